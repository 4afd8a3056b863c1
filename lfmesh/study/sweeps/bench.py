"""Bench where a unit's cameras are adjusted, searched, traced and compared with the reference.

An unknown metric of a camera, whatever the cause, is NaN with a reason.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import FileError, LfmeshError, PictureWarning
from lfmesh.scene import Scene
from lfmesh.study.metrics.comparison import Comparison, Found
from lfmesh.study.metrics.metrics import METRICS, columns_of, metric_of, pictures_of
from lfmesh.study.metrics.pictures import Camera, Films, Taken, in_a_line, taken
from lfmesh.study.sweeps.statistics import Estimate, combined
from lfmesh.study.tolerances.compensators import Compensator, compensated
from lfmesh.study.tolerances.largest_change import Allowed, Search, largest_change

Array = NDArray[np.float64]


class OnTheWay(NamedTuple):
    """Number of cameras with an unknown metric in a search and its adjustments.

    Attributes
    ----------
    unknown, cameras : int
        Cameras with the unknown metric, and all cameras.
    reason : str
        Reason for the first one.
    """

    unknown: int
    cameras: int
    reason: str


class Compared(NamedTuple):
    """Metrics of a camera compared with the reference.

    Attributes
    ----------
    columns : dict of (n,) float64
        Pseudo-values by column; NaN: unknown.
    unknown : dict of str
        Reasons by metric.
    maps : dict of (rows, columns, 2) float64
    has_none : bool
        True if no metric could be computed.
    """

    columns: dict[str, Array]
    unknown: dict[str, str]
    maps: dict[str, Array]
    has_none: bool = False


@dataclass(frozen=True)
class Traced:
    """Films of the reference, with their tracing time and warnings.

    Metrics' results for these films alone are cached in `found`.
    """

    films: Taken
    seconds: float
    warnings: tuple[PictureWarning, ...] = ()
    found: Found = field(default_factory=dict)


@dataclass(frozen=True)
class Bench:
    """Bench for a unit's cameras and reference.

    Attributes
    ----------
    camera, reference : Camera
    reference_traced : Traced
        Films of the reference.
    metrics : tuple of str
    replicates : range
    threads : int
        0: as in the scenes.
    compensators : tuple of Compensator
    """

    camera: Camera
    reference: Camera
    reference_traced: Traced
    metrics: tuple[str, ...]
    replicates: range
    threads: int
    compensators: tuple[Compensator, ...]
    seen: dict[str, list[str]] = field(default_factory=dict)
    """Reasons for an unknown metric, "" if known, for each judged camera, by metric."""

    def on_the_way(self) -> dict[str, OnTheWay]:
        """Return the metrics that are unknown for some of the judged cameras."""
        lacking = {name: [why for why in reasons if why] for name, reasons in self.seen.items()}
        return {name: OnTheWay(len(whys), len(self.seen[name]), whys[0]) for name, whys in lacking.items() if whys}

    def traced(self, camera: Camera, metrics: tuple[str, ...]) -> Taken:
        """Trace the pictures that some metrics need."""
        return taken(in_threads(camera, self.threads), pictures_of(metrics), self.replicates)

    def compared(self, camera: Camera, own: Films, metrics: tuple[str, ...]) -> Compared:
        """Compare a camera with the reference by some metrics; unknown ones do not affect the others.

        Parameters
        ----------
        camera : Camera
        own : dict of (replicates, H, W, channels) float64, W
            Films of the camera.
        metrics : tuple of str
        """
        count = len(self.replicates)
        pair = Comparison(
            camera, self.reference, own, self.reference_traced.films, count, found=self.reference_traced.found
        )
        columns: dict[str, Array] = {}
        unknown: dict[str, str] = {}
        failed = 0
        with np.errstate(invalid="ignore", divide="ignore"):
            for name in metrics:
                try:
                    values = METRICS[name].compute(pair)
                except FileError:
                    raise
                except LfmeshError as error:
                    failed += 1
                    unknown[name] = in_a_line(error)
                    values = np.full((count, len(METRICS[name].columns)), np.nan)
                own_columns = METRICS[name].columns
                columns |= {each.name: np.ascontiguousarray(values[:, k]) for k, each in enumerate(own_columns)}
                if not all(each.knows(combined(columns[each.name])) for each in own_columns):
                    unknown.setdefault(name, METRICS[name].unseen)
        return Compared(columns, unknown, pair.maps, failed == len(metrics))

    def judged(self, scene: Scene, metrics: tuple[str, ...]) -> Compared:
        """Trace a camera, and compare it with the reference; if it cannot be traced, all metrics are unknown."""
        camera = Camera(scene, self.camera.edge_distance_mm)
        try:
            found = self.compared(camera, self.traced(camera, metrics), metrics)
        except FileError:
            raise
        except LfmeshError as error:
            none = np.full(len(self.replicates), np.nan)
            unknown = dict.fromkeys(metrics, in_a_line(error))
            found = Compared({column.name: none for column in columns_of(metrics)}, unknown, {})
        for name in metrics:
            self.seen.setdefault(name, []).append(found.unknown.get(name, ""))
        return found

    def adjusted(self, scene: Scene) -> tuple[Scene, tuple[float, ...]]:
        """Return a camera adjusted by its compensators, and their changes.

        Raises
        ------
        LfmeshError
            A compensator's metric is unknown for every camera in its range.
        """
        columns = {column.name: column for column in columns_of(self.metrics)}
        lacking: dict[str, str] = {}
        had: set[str] = set()

        def merit(adjusted: Scene, name: str) -> float:
            found = self.judged(adjusted, (metric_of(name),))
            mean = combined(found.columns[name])
            if not columns[name].knows(mean):
                lacking.setdefault(name, found.unknown[metric_of(name)])
                return math.nan
            had.add(name)
            return columns[name].harm(mean.value)

        adjusted, changes = compensated(scene, self.compensators, merit)
        for name, reason in lacking.items():
            if name not in had:
                raise LfmeshError(f"cannot be adjusted by {name}: {reason}")
        return adjusted, tuple(changes)

    def searched(self, search: Search) -> Allowed:
        """Find the largest change for which adjusted cameras keep the limits.

        Raises
        ------
        LfmeshError
            A limited metric is unknown for the reference, or for every other camera.
        """
        columns = [column for column in columns_of(self.metrics) if column.name in search.limits]
        metrics = tuple(dict.fromkeys(metric_of(column.name) for column in columns))

        def measured(value: float) -> tuple[dict[str, Estimate], str]:
            try:
                scene, _ = self.adjusted(self.camera.scene.changed({search.path: value}))
            except FileError:
                raise
            except LfmeshError as error:
                # A camera that cannot be made or adjusted neither keeps nor breaks a limit.
                return dict.fromkeys(search.limits, Estimate(math.nan, math.nan)), in_a_line(error)
            found = self.judged(scene, metrics)
            return _means(found), in_words(found.unknown)

        reference = self.compared(self.reference, self.reference_traced.films, metrics)
        means = _means(reference)
        for column in columns:
            if not column.knows(means[column.name]):
                name = metric_of(column.name)
                why = reference.unknown[name]
                raise LfmeshError(f"{name} has a limit, but is not known for the reference camera: {why}")
        allowed = largest_change(search, columns, means, measured, len(self.replicates))
        if allowed.unknown and allowed.value == search.start and not allowed.column:
            raise LfmeshError(
                f"the largest change cannot be searched, because limits have no known value: {allowed.unknown}"
            )
        return allowed


def in_words(unknown: Mapping[str, str]) -> str:
    """Return the unknown metrics with their reasons, or ""."""
    return "; ".join(f"{name}: {reason}" for name, reason in unknown.items())


def _means(found: Compared) -> dict[str, Estimate]:
    return {name: combined(values) for name, values in found.columns.items()}


def in_threads(camera: Camera, threads: int) -> Camera:
    """Return a camera to be traced in a number of threads; 0: as in its scene."""
    scene = camera.scene
    if threads in (0, scene.transport.threads):
        return camera
    return Camera(scene.changed({"transport.threads": threads}), camera.edge_distance_mm)
