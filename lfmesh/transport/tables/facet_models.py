"""Scattering models of facets: a row for each target or file material, in each medium around it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.objects.targets import TargetMesh
from lfmesh.optics.gltf_material import GltfMaterial
from lfmesh.scene import Scene
from lfmesh.transport.tables.gloss_places import media_round_gloss
from lfmesh.transport.tables.hosts import Hosts
from lfmesh.transport.tables.scattering import ScatteringTables, scattering_tables
from lfmesh.transport.tables.varied_gloss import VariedGloss, varied_gloss

Rows = NDArray[np.int64]
Key = tuple[int | GltfMaterial, int]
"""Target or file material, and number of a medium."""


class FacetModels(NamedTuple):
    """Scattering models, and the model of each facet."""

    scattering: ScatteringTables
    of_facets: Rows  # (m,) row of each facet, in the first medium around its target
    in_media: Rows  # (rows, media) row of the same surface in each medium
    varied: VariedGloss  # gloss that a picture varies; `of_facets` gives its first model


def facet_models(
    scene: Scene, targets: list[TargetMesh], hosts: Hosts, wavelengths_nm: tuple[float, ...], reflectances: list[Array]
) -> FacetModels:
    """Return the scattering models of targets and of the materials in their files.

    The row of a target's own material is the number of the target.

    Parameters
    ----------
    scene : Scene
    targets : list of TargetMesh
        World frame.
    hosts : Hosts
    wavelengths_nm : tuple of float
    reflectances : list of (wavelengths,) float64
        Of the targets.
    """
    around = media_round_gloss(scene, targets, hosts)
    own: list[tuple[int, int]] = [(i, media[0]) for i, media in enumerate(around)]
    own += [(i, medium) for i, media in enumerate(around) for medium in media[1:]]
    used = [(each, medium) for i, media in enumerate(around) for medium in media for each in targets[i].materials]
    from_files = list(dict.fromkeys(used))
    keys: list[Key] = [*own, *from_files]
    rows = {key: row for row, key in enumerate(keys)}
    scattering = scattering_tables(
        [scene.targets[i].material for i, _ in own],
        wavelengths_nm,
        [reflectances[i] for i, _ in own],
        [material for material, _ in from_files],
        hosts.media.indices[[medium for _, medium in keys]],
    )
    of_facets = [np.zeros(0, np.int64)]
    for i, target in enumerate(targets):
        chosen = np.full(len(target.met_mesh.faces), i)
        if target.material_of is not None:
            chosen = np.append([rows[each, around[i][0]] for each in target.materials], i)[target.material_of]
        of_facets.append(chosen)
    return FacetModels(
        scattering, np.concatenate(of_facets).astype(np.int64),
        _in_media(keys, hosts.media.indices, len(scattering.models)), varied_gloss(targets, around, rows),
    )  # fmt: skip


def _in_media(keys: list[Key], indices: Array, count: int) -> Rows:
    """Return the row, (count, media), of each model's surface in each medium, equal for media of one index.

    Light in a medium that only touches a surface, within the tolerance for contact, meets the model of the surface's
    first medium.

    Parameters
    ----------
    keys : list of Key
        Of the first rows; the others are used in no medium.
    indices : (media, wavelengths) float64
    count : int
    """
    in_media = np.tile(np.arange(count)[:, None], len(indices))
    same: dict[int | GltfMaterial, list[int]] = {}
    for row, (what, _) in enumerate(keys):
        same.setdefault(what, []).append(row)
    for rows in same.values():
        for row in rows if len(rows) > 1 else ():
            in_media[np.ix_(rows, (indices == indices[keys[row][1]]).all(axis=1))] = row
    return in_media
