"""The command line: exit codes, one clear message for a mistake, nothing half-done, fitting progress."""

import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import types
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
import pytest

import lfmesh
import lfmesh as lf
from lfmesh.cli import main
from lfmesh.cli.options import Overrides
from lfmesh.scene import Scene, Transport, solved
from tests.cameras import bench_camera
from tests.processor_time import HANGS_S

SCENE = f"""{bench_camera(4, 4)}[[targets]]
shape = {{ kind = "plane", width_mm = 100.0, height_mm = 100.0 }}
position_mm = [0.0, 0.0, -500.0]
[[lights]]
kind = "point"
position_mm = [100.0, -100.0, -50.0]
power_w = 1.0
"""

MISMATCHED = SCENE.replace("focal_length_mm = 0.7", "focal_length_mm = 2.0")
"""Microlenses of f/16 behind a lens of f/5.6."""

Report = Callable[[lf.Progress], None]


class Renderer:
    """Stands in for the tracer: reports progress, and stops when told to."""

    def __init__(self) -> None:
        self.scene: Scene | None = None
        self.replicates_until_ctrl_c = math.inf
        self.seconds = 100.0

    def __call__(self, scene: Scene, progress: Report | None = None, **_: object) -> lf.Image:
        self.scene = scene = solved(scene)
        transport = scene.transport
        for replicate in range(transport.replicates):
            if replicate == self.replicates_until_ctrl_c:
                break
            for part in range(100):
                done = replicate * 100 + part + 1
                seconds = self.seconds * done / (100 * transport.replicates)
                if progress is not None:
                    total = 100_000 * transport.replicates
                    progress(lf.Progress(1000 * done, total, seconds, replicate, transport.replicates, "tracing"))
        finished = int(min(self.replicates_until_ctrl_c, transport.replicates))
        if finished == 0:
            raise KeyboardInterrupt
        shape = (*reversed(scene.camera.sensor.pixels), len(transport.wavelengths_nm))
        mean = np.random.default_rng(0).uniform(1e-12, 2e-12, shape)
        ledger = lf.Ledger(unit="m² sr", emitted=1.0, absorbed={"stop": 1.0}, packets=1, events=1)
        samples = transport.samples * finished / transport.replicates
        return lf.Image(mean, 0.1 * mean, scene, ledger, self.seconds, finished, samples, "mesh engine")


@pytest.fixture
def renderer(monkeypatch: pytest.MonkeyPatch) -> Renderer:
    fake = Renderer()
    module = types.ModuleType("lfmesh.waves.render")
    module.render = fake  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "lfmesh.waves.render", module)
    return fake


@pytest.fixture
def scene_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(SCENE)
    return Path("scene.toml")


def shell(
    *arguments: str, cwd: Path | None = None, stdout: int = subprocess.PIPE
) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", "lfmesh", *arguments],
        cwd=cwd,
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        timeout=HANGS_S,
        env={**os.environ, "PYTHONPATH": str(Path(lfmesh.__file__).parents[1])},
    )


def test_render_writes_a_run_and_says_where(
    renderer: Renderer, scene_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["render", "scene.toml", "-o", "run"]) == 0
    out = capsys.readouterr().out
    assert re.search(r"10\.\d\s+%\s+in\s+half", out)
    for name in ("preview_view.png", "preview.png", "raw.exr", "report.json"):
        assert str(Path("run") / name) in out
        assert (Path("run") / name).is_file()
    assert lfmesh.open_run("run").complete
    assert max(len(line) for line in out.splitlines()) <= 80
    broken = [line for line in out.splitlines() if line == "voxels"]
    assert not broken, "lines of the examples are not broken"


def test_options_override_the_transport_table(renderer: Renderer, scene_file: Path) -> None:
    options = "--samples 32 --method forward --engine mesh --surface flat --split roulette --seed 5 --threads 2"
    more = "--replicates 4 --diffraction lenslets --wavelengths-nm 486.1 587.6 656.3"
    assert main(["render", "scene.toml", "-o", "run", *options.split(), *more.split()]) == 0
    assert renderer.scene is not None
    transport = renderer.scene.transport
    assert (transport.samples, transport.method, transport.engine) == (32, "forward", "mesh")
    assert (transport.surface, transport.split, transport.seed) == ("flat", "roulette", 5)
    assert (transport.threads, transport.replicates, transport.diffraction) == (2, 4, "lenslets")
    assert transport.wavelengths_nm == (486.1, 587.6, 656.3)
    assert lfmesh.open_run("run").mean.shape == (40, 40, 3)


