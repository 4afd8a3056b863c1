"""Real rays through published lenses against a sequential trace written here, in extended precision.

The truth knows the order in which a path meets the surfaces, and nothing of meshes: centre-and-radius spheres, Newton's
method on aspheres, Snell's law for the tangential component, Fresnel's amplitudes from cosines.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.optics.glass import refractive_index
from lfmesh.scene import load_lens
from lfmesh.scene.files import library

EXTENDED = np.longdouble
POSITION_MM = 1e-9
WEIGHT = 1e-12
# Gradient-index glass, with its curved rays, has a truth of its own in `test_gradient_lenses.py`.
LENSES = [name for name in library() if not load_lens(f"lib:{name}").has_gradients]
# Half field in degrees up to which each lens is asked: the published one where there is one.
HALF_FIELD_DEG = {"double_gauss_50mm": 22.0, "cooke_triplet_50mm": 20.0, "ball_10mm": 20.0}
# Rays of 2500 on the front that reach the sensor, at least; a fisheye's front is far wider than its pupil.
LEAST = {"fisheye_10mm": 10}
TRANSMITTED, REFLECTED = "transmitted", "reflected"


@dataclass(frozen=True)
class Interface:
    """A surface as the truth sees it, with the indices before and behind it."""

    vertex_z: float
    radius: float
    conic: float
    asphere: tuple
    aperture: float
    before: float
    behind: float
    stop: bool

    def sag_and_slope(self, r2):
        """Sag, and dz/d(r²)."""
        c = EXTENDED(0) if np.isinf(self.radius) else 1 / EXTENDED(self.radius)
        root = np.sqrt(1 - (1 + EXTENDED(self.conic)) * c * c * r2)
        z, half_slope = c * r2 / (1 + root), c / (2 * root)
        for power, a in enumerate(self.asphere, 2):
            z = z + EXTENDED(a) * r2**power
            half_slope = half_slope + power * EXTENDED(a) * r2 ** (power - 1)
        return z, half_slope

    def meet(self, p, d, sense):
        """Points where rays cross the surface, and the unit normals there, towards +z. NaN where they do not."""
        if self.conic or self.asphere:
            return self._meet_by_newton(p, d)
        if np.isinf(self.radius):
            t = (self.vertex_z - p[:, 2]) / d[:, 2]
            return p + t[:, None] * d, np.broadcast_to(np.array([0, 0, 1], EXTENDED), p.shape)
        centre = np.array([0, 0, EXTENDED(self.vertex_z) + EXTENDED(self.radius)])
        to_foot = np.sum((centre - p) * d, axis=1)
        foot = p + to_foot[:, None] * d - centre
        half_chord = np.sqrt(EXTENDED(self.radius) ** 2 - np.sum(foot**2, axis=1))
        q = p + (to_foot - sense * np.sign(self.radius) * half_chord)[:, None] * d
        return q, (centre - q) / EXTENDED(self.radius)

    def _meet_by_newton(self, p, d):
        t = (self.vertex_z - p[:, 2]) / d[:, 2]
        for _ in range(30):
            q = p + t[:, None] * d
            z, half_slope = self.sag_and_slope(q[:, 0] ** 2 + q[:, 1] ** 2)
            rate = d[:, 2] - 2 * half_slope * (q[:, 0] * d[:, 0] + q[:, 1] * d[:, 1])
            t = t - (q[:, 2] - self.vertex_z - z) / rate
        q = p + t[:, None] * d
        half_slope = self.sag_and_slope(q[:, 0] ** 2 + q[:, 1] ** 2)[1]
        normal = np.column_stack([-2 * half_slope * q[:, 0], -2 * half_slope * q[:, 1], np.ones(len(q), EXTENDED)])
        return q, normal / np.linalg.norm(normal, axis=1, keepdims=True)


@dataclass
class Truth:
    """Rays on one path: where they are, and the share of their power that they carry."""

    position: np.ndarray
    direction: np.ndarray
    weight: np.ndarray
    passes: np.ndarray
    """Whether a ray met every surface so far inside its aperture, without total reflection."""
    cut_at_stop: np.ndarray
    """Whether the stop was the first to cut it."""


def interfaces_of(scene, wavelength_nm):
    """Every surface of a solved scene's lens; a pure stop has the same index on both sides."""
    lens = scene.camera.lens
    media = [None, *(surface.medium for surface in lens.surfaces)]
    index = [refractive_index(medium, wavelength_nm) for medium in media]
    return [
        Interface(z, s.radius_mm, s.conic, s.asphere_mm, s.semi_diameter_mm, index[i], index[i + 1], s.stop)
        for i, (s, z) in enumerate(zip(lens.surfaces, lens.vertices_mm, strict=True))
    ]


