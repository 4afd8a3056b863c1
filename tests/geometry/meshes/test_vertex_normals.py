"""Normals estimated at vertices: their order on uneven meshes, and the creases that they keep."""

import numpy as np
import pytest
import trimesh

from lfmesh.geometry.meshes.mesh import Mesh, facet_normals
from lfmesh.geometry.meshes.vertex_normals import estimated_corner_normals, is_closed, smooth_edges, smooth_groups
from lfmesh.geometry.meshes.weld import welded
from lfmesh.geometry.surfaces.edges import ring_profile
from lfmesh.geometry.surfaces.sag import normals, sag
from lfmesh.geometry.surfaces.surface import surface
from lfmesh.geometry.surfaces.tessellation import cap, element, revolved
from tests.instances import instances

ASPHERE = surface(45.0, -1.2, (3e-6, -2e-9), semi_diameter=12.0)


def on_surface(flat):
    """(n, 3) points of the asphere over points of the plane."""
    return np.column_stack([flat, sag(ASPHERE, np.hypot(*flat.T))])


def even(rings):
    return cap(ASPHERE, rings, 12.0)


def graded(rings):
    """Rings that crowd towards the axis: neighbours on one side are up to three times as far as on the other."""
    mesh = even(rings)
    r = np.hypot(*mesh.vertices[:, :2].T)
    return Mesh(on_surface(mesh.vertices[:, :2] * (0.4 + 0.6 * r / 12.0)[:, None]), mesh.faces)


def jittered(rings):
    """Every inner vertex moved aside by up to a quarter of the facets' size."""
    mesh = even(rings)
    moved = mesh.vertices[:, :2] + np.random.default_rng(7).uniform(-0.25, 0.25, (len(mesh.vertices), 2)) * 12.0 / rings
    inner = np.hypot(*mesh.vertices[:, :2].T) < 12.0 * (1.0 - 0.5 / rings)
    return Mesh(on_surface(np.where(inner[:, None], moved, mesh.vertices[:, :2])), mesh.faces)


def skewed(rings):
    """A sheared grid, all diagonals the same way: no vertex has a symmetric neighbourhood."""
    at = np.linspace(-8.0, 8.0, 2 * rings + 1)
    x, y = np.meshgrid(at, at)
    low = (np.arange(2 * rings)[:, None] * (2 * rings + 1) + np.arange(2 * rings)).ravel()
    up = low + 2 * rings + 1
    faces = np.concatenate([np.column_stack([low, low + 1, up + 1]), np.column_stack([low, up + 1, up])])
    return Mesh(on_surface(np.column_stack([(x + 0.6 * y * y / 8.0).ravel(), y.ravel()]) * 0.6), faces)


def tilts(mesh, found):
    """(corners,) angles in rad between corner normals and the surface's own."""
    corner = mesh.vertices[mesh.faces].reshape(-1, 3)
    return np.linalg.norm(found.reshape(-1, 3) - normals(ASPHERE, *corner[:, :2].T), axis=1)


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


def averaged(mesh):
    """Corner normals as trimesh makes them."""
    made = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).vertex_normals
    return np.asarray(made)[mesh.faces]


MESHES = {"even": even, "graded": graded, "jittered": jittered, "skewed": skewed}


@pytest.mark.parametrize("name", instances(MESHES, long=["even", "jittered"]))
def test_estimated_normals_are_of_second_order(name):
    make = MESHES[name]
    rings = np.array([12, 24, 48, 96])
    ours, means = [], []
    for n in rings:
        mesh = make(n)
        one = np.zeros(len(mesh.faces), np.int64)
        ours.append(tilts(mesh, estimated_corner_normals(mesh, one)))
        means.append(tilts(mesh, averaged(mesh)))

    def order(errors):
        return -np.polyfit(np.log(rings), np.log(errors), 1)[0]

    assert order([rms(e) for e in ours]) > 1.9
    # The worst are at the rims, where neighbours stand on one side only; they fall as fast.
    assert order([e.max() for e in ours]) > 1.8
    # The mean of the facets' normals, which mesh libraries give, is of first order there.
    assert order([e.max() for e in means]) < 1.2
    assert ours[-1].max() < 0.01 * means[-1].max()


def solid(mesh):
    body = welded(Mesh(np.array(mesh.vertices, float), np.array(mesh.faces, np.int64)))
    return Mesh(body.vertices, body.faces[facet_normals(body)[1] > 0.0])


def groups_of(mesh, crease_deg=None):
    return smooth_groups(mesh, smooth_edges(mesh, crease_deg))


def test_a_cube_keeps_six_faces_with_their_own_normals():
    cube = solid(trimesh.creation.box((2.0, 3.0, 4.0)).subdivide())
    groups = groups_of(cube)
    assert groups.max() + 1 == 6
    own = np.repeat(facet_normals(cube)[0][:, None], 3, axis=1)
    np.testing.assert_allclose(estimated_corner_normals(cube, groups), own, rtol=0, atol=1e-14)


