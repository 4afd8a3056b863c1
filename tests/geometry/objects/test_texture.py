"""Pictures: sRGB undone exactly, every depth and mode read alike, no picture refused in words."""

import numpy as np
import PIL.Image
import pytest

from lfmesh.errors import FileError
from lfmesh.geometry.objects import texture
from lfmesh.geometry.objects.texture import is_grey, load_texture, srgb_to_linear

RNG = np.random.default_rng(21)


def srgb(linear):
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def test_srgb_to_linear_undoes_the_standards_encoding():
    linear = np.linspace(0.0, 1.0, 4001)
    np.testing.assert_allclose(srgb_to_linear(srgb(linear)), linear, rtol=2e-7, atol=1e-7)
    # IEC 61966-2-1: half of the code range is 21.4 % of the light.
    assert srgb_to_linear(np.array(0.5)) == pytest.approx(0.21404114, rel=1e-6)


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "L", "LA", "P", "1", "I;16", "CMYK"])
def test_every_mode_is_read_as_linear_rgb(tmp_path, mode):
    values = np.array([[0, 255], [255, 0]], np.uint8)
    grey = PIL.Image.fromarray(values)
    picture = PIL.Image.fromarray(values.astype(np.uint16) * 257) if mode == "I;16" else grey.convert(mode)
    path = tmp_path / ("t.tif" if mode == "CMYK" else "t.png")
    picture.save(path)
    texture = load_texture(path)
    assert texture.dtype == np.float32
    assert is_grey(texture) == (mode in ("L", "I;16"))
    np.testing.assert_array_equal(texture, np.repeat(values[:, :, None] / 255.0, 3, axis=2))


def test_row_0_is_the_top_and_channels_are_red_green_blue(tmp_path):
    picture = np.zeros((4, 5, 3), np.uint8)
    picture[0, 3] = 255, 128, 64
    PIL.Image.fromarray(picture).save(tmp_path / "t.png")
    texture = load_texture(tmp_path / "t.png")
    np.testing.assert_allclose(texture[0, 3], srgb_to_linear(np.array([255, 128, 64]) / 255))
    assert texture.sum() == texture[0, 3].sum()


def test_jpeg(tmp_path):
    PIL.Image.fromarray(np.full((16, 16, 3), 128, np.uint8)).save(tmp_path / "t.jpg")
    np.testing.assert_allclose(load_texture(tmp_path / "t.jpg"), srgb_to_linear(np.array(128 / 255)), rtol=0.02)


def test_a_photograph_is_turned_upright_by_its_record(tmp_path):
    picture = PIL.Image.fromarray(np.zeros((8, 16, 3), np.uint8))
    record = picture.getexif()
    record[0x0112] = 6  # orientation: the top of the scene is the right of the file
    picture.save(tmp_path / "t.jpg", exif=record)
    assert load_texture(tmp_path / "t.jpg").shape == (16, 8, 3)


def test_sixteen_bits_in_grey_keep_their_depth(tmp_path):
    samples = RNG.integers(0, 65536, size=(6, 7)).astype(np.uint16)
    PIL.Image.fromarray(samples).save(tmp_path / "t.png")
    truth = np.repeat(srgb_to_linear(samples / 65535.0)[:, :, None], 3, axis=2)
    np.testing.assert_array_equal(load_texture(tmp_path / "t.png"), truth)


def test_what_is_no_picture_is_named(tmp_path):
    (tmp_path / "text.png").write_text("not a picture")
    (tmp_path / "empty.png").write_bytes(b"")
    PIL.Image.fromarray(RNG.integers(0, 255, (64, 64, 3)).astype(np.uint8)).save(tmp_path / "whole.png")
    (tmp_path / "short.png").write_bytes((tmp_path / "whole.png").read_bytes()[:3000])
    (tmp_path / "folder.png").mkdir()
    for name, reason in {
        "text.png": "not a picture",
        "empty.png": "not a picture",
        "short.png": "broken picture",
        "folder.png": "is a folder",
        "missing.png": "does not exist",
    }.items():
        with pytest.raises(FileError, match=reason) as raised:
            load_texture(tmp_path / name)
        message = str(raised.value)
        assert str(tmp_path / name) in message
        assert "\n" not in message


def test_no_other_program_is_started_for_a_picture(tmp_path):
    """Pillow reads PostScript by Ghostscript, whatever a file is called."""
    (tmp_path / "t.png").write_bytes(
        b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 10 10\n%%EndComments\nshowpage\n%%EOF\n"
    )
    with PIL.Image.open(tmp_path / "t.png") as picture:
        assert picture.format == "EPS"
    with pytest.raises(FileError, match="not a picture"):
        load_texture(tmp_path / "t.png")


def test_a_picture_with_too_many_pixels_is_refused_before_it_is_decoded(tmp_path, monkeypatch, recwarn):
    picture = PIL.Image.new("1", (64, 32))
    picture.save(tmp_path / "t.png")
    assert load_texture(tmp_path / "t.png").shape == (32, 64, 3)
    monkeypatch.setattr(PIL.Image.Image, "load", lambda *_: pytest.fail("decoded"))
    monkeypatch.setattr(texture, "MOST_PIXELS", 2047)
    with pytest.raises(FileError, match="has 64 × 32 pixels; give a picture of at most 2047"):
        load_texture(tmp_path / "t.png")
    for limit in (1500, 1000):
        # Pillow's own limits: of the one it warns, at twice the other it refuses.
        monkeypatch.setattr(PIL.Image, "MAX_IMAGE_PIXELS", limit)
        with pytest.raises(FileError, match="2047"):
            load_texture(tmp_path / "t.png")
    assert not recwarn.list


def test_bands_of_a_large_picture_join_without_a_seam(tmp_path, monkeypatch):
    samples = RNG.integers(0, 256, size=(23, 7, 3)).astype(np.uint8)
    PIL.Image.fromarray(samples).save(tmp_path / "t.png")
    whole = load_texture(tmp_path / "t.png")
    monkeypatch.setattr(texture, "_BAND_PIXELS", 14)
    np.testing.assert_array_equal(load_texture(tmp_path / "t.png"), whole)
    np.testing.assert_array_equal(whole, srgb_to_linear(samples / 255.0))
