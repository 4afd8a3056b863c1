"""Least-squares problem of a design: residuals of its merit, with derivatives by its knobs."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry.objects.refractors import measured
from lfmesh.scene import Scene, solved
from lfmesh.scene.files import with_lens_file
from lfmesh.scene.first_order.compute import facts_of_solved
from lfmesh.scene.literals import literal
from lfmesh.study.metrics.metrics import METRICS, metric_of
from lfmesh.study.metrics.pictures import in_a_line
from lfmesh.study.optimise.design_file import Constraint, DesignFile, Goal, Rays, Term
from lfmesh.study.optimise.figures import FIGURES, camera_values, shown_value
from lfmesh.study.optimise.jet import Jet, constant
from lfmesh.study.optimise.knobs import Choice, Knob, knobs_of, with_number_paths
from lfmesh.study.optimise.ray_figures import RayFigures, ray_figures_of
from lfmesh.study.optimise.renders import Renders
from lfmesh.study.sweeps.plan import path_faults
from lfmesh.study.sweeps.study_file import refused

Array = NDArray[np.float64]

DIFFERENCE = 1e-5
"""Central-difference step of closed-form numbers, as a fraction of a knob's range."""

RENDERED_DIFFERENCE = 1e-2
"""The same for figures of pictures, which are noisy; random numbers are shared."""

KEPT = 1e-6
"""Largest relative excess over a limit that counts as kept."""

ROUNDING = 1e-9
"""Largest deviation of a term, relative to its target and to its initial deviation, that counts as rounding error."""

Picks = tuple[int, ...]
"""Index of the value of each choice."""


class Place(NamedTuple):
    """Position of a camera in the space of a design.

    Attributes
    ----------
    at : (n,) float64
        Position of each knob in its range, 0 to 1.
    picks : tuple of int
    """

    at: Array
    picks: Picks


class Rated(NamedTuple):
    """A camera with its figures.

    Attributes
    ----------
    place : Place
    figures : dict of Jet
        Figures by their terms and constraints.
    """

    place: Place
    figures: dict[Goal, Jet]

    @property
    def finite(self) -> bool:
        """True if the camera is valid, all rays have a path and all figures a value."""
        return all(np.isfinite(jet.value).all() for jet in self.figures.values())


@dataclass(frozen=True)
class Pressure:
    """Augmented Lagrangian: pressure of the constraints against the merit.

    Attributes
    ----------
    stiffness : float
    multipliers : (k,) float64, or a number for all
        Multipliers of the excesses.
    merit : float
        Weight of the merit's residuals.
    """

    stiffness: float
    multipliers: Array | float
    merit: float = 1.0

    def residuals(self, excess: Jet) -> Jet:
        """Return the residuals √µ max(0, c + λ/µ) of excesses c over limits, (k,)."""
        root = float(np.sqrt(self.stiffness))
        pressed = (excess + self.multipliers / self.stiffness) * root
        active = pressed.value > 0.0
        return Jet(np.where(active, pressed.value, 0.0), np.where(active[:, None], pressed.slope, 0.0))

    def raised(self, excess: Array) -> Array:
        """Return the multipliers after a search that ended with given excesses."""
        return np.maximum(0.0, self.multipliers + self.stiffness * excess)