def test_white_takes_the_diffraction_that_is_asked_for(
    renderer: Renderer, scene_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["render", "scene.toml", "-o", "run"]) == 0
    monkeypatch.setattr("lfmesh.lightfield.calibration.white.render", renderer)
    for asked, wanted in ((["--diffraction", "lenslets"], "lenslets"), ([], "none")):
        main(["white", "run", *asked])
        assert renderer.scene is not None
        assert (renderer.scene.name, renderer.scene.transport.diffraction) == ("white", wanted)


def test_options_offer_the_choices_of_the_transport_table() -> None:
    offered = get_type_hints(Overrides)
    for name, field in Transport.model_fields.items():
        if get_origin(field.annotation) is Literal:
            choice, none = get_args(offered[name])
            assert (set(get_args(choice)), none) == (set(get_args(field.annotation)), type(None))


WRONG_ARGUMENTS = {
    "unknown command": ("rendr scene.toml", 'Unknown command "rendr"'),
    "unknown option": ("render scene.toml -o run --sample 3", "--sample"),
    "missing scene": ("render -o run", "scene"),
    "missing folder": ("render scene.toml", "--out"),
    "too many": ("render scene.toml more.toml -o run", "more.toml"),
    "bad choice": ("render scene.toml -o run --method fw", '"adjoint", "forward"'),
    "bad diffraction": ("render scene.toml -o run --diffraction lens", '"none", "lenslets"'),
    "fraction": ("render scene.toml -o run --samples 4.5", '"4.5" is not a whole number'),
    "negative": ("render scene.toml -o run --samples -8", "--samples = -8"),
    "zero replicates": ("render scene.toml -o run --replicates 0", "--replicates = 0"),
    "no wavelength": ("render scene.toml -o run --wavelengths-nm green", '"green"'),
    "nan": ("render scene.toml -o run --wavelengths-nm nan", "--wavelengths-nm"),
    "missing file": ("render none.toml -o run", "none.toml"),
    "folder as file": ("render . -o run", "cannot be read"),
    "check of nothing": ("check none.toml", "none.toml"),
    "file as folder": ("render scene.toml -o scene.toml", "scene.toml is a file"),
    "below a file": ("render scene.toml -o scene.toml/run", "cannot be written"),
    "foreign folder": ("render scene.toml -o .", "holds scene.toml and no run"),
}


@pytest.mark.parametrize(("arguments", "message"), WRONG_ARGUMENTS.values(), ids=WRONG_ARGUMENTS.keys())
def test_a_wrong_command_line_exits_with_2_and_says_why(
    renderer: Renderer, scene_file: Path, capsys: pytest.CaptureFixture[str], arguments: str, message: str
) -> None:
    assert main(arguments.split()) == 2
    captured = capsys.readouterr()
    assert [line.startswith("lfmesh: ") for line in captured.err.splitlines()].count(True) == 1
    assert message in captured.err
    assert captured.out == ""
    assert renderer.scene is None, "nothing may be rendered before the mistake is found"
    assert [path.name for path in Path().iterdir()] == ["scene.toml"]


WRONG_SCENES = {
    "no toml": ("focus_mm = 500.0", "focus_mm = = 500.0", "not valid TOML"),
    "unknown key": ("pitch_mm", "pich_mm", "did you mean 'pitch_mm'?"),
    "nan": ("focus_mm = 500.0", "focus_mm = nan", "camera.focus_mm"),
    "negative thickness": (
        "thickness_mm = 4.0",
        "thickness_mm = -4.0",
        "camera.lens.surfaces[1].thickness_mm = -4",
    ),
    "crossing surfaces": ("thickness_mm = 4.0", "thickness_mm = 0.1", "cross"),
    "unknown glass": ("index = 1.5, semi", 'glass = "SCHOTT/N-BK77", semi', "N-BK77"),
    "missing mesh": (
        'shape = { kind = "plane", width_mm = 100.0, height_mm = 100.0 }',
        'file = "b.glb"',
        "b.glb",
    ),
    "absurd sensor": ("pixels = [40, 40]", "pixels = [4000000, 4000000]", "GB"),
}


@pytest.mark.parametrize(("old", "new", "message"), WRONG_SCENES.values(), ids=WRONG_SCENES.keys())
@pytest.mark.parametrize("command", ["check scene.toml", "render scene.toml -o run"])
def test_a_wrong_scene_exits_with_2_and_names_the_fault(
    renderer: Renderer,
    scene_file: Path,
    capsys: pytest.CaptureFixture[str],
    command: str,
    old: str,
    new: str,
    message: str,
) -> None:
    assert old in SCENE
    scene_file.write_text(SCENE.replace(old, new, 1))
    assert main(command.split()) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("lfmesh: scene.toml")
    assert message in captured.err
    assert captured.out == ""
    assert not Path("run").exists()


