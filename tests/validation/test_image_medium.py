"""Image space that is not air: Snell's law at a window, watts by closed forms, and cameras of which only ratios count.

Radiance over n² is conserved but for losses: behind the lens, in a medium of the index n', a plane of the radiance L in
air has the radiance n'² L T. With every index times n a camera sends light along the same paths, with the same shares.
"""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.view.rays.history import history
from lfmesh.view.rays.launch import from_field_point
from tests.cameras import close_up_camera
from tests.renders import by_seed
from tests.validation.test_particles_in_water import bent
from tests.validation.test_radiometry import MM2, assert_means, behind_a_stop, disk_factor

Array = NDArray[np.float64]

OIL, GLASS, WINDOW = 1.4, 1.5, 4.0

IN_OIL = {"camera.image_medium": {"index": OIL}}

PINHOLE = [
    {"stop": True, "thickness_mm": 6.0, "semi_diameter_mm": 3.0},
    {"thickness_mm": WINDOW, "index": GLASS, "semi_diameter_mm": 12.0},
    {"semi_diameter_mm": 12.0},
]
"""A pinhole of 3 mm in radius before a flat window, and behind that oil up to the sensor."""

COVER = {"thickness_mm": 0.5, "gap_mm": 0.2, "index": 1.6}


@pytest.mark.parametrize("engine", ["mesh", "sequential"])
@pytest.mark.parametrize("cover", [None, COVER])
def test_rays_into_oil_follow_snells_law(engine: str, cover: dict[str, float] | None) -> None:
    """They land where the refractions put them, with the transmittance of Fresnel's faces."""
    draw = np.random.default_rng(3)
    start = np.column_stack([draw.uniform(-8.0, 8.0, (64, 2)), np.full(64, -30.0)])
    at = np.column_stack([draw.uniform(-4.0, 4.0, (64, 2)), np.zeros(64)])
    ahead = at - start
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    normal = np.array([0.0, 0.0, 1.0])
    stopped = np.hypot(*at[:, :2].T) > 3.0
    in_glass, first = bent(ahead, normal, 1.0, GLASS)
    in_oil, second = bent(in_glass, normal, GLASS, OIL)
    passed, before = first * second, 10.0
    p = at + 6.0 / ahead[:, 2:] * ahead + WINDOW / in_glass[:, 2:] * in_glass
    if cover is not None:
        in_cover, third = bent(in_oil, normal, OIL, COVER["index"])
        passed, before = passed * third * bent(in_cover, normal, COVER["index"], OIL)[1], 9.5
        p = p + 0.5 / in_cover[:, 2:] * in_cover
    p = p + before / in_oil[:, 2:] * in_oil
    sensor = {"pixels": [40, 40], "pixel_mm": 1.0, "distance_mm": 10.0, "cover": cover}
    scene = lf.Scene(
        camera={"lens": {"surfaces": PINHOLE}, "sensor": sensor, "image_medium": {"index": OIL}},
        transport={"engine": engine, "split": "transmit"},
    )
    paths = lf.trace(lf.build(scene), start, ahead, split="transmit")
    landed = paths.status == lf.Status.SENSOR
    np.testing.assert_array_equal(np.sort(paths.source[landed]), np.flatnonzero(~stopped))
    source = paths.source[landed]
    assert 10 < len(source) < 60
    np.testing.assert_allclose(paths.position[landed], p[source], rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(paths.weight[landed], passed[source], rtol=1e-12)


@pytest.mark.parametrize("method", ["adjoint", "forward"])
def test_irradiance_in_oil_is_n2_pi_l_t_times_the_stops_form_factor(method: str) -> None:
    """E = n'² π L T sin² u' on the axis, and off it n'² π L T times the form factor of the stop.

    Light meets the faces at up to 16°, where T is that of normal incidence within 1e-4 a surface.
    """
    wide = {"targets[0].shape": {"kind": "plane", "width_mm": 40.0, "height_mm": 40.0}}
    scene = behind_a_stop(GLASS, method).changed(IN_OIL | wide | {"camera.sensor.distance_mm": 30.0})
    images = np.array([image.mean[..., 0] for image in by_seed(scene, range(24))])
    rows, columns = images.shape[1:]
    nodes, weights = np.polynomial.legendre.leggauss(8)
    x = 0.5 * (np.arange(columns)[:, None] - 0.5 * (columns - 1) + 0.5 * nodes)
    y = 0.5 * (np.arange(rows)[:, None] - 0.5 * (rows - 1) + 0.5 * nodes)
    factor = disk_factor(30.0, np.hypot(x[None, :, None, :], y[:, None, :, None]), 3.0)
    factor = (factor * 0.25 * np.outer(weights, weights)).sum(axis=(2, 3))
    passed = 4.0 * GLASS / (1.0 + GLASS) ** 2 * 4.0 * GLASS * OIL / (GLASS + OIL) ** 2
    expected = OIL**2 * np.pi * 5.0 * passed * factor * 0.25 * MM2
    total = images.sum(axis=(1, 2))
    assert stats.sem(total) < 0.02 * total.mean()
    assert_means(np.column_stack([images.reshape(24, -1), total]), np.append(expected, expected.sum()), 4e-4)


def immersed(**settings: Any) -> lf.Scene:
    """A chart that shines before a camera with an array and a cover in oil."""
    camera = close_up_camera() | {"image_medium": {"index": 1.2}}
    camera["sensor"] |= {"cover": COVER}
    chart = {"shape": {"kind": "plane", "width_mm": 30.0, "height_mm": 30.0}, "position_mm": [0.0, 0.0, -60.0],
             "material": {"reflectance": 0.6, "radiance_w_m2_sr": 1.0}}  # fmt: skip
    scene = lf.Scene(
        camera=camera, targets=[chart],
        transport={"samples": 16, "replicates": 2, "threads": 1, "split": "transmit"},
    )  # fmt: skip
    return scene.changed(settings) if settings else scene


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"transport.engine": "mesh", "transport.split": "both", "camera.sensor.reflectance": 0.2},
        {"transport.method": "forward"},
        {"transport.diffraction": "lenslets", "transport.wavelengths_nm": [2000.0]},
    ],
)
def test_only_ratios_of_indices_count(settings: dict[str, Any]) -> None:
    """A camera and its objects in a medium, with every index and the wavelength times n, make the same picture."""
    n, radius = 1.25, {"camera.mla.focal_length_mm": None, "camera.mla.radius_mm": 1.3}
    placed = {"camera.sensor.distance_mm": 2.4, "camera.image_medium": None}
    air = immersed(**placed, **radius, **{"transport.wavelengths_nm": [500.0]} | settings)
    times = {
        "camera.object_medium": {"index": n}, "camera.image_medium": {"index": n}, "camera.mla.index": 1.5 * n,
        "camera.lens.surfaces[0].index": 1.5 * n, "camera.sensor.cover.index": COVER["index"] * n,
        "transport.wavelengths_nm": [n * wave for wave in air.transport.wavelengths_nm],
    }  # fmt: skip
    dry, wet = lf.render(air), lf.render(air.changed(times))
    assert dry.mean.sum() > 0.0
    np.testing.assert_allclose(wet.mean, dry.mean, rtol=0.0, atol=1e-9 * dry.mean.max())
    assert abs(wet.ledger.imbalance) < 1e-12


