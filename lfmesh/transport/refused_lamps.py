"""Refuse bodies of glass in object space round the camera or a lamp; both must stand in air."""

import numpy as np

from lfmesh.errors import SceneError
from lfmesh.geometry.meshes.mesh import Array, crossings
from lfmesh.geometry.objects.primitives import RINGS
from lfmesh.geometry.objects.targets import TargetMesh, named_target
from lfmesh.scene import Light, Scene
from lfmesh.scene.light.region import Region
from lfmesh.transport.events.facets import FLOAT32_GRAIN
from lfmesh.transport.tables.contacts import CUT

Bodies = dict[int, TargetMesh]
"""Bodies of glass by the numbers of their targets."""


def refuse_camera_and_lamps_inside(scene: Scene, bodies: Bodies, front: Array) -> None:
    """Refuse glass that encloses the camera's first surface, a lamp or part of a lamp.

    Parameters
    ----------
    scene : Scene
    bodies : dict of TargetMesh
        Bodies of glass; the error names the first one that holds a point.
    front : (n, 3) float64, mm
        Points of the camera's first surface, world frame.

    Raises
    ------
    SceneError
        Names the body.
    """
    body = _holding(bodies, front)
    if body is not None:
        raise SceneError(
            f"{named_target(scene, body)}: the camera's first surface lies inside this glass, but the camera must "
            "stand in air: move the body away, or give it a hollow around the camera, a surface that faces inwards"
        )
    for number, light in enumerate(scene.lights):
        near = {i: each for i, each in bodies.items() if _reaches(each.box_mm, light.region)}
        if near:
            _refuse_lamp_inside(scene, near, number, light)


def _reaches(box: Array, region: Region | None) -> bool:
    """Tell whether a lamp may reach into a box, given by its lowest and highest corner (2, 3)."""
    if region is None:
        return False
    (low, high), middle, size = box, region.centre_mm, region.size_mm
    return bool((middle + size >= low).all() and (middle - size <= high).all())


def _refuse_lamp_inside(scene: Scene, bodies: Bodies, number: int, light: Light) -> None:
    """Refuse a lamp with its middle in glass, or with a surface of glass passing through it."""
    region = light.region
    if region is None:
        return
    body = next((i for i, each in bodies.items() if _encloses(each, region.centre_mm)), None)
    if body is None and region.size_mm > 0.0:
        body = next((i for i, each in bodies.items() if _meets(each, region)), None)
    if body is not None:
        raise SceneError(
            f"lights[{number}].{light.place_in_words} lies inside {named_target(scene, body)}, but a lamp must stand "
            "in air: move it, or give the body a hollow around it, a surface that faces inwards"
        )


def _encloses(body: TargetMesh, place: Array) -> bool:
    """Tell whether a body holds a lamp's middle (3,), mm; a lamp on its surface, to rounding, is moved off later."""
    grain = FLOAT32_GRAIN * float(np.abs(place).sum())
    return bool(body.holds(place[None]).any()) and body.distance_mm(place) > grain


def _meets(body: TargetMesh, region: Region) -> bool:
    """Tell whether an extended lamp, its middle outside a body, reaches into the glass deeper than contact.

    A round body is represented by an enclosing mesh, at most 7e-4 of its radius larger.
    """
    mesh = body.mesh if body.round is None else body.round.hull(RINGS)
    facets = mesh.vertices[mesh.faces]
    low, high = facets.min(axis=(0, 1)), facets.max(axis=(0, 1))
    if (np.abs(0.5 * (low + high) - region.centre_mm) > 0.5 * (high - low) + region.size_mm).any():
        return False
    deep = CUT * min(float((high - low).max()), region.size_mm)
    ends = region.corners_mm
    if len(ends) == 2:
        # The line enters and leaves the glass only at its crossings with the surface.
        shares, inside = crossings(facets, *ends)
        places = np.unique([0.0, *shares[inside], 1.0])
        middles = 0.5 * (places[1:] + places[:-1])[np.diff(places) * region.size_mm > deep]
        return bool(body.holds(ends[0] + middles[:, None] * (ends[1] - ends[0])).any())
    # Facets that pass through the plane of the lamp, and their segments in it.
    normal = np.cross(*region.half_mm)
    height = (facets - region.centre_mm) @ (normal / np.linalg.norm(normal))
    passes = (height.min(axis=1) < -deep) & (height.max(axis=1) > deep)
    facets, height = facets[passes], height[passes]
    # Put the corner alone on its side first: both edges from it meet the plane.
    above = height > 0.0
    alone = np.argmax(above == (above.sum(axis=1) == 1)[:, None], axis=1)
    order = (alone[:, None] + np.arange(3)) % 3
    facets, height = (np.take_along_axis(each, index, axis=1) for each, index in (
        (facets, order[:, :, None]), (height, order)
    ))  # fmt: skip
    start, end = (
        facets[:, 0] + (height[:, 0] / (height[:, 0] - height[:, k]))[:, None] * (facets[:, k] - facets[:, 0])
        for k in (1, 2)
    )
    return bool(region.holds(start, end, np.full(len(facets), deep)).any())


def _holding(bodies: Bodies, points: Array) -> int | None:
    """Return the first body that holds any of the points."""
    return next((i for i, body in bodies.items() if body.holds(points).any()), None)
