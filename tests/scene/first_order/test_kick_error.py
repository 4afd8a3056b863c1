"""The table of errors of pictures of extended light, against Fresnel integrals behind square lenslets.

Lengths along the sensor are in pitches. The pupil is at infinity and incoherent for white light: each of its points
sends a plane wave to all lenslets, whose waves add up on the sensor. Pictures of an array without end are Fourier
series over the pitch. At an edge each object point sends all plane waves at once. x and y are independent but for the
round pupil.
"""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from scipy.special import j1

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene.first_order import kick_error
from tests.instances import instances

Array = NDArray[np.float64]

PIXELS, INNER = 10, 3
"""Pixels a lenslet; nodes of a pixel."""
FILL, LIT = 0.9, 4
"""Width of micro-images; lenslets on each side of the middle one."""
ROWS = 90
"""Points across the pupil, times a whole number: as many to each pixel. Edges are summed over this many rows."""
MIDDLE = slice(PIXELS, 2 * PIXELS)
ORDERS = 200
"""Of the series over a pitch: those beyond change errors by less than 10⁻⁴."""


class Pupil:
    """A camera of some Fresnel number whose sensor stands at a distance, over the focal length of the lenslets."""

    def __init__(self, fresnel: float, distance: float = 1.0) -> None:
        self.fresnel, self.distance = fresnel, distance
        # Waves of all points repeat beyond the lenslets that are lit; borders of pixels lie between points.
        count = ROWS * int(np.ceil(max(1.0, 0.4 * fresnel)))
        self.points = ((np.arange(count) + 0.5) / count - 0.5) * FILL
        self.pixels = (np.arange(3 * PIXELS) + 0.5) / PIXELS - 1.5
        nodes, weights = leggauss(INNER)
        self.places = (self.pixels[:, None] + 0.5 / PIXELS * nodes).ravel()
        self.weights = np.tile(0.5 / PIXELS * weights, len(self.pixels))

    def on_pixels(self, values: Array) -> Array:
        return np.add.reduceat(self.weights[:, None] * values, np.arange(0, len(self.weights), INNER), axis=0)

    def disk(self) -> Array:
        return np.asarray(np.hypot(self.points[:, None], self.points) < 0.5 * FILL, np.float64)

    def waves(self) -> NDArray[np.complex128]:
        """Return the field at each place of the sensor of each point's plane wave."""
        nodes, weights = leggauss(int(60 + 60 * self.fresnel))
        field, phase = np.zeros((len(self.places), len(self.points)), np.complex128), 4j * np.pi * self.fresnel
        for lenslet in range(-LIT, LIT + 1):
            x = lenslet + 0.5 * nodes
            onto = np.exp(phase * ((self.places[:, None] - x) ** 2 - self.distance * (x - lenslet) ** 2))
            field += (0.5 * weights * onto) @ np.exp(2.0 * phase * np.outer(x, self.points))
        return np.sqrt(4.0 * self.fresnel) * field

    def kicked(self, lit: Callable[[int], float] = lambda _: 1.0) -> Array:
        """Return the light of each point on each pixel, of rays that are turned at the lenslets by sinc²."""
        light = np.zeros((len(self.places), len(self.points)))
        for lenslet in range(-LIT, LIT + 1):
            off = self.places[:, None] - lenslet - self.points
            light += lit(lenslet) * 4.0 * self.fresnel * np.sinc(4.0 * self.fresnel * off) ** 2
        return self.on_pixels(light)

    def plain(self, lit: Callable[[int], float] = lambda _: 1.0) -> Array:
        """Return the same of rays that are not turned."""
        width, light = 1e-9, np.zeros((len(self.pixels), len(self.points)))
        low = self.pixels[:, None] - 0.5 / PIXELS - self.points
        for lenslet in range(-LIT, LIT + 1):
            ends = [np.clip((end - lenslet) / width, -0.5, 0.5) for end in (low, low + 1.0 / PIXELS)]
            light += lit(lenslet) * (ends[1] - ends[0])
        return light


def difference(found: Array, wanted: Array) -> float:
    return float(np.abs(found - wanted).sum() / wanted.sum())


