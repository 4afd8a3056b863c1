"""Tables for packets sent past lamps in scattering media, into the light scattered near the lamps.

Seen from distance D of a lamp of intensity I, single scattering at an angle α from the lamp has the radiance
κ I / (D sin α) ∫ p(ψ) dψ, from ψ = α to π, in an unbounded medium with the scattering coefficient κ and the phase
function p, before losses on the way. Along that line the scattering angle ψ grows from α to π, and the arriving light
is constant per step of ψ (equiangular sampling, Kulla & Fajardo, EGSR 2012). The tables hold this integral and its
integral over α, for the mean phase function of all media.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import kernel
from lfmesh.kernels.search import piece_with
from lfmesh.optics.phase import PhaseTables, evaluate_phase
from lfmesh.optics.quadrature import gauss_legendre
from lfmesh.transport.tables.tables import NOTHING_NEAR_LAMPS, SingleScatter
from lfmesh.transport.tables.volumes import NOT_IN_GRID, Volumes, corners_of

Array = NDArray[np.float64]

FINEST = 2.0**-17
"""Smallest angle, rad, that the table resolves from 0 and from π; phase functions have no narrower peaks."""

PIECES = 128
"""Number of equal pieces of the half circle. Towards 0 and towards π there are as many pieces again, in geometric
steps."""

EVEN = 0.1
"""Share of isotropic scattering in the table, because a phase function may have peaks narrower than the pieces."""

DENSE = 0.1
"""Scattering optical depth on the way to a lamp above which each point sends a packet past the lamp.

Below it, that light has little weight, and its variance falls with the square of the depth, and so does the share of
points.
"""

WORTH = 0.1
"""Share of points that send a packet, below which none does: the decision at each point would cost more."""


def single_scatter_tables(volumes: Volumes, lights: NDArray[np.void], size: float) -> SingleScatter:
    """Return the tables of a scene's media; empty ones if scattering near lamps is negligible.

    Parameters
    ----------
    volumes : Volumes
    lights : (lamps,) LIGHT
    size : float, mm
        Radius of a sphere about the origin that holds targets and camera.
    """
    rows = volumes.rows
    scattering = np.where((rows["inside"] == 0)[:, None], volumes.scattering, 0.0)
    if not volumes.scatters or not scattering.any() or not lights["placed"].any():
        return NOTHING_NEAR_LAMPS
    for number, row in enumerate(rows):
        if row["scattering"] != NOT_IN_GRID:
            voxels = int(np.prod(row["cells"]))
            scattering[number] *= volumes.values[row["scattering"] : row["scattering"] + voxels].max()
    extents = _extents(rows)
    far = max(size, float(np.linalg.norm(lights["position"][lights["placed"]], axis=1).max()))
    depth = float((scattering * np.minimum(extents, far)[:, None]).sum(axis=0).max())
    if min(depth / DENSE, 1.0) ** 2 < WORTH:
        return NOTHING_NEAR_LAMPS
    angles = _angles()
    middle, half = 0.5 * (angles[1:] + angles[:-1]), 0.5 * np.diff(angles)
    nodes, weights = gauss_legendre(8)
    found = np.zeros((scattering.shape[1], len(middle)))
    _mean_phase(volumes.phases, scattering, np.cos(middle[:, None] + half[:, None] * nodes), 0.5 * weights, found)
    phase = EVEN * 0.25 / np.pi + (1.0 - EVEN) * found
    pieces = 2.0 * half * phase
    beyond, below = np.zeros((2, len(phase), len(angles)))
    # Summed from the far end, so that the small numbers there keep their digits.
    beyond[:, :-1] = np.cumsum(pieces[:, ::-1], axis=1)[:, ::-1]
    below[:, 1:] = np.cumsum(half * (beyond[:, 1:] + beyond[:, :-1]), axis=1)
    return SingleScatter(angles, phase, beyond, below, scattering, extents)


def _angles() -> Array:
    """Return angles from 0 to π, rad, evenly spaced in the middle and ever closer towards both ends."""
    ends = np.geomspace(FINEST, 0.5 * np.pi, PIECES, endpoint=False)
    even = np.linspace(0.0, np.pi, PIECES + 1)
    return np.unique(np.concatenate([even, ends, np.pi - ends]))


def _extents(rows: NDArray[np.void]) -> Array:
    """Return the diagonal of the box around each medium, mm."""
    corners = [corners_of(row) for row in rows]
    return np.array([np.inf if each is None else np.linalg.norm(each[-1] - each[0]) for each in corners])


@kernel
def _mean_phase(phases: PhaseTables, scattering: Array, cosines: Array, weights: Array, found: Array) -> None:
    """Fill in the mean phase function of all scattering media, averaged over the cosines of each piece."""
    for colour in range(len(found)):
        count = 0
        for number in range(len(scattering)):
            if scattering[number, colour] <= 0.0:
                continue
            count += 1
            row = phases.rows[number, colour]
            for piece in range(len(cosines)):
                for node in range(len(weights)):
                    found[colour, piece] += weights[node] * evaluate_phase(phases, row, cosines[piece, node])
        for piece in range(len(cosines)):
            found[colour, piece] = found[colour, piece] / count if count > 0 else 0.25 / np.pi


@kernel
def light_beyond(near_lamps: SingleScatter, colour: int, angle: float) -> float:
    """Return the integral of the mean phase function from an angle to π, 1/sr.

    Parameters
    ----------
    near_lamps : SingleScatter
    colour : int
        Number of the wavelength.
    angle : float
        rad, 0 to π.
    """
    k = piece_with(near_lamps.angles, angle)
    return near_lamps.beyond[colour, k + 1] + near_lamps.phase[colour, k] * max(near_lamps.angles[k + 1] - angle, 0.0)


@kernel
def phase_at(near_lamps: SingleScatter, colour: int, angle: float) -> float:
    """Return the mean phase function at an angle, 1/sr: minus the derivative of `light_beyond`.

    Parameters
    ----------
    near_lamps, colour, angle
        As for `light_beyond`.
    """
    return near_lamps.phase[colour, piece_with(near_lamps.angles, angle)]


@kernel
def angle_beyond(near_lamps: SingleScatter, colour: int, light: float) -> float:
    """Return the angle, rad, for a value of `light_beyond`.

    Parameters
    ----------
    near_lamps, colour
        As for `light_beyond`.
    light : float
    """
    low, high = 0, len(near_lamps.angles) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if near_lamps.beyond[colour, middle] >= light:
            low = middle
        else:
            high = middle
    angle = near_lamps.angles[low + 1] - (light - near_lamps.beyond[colour, low + 1]) / near_lamps.phase[colour, low]
    return min(max(angle, near_lamps.angles[low]), near_lamps.angles[low + 1])


@kernel
def drawn_angle(near_lamps: SingleScatter, colour: int, u: float) -> float:
    """Return an angle from a lamp, rad, drawn in proportion to `light_beyond`.

    Parameters
    ----------
    near_lamps, colour
        As for `light_beyond`.
    u : float
        Uniform in [0, 1).
    """
    last = len(near_lamps.angles) - 1
    wanted = u * near_lamps.below[colour, last]
    k = piece_with(near_lamps.below[colour], wanted)
    rest, at_begin = wanted - near_lamps.below[colour, k], near_lamps.beyond[colour, k]
    # The root of b x − p x² / 2 = rest, in the form that holds for any p.
    root = np.sqrt(max(at_begin * at_begin - 2.0 * near_lamps.phase[colour, k] * rest, 0.0))
    return min(near_lamps.angles[k] + 2.0 * rest / (at_begin + root), near_lamps.angles[k + 1])
