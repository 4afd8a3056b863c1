"""The detector: photon statistics, full wells, steps and mosaics; the image stays as it was."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.lightfield.detector import Detector, transmittance
from lfmesh.scene import Scene

LEVEL = 1e-3
"""Of a test, all its comparisons together (Bonferroni)."""

FINE = Detector(full_well_e=65000.0, read_noise_e=0.0, dark_current_e_s=0.0, bits=16, black_level=535)
"""One electron a count, and nothing but shot noise."""


@pytest.fixture
def flat(camera: Callable[..., Scene], image_of: Callable[..., lf.Image]) -> Callable[..., lf.Image]:
    """An image with the same power in every pixel, such that a number of electrons is expected."""

    def build(electrons: float, detector: Detector = FINE, **changes: Any) -> lf.Image:
        scene = camera().changed(changes)
        columns, rows = scene.camera.sensor.pixels
        image = image_of(scene, np.ones((rows, columns, len(scene.transport.wavelengths_nm))))
        return replace(image, mean=image.mean * electrons / replace(detector, bayer=None).expected_e(image).max())

    return build


def test_a_watt_is_that_many_photons(flat: Callable[..., lf.Image]) -> None:
    """1 pW at 587.6 nm for 10 ms: 29,579.6 photons by hc = 1.98644586e-25 J m."""
    image = flat(1.0)
    image.mean[:] = 1e-12
    photons = 1e-12 * 0.01 * 587.6e-9 / 1.98644586e-25
    np.testing.assert_allclose(Detector(quantum_efficiency=1.0).expected_e(image), photons, rtol=1e-8)
    np.testing.assert_allclose(Detector(quantum_efficiency=0.25).expected_e(image), 0.25 * photons, rtol=1e-8)


def test_the_exposure_of_the_scene_is_the_time_for_which_its_shutter_is_open(flat: Callable[..., lf.Image]) -> None:
    """A shutter that opens and closes evenly in 0.2 s is open for half of that; without exposure, wells fill."""
    half = lf.Exposure(duration_s=0.2, shutter=((0.0, 0.0), (0.1, 1.0), (0.2, 0.0)))
    assert FINE.timed_by(flat(1.0, exposure=half)).exposure_s == pytest.approx(0.1)
    assert FINE.timed_by(flat(1.0, exposure={"duration_s": 0.2})).exposure_s == 0.2
    assert FINE.timed_by(flat(1.0)) == FINE.filling(flat(1.0))


def test_variance_is_mean_in_the_shot_noise_limit(flat: Callable[..., lf.Image]) -> None:
    """Dispersion Σ(n − m)²/m of Poisson numbers with a known mean is chi-square to its first two moments."""
    levels = (30.0, 300.0, 3000.0)
    assert FINE.electrons_per_count == 1.0
    for number, electrons in enumerate(levels):
        drawn = replace(FINE, seed=number).expose(flat(electrons)).electrons.ravel()
        dispersion = ((drawn - electrons) ** 2).sum() / electrons
        # Its variance is 2n + n/m, little more than chi-square's 2n.
        z = (dispersion - drawn.size) / np.sqrt(drawn.size * (2.0 + 1.0 / electrons))
        assert 2.0 * stats.norm.sf(abs(z)) > LEVEL / len(levels)


def test_dark_current_and_read_noise_add_their_variances(flat: Callable[..., lf.Image]) -> None:
    detector = replace(FINE, dark_current_e_s=5000.0, read_noise_e=10.0)
    drawn = detector.expose(flat(100.0)).electrons.ravel()
    mean, variance = 100.0 + 50.0, 100.0 + 50.0 + 100.0 + 1.0 / 12.0
    z = (drawn.mean() - mean) / np.sqrt(variance / drawn.size)
    ratio = drawn.var(ddof=1) / variance * (drawn.size - 1)
    assert 2.0 * stats.norm.sf(abs(z)) > LEVEL / 2
    tail = min(stats.chi2.sf(ratio, drawn.size - 1), stats.chi2.cdf(ratio, drawn.size - 1))
    assert 2.0 * tail > LEVEL / 2


def test_no_pixel_holds_more_than_the_full_well(flat: Callable[..., lf.Image]) -> None:
    detector = Detector(full_well_e=1000.0, read_noise_e=0.0, dark_current_e_s=0.0)
    exposed = detector.expose(flat(1500.0, detector))
    assert exposed.saturated.all()
    assert (exposed.counts == detector.white_level).all()
    below = detector.expose(flat(500.0, detector))
    assert not below.saturated.any()
    assert below.counts.max() < detector.white_level
    assert (detector.expose(flat(1e30, detector)).counts == detector.white_level).all()


def test_a_full_well_is_read_with_noise_as_any_other(flat: Callable[..., lf.Image]) -> None:
    """What is cut is the well, before the noise: about half of the saturated pixels are read below it."""
    detector = Detector(full_well_e=1000.0, read_noise_e=20.0, dark_current_e_s=0.0)
    exposed = detector.expose(flat(1500.0, detector))
    assert exposed.saturated.all()
    below = int((exposed.counts < detector.white_level).sum())
    chance = stats.norm.cdf(-0.5 * detector.electrons_per_count / detector.read_noise_e)
    assert stats.binomtest(below, exposed.counts.size, chance).pvalue > LEVEL


@pytest.mark.parametrize("bits", [1, 8, 12, 16])
def test_counts_are_the_nearest_steps(flat: Callable[..., lf.Image], bits: int) -> None:
    detector = Detector(full_well_e=6000.0, read_noise_e=0.0, dark_current_e_s=0.0, bits=bits, black_level=0)
    image = flat(3000.0, detector)
    counts = detector.expose(image).counts
    assert counts.max() < 2**bits
    fine = replace(FINE, full_well_e=65535.0, black_level=0).expose(image).counts  # the same electrons, one a count
    assert np.abs(counts - fine.astype(np.float64) * (2**bits - 1) / 6000.0).max() <= 0.5 + 1e-9


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_every_pixel_sees_the_colour_of_its_place(flat: Callable[..., lf.Image], pattern: str) -> None:
    for wavelength, colour in ((620.0, "R"), (530.0, "G"), (450.0, "B")):
        detector = replace(FINE, bayer=pattern)
        image = flat(1000.0, **{"transport.wavelengths_nm": (wavelength,)})
        # The pattern is that of the upright picture; the lens inverts, so its columns are reversed.
        expected = detector.expected_e(image)[:, ::-1]
        for place, filtered in enumerate(pattern):
            seen = expected[place // 2 :: 2, place % 2 :: 2]
            np.testing.assert_allclose(seen, 1000.0 * transmittance(filtered, (wavelength,))[0])
        brightest = np.argwhere(expected[:2, :2] == expected[:2, :2].max())
        assert {pattern[2 * row + column] for row, column in brightest} == {colour}


def test_a_seed_gives_one_exposure_and_the_image_stays(flat: Callable[..., lf.Image]) -> None:
    image = flat(200.0)
    before = image.mean.copy()
    one, again, other = (replace(FINE, seed=seed).expose(image).counts for seed in (3, 3, 4))
    np.testing.assert_array_equal(one, again)
    assert (one != other).mean() > 0.9
    np.testing.assert_array_equal(image.mean, before)


def test_filling_takes_the_bright_pixels_to_their_share(flat: Callable[..., lf.Image]) -> None:
    image = flat(7.0)
    assert FINE.filling(image, 0.5).expected_e(image).max() == pytest.approx(0.5 * FINE.full_well_e)
    image.mean[:] = 0.0
    with pytest.raises(lf.LfmeshError, match="the image is black"):
        FINE.filling(image)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("exposure_s", 0.0),
        ("exposure_s", float("nan")),
        ("quantum_efficiency", 1.2),
        ("full_well_e", float("inf")),
        ("dark_current_e_s", -1.0),
        ("read_noise_e", -1.0),
        ("bits", 17),
        ("black_level", 4095),
        ("bayer", "RGBG"),
        ("seed", -1),
    ],
)
def test_values_that_no_detector_has_are_named(field: str, value: Any) -> None:
    with pytest.raises(lf.LfmeshError, match=f"{field} = "):
        Detector(**{field: value})
