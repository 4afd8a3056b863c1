"""Glass from mesh files: what counts as a body, whose normals it has, and the lens that is measured on it."""

import numpy as np
import pytest
import trimesh

import lfmesh as lf
from lfmesh.errors import MeshError
from lfmesh.geometry.meshes.mesh import facet_normals
from lfmesh.geometry.objects.refractors import faces, solid_mesh
from lfmesh.geometry.surfaces.edges import ring_profile
from lfmesh.geometry.surfaces.surface import surface
from lfmesh.geometry.surfaces.tessellation import cap, element, revolved, rim_radius
from lfmesh.scene import Camera, Lens, MeshShape, Scene, Sensor, Surface

RADIUS = 5.0


def ball(subdivisions=1):
    return trimesh.creation.icosphere(subdivisions, RADIUS)


def with_normals(mesh, normals):
    copy = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    copy.vertex_normals = normals
    return copy


def saved(path, mesh):
    mesh.export(path)
    return path


def load(path, crease_deg=None):
    return solid_mesh(path, None if path.suffix == ".glb" else "mm", crease_deg)


def off_radial(mesh):
    """Largest angle in rad between the corner normals of a ball and its radii."""
    corner = mesh.vertices[mesh.faces]
    return np.linalg.norm(mesh.corner_normals - corner / np.linalg.norm(corner, axis=2, keepdims=True), axis=2).max()


@pytest.mark.parametrize("ending", ["obj", "ply", "glb"])
def test_the_normals_of_a_file_are_used_and_beat_the_estimate(tmp_path, ending):
    coarse = ball(2)
    given = load(saved(tmp_path / f"given.{ending}", with_normals(coarse, coarse.vertices / RADIUS)))
    bare = load(saved(tmp_path / f"bare.{ending}", trimesh.Trimesh(coarse.vertices, coarse.faces, process=False)))
    assert off_radial(given) < 2e-7  # the format's float32
    assert off_radial(bare) > 2e-3


def test_normals_need_not_be_unit_vectors(tmp_path):
    path = tmp_path / "long.obj"
    lines = [f"v {x} {y} {z}" for x, y, z in ball().vertices] + [f"vn {x} {y} {z}" for x, y, z in ball().vertices * 3]
    path.write_text("\n".join([*lines, *(f"f {a}//{a} {b}//{b} {c}//{c}" for a, b, c in ball().faces + 1)]))
    assert off_radial(load(path)) < 1e-12


def test_a_crease_angle_asks_for_estimates_in_their_place(tmp_path):
    tilted = ball().vertices / RADIUS + [0.1, 0.0, 0.0]
    path = saved(tmp_path / "tilted.ply", with_normals(ball(), tilted / np.linalg.norm(tilted, axis=1, keepdims=True)))
    assert off_radial(load(path)) > 0.09
    assert off_radial(load(path, 60.0)) < 0.01


@pytest.mark.parametrize("ending", ["obj", "ply", "glb"])
def test_flat_shading_says_no_more_than_the_facets_and_normals_are_estimated(tmp_path, ending):
    apart = trimesh.Trimesh(ball(2).triangles.reshape(-1, 3), np.arange(960).reshape(-1, 3), process=False)
    flat = with_normals(apart, np.repeat(apart.face_normals, 3, axis=0))
    body = load(saved(tmp_path / f"flat.{ending}", flat))
    own = facet_normals(body)[0][:, None]
    assert np.linalg.norm(body.corner_normals - own, axis=2).min() > 0.05
    assert off_radial(body) < 3e-3


