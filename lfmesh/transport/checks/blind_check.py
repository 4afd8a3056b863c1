"""Check of an image within its run against blind samples, by blocks of pixels.

In the adjoint method blind samples are not aimed. Few get through the lens, so they reveal only large deficits, the
larger the smaller the stop is; the result states the detectable deficit. Small deficits are found by `aim_proof`, but
blind samples show errors of any cause. A forward image is compared with paths from the pixels, most of them
uninformative.
"""

from dataclasses import dataclass, field
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.transport.aims.mixture import anywhere
from lfmesh.transport.aims.plate_view import NOTHING_SEEN
from lfmesh.transport.tables.tables import AimTables

Array = NDArray[np.float64]

SHARE = 1.0 / 128.0
"""Number of blind samples per sample of the image."""

CHUNK = 4096
"""Blind samples of neighbouring pixels that are traced together."""

GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)

LEVEL = 1e-3
"""Chance that the check fails though nothing is wrong, shared by the blocks (Bonferroni)."""

MOST_BLOCKS = 8
"""Largest number of blocks along each side of the sensor."""

HITS = 80
"""Samples with light that a block should have; with fewer, blocks are made larger."""


def without_aim(aim: AimTables) -> AimTables:
    """Return an aim that sends rays anywhere: into the hemisphere, or, without an array, to all of the lens."""
    return aim._replace(
        entrance=anywhere(aim.entrance),
        exit=anywhere(aim.exit),
        lenslets=aim.lenslets._replace(
            slope_radius2=np.full_like(aim.lenslets.slope_radius2, NOTHING_SEEN), search=0.0
        ),
    )


def first_of_runs(count: int, at_once: int, replicate: int) -> list[int]:
    """Return the first pixel (or packet) of each run that a replicate takes for the check.

    Parameters
    ----------
    count : int
        Total number of pixels (or packets).
    at_once : int
        Length of a run.
    replicate : int
    """
    runs = max(1, round(SHARE * count / at_once))
    places = GOLDEN * (1 + replicate * runs + np.arange(runs)) % 1.0
    return [int(place * max(0, count - at_once + 1)) for place in places]


@dataclass(frozen=True)
class BlindCheck:
    """Comparison of an image with blind samples in blocks of pixels.

    Attributes
    ----------
    blocks : (int, int)
        Rows and columns of blocks on the sensor.
    hits : int
        Number of blind samples that found light.
    worst : float
        Largest difference of any block, in standard errors of both estimates; positive where the image lacks light.
    limit : float
        Difference that any block exceeds by chance with a total probability of 1e-3.
    smallest_deficit : float or None
        Smallest missing share of light that half of the blocks would detect; None: no share.
    """

    blocks: tuple[int, int]
    hits: int
    worst: float
    limit: float
    smallest_deficit: float | None

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "BlindCheck":
        """Return the check from its JSON form."""
        rows, columns = values["blocks"]
        return cls(**values | {"blocks": (rows, columns)})

    @property
    def agrees(self) -> bool:
        """True if all blocks agree."""
        return abs(self.worst) <= self.limit


@dataclass
class BlindSamples:
    """Light that blind samples find during a run.

    Attributes
    ----------
    rows, columns, colours : int
        Pixels of the sensor, and wavelengths.
    """

    rows: int
    columns: int
    colours: int
    values: list[NDArray[np.int64]] = field(default_factory=list)
    found: list[Array] = field(default_factory=list)
    looked_at: list[NDArray[np.int64]] = field(default_factory=list)

    def add(self, pixels: NDArray[np.int64], colour: int, found: Array) -> None:
        """Add estimates of pixels.

        Parameters
        ----------
        pixels : (n,) int64
        colour : int
            Number of the wavelength.
        found : (n,) float64, W
            Light of each pixel, zeros included.
        """
        lit = found > 0.0
        self.values.append(pixels[lit] * self.colours + colour)
        self.found.append(found[lit])
        self.looked_at.append(pixels * self.colours + colour)

    def join(self, other: "BlindSamples") -> None:
        """Add the light found in another replicate."""
        self.values += other.values
        self.found += other.found
        self.looked_at += other.looked_at

    def compared(self, mean: Array, variance: Array, *, all_light: bool = True) -> BlindCheck:
        """Return the comparison with an image.

        Parameters
        ----------
        mean : (rows, columns, wavelengths) float64, W
        variance : (rows, columns, wavelengths) float64, W²
            NaN (unknown) counts as zero.
        all_light : bool
            Blind samples find all light of the image. If not, a lower value is no disagreement.
        """
        nothing = np.zeros(0)
        values = np.concatenate([*self.values, nothing.astype(np.int64)])
        found = np.concatenate([*self.found, nothing])
        looked_at = np.concatenate([*self.looked_at, nothing.astype(np.int64)])
        side = int(np.clip(np.sqrt(len(values) / HITS), 1, MOST_BLOCKS))
        blocks = min(side, self.rows), min(side, self.columns)

        def summed(of: NDArray[np.int64], values: Array) -> Array:
            row, column = np.divmod(of // self.colours, self.columns)
            block = row * blocks[0] // self.rows * blocks[1] + column * blocks[1] // self.columns
            sums: Array = np.bincount(block, values, blocks[0] * blocks[1]).astype(np.float64)
            return sums

        light = mean.reshape(-1)
        blind, squares = summed(values, found), summed(values, found**2)
        pixels, times = np.unique(looked_at, return_counts=True)
        noise = np.nan_to_num(variance.reshape(-1))
        expected, uncertain = summed(pixels, times * light[pixels]), summed(pixels, times**2 * noise[pixels])
        # A block with few hits would underestimate its spread, which is at least that of the expected light.
        typical = squares.sum() / max(blind.sum(), np.finfo(np.float64).tiny)
        own = np.maximum(squares, expected * typical)
        spread = np.sqrt(own + uncertain)
        limit = -NormalDist().inv_cdf(LEVEL / 2.0 / blind.size)
        known = own > 0.0
        z = (blind - expected)[known] / spread[known]
        deficit = np.divide(limit * spread, expected, out=np.full_like(spread, np.inf), where=known & (expected > 0.0))
        worst = float(z[(np.abs(z) if all_light else z).argmax()]) if z.size else 0.0
        worst = worst if all_light else max(worst, 0.0)
        smallest = float(np.median(deficit))
        return BlindCheck(blocks, len(values), worst, limit, smallest if smallest < 1.0 else None)
