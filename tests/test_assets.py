"""What lies in assets/: scenes are in order, lenses meet their published figures, files are sound."""

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from lfmesh.lightfield.views.focused import focused
from lfmesh.optics.glass import refractive_index
from lfmesh.scene import FirstOrder, Scene, Surface, first_order, load, loads, solved

ASSETS = Path(__file__).resolve().parents[1] / "assets"
SCENES = sorted((ASSETS / "scenes").glob("*.toml"))
LENSES = sorted((ASSETS / "lenses").rglob("*.toml"))

PUBLISHED = {
    # lens: wavelength in nm; EFL, BFL (None: not published) and the agreement to be expected, in mm
    "achromat_100mm": (587.6, 100.1, 97.1, 0.1),
    "angenieux_100mm": (587.6, 100.0, None, 0.1),
    "asphere_100mm": (1310.0, 100.0, None, 0.05),
    "ball_10mm": (587.6, 7.5, 2.5, 1e-12),
    "biotar_100mm": (587.6, 100.0, None, 0.2),
    "cemented_achromat_508mm": (587.6, 20 * 25.4, None, 0.2),
    "cooke_triplet_50mm": (550.0, 49.999783, 42.414858, 5e-7),
    "double_gauss_50mm": (587.6, 50.0, None, 0.5),
    "double_gauss_100mm": (587.6, 100.0, 61.4875364179821, 0.005),
    "edmund_32327_100mm": (587.6, 100.0, 95.95194415183156, 0.05),
    "edmund_55278_52mm": (587.6, 52.24, 43.707716717029655, 0.005),
    "edmund_65564_1_5mm": (587.6, 1.5, 0.9176749924408083, 0.005),
    "field_corrector_127mm": (587.6, 5 * 25.4, None, 0.1),
    "fisheye_10mm": (587.6, 10.0, None, 0.02),
    "flektogon_100mm": (587.6, 100.0, None, 0.3),
    "liou_brennan_eye_17mm": (555.0, 1000.0 / 60.35, 16.27, 0.003),
    "heliar_254mm": (587.6, 10 * 25.4, None, 0.2),
    "petzval_kodak_100mm": (587.6, 100.0, None, 0.1),
    "planar_49mm": (587.6, 49.4, None, 0.05),
    "plano_convex_25mm": (587.6, 25.4, 21.48, 0.005),
    "retrofocus_nikon_100mm": (587.6, 100.0, None, 0.1),
    "takumar_100mm": (587.6, 100.0, None, 0.05),
    "takumar_wide_100mm": (587.6, 100.0, None, 0.05),
    "telephoto_127mm": (587.6, 5 * 25.4, None, 0.05),
    "telephoto_250mm": (587.6, 250.0, None, 0.5),
    "telescope_doublet_1219mm": (587.6, 48 * 25.4, None, 0.5),
    "tessar_50mm": (587.6, 50.0, None, 0.05),
    "wide_angle_22mm": (587.6, 22.0, None, 0.05),
}

F_NUMBERS = {
    # lens: published f-number and the agreement to be expected, where the stop has a size of its own
    "cooke_triplet_50mm": (5.0, 1e-4),
    "double_gauss_50mm": (2.0, 0.05),
    "double_gauss_100mm": (2.0, 1e-3),
    "fisheye_10mm": (4.0, 0.1),
    "telephoto_250mm": (5.6, 0.2),
}

BFL_TO_LAST_DIGIT = ("double_gauss_100mm", "edmund_32327_100mm", "edmund_55278_52mm", "edmund_65564_1_5mm")
"""Lenses whose back focal length a lens design program computed at 587.6 nm and wrote with all its digits."""


def names(paths: list[Path]) -> list[str]:
    return [path.stem for path in paths]


def camera_with(lens: str, wavelength_nm: float) -> Scene:
    """Return the simplest scene with a lens: a conventional camera focused at 3 m."""
    text = f"""
        schema_version = 1
        [camera]
        focus_mm = 3000.0
        [camera.lens]
        file = "lib:{lens}"
        [camera.sensor]
        pixels = [64, 64]
        pixel_mm = 0.01
        [transport]
        wavelengths_nm = [{wavelength_nm}]
    """
    return solved(loads(text, folder=ASSETS))


def report_of(lens: str) -> FirstOrder:
    return first_order(camera_with(lens, PUBLISHED[lens][0]))


