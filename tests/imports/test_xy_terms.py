"""Terms in x and y: their numbering, and fringe Zernike polynomials against cosines and sines."""

import math

import numpy as np
import pytest
from scipy.special import eval_jacobi

from lfmesh.imports.xy_terms import MOST_FRINGE_TERMS, fringe_terms, number_of, powers_of

FRINGE = {
    # n, m and the function around the axis, of some of the 37, from Wyant and Creath's table.
    2: (1, 1, math.cos), 3: (1, 1, math.sin), 4: (2, 0, None), 5: (2, 2, math.cos), 6: (2, 2, math.sin),
    7: (3, 1, math.cos), 8: (3, 1, math.sin), 9: (4, 0, None), 10: (3, 3, math.cos), 11: (3, 3, math.sin),
    12: (4, 2, math.cos), 16: (6, 0, None), 17: (4, 4, math.cos), 25: (8, 0, None), 27: (5, 5, math.sin),
    28: (6, 4, math.cos), 35: (9, 1, math.sin), 36: (10, 0, None), 37: (12, 0, None),
}  # fmt: skip


def test_terms_are_counted_by_degree_and_then_by_the_power_of_y() -> None:
    assert [powers_of(k) for k in range(1, 11)] == [
        (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3), (4, 0),
    ]  # fmt: skip
    assert [number_of(*powers_of(k)) for k in range(1, 1000)] == list(range(1, 1000))
    # CODE V's j = ((m + n)² + m + 3 n) / 2 of x^m y^n.
    assert all(2 * number_of(m, n) == (m + n) ** 2 + m + 3 * n for m in range(12) for n in range(12))


@pytest.mark.parametrize("term", FRINGE)
def test_a_fringe_polynomial_is_a_radial_one_times_cosine_or_sine(term: int) -> None:
    n, m, around = FRINGE[term]
    terms = fringe_terms([0.0] * (term - 1) + [1.5])
    draw = np.random.default_rng(term)
    differences = []
    for r, angle in zip(draw.random(50), draw.uniform(-math.pi, math.pi, 50), strict=True):
        x, y = r * math.cos(angle), r * math.sin(angle)
        found = sum(value * x**i * y**j for (i, j), value in terms.items())
        radial = r**m * eval_jacobi((n - m) // 2, 0, m, 2.0 * r * r - 1.0)
        truth = 1.5 * radial * (around(m * angle) if around is not None else 1.0)
        differences.append(found - truth)
    # They differ by a constant, which has no effect.
    np.testing.assert_allclose(differences, np.mean(differences), rtol=0.0, atol=1e-10)


def test_a_constant_is_left_out_and_terms_that_cancel_are_none() -> None:
    assert fringe_terms([2.0]) == {}
    # 2ρ² − 1, and 6ρ⁴ − 6ρ² + 1 times a third.
    assert (2, 0) not in fringe_terms([0.0] * 3 + [3.0] + [0.0] * 4 + [1.0])
    assert len(fringe_terms([0.0] * (MOST_FRINGE_TERMS - 1) + [1.0])) == 27
