"""Light that a medium scatters near lamps: against quadrature about the lamp, and both methods against each other.

The packets that are sent past lamps are also left out, which scattered packets must make up for.
"""

from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.accuracy.hard.outcome import lens_scene, surfaces_of
from lfmesh.transport.tables import objects
from lfmesh.transport.tables.single_scatter import single_scatter_tables
from tests.cameras import camera_without_array
from tests.instances import instances
from tests.renders import unchecked

Array = NDArray[np.float64]

LAMP, BALL = np.array([45.0, 30.0, -110.0]), 30.0
"""Place of a lamp, mm, and radius of the ball of fog about it, which no line of sight crosses."""

POWER, DENSE = 4.0 * np.pi, 0.02
"""Of the lamp, W; scattering of the ball, 1/mm."""

ALBEDO = 0.9
CLOUD, THICK, THIN = 125.0, 2.0, 1e-6
"""Distance and radius of the cloud on the axis, mm, and its scattering, 1/mm, so little that it weakens nothing."""


def phase_of(g: float, cosine: Array) -> Array:
    return np.asarray((1.0 - g * g) / (4.0 * np.pi * (1.0 + g * g - 2.0 * g * cosine) ** 1.5))


def peaked(nodes: int, g: float) -> tuple[Array, Array]:
    """Return nodes and weights over cosines from -1 to 1, dense where g's phase function is large."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    near = (1.0 - abs(g)) ** 2 / 2.0
    # 1 − cosine = near (exp(s) − 1): even steps of the logarithm.
    top = np.log1p(2.0 / near)
    s = 0.5 * top * (x + 1.0)
    off, weights = near * np.expm1(s), 0.5 * top * w * near * np.exp(s)
    return (1.0 - off if g >= 0.0 else off - 1.0), weights


def once_scattered(v: Array, g: float) -> tuple[Array, Array]:
    """Return unit directions from a point to points of the ball, and what each sends there, W/mm² in all.

    Points about the lamp by their distance from it, by the angle at the lamp from the direction to the point, and by
    the azimuth: r² of the volume cancels the lamp's 1/r², so that nothing is large but the phase function. The fog of
    the ball weakens light on both ways.
    """
    to_v = v - LAMP
    far = np.linalg.norm(to_v)
    axis = to_v / far
    side = np.cross(axis, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    x, w = np.polynomial.legendre.leggauss(64)
    r, rw = 0.5 * BALL * (x + 1.0), 0.5 * BALL * w
    mu, mw = peaked(96, g)
    turn = 2.0 * np.pi * (np.arange(24) + 0.5) / 24.0
    r, mu, turn = (each.ravel() for each in np.meshgrid(r, mu, turn, indexing="ij"))
    weights = (rw[:, None, None] * mw[:, None] * np.full(24, 2.0 * np.pi / 24.0)).ravel()
    sine = np.sqrt(1.0 - mu**2)
    out = mu[:, None] * axis + sine[:, None] * (
        np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(axis, side)
    )
    points = LAMP + r[:, None] * out
    d = v - points
    reach = np.linalg.norm(d, axis=1)
    d /= reach[:, None]
    along = ((points - LAMP) * d).sum(axis=1)
    inside = -along + np.sqrt(along**2 + BALL**2 - r**2)
    light = DENSE * POWER / (4.0 * np.pi) * phase_of(g, (out * d).sum(axis=1)) / reach**2
    return -d, weights * light * np.exp(-DENSE * (r + inside))


def rendered(scene: dict[str, Any], depth: int) -> tuple[float, float]:
    """Return the radiance on the axis, W/(m² sr), by paths of so many events, and its standard error."""
    surfaces = surfaces_of(((50.0, 4.0, 1.5168), (-50.0, 0.0, 1.0)), aperture=5e-6)
    changes = {"camera.sensor.pixels": (2, 2), "camera.sensor.pixel_mm": 1e-6, "transport.samples": 16384,
               "transport.replicates": 16, "transport.split": "transmit", "transport.max_events": depth}  # fmt: skip
    even = {"shape": {"kind": "plane", "width_mm": 1e3, "height_mm": 1e3}, "position_mm": [0.0, 0.0, -400.0],
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}  # fmt: skip
    one = unchecked(lens_scene(surfaces).changed({**changes, "targets": [even]})).mean.sum()
    image = unchecked(lens_scene(surfaces).changed({**changes, **scene, "transport.seed": 4}))
    return float(image.mean.sum() / one), float(np.sqrt((image.stderr**2).sum()) / one)


def ball(g: float) -> dict[str, Any]:
    return {"bounds": {"kind": "sphere", "radius_mm": BALL}, "position_mm": LAMP.tolist(), "scattering_per_mm": DENSE,
            "phase": {"kind": "henyey_greenstein", "g": g}}  # fmt: skip


LIGHT = {"kind": "point", "position_mm": LAMP.tolist(), "power_w": POWER}

THREE_EVENTS = 4
"""Events up to which light is followed: two at the lens, a point in view, and one more that scatters."""


@pytest.mark.parametrize("g", instances([-0.9, 0.0, 0.8, 0.95], long=[0.8]))
def test_a_wall_is_lit_by_the_fog_round_a_lamp_as_quadrature_says(g: float) -> None:
    """A z-test at 3.3 sigma of direct light and what is scattered once, each weakened; four cases, 0.4 % together."""
    at = np.array([0.0, 0.0, -150.0])
    directions, light = once_scattered(at, g)
    scattered = float((light * np.maximum(directions[:, 2], 0.0)).sum())
    to_lamp = LAMP - at
    far = np.linalg.norm(to_lamp)
    direct = POWER / (4.0 * np.pi) * to_lamp[2] / far**3 * np.exp(-DENSE * BALL)
    expected = ALBEDO / np.pi * 1e6 * (direct + scattered)
    wall = {"shape": {"kind": "plane", "width_mm": 500.0, "height_mm": 500.0}, "position_mm": at.tolist(),
            "material": {"reflectance": ALBEDO}}  # fmt: skip
    found, sigma = rendered({"targets": [wall], "media": [ball(g)], "lights": [LIGHT]}, THREE_EVENTS)
    assert scattered > 0.1 * direct
    assert sigma < 0.006 * expected
    assert abs(found - expected) < 3.3 * sigma + 2e-4 * expected, (found, expected, sigma)


@pytest.mark.parametrize("g", instances([-0.9, 0.0, 0.8, 0.95], long=[0.8]))
def test_light_scattered_twice_is_its_integral_over_the_second_point_and_the_line_of_sight(g: float) -> None:
    """A thin cloud on the axis, lit by a lamp and the ball of fog round it: as above."""
    x, w = np.polynomial.legendre.leggauss(8)
    expected, twice = 0.0, 0.0
    for depth, step in zip(CLOUD + THICK * x, THICK * w, strict=True):
        at = np.array([0.0, 0.0, -depth])
        directions, light = once_scattered(at, g)
        second = float((light * phase_of(g, -directions[:, 2])).sum())
        to_lamp = LAMP - at
        far = np.linalg.norm(to_lamp)
        first = POWER / (4.0 * np.pi) / far**2 * np.exp(-DENSE * BALL) * float(phase_of(g, -to_lamp[2] / far))
        expected += 1e6 * THIN * step * (first + second)
        twice += 1e6 * THIN * step * second
    cloud = {"bounds": {"kind": "sphere", "radius_mm": THICK}, "position_mm": [0.0, 0.0, -CLOUD],
             "scattering_per_mm": THIN, "phase": {"kind": "henyey_greenstein", "g": g}}  # fmt: skip
    found, sigma = rendered({"targets": [], "media": [cloud, ball(g)], "lights": [LIGHT]}, THREE_EVENTS)
    assert twice > 0.1 * expected
    assert sigma < 0.006 * expected
    assert abs(found - expected) < 3.3 * sigma + 2e-4 * expected, (found, expected, sigma)


WALL = {"shape": {"kind": "plane", "width_mm": 120.0, "height_mm": 120.0}, "position_mm": [0.0, 0.0, -160.0],
        "material": {"reflectance": 0.6}}  # fmt: skip
BESIDE = {"shape": {"kind": "sphere", "radius_mm": 6.0}, "position_mm": [12.0, 8.0, -125.0],
          "material": {"reflectance": 0.9}}  # fmt: skip
GLASS = {"refractor": {"box_mm": [10.0, 10.0, 10.0], "index": 1.5}, "position_mm": [-14.0, 4.0, -125.0],
         "rotation_deg": [20.0, 30.0, 0.0]}  # fmt: skip


def lamp(kind: str, place: tuple[float, float, float], **more: Any) -> dict[str, Any]:
    return {"kind": kind, "position_mm": place, "power_w": 1.0, **more}


POINT = lamp("point", (20.0, 10.0, -120.0))
DISK = lamp("disk", (18.0, -12.0, -125.0), direction=[-0.6, 0.7, 0.2], radius_mm=5.0)
SPOT = lamp("spot", (-20.0, 10.0, -110.0), direction=[0.7, -0.2, -0.6], half_angle_deg=35.0)
WIDE = lamp("spot", (10.0, 20.0, -130.0), direction=[-0.2, -1.0, 0.3], half_angle_deg=120.0)
FAR = lamp("point", (150.0, -60.0, -90.0), power_w=8.0)
ROUND = {"bounds": {"kind": "sphere", "radius_mm": 45.0}, "position_mm": [0.0, 0.0, -130.0], "scattering_per_mm": 0.02}


def fog(g: float, **values: Any) -> dict[str, Any]:
    phase = {"kind": "henyey_greenstein", "g": g}
    return {"scattering_per_mm": 0.012, "absorption_per_mm": 0.004, "phase": phase, **values}


BOTH_WAYS: dict[str, dict[str, Any]] = {
    "a point lamp in fog that scatters backwards": {"media": [fog(-0.9)], "lights": [POINT]},
    "a point lamp in isotropic fog before a wall": {"media": [fog(0.0)], "lights": [POINT], "targets": [WALL]},
    "a point lamp in a ball of fog": {"media": [fog(0.8, **ROUND)], "lights": [POINT], "targets": [WALL]},
    "a lamp beside a ball of fog": {"media": [fog(0.8, **ROUND)], "lights": [FAR], "targets": [WALL]},
    "a point lamp in fog that scatters forwards": {"media": [fog(0.95)], "lights": [POINT], "targets": [WALL]},
    "a disk in fog": {"media": [fog(0.7)], "lights": [DISK], "targets": [WALL]},
    "a spot in fog": {"media": [fog(0.7)], "lights": [SPOT], "targets": [WALL]},
    "a spot of more than half a turn": {"media": [fog(0.6)], "lights": [WIDE], "targets": [WALL]},
    "many lamps and media": {
        "media": [fog(0.8), fog(-0.3, **ROUND)],
        "lights": [POINT, DISK, SPOT, WIDE, FAR],
        "targets": [WALL],
    },
    "a target beside the lamp": {"media": [fog(0.8)], "lights": [POINT], "targets": [WALL, BESIDE]},
    "glass beside the lamp": {"media": [fog(0.6, **ROUND)], "lights": [POINT], "targets": [WALL, GLASS]},
}


LONG = [
    "a point lamp in isotropic fog before a wall",
    "a point lamp in a ball of fog",
    "a lamp beside a ball of fog",
    "a disk in fog",
    "a spot in fog",
    "a spot of more than half a turn",
    "a target beside the lamp",
]
"""Every lamp, place of it and bounds of fog above is among the many; the suite has them, and the sharpest fog of both
senses, where a wrong share of packets past lamps counts most, and glass, which hides the lamp: that which scatters
forwards by what packets past lamps add, the others by both methods.
"""

FORWARD = {"a target beside the lamp": 8192, "a point lamp in fog that scatters forwards": 8192,
           "a spot of more than half a turn": 4096,
           "glass beside the lamp": 1024}  # fmt: skip
"""Samples of the forward method where 2048 leave an error of more than 5 %, or are more than it takes."""


def image_of(case: str, samples: int, **transport: Any) -> tuple[float, float]:
    """Return the whole light of an image and its standard error, W."""
    settings = {"samples": samples, "replicates": 16, "seed": 12} | transport
    image = unchecked(lf.Scene(camera=camera_without_array(pixels=8), transport=settings, **BOTH_WAYS[case]))  # type: ignore[arg-type]
    assert abs(image.ledger.imbalance) < 1e-11
    return float(image.mean.sum()), float(np.sqrt((image.stderr**2).sum()))


ADJOINT = {"many lamps and media": 128, "glass beside the lamp": 128}
"""Samples of the adjoint method where 512 leave a smaller error than those of the other images by far."""


@cache
def adjoint(case: str) -> tuple[float, float]:
    """Return the light of a case's adjoint image and its error, for both tests."""
    return image_of(case, ADJOINT.get(case, 512))


