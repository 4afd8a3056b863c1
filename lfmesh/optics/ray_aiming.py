"""Ray aiming: find the ray of a two-parameter family that lands on a given point.

The two numbers of a ray are, for example, the slopes at which it leaves a point, or the place at which it enters the
lens. Targets are apexes of the array, points of the stop, or image points. The method is Newton's, with a derivative
that every traced ray improves (C. G. Broyden, "A class of methods for solving nonlinear simultaneous equations", Math.
Comp. 19 (1965) 577).

`aim_rays` needs a good guess. `continue_rays` needs none: it starts from rays that are known and follows them while
their targets move, by steps that are halved where Newton's method does not contract (P. Deuflhard, Newton Methods for
Nonlinear Problems, 2004, chapter 5). A ray that cannot be followed to the end has come to an edge, whose
place is known.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Landing = Callable[[Array, NDArray[np.int64]], Array]
"""Maps the two numbers of rays (m, 2), and the indices of these rays (m,), to landing points (m, 2), mm; NaN: lost."""

TOLERANCE = 1e-12
"""Miss, relative to the target's size, at which a ray is not improved further."""

ARRIVED = 1e-7
"""Miss, relative to the target's size, up to which a ray counts as arrived; across facets none may come closer."""

MOST_STEPS = 24
"""Largest number of Newton steps; through smooth surfaces four to six are enough."""

FRUITLESS = 3
"""Steps in a row without improvement after which a ray is given up; steps that land nowhere are halved instead."""


CONTRACTION = 0.5
"""Ratio of the misses before and after each of Newton's steps up to which a continued ray stays on its branch."""

LEAST_STRIDE = 1e-6
"""Shortest step of a continuation, over the whole way."""

MOST_STRIDES = 128
"""Strides that are tried; 80 are the most that fields of lenses took, up to their edges. A ray whose strides
neither grow nor end, as on a surface that is all but a ridge, stays where it is: its aiming does not converge."""

CORRECTIONS = 12
"""Largest number of Newton's steps in one step of a continuation."""


class AimedRays(NamedTuple):
    """The best rays that a search found.

    Attributes
    ----------
    start : (n, 2) float64
        The two numbers of each ray; NaN where not even the first guess landed anywhere.
    miss : (n,) float64, mm
        Distance of the landing point from the target.
    arrived : (n,) bool
        Whether the ray lands on its target.
    """

    start: Array
    miss: Array
    arrived: NDArray[np.bool_]


def aim_rays(landing: Landing, targets: Array, guess: Array, derivative: Array | float, size: ArrayLike) -> AimedRays:
    """Find the rays that land on targets.

    Parameters
    ----------
    landing : callable
        Traces rays; see `Landing`.
    targets : (n, 2) float64, mm
        Points on which the rays shall land.
    guess : (n, 2) float64
        Initial numbers of each ray.
    derivative : (n, 2, 2) float64, or float
        Derivative of the landing point by the two numbers, near the guess: [i, j] of coordinate i by number j. A float
        is the step with which it is found from finite differences, which costs two more rays for each.
    size : float or (n,) float64, mm
        Size of the target, which tolerances are relative to.
    """
    size = np.broadcast_to(np.asarray(size, dtype=np.float64), len(targets))
    start = guess.copy()
    hit, derivative = _first(landing, start, derivative)
    miss = _length(targets - hit)
    start[~np.isfinite(miss)] = np.nan
    damping, fruitless = np.ones(len(start)), np.zeros(len(start), np.int64)
    for _ in range(MOST_STEPS):
        # Lost rays, with a miss of NaN, are not active.
        active = np.flatnonzero((miss > TOLERANCE * size) & (fruitless < FRUITLESS))
        if not len(active):
            break
        step = damping[active, None] * _solved(derivative[active], targets[active] - hit[active])
        trial = start[active] + step
        new = landing(trial, active)
        new_miss = _length(targets[active] - new)
        landed = np.isfinite(new_miss)
        seen, moved = active[landed], step[landed]
        surplus = new[landed] - hit[seen] - np.einsum("nij,nj->ni", derivative[seen], moved)
        derivative[seen] += surplus[:, :, None] * (moved / np.square(moved).sum(axis=1, keepdims=True))[:, None, :]
        closer = new_miss < miss[active]
        better = active[closer]
        start[better], hit[better], miss[better] = trial[closer], new[closer], new_miss[closer]
        damping[active] = np.where(closer, 1.0, 0.5 * damping[active])
        fruitless[active] = np.where(closer, 0, fruitless[active] + landed)
    return AimedRays(start, miss, miss <= ARRIVED * size)


class ContinuedRays(NamedTuple):
    """Rays that were followed while their targets moved.

    Attributes
    ----------
    start : (n, 2) float64
        The two numbers of each ray, as far as it was followed.
    derivative : (n, 2, 2) float64
        Of the miss by these numbers, there.
    share : (n,) float64
        Of the way; 1 where the ray was followed to the end.
    """

    start: Array
    derivative: Array
    share: Array

    @property
    def arrived(self) -> NDArray[np.bool_]:
        """(n,): whether rays were followed to the end."""
        return np.asarray(self.share >= 1.0)


