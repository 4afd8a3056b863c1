"""Meshes of lens surfaces are fine where a neighbour comes near, coarse elsewhere, and never cross it."""

from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.geometry import frame
from lfmesh.geometry.lens.air_gaps import Circles, cap_on, circles_of
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.geometry.surfaces.sag import sag
from lfmesh.geometry.surfaces.surface import put_in_pose, surface
from lfmesh.geometry.surfaces.tessellation import cap, height_above, rim_radius
from lfmesh.scene import Scene

WEIGHTS = np.random.default_rng(1).dirichlet([1.0, 1.0, 1.0], 24)


def pair(draw: np.random.Generator, where: str, gap: float, posed: bool = False) -> np.ndarray:
    """Two surfaces whose gap is smallest at the centre or at the edge."""
    aperture = float(draw.uniform(4.0, 12.0))
    c = np.sort(draw.uniform(-0.6, 0.6, 2)) / aperture
    front_c, back_c = c if where == "centre" else c[::-1]
    front, back = (surface(1.0 / k, draw.uniform(-1.0, 0.3), semi_diameter=aperture) for k in (front_c, back_c))
    between = np.linspace(0.0, 1.0201 * aperture, 1001)
    back["vertex_z"] = gap + float(np.max(sag(front, between) - sag(back, between)))
    if posed:
        turn = np.deg2rad(0.02)
        tilt = [[1.0, 0.0, 0.0], [0.0, np.cos(turn), -np.sin(turn)], [0.0, np.sin(turn), np.cos(turn)]]
        put_in_pose(back, frame.inverse(np.column_stack([tilt, [0.0, 0.0, -0.002 * aperture]])))
    return np.array([front, back])


def points_on(mesh: Any) -> np.ndarray:
    return np.einsum("qk,mki->mqi", WEIGHTS, mesh.vertices[mesh.faces]).reshape(-1, 3)


@pytest.mark.parametrize("where", ["centre", "edge"])
@pytest.mark.parametrize("posed", [False, True])
def test_meshes_stay_on_their_side_of_the_middle_between_surfaces(where: str, posed: bool) -> None:
    """Each mesh deviates by less than half of the gap at its place, whatever the surfaces are."""
    draw = np.random.default_rng(3)
    for _ in range(12):
        surfaces = pair(draw, where, float(10 ** draw.uniform(-3.0, 0.0)), posed)
        circles = circles_of(surfaces, 5)
        for own, other in ((0, 1), (1, 0)):
            at = points_on(cap_on(surfaces[own], circles[own]))
            if surfaces[own]["posed"]:
                at = frame.points(surfaces[own]["pose"], at)
            off, _ = height_above(surfaces[own], at)
            away, aside = height_above(surfaces[other], at)
            near = aside < 1.02 * surfaces[other]["semi_diameter"]
            assert near.sum() > 1000
            # The gap is the distance to the other surface, less the mesh's own deviation.
            assert (np.abs(off) < 0.5 * np.abs(away - off))[near].all()


def test_meshes_are_not_fine_far_from_a_gap_that_closes_at_the_edge() -> None:
    front, back = surface(25.0, semi_diameter=10.0), surface(40.0, semi_diameter=10.0)
    back["vertex_z"] = 1e-3 + float(sag(front, 10.202) - sag(back, 10.202))
    surfaces = np.array([front, back])
    circles = circles_of(surfaces, 5)
    assert circles[0].counts[-1] == circles[1].counts[-1] > 300
    for s, c in zip(surfaces, circles, strict=True):
        assert np.diff(c.radii)[-1] < 0.1 * np.diff(c.radii)[0]
        assert len(cap_on(s, c).faces) < 5000


