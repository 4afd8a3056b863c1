"""Rays through lenses with tilted and decentred elements against a trace written here, in extended precision.

The truth shares nothing with lfmesh: every surface is given by its vertex and three axes in the camera frame, turned by
rotations about x, y and z one after the other; spheres are centre and radius, aspheres are met by Newton's method.
"""

from dataclasses import dataclass

import numpy as np
import pytest

import lfmesh as lf

EXTENDED = np.longdouble
POSITION_MM = 1e-9
WEIGHT = 1e-12
RIM_MM = 1e-9
SENSOR_MM = 25.0
BEFORE_MM = -15.0


def turned(vector, tilt_deg):
    """A vector turned about x, then y, then z, each by the plane rotation of two coordinates."""
    v = [EXTENDED(c) for c in vector]
    for (i, j), angle in zip(((1, 2), (2, 0), (0, 1)), tilt_deg, strict=True):
        a = EXTENDED(angle) * np.arctan(EXTENDED(1)) / 45
        v[i], v[j] = v[i] * np.cos(a) - v[j] * np.sin(a), v[i] * np.sin(a) + v[j] * np.cos(a)
    return np.array(v, EXTENDED)


@dataclass
class Face:
    """A surface where it stands: its vertex and its axes, as rows, and the indices before and behind it."""

    vertex: np.ndarray
    axes: np.ndarray
    radius: float
    conic: float
    asphere: tuple
    aperture: float
    before: float
    behind: float

    def own(self, p, d):
        return (p - self.vertex) @ self.axes.T, d @ self.axes.T

    def meet(self, p, d, sense):
        """Points and unit normals along +axis (camera frame), and the distance of each point from the axis."""
        if self.conic or self.asphere:
            q, normal = self._by_newton(*self.own(p, d))
            return self.vertex + q @ self.axes, normal @ self.axes, np.hypot(q[:, 0], q[:, 1])
        axis = self.axes[2]
        if np.isinf(self.radius):
            t = ((self.vertex - p) @ axis) / (d @ axis)
            q, normal = p + t[:, None] * d, np.tile(axis, (len(p), 1))
        else:
            centre = self.vertex + EXTENDED(self.radius) * axis
            to_foot = np.sum((centre - p) * d, axis=1)
            foot = p + to_foot[:, None] * d - centre
            half_chord = np.sqrt(EXTENDED(self.radius) ** 2 - np.sum(foot**2, axis=1))
            q = p + (to_foot - sense * np.sign(self.radius) * half_chord)[:, None] * d
            normal = (centre - q) / EXTENDED(self.radius)
        off = q - self.vertex
        return q, normal, np.linalg.norm(off - (off @ axis)[:, None] * axis, axis=1)

    def _by_newton(self, p, d):
        c = EXTENDED(0) if np.isinf(self.radius) else 1 / EXTENDED(self.radius)

        def sag(r2):
            root = np.sqrt(1 - (1 + EXTENDED(self.conic)) * c * c * r2)
            z, half_slope = c * r2 / (1 + root), c / (2 * root)
            for power, a in enumerate(self.asphere, 2):
                z = z + EXTENDED(a) * r2**power
                half_slope = half_slope + power * EXTENDED(a) * r2 ** (power - 1)
            return z, half_slope

        t = -p[:, 2] / d[:, 2]
        for _ in range(40):
            q = p + t[:, None] * d
            z, half_slope = sag(q[:, 0] ** 2 + q[:, 1] ** 2)
            t = t - (q[:, 2] - z) / (d[:, 2] - 2 * half_slope * (q[:, 0] * d[:, 0] + q[:, 1] * d[:, 1]))
        q = p + t[:, None] * d
        half_slope = sag(q[:, 0] ** 2 + q[:, 1] ** 2)[1]
        normal = np.column_stack([-2 * half_slope * q[:, 0], -2 * half_slope * q[:, 1], np.ones(len(q), EXTENDED)])
        return q, normal / np.linalg.norm(normal, axis=1, keepdims=True)


