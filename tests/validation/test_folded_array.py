"""The folded array against the whole one, ray by ray: reflections and the steps between unlike lenslets included.

lfmesh keeps one cell a lenslet type and walks from cell to cell. Two truths that know nothing of folding are written
here. One meets every facet of the array's mesh in turn, in float64 (`surface` "flat" and "smooth"). The other clips the
ray to every cell at once and meets the spheres in them ("exact"). Where a packet was reflected and where refracted is
read from its recorded path; where that takes it is for the truth to say.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.kernels.decorators import kernel

compiled = kernel

AIR, GLASS, BEHIND = 0, 1, 2
# How a ray leaves an array.
GOES_ON, FRONT, BACK, MOUNT, EDGE, WALL, TOTAL = -1, 0, 1, 2, 3, 4, 5
BODY = {MOUNT: "mla mount", EDGE: "mla edge", WALL: "mla wall"}
CURVED, FLAT = 0, 1
INDEX = 1.5
THICKNESS_MM = 0.3
PITCH_MM = 0.125
SENSOR_MM = 2.0
RAYS = 500
POSITION_MM = 1e-10
PARALLEL = 1e-11
MOST_VERTICES = 6


class Whole(NamedTuple):
    """Every lenslet of an array, and every facet of its mesh, in a frame whose z runs from the curved face inwards."""

    hexagonal: bool
    pitch: float
    centre: np.ndarray  # (cells, 2)
    curvature: np.ndarray  # (cells,)
    apex: np.ndarray  # (cells, 2)
    top: float
    corners: np.ndarray  # (facets, 3, 3), cell by cell; none: the spheres count
    normals: np.ndarray  # (facets, 3) outward
    corner_normals: np.ndarray  # (facets, 3, 3) towards +z
    first: np.ndarray  # (cells + 1,) facet


# Vectors are tuples, which compile in a quarter of the time that arrays take.
@compiled
def row(a):
    return a[0], a[1], a[2]


@compiled
def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def times(c, a):
    return c * a[0], c * a[1], c * a[2]


@compiled
def plus(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@compiled
def crossed(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def turned(d, normal, n_i, n_t, refracts):
    """Direction after an interface and its share of the power; a share of 0 is refraction beyond the critical angle."""
    cos_i = dot(normal, d)
    if cos_i < 0.0:
        normal, cos_i = times(-1.0, normal), -cos_i
    sin2_t = (n_i / n_t) ** 2 * (1.0 - cos_i * cos_i)
    if sin2_t >= 1.0:
        return (d, 0.0) if refracts else (minus(d, times(2.0 * cos_i, normal)), 1.0)
    cos_t = np.sqrt(1.0 - sin2_t)
    s, p = n_i * cos_i + n_t * cos_t, n_t * cos_i + n_i * cos_t
    if not refracts:
        r_s, r_p = (n_i * cos_i - n_t * cos_t) / s, (n_t * cos_i - n_i * cos_t) / p
        return minus(d, times(2.0 * cos_i, normal)), 0.5 * (r_s * r_s + r_p * r_p)
    t_s, t_p = 2.0 * n_i * cos_i / s, 2.0 * n_i * cos_i / p
    on = plus(times(n_i / n_t, minus(d, times(cos_i, normal))), times(cos_t, normal))
    return times(1.0 / np.sqrt(dot(on, on)), on), n_t * cos_t / (n_i * cos_i) * 0.5 * (t_s * t_s + t_p * t_p)


@compiled
def stay_in_cell(whole, cell, p, d):
    """Distances between which a line is inside a cell; the second is the smaller where it never is."""
    enters, leaves = -np.inf, np.inf
    sides = 3 if whole.hexagonal else 2
    for side in range(sides):
        angle = side * np.pi / sides
        nx, ny = np.cos(angle), np.sin(angle)
        at = nx * (p[0] - whole.centre[cell, 0]) + ny * (p[1] - whole.centre[cell, 1])
        along = nx * d[0] + ny * d[1]
        if along == 0.0:
            if abs(at) > 0.5 * whole.pitch:
                return 0.0, -1.0
        else:
            a, b = (-0.5 * whole.pitch - at) / along, (0.5 * whole.pitch - at) / along
            enters, leaves = max(enters, min(a, b)), min(leaves, max(a, b))
    return enters, leaves


@compiled
def cell_at(whole, p, d, t):
    """The cell that a line is in just behind t; −1 for none."""
    best, most = -1, 0.0
    for cell in range(len(whole.centre)):
        enters, leaves = stay_in_cell(whole, cell, p, d)
        shared = min(leaves, t + 1e-9) - max(enters, t)
        if shared > most:
            best, most = cell, shared
    return best


@compiled
def leaves_outline(whole, p, d, t):
    """Where a ray, inside the array just behind t, first leaves the union of its cells."""
    cell = cell_at(whole, p, d, t)
    while cell >= 0:
        _, t = stay_in_cell(whole, cell, p, d)
        cell = cell_at(whole, p, d, t)
    return t


@compiled
def depth(whole, cell, x, y):
    """The curved face's z over a point."""
    c = whole.curvature[cell]
    r2 = (x - whole.centre[cell, 0] - whole.apex[cell, 0]) ** 2 + (y - whole.centre[cell, 1] - whole.apex[cell, 1]) ** 2
    return (1.0 - np.sqrt(1.0 - c * c * r2)) / c


