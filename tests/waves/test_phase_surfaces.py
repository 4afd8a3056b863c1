"""Waves behind diffractive faces: perfect phases, tilts, foci, and paths that agree with directions."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.analysis.field_curves import zone_foci
from lfmesh.waves.bundle import LensRays, pupil_grid
from tests.waves.test_array_truths import (
    CENTRE,
    COARSE,
    CORNER,
    FOCAL,
    IMAGE,
    PITCH,
    SPREAD,
    WAVE,
    Place,
    shares,
    square_truth,
)
from tests.waves.test_array_truths import camera as array_camera

Array = NDArray[np.float64]

WAVE_NM = 550.0
MM_PER_NM = 1e-6
F_MM = 10.0
METALENS = {"kind": "metalens", "focal_length_mm": F_MM, "design_nm": WAVE_NM}


def camera(surfaces: list[dict[str, Any]], wave_nm: float = WAVE_NM, **more: Any) -> lf.Scene:
    return lf.Scene.model_validate(
        {
            "schema_version": 1,
            "camera": {
                "lens": {"surfaces": surfaces},
                "sensor": {"pixels": [8, 8], "pixel_mm": 0.01},
                **({} if "sensor" in more else {"focus_mm": math.inf}),
                **more,
            },
            "transport": {"wavelengths_nm": [wave_nm]},
        }
    )


def plate(phase: dict[str, Any], **more: Any) -> lf.Scene:
    """A plate of glass with its stop in front, and a phase on its back."""
    front = {"stop": True, "thickness_mm": 1.0, "index": 1.5, "semi_diameter_mm": 2.5}
    return camera([front, {"semi_diameter_mm": 4.0, "phase": phase}], **more)


def rays_of(scene: lf.Scene, object_mm: float = math.inf, image_z_mm: float = 20.0) -> LensRays:
    return LensRays(lf.build(lf.solved(scene)), object_mm, image_z_mm)


@pytest.mark.parametrize("order", [1, -1, 2])
def test_a_perfect_metalens_has_no_aberration(order: int) -> None:
    """On a plane, for a plane wave along the axis; the order m of a phase for a wavelength m times longer, as well."""
    focal = F_MM if order > 0 else -F_MM
    phase = {**METALENS, "focal_length_mm": focal, "order": order, "design_nm": WAVE_NM * abs(order)}
    found = lf.wavefront(plate(phase))
    assert found.image_mm[2] == pytest.approx(1.0 + F_MM, rel=1e-12)
    assert found.pv_waves < 1e-9
    assert found.strehl == pytest.approx(1.0, abs=1e-12)
    assert found.passed == 1.0


def test_a_metalens_in_glass_focuses_there() -> None:
    """The same momentum at the face makes a focus at n' f, with aberration, as the glass bends the steep rays less."""
    found = lf.wavefront(plate(METALENS, image_medium={"index": 1.5}))
    assert found.image_mm[2] == pytest.approx(1.0 + 1.5 * F_MM, rel=1e-12)
    assert found.pv_waves > 0.1


def test_a_hologram_images_its_points_on_each_other() -> None:
    """A wave that diverges from 40 mm before the face converges to 30 mm behind it, at a finite aperture."""
    points = {"point_1_mm": [0.0, 0.0, -40.0], "point_2_mm": [0.0, 0.0, 30.0], "point_2": "virtual"}
    phase = {"kind": "hologram", "construction_nm": WAVE_NM, **points}
    stop = {"stop": True, "thickness_mm": 0.5, "semi_diameter_mm": 2.0}
    scene = camera([stop, {"semi_diameter_mm": 5.0, "phase": phase}], focus_mm=39.5)
    found = lf.wavefront(scene)
    assert found.image_mm[2] == pytest.approx(30.5, rel=1e-12)
    assert found.pv_waves < 1e-9


@pytest.mark.parametrize("wave_nm", [450.0, 700.0])
def test_a_radial_phase_focuses_by_its_first_coefficient_and_the_wavelength(wave_nm: float) -> None:
    """At f = −π R² / (m A₁ λ)."""
    radius, coefficient, order = 3.0, -900.0, 2
    phase = {"kind": "radial", "coefficients_rad": [coefficient, 1.0], "radius_mm": radius, "order": order}
    rays = rays_of(plate(phase))
    focus = rays.image_z_mm + zone_foci(rays, (wave_nm,), np.array([1e-4]))[0, 0] - 1.0
    assert focus == pytest.approx(-math.pi * radius**2 / (order * coefficient * wave_nm * MM_PER_NM), rel=1e-7)


