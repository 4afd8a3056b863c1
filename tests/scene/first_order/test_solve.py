"""Solving: what is omitted follows from first-order optics, checked by paraxial rays traced one by one."""

import math
import re

import pytest

from lfmesh.errors import SceneError
from lfmesh.scene import Pose, Scene, first_order, loads, solved


def trace(scene: Scene, height: float, angle: float) -> tuple[float, float]:
    """Follow a paraxial ray with a given height at the first vertex to just behind the last one."""
    before = 1.0
    for surface in scene.camera.lens.surfaces:
        after = surface.index or 1.0
        bend = 0.0 if math.isinf(surface.radius_mm) else height * (after - before) / surface.radius_mm
        angle = (before * angle - bend) / after
        height += angle * (surface.thickness_mm or 0.0)
        before = after
    return height, angle


def apex_height(scene: Scene, height: float, angle: float) -> float:
    """Height at which a ray, given at the first vertex, meets the plane of the lenslets' apexes."""
    mla = scene.camera.mla
    assert mla is not None
    assert mla.distance_mm is not None
    height, angle = trace(scene, height, angle)
    height += angle * mla.distance_mm
    if mla.curved_side == "sensor":
        height += angle / mla.index * mla.thickness_mm
    return height


@pytest.mark.parametrize("side", ["lens", "sensor"])
def test_the_object_plane_is_imaged_on_the_apexes(scene: Scene, side: str) -> None:
    ready = solved(scene.changed({"camera.mla.curved_side": side}))
    steep, flat = apex_height(ready, 400.0 * 0.01, 0.01), apex_height(ready, 400.0 * 0.002, 0.002)
    assert steep == pytest.approx(0.0, abs=1e-12)
    assert flat == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("side", ["lens", "sensor"])
def test_parallel_light_meets_on_the_sensor_behind_a_lenslet(scene: Scene, side: str) -> None:
    ready = solved(scene.changed({"camera.mla.curved_side": side, "camera.mla.focal_length_mm": (0.7, 0.9)}))
    mla, sensor = ready.camera.mla, ready.camera.sensor
    assert mla is not None
    assert sensor.distance_mm is not None
    n, t, power = 1.5, mla.thickness_mm, 0.5 / mla.radius_mm[0]
    height = 0.01
    if side == "lens":
        height += -height * power / n * t
        angle = -0.01 * power
    else:
        angle = -height * power
    assert height + angle * sensor.distance_mm == pytest.approx(0.0, abs=1e-15)


def test_a_conventional_camera_focuses_on_its_sensor(scene: Scene) -> None:
    ready = solved(scene.changed({"camera.mla": None}))
    height, angle = trace(ready, 4.0, 0.01)
    assert height + angle * ready.camera.sensor.distance_mm == pytest.approx(0.0, abs=1e-12)


def test_radius_follows_from_focal_length_at_the_primary_wavelength(scene: Scene) -> None:
    ready = solved(scene.changed({"camera.mla.focal_length_mm": (0.7, -0.9)}))
    assert ready.camera.mla.radius_mm == pytest.approx((0.35, -0.45))
    assert ready.camera.mla.focal_length_mm is None

    glass = scene.changed(
        {
            "camera.mla.index": None,
            "camera.mla.glass": "N-BK7",
            "transport.wavelengths_nm": (700.0, 587.5618, 450.0),
        }
    )
    assert solved(glass).camera.mla.radius_mm[0] == pytest.approx(0.7 * 0.51680, rel=1e-5)


def test_f_number_sets_the_entrance_pupil(scene: Scene) -> None:
    """The collimated ray at half the pupil's height meets the edge of a stop that lies behind the lens."""
    surfaces = scene.camera.lens.surfaces
    behind = (
        surfaces[1],
        surfaces[2].model_copy(update={"thickness_mm": 5.0}),
        surfaces[0].model_copy(update={"thickness_mm": None, "semi_diameter_mm": None}),
    )
    ready = solved(scene.changed({"camera.lens": {"surfaces": behind, "f_number": 8.0}}))
    _, angle = trace(ready, 1.0, 0.0)
    pupil = -1.0 / angle / 8.0
    edge, _ = trace(ready, pupil / 2, 0.0)
    assert ready.camera.lens.surfaces[2].semi_diameter_mm == pytest.approx(edge, rel=1e-12)
    assert ready.camera.lens.f_number is None


def test_epd_is_the_diameter_of_the_entrance_pupil(scene: Scene) -> None:
    """Of a stop behind the lens: the paraxial ray along the axis at half the diameter meets the stop's edge."""
    surfaces = scene.camera.lens.surfaces
    behind = (
        surfaces[1],
        surfaces[2].model_copy(update={"thickness_mm": 5.0}),
        surfaces[0].model_copy(update={"thickness_mm": None, "semi_diameter_mm": None}),
    )
    ready = solved(scene.changed({"camera.lens": {"surfaces": behind, "epd_mm": 7.0}}))
    edge, _ = trace(ready, 3.5, 0.0)
    assert ready.camera.lens.surfaces[2].semi_diameter_mm == pytest.approx(edge, rel=1e-12)
    assert ready.camera.lens.epd_mm is None
    assert first_order(ready).entrance_pupil_diameter_mm == pytest.approx(7.0, rel=1e-12)