@np.errstate(invalid="ignore")
def follow(interfaces, origins, directions, path=None, start=1):
    """Trace rays along a path: (surface, what happens there) in order; None is the image path."""
    p, d = np.array(origins, EXTENDED), np.array(directions, EXTENDED)
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    weight = np.ones(len(p), EXTENDED)
    passes, cut_at_stop = np.ones(len(p), bool), np.zeros(len(p), bool)
    sense = start
    for number, event in path or [(k, TRANSMITTED) for k in range(len(interfaces))]:
        face = interfaces[number]
        p, normal = face.meet(p, d, sense)
        inside = p[:, 0] ** 2 + p[:, 1] ** 2 <= EXTENDED(face.aperture) ** 2
        cut_at_stop |= passes & ~inside & face.stop
        passes &= inside
        n_i, n_t = (face.before, face.behind) if sense > 0 else (face.behind, face.before)
        n_i, n_t = EXTENDED(n_i), EXTENDED(n_t)
        normal = sense * normal
        cos_i = np.sum(d * normal, axis=1)
        along_surface = (n_i / n_t) * (d - cos_i[:, None] * normal)
        cos_t = np.sqrt(1 - np.sum(along_surface**2, axis=1))
        if event == TRANSMITTED:
            passes &= ~np.isnan(cos_t)
            t_s, t_p = 2 * n_i * cos_i / (n_i * cos_i + n_t * cos_t), 2 * n_i * cos_i / (n_t * cos_i + n_i * cos_t)
            weight = weight * (n_t * cos_t) / (n_i * cos_i) * (t_s**2 + t_p**2) / 2
            d = along_surface + cos_t[:, None] * normal
        else:
            r_s = (n_i * cos_i - n_t * cos_t) / (n_i * cos_i + n_t * cos_t)
            r_p = (n_t * cos_i - n_i * cos_t) / (n_t * cos_i + n_i * cos_t)
            weight = weight * np.where(np.isnan(cos_t), 1, (r_s**2 + r_p**2) / 2)
            d = d - 2 * cos_i[:, None] * normal
            sense = -sense
    return Truth(p, d, weight, passes, cut_at_stop)


def onto_plane(truth, z):
    t = (EXTENDED(z) - truth.position[:, 2]) / truth.direction[:, 2]
    return replace(truth, position=truth.position + t[:, None] * truth.direction)


def sensor_z(scene):
    return scene.camera.lens.vertices_mm[-1] + scene.camera.sensor.distance_mm


def scene_of(name, **transport):
    """A camera with one of the lenses that come with lfmesh, and a sensor that catches all it passes."""
    return lf.solved(
        lf.Scene(
            camera=lf.Camera(
                lens=load_lens(f"lib:{name}"),
                sensor=lf.Sensor(pixels=(4000, 4000), pixel_mm=0.02, distance_mm=30.0),
            ),
            transport=lf.Transport(**transport),
        )
    )


def bundle(interfaces, field_deg, count, seed):
    """Parallel rays at a field angle, spread over the first clear aperture and beyond it to its edge."""
    draw = np.random.default_rng(seed)
    first = interfaces[0]
    radius = 0.999 * first.aperture * np.sqrt(draw.uniform(size=count))
    turn = draw.uniform(0.0, 2 * np.pi, size=count)
    on_surface = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.zeros(count)])
    on_surface[:, 2] = np.asarray(first.sag_and_slope(radius.astype(EXTENDED) ** 2)[0], float)
    azimuth = draw.uniform(0.0, 2 * np.pi)
    sine = np.sin(np.deg2rad(field_deg))
    direction = np.array([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(np.deg2rad(field_deg))])
    directions = np.tile(direction, (count, 1))
    return on_surface - 20.0 * directions, directions


