"""Lines of bands: how they are drawn, and which samples take them."""

from math import gcd

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.optics.cie import named_spectrum
from lfmesh.optics.curve import Curve
from lfmesh.transport.packets.random import descendant
from lfmesh.transport.tables.lines import Lines, Turn, _hashed
from tests.cameras import camera_without_array


def scene(bands: object, **transport: object) -> lf.Scene:
    camera = camera_without_array(pixels=7)
    return lf.Scene(camera=camera | {"sensor": camera["sensor"] | {"bands": bands}}, transport=transport)


def test_without_bands_the_lines_are_the_wavelengths_in_their_order() -> None:
    lines = Lines.of(scene(None, wavelengths_nm=[600.0, 500.0]))
    assert lines.wavelengths_nm == (600.0, 500.0)
    assert not lines.in_bands
    np.testing.assert_array_equal(lines.power(3.0), [3.0, 3.0])
    for channel in range(2):
        (turn,) = lines.turns(5, channel)
        assert turn.column == channel
        np.testing.assert_array_equal(turn.begin(np.arange(9), 12), np.zeros(9))


def test_lines_have_the_distribution_of_the_response() -> None:
    """Kolmogorov and Smirnov on the lines of many seeds, one of each replicate and interval: level 1e-3, 3 bands."""
    shares: list[list[float]] = [[], [], []]
    for seed in range(30):
        one = scene("xyz", seed=seed, samples=64, replicates=8)
        lines = Lines.of(one)
        for channel, band in enumerate(one.passbands):
            for replicate in range(8):
                turns = list(lines.turns(replicate, channel))
                w = lines.wavelengths_nm[turns[(replicate + seed) % len(turns)].column]
                shares[channel].append(band.response.integral(380.0, w) / band.response.area_nm)
    for channel in range(3):
        assert stats.kstest(shares[channel], "uniform").pvalue > 1e-3 / 3.0


def test_lines_integrate_exactly_what_is_linear_in_the_share_of_the_response() -> None:
    one = scene("rgb", replicates=4, samples=4)
    lines = Lines.of(one)
    for channel, band in enumerate(one.passbands):
        first = band.response.ends_nm[0]
        for replicate in range(4):
            w = [lines.wavelengths_nm[turn.column] for turn in lines.turns(replicate, channel)]
            shares = [band.response.integral(first, each) / band.response.area_nm for each in w]
            np.testing.assert_allclose(np.mean(shares), 0.5, atol=1e-9)


def test_replicates_have_lines_of_their_own() -> None:
    lines = Lines.of(scene("rgb", replicates=4, samples=16, target_error=0.01))
    assert len(lines.columns) == 8
    assert len(np.unique(lines.columns)) == lines.columns.size == len(set(lines.wavelengths_nm))
    assert np.all(np.diff(lines.wavelengths_nm) > 0.0)


@pytest.mark.parametrize("samples", [1, 2, 3, 5, 8, 12, 16, 64])
@pytest.mark.parametrize("few", [False, True])
def test_every_sample_takes_one_line(samples: int, few: bool) -> None:
    lines = Lines.of(scene("rgb", replicates=2, samples=8))
    pixels = np.arange(5, 300)
    taken = np.zeros((len(pixels), samples), np.int64)
    for turn in lines.turns(1, 2, few=few):
        mine = turn.takes(pixels, samples)
        for place in np.flatnonzero(mine):
            begin = int(turn.begin(pixels[place : place + 1], samples)[0])
            taken[place, begin : begin + samples // turn.shares(samples)] += 1
    assert (taken == 1).all()


@pytest.mark.parametrize("samples", [1, 4, 8, 12])
def test_every_line_is_taken_as_often_whatever_the_sample(samples: int) -> None:
    """Over the keys, so that no sample of a pixel prefers a part of the band: chi-squared at 1e-3 over four tests."""
    count = np.zeros((16, samples))
    pixels = np.array([77])
    for key in range(1600):
        for line in range(16):
            turn = Turn(line, 16, line, 0, descendant(9, key))
            if turn.takes(pixels, samples)[0]:
                begin = int(turn.begin(pixels, samples)[0])
                count[line, begin : begin + samples // turn.shares(samples)] += 1
    assert (count.sum(axis=0) == 1600).all()
    for of_sample in count.T:
        assert stats.chisquare(of_sample).pvalue > 1e-3 / 25


@pytest.mark.parametrize("samples", [1, 2, 8, 16])
def test_neighbours_share_the_band_and_not_their_errors(samples: int) -> None:
    """What pixels see of a band of which the half is dark is not alike in them.

    The error of a sum over 8 x 8 pixels is then no larger than that of as many independent ones, and that of pixels
    which take all lines together is that of the lines alone. Variances over 400 keys: a ratio of 1.3 is 4 standard
    errors.
    """
    row = 24
    x, y = np.meshgrid(np.arange(5, 13), np.arange(3, 11))
    block, together = (y * row + x).ravel(), np.arange(32, 64)
    own, sums, exact = [], [], []
    for key in range(400):
        lit = np.zeros(24 * row)
        for line in range(32):
            turn = Turn(line, 32, line, 0, descendant(4, key))
            shares = turn.shares(samples)
            mine = turn.takes(np.arange(len(lit)), samples)
            lit[mine] += (line < 11) / shares
        own.append(lit[block].var())
        sums.append(lit[block].sum())
        exact.append(lit[together].mean())
    if np.mean(own) > 0.0:
        assert np.var(sums) < 1.3 * 64.0 * np.mean(own) * 64.0 / 63.0
    np.testing.assert_allclose(exact, 11.0 / 32.0, rtol=1e-12)


def test_hashes_of_arrays_are_those_of_packets() -> None:
    numbers = np.arange(0, 10**12, 10**11 + 7)
    expected = [int(descendant(12345, int(number))) for number in numbers]
    assert _hashed(np.uint64(12345), numbers).tolist() == expected


def test_packets_of_lights_take_the_lines_in_equal_parts() -> None:
    for total in (1, 6, 16, 48, 100):
        for offset in range(16):
            parts = [Turn(line, 16, line, offset, np.uint64(0)).part(total) for line in range(16)]
            lit = [part for part in parts if len(part)]
            assert sorted(number for part in lit for number in part) == list(range(total))
            assert len({len(part) for part in lit}) == 1
            assert len(lit) <= gcd(total, 16)


def test_power_is_spread_over_the_bands() -> None:
    """A power of 1 over all wavelengths is found again in a box that reaches over all of them."""
    one = scene(
        [{"name": "a", "center_nm": 500.0, "fwhm_nm": 60.0}, {"name": "b", "center_nm": 600.0, "fwhm_nm": 60.0}]
    )
    lines = Lines.of(one)
    first, last = one.reach_nm
    assert (first, last) == (410.0, 690.0)
    for shape in (None, Curve(*named_spectrum("D65"))):
        density = Curve(np.array([first, last]), np.full(2, 1.0 / (last - first))) if shape is None else shape
        w = np.linspace(first, last, 200_001)
        total = np.trapezoid(density.at(w), w)
        power = lines.power(1.0, shape)
        for channel, band in enumerate(one.passbands):
            columns = [turn.column for replicate in range(8) for turn in lines.turns(replicate, channel)]
            response = np.interp(w, band.response.wavelengths_nm, band.response.values, left=0.0, right=0.0)
            expected = np.trapezoid(density.at(w) * response, w) / total
            # Lines of eight replicates: quadrature with 128 random points.
            np.testing.assert_allclose(power[columns].mean(), expected, rtol=5e-3)