@compiled
def meets_sphere(whole, cell, p, d, medium):
    """Where a ray crosses a lenslet's sphere out of its medium, on the half with the apex; inf where it does not."""
    radius = 1.0 / whole.curvature[cell]
    centre = whole.centre[cell, 0] + whole.apex[cell, 0], whole.centre[cell, 1] + whole.apex[cell, 1], radius
    to_foot = dot(minus(centre, p), d)
    foot = minus(plus(p, times(to_foot, d)), centre)
    square = radius * radius - dot(foot, foot)
    if square < 0.0:
        return np.inf, centre
    # Into the glass along the normal towards +z, out of it against that.
    inward = 1.0 if medium == AIR else -1.0
    t = to_foot - inward * np.sign(radius) * np.sqrt(square)
    normal = times(1.0 / radius, minus(centre, plus(p, times(t, d))))
    return (t if normal[2] > 0.0 else np.inf), normal


@compiled
def next_on_spheres(whole, p, d, medium, thickness):
    """What a ray in air or glass meets next: (fate or GOES_ON, distance, face, normal)."""
    up = 0.0, 0.0, 1.0
    t = 0.0
    if medium == AIR and d[2] > 0.0 and p[2] < whole.top:
        t = (whole.top - p[2]) / d[2]
    out = np.inf
    if medium == AIR and d[2] < 0.0:
        out = (whole.top - p[2]) / d[2]
    elif medium == GLASS and d[2] > 0.0:
        out = (thickness - p[2]) / d[2]
    cell = cell_at(whole, p, d, t)
    if cell < 0:
        return MOUNT, t, CURVED, up
    while True:
        _, leaves = stay_in_cell(whole, cell, p, d)
        hit, normal = meets_sphere(whole, cell, p, d, medium)
        if t < hit <= min(leaves, out):
            return GOES_ON, hit, CURVED, normal
        if out <= leaves:
            if medium == AIR:
                return FRONT, out, CURVED, up
            return GOES_ON, out, FLAT, up
        t = leaves
        cell = cell_at(whole, p, d, t)
        if cell < 0:
            return MOUNT if medium == AIR else EDGE, t, CURVED, up
        q = plus(p, times(t, d))
        if (q[2] > depth(whole, cell, q[0], q[1])) != (medium == GLASS):
            return WALL, t, CURVED, up


@compiled
def next_on_mesh(whole, p, d, medium, left):
    """As `next_on_spheres`, with the facet that is met; `left` is the one the ray starts on."""
    up = 0.0, 0.0, 1.0
    start = 0.0
    if medium == AIR and d[2] > 0.0 and p[2] < whole.top:
        start = (whole.top - p[2]) / d[2]
        if cell_at(whole, p, d, start) < 0:
            return MOUNT, start, CURVED, up, -1
    outline = leaves_outline(whole, p, d, start)
    while True:
        nearest, facet = first_facet(whole, p, d, start, np.inf, -1.0 if medium != GLASS else 1.0, left)
        if medium == AIR and nearest > outline - 1e-12:
            if d[2] < 0.0 and (whole.top - p[2]) / d[2] <= outline:
                return FRONT, 0.0, CURVED, up, -1
            return MOUNT, outline, CURVED, up, -1
        if facet < 0:
            return EDGE, outline, CURVED, up, -1
        normal = row(whole.normals[facet])
        if abs(normal[2]) < 1e-9:
            if medium == AIR:
                return WALL, nearest, CURVED, up, facet
            if nearest > outline - 1e-12:
                return EDGE, nearest, CURVED, up, facet
            # Out of one prism: into the next one, or into the step between them.
            if first_facet(whole, p, d, nearest - 1e-10, nearest + 1e-10, -1.0, -1)[1] < 0:
                return WALL, nearest, CURVED, up, facet
            start, left = nearest + 1e-10, -1
            continue
        if normal[2] > 0.5 and whole.corners[facet, 0, 2] > 0.99 * THICKNESS_MM:
            return GOES_ON, nearest, FLAT, up, facet
        return GOES_ON, nearest, CURVED, interpolated(whole, facet, plus(p, times(nearest, d))), facet


