"""Bodies of glass that nest, touch and overlap: Snell and Fresnel by hand, the ball lens in water, nothing in nothing.

A packet goes from the medium it is in into the one beyond, without air between bodies that touch.
"""

import itertools
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy import stats
from scipy.spatial.transform import Rotation

import lfmesh as lf
from lfmesh.optics.fresnel import fresnel
from tests.cameras import camera_without_array
from tests.instances import instances
from tests.renders import unchecked

LEVEL = 1e-3
"""Chance that a statistical test fails though the law holds."""

GLASS, WATER = 1.52, 1.333
CENTRE = np.array([0.0, 0.0, -300.0])

CAMERA = camera_without_array()

Body = Callable[..., dict[str, Any]]


@pytest.fixture
def body(tmp_path: Path) -> Body:
    """Return what makes a target of glass from a mesh."""
    made: list[Path] = []

    def target(mesh: Any, index: float, at: Any = CENTRE, turned: Any = (0.0, 0.0, 0.0), **refractor: Any) -> Any:
        made.append(tmp_path / f"{len(made)}.stl")
        mesh.export(made[-1])
        own = {"file": str(made[-1]), "units": "mm", "index": index, "surface": "flat"} | refractor
        return {"refractor": own, "position_mm": [float(x) for x in at], "rotation_deg": [float(x) for x in turned]}

    return target


def world(*targets: dict[str, Any], **transport: Any) -> lf.World:
    return lf.build(lf.Scene(camera=CAMERA, targets=list(targets), transport=transport))


def slabs(body: Body, edges: list[tuple[float, float]], media: list[float], turned: Any, **keys: Any) -> list[Any]:
    """Return plates across the x axis through the centre, turned together about it; `keys`: a list a key."""
    turn = Rotation.from_euler("xyz", turned, degrees=True)
    return [
        body(
            trimesh.creation.box((high - low, 60.0, 60.0)), index,
            at=CENTRE + turn.apply([0.5 * (low + high), 0.0, 0.0]), turned=turned,
            **{key: values[k] for key, values in keys.items()},
        )
        for k, ((low, high), index) in enumerate(zip(edges, media, strict=True))
    ]  # fmt: skip


