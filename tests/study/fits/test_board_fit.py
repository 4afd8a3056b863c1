"""Focus and pose of a board come back from rendered pictures within the errors that the fit states."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import PIL.Image
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import binom, chi2

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.lightfield.views.decode import sampling_of, sorted_views
from lfmesh.lightfield.views.upright import Upright
from lfmesh.study.fits.board_fit import FOCUS, FOCUS_REACH, with_boards
from lfmesh.study.fits.board_pictures import fully_lit, of_own_lenslets
from lfmesh.study.fits.ray_map import RayMap
from lfmesh.study.fits.white_picture import light_of
from tests.cameras import bench_camera
from tests.study.fits.test_fit import LEVEL, errors

CORNERS, SQUARE_MM = 4, 5.5
"""Along each side, between four squares, and the side of a square."""


class Taken(NamedTuple):
    """What a camera with errors took, and the truth."""

    scene: lf.Scene
    truth: dict[str, float]
    pose: NDArray[np.float64]
    white: lf.Image
    board: lf.Image


def camera() -> lf.Scene:
    return solved_camera(lf.loads(bench_camera(24, 24))).scene


def taken_at(seed: int, folder: Path, samples: int, nearest_mm: float = 440.0) -> Taken:
    """Render white image and board of a random camera near the bench camera's, with a random pose."""
    scene, random = camera(), np.random.default_rng(900 + seed)
    truth = errors(seed) | {FOCUS: float(scene.camera.mla.distance_mm or 0.0) + random.uniform(-0.3, 0.3)}
    pose = np.array(
        [*random.uniform(-1.0, 1.0, 2), -random.uniform(nearest_mm, 560.0), *random.uniform(-15.0, 15.0, 3)]
    )
    squares = np.indices((CORNERS + 1, CORNERS + 1)).sum(axis=0) % 2
    PIL.Image.fromarray((255 * np.kron(squares, np.ones((32, 32)))).astype(np.uint8)).save(folder / "board.png")
    side = (CORNERS + 1) * SQUARE_MM
    target = {
        "shape": {"kind": "plane", "width_mm": side, "height_mm": side},
        "position_mm": pose[:3].tolist(),
        "rotation_deg": pose[3:].tolist(),
        "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0, "texture": str(folder / "board.png")},
    }
    settings = {"samples": samples, "split": "transmit", "seed": 3000 + seed, "replicates": 2}
    built = scene.changed(truth).changed({f"transport.{name}": value for name, value in settings.items()})
    return Taken(scene, truth, pose, lf.white_image(built), lf.render(built.changed({"targets": (target,)})))


def exposed(image: lf.Image, seed: int) -> lf.Exposed:
    return lf.Detector(seed=seed).filling(image).expose(image)


def white_fit(taken: Taken, seed: int, samples: int) -> tuple[lf.Fit, NDArray[np.float64]]:
    white = exposed(taken.white, seed)
    reach = FOCUS_REACH * float(taken.scene.camera.mla.distance_mm or 0.0)
    return lf.fit(white, taken.scene, also={FOCUS: reach}, samples=samples), light_of(white, taken.scene, "upright")


