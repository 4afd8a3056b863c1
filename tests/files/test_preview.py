"""Pictures: upright, exposed by themselves, and linear where they say so."""

from pathlib import Path

import numpy as np
import PIL.Image
import pytest

from lfmesh.files.colour import srgb_encode, srgb_weights, to_display
from lfmesh.files.preview import white_point, write_linear16, write_preview

GREEN = (550.0,)


def letter_f() -> np.ndarray:
    """A picture without any symmetry, (12, 10, 1) W."""
    picture = np.zeros((12, 10, 1))
    picture[1:11, 2] = picture[1, 2:8] = picture[5, 2:6] = 1e-12
    return picture


def read(path: Path) -> np.ndarray:
    with PIL.Image.open(path) as picture:
        return np.array(picture)


def test_a_preview_lies_as_the_picture_that_it_was_given(tmp_path: Path) -> None:
    given = letter_f()
    write_preview(tmp_path / "p.png", given, GREEN)
    picture = read(tmp_path / "p.png")
    assert picture.dtype == np.uint8
    np.testing.assert_array_equal(picture, np.where(given[:, :, 0] > 0, 255, 0))


@pytest.mark.parametrize("scale", [1e-18, 1e-9, 1.0, 1e6])
def test_preview_does_not_depend_on_the_power(tmp_path: Path, scale: float) -> None:
    raw = np.random.default_rng(0).random((40, 30, 1))
    write_preview(tmp_path / "a.png", raw, GREEN)
    white = write_preview(tmp_path / "b.png", raw * scale, GREEN)
    np.testing.assert_allclose(read(tmp_path / "a.png").astype(int), read(tmp_path / "b.png"), atol=1)
    assert white == pytest.approx(scale * np.percentile(raw, 99.5))


def test_a_firefly_does_not_darken_the_picture(tmp_path: Path) -> None:
    raw = np.full((50, 50, 1), 1e-12)
    raw[7, 9] = 1e-6
    write_preview(tmp_path / "p.png", raw, GREEN)
    assert read(tmp_path / "p.png").min() == 255


def test_pixels_that_are_hardly_known_do_not_set_the_exposure(tmp_path: Path) -> None:
    """2 % of the pixels hold one heavy sample each, more than the percentile forgives; their standard errors tell."""
    raw, stderr = np.full((50, 50, 1), 1e-12), np.full((50, 50, 1), 1e-13)
    raw[::10, ::5] = stderr[::10, ::5] = 1e-9
    assert write_preview(tmp_path / "p.png", raw, GREEN, stderr) == pytest.approx(1e-12)
    assert read(tmp_path / "p.png").min() == 255
    assert write_preview(tmp_path / "p.png", raw, GREEN) == pytest.approx(1e-9)
    for unknown in (raw, np.full_like(raw, np.nan)):
        assert write_preview(tmp_path / "p.png", raw, GREEN, unknown) == pytest.approx(1e-9)


def test_a_small_object_in_the_dark_is_seen(tmp_path: Path) -> None:
    raw = np.zeros((200, 200, 1))
    raw[100, 100:104, 0] = [1e-12, 2e-12, 3e-12, 4e-12]
    write_preview(tmp_path / "p.png", raw, GREEN)
    picture = read(tmp_path / "p.png")
    assert np.count_nonzero(picture) == 4
    assert len(np.unique(picture)) == 5, "its shades must not be burnt out"


def test_black_stays_black(tmp_path: Path) -> None:
    raw = np.zeros((5, 6, 1))
    assert write_preview(tmp_path / "p.png", raw, GREEN) == 0.0
    assert white_point(raw) == 0.0
    assert read(tmp_path / "p.png").max() == 0
    names, watts_per_count = write_linear16(tmp_path, raw, GREEN)
    assert watts_per_count == 0.0
    assert read(tmp_path / names[0]).max() == 0


def test_linear16_returns_the_power(tmp_path: Path) -> None:
    raw = np.random.default_rng(1).random((17, 13, 1)) * 3e-12
    names, watts_per_count = write_linear16(tmp_path, raw, GREEN)
    assert names == ["linear16.png"]
    counts = read(tmp_path / "linear16.png")
    assert counts.dtype == np.uint16
    assert counts.max() == 65535
    np.testing.assert_allclose(counts * watts_per_count, raw[:, :, 0], atol=0.5001 * watts_per_count)


def test_linear16_has_one_file_a_wavelength_and_one_scale(tmp_path: Path) -> None:
    raw = np.random.default_rng(2).random((9, 8, 3)) * np.array([1.0, 0.5, 0.1])
    names, watts_per_count = write_linear16(tmp_path, raw, (486.1, 587.6, 656.3))
    assert names == ["linear16_486.1nm.png", "linear16_587.6nm.png", "linear16_656.3nm.png"]
    for c, name in enumerate(names):
        np.testing.assert_allclose(read(tmp_path / name) * watts_per_count, raw[:, :, c], atol=0.5001 * watts_per_count)


def test_equal_power_is_white_and_single_wavelengths_have_their_colour() -> None:
    wavelengths = (450.0, 550.0, 650.0)
    rgb = to_display(np.array([[[1.0, 1.0, 1.0], [1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]]), wavelengths)[0]
    np.testing.assert_allclose(rgb[0], rgb[0].mean())
    assert [int(np.argmax(row)) for row in rgb[1:]] == [2, 1, 0]


@pytest.mark.parametrize("wavelengths", [(550.0,), (450.0, 650.0), (850.0, 900.0, 950.0)])
def test_samples_that_span_no_colours_give_grey(wavelengths: tuple[float, ...]) -> None:
    assert srgb_weights(wavelengths) is None
    assert to_display(np.ones((2, 3, len(wavelengths))), wavelengths).shape == (2, 3)


def test_colour_preview_is_rgb(tmp_path: Path) -> None:
    given = np.zeros((4, 4, 3))
    given[0, 0, 2] = given[3, 3, 0] = 1.0
    write_preview(tmp_path / "p.png", given, (450.0, 550.0, 650.0))
    picture = read(tmp_path / "p.png")
    assert picture.shape == (4, 4, 3)
    assert picture[0, 0].argmax() == 0, "650 nm is red"
    assert picture[3, 3].argmax() == 2


def test_srgb_encoding_at_known_values() -> None:
    """IEC 61966-2-1: 18 % grey is 118, half of the light 188."""
    np.testing.assert_array_equal(srgb_encode(np.array([0.0, 0.18, 0.5, 1.0, 2.0, -1.0])), [0, 118, 188, 255, 255, 0])
