"""Waves and spots behind gradient-index glass against closed forms: perfect rods, parabolic rods, and refusals."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.errors import LfmeshError
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.waves.bundle import LensRays, pupil_grid
from lfmesh.waves.pupil_waves import waves_of_field
from lfmesh.waves.ray_ends import Edge

Array = NDArray[np.float64]

WAVE_NM = 550.0
MM_PER_NM = 1e-6

N0, G = 1.6, 0.1
"""Index on the axis, and gradient constant in 1/mm."""

RIM_MM = 1.0

QUARTER_MM = 0.5 * math.pi / G
"""Quarter of the pitch."""

SENSOR = {"pixels": [8, 8], "pixel_mm": 0.01, "distance_mm": 5.0}


def sech_terms(count: int) -> list[float]:
    """Return c_k of sech² x = 1 + Σ c_k x^(2k), the derivative of t = tanh x, by t' = 1 − t²."""
    tanh = [1.0]
    for k in range(1, count + 1):
        tanh.append(-sum(tanh[i] * tanh[k - 1 - i] for i in range(k)) / (2 * k + 1))
    return [(2 * k + 1) * tanh[k] for k in range(1, count + 1)]


def sech_gradient() -> dict[str, Any]:
    """Return n = n₀ sech(g r), which images all meridional rays perfectly (A. Fletcher et al., 1954)."""
    coefficients = [c * G ** (2 * (k + 1)) for k, c in enumerate(sech_terms(14))]
    return {"kind": "radial_n2", "index": N0, "coefficients": coefficients}


PARABOLIC = {"kind": "radial_n2", "index": N0, "coefficients": [-G * G]}


def rod(gradient: dict[str, Any], length_mm: float, **more: Any) -> lf.Scene:
    """A rod with flat faces, and its stop in front."""
    front = {"stop": True, "thickness_mm": length_mm, "gradient": gradient, "semi_diameter_mm": RIM_MM}
    camera: dict[str, Any] = {"lens": {"surfaces": [front, {"semi_diameter_mm": 2.0 * RIM_MM}]}, "sensor": SENSOR}
    return lf.Scene.model_validate(
        {"schema_version": 1, "camera": {**camera, **more}, "transport": {"wavelengths_nm": [WAVE_NM]}}
    )


def rays_of(scene: lf.Scene, object_mm: float = math.inf, image_z_mm: float = QUARTER_MM) -> LensRays:
    return LensRays(lf.build(lf.solved(scene)), object_mm, image_z_mm)


def test_a_perfect_rod_of_a_quarter_pitch_has_no_aberration() -> None:
    """All rays parallel to the axis are meridional, and meet on the rear face after equal optical paths."""
    found = lf.wavefront(rod(sech_gradient(), QUARTER_MM), object_mm=math.inf, image_z_mm=QUARTER_MM)
    assert found.passed == 1.0
    assert found.pv_waves * WAVE_NM * MM_PER_NM < 1e-10
    assert found.strehl == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("quarters", [0.37, 1.0, 2.6])
def test_the_path_through_a_perfect_rod_is_that_of_the_closed_form(quarters: float) -> None:
    """(n₀/g) Δ arctan(√(1 + A²) tan u) on a meridional ray sinh(g r) = A sin u, u = g z + φ."""
    length = quarters * QUARTER_MM
    entry = np.column_stack([0.3 * np.linspace(-0.9, 0.9, 7), np.linspace(-0.9, 0.9, 7)])
    traced = rays_of(rod(sech_gradient(), length)).traced([0.0, 0.0], entry, WAVE_NM)
    amplitude = np.sinh(G * np.hypot(*entry.T))
    # From u = π/2, the arctangent grows by π/2 in each quarter.
    whole = math.floor(quarters)
    past = np.arctan(
        math.tan((quarters - whole) * 0.5 * math.pi) * (1.0 + amplitude**2) ** (0.5 if whole % 2 else -0.5)
    )
    np.testing.assert_allclose(traced.path_mm, N0 / G * (0.5 * math.pi * whole + past), rtol=0.0, atol=1e-10)
    height = np.arcsinh(amplitude * np.cos(G * length)) / G
    np.testing.assert_allclose(np.hypot(*traced.position[:, :2].T), np.abs(height), rtol=0.0, atol=2e-9)


def parabolic_height_mm(start_mm: Array, length_mm: float) -> Array:
    """Return the height of rays that enter parallel to the axis, r cos(g z n₀ / n(r))."""
    return np.asarray(start_mm * np.cos(G * length_mm / np.sqrt(1.0 - (G * start_mm) ** 2)))


