"""Lamps where a picture does not hold their light: in the field, and close to a target."""

import warnings
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.transport.checks.foreseen import foreseen
from tests.renders import by_seed
from tests.transport.checks.test_picture_warnings import scene

WALL = {"shape": {"kind": "plane", "width_mm": 40.0, "height_mm": 40.0}, "position_mm": (0.0, 0.0, -100.0)}


def lit(*position_mm: float, **changes: Any) -> lf.Scene:
    """The wall, lit by a point lamp; the field is some 9 mm wide there."""
    lamp = {"kind": "point", "position_mm": position_mm, "power_w": 1.0}
    return scene(targets=[WALL], lights=[lamp], **{"camera.sensor.pixel_mm": 0.5} | changes)


def kinds(given: lf.Scene) -> list[type]:
    return [type(each) for each in foreseen(lf.build(given))]


SHEET = {"shape": {"kind": "plane", "width_mm": 4.0, "height_mm": 4.0}, "position_mm": (0.0, 0.0, -70.0)}


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (lit(0.0, 0.0, -80.0), True),
        (lit(30.0, 0.0, -80.0), False),
        (lit(0.0, 0.0, 80.0), False),
        (lit(0.0, 0.0, -120.0), False),
        (lit(0.0, 0.0, -80.0).changed({"targets": [WALL, SHEET]}), False),
        (lit(0.0, 0.0, -60.0).changed({"targets": [WALL, SHEET]}), True),
    ],
    ids=["in the field", "beside it", "behind the camera", "behind the wall", "behind a sheet", "before a sheet"],
)
def test_a_lamp_that_a_real_camera_would_see_is_named(given: lf.Scene, told: bool) -> None:
    assert (lf.MissedLightWarning in kinds(given)) == told


@pytest.mark.parametrize(
    ("motion", "told"),
    [
        ({"velocity_mm_s": [-6000.0, 0.0, 0.0]}, True),
        ({"velocity_mm_s": [-1000.0, 0.0, 0.0]}, False),
        ({"velocity_mm_s": [-6000.0, 9000.0, 0.0]}, False),
        ({"spin_deg_s": [0.0, 18000.0, 0.0], "center_mm": [0.0, 0.0, -95.0]}, True),
    ],
    ids=["across", "beside", "past", "in a circle"],
)
def test_a_lamp_that_passes_through_the_field_is_named(motion: dict[str, Any], told: bool) -> None:
    """It begins and ends 30 mm beside the axis, or where the motion ends in a hundredth of a second."""
    given = lit(30.0, 0.0, -80.0).changed({"exposure": {"duration_s": 0.01}, "lights[0].motion": motion})
    found = [str(each) for each in foreseen(lf.build(given)) if isinstance(each, lf.MissedLightWarning)]
    assert any("lights[0] passes through the field" in text for text in found) == told


def test_each_of_some_lamps_in_the_field_is_named_and_of_many_a_few() -> None:
    random = np.random.default_rng(3)
    places = random.uniform([-8.0, -8.0, -90.0], [8.0, 8.0, 20.0], (10, 3)).tolist()
    lamps = [{"kind": "point", "position_mm": place, "power_w": 1.0} for place in places]

    def named(lights: list[dict[str, Any]]) -> list[str]:
        found = foreseen(lf.build(scene(targets=[WALL], lights=lights)))
        return [str(each) for each in found if isinstance(each, lf.MissedLightWarning) and "lights[" in str(each)]

    alone = [number for number, lamp in enumerate(lamps) if named([lamp])]
    assert 2 <= len(alone) <= 8
    assert [int(text[7 : text.index("]")]) for text in named(lamps)] == alone
    many = [{"kind": "point", "position_mm": [0.0, 0.0, -50.0 - i], "power_w": 1.0} for i in range(30)]
    assert len(named(many)) == 9
    assert "perhaps more of the 30 lights" in named(many)[-1]


