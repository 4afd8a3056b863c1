"""Paths through the camera as sequences: the faces that light meets in turn, and at which of them it is reflected.

The faces of a camera are numbered from the object to the sensor: the refracting surfaces of the lens, then the two
faces of the array, if there is one. A ghost of two reflections is a sequence like the image path, only longer.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Itinerary:
    """The faces that a path meets, in order.

    Attributes
    ----------
    faces : tuple of int
    reflected : tuple of bool
        Whether the path is reflected at each of them; else it is refracted.
    to_sensor : bool
        It leads from object space to the sensor, as light goes; else from the sensor to object space.
    """

    faces: tuple[int, ...]
    reflected: tuple[bool, ...]
    to_sensor: bool = True

    @property
    def mirrors(self) -> tuple[int, ...]:
        """The faces that reflect it, in order."""
        return tuple(face for face, mirrors in zip(self.faces, self.reflected, strict=True) if mirrors)

    @property
    def reverse(self) -> "Itinerary":
        """The same path the other way."""
        return Itinerary(self.faces[::-1], self.reflected[::-1], not self.to_sensor)

    def until(self, face: int) -> "Itinerary":
        """Return the part of a path before it first meets a face; for an array, its first face gives the lens' part."""
        end = self.faces.index(face) if face in self.faces else len(self.faces)
        return Itinerary(self.faces[:end], self.reflected[:end], self.to_sensor)


def image_path(faces: int) -> Itinerary:
    """Return the path that is refracted at every one of a number of faces."""
    return Itinerary(tuple(range(faces)), (False,) * faces)


def reflected_at(faces: int, first: int, second: int) -> Itinerary:
    """Return the path that is reflected back at one face and forth again at an earlier one.

    Parameters
    ----------
    faces : int
        Number of faces of the camera.
    first, second : int
        The faces that reflect, in the order in which light meets them; `first` > `second`.
    """
    forward, back, on = range(first), range(first - 1, second, -1), range(second + 1, faces)
    return Itinerary(
        (*forward, first, *back, second, *on),
        (*(False for _ in forward), True, *(False for _ in back), True, *(False for _ in on)),
    )


def reflected_twice_at(faces: int, face: int, *, from_behind: bool) -> Itinerary:
    """Return the path that is reflected twice running at the hollow side of one face.

    Light then runs along the inside of a steep surface: before it, or, `from_behind`, after it has passed through.

    Parameters
    ----------
    faces : int
        Number of faces of the camera.
    face : int
    from_behind : bool
    """
    around = (face, face, face)
    mirrored = (False, True, True) if from_behind else (True, True, False)
    return Itinerary(
        (*range(face), *around, *range(face + 1, faces)), (*(False,) * face, *mirrored, *(False,) * (faces - face - 1))
    )


def two_reflections(faces: int, hollow: Sequence[tuple[int, bool]] = ()) -> Iterator[Itinerary]:
    """Yield all paths from object space to the sensor with two reflections.

    Left out are paths that meet a face again, straight after it, other than by two reflections at its hollow side.

    Parameters
    ----------
    faces : int
        Number of faces of the camera.
    hollow : sequence of (int, bool)
        Faces with a hollow side that may be met again at once, and whether that side looks at the sensor.
    """
    for first in range(faces):
        for second in range(first):
            yield reflected_at(faces, first, second)
    for face, from_behind in hollow:
        yield reflected_twice_at(faces, face, from_behind=from_behind)
