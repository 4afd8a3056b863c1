"""The largest change that keeps a limit: the metric is at the limit there, and beyond it farther on."""

import math
import pickle
import random
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import lfmesh as lf
from lfmesh.study.metrics.column import Column
from lfmesh.study.sweeps.statistics import Estimate
from lfmesh.study.sweeps.table import Row, Table
from lfmesh.study.tolerances.largest_change import Allowed, Search, largest_change
from tests.study.studies import SHIFT, small_scene

TURN = "camera.mla.pose.tilt_deg[2]"


def run(folder: Path, limits: dict[str, float], *, scene: lf.Scene | None = None, **settings: Any) -> Table:
    axes = [{"path": SHIFT, "values": [-0.1, 0.06], "label": "array: decentre / mm"}, {"path": TURN, "values": [0.01]}]
    metrics = [name for name in ("chief_rays", "psnr") if any(limit.startswith(name) for limit in limits)]
    study = lf.Study(scene or small_scene(), axes=axes, metrics=metrics, limits=limits, **settings)
    return study.run(folder, workers=0)


def found(table: Table) -> list[Row]:
    return [row for row in table.rows if row.allowed is not None]


def test_a_displacement_is_at_its_limit_where_the_largest_change_ends(tmp_path: Path) -> None:
    """Chief rays move with the array, without noise: to the precision of the search, a ten-thousandth of its reach."""
    table = run(tmp_path, {"chief_rays_rms_px": 0.3})
    down, up, turn = found(table)
    for row, far in ((down, -0.1), (up, 0.06)):
        assert row.allowed is not None
        assert math.copysign(1.0, row.allowed.value) == math.copysign(1.0, far)
        assert 0.0 < row.allowed.value / far < 1.0
        assert row.estimates["chief_rays_rms_px"].value == pytest.approx(0.3, rel=1e-3)
        assert row.allowed.low < row.allowed.value < row.allowed.high
        assert row.allowed.column == "chief_rays_rms_px"
    assert down.allowed is not None
    assert up.allowed is not None
    assert down.allowed.value == pytest.approx(-up.allowed.value, rel=1e-2)
    assert turn.allowed == (0.01, 0.01, 0.01, "", "")


def test_a_reference_at_its_limit_is_not_called_beyond_it(tmp_path: Path) -> None:
    axes = [{"path": SHIFT, "values": [0.05], "label": "array: decentre / mm"}]
    study = lf.Study(small_scene(), axes=axes, metrics=["chief_rays"], limits={"chief_rays_rms_px": 0.0})
    study.run(tmp_path, workers=0)
    page = (tmp_path / "report.html").read_text()
    assert "array: decentre may not change at all: the reference itself is at a limit." in page


def test_it_is_told_in_table_and_report(tmp_path: Path) -> None:
    table = run(tmp_path, {"chief_rays_rms_px": 0.3})
    page = (tmp_path / "report.html").read_text()
    assert "array: decentre may change by -0.02" in page
    assert "mm, until a limit is reached: chief rays: displacement, rms at most 0.3 pixels." in page
    assert f"{TURN} may change by +0.01 deg, the whole studied range: no limit is reached." in page
    heading, *lines = (line.split(",") for line in (tmp_path / "table.csv").read_text().splitlines())
    searched = [dict(zip(heading, line, strict=True)) for line in lines if SHIFT in line]
    assert [float(line["allowed_low"]) for line in searched] == [row.allowed.low for row in found(table)[:2]]  # type: ignore[union-attr]
    # The points of the search are no cameras that were drawn or studied.
    assert "is broken at 2 of 3 cameras" in page


def test_a_limit_that_nothing_breaks_is_held(tmp_path: Path) -> None:
    table = run(tmp_path, {"chief_rays_rms_px": 3.0})
    assert all(row.allowed is not None and row.allowed.column == "" for row in found(table))
    page = (tmp_path / "report.html").read_text()
    assert "The limit chief rays: displacement, rms at most 3 pixels is held at all 3 cameras." in page