def test_the_creases_of_a_file_are_where_its_normals_differ(tmp_path):
    """A wall of eight sides, smooth to its file, whose facets meet at 45 degrees."""
    body = trimesh.creation.cylinder(radius=RADIUS, height=4.0, sections=8)
    facets = np.asarray(body.face_normals)
    corner = np.asarray(body.triangles)
    radial = corner * [1.0, 1.0, 0.0] / RADIUS
    on_wall = np.abs(facets[:, 2]) < 0.5
    normals = np.where(on_wall[:, None, None], radial, facets[:, None])
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in corner.reshape(-1, 3).tolist()]
    lines += [f"vn {x!r} {y!r} {z!r}" for x, y, z in normals.reshape(-1, 3).tolist()]
    lines += [f"f {a}//{a} {b}//{b} {c}//{c}" for a, b, c in np.arange(1, corner.size // 3 + 1).reshape(-1, 3)]
    (tmp_path / "wall.obj").write_text("\n".join(lines))
    loaded = load(tmp_path / "wall.obj")
    wall = np.abs(facet_normals(loaded)[0][:, 2]) < 0.5
    here = loaded.vertices[loaded.faces]
    np.testing.assert_allclose(loaded.corner_normals[wall], here[wall] * [1.0, 1.0, 0.0] / RADIUS, atol=1e-12)
    ends = np.sign(here[~wall][:, :, 2:]) * [0.0, 0.0, 1.0]
    np.testing.assert_allclose(loaded.corner_normals[~wall], ends, atol=1e-12)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda n: np.where(np.arange(42)[:, None] == 7, 0.0, n), "5 of its 240 corner normals have no direction"),
        (lambda n: np.where(np.arange(42)[:, None] == 7, np.nan, n), "5 of its 240 corner normals have no direction"),
        (lambda n: np.where(np.arange(42)[:, None] < 2, -n, n), "corner normals point to the wrong side"),
        (lambda n: -n, "240 of its 240 corner normals point to the wrong side"),
        (lambda n: np.add(n, [0.0, 0.0, 0.9]), "corner normals deviate more from their facet than on a smooth surface"),
        (lambda n: n * [1.0, 1.0, 0.2], "corner normals deviate more from their facet than on a smooth surface"),
    ],
)
def test_bad_normals_are_refused_in_one_line_that_counts_them(tmp_path, spoil, said):
    unit = ball().vertices / RADIUS
    path = saved(tmp_path / "bad.ply", with_normals(ball(), spoil(unit)))
    with pytest.raises(MeshError, match=said) as raised:
        load(path)
    assert "\n" not in str(raised.value)
    assert "crease_deg" in str(raised.value)
    assert off_radial(load(path, 60.0)) < 0.01  # the way out that it names


def test_a_body_turned_inside_out_is_turned_back_with_its_normals(tmp_path):
    inwards = trimesh.Trimesh(ball().vertices, ball().faces[:, ::-1], process=False)
    body = load(saved(tmp_path / "inwards.ply", with_normals(inwards, -ball().vertices / RADIUS)))
    assert off_radial(body) < 2e-7
    assert trimesh.Trimesh(body.vertices, body.faces, process=False).volume > 0.0


@pytest.mark.parametrize("ending", ["stl", "ply", "off", "obj", "glb"])
def test_an_open_mesh_is_refused_as_glass_in_one_line(tmp_path, ending):
    whole = ball(2)
    path = saved(tmp_path / f"open.{ending}", trimesh.Trimesh(whole.vertices, whole.faces[3:], process=False))
    with pytest.raises(
        MeshError, match=r"a refractor must be a closed body; \d+ of its edges belong to only one facet"
    ) as e:
        load(path)
    assert "\n" not in str(e.value)


def test_doubled_facets_are_called_doubled(tmp_path):
    whole = ball(2)
    for again in (whole.faces[:5], whole.faces[:5, ::-1]):
        faces = np.concatenate([whole.faces, again])
        path = saved(tmp_path / "doubled.stl", trimesh.Trimesh(whole.vertices, faces, process=False))
        with pytest.raises(MeshError, match=rf"closed body; 5 of its {len(faces)} facets are duplicates"):
            load(path)


TETRAHEDRON = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]

WITHOUT_VOLUME = {
    "a point": ([[1.0, 1.0, 1.0]] * 4, TETRAHEDRON, "its facets have no area"),
    "a line": ([[x, x, 0.0] for x in (0.0, 1.0, 2.0, 3.0)], TETRAHEDRON, "its facets have no area"),
    "a flat sheet": ([[0, 0, 0], [1, 0, 0.3], [0, 1, 0.7]], [[0, 1, 2], [0, 2, 1]], "all lie in one plane"),
}


@pytest.mark.parametrize("ending", ["stl", "obj", "ply", "off", "glb"])
@pytest.mark.parametrize(("vertices", "facets", "why"), WITHOUT_VOLUME.values(), ids=WITHOUT_VOLUME)
def test_glass_without_volume_is_refused_in_one_line(tmp_path, vertices, facets, why, ending):
    saved(tmp_path / f"flat.{ending}", trimesh.Trimesh(vertices, facets, process=False))
    with pytest.raises(MeshError, match=rf"flat\.{ending}: a refractor must be a closed body; .*{why}"):
        load(tmp_path / f"flat.{ending}")


