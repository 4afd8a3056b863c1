"""Exports read back by the readers that other people use, and hold what they say in the order that they say."""

import configparser
import json
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import PIL.Image
import pytest
import pyvista
from numpy.typing import NDArray
from scipy.io import loadmat

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.files import exr, run
from lfmesh.files.colour import srgb_weights
from lfmesh.files.exports.hci import CameraArray
from lfmesh.scene import Scene, first_order, loads, solved

Array = NDArray[Any]

CAMERA = """
schema_version = 1
camera.focus_mm = 500.0
camera.lens.surfaces = [
  {{ radius_mm = 50.0, thickness_mm = 4.0, index = 1.5, semi_diameter_mm = 8.0 }},
  {{ radius_mm = -50.0, thickness_mm = 3.0, semi_diameter_mm = 8.0 }},
  {{ stop = true, thickness_mm = 0.0, semi_diameter_mm = 3.0 }},
]
camera.mla = {{ layout = "{layout}", count = [8, 6], pitch_mm = 0.125, focal_length_mm = 0.7, index = 1.5, \
thickness_mm = 0.3 }}
camera.sensor = {{ pixels = [80, 64], pixel_mm = 0.0125 }}
transport = {{ replicates = 2, wavelengths_nm = {wavelengths} }}
"""


def scene_of(layout: str = "square", wavelengths: tuple[float, ...] = (587.6,)) -> Scene:
    return solved(loads(CAMERA.format(layout=layout, wavelengths=list(wavelengths))))


def image_of(scene: Scene, seed: int = 1) -> lf.Image:
    shape = (*scene.camera.sensor.pixels[::-1], scene.channels)
    mean = np.random.default_rng(seed).uniform(1.0, 2.0, shape) * 1e-12
    return lf.Image(mean, 0.1 * mean, scene, lf.Ledger(unit="W", emitted=1.0, escaped=1.0), 1.0, 2, 8.0, "by hand")


@pytest.fixture(scope="module")
def field() -> lf.LightField:
    """A light field with one sample missing."""
    field = lf.decode(image_of(scene_of()), views=5)
    data = field.data.copy()
    data[1, 2, 3, 4] = np.nan
    return replace(field, data=data)


@pytest.fixture
def ideal(field: lf.LightField, monkeypatch: pytest.MonkeyPatch) -> lf.LightField:
    """The same, its lens without aberrations: with them the focus follows no pinhole's law to the last digit."""
    monkeypatch.setitem(vars(field), "model", field.model.paraxial)
    return field


def png16(path: Path) -> Array:
    """Read by VTK, whose rows run from the bottom; pillow reads 8 bits only."""
    picture = pyvista.read(path)
    width, height, _ = picture.dimensions
    return np.asarray(picture["PNGImage"]).reshape(height, width, 3)[::-1]


