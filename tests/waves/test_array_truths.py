"""Point spreads behind lenslets: against thin lenses, by integrals in closed form and by angular spectra.

Camera A of 14 µm lenslets of f = 25 µm is a hundred times wider here and 10,000 times longer: all Fresnel numbers are
the same, and angles and the relief of the lenslets (4 µm, whatever the size) are too small to count. So what differs
from thin lenses in one plane is an error of the point spread, or of the grid.
"""

import math
import warnings
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.special import fresnel, j1

import lfmesh as lf
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME
from lfmesh.waves.point_spread import TOLERANCE
from tests.instances import instances

Array = NDArray[np.float64]
Waves = NDArray[np.complex128]
Place = tuple[float, float]

WAVE_NM, WAVE = 550.0, 0.55e-3
PITCH, FOCAL, PIXEL = 1.4, 250.0, 0.14
STOP, IMAGE = 14.0, 5000.0
FAR = 1e7
SPREAD = IMAGE / (2.0 * STOP) * PITCH
"""Defocus that spreads the light over one more pitch."""
GLASS, THICK = 1.5, 0.01
COARSE = 0.02
"""Tolerance at which a point spread is quick; errors are a third of it or less."""


def camera(
    array_mm: float, gap_mm: float, count: int, mla: dict[str, Any] | None = None, sensor: dict[str, Any] | None = None
) -> lf.Scene:
    """An ideal lens that images the far point IMAGE behind it, and lenslets a reduced distance before the sensor."""
    lens = {"surfaces": [{"paraxial": True, "focal_length_mm": 1.0 / (1.0 / IMAGE + 1.0 / FAR), "stop": True,
                          "semi_diameter_mm": STOP}]}  # fmt: skip
    lenslets = {
        "count": [count, count], "pitch_mm": PITCH, "focal_length_mm": FOCAL, "index": GLASS, "conic": -1.0,
        "thickness_mm": THICK, "distance_mm": array_mm,
    }  # fmt: skip
    lenslets |= mla or {}
    pixels = {"pixels": [10 * count, 10 * count], "pixel_mm": PIXEL, "distance_mm": gap_mm - THICK / GLASS}
    given = {"lens": lens, "mla": {k: v for k, v in lenslets.items() if v is not None}, "sensor": pixels}
    given["sensor"] |= sensor or {}
    return lf.Scene.model_validate({"schema_version": 1, "camera": given})


def spread(scene: lf.Scene, place: Place, tolerance: float) -> lf.PointSpread:
    """Return the point spread of a point whose image is at a place."""
    return lf.point_spread(scene, (*(-x * FAR / IMAGE for x in place), -FAR), WAVE_NM, tolerance=tolerance)


def passed(found: lf.PointSpread, faces: int = 2) -> float:
    """Return the light that the faces do not reflect, (1 / 5)² each."""
    return found.entered_w * 0.96**faces


def shares(scene: lf.Scene, place: Place, tolerance: float) -> tuple[Array, float]:
    """Return what falls on each pixel, and in all, of the light that two faces do not reflect."""
    found = spread(scene, place, tolerance)
    return found.mean / passed(found), found.power_w / passed(found)


def on_pixels(nodes: int, count: int) -> tuple[Array, Callable[[Waves], Array]]:
    """Return Gauss's nodes in a row of pixels, and the way to sum light at these, rows and columns, by pixel."""
    inner, weights = np.polynomial.legendre.leggauss(nodes)
    middles = (np.arange(count) - 0.5 * (count - 1)) * PIXEL
    each = np.tile(0.5 * PIXEL * weights, count)

    def summed(field: Waves) -> Array:
        power = np.abs(field) ** 2 * np.outer(each, each)
        return np.asarray(power.reshape(count, nodes, count, nodes).sum(axis=(1, 3)))

    return (middles[:, None] + 0.5 * PIXEL * inner).ravel(), summed


def through_lenslet(u: Array, s: Array, array_mm: float, gap_mm: float, middle: float, apex: float, f: float) -> Waves:
    """Return light at s on the sensor from u in the pupil, in one dimension: Fresnel's integral over a lenslet."""
    u, s = u[None, :], s[:, None]
    bend = 1.0 / array_mm - 1.0 / f + 1.0 / gap_mm
    scale = math.sqrt(2.0 * abs(bend) / WAVE)
    still = (u / array_mm - apex / f + s / gap_mm) / bend
    (high_s, high_c), (low_s, low_c) = (fresnel(scale * (middle + a - still)) for a in (0.5 * PITCH, -0.5 * PITCH))
    path = u * u / array_mm - apex**2 / f + s * s / gap_mm - bend * still**2
    integral = high_c - low_c + 1j * math.copysign(1.0, bend) * (high_s - low_s)
    return np.asarray(integral / scale * np.exp(1j * np.pi / WAVE * path) / (WAVE * math.sqrt(array_mm * gap_mm)))