def test_an_open_mesh_is_refused_by_the_scene_that_names_it(tmp_path):
    whole = ball(2)
    saved(tmp_path / "open.stl", trimesh.Trimesh(whole.vertices, whole.faces[1:], process=False))
    glass = {"file": "open.stl", "units": "mm", "index": 1.5}
    for fields in (
        {"lens": Lens(surfaces=({"refractor": glass},))},
        {"lens": SINGLET, "target": {"refractor": glass, "position_mm": (0.0, 0.0, -50.0)}},
    ):
        sensor = Sensor(pixels=(8, 8), pixel_mm=0.1, distance_mm=20.0)
        targets = (fields["target"],) if "target" in fields else ()
        scene = Scene(camera=Camera(lens=fields["lens"], sensor=sensor), targets=targets).in_folder(tmp_path)
        with pytest.raises(MeshError, match=r"open\.stl: a refractor must be a closed body; 3 of its edges"):
            lf.build(scene)


SINGLET = Lens(
    surfaces=(
        Surface(radius_mm=50.0, thickness_mm=4.0, index=1.5168, semi_diameter_mm=10.0, stop=True),
        Surface(radius_mm=-50.0, semi_diameter_mm=10.0),
    )
)


def biconvex(exact, rings=12):
    """The singlet as a closed trimesh; `exact`: with the spheres' own normals at the vertices of its faces."""
    front, back = surface(50.0, semi_diameter=10.0), surface(-50.0, vertex_z=4.0, semi_diameter=10.0)
    rim = rim_radius(front, rings)
    edge = revolved(ring_profile(front, rim, back, rim), 6 * rings)
    body = element(cap(front, rings, rim), edge, cap(back, rings, rim))
    corner = body.vertices[body.faces].reshape(-1, 3)
    soup = trimesh.Trimesh(corner, np.arange(len(corner)).reshape(-1, 3), process=False)
    return with_normals(soup, body.corner_normals.reshape(-1, 3)) if exact else soup


@pytest.mark.parametrize(("exact", "radius", "vertex"), [(True, 1e-5, 1e-6), (False, 1e-5, 1e-6)])
def test_first_order_optics_are_measured_on_the_two_faces_of_an_element(tmp_path, exact, radius, vertex):
    saved(tmp_path / "lens.ply", biconvex(exact))
    scene = Scene(camera=Camera(lens=SINGLET, sensor=Sensor(pixels=(8, 8), pixel_mm=0.1, distance_mm=20.0))).in_folder(
        tmp_path
    )
    front, back = faces(MeshShape(file="lens.ply", units="mm", surface="patch"), scene)
    assert front.radius_mm == pytest.approx(50.0, rel=radius)
    assert back.radius_mm == pytest.approx(-50.0, rel=radius)
    assert front.vertex_z == pytest.approx(0.0, abs=vertex)
    assert back.vertex_z == pytest.approx(4.0, abs=vertex)
    for face, apex in ((front, 50.0), (back, -46.0)):
        assert face.rim_mm == pytest.approx(10.2, rel=1e-6)
        corner = face.mesh.vertices[face.mesh.faces]
        radial = np.sign(apex) * (np.array([0.0, 0.0, apex]) - corner) / 50.0
        tilt = np.linalg.norm(face.mesh.corner_normals - radial, axis=2).max()
        assert tilt < (2e-7 if exact else 5e-4)
        assert exact or tilt > 1e-6


def landing(world):
    """Where a bundle lands on the sensor, (n, 3) mm."""
    draw = np.random.default_rng(3)
    r, phi = 9.0 * np.sqrt(draw.uniform(size=4000)), draw.uniform(0.0, 2.0 * np.pi, 4000)
    at = np.column_stack([r * np.cos(phi), r * np.sin(phi), np.full(4000, 0.0)])
    d = np.tile([0.0, np.sin(0.05), np.cos(0.05)], (4000, 1))
    paths = lf.trace(world, at - 50.0 * d, d, split="transmit")
    assert (paths.status == lf.Status.SENSOR).all()
    return paths.position


def test_patches_from_the_exact_normals_of_a_file_image_within_20_nm_at_a_thousand_facets(tmp_path):
    sensor = Sensor(pixels=(100, 100), pixel_mm=0.2, distance_mm=45.0)
    truth = landing(lf.build(Scene(camera=Camera(lens=SINGLET, sensor=sensor))))
    saved(tmp_path / "lens.ply", biconvex(exact=True))
    glass = {"file": "lens.ply", "units": "mm", "index": 1.5168, "surface": "patch"}
    lens = Lens(surfaces=({"refractor": glass, "semi_diameter_mm": 9.9},))
    found = landing(lf.build(Scene(camera=Camera(lens=lens, sensor=sensor)).in_folder(tmp_path)))
    assert 6 * 12**2 <= 1000
    assert np.sqrt(np.square(found - truth).sum(axis=1).mean()) < 2e-5