@pytest.mark.parametrize("path", SCENES, ids=names(SCENES))
def test_scene_loads_and_has_no_fault_of_layout(path: Path) -> None:
    warnings = first_order(load(path)).warnings
    if path.stem == "conventional":
        # Its point: what the light field camera can refocus, this one leaves out of focus.
        warnings = tuple(warning for warning in warnings if "out of the range that is sharp" not in warning)
    if path.stem == "lytro_class":
        # Pixels of 1 µm behind f/4 lenslets: what the real camera's pixels see is wider.
        assert any("the microlenses' Airy disk is 5.85 pixels wide" in warning for warning in warnings)
        warnings = tuple(warning for warning in warnings if "Airy disk" not in warning)
    if path.stem == "polarised":
        # The panel is seen in the window alone.
        assert any("targets[2] (panel) is out of the field" in warning for warning in warnings)
        warnings = tuple(warning for warning in warnings if "panel" not in warning)
    if path.stem == "eye":
        assert any("without proof for the rays between" in warning for warning in warnings)
        warnings = tuple(warning for warning in warnings if "without proof" not in warning)
    if path.stem == "anamorphic":
        assert any("its focal length is 49.923 mm in y and 35.256 mm in x" in warning for warning in warnings)
        warnings = tuple(warning for warning in warnings if "the lens is anamorphic" not in warning)
    assert warnings == ()


def test_both_cylinders_of_the_anamorphic_camera_focus_on_its_sensor_at_two_thirds() -> None:
    """Paraxial rays by hand, n u' = n u - y (n' - n) / R, in each section, from the axis at 500 mm."""
    n, gaps = 1.5168, (500.0, 4.0, 15.0, 4.0)
    images, magnifications = [], []
    for radii in ((25.8, math.inf, math.inf, math.inf), (math.inf, math.inf, 18.22, math.inf)):
        y, u, before = 0.0, 1.0, 1.0
        for gap, radius, after in zip(gaps, radii, (n, 1.0, n, 1.0), strict=True):
            y += gap * u
            u, before = (before * u - y * (after - before) / radius) / after, after
        images.append(23.0 - y / u)
        magnifications.append(1.0 / u)
    distance = solved(load(ASSETS / "scenes" / "anamorphic.toml")).camera.sensor.distance_mm
    assert distance is not None
    assert images[0] - 23.0 == pytest.approx(distance, abs=2e-4)  # the catalogue's index: 1.51680 to 1e-5
    assert images[1] == pytest.approx(images[0], abs=0.02)  # a tenth of a pixel at f/5.6
    assert magnifications[1] / magnifications[0] == pytest.approx(2 / 3, abs=0.02)


def test_the_hybrid_singlet_brings_two_colours_together() -> None:
    """Paraxial rays by hand from the axis at 500 mm, at the lines F and C; the phase adds mλA/(πR²) to the power."""
    scene = load(ASSETS / "scenes" / "hybrid_singlet.toml").changed({"camera.sensor.bands": None, "lights": ()})
    images = {}
    for line_nm in (486.1, 656.3):
        n = refractive_index("SCHOTT/N-BK7", line_nm)
        inside = (1.0 - 500.0 * (n - 1.0) / 27.2) / n
        height = 500.0 + 4.0 * inside
        for own in (True, False):
            added = 147.5 * line_nm * 1e-6 / (math.pi * 5.0**2) if own else 0.0
            images[own, line_nm] = height / (added * height - n * inside)
        known = solved(scene.changed({"transport.wavelengths_nm": [line_nm]})).camera.sensor.distance_mm
        assert known == pytest.approx(images[True, line_nm] - 3.0, rel=1e-6)
    assert abs(images[True, 486.1] - images[True, 656.3]) < 0.01
    assert images[False, 656.3] - images[False, 486.1] > 0.9


def test_the_rods_of_the_contact_sensor_image_its_chart_upright_at_its_own_size() -> None:
    """Paraxial rays by hand: height and n u harmonic in z within n = n0 sech(g r), and straight in air and window."""
    scene = load(ASSETS / "scenes" / "grin_rods.toml")
    mla, sensor, window = scene.camera.mla, scene.camera.sensor, scene.camera.lens.surfaces[0]
    n0, g = mla.gradient.index, math.sqrt(-mla.gradient.coefficients[0])
    angle = g * mla.thickness_mm
    before = 0.1 + window.thickness_mm / 1.5168 + mla.distance_mm
    rod = np.array(
        [[math.cos(angle), math.sin(angle) / (n0 * g)], [-n0 * g * math.sin(angle), math.cos(angle)]]
    )  # fmt: skip
    there = np.array([[1.0, sensor.distance_mm], [0.0, 1.0]]) @ rod @ np.array([[1.0, before], [0.0, 1.0]])
    assert there[0] == pytest.approx([1.0, 0.0], abs=2e-5)
    report = first_order(scene)
    assert report.relay_magnification == pytest.approx(1.0, abs=1e-6)
    assert report.object_distance_mm == pytest.approx(0.1, abs=2e-5)
    # sech² by its series, up to the corner of a cell.
    r = np.linspace(0.0, mla.pitch_mm / math.sqrt(3.0), 50)
    series = 1.0 + sum(c * r ** (2 * k + 2) for k, c in enumerate(mla.gradient.coefficients))
    assert np.abs(series - np.cosh(g * r) ** -2).max() < 1e-7


