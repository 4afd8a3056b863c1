"""Caps and solids: closed, outward, of the right volume, converging with the square of the facet size."""

import numpy as np
import pytest

from lfmesh.errors import SceneError
from lfmesh.geometry.lens.surface_gaps import end_where_they_touch
from lfmesh.geometry.meshes.mesh import facet_normals
from lfmesh.geometry.surfaces.edges import ANNULUS_LEAN, ring_profile
from lfmesh.geometry.surfaces.sag import normals, reach, sag
from lfmesh.geometry.surfaces.surface import surface
from lfmesh.geometry.surfaces.tessellation import (
    cap,
    chord_error,
    disk_pattern,
    element,
    last_radius,
    mesh_sag,
    revolved,
    rim_radius,
    ring_radii,
    rings_for,
)

CURVED = {
    "sphere": surface(30.0, semi_diameter=12.0),
    "hyperboloid": surface(-35.0, -2.3, semi_diameter=12.0),
    "asphere": surface(45.0, -1.2, (3e-6, -2e-9), semi_diameter=12.0),
    "hemisphere": surface(10.0, semi_diameter=10.0),
}


def sampled_chord_error(of, mesh):
    """Largest distance along z between surface and mesh over a grid of points in every facet."""
    grid = np.array([(i, j, 8 - i - j) for i in range(9) for j in range(9 - i)]) / 8.0
    p = np.einsum("gk,fkj->fgj", grid, mesh.vertices[mesh.faces]).reshape(-1, 3)
    return np.abs(p[:, 2] - of["vertex_z"] - sag(of, np.hypot(p[:, 0], p[:, 1]))).max()


@pytest.mark.parametrize("rings", [1, 2, 5])
def test_disk_pattern_is_a_disk_that_faces_plus_z(rings):
    ring, azimuth, faces = disk_pattern(rings)
    assert len(faces) == 6 * rings**2
    edges = {frozenset(edge) for f in faces for edge in (f[:2], f[1:], f[[2, 0]])}
    assert len(ring) - len(edges) + len(faces) == 1  # Euler
    x, y = ring * np.cos(azimuth), ring * np.sin(azimuth)
    a, b, c = faces.T
    assert ((x[b] - x[a]) * (y[c] - y[a]) > (x[c] - x[a]) * (y[b] - y[a])).all()


@pytest.mark.parametrize("of", CURVED.values(), ids=CURVED)
def test_cap_lies_on_the_surface_with_its_normals(of):
    mesh = cap(of, 6, rim_radius(of, 6))
    # A vertex beyond the surface's end has the height and the normal of the end, at its azimuth.
    r = np.hypot(*mesh.vertices[:, :2].T)
    inside = np.minimum(1.0, np.divide(last_radius(of), r, out=np.ones_like(r), where=r > 0.0))
    x, y = inside * mesh.vertices[:, 0], inside * mesh.vertices[:, 1]
    beyond = r > last_radius(of)
    assert beyond.sum() == (36 if of["semi_diameter"] == 10.0 else 0)
    np.testing.assert_allclose(mesh.vertices[:, 2], sag(of, r * inside), rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(mesh.corner_normals, axis=2), 1.0, atol=1e-15)
    # Where the slope is infinite the rounding of the radius tilts the normal by its root.
    tilt = np.sqrt(np.finfo(float).eps) if beyond.any() else 0.0
    np.testing.assert_allclose(mesh.corner_normals, normals(of, x, y)[mesh.faces], rtol=0, atol=tilt)
    assert (facet_normals(mesh)[0][:, 2] > 0).all()


@pytest.mark.parametrize("rings", [1, 3, 12])
def test_the_rims_chords_stay_outside_the_clear_aperture(rings):
    of = CURVED["sphere"]
    rim = rim_radius(of, rings)
    assert rim * np.cos(np.pi / (6 * rings)) > of["semi_diameter"]


