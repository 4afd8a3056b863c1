"""The main lens: a list of surfaces, from the object to the sensor."""

from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import ClassVar

from pydantic import Field

from lfmesh.optics.glass import Medium
from lfmesh.scene.camera.element import Element
from lfmesh.scene.camera.file_choices import AS_IT_STANDS, FILE_CHOICES, FileChoices
from lfmesh.scene.camera.gap_faults import gap_faults
from lfmesh.scene.camera.gaps import least_gap_mm, rim_gap_mm, touching_mm
from lfmesh.scene.camera.surface import Surface
from lfmesh.scene.literals import at_least
from lfmesh.scene.materials.coatings import UNCOATED, Coating
from lfmesh.scene.materials.finishes import POLISHED
from lfmesh.scene.materials.matter import Matter
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.quantities import (
    Count,
    GlassName,
    Index,
    Positive,
    Text,
)

__all__ = ["AS_IT_STANDS", "FILE_CHOICES", "STOP_SIZES", "Element", "FileChoices", "Lens", "Surface"]
STOP_SIZES = ("stop_semi_diameter_mm", "f_number", "epd_mm")
"""Keys that size the stop in place of the prescription."""
_EDIT = "to change the surfaces of a lens file, convert it (lfmesh lens convert {} lens.toml) and edit the copy"


