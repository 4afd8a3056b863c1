"""Focused plenoptic cameras: the plane in focus, depth range, covering and resolution that first-order optics gives."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.geometry.array.lattice import Lattice
from lfmesh.geometry.array.lenslets import lenslets, type_of
from lfmesh.lightfield.calibration.calibration import calibrate
from lfmesh.lightfield.rays.ray_model import RayModel
from lfmesh.lightfield.views.focused import lenslet_blur_px
from lfmesh.scene.first_order.focused import COVERING
from lfmesh.scene.first_order.report import STANDARD

Array = NDArray[np.float64]

RANDOM, IN_SUITE = 20, 1
"""Random cameras that are rendered, and those of them in the suite."""

PLANES, REACH, SAMPLES, FINER = 5, 0.8, 1, 8


def standard(draw: np.random.Generator) -> lf.Scene:
    """Draw a standard plenoptic camera: lens, focus, f-number, array and pixels."""
    f_number, pitch, pixels = draw.uniform(11.0, 18.0), draw.uniform(0.08, 0.2), int(draw.integers(11, 17))
    focal, count = draw.uniform(30.0, 100.0), 6
    focus = focal * draw.uniform(8.0, 20.0)
    thin = {"paraxial": True, "focal_length_mm": focal, "semi_diameter_mm": 12.0}
    return lf.Scene.model_validate(
        {
            "schema_version": 1,
            "camera": {
                "focus_mm": focus,
                "lens": {"surfaces": [thin], "f_number": f_number},
                "mla": {
                    "layout": str(draw.choice(["square", "hexagonal"])),
                    "count": [count, count],
                    "pitch_mm": pitch,
                    "focal_length_mm": 0.75 * f_number * pitch,
                    "index": 1.5,
                    "thickness_mm": 0.1,
                    "conic": -1.0 / 1.5**2,
                },
                "sensor": {"pixels": [count * pixels] * 2, "pixel_mm": pitch / pixels},
            },
            "transport": {"samples": SAMPLES, "replicates": 2, "split": "transmit", "threads": 1},
        }
    )


def focused(number: int) -> lf.Scene:
    """Draw a focused plenoptic camera by its number."""
    draw = np.random.default_rng(number)
    return lf.focused(standard(draw), draw.uniform(2.2, 4.5), "keplerian" if number % 2 else "galilean")


def spread_px2(scene: lf.Scene, distance_mm: float) -> float:
    """Return the mean square distance of a point's light in a micro-image from its middle there, in pixels²."""
    facts = lf.first_order(scene)
    point = {
        "shape": {"kind": "disk", "radius_mm": 0.1 * facts.object_sampling_mm},
        "position_mm": (0.0, 0.0, -distance_mm),
        "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
    }
    sensor = {
        "camera.sensor.pixels": tuple(FINER * n for n in scene.camera.sensor.pixels),
        "camera.sensor.pixel_mm": scene.camera.sensor.pixel_mm / FINER,
    }
    fine = scene.changed({"targets": [point], "transport.method": "forward", **sensor})
    image, centres = lf.render(fine), calibrate(fine).centres_px.reshape(-1, 2)
    y, x = np.nonzero(image.mean[..., 0])
    of, power = cKDTree(centres).query(np.column_stack([x, y]))[1], image.mean[y, x, 0]
    # Light that passes beside the array or between its rows lands far from the spots.
    brightest = np.zeros((len(centres), 2))
    order = np.argsort(power)
    brightest[of[order]] = np.column_stack([x, y])[order]
    inside = np.hypot(x - brightest[of, 0], y - brightest[of, 1]) < 1.5 * FINER
    y, x, of, power = y[inside], x[inside], of[inside], power[inside]
    lit = np.bincount(of, power, len(centres))
    squares = 0.0
    for place in (x, y):
        middle = np.bincount(of, power * place, len(centres)) / np.where(lit > 0.0, lit, 1.0)
        squares += float((power * (place - middle[of]) ** 2).sum())
    return squares / float(power.sum()) / FINER**2


def object_mm(facts: lf.FirstOrder, virtual_depth: float) -> float:
    """Return the object distance whose image lies at a virtual depth before the lenslets, by Newton's x x' = f²."""
    said = facts.focused[0]
    image_z = facts.lenslets_z_mm - virtual_depth * said.main_image_mm / said.virtual_depth
    rear_focus = facts.rear_principal_plane_z_mm + facts.efl_mm
    return facts.efl_mm**2 / (image_z - rear_focus) - facts.ffl_mm