def test_a_cylinder_keeps_its_wall_round_and_its_ends_flat():
    body = solid(trimesh.creation.cylinder(radius=5.0, height=8.0, sections=64))
    groups = groups_of(body)
    assert groups.max() + 1 == 3
    facets = facet_normals(body)[0]
    found = estimated_corner_normals(body, groups)
    on_wall = np.abs(facets[:, 2]) < 0.5
    np.testing.assert_allclose(found[~on_wall], np.repeat(facets[~on_wall][:, None], 3, axis=1), rtol=0, atol=1e-12)
    radial = body.vertices[body.faces[on_wall]] * [1.0, 1.0, 0.0] / 5.0
    # Facets lean by 49 mrad from the wall that they stand for.
    assert np.linalg.norm(found[on_wall] - radial, axis=2).max() < 1e-3


def plano_convex(rings=12):
    """A curved and a flat face, and the edge between them."""
    front, back = surface(30.0, semi_diameter=10.0), surface(np.inf, vertex_z=4.0, semi_diameter=10.0)
    edge = revolved(ring_profile(front, 10.0, back, 10.0), 6 * rings)
    return solid(element(cap(front, rings, 10.0), edge, cap(back, rings, 10.0)))


def test_a_plano_convex_element_keeps_its_rims_sharp():
    lens = plano_convex()
    groups = groups_of(lens)
    found = estimated_corner_normals(lens, groups)
    facets = facet_normals(lens)[0]
    flat, curved = facets[:, 2] > 0.99, facets[:, 2] < -0.5
    edge = set(groups[~flat & ~curved])
    one_flat, one_curved = set(groups[flat]), set(groups[curved])
    assert len(one_flat) == len(one_curved) == 1
    assert not one_flat & one_curved
    assert not edge & (one_flat | one_curved)
    np.testing.assert_allclose(found[flat], np.broadcast_to([0.0, 0.0, 1.0], found[flat].shape), rtol=0, atol=1e-12)
    centre = np.array([0.0, 0.0, 30.0])
    exact = (lens.vertices[lens.faces[curved]] - centre) / 30.0
    # At the rim as well, where a mean would lean towards the edge.
    assert np.linalg.norm(found[curved] - exact, axis=2).max() < 2e-4


@pytest.mark.parametrize(("crease_deg", "faces"), [(44.0, 3), (46.0, 1)])
def test_the_users_crease_angle_is_followed(crease_deg, faces):
    """Three faces of a prism of sixteen sides round 45 degrees: a bevel between two squares."""
    profile = np.array([[2.0, -2.0], [2.0, 1.0], [1.0, 2.0], [0.0, 2.0]])
    strip = [(0, 1), (1, 2), (2, 3)]
    vertices = np.concatenate([np.column_stack([profile, np.full(4, y)]) for y in (0.0, 1.0)])
    quads = np.concatenate([[[a, b, b + 4], [a, b + 4, a + 4]] for a, b in strip])
    bevel = Mesh(vertices, quads)
    assert groups_of(bevel, crease_deg).max() + 1 == faces
    found = estimated_corner_normals(bevel, groups_of(bevel, crease_deg))
    own = facet_normals(bevel)[0]
    split = np.linalg.norm(found - own[:, None], axis=2).max()
    assert (split < 1e-12) == (faces == 3)


def test_an_edge_of_three_facets_joins_nothing():
    fin = Mesh(
        np.array([[0.0, 0, 0], [1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0], [0, 0, 1.0]]),
        np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]]),
    )
    assert not smooth_edges(fin, 179.0).any()


BALL = trimesh.creation.icosphere(1).faces
FACES = {
    "ball": BALL,
    "box": trimesh.creation.box().faces,
    "hole": BALL[1:],
    "one facet turned": np.concatenate([BALL[:1, ::-1], BALL[1:]]),
    "all facets turned": BALL[:, ::-1],
    "a fin": np.concatenate([BALL, [[*BALL[0, :2], BALL.max() + 1]]]),
    "a facet twice": np.concatenate([BALL, BALL[:1]]),
    "two balls": np.concatenate([BALL, BALL + BALL.max() + 1]),
    "nothing": np.zeros((0, 3), np.int64),
}


@pytest.mark.parametrize("faces", FACES.values(), ids=FACES)
def test_a_mesh_is_closed_where_trimesh_finds_it_watertight_and_of_one_winding(faces):
    body = trimesh.Trimesh(np.random.default_rng(3).normal(size=(faces.max(initial=0) + 1, 3)), faces, process=False)
    assert is_closed(faces) == (body.is_watertight and body.is_winding_consistent)
