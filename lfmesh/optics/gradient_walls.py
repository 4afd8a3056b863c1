"""Rays through gradient-index glass to the first of the walls around it: faces, and an edge or the sides of a cell.

A march in steps of a given length finds the first wall that a ray crosses. Signs at the ends of a step show a crossing
in it. So does the closest approach within a step, where the distance from a wall turns from falling to rising. Then
equal steps from the start end on the wall, as in `gradient_path`.
"""

from typing import Any

import numpy as np

from lfmesh.kernels.decorators import kernel
from lfmesh.optics.gradient_path import NEAR, GradientRay, advance, corrector, drift, kicker
from lfmesh.optics.gradients import field_at

NO_WALL = -1
"""In place of the number of a wall: the ray stays in the glass."""

MOST_LENGTHS = 8
"""Steps of a march, over the usual number, after which a ray counts as staying in the glass."""

APPROACHES, CLOSE = 6, 0.5
"""Trials of the closest approach to a wall within a step, by regula falsi. They are left out if the parabola through
the rates shows that a ray keeps more than this share of its smaller distance from the wall at the ends."""

CROSSINGS, SETTLED = 40, 1e-10
"""Most trials of a crossing within a step, and the change of σ, over that of the step, that ends them."""

MOST_TRIALS = 10
"""Trials of equal steps to a wall. The march gives the length to its own accuracy, so one or two suffice."""


def wall_finder(count: int, clearance_at: Any) -> Any:
    """Make the kernel that finds the first wall on a ray's way through gradient-index glass.

    Parameters
    ----------
    count : int
        Number of walls.
    clearance_at : kernel
        Called as ``clearance_at(walls, wall, ray)`` for the walls 0 to `count` − 1; returns a function that is above 0
        in the glass and 0 on the wall, and its rate along T. The function may be inf: there is no such wall.

    Returns
    -------
    find_wall : kernel
    """

    @kernel
    def closest(
        field: Any, number: int, walls: Any, wall: int, before: GradientRay, step: float, at_end: tuple[float, float]
    ) -> tuple[float, float]:
        """Return where within a step a ray is closest to a wall, and the clearance there.

        Parameters
        ----------
        field, number, walls, wall
            As for `find_wall`.
        before : GradientRay
            At the step's beginning, where the clearance falls.
        step : float, mm
        at_end : (2,) float
            Clearance, and its positive change per step, at the end.
        """
        clearance, low_rate = clearance_at(walls, wall, before)
        low, high, low_rate, high_rate = 0.0, 1.0, step * low_rate, at_end[1]
        place = -low_rate / (high_rate - low_rate)
        least = min(clearance + 0.5 * place * low_rate, at_end[0] - 0.5 * (1.0 - place) * high_rate)
        if least > CLOSE * min(clearance, at_end[0]):
            return place, least
        for _ in range(APPROACHES):
            clearance, rate = clearance_at(walls, wall, advance(field, number, before, place * step, 1))
            if clearance <= 0.0:
                break
            if rate < 0.0:
                low, low_rate = place, step * rate
            else:
                high, high_rate = place, step * rate
            if not high_rate > low_rate:
                break
            place = low - (high - low) * low_rate / (high_rate - low_rate)
        return place, clearance

    @kernel
    def crossing(
        field: Any, number: int, walls: Any, wall: int, before: GradientRay, after: GradientRay, step: float
    ) -> tuple[bool, float]:
        """Return whether a ray crosses a wall in a step, and the place in the step, 0 to 1.

        Parameters
        ----------
        field, number, walls, wall
            As for `find_wall`.
        before, after : GradientRay
            At the step's beginning and end. A ray that begins on a wall leaves it.
        step : float, mm
        """
        begin, begin_rate = clearance_at(walls, wall, before)
        end, end_rate = clearance_at(walls, wall, after)
        begin_rate, end_rate, high = step * begin_rate, step * end_rate, 1.0
        if not begin < np.inf:
            return False, 0.0
        if end > 0.0:
            if not (begin > 0.0 and begin_rate < 0.0 and end_rate > 0.0):
                return False, 0.0
            high, end = closest(field, number, walls, wall, before, step, (end, end_rate))
            if end > 0.0:
                return False, 0.0
        elif not end <= 0.0:
            return False, 0.0
        low, place = 0.0, begin / (begin - end) if begin > 0.0 else 0.0
        if begin_rate > 0.0:
            # From a wall the clearance begins like a parabola.
            place = max(place, begin_rate / (begin_rate - end))
        place *= high
        for _ in range(CROSSINGS):
            clearance, rate = clearance_at(walls, wall, advance(field, number, before, place * step, 1))
            if clearance > 0.0:
                low = place
            else:
                high = place
            following = place - clearance / (step * rate)
            if not low < following < high:
                following = 0.5 * (low + high)
            settled = abs(following - place) <= SETTLED
            place = following
            if settled:
                break
        return True, place

    @kernel
    def find_wall(
        field: Any, number: int, ray: GradientRay, walls: Any, step: float, count_of_steps: int
    ) -> tuple[int, GradientRay, float]:
        """Return the first wall that a ray crosses, or `NO_WALL`; the ray there; and its length in σ, mm.

        A ray that turns back may cross the wall that it comes from.

        Parameters
        ----------
        field, number : Any
            Passed to `gradients.field_at`.
        ray : GradientRay
            In the glass or on a wall.
        walls : Any
            Passed to `clearance_at`.
        step : float, mm
            Length of a step in σ.
        count_of_steps : int
            Usual number of steps from wall to wall.
        """
        for wall in range(count):
            clearance, rate = clearance_at(walls, wall, ray)
            if clearance <= 0.0 and rate < 0.0:
                return wall, ray, 0.0
        before, most = ray, MOST_LENGTHS * count_of_steps
        for taken in range(most):
            after = advance(field, number, before, step, 1)
            first, at = NO_WALL, 1.0
            for wall in range(count):
                crosses, place = crossing(field, number, walls, wall, before, after, step)
                if crosses and (first == NO_WALL or place < at):
                    first, at = wall, place
            if first != NO_WALL:
                return first, advance(field, number, before, at * step, 1), (taken + at) * step
            if not abs(after.x + after.y + after.z) < np.inf:
                return NO_WALL, before, taken * step
            before = after
        return NO_WALL, before, most * step

    return find_wall


def lander(height_at: Any) -> Any:
    """Make the kernel that takes equal steps to a face near the end of a ray of known length.

    Parameters
    ----------
    height_at : kernel
        As in `gradient_path.tracer`.

    Returns
    -------
    land : kernel
    """
    kick, correction = kicker(field_at), corrector(height_at)

    @kernel
    def land(
        field: Any, number: int, start: GradientRay, face: Any, length: float, steps: int
    ) -> tuple[bool, GradientRay, float]:
        """Return whether equal steps end on a face, the ray there, and its length in σ, mm.

        Parameters
        ----------
        field, number : Any
            Passed to `gradients.field_at`.
        start : GradientRay
        face : Any
            Passed to `height_at`.
        length : float, mm
            Approximate length in σ, above 0.
        steps : int
        """
        for _ in range(MOST_TRIALS):
            end = advance(field, number, start, length / steps, steps)
            _, kick_x, kick_y, kick_z = field_at(field, number, end.x, end.y, end.z)
            change = correction(face, end, kick_x, kick_y, kick_z)
            if abs(change) <= NEAR * length:
                half = drift(end, 0.5 * change)
                return True, drift(kick(field, number, half, change), 0.5 * change), length + change
            length += change
            if not 0.0 < length < np.inf:
                break
        return False, start, 0.0

    return land
