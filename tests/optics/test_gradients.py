"""Index profiles of gradient-index glass: their formulas, their gradients, their dispersion, and the paraxial terms."""

from collections.abc import Callable
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from numpy.typing import NDArray

from lfmesh.optics.gradient_shapes import (
    INDEX_SQUARED,
    GradientMaterial,
    GradientProfile,
    at_wavelength,
    gradium_profile,
    paraxial_at,
    radial_and_axial_profile,
    radial_square_profile,
    revolved_profile,
    selfoc_profile,
    separable_profile,
    spherical_profile,
)
from lfmesh.optics.gradients import fields_at, gradient_table, kick_at, n2_at

Array = NDArray[np.float64]
Formula = Callable[[Any, Any, Any], Any]

POINTS = np.random.default_rng(3).uniform([-1.5, -1.5, -0.5], [1.5, 1.5, 4.0], (12, 3))
TABLE = [[1.6, 0.02, -0.003], [-0.05, 0.001, 0.0], [0.002, 0.0, 1e-4]]

FLINT = GradientMaterial(
    np.array(
        [
            [-0.068, -0.032, -0.029, -0.017, 0.003, 0.017],
            [-0.001, 0.033, 0.039, 0.037, 0.017, -0.041],
            [0.931, -0.031, -0.039, -0.042, -0.026, 0.044],
        ]
    ),
    np.array([[0.005, 0.0004, 0.00002], [0.082, 0.034, -0.034], [110.0, 0.0003, 0.0004]]),
    587.56,
)
"""Strengths of fifth and resonances of second degree in the index, as of the flints of SGRIN.DAT."""


def n_of_gradient_5(x: Any, y: Any, z: Any) -> Any:
    u = x * x + y * y
    return 1.7 - 0.012 * u + 3e-4 * u * u + 0.01 * z - 0.002 * z * z


def dispersed(n: Any, wavelength_um: float) -> Any:
    w2, reference = mp.mpf(wavelength_um) ** 2, mp.mpf(FLINT.reference_nm) ** 2 / 1000**2
    strengths, resonances = (
        [sum(c * n**j for j, c in enumerate(row)) for row in part] for part in (FLINT.strengths, FLINT.resonances_um2)
    )
    return n * n + (w2 - reference) * sum(k / (w2 - l2) for k, l2 in zip(strengths, resonances, strict=True))


def spherical(radius: float, x: Any, y: Any, z: Any) -> Any:
    t = radius - mp.sign(radius) * mp.sqrt(x * x + y * y + (radius - z) ** 2)
    return 1.5 + 0.03 * t - 0.004 * t * t + 1e-4 * t**3


def selfoc(x: Any, y: Any, z: Any) -> Any:
    """SLW-1.8 at 630 nm, as in GRADIENT_9.DAT."""
    w2 = mp.mpf("0.63") ** 2
    root = mp.mpf("0.3238") + mp.mpf("5.364e-3") / w2 + mp.mpf("2.626e-4") / w2**2
    return (mp.mpf("1.5868") + mp.mpf("8.14e-3") / w2) * (1 - root**2 * (x * x + y * y) / 2)


X, Y, Z = (0.7, 0.02, -0.01), (0.9, -0.03, -0.02, 0.001), (0.0, 0.05, 0.0, -1e-3)


def separable(x: Any, y: Any, z: Any) -> Any:
    return sum(c * v**i for part, v in ((X, x), (Y, y), (Z, z)) for i, c in enumerate(part))


GRADIUM = (1.8, -0.05, 0.03, -0.2, 0.15, -0.02)

