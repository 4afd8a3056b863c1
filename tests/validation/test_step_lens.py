"""A lens that a CAD kernel wrote as STEP is traced as its prescription.

`tests/solids` was made by gmsh (OpenCASCADE), whose spheres have the radii it was given; see
`tests/geometry/files/test_cad_file.py`.
"""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.geometry.objects.refractors import measured
from lfmesh.scene import Camera, Lens, Refractor, Scene, Sensor, Surface

SOLIDS = Path(__file__).resolve().parents[1] / "solids"
INDEX = 1.5168
PIXEL_MM = 0.005
SENSOR = Sensor(pixels=(4000, 4000), pixel_mm=PIXEL_MM, distance_mm=30.0)
PRESCRIBED = (
    Surface(radius_mm=30.0, thickness_mm=6.0, index=INDEX, semi_diameter_mm=9.5),
    Surface(radius_mm=-40.0, semi_diameter_mm=9.5),
)

pytestmark = pytest.mark.skipif(find_spec("cascadio") is None, reason="cascadio, of the extra cad, is not there")


def lens_of(file, **options):
    glass = Refractor(file=str(file), index=INDEX, **options)
    return Lens(surfaces=(Surface(refractor=glass, semi_diameter_mm=9.5),))


def landing(lens, count=4000):
    """Where a bundle of oblique rays lands on the sensor, (n, 3) mm."""
    draw = np.random.default_rng(21)
    r, phi = 7.0 * np.sqrt(draw.uniform(size=count)), draw.uniform(0.0, 2.0 * np.pi, count)
    at = np.column_stack([r * np.cos(phi), r * np.sin(phi), np.zeros(count)])
    d = np.tile([np.sin(0.03), np.sin(0.05), 0.0], (count, 1))
    d[:, 2] = np.sqrt(1.0 - np.square(d).sum(axis=1))
    paths = lf.trace(lf.build(Scene(camera=Camera(lens=lens, sensor=SENSOR))), at - 50.0 * d, d, split="transmit")
    assert (paths.status == lf.Status.SENSOR).all()
    return paths.position


def test_a_step_lens_is_traced_as_the_exact_spheres_of_its_prescription():
    found = landing(lens_of(SOLIDS / "biconvex.step"))
    off = np.linalg.norm(found - landing(Lens(surfaces=PRESCRIBED)), axis=1)
    assert off.max() < 1e-6


def test_by_patches_alone_it_images_within_a_quarter_pixel():
    found = landing(lens_of(SOLIDS / "biconvex.step", surface="patch"))
    off = np.linalg.norm(found - landing(Lens(surfaces=PRESCRIBED)), axis=1)
    # Exact spheres would be right to rounding: here the mesh is what is traced.
    assert 1e-7 < off.max() < 0.25 * PIXEL_MM


def surfaces_of(lens):
    return measured(Scene(camera=Camera(lens=lens, sensor=SENSOR))).camera.lens.surfaces


def test_the_bodies_of_a_doublet_are_elements_by_name():
    first, second = (
        Surface(refractor=Refractor(file=str(SOLIDS / "doublet.step"), node=name, index=1.5), thickness_mm=thickness)
        for name, thickness in (("L1", 0.1), ("L2", None))
    )
    made = surfaces_of(Lens(surfaces=(first, second)))
    assert [each.radius_mm for each in made] == pytest.approx([50.0, -40.0, -40.0, -120.0], rel=1e-13)
    assert [each.thickness_mm for each in made[:3]] == pytest.approx([8.0, 0.1, 3.0], rel=1e-12)
    assert [each.semi_diameter_mm for each in made] == pytest.approx([12.0] * 4, rel=1e-7)
    assert all(each.mesh is None for each in made)


def test_recognition_is_left_out_where_facets_are_asked_for():
    for surface in ("flat", "smooth", "patch"):
        assert all(each.mesh is not None for each in surfaces_of(lens_of(SOLIDS / "biconvex.step", surface=surface)))


def write_lens(gmsh, path, radii, thickness, rim, tilt=0.0):
    """Write a lens with its front vertex at the origin, turned by `tilt` about x; an infinite radius is a plane."""
    gmsh.clear()
    occ = gmsh.model.occ
    low, high = (
        vertex + (0.0 if np.isinf(radius) else radius - np.sign(radius) * np.sqrt(radius**2 - rim**2))
        for vertex, radius in ((0.0, radii[0]), (thickness, radii[1]))
    )
    # A face bulges out of the rod, which then is longer, or reaches into it, and is cut.
    low, high = min(low, 0.0), max(high, thickness)
    body = [(3, occ.addCylinder(0, 0, low, 0, 0, high - low, rim))]
    for vertex, radius, inside in ((0.0, radii[0], radii[0] > 0), (thickness, radii[1], radii[1] < 0)):
        if np.isfinite(radius):
            ball = [(3, occ.addSphere(0, 0, vertex + radius, abs(radius)))]
            body, _ = occ.intersect(body, ball) if inside else occ.cut(body, ball)
    occ.rotate(body, 0, 0, 0, 1, 0, 0, tilt)
    occ.synchronize()
    gmsh.write(str(path))
    return Lens(surfaces=(Surface(refractor=Refractor(file=str(path), index=1.5, tolerance_mm=0.05)),))


def test_random_lenses_that_gmsh_writes_have_their_radii_and_thickness(tmp_path, gmsh):
    draw = np.random.default_rng(8)
    signs = [(1, -1), (1, 1), (-1, -1), (-1, 1), (1, np.inf), (np.inf, -1), (-1, np.inf)]
    for k, sign in enumerate(signs):
        radii = np.array(sign) * draw.uniform(20.0, 200.0, 2)
        thickness, rim = draw.uniform(6.0, 9.0), draw.uniform(2.0, 8.0)
        one, two = surfaces_of(write_lens(gmsh, tmp_path / f"{k}.step", radii, thickness, rim))
        assert one.mesh is two.mesh is None
        assert [1.0 / one.radius_mm, 1.0 / two.radius_mm] == pytest.approx(list(1.0 / radii), rel=1e-12)
        assert one.thickness_mm == pytest.approx(thickness, abs=1e-9)
        assert [one.semi_diameter_mm, two.semi_diameter_mm] == pytest.approx([rim, rim], rel=1e-6)


def test_a_tilted_lens_is_not_straightened(tmp_path, gmsh):
    for k, tilt in enumerate((1e-6, 1e-2)):
        lens = write_lens(gmsh, tmp_path / f"{k}.step", (30.0, -40.0), 6.0, 8.0, tilt)
        assert all(each.mesh is not None for each in surfaces_of(lens))
