"""A study says all that is wrong with it before anything is traced."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.study.sweeps import probe
from lfmesh.study.sweeps.paths import value_at
from lfmesh.study.sweeps.plan import DISTANCES, seed_of
from lfmesh.study.sweeps.pool import Result, here
from tests.study.studies import SHIFT, shifted, small_scene

STUDY = """
scene = "scene.toml"
metrics = ["light"]
{}
"""


def write(folder: Path, text: str) -> Path:
    (folder / "scene.toml").write_text(small_scene().dump_toml())
    (folder / "study.toml").write_text(STUDY.format(text))
    return folder / "study.toml"


def test_all_faults_are_named_at_once(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        """
[[axes]]
path = "camera.mla.pose.tlt_deg[0]"
values = [0.1]
[[axes]]
path = "camera.mla.pose.tilt_deg[3]"
values = [0.1]
[[axes]]
path = "camera.lens.elements[0].pose.shift_mm[0]"
values = [0.1]
[[axes]]
path = "camera.focus_mm"
values = [70.0]
""",
    )
    with pytest.raises(lf.LfmeshError) as told:
        lf.Study.load(path)
    text = str(told.value)
    assert "4 faults" in text
    assert "did you mean 'tilt_deg'" in text
    assert "3 entries, numbered from 0: there is no [3]" in text
    assert "0 entries" in text
    assert "add refocus = true" in text


@pytest.mark.parametrize(
    ("fault", "why"),
    [
        ("paired = 3", "paired = 3: must be true or false"),
        ('design = "sobol"', "count: missing"),
        ('[[axes]]\npath = "transport.sed"\nvalues = [1]', "did you mean 'seed'"),
        ('[[axes]]\npath = "transport.samples"\nvalues = [1]\nfoo = 1', "axes[1].foo: unknown key"),
    ],
    ids=["of a value", "between keys", "of a path", "of an axis"],
)
def test_a_metric_that_does_not_exist_is_named_beside_any_other_fault(tmp_path: Path, fault: str, why: str) -> None:
    axis = '[[axes]]\npath = "transport.seed"\nrange = [0, 1]\n' + ("" if "sobol" in fault else "count = 2\n")
    text = f"{axis}{fault}" if fault.startswith("[[") else f"{fault}\n{axis}"
    path = write(tmp_path, text)
    path.write_text(path.read_text().replace('"light"', '"light", "psnrr"'))
    with pytest.raises(lf.LfmeshError) as told:
        lf.Study.load(path)
    first, *lines = str(told.value).splitlines()
    assert first.endswith("2 faults")
    assert any(why in line for line in lines)
    assert "metrics[1] = \"psnrr\": unknown metric (did you mean 'psnr'?)" in lines[-1]


def test_points_that_give_an_invalid_camera_are_named() -> None:
    axes = [
        {"path": "camera.mla.pitch_mm", "values": [0.5, -0.5, 9.0]},
        {"path": "camera.lens.surfaces[0].thickness_mm", "values": [3.0, 0.1]},
    ]
    with pytest.raises(lf.LfmeshError) as told:
        lf.Study(small_scene(), axes=axes, metrics=["light"])
    lines = str(told.value).splitlines()
    assert "3 faults" in lines[0]
    assert "point 2 (camera.mla.pitch_mm = -0.5 mm)" in lines[1]
    assert "must be above 0" in lines[1]
    assert "point 3 (camera.mla.pitch_mm = 9 mm)" in lines[2]
    assert "does not reach the corner" in lines[2]
    assert "point 5 (camera.lens.surfaces[0].thickness_mm = 0.1 mm)" in lines[3]
    assert "cross inside their clear aperture" in lines[3]


def test_a_camera_that_cannot_be_focused_is_found_where_it_is_focused_anew() -> None:
    axes = [{"path": "camera.focus_mm", "values": [70.0, 5.0]}]
    with pytest.raises(lf.LfmeshError, match=r"point 2 \(camera.focus_mm = 5 mm\): .*no real image"):
        lf.Study(small_scene(), axes=axes, refocus=True, metrics=["light"])


def test_refocus_that_refocuses_nothing_is_refused() -> None:
    with pytest.raises(lf.LfmeshError, match=r"^study: refocus = true: changes nothing.*compensator"):
        shifted(refocus=True)


def test_a_limit_of_metrics_without_columns_to_limit_says_so() -> None:
    with pytest.raises(lf.LfmeshError, match=r"not a column that can be limited; metrics = \['efficiency'\] have none"):
        shifted(metrics=("efficiency",), limits={"psnr_db": 30.0})


def test_a_limit_of_a_misspelt_metric_is_one_fault_and_not_two() -> None:
    with pytest.raises(lf.LfmeshError) as told:
        shifted(metrics=("psnrr",), limits={"psnr_db": 30.0})
    assert "psnrr" in str(told.value)
    assert "can be limited" not in str(told.value)


def test_python_names_a_fault_of_a_study_by_the_public_class() -> None:
    with pytest.raises(lf.LfmeshError, match=r"^Study\.foo") as told:
        shifted(foo=1)
    assert "StudyFile" not in str(told.value)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "axes: missing"),
        ('template = "assmbly"', "must be one of assembly"),
        ('metric = ["psnr"]\n[[axes]]\npath = "a"\nvalues = [1]', "did you mean 'metrics'"),
        ('design = "sobol"\n[[axes]]\npath = "transport.seed"\nvalues = [1]', "count: missing"),
        ('design = "grdi"\n[[axes]]\npath = "transport.seed"\nvalues = [1]', "did you mean 'grid'"),
        ('[[axes]]\npath = "transport.seed"\nrange = [0, 1]', "how many values"),
        ('batches = 3\n[[axes]]\npath = "transport.seed"\nvalues = [1]', "must divide transport.replicates = 4"),
        ('[changes]\n"transport.sampels" = 3\n[[axes]]\npath = "transport.seed"\nvalues = [1]', "mean 'samples'"),
        ('[[axes]]\npath = "camera.sensor.pixels"\nvalues = [[10, 10]]', "compared pixel by pixel"),
    ],
)
def test_what_a_study_cannot_mean_is_refused_in_a_line(
    tmp_path: Path, text: str, why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["study", str(write(tmp_path, text)), "-o", str(tmp_path / "out")]) == 2
    printed = capsys.readouterr().err
    assert why in printed
    assert "Traceback" not in printed
    assert not (tmp_path / "out").exists()


def test_paired_points_share_their_random_numbers_and_others_do_not() -> None:
    paired = shifted(3).plan
    assert {paired.scene_of(point).transport.seed for point in paired.points} == {3}
    alone = shifted(3, paired=False).plan
    seeds = [alone.scene_of(point).transport.seed for point in alone.points]
    assert len(set(seeds)) == 4
    assert seeds[0] == 3
    assert seeds == [seed_of(3, number) for number in range(4)]


def test_the_digest_follows_what_is_computed(tmp_path: Path) -> None:
    digests = {
        shifted(3).plan.digest,
        shifted(4).plan.digest,
        shifted(3, paired=False).plan.digest,
        shifted(3, metrics=("psnr",)).plan.digest,
        lf.Study(small_scene(seed=4), axes=shifted(3).plan.axes, metrics=["psnr", "light"]).plan.digest,
    }
    assert len(digests) == 5
    assert shifted(3).plan.digest == shifted(3).plan.digest


def test_a_dry_run_lists_points_and_computes_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(probe, "in_pool", lambda units, _: here(units))
    path = write(tmp_path, f'[[axes]]\npath = "{SHIFT}"\nvalues = [0.01, 0.02]')
    assert main(["study", str(path), "--dry-run"]) == 0
    printed = capsys.readouterr().out
    assert "camera.mla.pose.shift_mm[0] = 0.02" in printed
    assert "3 points, 3 units" in printed
    assert re.search(r"about [\d.]+ s \([\d.]+ s to start, [\d.]+ s per camera in one process\), [\d.]+ GB", printed)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["scene.toml", "study.toml"]


@pytest.mark.parametrize(("workers", "seconds"), [(0, 7.0 + 3 * 5.0), (2, 2 * 7.0 + 3 * 5.0 / 2)])
def test_the_time_of_a_study_has_the_start_of_its_processes_and_new_cameras(
    monkeypatch: pytest.MonkeyPatch, workers: int, seconds: float
) -> None:
    """Of 20 s until a process answers it worked for 15 s, 4 s of which went to its first camera, where others take 2 s.

    So it starts in 7 s. Two replicates more take 1 s more, so ten take 3 s more than the four that were tried.
    """
    times = json.dumps([15.0, 4.0, 2.0, 1.5, 0.5, [], []]).encode()
    monkeypatch.setattr(probe, "in_pool", lambda units, _: (Result(unit, times) for unit, _ in units))
    monkeypatch.setattr(probe, "reference_films", lambda _: b"")
    clock = iter((0.0, 20.0))
    monkeypatch.setattr(probe.time, "perf_counter", lambda: next(clock))
    axes = [{"path": SHIFT, "values": [0.01, 0.02]}]
    found = probe.probe(lf.Study(small_scene(replicates=10), axes=axes, metrics=["light"]).plan, workers)
    assert found.unit_seconds == pytest.approx(5.0)
    assert found.seconds == pytest.approx(seconds)


def test_the_time_of_a_study_is_that_of_a_camera_that_can_be_traced(monkeypatch: pytest.MonkeyPatch) -> None:
    """A target that is moved into the camera: building it fails at once."""
    timed: list[int] = []
    run_unit = probe.run_unit
    monkeypatch.setattr(probe, "in_pool", lambda units, _: here(units))
    monkeypatch.setattr(probe, "run_unit", lambda unit, films: (timed.append(unit.point), run_unit(unit, films))[1])
    axes = [{"path": "targets[0].position_mm[2]", "values": [1.0, -60.0]}]
    found = probe.probe(lf.Study(small_scene(), axes=axes, metrics=["light"]).plan, 0)
    assert timed == [0, 1, 2, 2, 2]
    assert len(found.unknown) == 1
    assert found.unknown[0].startswith("point 1 (targets[0].position_mm[2] = 1 mm) cannot be traced: targets[0]")


LENS = {
    "elements": [{"surfaces": [1]}],
    "surfaces": [
        {"thickness_mm": 2.0, "semi_diameter_mm": 10.0, "stop": True},
        {"radius_mm": 62.8, "thickness_mm": 4.0, "index": 1.517, "semi_diameter_mm": 12.7},
        {"radius_mm": -45.7, "thickness_mm": 2.5, "index": 1.673, "semi_diameter_mm": 12.7},
        {"radius_mm": -128.2, "semi_diameter_mm": 12.7},
    ],
}


@pytest.mark.parametrize("adjusted", [False, True])
def test_poses_by_which_surfaces_cross_are_named_before_anything_runs(adjusted: bool) -> None:
    """By −6 deg the edge of surface 1 turns through surface 2; by 3 deg it does not."""
    tilt = {"path": "camera.lens.elements[0].pose.tilt_deg[0]"}
    moved = {"compensators": [tilt | {"range": (-6.0, 0.0), "metric": "chief_rays_rms_px"}]} if adjusted else {}
    axes = [{"path": SHIFT, "values": [0.01]} if adjusted else tilt | {"values": [-6.0, 3.0]}]
    scene = small_scene().changed({"camera.focus_mm": 500.0, "camera.lens": LENS})
    with pytest.raises(lf.LfmeshError, match=r"point 1 .*tilt_deg = \[-6\.0, .*surfaces 1 and 2 cross") as told:
        lf.Study(scene, axes=axes, metrics=["chief_rays"], **moved)
    assert len(str(told.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("camera.mla.pose.shift_mm[2]", 9.0, "the array reaches .* mm through the sensor's plane"),
        ("camera.mla.pose.shift_mm[2]", -80.0, "camera.mla.pose: it reaches .* mm into the lens"),
        ("camera.sensor.pose.shift_mm[2]", -9.0, "the array reaches .* mm through the sensor's plane"),
    ],
)
def test_poses_by_which_array_or_sensor_collide_are_named_as_a_build_names_them(
    path: str, value: float, message: str
) -> None:
    scene = small_scene()
    with pytest.raises(lf.SceneError, match=message) as refusal:
        lf.build(scene.changed({path: value}))
    with pytest.raises(lf.LfmeshError, match="point 1 ") as told:
        lf.Study(scene, axes=[{"path": path, "values": [value, 0.01]}], metrics=["chief_rays"])
    assert str(refusal.value) in str(told.value)
    assert len(str(told.value).splitlines()) == 1


FOCAL, STOP = "camera.mla.focal_length_mm", "camera.lens.stop_semi_diameter_mm"


@pytest.mark.parametrize("path", [FOCAL, f"{FOCAL}[0]", STOP, "camera.lens.f_number"])
def test_what_solving_replaces_is_varied_as_the_scene_says_it(path: str) -> None:
    """The reference stays the same camera; relative changes are added to the scene's own number."""
    field = path.removesuffix("[0]")
    scene = small_scene() if field == FOCAL else small_scene().changed({field: 2.5})
    axes = [{"path": path, "values": [-0.05], "relative": True}]
    plan = lf.Study(scene, axes=axes, metrics=["chief_rays"], limits={"chief_rays_rms_px": 1.0}).plan
    reference, moved, searched = (lf.solved(plan.scene_of(point)) for point in plan.points)
    assert reference == lf.solved(scene)
    distances = {path: value_at(reference, path) for path in DISTANCES}
    wanted = {FOCAL: 2.6 - 0.05} if field == FOCAL else {field: 2.45}
    assert moved == searched == lf.solved(scene.changed(wanted | distances))


