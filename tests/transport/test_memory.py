"""Memory: film and a fixed pool, whatever the samples."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.peak_memory import PRINT_PEAK, SAYS_PEAK

ROOT = Path(__file__).resolve().parents[2]

RENDER = """
import lfmesh as lf
from lfmesh.assets import asset_path

changes = {{
    "camera.sensor.pixels": [64, 64], "camera.sensor.pixel_mm": 0.125, "transport.replicates": 2,
    "transport.threads": 2, "transport.split": "transmit", "transport.samples": {samples},
}}
lf.render(lf.load(asset_path("scenes/emitting_plane.toml")).changed(changes))
"""

GROWTH_MIB = 32.0
"""Allowed between the renders: what the allocator may differ by, and less than a tenth of what 500,000 packets hold."""


@pytest.mark.skipif(not SAYS_PEAK, reason="the system says no peak of a program alone")
def test_peak_memory_does_not_grow_with_samples() -> None:
    # The smaller render already fills whole chunks.
    peaks = []
    for samples in (16, 144):
        child = subprocess.run(
            [sys.executable, "-c", RENDER.format(samples=samples) + PRINT_PEAK],
            env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=True,
        )  # fmt: skip
        peaks.append(int(child.stdout) / 1024)
    assert peaks[1] - peaks[0] < GROWTH_MIB
