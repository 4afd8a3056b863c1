"""First-order optics and real axial rays of lenses and lenslets of gradient-index glass."""

import math
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.scene import Lens, Paraxial
from lfmesh.scene.advice import warnings
from lfmesh.scene.camera.lenslet_optics import lenslet_optics
from lfmesh.scene.first_order import axial_beam, beam_bounds, skew_bounds
from lfmesh.scene.first_order.compute import facts_of_solved, first_order
from lfmesh.scene.first_order.meridional import beam_mm, heights_mm
from lfmesh.scene.first_order.paraxial import Matrix
from lfmesh.scene.first_order.solve import lenslet_focal_length_mm, solved

WAVE_NM = 587.6
N, G = 1.6, 0.3
ROD = {"kind": "radial_n2", "index": N, "coefficients": [-G * G]}
MIXED = {"kind": "radial_n", "index": 1.6, "coefficients": [-0.07], "axial_coefficients": [0.02, -0.003]}
SENSOR = {"pixels": [8, 8], "pixel_mm": 0.01}


def rod(length: float, gradient: dict[str, Any] = ROD, *, radius: float = math.inf, back: float = math.inf) -> Lens:
    front = {"radius_mm": radius, "thickness_mm": length, "gradient": gradient, "semi_diameter_mm": 1.0, "stop": True}
    return Lens(surfaces=[front, {"radius_mm": back, "semi_diameter_mm": 1.0}])


def camera_of(lens: Lens, **keys: Any) -> lf.Scene:
    return lf.Scene(camera={"lens": lens.model_dump(), "focus_mm": 500.0, "sensor": SENSOR} | keys)


def plain(medium: dict[str, Any], **mla: Any) -> lf.Scene:
    """A biconvex lens, and an array of curved lenslets, of one medium in different words."""
    surfaces = [
        {"radius_mm": 30.0, "thickness_mm": 4.0, "semi_diameter_mm": 5.0, "stop": True} | medium,
        {"radius_mm": -40.0, "semi_diameter_mm": 5.0},
    ]
    array = {"count": [20, 20], "pitch_mm": 0.125, "radius_mm": 0.3, "thickness_mm": 0.3} | medium | mla
    sensor = {"pixels": [200, 200], "pixel_mm": 0.0125}
    return lf.Scene(camera={"lens": {"surfaces": surfaces}, "mla": array, "focus_mm": 500.0, "sensor": sensor})


@pytest.mark.parametrize("length", [1.0, 4.0, 9.0])
def test_a_rod_lens_has_its_focal_lengths(length: float) -> None:
    """1 / (n₀ g sin gL), and cot(gL) / (n₀ g) behind the rod."""
    lens = Paraxial.of(rod(length), WAVE_NM)
    assert lens.efl_mm == pytest.approx(1.0 / (N * G * math.sin(G * length)), rel=1e-13)
    assert lens.bfl_mm == pytest.approx(1.0 / (N * G * math.tan(G * length)), rel=1e-13)
    assert lens.ffl_mm == pytest.approx(-lens.bfl_mm, rel=1e-13)


def test_a_rod_of_half_a_period_is_afocal() -> None:
    lens = Paraxial.of(rod(math.pi / G), WAVE_NM)
    assert math.isinf(lens.efl_mm)
    assert lens.magnification(7.0) == pytest.approx(-1.0, rel=1e-12)


def test_a_wood_lens_focuses_like_a_thin_lens() -> None:
    """Power −2 c t of n = n₀ + c r² (R. W. Wood, Physical Optics, 1905), up to the square of its thickness."""
    for t in (0.1, 0.01):
        power = 1.0 / Paraxial.of(rod(t, {"kind": "radial_n", "index": 1.5, "coefficients": [-0.02]}), WAVE_NM).efl_mm
        assert power == pytest.approx(0.04 * t, rel=0.02 * t * t)


def test_an_axial_gradient_acts_at_the_faces_with_the_index_there() -> None:
    """Front n(0), back n(L), and ∫ dz/n between."""
    lens = rod(4.0, {"kind": "axial", "index": 1.5, "coefficients": [0.025]}, radius=20.0, back=-30.0)
    first, second, reduced = 0.5 / 20.0, 0.6 / 30.0, math.log(1.6 / 1.5) / 0.025
    paraxial = Paraxial.of(lens, WAVE_NM)
    assert paraxial.index_before(1) == pytest.approx(1.6, rel=1e-15)
    assert 1.0 / paraxial.efl_mm == pytest.approx(first + second - first * second * reduced, rel=1e-13)
    assert paraxial.bfl_mm == pytest.approx((1.0 - first * reduced) * paraxial.efl_mm, rel=1e-13)


