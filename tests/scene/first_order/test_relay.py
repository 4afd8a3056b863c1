"""Gradient-index rods that image a plane before them onto the sensor, against their closed paraxial matrices.

A rod with n² = n0² (1 − g² r²), plane faces and a = g L has the matrix (cos a, sin a / (n0 g), −n0 g sin a, cos a) on
height and n·slope. With the sensor s behind it, it images the plane l = −(B + D s)/m before it with m = A + C s.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import lfmesh as lf
from lfmesh.geometry.objects.placement import placements
from lfmesh.lightfield.views.upright import Upright
from lfmesh.scene.advice import half_field_mm

N0, G, PITCH_MM, PIXEL_MM = 1.6, 0.4, 0.6, 0.01
SINE = N0 * G * 0.5 * PITCH_MM
"""Sine of the widest cone that a rod guides: n0² − n²(p/2) = (n0 g p/2)²."""
WINDOW_MM, WINDOW_INDEX = 0.3, 1.5
OBJECT_MM = 0.25
UPRIGHT, INVERTED = 1.25 * math.pi, 0.75 * math.pi
CASES = [(0.5, UPRIGHT), (1.0, UPRIGHT), (2.0, UPRIGHT), (-1.0, INVERTED)]


def distances(magnification: float, angle: float) -> tuple[float, float]:
    """Return l and s, in mm of air."""
    a, b, c = math.cos(angle), math.sin(angle) / (N0 * G), -N0 * G * math.sin(angle)
    behind = (magnification - a) / c
    return -(b + a * behind) / magnification, behind


def behind_window(
    magnification: float, angle: float = UPRIGHT, *, count: int = 20, pixels: int = 800, **keys: Any
) -> lf.Scene:
    """Return rods behind a window; the plane that they image appears `OBJECT_MM` before it."""
    before, behind = distances(magnification, angle)
    surfaces = [
        {"thickness_mm": WINDOW_MM, "index": WINDOW_INDEX, "semi_diameter_mm": 20.0},
        {"semi_diameter_mm": 20.0, "stop": True},
    ]
    camera = {
        "lens": {"surfaces": surfaces},
        "mla": rods(count, angle) | {"distance_mm": before - OBJECT_MM - WINDOW_MM / WINDOW_INDEX},
        "sensor": {"pixels": [pixels, pixels], "pixel_mm": PIXEL_MM, "distance_mm": behind},
    }
    return lf.Scene(camera=camera, **keys)


def rods(count: int, angle: float) -> dict[str, Any]:
    gradient = {"kind": "radial_n2", "index": N0, "coefficients": [-G * G]}
    return {"count": [count, count], "pitch_mm": PITCH_MM, "thickness_mm": angle / G, "gradient": gradient}


def reach_mm(magnification: float, angle: float = UPRIGHT) -> float:
    """Return half the width of a rod's image: the largest y + s u with y² + (u / (n0 g))² at most (p/2)²."""
    _, behind = distances(magnification, angle)
    return 0.5 * PITCH_MM * math.hypot(1.0, behind * N0 * G)


@pytest.mark.parametrize(("magnification", "angle"), CASES)
def test_the_plane_in_focus_is_the_one_that_rods_image_onto_the_sensor(magnification: float, angle: float) -> None:
    report = lf.first_order(behind_window(magnification, angle))
    assert report.object_distance_mm == pytest.approx(OBJECT_MM, rel=1e-9)
    assert report.magnification == pytest.approx(1.0, rel=1e-12)
    assert report.object_sampling_mm == pytest.approx(PIXEL_MM / abs(magnification), rel=1e-9)
    if magnification > 0.0:
        assert report.relay_magnification == pytest.approx(magnification, rel=1e-9)
        assert report.kind == "conventional"
        # A pixel is pixel / m wide in the image by the lens.
        samples = report.airy_disk_mm / report.airy_disk_samples
        assert samples == pytest.approx(PIXEL_MM / magnification, rel=1e-9)
    else:
        # Inverted images of separate lenslets: a focused camera, with the virtual depth −1/m.
        assert report.relay_magnification is None
        assert report.kind == "focused plenoptic, Keplerian"
        assert report.focused[0].virtual_depth == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize(("magnification", "angle"), CASES)
