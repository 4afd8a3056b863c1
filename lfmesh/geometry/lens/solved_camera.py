"""The solved camera: a scene with nothing left to solve, its first-order report, and the meshes of its lens.

Every part of lfmesh asks here for the solved scene, its first-order report, its paraxial lens and the lens's meshes.
Scenes are immutable, so that an equal scene has the same answer, unless a file that its lens is made of has changed:
the files' stamps are part of what an answer is kept under. Scenes with one camera and different targets, lights or
random numbers share the meshes of its lens.
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
from lfmesh.scene.files import with_lens_file
from lfmesh.scene.first_order.compute import with_warnings, without_warnings
from lfmesh.scene.inputs import file_stamp, files_of
from lfmesh.scene.literals import plain

KEPT = 16
"""Cameras that are kept, the latest ones asked for."""

Key = tuple[object, ...]


@dataclass(frozen=True, eq=False)
class SolvedCamera:
    """A scene with nothing left to solve, and what follows from it. Made by `solved_camera`; compared by identity.

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
        """The first-order report without its warnings, which take longest."""
        return without_warnings(self.scene)

    @cached_property
    def paraxial(self) -> Paraxial:
        """The lens at the primary wavelength."""
        return Paraxial.of(self.scene.camera.lens, self.scene.primary_nm)

    def lens_shape(self, rings: int | None = None) -> LensShape:
        """Return the meshes of the lens, which are read-only; the table of its surfaces is the caller's own.

        Parameters
        ----------
        rings : int, optional
            Rings of triangles a cap, in place of what the tolerance or the sensor's pixels ask for.
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
    """Return the solved camera of a scene: computed once, then kept while scene and files stay as they are.

    Raises
    ------
    LfmeshError
        A distance is neither given nor to be had from `focus_mm`, a lens or mesh file cannot be used, or what follows
        from the scene is impossible.
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
        # A file changed while it was read: what was read belongs to neither key.
        return SolvedCamera(ready)
    own = _key(ready, ready.camera.lens)
    settings = ready.transport.surface, ready.transport.tessellation, ready.primary_nm
    shapes = _shapes_of(ready.camera, *settings, *own[1:])
    with _lock:
        # What is solved already is its own solution.
        camera = _kept.setdefault(own, SolvedCamera(ready, shapes))
        _kept[key] = camera
        while len(_kept) > 2 * KEPT:
            _kept.popitem(last=False)
    return camera


def first_order(scene: Scene) -> FirstOrder:
    """Return the first-order report of a scene, elements given as meshes measured first; see `solved_camera`.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    FirstOrder
    """
    return solved_camera(scene).report


def mesh_lines(scene: Scene) -> list[str]:
    """Return in words how a scene's lens is meshed: triangles a surface, and what they cost at the sensor."""
    lines = face_lines(scene)
    camera = solved_camera(scene)
    scene, shape = camera.scene, camera.lens_shape()
    for number, cap, error, own in zip(shape.numbers, shape.caps, shape.errors_mm, shape.analytic, strict=True):
        source = f"estimated error at the sensor {1e3 * error:.3g} µm" if own else "from its file"
        lines.append(f"surface {number:<15}{len(cap.faces)} triangles, {source}")
    total = float(np.sqrt(np.nansum(shape.errors_mm**2)))
    pixels = total / scene.camera.sensor.pixel_mm
    level = scene.transport.surface
    lines.append(f'{"all surfaces":<23}surface = "{level}": {1e3 * total:.3g} µm, {pixels:.3g} pixels')
    if level != "exact" and scene.transport.tessellation == Tessellation() and pixels > PIXEL_SHARE:
        lines.append(
            f'Note: at {shape.rings} rings, the finest, surface = "{level}" is {plain(pixels, 2)} pixels off; '
            'use "patch" or "exact"'
        )
    return lines


def _key(scene: Scene, lens: Lens) -> Key:
    """Return what the answer for a scene depends on; `lens` is the scene's, read from its file where it names one."""
    files = tuple((place, path, file_stamp(scene.resolve(path))) for place, path in _files_of(lens))
    return scene.digest, scene.folder, tuple(sorted(scene.digests.items())), lens, files


@lru_cache(maxsize=KEPT)
def _shapes_of(*_: object) -> dict[int | None, LensShape]:
    """Return the meshes, by rings, of all scenes that are alike in what meshes of a lens depend on, as given."""
    return {}


@lru_cache(maxsize=2 * KEPT)
def _files_of(lens: Lens) -> tuple[tuple[str, str], ...]:
    return tuple(files_of(lens))
