"""The first-order report, each figure by a second way, and its warnings."""

import json
import math
import re

import numpy as np
import pytest
from scipy.special import eval_jacobi

import lfmesh as lf
from lfmesh.scene import FirstOrder, Plane, Scene, Surface, Target, first_order, solved
from lfmesh.scene.first_order.paraxial import Paraxial


def lenslet_ray(scene: Scene, pupil_z: float, pupil_height: float, axis: float, apex_height: float) -> float:
    """Follow a ray from the exit pupil through a lenslet, face by face, to the sensor.

    The lenslet's axis lies at `axis`; `apex_height` is where the ray meets the plane of the curved face.
    """
    camera = scene.camera
    mla, z_last = camera.mla, camera.lens.vertices_mm[-1]
    assert mla is not None
    n, t, power = 1.5, mla.thickness_mm, 0.5 / mla.radius_mm[0]
    front = z_last + mla.distance_mm - pupil_z
    if mla.curved_side == "lens":
        angle = (apex_height - pupil_height) / front
        inside = (angle - (apex_height - axis) * power) / n
        return apex_height + inside * t + n * inside * camera.sensor.distance_mm
    angle = (apex_height - pupil_height) / (front + t / n)
    return apex_height + (angle - (apex_height - axis) * power) * camera.sensor.distance_mm


@pytest.mark.parametrize("side", ["lens", "sensor"])
def test_micro_image_pitch_and_diameter_are_where_rays_land(scene: Scene, side: str) -> None:
    ready = solved(scene.changed({"camera.mla.curved_side": side}))
    facts = first_order(ready)
    pixel, pitch = ready.camera.sensor.pixel_mm, ready.camera.mla.pitch_mm

    def landing(pupil_height: float, lenslet: int, inside: float = 0.0) -> float:
        axis = lenslet * pitch
        return lenslet_ray(ready, facts.exit_pupil_z_mm, pupil_height, axis, axis + inside) / pixel

    chief = landing(0.0, 8) - landing(0.0, 7)
    assert facts.micro_image_pitch_px == pytest.approx(chief, rel=1e-12)
    assert facts.micro_image_pitch_px > pitch / pixel

    radius = facts.exit_pupil_diameter_mm / 2
    width = landing(-radius, 3) - landing(radius, 3)
    assert facts.micro_image_diameter_px == pytest.approx(width, rel=1e-12)


def test_pupils_are_images_of_the_stop(scene: Scene) -> None:
    """A stop 2 mm before a singlet is its own entrance pupil; the lens images it into the exit pupil."""
    facts = first_order(scene)
    assert facts.entrance_pupil_z_mm == pytest.approx(0.0, abs=1e-14)
    assert facts.entrance_pupil_diameter_mm == pytest.approx(12.0)
    lens = Paraxial.of(solved(scene).camera.lens, 587.6)
    distance = lens.image_mm(0.0)
    assert facts.exit_pupil_z_mm == pytest.approx(lens.length_mm + distance, rel=1e-12)
    assert facts.exit_pupil_diameter_mm == pytest.approx(12.0 * lens.magnification(0.0), rel=1e-12)
    # The virtual image of a stop inside the focal length is upright, larger and on the stop's side.
    assert distance < 0
    assert facts.exit_pupil_diameter_mm > 12.0


def test_a_ray_aimed_at_the_entrance_pupil_meets_the_stop_in_proportion(scene: Scene) -> None:
    """With the stop 5 mm behind the singlet: the pupil's centre goes to the stop's, its edge to the edge."""
    front, back = scene.camera.lens.surfaces[1:]
    surfaces = (
        front,
        back.model_copy(update={"thickness_mm": 5.0}),
        Surface(stop=True, semi_diameter_mm=6.0),
    )
    facts = first_order(scene.changed({"camera.lens.surfaces": surfaces}))
    for aim, stop in ((0.0, 0.0), (facts.entrance_pupil_diameter_mm / 2, 6.0)):
        for angle in (0.0, 0.02):
            height = aim - angle * facts.entrance_pupil_z_mm
            inside = (angle - height * 0.5 / 60.0) / 1.5
            height += inside * 4.0
            behind = 1.5 * inside - height * -0.5 / -60.0
            assert height + behind * 5.0 == pytest.approx(stop, abs=1e-12)


def test_working_f_number_is_exit_pupil_over_distance(scene: Scene) -> None:
    facts = first_order(scene)
    expected = (facts.image_z_mm - facts.exit_pupil_z_mm) / facts.exit_pupil_diameter_mm
    assert facts.working_f_number == pytest.approx(expected, rel=1e-12)


