"""Refuse media that bend light where rays cannot be traced through them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.geometry import frame
from lfmesh.geometry.meshes.mesh import Array, Mesh
from lfmesh.geometry.objects.targets import TargetMesh, named_target
from lfmesh.scene import Scene
from lfmesh.transport.packets.packet import CAMERA_FRAME, WORLD_FRAME
from lfmesh.transport.tables.bending_fields import FieldMedium

ROUNDING = 1e-12
"""Relative reach behind the front of the lens that counts as rounding."""

PARALLEL = 1e-12
"""Length of a separating axis, over those of the edges it is perpendicular to, below which it has no direction."""

DIRECTIONS = np.eye(3)


def refuse_untraceable_fields(
    scene: Scene, media: Sequence[FieldMedium], targets: list[TargetMesh], moves: Array, front: float
) -> None:
    """Refuse media that bend polarised or diffracted light, or that reach the lens or glass.

    Parameters
    ----------
    scene : Scene
    media : sequence of FieldMedium
    targets : list of TargetMesh
        World frame.
    moves : (6, 6, 3, 4) float64
        See `frame_table`.
    front : float, mm
        z of the front of the lens, camera frame.

    Raises
    ------
    SceneError
        Names the medium and the reason.
    """
    for each in media:
        name = each.medium.name
        if scene.transport.polarisation:
            raise SceneError(f"{name}: bends light, which transport.polarisation does not follow; omit one of them")
        if scene.transport.diffraction != "none":
            raise SceneError(
                f'{name}: bends light, but transport.diffraction = "{scene.transport.diffraction}" needs straight rays '
                "before the lens; omit one of them"
            )
        behind = frame.points(moves[WORLD_FRAME, CAMERA_FRAME], each.medium.corners_mm())[:, 2]
        if behind.max() > front + ROUNDING * np.abs(behind).max():
            raise SceneError(
                f"{name}: reaches {behind.max() - front:.6g} mm behind the front of the lens; a medium that bends "
                "light must stay before it: move it, or make its bounds smaller"
            )
        for i, target in enumerate(targets):
            if scene.targets[i].refractor is not None and _reaches_into(target, each):
                raise SceneError(
                    f"{named_target(scene, i)} reaches into {name}, which bends light; glass must stay outside its "
                    "bounds: move one of them"
                )


def _reaches_into(body: TargetMesh, each: FieldMedium) -> bool:
    """Tell whether a body of glass has a place in common with the box of a field; contact does not count.

    A round body is represented by an enclosing mesh.
    """
    to_own = frame.inverse(each.medium.to_world)
    mesh: Mesh = body.hull
    low, high = each.medium.bounds_mm
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    corners = frame.points(to_own, mesh.vertices)[mesh.faces] - middle
    if triangles_meet_box(corners, half).any():
        return True
    return bool(body.holds(frame.points(each.medium.to_world, middle[None])).any())


def triangles_meet_box(corners: Array, half: Array) -> NDArray[np.bool_]:
    """Tell which triangles have points inside a box about the origin, (m,) bool.

    A box and a triangle are apart if and only if an axis separates them: a normal of the box, that of the triangle, or
    a direction perpendicular to an edge of each (S. Gottschalk, M. C. Lin and D. Manocha, SIGGRAPH 1996).

    Parameters
    ----------
    corners : (m, 3, 3) float64, mm
    half : (3,) float64, mm
        Half edges of the box.
    """
    edges = np.roll(corners, -1, axis=1) - corners
    axes = [np.broadcast_to(own, (len(corners), 3)) for own in DIRECTIONS]
    axes.append(np.cross(edges[:, 0], edges[:, 1]))
    axes += [np.cross(own, edges[:, k]) for own in DIRECTIONS for k in range(3)]
    meets = np.ones(len(corners), np.bool_)
    size = np.abs(corners).max(axis=(1, 2), initial=0.0) + half.max()
    for axis in axes:
        length = np.linalg.norm(axis, axis=1)
        along = np.einsum("mki,mi->mk", corners, axis)
        reach = np.abs(axis) @ half - ROUNDING * size * length
        apart = (along.min(axis=1) >= reach) | (along.max(axis=1) <= -reach)
        meets &= ~(apart & (length > PARALLEL * size))
    return meets
