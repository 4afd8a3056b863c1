"""Bands against sums over single wavelengths, and emission by temperature against Planck's law integrated.

Images are compared in blocks of pixels, whose errors are the reported ones; a test allows differences that random
numbers exceed with a probability of 1e-3, shared by its blocks (Bonferroni).
"""

from statistics import NormalDist
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.optics.cie import named_spectrum, planck_radiance
from tests.cameras import close_up_camera
from tests.instances import instances
from tests.renders import by_seed

LEVEL = 1e-3

PEAKED = {"wavelengths_nm": [300.0, 500.0, 587.6, 680.0, 900.0], "values": [0.05, 0.05, 0.9, 0.05, 0.05]}
"""Reflectance with a peak at the d line."""

SLOPING = {"wavelengths_nm": [300.0, 900.0], "values": [0.2, 0.6]}

BAND = {"name": "band", "center_nm": 570.0, "fwhm_nm": 80.0}

PLANE = {"shape": {"kind": "plane", "width_mm": 9.0, "height_mm": 9.0}, "position_mm": [0.0, 0.0, -60.0]}
LAMP = {"kind": "point", "position_mm": [20.0, -15.0, -25.0], "power_w": 1.0}


def lit_scene(**transport: Any) -> lf.Scene:
    """Return a plane that reflects by wavelength, lit by a lamp, before a plenoptic camera with a lens of flint."""
    camera = close_up_camera(16, 16)
    surfaces = camera["lens"]["surfaces"]
    surfaces[0] = {key: value for key, value in surfaces[0].items() if key != "index"} | {"glass": "SCHOTT/N-SF11"}
    target = {**PLANE, "material": {"reflectance": PEAKED}}
    return lf.Scene(camera=camera, targets=[target], lights=[LAMP], transport={"threads": 1} | transport)


