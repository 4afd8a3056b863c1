"""Object distances along a range of image points, as ratios, so that infinity needs no special case.

T and F are the matrices from the first vertex to the stop and on to behind the last vertex, M = F T, and n is the index
before the lens. Behind it i, D and t are reduced distances, over the index there. The ray through the centre of the
stop with slope 1 meets a plane, i behind the last vertex and D behind the exit pupil, at the height h = F_b + i F_d. An
image point for which views u apart on the exit pupil shift by u t / D on that plane has the object distance

    x = −n ((M_b + M_d i) h − t T_b) / ((M_a + M_c i) h − t T_a).

No term is infinite, even for a telecentric or afocal lens or an image point in the exit pupil. x falls as t grows: its
derivative is −n h² over the square of the denominator.
"""

import math
from typing import NamedTuple

from lfmesh.scene.first_order.paraxial import ROUNDED, Paraxial, quotient

NOTHING = math.inf, math.inf
"""Near and far end of a range without real objects."""


class Conjugates(NamedTuple):
    """Object distances (p + q t) / (r + s t), which fall as t grows; positive or infinite for real objects.

    Attributes
    ----------
    p, q, r, s : float
    least, most : float
        Range of t; images beyond its ends would have to pass through infinity.
    """

    p: float
    q: float
    r: float
    s: float
    least: float = -math.inf
    most: float = math.inf

    def object_mm(self, t: float) -> float:
        """Return the object distance at t; negative for a virtual object."""
        return quotient(_sum(self.p, self.q * t), _sum(self.r, self.s * t))

    def real(self, low: float, high: float) -> tuple[float, float] | None:
        """Return the part of a range of t with real objects, or None.

        As t grows, real objects fill one stretch, from infinity to the first vertex. If it passes through t = ∞ and
        covers two parts of the range, the one nearer to the middle is returned.

        Parameters
        ----------
        low, high : float
        """
        middle = 0.5 * (low + high)
        low, high = max(low, self.least), min(high, self.most)
        if self.q == self.s == 0.0 and not self.object_mm(middle) > 0.0:
            return None
        farthest = -self.r / self.s if self.s else -math.inf
        nearest = -self.p / self.q if self.q else math.inf
        if farthest < nearest:
            parts = [(max(low, farthest), min(high, nearest))]
        else:
            parts = [(low, min(high, nearest)), (max(low, farthest), high)]
        parts = [part for part in parts if part[0] <= part[1]]
        return min(parts, key=lambda part: max(part[0] - middle, middle - part[1]), default=None)

    def between_mm(self, low: float, high: float) -> tuple[float, float]:
        """Return the nearest and farthest distance of real objects in a range of t.

        Parameters
        ----------
        low, high : float
            As in `real`.

        Returns
        -------
        near_mm, far_mm : float
            `NOTHING` if there is no real object.
        """
        part = self.real(low, high)
        if part is None:
            return NOTHING
        near, far = (self.object_mm(end) for end in reversed(part))
        # Rounding may put an end at infinity, or at the first vertex, just beyond it.
        near = near if near > 0.0 else 0.0
        return near, far if far >= near else math.inf


def along_shifts(lens: Paraxial, image_mm: float) -> Conjugates:
    """Return the object distances along the shift t, in mm, of a plane behind the last vertex."""
    to_stop, whole = lens.to_stop, lens.whole
    index, height, behind = lens.indices[0], lens.chief_height_mm(image_mm), lens.image_index
    if height == 0.0:
        # The plane is the exit pupil: all its views show only the entrance pupil.
        return Conjugates(p=-index * to_stop.b, q=0.0, r=to_stop.a, s=0.0)
    infinite = behind * quotient(height, lens.from_stop.d)
    return Conjugates(
        p=-index * (whole.b + whole.d * (image_mm / behind)) * height,
        q=index * to_stop.b / behind,
        r=lens.magnification_onto(image_mm) * height,
        s=-to_stop.a / behind,
        least=infinite if infinite < 0.0 else -math.inf,
        most=infinite if infinite >= 0.0 else math.inf,
    )


def along_images(lens: Paraxial, image_mm: float) -> Conjugates:
    """Return the object distances along the distance t, in mm, of image points behind a plane.

    Parameters
    ----------
    lens : Paraxial
    image_mm : float
        Distance of the plane behind the last vertex.
    """
    whole, index, behind = lens.whole, lens.indices[0], lens.image_index
    return Conjugates(
        p=-index * (whole.b + whole.d * (image_mm / behind)),
        q=-index * whole.d / behind,
        r=lens.magnification_onto(image_mm),
        s=whole.c / behind,
    )


def along_depths(lens: Paraxial, lenslets_mm: float, to_sensor_mm: float, per_depth: float) -> Conjugates:
    """Return the object distances along the inverse virtual depth t, for image points d/t before the lenslets.

    Parameters
    ----------
    lens : Paraxial
    lenslets_mm : float
        Distance of the lenslets behind the last vertex.
    to_sensor_mm : float
        Distance d from the lenslets to the sensor, in the medium around them.
    per_depth : float
        t of the plane in focus.
    """
    whole, index = lens.whole, lens.indices[0]
    to_lenslets, to_sensor = (each / lens.image_index for each in (lenslets_mm, to_sensor_mm))
    return Conjugates(
        p=index * whole.d * to_sensor,
        q=-index * (whole.b + whole.d * to_lenslets),
        r=-whole.c * to_sensor,
        s=lens.magnification_onto(lenslets_mm),
        least=0.0 if per_depth > 0.0 else -math.inf,
        most=0.0 if per_depth <= 0.0 else math.inf,
    )


def _sum(first: float, second: float) -> float:
    """Add, returning 0 for a sum that is only rounding."""
    total = first + second
    return 0.0 if abs(total) <= ROUNDED * max(abs(first), abs(second)) else total