def faces_of(surfaces, elements):
    """The truth's surfaces, from the plain tables of a prescription and of its elements."""
    z, index, faces = EXTENDED(0), 1.0, []
    places = []
    for s in surfaces:
        places.append(z)
        z = z + EXTENDED(s.get("thickness_mm", 0.0))
    for number, s in enumerate(surfaces):
        vertex, tilt = np.array([0, 0, places[number]], EXTENDED), (0.0, 0.0, 0.0)
        for element in elements:
            if number in element["surfaces"]:
                tilt = element["pose"].get("tilt_deg", (0, 0, 0))
                pivot = np.array([0, 0, places[element["surfaces"][0]]], EXTENDED)
                vertex = pivot + turned(vertex - pivot, tilt) + np.array(element["pose"].get("shift_mm", (0, 0, 0)))
        axes = np.array([turned(axis, tilt) for axis in np.eye(3)])
        behind = s.get("index", 1.0)
        radius = s.get("radius_mm", np.inf)
        faces.append(
            Face(vertex, axes, radius, s.get("conic", 0.0), tuple(s.get("asphere_mm", ())), s["semi_diameter_mm"],
                 index, behind)
        )  # fmt: skip
        index = behind
    return faces


@np.errstate(invalid="ignore")
def follow(faces, origins, directions, sense):
    """Image path: points at the last surface, directions, weights, what passes, and the least distance from a rim."""
    p, d = np.array(origins, EXTENDED), np.array(directions, EXTENDED)
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    weight, passes, from_rim = np.ones(len(p), EXTENDED), np.ones(len(p), bool), np.full(len(p), np.inf)
    for face in faces if sense > 0 else faces[::-1]:
        p, normal, off_axis = face.meet(p, d, sense)
        from_rim = np.fmin(from_rim, np.where(passes, np.abs(off_axis - face.aperture), np.inf).astype(float))
        passes &= off_axis <= face.aperture
        n_i, n_t = (EXTENDED(n) for n in ((face.before, face.behind) if sense > 0 else (face.behind, face.before)))
        normal = sense * normal
        cos_i = np.sum(d * normal, axis=1)
        along_surface = (n_i / n_t) * (d - cos_i[:, None] * normal)
        cos_t = np.sqrt(1 - np.sum(along_surface**2, axis=1))
        passes &= ~np.isnan(cos_t)
        t_s, t_p = 2 * n_i * cos_i / (n_i * cos_i + n_t * cos_t), 2 * n_i * cos_i / (n_t * cos_i + n_i * cos_t)
        weight = weight * (n_t * cos_t) / (n_i * cos_i) * (t_s**2 + t_p**2) / 2
        d = along_surface + cos_t[:, None] * normal
    return p, d, weight, passes, from_rim


def scene_of(surfaces, elements):
    return lf.Scene(
        camera={
            "lens": {"surfaces": surfaces, "elements": elements},
            "sensor": {"pixels": [4000, 4000], "pixel_mm": 0.02, "distance_mm": SENSOR_MM},
        }
    )


def rays_to(faces, count, draw, sense):
    """Rays from points of a plane before the lens (behind it: sense −1) to points of the first surface they meet."""
    first = faces[0] if sense > 0 else faces[-1]
    turn, r = draw.uniform(0, 2 * np.pi, count), 1.02 * first.aperture * np.sqrt(draw.uniform(size=count))
    target = first.vertex + np.outer(r * np.cos(turn), first.axes[0]) + np.outer(r * np.sin(turn), first.axes[1])
    target = target.astype(float)
    z = BEFORE_MM if sense > 0 else float(faces[-1].vertex[2]) + 0.8 * SENSOR_MM
    slope = draw.uniform(-0.25, 0.25, (count, 2))
    step = (target[:, 2] - z)[:, None]
    origins = np.column_stack([target[:, :2] - slope * step, np.full(count, z)])
    directions = np.column_stack([slope, np.ones(count)]) * sense
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def assert_both_engines_agree_with_the_truth(surfaces, elements, count=2000, seed=0, least=0.05):
    """Both ways, both engines: the same rays get through, at the same places, with the same weights."""
    draw = np.random.default_rng(seed)
    scene = scene_of(surfaces, elements)
    world = lf.build(scene)
    faces = faces_of(surfaces, elements)
    sensor_z = sum(s.get("thickness_mm", 0.0) for s in surfaces) + SENSOR_MM
    for sense in (1.0, -1.0):
        origins, directions = rays_to(faces, count, draw, sense)
        p, d, weight, passes, from_rim = follow(faces, origins, directions, sense)
        plane = sensor_z if sense > 0 else BEFORE_MM
        at_plane = p + ((plane - p[:, 2]) / d[:, 2])[:, None] * d
        clear = from_rim > RIM_MM
        assert (~clear).sum() <= 2
        found = {}
        for engine in ("mesh", "sequential"):
            paths = lf.trace(world, origins, directions, split="transmit", engine=engine)
            assert len(np.unique(paths.source)) == len(paths)
            arrived = np.isin(paths.body, ["sensor", "beside the sensor"])
            if sense < 0:
                arrived = (paths.status == lf.Status.ESCAPED) & (paths.weight < 1.0)
            got = np.zeros(count, bool)
            got[paths.source[arrived]] = True
            np.testing.assert_array_equal(got[clear], passes[clear])
            kept = np.flatnonzero(arrived & clear[paths.source])
            rays = paths.source[kept]
            place, ahead = paths.position[kept], paths.direction[kept]
            place = place + ((plane - place[:, 2]) / ahead[:, 2])[:, None] * ahead
            assert np.abs(place - at_plane[rays]).max(initial=0.0) < POSITION_MM
            assert np.abs(paths.weight[kept] - weight[rays]).max(initial=0.0) < WEIGHT
            assert np.abs(ahead - d[rays]).max(initial=0.0) < 1e-12
            found[engine] = rays, place, paths.weight[kept]
            assert len(rays) >= least * count
        (rays, place, share), (others, other_place, other_share) = found["mesh"], found["sequential"]
        np.testing.assert_array_equal(rays, others)
        assert np.abs(place - other_place).max(initial=0.0) < POSITION_MM
        assert np.abs(share - other_share).max(initial=0.0) < WEIGHT


