"""The microlens array's shape, in its own frame: z runs from the curved face into the glass, apexes at z = 0.

Every lenslet is the same spherical cap on its own cell, up to three types (multi-focus), and may carry form errors
(decentre, radius). Only one cell a type is a mesh for Embree (`cell_mesh`); `mla_mesh` builds them all, for export,
for drawing, and as the truth that the folded array is tested against.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.geometry.lattice import Lattice
from lfmesh.geometry.mesh import Array, Index, Mesh, joined
from lfmesh.kernel import kernel

if TYPE_CHECKING:
    import trimesh

SUBDIVISIONS = 6
"""Triangles along a cell's side (square) or from its centre to a corner (hexagonal)."""

OFFSET = 8.0
"""Cells of different types stand this many pitches apart in their common Embree scene."""


class Lenslets(NamedTuple):
    """The lattice with what stands on it.

    Attributes
    ----------
    lattice : Lattice
    curvature : (types,) float64, 1/mm
        Positive: convex, converging in air.
    thickness : float, mm
        Apex to flat face.
    decentre : (cells, 2) float64, mm
        Apex of each lenslet from its cell's centre, row by row; empty when all are zero.
    stretch : (cells,) float64
        Curvature of each lenslet over its type's; empty when all are one.
    top, valley : float, mm
        The layer between the smallest and the largest z of the curved face.
    """

    lattice: Lattice
    curvature: Array
    thickness: float
    decentre: Array
    stretch: Array
    top: float
    valley: float

    @property
    def alike(self) -> bool:
        """Whether all lenslets are the same: one type, no form errors."""
        return len(self.curvature) == 1 and not len(self.decentre) and not len(self.stretch)

    @property
    def apexes(self) -> Array:
        """(rows, columns, 2) mm: where the lenslets' apexes stand."""
        centres = self.lattice.centres()
        return centres + self.decentre.reshape(centres.shape) if len(self.decentre) else centres


def lenslets(
    lattice: Lattice,
    radius_mm: NDArray[np.float64],
    thickness_mm: float,
    *,
    decenter_mm: float = 0.0,
    radius_error: float = 0.0,
    seed: int = 0,
) -> Lenslets:
    """Draw the shape of a microlens array with its form errors: normal, of the rms given.

    Parameters
    ----------
    lattice : Lattice
    radius_mm : (types,) float64
        Of each type of lenslet, signed.
    thickness_mm : float
        From the apexes to the flat face.
    decenter_mm : float
        Rms distance of the apexes from their cells' centres.
    radius_error : float
        Rms relative error of the radii.
    seed : int

    Raises
    ------
    SceneError
        The errors leave a lenslet that is no cap over its whole cell, or cuts through the flat face.
    """
    draw = np.random.default_rng(seed)
    cells = lattice.columns * lattice.rows
    # Both are drawn whichever is asked for, so that switching one error on leaves the other as it was.
    shift = draw.normal(size=(cells, 2)) * (decenter_mm / np.sqrt(2.0))
    stretch = 1.0 / (1.0 + radius_error * draw.normal(size=cells))
    curvature = 1.0 / np.asarray(radius_mm, dtype=np.float64)
    steepest = stretch.max() if radius_error else 1.0
    corner = lattice.circumradius + (np.linalg.norm(shift, axis=1).max() if decenter_mm else 0.0)
    if stretch.min() <= 0.0 or np.abs(curvature).max() * steepest * corner >= 1.0:
        raise SceneError(
            f"camera.mla.form: decenter_mm = {decenter_mm:g} and radius_error = {radius_error:g} (seed {seed}) leave "
            f"a lenslet whose sphere ends inside its cell, {corner:.4g} mm from its apex; give smaller errors or "
            "larger radii"
        )
    depths = [_cap_depth(c * steepest, corner) for c in curvature]
    if max(depths) >= thickness_mm:
        raise SceneError(
            f"camera.mla.thickness_mm = {thickness_mm:g}: the lenslets are {max(depths):.4g} mm deep at their corners "
            "and would cut through the flat face; give a thicker array or smaller form errors"
        )
    return Lenslets(
        lattice=lattice,
        curvature=curvature,
        thickness=float(thickness_mm),
        decentre=shift if decenter_mm else np.zeros((0, 2)),
        stretch=stretch if radius_error else np.zeros(0),
        top=float(min(0.0, *depths)),
        valley=float(max(0.0, *depths)),
    )


