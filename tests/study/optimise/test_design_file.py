"""Design files: what they hold, what is refused in one line, and what `lfmesh optimise` writes."""

import html
import importlib
import json
import math
import os
import re
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.errors import LfmeshError
from lfmesh.scene import solved
from lfmesh.study.optimise.design_file import Goal
from lfmesh.study.optimise.figures import FIGURES
from lfmesh.wrapping import COLUMNS
from tests.cameras import close_up_camera
from tests.study.optimise.test_optimise import RADIUS, THICKNESS, focal_length, plano_convex

SCENE = plano_convex()
VARIABLE: dict[str, Any] = {"path": RADIUS, "range": [20.0, 90.0]}
TERM: dict[str, Any] = {"metric": "efl_mm", "target": 80.0}


def glasses(other: Any) -> dict[str, Any]:
    """The glass of a lens as a variable, with a value that is none beside its own."""
    return {"path": "camera.lens.surfaces[0].glass", "values": ["SCHOTT/N-BK7", other]}


REFUSED: dict[str, tuple[dict[str, Any], list[str]]] = {
    "no variables": ({"variables": []}, ["variables: missing"]),
    "no merit": ({"merit": []}, ["merit: missing"]),
    "unknown path": (
        {"variables": [{**VARIABLE, "path": "camera.lens.surfaces[7].radius_mm"}]},
        ['variables[0].path = "camera.lens.surfaces[7].radius_mm"', "2 entries"],
    ),
    "mistyped path": ({"variables": [{**VARIABLE, "path": "camera.lens.surfaces[0].radius"}]}, ["radius_mm"]),
    "range reversed": ({"variables": [{**VARIABLE, "range": [90.0, 20.0]}]}, ["range = [90.0, 20.0]", "reversed"]),
    "range of a radius with 0": ({"variables": [{**VARIABLE, "range": [0.0, 90.0]}]}, ["a radius cannot be 0"]),
    "start outside of the range": (
        {"variables": [{**VARIABLE, "range": [50.0, 90.0]}]}, ["range = [50, 90]", "is 40 in the scene, outside"],
    ),
    "neither range nor values": ({"variables": [{"path": RADIUS}]}, ["variables[0]", "neither range and values"]),
    "one value": ({"variables": [{"path": RADIUS, "values": [40.0]}]}, ["at least two values"]),
    "start not among the values": (
        {"variables": [{"path": RADIUS, "values": [41.0, 42.0]}]}, ["is 40.0 in the scene, which is not among"],
    ),
    "no number": ({"variables": [{"path": "camera.lens.surfaces[0].coating", "range": [0.0, 1.0]}]}, ["not a number"]),
    "left to be solved": (
        {"variables": [{"path": "camera.sensor.distance_mm", "range": [50.0, 80.0]}]},
        ["not given", f"it is solved, to {solved(SCENE).camera.sensor.distance_mm:.6g} at present"],
    ),
    "left out": (
        {"variables": [{"path": "camera.lens.epd_mm", "range": [5.0, 8.0]}]}, ["not given", "solved or left out"],
    ),
    "several numbers": (
        {"variables": [{"path": "camera.pose.tilt_deg", "range": [-1.0, 1.0]}]},
        ["camera.pose.tilt_deg has 3 numbers in the scene; name one: camera.pose.tilt_deg[0]"],
    ),
    "whole number": ({"variables": [{"path": "camera.sensor.pixels[0]", "range": [50.0, 150.0]}]}, ["a whole number"]),
    "twice": ({"variables": [VARIABLE, VARIABLE]}, ["variables[1].path", "is a variable already"]),
    "unknown metric": (
        {"merit": [{"metric": "spot_rms"}]}, ['merit[0].metric = "spot_rms"', "the nearest are spot_rms_mm,"],
    ),
    "no target": ({"merit": [{"metric": "efl_mm"}]}, ["merit[0].target: missing", "efl_mm"]),
    "weight": ({"merit": [{**TERM, "weight": -1.0}]}, ["merit[0].weight = -1.0", "above 0"]),
    "mistyped key": ({"merit": [{**TERM, "wieght": 1.0}]}, ["wieght", "did you mean 'weight'"]),
    "frequency": ({"merit": [{"metric": "mtf"}]}, ["merit[0].per_mm: missing"]),
    "field of no ray": ({"merit": [{**TERM, "field": 0.5}]}, ["merit[0].field = 0.5", "omit it"]),
    "array": ({"merit": [{"metric": "views_across", "target": 9.0}]}, ["merit[0].metric", "microlens array"]),
    "one wavelength": ({"merit": [{"metric": "lateral_colour_mm"}]}, ["there is one wavelength"]),
    "no limit": ({"constraints": [{"metric": "efl_mm"}]}, ["constraints[0]", "no limit"]),
    "limits crossed": (
        {"constraints": [{"metric": "efl_mm", "least": 9.0, "most": 8.0}]}, ["constraints[0].most = 8.0"],
    ),
    "limits of two constraints crossed": (
        {"constraints": [{"metric": "efl_mm", "least": 100.0}, {"metric": "efl_mm", "most": 90.0}]},
        ["constraints[1].most = 90.0", "100 or more", "constraints[0]"],
    ),
    "limits of two constraints crossed, the other way": (
        {"constraints": [{"metric": "efl_mm", "most": 90.0}, {"metric": "efl_mm", "least": 100.0}]},
        ["constraints[1].least = 100.0", "90 or less", "constraints[0]"],
    ),
    "mistyped glass": (
        {"variables": [glasses("SCHOTT/N-BK77")]},
        ['variables[0].values[1]: camera.lens.surfaces[0].glass = "SCHOTT/N-BK77": not in', "SCHOTT/N-BK7 "],
    ),
    "glass of no maker": (
        {"variables": [VARIABLE, glasses("MOON/CHEESE")]}, ['variables[1].values[1]: ', '"MOON/CHEESE"', "names are"],
    ),
    "number in place of a glass": ({"variables": [glasses(3)]}, ["values[1]", "glass = 3: must be a name"]),
    "radius below the aperture": (
        {"variables": [{"path": RADIUS, "values": [40.0, 4.0]}]}, ["values[1]", "radius_mm = 4.0", "semi_diameter_mm"],
    ),
    "start in a range through flat": (
        {"variables": [{"path": RADIUS, "range": [-400.0, 400.0]}]},
        ["is 40 in the scene", "infinite radius", "R <= -400 and R >= 400", "[-400, 40]", "[20, 400]"],
    ),
    "infinite": ({"merit": [{"metric": "far_mm", "target": 900.0}], "focus": math.inf}, ["far_mm is inf"]),
    "search": ({"search": {"method": "best"}}, ['search.method = "best"', "'local' or 'global'"]),
    "too many rays": ({"rays": {"across": 2147483647}}, ["rays.across = 2147483647", "100 or less"]),
    "wavelengths": (
        {"merit": [{"metric": "spot_rms_mm"}], "rays": {"wavelengths_nm": [500.0, 600.0]}}, ["wavelengths_nm", "odd"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_a_fault_is_refused_in_one_line_that_names_it(case: str) -> None:
    given, words = REFUSED[case]
    given = {"variables": [VARIABLE], "merit": [TERM], **given}
    changes = {"camera.lens.surfaces[0].index": None, "camera.lens.surfaces[0].glass": "SCHOTT/N-BK7"}
    scene = SCENE.changed(changes) if "glass" in case else SCENE
    scene = scene.changed({"camera.focus_mm": given.pop("focus")}) if "focus" in given else scene
    with pytest.raises(LfmeshError) as refused:
        lf.optimise(scene, **given)
    message = str(refused.value)
    assert len(message.splitlines()) == 1, message
    for word in words:
        assert word in message


def test_lenses_without_formulas_are_refused_by_terms_of_rays_alone() -> None:
    toric = {"toroid": {"radius_x_mm": 50.0}, "radius_mm": 40.0}
    front = {**SCENE.camera.lens.surfaces[0].model_dump(exclude_defaults=True), **toric}
    scene = SCENE.changed({"camera.lens": {"surfaces": [front, {"semi_diameter_mm": 5.0}]}})
    with pytest.raises(LfmeshError, match=r"surfaces\[0\]\.toroid"):
        lf.optimise(scene, [VARIABLE], [{"metric": "spot_rms_mm"}])
    assert lf.optimise(scene, [VARIABLE], [TERM]).merit_after < 1e-12


def test_every_number_of_the_first_order_report_is_a_figure() -> None:
    facts = lf.first_order(lf.Scene(camera=close_up_camera())).as_dict()
    numbers = {name for name, value in facts.items() if isinstance(value, float)}
    assert numbers <= FIGURES.keys()


def write_design(folder: Path, *more: str) -> Path:
    lf.save(SCENE, folder / "camera.toml")
    lines = [
        'scene = "camera.toml"',
        "[changes]",
        f'"{RADIUS}" = 44.0',
        "[[variables]]",
        f'path = "{RADIUS}"',
        "range = [20.0, 90.0]",
        "[[variables]]",
        f'path = "{THICKNESS}"',
        "range = [1.0, 5.0]",
        'label = "thickness / mm"',
        "[[merit]]",
        'metric = "efl_mm"',
        "target = 80.0",
        "[[constraints]]",
        'metric = "centre_thickness_mm"',
        "most = 4.0",
        *more,
    ]
    path = folder / "design.toml"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_the_command_writes_the_best_scene_and_a_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["optimise", str(write_design(tmp_path)), "-o", str(tmp_path / "best")]) == 0
    scene = lf.load(tmp_path / "best" / "optimised.toml")
    assert lf.first_order(scene).efl_mm == pytest.approx(80.0, rel=1e-9)
    facts = json.loads((tmp_path / "best" / "optimum.json").read_text())
    (term,), (constraint,) = facts["terms"], facts["constraints"]
    assert term["before"] == pytest.approx(44.0 / 0.6)
    assert term["after"] == pytest.approx(80.0)
    assert facts["merit_before"] == pytest.approx((44.0 / 0.6 - 80.0) ** 2)
    assert constraint["excess_after"] == 0.0
    assert facts["variables"][0] == {
        "path": RADIUS, "before": 44.0, "after": scene.camera.lens.surfaces[0].radius_mm, "note": ""
    }  # fmt: skip
    assert facts["complete"]
    assert facts["cameras_tried"] > 1
    text = (tmp_path / "best" / "optimum.txt").read_text()
    printed = capsys.readouterr().out
    assert text in printed
    assert max(map(len, text.splitlines())) <= COLUMNS
    assert "thickness / mm" in text
    # A target that is reached to rounding leaves a merit of some 1e-25, in which no digit is one.
    assert facts["merit_after"] < 1e-15
    assert re.match(r"merit 44\.4444 before, 0 after\n", text)
    assert (
        "Merit function: 44.4444 before, 0 after (smaller is better)."
        in (tmp_path / "best" / "report.html").read_text()
    )


def test_the_page_holds_figures_variables_and_both_cameras_and_loads_nothing(tmp_path: Path) -> None:
    limit = ["[[constraints]]", 'metric = "edge_thickness_mm"', "least = 6.0"]
    assert main(["optimise", str(write_design(tmp_path, *limit)), "-o", str(tmp_path / "best")]) == 1
    page = (tmp_path / "best" / "report.html").read_text()
    facts = json.loads((tmp_path / "best" / "optimum.json").read_text())
    words = re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]*>", " ", page)))
    assert all(line in words for line in (*facts["not_reached"], *facts["notes"]))
    for each in (*facts["terms"], *facts["constraints"]):
        assert f"{each['before']:.6g} {each['after']:.6g}" in words
    assert all(f"{each['before']:.7g} {each['after']:.7g}" in words for each in facts["variables"])
    assert page.count('<img src="data:image/svg+xml;base64,') == 2
    assert not re.findall(r'(?:src|href)="(?!data:|#)', page)
    assert "<script" not in page


def test_the_page_gives_each_figure_its_words_and_its_unit_once(tmp_path: Path) -> None:
    assert main(["optimise", str(write_design(tmp_path)), "-o", str(tmp_path / "best")]) == 0
    page = (tmp_path / "best" / "report.html").read_text()
    rows = [re.findall(r"<t[dh]>(.*?)</t[dh]>", row) for row in re.findall(r"<tr>.*?</tr>", page, flags=re.DOTALL)]
    assert rows[0][:5] == ["figure", "unit", "asked for", "before", "after"]
    assert rows[1][:2] == ["efl_mm", "mm"]
    assert rows[2][:2] == ["centre_thickness_mm: thickness of elements on the axis", "mm"]
    assert "/ mm / mm" not in page


@pytest.mark.parametrize(
    ("metric", "unit"),
    [("spot_rms_mm", "mm"), ("mtf", ""), ("distortion", ""), ("micro_image_pitch_px", "pixels"),
     ("light_w_per_pixel", "W per pixel"), ("far_mm", "mm")],
)  # fmt: skip
def test_every_figure_knows_its_unit(metric: str, unit: str) -> None:
    found = Goal(metric=metric, per_mm=20.0 if metric == "mtf" else None)
    assert found.unit == unit
    assert " / " not in found.described


def test_the_exit_code_says_that_a_limit_is_not_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    design = write_design(tmp_path, "[[constraints]]", 'metric = "edge_thickness_mm"', "least = 6.0")
    assert main(["optimise", str(design), "-o", str(tmp_path / "best")]) == 1
    assert "edge_thickness_mm = " in (said := " ".join(capsys.readouterr().err.split()))
    assert "violates at least 6" in said
    assert "violates at least 6" in (tmp_path / "best" / "optimum.txt").read_text()
    assert lf.load(tmp_path / "best" / "optimised.toml").camera.lens.surfaces[0].thickness_mm


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["[[merit]]", 'metric = "spotrms"'], ["design.toml", "merit[1].metric", "unknown metric"]),
        (["[[merit]]", 'metric = "efl"'], ["the nearest are efl_mm,", "lfmesh/study/README.md"]),
        (["[[variables]]"], ["design.toml", "variables[2].path", "missing"]),
        (["=="], ["design.toml", "not valid TOML"]),
    ],
)
def test_the_command_names_file_and_fault(
    more: list[str], words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["optimise", str(write_design(tmp_path, *more)), "-o", str(tmp_path / "best")]) == 2
    complaint = " ".join(capsys.readouterr().err.split())
    assert all(word in complaint for word in words), complaint
    assert len(complaint) < 400
    assert not (tmp_path / "best").exists()


