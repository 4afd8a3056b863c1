"""The interface table: what stands at every surface between two media, by kind, and the numbers that belong to it.

A kind is one line in `KINDS`, a branch of `_finish_of` that tells which surfaces have it and with which numbers, and
its shares of the power in `transport.events.interface`. What the sequential engine cannot trace it refuses by this
table.
"""

from typing import NamedTuple

import numpy as np

from lfmesh.scene import Scene
from lfmesh.transport.tables.tables import INTERFACE, Interfaces


class Kind(NamedTuple):
    """A kind of interface.

    Attributes
    ----------
    name : str
        What messages call such a surface.
    is_smooth : bool
        A ray goes on along the reflected and the refracted direction alone.
    """

    name: str
    is_smooth: bool


KINDS = (Kind("smooth and bare", is_smooth=True),)
"""By their numbers in the table."""


class Finish(NamedTuple):
    """What one interface of a scene is.

    Attributes
    ----------
    where : str
        Its place in the scene file.
    kind : int
        Number in `KINDS`.
    parameters : tuple of tuple of float
        Rows of numbers, one a wavelength.
    """

    where: str
    kind: int
    parameters: tuple[tuple[float, ...], ...] = ()


class InterfaceTables(NamedTuple):
    """The interfaces of each region.

    Attributes
    ----------
    lens : Interfaces
        A row a refracting surface.
    array : Interfaces
        `CURVED_ROW` and `FLAT_ROW`.
    objects : Interfaces
        A row a target; nobody asks for that of an opaque one.
    """

    lens: Interfaces
    array: Interfaces
    objects: Interfaces


def camera_finishes(scene: Scene, wavelengths_nm: tuple[float, ...]) -> tuple[list[Finish], list[Finish]]:
    """Return what the refracting surfaces of the lens are, and the curved and the flat face of the array."""
    lens = scene.camera.lens
    numbers = [i for i in range(len(lens.surfaces)) if not lens.is_pure_stop(i)]
    surfaces = [_finish_of(f"camera.lens.surfaces[{i}]", wavelengths_nm) for i in numbers]
    faces = [_finish_of(f"camera.mla, its {face} face", wavelengths_nm) for face in ("curved", "flat")]
    return surfaces, faces


def rough_interface(scene: Scene) -> str | None:
    """Return which surface of lens or array is not smooth, in words; None: all are."""
    surfaces, faces = camera_finishes(scene, scene.transport.wavelengths_nm)
    for finish in (*surfaces, *(faces if scene.camera.mla is not None else ())):
        kind = KINDS[finish.kind]
        if not kind.is_smooth:
            return f"{finish.where} is {kind.name}"
    return None


def interface_tables(scene: Scene, wavelengths_nm: tuple[float, ...]) -> InterfaceTables:
    """Return the interfaces of lens, array and object space at some wavelengths, in nm."""
    surfaces, faces = camera_finishes(scene, wavelengths_nm)
    bodies = [_finish_of(f"targets[{i}]", wavelengths_nm) for i in range(len(scene.targets))]
    return InterfaceTables(
        lens=_table(surfaces, len(wavelengths_nm)),
        array=_table(faces, len(wavelengths_nm)),
        objects=_table(bodies, len(wavelengths_nm)),
    )


def _finish_of(where: str, wavelengths_nm: tuple[float, ...]) -> Finish:
    """Return what a surface is. None that a scene can ask for is anything but smooth and bare as yet."""
    return Finish(where, kind=0)


def _table(finishes: list[Finish], colours: int) -> Interfaces:
    """Return interfaces as kernels read them."""
    rows = np.zeros(len(finishes), INTERFACE)
    rows["kind"] = [finish.kind for finish in finishes]
    rows["first"] = np.cumsum([0, *(len(finish.parameters) for finish in finishes[:-1])])[: len(finishes)]
    parameters = [numbers for finish in finishes for numbers in finish.parameters]
    return Interfaces(rows=rows, parameters=np.array(parameters, dtype=np.float64).reshape(-1, colours))