def random_lens(draw):
    """Four to six surfaces of every kind with air or glass between them, and poses of random groups."""
    surfaces, in_glass = [], False
    count = int(draw.integers(4, 7))
    stop = int(draw.integers(0, count))
    for k in range(count):
        s = {"semi_diameter_mm": 5.0}
        if draw.random() < 0.85:
            s["radius_mm"] = float(draw.choice([-1, 1]) * draw.uniform(18.0, 90.0))
        kind = draw.integers(4)
        if kind == 1 and "radius_mm" in s:
            s["conic"] = float(draw.uniform(-2.0, 0.8))
        if kind == 2:
            s["asphere_mm"] = [float(draw.uniform(-2e-5, 2e-5)), float(draw.uniform(-2e-7, 2e-7))]
        if k == stop:
            s |= {"stop": True, "semi_diameter_mm": 4.0}
        last = k == count - 1
        in_glass = not last and (not in_glass or bool(draw.random() < 0.3))
        if in_glass:
            s["index"] = float(draw.uniform(1.4, 1.9))
        if not last:
            s["thickness_mm"] = float(draw.uniform(3.5, 5.0))
        surfaces.append(s)
    elements, first = [], 0
    while first < count:
        size = int(draw.integers(1, 4))
        if draw.random() < 0.7:
            numbers = list(range(first, min(first + size, count)))
            tilt, shift = [*draw.uniform(-4, 4, 2), draw.uniform(-180, 180)], [*draw.uniform(-0.4, 0.4, 3)]
            elements.append({"surfaces": numbers, "pose": {"tilt_deg": tilt, "shift_mm": shift}})
        first += size
    return surfaces, elements


SINGLET = [
    {"radius_mm": 30.0, "thickness_mm": 4.0, "index": 1.6, "semi_diameter_mm": 6.0},
    {"radius_mm": -40.0, "thickness_mm": 3.0, "semi_diameter_mm": 6.0},
    {"stop": True, "thickness_mm": 6.0, "semi_diameter_mm": 4.0},
    {"radius_mm": 60.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 6.0},
    {"radius_mm": -25.0, "thickness_mm": 2.0, "index": 1.7, "semi_diameter_mm": 6.0},
    {"radius_mm": -80.0, "semi_diameter_mm": 6.0},
]
"""A singlet, a pure stop, and a cemented doublet."""


@pytest.mark.parametrize("seed", range(8))
def test_random_lenses_with_random_poses(seed):
    draw = np.random.default_rng([7, seed])
    assert_both_engines_agree_with_the_truth(*random_lens(draw), seed=seed)


