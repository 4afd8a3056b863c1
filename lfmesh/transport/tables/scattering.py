"""Scattering models of targets for kernels: a kind per target, with its parameters.

A new model needs its parameters in the scene's `Material`, its kind and its row here, and its formulas in
`transport/events/scattering.py`. No other code depends on the kind.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.by_address import by_address
from lfmesh.optics.gloss import gloss_parameters, mean_albedos
from lfmesh.optics.gltf_material import GltfMaterial, gltf_parameters
from lfmesh.optics.metals import metal_index
from lfmesh.scene.objects.targets import Material

Array = NDArray[np.float64]

SCATTERING = np.dtype(
    [
        ("kind", "i8"),
        ("first", "i8"),  # row of `ScatteringTables.parameters` with its first parameter
        ("metal", "f8"),  # share of the surface that is metal, for a `BLEND`
        ("behind", "i8"),  # row of the model of the surface's other side
        ("emission", "i8"),  # row of the surface's emission model; for `THERMAL`, row of the surface's model
        ("black", "?"),  # scatters nothing, at any wavelength
    ]
)

LAMBERTIAN = 0  # parameter: reflectance
GLOSSY = 1  # parameters: see `optics.gloss`
BLEND = 2  # parameters: of a dielectric gloss, then of a metal, see `optics.gltf_material`
THERMAL = 3  # emission by temperature; parameters: mean emissivity for texture 0, and its reduction for texture 1


@by_address
class ScatteringTables(NamedTuple):
    """Scattering models of all targets, and of the materials in mesh files."""

    # (n,) SCATTERING: of targets, then of files' materials, each in all media around it; a black one if a hot sheet
    # has a black side; emission of each hot target, emission of the black side, and a given radiance, which is
    # the same in all directions
    models: NDArray[np.void]
    parameters: Array  # (parameters of all models, wavelengths)


def scattering_tables(
    materials: Sequence[Material],
    wavelengths_nm: tuple[float, ...],
    reflectances: Sequence[Array] | None = None,
    from_files: Sequence[GltfMaterial] = (),
    surroundings: Array | float = 1.0,
) -> ScatteringTables:
    """Return the scattering models of some materials, then of mesh files' materials, then of emission.

    A given radiance is emitted by Lambert's law, whatever the target's model. A surface with a temperature emits, in
    each direction, 1 minus its albedo times the black body's radiance (Kirchhoff).

    Parameters
    ----------
    materials : sequence of Material
    wavelengths_nm : (wavelengths,) tuple of float
    reflectances : sequence of (wavelengths,) float64, optional
        Optional if they are numbers.
    from_files : sequence of GltfMaterial
    surroundings : (materials + from_files, wavelengths) float64, or fewer axes
        Refractive index around each material; a gloss reflects by its own index over this one.
    """
    around = np.broadcast_to(surroundings, (len(materials) + len(from_files), len(wavelengths_nm)))
    if reflectances is None:
        reflectances = [np.full(len(wavelengths_nm), material.reflectance, np.float64) for material in materials]
    made = [
        _model_of(each, share, wavelengths_nm, outer)
        for each, share, outer in zip(materials, reflectances, around, strict=False)
    ]
    # Shared by all metallics, as metallic is no parameter.
    outer = around[len(materials) :]
    keys = [(each.base, each.alpha, index.tobytes()) for each, index in zip(from_files, outer, strict=True)]
    chosen = {key: i for i, key in reversed(list(enumerate(keys)))}
    which = list(chosen.values())
    distinct = gltf_parameters([from_files[i] for i in which], wavelengths_nm, outer[which])
    blends = dict(zip(chosen, distinct, strict=True))
    made += [(BLEND, blends[key]) for key in keys]
    hot = [i for i, each in enumerate(materials) if each.temperature_k is not None]
    one_sided = [i for i in hot if materials[i].sides == "front"]
    black = len(made)
    if one_sided:
        made.append((LAMBERTIAN, np.zeros((1, len(wavelengths_nm)))))
        hot.append(black)
    thermal = len(made)
    made += [(THERMAL, _mean_emissivity(*made[i])) for i in hot]
    made.append((LAMBERTIAN, np.ones((1, len(wavelengths_nm)))))
    models = np.zeros(len(made), SCATTERING)
    models["metal"][len(materials) : len(materials) + len(from_files)] = [each.metallic for each in from_files]
    models["behind"], models["emission"] = np.arange(len(made)), len(made) - 1
    models["behind"][one_sided] = black
    models["emission"][hot] = thermal + np.arange(len(hot))
    models["emission"][thermal : thermal + len(hot)] = hot
    rows: list[Array] = []
    first: dict[int, int] = {}
    for model, (kind, parameters) in zip(models, made, strict=True):
        if id(parameters) not in first:
            first[id(parameters)] = len(rows)
            rows += list(parameters)
        model["kind"] = kind
        model["first"] = first[id(parameters)]
        model["black"] = not parameters.any()
    return ScatteringTables(models, np.array(rows))


def _mean_emissivity(kind: int, parameters: Array) -> Array:
    """Return the parameters of a `THERMAL` model, (2, wavelengths), from the surface's parameters."""
    if kind == LAMBERTIAN:
        return np.concatenate([np.ones_like(parameters), parameters])
    alone, base = mean_albedos(parameters)
    return np.array([1.0 - alone, base])


def mean_emission(tables: ScatteringTables, model: int) -> tuple[Array, Array]:
    """Return the hemispherical mean emission of a surface, relative to its radiance.

    Parameters
    ----------
    tables : ScatteringTables
    model : int
        Row of the surface's scattering model.

    Returns
    -------
    untextured, by_texture : (wavelengths,) float64
        Value for texture 0, and the addition for texture 1.
    """
    row = tables.models[tables.models["emission"][model]]
    first = tables.parameters[row["first"]]
    if row["kind"] == THERMAL:
        return first, -tables.parameters[row["first"] + 1]
    return np.zeros_like(first), first


def _model_of(
    material: Material, reflectance: Array, wavelengths_nm: tuple[float, ...], around: Array
) -> tuple[int, Array]:
    """Return the kind and the parameters, (parameters, wavelengths), of a material's scattering model."""
    gloss = material.gloss
    if gloss is None:
        return LAMBERTIAN, reflectance[None, :]
    index = np.full(len(wavelengths_nm), gloss.index or 1.0, dtype=np.complex128)
    if gloss.metal is not None:
        index[:] = [metal_index(gloss.metal, wavelength) for wavelength in wavelengths_nm]
    return GLOSSY, gloss_parameters(reflectance, index / around, gloss.roughness)
