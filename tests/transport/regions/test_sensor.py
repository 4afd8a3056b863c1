"""A sensor that reflects: light goes to and fro before it as between the plates of textbooks, and none is lost."""

import numpy as np
import pytest

import lfmesh as lf
from tests.cameras import close_up_camera

INDEX, REFLECTANCE = 1.5, 0.3
PLATE = {
    "surfaces": [
        {"stop": True, "thickness_mm": 1.0, "semi_diameter_mm": 5.0},
        {"radius_mm": np.inf, "thickness_mm": 3.0, "index": INDEX, "semi_diameter_mm": 6.0},
        {"radius_mm": np.inf, "semi_diameter_mm": 6.0},
    ]
}
CUTOFF = 1e-9


def behind_plate(**transport):
    """A plane plate before a sensor."""
    sensor = {"pixels": (20, 20), "pixel_mm": 0.2, "distance_mm": 4.0, "reflectance": REFLECTANCE}
    return lf.Scene(camera={"lens": PLATE, "sensor": sensor}, transport=transport)


def axial(world, **settings):
    return lf.trace(world, [[0.1, 0.2, -5.0]], [[0.0, 0.0, 1.0]], weight_cutoff=CUTOFF, **settings)


@pytest.mark.parametrize("engine", ["mesh", "auto"])
def test_light_between_plate_and_sensor_is_a_geometric_series(engine):
    """Of incoherent light a plate passes (1 − r)/(1 + r), and so many times again what the gap sends back."""
    paths = axial(lf.build(behind_plate(engine=engine)))
    r = ((INDEX - 1.0) / (INDEX + 1.0)) ** 2
    plate = 2.0 * r / (1.0 + r)
    detected = (1.0 - plate) * (1.0 - REFLECTANCE) / (1.0 - REFLECTANCE * plate)
    on_sensor = paths.status == lf.Status.SENSOR
    assert paths.weight[on_sensor].sum() == pytest.approx(detected, abs=1e3 * CUTOFF)
    escaped = plate + (1.0 - plate) ** 2 * REFLECTANCE / (1.0 - REFLECTANCE * plate)
    assert paths.weight[paths.status == lf.Status.ESCAPED].sum() == pytest.approx(escaped, abs=1e3 * CUTOFF)
    assert abs(paths.ledger.imbalance) < 1e-12


@pytest.mark.parametrize("engine", ["mesh", "sequential"])
def test_refracted_rays_alone_leave_what_the_sensor_detects(engine):
    paths = axial(lf.build(behind_plate()), split="transmit", engine=engine)
    r = ((INDEX - 1.0) / (INDEX + 1.0)) ** 2
    assert paths.status.tolist() == [lf.Status.SENSOR]
    assert paths.weight[0] == pytest.approx((1.0 - r) ** 2 * (1.0 - REFLECTANCE), rel=1e-12)
    assert paths.events.tolist() == [3]
    lost = 2.0 * r - r * r + (1.0 - r) ** 2 * REFLECTANCE
    assert paths.ledger.absorbed["reflections not followed"] == pytest.approx(lost, rel=1e-12)


def test_a_mirror_sends_a_ray_back_by_the_law_of_reflection():
    """Off a tilted sensor, and recorded at its vertex."""
    scene = behind_plate().changed({"camera.sensor.pose": {"tilt_deg": (0.0, 4.0, 0.0)}, "camera.lens": PLATE})
    paths = lf.trace(lf.build(scene), [[0.0, 0.0, 6.0]], [[0.02, 0.01, 1.0]], record=True, weight_cutoff=0.05)
    arrived = np.array([0.02, 0.01, 1.0]) / np.linalg.norm([0.02, 0.01, 1.0])
    normal = np.array([np.sin(np.radians(4.0)), 0.0, np.cos(np.radians(4.0))])
    expected = arrived - 2.0 * (arrived @ normal) * normal
    away = paths.direction[paths.status != lf.Status.SENSOR]
    assert min(np.linalg.norm(away - expected, axis=1)) < 1e-12


@pytest.mark.parametrize("method", ["forward", "adjoint"])
@pytest.mark.parametrize("split", ["transmit", "both", "roulette"])
def test_energy_closes(method, split):
    camera = close_up_camera()
    camera["sensor"] |= {"reflectance": REFLECTANCE}
    plane = {"shape": {"kind": "plane", "width_mm": 6.0, "height_mm": 5.0}, "position_mm": [0, 0, -60.0],
             "material": {"radiance_w_m2_sr": 1.0}}  # fmt: skip
    transport = {"samples": 16, "method": method, "split": split, "engine": "auto" if split == "transmit" else "mesh"}
    image = lf.render(lf.Scene(camera=camera, targets=[plane], transport=transport))
    assert abs(image.ledger.imbalance) < 1e-12
    assert image.mean.sum() > 0.0


def test_without_reflections_pixels_are_darker_by_the_share_that_they_reflect():
    """To the last digit but rounding: the same paths."""
    plane = {"shape": {"kind": "plane", "width_mm": 6.0, "height_mm": 5.0}, "position_mm": [0, 0, -60.0],
             "material": {"radiance_w_m2_sr": 1.0}}  # fmt: skip
    scene = lf.Scene(camera=close_up_camera(), targets=[plane], transport={"samples": 8, "split": "transmit"})
    mirror = scene.changed({"camera.sensor.reflectance": REFLECTANCE})
    np.testing.assert_allclose(lf.render(mirror).mean, (1.0 - REFLECTANCE) * lf.render(scene).mean, rtol=1e-12)
