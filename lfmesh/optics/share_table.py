"""Tables of a coating's reflectance and transmittance by angle, for kernels.

One table serves both sides of a coating between two media. Its variable is the cosine m in the thinner medium, which
has the larger angles: light from the denser medium reaches m = 0, an end of the table, at its critical angle. In √m
there is no square root at that end, and the steep part near grazing incidence is spread out. Under total reflection an
absorbing coating reflects less than 1; that branch is a function of u = s / (1 + √(1 − s²)), with s the cosine over
that of the critical angle, which removes the square roots at both ends.

The range is cut into equal pieces with polynomials through Chebyshev nodes. Their number is doubled until the error
between nodes is below `TOLERANCE`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, pasted
from lfmesh.kernels.vector import select

Array = NDArray[np.float64]

TERMS = 6
"""Number of coefficients of a piece's polynomial, in the distance from its centre."""

TOLERANCE = 1e-8
"""Interpolation error at which the number of pieces is sufficient."""

ALLOWED = 1e-6
"""Largest acceptable interpolation error of a table of layers."""

ALLOWED_MEASURED = 1e-3
"""The same for a measured table, which is hardly more accurate: noise over many angles is not smooth in u."""

MOST_PIECES = 8192

FROM_THIN, FROM_DENSE, PASSED, TOTAL = 0, 1, 2, 3
"""Quantities of a table: reflectance from the thinner and the denser medium, transmittance, and reflectance under total
reflection. Without absorption, the first one determines all."""

_CHECKED = np.concatenate([[0.0, 1.0], 0.5 - 0.5 * np.cos(np.pi * np.arange(1, 2 * TERMS) / (2 * TERMS))])

Shares = Callable[[Array, bool], Array]
"""Compute the quantities of a table, (quantities, n), at values of its variable: √m, or u if the second is true."""


class TooManyPiecesError(Exception):
    """Values change too fast with the angle for the largest table; the argument is the error."""


@dataclass(frozen=True)
class ShareTable:
    """Reflectance and transmittance of a coating between two media at one wavelength.

    Attributes
    ----------
    coefficients : (quantities, pieces, TERMS) float64
        Only `FROM_THIN` if nothing is absorbed, else all four.
    error : float
        Largest interpolation error found.
    """

    coefficients: Array
    error: float

    @property
    def pieces(self) -> int:
        """Number of pieces."""
        return self.coefficients.shape[1]


def constant(reflectance: float) -> ShareTable:
    """Return the table of a coating with constant reflectance and no absorption."""
    coefficients = np.zeros((1, 1, TERMS))
    coefficients[0, 0, 0] = reflectance
    return ShareTable(coefficients, 0.0)


def tabulated(shares: Shares, absorbs: bool, least: int = 1, allowed: float = ALLOWED) -> ShareTable:
    """Tabulate the reflectance and transmittance of a coating.

    Parameters
    ----------
    shares : callable
    absorbs : bool
    least : int
        Minimum number of pieces, a power of 2.
    allowed : float
        Largest interpolation error.

    Raises
    ------
    TooManyPiecesError
    """
    pieces = max(least, 16)
    while True:
        parts = [_fitted(lambda u: shares(u, False), pieces)]
        if absorbs:
            parts.append(_fitted(lambda u: shares(u, True), pieces))
        error = max(part[1] for part in parts)
        if error <= TOLERANCE or 2 * pieces > MOST_PIECES:
            break
        pieces *= 2
    if not error <= allowed:
        raise TooManyPiecesError(error)
    return ShareTable(np.concatenate([part[0] for part in parts]), error)


def _fitted(shares: Callable[[Array], Array], pieces: int) -> tuple[Array, float]:
    """Return the polynomials of all pieces, (quantities, pieces, TERMS), and their largest error."""
    nodes = 0.5 - 0.5 * np.cos(np.pi * (np.arange(TERMS) + 0.5) / TERMS)
    left = np.arange(pieces)[:, None]
    at_nodes = shares(((left + nodes) / pieces).ravel()).reshape(-1, pieces, TERMS)
    fit = np.linalg.inv(np.vander(nodes - 0.5, TERMS, increasing=True))
    coefficients = at_nodes @ fit.T
    truth = shares(((left + _CHECKED) / pieces).ravel()).reshape(-1, pieces, len(_CHECKED))
    found = coefficients @ np.vander(_CHECKED - 0.5, TERMS, increasing=True).T
    return coefficients, float(np.abs(found - truth).max())