@pytest.mark.parametrize(
    "elements",
    [
        pytest.param([{"surfaces": [0, 1], "pose": {"tilt_deg": [2.0, -3.0, 0.0]}}], id="tilted singlet"),
        pytest.param([{"surfaces": [3, 4, 5], "pose": {"tilt_deg": [1.0, 2.0, 30.0], "shift_mm": [0.3, -0.2, 0.1]}}],
                     id="cemented group"),
        pytest.param([{"surfaces": [2], "pose": {"tilt_deg": [8.0, 0.0, 0.0], "shift_mm": [0.5, 0.0, 0.2]}}],
                     id="stop alone"),
        pytest.param([{"surfaces": [1, 2], "pose": {"tilt_deg": [3.0, 0.0, 0.0], "shift_mm": [0.5, 0.0, 0.2]}}],
                     id="stop in a group"),
        pytest.param([{"surfaces": [4], "pose": {"tilt_deg": [1.0, 0.0, 90.0]}}], id="cemented face alone"),
        pytest.param([{"surfaces": [1], "pose": {"tilt_deg": [0.0, 1.5, 0.0]}}], id="wedge"),
        pytest.param([{"surfaces": [0, 1], "pose": {"tilt_deg": [1e-12, 0.0, 0.0]}}], id="tiny tilt"),
        pytest.param([{"surfaces": [0], "pose": {"shift_mm": [0.0, 0.0, 0.5]}}], id="shift along the axis"),
        pytest.param([{"surfaces": [5], "pose": {"tilt_deg": [0.0, 0.0, 180.0]}}], id="half turn about the axis"),
        pytest.param([{"surfaces": list(range(6)), "pose": {"tilt_deg": [5.0, -5.0, 0.0], "shift_mm": [1.0, 0, 0]}}],
                     id="everything"),
    ],
)  # fmt: skip
def test_groups_of_every_kind(elements):
    assert_both_engines_agree_with_the_truth(SINGLET, elements)


def test_a_large_tilt():
    plate = [
        {"thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 6.0},
        {"thickness_mm": 14.0, "semi_diameter_mm": 6.0},
        {"radius_mm": 40.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 6.0, "stop": True},
        {"radius_mm": -40.0, "semi_diameter_mm": 6.0},
    ]
    elements = [{"surfaces": [0, 1], "pose": {"tilt_deg": [40.0, 0.0, 0.0]}}]
    assert_both_engines_agree_with_the_truth(plate, elements)


def random_rays(count, seed, z=-30.0, wide=6.0):
    draw = np.random.default_rng(seed)
    origins = np.column_stack([draw.uniform(-wide, wide, (count, 2)), np.full(count, z)])
    return origins, np.column_stack([draw.uniform(-0.15, 0.15, (count, 2)), np.ones(count)])


@pytest.mark.parametrize("engine", ["mesh", "sequential"])
def test_posing_all_elements_is_posing_the_camera_against_its_sensor(engine):
    """Lens and stop posed as one body, and the same pose of the camera with its sensor put back where it was."""
    angle, shift = 4.0, np.array([0.7, -0.5, 0.3])
    everything = [{"surfaces": list(range(6)), "pose": {"tilt_deg": [angle, 0.0, 0.0], "shift_mm": [*shift]}}]
    one = scene_of(SINGLET, everything)
    centre = np.array([0.0, 0.0, sum(s.get("thickness_mm", 0.0) for s in SINGLET) + SENSOR_MM])
    back = np.array([turned(axis, (-angle, 0, 0)) for axis in np.eye(3)], float).T @ (centre - shift) - centre
    other = scene_of(SINGLET, []).changed(
        {
            "camera.pose": {"tilt_deg": [angle, 0.0, 0.0], "shift_mm": [*shift]},
            "camera.sensor.pose": {"tilt_deg": [-angle, 0.0, 0.0], "shift_mm": [*back]},
        }
    )
    rays = random_rays(4000, 3)
    a, b = (lf.trace(lf.build(s), *rays, split="transmit", engine=engine) for s in (one, other))
    on_sensor = [np.isin(paths.body, ["sensor", "beside the sensor"]) for paths in (a, b)]
    assert on_sensor[0].sum() > 1000
    np.testing.assert_array_equal(a.source[on_sensor[0]], b.source[on_sensor[1]])
    assert np.abs(a.position[on_sensor[0]] - b.position[on_sensor[1]]).max() < POSITION_MM
    assert np.abs(a.direction[on_sensor[0]] - b.direction[on_sensor[1]]).max() < 1e-12
    assert np.abs(a.weight[on_sensor[0]] - b.weight[on_sensor[1]]).max() < WEIGHT


@pytest.mark.parametrize(("tilt_deg", "shift_mm"), [(0.02, 0.0), (0.0, 0.01), (0.02, -0.02)])
def test_a_small_pose_moves_the_image_as_first_order_optics_says(tilt_deg, shift_mm):
    """The front nodal point moves aside by h, the rear one by h', so the image by h' − m h (thick lens in air)."""
    lens = [
        {"radius_mm": 30.0, "thickness_mm": 6.0, "index": 1.6, "semi_diameter_mm": 4.0, "stop": True},
        {"radius_mm": -60.0, "semi_diameter_mm": 4.0},
    ]
    pose = {"tilt_deg": [tilt_deg, 0.0, 0.0], "shift_mm": [0.0, shift_mm, 0.0]}
    camera = {"focus_mm": 150.0, "lens": {"surfaces": lens, "elements": [{"surfaces": [0, 1], "pose": pose}]},
              "sensor": {"pixels": [1000, 1000], "pixel_mm": 0.01}}  # fmt: skip
    scene = lf.Scene(camera=camera)
    facts = lf.first_order(scene)
    tilt = np.deg2rad(tilt_deg)
    # A turn about x takes +z towards −y.
    front = shift_mm - tilt * facts.front_principal_plane_z_mm
    rear = shift_mm - tilt * facts.rear_principal_plane_z_mm
    expected = rear - facts.magnification * front
    slope = 1e-4 * np.stack(np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 5)), axis=-1).reshape(-1, 2)
    origins = np.tile([0.0, 0.0, -facts.object_distance_mm], (25, 1))
    for engine in ("mesh", "sequential"):
        paths = lf.trace(
            lf.build(scene), origins, np.column_stack([slope, np.ones(25)]), split="transmit", engine=engine
        )
        assert len(paths) == 25
        assert abs(paths.position[:, 1].mean() - expected) < 2e-4 * abs(expected)
        assert abs(paths.position[:, 0].mean()) < 1e-9