@compiled
def first_facet(whole, p, d, start, end, sense, left):
    """Distance and number of the first facet that a ray crosses into (−1) or out of (1) the glass; but not `left`."""
    nearest, facet = end, -1
    for cell in range(len(whole.centre)):
        enters, leaves = stay_in_cell(whole, cell, p, d)
        # All facets of a cell are inside it or on its border.
        if enters > min(leaves, nearest) + 1e-9 or leaves < start - 1e-9:
            continue
        for f in range(whole.first[cell], whole.first[cell + 1]):
            if f != left and dot(whole.normals[f], d) * sense > 0.0:
                t = facet_distance(whole, f, p, d)
                if start < t < nearest:
                    nearest, facet = t, f
    return nearest, facet


@compiled
def facet_distance(whole, f, p, d):
    """Distance to a facet along a ray; inf where it passes by."""
    a = whole.corners[f, 0]
    e1, e2 = minus(whole.corners[f, 1], a), minus(whole.corners[f, 2], a)
    cross = crossed(d, e2)
    determinant = dot(cross, e1)
    if determinant == 0.0:
        return np.inf
    s = minus(p, a)
    u = dot(s, cross) / determinant
    if u < 0.0 or u > 1.0:
        return np.inf
    other = crossed(s, e1)
    v = dot(d, other) / determinant
    if v < 0.0 or u + v > 1.0:
        return np.inf
    return dot(e2, other) / determinant


@compiled
def interpolated(whole, f, q):
    """Normal at a point of a facet, from its corners' by the areas of the triangles opposite them."""
    normal = 0.0, 0.0, 0.0
    for k in range(3):
        cross = crossed(minus(whole.corners[f, (k + 1) % 3], q), minus(whole.corners[f, (k + 2) % 3], q))
        normal = plus(normal, times(np.sqrt(dot(cross, cross)), whole.corner_normals[f, k]))
    return times(1.0 / np.sqrt(dot(normal, normal)), normal)


@compiled
def follow(whole, start, heading, medium, refracts, thickness, index, vertices, faces):
    """Trace one ray through the array, refracted or reflected at each vertex as told.

    Return its fate, the number of vertices (written with their faces), where it is, its direction and its weight.
    """
    p, d, weight, left = row(start), row(heading), 1.0, -1
    for count in range(len(refracts) + 1):
        if medium == BEHIND:
            if d[2] > 0.0:
                return BACK, count, p, d, weight
            t, face, normal = (thickness - p[2]) / d[2], FLAT, (0.0, 0.0, 1.0)
            fate = GOES_ON if cell_at(whole, p, d, t) >= 0 else MOUNT
            # Of a mesh's flat face it does not matter which facet was left: the next one met faces the other way.
            left = -1
        elif len(whole.corners):
            fate, t, face, normal, left = next_on_mesh(whole, p, d, medium, left)
        else:
            fate, t, face, normal = next_on_spheres(whole, p, d, medium, thickness)
        if fate != GOES_ON:
            return fate, count, plus(p, times(t, d)), d, weight
        if count == len(refracts):
            break
        p = plus(p, times(t, d))
        vertices[count, 0], vertices[count, 1], vertices[count, 2] = p
        faces[count] = face
        n_i = index if medium == GLASS else 1.0
        d, share = turned(d, normal, n_i, 1.0 + index - n_i, refracts[count])
        if share == 0.0:
            return TOTAL, count, p, d, weight
        weight *= share
        if refracts[count]:
            medium = (AIR if face == CURVED else BEHIND) if medium == GLASS else GLASS
    return GOES_ON, count, p, d, weight


