"""Plan of a study: its points and their scenes, all checked before anything is traced."""

import hashlib
import itertools
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from lfmesh.errors import LfmeshError
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.scene import Scene, load, solved
from lfmesh.scene.literals import literal
from lfmesh.study.metrics.metrics import METRICS
from lfmesh.study.metrics.pictures import FARTHEST_MM, Camera, in_a_line
from lfmesh.study.sweeps.axes import Axis, is_number, name_and_unit
from lfmesh.study.sweeps.named_fields import with_named
from lfmesh.study.sweeps.paths import number_path, value_at
from lfmesh.study.sweeps.study_file import StudyFile, refused, unknown_metrics
from lfmesh.study.tolerances.compensators import Compensator
from lfmesh.study.tolerances.error_modes import TEMPLATES
from lfmesh.study.tolerances.largest_change import Search
from lfmesh.transport.collisions import refuse_impossible_camera

Varied = TypeVar("Varied", Axis, Compensator)

MOST_POINTS = 1_000_000
"""Largest number of points in a study or items in a dataset; they are checked first, some hundreds per second."""

LEAST_REPLICATES = 3
"""Smallest number of replicates per batch: with one left out, two with independent noise remain."""

FOCUS = "camera.focus_mm"
DISTANCES = ("camera.mla.distance_mm", "camera.sensor.distance_mm")

CAMERAS_SEARCHED, CAMERAS_ADJUSTED = 10, 12
"""Cameras traced by a search of the largest change, and by an adjustment for each compensator."""


@dataclass(frozen=True)
class Point:
    """A point of a study.

    Attributes
    ----------
    number : int
        Number of the point; 0 is the reference.
    values : tuple
        One per axis; None: as in the reference camera.
    searched : int or None
        Axis of a search for the largest change within the limits; its value is the end of the search.
    """

    number: int
    values: tuple[Any, ...]
    searched: int | None = None


@dataclass(frozen=True, eq=False)
class Plan:
    """A study with known, valid points, made by `plan_of`.

    Attributes
    ----------
    study : StudyFile
    base : Scene
        Reference camera, solved unless the study refocuses, with the digests of all files that any point reads.
    axes : tuple of Axis
        Axes, including a template's.
    points : list of Point
    scenes : tuple of Scene
        For a study of scene files, with the digests of their files; otherwise empty.
    """

    study: StudyFile
    base: Scene
    axes: tuple[Axis, ...]
    points: list[Point]
    scenes: tuple[Scene, ...] = ()

    @property
    def metrics(self) -> tuple[str, ...]:
        """Names of the metrics."""
        return self.study.metrics

    @property
    def searched(self) -> bool:
        """True if the largest change of any axis is searched."""
        return any(point.searched is not None for point in self.points)

    @cached_property
    def reference_values(self) -> tuple[Any, ...]:
        """Values of the axes in the reference camera."""
        return tuple(value_at(self.base, axis.path) for axis in self.axes)

    def scene_of(self, point: Point) -> Scene:
        """Return the scene of a point.

        Raises
        ------
        SceneError
            The scene is not valid.
        """
        if self.scenes:
            return self.scenes[point.number]
        changes: dict[str, Any] = {
            axis.path: value for axis, value in zip(self.axes, point.values, strict=True) if value is not None
        }
        if not self.study.paired:
            changes["transport.seed"] = seed_of(self.base.transport.seed, point.number)
        return self.base.changed(changes) if changes else self.base

    def label(self, point: Point, found: Any = None) -> str:
        """Return a point in words, with names and units as in reports.

        Parameters
        ----------
        point : Point
        found : object, optional
            Result of the point's search.
        """
        if point.number == 0:
            return "the reference"
        if self.scenes:
            return (self.study.scenes or ())[point.number]
        words = []
        for i, (axis, value) in enumerate(zip(self.axes, point.values, strict=True)):
            if value is None:
                continue
            is_searched = i == point.searched
            name, unit = name_and_unit(axis.title)
            sign = "up to" if is_searched and found is None else "="
            shown = found if is_searched and found is not None else value
            digits = f"{shown:.6g}" if isinstance(shown, float) else literal(shown)
            words.append(f"{name} {sign} {digits}{unit and ' ' + unit}")
        return ("largest change, " if point.searched is not None else "") + (", ".join(words) or "the reference again")

    def cameras_of(self, point: Point) -> int:
        """Return a rough number of cameras traced at a point, several for searches and adjustments."""
        adjusted = 1 + CAMERAS_ADJUSTED * (len(self.study.compensators) if point.number else 0)
        return adjusted * (1 if point.searched is None else 1 + CAMERAS_SEARCHED)

    def search_of(self, point: Point) -> Search | None:
        """Return the search at a point, or None."""
        i = point.searched
        if i is None:
            return None
        return Search(self.axes[i].path, self.reference_values[i], point.values[i], self.study.limits)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all inputs of the results: scene, its files, points, metrics."""
        facts = {
            "scenes": [scene.digest for scene in self.scenes or (self.base,)],
            "inputs": [scene.digests for scene in self.scenes or (self.base,)],
            "paths": [axis.path for axis in self.axes],
            "points": [(point.values, point.searched) for point in self.points],
            "limits": self.study.limits if self.searched else {},
            "compensators": [(each.path, each.range, each.metric) for each in self.study.compensators],
            "metrics": self.metrics,
            "paired": self.study.paired,
            "refocus": self.study.refocus,
            "edge": self.study.edge_distance_mm,
            "batches": self.study.batches,
        }
        return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()

    def camera_of(self, point: Point) -> Camera:
        """Return the camera of a point, with the edge at the reference's distance."""
        return Camera(self.scene_of(point), self._edge_mm)

    @cached_property
    def _edge_mm(self) -> float:
        given = self.study.edge_distance_mm
        return given or min(solved_camera(self.scene_of(self.points[0])).report.object_distance_mm, FARTHEST_MM)

    def replicates_of(self, batch: int) -> range:
        """Return the numbers of a batch's replicates."""
        each = self.base.transport.replicates // self.study.batches
        return range(batch * each, (batch + 1) * each)

    @property
    def units(self) -> list[tuple[int, int]]:
        """Point and batch of every unit, beginning with the reference."""
        return [(point.number, batch) for point in self.points for batch in range(self.study.batches)]