def ends_of(paths, count):
    """Position, direction, weight and whether it met the sensor's plane, a row a ray; a ray has one packet or none."""
    assert len(np.unique(paths.source)) == len(paths)
    position, direction = np.full((count, 3), np.nan), np.full((count, 3), np.nan)
    weight, landed = np.full(count, np.nan), np.zeros(count, bool)
    position[paths.source], direction[paths.source], weight[paths.source] = (
        paths.position,
        paths.direction,
        paths.weight,
    )
    landed[paths.source] = np.isin(paths.body, ["sensor", "beside the sensor"])
    return position, direction, weight, landed


def assert_equal_where_they_land(world, scene, wavelength_nm, origins, directions):
    """The two traces let the same rays through and agree on them; return how many there are."""
    paths = lf.trace(world, origins, directions, wavelength_nm, split="transmit")
    position, direction, weight, landed = ends_of(paths, len(origins))
    truth = onto_plane(follow(interfaces_of(scene, wavelength_nm), origins, directions), sensor_z(scene))
    np.testing.assert_array_equal(landed, truth.passes)
    assert np.abs(position - truth.position)[landed].max() < POSITION_MM
    assert np.abs(direction - truth.direction)[landed].max() < 1e-12
    assert np.abs(weight - truth.weight)[landed].max() < WEIGHT
    return int(landed.sum())


def test_double_gauss_from_its_object_plane_to_its_sensor():
    scene = lf.solved(lf.load(asset_path("scenes/conventional.toml")).model_copy(update={"targets": ()}))
    world = lf.build(scene)
    draw = np.random.default_rng(1)
    for height in (0.0, 10.0, 50.0, 120.0, 190.0):
        turn = draw.uniform(0, 2 * np.pi)
        start = np.array([height * np.cos(turn), height * np.sin(turn), -500.0])
        pupil = draw.uniform(-7.0, 7.0, size=(4000, 2))
        # The entrance pupil lies some 30 mm behind the first vertex.
        aims = np.column_stack([pupil, np.full(4000, 30.0)])
        landed = assert_equal_where_they_land(world, scene, 587.6, np.tile(start, (4000, 1)), aims - start)
        assert landed > 400


@pytest.mark.parametrize("name", LENSES)
def test_every_lens_at_every_field(name):
    scene = scene_of(name)
    world = lf.build(scene)
    half_field = HALF_FIELD_DEG.get(name, 5.0)
    for seed, share in enumerate((0.0, 0.35, 0.7, 1.0)):
        interfaces = interfaces_of(scene, 587.6)
        origins, directions = bundle(interfaces, share * half_field, 2500, seed)
        assert assert_equal_where_they_land(world, scene, 587.6, origins, directions) > LEAST.get(name, 100)


@pytest.mark.parametrize("wavelength_nm", [450.0, 550.0, 700.0])
def test_dispersion_through_the_cooke_triplet(wavelength_nm):
    scene = scene_of("cooke_triplet_50mm")
    world = lf.build(scene)
    interfaces = interfaces_of(scene, wavelength_nm)
    assert abs(interfaces[0].behind - interfaces_of(scene, 587.6)[0].behind) > 1e-3
    for seed, field in enumerate((0.0, 14.0, 20.0)):
        origins, directions = bundle(interfaces, field, 2500, seed)
        assert assert_equal_where_they_land(world, scene, wavelength_nm, origins, directions) > 100