@pytest.mark.parametrize(("first", "second"), [("f_number", "epd_mm"), ("stop_semi_diameter_mm", "epd_mm")])
def test_the_stop_has_one_size(scene: Scene, first: str, second: str) -> None:
    with pytest.raises(SceneError, match=f"{second} = 4.0: {first} = 3 is given too"):
        scene.changed({f"camera.lens.{first}": 3.0, f"camera.lens.{second}": 4.0})


@pytest.mark.parametrize("side", ["lens", "sensor"])
def test_focus_at_infinity_gathers_parallel_light_on_the_apexes(scene: Scene, side: str) -> None:
    ready = solved(scene.changed({"camera.mla.curved_side": side, "camera.focus_mm": math.inf}))
    assert apex_height(ready, 3.0, 0.0) == pytest.approx(0.0, abs=1e-12)
    facts = first_order(ready)
    assert facts.object_distance_mm > 1e9
    assert not any("focus_mm" in warning for warning in facts.warnings)
    assert loads(ready.dump_toml()).camera.focus_mm == math.inf


@pytest.mark.parametrize("side", ["lens", "sensor", None])
def test_focus_from_the_sensor_is_the_distance_of_object_and_sensor(scene: Scene, side: str | None) -> None:
    changes: dict[str, object] = {"camera.mla": None} if side is None else {"camera.mla.curved_side": side}
    ready = solved(scene.changed(changes | {"camera.focus_mm": 400.0, "camera.focus_from": "sensor"}))
    mla = ready.camera.mla
    behind = mla.distance_mm + mla.thickness_mm if mla is not None else 0.0
    sensor_z = ready.camera.lens.vertices_mm[-1] + behind + ready.camera.sensor.distance_mm
    # A ray from the point of the axis that far before the sensor comes to the axis again where the lens focuses.
    start = (400.0 - sensor_z) * 0.01
    if mla is not None:
        assert apex_height(ready, start, 0.01) == pytest.approx(0.0, abs=1e-12)
    else:
        height, angle = trace(ready, start, 0.01)
        assert height + angle * ready.camera.sensor.distance_mm == pytest.approx(0.0, abs=1e-12)
    facts = first_order(ready)
    assert abs(facts.magnification) < 1.0
    assert not any("focus_mm" in warning for warning in facts.warnings)


def test_a_focus_nearer_to_the_sensor_than_four_focal_lengths_is_refused_with_the_nearest(scene: Scene) -> None:
    near = scene.changed({"camera.focus_mm": 200.0, "camera.focus_from": "sensor"})
    with pytest.raises(SceneError, match=r"focus_mm = 200: no plane .* give ([0-9.]+) or more") as refused:
        solved(near)
    nearest = float(re.search(r"give ([0-9.]+) or more", str(refused.value))[1])
    facts = first_order(near.changed({"camera.focus_mm": nearest}))
    # There, the image is as large as the object.
    assert facts.magnification == pytest.approx(-1.0, rel=5e-3)


def test_stop_size_overrides_the_prescription(scene: Scene) -> None:
    lens = solved(scene.changed({"camera.lens.stop_semi_diameter_mm": 2.5})).camera.lens
    assert lens.surfaces[0].semi_diameter_mm == 2.5
    assert lens.stop_semi_diameter_mm is None


@pytest.mark.parametrize(("front", "rear", "stop"), [(6.0, 9.0, 0), (9.0, 6.0, 1)])
def test_without_a_stop_the_surface_that_limits_the_axial_beam_is_it(
    scene: Scene, front: float, rear: float, stop: int
) -> None:
    surfaces = scene.camera.lens.surfaces[1:]
    unmarked = (
        surfaces[0].model_copy(update={"semi_diameter_mm": front}),
        surfaces[1].model_copy(update={"semi_diameter_mm": rear}),
    )
    lens = solved(scene.changed({"camera.lens.surfaces": unmarked})).camera.lens
    assert [surface.stop for surface in lens.surfaces] == [number == stop for number in range(2)]


def test_a_refracting_stop_keeps_its_curvature(scene: Scene) -> None:
    surfaces = tuple(s.model_copy(update={"stop": i == 1}) for i, s in enumerate(scene.camera.lens.surfaces))
    lens = solved(
        scene.changed({"camera.lens.surfaces": surfaces, "camera.lens.stop_semi_diameter_mm": 3.0})
    ).camera.lens
    assert lens.surfaces[1].semi_diameter_mm == 3.0
    assert lens.surfaces[1].radius_mm == 60.0
    assert not lens.is_pure_stop(1)
    assert solved(scene).camera.lens.is_pure_stop(0)


