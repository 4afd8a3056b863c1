"""Media around glossy targets: gloss reflects by its index over the index of the surrounding medium."""

import numpy as np

from lfmesh.errors import SceneError
from lfmesh.geometry.objects.targets import TargetMesh
from lfmesh.optics.gltf_material import DIELECTRIC_INDEX
from lfmesh.scene import Scene
from lfmesh.transport.tables.hosts import Hosts
from lfmesh.transport.tables.tables import AIR, OPAQUE


def media_round_gloss(scene: Scene, targets: list[TargetMesh], hosts: Hosts) -> list[tuple[int, ...]]:
    """Return the numbers of the media around each target's surface, one for each index among them.

    A target without gloss scatters alike in all media; its only number is `AIR`.

    Parameters
    ----------
    scene : Scene
    targets : list of TargetMesh
        World frame.
    hosts : Hosts

    Raises
    ------
    SceneError
        A gloss, also of a file's materials, has a lower index than a medium that the target reaches into.
    """
    found: list[tuple[int, ...]] = []
    for i, (given, target) in enumerate(zip(scene.targets, targets, strict=True)):
        if hosts.medium[i] != OPAQUE or (given.material.gloss is None and not target.materials):
            found.append((AIR,))
            continue
        bodies = hosts.along(target)
        for body in bodies:
            _refuse_lower_index(scene, i, target, hosts, body)
        media = sorted({hosts.number_of(body) for body in bodies})
        _, first = np.unique(hosts.media.indices[media], axis=0, return_index=True)
        found.append(tuple(media[k] for k in sorted(first)))
    return found


def _refuse_lower_index(scene: Scene, number: int, target: TargetMesh, hosts: Hosts, body: int | None) -> None:
    """Refuse a gloss that would reflect light totally: its facets have no table for that."""
    given = scene.targets[number]
    gloss, most = given.material.gloss, float(hosts.index_of(body).max())
    where = "camera.object_medium" if body is None else hosts.names[body]
    move = "" if body is None else "move the target out of it, or "
    if gloss is not None and gloss.index is not None and gloss.index < most:
        raise SceneError(
            f"targets[{number}].material.gloss.index = {gloss.index:g}: must not be below that of {where}, {most:.6g}, "
            f"into which the target reaches: {move}give a higher index"
        )
    if any(each.metallic < 1.0 for each in target.materials) and most > DIELECTRIC_INDEX:
        raise SceneError(
            f"targets[{number}].file = {given.file!r}: the gloss of glTF materials has the index "
            f"{DIELECTRIC_INDEX:g}, which must not be below that of {where}, {most:.6g}, into which the target "
            'reaches; give materials = "ignore", and material'
        )
