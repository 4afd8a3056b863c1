"""tools/bench on tiny cases: it runs, its JSON holds what its tables show, and its parts measure what they say."""

import importlib
import json
import os
import subprocess
import sys
import warnings
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from tests.instances import instances

ROOT = Path(__file__).resolve().parents[2]
TOOLS = ROOT / "tools"
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}

CASES = {
    "lens": ["--quick", "--rays", "2000", "--rounds", "1"],
    "scaling": [
        *["--quick", "--series", "triangles", "--series", "threads", "--series", "parts", "--engine", "sequential"],
        *["--side", "16", "--rounds", "1"],
    ],
    "render": ["--quick", str(ROOT / "assets/scenes/emitting_plane.toml"), "--engine", "sequential"],
    "image": ["--quick", str(ROOT / "assets/scenes/emitting_plane.toml"), "--pixels", "16", "--samples", "4"],
    "against": ["--quick", "HEAD", str(ROOT / "assets/scenes/emitting_plane.toml")],
    "errors": ["--quick", "--scene", "lit_chart", "--side", "16", "--reference", "64"],
    "media": ["--quick"],
    "paired": ["--quick", "--shift-um", "20"],
    "spreads": ["--quick"],
    "elements": ["--quick", "--samples", "2"],
    "fields": ["--quick", "--samples", "2"],
    "motion": ["--quick", "--samples", "2"],
    "startup": ["--quick"],
}
LONG = ("errors", "lens", "startup", "against", "scaling", "media", "paired", "render", "spreads", "elements", "fields",
        "motion")  # fmt: skip
"""Start-up compiles all kernels twice, the other commit's tree once more; scaling starts a process for each size, lens
for each lens and each other program. Of commands that render scenes and print tables of them, image and errors are in
the suite.
"""
TABLES = {
    "lens": {"lens": "COLUMNS"},
    "scaling": {
        "scaling": "COLUMNS",
        "exponents": "EXPONENT_COLUMNS",
        "threads": "THREAD_COLUMNS",
        "things": "THING_COLUMNS",
        "growth": "THING_EXPONENT_COLUMNS",
        "goals": "GOAL_COLUMNS",
    },
    "render": {"render": "COLUMNS", "lens": "LENS_COLUMNS", "ways": "WAY_COLUMNS"},
    "image": {"image": "COLUMNS", "small_camera": "PEER_COLUMNS"},
    "against": {"against": "COLUMNS"},
    "errors": {"errors": "COLUMNS"},
    "media": {"render": "RENDER_COLUMNS", "particles": "PARTICLE_COLUMNS", "flame": "FLAME_COLUMNS"},
    "paired": {"paired": "COLUMNS", "needed": "NEED_COLUMNS"},
    "spreads": {"spreads": "COLUMNS"},
    "elements": {"elements": "COLUMNS"},
    "fields": {"fields": "COLUMNS", "steps": "STEP_COLUMNS"},
    "motion": {"motion": "COLUMNS"},
    "startup": {"startup": "COLUMNS"},
}


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Import a module of tools/."""
    monkeypatch.syspath_prepend(str(TOOLS))

    def load(name: str) -> ModuleType:
        return importlib.import_module(name)

    return load


def bench(command: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(TOOLS / f"bench_{command}.py"), *arguments],
        capture_output=True, text=True, env=ENVIRONMENT, timeout=600,
    )  # fmt: skip


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Run a command's tiny case once; return what it printed, its figures, and the file of its drawing."""
    done: dict[str, tuple[str, dict[str, Any], Path]] = {}

    def run(command: str) -> tuple[str, dict[str, Any], Path]:
        if command not in done:
            folder = tmp_path_factory.mktemp(command)
            figures, drawing = folder / "figures.json", folder / "drawing.png"
            result = bench(command, *CASES[command], "--json", str(figures), "--figure", str(drawing))
            assert result.returncode == 0, result.stderr
            done[command] = result.stdout, json.loads(figures.read_text()), drawing
        return done[command]

    return run


