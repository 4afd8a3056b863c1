"""Ray aiming at the stop against brute force: the points that light reaches, and the edges that end other rays."""

import math
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.waves.bundle import Bundle, LensRays, pupil_grid
from lfmesh.waves.ray_ends import Edge
from tests.waves.brute_pupil import Prescription, Reached, reached

Array = NDArray[np.float64]

ACROSS, WAVE_NM = 64, 587.6


def scene_of(surfaces: list[dict[str, Any]], focus_mm: float = math.inf) -> lf.Scene:
    sensor = {"pixels": [8, 8], "pixel_mm": 0.01, "distance_mm": 50.0}
    camera = {"focus_mm": focus_mm, "lens": {"surfaces": surfaces}, "sensor": sensor}
    return lf.Scene.model_validate({"schema_version": 1, "camera": camera})


def drawn_surfaces(draw: np.random.Generator) -> list[dict[str, Any]]:
    """Return a singlet, doublet or triplet of spheres with its stop in front, on a surface, inside or behind."""
    scale, elements = float(np.exp(draw.uniform(np.log(20.0), np.log(200.0)))), int(draw.integers(1, 4))
    rim = scale * draw.uniform(0.05, 0.3)

    def radius() -> float:
        bent = draw.choice([-1.0, 1.0]) * scale * np.exp(draw.uniform(np.log(0.35), np.log(5.0)))
        return float(bent) if draw.random() < 0.9 else math.inf

    def surface(thickness: tuple[float, float], **medium: float) -> dict[str, Any]:
        return {
            "radius_mm": radius(),
            "thickness_mm": float(rim * draw.uniform(*thickness)),
            "semi_diameter_mm": float(rim * draw.uniform(0.7, 1.1)),
            **medium,
        }

    surfaces: list[dict[str, Any]] = []
    for _ in range(elements):
        surfaces.append(surface((0.1, 0.8), index=float(draw.uniform(1.45, 1.9))))
        surfaces.append(surface((0.02, 0.5)))
    gap, stop = float(rim * draw.uniform(0.02, 2.0)), float(rim * draw.uniform(0.2, 1.1))
    pure = {"stop": True, "semi_diameter_mm": stop, "thickness_mm": gap}
    where = draw.choice(["before", "on", "inside", "behind"])
    if where == "on":
        surfaces[int(draw.integers(0, len(surfaces)))].update(stop=True, semi_diameter_mm=stop)
    elif where == "before":
        surfaces.insert(0, pure)
    elif where == "inside" and elements > 1:
        surfaces.insert(2 * int(draw.integers(1, elements)), pure)
    else:
        surfaces[-1]["thickness_mm"] = gap
        surfaces.append(pure)
    del surfaces[-1]["thickness_mm"]
    return surfaces


def drawn_lens(seed: int) -> tuple[LensRays, Prescription]:
    """Return a random lens and object point, from just beyond the focal length to infinity, on and off the axis."""
    draw = np.random.default_rng(seed)
    while True:
        surfaces = drawn_surfaces(draw)
        try:
            scene = lf.solved(scene_of(surfaces))
            facts = lf.first_order(scene)
            world = lf.build(scene.camera_alone())
        except (lf.LfmeshError, ValidationError):
            continue
        if 5.0 < abs(facts.efl_mm) < 2000.0:
            break
    near = 1.02 * abs(facts.efl_mm) * float(np.exp(draw.uniform(0.0, np.log(50.0))))
    object_mm = math.inf if draw.random() < 0.25 else near
    slope = float(draw.uniform(0.0, 0.6)) if draw.random() < 0.8 else 0.0
    return LensRays(world, object_mm, 100.0), Prescription(surfaces, object_mm, slope)


class Compared(NamedTuple):
    """A pupil against brute force: its points that differ, what refuses it, and the findings of brute force."""

    wrong: int
    refused: str
    found: Reached


def compared(seed: int) -> Compared:
    rays, truth = drawn_lens(seed)
    found = reached(truth, ACROSS)
    try:
        bundle = rays.bundle(truth.slope, pupil_grid(ACROSS), WAVE_NM)
    except lf.LfmeshError as error:
        return Compared(0, str(error), found)
    return Compared(int((bundle.passes != (found.rays > 0)).sum()), "", found)