def through_lenslets(u: Array, s: Array, array_mm: float, gap_mm: float, count: int) -> Waves:
    """Return the same of a row of lenslets."""
    middles = (np.arange(count) - 0.5 * (count - 1)) * PITCH
    return np.asarray(sum(through_lenslet(u, s, array_mm, gap_mm, each, each, FOCAL) for each in middles))


def chebyshev_series(values: Waves, at: float) -> Waves:
    """Return series across the pupil of light (sensor, terms) at Chebyshev's points, of a point's image at a place."""
    terms = values.shape[1]
    values = values * np.exp(-1j * np.pi / (WAVE * IMAGE) * (pupil_points(terms) - at) ** 2)
    series = (dct(values.real) + 1j * dct(values.imag)) / terms
    series[:, 0] *= 0.5
    return np.asarray(series)


def pupil_points(terms: int, stop_mm: float = STOP) -> Array:
    return np.asarray(stop_mm * np.cos((np.arange(terms) + 0.5) / terms * np.pi))


def over_disk(terms: int) -> Array:
    """Return the integrals of Chebyshev's T_m(v) T_n(u) over the unit disk, (terms, terms)."""
    count = 2 * terms + 8
    angle = (np.arange(count) + 0.5) / count * np.pi
    n, end = np.arange(terms), np.pi / 2 - np.minimum(angle, np.pi - angle)
    below = np.where(n == 1, 1, n - 1)
    chord = np.cos(np.outer(end, n + 1)) / (n + 1) - np.cos(np.outer(end, n - 1)) / below
    chord[:, 1::2] = 0.0
    return np.asarray((np.cos(np.outer(angle, n)) * (np.sin(angle) * np.pi / count)[:, None]).T @ chord)


def square_truth(array_mm: float, gap_mm: float, place: Place, count: int, terms: int, nodes: int) -> Array:
    """Return the share of the pupil's light on each pixel behind square lenslets.

    The pupil is a disk, all else is separable: both factors become Chebyshev series across the pupil, which converge
    faster than any power of their terms.
    """
    sensor, summed = on_pixels(nodes, 10 * count)
    row = through_lenslets(pupil_points(terms), sensor, array_mm, gap_mm, count)
    x, y = (chebyshev_series(row, at) for at in place)
    return summed(y @ (over_disk(terms) * STOP**2) @ x.T) / (math.pi * STOP**2)


CENTRE, CORNER, ASIDE = (0.0, 0.0), (0.5 * PITCH, 0.5 * PITCH), (2.3 * PITCH, -1.25 * PITCH)
QUICK = [(0, CORNER), (3, CENTRE)]
SLOW = [(0, CENTRE), (0, ASIDE), (1, ASIDE), (-1, CORNER), (3, CORNER), (-3, CENTRE)]
"""Pitches more that the light spreads over, below 0 where the focus lies behind the lenslets; and its place."""


@pytest.mark.filterwarnings("error::lfmesh.errors.DiffractionWarning")
@pytest.mark.parametrize("case", instances(QUICK + SLOW, long=SLOW))
def test_spreads_behind_square_lenslets_are_fresnels(case: tuple[int, Place]) -> None:
    """On a coarse grid, with light where geometry has it, and nowhere else, and no more of it than entered."""
    (pitches, place), count = case, 9
    array = IMAGE + pitches * SPREAD
    found, power = shares(camera(array, FOCAL, count), place, COARSE)
    assert np.abs(found - square_truth(array, FOCAL, place, count, 360, 6)).sum() < 0.0075
    assert power == pytest.approx(1.0, abs=0.005)


@pytest.mark.long
@pytest.mark.parametrize("case", [(0, CENTRE), (0, CORNER), (3, CORNER), (-3, CENTRE), (10, CENTRE), (-10, CENTRE)])
def test_finer_grids_come_closer_to_fresnel(case: tuple[int, Place]) -> None:
    """With the tolerance that is not said, and up to ten pitches before and behind focus."""
    (pitches, place), count = case, 17
    array = IMAGE + pitches * SPREAD
    found, _ = shares(camera(array, FOCAL, count), place, TOLERANCE)
    truth = square_truth(array, FOCAL, place, count, 560, 14)
    assert np.abs(found - truth).sum() < 0.004


