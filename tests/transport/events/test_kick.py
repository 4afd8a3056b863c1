"""Directions behind diffracting apertures against closed forms of shares and transfer functions."""

import functools

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import j0, j1, sici

from lfmesh.kernels.decorators import kernel
from lfmesh.optics.diffraction import (
    HEXAGON,
    NEAR_SHARE,
    PARTS,
    RECTANGLE,
    ROUND,
    airy_quantiles,
    hexagon_cells,
    sinc2_quantiles,
)
from lfmesh.transport.events.kick import kick_by_key
from lfmesh.transport.packets.random import derived, descendant
from lfmesh.transport.tables.tables import Apertures

DRAWS = 400_000
LEVEL_SIGMA = 4.5
"""Of each test, in standard errors: wrong by chance once in 150,000."""


@kernel
def _fill(apertures: Apertures, key: np.uint64, kicks: np.ndarray) -> None:
    for i in range(len(kicks)):
        kicks[i, 0], kicks[i, 1] = kick_by_key(apertures, 0, derived(key, i), 3)


def apertures(shape: int, spread: tuple[float, float]) -> Apertures:
    """Apertures of a shape, with wavelengths over their widths."""
    quantiles = airy_quantiles() if shape == ROUND else sinc2_quantiles()
    cells = hexagon_cells() if shape == HEXAGON else np.empty((0, 2), np.float32)
    return Apertures(shape, np.array([spread]), quantiles, cells, row=0, to_lens=True, events=2, lever=1.0)


def kicks_of(shape: int, spread: float) -> np.ndarray:
    """Draw changes of direction over the spread, (n, 2): frequencies in cycles over the pitch or diameter."""
    kicks = np.empty((DRAWS, 2))
    _fill(apertures(shape, (spread, spread)), descendant(0x6B69636B, shape), kicks)
    return kicks / spread


def near(found: np.ndarray, expected: float) -> bool:
    """Compare a mean with its expected value by a z-test."""
    error = found.std() / np.sqrt(len(found))
    return bool(abs(found.mean() - expected) < LEVEL_SIGMA * error)


@functools.cache
def narrow(shape: int) -> np.ndarray:
    """Return changes over a spread that is small for any direction."""
    return kicks_of(shape, 1e-4)


CASES = {"A": (14.0, 25.0, 1.4), "D": (14.0, 56.0, 1.0), "B": (125.0, 500.0, 12.5), "C": (38.5, 154.0, 5.5)}
"""Pitch, distance from the sensor (of a focused camera 1.25 focal lengths) and pixel, µm, at 0.55 µm."""


def test_share_of_a_square_lenslets_light_on_a_pixel() -> None:
    """A pixel of 1.4 µm, 25 µm behind a lenslet of 14 µm: ∫ sinc² over it, by quadrature."""
    half = 0.7 / (0.55 * 25.0 / 14.0)
    one_axis = quad(lambda x: np.sinc(x) ** 2, -half, half)[0]
    assert one_axis == pytest.approx(0.8809, abs=1e-4)
    inside = np.abs(narrow(RECTANGLE)) < half
    assert near(inside[:, 0].astype(float), one_axis)
    assert near(inside[:, 1].astype(float), one_axis)
    assert near(inside.all(axis=1).astype(float), one_axis**2)


@pytest.mark.parametrize(("case", "printed"), [("A", 0.8246), ("D", 0.45), ("B", 0.956), ("C", 0.9)])
def test_squares_transfer_contrast_as_their_overlap_with_themselves(case: str, printed: float) -> None:
    """At half of Nyquist's frequency, a line in four pixels: 1 − λ f ν / p."""
    pitch, focal, pixel = CASES[case]
    shift = 0.55 * focal / (4.0 * pixel * pitch)
    assert 1.0 - shift == pytest.approx(printed, abs=1e-4)
    for axis in (0, 1):
        assert near(np.cos(2.0 * np.pi * shift * narrow(RECTANGLE)[:, axis]), 1.0 - shift)


