"""Gaps between neighbouring surfaces, proven by bounds of their sags so that no crest is missed."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from lfmesh.optics.bounds import ACROSS, SAG, Array, Range, first_below, least, plus, profile_range, scaled
from lfmesh.scene.camera.forms import SurfaceShape

ALLOWED_OVERLAP = 1e-9
"""Overlap allowed between touching neighbours of a prescription, relative to their vertex distance plus 1 mm."""

ROOM_WITHIN = 1e-6
"""Largest relative distance between the height of a crossing and the height up to which none is proven."""

Ranges = Callable[[Array, Array], Sequence[Range]]
Signs = tuple[float, float]


def least_gap_mm(
    front: SurfaceShape, back: SurfaceShape, inner_mm: float, outer_mm: float, enough_mm: float = math.inf
) -> tuple[float, float]:
    """Return the smallest difference of sags, back minus front, between two heights, and its height.

    Parameters
    ----------
    front, back : SurfaceShape
        Neighbours that both reach `outer_mm`.
    inner_mm, outer_mm : float
    enough_mm : float
        The search stops once no difference can be smaller than this.
    """
    ranges_of, low, high = _box(front, back, inner_mm, outer_mm)
    with np.errstate(all="ignore"):
        gap, place = least(ranges_of, low, high, enough_mm, touching_mm(front))
    return gap, math.sqrt(place[0])


def rim_gap_mm(front: SurfaceShape, back: SurfaceShape, front_mm: float, back_mm: float) -> float:
    """Return the smallest difference of sags, back minus front, between two rims over all azimuths.

    Parameters
    ----------
    front, back : SurfaceShape
        Neighbours that reach their rims.
    front_mm, back_mm : float
        Heights of the rims.
    """
    if front.form is None and back.form is None:
        return float(back.sag_mm(back_mm) - front.sag_mm(front_mm))
    ranges_of, low, high = _box(front, back, front_mm, front_mm, (back_mm / front_mm) ** 2)
    with np.errstate(all="ignore"):
        return least(ranges_of, low, high, math.inf, touching_mm(front))[0]


def room_mm(front: SurfaceShape, back: SurfaceShape, most_mm: float) -> float:
    """Return the largest height proven free of crossings between two neighbours, at most `most_mm`.

    Parameters
    ----------
    front, back : SurfaceShape
        Neighbours that reach `most_mm`.
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
    """Return the depth of a crossing that counts as rounding."""
    return ALLOWED_OVERLAP * (1.0 + (front.thickness_mm or 0.0))


def _box(
    front: SurfaceShape, back: SurfaceShape, inner: float, outer: float, wider: float = 1.0
) -> tuple[Ranges, list[float], list[float]]:
    """Return the bounds of the gap in cells, and the box's corners in r² and, if it matters, azimuth.

    The r² of the back surface is `wider` times that of the front.
    """
    if front.form is None and back.form is None:
        return lambda low, high: _on_circles(front, back, low[:, 0], high[:, 0]), [inner**2], [outer**2]
    symmetric = all(each.form is None or each.form.symmetric for each in (front, back))
    quarters = ((1.0, 1.0),) if symmetric else ((1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0))

    def ranges_of(low: Array, high: Array) -> list[Range]:
        """Return the bounds of the smallest gap over all quadrants."""
        parts = [_in_a_quarter(front, back, low, high, signs, wider) for signs in quarters]
        value, *rates = zip(*parts, strict=True)
        least_of_all = tuple(np.min(ends, axis=0) for ends in zip(*value, strict=True))
        return [least_of_all, *((np.min([r[0] for r in each], axis=0), np.max([r[1] for r in each], axis=0))
                                for each in rates)]  # fmt: skip

    return ranges_of, [inner**2, 0.0], [outer**2, 0.5 * math.pi]


def _on_circles(front: SurfaceShape, back: SurfaceShape, low: Array, high: Array) -> list[Range]:
    """Return bounds of the gap between two surfaces of revolution, and of its derivative by r².

    Terms that both surfaces share cancel exactly.
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
    """Return bounds of the gap, and of its derivatives by r² and by the azimuth, in cells of one quadrant."""
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
        # In a mirrored quadrant the azimuth runs the other way.
        parts.append((sag, scaled(scale, out), scaled(signs[0] * signs[1], turned)))
    return [plus(of_back, scaled(-1.0, of_front)) for of_back, of_front in zip(*parts, strict=True)]