@pytest.mark.parametrize("pitches", instances([-3, 3], long=[3]))
def test_spreads_of_focused_cameras_are_fresnels(pitches: int) -> None:
    """Lenslets that image the point, 3 of their focal lengths before or behind them, sharply on the sensor.

    It is an image under each of several lenslets, whose light interferes between them.
    """
    place, count = (0.3 * PITCH, 0.0), 9
    array, gap = IMAGE + pitches * SPREAD, 1.0 / (1.0 / FOCAL - 1.0 / (pitches * SPREAD))
    found, power = shares(camera(array, gap, count), place, COARSE)
    truth = square_truth(array, gap, place, count, 360, 6)
    assert np.abs(found - truth).sum() < 0.0075
    assert power == pytest.approx(1.0, abs=0.005)
    # In the lenslets' focal plane the same light is another picture.
    assert np.abs(found - square_truth(array, FOCAL, place, count, 360, 6)).sum() > 0.5


SHIFTED, BRIGHTER = 0.9589, 1.0439
"""Brightest place of an evenly lit square at Fresnel number 3.5636, over its focal length, and the light there."""


@cache
def peak_of_one_lenslet(distance: float, tolerance: float) -> float:
    """Return the peak of a lone lenslet, lit evenly by a wide lens, at a distance over the focal length."""
    array, stop = 4250.0, 20.0
    # Light converges on the lenslet: behind both, its focus is at FOCAL.
    mla = {"focal_length_mm": 1.0 / (1.0 / FOCAL - 1.0 / (IMAGE - array))}
    given = camera(array, FOCAL * distance, 1, mla).changed({"camera.lens.stop_semi_diameter_mm": stop})
    return lf.point_spread(given, (0.0, 0.0, -FAR), WAVE_NM, tolerance=tolerance).peak_w_mm2


def evenly_lit(distance: Array) -> Array:
    """Return the light on the axis behind an evenly lit square at distances, over its focal length; 1 there."""
    out_of_focus = PITCH * np.sqrt(0.5 * (1.0 / distance - 1.0) / (WAVE * FOCAL)) + 1e-9
    s, c = fresnel(out_of_focus)
    return np.asarray(((c * c + s * s) / out_of_focus**2) ** 2 / distance**2)


def test_both_figures_of_the_focal_shift_are_those_of_an_evenly_lit_square() -> None:
    fresnel_number = PITCH**2 / (4.0 * WAVE * FOCAL)
    assert fresnel_number == pytest.approx(3.5636, abs=1e-4)
    distance = np.linspace(0.9, 1.0, 10_001)
    light = evenly_lit(distance)
    assert distance[light.argmax()] == pytest.approx(SHIFTED, abs=1e-4)
    assert light.max() == pytest.approx(BRIGHTER, abs=1e-4)
    assert light[-1] == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("distance", [0.92, SHIFTED])
def test_a_lone_lenslet_is_as_bright_before_its_focus_as_a_square(distance: float) -> None:
    """On the slope before the brightest place, where light tells that place, and in it."""
    found = peak_of_one_lenslet(distance, COARSE) / peak_of_one_lenslet(1.0, COARSE)
    assert found == pytest.approx(float(evenly_lit(np.array(distance))), abs=0.002)


@pytest.mark.long
def test_the_brightest_place_of_a_lone_lenslet_is_that_of_a_square() -> None:
    places = np.array([0.92, 0.95, 0.975, 1.0])
    curve = np.polynomial.Polynomial.fit(places, [peak_of_one_lenslet(z, TOLERANCE) for z in places], 3)
    fine = np.linspace(places[0], places[-1], 4001)
    assert fine[curve(fine).argmax()] == pytest.approx(SHIFTED, abs=0.001)
    assert curve(fine).max() / curve(1.0) == pytest.approx(BRIGHTER, abs=0.002)


FORM = {"decenter_mm": 0.1 * PITCH, "radius_error": 0.1, "seed": 3}
"""Lenslets of different radii, beside the middles of their cells: they meet in steps of up to some waves."""
LIT = 2.5
"""Pitches from the light's middle within which lenslets are lit in focus."""


