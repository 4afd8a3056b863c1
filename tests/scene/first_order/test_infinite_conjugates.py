"""Infinity is a distance like any other: figures of cameras with far pupils, images and objects, by rays and limits."""

import math
import re
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene import FirstOrder, first_order, solved
from lfmesh.scene.first_order.paraxial import Paraxial
from lfmesh.scene.first_order.solve import image_plane_mm

CAMERAS = 100
"""Random cameras, many of which have their stop, array or object in a focal plane."""

FIGURES = ("object_distance_mm", "magnification", "working_f_number", "micro_image_pitch_px", "near_mm", "far_mm",
           "object_sampling_mm", "microlens_f_number")  # fmt: skip


def microscope(gap_mm: float) -> lf.Scene:
    """The light-field microscope with its stop this far before the tube lens of 180 mm."""
    scene = lf.load(asset_path("scenes/light_field_microscope.toml"))
    return scene.changed({"camera.lens.surfaces[1].thickness_mm": gap_mm})


@pytest.mark.parametrize("gap_mm", [100.0, 150.0, 175.0, 179.99, 180.0, 180.01, 190.0, 250.0])
def test_an_infinity_corrected_objective_has_the_same_focus_wherever_its_tube_lens_stands(gap_mm: float) -> None:
    """Light is parallel between the two lenses: of 10×, at f/20, in focus 18 mm before the objective."""
    facts = first_order(microscope(gap_mm))
    assert facts.object_distance_mm == pytest.approx(18.0, rel=1e-12)
    assert facts.magnification == pytest.approx(-10.0, rel=1e-12)
    assert facts.working_f_number == pytest.approx(20.0, rel=1e-12)
    # Views a pixel apart are 0.25/10 rad apart before the objective: 0.5 mm off, they shift by a lenslet of 12.5 µm.
    assert facts.near_mm == pytest.approx(17.75, rel=1e-12)
    assert facts.far_mm == pytest.approx(18.25, rel=1e-12)
    assert not facts.warnings


def test_figures_beside_an_infinite_one_tend_to_those_where_it_is_infinite() -> None:
    exact = first_order(microscope(180.0))
    assert math.isinf(exact.efl_mm)
    assert math.isinf(exact.exit_pupil_z_mm)
    for step in (1e-2, 1e-5, 1e-8, -1e-8, -1e-5, -1e-2):
        beside = first_order(microscope(180.0 + step))
        for name in FIGURES:
            assert getattr(beside, name) == pytest.approx(getattr(exact, name), rel=1e-3 * abs(step) + 1e-11), name
        assert beside.field.size_mm(-18.2) == pytest.approx(exact.field.size_mm(-18.2), rel=1e-3 * abs(step) + 1e-11)


def drawn(draw: np.random.Generator) -> dict[str, Any]:
    """Draw a camera of thin lenses that like to stand a focal length, or two, apart from stop, array and object."""

    def length(low: float, high: float) -> float:
        value = float(np.exp(draw.uniform(np.log(low), np.log(high))))
        return float(f"{value:.{draw.choice([1, 2, 6])}g}")

    lenses = [length(3.0, 300.0) * draw.choice([1.0, 1.0, -1.0]) for _ in range(draw.integers(1, 4))]
    surfaces: list[dict[str, Any]] = [
        {"paraxial": True, "focal_length_mm": float(f), "semi_diameter_mm": 10.0} for f in lenses
    ]
    surfaces.insert(int(draw.integers(len(surfaces) + 1)), {"stop": True, "semi_diameter_mm": length(0.5, 8.0)})
    for surface in surfaces[:-1]:
        like = abs(float(draw.choice(lenses)))
        surface["thickness_mm"] = float(draw.choice([like, 2.0 * like, length(0.5, 200.0)]))
    camera: dict[str, Any] = {"lens": {"surfaces": surfaces}, "sensor": {"pixels": [60, 60], "pixel_mm": 0.01}}
    camera["focus_mm"] = float(draw.choice([math.inf, abs(lenses[0]), length(5.0, 1e5)]))
    behind = float(draw.choice([abs(lenses[-1]), length(1.0, 300.0)]))
    if draw.random() < 0.8:
        camera["mla"] = {"count": [12, 12], "pitch_mm": 0.1, "focal_length_mm": 2.0, "index": 1.5, "thickness_mm": 0.5}
        camera["mla"]["curved_side"] = str(draw.choice(["lens", "sensor"]))
        camera["mla"]["distance_mm"] = behind
        if draw.random() < 0.2:
            camera["sensor"]["distance_mm"] = length(0.5, 4.0)
    else:
        camera["sensor"]["distance_mm"] = behind
    if draw.random() < 0.2:
        camera["object_medium"] = {"index": 1.33}
    return {"schema_version": 1, "camera": camera}