def deviations(found: lf.BoardFit, taken: Taken) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return focus and pose less their truth, (7,), and their covariance as stated."""
    (pose,) = found.poses
    count = len(found.estimates)
    known = [[each.parameter.path for each in found.estimates].index(FOCUS), *range(count, count + 6)]
    beside = np.array([*pose.position_mm, *pose.rotation_deg]) - taken.pose
    return np.array([found[FOCUS].value - taken.truth[FOCUS], *beside]), found.covariance[np.ix_(known, known)]


@pytest.fixture(scope="module", autouse=True)
def _maps_are_traced_once() -> Iterator[None]:
    """Trace the rays of each camera once: all fits but one start from the same camera and its neighbours."""
    traced, known = RayMap.of, dict[Any, RayMap]()

    def of(scene: lf.Scene, decoded: lf.Calibration, reach: float, *, of_bundles: bool = False) -> RayMap:
        key = scene, decoded.centres_px.tobytes(), decoded.known.tobytes(), reach, of_bundles
        if key not in known:
            known[key] = traced(scene, decoded, reach, of_bundles=of_bundles)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RayMap, "of", of)
        yield


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> Taken:
    return taken_at(3, tmp_path_factory.mktemp("board"), 32)


@pytest.fixture(scope="module")
def by_white(taken: Taken) -> tuple[lf.Fit, NDArray[np.float64]]:
    return white_fit(taken, 1, 8)


@pytest.fixture(scope="module")
def found(taken: Taken, by_white: Any) -> list[lf.BoardFit]:
    boards = [lf.Board(exposed(taken.board, seed), SQUARE_MM, CORNERS, CORNERS) for seed in (11,)]
    return [with_boards(by_white[0], taken.scene, by_white[1], [board]) for board in boards]


def test_focus_and_pose_come_back_within_their_intervals(found: list[lf.BoardFit], taken: Taken) -> None:
    for each in found:
        beside, covariance = deviations(each, taken)
        assert beside @ np.linalg.solve(covariance, beside) < chi2.ppf(1.0 - LEVEL, 7)
        assert each.rms < 1.0 / 20.0
        # Intervals that hold anything would pass; the white image alone leaves the focus open.
        assert each.white[FOCUS].kept
        assert np.all(np.sqrt(np.diag(covariance)) < [0.03, 0.005, 0.005, 0.5, 0.15, 0.15, 0.03])
        assert len(np.unique(each.corners[0].corner)) == CORNERS**2


def test_a_board_of_another_size_moves_away(taken: Taken, by_white: Any) -> None:
    """Squares 1 % larger: the shift from view to view, which depends on the distance, no longer goes with the size."""
    board = lf.Board(exposed(taken.board, 12), 1.01 * SQUARE_MM)
    found = with_boards(by_white[0], taken.scene, by_white[1], [board])
    beside, covariance = deviations(found, taken)
    assert beside @ np.linalg.solve(covariance, beside) > chi2.ppf(1.0 - LEVEL, 7)


def test_rays_of_the_map_are_those_of_pixels() -> None:
    scene = camera()
    calibration = lf.calibrate(scene)
    rays = RayMap.of(scene, calibration, 4.5)
    random = np.random.default_rng(5)
    lenslets, views = random.integers(2, 22, (40, 2)), random.uniform(-2.5, 2.5, (40, 2))
    # The lens inverts: columns of the picture run against those of the array.
    pixels = calibration.centres_px[lenslets[:, 1], lenslets[:, 0]] + views * (-1.0, 1.0)
    traced = lf.object_rays(scene, lenslets, pixels)
    place = np.column_stack([23 - lenslets[:, 0], lenslets[:, 1], views])
    x, y, along_x, along_y = (rays.terms(place, np.zeros((40, 2))) @ rays.coefficients).T
    slope = traced.direction[:, :2] / traced.direction[:, 2:]
    at_zero = traced.origin[:, :2] - traced.origin[:, 2:] * slope
    # A thousandth of a sample is 1 µm on a board at 500 mm.
    assert np.abs(np.column_stack([along_x, along_y]) - slope).max() * 500.0 < 1e-3
    assert np.abs(np.column_stack([x, y]) - at_zero).max() < 1e-3


def test_samples_that_the_lens_cuts_are_not_used() -> None:
    white = np.ones((5, 5, 6, 6))
    white[0], white[:, 4], white[1, 1] = 0.02, np.nan, 0.8
    lit = fully_lit(white + 0.005 * np.random.default_rng(6).normal(size=white.shape))
    assert lit[2:, :4].all()
    assert not lit[0].any()
    assert not lit[:, 4].any()
    assert not lit[1, 1].any()


def test_samples_with_light_of_the_next_lenslets_are_not_used() -> None:
    """Every second micro-image is drawn, as a disk of the pupil's size: what the others' samples see is foreign."""
    scene = camera()
    calibration, upright = lf.calibrate(scene), Upright.of(scene)
    sampling, count = sampling_of(calibration, upright), 10
    radius = 0.5 * calibration.lenslet_to_sensor_mm / calibration.f_number / calibration.pixel_mm
    fine = (np.arange(240 * 8) + 0.5) / 8.0 - 0.5
    parity = np.indices((24, 24)).sum(axis=0) % 2
    seen = {}
    for slack in (0.0, 0.15):
        drawn = np.zeros((2, 240 * 8, 240 * 8))
        for row, column in np.ndindex(24, 24):
            x, y = calibration.centres_px[row, column]
            near = [np.flatnonzero(np.abs(fine - middle) < radius + 1.0) for middle in (x, y)]
            disk = np.hypot(fine[near[0]] - x, (fine[near[1]] - y)[:, None]) < radius + slack
            drawn[parity[row, column]][np.ix_(near[1], near[0])] += disk
        pixels = drawn.reshape(2, 240, 8, 240, 8).mean(axis=(2, 4))
        each = [sorted_views(light, calibration, count, sampling, upright) for light in pixels]
        lenslet = parity[sampling.rows[:, None], sampling.columns[0]]
        seen[slack] = np.where(lenslet == 0, each[1], each[0])
    own = of_own_lenslets(calibration, sampling, upright, count)
    known = np.isfinite(seen[0.0])
    assert (seen[0.0][own & known] < 0.003).all()
    assert (seen[0.15][~own & known] > 0.0).all()
    # Both kinds are there: the outermost views that are lit see neighbours, the inner ones do not.
    assert own[2:8, 2:8].all()
    assert (seen[0.0][~own & known] > 0.05).sum() > 100


def test_places_that_lie_beside_the_fit_are_left_out_within_few_rounds(
    found: list[lf.BoardFit], taken: Taken, by_white: Any
) -> None:
    """One place in eight, those of the outermost views, is moved towards the middle by a quarter of a sample."""
    (seen,) = found[0].corners
    far = np.argsort(np.linalg.norm(seen.view, axis=1))[-len(seen.view) // 8 :]
    sample = seen.sample.copy()
    sample[far] -= 0.25 * seen.view[far] / np.linalg.norm(seen.view[far], axis=1, keepdims=True)
    said: list[str] = []
    board = lf.Board(corners=replace(seen, sample=sample))
    again = with_boards(by_white[0], taken.scene, by_white[1], [board], progress=said.append)
    assert np.isnan(again.residuals[0][far]).all()
    assert again.left_out < 1.05 * len(far)
    assert sum("round" in line for line in said) <= 4
    beside, covariance = deviations(again, taken)
    assert beside @ np.linalg.solve(covariance, beside) < chi2.ppf(1.0 - LEVEL, 7)


def test_a_start_on_the_wrong_side_does_not_turn_the_tilts_over(
    taken: Taken, by_white: Any, found: list[lf.BoardFit], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Squares seen under parallel rays look alike for both signs of the tilts: each is a minimum."""
    turn = Rotation.from_euler("xyz", taken.pose[3:], degrees=True).as_rotvec() * (-1.0, -1.0, 1.0)
    start = np.concatenate([taken.pose[:3], turn])
    monkeypatch.setattr("lfmesh.study.fits.board_fit.first_pose", lambda *_: start)
    again = with_boards(by_white[0], taken.scene, by_white[1], [lf.Board(corners=found[0].corners[0])])
    beside, covariance = deviations(again, taken)
    assert beside @ np.linalg.solve(covariance, beside) < chi2.ppf(1.0 - LEVEL, 7)