def test_a_mistake_shows_no_traceback(scene_file: Path) -> None:
    for arguments in (["render", "none.toml", "-o", "run"], ["render", "scene.toml"], ["check", "."]):
        done = shell(*arguments)
        assert done.returncode == 2
        assert "Traceback" not in done.stderr
        assert done.stdout == ""


def test_ctrl_c_keeps_the_finished_replicates(
    renderer: Renderer, scene_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    renderer.replicates_until_ctrl_c = 3
    assert main(["render", "scene.toml", "-o", "run"]) == 130
    assert "To continue: lfmesh render --resume run\n" in capsys.readouterr().out
    image = lfmesh.open_run("run")
    assert (image.complete, image.replicates, image.samples) == (False, 3, 24.0)
    assert json.loads(Path("run/report.json").read_text())["complete"] is False


def test_too_little_memory_is_one_line(
    renderer: Renderer, scene_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: Renderer, *_: object, **__: object) -> lf.Image:
        return np.zeros((1 << 26, 1 << 26))  # type: ignore[return-value]

    monkeypatch.setattr(Renderer, "__call__", full)
    assert main(["render", "scene.toml", "-o", "run"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("lfmesh: not enough memory: Unable to allocate 32.0 PiB")
    assert said.count("\n") == 1


def test_sigterm_ends_a_render_as_ctrl_c_does(
    renderer: Renderer, scene_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The renderer is interrupted, which keeps the replicates that are finished; with none, the exit code says why."""
    caught: list[BaseException] = []

    def killed(self: Renderer, scene: Scene, *_: object, **__: object) -> lf.Image:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(5.0)
        except KeyboardInterrupt as stop:
            caught.append(stop)
            raise
        raise AssertionError("not interrupted")

    monkeypatch.setattr(Renderer, "__call__", killed)
    assert main(["render", "scene.toml", "-o", "run"]) == 143
    assert len(caught) == 1
    assert "nothing was written" in capsys.readouterr().err
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


@contextmanager
def mounted_disk(folder: Path, options: str) -> Iterator[Path]:
    """Mount a disk in memory; skip the test where that is not allowed."""
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder]
    if subprocess.run(command, capture_output=True, check=False).returncode != 0:
        pytest.skip("no right to mount a disk")
    try:
        yield folder
    finally:
        subprocess.run(["umount", folder], check=True)


def test_a_full_disk_loses_no_finished_render(
    renderer: Renderer, scene_file: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with mounted_disk(tmp_path / "disk", "size=16k") as disk:
        assert main(["render", "scene.toml", "-o", str(disk / "run")]) == 2
        said = " ".join(capsys.readouterr().err.split())
    found = re.search(r"cannot be saved: (.*) It is in (\S+); move it", said)
    assert found is not None, said
    assert "No space left" in found[1]
    assert lfmesh.open_run(found[2]).complete
    shutil.rmtree(found[2])


def test_a_folder_that_cannot_be_written_is_refused_before_tracing(
    renderer: Renderer, scene_file: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with mounted_disk(tmp_path / "disk", "ro,size=16k") as disk:
        assert main(["render", "scene.toml", "-o", str(disk / "run")]) == 2
    assert "Read-only file system" in capsys.readouterr().err
    assert renderer.scene is None


def test_ctrl_c_with_nothing_finished_writes_nothing(
    renderer: Renderer, scene_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    renderer.replicates_until_ctrl_c = 0
    assert main(["render", "scene.toml", "-o", "run"]) == 130
    assert "nothing was written" in capsys.readouterr().err
    assert not Path("run").exists()


def test_progress_without_a_terminal_is_a_few_plain_lines(
    renderer: Renderer, scene_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["render", "scene.toml", "-o", "run"])
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("tracing")]
    assert 5 <= len(lines) <= 20
    assert lines[0] == "tracing: 10 %, 8,000 packets/s, 90 s left"
    assert lines[-1].startswith("tracing: 100 %")
    assert not any("\x1b" in line or "\r" in line for line in lines)


def test_a_short_render_says_hardly_anything(
    renderer: Renderer, scene_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    renderer.seconds = 1.0
    main(["render", "scene.toml", "-o", "run"])
    assert capsys.readouterr().err.count("tracing") == 1


def test_progress_on_a_terminal_has_rate_and_time_left(
    renderer: Renderer, scene_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "xterm")
    assert main(["render", "scene.toml", "-o", "run"]) == 0
    err = capsys.readouterr().err
    assert "8,000 packets/s" in err
    assert " left" in err
    assert "%" in err


def test_check_prints_the_first_order_report_and_warnings_are_no_error(
    scene_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A biconvex lens, R = ±50 mm, n = 1.5, 4 mm thick: f = n R / ((n−1)(2n − (n−1) t/R)) = 50.6757 mm."""
    scene_file.write_text(MISMATCHED)
    assert main(["check", "scene.toml"]) == 0
    out, err = capsys.readouterr()
    assert "50.67" in out
    warnings = lfmesh.first_order(lfmesh.load("scene.toml")).warnings
    assert warnings
    # What a render warns of, too, is a warning on standard error; the rest are notes.
    said = " ".join(f"{out} {err}".split())
    assert all(f"Note: {warning}" in said or f"Warning: {warning} [" in said for warning in warnings)
    assert max(len(line) for line in out.splitlines()) <= 80


@pytest.mark.parametrize(
    "beside",
    [
        "[[particles]]\ncount = 3\nseed = 1\nbounds = { kind = 'sphere', radius_mm = 1.0 }\n"
        "position_mm = [0, 0, 40]\nintensity_w_sr = 1e-3\n",
        "[[media]]\nbounds = { kind = 'sphere', radius_mm = 1.0 }\nposition_mm = [0, 0, 40]\nabsorption_per_mm = 0.1\n",
    ],
    ids=["particles behind the lens", "a medium behind the lens"],
)
def test_check_refuses_what_a_render_would(beside: str, scene_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene_file.write_text(SCENE + beside)
    said = []
    for command in (["check", "scene.toml"], ["render", "scene.toml", "-o", "run"]):
        assert main(command) == 2
        said.append(capsys.readouterr().err)
    assert said[0] == said[1]


def test_warnings_are_said_before_rendering(
    renderer: Renderer, scene_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene_file.write_text(MISMATCHED)
    main(["render", "scene.toml", "-o", "run"])
    err = capsys.readouterr().err
    warnings = lfmesh.first_order(lfmesh.load("scene.toml")).warnings
    assert warnings
    said = " ".join(err[: err.index("tracing")].split())
    # Of the picture, the Airy disk is a warning; what is likely to disappoint is a note.
    kinds = ["Warning" if "Airy" in warning else "Note" for warning in warnings]
    assert set(kinds) == {"Warning", "Note"}
    assert all(said.count(f"{kind}: {warning}") == 1 for kind, warning in zip(kinds, warnings, strict=True))


def test_schema_is_the_scenes_json_schema(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    assert {"camera", "targets", "lights", "transport"} <= set(schema["properties"])


HELPED = ["", "demo", "check", "render", "white", "decode", "refocus", "schema", "study", "fit", "dataset", "matrix"]
HELPED += ["lens", "lens list", "lens convert", "lens sheet", "frames", "camera-model", "compare", "view", "export"]
HELPED += ["grid"]


@pytest.mark.parametrize("command", HELPED)
def test_help_fits_80_columns(
    command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main([*command.split(), "--help"]) == 0
    out = capsys.readouterr().out
    assert "Usage: lfmesh" in out
    assert max(len(line) for line in out.splitlines()) <= 80


def test_paragraphs_of_help_are_broken_at_the_terminals_width_alone(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["render", "--help"]) == 0
    (paragraph,) = re.findall(r"^Ctrl-C keeps .*?$\n\n", capsys.readouterr().out, flags=re.MULTILINE | re.DOTALL)
    lines = paragraph.split("\n")[:-2]
    assert len(lines) == 3
    for line, after in pairwise(lines):
        assert len(line.rstrip()) + 1 + len(after.split()[0]) > 80


def test_a_reader_that_goes_away_is_no_error() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    try:
        done = shell("schema", stdout=writer)
    finally:
        os.close(writer)
    assert done.stderr == ""
    assert done.returncode == 141


def test_importing_lfmesh_and_its_command_line_is_light() -> None:
    heavy = {"numba", "vtkmodules", "pyvista", "embreex", "OpenEXR", "matplotlib", "trimesh", "PIL", "scipy"}
    code = "import sys, lfmesh, lfmesh.cli, lfmesh.scene; print(*{name.split('.')[0] for name in sys.modules})"
    environment = {**os.environ, "PYTHONPATH": str(Path(lfmesh.__file__).parents[1])}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    assert "lfmesh" in done.stdout.split()
    assert not heavy & set(done.stdout.split())


def test_no_public_name_is_that_of_a_module() -> None:
    """A name that is both would mean one or the other by what was imported first."""
    package = Path(lfmesh.__file__).parent
    assert {"view", "errors"} <= {path.stem for path in package.iterdir()}
    assert not set(lfmesh.__all__) & {path.stem for path in package.iterdir()}


def test_every_public_name_can_be_had() -> None:
    for name in lfmesh.__all__:
        assert getattr(lfmesh, name) is not None
    assert set(lfmesh.__all__) <= set(dir(lfmesh))
    with pytest.raises(AttributeError, match="no attribute 'lens_cap'"):
        lfmesh.lens_cap  # noqa: B018


class MeasuredReport:
    """Stands in for a measured report."""

    def print(self, console: Any) -> None:
        console.print("measured in words " * 12)

    def write(self, folder: Path) -> list[Path]:
        folder.mkdir()
        (folder / "accuracy.html").write_text("")
        return [folder / "accuracy.html"]


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What `lfmesh accuracy` asks to be measured; under "raises", what happens instead."""
    asked: dict[str, Any] = {}

    def measure(scene: Scene | None, *, quick: bool, progress: Callable[[str], None]) -> MeasuredReport:
        if "raises" in asked:
            raise asked["raises"]
        asked.update(scene=scene, quick=quick)
        progress("a mesh")
        return MeasuredReport()

    monkeypatch.setattr("lfmesh.accuracy.report.measure", measure)
    return asked


def test_accuracy_measures_the_scene_and_says_where_the_report_is(
    measured: dict[str, Any], scene_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["accuracy", "scene.toml", "-o", "report", "--quick"]) == 0
    assert measured["scene"].camera.mla.pitch_mm == 0.125
    assert measured["quick"]
    out, err = capsys.readouterr()
    assert "measured in words" in out
    assert str(Path("report") / "accuracy.html") in out
    assert max(len(line) for line in out.splitlines()) <= 80
    assert "a mesh" in err
    assert main(["accuracy"]) == 0
    assert measured["scene"] is None
    assert not measured["quick"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["no.toml"], "no.toml: cannot be read"),
        (["scene.toml", "-o", "scene.toml"], "scene.toml: is a file; give a folder for the report"),
        (["scene.toml", "-o", "scene.toml/report"], "report: cannot be written: Not a directory"),
        (["scene.toml", "--hard"], "--hard takes no scene"),
        (["--hard", "--quick"], "--hard takes no scene"),
        (["--hard", "-o", "report"], "--hard takes no scene"),
        (["scene.toml", "--fast"], "Unknown option"),
    ],
)
def test_accuracy_refuses_what_it_cannot_do_before_it_measures(
    arguments: list[str], message: str, measured: dict[str, Any], scene_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["accuracy", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert measured == {}
    assert [path.name for path in Path().iterdir()] == ["scene.toml"]


def test_accuracy_leaves_nothing_after_ctrl_c(
    measured: dict[str, Any], scene_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    measured["raises"] = KeyboardInterrupt()
    assert main(["accuracy", "scene.toml", "-o", "new/report"]) == 130
    assert "nothing was written" in capsys.readouterr().err
    assert [path.name for path in Path().iterdir()] == ["scene.toml"]


@pytest.mark.parametrize("failing", [False, True])
def test_hard_cases_print_a_line_each_as_they_finish_and_a_count(
    failing: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from lfmesh.accuracy import hard_cases
    from lfmesh.accuracy.hard.outcome import Outcome

    seen: list[str] = []

    def case(cause: str, passed: bool) -> Callable[[], Outcome]:
        def run() -> Outcome:
            seen.append(capsys.readouterr().out)
            return Outcome(cause, "right", "right" if passed else "wrong", passed, 0.0, 10.0, 3)

        return run

    monkeypatch.setattr(hard_cases, "CASES", (case("Easy.", True), case("Hard.", not failing), case("Last.", True)))
    assert main(["accuracy", "--hard"]) == (1 if failing else 0)
    seen.append(capsys.readouterr().out)
    assert seen[0] == ""
    assert seen[1] == "passed  Easy. Expected: right. Got: right; 3 queries repeated, 0 of 10 lost.\n"
    assert seen[2].startswith("FAILED  Hard. " if failing else "passed  Hard. ")
    assert seen[3].splitlines()[1].startswith(f"3 cases, {'1 failed' if failing else 'all passed'}; ")


def test_hard_cases_that_lose_energy_fail(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    from lfmesh.accuracy import hard_cases
    from lfmesh.accuracy.hard.outcome import Outcome

    monkeypatch.setattr(hard_cases, "CASES", (lambda: Outcome("Leak.", "all", "less", True, 1e-6, 1.0, 0),))
    assert main(["accuracy", "--hard"]) == 1
    assert "1e-06 of the energy lost, 1e-07 allowed" in capsys.readouterr().out
