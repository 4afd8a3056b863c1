"""Lines of bands: what they integrate, and which samples take them."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.optics.cie import NAMED, named_spectrum, planck_radiance
from lfmesh.optics.curve import Curve
from lfmesh.optics.glass import absorption_per_mm, refractive_index
from lfmesh.transport.packets.random import descendant, wavelength_numbers
from lfmesh.transport.sources.wavelengths import entries_of_pixels, order_of_packets, order_of_particles
from lfmesh.transport.tables.lines import Lines, Nodes
from lfmesh.transport.tables.volumes import _planck_constants as planck_of_lines
from tests.cameras import camera_without_array

Array = NDArray[np.float64]

GAUSSIANS = [{"name": f"g{width:g}", "center_nm": 550.0, "fwhm_nm": width} for width in (10.0, 20.0, 50.0, 90.0)]
GLASSES = ("SCHOTT/N-BK7", "SCHOTT/N-SF11", "SCHOTT/N-SF57", "SCHOTT/N-FK51A", "OHARA/S-LAH79", "HOYA/TAF1")
HIGH, LOW = 2.3, 1.46


def scene(bands: object, **transport: object) -> lf.Scene:
    camera = camera_without_array(pixels=7)
    return lf.Scene(camera=camera | {"sensor": camera["sensor"] | {"bands": bands}}, transport=transport)


def reflectance(layers: list[tuple[float, float]], wavelength_nm: Array) -> Array:
    """Reflectance of a stack on glass of n = 1.52 at normal incidence, by characteristic matrices (Macleod 2.126)."""
    b, c = np.ones(len(wavelength_nm), complex), np.full(len(wavelength_nm), 1.52, complex)
    for index, thickness_nm in layers[::-1]:
        phase = 2.0 * np.pi * index * thickness_nm / wavelength_nm
        b, c = np.cos(phase) * b + 1j * np.sin(phase) / index * c, 1j * index * np.sin(phase) * b + np.cos(phase) * c
    return np.abs((b - c) / (b + c)) ** 2


def quarter(index: float, wavelength_nm: float) -> tuple[float, float]:
    return index, wavelength_nm / 4.0 / index


COATINGS = {
    "one layer": [quarter(1.38, 550.0)],
    "three layers": [quarter(1.38, 550.0), quarter(2.1, 275.0), quarter(1.7, 550.0)],
    "mirror": [*([quarter(HIGH, 580.0), quarter(LOW, 580.0)] * 7), quarter(HIGH, 580.0)],
}


def factors() -> Iterator[tuple[str, Callable[[Array], Array]]]:
    """Yield what multiplies the light of a scene, from 0 to 1, by wavelength."""
    chart = lf.load(asset_path("scenes/color_checker.toml"))
    for target in chart.targets:
        given = target.material.reflectance
        yield target.name, Curve(np.array(given.wavelengths_nm), np.array(given.values)).at
    for name, layers in COATINGS.items():
        yield f"through {name}", lambda w, layers=layers: 1.0 - reflectance(layers, w)
        yield f"a ghost of {name}", lambda w, layers=layers: reflectance(layers, w) ** 2
    for glass in GLASSES:
        n = Curve(W := np.arange(380.0, 781.0), np.array([refractive_index(glass, w) for w in W]))
        inside = Curve(W, np.array([absorption_per_mm(glass, w) for w in W]))
        yield f"through {glass}", lambda w, n=n: 1.0 - ((n.at(w) - 1.0) / (n.at(w) + 1.0)) ** 2
        yield f"within {glass}", lambda w, inside=inside: np.exp(-30.0 * inside.at(w))


@pytest.mark.parametrize("bands", ["xyz", "rgb", GAUSSIANS], ids=["xyz", "rgb", "Gaussians"])
def test_sums_over_lines_are_the_integrals_over_bands(bands: object) -> None:
    """Within 1e-3 of what a white surface gives, under every illuminant."""
    one = scene(bands)
    lines = Lines.of(one)
    lights = [Curve(*named_spectrum(name)) for name in NAMED]
    of_lines = np.array([lines.mean(light) for light in lights])
    w = np.concatenate([np.linspace(*band.response.ends_nm, 4001) for band in one.passbands]).reshape(-1, 4001)
    seen = [light.at(w) * [band.response.at(x) for x, band in zip(w, one.passbands, strict=True)] for light in lights]
    for name, factor in factors():
        at_lines, at_all = factor(np.array(lines.wavelengths_nm)), factor(w.ravel()).reshape(w.shape)
        for channel, nodes in enumerate(lines.nodes):
            chance = np.diff(nodes.until, prepend=0.0)
            some = slice(nodes.first, nodes.first + len(chance))
            found = (of_lines * at_lines)[:, some] @ chance * lines.weight_nm[nodes.first]
            light = np.array([each[channel] for each in seen])
            white = np.trapezoid(light, w[channel])
            error = np.abs(found - np.trapezoid(light * at_all[channel], w[channel])) / white
            assert error.max() < 1e-3, (name, one.passbands[channel].name, NAMED[error.argmax()], error.max())


def test_a_single_line_in_the_middle_would_not_do() -> None:
    """The measure of the test above fails a band that one wavelength stands for."""
    one = scene("xyz")
    response = one.passbands[0].response
    w = np.linspace(*response.ends_nm, 8001)
    name, red = next(each for each in factors() if each[0] == "red")
    exact = np.trapezoid(response.at(w) * red(w), w) / response.area_nm
    assert abs(red(np.array([response.centroid_nm]))[0] - exact) > 0.01, name


def test_without_bands_the_lines_are_the_wavelengths_in_their_order() -> None:
    lines = Lines.of(scene(None, wavelengths_nm=[600.0, 500.0]))
    assert lines.wavelengths_nm == (600.0, 500.0)
    assert not lines.in_bands
    np.testing.assert_array_equal(lines.power(3.0), [3.0, 3.0])
    np.testing.assert_array_equal(lines.mean(Curve(np.array([500.0, 600.0]), np.array([1.0, 2.0]))), [2.0, 1.0])
    for channel, nodes in enumerate(lines.nodes):
        ((column, entries),) = entries_of_pixels(nodes, np.arange(9), 12, np.uint64(1))
        assert column == channel
        assert entries.taken.tolist() == [12] * 9


def test_no_sample_takes_a_gap_in_a_response(tmp_path) -> None:
    """And no line stands for light on both of its sides."""
    (tmp_path / "two.csv").write_text("wavelength_nm,response\n400,0\n430,1\n460,0\n600,0\n630,1\n660,0\n")
    one = scene([{"name": "two", "response": str(tmp_path / "two.csv")}])
    lines = Lines.of(one)
    (nodes,) = lines.nodes
    taken = np.array(lines.wavelengths_nm)[nodes.columns(np.linspace(0.0, 1.0, 10_001)[:-1])]
    assert not ((taken > 460.0) & (taken < 600.0)).any()
    np.testing.assert_allclose((taken < 500.0).mean(), 0.5, atol=1e-3)


def columns_of(
    nodes: Nodes, pixels: NDArray[np.int64], samples: int, key: np.uint64, pieces: tuple[range | None, ...] = (None,)
) -> NDArray[np.int64]:
    """Return the column of every sample of every pixel, (pixels, samples); each must have one."""
    found = np.full((len(pixels), samples), -1)
    started = [each for some in pieces for each in entries_of_pixels(nodes, pixels, samples, key, some=some)]
    for column, entries in started:
        np.testing.assert_array_equal(entries.pixel, pixels[entries.place])
        place, sample = np.repeat(entries.place, entries.taken), np.repeat(entries.begin, entries.taken)
        sample += np.arange(len(sample)) - np.repeat(np.cumsum(entries.taken) - entries.taken, entries.taken)
        assert (found[place, sample] == -1).all()
        found[place, sample] = column
    assert (found >= 0).all()
    return found


def test_samples_that_start_in_pieces_take_the_lines_of_the_whole() -> None:
    pixels, key = np.arange(3, 12), descendant(5, 1)
    for nodes in (Lines.of(scene("xyz")).nodes[0], Nodes.single(2)):
        whole = columns_of(nodes, pixels, 100, key)
        pieces = columns_of(nodes, pixels, 100, key, (range(37), range(37, 38), range(38, 100)))
        np.testing.assert_array_equal(pieces, whole)


@pytest.mark.parametrize("samples", [1, 2, 3, 8, 12, 64, 100])
def test_every_sample_takes_a_line_by_its_chance(samples: int) -> None:
    """Chi-squared over pixels on the first, the middle and the last sample: level 1e-3 over 21 tests."""
    nodes = Lines.of(scene("xyz")).nodes[0]
    found = columns_of(nodes, np.arange(3000), samples, descendant(5, samples)) - nodes.first
    chance = np.diff(nodes.until, prepend=0.0)
    few = np.cumsum(chance * 3000.0 / 25.0).astype(int)
    for sample in {0, samples // 2, samples - 1}:
        count = np.bincount(few, np.bincount(found[:, sample], minlength=len(chance)))
        expected = np.bincount(few, 3000.0 * chance)
        lit = expected > 0.0
        assert stats.chisquare(count[lit], expected[lit]).pvalue > 1e-3 / 21.0


@pytest.mark.parametrize("samples", [8, 27, 64])
def test_samples_of_a_pixel_lie_evenly_over_the_band(samples: int) -> None:
    """Any part of a band is taken as often as its share of the response asks for, within two samples."""
    nodes = Lines.of(scene("xyz")).nodes[0]
    found = columns_of(nodes, np.arange(50), samples, np.uint64(3)) - nodes.first
    for part in range(1, len(nodes.until)):
        share = (found < part).sum(axis=1)
        assert (np.abs(share - samples * nodes.until[part - 1]) <= 2.0).all()


def test_pixels_have_offsets_of_their_own() -> None:
    """Neighbours and replicates are not alike: correlation at 1e-3 of 4000 pairs."""
    first, second = (wavelength_numbers(descendant(8, replicate), np.arange(4001)) for replicate in (0, 1))
    assert stats.kstest(first, "uniform").pvalue > 1e-3
    for one, other in ((first[1:], first[:-1]), (first, second)):
        assert abs(np.corrcoef(one, other)[0, 1]) < 3.3 / np.sqrt(len(one))


def test_packets_of_lights_and_particles_lie_evenly_over_the_band() -> None:
    """Any run of a light's packets does, and the packets of each particle do; each packet is there once."""
    nodes = Lines.of(scene("rgb")).nodes[1]
    chance = np.diff(nodes.until, prepend=0.0)
    numbers, columns = order_of_packets(nodes, np.arange(10_000, 14_000), np.uint64(6))
    assert sorted(numbers) == list(range(10_000, 14_000))
    assert (np.diff(columns) >= 0).all()
    count = np.bincount(columns - nodes.first, minlength=len(chance))
    np.testing.assert_allclose(count, 4000 * chance, atol=20.0)
    numbers, columns = order_of_particles(nodes, np.arange(40 * 16), 40, 16, np.uint64(7))
    assert sorted(numbers) == list(range(40 * 16))
    half = nodes.first + np.searchsorted(nodes.until, 0.5)
    below = np.bincount(numbers[columns < half] % 40, minlength=40)
    assert (np.abs(below - 16.0 * nodes.until[half - nodes.first - 1]) <= 2.0).all()
    assert len(np.unique(columns[numbers < 40])) > 10


