"""First-order optics and real axial rays of lenses and lenslets with phases."""

import math
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.optics.glass import C_LINE_NM, D_LINE_NM, F_LINE_NM, refractive_index
from lfmesh.scene import Lens, Paraxial, Surface
from lfmesh.scene.camera.lenslet_optics import lenslet_optics
from lfmesh.scene.first_order import axial_beam, skew_bounds
from lfmesh.scene.first_order.beam_bounds import followed
from lfmesh.scene.first_order.meridional import beam_mm, heights_mm
from lfmesh.scene.first_order.phase_lines import phase_lines

WAVE_NM = 550.0
METALENS = {"kind": "metalens", "focal_length_mm": 20.0, "design_nm": WAVE_NM}
SENSOR = {"pixels": [8, 8], "pixel_mm": 0.01}


def alone(phase: dict[str, Any], **keys: Any) -> Lens:
    """A flat surface in air, with a plane 20 mm behind it."""
    front = {"thickness_mm": 20.0, "semi_diameter_mm": 8.0, "stop": True, "phase": phase} | keys
    return Lens(surfaces=[front, {"semi_diameter_mm": 30.0}])


def power(lens: Lens, wavelength_nm: float, *, section_x: bool = False) -> float:
    return 1.0 / Paraxial.of(lens, wavelength_nm, section_x=section_x).efl_mm


@pytest.mark.parametrize("order", [-1, 1, 2])
def test_a_radial_phase_has_the_power_of_its_first_coefficient(order: int) -> None:
    """−2 m A₁ λ / (2π R²)."""
    lens = alone({"kind": "radial", "coefficients_rad": [-300.0, 50.0], "radius_mm": 5.0, "order": order})
    for wavelength in (450.0, 650.0):
        wanted = order * 2.0 * 300.0 * wavelength * 1e-6 / (2.0 * math.pi * 25.0)
        assert power(lens, wavelength) == pytest.approx(wanted, rel=1e-12)


def test_the_abbe_number_of_a_phase_is_that_of_its_wavelengths() -> None:
    """λ_d / (λ_F − λ_C) = −3.452, whatever the phase."""
    lens = alone({"kind": "radial", "coefficients_rad": [-300.0], "radius_mm": 5.0})
    d, f, c = (power(lens, line) for line in (587.6, 486.1, 656.3))
    assert d / (f - c) == pytest.approx(-3.452, abs=5e-4)


def test_a_hybrid_singlet_is_an_achromat() -> None:
    """Powers φ V_i / (V_1 − V_2) of glass and of a phase on its front, with V_2 = −3.452, unite F and C."""
    glass = "SCHOTT/N-BK7"
    n_d, n_f, n_c = (refractive_index(glass, line) for line in (D_LINE_NM, F_LINE_NM, C_LINE_NM))
    v_glass, v_phase = (n_d - 1.0) / (n_f - n_c), D_LINE_NM / (F_LINE_NM - C_LINE_NM)
    wanted = 1.0 / 50.0
    of_glass, of_phase = wanted * v_glass / (v_glass - v_phase), -wanted * v_phase / (v_glass - v_phase)
    assert 0.0 < of_phase < 0.06 * wanted
    radius = (n_d - 1.0) / of_glass
    first = -of_phase * 2.0 * math.pi * 100.0 / (2.0 * D_LINE_NM * 1e-6)
    lens = Lens(
        surfaces=[
            {
                "radius_mm": radius,
                "thickness_mm": 2.0,
                "glass": glass,
                "semi_diameter_mm": 5.0,
                "stop": True,
                "phase": {"kind": "radial", "coefficients_rad": [first], "radius_mm": 10.0},
            },
            {"semi_diameter_mm": 5.0},
        ]
    )
    d, f, c = (power(lens, line) for line in (D_LINE_NM, F_LINE_NM, C_LINE_NM))
    assert d == pytest.approx(wanted, rel=1e-12)
    assert f == pytest.approx(c, rel=1e-12)