def test_other_random_numbers_show_the_metric_at_its_limit(tmp_path: Path) -> None:
    """PSNR with noise: at the value that one seed finds, another is at the limit by a z-test at 3.3 sigma."""
    limit = 22.0
    table = run(tmp_path / "a", {"psnr_db": limit}, scene=small_scene(samples=64))
    for number, row in enumerate(found(table)[:2]):
        assert row.allowed is not None
        axes = [{"path": SHIFT, "values": [row.allowed.value]}]
        scene = small_scene(samples=64, seed=17)
        again = lf.Study(scene, axes=axes, metrics=["psnr"]).run(tmp_path / f"b{number}", workers=0)
        own, other = row.estimates["psnr_db"], again.rows[1].estimates["psnr_db"]
        assert own.value == pytest.approx(limit, abs=0.05)
        assert abs(other.value - limit) < 3.3 * math.hypot(own.stderr, other.stderr)
        assert other.stderr < 1.0


def test_a_pool_finds_the_same_to_the_bit_and_nothing_is_searched_twice(tmp_path: Path) -> None:
    first = run(tmp_path / "a", {"chief_rays_rms_px": 0.3})
    study = lf.Study(small_scene(), axes=first.plan.axes, metrics=["chief_rays"], limits={"chief_rays_rms_px": 0.3})
    study.run(tmp_path / "b", workers=1)
    tables = [(tmp_path / name / "table.csv").read_text() for name in "ab"]
    assert tables[0] == tables[1]
    study.run(tmp_path / "b", workers=0)
    begun = (tmp_path / "b" / "log.jsonl").read_text().count('"begun"')
    assert begun == len(study.plan.points)
    plan = study.plan
    search = plan.search_of(plan.points[-1])
    assert pickle.loads(pickle.dumps(search)) == search


def test_a_reference_beyond_a_limit_allows_no_change() -> None:
    column = Column("light_ratio", "light", worse="low")
    search = Search("path", 2.0, 3.0, {"light_ratio": 1.5})
    allowed = largest_change(search, [column], {"light_ratio": Estimate(1.0, 0.0)}, lambda _: ({}, ""), 4)
    assert allowed == (2.0, 2.0, 2.0, "light_ratio", "")


def test_a_reference_beyond_a_limit_is_said_first(tmp_path: Path) -> None:
    axes = [{"path": SHIFT, "values": [0.05], "label": "array: decentre / mm"}]
    study = lf.Study(small_scene(), axes=axes, metrics=["noise"], limits={"noise": 1e-6})
    progress: list[int] = []

    def heed(message: Warning | str, *_: object, **__: object) -> None:
        # Only the reference is done by then.
        assert progress[-1] == 0
        said.append(str(message))

    said: list[str] = []
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = heed
        study.run(tmp_path, workers=0, progress=lambda now: progress.append(now.done))
    assert [each for each in said if "beyond the limit noise" in each]
    page = (tmp_path / "report.html").read_text()
    assert "The reference camera itself is beyond the limit noise" in page
    assert "array: decentre may not change at all: the reference itself is beyond a limit." in page
    assert "+0 (+0" not in page


@pytest.mark.parametrize(("column", "limit", "valid"), [
    ("chief_rays_rms_px", -0.3, "must be from 0 to inf"), ("ncc", 1.5, "must be from -1 to 1"),
    ("mtf50_lp_per_height", -1.0, "must be from 0 to inf"),
])  # fmt: skip
def test_a_limit_that_no_camera_can_have_is_refused(column: str, limit: float, valid: str) -> None:
    axes = [{"path": SHIFT, "values": [0.05]}]
    with pytest.raises(lf.LfmeshError, match=valid):
        lf.Study(small_scene(), axes=axes, metrics=["chief_rays", "ncc", "mtf50"], limits={column: limit})


def test_a_whole_number_is_no_compensator() -> None:
    adjusted = [{"path": "camera.sensor.pixels[0]", "range": [-2, 2], "metric": "ncc"}]
    axes = [{"path": SHIFT, "values": [0.05]}]
    with pytest.raises(lf.LfmeshError, match="is a whole number"):
        lf.Study(small_scene(), axes=axes, metrics=["ncc"], compensators=adjusted).plan  # noqa: B018


