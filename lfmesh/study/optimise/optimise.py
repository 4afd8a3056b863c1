"""`lf.optimise`: variation of a camera's numbers for the best merit."""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lfmesh.errors import LfmeshError
from lfmesh.notebook import Say, announced
from lfmesh.scene import Scene
from lfmesh.scene.files import load
from lfmesh.scene.literals import literal
from lfmesh.study.optimise.design_file import Constraint, DesignFile, Goal, Term, Variable, read_design
from lfmesh.study.optimise.figures import FIGURES, shown_value
from lfmesh.study.optimise.problem import KEPT, Problem, Rated, excess_of, is_rounding, share_of
from lfmesh.study.optimise.search import Search
from lfmesh.wrapping import wrapped

REACHED = 1e-3
"""Largest relative deviation from a target that counts as reached."""

UNLIKE, NOTHING = 0.1, 1e-6
"""Smallest relative difference of two values of a ray figure that is noted, and largest values that are ignored."""


@dataclass(frozen=True)
class TermResult:
    """A term of the merit, or a constraint, before and after the search.

    Attributes
    ----------
    goal : Term or Constraint
    before, after : float
        The figure, reduced to one number as in reports.
    share_before, share_after : float
        Contribution of a term to the merit; largest relative excess over a constraint's limit, 0 if kept.
    """

    goal: Term | Constraint
    before: float
    after: float
    share_before: float
    share_after: float

    @property
    def share_left(self) -> float:
        """Contribution to the merit after the search; 0 if it is rounding error."""
        goal = self.goal
        rounding = isinstance(goal, Term) and is_rounding(goal, self.share_after, self.share_before)
        return 0.0 if rounding else self.share_after

    @property
    def missed(self) -> str:
        """Missed target or broken limit in words, or ""."""
        goal = self.goal
        if isinstance(goal, Constraint):
            return f"{goal.title} = {self.after:.6g} violates {goal.in_words}" if self.share_after else ""
        off = abs(self.after - goal.wanted)
        if goal.target is None or off <= REACHED * (abs(goal.target) or abs(self.before)):
            return ""
        return f"{goal.title} = {self.after:.6g} is {off:.4g} from its target {goal.target:g}"


@dataclass(frozen=True)
class VariableResult:
    """A variable before and after the search.

    Attributes
    ----------
    variable : Variable
    before, after : object
        Values of the scene.
    note : str
        At which end of its range it is, if any, or that no term depends on it.
    """

    variable: Variable
    before: Any
    after: Any
    note: str = ""


@dataclass(frozen=True)
class Optimum:
    """Best camera that a search has found.

    Attributes
    ----------
    scene : Scene
        The best camera; distances solved from `focus_mm` are left to it.
    first : Scene
        Initial camera.
    merit_before, merit_after : float
        Sum of the terms: (weight · (value − target))².
    terms, constraints : tuple of TermResult
    variables : tuple of VariableResult
    evaluations : int
        Cameras tried, without those for derivatives.
    starts : int
        Number of least-squares searches.
    seconds : float
        Wall-clock time.
    complete : bool
        False if Ctrl-C ended the search.
    notes : tuple of str
        Method of the derivatives, and properties that the merit ignores.
    """

    scene: Scene
    first: Scene
    merit_before: float
    merit_after: float
    terms: tuple[TermResult, ...]
    constraints: tuple[TermResult, ...]
    variables: tuple[VariableResult, ...]
    evaluations: int
    starts: int
    seconds: float
    complete: bool
    notes: tuple[str, ...] = ()

    @property
    def missed(self) -> tuple[str, ...]:
        """Missed targets and broken limits, one line each."""
        return tuple(each.missed for each in (*self.terms, *self.constraints) if each.missed)

    @property
    def violated(self) -> tuple[str, ...]:
        """Broken limits, one line each."""
        return tuple(each.missed for each in self.constraints if each.missed)

    @property
    def effort(self) -> str:
        """Effort of the search in words, with a note if it was stopped."""
        ended = "" if self.complete else "; stopped before the search had ended"
        searches = f"{self.starts} search{'' if self.starts == 1 else 'es'}"
        return f"{self.evaluations} cameras tried, {searches}, {self.seconds:.1f} s{ended}"

    def __repr__(self) -> str:
        return f"<Optimum: merit {self.merit_left:.6g} from {self.merit_before:.6g}, {len(self.missed)} not reached>"

    @property
    def merit_left(self) -> float:
        """Merit after the search, without rounding errors."""
        return sum(each.share_left for each in self.terms)

    def lines(self) -> list[str]:
        """Return the outcome for a terminal, one line per item.

        Returns
        -------
        list of str
        """
        lines = [f"merit {self.merit_before:.6g} before, {self.merit_left:.6g} after"]
        wide = max(len(each.goal.title) for each in (*self.terms, *self.constraints)) + 2
        lines.append(f"{'term':<{wide}}{'target':>12}{'before':>14}{'after':>14}{'of the merit':>14}")
        for each in self.terms:
            assert isinstance(each.goal, Term)
            numbers = f"{each.goal.wanted:>12.6g}{each.before:>14.6g}{each.after:>14.6g}{each.share_left:>14.6g}"
            lines.append(f"{each.goal.title:<{wide}}{numbers}")
        for each in self.constraints:
            assert isinstance(each.goal, Constraint)
            state = f"violates {each.goal.in_words}" if each.share_after else f"keeps {each.goal.in_words}"
            lines.append(f"{each.goal.title:<{wide}}{'':>12}{each.before:>14.6g}{each.after:>14.6g}  {state}")
        wide = max(len(each.variable.title) for each in self.variables) + 2
        lines.append(f"{'variable':<{wide}}{'before':>18}{'after':>18}")
        for found in self.variables:
            note = f"  {found.note}" if found.note else ""
            lines.append(
                f"{found.variable.title:<{wide}}{shown_number(found.before):>18}{shown_number(found.after):>18}{note}"
            )
        told = [*(f"not reached: {line}" for line in self.missed), *(f"note: {line}" for line in self.notes)]
        lines += [line for each in told for line in wrapped(each).splitlines()]
        lines.append(self.effort)
        return lines

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def as_dict(self) -> dict[str, Any]:
        """Return the outcome as plain values.

        Returns
        -------
        dict
        """
        return {
            "merit_before": self.merit_before,
            "merit_after": self.merit_after,
            "terms": [_facts(each) for each in self.terms],
            "constraints": [_facts(each) for each in self.constraints],
            "variables": [
                {"path": each.variable.path, "before": each.before, "after": each.after, "note": each.note}
                for each in self.variables
            ],
            "not_reached": list(self.missed),
            "cameras_tried": self.evaluations,
            "searches": self.starts,
            "seconds": self.seconds,
            "complete": self.complete,
            "notes": list(self.notes),
        }


