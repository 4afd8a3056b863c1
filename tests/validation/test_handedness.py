"""Pictures show the world as an observer sees it: x to the right, y up, looking along -z from behind the camera.

An extruded letter (STL), a textured GLB and a textured primitive stand off the axis at known places. Everything that
lfmesh makes of them is compared with their vertices projected by hand, through a pinhole in the middle of the
entrance pupil: nothing from here to the products shares code with lfmesh. The right way round the correlation is above
0.9; each of the other seven ways of laying the picture down is at least 0.2 worse.
"""

import io
import json
import shutil
import struct
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import PIL.ImageDraw
import PIL.ImageFont
import pytest
import pyvista
import trimesh
from numpy.typing import NDArray
from scipy.io import loadmat

import lfmesh as lf
from tests.processor_time import HANGS_S

Array = NDArray[np.float64]

LEAST = 0.9
GAP = 0.2

# The camera: a stop, which is its own entrance pupil, 3 mm before a biconvex lens; all by paraxial formulae.
STOP_RADIUS, STOP_TO_LENS = 4.6, 3.0
RADIUS, INDEX, THICKNESS = 51.68, 1.5168, 5.0
FOCUS = 500.0
LENSLETS, PITCH, LENSLET_FOCAL_LENGTH = 48, 0.125, 0.76
PIXELS, BLOCK, PIXEL = 450, 9, 0.125 / 9
WAVELENGTH = 610.0
"""Where only red counts in a texture."""


def through_lens(
    height: float, slope: float, radius: float = RADIUS, thickness: float = THICKNESS
) -> tuple[float, float]:
    """Return height and slope of a paraxial ray behind a biconvex lens, from those before it."""
    power = (INDEX - 1.0) / radius
    slope = (slope - height * power) / INDEX
    height += thickness * slope
    return height, INDEX * slope - height * power


_Y, _U = through_lens(1.0, 1.0 / (FOCUS + STOP_TO_LENS))
LENS_TO_ARRAY = -_Y / _U
_Y, _U = through_lens(STOP_TO_LENS, 1.0)
IMAGE_DISTANCE = _Y + LENS_TO_ARRAY * _U
"""Height on the array over the slope of the ray through the pinhole."""
PUPIL_TO_ARRAY = LENS_TO_ARRAY + _Y / _U
MICRO_IMAGE_MAGNIFICATION = 1.0 + LENSLET_FOCAL_LENGTH / PUPIL_TO_ARRAY
"""Distance of micro-images over that of lenslets."""

SCENE: dict[str, Any] = {
    "camera": {
        "lens": {
            "surfaces": [
                {"stop": True, "thickness_mm": STOP_TO_LENS, "semi_diameter_mm": STOP_RADIUS},
                {"radius_mm": RADIUS, "thickness_mm": THICKNESS, "index": INDEX, "semi_diameter_mm": 9.0},
                {"radius_mm": -RADIUS, "semi_diameter_mm": 9.0},
            ]
        },
        "mla": {
            "count": (LENSLETS, LENSLETS), "pitch_mm": PITCH, "focal_length_mm": LENSLET_FOCAL_LENGTH, "index": 1.5,
            "thickness_mm": 0.3, "distance_mm": LENS_TO_ARRAY,
        },
        "sensor": {"pixels": (PIXELS, PIXELS), "pixel_mm": PIXEL},
    },
    "transport": {"split": "transmit", "samples": 8, "replicates": 2, "wavelengths_nm": (WAVELENGTH,), "threads": 2},
}  # fmt: skip
GLOW = {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}


# The bodies: what is handed to lfmesh, and the same facets, placed by hand.


@dataclass(frozen=True)
class Body:
    """A target, its facets (n, 3, 3) in the world, and where their corners lie in its picture, from its bottom left."""

    name: str
    target: dict[str, Any]
    facets: Array
    uv: Array | None = None
    picture: Array | None = field(default=None, repr=False)
    """(h, w), 0 to 1, row 0 on top; a body without one glows evenly."""


