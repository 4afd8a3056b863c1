"""A tolerance budget: the share of cameras that keep a limit, and the errors that break it by themselves."""

import math
from pathlib import Path

import pytest
from scipy.stats import binom, norm

import lfmesh as lf
from lfmesh.study.sweeps.statistics import share_of
from tests.study.studies import SHIFT, small_scene

TURN = "camera.mla.pose.tilt_deg[2]"


def test_the_interval_of_a_share_holds_it_as_often_as_it_says() -> None:
    """Clopper and Pearson's is never below 95 %: summed over all outcomes of 40 trials."""
    for truth in (0.02, 0.3, 0.5, 0.97):
        held = sum(
            binom.pmf(good, 40, truth)
            for good in range(41)
            if share_of(good, 40).low <= truth <= share_of(good, 40).high
        )
        assert held >= 0.95
    assert share_of(0, 40).low == 0.0
    assert share_of(40, 40).high == 1.0


def test_the_yield_is_that_of_the_distribution(tmp_path: Path) -> None:
    """Centres shift by (1 + d/D)/pixel times a normal decentre: the share below a limit is known."""
    scene, sigma, limit_px = small_scene(), 0.02, 0.25
    axes = [{"path": SHIFT, "normal": (0.0, sigma)}]
    study = lf.Study(
        scene, axes=axes, design="sobol", count=32, metrics=["chief_rays"], limits={"chief_rays_rms_px": limit_px}
    )
    table = study.run(tmp_path, workers=0)
    found = table.yield_share()
    assert found is not None
    # Pixels for each mm, from the study's own sensitivity.
    (per_mm,) = (each for each in table.sensitivities() if each.column.name == "chief_rays_x_px")
    reach = limit_px / per_mm.slope.value / sigma
    expected = 2.0 * norm.cdf(reach) - 1.0
    assert 0.3 < expected < 0.95
    # Sobol' points in one dimension cover the distribution to 1/32 on either side.
    assert math.isclose(found.value, expected, abs_tol=2.0 / 32.0)
    assert found.low < expected < found.high
    assert f"Yield: {found.good} of 32 cameras" in (tmp_path / "report.html").read_text()


def test_errors_that_break_a_limit_by_themselves_are_named(tmp_path: Path) -> None:
    axes = [{"path": SHIFT, "values": [-0.08, -0.05, 0.01, 0.06]}, {"path": TURN, "values": [0.01]}]
    study = lf.Study(small_scene(), axes=axes, metrics=["chief_rays"], limits={"chief_rays_rms_px": 0.3})
    table = study.run(tmp_path, workers=0)
    assert table.breaking() == [(SHIFT, -0.05)]
    assert table.yield_share() is None
    assert "is broken at 3 of 5 cameras" in (tmp_path / "report.html").read_text()


def test_a_limit_of_what_is_not_measured_is_refused() -> None:
    with pytest.raises(lf.LfmeshError, match=r"did you mean 'psnr_db'"):
        lf.Study(small_scene(), axes=[{"path": SHIFT, "values": [0.1]}], metrics=["psnr"], limits={"psnr": 30.0})
