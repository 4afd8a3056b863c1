"""Image space that is not air: closed forms of one surface, a published eye, a window, an immersed array."""

import math
from typing import Any

import pytest

from lfmesh.errors import SceneError
from lfmesh.scene import Lens, Paraxial, Scene, first_order, loads, solved
from lfmesh.scene.first_order.conjugates import along_shifts
from lfmesh.scene.first_order.meridional import heights_mm
from lfmesh.scene.lens_library import Entry
from tests.cameras import camera_without_array, close_up_camera

OIL, VITREOUS = 1.4, 1.336

GULLSTRAND = [
    {"radius_mm": 7.7, "thickness_mm": 0.5, "index": 1.376, "semi_diameter_mm": 4.0},
    {"radius_mm": 6.8, "thickness_mm": 3.1, "index": 1.336, "semi_diameter_mm": 4.0},
    {"radius_mm": 10.0, "thickness_mm": 0.546, "index": 1.386, "semi_diameter_mm": 2.0, "stop": True},
    {"radius_mm": 7.911, "thickness_mm": 2.419, "index": 1.406, "semi_diameter_mm": 3.0},
    {"radius_mm": -5.76, "thickness_mm": 0.635, "index": 1.386, "semi_diameter_mm": 3.0},
    {"radius_mm": -6.0, "semi_diameter_mm": 3.0},
]
"""Gullstrand's exact eye, relaxed (Helmholtz's Treatise on Physiological Optics, 1924, appendix II to part I)."""


def in_oil(**camera: Any) -> Scene:
    return Scene(camera=close_up_camera() | {"image_medium": {"index": OIL}} | camera)


def trace(scene: Scene, height: float, slope: float) -> tuple[float, float]:
    """Follow a paraxial ray, with plain angles, from the plane of the first vertex to just behind the last one."""
    before = 1.0
    for surface in scene.camera.lens.surfaces:
        after = surface.index or 1.0
        bend = 0.0 if math.isinf(surface.radius_mm) else height * (after - before) / surface.radius_mm
        slope = (before * slope - bend) / after
        height += slope * (surface.thickness_mm or 0.0)
        before = after
    return height, slope


def test_one_surface_images_as_its_equation_says() -> None:
    """n'/s' − n/s = (n' − n)/R: focal lengths R/(n' − 1) and n' R/(n' − 1), magnification s'/(n' s)."""
    one = Paraxial(curvatures=(1.0 / 20.0,), gaps_mm=(), indices=(1.0, OIL), stop=0)
    power = (OIL - 1.0) / 20.0
    assert one.efl_mm == pytest.approx(1.0 / power, rel=1e-14)
    assert one.ffl_mm == pytest.approx(-1.0 / power, rel=1e-14)
    assert one.bfl_mm == pytest.approx(OIL / power, rel=1e-14)
    assert one.rear_principal_mm == pytest.approx(0.0, abs=1e-12)
    image = OIL / (power - 1.0 / 150.0)
    assert one.image_mm(150.0) == pytest.approx(image, rel=1e-13)
    assert one.object_mm(image) == pytest.approx(150.0, rel=1e-13)
    assert one.magnification(150.0) == pytest.approx(-image / (OIL * 150.0), rel=1e-13)
    assert one.magnification_onto(image) == pytest.approx(-image / (OIL * 150.0), rel=1e-13)
    # The stop is the surface itself: the cone 2 u' at the image is its diameter over the image's distance.
    assert one.chief_height_mm(image) == pytest.approx(image / OIL, rel=1e-13)


