"""The first-order model: distances and shifts belong to each other, and follow the report of the scene."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.lightfield.rays.lens_alone import focus_shift
from lfmesh.lightfield.rays.ray_model import RayModel, ShiftMap, TracedShift
from lfmesh.scene import Scene, first_order, solved
from lfmesh.scene.first_order.paraxial import Paraxial


@pytest.fixture
def real(camera: Callable[..., Scene]) -> RayModel:
    return RayModel.of(camera())


@pytest.fixture
def model(real: RayModel) -> RayModel:
    """Without the shift of the focus by spherical aberration: what first-order optics can be compared with."""
    return replace(real, focus_shift_mm=0.0, focus_shift_mm2=0.0)


@pytest.mark.parametrize("pupil_mm", [59.24, 200.0, math.inf, -150.0])
def test_distance_and_shift_are_inverse(real: RayModel, pupil_mm: float) -> None:
    model = replace(real, pupil_to_array_mm=pupil_mm)
    assert model.focus_shift_mm < 0.0
    for distance in (120.0, 300.0, 500.0, 800.0, 5000.0):
        assert model.distance_mm(model.shift_mm(distance)) == pytest.approx(distance, rel=1e-9)


def relay(stop_mm: float) -> Scene:
    """Return a camera the stop of which stands behind a biconvex lens."""
    glass = {"radius_mm": 30.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 9.0}
    back = {"radius_mm": -30.0, "thickness_mm": stop_mm, "semi_diameter_mm": 9.0}
    lens = {"surfaces": [glass, back, {"stop": True, "semi_diameter_mm": 3.0}]}
    array = {"count": [10, 10], "pitch_mm": 0.2, "focal_length_mm": 1.0, "index": 1.5, "thickness_mm": 0.4}
    sensor = {"pixels": [100, 100], "pixel_mm": 0.02}
    return solved(Scene(camera={"focus_mm": 60.0, "lens": lens, "mla": array, "sensor": sensor}))


def test_spherical_aberration_of_an_object_side_telecentric_lens_is_that_of_one_that_is_nearly_so() -> None:
    back_focus = Paraxial.of(relay(20.0).camera.lens, relay(20.0).primary_nm).bfl_mm + 20.0
    telecentric, nearly = relay(back_focus), relay(back_focus + 1e-4)
    assert math.isinf(first_order(telecentric).entrance_pupil_z_mm)
    assert math.isfinite(first_order(nearly).entrance_pupil_z_mm)
    shift, truth = focus_shift(telecentric), focus_shift(nearly)
    assert truth[0] < -1e-3
    assert shift == pytest.approx(truth, rel=1e-3)


def as_measured(model: RayModel) -> TracedShift:
    """The paraxial model, written by what its rays show: b = place, c = view, linear in the vergence V."""
    # By hand, from x V = a + b s + c u of an object at 1/V: two distances tell the line that their shifts lie on.
    near, far = (model.shift_mm(distance) for distance in (300.0, 900.0))
    infinite = model.shift_mm(math.inf)
    # shift = (p + q V) / (1 + r V), p = infinite.
    rows = np.array([[1.0 / 300.0, -near / 300.0], [1.0 / 900.0, -far / 900.0]])
    q, r = np.linalg.solve(rows, [near - infinite, far - infinite])
    return TracedShift((1.0, float(r)), (infinite, float(q)))


@pytest.mark.parametrize("kind", ["first order", "traced"])
def test_both_maps_of_shift_and_distance_answer_alike(model: RayModel, kind: str) -> None:
    """For numbers and arrays, to infinity and beyond: virtual objects have negative distances."""
    answers: ShiftMap = model if kind == "first order" else as_measured(model)
    shifts = np.array([[0.5, 0.0, -0.1], [answers.shift_mm(math.inf), answers.shift_mm(math.inf) - 0.01, np.nan]])
    shifts[0] *= model.lenslet_pitch_mm
    found = answers.distance_mm(shifts)
    assert found.shape == (2, 3)
    assert found[0, 0] < found[0, 1] < found[0, 2]
    for shift, distance in zip(shifts[0], found[0], strict=True):
        assert answers.shift_mm(float(distance)) == pytest.approx(shift, abs=1e-12)
        one = answers.distance_mm(float(shift))
        assert isinstance(one, float)
        assert one == distance
    assert abs(found[1, 0]) > 1e12
    assert found[1, 1] < 0.0
    assert np.isnan(found[1, 2])
    np.testing.assert_allclose(found[0], model.distance_mm(shifts[0]), rtol=1e-9)


def test_what_is_in_focus_does_not_shift_and_nearer_shifts_positive(model: RayModel) -> None:
    assert model.shift_mm(500.0) == pytest.approx(0.0, abs=1e-14)
    assert model.shift_mm(400.0) > 0.0 > model.shift_mm(700.0)


def test_pitch_and_range_are_those_of_the_report(camera: Callable[..., Scene], model: RayModel) -> None:
    facts = first_order(camera())
    assert model.micro_image_pitch_px == pytest.approx(facts.micro_image_pitch_px, rel=1e-14)
    assert model.refocus_range_mm == pytest.approx((facts.near_mm, facts.far_mm), rel=1e-12)


def test_a_shift_is_the_parallax_of_two_points_of_the_exit_pupil(model: RayModel) -> None:
    """By similar triangles, from the image of an object: lines from two pupil points to it, cut by the array."""
    image = 1.0 / (1.0 / model.efl_mm - 1.0 / (350.0 + model.front_principal_z_mm)) + model.rear_principal_z_mm
    pupil = model.array_z_mm - model.pupil_to_array_mm
    share = (model.array_z_mm - pupil) / (image - pupil)
    crossings = [x + (1.0 - x) * share for x in (0.0, model.view_step_mm)]
    assert model.shift_mm(350.0) == pytest.approx(crossings[1] - crossings[0], rel=1e-12)


def test_object_scale_is_what_a_chief_ray_sees(model: RayModel) -> None:
    """In the plane of focus the size of an object over that of its image is 1/magnification."""
    image = model.array_z_mm - model.rear_principal_z_mm
    assert model.object_scale(500.0) == pytest.approx((500.0 + model.front_principal_z_mm) / image, rel=1e-12)


def test_installation_along_the_axis_counts(camera: Callable[..., Scene], model: RayModel) -> None:
    moved = RayModel.of(camera().changed({"camera.mla.pose.shift_mm": [0.0, 0.0, 0.02]}))
    assert moved.array_z_mm == pytest.approx(model.array_z_mm + 0.02, rel=1e-15)
    assert moved.lenslet_to_sensor_mm == pytest.approx(model.lenslet_to_sensor_mm - 0.02, rel=1e-14)
    assert moved.pupil_to_array_mm == pytest.approx(model.pupil_to_array_mm + 0.02, rel=1e-14)


@pytest.mark.parametrize("distance", [27.0, 0.0, -5.0, math.nan])
def test_an_object_inside_the_front_focal_length_is_refused(model: RayModel, distance: float) -> None:
    with pytest.raises(lf.LfmeshError, match="must lie before the front focal point"):
        model.shift_mm(distance)


@pytest.mark.parametrize("distance", [300.0, 450.0, 1000.0])
def test_the_sharpest_image_is_that_of_real_rays(camera: Callable[..., Scene], real: RayModel, distance: float) -> None:
    """A cone through the whole stop, square in the entrance pupil, traced to the array: where its spot is smallest.

    The model ties the shift at two distances by a line, good to 4 micrometres; first-order optics errs by 60 or more.
    """
    scene = camera()
    pupil = first_order(scene)
    one = 0.5 * pupil.entrance_pupil_diameter_mm * np.linspace(-1.0, 1.0, 41)
    x, y = (axis.ravel() for axis in np.meshgrid(one, one))
    toward = np.column_stack([x, y, np.full(x.size, pupil.entrance_pupil_z_mm + distance)])
    # Without the array, the sensor in its place; the stop of the lens takes the corners of the square.
    sensor = {"pixels": (2, 2), "pixel_mm": 10.0, "distance_mm": scene.camera.mla.distance_mm}
    world = lf.build(scene.changed({"camera.mla": None, "camera.sensor": sensor}))
    paths = lf.trace(world, np.tile([0.0, 0.0, -distance], (x.size, 1)), toward, split="transmit")
    arrived = paths.status == lf.Status.SENSOR
    spot, slope = paths.position[arrived, :2], paths.direction[arrived, :2] / paths.direction[arrived, 2:]
    excess = -(spot * slope).sum() / (slope * slope).sum()
    assert real.image_excess_mm(distance) == pytest.approx(excess, abs=0.004)
    assert abs(replace(real, focus_shift_mm=0.0, focus_shift_mm2=0.0).image_excess_mm(distance) - excess) > 0.06


def test_infinity_has_a_shift(model: RayModel) -> None:
    assert model.shift_mm(math.inf) == pytest.approx(model.shift_mm(1e9), rel=1e-6)
    assert np.isinf(model.distance_mm(model.shift_mm(math.inf))) or model.distance_mm(model.shift_mm(math.inf)) > 1e12


def test_an_object_in_the_front_principal_plane_has_the_shift_of_its_neighbours(model: RayModel) -> None:
    """A lens of negative focal length images it; by first-order optics into the rear principal plane."""
    negative = replace(model, efl_mm=-60.0, front_principal_z_mm=-80.0)
    near = [negative.shift_mm(80.0 + step) for step in (-1e-5, 1e-5)]
    assert negative.image_excess_mm(80.0) == negative.rear_principal_z_mm - negative.array_z_mm
    assert negative.shift_mm(80.0) == pytest.approx(np.mean(near), rel=1e-6)
    scales = [negative.object_scale(80.0 + step) for step in (-1e-5, 1e-5)]
    assert negative.object_scale(80.0) == pytest.approx(np.mean(scales), rel=1e-6)


def test_an_object_in_the_front_principal_plane_of_a_lens_with_aberrations_is_refused(real: RayModel) -> None:
    negative = replace(real, efl_mm=-60.0, front_principal_z_mm=-80.0, focus_shift_mm2=-0.1)
    with pytest.raises(lf.LfmeshError, match="lies in the front principal plane"):
        negative.shift_mm(80.0)


def test_an_array_in_the_exit_pupil_is_refused() -> None:
    """The stop is the last surface, and its own exit pupil; sums of distances are rounded."""
    scene = relay(20.0)
    assert scene.camera.mla is not None
    shift = [0.0, 0.0, -(scene.camera.mla.distance_mm or 0.0)]
    with pytest.raises(lf.LfmeshError, match="the exit pupil lies on the array"):
        RayModel.of(scene.changed({"camera.mla.pose.shift_mm": shift}))


def test_a_conventional_camera_has_no_model(camera: Callable[..., Scene]) -> None:
    with pytest.raises(lf.LfmeshError, match="records no light field"):
        RayModel.of(camera().changed({"camera.mla": None}))


def test_distances_in_water_are_those_of_the_report(camera: Callable[..., Scene]) -> None:
    """The plane in focus, the ends of the refocus range, and the size of what is in focus."""
    again = {"camera.mla.distance_mm": None, "camera.sensor.distance_mm": None}
    scene = camera().changed(again | {"camera.object_medium": {"index": 1.333}})
    facts, real = first_order(scene), RayModel.of(scene)
    assert facts.object_index == 1.333
    model = real.paraxial
    assert model.nearest_mm == pytest.approx(-facts.ffl_mm, rel=1e-12)
    assert model.distance_mm(0.0) == pytest.approx(facts.object_distance_mm, rel=1e-12)
    assert model.refocus_range_mm == pytest.approx((facts.near_mm, facts.far_mm), rel=1e-12)
    assert model.object_scale(facts.object_distance_mm) == pytest.approx(1.0 / abs(facts.magnification), rel=1e-12)
    for distance in (300.0, 800.0, 5000.0):
        assert real.distance_mm(real.shift_mm(distance)) == pytest.approx(distance, rel=1e-9)
    assert 0.0 < abs(real.focus_shift_mm) < 0.1 * facts.efl_mm


def test_the_f_number_of_an_immersed_camera_is_that_of_its_report(camera: Callable[..., Scene]) -> None:
    """It is 1 / (2 n' u'), of a cone of light with the slope u' behind the lens."""
    again = {"camera.mla.distance_mm": None, "camera.sensor.distance_mm": None}
    scene = camera().changed(again | {"camera.image_medium": {"index": 1.3}})
    facts, model = first_order(scene), RayModel.of(scene)
    assert model.f_number == facts.working_f_number
    assert facts.lenslets_z_mm is not None
    cone = 0.5 * facts.exit_pupil_diameter_mm / abs(facts.lenslets_z_mm - facts.exit_pupil_z_mm)
    assert model.pupil_slope == pytest.approx(cone, rel=1e-12)
    assert model.f_number == pytest.approx(1.0 / (2.0 * 1.3 * cone), rel=1e-12)
