"""Plane sections of a camera and the objects before it: (n, 2) polylines of z and y in the camera frame, mm.

The section planes have constant x; the meridional plane is x = 0.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import trimesh

from lfmesh.errors import LfmeshError
from lfmesh.geometry.array.lenslets import Lenslets, faces_at, shape_of, type_of
from lfmesh.geometry.frame import points
from lfmesh.geometry.lens.lens_shape import LensShape
from lfmesh.geometry.lens.main_order import has_several_orders
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.surfaces.edges import ring_profile
from lfmesh.geometry.surfaces.sag import heights
from lfmesh.geometry.surfaces.surface import is_revolved
from lfmesh.geometry.surfaces.tessellation import cap, mesh_heights
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.camera.lens import Lens

PROFILE_POINTS = 121
"""Points of a lens surface from the axis to its rim, denser towards the rim."""

SECTION_RINGS = 60
"""Triangle rings of a posed lens surface used for its section."""

ARROW = 0.08
"""Arrow head length of a thin lens, relative to its semi-diameter."""

LEAST_ACROSS = 1e-3
"""Sine of the angle between a rectangle and the section plane below which they count as parallel."""

ASIDE = 1e-7
"""Shift of the plane relative to the mesh size, so that it contains no vertex."""


class Glass(NamedTuple):
    """Section of a lens element.

    Attributes
    ----------
    name : str
        Name in `World.mesh`.
    refractive_index : float
        Of gradient-index glass, at the vertex of its front.
    is_gradient : bool
        True for gradient-index glass.
    front, back : (n, 2) float64, mm
        Profiles of its two faces, z and y, from the lower rim to the upper one; identical where two elements are
        cemented.
    outline : (m, 2) float64, mm
        Closed section including edges.
    """

    name: str
    refractive_index: float
    is_gradient: bool
    front: Array
    back: Array
    outline: Array


class ThinLens(NamedTuple):
    """Section of a thin lens: a line with arrow heads, pointing outwards if it converges, else inwards.

    Attributes
    ----------
    name : str
        Name in the path table: "surface[0]".
    focal_length_mm : float
    lines : list of (n, 2) float64, mm
        z and y of the line and the two arrow heads.
    """

    name: str
    focal_length_mm: float
    lines: list[Array]


class Diffractive(NamedTuple):
    """Section of a diffractive surface.

    Attributes
    ----------
    name : str
        Name in the path table.
    orders : str
        Its orders, in words.
    line : (n, 2) float64, mm
        z and y of its profile, from the lower rim to the upper one.
    """

    name: str
    orders: str
    line: Array


class Cut(NamedTuple):
    """Section of a flat rectangle, or of layers parallel to it, by a plane of constant x.

    Attributes
    ----------
    to_camera : (3, 4) float64
        Transform from the rectangle's own frame.
    start, ahead : (2,) float64
        Line in the rectangle at zero height: start + s · ahead, with s in mm, towards +y of the camera.
    lift : (2,) float64
        Shift of the line per mm of height.
    low, high : float, mm
        Range of s within the rectangle.
    """

    to_camera: Array
    start: Array
    ahead: Array
    lift: Array
    low: float
    high: float

    def local(self, s: Array, height: Array | float = 0.0) -> Array:
        """Return (n, 2) points in the rectangle's frame at positions s on the line, at a height."""
        height = np.broadcast_to(height, np.shape(s))
        return np.asarray(self.start + np.multiply.outer(s, self.ahead) + np.multiply.outer(height, self.lift))

    def section(self, s: Array, height: Array | float = 0.0) -> Array:
        """Return the same points as (n, 2) z and y in the camera frame."""
        local = np.column_stack([self.local(s, height), np.broadcast_to(height, np.shape(s))])
        return in_section(local @ self.to_camera[:, :3].T + self.to_camera[:, 3])


def in_section(points: Array) -> Array:
    """Return z and y of (n, 3) points."""
    return np.asarray(points)[:, [2, 1]]