def sharpest_mm(scene: lf.Scene) -> float:
    """Return the distance at which a point is sharpest in the raw image: the lowest point of a curve over 1/v."""
    facts = lf.first_order(scene)
    step = scene.camera.sensor.pixel_mm / scene.camera.mla.pitch_mm
    away = REACH * np.linspace(-1.0, 1.0, PLANES)
    inverse = 1.0 / facts.focused[0].virtual_depth + step * away
    curve = [spread_px2(scene, object_mm(facts, 1.0 / at)) for at in inverse]
    # Of third order, since more lenslets see a point, and some only in part, at one end than at the other.
    lowest = min((top for top in np.roots(np.polyder(np.polyfit(away, curve, 3))) if np.isreal(top)), key=abs)
    return object_mm(facts, 1.0 / (1.0 / facts.focused[0].virtual_depth + step * float(np.real(lowest))))


def close(number: int) -> None:
    scene = focused(number)
    said = lf.first_order(scene).focused[0].in_focus_mm
    assert sharpest_mm(scene) == pytest.approx(said, rel=0.02)


@pytest.mark.filterwarnings("ignore::lfmesh.errors.DiffractionWarning")
@pytest.mark.parametrize("number", range(IN_SUITE))
def test_the_plane_in_focus_is_the_sharpest_one_of_rendered_pictures(number: int) -> None:
    close(number)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::lfmesh.errors.DiffractionWarning")
@pytest.mark.parametrize("number", range(IN_SUITE, RANDOM))
def test_the_plane_in_focus_is_the_sharpest_one_of_many_cameras(number: int) -> None:
    close(number)


@pytest.mark.parametrize("number", range(6))
def test_a_camera_made_focused_is_in_focus_where_the_standard_one_was(number: int) -> None:
    scene = standard(np.random.default_rng(number))
    was, now = lf.first_order(scene), lf.first_order(focused(number))
    assert was.kind == STANDARD
    assert not was.focused
    assert now.kind == ("focused plenoptic, Keplerian" if number % 2 else "focused plenoptic, Galilean")
    assert now.object_distance_mm == pytest.approx(scene.camera.focus_mm, rel=1e-9)
    assert now.focused[0].in_focus_mm == now.object_distance_mm
    # Georgiev and Lumsdaine: a lenslet samples the main image |v| times more coarsely than a pixel.
    pixel, depth = scene.camera.sensor.pixel_mm, abs(now.focused[0].virtual_depth)
    assert now.object_sampling_mm == pytest.approx(pixel * depth / abs(now.magnification), rel=1e-9)
    assert now.view_spacing_mm is None


@pytest.mark.parametrize("number", range(6))
def test_the_depth_range_ends_where_lenslets_blur_by_a_pixel(number: int) -> None:
    scene = focused(number)
    said, model = lf.first_order(scene).focused[0], RayModel.of(scene).paraxial
    for distance in (said.near_mm, said.far_mm):
        if math.isfinite(distance):
            assert lenslet_blur_px(scene, model.image_excess_mm(distance))[0] == pytest.approx(1.0, rel=1e-6)
    assert lenslet_blur_px(scene, model.image_excess_mm(said.in_focus_mm))[0] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("layout", "types"), list(COVERING))
def test_every_point_is_as_near_to_a_lenslet_of_each_type_as_is_said(layout: str, types: int) -> None:
    """Against the distances of a grid of points from all lenslets of a type: none farther, and one as far."""
    lattice = Lattice(layout == "hexagonal", 1.0, 18, 18)
    array = lenslets(lattice, np.full(types, 5.0), 1.0)
    kinds = np.array([[type_of(array, c, r) for c in range(18)] for r in range(18)])
    side = np.linspace(-3.0, 3.0, 241)
    points = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    for kind in range(types):
        farthest = cKDTree(lattice.centres()[kinds == kind]).query(points)[0].max()
        assert COVERING[layout, types] - 0.02 < farthest <= COVERING[layout, types] + 1e-9