def linear(srgb: Array) -> Array:
    """IEC 61966-2-1, inverse."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def test_the_toolbox_array_is_indexed_as_the_toolbox_does(field: lf.LightField, tmp_path: Path) -> None:
    lf.export_field(field, tmp_path / "mat", "lftoolbox")
    content = loadmat(tmp_path / "mat" / "lightfield.mat", simplify_cells=True)
    array, facts = content["LF"], content["LFMetadata"]
    assert array.dtype == np.uint16
    assert array.shape == (*field.views, *field.size, 4)
    known = np.isfinite(field.data[..., 0])
    np.testing.assert_array_equal(array[..., 3], np.where(known, 65535, 0))
    for c in range(3):
        light = array[..., c] * facts["unit_per_count"]
        np.testing.assert_allclose(light[known], field.data[..., 0][known], atol=0.51 * facts["unit_per_count"])
    assert facts["unit"] == "W per pixel"
    np.testing.assert_array_equal(facts["s_mm"], field.s_mm)


def with_black_corners(field: lf.LightField) -> lf.LightField:
    """The same, as a camera whose lens lights no corner of the micro-images has it."""
    data = field.data.copy()
    data[::4, ::4] = np.nan
    return replace(field, data=data)


def test_views_that_a_format_can_only_write_black_are_warned_of(field: lf.LightField, tmp_path: Path) -> None:
    whole = replace(field, data=np.nan_to_num(field.data))
    lf.export_field(whole, tmp_path / "whole", "views")
    with pytest.warns(UserWarning, match=r"^4 of 25 views .* 4 of them in all.*decode 3 views across"):
        lf.export_field(with_black_corners(whole), tmp_path / "views", "views")


def test_the_toolbox_array_says_itself_what_is_unknown(field: lf.LightField, tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        lf.export_field(with_black_corners(field), tmp_path / "mat", "lftoolbox")
    assert not loadmat(tmp_path / "mat" / "lightfield.mat")["LF"][::4, ::4, :, :, 3].any()


def test_every_tile_of_the_eslf_picture_is_a_lenslet(field: lf.LightField, tmp_path: Path) -> None:
    lf.export_field(field, tmp_path / "eslf", "eslf")
    picture = png16(tmp_path / "eslf" / "lightfield.eslf.png")
    facts = json.loads((tmp_path / "eslf" / "export.json").read_text())
    assert picture.dtype == np.uint16
    for v, u in ((0, 0), (1, 2), (4, 3)):
        light = picture[v::5, u::5, 1] * facts["unit_per_count"]
        expected = np.nan_to_num(field.data[v, u, :, :, 0])
        np.testing.assert_allclose(light, expected, atol=0.51 * facts["unit_per_count"])
    with PIL.Image.open(tmp_path / "eslf" / "lightfield.eslf.png") as seen:
        np.testing.assert_array_equal(np.asarray(seen), picture >> 8)


def test_wavelengths_that_span_colours_become_rgb(tmp_path: Path) -> None:
    """Blue light alone ends in the blue channel."""
    scene = scene_of(wavelengths=(450.0, 550.0, 620.0))
    image = image_of(scene)
    image.mean[..., 1:] = 0.0
    lf.export_field(lf.decode(image, views=3), tmp_path / "mat", "lftoolbox")
    array = loadmat(tmp_path / "mat" / "lightfield.mat")["LF"].astype(float)
    assert array[..., 2].mean() > 5.0 * array[..., :2].mean()


def parameters(path: Path) -> configparser.ConfigParser:
    config = configparser.ConfigParser()
    config.read(path / "parameters.cfg")
    return config


def test_hci_views_are_numbered_row_by_row(field: lf.LightField, tmp_path: Path) -> None:
    paths = lf.export_field(field, tmp_path / "hci", "hci")
    assert sum(path.suffix == ".png" for path in paths) == 25
    ratio = []
    for v, u in ((0, 0), (0, 3), (3, 1)):
        with PIL.Image.open(tmp_path / "hci" / f"input_Cam{5 * v + u:03d}.png") as picture:
            assert picture.mode == "RGB"
            shown = linear(np.asarray(picture)[..., 0] / 255.0)
        clipped = shown > 0.999
        ratio.append((shown / field.data[v, u, :, :, 0])[~clipped])
    # One exposure for all, to the rounding of 8 bits.
    ratios = np.concatenate(ratio)
    assert np.ptp(ratios) < 0.02 * ratios.mean()


@pytest.mark.parametrize(("camera", "close"), [("ideal", 1e-9), ("field", 1e-3)])
def test_hci_disparities_are_those_of_the_ray_model(
    camera: str, close: float, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """By the benchmark's own formula, from the numbers in parameters.cfg: exact but for the lens's aberrations."""
    field: lf.LightField = request.getfixturevalue(camera)
    lf.export_field(field, tmp_path / "hci", "hci")
    config = parameters(tmp_path / "hci")
    inside, outside = config["intrinsics"], config["extrinsics"]
    size = max(inside.getint("image_resolution_x_px"), inside.getint("image_resolution_y_px"))
    assert (outside.getint("num_cams_x"), outside.getint("num_cams_y"), size) == (5, 5, 8)
    focus = outside.getfloat("focus_distance_m")
    f = outside.getfloat("baseline_mm") / 1000.0 * inside.getfloat("focal_length_mm") * size
    pupil = first_order(field.scene).entrance_pupil_z_mm
    for distance_mm in (350.0, 450.0, 500.0, 700.0, 2000.0):
        depth = (distance_mm + pupil) / 1000.0
        disparity = (f * focus / depth - f) / focus / inside.getfloat("sensor_size_mm")
        expected = field.model.shift_mm(distance_mm) / field.spacing_mm[1]
        assert disparity == pytest.approx(expected, rel=close, abs=close * field.model.lenslet_pitch_mm)


def test_the_baseline_is_the_step_of_the_views_imaged_into_the_entrance_pupil(ideal: lf.LightField) -> None:
    facts = first_order(ideal.scene)
    magnification = facts.entrance_pupil_diameter_mm / facts.exit_pupil_diameter_mm
    assert abs(magnification - 1.0) > 0.01
    assert CameraArray.of(ideal).baseline_mm == pytest.approx(ideal.model.view_step_mm * magnification, rel=1e-9)


def test_hci_depth_reads_back_from_pfm(ideal: lf.LightField, tmp_path: Path) -> None:
    field = ideal
    depth_mm = np.linspace(400.0, 600.0, 48).reshape(field.size)
    depth_mm[0, 1] = np.inf
    lf.export_field(field, tmp_path / "hci", "hci", depth_mm=depth_mm)
    pupil_mm = first_order(field.scene).entrance_pupil_z_mm
    with PIL.Image.open(tmp_path / "hci" / "gt_depth_lowres.pfm") as file:
        np.testing.assert_allclose(np.asarray(file), (depth_mm + pupil_mm) / 1000.0, rtol=1e-6)
    with PIL.Image.open(tmp_path / "hci" / "gt_disp_lowres.pfm") as file:
        disparity = np.asarray(file)
    expected = field.model.shift_mm(depth_mm[2, 3]) / field.spacing_mm[1]
    assert disparity[2, 3] == pytest.approx(expected, rel=1e-5)
    assert parameters(tmp_path / "hci")["meta"].getfloat("disp_max") == pytest.approx(disparity.max(), rel=1e-6)


def test_views_come_as_pictures_and_as_measured(field: lf.LightField, tmp_path: Path) -> None:
    lf.export_field(field, tmp_path / "views", "views")
    read = exr.read(tmp_path / "views" / "view_v03_u01.exr", ("view", "stderr"))
    np.testing.assert_array_equal(read.parts["view"], field.data[3, 1])
    np.testing.assert_array_equal(read.parts["stderr"], field.stderr[3, 1])
    with PIL.Image.open(tmp_path / "views" / "view_v03_u01.png") as picture:
        shown = linear(np.asarray(picture)[..., 0] / 255.0).ravel()
    assert np.corrcoef(shown, field.data[3, 1].ravel())[0, 1] > 0.99


def channels_of(path: Path) -> dict[str, Array]:
    """Channels of the only part of an EXR file."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        assert len(file.parts) == 1
        return {name: channel.pixels.copy() for name, channel in file.channels().items()}