def test_a_lamp_in_the_plane_of_facets_is_named_without_a_warning_of_numbers() -> None:
    box = {"shape": {"kind": "box", "size_mm": (1.0, 1.0, 1.0)}, "position_mm": (0.0, 0.0, -120.0)}
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        assert lf.MissedLightWarning in kinds(lit(0.0, 0.0, -80.0).changed({"targets": [box]}))


def test_a_lamp_is_in_the_field_of_a_camera_that_has_turned() -> None:
    turned = {"camera.pose": {"tilt_deg": (0.0, 90.0, 0.0)}}
    for place, told in (((-80.0, 0.0, 0.0), True), ((0.0, 0.0, -80.0), False)):
        lamp = {"kind": "point", "position_mm": place, "power_w": 1.0}
        assert (lf.MissedLightWarning in kinds(scene(targets=[], lights=[lamp], **turned))) == told


@pytest.mark.parametrize(("place", "fog", "told"), [(0.0, 1e-3, True), (0.0, 0.0, False), (30.0, 1e-3, False)])
def test_a_disk_lamp_in_the_field_is_found_by_few_paths_in_fog(place: float, fog: float, told: bool) -> None:
    disk = {"kind": "disk", "position_mm": (place, 0.0, -60.0), "direction": (0.0, 0.0, -1.0), "radius_mm": 1.0}
    media = [{"scattering_per_mm": fog}] if fog else []
    assert (lf.HeavyPathsWarning in kinds(scene(lights=[disk | {"power_w": 1.0}], media=media))) == told


def sized(kind: str, *middle_mm: float, half_mm: float = 6.0, along: str = "x") -> dict[str, Any]:
    """A tube or a narrow panel across the field, along x or along z."""
    axis = np.eye(3)["xyz".index(along)]
    if kind == "line":
        ends = (tuple(np.array(middle_mm) + sign * half_mm * axis) for sign in (-1.0, 1.0))
        return {"kind": "line", "power_w": 1.0} | dict(zip(("start_mm", "end_mm"), ends, strict=True))
    return {"kind": "rectangle", "power_w": 1.0, "position_mm": middle_mm, "width_mm": 2.0 * half_mm, "height_mm": 0.01,
            "direction": (0.0, 0.0, -1.0)}  # fmt: skip


@pytest.mark.parametrize("kind", ["line", "rectangle"])
def test_a_long_lamp_is_in_the_field_with_any_part_of_it(kind: str) -> None:
    """The field is some 9 mm wide at 100 mm; ends and middle may all be beside it."""
    wide = {"camera.sensor.pixel_mm": 0.5}
    for lamp, told in (
        (sized(kind, 0.0, 0.0, -80.0), True),
        (sized(kind, 30.0, 0.0, -80.0, half_mm=31.0), True),
        (sized(kind, 60.0, 0.0, -80.0, half_mm=90.0), True),
        (sized(kind, 40.0, 0.0, -80.0), False),
        (sized(kind, 0.0, 40.0, -80.0, half_mm=90.0), False),
        (sized(kind, 0.0, 0.0, 80.0), False),
    ):
        assert (lf.MissedLightWarning in kinds(scene(targets=[], lights=[lamp], **wide))) == told, lamp


def test_a_long_lamp_is_hidden_where_a_target_hides_all_of_it() -> None:
    sheet = {"shape": {"kind": "plane", "width_mm": 14.0, "height_mm": 4.0}, "position_mm": (0.0, 0.0, -70.0)}
    hole = [sheet | {"position_mm": (x, 0.0, -70.0)} for x in (-7.5, 7.5)]
    ball = {"shape": {"kind": "sphere", "radius_mm": 12.0}, "position_mm": (0.0, 0.0, -60.0)}
    for kind in ("line", "rectangle"):
        lamp = sized(kind, 0.0, 0.0, -80.0)
        for targets, told in (([sheet], False), ([ball], False), (hole, True), ([], True)):
            found = kinds(scene(targets=targets, lights=[lamp], **{"camera.sensor.pixel_mm": 0.5}))
            assert (lf.MissedLightWarning in found) == told, (kind, targets)
        short = sheet | {"shape": {"kind": "plane", "width_mm": 8.0, "height_mm": 4.0}}
        assert lf.MissedLightWarning in kinds(scene(targets=[short], lights=[lamp]))