@pytest.mark.parametrize("shift", [0.05, 0.175, 0.55, 0.9])
def test_hexagons_transfer_contrast_as_their_overlap_with_themselves(shift: float) -> None:
    """Along the rows of lenslets and across, by the hexagon's height over x, for shifts in pitches."""

    def height(x: float) -> float:
        return (2.0 - 2.0 * abs(x)) / np.sqrt(3.0) if abs(x) <= 0.5 else 0.0

    area = 0.5 * np.sqrt(3.0)
    along = quad(lambda x: min(height(x), height(x - shift)), -0.5 + shift, 0.5, points=[0.5 * shift])[0] / area
    across = quad(lambda x: max(height(x) - shift, 0.0), -0.5, 0.5, points=[0.0], limit=200)[0] / area
    assert near(np.cos(2.0 * np.pi * shift * narrow(HEXAGON)[:, 0]), along)
    assert near(np.cos(2.0 * np.pi * shift * narrow(HEXAGON)[:, 1]), across)


def hexagons_share(within: float) -> tuple[float, float]:
    """Share of a hexagon's light within a distance of the middle, across two of the sides and along them.

    A chord of width w sends w sinc²(w q) of its light there, summed over the other direction.
    """

    def share(width: float) -> float:
        x = width * within
        return float(2.0 / np.pi * (sici(2.0 * np.pi * x)[0] - np.sin(np.pi * x) ** 2 / (np.pi * x)))

    area, side = 0.5 * np.sqrt(3.0), 1.0 / np.sqrt(3.0)
    tip = quad(lambda y: 2.0 * np.sqrt(3.0) * y * share(2.0 * np.sqrt(3.0) * y), 0.0, 0.5 * side, limit=200)[0]
    half = quad(lambda x: 2.0 * (1.0 - x) * side * share(2.0 * (1.0 - x) * side), 0.0, 0.5, limit=200)[0]
    return (side * share(1.0) + 2.0 * tip) / area, 2.0 * half / area


@pytest.mark.parametrize("within", [0.3, 1.0, 2.5, 5.9, 6.1, 12.0, 100.0])
def test_hexagons_diffract_as_all_their_chords_do(within: float) -> None:
    """In the table of cells and beyond."""
    across, along = hexagons_share(within)
    assert near((np.abs(narrow(HEXAGON)[:, 0]) < within).astype(float), across)
    assert near((np.abs(narrow(HEXAGON)[:, 1]) < within).astype(float), along)