def test_exr_rgb_has_the_channels_that_every_reader_takes_and_no_other(tmp_path: Path) -> None:
    scene = scene_of(wavelengths=(450.0, 550.0, 620.0))
    field = lf.decode(image_of(scene), views=3)
    depth_mm = np.array([[400.0, np.nan], [np.inf, 500.0], [600.0, 700.0]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        paths = lf.export_field(field, tmp_path / "rgb", "exr-rgb", depth_mm=depth_mm)
    files = {path.name: channels_of(path) for path in paths if path.suffix == ".exr"}
    assert len(files) == 9 * (1 + 3) + 1
    for channels in files.values():
        assert set(channels) == {"R", "G", "B"}
        assert {pixels.dtype for pixels in channels.values()} == {np.dtype(np.float32)}
    for name in "RGB":
        np.testing.assert_array_equal(files["depth.exr"][name], depth_mm.astype(np.float32))
        for c in range(3):
            np.testing.assert_array_equal(files[f"view_v02_u01_c{c}.exr"][name], field.data[2, 1, :, :, c])
    rgb = np.stack([files["view_v02_u01.exr"][name] for name in "RGB"], axis=-1)
    expected = np.clip(field.data[2, 1] @ srgb_weights(field.wavelengths_nm).T, 0.0, None)
    np.testing.assert_allclose(rgb, expected, rtol=1e-5, atol=1e-7 * expected.max())
    assert json.loads((tmp_path / "rgb" / "export.json").read_text())["channels"][1] == "S0.550,0nm"


def test_exr_rgb_of_one_wavelength_is_grey_and_black_where_unknown(field: lf.LightField, tmp_path: Path) -> None:
    paths = lf.export_field(field, tmp_path / "rgb", "exr-rgb")
    assert len(paths) == 25 + 1
    for channels in channels_of(tmp_path / "rgb" / "view_v01_u02.exr").values():
        np.testing.assert_array_equal(channels, np.nan_to_num(field.data[1, 2, :, :, 0]))


def test_plenopticam_gets_what_it_divides_and_true_centres(tmp_path: Path) -> None:
    """Raw in sRGB over white as it is: the radiance, to the rounding of 8 bits."""
    scene = scene_of()
    image, white, calibration = image_of(scene), image_of(scene, seed=2), lf.calibrate(scene)
    with pytest.warns(UserWarning, match="60 × 60"):
        lf.export_raw(image, white, calibration, tmp_path / "pop", "plenopticam")
    folder = tmp_path / "pop"
    with PIL.Image.open(folder / "raw.png") as raw, PIL.Image.open(folder / "white.png") as flat:
        assert raw.mode == flat.mode == "RGB"
        counts, flats = np.asarray(raw)[..., 0], np.asarray(flat)[..., 0]
    facts = json.loads((folder / "export.json").read_text())
    radiance = facts["radiance_w_m2_sr"] * linear(counts / 255.0) / (flats / 255.0)
    expected = (image.mean / white.mean)[:, ::-1, 0]
    kept = (counts < 255) & (flats < 255)
    assert kept.mean() > 0.97
    np.testing.assert_allclose(radiance[kept], expected[kept], rtol=0.03)
    centres = json.loads((folder / "centres.json").read_text())
    row, column, t, s = centres["mic_list"][8 * 1 + 2]
    assert (t, s) == (1, 2)
    np.testing.assert_allclose((79 - column, row), calibration.centres_px[1, -3])
    settings = json.loads((folder / "settings.json").read_text())
    assert settings["ptc_leng"] % 2 == 1
    assert settings["ptc_leng"] < calibration.pitch_px


def test_plenpy_gets_16_linear_bits_and_lengths_in_metres(tmp_path: Path) -> None:
    scene = scene_of("hexagonal")
    image, white, calibration = image_of(scene), image_of(scene, seed=2), lf.calibrate(scene)
    lf.export_raw(image, white, calibration, tmp_path / "plenpy", "plenpy")
    raw = png16(tmp_path / "plenpy" / "Images" / "raw.png").astype(float)
    flat = png16(tmp_path / "plenpy" / "Calibration" / "WhiteImages" / "white.png").astype(float)
    facts = json.loads((tmp_path / "plenpy" / "export.json").read_text())
    kept = (raw < 65535) & (flat < 65535)
    expected = np.broadcast_to((image.mean / white.mean)[:, ::-1], raw.shape)
    np.testing.assert_allclose((facts["radiance_w_m2_sr"] * raw / flat)[kept], expected[kept], rtol=1e-3)
    settings = json.loads((tmp_path / "plenpy" / "camera.json").read_text())
    side = json.loads((tmp_path / "plenpy" / "Images" / "raw.json").read_text())["camera"]
    enlarged = (side["imageDistance"] + settings["ml_focal_length"]) / side["imageDistance"]
    assert enlarged * 0.125 / 0.0125 == pytest.approx(calibration.nominal_pitch_px, rel=1e-12)


@pytest.mark.parametrize(
    ("export", "fault"),
    [
        (lambda f, to: lf.export_field(f, to, "hci", depth_mm=np.ones((3, 4))), "depth map has 4 × 3 samples"),
        (lambda f, to: lf.export_field(f, to, "eslf", depth_mm=np.ones((6, 8))), "hci and exr-rgb can"),
        (lambda f, to: lf.export_field(f, to, "tiff"), "must be one of lftoolbox"),
        (lambda f, to: lf.export_raw(*_raw(), to, "lytro"), "must be one of plenopticam"),
        (lambda f, to: lf.export_raw(*_raw(), to, "plenpy"), "this one is square"),
        (lambda f, to: lf.export_raw(*_raw(dark=0), to, "plenopticam"), "the raw image is black"),
        (lambda f, to: lf.export_raw(*_raw(dark=1), to, "plenopticam"), "the white image is black"),
    ],
)
@pytest.mark.filterwarnings("ignore:PlenoptiCam")
def test_what_a_format_cannot_hold_is_told_and_nothing_is_left(
    field: lf.LightField, tmp_path: Path, export: Callable[[lf.LightField, Path], object], fault: str
) -> None:
    with pytest.raises(lf.LfmeshError, match=fault):
        export(field, tmp_path / "out")
    assert not list(tmp_path.iterdir())


def _raw(dark: int | None = None) -> tuple[lf.Image, lf.Image, lf.Calibration]:
    scene = scene_of()
    images = [image_of(scene), image_of(scene)]
    if dark is not None:
        images[dark].mean[:] = 0.0
    return images[0], images[1], lf.calibrate(scene)


@pytest.mark.filterwarnings("ignore:PlenoptiCam needs")
@pytest.mark.parametrize(("spot", "words"), [(1.0, "1 pitch wide"), (1.04, "1 pitch wide"), (1.3, "1.3 pitches wide")])
def test_micro_images_that_touch_are_told_by_their_width(spot: float, words: str, tmp_path: Path) -> None:
    image, white, calibration = _raw()
    touching = replace(calibration, f_number=calibration.microlens_f_number / spot)
    with pytest.warns(UserWarning, match=f"they are {words}; stop the lens down"):
        lf.export_raw(image, white, touching, tmp_path / "out", "plenopticam")


def test_a_folder_that_holds_something_is_left_alone(field: lf.LightField, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(lf.FileError, match="is not empty"):
        lf.export_field(field, tmp_path, "eslf")
    with pytest.raises(lf.FileError, match="is a file"):
        lf.export_field(field, tmp_path / "notes.txt", "eslf")
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize("way", ["name", "link", "here"])
def test_an_empty_folder_is_filled_and_stays_what_it_is(
    field: lf.LightField, way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    known = empty.stat().st_ino
    (tmp_path / "link").symlink_to(empty)
    monkeypatch.chdir(empty)
    written = lf.export_field(field, {"name": empty, "link": tmp_path / "link", "here": "."}[way], "eslf")
    assert sorted(path.name for path in empty.iterdir()) == sorted(path.name for path in written)
    assert empty.stat().st_ino == known
    assert (tmp_path / "link").is_symlink()
    with pytest.raises(lf.FileError, match="is not empty"):
        lf.export_field(field, empty, "eslf")


def test_the_command_exports_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = scene_of()
    folder = lf.save(image_of(scene), tmp_path / "run")
    depth = exr.SpectralImage({"Z": np.full((6, 8, 1), 500.0, np.float32)}, (587.6,), {})
    exr.write(tmp_path / "light.exr", depth)
    assert main(["export", str(folder), "--format", "eslf", "-o", str(tmp_path / "eslf")]) == 0
    assert (tmp_path / "eslf" / "lightfield.eslf.png").is_file()
    for words, fault in (
        (["--format", "plenopticam"], "has no white.exr; make it with lfmesh white"),
        (["--format", "eslf", "--depth", "d.exr"], "cannot hold depth"),
        (["--format", "hci", "--depth", str(tmp_path / "d.exr")], "does not exist"),
        (["--format", "hci", "--depth", str(tmp_path / "light.exr")], "has no channel truth or Z"),
        (["--format", "tiff"], "tiff"),
    ):
        assert main(["export", str(folder), *words, "-o", str(tmp_path / "no")]) == 2
        assert fault in " ".join(capsys.readouterr().err.split())
        assert not (tmp_path / "no").exists()
    lf.save_white(image_of(scene, seed=2), lf.calibrate(scene), folder)
    assert main(["export", str(folder), "--format", "plenopticam", "-o", str(tmp_path / "pop")]) == 0
    assert "Note: PlenoptiCam needs about 60 × 60" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["calibration.json", "depth.exr", "report.json"])
def test_the_command_refuses_a_file_of_the_run_that_was_altered(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = scene_of()
    folder = lf.save(image_of(scene), tmp_path / "run")
    lf.save_white(image_of(scene, seed=2), lf.calibrate(scene), folder)
    with run.added(folder) as staging:
        exr.write_maps(staging / "depth.exr", {"Z": np.ones((6, 8))}, {})
    content = (folder / name).read_bytes()
    (folder / name).write_bytes(content.replace(b"1", b"2", 1) if name.endswith("json") else content[:-1] + b"x")
    kinds = {"calibration.json": ["plenopticam"], "depth.exr": ["hci", "--depth", "depth.exr"], "report.json": ["eslf"]}
    assert main(["export", str(folder), "--format", *kinds[name], "-o", str(tmp_path / "no")]) == 2
    assert f"{name} is truncated or damaged: it is not what was saved" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "no").exists()
