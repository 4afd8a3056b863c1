"""Touching faces of a lens: in both engines rays cross them one after the other, by Snell's law.

The truth here knows the order of the faces alone. Each ray goes to the next of them, wherever that lies along it.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.geometry import frame
from tests.frames import motion
from tests.instances import instances

Array = NDArray[np.float64]

SEMI = 5.0
RAYS = 600
SENSOR_MM = 30.0
FRONT, BACK = 40.0, -60.0
INDEX = 1.5


def sphere(radius_mm: float, height: float) -> float:
    return float(height**2 / radius_mm / (1.0 + np.sqrt(1.0 - (height / radius_mm) ** 2)))


def faces(before: dict[str, Any], behind: dict[str, Any], gap_mm: float = 0.0) -> list[dict[str, Any]]:
    """Return the surfaces of two elements by the two that face each other."""
    return [
        {"radius_mm": FRONT, "thickness_mm": 4.0, "index": INDEX, "stop": True},
        before | {"thickness_mm": gap_mm},
        behind | {"thickness_mm": 4.0, "index": INDEX},
        {"radius_mm": BACK},
    ]


def r(radius_mm: float, **terms: Any) -> dict[str, Any]:
    return {"radius_mm": radius_mm, **terms}


PLANE = r(np.inf)
# z = −0.02 r² + r⁴ / 900, which is least at r = 3: −0.09.
WAVY = r(-25.0, conic=-1.0, asphere_mm=[1.0 / 900.0])
LENSES: dict[str, list[dict[str, Any]]] = {
    "spheres at their vertices": faces(r(-30.0), r(50.0)),
    "a plane and a sphere": faces(PLANE, r(50.0)),
    "a sphere and a plane": faces(r(-50.0), PLANE),
    "menisci, the first steeper": faces(r(-30.0), r(-50.0)),
    "menisci, the second steeper": faces(r(60.0), r(40.0)),
    "planes all over": faces(PLANE, PLANE),
    "spheres all over": faces(r(-30.0), r(-30.0)),
    "a plate between planes": [
        *faces(PLANE, PLANE)[:3],
        PLANE | {"thickness_mm": 0.0},
        PLANE | {"thickness_mm": 0.3, "index": 1.7},
        r(BACK),
    ],
    "spheres at their rims": faces(r(30.0), r(-40.0), sphere(30.0, SEMI) + sphere(40.0, SEMI)),
    "a plane and an asphere along a circle": faces(PLANE, WAVY, 0.09),
    "conics": faces(r(-30.0, conic=-1.0), r(50.0, conic=0.5)),
    "aspheres at their vertices": faces(r(-30.0, asphere_mm=[-1e-5]), r(50.0, asphere_mm=[1e-5])),
    "hollow aspheres, the second": faces(r(-30.0, asphere_mm=[-1e-6]), r(-50.0, asphere_mm=[1e-6])),
    "hollow aspheres, the first": faces(r(60.0, asphere_mm=[1e-7]), r(40.0, asphere_mm=[1e-6])),
    "a sphere in a hollow asphere": faces(r(-30.0), r(-50.0, asphere_mm=[1e-6])),
    "aspheres all over": faces(r(-30.0, asphere_mm=[-1e-5]), r(-30.0, asphere_mm=[-1e-5])),
    "a hollow asphere nearer than float32 tells": faces(r(-30.0), r(-50.0, asphere_mm=[1e-6]), 1e-7),
    "odd aspheres": faces(r(-30.0, odd_asphere_mm=[-1e-4]), r(50.0, odd_asphere_mm=[1e-4])),
}
SLOW = ["spheres all over", "aspheres all over", "conics", "hollow aspheres, the first", "odd aspheres"]


def scene_of(surfaces: list[dict[str, Any]], level: str = "exact", **lens: Any) -> lf.Scene:
    given = [{"semi_diameter_mm": SEMI} | each for each in surfaces]
    sensor = {"pixels": [4, 4], "pixel_mm": 100.0, "distance_mm": SENSOR_MM}
    return lf.Scene(
        camera={"lens": {"surfaces": given, **lens}, "sensor": sensor}, transport={"samples": 1, "surface": level}
    )


def sag_of(surface: dict[str, Any]) -> Callable[[Array], tuple[Array, Array]]:
    """Return a function of radii that gives sag and slope of a surface of revolution."""
    c, k = 1.0 / surface["radius_mm"], surface.get("conic", 0.0)
    powers = {2 * i + 4: a for i, a in enumerate(surface.get("asphere_mm", ()))}
    powers |= {2 * i + 3: a for i, a in enumerate(surface.get("odd_asphere_mm", ()))}

    def sag(height: Array) -> tuple[Array, Array]:
        root = np.sqrt(1.0 - (1.0 + k) * c * c * height**2)
        z = c * height**2 / (1.0 + root) + sum(a * height**n for n, a in powers.items())
        return z, c * height / root + sum(n * a * height ** (n - 1) for n, a in powers.items())

    return sag


def truth(surfaces: list[dict[str, Any]], p: Array, d: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Return rays behind all surfaces of a lens whose first vertex is at 0, their weights, and which pass for sure."""
    vertices = np.cumsum([0.0, *(s.get("thickness_mm", 0.0) for s in surfaces[:-1])])
    n = [1.0, *(s.get("index", 1.0) for s in surfaces)]
    order = range(len(surfaces)) if d[0, 2] > 0.0 else range(len(surfaces))[::-1]
    weight, passes = np.ones(len(p)), np.ones(len(p), bool)
    for k in order:
        n_i, n_t = (n[k], n[k + 1]) if d[0, 2] > 0.0 else (n[k + 1], n[k])
        sag, vertex = sag_of(surfaces[k]), np.array([0.0, 0.0, vertices[k]])
        p = p - vertex
        p = p - (p[:, 2] / d[:, 2])[:, None] * d
        with np.errstate(invalid="ignore"):
            for _ in range(30):
                height = np.hypot(p[:, 0], p[:, 1])
                z, slope = sag(height)
                away = np.divide(slope, height, out=np.zeros_like(height), where=height > 0.0)
                normal = np.column_stack([-away * p[:, 0], -away * p[:, 1], np.ones(len(p))])
                p = p - ((p[:, 2] - z) / np.sum(normal * d, axis=1))[:, None] * d
            passes &= np.hypot(p[:, 0], p[:, 1]) < 0.999 * SEMI
            normal *= np.sign(d[0, 2]) / np.linalg.norm(normal, axis=1, keepdims=True)
            cos_i = np.sum(normal * d, axis=1)
            cos_t = np.sqrt(1.0 - (n_i / n_t) ** 2 * (1.0 - cos_i**2))
            s = 2.0 * n_i * cos_i / (n_i * cos_i + n_t * cos_t)
            t = 2.0 * n_i * cos_i / (n_t * cos_i + n_i * cos_t)
            weight = weight * 0.5 * (s * s + t * t) * n_t * cos_t / (n_i * cos_i)
            d = n_i / n_t * d + (cos_t - n_i / n_t * cos_i)[:, None] * normal
            passes &= cos_t > 0.05
        p = p + vertex
    return p, d, weight, passes