def _cap_depth(curvature: float, radius: float) -> float:
    return curvature * radius**2 / (1.0 + np.sqrt(1.0 - (curvature * radius) ** 2))


@kernel
def are_alike(mla: Lenslets) -> bool:
    """Tell whether all lenslets are the same: one type, no form errors."""
    return len(mla.curvature) == 1 and len(mla.decentre) == 0 and len(mla.stretch) == 0


@kernel
def type_of(mla: Lenslets, column: int, row: int) -> int:
    """Return a cell's type: neighbours differ in an array of three types (hexagonal) or of two (square).

    Parameters
    ----------
    mla : Lenslets
    column, row : int
    """
    types = len(mla.curvature)
    if types == 1:
        return 0
    if mla.lattice.hexagonal:
        # Axial coordinates make the three types a regular colouring: no two of a kind touch.
        return (column - (row >> 1) + 2 * row) % types if types == 3 else (column + row) % types
    return (column + row) % types


@kernel
def shape_of(mla: Lenslets, column: int, row: int) -> tuple[float, float, float]:
    """Return a lenslet's curvature and its apex relative to the cell's centre.

    Parameters
    ----------
    mla : Lenslets
    column, row : int

    Returns
    -------
    curvature : float, 1/mm
    apex_x, apex_y : float, mm
    """
    c = mla.curvature[type_of(mla, column, row)]
    cell = row * mla.lattice.columns + column
    if len(mla.stretch):
        c *= mla.stretch[cell]
    if len(mla.decentre):
        return c, mla.decentre[cell, 0], mla.decentre[cell, 1]
    return c, 0.0, 0.0


@kernel
def cap_sag(curvature: float, r2: float) -> float:
    """Return the sag of a spherical cap."""
    return curvature * r2 / (1.0 + np.sqrt(1.0 - curvature * curvature * r2))


@kernel
def border_sag(lattice: Lattice, curvature: float, x: float, y: float, side: int) -> float:
    """Return the z of a cell's mesh at a point of one of its sides: on the chord between two vertices of the border.

    The side is numbered as in `leaves_at`, by either of the cells that share it.

    Parameters
    ----------
    lattice : Lattice
    curvature : float, 1/mm
    x, y : float, mm
        From the cell's centre.
    side : int
    """
    segments = border_segments(lattice.hexagonal)
    angle = side * np.pi / (3.0 if lattice.hexagonal else 2.0)
    step = lattice.pitch / (np.sqrt(3.0) if lattice.hexagonal else 1.0) / segments
    along = (np.cos(angle) * y - np.sin(angle) * x) / step + 0.5 * segments
    low = np.floor(along)
    apothem2 = 0.25 * lattice.pitch**2
    z_low = cap_sag(curvature, apothem2 + ((low - 0.5 * segments) * step) ** 2)
    z_high = cap_sag(curvature, apothem2 + ((low + 1.0 - 0.5 * segments) * step) ** 2)
    return z_low + (along - low) * (z_high - z_low)


@kernel
def border_segments(hexagonal: bool, subdivisions: int = SUBDIVISIONS) -> int:
    """Return how many edges of `cell_pattern` make one side of a cell."""
    return subdivisions if hexagonal else (subdivisions + 1) // 2


