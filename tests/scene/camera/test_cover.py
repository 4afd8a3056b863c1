"""The cover glass in the scene file: what it does to focus and micro-images, and what is refused."""

import pytest

import lfmesh as lf
from lfmesh.errors import SceneError
from lfmesh.scene.files import loads
from tests.cameras import camera_without_array, close_up_camera

COVER = {"thickness_mm": 0.6, "gap_mm": 0.1, "index": 1.5}
SHIFT_MM = 0.2
"""0.6 mm (1 - 1/1.5)."""


def scene(array=True, cover=COVER, **sensor):
    camera = close_up_camera() if array else camera_without_array()
    camera["sensor"] |= {"cover": cover, **sensor}
    return lf.Scene(camera=camera)


def placed(of):
    """From the array or the last vertex to the sensor, solved."""
    return lf.build(of).scene.camera.sensor.distance_mm


@pytest.mark.parametrize("array", [True, False])
def test_an_omitted_distance_follows_the_image_that_the_cover_moves(array):
    assert placed(scene(array)) - placed(scene(array, None)) == pytest.approx(SHIFT_MM, rel=1e-12)


def test_a_given_distance_is_kept_and_the_plane_in_focus_moves():
    """The sensor 0.2 mm behind the old image is in focus with the cover on the same object plane."""
    bare = scene(False, None)
    behind = placed(bare) + SHIFT_MM
    covered = scene(False, distance_mm=behind)
    assert placed(covered) == behind
    facts = lf.first_order(covered)
    assert facts.cover_shift_mm == pytest.approx(SHIFT_MM, rel=1e-12)
    assert facts.object_distance_mm == pytest.approx(lf.first_order(bare).object_distance_mm, rel=1e-12)
    assert ("sensor's cover", "moves the image 200 µm away from the lens") in facts.rows()


def test_micro_images_are_those_of_the_reduced_distance():
    with_cover, bare = (lf.first_order(each) for each in (scene(), scene(cover=None)))
    for name in ("microlens_f_number", "micro_image_pitch_px", "micro_image_diameter_px"):
        assert getattr(with_cover, name) == pytest.approx(getattr(bare, name), rel=1e-12)
    still = lf.first_order(scene(distance_mm=placed(scene(cover=None))))
    assert still.micro_image_diameter_px < bare.micro_image_diameter_px


def test_the_distance_from_the_sensor_includes_the_cover():
    """`focus_from = "sensor"`: the track from object to sensor is the one asked for."""
    camera = camera_without_array() | {"focus_from": "sensor"}
    camera["sensor"] |= {"cover": COVER}
    solved = lf.build(lf.Scene(camera=camera)).scene
    lens = solved.camera.lens
    track = lf.first_order(solved).object_distance_mm + lens.vertices_mm[-1] + solved.camera.sensor.distance_mm
    assert track == pytest.approx(150.0, rel=1e-12)


def test_toml_keeps_the_cover():
    camera = close_up_camera()
    camera["sensor"] |= {"cover": COVER | {"coating": "ar"}}
    given = lf.Scene(camera=camera, coatings={"ar": {"reflectance": 0.01}})
    assert loads(given.dump_toml()) == given


@pytest.mark.parametrize(
    ("cover", "message"),
    [
        (COVER | {"gap_mm": 0.0}, "gap_mm"),
        (COVER | {"gap_mm": -0.1}, "gap_mm"),
        (COVER | {"thickness_mm": 0.0}, "thickness_mm"),
        (COVER | {"index": 0.9}, "index"),
        (COVER | {"coating": "unknown"}, "coating"),
        (COVER | {"glass": "SCHOTT/N-BK7"}, "index = 1.5 is given too"),
        ({"thickness_mm": 0.5, "gap_mm": 0.1}, "give the cover's index, or glass"),
        (COVER | {"index": None, "glass": "SCHOTT/NONE"}, "glass"),
        (COVER | {"width_mm": 3.0}, "width_mm"),
    ],
)
def test_what_no_cover_can_be_is_refused(cover, message):
    with pytest.raises(SceneError, match=message):
        scene(cover=cover)


def test_a_cover_needs_room():
    with pytest.raises(SceneError, match=r"distance_mm = 0\.5; thickness_mm and gap_mm together"):
        scene(distance_mm=0.5)


def test_a_cover_that_meets_the_array_is_refused():
    """As solved, or as poses tilt it."""
    with pytest.raises(SceneError, match="thickness_mm and gap_mm together must be less"):
        lf.build(scene(cover=COVER | {"gap_mm": 4.0}))
    with pytest.raises(SceneError, match="through the sensor's cover"):
        lf.build(scene(cover=COVER | {"gap_mm": 1.7}, pose={"tilt_deg": [20.0, 0.0, 0.0]}))


def test_polarised_light_and_a_cover_exclude_each_other():
    camera = close_up_camera()
    camera["sensor"] |= {"cover": COVER}
    with pytest.raises(SceneError, match="omit the cover"):
        lf.Scene(camera=camera, transport={"polarisation": True})