def test_a_tube_that_is_close_to_a_target_with_any_part_is_named() -> None:
    """A long one lights a strip, which more samples meet than the spot of a short one at the same height."""
    given = scene(targets=[WALL], **{"camera.sensor.pixel_mm": 0.5})
    for lamp, told in (
        (sized("line", 0.0, 0.0, -99.999), True),
        (sized("line", 0.0, 0.0, -99.98), False),
        (sized("line", 0.0, 0.0, -80.0, half_mm=19.999, along="z"), True),
        (sized("line", 0.0, 0.0, -80.0, half_mm=5.0, along="z"), False),
        (sized("line", 0.0, 0.0, -99.98, half_mm=0.01), True),
    ):
        assert (lf.HeavyPathsWarning in kinds(given.changed({"lights": [lamp]}))) == told, lamp


@pytest.mark.parametrize("height_mm", [0.02, 0.6])
def test_a_picture_of_a_spot_that_samples_seldom_meet_is_told_doubtful(height_mm: float) -> None:
    """From the height on that the warning names, the stated error holds; far below it, most pictures are too dark.

    Of 40 seeds more than 30 are within twice their error of the truth by the forward law of the spot: all its light
    falls into the field. Below, fewer than 30 are.
    """
    given = lit(0.0, 0.0, -100.0 + height_mm, **{"transport.replicates": 8})
    far = lit(0.0, 0.0, -100.0 + height_mm, **{"transport.samples": 1 << 17, "transport.replicates": 8})
    truth = lf.render(far).mean.sum()
    held = 0
    for image in by_seed(given, range(40)):
        held += abs(image.mean.sum() - truth) < 2.0 * np.sqrt((image.stderr**2).sum())
    warns = lf.HeavyPathsWarning in kinds(given)
    assert warns == (height_mm < 0.1)
    assert (held > 33) != warns
    assert lf.HeavyPathsWarning not in kinds(given.changed({"transport.method": "forward"}))


def beam(half_angle_deg: float, *place: float, to: tuple[float, float, float] = (0.0, 0.0, -100.0)) -> dict[str, Any]:
    way = (np.array(to) - place).tolist()
    return {"kind": "spot", "position_mm": place, "direction": way, "half_angle_deg": half_angle_deg, "power_w": 1.0}


@pytest.mark.parametrize(
    ("lamp", "told"),
    [
        (beam(0.01, 30.0, 0.0, -60.0), True),
        (beam(1e-9, 30.0, 0.0, -60.0), True),
        (beam(8.0, 30.0, 0.0, -60.0), False),
        (beam(0.01, 30.0, 0.0, -60.0, to=(15.0, 0.0, -100.0)), False),
        (beam(0.01, 30.0, 0.0, -60.0, to=(90.0, 0.0, -100.0)), False),
        (beam(0.01, 30.0, 0.0, -120.0), False),
    ],
    ids=["narrow", "without width", "wide", "beside the field", "past the wall", "behind the wall"],
)
def test_a_beam_whose_spot_few_samples_meet_is_named(lamp: dict[str, Any], told: bool) -> None:
    """A picture that misses the spot is black, or lacks this lamp's light among that of others, without an error."""
    given = scene(targets=[WALL], lights=[lamp], **{"camera.sensor.pixel_mm": 0.5})
    named = [str(each) for each in foreseen(lf.build(given)) if isinstance(each, lf.HeavyPathsWarning)]
    assert bool(named) == told
    assert all("lights a spot" in text and "targets[0]" in text for text in named)
    assert lf.HeavyPathsWarning not in kinds(given.changed({"transport.method": "forward"}))


def test_reflections_that_the_sequential_engine_leaves_out_are_named() -> None:
    for split, told in (("both", True), ("transmit", False)):
        given = scene(**{"transport.engine": "sequential", "transport.split": split})
        assert (lf.MissedLightWarning in kinds(given)) == told
