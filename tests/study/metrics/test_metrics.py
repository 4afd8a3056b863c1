"""Metrics against geometry from outside: where micro-images go when array and sensor move."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene.first_order.solve import apparent_thickness_mm
from lfmesh.study.metrics.column import Column
from lfmesh.study.metrics.comparison import Comparison
from lfmesh.study.metrics.metrics import METRICS, columns_of
from lfmesh.study.metrics.pictures import Camera, films, image_of
from lfmesh.study.sweeps.statistics import Estimate, combined
from lfmesh.study.sweeps.table import Table
from tests.study.studies import small_scene

Array = NDArray[np.float64]

LENSLETS, PITCH_MM, PIXEL_MM = 12, 0.125, 0.0125
MARGIN_PX = 12


@pytest.fixture(scope="module")
def scene() -> lf.Scene:
    """The first scene's camera with fewer lenslets, whose micro-images all lie on the sensor."""
    pixels = 10 * LENSLETS + MARGIN_PX
    return lf.load(asset_path("scenes/first_light.toml")).changed(
        {
            "camera.mla.count": (LENSLETS, LENSLETS),
            "camera.sensor.pixels": (pixels, pixels),
            "transport.samples": 64,
            "transport.replicates": 4,
            "transport.split": "transmit",
        }
    )


def distances_mm(scene: lf.Scene) -> tuple[float, float]:
    """D, from the exit pupil to the lenslets, and d, from their rear principal points to the sensor."""
    ready = lf.solved(scene)
    facts, mla = lf.first_order(scene), ready.camera.mla
    assert mla is not None
    assert mla.distance_mm is not None
    assert ready.camera.sensor.distance_mm is not None
    apexes = ready.camera.lens.vertices_mm[-1] + mla.distance_mm
    inside = apparent_thickness_mm(ready.camera, scene.primary_nm)
    return apexes - facts.exit_pupil_z_mm, ready.camera.sensor.distance_mm + inside


def lenslets_mm() -> Array:
    """Centres of the lenslets, (rows, columns, 2)."""
    along = PITCH_MM * (np.arange(LENSLETS) - 0.5 * (LENSLETS - 1))
    return np.stack(np.meshgrid(along, along), axis=-1)


def run(scene: lf.Scene, path: str, values: list[float], metrics: list[str], folder: Path) -> Table:
    return lf.Study(scene, axes=[{"path": path, "values": values}], metrics=metrics).run(folder, workers=0)


def rms(field: Array) -> float:
    return float(np.sqrt(np.nanmean((field**2).sum(axis=-1))))


def test_an_array_turned_by_a_tenth_of_a_degree_turns_the_centres(scene: lf.Scene, tmp_path: Path) -> None:
    """A centre stands at (1 + d/D) times its lenslet's place, seen from the middle of the pupil on the axis."""
    table = run(scene, "camera.mla.pose.tilt_deg[2]", [0.1], ["chief_rays"], tmp_path)
    to_pupil, to_sensor = distances_mm(scene)
    turn = math.radians(0.1)
    place = lenslets_mm() * (1.0 + to_sensor / to_pupil) / PIXEL_MM
    matrix = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    predicted = place @ matrix.T - place
    found = table.rows[1].maps["chief_rays"]
    assert np.isfinite(found).all()
    # Within 1 % of the field, everywhere.
    assert rms(found - predicted) < 0.01 * rms(predicted)
    assert np.abs(found - predicted).max() < 0.01 * np.hypot(*predicted.reshape(-1, 2).T).max()
    assert table.rows[1].estimates["chief_rays_turn_deg"].value == pytest.approx(0.1, rel=1e-3)


def test_white_images_show_the_same_turn(scene: lf.Scene, tmp_path: Path) -> None:
    """The centres that two noisy white images show, to one another: within 4 standard errors and 2 % of the turn."""
    table = run(scene, "camera.mla.pose.tilt_deg[2]", [0.5], ["centres"], tmp_path)
    turn = table.rows[1].estimates["centres_turn_deg"]
    assert abs(turn.value - 0.5) < 4.0 * turn.stderr + 0.01
    assert turn.stderr < 0.02
    shift = table.rows[1].estimates["centres_x_px"]
    assert abs(shift.value) < 4.0 * shift.stderr + 0.005


