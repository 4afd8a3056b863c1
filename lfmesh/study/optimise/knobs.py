"""Variables of a design as numbers from 0 to 1, and their values in the scene."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from lfmesh.scene import Scene
from lfmesh.scene.literals import counted, literal
from lfmesh.study.optimise.design_file import DesignFile, Variable
from lfmesh.study.sweeps.axes import is_number
from lfmesh.study.sweeps.paths import number_path, value_at
from lfmesh.study.sweeps.plan import path_faults

AT_BOUND = 1e-3
"""Fraction of a range within which a value counts as at its end."""


@dataclass(frozen=True)
class Knob:
    """A number of the scene that varies within a range; a radius varies as its curvature.

    Attributes
    ----------
    variable : Variable
    start : float
        Value in the initial scene.
    """

    variable: Variable
    start: float

    @property
    def _ends(self) -> tuple[float, float]:
        low, high = self.variable.range or (0.0, 0.0)
        if not self.variable.is_radius:
            return low, high
        # Between radii of one sign the curvature falls with the radius; between opposite signs it rises through 0.
        return (1.0 / low, 1.0 / high) if low < 0.0 < high else (1.0 / high, 1.0 / low)

    def value(self, place: float) -> float:
        """Return the scene's value at a position in the range, 0 to 1; exact at the ends."""
        low, high = self._ends
        at = high if place == 1.0 else low + place * (high - low)
        if not self.variable.is_radius:
            return at
        return 1.0 / at if at else math.inf

    def place(self, value: float) -> float:
        """Return the position in the range of a value of the scene."""
        low, high = self._ends
        at = 1.0 / value if self.variable.is_radius else value
        return (at - low) / (high - low)

    def bound_in_words(self, place: float) -> str:
        """Return in words the end of the range at which a value is, or ""."""
        if not (place <= AT_BOUND or place >= 1.0 - AT_BOUND):
            return ""
        return f"at the end of its range, {self.value(0.0 if place <= AT_BOUND else 1.0):.6g}"


@dataclass(frozen=True)
class Choice:
    """A field of the scene that takes one of several values.

    Attributes
    ----------
    variable : Variable
    start : int
        Index of the value in the initial scene.
    """

    variable: Variable
    start: int

    @property
    def values(self) -> tuple[Any, ...]:
        """Values to choose from."""
        return self.variable.values or ()


def with_number_paths(design: DesignFile, scene: Scene) -> DesignFile:
    """Return a design with variables that name numbers: in a field with a list of one number, that number.

    Parameters
    ----------
    design : DesignFile
    scene : Scene

    Raises
    ------
    SceneError
        Two variables are the same number.
    """
    variables = tuple(
        each.model_copy(update={"path": number_path(each.path, each.values or (), scene)}) for each in design.variables
    )
    return DesignFile(**dict(design) | {"variables": variables})


def knobs_of(variables: Sequence[Variable], scene: Scene, ready: Scene) -> tuple[list[Knob], list[Choice], list[str]]:
    """Find the variables in the initial scene.

    Parameters
    ----------
    variables : sequence of Variable
    scene : Scene
        Scene with its lens read from its file.
    ready : Scene
        The same, solved.

    Returns
    -------
    knobs : list of Knob
    choices : list of Choice
    faults : list of str
        One line per fault.
    """
    knobs: list[Knob] = []
    choices: list[Choice] = []
    faults: list[str] = []
    for i, variable in enumerate(variables):
        found = [f"variables[{i}].{line}" for line in _faults(variable, scene, ready)]
        faults += found
        if found:
            continue
        value = value_at(scene, variable.path)
        if variable.range is not None:
            knobs.append(Knob(variable, float(value)))
        else:
            choices.append(Choice(variable, [_same(value, each) for each in variable.values or ()].index(True)))
    return knobs, choices, faults


def _faults(variable: Variable, scene: Scene, ready: Scene) -> Iterator[str]:
    where = list(path_faults({variable.path: None}, scene, "path"))
    yield from where
    if where:
        return
    value = value_at(scene, variable.path)
    named = f"path: {variable.path} is {_shown(value)} in the scene"
    if variable.range is None:
        if not any(_same(value, each) for each in variable.values or ()):
            yield f"{named}, which is not among the values; add it, the search begins there"
        return
    flat = variable.is_radius and value == math.inf
    if value is None and is_number(found := value_at(ready, variable.path)):
        yield f"{named}: it is solved, to {found:.6g} at present; give it a number to begin with, such as this one"
    elif value is None:
        yield f"{named}, solved or left out; give it a number to begin with"
    elif value and isinstance(value, tuple) and all(map(is_number, value)):
        yield f"path: {variable.path} has {counted(len(value), 'number')} in the scene; name one: {variable.path}[0]"
    elif not is_number(value) and not flat:
        yield f"{named}, not a number; give values to choose from in place of a range"
    elif isinstance(value, int):
        yield f"{named}, a whole number; give values to choose from in place of a range"
    elif not 0.0 <= Knob(variable, value).place(value) <= 1.0:
        yield _outside(variable, value)


def _outside(variable: Variable, value: float) -> str:
    """Return in words that a value of the scene is outside the range of its variable."""
    low, high = variable.range or (0.0, 0.0)
    words = f"range = [{low:g}, {high:g}]: {variable.path} is {value:g} in the scene, outside it"
    if not (variable.is_radius and low < 0.0 < high):
        return words
    to_flat = f"[{value:g}, {high:g}]" if value < 0.0 else f"[{low:g}, {value:g}]"
    one_sign = f"[{low:g}, {0.5 * value:g}]" if value < 0.0 else f"[{0.5 * value:g}, {high:g}]"
    return (
        f"{words}: the range of a radius through 0 passes through flat (infinite radius) and has R <= {low:g} and "
        f"R >= {high:g}; give ends nearer to 0, such as {to_flat}, or of one sign, such as {one_sign}"
    )


def _same(value: Any, other: Any) -> bool:
    return bool(value == other or (isinstance(other, list) and value == tuple(other)))


def _shown(value: Any) -> str:
    return "not given" if value is None else literal(value) if isinstance(value, (str, float, int)) else "a table"
