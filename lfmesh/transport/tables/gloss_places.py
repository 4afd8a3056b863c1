"""Places of glossy targets: a gloss reflects by its index over that of the medium round it."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.geometry.objects.targets import TargetMesh
from lfmesh.optics.gltf_material import DIELECTRIC_INDEX
from lfmesh.scene import Scene
from lfmesh.transport.tables.hosts import Hosts
from lfmesh.transport.tables.tables import AIR, OPAQUE

INWARDS = 1.0 / 16.0
"""Share of the way to a target's middle by which places are asked for: facets that rest on a wall are in the liquid."""


def media_round_gloss(scene: Scene, targets: list[TargetMesh], hosts: Hosts) -> NDArray[np.int64]:
    """Return the number of the medium that each target stands in, (targets,); of those without gloss, what bodies do.

    Parameters
    ----------
    scene : Scene
    targets : list of TargetMesh
        World frame.
    hosts : Hosts

    Raises
    ------
    SceneError
        A glossy target stands in media of several indices, or its gloss, or its file's, has no higher index than the
        medium.
    """
    numbers = np.full(len(targets), AIR)
    for i, (given, target) in enumerate(zip(scene.targets, targets, strict=True)):
        gloss = given.material.gloss
        if hosts.medium[i] != OPAQUE or (gloss is None and not target.materials):
            continue
        places = target.mesh.vertices[target.mesh.faces].mean(axis=1)
        places += INWARDS * (places.mean(axis=0) - places)
        bodies = np.unique(hosts.top_round(places))
        media = np.where(bodies < 0, AIR, hosts.medium[bodies])
        indices = hosts.media.indices[media]
        if (indices != indices[0]).any():
            found = ", ".join(f"{index:.6g}" for index in indices[:, 0])
            raise SceneError(
                f"targets[{i}]: stands in media of the refractive indices {found}, by which its gloss reflects "
                "differently; move it, or make it a target in each medium"
            )
        numbers[i] = media[0]
        most = float(indices[0].max())
        where = "camera.object_medium" if bodies[0] < 0 else hosts.names[bodies[0]]
        if gloss is not None and gloss.index is not None and not gloss.index > most:
            raise SceneError(
                f"targets[{i}].material.gloss.index = {gloss.index:g}: must be above that of {where}, {most:.6g}"
            )
        if any(each.metallic < 1.0 for each in target.materials) and not most < DIELECTRIC_INDEX:
            raise SceneError(
                f"targets[{i}].file = {given.file!r}: the gloss of glTF materials has the index {DIELECTRIC_INDEX:g}, "
                f'which must be above that of {where}, {most:.6g}; give materials = "ignore", and material'
            )
    return numbers