def test_the_spot_of_a_parabolic_rod_is_that_of_the_closed_form() -> None:
    rays = rays_of(rod(PARABOLIC, QUARTER_MM))
    grid = pupil_grid(16)
    bundle = rays.bundle(0.0, grid, WAVE_NM)
    assert bundle.passes.all()
    radius = np.hypot(*grid.T)
    expected = grid / radius[:, None] * parabolic_height_mm(RIM_MM * radius, QUARTER_MM)[:, None]
    np.testing.assert_allclose(bundle.place, expected, rtol=0.0, atol=2e-9)
    assert np.abs(expected).max() > 1e-3, "no aberration: no test of it"


def test_the_lens_sheet_of_a_parabolic_rod_has_its_closed_form() -> None:
    """A rod a little shorter than a quarter of the pitch, focused behind its rear face."""
    scene = rod(PARABOLIC, 0.8 * QUARTER_MM, sensor={**SENSOR, "distance_mm": None}, focus_mm=math.inf)
    sheet = lf.analyse(scene, height_mm=0.05, wavelengths_nm=(WAVE_NM,), across=16)
    angle = 0.8 * 0.5 * math.pi
    assert sheet.first_order.efl_mm == pytest.approx(1.0 / (N0 * G * math.sin(angle)), rel=1e-12)
    assert sheet.image_z_mm == pytest.approx(0.8 * QUARTER_MM + 1.0 / (N0 * G * math.tan(angle)), rel=1e-12)
    front = sheet.waves[0]
    assert not isinstance(front, str), front
    assert front.wavefront.strehl == pytest.approx(lf.wavefront(scene).strehl, rel=1e-12)
    fan = sheet.fans[0][0]
    start = fan.pupil * RIM_MM
    axis = np.sqrt(1.0 - (G * start) ** 2)
    turn = G * 0.8 * QUARTER_MM / axis
    # n sin of the angle is kept at the flat face.
    sine = -N0 * G * start * np.sin(turn)
    expected = start * np.cos(turn) + (sheet.image_z_mm - 0.8 * QUARTER_MM) * sine / np.sqrt(1.0 - sine**2)
    np.testing.assert_allclose(fan.tangential_mm, expected, rtol=0.0, atol=1e-8)


def test_the_point_spread_of_a_rod_peaks_by_its_strehl_ratio() -> None:
    scene = rod(PARABOLIC, 0.8 * QUARTER_MM, sensor={"pixels": [64, 64], "pixel_mm": 0.002}, focus_mm=1000.0)
    found = lf.point_spread(scene, (0.0, 0.0, -1000.0))
    assert found.strehl == pytest.approx(lf.wavefront(scene).strehl, abs=0.01)


GRADIENTS: dict[str, dict[str, Any]] = {
    "radial_n": {"kind": "radial_n", "index": 1.6, "coefficients": [-0.004, 2e-5], "axial_coefficients": [0.01, -1e-3]},
    "radial_n2": {"kind": "radial_n2", "index": 1.6, "coefficients": [-0.01, 5e-5]},
    "axial": {"kind": "axial", "index": 1.7, "coefficients": [-0.03, 0.002]},
    "spherical": {"kind": "spherical", "index": 1.6, "coefficients": [-0.02, 0.001], "radius_mm": 25.0},
    "xyz": {"kind": "xyz", "index": 1.6, "x_coefficients": [0.004, -0.003], "y_coefficients": [0.0, -0.005, 2e-4],
            "z_coefficients": [0.01]},
}  # fmt: skip


@pytest.mark.parametrize("kind", GRADIENTS)
def test_the_gradient_of_the_path_is_the_direction(kind: str) -> None:
    """By Malus and Dupin, behind a tilted and shifted lens of gradient glass, from a near point beside the axis."""
    front = {"stop": True, "thickness_mm": 4.0, "radius_mm": 40.0, "semi_diameter_mm": 2.0, "gradient": GRADIENTS[kind]}
    back = {"radius_mm": -30.0, "conic": 0.4, "asphere_mm": [2e-5], "semi_diameter_mm": 3.0}
    pose = {"tilt_deg": [2.0, -3.0, 20.0], "shift_mm": [0.1, -0.2, 0.05]}
    lens = {"surfaces": [front, back], "elements": [{"surfaces": [0, 1], "pose": pose}]}
    rays = rays_of(rod(PARABOLIC, 1.0, lens=lens), 80.0)
    step, at = 1e-3, 1.2 * pupil_grid(5)
    for move in (np.array([step, 0.0]), np.array([0.0, step])):
        more, here, less = (rays.traced([0.02, -0.05], at + sign * move, WAVE_NM) for sign in (1.0, 0.0, -1.0))
        along = more.position - less.position
        length = np.linalg.norm(along, axis=1)
        slope = (more.path_mm - less.path_mm) / length
        np.testing.assert_allclose(slope, (here.direction * along).sum(axis=1) / length, rtol=0.0, atol=2e-8)


