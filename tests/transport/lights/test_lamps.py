"""Lights light a place as their packets do: what a point is told and what packets bring there are the same watts."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.kernels.decorators import kernel
from lfmesh.optics.scattering import tangents
from lfmesh.transport.lights.intensity import intensity
from lfmesh.transport.lights.lamps import illuminate
from lfmesh.transport.packets.random import derived, run_key, uniform
from lfmesh.transport.sources.lamp_rays import emitted
from lfmesh.transport.tables.tables import ObjectTables

Array = NDArray[np.float64]

LENS = {"surfaces": [{"radius_mm": 20.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 5.0},
                     {"radius_mm": -20.0, "thickness_mm": 1.0, "semi_diameter_mm": 5.0},
                     {"stop": True, "semi_diameter_mm": 4.0}]}  # fmt: skip
LIGHTS: dict[str, dict[str, Any]] = {
    "point": {"kind": "point", "position_mm": [30.0, 10.0, -40.0], "power_w": 3.0},
    "point among the targets": {"kind": "point", "position_mm": [1.0, 0.5, -57.0], "power_w": 3.0},
    "directional": {"kind": "directional", "direction": [-0.4, 0.3, -1.0], "irradiance_w_m2": 2.0},
    "disk": {"kind": "disk", "position_mm": [15.0, 5.0, -45.0], "direction": [-1.0, 0.0, -1.0],
             "radius_mm": 6.0, "power_w": 3.0},
    "disk whose back is turned to a part": {"kind": "disk", "position_mm": [1.5, 0.0, -57.0],
                                            "direction": [-1.0, 0.0, 0.0], "radius_mm": 1.0, "power_w": 3.0},
    "spot, wider than the targets": {"kind": "spot", "position_mm": [3.0, 5.0, -30.0], "power_w": 3.0,
                                     "direction": [0.1, 0.2, -1.0], "half_angle_deg": 35.0},
    "spot, wider than the targets, soft": {"kind": "spot", "position_mm": [3.0, 5.0, -30.0], "power_w": 3.0,
                                           "direction": [0.0, 0.1, -1.0], "half_angle_deg": 25.0, "edge_deg": 20.0},
    "spot, narrower than the targets": {"kind": "spot", "position_mm": [1.0, 0.0, -20.0], "power_w": 3.0,
                                        "direction": [0.0, 0.0, -1.0], "half_angle_deg": 5.0},
    "spot, narrower than the targets, soft": {"kind": "spot", "position_mm": [1.0, 0.0, -20.0], "power_w": 3.0,
                                              "direction": [0.0, 0.0, -1.0], "half_angle_deg": 5.5, "edge_deg": 3.0},
    "line": {"kind": "line", "start_mm": [15.0, 5.0, -45.0], "end_mm": [-5.0, 20.0, -40.0], "power_w": 3.0},
    "line through the plane that is lit": {"kind": "line", "start_mm": [1.0, 0.5, -50.0], "end_mm": [-1.5, -0.5, -68.0],
                                           "power_w": 3.0},
    "rectangle": {"kind": "rectangle", "position_mm": [15.0, 5.0, -45.0], "direction": [-1.0, 0.0, -1.0],
                  "width_mm": 20.0, "height_mm": 3.0, "turn_deg": 30.0, "power_w": 3.0},
    "rectangle whose back is turned to a part": {"kind": "rectangle", "position_mm": [1.5, 0.0, -57.0], "power_w": 3.0,
                                                 "direction": [-1.0, 0.0, -0.5], "width_mm": 4.0, "height_mm": 9.0},
    "rectangle with a profile": {"kind": "rectangle", "position_mm": [2.0, 1.0, -45.0], "direction": [-0.2, 0.0, -1.0],
                                 "width_mm": 6.0, "height_mm": 3.0, "power_w": 3.0, "profile": "quarter.ies"},
    "profile, wider than the targets": {"kind": "point", "position_mm": [5.0, 9.0, -35.0], "power_w": 3.0,
                                        "profile": "quarter.ies", "rotation_deg": [60.0, 0.0, -10.0]},
    "profile, narrower than the targets": {"kind": "spot", "position_mm": [0.5, -0.5, -52.0], "power_w": 3.0,
                                           "direction": [0.0, 0.0, -1.0], "profile": "narrow.ies", "turn_deg": 30.0},
}  # fmt: skip
HEAD = "IESNA:LM-63-2002\n[TEST] made for tests\nTILT=NONE\n"
IES = {
    "quarter.ies": HEAD + "1 1000 1 6 3 1 2 0 0 0\n1 1 40\n0 20 50 70 80 90\n0 30 90\n"
    "200 180 90 60 70 0\n200 170 70 80 10 0\n200 90 30 20 0 0\n",
    "narrow.ies": HEAD + "1 -1 1 5 4 1 1 0 0 0 1 1 1\n0 5 12 30 180\n0 90 200 360\n"
    "900 800 100 5 0\n900 500 60 0 0\n900 700 200 5 0\n900 800 100 5 0\n",
}
MIDDLE = np.array([0.0, 0.0, 60.0])
"""The origin of the world in the object frame, whose origin is the middle of the ball."""

SIDE = 3.0
"""Half the side of the square that is lit, mm, in the plane z = 0 of the object frame."""

COUNT = 100_000
LEVEL = 1e-3
"""Chance that this file fails though all is right, shared by its comparisons: four quarters of the square a light."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with profiles: one of two planes of symmetry, and a narrow one without."""
    folder = tmp_path_factory.mktemp("profiles")
    for name, text in IES.items():
        (folder / name).write_text(text)
    return folder


