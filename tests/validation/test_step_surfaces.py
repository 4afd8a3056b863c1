"""Cylinders, tori and turned curves of a STEP file, and spheres of meshes, are traced as their prescription.

The files are a CAD kernel's (`cad_lenses`); what they should do is traced through the prescription, typed in by hand.
"""

import re
from importlib.util import find_spec

import numpy as np
import pytest
import trimesh

import lfmesh as lf
from lfmesh.geometry.objects.refractors import face_lines, measured
from lfmesh.geometry.surfaces.optical_face import Told, fitted_form, told_form
from lfmesh.scene import Camera, Element, Lens, Pose, Refractor, Scene, Sensor, Surface
from tests.geometry.files.test_cad_file import model, save_3mf
from tests.validation.cad_lenses import (
    SOLIDS,
    cylinder_lens,
    ellipse,
    rational_arc,
    sag,
    spline,
    toric_lens,
    turned_lens,
)

INDEX = 1.5168
RIM = 8.0
SENSOR = Sensor(pixels=(4000, 4000), pixel_mm=0.005, distance_mm=30.0)
IDENTITY = np.hstack([np.eye(3), np.zeros((3, 1))])

needs_cascadio = pytest.mark.skipif(find_spec("cascadio") is None, reason="cascadio, of the extra cad, is not there")


def scene_of(lens):
    return Scene(camera=Camera(lens=lens, sensor=SENSOR))


def from_file(path, elements=(), **options):
    glass = Refractor(file=str(path), index=INDEX, **options)
    return Lens(surfaces=(Surface(refractor=glass, semi_diameter_mm=0.95 * RIM),), elements=elements)


def prescribed(thickness, pose=None, **front):
    surfaces = (
        Surface(thickness_mm=thickness, index=INDEX, semi_diameter_mm=0.95 * RIM, **front),
        Surface(semi_diameter_mm=0.95 * RIM),
    )
    return Lens(surfaces=surfaces, elements=() if pose is None else (Element(surfaces=(0, 1), pose=pose),))


def landing(lens, count=500, share=0.75):
    """Where a bundle of oblique rays lands on the sensor, (n, 3) mm."""
    draw = np.random.default_rng(4)
    r, phi = share * RIM * np.sqrt(draw.uniform(size=count)), draw.uniform(0.0, 2.0 * np.pi, count)
    at = np.column_stack([r * np.cos(phi), r * np.sin(phi), np.zeros(count)])
    d = np.tile([np.sin(0.03), np.sin(0.05), 0.0], (count, 1))
    d[:, 2] = np.sqrt(1.0 - np.square(d).sum(axis=1))
    paths = lf.trace(lf.build(scene_of(lens)), at - 50.0 * d, d, split="transmit")
    assert (paths.status == lf.Status.SENSOR).all()
    return paths.position


def apart(lens, other, share=0.75):
    return float(np.linalg.norm(landing(lens, share=share) - landing(other, share=share), axis=1).max())


def are_exact(lens):
    return [each.mesh is None for each in measured(scene_of(lens)).camera.lens.surfaces]


@needs_cascadio
@pytest.mark.parametrize(
    ("name", "thickness", "front", "turn"),
    [
        ("cylinder", 5.0, {"toroid": {"radius_x_mm": 30.0}}, 30.0),
        ("asphere", 6.0, {"radius_mm": 25.0, "conic": -0.7, "asphere_mm": (1e-6, -2e-9)}, 0.0),
        ("rational", 6.0, {"radius_mm": 25.0}, 0.0),
    ],
)
def test_faces_that_a_file_tells_are_traced_as_their_prescription(name, thickness, front, turn):
    lens = from_file(SOLIDS / f"{name}.step")
    assert are_exact(lens) == [True, True]
    pose = Pose(tilt_deg=(0.0, 0.0, turn)) if turn else None
    assert apart(lens, prescribed(thickness, pose, **front)) < 1e-6


@needs_cascadio
def test_by_patches_an_asphere_images_within_a_quarter_pixel():
    lens = from_file(SOLIDS / "asphere.step", surface="patch")
    assert are_exact(lens) == [False, False]
    true = prescribed(6.0, radius_mm=25.0, conic=-0.7, asphere_mm=(1e-6, -2e-9))
    assert 1e-7 < apart(lens, true) < 0.25 * SENSOR.pixel_mm


