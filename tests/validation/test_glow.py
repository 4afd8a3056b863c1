"""Emitting media as light sources: what they send to targets and other media, against closed forms, and once only.

An optically thin ball sends what a point of its power in its middle would (its field is radial, and its flux is kept),
and so does one that absorbs, of what leaves it: 4π a² π ∫ 2 μ S (1 − exp(−2 κ a μ)) dμ for the radius a and the source
function S.
"""

from copy import copy
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import lfmesh as lf
from lfmesh.accuracy.hard.outcome import lens_scene, surfaces_of
from lfmesh.assets import asset_path
from lfmesh.transport.render.render import Renderer
from lfmesh.transport.tables.emitting_facets import no_emitters
from tests.cameras import camera_without_array
from tests.instances import instances
from tests.renders import unchecked

Array = NDArray[np.float64]

SURFACES = surfaces_of(((50.0, 4.0, 1.5168), (-50.0, 0.0, 1.0)), aperture=5e-6)
ONE_LINE = {"camera.sensor.pixels": (2, 2), "camera.sensor.pixel_mm": 1e-6, "transport.samples": 1024,
            "transport.replicates": 16, "transport.split": "transmit"}  # fmt: skip
PLATE_AT, REFLECTANCE, COSINE = -400.0, 0.5, 0.3


def plate(**material: float) -> dict[str, Any]:
    return {"shape": {"kind": "plane", "width_mm": 4e3, "height_mm": 4e3}, "position_mm": [0.0, 0.0, PLATE_AT],
            "material": material}  # fmt: skip


def by_chance(world: lf.World) -> lf.World:
    """Return a world in which scattered packets alone find what targets and media emit."""
    objects = world.tables.objects
    volumes = objects.volumes._replace(powers=0.0 * objects.volumes.powers)
    world = copy(world)
    world.tables = world.tables._replace(objects=objects._replace(volumes=volumes, emitters=no_emitters()))
    return world


@pytest.fixture(scope="module")
def of_one() -> float:
    """The power of a pixel that sees 1 W/(m² sr), W."""
    seen = lens_scene(SURFACES).changed({"targets": [plate(reflectance=0.0, radiance_w_m2_sr=1.0)], **ONE_LINE})
    return float(unchecked(seen).mean.mean())


@pytest.mark.parametrize("depth", [0.0, 2.0])
@pytest.mark.parametrize(("radius", "distance"), [(0.05, 1.0), (0.05, 1000.0), (0.5, 30.0), (5.0, 20.0), (5.0, 1000.0)])
def test_a_glowing_ball_lights_a_plate(radius: float, distance: float, depth: float, of_one: float) -> None:
    """From 0.1 to 10 mm wide and 1 to 1000 mm away: ten z-tests at 3.9 sigma, a level of 0.001; sigma below 2 %."""
    place = [distance * np.sqrt(1.0 - COSINE**2), 0.0, PLATE_AT + distance * COSINE]
    ball = {"bounds": {"kind": "sphere", "radius_mm": radius}, "position_mm": place, "emission_w_mm3_sr": 1e-3,
            "absorption_per_mm": 0.5 * depth / radius}  # fmt: skip
    image = unchecked(
        lens_scene(SURFACES).changed({"targets": [plate(reflectance=REFLECTANCE)], "media": [ball], **ONE_LINE})
    )
    power = 4.0 * np.pi * 1e-3 * 4.0 / 3.0 * np.pi * radius**3
    if depth > 0.0:
        shown = 0.5 - (1.0 - np.exp(-depth) * (1.0 + depth)) / depth**2
        power = 8.0 * np.pi**2 * radius**2 * 1e-3 * 2.0 * radius / depth * shown
    expected = REFLECTANCE / np.pi * 1e6 * power * COSINE / (4.0 * np.pi * distance**2) * of_one
    found, sigma = image.mean.mean(), np.sqrt((image.stderr**2).sum()) / image.mean.size
    assert sigma < 0.02 * expected
    assert abs(found - expected) < 3.9 * sigma, (found / expected, sigma / expected)