@pytest.mark.parametrize("name", ["double_gauss_50mm", "cooke_triplet_50mm", "asphere_100mm"])
def test_the_stop_passes_what_lies_inside_its_radius_and_nothing_else(name):
    """Rays aimed by bisection of the truth at the stop's edge, then moved 1e-7 mm inwards and outwards."""
    scene = scene_of(name)
    # Narrower than every other aperture, so that only the stop cuts.
    scene = with_stop(scene, 0.6 * min(s.semi_diameter_mm for s in scene.camera.lens.surfaces))
    world = lf.build(scene)
    interfaces = interfaces_of(scene, 587.6)
    edge = next(face.aperture for face in interfaces if face.stop)
    rays = 64
    turn = 2 * np.pi * (np.arange(rays) + 0.3) / rays
    height = np.full(rays, 0.2 * edge)
    step = np.full(rays, 2.0 * edge)
    for _ in range(60):
        tried = height + step
        inside = follow_to_stop(interfaces, tried, turn) < edge
        height = np.where(inside, tried, height)
        step *= 0.5
    for offset in (-1e-7, 1e-7):
        origins, directions = meridional(height + offset, turn)
        truth = follow(interfaces, origins, directions)
        assert truth.passes.all() == (offset < 0.0)
        paths = lf.trace(world, origins, directions, split="transmit")
        if offset < 0.0:
            assert set(paths.body) <= {"sensor", "beside the sensor"}
        else:
            assert truth.cut_at_stop.all()
            assert set(paths.body) == {"stop"}
            np.testing.assert_array_equal(paths.status, lf.Status.ABSORBED)
        assert len(paths) == rays


def with_stop(scene, semi_diameter_mm):
    lens = scene.camera.lens
    surfaces = tuple(
        s.model_copy(update={"semi_diameter_mm": semi_diameter_mm}) if s.stop else s for s in lens.surfaces
    )
    camera = scene.camera.model_copy(update={"lens": lens.model_copy(update={"surfaces": surfaces})})
    return scene.model_copy(update={"camera": camera})


def meridional(height, turn):
    """Rays parallel to the axis at given heights and azimuths."""
    origins = np.column_stack([height * np.cos(turn), height * np.sin(turn), np.full(len(height), -20.0)])
    return origins, np.tile([0.0, 0.0, 1.0], (len(height), 1))


def follow_to_stop(interfaces, height, turn):
    """Height at which meridional rays meet the stop; inf where they do not get there."""
    stop = next(i for i, face in enumerate(interfaces) if face.stop)
    truth = follow(interfaces, *meridional(height, turn), path=[(k, TRANSMITTED) for k in range(stop + 1)])
    return np.nan_to_num(np.hypot(truth.position[:, 0], truth.position[:, 1]), nan=np.inf)


@pytest.mark.parametrize("number", [0, 2, 10])
def test_a_clear_aperture_passes_what_lies_inside_it_and_nothing_else(number):
    """Rays that meet one surface of the double Gauss within 1e-7 mm of its edge, coming from the side of the air."""
    scene = scene_of("double_gauss_50mm")
    world = lf.build(scene)
    face = interfaces_of(scene, 587.6)[number]
    turn = 2 * np.pi * (np.arange(48) + 0.3) / 48
    onward = -1.0 if face.behind == 1.0 else 1.0
    directions = onward * np.column_stack([-0.3 * np.cos(turn), -0.3 * np.sin(turn), np.ones(48)])
    for offset, meets in ((-1e-7, f"lens surface {number}"), (1e-7, "mount")):
        r = np.full(48, face.aperture + offset)
        z = face.vertex_z + np.asarray(face.sag_and_slope(r.astype(EXTENDED) ** 2)[0], float)
        on_edge = np.column_stack([r * np.cos(turn), r * np.sin(turn), z])
        paths = lf.trace(world, on_edge - 0.1 * directions, directions, split="transmit", record=True)
        assert {path_of(paths, packet)[0][1] for packet in range(48)} == {meets}


def path_of(paths, packet):
    """(event, surface, position, weight) of a packet's recorded vertices, its start left out."""
    return [(v.event.name.lower(), v.surface, v.position, v.weight) for v in paths.vertices(packet)[1:]]


