"""Chief rays: from the middle of the stop, through the apex, to the pixel where a trace of the whole camera ends."""

from collections.abc import Callable

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.geometry import frame
from lfmesh.lightfield.rays.chief_rays import chief_rays
from lfmesh.scene import Scene
from tests.frames import motion

BUILT_BADLY = {
    "camera.mla.pose": {"shift_mm": [0.03, -0.02, 0.01], "tilt_deg": [0.6, -0.4, 1.0]},
    "camera.sensor.pose": {"shift_mm": [-0.02, 0.01, 0.02], "tilt_deg": [-0.3, 0.2, 0.5]},
    "camera.mla.form": {"pitch_error": 0.002, "decenter_mm": 0.002, "radius_error": 0.01, "seed": 3},
    "camera.pose": {"shift_mm": [40.0, 30.0, -20.0], "tilt_deg": [10.0, 20.0, 30.0]},
}

PRISM = {"kind": "xy", "coefficients_rad": [[1, 0, 30.0], [0, 1, -20.0], [2, 0, -8.0]], "radius_mm": 0.0625}
"""A phase that deflects the rays through the apexes."""


@pytest.mark.parametrize("phase", [None, PRISM], ids=["glass", "phase"])
@pytest.mark.parametrize("curved_side", ["lens", "sensor"])
@pytest.mark.parametrize("layout", ["square", "hexagonal"])
def test_the_whole_camera_traced_ends_where_the_chief_ray_lands(
    camera: Callable[..., Scene], layout: str, curved_side: str, phase: dict[str, object] | None
) -> None:
    """Every installation and form error at once; `lf.trace` meets the array cell by cell and shares no formula."""
    scene = camera(layout, curved_side).changed(BUILT_BADLY | {"camera.mla.curved_phase": phase})
    rays = chief_rays(scene)
    assert rays.traced.all()
    world = lf.build(scene)
    to_world = frame.frame(scene.camera.pose.tilt_deg, scene.camera.pose.shift_mm)
    # In the air before the array, which is as close as a ray may start.
    start = frame.points(to_world, (rays.entry - 2.0 * rays.direction).reshape(-1, 3))
    direction = frame.directions(to_world, rays.direction.reshape(-1, 3))
    paths = lf.trace(world, start, direction, split="transmit")
    assert (paths.status == lf.Status.SENSOR).all()
    landed = frame.points(motion(world, "world", "sensor"), paths.position)[:, :2]
    np.testing.assert_allclose(landed, rays.landing.reshape(-1, 2)[paths.source], rtol=0, atol=1e-12)


def test_chief_rays_pass_the_middle_of_the_stop(camera: Callable[..., Scene]) -> None:
    """Traced backwards, they get through a stop that is 1e-9 mm wide."""
    scene = camera().changed(BUILT_BADLY).changed({"camera.pose": {}})
    rays = chief_rays(scene)
    stop = scene.camera.lens.stop_index
    pinhole = lf.build(scene.changed({f"camera.lens.surfaces[{stop}].semi_diameter_mm": 5e-10}))
    start, direction = (rays.entry - rays.direction).reshape(-1, 3), -rays.direction.reshape(-1, 3)
    paths = lf.trace(pinhole, start, direction, split="transmit")
    assert (paths.status == lf.Status.ESCAPED).all()
    beside = np.add(start, [1e-8, 0.0, 0.0])
    assert not (lf.trace(pinhole, beside, direction, split="transmit").status == lf.Status.ESCAPED).any()


def test_where_the_stop_is_a_surface_of_glass_the_rays_start_at_its_vertex(camera: Callable[..., Scene]) -> None:
    lens = {
        "surfaces": [
            {"radius_mm": 40.0, "thickness_mm": 4.0, "index": 1.5, "semi_diameter_mm": 6.0, "stop": True},
            {"radius_mm": -60.0, "semi_diameter_mm": 8.0},
        ]
    }
    scene = lf.solved(camera().changed({"camera.lens": lens, "camera.mla.distance_mm": None}))
    rays = chief_rays(scene)
    assert rays.traced.all()
    backwards = lf.trace(
        lf.build(scene),
        (rays.entry - rays.direction).reshape(-1, 3),
        -rays.direction.reshape(-1, 3),
        split="transmit",
        record=True,
    )
    vertices = [next(v for v in backwards.vertices(i) if v.surface == "lens surface 0") for i in range(len(backwards))]
    np.testing.assert_allclose([v.position for v in vertices], 0.0, atol=1e-9)


@pytest.mark.parametrize("stop", [0, 1], ids=["before the glass", "behind the glass"])
def test_beside_gradient_glass_chief_rays_pass_the_middle_of_the_stop(camera: Callable[..., Scene], stop: int) -> None:
    """They start in the glass, a little behind the stop along a straight line, or in the air behind it."""
    gradient = {"kind": "radial_n2", "index": 1.5, "coefficients": [-0.001]}
    surfaces = [
        {"radius_mm": 40.0, "thickness_mm": 4.0, "gradient": gradient, "semi_diameter_mm": 8.0},
        {"radius_mm": -60.0, "semi_diameter_mm": 8.0},
    ]
    surfaces[stop] |= {"stop": True, "semi_diameter_mm": 6.0}
    scene = lf.solved(camera().changed({"camera.lens": {"surfaces": surfaces}, "camera.mla.distance_mm": None}))
    rays = chief_rays(scene)
    assert rays.traced.all()
    start, direction = (rays.entry - rays.direction).reshape(-1, 3), -rays.direction.reshape(-1, 3)
    backwards = lf.trace(lf.build(scene), start, direction, split="transmit", record=True)
    name = f"lens surface {stop}"
    vertices = [next(v for v in backwards.vertices(i) if v.surface == name) for i in range(len(backwards))]
    np.testing.assert_allclose([v.position for v in vertices], [[0.0, 0.0, 4.0 * stop]] * len(vertices), atol=1e-8)


def test_a_lenslet_beyond_the_lens_reach_has_no_chief_ray(camera: Callable[..., Scene]) -> None:
    """The mount of the rear element hides the corners of a large array from the middle of the stop."""
    scene = camera(columns=500, rows=2)
    traced = chief_rays(scene).traced
    assert traced[:, 240:260].all()
    assert not traced[:, [0, -1]].any()


def test_arrays_with_a_phase_on_the_flat_face_have_no_chief_rays(camera: Callable[..., Scene]) -> None:
    with pytest.raises(lf.LfmeshError, match=r"camera\.mla\.flat_phase"):
        chief_rays(camera().changed({"camera.mla.flat_phase": PRISM}))


def test_a_conventional_camera_has_no_chief_rays_of_lenslets(camera: Callable[..., Scene]) -> None:
    scene = camera().changed({"camera.mla": None})
    with pytest.raises(lf.LfmeshError, match=r"camera\.mla is missing"):
        chief_rays(scene)
