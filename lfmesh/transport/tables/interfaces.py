"""The interface table: the kind of each surface between two media, with its parameters.

A new kind is one line in `KINDS`, a branch of `_finish_of` that gives the surfaces of that kind and their parameters,
and its shares of the power in `transport.events.interface`. By this table the sequential engine refuses interfaces that
it cannot trace.
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
        Description in messages.
    is_smooth : bool
        Light continues along the reflected and the refracted direction only.
    """

    name: str
    is_smooth: bool


KINDS = (Kind("smooth and bare", is_smooth=True),)
"""Kinds by their number in the table."""


class Finish(NamedTuple):
    """Kind and parameters of one interface of a scene.

    Attributes
    ----------
    where : str
        Path in the scene file.
    kind : int
        Index in `KINDS`.
    parameters : tuple of tuple of float
        Rows of values, one for each wavelength.
    """

    where: str
    kind: int
    parameters: tuple[tuple[float, ...], ...] = ()


class InterfaceTables(NamedTuple):
    """The interfaces of each region.

    Attributes
    ----------
    lens : Interfaces
        One row for each refracting surface.
    array : Interfaces
        `CURVED_ROW` and `FLAT_ROW`.
    objects : Interfaces
        One row for each target; rows of opaque targets are not used.
    """

    lens: Interfaces
    array: Interfaces
    objects: Interfaces


def camera_finishes(scene: Scene, wavelengths_nm: tuple[float, ...]) -> tuple[list[Finish], list[Finish]]:
    """Return the finishes of the refracting surfaces of the lens, and of the curved and the flat face of the array."""
    lens = scene.camera.lens
    numbers = [i for i in range(len(lens.surfaces)) if not lens.is_pure_stop(i)]
    surfaces = [_finish_of(f"camera.lens.surfaces[{i}]", wavelengths_nm) for i in numbers]
    faces = [_finish_of(f"camera.mla, its {face} face", wavelengths_nm) for face in ("curved", "flat")]
    return surfaces, faces


def rough_interface(scene: Scene) -> str | None:
    """Describe the first surface of lens or array that is not smooth; None if all are."""
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
    """Return the finish of a surface; scene files have no other than smooth and bare as yet."""
    return Finish(where, kind=0)


def _table(finishes: list[Finish], colours: int) -> Interfaces:
    """Return interfaces as kernels read them."""
    rows = np.zeros(len(finishes), INTERFACE)
    rows["kind"] = [finish.kind for finish in finishes]
    rows["first"] = np.cumsum([0, *(len(finish.parameters) for finish in finishes[:-1])])[: len(finishes)]
    parameters = [numbers for finish in finishes for numbers in finish.parameters]
    return Interfaces(rows=rows, parameters=np.array(parameters, dtype=np.float64).reshape(-1, colours))