def test_files_of_another_kind_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    design = write_design(tmp_path)
    assert main(["optimise", str(tmp_path / "camera.toml"), "-o", str(tmp_path / "best")]) == 2
    assert "is a scene file, but a design file is needed" in " ".join(capsys.readouterr().err.split())
    assert main(["check", str(design)]) == 2
    assert "lfmesh optimise takes it" in " ".join(capsys.readouterr().err.split())


def test_ctrl_c_writes_the_best_camera_so_far(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from lfmesh.study.optimise.search import Search

    def interrupted(self: Search) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Search, "run", interrupted)
    assert main(["optimise", str(write_design(tmp_path)), "-o", str(tmp_path / "best")]) == 130
    assert lf.load(tmp_path / "best" / "optimised.toml").camera.lens.surfaces[0].radius_mm == 44.0
    assert not json.loads((tmp_path / "best" / "optimum.json").read_text())["complete"]
    assert "best camera so far" in capsys.readouterr().err


def interrupted_once(usual: Callable[..., Any], *, after: bool) -> Callable[..., Any]:
    """Return a function that a signal comes in once, before or after its work."""
    left = [True]

    def cut(*given: Any) -> Any:
        if after:
            found = usual(*given)
        if left.pop() if left else False:
            os.kill(os.getpid(), signal.SIGINT)
        return found if after else usual(*given)

    return cut


