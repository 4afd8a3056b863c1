"""Plates with lenslets on both faces, against traces written here, thick-lens formulas, and each other.

The truth knows nothing of folding, of cells' meshes, of mirrored frames or of the engines' steps: on each face it
samples the height of the ray over the whole array, finds where that changes its sign (Brent's method), and bends the
ray there by Snell's law.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.accuracy.analytic import Camera
from tests.instances import instances
from tests.validation.test_lenslet_profiles import PITCH_MM, SENSOR_MM, Face, bent, cell_samples, scene_of

POSITION_MM = 1e-9
COUNT = 60
LENS_TO_ARRAY_MM = 30.0


@dataclass(frozen=True)
class Side:
    """One face of the plate, in the frame whose z runs from its apexes into the glass."""

    face: Face
    layer: tuple[float, float]

    def step(self, p: np.ndarray, d: np.ndarray, index: float) -> Any:
        """Point, direction and share behind the face of a ray that comes to it; a word for one that does not pass."""
        inward = d[2] > 0.0
        ends = sorted((border - p[2]) / d[2] for border in self.layer)
        what, t, cell = self.face.crossing(p, d, max(ends[0], 0.0), ends[1])
        if what != "face":
            return what
        p = p + t * d
        next_ = bent(d, self.face.normal(cell, p[0], p[1]), *((1.0, index) if inward else (index, 1.0)))
        if next_ is None:
            return "total"
        d, share = next_
        if (d[2] > 0.0) != inward:
            return "turned"
        end = (self.layer[1 if inward else 0] - p[2]) / d[2]
        return "again" if self.face.crossing(p, d, 1e-7, end)[0] != "none" else (p, d, share)


@dataclass(frozen=True)
class Plate:
    """Both faces; z runs from the apexes of the lens's side to those of the sensor's, which are shifted against it."""

    lens: Side
    sensor: Side
    shift: np.ndarray
    thickness: float
    index: float

    def landing(self, p: np.ndarray, d: np.ndarray, behind: float) -> Any:
        """Point, direction and share at a distance behind the plate; a word for a ray that does not get there."""
        to_sensor, weight = d[2] > 0.0, 1.0
        for side in ("lens", "sensor") if to_sensor else ("sensor", "lens"):
            origin = np.zeros(3) if side == "lens" else np.array([*self.shift, self.thickness])
            turn = np.array([1.0, 1.0, 1.0 if side == "lens" else -1.0])
            passed = getattr(self, side).step((p - origin) * turn, d * turn, self.index)
            if isinstance(passed, str):
                return passed
            p, d, weight = passed[0] * turn + origin, passed[1] * turn, weight * passed[2]
        to = self.thickness + behind if to_sensor else -behind
        return p + (to - p[2]) / d[2] * d, d, weight


def side_of(face: Face) -> Side:
    heights = [face.sag(c, *p) for c in range(64) for p in cell_samples(face, c)]
    low, high = min(heights), max(heights)
    margin = 1e-3 + 0.05 * (high - low)
    return Side(face, (low - margin, high + margin))


def random_side(draw: np.random.Generator, layout: str, axis: str | None, types: int, plain: bool) -> Face:
    corner = 0.5 * PITCH_MM if axis else PITCH_MM / np.sqrt(3.0 if layout == "hexagonal" else 2.0)
    radius, conic, terms = [], [], []
    for _ in range(types):
        r = corner * draw.uniform(1.3, 4.0) * draw.choice([1.0, 1.0, -1.0])
        wave = np.zeros(0) if plain else draw.uniform(-1.0, 1.0, size=2)
        radius.append(r)
        conic.append(0.0 if plain else draw.uniform(-4.0, 0.3))
        terms.append(tuple(w * 0.25 * corner**2 / abs(r) / corner ** (2 * j + 4) for j, w in enumerate(wave)))
    return Face(layout, tuple(radius), tuple(conic), tuple(terms), axis)


def random_plate(number: int) -> tuple[lf.Scene, Plate]:
    """Spheres, aspheres, crossed and parallel cylinders, both layouts, types, both signs, both sides, with decentre."""
    draw = np.random.default_rng([number, 51])
    layout = "hexagonal" if number % 3 == 1 else "square"
    axes = (None, None)
    if number % 3 == 2:
        axes = (("x", "y"), ("y", "x"), ("y", "y"), (None, "x"))[number // 3 % 4]
    types = 1 if number % 4 != 3 else 3 if layout == "hexagonal" else 2
    curved = random_side(draw, layout, axes[0], types, plain=number % 2 == 0)
    back = random_side(draw, layout, axes[1], 1, plain=number % 4 in (0, 3))
    shift = draw.uniform(-0.4, 0.4, size=2) * PITCH_MM if number % 5 else np.zeros(2)
    sides = side_of(curved), side_of(back)
    thickness = 1.05 * sum(max(0.0, side.layer[1]) for side in sides) + draw.uniform(0.0, 0.3)
    index = draw.uniform(1.3, 1.9)
    looks = "sensor" if number // 2 % 2 else "lens"
    scene = scene_of(
        looks, layout=layout, radius_mm=curved.radius, conic=curved.conic, asphere_mm=curved.terms,
        cylinder_axis=curved.axis, index=index, thickness_mm=thickness,
        back=lf.BackFace(
            radius_mm=back.radius[0], conic=back.conic[0], asphere_mm=back.terms[0], cylinder_axis=back.axis,
            decenter_mm=tuple(shift),
        ),
    )  # fmt: skip
    if looks == "lens":
        return scene, Plate(*sides, shift, thickness, index)
    return scene, Plate(sides[1], sides[0], -shift, thickness, index)


MIXED = [3, 6, 7, 10]
"""Plates with spheres on one face alone, which compile kernels of their own; others have spheres on both or on none."""


def starts(
    plate: Plate, draw: np.random.Generator, to_sensor: bool, angles_deg: tuple[float, float] = (0.0, 30.0)
) -> tuple[np.ndarray, np.ndarray]:
    """Rays close before either side, in the plate's frame."""
    at = np.column_stack([draw.uniform(-2.0, 2.0, size=(COUNT, 2)) * PITCH_MM, np.zeros(COUNT)])
    at[:, 2] = 0.0 if to_sensor else plate.thickness
    angle, turn = np.deg2rad(draw.uniform(*angles_deg, COUNT)), draw.uniform(0.0, 2.0 * np.pi, COUNT)
    d = np.column_stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])
    d[:, 2] *= 1.0 if to_sensor else -1.0
    return at - 0.5 * d, d


