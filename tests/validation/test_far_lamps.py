"""Lamps far beyond everything else, where single precision is coarser than the camera, in the forward method.

The adjoint method asks each lamp from the sheet that it lights, in double precision: it is the truth here.
"""

import numpy as np
import pytest

from tests.instances import instances
from tests.validation.test_rough_camera import agree, scene

MATT = {"reflectance": 0.9, "radiance_w_m2_sr": 0.0}


@pytest.mark.parametrize("distance_mm", instances([1e7, 1e9, 1e11], long=[1e7, 1e9]))
def test_a_far_lamp_beside_a_near_one_lights_a_sheet_alike_in_both_methods(distance_mm: float) -> None:
    """Forward, lamps share the packets by their power towards the targets; adjoint, each is asked from the sheet."""
    near = {"kind": "point", "position_mm": (6.0, 4.0, -14.0), "power_w": 5e-7}
    place = tuple(float(x) for x in np.array([0.5, 0.0, -20.0]) + distance_mm * np.array([0.6, 0.0, 0.8]))
    far = {"kind": "point", "position_mm": place, "power_w": 4e-3 * np.pi * (1e-3 * distance_mm) ** 2}
    given = scene({"targets[0].material": MATT, "lights": [near, far]}, samples=2048, replicates=32)
    agree(given, given.changed({"transport.method": "forward"}))


def test_a_far_lamps_light_is_absorbed_all_the_way() -> None:
    """In a medium without bounds, which ends at the lens: two metres of it, most of them beyond everything else."""
    lamp = {"kind": "point", "position_mm": (2000.0, 0.0, 15.0), "power_w": 1.0}
    dim = {"absorption_per_mm": 0.0005}
    changes = {"targets[0].material": MATT, "targets[0].rotation_deg": (0.0, 40.0, 0.0), "media": [dim]}
    given = scene(changes | {"lights": [lamp]}, samples=2048, replicates=32)
    agree(given, given.changed({"transport.method": "forward"}))
