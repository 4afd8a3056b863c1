"""Decoded and refocused, a plenoptic camera's image is a conventional camera's; and everything has the right sign."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image as Picture

import lfmesh as lf
from lfmesh.assets import asset_path

Array = NDArray[np.float64]

LEAST_NCC = 0.98
FINEST = 4.0

LENS = {"file": asset_path("lenses/double_gauss_50mm.toml").as_posix(), "stop_semi_diameter_mm": 4.77}


def camera(layout: str = "square", columns: int = 40, rows: int = 40, **transport: Any) -> lf.Scene:
    """The default camera, f/4 and focused on 500 mm, with fewer lenslets."""
    array = {"layout": layout, "count": (columns, rows), "pitch_mm": 0.125, "focal_length_mm": 0.5}
    return lf.solved(
        lf.Scene(
            camera={
                "focus_mm": 500.0,
                "lens": LENS,
                "mla": {**array, "index": 1.5, "thickness_mm": 0.3},
                "sensor": {"pixels": (10 * columns + 10, 10 * rows + 10), "pixel_mm": 0.0125},
            },
            transport={"split": "transmit", "samples": 8, "replicates": 2, "threads": 2, **transport},
        )
    )


@pytest.fixture(scope="module")
def texture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A random pattern whose finest waves are FINEST lenslets long: what the array can sample."""
    side, waves = 256, 40.0 / FINEST
    spectrum = np.fft.fft2(np.random.default_rng(5).normal(size=(side, side)))
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(side, 1 / side), np.fft.fftfreq(side, 1 / side)))
    pattern = np.fft.ifft2(np.where(frequency < waves, spectrum, 0.0)).real
    path = tmp_path_factory.mktemp("texture") / "pattern.png"
    levels = np.clip(127.5 + 50.0 * pattern / pattern.std(), 0.0, 255.0)
    Picture.fromarray(levels.astype(np.uint8)).save(path)
    return path


def chart(texture: Path, distance_mm: float) -> dict[str, Any]:
    """A glowing pattern that fills the field: 40 lenslets wide."""
    width = 47.0 * distance_mm / 500.0
    return {
        "shape": {"kind": "plane", "width_mm": width, "height_mm": width},
        "position_mm": (0.0, 0.0, -distance_mm),
        "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0, "texture": texture.as_posix()},
    }


def conventional(scene: lf.Scene, distance_mm: float, pixel_mm: float, pixels: tuple[int, int]) -> Array:
    """What the same lens takes without the array, focused on the plane itself; upright."""
    image = lf.render(
        scene.changed(
            {
                "camera.mla": None,
                "camera.focus_mm": distance_mm,
                "camera.sensor": {"pixels": pixels, "pixel_mm": pixel_mm},
                "transport.samples": 256,
            }
        )
    )
    return image.mean[:, ::-1, 0]


def ncc(one: Array, other: Array) -> float:
    """Normalised cross-correlation of the centre halves."""
    height, width = one.shape
    middle = np.s_[height // 4 : height - height // 4, width // 4 : width - width // 4]
    a, b = one[middle] - one[middle].mean(), other[middle] - other[middle].mean()
    return float((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()))


@pytest.mark.parametrize("distance_mm", [350.0, pytest.param(900.0, marks=pytest.mark.long)])
@pytest.mark.parametrize(("layout", "rows"), [("square", 40), pytest.param("hexagonal", 46, marks=pytest.mark.long)])
def test_refocused_on_a_chart_the_picture_is_a_conventional_cameras(
    texture: Path, layout: str, rows: int, distance_mm: float
) -> None:
    """And a photograph of the plane that the camera was focused on is not: the test is of the refocusing."""
    scene = camera(layout, rows=rows).changed({"targets": [chart(texture, distance_mm)]})
    field = lf.decode(lf.render(scene), white=lf.white_image(scene))
    photograph = lf.refocus(field, distance_mm)
    # Pixels that see as much of the plane as a sample of the photograph does.
    model = field.model
    enlarged = 1.0 + model.image_excess_mm(distance_mm) / model.pupil_to_array_mm
    height, width = field.size
    taken = conventional(scene, distance_mm, field.spacing_mm[1] * enlarged, (width, height))
    assert ncc(photograph.mean[..., 0], taken) > LEAST_NCC
    assert ncc(lf.refocus(field, distance_mm, method="fourier").mean[..., 0], taken) > LEAST_NCC
    assert ncc(lf.refocus(field, 500.0).mean[..., 0], taken) < 0.9


def spot(distance_mm: float, place_mm: tuple[float, float]) -> lf.LightField:
    """The light field of a small glowing disk."""
    target = {
        "shape": {"kind": "disk", "radius_mm": 0.8},
        "position_mm": (*place_mm, -distance_mm),
        "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
    }
    scene = camera(columns=24, rows=24, method="forward", samples=2)
    return lf.decode(lf.render(scene.changed({"targets": [target]})))


def centroid(view: Array, axis: int) -> float:
    light = np.nan_to_num(view[..., 0]).sum(axis=1 - axis)
    return float((light * np.arange(len(light))).sum() / light.sum())


def test_views_stand_upright_and_unmirrored() -> None:
    """A spot at +x, −y lies right of the middle and below it, as in the previews."""
    view = spot(500.0, (6.0, -4.0)).view(5, 5)
    assert centroid(view, 1) > 11.5 + 3.0
    assert centroid(view, 0) > 11.5 + 2.0


@pytest.mark.parametrize(("distance_mm", "sign"), [(380.0, -1.0), (700.0, 1.0)], ids=["near", "far"])
def test_views_epis_and_refocusing_have_the_right_sign(distance_mm: float, sign: float) -> None:
    """Seen from further right (larger u), what is nearer than the focus moves left, what is farther moves right; and
    from further down (larger v), up and down.

    By the ray model's shift, to a twentieth of a sample a view; and the photograph is sharpest on the spot's own side.
    """
    field = spot(distance_mm, (0.0, 0.0))
    views = range(2, 8)
    across = np.polyfit(views, [centroid(field.view(5, u), 1) for u in views], 1)[0]
    down = np.polyfit(views, [centroid(field.view(v, 4), 0) for v in views], 1)[0]
    expected = -field.model.shift_mm(distance_mm) / field.spacing_mm[1]
    assert np.sign(expected) == sign
    assert across == pytest.approx(expected, abs=0.05)
    assert down == pytest.approx(expected, abs=0.05)
    # An EPI's line leans the same way: row u of epi(t=...) is a row of view u.
    row = round(centroid(field.view(5, 5), 0))
    epi = field.epi(t=row, v=5)[2:8, :, 0]
    lines = (epi * np.arange(epi.shape[1])).sum(axis=1) / epi.sum(axis=1)
    assert np.polyfit(views, lines, 1)[0] == pytest.approx(expected, abs=0.1)
    peaks = {d: float(np.nanmax(lf.refocus(field, d).mean)) for d in (380.0, 500.0, 700.0)}
    assert max(peaks, key=peaks.__getitem__) == distance_mm
