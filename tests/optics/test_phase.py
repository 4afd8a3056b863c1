"""Phase functions: their integral is one, their mean cosine is what it says, and what is drawn has their density."""

from itertools import pairwise

import numpy as np
import pytest
from scipy import integrate, stats

from lfmesh.errors import FileError
from lfmesh.kernels.decorators import kernel
from lfmesh.optics.mie import mie_sphere
from lfmesh.optics.phase import (
    evaluate_phase,
    henyey_greenstein,
    isotropic,
    phase_tables,
    rayleigh,
    read_phase,
    sampled_cosine,
    tabulated,
)

DRAWN = 400_000
CELLS = 100

FUNCTIONS = {
    "isotropic": isotropic(),
    "rayleigh": rayleigh(),
    "hg 0.7": henyey_greenstein(0.7),
    "hg -0.4": henyey_greenstein(-0.4),
    "hg 1e-9": henyey_greenstein(1e-9),
    "hg 0.999": henyey_greenstein(0.999),
    "table": tabulated([-1.0, -0.2, 0.1, 0.1 + 1e-9, 0.9, 1.0], [1.0, 0.0, 0.0, 3.0, 2.0, 40.0]),
    "mie": mie_sphere(2.0, 1.59 + 0.01j, 532.0, 1.333).phase,
}

LEVEL = 1e-3 / len(FUNCTIONS)
"""Of one chi-squared test: 1e-3 for all of them together, after Bonferroni."""


@kernel
def draw_all(phases, u, cosines):
    for k in range(len(u)):
        cosines[k] = sampled_cosine(phases, phases.rows[0, 0], u[k])


def drawn(function, u):
    cosines = np.empty(len(u))
    draw_all(phase_tables([[function]]), u, cosines)
    return cosines


@kernel
def at_all(phases, cosines, values):
    for k in range(len(cosines)):
        values[k] = evaluate_phase(phases, phases.rows[0, 0], cosines[k])


def integral(function, moment=0):
    """Integrate a phase function, times a power of the cosine, over the sphere: piecewise, by Gauss."""
    x, w = np.polynomial.legendre.leggauss(20)
    # Pieces that shrink towards both ends hold any peak; a table is smooth between its nodes.
    fine = np.geomspace(1e-12, 1.0, 400)
    nodes = np.unique(np.concatenate([[-1.0, 1.0], fine - 1.0, 1.0 - fine, function.cosines]))
    low, width = nodes[:-1, None], np.diff(nodes)[:, None]
    mu = low + 0.5 * width * (x + 1.0)
    return np.pi * float((w * width * function.at(mu) * mu**moment).sum())


@pytest.mark.parametrize("name", FUNCTIONS)
def test_integral_over_the_sphere_is_one_and_the_mean_cosine_is_g(name):
    function = FUNCTIONS[name]
    assert integral(function) == pytest.approx(1.0, abs=1e-12)
    assert integral(function, 1) == pytest.approx(function.mean_cosine, abs=1e-10)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_drawn_cosines_have_the_density_that_is_evaluated(name):
    """Chi-squared over cells of equal expectation, whose edges come from integrating what is evaluated."""
    function = FUNCTIONS[name]
    fine = np.geomspace(1e-9, 1.0, 3000)
    nodes = np.unique(np.concatenate([[-1.0, 1.0], fine - 1.0, 1.0 - fine, function.cosines]))
    x, w = np.polynomial.legendre.leggauss(8)
    mu = nodes[:-1, None] + 0.5 * np.diff(nodes)[:, None] * (x + 1.0)
    below = np.concatenate([[0.0], np.cumsum(np.pi * (np.diff(nodes)[:, None] * w * function.at(mu)).sum(axis=1))])
    edges = nodes[np.unique(np.searchsorted(below, np.arange(1, CELLS) / CELLS))]
    shares = np.diff(np.concatenate([[0.0], below[np.searchsorted(nodes, edges)], [1.0]]))
    cosines = drawn(function, np.random.default_rng(7).random(DRAWN))
    assert np.abs(cosines).max() <= 1.0
    counts = np.bincount(np.searchsorted(edges, cosines), minlength=len(shares))
    full = shares * DRAWN > 5.0
    assert (counts[~full] <= 30).all()
    chi2 = ((counts - shares * DRAWN) ** 2 / (shares * DRAWN))[full].sum()
    assert stats.chi2.sf(chi2, full.sum() - 1) > LEVEL


