"""Tables of polarised light for kernels: layers of coatings with their phases, lights, and the polariser.

Polarised packets are divided by the layers' amplitudes, computed at every event: the tables of `tables.coatings` hold
shares of unpolarised power, without phases.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.kernels.by_address import by_address
from lfmesh.optics.coatings import Stack
from lfmesh.scene import Scene
from lfmesh.scene.materials.coatings import UNCOATED
from lfmesh.transport.packets.book import Book
from lfmesh.transport.packets.packet import SENSOR_FRAME, WORLD_FRAME
from lfmesh.transport.tables.coatings import stack_of
from lfmesh.transport.tables.interfaces import POLARISER, Face, faces_of_regions
from lfmesh.transport.tables.tables import NO_SLOT

FILM = np.dtype(
    [
        ("first", "i8"),  # first layer
        ("count", "i8"),  # number of layers; 0: a bare interface
        ("turned", "?"),  # the first layer is on the far side, see `tables.interfaces.Face`
        ("absorbs", "?"),
        ("slot", "i8"),  # slot of the book for absorbed light
    ]
)

IN_LENS, IN_ARRAY, IN_OBJECTS = 0, 1, 2
"""Regions, in the order of `PolarisationTables.begin`."""


@by_address
class PolarisationTables(NamedTuple):
    """Tables of a scene with polarised light."""

    begin: NDArray[np.int64]  # (3,) film of the first interface of lens, array and object space
    films: NDArray[np.void]  # (n,) FILM: one per row of the regions' interfaces
    indices: NDArray[np.complex128]  # (layers of all films, wavelengths)
    thicknesses: NDArray[np.float64]  # (layers of all films,) nm
    wavelengths: NDArray[np.float64]  # nm
    lights: NDArray[np.float64]  # (lights, 3) Q, U and V over I, with the reference direction of `across`
    has_polariser: bool
    absorbing: NDArray[np.float64]  # (3,) absorbing axis of the polariser, world frame
    slot: int  # slot of the book for light absorbed by the polariser


def polarisation_tables(
    scene: Scene, wavelengths_nm: Sequence[float], moves: Array, book: Book
) -> PolarisationTables | None:
    """Return the tables of a scene with polarised light; None for any other.

    Parameters
    ----------
    scene : Scene
    wavelengths_nm : sequence of float
    moves : (6, 6, 3, 4) float64
        See `tables.frames`.
    book : Book
    """
    if not scene.transport.polarisation:
        return None
    regions = faces_of_regions(scene)
    faces = [face for region in regions for face in region]
    films = np.zeros(len(faces), FILM)
    indices: list[list[complex]] = []
    thicknesses: list[float] = []
    for film, face in zip(films, faces, strict=True):
        film["first"], film["turned"] = len(thicknesses), face.begins_behind
        film["slot"] = book.coatings.get(face.body, NO_SLOT)
        stacks = [_stack(scene, face, wavelength) for wavelength in wavelengths_nm]
        film["count"], film["absorbs"] = len(stacks[0].indices), any(stack.absorbs for stack in stacks)
        indices += np.transpose([stack.indices for stack in stacks]).tolist()
        thicknesses += stacks[0].thicknesses_nm
    angle = np.deg2rad(scene.camera.polariser_deg or 0.0)
    along = frame.directions(moves[SENSOR_FRAME, WORLD_FRAME], [-np.sin(angle), np.cos(angle), 0.0])
    return PolarisationTables(
        begin=np.cumsum([0, *(len(region) for region in regions[:-1])]),
        films=films,
        indices=np.array(indices, np.complex128).reshape(-1, len(wavelengths_nm)),
        thicknesses=np.array(thicknesses),
        wavelengths=np.array(wavelengths_nm, np.float64),
        lights=_states_of_lights(scene),
        has_polariser=scene.camera.polariser_deg is not None,
        absorbing=along / np.linalg.norm(along),
        slot=book.coatings.get(POLARISER, NO_SLOT),
    )


def _stack(scene: Scene, face: Face, wavelength_nm: float) -> Stack:
    layers = scene.all_coatings[face.coating].layers if face.coating != UNCOATED else None
    return stack_of(layers or (), wavelength_nm)


def _states_of_lights(scene: Scene) -> Array:
    """Return Q, U and V over I of the light of each lamp, (lights, 3)."""
    states = np.zeros((len(scene.lights), 3))
    for state, light in zip(states, scene.lights, strict=True):
        if light.state is not None:
            state[:] = light.state.stokes
    return states