def steps_truth(scene: lf.Scene, array_mm: float, place: Place, count: int, lit: float) -> Array:
    """Return the share of the pupil's light on each pixel behind square lenslets, each with a form of its own.

    Only those within some pitches of the place count.
    """
    terms, nodes = 300, 6
    world = lf.build(scene)
    shape = world.tables.mla.lenslets
    sense = np.sign(np.diag(world.tables.frames[CAMERA_FRAME, MLA_FRAME][:2, :2]))
    middles, apexes = (each.reshape(-1, 2) * sense for each in (shape.lattice.centres(), shape.apexes))
    focal = 1.0 / ((GLASS - 1.0) * abs(shape.curvature[0]) * shape.stretch)
    sensor, summed = on_pixels(nodes, 10 * count)
    u, disk = pupil_points(terms), over_disk(terms) * STOP**2
    light = np.zeros((sensor.size, sensor.size), np.complex128)
    for middle, apex, f in zip(middles, apexes, focal, strict=True):
        if math.dist(middle, place) < lit * PITCH:
            x, y = (
                chebyshev_series(through_lenslet(u, sensor, array_mm, FOCAL, middle[axis], apex[axis], f), place[axis])
                for axis in (0, 1)
            )
            light += y @ disk @ x.T
    return summed(light) / (math.pi * STOP**2)


STEPS: list[tuple[int, Place, float]] = [(0, CORNER, 0.04), (2, CENTRE, 0.0075)]
"""Pitches more that the light spreads over, its place, and the largest difference.

In focus on a corner steps send 0.02 of the light beyond the grid's directions.
"""


@pytest.mark.parametrize("case", instances(STEPS, long=STEPS[1:]))
def test_lenslets_that_meet_in_steps_are_fresnels(case: tuple[int, Place, float]) -> None:
    """But for the light that is known to be beyond the grid, about as much as the difference."""
    (pitches, place, most), count = case, 9
    array = IMAGE + pitches * SPREAD
    given = camera(array, FOCAL, count, {"form": FORM})
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", lf.DiffractionWarning)
        found = spread(given, place, COARSE)
    off = np.abs(found.mean / passed(found) - steps_truth(given, array, place, count, LIT + pitches)).sum()
    assert off < most
    assert 0.5 * off < found.beyond < 2.0 * off
    assert len(said) == (found.beyond > 0.005)
    assert all("steps and rims" in str(each.message) for each in said)


class Plane:
    """Grid of thin lenslets, over which light and phase are averaged cell by cell, so that borders may lie anywhere."""

    CELLS, PER_PIXEL, NODES = 640, 10, 3

    def __init__(self) -> None:
        self.step = PIXEL / self.PER_PIXEL
        self.x = (np.arange(self.CELLS) - 0.5 * (self.CELLS - 1)) * self.step
        self.waves = np.fft.fftfreq(self.CELLS, self.step)
        nodes, weights = np.polynomial.legendre.leggauss(self.NODES)
        self.nodes = list(zip(0.5 * self.step * nodes, 0.5 * weights, strict=True))

    def shifted(self, spectrum: Waves, a: float, b: float) -> Waves:
        """Return the light this far beside the middles of cells."""
        turn = np.exp(2j * np.pi * np.add.outer(b * self.waves, a * self.waves))
        return np.asarray(np.fft.ifft2(spectrum * turn))

    def behind(self, light: Callable[[float, float], Waves], path_mm: Callable[[Array, Array], Array]) -> Waves:
        """Return the spectrum of light, given beside the middles of cells, behind lenslets that lengthen its path."""
        found = np.zeros((self.CELLS, self.CELLS), np.complex128)
        for a, share_a in self.nodes:
            for b, share_b in self.nodes:
                path = path_mm(self.x[None, :] + a, self.x[:, None] + b)
                found += share_a * share_b * light(a, b) * np.exp(2j * np.pi / WAVE * path)
        # A wave's mean over a cell is less than the wave.
        mean = sum(share * np.cos(2.0 * np.pi * self.waves * a) for a, share in self.nodes)
        return np.asarray(np.fft.fft2(found) / np.outer(mean, mean))

    def travelled(self, spectrum: Waves, z_mm: float) -> Waves:
        return spectrum * np.exp(-1j * np.pi * WAVE * z_mm * np.add.outer(self.waves**2, self.waves**2))

    def pixels(self, spectrum: Waves, count: int) -> Array:
        """Return the power on a square of pixels in the middle."""
        sensor, summed = on_pixels(6, count)
        to = np.exp(2j * np.pi * np.outer(sensor - self.x[0], self.waves)) / self.CELLS
        return summed(to @ spectrum @ to.T)


