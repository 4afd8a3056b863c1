"""Sensors that reflect nearly all light, close behind plane faces of high index: most of the picture is ghosts."""

from typing import Any

import numpy as np

from lfmesh.accuracy.hard.outcome import SINGLET, Outcome, case, lens_scene
from lfmesh.scene import Material, Plane, Scene, Target
from lfmesh.transport.render.render import render

REFLECTS, INDEX = 0.999, 4.0

CLOSE_MM = 1e-3
"""Thickness of a cover and of its gap through which the pupil looks as large by every path."""

BEHIND_MM = 44.9
"""From the lens to an array."""

GAP_MM = 0.1
"""Behind it; nearer, few rays through a lenslet would come to the opening."""

PASSES = np.arange(2000)
"""Between plate and sensor; light that passes more often is below rounding."""


def _wall(stop_mm: float, changes: dict[str, Any], distance: float) -> Scene:
    """Return an evenly bright wall before a lens that reflects nothing, and a mirror with pixels behind it."""
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
    """Compare what all paths bring over the image path with an incoherent plate before a mirror.

    Parameters
    ----------
    pupil : float or (PASSES,) float64
        Solid angle of the pupil after so many passes between plate and sensor, over that by the image path.
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
    """See a wall by a sensor that reflects 0.999 behind a cover of germanium's index, through a small stop."""
    cover = {"thickness_mm": CLOSE_MM, "gap_mm": CLOSE_MM, "index": INDEX}
    return _compared(_wall(0.5, {"camera.sensor.cover": cover}, 45.0))


@case
def array_before_a_bright_sensor() -> Outcome:
    """See a wall by a sensor that reflects 0.999 behind an array of germanium's index, its lenslets all but flat."""
    array = {
        "count": [60, 60], "pitch_mm": 0.1, "radius_mm": 1e6, "index": INDEX, "thickness_mm": 0.2 * GAP_MM,
        "distance_mm": BEHIND_MM,
    }  # fmt: skip
    farther = 1.0 + 2.0 * PASSES * GAP_MM / (BEHIND_MM + GAP_MM)
    return _compared(_wall(5.0, {"camera.mla": array}, GAP_MM), farther**-2)
