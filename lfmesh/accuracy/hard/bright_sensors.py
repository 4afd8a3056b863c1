"""Highly reflective sensors close behind plane faces of high index, so that ghosts dominate the image."""

from typing import Any

import numpy as np

from lfmesh.accuracy.hard.outcome import SINGLET, Outcome, case, lens_scene
from lfmesh.scene import Material, Plane, Scene, Target
from lfmesh.transport.render.render import render

REFLECTS, INDEX = 0.999, 4.0

CLOSE_MM = 1e-3
"""Thickness of a cover and of its gap, small enough that the pupil looks the same by every path."""

BEHIND_MM = 44.9
"""Distance from the lens to an array."""

GAP_MM = 0.1
"""Gap behind the array; if smaller, few rays through a lenslet would reach the opening."""

PASSES = np.arange(2000)
"""Passes between plate and sensor; further ones are below rounding."""


def _wall(stop_mm: float, changes: dict[str, Any], distance: float) -> Scene:
    """Return an evenly bright wall in front of a lens without reflections, and a mirror with pixels behind it."""
    wall = Target(
        shape=Plane(width_mm=2e3, height_mm=2e3), position_mm=(0.0, 0.0, -500.0),
        material=Material(reflectance=0.0, radiance_w_m2_sr=1.0),
    )  # fmt: skip
    bare = [
        surface.model_dump(exclude_unset=True) | {"coating": "clear", "semi_diameter_mm": stop_mm}
        for surface in SINGLET
    ]
    general = {
        "coatings": {"clear": {"reflectance": 0.0}},
        "camera.lens.surfaces": bare,
        "camera.sensor.reflectance": REFLECTS,
        "transport": {"samples": 256, "replicates": 16, "wavelengths_nm": [587.6]},
    }
    return lens_scene(SINGLET, sensor_mm=4.0, distance=distance, targets=(wall,)).changed(general | changes)


def _compared(scene: Scene, pupil: float | np.ndarray[Any, Any] = 1.0) -> Outcome:
    """Compare the light of all paths, over the image path's, with an incoherent plate in front of a mirror.

    Parameters
    ----------
    pupil : float or (PASSES,) float64
        Solid angle of the pupil after each number of passes between plate and sensor, over the image path's.
    """
    image = render(scene)
    path = render(scene.changed({"transport.split": "transmit", "transport.samples": 1024}))
    found = float(image.mean.sum() / path.mean.sum())
    errors = [np.sqrt((each.stderr**2).sum()) / each.mean.sum() for each in (image, path)]
    error = found * float(np.hypot(*errors))
    # The image path is refracted twice and detected at once.
    once = ((INDEX - 1.0) / (INDEX + 1.0)) ** 2
    through, back = (1.0 - once) / (1.0 + once), 2.0 * once / (1.0 + once)
    expected = through * float(((REFLECTS * back) ** PASSES * pupil).sum()) / (1.0 - once) ** 2
    return Outcome(
        "", f"{expected:.4f} times the image path", f"{found:.4f} ± {error:.4f}",
        abs(found - expected) < 4.0 * error and error < 0.02 * expected, 0.0, float(path.mean.sum()), 0,
    )  # fmt: skip


@case
def sensor_that_detects_a_thousandth() -> Outcome:
    """View a wall with a sensor of reflectance 0.999 behind a cover of index 4, through a small stop."""
    cover = {"thickness_mm": CLOSE_MM, "gap_mm": CLOSE_MM, "index": INDEX}
    return _compared(_wall(0.5, {"camera.sensor.cover": cover}, 45.0))


@case
def array_before_a_bright_sensor() -> Outcome:
    """View a wall with a sensor of reflectance 0.999 behind an array of index 4 with almost flat lenslets."""
    array = {
        "count": [60, 60], "pitch_mm": 0.1, "radius_mm": 1e6, "index": INDEX, "thickness_mm": 0.2 * GAP_MM,
        "distance_mm": BEHIND_MM,
    }  # fmt: skip
    farther = 1.0 + 2.0 * PASSES * GAP_MM / (BEHIND_MM + GAP_MM)
    return _compared(_wall(5.0, {"camera.mla": array}, GAP_MM), farther**-2)
