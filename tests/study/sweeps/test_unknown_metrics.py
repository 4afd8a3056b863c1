"""A metric that cannot be had is unknown, with its reason; the others stand."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.study.sweeps import probe
from lfmesh.study.sweeps.pool import here
from lfmesh.study.sweeps.sentences import in_short
from lfmesh.study.sweeps.study_folder import logged
from lfmesh.study.sweeps.table import Table
from tests.cameras import SQUARE_ARRAY
from tests.study.studies import SHIFT, small_scene

ASIDE = "camera.sensor.pose.shift_mm[0]"
"""Of a sensor that is moved out of all light the white image is black, and shows no micro-images."""

BLACK = "the white image shows no micro-images: it is black"
TWO_SIDED = "arrays with lenslets on both faces are not decoded or calibrated"


def aside(*shifts_mm: float, metrics: tuple[str, ...] = ("light", "centres"), **settings: Any) -> lf.Study:
    axes = [{"path": ASIDE, "values": list(shifts_mm)}]
    return lf.Study(small_scene(samples=8), axes=axes, metrics=metrics, **settings)


def two_sided() -> lf.Scene:
    mla = {name: value for name, value in SQUARE_ARRAY.items() if name != "focal_length_mm"}
    return small_scene(samples=8).changed({"camera.mla": mla | {"radius_mm": 3.0, "back": {"radius_mm": 3.0}}})


def finite(table: Table, column: str) -> list[bool]:
    return np.isfinite(table.values(column)).tolist()


@pytest.mark.parametrize("workers", [0, 1])
def test_a_metric_that_cannot_be_had_at_a_point_is_unknown_there_and_the_others_stand(
    workers: int, tmp_path: Path
) -> None:
    table = aside(0.01, 40.0).run(tmp_path, workers=workers)
    alone = aside(0.01, 40.0, metrics=("light",)).run(tmp_path / "alone", workers=0)
    assert not table.failed
    assert finite(table, "centres_rms_px") == [True, True, False]
    assert table.values("light_ratio").tolist() == alone.values("light_ratio").tolist()
    assert [dict(row.unknown) for row in table.rows] == [{}, {}, {"centres": BLACK}]
    assert (tmp_path / "table.csv").read_text().splitlines()[-1].endswith(f",,centres: {BLACK},LightOutsideAimWarning")
    (noted,) = (line for line in logged(tmp_path) if line["event"] == "unknown")
    assert (noted["point"], noted["metric"], noted["reason"]) == (2, "centres", BLACK)
    said = f"centres is not known at 1 of 3 points ({ASIDE} = 40 mm): {BLACK}."
    assert said in in_short(table)
    assert said in (tmp_path / "report.html").read_text()


def test_a_point_of_which_no_metric_can_be_had_fails(tmp_path: Path) -> None:
    table = aside(40.0, metrics=("centres",)).run(tmp_path, workers=0)
    assert [row.fault for row in table.rows] == ["", BLACK]
    assert not any(row.unknown for row in table.rows)
    scene = small_scene(samples=8).changed({ASIDE: 40.0})
    study = lf.Study(scene, axes=[{"path": SHIFT, "values": [0.01]}], metrics=["centres"])
    with pytest.warns(UserWarning, match=f"^no metric is known for the reference camera: {BLACK}"):
        study.run(tmp_path / "black", workers=0)


def test_a_metric_that_cannot_be_had_of_the_reference_is_said_before_other_cameras_are_traced(tmp_path: Path) -> None:
    """Whatever lacks: the metric itself, or a picture that it is made of."""
    study = lf.Study(
        two_sided(), axes=[{"path": SHIFT, "values": [0.01]}], metrics=["light", "chief_rays", "crosstalk"]
    )
    told: list[tuple[int, str]] = []
    done = 0

    def count(now: Any) -> None:
        nonlocal done
        done = now.done

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("warnings.warn", lambda each, **_: told.append((done, str(each))))
        table = study.run(tmp_path, workers=0, progress=count)
    assert [when for when, _ in told] == [0, 0]
    for name, (_, words) in zip(("chief_rays", "crosstalk"), told, strict=True):
        assert words.startswith(f"{name} is not known for the reference camera: ")
        assert TWO_SIDED in words
    assert not table.failed
    assert finite(table, "light_ratio") == [True, True]
    assert [sorted(row.unknown) for row in table.rows] == 2 * [["chief_rays", "crosstalk"]]


def test_the_command_and_its_dry_run_name_a_metric_that_cannot_be_had(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(probe, "in_pool", lambda units, _: here(units))
    (tmp_path / "scene.toml").write_text(two_sided().dump_toml())
    study = tmp_path / "study.toml"
    study.write_text(
        f'scene = "scene.toml"\nmetrics = ["light", "chief_rays"]\n[[axes]]\npath = "{SHIFT}"\nvalues = [0.01]\n'
    )
    assert main(["study", str(study), "--dry-run"]) == 0
    printed = " ".join(capsys.readouterr().err.split())
    assert "Note: chief_rays is not known for the reference camera: camera.mla.back: arrays with" in printed
    assert main(["study", str(study), "-o", str(tmp_path / "out"), "--workers", "0"]) == 0
    captured = capsys.readouterr()
    assert "2 of 2 points are done." in captured.out
    printed = " ".join(captured.err.split())
    assert "Note: chief_rays is not known for the reference camera: camera.mla.back: arrays with" in printed
    assert "Note: chief_rays is not known at 2 of 2 points (the reference," in printed


def test_a_limit_of_a_metric_that_cannot_be_had_is_neither_held_nor_broken(tmp_path: Path) -> None:
    table = aside(0.01, 40.0, limits={"centres_rms_px": 1.0}).run(tmp_path, workers=0)
    assert any(line.endswith("1.0 is held at 1 of 2 cameras; for 1 its value is not known.") for line in held(table))
    assert not table.breaking()
    drawn = {"path": ASIDE, "range": (0.0, 10.0)}
    study = lf.Study(
        small_scene(samples=8), axes=[drawn], metrics=["light", "centres"], limits={"centres_rms_px": 1e3},
        design="latin_hypercube", count=4, seed=1,
    )  # fmt: skip
    table = study.run(tmp_path / "drawn", workers=0)
    known = int(np.isfinite(table.values("centres_rms_px")[[row.point.number for row in table.drawn]]).sum())
    found = table.yield_share()
    assert found is not None
    assert 0 < known < 4
    assert found.trials == known


def held(table: Table) -> list[str]:
    return [line.replace("at most 1 pixels", "1.0") for line in in_short(table) if line.startswith("The limit")]


def test_what_is_adjusted_or_searched_by_a_metric_that_cannot_be_had_fails(tmp_path: Path) -> None:
    """A camera that was not adjusted would be another one; and without a limit of the reference there is no search."""
    compensators = [{"path": "camera.mla.pose.tilt_deg[2]", "range": (-0.1, 0.1), "metric": "chief_rays_rms_px"}]
    with pytest.warns(UserWarning, match="chief_rays is not known for the reference camera"):
        table = lf.Study(
            two_sided(),
            axes=[{"path": SHIFT, "values": [0.01]}],
            metrics=["light", "chief_rays"],
            limits={"chief_rays_rms_px": 1.0},
            compensators=compensators,
        ).run(tmp_path, workers=0)
    adjusted, *searched = (row.fault for row in table.rows[1:])
    assert adjusted.startswith("cannot be adjusted by chief_rays_rms_px: ")
    assert searched
    assert all(why.startswith("chief_rays has a limit, but is not known for the reference") for why in searched)
    assert not any("reference camera itself" in line for line in in_short(table))


def test_a_value_that_noise_or_darkness_hides_has_a_reason_as_one_that_cannot_be_computed(tmp_path: Path) -> None:
    table = aside(40.0, metrics=("light", "ncc")).run(tmp_path, workers=0)
    assert not table.failed
    assert finite(table, "ncc") == [True, False]
    assert dict(table.rows[1].unknown) == {"ncc": "there is no light, or not enough of it"}
    assert "ncc: there is no light" in (tmp_path / "table.csv").read_text().splitlines()[-1]


def test_cameras_that_are_not_known_on_the_way_of_an_adjustment_are_counted_and_not_the_best(tmp_path: Path) -> None:
    """The adjustment tries the sensor 10 mm aside, where it is dark."""
    best = {"path": ASIDE, "range": (-20.0, 20.0), "metric": "centres_rms_px"}
    axes = [{"path": SHIFT, "values": [0.01]}]
    study = lf.Study(small_scene(samples=8), axes=axes, metrics=["light", "centres"], compensators=[best])
    table = study.run(tmp_path, workers=0)
    assert not table.failed
    assert finite(table, "centres_rms_px") == [True, True]
    met = table.rows[1].on_the_way["centres"]
    assert 0 < met.unknown < met.cameras
    assert met.reason == BLACK
    said = f"({met.unknown} of {met.cameras} cameras on the way): {BLACK}"
    assert said in (tmp_path / "table.csv").read_text()
    assert f"centres is not known for {met.unknown} of {met.cameras} cameras tried" in " ".join(in_short(table))
    assert [line["unknown"] for line in logged(tmp_path) if line["event"] == "unknown on the way"] == [met.unknown]