def scene_of(layout, curved_side, focal_length_mm, surface="exact", **form):
    """A camera whose 8 × 8 array is held between a weak lens and a wide sensor, with room for rays on both sides."""
    return lf.Scene(
        camera=lf.Camera(
            lens=lf.Lens(
                surfaces=(
                    lf.Surface(radius_mm=40.0, thickness_mm=4.0, index=1.5, semi_diameter_mm=6.0, stop=True),
                    lf.Surface(radius_mm=-40.0, semi_diameter_mm=6.0),
                )
            ),
            mla=lf.MicrolensArray(
                layout=layout,
                count=(8, 8),
                pitch_mm=PITCH_MM,
                focal_length_mm=focal_length_mm,
                index=INDEX,
                thickness_mm=THICKNESS_MM,
                curved_side=curved_side,
                distance_mm=30.0,
                form=lf.ArrayForm(**form),
            ),
            sensor=lf.Sensor(pixels=(1000, 1000), pixel_mm=0.02, distance_mm=SENSOR_MM),
        ),
        transport=lf.Transport(surface=surface),
    )


def array_frame(scene):
    """z of the curved apexes, and the sign with which z of the array's frame runs along that of the camera."""
    face = scene.camera.lens.vertices_mm[-1] + scene.camera.mla.distance_mm
    return (face, 1.0) if scene.camera.mla.curved_side == "lens" else (face + THICKNESS_MM, -1.0)


def cell_centres(layout, pitch):
    """(64, 2) centres row by row, and the type of each lenslet in an array of two (square) or three (hexagonal)."""
    row, column = (index.ravel() for index in np.indices((8, 8)))
    if layout == "square":
        return np.column_stack([column - 3.5, row - 3.5]) * pitch, (column + row) % 2
    x = column - 3.5 + np.where(row % 2, 0.25, -0.25)
    # In axial coordinates q, r the colour q − r modulo 3 differs from that of all six neighbours.
    return np.column_stack([x, (row - 3.5) * np.sqrt(0.75)]) * pitch, (column - row // 2 - row) % 3


def whole_of(world):
    """The whole array from its mesh and its prescription; its spheres are the ones that the mesh's vertices lie on."""
    mla, surface = world.scene.camera.mla, world.scene.transport.surface
    pitch = PITCH_MM * (1.0 + mla.form.pitch_error)
    centre, kind = cell_centres(mla.layout, pitch)
    radius = np.array(mla.radius_mm)[kind if mla.types > 1 else np.zeros(64, int)]
    apex = np.zeros((64, 2))
    drawn = world.tables.mla.lenslets
    if mla.form.decenter_mm:
        apex = drawn.decentre
    if mla.form.radius_error:
        radius = radius / drawn.stretch
    top = min(0.0, *(r - np.sign(r) * np.sqrt(r * r - mla.corner_mm**2) for r in mla.radius_mm))
    apex_z, sign = array_frame(world.scene)
    mesh = world.mesh("mla")
    corners = (np.asarray(mesh.vertices) - [0.0, 0.0, apex_z])[mesh.faces] * [1.0, 1.0, sign]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals *= sign / np.linalg.norm(normals, axis=1, keepdims=True)
    middle = corners.mean(axis=1)[:, :2]
    cell = np.argmin(np.linalg.norm(middle[:, None] - centre, axis=2), axis=1)
    order = np.argsort(cell, kind="stable")
    cell, corners, normals = cell[order], corners[order], normals[order]
    sphere = np.column_stack([centre + apex, radius])[cell]
    exact = (sphere[:, None] - corners) / radius[cell, None, None]
    curved = normals[:, 2] < -1e-9
    assert curved.any()
    np.testing.assert_allclose(np.linalg.norm(exact[curved], axis=2), 1.0, rtol=0, atol=1e-12)
    first = np.searchsorted(cell, np.arange(65))
    if surface == "exact":
        corners, normals, exact = corners[:0], normals[:0], exact[:0]
    elif surface == "flat":
        exact = np.repeat(-normals[:, None], 3, axis=1)
    hexagonal = mla.layout == "hexagonal"
    return Whole(hexagonal, pitch, centre, 1.0 / radius, apex, top, corners, normals, exact, first)


def rays(scene, from_lens, seed, count):
    """Rays at up to 40° of incidence on the array and a little round it, in the world's frame."""
    draw = np.random.default_rng(seed)
    near, sign = array_frame(scene)
    far = near + sign * THICKNESS_MM
    z = min(near, far) if from_lens else max(near, far)
    half = 4.3 * PITCH_MM
    at = np.column_stack([draw.uniform(-half, half, size=(count, 2)), np.full(count, z)])
    angle = np.arccos(draw.uniform(np.cos(np.deg2rad(40.0)), 1.0, size=count))
    turn = draw.uniform(0.0, 2 * np.pi, size=count)
    d = np.column_stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)])
    if not from_lens:
        d[:, 2] *= -1.0
    return at - 0.5 * d, d


