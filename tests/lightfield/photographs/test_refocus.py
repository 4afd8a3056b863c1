"""Refocusing by laws that hold for any camera: on light fields made by hand."""

import math
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.lightfield.photographs.photograph import all_in_focus
from lfmesh.scene import Scene


@pytest.fixture
def scene(camera: Callable[..., Scene]) -> Scene:
    return camera(columns=40, rows=36)


def plane_field(scene: Scene, distance_mm: float, *, noise: float = 0.0, views: int = 8) -> lf.LightField:
    """A smooth pattern in a plane, as every view samples it, by the ray model's parallax."""
    model = lf.RayModel.of(scene)
    columns, rows = scene.camera.mla.count
    v = model.slope_step * (np.arange(views) - 0.5 * (views - 1))
    t, s = (0.125 * (np.arange(count) - 0.5 * (count - 1)) for count in (rows, columns))
    # A step of the view in slope moves a point by its share of the shift, against the view.
    per_slope = model.shift_mm(distance_mm) / model.slope_step
    y = t[None, None, :, None] + per_slope * v[:, None, None, None]
    x = s[None, None, None, :] + per_slope * v[None, :, None, None]
    data = pattern(x, y)[..., None]
    stderr = np.full(data.shape, noise)
    return lf.LightField(
        data.astype(np.float32), stderr.astype(np.float32), v, v.copy(), t, s, (587.6,), "W per pixel", scene, "",
        np.ones((rows, columns), np.float32),
    )  # fmt: skip


