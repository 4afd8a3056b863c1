"""Random numbers are uniform and independent, whichever two of them a packet or its neighbours draw.

Every test is a chi-square test over a grid of bins, at LEVEL together.
"""

import numba
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from lfmesh.transport.packets.random import DIMENSIONS_PER_EVENT, derived, descendant, mix, uniform

LEVEL = 1e-3
COUNT = 1 << 18
BINS = 32

Array = NDArray[np.float64]


@numba.njit
def numbers(root: np.uint64, count: int, generation: int, child: int, dimension: int) -> Array:
    """Return one number of each of `count` neighbouring keys, or of the same child of each."""
    u = np.empty(count)
    for k in range(count):
        key = derived(root, k)
        for _ in range(generation):
            key = derived(key, child)
        u[k] = uniform(key, dimension)
    return u


def p_of_uniform(u: Array) -> float:
    """Return the chi-square p-value of numbers that should fill 1024 bins of [0, 1) alike."""
    assert u.min() >= 0.0
    assert u.max() < 1.0
    return float(stats.chisquare(np.bincount((u * 1024).astype(int), minlength=1024)).pvalue)


def p_of_independent(u: Array, v: Array) -> float:
    """Return the chi-square p-value of pairs that should fill a square of BINS x BINS alike."""
    return float(stats.chisquare(np.histogram2d(u, v, BINS, [[0, 1], [0, 1]])[0].ravel()).pvalue)


ROOT = descendant(0x7465737473, 1)
# Those of a start (negative), of the first event, of a late event, and of a second lamp.
DIMENSIONS = (-64, -59, 0, 5, 11, 63 * DIMENSIONS_PER_EVENT + 9, 4096 + 9)


@pytest.mark.parametrize("dimension", DIMENSIONS)
def test_every_dimension_is_uniform(dimension: int) -> None:
    assert p_of_uniform(numbers(ROOT, COUNT, 0, 0, dimension)) > LEVEL / len(DIMENSIONS)


def test_numbers_of_one_packet_are_independent() -> None:
    """Neighbouring dimensions, those of neighbouring events, and all pairs of the listed ones."""
    pairs = [(d, d + 1) for d in DIMENSIONS] + [(d, d + DIMENSIONS_PER_EVENT) for d in DIMENSIONS]
    pairs += [(a, b) for a in DIMENSIONS for b in DIMENSIONS if a < b]
    p = [p_of_independent(numbers(ROOT, COUNT, 0, 0, a), numbers(ROOT, COUNT, 0, 0, b)) for a, b in pairs]
    assert min(p) > LEVEL / len(p)


@pytest.mark.parametrize("apart", [1, 2, 16, 64])
def test_numbers_of_neighbouring_packets_are_independent(apart: int) -> None:
    p = []
    for dimension in DIMENSIONS:
        u = numbers(ROOT, COUNT + apart, 0, 0, dimension)
        p.append(p_of_independent(u[:-apart], u[apart:]))
    assert min(p) > LEVEL / (4 * len(p))


def test_children_of_a_split_are_independent_of_their_parent() -> None:
    """The refracted child keeps its parent's key, so parent and reflected child must share no number."""
    p = []
    for dimension in DIMENSIONS:
        parent = numbers(ROOT, COUNT, 0, 0, dimension)
        p += [p_of_independent(parent, numbers(ROOT, COUNT, 1, child, dimension)) for child in (0, 1, 2, 1 << 20)]
        p.append(p_of_independent(numbers(ROOT, COUNT, 1, 1, dimension), numbers(ROOT, COUNT, 1, 2, dimension)))
        p.append(p_of_independent(numbers(ROOT, COUNT, 1, 1, dimension), numbers(ROOT, COUNT, 2, 1, dimension)))
    assert min(p) > LEVEL / len(p)


def test_seeds_and_replicates_give_independent_numbers() -> None:
    roots = [descendant(0x6C66, seed, replicate) for seed in (0, 1, 2) for replicate in (0, 1, 2)]
    u = [numbers(root, COUNT, 0, 0, -63) for root in roots]
    p = [p_of_independent(a, b) for i, a in enumerate(u) for b in u[:i]]
    assert min(p) > LEVEL / len(p)


def test_mix_flips_every_bit_with_even_odds() -> None:
    """Each of 64 x 64 pairs of input and output bit: a binomial test over random inputs, Bonferroni over all."""
    inputs = np.random.default_rng(3).integers(0, 2**64, 2000, dtype=np.uint64)
    flips = np.zeros((64, 64))
    bits = np.arange(64, dtype=np.uint64)
    hashed = np.array([mix(np.uint64(z)) for z in inputs], dtype=np.uint64)
    for i in range(64):
        other = np.array([mix(np.uint64(z ^ (np.uint64(1) << bits[i]))) for z in inputs], dtype=np.uint64)
        flips[i] = ((((hashed ^ other)[:, None]) >> bits) & np.uint64(1)).sum(axis=0)
    p = 2.0 * stats.norm.sf(np.abs(flips - 1000.0) / np.sqrt(500.0))
    assert p.min() > LEVEL / p.size


def test_descendant_follows_the_kernels_line_of_children() -> None:
    """From Python too, for keys on either side of 2⁶³, which numba would take for signed."""

    @numba.njit
    def grandchild(key: np.uint64, a: int, b: int) -> np.uint64:
        return derived(derived(key, a), b)

    for a in range(64):
        expected = grandchild(np.uint64(7), a, 3)
        assert isinstance(descendant(7, a, 3), np.uint64)
        assert int(descendant(7, a, 3)) == int(expected)
    assert {int(descendant(7, a)) >= 2**63 for a in range(64)} == {False, True}
