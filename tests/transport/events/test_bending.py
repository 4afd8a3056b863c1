"""Rays through media that bend light: chords between nodes, faces, and what stands in a field."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.optics.index_field_path import MOST_CHORDS
from lfmesh.transport.engine import Workspace
from lfmesh.transport.packets.packet import BENT, PACKET
from lfmesh.transport.settings import options_of
from tests.cameras import camera_without_array

LENGTH_MM, HALF_MM = 300.0, 10.0
ON_AXIS = 1.0005
PER_MM = float(np.sqrt(2.0 * 0.0009)) / HALF_MM
"""Gradient constant g of a duct n² = n₀² (1 − g² r²) that differs from 1 by less than 1e-3 within `HALF_MM`."""

DUCT = {
    "name": "duct",
    "bounds": {"kind": "box", "size_mm": [2.0 * 0.7 * HALF_MM, 2.0 * 0.7 * HALF_MM, LENGTH_MM]},
    "index": {"kind": "radial_n2", "index": ON_AXIS, "coefficients": [-(PER_MM**2)]},
    "position_mm": [0.0, 0.0, -400.0],
}
STARTS = np.array([[1.0, 2.0, -600.0], [-3.0, 0.5, -600.0], [0.0, 5.0, -600.0]])
ALONG = np.tile([0.0, 0.0, 1.0], (len(STARTS), 1))


def scene(*media: dict[str, Any], **tables: Any) -> lf.Scene:
    return lf.Scene(**{"camera": camera_without_array(), "media": media} | tables)  # type: ignore[arg-type]


def in_duct(starts: np.ndarray, length_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Return places across the axis and optical ray vectors of rays that enter a duct along its axis."""
    along = ON_AXIS * np.sqrt(1.0 - PER_MM**2 * (starts[:, :2] ** 2).sum(axis=1, keepdims=True))
    phase = PER_MM * ON_AXIS * length_mm / along
    across = -starts[:, :2] * PER_MM * ON_AXIS * np.sin(phase)
    return starts[:, :2] * np.cos(phase), np.hstack([across, along])


def screen(z_mm: float, size_mm: float = 100.0) -> dict[str, Any]:
    return {"shape": {"kind": "plane", "width_mm": size_mm, "height_mm": size_mm}, "position_mm": [0.0, 0.0, z_mm]}


def test_a_ray_leaves_a_parabolic_duct_as_the_sine_of_its_phase_says() -> None:
    world = lf.build(scene(DUCT))
    assert world.tables.objects.fields is not None
    assert world.tables.objects.fields.free.all()
    paths = lf.trace(world, STARTS, ALONG, split="transmit")
    _, optical = in_duct(STARTS, LENGTH_MM)
    # Only the lens may turn the ray again; those that miss it have kept the direction behind the duct.
    recorded = lf.trace(world, STARTS, ALONG, split="transmit", record=True)
    for ray in range(len(STARTS)):
        vertices = recorded.vertices(int(np.flatnonzero(recorded.source == ray)[0]))
        behind = [k for k, vertex in enumerate(vertices) if vertex.surface == "index field"][-1]
        way = vertices[behind + 1].position - vertices[behind].position
        way /= np.linalg.norm(way)
        assert way[:2] == pytest.approx(optical[ray, :2], abs=1e-9)
        place, _ = in_duct(STARTS, LENGTH_MM)
        assert vertices[behind].position[:2] == pytest.approx(place[ray], abs=1e-8)
        assert vertices[behind].position[2] == pytest.approx(-400.0 + 0.5 * LENGTH_MM, rel=1e-12)
    # Chord by chord, or at once: the same ray.
    assert recorded.position == pytest.approx(paths.position, abs=1e-9)
    assert recorded.events.tolist() == paths.events.tolist()


def test_a_target_in_a_field_is_met_where_the_curve_meets_it() -> None:
    depth = 170.0
    at_z = -400.0 - 0.5 * LENGTH_MM + depth
    world = lf.build(scene(DUCT, targets=[screen(at_z, 12.0)]))
    assert not world.tables.objects.fields.free.any()
    paths = lf.trace(world, STARTS, ALONG, split="transmit")
    place, _ = in_duct(STARTS, depth)
    assert (paths.status == lf.Status.TARGET).all()
    size = 1.5 * 400.0 / 30.0
    assert np.abs(paths.position[:, :2] - place).max() < 0.01 * size
    assert np.abs(place - STARTS[:, :2]).max() > 0.1


def test_a_ray_sent_back_from_its_end_returns_to_its_start() -> None:
    there = lf.build(scene(DUCT, targets=[screen(-700.0), screen(-200.0)]))
    ends = lf.trace(there, STARTS, ALONG, split="transmit")
    back = lf.trace(there, ends.position - 1e-3 * ends.direction, -ends.direction, split="transmit")
    assert back.position[:, :2] == pytest.approx(STARTS[:, :2], abs=1e-8)


def test_a_grazing_ray_is_totally_reflected_at_the_face_of_a_thinner_field() -> None:
    thin = {"bounds": {"kind": "box", "size_mm": [20.0, 20.0, 300.0]}, "index": 0.9995, "position_mm": [0, 0, -400.0]}
    world = lf.build(scene(thin, targets=[screen(-100.0, 400.0)]))
    # The critical angle from grazing is √(2 · 5e-4) = 1.8 degrees.
    angles = np.deg2rad([1.5, 2.2])
    starts = np.array([[10.0 + 100.0 * np.tan(angle), 0.0, -500.0] for angle in angles])
    ways = np.array([[-np.sin(angle), 0.0, np.cos(angle)] for angle in angles])
    paths = lf.trace(world, starts, ways, split="transmit", record=True)
    events = [[vertex.event for vertex in paths.vertices(ray) if vertex.surface == "index field"] for ray in range(2)]
    assert events[0] == [lf.Event.REFLECTED]
    assert events[1][0] == lf.Event.TRANSMITTED
    assert paths.direction[0] == pytest.approx([np.sin(angles[0]), 0.0, np.cos(angles[0])], abs=1e-12)