def on_the_array(path):
    """The recorded vertices of a path from its start to where it first leaves the array; the rest is dropped."""
    kept = []
    for vertex in path[1:]:
        if vertex.surface not in ("mla curved face", "mla flat face"):
            break
        kept.append(vertex)
    return kept


def assert_near(found, expected, allowed):
    """As `numpy.testing.assert_allclose`, which takes most of the time when asked about every packet."""
    assert (np.abs(found - expected) <= allowed).all(), (found, expected)


def assert_every_packet_agrees(world, whole, split, from_lens, seed, count):
    """Trace rays both ways; return how often each fate occurred and the most vertices of a path."""
    apex_z, sign = array_frame(world.scene)
    origins, directions = rays(world.scene, from_lens, seed, count)
    starts, headings = (origins - [0, 0, apex_z]) * [1, 1, sign], directions * [1, 1, sign]
    medium = AIR if from_lens == (sign > 0) else BEHIND
    paths = lf.trace(world, origins, directions, split=split, record=True, weight_cutoff=0.0, max_events=MOST_VERTICES)
    fates, longest = np.zeros(6, int), 0
    vertices, faces = np.zeros((MOST_VERTICES + 1, 3)), np.zeros(MOST_VERTICES + 1, int)
    for packet in range(len(paths)):
        path = paths.vertices(packet)
        kept = on_the_array(path)
        last = path[len(kept) + 1]
        source = paths.source[packet]
        refracts = np.array([v.event.name == "TRANSMITTED" for v in kept], dtype=np.bool_)
        fate, met, end, on, weight = follow(
            whole, starts[source], headings[source], medium, refracts, THICKNESS_MM, INDEX, vertices, faces
        )
        assert [v.surface for v in kept] == [("mla curved face", "mla flat face")[face] for face in faces[:met]]
        found = (np.array([v.position for v in kept]).reshape(-1, 3) - [0, 0, apex_z]) * [1, 1, sign]
        assert_near(found, vertices[:met], POSITION_MM)
        assert abs(weight - (kept[-1].weight if kept else 1.0)) < 1e-10
        longest = max(longest, met)
        if last.surface == "depth":
            continue
        fates[fate] += 1
        if fate in BODY:
            assert last.surface == BODY[fate]
        elif (fate == BACK) == (sign > 0):
            assert last.surface in ("sensor", "beside the sensor")
            # The mesh's corners carry the world's rounding, 7e-15 mm over facets of 0.01 mm. Of a ray that leaves at
            # grazing incidence only what is parallel to the array tells the direction that well.
            heading = paths.direction[packet] * [1, 1, sign]
            assert_near(heading[:2], on[:2], PARALLEL)
            assert heading[2] * on[2] > 0.0
            sensor = THICKNESS_MM + SENSOR_MM if sign > 0 else -SENSOR_MM
            run = (sensor - end[2]) / heading[2]
            landing = (last.position - [0, 0, apex_z]) * [1, 1, sign]
            assert_near(landing, end + run * heading, POSITION_MM * (1.0 + run))
        else:
            assert not last.surface.startswith(("mla", "sensor", "beside"))
    # A ray without a packet is one that total reflection ends because reflections are not followed.
    onward = np.ones(MOST_VERTICES, np.bool_)
    for source in np.setdiff1d(np.arange(count), paths.source):
        fate = follow(whole, starts[source], headings[source], medium, onward, THICKNESS_MM, INDEX, vertices, faces)[0]
        fates[fate] += 1
        assert (split, fate) == ("transmit", TOTAL)
    return fates, longest


