"""Design file: a scene, its variables, and the merit of a camera."""

import difflib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from lfmesh.scene.model import Fault, Model
from lfmesh.scene.quantities import Count, FractionOfOne, Number, ObjectDistance, Positive, Text, Whole
from lfmesh.study.optimise.figures import FIGURES, OF_REPORT, figure_named
from lfmesh.study.sweeps.axes import name_and_unit, titled
from lfmesh.study.sweeps.study_file import read_tables

MOST_ACROSS, MOST_STARTS = 100, 10_000
"""Largest numbers of rays and starts: more would fill the memory."""

ALL_FIGURES = 'All of them: "Designs" in lfmesh/study/README.md, "Design file" in the reference of the documentation'
"""Reference to the list of figures, for messages."""


class Variable(Model):
    """A field of the scene that may vary."""

    path: Text
    """The field, such as "camera.lens.surfaces[0].radius_mm"."""
    range: tuple[Number, Number] | None = None
    """Least and largest value. Of a radius, a range from a negative to a positive number leads through flat: the radius
    is then the first one or flatter, or the second one or flatter."""
    values: tuple[Any, ...] | None = None
    """In place of `range`: the values to choose from, such as names of glasses."""
    label: Text | None = None
    """Name of the variable in reports."""

    @property
    def title(self) -> str:
        """Name of the variable in reports, with its unit."""
        return titled(self.path, self.label)

    @property
    def is_radius(self) -> bool:
        """True if it is a radius of curvature, which is varied by its reciprocal."""
        return self.path.rsplit(".", 1)[-1].split("[")[0] == "radius_mm"

    def faults(self) -> Iterator[Fault]:
        """Yield the faults of the range or the values."""
        if (self.range is None) == (self.values is None):
            yield Fault((), None, f"{'neither' if self.range is None else 'both'} range and values: give one of them")
            return
        if self.range is not None:
            low, high = self.range
            if not low < high:
                yield Fault(("range",), [low, high], "is empty or reversed: the first value must be below the second")
            elif self.is_radius and 0.0 in (low, high):
                yield Fault(("range",), [low, high], "a radius cannot be 0; give ends other than 0")
        elif len(self.values or ()) < 2:
            yield Fault(("values",), list(self.values or ()), "must be at least two values")


class Goal(Model):
    """A figure of a camera."""

    metric: Text
    """Name of the figure."""
    field: FractionOfOne | None = None
    """Of rays: share of the largest image height, 0 to 1; all of 0, 0.7 and 1 if omitted."""
    per_mm: Positive | None = None
    """Of "mtf": spatial frequency, line pairs a mm."""

    def faults(self) -> Iterator[Fault]:
        """Yield the faults of the figure."""
        figure = figure_named(self.metric)
        if figure is None:
            close = ", ".join(difflib.get_close_matches(self.metric, FIGURES, n=3, cutoff=0.0))
            yield Fault(("metric",), self.metric, f"unknown metric; the nearest are {close}. {ALL_FIGURES}")
            return
        if self.field is not None and figure.source != "rays":
            yield Fault(("field",), self.field, f"omit it: {self.metric} does not depend on the field")
        if self.field == 0.0 and self.metric == "distortion":
            yield Fault(("field",), 0.0, "must be above 0: there is no distortion on the axis")
        if (self.per_mm is None) == (self.metric == "mtf"):
            words = "missing: the frequency" if self.per_mm is None else f"omit it: {self.metric} has no frequency"
            yield Fault(("per_mm",), self.per_mm, words)

    @property
    def figure(self) -> tuple[str, float | None, float | None]:
        """Metric, field and frequency, which identify the figure."""
        return self.metric, self.field, self.per_mm

    @property
    def title(self) -> str:
        """Name of the figure in reports."""
        at = [f"{self.per_mm:g} per mm"] if self.per_mm is not None else []
        at += [f"field {self.field:g}"] if self.field is not None else []
        return f"{self.metric} ({', '.join(at)})" if at else self.metric

    @property
    def described(self) -> str:
        """Name of the figure and what it is, without its unit."""
        figure = figure_named(self.metric)
        assert figure is not None
        words = name_and_unit(figure.title)[0]
        return self.title if figure.title == OF_REPORT else f"{self.title}: {words}"

    @property
    def unit(self) -> str:
        """Unit of the figure; "" if it has none."""
        figure = figure_named(self.metric)
        assert figure is not None
        return name_and_unit(figure.title)[1] or name_and_unit(titled(self.metric, None))[1]


