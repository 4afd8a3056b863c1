"""Profiles of revolution in concentric zones, with a formula for each zone, and proven bounds of them.

A point on a border belongs to the zone inside it. The slope may jump there: such a kink makes the second derivative
along the meridian unbounded, on the side of the jump's sign, in every cell with the border inside.
"""

import math
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from lfmesh.optics.bounds import (
    ACROSS,
    ALONG,
    SAG,
    SLOPE,
    Range,
    in_plane,
    on_meridian,
    plus,
    profile_range,
    scaled,
)

Heights = TypeVar("Heights", float, NDArray[np.float64])

_SCALES = {SAG: 0, SLOPE: 1, ACROSS: 2, ALONG: 2}
"""Power of a zone's scale in each quantity."""


class Zone(NamedTuple):
    """A ring of a profile, z(r) = offset + f(scale r), with f the sum of a conic and powers.

    Attributes
    ----------
    inner, outer : float, mm
        Borders; 0 for the innermost, inf for the outermost.
    offset : float
    curvature, conic : float
    powers : sequence of (int, float)
        Exponents, 2 at least, and their coefficients.
    scale : float
    """

    inner: float
    outer: float
    offset: float
    curvature: float
    conic: float
    powers: Sequence[tuple[int, float]]
    scale: float = 1.0

    def sag(self, height: Heights) -> Heights:
        """Return z at heights of either sign; a finite number beyond the end of the conic.

        Parameters
        ----------
        height : float or array, mm
        """
        c, r = self.curvature, self.scale * np.abs(height)
        root = np.sqrt(np.maximum(0.0, 1.0 - (1.0 + self.conic) * c * c * r * r))
        with np.errstate(over="ignore"):
            return self.offset + c * r * r / (1.0 + root) + sum(a * r**power for power, a in self.powers if a)

    def slope(self, height: float) -> float:
        """Return dz/dr at a height of either sign.

        Parameters
        ----------
        height : float, mm
        """
        c, r = self.curvature, self.scale * abs(height)
        root = math.sqrt(max(1e-300, 1.0 - (1.0 + self.conic) * c * c * r * r))
        terms = sum(power * a * r ** (power - 1) for power, a in self.powers)
        return math.copysign(self.scale * (c * r / root + terms), height) if r else 0.0


def joined(inner: Zone, outer: Zone) -> tuple[Zone, Zone]:
    """Return two zones, the outer one shifted so that it continues the inner one without a step."""
    free = outer._replace(offset=0.0)
    return inner, free._replace(offset=float(inner.sag(outer.inner) - free.sag(outer.inner)))


def zone_range(zone: Zone, r: Range, order: int) -> Range:
    """Return the ranges of a zone's formula, or of one of its derivatives, over intervals of the radius.

    Parameters
    ----------
    zone : Zone
    r : (n,) float64 each, mm
    order : int
        SAG, SLOPE, ACROSS or ALONG.
    """
    curvature = np.full_like(r[0], zone.curvature)
    found = profile_range((curvature, curvature), zone.conic, zone.powers, scaled(zone.scale, r), order)
    found = scaled(zone.scale ** _SCALES[order], found)
    return plus(found, (np.full_like(r[0], zone.offset),) * 2) if order == SAG else found


def zones_range(zones: Sequence[Zone], r: Range, order: int) -> Range:
    """Return the ranges of a profile in zones, or of one of its derivatives, over intervals of the radius.

    Parameters
    ----------
    zones : sequence of Zone
        From the axis outwards.
    r : (n,) float64 each, mm
        Inside the reach of the profile.
    order : int
        SAG, SLOPE, ACROSS or ALONG.
    """
    low, high = np.full_like(r[0], np.inf), np.full_like(r[0], -np.inf)
    for zone in zones:
        meets = (r[0] <= zone.outer) & (r[1] >= zone.inner)
        inside = (
            np.where(meets, np.maximum(r[0], zone.inner), zone.inner),
            np.where(meets, np.minimum(r[1], zone.outer), zone.inner),
        )
        part = zone_range(zone, inside, order)
        low, high = np.where(meets, np.minimum(low, part[0]), low), np.where(meets, np.maximum(high, part[1]), high)
    if order == ALONG:
        for border, (least, most) in kinks(zones):
            crosses = (r[0] < border) & (border < r[1])
            low = np.where(crosses & (least < 0.0), -np.inf, low)
            high = np.where(crosses & (most > 0.0), np.inf, high)
    return low, high


def kinks(zones: Sequence[Zone]) -> list[tuple[float, tuple[float, float]]]:
    """Return the radius of each border, mm, and bounds of the jump of the slope there, outwards."""
    found = []
    for inner, outer in pairwise(zones):
        at = np.array([outer.inner])
        before, behind = (zone_range(zone, (at, at), SLOPE) for zone in (inner, outer))
        found.append((outer.inner, (float(behind[0][0] - before[1][0]), float(behind[1][0] - before[0][0]))))
    return found


def zones_on_meridian(zones: Sequence[Zone], height: Range) -> tuple[Range, Range, Range]:
    """Return bounds of a profile in zones at heights of either sign, and of its first and second derivative.

    Parameters
    ----------
    zones : sequence of Zone
    height : (n,) float64 each, mm
        Unbounded heights give unbounded results.
    """
    return on_meridian(partial(zones_range, zones), height)


def zones_in_plane(zones: Sequence[Zone], x: Range, y: Range) -> list[Range]:
    """Return bounds of a profile in zones and of its derivatives, as `revolved_bends` does.

    Parameters
    ----------
    zones : sequence of Zone
    x, y : (n,) float64 each, mm
        Finite.
    """
    return in_plane(partial(zones_range, zones), x, y)