def test_the_eye_has_its_published_power_and_length_and_sees_far() -> None:
    """Liou and Brennan, 1997: 60.35 D (60.343 D of their rounded numbers), 23.95 mm, relaxed; in D and mm."""
    scene = solved(load(ASSETS / "scenes" / "eye.toml"))
    assert 1000.0 / first_order(scene).efl_mm == pytest.approx(60.35, abs=0.01)
    lens, retina_mm = scene.camera.lens, scene.camera.sensor.distance_mm
    assert retina_mm == pytest.approx(16.27, abs=5e-3)  # the last digit that is published
    assert lens.vertices_mm[-1] + retina_mm == pytest.approx(23.95, abs=5e-3)
    # Both halves of the lens have one index where they meet.
    front, back = (surface.gradient for surface in lens.surfaces[2:4])
    assert front is not None
    assert back is not None
    assert front.index_on_axis(555.0, 1.59) == pytest.approx(back.index_at(555.0), abs=1e-6)


def test_the_promised_scenes_are_there() -> None:
    promised = {"first_light", "lit_chart", "conventional", "hexagonal", "emitting_plane", "lytro_class", "focused"}
    assert {
        "anamorphic",
        "aquarium",
        "circuit_board",
        "coated",
        "color_checker",
        "cover_glass",
        "diffraction",
        "eye",
        "glossy",
        "grin_rods",
        "ground_glass",
        "hot_metal",
        "hybrid_singlet",
        "immersed_sensor",
        "metalens_array",
        "panel_and_tube",
        "polarised",
        "rolling_shutter",
        "schlieren_plume",
        "streaks",
        "tank",
        "underwater",
        *promised,
    } <= set(names(SCENES))


def test_the_circuit_board_is_an_assembly_of_a_hundred_parts_in_a_small_file() -> None:
    scene = load(ASSETS / "scenes" / "circuit_board.toml")
    assert 95 <= len(scene.targets) <= 105
    assert len(scene.lights) == 60
    assert (ASSETS / "meshes" / "board.glb").stat().st_size < 150_000
    assert len({target.node for target in scene.targets}) == len(scene.targets)
    report = first_order(scene)
    assert report.near_mm < 485.0, "the board can be refocused from its lower edge"
    assert report.far_mm > 522.0, "to the table behind it"


def test_the_lytro_class_array_covers_its_sensor() -> None:
    camera = load(ASSETS / "scenes" / "lytro_class.toml").camera
    assert (camera.sensor.pixels, camera.mla.count, camera.mla.pitch_mm) == ((7728, 5368), (541, 434), 0.014)
    across, rows = 541 * 0.014, 434 * 0.014 * math.sqrt(0.75)
    for array, sensor in zip((across, rows), camera.sensor.size_mm, strict=True):
        assert abs(array - sensor) < 0.5 * camera.mla.pitch_mm


@pytest.mark.parametrize("name", ["first_light", "emitting_plane", "hexagonal", "lytro_class", "metalens_array"])
def test_micro_images_fill_their_pitch_and_do_not_overlap(name: str) -> None:
    report = first_order(load(ASSETS / "scenes" / f"{name}.toml"))
    assert 0.97 < report.micro_image_diameter_px / report.micro_image_pitch_px <= 1.0


def test_the_focused_camera_is_the_one_made_from_the_standard_one() -> None:
    made = focused(load(ASSETS / "scenes" / "emitting_plane.toml"), 3.0).camera
    written = solved(load(ASSETS / "scenes" / "focused.toml")).camera
    assert written.mla.distance_mm == pytest.approx(made.mla.distance_mm, abs=1e-4)
    assert written.mla.radius_mm == pytest.approx(made.mla.radius_mm)
    assert written.sensor.distance_mm == pytest.approx(made.sensor.distance_mm)


def test_bracket_and_chart_lie_on_either_side_of_the_plane_of_focus() -> None:
    scene = load(ASSETS / "scenes" / "first_light.toml")
    bracket, chart = (-target.position_mm[2] for target in scene.targets)
    report = first_order(scene)
    assert report.near_mm < bracket < report.object_distance_mm < chart < report.far_mm


