"""Glossy surfaces at their limits: smooth, rough, low and high index, at grazing incidence."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.accuracy.hard.outcome import Outcome, case
from lfmesh.kernels.decorators import kernel
from lfmesh.optics.gloss import MARGIN
from lfmesh.scene.objects.targets import LARGEST_ROUGHNESS, SMALLEST_ROUGHNESS, Gloss, Material
from lfmesh.transport.events.scattering import Point, sample
from lfmesh.transport.packets.random import derived, run_key, uniform
from lfmesh.transport.tables.scattering import ScatteringTables, scattering_tables

DRAWN = 20_000
COSINES = (1.0, 0.1, 1e-2, 1e-4, 1e-8)
MOST_SIGMAS = 4.5
"""With twenty values, one is that far off once in 7000 runs."""


@kernel
def _carried(scattering: ScatteringTables, point: Point, x: float, z: float, key: np.uint64, found: NDArray) -> None:  # type: ignore[type-arg]
    """Write the weights (n,) of random directions for light that arrives along (x, 0, z)."""
    for i in range(len(found)):
        own = derived(key, i)
        found[i] = sample(scattering, point, 0, (x, 0.0, z), uniform(own, 0), uniform(own, 1))[3]


@case
def gloss_at_its_ends() -> Outcome:
    """Illuminate glossy white surfaces of extreme roughness, index 1.01 and 4, down to grazing."""
    point = Point(0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0, 1.0)
    carried = np.empty(DRAWN)
    worst, shares = 0.0, []
    for index in (1.01, 4.0):
        for roughness in (SMALLEST_ROUGHNESS, LARGEST_ROUGHNESS):
            white = Material(reflectance=1.0, gloss=Gloss(index=index, roughness=roughness))
            tables = scattering_tables([white], (550.0,))
            for number, cosine in enumerate(COSINES):
                _carried(tables, point, np.sqrt(1.0 - cosine**2), -cosine, run_key(number), carried)
                share, sigma = carried.mean(), carried.std(ddof=1) / np.sqrt(DRAWN)
                off = max(share - 1.0, 1.0 - 2.0 * MARGIN - share, 0.0)
                worst = max(worst, off / sigma if np.isfinite(share) else np.inf)
                shares.append(share)
    rays = float(DRAWN * len(shares))
    return Outcome(
        "", f"a share of 1 to {2.0 * MARGIN:g}", f"{min(shares):.4f} to {max(shares):.4f}, {worst:.1f} σ off",
        bool(worst < MOST_SIGMAS), 0.0, rays, 0,
    )  # fmt: skip