def pattern(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 2.0 + np.sin(5.0 * x + 1.0) * np.cos(4.0 * y) + 0.5 * np.sin(3.0 * y - 2.0 * x)


MIDDLE = np.s_[10:-10, 10:-10]


@pytest.mark.parametrize("method", ["shift", "fourier"])
@pytest.mark.parametrize("distance_mm", [380.0, 500.0, 800.0])
def test_a_photograph_of_a_plane_is_what_the_middle_view_sees(scene: Scene, distance_mm: float, method: str) -> None:
    """Shift-and-add interpolates linearly: it errs by h²/8 of the curvature at most, which is 25 here."""
    field = plane_field(scene, distance_mm)
    photograph = lf.refocus(field, distance_mm, method=method)
    expected = pattern(field.s_mm[None, :], field.t_mm[:, None])
    error = np.abs(photograph.mean[..., 0] - expected)[MIDDLE].max()
    assert error < (2.0 * 0.125**2 / 8.0 * 25.0 if method == "shift" else 0.03)
    elsewhere = lf.refocus(field, 1500.0 if distance_mm < 500.0 else 300.0, method=method).mean[..., 0]
    assert np.abs(elsewhere - expected)[MIDDLE].max() > 0.15


def test_coverage_is_the_fraction_of_views_that_know_a_sample(scene: Scene) -> None:
    field = plane_field(scene, 420.0)
    known = np.random.default_rng(3).random(field.data.shape) < 0.7
    gaps = replace(field, data=np.where(known, field.data, np.nan).astype(np.float32))
    photograph = lf.refocus(gaps, field.model.distance_mm(0.0))
    np.testing.assert_allclose(photograph.coverage, known[..., 0].mean(axis=(0, 1)), atol=1e-6)


def test_both_methods_agree_on_what_is_known(scene: Scene) -> None:
    field = plane_field(scene, 420.0)
    dark = field.data.copy()
    dark[0, 0] = dark[-1, 0] = np.nan
    dark[3, 3, 15:20, 15:20] = np.nan
    field = replace(field, data=dark)
    one, other = (lf.refocus(field, 420.0, method=method).mean for method in ("shift", "fourier"))
    np.testing.assert_allclose(one[MIDDLE], other[MIDDLE], atol=0.12)


def test_unknown_samples_do_not_darken_the_photograph(scene: Scene) -> None:
    field = plane_field(scene, 500.0)
    ones = np.ones_like(field.data)
    ones[:3] = np.nan
    ones[:, :, 5, 6] = np.nan
    photograph = lf.refocus(replace(field, data=ones), 440.0)
    known = np.isfinite(photograph.mean)
    assert known.mean() > 0.99
    np.testing.assert_allclose(photograph.mean[known], 1.0, rtol=1e-6)
    still = lf.refocus(replace(field, data=ones), field.model.distance_mm(0.0)).mean
    assert np.argwhere(np.isnan(still[..., 0])).tolist() == [[5, 6]]


@pytest.mark.parametrize("distance_mm", [500.0, 360.0])
def test_standard_errors_of_photographs_are_those_of_independent_samples(scene: Scene, distance_mm: float) -> None:
    """300 draws: the variance over the predicted one has the mean 1, within 5 standard errors of that mean.

    Neighbours of a photograph share samples: at most 4 a view, which widens it by no more than a factor of 2.
    """
    field = plane_field(scene, 500.0, noise=0.2, views=3)
    rng = np.random.default_rng(1)
    draws = []
    for _ in range(300):
        noisy = (0.2 * rng.normal(size=field.data.shape)).astype(np.float32)
        draws.append(lf.refocus(replace(field, data=noisy), distance_mm).mean)
    ratio = np.var(draws, axis=0, ddof=1) / lf.refocus(field, distance_mm).stderr ** 2
    assert abs(ratio.mean() - 1.0) < 5.0 * 2.0 * np.sqrt(2.0 / 299 / ratio.size)


def test_sharing_is_what_interpolated_neighbours_have_in_common(
    camera: Callable[..., Scene], image_of: Callable[..., lf.Image]
) -> None:
    """A photograph in focus, from raw images of independent noise: samples of neighbouring views share pixels.

    400 draws; the variance over the predicted one, whose mean is 1 but for what the rim of the views adds (their
    outermost pixels count less than once: by one pixel in nine along each axis at most).
    """
    scene = camera(columns=6, rows=5)
    calibration = lf.calibrate(scene)
    rng = np.random.default_rng(3)
    size = scene.camera.sensor.pixels[::-1]
    predicted = lf.refocus(lf.decode(image_of(scene, np.zeros(size), np.ones(size)), calibration=calibration), 500.0)
    draws = [
        lf.refocus(lf.decode(image_of(scene, rng.normal(size=size)), calibration=calibration), 500.0).mean
        for _ in range(400)
    ]
    ratio = np.var(draws, axis=0, ddof=1) / predicted.stderr**2
    spread = 5.0 * np.sqrt(2.0 / 399 / ratio.size)
    assert (8.0 / 9.0) ** 2 - spread < ratio.mean() < 1.0 + spread


def test_a_smaller_aperture_has_more_depth_of_field_and_fewer_views(scene: Scene) -> None:
    field = plane_field(scene, 800.0, noise=0.1)
    wide, narrow = lf.refocus(field, 500.0), lf.refocus(field, 500.0, f_number=16.0)
    expected = pattern(field.s_mm[None, :], field.t_mm[:, None])
    blur = [np.abs(p.mean[..., 0] - expected)[MIDDLE].mean() for p in (wide, narrow)]
    assert blur[1] < 0.5 * blur[0]
    assert narrow.stderr[20, 20, 0] > wide.stderr[20, 20, 0]
    assert (wide.f_number, narrow.f_number) == (field.model.f_number, 16.0)


def test_at_the_cameras_own_f_number_the_aperture_is_the_micro_image(scene: Scene) -> None:
    """Views whose whole pixel lies within pixel/d of the pupil's rim count in full, those outside not at all."""
    field = plane_field(scene, 500.0, views=10)
    lone = np.zeros_like(field.data)
    lone[0, 0] = 1.0
    assert lf.refocus(replace(field, data=lone), 500.0, f_number=field.model.f_number).mean[20, 20, 0] == 0.0
    lone[0, 0], lone[5, 5] = 0.0, 1.0
    share = lf.refocus(replace(field, data=lone), 500.0, f_number=field.model.f_number).mean[20, 20, 0]
    # Of a disk 10 pixels wide.
    assert 1.0 / share == pytest.approx(np.pi * 25.0, rel=0.02)


def test_every_place_of_all_in_focus_comes_from_its_own_plane(scene: Scene) -> None:
    """The left half of the scene is near, the right half far."""
    near, far = plane_field(scene, 400.0), plane_field(scene, 700.0)
    both = near.data.copy()
    both[..., 20:, :] = far.data[..., 20:, :]
    stack = lf.focal_stack(replace(near, data=both), [400.0, 500.0, 700.0])
    picture = all_in_focus(stack)
    assert (picture.distance_mm[8:-8, 8:12] == 400.0).mean() > 0.9
    assert (picture.distance_mm[8:-8, -12:-8] == 700.0).mean() > 0.9
    row, column = 18, 10
    plane = stack.distances_mm.index(picture.distance_mm[row, column])
    np.testing.assert_array_equal(picture.mean[row, column], stack.mean[plane, row, column])


def test_a_plane_beyond_the_range_is_warned_about_and_one_within_is_not(scene: Scene) -> None:
    field = plane_field(scene, 500.0)
    near, far = field.model.refocus_range_mm
    with pytest.warns(UserWarning, match=f"beyond the range of sharp refocusing, {near:.4g} mm to {far:.4g} mm"):
        lf.refocus(field, 0.99 * near)
    with pytest.warns(UserWarning, match="2 planes, 200 to 220 mm, lie beyond"):
        lf.focal_stack(field, [200.0, 220.0, 500.0])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        lf.focal_stack(field, [1.01 * near, 0.99 * far])


def test_infinity_is_a_plane_like_any_other(scene: Scene) -> None:
    with pytest.warns(UserWarning, match="inf mm lies beyond"):
        photograph = lf.refocus(plane_field(scene, 500.0), math.inf)
    assert math.isinf(photograph.sample_mm)


def test_faults_are_told_in_one_line(scene: Scene) -> None:
    field = plane_field(scene, 500.0)
    cases = [
        (lambda: lf.refocus(field, 20.0), "distance_mm = 20: must lie before the front focal point"),
        (lambda: lf.refocus(field, math.nan), "distance_mm = nan"),
        (lambda: lf.refocus(field, 500.0, f_number=2.0), r"f_number = 2: must be from 4\.0"),
        (lambda: lf.refocus(field, 500.0, f_number=50.0), "f_number = 50"),
        (lambda: lf.refocus(field, 500.0, method="wave"), "method = 'wave'"),
        (lambda: lf.focal_stack(field, []), "distances_mm is empty"),
    ]
    for fault, words in cases:
        with pytest.raises(lf.LfmeshError, match=words) as caught:
            fault()
        assert "\n" not in str(caught.value)