def passed(order: int, fresnel: float, distance: float) -> complex:
    """Return a coefficient of the series of the light of a plane wave along the axis, behind lenslets T without end.

    With δ = order / 4F it is exp(iπ order δ) ∫ T(x − δ) T*(x) exp(−2πi order x) dx over a pitch, by the convolution of
    T with Fresnel's kernel. In each lenslet that x − δ is in, the integrand is a wave. A wave that comes aslant has the
    same coefficients, of a picture that is shifted.
    """
    total, shift = 0j, order / (4.0 * fresnel)
    for lenslet in range(int(np.floor(-shift)), int(np.floor(1.0 - shift)) + 1):
        low, high = max(-0.5, lenslet - 0.5 + shift), min(0.5, lenslet + 0.5 + shift)
        if low < high:
            off, width = shift + lenslet, high - low
            cycles = 4.0 * fresnel * distance * off - order
            phase = np.pi * (cycles * (low + high) - 4.0 * fresnel * distance * off * off + order * shift)
            total += width * np.sinc(cycles * width) * np.exp(1j * phase)
    return total


def picture(coefficients: NDArray[np.complex128]) -> Array:
    """Return the light on a lenslet's pixels, (n, n), by the coefficients in each axis of a picture of a point."""
    orders = np.arange(-ORDERS, ORDERS + 1)
    x = np.pi * FILL * np.hypot(orders[:, None], orders)
    disk = np.divide(2.0 * j1(x), x, out=np.ones_like(x), where=x > 0.0)
    at = (np.arange(PIXELS) + 0.5) / PIXELS - 0.5
    waves = np.exp(2j * np.pi * np.outer(at, orders)) * np.sinc(orders / PIXELS) * coefficients
    return np.asarray((waves @ disk @ waves.T).real)


def wave_picture(fresnel: float, distance: float) -> Array:
    """Return the white picture by waves."""
    return picture(np.array([passed(order, fresnel, distance) for order in range(-ORDERS, ORDERS + 1)]))


def white(fresnel: float, distance: float) -> tuple[float, float]:
    """Return the errors of white pictures without and with the kick."""
    orders, truth = np.arange(-ORDERS, ORDERS + 1), wave_picture(fresnel, distance)
    rays = np.sinc(orders * (1.0 - distance)).astype(np.complex128)
    turned = rays * np.clip(1.0 - np.abs(orders) / (4.0 * fresnel), 0.0, None)
    return difference(picture(rays), truth), difference(picture(turned), truth)