def by_hand(angle: np.ndarray, widths: list[float], media: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return how far aside rays come out of a pile of plates in air, and their power without reflections."""
    aside, power = np.zeros(len(angle)), np.ones(len(angle))
    before = 1.0
    for width, index in zip([*widths, 0.0], [*media, 1.0], strict=True):
        cosine = np.sqrt(1.0 - (np.sin(angle) / before) ** 2)
        power *= [fresnel(before, index, c)[1] for c in cosine]
        aside += width * np.tan(np.arcsin(np.sin(angle) / index))
        before = index
    return aside, power


TURNS = [(0.0, 0.0, 0.0), (31.0, -17.0, 53.0)]

PILES = {
    "shared faces": ([(-8.0, -5.0), (-5.0, 6.0), (6.0, 10.0)], {}),
    "water that reaches into the glass": ([(-8.0, -5.0), (-6.2, 7.5), (6.0, 10.0)], {"priority": [0, -1, 0]}),
    "glass that reaches into the water": ([(-8.0, -5.0), (-6.2, 7.5), (6.0, 10.0)], {"priority": [2, 1, 5]}),
    "water all through": ([(-8.0, -5.0), (-8.0, 10.0), (6.0, 10.0)], {}),
}
"""Glass, water, glass: in each the water is what lies between −5 and 6."""


@pytest.mark.parametrize("turned", TURNS)
@pytest.mark.parametrize("pile", PILES)
def test_water_between_glass_plates_bends_and_passes_light_as_by_hand(body: Body, pile: str, turned: Any) -> None:
    edges, keys = PILES[pile]
    made = world(*slabs(body, edges, [GLASS, WATER, GLASS], turned, **keys))
    draw = np.random.default_rng(2)
    count = 3000
    turn = Rotation.from_euler("xyz", turned, degrees=True)
    angle, round_ = draw.uniform(0.0, np.deg2rad(60.0), count), draw.uniform(0.0, 2.0 * np.pi, count)
    across = np.column_stack([np.zeros(count), np.cos(round_), np.sin(round_)])
    d = np.cos(angle)[:, None] * [1.0, 0.0, 0.0] + np.sin(angle)[:, None] * across
    met = np.column_stack([np.full(count, -8.0), draw.uniform(-3.0, 3.0, (count, 2))])
    paths = lf.trace(made, CENTRE + turn.apply(met - 20.0 * d), turn.apply(d), split="transmit")
    assert not any(paths.ledger.lost.values())
    assert (paths.status == lf.Status.ESCAPED).all()
    assert (paths.source == np.arange(count)).all()
    aside, power = by_hand(angle, [3.0, 11.0, 4.0], [GLASS, WATER, GLASS])
    out = turn.inv().apply(paths.position - CENTRE)
    # Mesh files are of float32: 1e-6 mm.
    assert np.abs(out - (met + [18.0, 0.0, 0.0] + aside[:, None] * across)).max() < 1e-5
    assert np.abs(turn.inv().apply(paths.direction) - d).max() < 1e-6
    np.testing.assert_allclose(paths.weight, power, rtol=1e-6)
    assert (paths.events == 4).all()


@pytest.mark.parametrize("height", [0.2, 1.0, 3.0])
def test_a_glass_ball_in_water_is_a_ball_lens_of_the_relative_index(body: Body, height: float) -> None:
    radius, relative = 5.0, GLASS / WATER
    ball = body(trimesh.creation.icosphere(4, radius), GLASS, surface="patch")
    made = world(body(trimesh.creation.box((120.0, 60.0, 60.0)), WATER), ball)
    phi = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False) + 0.1
    aside = height * np.column_stack([np.zeros(40), np.cos(phi), np.sin(phi)])
    d = np.tile([1.0, 0.0, 0.0], (40, 1))
    paths = lf.trace(made, CENTRE + aside - 80.0 * d, d, split="transmit", record=True)
    assert (paths.events == 4).all()
    i, r = np.arcsin(height / radius), np.arcsin(height / (relative * radius))
    truth = height / np.sin(2.0 * (i - r))
    for packet in range(40):
        # Start, water, into the ball, out of it, the far face.
        out, after = (paths.vertices(packet)[k].position - CENTRE for k in (3, 4))
        way = after - out
        height_out, fall = np.linalg.norm(out[1:]), -(out[1:] @ way[1:]) / np.linalg.norm(out[1:])
        crosses = out[0] + height_out * way[0] / fall
        # Curved facets of 0.5 mm: their normals are 1e-5 off.
        assert crosses == pytest.approx(truth, rel=5e-4)
    if height == 0.2:
        assert truth == pytest.approx(relative * radius / (2.0 * (relative - 1.0)), rel=1e-3)


SHINING = {
    "shape": {"kind": "plane", "width_mm": 60.0, "height_mm": 60.0},
    "position_mm": [0.0, 0.0, -160.0],
    "material": {"reflectance": 0.0, "radiance_w_m2_sr": 100.0},
}


def test_rays_that_start_beside_the_lens_start_in_air(body: Body) -> None:
    """Between its surfaces along the axis, but outside its rim."""
    traced = world(body(trimesh.creation.icosphere(3, 8.0), GLASS, at=(40.0, 0.0, -60.0)))
    beside, before = (lf.trace(traced, [42.0, 1.0, z], [0.0, 0.0, -1.0], split="transmit") for z in (1.5, -5.0))
    assert beside.status.tolist() == before.status.tolist() == [lf.Status.ESCAPED]
    np.testing.assert_allclose(beside.direction, before.direction, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(beside.weight, before.weight, rtol=1e-12)


def box(size: tuple[float, float, float]) -> Any:
    return trimesh.creation.box(size)


def picture(*targets: dict[str, Any], **transport: Any) -> lf.Image:
    settings = {"samples": 64, "replicates": 8, "threads": 1, "engine": "mesh"} | transport
    return unchecked(lf.Scene(camera=CAMERA, targets=[*targets, SHINING], transport=settings))


@pytest.mark.parametrize("split", ["both", "transmit"])
def test_a_body_of_the_index_round_it_is_not_there(body: Body, split: str) -> None:
    tank = body(box((40.0, 40.0, 30.0)), WATER, at=(1.0, 0.0, -130.0), turned=(3.0, 2.0, 0.0))
    ball = body(trimesh.creation.icosphere(3, 8.0), WATER, at=(-1.0, 1.0, -128.0), surface="patch")
    alone, both = picture(tank, split=split), picture(tank, ball, split=split)
    np.testing.assert_allclose(both.mean, alone.mean, rtol=1e-9)
    assert both.ledger.events == alone.ledger.events
    glass = {**ball, "refractor": {**ball["refractor"], "index": GLASS}}
    assert np.abs(picture(tank, glass, split=split).mean / alone.mean - 1.0).max() > 1e-2


@pytest.mark.parametrize("surface", ["flat", "smooth", "patch"])
@pytest.mark.parametrize("fineness", [1, 3])
def test_rays_that_graze_a_ball_of_the_index_round_it_go_on(surface: str, fineness: int, body: Body) -> None:
    """Those that cut off a thin slice of a coarse ball were led to the slice's other side, and lost: 3e-4 of them."""
    tank = body(box((40.0, 40.0, 40.0)), WATER)
    ball = body(trimesh.creation.icosphere(fineness, 8.0), WATER, surface=surface)
    draw = np.random.default_rng(fineness)
    count = 100_000
    around = draw.uniform(0.0, 2.0 * np.pi, count)
    height = draw.uniform(7.0, 8.0, count)
    starts = np.column_stack([height * np.cos(around), height * np.sin(around), np.full(count, 70.0)])
    way = Rotation.from_euler("xyz", [10.0, -7.0, 20.0], degrees=True)
    origins, ways = CENTRE + way.apply(starts), np.tile(way.apply([0.0, 0.0, -1.0]), (count, 1))
    without, through = (lf.trace(world(*each), origins, ways, split="transmit") for each in ([tank], [tank, ball]))
    assert (through.status == lf.Status.ESCAPED).all()
    np.testing.assert_allclose(through.direction, without.direction, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(through.weight, without.weight, rtol=1e-12)


def deep(body: Body) -> list[dict[str, Any]]:
    """Return a tank of water between plates of glass, with a ball three deep in it and one that cuts its wall."""
    at = (0.0, 0.0, -130.0)
    return [
        body(box((40.0, 40.0, 30.0)), WATER, at=at),
        body(box((40.0, 40.0, 3.0)), GLASS, at=(0.0, 0.0, -113.5)),
        body(box((40.0, 40.0, 3.0)), GLASS, at=(0.0, 0.0, -146.5)),
        body(trimesh.creation.icosphere(3, 9.0), 1.6, at=at, surface="patch"),
        body(trimesh.creation.icosphere(2, 5.0), 1.8, at=(1.0, 0.0, -131.0), surface="patch"),
        body(trimesh.creation.icosphere(2, 6.0), 1.7, at=(18.0, 3.0, -130.0), surface="smooth", priority=1),
    ]


@pytest.mark.parametrize("method", instances(["adjoint", "forward"], long=["forward"]))
def test_energy_closes_and_next_to_nothing_is_lost_in_nested_glass(body: Body, method: str) -> None:
    ledger = picture(*deep(body), method=method).ledger
    assert abs(ledger.imbalance) < 1e-12
    assert ledger.lost_share < 1e-7


def test_both_methods_see_the_same_through_nested_glass(body: Body) -> None:
    """A block in a block in water between plates of glass: air where they touch would take a tenth of the light."""
    pile = [
        *deep(body)[:3],
        body(box((20.0, 20.0, 20.0)), 1.6, at=(0.0, 0.0, -130.0), turned=(20.0, 10.0, 0.0)),
        body(box((9.0, 9.0, 9.0)), 1.8, at=(1.0, 0.0, -131.0), turned=(-10.0, 25.0, 0.0)),
    ]
    one_pixel = CAMERA | {"sensor": {"pixels": [1, 1], "pixel_mm": 9.0}}
    small = SHINING | {"shape": {"kind": "plane", "width_mm": 16.0, "height_mm": 16.0}}
    settings: dict[str, Any] = {"replicates": 32, "engine": "mesh"}
    adjoint, forward = (
        unchecked(lf.Scene(camera=one_pixel, targets=[*pile, small], transport=settings | own))
        for own in ({"samples": 8192}, {"samples": 262144, "method": "forward"})
    )
    for image in (adjoint, forward):
        assert abs(image.ledger.imbalance) < 1e-12
        assert image.ledger.lost_share < 1e-7
    (a, a_error), (f, f_error) = ((im.mean.item(), im.stderr.item()) for im in (adjoint, forward))
    z = (a - f) / np.hypot(a_error, f_error)
    assert 2.0 * stats.t.sf(abs(z), 31) > LEVEL
    assert np.hypot(a_error, f_error) / a < 0.04


def test_a_tank_with_an_opaque_target_in_it_shines_through_the_water(body: Body) -> None:
    """What shines in water is seen n² darker from the air, and by as much as the face reflects.

    The ball of glass beside the sight line changes nothing.
    """
    plane = {
        **SHINING,
        "position_mm": [0.0, 0.0, -130.0],
        "shape": {"kind": "plane", "width_mm": 80.0, "height_mm": 80.0},
    }
    settings = {"samples": 64, "replicates": 8, "threads": 1, "engine": "mesh", "split": "transmit"}
    tank = body(box((100.0, 100.0, 30.0)), WATER, at=(0.0, 0.0, -130.0))
    ball = body(trimesh.creation.icosphere(2, 4.0), GLASS, at=(40.0, 40.0, -124.0))
    dry = lf.render(lf.Scene(camera=CAMERA, targets=[plane], transport=settings))
    wet = lf.render(lf.Scene(camera=CAMERA, targets=[plane, tank, ball], transport=settings))
    ratio = wet.mean.sum() / dry.mean.sum()
    assert ratio == pytest.approx(4.0 / WATER / (1.0 + WATER) ** 2, rel=2e-3)


@pytest.mark.parametrize(("index", "low", "high"), [(1.0, -60.0, -45.0), (WATER, 12.0, 38.0), (GLASS, 2.0, 9.0)])
def test_rays_start_in_the_medium_that_is_there(index: float, low: float, high: float, body: Body) -> None:
    """A box of glass in a box of water: whatever they cross, parallel faces leave n sin θ as it is."""
    draw = np.random.default_rng(5)
    both = world(body(trimesh.creation.box((80.0, 80.0, 80.0)), WATER), body(trimesh.creation.box([20.0] * 3), GLASS))
    n = 200
    p = CENTRE + np.column_stack([draw.uniform(-2.0, 2.0, (n, 2)), draw.uniform(low, high, n)])
    p[:, 2] = 2.0 * CENTRE[2] - p[:, 2]
    angle, turn = draw.uniform(0.0, 0.1 if index == 1.0 else 0.6, n), draw.uniform(0.0, 2.0 * np.pi, n)
    d = np.column_stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), -np.cos(angle)])
    paths = lf.trace(both, p, d, split="transmit")
    np.testing.assert_allclose(np.hypot(*paths.direction[:, :2].T), index * np.sin(angle), rtol=1e-12)
    assert (paths.events == {1.0: 4, WATER: 1, GLASS: 2}[index]).all()