def seed_of(seed: int, point: int) -> int:
    """Return the seed of a point with random numbers of its own."""
    words = hashlib.sha256(f"{seed} {point}".encode()).digest()
    return int.from_bytes(words[:8], "big") >> 1 if point else seed


def plan_of(study: StudyFile, base: Scene | Sequence[Scene], name: str = "study") -> Plan:
    """Plan a study: make its points, and check each before anything is traced.

    Parameters
    ----------
    study : StudyFile
    base : Scene or sequence of Scene
        Scene of the reference camera, or the scenes to compare.
    name : str
        Name of the study in messages.

    Raises
    ------
    LfmeshError
        One line per fault.
    """
    scenes = () if isinstance(base, Scene) else tuple(base)
    first = base if isinstance(base, Scene) else scenes[0]
    axes = study.axes
    if study.template is not None:
        ready = TEMPLATES[study.template](solved_camera(first).scene)
        first = first.changed(ready.changes)
        axes = (*ready.axes, *axes)
        if study.is_drawn and not all(axis.is_spread for axis in ready.axes):
            way = (
                f"write its axes with lfmesh study --template {study.template} SCENE -o FILE and give each one of these"
            )
            raise refused(name, [f'template = "{study.template}": lists values, and {study.needs_spread}; {way}'])
    faults = [*path_faults(study.changes, first, "changes")]
    if not faults and study.changes:
        first = first.changed(study.changes)
    ready_scene = solved_camera(first).scene
    if study.refocus:
        # Solved again at every point: lenslets keep their radii, the rest follows the scene.
        omitted = [path for path in DISTANCES if _is_omitted(first, path)]
        ready_scene = ready_scene.changed(dict.fromkeys(omitted, None))
    paths = [*(axis.path for axis in axes), *(each.path for each in study.compensators)]
    ready_scene = with_named(ready_scene, first, paths)
    axes = tuple(_renamed(axis, number_path(axis.path, axis.values or (), ready_scene)) for axis in axes)
    adjusted = tuple(_renamed(each, number_path(each.path, (), ready_scene)) for each in study.compensators)
    study = study.model_copy(update={"compensators": adjusted})
    for i, axis in enumerate(axes):
        faults += [
            f"axes[{i}].{line}" for line in path_faults({axis.path: None}, ready_scene, "path", refocus=study.refocus)
        ]
        if not faults and axis.relative and not is_number(value_at(ready_scene, axis.path)):
            found = value_at(ready_scene, axis.path)
            faults.append(f"axes[{i}].relative: {axis.path} is {found!r} in the reference camera, not a number")
    for i, each in enumerate(study.compensators):
        of = list(path_faults({each.path: None}, ready_scene, "path", refocus=study.refocus))
        if not of and not is_number(value_at(ready_scene, each.path)):
            found = value_at(ready_scene, each.path)
            of.append(f"path: {each.path} is {found!r} in the reference camera, not a number")
        elif not of and isinstance(value_at(ready_scene, each.path), int):
            of.append(f"path: {each.path} is a whole number and cannot be adjusted continuously; make it an axis")
        faults += [f"compensators[{i}].{line}" for line in of]
    faults += _metric_faults(study, ready_scene)
    faults += _count_faults(study, axes)
    if faults:
        raise refused(name, faults)
    points = [Point(i, ()) for i in range(len(scenes))] if scenes else list(_points(study, axes, ready_scene))
    if study.limits and not scenes:
        points += _searches(axes, points, ready_scene)
    ready_scene = pinned_with(ready_scene, ((axis.path, axis.values or ()) for axis in axes))
    plan = Plan(study, ready_scene, axes, points, tuple(scene.pinned() for scene in scenes))
    faults = list(_point_faults(plan))
    if faults:
        raise refused(name, faults)
    return plan