def test_power_is_spread_over_the_bands() -> None:
    """A power of 1 over all wavelengths is found again in a box that reaches over all of them."""
    one = scene(
        [{"name": "a", "center_nm": 500.0, "fwhm_nm": 60.0}, {"name": "b", "center_nm": 600.0, "fwhm_nm": 60.0}]
    )
    lines = Lines.of(one)
    first, last = one.reach_nm
    assert (first, last) == (410.0, 690.0)
    for shape in (None, Curve(*named_spectrum("FL11"))):
        density = Curve(np.array([first, last]), np.full(2, 1.0 / (last - first))) if shape is None else shape
        w = np.linspace(first, last, 200_001)
        total = np.trapezoid(density.at(w), w)
        power = lines.power(1.0, shape)
        for nodes, band in zip(lines.nodes, one.passbands, strict=True):
            response = np.interp(w, band.response.wavelengths_nm, band.response.values, left=0.0, right=0.0)
            expected = np.trapezoid(density.at(w) * response, w) / total
            chance = np.diff(nodes.until, prepend=0.0)
            found = (power[nodes.first : nodes.first + len(chance)] * chance).sum()
            np.testing.assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.parametrize("temperature_k", [800.0, 1500.0, 3000.0])
@pytest.mark.parametrize("bands", ["xyz", "rgb"])
def test_flames_by_temperature_have_plancks_light_in_a_band(bands: str, temperature_k: float) -> None:
    one = scene(bands)
    lines = Lines.of(one)
    first, second = planck_of_lines(lines)
    found = first / np.expm1(second / temperature_k)
    for nodes, band in zip(lines.nodes, one.passbands, strict=True):
        w = np.linspace(*band.response.ends_nm, 20_001)
        expected = np.trapezoid(band.response.at(w) * planck_radiance(w, temperature_k), w)
        chance = np.diff(nodes.until, prepend=0.0)
        of_band = found[nodes.first : nodes.first + len(chance)] @ chance
        np.testing.assert_allclose(of_band, expected, rtol=1e-3)