def tables_of(light: dict[str, Any], folder: Path) -> ObjectTables:
    """A sphere, so that packets are aimed at all that is round the square, and the camera far off."""
    ball = {"shape": {"kind": "sphere", "radius_mm": 5.0}, "position_mm": [0.0, 0.0, -60.0]}
    scene = lf.Scene(camera={"focus_mm": 60.0, "lens": LENS, "sensor": {"pixels": [4, 4], "pixel_mm": 0.1}},
                     targets=[ball], lights=[light])  # fmt: skip
    return lf.build(scene.in_folder(folder)).tables.objects


@kernel
def asked(objects: ObjectTables, places: Array, key: np.uint64, told: Array) -> None:
    """Write what points of the plane z = 0 are told: irradiance of its front, of its back, W/m²."""
    for i in range(len(places)):
        own = derived(key, i)
        u, v = uniform(own, 5), uniform(own, 6)
        place = places[i, 0], places[i, 1], 0.0
        _, _, uz, _, irradiance = illuminate(objects.lamps.profiles, objects.lamps.rows[0], place, u, v, False)
        told[i] = irradiance * abs(uz)


@kernel
def sent(objects: ObjectTables, key: np.uint64, rays: Array) -> None:
    """Write packets: start, direction, share of their power."""
    for i in range(len(rays)):
        rays[i] = emitted(objects, objects.lamps.rows[0], derived(key, i), None)


def quarters(x: Array, y: Array, power: Array) -> Array:
    """Return what falls on each quarter of the square, (4, n)."""
    inside = (np.abs(x) < SIDE) & (np.abs(y) < SIDE)
    return np.array([power * (inside & ((x > 0) == right) & ((y > 0) == up)) for right in (0, 1) for up in (0, 1)])


