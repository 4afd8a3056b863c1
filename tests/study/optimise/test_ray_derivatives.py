"""Derivatives of rays are those of differences, and rays are those of the sequential engine."""

import math
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.study.optimise.design_file import DesignFile
from lfmesh.study.optimise.jet import Jet
from lfmesh.study.optimise.problem import Place, Problem
from lfmesh.waves.bundle import LensRays
from tests.study.optimise.designs import TRIPLET_MM, camera, lens_variables

WAVES_NM = [500.0, 550.0, 600.0]
GLASS = {"nd": 1.6, "vd": 50.0}
PARALLEL = {"object_mm": math.inf, "across": 6}


def variable(path: str, low: float, high: float) -> dict[str, Any]:
    return {"path": f"camera.{path}", "range": [low, high]}


def asphere(**surface: Any) -> lf.Scene:
    """An aspheric singlet of f/2.5, a little out of focus."""
    first = {"radius_mm": 30.0, "thickness_mm": 8.0, "glass": GLASS, "semi_diameter_mm": 10.0, "stop": True, **surface}
    return lf.Scene(
        camera={
            "focus_mm": 400.0,
            "lens": {"surfaces": [first, {"radius_mm": -300.0, "semi_diameter_mm": 10.0}]},
            "sensor": {"pixels": [100, 100], "pixel_mm": 0.05},
        },
        transport={"wavelengths_nm": WAVES_NM},
    )


