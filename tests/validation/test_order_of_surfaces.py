"""Surfaces of lens and array found by their order against those that Embree finds, packet by packet, image by image.

The meshes are the model. Rays come from both sides of lens or array, from within its field and from far outside it,
and every packet of their reflections that waits for a surface of the lens, or in a cell of the array, takes both ways.
"""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.errors import SceneError
from lfmesh.files.words import summary
from lfmesh.geometry import frame
from lfmesh.geometry.array.lenslets import Lenslets
from lfmesh.scene import load_lens
from lfmesh.transport.checks import order_check
from lfmesh.transport.checks.order_check import LARGEST_MM, OrderCheck, compare
from lfmesh.transport.engine import Workspace
from lfmesh.transport.packets.packet import BOTH, BY_ORDER_OR_MESH, LENS, MLA_FRAME, PLATE, WORLD_FRAME, Options
from lfmesh.transport.paths.automaton import ON_IMAGE_PATH, STRAY
from lfmesh.transport.render.parts import parts_of
from lfmesh.transport.render.render import Renderer
from lfmesh.transport.settings import options_of
from lfmesh.transport.sources.rays import RaySource
from lfmesh.transport.sources.source import Launcher
from tests.instances import instances

LENSES = sorted(path.stem for path in asset_path("lenses").glob("*.toml"))
OF_WEIGHTS = 1e-12
PER_ASSET, PER_DRAWN, PER_ARRAY = 50_000, 30_000, 20_000
"""Packets that are compared for each lens or array: a fault that one in 10,000 meets is seen."""
SENSOR = {"pixels": [400, 400], "pixel_mm": 0.1, "distance_mm": 30.0}
SPHERES = {
    "surfaces": [
        {"radius_mm": 30.0, "thickness_mm": 5.0, "index": 1.6, "semi_diameter_mm": 8.0},
        {"radius_mm": -40.0, "thickness_mm": 3.0, "semi_diameter_mm": 8.0},
        {"stop": True, "semi_diameter_mm": 5.0},
    ]
}


def world_of(lens: Any) -> lf.World:
    return lf.build(lf.Scene(camera={"lens": lens, "sensor": SENSOR}, targets=[]))


def drawn_lens(seed: int) -> dict[str, Any]:
    """Draw a lens of steep menisci, cemented elements and thin gaps, its stop on a surface, in glass or in air."""
    draw = np.random.default_rng(seed)
    semi = draw.uniform(3.0, 15.0)
    surfaces: list[dict[str, Any]] = []
    for _ in range(draw.integers(1, 5)):
        for _ in range(draw.integers(2, 4)):
            aperture = semi * draw.uniform(0.6, 1.1)
            radius = draw.choice([-1, 1]) * aperture * (1.0 + 10.0 ** draw.uniform(-1.5, 1.0))
            surfaces.append(
                {
                    "radius_mm": np.inf if draw.random() < 0.08 else radius,
                    "conic": draw.uniform(-3.0, 0.0) if draw.random() < 0.25 else 0.0,
                    "thickness_mm": aperture * 10.0 ** draw.uniform(-1.5, 0.4),
                    "semi_diameter_mm": aperture,
                    "index": draw.uniform(1.4, 2.0),
                }
            )
        del surfaces[-1]["index"]
    if draw.random() < 0.33:
        surfaces[draw.integers(0, len(surfaces))]["stop"] = True
    else:
        at = int(draw.integers(0, len(surfaces) + 1))
        opening = semi * draw.uniform(0.2, 0.8)
        stop = {"stop": True, "semi_diameter_mm": opening, "thickness_mm": semi * 10.0 ** draw.uniform(-1.5, 0.0)}
        if at > 0 and "index" in surfaces[at - 1]:
            stop["index"] = surfaces[at - 1]["index"]
        surfaces.insert(at, stop)
    surfaces[-1].pop("thickness_mm")
    return {"surfaces": surfaces}


