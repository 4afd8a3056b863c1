"""The white scene: the same camera before a plane that it cannot see past, wherever it stands."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.lightfield.calibration.white import RADIANCE, white_scene
from lfmesh.scene import Scene

POSE = {"camera.pose": {"shift_mm": [40.0, 30.0, -20.0], "tilt_deg": [10.0, 20.0, 30.0]}}
FORM = {"camera.mla.form": {"decenter_mm": 0.002, "radius_error": 0.01, "seed": 3}}


def test_camera_and_effort_are_those_of_the_scene(camera: Callable[..., Scene]) -> None:
    scene = camera().changed({**POSE, **FORM, "transport.samples": 48, "transport.method": "forward"})
    white = white_scene(scene)
    assert white.camera == scene.camera
    assert white.transport.samples == 48
    # From the lights, a plane this large would light the sensor once in a million packets.
    assert white.transport.method == "adjoint"


@pytest.mark.parametrize("changes", [{}, POSE], ids=["in place", "moved and turned"])
def test_every_ray_out_of_the_camera_meets_the_plane(camera: Callable[..., Scene], changes: dict) -> None:
    """From all over the sensor through all of the pupil: whatever leaves the lens has met the plane."""
    scene = camera().changed(changes)
    rng = np.random.default_rng(0)
    lenslets = np.column_stack([rng.integers(0, 14, 2000), rng.integers(0, 12, 2000)])
    pixels = lf.calibrate(scene).centres_px[lenslets[:, 1], lenslets[:, 0]] + rng.uniform(-7.0, 7.0, (2000, 2))
    rays = lf.object_rays(scene, lenslets, pixels)
    out = np.isfinite(rays.origin[:, 0])
    assert 0.2 < out.mean() < 0.9
    paths = lf.trace(lf.build(white_scene(scene)), rays.origin[out] + rays.direction[out], rays.direction[out])
    assert set(paths.body) == {"white"}


def test_the_brightest_pixels_hold_what_their_lenslets_gather(camera: Callable[..., Scene]) -> None:
    """Power = radiance · pixel area · the solid angle of a lenslet from it, less what uncoated faces reflect.

    From the middle of the pupil, to 5 %: the cosines and the lenslet's aberration are left out.
    """
    scene = camera().changed({"transport.samples": 64})
    image = lf.white_image(scene)
    x, y = np.round(lf.calibrate(scene).centres_px[6, 7]).astype(int)
    seen = image.mean[y - 1 : y + 2, x - 1 : x + 2, 0].mean()
    gathered = RADIANCE * (0.0125e-3) ** 2 * (0.125 / 0.5) ** 2
    surfaces = image.scene.camera.lens.surfaces
    media = [1.0, *(s.index or 1.0 for s in surfaces), 1.5, 1.0]
    passed = np.prod([1.0 - ((a - b) / (a + b)) ** 2 for a, b in pairwise(media)])
    assert seen == pytest.approx(gathered * passed, rel=0.05)


def test_nothing_else_of_the_scene_shines_or_stands_before_the_camera(camera: Callable[..., Scene]) -> None:
    """A fog, particles or a tank would dim the white image, or shine in it; all who ask for the camera alone say so."""
    alone = camera().camera_alone()
    ball = {"kind": "sphere", "radius_mm": 9.0}
    sheet = {
        "point_mm": [0.0, 0.0, -400.0],
        "normal": [0.0, 0.0, 1.0],
        "direction": [1.0, 0.0, 0.0],
        "thickness_mm": 9.0,
        "width_mm": 9.0,
        "power_w": 1.0,
    }
    place = {"position_mm": [0.0, 0.0, -400.0]}
    full = alone.changed(
        {
            "targets": [{"shape": ball, **place}],
            "lights": [{"kind": "point", "position_mm": [0.0, 90.0, -90.0], "power_w": 1.0}],
            "media": [{"absorption_per_mm": 0.01, "emission_w_mm3_sr": 1e-6}],
            "particles": [{"count": 9, "bounds": ball, "diameter_um": 9.0, "sheet": sheet, **place}],
            "tanks": [{"size_mm": [60.0, 60.0, 60.0], "wall_mm": 2.0, "wall": {"index": 1.5}, "liquid": {"index": 1.3},
                       "position_mm": [0.0, 0.0, -100.0]}],
        }
    )  # fmt: skip
    assert full != alone
    assert full.camera_alone() == alone
    assert white_scene(full) == white_scene(alone)
