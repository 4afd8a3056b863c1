"""Round faces of targets and glass that rays meet exactly, in float64: spheres, cylinder walls and disks in a tree.

Parameters (s, t) in the unit square map to each face with equal areas, for sampling light sources: longitude and height
of a sphere (Archimedes) or wall, azimuth and squared radius of a disk. See `primitives` for the picture on a face.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import Frame, points
from lfmesh.geometry.meshes.box_tree import box_tree, next_node
from lfmesh.geometry.meshes.boxes import meets_box, slopes_of
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.ray import Ray
from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined, kernel

LARGEST_LEAF = 2
"""Largest number of faces in a leaf."""

MARGIN = 1e-9
"""Enlargement of boxes beyond their faces, relative to the largest leaf: more than the rounding of rays."""

SPHERE, WALL, FLAT = range(3)
"""Kinds of faces: a sphere, the wall of a cylinder about the third axis, and a disk facing along it."""

ROUND = np.dtype(
    [
        ("kind", "i8"),
        ("body", "i8"),
        ("centre", "f8", (3,)),  # mm
        ("axes", "f8", (3, 3)),  # rows: unit vectors of the face's own frame
        ("radius", "f8"),  # mm
        ("half", "f8"),  # mm, half the height of a wall
        ("area", "f8"),  # mm²
        ("corner", "f8", (2,)),  # lower left corner of its picture in the target's texture
        ("extent", "f8", (2,)),  # of the picture in the texture
    ]
)


@by_address
class RoundFaces(NamedTuple):
    """Round faces in a tree of boxes (see `box_tree`)."""

    faces: NDArray[np.void]  # (n,) ROUND
    first: int  # number of the first face among the facets of object space
    low: Array  # (2 · leaves, 3) mm
    high: Array
    order: NDArray[np.int64]  # (leaves · size,) faces, leaf by leaf
    leaves: int
    size: int


def round_faces(bodies: Sequence[NDArray[np.void]], through: Frame, first: int) -> RoundFaces | None:
    """Return the faces of some bodies in another frame, in a tree; None if there are none.

    Parameters
    ----------
    bodies : sequence of (k,) ROUND
        Faces of each target; its number becomes their `body`.
    through : (3, 4) float64
        Transform to the new frame.
    first : int
        See `RoundFaces`.
    """
    faces = np.concatenate([np.zeros(0, ROUND), *bodies])
    if not len(faces):
        return None
    faces["body"] = np.repeat(np.arange(len(bodies)), [len(each) for each in bodies])
    faces["centre"] = points(through, faces["centre"])
    faces["axes"] = faces["axes"] @ through[:, :3].T
    low, high = boxes_of(faces)
    tree = box_tree(low, high, 0.5 * (low + high), LARGEST_LEAF, MARGIN)
    return RoundFaces(faces, first, tree.low, tree.high, tree.order, tree.leaves, tree.size)


def boxes_of(faces: NDArray[np.void]) -> tuple[Array, Array]:
    """Return the lowest and the highest corners of the boxes round faces (n,) ROUND, each (n, 3) mm."""
    kind, radius, half = (faces[name][:, None] for name in ("kind", "radius", "half"))
    axis = faces["axes"][:, 2]
    across = radius * np.sqrt(np.maximum(1.0 - axis**2, 0.0))
    reach = np.where(kind == SPHERE, radius, across + np.where(kind == WALL, half * np.abs(axis), 0.0))
    return faces["centre"] - reach, faces["centre"] + reach


def places_in_picture(face: np.void, s: Array, t: Array) -> Array:
    """Return the positions (n, 2) in its target's texture of a face's points.

    Parameters
    ----------
    face : ROUND
    s, t : (n,) float64
        Parameters of the points.
    """
    if face["kind"] == SPHERE:
        place = np.column_stack([s, 0.5 + np.arcsin(2.0 * t - 1.0) / np.pi])
    elif face["kind"] == WALL:
        place = np.column_stack([s, t])
    else:
        r = np.sqrt(t)
        place = 0.5 + 0.5 * np.column_stack([r * np.cos(2.0 * np.pi * s), r * np.sin(2.0 * np.pi * s)])
    return np.asarray(face["corner"] + face["extent"] * place)


def round_finder(is_met: Any) -> Any:
    """Make the kernel that finds the first round face that a ray meets.

    Parameters
    ----------
    is_met : kernel
        Called as ``is_met(state, number, t, along)`` for a face crossed at distance t, where along is outward
        normal · direction. Returns False if the ray passes as though there were no face.

    Returns
    -------
    first_round : kernel
    """

    @kernel
    def first_round(rounds: RoundFaces, state: Any, ray: Ray, left: int, until: float) -> tuple[int, float, float]:
        """Return the number of the first face that a ray meets, the distance, and outward normal · direction; −1: none.

        Parameters
        ----------
        rounds : RoundFaces
        state : Any
            Passed on to `is_met`.
        ray : Ray
        left : int
            Number of the face that the ray starts on; out of range if none.
        until : float, mm
            Distance within which to search.
        """
        found, nearest, steepness = -1, until, 0.0
        slopes, node = slopes_of(ray), 1
        while node > 0:
            if meets_box(rounds.low[node], rounds.high[node], ray, slopes, 0.0, nearest):
                if node < rounds.leaves:
                    node *= 2
                    continue
                begin = (node - rounds.leaves) * rounds.size
                for k in range(begin, begin + rounds.size):
                    number = rounds.order[k]
                    enters, leaves, steep = _crossings(rounds.faces[number], ray, number == left)
                    if 0.0 < enters < nearest and is_met(state, number, enters, -steep):
                        found, nearest, steepness = number, enters, -steep
                    elif 0.0 < leaves < nearest and is_met(state, number, leaves, steep):
                        found, nearest, steepness = number, leaves, steep
            node = next_node(node)
        return found, nearest, steepness

    return first_round


@inlined
def _always(state: Any, number: int, t: float, along: float) -> bool:
    """Accept every face."""
    return True


first_round = round_finder(_always)
"""Finder of the first face, regardless of the light's behaviour there; `state` is unused."""


