"""Error of pictures of extended light, with and without the diffraction of lenslets.

The reference is scalar wave optics, for a lens with a round pupil at infinity. Errors are sums over pixels of absolute
differences from it, relative to the light.

- White pictures of a wide array are computed for square lenslets, and for hexagonal ones with the sensor in their focal
  plane. Behind an unbounded array, the waves of a pupil point are a Fourier series over the lattice, in closed form.
  For the hexagons it is the lenslet's own transfer function: waves of neighbours leave no trace.
- White pictures behind other hexagons, and edges in focus behind the three nearest square lenslets (mean of an edge
  through a lenslet's centre and one between lenslets), are tabulated. The tables, which the tests compute by Fresnel
  integrals, are for pixels of about a tenth of the pitch and micro-images about 0.9 pitches wide.
- Edges behind hexagons are unknown.

All lenslets are thin. Rays include the aberrations of true faces geometrically; the kick ignores them. `lenslet_waves`
computes the resulting error of white pictures.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WIDTH, PIXELS = 0.9, 10
"""Parameters of the tables: width of micro-images in pitches, and pixels per pitch."""

LIKE_WIDTH, LIKE_PIXELS = 0.05, 2
"""Differences from these within which the tables represent a camera. At a width of 1, errors without diffraction are
half as large; with pixels of a fifteenth of the pitch they are up to half larger."""

LIKE_WIDTH_WITH = 0.11
"""The same for edges with diffraction, which change by a quarter at most, and hardly with smaller pixels."""

FOCAL_PLANE = 0.02
"""Distance from the focal plane, over the focal length, within which the sensor counts as in it."""

ACROSS_A_PIXEL, HEXAGON_ORDERS = 5, 2.4
"""For hexagons: points compared, and longest wave of the series, per pixel along a pitch."""

MOST_PIXELS = 20
"""Maximum number of pixels along a pitch; finer ones are binned."""

ORDERS_A_PIXEL, LEAST_ORDERS = 20, 100
"""Waves of the series per pixel along a pitch, and their minimum: further ones change errors by less than 10⁻⁴."""

FRESNEL_NUMBERS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Square of half a lenslet's width, over the wavelength times the distance from the sensor."""

DISTANCES = (0.7, 0.85, 1.0, 1.2, 1.4)
"""Distances of the sensor behind the lenslets, over their focal length."""

EDGE_WITHOUT = (0.5145, 0.2984, 0.1603, 0.0802, 0.0550, 0.0422)
EDGE_WITH = (0.0815, 0.0573, 0.0384, 0.0236, 0.0139, 0.0082)
"""Errors of edges in focus, by Fresnel number, with the sensor in the lenslets' focal plane."""

HEXAGONS_WITHOUT = (
    (0.2323, 0.1204, 0.0663, 0.0379, 0.0193, 0.0097),
    (0.3232, 0.1978, 0.0996, 0.0483, 0.0241, 0.0121),
    (0.3760, 0.2450, 0.1361, 0.0702, 0.0356, 0.0180),
    (0.2730, 0.1344, 0.0549, 0.0314, 0.0167, 0.0085),
    (0.1307, 0.0508, 0.0619, 0.0325, 0.0164, 0.0081),
)
HEXAGONS_WITH = (
    (0.0093, 0.0190, 0.0363, 0.0263, 0.0150, 0.0079),
    (0.0072, 0.0074, 0.0149, 0.0158, 0.0106, 0.0061),
    (0.0000, 0.0000, 0.0000, 0.0000, 0.0000, 0.0000),
    (0.0179, 0.0334, 0.0410, 0.0306, 0.0179, 0.0095),
    (0.0427, 0.0778, 0.0694, 0.0377, 0.0197, 0.0101),
)
"""Errors of white pictures behind hexagons, by distance and Fresnel number."""


class KickError(NamedTuple):
    """Relative errors of pictures of extended light, with and without the lenslets' diffraction.

    Attributes
    ----------
    white_without, white_with : float
    edge_without, edge_with : float or None
        None for hexagons, lenslets out of focus, and cameras unlike the tables'.
    true_faces : bool
        True if `white_with` is for the camera's own lenslets rather than thin ones.
    """

    white_without: float
    white_with: float
    edge_without: float | None
    edge_with: float | None
    true_faces: bool = False

    @property
    def lenslets_in_words(self) -> str:
        """Kind of lenslets that `white_with` applies to."""
        return "behind the true faces" if self.true_faces else "behind thin lenslets and more behind true faces"