def test_sampling_and_field_are_the_array_seen_on_the_object(scene: Scene) -> None:
    facts = first_order(scene)
    image = facts.image_z_mm - facts.rear_principal_plane_z_mm
    away = facts.object_distance_mm + facts.front_principal_plane_z_mm
    assert facts.magnification == pytest.approx(-image / away, rel=1e-12)
    assert facts.object_sampling_mm == pytest.approx(0.12 * away / image, rel=1e-12)
    assert facts.field_of_view_mm == pytest.approx((32 * 0.12 * away / image, 24 * 0.12 * away / image))
    assert facts.object_distance_mm == pytest.approx(400.0, rel=1e-12)


@pytest.mark.parametrize("side", ["lens", "sensor"])
def test_views_a_pixel_apart_shift_by_a_lenslet_at_the_ends_of_the_range(scene: Scene, side: str) -> None:
    ready = solved(scene.changed({"camera.mla.curved_side": side}))
    facts = first_order(ready)
    lens, pixel = Paraxial.of(ready.camera.lens, 587.6), ready.camera.sensor.pixel_mm
    width = facts.exit_pupil_diameter_mm
    pixels = facts.micro_image_diameter_px
    step = width / pixels
    for distance in (facts.near_mm, facts.far_mm):
        image_z = lens.length_mm + lens.image_mm(distance)
        # Lines from two pupil points, a view apart, to the image point, where they cross the array.
        reach = image_z - facts.exit_pupil_z_mm
        crossings = [u * (image_z - facts.image_z_mm) / reach for u in (0.0, step)]
        assert abs(crossings[1] - crossings[0]) == pytest.approx(0.12, rel=1e-9)
    assert facts.near_mm < 400.0 < facts.far_mm
    assert pixel * pixels == pytest.approx(width / (facts.image_z_mm - facts.exit_pupil_z_mm) * 0.7, rel=1e-12)


def test_a_conventional_camera_samples_by_pixels(scene: Scene) -> None:
    facts = first_order(scene.changed({"camera.mla": None}))
    assert facts.micro_image_pitch_px is None
    assert facts.object_sampling_mm == pytest.approx(0.012 / abs(facts.magnification))
    # At the ends of the depth of field the blur is one pixel.
    lens = Paraxial.of(scene.camera.lens, 587.6)
    for distance in (facts.near_mm, facts.far_mm):
        image_z = lens.length_mm + lens.image_mm(distance)
        away = abs(image_z - facts.image_z_mm) / (image_z - facts.exit_pupil_z_mm)
        assert away * facts.exit_pupil_diameter_mm == pytest.approx(0.012, rel=1e-9)


@pytest.mark.parametrize(("side", "focus_mm"), [("lens", 500.0), ("sensor", 500.0), ("lens", 3000.0)])
def test_refocused_photographs_are_sharp_while_a_point_spreads_over_a_lenslet(
    scene: Scene, side: str, focus_mm: float
) -> None:
    """Lines from both edges of the exit pupil to the image point, shifted for the refocused plane, a pitch apart.

    The camera focused on 3000 mm can be refocused to infinity, where its depth of field begins at a finite distance.
    """
    ready = solved(scene.changed({"camera.mla.curved_side": side, "camera.focus_mm": focus_mm}))
    facts = first_order(ready)
    lens = Paraxial.of(ready.camera.lens, 587.6)

    def crossing(distance: float) -> float:
        """Where the line from the pupil's upper edge to the axial image of an object crosses the image plane."""
        image_z = lens.length_mm + lens.image_mm(distance)
        share = (image_z - facts.image_z_mm) / (image_z - facts.exit_pupil_z_mm)
        return 0.5 * facts.exit_pupil_diameter_mm * share

    planes = (facts.near_mm, facts.object_distance_mm, facts.far_mm)
    assert tuple(row[0] for row in facts.refocused_mm) == planes
    assert math.isinf(facts.far_mm) == (focus_mm == 3000.0)
    for plane, near, far in facts.refocused_mm:
        assert near < plane <= far
        for end in (near, far):
            if math.isfinite(end):
                assert 2 * abs(crossing(end) - crossing(plane)) == pytest.approx(0.12, rel=1e-9)


def test_views_a_pixel_apart_are_that_far_apart_on_the_entrance_pupil(scene: Scene) -> None:
    """Light that meets an apex on the axis, a pixel aside behind it, followed back to the stop at the first vertex."""
    ready = solved(scene)
    facts = first_order(ready)
    m = Paraxial.of(ready.camera.lens, 587.6).whole
    slope = ready.camera.sensor.pixel_mm / 0.7
    behind = -slope * ready.camera.mla.distance_mm
    assert abs(m.d * behind - m.b * slope) == pytest.approx(facts.view_spacing_mm, rel=1e-9)


