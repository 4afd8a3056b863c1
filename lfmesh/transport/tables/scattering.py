"""The scattering models of targets as kernels read them: a kind for each target, with its parameters.

A new model has its parameters in the scene's `Material`, its kind and its row here, and its formulas in
`transport/events/scattering.py`. No other code depends on the kind.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.by_address import by_address
from lfmesh.optics.gloss import gloss_parameters
from lfmesh.optics.gltf_material import GltfMaterial, gltf_parameters
from lfmesh.optics.metals import metal_index
from lfmesh.scene.targets import Material

Array = NDArray[np.float64]

SCATTERING = np.dtype(
    [
        ("kind", "i8"),
        ("first", "i8"),  # row of `ScatteringTables.parameters` with its first parameter
        ("metal", "f8"),  # share of the surface that is metal, of a `BLEND`
        ("black", "?"),  # scatters nothing, at any wavelength
    ]
)

LAMBERTIAN = 0  # parameter: reflectance
GLOSSY = 1  # parameters: see `optics.gloss`
BLEND = 2  # parameters: those of a dielectric gloss, then those of a metal, see `optics.gltf_material`


@by_address
class ScatteringTables(NamedTuple):
    """The scattering models of all targets, and of the materials that mesh files bring."""

    # (targets + files' materials + 1,) SCATTERING; the last one is for light that targets emit
    models: NDArray[np.void]
    parameters: Array  # (parameters of all models, wavelengths)


def scattering_tables(
    materials: Sequence[Material],
    wavelengths_nm: tuple[float, ...],
    reflectances: Sequence[Array] | None = None,
    from_files: Sequence[GltfMaterial] = (),
) -> ScatteringTables:
    """Return the scattering models of some materials, then those of mesh files' materials, then that of emission.

    Emission follows Lambert's law, whatever the target's scattering model.

    Parameters
    ----------
    materials : sequence of Material
    wavelengths_nm : (wavelengths,) tuple of float
    reflectances : sequence of (wavelengths,) float64, optional
        Of the materials; may be left out if they are numbers.
    from_files : sequence of GltfMaterial
    """
    models = np.zeros(len(materials) + len(from_files) + 1, SCATTERING)
    rows: list[Array] = []
    if reflectances is None:
        reflectances = [np.full(len(wavelengths_nm), material.reflectance, np.float64) for material in materials]
    made = [_model_of(each, share, wavelengths_nm) for each, share in zip(materials, reflectances, strict=True)]
    made += [(BLEND, gltf_parameters(each, wavelengths_nm)) for each in from_files]
    made.append((LAMBERTIAN, np.ones((1, len(wavelengths_nm)))))
    models["metal"][len(materials) : -1] = [each.metallic for each in from_files]
    for model, (kind, parameters) in zip(models, made, strict=True):
        model["kind"] = kind
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
