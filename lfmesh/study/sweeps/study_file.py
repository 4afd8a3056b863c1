"""Study file: a scene, its axes, and the metrics."""

import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import Field, ValidationError

from lfmesh.errors import LfmeshError
from lfmesh.scene.file_kinds import FileKind, mistaken_for
from lfmesh.scene.files import parse_toml, read_text
from lfmesh.scene.literals import literal
from lfmesh.scene.model import Fault, Model, fault_lines, listed, nearest
from lfmesh.scene.quantities import Count, Flag, Number, Positive, Text, Whole
from lfmesh.study.metrics.metrics import METRICS, columns_of
from lfmesh.study.sweeps.axes import Axis
from lfmesh.study.tolerances.compensators import Compensator
from lfmesh.study.tolerances.error_modes import TEMPLATES

Tables = TypeVar("Tables", bound=Model)
Design = Literal["grid", "one_at_a_time", "latin_hypercube", "sobol"]


class StudyFile(Model):
    """Content of a study file."""

    schema_version: Literal[1] = 1
    """Version of this format."""
    name: Text = ""
    """Name of the study."""
    scene: Text | None = None
    """Scene file of the reference camera, relative to this file."""
    scenes: tuple[Text, ...] | None = None
    """In place of `scene` and `axes`: scene files to compare, the first of which is the reference."""
    template: Text | None = None
    """Ready-made axes, which come before those of the file: "assembly", "manufacturing", "packets-and-splits" or
    "sensor"."""
    changes: dict[str, Any] = Field(default_factory=dict)
    """Values that hold at every point, by their path, such as "transport.samples" = 64."""
    metrics: tuple[Text, ...] = ("psnr", "centres")
    """Quantities measured of each camera."""
    paired: Flag = True
    """Use the same random numbers at every point, so that differences are sharp."""
    design: Design = "one_at_a_time"
    """Points that are taken: every combination of values ("grid"), every value by itself ("one_at_a_time"), or `count`
    points that fill the space ("latin_hypercube", "sobol")."""
    count: Count | None = None
    """Number of points of a "latin_hypercube" or "sobol" design."""
    seed: Whole = 0
    """Of these designs."""
    batches: Count = 1
    """Parts into which the replicates of a point are divided; each is a unit of work."""
    refocus: Flag = False
    """Solve the distances that the scene omits anew at every point, as for a camera that is focused after it was
    changed. Else they are solved once, for the reference camera, which is then disturbed."""
    edge_distance_mm: Positive | None = None
    """Position of the edge of the metrics "mtf50" and "refocus"; in the plane in focus if omitted."""
    limits: dict[str, Number] = Field(default_factory=dict)
    """Limits of a good camera, by the column of the table, such as "psnr_db" = 30.0: at least, or, of columns that are
    the worse the larger they are, at most. They are values of the column, not shares of the reference's: for 10 % less
    than the reference run the study without limits, and take 0.9 times point 0 of its table. The report has the yield,
    and the largest change of each axis by itself that keeps them, which is searched between the reference and the
    farthest values of the axis."""
    compensators: tuple[Compensator, ...] = ()
    """Adjustments that assembly makes at every point, apart from the reference, before the metrics are taken."""
    axes: tuple[Axis, ...] = ()
    """Quantities that vary."""

    def faults(self) -> Iterator[Fault]:
        """Yield faults between the fields."""
        if (self.scene is None) == (self.scenes is None):
            yield Fault(("scene",), self.scene, "give either scene or scenes")
        if self.scenes is not None:
            yield from self._of_scenes()
        elif not self.axes and self.template is None:
            yield Fault(("axes",), None, "missing: the parameters that vary; or give a template")
        if self.template is not None and self.template not in TEMPLATES:
            yield Fault(("template",), self.template, f"must be one of {', '.join(TEMPLATES)}")
        if not self.metrics:
            yield Fault(("metrics",), [], "must not be empty")
        known = tuple(filter(METRICS.get, self.metrics))
        columns = {each.name: each for each in columns_of(known) if each.worse}
        judged = list(columns)
        there_are = f"there are {', '.join(judged)}" if judged else f"metrics = {list(self.metrics)} have none"
        for name, limit in self.limits.items():
            if name not in judged:
                # It may belong to a misspelt metric, which is reported separately.
                if known == self.metrics:
                    valid = f"not a column that can be limited{nearest(name, judged)}; {there_are}"
                    yield Fault(("limits", name), limit, valid)
                continue
            low, high = columns[name].reach
            if not low <= limit <= high:
                yield Fault(("limits", name), limit, f"must be from {low:g} to {high:g}, as the column's values are")
        for i, each in enumerate(self.compensators):
            if each.metric not in judged and known == self.metrics:
                valid = f"not a column that can be optimised{nearest(each.metric, judged)}; {there_are}"
                yield Fault(("compensators", i, "metric"), each.metric, valid)
            if each.path in [other.path for other in self.compensators[:i]]:
                yield Fault(("compensators", i, "path"), each.path, "is a compensator already")
        if self.batches > 1 and (self.limits or self.compensators):
            what = "limits" if self.limits else "compensators"
            yield Fault(("batches",), self.batches, f"must be 1 with {what}: all replicates together decide on a value")
        paths = [axis.path for axis in self.axes]
        for i, path in enumerate(paths):
            if path in paths[:i]:
                yield Fault(("axes", i, "path"), path, "is an axis already")
        yield from self._of_the_design()

    @property
    def is_drawn(self) -> bool:
        """True if the design samples the distributions of the axes, instead of taking listed values."""
        return self.design in ("latin_hypercube", "sobol")

    @property
    def needs_spread(self) -> str:
        """Message that refuses listed values for a design that samples."""
        return f'design = "{self.design}" needs a range, log_range, uniform or normal'

    def _of_scenes(self) -> Iterator[Fault]:
        if len(self.scenes or ()) < 2:
            yield Fault(("scenes",), list(self.scenes or ()), "must name at least two scenes")
        for key in ("axes", "template"):
            if getattr(self, key):
                yield Fault((key,), None, "omit it: the scenes themselves are the points")

    def _of_the_design(self) -> Iterator[Fault]:
        filling = self.is_drawn
        if filling and self.count is None and self.scenes is None:
            yield Fault(("count",), None, f'missing: the number of points of design = "{self.design}"')
        if not filling and self.count is not None:
            yield Fault(("count",), self.count, f'omit it: design = "{self.design}" takes the values of the axes')
        for i, axis in enumerate(self.axes):
            if axis.way is None:
                continue
            if filling and not axis.is_spread:
                yield Fault(("axes", i, "values"), list(axis.values or ()), self.needs_spread)
            if filling and axis.count is not None:
                yield Fault(("axes", i, "count"), axis.count, "omit it: the study's count holds for all axes")
            if not filling and axis.is_spread and axis.count is None:
                yield Fault(("axes", i, "count"), None, f"missing: how many values {axis.way} gives")