def test_a_metalens_has_its_focal_length_and_that_falls_with_the_wavelength() -> None:
    """f λ₀/λ, of either sign."""
    for focal_length in (20.0, -35.0):
        lens = alone(METALENS | {"focal_length_mm": focal_length})
        for wavelength in (WAVE_NM, 480.0, 700.0):
            wanted = focal_length * WAVE_NM / wavelength
            assert Paraxial.of(lens, wavelength).efl_mm == pytest.approx(wanted, rel=1e-12)


def test_the_power_of_a_phase_adds_to_that_of_refraction() -> None:
    curved = {"radius_mm": 30.0, "index": 1.5}
    phase = {"kind": "radial", "coefficients_rad": [-300.0], "radius_mm": 5.0}
    assert power(alone(phase, **curved), WAVE_NM) == pytest.approx(0.5 / 30.0 + power(alone(phase), WAVE_NM), rel=1e-12)


def test_sections_of_a_polynomial_have_their_own_power() -> None:
    lens = alone({"kind": "xy", "coefficients_rad": [[2, 0, -50.0], [0, 2, -300.0]], "radius_mm": 5.0})
    assert lens.number_off_revolution == 0
    assert power(lens, WAVE_NM) == pytest.approx(6.0 * power(lens, WAVE_NM, section_x=True), rel=1e-12)


def test_a_hologram_has_the_vergences_of_its_points() -> None:
    """1/f = 1/d₁ + 1/d₂ for light from a point that converges to the other, times λ/λ_c."""
    keys = {"point_1_mm": [0.0, 0.0, -60.0], "point_2_mm": [0.0, 0.0, 30.0], "point_2": "virtual"}
    lens = alone({"kind": "hologram", "construction_nm": 500.0} | keys)
    assert lens.number_off_revolution is None
    for wavelength in (500.0, 600.0):
        assert power(lens, wavelength) == pytest.approx((1 / 60 + 1 / 30) * wavelength / 500.0, rel=1e-12)


def test_a_grating_has_no_power_and_the_report_names_its_turn() -> None:
    """sin θ = λ L."""
    scene = scene_of({"kind": "grating", "lines_per_mm": 100.0}, transport={"wavelengths_nm": [WAVE_NM]})
    plain = scene_of(None, transport={"wavelengths_nm": [WAVE_NM]})
    facts = lf.first_order(scene)
    assert facts.efl_mm == lf.first_order(plain).efl_mm
    angle = math.degrees(math.asin(100.0 * WAVE_NM * 1e-6))
    assert any(f"turns light on the axis by {angle:.4g} degrees" in each for each in facts.warnings)


def scene_of(phase: dict[str, Any] | None, transport: dict[str, Any] | None = None, **keys: Any) -> lf.Scene:
    """A weak lens with a phase on its flat back."""
    back: dict[str, Any] = {"semi_diameter_mm": 6.0} | ({"phase": phase} if phase is not None else {})
    front = {"radius_mm": 40.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 4.0, "stop": True}
    camera = {"lens": {"surfaces": [front, back]}, "focus_mm": 500.0, "sensor": SENSOR} | keys
    return lf.Scene(camera=camera, transport=transport or {})


def test_clear_apertures_behind_a_grating_must_be_given() -> None:
    scene = scene_of({"kind": "grating", "lines_per_mm": 100.0})
    with pytest.raises(
        lf.SceneError, match=r"surfaces\[1\].semi_diameter_mm: missing, and the phase of surfaces\[1\] turns light"
    ):
        lf.first_order(scene.changed({"camera.lens.surfaces[1].semi_diameter_mm": None}))