@pytest.mark.parametrize("gradient", [ROD, MIXED])
def test_light_that_returns_meets_the_same_gap_in_reverse(gradient: dict[str, Any]) -> None:
    """There and back with the angle reversed is no change."""
    gap = Paraxial.of(rod(4.0, gradient), WAVE_NM).gap(0)
    turned = gap.then(Matrix(1.0, 0.0, 0.0, -1.0)).then(gap.reversed).then(Matrix(1.0, 0.0, 0.0, -1.0))
    assert tuple(turned) == pytest.approx((1.0, 0.0, 0.0, 1.0), abs=1e-14)
    assert gap.a * gap.d - gap.b * gap.c == pytest.approx(1.0, abs=1e-14)


def test_a_ghost_crosses_a_rod_three_times() -> None:
    """Plane faces reflect without power: the matrix of three lengths."""
    three = Paraxial.of(rod(12.0), WAVE_NM).whole
    assert tuple(Paraxial.of(rod(4.0), WAVE_NM).reflected_twice(1, 0)) == pytest.approx(tuple(three), abs=1e-13)


def test_a_ghost_in_a_graded_lens_meets_each_face_with_the_index_there() -> None:
    """Reflection at the back has the power −2 n(L) c, at the front 2 n(0) c."""
    lens = Paraxial.of(rod(4.0, MIXED, radius=20.0, back=-30.0), WAVE_NM)
    gap = lens.gap(0)
    behind, before = 1.6 + 0.02 * 4.0 - 0.003 * 16.0, 1.6
    wanted = (
        lens.refraction(0).then(gap).then(Matrix(1.0, 0.0, -2.0 * behind / 30.0, 1.0)).then(gap.reversed)
        .then(Matrix(1.0, 0.0, -2.0 * before / 20.0, 1.0)).then(gap).then(lens.refraction(1))
    )  # fmt: skip
    assert tuple(lens.reflected_twice(1, 0)) == pytest.approx(tuple(wanted), rel=1e-13)


def test_reports_of_a_gradient_without_coefficients_are_those_of_plain_glass() -> None:
    """To 1e-12 in every figure."""
    zero = {"gradient": {"kind": "radial_n2", "index": 1.5, "coefficients": [0.0]}}
    for keys in ({}, {"curved_side": "sensor"}, {"back": {"radius_mm": 0.5}}):
        found, wanted = (facts_of_solved(solved(plain(medium, **keys))) for medium in (zero, {"index": 1.5}))
        assert found.kind == wanted.kind
        for field in fields(wanted):
            one, other = getattr(found, field.name), getattr(wanted, field.name)
            if isinstance(other, float):
                assert one == pytest.approx(other, rel=1e-12, abs=1e-12), field.name
        assert solved(plain(zero, **keys)).camera.sensor.distance_mm == pytest.approx(
            solved(plain({"index": 1.5}, **keys)).camera.sensor.distance_mm, rel=1e-12
        )


def test_a_gradient_without_coefficients_is_plain_glass_to_real_rays() -> None:
    zero = {"gradient": {"kind": "radial_n2", "index": 1.5, "coefficients": [0.0]}}
    found, wanted = (plain(medium).camera.lens for medium in (zero, {"index": 1.5}))
    for height in (1.0, 4.5):
        assert heights_mm(found, WAVE_NM, 300.0, height) == pytest.approx(
            heights_mm(wanted, WAVE_NM, 300.0, height), rel=1e-11
        )
    assert beam_mm(found, WAVE_NM, 300.0, 5.0).found_mm == pytest.approx(
        beam_mm(wanted, WAVE_NM, 300.0, 5.0).found_mm, rel=1e-6
    )


