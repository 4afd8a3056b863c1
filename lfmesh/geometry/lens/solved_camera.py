"""The solved camera: a scene with all unknowns solved, its first-order report, its paraxial lens and its lens meshes.

Scenes are immutable, so results are cached and equal scenes share them, unless a lens file has changed (by its stamp).
Scenes that differ only in targets, lights or random numbers share the lens meshes.
"""

from collections import OrderedDict
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from threading import Lock

import numpy as np

from lfmesh.geometry.lens.lens_shape import PIXEL_SHARE, LensShape, lens_shape
from lfmesh.geometry.objects.refractors import face_lines, measured
from lfmesh.geometry.objects.tanks import with_tanks
from lfmesh.scene import FirstOrder, Paraxial, Scene, Tessellation, solved
from lfmesh.scene.camera.lens import Lens
from lfmesh.scene.camera.mla import MicrolensArray
from lfmesh.scene.files import with_lens_file
from lfmesh.scene.first_order.compute import with_warnings, without_warnings
from lfmesh.scene.inputs import file_stamp, files_of
from lfmesh.scene.literals import plain

KEPT = 16
"""Cameras in the cache, most recently used."""

Key = tuple[object, ...]


@dataclass(frozen=True, eq=False)
class SolvedCamera:
    """A scene with all unknowns solved, and its derived results. Made by `solved_camera`; compared by identity.

    Attributes
    ----------
    scene : Scene
        Solved, its mesh elements measured.
    """

    scene: Scene
    _shapes: dict[int | None, LensShape] = field(default_factory=dict, repr=False)

    @cached_property
    def report(self) -> FirstOrder:
        """The first-order report."""
        return with_warnings(self.scene, self.facts)

    @cached_property
    def facts(self) -> FirstOrder:
        """The first-order report without its warnings, which take longest to compute."""
        return without_warnings(self.scene)

    @cached_property
    def paraxial(self) -> Paraxial:
        """The lens at the primary wavelength."""
        return Paraxial.of(self.scene.camera.lens, self.scene.primary_nm)

    def lens_shape(self, rings: int | None = None) -> LensShape:
        """Return the meshes of the lens, read-only, with a copy of the table of its surfaces.

        Parameters
        ----------
        rings : int, optional
            Rings of triangles per cap. Default: from the tolerance or the pixel size.
        """
        if rings not in self._shapes:
            shape = lens_shape(self.scene, rings)
            for mesh in (*shape.caps, *shape.closures):
                for values in (mesh.vertices, mesh.faces, mesh.corner_normals):
                    if values is not None:
                        values.setflags(write=False)
            self._shapes[rings] = shape
        shape = self._shapes[rings]
        return replace(
            shape, numbers=list(shape.numbers), surfaces=shape.surfaces.copy(), rims=list(shape.rims),
            caps=list(shape.caps), closures=list(shape.closures), media=list(shape.media),
            analytic=shape.analytic.copy(), errors_mm=shape.errors_mm.copy(),
        )  # fmt: skip


_kept: OrderedDict[Key, SolvedCamera] = OrderedDict()
_lock = Lock()


def solved_camera(scene: Scene) -> SolvedCamera:
    """Return the solved camera of a scene, from the cache if neither the scene nor its files have changed.

    Raises
    ------
    LfmeshError
        A distance is neither given nor follows from `focus_mm`, a lens or mesh file cannot be used, or the solved scene
        is impossible.
    """
    lens = with_lens_file(scene.camera.lens, scene.folder)
    key = _key(scene, lens)
    with _lock:
        camera = _kept.get(key)
        if camera is not None:
            _kept.move_to_end(key)
            return camera
    ready = with_tanks(solved(measured(scene)))
    if _key(scene, lens) != key:
        # A file changed while it was read: its content belongs to neither key.
        return SolvedCamera(ready)
    own = _key(ready, ready.camera.lens)
    settings = ready.transport.surface, ready.transport.tessellation, ready.primary_nm
    shapes = _shapes_of(ready.camera, *settings, *own[2:])
    with _lock:
        # A solved scene is its own solution.
        camera = _kept.setdefault(own, SolvedCamera(ready, shapes))
        _kept[key] = camera
        while len(_kept) > 2 * KEPT:
            _kept.popitem(last=False)
    return camera


def first_order(scene: Scene) -> FirstOrder:
    """Return the first-order report of a scene; elements given as meshes are measured first.

    The report is cached; see `solved_camera`.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    FirstOrder
    """
    return solved_camera(scene).report


def mesh_lines(scene: Scene) -> list[str]:
    """Return text lines that describe the lens meshes: triangles per surface, and the error at the sensor, if any."""
    lines = face_lines(scene)
    camera = solved_camera(scene)
    scene, shape = camera.scene, camera.lens_shape()
    total = float(np.sqrt(np.nansum(shape.errors_mm**2)))
    for number, cap, error, own in zip(shape.numbers, shape.caps, shape.errors_mm, shape.analytic, strict=True):
        source = ", from its file"
        if own:
            source = f", estimated error at the sensor {1e3 * error:.3g} µm" if total > 0.0 else ""
        lines.append(f"surface {number:<15}{len(cap.faces)} triangles{source}")
    pixels = total / scene.camera.sensor.pixel_mm
    level = scene.transport.surface
    sum_of_all = f": {1e3 * total:.3g} µm, {pixels:.3g} pixels" if total > 0.0 else ""
    lines.append(f'{"all surfaces":<23}surface = "{level}"{sum_of_all}')
    if level != "exact" and scene.transport.tessellation == Tessellation() and pixels > PIXEL_SHARE:
        lines.append(
            f'Note: at {shape.rings} rings, the finest, surface = "{level}" is {plain(pixels, 2)} pixels off; '
            'use "patch" or "exact"'
        )
    return lines


def _key(scene: Scene, lens: Lens) -> Key:
    """Return the cache key of a scene; `lens` is the scene's lens, read from its file if it names one."""
    held = (_files_of(part) for part in (lens, scene.camera.mla) if part is not None)
    files = tuple((place, path, file_stamp(scene.resolve(path))) for part in held for place, path in part)
    return scene.digest, scene.title, scene.folder, tuple(sorted(scene.digests.items())), lens, files


@lru_cache(maxsize=KEPT)
def _shapes_of(*_: object) -> dict[int | None, LensShape]:
    """Return the meshes, by number of rings, shared by all scenes with the same lens settings."""
    return {}


@lru_cache(maxsize=2 * KEPT)
def _files_of(part: Lens | MicrolensArray) -> tuple[tuple[str, str], ...]:
    return tuple(files_of(part))
