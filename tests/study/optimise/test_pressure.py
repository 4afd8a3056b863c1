"""Limits in force press on the merit as hard as the optimum asks, by multipliers of known size."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

import lfmesh as lf
from lfmesh.study.optimise.jet import Jet
from lfmesh.study.optimise.problem import Pressure

Array = NDArray[np.float64]

WISHED, LIMIT = np.array([3.0, 2.0, 1.0]), 2.0
"""Three places are wished for; the first may be `LIMIT` / 2 at most, and the first two together `LIMIT`."""


def excess_at(x: Array) -> Jet:
    """Return the excesses of both limits, and of one that is not in force."""
    rows = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    return Jet(rows @ x - np.array([0.5 * LIMIT, LIMIT, 9.0]), rows)


def test_multipliers_become_those_of_two_limits_in_force() -> None:
    """The optimum is (1, 1, 1); the merit's slopes, 2 (x − wished), are −2 λ: λ = (1, 1, 0)."""
    pressure = Pressure(1.0, np.zeros(3))
    place = np.zeros(3)
    for _ in range(60):
        now = pressure

        def pressed(x: Array, now: Pressure = now) -> Array:
            return np.concatenate([x - WISHED, now.residuals(excess_at(x)).value])

        place = least_squares(pressed, place, xtol=1e-14, ftol=1e-14, gtol=1e-14).x
        pressure = Pressure(pressure.stiffness, pressure.raised(excess_at(place).value))
    assert place == pytest.approx([1.0, 1.0, 1.0], abs=1e-6)
    assert pressure.multipliers == pytest.approx([1.0, 1.0, 0.0], abs=1e-6)


def test_a_camera_with_two_limits_in_force_is_the_best_that_keeps_them() -> None:
    """Two elements as thick as wished and the air between them, of which limits leave too little, in closed form."""
    scene = two_elements()
    found = lf.optimise(
        scene,
        [{"path": f"camera.lens.surfaces[{i}].thickness_mm", "range": [1.0, 12.0]} for i in range(3)],
        [{"metric": "centre_thickness_mm", "target": 8.0}, {"metric": "air_space_mm", "target": 6.0}],
        constraints=[{"metric": "total_length_mm", "most": 53.0}, {"metric": "air_space_mm", "least": 4.5}],
    )
    assert not any(each.missed for each in found.constraints)
    thickness = [surface.thickness_mm for surface in found.scene.camera.lens.surfaces[:3]]
    assert thickness == pytest.approx([4.25, 4.5, 4.25], rel=2e-5)


def test_a_step_to_a_camera_that_is_not_valid_is_shortened_where_limits_are_of_many_parts() -> None:
    """A face of less than 5 mm radius does not reach its rim; one limit is of two elements, one of a length."""
    found = lf.optimise(
        two_elements(),
        [{"path": "camera.lens.surfaces[0].radius_mm", "range": [2.0, 90.0]}],
        [{"metric": "efl_mm", "target": 5.0}],
        constraints=[{"metric": "centre_thickness_mm", "least": 2.0}, {"metric": "total_length_mm", "most": 60.0}],
    )
    assert found.merit_after < 0.01 * found.merit_before
    assert 5.0 < found.scene.camera.lens.surfaces[0].radius_mm < 6.0


def two_elements() -> lf.Scene:
    """Return two plano-convex lenses with a sensor 40 mm behind them."""
    curved = {"radius_mm": 60.0, "thickness_mm": 3.0, "index": 1.6, "semi_diameter_mm": 5.0}
    flat = {"thickness_mm": 2.0, "semi_diameter_mm": 5.0}
    surfaces = [curved | {"stop": True}, flat, curved, {"semi_diameter_mm": 5.0}]
    sensor = {"pixels": [100, 100], "pixel_mm": 0.05, "distance_mm": 40.0}
    return lf.Scene(camera={"lens": {"surfaces": surfaces}, "sensor": sensor})