@pytest.mark.parametrize("name", LIGHTS)
def test_packets_bring_what_points_are_told(name: str, folder: Path) -> None:
    """Watts on the quarters of a square, by t-tests of two estimates."""
    objects = tables_of(LIGHTS[name], folder)
    places = np.random.default_rng(4).uniform(-SIDE, SIDE, (COUNT, 2))
    told, rays = np.empty(COUNT), np.empty((COUNT, 7))
    asked(objects, places, run_key(1), told)
    sent(objects, run_key(2), rays)
    by_points = quarters(*places.T, told * (2.0 * SIDE) ** 2 * 1e-6)
    light = objects.lamps.rows[0]
    watts = light["power"] * (np.pi * objects.lit_radius**2 * 1e-6 if not light["placed"] else 1.0)
    p, d, share = rays[:, :3], rays[:, 3:6], rays[:, 6]
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1.0, rtol=1e-14)
    t = -p[:, 2] / d[:, 2]
    by_packets = quarters(*(p[:, :2] + t[:, None] * d[:, :2]).T, watts * share * (t > 0.0))
    for one, other in zip(by_points, by_packets, strict=True):
        # Three standard errors see ten per cent.
        assert 3.0 * np.hypot(stats.sem(one), stats.sem(other)) < 0.1 * other.mean()
        assert stats.ttest_ind(one, other, equal_var=False).pvalue > LEVEL / (4 * len(LIGHTS))


@kernel
def shining(objects: ObjectTables, ways: Array, found: Array) -> None:
    """Write the intensity of the first light in directions (n, 3), W/sr."""
    for i in range(len(ways)):
        found[i] = intensity(objects.lamps.profiles, objects.lamps.rows[0], ways[i, 0], ways[i, 1], ways[i, 2])