@pasted
def place_in_table(u: float, pieces: int) -> tuple[float, float]:
    """Return the piece that contains a value of the table's variable, and the distance from its centre.

    Without branches, so that loops over rays are vectorised; NaN falls into the first piece.
    """
    place = select(u > 0.0, select(u < 1.0, u, 1.0), 0.0) * pieces
    piece = np.floor(place)
    piece = select(piece < pieces - 1.0, piece, pieces - 1.0)
    return piece, place - piece - 0.5


@pasted
def variable_under_total_reflection(n_i: float, n_t: float, cos_i: float) -> float:
    """Return the variable u of `TOTAL`.

    Parameters
    ----------
    n_i, n_t : float
        Indices before and behind the coating, the second one smaller.
    cos_i : float
        Cosine of incidence.
    """
    s2 = cos_i * cos_i * n_i * n_i / ((n_i - n_t) * (n_i + n_t))
    s2 = select(s2 < 1.0, s2, 1.0)
    return np.sqrt(s2) / (1.0 + np.sqrt(1.0 - s2))


@inlined
def side_of_table(n_i: float, n_t: float, outward: bool) -> int:
    """Return the table quantity that is the reflectance from a side.

    Parameters
    ----------
    n_i, n_t, outward
        As in `coated_shares`.
    """
    return FROM_DENSE if n_i > n_t or (n_i == n_t and outward) else FROM_THIN


@inlined
def looked_up(parameters: Array, first: int, pieces: int, colour: int, u: float) -> float:
    """Evaluate one quantity, 0 to 1, from its polynomials.

    Parameters
    ----------
    parameters : (n, wavelengths) float64
    first, pieces : int
        Row of the quantity's first coefficient, and number of pieces.
    colour : int
        Wavelength index.
    u : float
        Variable, 0 to 1.
    """
    piece, x = place_in_table(u, pieces)
    at = first + TERMS * int(piece)
    share = parameters[at + 5, colour]
    share = parameters[at + 4, colour] + x * share
    share = parameters[at + 3, colour] + x * share
    share = parameters[at + 2, colour] + x * share
    share = parameters[at + 1, colour] + x * share
    share = parameters[at, colour] + x * share
    return min(max(share, 0.0), 1.0)


@inlined
def coated_shares(
    parameters: Array, first: int, pieces: int, absorbs: bool, colour: int,
    n_i: float, n_t: float, cos_i: float, cos_t: float, total: bool, outward: bool,
) -> tuple[float, float]:  # fmt: skip
    """Return reflectance and transmittance of a coating.

    Parameters
    ----------
    parameters : (n, wavelengths) float64
    first, pieces : int
        Row of the table's first coefficient, and number of pieces.
    absorbs : bool
        True if the table has all quantities.
    colour : int
        Wavelength index.
    n_i, n_t, cos_i, cos_t : float
        Index and cosine before and behind the coating.
    total : bool
    outward : bool
        Light comes from the last layer's side. Between equal indices the first side counts as the thinner medium.
    """
    size = TERMS * pieces
    if total:
        if not absorbs:
            return 1.0, 0.0
        u = variable_under_total_reflection(n_i, n_t, cos_i)
        return looked_up(parameters, first + TOTAL * size, pieces, colour, u), 0.0
    u = np.sqrt(min(cos_i, cos_t))
    if not absorbs:
        reflectance = looked_up(parameters, first, pieces, colour, u)
        return reflectance, 1.0 - reflectance
    reflectance = looked_up(parameters, first + side_of_table(n_i, n_t, outward) * size, pieces, colour, u)
    return reflectance, min(looked_up(parameters, first + PASSED * size, pieces, colour, u), 1.0 - reflectance)