def test_gullstrands_eye_has_its_published_cardinal_points() -> None:
    """58.64 dioptres; from the cornea, principal points 1.348 and 1.602 mm, focal points −15.707 and 24.387 mm.

    Gullstrand rounded on the way: his last digits are off by up to 3. The pupils are those of D. A. Atchison, G. Smith,
    Optics of the Human Eye (2000), appendix 3.
    """
    sensor = {"pixels": [6, 6], "pixel_mm": 0.1}
    eye = Scene(
        camera={
            "lens": {"surfaces": GULLSTRAND}, "sensor": sensor, "image_medium": {"index": VITREOUS},
            "focus_mm": math.inf,
        }
    )  # fmt: skip
    report = first_order(eye)
    assert 1000.0 / report.efl_mm == pytest.approx(58.64, abs=0.005)
    assert report.front_principal_plane_z_mm == pytest.approx(1.348, abs=3e-3)
    assert report.rear_principal_plane_z_mm == pytest.approx(1.602, abs=3e-3)
    assert report.ffl_mm == pytest.approx(-15.707, abs=3e-3)
    assert report.image_z_mm == pytest.approx(24.387, abs=3e-3)
    assert report.entrance_pupil_z_mm == pytest.approx(3.047, abs=5e-4)
    assert report.exit_pupil_z_mm == pytest.approx(3.665, abs=5e-4)
    # The focal lengths on both sides reach from the principal to the focal points.
    assert report.efl_mm == pytest.approx(report.front_principal_plane_z_mm - report.ffl_mm, rel=1e-12)
    behind = report.image_z_mm - report.rear_principal_plane_z_mm
    assert VITREOUS * report.efl_mm == pytest.approx(behind, rel=1e-12)
    assert f"index {VITREOUS:g}: {behind:.6g} mm is the focal length on its side" in str(report)


def test_an_image_behind_a_flat_window_lies_deeper_by_the_index() -> None:
    """A window before an oiled sensor: reduced distances t/n on the way add up to those in air."""
    gap, window = 10.0, 4.0
    bare = camera_without_array(focus_mm=150.0)
    one, two = bare["lens"]["surfaces"]
    port = [{"thickness_mm": window, "index": 1.5, "semi_diameter_mm": 9.0}, {"semi_diameter_mm": 9.0}]
    oiled = camera_without_array(focus_mm=150.0) | {"image_medium": {"index": OIL}}
    oiled["lens"] = {"surfaces": [one, two | {"thickness_mm": gap}, *port]}
    dry, wet = first_order(Scene(camera=bare)), first_order(Scene(camera=oiled))
    assert (dry.image_index, wet.image_index) == (1.0, OIL)
    reduced = dry.image_z_mm - 3.0 - gap - window / 1.5
    assert wet.image_z_mm - 3.0 - gap - window == pytest.approx(OIL * reduced, rel=1e-12)
    for each in ("efl_mm", "magnification", "working_f_number", "object_distance_mm", "airy_disk_mm", "near_mm"):
        assert getattr(wet, each) == pytest.approx(getattr(dry, each), rel=1e-12), each
    # The pupil lies on the lens's first surface: behind it, distances in air become those in oil.
    apparent = dry.exit_pupil_z_mm - 3.0 - gap - window / 1.5
    assert wet.exit_pupil_z_mm - 3.0 - gap - window == pytest.approx(OIL * apparent, rel=1e-12)
    assert wet.exit_pupil_diameter_mm == pytest.approx(dry.exit_pupil_diameter_mm, rel=1e-12)


def test_pupils_and_focus_are_those_of_traced_paraxial_rays() -> None:
    scene = solved(in_oil())
    report, mla = first_order(scene), scene.camera.mla
    assert mla is not None
    assert mla.distance_mm is not None
    for slope in (0.002, 0.01):
        height, angle = trace(scene, 60.0 * slope, slope)
        assert height + mla.distance_mm * angle == pytest.approx(0.0, abs=1e-13)
    height, angle = trace(scene, -0.01 * report.entrance_pupil_z_mm, 0.01)
    last = scene.camera.lens.vertices_mm[-1]
    assert height + angle * (report.exit_pupil_z_mm - last) == pytest.approx(0.0, abs=1e-13)
    # The marginal ray of the plane in focus has the slope u' behind the lens, and the f-number 1 / (2 n' u').
    rim = trace(scene, 60.0, 1.0)[0] / 4.0
    _, angle = trace(scene, 60.0 / rim, 1.0 / rim)
    assert report.working_f_number == pytest.approx(abs(0.5 / (OIL * angle)), rel=1e-12)