def all_round(edges: Array, axis: Array) -> tuple[Array, Array]:
    """Return directions all round and their solid angles: Gauss-Legendre between angles from an axis, rad."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    middle, half = 0.5 * (edges[1:] + edges[:-1])[:, None], 0.5 * np.diff(edges)[:, None]
    theta, w = (middle + half * nodes).ravel(), (half * weights).ravel()
    phi = 2.0 * np.pi * (np.arange(720) + 0.5) / 720
    axis = axis / np.linalg.norm(axis)
    u, v = np.reshape(tangents(*axis), (2, 3))
    sine = np.sin(theta)[:, None, None]
    ways = sine * (np.cos(phi)[:, None] * u + np.sin(phi)[:, None] * v) + np.cos(theta)[:, None, None] * axis
    return ways.reshape(-1, 3), np.repeat(w * np.sin(theta) * 2.0 * np.pi / 720, 720)


@pytest.mark.parametrize("name", [name for name in LIGHTS if "spot" in name or "profile" in name])
def test_the_intensity_of_a_spot_or_profile_adds_up_to_its_power(name: str, folder: Path) -> None:
    light = LIGHTS[name]
    objects = tables_of(light, folder)
    down = objects.lamps.rows[0]["direction"]
    edges = {"quarter.ies": [0, 20, 50, 70, 80, 90], "narrow.ies": [0, 5, 12, 30, 180]}.get(light.get("profile", ""))
    if edges is None:
        outer = light["half_angle_deg"]
        edges = sorted({0.0, outer - light.get("edge_deg", 0.0), outer})
    ways, solid_angle = all_round(np.deg2rad(np.array(edges, dtype=np.float64)), down)
    found = np.empty(len(ways))
    shining(objects, ways, found)
    # The azimuths of the profile are linear between kinks, so that midpoints between them are exact but for these.
    assert (found * solid_angle).sum() == pytest.approx(3.0, rel=1e-4 if "profile" in name else 1e-12)


def test_a_sharp_spot_shines_evenly_into_its_cone(folder: Path) -> None:
    """Its intensity is P / (2π (1 − cos)) inside and nothing outside."""
    light = LIGHTS["spot, wider than the targets"]
    objects = tables_of(light, folder)
    axis = np.array(light["direction"])
    ways, _ = all_round(np.deg2rad([0.0, 34.999999, 35.000001, 180.0]), axis)
    found = np.empty(len(ways))
    shining(objects, ways, found)
    inside = ways @ axis / np.linalg.norm(axis) > np.cos(np.deg2rad(35.0))
    np.testing.assert_allclose(found[inside], 3.0 / (2.0 * np.pi * (1.0 - np.cos(np.deg2rad(35.0)))), rtol=1e-13)
    assert not found[~inside].any()


def test_a_profile_shines_as_its_file_says(folder: Path) -> None:
    """Ratios of intensities at angles of the file and half-way between them, about the axes that the scene says."""
    point = {"kind": "point", "position_mm": [0.0, 9.0, -35.0], "power_w": 3.0, "profile": "narrow.ies"}
    spot = LIGHTS["profile, narrower than the targets"]

    def at(theta_deg: float, phi_deg: float) -> list[float]:
        """Direction by the angles of the profile: nadir -y, 0 degrees +x, 90 degrees -z."""
        theta, phi = np.deg2rad(theta_deg), np.deg2rad(phi_deg)
        return [np.sin(theta) * np.cos(phi), -np.cos(theta), -np.sin(theta) * np.sin(phi)]

    ways = np.array([at(0, 0), at(5, 0), at(5, 90), at(12, 200), at(8.5, 145), at(21, 280), at(5, -1e-7)])
    expected = [900, 800, 500, 200, 0.25 * (500 + 60 + 700 + 200), 0.25 * (200 + 5 + 100 + 5), 800]
    found = np.empty(len(ways))
    shining(tables_of(point, folder), ways, found)
    np.testing.assert_allclose(found / found[0], np.array(expected) / 900.0, rtol=1e-8)
    # The spot: nadir along -z, seen from behind (+z) counter-clockwise from +x by 30 degrees.
    phi = np.deg2rad(30.0 + np.array([0.0, 90.0, 200.0]))
    sine, cosine = np.sin(np.deg2rad(12.0)), np.cos(np.deg2rad(12.0))
    ways = np.column_stack([sine * np.cos(phi), sine * np.sin(phi), np.full(3, -cosine)])
    found = np.empty(3)
    shining(tables_of(spot, folder), ways, found)
    np.testing.assert_allclose(found / found[0], [1.0, 0.6, 2.0], rtol=1e-10)


@kernel
def told_near(objects: ObjectTables, places: Array, numbers: Array, told: Array) -> None:
    """Write direction and irradiance that points of a medium are told, from random points of the first light."""
    for i in range(len(places)):
        place = places[i, 0], places[i, 1], places[i, 2]
        ux, uy, uz, _, irradiance = illuminate(
            objects.lamps.profiles, objects.lamps.rows[0], place, numbers[i, 0], numbers[i, 1], True
        )
        told[i] = ux, uy, uz, irradiance


def told(lamp: dict[str, Any], folder: Path, places: Array, seed: int = 8) -> tuple[Array, Array]:
    """Return directions and irradiances at places of the world, from a random point of the lamp each."""
    objects = tables_of(lamp, folder)
    found = np.empty((len(places), 4))
    told_near(objects, places + MIDDLE, np.random.default_rng(seed).random((len(places), 2)), found)
    return found[:, :3], found[:, 3]


def z_value(told: Array, expected: float) -> float:
    """Return by how many standard errors a mean is off, with rounding."""
    return abs(float(told.mean()) - expected) / (float(stats.sem(told)) + 1e-11 * abs(expected))


@pytest.mark.parametrize("height", [1e-9, 1e-3, 0.3, 1.9])
@pytest.mark.parametrize("aside", [0.0, 0.7, 1.0, 1.3])
def test_points_as_near_to_a_disk_as_may_be_are_told_its_solid_angle(height: float, aside: float, folder: Path) -> None:
    """Sixteen z-tests at a level of 0.001 together; no single draw brings more than four times what is stated."""
    radius, power = 3.0, 2.0
    lamp = {"kind": "disk", "position_mm": [0.0, 0.0, -60.0], "direction": [0.0, 0.0, 1.0], "radius_mm": radius,
            "power_w": power}  # fmt: skip
    _, found = told(lamp, folder, np.tile([aside * radius, 0.0, height * radius - 60.0], (40_000, 1)))
    # Solid angle of a disk over the height h: ∫ h / √(h² + ρ²) between its borders, over the turn about the foot.
    phi = 2.0 * np.pi * (np.arange(200_000) + 0.5) / 200_000
    root = 1.0 - (aside * np.sin(phi)) ** 2
    chord = np.sqrt(np.maximum(root, 0.0))
    ends = np.maximum([-aside * np.cos(phi) - chord, -aside * np.cos(phi) + chord], 0.0)
    sides = height / np.hypot(height, ends)
    omega = 2.0 * np.pi * np.where(root > 0.0, sides[0] - sides[1], 0.0).mean()
    expected = power / (np.pi * np.pi * radius**2) * 1e6 * omega
    assert found.max() <= 4.0 * power / (np.pi * radius**2) * 1e6 * (1.0 + 1e-6)
    assert abs(found.mean() - expected) < 4.0 * found.std() / np.sqrt(len(found)) + 1e-4 * expected


TUBE = {"kind": "line", "start_mm": [-4.0, 0.0, -60.0], "end_mm": [4.0, 0.0, -60.0], "power_w": 2.0}
PANEL = {"kind": "rectangle", "position_mm": [0.0, 0.0, -60.0], "direction": [0.0, 0.0, 1.0], "width_mm": 8.0,
         "height_mm": 3.0, "power_w": 2.0}  # fmt: skip
SCALES = [1e-9, 1e-4, 1.0, 1e4]
"""Sizes of lamps, from a picometre to 80 m."""


def scaled(lamp: dict[str, Any], k: float) -> dict[str, Any]:
    """Return a lamp in a ball's middle that is k times as large."""
    changes: dict[str, Any] = {key: k * lamp[key] for key in ("width_mm", "height_mm") if key in lamp}
    changes |= {key: [k * lamp[key][0], 0.0, -60.0] for key in ("start_mm", "end_mm") if key in lamp}
    return lamp | changes


