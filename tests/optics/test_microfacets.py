"""GGX microfacets: normalisation, masking that conserves area, and the distribution of sampled normals."""

import numpy as np
import pytest
from scipy import stats

from lfmesh.kernels.decorators import kernel
from lfmesh.optics.microfacets import (
    facet_density,
    projected_area,
    smith_g2,
    smith_lambda,
    visible_normal,
)

ALPHAS = [0.01, 0.1, 0.5, 1.0]
COSINES = [1.0, 0.7, 0.05, -0.3, -0.99]
DRAWN = 200_000
LEVEL = 1e-3 / (len(ALPHAS) * len(COSINES))
"""Of one chi-squared test: 1e-3 for all of them together, after Bonferroni."""


@kernel
def many_normals(alpha, x, y, z, u, v, normals):
    for k in range(len(u)):
        normals[k, 0], normals[k, 1], normals[k, 2] = visible_normal(alpha, x, y, z, u[k], v[k])


def seen_from(cosine, azimuth=0.7):
    sine = np.sqrt(1.0 - cosine**2)
    return sine * np.cos(azimuth), sine * np.sin(azimuth), cosine


FINE = 1200
"""Midpoints of the integrals, along each of two coordinates."""


@kernel
def facet_integrals(alpha, dx, dy, dz, first, steps):
    """Integrate over facet normals: D cos θ, and the projected area towards a direction.

    Slopes are alpha tan t, and t begins at `first`. Bounded integrands, so that midpoints do.
    """
    covered, area = 0.0, 0.0
    step = (0.5 * np.pi - first) / steps
    for i in range(steps):
        slope = alpha * np.tan(first + (i + 0.5) * step)
        z = 1.0 / np.sqrt(1.0 + slope * slope)
        # dω = sin θ dθ dφ = z³ slope d(slope) dφ
        solid = z**3 * slope * (alpha + slope * slope / alpha) * step * 2.0 * np.pi / steps
        for k in range(steps):
            phi = 2.0 * np.pi * (k + 0.5) / steps
            x, y = slope * z * np.cos(phi), slope * z * np.sin(phi)
            density = facet_density(alpha, x, y, z)
            covered += density * z * solid
            area += density * max(0.0, dx * x + dy * y + dz * z) * solid
    return covered, area


def first_seen(alpha, cosine):
    """Return the least t, with slope alpha tan t, of a facet that is seen from a direction."""
    return 0.0 if cosine >= 0.0 else np.arctan(-cosine / np.sqrt(1.0 - cosine**2) / alpha)


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("cosine", COSINES)
def test_densities_integrate_to_what_they_must(alpha, cosine):
    """D cos θ to one, so that facets cover the surface once; D cos over what is seen to the projected area."""
    seen = seen_from(cosine)
    _, area = facet_integrals(alpha, *seen, first_seen(alpha, cosine), FINE)
    assert area == pytest.approx(projected_area(alpha, *seen), rel=1e-5)
    covered, _ = facet_integrals(alpha, *seen, 0.0, FINE)
    assert covered == pytest.approx(1.0, rel=2e-6)


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("cosine", [1.0, 0.7, 0.05])
def test_facets_that_are_seen_cover_the_surface_as_it_is_seen(alpha, cosine):
    """σ G₁ = cos θ with G₁ = 1/(1 + Λ): that is what masking is for."""
    seen = seen_from(cosine)
    assert projected_area(alpha, *seen) / (1.0 + smith_lambda(alpha, *seen)) == pytest.approx(cosine, rel=1e-14)


@pytest.mark.parametrize("alpha", ALPHAS)
def test_masking_functions_follow_from_lambda(alpha):
    above, beside = seen_from(0.6), seen_from(0.2, 2.0)
    below = tuple(-np.array(beside))
    first, second = smith_lambda(alpha, *above), smith_lambda(alpha, *beside)
    assert smith_g2(alpha, *above, *beside) == pytest.approx(1.0 / (1.0 + first + second), rel=1e-14)
    assert smith_lambda(alpha, *below) == pytest.approx(-1.0 - second, rel=1e-14)


def test_nothing_is_seen_through_the_surface_or_along_it():
    along, above, below = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
    assert smith_g2(0.5, *above, *below) == smith_g2(0.5, *along, *above) == 0.0
    assert facet_density(0.5, *below) == 0.0


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("cosine", COSINES)
def test_sampled_normals_have_their_density(alpha, cosine):
    """Chi-squared over 8 x 8 cells: equal steps of t, where slopes are alpha tan t, and of azimuth."""
    rng = np.random.default_rng(int(1000 * alpha) + int(100 * (cosine + 1.0)))
    seen, normals = seen_from(cosine), np.empty((DRAWN, 3))
    many_normals(alpha, *seen, rng.random(DRAWN), rng.random(DRAWN), normals)
    np.testing.assert_allclose((normals**2).sum(axis=1), 1.0, rtol=1e-13)
    assert (normals @ seen).min() > -1e-12 * alpha
    first = first_seen(alpha, cosine)
    t = np.arctan(np.hypot(normals[:, 0], normals[:, 1]) / normals[:, 2] / alpha)
    rank = (t - first) / (0.5 * np.pi - first)
    azimuth = np.arctan2(normals[:, 1], normals[:, 0]) % (2.0 * np.pi)
    cells = 8
    counts = np.histogram2d(rank, azimuth, cells, [[0.0, 1.0], [0.0, 2.0 * np.pi]])[0].ravel()
    fine = 40 * cells
    middles = (np.arange(fine) + 0.5) / fine
    t, phi = np.meshgrid(first + (0.5 * np.pi - first) * middles, 2.0 * np.pi * middles, indexing="ij")
    slope = alpha * np.tan(t)
    z = 1.0 / np.sqrt(1.0 + slope**2)
    facing = np.maximum(0.0, slope * z * (seen[0] * np.cos(phi) + seen[1] * np.sin(phi)) + seen[2] * z)
    # D cos θ dω = 2 sin t cos t dt dφ / 2π
    share = facing / z * np.sin(2.0 * t) * (0.5 * np.pi - first) / fine**2 / projected_area(alpha, *seen)
    expected = DRAWN * share.reshape(cells, fine // cells, cells, fine // cells).sum(axis=(1, 3)).ravel()
    assert counts.sum() == DRAWN
    assert expected.sum() == pytest.approx(DRAWN, rel=2e-4)
    rare = expected < 10.0
    assert counts[rare].sum() <= stats.poisson.isf(LEVEL, max(expected[rare].sum(), 1e-9))
    p = stats.chisquare(counts[~rare], expected[~rare] * counts[~rare].sum() / expected[~rare].sum()).pvalue
    assert p > LEVEL