class TestRealRays:
    """Real rays of the axial beam, and their bounds."""

    @pytest.mark.parametrize("height", [0.1, 3.0, -7.5])
    def test_a_metalens_has_no_aberration_on_the_axis(self, height: float) -> None:
        assert heights_mm(alone(METALENS), WAVE_NM, math.inf, height) == pytest.approx([height, 0.0], abs=1e-12)

    def test_the_meridional_ray_is_the_one_in_space(self) -> None:
        phase = {"kind": "radial", "coefficients_rad": [-900.0, 60.0, -20.0], "radius_mm": 5.0, "order": 1}
        lens = alone(phase, radius_mm=25.0, conic=-0.4, index=1.6)
        for height in (0.5, 4.0, 7.0):
            (_, y), *_ = np.moveaxis(axial_beam._crossings(lens, WAVE_NM, 300.0, np.array([[0.0, height]])), 0, -1)
            assert heights_mm(lens, WAVE_NM, 300.0, height) == pytest.approx(y[:-1], rel=1e-8)

    @pytest.mark.parametrize(
        "phase",
        [
            METALENS,
            METALENS | {"focal_length_mm": -15.0},
            {"kind": "radial", "coefficients_rad": [-900.0, 60.0, -20.0], "radius_mm": 5.0},
            {
                "kind": "hologram", "point_1_mm": [0.0, 0.0, -60.0], "point_2_mm": [0.0, 0.0, -30.0],
                "construction_nm": 500.0,
            },
        ],
    )  # fmt: skip
    @pytest.mark.parametrize("radius", [math.inf, 30.0, -30.0])
    def test_no_meridional_ray_leaves_the_bounds_of_its_zone(self, phase: dict[str, Any], radius: float) -> None:
        lens = alone(phase, radius_mm=radius, index=1.6)
        draw = np.random.default_rng(5)
        low = draw.uniform(0.0, 6.5, 60)
        high = low + 10.0 ** draw.uniform(-3.0, 0.0, 60)
        zones = followed(lens, WAVE_NM, 200.0, low, high)
        assert zones.pass_on.mean() > 0.9
        for _ in range(5):
            entry = low + draw.uniform(size=60) * (high - low)
            found, above, below = (
                np.array([heights_mm(lens, WAVE_NM, 200.0, y) for y in entry + step]).T for step in (0.0, 1e-4, -1e-4)
            )
            for value, ranges, rounding in (
                (found, zones.heights_mm, 1e-9), ((above - below) / 2e-4, zones.slopes, 1e-4),
            ):  # fmt: skip
                assert (value >= ranges[:, 0] - rounding).all()
                assert (value <= ranges[:, 1] + rounding).all()

    @pytest.mark.parametrize(
        "phase",
        [
            METALENS,
            {"kind": "xy", "coefficients_rad": [[2, 0, -300.0], [0, 2, -90.0], [2, 1, 9.0]], "radius_mm": 5.0},
            {"kind": "grating", "lines_per_mm": 150.0, "direction_deg": 20.0},
            {
                "kind": "hologram", "point_1_mm": [3.0, 0.0, -60.0], "point_2_mm": [0.0, -4.0, 30.0],
                "point_2": "virtual", "construction_nm": 500.0,
            },
        ],
    )  # fmt: skip
    @pytest.mark.parametrize("radius", [math.inf, 40.0])
    def test_no_skew_ray_leaves_the_bounds_of_its_cell(self, phase: dict[str, Any], radius: float) -> None:
        lens = alone(phase, radius_mm=radius, index=1.6)
        draw = np.random.default_rng(3)
        low = draw.uniform(-5.0, 4.5, (60, 2))
        high = low + 10.0 ** draw.uniform(-3.0, -0.3, (60, 2))
        (least, most), pass_on = skew_bounds._followed(lens, WAVE_NM, 300.0, low, high)
        assert pass_on.mean() > 0.9
        moves = 1e-4 * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
        for _ in range(5):
            entry = low + draw.uniform(size=(60, 2)) * (high - low)
            at, right, left, up, down = (
                np.square(axial_beam._crossings(lens, WAVE_NM, 300.0, entry + move)[:-1]).sum(axis=2) for move in moves
            )
            for k, value in enumerate((at, (right - left) / 2e-4, (up - down) / 2e-4)):
                rounding = 1e-9 if k == 0 else 1e-4
                assert (value >= least[:, k, :60] - rounding).all()
                assert (value <= most[:, k, :60] + rounding).all()

    def test_the_beam_of_a_metalens_narrows_to_its_focus(self) -> None:
        lens = Lens(
            surfaces=[
                alone(METALENS).surfaces[0].model_copy(update={"thickness_mm": 15.0}),
                Surface(semi_diameter_mm=9.0),
            ]
        )
        beam = beam_mm(lens, WAVE_NM, math.inf, 8.0)
        assert beam.found_mm == pytest.approx([8.0, 2.0], rel=1e-5)
        assert beam.proven_mm == pytest.approx([8.0, 2.0], rel=1e-5)

    @pytest.mark.parametrize(("excess", "warned"), [(0.999, True), (1.001, False)])
    def test_an_aperture_that_clips_the_beam_of_a_grating_is_warned_of(self, excess: float, warned: bool) -> None:
        """Parallel light of a round stop, turned by sin θ = λ L, lies between 20 tan θ ± 2 mm."""
        lens = alone({"kind": "grating", "lines_per_mm": 150.0}, semi_diameter_mm=2.0)
        sine = 150.0 * WAVE_NM * 1e-6
        reach = 20.0 * sine / math.sqrt(1.0 - sine**2) + 2.0
        plane = {"thickness_mm": 1.0, "index": 1.5, "semi_diameter_mm": excess * reach}
        back = {"radius_mm": -60.0, "semi_diameter_mm": 20.0}
        camera = {"lens": {"surfaces": [lens.surfaces[0], plane, back]}, "sensor": SENSOR, "focus_mm": math.inf}
        found = lf.first_order(lf.Scene(camera=camera, transport={"wavelengths_nm": [WAVE_NM]})).warnings
        assert any("surfaces[1], whose clear aperture" in each for each in found) is warned