BY_BOTH_METHODS = [
    "a point lamp in fog that scatters backwards", "many lamps and media", "glass beside the lamp"
]  # fmt: skip


@pytest.mark.parametrize("case", instances(BOTH_WAYS, long=[*LONG, *BY_BOTH_METHODS]))
def test_packets_past_lamps_add_no_light_and_leave_none_out(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole light with them and by scattered packets alone: z-tests at 3.5 sigma, for eleven scenes 0.5 %."""
    (one, error), often = adjoint(case), single_scatter_tables

    def never(*given: Any) -> Any:
        tables = often(*given)
        assert len(tables.angles)
        return tables._replace(scattering=np.zeros_like(tables.scattering))

    monkeypatch.setattr(objects, "single_scatter_tables", never)
    other, its_error = image_of(case, 1024)
    assert max(error, its_error) < 0.05 * one
    assert its_error != error
    assert abs(one - other) < 3.5 * np.hypot(error, its_error), (one, error, other, its_error)


@pytest.mark.parametrize("case", instances(BOTH_WAYS, long=[*LONG, "a point lamp in fog that scatters forwards"]))
def test_forward_equals_adjoint_with_lamps_in_fog(case: str) -> None:
    """A z-test of the whole light at 3.5 sigma, for eleven scenes a level of 0.5 %."""
    (a, error), (f, its_error) = adjoint(case), image_of(case, FORWARD.get(case, 2048), method="forward", seed=11)
    assert max(error, its_error) < 0.1 * a
    assert abs(a - f) < 3.5 * np.hypot(error, its_error), (a, f, error, its_error)
