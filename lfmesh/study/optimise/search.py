"""Search for the best camera of a design: bounded least squares, starts, choices, differential evolution.

The algorithms are scipy's `least_squares` (trust region reflective) with the problem's derivatives, Latin hypercubes
and `differential_evolution`. A camera that is not valid, or loses a ray, has no residuals; steps to one are shortened.
The search ends early if only rounding error is left of the merit.
"""

import contextlib
import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from lfmesh.notebook import Say
from lfmesh.study.optimise.idle import Idle, idle_variables
from lfmesh.study.optimise.jet import Jet
from lfmesh.study.optimise.problem import KEPT, Picks, Place, Pressure, Problem, Rated, joined, picked

Array = NDArray[np.float64]

ROUNDS = 20
"""Largest number of least-squares rounds with constraints, each with more pressure."""

PRESSURE = 0.1
"""Initial stiffness of constraints, over the merit: low, so that the search is not forced along them from afar."""

STIFFER = 4.0
"""Factor of the stiffness if a round has not reduced the excess to `FALL` times its value."""

FALL = 0.25

STEADY = 1e-3
"""Relative change of the constraints' multipliers at which they have converged."""

SETTLED = 1e-10
"""Relative change of merit and positions at which a least-squares search has converged."""

NO_GRADIENT = float(np.finfo(np.float64).eps)
"""Gradient at which a search ends at once, as for variables without effect."""

COARSE = 1e-3
"""Like `SETTLED`, for the first of several rounds; later ones are finer by `STIFFER`."""

MOST_COMBINATIONS = 24
"""Largest number of combinations of choices that are all searched; otherwise one choice is changed at a time."""

DRAWS = 20
"""Random cameras per start; one of them must be valid."""

POPULATION = 8
"""Population of differential evolution per variable."""

NONE = 1e300
"""Substitute for the merit of a camera that has none."""

LIMITS_ALONE = Pressure(1.0, 0.0, merit=0.0)
"""Pressure that ignores the merit."""


class _ExactError(Exception):
    """The best camera keeps all limits, and only rounding error is left of its merit."""