def test_a_ray_from_within_four_bodies_crosses_all_of_them(body: Body) -> None:
    nested = [body(trimesh.creation.box([size] * 3), 1.3 + 0.01 * size) for size in (40.0, 32.0, 24.0, 16.0)]
    paths = lf.trace(world(*nested), [CENTRE], [[0.0, 0.0, -1.0]], split="transmit")
    expected = np.prod([fresnel(a, b, 1.0)[1] for a, b in itertools.pairwise([1.46, 1.54, 1.62, 1.7, 1.0])])
    assert abs(paths.weight[0] / expected - 1.0) < 1e-12


@pytest.mark.parametrize("turned", [(0.0, 0.0, 0.0), (17.0, -40.0, 8.0)])
def test_rays_that_start_on_a_face_of_glass_meet_it(turned: Any, body: Body) -> None:
    """Water against glass, and a box that shares a face with the water: as from a billionth of a millimetre before."""
    turn = Rotation.from_euler("xyz", turned, degrees=True)
    both = world(
        body(trimesh.creation.box((80.0, 80.0, 40.0)), WATER, turned=turned),
        body(trimesh.creation.box((80.0, 80.0, 5.0)), GLASS, at=CENTRE + turn.apply([0.0, 0.0, -22.5]), turned=turned),
        body(trimesh.creation.box([20.0] * 3), 1.7, at=CENTRE + turn.apply([0.0, 0.0, 10.0]), turned=turned),
    )
    draw, n = np.random.default_rng(8), 400
    p = np.column_stack([draw.uniform(-30.0, 30.0, (n, 2)), draw.choice([20.0, 0.0, -20.0, -25.0], n)])
    p[p[:, 2] == 0.0, :2] *= 0.3
    d = np.column_stack([draw.uniform(-0.3, 0.3, (n, 2)), draw.choice([-1.0, 1.0], n)])
    p, d = CENTRE + turn.apply(p), turn.apply(d / np.linalg.norm(d, axis=1, keepdims=True))
    on_it, before = (lf.trace(both, start, d, split="transmit") for start in (p, p - 1e-9 * d))
    assert (on_it.events == before.events).all()
    assert (before.events > 0).all()
    np.testing.assert_allclose(on_it.weight, before.weight, rtol=1e-9)
    np.testing.assert_allclose(on_it.direction, before.direction, atol=1e-9)


