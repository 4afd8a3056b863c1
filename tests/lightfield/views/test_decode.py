"""Decoding puts every pixel where it belongs: laws on raw images whose light field is known."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial import cKDTree

import lfmesh as lf
from lfmesh.geometry.array.lattice import Lattice
from lfmesh.lightfield.calibration.calibration import Calibration, calibrate
from lfmesh.lightfield.calibration.white import white_scene
from lfmesh.lightfield.views.decode import decode
from lfmesh.scene import Scene

BADLY_MOUNTED = {"camera.mla.pose": {"shift_mm": [0.03, -0.02, 0.0], "tilt_deg": [0.0, 0.0, 0.8]}}


def ramp(scene: Scene, along_x: float, along_y: float) -> np.ndarray:
    """A raw image (H, W) that is linear in its pixels, so that interpolation is exact."""
    columns, rows = scene.camera.sensor.pixels
    return 1000.0 + along_x * np.arange(columns)[None, :] + along_y * np.arange(rows)[:, None]


def lenslet_ramp(calibration: Calibration, along_x: float, along_y: float) -> np.ndarray:
    """A raw image in which every micro-image has one value, linear in its lenslet's place on the array, mm."""
    rows, columns = calibration.known.shape
    pitch = calibration.lenslet_pitch_mm
    places = Lattice(calibration.layout == "hexagonal", pitch, columns, rows).centres().reshape(-1, 2)
    centres = calibration.centres_px.reshape(-1, 2)
    width, height = calibration.sensor_px
    y, x = np.mgrid[:height, :width]
    owner = ((x[..., None] - centres[:, 0]) ** 2 + (y[..., None] - centres[:, 1]) ** 2).argmin(axis=2)
    return (1000.0 + places @ [along_x, along_y])[owner]


def test_a_sample_is_the_raw_image_at_its_pixels_from_the_true_centre_turned_upright(
    camera: Callable[..., Scene], image_of: Callable[..., lf.Image]
) -> None:
    scene = camera().changed(BADLY_MOUNTED)
    calibration = calibrate(scene)
    field = decode(image_of(scene, ramp(scene, 2.0, 3.0)), calibration=calibration)
    rows, columns = calibration.known.shape
    views = field.views[0]
    assert field.data.shape == (10, 10, rows, columns, 1)
    for v, u, t, s in [(0, 0, 3, 4), (9, 2, 5, 1), (4, 7, rows - 2, columns - 2)]:
        # An inverting lens: columns are reversed, of lenslets and of the pixels behind each; rows are not.
        x, y = calibration.centres_px[t, columns - 1 - s]
        expected = 1000.0 + 2.0 * (x + (views - 1) / 2 - u) + 3.0 * (y - (views - 1) / 2 + v)
        assert field.data[v, u, t, s, 0] == pytest.approx(expected, rel=1e-6)


def test_axes_say_where_a_sample_lies(camera: Callable[..., Scene], image_of: Callable[..., lf.Image]) -> None:
    scene = camera()
    field = decode(image_of(scene, ramp(scene, 1.0, 1.0)))
    assert np.diff(field.s_mm) == pytest.approx(0.125)
    assert np.diff(field.u_rad) == pytest.approx(0.0125 / 0.5)
    assert field.s_mm.sum() == pytest.approx(0.0, abs=1e-12)
    assert field.u_rad.sum() == pytest.approx(0.0, abs=1e-12)
    assert (len(field.v_rad), len(field.u_rad), len(field.t_mm), len(field.s_mm)) == field.data.shape[:4]


