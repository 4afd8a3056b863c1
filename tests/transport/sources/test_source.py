"""Sources: whatever packets start from, they are the same packets however it is cut into parts."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.lib.recfunctions import repack_fields

import lfmesh as lf
from lfmesh.transport.engine import Workspace
from lfmesh.transport.packets.book import EMITTED
from lfmesh.transport.packets.packet import BY_MESH, OBJECTS, PACKET, STATIONS
from lfmesh.transport.packets.random import run_key
from lfmesh.transport.render.tally import Film
from lfmesh.transport.settings import options_of
from lfmesh.transport.sources.lights import LightSource
from lfmesh.transport.sources.pixels import PixelSource
from lfmesh.transport.sources.rays import RaySource
from lfmesh.transport.sources.source import Launcher, Source
from lfmesh.transport.tables.lines import FIRST

KEY = run_key(7)
PIXELS, SAMPLES = 36, 5
LENS = {"surfaces": [{"radius_mm": 20.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 5.0},
                     {"radius_mm": -20.0, "thickness_mm": 1.0, "semi_diameter_mm": 5.0},
                     {"stop": True, "semi_diameter_mm": 4.0}]}  # fmt: skip


@pytest.fixture(scope="module")
def world() -> lf.World:
    """A lamp, a target that shines, and a camera without an array."""
    wall = {"shape": {"kind": "plane", "width_mm": 9.0, "height_mm": 9.0}, "position_mm": [0.0, 0.0, -60.0],
            "material": {"reflectance": 0.5, "radiance_w_m2_sr": 2.0}}  # fmt: skip
    lamp = {"kind": "point", "position_mm": [20.0, -15.0, -25.0], "power_w": 1e-3}
    camera = {"focus_mm": 60.0, "lens": LENS, "sensor": {"pixels": [6, 6], "pixel_mm": 0.1}}
    return lf.build(lf.Scene(camera=camera, targets=[wall], lights=[lamp]))


def pixels() -> Source:
    return PixelSource(np.arange(PIXELS), SAMPLES, KEY)


def lights() -> Source:
    return LightSource(40, 150, 1000, KEY, FIRST)


def rays() -> Source:
    random = np.random.default_rng(1)
    d = np.column_stack([random.normal(0.0, 0.05, (90, 2)), np.ones(90)])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return RaySource(
        -40.0 * d, d, np.full(90, OBJECTS), np.zeros(90, np.int64), random.random(90), KEY, away=0.25
    )  # fmt: skip


SOURCES: dict[str, tuple[Callable[[], Source], dict[str, bool]]] = {
    "pixels": (pixels, {"tracing": True}),
    "lights": (lights, {"adjoint": False}),
    "rays": (rays, {"tracing": True}),
}


def workspace(world: lf.World, name: str) -> Workspace:
    return Workspace(world, options_of(world)._replace(faces=BY_MESH, **SOURCES[name][1] | {"adjoint": False}))


def started(work: Workspace, source: Source, part: range) -> tuple[list[bytes], float]:
    """Return the packets of a part, station by station, and the power that was booked."""
    work.begin(packets=len(part) * source.each)
    source.launch(work, part)
    fields = [name for name in PACKET.names or () if name not in ("source", "density")]
    waiting = [work.stacks.waiting(s)[fields] for s in range(STATIONS)]
    return sorted(row.tobytes() for row in repack_fields(np.concatenate(waiting))), float(work.book[EMITTED])


@pytest.mark.parametrize("name", SOURCES)
def test_parts_of_a_source_start_the_packets_of_the_whole(name: str, world: lf.World) -> None:
    source, work = SOURCES[name][0](), workspace(world, name)
    whole, emitted = started(work, source, range(len(source)))
    assert emitted > 0.0
    assert 0 < len(whole) <= len(source) * source.each
    parts = [started(work, source, part) for part in source.parts(7)]
    assert len(parts) > 4
    assert sorted(packet for part in parts for packet in part[0]) == whole
    assert sum(part[1] for part in parts) == pytest.approx(emitted, rel=1e-13)


def test_parts_are_whole_things_and_about_a_chunk() -> None:
    source = pixels()
    assert [len(part) * source.each for part in source.parts(4 * SAMPLES + 3)] == [4 * SAMPLES] * 9
    assert list(source.parts(1)) == [range(i, i + 1) for i in range(PIXELS)]


def test_samples_beyond_a_chunk_bring_the_same_light_in_less_memory(world: lf.World) -> None:
    films, sizes = [], []
    for chunk in (4096, 64):
        launcher = Launcher(lambda chunk=chunk: Workspace(world, options_of(world), chunk))  # type: ignore[misc]
        film = Film.empty(2, 1, 0)
        work = launcher.trace(PixelSource(np.arange(2), 2048, KEY), film=film)
        films.append(film)
        sizes.append(work.stacks.memory.nbytes)
    np.testing.assert_allclose(films[1].power, films[0].power, rtol=1e-12)
    np.testing.assert_array_equal(films[1].hits, films[0].hits)
    assert films[0].hits.all()
    assert sizes[1] < 0.1 * sizes[0]


@pytest.mark.parametrize("name", SOURCES)
def test_what_is_traced_is_in_order_whatever_the_threads(name: str, world: lf.World) -> None:
    source = SOURCES[name][0]()
    results = []
    for threads in (1, 3):
        launcher = Launcher(lambda: workspace(world, name))
        results.append(launcher.traced(source, lambda work, part: (part, work.book.copy()), threads, 40))
    for one, other in zip(*results, strict=True):
        assert one[0] == other[0]
        np.testing.assert_array_equal(one[1], other[1])


def test_a_ray_carries_its_weight_and_meets_nothing_near_its_start(world: lf.World) -> None:
    source = rays()
    assert isinstance(source, RaySource)
    work = workspace(world, "rays")
    work.begin(packets=len(source))
    source.launch(work, range(10, 30))
    packets = work.stacks.waiting(OBJECTS)
    np.testing.assert_array_equal(packets["source"], np.arange(10, 30))
    for field, expected in (("weight", source.weight[10:30]), ("start", source.weight[10:30])):
        np.testing.assert_array_equal(packets[field], expected)
    assert (packets["query_from"] == 0.25).all()
    assert (packets["limit"] == 0.25).all()
    assert work.book[EMITTED] == pytest.approx(source.weight[10:30].sum(), rel=1e-15)


def test_nothing_starts_where_nothing_shines() -> None:
    camera = {"focus_mm": 60.0, "lens": LENS, "sensor": {"pixels": [6, 6], "pixel_mm": 0.1}}
    dark = lf.build(lf.Scene(camera=camera, targets=[]))
    assert started(workspace(dark, "lights"), lights(), range(150)) == ([], 0.0)


def test_no_ray_through_the_array_is_rouletted_by_more_than_a_lenslets_weight() -> None:
    """Children of blind rays, which are few and heavy, are followed to the same weight as those of main rays."""
    sensor = {"pixels": (40, 40), "pixel_mm": 0.0125}
    camera = {"focus_mm": 60.0, "lens": LENS, "mla": {"count": (12, 12), "pitch_mm": 0.125, "focal_length_mm": 0.5,
              "index": 1.5, "thickness_mm": 0.3}, "sensor": sensor}  # fmt: skip
    wall = {"shape": {"kind": "plane", "width_mm": 9.0, "height_mm": 9.0}, "position_mm": [0.0, 0.0, -60.0]}
    world = lf.build(lf.Scene(camera=camera, targets=[wall]))
    samples = 16
    aim = world.aim._replace(exit=world.aim.exit._replace(wide_share=0.5))
    tables = world.tables._replace(aim=aim)
    source = PixelSource(np.arange(1600), samples, KEY)
    work = Workspace(world, options_of(world)._replace(faces=BY_MESH), tables=tables)
    work.begin(packets=1600 * samples)
    source.launch(work, range(1600))
    packets = np.concatenate([work.stacks.waiting(s) for s in range(STATIONS)])
    weight, start = packets["weight"], packets["start"]
    # Of the lenslet straight ahead, over the share of the main rays, m² sr.
    mla, distance = world.scene.camera.mla, world.scene.camera.sensor.distance_mm
    assert mla is not None
    assert distance is not None
    etendue = 1e-6 * 0.0125**2 * (mla.pitch_mm / (distance + mla.thickness_mm / 1.5)) ** 2 / samples / 0.5
    np.testing.assert_allclose(start, np.minimum(weight, etendue), rtol=1e-9)
    # Main rays keep their own weight where one lenslet shows the opening; blind rays are far above.
    assert (start == weight).mean() > 0.1
    assert (weight > 20.0 * start).mean() > 0.1