def test_chart_fills_the_field_of_view() -> None:
    scene = load(ASSETS / "scenes" / "first_light.toml")
    report, chart = first_order(scene), scene.targets[1]
    growth = (report.entrance_pupil_z_mm - chart.position_mm[2]) / (
        report.entrance_pupil_z_mm + report.object_distance_mm
    )
    assert chart.shape.width_mm >= growth * report.field_of_view_mm[0]
    assert chart.shape.height_mm >= growth * report.field_of_view_mm[1]


def test_every_lens_has_a_published_figure() -> None:
    assert set(names(LENSES)) == set(PUBLISHED)


@pytest.mark.parametrize("lens", PUBLISHED)
def test_lens_names_its_source(lens: str) -> None:
    assert camera_with(lens, PUBLISHED[lens][0]).camera.lens.source


@pytest.mark.parametrize("lens", PUBLISHED)
def test_focal_lengths_are_the_published_ones(lens: str) -> None:
    _, efl_mm, bfl_mm, tolerance_mm = PUBLISHED[lens]
    report = report_of(lens)
    assert report.efl_mm == pytest.approx(efl_mm, abs=tolerance_mm)
    if bfl_mm is not None:
        assert report.bfl_mm == pytest.approx(bfl_mm, abs=tolerance_mm)


@pytest.mark.parametrize("lens", BFL_TO_LAST_DIGIT)
def test_back_focal_lengths_are_those_of_other_programs(lens: str) -> None:
    """To what the last printed digits of its radii and of the glasses' formulas leave open."""
    assert report_of(lens).bfl_mm == pytest.approx(PUBLISHED[lens][2], rel=2e-9)


@pytest.mark.parametrize("lens", F_NUMBERS)
def test_lens_works_at_its_published_aperture(lens: str) -> None:
    report = report_of(lens)
    f_number, tolerance = F_NUMBERS[lens]
    assert report.efl_mm / report.entrance_pupil_diameter_mm == pytest.approx(f_number, abs=tolerance)


def test_the_catalogue_is_as_large_as_promised() -> None:
    assert len(LENSES) >= 20


def axis_crossing_mm(front: Surface, index: float, height_mm: float) -> float:
    """Return where a ray parallel to the axis crosses it behind the rear face of a plano-convex singlet."""
    root = math.sqrt(1 - (1 + front.conic) * height_mm**2 / front.radius_mm**2)
    sag = height_mm**2 / (front.radius_mm * (1 + root))
    slope = height_mm / (front.radius_mm * root)
    for power, coefficient in zip((4, 6, 8), front.asphere_mm, strict=True):
        sag += coefficient * height_mm**power
        slope += power * coefficient * height_mm ** (power - 1)
    incidence = math.atan(slope)
    inside = incidence - math.asin(math.sin(incidence) / index)
    height_at_rear = height_mm - (front.thickness_mm - sag) * math.tan(inside)
    return height_at_rear / math.tan(math.asin(index * math.sin(inside)))


def test_asphere_is_free_of_spherical_aberration_at_its_design_wavelength() -> None:
    """Rays of every height cross the axis within 0.1 µm of the paraxial focus, or a coefficient is wrong."""
    front = camera_with("asphere_100mm", 1310.0).camera.lens.surfaces[0]
    index = refractive_index(front.medium, 1310.0)
    focus_mm = report_of("asphere_100mm").bfl_mm
    errors = [axis_crossing_mm(front, index, h) - focus_mm for h in np.linspace(0.5, front.semi_diameter_mm, 23)]
    assert np.abs(errors).max() < 1e-4


def test_bracket_is_a_closed_solid_of_the_size_its_scene_expects() -> None:
    bracket = trimesh.load_mesh(ASSETS / "meshes" / "bracket.stl")
    assert bracket.is_watertight
    assert bracket.is_winding_consistent
    assert bracket.is_volume
    assert bracket.extents == pytest.approx([36.0, 34.0, 46.0], abs=0.1)
    assert np.abs(bracket.bounds.sum(axis=0)).max() < 1e-3, "not centred on its origin"
    # Two screw holes, two slots and the eye go through; each raises the genus by one.
    assert 1 - bracket.euler_number / 2 == 5


@pytest.mark.parametrize("name", ["chart", "siemens", "dots"])
def test_chart_opens_as_a_contrasty_8_bit_picture(name: str) -> None:
    path = ASSETS / "charts" / f"{name}.png"
    assert path.stat().st_size < 500_000
    with Image.open(path) as picture:
        grey = np.asarray(picture.convert("L"))
    assert grey.shape[0] == grey.shape[1] >= 1024
    assert grey.min() < 30
    assert grey.max() > 220