def with_aspheres(lens: dict[str, Any], seed: int) -> dict[str, Any]:
    """Give about half of the surfaces terms up to r⁸, steep enough at some rims that a ray crosses them twice."""
    draw = np.random.default_rng((seed, 1))
    surfaces = []
    for s in lens["surfaces"]:
        a, changes = s["semi_diameter_mm"], {}
        if "radius_mm" in s and draw.random() < 0.6:
            slopes = draw.normal(size=3) * 10.0 ** draw.uniform(-2.0, -0.3)
            changes["asphere_mm"] = [
                float(slope) / (n * a ** (n - 1)) for slope, n in zip(slopes, (4, 6, 8), strict=True)
            ]
            changes["radius_mm"] = 2.0 * s["radius_mm"]
        surfaces.append(s | changes)
    return {"surfaces": surfaces}


def with_poses(lens: dict[str, Any], seed: int) -> dict[str, Any]:
    """Let each piece of glass, cemented groups as one, stand off its place with probability 0.7."""
    draw = np.random.default_rng((seed, 2))
    groups: list[list[int]] = [[]]
    for i, s in enumerate(lens["surfaces"]):
        groups[-1].append(i)
        if "index" not in s:
            groups.append([])
    size = max(s["semi_diameter_mm"] for s in lens["surfaces"])
    elements = []
    for group in groups:
        if len(group) > 1 and draw.random() < 0.7:
            shift, tilt = draw.normal(size=3) * [0.02, 0.02, 0.002] * size, draw.normal(size=3) * [1.0, 1.0, 30.0]
            elements.append({"surfaces": group, "pose": {"shift_mm": shift.tolist(), "tilt_deg": tilt.tolist()}})
    return lens | {"elements": elements}


def conics_as_prescribed(lens: dict[str, Any], seed: int) -> dict[str, Any]:
    """Leave the lens as it is drawn."""
    return lens


def drawn_worlds(count: int, changed: Any = conics_as_prescribed) -> list[lf.World]:
    """Build lenses by seed, without those whose rims would cross."""
    worlds: list[lf.World] = []
    seed = 0
    while len(worlds) < count:
        try:
            worlds.append(world_of(changed(drawn_lens(seed), seed)))
        except (SceneError, ValueError) as error:
            assert any(word in str(error) for word in ("rims", "thickness", "cross", "edge", "reach")), error  # noqa: PT017
        seed += 1
    return worlds


def rays_from_both_sides(world: lf.World, count: int, seed: int) -> RaySource:
    """Draw rays from points up to four semi-diameters beside the axis to points of all apertures."""
    draw = np.random.default_rng(seed)
    lens = world.tables.lens
    behind = draw.random(count) < 0.5
    start = draw.uniform(-4.0, 4.0, (count, 3)) * lens.box_high[0] * draw.random((count, 1))
    before = lens.box_low[2] - draw.uniform(0.1, 600.0, count)
    start[:, 2] = np.where(behind, lens.box_high[2] + draw.uniform(0.1, 60.0, count), before)
    k = draw.integers(0, len(lens.surfaces), count)
    r, turn = lens.surfaces["semi_diameter"][k] * np.sqrt(draw.random(count)), draw.uniform(0.0, 2.0 * np.pi, count)
    d = np.column_stack([r * np.cos(turn), r * np.sin(turn), lens.surfaces["vertex_z"][k]]) - start
    for _ in range(2):
        d /= np.linalg.norm(d, axis=1, keepdims=True)
    space = np.where(behind, len(lens.surfaces), 0)
    return RaySource(start, d, np.full(count, LENS), space, np.ones(count), np.uint64(seed))


