"""Media of a scene: air, and the glasses of lens, array and bodies in object space, each with a number.

Packets carry the number of their medium; `Media` has the properties. Glasses of one index with different absorption are
different media. Number 0 is the medium outside the lens: before it air or the object medium, behind it air or the image
medium. Among the spaces of the lens these two have numbers of their own. Both are clear.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from lfmesh.optics.glass import Medium, absorption_per_mm, catalogue_name, refractive_index
from lfmesh.scene import Refractor, Scene
from lfmesh.scene.light.spectra import Spectrum, curve_of
from lfmesh.transport.packets.book import Book
from lfmesh.transport.tables.tables import AIR, NO_SLOT, Absorption, LensTables, Media, MlaTables

Array = NDArray[np.float64]

Dye = float | Spectrum | Literal["catalogue"]
"""Absorption coefficient of a medium, 1/mm, or "catalogue": from the glass's internal transmittance."""

CLEAR: Dye = 0.0


@dataclass(frozen=True)
class MediumList:
    """Distinct media of a scene, by number.

    Attributes
    ----------
    scene : Scene
    media : tuple of Medium
        Air first.
    dyes : tuple of Dye
        Absorption of each medium.
    """

    scene: Scene
    media: tuple[Medium, ...]
    dyes: tuple[Dye, ...]

    @classmethod
    def of(cls, scene: Scene) -> "MediumList":
        """Return the media of a scene."""
        camera = scene.camera
        inside = [surface.medium for surface in camera.lens.surfaces[: camera.lens.last_interface]]
        inside += [camera.mla.medium] if camera.mla is not None else []
        inside += [camera.sensor.cover.medium] if camera.sensor.cover is not None else []
        bodies = [target.refractor for target in scene.targets if target.refractor is not None]
        found = [
            (None, CLEAR),
            (camera.lens.media[0], CLEAR),
            (camera.medium_behind_lens, CLEAR),
            *((medium, _dye_in_camera(scene, medium)) for medium in inside),
        ]
        found += [(body.medium, body.absorption_per_mm) for body in bodies]
        distinct = tuple(dict.fromkeys(found))
        return cls(scene, tuple(medium for medium, _ in distinct), tuple(dye for _, dye in distinct))

    @property
    def before_lens(self) -> int:
        """Number of the medium in front of the lens, among the spaces of the lens."""
        return self._number(self.scene.camera.lens.media[0], CLEAR)

    @property
    def behind_lens(self) -> int:
        """Number of the medium behind the lens, among the spaces of the lens."""
        return self._number(self.scene.camera.medium_behind_lens, CLEAR)

    def in_camera(self, medium: Medium) -> int:
        """Return the number of a medium of lens, array or cover."""
        return self._number(medium, _dye_in_camera(self.scene, medium))

    def of_body(self, body: Refractor) -> int:
        """Return the number of the medium of a body of glass."""
        return self._number(body.medium, body.absorption_per_mm)

    def _number(self, medium: Medium, dye: Dye) -> int:
        return list(zip(self.media, self.dyes, strict=True)).index((medium, dye))

    @property
    def absorbing(self) -> tuple[int, ...]:
        """Numbers of the media that absorb."""
        return tuple(number for number, dye in enumerate(self.dyes) if dye != CLEAR)

    def places(self, number: int, elements: Iterable[Medium]) -> str:
        """Return the names of the bodies filled by a medium, for example "lens[0], mla".

        Parameters
        ----------
        number : int
        elements : iterable of Medium
            Glasses of the lens elements, in order.
        """
        names = [f"lens[{i}]" for i, medium in enumerate(elements) if self.in_camera(medium) == number]
        mla = self.scene.camera.mla
        names += ["mla"] if mla is not None and self.in_camera(mla.medium) == number else []
        cover = self.scene.camera.sensor.cover
        names += ["cover"] if cover is not None and self.in_camera(cover.medium) == number else []
        for i, target in enumerate(self.scene.targets):
            if target.refractor is not None and self.of_body(target.refractor) == number:
                names.append(target.name or f"targets[{i}]")
        return ", ".join(names)

    def table(self, wavelengths_nm: tuple[float, ...], book: Book | None, within: Iterable[int]) -> Media:
        """Return the media at some wavelengths, for the kernels of a region.

        Parameters
        ----------
        wavelengths_nm : tuple of float
        book : Book or None
            None: without absorption.
        within : iterable of int
            Media of the region.
        """
        indices = np.array(
            [[refractive_index(medium, wavelength_nm) for wavelength_nm in wavelengths_nm] for medium in self.media]
        )
        absorbing = self.absorbing
        if book is None or not set(absorbing) & set(within):
            return Media(indices)
        slot = np.full(len(self.media), NO_SLOT)
        slot[list(absorbing)] = book.absorbers
        per_mm = np.array([self._absorption(number, wavelengths_nm) for number in range(len(self.media))])
        return Media(indices, Absorption(per_mm, slot))

    def table_behind_lens(self, wavelengths_nm: tuple[float, ...], book: Book | None, within: Iterable[int]) -> Media:
        """Return the media of the array or the sensor's cover at some wavelengths.

        Parameters
        ----------
        wavelengths_nm : tuple of float
        book : Book or None
        within : iterable of int
            As for `table`.
        """
        media = self.table(wavelengths_nm, book, within)
        media.indices[AIR] = media.indices[self.behind_lens]
        return media

    def table_of_objects(self, wavelengths_nm: tuple[float, ...], book: Book | None, within: Iterable[int]) -> Media:
        """Return the media of object space at some wavelengths, always with absorption: kernels compile once.

        Parameters
        ----------
        wavelengths_nm : tuple of float
        book : Book or None
        within : iterable of int
            As for `table`.
        """
        media = self.table(wavelengths_nm, book, within)
        media.indices[AIR] = media.indices[self.before_lens]
        return without_absorption(media) if media.absorption is None else media

    def _absorption(self, number: int, wavelengths_nm: tuple[float, ...]) -> Array:
        """Return the absorption coefficient of a medium at some wavelengths, 1/mm."""
        medium, dye = self.media[number], self.dyes[number]
        if dye == "catalogue":
            return np.array(
                [absorption_per_mm(str(catalogue_name(medium)), wavelength_nm) for wavelength_nm in wavelengths_nm]
            )
        where = f"{self.places(number, ())}: absorption_per_mm"
        return curve_of(dye, (min(wavelengths_nm), max(wavelengths_nm)), self.scene, where).at(wavelengths_nm)