def cell_pattern(lattice: Lattice, subdivisions: int = SUBDIVISIONS) -> tuple[Array, Index]:
    """Return the (v, 2) points, mm, and (f, 3) triangles (facing +z) that tile the cell at the origin.

    Points on a side are equally spaced, so that the patterns of neighbouring cells share them.
    """
    corners = lattice.corners()
    points: list[Array] = []
    faces: list[Index] = []
    n = border_segments(lattice.hexagonal, subdivisions)
    count = 0
    # One fan of triangles a side, each refined n-fold.
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
    """Merge points that agree to a rounding error of the scale."""
    _, first, inverse = np.unique(
        np.round(points / (scale * 1e-9)).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    return points[first], inverse.reshape(-1)[faces]


def _cap_points(curvature: float, apex: Array, relative: Array, centre: Array) -> tuple[Array, Array]:
    """Return the vertices of one lenslet over points of its cell, and their normals towards +z."""
    from_apex = relative - apex
    r2 = np.einsum("ij,ij->i", from_apex, from_apex)
    z = curvature * r2 / (1.0 + np.sqrt(1.0 - curvature**2 * r2))
    normal = np.column_stack([-curvature * from_apex, 1.0 - curvature * z])
    return np.column_stack([relative + centre, z]), normal / np.linalg.norm(normal, axis=1, keepdims=True)


def cell_mesh(mla: Lenslets, kind: int) -> Mesh:
    """Return the curved face over one cell of a type, centred at the origin, facing +z, with its neighbours' rims.

    The rims (the neighbours' triangles that touch the cell) are there so that a ray along the border meets a facet on
    either side of it; the neighbours are taken to be of the same type.
    """
    pattern, faces = cell_pattern(mla.lattice)
    patch = mla.lattice._replace(columns=3, rows=3)
    centres = patch.centres().reshape(-1, 2)
    centres = centres - patch.centres()[1, 1]
    apothem = 0.5 * mla.lattice.pitch
    parts = []
    for centre in centres:
        vertices, normals = _cap_points(float(mla.curvature[kind]), np.zeros(2), pattern, centre)
        near = _cell_norm(mla.lattice, vertices[:, :2]) <= apothem * (1.0 + 1e-9)
        keep = faces[near[faces].any(axis=1)]
        parts.append(Mesh(vertices, keep, normals[keep]))
    return joined(parts)


def _cell_norm(lattice: Lattice, p: Array) -> Array:
    """Return the norm whose ball of radius pitch/2 is the cell."""
    if not lattice.hexagonal:
        return np.abs(p).max(axis=1)
    turn = np.deg2rad([0.0, 60.0, 120.0])
    return np.abs(p @ np.stack([np.cos(turn), np.sin(turn)])).max(axis=1)


def mla_mesh(mla: Lenslets, subdivisions: int = SUBDIVISIONS) -> "trimesh.Trimesh":
    """Return the whole array as a closed mesh.

    Where all lenslets are alike it is one shell. Unlike neighbours meet in steps, so each lenslet is then a closed
    prism of its own and the prisms stand side by side.
    """
    import trimesh

    pattern, faces = cell_pattern(mla.lattice, subdivisions)
    centres = mla.lattice.centres()
    rows, columns = np.indices(centres.shape[:2])
    solids = []
    for centre, column, row in zip(centres.reshape(-1, 2), columns.flat, rows.flat, strict=True):
        curvature, ex, ey = shape_of(mla, int(column), int(row))
        vertices, _ = _cap_points(curvature, np.array([ex, ey]), pattern, centre)
        solids.append(vertices)
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


def _prism(flat: Array, faces: Index, z: Array, thickness: float) -> "trimesh.Trimesh":
    """Close a height field with side walls and a flat face, outward-oriented."""
    import trimesh

    count = len(flat)
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    key = directed[:, 0] * count + directed[:, 1]
    border = directed[~np.isin(key, directed[:, 1] * count + directed[:, 0])]
    a, b = border[:, 0], border[:, 1]
    walls = np.concatenate([np.column_stack([a, b, b + count]), np.column_stack([a, b + count, a + count])])
    vertices = np.concatenate([np.column_stack([flat, z]), np.column_stack([flat, np.full(count, thickness)])])
    # `faces` look towards +z: into the glass on the curved face, outward on the flat one.
    return trimesh.Trimesh(vertices, np.concatenate([faces[:, ::-1], faces + count, walls]), process=False)