Miss = Callable[[Array, Array, NDArray[np.int64]], Array]
"""Maps the numbers of rays (m, 2), shares of the way (m,) and the indices of these rays (m,) to misses (m, 2), mm."""


def continue_rays(
    miss: Miss, start: Array, difference: float, size: float, derivative: Array | None = None
) -> ContinuedRays:
    """Follow rays from targets that they hit to others, along a way from 0 to 1.

    A ray never leaves its branch: steps are short enough for Newton's method to contract, and the sign of the
    derivative's determinant stays. Where a branch ends, at the border of the map or at a fold, the ray stays.

    Parameters
    ----------
    miss : callable
        Traces rays; see `Miss`. NaN: lost.
    start : (n, 2) float64
        Numbers of rays whose miss at the share 0 is zero.
    difference : float
        Step in the numbers by which derivatives are taken.
    size : float, mm
        Size of the target, which tolerances are relative to.
    derivative : (n, 2, 2) float64, optional
        Of the misses at the share 0, if it is known.
    """
    start, share, stride = start.copy(), np.zeros(len(start)), np.ones(len(start))
    if derivative is None:
        derivative = _derivative(miss, start, share, np.arange(len(start)), difference)
    derivative = derivative.copy()
    known = np.isfinite(derivative).all(axis=(1, 2))
    for _ in range(MOST_STRIDES):
        # At a border derivatives cannot be had by differences: the ray stays there.
        active = np.flatnonzero(known & (share < 1.0) & (stride >= LEAST_STRIDE))
        if not len(active):
            break
        wanted = np.minimum(share[active] + stride[active], 1.0)
        trial, follows = _corrected(miss, start[active], derivative[active], wanted, active, size)
        new = np.full((len(active), 2, 2), np.nan)
        new[follows] = _derivative(miss, trial[follows], wanted[follows], active[follows], difference)
        follows &= _determinant(new) * _determinant(derivative[active]) > 0.0
        on = active[follows]
        start[on], derivative[on], share[on] = trial[follows], new[follows], wanted[follows]
        stride[active] = np.where(follows, 2.0, 0.5) * stride[active]
    return ContinuedRays(start, derivative, share)


def _corrected(
    miss: Miss, start: Array, derivative: Array, share: Array, which: NDArray[np.int64], size: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Return where Newton's method leads from rays (m, 2), and whether it contracts all the way."""
    start, derivative = start.copy(), derivative.copy()
    off = miss(start, share, which)
    left = _length(off)
    follows = np.isfinite(left)
    for _ in range(CORRECTIONS):
        active = np.flatnonzero(follows & (left > TOLERANCE * size))
        if not len(active):
            break
        step = -_solved(derivative[active], off[active])
        trial = start[active] + step
        new = miss(trial, share[active], which[active])
        new_left = _length(new)
        contracts = new_left <= CONTRACTION * left[active]
        # Rounding ends the contraction of rays that have arrived.
        settled = ~contracts & (left[active] <= ARRIVED * size)
        follows[active] = contracts | settled
        left[active[settled]] = 0.0
        on = active[contracts]
        surplus = new[contracts] - off[on] - np.einsum("nij,nj->ni", derivative[on], step[contracts])
        moved = step[contracts]
        derivative[on] += surplus[:, :, None] * (moved / np.square(moved).sum(axis=1, keepdims=True))[:, None, :]
        start[on], off[on], left[on] = trial[contracts], new[contracts], new_left[contracts]
    return start, follows & (left <= ARRIVED * size)


def _derivative(miss: Miss, start: Array, share: Array, which: NDArray[np.int64], difference: float) -> Array:
    """Return the derivative (m, 2, 2) of misses by the numbers of rays, by central differences."""
    sides = difference * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    four = miss((start + sides[:, None]).reshape(-1, 2), np.tile(share, 4), np.tile(which, 4)).reshape(4, -1, 2)
    return np.stack([(four[0] - four[1]), (four[2] - four[3])], axis=2) / (2.0 * difference)


def _determinant(matrices: Array) -> Array:
    return np.asarray(matrices[:, 0, 0] * matrices[:, 1, 1] - matrices[:, 0, 1] * matrices[:, 1, 0])


def _first(landing: Landing, guess: Array, derivative: Array | float) -> tuple[Array, Array]:
    """Return where the guessed rays land, (n, 2), and the derivative there, (n, 2, 2)."""
    every = np.arange(len(guess))
    if isinstance(derivative, np.ndarray):
        return landing(guess, every), derivative.copy()
    shifts = derivative * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    here, *changed = landing((guess + shifts[:, None]).reshape(-1, 2), np.tile(every, 3)).reshape(3, -1, 2)
    return here, np.stack([(there - here) / derivative for there in changed], axis=2)


def _solved(derivative: Array, error: Array) -> Array:
    """Return Newton's steps (n, 2) for errors (n, 2); not finite where the derivative is singular."""
    (a, b), (c, d) = derivative[:, 0].T, derivative[:, 1].T
    with np.errstate(divide="ignore", invalid="ignore"):
        over = 1.0 / (a * d - b * c)
        x, y = error.T
        return np.column_stack([(d * x - b * y) * over, (a * y - c * x) * over])


def _length(vectors: Array) -> Array:
    return np.asarray(np.hypot(vectors[:, 0], vectors[:, 1]))