def load_scenes(study: StudyFile, folder: Path) -> Scene | tuple[Scene, ...]:
    """Load the scene of a study, or its several scenes, solved.

    Raises
    ------
    LfmeshError
        A scene cannot be loaded.
    """
    if study.scene is not None:
        return load(folder / study.scene)
    return tuple(solved_camera(load(folder / name).changed(study.changes)).scene for name in study.scenes or ())


def _is_omitted(scene: Scene, path: str) -> bool:
    try:
        return value_at(scene, path) is None
    except KeyError:
        return False


def _focus_of(scene: Scene) -> tuple[Any, ...]:
    """Return the distances of array and sensor of a solved scene."""
    camera = scene.camera
    return camera.mla and camera.mla.distance_mm, camera.sensor.distance_mm


def _renamed(each: Varied, path: str) -> Varied:
    return each.model_copy(update={"path": path})


def path_faults(paths: dict[str, Any], scene: Scene, prefix: str, *, refocus: bool = True) -> Iterator[str]:
    """Yield the paths that do not exist.

    Parameters
    ----------
    paths : dict
        Paths, with any values.
    scene : Scene
    prefix : str
        Name of a path in messages.
    refocus : bool
        True if distances are solved at every point.
    """
    for path in paths:
        try:
            value_at(scene, path)
        except KeyError as error:
            yield f'{prefix} = "{path}": {error.args[0]}'
        else:
            if path == FOCUS and prefix == "path" and not refocus:
                yield f'{prefix} = "{path}": changes nothing, because distances are solved once; add refocus = true'


def _metric_faults(study: StudyFile, scene: Scene) -> Iterator[str]:
    transport = scene.transport
    if transport.target_error is not None:
        yield "transport.target_error: omit it; the replicates of a study must all have the same samples"
    batches = study.batches
    if transport.replicates % batches or transport.replicates // batches < LEAST_REPLICATES:
        yield (
            f"batches = {batches}: must divide transport.replicates = {transport.replicates} into equal parts of at "
            f"least {LEAST_REPLICATES}"
        )
    yield from unknown_metrics(study.metrics)
    if "efficiency" in study.metrics and "noise" not in study.metrics:
        yield "metrics: efficiency is 1/(noise² · time); add noise"
    for name in filter(METRICS.get, study.metrics):
        if why := METRICS[name].why_unknown(scene):
            yield f"metrics: {name} {why}"


def _count_faults(study: StudyFile, axes: tuple[Axis, ...]) -> Iterator[str]:
    """Yield faults of the number of points, before they are made."""
    each = [len(axis.values) if axis.values is not None else axis.count or 1 for axis in axes]
    if study.count is not None:
        field, points = "count", study.count
    elif study.design == "grid":
        field, points = "axes", math.prod(each)
    else:
        field, points = "axes", sum(each)
    if points > MOST_POINTS and not study.scenes:
        yield f'{field}: design = "{study.design}" makes {points:,} points; a study has at most {MOST_POINTS:,}'