def unknown_metrics(names: object) -> Iterator[str]:
    """Yield the faults of metric names, one line each; a value that is not a list of names is reported elsewhere.

    It is separate from `StudyFile.faults`, so that they are reported along with wrong fields or paths.
    """
    for i, name in enumerate(names if isinstance(names, list | tuple) else ()):
        if isinstance(name, str) and name not in METRICS:
            close, there_are = nearest(name, METRICS), ", ".join(METRICS)
            yield f"metrics[{i}] = {literal(name)}: unknown metric{close}; there are {there_are}"


def read_study(path: Path) -> StudyFile:
    """Read a study file; the plan checks the names of its metrics.

    Raises
    ------
    LfmeshError
        The file cannot be read, is not TOML, or is not a valid study: one line per fault.
    """
    return read_tables(path, StudyFile, "study", lambda data: unknown_metrics(data.get("metrics")))


def read_tables(
    path: Path,
    kind: type[Tables],
    called: FileKind,
    beside: Callable[[dict[str, Any]], Iterator[str]] = lambda _: iter(()),
) -> Tables:
    """Read a TOML file that holds one model.

    Parameters
    ----------
    path : Path
    kind : type of Model
    called : {"study", "dataset", "design"}
    beside : callable
        Yields further faults from the file's content.

    Raises
    ------
    LfmeshError
        The file cannot be read, is not TOML, or is not a valid model: one line per fault.
    """
    try:
        data = parse_toml(read_text(path))
    except OSError as error:
        raise LfmeshError(f"{path}: cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise LfmeshError(f"{path}: not valid TOML: {error}") from None
    if words := mistaken_for(called, data):
        raise LfmeshError(f"{path}: {words}")
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        raise refused(str(path), [*fault_lines(error, data), *beside(data)]) from None


def refused(name: str, faults: list[str]) -> LfmeshError:
    """Return the error that lists the faults of a study."""
    if len(faults) == 1:
        return LfmeshError(f"{name}: {faults[0]}")
    return LfmeshError("\n".join([f"{name}: {len(faults)} faults", *(f"  {line}" for line in listed(faults))]))