@pytest.mark.parametrize("command", instances(CASES, long=LONG))
def test_json_holds_what_the_tables_show(command: str, ran: Any, tool: Any) -> None:
    printed, figures, drawing = ran(command)
    lines = [line.split() for line in printed.splitlines()]
    own = tool(f"bench_{command}")
    for key, columns in TABLES[command].items():
        table = tool("bench_report").Table("", getattr(own, columns), figures[key])
        assert len(figures[key]) > 0
        for line in table.lines()[1:]:
            assert line.split() in lines
    for ratio in figures["ratios"]:
        assert any(ratio["name"] in line and f"{ratio['value']:.3g}" in line for line in printed.splitlines())
    for name, why in figures["missing"].items():
        assert f"without {name}: {why}" in printed
    assert drawing.read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
def test_every_contender_lands_where_its_surfaces_say(ran: Any) -> None:
    _, figures, _ = ran("lens")
    largest = {(row["lens"], row["contender"]): row["max_mm"] for row in figures["lens"]}
    astray = {(row["lens"], row["contender"]): row["astray"] for row in figures["lens"]}
    # Of optiland's aspheres its own tolerance is the limit, of mitsuba float32 and the offset of its rays.
    limits = {"mesh, exact": 1e-9, "sequential": 1e-9, "sequential, blocks": 1e-9, "batoid": 1e-9}
    limits |= {"lf.trace, mesh": 1e-9, "lf.trace, sequential": 1e-9, "optiland": 1e-5, "mitsuba": 0.02}
    for lens in ("spheres", "aspheres"):
        for contender, limit in limits.items():
            if contender not in figures["missing"]:
                assert largest[lens, contender] <= limit, (lens, contender)
                assert astray[lens, contender] == 0.0, (lens, contender)
        assert largest[lens, "mesh, flat"] > largest[lens, "mesh, smooth"] > 1e-6 > largest[lens, "mesh, exact"]
        assert largest[lens, "Embree alone, exact's mesh"] is None


def test_both_engines_land_where_the_surfaces_say(tool: Any) -> None:
    lens = tool("bench_lens")
    for kind in lens.LENSES:
        scene = lens.lens_of(kind)
        world, (sent, truth) = lens.lf.build(scene), lens.rays_through(scene, 200)
        assert truth.arrives.all()
        for engine in ("mesh", "sequential"):
            place, weight = lens.landed_paths(world, lens.partial(lens.traced, world, sent, 587.6, engine, 1))
            np.testing.assert_allclose(place, truth.position[:, : place.shape[1]], rtol=0.0, atol=1e-9)
            assert (weight > 0.0).all()


def test_a_ray_that_the_lens_stops_has_no_landing(tool: Any) -> None:
    lens = tool("bench_lens")
    scene = lens.lens_of("spheres")
    world = lens.lf.build(scene)
    # Along the axis, and outside the stop but inside the first surface's aperture.
    sent = lens.Bundle(np.array([[0.0, 0.0, -5.0], [11.0, 0.0, -5.0]]), np.array([[0.0, 0.0, 1.0]] * 2))
    for engine in ("mesh", "sequential"):
        call = lens.partial(lens.traced, world, sent, 587.6, engine, 1)
        place, weight = lens.landed_paths(world, call)
        assert np.allclose(place[0], 0.0, atol=1e-12)
        assert np.isnan(place[1]).all()
        assert np.isnan(weight[1])


def test_the_aspheric_lens_is_another_lens(tool: Any) -> None:
    lens = tool("bench_lens")
    spheres, aspheres = (lens.lens_of(kind) for kind in lens.LENSES)
    sent, landed = lens.rays_through(spheres, 500)
    bent = lens.analytic.Camera.of(aspheres, 587.6).land(*sent)
    off = np.linalg.norm(bent.position - landed.position, axis=1)[bent.arrives]
    assert landed.arrives.all()
    assert np.median(off) > 0.01