KINDS: dict[str, tuple[GradientProfile, Formula]] = {
    "revolved": (
        revolved_profile(TABLE),
        lambda x, y, z: (
            sum(c * (x * x + y * y) ** i * z**j for i, row in enumerate(TABLE) for j, c in enumerate(row)) ** 2
        ),
    ),
    "revolved square": (
        revolved_profile(TABLE, INDEX_SQUARED),
        lambda x, y, z: sum(c * (x * x + y * y) ** i * z**j for i, row in enumerate(TABLE) for j, c in enumerate(row)),
    ),
    "radial square": (
        radial_square_profile(1.6, [-0.09, 0.004, -1e-4]),
        lambda x, y, z: (
            mp.mpf(1.6) ** 2 * (1 - 0.09 * (x * x + y * y) + 0.004 * (x * x + y * y) ** 2 - 1e-4 * (x * x + y * y) ** 3)
        ),
    ),
    "Liou and Brennan's lens, front": (
        radial_and_axial_profile(1.368, [-0.001978], [0.049057, -0.015427]),
        lambda x, y, z: (1.368 + 0.049057 * z - 0.015427 * z * z - 0.001978 * (x * x + y * y)) ** 2,
    ),
    "separable": (separable_profile(X, Y, Z), lambda x, y, z: separable(x, y, z) ** 2),
    "folded": (separable_profile(X, Y, Z, folded=True), lambda x, y, z: separable(x, abs(y), z) ** 2),
    "spherical": (
        spherical_profile(6.0, (1.5, 0.03, -0.004, 1e-4)),
        lambda x, y, z: spherical(6.0, x, y, z) ** 2,
    ),
    "spherical, centre in front": (
        spherical_profile(-8.0, (1.5, 0.03, -0.004, 1e-4)),
        lambda x, y, z: spherical(-8.0, x, y, z) ** 2,
    ),
    "axial": (
        spherical_profile(np.inf, (1.5, 0.03, -0.004)),
        lambda x, y, z: (1.5 + 0.03 * z - 0.004 * z * z) ** 2,
    ),
    "selfoc": (
        selfoc_profile((1.5868, 8.14e-3), (0.3238, 5.364e-3, 2.626e-4), 630.0),
        lambda x, y, z: selfoc(x, y, z) ** 2,
    ),
    "gradium": (
        gradium_profile(GRADIUM, 9.0, 2.5),
        lambda x, y, z: sum(c * ((z + 2.5) / 9.0) ** i for i, c in enumerate(GRADIUM)) ** 2,
    ),
    "dispersed": (
        at_wavelength(radial_and_axial_profile(1.7, (-0.012, 3e-4), (0.01, -0.002)), FLINT, 486.13),
        lambda x, y, z: dispersed(n_of_gradient_5(x, y, z), 0.48613),
    ),
}


def exact(formula: Formula, point: Array) -> list[float]:
    """Return n² and half its gradient in 40 digits."""
    with mp.workdps(40):
        at = [mp.mpf(float(c)) for c in point]
        orders = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
        return [float(formula(*at)), *(float(mp.diff(formula, tuple(at), order) / 2) for order in orders)]


@pytest.mark.parametrize("kind", KINDS)
def test_a_profile_is_its_formula_with_half_its_gradient(kind: str) -> None:
    profile, formula = KINDS[kind]
    found = fields_at(gradient_table([profile]), 0, POINTS)
    for point, values in zip(POINTS, found, strict=True):
        np.testing.assert_allclose(values, exact(formula, point), rtol=1e-13, atol=1e-15)


def test_profiles_of_one_table_do_not_mix() -> None:
    profiles = [profile for profile, _ in KINDS.values()]
    together = gradient_table(profiles)
    for number, profile in enumerate(profiles):
        alone = gradient_table([profile])
        for x, y, z in POINTS[:3].tolist():
            kick = kick_at(together, number, x, y, z)
            assert (n2_at(together, number, x, y, z), *kick) == tuple(fields_at(alone, 0, [(x, y, z)])[0])


def test_a_spherical_profile_is_constant_on_spheres_and_has_no_direction_at_their_centre() -> None:
    table = gradient_table([KINDS["spherical"][0]])
    around = POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True)
    fields = fields_at(table, 0, [0.0, 0.0, 6.0] + 3.7 * around)
    np.testing.assert_allclose(fields[:, 0], n2_at(table, 0, 0.0, 0.0, 2.3), rtol=1e-14)
    np.testing.assert_allclose(np.cross(fields[:, 1:], around), 0.0, atol=1e-15)
    assert kick_at(table, 0, 0.0, 0.0, 6.0) == (0.0, 0.0, 0.0)


def test_spheres_of_a_large_radius_lose_no_digits() -> None:
    table = gradient_table([spherical_profile(1e9, (1.5, 0.03)), spherical_profile(np.inf, (1.5, 0.03))])
    found, plane = (fields_at(table, number, POINTS) for number in (0, 1))
    np.testing.assert_allclose(found, plane, rtol=1e-9, atol=1e-9)
    assert fields_at(table, 0, [(0.0, 0.0, 1.25)])[0, 0] == pytest.approx((1.5 + 0.03 * 1.25) ** 2, rel=1e-15)


