"""Meshes of the microlens array: one cell of each type, for Embree, and the whole array as a closed body."""

from typing import TYPE_CHECKING

import numpy as np

from lfmesh.geometry.array.lattice import Lattice
from lfmesh.geometry.meshes.mesh import Array, Index, Mesh, joined

if TYPE_CHECKING:
    import trimesh
from lfmesh.geometry.array.lenslets import SUBDIVISIONS, Lenslets, border_segments, faces_at, shape_of, type_of

OFFSET = 8.0
"""Distance, in pitches, between cells of different types in their common Embree scene."""


def cell_pattern(lattice: Lattice, subdivisions: int = SUBDIVISIONS) -> tuple[Array, Index]:
    """Tile the cell at the origin: return points (v, 2), mm, and triangles (f, 3) facing +z.

    Points on a side are equally spaced, so neighbouring cells share them.
    """
    corners = lattice.corners()
    points: list[Array] = []
    faces: list[Index] = []
    n = border_segments(lattice.hexagonal, subdivisions)
    count = 0
    # One fan of triangles per side, each refined n-fold.
    index = {(i, j): i * (i + 1) // 2 + j for i in range(n + 1) for j in range(i + 1)}
    fan = np.array(
        [(index[i, j], index[i + 1, j], index[i + 1, j + 1]) for i in range(n) for j in range(i + 1)]
        + [(index[i, j], index[i + 1, j + 1], index[i, j + 1]) for i in range(1, n) for j in range(i)]
    )
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        points.append(np.array([a * (i - j) / n + b * j / n for i in range(n + 1) for j in range(i + 1)]))
        faces.append(fan + count)
        count += len(points[-1])
    return _merged(np.concatenate(points), np.concatenate(faces), lattice.pitch)


def _merged(points: Array, faces: Index, scale: float) -> tuple[Array, Index]:
    """Merge points that agree to 1e-9 of the scale."""
    _, first, inverse = np.unique(
        np.round(points / (scale * 1e-9)).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    return points[first], inverse.reshape(-1)[faces]


def cell_mesh(mla: Lenslets, kind: int) -> Mesh:
    """Return the curved face over one cell of a type, centred at the origin and facing +z, with its neighbours' rims.

    The rims are the neighbours' triangles that touch the cell. With them, a ray along the border meets a facet on
    either side. The neighbours are assumed to have the same type.
    """
    pattern, faces = cell_pattern(mla.lattice)
    patch = mla.lattice._replace(columns=3, rows=3)
    centres = patch.centres().reshape(-1, 2)
    centres = centres - patch.centres()[1, 1]
    apothem = 0.5 * mla.lattice.pitch
    parts = []
    for centre in centres:
        z, normals = faces_at(mla, kind, float(mla.curvature[kind]), pattern)
        vertices = np.column_stack([pattern + centre, z])
        near = _cell_norm(mla.lattice, vertices[:, :2]) <= apothem * (1.0 + 1e-9)
        keep = faces[near[faces].any(axis=1)]
        parts.append(Mesh(vertices, keep, normals[keep]))
    return joined(parts)


def _cell_norm(lattice: Lattice, p: Array) -> Array:
    """Return the norm of points; its ball of radius pitch/2 is the cell."""
    if not lattice.hexagonal:
        return np.abs(p).max(axis=1)
    turn = np.deg2rad([0.0, 60.0, 120.0])
    return np.abs(p @ np.stack([np.cos(turn), np.sin(turn)])).max(axis=1)


def mla_mesh(
    mla: Lenslets, subdivisions: int = SUBDIVISIONS, back: Lenslets | None = None, shift_mm: Array | None = None
) -> "trimesh.Trimesh":
    """Return the whole array as a closed mesh: one shell if all lenslets are alike.

    Otherwise neighbours meet in steps, and each lenslet is a closed prism.

    Parameters
    ----------
    mla : Lenslets
    subdivisions : int
    back : Lenslets, optional
        Lenslets on the other face, in their own frame, which looks the other way. Default: a flat face.
    shift_mm : (2,) float64, optional
        Shift of that frame in x and y.
    """
    import trimesh

    if back is not None:
        return _between_faces(mla, back, np.zeros(2) if shift_mm is None else shift_mm, subdivisions)

    pattern, faces = cell_pattern(mla.lattice, subdivisions)
    centres = mla.lattice.centres()
    rows, columns = np.indices(centres.shape[:2])
    solids = []
    for centre, column, row in zip(centres.reshape(-1, 2), columns.flat, rows.flat, strict=True):
        curvature, ex, ey = shape_of(mla, int(column), int(row))
        z, _ = faces_at(mla, type_of(mla, int(column), int(row)), curvature, pattern - [ex, ey])
        solids.append(np.column_stack([pattern + centre, z]))
    count = len(pattern)
    if mla.alike:
        all_points = np.concatenate(solids)
        flat, merged = _merged(
            all_points[:, :2],
            np.concatenate([faces + i * count for i in range(len(solids))]),
            mla.lattice.pitch,
        )
        z = np.zeros(len(flat))
        z[merged] = all_points[:, 2][np.concatenate([faces + i * count for i in range(len(solids))])]
        return _prism(flat, merged, z, mla.thickness)
    return trimesh.util.concatenate([_prism(v[:, :2], faces, v[:, 2], mla.thickness) for v in solids])


def _between_faces(mla: Lenslets, back: Lenslets, shift_mm: Array, subdivisions: int) -> "trimesh.Trimesh":
    """Return an array with lenslets on both faces: one closed shell if all are alike, else a prism for each cell.

    If the second face is shifted, the prisms lean by the shift.
    """
    import trimesh

    pattern, faces = cell_pattern(mla.lattice, subdivisions)
    centres = mla.lattice.centres()
    rows, columns = np.indices(centres.shape[:2])
    count = len(pattern)
    fronts: list[Array] = []
    backs: list[Array] = []
    for centre, column, row in zip(centres.reshape(-1, 2), columns.flat, rows.flat, strict=True):
        for lenslets_, into in ((mla, fronts), (back, backs)):
            curvature, ex, ey = shape_of(lenslets_, int(column), int(row))
            kind = type_of(lenslets_, int(column), int(row))
            z, _ = faces_at(lenslets_, kind, curvature, pattern - [ex, ey])
            into.append(np.column_stack([pattern + centre, z]))
    for each in backs:
        each[:, :2] += shift_mm
        each[:, 2] = mla.thickness - each[:, 2]
    if not (mla.alike and back.alike):
        return trimesh.util.concatenate([_shell(a, b, faces) for a, b in zip(fronts, backs, strict=True)])
    front, other = np.concatenate(fronts), np.concatenate(backs)
    every = np.concatenate([faces + i * count for i in range(len(fronts))])
    flat, merged = _merged(front[:, :2], every, mla.lattice.pitch)
    sheets = np.zeros((2, len(flat), 3))
    sheets[0, merged], sheets[1, merged] = front[every], other[every]
    return _shell(sheets[0], sheets[1], merged)


def _shell(front: Array, back: Array, faces: Index) -> "trimesh.Trimesh":
    """Close two sheets with the same triangles, facing +z, by side walls; the result faces outward."""
    import trimesh

    count = len(front)
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    key = directed[:, 0] * count + directed[:, 1]
    border = directed[~np.isin(key, directed[:, 1] * count + directed[:, 0])]
    a, b = border[:, 0], border[:, 1]
    walls = np.concatenate([np.column_stack([a, b, b + count]), np.column_stack([a, b + count, a + count])])
    # The triangles of the first sheet face into the glass, those of the second outward.
    all_faces = np.concatenate([faces[:, ::-1], faces + count, walls])
    return trimesh.Trimesh(np.concatenate([front, back]), all_faces, process=False)


def _prism(flat: Array, faces: Index, z: Array, thickness: float) -> "trimesh.Trimesh":
    """Close a height field with side walls and a flat face; the result faces outward."""
    front, back = np.column_stack([flat, z]), np.column_stack([flat, np.full(len(flat), thickness)])
    return _shell(front, back, faces)