def test_far_neighbours_change_nothing() -> None:
    surfaces = np.array([surface(50.0, semi_diameter=10.0), surface(-50.0, vertex_z=8.0, semi_diameter=10.0)])
    for s, c in zip(surfaces, circles_of(surfaces, 5), strict=True):
        assert c.even
        np.testing.assert_array_equal(c.counts, [1, 6, 12, 18, 24, 30])
        plain = cap(s, 5, rim_radius(s, 5))
        np.testing.assert_allclose(cap_on(s, c).vertices, plain.vertices, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("counts", [(1, 6), (1, 6, 30, 30, 12), (1, 7, 720, 5)])
def test_circles_of_any_numbers_of_points_make_a_disk_that_faces_plus_z(counts: tuple[int, ...]) -> None:
    mesh = cap_on(surface(np.inf, semi_diameter=10.0), Circles(np.linspace(0.0, 10.0, len(counts)), np.array(counts)))
    rim = counts[-1]
    corners = mesh.vertices[mesh.faces][:, :, :2]
    ahead, aside = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    signed = 0.5 * (ahead[:, 0] * aside[:, 1] - ahead[:, 1] * aside[:, 0])
    assert signed.sum() == pytest.approx(0.5 * rim * 100.0 * np.sin(2 * np.pi / rim), rel=1e-12)
    if counts != (1, 7, 720, 5):
        # Facets between a circle of 720 points and the pentagon outside it overlap.
        assert (signed > 0.0).all()
    edges = np.sort(np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]), axis=1)
    _, times = np.unique(edges, axis=0, return_counts=True)
    assert np.bincount(times).tolist() == [0, rim, (3 * len(mesh.faces) - rim) // 2]


def doublet(gap: float, radii: tuple[float, float], at_edge: bool) -> Scene:
    """Two lenses of semi-diameter 10 mm whose air gap is that wide at the edge or at the centre."""
    front, back = (surface(r) for r in radii)
    apart = gap + float(sag(front, 10.0) - sag(back, 10.0)) * at_edge
    shape = ((50.0, 4.0, 1.6), (radii[0], apart, None), (radii[1], 3.0, 1.5), (-80.0, None, None))
    keys = "radius_mm", "thickness_mm", "index"
    listed = [dict(zip(keys, values, strict=True)) | {"semi_diameter_mm": 10.0} for values in shape]
    listed[0]["stop"] = True
    sensor = {"pixels": [40, 40], "pixel_mm": 1.0, "distance_mm": 30.0}
    return Scene(camera={"lens": {"surfaces": listed}, "sensor": sensor})


@pytest.mark.parametrize(
    ("gap", "radii", "at_edge"),
    [(0.01, (25.0, 40.0), True), (0.002, (25.0, 40.0), True), (1e-4, (-60.0, 40.0), False)],
)
def test_rays_through_a_narrow_gap_agree_with_those_without_a_mesh(
    gap: float, radii: tuple[float, float], at_edge: bool
) -> None:
    """Meshes of a few thousand triangles, ray by ray to 1e-9 mm; rings of equal width made 350,000."""
    made = doublet(gap, radii, at_edge)
    shape = solved_camera(made).lens_shape()
    assert sum(len(mesh.faces) for mesh in (*shape.caps, *shape.closures)) < 20_000
    world = lf.build(made, aimed=False)
    draw = np.random.default_rng(11)
    r, phi = 9.99 * np.sqrt(draw.uniform(0.0, 1.0, 4000)), draw.uniform(0.0, 2 * np.pi, 4000)
    d = np.column_stack([draw.uniform(-0.2, 0.2, (4000, 2)), np.ones(4000)])
    o = np.column_stack([r * np.cos(phi), r * np.sin(phi), np.full(4000, 1.0)]) - 20.0 * d
    mesh, order = (lf.trace(world, o, d, split="transmit", engine=engine) for engine in ("mesh", "sequential"))
    assert mesh.ledger.lost_share == 0.0
    lands, others = mesh.status == lf.Status.SENSOR, order.status == lf.Status.SENSOR
    np.testing.assert_array_equal(mesh.source[lands], order.source[others])
    assert lands.sum() > 500
    np.testing.assert_allclose(mesh.position[lands], order.position[others], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(mesh.weight[lands], order.weight[others], rtol=1e-12)