class Lens(Model):
    """The main lens, given by its prescription or by a file."""

    elsewhere: ClassVar[Mapping[str, str]] = {
        "coating": "it belongs to a surface: surfaces = [{ ..., coating = ... }]; " + _EDIT.format("lib:tessar_50mm")
    }

    file: Text | None = None
    """Lens file (.toml, .zmx, .seq, .len, .json, .csv), relative to the scene file, or "lib:" and a name of the
    library. It replaces `surfaces`; the library comes with lfmesh. A TOML file has the keys of this table (name,
    source, surfaces, ...). The other files are Zemax's, CODE V's, OSLO's, optiland's, or a table of surfaces."""
    substitutes: dict[Text, GlassName | Index] = Field(default_factory=dict)
    """Catalogue glass or index for a glass name in the file: { BK7 = "SCHOTT/N-BK7" }."""
    configuration: Count | None = None
    """Number of the file's configuration, from 1. Omitted: as the file's surfaces stand."""
    coating_file: Text | None = None
    """Zemax coating file for a .zmx file, relative to the scene file. Omitted: the one beside the lens file."""
    gradient_files: tuple[Text, ...] = ()
    """Zemax's files of gradient-index materials for a .zmx file (SGRIN.DAT, GRADIENT_9.DAT, PROFILE.GRD), relative to
    the scene file. Omitted: the ones beside the lens file."""
    name: Text | None = None
    """Name of the lens."""
    source: Text | None = None
    """Publication of the prescription."""
    surfaces: tuple[Surface, ...] = ()
    """The surfaces, from the object to the sensor; the first vertex is the origin of the camera frame. Or give
    `file`."""
    stop_semi_diameter_mm: Positive | None = None
    """Radius of the aperture stop, in mm. Or give `f_number` or `epd_mm`. Omitted: that of the prescription."""
    f_number: Positive | None = None
    """Focal length over entrance pupil diameter (no unit), which sets the radius of the stop. The focal length is one
    over the power, whatever the media on both sides."""
    epd_mm: Positive | None = None
    """Diameter of the entrance pupil, in mm, which sets the radius of the stop."""
    elements: tuple[Element, ...] = ()
    """Rigid groups of surfaces with a pose of their own: tilted and decentred elements."""
    coatings: dict[str, Coating] = Field(default_factory=dict)
    """Coatings of the lens, by the name that its surfaces use, in addition to the coatings of the scene."""
    object_medium: Matter | None = None
    """Medium before the first surface that the lens is designed for, such as { index = 1.333 }. A scene's
    `camera.object_medium` overrides it. Omitted: air."""

    def __hash__(self) -> int:
        values = (frozenset(value.items()) if isinstance(value, dict) else value for _, value in self)
        return hash(tuple(values))

    @property
    def file_choices(self) -> FileChoices:
        """Options for reading its file."""
        return FileChoices(**{key: getattr(self, key) for key in FILE_CHOICES})

    @property
    def media(self) -> tuple[Medium, ...]:
        """Medium before the first surface, then behind each surface.

        A flat first surface that is a stop without a given medium stands in the object medium.
        """
        outside = self.object_medium.medium if self.object_medium is not None else None
        behind = [surface.medium for surface in self.surfaces]
        if behind and self.surfaces[0].is_plain_stop:
            behind[0] = outside
        return outside, *behind

    @property
    def stop_index(self) -> int | None:
        """Number of the stop surface, or None if none is marked."""
        return next((i for i, surface in enumerate(self.surfaces) if surface.stop), None)

    @property
    def vertices_mm(self) -> tuple[float, ...]:
        """Z of every surface's vertex in the camera frame."""
        z = [0.0]
        for surface in self.surfaces[:-1]:
            z.append(z[-1] + (surface.thickness_mm or 0.0))
        return tuple(z)

    @property
    def last_interface(self) -> int:
        """Number of the last surface that is not only a stop; 0 if there is none."""
        number = len(self.surfaces) - 1
        while number > 0 and self.is_pure_stop(number):
            number -= 1
        return max(number, 0)

    def has_glass_behind(self, number: int) -> bool:
        """Return whether glass of the lens follows surface `number`, rather than air or the medium outside.

        Parameters
        ----------
        number : int
            From 0.

        Returns
        -------
        bool
        """
        if self.surfaces[number].medium is None or number >= self.last_interface:
            return False
        return not all(self.is_pure_stop(i) for i in range(number + 1))

    def looking_into(self, matter: Matter) -> "Lens":
        """Return the lens with another medium behind its last interface, and behind stops that follow.

        Parameters
        ----------
        matter : Matter

        Returns
        -------
        Lens
        """
        given = {"index": matter.index, "glass": matter.glass} if matter.medium is not None else {}
        surfaces = list(self.surfaces)
        for number in range(self.last_interface, len(surfaces)):
            own = {"index": None, "glass": None, "gradient": None, **given}
            surfaces[number] = surfaces[number].model_copy(update=own)
        return self.model_copy(update={"surfaces": tuple(surfaces)})

    def element_of(self, number: int) -> int | None:
        """Return the index in `elements` of the element that contains surface `number`, or None.

        Parameters
        ----------
        number : int
            From 0.

        Returns
        -------
        int or None
        """
        return next((i for i, element in enumerate(self.elements) if number in element.surfaces), None)

    def is_pure_stop(self, number: int) -> bool:
        """Return whether surface `number` is only a stop: marked, flat, without a phase, in one homogeneous medium.

        Parameters
        ----------
        number : int
            From 0.

        Returns
        -------
        bool
        """
        surface, media = self.surfaces[number], self.media
        # A gradient counts from the vertex of its own surface, so that equal ones differ behind the next.
        acts = surface.paraxial or surface.phase is not None or surface.gradient is not None
        return surface.stop and surface.is_flat and not acts and media[number] == media[number + 1]

    def aperture_mm(self, number: int) -> float | None:
        """Return the clear radius of surface `number`, or None if the pupil's size determines it.

        Parameters
        ----------
        number : int
            From 0.

        Returns
        -------
        float or None
            mm.
        """
        surface = self.surfaces[number]
        if surface.stop and self.stop_semi_diameter_mm is not None:
            return self.stop_semi_diameter_mm
        return None if surface.stop and self.stop_size else surface.semi_diameter_mm

    @property
    def stop_size(self) -> dict[str, float]:
        """Key and value that size the stop in place of the prescription: one entry, or none."""
        sizes = {key: getattr(self, key) for key in STOP_SIZES}
        return {key: size for key, size in sizes.items() if size is not None}

    def faults(self) -> Iterator[Fault]:
        """Yield faults between surfaces."""
        if self.file is not None:
            if self.surfaces:
                yield Fault(
                    ("file",), self.file, f"surfaces are given too; give one of them; {_EDIT.format(self.file)}"
                )
            return
        for key in FILE_CHOICES:
            if value := getattr(self, key):
                yield Fault((key,), value, "it selects from a lens file, but no file is given")
        for name, coating in self.coatings.items():
            if coating.table is not None:
                yield Fault(("coatings", name, "table"), coating.table, "a coating with a file belongs to the scene")
        if not self.surfaces:
            yield Fault(("surfaces",), None, 'missing: give the prescription, or file = "..." with one')
            return
        if all(self.is_pure_stop(i) and surface.mesh is None for i, surface in enumerate(self.surfaces)):
            yield Fault(
                ("surfaces",),
                None,
                "only a stop: a lens needs a surface with glass behind it. For a pinhole camera put a flat "
                "window in front of the stop, such as { thickness_mm = 1.0, index = 1.5, semi_diameter_mm = 10.0 }, "
                "{ thickness_mm = 1.0, semi_diameter_mm = 10.0 }",
            )
            return
        for i, surface in enumerate(self.surfaces):
            if self.is_pure_stop(i) and surface.mesh is None:
                given = {"coating": surface.coating} if surface.coating != UNCOATED else {}
                given |= {"finish": surface.finish.kind} if surface.finish != POLISHED else {}
                for key, value in given.items():
                    yield Fault(("surfaces", i, key), value, "omit it: a stop without glass is no interface")
        for i, (surface, medium) in enumerate(zip(self.surfaces, self.media, strict=False)):
            if surface.paraxial and medium is not None:
                what = f"surfaces[{i - 1}]" if i else "camera.object_medium"
                yield Fault(
                    ("surfaces", i, "paraxial"), True,
                    f"{what} puts {medium if isinstance(medium, str) else 'glass' if i else 'a medium'} before it; "
                    "a thin lens stands in air",
                )  # fmt: skip
        yield from self._stop_faults()
        yield from self._spacing_faults()
        yield from self._element_faults()
        yield from gap_faults(self.surfaces, self.element_of)

    def _stop_faults(self) -> Iterator[Fault]:
        stops = [i for i, surface in enumerate(self.surfaces) if surface.stop]
        if len(stops) > 1:
            yield Fault(("surfaces", stops[1], "stop"), True, f"surfaces[{stops[0]}] is already the stop; keep one")
        sizes = list(self.stop_size.items())
        for key, size in sizes[1:]:
            yield Fault((key,), size, f"{sizes[0][0]} = {sizes[0][1]:g} is given too; give one of them")
        for i, surface in enumerate(self.surfaces):
            sized = surface.stop and bool(self.stop_size)
            if sized and surface.qbfs is not None:
                yield Fault(
                    ("surfaces", i, "qbfs"), None,
                    f"ends at norm_radius_mm; give the size of this stop by semi_diameter_mm, not {sizes[0][0]}",
                )  # fmt: skip
            solved = bool(stops) and not surface.stop and surface.mesh is None
            if surface.semi_diameter_mm is None and not sized and not solved and surface.refractor is None:
                hint = "" if stops else "; or mark the stop: the other clear apertures are computed from it"
                yield Fault(
                    ("surfaces", i, "semi_diameter_mm"), None, f"missing: the radius of the clear aperture{hint}"
                )

    def _element_faults(self) -> Iterator[Fault]:
        last = len(self.surfaces) - 1
        owner: dict[int, int] = {}
        for i, element in enumerate(self.elements):
            beyond = [number for number in element.surfaces if number > last]
            if beyond:
                yield Fault(
                    ("elements", i, "surfaces"),
                    list(element.surfaces),
                    f"there is no surface {beyond[0]}; the lens has surfaces 0 to {last}",
                )
            taken = [number for number in element.surfaces if number in owner]
            if taken:
                yield Fault(
                    ("elements", i, "surfaces"),
                    list(element.surfaces),
                    f"surface {taken[0]} already belongs to elements[{owner[taken[0]]}]; name it only once",
                )
            owner.update((number, i) for number in element.surfaces if number not in owner)

    def _spacing_faults(self) -> Iterator[Fault]:
        last = len(self.surfaces) - 1
        for i, surface in enumerate(self.surfaces[:-1]):
            if surface.thickness_mm is None:
                yield Fault(("surfaces", i, "thickness_mm"), None, "missing: the distance to the next vertex")
            else:
                yield from self._crossing(i)
        if self.surfaces[last].thickness_mm:
            yield Fault(
                ("surfaces", last, "thickness_mm"),
                self.surfaces[last].thickness_mm,
                "omit it at the last surface: mla.distance_mm or sensor.distance_mm gives the distance behind it",
            )

    @property
    def has_meshes(self) -> bool:
        """True if mesh files give some surfaces, which then have no exact form."""
        return any(surface.mesh is not None or surface.refractor is not None for surface in self.surfaces)

    @property
    def has_gradients(self) -> bool:
        """True if there is gradient-index glass between some surfaces."""
        return any(surface.gradient is not None for surface in self.surfaces)

    def kinds_followed(self, number: int) -> str:
        """Return in words the surfaces that a method takes which refuses surface `number`, and what to do with that.

        Parameters
        ----------
        number : int
            Of a surface with an `asymmetric_key`.

        Returns
        -------
        str
        """
        zone = self.surfaces[number].outer_zone
        if zone is None or self.surfaces[number].asymmetric_key != "outer_zone":
            return "surfaces of revolution only"
        return f"surfaces of one formula only, without a kink at border_mm = {zone.border_mm:g}; omit outer_zone"

    @property
    def number_off_revolution(self) -> int | None:
        """Number of the first surface without rotational symmetry, or None."""
        return next((i for i, surface in enumerate(self.surfaces) if surface.asymmetric_key is not None), None)

    def gap_mm(self, number: int, height_mm: float) -> float:
        """Return the smallest axial distance over all azimuths from surface `number` to the next at a height.

        Parameters
        ----------
        number : int
            From 0; not the last.
        height_mm : float

        Returns
        -------
        float
            mm; negative where the surfaces cross.
        """
        front, back = self.surfaces[number], self.surfaces[number + 1]
        return (front.thickness_mm or 0.0) + least_gap_mm(front, back, height_mm, height_mm)[0]

    def edge_mm(self, number: int) -> float:
        """Return the smallest axial distance over all azimuths from the rim of surface `number` to the next rim.

        Parameters
        ----------
        number : int
            From 0; not the last.

        Returns
        -------
        float
            mm; negative where the rims cross.
        """
        front, back = self.surfaces[number], self.surfaces[number + 1]
        rims = front.semi_diameter_mm or 0.0, back.semi_diameter_mm or 0.0
        return (front.thickness_mm or 0.0) + rim_gap_mm(front, back, *rims)

    def _crossing(self, number: int) -> Iterator[Fault]:
        """Compare the sags of a surface and the next over their common aperture."""
        front, back = self.surfaces[number], self.surfaces[number + 1]
        if front.refractor is not None or back.refractor is not None:
            return
        apertures = [a for a in (self.aperture_mm(number), self.aperture_mm(number + 1)) if a is not None]
        if not apertures:
            return
        needed, height = _thickness_to_touch(front, back, tuple(apertures))
        given = front.thickness_mm or 0.0
        # Elements may touch; an overlap within rounding is not a crossing.
        if needed > given + touching_mm(front):
            yield Fault(
                ("surfaces", number, "thickness_mm"),
                given,
                f"surfaces {number} and {number + 1} cross inside their clear aperture, by "
                f"{needed - given:.4g} mm at {height:.4g} mm from the axis; give {at_least(needed)} or more, or "
                "smaller semi-diameters",
            )


@lru_cache(maxsize=1024)
def _thickness_to_touch(front: Surface, back: Surface, apertures_mm: tuple[float, ...]) -> tuple[float, float]:
    """Return the vertex distance of two surfaces in contact inside an aperture, and the height of contact, mm.

    The search stops at the given distance if the bounds exclude a crossing. Cached, as a study asks for the same pair
    thousands of times.
    """
    radius = min(*apertures_mm, front.reach_mm, back.reach_mm)
    given = front.thickness_mm or 0.0
    of_revolution = front.section_key is None and back.section_key is None
    if of_revolution and not front.powers_mm and not back.powers_mm:
        # A conic rises or falls all the way to its rim: between these bounds nothing can cross.
        highest, lowest = max(0.0, front.sag_mm(radius)), min(0.0, back.sag_mm(radius))
        if highest - lowest <= given:
            return given, 0.0
    gap, height = least_gap_mm(front, back, 0.0, radius, -given)
    return -gap, height