def test_covering_and_views_are_those_of_the_cone_from_the_pupil() -> None:
    """A point a before the lenslets lights P a / (D − a) of them, for a pupil P wide and D away; all by that.

    Far from the pupil, three hexagonal types with matched f-numbers cover all from a virtual depth of 2 on (Perwass and
    Wietzke).
    """
    base = standard(np.random.default_rng(1)).changed({"camera.mla.layout": "hexagonal"})
    scene = lf.focused(base, [3.0, 4.0, 5.0])
    facts, pitch = lf.first_order(scene), scene.camera.mla.pitch_mm
    away = facts.lenslets_z_mm - facts.exit_pupil_z_mm
    for at in facts.focused:
        wide = facts.exit_pupil_diameter_mm * at.main_image_mm / (away - at.main_image_mm)
        assert at.seen_by == pytest.approx(math.pi / 4.0 * (wide / pitch) ** 2 / math.sqrt(0.75) / 3.0, rel=1e-9)
        a = at.covering_depth * at.to_sensor_mm
        assert facts.exit_pupil_diameter_mm * a / (away - a) == pytest.approx(2.0 * pitch, rel=1e-9)
        matched = at.covering_depth * facts.exit_pupil_diameter_mm / away * at.to_sensor_mm / pitch
        assert matched == pytest.approx(2.0, rel=0.1)
    assert facts.object_distance_mm == pytest.approx(sorted(at.in_focus_mm for at in facts.focused)[1])
    assert facts.near_mm == min(at.near_mm for at in facts.focused)


def thin_camera(reduction: float | tuple[float, ...], kind: str = "keplerian") -> lf.Scene:
    """A focused camera from a lens of 50 mm at f/4, in focus at 500 mm, with 10 pixels a lenslet."""
    base = lf.load(asset_path("scenes/emitting_plane.toml"))
    thin = {"paraxial": True, "focal_length_mm": 50.0, "semi_diameter_mm": 20.0, "stop": True}
    lens = {"surfaces": [thin], "stop_semi_diameter_mm": 6.25}
    return lf.focused(base.changed({"camera.lens": lens}), reduction, kind)  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", ["keplerian", "galilean"])
@pytest.mark.parametrize("reduction", [1.5, 3.0, 5.0, 9.0, 9.2, 9.5, 9.9])
def test_the_plane_in_focus_lies_within_the_depth_range_by_the_thin_lens_formula(reduction: float, kind: str) -> None:
    """1/a ± a pixel of blur, imaged by 1/z = 1/f − 1/z'; past infinity the range ends there."""
    scene = thin_camera(reduction, kind)
    said, mla = lf.first_order(scene).focused[0], scene.camera.mla
    step = scene.camera.sensor.pixel_mm / mla.pitch_mm / said.to_sensor_mm
    ends = []
    for shift in (step, -step):
        image = mla.distance_mm - 1.0 / (1.0 / said.main_image_mm + shift)
        ends.append(1.0 / (1.0 / 50.0 - 1.0 / image) if image > 50.0 else math.inf)
    assert (said.near_mm, said.far_mm) == pytest.approx(tuple(ends), rel=1e-9)
    assert said.near_mm < said.in_focus_mm < said.far_mm
    assert not [text for text in lf.first_order(scene).warnings if "out of the range" in text]


def test_a_multi_focus_array_with_a_type_for_far_objects_is_focused() -> None:
    facts = lf.first_order(thin_camera((2.0, 8.0, 20.0)))
    assert facts.kind == "focused plenoptic, Keplerian"
    assert facts.object_distance_mm == pytest.approx(500.0, rel=1e-9)
    assert max(at.far_mm for at in facts.focused) == math.inf


def test_reductions_that_make_a_standard_camera_are_refused() -> None:
    with pytest.raises(lf.LfmeshError, match="must be below 10, the pixels per lenslet"):
        thin_camera(12.0)


def test_a_sensor_a_little_off_the_focal_plane_leaves_a_camera_a_standard_one() -> None:
    scene = lf.solved(standard(np.random.default_rng(3)))
    # A pixel of blur over the pitch, of the focal length R / (n - 1).
    pixel = scene.camera.sensor.pixel_mm / scene.camera.mla.pitch_mm * scene.camera.mla.radius_mm[0] / 0.5
    for share, is_focused in ((0.8, False), (1.2, True)):
        distance = scene.camera.sensor.distance_mm + share * pixel
        moved = scene.changed({"camera.sensor.distance_mm": distance, "camera.focus_mm": None})
        assert bool(lf.first_order(moved).focused) is is_focused


def test_what_is_advised_for_a_focused_camera_focuses_it() -> None:
    scene = focused(1)
    asked = scene.changed({"camera.focus_mm": 700.0})
    advice = next(text for text in lf.first_order(asked).warnings if "focus_mm" in text)
    distance = float(advice.rsplit("=", 1)[1])
    moved = asked.changed({"camera.mla.distance_mm": distance})
    facts: Any = lf.first_order(moved)
    assert facts.object_distance_mm == pytest.approx(700.0, rel=1e-4)
    assert not [text for text in facts.warnings if "focus_mm" in text]


def test_a_focused_camera_is_not_made_focused_again() -> None:
    with pytest.raises(lf.LfmeshError, match="already a focused plenoptic one"):
        lf.focused(focused(0))