ARRAY = {"count": [8, 8], "pitch_mm": 0.12, "index": 1.5, "thickness_mm": 0.3, "distance_mm": 70.0}
LENSLET = {"kind": "metalens", "focal_length_mm": 0.5, "design_nm": WAVE_NM}


class TestLenslets:
    """Arrays with phases."""

    def optics(self, wavelength_nm: float = WAVE_NM, **keys: Any) -> tuple[lf.Scene, Any]:
        scene = lf.solved(
            scene_of(None, {"wavelengths_nm": [WAVE_NM]}, mla=ARRAY | keys, sensor=SENSOR | {"distance_mm": 0.4})
        )
        return scene, lenslet_optics(scene.camera, wavelength_nm)

    def test_a_metalens_array_has_the_focal_length_of_its_phase(self) -> None:
        for wavelength in (WAVE_NM, 480.0):
            _, at = self.optics(wavelength, curved_phase=LENSLET)
            assert at.focal_length_mm == pytest.approx(0.5 * WAVE_NM / wavelength, rel=1e-12)

    @pytest.mark.parametrize("side", ["lens", "sensor"])
    def test_an_omitted_sensor_stands_in_the_focal_plane(self, side: str) -> None:
        """f − t/n behind the plate if light leaves by the flat face, else f."""
        array = ARRAY | {"curved_phase": LENSLET, "curved_side": side}
        scene = lf.solved(scene_of(None, {"wavelengths_nm": [WAVE_NM]}, mla=array))
        wanted = 0.5 - 0.3 / 1.5 if side == "lens" else 0.5
        assert scene.camera.sensor.distance_mm == pytest.approx(wanted, rel=1e-12)

    def test_both_faces_of_a_plate_add_their_powers(self) -> None:
        """φ₁ + φ₂ − φ₁ φ₂ t/n, with the curved face's refraction in φ₁."""
        flat = {"kind": "radial", "coefficients_rad": [-8.0], "radius_mm": 0.1}
        _, at = self.optics(radius_mm=0.4, curved_phase=LENSLET, flat_phase=flat)
        one, other = 0.5 / 0.4 + 2.0, 2.0 * 8.0 * WAVE_NM * 1e-6 / (2.0 * math.pi * 0.01)
        assert at.power_per_mm == pytest.approx(one + other - one * other * 0.2, rel=1e-12)

    def test_an_immersed_phase_has_its_power_over_the_index(self) -> None:
        camera = {"mla": ARRAY | {"curved_phase": LENSLET}, "image_medium": {"index": 1.3}}
        scene = lf.solved(scene_of(None, {"wavelengths_nm": [WAVE_NM]}, sensor=SENSOR | {"distance_mm": 0.4}, **camera))
        assert lenslet_optics(scene.camera, WAVE_NM).focal_length_mm == pytest.approx(0.5 * 1.3, rel=1e-12)

    def test_the_report_states_the_focal_length(self) -> None:
        scene, _ = self.optics(curved_phase=LENSLET)
        assert any("focal length 0.5 mm" in line for line in lf.first_order(scene).lines())
        (line,) = phase_lines(scene)
        assert line.startswith("phase of the array's curved face")
        assert "metalens, order 1: power 2/mm (focal length 0.5 mm), 100 % of the light in order 1" in line
        # At the corner of the cell, sin θ = r / √(r² + f²).
        corner = 0.12 / math.sqrt(2.0)
        period = WAVE_NM * 1e-3 * math.hypot(corner, 0.5) / corner
        assert f"period from {period:.4g} µm" in line

    def test_different_sections_are_reported_apart(self) -> None:
        phase = {"kind": "xy", "coefficients_rad": [[0, 2, -8.0]], "radius_mm": 0.1}
        scene, at = self.optics(curved_phase=phase)
        assert at.power_per_mm > 0.0
        rows = [line for line in lf.first_order(scene).lines() if line.startswith("lenslets, ")]
        assert any("x–z" in row and "no power" in row for row in rows)


