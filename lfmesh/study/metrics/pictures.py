"""Pictures for metrics: the scene, a white plane, an edge, with one film per replicate."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import FileError, LfmeshError, warn_caller
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.lightfield.calibration.white import white_scene
from lfmesh.scene import Scene
from lfmesh.study.cameras.compare import edge_plane, measuring
from lfmesh.study.metrics.crosstalk import lenslet_light
from lfmesh.transport.build import build
from lfmesh.transport.checks.found import books
from lfmesh.transport.packets.ledger import Ledger
from lfmesh.transport.render.image import Image
from lfmesh.transport.render.render import warn_beforehand
from lfmesh.transport.render.tally import Work
from lfmesh.transport.render.tracer import Tracer

Array = NDArray[np.float64]
Films = Mapping[str, Array]
"""Light of each replicate, (replicates, H, W, channels) float64, W, by picture name."""

FARTHEST_MM = 1e6
"""Largest distance of the edge."""


LENSLETS = "lenslets"
"""Not a picture: light of a white surround in each micro-image, through its own lenslet and through others."""


@dataclass(frozen=True)
class Camera:
    """A solved camera of a study, with the distance of its edge."""

    scene: Scene
    edge_distance_mm: float = FARTHEST_MM


def films(camera: Camera, names: Sequence[str], replicates: Sequence[int]) -> dict[str, Array]:
    """Trace replicates of pictures; each of `PICTURES` is bitwise equal to `lf.render` of the same scene.

    An exception is a scene with bands and more than eight replicates, which depend on each other in `lf.render`;
    metrics need independent ones.

    Warnings are as from `lf.render`, without the checks of a whole image: the blind check, and errors of single pixels.

    Parameters
    ----------
    camera : Camera
    names : sequence of str
        Names from `PICTURES`, or "lenslets" for `lenslet_light`.
    replicates : sequence of int

    Raises
    ------
    LfmeshError
        The scene cannot be built.
    """
    return {name: _film_of(camera, name, replicates) for name in names}


class Taken(dict[str, Array]):
    """Films of a camera by picture; accessing one that cannot be traced raises the reason.

    Attributes
    ----------
    lacking : dict of str
        Reasons why pictures cannot be traced, by name.
    """

    def __init__(self, films: Films, lacking: Mapping[str, str]) -> None:
        super().__init__(films)
        self.lacking = lacking

    def __missing__(self, name: str) -> Array:
        """Raise the reason why the film is missing."""
        if name in self.lacking:
            raise LfmeshError(self.lacking[name])
        raise KeyError(name)


def taken(camera: Camera, names: Sequence[str], replicates: Sequence[int]) -> Taken:
    """Trace the pictures that can be traced, as `films` does.

    Parameters
    ----------
    camera : Camera
    names : sequence of str
    replicates : sequence of int

    Raises
    ------
    FileError
        A file of the scene cannot be read.
    LfmeshError
        None of the pictures can be traced.
    """
    found: dict[str, Array] = {}
    lacking: dict[str, str] = {}
    for name in names:
        try:
            found |= films(camera, (name,), replicates)
        except FileError:
            # A fault of the machine, not of the camera.
            raise
        except LfmeshError as error:
            lacking[name] = in_a_line(error)
    if lacking and not found:
        raise LfmeshError("; ".join(dict.fromkeys(lacking.values())))
    return Taken(found, lacking)


def in_a_line(error: LfmeshError) -> str:
    """Return an error of several lines as one."""
    return "; ".join(line.strip().removeprefix("Scene.") for line in str(error).splitlines())


def _film_of(camera: Camera, name: str, replicates: Sequence[int]) -> Array:
    if name == LENSLETS:
        return lenslet_light(camera.scene, replicates)
    return _films(PICTURES[name](camera), replicates)


def _films(scene: Scene, replicates: Sequence[int]) -> Array:
    tracer = Tracer(build(scene), check=False, independent=True)
    warn_beforehand(tracer)
    films, layout = [], tracer.layout
    book, work = np.zeros(layout.book), Work(np.zeros(layout.counters, np.int64))
    for replicate in replicates:
        tally = layout.tally()
        tally.restart(replicate)
        tally.merge([tracer.piece(replicate, tracer.plan.whole())])
        films.append(reduce(np.add, [film.power for film in tally.films]).reshape(tracer.shape))
        book += tally.book
        work.add(tally.work)
    warn_caller(books(scene, tracer.ledger(book, work, len(films))))
    return np.stack(films)


def image_of(scene: Scene, films: Array) -> Image:
    """Return the image of some replicates, as if taken by the camera of a scene.

    Parameters
    ----------
    scene : Scene
    films : (n, H, W, channels) float64, W
    """
    count = len(films)
    stderr = films.std(axis=0, ddof=1) / math.sqrt(count) if count > 1 else np.full(films.shape[1:], np.nan)
    return Image(films.mean(axis=0), stderr, scene, Ledger(), 0.0, count, float(scene.transport.samples), "")


def _itself(camera: Camera) -> Scene:
    return camera.scene


def _white(camera: Camera) -> Scene:
    return white_scene(camera.scene)


def _image_path(camera: Camera) -> Scene:
    return camera.scene.changed({"transport.split": "transmit"})


def edge_scene(camera: Camera) -> Scene:
    """Return a scene of a bright half-plane with a slightly slanted edge through the axis."""
    solved = solved_camera(camera.scene)
    plane = edge_plane(solved.report, camera.edge_distance_mm)
    return measuring(solved.scene).changed({"targets": [plane]})


PICTURES: dict[str, Callable[[Camera], Scene]] = {
    "scene": _itself,
    "white": _white,
    "image path": _image_path,
    "edge": edge_scene,
}
"""Scene of each picture."""