@pytest.mark.parametrize("order", [1, -2])
def test_a_grating_tilts_the_wavefront_by_its_lines(order: int) -> None:
    """By m lines λ along the grating vector, in path and direction."""
    lines, angle = 150.0, math.radians(30.0)
    phase = {"kind": "grating", "lines_per_mm": lines, "direction_deg": 30.0, "order": order}
    rays = rays_of(plate(phase, sensor={"pixels": [8, 8], "pixel_mm": 0.01, "distance_mm": 20.0}))
    traced = rays.traced([0.0, 0.0], pupil_grid(8) * 2.0, WAVE_NM)
    turn = order * lines * WAVE_NM * MM_PER_NM * np.array([math.cos(angle), math.sin(angle)])
    np.testing.assert_allclose(traced.direction[:, :2], np.broadcast_to(turn, (len(traced.direction), 2)), atol=1e-14)
    path = traced.path_mm - traced.position[:, :2] @ turn
    assert np.ptp(path) < 1e-9 * WAVE_NM * MM_PER_NM


def grid(folder: Path) -> dict[str, Any]:
    x = np.linspace(-5.0, 5.0, 41)
    phase = -40.0 * np.add.outer(x**2, x**2) + 3.0 * np.multiply.outer(x, x**3)
    np.savez(folder / "phase.npz", phase_rad=phase, spacing_mm=0.25)
    return {"kind": "grid", "file": str(folder / "phase.npz")}