def _dye_in_camera(scene: Scene, medium: Medium) -> Dye:
    """Return the absorption of a medium of the camera: only for catalogue glasses, if the camera asks for it."""
    return "catalogue" if scene.camera.absorption and catalogue_name(medium) is not None else CLEAR


def without_absorption(media: Media) -> Media:
    """Return the media of object space without absorption.

    Parameters
    ----------
    media : Media
    """
    nothing = Absorption(np.zeros_like(media.indices), np.full(len(media.indices), NO_SLOT))
    return media._replace(absorption=nothing)


def index2_behind_lens(scene: Scene, wavelengths_nm: Iterable[float]) -> Array:
    """Return the squared index of the medium behind the lens at some wavelengths, (wavelengths,)."""
    return np.array([scene.camera.image_index(wavelength_nm) ** 2 for wavelength_nm in wavelengths_nm])


Region = TypeVar("Region", LensTables, MlaTables)


def clear(tables: Region) -> Region:
    """Return the tables of a region without absorption."""
    media = tables.media._replace(absorption=None)
    if isinstance(tables, MlaTables):
        return with_media(tables, media)
    return tables._replace(media=media)


def with_media(mla: MlaTables, media: Media, **others: Any) -> MlaTables:
    """Return the tables of the array, for both faces, with other media.

    Parameters
    ----------
    mla : MlaTables
    media : Media
    **others
        Further fields shared by both faces.
    """
    back = None if mla.back is None else mla.back._replace(media=media, **others)
    return mla._replace(media=media, back=back, **others)