@pytest.mark.parametrize("where", ["optimise._differences", "design_files.write_files"])
def test_ctrl_c_after_the_search_loses_nothing_and_is_told_nothing_wrong(
    where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """While the best camera is looked at again, and when its files are written."""
    module, name = where.split(".")
    place = importlib.import_module(f"lfmesh.study.optimise.{module}")
    monkeypatch.setattr(place, name, interrupted_once(getattr(place, name), after=module == "design_files"))
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert main(["optimise", str(write_design(tmp_path)), "-o", str(tmp_path / "best")]) in (0, 130)
    finally:
        signal.signal(signal.SIGINT, usual)
    told = capsys.readouterr()
    assert "nothing was written" not in told.err
    written = {path.name for path in (tmp_path / "best").iterdir()}
    assert written == {"optimised.toml", "optimum.json", "optimum.txt", "report.html"}
    assert all(name in told.out for name in written)
    assert json.loads((tmp_path / "best" / "optimum.json").read_text())["complete"]


def test_constraints_and_terms_of_the_same_figure_are_told_apart() -> None:
    found = lf.optimise(SCENE, [VARIABLE], focal_length(80.0), constraints=[{"metric": "efl_mm", "most": 70.0}])
    assert lf.first_order(found.scene).efl_mm == pytest.approx(70.0, rel=2e-6)
    assert found.missed == ("efl_mm = 70 is 10 from its target 80",)