@pytest.mark.parametrize("seed", [*range(6), 75, 262, 280, 397])
def test_light_passes_the_points_of_the_stop_that_brute_force_finds(seed: int) -> None:
    """Not one of the 3,228 points differs, so shares agree to less than 1e-4.

    In lens 75 total reflection ends rays, in 280 a caustic, and in 397 one just beyond the aperture; in 262 rays graze
    the end of a sphere.
    """
    wrong, refused, found = compared(seed)
    assert refused == ""
    assert found.undecided == 0
    assert not found.folded
    assert wrong == 0


def test_a_pupil_is_refused_where_rays_that_have_crossed_come_beyond_a_caustic() -> None:
    """In lens 101 nearly all light comes to the stop from the other side of the axis."""
    _, refused, found = compared(101)
    assert found.folded
    assert (found.rays > 0).any()
    assert "rays of this field cross before the stop" in refused


@pytest.mark.parametrize(("behind_mm", "crosses"), [(20.0, False), (95.0, True)])
def test_waves_are_refused_where_rays_cross_before_the_stop(behind_mm: float, crosses: bool) -> None:
    """A biconvex lens of f = 100 mm: near its focus the rays of its rim have crossed those of its middle."""
    front = {"radius_mm": 100.0, "thickness_mm": 8.0, "index": 1.5, "semi_diameter_mm": 25.0}
    back = {"radius_mm": -100.0, "thickness_mm": behind_mm, "semi_diameter_mm": 25.0}
    scene = scene_of([front, back, {"stop": True, "semi_diameter_mm": 6.0}])
    if crosses:
        with pytest.raises(lf.LfmeshError, match=r"rays of this field cross before the stop \(.* % of the rays"):
            lf.wavefront(scene, object_mm=math.inf, image_z_mm=107.0)
    else:
        assert lf.wavefront(scene, object_mm=math.inf, image_z_mm=107.0).passed == 1.0


@pytest.mark.parametrize("height_mm", [0.7, 1e-6])
def test_spots_are_refused_where_light_comes_back_into_the_stop(height_mm: float) -> None:
    """A steep plano-convex lens: the rays of its rim cross the axis and come back into a small stop behind the focus.

    No point of the stop is without a ray then; half of the light is that of the rim.
    """
    front = {"radius_mm": 10.0, "thickness_mm": 6.0, "index": 1.8, "semi_diameter_mm": 8.5}
    stop = {"stop": True, "semi_diameter_mm": 1.2}
    scene = scene_of([front, {"thickness_mm": 5.0, "semi_diameter_mm": 9.0}, stop])
    with pytest.raises(lf.LfmeshError, match="rays of this field cross before the stop"):
        lf.analyse(scene, object_mm=math.inf, height_mm=height_mm)


@pytest.mark.long
def test_a_thousand_random_pupils_are_those_of_brute_force() -> None:
    results = [compared(seed) for seed in range(1000)]
    assert sum(each.found.undecided for each in results) == 0
    assert [seed for seed, each in enumerate(results) if each.wrong] == []
    refused = [each for each in results if each.refused]
    assert all("cross before the stop" in each.refused and each.found.folded for each in refused)
    assert len(refused) < 50


def library(name: str, focus_mm: float, **lens: Any) -> lf.Scene:
    camera = {
        "focus_mm": focus_mm,
        "lens": {"file": f"lib:{name}", **lens},
        "sensor": {"pixels": [8, 8], "pixel_mm": 0.01},
    }
    scene = lf.Scene.model_validate({"schema_version": 1, "camera": camera})
    return lf.solved(scene.in_folder(asset_path("scenes")))


def relay() -> lf.Scene:
    """Two equal hyperboloids, stop on the first, from a point 50 mm before it: no aberration on the axis."""
    front = {
        "radius_mm": 25.0,
        "conic": -2.25,
        "thickness_mm": 14.0,
        "index": 1.5,
        "semi_diameter_mm": 15.0,
        "stop": True,
    }
    return scene_of([front, {"radius_mm": -25.0, "conic": -2.25, "semi_diameter_mm": 20.0}], 50.0)


@pytest.mark.parametrize(
    "scene",
    [relay(), library("plano_convex_25mm", 100.0), library("asphere_100mm", 150.0)],
    ids=["relay", "plano-convex", "asphere"],
)
def test_no_ray_of_a_near_object_is_lost_where_the_stop_is_the_first_surface(scene: lf.Scene) -> None:
    """The paraxial ray to the rim of the stop misses it; the real ones all come there."""
    assert lf.wavefront(scene).passed == 1.0