def assert_arrays_agree(scene, count):
    """Compare rays from both sides, on the transmitted path and on all paths; return what absorbed some of them."""
    world = lf.build(scene)
    whole = whole_of(world)
    fates, longest = np.zeros(6, int), 0
    for seed, (split, from_lens) in enumerate(product(("transmit", "both"), (True, False))):
        number = count if split == "transmit" else count // 10
        some, length = assert_every_packet_agrees(world, whole, split, from_lens, seed, number)
        fates += some
        longest = max(longest, length)
    assert longest == MOST_VERTICES
    assert fates[FRONT] > count // 2
    assert fates[BACK] > count // 2
    return set(np.flatnonzero(fates)) - {FRONT, BACK, TOTAL}


ARRAYS = {
    "square": ("square", (0.5,)),
    "square of two types": ("square", (0.5, 0.4)),
    "hexagonal": ("hexagonal", (0.5,)),
    "hexagonal of three types": ("hexagonal", (0.5, 0.45, 0.56)),
    "hexagonal, diverging": ("hexagonal", (-0.5,)),
}


FACES = [("exact", "lens"), ("flat", "sensor"), ("smooth", "lens"), ("exact", "sensor"), ("flat", "lens")]
KEPT = [
    *((name, *FACES[0]) for name in ARRAYS), ("square of two types", *FACES[1]),
    ("hexagonal of three types", *FACES[2]), ("hexagonal, diverging", *FACES[3]),
]  # fmt: skip
"""Every array, and every kind of face once or more, by unlike lenslets, whose steps others do not have."""
ALL = [(name, *face) for name in ARRAYS for face in FACES]


@pytest.mark.parametrize(
    ("name", "surface", "curved_side"),
    [pytest.param(*each, marks=[] if each in KEPT else [pytest.mark.long]) for each in ALL],
)
def test_folded_array_is_the_whole_array(name, surface, curved_side):
    layout, focal_lengths = ARRAYS[name]
    absorbed_by = assert_arrays_agree(scene_of(layout, curved_side, focal_lengths, surface), RAYS)
    # Only unlike neighbours meet in a step.
    assert absorbed_by == {MOUNT, EDGE} | ({WALL} if len(focal_lengths) > 1 else set())


@pytest.mark.long
@pytest.mark.parametrize("surface", ["exact", "flat", "smooth"])
@pytest.mark.parametrize("name", ARRAYS)
def test_folded_array_is_the_whole_array_for_many_rays(name, surface):
    layout, focal_lengths = ARRAYS[name]
    assert_arrays_agree(scene_of(layout, "lens", focal_lengths, surface), 20 * RAYS)


@pytest.mark.parametrize("curved_side", ["lens", "sensor"])
@pytest.mark.parametrize("layout", ["square", "hexagonal"])
def test_lenslets_with_form_errors_are_met_on_their_own_displaced_spheres(layout, curved_side):
    scene = scene_of(layout, curved_side, (0.5,), decenter_mm=0.006, radius_error=0.1, pitch_error=0.01, seed=4)
    absorbed_by = assert_arrays_agree(scene, RAYS)
    assert absorbed_by == {MOUNT, EDGE, WALL}
    world = lf.build(scene)
    whole = whole_of(world)
    assert np.ptp(whole.curvature) > 0.2 * whole.curvature.mean()
    assert np.abs(whole.apex).max() > 0.005
    apex_z, sign = array_frame(world.scene)
    origins, directions = rays(scene, curved_side == "lens", 9, RAYS)
    paths = lf.trace(world, origins, directions, split="transmit", record=True)
    met = [v for i in range(len(paths)) for v in paths.vertices(i) if v.surface == "mla curved face"]
    assert len(met) > 0.5 * RAYS
    p = (np.array([v.position for v in met]) - [0.0, 0.0, apex_z]) * [1.0, 1.0, sign]
    cell = np.argmin(np.linalg.norm(p[:, None, :2] - whole.centre, axis=2), axis=1)
    radius = 1.0 / whole.curvature[cell]
    centre = np.column_stack([(whole.centre + whole.apex)[cell], radius])
    # The vertices are given in the world's frame, 34 mm off, whose rounding is 7e-15 mm.
    np.testing.assert_allclose(np.linalg.norm(p - centre, axis=1), radius, rtol=1e-12, atol=3e-14)


@pytest.mark.parametrize("form", [{"decenter_mm": 0.001}, {"radius_error": 0.01}])
@pytest.mark.parametrize("surface", ["flat", "smooth"])
def test_form_errors_of_single_lenslets_need_exact_surfaces(surface, form):
    with pytest.raises(lf.SceneError, match=r"camera\.mla\.form"):
        lf.build(scene_of("square", "lens", (0.5,), surface, **form))
