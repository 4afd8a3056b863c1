"""The matrix of ghosts holds the two-reflection paths, each at the pair of surfaces that light meets in turn."""

from dataclasses import replace

import numpy as np
import PIL.Image
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene import load_lens
from lfmesh.view.figure_file import encoded_figure
from lfmesh.view.rays.ghosts import ghost_matrix, in_cell
from lfmesh.view.rays.launch import from_field_point, from_pixels
from lfmesh.view.rays.paths import standard_errors


@pytest.fixture(scope="module")
def world():
    camera = lf.Camera(
        lens=load_lens(asset_path("lenses/double_gauss_50mm.toml")),
        focus_mm=500.0,
        mla=lf.MicrolensArray(count=(40, 40), pitch_mm=0.125, focal_length_mm=0.5, index=1.5, thickness_mm=0.3),
        sensor=lf.Sensor(pixels=(50, 50), pixel_mm=0.1),
    )
    return lf.build(lf.Scene(camera=camera))


@pytest.fixture(scope="module")
def rays(world):
    return from_field_point(world, (4.0, 3.0, -500.0), 300, aim="lens", weight_cutoff=5e-4)


def test_cells_are_the_power_of_their_paths(rays):
    matrix = ghost_matrix(rays)
    expected = np.zeros_like(matrix.power)
    for path in np.flatnonzero(rays.status == lf.Status.SENSOR):
        part = range(rays.offsets[path], rays.offsets[path + 1])
        mirrors = [rays.surfaces[rays.surface[v]] for v in part if rays.event[v] == lf.Event.REFLECTED]
        if len(mirrors) == 2:
            expected[tuple(matrix.names.index(name) for name in mirrors)] += rays.end_power[path]
    assert (expected > 0.0).sum() > 20
    np.testing.assert_allclose(matrix.power, expected, rtol=1e-12)
    assert matrix.total == pytest.approx(rays.end_power[rays.status == lf.Status.SENSOR].sum(), rel=1e-12)
    assert matrix.labels == [
        "L1a", "L1b", "L2a", "L2b", "L3b", "L4a", "L4b", "L5b", "L6a", "L6b", "MLAc", "MLAf"
    ]  # fmt: skip


def test_light_is_first_reflected_by_the_surface_nearer_to_the_sensor(world, rays):
    """Also where the rays were launched from the sensor and met the surfaces the other way round."""
    adjoint = from_pixels(world, range(20, 30), range(20, 30), 1000, weight_cutoff=1e-3)
    for some in (rays, adjoint):
        power = ghost_matrix(some).power
        assert power.sum() > 0.0
        np.testing.assert_array_equal(np.triu(power), 0.0)


def test_the_strongest_pairs_come_first(rays):
    matrix = ghost_matrix(rays)
    pairs = matrix.strongest(5)
    assert [power for *_, power in pairs] == sorted(matrix.power.ravel(), reverse=True)[:5]
    first, second, power = pairs[0]
    assert matrix.power[matrix.names.index(first), matrix.names.index(second)] == power
    assert len(matrix.strongest(10_000)) == (matrix.power > 0.0).sum()


def test_the_figure_names_rows_columns_and_colours(rays):
    matrix = ghost_matrix(rays)
    axes, bar = matrix.figure().axes
    assert [t.get_text() for t in axes.get_xticklabels()] == matrix.labels
    assert [t.get_text() for t in axes.get_yticklabels()] == matrix.labels
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("second reflection", "first reflection")
    assert "share of the power on the sensor" in bar.get_ylabel()
    image = axes.get_images()[0]
    np.testing.assert_allclose(image.get_array().filled(0.0), 100.0 * matrix.power / matrix.total)
    # Logarithmic: each factor of ten is as far in colour.
    norm = image.norm
    assert norm(norm.vmax) - norm(norm.vmax / 10) == pytest.approx(norm(norm.vmax / 10) - norm(norm.vmax / 100))
    numbers = {t.get_text() for t in axes.texts}
    place = np.unravel_index(matrix.power.argmax(), matrix.power.shape)
    share, error = (100.0 * values[place] / matrix.total for values in (matrix.power, matrix.error))
    assert in_cell(share, error) in numbers


def test_names_of_surfaces_are_no_mathematics(rays):
    matrix = ghost_matrix(rays)
    named = replace(matrix, labels=["a$b^$", *matrix.labels[1:]], source="$x^$ of y")
    axes, _ = named.figure().axes
    encoded_figure(axes.figure, "png", dpi=20)
    assert axes.get_xticklabels()[0].get_text() == "a$b^$"


