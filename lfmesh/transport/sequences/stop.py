"""Stop of the lens for ray blocks: ends rays outside its aperture, and may diffract the others.

A deflection at the stop, in n sin θ along it, is the same everywhere in the pupil. Étendue is conserved from there to
the image, so a deflection shifts a ray at the image by the same distance from anywhere in the pupil: by λ N for λ over
the stop's diameter, whatever the glass in between and the pupil magnification.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.surfaces.surface import normal_at
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.kernels.vector import select
from lfmesh.transport.events.interface import is_thin_lens
from lfmesh.transport.events.kick import turned_along
from lfmesh.transport.packets.book import EVANESCENT, STOP
from lfmesh.transport.sequences.bundle import (
    AT_X,
    AT_Y,
    AT_Z,
    BLOCK,
    DX,
    DY,
    DZ,
    ENDED_ON,
    ETENDUE,
    FATE,
    X,
    Y,
    Z,
    absorb,
    end_by_fate,
    move_bundle,
    set_fate,
)
from lfmesh.transport.sequences.kicks import kick_of_ray
from lfmesh.transport.tables.tables import LensTables

Array = NDArray[np.float64]


@kernel
def through_stop(bundle: Array, lens: LensTables, colour: int, book: Array) -> None:
    """End rays outside the stop's aperture, and diffract the others.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
        Camera frame.
    lens : LensTables
        Lens with a stop that is not a refracting surface.
    colour : int
        Wavelength number.
    book : (slots,) float64
        Receives light absorbed by media.
    """
    if lens.stop_posed:
        move_bundle(bundle, lens.stop_unpose)
    _meet_stop(bundle, lens.stop_z, lens.stop_radius * lens.stop_radius)
    medium = lens.medium[lens.stop_space]
    _go_to_stop(lens.aperture, bundle, lens.stop_z)
    absorb(bundle, lens.media.absorption, medium, colour, book)
    end_by_fate(bundle)
    _turn_at_stop(lens.aperture, bundle, colour, lens.media.indices[medium, colour])
    if lens.stop_posed:
        move_bundle(bundle, lens.stop_pose)


@kernel
def _meet_stop(bundle: Array, stop_z: float, limit: float) -> None:
    for i in range(BLOCK):
        t = (stop_z - bundle[Z + i]) / bundle[DZ + i]
        x, y = bundle[X + i] + t * bundle[DX + i], bundle[Y + i] + t * bundle[DY + i]
        passes = x * x + y * y <= limit
        # A ray that passes stays where it is.
        set_fate(bundle, i, select(passes, 0.0, t), select(passes, 0.0, STOP + 1.0))
        bundle[AT_Z + i] = select(passes, bundle[Z + i], stop_z)


@inlined
def _go_to_stop(aperture: Any, bundle: Array, stop_z: float) -> None:
    """Set the intersections of passing rays with a stop that diffracts."""
    if aperture is None:
        return
    for i in range(BLOCK):
        if bundle[FATE + i] == 0.0:
            set_fate(bundle, i, (stop_z - bundle[Z + i]) / bundle[DZ + i], 0.0)
            bundle[AT_Z + i] = stop_z


@inlined
def _turn_at_stop(aperture: Any, bundle: Array, colour: int, index: float) -> None:
    """Move rays to a stop that diffracts, and deflect them there."""
    if aperture is None:
        return
    for i in range(BLOCK):
        if bundle[ENDED_ON + i] == 0.0:
            bundle[X + i], bundle[Y + i], bundle[Z + i] = bundle[AT_X + i], bundle[AT_Y + i], bundle[AT_Z + i]
            _turn(bundle, i, kick_of_ray(aperture, bundle, i, colour), index, 0.0, 0.0, 1.0)


@inlined
def turn_behind_stop(aperture: Any, bundle: Array, lens: LensTables, k: int, colour: int, sense: float) -> None:
    """Diffract rays behind a refracting surface, if it is the stop and diffracts.

    Refraction conserves n sin θ along the surface, so the side of the deflection does not matter. A thin lens
    conserves differences of slopes instead: there slopes change, and étendue as at the lens itself.

    Parameters
    ----------
    aperture : Apertures or None
        Apertures of the lens.
    bundle : (ROWS · BLOCK,) float64
        Camera frame.
    lens : LensTables
    k : int
        Surface number.
    colour : int
        Wavelength number.
    sense : float
        1 for rays towards the sensor, −1 for others.
    """
    if aperture is None:
        return
    surface = lens.surfaces[k]
    if surface.stop != 1:
        return
    if surface.posed:
        move_bundle(bundle, surface.unpose)
    index = lens.media.indices[lens.medium[k + 1 if sense > 0.0 else k], colour]
    thin = is_thin_lens(lens.interfaces, k)
    for i in range(BLOCK):
        if bundle[ENDED_ON + i] != 0.0:
            continue
        kick = kick_of_ray(aperture, bundle, i, colour)
        if thin:
            dz = abs(bundle[DZ + i])
            ux, uy = bundle[DX + i] + kick[0] * dz, bundle[DY + i] + kick[1] * dz
            scale2 = 1.0 / (ux * ux + uy * uy + dz * dz)
            scale = np.sqrt(scale2)
            bundle[DX + i], bundle[DY + i], bundle[DZ + i] = ux * scale, uy * scale, bundle[DZ + i] * scale
            bundle[ETENDUE + i] *= scale2 * scale2
        else:
            nx, ny, nz = normal_at(surface, bundle[X + i], bundle[Y + i], bundle[Z + i] - surface.vertex_z)
            _turn(bundle, i, kick, index, nx, ny, nz)
    if surface.posed:
        move_bundle(bundle, surface.pose)


@inlined
def _turn(bundle: Array, i: int, kick: tuple[float, float], index: float, nx: float, ny: float, nz: float) -> None:
    """Deflect a ray along a face, in n sin θ, or end it if no such direction exists."""
    goes_on, dx, dy, dz = turned_along(
        (kick[0] / index, kick[1] / index), (bundle[DX + i], bundle[DY + i], bundle[DZ + i]), (nx, ny, nz)
    )
    bundle[DX + i], bundle[DY + i], bundle[DZ + i] = dx, dy, dz
    if not goes_on:
        bundle[ENDED_ON + i] = EVANESCENT + 1.0
