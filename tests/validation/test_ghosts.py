"""Ghosts of an uncoated double Gauss against a sequential trace of the pair of surfaces, written here.

The truth knows which surface a path meets next, and nothing of meshes, packets or splitting: spheres by centre and
radius, Snell's law for the part along the surface, Fresnel's amplitudes from cosines. Field points shine with 1 W/sr.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene import load_lens
from lfmesh.view.rays.exact_ghosts import exact_ghosts
from lfmesh.view.rays.ghosts import ghost_matrix
from lfmesh.view.rays.launch import from_field_point
from lfmesh.view.rays.names import lens_names
from tests.instances import instances

FIELD_POINTS = [(0.0, 0.0, -500.0), (60.0, 40.0, -500.0), (-120.0, 20.0, -650.0)]
SEEDS = 6
LEVEL = 1e-3 / 3
"""Of each comparison, so that all of them together fail by chance once in a thousand times."""


@dataclass(frozen=True)
class Face:
    z: float
    radius: float
    aperture: float
    before: float
    behind: float
    stop: bool


@pytest.fixture(scope="module")
def world():
    camera = lf.Camera(
        lens=load_lens(asset_path("lenses/double_gauss_50mm.toml")),
        focus_mm=500.0,
        sensor=lf.Sensor(pixels=(400, 300), pixel_mm=0.08),
    )
    return lf.build(lf.Scene(camera=camera))


def faces_of(scene):
    lens, before, faces = scene.camera.lens, 1.0, []
    for s, z in zip(lens.surfaces, lens.vertices_mm, strict=True):
        behind = s.index or 1.0
        faces.append(Face(z, s.radius_mm, s.semi_diameter_mm, before, behind, s.stop))
        before = behind
    return faces


def itinerary(faces, first, second):
    """Surfaces and whether they mirror: forward to `first`, back to `second`, and forward again."""
    through = [(k, False) for k in range(first)]
    back = [(k, False) for k in range(first - 1, second, -1)]
    on = [(k, False) for k in range(second + 1, len(faces))]
    return [*through, (first, True), *back, (second, True), *on]


def dot(a, b):
    return np.einsum("ij,ij->i", a, b)


def meet(face, p, d):
    """Where rays cross the half of a sphere that holds the vertex, and the normal there."""
    if np.isinf(face.radius):
        t = (face.z - p[:, 2]) / d[:, 2]
        return p + t[:, None] * d, np.broadcast_to([0.0, 0.0, 1.0], p.shape)
    centre = np.array([0.0, 0.0, face.z + face.radius])
    half = dot(centre - p, d)
    foot = p + half[:, None] * d
    chord = np.sqrt(face.radius**2 - dot(foot - centre, foot - centre))
    ends = [foot + sign * chord[:, None] * d for sign in (-1.0, 1.0)]
    nearer = [np.abs(q[:, 2] - face.z) for q in ends]
    q = np.where((nearer[0] < nearer[1])[:, None], *ends)
    return q, (centre - q) / face.radius


@np.errstate(invalid="ignore")
def follow(faces, path, p, d):
    """Return where rays on a path meet its last surface, their directions and shares of power; 0: they do not pass."""
    share = np.ones(len(p))
    for number, mirrors in path:
        face = faces[number]
        q, normal = meet(face, p, d)
        ahead = dot(q - p, d) > 0.0
        share = np.where(ahead & (q[:, 0] ** 2 + q[:, 1] ** 2 <= face.aperture**2), share, 0.0)
        p = q
        along = dot(d, normal)
        normal = normal * np.sign(along)[:, None]
        n_i, n_t = np.where(along > 0.0, face.before, face.behind), np.where(along > 0.0, face.behind, face.before)
        cos_i = np.abs(along)
        tangential = (n_i / n_t)[:, None] * (d - cos_i[:, None] * normal)
        sin2_t = dot(tangential, tangential)
        cos_t = np.sqrt(1.0 - sin2_t)
        r_s = (n_i * cos_i - n_t * cos_t) / (n_i * cos_i + n_t * cos_t)
        r_p = (n_t * cos_i - n_i * cos_t) / (n_t * cos_i + n_i * cos_t)
        mirrored = np.where(sin2_t >= 1.0, 1.0, 0.5 * (r_s**2 + r_p**2))
        share = share * (mirrored if mirrors else 1.0 - mirrored)
        d = d - 2.0 * cos_i[:, None] * normal if mirrors else tangential + cos_t[:, None] * normal
    return p, d, np.nan_to_num(share)


def onto_sensor(world, p, d, share):
    """Return where rays meet the sensor's plane, and their shares, 0 beside it."""
    camera = world.scene.camera
    z = camera.lens.vertices_mm[-1] + camera.sensor.distance_mm
    landed = p + ((z - p[:, 2]) / d[:, 2])[:, None] * d
    x, y = (0.5 * size for size in camera.sensor.size_mm)
    inside = (np.abs(landed[:, 0]) <= x) & (np.abs(landed[:, 1]) <= y) & (d[:, 2] > 0.0)
    return landed, np.where(inside, share, 0.0)