def test_the_figure_fits_on_a_small_screen_and_its_numbers_into_their_cells(rays):
    figure = ghost_matrix(rays).figure()
    width, height = figure.get_size_inches() * figure.dpi
    assert width <= 1280
    assert height <= 800
    figure.canvas.draw()
    axes = figure.axes[0]
    cell = (
        axes.get_window_extent().width / len(axes.get_xticks()),
        axes.get_window_extent().height / len(axes.get_yticks()),
    )
    for text in axes.texts:
        box = text.get_window_extent()
        assert box.width < cell[0]
        assert box.height < cell[1]


def test_a_share_is_given_to_the_digit_of_its_error():
    assert in_cell(0.20173, 0.0031) == "0.202\n±0.003"
    assert in_cell(12.3, 2.0) == "12\n±2"
    assert in_cell(0.0123, 0.0) == "0.012", "exact"
    assert in_cell(2.1e-6, 0.0) == in_cell(2.1e-6, 3e-5) == "< 0.001"
    assert in_cell(0.0123, 2e-5) == "0.01230\n±0.00002", "decimals, however small the error is"


def test_errors_of_powers_are_what_independent_rays_scatter_by():
    """The mean stated variance against the variance over replicates: chi-square, 3 sums, 1e-4 in all."""
    random, replicates, launched = np.random.default_rng(5), 400, 60
    sums, stated = np.empty((replicates, 3)), np.empty((replicates, 3))
    for k in range(replicates):
        # Two paths a ray in the first sum, whose powers go together; a rare one in the second; the third has none.
        common = random.exponential(1.0, launched)
        rare = np.where(random.random(launched) < 0.1, random.exponential(5.0, launched), 0.0)
        power = np.concatenate([common, 0.5 * common, rare])
        source = np.tile(np.arange(launched), 3)
        group = np.repeat([0, 0, 1], launched)
        sums[k] = np.bincount(group, power, 3)
        stated[k] = standard_errors(power, source, group, 3)
    assert (stated[:, 2] == 0.0).all()
    ratio = (replicates - 1) * sums[:, :2].var(axis=0, ddof=1) / (stated[:, :2] ** 2).mean(axis=0)
    low, high = stats.chi2.ppf([0.5e-4 / 3, 1 - 0.5e-4 / 3], replicates - 1)
    # The sums are not normal: their kurtosis widens the interval.
    excess = stats.kurtosis(sums[:, :2], axis=0)
    wider = np.sqrt(1.0 + np.maximum(excess, 0.0) / 2.0)
    middle = replicates - 1
    assert (ratio > middle - wider * (middle - low)).all()
    assert (ratio < middle + wider * (high - middle)).all()


def test_pairs_that_only_some_rays_see_have_an_error(rays):
    matrix = ghost_matrix(rays)
    assert (matrix.error[matrix.power > 0.0] > 0.0).all()
    assert (matrix.error[matrix.power == 0.0] == 0.0).all()
    assert (matrix.error < matrix.power.max()).all()


def test_the_figure_is_written_as_its_ending_says(tmp_path, rays):
    matrix = ghost_matrix(rays)
    with PIL.Image.open(matrix.save(tmp_path / "ghosts.png")) as picture:
        assert np.ptp(np.asarray(picture.convert("L"))) > 100
    assert matrix.save(tmp_path / "ghosts.svg").read_text(encoding="utf-8").startswith("<?xml")
    with pytest.raises(lf.LfmeshError, match=r"one of \.svg, \.png, \.pdf"):
        matrix.save(tmp_path / "ghosts.tiff")
    with pytest.raises(lf.FileError):
        matrix.save(tmp_path / "nowhere" / "ghosts.png")
    assert sorted(f.name for f in tmp_path.iterdir()) == ["ghosts.png", "ghosts.svg"]


def test_without_ghosts_the_figure_is_refused_and_the_matrix_is_zero(world, tmp_path):
    matrix = ghost_matrix(from_field_point(world, (0.0, 0.0, -500.0), 50, split="transmit"))
    assert not matrix.power.any()
    assert matrix.strongest() == []
    with pytest.raises(lf.LfmeshError, match='split = "both"'):
        matrix.save(tmp_path / "ghosts.png")
    assert not list(tmp_path.iterdir())
