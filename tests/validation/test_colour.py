"""Colour through the whole camera: a ColorChecker comes out as it was published.

Published: average of 30 charts, D. Pascale, BabelColor, "The ColorChecker Pages" (2012): chromaticities and luminances
under illuminant D50, from the same spectra that the scene has.
"""

import json
from pathlib import Path

import numpy as np
import PIL.Image
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.cli import main
from lfmesh.files.colour import srgb_weights
from lfmesh.optics.cie import named_spectrum, observer
from lfmesh.scene.camera.bands import Band, Centroids, passband, preset

D50_XY = (0.3457, 0.3585)
PUBLISHED_XYY = [
    (0.4325, 0.3788, 0.1034), (0.4191, 0.3748, 0.3525), (0.2761, 0.3004, 0.1847), (0.37, 0.4501, 0.1335),
    (0.302, 0.2877, 0.2324), (0.2856, 0.391, 0.4174), (0.5291, 0.4075, 0.3117), (0.2339, 0.2155, 0.114),
    (0.5008, 0.3293, 0.1979), (0.3326, 0.2556, 0.0644), (0.3989, 0.4998, 0.4435), (0.4962, 0.4428, 0.4358),
    (0.204, 0.1696, 0.0579), (0.327, 0.5033, 0.2307), (0.5709, 0.3298, 0.1268), (0.4694, 0.4732, 0.6081),
    (0.4177, 0.2704, 0.2007), (0.2151, 0.3037, 0.1903), (0.3488, 0.3628, 0.9129), (0.3451, 0.3596, 0.5885),
    (0.3446, 0.359, 0.3595), (0.3438, 0.3589, 0.1912), (0.3423, 0.3576, 0.0893), (0.3439, 0.3565, 0.032),
]  # fmt: skip
WHITE = 18
"""Number of the white patch."""

MIDDLE_PIXELS = 8
"""Side of the part of a patch that is looked at."""


def xyz_of(x: float, y: float, luminance: float) -> np.ndarray:
    return luminance / y * np.array([x, y, 1.0 - x - y])


def lab(xyz: np.ndarray, white: np.ndarray) -> np.ndarray:
    t = xyz / white
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], axis=-1)