def true_power(world, path, point, rays=100_000, seed=99):
    """Return the power in W that a point of 1 W/sr sends along a path onto the sensor, and its standard error.

    By directions drawn uniformly over the cone in which a disk wider than the lens, 1 mm before it, is seen.
    """
    draw = np.random.default_rng(seed)
    radius = 1.05 * max(face.aperture for face in faces_of(world.scene))
    radius *= 1.0 + 1.0 / abs(point[2])
    r, phi = radius * np.sqrt(draw.random(rays)), 2.0 * np.pi * draw.random(rays)
    to = np.stack([r * np.cos(phi), r * np.sin(phi), np.full(rays, -1.0)], axis=-1) - point
    length = np.linalg.norm(to, axis=1)
    solid_angle = np.pi * radius**2 * to[:, 2] / length**3
    p = np.broadcast_to(np.asarray(point), to.shape)
    _, share = onto_sensor(world, *follow(faces_of(world.scene), path, p, to / length[:, None]))
    watts = share * solid_angle
    return watts.mean(), watts.std(ddof=1) / np.sqrt(rays)


def launched(world, point, seed=0, count=400):
    # Light enough that ghosts of two reflections are never left to the roulette.
    return from_field_point(world, point, count, aim="lens", weight_cutoff=3e-4, seed=seed)


def strongest(world, rays):
    """First and second surface, as numbers of the prescription, of the strongest ghost; and its path's filter mask."""
    first, second, _ = ghost_matrix(rays).strongest(1)[0]
    numbers = [world.lens_shape.numbers[lens_names(world).index(name)] for name in (first, second)]
    at = [rays.surfaces.index(name) for name in (first, second)]
    two = rays.arrives & (rays.count_vertices(rays.reflected) == 2)
    mask = two.copy()
    mirrors = rays.keep(two)
    mask[two] = (mirrors.surface[mirrors.reflected].reshape(-1, 2) == at).all(axis=1)
    return *numbers, mask


@pytest.mark.parametrize("point", FIELD_POINTS)
def test_rays_of_the_strongest_ghost_are_those_of_the_sequential_trace(world, point):
    """The same rays arrive, within 1e-6 mm of where the truth has them, with its power."""
    rays = launched(world, point)
    first, second, mask = strongest(world, rays)
    assert first > second
    faces = faces_of(world.scene)
    # The launched rays: of each, the first path that goes anywhere.
    step = rays.position[rays.offsets[:-1] + 1] - rays.position[rays.offsets[:-1]]
    length = np.linalg.norm(step, axis=1)
    goes = np.flatnonzero(length > 0.0)
    source, at = np.unique(rays.source[goes], return_index=True)
    d = step[goes[at]] / length[goes[at]][:, None]
    p, share = onto_sensor(
        world, *follow(faces, itinerary(faces, first, second), np.broadcast_to(np.asarray(point), d.shape), d)
    )
    assert set(source[share > 0.0]) == set(rays.source[mask])
    assert mask.sum() > 100
    assert len(set(rays.source[mask])) == mask.sum()
    place = np.searchsorted(source, rays.source[mask])
    ends = rays.offsets[1:][mask] - 1
    assert np.abs(rays.position[ends] - p[place]).max() < 1e-6
    started = rays.power[rays.offsets[:-1]][mask]
    np.testing.assert_allclose(rays.end_power[mask], started * share[place], rtol=1e-9)


@pytest.mark.parametrize("point", instances(FIELD_POINTS[:2], long=FIELD_POINTS[:1]))
def test_power_of_the_strongest_ghost_is_that_of_the_sequential_trace(world, point):
    """A t-test of the launches of several seeds against the truth, whose own error is that of its draw."""
    # The pair is chosen by a launch that the comparison leaves out, so that it is not chosen for being too bright.
    first, second, _ = strongest(world, launched(world, point, seed=1000))
    numbers = {number: k for k, number in enumerate(world.lens_shape.numbers)}
    cell = numbers[first], numbers[second]
    found = np.array([ghost_matrix(launched(world, point, seed)).power[cell] for seed in range(SEEDS)])
    faces = faces_of(world.scene)
    truth, truth_error = true_power(world, itinerary(faces, first, second), point)
    error = np.hypot(found.std(ddof=1) / np.sqrt(SEEDS), truth_error)
    # Tight enough to tell a few per cent.
    assert error < 0.03 * truth
    assert abs(found.mean() - truth) < stats.t.isf(0.5 * LEVEL, SEEDS - 1) * error


def test_the_image_path_carries_the_power_of_the_sequential_trace(world):
    """The same for light that is not reflected at all: what a ghost's share is a share of."""
    point = FIELD_POINTS[2]
    power = []
    for seed in range(SEEDS):
        rays = from_field_point(world, point, 3000, split="transmit", seed=seed)
        power.append(rays.end_power[rays.arrives].sum())
    faces = faces_of(world.scene)
    truth, truth_error = true_power(world, [(k, False) for k in range(len(faces))], point)
    error = np.hypot(np.std(power, ddof=1) / np.sqrt(SEEDS), truth_error)
    assert error < 0.01 * truth
    assert abs(np.mean(power) - truth) < stats.t.isf(0.5 * LEVEL, SEEDS - 1) * error