class Term(Goal):
    """A term of the merit: (weight · (value − target))², which is the smaller the better."""

    target: Number | None = None
    """Value wished for; of aberrations and other faults 0 if omitted, of "mtf" 1."""
    weight: Positive = 1.0
    """Factor of the deviation, in 1 over the unit of the metric."""

    def faults(self) -> Iterator[Fault]:
        """Yield the faults of the figure or its target."""
        yield from super().faults()
        figure = figure_named(self.metric)
        if figure is not None and figure.ideal is None and self.target is None:
            yield Fault(("target",), None, f"missing: the desired {self.metric}")

    @property
    def wanted(self) -> float:
        """Target, or the metric's ideal value."""
        if self.target is not None:
            return self.target
        figure = figure_named(self.metric)
        assert figure is not None
        assert figure.ideal is not None
        return figure.ideal


class Constraint(Goal):
    """A figure that must stay within limits; one of several values, such as edges of elements, with all of them."""

    least: Number | None = None
    """It is this or more."""
    most: Number | None = None
    """It is this or less."""

    def faults(self) -> Iterator[Fault]:
        """Yield the faults of the figure or the limits."""
        yield from super().faults()
        if self.least is None and self.most is None:
            yield Fault((), None, "no limit: give least, most or both")
        elif self.least is not None and self.most is not None and not self.least <= self.most:
            yield Fault(("most",), self.most, f"must be least = {self.least:g} or more")

    @property
    def in_words(self) -> str:
        """Limits in words."""
        words = [f"at least {self.least:g}"] if self.least is not None else []
        words += [f"at most {self.most:g}"] if self.most is not None else []
        return ", ".join(words)


class Rays(Model):
    """The rays that spots, MTF and chief rays are made of; as `lf.analyse` takes them."""

    object_mm: ObjectDistance | None = None
    """Distance of the object plane before the first vertex; inf: parallel light. That which `camera.focus_mm` names, or
    else the plane in focus, if omitted."""
    height_mm: Positive | None = None
    """Largest image height; half the diagonal of what sensor and array use, if omitted."""
    wavelengths_nm: tuple[Positive, ...] | None = None
    """An odd number, ascending, the primary one in the middle; those of the scene if omitted."""
    across: Annotated[int, Field(strict=True, ge=2, le=MOST_ACROSS)] = 10
    """Rays on a diameter of the stop, 2 to 100."""


class Search(Model):
    """The search for the best camera."""

    method: Literal["local", "global"] = "local"
    """"local": least squares from the scene and from further `starts`; "global": differential evolution over all
    ranges and values first, least squares from its best."""
    starts: Annotated[int, Field(strict=True, ge=1, le=MOST_STARTS)] = 1
    """Cameras that a local search begins with: that of the scene, and others drawn from the ranges."""
    seed: Whole = 0
    """Of what is drawn."""
    evaluations: Count = 2000
    """Most cameras that one search tries."""


class DesignFile(Model):
    """Content of a design file."""

    schema_version: Literal[1] = 1
    """Version of this format."""
    name: Text = ""
    """Name of the design."""
    scene: Text
    """Scene file of the camera to begin with, relative to this file."""
    changes: dict[str, Any] = Field(default_factory=dict)
    """Values that are replaced before anything else, by their path, such as "camera.sensor.distance_mm" = 42.2."""
    rays: Rays = Field(default_factory=Rays)
    """The rays that are sent."""
    search: Search = Field(default_factory=Search)
    """Method of the search, and its length."""
    variables: tuple[Variable, ...] = ()
    """Quantities that may vary."""
    merit: tuple[Term, ...] = ()
    """Merit of a camera: the sum of these terms is to be small."""
    constraints: tuple[Constraint, ...] = ()
    """Constraints that must hold."""

    def faults(self) -> Iterator[Fault]:
        """Yield faults between the fields."""
        if not self.variables:
            yield Fault(("variables",), None, "missing: the parameters that may vary")
        if not self.merit:
            yield Fault(("merit",), None, "missing: the terms of the merit function")
        paths = [variable.path for variable in self.variables]
        for i, path in enumerate(paths):
            if path in paths[:i]:
                yield Fault(("variables", i, "path"), path, "is a variable already")
        yield from self._contradictions()

    def _contradictions(self) -> Iterator[Fault]:
        """Yield limits that contradict an earlier constraint of the same figure."""
        for i, later in enumerate(self.constraints):
            for j, earlier in enumerate(self.constraints[:i]):
                if later.figure != earlier.figure:
                    continue
                least, most = later.least, later.most
                held = f"constraints[{j}] holds the same figure to"
                if least is not None and earlier.most is not None and least > earlier.most:
                    words = f"must be {earlier.most:g} or less, as {held} most = {earlier.most:g}"
                    yield Fault(("constraints", i, "least"), least, words)
                if most is not None and earlier.least is not None and most < earlier.least:
                    words = f"must be {earlier.least:g} or more, as {held} least = {earlier.least:g}"
                    yield Fault(("constraints", i, "most"), most, words)


def read_design(path: Path) -> DesignFile:
    """Read a design file.

    Raises
    ------
    LfmeshError
        The file cannot be read, is not TOML, or is not a valid design: one line per fault.
    """
    return read_tables(path, DesignFile, "design")