def edge(fresnel: float, at: float) -> tuple[float, float]:
    """Return the same of the picture of an edge that is in focus across the lenslets, `at` off a lenslet's middle."""
    pupil = Pupil(fresnel)
    waves, step = pupil.waves(), pupil.points[1] - pupil.points[0]

    def lit(lenslet: int) -> float:
        return min(max(lenslet + 0.5 - at, 0.0), 1.0)

    spacing = 1.0 / (10.0 * fresnel + 4.0)
    objects = at + spacing * (0.5 + np.arange(int((LIT + 0.5 - at) / spacing)))
    phases = np.exp(-8j * np.pi * fresnel * np.outer(pupil.points, objects))
    # Across the edge, and along it.
    rays = [(pupil.plain(lit), pupil.plain()[MIDDLE]), (pupil.kicked(lit), pupil.kicked()[MIDDLE])]
    along = pupil.on_pixels(np.abs(waves) ** 2)[MIDDLE]
    truth, *found = np.zeros((3, 3 * PIXELS, PIXELS))
    for number in range(len(pupil.points) // 2, len(pupil.points), len(pupil.points) // ROWS):
        inside = pupil.disk()[number] > 0.0
        coherent = np.abs(waves[:, inside] @ phases[inside]) ** 2
        light = pupil.on_pixels(coherent.sum(axis=1)[:, None])[:, 0] * spacing * step * 4.0 * fresnel
        pair = [number, len(pupil.points) - 1 - number]
        truth += np.outer(light, along[:, pair].sum(axis=1))
        for picture, (across, white_light) in zip(found, rays, strict=True):
            picture += np.outer(across[:, inside].sum(axis=1), white_light[:, pair].sum(axis=1))
    return difference(found[0], truth), difference(found[1], truth)


@pytest.mark.parametrize("distance", range(len(kick_error.DISTANCES)))
def test_errors_of_white_pictures_are_those_of_fresnel_integrals(distance: int) -> None:
    for number, fresnel in enumerate(kick_error.FRESNEL_NUMBERS):
        wanted = kick_error.SQUARES_WITHOUT[distance][number], kick_error.SQUARES_WITH[distance][number]
        assert white(fresnel, kick_error.DISTANCES[distance]) == pytest.approx(wanted, abs=1e-4)


@pytest.mark.parametrize("distance", [0.7, 1.0, 1.2])
def test_the_series_is_the_sum_over_many_lenslets(distance: float) -> None:
    """Of the middle one of 9 lenslets: an array without end adds 2 / (π² 4F · 5) of light, tails of all others."""
    fresnel = 2.0
    pupil = Pupil(fresnel, distance)
    light = pupil.on_pixels(np.abs(pupil.waves()) ** 2)[MIDDLE]
    found, truth = light @ pupil.disk() @ light.T, wave_picture(fresnel, distance)
    assert difference(found / found.sum(), truth / truth.sum()) < 2.0 / (np.pi**2 * 4.0 * fresnel * 5.0)
    rays = picture(np.sinc(np.arange(-ORDERS, ORDERS + 1) * (1.0 - distance)).astype(np.complex128))
    assert difference(rays / rays.sum(), truth / truth.sum()) > 0.04


@pytest.mark.parametrize(
    "number", instances(range(len(kick_error.FRESNEL_NUMBERS)), long=range(3, len(kick_error.FRESNEL_NUMBERS)))
)
def test_errors_of_edges_are_those_of_fresnel_integrals(number: int) -> None:
    means = np.mean([edge(kick_error.FRESNEL_NUMBERS[number], at) for at in (0.0, 0.5)], axis=0)
    assert means == pytest.approx((kick_error.EDGE_WITHOUT[number], kick_error.EDGE_WITH[number]), abs=2e-4)


def test_waves_keep_power() -> None:
    """Wide micro-images of evenly lit lenslets: a lenslet's pixels hold the light that falls on it."""
    pupil = Pupil(2.0)
    light = pupil.on_pixels(np.abs(pupil.waves()) ** 2)[MIDDLE]
    assert light.sum() / len(pupil.points) == pytest.approx(1.0, abs=0.005)


def test_errors_between_and_beyond_the_tables() -> None:
    low, between, high = (kick_error.kick_error(number) or pytest.fail("in the table") for number in (2.0, 2.5, 4.0))
    assert low.edge_with > between.edge_with > high.edge_with
    assert low.white_without > between.white_without > high.white_without
    assert between.white_without == pytest.approx(white(2.5, 1.0)[0], rel=0.01)
    assert kick_error.kick_error(100.0) == kick_error.kick_error(16.0)
    assert kick_error.kick_error(0.3) is None
    assert kick_error.kick_error(2.0, 0.5) is None
    assert (kick_error.kick_error(2.0, 1.1, in_focus=False) or low).edge_with is None


def test_a_camera_has_the_errors_of_its_distance_or_none() -> None:
    """Pixels of a fifth of a pitch: a sensor 0.15 focal lengths too far still counts as in the focal plane."""
    scene = lf.load(asset_path("scenes/diffraction.toml")).changed(
        {"camera.sensor.pixel_mm": 0.0028, "camera.sensor.pixels": [120, 120]}
    )
    sharp = lf.first_order(scene)
    assert sharp.kick_error == pytest.approx(kick_error.kick_error(sharp.microlens_fresnel_number or 0.0))
    near = lf.solved(scene).camera.sensor.distance_mm or 0.0
    moved = lf.first_order(scene.changed({"camera.sensor.distance_mm": near + 0.15 * 0.056}))
    assert moved.kind == sharp.kind
    assert moved.kick_error == pytest.approx(kick_error.kick_error(moved.microlens_fresnel_number or 0.0, 1.15))
    hexagons = lf.first_order(scene.changed({"camera.mla.layout": "hexagonal"}))
    wanted = kick_error.kick_error(hexagons.microlens_fresnel_number or 0.0, layout="hexagonal")
    assert hexagons.kick_error[:2] == pytest.approx(wanted[:2])
    assert hexagons.kick_error[:2] != pytest.approx(sharp.kick_error[:2], rel=0.01)
    assert hexagons.kick_error[2:] == (None, None)
    for unlike_both in ({"clear_diameter_mm": 0.012}, {"cylinder_axis": "x"}):
        facts = lf.first_order(scene.changed({f"camera.mla.{key}": value for key, value in unlike_both.items()}))
        assert facts.kick_error is None
        assert any("no table of errors" in line for line in facts.lines())
