"""Coatings of interfaces, each given by one field of `Coating`."""

import re
from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated

import numpy as np
from pydantic import Field

from lfmesh.optics.glass import complex_index
from lfmesh.scene.literals import counted
from lfmesh.scene.model import Fault, Model, nearest
from lfmesh.scene.quantities import FilePath, FractionOfOne, GlassName, Positive

UNCOATED = "none"
"""Name of the bare surface, which every scene has."""

MOST_LAYERS = 1000

LayerIndex = Annotated[float, Field(strict=True, gt=0, le=20)]
Extinction = Annotated[float, Field(strict=True, ge=0, le=100)]

_NAME = re.compile(r"[A-Za-z0-9_-]+")


class MeasuredIndex(Model):
    """Complex index n + ik of a layer by a table, interpolated linearly and constant beyond its ends."""

    wavelengths_nm: tuple[Positive, ...] = Field(min_length=1)
    """Wavelengths, increasing, in nm."""
    index: tuple[LayerIndex, ...]
    """Refractive index n at each wavelength."""
    extinction: tuple[Extinction, ...] = ()
    """Extinction k at each wavelength. Omitted: none."""

    def faults(self) -> Iterator[Fault]:
        """Yield faults between columns."""
        count = len(self.wavelengths_nm)
        for key in ("index", "extinction"):
            given = len(getattr(self, key))
            if given != count and (given or key == "index"):
                found = f"{counted(given, 'number')} for {counted(count, 'wavelength')}"
                yield Fault((key,), None, f"{found}; give one for each")
        if any(after <= before for before, after in pairwise(self.wavelengths_nm)):
            yield Fault(("wavelengths_nm",), None, "must increase")

    def at(self, wavelength_nm: float) -> complex:
        """Return n + ik at a wavelength.

        Parameters
        ----------
        wavelength_nm : float

        Returns
        -------
        complex
        """
        columns = (self.index, self.extinction or (0.0,) * len(self.index))
        n, k = (float(np.interp(wavelength_nm, self.wavelengths_nm, column)) for column in columns)
        return complex(n, k)


class Layer(Model):
    """A plane layer of a coating."""

    index: LayerIndex | None = None
    """Refractive index. Or give `glass` or `measured`."""
    extinction: Extinction = 0.0
    """Imaginary part k of the index n + ik, for a layer that absorbs (no unit); beside `index` only."""
    glass: GlassName | None = None
    """A glass or film of the catalogue, like "SCHOTT/N-BK7" or "main/TiO2/Devore-o", with the catalogue's extinction,
    if any."""
    measured: MeasuredIndex | None = None
    """Index and extinction by wavelength."""
    thickness_nm: Positive
    """Thickness, in nm."""

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields."""
        given = [key for key in ("index", "glass", "measured") if getattr(self, key) is not None]
        if not given:
            yield Fault(("index",), None, "missing: give the index of the layer, glass or measured")
        elif len(given) > 1:
            first, second = (getattr(self, key) for key in given[:2])
            shown = None if given[1] == "measured" else second
            yield Fault((given[1],), shown, f"{given[0]} = {first} is given too; give one of them")
        elif self.index is None and self.extinction:
            source = "catalogue" if self.glass is not None else "table"
            yield Fault(("extinction",), self.extinction, f"omit it: the {source} gives it")

    def index_at(self, wavelength_nm: float) -> complex:
        """Return the complex index n + ik at a wavelength.

        Parameters
        ----------
        wavelength_nm : float

        Returns
        -------
        complex

        Raises
        ------
        GlassError
            The catalogue lacks the glass, or its index at this wavelength.
        """
        if self.glass is not None:
            return complex_index(self.glass, wavelength_nm)
        if self.measured is not None:
            return self.measured.at(wavelength_nm)
        return complex(self.index or 1.0, self.extinction)


class MeasuredReflectance(Model):
    """Reflectance by wavelength and angle; the rest of the light is transmitted."""

    wavelengths_nm: tuple[Positive, ...] = Field(min_length=1)
    """Wavelengths, increasing, in nm; linear in between, nothing outside."""
    angles_deg: tuple[float, ...]
    """Angles in the thinner medium, increasing from 0 to 90 degrees; a monotone cubic in the cosine in between."""
    reflectance: tuple[tuple[FractionOfOne, ...], ...]
    """One row per wavelength: the reflectance at each angle, 0..1; 1 at 90 degrees."""

    def faults(self) -> Iterator[Fault]:
        """Yield faults between columns."""
        for key in ("wavelengths_nm", "angles_deg"):
            if any(after <= before for before, after in pairwise(getattr(self, key))):
                yield Fault((key,), None, "must increase")
        if not self.angles_deg or (self.angles_deg[0], self.angles_deg[-1]) != (0.0, 90.0):
            yield Fault(("angles_deg",), None, "must reach from 0 to 90")
        rows = {len(row) for row in self.reflectance}
        if len(self.reflectance) != len(self.wavelengths_nm) or rows != {len(self.angles_deg)}:
            yield Fault(("reflectance",), None, "must have a row per wavelength with a number per angle")
        elif any(row[-1] != 1.0 for row in self.reflectance):
            yield Fault(("reflectance",), None, "must end at 1: at 90 degrees every surface reflects everything")


class Coating(Model):
    """Coating of an interface, given by exactly one field."""

    reflectance: FractionOfOne | None = None
    """Share of the light that is reflected, 0..1, at every angle and wavelength; the rest passes."""
    table: FilePath | None = None
    """CSV file, relative to the scene file, with wavelength_nm, angle_deg and reflectance. Angles are in the thinner
    medium, from 0 to 90, and are the same at every wavelength. The rest of the light passes. Interpolation is linear in
    wavelength and a monotone cubic in the cosine of the angle, as layers behave; give closely spaced angles."""
    measured: MeasuredReflectance | None = None
    """Contents of a `table` file, in its place."""
    layers: tuple[Layer, ...] | None = None
    """The layers of a stack, from the air side to the glass; between two glasses from the object to the sensor."""

    @property
    def kind(self) -> str:
        """Name of the field that is given."""
        return self._given[0]

    @property
    def _given(self) -> list[str]:
        return [key for key in type(self).model_fields if getattr(self, key) is not None]

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields."""
        given = self._given
        if not given:
            *others, last = type(self).model_fields
            yield Fault((), None, f"a coating needs one of {', '.join(others)} and {last}")
        if self.layers is not None and not 0 < len(self.layers) <= MOST_LAYERS:
            yield Fault(("layers",), None, f"{len(self.layers)} layers are given; a stack has 1 to {MOST_LAYERS}")
        for key in given[1:]:
            yield Fault((key,), None, f"{given[0]} is given too; give one of them")


def name_fault(name: str) -> str | None:
    """Return why a coating cannot have this name, or None if it can."""
    if name == UNCOATED:
        return f'"{UNCOATED}" stands for a bare surface; use another name'
    if not _NAME.fullmatch(name):
        return "a coating name has only letters, digits, _ and -"
    return None


def unknown_fault(name: str, known: Iterator[str] | list[str] | tuple[str, ...]) -> str | None:
    """Return a message if a surface names an unknown coating, else None."""
    names = [*known, UNCOATED]
    if name in names:
        return None
    return f"no coating has this name{nearest(name, names)}; there are {', '.join(names)}"