POSE = {"tilt_deg": [0.3, 0.2, 0.0], "shift_mm": [0.02, 0.1, 0.0]}
THIN_LENS = {"paraxial": True, "focal_length_mm": 60.0, "thickness_mm": 5.0, "semi_diameter_mm": 15.0}
RADIAL = {"kind": "radial", "coefficients_rad": [-90.0, 3.0], "radius_mm": 10.0, "order": 2}
METALENS = {"kind": "metalens", "focal_length_mm": 400.0, "design_nm": 550.0}
HOLOGRAM = {
    "kind": "hologram",
    "construction_nm": 500.0,
    "point_1_mm": [0.0, 0.0, -900.0],
    "point_2_mm": [0.0, 0.0, 300.0],
    "point_2": "virtual",
}
SELFOC = {"kind": "selfoc", "index": [1.58, 0.008], "gradient_constant_per_mm": [0.02, 0.001, 0.0]}
DISPERSIVE = {
    "kind": "radial_n",
    "index": 1.6,
    "coefficients": [-4e-4, 1e-6],
    "axial_coefficients": [0.004],
    "dispersion": {"reference_nm": 550.0, "strengths": [[1.1, 0.1]], "resonances_um2": [[0.012]]},
}
SURFACE = "lens.surfaces[0]"
CASES: dict[str, tuple[lf.Scene, list[dict[str, Any]], dict[str, Any]]] = {
    "spheres": (
        camera("cooke_triplet_50mm", 42.4),
        lens_variables(camera("cooke_triplet_50mm", 42.4), (0, 1, 2, 3, 4)),
        {**PARALLEL, "height_mm": TRIPLET_MM},
    ),
    "conic and aspheric terms": (
        asphere(conic=-0.6, asphere_mm=[2e-6, 1e-9], odd_asphere_mm=[1e-6]),
        [
            variable(f"{SURFACE}.conic", -1.5, 0.5),
            variable(f"{SURFACE}.asphere_mm[0]", -1e-5, 1e-5),
            variable(f"{SURFACE}.asphere_mm[1]", -1e-8, 1e-8),
            variable(f"{SURFACE}.odd_asphere_mm[0]", -1e-5, 1e-5),
            variable(f"{SURFACE}.radius_mm", 20.0, 50.0),
            variable(f"{SURFACE}.thickness_mm", 5.0, 12.0),
            variable(f"{SURFACE}.glass.nd", 1.5, 1.7),
            variable("focus_mm", 200.0, 900.0),
        ],
        {"across": 6},
    ),
    "water before the lens": (
        asphere(radius_mm=15.0).changed({"camera.object_medium": {"index": 1.333}}),
        [
            variable(f"{SURFACE}.radius_mm", 12.0, 20.0),
            variable("object_medium.index", 1.2, 1.4),
            variable("focus_mm", 200.0, 900.0),
        ],
        {"across": 6},
    ),
    "strong asphere of Forbes": (
        asphere(qcon={"norm_radius_mm": 10.0, "coefficients_mm": [0.05, -0.01]}),
        [variable(f"{SURFACE}.qcon.coefficients_mm[0]", -0.2, 0.2), variable(f"{SURFACE}.radius_mm", 20.0, 50.0)],
        {"across": 6},
    ),
    "radial phase and metalens": (
        asphere(conic=-0.6, phase=RADIAL).changed({"camera.lens.surfaces[1].phase": METALENS}),
        [
            variable(f"{SURFACE}.phase.coefficients_rad[0]", -200.0, 0.0),
            variable(f"{SURFACE}.phase.coefficients_rad[1]", -20.0, 20.0),
            variable(f"{SURFACE}.phase.radius_mm", 8.0, 12.0),
            variable("lens.surfaces[1].phase.focal_length_mm", 200.0, 600.0),
            variable(f"{SURFACE}.radius_mm", 20.0, 50.0),
            variable(f"{SURFACE}.glass.nd", 1.5, 1.7),
        ],
        {"across": 6},
    ),
    "hologram": (
        asphere(phase=HOLOGRAM),
        [variable(f"{SURFACE}.phase.point_2_mm[2]", 200.0, 600.0), variable(f"{SURFACE}.thickness_mm", 5.0, 12.0)],
        {"across": 6},
    ),
    "gradient-index rod": (
        asphere(glass=None, gradient=SELFOC, radius_mm=60.0),
        [
            variable(f"{SURFACE}.gradient.gradient_constant_per_mm[0]", 0.01, 0.03),
            variable(f"{SURFACE}.gradient.index[0]", 1.5, 1.7),
            variable(f"{SURFACE}.radius_mm", 40.0, 90.0),
            variable(f"{SURFACE}.thickness_mm", 5.0, 12.0),
            variable("lens.surfaces[1].radius_mm", -400.0, -200.0),
            variable("focus_mm", 200.0, 900.0),
        ],
        {"across": 6},
    ),
    "dispersive gradient in a tilted element, behind an asphere": (
        asphere(conic=-0.6, asphere_mm=[2e-6], glass=None, gradient=DISPERSIVE).changed(
            {
                "camera.lens.surfaces[1].odd_asphere_mm": [1e-6],
                "camera.lens.elements": [{"surfaces": [0, 1], "pose": POSE}],
            }
        ),
        [
            variable(f"{SURFACE}.gradient.coefficients[0]", -1e-3, 0.0),
            variable(f"{SURFACE}.gradient.coefficients[1]", 0.0, 2e-6),
            variable(f"{SURFACE}.gradient.axial_coefficients[0]", 0.0, 0.01),
            variable(f"{SURFACE}.gradient.dispersion.strengths[0][0]", 1.0, 1.2),
            variable(f"{SURFACE}.asphere_mm[0]", -1e-5, 1e-5),
            variable("lens.surfaces[1].odd_asphere_mm[0]", -1e-5, 1e-5),
            variable("lens.elements[0].pose.tilt_deg[0]", -1.0, 1.0),
            variable(f"{SURFACE}.thickness_mm", 5.0, 12.0),
        ],
        {"across": 6},
    ),
    "tilted and decentred element, f-number": (
        camera("tessar_50mm", 46.0, elements=[{"surfaces": [2, 3], "pose": POSE}]),
        [
            variable("lens.elements[0].pose.tilt_deg[0]", -1.0, 1.0),
            variable("lens.elements[0].pose.shift_mm[1]", -0.5, 0.5),
            variable("lens.surfaces[2].radius_mm", -40.0, -20.0),
            variable("sensor.distance_mm", 40.0, 50.0),
        ],
        {**PARALLEL, "height_mm": 5.0},
    ),
    "ideal thin lens": (
        lf.Scene(
            camera={
                "focus_mm": 300.0,
                "lens": {
                    "surfaces": [THIN_LENS,
                                 {"radius_mm": 80.0, "index": 1.5, "thickness_mm": 4.0, "semi_diameter_mm": 15.0},
                                 {"semi_diameter_mm": 15.0}],
                    "f_number": 4.0,
                },
                "sensor": {"pixels": [100, 100], "pixel_mm": 0.05},
            },
            transport={"wavelengths_nm": WAVES_NM},
        ),
        [
            variable("lens.surfaces[0].focal_length_mm", 40.0, 90.0),
            variable("lens.f_number", 3.0, 8.0),
            variable("lens.surfaces[1].radius_mm", 50.0, 150.0),
        ],
        {"across": 6},
    ),
}  # fmt: skip