@inlined
def _crossings(face: Any, ray: Ray, starts_on_it: bool) -> tuple[float, float, float]:
    """Return the distances to the inward and outward crossing of a face by a line, and |normal · direction| there.

    They are inf if the line misses the face. A ray that starts on a face crosses it only at the other root.
    """
    if face.kind == SPHERE:
        return _crossings_of_sphere(face, ray, starts_on_it)
    x, y, z, dx, dy, dz = _own(face, ray)
    radius2 = face.radius * face.radius
    if face.kind == FLAT:
        t = -z / dz
        if starts_on_it or not abs(t) < np.inf:
            return np.inf, np.inf, 0.0
        x, y = x + t * dx, y + t * dy
        if not x * x + y * y <= radius2:
            return np.inf, np.inf, 0.0
        return (t, np.inf, -dz) if dz < 0.0 else (np.inf, t, dz)
    across2 = dx * dx + dy * dy
    middle = -(x * dx + y * dy) / across2
    nx, ny = x + middle * dx, y + middle * dy
    room = radius2 - nx * nx - ny * ny
    if not (across2 > 0.0 and room >= 0.0):
        return np.inf, np.inf, 0.0
    half = np.sqrt(room / across2)
    enters, leaves = middle - half, middle + half
    if starts_on_it:
        enters, leaves, half = np.inf, 2.0 * middle, middle
    if not abs(z + enters * dz) <= face.half:
        enters = np.inf
    if not abs(z + leaves * dz) <= face.half:
        leaves = np.inf
    return enters, leaves, half * across2 / face.radius


@inlined
def _crossings_of_sphere(face: Any, ray: Ray, starts_on_it: bool) -> tuple[float, float, float]:
    """Return the result of `_crossings` for a sphere.

    The distance from the line to the centre is computed first, since a difference of squares loses digits for distant
    starts (E. Haines, J. Günther and T. Akenine-Möller, "Precision improvements for ray/sphere intersection", in Ray
    Tracing Gems, 2019).
    """
    centre = face.centre
    x, y, z = ray.x - centre[0], ray.y - centre[1], ray.z - centre[2]
    middle = -(x * ray.dx + y * ray.dy + z * ray.dz)
    x, y, z = x + middle * ray.dx, y + middle * ray.dy, z + middle * ray.dz
    room = face.radius * face.radius - x * x - y * y - z * z
    if room < 0.0:
        return np.inf, np.inf, 0.0
    half = np.sqrt(room)
    if starts_on_it:
        return np.inf, 2.0 * middle, middle / face.radius
    return middle - half, middle + half, half / face.radius


@inlined
def _own(face: Any, ray: Ray) -> Ray:
    """Return a ray in a face's own frame."""
    x, y, z = ray.x - face.centre[0], ray.y - face.centre[1], ray.z - face.centre[2]
    a = face.axes
    return Ray(
        a[0, 0] * x + a[0, 1] * y + a[0, 2] * z,
        a[1, 0] * x + a[1, 1] * y + a[1, 2] * z,
        a[2, 0] * x + a[2, 1] * y + a[2, 2] * z,
        a[0, 0] * ray.dx + a[0, 1] * ray.dy + a[0, 2] * ray.dz,
        a[1, 0] * ray.dx + a[1, 1] * ray.dy + a[1, 2] * ray.dz,
        a[2, 0] * ray.dx + a[2, 1] * ray.dy + a[2, 2] * ray.dz,
    )