def _points(study: StudyFile, axes: tuple[Axis, ...], base: Scene) -> Iterator[Point]:
    """Yield the points of a design, beginning with the reference."""
    blank = (None,) * len(axes)
    yield Point(0, blank)
    added = [value_at(base, axis.path) if axis.relative else None for axis in axes]

    def placed(values: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(
            value if value is None or start is None else start + value
            for value, start in zip(values, added, strict=True)
        )

    if study.design == "one_at_a_time":
        rows: Iterator[tuple[Any, ...]] = (
            (*blank[:i], value, *blank[i + 1 :]) for i, axis in enumerate(axes) for value in axis.listed()
        )
    elif study.design == "grid":
        rows = itertools.product(*(axis.listed() for axis in axes))
    else:
        rows = _filling(study, axes)
    for number, row in enumerate(rows, start=1):
        yield Point(number, placed(row))


def _searches(axes: tuple[Axis, ...], points: list[Point], base: Scene) -> list[Point]:
    """Return the points that search the largest change of an axis, one for each side studied."""
    found: list[Point] = []
    for i, axis in enumerate(axes):
        start = value_at(base, axis.path)
        values = [point.values[i] for point in points if point.values[i] is not None]
        if not isinstance(start, float) or not all(map(is_number, values)) or axis.path.startswith("transport."):
            continue
        low, high = min(values), max(values)
        for far in (*([low] if low < start else []), *([high] if high > start else [])):
            row = tuple(float(far) if k == i else None for k in range(len(axes)))
            found.append(Point(len(points) + len(found), row, i))
    return found


def _filling(study: StudyFile, axes: tuple[Axis, ...]) -> Iterator[tuple[Any, ...]]:
    """Yield points of a Latin hypercube (McKay et al. 1979) or of Sobol's sequence, scrambled (Owen 1995)."""
    import warnings

    from scipy.stats import qmc

    count = study.count or 1
    kind = qmc.LatinHypercube if study.design == "latin_hypercube" else qmc.Sobol
    draw = kind(d=len(axes), rng=np.random.default_rng(study.seed))
    with warnings.catch_warnings():
        # Sobol' points are only slightly less even if their number is not a power of two.
        warnings.simplefilter("ignore", UserWarning)
        shares = draw.random(count)
    columns = [axis.quantiles(shares[:, i]).tolist() for i, axis in enumerate(axes)]
    yield from zip(*columns, strict=True)


def _point_faults(plan: Plan) -> Iterator[str]:
    """Yield the points with an invalid scene, or another sensor or array size than the reference."""
    size = _sizes(plan.scene_of(plan.points[0]))
    distances = set()
    for point in plan.points:
        try:
            scene = plan.scene_of(point)
            distances.add(_focus_of(_checked(scene)))
            for each in plan.study.compensators if point.number else ():
                for change in each.range:
                    _checked(each.applied(scene, change))
        except LfmeshError as error:
            yield f"point {point.number} ({plan.label(point)}): {in_a_line(error)}"
            continue
        except (KeyError, IndexError, TypeError, ValueError) as error:
            yield f"point {point.number} ({plan.label(point)}): cannot be set: {error}"
            continue
        own = _sizes(scene)
        for what, (here, there) in own.items() if own != size else ():
            if size[what] != (here, there):
                yield (
                    f"point {point.number} ({plan.label(point)}): {what} = {[here, there]} differs from the "
                    f"reference's {list(size[what])}: images are compared pixel by pixel"
                )
    if plan.study.refocus and len(plan.points) > 1 and len(distances) == 1:
        yield (
            "refocus = true: changes nothing: by first-order optics every point has the reference's distances of array "
            "and sensor; omit it. To refocus after a change of a pose, use a compensator of camera.mla.distance_mm"
        )


def _checked(scene: Scene) -> Scene:
    """Return a scene solved.

    Raises
    ------
    SceneError
        The scene is not valid, or elements, array and sensor intersect, which a build would refuse.
    """
    meshes = any(surface.refractor is not None for surface in scene.camera.lens.surfaces)
    ready = solved_camera(scene).scene if meshes else solved(scene)
    refuse_impossible_camera(ready)
    return ready


def _sizes(scene: Scene) -> dict[str, tuple[int, int]]:
    camera = scene.camera
    sizes = {"camera.sensor.pixels": camera.sensor.pixels, "channels": (scene.channels, 1)}
    return sizes | ({"camera.mla.count": camera.mla.count} if camera.mla is not None else {})


def pinned_with(base: Scene, choices: Iterable[tuple[str, Iterable[Any]]]) -> Scene:
    """Return a scene with the digests of its files, and of the files read with other values.

    Parameters
    ----------
    base : Scene
    choices : iterable of (str, iterable)
        Paths in the scene, and their possible values.
    """
    base = base.pinned()
    for path, values in choices:
        for value in values:
            # A number names no file; an invalid value is reported with its point.
            if not is_number(value):
                with suppress(LfmeshError, KeyError, IndexError, TypeError, ValueError):
                    base = base.with_digests(base.changed({path: value}).pinned().digests)
    return base
