"""Misaligned lens elements: poses, check for crossing surfaces, and rings that close the spaces.

The surfaces of an element move rigidly about the vertex of its first surface. Once two neighbouring surfaces have moved
relative to each other, the ring between their rims is no longer a surface of revolution.
"""

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.geometry import frame
from lfmesh.geometry.lens.surface_gaps import crossing
from lfmesh.geometry.meshes.mesh import Array, Mesh
from lfmesh.geometry.surfaces.edges import ANNULUS_LEAN, ROUNDING_OF_COORDINATES, ring_profile, stays_beside
from lfmesh.geometry.surfaces.surface import in_place, is_revolved, put_in_pose, surface_of
from lfmesh.geometry.surfaces.tessellation import mesh_heights, on_circles, revolved, stand_together, strip
from lfmesh.scene.camera.lens import Lens


def pose_of(lens: Lens, number: int) -> frame.Frame:
    """Return the rigid motion (3, 4) of a surface from its nominal position to its actual one.

    Parameters
    ----------
    lens : Lens
    number : int
        Number of the surface in the scene.
    """
    which = lens.element_of(number)
    if which is None:
        return frame.IDENTITY
    pose = lens.elements[which].pose
    if not any(pose.shift_mm) and not any(pose.tilt_deg):
        return frame.IDENTITY
    turn = frame.rotation(pose.tilt_deg)
    pivot = np.array([0.0, 0.0, lens.vertices_mm[lens.elements[which].surfaces[0]]])
    return np.column_stack([turn, pivot - turn @ pivot + pose.shift_mm])


def refuse_crossing_elements(lens: Lens) -> None:
    """Raise if poses make neighbouring surfaces, including the stop, cross inside their clear apertures.

    Parameters
    ----------
    lens : Lens
        Solved.

    Raises
    ------
    SceneError
        The message names the pose and the depth of the crossing, or its bound if a crossing is only possible.
    """
    records = []
    for number, s in enumerate(lens.surfaces):
        record = surface_of(s, vertex_z=lens.vertices_mm[number], semi_diameter=s.semi_diameter_mm or np.inf)
        put_in_pose(record, pose_of(lens, number))
        records.append(record)
    for number, (front, back) in enumerate(pairwise(records)):
        if stand_together(front, back):
            continue
        least = ROUNDING_OF_COORDINATES * float(back["semi_diameter"] + back["vertex_z"])
        found, possible = crossing(front, back, least)
        if possible > 0.0:
            raise SceneError(_refusal(lens, number, found, possible))


def _refusal(lens: Lens, number: int, found: float, possible: float) -> str:
    """Return the error message for poses that make surfaces `number` and `number` + 1 cross, or possibly cross."""
    which = [lens.element_of(n) for n in (number, number + 1)]
    named = ", ".join(
        f"camera.lens.elements[{i}].pose = {{ shift_mm = {list(lens.elements[i].pose.shift_mm)}, "
        f"tilt_deg = {list(lens.elements[i].pose.tilt_deg)} }}"
        for i in which
        if i is not None
    )
    if found == 0.0:
        return (
            f"{named}: surfaces {number} and {number + 1} touch inside their clear apertures and may cross, by up to "
            f"{possible:.4g} mm; increase the distance between them by this"
        )
    return (
        f"{named}: surfaces {number} and {number + 1} cross inside their clear apertures, by {found:.4g} mm; give "
        "smaller shifts and tilts, a larger distance between them, or smaller semi-diameters"
    )


