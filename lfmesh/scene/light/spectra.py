"""Spectral quantities: a number, or a spectrum given by a table, a file, an illuminant or a temperature."""

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Discriminator, Field, Tag

from lfmesh.errors import SceneError
from lfmesh.optics.cie import NAMED, named_spectrum, planck_radiance
from lfmesh.optics.curve import Curve, curve_fault, read_curve
from lfmesh.scene.inputs import file_stamp
from lfmesh.scene.model import Fault, Location, Model, nearest
from lfmesh.scene.quantities import FilePath, FractionOfOne, NonNegative, Number, Positive, Text

Kelvin = Annotated[float, Field(strict=True, ge=1.0, le=1e6)]
"""A temperature of a black body, in K."""

NO_COEFFICIENT = "a coefficient is a number without quotes, a table, or the name of a .csv file, in 1/mm"

PIECES = 4096
"""Number of intervals in a table of Planck's law over the requested range."""


class Spectrum(Model):
    """A quantity by wavelength: one of `wavelengths_nm` with `values`, `file`, `name` and `blackbody_k`."""

    wavelengths_nm: tuple[Positive, ...] | None = None
    """Wavelengths of a table, increasing, in nm; linear in between."""
    values: tuple[Number, ...] | None = None
    """Value at each of `wavelengths_nm`, in the unit of the field that holds the spectrum."""
    file: FilePath | None = None
    """A CSV file, relative to the scene file, with the columns wavelength_nm and value."""
    name: Text | None = None
    """An illuminant of the CIE: "A", "D50", "D65", "E" and others; a shape without a scale."""
    blackbody_k: Kelvin | None = None
    """Temperature of a black body, in K."""

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields."""
        table = self.wavelengths_nm is not None or self.values is not None
        given = [key for key in ("file", "name", "blackbody_k") if getattr(self, key) is not None]
        given = ["values", *given] if table else given
        if not given:
            yield Fault((), None, "a spectrum needs wavelengths_nm with values, or file, or name, or blackbody_k")
        for key in given[1:]:
            yield Fault((key,), getattr(self, key), f"{given[0]} is given too; give one of them")
        if table and (why := curve_fault(self.wavelengths_nm or (), self.values or ())):
            yield Fault((), None, why)
        if self.name is not None and self.name not in NAMED:
            near = nearest(self.name, NAMED)
            yield Fault(("name",), self.name, f"no illuminant has this name{near}; there are {', '.join(NAMED)}")

    def in_words(self) -> str:
        """Return the name, file, temperature or range.

        Returns
        -------
        str
        """
        if self.blackbody_k is not None:
            return f"black body of {self.blackbody_k:g} K"
        if self.wavelengths_nm is not None:
            return f"table from {self.wavelengths_nm[0]:g} to {self.wavelengths_nm[-1]:g} nm"
        return str(self.file or self.name)


def _of_text(value: Any) -> Any:
    """Accept text as a file's path, if it ends in .csv, else as an illuminant's name."""
    if isinstance(value, str):
        return {"file" if value.lower().endswith(".csv") else "name": value}
    return value


def _kind(value: Any) -> str:
    return "<number>" if isinstance(value, int | float) else "<spectrum>"


Reflectance = Annotated[
    Annotated[FractionOfOne, Tag("<number>")] | Annotated[Spectrum, Tag("<spectrum>")],
    Discriminator(_kind),
    BeforeValidator(_of_text, json_schema_input_type=FractionOfOne | str | Spectrum),
]
"""A fraction of the light, 0 to 1: a number, or by wavelength."""

Radiance = Annotated[
    Annotated[NonNegative, Tag("<number>")] | Annotated[Spectrum, Tag("<spectrum>")],
    Discriminator(_kind),
    BeforeValidator(_of_text, json_schema_input_type=NonNegative | str | Spectrum),
]
"""A radiance: a number in W/(m² sr), or by wavelength in W/(m² sr nm)."""


def _coefficient_of_text(value: Any) -> Any:
    """Accept text as a file only: an illuminant is not a coefficient."""
    if isinstance(value, str) and not value.lower().endswith(".csv"):
        raise ValueError(NO_COEFFICIENT)
    return value


Coefficient = Annotated[
    Radiance, BeforeValidator(_coefficient_of_text, json_schema_input_type=NonNegative | str | Spectrum)
]
"""A coefficient in 1/mm: a number, or by wavelength."""

Shape = Annotated[Spectrum, BeforeValidator(_of_text, json_schema_input_type=str | Spectrum)]
"""Distribution of a power over wavelength, in any unit."""


def coefficient_faults(value: float | Spectrum, where: Location) -> Iterator[Fault]:
    """Yield a spectrum of light given as a coefficient."""
    if not isinstance(value, Spectrum):
        return
    if value.name is not None or value.blackbody_k is not None:
        yield Fault(where, None, NO_COEFFICIENT)


class Resolves(Protocol):
    """A scene, which locates its files."""

    def resolve(self, path: str | Path) -> Path:
        """Return the full path of a file."""


def spectral_in_words(value: float | Spectrum) -> str:
    """Describe a spectral quantity by its number or spectrum."""
    return value.in_words() if isinstance(value, Spectrum) else f"{value:g}"


def curve_of(spectrum: float | Spectrum, reach_nm: tuple[float, float], scene: Resolves, where: str) -> Curve:
    """Return a spectral quantity as a curve over wavelength.

    Parameters
    ----------
    spectrum : float or Spectrum
        A number holds at all wavelengths.
    reach_nm : (float, float)
        Wavelength range that the curve must cover.
    scene : Resolves
    where : str
        Location in the scene, for messages.

    Raises
    ------
    SceneError, FileError
        It does not cover the range, or its file cannot be used.
    """
    first, last = reach_nm
    if not isinstance(spectrum, Spectrum):
        return Curve(_reach(first, last), np.full(2, spectrum, np.float64))
    if spectrum.blackbody_k is not None:
        return planck_curve(spectrum.blackbody_k, reach_nm)
    if spectrum.file is not None:
        path = scene.resolve(spectrum.file)
        curve = _read(path, file_stamp(path))
    elif spectrum.name is not None:
        curve = Curve(*named_spectrum(spectrum.name))
    else:
        curve = Curve(np.array(spectrum.wavelengths_nm), np.array(spectrum.values))
    if not curve.holds(first, last):
        shortest, longest = curve.ends_nm
        raise SceneError(
            f"{where}: its spectrum extends from {shortest:g} to {longest:g} nm, but the scene's wavelengths lie from "
            f"{first:g} to {last:g} nm"
        )
    return curve


def planck_curve(temperature_k: float, reach_nm: tuple[float, float]) -> Curve:
    """Return the spectral radiance of a black body between two wavelengths, W/(m² sr nm)."""
    first, last = reach_nm
    # Not checked as a table is: far from its peak a black body may emit next to nothing.
    w = np.linspace(first, last, PIECES + 1) if last > first else _reach(first, last)
    return Curve(w, planck_radiance(w, temperature_k))


def _reach(first_nm: float, last_nm: float) -> NDArray[np.float64]:
    """Return the ends of a curve over a wavelength range, widened if it is a single wavelength, (2,) nm."""
    return np.array([first_nm, max(last_nm, first_nm * (1.0 + 1e-6))])


@lru_cache(maxsize=256)
def _read(path: Path, stamp: tuple[object, ...]) -> Curve:
    """Return the curve of a file; `stamp` identifies the version of the file."""
    return read_curve(path, "value")


def reflectance_fault(value: float | Spectrum, where: Location) -> Iterator[Fault]:
    """Yield the reason why a spectrum is not a reflectance; values in files are checked on reading."""
    if not isinstance(value, Spectrum):
        return
    if value.name is not None or value.blackbody_k is not None:
        what = "an illuminant" if value.name is not None else "a black body"
        yield Fault(where, None, f"{what} is no reflectance: give a number, a table or a file with values from 0 to 1")
    for wavelength, share in zip(value.wavelengths_nm or (), value.values or (), strict=False):
        if share > 1.0:
            yield Fault(where, None, f"value {share:g} at {wavelength:g} nm: a reflectance must lie between 0 and 1")
            return