NEAR_PLACES = np.array([[0.0, 0.1, 1e-8], [3.9, 0.0, 1e-4], [1.0, -2.0, 0.5], [9.0, 0.3, 2.0], [-60.0, 30.0, 4.0],
                        [4.5, 1e-6, 1e-7], [-3e4, 2e4, 5e4]])  # fmt: skip
"""Places round a lamp, in its units: beside it, over its ends, along its axis, and far away."""


@pytest.mark.parametrize("place", NEAR_PLACES.tolist())
def test_a_tube_gives_each_point_its_irradiance_in_closed_form(place: list[float], folder: Path) -> None:
    """∫ sin θ / r² along it is (sin β − sin α) / h, α and β the angles of its ends from the perpendicular of length h.

    Near it every draw brings just that.
    """
    at = np.array(place)
    h = np.hypot(at[1], at[2])
    sines = (4.0 - at[0]) / np.hypot(4.0 - at[0], h) + (4.0 + at[0]) / np.hypot(4.0 + at[0], h)
    if sines < 1e-6:
        # Both ends on one side, nearly in line: without the digits that cancel.
        sines = 0.5 * h**2 * abs(1.0 / (4.0 - at[0]) ** 2 - 1.0 / (4.0 + at[0]) ** 2)
    places = np.tile(at - MIDDLE, (5_000, 1))
    h = np.hypot(at[1], places[0, 2] + 60.0)
    expected = 2.0 / np.pi**2 / (8.0 * h) * 1e6 * sines
    _, found = told(TUBE, folder, places)
    if np.linalg.norm(at) < 64.0:
        np.testing.assert_allclose(found, expected, rtol=1e-5)
    assert z_value(found, expected) < 4.0 or abs(found.mean() / expected - 1.0) < 1e-5