def test_ways_that_model_the_same_light_agree(ran: Any) -> None:
    _, figures, _ = ran("image")
    pairs = {row["pair"]: row for row in figures["agreement"]}
    # The same paths by two engines: rounding.
    assert abs(pairs["adjoint, sequential − adjoint, image path"]["relative"]) < 1e-9


@pytest.mark.long
def test_mitsuba_receives_the_same_power(tool: Any) -> None:
    pytest.importorskip("mitsuba")
    if fault := tool("bench_peers").fault_of("mitsuba"):
        pytest.skip(fault)
    _, _, agreement = tool("bench_image").beside_mitsuba(8, 64, 12, True)
    light = [row for row in agreement if "mitsuba" in row["pair"]]
    # Three comparisons at 1 % in all, each of two means of 12 runs: Student's t with 11 degrees of freedom.
    assert len(light) == 3
    assert all(abs(row["z"]) < 3.73 for row in light)


def test_without_reflections_there_is_less_light(ran: Any) -> None:
    power = {row["way"]: row["power_w"] for row in ran("image")[1]["small_camera"]}
    assert power["adjoint, sequential"] < power["adjoint, Sobol'"]


MISTAKES = [
    ("render", ["nowhere.toml"], "nowhere.toml"),
    ("lens", ["--json", "nowhere/figures.json"], "nowhere/figures.json"),
    ("scaling", ["--figure", "drawing.bmp"], ".png"),
    ("image", ["--runs", "1"], "2 or more"),
    ("lens", ["--rays", "0"], "0 is not positive"),
    ("against", ["no-such-commit"], "no-such-commit"),
    ("paired", ["--shift-um", "-1"], "--shift-um -1"),
]

RUN_ALL = """
import contextlib, io, json, os, runpy, sys
for tool, *arguments in json.load(sys.stdin):
    sys.argv, out, err, code = [tool, *arguments], io.StringIO(), io.StringIO(), 0
    sys.path.insert(0, os.path.dirname(tool))
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            runpy.run_path(tool, run_name="__main__")
        except SystemExit as end:
            code = end.code
    print(json.dumps([code, out.getvalue(), err.getvalue()]), flush=True)
"""
"""Runs programs one after the other in one process, so that what they import is imported once."""


@pytest.fixture(scope="module")
def mistaken() -> list[tuple[int, str, str]]:
    """Return the exit code of each mistake, what it printed, and what it said of errors."""
    calls = [[str(TOOLS / f"bench_{command}.py"), *arguments] for command, arguments, _ in MISTAKES]
    child = subprocess.run(
        [sys.executable, "-c", RUN_ALL],
        input=json.dumps(calls), capture_output=True, text=True, env=ENVIRONMENT, timeout=600,
    )  # fmt: skip
    assert child.returncode == 0, child.stderr
    assert child.stderr == ""
    return [tuple(json.loads(line)) for line in child.stdout.splitlines()]


@pytest.mark.parametrize("number", range(len(MISTAKES)), ids=[f"{m[0]} {' '.join(m[1])}" for m in MISTAKES])
def test_a_mistake_is_one_line(number: int, mistaken: list[tuple[int, str, str]]) -> None:
    code, printed, said = mistaken[number]
    assert code == 2
    assert printed == ""
    (line,) = said.splitlines()
    assert line.startswith("tools/bench: ")
    assert MISTAKES[number][2] in line


def test_an_unknown_command_names_the_known_ones() -> None:
    result = subprocess.run([TOOLS / "bench", "nonsense"], capture_output=True, text=True)
    assert result.returncode == 2
    assert all(command in result.stderr for command in CASES)


