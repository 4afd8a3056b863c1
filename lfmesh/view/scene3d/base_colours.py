"""Base colours of targets as a render has them: of the materials of glTF files, or of the reflectance."""

from typing import NamedTuple

import numpy as np
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from lfmesh.files.colour import srgb_encode, srgb_weights, white_signals
from lfmesh.geometry.objects.targets import TargetMesh
from lfmesh.transport.tables.spectra import reflectance_at
from lfmesh.transport.world import World

Array = NDArray[np.float64]

MOST_PLAIN = 64
"""Most colours of facets that show a single texel each; of more, the facets keep the picture."""


class BaseColour(NamedTuple):
    """Base colour of some facets of a target.

    Attributes
    ----------
    colour : (3,) float64
        Linear sRGB, 0 to 1.
    opacity : float
        0 to 1.
    has_picture : bool
        True if the target's picture multiplies the colour; a single texel of it is part of the colour.
    facets : (m,) bool
    """

    colour: Array
    opacity: float
    has_picture: bool
    facets: NDArray[np.bool_]


def base_colours(world: World, number: int) -> list[BaseColour]:
    """Return the base colours of a target.

    Parameters
    ----------
    world : World
    number : int
        Of the target, which is not of glass.
    """
    target, material = world.targets[number], world.scene.targets[number].material
    count = len(target.mesh.faces)
    own = _own_colour(world, number)
    rows = np.ones((count, 5))
    # Facets without a material in the file have −1, the last row.
    table = np.array([*(each.base for each in target.materials), own])
    rows[:, :3] = own if target.material_of is None else table[target.material_of]
    rows[:, 3] = material.opacity if isinstance(material.opacity, float) else 1.0
    rows[:, 4] = 0.0
    if target.texture is not None and target.uv is not None:
        rows[:, 4] = 1.0
        plain = (target.uv == target.uv[:, :1]).all(axis=(1, 2))
        texels = _texels(target, target.uv[plain, 0])
        if len(np.unique(texels, axis=0)) <= MOST_PLAIN:
            rows[plain, :4] *= texels
            rows[plain, 4] = 0.0
    kinds, which = np.unique(rows, axis=0, return_inverse=True)
    which = which.reshape(-1)
    return [BaseColour(kind[:3], float(kind[3]), bool(kind[4]), which == place) for place, kind in enumerate(kinds)]


def _texels(target: TargetMesh, uv: Array) -> Array:
    """Return colour and opacity of a target's picture at texture coordinates (n, 2), as (n, 4)."""
    assert target.texture is not None
    height, width = target.texture.shape[:2]
    row = np.clip(((1.0 - uv[:, 1]) * height).astype(np.int64), 0, height - 1)
    column = np.clip((uv[:, 0] * width).astype(np.int64), 0, width - 1)
    opacity = np.ones(len(uv)) if target.alpha is None else target.alpha[row, column]
    return np.column_stack([target.texture[row, column], opacity]).astype(np.float64)


def _own_colour(world: World, number: int) -> Array:
    """Return the colour of a target's reflectance in the light that pictures show as white; white if it emits.

    It is grey if pictures of the scene are, see `srgb_weights`.
    """
    scene = world.scene
    if scene.targets[number].material.emits:
        return np.ones(3)
    reflectance = reflectance_at(scene, number, tuple(scene.wavelengths_nm))
    weights, white = srgb_weights(scene.wavelengths_nm), white_signals(scene.wavelengths_nm)
    if weights is None:
        return np.full(3, reflectance.mean())
    return np.clip(weights @ (white * reflectance) / (weights @ white), 0.0, 1.0)


def paint(colour: Array, least: float = 0.0) -> str:
    """Return linear sRGB (3,) as #rrggbb.

    Parameters
    ----------
    colour : (3,) float64
    least : float
        Smallest value of the largest channel, coded from 0 to 1: darker colours are brightened, with their hue.
    """
    coded = srgb_encode(colour) / 255.0
    largest = float(coded.max())
    if largest < least:
        coded = coded * (least / largest) if largest > 0.0 else np.full(3, least)
    red, green, blue = coded.tolist()
    return to_hex((red, green, blue))
