"""Paths through the camera as sequences of faces, with refraction or reflection at each.

The faces of a camera are numbered from the object to the sensor: the refracting surfaces of the lens; the two faces of
the array, if any; the two faces of the sensor's cover, if any; the sensor, if it reflects. A ghost with two reflections
is a sequence like the image path, only longer.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

LENS_LEG, ARRAY_LEG, PLANES_LEG = 0, 1, 2
"""Parts of the camera: the lens; the array; the plane faces of the sensor and its cover."""


@dataclass(frozen=True)
class Itinerary:
    """Faces that a path meets, in order.

    Attributes
    ----------
    faces : tuple of int
    reflected : tuple of bool
        True for each face that reflects the path; the others refract it.
    to_sensor : bool
        The path leads from object space to the sensor, as light goes; else from the sensor to object space.
    """

    faces: tuple[int, ...]
    reflected: tuple[bool, ...]
    to_sensor: bool = True

    @property
    def mirrors(self) -> tuple[int, ...]:
        """The faces that reflect the path, in order."""
        return tuple(face for face, mirrors in zip(self.faces, self.reflected, strict=True) if mirrors)

    @property
    def reverse(self) -> "Itinerary":
        """The same path in the opposite direction."""
        return Itinerary(self.faces[::-1], self.reflected[::-1], not self.to_sensor)

    def until(self, face: int) -> "Itinerary":
        """Return the part of a path before a face; before the array's first face, this is the lens part."""
        end = self.faces.index(face) if face in self.faces else len(self.faces)
        return Itinerary(self.faces[:end], self.reflected[:end], self.to_sensor)


@dataclass(frozen=True)
class Leg:
    """Consecutive faces of a path in one part of the camera.

    Attributes
    ----------
    part : int
        `LENS_LEG`, `ARRAY_LEG` or `PLANES_LEG`.
    faces : tuple of int
        Counted within the part, from the object to the sensor.
    reflected : tuple of bool
        True for each face that reflects the path.
    to_sensor : bool
        Direction at the start of the leg.
    """

    part: int
    faces: tuple[int, ...]
    reflected: tuple[bool, ...]
    to_sensor: bool


@dataclass(frozen=True)
class Faces:
    """Number of faces of each part of a camera, from the object to the sensor.

    Attributes
    ----------
    of_lens, of_array, planes : int
    sensor_reflects : bool
        The last of the planes is the sensor, where every detected path ends.
    """

    of_lens: int
    of_array: int
    planes: int
    sensor_reflects: bool

    def paths(self, hollow: Sequence[tuple[int, bool]] = ()) -> Iterator[Itinerary]:
        """Yield the image path and all paths with two reflections, from object space to the sensor.

        Parameters
        ----------
        hollow : sequence of (int, bool)
            As for `two_reflections`.
        """
        ends, total = int(self.sensor_reflects), self.of_lens + self.of_array + self.planes
        for path in (image_path(total), *two_reflections(total, hollow)):
            yield Itinerary(path.faces[: len(path.faces) - ends], path.reflected[: len(path.faces) - ends])

    def part(self, face: int) -> int:
        """Return the part of the camera to which a face belongs."""
        return LENS_LEG if face < self.of_lens else ARRAY_LEG if face < self.of_lens + self.of_array else PLANES_LEG

    def legs(self, path: Itinerary) -> list[Leg]:
        """Return the legs of a path, part by part."""
        begin = {LENS_LEG: 0, ARRAY_LEG: self.of_lens, PLANES_LEG: self.of_lens + self.of_array}
        legs, to_sensor = [], path.to_sensor
        for part, met in groupby(zip(path.faces, path.reflected, strict=True), lambda met: self.part(met[0])):
            faces, reflected = zip(*met, strict=True)
            legs.append(Leg(part, tuple(face - begin[part] for face in faces), reflected, to_sensor))
            to_sensor ^= sum(reflected) % 2 == 1
        return legs


def image_path(faces: int) -> Itinerary:
    """Return the path that is refracted at each of `faces` faces."""
    return Itinerary(tuple(range(faces)), (False,) * faces)


def reflected_at(faces: int, first: int, second: int) -> Itinerary:
    """Return the path reflected back at one face and forth again at an earlier one.

    Parameters
    ----------
    faces : int
        Number of faces of the camera.
    first, second : int
        Reflecting faces in the order that light meets them; `first` > `second`.
    """
    forward, back, on = range(first), range(first - 1, second, -1), range(second + 1, faces)
    return Itinerary(
        (*forward, first, *back, second, *on),
        (*(False for _ in forward), True, *(False for _ in back), True, *(False for _ in on)),
    )


def reflected_twice_at(faces: int, face: int, *, from_behind: bool) -> Itinerary:
    """Return the path with two successive reflections at the concave side of a face.

    Light then runs along the inside of a steep surface: before it or, `from_behind`, after passing through.

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

    Paths that meet a face twice in succession are omitted, except for two reflections at its concave side.

    Parameters
    ----------
    faces : int
        Number of faces of the camera.
    hollow : sequence of (int, bool)
        Faces with a concave side that may be met again at once, and whether that side faces the sensor.
    """
    for first in range(faces):
        for second in range(first):
            yield reflected_at(faces, first, second)
    for face, from_behind in hollow:
        yield reflected_twice_at(faces, face, from_behind=from_behind)