def test_a_single_rod_sees_the_size_of_the_sensor_over_its_magnification(magnification: float, angle: float) -> None:
    scene = behind_window(magnification, angle, count=1, pixels=40)
    report = lf.first_order(scene)
    assert 2.0 * reach_mm(magnification, angle) > 40 * PIXEL_MM
    assert report.relay_magnification == pytest.approx(magnification, rel=1e-9)
    assert report.object_distance_mm == pytest.approx(OBJECT_MM, rel=1e-9)
    assert report.object_sampling_mm == pytest.approx(PIXEL_MM / abs(magnification), rel=1e-9)
    assert report.field_of_view_mm == pytest.approx([40 * PIXEL_MM / abs(magnification)] * 2, rel=1e-9)
    assert Upright.of(scene).inverts == (magnification < 0.0)
    assert not any("do not join" in each or "outer" in each for each in report.warnings)


@pytest.mark.parametrize("magnification", [0.5, 1.0, 2.0])
def test_many_rods_see_about_the_size_of_the_sensor_whatever_their_magnification(magnification: float) -> None:
    size = 800 * PIXEL_MM
    wide = size + 2.0 * reach_mm(magnification) * abs(1.0 - 1.0 / magnification)
    assert lf.first_order(behind_window(magnification)).field_of_view_mm == pytest.approx([wide, wide], rel=1e-9)


@pytest.mark.parametrize("magnification", [0.5, 1.0, 2.0])
@pytest.mark.parametrize(("count", "pixels"), [(1, 40), (1, 400), (3, 60), (3, 800), (9, 200), (9, 800)])
def test_the_field_is_the_part_of_the_plane_with_guided_rays_to_the_sensor(
    magnification: float, count: int, pixels: int
) -> None:
    """All rays at the rods' rear faces that are guided: y² + (u / (n0 g))² at most half a pitch squared."""
    before, behind = distances(magnification, UPRIGHT)
    share, turn = np.meshgrid(np.linspace(0.0, 1.0, 41), np.linspace(0.0, 2.0 * math.pi, 721))
    y, u = 0.5 * PITCH_MM * share * np.cos(turn), SINE * share * np.sin(turn)
    cosine, sine = math.cos(UPRIGHT), math.sin(UPRIGHT)
    y0, u0 = cosine * y - sine / (N0 * G) * u, N0 * G * sine * y + cosine * u
    outermost, widest = 0.5 * (count - 1) * PITCH_MM, 0.0
    # Rods at any place between the outermost ones: the report does not resolve single cells.
    for axis in np.linspace(-outermost, outermost, 401):
        landed, point = axis + y + behind * u, axis + y0 - before * u0
        seen = np.abs(point[np.abs(landed) <= 0.5 * pixels * PIXEL_MM])
        widest = max(widest, 2.0 * seen.max(initial=0.0))
    report = lf.first_order(behind_window(magnification, count=count, pixels=pixels))
    assert report.field_of_view_mm[0] == pytest.approx(widest, rel=0.01)


