"""Paths through gradient-index glass: curves against closed forms, indices at vertices, and the laws of refraction."""

import itertools
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.geometry import frame as frames
from lfmesh.transport.packets.packet import WORLD_FRAME
from lfmesh.view.key_figures import key_figures
from lfmesh.view.layout.content import layout
from lfmesh.view.rays.gradient_segments import FLATNESS
from lfmesh.view.rays.history import history, lines
from lfmesh.view.rays.launch import from_field_point, from_pixels
from lfmesh.view.rays.paths import Rays
from lfmesh.view.scene3d.describe import describe
from lfmesh.view.scene3d.ray_lines import ray_lines

Array = NDArray[np.float64]

N0, G, LENGTH_MM = 1.6, 0.15, 25.0
"""Index on the axis, gradient constant in 1/mm, and length of a rod of more than half a pitch."""

POINT_MM = (1.0, 2.0, -60.0)


def rod(**more: Any) -> lf.Scene:
    front = {"stop": True, "thickness_mm": LENGTH_MM, "semi_diameter_mm": 1.5,
             "gradient": {"kind": "radial_n2", "index": N0, "coefficients": [-G * G]}}  # fmt: skip
    return lf.Scene.model_validate(
        {
            "schema_version": 1,
            "camera": {
                "lens": {"surfaces": [front, {"semi_diameter_mm": 3.0, **more}]},
                "sensor": {"pixels": [200, 200], "pixel_mm": 0.1, "distance_mm": 20.0},
            },
            "transport": {"wavelengths_nm": [550.0]},
        }
    )


@pytest.fixture(scope="module")
def world() -> lf.World:
    return lf.build(rod())


@pytest.fixture(scope="module")
def rays(world: lf.World) -> Rays:
    return from_field_point(world, POINT_MM, 60, aim="lens", weight_cutoff=1e-4)


def index_at(points: Array) -> Array:
    return N0 * np.sqrt(1.0 - G * G * (points[..., 0] ** 2 + points[..., 1] ** 2))


def closed_form(start: Array, momentum: Array, z: Array) -> Array:
    """Return x and y at z of a ray in the rod: harmonic in (z − z₀) / β, with β = √(n² − p²) kept."""
    beta = np.sqrt(index_at(start) ** 2 - momentum @ momentum)
    turn = N0 * G * np.abs(z - start[2])[:, None] / beta
    return start[:2] * np.cos(turn) + momentum / (N0 * G) * np.sin(turn)


def image_path(rays: Rays) -> NDArray[np.int64]:
    """Return the first vertex of the paths that meet both faces once, which is the one on the front face, less 1."""
    return np.flatnonzero(rays.arrives & (np.diff(rays.offsets) == 4))


def test_curves_are_those_of_the_closed_form_and_smooth(rays: Rays) -> None:
    paths = image_path(rays)
    assert len(paths) > 10
    bulge = 0.0
    for path in paths:
        front = int(rays.offsets[path]) + 1
        before = rays.position[front] - rays.position[front - 1]
        momentum = before[:2] / np.linalg.norm(before)
        curve = rays.curves(np.array([front]))[front]
        np.testing.assert_array_equal(curve[[0, -1]], rays.position[[front, front + 1]])
        np.testing.assert_allclose(curve[:, :2], closed_form(curve[0], momentum, curve[:, 2]), rtol=0.0, atol=1e-8)
        # The lines between the points are within a tenth of a pixel of the curve in a picture 1000 pixels wide.
        middle = 0.5 * (curve[1:] + curve[:-1])
        off = np.linalg.norm(middle[:, :2] - closed_form(curve[0], momentum, middle[:, 2]), axis=1)
        assert off.max() < FLATNESS * LENGTH_MM
        chord = curve[0] + (curve[:, 2:] - curve[0, 2]) / LENGTH_MM * (curve[-1] - curve[0])
        bulge = max(bulge, float(np.linalg.norm(curve - chord, axis=1).max()))
    assert bulge > 100.0 * FLATNESS * LENGTH_MM, "no curve: no test of it"


