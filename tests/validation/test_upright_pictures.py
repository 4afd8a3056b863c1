"""Pictures stand as an observer behind the camera sees them, against places that are projected here, by hand.

Three small glowing disks stand in the plane in focus where no turn and no mirror takes them onto each other. Somebody
who stands behind the camera and looks along −z with +y up sees +x to the right. Nothing here turns or indexes pictures
with what lfmesh turns them with: an object point (x, y) belongs `x` over the width to the right of a picture's middle
and `y` over the height above it, seen through a pinhole in the entrance pupil.
"""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
import pyvista
from numpy.typing import NDArray
from scipy.io import loadmat

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.files import exr
from lfmesh.files.exposed import save_exposed
from lfmesh.files.field import save_field
from lfmesh.files.photographs import save_all_in_focus, save_photograph, save_stack
from lfmesh.view.browser.field_views import FieldViews
from lfmesh.view.browser.sensor_picture import SensorPicture
from lfmesh.view.request import subject_of
from tests.instances import instances

Array = NDArray[np.float64]

DISKS = ((0.66, 0.27), (-0.4, 0.6), (0.13, -0.53))
"""Places of the disks, (x, y) over half the width of what the camera sees in the plane in focus."""

RADIUS = 0.04
"""Of the disks, over the same."""

WIDE = 0.25
"""Of a disk that covers many lenslets, so that its centroid moves evenly from view to view."""

WINDOW = 0.18
"""Half the side of the square round a disk's place in which its light is looked for, over half of a picture's width."""


@dataclass(frozen=True)
class Camera:
    """A light-field camera focused on a distance, and what it is to see."""

    scene: lf.Scene
    focus_mm: float
    half_mm: float  # of what it sees in that plane

    def disk(self, x: float, y: float, distance_mm: float, radius: float = RADIUS) -> dict[str, Any]:
        """Return a glowing disk that is seen in the direction of a place (x, y) in the plane in focus."""
        pupil = lf.first_order(self.scene).entrance_pupil_z_mm
        scale = self.half_mm * (distance_mm + pupil) / (self.focus_mm + pupil)
        return {
            "shape": {"kind": "disk", "radius_mm": radius * scale},
            "position_mm": (x * scale, y * scale, -distance_mm),
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
        }

    def image(self, *targets: dict[str, Any]) -> lf.Image:
        """Render what it sees from the targets to the sensor."""
        return lf.render(
            self.scene.changed({"targets": targets, "transport.method": "forward", "transport.samples": 4})
        )

    @cached_property
    def taken(self) -> lf.Image:
        """The picture of the three disks."""
        return self.image(*(self.disk(x, y, self.focus_mm) for x, y in DISKS))

    @cached_property
    def white(self) -> lf.Image:
        return lf.white_image(self.scene)

    @cached_property
    def calibration(self) -> lf.Calibration:
        return lf.calibrate(self.scene)

    @cached_property
    def field(self) -> lf.LightField:
        return lf.decode(self.taken, calibration=self.calibration)


BICONVEX = [
    {"radius_mm": 50.0, "thickness_mm": 4.0, "index": 1.5, "semi_diameter_mm": 14.0},
    {"radius_mm": -50.0, "semi_diameter_mm": 14.0},
]


def camera(lens: dict[str, Any], focus_mm: float, focal_mm: float = 0.5, layout: str = "square") -> Camera:
    """Return a camera of 20 × 20 lenslets of some 10 × 10 pixels."""
    rows = 20 if layout == "square" else 23
    mla = {"layout": layout, "count": (20, rows), "pitch_mm": 0.125, "focal_length_mm": focal_mm}
    scene = lf.solved(
        lf.Scene(
            camera={
                "focus_mm": focus_mm,
                "lens": lens,
                "mla": {**mla, "index": 1.5, "thickness_mm": 0.3},
                "sensor": {"pixels": (210, 210), "pixel_mm": 0.0125},
            },
            transport={"split": "transmit", "samples": 8, "replicates": 2, "threads": 2},
        )
    )
    return Camera(scene, focus_mm, 0.5 * 20 * 0.125 / abs(lf.first_order(scene).magnification))


def double_gauss(layout: str = "square") -> Camera:
    """The lens of the demo, which inverts as all camera lenses do."""
    lens = {"file": asset_path("lenses/double_gauss_50mm.toml").as_posix(), "stop_semi_diameter_mm": 4.77}
    return camera(lens, 500.0, layout=layout)