def test_total_reflection_returns_all_of_a_ray():
    """Beyond the critical angle of the flat face of a thick plano-convex element."""
    scene = lf.Scene(
        camera=lf.Camera(
            lens=lf.Lens(
                surfaces=(
                    lf.Surface(radius_mm=30.0, thickness_mm=15.0, index=1.6, semi_diameter_mm=15.0, stop=True),
                    lf.Surface(semi_diameter_mm=15.0),
                )
            ),
            sensor=lf.Sensor(pixels=(100, 100), pixel_mm=0.1, distance_mm=30.0),
        )
    )
    world = lf.build(scene)
    interfaces = interfaces_of(lf.solved(scene), 587.6)
    draw = np.random.default_rng(5)
    critical = np.arcsin(1 / 1.6)
    angle = critical + draw.uniform(1e-6, 0.15, size=200)
    turn = draw.uniform(0, 2 * np.pi, size=200)
    directions = np.column_stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])
    origins = np.tile([0.0, 0.0, 10.0], (200, 1)) - directions
    truth = follow(interfaces, origins, directions, path=[(1, REFLECTED), (0, TRANSMITTED)])
    paths = lf.trace(world, origins, directions, split="both", weight_cutoff=0.0, max_events=2, record=True)
    compared = 0
    for packet in range(len(paths)):
        path = path_of(paths, packet)
        event, surface, position, weight = path[0]
        assert (event, surface) == ("reflected", "lens surface 1")
        # All of it, to the last bit: R is 1 and there is no refracted child.
        assert weight == 1.0
        np.testing.assert_allclose(position[2], 15.0, rtol=0, atol=1e-12)
        if len(path) > 1 and path[1][:2] == ("transmitted", "lens surface 0"):
            i = paths.source[packet]
            assert np.abs(path[1][2] - truth.position[i]).max() < POSITION_MM
            assert abs(path[1][3] - truth.weight[i]) < WEIGHT
            assert np.abs(paths.direction[packet] - truth.direction[i]).max() < 1e-12
            compared += 1
    assert compared == truth.passes.sum() > 100


def test_every_double_reflection_of_the_double_gauss():
    """Each ghost, reflected at surface k and again at j < k, is among the packets of its ray, with its R's and T's."""
    scene = scene_of("double_gauss_50mm")
    world = lf.build(scene)
    interfaces = interfaces_of(scene, 587.6)
    stop = next(i for i, face in enumerate(interfaces) if face.stop)
    last = len(interfaces) - 1
    origins, directions = bundle([replace(interfaces[0], aperture=4.0)], 3.0, 6, seed=9)
    cutoff = 1e-6
    paths = lf.trace(world, origins, directions, split="both", weight_cutoff=cutoff, max_events=40, record=True)
    found = {}
    for packet in np.flatnonzero(np.isin(paths.body, ["sensor", "beside the sensor"])):
        path = path_of(paths, packet)
        numbers = tuple((int(surface.rsplit(" ", 1)[1]), event) for event, surface, _, _ in path[:-1])
        found[int(paths.source[packet]), numbers] = packet
    ghosts = 0
    for k in range(1, last + 1):
        for j in range(k):
            if stop in (j, k):
                continue
            way = [(i, TRANSMITTED) for i in range(k)] + [(k, REFLECTED)]
            way += [(i, TRANSMITTED) for i in range(k - 1, j, -1)] + [(j, REFLECTED)]
            way += [(i, TRANSMITTED) for i in range(j + 1, last + 1)]
            truth = onto_plane(follow(interfaces, origins, directions, way), sensor_z(scene))
            recorded = tuple(step for step in way if step[0] != stop)
            for i in np.flatnonzero(truth.passes & (truth.weight > cutoff)):
                packet = found[int(i), recorded]
                assert np.abs(paths.position[packet] - truth.position[i]).max() < POSITION_MM
                assert np.abs(paths.direction[packet] - truth.direction[i]).max() < 1e-11
                assert abs(paths.weight[packet] - truth.weight[i]) < WEIGHT
                ghosts += 1
    assert ghosts > 100