def cut_through(name: str, to_camera: Array, size_mm: tuple[float, float], x: float = 0.0) -> Cut:
    """Cut a rectangle in the xy plane of its own frame by a plane of constant x in the camera frame.

    Parameters
    ----------
    name : str
        Name in messages.
    to_camera : (3, 4) float64
        Transform from the rectangle's own frame.
    size_mm : (width, height), mm
    x : float, mm
        Position of the plane, camera frame.

    Raises
    ------
    LfmeshError
        The plane misses the rectangle or is parallel to it, so `name` has no section.
    """
    across = to_camera[0, :2]
    square = float(across @ across)
    if square < LEAST_ACROSS**2:
        raise LfmeshError(f"{name}.pose: tilt_deg turns it into the plane of the drawing, y and z; it has no section")
    start = (x - to_camera[0, 3]) / square * across
    ahead = np.array([-across[1], across[0]]) / np.sqrt(square)
    if to_camera[1, :2] @ ahead < 0.0:
        ahead = -ahead
    low, high = -np.inf, np.inf
    for p, d, half in zip(start, ahead, np.multiply(0.5, size_mm), strict=True):
        if abs(d) > 1e-12:
            low, high = (
                max(low, (-half - p) / d if d > 0 else (half - p) / d),
                min(high, (np.copysign(half, d) - p) / d),
            )
        elif abs(p) > half:
            low, high = 1.0, -1.0
    if not low < high:
        raise LfmeshError(f"{name}.pose: the plane of the drawing, x = {x:.4g} mm, does not meet it; shift it less")
    return Cut(to_camera, start, ahead, -to_camera[0, 2] / square * across, float(low), float(high))


def lens_glass(shape: LensShape, indices: Array) -> list[Glass]:
    """Cut the elements of a lens by the meridional plane.

    Parameters
    ----------
    shape : LensShape
    indices : (K + 1,) float64
        Refractive indices before, between and behind the surfaces.
    """
    elements = []
    for number, k in enumerate(shape.elements):
        front, back = _profile(shape, k), _profile(shape, k + 1)
        if shape.surfaces["posed"][k : k + 2].any():
            # No rotational or mirror symmetry: join the corners for the edges.
            outline = np.concatenate([front, back[::-1]])
        else:
            edge = _edge(shape, k)
            lower = np.column_stack([edge[:, 0], -edge[:, 1]])
            outline = np.concatenate([front, edge[1:-1], back[::-1], lower[::-1][1:-1]])
        is_gradient = isinstance(shape.media[k + 1], Gradient)
        elements.append(Glass(f"lens[{number}]", float(indices[k + 1]), is_gradient, front, back, outline))
    return elements


def thin_lenses(shape: LensShape, lens: Lens) -> list[ThinLens]:
    """Cut the thin lenses of a lens by the meridional plane.

    Parameters
    ----------
    shape : LensShape
    lens : Lens
        Prescription of the lens.
    """
    found = []
    for k, number in enumerate(shape.numbers):
        focal_length, record = lens.surfaces[number].focal_length_mm, shape.surfaces[k]
        if focal_length is None:
            continue
        rim = float(record["semi_diameter"])
        barb = ARROW * rim if focal_length > 0.0 else -ARROW * rim
        z = np.array([-abs(barb), 0.0, abs(barb)])
        heads = [np.array([side * (rim - barb), side * rim, side * (rim - barb)]) for side in (-1.0, 1.0)]
        drawn = [(np.zeros(2), np.array([-rim, rim])), *((z, y) for y in heads)]
        in_camera = [
            points(record["pose"], np.column_stack([np.zeros_like(y), y, record["vertex_z"] + z])) for z, y in drawn
        ]
        found.append(ThinLens(f"surface[{number}]", focal_length, [in_section(line) for line in in_camera]))
    return found


def diffractive_surfaces(shape: LensShape, lens: Lens, names: Sequence[str]) -> list[Diffractive]:
    """Cut the diffractive surfaces of a lens by the meridional plane.

    Parameters
    ----------
    shape : LensShape
    lens : Lens
        Prescription of the lens.
    names : sequence of str
        Of its refracting surfaces.
    """
    found = []
    for k, number in enumerate(shape.numbers):
        phase = lens.surfaces[number].phase
        if phase is not None:
            others = " alone" if has_several_orders(phase) else ""
            found.append(Diffractive(names[k], f"order {phase.main_order:+d}{others}", _profile(shape, k)))
    return found


def _profile(shape: LensShape, k: int) -> Array:
    """Return the section of surface k from its lower to its upper rim."""
    posed = shape.surfaces[k]["posed"]
    if posed or not shape.analytic[k]:
        mesh = shape.caps[k]
        if posed and shape.analytic[k]:
            mesh = cap(shape.surfaces[k], SECTION_RINGS, shape.rims[k]).moved(shape.surfaces[k]["pose"])
        lines = mesh_section(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False))
        if not lines:
            raise LfmeshError(
                f"camera.lens.elements: shift_mm moves surface {shape.numbers[k]} beside the plane of the drawing, "
                "x = 0; shift it less"
            )
        line = max(lines, key=len)
        return line if line[0, 1] < line[-1, 1] else line[::-1]
    rim = shape.rims[k]
    y = rim * np.sin(np.linspace(-0.5 * np.pi, 0.5 * np.pi, 2 * PROFILE_POINTS - 1))
    return np.column_stack([shape.surfaces[k]["vertex_z"] + mesh_heights(shape.surfaces[k], np.zeros_like(y), y), y])