def test_the_lens_at_each_wavelength_and_band(scene: Scene) -> None:
    glass = {f"camera.lens.surfaces[1].{key}": value for key, value in (("index", None), ("glass", "SCHOTT/N-BK7"))}
    lines = scene.changed({**glass, "transport.wavelengths_nm": (486.1, 587.6, 656.3)})
    facts = first_order(lines)
    alone = [first_order(lines.changed({"transport.wavelengths_nm": (nm,)})) for nm in (486.1, 587.6, 656.3)]
    assert [at.efl_mm for at in facts.by_wavelength] == [one.efl_mm for one in alone]
    blue, green, red = (at.image_shift_mm for at in facts.by_wavelength)
    assert blue < green == 0.0 < red
    assert sum(line.startswith("at ") for line in facts.lines()) == 3
    json.dumps(facts.as_dict())
    bands = scene.changed({**glass, "camera.sensor.bands": "rgb"})
    assert [at.wavelength_nm for at in first_order(bands).by_wavelength] == list(bands.wavelengths_nm)
    assert first_order(scene).by_wavelength == ()


@pytest.fixture
def telecentric(scene: Scene) -> Scene:
    """The camera with its stop in the front focal plane, so that the exit pupil is at infinity."""
    gap = 2.0 - Paraxial.of(scene.camera.lens, 587.6).ffl_mm
    return scene.changed({"camera.lens.surfaces[0].thickness_mm": gap, "camera.focus_mm": 300.0})


def test_micro_images_of_a_telecentric_lens_are_a_pitch_apart(telecentric: Scene) -> None:
    facts = first_order(telecentric)
    assert facts.exit_pupil_diameter_mm == math.inf
    assert facts.micro_image_pitch_px == pytest.approx(10.0, rel=1e-12)
    assert math.isfinite(facts.working_f_number)
    assert "telecentric" in str(facts)


def test_refocus_range_is_the_depth_of_field_of_an_f_number_p_times_higher(telecentric: Scene) -> None:
    """Ng et al. 2005, where the pupil is far away: a blur of one pitch at f-number N · P."""
    facts = first_order(telecentric)
    lens = Paraxial.of(telecentric.camera.lens, 587.6)
    depth = 0.12 * facts.working_f_number * facts.micro_image_diameter_px
    image = facts.image_z_mm - lens.length_mm
    assert facts.near_mm == pytest.approx(lens.object_mm(image + depth), rel=1e-9)
    assert facts.far_mm == pytest.approx(lens.object_mm(image - depth), rel=1e-9)


def matched(scene: Scene) -> Scene:
    """The camera with its lens stopped down to the microlenses' f-number."""
    facts = first_order(scene)
    radius = 6.0 * facts.working_f_number / facts.microlens_f_number
    return scene.changed({"camera.lens.stop_semi_diameter_mm": 0.99 * radius})


def test_a_good_camera_has_no_warnings(scene: Scene) -> None:
    assert first_order(matched(scene)).warnings == ()


PARTICLES = {
    "count": 3,
    "bounds": {"kind": "sphere", "radius_mm": 1.0},
    "position_mm": [0.0, 0.0, -400.0],
    "intensity_w_sr": 1.0,
}