def ciede2000(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """G. Sharma, W. Wu, E. N. Dalal, Color Res. Appl. 30 (2005) 21."""
    (l1, a1, b1), (l2, a2, b2) = np.moveaxis(one, -1, 0), np.moveaxis(other, -1, 0)
    mean = 0.5 * (np.hypot(a1, b1) + np.hypot(a2, b2))
    g = 0.5 * (1 - np.sqrt(mean**7 / (mean**7 + 25.0**7)))
    c1, c2 = np.hypot((1 + g) * a1, b1), np.hypot((1 + g) * a2, b2)
    h1, h2 = (np.degrees(np.arctan2(b, (1 + g) * a)) % 360 for a, b in ((a1, b1), (a2, b2)))
    dh = np.where(np.abs(h2 - h1) <= 180, h2 - h1, np.where(h2 <= h1, h2 - h1 + 360, h2 - h1 - 360))
    dh = np.where(c1 * c2 == 0, 0.0, dh)
    total = h1 + h2
    h = np.where(np.abs(h1 - h2) <= 180, total / 2, np.where(total < 360, (total + 360) / 2, (total - 360) / 2))
    h = np.where(c1 * c2 == 0, total, h)
    lm, cm = (l1 + l2) / 2, (c1 + c2) / 2
    cos = lambda degrees: np.cos(np.radians(degrees))  # noqa: E731
    t = 1 - 0.17 * cos(h - 30) + 0.24 * cos(2 * h) + 0.32 * cos(3 * h + 6) - 0.2 * cos(4 * h - 63)
    sl = 1 + 0.015 * (lm - 50) ** 2 / np.sqrt(20 + (lm - 50) ** 2)
    sc, sh = 1 + 0.045 * cm, 1 + 0.015 * cm * t
    turn = -2 * np.sqrt(cm**7 / (cm**7 + 25.0**7)) * np.sin(np.radians(60 * np.exp(-(((h - 275) / 25) ** 2))))
    dl, dc, dq = (l2 - l1) / sl, (c2 - c1) / sc, 2 * np.sqrt(c1 * c2) * np.sin(np.radians(dh / 2)) / sh
    return np.sqrt(dl**2 + dc**2 + dq**2 + turn * dc * dq)


def test_the_difference_of_colours_is_the_published_one() -> None:
    """Sharma's test data, pairs 1, 7, 17 and 25."""
    pairs = np.array([
        [[50, 2.6772, -79.7751], [50, 0, -82.7485]], [[50, 0, 0], [50, -1, 2]],
        [[50, 2.5, 0], [73, 25, -18]], [[60.2574, -34.0099, 36.2677], [60.4626, -34.1751, 39.4387]],
    ])  # fmt: skip
    np.testing.assert_allclose(ciede2000(pairs[:, 0], pairs[:, 1]), [2.0425, 2.3669, 27.1492, 1.2644], atol=1e-4)


def patches(image: lf.Image) -> np.ndarray:
    """Return the mean of the middle of each patch, (24, channels)."""
    facts = lf.first_order(image.scene)
    pixel = image.scene.camera.sensor.pixel_mm / abs(facts.magnification)
    picture = image.mean[:, ::-1]
    rows, columns = picture.shape[:2]
    found = []
    for target in image.scene.targets:
        x, y, _ = target.position_mm
        column, row = (columns - MIDDLE_PIXELS + 1) / 2 + x / pixel, (rows - MIDDLE_PIXELS + 1) / 2 - y / pixel
        part = np.s_[round(row) : round(row) + MIDDLE_PIXELS, round(column) : round(column) + MIDDLE_PIXELS]
        found.append(picture[part].mean(axis=(0, 1)))
    return np.array(found)


def render(seed: int, light: str, samples: int, **more: int) -> lf.Image:
    scene = lf.load(asset_path("scenes/color_checker.toml"))
    return lf.render(
        scene.changed({"lights[0].spectrum": light, "transport.samples": samples, "transport.seed": seed, **more})
    )


@pytest.mark.long
def test_a_color_checker_comes_out_as_published() -> None:
    """Under the illuminant of the published values, normalised to the white patch: below 0.5, with noise below 0.1.

    The noise is the root mean square of what one render differs by, from two with independent seeds. The published
    values are those of the spectra, integrated by hand, within 0.21.
    """
    white = xyz_of(*D50_XY, 1.0)
    wanted = np.array([xyz_of(*each) for each in PUBLISHED_XYY])
    seen = [patches(render(seed, "D50", 1024, **{"transport.replicates": 8})) for seed in (1, 2)]
    labs = [lab(found * (wanted[WHITE, 1] / found[WHITE, 1]), white) for found in seen]
    for found in labs:
        assert ciede2000(found, lab(wanted, white)).max() < 0.5
    assert np.sqrt((ciede2000(*labs) ** 2).mean() / 2.0) < 0.1


def test_under_d65_its_picture_has_the_colours_of_its_spectra(tmp_path: Path) -> None:
    """As integrated by hand; the picture's white is D65, so that the grey patches are grey."""
    image = render(3, "D65", 64)
    w = np.arange(380.0, 781.0)
    light = np.interp(w, *named_spectrum("D65"))
    spectra = [target.material.reflectance for target in image.scene.targets]
    by_hand = np.array([observer(w) @ (light * np.interp(w, s.wavelengths_nm, s.values)) for s in spectra])
    white = observer(w) @ light
    found = patches(image)
    found *= by_hand[WHITE, 1] / found[WHITE, 1]
    off = ciede2000(lab(found, white), lab(by_hand, white))
    assert off.max() < 1.5, "noise, mostly"
    assert np.median(off) < 0.4
    lf.save(image, tmp_path / "run")
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert report["pictures"]["preview.png"]["white_point"] == "D65"
    assert {path.name for path in (tmp_path / "run").glob("linear16*")} == {f"linear16_{name}.png" for name in "XYZ"}
    again = lf.open_run(tmp_path / "run")
    assert again.channel_names == ("X", "Y", "Z")
    with PIL.Image.open(tmp_path / "run" / "preview.png") as picture:
        shown = np.asarray(picture).astype(float)
    pixel = image.scene.camera.sensor.pixel_mm / abs(lf.first_order(image.scene).magnification)
    x, y, _ = image.scene.targets[20].position_mm
    grey = shown[round(39.5 - y / pixel) - 3 :, round(59.5 + x / pixel) - 3 :][:7, :7].mean(axis=(0, 1))
    assert np.ptp(grey) < 3.0
    red = shown[
        round(39.5 - image.scene.targets[14].position_mm[1] / pixel),
        round(59.5 + image.scene.targets[14].position_mm[0] / pixel),
    ]
    assert red.argmax() == 0


def test_weights_of_the_observers_bands_are_the_standards_matrix() -> None:
    weights = srgb_weights(Centroids.of(preset("xyz")))
    matrix = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
    np.testing.assert_allclose(weights / weights[0, 0], matrix / matrix[0, 0], atol=2e-4)


def test_weights_of_other_bands_keep_white_and_find_hues() -> None:
    weights = srgb_weights(Centroids.of(preset("rgb")))
    w = np.arange(380.0, 781.0)
    light = np.interp(w, *named_spectrum("D65"))
    responses = np.array(
        [np.interp(w, b.response.wavelengths_nm, b.response.values, left=0, right=0) for b in preset("rgb")]
    )
    rgb = weights @ (responses @ light)
    np.testing.assert_allclose(rgb, rgb.mean(), rtol=1e-12)
    for line, primary in ((460.0, 2), (535.0, 1), (630.0, 0)):
        assert (weights @ responses[:, int(line - 380.0)]).argmax() == primary


@pytest.mark.parametrize("centres", [(850.0, 900.0, 950.0), (540.0, 541.0, 900.0), (450.0, 550.0)])
def test_bands_that_tell_no_colours_apart_give_grey(centres: tuple[float, ...]) -> None:
    bands = tuple(
        passband(Band(name=f"b{i}", center_nm=centre, fwhm_nm=20.0), None) for i, centre in enumerate(centres)
    )
    assert srgb_weights(Centroids.of(bands)) is None


def test_a_mosaic_of_bands_becomes_an_upright_picture(tmp_path: Path) -> None:
    scene = lf.load(asset_path("scenes/color_checker.toml"))
    image = lf.render(scene.changed({"camera.sensor.bands": "rgb", "transport.samples": 16}))
    lf.save(image, tmp_path / "run")
    assert main(["expose", str(tmp_path / "run"), "--bayer", "GRBG", "--read-noise-e", "0"]) == 0
    with PIL.Image.open(tmp_path / "run" / "exposed_preview.png") as picture:
        shown = np.asarray(picture).astype(float)
    pixel = image.scene.camera.sensor.pixel_mm / abs(lf.first_order(image.scene).magnification)

    def at(number: int) -> np.ndarray:
        x, y, _ = image.scene.targets[number].position_mm
        return shown[round(39.5 - y / pixel) - 3 :, round(59.5 + x / pixel) - 3 :][:7, :7].mean(axis=(0, 1))

    assert [int(at(number).argmax()) for number in (14, 13, 12)] == [0, 1, 2], "red, green, blue"
    assert np.ptp(at(20)) < 8.0, "grey"
    with pytest.raises(lf.LfmeshError, match="a detector without filters sees one band"):
        lf.Detector().expose(image)
    other = scene.changed({"camera.sensor.bands": [{"name": "one", "center_nm": 550.0, "fwhm_nm": 50.0}]})
    with pytest.raises(lf.LfmeshError, match="its filters see the bands R, G and B"):
        lf.Detector(bayer="RGGB").electrons_per_watt(other.wavelengths_nm)