@pytest.mark.parametrize("index", [1.0, 1.3, 1.4, 1.6])
def test_a_metalens_array_in_oil_needs_no_index_of_its_own(index: float) -> None:
    """Its focal length in oil is that in air times the index of the oil, whatever its flat plate is made of."""
    phase = {"kind": "metalens", "focal_length_mm": 2.0, "design_nm": 587.6}
    mla = {"count": [4, 4], "pitch_mm": 0.5, "index": index, "thickness_mm": 0.3, "curved_phase": phase}
    front = {"radius_mm": 50.0, "thickness_mm": 3.0, "index": 1.5168, "semi_diameter_mm": 5.0, "stop": True}
    camera: dict[str, Any] = {
        "focus_mm": 500.0, "image_medium": {"index": 1.4}, "lens": {"surfaces": [front, {"semi_diameter_mm": 5.0}]},
        "mla": mla, "sensor": {"pixels": [16, 16], "pixel_mm": 0.1},
    }  # fmt: skip
    (section,) = lf.first_order(lf.Scene(camera=camera)).lenslet_sections
    assert section.focal_length_mm == pytest.approx(2.8, rel=1e-12)
    assert section.focus_behind_mm == pytest.approx(2.8 - 0.3 * 1.4 / index, rel=1e-12)
    glass = {key: value for key, value in mla.items() if key != "curved_phase"} | {"radius_mm": 1.0}
    if index <= 1.4:
        with pytest.raises(lf.SceneError, match=r"mla\.index = 1\.\d: (has the index|must be above 1)"):
            lf.Scene(camera=camera | {"mla": glass})