def test_cells_of_a_hexagons_table_hold_its_light() -> None:
    """Some cells against the transform of all chords, squared; and light within a distance, even in between."""
    cells = hexagon_cells()
    chances = np.zeros(len(cells))
    np.add.at(chances, np.arange(len(cells)), cells[:, 0])
    np.add.at(chances, cells[:, 1].astype(np.int64), 1.0 - cells[:, 0])
    chances /= len(cells)
    across = round(np.sqrt(len(cells) - 1))
    # Frequencies beyond the table have a product with a side that the search for them starts at.
    assert sinc2_quantiles()[int(PARTS * NEAR_SHARE) + 1] < 0.25 * 6.0
    x, weights = np.polynomial.legendre.leggauss(60)
    # Half of the chords, as their heights have a kink in the middle.
    x, weights, nodes = 0.25 * (x + 1.0), 0.25 * weights, np.polynomial.legendre.leggauss(4)
    height = 2.0 * (1.0 - x) / np.sqrt(3.0)
    for row, column in ((0, 0), (3, 20), (25, 25), (70, 1), (0, 100), (140, 90)):
        found = 0.0
        for u, at_u in zip(*nodes, strict=True):
            for v, at_v in zip(*nodes, strict=True):
                qx, qy = (np.array([column, row]) + 0.5 + 0.5 * np.array([u, v])) * 6.0 / across
                field = 2.0 * (weights * height * np.sinc(height * qy) * np.cos(2.0 * np.pi * qx * x)).sum()
                found += 0.25 * at_u * at_v * field**2 / (0.5 * np.sqrt(3.0))
        # Gaussian quadrature, of three points there and four here, and the four quarters.
        assert chances[across * row + column] == pytest.approx(4.0 * found * (6.0 / across) ** 2, rel=1e-3)
    edges = np.array([hexagons_share(max(at, 1e-9)) for at in np.linspace(0.0, 3.0, across // 2 + 1)])
    middles = np.array([hexagons_share(at) for at in 3.0 * (np.arange(across // 2) + 0.5) / (across // 2)])
    assert np.abs(0.5 * (edges[1:] + edges[:-1]) - middles).max() < 3.5e-4


@pytest.mark.parametrize(("within_um", "printed"), [(0.7, 0.6170), (1.4, 0.8379)])
def test_light_within_a_distance_behind_a_round_lenslet_is_rayleighs(within_um: float, printed: float) -> None:
    """At f/2: 1 − J₀² − J₁², v = π r / λN."""
    v = np.pi * within_um / (0.55 * 2.0)
    expected = 1.0 - j0(v) ** 2 - j1(v) ** 2
    assert expected == pytest.approx(printed, abs=1e-4)
    distance = np.hypot(narrow(ROUND)[:, 0], narrow(ROUND)[:, 1]) * 0.55 * 2.0
    assert near((distance < within_um).astype(float), expected)


@pytest.mark.parametrize(("case", "printed"), [("A", 0.7778), ("D", 0.3368), ("B", 0.944), ("C", 0.8729)])
def test_circles_transfer_contrast_as_their_overlap_with_themselves(case: str, printed: float) -> None:
    """At half of Nyquist's frequency, along three directions: 2/π (arccos ν − ν √(1 − ν²))."""
    pitch, focal, pixel = CASES[case]
    shift = 0.55 * focal / (4.0 * pixel * pitch)
    overlap = 2.0 / np.pi * (np.arccos(shift) - shift * np.sqrt(1.0 - shift**2))
    assert overlap == pytest.approx(printed, abs=1e-4)
    for turn in (0.0, 1.0, 0.5 * np.pi):
        along = narrow(ROUND) @ (np.cos(turn), np.sin(turn))
        assert near(np.cos(2.0 * np.pi * shift * along), overlap)


def test_airys_tail_falls_as_its_integral() -> None:
    """Beyond x diameters over λ lie J₀² + J₁² of the light, 2/(π² x) in the mean."""
    distance = np.hypot(narrow(ROUND)[:, 0], narrow(ROUND)[:, 1])
    for beyond in (3.9, 4.3, 5.0, 10.0, 100.0, 1000.0):
        expected = j0(np.pi * beyond) ** 2 + j1(np.pi * beyond) ** 2
        assert expected == pytest.approx(2.0 / (np.pi**2 * beyond), rel=0.1)
        assert near((distance > beyond).astype(float), expected)


def test_tails_fall_as_their_integral() -> None:
    """Beyond X on one axis lie 1/(π² X) of a square's light, to the second order."""
    for beyond in (10.0, 100.0, 1000.0):
        expected = 2.0 * quad(lambda x: np.sinc(x) ** 2, 0.0, beyond, limit=5000)[0]
        assert 1.0 - expected == pytest.approx(1.0 / (np.pi**2 * beyond), rel=1e-2)
        assert near((np.abs(narrow(RECTANGLE)[:, 0]) > beyond).astype(float), 1.0 - expected)


def test_shares_within_any_distance_are_those_of_the_density_to_their_stated_error() -> None:
    """The table's chances against quadrature of the densities over each part; the tail goes on at its end."""
    for quantiles, density_of in (
        (sinc2_quantiles(), lambda x: 2.0 * np.sinc(x) ** 2),
        (airy_quantiles(), lambda x: 2.0 * np.divide(j1(np.pi * x) ** 2, x, out=np.zeros_like(x), where=x > 0.0)),
    ):
        x = np.linspace(0.0, quantiles[-1], 200_001)
        density = density_of(x)
        within = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(x))])
        chances = np.interp(x, quantiles, np.arange(len(quantiles)) / PARTS)
        assert np.abs(chances - within).max() < 1.2e-4
        assert chances[-1] == pytest.approx(within[-1], abs=1e-8)


def test_no_change_is_beyond_a_right_angle() -> None:
    for shape in (RECTANGLE, ROUND):
        wide = kicks_of(shape, 0.3) * 0.3
        assert np.hypot(wide[:, 0], wide[:, 1]).max() < 1.0


def test_an_aperture_without_ends_does_not_diffract() -> None:
    kicks = np.empty((1000, 2))
    _fill(apertures(RECTANGLE, (0.04, 0.0)), descendant(1, 2), kicks)
    assert (kicks[:, 1] == 0.0).all()
    assert kicks[:, 0].std() > 0.0