def closure(lens: Lens, surfaces: NDArray[np.void], rims: list[float], numbers: list[int], k: int, count: int) -> Mesh:
    """Return the ring that joins the rims of surfaces k and k + 1 in their poses, and faces the axis.

    Parameters
    ----------
    lens : Lens
    surfaces : (K,) SURFACE
    rims : (K,) list of float, mm
    numbers : (K,) list of int
        Position of each refracting surface in the prescription.
    k : int
    count : int
        Number of azimuths.
    """
    front, back = surfaces[k], surfaces[k + 1]
    if not (is_revolved(front) and is_revolved(back)):
        return _closure_off_revolution(lens, front, rims[k], back, rims[k + 1], (numbers[k], numbers[k + 1]), count)
    profile = ring_profile(front, rims[k], back, rims[k + 1], count)
    if stand_together(front, back):
        ring = revolved(profile, count)
        return ring.moved(front["pose"]) if front["posed"] else ring
    phi = 2 * np.pi * np.arange(count) / count
    round_ = np.stack([np.cos(phi), np.sin(phi), np.zeros(count)], axis=-1)

    def circle(of: Any, point: Array) -> Array:
        placed = point[0] * round_ + [0.0, 0.0, point[1]]
        return frame.points(of["pose"], placed) if of["posed"] else placed

    first, last = circle(front, profile[0]), circle(back, profile[-1])
    # If one of them is turned about its axis, join each vertex to the nearest one of the other rim.
    turns = [int(np.argmin([np.square(first - np.roll(last, -n, axis=0)).sum() for n in range(count)]))]
    last = np.roll(last, -turns[0], axis=0)
    trials = [np.stack([first, last])]
    if len(profile) == 3:
        # The annulus starts from the rim of the narrower surface and moves with it.
        corner = circle(front, profile[1]) if rims[k] < rims[k + 1] else np.roll(circle(back, profile[1]), -turns[0], 0)
        trials.insert(0, np.stack([first, corner, last]))
    for lines in trials:
        if _clears(lines, front, rims[k], back, rims[k + 1]):
            return strip(lines)
    raise SceneError(
        f"{_refusal(lens, numbers[k], 0.0, 0.0).split(': surfaces')[0]}: the edge between surfaces {numbers[k]} and "
        f"{numbers[k + 1]} cuts one of them; give smaller shifts and tilts, or more room between them"
    )


def _closure_off_revolution(
    lens: Lens, front: Any, front_rim: float, back: Any, back_rim: float, numbers: tuple[int, int], count: int
) -> Mesh:
    """Return the ring between two surfaces if one is a biconic or toroid, with a rim that rises and falls."""
    first, last = (on_circles(s, np.array([r]), count)[0] for s, r in ((front, front_rim), (back, back_rim)))
    narrow, rim, wide = (front, front_rim, back_rim) if front_rim < back_rim else (back, back_rim, front_rim)
    turn = 0
    if not stand_together(front, back):
        turn = int(np.argmin([np.square(first - np.roll(last, -n, axis=0)).sum() for n in range(count)]))
    last = np.roll(last, -turn, axis=0)
    trials = [np.stack([first, last])]
    if front_rim != back_rim:
        # As with surfaces of revolution, a cylinder and an annulus that leans a little.
        phi = 2 * np.pi * np.arange(count) / count
        x, y = np.cos(phi), np.sin(phi)
        other = back if narrow is front else front
        z = mesh_heights(narrow, rim * x, rim * y) + narrow["vertex_z"]
        lean = mesh_heights(other, wide * x, wide * y) + other["vertex_z"] - z
        corner = np.column_stack([wide * x, wide * y, z + ANNULUS_LEAN * lean])
        corner = frame.points(narrow["pose"], corner) if narrow["posed"] else corner
        trials.insert(0, np.stack([first, corner if narrow is front else np.roll(corner, -turn, axis=0), last]))
    apart = last[:, 2] >= first[:, 2] - abs(back_rim - front_rim)
    for lines in trials:
        if apart.all() and _clears(lines, front, front_rim, back, back_rim):
            return strip(lines)
    raise SceneError(
        f"the rims of surfaces {numbers[0]} and {numbers[1]} cross; give more thickness, smaller semi-diameters"
        + (", or smaller shifts and tilts" if front["posed"] or back["posed"] else "")
    )


def _clears(lines: Array, front: Any, front_rim: float, back: Any, back_rim: float) -> bool:
    """Tell whether strips between closed polylines stay behind the front surface and in front of the back one."""
    return all(
        stays_beside(in_place(of, lines), of, rim, side, lines.shape[1])
        for of, rim, side in ((front, front_rim, 1.0), (back, back_rim, -1.0))
    )