def test_a_rod_has_the_focal_length_of_its_array() -> None:
    """Flat rods: 1 / (n₀ g sin gL), over the image index outside, with the sensor in the focal plane."""
    mla = {"count": [8, 8], "pitch_mm": 0.5, "thickness_mm": 3.0, "gradient": ROD}
    lens = {"surfaces": [{"radius_mm": 30.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 4.0, "stop": True},
                         {"semi_diameter_mm": 4.0}]}  # fmt: skip
    for index in (1.0, 1.33):
        scene = solved(
            lf.Scene(
                camera={"lens": lens, "mla": mla, "focus_mm": 500.0, "sensor": SENSOR, "image_medium": {"index": index}}
            )
        )
        c, s = math.cos(3.0 * G), math.sin(3.0 * G)
        assert lenslet_focal_length_mm(scene.camera, WAVE_NM) == pytest.approx((index / (N * G * s),), rel=1e-13)
        at = lenslet_optics(scene.camera, WAVE_NM)
        assert at.front_principal_mm == pytest.approx(index * (1.0 - c) / (N * G * s), rel=1e-13)
        assert scene.camera.sensor.distance_mm == pytest.approx(index * c / (N * G * s), rel=1e-12)
        rows = [value for name, value in first_order(scene).rows() if name.startswith("lenslets")]
        assert any(f"focal length {index / (N * G * s):.6g} mm" in row for row in rows)


def test_the_array_s_gradient_counts_from_the_face_towards_the_lens() -> None:
    """An axial gradient behind a curved face: its index there makes the power."""
    gradient = {"kind": "axial", "index": 1.5, "coefficients": [0.5]}
    for side, index in (("lens", 1.5), ("sensor", 1.65)):
        scene = solved(plain({"index": 1.5}, index=None, gradient=gradient, curved_side=side))
        assert lenslet_focal_length_mm(scene.camera, WAVE_NM) == pytest.approx((0.3 / (index - 1.0),), rel=1e-12)


def test_lenslets_may_differ_in_x_and_y() -> None:
    gradient = {"kind": "xyz", "index": 1.6, "y_coefficients": [0.0, -0.072]}
    mla = {"count": [8, 8], "pitch_mm": 0.5, "thickness_mm": 3.0, "gradient": gradient}
    camera = solved(camera_of(rod(4.0), mla=mla | {"distance_mm": 1.0}, sensor=SENSOR | {"distance_mm": 1.0})).camera
    s = math.sin(3.0 * G)
    assert lenslet_optics(camera, WAVE_NM, section="y").focal_length_mm == pytest.approx(1.0 / (N * G * s), rel=1e-13)
    assert math.isinf(lenslet_optics(camera, WAVE_NM, section="x").focal_length_mm)
    assert lenslet_focal_length_mm(camera, WAVE_NM) == pytest.approx((1.0 / (N * G * s),), rel=1e-13)


@pytest.mark.parametrize("gradient", [ROD, MIXED])
def test_real_rays_near_the_axis_have_the_paraxial_heights(gradient: dict[str, Any]) -> None:
    lens = rod(4.0, gradient, radius=20.0, back=-30.0)
    found = heights_mm(lens, WAVE_NM, 300.0, 1e-4)
    paraxial = Paraxial.of(lens, WAVE_NM)
    ray = paraxial.axial_ray(300.0)
    scale = 1e-4 / ray.height_mm
    assert found == pytest.approx([scale * each for each in paraxial.heights_mm(ray)], rel=1e-7)


def test_a_meridional_ray_of_a_rod_follows_its_sine() -> None:
    """In n² = n₀² (1 − g² r²), x = h cos(g z / cos θ) with n(h) = n₀ cos θ, for a ray parallel to the axis at h."""
    height, length = 0.9, 4.0
    cosine = math.sqrt(1.0 - (G * height) ** 2)
    found = heights_mm(rod(length), WAVE_NM, math.inf, height)
    assert found == pytest.approx([height, height * math.cos(G * length / cosine)], rel=1e-9)


def test_rays_end_on_the_face_itself_also_on_aspheres() -> None:
    """In an axial gradient, n sin θ stays: the height on the face agrees with a quadrature of tan θ to the sag."""
    gradient = {"kind": "axial", "index": 1.5, "coefficients": [0.05]}
    front = {"thickness_mm": 4.0, "gradient": gradient, "semi_diameter_mm": 3.0, "stop": True}
    lens = Lens(surfaces=[front, {"radius_mm": -8.0, "asphere_mm": [1e-3], "semi_diameter_mm": 3.0}])
    first, last = heights_mm(lens, WAVE_NM, 3.0, 1.5)
    invariant = math.sin(math.atan2(1.5, 3.0))
    z = 4.0 + lens.surfaces[1].sag_mm(last)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    n = 1.5 + 0.05 * 0.5 * z * (nodes + 1.0)
    travelled = 0.5 * z * float(weights @ (invariant / np.sqrt(n * n - invariant**2)))
    assert last - first == pytest.approx(travelled, rel=1e-10)