@pytest.mark.parametrize("rings", [1, 5, 8, 40])
def test_the_mesh_of_a_hemisphere_holds_its_last_circle_and_no_more_than_its_chords_need(rings):
    """A float32 query at the equator is to find a facet; what is beyond the end has the end's height."""
    of = CURVED["hemisphere"]
    rim = rim_radius(of, rings)
    past = rim * np.cos(np.pi / (6 * rings)) / 10.0 - 1.0
    assert np.finfo(np.float32).eps < past < 16 * np.finfo(np.float32).eps
    z = cap(of, rings, rim).vertices[:, 2]
    assert np.isfinite(z).all()
    # Where a double of the radius still has a sag: 7e-8 below the equator.
    assert 10.0 - 1e-6 < z.max() == mesh_sag(of, rim) < 10.0


def test_rings_are_equally_spaced_along_the_meridian_of_a_hemisphere():
    of = CURVED["hemisphere"]
    radii = ring_radii(of, 9, rim_radius(of, 9))
    angle = np.arcsin(np.minimum(radii / 10.0, 1.0))
    np.testing.assert_allclose(np.diff(angle), np.pi / 18, rtol=2e-3)


def touching(aperture_mm):
    """Two spheres of 50 mm whose air gap closes 8 mm from the axis."""
    gap = 2.0 * (50.0 - np.sqrt(50.0**2 - 8.0**2))
    front, back = surface(50.0, semi_diameter=aperture_mm), surface(-50.0, vertex_z=gap, semi_diameter=aperture_mm)
    return np.array([front, back])


@pytest.mark.parametrize("aperture_mm", [8.0, 7.99, 7.9])
def test_surfaces_that_touch_at_their_rims_end_there_and_their_meshes_do_not_cross(aperture_mm):
    pair = touching(aperture_mm)
    assert rim_radius(pair[0], 5) > 8.0  # else the test asks nothing
    end_where_they_touch(pair, 5)
    np.testing.assert_allclose(pair["end"], 8.0, rtol=1e-12)
    np.testing.assert_allclose([reach(s) for s in pair], pair["end"])
    for rings in (5, 12):
        front, back = (cap(s, rings, rim_radius(s, rings)) for s in pair)
        np.testing.assert_allclose(front.vertices[:, :2], back.vertices[:, :2], rtol=0, atol=1e-12)
        apart = back.vertices[:, 2] - front.vertices[:, 2]
        assert apart.min() > -1e-12
        assert apart.max() > 1.2


def test_surfaces_that_stay_apart_have_no_end_of_their_own():
    pair = touching(7.0)
    end_where_they_touch(pair, 5)
    np.testing.assert_array_equal(pair["end"], np.inf)


@pytest.mark.parametrize("name", ["sphere", "hyperboloid", "asphere"])
def test_chord_error_falls_with_the_square_of_the_facet_size_and_is_bounded(name):
    of = CURVED[name]
    errors = []
    for rings in (8, 16, 32):
        mesh = cap(of, rings, 12.0)
        errors.append(sampled_chord_error(of, mesh))
        assert errors[-1] <= chord_error(of, rings, 12.0) < 3.0 * errors[-1]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(orders, 2.0, atol=0.15)


def biconvex(rings):
    front = surface(50.0, semi_diameter=10.0)
    back = surface(-40.0, vertex_z=6.0, semi_diameter=8.0)
    profile = ring_profile(front, 10.0, back, 8.0)
    ring = revolved(profile, 6 * rings)
    return element(cap(front, rings, 10.0), ring, cap(back, rings, 8.0)).solid()


def cap_volume(radius, rim):
    height = radius - np.sqrt(radius**2 - rim**2)
    return np.pi * height**2 * (3 * radius - height) / 3


