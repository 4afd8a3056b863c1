"""Ranges of heights and second derivatives of biconics and toroids, from the ranges of their parts.

Scenes and camera geometry use cells in different coordinates but bound the same parts.
"""

from typing import NamedTuple

import numpy as np

from lfmesh.optics.bounds import Range, plus, scaled, times


class BiconicParts(NamedTuple):
    """Parts of a biconic in cells, with the curvatures c_x and c_y, a_x = (1 + k_x) c_x², and a_y likewise.

    Attributes
    ----------
    bulge : Range, mm
        q = c_x x² + c_y y².
    root : Range
        w = √(1 − a_x x² − a_y y²).
    share : Range
        s = 1 / (1 + w). The height is q s.
    first : Range
        s² / w.
    rest : Range, mm
        q s² (2 s + 1/w) / w².
    """

    bulge: Range
    root: Range
    share: Range
    first: Range
    rest: Range

    @property
    def height(self) -> Range:
        """Height q s, mm."""
        return times(self.bulge, self.share)

    def by_square(self, c: float, a: float) -> Range:
        """Return the derivative by x² or by y², c s + a q s² / (2 w), 1/mm.

        Parameters
        ----------
        c, a : float, 1/mm and 1/mm²
        """
        return plus(scaled(c, self.share), scaled(0.5 * a, times(self.bulge, self.first)))

    def second(self, c: float, a: float, square: Range, bent: Range) -> Range:
        """Return the second derivative by x or by y, 2 c s + a (4 c x² + q) s²/w + a² x² q s² (2 s + 1/w) / w², 1/mm.

        Parameters
        ----------
        c, a : float, 1/mm and 1/mm²
        square, bent : Range, mm² and mm
            x², and 4 c x² + q.
        """
        return plus(scaled(2.0 * c, self.share), scaled(a, times(bent, self.first)),
                    scaled(a * a, times(square, self.rest)))  # fmt: skip

    def mixed(self, c: tuple[float, float], a: tuple[float, float]) -> Range:
        """Return the derivative by x and y over x y, 2 (c_x a_y + c_y a_x) s²/w + a_x a_y q s² (2 s + 1/w) / w².

        Parameters
        ----------
        c, a : (float, float), 1/mm and 1/mm²
            Values for x and y.
        """
        return plus(scaled(2.0 * (c[0] * a[1] + c[1] * a[0]), self.first), scaled(a[0] * a[1], self.rest))


def biconic_parts(bulge: Range, dip: Range) -> BiconicParts:
    """Return the parts of a biconic.

    Parameters
    ----------
    bulge, dip : Range, mm and 1
        c_x x² + c_y y² and a_x x² + a_y y².
    """
    w = np.sqrt(np.maximum(1.0 - dip[1], 0.0)), np.sqrt(np.maximum(1.0 - dip[0], 0.0))
    with np.errstate(divide="ignore"):
        s = 1.0 / (1.0 + w[1]), 1.0 / (1.0 + w[0])
        first = s[0] ** 2 / w[1], s[1] ** 2 / w[0]
        second = s[0] ** 2 * (2.0 * s[0] + 1.0 / w[1]) / w[1] ** 2, s[1] ** 2 * (2.0 * s[1] + 1.0 / w[0]) / w[0] ** 2
    return BiconicParts(bulge, w, s, first, times(bulge, second))


def toroid_height(c_x: float, f: Range, x2: Range, u: Range, v: Range) -> Range:
    """Return the height f + c_x x² / (u + v) of a toroid, mm.

    Parameters
    ----------
    c_x : float, 1/mm
    f, x2 : Range, mm and mm²
        Curve f(y), and x².
    u, v : Range
        1 − c_x f and √(u² − c_x² x²).
    """
    with np.errstate(divide="ignore"):
        return plus(f, scaled(c_x, times(x2, (1.0 / (u[1] + v[1]), 1.0 / (u[0] + v[0])))))


def toroid_seconds(c_x: float, along: Range, over: Range, steep2: Range, bend: Range) -> tuple[Range, Range, Range]:
    """Return a toroid's second derivative by x, c_x u² / v³, and two parts of that by y, c_x e² / v and f″ u / v.

    Parameters
    ----------
    c_x : float, 1/mm
    along, over : Range
        u / v and 1 / v.
    steep2 : Range
        e², with e = f′ c_x x / v.
    bend : Range, 1/mm
        f″.
    """
    in_x, turned = (scaled(c_x, times(over, each)) for each in (times(along, along), steep2))
    return in_x, turned, times(bend, along)
