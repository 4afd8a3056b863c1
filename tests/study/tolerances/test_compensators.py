"""Compensators bring a camera to its best before it is judged, as assembly does."""

from pathlib import Path
from typing import Any

import pytest

import lfmesh as lf
from lfmesh.study.sweeps.table import Table
from tests.study.studies import SHIFT, small_scene

SENSOR_X, SENSOR_Y = (f"camera.sensor.pose.shift_mm[{i}]" for i in (0, 1))
TURN, SENSOR_TURN = "camera.mla.pose.tilt_deg[2]", "camera.sensor.pose.tilt_deg[2]"
MOVED = "chief_rays_rms_px"


def run(folder: Path, axes: list[dict[str, Any]], compensators: list[dict[str, Any]], **settings: Any) -> Table:
    settings = {"metrics": ["chief_rays"], "compensators": compensators, **settings}
    return lf.Study(small_scene(), axes=axes, **settings).run(folder, workers=0)


def test_a_sensor_that_is_moved_along_mends_a_decentred_array(tmp_path: Path) -> None:
    """Centres move by (1 + d/D) of the decentre; so much the sensor follows, and nothing is left of it."""
    axes = [{"path": SHIFT, "values": [-0.05, 0.05]}]
    plain = run(tmp_path / "a", axes, [])
    mended = run(
        tmp_path / "b", axes, [{"path": SENSOR_X, "range": (-0.2, 0.2), "metric": MOVED, "label": "sensor / mm"}]
    )
    for before, after in zip(plain.rows[1:], mended.rows[1:], strict=True):
        moved = before.estimates["chief_rays_x_px"].value * 0.1
        # The last step of the search is a thousandth of half the range.
        assert after.adjusted[0] == pytest.approx(moved, abs=2e-4)
        assert after.estimates[MOVED].value < 0.01 * before.estimates[MOVED].value
    assert mended.rows[0].adjusted == ()
    assert mended.rows[0].estimates == plain.rows[0].estimates
    page = (tmp_path / "b" / "report.html").read_text()
    assert "sensor was adjusted at every camera to the best chief rays: displacement, rms, by " in page
    assert f"adjusted {SENSOR_X}" in (tmp_path / "b" / "table.csv").read_text().splitlines()[0]


def test_neighbours_with_one_metric_are_adjusted_together(tmp_path: Path) -> None:
    """A turned and decentred array: the sensor turns and moves along."""
    axes = [{"path": SHIFT, "values": [0.05]}, {"path": TURN, "values": [1.5]}]
    compensators = [{"path": path, "range": (-2.0, 2.0), "metric": MOVED} for path in (SENSOR_TURN,)]
    compensators += [{"path": path, "range": (-0.2, 0.2), "metric": MOVED} for path in (SENSOR_X, SENSOR_Y)]
    table = run(tmp_path, axes, compensators, design="grid")
    row = table.rows[1]
    assert row.adjusted[0] == pytest.approx(1.5, abs=0.02)
    assert row.estimates[MOVED].value < 0.02


def test_the_largest_change_is_that_of_an_adjusted_camera(tmp_path: Path) -> None:
    """A sensor that can follow by 0.02 mm leaves so much more room for the decentre."""
    axes = [{"path": SHIFT, "values": [0.1]}]
    allowed = []
    for number, compensators in enumerate(([], [{"path": SENSOR_X, "range": (-0.02, 0.02), "metric": MOVED}])):
        table = run(tmp_path / str(number), axes, compensators, limits={MOVED: 0.3})
        allowed.append(table.rows[-1].allowed)
    assert allowed[0] is not None
    assert allowed[1] is not None
    per_mm = 0.3 / allowed[0].value
    assert allowed[1].value - allowed[0].value == pytest.approx(0.02 / 0.1 / per_mm, rel=0.02)


@pytest.mark.parametrize(
    ("compensator", "settings", "why"),
    [
        ({"path": SENSOR_X, "range": (0.1, 0.2), "metric": MOVED}, {}, "must include 0"),
        ({"path": SENSOR_X, "range": (-0.1, 0.2), "metric": "chief_rays"}, {}, "did you mean 'chief_rays_rms_px'"),
        ({"path": "camera.sensor.pose.shft_mm[0]", "range": (-0.1, 0.2), "metric": MOVED}, {}, "mean 'shift_mm'"),
        ({"path": "camera.mla.layout", "range": (-0.1, 0.2), "metric": MOVED}, {}, "not a number"),
        ({"path": SENSOR_X, "range": (-0.1, 0.2), "metric": MOVED}, {"batches": 2}, "batches = 2: must be 1"),
        ({"path": "camera.mla.pitch_mm", "range": (-0.9, 0.0), "metric": MOVED}, {}, "must be above 0"),
    ],
)
def test_what_cannot_be_adjusted_is_refused(compensator: dict[str, Any], settings: dict[str, Any], why: str) -> None:
    axes = [{"path": SHIFT, "values": [0.1]}]
    with pytest.raises(lf.LfmeshError, match=why):
        lf.Study(small_scene(), axes=axes, metrics=["chief_rays"], compensators=[compensator], **settings)