def rays_at(vertex: float, start: float, seed: int) -> tuple[Array, Array]:
    """Return rays to a plane inside the lens: on the axis, next to it, and all over; half are parallel to the axis."""
    draw = np.random.default_rng(seed)
    near = RAYS // 4
    height = np.concatenate(
        [np.zeros(near), 10.0 ** draw.uniform(-9.0, -1.0, near), SEMI * np.sqrt(draw.random(RAYS - 2 * near))]
    )
    turn, turned = draw.uniform(0.0, 2.0 * np.pi, (2, RAYS))
    angle = draw.uniform(0.0, 0.25, RAYS) * draw.choice([0.0, 1.0], RAYS)
    d = np.column_stack([np.sin(angle) * np.cos(turned), np.sin(angle) * np.sin(turned), np.cos(angle)])
    d[:, 2] *= np.sign(vertex - start)
    p = np.column_stack([height * np.cos(turn), height * np.sin(turn), np.full(RAYS, vertex)])
    return p + ((start - vertex) / d[:, 2])[:, None] * d, d


def assert_engines_agree_with_truth(
    world: lf.World, surfaces: list[dict[str, Any]], pose: Array = frame.IDENTITY
) -> None:
    """Trace rays along and against the axis of a lens that stands in a pose, and compare where they go."""
    origin = [0.0, 0.0, world.tables.lens.surfaces["vertex_z"][0]]
    move = motion(world, "camera", "world")
    length = sum(s.get("thickness_mm", 0.0) for s in surfaces)
    for seed, start in enumerate((-10.0, length + 10.0)):
        rays = rays_at(surfaces[0]["thickness_mm"], start, seed)
        p, d, weight, passes = truth(surfaces, *rays)
        assert passes.mean() > 0.75
        end = frame.points(pose, p + origin), frame.directions(pose, d)
        sent = frame.points(pose, rays[0] + origin), frame.directions(pose, rays[1])
        there, goes = frame.points(move, end[0]), frame.directions(move, end[1])
        for engine in ("sequential", "mesh"):
            paths = lf.trace(
                world, frame.points(move, sent[0]), frame.directions(move, sent[1]), split="transmit", engine=engine,
                threads=1,
            )  # fmt: skip
            assert paths.ledger.lost_share == 0.0
            row = np.full(RAYS, -1)
            row[paths.source] = np.arange(len(paths))
            row = row[passes]
            kept = paths.events[row] == len(surfaces)
            assert kept.all(), (engine, start, {paths.body[i] for i in row[~kept]})
            # A ray's distance from the line that it should run along.
            off = paths.position[row] - there[passes]
            off -= np.sum(off * goes[passes], axis=1, keepdims=True) * goes[passes]
            assert np.abs(off).max() < 1e-11
            assert np.abs(paths.direction[row] - goes[passes]).max() < 1e-12
            np.testing.assert_allclose(paths.weight[row], weight[passes], rtol=1e-11)