def solid_angle(corners: Array, points: Array) -> Array:
    """Return the solid angle of a rectangle as points see it, by two triangles (Van Oosterom & Strackee 1983), (n,)."""
    total = np.zeros(len(points))
    for triangle in (corners[[0, 1, 2]], corners[[0, 2, 3]]):
        a, b, c = (corner - points for corner in triangle)
        la, lb, lc = (np.linalg.norm(each, axis=1) for each in (a, b, c))
        across = np.abs((a * np.cross(b, c)).sum(axis=1))
        along = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
        total += 2.0 * np.arctan2(across, along)
    return total


def test_thin_fog_beside_a_glowing_sheet_is_its_integral_along_the_line() -> None:
    """Twelve random sheets of 1 to 60 mm beside the line, of both sides or one: the mean square of z as for t of 15.

    Fog that scatters evenly shows σ L Ω / 4π per length, of the solid angle Ω of the sheet; dark backs show nothing.
    """
    ks, near, far = 1e-6, 100.0, 300.0
    # Beside targets off the axis, a pupil of nanometres would lose a part of its rays.
    surfaces = surfaces_of(((50.0, 4.0, 1.5168), (-50.0, 0.0, 1.0)), aperture=5e-3)
    changes = ONE_LINE | {"camera.sensor.pixel_mm": 1e-3}
    wall = lens_scene(surfaces).changed({"targets": [plate(reflectance=0.0, radiance_w_m2_sr=1.0)], **changes})
    of_one = unchecked(wall).mean.mean()
    random = np.random.default_rng(12)
    fog = {"bounds": {"kind": "box", "size_mm": [1e3, 1e3, far - near]}, "position_mm": [0.0, 0.0, -200.0],
           "scattering_per_mm": ks}  # fmt: skip
    nodes, weights = np.polynomial.legendre.leggauss(400)
    t = 0.5 * (near + far) + 0.5 * (far - near) * nodes
    line = np.stack([0.0 * t, 0.0 * t, -t], axis=1)
    zs = []
    for number in range(12):
        half = 0.5 * 10.0 ** random.uniform(0.0, 1.8, 2)
        turn = Rotation.random(rng=random)
        place = np.array([1.05 * np.hypot(*half) + random.exponential(10.0), 0.0, random.uniform(-260.0, -140.0)])
        corners = place + turn.apply([[x * half[0], y * half[1], 0.0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
        material = {"reflectance": 0.0, "radiance_w_m2_sr": 2.0, "sides": ("both", "front")[number % 2]}
        sheet = {"shape": {"kind": "plane", "width_mm": 2.0 * half[0], "height_mm": 2.0 * half[1]},
                 "position_mm": place.tolist(), "rotation_deg": turn.as_euler("xyz", degrees=True).tolist(),
                 "material": material}  # fmt: skip
        scene = lens_scene(surfaces).changed({"targets": [sheet], "media": [fog], "transport.seed": number, **changes})
        image = unchecked(scene)
        seen = solid_angle(corners, line)
        if number % 2:
            seen = np.where((line - place) @ turn.apply([0.0, 0.0, 1.0]) > 0.0, seen, 0.0)
        expected = ks / (4.0 * np.pi) * 2.0 * 0.5 * (far - near) * (weights * seen).sum() * of_one
        if expected > 0.0:
            zs += ((image.mean - expected) / image.stderr).ravel().tolist()
        else:
            assert (image.mean == 0.0).all()
    z = np.array(zs)
    assert (z**2).mean() < 1.154 + 3.3 * np.sqrt(3.39 / len(z)), z


BALL = {"name": "glow", "bounds": {"kind": "sphere", "radius_mm": 2.0}, "position_mm": [12.0, 5.0, -130.0],
        "emission_w_mm3_sr": 1e-6, "absorption_per_mm": 0.05}  # fmt: skip
WALL = {"shape": {"kind": "plane", "width_mm": 100.0, "height_mm": 80.0}, "position_mm": [0.0, 0.0, -160.0],
        "material": {"reflectance": 0.6}}  # fmt: skip
WHITE = {"shape": {"kind": "sphere", "radius_mm": 8.0}, "position_mm": [-12.0, 0.0, -120.0],
         "material": {"reflectance": 0.8}}  # fmt: skip
HOT = {"shape": {"kind": "sphere", "radius_mm": 3.0}, "position_mm": [-14.0, 8.0, -135.0],
       "material": {"reflectance": 0.2, "radiance_w_m2_sr": 3.0}}  # fmt: skip
FOG = {"scattering_per_mm": 0.01, "absorption_per_mm": 0.002, "phase": {"kind": "henyey_greenstein", "g": 0.6},
       "bounds": {"kind": "box", "size_mm": [80.0, 80.0, 60.0]}, "position_mm": [0.0, 0.0, -130.0]}  # fmt: skip
TANK = {"size_mm": [80.0, 80.0, 60.0], "wall_mm": 3.0, "wall": {"index": 1.5}, "liquid": {"index": 1.33},
        "position_mm": [0.0, 0.0, -130.0]}  # fmt: skip
IN_WATER = WALL | {"shape": {"kind": "plane", "width_mm": 50.0, "height_mm": 50.0}, "position_mm": [0.0, 0.0, -145.0]}
SLAB = {"refractor": {"box_mm": [40.0, 40.0, 3.0], "index": 1.5}, "position_mm": [12.0, 5.0, -140.0]}

WAYS: dict[str, dict[str, Any]] = {
    "a flame and a hot ball in fog": {"media": [BALL, FOG], "targets": [WALL, WHITE, HOT]},
    "behind glass": {"media": [BALL], "targets": [WALL, SLAB, WHITE]},
    "in water": {"media": [BALL | {"inside": "tanks[0] liquid"}], "tanks": [TANK], "targets": [IN_WATER]},
    "in fog in water": {
        "media": [BALL | {"inside": "tanks[0] liquid"}, FOG | {"inside": "tanks[0] liquid"}],
        "tanks": [TANK], "targets": [IN_WATER, HOT | {"position_mm": [-14.0, 8.0, -135.0]}],
    },
}  # fmt: skip


@pytest.mark.parametrize("name", instances(WAYS, long=["in water"]))
def test_light_of_media_counts_once_by_whatever_way_it_is_found(name: str) -> None:
    """Against scattered packets alone: z-tests of the whole light at 3.5 sigma, a level of 0.002 for four scenes."""
    transport = {"samples": 192, "replicates": 16, "seed": 4}
    world = lf.build(lf.Scene(camera=camera_without_array(pixels=8), transport=transport, **WAYS[name]))  # type: ignore[arg-type]
    images = [Renderer(each).image() for each in (world, by_chance(world))]
    (a, sigma_a), (b, sigma_b) = ((im.mean.sum(), np.sqrt((im.stderr**2).sum())) for im in images)
    assert sigma_a < 1.1 * sigma_b
    assert abs(a - b) < 3.5 * np.hypot(sigma_a, sigma_b), (a, sigma_a, b, sigma_b)


def test_a_flame_lights_a_chart_beside_it_by_both_methods() -> None:
    """The flame of assets/volumes before a wall: whole light within 3.3 sigma, pixels' mean square below 2."""
    flame = {"grid": "../volumes/flame.npz", "position_mm": [25.0, -24.0, -130.0]}
    images = []
    for method, samples in (("adjoint", 64), ("forward", 512)):
        transport = {"replicates": 16, "seed": 7, "wavelengths_nm": [589.0], "method": method, "samples": samples}
        scene = lf.Scene(camera=camera_without_array(pixels=8), media=[flame], targets=[WALL], transport=transport)  # type: ignore[arg-type, list-item]
        images.append(unchecked(scene.in_folder(asset_path("scenes"))))
    adjoint, forward = images
    assert (np.median(adjoint.stderr / adjoint.mean)) < 0.1
    difference, variance = adjoint.mean - forward.mean, adjoint.stderr**2 + forward.stderr**2
    assert abs(difference.sum()) < 3.3 * np.sqrt(variance.sum())
    assert (difference**2 / variance).mean() < 2.0
