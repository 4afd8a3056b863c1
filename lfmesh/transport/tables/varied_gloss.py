"""Gloss varied by a picture over a surface: the scattering models mixed at each point, for kernels."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.objects.targets import TargetMesh
from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import kernel
from lfmesh.optics.gltf_material import RATIO, ROUGHNESSES, SMALLEST_ALPHA

RANGE = np.dtype(
    [
        ("first", "i8"),  # place in `VariedGloss.rows`
        ("roughnesses", "i8"),  # number of roughnesses of its models, with two metallics each
        ("least", "f8"),  # number of the first roughness, see `GltfRange`
        ("metallic", "f8"),  # the least metallic
        ("more", "f8"),  # excess of the largest metallic
    ]
)


@by_address
class VariedGloss(NamedTuple):
    """Gloss by pictures of metallic and roughness; without rows if no target has such a picture."""

    range_of: NDArray[np.int64]  # (m,) range of each facet of the targets; −1: none
    uv: Array  # (m, 3, 2)
    picture: NDArray[np.int64]  # (targets, 3): first value, height, width
    roughness: NDArray[np.float32]  # (values,)
    metallic: NDArray[np.float32]  # (values,)
    ranges: NDArray[np.void]  # (n,) RANGE
    rows: NDArray[np.int64]  # row of each model in the first medium around its target: by roughness, two metallics each


def varied_gloss(targets: list[TargetMesh], around: list[tuple[int, ...]], row_of: Mapping[Any, int]) -> VariedGloss:
    """Return the tables of gloss varied by pictures.

    Parameters
    ----------
    targets : list of TargetMesh
    around : list of tuple of int
        Media around each target.
    row_of : mapping
        Rows of scattering models by their `GltfMaterial` and the number of their medium.
    """
    if all(target.gloss is None for target in targets):
        none, no_values = np.zeros(0, np.int64), np.zeros(0, np.float32)
        return VariedGloss(
            none, np.zeros((0, 3, 2)), np.zeros((0, 3), np.int64), no_values, no_values, np.zeros(0, RANGE), none
        )
    picture = np.zeros((len(targets), 3), np.int64)
    range_of, uv, values = [], [], [np.zeros((0, 2), np.float32)]
    ranges: list[tuple[float, ...]] = []
    rows: list[int] = []
    for i, target in enumerate(targets):
        if target.gloss is None:
            facets = len(target.met_mesh.faces)
            range_of.append(np.full(facets, -1))
            uv.append(np.zeros((facets, 3, 2)))
            continue
        gloss = target.gloss
        range_of.append(np.where(gloss.range_of < 0, -1, gloss.range_of + len(ranges)))
        uv.append(gloss.uv)
        picture[i] = sum(map(len, values)), *gloss.picture.shape[:2]
        values.append(gloss.picture.reshape(-1, 2))
        for each in gloss.ranges:
            least, largest = each.metallic
            ranges.append((len(rows), each.last - each.first + 1, each.first, least, largest - least))
            rows += [row_of[material, around[i][0]] for material in each.materials]
    of_all = np.concatenate(values)
    return VariedGloss(
        np.concatenate(range_of).astype(np.int64), np.concatenate(uv), picture, of_all[:, 0].copy(),
        of_all[:, 1].copy(), np.array(ranges, RANGE), np.array(rows, np.int64),
    )  # fmt: skip


@kernel
def drawn_model(varied: VariedGloss, number: int, roughness: float, metallic: float, u: float, v: float) -> int:
    """Draw one of the scattering models mixed at a point, by its share; return its row.

    Parameters
    ----------
    varied : VariedGloss
    number : int
        Range of the facet.
    roughness, metallic : float
        From the picture.
    u, v : float
        Uniform in [0, 1).
    """
    own = varied.ranges[number]
    alpha = max(roughness * roughness, SMALLEST_ALPHA)
    place = min(max(ROUGHNESSES + np.log(alpha) / RATIO - own.least, 0.0), own.roughnesses - 1.0)
    k = int(place)
    if u < place - k:
        k += 1
    more = 1 if v * own.more < metallic - own.metallic else 0
    return int(varied.rows[own.first + 2 * k + more])
