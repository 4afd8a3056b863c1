"""The truth of the accuracy report in gradient-index glass: closed forms, SciPy's integrator, and the tracer."""

from typing import Any

import mpmath as mp
import numpy as np
import pytest
from pydantic import TypeAdapter

import lfmesh as lf
from lfmesh.accuracy import analytic
from lfmesh.accuracy.analytic_gradients import GradientIndex, n2_of
from lfmesh.accuracy.lens_accuracy import LENS_ALONE, study_lens
from lfmesh.assets import asset_path
from lfmesh.errors import LfmeshError
from lfmesh.optics.gradients import fields_at, gradient_table
from lfmesh.scene.camera.gradient import AnyGradient
from tests.instances import instances
from tests.validation.gradient_truth import faces_of, follow
from tests.validation.test_gradient_lenses import ELEMENT, KINDS, SENSOR_MM, random_lens, rays_to, scene_of
from tests.validation.test_gradient_rays import DIGITS, MEDIA, NM, POINTS, SINES, plate

FEW_ROUNDINGS_MM = 5e-13

DISPERSION = {
    "reference_nm": 587.56,
    "strengths": [[-0.0683636, -0.0323639, -0.0286748], [0.931075, -0.0306245, -0.0392756]],
    "resonances_um2": [[0.00498103, 0.000410271, 2.44e-5], [110.0, 2.85988e-4]],
}
GRADIENTS: dict[str, dict[str, Any]] = {
    "radial_n2": {"kind": "radial_n2", "index": 1.6, "coefficients": [-0.09, 1e-3, 2e-4]},
    "radial_n": {
        "kind": "radial_n", "index": 1.7, "coefficients": [-0.03, 1e-3], "axial_coefficients": [0.01, -1e-3, 2e-4],
        "dispersion": DISPERSION,
    },
    "axial": {"kind": "axial", "index": 1.7, "coefficients": [0.02, -1e-3], "dispersion": DISPERSION},
    "spherical": {"kind": "spherical", "index": 1.6, "radius_mm": -9.0, "coefficients": [0.02, -1e-3]},
    "spherical about infinity": {
        "kind": "spherical", "index": 1.6, "radius_mm": float("inf"), "coefficients": [0.02, -1e-3]
    },
    "xyz": {
        "kind": "xyz", "index": 1.6, "x_coefficients": [0.01, -0.02], "y_coefficients": [-0.02, 0.0, 3e-3],
        "z_coefficients": [0.03, 1e-3],
    },
    "selfoc": {
        "kind": "selfoc", "index": [1.5477, 6.37e-3], "gradient_constant_per_mm": [0.4785, 7.157e-3, 3.749e-4]
    },
    "gradium": {
        "kind": "gradium", "coefficients": [1.7442713, -3.4052535e-2, 2.3409570e-1], "blank_mm": 12.1,
        "offset_mm": 5.0, "dispersion": DISPERSION,
    },
}  # fmt: skip