@needs_cascadio
def test_a_turned_face_stands_where_the_pose_of_its_element_puts_it():
    """Turned within an element that is turned, tilted and shifted: the rotations are multiplied here by hand."""
    from scipy.spatial.transform import Rotation

    outer = Rotation.from_euler("xyz", [2.0, -1.5, 20.0], degrees=True)
    both = (outer * Rotation.from_euler("z", 30.0, degrees=True)).as_euler("xyz", degrees=True)
    shift = (0.1, -0.2, 0.05)
    element = Element(surfaces=(0,), pose=Pose(tilt_deg=(2.0, -1.5, 20.0), shift_mm=shift))
    true = prescribed(5.0, Pose(tilt_deg=tuple(map(float, both)), shift_mm=shift), toroid={"radius_x_mm": 30.0})
    assert apart(from_file(SOLIDS / "cylinder.step", (element,)), true) < 1e-6


@needs_cascadio
def test_random_cylinders_and_tori_in_random_poses_are_exact(tmp_path, gmsh):
    draw = np.random.default_rng(11)
    for k in range(4):
        turn, shift = draw.uniform(-90.0, 90.0), draw.uniform(-40.0, 40.0)
        where = {"turn_deg": turn, "shift_z": shift}
        pose = Pose(tilt_deg=(0.0, 0.0, turn))
        if k < 3:
            radius = draw.uniform(15.0, 80.0) * (-1) ** k
            path = cylinder_lens(gmsh, tmp_path / f"{k}.step", radius, 6.0, RIM, square=k == 2, **where)
            true = prescribed(6.0, pose, toroid={"radius_x_mm": radius})
        else:
            radii = draw.uniform(15.0, 30.0), draw.uniform(35.0, 80.0)
            path = toric_lens(gmsh, tmp_path / f"{k}.step", *radii, 6.0, RIM, **where)
            true = prescribed(6.0, pose, radius_mm=radii[0], toroid={"radius_x_mm": radii[1]})
        lens = from_file(path, tolerance_mm=0.02)
        assert are_exact(lens) == [True, True], face_lines(scene_of(lens))
        assert apart(lens, true) < 1e-6


@needs_cascadio
def test_random_turned_conics_and_aspheres_are_exact(tmp_path, gmsh):
    draw = np.random.default_rng(12)
    for k, kind in enumerate(("ellipse", "ellipse", "rational", "rational", "spline", "spline")):
        radius = draw.uniform(18.0, 60.0)
        conic = draw.uniform(-0.9, 0.8) if kind == "ellipse" else draw.uniform(-3.0, 0.8)
        terms = tuple(draw.uniform(-1.0, 1.0, 2) * (2e-6, 4e-9)) if kind == "spline" else ()
        front = {
            "ellipse": lambda r=radius, c=conic: ellipse(r, c, RIM),
            "rational": lambda r=radius, c=conic: rational_arc(r, c, RIM),
            "spline": lambda r=radius, c=conic, t=terms: spline(lambda h: sag(h, r, c, t), RIM),
        }[kind]()
        path = turned_lens(gmsh, tmp_path / f"{k}.step", front, 7.0, RIM, shift_z=draw.uniform(-40.0, 40.0))
        lens = from_file(path, tolerance_mm=0.02)
        assert are_exact(lens) == [True, True], face_lines(scene_of(lens))
        assert apart(lens, prescribed(7.0, radius_mm=radius, conic=conic, asphere_mm=terms)) < 1e-6


MILLIMETRE = "SI_UNIT(.MILLI.,.METRE.) );"
INCH = (
    "( CONVERSION_BASED_UNIT('INCH',#901) LENGTH_UNIT() NAMED_UNIT(#902) );\n"
    "#901 = LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),#903);\n#902 = DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.);\n"
    "#903 = ( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.) );"
)


@needs_cascadio
@pytest.mark.parametrize(("unit", "mm"), [("inch", 25.4), ("centimetre", 10.0), ("metre", 1e3)])
def test_a_swept_curve_has_the_size_of_the_files_unit(tmp_path, unit, mm):
    text = (SOLIDS / "rational.step").read_text()
    line = f"( LENGTH_UNIT() NAMED_UNIT(*) {MILLIMETRE}"
    other = {"inch": INCH, "metre": line.replace(".MILLI.", "$"), "centimetre": line.replace("MILLI", "CENTI")}[unit]
    (tmp_path / "a.step").write_text(text.replace(line, other))
    lens = Lens(
        surfaces=(Surface(refractor=Refractor(file=str(tmp_path / "a.step"), index=1.5, tolerance_mm=0.02 * mm)),)
    )
    front, back = measured(scene_of(lens)).camera.lens.surfaces
    assert front.mesh is back.mesh is None
    assert front.radius_mm == pytest.approx(25.0 * mm, rel=1e-10)
    assert front.thickness_mm == pytest.approx(6.0 * mm, rel=1e-12)