WARNED = [
    ({"camera.lens.stop_semi_diameter_mm": 8.0}, "f-numbers do not match: the lens works at f/"),
    ({"camera.lens.stop_semi_diameter_mm": 8.0}, "micro-images overlap"),
    ({"camera.lens.stop_semi_diameter_mm": 3.0}, "micro-images leave gaps"),
    ({"camera.lens.stop_semi_diameter_mm": 10.5}, "stop is larger than a clear aperture"),
    ({"camera.mla.distance_mm": 50.0}, "inside the focal length: the camera is focused beyond infinity"),
    ({"camera.focus_mm": 50.0, "camera.mla.distance_mm": 70.0}, "focus_mm = 50 is inside the focal length"),
    ({"camera.mla.distance_mm": 70.0}, "focus_mm = 400, but the distances given focus on"),
    ({"targets[0].position_mm": (40.0, 0.0, -400.0)}, "targets[0] is out of the field: at z = -400 mm"),
    ({"targets[0].position_mm": (0.0, 0.0, 400.0)}, "targets[0] is out of the field: z = 400 mm is behind"),
    ({"targets[0].position_mm": (0.0, 0.0, -4000.0)}, "targets[0] stands at 4000 mm, out of the range"),
    ({"camera.sensor.pixels": (100, 240)}, "outer lenslets are not recorded"),
    ({"camera.sensor.pixels": (320, 480)}, "outer pixels stay dark"),
    ({"camera.mla.pose.shift_mm[0]": 5.0}, "the array stands 5 mm beside the sensor along x"),
    ({"camera.sensor.pose.shift_mm[1]": -5.0}, "the array stands 5 mm beside the sensor along y"),
    ({"camera.sensor.pixel_mm": 0.08, "camera.sensor.pixels": (48, 36)}, "too few to distinguish directions"),
    ({"targets": ()}, "no targets"),
    ({"lights": ()}, "nothing emits"),
    (
        {"media": [{"scattering_per_mm": 0.01}], "transport.method": "forward"},
        "media[0] scatters light right before the lens",
    ),
    (
        {
            "media": [{"name": "smoke", "scattering_per_mm": 0.01}],
            "particles": [PARTICLES],
        },
        "smoke scatters light: the picture has only a part of the particles' light",
    ),
    (
        {
            "targets": [
                {
                    "refractor": {
                        "box_mm": [9.0, 9.0, 3.0],
                        "index": 1.5,
                        "finish": {"kind": "ground", "roughness": 0.03},
                    },
                    "position_mm": [0.0, 0.0, -350.0],
                }
            ],
            "particles": [PARTICLES],
        },
        "targets[0].refractor.finish scatters light: the picture has only a part of the particles' light",
    ),
    ({"transport.samples": 12}, "samples = 12 is not a multiple of 8 replicates: rounded up to 16"),
    (
        {"coatings": {"ar": {"layers": [{"index": 1.38, "thickness_nm": 0.1064}]}}},
        "coatings.ar.layers[0].thickness_nm = 0.1064: thinner than an atom; if that is in µm, give 106.4",
    ),
]


@pytest.mark.parametrize(("values", "words"), WARNED)
def test_warnings_say_what_is_likely_to_disappoint(scene: Scene, values: dict[str, object], words: str) -> None:
    facts = first_order(matched(scene).changed(values))
    assert any(words in warning for warning in facts.warnings), facts.warnings
    assert f"Note: {facts.warnings[0]}" in str(facts)


@pytest.mark.parametrize("behind", [1.0, 1.3])
@pytest.mark.parametrize("stop_mm", [3.0, 8.0])
def test_f_numbers_match_at_the_focal_length_and_at_the_stop_that_the_warning_names(
    scene: Scene, stop_mm: float, behind: float
) -> None:
    off = scene.changed({"camera.lens.stop_semi_diameter_mm": stop_mm, "camera.image_medium": {"index": behind}})
    (said,) = (warning for warning in first_order(off).warnings if "f-numbers do not match" in warning)
    named = dict(re.findall(r"(camera\.[a-z._]+) = ([\d.]+)", said))
    assert named.keys() == {"camera.mla.focal_length_mm", "camera.lens.stop_semi_diameter_mm"}
    for path, value in named.items():
        facts = first_order(off.changed({path: float(value)}))
        assert facts.working_f_number == pytest.approx(facts.microlens_f_number, rel=1e-3)
        assert not any("f-numbers" in warning for warning in facts.warnings)
    several = off.changed({"camera.mla.focal_length_mm": [0.7, 0.6]})
    (said,) = (warning for warning in first_order(several).warnings if "f-numbers do not match" in warning)
    assert "focal_length_mm" not in said
    assert "stop_semi_diameter_mm" in said


@pytest.mark.parametrize(
    ("coefficients", "rim", "growth"),
    [
        ((0.01,), 5.0, None),
        ((0.01,), 5.2, None),
        ((0.01,), 6.0, 1.2**4),
        ((0.0, 0.0, 0.0, 1e-4), 5.2, 1.04**4 * eval_jacobi(3, 0, 4, 2.0 * 1.04**2 - 1.0)),
        ((0.01, 0.0, 0.0, 0.0, 1e-4), 6.0, 1.2**4 * eval_jacobi(4, 0, 4, 2.0 * 1.2**2 - 1.0)),
        ((0.01, 0.0, 0.0, 0.0, 0.0), 5.2, None),
    ],
)
def test_a_strong_asphere_that_is_clear_beyond_its_norm_radius_is_named(
    scene: Scene, coefficients: tuple[float, ...], rim: float, growth: float | None
) -> None:
    qcon = {"norm_radius_mm": 5.0, "coefficients_mm": coefficients}
    surface = "camera.lens.surfaces[1]"
    changed = scene.changed({f"{surface}.qcon": qcon, f"{surface}.semi_diameter_mm": rim})
    said = [line for line in first_order(changed).warnings if "norm_radius_mm" in line]
    assert len(said) == (growth is not None)
    if growth is not None:
        assert said[0].startswith(f"surfaces[1] is clear up to {rim:g} mm")
        assert f"{growth:.3g} times" in said[0]