def test_the_f_number_of_the_lens_is_that_of_the_cone_from_a_far_object() -> None:
    given = in_oil(focus_mm=math.inf).changed({"camera.lens.f_number": 8.0})
    scene, report = solved(given), first_order(given)
    _, angle = trace(scene, 0.5 * report.entrance_pupil_diameter_mm, 0.0)
    assert 0.5 / (OIL * abs(angle)) == pytest.approx(8.0, rel=1e-12)
    assert report.working_f_number == pytest.approx(8.0, rel=1e-12)


def test_the_plane_that_is_named_from_the_sensor_is_the_one_in_focus() -> None:
    """x x' = n n' f² (Newton), through the distance from object to sensor."""
    media = {"object_medium": {"index": 1.333}, "image_medium": {"index": OIL}}
    scene = Scene(camera=camera_without_array(focus_mm=700.0) | {"focus_from": "sensor"} | media)
    report = first_order(scene)
    assert report.object_distance_mm + report.image_z_mm == pytest.approx(700.0, rel=1e-12)
    beyond = report.object_distance_mm + report.ffl_mm, report.image_z_mm - 3.0 - report.bfl_mm
    assert beyond[0] * beyond[1] == pytest.approx(1.333 * OIL * report.efl_mm**2, rel=1e-9)


def test_shifts_of_an_immersed_plane_have_the_conjugates_of_their_images() -> None:
    """A shift t between views u apart on the exit pupil, D before the plane, is that of an image t D/(D − t) behind."""
    scene = solved(in_oil())
    lens = Paraxial.of(scene.camera.lens, 587.6)
    plane = scene.camera.mla.distance_mm if scene.camera.mla is not None else None
    assert plane is not None
    z, _ = lens.exit_pupil(1.0)
    away = plane - (z - lens.length_mm)
    shifts = along_shifts(lens, plane)
    for t in (-1.0, 0.3, 2.0):
        assert shifts.object_mm(t) == pytest.approx(lens.object_mm(plane + t * away / (away - t)), rel=1e-11)


@pytest.mark.parametrize("side", ["lens", "sensor"])
def test_immersed_lenslets_focus_on_the_sensor(side: str) -> None:
    """Paraxial rays with plain angles, parallel before a plano-convex plate in oil, meet on the sensor."""
    scene = solved(in_oil().changed({"camera.mla.curved_side": side}))
    mla, sensor = scene.camera.mla, scene.camera.sensor
    assert mla is not None
    assert mla.radius_mm is not None
    assert sensor.distance_mm is not None
    power = (1.5 - OIL) / mla.radius_mm[0]
    first, second = (power, 0.0) if side == "lens" else (0.0, power)
    slope = -first / 1.5
    height = 1.0 + mla.thickness_mm * slope
    slope = (1.5 * slope - second * height) / OIL
    assert height + sensor.distance_mm * slope == pytest.approx(0.0, abs=1e-12)
    # The key is a focal length in air.
    assert mla.radius_mm[0] == pytest.approx(2.6 * 0.5, rel=1e-12)


def test_an_immersed_cover_moves_the_image_by_what_its_index_differs() -> None:
    cover = {"thickness_mm": 0.5, "gap_mm": 0.1, "index": 1.6}
    given = Scene(camera=camera_without_array() | {"image_medium": {"index": OIL}})
    bare, covered = first_order(given), first_order(given.changed({"camera.sensor.cover": cover}))
    assert covered.cover_shift_mm == pytest.approx(0.5 * (1.0 - OIL / 1.6), rel=1e-12)
    assert covered.image_z_mm == pytest.approx(bare.image_z_mm, rel=1e-12)
    matched = first_order(given.changed({"camera.sensor.cover": cover | {"index": OIL}}))
    assert matched.cover_shift_mm == 0.0
    thinner = first_order(given.changed({"camera.sensor.cover": cover | {"index": 1.2}}))
    assert thinner.cover_shift_mm == pytest.approx(0.5 * (1.0 - OIL / 1.2), rel=1e-12)
    assert "moves the image 83.33 µm towards the lens" in str(thinner)
    assert "moves the image 62.5 µm away from the lens" in str(covered)