def relay() -> Camera:
    """Two lenses with an image between them: what the array gets is erect, and the exit pupil is inverted."""
    first = [BICONVEX[0], {**BICONVEX[1], "thickness_mm": 196.0}]
    stop = {"stop": True, "thickness_mm": 1.0, "semi_diameter_mm": 3.5}
    return camera({"surfaces": [stop, *first, *BICONVEX]}, 100.0, 1.5)


def remote_stop() -> Camera:
    """A stop two focal lengths before the lens, which images it, inverted, behind the array."""
    stop = {"stop": True, "thickness_mm": 100.0, "semi_diameter_mm": 2.0}
    return camera({"surfaces": [stop, *BICONVEX]}, 400.0, 1.5)


CAMERAS: dict[str, Callable[[], Camera]] = {
    "square": double_gauss,
    "hexagonal": lambda: double_gauss("hexagonal"),
    "relay": relay,
    "remote stop": remote_stop,
}


@cache
def made(kind: str) -> Camera:
    """Return the camera of a kind, with what it has taken: made once for all tests."""
    return CAMERAS[kind]()


@pytest.fixture(scope="module", params=CAMERAS)
def bench(request: pytest.FixtureRequest) -> Camera:
    return made(request.param)


@pytest.fixture(scope="module")
def square() -> Camera:
    return made("square")


def share_at(picture: Array, half: tuple[float, float], places: tuple[tuple[float, float], ...]) -> float:
    """Return the share of a picture's light that lies round the places.

    Parameters
    ----------
    picture : (H, W) float64
    half : tuple of float
        Half the width of what the camera sees, in the picture's own pixels, along rows and columns.
    places : tuple of (x, y)
    """
    height, width = picture.shape
    row, column = np.indices(picture.shape)
    seen_x, seen_y = (column - 0.5 * (width - 1)) / half[1], -(row - 0.5 * (height - 1)) / half[0]
    near = np.zeros(picture.shape, np.bool_)
    for x, y in places:
        near |= (np.abs(seen_x - x) < WINDOW) & (np.abs(seen_y - y) < WINDOW)
    light = np.nan_to_num(picture)
    assert light.sum() > 0.0
    return float(light[near].sum() / light.sum())


def assert_upright(picture: NDArray[Any], half: tuple[float, float] | None = None) -> None:
    """Assert that a picture (H, W) or (H, W, c) shows the three disks where they are, and not where any turn puts them.

    `half` is half of the picture itself where it shows just what the array covers.
    """
    shown = np.asarray(picture, dtype=np.float64)
    shown = shown.reshape(*shown.shape[:2], -1).mean(axis=2)
    half = half or (0.5 * shown.shape[0], 0.5 * shown.shape[1])
    assert share_at(shown, half, DISKS) > 0.9
    for along_x, along_y in ((-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)):
        assert share_at(shown, half, tuple((along_x * x, along_y * y) for x, y in DISKS)) < 0.3


def on_sensor(bench: Camera) -> tuple[float, float]:
    """Return half the width of the array's picture on the sensor, in pixels."""
    sensor = bench.scene.camera.sensor
    half = 0.5 * 20 * (lf.first_order(bench.scene).micro_image_pitch_px or math.nan)
    assert half < 0.5 * min(sensor.pixels)
    return half, half


def in_views(bench: Camera) -> tuple[float, float]:
    """Return half the width of 20 lenslets, in samples of a view."""
    along_t, along_s = bench.field.spacing_mm
    return 10.0 * 0.125 / along_t, 10.0 * 0.125 / along_s


def png(path: Path) -> Array:
    """Read a picture as light: counts of 16 bits as they are, sRGB of 8 bits undone (IEC 61966-2-1)."""
    with PIL.Image.open(path) as picture:
        counts = np.asarray(picture)
    if counts.dtype != np.uint8:
        return counts.astype(np.float64)
    return np.where(counts <= 10, counts / 255.0 / 12.92, ((counts / 255.0 + 0.055) / 1.055) ** 2.4)


def png16(path: Path) -> Array:
    """Read 16-bit RGB by VTK, whose rows run from the bottom; pillow reads 8 bits only."""
    picture = pyvista.read(path)
    width, height, _ = picture.dimensions
    return np.asarray(picture["PNGImage"], dtype=np.float64).reshape(height, width, 3)[::-1]


