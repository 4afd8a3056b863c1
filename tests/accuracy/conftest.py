"""A camera small enough to measure in seconds, and what the accuracy report says of it."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

import lfmesh as lf
from lfmesh.accuracy import lens_accuracy
from lfmesh.accuracy import report as accuracy
from lfmesh.accuracy.image_efficiency import ANALOG, QUICK, SPLITTING, WAYS
from lfmesh.accuracy.report import AccuracyReport

SCENE = """
schema_version = 1
name = "tiny camera <&>"
[camera]
focus_mm = 60.0
[camera.lens]
name = "biconvex"
surfaces = [
  { radius_mm = 20.0, thickness_mm = 3.0, index = 1.5, semi_diameter_mm = 5.0 },
  { radius_mm = -20.0, thickness_mm = 1.0, semi_diameter_mm = 5.0 },
  { stop = true, semi_diameter_mm = 4.0 },
]
[camera.mla]
count = [8, 8]
pitch_mm = 0.5
focal_length_mm = 2.6
index = 1.5
thickness_mm = 0.5
[camera.sensor]
pixels = [40, 40]
pixel_mm = 0.1
[[targets]]
shape = { kind = "plane", width_mm = 12.0, height_mm = 12.0 }
position_mm = [0.0, 0.0, -60.0]
material = { reflectance = 0.8 }
[[lights]]
kind = "point"
position_mm = [20.0, -15.0, -25.0]
power_w = 1.0
"""


@pytest.fixture(scope="session", autouse=True)
def _one_run_by_the_clock() -> Iterator[None]:
    """No test here is about speed or memory; to collect garbage before each row costs most where many tests ran."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lens_accuracy, "release_freed_memory", lambda: None)
        patch.setattr(lens_accuracy, "TIMED_RUNS", 1)
        patch.setattr(lens_accuracy, "TIMED_SECONDS", 0.0)
        yield


@pytest.fixture(scope="session")
def scene_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("accuracy") / "scene.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture(scope="session")
def report(scene_file: Path) -> AccuracyReport:
    """The quick report, with fewer samples of images."""
    samples = {way.name: (16, 64) if way in (ANALOG, SPLITTING) else (4, 8) for way in WAYS}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(accuracy, "QUICK", replace(QUICK, pixels=20, samples=samples, repeats=4, reference=1024))
        patch.setattr(accuracy, "QUICK_RAYS", 1 << 11)
        return accuracy.measure(lf.load(scene_file), quick=True)