@pytest.mark.parametrize("magnification", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("index", [1.0, 1.33])
def test_the_cone_of_guided_light_is_the_same_in_any_medium(magnification: float, index: float) -> None:
    scene = behind_window(magnification)
    before, behind = distances(magnification, UPRIGHT)
    changes = {
        "camera.image_medium": {"index": index},
        "camera.mla.distance_mm": index * (before - OBJECT_MM - WINDOW_MM / WINDOW_INDEX),
        "camera.sensor.distance_mm": index * behind,
    }
    report = lf.first_order(scene.changed(changes))
    assert report.object_distance_mm == pytest.approx(OBJECT_MM, rel=1e-9)
    assert report.working_f_number == pytest.approx(0.5 / SINE, rel=1e-6)


@pytest.mark.parametrize("magnification", [0.5, 1.0, 2.0])
def test_targets_are_in_the_field_within_the_cone_that_rods_guide(magnification: float) -> None:
    """Beyond the plane in focus, the field widens by the guided cone, not by the window's rim."""
    z = -30.0
    wide = lf.first_order(behind_window(magnification)).field_of_view_mm[0]
    half = 0.5 * wide + (-z - OBJECT_MM) * SINE
    for x, outside in ((half - 0.3, False), (half + 0.3, True)):
        target = {"shape": {"kind": "disk", "radius_mm": 0.1}, "position_mm": [x, 0.0, z]}
        report = lf.first_order(behind_window(magnification, targets=[target]))
        assert half_field_mm(z, report)[0] == pytest.approx(half, rel=1e-6)
        assert any("out of the field" in each for each in report.warnings) == outside


def test_bodies_far_behind_the_plane_in_focus_have_the_samples_of_parallel_chief_rays(tmp_path: Path) -> None:
    """Each pixel looks along the axis, so a sample 120 times as far away is not 120 times as wide."""
    trimesh.creation.box(extents=(0.5, 0.5, 0.5)).export(tmp_path / "part.stl")
    target = {"file": "part.stl", "units": "mm", "position_mm": [0.0, 0.0, -30.0]}
    (placement,) = placements(behind_window(1.0, targets=[target]).in_folder(tmp_path))
    assert not any("less than a sample" in each for each in placement.warnings)


@pytest.mark.parametrize("magnification", [0.5, 1.0, 2.0])
def test_check_reports_images_that_do_not_join(magnification: float) -> None:
    """Neighbouring rods image a point |1 − m| p apart."""
    said = [each for each in lf.first_order(behind_window(magnification)).warnings if "do not join" in each]
    if magnification == 1.0:
        assert said == []
    else:
        assert f"{abs(1.0 - magnification) * PITCH_MM:.4g} mm" in said[0]


@pytest.mark.parametrize("magnification", [0.5, 1.0, 2.0])
def test_the_depth_of_field_is_that_of_the_cone_that_makes_one_image(magnification: float) -> None:
    """A point is blurred to a pixel where m ε times the cone is a pixel: of all rods if m = 1, of one rod otherwise."""
    before, _ = distances(magnification, UPRIGHT)
    cone = SINE if magnification == 1.0 else 0.5 * PITCH_MM / math.hypot(before, 1.0 / (N0 * G))
    depth = PIXEL_MM / magnification / (2.0 * cone)
    report = lf.first_order(behind_window(magnification))
    assert [report.near_mm, report.far_mm] == pytest.approx([OBJECT_MM - depth, OBJECT_MM + depth], rel=1e-6)


@pytest.mark.parametrize("magnification", [0.5, 1.0, 2.0])
def test_focus_mm_places_the_plane_that_rods_image_in_the_lens_s_image(magnification: float) -> None:
    before, behind = distances(magnification, UPRIGHT)
    surfaces = [{"thickness_mm": 3.0, "index": 1.5, "radius_mm": 20.0, "semi_diameter_mm": 6.0, "stop": True},
                {"radius_mm": -20.0, "semi_diameter_mm": 6.0}]  # fmt: skip
    sensor = {"pixels": [800, 800], "pixel_mm": PIXEL_MM, "distance_mm": behind}
    camera = {"lens": {"surfaces": surfaces}, "focus_mm": 60.0, "mla": rods(20, UPRIGHT), "sensor": sensor}
    scene = lf.Scene(camera=camera)
    report = lf.first_order(scene)
    assert report.relay_magnification == pytest.approx(magnification, rel=1e-9)
    assert report.object_distance_mm == pytest.approx(60.0, rel=1e-9)
    assert not any("focus_mm" in each for each in report.warnings)
    # From the sensor the same plane is as much farther as the camera is long.
    track = 60.0 + report.image_z_mm + before + UPRIGHT / G + behind
    again = lf.first_order(scene.changed({"camera.focus_mm": track, "camera.focus_from": "sensor"}))
    assert again.object_distance_mm == pytest.approx(60.0, rel=1e-6)
    assert report.object_sampling_mm == pytest.approx(PIXEL_MM / abs(magnification * report.magnification), rel=1e-9)
    assert Upright.of(scene).inverts


def test_rods_with_the_sensor_in_their_focal_plane_image_the_pupil() -> None:
    """m is 0 but for rounding, whose sign must not turn the camera into another kind."""
    focal = math.cos(UPRIGHT) / (N0 * G * math.sin(UPRIGHT))
    for distance in (focal * (1.0 - 1e-12), focal, focal * (1.0 + 1e-12)):
        report = lf.first_order(behind_window(1.0).changed({"camera.sensor.distance_mm": distance}))
        assert report.relay_magnification is None
        assert report.kind == "standard plenoptic"


def test_check_reports_rods_that_image_a_plane_within_the_plate() -> None:
    """Nearer than the focal plane, the sensor has a virtual conjugate: neither a relay nor an image of the pupil."""
    scene = behind_window(1.0).changed({"camera.sensor.distance_mm": 1.0})
    assert any("do not image the pupil onto the sensor" in each for each in lf.first_order(scene).warnings)


@pytest.mark.parametrize("share", [1.0, 1.0 - 1e-13])
def test_check_reports_afocal_rods_with_unknown_figures(share: float) -> None:
    """Rods of half a period, to rounding: −1 times, from a plane as far behind their first face as the sensor is."""
    changes = {"camera.mla.thickness_mm": share * math.pi / G, "camera.sensor.distance_mm": 1.0}
    said = lf.first_order(behind_window(1.0).changed(changes)).warnings
    assert any("a plane 1 mm behind the array's first face" in each and "-1" in each for each in said)


def test_micro_images_of_rods_with_an_intermediate_image_have_a_positive_size() -> None:
    focal = math.cos(UPRIGHT) / (N0 * G * math.sin(UPRIGHT))
    report = lf.first_order(behind_window(1.0).changed({"camera.sensor.distance_mm": focal}))
    assert report.microlens_f_number == pytest.approx(1.0 / (N0 * G * abs(math.sin(UPRIGHT)) * PITCH_MM), rel=1e-6)
    assert report.micro_image_diameter_px is not None
    assert report.micro_image_diameter_px > 0.0


@pytest.mark.parametrize(("magnification", "angle"), CASES)
def test_traced_rays_from_a_point_land_where_its_rod_images_it(magnification: float, angle: float) -> None:
    """Rays near each rod's axis: x_r + m (X − x_r)."""
    scene = behind_window(magnification, angle, count=3)
    before, _ = distances(magnification, angle)
    axes, point = np.array([-PITCH_MM, 0.0, PITCH_MM]), 0.03
    slopes = ((axes - point)[:, None] + np.linspace(-0.05, 0.05, 21)) / before
    directions = np.stack([slopes, np.zeros_like(slopes), np.ones_like(slopes)], axis=-1).reshape(-1, 3)
    start = np.array([point, 0.0, -OBJECT_MM]) + 1e-3 * directions
    paths = lf.trace(lf.build(scene), start, directions, split="transmit")
    rod = paths.source // 21
    for number, axis in enumerate(axes):
        landed = paths.position[(rod == number) & (paths.status == lf.Status.SENSOR), 0]
        # Oblique beams through the outer rods have aberrations.
        share = 0.005 if number == 1 else 0.05
        assert len(landed) == 21 or number != 1
        assert np.abs(landed - axis - magnification * (point - axis)).max(initial=0.0) < share * PITCH_MM