def _edge(shape: LensShape, k: int) -> Array:
    """Return the upper edge of the element behind surface k, (z, y) from its front to its back rim."""
    front, back = shape.surfaces[k], shape.surfaces[k + 1]
    if not (is_revolved(front) and is_revolved(back)):
        ends = np.stack([_profile(shape, k)[-1], _profile(shape, k + 1)[-1]])
        ring = shape.closures[k]
        lines = mesh_section(trimesh.Trimesh(ring.vertices, ring.faces, process=False)) if len(ring.faces) else []
        upper = max((line for line in lines if line[:, 1].mean() > 0.0), key=len, default=ends)
        back_to_front = np.linalg.norm(upper[0] - ends[0]) > np.linalg.norm(upper[-1] - ends[0])
        return upper[::-1] if back_to_front else upper
    return ring_profile(front, shape.rims[k], back, shape.rims[k + 1], shape.azimuths)[:, ::-1]


def sag_at_rim(shape: LensShape, k: int) -> float:
    """Return z of a surface at its clear aperture."""
    record = shape.surfaces[k]
    return float(record["vertex_z"] + heights(record, 0.0, record["semi_diameter"]))


def mesh_section(mesh: trimesh.Trimesh, x: float = 0.0) -> list[Array]:
    """Cut a mesh by the plane at x: (n, 2) polylines of z and y, closed ones with their first point repeated."""
    size = float(np.ptp(mesh.bounds, axis=0).max())
    segments = trimesh.intersections.mesh_plane(mesh, [1.0, 0.0, 0.0], [x + ASIDE * size, 0.0, 0.0])
    return chained(np.asarray(segments, dtype=np.float64).reshape(-1, 2, 3)[:, :, [2, 1]], ASIDE * size)


def chained(segments: Array, closeness: float) -> list[Array]:
    """Join segments (n, 2, 2) with coinciding ends to polylines."""
    ends = np.round(segments.reshape(-1, 2) / closeness).astype(np.int64)
    _, nodes = np.unique(ends, axis=0, return_inverse=True)
    pairs = nodes.reshape(-1, 2)
    at_node: dict[int, list[int]] = {}
    for i, pair in enumerate(pairs):
        if pair[0] != pair[1]:
            for node in pair:
                at_node.setdefault(int(node), []).append(i)
    used = pairs[:, 0] == pairs[:, 1]
    lines = []
    # Open lines start at ends of a single segment; the rest is closed.
    for start in sorted(at_node, key=lambda node: (len(at_node[node]) != 1, node)):
        line: list[Array] = []
        node = start
        while left := [i for i in at_node[node] if not used[i]]:
            i = left[0]
            used[i] = True
            end = int(pairs[i, 1] == node)
            line += [segments[i, end]] if not line else []
            line.append(segments[i, 1 - end])
            node = int(pairs[i, 1 - end])
        if line:
            lines.append(np.array(line))
    return lines


def curved_face(cut: Cut, mla: Lenslets, s: Array) -> Array:
    """Return the height of the array's curved face along a cut through it, mm: z of the array's frame.

    Parameters
    ----------
    cut : Cut
    mla : Lenslets
    s : (n,) float64, mm
        Positions along the cut.
    """
    height = np.zeros_like(s)
    centres = mla.lattice.centres().reshape(-1, 2)
    line = cut.local(s)
    reach = 0.5 * np.ptp(line, axis=0).max() + 2.0 * mla.lattice.pitch
    middle = 0.5 * (line.min(axis=0) + line.max(axis=0))
    numbers = np.flatnonzero(np.abs(centres - middle).max(axis=1) < reach)
    # The deep face of a tilted array is cut a little aside.
    for _ in range(4):
        p = cut.local(s, height)
        nearest = numbers[((p[:, None] - centres[numbers]) ** 2).sum(axis=2).argmin(axis=1)]
        for cell in np.unique(nearest):
            row, column = divmod(int(cell), mla.lattice.columns)
            curvature, ex, ey = shape_of(mla, column, row)
            there = nearest == cell
            kind = type_of(mla, column, row)
            height[there] = faces_at(mla, kind, curvature, p[there] - centres[cell] - (ex, ey))[0]
    return height