def test_solving_twice_changes_nothing(scene: Scene) -> None:
    once = solved(scene.changed({"camera.lens.f_number": 6.0, "camera.mla.pose": Pose(tilt_deg=(1.0, 0.0, 0.0))}))
    assert solved(once) is once


def test_given_distances_stay(scene: Scene) -> None:
    ready = solved(scene.changed({"camera.mla.distance_mm": 70.0, "camera.sensor.distance_mm": 0.45}))
    assert ready.camera.mla.distance_mm == 70.0
    assert ready.camera.sensor.distance_mm == 0.45


def without_apertures(scene: Scene) -> Scene:
    """The camera with its stop 3 mm before the lens and no other clear aperture."""
    surfaces = [s.model_dump() for s in scene.camera.lens.surfaces]
    surfaces[0]["thickness_mm"] = 3.0
    for s in surfaces[1:]:
        s["semi_diameter_mm"] = None
    return scene.changed({"camera.lens.surfaces": surfaces})


def test_omitted_apertures_pass_the_beam_of_the_corner_of_the_picture(scene: Scene) -> None:
    """The farthest ray from the corner's conjugate through the edge of the stop, traced by paraxial steps."""
    ready = solved(without_apertures(scene))
    facts = first_order(ready)
    corner = 0.5 * math.hypot(*facts.field_of_view_mm)
    # From the far side of the field over the far edge of the stop, 400 mm behind it: to the front and the back.
    slope = (6.0 + corner) / 400.0
    front = 6.0 + 3.0 * slope
    inside = (slope - front * 0.5 / 60.0) / 1.5
    back = front + 4.0 * inside
    _, first, second = ready.camera.lens.surfaces
    assert first.semi_diameter_mm == pytest.approx(1.05 * front, rel=1e-9)
    assert second.semi_diameter_mm == pytest.approx(1.05 * back, rel=1e-9)


def test_omitted_apertures_end_where_surfaces_do_or_meet(scene: Scene) -> None:
    open_ = without_apertures(scene)
    thin = solved(open_.changed({"camera.lens.surfaces[1].thickness_mm": 0.5})).camera.lens
    # Two spheres of radius 60 that are 0.5 mm apart at the axis meet at a height of √(2 · 60 · 0.25).
    assert 0.9 * 30**0.5 < thin.surfaces[1].semi_diameter_mm < 30**0.5
    strong = {"camera.lens.surfaces[1].radius_mm": 5.5, "camera.lens.surfaces[1].thickness_mm": 12.0}
    steep = solved(open_.changed(strong | {"camera.mla.distance_mm": 40.0, "camera.focus_mm": None})).camera.lens
    assert steep.surfaces[1].semi_diameter_mm <= 5.5


def test_apertures_are_needed_where_no_stop_is_marked(scene: Scene) -> None:
    with pytest.raises(SceneError, match=r"semi_diameter_mm: missing: .*; or mark the stop"):
        without_apertures(scene).changed({"camera.lens.surfaces[0].stop": False})


IMPOSSIBLE = [
    ({"camera.focus_mm": None}, r"camera\.mla\.distance_mm: missing; give it, or give camera\.focus_mm"),
    ({"camera.focus_mm": None, "camera.mla": None}, r"camera\.sensor\.distance_mm: missing; give it, or"),
    ({"camera.focus_mm": 40.0}, r"focus_mm = 40: no real image.*57\.3258 mm before the lens; give 57\.326 or more"),
    (
        {"camera.lens.surfaces[1].radius_mm": -60.0, "camera.lens.surfaces[2].radius_mm": 60.0},
        "use a converging lens",
    ),
    ({"camera.mla.focal_length_mm": -0.7}, r"diverges.*give camera\.sensor\.distance_mm too"),
    ({"camera.mla.thickness_mm": 2.0}, r"ends inside their plate; give thickness_mm at most 1\.04999"),
    ({"camera.lens": {"file": "none.toml"}}, r"none\.toml: cannot be read"),
]


def test_of_a_relay_that_images_a_plane_into_itself_it_is_said_where() -> None:
    """Two lenses of 50 mm, 100 mm apart, image what stands 105 mm before the first one 5 mm before the second one."""
    lens = {"paraxial": True, "focal_length_mm": 50.0, "semi_diameter_mm": 9.0}
    for spread, focal in ((100.0, "inf"), (99.999, r"2\.5e\+06")):
        surfaces = [{**lens, "stop": True, "thickness_mm": spread}, lens]
        camera = {"focus_mm": 105.0, "lens": {"surfaces": surfaces}, "sensor": {"pixels": [8, 8], "pixel_mm": 0.01}}
        scene = Scene.model_validate({"schema_version": 1, "camera": camera})
        message = rf"focal length is {focal} mm, images this plane [45](\.\d+)? mm before the last vertex"
        with pytest.raises(SceneError, match=message):
            solved(scene)


@pytest.mark.parametrize(("values", "message"), IMPOSSIBLE)
def test_what_cannot_be_solved_says_what_to_give(scene: Scene, values: dict[str, object], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        solved(scene.changed(values))