def test_all_pictures_of_a_run_are_upright(bench: Camera, tmp_path: Path) -> None:
    folder = lf.save(bench.taken, tmp_path / "run")
    assert_upright(png(folder / "preview.png"), on_sensor(bench))
    assert_upright(png(folder / "linear16.png"), on_sensor(bench))
    view = png(folder / "preview_view.png")
    # As high and as wide as the array with its rims.
    rows = 20.0 if bench.scene.camera.mla.layout == "square" else 22.0 * math.sqrt(0.75) + 2.0 / math.sqrt(3.0)
    columns = 20.0 if bench.scene.camera.mla.layout == "square" else 20.5
    assert_upright(view, (view.shape[0] * 10.0 / rows, view.shape[1] * 10.0 / columns))
    save_exposed(lf.Detector().filling(bench.taken).expose(bench.taken), folder)
    counts = png(folder / "exposed.png")
    assert_upright(np.where(counts > 200.0, counts, 0.0), on_sensor(bench))
    report = json.loads((folder / "report.json").read_text())
    assert {picture["orientation"] for picture in report["pictures"].values()} == {"upright"}


def test_raw_images_stay_as_they_lie_on_the_sensor_and_say_how_to_turn_them(bench: Camera, tmp_path: Path) -> None:
    """The light of an object at +x, +y lies where x and y have the magnification's sign; columns count along x, rows
    along y.
    """
    folder = lf.save(bench.taken, tmp_path / "run")
    raw = exr.read(folder / "raw.exr", ("raw", "stderr"))
    power = raw.parts["raw"][..., 0].astype(np.float64)
    erect = lf.first_order(bench.scene).magnification > 0.0
    assert_upright(power[::-1] if erect else power[:, ::-1], on_sensor(bench))
    assert raw.metadata["orientation"].endswith("rows reversed, [::-1]" if erect else "columns reversed, [:, ::-1]")