MERIT = [
    {"metric": "spot_rms_mm"},
    {"metric": "spot_chief_rms_mm", "field": 0.5},
    {"metric": "mtf", "per_mm": 10.0},
    {"metric": "distortion"},
    {"metric": "lateral_colour_mm"},
    {"metric": "efl_mm", "target": 50.0},
]


def problem_of(case: str) -> Problem:
    scene, variables, rays = CASES[case]
    return Problem(DesignFile(scene="scene", variables=variables, merit=MERIT, rays=rays), scene)


def figures(problem: Problem, number: int, share: float) -> list[np.ndarray]:
    """Return the values of every term with one variable moved by a share of its range."""
    at = problem.start.at.copy()
    at[number] += share
    rated = problem.rated(Place(at, problem.start.picks))
    return [rated.figures[goal].value for goal in problem.goals]


@pytest.mark.parametrize("case", CASES)
def test_derivatives_are_those_of_differences(case: str) -> None:
    problem = problem_of(case)
    rated = problem.rated(problem.start, slopes=True)
    for number, knob in enumerate(problem.knobs):
        near, far = ([figures(problem, number, sign * step) for sign in (1.0, -1.0)] for step in (1e-4, 2e-4))
        for k, goal in enumerate(problem.goals):
            narrow, wide = (near[0][k] - near[1][k]) / 2e-4, (far[0][k] - far[1][k]) / 4e-4
            # The errors of second order of two steps cancel.
            truth = (4.0 * narrow - wide) / 3.0
            slope = rated.figures[goal].slope[:, number]
            assert np.abs(slope - truth).max() <= 1e-6 * np.abs(truth).max() + 1e-10, (knob.variable.path, goal.metric)


@pytest.mark.parametrize("case", CASES)
def test_rays_land_where_the_sequential_engine_lands_them(case: str) -> None:
    problem = problem_of(case)
    rays, scene = problem.rays, lf.solved(problem.scene)
    assert rays is not None
    numbers = rays.layout.numbers_of(scene)
    jets = Jet(numbers, np.zeros((len(numbers), 0)))
    lens, landed = rays.layout.opened(jets), rays.landed(jets)
    vergence = float(lens.vergence.value)
    bench = LensRays(lf.build(scene), 1.0 / vergence if vergence else math.inf, float(lens.image_z.value))
    for field, slope in enumerate(lens.slopes.value):
        for wave, wavelength in enumerate(rays.layout.waves_nm):
            rows = np.flatnonzero((rays.fan.field == field) & (rays.fan.wave == wave))
            bundle = bench.bundle(float(slope), rays.fan.pupil[rows], wavelength)
            found = np.stack([landed.x.value[rows], landed.y.value[rows]], axis=1)
            known = np.isfinite(bundle.place).all(axis=1)
            assert known.sum() >= len(rows) - 1
            np.testing.assert_allclose(found[known], bundle.place[known], rtol=0.0, atol=1e-7)


def test_arithmetic_of_jets_has_the_derivatives_of_the_formulas() -> None:
    x = np.array([0.7, 1.9])
    jet = Jet(x, np.ones((2, 1)))
    for found, value, slope in (
        (2.0 - jet * jet, 2.0 - x**2, -2.0 * x),
        (1.0 / (jet + 1.0), 1.0 / (x + 1.0), -1.0 / (x + 1.0) ** 2),
        (jet / (jet * jet + 1.0), x / (x**2 + 1.0), (1.0 - x**2) / (x**2 + 1.0) ** 2),
        (jet.root(), np.sqrt(x), 0.5 / np.sqrt(x)),
        (jet.power(3), x**3, 3.0 * x**2),
        (x * jet, x * x, x),
    ):
        np.testing.assert_allclose(found.value, value, rtol=1e-14)
        np.testing.assert_allclose(found.slope[:, 0], slope, rtol=1e-14)
