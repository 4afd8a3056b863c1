"""Cameras of the library have the published figures. Tolerances are the rounding of the published numbers."""

import math
import re
from functools import cache

import pytest

from lfmesh.assets import asset_path
from lfmesh.scene import FirstOrder, Scene, first_order, loads
from lfmesh.scene.camera_library import camera_names, library_camera
from lfmesh.scene.first_order.report import GALILEAN, STANDARD


@cache
def scene_of(name: str) -> Scene:
    return loads(library_camera(name).text, folder=asset_path("cameras"))


@cache
def facts_of(name: str) -> FirstOrder:
    return first_order(scene_of(name))


@pytest.mark.parametrize("name", camera_names())
def test_a_camera_has_no_fault_of_layout_and_names_its_source(name: str) -> None:
    camera = library_camera(name)
    assert facts_of(name).warnings == ()
    assert re.search(r"\(\d{4}\)|tests/test_lytro\.py", camera.source)
    assert camera.title.endswith(".")
    assert "Source" not in camera.title


@pytest.mark.parametrize("name", camera_names())
def test_every_key_of_a_camera_is_explained_and_figures_without_a_source_are_marked(name: str) -> None:
    text = library_camera(name).text
    head, *tables = re.split(r"^(?=\[)", text, flags=re.MULTILINE)
    assert 'Figures marked "assumed" are not from this source. Lengths are in mm' in head
    for table in tables:
        if table.startswith("[camera"):
            for line in table.splitlines():
                is_list = line.endswith(("[", "]")) or line.startswith(("surfaces", "  {"))
                assert not line or is_list or "#" in line, line
    assert text.count("(assumed)") >= 4


def test_ng_2005_has_a_photograph_of_292_points_and_just_under_14_views() -> None:
    facts, camera = facts_of("ng_2005_handheld"), scene_of("ng_2005_handheld").camera
    assert facts.kind == STANDARD
    assert facts.micro_image_pitch_px == pytest.approx(14, rel=0.5 / 14)
    assert facts.micro_image_pitch_px < 14
    assert facts.microlens_f_number == pytest.approx(500 / 125, rel=0.5 / 125)
    # Pixels "9 microns wide": 9 ± 0.5.
    assert camera.sensor.size_mm[0] / camera.mla.pitch_mm == pytest.approx(292, rel=0.5 / 9)


def test_ng_2005_refocuses_within_the_depth_of_field_of_a_lens_14_times_stopped_down() -> None:
    """Sharpness grows with the number of pixels under a microlens: f/4 refocuses as f/56 is sharp.

    By hand for the thin lens: an image point eps behind the array makes a spot of A eps / (b + eps) through a pupil A.
    """
    focal, focus, f_number, pitch = 80.0, 2000.0, 4.0, 0.125
    image = 1 / (1 / focal - 1 / focus)

    def near_mm(views: float) -> float:
        pupil = image / (f_number * views)
        behind = image + pitch * image / (pupil - pitch)
        return 1 / (1 / focal - 1 / behind)

    facts = facts_of("ng_2005_handheld")
    assert near_mm(14.0) < facts.near_mm < near_mm(13.5)
    assert facts.far_mm == math.inf


def test_levoy_2006_resolves_3_micrometres_with_12_spots_and_15_pixels_per_lenslet() -> None:
    facts, camera = facts_of("levoy_2006_microscope"), scene_of("levoy_2006_microscope").camera
    assert facts.magnification == pytest.approx(-40, rel=0.5 / 40)
    assert facts.working_f_number == pytest.approx(40 / (2 * 0.95), rel=0.005 / 0.95)
    assert 1e3 * facts.object_sampling_mm == pytest.approx(3.1, rel=0.05 / 3.1)
    assert facts.exit_pupil_z_mm + 160 == pytest.approx(facts.lenslets_z_mm, rel=0.5 / 160)
    assert facts.micro_image_pitch_px == pytest.approx(15, rel=0.5 / 15)
    assert facts.microlens_f_number == pytest.approx(20, rel=0.5 / 20)
    assert camera.mla.size_mm == pytest.approx((25, 25), rel=0.5 / 25)
    # The slides' spot is Sparrow's limit, 0.47 λ / NA, where the Airy disk's radius is 0.61 λ / NA.
    spot_um = 1e3 * facts.airy_disk_mm / 2 * 0.47 / 0.61
    assert spot_um == pytest.approx(10.4, rel=0.05 / 10.4)
    assert spot_um / 40 == pytest.approx(0.26, rel=0.005 / 0.26)
    assert 125 / spot_um == pytest.approx(12, rel=0.5 / 12)