def test_drawn_lines_have_the_points_of_the_curves(rays: Rays) -> None:
    drawn = ray_lines(rays, 10**6)
    points, firsts = drawn.points
    curved = np.isin(drawn.vertex, rays.gradients.vertex)
    assert (np.diff(firsts)[~curved] == 2).all()
    assert (np.diff(firsts)[curved] > 8).all()
    np.testing.assert_array_equal(points[firsts[:-1]], drawn.ends[:, 0])
    np.testing.assert_array_equal(points[firsts[1:] - 1], drawn.ends[:, 1])
    pieces, segment = drawn.pieces
    for number in (int(np.argmax(curved)), int(np.argmin(curved))):
        own = points[firsts[number] : firsts[number + 1]]
        np.testing.assert_array_equal(pieces[segment == number], np.stack([own[:-1], own[1:]], axis=1))
    mesh, _ = drawn.coloured("wavelength")
    assert mesh.n_cells == len(drawn)
    assert mesh.get_cell(int(np.argmax(curved))).n_points == np.diff(firsts)[np.argmax(curved)]


@pytest.mark.parametrize("from_sensor", [False, True])
def test_a_history_states_the_index_at_each_vertex(world: lf.World, rays: Rays, from_sensor: bool) -> None:
    """Angles are those of the curve's tangents, and powers the products of Fresnel's shares, reflections included."""
    if from_sensor:
        rays = from_pixels(world, range(98, 102), range(96, 104), 8, weight_cutoff=1e-4)
    seen = dict.fromkeys((lf.Event.TRANSMITTED, lf.Event.REFLECTED), 0)
    for path in range(len(rays)):
        steps = history(rays, path)
        for number, (before, step) in enumerate(itertools.pairwise(steps), start=1):
            if step.reflectance is None or step.transmittance is None:
                continue
            inside = step.in_gradient
            assert step.index == pytest.approx(index_at(step.position_mm) if inside else 1.0, rel=1e-12)
            n_i = index_at(step.position_mm) if before.in_gradient else 1.0
            share = step.transmittance if step.event == lf.Event.TRANSMITTED else step.reflectance
            assert step.power == pytest.approx(before.power * share * step.roulette, rel=1e-9)
            assert step.roulette == pytest.approx(1.0, rel=1e-9) or step.power < 1e-3 * steps[0].power
            seen[step.event] += 1
            if step.event == lf.Event.TRANSMITTED and not inside and number < len(steps) - 1:
                away = steps[number + 1].position_mm - step.position_mm
                sine = np.linalg.norm(away[:2]) / np.linalg.norm(away)
                assert n_i * np.sin(np.deg2rad(step.incidence_deg)) == pytest.approx(sine, abs=1e-9)
    assert min(seen.values()) > 20


def test_a_printed_history_names_the_index(rays: Rays) -> None:
    steps = history(rays, int(image_path(rays)[0]))
    assert steps[1].in_gradient
    assert f"n = {steps[1].index:.6g}" in lines(steps, rays.unit)[2]
    assert steps[2].medium == "air"


def test_a_layout_draws_curves() -> None:
    drawn = layout(rod())
    (glass,) = drawn.glass
    assert glass.is_gradient
    ray = drawn.bundles[0].rays[-1]
    assert len(ray.line) > len(ray.points) + 6
    inside = ray.line[(ray.line[:, 2] > 0.0) & (ray.line[:, 2] < LENGTH_MM)]
    before = ray.points[1] - ray.points[0]
    expected = closed_form(ray.points[1], before[:2] / np.linalg.norm(before), inside[:, 2])
    np.testing.assert_allclose(inside[:, :2], expected, rtol=0.0, atol=1e-8)


def test_descriptions_state_the_gradient(world: lf.World) -> None:
    facts = dict(describe(world, "lens[0]"))
    assert "radial_n2" in facts["gradient-index glass"]
    rim = N0 * np.sqrt(1.0 - (G * 1.5) ** 2)
    expected = f"1.6, front vertex; 1.6, rear vertex; {rim:.6g}, 1.5 mm from the axis in y"
    assert facts["index at 550 nm"] == expected
    assert "1 element, 1 of gradient-index glass" in dict(key_figures(world))["lens"]


def test_segments_in_homogeneous_glass_stay_straight() -> None:
    """Of a doublet, the part of gradient glass alone is curved, for light that is reflected between the two as well."""
    front = {"stop": True, "thickness_mm": 5.0, "semi_diameter_mm": 1.5, "index": 1.5, "radius_mm": 20.0}
    rod_ = {"thickness_mm": 10.0, "semi_diameter_mm": 2.0,
            "gradient": {"kind": "axial", "index": 1.7, "coefficients": [-0.01]}}  # fmt: skip
    scene = rod().changed({"camera.lens.surfaces": [front, rod_, {"semi_diameter_mm": 2.5}]})
    rays = from_field_point(lf.build(scene), POINT_MM, 20, aim="lens", weight_cutoff=1e-4)
    z = rays.position[:, 2]
    begins = np.flatnonzero((z[:-1] > 4.9) & (z[1:] > 4.9) & (z[:-1] < 15.1) & (z[1:] < 15.1))
    begins = begins[np.diff(rays.path)[begins] == 0]
    np.testing.assert_array_equal(rays.gradients.vertex, begins)
    assert (rays.gradients.space == 2).all()
    assert (np.diff(z)[begins] < 0.0).any()