def test_a_lens_is_a_closed_outward_solid_whose_volume_converges_to_the_closed_form():
    edge = 6.0 - (40.0 - np.sqrt(40.0**2 - 8.0**2)) - (50.0 - np.sqrt(50.0**2 - 10.0**2))
    lean = ANNULUS_LEAN * edge
    cylinder = np.pi * 10.0**2 * (edge - lean)
    annulus = np.pi * lean * (10.0**2 + 10.0 * 8.0 + 8.0**2) / 3  # a flat cone, cut off
    truth = cap_volume(50.0, 10.0) + cap_volume(40.0, 8.0) + cylinder + annulus
    errors = []
    for rings in (6, 12, 24):
        solid = biconvex(rings)
        assert solid.is_watertight
        assert solid.is_winding_consistent
        assert solid.is_volume
        errors.append(truth - solid.volume)
    assert min(errors) > 0  # chords lie inside
    assert errors[-1] < 1e-3 * truth
    np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), 2.0, atol=0.1)


def test_edges_are_turned_cylinders_with_an_annulus_that_leans_into_their_space():
    front, back = surface(50.0, semi_diameter=10.0), surface(-40.0, vertex_z=6.0, semi_diameter=8.0)
    profile = ring_profile(front, 10.0, back, 8.0)
    z_front, z_back = sag(front, 10.0), 6.0 + sag(back, 8.0)
    corner = z_back - ANNULUS_LEAN * (z_back - z_front)
    np.testing.assert_allclose(profile, [(10.0, z_front), (10.0, corner), (8.0, z_back)])
    same = ring_profile(front, 8.0, back, 8.0)
    np.testing.assert_allclose(same, [(8.0, sag(front, 8.0)), (8.0, z_back)])
    wider_back = ring_profile(
        surface(50.0, semi_diameter=8.0), 8.0, surface(-40.0, vertex_z=6.0, semi_diameter=10.0), 10.0
    )
    (_, z_front), (_, corner), (_, z_back) = wider_back
    np.testing.assert_allclose(wider_back[:, 0], (8.0, 10.0, 10.0))
    np.testing.assert_allclose(corner - z_front, ANNULUS_LEAN * (z_back - z_front))


def test_the_rings_on_both_sides_of_a_rim_never_lie_in_one_plane():
    before, narrow = surface(np.inf, vertex_z=-3.0, semi_diameter=10.0), surface(60.0, vertex_z=2.0, semi_diameter=8.0)
    after = surface(-40.0, vertex_z=6.0, semi_diameter=10.0)
    front, back = ring_profile(before, 10.0, narrow, 8.0), ring_profile(narrow, 8.0, after, 10.0)
    assert front[1, 0] == back[1, 0] == 10.0  # both have an annulus from the narrow rim outwards ...
    assert front[1, 1] < narrow["vertex_z"] + sag(narrow, 8.0) < back[1, 1]  # ... that leans to its own side


def test_an_annulus_that_would_cut_a_surface_becomes_a_cone():
    # A thin meniscus: the flat annulus at the smaller back rim's height would cross the front surface.
    front, back = surface(20.0, semi_diameter=12.0), surface(18.0, vertex_z=2.0, semi_diameter=8.0)
    profile = ring_profile(front, 12.0, back, 8.0)
    np.testing.assert_allclose(profile, [(12.0, sag(front, 12.0)), (8.0, 2.0 + sag(back, 8.0))])


def test_rims_that_cross_are_refused_with_their_places():
    front, back = surface(20.0, semi_diameter=10.0), surface(-20.0, vertex_z=1.0, semi_diameter=10.0)
    with pytest.raises(SceneError, match="rims of two neighbouring surfaces cross"):
        ring_profile(front, 10.0, back, 10.0)


def test_rings_hold_a_sag_tolerance():
    one = np.array([CURVED["asphere"]])
    rings = rings_for(one, 4, tolerance_mm=1e-3)
    assert sampled_chord_error(one[0], cap(one[0], rings, rim_radius(one[0], rings))) < 1e-3
    assert rings_for(one, 4) == 4