def test_a_lens_that_diverges_is_told_from_a_relay(scene: Scene) -> None:
    """Both have a negative focal length; images of a relay, which holds an image itself, are real."""
    stop, front, back = matched(scene).camera.lens.surfaces
    hollow = (
        stop,
        front.model_copy(update={"radius_mm": -front.radius_mm}),
        back.model_copy(update={"radius_mm": -back.radius_mm}),
    )
    relay = (stop, front, back.model_copy(update={"thickness_mm": 240.0}), front, back)
    for surfaces, diverges in ((hollow, True), (relay, False)):
        lens = scene.camera.lens.model_copy(update={"surfaces": surfaces})
        camera = scene.camera.model_copy(update={"lens": lens, "focus_mm": None})
        changed = scene.model_copy(update={"camera": camera}).changed({"camera.mla.distance_mm": 120.0})
        facts = first_order(changed)
        assert facts.efl_mm < 0.0
        assert any("diverges" in warning for warning in facts.warnings) is diverges


def test_an_emitting_target_needs_no_lamp(scene: Scene) -> None:
    target = Target(shape=Plane(width_mm=1.0, height_mm=1.0), material={"radiance_w_m2_sr": 1.0})
    facts = first_order(scene.changed({"lights": (), "targets": (target,)}))
    assert not any("shines" in warning for warning in facts.warnings)


def test_the_report_has_a_line_for_every_figure(scene: Scene) -> None:
    lines = first_order(matched(scene)).lines()
    # Principal planes, pupils (two figures each), refocus range and the lens's Airy disk (three figures) share lines;
    # so do the two of the views, and of diffraction at a lenslet. Three refocused planes have a line each; no element
    # has a pose; one wavelength has no line of its own, without a cover there is no line of it, and none of two figures
    # of another section in x, nor of lenslets' sections. The image plane is that of the lenslets, and there are none of
    # a focused camera. Air before the lens has no line, nor has air behind it. One line more says what diffraction at
    # the lenslets makes of points. The field at other distances than that in focus has none,
    # nor have lenslets that do not image upright.
    assert len(lines) == len(FirstOrder.__dataclass_fields__) - 18
    assert any(line.startswith("effective focal length 60.67") for line in lines)


def test_flat_glass_has_no_focal_length(scene: Scene) -> None:
    flat = (
        Surface(thickness_mm=3.0, index=1.5, semi_diameter_mm=5.0, stop=True),
        Surface(semi_diameter_mm=5.0),
    )
    assert Paraxial.of(scene.camera.lens.model_copy(update={"surfaces": flat}), 587.6).efl_mm == math.inf


def test_the_field_of_an_anamorphic_lens_is_that_of_its_chief_rays_in_both_sections() -> None:
    """A ray through the middle of a stop before the lens, traced: where it lands over where it comes from."""
    toric = {"radius_mm": 30.0, "toroid": {"radius_x_mm": 18.0}, "thickness_mm": 3.0, "index": 1.5}
    surfaces = (
        {"stop": True, "thickness_mm": 4.0, "semi_diameter_mm": 1.0},
        toric | {"semi_diameter_mm": 6.0},
        {"radius_mm": math.inf, "semi_diameter_mm": 6.0},
    )
    scene = lf.Scene(
        camera={
            "lens": {"surfaces": surfaces},
            "sensor": {"pixels": (80, 60), "pixel_mm": 0.05, "distance_mm": 65.0},
        }
    )
    facts = lf.first_order(scene)
    slope = 1e-4
    for axis, (size, seen) in enumerate(zip((4.0, 3.0), facts.field_of_view_mm, strict=True)):
        start, way = np.array([[0.0, 0.0, -1.0]]), np.array([[0.0, 0.0, 1.0]])
        start[0, axis], way[0, axis] = -slope, slope
        lands = lf.trace(lf.build(scene), start, way, split="transmit").position[0, axis]
        point = -slope * facts.object_distance_mm
        assert seen == pytest.approx(size * abs(point / lands), rel=1e-6)
    assert facts.field_of_view_mm[0] / 4.0 != pytest.approx(facts.field_of_view_mm[1] / 3.0, rel=0.02)