def rotation(degrees: tuple[float, float, float]) -> Array:
    """Return the matrix of rotations about x, then y, then z."""
    (a, b, c), (p, q, r) = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    about_x = np.array([[1, 0, 0], [0, a, -p], [0, p, a]])
    about_y = np.array([[b, 0, q], [0, 1, 0], [-q, 0, b]])
    about_z = np.array([[c, -r, 0], [r, c, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def extruded_letter(folder: Path) -> Body:
    """An F of three boxes: x along its bars, y up its stem, 4 mm deep."""
    boxes = [((-7, -10), (-3, 10)), ((-3, 6), (7, 10)), ((-3, -1), (4, 3))]
    solid = trimesh.util.concatenate([trimesh.creation.box(bounds=[(*low, -2), (*high, 2)]) for low, high in boxes])
    solid.export(folder / "f.stl")
    place, turn = (14.0, 8.0, -470.0), (12.0, -15.0, 10.0)
    target = {
        "file": str(folder / "f.stl"),
        "units": "mm",
        "position_mm": place,
        "rotation_deg": turn,
        "material": GLOW,
    }
    return Body("letter", target, np.asarray(solid.triangles) @ rotation(turn).T + place)


def written(letter: str, folder: Path, size: tuple[int, int]) -> tuple[Path, Array]:
    """Write a letter, orange on dark blue, as PNG; return the file and what of it is letter."""
    mask = PIL.Image.new("L", size)
    font = PIL.ImageFont.load_default(1.2 * size[1])
    middle = (0.5 * size[0], 0.5 * size[1])
    PIL.ImageDraw.Draw(mask).text(middle, letter, 255, font, "mm", stroke_width=size[1] // 20)
    share = np.asarray(mask)[..., None] / 255.0
    colours = share * [255, 170, 20] + (1.0 - share) * [0, 0, 50]
    path = folder / f"{letter}.png"
    PIL.Image.fromarray(np.rint(colours).astype(np.uint8)).save(path)
    return path, share[..., 0]


QUAD = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])
"""Bottom left, bottom right, top right, top left."""
SPLIT = np.array([[0, 1, 2], [0, 2, 3]])


def textured_glb(folder: Path) -> Body:
    """An R on a sheet, its file written by hand; glTF counts from the top left of a picture, in metres."""
    image, letter = written("R", folder, (96, 128))
    corners, turn, place = QUAD * [15.0, 20.0, 0.0], (0.0, 20.0, -15.0), (-13.0, 9.0, -540.0)
    uv = QUAD[:, :2] + 0.5
    content = [
        (1e-3 * corners).astype("<f4").tobytes(), np.column_stack([uv[:, 0], 1.0 - uv[:, 1]]).astype("<f4").tobytes(),
        SPLIT.astype("<u2").tobytes(), image.read_bytes(),
    ]  # fmt: skip
    starts = np.cumsum([0, *(len(part) + -len(part) % 4 for part in content)])
    views = [
        {"buffer": 0, "byteOffset": int(start), "byteLength": len(part)}
        for start, part in zip(starts, content, strict=False)
    ]
    tree = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0}], "images": [{"bufferView": 3, "mimeType": "image/png"}],
        "buffers": [{"byteLength": int(starts[-1])}], "bufferViews": views,
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": (1e-3 * corners[0]).tolist(),
             "max": (1e-3 * corners[2]).tolist()},
            {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2"},
            {"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
    }  # fmt: skip
    words = json.dumps(tree).encode()
    words += b" " * (-len(words) % 4)
    data = b"".join(part + b"\0" * (-len(part) % 4) for part in content)
    chunks = struct.pack("<I4s", len(words), b"JSON") + words + struct.pack("<I4s", len(data), b"BIN\0") + data
    (folder / "r.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    target = {"file": str(folder / "r.glb"), "position_mm": place, "rotation_deg": turn, "material": GLOW}
    return Body("glb", target, (corners @ rotation(turn).T + place)[SPLIT], uv[SPLIT], letter)


def textured_plane(folder: Path) -> Body:
    """A 4 on a plane, by the rule: its right is +x, its top is +y."""
    image, letter = written("4", folder, (96, 128))
    place = (12.0, -9.0, -FOCUS)
    target = {
        "shape": {"kind": "plane", "width_mm": 15.0, "height_mm": 20.0},
        "position_mm": place,
        "material": {**GLOW, "texture": str(image)},
    }
    corners = np.array([[4.5, -19.0], [19.5, -19.0], [19.5, 1.0], [4.5, 1.0]])
    facets = np.column_stack([corners, np.full(4, -FOCUS)])[SPLIT]
    return Body("plane", target, facets, (QUAD[:, :2] + 0.5)[SPLIT], letter)


def textured_box(folder: Path) -> Body:
    """A G on a box whose top, the +y face, is turned towards the camera: there the top of a picture lies towards -z."""
    image, letter = written("G", folder, (128, 128))
    turn, place = (90.0, 0.0, 0.0), (-12.0, -7.0, -FOCUS)
    target = {
        "shape": {"kind": "box", "size_mm": (18.0, 4.0, 18.0)},
        "position_mm": place,
        "rotation_deg": turn,
        "material": {**GLOW, "texture": str(image)},
    }
    # Bottom left, bottom right, top right, top left, seen from above with -z on top.
    corners = np.array([[-9.0, 2.0, 9.0], [9.0, 2.0, 9.0], [9.0, 2.0, -9.0], [-9.0, 2.0, -9.0]])
    facets = (corners @ rotation(turn).T + place)[SPLIT]
    return Body("box", target, facets, (QUAD[:, :2] + 0.5)[SPLIT], letter)


BODIES: dict[str, Callable[[Path], Body]] = {
    "letter": extruded_letter, "glb": textured_glb, "plane": textured_plane, "box": textured_box,
}  # fmt: skip


# The oracle: facets projected and filled.

Projection = Callable[[Array], tuple[Array, Array]]
"""From (n, 3) points to (n, 2) columns and rows, in pixels from the middle of the first, and (n,) depths."""

FINE = 4
"""Points a pixel, along each axis, in a drawing by hand."""


def drawing(facets: Array, uv: Array | None, picture: Array | None, project: Projection, size: int) -> Array:
    """Fill projected facets; each point of a picture on them shows what lies there."""
    fine = np.zeros((size * FINE, size * FINE))
    for number, facet in enumerate(facets):
        place, depth = project(facet)
        corners = (place + 0.5) * FINE - 0.5
        low = np.maximum(np.floor(corners.min(axis=0)).astype(int), 0)
        high = np.minimum(np.ceil(corners.max(axis=0)).astype(int), size * FINE - 1)
        edges = (corners[1:] - corners[0]).T
        if (high < low).any() or abs(np.linalg.det(edges)) < 1e-12:
            continue
        column, row = np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True)))
        second, third = np.linalg.solve(edges, np.stack([column.ravel(), row.ravel()]) - corners[0][:, None])
        share = np.stack([1.0 - second - third, second, third], axis=1)
        inside = (share >= -1e-9).all(axis=1)
        value: Any = 1.0
        if uv is not None and picture is not None:
            nearness = share[inside] / depth
            u, v = (nearness @ uv[number] / nearness.sum(axis=1, keepdims=True)).T
            height, width = picture.shape
            texel = np.clip([(1.0 - v) * height, u * width], 0, [[height - 1], [width - 1]]).astype(int)
            value = picture[texel[0], texel[1]]
        fine[row.ravel()[inside], column.ravel()[inside]] = value
    return fine.reshape(size, FINE, size, FINE).mean(axis=(1, 3))


