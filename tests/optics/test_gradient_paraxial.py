"""Paraxial optics of gradient-index glass against closed forms."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from lfmesh.errors import GlassError
from lfmesh.optics.gradient_paraxial import GapMatrix, gap_matrix, index_on_axis
from lfmesh.optics.gradient_path import ConicFace, starting_rays, steps_needed, traced
from lfmesh.optics.gradient_shapes import (
    INDEX_SQUARED,
    GradientMaterial,
    GradientProfile,
    at_wavelength,
    gradium_profile,
    radial_and_axial_profile,
    radial_square_profile,
    revolved_profile,
    selfoc_profile,
    separable_profile,
    spherical_profile,
)
from lfmesh.optics.gradients import gradient_table

N, G = 1.6, 0.3
MIXED = [[1.5, 0.02, -0.003], [-0.02, 0.001, 0.0005]]


def close(found: GapMatrix, wanted: GapMatrix, rel: float = 1e-13) -> bool:
    return found == pytest.approx(wanted, rel=rel, abs=rel)


def moved(coefficients: list[list[float]], to: float, sense: float) -> NDArray[np.float64]:
    """Coefficients of r² and z of the same index with `to` + `sense` z in place of z."""
    table = np.array(coefficients)
    found = np.zeros_like(table)
    for j in range(table.shape[1]):
        for i in range(j + 1):
            found[:, i] += table[:, j] * math.comb(j, i) * to ** (j - i) * sense**i
    return found


def determinant(matrix: GapMatrix) -> float:
    a, b, c, d = matrix
    return a * d - b * c


@pytest.mark.parametrize("length", [0.5, 4.0, math.pi / G, 40.0])
def test_a_rod_turns_rays_by_cosine_and_sine(length: float) -> None:
    """n² = n₀² (1 − g² r²): cos gL, sin gL / (n₀ g), −n₀ g sin gL, cos gL."""
    c, s = math.cos(G * length), math.sin(G * length)
    assert close(gap_matrix(radial_square_profile(N, [-G * G]), length), (c, s / (N * G), -N * G * s, c))


def test_a_rod_with_less_index_on_its_axis_diverges() -> None:
    c, s = math.cosh(G * 4.0), math.sinh(G * 4.0)
    assert close(gap_matrix(radial_square_profile(N, [G * G]), 4.0), (c, s / (N * G), N * G * s, c))


def test_n_and_its_square_give_the_same_rod() -> None:
    """n = n₀ + c r² has the g of n² = n₀² (1 + 2 c/n₀ r²)."""
    one = gap_matrix(radial_and_axial_profile(N, [-0.072, 5.0]), 4.0)
    assert close(one, gap_matrix(radial_square_profile(N, [-2.0 * 0.072 / N, -3.0]), 4.0))


def test_a_selfoc_rod_has_its_gradient_constant() -> None:
    """√A = K₀ + K₁/λ² + K₂/λ⁴ is g."""
    g = 0.2931 + 0.005369 / 0.25 + 0.000287 / 0.0625
    n = 1.5868 + 0.00813 / 0.25
    c, s = math.cos(4.0 * g), math.sin(4.0 * g)
    found = gap_matrix(selfoc_profile([1.5868, 0.00813], [0.2931, 0.005369, 0.000287], 500.0), 4.0)
    assert close(found, (c, s / (n * g), -n * g * s, c))


def test_an_axial_gradient_is_a_plate_of_reduced_length() -> None:
    """∫ dz/n, without power."""
    n0, slope, length = 1.5, 0.02, 4.0
    reduced = math.log1p(slope * length / n0) / slope
    profile = radial_and_axial_profile(n0, [], [slope])
    assert close(gap_matrix(profile, length), (1.0, reduced, 0.0, 1.0))
    assert index_on_axis(profile, length) == pytest.approx(1.58, rel=1e-15)


def test_a_rod_whose_strength_grows_along_it_follows_airys_functions() -> None:
    """n² = n₀² (1 − g² z r²): h″ = −g² z h, with Ai and Bi at −g^(2/3) z from their power series."""
    length, k = 5.0, G ** (2.0 / 3.0)
    # f and g of Abramowitz and Stegun, 10.4.3: f(0) = 1, f′(0) = 0, g(0) = 0, g′(0) = 1, both solve w″ = x w.
    x = -k * length
    f = g = df = dg = 0.0
    term_f, term_g = 1.0, x
    for m in range(60):
        f, g = f + term_f, g + term_g
        df, dg = df + 3 * m * term_f / x, dg + (3 * m + 1) * term_g / x
        term_f *= x**3 / ((3 * m + 2) * (3 * m + 3))
        term_g *= x**3 / ((3 * m + 3) * (3 * m + 4))
    wanted = f, -g / (N * k), -N * k * df, dg
    profile = revolved_profile([[N * N, 0.0], [0.0, -((N * G) ** 2)]], INDEX_SQUARED)
    assert close(gap_matrix(profile, length), wanted, 1e-12)


@pytest.mark.parametrize(
    "profile",
    [
        revolved_profile(MIXED),
        revolved_profile([[2.4, 0.1, 0.02], [-0.3, 0.1, 0.01]], INDEX_SQUARED),
        spherical_profile(9.0, [1.5, 0.03, -0.004]),
        spherical_profile(-9.0, [1.5, 0.03, -0.004]),
        gradium_profile([1.7, -0.05, 0.01], 8.0, 1.5),
        at_wavelength(
            revolved_profile(MIXED),
            GradientMaterial(np.array([[0.01, 0.002]]), np.array([[0.02, 0.001]]), 587.6),
            450.0,
        ),
    ],
)
def test_the_determinant_is_1(profile: GradientProfile) -> None:
    for length in (0.1, 2.0, 6.0):
        assert determinant(gap_matrix(profile, length)) == pytest.approx(1.0, abs=1e-14)


def test_the_reversed_glass_has_the_matrix_of_returning_light() -> None:
    """z → L − z: (d, b, c, a)."""
    length = 3.0
    a, b, c, d = gap_matrix(revolved_profile(MIXED), length)
    assert close(gap_matrix(revolved_profile(moved(MIXED, length, -1.0)), length), (d, b, c, a))


def test_two_parts_of_a_gap_make_the_whole() -> None:
    first, second = 1.2, 1.8
    one = gap_matrix(revolved_profile(MIXED), first)
    other = gap_matrix(revolved_profile(moved(MIXED, first, 1.0)), second)
    a, b, c, d = (np.reshape(other, (2, 2)) @ np.reshape(one, (2, 2))).ravel().tolist()
    assert close(gap_matrix(revolved_profile(MIXED), first + second), (a, b, c, d))


def test_a_gradient_along_x_acts_in_that_section_alone() -> None:
    profile = separable_profile([0.0, 0.0, -0.072], [], [N])
    c, s = math.cos(G * 4.0), math.sin(G * 4.0)
    assert close(gap_matrix(profile, 4.0, section_x=True), (c, s / (N * G), -N * G * s, c))
    assert close(gap_matrix(profile, 4.0), (1.0, 4.0 / N, 0.0, 1.0))


@pytest.mark.parametrize("profile", [revolved_profile(MIXED), spherical_profile(9.0, [1.5, 0.03, -0.004])])
def test_real_rays_near_the_axis_follow_the_matrix(profile: GradientProfile) -> None:
    """Their departure is of third order."""
    length, h, p = 3.0, 1e-4, 2e-4
    gradients = gradient_table([profile])
    start = starting_rays(gradients, 0, [[0.0, h, 0.0]], [[0.0, p / 1.5, math.sqrt(1.0 - (p / 1.5) ** 2)]])
    face = ConicFace(0.0, 0.0, length)
    steps = steps_needed(lambda count: traced(gradients, 0, start, face, count), 1e-12)
    reached, ends = traced(gradients, 0, start, face, steps)
    a, b, c, d = gap_matrix(profile, length)
    assert reached.all()
    assert ends[0, 1] == pytest.approx(a * h + b * p, rel=1e-6)
    assert ends[0, 4] == pytest.approx(c * h + d * p, rel=1e-6)


def test_no_length_is_no_change() -> None:
    assert gap_matrix(revolved_profile(MIXED), 0.0) == (1.0, 0.0, 0.0, 1.0)


def test_an_index_that_is_not_real_on_the_axis_is_refused() -> None:
    profile = revolved_profile([[2.0, -1.0]], INDEX_SQUARED)
    with pytest.raises(GlassError, match=r"n² = -1 on the axis at z = 3 mm"):
        index_on_axis(profile, 3.0)
    with pytest.raises(GlassError, match=r"n² = .* on the axis"):
        gap_matrix(profile, 3.0)
