"""Three cameras on one scene: what measures them is right, and they differ as optics say."""

import io
import json
import math
import re
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import erf

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.cli import main
from lfmesh.study.cameras import compare as comparing
from lfmesh.study.cameras.compare import CONVENTIONAL, FOCUSED, STANDARD, compare, sharp_range, three_cameras
from lfmesh.study.metrics.resolution import edge_mtf50, point_width

Array = NDArray[np.float64]


LAMP = {
    "shape": {"kind": "disk", "radius_mm": 2.5},
    "position_mm": (8.0, 5.0, -499.5),
    "material": {"reflectance": 0.0, "radiance_w_m2_sr": 10.0},
}
"""Ten times as bright as anything else, right of the middle and above it."""


def edge(sigma: float, lean_deg: float = 5.0, size: int = 80, offset: float = 0.3) -> Array:
    """A slanted edge blurred by a Gaussian."""
    t, s = np.indices((size, size)) - 0.5 * (size - 1)
    lean = np.deg2rad(lean_deg)
    return np.asarray(1.0 + erf((s * np.cos(lean) + t * np.sin(lean) - offset) / (np.sqrt(2.0) * sigma)))


@pytest.mark.parametrize("sigma", [0.8, 1.5, 3.0])
@pytest.mark.parametrize("turned", [False, True])
def test_the_mtf50_of_a_gaussian_edge_is_the_known_one(sigma: float, turned: bool) -> None:
    """exp(−2 π² σ² f²) = 1/2 at f = sqrt(ln 2 / 2) / (π σ); bins of a quarter sample blur the sharpest a little."""
    picture = edge(sigma)[:, ::-1] if turned else edge(sigma)
    known = np.sqrt(np.log(2.0) / 2.0) / (np.pi * sigma)
    assert edge_mtf50(picture) == pytest.approx(known, rel=0.04)


def test_noise_does_not_change_an_edge_much_and_without_edge_there_is_no_figure() -> None:
    noise = np.random.default_rng(1).normal(scale=0.02, size=(80, 80))
    assert edge_mtf50(edge(1.5) + noise) == pytest.approx(edge_mtf50(edge(1.5)), rel=0.1)
    assert np.isnan(edge_mtf50(np.ones((80, 80))))
    assert np.isnan(edge_mtf50(np.ones((3, 80))))


def test_rows_that_got_no_light_do_not_count() -> None:
    lit = np.random.default_rng(2).random(80) < 0.7
    assert edge_mtf50(edge(1.5) * lit[:, None]) == pytest.approx(edge_mtf50(edge(1.5)), rel=0.02)
    assert np.isnan(edge_mtf50(edge(1.5) * (np.arange(80) < 5)[:, None]))


def test_a_points_width_is_that_of_its_spread() -> None:
    t, s = np.indices((61, 61)) - 30.0
    spot = np.exp(-0.5 * ((t - 1.3) ** 2 + (s + 0.4) ** 2) / 2.0**2)
    assert point_width(spot, (31.0, 30.0), 20.0) == pytest.approx(np.hypot(2.0, np.sqrt(1 / 12)), rel=1e-3)
    assert np.isnan(point_width(np.zeros((9, 9)), (4.0, 4.0), 3.0))


def scene(**camera: Any) -> lf.Scene:
    lens = {"file": asset_path("lenses/double_gauss_50mm.toml").as_posix(), "stop_semi_diameter_mm": 4.77}
    array = {"count": (32, 32), "pitch_mm": 0.125, "focal_length_mm": 0.5, "index": 1.5, "thickness_mm": 0.3}
    chart = {
        "shape": {"kind": "plane", "width_mm": 38.0, "height_mm": 38.0},
        "position_mm": (0.0, 0.0, -500.0),
        "material": {
            "reflectance": 0.0,
            "radiance_w_m2_sr": 1.0,
            "texture": asset_path("charts/chart.png").as_posix(),
        },
    }
    return lf.Scene(
        camera={
            "focus_mm": 500.0,
            "lens": lens,
            "mla": array,
            "sensor": {"pixels": (320, 320), "pixel_mm": 0.0125},
            **camera,
        },
        targets=[chart],
        transport={"split": "transmit", "samples": 4, "replicates": 2, "threads": 2},
    )


def test_the_cameras_share_lens_sensor_and_samples() -> None:
    cameras = three_cameras(scene())
    assert list(cameras) == [CONVENTIONAL, STANDARD, FOCUSED]
    shared = [
        (of.camera.lens, of.camera.sensor.pixels, of.camera.sensor.pixel_mm, of.transport) for of in cameras.values()
    ]
    assert shared[0] == shared[1] == shared[2]
    assert lf.first_order(cameras[CONVENTIONAL]).object_distance_mm == pytest.approx(500.0)
    assert cameras[CONVENTIONAL].camera.mla is None


class Commanded(NamedTuple):
    """What a run of `lfmesh compare` returns inside, writes and prints."""

    result: comparing.Comparison
    folder: Path
    output: str
    errors: str