class Problem:
    """A design with validated variables, merit and constraints.

    Parameters
    ----------
    design : DesignFile
    scene : Scene
        Initial camera.
    name : str
        Name of the design in messages.

    Raises
    ------
    LfmeshError
        One line per fault.
    """

    def __init__(self, design: DesignFile, scene: Scene, name: str = "design") -> None:
        lens = with_lens_file(scene.camera.lens, scene.folder)
        if lens is not scene.camera.lens:
            scene = scene.changed({"camera.lens": lens.model_dump()})
        faults = list(path_faults(design.changes, scene, "changes"))
        if faults:
            raise refused(name, faults)
        self.scene = scene.changed(design.changes) if design.changes else scene
        self.design = design = with_number_paths(design, self.scene)
        self.knobs: list[Knob]
        self.choices: list[Choice]
        solved_scene = self._solved(self.scene)
        self.knobs, self.choices, faults = knobs_of(design.variables, self.scene, solved_scene)
        faults += [
            f"{key}[{i}].metric: {goal.metric} needs a camera with a microlens array"
            for key, goals in (("merit", design.merit), ("constraints", design.constraints))
            for i, goal in enumerate(goals)
            if solved_scene.camera.mla is None and _is_of_array(goal.metric)
        ]
        if faults:
            raise refused(name, faults)
        self.evaluations = 0
        self._last: Rated | None = None
        self._refuse_unknown_values(name)
        if faults := list(self._value_faults()):
            raise refused(name, faults)

    @property
    def goals(self) -> tuple[Goal, ...]:
        """Terms of the merit, followed by the constraints."""
        return (*self.design.merit, *self.design.constraints)

    @cached_property
    def start(self) -> Place:
        """Initial camera."""
        at = np.array([knob.place(knob.start) for knob in self.knobs])
        return Place(at, tuple(choice.start for choice in self.choices))

    @cached_property
    def rays(self) -> RayFigures | None:
        """Rays of the design; None if no figure needs rays."""
        return self._rays_of(self.scene, self.design.rays) if self.of_rays else None

    @property
    def of_rays(self) -> list[Goal]:
        """Terms and constraints on ray figures."""
        return [goal for goal in self.goals if FIGURES[goal.metric].source == "rays"]

    @cached_property
    def renders(self) -> Renders | None:
        """Pictures of the design; None if no figure needs pictures."""
        columns = dict.fromkeys(goal.metric for goal in self.goals if FIGURES[goal.metric].source == "render")
        return Renders(self._solved(self.scene), tuple(columns)) if columns else None

    def scene_at(self, place: Place) -> Scene:
        """Return the scene of a camera, before its distances are solved.

        Raises
        ------
        LfmeshError
            The scene is not valid.
        """
        return self.scene.changed(self.values_at(place)) if self.design.variables else self.scene

    def values_at(self, place: Place) -> dict[str, Any]:
        """Return the values of all variables by path, in order; unchanged variables keep the scene's exact value."""
        found: dict[str, Any] = {}
        for knob, at, first in zip(self.knobs, place.at, self.start.at, strict=True):
            found[knob.variable.path] = knob.start if at == first else knob.value(float(at))
        for choice, pick in zip(self.choices, place.picks, strict=True):
            found[choice.variable.path] = choice.values[pick]
        return {variable.path: found[variable.path] for variable in self.design.variables}

    def rated(self, place: Place, *, slopes: bool = False) -> Rated:
        """Return a camera's figures, NaN if it is not valid, and optionally their derivatives by the knobs.

        Rays are differentiated by the numbers of the lens while traced; these numbers and figures of the solved scene
        by central differences; pictures by differences with common random numbers.

        Parameters
        ----------
        place : Place
        slopes : bool
        """
        if not slopes and self._last is not None and _same(self._last.place, place):
            return self._last
        self.evaluations += not slopes
        numbers = _with_slopes(self._numbers, place, DIFFERENCE if slopes else 0.0)
        pictures = _with_slopes(self._pictures, place, RENDERED_DIFFERENCE if slopes else 0.0)
        figures = self._figures(numbers, pictures)
        rated = Rated(place, figures)
        if not slopes:
            self._last = rated
        return rated

    def beside(self, place: Place) -> Array:
        """Return all figures' values of a camera, without effect on the search's counts or caches.

        Parameters
        ----------
        place : Place

        Returns
        -------
        (k,) float64
            NaN if the camera is not valid.
        """
        guess = self.rays.guess if self.rays is not None else None
        figures = self._figures(_with_slopes(self._numbers, place, 0.0), _with_slopes(self._pictures, place, 0.0))
        if self.rays is not None and guess is not None:
            self.rays.guess = guess
        return joined([figures[goal] for goal in self.goals]).value

    def residuals(self, rated: Rated) -> Jet:
        """Return the residuals of the merit (the sum of their squares)."""
        return joined([term_residuals(term, rated.figures[term]) for term in self.design.merit])

    def excess(self, rated: Rated) -> Jet:
        """Return the relative excesses over limits, negative inside, (k,), with derivatives."""
        return joined([excess_of(each, rated.figures[each]) for each in self.design.constraints])

    def merit(self, rated: Rated) -> float:
        """Return the merit; smaller is better."""
        residuals = self.residuals(rated).value
        return float(residuals @ residuals)

    def violation(self, rated: Rated) -> float:
        """Return the largest relative excess over a limit; 0 if all are kept, NaN if unknown."""
        excess = float(self.excess(rated).value.max(initial=0.0)) if self.design.constraints else 0.0
        return 0.0 if excess <= KEPT else excess

    def is_exact(self, rated: Rated, first: Rated) -> bool:
        """Tell whether a camera keeps all limits, with only rounding error in each term of the merit.

        Parameters
        ----------
        rated, first : Rated
            The camera, with all figures known, and the initial one.
        """
        left = (is_rounding(term, share_of(term, rated), share_of(term, first)) for term in self.design.merit)
        return not self.violation(rated) and all(left)

    def looked_at_again(self, place: Place) -> dict[Goal, float]:
        """Return ray figures from more than twice as many rays across that pass this camera.

        Exactly twice as many would have the same moiré.

        Parameters
        ----------
        place : Place

        Raises
        ------
        LfmeshError
            Rays of a field do not pass the camera.
        """
        if not self.of_rays:
            return {}
        scene, asked = self.scene_at(place), self.design.rays
        rays = self._rays_of(scene, asked.model_copy(update={"across": 2 * asked.across + 3}))
        numbers = constant(rays.layout.numbers_of(self._solved(scene)), 0)
        landed = rays.landed(numbers)
        return {goal: shown_value(goal.metric, rays.values(goal, landed, numbers).value) for goal in self.of_rays}

    def _rays_of(self, scene: Scene, asked: Rays) -> RayFigures:
        shares = tuple(goal.field for goal in self.of_rays if goal.field is not None)
        return ray_figures_of(self._solved(scene), asked, shares)

    def _solved(self, scene: Scene) -> Scene:
        return solved(measured(scene))

    def _numbers(self, place: Place) -> Array:
        """Return all closed-form inputs of figures: numbers of the lens, figures of the solved scene."""
        scene = self._solved(self.scene_at(place))
        lens = self.rays.layout.numbers_of(scene) if self.rays is not None else np.empty(0)
        facts = facts_of_solved(scene)
        return np.concatenate([lens, *(camera_values(goal.metric, scene, facts) for goal in self._of_camera)])

    def _pictures(self, place: Place) -> Array:
        return np.empty(0) if self.renders is None else self.renders.values(self._solved(self.scene_at(place)))

    @property
    def _of_camera(self) -> list[Goal]:
        return [goal for goal in self.goals if FIGURES[goal.metric].source == "camera"]

    @cached_property
    def _sizes(self) -> tuple[int, list[int]]:
        """Numbers of lens numbers, and of values of each figure of the solved scene."""
        scene = self._solved(self.scene)
        facts = facts_of_solved(scene)
        lens = len(self.rays.layout.numbers_of(scene)) if self.rays is not None else 0
        return lens, [len(camera_values(goal.metric, scene, facts)) for goal in self._of_camera]

    def _figures(self, numbers: Jet | None, pictures: Jet | None) -> dict[Goal, Jet]:
        if numbers is None or pictures is None:
            return dict.fromkeys(self.goals, Jet(np.full(1, np.nan), np.zeros((1, len(self.knobs)))))
        lens, sizes = self._sizes
        found: dict[Goal, Jet] = {}
        ends = np.cumsum([lens, *sizes])
        for goal, first, last in zip(self._of_camera, ends, ends[1:], strict=False):
            found[goal] = numbers.picked(slice(int(first), int(last)))
        if self.rays is not None:
            of_lens = numbers.picked(slice(0, lens))
            landed = self.rays.landed(of_lens)
            for goal in self.of_rays:
                found[goal] = self.rays.values(goal, landed, of_lens)
        for goal in self.goals:
            if self.renders is not None and goal.metric in self.renders.columns:
                at = self.renders.columns.index(goal.metric)
                found[goal] = pictures.picked(slice(at, at + 1))
        return found

    def _refuse_unknown_values(self, name: str) -> None:
        """Refuse a design if the initial camera has no merit."""
        # Check the initial camera first: a fault of it has its own message.
        self._numbers(self.start)
        rated = self.rated(self.start)
        faults = [
            f"{key}[{i}].metric: {goal.metric} is {self._in_words(goal, rated)}; start with a camera that has a number"
            for key, goals in (("merit", self.design.merit), ("constraints", self.design.constraints))
            for i, goal in enumerate(goals)
            if not np.isfinite(rated.figures[goal].value).all()
        ]
        if faults:
            raise refused(name, faults)

    def _in_words(self, goal: Goal, rated: Rated) -> str:
        """Return the value of a figure in the initial camera, or why it is unknown."""
        value = shown_value(goal.metric, rated.figures[goal].value)
        if not np.isnan(value):
            return f"{value:g} in the starting camera"
        why = self.renders.unknown.get(goal.metric, "") if self.renders is not None else ""
        return "not known in the starting camera" + (f": {why}" if why else "")

    def _value_faults(self) -> Iterator[str]:
        """Yield candidate values that are not valid in the initial camera, in the scene's words."""
        size = len(self._numbers(self.start))
        for number, choice in enumerate(self.choices):
            path, variable = choice.variable.path, self.design.variables.index(choice.variable)
            for pick, value in enumerate(choice.values):
                reason = "is of a lens with another number of surfaces than the starting camera's"
                with_it = picked(self.start, number, pick)
                try:
                    if len(self._numbers(with_it)) == size:
                        continue
                except LfmeshError as error:
                    reason = in_a_line(error).removeprefix(f"{path} = {literal(value)}: ")
                yield f"variables[{variable}].values[{pick}]: {path} = {literal(value)}: {reason}"


