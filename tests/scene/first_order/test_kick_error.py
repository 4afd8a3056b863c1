"""The table of errors of pictures of extended light, against Fresnel integrals behind square lenslets.

Lengths along the sensor are in pitches. The pupil is at infinity and incoherent for white light: each of its points
sends a plane wave to all lenslets, whose waves add up on the sensor. At an edge each object point sends all plane waves
at once. x and y are independent but for the round pupil.
"""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from lfmesh.scene.first_order import kick_error

Array = NDArray[np.float64]

PIXELS, INNER = 10, 3
"""Pixels a lenslet; nodes of a pixel."""
FILL, LIT = 0.9, 4
"""Width of micro-images; lenslets on each side of the middle one."""
ROWS = 90
"""Points across the pupil, times a whole number: as many to each pixel. Edges are summed over this many rows."""
MIDDLE = slice(PIXELS, 2 * PIXELS)


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
        nodes, weights = leggauss(40) if self.distance != 1.0 else (np.zeros(1), np.full(1, 2.0))
        light = np.zeros((len(self.places), len(self.points)))
        for lenslet in range(-LIT, LIT + 1):
            for node, weight in zip(nodes, weights, strict=True):
                off = self.places[:, None] - lenslet - 0.5 * node * (1.0 - self.distance) - self.points
                light += lit(lenslet) * 0.5 * weight * 4.0 * self.fresnel * np.sinc(4.0 * self.fresnel * off) ** 2
        return self.on_pixels(light)

    def plain(self, lit: Callable[[int], float] = lambda _: 1.0) -> Array:
        """Return the same of rays that are not turned."""
        width, light = max(abs(1.0 - self.distance), 1e-9), np.zeros((len(self.pixels), len(self.points)))
        low = self.pixels[:, None] - 0.5 / PIXELS - self.points
        for lenslet in range(-LIT, LIT + 1):
            ends = [np.clip((end - lenslet) / width, -0.5, 0.5) for end in (low, low + 1.0 / PIXELS)]
            light += lit(lenslet) * (ends[1] - ends[0])
        return light


def difference(found: Array, wanted: Array) -> float:
    return float(np.abs(found - wanted).sum() / wanted.sum())


def white(fresnel: float, distance: float) -> tuple[float, float]:
    """Return the errors of white pictures without and with the kick."""
    pupil = Pupil(fresnel, distance)
    disk, waves = pupil.disk(), pupil.on_pixels(np.abs(pupil.waves()) ** 2)
    truth, plain, kicked = (each[MIDDLE] @ disk @ each[MIDDLE].T for each in (waves, pupil.plain(), pupil.kicked()))
    return difference(plain, truth), difference(kicked, truth)


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


LAST = len(kick_error.FRESNEL_NUMBERS) - 1
CHEAP = [(number, distance) for number in (0, 2) for distance in (1, 2, 4)]
ALL = [(number, distance) for number in range(LAST + 1) for distance in range(len(kick_error.DISTANCES))]


def entries(number: int, distance: int) -> None:
    fresnel = kick_error.FRESNEL_NUMBERS[number]
    wanted = kick_error.WHITE_WITHOUT[distance][number], kick_error.WHITE_WITH[distance][number]
    assert white(fresnel, kick_error.DISTANCES[distance]) == pytest.approx(wanted, abs=2e-4)
    if kick_error.DISTANCES[distance] == 1.0:
        means = np.mean([edge(fresnel, at) for at in (0.0, 0.5)], axis=0)
        wanted = kick_error.EDGE_WITHOUT[number], kick_error.EDGE_WITH[number]
        assert means == pytest.approx(wanted, abs=2e-4)


@pytest.mark.parametrize(("number", "distance"), CHEAP)
def test_errors_are_those_of_fresnel_integrals(number: int, distance: int) -> None:
    entries(number, distance)


@pytest.mark.long
@pytest.mark.parametrize(("number", "distance"), [each for each in ALL if each not in CHEAP])
def test_all_errors_are_those_of_fresnel_integrals(number: int, distance: int) -> None:
    entries(number, distance)


def test_waves_keep_power() -> None:
    """Wide micro-images of evenly lit lenslets: a lenslet's pixels hold the light that falls on it."""
    pupil = Pupil(2.0)
    light = pupil.on_pixels(np.abs(pupil.waves()) ** 2)[MIDDLE]
    assert light.sum() / len(pupil.points) == pytest.approx(1.0, abs=0.005)


def test_errors_between_and_beyond_the_tables() -> None:
    low, between, high = (kick_error.kick_error(number) or pytest.fail("in the table") for number in (2.0, 2.5, 4.0))
    assert low.white_with > between.white_with > high.white_with
    assert kick_error.kick_error(100.0) == kick_error.kick_error(16.0)
    assert kick_error.kick_error(0.3) is None
    assert kick_error.kick_error(2.0, 0.5) is None
    assert (kick_error.kick_error(2.0, 1.1) or low).edge_with is None