def test_a_uniform_field_of_the_index_around_changes_no_ray() -> None:
    same = {"bounds": {"kind": "box", "size_mm": [50.0, 50.0, 100.0]}, "index": 1.0, "position_mm": [0, 0, -400.0],
            "rotation_deg": [10.0, 20.0, 30.0]}  # fmt: skip
    wall = screen(-200.0)
    draw = np.random.default_rng(3)
    starts = np.column_stack([draw.uniform(-30, 30, (64, 2)), np.full(64, -600.0)])
    ways = np.column_stack([draw.uniform(-0.05, 0.05, (64, 2)), np.ones(64)])
    bent = lf.trace(lf.build(scene(same, targets=[wall])), starts, ways)
    straight = lf.trace(lf.build(scene(targets=[wall])), starts, ways)
    assert bent.position == pytest.approx(straight.position, abs=1e-10)
    assert bent.direction == pytest.approx(straight.direction, abs=1e-13)


def test_a_density_bends_each_wavelength_by_its_own_constant(tmp_path: Path) -> None:
    nodes = np.linspace(-19.0, 19.0, 20)
    density = np.broadcast_to(1.2 + 0.4 * nodes[:, None, None] / 20.0, (20, 20, 20))
    np.savez(tmp_path / "ramp.npz", density_kg_m3=density, spacing_mm=2.0)
    ramp = {"grid": "ramp.npz", "position_mm": [0.0, 0.0, -400.0]}
    given = scene(ramp, targets=[screen(-200.0)]).in_folder(tmp_path)
    world = lf.build(given)
    turned = []
    for wavelength in (450.0, 650.0):
        paths = lf.trace(world, [[0.0, 0.0, -500.0]], [[0.0, 0.0, 1.0]], wavelength_nm=wavelength)
        turned.append(paths.direction[0, 0])
    own = [lf.trace(lf.build(given.changed({"transport.wavelengths_nm": [w]})), [[0.0, 0.0, -500.0]],
                    [[0.0, 0.0, 1.0]]).direction[0, 0] for w in (450.0, 650.0)]  # fmt: skip
    assert turned == pytest.approx(own, rel=1e-9)
    # Gladstone and Dale: K ∂ρ/∂x L, with K of air near 2.26e-4 m³/kg.
    assert turned[1] == pytest.approx(2.26e-4 * 0.02 * 40.0, rel=0.01)
    assert turned[0] / turned[1] == pytest.approx(1.018, abs=0.006)


def test_all_light_is_accounted_for_with_a_field_and_fog_in_it() -> None:
    fog = {"bounds": {"kind": "sphere", "radius_mm": 60.0}, "position_mm": [0.0, 0.0, -400.0],
           "scattering_per_mm": 1e-3, "absorption_per_mm": 1e-3}  # fmt: skip
    world = lf.build(scene(DUCT, fog, targets=[screen(-200.0), screen(-600.0)]))
    draw = np.random.default_rng(1)
    starts = np.column_stack([draw.uniform(-6, 6, (500, 2)), np.full(500, -590.0)])
    ways = np.column_stack([draw.uniform(-0.02, 0.02, (500, 2)), np.ones(500)])
    ledger = lf.trace(world, starts, ways).ledger
    assert abs(ledger.imbalance) < 1e-12


def test_packets_have_a_chord_only_where_light_is_bent() -> None:
    straight, bent = (lf.build(given, aimed=False) for given in (scene(), scene(DUCT)))
    for world, record in ((straight, PACKET), (bent, BENT)):
        assert Workspace(world, options_of(world), 1).stacks.record == record
    assert straight.tables.objects.fields is None
    assert "trapped in duct" in bent.slots
    assert MOST_CHORDS > 0


def test_field_and_camera_give_the_same_light_forward_and_backward() -> None:
    lens = {"bounds": {"kind": "box", "size_mm": [40.0, 40.0, 60.0]}, "position_mm": [0.0, 0.0, -120.0],
            "index": {"kind": "radial_n2", "index": 1.0008, "coefficients": [-4e-6]}}  # fmt: skip
    lamp = {"kind": "point", "position_mm": [60.0, 0.0, -60.0], "power_w": 1.0}
    wall = screen(-250.0, 200.0) | {"material": {"reflectance": 0.8}}
    settings = {"samples": 1 << 13, "replicates": 16}
    given = scene(lens, targets=[wall], lights=[lamp], transport=settings)
    given = given.changed({"camera.sensor.pixels": [2, 2], "camera.sensor.pixel_mm": 6.0})
    other = lf.render(given.changed({"transport.method": "forward", "transport.samples": 1 << 18}))
    one = lf.render(given)
    difference = float(one.mean.sum() - other.mean.sum())
    deviation = float(np.sqrt((one.stderr**2).sum() + (other.stderr**2).sum()))
    assert abs(difference) < 4.0 * deviation
    assert deviation < 0.02 * float(one.mean.sum())