def in_focus(plane: Plane, place: Place) -> Callable[[float, float], Waves]:
    """Return the light of power 1 about the pupil's image: Airy's amplitude, on a sphere about the pupil."""
    aperture = STOP / IMAGE

    def light(a: float, b: float) -> Waves:
        x, y = plane.x[None, :] + a, plane.x[:, None] + b
        v = 2.0 * np.pi * aperture / WAVE * np.hypot(x - place[0], y - place[1])
        disk = 2.0 * j1(v) / v * math.sqrt(math.pi) * aperture / WAVE
        return np.asarray(disk * np.exp(1j * np.pi / (WAVE * IMAGE) * (x * x + y * y)))

    return light


def to_nearest(offset: float, pitch: float, x: Array) -> Array:
    return np.asarray((x - offset) - pitch * np.round((x - offset) / pitch))


def squares(x: Array, y: Array) -> Array:
    """Return the square of the distance to the middle of a square cell."""
    return np.asarray(to_nearest(0.0, PITCH, x) ** 2 + to_nearest(0.0, PITCH, y) ** 2)


def hexagons(x: Array, y: Array) -> Array:
    """Return the same for hexagonal cells, of an array whose middle lies a quarter of a pitch beside a lenslet's."""
    row = math.sqrt(3.0) * PITCH
    odd = to_nearest(0.25 * PITCH, PITCH, x) ** 2 + to_nearest(0.5 * row, row, y) ** 2
    return np.asarray(np.minimum(to_nearest(-0.25 * PITCH, PITCH, x) ** 2 + to_nearest(0.0, row, y) ** 2, odd))


WITHIN = 40
"""Pixels on a side of the middle in which shares are compared."""


def difference(found: Array, truth: Array) -> float:
    beside = (len(found) - WITHIN) // 2
    return float(np.abs(found[beside:-beside, beside:-beside] - truth).sum())


def test_both_truths_are_one() -> None:
    plane = Plane()
    behind = plane.behind(in_focus(plane, CORNER), lambda x, y: -squares(x, y) / (2.0 * FOCAL))
    on_grid = plane.pixels(plane.travelled(behind, FOCAL), WITHIN)
    assert difference(square_truth(IMAGE, FOCAL, CORNER, 9, 300, 6), on_grid) < 0.002


def test_spreads_behind_hexagonal_lenslets_are_those_of_thin_ones() -> None:
    """At a corner of three of them."""
    place = (0.25 * PITCH, PITCH / (2.0 * math.sqrt(3.0)))
    found, _ = shares(camera(IMAGE, FOCAL, 9, {"layout": "hexagonal", "count": [11, 9]}), place, COARSE)
    plane = Plane()
    behind = plane.behind(in_focus(plane, place), lambda x, y: -hexagons(x, y) / (2.0 * FOCAL))
    assert difference(found, plane.pixels(plane.travelled(behind, FOCAL), WITHIN)) < 0.004


def test_a_cover_shortens_the_way_to_the_sensor() -> None:
    """By its thickness, and lengthens it by that over the index; out of the lenslets' focus."""
    cover, way = {"thickness_mm": 90.0, "gap_mm": 60.0, "index": 1.8}, FOCAL - 25.0
    apart = way + 90.0 - 90.0 / 1.8 - THICK / GLASS
    found, _ = shares(camera(IMAGE, FOCAL, 9, sensor={"cover": cover, "distance_mm": apart}), CENTRE, COARSE)
    bare = 0.96**2 * (1.0 - (0.8 / 2.8) ** 2) ** 2
    truth = square_truth(IMAGE, way, CENTRE, 9, 300, 6)
    assert np.abs(found * 0.96**2 / bare - truth).sum() < 0.0075


def test_lenslets_with_two_curved_faces_are_two_thin_ones_in_a_row() -> None:
    """A thick plate, with light from each face to the neighbours of the one behind it."""
    radius, thick, way = 250.0, 120.0, 220.0
    both = {"focal_length_mm": None, "radius_mm": radius, "thickness_mm": thick,
            "back": {"radius_mm": radius, "conic": -1.0}}  # fmt: skip
    found, _ = shares(camera(IMAGE, way, 9, both, {"distance_mm": way}), CORNER, COARSE)
    plane, face = Plane(), lambda x, y: -squares(x, y) * (GLASS - 1.0) / (2.0 * radius)
    inside = plane.travelled(plane.behind(in_focus(plane, CORNER), face), thick / GLASS)
    behind = plane.behind(lambda a, b: plane.shifted(inside, a, b), face)
    assert difference(found, plane.pixels(plane.travelled(behind, way), WITHIN)) < 0.003