GRID = 160
"""Points along a side of the grid by which the truth integrates over the pupil."""

DEVIATIONS = 4.5
"""Of 46 comparisons with errors that are known only as estimates."""


def power_by_grid(world, path, point):
    """Return the power in W that a point of 1 W/sr sends along a path onto the sensor, by the midpoint rule, and error.

    The error is that of the points at the edge of the lit region, each of which stands for an area lit to a share from
    0 to 1, and half of what every second point alone differs by.
    """
    radius = 1.1 * max(face.aperture for face in faces_of(world.scene))
    step = 2.0 * radius / GRID
    x, y = np.meshgrid(*2 * [(np.arange(GRID) + 0.5) * step - radius], indexing="ij")
    to = np.stack([x.ravel(), y.ravel(), np.full(x.size, -0.5)], axis=-1) - point
    length = np.linalg.norm(to, axis=1)
    p = np.broadcast_to(np.asarray(point), to.shape)
    _, share = onto_sensor(world, *follow(faces_of(world.scene), path, p, to / length[:, None]))
    watts = (share * to[:, 2] / length**3 * step**2).reshape(GRID, GRID)
    lit = np.pad(watts > 0.0, 1)
    neighbours = [np.roll(lit, shift, axis)[1:-1, 1:-1] for shift in (-1, 1) for axis in (0, 1)]
    edge = np.logical_or.reduce([neighbour != lit[1:-1, 1:-1] for neighbour in neighbours])
    coarse = 4.0 * watts[::2, ::2].sum()
    return watts.sum(), np.hypot(watts.max() * np.sqrt(edge.sum() / 12.0), 0.5 * (coarse - watts.sum()))


@pytest.fixture(scope="module")
def exact(world):
    """Ghosts of the second field point by quadrature."""
    return exact_ghosts(world, FIELD_POINTS[1])


def test_every_ghost_by_quadrature_has_the_power_of_the_sequential_trace(world, exact):
    """And so has the image path; their total, to a thousandth."""
    point = FIELD_POINTS[1]
    faces, numbers = faces_of(world.scene), world.lens_shape.numbers
    found, true, error = [], [], []
    for row in (exact.image, *exact.ghosts):
        if len(set(row.path.mirrors)) == 1:
            # No ray runs along the inside of these surfaces.
            assert row.power == 0.0
            continue
        pair = [numbers[k] for k in row.path.mirrors]
        path = itinerary(faces, *pair) if pair else [(k, False) for k in range(len(faces))]
        truth, off = power_by_grid(world, path, point)
        found.append(row.power)
        true.append(truth)
        error.append(np.hypot(row.error, off))
    found, true, error = np.array(found), np.array(true), np.array(error)
    assert len(found) == 46
    assert (np.abs(found - true) < DEVIATIONS * error).all(), (found / true, error / true)
    # What most of the light takes is known well.
    strong = true[1:] > 0.02 * true[1:].sum()
    assert strong.sum() > 10
    assert (error[1:][strong] < 0.01 * true[1:][strong]).all()
    assert exact.power == pytest.approx(true[1:].sum(), rel=1e-3)
    assert exact.error < 1e-3 * exact.power


def test_ghosts_by_quadrature_are_those_of_the_mesh_engine(world, exact):
    """The image path's ten strongest ghosts, and all of them together, by t-tests over launches of several seeds."""
    point, seeds = FIELD_POINTS[1], 12
    launches = [ghost_matrix(launched(world, point, seed)).power for seed in range(seeds)]
    strongest_rows = exact.ghosts[:10]
    found = np.array([[power[row.path.mirrors] for row in strongest_rows] + [power.sum()] for power in launches])
    truth = np.array([row.power for row in strongest_rows] + [exact.power])
    error = found.std(axis=0, ddof=1) / np.sqrt(seeds)
    assert error[-1] < 0.01 * truth[-1]
    assert (error < 0.05 * truth).all()
    limit = stats.t.isf(0.5e-3 / len(truth), seeds - 1)
    assert (np.abs(found.mean(axis=0) - truth) < limit * error).all(), (found.mean(axis=0) / truth, error / truth)


def test_paraxial_focus_of_a_ghost_is_where_rays_near_the_axis_meet_it(world):
    distance = 500.0
    faces, numbers = faces_of(world.scene), world.lens_shape.numbers
    exact = exact_ghosts(world, (0.0, 0.0, -distance))
    height = 1e-3
    d = np.array([[height, 0.0, distance]]) / np.hypot(height, distance)
    for row in exact.ghosts:
        if len(set(row.path.mirrors)) < 2:
            continue
        path = itinerary(faces, *(numbers[k] for k in row.path.mirrors))
        p, u, _ = follow(faces, path, np.array([[0.0, 0.0, -distance]]), d)
        crossing = p[0, 2] - p[0, 0] * u[0, 2] / u[0, 0] - faces[-1].z
        assert row.focus_mm == pytest.approx(crossing, rel=1e-4), row.mirrors