@pytest.mark.parametrize("name", FUNCTIONS)
def test_drawing_inverts_the_integral_of_the_density(name):
    """Between two cosines that are drawn lies the share of the light by which their random numbers differ."""
    function = FUNCTIONS[name]
    u = np.array([0.013, 0.2, 0.41, 0.6, 0.77, 0.951, 0.999])
    cosines = drawn(function, u)
    inner = function.cosines
    for k in range(len(u) - 1):
        low, high = cosines[k], cosines[k + 1]
        nodes = np.concatenate([[low], inner[(inner > low) & (inner < high)], [high]])
        found = sum(
            integrate.quad(lambda mu: float(function.at(mu)), a, b, epsabs=1e-13, epsrel=1e-11, limit=400)[0]
            for a, b in pairwise(nodes)
        ) if len(nodes) < 50 else np.trapezoid(function.at(nodes), nodes)  # fmt: skip
        assert 2.0 * np.pi * found == pytest.approx(u[k + 1] - u[k], abs=1e-9)


def test_henyey_greenstein_tends_to_isotropic_and_to_straight_on():
    u = np.linspace(0.0, 1.0, 1001)
    np.testing.assert_allclose(drawn(henyey_greenstein(1e-12), u), 2.0 * u - 1.0, atol=3e-12)
    mu = np.linspace(-1.0, 1.0, 101)
    np.testing.assert_allclose(henyey_greenstein(1e-12).at(mu), 0.25 / np.pi, rtol=1e-11)
    g = 1.0 - 1e-9
    # The median lies where 1 - cos is of the order of (1 - g)²; both ends are reached and nothing lies beyond.
    peaked = drawn(henyey_greenstein(g), u)
    assert peaked[0] == -1.0
    assert peaked[-1] == 1.0
    assert 1.0 - peaked[500] < 10.0 * (1.0 - g) ** 2 + 1e-16
    turned = drawn(henyey_greenstein(-0.6), 1.0 - u)
    np.testing.assert_allclose(turned, -drawn(henyey_greenstein(0.6), u), rtol=0.0, atol=1e-14)
    # At its peak: (1 - g²) / (1 - g)³.
    assert henyey_greenstein(g).at(1.0) == pytest.approx((1.0 + g) / (4.0 * np.pi * (1.0 - g) ** 2), rel=1e-6)


def test_table_from_a_file(tmp_path):
    path = tmp_path / "phase.csv"
    path.write_text("angle_deg,value\n0,2\n90,1\n180,0\n")
    np.testing.assert_allclose(read_phase(path).at([1.0, 0.0, -0.5]), np.array([2.0, 1.0, 0.5]) / (4.0 * np.pi))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("angle_deg,value\n0,1\n90,2\n", "from 0 to 180"),
        ("angle_deg,value\n0,1\n90,-2\n180,1\n", "0 or more"),
        ("angle_deg,value\n0,1\n90,nan\n180,1\n", "finite"),
        ("angle_deg,value\n0,0\n180,0\n", "not all 0"),
        ("angle_deg,value\n0,1\n1e-12,1\n180,0\n", "same cosine"),
        ("angle_deg,intensity\n0,1\n180,1\n", "no column value"),
        ("angle_deg,value\n0,1\nten,1\n180,1\n", "below its first line"),
        ("angle_deg,value\n", "from 0 to 180"),
    ],
)
def test_bad_tables_are_refused_in_one_line(tmp_path, text, said):
    path = tmp_path / "phase.csv"
    path.write_text(text)
    with pytest.raises(FileError, match=said) as raised:
        read_phase(path)
    assert "\n" not in str(raised.value)