@pytest.mark.parametrize(("curved_side", "back"), [("lens", None), ("sensor", None), ("lens", {"radius_mm": 4.0})])
def test_only_ratios_of_indices_count(curved_side: str, back: dict[str, float] | None) -> None:
    """With every index times n, lengths, directions and micro-images stay; the power is n times as large."""
    n = 1.25
    cover = {"thickness_mm": 0.5, "gap_mm": 0.1, "index": 1.6}
    shape = {"focal_length_mm": None, "radius_mm": 1.3, "curved_side": curved_side, "back": back}
    base = close_up_camera()
    base["mla"] |= shape
    base["sensor"] |= {"cover": cover, "distance_mm": 2.4}
    air = Scene(camera=base, transport={"wavelengths_nm": [500.0]})
    times = {
        "camera.object_medium": {"index": n}, "camera.image_medium": {"index": n}, "camera.mla.index": 1.5 * n,
        "camera.lens.surfaces[0].index": 1.5 * n, "camera.sensor.cover.index": 1.6 * n,
        "transport.wavelengths_nm": [500.0 * n],
    }  # fmt: skip
    dry, wet = first_order(air).as_dict(), first_order(air.changed(times)).as_dict()
    scaled = {
        "wavelength_nm": n, "airy_wavelength_nm": n, "efl_mm": 1.0 / n, "working_f_number": 1.0 / n,
        "microlens_f_number": 1.0 / n, "object_index": n, "image_index": n,
    }  # fmt: skip
    for name, value in dry.items():
        if isinstance(value, float):
            assert wet[name] == pytest.approx(scaled.get(name, 1.0) * value, rel=1e-9), name
    assert sum(wet["refocused_mm"], ()) == pytest.approx(sum(dry["refocused_mm"], ()), rel=1e-9)
    for name, value in dry["field"].items():
        assert wet["field"][name] == pytest.approx(value, rel=1e-9), name
    for one, other in zip(dry["lenslet_sections"], wet["lenslet_sections"], strict=True):
        for name, value in one.items():
            factor = 1.0 / n if name == "f_number" else 1.0
            assert other[name] == (value if isinstance(value, str) else pytest.approx(factor * value, rel=1e-9)), name
    assert len(dry["lenslet_sections"]) == (0 if back is None else 1)
    for name, value in (dry["kick_error"] or {}).items():
        assert wet["kick_error"][name] == (value if value is None else pytest.approx(value, rel=1e-6)), name


def test_an_index_of_one_is_air() -> None:
    plain = Scene(camera=close_up_camera())
    assert first_order(in_oil(image_medium={"index": 1.0})) == first_order(plain)
    assert solved(in_oil(image_medium={"index": 1.0})) == solved(plain)


def test_a_library_lens_counts_its_elements_without_the_medium_behind_them() -> None:
    """Gullstrand's eye: the cornea, and three shells of the lens with the aqueous humour before them."""
    eye = Lens(surfaces=[*GULLSTRAND[:-1], GULLSTRAND[-1] | {"index": VITREOUS}])
    assert ", 5 elements;" in str(Entry("eye", eye, 17.05, 2.0))


def test_the_medium_behind_the_last_surface_gives_way_to_the_scenes() -> None:
    """Stops behind the last interface stand in it too."""
    own = Scene(camera=close_up_camera()).changed({f"camera.lens.surfaces[{i}].index": VITREOUS for i in (1, 2)})
    assert first_order(own).image_index == VITREOUS
    assert first_order(own.changed({"camera.image_medium": {"index": OIL}})) == first_order(in_oil())
    assert first_order(own.changed({"camera.image_medium": {"index": 1.0}})).image_index == 1.0