def term_residuals(term: Term, values: Jet) -> Jet:
    """Return the residuals of a term; their squares add up to (weight · (value − target))²."""
    if FIGURES[term.metric].shown == "rms":
        if term.wanted == 0.0:
            return values * term.weight
        square = Jet((values.value @ values.value)[None], 2.0 * (values.value @ values.slope)[None])
        return (square.root() - term.wanted) * term.weight
    return (values - term.wanted) * (term.weight / float(np.sqrt(len(values.value))))


def share_of(term: Term, rated: Rated) -> float:
    """Return the contribution of a term to a camera's merit."""
    residuals = term_residuals(term, rated.figures[term]).value
    return float(residuals @ residuals)


def is_rounding(term: Term, share: float, first: float) -> bool:
    """Tell whether a term's contribution to the merit is only rounding error.

    Parameters
    ----------
    term : Term
    share, first : float
        Present and initial contribution, see `share_of`; the target counts, too.
    """
    return share <= ROUNDING**2 * max(first, (term.weight * term.wanted) ** 2)


def excess_of(constraint: Constraint, values: Jet) -> Jet:
    """Return the relative excesses of values over limits; for a limit of 0, in the unit of the values."""
    if FIGURES[constraint.metric].shown == "rms":
        values = Jet((values.value @ values.value)[None], 2.0 * (values.value @ values.slope)[None]).root()
    beyond = []
    if constraint.least is not None:
        beyond.append((constraint.least - values) * (1.0 / (abs(constraint.least) or 1.0)))
    if constraint.most is not None:
        beyond.append((values - constraint.most) * (1.0 / (abs(constraint.most) or 1.0)))
    return joined(beyond)


