"""Phases and gratings of optiland's files."""

import json
import math
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfmesh.errors import SceneError
from lfmesh.imports.optiland_json import read
from lfmesh.imports.report import Verdict
from lfmesh.scene.camera.phase import GratingPhase, RadialPhase
from tests.imports.test_optiland_json import AIR, GLASS, LENS, surface


def with_phase(z: float, **profile: Any) -> dict[str, Any]:
    """Return a flat surface in air with a phase."""
    made = surface("Plane", z, math.inf)
    made["interaction_model"] |= {"type": "PhaseInteractionModel", "phase_profile": profile}
    return made


def with_grooves(z: float, kind: str = "PlaneGrating", radius: float = math.inf, **shape: Any) -> dict[str, Any]:
    """Return a grating in air."""
    made = surface(kind, z, radius, **{"order": -1.0, "period": 500.0, "angle": 0.0, **shape})
    made["interaction_model"]["type"] = "DiffractiveInteractionModel"
    return made


PHASES: dict[str, Any] = deepcopy(LENS)
PHASES["surface_group"]["surfaces"] = [
    surface("Plane", -math.inf, math.inf),
    surface("StandardGeometry", 0.0, 40.0, GLASS, stop=True, conic=0.0),
    surface("StandardGeometry", 4.0, -60.0, AIR, conic=0.0),
    with_phase(6.0, phase_type="radial", coefficients=[-1.5, 2e-3]),
    with_phase(8.0, phase_type="linear_grating", period=0.5, angle=math.pi / 3.0, order=2, efficiency=0.75),
    with_grooves(10.0, angle=math.pi / 6.0),
    with_phase(12.0, phase_type="constant", phase=1.25),
    surface("Plane", 50.0, math.inf),
]


def read_phases(change=lambda surfaces: None):
    data = deepcopy(PHASES)
    change(data["surface_group"]["surfaces"])
    return read(Path("lens.json"), json.dumps(data).splitlines())


def test_phases_and_gratings_are_taken():
    """optiland's k' = k + ∇φ, and p' = p + m λ/d with grooves at an angle from x."""
    lens, report = read_phases()
    radial, linear, grooves = (each.phase for each in lens.surfaces[2:])
    assert isinstance(radial, RadialPhase)
    assert (radial.coefficients_rad, radial.radius_mm, radial.main_order) == ((-1.5, 2e-3), 1.0, 1)
    assert isinstance(linear, GratingPhase)
    assert (linear.lines_per_mm, linear.main_order, linear.efficiency) == (2.0, 2, 0.75)
    angle = math.pi / 3.0
    np.testing.assert_allclose(linear.gradient_rad_mm, 4.0 * math.pi * np.array([math.cos(angle), math.sin(angle)]))
    assert (grooves.lines_per_mm, grooves.main_order) == (2.0, -1)
    angle = math.pi / 6.0
    np.testing.assert_allclose(grooves.gradient_rad_mm, 4.0 * math.pi * np.array([-math.sin(angle), math.cos(angle)]))
    # The plane with a constant phase has no effect.
    assert len(lens.surfaces) == 5
    assert "phases: 3, of surfaces 2 (radial), 3 (grating), 4 (grating)" in report.notes
    assert not report.of(Verdict.UNKNOWN)


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (with_phase(6.0, phase_type="grid", x_coords=[0, 1], y_coords=[0, 1]), "a phase_profile grid is not read"),
        (with_phase(6.0, phase_type="height_profile"), "a phase_profile height_profile is not read"),
        (with_phase(6.0, phase_type="vortex"), "a phase_profile of type vortex is not read"),
        (with_phase(6.0), "a phase_profile of type None is not read"),
        (with_phase(6.0, phase_type="radial"), "coefficients must be a list"),
        (with_phase(6.0, phase_type="radial", coefficients=[1.0, "2"]), "coefficient must be a number"),
        (with_phase(6.0, phase_type="radial", coefficients=[math.nan]), "must be 1e+15 or less"),
        (with_phase(6.0, phase_type="radial", coefficients=[10**400]), "must be 1e+15 or less"),
        (with_phase(6.0, phase_type="linear_grating", angle=0.0), "period must be a number"),
        (with_phase(6.0, phase_type="linear_grating", period=0.0), "period = 0 must be above 0"),
        (with_phase(6.0, phase_type="linear_grating", period=1.0, order=0.5), "order must be a whole number"),
        (with_phase(6.0, phase_type="linear_grating", period=1.0, efficiency=1.5), "efficiency = 1.5 must lie"),
        (with_grooves(6.0, "StandardGratingGeometry", 30.0), "a curved grating is not read"),
        (with_grooves(6.0, period=-1.0), "period = -1 must be above 0"),
        (with_grooves(6.0, radius=10**400), "exceeds the range of numbers"),
    ],
)
def test_a_phase_that_cannot_be_read_is_one_line(made, said):
    with pytest.raises(SceneError) as raised:
        read_phases(lambda surfaces: surfaces.__setitem__(3, made))
    assert str(raised.value).startswith("lens.json: surfaces[3]: ")
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)


def test_thousands_of_terms_are_one_line():
    with pytest.raises(SceneError) as raised:
        read_phases(
            lambda surfaces: surfaces.__setitem__(3, with_phase(6.0, phase_type="radial", coefficients=[1.0] * 5000))
        )
    assert "\n" not in str(raised.value)
    assert len(str(raised.value)) < 300


def test_a_phase_that_reflects_is_refused():
    def reflect(surfaces):
        surfaces[3]["interaction_model"]["is_reflective"] = True

    with pytest.raises(SceneError, match="mirrors are not supported"):
        read_phases(reflect)