def origin_of(scene: lf.Scene, plate: Plate) -> np.ndarray:
    """Place of the plate's frame in the camera: the curved face is the one that stands where the scene puts it."""
    z = scene.camera.lens.vertices_mm[-1] + LENS_TO_ARRAY_MM
    shift = np.zeros(2) if scene.camera.mla.curved_side == "lens" else -plate.shift
    return np.array([*shift, z])


@pytest.mark.parametrize("number", instances(range(12), long=MIXED))
def test_rays_land_where_an_independent_trace_lands_them(number):
    scene, plate = random_plate(number)
    world = lf.build(scene, aimed=False)
    draw = np.random.default_rng([number, 52])
    at = origin_of(scene, plate)
    o, d = starts(plate, draw, to_sensor=True)
    expected = [plate.landing(p, q, SENSOR_MM) for p, q in zip(o, d, strict=True)]
    arrives = np.array([not isinstance(e, str) for e in expected])
    assert arrives.sum() > 0.6 * COUNT
    truth = np.array([e[0] for e in expected if not isinstance(e, str)]) + at
    weight = np.array([e[2] for e in expected if not isinstance(e, str)])
    for engine in ("mesh", "sequential"):
        # Of light that is reflected totally, the mesh engine follows what may come back by a second total reflection.
        ends = ("wall", "beside") if engine == "mesh" else ("wall", "beside", "total", "turned", "again")
        lost = np.array([e in ends for e in expected])
        paths = lf.trace(world, o + at, d, split="transmit", engine=engine)
        on = paths.status == lf.Status.SENSOR
        found, weights = np.full((COUNT, 3), np.nan), np.full(COUNT, np.nan)
        found[paths.source[on]], weights[paths.source[on]] = paths.position[on], paths.weight[on]
        np.testing.assert_allclose(found[arrives], truth, rtol=0, atol=POSITION_MM)
        np.testing.assert_allclose(weights[arrives], weight, rtol=1e-9)
        assert np.isnan(weights[lost]).all()