def test_no_pose_and_a_pose_of_zero_are_the_same_to_the_last_bit():
    zero = [{"surfaces": [0, 1], "pose": {}}, {"surfaces": [3, 4, 5], "pose": {"tilt_deg": [0.0, -0.0, 0.0]}}]
    rays = random_rays(3000, 5)
    for engine in ("mesh", "sequential"):
        a, b = (lf.trace(lf.build(scene_of(SINGLET, e)), *rays, split="transmit", engine=engine) for e in ([], zero))
        assert a.position.tobytes() == b.position.tobytes()
        assert a.weight.tobytes() == b.weight.tobytes()


@pytest.mark.parametrize("seed", range(3))
def test_energy_closes_with_all_reflections(seed):
    """What arrives, is absorbed, escapes or is cut adds up to what started, and nothing is lost."""
    draw = np.random.default_rng([23, seed])
    world = lf.build(scene_of(*random_lens(draw)))
    origins, directions = random_rays(3000, seed)
    paths = lf.trace(world, origins, directions, split="both", weight_cutoff=1e-4)
    ledger = paths.ledger
    assert abs(ledger.imbalance) < 1e-12
    assert ledger.lost_share == 0.0
    ahead = lf.trace(world, *random_rays(3000, seed), split="transmit")
    # Reflections are there, and change nothing of the image path.
    assert len(paths) > 3 * len(ahead)


def test_a_ray_that_starts_on_a_path_through_posed_elements_goes_on_along_it():
    """Starts inside tilted glass, and between it and its neighbours, are in the medium that they look to be in."""
    elements = [
        {"surfaces": [0, 1], "pose": {"tilt_deg": [6.0, -4.0, 0.0], "shift_mm": [0.4, 0.3, 0.2]}},
        {"surfaces": [3, 4, 5], "pose": {"tilt_deg": [-5.0, 3.0, 0.0]}},
    ]
    world = lf.build(scene_of(SINGLET, elements))
    origins, directions = random_rays(300, 8, wide=5.0)
    paths = lf.trace(world, origins, directions, split="transmit", record=True)
    whole = np.flatnonzero(np.isin(paths.body, ["sensor", "beside the sensor"]))
    assert len(whole) > 50
    for step in range(1, 5):
        points = np.array([[v.position for v in paths.vertices(packet)] for packet in whole])
        here, there = points[:, step], points[:, step + 1]
        again = lf.trace(world, 0.5 * (here + there), there - here, split="transmit")
        assert len(again) == len(whole)
        assert np.abs(again.position - paths.position[whole]).max() < 1e-8
