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

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene.first_order import kick_error
from lfmesh.scene.literals import percent
from tests.instances import instances

Array = NDArray[np.float64]

PIXELS, INNER = 10, 3
"""Pixels a lenslet; nodes of a pixel."""
FILL, LIT = 0.9, 4
"""Width of micro-images; lenslets on each side of the middle one."""
ROWS = 90
"""Points across the pupil, times a whole number: as many to each pixel. Edges are summed over this many rows."""


class Pupil:
    """A camera of some Fresnel number whose sensor stands at a distance, over the focal length of the lenslets."""

    def __init__(self, fresnel: float, distance: float = 1.0, width: float = FILL, pixels: int = PIXELS) -> None:
        self.fresnel, self.distance, self.width = fresnel, distance, width
        # Waves of all points repeat beyond the lenslets that are lit; borders of pixels lie between points.
        count = ROWS * int(np.ceil(max(1.0, 0.4 * fresnel)))
        self.points = ((np.arange(count) + 0.5) / count - 0.5) * width
        self.side = 0.5 / pixels
        self.pixels = (np.arange(3 * pixels) + 0.5) / pixels - 1.5
        self.middle = slice(pixels, 2 * pixels)
        nodes, weights = leggauss(INNER)
        self.places = (self.pixels[:, None] + self.side * nodes).ravel()
        self.weights = np.tile(self.side * weights, len(self.pixels))

    def on_pixels(self, values: Array) -> Array:
        return np.add.reduceat(self.weights[:, None] * values, np.arange(0, len(self.weights), INNER), axis=0)

    def disk(self) -> Array:
        return np.asarray(np.hypot(self.points[:, None], self.points) < 0.5 * self.width, np.float64)

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
        """Return the same of rays that are not turned: out of focus a lenslet shows a point as a small square."""
        spread, light = max(abs(1.0 - self.distance), 1e-9), np.zeros((len(self.pixels), len(self.points)))
        low = self.pixels[:, None] - self.side - self.points
        for lenslet in range(-LIT, LIT + 1):
            ends = [np.clip((end - lenslet) / spread, -0.5, 0.5) for end in (low, low + 2.0 * self.side)]
            light += lit(lenslet) * (ends[1] - ends[0])
        return light

    def white(self, light: Array) -> Array:
        """Return the picture of all points behind the middle lenslet, whose light adds up to 1."""
        seen = light[self.middle]
        found = seen @ self.disk() @ seen.T
        return np.asarray(found / found.sum())


def difference(found: Array, wanted: Array) -> float:
    return float(np.abs(found - wanted).sum() / wanted.sum())


