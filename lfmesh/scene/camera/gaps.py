"""Gaps between neighbouring surfaces, proven by bounds of their sags: no crest between samples is overlooked."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from lfmesh.optics.bounds import ACROSS, SAG, Array, Range, first_below, least, plus, profile_range, scaled
from lfmesh.scene.camera.forms import SurfaceShape

ALLOWED_OVERLAP = 1e-9
"""Depth up to which neighbours in contact may overlap in a prescription: over the distance of their vertices plus 1 mm.
"""

ROOM_WITHIN = 1e-6
"""Largest relative distance of the height at which surfaces cross from that up to which they are proven not to."""

Ranges = Callable[[Array, Array], Sequence[Range]]
Signs = tuple[float, float]


def least_gap_mm(
    front: SurfaceShape, back: SurfaceShape, inner_mm: float, outer_mm: float, enough_mm: float = math.inf
) -> tuple[float, float]:
    """Return the least difference of sags, back less front, between two heights, and the height there, mm.

    Parameters
    ----------
    front, back : SurfaceShape
        Neighbours, which do not end before.
    inner_mm, outer_mm : float
    enough_mm : float
        It is not looked for any more closely when none is less.
    """
    ranges_of, low, high = _box(front, back, inner_mm, outer_mm)
    with np.errstate(all="ignore"):
        gap, place = least(ranges_of, low, high, enough_mm, touching_mm(front))
    return gap, math.sqrt(place[0])


def rim_gap_mm(front: SurfaceShape, back: SurfaceShape, front_mm: float, back_mm: float) -> float:
    """Return the least difference of sags, back less front, between rims at heights of their own, at any azimuth, mm.

    Parameters
    ----------
    front, back : SurfaceShape
        Neighbours, which do not end before.
    front_mm, back_mm : float
    """
    if front.form is None and back.form is None:
        return float(back.sag_mm(back_mm) - front.sag_mm(front_mm))
    ranges_of, low, high = _box(front, back, front_mm, front_mm, (back_mm / front_mm) ** 2)
    with np.errstate(all="ignore"):
        return least(ranges_of, low, high, math.inf, touching_mm(front))[0]


def room_mm(front: SurfaceShape, back: SurfaceShape, most_mm: float) -> float:
    """Return the height up to which two neighbours are proven not to cross, `most_mm` at most.

    Parameters
    ----------
    front, back : SurfaceShape
        They do not end before.
    most_mm : float
    """
    ranges_of, low, high = _box(front, back, 0.0, most_mm)
    level = -(front.thickness_mm or 0.0) - touching_mm(front)
    with np.errstate(all="ignore"):
        end = first_below(ranges_of, low, high, level, ROOM_WITHIN)
    if end >= high[0]:
        return most_mm
    return math.sqrt(end)


def touching_mm(front: SurfaceShape) -> float:
    """Return the depth up to which a crossing with the next surface is rounding, mm."""
    return ALLOWED_OVERLAP * (1.0 + (front.thickness_mm or 0.0))


def _box(
    front: SurfaceShape, back: SurfaceShape, inner: float, outer: float, wider: float = 1.0
) -> tuple[Ranges, list[float], list[float]]:
    """Return the bounds of the gap in cells, and the corners of the box of all: r², and the azimuth where it tells.

    The r² of the back is that of the front times `wider`.
    """
    if front.form is None and back.form is None:
        return lambda low, high: _on_circles(front, back, low[:, 0], high[:, 0]), [inner**2], [outer**2]
    symmetric = all(each.form is None or each.form.symmetric for each in (front, back))
    quarters = ((1.0, 1.0),) if symmetric else ((1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0))

    def ranges_of(low: Array, high: Array) -> list[Range]:
        """Return those of the least gap of all quarters."""
        parts = [_in_a_quarter(front, back, low, high, signs, wider) for signs in quarters]
        value, *rates = zip(*parts, strict=True)
        least_of_all = tuple(np.min(ends, axis=0) for ends in zip(*value, strict=True))
        return [least_of_all, *((np.min([r[0] for r in each], axis=0), np.max([r[1] for r in each], axis=0))
                                for each in rates)]  # fmt: skip

    return ranges_of, [inner**2, 0.0], [outer**2, 0.5 * math.pi]


def _on_circles(front: SurfaceShape, back: SurfaceShape, low: Array, high: Array) -> list[Range]:
    """Return bounds of the gap of two surfaces of revolution, and of its derivative, by r².

    What both have in common leaves no part in either.
    """
    r = np.sqrt(low), np.sqrt(high)
    powers = dict(back.powers_mm)
    for power, factor in front.powers_mm:
        powers[power] = powers.get(power, 0.0) - factor
    terms = [(power, factor) for power, factor in powers.items() if factor]
    conics = [(each.curvature_per_mm, each.vertex_conic) for each in (back, front)]
    if conics[0] == conics[1]:
        conics = [(0.0, 0.0)] * 2
    found = []
    for order in (SAG, ACROSS):
        of_back, of_front = (
            profile_range((np.full(len(low), c),) * 2, conic, of, r, order)
            for (c, conic), of in zip(conics, (terms, ()), strict=True)
        )
        found.append(plus(of_back, scaled(-1.0, of_front)))
    return [found[0], scaled(0.5, found[1])]


def _in_a_quarter(
    front: SurfaceShape, back: SurfaceShape, low: Array, high: Array, signs: Signs, wider: float
) -> list[Range]:  # fmt: skip
    """Return bounds of the gap, and of its derivatives by r² and by the azimuth, in cells of one quarter turn."""
    inner, turn = ((low[:, k], high[:, k]) for k in (0, 1))
    # From the y axis to the x axis.
    sine = scaled(signs[0], (np.sin(turn[0]), np.sin(turn[1])))
    cosine = scaled(signs[1], (np.maximum(np.cos(turn[1]), 0.0), np.cos(turn[0])))
    parts = []
    for surface, scale in ((back, wider), (front, 1.0)):
        square = scaled(scale, inner)
        if surface.form is None:
            sag, across = surface.profile_ranges((np.sqrt(square[0]), np.sqrt(square[1])))
            parts.append((sag, scaled(0.5 * scale, across), (np.zeros_like(square[0]),) * 2))
            continue
        sag, out, turned = surface.form.ranges_in(surface, square, sine, cosine)
        # In a mirrored quarter the azimuth runs the other way.
        parts.append((sag, scaled(scale, out), scaled(signs[0] * signs[1], turned)))
    return [plus(of_back, scaled(-1.0, of_front)) for of_back, of_front in zip(*parts, strict=True)]
