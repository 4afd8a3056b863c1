"""`lf.show` and `lfmesh view`: files, one clear line where nothing can be drawn, what is refused."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
import trimesh

import lfmesh
import lfmesh as lf
from lfmesh.cli import main
from lfmesh.errors import LfmeshError
from lfmesh.files import run as runs
from lfmesh.scene import Scene, loads
from lfmesh.view import show
from lfmesh.view.rays import launch
from lfmesh.view.rays.paths import Rays
from lfmesh.view.request import LaunchOptions, first_look, launched, middle_pixel, subject_of, together
from lfmesh.view.scene3d.gl import MISSING, Probe
from lfmesh.view.scene3d.plotter import Drawing, View
from tests.processor_time import HANGS_S
from tests.view.conftest import SCENE

QUICK = ["--size", "320x200", "--count", "6"]

FETCHES = re.compile(r"""(?:src|href|url|import|fetch)["']?\s*[=(:,]\s*["'`]?\s*(?:https?:)?//""", re.IGNORECASE)


def image_of(scene: Scene, power: np.ndarray) -> lf.Image:
    ledger = lf.Ledger(unit="m² sr", emitted=1.0, absorbed={"stop": 1.0}, packets=1, events=1)
    return lf.Image(power, 0.01 * power, scene, ledger, 1.0, 8, 64.0, "mesh engine")


@pytest.mark.drawing
def test_the_command_writes_a_picture_a_page_and_a_model(
    scene_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = {"--screenshot": "out.png", "--html": "out.html", "--gltf": "out.glb"}
    files = [word for option, name in names.items() for word in (option, str(tmp_path / name))]
    assert main(["view", str(scene_file), *QUICK, *files]) == 0
    printed = capsys.readouterr().out.split()
    assert printed == [str(tmp_path / name) for name in names.values()]
    with PIL.Image.open(tmp_path / "out.png") as picture:
        assert picture.size == (320, 200)
        assert len(np.unique(np.asarray(picture.convert("RGB")).reshape(-1, 3), axis=0)) > 500
    _check_page((tmp_path / "out.html").read_text(encoding="utf-8"))
    _check_model(tmp_path / "out.glb", scene_file)


def _check_page(page: str) -> None:
    """It has its words, and asks no server for anything."""
    body = page[page.index("<body>") : page.index("<script", page.index("<body>"))]
    for words in (
        "<h1>bench</h1>",
        "6 rays each from field 0,0,-200",
        "18 paths",
        "0, 0, -200 mm",
        "axis marked every",
    ):
        assert words in body
    assert "<title>bench</title>" in page
    assert not FETCHES.findall(page)


def _check_model(path: Path, scene_file: Path) -> None:
    """Bodies stand where the world has them, in metres; so do the rays."""
    subject = subject_of(scene_file)
    model = trimesh.load(path)
    rays = launched(subject.world, count=6).rays
    assert rays is not None
    for name in ("lens[0]", "lens[1]", "sensor", "targets[0]"):
        # Of a lens the rim of the traced mesh reaches a little farther than the finer one that is drawn.
        wanted = subject.world.mesh(name).bounds * 1e-3
        assert np.allclose(model.geometry[name].bounds, wanted, atol=1e-4 if name.startswith("lens") else 1e-8)
    lenslets = model.geometry["mla"].bounds
    assert np.allclose(lenslets[:, :2], subject.world.mesh("mla").bounds[:, :2] * 1e-3, atol=1e-8)
    assert np.allclose(
        model.geometry["rays"].bounds, [rays.position.min(axis=0) / 1e3, rays.position.max(axis=0) / 1e3]
    )


def test_without_a_display_one_line_says_what_to_do(
    scene_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert main(["view", str(scene_file)]) == 2
    error = capsys.readouterr().err.strip()
    assert "\n" not in error
    assert all(option in error for option in ("no display", "--screenshot", "--html", "--browser"))
    with pytest.raises(lf.LfmeshError, match=r'no display .* screenshot="out\.png" or a page with html="out\.html"$'):
        lf.show(scene_file)


def hidden(folder: Path, library: str) -> dict[str, str]:
    """Return an environment in which VTK cannot load a library that it draws with."""
    environment = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY")}
    if library == "libegl1":
        # A library of that name which holds none of its functions: the system's is not looked for any more.
        (folder / "libEGL.so.1").write_bytes(_any_library().read_bytes())
        return {**environment, "LD_LIBRARY_PATH": str(folder)}
    # Mesa looks for its drivers in this folder alone.
    return {**environment, "LIBGL_DRIVERS_PATH": str(folder)}


def _any_library() -> Path:
    maps = Path("/proc/self/maps").read_text().split()
    return next(Path(word) for word in maps if re.search(r"/libm[.-].*so", word))


@pytest.mark.drawing
@pytest.mark.skipif(sys.platform != "linux", reason="hides libraries as Linux looks for them")
@pytest.mark.parametrize("library", ["libegl1", "libgl1-mesa-dri"])
def test_a_missing_library_is_noticed_without_a_crash(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, library: str
) -> None:
    with Probe() as probe:
        probe.check()
    for name, value in hidden(tmp_path, library).items():
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("DISPLAY", raising=False)
    with Probe() as probe, pytest.raises(LfmeshError, match="libegl1 and libgl1-mesa-dri"):
        probe.check()


@pytest.mark.drawing
@pytest.mark.skipif(sys.platform != "linux", reason="hides libraries as Linux looks for them")
def test_with_missing_libraries_the_command_says_so_in_one_line(scene_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.png"
    child = subprocess.run(
        [sys.executable, "-m", "lfmesh", "view", str(scene_file), "--rays", "none", "--screenshot", str(out)],
        capture_output=True, text=True, timeout=HANGS_S,
        env={**hidden(tmp_path, "libegl1"), "PYTHONPATH": str(Path(lfmesh.__file__).parents[1])},
    )  # fmt: skip
    assert child.returncode == 2
    assert child.stderr.strip() == f"lfmesh: {MISSING}"
    assert not out.exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--screenshot", "out.jpg"], r"screenshot out\.jpg: the name must end in \.png"),
        (["--gltf", "out.obj"], r"gltf out\.obj: the name must end in \.glb"),
        (["--html", "nowhere/out.html"], r"nowhere does not exist"),
        (["--screenshot", "out.png", "--size", "huge"], r"--size huge: give WIDTHxHEIGHT"),
        (["--screenshot", "out.png", "--size", "0x10"], r"--size 0x10: give WIDTHxHEIGHT"),
        (["--table", "--rays", "beam 1"], r"unknown launch 'beam'"),
        (["--table", "--rays", "none"], r"no paths to report"),
        (["--table", "--filter", "hits(moon)"], r"moon"),
    ],
)
def test_a_mistake_gets_one_message_and_writes_nothing(
    scene_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
    options: list[str], message: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DISPLAY", "")
    assert main(["view", str(scene_file), *options]) == 2
    error = capsys.readouterr().err
    assert error.startswith("lfmesh: ")
    assert re.search(message, error)
    assert list(tmp_path.iterdir()) == [scene_file]


def test_reports_need_no_display(
    scene_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DISPLAY", "")
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    spec = ["--rays", "field 0,-8,-199", "--count", "20", "--split", "both", "--weight-cutoff", "1e-4"]
    csv = tmp_path / "paths.csv"
    assert main(["view", str(scene_file), *spec, "--filter", "ghost", "--table", "--paths", str(csv)]) == 0
    printed = capsys.readouterr().out
    assert "ghost" in printed
    assert "image path" not in printed
    assert str(csv) in printed
    assert main(["view", str(scene_file), *spec, "--path", "0", "--table"]) == 0
    assert "1 sequence," in capsys.readouterr().out


@pytest.mark.drawing
def test_in_a_notebook_it_returns_the_picture(world: lf.World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(show, "in_notebook", lambda: True)
    picture = lfmesh.show(world, "field 0,0,-190", count=4, size=(200, 120), preset="lens")
    assert isinstance(picture, PIL.Image.Image)
    assert picture.size == (200, 120)


def test_an_option_that_does_not_exist_is_refused_before_anything_is_built(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(show, "look", lambda *_, **__: pytest.fail("something was built"))
    with pytest.raises(TypeError, match=r"show\(\) got an unexpected keyword argument 'colours'"):
        lfmesh.show(tmp_path / "scene.toml", screenshot=tmp_path / "out.png", colours="path")  # type: ignore[call-arg]


def test_every_option_of_show_is_one_of_a_drawing_its_outputs_or_a_launch() -> None:
    fields = {*Drawing.__dataclass_fields__, *show.Outputs.__dataclass_fields__, *LaunchOptions.__annotations__}
    assert set(show.Options.__annotations__) == fields
    assert all(re.search(rf"\b{name}\b", lfmesh.show.__doc__ or "") for name in fields)


def test_the_picture_of_a_run_is_turned_back_to_how_it_lies_on_the_sensor(scene: Scene, tmp_path: Path) -> None:
    power = np.full((100, 120, 1), 1e-12)
    power[5:15, 80:100] = 1e-9
    image = image_of(scene.changed({"transport.replicates": 8}), power)
    runs.save(image, tmp_path / "run")
    for subject in (subject_of(tmp_path / "run"), subject_of(image)):
        assert subject.picture is not None
        bright = np.argwhere(subject.picture[..., 0] > 128)
        assert bright.min(axis=0).tolist() == [5, 80]
        assert bright.max(axis=0).tolist() == [14, 99]


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LfmeshError, match=r"has no scene\.toml; give a scene file, or a run folder"):
        subject_of(tmp_path)


def test_the_first_look_is_at_points_of_the_plane_in_focus_inside_the_field(world: lf.World) -> None:
    rays = launched(world, count=30).rays
    assert rays is not None
    starts = rays.position[rays.offsets[:-1]]
    assert np.allclose(starts[:, 2], -world.first_order.object_distance_mm)
    assert len(np.unique(starts.round(6), axis=0)) == 3
    for start in np.unique(starts.round(6), axis=0):
        assert rays.arrives[(starts.round(6) == start).all(axis=1)].mean() > 0.5


def test_a_camera_focused_on_infinity_has_a_first_look_too() -> None:
    scene = loads(SCENE.replace("focus_mm = 200.0", "").replace("[camera.mla]", "[camera.mla]\ndistance_mm = 60.0"))
    assert all(spec.startswith("field ") for spec in first_look(lfmesh.build(scene)))


def test_a_point_that_a_target_hides_is_named_with_the_target() -> None:
    wall = """
[[targets]]
name = "wall"
shape = { kind = "plane", width_mm = 20.0, height_mm = 20.0 }
position_mm = [0.0, 20.0, -150.0]
"""
    world = lf.build(loads(SCENE.replace("[[lights]]", wall + "[[lights]]")))
    seen = launched(world, ["field 0,0,-199", "field 0,30,-199"], 8, split="transmit")
    assert seen.caption[1:] == ("field 0,30,-199: no ray reaches the lens, wall stands in the way",)
    assert seen.rays is not None
    assert seen.rays.arrives.any()


def test_the_first_look_is_at_a_target_that_stands_before_the_plane_in_focus() -> None:
    ball = """
[[targets]]
shape = { kind = "sphere", radius_mm = 30.0 }
position_mm = [0.0, 0.0, -170.0]
"""
    world = lf.build(loads(SCENE.replace("[[lights]]", ball + "[[lights]]")))
    seen = launched(world, count=30)
    assert len(seen.caption) == 1
    assert seen.rays is not None
    starts = np.unique(seen.rays.position[seen.rays.offsets[:-1]].round(6), axis=0)
    assert np.hypot(np.hypot(*starts[:, :2].T), starts[:, 2] + 170.0) == pytest.approx(30.0, abs=0.3)
    assert seen.rays.arrives.mean() > 0.3


def test_a_pixel_from_which_no_ray_leaves_the_camera_is_named() -> None:
    """At the corner of four lenslets, behind a small stop."""
    world = lf.build(loads(SCENE).changed({"camera.lens.stop_semi_diameter_mm": 0.5}))
    row, column = middle_pixel(world)
    seen = launched(world, [f"pixel {column},{row}", "pixel 60,50"], 8)
    assert seen.caption[1:] == ("pixel 60,50: no ray leaves the camera",)


@pytest.mark.parametrize(
    "replaced", [("", ""), ("count = [12, 10]", "count = [11, 9]"), ("pixels = [120", "pixels = [121")]
)
def test_the_middle_pixel_lies_in_the_light(replaced: tuple[str, str]) -> None:
    world = lf.build(loads(SCENE.replace(*replaced)))
    row, column = middle_pixel(world)
    columns, rows = world.scene.camera.sensor.pixels
    assert abs(row - rows / 2) < 8
    assert abs(column - columns / 2) < 8
    lit = launch.from_pixel(world, row, column, 64, split="transmit")
    pitch = lit.world.first_order.micro_image_pitch_px
    assert pitch is not None
    dark = launch.from_pixel(world, row + round(pitch / 2), column + round(pitch / 2), 64, split="transmit")
    assert lit.arrives.mean() > 0.5
    assert lit.end_power[lit.arrives].sum() > 2.0 * dark.end_power[dark.arrives].sum()


def test_without_an_array_the_middle_pixel_is_that_of_the_sensor(conventional: lf.World) -> None:
    assert middle_pixel(conventional) == (50, 60)


@pytest.mark.drawing
def test_the_magnified_array_has_a_letter_there_and_where_it_stands(
    world: lf.World, views: Callable[..., View]
) -> None:
    view = views(world)
    written: list[tuple[str, bool]] = []
    mark = view.overlay.mark

    def noted(words: str, place_mm: Any = None) -> None:
        written.append((words, place_mm is not None))
        mark(words, place_mm)

    view.overlay.mark = noted  # type: ignore[method-assign]
    props = view.plotter.renderer.GetViewProps().GetNumberOfItems()
    show.picture_of(view)
    assert written == [("A", True), ("A: lenslets", False)]
    assert view.plotter.renderer.GetViewProps().GetNumberOfItems() == props, "a letter is left behind"


def test_several_launches_are_their_sum(world: lf.World) -> None:
    parts = [launch.from_field_point(world, [0.0, y, -199.0], 10, split="both") for y in (0.0, -8.0)]
    both = together(parts)
    assert len(both) == sum(len(part) for part in parts)
    assert both.offsets[-1] == len(both.position)
    assert len(np.unique(both.source)) == sum(len(np.unique(part.source)) for part in parts)
    start = 0
    for part in parts:
        mine = np.zeros(len(both), np.bool_)
        mine[start : start + len(part)] = True
        again = both.keep(mine)
        assert np.array_equal(again.position, part.position)
        assert [both.sequences[i] for i in again.sequence] == [part.sequences[i] for i in part.sequence]
        start += len(part)
    power = np.bincount(both.sequence, both.end_power * both.arrives, len(both.sequences))
    assert (np.diff(power) <= 0.0).all(), "what brings most comes first"


def test_rays_of_different_units_are_not_mixed(world: lf.World) -> None:
    parts: list[Callable[[], Rays]] = [
        lambda: launch.from_field_point(world, [0.0, 0.0, -199.0], 4),
        lambda: launch.from_pixel(world, 50, 60, 4),
    ]
    with pytest.raises(LfmeshError, match="different units"):
        together([make() for make in parts])