def test_below_zero_the_square_of_the_index_follows_its_formula() -> None:
    """Without a kink, which would spoil an integrator's order."""
    table = gradient_table([radial_square_profile(1.6, [-0.09])])
    for r in (3.0, 3.5, 10.0):
        assert n2_at(table, 0, 0.0, r, 0.0) == pytest.approx(1.6**2 * (1.0 - 0.09 * r * r), rel=1e-14, abs=1e-15)
        assert kick_at(table, 0, 0.0, r, 0.0) == pytest.approx((0.0, -(1.6**2) * 0.09 * r, 0.0), rel=1e-14)


def test_at_its_reference_wavelength_a_material_has_its_profile() -> None:
    profile = radial_and_axial_profile(1.7, (-0.012, 3e-4), (0.01, -0.002))
    found, wanted = (
        fields_at(gradient_table([each]), 0, POINTS)
        for each in (at_wavelength(profile, FLINT, FLINT.reference_nm), profile)
    )
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("wavelength_nm", [365.0, 486.1327, 656.2725, 1529.6])
def test_a_material_with_the_strengths_of_a_glass_has_its_dispersion(wavelength_nm: float) -> None:
    """Sellmeier's n² = 1 + Σ B λ²/(λ² − C) is a material with K = B C/(C − λ_ref²) and L = C: here SCHOTT's N-BK7."""
    b, c = np.array([1.03961212, 0.231792344, 1.01046945]), np.array([0.00600069867, 0.0200179144, 103.560653])

    def squared(wavelength_um: float) -> float:
        return float(1.0 + np.sum(b * wavelength_um**2 / (wavelength_um**2 - c)))

    reference_nm = 587.5618
    material = GradientMaterial((b * c / (c - (1e-3 * reference_nm) ** 2))[:, None], c[:, None], reference_nm)
    profile = at_wavelength(revolved_profile([squared(1e-3 * reference_nm) ** 0.5]), material, wavelength_nm)
    assert n2_at(gradient_table([profile]), 0, 0.3, 0.2, 0.1) == pytest.approx(squared(1e-3 * wavelength_nm), rel=1e-14)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "folded"])
def test_paraxial_terms_are_differences_about_the_axis(kind: str) -> None:
    profile, _ = KINDS[kind]
    z = np.array([-0.3, 0.0, 1.1, 3.0])
    table, step, zero = gradient_table([profile]), 1e-3, np.zeros(4)
    fields = [fields_at(table, 0, np.column_stack([dx + zero, dy + zero, z])) for dx, dy in offsets(step)]
    n2, along, xx, yy = paraxial_at(profile, z)
    linear = fields[0][:, 1:3] if kind == "separable" else 0.0
    np.testing.assert_allclose(n2, fields[0][:, 0], rtol=1e-14)
    np.testing.assert_allclose(along, fields[0][:, 3], rtol=1e-12, atol=1e-15)
    across = np.column_stack([fields[1][:, 1] - fields[2][:, 1], fields[3][:, 2] - fields[4][:, 2]]) / (2.0 * step)
    # ½ ∂²n²/∂x² = n ∂²n/∂x² + (∂n/∂x)²; paraxially the linear terms are left out.
    np.testing.assert_allclose(np.column_stack([xx, yy]), across - linear**2 / n2[:, None], rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("radius", [3.0, -2.0])
def test_a_smooth_ball_has_the_curvature_of_its_polynomial_up_to_its_centre(radius: float) -> None:
    """n = n₀ + c (ρ² − R²) is n₀ + c (r² − 2 R z + z²); a ball with a slope at its centre has no curvature there."""
    c, z = -0.02, radius * np.array([0.0, 0.3, 1.0 - 1e-9, 1.0, 1.7])
    # In t = R − ρ: ρ² − R² = t² − 2 R t.
    ball = paraxial_at(spherical_profile(radius, (1.6, -2.0 * radius * c, c)), z)
    same = paraxial_at(radial_and_axial_profile(1.6, [c], (-2.0 * radius * c, c)), z)
    for own, other in zip(ball, same, strict=True):
        np.testing.assert_allclose(own, other, rtol=1e-13, atol=1e-14)
    with np.errstate(divide="ignore"):
        pointed = paraxial_at(spherical_profile(radius, (1.6, 0.01)), [radius])
    assert np.isinf(pointed[2]).all()


def offsets(step: float) -> list[tuple[float, float]]:
    return [(0.0, 0.0), (step, 0.0), (-step, 0.0), (0.0, step), (0.0, -step)]
