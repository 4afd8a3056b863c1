"""Lenslets that are no spheres: conics, even aspheres and cylinders, against traces written here and closed forms.

The truth knows nothing of folding, of cells' meshes or of the engines' steps: it samples the height of the ray over the
whole array's face, finds where that changes its sign (Brent's method), and bends the ray there by Snell's law.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import lfmesh as lf
from tests.validation.test_folded_array import (
    Whole,
    array_frame,
    assert_every_packet_agrees,
    cell_centres,
)

PITCH_MM = 0.125
SENSOR_MM = 2.0
SAMPLES = 1500
POSITION_MM = 1e-9


@cache
def cells_of(layout: str) -> tuple[np.ndarray, np.ndarray]:
    """Centres of the 64 cells, row by row, and the types of their lenslets."""
    return cell_centres(layout, PITCH_MM)


@dataclass(frozen=True)
class Face:
    """The curved face of an array of 8 × 8 lenslets, in the frame whose z runs into the glass."""

    layout: str
    radius: tuple[float, ...]
    conic: tuple[float, ...]
    terms: tuple[tuple[float, ...], ...]
    axis: str | None

    def cell(self, x: float, y: float) -> int:
        centre = cells_of(self.layout)[0]
        return int(np.argmin((centre[:, 0] - x) ** 2 + (centre[:, 1] - y) ** 2))

    def kind(self, cell: int) -> int:
        if len(self.radius) == 1:
            return 0
        if self.axis is not None:
            return (cell % 8 if self.axis == "y" else cell // 8) % len(self.radius)
        return int(cells_of(self.layout)[1][cell])

    def local(self, cell: int, x: Any, y: Any) -> tuple[Any, Any]:
        centre = cells_of(self.layout)[0][cell]
        return (0.0 if self.axis == "x" else x - centre[0]), (0.0 if self.axis == "y" else y - centre[1])

    def sag(self, cell: int, x: Any, y: Any) -> Any:
        u, v = self.local(cell, x, y)
        kind = self.kind(cell)
        r2, r, k = u * u + v * v, self.radius[kind], self.conic[kind]
        z = r2 / (r * (1.0 + np.sqrt(1.0 - (1.0 + k) * r2 / r**2)))
        return z + sum(a * r2 ** (j + 2) for j, a in enumerate(self.terms[kind]))

    def normal(self, cell: int, x: float, y: float) -> np.ndarray:
        # The derivative of the sag by u, written out by powers of r.
        u, v = self.local(cell, x, y)
        kind = self.kind(cell)
        r2, r, k = u * u + v * v, self.radius[kind], self.conic[kind]
        rate = 1.0 / (r * np.sqrt(1.0 - (1.0 + k) * r2 / r**2))
        rate += sum((2 * j + 4) * a * r2 ** (j + 1) for j, a in enumerate(self.terms[kind]))
        n = np.array([-rate * u, -rate * v, 1.0])
        return n / np.linalg.norm(n)

    def crossing(self, p: np.ndarray, d: np.ndarray, begin: float, end: float) -> tuple[str, float, int]:
        """The first change of sides between two distances: "none", "face", "wall", or "beside" the array."""
        t = np.linspace(begin, end, SAMPLES)
        centre = cells_of(self.layout)[0]
        x, y, z = (p[i] + t * d[i] for i in range(3))
        near = ((centre[:, 0, None] - x) ** 2 + (centre[:, 1, None] - y) ** 2).argmin(axis=0)
        apothem = np.abs(np.stack([x - centre[near, 0], y - centre[near, 1]]))
        out = apothem.max(axis=0) > 0.75 * PITCH_MM
        height = np.empty(SAMPLES)
        for cell in np.unique(near):
            of = near == cell
            with np.errstate(invalid="ignore"):
                height[of] = z[of] - self.sag(cell, x[of], y[of])
        changes = np.flatnonzero((np.sign(height[1:]) != np.sign(height[:-1])) & np.isfinite(height[1:]))
        if out.any() and (not len(changes) or np.argmax(out) <= changes[0] + 1):
            return "beside", 0.0, -1
        if not len(changes):
            return "none", 0.0, -1
        i = changes[0]
        for cell in dict.fromkeys([int(near[i]), int(near[i + 1])]):

            def over(s: float, cell: int = cell) -> float:
                return float(p[2] + s * d[2] - self.sag(cell, p[0] + s * d[0], p[1] + s * d[1]))

            if np.sign(over(t[i])) != np.sign(over(t[i + 1])):
                s = brentq(over, t[i], t[i + 1], xtol=1e-15, rtol=1e-15)
                if self.cell(p[0] + s * d[0], p[1] + s * d[1]) == cell:
                    return "face", s, cell
        return "wall", 0.0, -1


def bent(d: np.ndarray, n: np.ndarray, before: float, after: float) -> tuple[np.ndarray, float] | None:
    """Direction and transmitted share behind an interface; None under total reflection."""
    n = n if n @ d > 0.0 else -n
    tangential = before / after * (d - (n @ d) * n)
    rest = 1.0 - tangential @ tangential
    if rest <= 0.0:
        return None
    out = tangential + np.sqrt(rest) * n
    a, b = n @ d, n @ out
    s, q = (before * a - after * b) / (before * a + after * b), (after * a - before * b) / (after * a + before * b)
    return out, 1.0 - 0.5 * (s * s + q * q)


def landing(face: Face, layer: tuple[float, float], thickness: float, index: float, p: np.ndarray, d: np.ndarray):
    """Point and weight SENSOR_MM behind the array, in its frame; a word for a ray that does not get there."""
    inward = d[2] > 0.0
    weight = 1.0
    for step in ("curved", "flat") if inward else ("flat", "curved"):
        if step == "flat":
            t = (thickness - p[2]) / d[2]
            p = p + t * d
            next_ = bent(d, np.array([0.0, 0.0, 1.0]), *((index, 1.0) if inward else (1.0, index)))
        else:
            ends = sorted((border - p[2]) / d[2] for border in layer)
            what, t, cell = face.crossing(p, d, max(ends[0], 0.0), ends[1])
            if what != "face":
                return what
            p = p + t * d
            next_ = bent(d, face.normal(cell, p[0], p[1]), *((1.0, index) if inward else (index, 1.0)))
        if next_ is None:
            return "total"
        d, share = next_
        weight *= share
        if step == "curved":
            if (d[2] > 0.0) != inward:
                return "turned"
            # The ray may meet a neighbour, or its own lenslet again, before it leaves the layer.
            end = (layer[1 if inward else 0] - p[2]) / d[2]
            what, _, _ = face.crossing(p, d, 1e-7, end)
            if what != "none":
                return "again"
    to = thickness + SENSOR_MM if inward else -SENSOR_MM
    return p + (to - p[2]) / d[2] * d, weight


def scene_of(curved_side: str = "lens", surface: str = "exact", **mla: Any) -> lf.Scene:
    given = {
        "layout": "square", "count": (8, 8), "pitch_mm": PITCH_MM, "radius_mm": (0.25,), "index": 1.5,
        "thickness_mm": 0.3, "curved_side": curved_side, "distance_mm": 30.0, **mla,
    }  # fmt: skip
    lens = lf.Lens(
        surfaces=(
            lf.Surface(radius_mm=40.0, thickness_mm=4.0, index=1.5, semi_diameter_mm=6.0, stop=True),
            lf.Surface(radius_mm=-40.0, semi_diameter_mm=6.0),
        )
    )
    return lf.Scene(
        camera=lf.Camera(
            lens=lens, mla=lf.MicrolensArray(**given),
            sensor=lf.Sensor(pixels=(1000, 1000), pixel_mm=0.02, distance_mm=SENSOR_MM),
        ),
        transport=lf.Transport(surface=surface),
    )  # fmt: skip


def aimed_rays(scene: lf.Scene, draw: np.random.Generator, count: int, steepest_deg: float = 35.0):
    """Rays towards the array from the lens's side, in the world's frame."""
    apex_z, sign = array_frame(scene)
    thickness = scene.camera.mla.thickness_mm
    if sign < 0:
        apex_z = scene.camera.lens.vertices_mm[-1] + 30.0 + thickness
    z = apex_z if sign > 0 else apex_z - thickness
    at = np.column_stack([draw.uniform(-2.0 * PITCH_MM, 2.0 * PITCH_MM, size=(count, 2)), np.full(count, z)])
    angle = np.deg2rad(draw.uniform(0.0, steepest_deg, size=count))
    turn = draw.uniform(0.0, 2.0 * np.pi, size=count)
    d = np.column_stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])
    return at - 0.5 * d, d, apex_z, sign


def random_face(number: int) -> tuple[Face, float, float, str]:
    """A random array: face, thickness, index and curved side; every kind occurs among a few numbers."""
    draw = np.random.default_rng([number, 5])
    layout = "hexagonal" if number % 3 == 1 else "square"
    axis = ("y", "x")[number // 3 % 2] if number % 3 == 2 else None
    types = 1 + (number // 2) % 2 * (2 if layout == "hexagonal" else 1)
    corner = 0.5 * PITCH_MM if axis else PITCH_MM / np.sqrt(3.0 if layout == "hexagonal" else 2.0)
    radius, conic, terms = [], [], []
    for _ in range(types):
        r = corner * draw.uniform(1.3, 4.0) * draw.choice([1.0, 1.0, -1.0])
        k = draw.uniform(-4.0, 0.3)
        wave = draw.uniform(-1.0, 1.0, size=3)
        radius.append(r)
        conic.append(k)
        # Each term by itself makes up to an eighth of the sphere's sag at the corner, so that some faces turn back.
        terms.append(tuple(w * 0.25 * corner**2 / abs(r) / corner ** (2 * j + 4) for j, w in enumerate(wave)))
    side = "sensor" if number % 2 else "lens"
    return Face(layout, tuple(radius), tuple(conic), tuple(terms), axis), 0.3, draw.uniform(1.3, 1.9), side


def world_of(face: Face, thickness: float, index: float, side: str, surface: str = "exact") -> Any:
    return lf.build(
        scene_of(
            side, surface, layout=face.layout, radius_mm=face.radius, conic=face.conic, asphere_mm=face.terms,
            cylinder_axis=face.axis, index=index, thickness_mm=thickness,
        ),
        aimed=False,
    )  # fmt: skip


@pytest.mark.parametrize("number", range(10))
def test_rays_land_where_an_independent_trace_lands_them(number):
    face, thickness, index, side = random_face(number)
    world = world_of(face, thickness, index, side)
    heights = [face.sag(c, *p) for c in range(64) for p in cell_samples(face, c)]
    low, high = min(heights), max(heights)
    layer = (low - 1e-3 - 0.05 * (high - low), high + 1e-3 + 0.05 * (high - low))
    draw = np.random.default_rng([number, 6])
    count = 70
    o, d, apex_z, sign = aimed_rays(world.scene, draw, count)
    expected = [
        landing(face, layer, thickness, index, p, q)
        for p, q in zip((o - [0, 0, apex_z]) * [1, 1, sign], d * [1, 1, sign], strict=True)
    ]
    plain = np.array([not isinstance(e, str) for e in expected])
    assert plain.sum() > 0.8 * count
    truth = np.array([e[0] for e in expected if not isinstance(e, str)]) * [1, 1, sign] + [0, 0, apex_z]
    weight = np.array([e[1] for e in expected if not isinstance(e, str)])
    for engine in ("mesh", "sequential"):
        paths = lf.trace(world, o, d, split="transmit", engine=engine)
        on = paths.status == lf.Status.SENSOR
        found, weights = np.full((count, 3), np.nan), np.full(count, np.nan)
        found[paths.source[on]], weights[paths.source[on]] = paths.position[on], paths.weight[on]
        np.testing.assert_allclose(found[plain], truth, rtol=0, atol=POSITION_MM)
        np.testing.assert_allclose(weights[plain], weight, rtol=1e-9)
        refused = np.array([e in ("wall", "total", "beside") for e in expected])
        assert np.isnan(weights[refused]).all()


def cell_samples(face: Face, cell: int) -> np.ndarray:
    """Points that fill a cell up to its corners."""
    centre = cells_of(face.layout)[0][cell]
    turn = np.deg2rad(np.arange(30, 390, 60) if face.layout == "hexagonal" else np.arange(45, 405, 90))
    corner = PITCH_MM / np.sqrt(3.0 if face.layout == "hexagonal" else 2.0)
    way = corner * np.column_stack([np.cos(turn), np.sin(turn)])
    return centre + (np.linspace(0.0, 1.0, 40)[:, None, None] * way).reshape(-1, 2)


def whole_of_mesh(world: Any, smooth: bool) -> Whole:
    """The whole array from its own mesh, facet by facet, as the test of the folded array takes it."""
    mla = world.scene.camera.mla
    apex_z, sign = array_frame(world.scene)
    mesh = world.mesh("mla")
    corners = (np.asarray(mesh.vertices) - [0.0, 0.0, apex_z])[mesh.faces] * [1.0, 1.0, sign]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals *= sign / np.linalg.norm(normals, axis=1, keepdims=True)
    centre, _ = cell_centres(mla.layout, PITCH_MM)
    cell = np.argmin(np.linalg.norm(corners.mean(axis=1)[:, None, :2] - centre, axis=2), axis=1)
    order = np.argsort(cell, kind="stable")
    cell, corners, normals = cell[order], corners[order], normals[order]
    first = np.searchsorted(cell, np.arange(65))
    face = Face(mla.layout, mla.radius_mm, mla.conic, mla.asphere_mm, mla.cylinder_axis)
    exact = np.repeat(-normals[:, None], 3, axis=1)
    curved = np.flatnonzero(normals[:, 2] < -1e-9)
    for f in curved:
        for k in range(3):
            x, y, z = corners[f, k]
            # The world's rounding of the vertices is 7e-15 mm.
            assert abs(z - face.sag(cell[f], x, y)) < 1e-12
            if smooth:
                exact[f, k] = face.normal(cell[f], x, y)
    top = float(min(0.0, *corners[curved, :, 2].ravel()))
    nothing = np.zeros(64)
    return Whole(
        mla.layout == "hexagonal", PITCH_MM, centre, nothing, np.zeros((64, 2)), top, corners, normals, exact, first
    )


@pytest.mark.parametrize("from_lens", [True, False])
@pytest.mark.parametrize("number", [0, 1, 2, 3])
def test_the_folded_array_is_the_whole_mesh_whichever_way_rays_come(number, from_lens):
    face, thickness, _, side = random_face(number)
    surface = ("flat", "smooth")[number % 2]
    world = world_of(face, thickness, 1.5, side, surface)
    whole = whole_of_mesh(world, surface == "smooth")
    fates, _ = assert_every_packet_agrees(world, whole, "transmit", from_lens, number, 150)
    few, longest = assert_every_packet_agrees(world, whole, "both", from_lens, number + 9, 15)
    assert fates.sum() + few.sum() > 165
    assert longest >= 4


def focused(side: str, index: float, thickness: float, radius: float, sensor_mm: float, **mla: Any) -> Any:
    """A world whose sensor stands at a distance behind the array, for collimated light."""
    scene = scene_of(side, radius_mm=(radius,), index=index, thickness_mm=thickness, **mla)
    return lf.build(scene.changed({"camera.sensor.distance_mm": sensor_mm}), aimed=False)


def collimated(world: Any, cell: int, layout: str, draw: np.random.Generator, count: int, slope_y: float = 0.0):
    """Parallel rays that start close before the array, over most of one cell."""
    centre = cell_centres(layout, PITCH_MM)[0][cell]
    z = world.scene.camera.lens.vertices_mm[-1] + 30.0 - 0.02
    at = centre + draw.uniform(-0.33, 0.33, size=(count, 2)) * PITCH_MM
    d = np.broadcast_to(np.array([0.0, slope_y, 1.0]) / np.hypot(1.0, slope_y), (count, 3))
    return np.column_stack([at, np.full(count, z)]), d, centre


@pytest.mark.parametrize("engine", ["mesh", "sequential"])
@pytest.mark.parametrize("layout", ["square", "hexagonal"])
@pytest.mark.parametrize("index", [1.4, 1.8])
def test_hyperbolic_lenslets_focus_axial_light_from_their_glass_to_a_point(index, layout, engine):
    """Descartes: a hyperboloid of k = −n² towards the focus makes all ways from a plane wave in the glass equal."""
    radius = 0.14
    world = focused("sensor", index, 0.3, radius, radius / (index - 1.0), layout=layout, conic=(-(index**2),))
    o, d, centre = collimated(world, 27, layout, np.random.default_rng(3), 200)
    paths = lf.trace(world, o, d, split="transmit", engine=engine)
    assert (paths.status == lf.Status.SENSOR).all()
    assert len(paths) == 200
    np.testing.assert_allclose(paths.position[:, :2], np.broadcast_to(centre, (200, 2)), rtol=0, atol=2e-14)
    sphere = focused("sensor", index, 0.3, radius, radius / (index - 1.0), layout=layout)
    spread = lf.trace(sphere, o, d, split="transmit", engine=engine).position[:, :2] - centre
    assert np.abs(spread).max() > 1e-3


@pytest.mark.parametrize("engine", ["mesh", "sequential"])
def test_elliptical_lenslets_focus_axial_light_in_their_glass_to_a_point(engine):
    """The same for k = −1/n² towards the light: the focus n R / (n − 1) behind the apex, here on the flat face."""
    index, radius = 1.6, 0.15
    thickness = index * radius / (index - 1.0)
    world = focused("lens", index, thickness, radius, 1e-6, conic=(-1.0 / index**2,))
    o, d, centre = collimated(world, 35, "square", np.random.default_rng(4), 200)
    paths = lf.trace(world, o, d, split="transmit", engine=engine)
    assert len(paths) == 200
    # The sensor is a nanometre behind the focus; slopes behind the glass are below 1.
    np.testing.assert_allclose(paths.position[:, :2], np.broadcast_to(centre, (200, 2)), rtol=0, atol=1e-6)
    back = world.scene.camera.lens.vertices_mm[-1] + 30.0 + thickness
    at_focus = paths.position - (paths.position[:, 2:] - back) / paths.direction[:, 2:] * paths.direction
    np.testing.assert_allclose(at_focus[:, :2], np.broadcast_to(centre, (200, 2)), rtol=0, atol=2e-14)


@pytest.mark.parametrize("engine", ["mesh", "sequential"])
@pytest.mark.parametrize("axis", ["x", "y"])
def test_acylindrical_lenslets_focus_skew_light_to_a_line(axis, engine):
    """Across a cylinder, light inclined along it by γ in air sees n_γ = √(n² − sin² γ) / cos γ, in air 1.

    So the hyperbola of k = −n_γ² focuses it to a line, R / (n_γ − 1) behind the apexes, without any width.
    """
    index, radius, slope = 1.5, 0.14, 0.4
    sine2 = slope**2 / (1.0 + slope**2)
    seen = np.sqrt((index**2 - sine2) / (1.0 - sine2))
    world = focused("sensor", index, 0.3, radius, radius / (seen - 1.0), conic=(-(seen**2),), cylinder_axis=axis)
    o, d, centre = collimated(world, 27, "square", np.random.default_rng(5), 200, slope)
    if axis == "x":
        # The same light mirrored at the diagonal of the square array.
        o, d = o[:, [1, 0, 2]], d[:, [1, 0, 2]]
    across = 0 if axis == "y" else 1
    paths = lf.trace(world, o, d, split="transmit", engine=engine)
    assert len(paths) == 200
    np.testing.assert_allclose(paths.position[:, across], centre[0], rtol=0, atol=2e-14)
    # Along the line the light goes on as through a plane plate: parallel, at the slope it came with.
    along = paths.direction[:, 1 - across] / np.hypot(paths.direction[:, across], paths.direction[:, 2])
    np.testing.assert_allclose(along, slope, rtol=1e-13)
    assert np.ptp(paths.position[:, 1 - across]) > 0.4 * PITCH_MM


def test_a_lens_before_cylinders_lights_a_line_as_wide_as_the_formula_says():
    """Spherical cylinders: third-order longitudinal aberration of the plano-convex, flat side to the light."""
    index, radius = 1.5, 1.0
    f = radius / (index - 1.0)
    world = focused("sensor", index, 0.3, radius, f, cylinder_axis="y")
    o, d, centre = collimated(world, 27, "square", np.random.default_rng(6), 400)
    paths = lf.trace(world, o, d, split="transmit")
    h = o[paths.source, 0] - centre[0]
    # The exact ray: refracted at the height h on a circle, from the normal's angle there.
    normal = np.arcsin(h / radius)
    bend = np.arcsin(index * h / radius) - normal
    sag = radius - np.sqrt(radius**2 - h**2)
    truth = h - np.tan(bend) * (f + sag)
    np.testing.assert_allclose(paths.position[:, 0] - centre[0], truth, rtol=0, atol=2e-14)
    np.testing.assert_allclose(paths.position[:, 1], o[paths.source, 1], rtol=0, atol=2e-14)
    third_order = -(index**2) * h**3 / (2.0 * radius**2)
    np.testing.assert_allclose(truth, third_order, rtol=0.02, atol=1e-9)