ROD_G, ROD_MM = 0.9, 4.0
"""Gradient constant in 1/mm, and length of the rods of an array: more than half a pitch."""


def rods(side: str, walls: str = "absorb", g: float = ROD_G) -> lf.Scene:
    lens = {"surfaces": [{"paraxial": True, "focal_length_mm": 20.0, "stop": True, "semi_diameter_mm": 2.0}]}
    gradient = {"kind": "radial_n2", "index": N0, "coefficients": [-g * g]}
    mla = {"count": [8, 8], "pitch_mm": 0.4, "thickness_mm": ROD_MM, "distance_mm": 22.0, "curved_side": side,
           "walls": walls, "gradient": gradient}  # fmt: skip
    sensor = {"pixels": [64, 64], "pixel_mm": 0.05, "distance_mm": 2.0}
    camera = {"lens": lens, "mla": mla, "sensor": sensor}
    return lf.Scene.model_validate(
        {"schema_version": 1, "camera": camera, "transport": {"wavelengths_nm": [550.0]}}
    )  # fmt: skip


@pytest.mark.parametrize("side", ["lens", "sensor"])
def test_curves_in_the_rods_of_an_array_are_those_of_the_closed_form(side: str) -> None:
    """About the axis of each rod, with the index of its own field at the vertices."""
    world = lf.build(rods(side))
    rays = from_field_point(world, (0.3, -0.5, -200.0), 40, aim="lens", weight_cutoff=1e-2)
    mla = world.tables.mla
    flat = mla.lenslets.lattice.centres().reshape(-1, 2)
    centres = frames.points(world.tables.frames[mla.frame, WORLD_FRAME], np.pad(flat, ((0, 0), (0, 1))))[:, :2]
    found = 0
    for number, vertex in enumerate(rays.gradients.vertex[:60].tolist()):
        if rays.lenslet[vertex + 1] < 0 or rays.event[vertex] != lf.Event.TRANSMITTED:
            continue
        axis = np.append(centres[rays.lenslet[vertex]], 0.0)
        curve = rays.curves(np.array([vertex]))[vertex] - axis
        index = N0 * np.sqrt(1.0 - ROD_G**2 * (curve[0, :2] @ curve[0, :2]))
        momentum = index * rays.gradients.leaving[number][:2]
        beta = np.sqrt(index**2 - momentum @ momentum)
        turn = N0 * ROD_G * np.abs(curve[:, 2] - curve[0, 2])[:, None] / beta
        expected = curve[0, :2] * np.cos(turn) + momentum / (N0 * ROD_G) * np.sin(turn)
        np.testing.assert_allclose(curve[:, :2], expected, rtol=0.0, atol=1e-8)
        found += 1
    assert found > 20
    for path in range(0, len(rays), 7):
        for step in history(rays, path):
            if step.in_gradient and step.short in ("MLAc", "MLAb"):
                off = step.position_mm[:2] - centres[np.argmin(np.linalg.norm(centres - step.position_mm[:2], axis=1))]
                assert step.index == pytest.approx(N0 * np.sqrt(1.0 - ROD_G**2 * (off @ off)), rel=1e-12)


def test_a_curve_goes_on_behind_a_clear_wall() -> None:
    """Towards the axis of the next rod; both pieces end on the recorded vertices."""
    world = lf.build(rods("lens", walls="clear", g=0.3))
    rays = from_field_point(world, (1.5, 0.5, -40.0), 80, aim="lens", weight_cutoff=1e-2)
    at, to = rays.lenslet[:-1], rays.lenslet[1:]
    crossing = np.flatnonzero((at >= 0) & (to >= 0) & (at != to) & np.isin(np.arange(len(at)), rays.gradients.vertex))
    assert len(crossing) > 0
    for vertex, curve in rays.curves(crossing).items():
        steps = np.linalg.norm(np.diff(curve, axis=0), axis=1)
        assert steps.max() < 1.01 * steps.min(), vertex
