"""The scattering models of targets as kernels read them: a kind for each target, with its parameters.

A new model has its parameters in the scene's `Material`, its kind and its row here, and its formulas in
`transport/events/scattering.py`. No other code depends on the kind.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.optics.gloss import gloss_parameters
from lfmesh.optics.metals import metal_index
from lfmesh.scene.targets import Material

Array = NDArray[np.float64]

SCATTERING = np.dtype(
    [
        ("kind", "i8"),
        ("first", "i8"),  # row of `ScatteringTables.parameters` with its first parameter
        ("black", "?"),  # scatters nothing, at any wavelength
    ]
)

LAMBERTIAN = 0  # parameter: reflectance
GLOSSY = 1  # parameters: see `optics.gloss`


class ScatteringTables(NamedTuple):
    """The scattering models of all targets."""

    models: NDArray[np.void]  # (targets + 1,) SCATTERING; the last one is for light that targets emit
    parameters: Array  # (parameters of all models, wavelengths)


def scattering_tables(
    materials: Sequence[Material], wavelengths_nm: tuple[float, ...], reflectances: Sequence[Array] | None = None
) -> ScatteringTables:
    """Return the scattering models of some materials, followed by the model of emission.

    Emission follows Lambert's law, whatever the target's scattering model.

    Parameters
    ----------
    materials : sequence of Material
    wavelengths_nm : (wavelengths,) tuple of float
    reflectances : sequence of (wavelengths,) float64, optional
        Of the materials; may be left out if they are numbers.
    """
    models = np.zeros(len(materials) + 1, SCATTERING)
    rows: list[Array] = []
    if reflectances is None:
        reflectances = [np.full(len(wavelengths_nm), material.reflectance, np.float64) for material in materials]
    shares = [*reflectances, np.ones(len(wavelengths_nm))]
    for model, material, share in zip(models, [*materials, Material(reflectance=1.0)], shares, strict=True):
        model["kind"], parameters = _model_of(material, share, wavelengths_nm)
        model["first"] = len(rows)
        model["black"] = not parameters.any()
        rows += list(parameters)
    return ScatteringTables(models, np.array(rows))


def _model_of(material: Material, reflectance: Array, wavelengths_nm: tuple[float, ...]) -> tuple[int, Array]:
    """Return the kind of a material's scattering model, and its parameters, (parameters, wavelengths)."""
    gloss = material.gloss
    if gloss is None:
        return LAMBERTIAN, reflectance[None, :]
    index = np.full(len(wavelengths_nm), gloss.index or 1.0, dtype=np.complex128)
    if gloss.metal is not None:
        index[:] = [metal_index(gloss.metal, wavelength) for wavelength in wavelengths_nm]
    return GLOSSY, gloss_parameters(reflectance, index, gloss.roughness)