KINDS: dict[str, dict[str, Any]] = {
    "radial": {"kind": "radial", "coefficients_rad": [-400.0, 60.0, -3.0], "radius_mm": 3.0},
    "xy": {"kind": "xy", "coefficients_rad": [[1, 0, 80.0], [2, 0, -300.0], [1, 1, 40.0], [0, 3, 25.0]],
           "radius_mm": 3.0},
    "grating": {"kind": "grating", "lines_per_mm": 90.0, "direction_deg": 130.0, "order": -1},
    "metalens": {**METALENS, "order": 2},
    "hologram": {"kind": "hologram", "construction_nm": 488.0, "point_1_mm": [3.0, -2.0, -60.0],
                 "point_2_mm": [0.5, 1.0, 50.0], "point_2": "virtual"},
    "grid": {},
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_the_gradient_of_the_path_is_the_direction(kind: str, tmp_path: Path) -> None:
    """By Malus and Dupin, across a tilted and shifted asphere with a phase, from a near point beside the axis."""
    phase = KINDS[kind] or grid(tmp_path)
    front = {"stop": True, "thickness_mm": 2.0, "index": 1.6, "radius_mm": 40.0, "semi_diameter_mm": 2.0}
    back = {"radius_mm": -30.0, "conic": 0.4, "asphere_mm": [2e-5], "semi_diameter_mm": 3.0, "phase": phase}
    pose = {"tilt_deg": [2.0, -3.0, 20.0], "shift_mm": [0.1, -0.2, 0.05]}
    lens = {"surfaces": [front, back], "elements": [{"surfaces": [0, 1], "pose": pose}]}
    sensor = {"pixels": [8, 8], "pixel_mm": 0.01, "distance_mm": 20.0}
    rays = rays_of(camera([], lens=lens, sensor=sensor), 80.0)
    step, at = 1e-4, 1.2 * pupil_grid(5)
    for move in (np.array([step, 0.0]), np.array([0.0, step])):
        more, here, less = (rays.traced([0.02, -0.05], at + sign * move, WAVE_NM) for sign in (1.0, 0.0, -1.0))
        along = more.position - less.position
        length = np.linalg.norm(along, axis=1)
        slope = (more.path_mm - less.path_mm) / length
        np.testing.assert_allclose(slope, (here.direction * along).sum(axis=1) / length, atol=1e-9)


def test_the_weight_of_rays_is_that_of_their_order() -> None:
    """By sinc² of the blaze's phase step at a shorter wavelength, in a glass without dispersion."""
    blaze = {**METALENS, "efficiency": "blaze"}
    full, less = (lf.wavefront(plate(phase), 0.0, 440.0).weight for phase in (METALENS, blaze))
    np.testing.assert_allclose(less / full, np.sinc(WAVE_NM / 440.0 - 1.0) ** 2, rtol=1e-12)


SEVERAL = {**METALENS, "orders": [{"order": 1, "share": 0.7}, {"order": 0, "share": 0.2}]}


def test_wavefronts_of_several_orders_are_those_of_the_main_one() -> None:
    """And a warning says so."""
    one = lf.wavefront(plate(METALENS), 0.05)
    with pytest.warns(lf.DiffractionWarning, match=r"surfaces\[1\].phase has several orders.* order 1 alone"):
        found = lf.wavefront(plate(SEVERAL), 0.05)
    np.testing.assert_allclose(found.opd_waves, one.opd_waves, atol=1e-12)
    np.testing.assert_allclose(found.weight, 0.7 * one.weight, rtol=1e-12)


@pytest.mark.filterwarnings("error")
def test_orders_of_reflected_light_do_not_count() -> None:
    one, mirrored = (
        lf.wavefront(plate({**METALENS, **more}), 0.05)
        for more in ({}, {"reflected_orders": [{"order": 1, "share": 0.5}, {"order": 0, "share": 0.5}]})
    )
    np.testing.assert_array_equal(mirrored.opd_waves, one.opd_waves)
    np.testing.assert_array_equal(mirrored.weight, one.weight)


def test_a_ray_whose_order_is_evanescent_says_so() -> None:
    phase = {"kind": "grating", "lines_per_mm": 2000.0}
    scene = plate(phase, sensor={"pixels": [8, 8], "pixel_mm": 0.01, "distance_mm": 20.0})
    with pytest.raises(lf.LfmeshError, match=r"an order that is evanescent or without light, at surfaces\[1\]"):
        lf.wavefront(scene, 0.0, object_mm=math.inf, image_z_mm=20.0)


def test_the_point_spread_of_a_perfect_metalens_is_airys() -> None:
    scene = plate(METALENS, focus_mm=1e5).changed({"camera.sensor.pixel_mm": 0.0004, "camera.sensor.pixels": [64, 64]})
    found = lf.point_spread(scene, (0.0, 0.0, -1e5), tolerance=COARSE)
    assert found.strehl == pytest.approx(1.0, abs=0.005)
    with pytest.warns(lf.DiffractionWarning, match="several orders"):
        several = lf.point_spread(
            scene.changed({"camera.lens.surfaces[1].phase": SEVERAL}), (0.0, 0.0, -1e5), tolerance=COARSE
        )
    np.testing.assert_allclose(several.mean, 0.7 * found.mean, atol=1e-12 * found.mean.max())


RADIAL_LENSLET = {
    "kind": "radial", "radius_mm": 0.5 * PITCH, "coefficients_rad": [-math.pi * (0.5 * PITCH) ** 2 / (WAVE * FOCAL)],
}  # fmt: skip
NO_RELIEF = {"focal_length_mm": None, "conic": None}
ARRAYS: dict[str, dict[str, Any]] = {
    "towards the lens": {**NO_RELIEF, "curved_phase": RADIAL_LENSLET},
    "towards the sensor": {**NO_RELIEF, "curved_phase": RADIAL_LENSLET, "curved_side": "sensor"},
    "half on either face": {
        **NO_RELIEF,
        "curved_phase": {**RADIAL_LENSLET, "coefficients_rad": [0.5 * RADIAL_LENSLET["coefficients_rad"][0]]},
        "flat_phase": {**RADIAL_LENSLET, "coefficients_rad": [0.5 * RADIAL_LENSLET["coefficients_rad"][0]]},
    },
    "half on glass": {
        "focal_length_mm": 2.0 * FOCAL,
        "curved_phase": {**RADIAL_LENSLET, "coefficients_rad": [0.5 * RADIAL_LENSLET["coefficients_rad"][0]]},
    },
}  # fmt: skip


@pytest.mark.parametrize(("pitches", "place"), [(0, CORNER), (3, CENTRE)])
@pytest.mark.parametrize("mla", ARRAYS)
def test_spreads_behind_diffractive_lenslets_are_fresnels(mla: str, pitches: int, place: Place) -> None:
    """A phase of r² is a thin lens without relief, so the integrals of thin lenses are the truth."""
    array, count = IMAGE + pitches * SPREAD, 9
    found, power = shares(array_camera(array, FOCAL, count, ARRAYS[mla]), place, COARSE)
    assert np.abs(found - square_truth(array, FOCAL, place, count, 360, 6)).sum() < 0.0075
    assert power == pytest.approx(1.0, abs=0.005)


def test_pictures_of_particles_refuse_faces_with_several_orders() -> None:
    scene = plate(SEVERAL).changed(
        {
            "camera.focus_mm": 500.0, "transport.diffraction": "stop", "transport.split": "transmit",
            "transport.samples": 8, "transport.replicates": 4,
            "particles": [{"count": 1, "intensity_w_sr": 1.0, "position_mm": [0.0, 0.0, -500.0],
                           "bounds": {"kind": "sphere", "radius_mm": 0.1}}],
        }
    )  # fmt: skip
    with pytest.raises(lf.LfmeshError, match=r"surfaces\[1\] has a phase with several orders"):
        lf.render(scene)