def narrow_rod() -> lf.Scene:
    """A rod as wide as its stop: steep rays of a near point meet its edge between the faces."""
    surfaces = [
        {"stop": True, "thickness_mm": 1.6 * QUARTER_MM, "gradient": PARABOLIC, "semi_diameter_mm": RIM_MM},
        {"semi_diameter_mm": RIM_MM},
    ]
    return rod(PARABOLIC, 1.0, lens={"surfaces": surfaces})


def test_rays_that_meet_the_edge_of_the_glass_name_it_and_waves_refuse_them() -> None:
    scene = narrow_rod()
    rays = rays_of(scene, 20.0, 1.6 * QUARTER_MM + 5.0)
    bundle = rays.bundle(0.0, pupil_grid(16), WAVE_NM)
    # A ray from the height h with the reduced slope p has the amplitude √(h² + (p / n₀ g)²). The rim is a little wider.
    height = RIM_MM * np.hypot(*bundle.pupil.T)
    amplitude = np.hypot(height, height / np.hypot(height, 20.0) / (N0 * G))
    stopped = amplitude > max(rays.world.lens_shape.rims)
    assert 0 < stopped.sum() < len(stopped)
    assert not bundle.passes[stopped].any()
    assert bundle.passes[amplitude < RIM_MM].all()
    assert set(bundle.ends.edge[stopped]) == {Edge.GLASS_EDGE}
    assert "the edge of the gradient-index glass behind surfaces[0]" in " ".join(bundle.ends.words())
    with pytest.raises(LfmeshError, match=r"camera.lens.surfaces\[0\].gradient: .* end inside the glass"):
        waves_of_field(rays, solved_camera(rays.world.scene), np.zeros(2), WAVE_NM)


FADING = {"kind": "axial", "index": 1.5, "coefficients": [-0.24]}


def test_a_ray_that_turns_back_in_the_glass_is_named() -> None:
    """From n = 1.5 towards 1.02: a ray with n sin θ = 1.23 turns back, as in a mirage."""
    wide = {f"camera.lens.surfaces[{k}].semi_diameter_mm": 9.0 for k in (0, 1)}
    scene = rod(FADING, 2.0, object_medium={"index": 1.5}).changed(wide)
    with pytest.raises(LfmeshError, match=r"the gradient-index glass behind surfaces\[0\], in which it turns away"):
        lf.wavefront(scene, math.tan(math.radians(55.0)), object_mm=math.inf, image_z_mm=10.0)


def test_a_chief_ray_that_turns_back_in_the_glass_names_it() -> None:
    """A ray with n sin θ = 1.1 turns back; one with 0.9 passes."""
    rays = rays_of(rod(FADING, 2.0, object_medium={"index": 1.5}), 20.0, 10.0)
    turns, passes = (rays.chief(math.tan(math.asin(p / 1.5)), WAVE_NM) for p in (1.1, 0.9))
    assert passes.exists
    assert passes.blocked_by == ""
    assert not turns.exists
    assert turns.blocked_by == (
        "the gradient-index glass behind surfaces[0], in which it turns away from the next surface"
    )


def test_gradient_index_lenslets_refuse_waves() -> None:
    mla = {"count": [4, 4], "pitch_mm": 0.5, "thickness_mm": 3.0, "gradient": PARABOLIC}
    lens = {"surfaces": [{"paraxial": True, "focal_length_mm": 20.0, "stop": True, "semi_diameter_mm": 2.0}]}
    sensor = {"pixels": [64, 64], "pixel_mm": 0.03}
    scene = rod(PARABOLIC, 1.0, lens=lens, mla=mla, sensor=sensor, focus_mm=100.0)
    with pytest.raises(
        LfmeshError, match=r"camera.mla.gradient: waves are not followed through gradient-index lenslets"
    ):
        lf.point_spread(scene, (0.0, 0.0, -100.0))