@pytest.mark.parametrize("name", GRADIENTS)
def test_the_index_of_every_kind_is_that_of_its_profile(name: str) -> None:
    """Two programs that share no code evaluate the formulas, n² and ½ ∇n²."""
    gradient: Any = TypeAdapter(AnyGradient).validate_python(GRADIENTS[name])
    at = np.random.default_rng(1).uniform([-1.0, -1.0, 0.0], [1.0, 1.0, 2.0], (50, 3))
    for wavelength_nm in (486.1, 656.3):
        fields = fields_at(gradient_table([gradient.profile(wavelength_nm)]), 0, at)
        n2 = n2_of(gradient, wavelength_nm, *(at.T + 0j)).real
        np.testing.assert_allclose(n2, fields[:, 0], rtol=1e-14)
        state = np.hstack([at, np.zeros((50, 3))])
        rates = GradientIndex(gradient, wavelength_nm)._rates(state)[:, 3:]
        np.testing.assert_allclose(rates, fields[:, 1:], rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("medium", MEDIA)
def test_truth_through_plates_lands_where_closed_forms_do(medium: str) -> None:
    gradient, law = MEDIA[medium]
    length, gap = 4.0, 3.0
    scene = plate(gradient, length)
    sines = 0.5 * SINES
    d = np.column_stack([sines, np.sqrt(1.0 - (sines**2).sum(axis=1))])
    origins = np.column_stack([POINTS, np.zeros(len(POINTS))]) - d
    landed = analytic.Camera.of(scene, NM).land(origins, d)
    assert landed.arrives.all()
    with mp.workdps(DIGITS):
        for at, start, sine in zip(landed.position, POINTS, sines, strict=True):
            end = law(*(mp.mpf(float(c)) for c in (*start, *sine)), mp.mpf(length))
            along = mp.sqrt(1 - end.tx**2 - end.ty**2)
            true = [float(end.x + gap * end.tx / along), float(end.y + gap * end.ty / along)]
            assert np.abs(at - true).max() < FEW_ROUNDINGS_MM
    claimed = analytic.own_error(scene, NM, origins, d)
    assert claimed is None or claimed < FEW_ROUNDINGS_MM


LENSES = 16


@pytest.mark.parametrize("number", instances(range(LENSES), long=range(4, LENSES)))
def test_truth_through_random_lenses_lands_where_an_integration_in_arc_length_does(number: int) -> None:
    draw = np.random.default_rng([9, number])
    surfaces, elements = random_lens(draw, KINDS[number % len(KINDS)])
    faces = faces_of(surfaces, elements)
    origins, d = rays_to(faces[0], draw, 1.0)
    landed = analytic.Camera.of(scene_of(surfaces, elements), NM).land(origins, d)
    compared, sensor_z = 0, sum(s.get("thickness_mm", 0.0) for s in surfaces) + SENSOR_MM
    for k, ray in enumerate(zip(origins, d, strict=True)):
        true = follow(faces, *ray)
        if true.passes and true.margin > 1e-6:
            at, along = true.points[-1], true.direction
            assert landed.arrives[k]
            on_sensor = at + (sensor_z - at[2]) / along[2] * along
            assert np.abs(landed.position[k] - on_sensor[:2]).max() < 1e-10
            assert landed.weight[k] == pytest.approx(true.weight, rel=1e-11)
            compared += 1
    assert compared >= 2


def test_arrays_without_a_truth_are_refused_by_their_key() -> None:
    scene = lf.load(asset_path("scenes/focused.toml")).changed(
        {
            "camera.mla.index": None, "camera.mla.glass": None, "camera.mla.focal_length_mm": None,
            "camera.mla.radius_mm": None, "camera.mla.gradient": GRADIENTS["radial_n2"],
        }
    )  # fmt: skip
    for key, value in (("walls", "clear"), ("form", {"decenter_mm": 1e-3}), ("back", {"radius_mm": 9.0})):
        with pytest.raises(LfmeshError, match=rf"camera\.mla\.{key}: the truth .* walls that absorb"):
            analytic.Camera.of(scene.changed({f"camera.mla.{key}": value}), NM)


def test_a_lens_with_a_gradient_is_measured_at_exact_surfaces_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfmesh.accuracy.lens_accuracy.TIMED_RUNS", 1)
    monkeypatch.setattr("lfmesh.accuracy.lens_accuracy.TIMED_SECONDS", 0.0)
    scene = scene_of(ELEMENT, []).changed({"camera.sensor.pixels": [40, 40], "camera.sensor.pixel_mm": 0.1})
    study = study_lens(scene.changed({"camera.focus_mm": 200.0, "camera.sensor.distance_mm": None}), rays=1 << 11)
    assert study.ways == (LENS_ALONE,)
    assert {row.surface for row in study.rows} == {"exact"}
    for row in study.rows:
        assert row.rays > 100
        assert row.max_mm <= 5e-9
        assert row.max_weight <= 1e-9
