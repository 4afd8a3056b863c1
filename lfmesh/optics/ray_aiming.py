"""Ray aiming: find the ray of a two-parameter family that lands on a given point.

The parameters are, for example, a ray's slopes at a point or its entry point on the lens. Targets are apexes of the
array, points of the stop, or image points. The method is Newton's, with a derivative that every traced ray improves
(C. G. Broyden, "A class of methods for solving nonlinear simultaneous equations", Math. Comp. 19 (1965) 577).

`aim_rays` needs a good guess. `continue_rays` needs none: it starts from known rays and follows them while their
targets move, with steps that are halved if Newton's method does not contract (P. Deuflhard, Newton Methods for
Nonlinear Problems, 2004, chapter 5). A ray that cannot be followed to the end locates an edge.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Landing = Callable[[Array, NDArray[np.int64]], Array]
"""Maps parameters of rays (m, 2) and ray indices (m,) to landing points (m, 2), mm; NaN: lost."""

TOLERANCE = 1e-12
"""Miss, relative to the target's size, at which a ray is accepted without further steps."""

ARRIVED = 1e-7
"""Miss, relative to the target's size, within which a ray counts as arrived; facets may allow no better."""

MOST_STEPS = 24
"""Maximum number of Newton steps; for smooth surfaces four to six suffice."""

FRUITLESS = 3
"""Number of consecutive steps without improvement that end a search; steps that lose the ray are halved instead."""


CONTRACTION = 0.5
"""Largest ratio of a Newton step's miss to the previous one that keeps a continued ray on its branch."""

LEAST_STRIDE = 1e-6
"""Shortest continuation step, relative to the whole path."""

MOST_STRIDES = 128
"""Maximum number of strides; fields of lenses took at most 80, up to their edges. A ray with strides that neither grow
nor end, as on a surface that is nearly a ridge, stays where it is: its aiming does not converge."""

CORRECTIONS = 12
"""Maximum number of Newton steps per continuation step."""


class AimedRays(NamedTuple):
    """The best rays found by a search.

    Attributes
    ----------
    start : (n, 2) float64
        Parameters of each ray; NaN if not even the first guess landed.
    miss : (n,) float64, mm
        Distance of the landing point from the target.
    arrived : (n,) bool
        True if the ray lands on its target.
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
        Points to land on.
    guess : (n, 2) float64
        Initial parameters of each ray.
    derivative : (n, 2, 2) float64, or float
        Derivative of the landing point near the guess: [i, j] of coordinate i by parameter j. A float is a
        finite-difference step, at the cost of two extra rays each.
    size : float or (n,) float64, mm
        Size of the target, the unit of tolerances.
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
        Parameters of each ray, as far as it was followed.
    derivative : (n, 2, 2) float64
        Derivative of the miss there.
    share : (n,) float64
        Fraction of the path; 1 at its end.
    """

    start: Array
    derivative: Array
    share: Array

    @property
    def arrived(self) -> NDArray[np.bool_]:
        """(n,): True for rays that were followed to the end."""
        return np.asarray(self.share >= 1.0)


Miss = Callable[[Array, Array, NDArray[np.int64]], Array]
"""Maps parameters of rays (m, 2), fractions of the path (m,) and ray indices (m,) to misses (m, 2), mm."""


def continue_rays(
    miss: Miss, start: Array, difference: float, size: float, derivative: Array | None = None
) -> ContinuedRays:
    """Follow rays from targets that they hit to others, along a path from 0 to 1.

    A ray never leaves its branch: steps are short enough for Newton's method to contract, and the derivative's
    determinant keeps its sign. At the end of a branch, a border or a fold, the ray stays.

    Parameters
    ----------
    miss : callable
        Traces rays; see `Miss`. NaN: lost.
    start : (n, 2) float64
        Parameters of rays with zero miss at the fraction 0.
    difference : float
        Step in the parameters for finite differences.
    size : float, mm
        Size of the target, the unit of tolerances.
    derivative : (n, 2, 2) float64, optional
        Derivative of the misses at the fraction 0, if known.
    """
    start, share, stride = start.copy(), np.zeros(len(start)), np.ones(len(start))
    if derivative is None:
        derivative = _derivative(miss, start, share, np.arange(len(start)), difference)
    derivative = derivative.copy()
    known = np.isfinite(derivative).all(axis=(1, 2))
    for _ in range(MOST_STRIDES):
        # Finite differences fail at a border: the ray stays there.
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
    """Apply Newton's method to rays (m, 2); return the new parameters, and whether it contracts throughout."""
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
        # Rounding ends the contraction of arrived rays.
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
    """Return the derivative (m, 2, 2) of misses by the parameters of rays, by central differences."""
    sides = difference * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    four = miss((start + sides[:, None]).reshape(-1, 2), np.tile(share, 4), np.tile(which, 4)).reshape(4, -1, 2)
    return np.stack([(four[0] - four[1]), (four[2] - four[3])], axis=2) / (2.0 * difference)


def _determinant(matrices: Array) -> Array:
    return np.asarray(matrices[:, 0, 0] * matrices[:, 1, 1] - matrices[:, 0, 1] * matrices[:, 1, 0])


def _first(landing: Landing, guess: Array, derivative: Array | float) -> tuple[Array, Array]:
    """Return the landing points of the guessed rays, (n, 2), and the derivative there, (n, 2, 2)."""
    every = np.arange(len(guess))
    if isinstance(derivative, np.ndarray):
        return landing(guess, every), derivative.copy()
    shifts = derivative * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    here, *changed = landing((guess + shifts[:, None]).reshape(-1, 2), np.tile(every, 3)).reshape(3, -1, 2)
    return here, np.stack([(there - here) / derivative for there in changed], axis=2)


def _solved(derivative: Array, error: Array) -> Array:
    """Return Newton steps (n, 2) for errors (n, 2); not finite if the derivative is singular."""
    (a, b), (c, d) = derivative[:, 0].T, derivative[:, 1].T
    with np.errstate(divide="ignore", invalid="ignore"):
        over = 1.0 / (a * d - b * c)
        x, y = error.T
        return np.column_stack([(d * x - b * y) * over, (a * y - c * x) * over])


def _length(vectors: Array) -> Array:
    return np.asarray(np.hypot(vectors[:, 0], vectors[:, 1]))