def waiting_packets(
    world: lf.World, count: int, seed: int, source: RaySource | None = None
) -> tuple[NDArray[np.void], Options]:
    """Return packets that wait for a surface of lens or array, of the first rays whose packets are as many."""
    options = options_of(world, tracing=True, faces=BY_ORDER_OR_MESH, split=BOTH, cutoff=0.02)
    source = source or rays_from_both_sides(world, 2 * count // (3 * len(world.tables.lens.surfaces)), seed)
    work = next(Launcher(lambda: Workspace(world, options)).launches(source))
    work.sampled = []
    work.run()
    packets = np.concatenate(work.sampled)
    packets["path"] = np.where(packets["events"] > 0, STRAY, ON_IMAGE_PATH)
    some = np.random.default_rng(seed).permutation(len(packets))[:count]
    return packets[some], options


def hollow_again(world: lf.World, packets: NDArray[np.void]) -> NDArray[np.bool_]:
    """Tell which packets, on straight lines, come back to the surface that they have just left, on its hollow side."""
    again = np.zeros(len(packets), np.bool_)
    p, d = (np.stack([packets[axis] for axis in axes], axis=1) for axes in (("x", "y", "z"), ("dx", "dy", "dz")))
    for k, surface in enumerate(world.tables.lens.surfaces):
        c, q = surface["curvature"], 1.0 + surface["conic"]
        squash = np.array([1.0, 1.0, q])
        start = p - [0.0, 0.0, surface["vertex_z"]]
        sense = np.where(packets["space"] == k, 1.0, -1.0)
        # The chord from a point of the conic to its other point on the line.
        with np.errstate(divide="ignore", invalid="ignore"):
            chord = -2.0 * (c * np.sum(squash * start * d, axis=1) - d[:, 2]) / (c * np.sum(squash * d * d, axis=1))
            end = start + chord[:, None] * d
            inside = (np.hypot(end[:, 0], end[:, 1]) <= surface["semi_diameter"]) & (c * q * end[:, 2] < 1.0)
        again |= (packets["last"] == k) & (sense * c < 0.0) & (chord > 0.0) & inside
    return again


def compared(world: lf.World, count: int, seed: int) -> OrderCheck:
    packets, options = waiting_packets(world, count, seed)
    return compare(world, options, world.tables, packets)


def assert_agrees(check: OrderCheck) -> None:
    assert check.holds, check
    assert check.deviation_mm <= LARGEST_MM
    assert check.deviation <= OF_WEIGHTS, check


@pytest.mark.parametrize("name", LENSES)
def test_every_packet_in_a_known_lens_meets_the_surface_that_embree_finds(name: str) -> None:
    world = world_of(load_lens(asset_path(f"lenses/{name}.toml")))
    check = compared(world, PER_ASSET, seed=1)
    assert_agrees(check)
    # In gradient-index glass there is no mesh to compare with.
    curved = any(surface.gradient is not None for surface in world.scene.camera.lens.surfaces)
    assert check.compared > (0.25 if curved else 0.8) * PER_ASSET
    assert check.reflected > (0.1 if curved else 0.3) * PER_ASSET


@pytest.mark.parametrize("first", [0, 4, 8])
def test_every_packet_in_a_drawn_lens_meets_the_surface_that_embree_finds(first: int) -> None:
    for number, world in enumerate(drawn_worlds(first + 4)[first:], first):
        check = compared(world, PER_DRAWN, seed=number)
        assert_agrees(check)
        assert check.reflected > 0.1 * PER_DRAWN


def test_every_packet_between_touching_faces_meets_the_surface_that_embree_finds() -> None:
    """Planes, a plane and a sphere, and menisci, with reflections to and fro in gaps that close somewhere."""
    element = {"index": 1.6, "semi_diameter_mm": 6.0, "thickness_mm": 4.0}
    face = {"semi_diameter_mm": 6.0, "thickness_mm": 0.0}
    surfaces: list[dict[str, Any]] = [{"radius_mm": 40.0, "stop": True} | element]
    for before, behind in ((np.inf, np.inf), (np.inf, 50.0), (60.0, 40.0), (-30.0, -50.0)):
        surfaces += [face | {"radius_mm": before}, element | {"radius_mm": behind}]
    world = world_of({"surfaces": [*surfaces, {"radius_mm": -60.0, "semi_diameter_mm": 6.0}]})
    packets, options = waiting_packets(world, PER_DRAWN, seed=1)
    check = compare(world, options, world.tables, packets)
    assert_agrees(check)
    assert check.compared > 0.8 * PER_DRAWN
    assert check.reflected > 0.3 * PER_DRAWN


def posed_aspheres(lens: dict[str, Any], seed: int) -> dict[str, Any]:
    """Give some surfaces terms, and some elements a pose."""
    return with_poses(with_aspheres(lens, seed), seed)


@pytest.mark.parametrize("changed", [with_aspheres, with_poses, posed_aspheres])
def test_every_packet_beside_an_asphere_or_a_posed_surface_meets_the_surface_that_embree_finds(changed: Any) -> None:
    decided = compared_in_all = 0
    for number, world in enumerate(drawn_worlds(5, changed)):
        packets, options = waiting_packets(world, PER_DRAWN, seed=number)
        check = compare(world, options, world.tables, packets)
        assert_agrees(check)
        # Only here is what is new: spaces that roots alone do not decide.
        beside = packets[~world.tables.lens.by_roots[packets["space"]]]
        decided += compare(world, options, world.tables, beside).compared
        compared_in_all += len(beside)
    assert decided > 0.3 * compared_in_all > 0.1 * PER_DRAWN


def spoil_free_radius(order: NDArray[np.float64]) -> None:
    """Let no ring stand in the way."""
    order[:, 8] = np.inf


def spoil_place(order: NDArray[np.float64]) -> None:
    """Move a surface by some hundred times what may be deviated from."""
    order[1, 2] += 1e-7


def spoil_aperture(order: NDArray[np.float64]) -> None:
    """Let light through outside the clear apertures."""
    order[:, [3, 7]] *= 1.01


def test_packets_that_come_back_to_the_surface_they_left_meet_it_again() -> None:
    found = 0
    for number, world in enumerate(drawn_worlds(8)):
        packets, options = waiting_packets(world, PER_DRAWN, seed=100 + number)
        check = compare(world, options, world.tables, packets[hollow_again(world, packets)])
        if check.compared > 0:
            assert_agrees(check)
        found += check.compared
    assert found > 1000


@pytest.mark.parametrize("spoil", [spoil_free_radius, spoil_place, spoil_aperture])
def test_a_wrong_order_is_told(spoil: Any) -> None:
    # In this lens some rays run through the ring, beyond which they would meet a surface.
    world = world_of(drawn_lens(seed=78))
    packets, options = waiting_packets(world, 20_000, seed=78)
    order = world.tables.lens.order.copy()
    spoil(order)
    tables = world.tables._replace(lens=world.tables.lens._replace(order=order))
    assert compare(world, options, world.tables, packets).holds
    assert not compare(world, options, tables, packets).holds


@pytest.mark.parametrize("changed", [with_aspheres, with_poses])
def test_a_false_certificate_is_told(changed: Any) -> None:
    """Were every ray taken to be steeper than its surfaces, some would meet another surface."""
    told = 0
    for number, world in enumerate(drawn_worlds(3, changed)):
        packets, options = waiting_packets(world, 20_000, seed=number)
        order = world.tables.lens.order.copy()
        order[:, 9] = 0.0
        lens = world.tables.lens._replace(order=order, ordered=np.ones(len(order), np.bool_))
        told += not compare(world, options, world.tables._replace(lens=lens), packets).holds
    assert told > 0


ARRAYS: dict[str, dict[str, Any]] = {
    "square": {},
    "hexagonal, curved side to the sensor": {"layout": "hexagonal", "curved_side": "sensor"},
    "steep": {"focal_length_mm": 0.3},
    "concave": {"focal_length_mm": -0.5},
    "three types": {"layout": "hexagonal", "focal_length_mm": [0.7, 1.0, 1.4]},
    "form errors": {"form": {"pitch_error": 1e-3, "decenter_mm": 0.01, "radius_error": 0.05, "seed": 3}},
    "posed": {"pose": {"shift_mm": [0.01, 0.02, 0.03], "tilt_deg": [0.5, -0.3, 2.0]}},
    "aspheres": {"layout": "hexagonal", "conic": -1.5, "asphere_mm": [-30.0, 900.0]},
    "acylinders with form errors": {
        "conic": -2.0,
        "cylinder_axis": "x",
        "form": {"decenter_mm": 0.01, "radius_error": 0.05, "seed": 3},
    },
}


def world_with_array(**mla: Any) -> lf.World:
    given = {"count": [9, 8], "pitch_mm": 0.2, "focal_length_mm": 1.0, "index": 1.5, "thickness_mm": 0.4} | mla
    sensor = {"pixels": [24, 24], "pixel_mm": 0.1, "distance_mm": 0.7}
    camera = {"focus_mm": 300.0, "lens": SPHERES, "mla": given, "sensor": sensor}
    return lf.build(lf.Scene(camera=camera, targets=[]))


def rays_at_the_array(world: lf.World, count: int, seed: int) -> RaySource:
    """Draw rays from both sides to points of the array and a little beside it, many of them grazing.

    They start within a few pitches. From far away the rounding of the start alone, over the radius of a lenslet, would
    change weights near the critical angle by more than 1e-12.
    """
    draw = np.random.default_rng(seed)
    lenslets, frames = world.tables.mla.lenslets, world.tables.frames
    half = 1.1 * np.array(lenslets.lattice.half_extent)
    behind = draw.random(count) < 0.5
    depth = 10.0 ** draw.uniform(-2.5, -1.0, count)
    aside = draw.normal(size=(count, 2)) * (depth * 10.0 ** draw.uniform(-2.0, 1.0, count))[:, None]
    to = np.column_stack([draw.uniform(-1.0, 1.0, (count, 2)) * half, np.where(behind, lenslets.thickness, 0.0)])
    before = np.where(behind, lenslets.thickness + depth, lenslets.top - depth)
    start = np.column_stack([to[:, :2] + aside, before])
    start, to = (frame.points(frames[MLA_FRAME, WORLD_FRAME], p) for p in (start, to))
    d = to - start
    for _ in range(2):
        d /= np.linalg.norm(d, axis=1, keepdims=True)
    return RaySource(start, d, np.full(count, PLATE), np.zeros(count, np.int64), np.ones(count), np.uint64(seed))


def array_packets(world: lf.World, count: int, seed: int) -> tuple[NDArray[np.void], Options]:
    """Return packets that wait in the cells of the array."""
    packets, options = waiting_packets(world, 4 * count, seed, rays_at_the_array(world, 4 * count, seed))
    return packets[packets["frame"] == MLA_FRAME][:count], options


@pytest.mark.parametrize(
    "name",
    instances(ARRAYS, long=["square", "hexagonal, curved side to the sensor", "posed", "acylinders with form errors"]),
)
def test_every_packet_in_a_cell_meets_the_face_or_side_that_embree_finds(name: str) -> None:
    world = world_with_array(**ARRAYS[name])
    packets, options = array_packets(world, PER_ARRAY, seed=5)
    check = compare(world, options, world.tables, packets)
    assert_agrees(check)
    assert check.compared > 0.999 * PER_ARRAY
    assert check.reflected > 0.05 * PER_ARRAY


def other_curvature(lenslets: Lenslets) -> Lenslets:
    """Bend the faces by some hundred times what may be deviated from."""
    return lenslets._replace(curvature=lenslets.curvature * (1.0 + 1e-4))


def other_pitch(lenslets: Lenslets) -> Lenslets:
    """Move the sides of the cells."""
    return lenslets._replace(lattice=lenslets.lattice._replace(pitch=lenslets.lattice.pitch * (1.0 + 1e-5)))


def thinner_layer(lenslets: Lenslets) -> Lenslets:
    """Cut off the corners of the faces."""
    return lenslets._replace(valley=0.8 * lenslets.valley)


@pytest.mark.parametrize("spoil", [other_curvature, other_pitch, thinner_layer])
def test_a_wrong_cell_is_told(spoil: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    world = world_with_array()
    packets, options = array_packets(world, 20_000, seed=5)
    assert compare(world, options, world.tables, packets).holds
    array = world.tables.mla
    spoiled = world.tables._replace(mla=array._replace(lenslets=spoil(array.lenslets)))

    def spoiled_in_order(world: lf.World, options: Options, chunk: int, tables: Any) -> Workspace:
        return Workspace(world, options, chunk, spoiled if options.faces == BY_ORDER_OR_MESH else tables)

    monkeypatch.setattr(order_check, "Workspace", spoiled_in_order)
    assert not compare(world, options, world.tables, packets).holds


def test_an_order_that_nothing_was_compared_with_does_not_hold() -> None:
    world = world_of(drawn_lens(seed=78))
    packets, options = waiting_packets(world, 1000, seed=78)
    check = compare(world, options, world.tables, packets[:0])
    assert check.compared == 0
    assert not check.holds


POSED_ASPHERES = {
    "surfaces": [SPHERES["surfaces"][0] | {"asphere_mm": [2e-5, -1e-7]}, *SPHERES["surfaces"][1:]],
    "elements": [{"surfaces": [0, 1], "pose": {"shift_mm": [0.05, 0.0, 0.0], "tilt_deg": [0.0, 0.3, 0.0]}}],
}


def scene(lens: Any = SPHERES, **transport: Any) -> lf.Scene:
    """A light-field camera before a plane that shines and a lamp that lights it, with some light by reflections."""
    plane = {"shape": {"kind": "plane", "width_mm": 200.0, "height_mm": 200.0}, "position_mm": [0.0, 0.0, -300.0]}
    settings = {"samples": 32, "replicates": 4, "threads": 1, "wavelengths_nm": [587.6], "weight_cutoff": 0.1}
    mla = {"count": [12, 12], "pitch_mm": 0.2, "focal_length_mm": 1.0, "index": 1.5, "thickness_mm": 0.4}
    return lf.Scene(
        camera={"focus_mm": 300.0, "lens": lens, "mla": mla, "sensor": {"pixels": [24, 24], "pixel_mm": 0.1}},
        targets=[plane | {"material": {"reflectance": 0.5, "radiance_w_m2_sr": 1.0}}],
        lights=[{"kind": "point", "position_mm": [50.0, 50.0, -20.0], "power_w": 5.0}],
        transport=settings | transport,
    )


METHODS: list[dict[str, Any]] = [
    {"method": "adjoint", "split": "roulette"},
    {"method": "forward"},
    {"method": "adjoint", "lens": POSED_ASPHERES},
]


@pytest.mark.parametrize("method", METHODS)
def test_the_image_is_that_of_the_meshes_and_its_energy_closes(method: dict[str, Any]) -> None:
    """The same random numbers give the same paths, so that the images differ by rounding alone."""
    world = lf.build(scene(**method))
    renderer = Renderer(world)
    assert renderer.order is not None
    assert renderer.order.compared > 300
    assert_agrees(renderer.order)
    image = renderer.image()
    by_meshes = Renderer(world)
    by_meshes.parts = tuple(part.by_meshes() for part in by_meshes.parts)
    truth = by_meshes.image()
    assert image.timings["embree_queries"] < truth.timings["embree_queries"]
    assert np.abs(image.mean - truth.mean).max() <= 1e-10 * truth.mean.max()
    assert abs(image.ledger.imbalance) <= 1e-12
    assert image.ledger.events == truth.ledger.events


def test_the_image_is_bitwise_the_same_for_any_number_of_threads() -> None:
    one, three = lf.render(scene(POSED_ASPHERES)), lf.render(scene(POSED_ASPHERES, threads=3))
    assert one.order == three.order
    assert np.array_equal(one.mean, three.mean)


def test_a_run_whose_order_deviates_uses_the_meshes_and_says_so() -> None:
    world = lf.build(scene())
    order = world.tables.lens.order.copy()
    spoil_place(order)
    world.tables = world.tables._replace(lens=world.tables.lens._replace(order=order))
    image = Renderer(world).image()
    assert image.order is not None
    assert not image.order.holds
    assert any(line.startswith("Warning: sequential and mesh tracing of lens and array") for line in summary(image))
    honest = Renderer(lf.build(scene()))
    honest.parts = parts_of(honest.world, by_meshes=True)
    assert np.array_equal(image.mean, honest.image().mean)


def test_meshes_that_stand_for_nothing_exact_are_not_asked_for_an_order() -> None:
    for changes in ({"surface": "flat"}, {"engine": "mesh"}):
        renderer = Renderer(lf.build(scene(**changes)))
        assert renderer.order is None
        assert not any(part.options.faces == BY_ORDER_OR_MESH for part in renderer.parts)
