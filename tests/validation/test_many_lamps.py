"""Many lamps light a scene as few do: against an area lamp, against sums of few lamps, and forward against adjoint.

Sums of few lamps are the truth that knows no tree: up to eight lamps are all asked from each point. The forward method
has no part of the tree either.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from tests.instances import instances
from tests.renders import by_seed
from tests.transport.lights.test_many_lamps import PROFILE
from tests.validation.test_sized_lamps import CAMERA, PLACES, WALL, agree, watts

SCREEN = {"shape": {"kind": "plane", "width_mm": 30.0, "height_mm": 30.0}, "position_mm": [-18.0, 0.0, -50.0],
          "rotation_deg": [0.0, 90.0, 0.0], "material": {"reflectance": 0.0}}  # fmt: skip


SAMPLES = {"air": 512, "fog": 512, "glass": 16_384, "tank": 16_384}
"""Of adjoint pictures: light of lamps through glass has as many packets as these, which are noisier than others."""


def on_disk(count: int, centre: list[float], axis: list[float], radius: float) -> np.ndarray:
    """Return points that cover a disk evenly, (count, 3): a spiral by the golden angle."""
    n = np.array(axis) / np.linalg.norm(axis)
    x = np.cross(n, [0.0, 1.0, 0.0]) / np.linalg.norm(np.cross(n, [0.0, 1.0, 0.0]))
    r, phi = radius * np.sqrt((np.arange(count) + 0.5) / count), np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    return np.array(centre) + (r * np.cos(phi))[:, None] * x + (r * np.sin(phi))[:, None] * np.cross(n, x)


def crowd(count: int, seed: int) -> list[dict[str, Any]]:
    """Return lamps beside the camera, one of them a thousand times as bright; every fourth is behind the screen."""
    random = np.random.default_rng(seed)
    found: list[dict[str, Any]] = []
    for number in range(count):
        x, y, z = random.uniform(4.0, 16.0), random.uniform(-12.0, 12.0), random.uniform(-50.0, -30.0)
        place = [float(x if number % 4 else -22.0), float(y), float(z)]
        lamp = {"kind": "point", "position_mm": place, "power_w": float(random.uniform(0.5, 2.0))}
        if number % 4 == 2:
            lamp |= {"profile": "led.ies", "rotation_deg": [-70.0, 0.0, float(random.uniform(-50.0, 50.0))]}
        if number % 4 == 3:
            lamp |= {"kind": "disk", "direction": [-1.0, 0.2, -1.0], "radius_mm": 0.5}
        if number == count // 2 + 1:
            lamp["power_w"] *= 1000.0
        found.append(lamp)
    return found


@pytest.mark.filterwarnings("ignore::lfmesh.PictureWarning")
@pytest.mark.parametrize("count", instances([1_000, 10_000], long=[10_000]))
def test_lamps_that_cover_a_disk_light_as_the_disk_lamp(count: int) -> None:
    centre, axis, radius = [12.0, 3.0, -46.0], [-1.0, 0.0, -0.8], 8.0
    disk = {"kind": "disk", "position_mm": centre, "direction": axis, "radius_mm": radius, "power_w": 3.0}
    small = [
        {"kind": "disk", "position_mm": place, "direction": axis, "radius_mm": 0.01, "power_w": 3.0 / count}
        for place in on_disk(count, centre, axis, radius).tolist()
    ]
    agree(
        watts(1024, "adjoint", targets=[WALL], lights=[disk]),
        watts(1024, "adjoint", targets=[WALL], lights=small),
        0.02,
    )


def written(folder: Path) -> Path:
    (folder / "led.ies").write_text(PROFILE)
    return folder


@pytest.mark.filterwarnings("ignore::lfmesh.PictureWarning")
@pytest.mark.parametrize("place", instances(list(PLACES), long=["fog", "glass", "tank"]))
def test_many_lamps_light_as_the_sum_of_few_at_a_time(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(written(tmp_path))
    lights = crowd(24, 6)
    scene = PLACES[place] | {"targets": [*PLACES[place]["targets"], SCREEN]}
    parts = [watts(SAMPLES[place], "adjoint", lights=lights[i : i + 8], **scene) for i in range(0, 24, 8)]
    total = sum(part[0] for part in parts), float(np.sqrt(sum(part[1] ** 2 for part in parts)))
    agree(total, watts(SAMPLES[place], "adjoint", lights=lights, **scene), 0.03)


@pytest.mark.filterwarnings("ignore::lfmesh.PictureWarning")
@pytest.mark.parametrize("place", instances(list(PLACES), long=["fog", "glass", "tank"]))
def test_forward_equals_adjoint_with_many_lamps(place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(written(tmp_path))
    scene = PLACES[place] | {"targets": [*PLACES[place]["targets"], SCREEN], "lights": crowd(300, 7)}
    agree(watts(SAMPLES[place], "adjoint", **scene), watts(65_536, "forward", **scene), 0.03)


@pytest.mark.filterwarnings("ignore::lfmesh.PictureWarning")
@pytest.mark.long
def test_forward_equals_adjoint_where_the_brightest_of_a_thousand_lamps_is_hidden() -> None:
    """It stands behind the screen, has eight times the power of all others, and every point asks it."""
    lights = [lamp for lamp in crowd(1333, 9) if "profile" not in lamp]
    for lamp in lights:
        lamp["power_w"] = min(lamp["power_w"], 2.0)
    lights.append({"kind": "point", "position_mm": [-22.0, 0.0, -50.0], "power_w": 1e4})
    scene: dict[str, Any] = {"targets": [WALL, SCREEN], "lights": lights}
    agree(watts(512, "adjoint", **scene), watts(65_536, "forward", **scene), 0.03)


@pytest.mark.filterwarnings("ignore::lfmesh.PictureWarning")
def test_the_error_of_many_lamps_is_what_it_is_said_to_be() -> None:
    """In each quarter of the pixels by brightness, over 32 seeds: the spread over the reported error."""
    lights = [lamp | {"power_w": 1.0} for lamp in crowd(200, 3) if "profile" not in lamp]
    camera = CAMERA | {"sensor": {"pixels": [8, 8], "pixel_mm": 0.5}}
    settings = {"samples": 32, "replicates": 8, "split": "transmit"}
    scene = lf.Scene(camera=camera, targets=[WALL, SCREEN], lights=lights, transport=settings)
    found = [(image.mean[:, :, 0], image.stderr[:, :, 0]) for image in by_seed(scene, range(32))]
    means, errors = (np.array(each) for each in zip(*found, strict=True))
    spread, said = means.var(axis=0, ddof=1), (errors**2).mean(axis=0)
    order = np.argsort(means.mean(axis=0), axis=None)
    for quarter in np.split(order, 4):
        assert 0.8 < np.sqrt(spread.ravel()[quarter].sum() / said.ravel()[quarter].sum()) < 1.3