def test_contenders_take_turns(tool: Any) -> None:
    report = tool("bench_report")
    order: list[str] = []
    contenders = [
        report.Contender(name, lambda given: order.append(given), prepare=lambda name=name: name) for name in "abc"
    ]
    clocks = report.in_turns(contenders, 3)
    # One round to warm up; every second round is reversed, so that nobody always comes first.
    assert "".join(order) == "abc" + "abc" + "cba" + "abc"
    assert all(len(clock.wall) == 3 for clock in clocks.values())


def test_a_ratio_is_of_neighbours_in_time(tool: Any) -> None:
    # The machine slows down tenfold on the way; the ratio does not see it.
    ratio = tool("bench_report").Ratio.of("", [1.0, 3.0, 10.0], [2.0, 6.0, 20.0])
    assert (ratio.low, ratio.value, ratio.high) == (2.0, 2.0, 2.0)


def test_the_exponent_of_a_power_law_is_found(tool: Any) -> None:
    scaling = tool("bench_scaling")
    rows = [scaling.ScalingRow("samples", "mesh", n, 1.0, 3e-3 * n**1.25, 0.0, 0.0) for n in (2, 8, 64, 100)]
    fitted = scaling.exponent(rows)
    assert fitted["exponent"] == pytest.approx(1.25, abs=1e-12)
    assert fitted["exponent_error"] == pytest.approx(0.0, abs=1e-12)
    assert scaling.exponent(rows[:2])["exponent_error"] is None


def test_times_to_equal_error_count_more_samples_and_one_build(tool: Any) -> None:
    """Twice the error takes four times the samples: 2 s of building and 4 · 1.5 s of rendering, against 2 s in all."""
    row = {"again_seconds": 1.0, "error_percent": 1.0, "peak_mib": 512.0, "builds_again": 0}
    many = row | {"size": 1_000, "seconds": 3.5, "again_seconds": 1.5, "error_percent": 2.0, "builds_again": 1}
    goals = tool("bench_things").goals_of("lamps", [row | {"size": 1, "seconds": 2.0}, many])
    assert [(goal["measured"], goal["met"]) for goal in goals] == [(4.0, "yes"), (0.5, "yes"), (1.0, "no")]


@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="the system says no peak of a program alone")
def test_peak_memory_is_of_the_child_alone() -> None:
    child = "import bench_report; print(bench_report.peak_mib())"
    parent = (
        "import subprocess, sys, numpy as np; held = np.ones(80_000_000); "
        f"subprocess.run([sys.executable, '-c', {child!r}], check=True)"
    )
    result = subprocess.run(
        [sys.executable, "-c", parent], cwd=TOOLS, env=ENVIRONMENT, capture_output=True, text=True, check=True
    )
    assert float(result.stdout) < 400.0


def test_a_peer_that_is_not_installed_says_so(tool: Any) -> None:
    fault = tool("bench_peers").fault_of("no_such_tracer")
    assert fault.startswith("not installed")


def test_a_peer_cannot_make_errors_of_warnings(tool: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "strict_tracer.py").write_text("import warnings\nwarnings.simplefilter('error')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    before = list(warnings.filters)
    tool("bench_peers").imported("strict_tracer")
    assert list(warnings.filters) == before


def test_a_ring_stops_as_much_as_a_round_one(tool: Any) -> None:
    points, faces = tool("bench_mitsuba").annulus(4.77, 20.0, -3.0)
    a, b, c = np.moveaxis(points[faces], 1, 0)
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    azimuths = len(points) // 2
    outer = 0.5 * azimuths * 400.0 * np.sin(2.0 * np.pi / azimuths)
    assert outer - area == pytest.approx(np.pi * 4.77**2, rel=1e-12)


def test_a_lenslet_is_covered_once(tool: Any) -> None:
    points, faces = tool("bench_mitsuba").square_grid(5)
    a, b, c = np.moveaxis(points[faces], 1, 0)
    areas = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert (areas > 0.0).all()
    assert areas.sum() == pytest.approx(1.0, rel=1e-12)