def joined(parts: Sequence[Jet]) -> Jet:
    """Concatenate one-dimensional jets."""
    return Jet(np.concatenate([part.value for part in parts]), np.concatenate([part.slope for part in parts]))


def _with_slopes(function: Callable[[Place], Array], place: Place, share: float) -> Jet | None:
    """Return values with derivatives by central differences, one-sided next to unknown values.

    Parameters
    ----------
    function : callable
        Returns values of a camera, (k,); raises `LfmeshError` if it is not valid.
    place : Place
    share : float
        Step as a fraction of each range; 0: no derivatives.

    Returns
    -------
    Jet or None
        None if the camera itself is not valid; unknown derivatives are NaN.
    """
    middle = _known(function, place)
    if middle is None:
        return None
    slope = np.zeros((len(middle), len(place.at)))
    for number in range(len(place.at) if share and len(middle) else 0):
        step = np.zeros(len(place.at))
        step[number] = share

        def beside(steps: float, step: Array = step) -> Array:
            found = _known(function, Place(place.at + steps * step, place.picks))
            return np.full(len(middle), np.nan) if found is None else found

        before, after = beside(-1.0), beside(1.0)
        slope[:, number] = (after - before) / (2.0 * share)
        for sign, near in ((1.0, after), (-1.0, before)):
            lacking = np.isfinite(middle) & np.isnan(slope[:, number])
            if (lacking & np.isfinite(near)).any():
                one_sided = sign * (4.0 * near - beside(2.0 * sign) - 3.0 * middle) / (2.0 * share)
                slope[lacking, number] = one_sided[lacking]
    return Jet(middle, slope)


def _known(function: Callable[[Place], Array], place: Place) -> Array | None:
    try:
        return function(place)
    except LfmeshError:
        return None


def picked(place: Place, number: int, pick: int) -> Place:
    """Return a camera with another value of one choice.

    Parameters
    ----------
    place : Place
    number, pick : int
        Index of the choice, and of its new value.
    """
    return Place(place.at, (*place.picks[:number], pick, *place.picks[number + 1 :]))


def _same(place: Place, other: Place) -> bool:
    return place.picks == other.picks and np.array_equal(place.at, other.at)


def _is_of_array(metric: str) -> bool:
    """Tell whether a figure exists only for cameras with a microlens array."""
    if FIGURES[metric].source == "render":
        return METRICS[metric_of(metric)].needs_mla
    return metric.startswith(("lenslet", "micro", "view"))