def shift_mm(scene: lf.Scene, object_mm: float) -> float:
    """Return how far a point of the axis moves on the array from view to view, or blurs on the sensor, by rays.

    Two rays of the point are apart on the stop by what separates rays there that meet the middle lenslet and fall on
    neighbouring pixels; without an array, by the stop's diameter.
    """
    lens = Paraxial.of(scene.camera.lens, scene.primary_nm)
    plane = image_plane_mm(scene.camera, scene.primary_nm)

    def at_stop_and_plane(height: float, angle: float) -> tuple[float, float]:
        stop = math.nan
        for number in range(len(lens.curvatures)):
            stop = height if number == lens.stop else stop
            angle -= lens.thin_powers[number] * height
            if number < len(lens.gaps_mm):
                height += lens.gaps_mm[number] * angle
        return stop, height + plane * angle

    mla, pixel = scene.camera.mla, scene.camera.sensor.pixel_mm
    step = 2.0 * lens_stop_mm(scene)
    if mla is not None:
        # Rays through the middle lenslet, followed back: the image in the stop of a step of one pixel.
        one, other = at_stop_and_plane(1.0, 0.0), at_stop_and_plane(0.0, 1.0)
        on_stop = other[0] * one[1] - one[0] * other[1]
        slope = pixel / to_sensor_mm(scene)
        step = abs(slope * on_stop)
    x = object_mm / lens.indices[0]
    stop, landing = at_stop_and_plane(1.0, 0.0) if math.isinf(x) else at_stop_and_plane(x, 1.0)
    return abs(landing / stop) * step if stop else math.inf


def lens_stop_mm(scene: lf.Scene) -> float:
    lens = scene.camera.lens
    return lens.surfaces[lens.stop_index or 0].semi_diameter_mm or math.nan


def to_sensor_mm(scene: lf.Scene) -> float:
    """Distance from the lenslets to the sensor, as in air: their flat face is seen at t/n."""
    mla, distance = scene.camera.mla, scene.camera.sensor.distance_mm
    assert mla is not None
    assert distance is not None
    return distance + (mla.thickness_mm / 1.5 if mla.curved_side == "lens" else 0.0)


@lru_cache(maxsize=1)
def cameras() -> list[tuple[lf.Scene, FirstOrder]]:
    draw = np.random.default_rng(62)
    found = []
    while len(found) < CAMERAS:
        try:
            scene = solved(lf.Scene.model_validate(drawn(draw)))
        except (lf.LfmeshError, ValueError):
            continue
        found.append((scene, first_order(scene)))
    return found


def test_no_figure_of_a_camera_is_undefined_and_no_range_is_out_of_order() -> None:
    for scene, facts in cameras():
        words = str(facts).replace("focus_mm = inf", "")
        assert not re.search(r"\b(nan|inf)\b", words), words
        for name, value in facts.as_dict().items():
            assert not (isinstance(value, float) and math.isnan(value)), (name, scene.camera)
        assert 0.0 <= facts.near_mm <= facts.far_mm
        for plane, near, far in facts.refocused_mm:
            assert near <= far
            if 0.0 < plane < math.inf and facts.near_mm <= plane <= facts.far_mm:
                assert near <= plane * (1.0 + 1e-9)
                assert far >= plane * (1.0 - 1e-9)


def test_the_range_holds_all_distances_round_the_focus_that_shift_by_a_lenslet_at_most_and_no_others() -> None:
    """By rays from surface to surface; a conventional camera's point blurs over a pixel at most."""
    seen = 0
    for scene, facts in cameras():
        focus = facts.object_distance_mm
        if facts.focused or not focus > 0.0 or facts.working_f_number == 0.0:
            continue
        most = scene.camera.mla.pitch_mm if scene.camera.mla is not None else scene.camera.sensor.pixel_mm
        front = -facts.ffl_mm
        ends = [(facts.near_mm, -1.0), (facts.far_mm, 1.0)]
        for end, way in ends:
            inside = focus if math.isinf(end) else end - way * 1e-6 * end
            if inside > 0.0 and way * (end - focus) > 1e-5 * min(end, focus):
                assert shift_mm(scene, inside) <= most * (1.0 + 1e-9), (scene.camera, end)
                seen += 1
            if math.isinf(end):
                assert shift_mm(scene, math.inf) <= most * (1.0 + 1e-9)
            elif end > 0.0 and not abs(end - front) <= 1e-9 * end:
                assert shift_mm(scene, end) == pytest.approx(most, rel=1e-6), (scene.camera, end)
    assert seen > CAMERAS / 2


def test_every_camera_sees_the_size_of_its_array_on_the_plane_in_focus_and_along_chief_rays_elsewhere() -> None:
    for scene, facts in cameras():
        if facts.focused or not 0.0 < facts.object_distance_mm < 1e6 or facts.working_f_number == 0.0:
            continue
        sizes = scene.camera.sensor.size_mm
        if scene.camera.mla is not None:
            sizes = min(sizes[0], scene.camera.mla.size_mm[0]), min(sizes[1], scene.camera.mla.size_mm[1])
        on_object = tuple(size / abs(facts.magnification) for size in sizes)
        assert facts.field_of_view_mm == pytest.approx(on_object, rel=1e-9)
        # The field is narrowest, a point, in the middle of the entrance pupil; the beam in the plane in focus.
        pupil = facts.entrance_pupil_z_mm
        if math.isfinite(pupil):
            assert max(facts.field.size_mm(pupil)) <= 1e-9 * max(on_object)
            assert facts.field.beam_mm(pupil) == pytest.approx(facts.entrance_pupil_diameter_mm, rel=1e-9)
        assert facts.field.beam_mm(-facts.object_distance_mm) <= 1e-9 * facts.field.beam_mm(0.0) + 1e-12