def optimise(
    scene: Scene,
    variables: Sequence[Variable | Mapping[str, Any]],
    merit: Sequence[Term | Mapping[str, Any]],
    *,
    constraints: Sequence[Constraint | Mapping[str, Any]] = (),
    rays: Mapping[str, Any] | None = None,
    search: Mapping[str, Any] | None = None,
    progress: Say | bool | None = None,
) -> Optimum:
    """Vary numbers of a camera for the best merit.

    The keys are those of a design file, see `lfmesh/study/README.md`.

    Parameters
    ----------
    scene : Scene
        Initial camera.
    variables : sequence of dict
        Keys of `[[variables]]`: path, and range or values.
    merit : sequence of dict
        Keys of `[[merit]]`: metric, target, weight, field, per_mm.
    constraints : sequence of dict
        Keys of `[[constraints]]`: metric, least, most, field, per_mm.
    rays : dict, optional
        Keys of `[rays]`: object_mm, height_mm, wavelengths_nm, across.
    search : dict, optional
        Keys of `[search]`: method, starts, seed, evaluations.
    progress : callable or bool, optional
        Called with the progress in words. True shows it, False nothing. Default: it is shown at a terminal or in a
        notebook after two seconds.

    Returns
    -------
    Optimum
        Best camera; after Ctrl-C, the best so far.

    Raises
    ------
    LfmeshError
        One line per fault.

    Examples
    --------
    >>> found = lf.optimise(
    ...     scene,
    ...     [{"path": "camera.lens.surfaces[0].radius_mm", "range": [15.0, 40.0]}],
    ...     [{"metric": "spot_rms_mm"}, {"metric": "efl_mm", "target": 50.0}],
    ... )
    >>> lf.save(found.scene, "best.toml")
    """
    design = DesignFile(
        scene="scene", variables=tuple(variables), merit=tuple(merit), constraints=tuple(constraints),
        rays=rays or {}, search=search or {},
    )  # fmt: skip
    return best_of(Problem(design, scene), progress)


def load_design(path: str | Path) -> Problem:
    """Read a design file and its scene.

    Raises
    ------
    LfmeshError
        One line per fault.
    """
    path = Path(path)
    design = read_design(path)
    return Problem(design, load(path.parent / design.scene), str(path))


def best_of(problem: Problem, progress: Say | bool | None = None) -> Optimum:
    """Search for the best camera of a design; see `optimise`.

    Parameters
    ----------
    problem : Problem
    progress : callable or bool, optional
    """
    with announced(progress) as say:
        return _searched(problem, say)


def _searched(problem: Problem, say: Say) -> Optimum:
    began = time.perf_counter()
    search = Search(problem, say)
    complete = False
    try:
        search.run()
        complete = True
        return _optimum(problem, search, began, complete=complete)
    except KeyboardInterrupt:
        # An interrupt after the search does not lose the result either.
        return _optimum(problem, search, began, complete=complete)


