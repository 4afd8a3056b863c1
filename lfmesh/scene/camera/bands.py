"""Bands of the sensor, which replace single wavelengths as channels of the image."""

import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Discriminator, Field, Tag

from lfmesh.errors import FileError
from lfmesh.optics.cie import observer
from lfmesh.optics.curve import LONGEST_NM, SHORTEST_NM, Curve, gaussian, read_curve
from lfmesh.scene.inputs import file_stamp
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.quantities import FilePath, Positive, Text

HALF_REACH = 1.5
"""Extent of a Gaussian band to each side of its centre, in full widths at half maximum. There the response is 0.2 %;
0.04 % of the area lies beyond."""

MOST_BANDS = 64

VISIBLE_NM = (380.0, 780.0)
"""Limits of the preset bands."""

RGB_NM = {"R": (600.0, 90.0), "G": (540.0, 90.0), "B": (460.0, 90.0)}
"""Centre and full width at half maximum of the "rgb" bands, Gaussians with a peak of 1."""


_NAME = re.compile(r"[A-Za-z0-9_-]{1,32}")


class Band(Model):
    """A range of wavelengths that the sensor detects together, by a Gaussian or measured response."""

    name: Text
    """Name of the channel: letters, digits, _ and -."""
    center_nm: Annotated[float, Field(strict=True, ge=SHORTEST_NM, le=LONGEST_NM)] | None = None
    """Peak wavelength of a Gaussian response (peak value 1), in nm. Or give `response`."""
    fwhm_nm: Positive | None = None
    """Full width of the Gaussian at half maximum, in nm; cut off 1.5 widths to each side. The response is 0.2 %
    there."""
    response: FilePath | None = None
    """CSV file, relative to the scene file, with wavelength_nm and response (no unit). The response is interpolated
    linearly and is 0 outside. Replaces `center_nm` and `fwhm_nm`."""

    def faults(self) -> Iterator[Fault]:
        """Yield a name that files cannot store, and faults between fields."""
        if not _NAME.fullmatch(self.name):
            yield Fault(("name",), self.name, "a band name has at most 32 characters: letters, digits, _ and -")
        if self.response is not None:
            for key in ("center_nm", "fwhm_nm"):
                if getattr(self, key) is not None:
                    yield Fault((key,), getattr(self, key), "response is given too; give one of them")
        elif self.center_nm is None or self.fwhm_nm is None:
            missing = "center_nm" if self.center_nm is None else "fwhm_nm"
            yield Fault((missing,), None, "missing: a band needs center_nm and fwhm_nm, or response")
        else:
            first, last = self.center_nm - HALF_REACH * self.fwhm_nm, self.center_nm + HALF_REACH * self.fwhm_nm
            if first < SHORTEST_NM or last > LONGEST_NM:
                yield Fault(
                    ("fwhm_nm",),
                    self.fwhm_nm,
                    f"the band extends from {first:g} to {last:g} nm, 1.5 times its width on each side; wavelengths "
                    f"must lie between {SHORTEST_NM:g} and {LONGEST_NM:g} nm",
                )


def _kind_of_bands(value: Any) -> str:
    return "<preset>" if isinstance(value, str) else "<bands>"


Bands = Annotated[
    Annotated[tuple[Band, ...], Tag("<bands>")] | Annotated[Literal["rgb", "xyz"], Tag("<preset>")],
    Discriminator(_kind_of_bands),
]
"""Bands of a sensor, or the name of a preset."""


class Passband(NamedTuple):
    """A band with its response.

    Attributes
    ----------
    name : str
    response : Curve
        Response by wavelength, without a unit.
    """

    name: str
    response: Curve


class Centroids(tuple[float, ...]):
    """Wavelengths of channels that are bands: the centroids of their responses, nm.

    Attributes
    ----------
    bands : tuple of Passband
    """

    bands: tuple[Passband, ...]

    @classmethod
    def of(cls, bands: tuple[Passband, ...]) -> "Centroids":
        """Return the centroids of some bands."""
        centroids = cls(band.response.centroid_nm for band in bands)
        centroids.bands = bands
        return centroids


def channel_labels(wavelengths_nm: tuple[float, ...]) -> tuple[str, ...]:
    """Return the names of bands as channels in files; none for single wavelengths."""
    return tuple(band.name for band in wavelengths_nm.bands) if isinstance(wavelengths_nm, Centroids) else ()


def preset(name: str) -> tuple[Passband, ...]:
    """Return the bands of a preset: "rgb" or "xyz"."""
    first, last = VISIBLE_NM
    if name == "rgb":
        found = []
        for band, (center, width) in RGB_NM.items():
            reach = HALF_REACH * width
            ends = max(first, center - reach), min(last, center + reach)
            found.append(Passband(band, gaussian(center, width, *ends)))
        return tuple(found)
    w = np.arange(first, last + 1.0)
    return tuple(Passband(band, Curve(w, values)) for band, values in zip("XYZ", observer(w), strict=True))


def passband(band: Band, path: Path | None) -> Passband:
    """Return a band with its response, read from `path` if that is given.

    Raises
    ------
    FileError
        The file cannot be used.
    """
    if path is not None:
        return Passband(band.name, _measured(path, file_stamp(path)))
    center, width = band.center_nm or 0.0, band.fwhm_nm or 0.0
    return Passband(band.name, gaussian(center, width, center - HALF_REACH * width, center + HALF_REACH * width))


@lru_cache(maxsize=64)
def _measured(path: Path, stamp: tuple[object, ...]) -> Curve:
    """Return a measured response; `stamp` identifies the version of the file."""
    curve = read_curve(path, "response")
    if curve.area_nm == 0.0:
        raise FileError(f"{path}: the response is 0 at every wavelength")
    return curve


def band_faults(bands: tuple[Band, ...] | str) -> Iterator[Fault]:
    """Yield faults of a sensor's list of bands."""
    if isinstance(bands, str):
        return
    if not bands:
        yield Fault(("bands",), None, 'must not be empty: give a band, "rgb" or "xyz", or omit it')
    if len(bands) > MOST_BANDS:
        yield Fault(("bands",), None, f"{len(bands)} bands are given; a sensor has at most {MOST_BANDS}")
    names = [band.name for band in bands]
    for i, name in enumerate(names):
        if name in names[:i]:
            yield Fault(("bands", i, "name"), name, "another band has this name")
