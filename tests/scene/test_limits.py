"""Scene files that no camera needs are refused in bounded messages: huge numbers, deep nesting, impossible names."""

import math
import re

import pytest

from lfmesh.errors import SceneError
from lfmesh.geometry.surfaces.surface import MAX_ASPHERE_TERMS
from lfmesh.scene import MicrolensArray, loads
from lfmesh.scene.camera.qcon import MOST_ASPHERE_TERMS
from lfmesh.scene.first_order.compute import first_order
from lfmesh.scene.model import MOST_FAULTS
from tests.cameras import bench_camera

SCENE = bench_camera(4, 4)
TEXTURE = '[[targets]]\nshape = {{ kind = "disk", radius_mm = 1.0 }}\n[targets.material]\ntexture = {}\n'

REFUSED = {
    "an integer of 4000 digits": (SCENE.replace("[4, 4]", f"[{'9' * 4000}, 4]"), "camera.mla.count[0] = an integer of"),
    "an integer of 9000 digits": (SCENE.replace("[4, 4]", f"[{'9' * 9000}, 4]"), "thousands of digits"),
    "a hexadecimal integer": (SCENE.replace("[4, 4]", f"[0x{'f' * 9000}, 4]"), "about 10837 digits"),
    "nested lists": (SCENE.replace("[4, 4]", "[" * 5000 + "]" * 5000), "nested too deeply"),
    "nested tables": (SCENE.replace("[4, 4]", f"[{{ {'a.' * 3000}b = 1 }}, 4]"), "nested too deeply"),
    "a file name with NUL": (SCENE + TEXTURE.format('"a\\u0000b.png"'), "not contain a NUL character"),
    "a lens file's name with NUL": (
        re.sub(r"surfaces = \[.*?\n\]", 'file = "a\\\\u0000b.toml"', SCENE, flags=re.DOTALL),
        "not contain a NUL character",
    ),
    "a file name of 300 characters": (SCENE + TEXTURE.format(f'"{"n" * 300}"'), "name too long"),
    "a lens file's name of 300 characters": (
        re.sub(r"surfaces = \[.*?\n\]", f'file = "{"n" * 300}"', SCENE, flags=re.DOTALL),
        "name too long",
    ),
    "a huge focal length": (SCENE.replace("0.7", "1e200"), "camera.mla.focal_length_mm[0] = 1e+200: must be"),
    "a huge pixel": (SCENE.replace("0.0125", "1e300"), "camera.sensor.pixel_mm = 1e+300: must be"),
    "a vanishing pixel": (SCENE.replace("0.0125", "1e-300"), "camera.sensor.pixel_mm = 1e-300: must be"),
    "a huge asphere": (
        SCENE.replace("radius_mm = 50.0", "radius_mm = 50.0, asphere_mm = [0.0, 1e200]"),
        "camera.lens.surfaces[1].asphere_mm[1] = 1e+200: times r^6",
    ),
    "too many asphere terms": (
        SCENE.replace("radius_mm = 50.0", f"radius_mm = 50.0, asphere_mm = {[0.0] * (MOST_ASPHERE_TERMS + 1)}"),
        f"may have at most {MOST_ASPHERE_TERMS} entries",
    ),
    "too many replicates": (SCENE + "[transport]\nreplicates = 100000000", "must be 10,000 or less"),
    "a wavelength below zero, and no other": (SCENE + "[transport]\nwavelengths_nm = [-500.0]", "must be 100 or more"),
    "too many threads": (SCENE + "[transport]\nthreads = 1000000000", "must be 1024 or less"),
}


@pytest.mark.parametrize(("text", "reason"), REFUSED.values(), ids=REFUSED)
def test_what_no_camera_needs_is_refused(text: str, reason: str) -> None:
    assert text != SCENE
    with pytest.raises(SceneError) as refusal:
        loads(text)
    message = str(refusal.value)
    assert reason.lower() in message.lower()
    assert len(message.splitlines()) == 1
    assert "\0" not in message


def test_a_scene_holds_as_many_terms_of_an_asphere_as_are_traced() -> None:
    assert MOST_ASPHERE_TERMS == MAX_ASPHERE_TERMS
    terms = [0.0] * (MOST_ASPHERE_TERMS - 1) + [1e-30]
    scene = loads(SCENE.replace("radius_mm = 50.0", f"radius_mm = 50.0, asphere_mm = {terms}"))
    assert len(scene.camera.lens.surfaces[1].asphere_mm) == MOST_ASPHERE_TERMS


def test_of_many_faults_the_first_are_listed_and_the_others_counted() -> None:
    with pytest.raises(SceneError) as refusal:
        loads(SCENE + "".join(f"wrong_{number} = 1\n" for number in range(1000)))
    first, *listed, last = str(refusal.value).splitlines()
    assert "1000 faults" in first
    assert len(listed) == MOST_FAULTS
    assert last.strip() == f"and {1000 - MOST_FAULTS} more"
    with pytest.raises(SceneError, match=f"and {51 - MOST_FAULTS} more"):
        MicrolensArray(**{f"wrong_{number}": 1 for number in range(48)})


def test_a_key_of_any_length_takes_one_short_line() -> None:
    with pytest.raises(SceneError) as refusal:
        loads(f'{SCENE}"{"k" * 10_000}\\n" = 1\n')
    assert len(str(refusal.value)) < 1000
    assert len(str(refusal.value).splitlines()) == 1


RELAYED_STOP = """
schema_version = 1
[camera.lens]
surfaces = [
  { stop = true, thickness_mm = 63.0, semi_diameter_mm = 1.0 },
  { thickness_mm = 2.0, index = 2.0, semi_diameter_mm = 8.0 },
  { radius_mm = -32.0, semi_diameter_mm = 8.0 },
]
[camera.mla]
distance_mm = DISTANCE
count = [4, 4]
pitch_mm = 0.125
focal_length_mm = 1.0
index = 2.0
thickness_mm = 0.5
[camera.sensor]
distance_mm = 0.75
pixels = [32, 32]
pixel_mm = 0.015625
"""
"""A lens of f = 32 mm with its stop 2 f before it, so that the exit pupil stands 64 mm behind; every number is a sum of
powers of two, so that differences are exact."""


@pytest.mark.parametrize(
    ("distance_mm", "pitch_px"),
    [(64.0, math.inf), (63.0, 0.0), (56.0, 7.0)],
    ids=["apexes in the pupil", "sensor in the pupil", "refocusing to the pupil"],
)
def test_an_array_round_the_exit_pupil_is_reported_on(distance_mm: float, pitch_px: float) -> None:
    """There a distance or pitch is 0 by which other figures are divided."""
    report = first_order(loads(RELAYED_STOP.replace("DISTANCE", str(distance_mm))))
    assert report.exit_pupil_z_mm == 129.0
    assert report.micro_image_pitch_px == pytest.approx(pitch_px)
    assert report.lines()
    assert any("micro-images coincide" in warning for warning in report.warnings) == (pitch_px <= 0)
