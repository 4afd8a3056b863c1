"""A lens that looks into water: closed forms of one surface and of a window, and paraxial rays traced one by one."""

import math
from pathlib import Path

import pytest

import lfmesh as lf
from lfmesh.errors import SceneError
from lfmesh.scene import Paraxial, Scene, first_order, loads, solved
from lfmesh.scene.first_order.meridional import heights_mm
from tests.cameras import camera_without_array, close_up_camera

WATER = 1.333


def in_water(**camera: object) -> Scene:
    return Scene(camera=close_up_camera() | {"object_medium": {"index": WATER}} | camera)


def trace(scene: Scene, height: float, slope: float) -> tuple[float, float]:
    """Follow a paraxial ray, with plain angles, from the plane of the first vertex to just behind the last one."""
    before = WATER
    for surface in scene.camera.lens.surfaces:
        after = surface.index or 1.0
        bend = 0.0 if math.isinf(surface.radius_mm) else height * (after - before) / surface.radius_mm
        slope = (before * slope - bend) / after
        height += slope * (surface.thickness_mm or 0.0)
        before = after
    return height, slope


def test_one_surface_images_as_its_equation_says() -> None:
    """n'/s' − n/s = (n' − n)/R: focal lengths n R/(n' − n) and n' R/(n' − n), magnification n s'/(n' s)."""
    one = Paraxial(curvatures=(-1.0 / 20.0,), gaps_mm=(), indices=(WATER, 1.0), stop=0)
    power = (1.0 - WATER) / -20.0
    assert one.efl_mm == pytest.approx(1.0 / power, rel=1e-14)
    assert one.ffl_mm == pytest.approx(-WATER / power, rel=1e-14)
    assert one.front_principal_mm == pytest.approx(0.0, abs=1e-12)
    image = 1.0 / (power - WATER / 150.0)
    assert one.image_mm(150.0) == pytest.approx(image, rel=1e-13)
    assert one.object_mm(image) == pytest.approx(150.0, rel=1e-13)
    assert one.magnification(150.0) == pytest.approx(-WATER * image / 150.0, rel=1e-13)


def test_a_flat_port_brings_objects_nearer_by_the_index() -> None:
    """Behind a plane window a camera in air focuses on 1/n of the distance in water, the window's own reduced too."""
    port = {"thickness_mm": 4.0, "index": 1.5, "semi_diameter_mm": 9.0}
    gap = {"thickness_mm": 10.0, "semi_diameter_mm": 9.0}
    lens = camera_without_array()["lens"]["surfaces"]
    bare = Scene(camera=camera_without_array(focus_mm=150.0))
    apparent = 150.0 - 4.0 / 1.5 - 10.0
    behind_port = camera_without_array(focus_mm=WATER * apparent)
    behind_port["lens"] = {"surfaces": [port, gap, *lens]}
    behind_port["object_medium"] = {"index": WATER}
    dry, wet = first_order(bare), first_order(Scene(camera=behind_port))
    assert wet.object_index == WATER
    assert wet.image_z_mm - 14.0 == pytest.approx(dry.image_z_mm, rel=1e-12)
    assert wet.magnification == pytest.approx(dry.magnification, rel=1e-12)
    assert wet.efl_mm == pytest.approx(dry.efl_mm, rel=1e-12)
    # The pupil lies on the lens's first surface.
    assert wet.entrance_pupil_z_mm == pytest.approx(WATER * (4.0 / 1.5 + 10.0), rel=1e-12)
    assert wet.entrance_pupil_diameter_mm == pytest.approx(dry.entrance_pupil_diameter_mm, rel=1e-12)


def test_pupils_and_focus_are_those_of_traced_paraxial_rays() -> None:
    scene = solved(in_water())
    report = first_order(scene)
    assert scene.camera.mla is not None
    assert scene.camera.mla.distance_mm is not None
    for slope in (0.002, 0.01):
        height, angle = trace(scene, 60.0 * slope, slope)
        assert height + scene.camera.mla.distance_mm * angle == pytest.approx(0.0, abs=1e-13)
    # A ray towards the middle of the entrance pupil leaves from the middle of the exit pupil.
    height, angle = trace(scene, -0.01 * report.entrance_pupil_z_mm, 0.01)
    last = scene.camera.lens.vertices_mm[-1]
    assert height + angle * (report.exit_pupil_z_mm - last) == pytest.approx(0.0, abs=1e-13)
    # One towards its edge, along the axis, passes the edge of the stop, which is the last surface.
    height, angle = trace(scene, 0.5 * report.entrance_pupil_diameter_mm, 0.0)
    assert height == pytest.approx(4.0, rel=1e-12)
    assert report.efl_mm == pytest.approx(-0.5 * report.entrance_pupil_diameter_mm / angle, rel=1e-12)


def test_the_f_number_is_that_of_the_cone_behind_the_lens() -> None:
    """Of a far object it is the image-side focal length over the entrance pupil, W N² the same as in air."""
    given = in_water(focus_mm=math.inf)
    report = first_order(given.changed({"camera.lens.f_number": 8.0}))
    _, angle = trace(given, 0.5 * report.entrance_pupil_diameter_mm, 0.0)
    assert -0.5 / angle == pytest.approx(8.0, rel=1e-12)
    assert report.entrance_pupil_diameter_mm == pytest.approx(report.efl_mm / 8.0, rel=1e-12)
    # The marginal ray of `working_f_number` goes to the lenslets, where the image of a far object is.
    assert report.working_f_number == pytest.approx(8.0, rel=1e-12)