def test_a_hexagonal_array_is_resampled_to_a_square_grid(
    camera: Callable[..., Scene], image_of: Callable[..., lf.Image]
) -> None:
    """What is linear on the array is linear in the grid: nothing is sheared, stretched or shifted."""
    scene = camera("hexagonal")
    calibration = calibrate(scene)
    field = decode(image_of(scene, lenslet_ramp(calibration, 200.0, 300.0)), calibration=calibration, views=1)
    assert np.diff(field.s_mm) == pytest.approx(0.125 * np.sqrt(0.75))
    assert np.diff(field.t_mm) == pytest.approx(np.diff(field.s_mm)[0])
    assert "square grid" in field.sampling
    # Of an inverting lens' picture s runs against x on the array, t along y.
    expected = 1000.0 - 200.0 * field.s_mm[None, :] + 300.0 * field.t_mm[:, None]
    np.testing.assert_allclose(field.data[0, 0, :, 1:-1, 0], expected[:, 1:-1], rtol=1e-6)


@pytest.mark.parametrize("layout", ["square", "hexagonal"])
@pytest.mark.parametrize("views", [None, 11])
def test_what_is_nearer_to_another_micro_image_is_in_no_view(
    camera: Callable[..., Scene], image_of: Callable[..., lf.Image], layout: str, views: int | None
) -> None:
    """By the distances of a sample from all centres, for a lenslet in the middle of a turned array."""
    scene = camera(layout).changed(BADLY_MOUNTED)
    calibration = calibrate(scene)
    field = decode(image_of(scene, ramp(scene, 2.0, 3.0)), calibration=calibration, views=views)
    rows, columns = calibration.known.shape
    row, column = rows // 2, columns // 2
    across = np.arange(field.views[0]) - 0.5 * (field.views[0] - 1)
    # An inverting lens: columns of the picture run against those of the sensor.
    places = calibration.centres_px[row, column] + np.stack(np.meshgrid(-across, across), axis=-1)
    near, which = cKDTree(calibration.centres_px.reshape(-1, 2)).query(places, 2)
    plain = near[..., 1] - near[..., 0] > 0.02
    known = np.isfinite(field.data[:, :, row, field.data.shape[3] // 2, 0])
    np.testing.assert_array_equal(known[plain], (which[..., 0] == row * columns + column)[plain])
    assert not known.all() or (layout == "square" and views is None)


@pytest.mark.parametrize("layout", ["square", "hexagonal"])
def test_standard_errors_are_those_of_the_interpolation(
    camera: Callable[..., Scene], image_of: Callable[..., lf.Image], layout: str
) -> None:
    """Against many images with independent noise of the standard errors given: chi-squared a sample.

    The variance of 400 draws over the predicted one is chi²/399; over all samples its mean is 1 within 5 standard
    deviations of the mean, which neighbours that share pixels make up to 9 times wider than independent ones would.
    """
    scene = camera(layout, columns=6, rows=5)
    calibration = calibrate(scene)
    rng = np.random.default_rng(7)
    columns, rows = scene.camera.sensor.pixels
    spread = rng.uniform(1.0, 2.0, (rows, columns))
    zero = np.zeros((rows, columns))
    predicted = decode(image_of(scene, zero, spread), calibration=calibration, views=2).stderr
    draws = [
        decode(image_of(scene, spread * rng.normal(size=(rows, columns))), calibration=calibration, views=2).data
        for _ in range(400)
    ]
    ratio = np.var(draws, axis=0, ddof=1) / predicted**2
    assert abs(ratio.mean() - 1.0) < 5.0 * np.sqrt(9.0 * 2.0 / 399 / ratio.size)


def test_divided_by_white_the_field_is_the_radiance_and_dark_is_unknown(
    camera: Callable[..., Scene], image_of: Callable[..., lf.Image]
) -> None:
    scene = camera()
    calibration = calibrate(scene)
    rng = np.random.default_rng(2)
    height, width = scene.camera.sensor.pixels[::-1]
    # Round micro-images between which it is dark.
    y, x = np.mgrid[:height, :width]
    centres = calibration.centres_px.reshape(-1, 2)
    off = np.sqrt(((x[..., None] - centres[:, 0]) ** 2 + (y[..., None] - centres[:, 1]) ** 2).min(axis=2))
    white = np.where(off < 5.0, rng.uniform(0.5, 1.0, (height, width)), 0.0)
    field = decode(image_of(scene, 3.0 * white), white=image_of(scene, white), calibration=calibration)
    assert field.unit == "W/(m² sr)"
    lit = np.isfinite(field.data)
    np.testing.assert_allclose(field.data[lit], 3.0, rtol=1e-6)
    assert np.isnan(field.data[0, 0]).all()
    assert lit[2:8, 2:8].all()


def test_beyond_the_sensor_nothing_is_known(camera: Callable[..., Scene], image_of: Callable[..., lf.Image]) -> None:
    scene = camera(columns=16)
    field = decode(image_of(scene, ramp(scene, 0.0, 0.0)))
    assert np.isnan(field.data[:, :, :, 0]).any()
    assert np.isfinite(field.data[:, :, 1:-1, 1:-1]).all()


def test_view_epi_and_mosaic_show_the_same_samples(
    camera: Callable[..., Scene], image_of: Callable[..., lf.Image]
) -> None:
    scene = camera()
    field = decode(image_of(scene, np.random.default_rng(0).random(scene.camera.sensor.pixels[::-1])))
    height, width = field.size
    np.testing.assert_array_equal(field.epi(t=3, v=2)[7], field.view(2, 7)[3])
    np.testing.assert_array_equal(field.epi(s=5, u=4)[1], field.view(1, 4)[:, 5])
    mosaic = field.views_mosaic()
    np.testing.assert_array_equal(mosaic[2 * height : 3 * height, 7 * width : 8 * width], field.view(2, 7))


def test_to_xarray_keeps_samples_axes_and_units(
    camera: Callable[..., Scene], image_of: Callable[..., lf.Image]
) -> None:
    pytest.importorskip("xarray")
    scene = camera()
    field = decode(image_of(scene, ramp(scene, 1.0, 2.0)))
    data = field.to_xarray()
    np.testing.assert_array_equal(data["data"].values, field.data)
    np.testing.assert_array_equal(data["u"].values, field.u_rad)
    assert data["s"].attrs["unit"] == "mm"
    assert data["data"].attrs["unit"] == "W per pixel"


def test_a_moving_camera_has_the_white_image_of_the_camera_at_rest(
    camera: Callable[..., Scene], image_of: Callable[..., lf.Image]
) -> None:
    still = camera()
    moving = still.changed({"exposure": {"duration_s": 0.01}, "camera.motion": {"velocity_mm_s": [5.0, 0.0, 0.0]}})
    picture = ramp(still, 1.0, 2.0)
    white = image_of(white_scene(moving), np.full(picture.shape, 2.0))
    found = decode(image_of(moving, picture), white=white)
    np.testing.assert_array_equal(found.data, decode(image_of(still, picture), white=white).data)


def test_faults_are_told_in_one_line(camera: Callable[..., Scene], image_of: Callable[..., lf.Image]) -> None:
    scene = camera()
    image = image_of(scene, ramp(scene, 0.0, 0.0))
    conventional = scene.changed({"camera.mla": None})
    other = scene.changed({"camera.mla.pitch_mm": 0.12})
    smaller = image_of(scene, np.ones((20, 30)))
    cases = [
        (lambda: decode(image_of(conventional, image.mean)), "conventional camera"),
        (lambda: decode(smaller), "30 × 20 pixels"),
        (lambda: decode(image, views=0), "views = 0"),
        (lambda: decode(image, views=12), "views = 12: must be from 1 to 11"),
        (lambda: decode(image, white=image_of(other, image.mean)), "another camera"),
        (lambda: decode(image, white=smaller), "the white image has the shape"),
        (lambda: decode(image, calibration=calibrate(camera(columns=4))), "the calibration is of 4 × 12 lenslets"),
        (lambda: decode(image).view(10, 0), "v = 10"),
        (lambda: decode(image).epi(), "either a row t or a column s"),
        (lambda: decode(image).epi(t=1, s=2), "either a row t or a column s"),
    ]
    for fault, words in cases:
        with pytest.raises(lf.LfmeshError, match=words) as caught:
            fault()
        assert "\n" not in str(caught.value)