@pytest.mark.parametrize("layout", ["square", "hexagonal"])
@pytest.mark.parametrize("steep", [1.02, 1.5])
def test_steep_faces_that_nearly_touch_at_their_corners(layout, steep):
    corner = PITCH_MM / np.sqrt(3.0 if layout == "hexagonal" else 2.0)
    radius = steep * corner
    face = Face(layout, (radius,), (0.0,), ((),), None)
    thickness = 2.0 * (radius - np.sqrt(radius**2 - corner**2)) * (1.0 + 1e-9)
    scene = scene_of(
        layout=layout, radius_mm=(radius,), thickness_mm=thickness, index=1.5, back=lf.BackFace(radius_mm=radius)
    )  # fmt: skip
    plate = Plate(side_of(face), side_of(face), np.zeros(2), thickness, 1.5)
    o, d = starts(plate, np.random.default_rng(55), to_sensor=True)
    at = origin_of(scene, plate)
    expected = [plate.landing(p, q, SENSOR_MM) for p, q in zip(o, d, strict=True)]
    arrives = np.array([not isinstance(e, str) for e in expected])
    assert arrives.sum() > 15
    truth = np.array([e[0] for e in expected if not isinstance(e, str)]) + at
    world = lf.build(scene, aimed=False)
    for engine in ("mesh", "sequential"):
        paths = lf.trace(world, o + at, d, split="transmit", engine=engine)
        on = paths.status == lf.Status.SENSOR
        found = np.full((COUNT, 3), np.nan)
        found[paths.source[on]] = paths.position[on]
        np.testing.assert_allclose(found[arrives], truth, rtol=0, atol=POSITION_MM)


@pytest.mark.parametrize("number", instances(range(12), long=MIXED))
def test_rays_from_the_sensor_leave_the_plate_as_an_independent_trace_lets_them(number):
    scene, plate = random_plate(number)
    world = lf.build(scene, aimed=False)
    at = origin_of(scene, plate)
    # Steep enough for most of them to miss the lens, and to end on its mount on a straight line from the plate.
    o, d = starts(plate, np.random.default_rng([number, 53]), to_sensor=False, angles_deg=(15.0, 32.0))
    expected = [plate.landing(p, q, LENS_TO_ARRAY_MM - 2.0) for p, q in zip(o, d, strict=True)]
    beside = np.array([not isinstance(e, str) and np.hypot(*(e[0][:2] + at[:2])) > 7.0 for e in expected])
    assert beside.sum() > 0.25 * COUNT
    truth = np.array([e[0] for e, b in zip(expected, beside, strict=True) if b]) + at
    way = np.array([e[1] for e, b in zip(expected, beside, strict=True) if b])
    weight = np.array([e[2] for e, b in zip(expected, beside, strict=True) if b])
    for engine in ("mesh", "sequential"):
        paths = lf.trace(world, o + at, d, split="transmit", engine=engine)
        found, weights = np.full((COUNT, 3), np.nan), np.full(COUNT, np.nan)
        directions = np.full((COUNT, 3), np.nan)
        found[paths.source], weights[paths.source] = paths.position, paths.weight
        directions[paths.source] = paths.direction
        t = ((found[beside] - truth) * way).sum(axis=1)
        np.testing.assert_allclose(found[beside], truth + t[:, None] * way, rtol=0, atol=POSITION_MM)
        np.testing.assert_allclose(directions[beside], way, rtol=0, atol=1e-10)
        np.testing.assert_allclose(weights[beside], weight, rtol=1e-9)