def _optimum(problem: Problem, search: Search, began: float, *, complete: bool) -> Optimum:
    design, first, best = problem.design, search.first, search.best
    return Optimum(
        scene=problem.scene_at(best.place),
        first=problem.scene,
        merit_before=problem.merit(first),
        merit_after=problem.merit(best),
        terms=tuple(_compared(goal, first, best) for goal in design.merit),
        constraints=tuple(_compared(goal, first, best) for goal in design.constraints),
        variables=_variables(problem, search),
        evaluations=problem.evaluations,
        starts=search.starts,
        seconds=time.perf_counter() - began,
        complete=complete,
        notes=(*_notes(problem, search), *_differences(problem, best)),
    )


def _compared(goal: Term | Constraint, first: Rated, best: Rated) -> TermResult:
    values, shares = [], []
    for rated in (first, best):
        jet = rated.figures[goal]
        values.append(shown_value(goal.metric, jet.value))
        if isinstance(goal, Term):
            shares.append(share_of(goal, rated))
        else:
            excess = float(excess_of(goal, jet).value.max())
            shares.append(excess if excess > KEPT else 0.0)
    return TermResult(goal, values[0], values[1], shares[0], shares[1])


def _variables(problem: Problem, search: Search) -> tuple[VariableResult, ...]:
    before, after = (problem.values_at(rated.place) for rated in (search.first, search.best))
    notes = {
        knob.variable.path: knob.bound_in_words(float(at))
        for knob, at in zip(problem.knobs, search.best.place.at, strict=True)
    } | dict.fromkeys(search.idle.paths(problem), "left as it was")
    return tuple(
        VariableResult(each, before[each.path], after[each.path], notes.get(each.path, ""))
        for each in problem.design.variables
    )


def _notes(problem: Problem, search: Search) -> tuple[str, ...]:
    sources = {FIGURES[goal.metric].source for goal in problem.goals}
    notes = [f"no term depends on {path}: it was left as it is" for path in search.idle.paths(problem)]
    notes += _not_searched(problem, search)
    if search.cut:
        most = problem.design.search.evaluations
        notes.append(f"a search ended after evaluations = {most} cameras, before it converged: allow more")
    notes += [
        f"a search ended at a camera around which {title} is unknown, so it has no derivative: begin elsewhere, or "
        "raise samples"
        for title in sorted(search.left_open)
    ]
    if search.beyond_reach and problem.violation(search.best):
        notes += [
            f"{goal.title}: a search for the limits alone found no camera that keeps {goal.in_words}; the nearest has "
            f"{shown_value(goal.metric, search.best.figures[goal].value):.6g}"
            for goal in problem.design.constraints
            if excess_of(goal, search.best.figures[goal]).value.max() > KEPT
        ]
    if "rays" in sources:
        rays = problem.rays
        assert rays is not None
        if rays.stopped:
            named = "" if problem.design.rays.height_mm is None else f" = {problem.design.rays.height_mm:g}"
            notes.append(
                f"height_mm{named} in [rays]: the starting camera stops most rays, and the terms use only the rays "
                f"that pass: {rays.stopped}; give a smaller height_mm"
            )
        notes.append(
            f"the search follows the {rays.passed} rays that pass the starting lens, equally weighted, and does not "
            "update vignetting: check the result with lfmesh lens sheet"
        )
    if "render" in sources:
        notes.append("derivatives of pictures are differences over 1 % of a range, with common random numbers")
    return tuple(notes)


def _not_searched(problem: Problem, search: Search) -> Iterator[str]:
    """Yield values that no search could start with."""
    for number, choice in enumerate(problem.choices):
        searched, lost = ({picks[number] for picks in seen} for seen in (search.searched, search.lost))
        for pick in sorted(lost - searched):
            yield (
                f"{choice.variable.path} = {literal(choice.values[pick])} was not searched: at the starting points, "
                "the camera with it is not valid, or rays have no path in it"
            )


def _differences(problem: Problem, best: Rated) -> Iterator[str]:
    """Yield ray figures that differ with a denser grid of rays through the best camera."""
    try:
        again = problem.looked_at_again(best.place)
    except LfmeshError as error:
        yield f"the best camera could not be checked with other rays: {error}"
        return
    for goal, value in again.items():
        searched = shown_value(goal.metric, best.figures[goal].value)
        if not abs(value - searched) <= max(UNLIKE * max(abs(value), abs(searched)), NOTHING):
            other = "not known" if np.isnan(value) else f"{value:.4g}"
            yield (
                f"{goal.title} is {searched:.4g} by the rays of the search, but {other} by twice as many across that "
                "pass the best camera: raise across in [rays], or check its clear apertures"
            )


def _facts(result: TermResult) -> dict[str, Any]:
    goal: Goal = result.goal
    asked = {key: value for key, value in goal.model_dump().items() if value is not None}
    return {
        **asked,
        "title": FIGURES[goal.metric].title,
        "before": result.before,
        "after": result.after,
        "merit_before" if isinstance(goal, Term) else "excess_before": result.share_before,
        "merit_after" if isinstance(goal, Term) else "excess_after": result.share_after,
    }


def shown_number(value: Any) -> str:
    """Return a value of the scene in words, with numbers to seven digits."""
    return f"{value:.7g}" if isinstance(value, float | np.floating) else literal(value)