def test_the_illum_is_decoded_to_15_views_of_434_rows_and_625_columns() -> None:
    facts, camera = facts_of("lytro_illum"), scene_of("lytro_illum").camera
    assert facts.kind == STANDARD
    assert math.ceil(facts.micro_image_pitch_px) == 15
    # An offset of 37 µm between array and sensor widens the pitch by 37 µm / 97.3 mm.
    assert facts.micro_image_pitch_px == pytest.approx(20 / 1.4 * (1 + 0.037 / 97.28562), rel=1e-6)
    assert facts.lenslets_z_mm - facts.exit_pupil_z_mm == pytest.approx(97.28562, rel=2e-5)
    assert facts.efl_mm == pytest.approx(24.199466, rel=0.5e-4 / 24.2)
    width, height = camera.sensor.size_mm
    assert camera.mla.count == (round(width / 0.02), round(height / (0.02 * math.sqrt(0.75))))
    assert camera.mla.count[1] == 434
    # Toolboxes resample the columns to the distance of the rows.
    assert camera.mla.count[0] / math.sqrt(0.75) == pytest.approx(625, abs=0.5)


def test_the_r12_has_the_micro_images_of_its_calibration() -> None:
    facts, camera = facts_of("raytrix_r12"), scene_of("raytrix_r12").camera
    assert facts.kind == GALILEAN
    # The pitch on the sensor was measured in white images; pitch, D and d come from pictures of a checkerboard.
    assert facts.micro_image_pitch_px == pytest.approx(23.31, rel=0.005 / 23.31)
    for array, sensor in zip(camera.mla.size_mm, camera.sensor.size_mm, strict=True):
        assert array == pytest.approx(sensor, abs=camera.mla.pitch_mm)
    assert [at.to_sensor_mm for at in facts.focused] == pytest.approx([0.324774] * 3, rel=2e-6)
    # A camera with matched f-numbers is covered from the virtual depth 2 on.
    assert [at.covering_depth for at in facts.focused] == pytest.approx([2.0] * 3, rel=0.5 / 2)
    assert all(abs(at.virtual_depth) > at.covering_depth for at in facts.focused)


def test_the_r12_has_micro_images_as_wide_as_measured_in_white_images() -> None:
    """Radii by lenslet type, m / N + q: 11.66, 10.73 and 11.35 pixels, with m = -0.140596 mm and N = 4.

    The final calibration, from pictures of a checkerboard, has m = d f / 2D = 0.142380 mm: 1.3 % is the source's error.
    The micro-image is the pupil's image, blurred by the lenslet where the sensor is out of the pupil's focus.
    """
    scene = scene_of("raytrix_r12").changed({"camera.lens.f_number": 4.0})
    facts, camera = first_order(scene), scene.camera
    assert facts.entrance_pupil_diameter_mm == pytest.approx(12.42862, rel=1e-6)
    m, q, pixel = -0.14059554, (-0.02897562, -0.02384261, -0.02728867), 0.0055
    for at, each in zip(facts.focused, q, strict=True):
        to_pupil = facts.lenslets_z_mm - facts.exit_pupil_z_mm
        blur = camera.mla.pitch_mm / pixel * (1 / to_pupil - 1 / at.main_image_mm) * at.to_sensor_mm
        radius = (facts.micro_image_diameter_px + blur) / 2
        assert radius == pytest.approx(-(m / 4 + each) / pixel, rel=0.013)
    # So wide, they leave no gaps at a pitch of 23.3 pixels, though the pupil's image is 12.9 pixels wide.
    assert not any("micro-images leave gaps" in warning for warning in facts.warnings)


def test_the_piv_camera_has_the_micro_images_and_the_field_of_its_toolkit() -> None:
    facts, camera = facts_of("auburn_piv"), scene_of("auburn_piv").camera
    assert facts.kind == STANDARD
    assert camera.mla.count == (289, 193)
    assert camera.sensor.size_mm[1] == pytest.approx(24.272, rel=0.0005 / 24.272)
    assert facts.micro_image_pitch_px == pytest.approx(16.9689, rel=0.0005 / 0.125)
    assert facts.magnification == pytest.approx(-24.272 / 24.2, rel=0.05 / 24.2)