def test_a_distance_error_changes_the_pitch_by_its_formula(scene: lf.Scene, tmp_path: Path) -> None:
    """(D + d)/D: an array that is nearer to the sensor by δ has D + δ and d − δ."""
    errors = [-0.1, 0.05, 0.1]
    table = run(scene, "camera.mla.pose.shift_mm[2]", errors, ["chief_rays"], tmp_path)
    to_pupil, to_sensor = distances_mm(scene)
    for row, error in zip(table.rows[1:], errors, strict=True):
        ratio = row.estimates["chief_rays_pitch_ratio"].value
        predicted = (1.0 + (to_sensor - error) / (to_pupil + error)) / (1.0 + to_sensor / to_pupil)
        assert ratio - 1.0 == pytest.approx(predicted - 1.0, rel=0.01)
    (pitch,) = (each for each in table.sensitivities() if each.column.name == "chief_rays_pitch_ratio")
    assert pitch.slope.low < pitch.slope.value < pitch.slope.high
    assert pitch.slope.value == pytest.approx(-1.0 / to_pupil, rel=0.03)


@pytest.mark.parametrize("metric", ["chief_rays", "centres"])
def test_a_decentre_moves_all_centres_alike(scene: lf.Scene, tmp_path: Path, metric: str) -> None:
    """By (1 + d/D) of the decentre, to 1 % by chief rays; by white images to 4 standard errors besides."""
    table = run(scene, "camera.mla.pose.shift_mm[0]", [0.005], [metric], tmp_path)
    to_pupil, to_sensor = distances_mm(scene)
    predicted = 0.005 * (1.0 + to_sensor / to_pupil) / PIXEL_MM
    x, y = (table.rows[1].estimates[f"{metric}_{axis}_px"] for axis in "xy")
    assert abs(x.value - predicted) < 0.01 * predicted + 4.0 * x.stderr
    assert abs(y.value) < 0.01 * predicted + 4.0 * y.stderr
    if metric == "chief_rays":
        field = table.rows[1].maps[metric]
        assert np.ptp(field[..., 0]) < 0.01 * predicted


def pair_of(first: Array, second: Array, scene: lf.Scene) -> Comparison:
    camera = Camera(scene)
    return Comparison(camera, camera, {"scene": first}, {"scene": second}, len(first))


def value(metric: str, pair: Comparison, column: int = 0) -> tuple[float, float]:
    pseudo = METRICS[metric].compute(pair)[:, column]
    return METRICS[metric].columns[column].estimate(combined(pseudo))


def test_psnr_and_correlation_are_those_of_the_pictures_without_their_noise() -> None:
    """Synthetic pictures with as much noise as difference: what is measured is the difference alone."""
    scene = small_scene()
    draw = np.random.default_rng(5)
    truth = 1.0 + draw.random((60, 60, 1))
    other = truth + 0.1 * draw.normal(size=truth.shape)

    def noisy(picture: Array) -> Array:
        return picture + 0.3 * draw.normal(size=(8, *picture.shape))

    pair = pair_of(noisy(other), noisy(truth), scene)
    psnr, error = value("psnr", pair)
    white = (truth**2).mean() / truth.mean()
    expected = -10.0 * math.log10(((other - truth) ** 2).mean() / white**2)
    # Two z-tests at 3.3 sigma, 0.1 % each.
    assert abs(psnr - expected) < 3.3 * error
    assert error < 1.5
    ncc, error = value("ncc", pair)
    expected = float(np.corrcoef(other.ravel(), truth.ravel())[0, 1])
    assert abs(ncc - expected) < 3.3 * error
    assert error < 0.02


def test_noise_is_the_standard_error_of_the_image() -> None:
    scene = small_scene()
    camera = Camera(scene)
    power = films(camera, ["scene"], range(4))["scene"]
    image = lf.render(scene)
    assert np.array_equal(image_of(scene, power).mean, power.mean(axis=0))
    np.testing.assert_allclose(power.mean(axis=0), image.mean, rtol=1e-12)
    noise, _ = value("noise", pair_of(power, power, scene))
    variance = float((image.stderr**2).mean())
    assert noise == pytest.approx(math.sqrt(variance / ((image.mean**2).mean() - variance)), rel=0.02)


