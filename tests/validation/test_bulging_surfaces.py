"""The vertices of a mesh are on its surface: rays that pass between a bulge and its chords are not lost."""

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
RAYS = 20_000


def drawn_lens(draw: np.random.Generator) -> lf.Scene:
    """One to three thick elements of even aspheres as wide as up to 0.94 of their radii; the outer faces bulge.

    A hollow outer face is left out, as the sequential engine does not hold a ray against its rim.
    """
    faces = 2 * int(draw.integers(1, 4))
    surfaces: list[dict[str, Any]] = []
    for i in range(faces):
        hollow = 0 < i < faces - 1 and draw.random() < 0.3
        radius = (1.0 if (i % 2 == 0) != hollow else -1.0) * SEMI * draw.uniform(1.06, 3.0)
        term = draw.normal() * 2e-2 / SEMI**3 if draw.random() < 0.7 else np.copysign(1e-9, radius)
        surfaces.append({"radius_mm": radius, "semi_diameter_mm": SEMI, "asphere_mm": [term], "thickness_mm": 12.0})
        if i % 2 == 0:
            surfaces[-1]["index"] = draw.uniform(1.2, 1.9)
    surfaces[0]["stop"] = True
    del surfaces[-1]["thickness_mm"]
    sensor = {"pixels": [4, 4], "pixel_mm": 100.0, "distance_mm": 30.0}
    return lf.Scene(camera={"lens": {"surfaces": surfaces}, "sensor": sensor}, transport={"samples": 1})


def sequential_against_mesh(seed: int) -> None:
    """Compare rays towards a drawn lens, half of them nearly square to its axis, one by one."""
    draw = np.random.default_rng(seed)
    world = lf.build(drawn_lens(draw))
    points = np.column_stack([draw.uniform(-1.1 * SEMI, 1.1 * SEMI, (RAYS, 2)), draw.uniform(-3.0, 3.0, RAYS)])
    ways = draw.normal(size=(RAYS, 3))
    ways[:, 2] = np.abs(ways[:, 2]) * np.where(draw.random(RAYS) < 0.5, 0.2, 2.0)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    points[:, 2] += world.tables.lens.surfaces["vertex_z"][0]
    move = motion(world, "camera", "world")
    rays = frame.points(move, points - 40.0 * ways), frame.directions(move, ways)
    by_order, by_mesh = (lf.trace(world, *rays, split="transmit", engine=engine) for engine in ("sequential", "mesh"))
    assert by_mesh.ledger.lost_share == 0.0
    ends = []
    for paths in (by_order, by_mesh):
        on_sensor = np.flatnonzero(paths.status == lf.Status.SENSOR)
        on_sensor = on_sensor[np.argsort(paths.source[on_sensor])]
        ends.append((paths.source[on_sensor], paths.position[on_sensor], paths.weight[on_sensor]))
    (source, position, weight), (of_mesh, there, arrives) = ends
    # What total reflection has turned goes on in the mesh engine alone.
    turned = ~np.isin(of_mesh, by_order.source)
    np.testing.assert_array_equal(of_mesh[~turned], source)
    np.testing.assert_allclose(there[~turned], position, rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(arrives[~turned], weight, rtol=1e-7)


@pytest.mark.parametrize("seed", range(2))
def test_sequential_and_mesh_engine_agree_ray_by_ray_at_bulging_aspheres(seed: int) -> None:
    sequential_against_mesh(seed)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2, 42))
def test_sequential_and_mesh_engine_agree_at_forty_more(seed: int) -> None:
    sequential_against_mesh(seed)


def sphere(c: float, r2: Array) -> Array:
    return np.asarray(c * r2 / (1.0 + np.sqrt(1.0 - c * c * r2)))