def edge(fresnel: float, at: float, width: float = FILL, pixels: int = PIXELS) -> tuple[float, float]:
    """Return the same of the picture of an edge that is in focus across the lenslets, `at` off a lenslet's middle."""
    pupil = Pupil(fresnel, 1.0, width, pixels)
    waves, step = pupil.waves(), pupil.points[1] - pupil.points[0]

    def lit(lenslet: int) -> float:
        return min(max(lenslet + 0.5 - at, 0.0), 1.0)

    spacing = 1.0 / (10.0 * fresnel + 4.0)
    objects = at + spacing * (0.5 + np.arange(int((LIT + 0.5 - at) / spacing)))
    phases = np.exp(-8j * np.pi * fresnel * np.outer(pupil.points, objects))
    # Across the edge, and along it.
    rays = [(pupil.plain(lit), pupil.plain()[pupil.middle]), (pupil.kicked(lit), pupil.kicked()[pupil.middle])]
    along = pupil.on_pixels(np.abs(waves) ** 2)[pupil.middle]
    truth, *found = np.zeros((3, 3 * pixels, pixels))
    for number in range(len(pupil.points) // 2, len(pupil.points), len(pupil.points) // ROWS):
        inside = pupil.disk()[number] > 0.0
        coherent = np.abs(waves[:, inside] @ phases[inside]) ** 2
        light = pupil.on_pixels(coherent.sum(axis=1)[:, None])[:, 0] * spacing * step * 4.0 * fresnel
        pair = [number, len(pupil.points) - 1 - number]
        truth += np.outer(light, along[:, pair].sum(axis=1))
        for picture, (across, white_light) in zip(found, rays, strict=True):
            picture += np.outer(across[:, inside].sum(axis=1), white_light[:, pair].sum(axis=1))
    return difference(found[0], truth), difference(found[1], truth)


@pytest.mark.parametrize(
    ("distance", "width", "pixels"),
    [(0.7, 0.9, 10), (1.0, 0.9, 10), (1.2, 0.9, 10), (1.0, 0.45, 8), (0.85, 0.6, 12), (1.0, 1.125, 8)],
)
def test_errors_of_white_pictures_are_those_of_fresnel_integrals(distance: float, width: float, pixels: int) -> None:
    """Of the middle one of 9 lenslets: an array without end adds 2 / (π² 4F · 5) of light, tails of all others.

    The sum over waves lacks them, and that over rays that are turned."""
    fresnel = 2.0
    pupil = Pupil(fresnel, distance, width, pixels)
    truth = pupil.white(pupil.on_pixels(np.abs(pupil.waves()) ** 2))
    without, with_kick = kick_error.white_errors(fresnel, distance, width, pixels)
    slack = 2.0 / (np.pi**2 * 4.0 * fresnel * 5.0)
    assert without == pytest.approx(difference(pupil.white(pupil.plain()), truth), abs=slack)
    assert without > 4.0 * slack
    if distance == 1.0:
        assert with_kick < 1e-12
        assert difference(pupil.white(pupil.kicked()), truth) < 2.0 * slack


def test_stopping_the_lens_down_makes_pictures_without_diffraction_worse() -> None:
    """The smaller a micro-image, the more of its light is at its edge."""
    scene = lf.load(asset_path("scenes/diffraction.toml"))
    wide, narrow = (
        lf.first_order(scene.changed({"camera.lens.stop_semi_diameter_mm": radius})).kick_error
        for radius in (4.77, 2.385)
    )
    assert narrow.white_without > 2.0 * wide.white_without
    assert narrow.true_faces
    assert narrow.white_with < 0.1 * narrow.white_without
    assert wide.edge_with is not None
    assert narrow.edge_with is None


@pytest.mark.parametrize(
    "number", instances(range(len(kick_error.FRESNEL_NUMBERS)), long=range(3, len(kick_error.FRESNEL_NUMBERS)))
)
def test_errors_of_edges_are_those_of_fresnel_integrals(number: int) -> None:
    means = np.mean([edge(kick_error.FRESNEL_NUMBERS[number], at) for at in (0.0, 0.5)], axis=0)
    assert means == pytest.approx((kick_error.EDGE_WITHOUT[number], kick_error.EDGE_WITH[number]), abs=2e-4)


def test_waves_keep_power() -> None:
    """Wide micro-images of evenly lit lenslets: a lenslet's pixels hold the light that falls on it."""
    pupil = Pupil(2.0)
    light = pupil.on_pixels(np.abs(pupil.waves()) ** 2)[pupil.middle]
    assert light.sum() / len(pupil.points) == pytest.approx(1.0, abs=0.005)


def test_errors_between_and_beyond_the_tables() -> None:
    low, between, high = (kick_error.kick_error(number) or pytest.fail("in the table") for number in (2.0, 2.5, 4.0))
    assert low.edge_with > between.edge_with > high.edge_with
    assert low.white_without > between.white_without > high.white_without
    assert between.white_without == kick_error.white_errors(2.5, 1.0, FILL, PIXELS)[0]
    assert (kick_error.kick_error(100.0) or low)[2:4] == (None, None)
    assert kick_error.kick_error(100.0, 1.2, layout="hexagonal") is None
    assert kick_error.kick_error(100.0, layout="hexagonal").white_without < 0.01
    assert (kick_error.kick_error(0.3) or low)[2:4] == (None, None)
    assert (kick_error.kick_error(2.0, width=0.7) or low)[2:4] == (None, None)
    finer = kick_error.kick_error(2.0, pixels=20) or pytest.fail("of squares")
    assert (finer.edge_without, finer.edge_with) == (None, low.edge_with)
    assert kick_error.kick_error(2.0, 0.5, layout="hexagonal") is None
    assert kick_error.kick_error(2.0, 1.2, width=0.7, layout="hexagonal") is None
    assert (kick_error.kick_error(2.0, 1.1, in_focus=False) or low).edge_with is None


def test_a_camera_has_the_errors_of_its_distance_or_none() -> None:
    """Pixels of a fifth of a pitch: a sensor 0.15 focal lengths too far still counts as in the focal plane."""
    # Two faces with lenslets, one of which hardly bends light: true faces are not computed.
    scene = lf.load(asset_path("scenes/diffraction.toml")).changed(
        {
            "camera.sensor.pixel_mm": 0.0028,
            "camera.sensor.pixels": [120, 120],
            "camera.mla.focal_length_mm": None,
            "camera.mla.radius_mm": 0.028,
            "camera.mla.back": {"radius_mm": 1e9},
        }
    )

    def wanted(facts: lf.FirstOrder, distance: float) -> tuple[float, float]:
        width = facts.micro_image_diameter_px / facts.micro_image_pitch_px
        return kick_error.white_errors(facts.microlens_fresnel_number, distance, width, 5)

    sharp = lf.first_order(scene)
    assert sharp.kick_error[:2] == pytest.approx(wanted(sharp, 1.0), abs=1e-9)
    near = lf.solved(scene).camera.sensor.distance_mm or 0.0
    moved = lf.first_order(scene.changed({"camera.sensor.distance_mm": near + 0.15 * 0.056}))
    assert moved.kind == sharp.kind
    assert moved.kick_error[:2] == pytest.approx(wanted(moved, 1.15), abs=1e-9)
    hexagons = lf.first_order(scene.changed({"camera.mla.layout": "hexagonal"}))
    width = hexagons.micro_image_diameter_px / hexagons.micro_image_pitch_px
    error = kick_error.hexagon_error(hexagons.microlens_fresnel_number, width, 5)
    assert hexagons.kick_error == pytest.approx((error, 0.0, None, None, False))
    for unlike_both in ({"clear_diameter_mm": 0.012}, {"cylinder_axis": "x"}):
        facts = lf.first_order(scene.changed({f"camera.mla.{key}": value for key, value in unlike_both.items()}))
        assert facts.kick_error is None
        assert any("no table of errors" in line for line in facts.lines())


def test_the_stated_error_is_that_of_the_true_faces_where_diffraction_counts() -> None:
    """`tests/validation/test_lenslet_faces.py` measures it."""
    scene = lf.load(asset_path("scenes/diffraction.toml"))
    facts = lf.first_order(scene)
    words = f"{percent(facts.kick_error.white_with)} behind the true faces"
    assert facts.kick_error.true_faces
    assert 0.004 < facts.kick_error.white_with < 0.006
    assert any(words in text for name, text in facts.rows() if name == "diffraction, lenslets")
    warned = lf.first_order(scene.changed({"transport.diffraction": "none"})).warnings
    assert any(words in str(each) for each in warned)
    turned = lf.first_order(scene.changed({"camera.mla.curved_side": "sensor"}))
    assert turned.kick_error.white_with > 2.0 * facts.kick_error.white_with


def test_without_blur_by_diffraction_true_faces_are_not_computed_and_it_is_said() -> None:
    facts = lf.first_order(lf.load(asset_path("scenes/first_light.toml")))
    assert facts.microlens_airy_disk_px is not None
    assert facts.microlens_airy_disk_px < 1.0
    assert not facts.kick_error.true_faces
    assert any("behind thin lenslets and more behind true faces" in text for _, text in facts.rows())