@pytest.fixture(scope="module")
def commanded(tmp_path_factory: pytest.TempPathFactory) -> Commanded:
    """The comparison of the camera before the chart and the lamp, by the command."""
    folder = tmp_path_factory.mktemp("compare")
    file, results = folder / "scene.toml", []
    file.write_text(scene().changed({"targets": [*scene().targets, LAMP]}).dump_toml())

    def kept(*arguments: Any, **settings: Any) -> comparing.Comparison:
        results.append(compare(*arguments, **settings))
        return results[-1]

    output, errors = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(output), redirect_stderr(errors):
        patch.setattr(comparing, "compare", kept)
        assert main(["compare", str(file), "-o", str(folder / "out"), "--steps", "3", "--samples", "4"]) == 0
    (result,) = results
    return Commanded(result, folder / "out", output.getvalue(), errors.getvalue())


def test_each_camera_is_best_at_what_it_is_for(commanded: Commanded) -> None:
    """Pixels go to resolution, to directions, or to some of both; sharpness over distances follows.

    And all of the pictures stand upright.
    """
    result = commanded.result
    conventional, standard, focused = result.cameras
    for picture in result.pictures:
        # Sensor and array see 40 mm of the plane; +x is to the right and +y up.
        height, width = picture.shape
        row, column = np.argwhere(picture > 5.0).mean(axis=0)
        assert (column + 0.5) / width == pytest.approx(0.5 + 8.0 / 40.0, abs=0.02)
        assert (row + 0.5) / height == pytest.approx(0.5 - 5.0 / 40.0, abs=0.02)
    assert conventional.mtf50_lp_per_height > 1.5 * focused.mtf50_lp_per_height
    assert focused.mtf50_lp_per_height > 1.5 * standard.mtf50_lp_per_height
    assert conventional.point_width_mm < focused.point_width_mm < standard.point_width_mm
    assert conventional.views_across < focused.views_across < standard.views_across
    assert standard.views_across == pytest.approx(10.0, rel=0.02)
    # What a lenslet samples at twice the frequency at most.
    assert standard.mtf50_lp_per_height < 0.6 * standard.picture_samples[1]
    near, far = standard.refocus_range_mm
    for nearer, farther in (standard.depth_of_field_mm, conventional.depth_of_field_mm):
        assert near < 0.95 * nearer
        assert 1.3 * farther < far
    # The array bends light aside, it takes hardly any: reflections at two more faces.
    for camera in (standard, focused):
        assert camera.light_w_per_pixel == pytest.approx(conventional.light_w_per_pixel, rel=0.12)


def test_the_command_writes_a_table_a_figure_and_numbers(commanded: Commanded) -> None:
    out, said, told = commanded.folder, commanded.output, commanded.errors
    assert all(name in said for name in (CONVENTIONAL, STANDARD, FOCUSED, "MTF50", "refocus range"))
    numbers = json.loads((out / "comparison.json").read_text())
    assert [camera["name"] for camera in numbers["cameras"]] == [CONVENTIONAL, STANDARD, FOCUSED]
    assert numbers["cameras"][0]["edges"][0]["refocused"] is None
    # Four samples are few: each kind of warning is said once, with the number of pictures, and kept.
    assert all(re.match(r"\d+ of 18 pictures, such as ", each["text"]) for each in numbers["warnings"])
    assert {each["kind"] for each in numbers["warnings"]} >= {"TooFewSamplesWarning"}
    assert told.count("Warning:") == len(numbers["warnings"])
    assert (out / "comparison.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("words", "fault"), [(["--steps", "4"], "an odd number"), (["--reduction", "0.5"], "numbers above 1")]
)
def test_wrong_wishes_get_one_line_and_leave_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], fault: str
) -> None:
    out = tmp_path / "out"
    file = asset_path("scenes/emitting_plane.toml")
    assert main(["compare", str(file), "-o", str(out), *words]) == 2
    assert fault in capsys.readouterr().err
    assert not out.exists()


def test_a_conventional_scene_has_nothing_to_compare() -> None:
    with pytest.raises(lf.LfmeshError, match=r"camera\.mla is missing"):
        comparing.compare(lf.load(asset_path("scenes/conventional.toml")))


def test_a_range_of_sharp_distances_ends_where_sharpness_is_known_to_fall_and_is_open_where_it_is_not_known() -> None:
    """Sharpness falls by half of that in focus for each half dioptre: by a straight line, to the half."""
    distances = [1e3 / vergence for vergence in (2.0, 2.25, 2.5, 2.75, 3.0)]
    falls = list(zip(distances, (0.0, 0.5, 1.0, 0.5, 0.0), strict=True))
    ends, unknown = sharp_range(falls, 400.0)
    assert ends == pytest.approx((1e3 / 2.75, 1e3 / 2.25))
    assert unknown == ()
    hidden = [(at, math.nan if at < 399.0 else value) for at, value in falls]
    ends, unknown = sharp_range(hidden, 400.0)
    assert ends == pytest.approx((400.0, 1e3 / 2.25))
    assert unknown == pytest.approx((400.0,))
    ends, unknown = sharp_range([(at, 1.0) for at in distances], 400.0)
    assert unknown == ends
    assert all(map(math.isnan, sharp_range([(at, math.nan) for at in distances], 400.0)[0]))