def contour(corners: Array, normal: Array) -> float:
    """Return Lambert's contour integral: the irradiance over the radiance on a plane at the origin, all before it."""
    total = 0.0
    for one, other in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        cross = np.cross(one, other)
        length = np.linalg.norm(cross)
        total += float(np.arctan2(length, one @ other)) * float(cross @ normal) / float(length)
    return 0.5 * abs(total)


@pytest.mark.parametrize("place", [[0.0, 0.1, 1e-8], [3.9, 1.4, 1e-4], [1.0, -2.0, 0.5], [9.0, 0.3, 2.0],
                                   [-60.0, 30.0, 4.0], [1e3, 2e3, 5e3]])  # fmt: skip
@pytest.mark.parametrize("turned", [False, True])
def test_a_panel_gives_each_point_its_irradiance_by_lamberts_contour(
    place: list[float], turned: bool, folder: Path
) -> None:
    """On a plane parallel to the panel, twelve z-tests at a level of 0.001 together; no draw above 2π its radiance."""
    half = np.array([1.5, 4.0] if turned else [4.0, 1.5])
    at = np.array(place)
    places = np.tile(at - MIDDLE, (20_000, 1))
    at[2] = places[0, 2] + 60.0
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [*half, 0.0] - at
    radiance = 2.0 / (np.pi * 24.0) * 1e6
    expected = radiance * contour(corners, np.array([0.0, 0.0, 1.0]))
    ways, found = told(PANEL | {"turn_deg": 90.0 * turned}, folder, places)
    assert found.max() <= 2.0 * np.pi * radiance * (1.0 + 1e-9)
    assert z_value(found * np.abs(ways[:, 2]), expected) < 4.0
    assert told(PANEL, folder, places * [1, 1, -1] - 2.0 * MIDDLE)[1].max() == 0.0


def halves(lamp: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the two halves of the tube or the panel, side by side."""
    if lamp["kind"] == "line":
        middle = {"end_mm": [0.0, 0.0, -60.0]}, {"start_mm": [0.0, 0.0, -60.0]}
        return [lamp | {"power_w": 1.0} | part for part in middle]
    return [lamp | {"power_w": 1.0, "width_mm": 4.0, "position_mm": [x, 0.0, -60.0]} for x in (-2.0, 2.0)]


@pytest.mark.parametrize("lamp", [TUBE, PANEL], ids=lambda lamp: lamp["kind"])
def test_a_lamp_in_two_halves_gives_the_same_light(lamp: dict[str, Any], folder: Path) -> None:
    """Radiant vectors at random places, each component by a z-test; sixty at a level of 0.001 together."""
    random = np.random.default_rng(2)
    for place in random.normal(0.0, 4.0, (10, 3)):
        places = np.tile(np.abs(place) - MIDDLE, (20_000, 1))
        whole, *parts = (told(each, folder, places, seed) for seed, each in enumerate([lamp, *halves(lamp)]))
        one = whole[0] * whole[1][:, None]
        other = sum(ways * value[:, None] for ways, value in parts)
        sigma = np.sqrt(stats.sem(one) ** 2 + stats.sem(other) ** 2)
        scale = 1e-9 * np.abs(one).mean()
        assert (np.abs(one.mean(axis=0) - other.mean(axis=0)) < 4.2 * sigma + scale).all()


@pytest.mark.parametrize("lamp", [TUBE, PANEL], ids=lambda lamp: lamp["kind"])
@pytest.mark.parametrize("k", SCALES)
def test_irradiance_scales_with_the_lamp(lamp: dict[str, Any], k: float, folder: Path) -> None:
    """A lamp k times as large, seen from k times as far, gives 1 / k² of the light, whatever k."""
    at = np.array([1.0, 0.7, 2.0])
    one, other = (
        told(scaled(lamp, scale), folder, np.tile(scale * at - MIDDLE, (5_000, 1)))[1].mean() for scale in (1.0, k)
    )
    # The place has the digits of a coordinate of 60 mm.
    assert other * k * k == pytest.approx(one, rel=1e-9 + 1e-13 / k)