def test_the_interval_is_that_of_the_metrics_error() -> None:
    """A straight line with slope −2 and an error of 0.01 of 4 replicates: Student's 3.182 times 0.005."""
    column = Column("light_ratio", "light", worse="low")
    search = Search("path", 0.0, 1.0, {"light_ratio": 0.5})

    def measured(value: float) -> tuple[dict[str, Estimate], str]:
        return {"light_ratio": Estimate(1.0 - 2.0 * value, 0.01)}, ""

    allowed = largest_change(search, [column], measured(0.0)[0], measured, 4)
    assert allowed.value == pytest.approx(0.25, abs=1e-4)
    assert 0.5 * (allowed.high - allowed.low) == pytest.approx(3.182 * 0.005, rel=0.01)


def test_the_first_of_several_limits_decides() -> None:
    columns = [Column("a", "a", "root", worse="high"), Column("b", "b", worse="low")]
    search = Search("path", 0.0, -1.0, {"a": 0.8, "b": 0.7})

    def measured(value: float) -> tuple[dict[str, Estimate], str]:
        return {"a": Estimate(value**2, 0.0), "b": Estimate(1.0 + 0.5 * value, 0.0)}, ""

    allowed = largest_change(search, columns, measured(0.0)[0], measured, 4)
    assert allowed.column == "b"
    assert allowed.value == pytest.approx(-0.6, abs=1e-3)


LIGHT = Column("light_ratio", "light", worse="low")
UNKNOWN = Estimate(math.nan, math.nan)


def limit_of_a_line(is_known: Callable[[float], bool], far: float = 1.0, error: float = 0.0) -> tuple[Allowed, int]:
    """Search along 1 − 2 x for 0.5, which is at x = 0.25, where some cameras are not known; and count the cameras."""
    measured: list[float] = []

    def measure(value: float) -> tuple[dict[str, Estimate], str]:
        measured.append(value)
        known = is_known(value)
        return {"light_ratio": Estimate(1.0 - 2.0 * value, error) if known else UNKNOWN}, "" if known else "dark"

    search = Search("path", 0.0, far, {"light_ratio": 0.5})
    return largest_change(search, [LIGHT], {"light_ratio": Estimate(1.0, error)}, measure, 4), len(measured)


@pytest.mark.parametrize("hole", [(0.3, 1.0), (0.7, 0.9), (0.26, 0.4), (0.01, 0.2), (0.5, 2.0)])
def test_what_is_not_known_is_gone_round_to_the_limit(hole: tuple[float, float]) -> None:
    found, cameras = limit_of_a_line(lambda x: not hole[0] < x < hole[1])
    assert found.value == pytest.approx(0.25, abs=1e-4)
    assert found.low < 0.25 < found.high
    assert (found.column, found.unknown) == ("light_ratio", "")
    assert found.high - found.low < 1e-3
    assert cameras < 30


@pytest.mark.parametrize("far", [1.0, 0.4])
def test_a_limit_among_what_is_not_known_lies_within_the_interval_and_is_named(far: float) -> None:
    """From 0.2 to 0.5 nothing is known: the limit is neither held there nor reached."""
    found, cameras = limit_of_a_line(lambda x: not 0.2 < x < 0.5, far)
    assert found.unknown == "dark"
    assert found.value == found.low <= 0.2
    assert found.high >= min(0.5, far)
    assert found.column == ("light_ratio" if far > 0.5 else "")
    assert cameras < 30


def test_what_noise_hides_is_no_limit() -> None:
    """At random two of three cameras are not known: in 200 searches, none states an interval without the limit."""
    for seed in range(200):
        draw = random.Random(seed)
        found, cameras = limit_of_a_line(lambda _, draw=draw: draw.random() < 1.0 / 3.0)  # type: ignore[misc]
        assert found.low <= 0.25 <= found.high
        assert cameras < 80


def test_a_known_camera_before_the_unknown_ends_the_interval_unless_its_own_error_reaches_the_limit() -> None:
    sure, unsure = (limit_of_a_line(lambda x: x <= 0.2, error=error)[0] for error in (1e-3, 0.1))
    assert sure.low == sure.value <= 0.2
    assert unsure.low < unsure.value
