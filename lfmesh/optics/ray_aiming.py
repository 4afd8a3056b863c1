"""Ray aiming: find the ray of a two-parameter family that lands on a given point.

The two numbers of a ray are, for example, the slopes at which it leaves a point, or the place at which it enters the
lens. Targets are apexes of the array, points of the stop, or image points. The method is Newton's, with a derivative
that every traced ray improves (C. G. Broyden, "A class of methods for solving nonlinear simultaneous equations", Math.
Comp. 19 (1965) 577).

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
