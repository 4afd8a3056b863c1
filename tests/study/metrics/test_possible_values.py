"""Metrics of random cameras: no value is beyond what is possible, with as few packets as can be."""

from pathlib import Path

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.study.metrics.edge_metrics import SHARPEST
from lfmesh.study.metrics.metrics import METRICS
from lfmesh.study.sweeps.statistics import Estimate
from lfmesh.study.sweeps.table import Table
from tests.study.metrics.test_stated_errors import LENSLETS, cameras

NAMES = tuple(name for name in METRICS if name not in ("efficiency", "depth"))
"""All with columns; the camera's lenslets are too few to tell depth."""

RANGES = {
    "camera.mla.pose.shift_mm[0]": (-0.06, 0.06),
    "camera.mla.pose.tilt_deg[0]": (-3.0, 3.0),
    "camera.mla.pose.tilt_deg[2]": (-2.0, 2.0),
    "camera.mla.pose.shift_mm[2]": (-0.2, 0.2),
    "camera.sensor.pose.shift_mm[1]": (-0.1, 0.1),
    "camera.lens.stop_semi_diameter_mm": (1.5, 4.8),
}
"""Far beyond errors of assembly."""

OF_EDGES = ("mtf50", "refocus")
"""Metrics that take seconds."""


def random_cameras(kind: str, count: int, names: tuple[str, ...], folder: Path) -> Table:
    """Return a study of cameras drawn from the ranges, reflections and all, with 2 samples a pixel."""
    draw = np.random.default_rng(count)
    scene = cameras(2)[kind][0].changed({"transport.split": "both", "transport.threads": 1})
    drawn = [{path: float(draw.uniform(*ends)) for path, ends in RANGES.items()} for _ in range(count)]
    return lf.Study([scene, *map(scene.changed, drawn)], metrics=names).run(folder, workers=0)


def impossible(table: Table) -> list[str]:
    """Return the values that cannot be and the errors that are none, in words."""
    wrong = []
    for column in table.columns:
        low, high = column.reach
        if column.name.endswith("pitch_ratio") or column.name == "refocus_mm":
            low = 0.0
        for row, value, error in zip(table.rows, table.values(column.name), table.stderr(column.name), strict=True):
            if column.name.startswith("mtf50"):
                # What samples as wide as a lenslet resolve, to rounding.
                low, high = 0.0, SHARPEST * LENSLETS * (1.0 + 1e-12)
            if not (np.isnan(value) or low <= value <= high) or np.isinf(value) or error < 0.0 or np.isinf(error):
                wrong.append(f"camera {row.point.number}: {column.name} = {value} ± {error}")
    return wrong


def check(table: Table) -> None:
    """Demand that all values are possible, and that each column has some; cameras may show no micro-images."""
    assert not table.failed
    assert all("shows no micro-images" in reason for row in table.rows for reason in row.unknown.values())
    assert impossible(table) == []
    known = {column.name: bool(np.isfinite(table.values(column.name)).any()) for column in table.columns}
    assert [name for name, some in known.items() if not some] == []


def test_noise_brings_no_column_beyond_what_is_possible() -> None:
    """Of 200 random means and errors for each column: a value within its range and an error, or that it is unknown."""
    draw = np.random.default_rng(5)
    for name, metric in METRICS.items():
        for column in metric.columns:
            low, high = column.reach
            for value, error in zip(draw.normal(0.5, 1.0, 200), draw.exponential(0.3, 200), strict=True):
                found = column.estimate(Estimate(float(value), float(error)))
                assert np.isnan(found.value) or low <= found.value <= high, (name, column.name, value, error)
                assert np.isnan(found.stderr) or 0.0 <= found.stderr < np.inf, (name, column.name, value, error)


def test_no_value_of_random_cameras_is_impossible(tmp_path: Path) -> None:
    check(random_cameras("standard", 1, tuple(name for name in NAMES if name not in OF_EDGES), tmp_path))


@pytest.mark.long
@pytest.mark.parametrize("kind", ["standard", "focused"])
def test_no_value_of_200_random_cameras_is_impossible(kind: str, tmp_path: Path) -> None:
    """100 cameras of each kind."""
    check(random_cameras(kind, 100, NAMES, tmp_path))
