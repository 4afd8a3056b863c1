"""`exact` on the default coarse mesh against the analytic lens: where rays land, and the flux of the spot's main lobe.

The truth is the sequential trace of `lfmesh.accuracy.analytic`, which knows no meshes.
"""

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.accuracy.analytic import Camera
from lfmesh.accuracy.lens_accuracy import bundle, lens_scene
from lfmesh.assets import asset_path

LENSES = sorted(path.stem for path in asset_path("lenses").glob("*.toml"))
BATCH = 1 << 17
POSITION_MM = 1e-9
WEIGHT = 1e-12
LOBE_MM = 0.005
"""Radius of the central 10 µm."""


def camera(name):
    """A lens twenty focal lengths from its object plane, and a sensor for 25 degrees of half field."""
    return lens_scene(asset_path(f"lenses/{name}.toml"))


def landings(world, origins, directions, split="transmit"):
    """Position on the sensor's plane, weight and arrival, a row a ray, of the packets that were only refracted."""
    refracting = sum(not world.scene.camera.lens.is_pure_stop(k) for k in range(len(world.scene.camera.lens.surfaces)))
    paths = lf.trace(world, origins, directions, split=split)
    # A ghost has two events more.
    direct = np.isin(paths.body, ["sensor", "beside the sensor"]) & (paths.events == refracting)
    source = paths.source[direct]
    assert len(np.unique(source)) == len(source)
    position, weight = np.full((len(origins), 2), np.nan), np.zeros(len(origins))
    position[source], weight[source] = paths.position[direct, :2], paths.weight[direct]
    return position, weight, ~np.isnan(position[:, 0])


def lands_as_the_truth(name, rays):
    scene = camera(name)
    world = lf.build(scene)
    truth = Camera.of(scene, 587.6)
    widest, landed = 0.0, 0
    for seed, first in enumerate(range(0, rays, BATCH)):
        sent = bundle(scene, min(BATCH, rays - first), seed)
        true = truth.land(*sent)
        position, weight, arrives = landings(world, *sent)
        np.testing.assert_array_equal(arrives, true.arrives)
        assert np.abs(position - true.position)[arrives].max() < POSITION_MM
        assert np.abs(weight - true.weight)[arrives].max() < WEIGHT
        field = np.rad2deg(np.arccos(sent.directions[arrives, 2]))
        widest, landed = max(widest, field.max()), landed + int(arrives.sum())
    assert widest > 20.0
    assert landed > 0.1 * rays


@pytest.mark.parametrize("name", LENSES)
def test_exact_on_the_default_mesh_lands_as_the_analytic_lens(name):
    lands_as_the_truth(name, 20_000)


@pytest.mark.long
@pytest.mark.parametrize("name", LENSES)
def test_a_million_rays_a_lens_land_as_the_analytic_lens(name):
    lands_as_the_truth(name, 1_000_000)


@pytest.mark.parametrize("field_deg", [0.0, 3.0])
@pytest.mark.parametrize("name", LENSES)
def test_the_main_lobe_has_the_flux_of_the_analytic_lens(name, field_deg):
    """With all reflections followed: what is lost from the image path would not show in the balance."""
    scene = camera(name)
    world, truth = lf.build(scene), Camera.of(scene, 587.6)
    report = lf.first_order(scene)
    draw = np.random.default_rng(5)
    # The truth integrates rays through gradients, which takes long.
    count = 8_000 if any(True for _ in scene.gradients()) else 40_000
    r = 0.5 * report.entrance_pupil_diameter_mm * np.sqrt(draw.uniform(size=count))
    phi = draw.uniform(0.0, 2.0 * np.pi, count)
    pupil = np.column_stack([r * np.cos(phi), r * np.sin(phi), np.full(count, report.entrance_pupil_z_mm)])
    distance = scene.camera.focus_mm
    point = np.array([0.0, np.tan(np.deg2rad(field_deg)) * distance, -distance])
    d = pupil - point
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    # From the first vertex's plane backwards by 30 mm: clear of the lens, and near enough to keep the digits.
    o = pupil - d * ((pupil[:, 2] + 30.0) / d[:, 2])[:, None]
    true = truth.land(o, d)
    position, weight, _ = landings(world, o, d, "both")
    # The lobe's middle: where the rays are densest, those round the chief ray.
    middle = np.nanmedian(true.position[r < 0.1 * r.max()], axis=0)
    inside_true = np.linalg.norm(true.position - middle, axis=1) < LOBE_MM
    inside = np.linalg.norm(position - middle, axis=1) < LOBE_MM
    flux, expected = weight[inside].sum(), true.weight[inside_true].sum()
    assert expected > 1e-3 * true.weight.sum()
    assert abs(flux / expected - 1.0) < 1e-6