def focal_point(section: str, first: float, second: float, thickness: float, index: float) -> float:
    """Distance of the paraxial focus behind a plate, by the thick-lens formula as a chain of two refractions.

    A cylinder bends rays in one section only; the radii are those of `section`, inf where the face is flat there.
    """
    vergence = (index - 1.0) / first
    vergence /= 1.0 - thickness / index * vergence
    return 1.0 / (vergence + (index - 1.0) / second)


@pytest.mark.parametrize("engine", ["mesh", "sequential"])
@pytest.mark.parametrize("looks", ["lens", "sensor"])
@pytest.mark.parametrize(
    ("axes", "radii", "thickness"),
    [((None, None), (0.4, 0.5), 0.3), ((None, None), (0.4, -0.9), 0.25), (("x", "y"), (0.25, 0.15), 0.3),
     (("y", "x"), (0.3, 0.4), 0.2), (("y", "y"), (0.5, 0.4), 0.3)],
)  # fmt: skip
def test_collimated_light_crosses_the_axis_where_the_thick_lens_formula_says(axes, radii, thickness, looks, engine):
    index = 1.5
    scene = scene_of(
        looks, radius_mm=(radii[0],), cylinder_axis=axes[0], thickness_mm=thickness, index=index,
        back=lf.BackFace(radius_mm=radii[1], cylinder_axis=axes[1]),
    )  # fmt: skip
    world = lf.build(scene, aimed=False)
    z = scene.camera.lens.vertices_mm[-1] + LENS_TO_ARRAY_MM
    # Close to the axis of the lenslet in column 4, row 4, where third order is far below the tolerance.
    off, centre = 1e-5 * PITCH_MM, 0.5 * PITCH_MM
    o = np.array([[centre + off, centre, z - 0.1], [centre, centre + off, z - 0.1]])
    paths = lf.trace(world, o, np.array([[0.0, 0.0, 1.0]] * 2), split="transmit", engine=engine)
    assert (paths.status == lf.Status.SENSOR).all()
    for number, section in enumerate("xy"):
        bends = [np.inf if axis == section else radius for axis, radius in zip(axes, radii, strict=True)]
        first, second = bends if looks == "lens" else bends[::-1]
        ray = int(np.flatnonzero(paths.source == number)[0])
        across, d = paths.position[ray, number] - centre, paths.direction[ray]
        if np.isinf(first) and np.isinf(second):
            assert abs(d[number]) < 1e-14
            continue
        crosses = paths.position[ray, 2] - across / d[number] * d[2] - z - thickness
        expected = focal_point(section, first, second, thickness, index)
        assert crosses == pytest.approx(expected, rel=1e-6)
        facts = {at.section: at for at in lf.first_order(scene).lenslet_sections}
        assert facts.get(section, facts.get("")).focus_behind_mm == pytest.approx(expected, rel=1e-12)


def test_the_sensor_of_a_scene_without_distance_stands_in_that_focus():
    scene = scene_of(radius_mm=(0.4,), back=lf.BackFace(radius_mm=0.5)).changed({"camera.sensor.distance_mm": None})
    behind = lf.solved(scene).camera.sensor.distance_mm
    assert behind == pytest.approx(focal_point("x", 0.4, 0.5, 0.3, 1.5), rel=1e-12)


def flat_back(radius_mm: float) -> lf.Scene:
    return scene_of(back=lf.BackFace(radius_mm=radius_mm)).changed(
        {
            "camera.sensor.pixels": [16, 16], "camera.sensor.pixel_mm": 0.05, "camera.sensor.distance_mm": 0.3,
            "transport": {"samples": 16, "replicates": 2},
            "targets": [
                {
                    "shape": {"kind": "plane", "width_mm": 400.0, "height_mm": 400.0},
                    "position_mm": [0.0, 0.0, -500.0],
                    "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
                }
            ],
        }
    )  # fmt: skip