def test_a_lamp_lights_the_same_immersed_picture_in_both_methods() -> None:
    """The forward method follows watts, which know no n²: it is the truth for what lamps bring to pixels."""
    lamp = {"kind": "point", "position_mm": [20.0, -15.0, -25.0], "power_w": 1.0}
    lit = immersed(**{"lights": [lamp], "targets[0].material": {"reflectance": 0.7}})
    sums = [
        np.array([image.mean.sum() for image in by_seed(lit.changed({"transport.method": method, **taken}), seeds)])
        for method, taken, seeds in (
            ("adjoint", {}, range(8)), ("forward", {"transport.samples": 512}, range(100, 124)),
        )
    ]  # fmt: skip
    error = np.hypot(*(stats.sem(each) for each in sums))
    assert error < 0.03 * sums[0].mean()
    assert abs(sums[1].mean() - sums[0].mean()) < 4.0 * error


def test_both_engines_make_the_same_immersed_picture() -> None:
    mesh, ordered = (lf.render(immersed(**{"transport.engine": each})) for each in ("mesh", "sequential"))
    assert ordered.mean.sum() > 0.0
    np.testing.assert_allclose(ordered.mean, mesh.mean, rtol=0.0, atol=1e-9 * mesh.mean.max())


def test_a_cover_of_the_oils_index_cannot_be_seen() -> None:
    matched = immersed(**{"camera.sensor.distance_mm": 8.0, "camera.sensor.cover.index": 1.2})
    start, ahead = [[0.5, 0.2, -58.0], [0.9, 0.6, -58.0]], [[0.0, 0.01, 1.0], [-0.02, 0.0, 1.0]]
    worlds = lf.build(matched), lf.build(matched.changed({"camera.sensor.cover": None}))
    seen, truth = (lf.trace(each, start, ahead, split="transmit") for each in worlds)
    np.testing.assert_allclose(seen.position, truth.position, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(seen.weight, truth.weight, rtol=1e-13)


def test_chief_rays_and_photographs_know_the_oil() -> None:
    """Micro-images are apart as by first-order optics, and a distance has the shift that leads back to it."""
    scene = immersed()
    facts, model = lf.first_order(scene), lf.RayModel.of(scene)
    assert facts.micro_image_pitch_px is not None
    assert lf.calibrate(scene).pitch_px == pytest.approx(facts.micro_image_pitch_px, rel=2e-2)
    assert model.micro_image_pitch_px == pytest.approx(facts.micro_image_pitch_px, rel=1e-12)
    assert model.paraxial.distance_mm(0.0) == pytest.approx(facts.object_distance_mm, rel=1e-9)
    assert model.paraxial.refocus_range_mm[0] == pytest.approx(facts.near_mm, rel=1e-9)
    assert model.distance_mm(model.shift_mm(70.0)) == pytest.approx(70.0, rel=1e-9)


def test_the_history_of_a_path_names_the_oil() -> None:
    """From the chart through lens, array and cover: air, the lens, oil, the array, oil, the cover, oil."""
    rays = from_field_point(lf.build(immersed()), (0.0, 0.0, -60.0), 8, split="transmit")
    media = [[step.medium for step in history(rays, path)] for path in range(len(rays))]
    passed = max(media, key=len)
    assert passed[:7] == ["air", "n = 1.5", "n = 1.2", "n = 1.5", "n = 1.2", "n = 1.6", "n = 1.2"]