def kick_error(
    fresnel_number: float, distance: float = 1.0, *, layout: str = "square", in_focus: bool = True,
    width: float = WIDTH, pixels: int = PIXELS,
) -> KickError | None:  # fmt: skip
    """Return the errors of a camera's pictures, or None for hexagons not covered by the tables.

    Parameters
    ----------
    fresnel_number : float
        Square of half a lenslet's width, over the wavelength times the distance from the sensor.
    distance : float
        Distance of the sensor behind the lenslets, over their focal length.
    layout : str
        "square" or "hexagonal".
    in_focus : bool
        True if the lenslets image the pupil sharply to a pixel, as the errors of edges require.
    width : float
        Width of micro-images, in pitches.
    pixels : int
        Pixels along a pitch.
    """
    within = FRESNEL_NUMBERS[0] <= fresnel_number <= FRESNEL_NUMBERS[-1]
    known = within and abs(width - WIDTH) <= LIKE_WIDTH and abs(pixels - PIXELS) <= LIKE_PIXELS
    if layout == "square":
        white = white_errors(fresnel_number, distance, width, pixels)
    elif abs(distance - 1.0) <= FOCAL_PLANE:
        white = hexagon_error(fresnel_number, width, pixels), 0.0
    elif known and DISTANCES[0] <= distance <= DISTANCES[-1]:
        tables = HEXAGONS_WITHOUT, HEXAGONS_WITH
        rows = [[_by_number(errors, fresnel_number) for errors in table] for table in tables]
        white = float(np.interp(distance, DISTANCES, rows[0])), float(np.interp(distance, DISTANCES, rows[1]))
    else:
        return None
    edges = in_focus and layout == "square"
    finer = within and abs(width - WIDTH) <= LIKE_WIDTH_WITH and pixels >= PIXELS - LIKE_PIXELS
    return KickError(
        *white,
        _by_number(EDGE_WITHOUT, fresnel_number) if edges and known else None,
        _by_number(EDGE_WITH, fresnel_number) if edges and finer else None,
    )


def _by_number(errors: tuple[float, ...], number: float) -> float:
    """Interpolate an error of a table at a Fresnel number."""
    # Errors are roughly inversely proportional to the number.
    return float(np.interp(np.log(number), np.log(FRESNEL_NUMBERS), np.multiply(errors, FRESNEL_NUMBERS))) / number


@lru_cache(maxsize=64)
def white_errors(fresnel_number: float, distance: float, width: float, pixels: int) -> tuple[float, float]:
    """Return the errors of white pictures behind square lenslets, without their diffraction and with it.

    Parameters
    ----------
    fresnel_number, distance, width, pixels
        As in `kick_error`.
    """
    pixels = min(pixels, MOST_PIXELS)
    most = max(ORDERS_A_PIXEL * pixels, LEAST_ORDERS)
    orders = np.arange(-most, most + 1)
    half = np.array([passed(order, fresnel_number, distance) for order in range(most + 1)])
    waves = np.concatenate([half[:0:-1].conj(), half])
    rays = np.sinc(orders * (1.0 - distance))
    turned = rays * np.clip(1.0 - np.abs(orders) / (4.0 * fresnel_number), 0.0, None)
    truth, without, with_kick = (white_picture(each, width, pixels) for each in (waves, rays, turned))
    light = truth.sum()
    return float(np.abs(without - truth).sum() / light), float(np.abs(with_kick - truth).sum() / light)