def test_a_back_face_without_curvature_is_the_flat_one_to_the_last_bit():
    plain = flat_back(np.inf).changed({"camera.mla.back": None})
    np.testing.assert_array_equal(lf.render(flat_back(np.inf)).mean, lf.render(plain).mean)


def test_a_face_that_becomes_flat_gives_the_picture_of_the_flat_one():
    """Rays of both land in the same place, and carry the same light, to rounding of a radius of 10 km."""
    draw = np.random.default_rng(7)
    at = np.column_stack([draw.uniform(-2.0, 2.0, size=(200, 2)) * PITCH_MM, np.zeros(200)])
    angle, turn = np.deg2rad(draw.uniform(0.0, 25.0, 200)), draw.uniform(0.0, 2.0 * np.pi, 200)
    d = np.column_stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])
    found = []
    for back in (lf.BackFace(radius_mm=1e10), None):
        scene = scene_of(back=back)
        z = scene.camera.lens.vertices_mm[-1] + LENS_TO_ARRAY_MM
        world = lf.build(scene, aimed=False)
        for engine in ("mesh", "sequential"):
            paths = lf.trace(world, at - 0.5 * d + [0.0, 0.0, z], d, split="transmit", engine=engine)
            on = paths.status == lf.Status.SENSOR
            order = np.argsort(paths.source[on], kind="stable")
            found.append((paths.source[on][order], paths.position[on][order], paths.weight[on][order]))
    for source, position, weight in found[1:]:
        np.testing.assert_array_equal(source, found[0][0])
        np.testing.assert_allclose(position, found[0][1], rtol=0, atol=1e-9)
        np.testing.assert_allclose(weight, found[0][2], rtol=1e-9)


CAMERA = {
    "focus_mm": 500.0,
    "lens": {
        "surfaces": [
            {"radius_mm": 29.0, "thickness_mm": 4.0, "index": 1.6, "semi_diameter_mm": 8.0},
            {"radius_mm": -60.0, "thickness_mm": 1.0, "semi_diameter_mm": 8.0},
            {"stop": True, "thickness_mm": 0.0, "semi_diameter_mm": 4.0},
        ]
    },
    "mla": {
        "count": [8, 8], "pitch_mm": 0.125, "radius_mm": 0.5, "index": 1.5, "thickness_mm": 0.3, "distance_mm": 30.0,
        "back": {"radius_mm": 0.5},
    },
    "sensor": {"pixels": [40, 40], "pixel_mm": 0.025},
}  # fmt: skip
GLOW = {
    "shape": {"kind": "plane", "width_mm": 200.0, "height_mm": 200.0}, "position_mm": [0.0, 0.0, -500.0],
    "material": {"radiance_w_m2_sr": 1.0, "reflectance": 0.3},
}  # fmt: skip


def glowing(**transport: Any) -> lf.Scene:
    settings = {"samples": 16, "replicates": 2, "split": "both", "engine": "mesh", **transport}
    return lf.Scene(camera=CAMERA, targets=[GLOW], transport=settings)


@pytest.mark.parametrize("method", ["adjoint", "forward"])
def test_energy_closes_with_all_reflections(method):
    ledger = lf.render(glowing(method=method)).ledger
    assert abs(ledger.imbalance) <= 1e-12
    assert ledger.lost_share < 1e-7
    assert ledger.absorbed["mla mount"] > 0.0


def test_all_reflections_are_there_and_named_after_their_faces():
    world = lf.build(glowing(), aimed=False)
    z = world.scene.camera.lens.vertices_mm[-1] + LENS_TO_ARRAY_MM
    o, d = np.array([[0.07, 0.05, z - 1.0]]), np.array([[0.0, 0.0, 1.0]])
    whole = lf.trace(world, o, d, split="both", weight_cutoff=0.0, max_events=12, record=True)
    names = {vertex.surface for packet in range(len(whole)) for vertex in whole.vertices(packet)}
    assert {"mla curved face", "mla back face"} <= names
    assert "mla flat face" not in names


