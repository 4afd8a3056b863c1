"""From a scene file to pictures, end to end: a run folder that renders again, the demo, and words for the dark."""

import signal
import sys
import time
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
from scipy import stats
from scipy.spatial import ConvexHull

import lfmesh
import lfmesh as lf
import lfmesh.waves.render
from lfmesh.assets import asset_path
from lfmesh.cli import main
from lfmesh.files.run import RAW, SCENE
from lfmesh.scene import Scene
from lfmesh.transport.render.render import render
from lfmesh.view import overview

SMALL = """
schema_version = 1
name = "small"
[camera]
focus_mm = 500.0
[camera.lens]
surfaces = [
  {{ radius_mm = 50.0, thickness_mm = 4.0, index = 1.5, semi_diameter_mm = 8.0 }},
  {{ radius_mm = -50.0, thickness_mm = 1.0, semi_diameter_mm = 8.0 }},
  {{ stop = true, thickness_mm = 0.0, semi_diameter_mm = {stop_mm} }},
]
[camera.mla]
count = [6, 6]
pitch_mm = 0.125
focal_length_mm = 0.7
index = 1.5
thickness_mm = 0.3
[camera.sensor]
pixels = [60, 60]
pixel_mm = 0.0125
[[targets]]
name = "wall"
shape = {{ kind = "plane", width_mm = 60.0, height_mm = 60.0 }}
position_mm = [{target_x_mm}, 0.0, -500.0]
[[lights]]
kind = "point"
position_mm = [100.0, -100.0, {light_z_mm}]
power_w = 1.0
[transport]
samples = 8
replicates = 4
"""
LIT = {"stop_mm": 5.0, "target_x_mm": 0.0, "light_z_mm": -50.0}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(SMALL.format(**LIT))
    return tmp_path


def test_a_run_reads_back_and_its_own_scene_renders_the_same_bits_again(folder: Path) -> None:
    assert main(["render", "scene.toml", "-o", "first"]) == 0
    assert main(["render", f"first/{SCENE}", "-o", "again", "--threads", "1"]) == 0
    first, again = lfmesh.open_run("first"), lfmesh.open_run("again")
    assert first.mean.shape == (60, 60, 1)
    assert first.complete
    assert (first.mean > 0).mean() > 0.5
    np.testing.assert_array_equal(again.mean, first.mean)
    np.testing.assert_array_equal(again.stderr, first.stderr)
    direct = render(lfmesh.load("scene.toml"))
    np.testing.assert_array_equal(first.mean, direct.mean.astype(np.float32))
    assert abs(direct.ledger.imbalance) < 1e-12


def test_another_seed_gives_other_noise_and_the_same_picture(folder: Path) -> None:
    """z over the whole picture, at the 1e-4 level; the bits must differ."""
    assert main(["render", "scene.toml", "-o", "a"]) == 0
    assert main(["render", "scene.toml", "-o", "b", "--seed", "9"]) == 0
    a, b = lfmesh.open_run("a"), lfmesh.open_run("b")
    assert not np.array_equal(a.mean, b.mean)
    z = (a.mean.sum() - b.mean.sum()) / np.sqrt((a.stderr**2).sum() + (b.stderr**2).sum())
    assert abs(z) < stats.norm.isf(0.5e-4)


DARK = {
    "lamp behind the target": (
        {"light_z_mm": -900.0},
        ["reached targets[0] (wall), but nothing there emits", "targets[0] (wall) is lit by no lamp on the"],
    ),
    "target out of the field": (
        {"target_x_mm": 400.0},
        ["None of the paths traced back from the sensor reached a target; ", " left the lens and met nothing."],
    ),
    "lens cap": (
        {"stop_mm": 1e-4},
        [
            "None of the paths traced back from the sensor reached a target, or even left the lens.",
            "of the paths reached the lens; of these 100 % ended on the stop.",
        ],
    ),
}


