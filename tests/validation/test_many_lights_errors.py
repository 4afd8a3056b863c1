"""Many lights: both methods agree, and their errors are as they are said to be, in each quarter of the pixels.

One set of pictures for each scene serves both claims: `SEEDS` independent ones of 64 pixels by each method. A mean over
seeds has the error that seeds tell, whatever pictures report.

A quarter has 16 pixels, and so 16 · (SEEDS − 1) independent deviations. The ratio of true and reported error then has a
standard deviation of √((κ − 1) / (4 · 16 · SEEDS)), with the kurtosis κ of a pixel: 3 % of normal ones (κ = 3), 9 % of
pixels that few paths light (κ = 17). The bounds, 0.8 and 1.3, are 7 and 2.6 of these away. Seeds are fixed, so that a
test which passes does so always.
"""

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from tests.instances import instances
from tests.renders import by_seed
from tests.validation.test_many_emitters import near_and_far
from tests.validation.test_many_lamps import PROFILE, SCREEN, crowd, on_disk
from tests.validation.test_sized_lamps import CAMERA, PLACES, WALL

Array = NDArray[np.float64]

SEEDS = 32
LEVEL = 1e-4
"""Chance that two methods that agree are found to differ, in any pixel or in all together, in each scene."""

EYE = CAMERA | {"sensor": {"pixels": [8, 8], "pixel_mm": 0.5}}
BLOCK = {"refractor": {"box_mm": [6.0, 6.0, 6.0], "index": 1.5}, "position_mm": [-3.0, -1.0, -50.0],
         "rotation_deg": [25.0, 35.0, 0.0]}  # fmt: skip