@needs_cascadio
def test_a_curve_that_is_no_conic_with_even_terms_stays_facets_and_the_distance_is_said(tmp_path, gmsh):
    wave = spline(lambda r: sag(r, 25.0) + 2e-5 * np.sin(3.0 * r) ** 2, RIM)
    lens = from_file(turned_lens(gmsh, tmp_path / "wave.step", wave, 6.0, RIM))
    assert are_exact(lens) == [False, True]
    said = face_lines(scene_of(lens))[0]
    assert "facets: the nearest conic with even terms is" in said
    off = float(said.split("terms is ")[1].split(" mm")[0])
    # A wave of 1e-5 mm to both sides of its mean, which smooth terms can take away in part.
    assert 1e-7 < off < 1.5e-5


def round_points(radius, rings=12, rim=RIM, z=0.0, **shape):
    """Points of a face on rings, (n, 3)."""
    r = np.repeat(rim * np.arange(1, rings + 1) / rings, 24)
    phi = np.tile(2.0 * np.pi * np.arange(24) / 24, rings)
    return np.column_stack([r * np.cos(phi), r * np.sin(phi), z + sag(r, radius, **shape)])


def test_a_surface_of_the_file_that_misses_the_vertices_is_not_taken():
    points = round_points(30.0)
    for radius, at, taken in (
        (30.0, 30.0, True),
        (30.002, 30.002, False),
        (30.0, 30.0001, False),
        (-30.0, -30.0, False),
    ):
        told = Told({"kind": "sphere", "at": [0.0, 0.0, at], "radius": abs(radius)}, IDENTITY)
        assert (told_form(points, [told])[0] is not None) == taken, (radius, at)
    beside = Told({"kind": "sphere", "at": [1e-5, 0.0, 30.0], "radius": 30.0}, IDENTITY)
    assert told_form(points, [beside])[0] is None
    dented = points.copy()
    dented[100, 2] += 1e-3
    right = Told({"kind": "sphere", "at": [0.0, 0.0, 30.0], "radius": 30.0}, IDENTITY)
    assert told_form(dented, [right])[0] is None


def lens_mesh(front, back, thickness, rings=12, sections=24, rim=RIM):
    """A lens of two profiles z(r) as a closed triangle mesh with points on rings."""
    radii = rim * np.arange(1, rings + 1) / rings
    phi = 2.0 * np.pi * np.arange(sections) / sections
    around = np.column_stack([np.cos(phi), np.sin(phi)])
    vertices, facets = [], []
    for curve, vertex, flip in ((front, 0.0, True), (back, thickness, False)):
        base = sum(map(len, vertices))
        xy = np.concatenate([[[0.0, 0.0]], *(r * around for r in radii)])
        vertices.append(np.column_stack([xy, vertex + curve(np.hypot(*xy.T))]))
        k = np.arange(sections)
        n = (k + 1) % sections
        these = [np.column_stack([0 * k, 1 + k, 1 + n])]
        for ring in range(rings - 1):
            a, b = 1 + ring * sections, 1 + (ring + 1) * sections
            these += [np.column_stack([a + k, b + k, b + n]), np.column_stack([a + k, b + n, a + n])]
        made = base + np.concatenate(these)
        facets.append(made[:, ::-1] if flip else made)
    one, two = 1 + (rings - 1) * sections, len(vertices[0]) + 1 + (rings - 1) * sections
    facets += [np.column_stack([one + k, one + n, two + n]), np.column_stack([one + k, two + n, two + k])]
    return trimesh.Trimesh(np.concatenate(vertices), np.concatenate(facets), process=False)


