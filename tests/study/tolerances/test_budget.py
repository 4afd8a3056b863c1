"""The budget of errors: contributions add up to what cameras with all errors have, and are ranked by their size."""

import re
from pathlib import Path
from typing import Any

import pytest

import lfmesh as lf
from lfmesh.study.sweeps.sentences import budget_rows
from lfmesh.study.sweeps.table import Table
from lfmesh.study.tolerances.budget import Budget, budget_of
from tests.study.studies import SHIFT, small_scene

SHIFT_Y, ASIDE = "camera.mla.pose.shift_mm[1]", "targets[0].position_mm[0]"
MOVED = "chief_rays_rms_px"


def budget(table: Table, name: str = MOVED) -> Budget:
    return budget_of(table, next(column for column in table.columns if column.name == name))


def run(folder: Path, axes: list[dict[str, Any]], **settings: Any) -> Table:
    return lf.Study(small_scene(), axes=axes, **{"metrics": ["chief_rays"], **settings}).run(folder, workers=0)


def test_contributions_add_up_to_that_of_all_errors_together(tmp_path: Path) -> None:
    """Decentres of 0.02 and 0.04 mm (normal) share the mean square 1 : 4, and their sum is that of drawn cameras."""
    axes = [{"path": SHIFT, "normal": (0.0, 0.02)}, {"path": SHIFT_Y, "normal": (0.0, 0.04)}]
    table = run(tmp_path, axes, design="sobol", count=16, limits={MOVED: 0.5})
    found = budget(table)
    assert found.reason == ""
    assert [effect.axis for effect in found.effects] == [1, 0]
    assert all(effect.is_resolved for effect in found.effects)
    assert found.square == pytest.approx(found.drawn, rel=0.02)
    x = [row.point.values for row in table.drawn]
    expected = sum(y**2 for _, y in x) / sum(a**2 + b**2 for a, b in x)
    assert found.share(found.effects[0]).value == pytest.approx(expected, abs=0.02)
    page = (tmp_path / "report.html").read_text()
    assert f"The mean square of chief rays: displacement, rms comes from {SHIFT_Y} " in page
    assert "Budget of chief rays: displacement, rms" in page
    # No camera has one error by itself; the shares of quantities without noise have no error that is seen.
    assert "Which error matters" not in page
    shares = re.findall(r"comes from (.*?)\. All together", page)
    assert shares
    assert not any("±" in each for each in shares)


def test_one_error_at_a_time_gives_the_same_sensitivities(tmp_path: Path) -> None:
    """Displacements are 10.9 pixels a millimetre: their square is quadratic, without a linear part."""
    axes = [{"path": path, "values": [-0.04, -0.02, 0.02, 0.04]} for path in (SHIFT, SHIFT_Y)]
    table = run(tmp_path, axes)
    (per_mm,) = (s.slope.value for s in table.sensitivities() if s.column.name == "chief_rays_x_px" and s.path == SHIFT)
    for effect in budget(table).effects:
        assert effect.quadratic.value == pytest.approx(per_mm**2, rel=1e-3)
        assert abs(effect.linear.value) < 1e-3 * per_mm**2
        limit = effect.predicted(budget(table).column, table.rows[0].means[MOVED], 0.3, 0.04)
        assert limit == pytest.approx(0.3 / per_mm, rel=1e-3)


def test_an_error_without_effect_is_named_as_not_resolved(tmp_path: Path) -> None:
    axes = [{"path": SHIFT, "values": [-0.05, 0.05]}, {"path": ASIDE, "values": [-0.5, 0.5]}]
    table = run(tmp_path, axes, metrics=["psnr"])
    found = budget(table, "psnr_db")
    assert [effect.is_resolved for effect in found.effects] == [True, False]
    assert f"not resolved: {ASIDE}" in (tmp_path / "report.html").read_text()


def test_rounding_of_metrics_without_noise_is_no_effect(tmp_path: Path) -> None:
    """Decentres to either side: no linear part of the square; of what no chief ray meets, no effect."""
    axes = [{"path": SHIFT, "values": [-0.05, 0.05]}, {"path": ASIDE, "values": [-0.5, 0.5]}]
    table = run(tmp_path, axes)
    moved, aside = budget(table).effects
    assert moved.linear == aside.linear == aside.quadratic == (0.0, 0.0)
    assert not aside.is_resolved
    assert all(each.slope.value == 0.0 or abs(each.slope.value) > 1e-6 for each in table.sensitivities())
    assert "e-2" not in " ".join(cell for row in budget_rows(table, budget(table)) for cell in row)


def test_too_few_points_are_said_to_be_so(tmp_path: Path) -> None:
    axes = [{"path": SHIFT, "normal": (0.0, 0.02)}, {"path": SHIFT_Y, "normal": (0.0, 0.04)}]
    table = run(tmp_path, axes, design="latin_hypercube", count=3)
    assert budget(table).reason == "4 points are too few for linear and quadratic sensitivities"
    assert "No budget of chief rays: displacement, rms: 4 points are too few" in (tmp_path / "report.html").read_text()
