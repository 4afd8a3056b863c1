"""Variables that affect no term or constraint of a design; a search leaves them unchanged."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.study.optimise.problem import Place, Problem, picked

Array = NDArray[np.float64]

PLACES, STEPS = (0.0, 1.0, 0.618), (-0.01, 0.01)
"""Positions in its range that a variable is moved to, and steps from its present one, as fractions of the range."""

SHARES = (0.0, 0.01, 0.1, 1.0, 1.0)
"""Fractions of the way from the initial camera to a random one: a variable may have no effect in one camera only."""

ALIKE = 1e-10
"""Relative difference below which figures count as equal; ray aiming leaves less."""


class Idle(NamedTuple):
    """Indices of the variables without effect.

    Attributes
    ----------
    knobs, choices : tuple of int
    """

    knobs: tuple[int, ...]
    choices: tuple[int, ...]

    def paths(self, problem: Problem) -> list[str]:
        """Return the paths of these variables."""
        knobs = [problem.knobs[number].variable.path for number in self.knobs]
        return knobs + [problem.choices[number].variable.path for number in self.choices]


def idle_variables(problem: Problem) -> Idle:
    """Find the variables that change no figure when moved alone, in the initial and in other cameras.

    Parameters
    ----------
    problem : Problem
    """
    knobs, choices = list(range(len(problem.knobs))), list(range(len(problem.choices)))
    # A variable is known to have no effect only if another of its values has figures in the initial camera.
    untold = True
    for place in _cameras(problem):
        if not (knobs or choices):
            break
        here = problem.beside(place)
        if np.isfinite(here).all():
            knobs = [each for each in knobs if not _matters(problem, here, _moved(place, each), untold)]
            choices = [each for each in choices if not _matters(problem, here, _chosen(problem, place, each), untold)]
        untold = False
    return Idle(tuple(knobs), tuple(choices))


def _cameras(problem: Problem) -> Iterator[Place]:
    """Yield the initial camera, others near it, and others anywhere in the ranges."""
    rng = np.random.default_rng(0)
    start = problem.start
    for share in SHARES:
        at = start.at + share * (rng.random(len(start.at)) - start.at)
        drawn = tuple(int(rng.integers(len(choice.values))) for choice in problem.choices)
        yield Place(at, drawn if share else start.picks)


def _moved(place: Place, number: int) -> Iterator[Place]:
    for moved in (*PLACES, *(min(max(place.at[number] + step, 0.0), 1.0) for step in STEPS)):
        if moved != place.at[number]:
            at = place.at.copy()
            at[number] = moved
            yield Place(at, place.picks)


def _chosen(problem: Problem, place: Place, number: int) -> Iterator[Place]:
    for pick in range(len(problem.choices[number].values)):
        if pick != place.picks[number]:
            yield picked(place, number, pick)


def _matters(problem: Problem, here: Array, others: Iterator[Place], untold: bool) -> bool:
    """Tell whether any camera has other figures; `untold` if none has figures at all."""
    for other in others:
        there = problem.beside(other)
        if there.shape != here.shape or not np.isfinite(there).all():
            continue
        untold = False
        if (np.abs(there - here) > ALIKE * np.maximum(np.abs(there), np.abs(here))).any():
            return True
    return untold