class Search:
    """Search that keeps the best camera found.

    Parameters
    ----------
    problem : Problem
    say : callable, optional
        Called now and then with the progress in words.

    Attributes
    ----------
    first, best : Rated
    starts : int
        Initial cameras of least-squares searches.
    idle : Idle
        Variables without effect, which stay unchanged.
    searched, lost : set of Picks
        Values of choices that least-squares searches started with, or could not start with because the camera is not
        valid or loses a ray.
    cut : bool
        A search ended at its limit of cameras before it converged.
    left_open : set of str
        Figures with unknown derivatives where a search ended for that reason.
    beyond_reach : bool
        A search for the limits alone found no camera that keeps all of them.
    """

    def __init__(self, problem: Problem, say: Say | None = None) -> None:
        self.problem = problem
        self.say = say or (lambda _: None)
        self.first = self.best = problem.rated(problem.start)
        self.starts = 0
        self.idle = Idle((), ())
        self.searched: set[Picks] = set()
        self.lost: set[Picks] = set()
        self.cut = False
        self.left_open: set[str] = set()
        self.beyond_reach = False

    def run(self) -> None:
        """Search; the best camera is kept even after Ctrl-C. The search stops at an exact solution."""
        self.idle = idle_variables(self.problem)
        with contextlib.suppress(_ExactError):
            self._search()

    def _search(self) -> None:
        asked = self.problem.design.search
        if asked.method == "global":
            self._evolve()
            self._over_choices(self.best.place)
            return
        for place in self._places(asked.starts, asked.seed):
            self._over_choices(place)

    def rank(self, rated: Rated) -> tuple[float, float]:
        """Return the sort key of a camera, smaller is better: excess over limits, then merit."""
        if not rated.finite:
            return math.inf, math.inf
        return self.problem.violation(rated), self.problem.merit(rated)

    def _rated(self, at: Array, picks: Picks) -> Rated:
        start = self.problem.start
        at = np.clip(at, 0.0, 1.0)
        at[list(self.idle.knobs)] = start.at[list(self.idle.knobs)]
        for number in self.idle.choices:
            picks = (*picks[:number], start.picks[number], *picks[number + 1 :])
        rated = self.problem.rated(Place(at, picks))
        if self.rank(rated) < self.rank(self.best):
            self.best = rated
        first, best = (self.problem.merit(each) for each in (self.first, self.best))
        self.say(f"cameras tried: {self.problem.evaluations}, merit {best:.4g} ({first:.4g} at first)")
        if self.problem.is_exact(self.best, self.first):
            raise _ExactError
        return rated

    def _places(self, count: int, seed: int) -> Iterator[Place]:
        """Yield the scene's camera, followed by random ones from the ranges."""
        start = self.problem.start
        yield start
        if count == 1 or not self.problem.knobs:
            return
        from scipy.stats import qmc

        draws = qmc.LatinHypercube(len(self.problem.knobs), rng=np.random.default_rng(seed)).random(DRAWS * (count - 1))
        valid = (Place(at, start.picks) for at in draws if self._rated(at, start.picks).finite)
        yield from itertools.islice(valid, count - 1)

    def _over_choices(self, place: Place) -> None:
        """Search from a camera: over all combinations of choices, or by improving one choice at a time."""
        options: list[Sequence[int]] = [range(len(choice.values)) for choice in self.problem.choices]
        for number in self.idle.choices:
            options[number] = [self.problem.start.picks[number]]
        if math.prod(map(len, options)) <= MOST_COMBINATIONS:
            for picks in sorted(itertools.product(*options), key=lambda picks: picks != place.picks):
                self._descend(place.at, picks)
            return
        found = self._descend(place.at, place.picks)
        improves = True
        while improves:
            improves = False
            for number, numbers in enumerate(options):
                for pick in numbers:
                    if pick == found.place.picks[number]:
                        continue
                    other = self._descend(found.place.at, picked(found.place, number, pick).picks)
                    if self.rank(other) < self.rank(found):
                        found, improves = other, True

    def _descend(self, at: Array, picks: Picks) -> Rated:
        """Search by least squares from a camera, with rising pressure of the constraints; return the last camera.

        If pressure does not help, search for the limits alone, without the merit.
        """
        self.starts += 1
        rated = self._rated(at, picks)
        (self.searched if rated.finite else self.lost).add(rated.place.picks)
        if not rated.finite or not self.problem.knobs:
            return rated
        constraints = self.problem.design.constraints
        size = len(self.problem.excess(rated).value) if constraints else 0
        pressure = Pressure(PRESSURE * max(self.problem.merit(rated), KEPT), np.zeros(size))
        before = math.inf
        within_reach = False
        settled = COARSE if constraints else SETTLED
        for _ in range(ROUNDS if constraints else 1):
            rated = self._least_squares(rated, pressure, settled)
            if not constraints:
                break
            excess = self.problem.excess(rated).value
            worst, multipliers = float(excess.max()), pressure.raised(excess)
            change = np.abs(multipliers - pressure.multipliers).max()
            if worst <= KEPT and change <= STEADY * multipliers.max():
                if settled == SETTLED:
                    break
                settled = SETTLED
            resists = worst > max(FALL * before, KEPT)
            if resists and not within_reach:
                nearest = self._least_squares(rated, LIMITS_ALONE, SETTLED)
                if self.problem.violation(nearest):
                    self.beyond_reach = True
                    return nearest
                within_reach = True
            stiffness = pressure.stiffness * (STIFFER if resists else 1.0)
            pressure, before = Pressure(stiffness, multipliers), worst
            settled = max(SETTLED, settled / STIFFER)
        return rated

    def _least_squares(self, rated: Rated, pressure: Pressure, settled: float) -> Rated:
        from scipy.optimize import least_squares

        problem, picks = self.problem, rated.place.picks

        def pressed_by(found: Rated) -> Jet:
            residuals = problem.residuals(found)
            # A camera that is not valid has one unknown value per figure, even for figures with several values.
            if not problem.design.constraints or not found.finite:
                return residuals
            return joined([residuals * pressure.merit, pressure.residuals(problem.excess(found))])

        size = len(pressed_by(self._rated(rated.place.at, picks)).value)

        def values(at: Array) -> Array:
            value = pressed_by(self._rated(at, picks)).value
            return value if len(value) == size and np.isfinite(value).all() else np.full(size, np.inf)

        def slopes(at: Array) -> Array:
            rated = problem.rated(Place(at, picks), slopes=True)
            open_ones = {goal.title for goal, jet in rated.figures.items() if not np.isfinite(jet.slope).all()}
            if open_ones:
                # Nothing more can be found around an unknown camera: end the search.
                self.left_open |= open_ones
                return np.zeros((size, len(at)))
            slope = pressed_by(rated).slope
            return slope if len(slope) == size else np.zeros((size, len(at)))

        found = least_squares(
            values, np.clip(rated.place.at, 0.0, 1.0), slopes, bounds=(0.0, 1.0), x_scale="jac", ftol=settled,
            xtol=settled, gtol=NO_GRADIENT, max_nfev=problem.design.search.evaluations,
        )  # fmt: skip
        self.cut |= found.status == 0
        return self._rated(found.x, picks)

    def _evolve(self) -> None:
        """Search all ranges and values by differential evolution."""
        from scipy.optimize import differential_evolution

        problem = self.problem
        knobs, choices = len(problem.knobs), problem.choices
        scale = max(problem.merit(self.first), KEPT) / KEPT

        def badness(variables: Array) -> float:
            rated = self._rated(variables[:knobs], tuple(int(pick) for pick in np.round(variables[knobs:])))
            if not rated.finite:
                return NONE
            return problem.merit(rated) + scale * problem.violation(rated)

        number = knobs + len(choices)
        start = problem.start
        differential_evolution(
            badness,
            [(0.0, 1.0)] * knobs + [(0, len(choice.values) - 1) for choice in choices],
            integrality=[False] * knobs + [True] * len(choices),
            x0=np.array([*np.clip(start.at, 0.0, 1.0), *start.picks]),
            popsize=POPULATION,
            maxiter=max(1, problem.design.search.evaluations // (POPULATION * number)),
            rng=np.random.default_rng(problem.design.search.seed),
            polish=False,
        )