@kernel
def lies_in(face: Any, x: float, y: float, z: float) -> bool:
    """Tell whether a point lies in the closed body of a face; a cylinder is tested by its wall, never by its flat ends.

    Parameters
    ----------
    face : ROUND
    x, y, z : float, mm
    """
    own = _own(face, Ray(x, y, z, 0.0, 0.0, 1.0))
    if face.kind == FLAT:
        return False
    across2 = own.x * own.x + own.y * own.y
    if face.kind == WALL:
        return across2 < face.radius * face.radius and abs(own.z) < face.half
    return across2 + own.z * own.z < face.radius * face.radius


@kernel
def round_normal(face: Any, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the outward unit normal at a point of a face.

    Parameters
    ----------
    face : ROUND
    x, y, z : float, mm
    """
    a, centre = face.axes, face.centre
    if face.kind == FLAT:
        return a[2, 0], a[2, 1], a[2, 2]
    x, y, z = x - centre[0], y - centre[1], z - centre[2]
    if face.kind == WALL:
        height = a[2, 0] * x + a[2, 1] * y + a[2, 2] * z
        x, y, z = x - height * a[2, 0], y - height * a[2, 1], z - height * a[2, 2]
    over = 1.0 / np.sqrt(x * x + y * y + z * z)
    return over * x, over * y, over * z


@kernel
def parameters_at(face: Any, x: float, y: float, z: float) -> tuple[float, float]:
    """Return the parameters (s, t) of a point of a face.

    Parameters
    ----------
    face : ROUND
    x, y, z : float, mm
    """
    own = _own(face, Ray(x, y, z, 0.0, 0.0, 1.0))
    if face.kind == SPHERE:
        return 0.5 + np.arctan2(own.x, own.z) / (2.0 * np.pi), 0.5 + 0.5 * own.y / face.radius
    turn = np.arctan2(own.y, own.x) / (2.0 * np.pi)
    if face.kind == WALL:
        return (0.75 - turn) % 1.0, 0.5 - 0.5 * own.z / face.half
    return turn % 1.0, (own.x * own.x + own.y * own.y) / (face.radius * face.radius)


@kernel
def point_at(face: Any, s: float, t: float) -> tuple[float, float, float]:
    """Return the point of a face, mm, at some parameters.

    Parameters
    ----------
    face : ROUND
    s, t : float
    """
    radius = face.radius
    if face.kind == SPHERE:
        height, turn = 2.0 * t - 1.0, np.pi * (2.0 * s - 1.0)
        around = radius * np.sqrt(max(1.0 - height * height, 0.0))
        x, y, z = around * np.sin(turn), radius * height, around * np.cos(turn)
    elif face.kind == WALL:
        turn = 2.0 * np.pi * (0.75 - s)
        x, y, z = radius * np.cos(turn), radius * np.sin(turn), face.half * (1.0 - 2.0 * t)
    else:
        around, turn = radius * np.sqrt(t), 2.0 * np.pi * s
        x, y, z = around * np.cos(turn), around * np.sin(turn), 0.0
    a, centre = face.axes, face.centre
    return (
        centre[0] + a[0, 0] * x + a[1, 0] * y + a[2, 0] * z,
        centre[1] + a[0, 1] * x + a[1, 1] * y + a[2, 1] * z,
        centre[2] + a[0, 2] * x + a[1, 2] * y + a[2, 2] * z,
    )


@kernel
def place_in_picture(face: Any, x: float, y: float, z: float) -> tuple[float, float]:
    """Return the position of a face's point in its target's texture.

    Parameters
    ----------
    face : ROUND
    x, y, z : float, mm
    """
    if face.kind == FLAT:
        own = _own(face, Ray(x, y, z, 0.0, 0.0, 1.0))
        u, v = 0.5 + 0.5 * own.x / face.radius, 0.5 + 0.5 * own.y / face.radius
    else:
        u, v = parameters_at(face, x, y, z)
        if face.kind == SPHERE:
            v = 0.5 + np.arcsin(min(max(2.0 * v - 1.0, -1.0), 1.0)) / np.pi
    return face.corner[0] + face.extent[0] * u, face.corner[1] + face.extent[1] * v