def bundle_of(scene: lf.Scene, slope: float, pupil: Array) -> Bundle:
    facts = lf.first_order(scene)
    return LensRays(lf.build(scene), facts.object_distance_mm, facts.image_z_mm).bundle(slope, pupil, WAVE_NM)


@pytest.mark.parametrize("slope", [0.0, 0.1, 0.2, 0.3, 0.4])
def test_the_rays_of_a_pupil_do_not_depend_on_which_others_are_sought(slope: float) -> None:
    """A double Gauss: one by one, in a grid, and after other fields."""
    scene, pupil = library("double_gauss_50mm", 500.0), pupil_grid(16)
    whole = bundle_of(scene, slope, pupil)
    few = bundle_of(scene, slope, pupil[::9])
    np.testing.assert_array_equal(few.passes, whole.passes[::9])
    np.testing.assert_allclose(few.entry, whole.entry[::9], atol=1e-9)
    np.testing.assert_array_equal(few.ends.edge, whole.ends.edge[::9])


def test_every_edge_that_ends_rays_has_its_name() -> None:
    """A strong ball lens, its stop behind it: rays of 80 % of the stop never existed, they would miss the ball."""
    ball = [
        {"radius_mm": 5.0, "thickness_mm": 10.0, "index": 1.5, "semi_diameter_mm": 4.0},
        {"radius_mm": -5.0, "thickness_mm": 1.0, "semi_diameter_mm": 3.0},
        {"stop": True, "semi_diameter_mm": 2.8},
    ]
    scene = scene_of(ball)
    aim = LensRays(lf.build(scene), lf.first_order(scene).object_distance_mm, 50.0).aim
    ends = aim.through(np.array([0.0, 0.3]), aim.stop_radius * pupil_grid(24), WAVE_NM).ends
    assert Edge.UNKNOWN not in ends.edge
    assert set(ends.edge) - {Edge.NONE} != set()
    assert all("surfaces[" in line or "caustic" in line for line in ends.words())


@pytest.mark.parametrize("tilt_deg", [(-2.2, 0.0, 0.0), (8.0, 0.0, 0.0), (0.0, 2.2, 0.0)])
@pytest.mark.parametrize("slope", [0.0, 0.19])
def test_tilted_lenses_behind_the_stop_lose_no_ray(tilt_deg: tuple[float, float, float], slope: float) -> None:
    """The lens is wide enough for all rays: the first face, turned, stands out before its vertex and its rim."""
    surfaces: list[dict[str, Any]] = [
        {"stop": True, "semi_diameter_mm": 2.08, "thickness_mm": 2.66},
        {"radius_mm": 33.8, "semi_diameter_mm": 5.62, "index": 1.6, "thickness_mm": 7.0},
        {"radius_mm": -55.45, "semi_diameter_mm": 5.55},
    ]
    scene = scene_of(surfaces).changed(
        {"camera.lens.elements": [{"surfaces": [1, 2], "pose": {"tilt_deg": list(tilt_deg)}}]}
    )
    assert lf.wavefront(scene, slope, object_mm=math.inf, across=24).passed == 1.0


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3, 1e6])
@pytest.mark.parametrize("air", [0.0, 1e-15])
def test_rays_pass_faces_that_touch_at_their_vertices(scale: float, air: float) -> None:
    """The chief ray of the axis starts at the next face: rounding says on which side of it."""
    radius, rim = 20.0 * scale, 10.0 * scale
    thickness = 4.0 * (radius - math.sqrt(radius**2 - rim**2))
    faces = [
        {"radius_mm": radius, "thickness_mm": thickness, "index": 1.5, "semi_diameter_mm": rim},
        {"radius_mm": -radius, "thickness_mm": air * scale, "semi_diameter_mm": rim},
    ]
    last = {key: value for key, value in faces[1].items() if key != "thickness_mm"}
    scene = scene_of([{**faces[0], "stop": True}, faces[1], faces[0], last], focus_mm=500.0 * scale)
    found = lf.wavefront(scene.changed({"camera.sensor.distance_mm": scale}), object_mm=500.0 * scale, across=24)
    assert found.passed == 1.0
