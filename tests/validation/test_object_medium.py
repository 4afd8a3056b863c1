"""A camera that looks into water: Snell's law at a port, a dome about the pupil, and watts by closed forms.

Radiance over n² is conserved but for losses: a plane of the radiance L in a medium of the index n is seen from air with
L T / n². A black body in water has n² times its radiance in air, so that its picture is as bright.
"""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.optics.gloss import EXTINCTION, INDEX, interface_reflectance
from lfmesh.scene import Paraxial
from lfmesh.transport.tables.scattering import scattering_tables
from lfmesh.view.rays.history import history
from lfmesh.view.rays.launch import from_field_point
from tests.cameras import biconvex, close_up_camera
from tests.renders import by_seed
from tests.validation.test_particles_in_water import bent
from tests.validation.test_radiometry import MM2, assert_means, behind_a_stop, disk_factor

Array = NDArray[np.float64]

WATER, GLASS = 1.333, 1.5

WINDOW = 4.0
"""Thickness of the port, mm."""

PORT = [
    {"thickness_mm": WINDOW, "index": GLASS, "semi_diameter_mm": 12.0},
    {"thickness_mm": 6.0, "semi_diameter_mm": 12.0},
    {"stop": True, "semi_diameter_mm": 3.0},
]
"""A flat port before a pinhole of 3 mm in radius."""

IN_WATER = {"camera.object_medium": {"index": WATER}}


def through_port() -> lf.Scene:
    sensor = {"pixels": [40, 40], "pixel_mm": 1.0, "distance_mm": 10.0}
    return lf.Scene(camera={"lens": {"surfaces": PORT}, "sensor": sensor, "object_medium": {"index": WATER}})


def fan(count: int, z: float) -> tuple[Array, Array]:
    """Return points in a plane of object space, and directions towards points of the port."""
    draw = np.random.default_rng(3)
    start = np.column_stack([draw.uniform(-8.0, 8.0, (count, 2)), np.full(count, z)])
    at = np.column_stack([draw.uniform(-4.0, 4.0, (count, 2)), np.zeros(count)])
    ahead = at - start
    return start, ahead / np.linalg.norm(ahead, axis=1, keepdims=True)