def blocks(values: NDArray[np.float64], side: int) -> NDArray[np.float64]:
    """Return the sums over square blocks of pixels, (blocks, channels)."""
    rows, columns, channels = values.shape
    parts = values.reshape(rows // side, side, columns // side, side, channels)
    return np.asarray(parts.sum(axis=(1, 3)).reshape(-1, channels))


def disagreement(
    one: NDArray[np.float64], its_variance: NDArray[np.float64], other: NDArray[np.float64],
    other_variance: NDArray[np.float64],
) -> tuple[float, float]:  # fmt: skip
    """Return the largest difference in standard errors, and the limit that it may have."""
    z = np.abs(one - other) / np.sqrt(its_variance + other_variance)
    return float(z.max()), -NormalDist().inv_cdf(LEVEL / 2.0 / z.size)


def spread_of_seeds(scene: lf.Scene, seeds: range, side: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return mean and variance of the mean of the blocks over renders with several seeds."""
    sums = np.array([blocks(image.mean, side) for image in by_seed(scene, seeds)])
    return sums.mean(axis=0), sums.var(axis=0, ddof=1) / len(sums)


@pytest.mark.parametrize(("fwhm_nm", "agrees"), [(0.01, True), (80.0, False)])
def test_a_narrow_band_is_a_line_and_a_wide_one_is_not(fwhm_nm: float, agrees: bool) -> None:
    scene = lit_scene(samples=64, replicates=8, split="transmit")
    line = lf.render(scene.changed({"transport.seed": 9}))
    wide = {"camera.sensor.bands": [{**BAND, "center_nm": 587.6, "fwhm_nm": fwhm_nm}]}
    band = scene.changed(wide)
    # The power lies in the whole reach of the band, of which its response takes a part.
    response = band.passbands[0].response
    share = response.area_nm / (response.ends_nm[1] - response.ends_nm[0])
    image = lf.render(band)
    side = 8
    largest, limit = disagreement(
        blocks(image.mean, side) / share, blocks(image.stderr**2, side) / share**2,
        blocks(line.mean, side), blocks(line.stderr**2, side),
    )  # fmt: skip
    assert (largest < limit) == agrees


@pytest.mark.parametrize(
    ("transport", "seeds"),
    [
        ({"split": "transmit", "samples": 64}, 6),
        ({"split": "both", "samples": 64}, 6),
        ({"engine": "mesh", "split": "roulette", "samples": 32}, 6),
        ({"method": "forward", "split": "transmit", "samples": 128}, 6),
    ],
    ids=["image path", "reflections apart", "meshes", "forward"],
)
def test_a_band_is_the_sum_of_its_wavelengths(transport: dict[str, Any], seeds: int) -> None:
    """A lamp of illuminant A in a band, against single wavelengths weighted with the lamp and the response."""
    scene = lit_scene(replicates=4, **transport)
    band = scene.changed({"camera.sensor.bands": [BAND], "lights[0].spectrum": "A"})
    response, (first, last) = band.passbands[0].response, band.reach_nm
    edges = np.linspace(first, last, 25)
    w = 0.5 * (edges[1:] + edges[:-1])
    fine = np.linspace(first, last, 20_001)
    shape = np.interp(fine, *named_spectrum("A"))
    weight = np.interp(w, *named_spectrum("A")) / np.trapezoid(shape, fine) * response.at(w) * np.diff(edges)
    lines = lf.render(scene.changed({"transport.wavelengths_nm": tuple(w), "transport.seed": 100}))
    mean, variance = spread_of_seeds(band, range(seeds), 8)
    expected = blocks(lines.mean * weight, 8).sum(axis=1, keepdims=True)
    known = blocks((lines.stderr * weight) ** 2, 8).sum(axis=1, keepdims=True)
    # Student's quantile, as the variance is that of few seeds.
    z = np.abs(mean - expected) / np.sqrt(variance.mean() + known)
    assert z.max() < stats.t.isf(LEVEL / 2.0 / z.size, seeds - 1)
    # The same lamp with all of its power at the band's centroid would be seen to differ.
    middle = int(np.argmin(np.abs(w - response.centroid_nm)))
    alone = blocks(lines.mean[:, :, middle : middle + 1], 8) * weight.sum()
    assert abs((mean - alone).sum()) > 5.0 * np.sqrt((variance.mean() + known).sum())


def test_a_band_has_the_axial_colour_of_its_wavelengths() -> None:
    """A bright spot on the axis of a singlet of flint, in focus at one wavelength: a band blurs it as its lines do."""
    lens = {
        "surfaces": [
            {"radius_mm": 60.0, "thickness_mm": 3.0, "glass": "SCHOTT/N-SF11", "semi_diameter_mm": 4.0, "stop": True},
            {"radius_mm": -60.0, "semi_diameter_mm": 5.0},
        ]
    }
    spot = {"shape": {"kind": "disk", "radius_mm": 0.05}, "position_mm": [0.0, 0.0, -150.0],
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}  # fmt: skip
    camera = {"focus_mm": 150.0, "lens": lens, "sensor": {"pixels": [16, 16], "pixel_mm": 0.012}}
    settings = {"samples": 512, "replicates": 8, "threads": 1, "split": "transmit"}
    scene = lf.Scene(camera=camera, targets=[spot], transport=settings)
    # The band's centroid is the primary wavelength, as the line that is in the middle of the others.
    wide = {"name": "wide", "center_nm": 587.6, "fwhm_nm": 100.0}
    band = scene.changed({"camera.sensor.bands": [wide]})
    response, (first, last) = band.passbands[0].response, band.reach_nm
    edges = np.linspace(first, last, 22)
    w = 0.5 * (edges[1:] + edges[:-1])
    weight = response.at(w) * np.diff(edges) / (last - first)
    lines = lf.render(scene.changed({"transport.wavelengths_nm": tuple(w), "transport.seed": 7}))
    assert lines.scene.primary_nm == pytest.approx(587.6)
    row, column = np.indices((16, 16)) - 7.5
    ring = np.minimum(np.hypot(row, column).astype(int), 5).ravel()

    def by_ring(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.bincount(ring, values.ravel())

    sums = np.array([by_ring(image.mean) for image in by_seed(band, range(6))])
    mean, variance = sums.mean(axis=0), sums.var(axis=0, ddof=1) / len(sums)
    expected, known = by_ring((lines.mean * weight).sum(axis=2)), by_ring(((lines.stderr * weight) ** 2).sum(axis=2))
    t = np.abs(mean - expected) / np.sqrt(variance + known)
    assert t.max() < stats.t.isf(LEVEL / 2.0 / t.size, len(sums) - 1)
    # All of the power at the middle wavelength would lie in narrower rings.
    alone = by_ring(lines.mean[:, :, 10]) * weight.sum()
    assert np.abs(mean - alone)[0] > 0.1 * alone[0]


def test_a_hot_surface_shines_by_plancks_law() -> None:
    """Emissivity 1 − reflectance at 2900 K in three bands, over the same camera's image of a known radiance.

    The lens has the same index at every wavelength. The closed form is ∫ R(λ) ε(λ) L(λ) dλ by quadrature.
    """
    surfaces = [{"radius_mm": 30.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 6.0, "stop": True},
                {"radius_mm": -30.0, "semi_diameter_mm": 6.0}]  # fmt: skip
    camera = {"focus_mm": 150.0, "lens": {"surfaces": surfaces}, "sensor": {"pixels": [8, 8], "pixel_mm": 0.5}}
    plane = {"shape": {"kind": "plane", "width_mm": 400.0, "height_mm": 400.0}, "position_mm": [0.0, 0.0, -150.0]}
    known = {**plane, "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}
    hot = {**plane, "material": {"reflectance": SLOPING, "temperature_k": 2900.0}}
    settings = {"samples": 1024, "replicates": 8, "threads": 1, "split": "transmit"}
    white = lf.render(lf.Scene(camera=camera, targets=[known], transport=settings | {"seed": 50}))
    camera["sensor"]["bands"] = "rgb"
    scene = lf.Scene(camera=camera, targets=[hot], transport=settings)
    sums = np.array([image.mean.sum(axis=(0, 1)) for image in by_seed(scene, range(8))])
    reference, its_error = white.mean.sum(), np.sqrt((white.stderr**2).sum())
    found, error = sums.mean(axis=0) / reference, sums.std(axis=0, ddof=1) / np.sqrt(len(sums)) / reference
    sigma = np.hypot(error / found, its_error / reference)
    w = np.linspace(*scene.reach_nm, 100_001)
    emissivity = 1.0 - np.interp(w, SLOPING["wavelengths_nm"], SLOPING["values"])
    for channel, band in enumerate(scene.passbands):
        response = np.interp(w, band.response.wavelengths_nm, band.response.values, left=0.0, right=0.0)
        expected = np.trapezoid(response * emissivity * planck_radiance(w, 2900.0), w)
        assert sigma[channel] < 1e-3
        assert abs(found[channel] / expected - 1.0) < 3.0 * sigma[channel]


def test_the_reported_error_holds_the_noise_of_the_wavelengths() -> None:
    """A lamp of narrow peaks in a wide band: the variance over seeds against the reported one, by an F test.

    A seed counts as one measurement, a replicate of it as one too, whatever the number of pixels.
    """
    scene = lit_scene(samples=32, replicates=4, split="transmit").changed(
        {"camera.sensor.bands": [{**BAND, "fwhm_nm": 120.0}], "lights[0].spectrum": "FL11",
         "targets[0].material.reflectance": 0.8}
    )  # fmt: skip
    seeds = 16
    images = list(by_seed(scene, range(seeds)))
    totals = np.array([image.mean for image in images])
    lit = totals.mean(axis=0) > 0.2 * totals.mean(axis=0).max()
    true = totals.var(axis=0, ddof=1)[lit].mean()
    reported = np.mean([(image.stderr**2)[lit].mean() for image in images])
    law = stats.f(seeds - 1, seeds * (scene.transport.replicates - 1))
    assert law.ppf(LEVEL / 2.0) < true / reported < law.isf(LEVEL / 2.0)
    # And that noise is most of it: at one wavelength the relative error is far smaller.
    line = lf.render(scene.at_line(570.0))
    at_line = np.mean((line.stderr**2)[lit]) / np.mean(line.mean[lit]) ** 2
    assert true / totals.mean(axis=0)[lit].mean() ** 2 > 2.0 * at_line


RED = {"wavelengths_nm": [300.0, 560.0, 620.0, 900.0], "values": [0.05, 0.06, 0.7, 0.75]}


@pytest.mark.parametrize("bands", instances(["xyz", "rgb"], long=["xyz"]))
@pytest.mark.parametrize("replicates", instances([8, 16, 64], long=[16, 64]))
def test_errors_of_pixels_add_up_to_that_of_their_sum(bands: str, replicates: int) -> None:
    """A red matt plane under D65: sums over 144 pixels scatter over 24 seeds as the pixels' errors say.

    Pooled over three bands the ratio is known within 9 %.
    """
    camera = close_up_camera(12, 12)
    camera["sensor"]["bands"] = bands
    plane = {**PLANE, "shape": {"kind": "plane", "width_mm": 20.0, "height_mm": 20.0}, "material": {"reflectance": RED}}
    sun = {"kind": "directional", "direction": [0.1, 0.1, -1.0], "irradiance_w_m2": 1.0, "spectrum": "D65"}
    settings = {"samples": 8 * replicates, "replicates": replicates, "split": "transmit", "threads": 1}
    scene = lf.Scene(camera=camera, targets=[plane], lights=[sun], transport=settings)
    images = list(by_seed(scene, range(24)))
    scatter = np.array([image.mean.sum(axis=(0, 1)) for image in images]).var(axis=0, ddof=1)
    stated = np.mean([(image.stderr**2).sum(axis=(0, 1)) for image in images], axis=0)
    assert 0.8 < np.sqrt((scatter / stated).mean()) < 1.25


def test_ghosts_of_a_band_agree_with_the_meshes() -> None:
    scene = lit_scene(samples=16, replicates=2, split="both").changed({"camera.sensor.bands": "rgb"})
    order = lf.render(scene).order
    assert order.reflected > 1000
    assert order.differing == 0
    assert order.deviation < 1e-9


@pytest.mark.parametrize("method", ["adjoint", "forward"])
def test_the_number_of_threads_changes_no_bit_of_a_band(method: str) -> None:
    scene = lit_scene(samples=16, replicates=2, method=method).changed({"camera.sensor.bands": "xyz"})
    one, three = (lf.render(scene.changed({"transport.threads": threads})) for threads in (1, 3))
    for name in ("mean", "stderr", "hits"):
        np.testing.assert_array_equal(getattr(one, name), getattr(three, name))