def bulging(kind: str, draw: np.random.Generator) -> tuple[dict[str, Any], Any]:
    """Return a random surface that bulges everywhere, as keys of a scene and as its sag."""
    c, d = 1.0 / (SEMI * draw.uniform(1.1, 3.0, 2))
    if kind == "biconic":

        def sag(x: Array, y: Array) -> Array:
            return (d * x * x + c * y * y) / (1.0 + np.sqrt(1.0 - d * d * x * x - c * c * y * y))

        return {"radius_mm": 1.0 / c, "biconic": {"radius_x_mm": 1.0 / d, "conic_x": 0.0}}, sag
    if kind == "toroid":

        def sag(x: Array, y: Array) -> Array:
            return 1.0 / d - np.sqrt((1.0 / d - sphere(c, y * y)) ** 2 - x * x)

        return {"radius_mm": 1.0 / c, "toroid": {"radius_x_mm": 1.0 / d}}, sag
    power = {"even": 4, "odd": 3}[kind]
    term = draw.uniform(0.0, 0.1) / SEMI ** (power - 1)

    def sag(x: Array, y: Array) -> Array:
        return sphere(c, x * x + y * y) + term * np.hypot(x, y) ** power

    return {"radius_mm": 1.0 / c, {"even": "asphere_mm", "odd": "odd_asphere_mm"}[kind]: [term]}, sag


@pytest.mark.parametrize("kind", ["even", "odd", "biconic", "toroid"])
@pytest.mark.parametrize("seed", instances(range(2), long=[1]))
def test_rays_that_all_but_touch_a_bulge_meet_it_or_pass_it(kind: str, seed: int) -> None:
    """Rays near a tangent, within some micrometres, against the crossings of a dense scan of each ray."""
    draw = np.random.default_rng(seed)
    keys, sag = bulging(kind, draw)
    face = keys | {"semi_diameter_mm": SEMI, "thickness_mm": 9.0, "index": 1.5, "stop": True}
    lens = {"surfaces": [face, {"radius_mm": np.inf, "semi_diameter_mm": SEMI}]}
    sensor = {"pixels": [4, 4], "pixel_mm": 100.0, "distance_mm": 30.0}
    world = lf.build(lf.Scene(camera={"lens": lens, "sensor": sensor}, transport={"samples": 1}))
    count, step = 400, 1e-6
    r, phi = 0.95 * SEMI * np.sqrt(draw.random(count)), draw.uniform(0.0, 2.0 * np.pi, count)
    x, y = r * np.cos(phi), r * np.sin(phi)
    slopes = (sag(x + step, y) - sag(x - step, y), sag(x, y + step) - sag(x, y - step))
    normal = np.column_stack([-slopes[0], -slopes[1], np.full(count, 2.0 * step)])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    ways = np.cross(normal, draw.normal(size=(count, 3)))
    ways *= np.copysign(1.0, ways[:, 2:]) / np.linalg.norm(ways, axis=1, keepdims=True)
    points = np.column_stack([x, y, sag(x, y)]) + draw.normal(0.0, 3e-3, (count, 1)) * normal
    along = np.linspace(-2.0 * SEMI, 2.0 * SEMI, 8001)
    scan = points[:, None] + along[:, None] * ways[:, None]
    with np.errstate(invalid="ignore"):
        behind = scan[..., 2] - sag(scan[..., 0], scan[..., 1]) > 0.0
    inside = np.hypot(scan[..., 0], scan[..., 1])
    met = (behind & (inside < 0.99 * SEMI)).any(axis=1)
    beside = (behind & (inside >= 0.99 * SEMI)).any(axis=1)
    vertex = np.array([0.0, 0.0, world.tables.lens.surfaces["vertex_z"][0]])
    move = motion(world, "camera", "world")
    starts = frame.points(move, points + vertex - 30.0 * ways)
    paths = lf.trace(world, starts, frame.directions(move, ways), split="transmit", max_events=1)
    assert paths.ledger.lost_share == 0.0
    met_by_mesh = np.zeros(count, bool)
    met_by_mesh[paths.source[paths.events > 0]] = True
    assert met.sum() > count // 4
    assert not (met & ~met_by_mesh & ~beside).any()
    # Between two points of the scan hide dips of less than a ten-thousandth of a millimetre.
    assert (met_by_mesh & ~met & ~beside).sum() <= 2
