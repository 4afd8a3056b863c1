"""Glass that is known only as a mesh: curved facets against the exact surfaces, bodies against closed forms."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

import lfmesh as lf
from lfmesh.scene import Camera, Lens, Scene, Sensor, Target, Transport

ASSETS = Path(__file__).parents[2] / "assets"


def landing(world, field_deg: float, surface: str | None = None) -> np.ndarray:
    """Where a bundle through the entrance pupil lands on the sensor, (n, 3) mm."""
    draw = np.random.default_rng(1)
    report = world.first_order
    field = np.deg2rad(field_deg)
    r = 0.48 * report.entrance_pupil_diameter_mm * np.sqrt(draw.uniform(size=4000))
    phi = draw.uniform(0.0, 2.0 * np.pi, 4000)
    pupil = np.column_stack([r * np.cos(phi), r * np.sin(phi), np.full(4000, report.entrance_pupil_z_mm)])
    d = np.tile([0.0, np.sin(field), np.cos(field)], (4000, 1))
    paths = lf.trace(world, pupil - 100.0 * d, d, 550.0, split="transmit", surface=surface)
    on_sensor = paths.status == lf.Status.SENSOR
    assert on_sensor.mean() > 0.95
    where = np.full((4000, 3), np.nan)
    where[paths.source[on_sensor]] = paths.position[on_sensor]
    return where


def rms(a: np.ndarray, b: np.ndarray) -> float:
    """Root mean square distance of the rays that both have, mm."""
    return float(np.sqrt(np.nanmean(np.square(a - b).sum(axis=1))))


def biconvex(surface: str) -> Scene:
    """The lens of Nagata's use for ray tracing: R ±50 mm, n 1.5168."""
    faces = [
        {"radius_mm": 50.0, "thickness_mm": 6.0, "index": 1.5168, "semi_diameter_mm": 10.0, "stop": True},
        {"radius_mm": -50.0, "semi_diameter_mm": 10.0},
    ]
    return Scene(
        camera=Camera(focus_mm=1e5, lens=Lens(surfaces=faces), sensor=Sensor(pixels=(64, 64), pixel_mm=0.5)),
        transport=Transport(surface=surface, wavelengths_nm=(550.0,)),
    )


def test_patches_converge_with_order_three():
    truth = landing(lf.build(biconvex("exact")), 5.0)
    rings = np.array([6, 12, 24, 48])
    errors = [rms(landing(lf.build(biconvex("patch"), rings=n), 5.0), truth) for n in rings]
    assert 6 * rings[1] ** 2 <= 1000
    assert errors[1] < 2e-5
    assert -np.polyfit(np.log(rings), np.log(errors), 1)[0] > 2.7


def test_the_default_tessellation_is_estimated_at_a_tenth_of_a_pixel_and_the_estimate_holds_within_a_factor():
    truth = landing(lf.build(biconvex("exact")), 5.0)
    for surface in ("flat", "smooth", "patch"):
        scene = biconvex(surface)
        world = lf.build(scene)
        estimate = float(np.linalg.norm(world.lens_shape.errors_mm))
        assert estimate < 0.1 * scene.camera.sensor.pixel_mm
        assert 0.4 < rms(landing(world, 5.0), truth) / estimate < 2.5


@pytest.mark.parametrize("field_deg", [0.0, 7.0, 12.0])
def test_a_lens_exported_as_stl_images_as_its_prescription(tmp_path, field_deg):
    lens = lf.load(ASSETS / "scenes" / "conventional.toml").changed(
        {"camera.lens": {"file": "../lenses/cooke_triplet_50mm.toml"}}
    )
    prescription = lf.solved(lens).camera.lens
    sensor = Sensor(pixels=(640, 640), pixel_mm=0.05, distance_mm=42.2)
    transport = Transport(wavelengths_nm=(550.0,))
    world = lf.build(Scene(camera=Camera(lens=prescription, sensor=sensor), transport=transport), rings=18)
    elements = []
    for number, k in enumerate(world.lens_shape.elements):
        world.mesh(f"lens[{number}]").export(tmp_path / f"{number}.stl")
        front, back = prescription.surfaces[k], prescription.surfaces[k + 1]
        elements.append(
            {
                "refractor": {"file": f"{number}.stl", "units": "mm", "glass": front.glass},
                "thickness_mm": back.thickness_mm,
                "semi_diameter_mm": min(front.semi_diameter_mm, back.semi_diameter_mm),
            }
        )
    scanned = Scene(camera=Camera(lens=Lens(surfaces=elements), sensor=sensor), transport=transport)
    copy = lf.build(scanned.in_folder(tmp_path))
    assert copy.first_order.efl_mm == pytest.approx(world.first_order.efl_mm, rel=1e-3)
    # A quarter of a pixel of 12.5 µm.
    assert rms(landing(copy, field_deg), landing(world, field_deg)) < 0.25 * 0.0125


def test_a_corner_cube_sends_light_back_where_it_came_from(tmp_path):
    corner = trimesh.Trimesh(
        [[0, 0, 0], [30, 0, 0], [0, 30, 0], [0, 0, 30]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    )
    corner.export(tmp_path / "corner.stl")
    cube = {"file": "corner.stl", "units": "mm", "index": 1.5, "surface": "flat"}
    scene = biconvex("exact").model_copy(update={"targets": (Target(refractor=cube, position_mm=(0.0, 0.0, -100.0)),)})
    world = lf.build(scene.in_folder(tmp_path))
    draw = np.random.default_rng(2)
    axis = np.ones(3) / np.sqrt(3.0)
    origins = np.array([0.0, 0.0, -100.0]) + 40.0 * axis + draw.uniform(-2.0, 2.0, (2000, 3))
    directions = -axis + 0.02 * draw.normal(size=(2000, 3))
    paths = lf.trace(world, origins, directions, split="transmit")
    back = (paths.status == lf.Status.ESCAPED) & (paths.weight < 1.0)
    assert back.sum() >= 1990
    sent = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    assert np.abs(paths.direction[back] + sent[paths.source[back]]).max() < 1e-12