MEDIA = {
    "camera.object_medium": {"index": 1.1},
    "camera.image_medium": {"index": 1.05},
    "camera.air": {"temperature_c": 30.0, "pressure_kpa": 95.0},
    "camera.lens.surfaces[0].glass": "SCHOTT/N-BK7",
    "camera.lens.surfaces[0].index": None,
}


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("camera.object_medium.index", 1.2),
        ("camera.image_medium.index", 1.1),
        ("camera.image_medium", {"index": 1.1}),
        ("camera.air.pressure_kpa", 20.0),
    ],
)
def test_media_and_air_are_varied_as_the_scene_says_them(path: str, value: Any) -> None:
    scene = small_scene().changed(MEDIA)
    plan = lf.Study(scene, axes=[{"path": path, "values": [value]}], metrics=["chief_rays"]).plan
    reference, moved = (lf.solved(plan.scene_of(point)) for point in plan.points)
    assert reference == lf.solved(scene)
    assert lf.first_order(moved).efl_mm == pytest.approx(lf.first_order(scene.changed({path: value})).efl_mm, rel=1e-12)
    assert abs(lf.first_order(moved).efl_mm - lf.first_order(reference).efl_mm) > 1e-4


def test_the_liquid_of_a_tank_is_varied_as_the_scene_says_it() -> None:
    """A solved scene has windows and liquid as bodies; the reference has one liquid, the other point another."""
    tank = {
        "size_mm": [100.0, 100.0, 60.0], "wall_mm": 5.0, "wall": {"index": 1.5}, "liquid": {"index": 1.33},
        "position_mm": [0.0, 0.0, -500.0],
    }  # fmt: skip
    scene = small_scene().changed({"tanks": [tank]})
    axes = [{"path": "tanks[0].liquid.index", "values": [1.4]}]
    plan = lf.Study(scene, axes=axes, metrics=["chief_rays"]).plan
    reference, moved = (plan.scene_of(point) for point in plan.points)
    assert [each.tanks[0].liquid.index for each in (reference, moved)] == [1.33, 1.4]
    assert reference.targets == moved.targets == scene.targets


def test_points_are_told_with_the_names_and_units_of_reports() -> None:
    axes = [{"path": SHIFT, "values": [0.1 / 3.0], "relative": True, "label": "array: decentre / mm"}]
    plan = lf.Study(small_scene(), axes=axes, metrics=["chief_rays"], limits={"chief_rays_rms_px": 1.0}).plan
    told = [plan.label(point) for point in plan.points]
    assert told == [
        "the reference",
        "array: decentre = 0.0333333 mm",
        "largest change, array: decentre up to 0.0333333 mm",
    ]


@pytest.mark.parametrize("design", ["sobol", "latin_hypercube"])
def test_a_drawn_design_over_a_template_of_listed_values_is_refused_in_one_line(design: str) -> None:
    with pytest.raises(lf.LfmeshError) as told:
        lf.Study(small_scene(), design=design, count=8, metrics=["chief_rays"], template="assembly")
    said = str(told.value)
    assert said.startswith(
        f'study: template = "assembly": lists values, and design = "{design}" needs a range, log_range'
    )
    assert len(said.splitlines()) == 1
