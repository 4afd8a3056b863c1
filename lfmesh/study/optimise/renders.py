"""Figures of pictures: columns of a study's table, relative to the initial camera."""

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import FileError, LfmeshError
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.scene import Scene
from lfmesh.study.metrics.comparison import Comparison, Found
from lfmesh.study.metrics.metrics import METRICS, metric_of, pictures_of
from lfmesh.study.metrics.pictures import FARTHEST_MM, Camera, Films, films, in_a_line
from lfmesh.study.sweeps.statistics import combined

Array = NDArray[np.float64]


class Renders:
    """Renderer with common random numbers for all cameras, so that differences are precise.

    Parameters
    ----------
    scene : Scene
        Initial camera, solved.
    columns : sequence of str
        Columns of a study's table.

    Attributes
    ----------
    unknown : dict of str
        Reasons for unknown columns of the last camera.
    """

    def __init__(self, scene: Scene, columns: Sequence[str]) -> None:
        self.columns = tuple(columns)
        self.metrics = tuple(dict.fromkeys(metric_of(column) for column in columns))
        edge_mm = min(solved_camera(scene).report.object_distance_mm, FARTHEST_MM)
        self._reference = Camera(scene, edge_mm)
        self._found: Found = {}
        self.unknown: dict[str, str] = {}

    @cached_property
    def _reference_films(self) -> Films:
        return self._traced(self._reference)

    def _traced(self, camera: Camera) -> Films:
        return films(camera, pictures_of(self.metrics), range(camera.scene.transport.replicates))

    def values(self, scene: Scene) -> Array:
        """Return the columns of a solved camera, (k,); NaN: unknown.

        Raises
        ------
        LfmeshError
            The camera cannot be traced.
        """
        camera = Camera(scene, self._reference.edge_distance_mm)
        own, count = self._traced(camera), scene.transport.replicates
        pair = Comparison(camera, self._reference, own, self._reference_films, count, found=self._found)
        found: dict[str, float] = {}
        self.unknown = {}
        with np.errstate(invalid="ignore", divide="ignore"):
            for name in self.metrics:
                metric, why = METRICS[name], METRICS[name].unseen
                try:
                    values = metric.compute(pair)
                except FileError:
                    raise
                except LfmeshError as error:
                    values, why = np.full((count, len(metric.columns)), np.nan), in_a_line(error)
                for number, column in enumerate(metric.columns):
                    value = column.estimate(combined(np.ascontiguousarray(values[:, number]))).value
                    found[column.name] = value
                    if math.isnan(value):
                        self.unknown[column.name] = why
        return np.array([found[name] for name in self.columns])