@pytest.mark.parametrize(("change", "said"), DARK.values(), ids=DARK)
def test_a_black_picture_says_where_the_light_went(
    folder: Path, capsys: pytest.CaptureFixture[str], change: dict[str, float], said: list[str]
) -> None:
    (folder / "scene.toml").write_text(SMALL.format(**{**LIT, **change}))
    assert main(["render", "scene.toml", "-o", "run"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "The picture is black: no light reached the sensor." in out
    for words in said:
        assert words in out
    assert not lfmesh.open_run("run").mean.any()


def test_a_lit_picture_says_how_noisy_it_is_and_nothing_of_the_dark(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["render", "scene.toml", "-o", "run"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "4 times the samples, 32 per pixel, would at least halve it" in out
    assert "black" not in out
    assert "ended on" not in out


class CatchesEverything:
    """Imports that turn Ctrl-C into a module that is not there, as libraries with optional parts do."""

    def __init__(self) -> None:
        self.asked = self.caught = False

    def find_spec(self, name: str, *_: object) -> None:
        if name == "lfmesh.waves.render":
            self.asked = True
            try:
                # To this thread: one that the process is sent may wait in another until the import is over.
                signal.raise_signal(signal.SIGINT)
                time.sleep(0.01)
            except BaseException:
                self.caught = True


def test_ctrl_c_while_libraries_are_imported_stops_the_run(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    library = CatchesEverything()
    monkeypatch.setattr(sys, "meta_path", [library, *sys.meta_path])
    # The package's attribute too: both are put back, and the module that is imported here is forgotten.
    monkeypatch.setattr(lfmesh.waves, "render", lfmesh.waves.render)
    monkeypatch.delitem(sys.modules, "lfmesh.waves.render")
    # As in a process of its own: event loops of other tests leave handlers behind.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert main(["render", "scene.toml", "-o", "run"]) == 130
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert library.asked
    assert not library.caught
    assert "nothing was written" in capsys.readouterr().err
    assert not (folder / "run").exists()


def demo_scene(**changes: object) -> Scene:
    """The demo with a few large pixels, one a lenslet, and few samples: what its preview shows, coarsely."""
    scene = lfmesh.load(asset_path("scenes/first_light.toml"))
    coarse = {
        "camera.mla": None,
        "camera.sensor.distance_mm": None,
        "camera.sensor.pixels": (32, 32),
        "camera.sensor.pixel_mm": 0.25,
        "transport.samples": 256,
        "transport.replicates": 32,
        "transport.split": "transmit",
    }
    return scene.changed({**coarse, **changes})


def without(scene: Scene, name: str) -> Scene:
    return scene.model_copy(update={"targets": tuple(t for t in scene.targets if t.name != name)})


def upright(image: lf.Image) -> np.ndarray:
    """As somebody behind the camera sees it: row 0 on top (+y), columns to the right (+x)."""
    return image.mean[:, ::-1, 0]


def test_the_demo_shows_the_bracket_before_the_chart() -> None:
    """Pixels differ from a picture of the chart alone where the bracket stands, and there only.

    Where it stands is known from first-order optics: its corners, projected through the entrance pupil, so that a
    picture turned the wrong way fails. The level is 1e-3 over all pixels together (Bonferroni), two-sided, Student's t
    with the 31 degrees of freedom of 32 replicates.
    """
    scene = demo_scene()
    both, chart = render(scene), render(without(scene, "bracket"))
    error = np.hypot(both.stderr, chart.stderr)[:, ::-1, 0]
    change = np.abs(upright(both) - upright(chart)) > stats.t.isf(0.5e-3 / both.mean.size, 31) * error
    outline = bracket_on_the_picture(scene)
    assert change[outline].mean() > 0.25, "the bracket is hardly to be told from the chart"
    assert not change[~around(outline)].any(), "something changed beside the bracket"


def bracket_on_the_picture(scene: Scene) -> np.ndarray:
    """Return the (H, W) pixels of the upright picture onto which vertices of the bracket are imaged."""
    report = lfmesh.first_order(scene)
    corners = lfmesh.build(scene).mesh("targets[0]").vertices
    pupil = report.entrance_pupil_z_mm
    scale = (report.object_distance_mm + pupil) / (pupil - corners[:, 2])
    side = report.field_of_view_mm[0]
    pixels = scene.camera.sensor.pixels[0]
    place = np.stack([corners[:, 0], -corners[:, 1]]) * scale / side + 0.5
    column, row = np.clip(place * pixels, 0, pixels - 1).astype(int)
    hit = np.zeros((pixels, pixels), bool)
    hit[row, column] = True
    return hit


def around(outline: np.ndarray) -> np.ndarray:
    """Return the convex hull of the outline and two pixels more, for blur."""
    sides = ConvexHull(np.argwhere(outline)).equations
    distance = np.einsum("sk,krc->src", sides[:, :2], np.indices(outline.shape)) + sides[:, 2, None, None]
    return np.asarray(distance.max(axis=0) <= 2.0)


@pytest.fixture
def small_demo(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the demo's run, whose scene has few lenslets."""
    small = lfmesh.load(asset_path("scenes/demo.toml")).changed(
        {"camera.sensor.pixels": (160, 160), "camera.mla.count": (16, 16)}
    )
    monkeypatch.setattr("lfmesh.scene.load", lambda _: small)
    return folder / "lfmesh-demo"


def test_the_demo_command_writes_every_picture(small_demo: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--samples", "8"]) == 0
    out = capsys.readouterr().out
    for name in ("preview.png", "preview_view.png", "linear16_R.png", "report.json", "overview.png", RAW, SCENE):
        assert (small_demo / name).is_file()
    assert np.ptp(np.asarray(PIL.Image.open(small_demo / "preview.png")).astype(int), axis=2).max() > 100, "grey"
    lines = out.splitlines()
    assert len(lines) <= 10
    assert max(map(len, lines)) <= 80
    assert lines[0].split()[0] == str(Path("lfmesh-demo") / "overview.png")
    assert {line.split(":")[0] for line in lines} >= {"Noise", "Checks", "Next"}
    for term in ("naimed", "equential", "quarter", "blocks", "deviation"):
        assert term not in out, "words for those who know the method"


def test_the_demos_sheet_shows_two_different_photographs_and_a_depth_that_varies(small_demo: Path) -> None:
    assert main(["demo", "--samples", "8"]) == 0
    with PIL.Image.open(small_demo / "overview.png") as sheet:
        assert sheet.size == (overview.WIDTH, overview.HEIGHT)
        lower = np.asarray(sheet.convert("RGB")).astype(int)[-overview.MARGIN - overview.SMALL : -overview.MARGIN]
    step = overview.SMALL + overview.GAP
    view, near, far, depth = (
        lower[:, overview.MARGIN + k * step : overview.MARGIN + k * step + overview.SMALL] for k in range(4)
    )
    assert np.abs(near - far).mean() > 2.0
    for picture in (view, near, far, depth):
        assert picture.std() > 20.0
        assert np.ptp(picture, axis=2).max() > 60, "grey"


def test_without_libraries_for_drawing_the_sheet_has_the_layout(
    small_demo: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(_: object) -> None:
        raise lf.LfmeshError("drawing needs the GL libraries")

    monkeypatch.setattr(overview.Probe, "check", missing)
    assert main(["demo", "--samples", "4"]) == 0
    with PIL.Image.open(small_demo / "overview.png") as sheet:
        upper = np.asarray(sheet.convert("L"))[overview.MARGIN + overview.CAPTION :][: overview.LARGE]
    assert np.median(upper[:, overview.MARGIN : overview.MARGIN + overview.LARGE]) == 255, "paper of the drawing"


def test_ctrl_c_while_the_sheet_is_drawn_keeps_the_run(
    small_demo: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(overview, "camera_picture", stopped)
    assert main(["demo", "--samples", "4"]) == 130
    assert f"the run in {Path('lfmesh-demo')} is saved" in capsys.readouterr().err
    assert lfmesh.open_run(small_demo).complete
    assert not (small_demo / "overview.png").exists()