@pytest.mark.parametrize("engine", ["mesh", "sequential"])
def test_rays_through_a_flat_port_follow_snells_law(engine: str) -> None:
    """They land where two refractions put them, with the transmittance of both of Fresnel's faces."""
    start, ahead = fan(64, -30.0)
    normal = np.array([0.0, 0.0, 1.0])
    p = start - start[:, 2:] / ahead[:, 2:] * ahead
    in_glass, first = bent(ahead, normal, WATER, GLASS)
    p = p + WINDOW / in_glass[:, 2:] * in_glass
    in_air, second = bent(in_glass, normal, GLASS, 1.0)
    stopped = np.hypot(*(p + 6.0 / in_air[:, 2:] * in_air)[:, :2].T) > 3.0
    p = p + 16.0 / in_air[:, 2:] * in_air
    world = lf.build(through_port().changed({"transport.engine": engine, "transport.split": "transmit"}))
    paths = lf.trace(world, start, ahead, split="transmit")
    landed = paths.status == lf.Status.SENSOR
    np.testing.assert_array_equal(np.sort(paths.source[landed]), np.flatnonzero(~stopped))
    source = paths.source[landed]
    assert 10 < len(source) < 60
    np.testing.assert_allclose(paths.position[landed], p[source], rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(paths.weight[landed], (first * second)[source], rtol=1e-12)


def dome(radius: float, thickness: float) -> list[dict[str, Any]]:
    """Return a dome of glass whose two spheres have their centre in the pinhole behind it."""
    return [
        {"radius_mm": radius, "thickness_mm": thickness, "index": GLASS, "semi_diameter_mm": 0.7 * radius},
        {"radius_mm": radius - thickness, "thickness_mm": radius - thickness, "semi_diameter_mm": 0.6 * radius},
        {"stop": True, "semi_diameter_mm": 1.0},
    ]


def test_a_dome_about_the_pupil_does_not_bend_chief_rays() -> None:
    scene = through_port().changed({"camera.lens": {"surfaces": dome(40.0, 5.0)}})
    world = lf.build(scene)
    start = np.array([[0.0, 0.0, -80.0], [30.0, -20.0, -60.0], [-60.0, 15.0, -30.0]])
    ahead = np.array([0.0, 0.0, 40.0]) - start
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    paths = lf.trace(world, start, ahead, split="transmit")
    assert len(paths.source) == 3
    np.testing.assert_allclose(paths.direction, ahead[paths.source], rtol=0.0, atol=1e-13)


def test_a_dome_makes_a_near_virtual_image_of_far_water() -> None:
    """Far objects appear where n'/s' = (n' − n)/R, surface after surface, puts them: some 4 R before a thin dome."""
    radius, thickness = 40.0, 2.0
    lens = through_port().changed({"camera.lens": {"surfaces": dome(radius, thickness)}}).camera.lens
    given = lens.model_copy(update={"object_medium": lf.Matter(index=WATER)})
    first = GLASS / ((GLASS - WATER) / radius) - thickness
    second = 1.0 / ((1.0 - GLASS) / (radius - thickness) + GLASS / first)
    behind_stop = second - (radius - thickness)
    assert Paraxial.of(given, 587.6).bfl_mm == pytest.approx(behind_stop, rel=1e-12)
    assert -4.5 * radius < behind_stop < -3.5 * radius
    # Rays close to the axis agree.
    world = lf.build(through_port().changed({"camera.lens": {"surfaces": dome(radius, thickness)}}))
    paths = lf.trace(world, [[0.001, 0.0, -100.0]], [[0.0, 0.0, 1.0]], split="transmit")
    (x, _, z), (dx, _, dz) = paths.position[0], paths.direction[0]
    assert z - x / dx * dz - radius == pytest.approx(behind_stop, rel=1e-6)


@pytest.mark.parametrize("method", ["adjoint", "forward"])
def test_a_plane_in_water_is_seen_with_its_radiance_over_the_square_of_the_index(method: str) -> None:
    """Irradiance of every pixel: π L T / n² times the form factor of the stop, which stands right before the sensor."""
    scene = behind_a_stop(GLASS, method).changed(IN_WATER)
    images = np.array([image.mean[..., 0] for image in by_seed(scene, range(24))])
    rows, columns = images.shape[1:]
    nodes, weights = np.polynomial.legendre.leggauss(8)
    x = 0.5 * (np.arange(columns)[:, None] - 0.5 * (columns - 1) + 0.5 * nodes)
    y = 0.5 * (np.arange(rows)[:, None] - 0.5 * (rows - 1) + 0.5 * nodes)
    factor = disk_factor(16.0, np.hypot(x[None, :, None, :], y[:, None, :, None]), 3.0)
    factor = (factor * 0.25 * np.outer(weights, weights)).sum(axis=(2, 3))
    passed = 4.0 * WATER * GLASS / (WATER + GLASS) ** 2 * 4.0 * GLASS / (GLASS + 1.0) ** 2
    expected = np.pi * 5.0 * passed / WATER**2 * factor * 0.25 * MM2
    total = images.sum(axis=(1, 2))
    assert stats.sem(total) < 0.008 * total.mean()
    assert_means(np.column_stack([images.reshape(24, -1), total]), np.append(expected, expected.sum()), 4e-4)


@pytest.mark.parametrize("method", ["adjoint", "forward"])
def test_a_black_body_in_water_is_as_bright_as_in_air(method: str) -> None:
    """Its radiance in water is n² B, which leaves water as B: only the first face's transmittance changes."""
    material = {"reflectance": 0.0, "temperature_k": 2500.0}
    bands = [{"name": "R", "center_nm": 620.0, "fwhm_nm": 20.0}]
    settings = {"targets[0].material": material, "camera.sensor.bands": bands}
    hot = behind_a_stop(GLASS, method).changed(settings)
    sums = [
        np.array([image.mean.sum() for image in by_seed(hot.changed(medium), range(12))]) for medium in ({}, IN_WATER)
    ]
    passed = 4.0 * WATER * GLASS / (WATER + GLASS) ** 2 / 0.96
    ratio = sums[1].mean() / sums[0].mean()
    error = ratio * np.hypot(*(stats.sem(each) / each.mean() for each in sums))
    assert error < 0.02
    assert abs(ratio - passed) < 4.0 * error + 4e-4


def test_a_lamp_in_water_lights_the_same_picture_in_both_methods() -> None:
    """The forward method follows watts, which know no n²: it is the truth for what lamps bring to pixels."""
    lamp = {"kind": "point", "position_mm": [14.0, 9.0, -6.0], "power_w": 1.0}
    lit = {"targets[0].material": {"reflectance": 0.7}, "lights": [lamp]}
    sums = [
        np.array([image.mean.sum() for image in by_seed(behind_a_stop(GLASS, method).changed(IN_WATER | lit), seeds)])
        for method, seeds in (("adjoint", range(8)), ("forward", range(100, 124)))
    ]
    error = np.hypot(*(stats.sem(each) for each in sums))
    assert error < 0.02 * sums[0].mean()
    assert abs(sums[1].mean() - sums[0].mean()) < 4.0 * error


def lit_in_water(**settings: Any) -> lf.Scene:
    """A matt chart and a ball of glass in water, lit by a lamp there."""
    chart = {"shape": {"kind": "plane", "width_mm": 9.0, "height_mm": 9.0}, "position_mm": [0.0, 0.0, -60.0],
             "material": {"reflectance": 0.7}}  # fmt: skip
    block = {"refractor": {"box_mm": [1.0, 1.0, 1.0], "index": 1.6}, "position_mm": [0.6, 0.3, -55.0]}
    lamp = {"kind": "point", "position_mm": [20.0, -15.0, -25.0], "power_w": 1.0}
    scene = lf.Scene(
        camera=close_up_camera() | {"object_medium": {"index": WATER}},
        targets=[chart, block],
        lights=[lamp],
        transport={"samples": 16, "replicates": 2, "threads": 1, "split": "transmit"},
    )
    return scene.changed(settings) if settings else scene


@pytest.mark.parametrize("method", ["adjoint", "forward"])
def test_energy_closes_in_water(method: str) -> None:
    image = lf.render(lit_in_water(**{"transport.method": method, "transport.split": "both"}))
    assert abs(image.ledger.imbalance) < 1e-12
    assert image.mean.sum() > 0.0


def test_both_engines_make_the_same_picture_of_water() -> None:
    mesh, ordered = (lf.render(lit_in_water(**{"transport.engine": each})) for each in ("mesh", "sequential"))
    assert ordered.mean.sum() > 0.0
    np.testing.assert_allclose(ordered.mean, mesh.mean, rtol=0.0, atol=1e-9 * mesh.mean.max())


def test_glass_of_the_waters_index_cannot_be_seen() -> None:
    """A block that is matched to the water changes no ray; in air it would bend them."""
    scene = lit_in_water(**{"targets[1].refractor.index": WATER})
    world, bare = lf.build(scene), lf.build(scene.changed({"targets": scene.targets[:1]}))
    start = np.array([[0.5, 0.2, -58.0], [0.9, 0.6, -58.0], [0.3, 0.1, -58.0]])
    ahead = np.array([[0.0, 0.01, 1.0], [-0.02, 0.0, 1.0], [0.01, 0.0, 1.0]])
    seen, truth = (lf.trace(each, start, ahead, split="transmit") for each in (world, bare))
    order, other = np.argsort(seen.source), np.argsort(truth.source)
    np.testing.assert_allclose(seen.position[order], truth.position[other], rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(seen.weight[order], truth.weight[other], rtol=1e-13)


def test_lacquer_in_water_reflects_by_its_index_over_the_waters() -> None:
    """Its facets' reflectance at normal incidence is ((1.5 − 1.333) / (1.5 + 1.333))²."""
    material = lf.Material(reflectance=0.0, gloss=lf.Gloss(index=1.5, roughness=0.3))
    tables = scattering_tables([material], (550.0,), surroundings=WATER)
    index, extinction = tables.parameters[tables.models["first"][0] + np.array([INDEX, EXTINCTION]), 0]
    reflected = interface_reflectance(index, extinction, np.array([1.0]))
    assert reflected[0] == pytest.approx(((1.5 - WATER) / (1.5 + WATER)) ** 2, rel=1e-12)


def test_the_history_of_a_path_names_the_water() -> None:
    """From the chart through the block and the lens: water, glass, water, the lens, air."""
    rays = from_field_point(lf.build(lit_in_water()), (0.6, 0.3, -60.0), 8, aim="lens", split="transmit")
    media = [[step.medium for step in history(rays, path)] for path in range(len(rays))]
    assert ["n = 1.333", "n = 1.6", "n = 1.333", "n = 1.5", "air"] in [each[:5] for each in media]


def test_faults_name_the_key() -> None:
    with pytest.raises(
        lf.SceneError, match=r"gloss\.index = 1\.3: must not be below that of camera\.object_medium, 1\.333"
    ):
        lf.build(lit_in_water(**{"targets[0].material.gloss": {"index": 1.3, "roughness": 0.2}}))


def test_a_lens_of_an_index_below_the_waters_diverges() -> None:
    surfaces = biconvex(index=1.2)["surfaces"]
    lens = lf.Lens(surfaces=surfaces, object_medium={"index": WATER})
    power = (1.2 - WATER) / 20.0 + 0.2 / 20.0
    assert Paraxial.of(lens, 587.6).whole.c == pytest.approx(
        -(power - 3.0 / 1.2 * (1.2 - WATER) / 20.0 * 0.2 / 20.0), rel=1e-12
    )