def passed(order: int, fresnel_number: float, distance: float) -> complex:
    """Return a Fourier coefficient of the light of an axial plane wave behind an unbounded array of lenslets T.

    With δ = order / 4F, in pitches, it is exp(iπ order δ) ∫ T(x − δ) T*(x) exp(−2πi order x) dx over a pitch, by
    convolution with Fresnel's kernel. Within each lenslet that contains x − δ, the integrand is a wave. Oblique waves
    have the same coefficients but shifted pictures.

    Parameters
    ----------
    order : int
    fresnel_number, distance
        As in `kick_error`.
    """
    total, shift = 0j, order / (4.0 * fresnel_number)
    for lenslet in range(math.floor(-shift), math.floor(1.0 - shift) + 1):
        low, high = max(-0.5, lenslet - 0.5 + shift), min(0.5, lenslet + 0.5 + shift)
        if low < high:
            off, part = shift + lenslet, high - low
            cycles = 4.0 * fresnel_number * distance * off - order
            phase = math.pi * (cycles * (low + high) - 4.0 * fresnel_number * distance * off * off + order * shift)
            total += part * float(np.sinc(cycles * part)) * complex(math.cos(phase), math.sin(phase))
    return total


def white_picture(coefficients: NDArray[np.complex128] | Array, width: float, pixels: int) -> Array:
    """Return the light on a lenslet's pixels, (n, n), from the coefficients of a point's picture in each axis.

    Parameters
    ----------
    coefficients : (2 m + 1,) complex128
        Orders from −m to m.
    width, pixels
        As in `kick_error`.
    """
    most = len(coefficients) // 2
    orders = np.arange(-most, most + 1)
    disk = _of_disk(width, np.hypot(orders[most:, None], orders[most:]))[np.ix_(abs(orders), abs(orders))]
    at = (np.arange(pixels) + 0.5) / pixels - 0.5
    waves = np.exp(2j * np.pi * np.outer(at, orders)) * np.sinc(orders / pixels) * coefficients
    return np.asarray((waves @ disk @ waves.T).real)


def _of_disk(width: float, frequency: Array) -> Array:
    """Return the Fourier coefficients of an evenly lit disk, relative to its light."""
    # Reading a scene must not import scipy.
    from scipy.special import j1

    x = np.pi * width * frequency
    return np.asarray(np.divide(2.0 * j1(x), x, out=np.ones_like(x), where=x > 0.0))


@lru_cache(maxsize=64)
def hexagon_error(fresnel_number: float, width: float, pixels: int) -> float:
    """Return the error of white pictures without diffraction behind hexagons, with the sensor in their focal plane.

    Parameters
    ----------
    fresnel_number, width, pixels
        As in `kick_error`.
    """
    pixels = min(pixels, MOST_PIXELS)
    longest, across = HEXAGON_ORDERS * pixels, ACROSS_A_PIXEL * pixels
    reach = math.ceil(longest)
    numbers = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2), axis=-1).reshape(-1, 2)
    # Frequencies of a lattice of pitch 1 with every second row shifted by half a pitch.
    orders = np.stack([numbers[:, 0], (2.0 * numbers[:, 1] - numbers[:, 0]) / math.sqrt(3.0)], axis=1)
    inside = np.hypot(*orders.T) <= longest
    numbers, orders = numbers[inside], orders[inside]
    rays = _of_disk(width, np.hypot(*orders.T)) * np.sinc(orders / pixels).prod(axis=1)

    def picture(coefficients: Array) -> Array:
        series = np.zeros((across, across))
        np.add.at(series, tuple(numbers.T % across), coefficients)
        return np.asarray(np.fft.fft2(series).real)

    truth = picture(rays * hexagons_in_common(orders / (4.0 * fresnel_number)))
    return float(np.abs(picture(rays) - truth).sum() / truth.sum())


def hexagons_in_common(shift: Array) -> Array:
    """Return the overlap of a hexagon and its shifted copy, as a fraction of its area.

    The overlap is a hexagon with the same angles: a rhomboid of its two narrower widths, minus two corners.

    Parameters
    ----------
    shift : (n, 2) float64
        In units of the distance between opposite sides; one pair is perpendicular to x.
    """
    angles = np.arange(3) * np.pi / 3.0
    along = shift @ np.stack([np.cos(angles), np.sin(angles)])
    low, middle, high = np.sort(np.maximum(1.0 - np.abs(along), 0.0), axis=1).T
    corner = np.maximum(0.5 * (low + middle - high), 0.0)
    return np.asarray((low * middle - corner**2) / 0.75)
