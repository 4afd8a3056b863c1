"""Ground glass: sampled directions have the stated density, which is reciprocal; nothing is lost; limits hold."""

import numpy as np
import pytest
from scipy import stats

from lfmesh.kernels.decorators import kernel
from lfmesh.optics.fresnel import fresnel
from lfmesh.optics.microfacets import smith_g2, smith_lambda, visible_normal
from lfmesh.transport.events.ground import ground_density, ground_direction
from lfmesh.transport.packets.random import derived, uniform
from tests.instances import instances

LEVEL = 1e-3
"""Chance that this file fails though all is right, shared by its COMPARISONS (Bonferroni)."""
COMPARISONS = 40

IN, OUT = (1.0, 1.5), (1.5, 1.0)


@kernel
def many_directions(alpha, n_i, n_t, x, y, z, seed, directions):
    for k in range(len(directions)):
        key = derived(seed, k)
        passes, ox, oy, oz = ground_direction(alpha, n_i, n_t, (x, y, z), uniform(key, -1), uniform(key, -2), key)
        directions[k, 0], directions[k, 1], directions[k, 2] = ox, oy, oz
        if passes != (oz < 0.0):
            directions[k, 0] = np.nan


@kernel
def many_densities(alpha, n_i, n_t, x, y, z, wanted, seed, densities):
    for k in range(len(densities)):
        densities[k] = ground_density(
            alpha, n_i, n_t, (x, y, z), (wanted[k, 0], wanted[k, 1], wanted[k, 2]), derived(seed, k)
        )


@kernel
def chance_to_leave_at_once(alpha, x, y, z, seed, chances):
    """Mirror a direction at facets that are seen from it; enter the chance that nothing stands in its way out."""
    for k in range(len(chances)):
        key = derived(seed, k)
        mx, my, mz = visible_normal(alpha, x, y, z, uniform(key, 0), uniform(key, 1))
        twice = 2.0 * (x * mx + y * my + z * mz)
        ox, oy, oz = twice * mx - x, twice * my - y, twice * mz - z
        chances[k] = smith_g2(alpha, x, y, z, ox, oy, oz) * (1.0 + smith_lambda(alpha, x, y, z))


def downwards(degrees):
    return np.sin(np.radians(degrees)), 0.0, -np.cos(np.radians(degrees))


def directions(alpha, indices, arriving, count=400_000, seed=1):
    found = np.empty((count, 3))
    many_directions(alpha, *indices, *arriving, np.uint64(seed), found)
    return found


ALPHAS, MEDIA, DEGREES = (0.1, 0.5, 1.0), (IN, OUT), (0.0, 50.0, 85.0)
ROUGH = [(ALPHAS[a], MEDIA[m], DEGREES[d]) for a, m, d in np.ndindex(3, 2, 3)]
SECOND = [(ALPHAS[a], MEDIA[m], DEGREES[d]) for a, m, d in np.ndindex(3, 2, 3) if (a + m + d) % 2]
"""Half of them; the others have every pair of values, too."""


@pytest.mark.parametrize("case", instances(ROUGH, long=SECOND), ids=str)
def test_directions_have_their_density(case):
    """Counts in cells of the sphere against the mean density there, itself sampled: the sum of z² over cells."""
    alpha, indices, degrees = case
    arriving = downwards(degrees)
    found = directions(alpha, indices, arriving, seed=int(degrees))
    np.testing.assert_allclose((found**2).sum(axis=1), 1.0, rtol=1e-12)
    rng = np.random.default_rng(7)
    counts = _in_cells(found)
    each, z2 = 10_000, []
    for cell in range(60):
        row, column = divmod(cell, 6)
        polar = np.pi / 10.0 * (row + rng.random(each))
        azimuth = np.pi / 6.0 * (column + rng.random(each))
        wanted = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1)
        density = np.empty(each)
        many_densities(alpha, *indices, *arriving, wanted, np.uint64(1000 + cell), density)
        # Both signs of the azimuth.
        density *= np.sin(polar) * 2.0 * np.pi**2 / 60.0 * len(found)
        # Where few samples hold much of the sum, its error is not normal.
        if density.mean() > 100.0 and density.max() < 0.01 * density.sum():
            z2.append((counts[cell] - density.mean()) ** 2 / (density.mean() + density.var(ddof=1) / each))
    assert len(z2) >= 6
    assert stats.chi2.sf(sum(z2), len(z2)) > LEVEL / COMPARISONS