@pytest.mark.parametrize(
    "matter", [{"index": OIL}, {"glass": "main/H2O/Daimon-20.0C"}, {"glass": {"nd": 1.333, "vd": 55.7}}]
)
def test_a_scene_file_keeps_its_medium(matter: dict[str, object]) -> None:
    scene = in_oil(image_medium=matter)
    assert loads(scene.dump_toml()) == scene
    assert "image medium" in str(first_order(scene))
    assert solved(solved(scene)) == solved(scene)
    assert loads(solved(scene).dump_toml()) == solved(scene)


def test_water_has_its_index_beside_the_air_that_is_named() -> None:
    plain = in_oil(image_medium={"glass": "main/H2O/Daimon-20.0C"})
    in_vacuum = plain.changed({"camera.air": {"pressure_kpa": 0.0}})
    ratio = first_order(in_vacuum).image_index / first_order(plain).image_index
    assert ratio == pytest.approx(1.000272, abs=1e-6)


def test_the_real_ray_behind_the_lens_is_bent_as_snell_says() -> None:
    lens = solved(in_oil()).camera.lens
    first, second, stop = heights_mm(lens, 587.6, math.inf, 2.0)
    inside = math.asin(2.0 / 20.0) - math.asin(2.0 / 20.0 / 1.5)
    sag, back = 20.0 - math.sqrt(20.0**2 - first**2), 20.0 - math.sqrt(20.0**2 - second**2)
    assert second == pytest.approx(first - (3.0 - back - sag) * math.tan(inside), rel=1e-12)
    normal = math.asin(second / 20.0)
    behind = math.asin(1.5 / OIL * math.sin(-inside - normal)) + normal
    assert stop == pytest.approx(second + (1.0 + back) * math.tan(behind), rel=1e-12)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (1.333, "camera.image_medium = 1.333: must be a table"),
        ({}, "camera.image_medium.index: missing: give the index, or glass"),
        ({"index": 1.3, "glass": "SCHOTT/N-BK7"}, "camera.image_medium.glass"),
        ({"glass": "main/H2O/Nobody"}, 'camera.image_medium.glass = "main/H2O/Nobody": not in the catalogue'),
        ({"index": 1.5}, "camera.mla.index = 1.5: has the index 1.5 beside the medium behind the lens"),
    ],
)
def test_faults_are_one_line_that_names_the_key(given: object, message: str) -> None:
    with pytest.raises(SceneError) as refused:
        in_oil(image_medium=given)
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def test_lenslets_converge_at_every_wavelength() -> None:
    """A liquid that disperses more than the array's glass has its index in the blue."""
    cinnamon = {"glass": {"nd": 1.49, "vd": 20.0}}
    red = in_oil(image_medium=cinnamon).changed({"transport.wavelengths_nm": [650.0]})
    assert first_order(red).image_index < 1.49
    with pytest.raises(
        SceneError, match=r"camera\.mla\.index = 1\.5: .* behind the lens at 450 nm; lenslets need an index above"
    ):
        red.changed({"transport.wavelengths_nm": [650.0, 450.0]})


def test_indices_whose_ratio_is_one_are_refused() -> None:
    """Two numbers below 2 that differ in the last digit have the ratio 1 + 1.1e-16, which is 1 in float64."""
    plate = math.nextafter(2.0, 0.0)
    with pytest.raises(SceneError, match="lenslets need an index above 2"):
        in_oil(image_medium={"index": math.nextafter(plate, 0.0)}).changed({"camera.mla.index": plate})


def test_a_thin_lens_does_not_look_into_oil() -> None:
    thin = [{"paraxial": True, "focal_length_mm": 20.0, "semi_diameter_mm": 4.0, "stop": True}]
    with pytest.raises(SceneError, match=r"camera\.image_medium: omit it: .*a thin lens stands in air"):
        in_oil(lens={"surfaces": thin})
