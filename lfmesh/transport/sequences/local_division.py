"""Division of light at a face of gradient-index glass: each ray of a block has indices of its own."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import kernel
from lfmesh.transport.events.interface import shares
from lfmesh.transport.sequences.bundle import (
    AT_X,
    AT_Y,
    AT_Z,
    BLOCK,
    DX,
    DY,
    DZ,
    ENDED_ON,
    FATE,
    INDEX_BEFORE,
    INDEX_BEHIND,
    NX,
    NY,
    NZ,
    WEIGHT,
)
from lfmesh.transport.sequences.division import go_on
from lfmesh.transport.tables.tables import ABSORBING, Interfaces

Array = NDArray[np.float64]


@kernel
def divide_locally(
    bundle: Array, interfaces: Interfaces, number: int, colour: int, outward: bool, mirrors: bool, book: Array
) -> None:
    """Take the rays of a bundle through a polished face, or reflect them there, as `division.divide` does.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
        With the indices before and after the face in `INDEX_BEFORE` and `INDEX_BEHIND`.
    interfaces : Interfaces
        Interfaces of the region.
    number, colour : int
        Row of the interface, and number of the wavelength.
    outward : bool
        Rays come from the side of a coating's last layer.
    mirrors : bool
        Reflect the rays; else refract them.
    book : (slots,) float64
        Receives light absorbed by a coating.
    """
    row, absorbed = interfaces.rows[number], 0.0
    for i in range(BLOCK):
        ux, uy, uz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        share, taken = 1.0, 0.0
        if bundle[ENDED_ON + i] == 0.0 and bundle[FATE + i] == 0.0:
            nx, ny, nz = bundle[NX + i], bundle[NY + i], bundle[NZ + i]
            n_i, n_t = bundle[INDEX_BEFORE + i], bundle[INDEX_BEHIND + i]
            cos_i = min(nx * ux + ny * uy + nz * uz, 1.0)
            reflectance, passed, cos_t = shares(interfaces, number, colour, n_i, n_t, cos_i, outward)
            if row.kind == ABSORBING:
                taken = bundle[WEIGHT + i] * (1.0 - reflectance - passed)
                absorbed += taken
            eta = 1.0 if mirrors else n_i / n_t
            g = -2.0 * cos_i if mirrors else cos_t - eta * cos_i
            share = reflectance if mirrors else passed
            ux, uy, uz = eta * ux + g * nx, eta * uy + g * ny, eta * uz + g * nz
        x, y, z = bundle[AT_X + i], bundle[AT_Y + i], bundle[AT_Z + i]
        go_on(bundle, i, True, Ray(x, y, z, ux, uy, uz), bundle[FATE + i], share, taken)
    if absorbed != 0.0:
        book[row.slot] += absorbed