def _in_cells(found):
    """Count directions in 10 cells of the polar angle by 6 of |azimuth|, in which all is symmetric."""
    row = np.clip(np.floor(10.0 / np.pi * np.arccos(np.clip(found[:, 2], -1.0, 1.0))), 0, 9)
    column = np.clip(np.floor(6.0 / np.pi * np.abs(np.arctan2(found[:, 1], found[:, 0]))), 0, 5)
    return np.bincount((6 * row + column).astype(int), minlength=60)


@pytest.mark.parametrize("alpha", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("through", [False, True])
def test_basic_radiance_is_exchanged_evenly(alpha, through):
    """What goes from one direction to another, over n² cos θ of where it goes, goes as well from that to the first."""
    count = 400_000
    one, other = np.array([np.sin(0.6), 0.0, np.cos(0.6)]), np.array([-np.sin(0.5), 0.3, np.cos(0.5)])
    other /= np.linalg.norm(other)
    sign = -1.0 if through else 1.0
    there, back = np.empty(count), np.empty(count)
    n_i, n_t = 1.0, 1.5
    wanted = np.broadcast_to(other * [1.0, 1.0, sign], (count, 3)).copy()
    many_densities(alpha, n_i, n_t, *-one, wanted, np.uint64(1), there)
    # The way back as its own side sees it, turned over where the two are on different sides.
    wanted = np.broadcast_to(one * [1.0, 1.0, sign], (count, 3)).copy()
    ways = (n_t, n_i) if through else (n_i, n_t)
    many_densities(alpha, *ways, *-other, wanted, np.uint64(2), back)
    there /= other[2] * (n_t if through else n_i) ** 2
    back /= one[2] * n_i**2
    z = (there.mean() - back.mean()) / np.sqrt((there.var() + back.var()) / count)
    assert there.mean() > 0.0
    assert 2.0 * stats.norm.sf(abs(z)) > LEVEL / COMPARISONS


@pytest.mark.parametrize("indices", [IN, OUT, (1.0, 1.0 + 1e-9), (1.0, 4.0), (4.0, 1.0)], ids=str)
@pytest.mark.parametrize("alpha", [1e-3, 0.1, 1.0])
@pytest.mark.parametrize("degrees", [0.0, 30.0, 89.9999])
def test_all_light_leaves_on_the_side_that_is_said(alpha, indices, degrees):
    found = directions(alpha, indices, downwards(degrees), count=20_000)
    assert np.isfinite(found).all()
    assert (found[:, 2] != 0.0).all()


@pytest.mark.parametrize("indices", [IN, OUT], ids=["into glass", "out of glass"])
def test_almost_smooth_facets_reflect_and_refract_by_snell_and_fresnel(indices):
    arriving = downwards(30.0)
    found = directions(1e-4, indices, arriving)
    passed = found[:, 2] < 0.0
    reflectance, _, cos_t = fresnel(*indices, -arriving[2])
    assert stats.binomtest(int((~passed).sum()), len(found), reflectance).pvalue > LEVEL / COMPARISONS
    sine = arriving[0] * indices[0] / indices[1]
    # Slopes have no variance, so medians; they tilt a refracted ray by less than the slope itself.
    np.testing.assert_allclose(np.median(found[passed], axis=0), [sine, 0.0, -cos_t], atol=2e-6)
    np.testing.assert_allclose(np.median(found[~passed], axis=0), [arriving[0], 0.0, -arriving[2]], atol=1e-5)


def test_roughest_facets_send_back_at_once_what_is_known():
    """All that mirrors of roughness 1, seen along the normal, reflect at once is 1 - ln 2."""
    chances = np.empty(1_000_000)
    chance_to_leave_at_once(1.0, 0.0, 0.0, 1.0, np.uint64(3), chances)
    z = (chances.mean() - (1.0 - np.log(2.0))) / (chances.std() / np.sqrt(len(chances)))
    assert 2.0 * stats.norm.sf(abs(z)) > LEVEL / COMPARISONS
