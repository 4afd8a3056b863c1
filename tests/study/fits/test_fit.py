"""A camera's assembly errors come back from its white image within the errors the fit states, or it says why not."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.geometry.array.lattice import Lattice
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.lightfield.rays.ray_model import RayModel
from lfmesh.lightfield.views.upright import Upright
from lfmesh.study.fits.fit_errors import Split, neighbours_meat
from lfmesh.study.fits.fit_model import smooth
from lfmesh.study.fits.micro_image_phase import micro_image_places
from lfmesh.study.fits.white_picture import light_of
from tests.cameras import as_text, bench_camera, camera_without_array

POSE, PITCH = "camera.mla.pose", "camera.mla.form.pitch_error"
DISTANCE = f"{POSE}.shift_mm[2]"
LARGEST = {
    f"{POSE}.tilt_deg[2]": 0.3,
    f"{POSE}.tilt_deg[0]": 0.3,
    f"{POSE}.tilt_deg[1]": 0.3,
    f"{POSE}.shift_mm[0]": 0.03,
    f"{POSE}.shift_mm[1]": 0.03,
    DISTANCE: 0.02,
    PITCH: 1e-3,
}
"""Errors are drawn uniformly up to these, to either side."""

LEVEL = 1e-4
"""Of a test: by chance it fails once in so many."""


def camera(columns: int, rows: int) -> lf.Scene:
    return solved_camera(lf.loads(bench_camera(columns, rows))).scene


def errors(seed: int) -> dict[str, float]:
    drawn = np.random.default_rng(seed).uniform(-1.0, 1.0, len(LARGEST))
    return {path: float(share * largest) for share, (path, largest) in zip(drawn, LARGEST.items(), strict=True)}


def exposed(scene: lf.Scene, truth: dict[str, float], seed: int) -> lf.Exposed:
    """Return a noisy white image of a camera with errors; other random numbers than those of the fit."""
    settings = {"samples": 256, "split": "transmit", "seed": 1000 + seed, "replicates": 2}
    built = scene.changed(truth).changed({f"transport.{name}": value for name, value in settings.items()})
    white = lf.white_image(built)
    return lf.Detector(seed=seed).filling(white).expose(white)


def deviations(found: lf.Fit, truth: dict[str, float]) -> NDArray[np.float64]:
    """Return value less truth of what is known: parameters by themselves, then the combination."""
    own = [each.value - truth[each.parameter.path] for each in found.estimates if not each.together]
    (both,) = found.combinations
    return np.array([*own, both.value - sum(part * truth[path] for path, part in both.coefficients.items())])


def chi_square(found: lf.Fit, truth: dict[str, float]) -> float:
    paths = [each.parameter.path for each in found.estimates]
    (both,) = found.combinations
    known = [i for i, each in enumerate(found.estimates) if not each.together] + [
        paths.index(next(iter(both.coefficients)))
    ]
    beside = deviations(found, truth)
    return float(beside @ np.linalg.solve(found.covariance[np.ix_(known, known)], beside))


@pytest.fixture(scope="module")
def taken() -> tuple[lf.Scene, dict[str, float], lf.Exposed]:
    scene, truth = camera(12, 12), errors(7)
    return scene, truth, exposed(scene, truth, 7)


@pytest.fixture(scope="module")
def found(taken: tuple[lf.Scene, dict[str, float], lf.Exposed]) -> lf.Fit:
    scene, _, picture = taken
    return lf.fit(picture, scene, samples=64)


def test_known_errors_come_back_within_their_intervals(found: lf.Fit, taken: Any) -> None:
    _, truth, _ = taken
    assert chi_square(found, truth) < chi2.ppf(1.0 - LEVEL, 6)
    assert found.rms_px < 1.0 / 20.0
    # Intervals that hold anything would pass: a turn of the array shows to some thousandths of a degree.
    assert found["array: rotation"].standard_error < 0.01
    assert found["array: shift in x"].standard_error < 0.001
    assert found.pitch_px == pytest.approx(
        lf.calibrate(taken[0].changed(truth)).pitch_px, abs=4.0 * found.pitch_error_px
    )


def test_pitch_and_distance_are_only_known_together(found: lf.Fit, taken: Any) -> None:
    """Micro-images lie (p / pixel)(D + d) / D apart: a relative error of p is that of −1/D for each mm of distance."""
    (both,) = found.combinations
    assert set(both.coefficients) == {PITCH, DISTANCE}
    kept = [each.parameter.path for each in found.estimates if each.kept]
    assert kept == [DISTANCE]
    assert found[DISTANCE].value == 0.0
    assert both.coefficients[PITCH] == 1.0
    assert both.coefficients[DISTANCE] == pytest.approx(-1.0 / RayModel.of(taken[0]).pupil_to_array_mm, rel=0.01)


@pytest.mark.long
def test_stated_intervals_cover_the_truth_over_fifty_draws() -> None:
    """Normalised squares of 50 draws: χ² with 300 degrees of freedom; of the intervals of two σ, 95 %."""
    scene, squares, inside = camera(16, 16), [], []
    for seed in range(50):
        truth = errors(seed)
        fitted = lf.fit(exposed(scene, truth, seed), scene.changed({"transport.seed": 5000 + 20 * seed}))
        assert fitted.rms_px < 1.0 / 20.0
        squares.append(chi_square(fitted, truth))
        sizes = [each.standard_error for each in fitted.estimates if not each.together]
        sizes.append(fitted.combinations[0].standard_error)
        inside.append(np.abs(deviations(fitted, truth)) < 2.0 * np.array(sizes))
    assert sum(squares) < chi2.ppf(1.0 - LEVEL, 300)
    assert np.mean(inside) > 0.9


def test_files_of_a_fit(found: lf.Fit, taken: Any, tmp_path: Path) -> None:
    from lfmesh.study.fits.fit_files import write_fit

    warning = lf.CutPathsWarning("paths were cut")
    scene, table, picture = write_fit(replace(found, warnings=(warning,)), tmp_path / "new" / "fitted")
    assert lf.load(scene).camera == found.scene.camera
    values = json.loads(table.read_text())
    assert values["known_together"][0]["coefficients"].keys() == {PITCH, DISTANCE}
    by_path = {each["path"]: each for each in values["parameters"]}
    assert values["warnings"] == [warning.as_dict()]
    assert by_path[DISTANCE]["kept"]
    assert by_path[DISTANCE]["standard_error"] is None
    assert np.shape(values["covariance"]) == (7, 7)
    assert len(np.unique(np.asarray(PIL.Image.open(picture)))) > 10


def test_warnings_of_simulated_images_are_those_of_the_fit_even_if_there_is_none(found: lf.Fit, taken: Any) -> None:
    assert found.warnings == ()
    scene, _, picture = taken
    dark = scene.changed({"transport.max_events": 2})
    with (
        pytest.warns(lf.CutPathsWarning, match="1 of 1 simulated white images, such as image 1"),
        pytest.raises(lf.LfmeshError, match="black"),
    ):
        lf.fit(picture, dark, samples=8)


def test_a_file_that_changes_during_a_fit_ends_it_with_its_name(taken: Any, tmp_path: Path) -> None:
    """Simulated images of one fit would be of two sensors; the response is read for each of them."""
    scene, _, picture = taken
    response = tmp_path / "green.csv"
    response.write_text("wavelength_nm,response\n540,0\n550,1\n560,0\n")
    banded = scene.changed({"camera.sensor.bands": [{"name": "green", "response": str(response)}]})
    said: list[str] = []

    def change_before_the_second(words: str) -> None:
        said.append(words)
        if words == "simulating white image 1":
            response.write_text("wavelength_nm,response\n640,0\n650,1\n660,0\n")

    with pytest.raises(lf.FileError, match=r"green\.csv has changed"):
        lf.fit(picture, banded, samples=2, progress=change_before_the_second)
    assert said == ["tracing derivatives", "simulating white image 1"]


def test_places_are_the_phase_of_a_lattice_whatever_the_background() -> None:
    """Two crossed cosines have their bright places at known points."""
    scene = camera(8, 8)
    pitch = RayModel.of(scene).micro_image_pitch_px
    truth = Lattice(False, pitch, 8, 8).centres() + 39.5 + np.array([1.3, -2.1])
    wave = [1.0 + np.cos(2.0 * np.pi * (np.arange(80) - truth[0, 0, axis]) / pitch) for axis in (0, 1)]
    light = np.outer(wave[1], wave[0]) ** 2
    for background in (0.0, 1.0):
        places = micro_image_places(light + background, scene)
        known = np.isfinite(places[..., 0])
        assert known.sum() >= 25
        assert np.abs(places - truth)[known].max() < 1e-3


def hexagonal_waves(away: NDArray[np.float64], pitch: float) -> list[NDArray[np.float64]]:
    """Return the sums of a hexagonal lattice's three shortest cosines, and of the three next, about one of its points.

    Crests of the first are pitch √3 / 2 apart, and a crest runs through rows of neighbours; of the next, pitch / 2.
    """
    sums = []
    for first, apart in ((30.0, np.sqrt(0.75) * pitch), (0.0, 0.5 * pitch)):
        angles = np.deg2rad(first + np.arange(0.0, 180.0, 60.0))
        sums.append(sum(np.cos(2.0 * np.pi / apart * (away @ np.array([np.cos(a), np.sin(a)]))) for a in angles))
    return sums


def hexagonal_scene() -> tuple[lf.Scene, NDArray[np.float64], list[NDArray[np.float64]]]:
    """Return a camera, where its micro-images lie, and the waves about them."""
    scene = lf.loads(bench_camera(10, 10).replace("pitch_mm = 0.125", 'layout = "hexagonal"\npitch_mm = 0.125'))
    scene = solved_camera(scene).scene
    pitch = RayModel.of(scene).micro_image_pitch_px
    truth = Lattice(True, pitch, 10, 10).centres() + 49.5 + np.array([0.8, -1.2])
    pixels = np.stack(np.meshgrid(np.arange(100.0), np.arange(100.0)), axis=-1)
    return scene, truth, hexagonal_waves(pixels - truth[0, 0], pitch)


@pytest.mark.parametrize("shares", [(0.2, 0.1), (0.2, -0.1), (0.03, -0.1)])
def test_hexagonal_places_are_the_phase_of_the_stronger_waves(shares: tuple[float, float]) -> None:
    """Of disks that nearly touch, the shortest waves all but vanish, and the next are dark in the middle."""
    scene, truth, waves = hexagonal_scene()
    places = micro_image_places(1.0 + shares[0] * waves[0] + shares[1] * waves[1], scene, truth + 0.2)
    known = np.isfinite(places[..., 0])
    assert known.sum() >= 40
    assert np.abs(places - truth)[known].max() < 1e-3


def test_overlapping_micro_images_are_not_taken_for_the_light_between_them() -> None:
    """Where hexagonal micro-images overlap, the light is brightest half way to their neighbours."""
    scene, truth, waves = hexagonal_scene()
    light = 1.0 - 0.2 * waves[0]
    places = micro_image_places(light, scene, truth + 0.2)
    known = np.isfinite(places[..., 0])
    assert known.sum() >= 40
    assert np.abs(places - truth)[known].max() < 1e-3
    assert np.nanmin(np.linalg.norm(micro_image_places(light, scene) - truth, axis=-1)) > 1.0


def test_equal_columns_are_not_told_apart() -> None:
    rows = np.random.default_rng(1).normal(size=(40, 3))
    rows[:, 2] = 0.5 * rows[:, 1]
    split = Split.of(rows, 0.1)
    assert split.free == [0, 1]
    assert split.kept == [2]
    assert split.group == (1, 2)
    assert split.traded[1, 0] == pytest.approx(-0.5)
    assert split.traded[0, 0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("orientation", ["upright", "upside_down", "sensor"])
def test_pictures_are_turned_as_they_lie(orientation: Any) -> None:
    scene = camera(8, 8)
    raw = np.random.default_rng(2).uniform(1.0, 2.0, (80, 80))
    upright = Upright.of(scene).picture(raw)
    lies = {"upright": upright, "upside_down": upright[::-1, ::-1], "sensor": raw}
    assert np.array_equal(light_of(lies[orientation], scene, orientation), raw)


FULL = np.full((80, 80), 255, np.uint8)


@pytest.mark.parametrize(
    ("picture", "words"),
    [
        (np.ones((80, 90)), r"90 × 80 pixels, but camera\.sensor\.pixels = \[80, 80\]"),
        (np.zeros((80, 80)), "is black"),
        (FULL, r"100\.0% of the white image's pixels are at 255.*saturated"),
        (np.full((80, 80), np.nan), "not numbers"),
        (np.ones((80, 80)), "no camera like the scene.s fits this picture"),
        (np.ones((4, 80, 80)), "80 × 4 pixels"),
        (np.ones(80), r"must be \(H, W\)"),
        (np.array([["a"]]), "real numbers"),
    ],
)
def test_a_picture_that_cannot_be_fitted_is_refused_in_one_line(picture: NDArray[Any], words: str) -> None:
    with pytest.raises(lf.LfmeshError, match=words) as refused:
        lf.fit(picture, camera(8, 8))
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"also": {"camera.sensor.distanc_mm": 0.1}}, "distance_mm"),
        ({"also": {"camera.sensor.pixels": 0.1}}, "only finite numbers can be fitted"),
        ({"also": {"camera.sensor.distance_mm": 0.0}}, "above 0"),
        ({"also": {PITCH: 0.1}}, "fitted already"),
        ({"orientation": "left"}, "must be one of upright, upside_down, sensor"),
        ({"samples": 1}, "2 or more"),
    ],
)
def test_a_wrong_option_is_named(options: dict[str, Any], words: str) -> None:
    with pytest.raises(lf.LfmeshError, match=words):
        lf.fit(np.eye(80), camera(8, 8), **options)


def test_a_conventional_camera_has_nothing_to_fit() -> None:
    with pytest.raises(lf.LfmeshError, match=r"camera\.mla is missing"):
        lf.fit(np.ones((6, 6)), lf.Scene(camera=camera_without_array()))


@pytest.mark.parametrize("content", [b"no picture", b"\x89PNG\r\n\x1a\nbroken"])
def test_the_command_says_what_is_wrong_with_a_file(
    content: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, picture = tmp_path / "scene.toml", tmp_path / "white.png"
    scene.write_text(as_text(camera=camera_without_array()))
    assert main(["fit", str(picture), str(scene), "-o", str(tmp_path / "out")]) == 2
    assert "does not exist" in capsys.readouterr().err
    picture.write_bytes(content)
    assert main(["fit", str(picture), str(scene), "-o", str(tmp_path / "out")]) == 2
    assert "picture" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_errors_of_neighbours_that_share_light_widen_the_intervals() -> None:
    """Moving averages of white noise on shift, turn, scale and tilts of 22 × 22: χ² of 6 × 300 degrees of freedom.

    Taken as independent, their squares are larger by half.
    """
    draw, n = np.random.default_rng(3), 22
    y, x = np.meshgrid(np.linspace(-1.0, 1.0, n), np.linspace(-1.0, 1.0, n), indexing="ij")
    ways = [(x**0, 0 * x), (0 * x, x**0), (-y, x), (x, y), (x * x, x * y), (x * y, y * y)]
    slopes = np.stack([np.stack(way, axis=-1) for way in ways], axis=-1)
    used, rows = np.ones((n, n), bool), slopes.reshape(-1, 6)
    inverse = np.linalg.inv(rows.T @ rows)
    squares, alone = 0.0, 0.0
    for _ in range(300):
        white = draw.normal(size=(n + 1, n + 1, 2))
        noise = white[1:, 1:] + 0.15 * (white[:-1, 1:] + white[1:, :-1])
        found = inverse @ rows.T @ noise.ravel()
        left = (noise.ravel() - rows @ found).reshape(noise.shape)
        covariance = inverse @ neighbours_meat(left, slopes, used) @ inverse
        squares += float(found @ np.linalg.solve(covariance, found))
        alone += float(found @ np.linalg.solve(inverse * (left**2).sum() / (2 * n * n - 6), found))
    # Beside the test's own level 5 %: the covariance is estimated, too.
    assert chi2.ppf(LEVEL, 1800) < squares < 1.05 * chi2.ppf(1.0 - LEVEL, 1800)
    assert alone > 1.3 * 1800


def test_what_changes_slowly_over_the_array_is_kept() -> None:
    """A cubic comes back to rounding, also where a third of the micro-images is not known."""
    y, x = np.meshgrid(np.linspace(-1.0, 1.0, 9), np.linspace(-1.0, 1.0, 12), indexing="ij")
    cubic = np.stack([1.0 + x - 2.0 * x * y**2, x**3 - y], axis=-1)
    torn = np.where(np.random.default_rng(2).random((9, 12, 1)) < 0.3, np.nan, cubic)
    np.testing.assert_allclose(smooth(torn), cubic, atol=1e-12)