def test_views_and_photographs_are_upright(bench: Camera, tmp_path: Path) -> None:
    field, half = bench.field, in_views(bench)
    views, _ = field.views
    for v, u in ((views // 2, views // 2), (views // 2, 2), (2, views // 2), (views - 3, views // 2 + 1)):
        assert_upright(field.view(v, u), half)
    folder = lf.save(bench.taken, tmp_path / "run")
    save_field(field, folder)
    mosaic = png(folder / "views.png")
    tile = mosaic.shape[0] // views, mosaic.shape[1] // views
    middle = mosaic[views // 2 * tile[0] :, views // 2 * tile[1] :][: tile[0], : tile[1]]
    enlarged = tile[0] / field.size[0]
    assert_upright(middle, (half[0] * enlarged, half[1] * enlarged))
    for method in ("shift", "fourier"):
        assert_upright(np.maximum(lf.refocus(field, bench.focus_mm, method=method).mean, 0.0), half)
    stack = lf.focal_stack(field, [bench.focus_mm, 0.97 * bench.focus_mm, 1.03 * bench.focus_mm])
    sharp = lf.all_in_focus(stack)
    assert_upright(sharp.mean, half)
    saved = [*save_photograph(stack.photographs[0], folder), *save_all_in_focus(sharp, folder)]
    saved += save_stack(stack, folder)
    for path in saved:
        if path.suffix == ".png":
            shown = png(path)
            enlarged = shown.shape[0] / field.size[0]
            assert_upright(shown, (half[0] * enlarged, half[1] * enlarged))


def test_an_epi_shows_a_disk_where_it_is(bench: Camera) -> None:
    """In the row of the first disk it lies right of the middle, in the column of the first it lies above it."""
    field, (half_t, half_s) = bench.field, in_views(bench)
    (height, width), (x, y) = field.size, DISKS[0]
    across, down = 0.5 * (width - 1) + x * half_s, 0.5 * (height - 1) - y * half_t
    for epi, place in ((field.epi(t=round(down)), across), (field.epi(s=round(across)), down)):
        middle = np.nan_to_num(epi[..., 0]).sum(axis=0)
        assert (middle * np.arange(len(middle))).sum() / middle.sum() == pytest.approx(place, abs=0.1 * half_s)


FIELD_FORMATS = ("lftoolbox", "eslf", "hci", "views")


@pytest.mark.parametrize("kind", FIELD_FORMATS)
def test_exported_views_are_upright(bench: Camera, kind: Any, tmp_path: Path) -> None:
    lf.export_field(bench.field, tmp_path / "out", kind)
    rows, columns = bench.field.views
    v, u = rows // 2, columns // 2
    shown: list[NDArray[Any]]
    if kind == "lftoolbox":
        shown = [loadmat(tmp_path / "out" / "lightfield.mat")["LF"][v, u, ..., :3]]
    elif kind == "eslf":
        shown = [png16(tmp_path / "out" / "lightfield.eslf.png")[v::rows, u::columns]]
    elif kind == "hci":
        shown = [png(tmp_path / "out" / f"input_Cam{v * columns + u:03d}.png")]
    else:
        name = tmp_path / "out" / f"view_v{v:02d}_u{u:02d}.exr"
        shown = [exr.read(name, ("view", "stderr")).parts["view"], png(name.with_suffix(".png"))]
    for picture in shown:
        assert_upright(picture, in_views(bench))


@pytest.mark.filterwarnings("ignore:PlenoptiCam")
def test_exported_raw_pictures_and_centres_are_upright(bench: Camera, tmp_path: Path) -> None:
    calibration = bench.calibration
    lf.export_raw(bench.taken, bench.white, calibration, tmp_path / "p", "plenopticam")
    assert_upright(png(tmp_path / "p" / "raw.png"), on_sensor(bench))
    if calibration.layout == "hexagonal":
        lf.export_raw(bench.taken, bench.white, calibration, tmp_path / "q", "plenpy")
        assert_upright(png16(tmp_path / "q" / "Images" / "raw.png"), on_sensor(bench))
    # Where centres are said to be, the light of a white plane has its centres.
    white = png(tmp_path / "p" / "white.png").mean(axis=2)
    centres = json.loads((tmp_path / "p" / "centres.json").read_text())["mic_list"]
    offsets, last = [], (-1.0, -1.0, -1, -1)
    for row, column, t, s in centres:
        # Numbered from the top left: every next one further right, every next row further down.
        assert column > last[1] if t == last[2] else row > last[0]
        last = (row, column, t, s)
        if not (20.0 < row < 190.0 and 20.0 < column < 190.0):
            continue
        top, left = round(row) - 4, round(column) - 4
        light = white[top : top + 9, left : left + 9]
        j, i = np.indices(light.shape)
        middle = (light * j).sum() / light.sum() + top, (light * i).sum() / light.sum() + left
        offsets.append(np.hypot(middle[0] - row, middle[1] - column))
    assert len(offsets) > 150
    assert np.mean(offsets) < 0.7


def moved(pictures: list[NDArray[Any]]) -> tuple[float, float]:
    """Return by how much a spot moves from picture to picture, to the right and up, in pixels."""
    places = []
    for picture in pictures:
        light = np.nan_to_num(np.asarray(picture, np.float64)).reshape(*picture.shape[:2], -1).sum(axis=2)
        row, column = np.indices(light.shape)
        places.append(((light * column).sum() / light.sum(), -(light * row).sum() / light.sum()))
    step = np.polyfit(np.arange(len(places)), places, 1)[0]
    return float(step[0]), float(step[1])


def test_views_from_further_right_and_further_down_see_parallax(bench: Camera, tmp_path: Path) -> None:
    """From a viewpoint further right, what is nearer than the focus moves left; from further down it moves up.

    The viewpoints lie in the entrance pupil, a pixel seen from there apart; whether they are images of the exit pupil
    that are inverted (relay, remote stop) or not is nothing that an observer could see. By hand: to a viewpoint that
    moves by b, a point at depth z before the pupil moves by −b (f − z)/z in the plane in focus at f. Spherical
    aberration moves the focus of real rays a little, so that a near and a far point are compared with each other.
    """
    facts = lf.first_order(bench.scene)
    apart = {100.0: 1.05, 400.0: 1.8, 500.0: 1.25}[bench.focus_mm]
    model = lf.RayModel.of(bench.scene)
    step = model.pixel_mm / model.lenslet_to_sensor_mm * abs(model.pupil_to_array_mm)
    baseline = step * facts.entrance_pupil_diameter_mm / facts.exit_pupil_diameter_mm
    expected, across, down, disparities, across_hci, down_hci = [], [], [], [], [], []
    for name, distance in (("near", bench.focus_mm / apart), ("far", bench.focus_mm * apart)):
        field = lf.decode(bench.image(bench.disk(0.2, 0.1, distance, WIDE)), calibration=bench.calibration)
        focus, depth = bench.focus_mm + facts.entrance_pupil_z_mm, distance + facts.entrance_pupil_z_mm
        expected.append(-baseline * (focus - depth) / depth / bench.half_mm * in_views(bench)[1])
        middle = field.views[0] // 2
        views = range(middle - 2, middle + 3)
        across.append(moved([field.view(middle, u) for u in views]))
        down.append(moved([field.view(v, middle) for v in views]))
        # The benchmark's cameras, numbered row by row, see the same.
        folder, columns = tmp_path / name, field.views[1]
        lf.export_field(field, folder, "hci", depth_mm=np.full(field.size, distance))
        taken = {(v, u): png(folder / f"input_Cam{v * columns + u:03d}.png") for v in views for u in views}
        across_hci.append(moved([taken[middle, u] for u in views])[0])
        down_hci.append(moved([taken[v, middle] for v in views])[1])
        with PIL.Image.open(folder / "gt_disp_lowres.pfm") as file:
            disparities.append(float(np.asarray(file)[3, 4]))
    assert expected[0] < -0.1
    assert expected[1] > 0.1
    right, far_right = across
    up, far_up = down
    assert right[0] < 0.0 < far_right[0]
    # Viewpoints move down from view to view: what is near moves up.
    assert up[1] > 0.0 > far_up[1]
    between = expected[0] - expected[1]
    assert right[0] - far_right[0] == pytest.approx(between, rel=0.1)
    assert up[1] - far_up[1] == pytest.approx(-between, rel=0.1)
    for sideways in (right[1], far_right[1], up[0], far_up[0]):
        assert sideways == pytest.approx(0.0, abs=0.1 * abs(between))
    # Positive for what is nearer than the focus, which moves left in cameras further right, and up in lower ones.
    assert disparities[0] > 0.0 > disparities[1]
    assert np.diff(across_hci) == pytest.approx(-np.diff(disparities), rel=0.1)
    assert np.diff(down_hci) == pytest.approx(np.diff(disparities), rel=0.1)


def chart(distance_mm: float, x_mm: float, y_mm: float, width_mm: float) -> dict[str, Any]:
    """A glowing chart, whose texture may lie on it as it likes."""
    return {
        "shape": {"kind": "plane", "width_mm": width_mm, "height_mm": width_mm},
        "position_mm": (x_mm, y_mm, -distance_mm),
        "material": {
            "reflectance": 0.0,
            "radiance_w_m2_sr": 1.0,
            "texture": asset_path("charts/chart.png").as_posix(),
        },
    }


@pytest.mark.parametrize("kind", instances(["square", "relay"], long=["square"]))
def test_depth_is_upright(kind: str) -> None:
    """A near plane fills the upper right quarter (+x, +y); behind it stands one that fills the rest."""
    bench = made(kind)
    near, far = (430.0, 620.0) if kind == "square" else (96.0, 105.0)
    wide = bench.half_mm
    targets = (chart(near, 0.75 * wide, 0.75 * wide, 1.5 * wide), chart(far, 0.0, 0.0, 6.0 * wide))
    scene = bench.scene.changed({"targets": targets, "transport.samples": 16})
    field = lf.decode(lf.render(scene), white=lf.white_image(scene), views=4)
    truth = lf.depth_truth(scene, views=4, samples=2)
    found = lf.estimate_depth(field)
    sure = np.where(found.confidence > 0.3, found.distance_mm, np.nan)
    between = 0.5 * (near + far)
    for depth, agree in ((truth.middle_mm, 0.97), (truth.views_mm[2, 3], 0.9), (sure, 0.85)):
        height, width = depth.shape
        is_near = np.where(np.isfinite(depth), depth < between, np.nan)
        quarters = {
            "upper right": is_near[2 : height // 2 - 1, width // 2 + 2 : -2],
            "upper left": is_near[2 : height // 2 - 1, 2 : width // 2 - 1],
            "lower right": is_near[height // 2 + 2 : -2, width // 2 + 2 : -2],
            "lower left": is_near[height // 2 + 2 : -2, 2 : width // 2 - 1],
        }
        for name, quarter in quarters.items():
            assert np.isfinite(quarter).mean() > 0.2
            share = float(np.nanmean(quarter))
            assert share > agree if name == "upper right" else share < 1.0 - agree, (name, share)
    # Of the raw pixels the near ones lie where the lens images +x, +y to: towards −x, −y, or not inverted, +x, +y.
    raw = np.where(np.isfinite(truth.pixels_mm), truth.pixels_mm < between, 0.0)
    half = raw.shape[0] // 2
    sums = {(r, c): raw[r * half :][:half, c * half :][:, :half].sum() for r in (0, 1) for c in (0, 1)}
    assert max(sums, key=sums.__getitem__) == ((0, 0) if kind == "square" else (1, 1))
    assert max(sums.values()) > 0.8 * sum(sums.values())


def test_patches_of_a_focused_camera_are_upright(square: Camera) -> None:
    scene = lf.focused(square.scene, 3.0)
    targets = tuple(square.disk(x, y, square.focus_mm) for x, y in DISKS)
    image = lf.render(scene.changed({"targets": targets, "transport.method": "forward", "transport.samples": 4}))
    pictures = [lf.render_patches(image, 500.0), lf.patches_in_focus(image, [490.0, 500.0])]
    for picture in pictures:
        # Its array stands a little farther from the pupil than the image that it sees.
        assert_upright(picture.mean)


def test_a_conventional_cameras_picture_is_upright(square: Camera, tmp_path: Path) -> None:
    changes = {"camera.mla": None, "camera.sensor": {"pixels": (50, 50), "pixel_mm": 0.05}}
    scene = lf.solved(square.scene.changed(changes))
    targets = tuple(square.disk(x, y, square.focus_mm) for x, y in DISKS)
    image = lf.render(scene.changed({"targets": targets, "transport.method": "forward", "transport.samples": 64}))
    folder = lf.save(image, tmp_path / "run")
    assert_upright(png(folder / "preview.png"))
    assert_upright(png(folder / "linear16.png"))


def test_a_click_on_the_picture_is_the_pixel_whose_ray_meets_what_is_seen_there(bench: Camera, tmp_path: Path) -> None:
    """The pixel is asked where it looks: its ray through its lenslet, traced out of the camera, meets the disk."""
    sensor, calibration = bench.scene.camera.sensor, bench.calibration
    columns, rows = sensor.pixels
    folder = lf.save(bench.taken, tmp_path / "run")
    views = FieldViews(bench.taken, folder, calibration)
    picture = SensorPicture(columns, rows, views.upright, bench.taken, calibration)
    picture.zoom(0.5, 0.5, 1.2)
    half_rows, half_columns = on_sensor(bench)
    part = picture.part
    for x, y in DISKS:
        # The place of the disk, and the centre of the micro-image that is marked next to it.
        wanted = (0.5 * columns + x * half_columns - part.column, 0.5 * rows - y * half_rows - part.row)
        marks = picture.centres_shown() * [part.width, part.height]
        at = marks[np.hypot(*(marks - wanted).T).argmin()]
        assert np.hypot(*(at - wanted)) < 8.0
        row, column = picture.pixel(at[0] / part.width, at[1] / part.height)
        lenslet = np.unravel_index(
            np.hypot(*(calibration.centres_px.reshape(-1, 2) - (column, row)).T).argmin(), calibration.known.shape
        )
        rays = lf.object_rays(bench.scene, np.array([[lenslet[1], lenslet[0]]]), np.array([[column, row]]))
        (origin,), (direction,) = rays.origin, rays.direction
        met = origin + direction * (-bench.focus_mm - origin[2]) / direction[2]
        np.testing.assert_allclose(met[:2] / bench.half_mm, (x, y), atol=0.12)
        left, top, across, down = picture.box(range(row, row + 1), range(column, column + 1))
        assert left - 1e-9 <= at[0] / part.width <= left + across + 1e-9
        assert top - 1e-9 <= at[1] / part.height <= top + down + 1e-9
        place = views.place(row, column)
        assert place is not None
        along_t, along_s = in_views(bench)
        height, width = bench.field.size
        assert (place.s - 0.5 * (width - 1)) / along_s == pytest.approx(x, abs=0.12)
        assert -(place.t - 0.5 * (height - 1)) / along_t == pytest.approx(y, abs=0.12)


def test_the_picture_on_the_sensor_in_3d_lies_as_the_raw_image_does(bench: Camera, tmp_path: Path) -> None:
    """From a run it is the upright preview, turned back."""
    folder = lf.save(bench.taken, tmp_path / "run")
    shown = subject_of(folder).picture
    assert shown is not None
    power = bench.taken.mean[..., 0]
    lit = shown[..., 0] > 128
    assert power[lit].sum() > 0.5 * power.sum()
    assert lit.sum() < 0.3 * lit.size