def pinhole(size: int, sample_mm: float) -> Projection:
    """See from the middle of the stop, at the origin, along -z: columns run along +x, rows along -y."""

    def project(points: Array) -> tuple[Array, Array]:
        depth = -points[:, 2]
        right, up = IMAGE_DISTANCE / sample_mm * points[:, :2].T / depth
        return 0.5 * (size - 1) + np.column_stack([right, -up]), depth

    return project


def eye(place: Array, focus: Array, angle_deg: float, size: int) -> Projection:
    """See from a place, with +y up, an angle from the bottom of a square picture to its top."""
    ahead = (focus - place) / np.linalg.norm(focus - place)
    right = np.cross(ahead, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    axes = np.stack([right, -np.cross(right, ahead)])
    scale = 0.5 * size / np.tan(np.deg2rad(0.5 * angle_deg))

    def project(points: Array) -> tuple[Array, Array]:
        depth = (points - place) @ ahead
        return 0.5 * (size - 1) + scale * ((points - place) @ axes.T) / depth[:, None], depth

    return project


ORIENTATIONS: dict[str, Callable[[Array], Array]] = {
    "columns reversed": lambda a: a[:, ::-1],
    "rows reversed": lambda a: a[::-1],
    "turned by 180°": lambda a: a[::-1, ::-1],
    "transposed": lambda a: a.T,
    "transposed, columns reversed": lambda a: a.T[:, ::-1],
    "transposed, rows reversed": lambda a: a.T[::-1],
    "transposed, turned by 180°": lambda a: a.T[::-1, ::-1],
}
"""Every way of laying a square picture down but the right one."""


def correlation(a: Array, b: Array) -> float:
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def assert_upright(found: Array, expected: Array, least: float = LEAST) -> None:
    assert found.shape == expected.shape
    found = np.nan_to_num(found)
    right = correlation(found, expected)
    others = {name: correlation(turned(found), expected) for name, turned in ORIENTATIONS.items()}
    best = max(others, key=others.__getitem__)
    assert right > least, f"correlation {right:.3f}; {best} it is {others[best]:.3f}"
    assert others[best] < right - GAP, f"correlation {right:.3f}, and {best} it is {others[best]:.3f}"


# What lfmesh makes of a body.


@dataclass
class Shot:
    """A body before the camera, and all that is made of it, each when it is first asked for."""

    body: Body
    folder: Path
    changes: dict[str, Any] = field(default_factory=dict)
    """Of the camera."""

    @cached_property
    def scene(self) -> lf.Scene:
        return lf.Scene(**SCENE, targets=[self.body.target]).changed(self.changes)

    @cached_property
    def image(self) -> lf.Image:
        return lf.render(self.scene)

    @cached_property
    def white(self) -> lf.Image:
        return lf.white_image(self.scene)

    @cached_property
    def run(self) -> Path:
        return lf.save(self.image, self.folder / "run")

    @cached_property
    def field(self) -> lf.LightField:
        return lf.decode(self.image, views=7)

    @property
    def distance_mm(self) -> float:
        return -float(self.body.facets[..., 2].mean())

    def exported(self, kind: str) -> Path:
        """The folder of an export."""
        folder = self.folder / kind
        if kind in ("plenopticam", "plenpy"):
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", "PlenoptiCam", UserWarning)
                lf.export_raw(self.image, self.white, lf.calibrate(self.scene), folder, kind)  # type: ignore[arg-type]
        else:
            lf.export_field(self.field, folder, kind)  # type: ignore[arg-type]
        return folder


def eight_bits(path: Path) -> Array:
    """Read red, linear (IEC 61966-2-1)."""
    with PIL.Image.open(path) as picture:
        coded = np.asarray(picture.convert("RGB"))[..., 0] / 255.0
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)


