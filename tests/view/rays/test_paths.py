"""How paths are laid out: whole, each once, and grouped by what happened to them."""

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.geometry import frame as frames
from lfmesh.scene import load_lens
from lfmesh.view.rays.launch import as_in_run, from_field_point, from_pixels
from lfmesh.view.rays.names import aliases, label, lens_names
from tests.frames import motion


@pytest.fixture(scope="module")
def world():
    camera = lf.Camera(
        lens=load_lens(asset_path("lenses/double_gauss_50mm.toml")),
        focus_mm=500.0,
        mla=lf.MicrolensArray(
            layout="hexagonal", count=(40, 40), pitch_mm=0.125, focal_length_mm=0.5, index=1.5, thickness_mm=0.3
        ),
        sensor=lf.Sensor(pixels=(60, 50), pixel_mm=0.08),
        pose=lf.Pose(shift_mm=(3.0, -2.0, 1.0), tilt_deg=(4.0, 5.0, 6.0)),
    )
    return lf.build(lf.Scene(camera=camera))


@pytest.fixture(scope="module")
def point(world):
    """A point near the axis of the camera, which stands askew in the world."""
    return frames.points(motion(world, "camera", "world"), [[4.0, 3.0, -500.0]])[0]


@pytest.fixture(scope="module")
def rays(world, point):
    return from_field_point(world, point, 300, aim="lens", weight_cutoff=0.005)


def vertices(rays, path):
    return range(rays.offsets[path], rays.offsets[path + 1])


def test_every_path_begins_at_its_start_and_ends_once(rays, point):
    first, last = rays.offsets[:-1], rays.offsets[1:] - 1
    between = np.ones(len(rays.event), bool)
    between[first] = between[last] = False
    assert (rays.event[first] == lf.Event.START).all()
    assert np.isin(rays.event[between], [lf.Event.TRANSMITTED, lf.Event.REFLECTED]).all()
    ends = {
        lf.Status.SENSOR: lf.Event.SENSOR, lf.Status.ABSORBED: lf.Event.ABSORBED, lf.Status.ESCAPED: lf.Event.ESCAPED
    }  # fmt: skip
    assert [lf.Event(e) for e in rays.event[last]] == [ends[lf.Status(s)] for s in rays.status]
    np.testing.assert_allclose(rays.position[first], np.tile(point, (len(rays), 1)), atol=1e-12)
    # A row a vertex, none shared and none left over.
    assert (rays.offsets[0], rays.offsets[-1]) == (0, len(rays.position))
    assert set(rays.source) == set(range(300))


def test_paths_are_those_of_a_trace_of_the_same_rays(world, point):
    """Vertex by vertex what `lf.trace` records of the rays with the same directions."""
    at_pupil = from_field_point(world, point, 40, split="transmit")
    d = at_pupil.position[at_pupil.offsets[:-1] + 1] - at_pupil.position[at_pupil.offsets[:-1]]
    paths = lf.trace(world, np.tile(point, (len(d), 1)), d, split="transmit", record=True)
    order = np.argsort(at_pupil.source)
    assert len(paths) == len(order) == 40
    for packet, path in enumerate(order):
        traced = paths.vertices(packet)
        assert len(traced) == len(vertices(at_pupil, path))
        if paths.status[packet] == lf.Status.ESCAPED:
            continue
        here = at_pupil.position[vertices(at_pupil, path)]
        np.testing.assert_allclose(here, [v.position for v in traced], atol=1e-9)
        power = at_pupil.power[vertices(at_pupil, path)]
        np.testing.assert_allclose(power / power[0], [v.weight for v in traced], rtol=1e-9)


def test_paths_with_one_sequence_met_the_same_surfaces_in_the_same_way(rays):
    met = {}
    for path in range(len(rays)):
        part = vertices(rays, path)
        key = tuple((rays.surfaces[rays.surface[v]], lf.Event(rays.event[v])) for v in part if v > part[0])
        assert met.setdefault(int(rays.sequence[path]), key) == key
    assert len(set(met.values())) == len(met) == len(rays.sequences) > 100
    for number, key in met.items():
        letters = {lf.Event.TRANSMITTED: " T", lf.Event.REFLECTED: " R"}
        assert rays.sequences[number] == ", ".join(label(name) + letters.get(event, "") for name, event in key)


def test_sequences_are_numbered_by_what_they_bring_to_the_sensor(rays):
    power = np.bincount(rays.sequence, rays.end_power * rays.arrives)
    assert (np.diff(power) <= 0.0).all()
    assert rays.sequences[0] == (
        "L1a T, L1b T, L2a T, L2b T, L3b T, L4a T, L4b T, L5b T, L6a T, L6b T, MLAc T, MLAf T, sensor"
    )


