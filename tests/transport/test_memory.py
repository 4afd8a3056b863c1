"""Memory: film and a fixed pool, whatever the samples."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

RENDER = """
import lfmesh as lf
from lfmesh.assets import asset_path

changes = {{
    "camera.sensor.pixels": [64, 64], "camera.sensor.pixel_mm": 0.125, "transport.replicates": 2,
    "transport.threads": 2, "transport.split": "transmit", "transport.samples": {samples},
}}
lf.render(lf.load(asset_path("scenes/emitting_plane.toml")).changed(changes))
with open("/proc/self/status") as status:
    print(next(line.split()[1] for line in status if line.startswith("VmHWM")))
"""

GROWTH_MIB = 32.0
"""Allowed between the renders: what the allocator may differ by, and less than a tenth of what 500,000 packets hold."""


@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="the system says no peak of a program alone")
def test_peak_memory_does_not_grow_with_samples() -> None:
    # The smaller render already fills whole chunks.
    peaks = []
    for samples in (16, 512):
        child = subprocess.run(
            [sys.executable, "-c", RENDER.format(samples=samples)],
            env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, check=True,
        )  # fmt: skip
        peaks.append(int(child.stdout) / 1024)
    assert peaks[1] - peaks[0] < GROWTH_MIB
