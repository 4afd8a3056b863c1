"""The light field in the page: which view and sample a pixel is, which planes the slider reaches."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.errors import FileError
from lfmesh.files import exr, run
from lfmesh.files.field import save_field
from lfmesh.scene import Scene
from lfmesh.view.browser.field_views import FieldViews
from lfmesh.view.pictures import UNKNOWN


@pytest.fixture(params=["square", "hexagonal"])
def views(
    request: pytest.FixtureRequest, tmp_path: Path, camera: Callable[..., Scene], image_of: Callable[..., lf.Image]
) -> FieldViews:
    """The light field of a raw image whose pixels hold their own place: the row in red, the column in blue."""
    scene = camera(request.param, (656.3, 486.1))
    columns, rows = scene.camera.sensor.pixels
    image = image_of(scene, np.stack(np.indices((rows, columns)), axis=-1))
    run.save(image, tmp_path / "run")
    return FieldViews(image, tmp_path / "run")


def test_a_pixel_is_the_sample_that_it_is_said_to_be(views: FieldViews) -> None:
    # A sample lies within half a pixel of what is asked for; where rows of lenslets are resampled, along them within
    # half a lenslet more.
    along_rows = 0.5 + (0.5 * views.calibration.pitch_px if views.calibration.layout == "hexagonal" else 0.0)
    known = 0
    for row, column in np.random.default_rng(5).integers((20, 20), (110, 130), (300, 2)):
        if place := views.place(int(row), int(column)):
            down, across = views.field.data[place.v, place.u, place.t, place.s].astype(float)
            if np.isnan(down):
                # The next half pixel is another lenslet's.
                assert views.calibration.layout == "hexagonal"
                continue
            known += 1
            assert abs(down - row) <= 0.5 + 1e-4
            assert abs(across - column) <= along_rows + 1e-4
    assert known > 200, "most pixels belong to a lenslet"


def test_pixels_beside_the_array_belong_to_no_lenslet(views: FieldViews) -> None:
    for row, column in ((0, 0), (0, 149), (129, 0), (129, 149)):
        assert views.place(row, column) is None


def test_the_slider_runs_through_the_range_of_sharp_refocusing(views: FieldViews) -> None:
    planes = views.planes_mm
    near, far = views.field.model.refocus_range_mm
    assert planes[0] == pytest.approx(near)
    assert planes[-1] == pytest.approx(far)
    assert (np.diff(planes) > 0.0).all()
    shifts = [views.field.model.shift_mm(plane) for plane in planes]
    assert np.diff(shifts) == pytest.approx(np.diff(shifts)[0], rel=1e-6)
    at_focus = views.field.model.shift_mm(planes[views.focus_step])
    assert abs(at_focus) <= 0.5 * abs(shifts[0] - shifts[1]) * (1.0 + 1e-9)


def test_files_of_the_run_are_preferred_to_new_ones(
    tmp_path: Path, camera: Callable[..., Scene], image_of: Callable[..., lf.Image]
) -> None:
    scene = camera("square")
    columns, rows = scene.camera.sensor.pixels
    image = image_of(scene, np.ones((rows, columns)))
    folder = tmp_path / "run"
    run.save(image, folder)
    made = FieldViews(image, folder)
    assert made.decoded_here
    save_field(made.field, folder)
    shifted = replace(made.calibration, centres_px=made.calibration.centres_px + 0.25)
    run.save_white(image, shifted, folder)
    kept = FieldViews(image, folder)
    assert not kept.decoded_here
    assert kept.calibration.centres_px == pytest.approx(made.calibration.centres_px + 0.25)


def test_depth_is_shown_where_the_run_has_it(
    tmp_path: Path, camera: Callable[..., Scene], image_of: Callable[..., lf.Image]
) -> None:
    scene = camera("square")
    columns, rows = scene.camera.sensor.pixels
    image = image_of(scene, np.ones((rows, columns)))
    folder = tmp_path / "run"
    run.save(image, folder)
    assert FieldViews(image, folder).depth() is None
    distance = np.full((12, 14), 400.0, np.float32)
    distance[:, 7:] = 600.0
    distance[3, 5] = np.nan
    with run.added(folder) as staging:
        exr.write_maps(staging / "depth.exr", {"Z": distance}, {})
    shown = FieldViews(image, folder).depth()
    assert shown is not None
    picture, low, high = shown
    assert (low, high) == (400.0, 600.0)
    assert tuple(picture[3, 5]) == UNKNOWN
    near, far = tuple(picture[0, 0]), tuple(picture[0, 13])
    assert near != far
    known = np.isfinite(distance)
    assert (picture[known & (distance < 500.0)] == near).all()
    assert (picture[known & (distance > 500.0)] == far).all()


def test_colours_of_depth_span_the_truth_whatever_single_samples_say(
    tmp_path: Path, camera: Callable[..., Scene], image_of: Callable[..., lf.Image]
) -> None:
    scene = camera("square")
    columns, rows = scene.camera.sensor.pixels
    image = image_of(scene, np.ones((rows, columns)))
    run.save(image, tmp_path / "run")
    truth = np.full((12, 14), 300.0, np.float32)
    truth[:, 7:] = 700.0
    found = np.full((12, 14), 500.0, np.float32)
    found[0, :2] = 5.0, 1e6
    with run.added(tmp_path / "run") as staging:
        exr.write_maps(staging / "depth.exr", {"Z": found, "truth": truth}, {})
    shown = FieldViews(image, tmp_path / "run").depth()
    assert shown is not None
    assert shown[1:] == (300.0, 700.0)


@pytest.mark.parametrize("name", [run.CALIBRATION, "depth.exr", "lightfield.exr"])
def test_a_file_of_the_run_that_was_altered_is_refused(
    name: str, tmp_path: Path, camera: Callable[..., Scene], image_of: Callable[..., lf.Image]
) -> None:
    scene = camera("square")
    image = image_of(scene, np.ones(scene.camera.sensor.pixels[::-1]))
    folder = run.save(image, tmp_path / "run")
    run.save_white(image, lf.calibrate(scene), folder)
    with run.added(folder) as staging:
        exr.write_maps(staging / "depth.exr", {"Z": np.ones((2, 2)), "truth": np.ones((2, 2))}, {})
    save_field(FieldViews(image, folder).field, folder)
    path = folder / name
    content = path.read_bytes()
    path.write_bytes(content.replace(b"1", b"2", 1) if name.endswith("json") else content[:-1] + b"x")
    with pytest.raises(FileError, match=rf"{name} is truncated or damaged: it is not what was saved"):
        FieldViews(image, folder)