def saved(path, mesh):
    """Write a mesh in the format's own digits, and return the key of its unit."""
    if path.suffix == ".3mf":
        points = "".join(f'<vertex x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>' for x, y, z in mesh.vertices)
        facets = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in mesh.faces)
        body = f"<mesh><vertices>{points}</vertices><triangles>{facets}</triangles></mesh>"
        save_3mf(path, model(f'<object id="1" name="lens">{body}</object>'))
        return {}
    if path.suffix == ".glb":
        mesh = trimesh.Trimesh(mesh.vertices * 1e-3, mesh.faces, process=False)
    mesh.export(path)
    return {} if path.suffix == ".glb" else {"units": "mm"}


@pytest.mark.parametrize("ending", ["stl", "glb", "3mf", "ply"])
def test_spheres_are_fitted_where_a_mesh_names_no_surfaces(tmp_path, ending):
    draw = np.random.default_rng(31)
    for signs in ((1, -1), (1, np.inf), (-1, 1)):
        radii = np.array(signs) * draw.uniform(25.0, 120.0, 2)
        mesh = lens_mesh(lambda r: sag(r, radii[0]), lambda r: sag(r, radii[1]), 8.0)  # noqa: B023
        options = saved(tmp_path / f"lens.{ending}", mesh)
        lens = from_file(tmp_path / f"lens.{ending}", **options)
        assert are_exact(lens) == [True, True], face_lines(scene_of(lens))
        true = Lens(
            surfaces=(
                Surface(radius_mm=radii[0], thickness_mm=8.0, index=INDEX, semi_diameter_mm=0.95 * RIM),
                Surface(radius_mm=radii[1], semi_diameter_mm=0.95 * RIM),
            )
        )
        assert apart(lens, true, 0.5) < 1e-4


NEARLY = {
    "an asphere": lambda x, y: 1e-8 * (x * x + y * y) ** 2,
    "a conic": lambda x, y: sag(np.hypot(x, y), 30.0, 0.02) - sag(np.hypot(x, y), 30.0),
    "a toroid": lambda x, y: 1e-6 * x * x,
    "tilted": lambda x, y: 5e-6 * x,
    "a dent": lambda x, y: 3e-4 * ((x - 4.0) ** 2 + y * y < 1.0),
    # Two narrow ones: every vertex lies near the sphere, and rays there land micrometres away.
    "a smooth dent": lambda x, y: 9e-5 * np.exp(-((x - 2.0) ** 2 + (y - 1.0) ** 2) / 0.08),
    "a shallow one": lambda x, y: 9e-6 * np.exp(-((x - 2.0) ** 2 + (y - 1.0) ** 2) / 2.0),
    # From azimuth to azimuth up and down: no part of it is smooth.
    "rough": lambda x, y: 2e-4 * np.cos(12.0 * np.arctan2(y, x)),
}


@pytest.mark.parametrize("kind", NEARLY)
def test_what_is_nearly_a_sphere_is_none(kind):
    points = round_points(30.0)
    exact, _ = fitted_form(points)
    assert exact is not None
    assert exact.keys["radius_mm"] == pytest.approx(30.0, rel=1e-12)
    points[:, 2] += NEARLY[kind](points[:, 0], points[:, 1])
    form, why = fitted_form(points)
    assert form is None
    assert "off the nearest sphere" in why


def test_digits_that_a_file_leaves_out_do_not_hide_a_sphere():
    points = np.round(round_points(30.0), 5)
    form, _ = fitted_form(points)
    assert form is not None
    assert form.keys["radius_mm"] == pytest.approx(30.0, rel=1e-5)
    assert 3e-6 < float(form.words.split("within ")[1].split()[0]) < 6e-6


def test_too_few_vertices_tell_no_sphere():
    """All vertices of a coarse face lie on a sphere, whatever it should be."""
    assert "too few vertices" in fitted_form(round_points(30.0, rings=2)[::2])[1]
    assert "too few places" in fitted_form(round_points(30.0, rings=2))[1]


def test_what_a_face_is_traced_as_is_said(tmp_path):
    mesh = lens_mesh(lambda r: sag(r, 40.0), lambda r: 0.0 * r, 6.0)
    options = saved(tmp_path / "lens.stl", mesh)
    lens = from_file(tmp_path / "lens.stl", **options)
    front, back = face_lines(scene_of(lens))
    assert front.startswith("surface 0")
    said = re.fullmatch(
        r".* exact, a sphere fitted to its vertices, radius (.+) mm; they lie within (.+) mm of it", front
    )
    assert said is not None
    assert float(said[1]) == pytest.approx(40.0, rel=1e-7)
    assert float(said[2]) < 1e-6
    assert back.endswith("exact, a plane by its vertices")