def test_ghosts_are_what_reflections_add(tmp_path: Path) -> None:
    """Where no reflection is followed the share is exactly zero; where all are, it is there at 4 sigma."""
    table = run(small_scene(split="both", samples=256), "transport.split", ["transmit"], ["ghosts"], tmp_path)
    followed, left_out = (row.estimates["ghost_share"] for row in table.rows)
    assert left_out == (0.0, 0.0)
    assert followed.value > 4.0 * followed.stderr > 0.0
    assert followed.value < 0.1


def test_paired_points_resolve_what_others_do_not(tmp_path: Path) -> None:
    """A decentre by 0.1 µm in the light of a pixel: the same noise at both points drops out of the difference.

    The variances of 8 seeds with 8 replicates each are pooled. An F-test at a level of 1e-3, with 7 degrees of freedom
    for each seed, says that the paired one is less than a ninth of the other.
    """
    axes: list[dict[str, Any]] = [{"path": "camera.mla.pose.shift_mm[0]", "values": [0.0001]}]
    seeds, replicates = range(1, 9), 8
    variance = {}
    for paired in (True, False):
        variance[paired] = 0.0
        for seed in seeds:
            scene = small_scene().changed({"transport.seed": seed, "transport.replicates": replicates})
            study = lf.Study(scene, axes=axes, metrics=["light"], paired=paired)
            table = study.run(tmp_path / f"{paired}-{seed}", workers=0)
            variance[paired] += table.rows[1].estimates["light_ratio"].stderr ** 2 / len(seeds)
    degrees = len(seeds) * (replicates - 1)
    assert variance[False] / variance[True] > 9.0 * stats.f.ppf(1.0 - 1e-3, degrees, degrees)


@pytest.mark.parametrize(
    ("name", "mean", "expected"),
    [
        # Ten times its error, and twice: the logarithm of a mean square that may be half as large has no error.
        ("psnr_db", (1e-3, 1e-4), (30.0, 10.0 / math.log(10.0) * 0.1)),
        ("psnr_db", (1e-3, 5e-4), (30.0, math.nan)),
        ("psnr_db", (0.0, 0.0), (math.nan, math.nan)),
        ("psnr_db", (-1e-5, 1e-4), (math.nan, math.nan)),
        ("centres_rms_px", (0.04, 0.004), (0.2, 0.01)),
        ("centres_rms_px", (1e-4, 1e-4), (0.01, math.nan)),
        ("centres_rms_px", (0.0, 0.0), (0.0, 0.0)),
        ("ncc", (0.9, 0.01), (0.9, 0.01)),
        ("ncc", (0.99, 0.01), (0.99, math.nan)),
        ("ncc", (1.01, 0.02), (1.0, math.nan)),
        ("ncc", (1.5, 0.02), (math.nan, math.nan)),
        ("ncc", (1.0, 0.0), (1.0, 0.0)),
        ("ghost_share", (-0.001, 0.002), (0.0, math.nan)),
        ("ghost_share", (0.0, 0.0), (0.0, 0.0)),
        # No ray has crossed, by chance.
        ("crosstalk_share", (0.0, 0.0), (0.0, math.nan)),
    ],
)
def test_a_value_is_possible_and_states_an_error_only_where_it_can(
    name: str, mean: tuple[float, float], expected: tuple[float, float]
) -> None:
    column = next(column for column in columns_of(tuple(METRICS)) if column.name == name)
    assert column.estimate(Estimate(*mean)) == pytest.approx(expected, nan_ok=True)


def test_every_metric_names_its_columns_once() -> None:
    names = [column.name for column in columns_of(tuple(METRICS))]
    assert len(names) == len(set(names))
    assert all(isinstance(column, Column) and column.title for column in columns_of(tuple(METRICS)))


@pytest.mark.long
def test_a_calibration_mends_a_turned_array(scene: lf.Scene, tmp_path: Path) -> None:
    """By a degree the edge blurs where it is decoded to plan, and less with centres from the white image (4 sigma)."""
    larger = scene.changed({"camera.mla.count": (32, 32), "camera.sensor.pixels": (332, 332), "transport.samples": 32})
    table = run(larger, "camera.mla.pose.tilt_deg[2]", [1.0], ["mtf50"], tmp_path)
    straight, turned = (row.estimates["mtf50_lp_per_height"] for row in table.rows)
    mended = table.rows[1].estimates["mtf50_calibrated_lp_per_height"]
    assert straight.value - turned.value > 4.0 * math.hypot(straight.stderr, turned.stderr)
    assert mended.value - turned.value > 4.0 * math.hypot(mended.stderr, turned.stderr)