def test_a_path_that_escapes_ends_on_a_sphere_round_the_scene_and_goes_straight_there(world, rays):
    escaped = np.flatnonzero((rays.status == lf.Status.ESCAPED) & (np.diff(rays.offsets) > 2))
    last = rays.offsets[1:][escaped] - 1
    assert len(escaped) > 100
    away = rays.position[last] - rays.position[last - 1]
    assert np.linalg.norm(away, axis=1).min() > 10.0
    p = rays.position[last]
    # All on one sphere: |p|² is linear in p.
    design = np.column_stack([p, np.ones(len(p))])
    fit, *_ = np.linalg.lstsq(design, (p**2).sum(axis=1), rcond=None)
    assert np.abs(design @ fit - (p**2).sum(axis=1)).max() < 1e-6
    centre, radius2 = 0.5 * fit[:3], fit[3] + 0.25 * fit[:3] @ fit[:3]
    # Nothing that is met lies further out, also of what the planes of mount and sensor end.
    met = np.ones(len(rays.position), bool)
    met[rays.offsets[:-1]] = False
    assert ((rays.position[met] - centre) ** 2).sum(axis=1).max() < radius2 * (1.0 + 1e-9)
    d = away / np.linalg.norm(away, axis=1)[:, None]
    front = d[rays.surface[last - 1] == rays.surfaces.index("lens[0].front")]
    assert (front[:, 2] < 0.0).mean() > 0.9


def test_pixels_are_those_under_the_ends(world, rays):
    hit = rays.status == lf.Status.SENSOR
    at = rays.position[rays.offsets[1:] - 1][hit]
    sensor = world.mesh("sensor").vertices
    corner, along, up = sensor[0], sensor[1] - sensor[0], sensor[3] - sensor[0]
    column = (at - corner) @ along / (along @ along) * 60
    row = (at - corner) @ up / (up @ up) * 50
    assert hit.sum() > 100
    np.testing.assert_array_equal(rays.pixel[hit], np.floor(np.column_stack([row, column])))
    assert (rays.pixel[~hit] == -1).all()


def test_lenslets_are_those_whose_cell_holds_the_vertex(world, rays):
    curved = rays.surface == rays.surfaces.index("mla.curved")
    centres = world.tables.mla.lenslets.lattice.centres().reshape(-1, 2)
    p = frames.points(motion(world, "world", "array"), rays.position[curved])[:, :2]
    distance = np.linalg.norm(p[:, None] - centres, axis=2)
    np.testing.assert_allclose(distance[np.arange(len(p)), rays.lenslet[curved]], distance.min(axis=1), atol=1e-9)
    assert (rays.lenslet[~curved] == -1).all()
    assert curved.sum() > 100


def test_kept_paths_are_the_same_paths(rays):
    chosen = np.arange(len(rays)) % 3 == 1
    kept = rays.keep(chosen)
    assert len(kept) == chosen.sum()
    for new, old in enumerate(np.flatnonzero(chosen)[:200]):
        a, b = vertices(kept, new), vertices(rays, old)
        for name in ("position", "surface", "event", "power", "lenslet"):
            np.testing.assert_array_equal(getattr(kept, name)[a], getattr(rays, name)[b])
        for name in ("status", "source", "pixel", "wavelength_nm", "sequence", "end_power", "ghosts"):
            np.testing.assert_array_equal(getattr(kept, name)[new], getattr(rays, name)[old])
    assert len(rays.keep(np.zeros(len(rays), bool))) == 0
    # What was worked out for all paths is not taken for that of the kept ones.
    assert len(kept.path) == len(kept.position)


def test_surfaces_are_called_by_their_elements(world):
    names = lens_names(world)
    assert names == [
        "lens[0].front", "lens[0].back", "lens[1].front", "lens[1].back", "lens[2].back",
        "lens[3].front", "lens[3].back", "lens[4].back", "lens[5].front", "lens[5].back",
    ]  # fmt: skip
    assert [label(name) for name in names] == ["L1a", "L1b", "L2a", "L2b", "L3b", "L4a", "L4b", "L5b", "L6a", "L6b"]
    other = aliases(world)
    assert (other["lens[2].front"], other["L3a"]) == ("lens[1].back", "lens[1].back")
    # The names of elements are those of their meshes: a front is a face of its element's solid.
    for element in range(6):
        solid = world.mesh(f"lens[{element}]")
        z = solid.bounds[:, 2]
        assert z[0] < z[1]


def test_what_reaches_the_scene_from_the_sensor_arrives(world):
    rays = from_pixels(world, range(20, 24), range(20, 24), 200)
    assert rays.from_sensor
    assert set(rays.status[rays.arrives]) == {lf.Status.ESCAPED}
    assert rays.ghosts.any()
    assert (rays.count_vertices(rays.reflected)[rays.ghosts] >= 2).all()


def test_light_that_a_target_emits_starts_there():
    camera = lf.Camera(
        lens=load_lens(asset_path("lenses/double_gauss_50mm.toml")),
        focus_mm=500.0,
        sensor=lf.Sensor(pixels=(8, 8), pixel_mm=0.2),
    )
    glow = lf.Target(
        name="glow", shape=lf.Plane(width_mm=20.0, height_mm=20.0), position_mm=(0.0, 0.0, -500.0),
        material=lf.Material(radiance_w_m2_sr=1.0),
    )  # fmt: skip
    scene = lf.Scene(camera=camera, targets=(glow,), transport=lf.Transport(method="forward", samples=16))
    rays = as_in_run(lf.build(scene), 300)
    first = rays.offsets[:-1]
    assert len(rays) > 100
    assert (rays.event[first] == lf.Event.START).all()
    assert {rays.surfaces[s] for s in rays.surface[first]} == {"glow"}
    np.testing.assert_allclose(rays.position[first][:, 2], -500.0)
    assert not any("glow" in sequence.split(",")[0] for sequence in rays.sequences)