def grey16(path: Path) -> Array:
    with PIL.Image.open(path) as picture:
        return np.asarray(picture, dtype=np.float64)


def rgb16(path: Path) -> Array:
    """Read red; by VTK, whose rows run from the bottom, as pillow reads 8 bits only."""
    picture = pyvista.read(path)
    width, height, _ = picture.dimensions
    return np.asarray(picture["PNGImage"], dtype=np.float64).reshape(height, width, 3)[::-1, :, 0]


def averaged(pixels: Array, block: int = BLOCK) -> Array:
    """Return the means of square blocks: by default, of micro-images."""
    size = len(pixels) // block
    return pixels.reshape(size, block, size, block).mean(axis=(1, 3))


def per_lenslet(pixels: Array) -> Array:
    """Return a picture whose lenslets are drawn as squares with one value each."""
    return averaged(pixels, len(pixels) // LENSLETS)


def exposed_png(shot: Shot) -> Array:
    from lfmesh.files.exposed import save_exposed

    save_exposed(lf.Detector().filling(shot.image).expose(shot.image), shot.run)
    return grey16(shot.run / "exposed.png")


RAW: dict[str, Callable[[Shot], Array]] = {
    "raw image": lambda shot: shot.image.mean[:, ::-1, 0],
    "preview.png": lambda shot: eight_bits(shot.run / "preview.png"),
    "linear16.png": lambda shot: grey16(shot.run / "linear16.png"),
    "exposed.png": exposed_png,
    "plenopticam": lambda shot: eight_bits(shot.exported("plenopticam") / "raw.png"),
}
"""Upright pictures of all pixels."""


def tile(mosaic: Array, views: int = 7) -> Array:
    """Return the middle one of views side by side."""
    size, middle = len(mosaic) // views, views // 2
    return mosaic[middle * size : (middle + 1) * size, middle * size : (middle + 1) * size]


def views_png(shot: Shot) -> Array:
    from lfmesh.files.field import save_field

    save_field(shot.field, shot.run)
    return tile(eight_bits(shot.run / "views.png"))


def refocused_png(shot: Shot) -> Array:
    from lfmesh.files.photographs import save_photograph

    _, path = save_photograph(lf.refocus(shot.field, shot.distance_mm), shot.run)
    return per_lenslet(eight_bits(path))


def stack(shot: Shot) -> lf.FocalStack:
    return lf.focal_stack(shot.field, [450.0, shot.distance_mm, 560.0])


def all_in_focus_png(shot: Shot) -> Array:
    from lfmesh.files.photographs import save_all_in_focus

    save_all_in_focus(lf.all_in_focus(stack(shot)), shot.run)
    return per_lenslet(eight_bits(shot.run / "all_in_focus.png"))


def stack_png(shot: Shot) -> Array:
    from lfmesh.files.photographs import save_stack

    save_stack(stack(shot), shot.run)
    with PIL.Image.open(shot.run / "stack.png") as animation:
        animation.seek(1)
        return per_lenslet(np.asarray(animation.convert("RGB"), dtype=np.float64)[..., 0])


def toolbox_view(shot: Shot) -> Array:
    light = loadmat(shot.exported("lftoolbox") / "lightfield.mat")["LF"]
    return light[3, 3, :, :, 0].astype(float)


def epis(shot: Shot) -> Array:
    """Put the rows of the middle view together from the EPIs of all rows."""
    return np.stack([shot.field.epi(t=t, v=3)[3, :, 0] for t in range(LENSLETS)])


VIEWS: dict[str, Callable[[Shot], Array]] = {
    "centre view": lambda shot: shot.field.view(3, 3)[..., 0],
    "centre view over white": lambda shot: lf.decode(shot.image, white=shot.white, views=7).view(3, 3)[..., 0],
    "epis": epis,
    "views.png": views_png,
    "refocused": lambda shot: lf.refocus(shot.field, shot.distance_mm).mean[..., 0],
    "refocused, Fourier": lambda shot: lf.refocus(shot.field, shot.distance_mm, method="fourier").mean[..., 0],
    "refocused.png": refocused_png,
    "all in focus": lambda shot: lf.all_in_focus(stack(shot)).mean[..., 0],
    "all_in_focus.png": all_in_focus_png,
    "stack.png": stack_png,
    "lftoolbox": toolbox_view,
    "eslf": lambda shot: rgb16(shot.exported("eslf") / "lightfield.eslf.png")[3::7, 3::7],
    "hci": lambda shot: eight_bits(shot.exported("hci") / "input_Cam024.png"),
    "views": lambda shot: eight_bits(shot.exported("views") / "view_v03_u03.png"),
}
"""Upright pictures of one sample a lenslet."""

CORE = {
    "letter": {*RAW, *VIEWS},
    "glb": {"raw image", "centre view", "refocused"},
    "plane": {"raw image", "centre view", "refocused"},
    "box": {"raw image"},
}
"""What is compared in every run of the tests; the rest is `long`."""


def cases(products: dict[str, Any]) -> list[Any]:
    return [
        pytest.param(body, name, id=f"{body}: {name}", marks=[] if name in CORE[body] else [pytest.mark.long])
        for body in BODIES
        for name in products
    ]


@pytest.fixture(scope="module")
def shots(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Shot]:
    made: dict[str, Shot] = {}

    def shot(body: str) -> Shot:
        if body not in made:
            folder = tmp_path_factory.mktemp(body)
            made[body] = Shot(BODIES[body](folder), folder)
        return made[body]

    return shot


def by_hand(body: Body, size: int, sample_mm: float) -> Array:
    return drawing(body.facets, body.uv, body.picture, pinhole(size, sample_mm), size)


@pytest.mark.parametrize(("body", "product"), cases(RAW))
def test_pictures_of_all_pixels_show_what_is_projected_by_hand(
    shots: Callable[[str], Shot], body: str, product: str
) -> None:
    shot = shots(body)
    found = averaged(RAW[product](shot))
    assert_upright(found, by_hand(shot.body, len(found), BLOCK * PIXEL / MICRO_IMAGE_MAGNIFICATION))


@pytest.mark.parametrize(("body", "product"), cases(VIEWS))
def test_views_and_photographs_show_what_is_projected_by_hand(
    shots: Callable[[str], Shot], body: str, product: str
) -> None:
    shot = shots(body)
    # A plane nearer or farther than the focus is photographed at the views' own scale.
    assert_upright(VIEWS[product](shot), by_hand(shot.body, LENSLETS, PITCH))


@pytest.mark.parametrize("body", BODIES)
def test_the_view_of_a_run_shows_what_is_projected_by_hand(shots: Callable[[str], Shot], body: str) -> None:
    shot = shots(body)
    found = averaged(eight_bits(shot.run / "preview_view.png"), 10)
    assert_upright(found, by_hand(shot.body, len(found), LENSLETS * PITCH / len(found)))


def test_true_depth_is_known_where_the_letter_is(shots: Callable[[str], Shot]) -> None:
    shot = shots("letter")
    truth = lf.depth_truth(shot.scene, views=3, samples=1)
    expected = by_hand(shot.body, LENSLETS, PITCH)
    assert_upright(np.isfinite(truth.views_mm[1, 1]).astype(float), expected)
    assert_upright(np.isfinite(truth.middle_mm).astype(float), expected)
    pixels = averaged(truth.seen[:, ::-1].astype(float))
    assert_upright(pixels, by_hand(shot.body, len(pixels), BLOCK * PIXEL / MICRO_IMAGE_MAGNIFICATION))


def centroid(view: Array) -> Array:
    """Return the mean column and row of the light."""
    light = np.nan_to_num(view)
    return np.array([light.sum(axis=0) @ np.arange(light.shape[1]), light.sum(axis=1) @ np.arange(len(light))]) / (
        light.sum()
    )


def disk_at(distance_mm: float) -> Body:
    """A small disk on the axis."""
    disk = {"shape": {"kind": "disk", "radius_mm": 4.0}, "position_mm": (0.0, 0.0, -distance_mm), "material": GLOW}
    return Body("disk", disk, np.zeros((0, 3, 3)))


def assert_parallax(field: lf.LightField, expected: float) -> None:
    """Views that are four apart along an axis show a body that many samples further to the right, or down."""
    across = centroid(field.view(3, 5)[..., 0]) - centroid(field.view(3, 1)[..., 0])
    down = centroid(field.view(5, 3)[..., 0]) - centroid(field.view(1, 3)[..., 0])
    # The lenses have aberrations.
    assert across == pytest.approx([expected, 0.0], rel=0.15, abs=0.1)
    assert down == pytest.approx([0.0, expected], rel=0.15, abs=0.1)


@pytest.mark.parametrize("distance_mm", [330.0, 900.0], ids=["near", "far"])
def test_larger_u_looks_from_further_right_and_larger_v_from_further_down(distance_mm: float, tmp_path: Path) -> None:
    """By the pinhole moved over the pupil: what is nearer than the focus moves against it.

    From p beside the middle it sees a point on the axis, at distance d, where the line through both meets the plane in
    focus F: at p (1 - F/d). The shift is nearly two lenslets.
    """
    # A pixel beside the middle of a micro-image looks at the exit pupil, whose radius is that of the stop over _U.
    step = PIXEL / LENSLET_FOCAL_LENGTH * PUPIL_TO_ARRAY * _U
    shift = 4 * step * (1.0 - FOCUS / distance_mm) * IMAGE_DISTANCE / FOCUS
    assert_parallax(Shot(disk_at(distance_mm), tmp_path).field, shift / PITCH)


def test_axes_of_the_light_field_ascend_to_the_right_and_down(shots: Callable[[str], Shot]) -> None:
    field = shots("letter").field
    axes = {"s_mm": field.s_mm, "t_mm": field.t_mm, "u_rad": field.u_rad, "v_rad": field.v_rad}
    for name, axis in axes.items():
        assert (np.diff(axis) > 0.0).all(), name
        assert axis.mean() == pytest.approx(0.0, abs=1e-9), name
    # The letter is right of the axis and above it.
    right, down = np.interp(centroid(field.view(3, 3)[..., 0]), np.arange(LENSLETS), field.s_mm)
    assert right > 0.5
    assert down < -0.3


# Other cameras.

CONVENTIONAL = {
    "camera.mla": None, "camera.sensor": {
        "pixels": (LENSLETS, LENSLETS), "pixel_mm": PITCH, "distance_mm": LENS_TO_ARRAY,
    },
}  # fmt: skip


def test_a_conventional_cameras_picture_shows_what_is_projected_by_hand(tmp_path: Path) -> None:
    shot = Shot(extruded_letter(tmp_path), tmp_path, CONVENTIONAL)
    expected = by_hand(shot.body, LENSLETS, PITCH)
    assert_upright(shot.image.mean[:, ::-1, 0], expected)
    assert_upright(eight_bits(shot.run / "preview.png"), expected)


def test_a_camera_that_is_moved_and_turned_sees_the_same(tmp_path: Path) -> None:
    """And right and up are its own."""
    tilt, shift = (25.0, 130.0, -40.0), (300.0, -20.0, 70.0)
    body = textured_plane(tmp_path)
    place = rotation(tilt) @ body.target["position_mm"] + shift
    target = {**body.target, "position_mm": place.tolist(), "rotation_deg": tilt}
    moved = Body("moved", target, body.facets, body.uv, body.picture)
    shot = Shot(moved, tmp_path, {"camera.pose": {"shift_mm": shift, "tilt_deg": tilt}})
    assert_upright(shot.field.view(3, 3)[..., 0], by_hand(body, LENSLETS, PITCH))


@pytest.mark.long
@pytest.mark.parametrize("body", BODIES)
def test_a_hexagonal_cameras_pictures_show_what_is_projected_by_hand(tmp_path: Path, body: str) -> None:
    hexagonal = {"camera.mla.layout": "hexagonal", "camera.mla.count": (LENSLETS, round(LENSLETS / np.sqrt(0.75)))}
    shot = Shot(BODIES[body](tmp_path), tmp_path, hexagonal)
    folder = shot.exported("plenpy")
    for pixels in (eight_bits(shot.run / "preview.png"), rgb16(folder / "Images" / "raw.png")):
        found = averaged(pixels)
        assert_upright(found, by_hand(shot.body, len(found), BLOCK * PIXEL / MICRO_IMAGE_MAGNIFICATION))


@pytest.mark.long
@pytest.mark.parametrize("body", BODIES)
def test_a_focused_cameras_photographs_show_what_is_projected_by_hand(tmp_path: Path, body: str) -> None:
    """Its patches are put together the right way round; at the scale that the photograph says."""
    shot = Shot(BODIES[body](tmp_path), tmp_path)
    standard = shot.scene.changed({"camera.mla.distance_mm": None, "camera.focus_mm": FOCUS})
    taken = lf.render(lf.focused(standard, 3.0))
    photograph = lf.render_patches(taken, shot.distance_mm)
    size = len(photograph.mean)
    sample_mm = photograph.sample_mm * IMAGE_DISTANCE / shot.distance_mm
    assert_upright(photograph.mean[..., 0], by_hand(shot.body, size, sample_mm))


# A relay: the lens, a field lens in its image, and a second lens that images it once more, now the right way up.
FIELD_LENS_RADIUS, FIELD_LENS_THICKNESS = 40.0, 3.0
RELAY_DISTANCE = 100.0


@dataclass(frozen=True)
class Relay:
    """Its surfaces, where its image lies, and how the ray through the pinhole with slope 1 arrives there."""

    surfaces: list[dict[str, Any]]
    distance_mm: float
    height_mm: float
    slope: float


RELAY_STOP = 2.5


def relay() -> Relay:
    lenses = [
        (RADIUS, THICKNESS, STOP_TO_LENS), (FIELD_LENS_RADIUS, FIELD_LENS_THICKNESS, LENS_TO_ARRAY),
        (RADIUS, THICKNESS, RELAY_DISTANCE),
    ]  # fmt: skip
    surfaces: list[dict[str, Any]] = [{"stop": True, "semi_diameter_mm": RELAY_STOP}]
    marginal, chief = (1.0, 1.0 / FOCUS), (0.0, 1.0)
    for radius, thickness, before in lenses:
        surfaces[-1]["thickness_mm"] = before
        marginal, chief = (through_lens(y + before * u, u, radius, thickness) for y, u in (marginal, chief))
        surfaces += [
            {"radius_mm": radius, "thickness_mm": thickness, "index": INDEX, "semi_diameter_mm": 9.0},
            {"radius_mm": -radius, "semi_diameter_mm": 9.0},
        ]
    distance = -marginal[0] / marginal[1]
    return Relay(surfaces, distance, chief[0] + distance * chief[1], chief[1])


def test_a_relay_that_images_the_right_way_up_reverses_rows_in_place_of_columns(tmp_path: Path) -> None:
    lens = relay()
    assert lens.height_mm < 0.0 < IMAGE_DISTANCE
    changes = {
        "camera.lens.surfaces": lens.surfaces,
        "camera.mla": None,
        "camera.sensor": {"pixels": (LENSLETS, LENSLETS), "pixel_mm": PITCH, "distance_mm": lens.distance_mm},
    }
    shot = Shot(extruded_letter(tmp_path), tmp_path, changes)
    expected = by_hand(shot.body, LENSLETS, PITCH * IMAGE_DISTANCE / -lens.height_mm)
    assert_upright(shot.image.mean[::-1, :, 0], expected)
    assert_upright(eight_bits(shot.run / "preview.png"), expected)


def test_the_views_of_a_relay_look_from_where_they_say(tmp_path: Path) -> None:
    """Whatever the sign of its pupil magnification: it is negative here, as that of the image is positive."""
    lens, near_mm = relay(), 330.0
    pupil_to_array = lens.height_mm / lens.slope
    focal_length = PITCH * abs(pupil_to_array * lens.slope) / (2 * RELAY_STOP)
    changes = {
        "camera.lens.surfaces": lens.surfaces,
        "camera.mla.distance_mm": lens.distance_mm,
        "camera.mla.focal_length_mm": focal_length,
    }
    letter = Shot(extruded_letter(tmp_path), tmp_path, changes)
    sample_mm = PITCH * IMAGE_DISTANCE / -lens.height_mm
    assert_upright(letter.field.view(3, 3)[..., 0], by_hand(letter.body, LENSLETS, sample_mm))
    step = PIXEL / focal_length * abs(pupil_to_array * lens.slope)
    shift = 4 * step * (1.0 - FOCUS / near_mm) * -lens.height_mm / FOCUS
    assert_parallax(Shot(disk_at(near_mm), tmp_path, changes).field, shift / PITCH)


# 3D: pictures, pages and models.

SIDE = 400
PAGE = (500, 400)
"""Width and height of the browser's window: as wide, over its height, as a page is laid out for."""


def assert_seen(shot: Shot, picture: PIL.Image.Image, aspect: float, angle_deg: float) -> None:
    """Compare a 3D view with the body, seen from where lfmesh has put the eye; what is right and up is ours."""
    from lfmesh.view.scene3d.presets import viewpoint

    seen = viewpoint(lf.build(shot.scene), "object", aspect, angle_deg=angle_deg)
    assert seen.eye[2] > seen.focus[2], "from behind"
    expected = drawing(
        shot.body.facets, shot.body.uv, shot.body.picture, eye(seen.eye, seen.focus, angle_deg, SIDE), SIDE
    )
    rgb = np.asarray(picture.convert("RGB"), dtype=np.float64)
    left = (rgb.shape[1] - SIDE) // 2
    red, _, blue = np.moveaxis(rgb[:, left : left + SIDE], 2, 0)
    # Of all that is drawn only letters on pictures are orange, and only glowing bodies as bright as this.
    assert_upright((red - blue > 60.0 if shot.body.picture is not None else blue > 200.0).astype(float), expected)


@pytest.mark.drawing
@pytest.mark.parametrize("body", BODIES)
def test_the_picture_of_a_3d_view_shows_what_is_projected_by_hand(
    shots: Callable[[str], Shot], tmp_path: Path, body: str
) -> None:
    shot = shots(body)
    lf.show(shot.scene, rays="none", preset="object", size=(SIDE, SIDE), screenshot=tmp_path / "view.png")
    with PIL.Image.open(tmp_path / "view.png") as picture:
        assert_seen(shot, picture, 1.0, 36.0)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
    with sync_playwright() as driver:
        # Chromium's sandbox does not run as root, as tests do in containers; its WebGL may be software.
        arguments = ["--no-sandbox", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
        running = driver.chromium.launch(executable_path=chromium, args=arguments)
        yield running
        running.close()


@pytest.mark.drawing
@pytest.mark.browser
@pytest.mark.parametrize(
    "body", ["plane", *(pytest.param(body, marks=pytest.mark.long) for body in BODIES if body != "plane")]
)
def test_a_page_shows_what_is_projected_by_hand(
    shots: Callable[[str], Shot], browser: Any, tmp_path: Path, body: str
) -> None:
    shot = shots(body)
    lf.show(shot.scene, rays="none", preset="object", html=tmp_path / "page.html")
    page = browser.new_page(viewport={"width": PAGE[0], "height": PAGE[1]})
    try:
        page.set_default_timeout(1000.0 * HANGS_S)
        page.goto((tmp_path / "page.html").as_uri())
        page.wait_for_selector("canvas")
        page.evaluate("document.querySelectorAll('.words').forEach(words => words.remove())")
        page.wait_for_timeout(3000)
        shown, before = page.screenshot(), b""
        while shown != before:
            page.wait_for_timeout(500)
            shown, before = page.screenshot(), shown
        picture = PIL.Image.open(io.BytesIO(shown))
    finally:
        page.close()
    # vtk.js has its own angle from the bottom to the top of a picture.
    assert_seen(shot, picture, PAGE[0] / PAGE[1], 30.0)


def in_glb(path: Path, name: str) -> tuple[Array, Array, Array | None]:
    """Read the facets (n, 3, 3) of a node in m, their uv from the top left, and red of the base colour's picture."""
    content = path.read_bytes()
    length = struct.unpack_from("<I", content, 12)[0]
    tree, data = json.loads(content[20 : 20 + length]), content[28 + length :]

    def bytes_of(number: int) -> bytes:
        view = tree["bufferViews"][number]
        start = view.get("byteOffset", 0)
        return data[start : start + view["byteLength"]]

    def array(number: int) -> Array:
        accessor = tree["accessors"][number]
        kind = {5126: "<f4", 5125: "<u4", 5123: "<u2"}[accessor["componentType"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}[accessor["type"]]
        start = accessor.get("byteOffset", 0)
        return np.frombuffer(bytes_of(accessor["bufferView"])[start:], kind, accessor["count"] * width).reshape(
            -1, width
        )

    node = next(node for node in tree["nodes"] if node.get("name") == name)
    assert not node.keys() & {"translation", "rotation", "scale"}
    placed = np.reshape(node.get("matrix", np.eye(4).ravel()), (4, 4)).T
    (primitive,) = tree["meshes"][node["mesh"]]["primitives"]
    points = array(primitive["attributes"]["POSITION"]).astype(float) @ placed[:3, :3].T + placed[:3, 3]
    faces = array(primitive["indices"]).reshape(-1, 3).astype(int)
    texture = tree["materials"][primitive["material"]]["pbrMetallicRoughness"].get("baseColorTexture")
    uv = array(primitive["attributes"]["TEXCOORD_0"]).astype(float)[faces]
    if texture is None:
        return points[faces], uv, None
    image = tree["images"][tree["textures"][texture["index"]]["source"]]
    with PIL.Image.open(io.BytesIO(bytes_of(image["bufferView"]))) as picture:
        return points[faces], uv, np.asarray(picture.convert("RGB"), dtype=np.float64)[..., 0] / 255.0


@pytest.mark.drawing
@pytest.mark.parametrize("body", BODIES)
def test_a_model_holds_what_is_projected_by_hand(shots: Callable[[str], Shot], tmp_path: Path, body: str) -> None:
    """In metres, with our axes, which are glTF's: right-handed, y up."""
    shot = shots(body)
    lf.show(shot.scene, rays="none", gltf=tmp_path / "model.glb")
    facets, uv, picture = in_glb(tmp_path / "model.glb", "targets[0]")
    # glTF counts v from the top of a picture.
    uv = uv * [1.0, -1.0] + [0.0, 1.0]
    if shot.body.name == "box":
        # Only the face towards the camera; the others are seen edge-on.
        front = np.ptp(facets[..., 2], axis=1) < 1e-6
        front &= facets[..., 2].mean(axis=1) == facets[front][..., 2].mean(axis=1).max()
        facets, uv = facets[front], uv[front]
    found = drawing(1e3 * facets, uv, picture, pinhole(LENSLETS, PITCH), LENSLETS)
    assert_upright(found, by_hand(shot.body, LENSLETS, PITCH))