@pytest.mark.parametrize("name", instances(LENSES, long=SLOW))
def test_rays_cross_touching_faces_in_their_order(name: str) -> None:
    assert_engines_agree_with_truth(lf.build(scene_of(LENSES[name]), aimed=False), LENSES[name])


@pytest.mark.parametrize("name", ["menisci, the first steeper", "a sphere in a hollow asphere", "planes all over"])
def test_rays_cross_touching_faces_of_tilted_elements_in_their_order(name: str) -> None:
    """All elements stand in one pose, so that they still touch."""
    given = {"tilt_deg": [2.0, -3.0, 20.0], "shift_mm": [0.1, 0.2, 0.0]}
    numbers = list(range(len(LENSES[name])))
    world = lf.build(scene_of(LENSES[name], elements=[{"surfaces": numbers, "pose": given}]), aimed=False)
    pose = world.tables.lens.surfaces["pose"][0]
    assert not np.array_equal(pose, frame.IDENTITY)
    assert_engines_agree_with_truth(world, LENSES[name], pose)


@pytest.mark.parametrize("level", ["flat", "smooth", "patch"])
@pytest.mark.parametrize("name", ["menisci, the first steeper", "planes all over"])
def test_no_level_of_facets_absorbs_rays_where_faces_touch(name: str, level: str) -> None:
    """Facets bend rays a little off, but all of them go through the faces."""
    world = lf.build(scene_of(LENSES[name], level), aimed=False)
    origin = [0.0, 0.0, world.tables.lens.surfaces["vertex_z"][0]]
    move = motion(world, "camera", "world")
    length = sum(s.get("thickness_mm", 0.0) for s in LENSES[name])
    for seed, start in enumerate((-10.0, length + 10.0)):
        p, d = rays_at(LENSES[name][0]["thickness_mm"], start, seed)
        passes = truth(LENSES[name], p, d)[3] & (np.hypot(p[:, 0], p[:, 1]) < 0.8 * SEMI)
        paths = lf.trace(
            world, frame.points(move, p + origin), frame.directions(move, d), split="transmit", engine="mesh", threads=1
        )
        assert paths.ledger.lost_share == 0.0
        through = np.zeros(RAYS, bool)
        through[paths.source[paths.events == len(LENSES[name])]] = True
        assert through[passes].all()


def test_a_ray_that_starts_on_a_vertex_of_a_lens_meets_it() -> None:
    surfaces = LENSES["menisci, the first steeper"]
    world = lf.build(scene_of(surfaces), aimed=False)
    move = motion(world, "camera", "world")
    vertices = world.tables.lens.surfaces["vertex_z"]
    starts = frame.points(move, np.column_stack([np.zeros(4), np.zeros(4), vertices]))
    ways = frame.directions(move, np.tile([0.0, 0.0, 1.0], (4, 1)))
    paths = lf.trace(world, starts, ways, split="transmit", threads=1)
    # The second and the third are one point.
    assert paths.status.tolist() == [lf.Status.SENSOR] * 4
    assert paths.events[np.argsort(paths.source)].tolist() == [4, 3, 3, 1]


@pytest.mark.parametrize(("number", "radius_mm"), [(0, 30.0), (1, -30.0), (2, 30.0), (3, -30.0)])
def test_a_stop_whose_plane_touches_a_vertex_cuts_the_same_rays_in_either_engine(number: int, radius_mm: float) -> None:
    """Before a bulging face or behind one, at the front of the lens, between its elements, and in their glass."""
    surfaces = [each | {"stop": False} for each in faces(r(-30.0), r(radius_mm if radius_mm < 0.0 else 50.0))]
    surfaces[0]["radius_mm"] = radius_mm
    # It stands on the vertex before it; at the front of the lens, on the one behind.
    stop: dict[str, Any] = {"stop": True, "semi_diameter_mm": 0.5 * SEMI, "thickness_mm": 0.0}
    if number > 0:
        before = surfaces[number - 1]
        stop |= {key: before[key] for key in ("thickness_mm", "index") if key in before}
        before["thickness_mm"] = 0.0
    surfaces.insert(number, stop)
    world = lf.build(scene_of(surfaces), aimed=False)
    move = motion(world, "camera", "world")
    vertex = world.tables.lens.surfaces["vertex_z"][0]
    height = np.linspace(0.0, 0.9 * SEMI, 40)
    for forward in (True, False):
        start = vertex - 10.0 if forward else vertex + 20.0
        p = np.column_stack([height, np.zeros(40), np.full(40, start)])
        d = np.tile([0.0, 0.0, 1.0 if forward else -1.0], (40, 1))
        ends = []
        for engine in ("sequential", "mesh"):
            paths = lf.trace(
                world, frame.points(move, p), frame.directions(move, d), split="transmit", engine=engine, threads=1
            )
            body = np.array(paths.body)[np.argsort(paths.source)]
            ends.append(body.tolist())
            assert body[0] != "stop"
        assert ends[0] == ends[1]
        assert "stop" in ends[0]
