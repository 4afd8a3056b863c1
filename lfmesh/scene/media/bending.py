"""The quantities by which a medium bends light, and the law that each gives its index."""

from collections.abc import Collection, Iterator
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Discriminator, Tag

from lfmesh.optics.air import REFERENCE_C, REFERENCE_KPA
from lfmesh.optics.gladstone_dale import index_by_density
from lfmesh.scene.camera.gradient import AnyGradient, Gradient
from lfmesh.scene.media.air import Air
from lfmesh.scene.quantities import FieldNumber

Array = NDArray[np.float64]

INDEX_KEYS = ("index", "density_kg_m3", "pressure_kpa")
"""Quantities that set the index of a medium, a pressure together with `temperature_k`; in a key or in a grid."""


def _number_or_formula(value: object) -> str:
    return "<formula>" if isinstance(value, dict | Gradient) else "<number>"


FieldIndex = Annotated[
    Annotated[FieldNumber, Tag("<number>")] | Annotated[AnyGradient, Tag("<formula>")],
    Discriminator(_number_or_formula),
]
"""The index of a medium: a number, or a formula of gradient-index glass."""


def law_faults(given: Collection[str], *, whole: bool) -> Iterator[tuple[str, str]]:
    """Yield the keys of a medium that do not give one index, each with the reason.

    Parameters
    ----------
    given : collection of str
        Keys with a value, and arrays of the grid.
    whole : bool
        False if the grid, with further arrays, has not been read.
    """
    laws = [key for key in INDEX_KEYS if key in given]
    for key in laws[1:]:
        yield key, f"{laws[0]} is given too, and sets the index; give one of them"
    if "gladstone_dale_m3_kg" in given and laws and "density_kg_m3" not in laws:
        yield "gladstone_dale_m3_kg", f"{laws[0]} sets the index without it; give density_kg_m3, or omit it"
    elif "gladstone_dale_m3_kg" in given and not laws and whole:
        yield "gladstone_dale_m3_kg", "needs density_kg_m3"
    if laws == ["pressure_kpa"] and "temperature_k" not in given and whole:
        yield "pressure_kpa", "needs temperature_k: the index of air follows from both"


def density_law(
    wavelengths_nm: tuple[float, ...], air: Air | None, gladstone_dale_m3_kg: float | None
) -> tuple[Array, Array]:
    """Return a and b of the index n = a + b ρ of a gas, relative to the scene's air.

    Parameters
    ----------
    wavelengths_nm : tuple of float
    air : Air or None
        Air of the scene. None: that of the catalogues.
    gladstone_dale_m3_kg : float or None
        Constant of the gas. None: that of dry air at each wavelength.

    Returns
    -------
    offsets, scales : (wavelengths,) float64
        a, and b in m³/kg.
    """
    celsius, kpa = (REFERENCE_C, REFERENCE_KPA) if air is None else (air.temperature_c, air.pressure_kpa)
    return index_by_density(wavelengths_nm, celsius, kpa, gladstone_dale_m3_kg)