def error_at_sensor(surface, rings):
    """Rms distance on the sensor from the truth, mm; and the rms or sum over surfaces of what facets of this size do.

    For flat facets that is the tilt of a facet against the surface above it, edge / (√12 R) rms, times n − 1 and the
    way to the sensor. Interpolated normals of a sphere are exact, and what remains is a facet's depth below the
    surface, at most edge² / 8R.
    """
    scene = scene_of("cooke_triplet_50mm", surface=surface)
    world = lf.build(scene, rings=rings)
    interfaces = interfaces_of(scene, 587.6)
    origins, directions = bundle([replace(interfaces[0], aperture=5.0)], 10.0, 3000, seed=2)
    paths = lf.trace(world, origins, directions, split="transmit")
    position, _, _, landed = ends_of(paths, len(origins))
    truth = onto_plane(follow(interfaces, origins, directions), sensor_z(scene))
    both = landed & truth.passes
    # Rays at the very edge of an aperture may fall on either side of it.
    assert (landed != truth.passes).sum() < 0.02 * len(origins)
    assert both.sum() > 1500
    error = float(np.sqrt(np.mean(np.sum((position - truth.position)[both] ** 2, axis=1))))
    edge_over_radius = np.array([face.aperture / rings / abs(face.radius) for face in interfaces])
    if surface == "flat":
        bend = np.array([abs(face.behind - face.before) for face in interfaces])
        way = sensor_z(scene) - np.array([face.vertex_z for face in interfaces])
        return error, float(np.linalg.norm(edge_over_radius / np.sqrt(12) * bend * way))
    return error, float(np.sum(edge_over_radius**2 / 8 * [abs(face.radius) for face in interfaces]))


def test_flat_facets_converge_with_order_one():
    errors, estimates = zip(*(error_at_sensor("flat", rings) for rings in (12, 24, 48)), strict=True)
    for error, estimate in zip(errors, estimates, strict=True):
        assert 0.5 * estimate < error < 2.0 * estimate
    for coarse, fine in pairwise(errors):
        assert 0.8 < np.log2(coarse / fine) < 1.2


def test_interpolated_normals_converge_with_order_two():
    errors, bounds = zip(*(error_at_sensor("smooth", rings) for rings in (12, 24, 48)), strict=True)
    for error, bound in zip(errors, bounds, strict=True):
        assert POSITION_MM < error < bound
    for coarse, fine in pairwise(errors):
        assert 1.8 < np.log2(coarse / fine) < 2.2


def test_a_ray_from_within_the_stops_space_is_cut_only_where_it_crosses_the_stop():
    """Rays that meet the concave face before the stop twice running: none of their lines would pass the stop."""
    scene = scene_of("double_gauss_50mm")
    world = lf.build(scene)
    face, stop = (interfaces_of(scene, 587.6)[number] for number in (4, 5))
    draw = np.random.default_rng(6)
    count = 200
    centre = np.array([0.0, 0.0, face.vertex_z + face.radius])

    def on_face(radius, turn):
        z = centre[2] - np.sqrt(face.radius**2 - radius**2)
        return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), z])

    turn = draw.uniform(0, 2 * np.pi, size=count)
    first = on_face(draw.uniform(6.0, 8.5, size=count), turn)
    second = on_face(draw.uniform(6.0, 8.5, size=count), turn + np.pi + draw.uniform(-0.5, 0.5, size=count))
    between = second - first
    between /= np.linalg.norm(between, axis=1, keepdims=True)
    normal = (centre - first) / face.radius
    arriving = between - 2 * np.sum(between * normal, axis=1, keepdims=True) * normal
    for directions, crossing in ((arriving, first), (between, second)):
        to_stop = (stop.vertex_z - crossing[:, 2]) / directions[:, 2]
        at_stop = crossing + to_stop[:, None] * directions
        assert (np.hypot(at_stop[:, 0], at_stop[:, 1]) > stop.aperture).mean() > 0.5
    paths = lf.trace(world, first - 0.5 * arriving, arriving, weight_cutoff=0.0, max_events=2, record=True)
    twice = 0
    for packet in range(len(paths)):
        path = path_of(paths, packet)
        source = paths.source[packet]
        assert path[0][1] == "lens surface 4"
        assert np.abs(path[0][2] - first[source]).max() < POSITION_MM
        if path[0][0] == "reflected":
            assert path[1][1] == "lens surface 4"
            assert np.abs(path[1][2] - second[source]).max() < POSITION_MM
            twice += 1
    assert twice >= count