def test_a_gap_that_is_too_narrow_to_be_there_is_named(body: Body) -> None:
    """Plates of 60 mm: 6e-4 mm and nearer are taken to touch, and a gap of 1e-4 mm is said; files' rounding is not."""
    plates = [(-10.0, 0.0), (1e-4, 10.0)]
    with pytest.warns(
        UserWarning, match=r"targets\[0\].* and targets\[1\].*0.0001 mm apart are taken to touch.*0.0006 mm"
    ):
        world(*slabs(body, plates, [GLASS, GLASS], (0.0, 0.0, 0.0)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        world(*slabs(body, [(-10.0, 0.0), (0.0, 10.0)], [GLASS, GLASS], (20.0, 30.0, 40.0)))
        world(*slabs(body, [(-10.0, 0.0), (1e-2, 10.0)], [GLASS, GLASS], (20.0, 30.0, 40.0)))


def test_a_box_that_shares_a_face_with_the_one_round_it_lies_inside_it(body: Body) -> None:
    """Whatever rounding makes of decimals."""
    draw = np.random.default_rng(0)
    for x, z in zip(draw.uniform(-10.0, 10.0, 12).round(1), draw.uniform(-305.0, -300.0, 12).round(1), strict=True):
        outer = body(trimesh.creation.box((80.0, 80.0, 40.0)), WATER, at=(x, 0.0, z))
        inner = body(trimesh.creation.box([20.0] * 3), 1.7, at=(x, 0.0, round(z + 10.0, 1)))
        assert world(outer, inner).tables.objects.rank.tolist() == [1, 2]