def unequal(count: int) -> list[dict[str, Any]]:
    """Return lamps of equal power, a bright one, and one of eight times all power that the screen hides."""
    lights = [lamp for lamp in crowd(count * 4 // 3, 9) if "profile" not in lamp]
    for lamp in lights:
        lamp["power_w"] = min(lamp["power_w"], 2.0)
    bright = {"kind": "point", "position_mm": [9.0, 6.0, -45.0], "power_w": 1e3}
    return [*lights, bright, {"kind": "point", "position_mm": [-22.0, 0.0, -50.0], "power_w": 1e4}]


def leds(count: int) -> list[dict[str, Any]]:
    """Return a board of light-emitting diodes with a profile, each turned its own way."""
    places = on_disk(count, [14.0, 3.0, -44.0], [-1.0, 0.0, -0.8], 6.0).tolist()
    turns = np.random.default_rng(4).uniform(-25.0, 25.0, (count, 2))
    return [
        {"kind": "point", "position_mm": place, "power_w": 1.0, "profile": "led.ies",
         "rotation_deg": [60.0 + float(a), 0.0, -50.0 + float(b)]}
        for place, (a, b) in zip(places, turns, strict=True)
    ]  # fmt: skip


def sheet(folder: Path, side: int) -> dict[str, Any]:
    """Return a glowing sheet of 2 · side² facets, with a picture that is dark but for four small dots."""
    x = np.linspace(-12.0, 12.0, side + 1)
    vertices = np.stack(np.meshgrid(x, x, [0.0], indexing="ij"), -1).reshape(-1, 3)
    i = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    faces = np.concatenate([np.stack([i, i + side + 1, i + 1], 1), np.stack([i + 1, i + side + 1, i + side + 2], 1)])
    lines = [f"v {a:.9g} {b:.9g} 0\nvt {a / 24.0 + 0.5:.9g} {b / 24.0 + 0.5:.9g}" for a, b, _ in vertices]
    lines += ["f " + " ".join(f"{k}/{k}" for k in face) for face in (faces + 1).tolist()]
    (folder / "sheet.obj").write_text("\n".join(lines))
    picture = np.full((64, 64), 2, np.uint8)
    for row, column in ((5, 50), (30, 12), (31, 44), (57, 20)):
        picture[row : row + 2, column : column + 2] = 255
    PIL.Image.fromarray(picture).save(folder / "dots.png")
    return {"file": "sheet.obj", "units": "mm", "position_mm": [16.0, 0.0, -46.0], "rotation_deg": [0.0, -60.0, 0.0],
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 20.0, "texture": "dots.png"}}  # fmt: skip


def with_crowd(place: str, count: int = 300) -> dict[str, Any]:
    return PLACES[place] | {"targets": [*PLACES[place]["targets"], SCREEN], "lights": crowd(count, 7)}


def flames(count: int) -> list[dict[str, Any]]:
    """Return small flames beside the field, near to the wall and far from it."""
    random = np.random.default_rng(8)
    x, y, z = random.uniform(9.0, 16.0, count), random.uniform(-9.0, 9.0, count), -59.0 + random.exponential(4.0, count)
    return [
        {"bounds": {"kind": "sphere", "radius_mm": 0.4}, "position_mm": place, "emission_w_mm3_sr": 0.1}
        for place in np.column_stack([x, y, z]).tolist()
    ]


SCENES: dict[str, Any] = {
    "1,000 lamps on a disk": lambda _: {"targets": [WALL], "lights": [
        {"kind": "point", "position_mm": place, "power_w": 1e-3}
        for place in on_disk(1000, [12.0, 3.0, -46.0], [-1.0, 0.0, -0.8], 8.0).tolist()]},
    "a bright and a hidden one of 1,000": lambda _: {"targets": [WALL, SCREEN], "lights": unequal(1000)},
    "LEDs": lambda _: {"targets": [WALL], "lights": leds(200)},
    "fog": lambda _: with_crowd("fog"),
    "window": lambda _: with_crowd("glass"),
    "body of glass": lambda _: with_crowd("air") | {"targets": [WALL, BLOCK]},
    "tank": lambda _: with_crowd("tank"),
    "balls": lambda folder: {"targets": [WALL, *near_and_far(folder)[::2]]},
    "flames": lambda _: {"targets": [WALL], "media": flames(20)},
    "100,352 facets": lambda folder: {"targets": [WALL, sheet(folder, 224)]},
}  # fmt: skip

SAMPLES = {"window": 256, "body of glass": 256, "tank": 256}
"""Of a pixel by the adjoint method; light of lamps through glass has as many packets as these."""

FORWARD = 512
IN_SUITE = ["LEDs", "a bright and a hidden one of 1,000", "balls"]
NAMES = instances(SCENES, long=[name for name in SCENES if name not in IN_SUITE])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    made = tmp_path_factory.mktemp("many_lights")
    (made / "led.ies").write_text(PROFILE)
    yield made
    _pictures.cache_clear()


@cache
def _pictures(name: str, method: str, folder: Path) -> tuple[Array, Array]:
    """Return the means and the errors of pictures of one scene, (SEEDS, 8, 8)."""
    samples = SAMPLES.get(name, 32) if method == "adjoint" else FORWARD
    transport = {"method": method, "samples": samples, "replicates": 8, "split": "transmit"}
    scene = lf.Scene(camera=EYE, transport=transport, **SCENES[name](folder)).in_folder(folder)  # type: ignore[arg-type]
    images = [(image.mean[:, :, 0], image.stderr[:, :, 0]) for image in by_seed(scene, range(SEEDS))]
    means, errors = (np.array(each) for each in zip(*images, strict=True))
    return means, errors


@pytest.mark.filterwarnings("ignore::lfmesh.PictureWarning")
@pytest.mark.parametrize("name", NAMES)
def test_forward_equals_adjoint_with_many_lights(name: str, folder: Path) -> None:
    """Welch's test of the sum of all pixels, which is known to 3 %, and of each quadrant."""
    one, other = (_pictures(name, method, folder)[0] for method in ("adjoint", "forward"))
    for means in (one, other):
        total = means.sum(axis=(1, 2))
        assert stats.sem(total) < 0.03 * total.mean()
    quadrants = [np.kron(np.eye(4)[k].reshape(2, 2), np.ones((4, 4))) > 0.0 for k in range(4)]
    for group in [np.ones((8, 8), np.bool_), *quadrants]:
        assert stats.ttest_ind(one[:, group].sum(1), other[:, group].sum(1), equal_var=False).pvalue > LEVEL / 5.0


@pytest.mark.filterwarnings("ignore::lfmesh.PictureWarning")
@pytest.mark.parametrize("method", ["adjoint", "forward"])
@pytest.mark.parametrize("name", NAMES)
def test_the_error_of_many_lights_is_what_it_is_said_to_be(name: str, method: str, folder: Path) -> None:
    """The spread of seeds over the reported error, as the module says."""
    means, errors = _pictures(name, method, folder)
    spread, said = means.var(axis=0, ddof=1).ravel(), (errors**2).mean(axis=0).ravel()
    for quarter in np.split(np.argsort(means.mean(axis=0), axis=None), 4):
        assert 0.8 < np.sqrt(spread[quarter].sum() / said[quarter].sum()) < 1.3
