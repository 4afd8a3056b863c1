"""Off-axis surfaces: moves of the local frame along a prescription, and the resulting elements.

Lens files place each surface in the frame left by the surfaces before it: thicknesses advance it along its z axis, and
moves shift and rotate it between surfaces. An lfmesh lens has one axis, and groups of surfaces with a pose.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lfmesh.scene.camera.lens import Element
from lfmesh.scene.pose import Pose

Array = NDArray[np.float64]

SAME = 1e-12
"""Largest difference of equal frames (rounding): of direction, and of position as a fraction of the lens's length."""

_DIGITS = 12
"""Decimal places of written angles (degrees) and shifts; further ones are rounding errors."""


@dataclass(frozen=True)
class Move:
    """Move of the frame of the surfaces, lengths in the file's unit.

    Attributes
    ----------
    shift : (3,) tuple of float
        Shift of the origin along the axes before the rotation.
    turn : Rotation
    """

    shift: tuple[float, float, float]
    turn: Rotation

    @classmethod
    def shifted_then_tilted(cls, shift: Sequence[float], tilt_deg: Sequence[float]) -> "Move":
        """Return a shift, then right-handed rotations about the frame's own x, y and z axes in this order."""
        x, y, z = shift
        return cls((x, y, z), Rotation.from_euler("XYZ", tilt_deg, degrees=True))

    @classmethod
    def tilted_then_shifted(cls, shift: Sequence[float], tilt_deg: Sequence[float]) -> "Move":
        """Return rotations about the frame's own z, y and x axes in this order, then a shift along the new axes."""
        turn = Rotation.from_euler("ZYX", tilt_deg[::-1], degrees=True)
        x, y, z = turn.apply(shift)
        return cls((float(x), float(y), float(z)), turn)

    @property
    def inverse(self) -> "Move":
        """Inverse move."""
        back = self.turn.inv()
        x, y, z = -back.apply(self.shift)
        return Move((float(x), float(y), float(z)), back)


@dataclass(frozen=True)
class Place:
    """Frame of a surface relative to the object's, lengths in one unit.

    Attributes
    ----------
    vertex : (3,) float64
    turn : Rotation
    """

    vertex: Array
    turn: Rotation

    def moved(self, move: Move) -> "Place":
        """Return the frame after a move."""
        return Place(self.vertex + self.turn.apply(move.shift), self.turn * move.turn)

    def along(self, distance: float) -> "Place":
        """Return the frame moved along its z axis."""
        return Place(self.vertex + self.turn.apply((0.0, 0.0, distance)), self.turn)

    def on_axis(self, length: float) -> bool:
        """Tell whether this frame differs from the object's only by a shift along z.

        Parameters
        ----------
        length : float
            Length of the lens.
        """
        return self.turn.magnitude() <= SAME and float(np.hypot(*self.vertex[:2])) <= SAME * length

    def continues(self, other: "Place", length: float) -> bool:
        """Tell whether another frame lies on this one's z axis, equally oriented."""
        apart = self.turn.inv().apply(other.vertex - self.vertex)
        turned = (self.turn.inv() * other.turn).magnitude()
        return bool(turned <= SAME and float(np.hypot(*apart[:2])) <= SAME * length)


START = Place(np.zeros(3), Rotation.identity())
"""Frame of the first surface after the object."""


def straightened(places: Sequence[Place], sums: Sequence[float]) -> tuple[list[float], list[Element]]:
    """Return the axial positions of the surfaces without their poses, and the elements with their poses.

    Parameters
    ----------
    places : sequence of Place
        Frames of the surfaces, mm.
    sums : sequence of float
        Summed thicknesses up to each surface, mm: they set the spacing before off-axis groups.
    """
    length = max(1.0, *(float(np.linalg.norm(place.vertex)) for place in places))
    groups: list[list[int]] = []
    for number, place in enumerate(places):
        if not place.on_axis(length):
            joins = groups and groups[-1][-1] == number - 1 and places[number - 1].continues(place, length)
            groups[-1].append(number) if joins else groups.append([number])
    inside = {number for group in groups for number in group[1:]}
    vertices: list[float] = []
    for number, place in enumerate(places):
        z = float(place.vertex[2])
        if number in inside:
            z = vertices[-1] + float(places[number - 1].turn.inv().apply(place.vertex - places[number - 1].vertex)[2])
        elif vertices and not place.on_axis(length):
            z = vertices[-1] + max(0.0, sums[number] - sums[number - 1])
        elif not place.on_axis(length):
            z = sums[0]
        vertices.append(z)
    return vertices, [_element(group, places[group[0]], vertices[group[0]]) for group in groups]


def gaps(vertices: Sequence[float]) -> list[float]:
    """Return the distances between neighbours."""
    return [back - front for front, back in pairwise(vertices)]


def _element(group: list[int], first: Place, vertex: float) -> Element:
    """Return a group with the pose that moves its first vertex from the axis into place."""
    x, y, z = np.round(first.vertex - [0.0, 0.0, vertex], _DIGITS) + 0.0
    about_x, about_y, about_z = np.round(first.turn.as_euler("xyz", degrees=True), _DIGITS) + 0.0
    pose = Pose(shift_mm=(float(x), float(y), float(z)), tilt_deg=(float(about_x), float(about_y), float(about_z)))
    return Element(surfaces=tuple(group), pose=pose)


def move_of(element: Element) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return an element's shift, mm, and tilts about its own x, y and z axes in turn, degrees.

    Parameters
    ----------
    element : Element
    """
    x, y, z = Rotation.from_euler("xyz", element.pose.tilt_deg, degrees=True).as_euler("XYZ", degrees=True) + 0.0
    return element.pose.shift_mm, (float(x), float(y), float(z))