def test_the_plane_that_is_named_from_the_sensor_is_the_one_in_focus() -> None:
    """x x' = n f² (Newton), through the distance from object to sensor."""
    given = camera_without_array(focus_mm=220.0) | {"focus_from": "sensor", "object_medium": {"index": WATER}}
    scene = Scene(camera=given)
    report = first_order(scene)
    assert report.object_distance_mm + report.image_z_mm == pytest.approx(220.0, rel=1e-12)
    assert first_order(scene.changed({"camera.focus_mm": 500.0})).object_distance_mm > report.object_distance_mm
    with pytest.raises(SceneError, match="no plane this far before the sensor is imaged onto it; give ") as refused:
        first_order(scene.changed({"camera.focus_mm": 150.0}))
    least = float(str(refused.value).split("give ")[1].split()[0])
    assert abs(first_order(scene.changed({"camera.focus_mm": least})).magnification) == pytest.approx(
        math.sqrt(WATER), rel=1e-2
    )


def test_an_index_of_one_is_air() -> None:
    plain, named = Scene(camera=close_up_camera()), in_water(object_medium={"index": 1.0})
    assert first_order(named) == first_order(plain)


def test_the_medium_of_a_lens_file_gives_way_to_the_scenes(tmp_path: Path) -> None:
    lens = Scene(camera=close_up_camera()).camera.lens
    path = tmp_path / "lens.toml"
    text = lens.model_copy(update={"object_medium": lf.Matter(index=1.4)})
    whole = Scene(camera=close_up_camera() | {"lens": text.model_dump()}).dump_toml()
    table = whole.split("[camera.lens]")[1].split("[camera.mla]")[0].replace("camera.lens.", "")
    path.write_text(table)
    own = Scene(camera=close_up_camera() | {"lens": {"file": str(path)}})
    assert first_order(own).object_index == 1.4
    assert first_order(own.changed({"camera.object_medium": {"index": WATER}})).object_index == WATER
    assert first_order(own.changed({"camera.object_medium": {"index": 1.0}})).object_index == 1.0


@pytest.mark.parametrize(
    "matter", [{"index": WATER}, {"glass": "main/H2O/Daimon-20.0C"}, {"glass": {"nd": 1.333, "vd": 55.7}}]
)
def test_a_scene_file_keeps_its_medium(matter: dict[str, object]) -> None:
    scene = in_water(object_medium=matter)
    again = loads(scene.dump_toml())
    assert again == scene
    assert first_order(again).object_index == pytest.approx(WATER, abs=1e-3)
    assert "object medium" in str(first_order(again))
    assert solved(solved(scene)) == solved(scene)
    assert loads(solved(scene).dump_toml()) == solved(scene)


def test_water_has_its_index_beside_the_air_that_is_named() -> None:
    plain = in_water(object_medium={"glass": "main/H2O/Daimon-20.0C"})
    in_vacuum = plain.changed({"camera.air": {"pressure_kpa": 0.0}})
    ratio = first_order(in_vacuum).object_index / first_order(plain).object_index
    assert ratio == pytest.approx(1.000272, abs=1e-6)


def test_the_real_ray_to_the_edge_of_the_stop_is_bent_as_snell_says() -> None:
    lens = solved(in_water()).camera.lens
    heights = heights_mm(lens, 587.6, math.inf, 2.0)
    sine = 2.0 / 20.0
    angle = math.asin(sine) - math.asin(sine * WATER / 1.5)
    sag = 20.0 - math.sqrt(20.0**2 - 2.0**2)
    # In the glass, a straight line to the second surface.
    y, z = 2.0, sag
    at = heights[1]
    back = 3.0 - (20.0 - math.sqrt(20.0**2 - at**2))
    assert at == pytest.approx(y - (back - z) * math.tan(angle), rel=1e-12)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (1.333, "camera.object_medium = 1.333: must be a table"),
        ({}, "camera.object_medium.index: missing: give the index, or glass"),
        ({"index": 0.9}, "camera.object_medium.index = 0.9: must be 1 or more"),
        ({"index": 1.3, "glass": "SCHOTT/N-BK7"}, "camera.object_medium.glass"),
        (
            {"glass": "main/H2O/Nobody"},
            'camera.object_medium.glass = "main/H2O/Nobody": not in the catalogue; close to it are main/H2O/',
        ),
        ({"glass": "WATER"}, "close to it are main/H2O/Daimon-20.0C (nd 1.33340"),
        ({"index": 1.3, "absorption_per_mm": 0.1}, "camera.object_medium.absorption_per_mm: unknown key"),
        (
            {"glass": {"wavelengths_nm": [400.0, 450.0, 500.0], "values": [1.34, 1.338, 1.336]}},
            "camera.object_medium.glass",
        ),
    ],
)
def test_faults_are_one_line_that_names_the_key(given: object, message: str) -> None:
    with pytest.raises(SceneError) as refused:
        in_water(object_medium=given)
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_thin_lens_does_not_look_into_water() -> None:
    thin = [{"paraxial": True, "focal_length_mm": 20.0, "semi_diameter_mm": 4.0, "stop": True}]
    with pytest.raises(SceneError, match=r"camera\.object_medium: omit it: .*a thin lens stands in air"):
        in_water(lens={"surfaces": thin})