def test_the_mesh_of_the_plate_is_closed_and_holds_its_glass():
    """Of caps over squares, by quadrature of the sphere's sag; facets of chords leave a little of it out."""
    scene = glowing()
    mesh = lf.build(scene, aimed=False).mesh("mla")
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    u = (np.arange(400) + 0.5) / 400 * PITCH_MM - 0.5 * PITCH_MM
    r2 = u[:, None] ** 2 + u**2
    mean_sag = (r2 / (0.5 + np.sqrt(0.25 - r2))).mean()
    assert 0.9975 < mesh.volume / (0.3 - 2.0 * mean_sag) < 1.0
    aside = scene.changed({"camera.mla.back": {"radius_mm": 0.5, "decenter_mm": [0.02, 0.03]}})
    leaning = lf.build(aside, aimed=False).mesh("mla")
    np.testing.assert_allclose(leaning.bounds[1, :2] - mesh.bounds[1, :2], [0.02, 0.03], atol=1e-12)


@pytest.mark.parametrize("number", [0, 2, 4, 8])
def test_the_truth_of_the_accuracy_command_is_the_same(number):
    scene, _ = random_plate(number)
    world = lf.build(scene, aimed=False)
    draw = np.random.default_rng([number, 54])
    # Close to the axis, so that the lens sends them onto the array, which is 1 mm wide.
    o = np.column_stack([draw.uniform(-0.8, 0.8, size=(200, 2)), np.full(200, -1.0)])
    d = np.column_stack([draw.uniform(-0.005, 0.005, size=(200, 2)), np.ones(200)])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    truth = Camera.of(scene, 587.6).land(o, d)
    paths = lf.trace(world, o, d, split="transmit", engine="sequential")
    on = paths.status == lf.Status.SENSOR
    both = truth.arrives[paths.source[on]]
    assert both.sum() > 60
    np.testing.assert_allclose(
        paths.position[on][both][:, :2], truth.position[paths.source[on][both]], rtol=0, atol=1e-9
    )


def test_decoding_refuses_the_plate_in_one_line():
    with pytest.raises(lf.LfmeshError, match=r"camera\.mla\.back: arrays with lenslets on both faces are not decoded"):
        lf.RayModel.of(lf.solved(glowing()))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"camera.mla.back.radius_mm": 0.05}, "camera.mla.back.radius_mm = 0.05: the lenslets end 0.05 mm"),
        (
            {"camera.mla.back.radius_mm": 0.1, "camera.mla.radius_mm": 0.09, "camera.mla.thickness_mm": 0.1},
            "so they meet inside the plate: give thickness_mm",
        ),
        ({"camera.mla.radius_mm": None, "camera.mla.focal_length_mm": 0.5}, "mla.focal_length_mm = .0.5.: with camera"),
        (
            {"camera.mla.back.cylinder_axis": "x", "camera.mla.layout": "hexagonal"},
            'camera.mla.back.cylinder_axis = "x": cylinders need layout = "square"',
        ),
        ({"camera.mla.back.decenter_mm": [0.1, 0.0]}, "camera.mla.back.decenter_mm = .0.1, 0.0.: must be at mo"),
        ({"camera.mla.back.asphere_mm": [-1e4]}, "camera.mla.back.radius_mm = 0.5: the face rises up to"),
        ({"camera.mla.back.radius_mm": 0}, "camera.mla.back.radius_mm = 0: must be a number other than 0"),
        ({"camera.mla.back.radius_mm": float("nan")}, "camera.mla.back.radius_mm"),
    ],
)
def test_what_cannot_be_a_plate_is_refused_in_one_line(changes, words):
    with pytest.raises(lf.SceneError, match=words) as caught:
        glowing().changed(changes)
    assert len(str(caught.value).splitlines()) == 1


def test_form_errors_that_let_the_faces_meet_are_refused():
    thin = {"camera.mla.thickness_mm": 0.0161, "camera.mla.form": {"decenter_mm": 0.01, "radius_error": 0.05}}
    with pytest.raises(lf.SceneError, match="would meet in the plate"):
        lf.build(glowing().changed(thin), aimed=False)