def test_skew_rays_agree_with_meridional_ones() -> None:
    """The axial beam of a lens of revolution, told by x and y, has the width of its meridional rays."""
    gradient = {"kind": "xyz", "index": 1.6, "x_coefficients": [0.0, -0.07], "y_coefficients": [0.0, -0.070000001]}
    found = axial_beam.beam_mm(rod(3.0, gradient, radius=12.0, back=-15.0), WAVE_NM, 300.0)
    wanted = beam_mm(
        rod(3.0, {"kind": "radial_n", "index": 1.6, "coefficients": [-0.07]}, radius=12.0, back=-15.0),
        WAVE_NM, 300.0, 1.0,
    )  # fmt: skip
    assert found.found_mm == pytest.approx(wanted.found_mm, rel=1e-6)
    assert found.proven_mm == found.found_mm


def test_bounds_prove_nothing_behind_gradient_glass() -> None:
    lens = rod(4.0)
    zones = beam_bounds.followed(lens, WAVE_NM, 300.0, np.array([0.0]), np.array([0.5]))
    assert zones.pass_on[:, 0].tolist() == [False, False]
    assert np.isinf(zones.heights_mm[1]).all()
    followed = skew_bounds._followed(lens, WAVE_NM, 300.0, np.array([[0.0, 0.0]]), np.array([[0.5, 0.5]]))
    assert not followed.pass_on.any()


def test_apertures_are_compared_with_real_rays_and_the_report_says_how() -> None:
    lens = Lens(surfaces=[rod(4.0).surfaces[0].model_dump(), {"semi_diameter_mm": 0.2}])
    scene = solved(camera_of(lens))
    said = warnings(scene, facts_of_solved(scene))
    assert any("its axial beam is" in each and "on surfaces[1]" in each for each in said)
    assert any("without proof for the rays between" in each for each in said)


def test_omitted_clear_apertures_pass_the_beam_between_the_faces() -> None:
    """From a point on the front face, rays in half a period spread to the slope over n₀ g."""
    surfaces = [
        {"thickness_mm": math.pi / G, "gradient": ROD},
        {"thickness_mm": 1.0},
        {"stop": True, "semi_diameter_mm": 0.5},
    ]
    camera = {"lens": {"surfaces": surfaces}, "sensor": {"pixels": [2, 2], "pixel_mm": 1e-6, "distance_mm": 2.0}}
    lens = solved(lf.Scene(camera=camera)).camera.lens
    paraxial = Paraxial.of(lens, WAVE_NM)
    assert paraxial.magnification(0.5) == pytest.approx(-1.0, rel=1e-12)
    behind = paraxial.rays_behind(paraxial.marginal_ray(paraxial.object_mm(2.0), 0.5))[0]
    inside = math.hypot(behind.height_mm, behind.angle / (N * G))
    assert inside > 1.1 * abs(behind.height_mm)
    for surface in lens.surfaces[:2]:
        assert surface.semi_diameter_mm == pytest.approx(1.05 * inside, rel=0.01)


def test_a_gradient_across_the_axis_is_told_and_needs_clear_apertures() -> None:
    gradient = {"kind": "xyz", "index": 1.6, "y_coefficients": [0.01, -0.05]}
    scene = solved(camera_of(rod(4.0, gradient)))
    said = warnings(scene, facts_of_solved(scene))
    assert any("the gradient behind surface 0 turns light on the axis" in each for each in said)
    assert any("the gradient behind surface 0 is not symmetric about x and y" in each for each in said)
    omitted = Lens(
        surfaces=[
            {"thickness_mm": 4.0, "gradient": gradient, "semi_diameter_mm": 1.0, "stop": True},
            {},
        ]
    )
    with pytest.raises(lf.SceneError, match=r"the gradient of surfaces\[0\] turns light on the axis"):
        solved(camera_of(omitted))


def test_the_focal_length_follows_the_dispersion() -> None:
    """A SELFOC rod has the gradient constant of each wavelength."""
    keys = {"kind": "selfoc", "index": [1.5868, 0.00813], "gradient_constant_per_mm": [0.2931, 0.005369, 0.000287]}
    for wavelength in (450.0, 650.0):
        per_um2 = (1e-3 * wavelength) ** -2
        n, g = 1.5868 + 0.00813 * per_um2, 0.2931 + 0.005369 * per_um2 + 0.000287 * per_um2**2
        wanted = 1.0 / (n * g * math.sin(4.0 * g))
        assert Paraxial.of(rod(4.0, keys), wavelength).efl_mm == pytest.approx(wanted, rel=1e-13)