def test_the_command_writes_scene_values_and_pictures(
    found: list[lf.BoardFit], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, white, board = tmp_path / "scene.toml", tmp_path / "white.png", tmp_path / "near.png"
    scene.write_text(bench_camera(24, 24))
    for path in (white, board):
        PIL.Image.fromarray(np.eye(240, dtype=np.uint8)).save(path)
    asked: list[Any] = []
    monkeypatch.setattr(
        "lfmesh.study.fits.board_fit.fit_boards", lambda *given, **options: asked.append(given) or found[0]
    )
    command = ["fit", str(white), str(scene), "-o", str(tmp_path / "out"), "--board", str(board), "--square-mm", "5.5"]
    assert main([*command, "--grid", "4", "4"]) == 0
    (given,) = asked[0][2]
    assert (given.square_mm, given.columns, given.rows) == (5.5, 4, 4)
    said = capsys.readouterr().out
    assert "near.png: position" in said
    assert "Only known together: z of near.png" in said
    assert lf.load(tmp_path / "out" / "fitted.toml").camera == found[0].scene.camera
    values = json.loads((tmp_path / "out" / "fit.json").read_text())
    assert values["boards"][0]["position_mm"] == list(found[0].poses[0].position_mm)
    assert {each["path"] for each in values["parameters"]} >= {FOCUS}
    for name in ("residuals.png", "board_residuals.png"):
        assert len(np.unique(np.asarray(PIL.Image.open(tmp_path / "out" / name)))) > 10
    assert main(["fit", str(white), str(scene), "-o", str(tmp_path / "no"), "--square-mm", "5"]) == 2
    assert "--board" in capsys.readouterr().err
    assert main(["fit", str(white), str(scene), "-o", str(tmp_path / "no"), "--board", str(board)]) == 2
    assert "square_mm = None" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()


def test_a_fit_without_boards_is_refused() -> None:
    with pytest.raises(lf.LfmeshError, match="boards is empty"):
        lf.fit_boards(np.eye(240), camera(), [])


@pytest.mark.long
def test_stated_intervals_cover_the_truth_over_twenty_draws(tmp_path: Path) -> None:
    """Of each of the seven values, at least as many lie within two standard errors as a binomial law of 95 % gives."""
    inside = []
    for seed in range(20):
        # Some turned boards that stand nearer are not whole in view, and are refused.
        taken = taken_at(seed, tmp_path, 256, nearest_mm=480.0)
        fitted, light = white_fit(taken, seed, 128)
        board = lf.Board(exposed(taken.board, 50 + seed), SQUARE_MM, CORNERS, CORNERS)
        found = with_boards(fitted, taken.scene, light, [board])
        assert found.rms < 1.0 / 20.0
        beside, covariance = deviations(found, taken)
        inside.append(np.abs(beside) < 2.0 * np.sqrt(np.diag(covariance)))
    assert (np.sum(inside, axis=0) >= binom.ppf(LEVEL / 7.0, 20, 0.95)).all()
