"""Lenses of one to six surfaces, drawn by the powers, bendings and gaps of their elements."""

import math
from typing import Any

from tests.random_scenes.draft import Dice, NotDrawnError, Tables, rounded

ELEMENTS = {1: ("thin",), 2: ("singlet",), 3: ("doublet",), 4: ("singlet", "singlet"), 5: ("doublet", "singlet"),
            6: ("singlet", "singlet", "singlet")}  # fmt: skip
"""Elements of a lens by its number of refracting surfaces; 1 is an ideal thin lens."""

STEEPEST = 0.92
"""Sine of the largest slope of a surface at the height of the marginal ray."""


def draw_lens(dice: Dice, surfaces: int, focal_mm: float, f_number: float) -> tuple[list[Tables], list[list[int]]]:
    """Draw a lens with its stop anywhere: its surfaces, and the numbers of those of each element.

    Parameters
    ----------
    dice : Dice
    surfaces : int
        Refracting ones, 1 to 6.
    focal_mm, f_number : float
    """
    if surfaces == 1:
        return [{"paraxial": True, "focal_length_mm": focal_mm, "stop": True}], [[0]]
    kinds = list(ELEMENTS[surfaces])
    dice.draw.shuffle(kinds)
    powers = _powers(dice, len(kinds))
    elements = [_curvatures(dice, kind, power) for kind, power in zip(kinds, powers, strict=True)]
    gaps = [dice.log_between(0.005, 0.3) for _ in kinds]
    margins = [[dice.between(0.01, 0.06) for _ in indices] for _, indices in elements]
    height = 0.55 / f_number
    for _ in range(8):
        lens = _laid_out(elements, gaps, margins, height)
        efl = _focal_length(lens)
        if not 0.05 < efl < 20.0:
            raise NotDrawnError("the lens does not converge")
        elements = [([c * efl for c in curvatures], indices) for curvatures, indices in elements]
    tables, groups = [], []
    for curvature, thickness, index in _laid_out(elements, gaps, margins, height):
        table = {"radius_mm": rounded(focal_mm / curvature) if abs(curvature) > 1e-6 else math.inf}
        table["thickness_mm"] = rounded(thickness * focal_mm)
        if index != 1.0:
            table["index"] = index
        tables.append(table)
    first = 0
    for curvatures, _ in elements:
        groups.append(list(range(first, first + len(curvatures))))
        first += len(curvatures)
    return _with_stop(dice, tables, groups, focal_mm)


def _powers(dice: Dice, count: int) -> list[float]:
    powers = [dice.between(0.5, 1.5) for _ in range(count)]
    if count > 1 and dice.chance(0.4):
        powers[int(dice.draw.integers(count))] *= -0.5
    total = sum(powers)
    if total < 0.2:
        raise NotDrawnError("the lens does not converge")
    return [power / total for power in powers]


def _curvatures(dice: Dice, kind: str, power: float) -> tuple[list[float], list[float]]:
    """Draw the curvatures of an element of a power, in units of the focal length, and the indices of its glasses."""
    bending, index = dice.between(-1.6, 1.6), dice.between(1.4, 1.9)
    front = power * (bending + 1.0) / (2.0 * (index - 1.0))
    if kind == "singlet":
        return [front, front - power / (index - 1.0)], [index]
    of_front, other = power * dice.between(0.8, 2.0), dice.between(1.4, 1.9)
    middle = front - of_front / (index - 1.0)
    return [front, middle, middle - (power - of_front) / (other - 1.0)], [index, other]


def _sag(curvature: float, height: float) -> float:
    if abs(curvature * height) > STEEPEST:
        raise NotDrawnError("a surface of the lens is too steep")
    return curvature * height**2 / (1.0 + math.sqrt(1.0 - (curvature * height) ** 2))


def _laid_out(elements: Any, gaps: list[float], margins: Any, height: float) -> list[tuple[float, float, float]]:
    """Return (curvature, thickness, index) of each surface, so thick that no two meet within the aperture."""
    curvatures = [c for of, _ in elements for c in of]
    indices = [n for _, of in elements for n in (*of, 1.0)]
    extra = [x for margin, gap in zip(margins, gaps, strict=True) for x in (*margin, gap)]
    sags = [_sag(c, 1.1 * height) for c in curvatures]
    depth = [max(0.0, front - back) for front, back in zip(sags, [*sags[1:], 0.0], strict=True)]
    return [(c, d + x, n) for c, d, x, n in zip(curvatures, depth, extra, indices, strict=True)]


def _focal_length(lens: list[tuple[float, float, float]]) -> float:
    """Return the paraxial focal length, by a ray of height 1 along the axis; negative or infinite where it diverges."""
    height, slope, before = 1.0, 0.0, 1.0
    for curvature, thickness, index in lens:
        slope = (before * slope - (index - before) * curvature * height) / index
        height, before = height + thickness * slope, index
    return -1.0 / slope if slope else math.inf


def _with_stop(
    dice: Dice, surfaces: list[Tables], groups: list[list[int]], focal_mm: float
) -> tuple[list[Tables], list[list[int]]]:
    """Put the stop before, between or behind the elements, or on a surface."""
    if dice.chance(0.3):
        surfaces[int(dice.draw.integers(len(surfaces)))]["stop"] = True
        surfaces[-1].pop("thickness_mm")
        return surfaces, groups
    before = int(dice.draw.integers(len(groups) + 1))
    place = groups[before][0] if before < len(groups) else len(surfaces)
    stop = {"stop": True, "thickness_mm": rounded(focal_mm * dice.log_between(0.005, 0.3))}
    surfaces.insert(place, stop)
    surfaces[-1].pop("thickness_mm")
    return surfaces, [[n + (n >= place) for n in group] for group in groups]
