"""Shape of the microlens array in its own frame: z runs from the curved face into the glass, apexes lie at z = 0.

Each lenslet is a cap on its own cell: a sphere, or a `lenslet_profile`. There are up to three types (multi-focus), and
lenslets may have form errors (decentre, radius). For meshes, see `array_mesh`.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.geometry.array.lattice import Lattice
from lfmesh.geometry.array.lenslet_profile import (
    fill_shapes,
    first_crossing,
    is_steeper,
    powers_of,
    profile_of,
    profile_shape,
)
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.ray import Ray
from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.bounds import SAG, profile_extremes

if TYPE_CHECKING:
    pass

SUBDIVISIONS = 6
"""Triangles along a cell's side (square) or from its centre to a corner (hexagonal)."""

DEPTH_WITHIN = 1e-6
"""Largest relative excess of the depth bounds of an aspheric face."""

FLAT_LAYER = 1e-3
"""Half the thickness of the layer about a flat face, in pitches. The borders of a layer must not lie on its face, or
rounding would decide which of the two a ray meets first."""

FLAT_SHARE = 0.01
"""Largest half thickness of that layer, in thicknesses of the plate."""


@by_address
class Lenslets(NamedTuple):
    """Lattice and shapes of the lenslets.

    Attributes
    ----------
    lattice : Lattice
    curvature : (types,) float64, 1/mm
        Positive: convex, converging in air.
    thickness : float, mm
        Apex to flat face.
    decentre : (cells, 2) float64, mm
        Apex of each lenslet from its cell's centre, row by row; empty if all are zero.
    stretch : (cells,) float64
        Curvature of each lenslet over its type's; empty if all are one.
    top, valley : float, mm
        Least and largest z of the curved face; a flat one lies between them.
    profile : Profile
        None if all lenslets are spheres; code for other faces is then not even compiled.
    clear_radius : float, mm
        Radius of the mask's opening over each cell, about its centre; inf without a mask.
    """

    lattice: Lattice
    curvature: Array
    thickness: float
    decentre: Array
    stretch: Array
    top: float
    valley: float
    profile: Any = None
    clear_radius: float = np.inf

    @property
    def alike(self) -> bool:
        """True if all lenslets are the same: one type, no form errors."""
        return len(self.curvature) == 1 and not len(self.decentre) and not len(self.stretch)

    @property
    def apexes(self) -> Array:
        """Positions of the lenslets' apexes, (rows, columns, 2) mm."""
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
    conic: Sequence[float] = (0.0,),
    asphere_mm: Sequence[Sequence[float]] = ((),),
    cylinder_axis: str | None = None,
) -> Lenslets:
    """Return a microlens array with random form errors, normally distributed with the given rms.

    Parameters
    ----------
    lattice : Lattice
    radius_mm : (types,) float64
        Signed; inf: flat.
    thickness_mm : float
        From the apexes to the flat face.
    decenter_mm : float
        Rms distance of the apexes from their cells' centres.
    radius_error : float
        Rms relative error of the radii.
    seed : int
    conic : (types,) or (1,) float
        Conic constant of each type, or of all.
    asphere_mm : (types, n) or (1, n) float
        Coefficients of r⁴, r⁶, ... of each type, or of all. Trailing zeros may be omitted.
    cylinder_axis : str, optional
        "x" or "y": the lenslets are cylinders along this axis, each over a whole row or column of cells.

    Raises
    ------
    SceneError
        With its errors, a lenslet does not cover its whole cell or cuts through the flat face.
    """
    draw = np.random.default_rng(seed)
    cells = lattice.columns * lattice.rows
    # Always draw both, so that switching one error on does not change the other.
    shift = draw.normal(size=(cells, 2)) * (decenter_mm / np.sqrt(2.0))
    stretch = 1.0 / (1.0 + radius_error * draw.normal(size=cells))
    shift, stretch = _along_cylinders(lattice, cylinder_axis, shift), _along_cylinders(lattice, cylinder_axis, stretch)
    curvature = 1.0 / np.asarray(radius_mm, dtype=np.float64)
    steepest = stretch.max() if radius_error else 1.0
    widest = lattice.circumradius if cylinder_axis is None else 0.5 * lattice.pitch
    corner = widest + (np.linalg.norm(shift, axis=1).max() if decenter_mm else 0.0)
    conics, terms = _of_each_type(len(curvature), conic, asphere_mm)
    squash = 1.0 + conics
    if stretch.min() <= 0.0 or (squash * (np.abs(curvature) * steepest * corner) ** 2).max() >= 1.0:
        raise SceneError(
            f"camera.mla.form: decenter_mm = {decenter_mm:g} and radius_error = {radius_error:g} (seed {seed}) leave "
            f"a lenslet whose {'conic' if conics.any() else 'sphere'} ends inside its cell, {corner:.4g} mm from its "
            "apex; give smaller errors or larger radii"
        )
    profile = None
    if cylinder_axis is None and not conics.any() and not terms.any():
        depths = [_cap_depth(c * steepest, corner) for c in curvature]
    else:
        between = (float(stretch.min()), float(stretch.max())) if radius_error else (1.0, 1.0)
        profile = profile_of(curvature, conics, terms, cylinder_axis, corner, between)
        depths = _profile_depths(curvature, conics, terms, corner, between)
    if max(depths) >= thickness_mm:
        raise SceneError(
            f"camera.mla.thickness_mm = {thickness_mm:g}: the lenslets are {max(depths):.4g} mm deep at their corners "
            "and would cut through the flat face; give a thicker array or smaller form errors"
        )
    if (~terms.any(axis=1) & (curvature == 0.0)).any():
        layer = min(FLAT_LAYER * lattice.pitch, FLAT_SHARE * thickness_mm)
        depths += [-layer, layer]
    return Lenslets(
        lattice=lattice,
        curvature=curvature,
        thickness=float(thickness_mm),
        decentre=shift if decenter_mm else np.zeros((0, 2)),
        stretch=stretch if radius_error else np.zeros(0),
        top=float(min(0.0, *depths)),
        valley=float(max(0.0, *depths)),
        profile=profile,
    )


def _along_cylinders(lattice: Lattice, cylinder_axis: str | None, values: Array) -> Array:
    """Give all cells of a cylinder the value of its first cell; values are ordered row by row."""
    if cylinder_axis is None:
        return values
    of_cells = values.reshape(lattice.rows, lattice.columns, *values.shape[1:])
    first = of_cells[:1] if cylinder_axis == "y" else of_cells[:, :1]
    return np.ascontiguousarray(np.broadcast_to(first, of_cells.shape).reshape(values.shape))


def _of_each_type(types: int, conic: Sequence[float], asphere_mm: Sequence[Sequence[float]]) -> tuple[Array, Array]:
    """Return the conic constants (types,) and the coefficients (types, n) of an array's types."""
    conics = np.array(np.broadcast_to(np.asarray(conic, np.float64), (types,)))
    terms = np.zeros((len(asphere_mm), max(map(len, asphere_mm))))
    for row, given in zip(terms, asphere_mm, strict=True):
        row[: len(given)] = given
    return conics, np.ascontiguousarray(np.broadcast_to(terms, (types, terms.shape[1])))


def _profile_depths(
    curvature: Array, conics: Array, terms: Array, corner: float, stretch: tuple[float, float]
) -> list[float]:
    """Return strict bounds of the least and the largest sag of each type."""
    depths: list[float] = []
    for c, k, a in zip(curvature, conics, terms, strict=True):
        # The sag grows with the curvature at every distance.
        for bent in stretch:
            least, most = profile_extremes((c * bent, c * bent), k, powers_of(a), corner, (SAG,), DEPTH_WITHIN)
            # The search for the face starts here, so it must not start on the face.
            clear = DEPTH_WITHIN * (most - least)
            depths += [least - clear, most + clear]
    return depths


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
        # Axial coordinates make the three types a regular colouring: no two cells of a type touch.
        return (column - (row >> 1) + 2 * row) % types if types == 3 else (column + row) % types
    return _across_cylinders(mla.profile, column, row) % types


@inlined
def _across_cylinders(profile: Any, column: int, row: int) -> int:
    """Return the number of a cell's cylinder; for lenslets of revolution, column + row."""
    if profile is None:
        return column + row
    return (column if profile.weight_x > 0.0 else 0) + (row if profile.weight_y > 0.0 else 0)


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


@inlined
def is_spherical(profile: Any) -> bool:
    """Tell whether lenslets with this profile are spheres (they have none)."""
    return profile is None


@kernel
def face_sag(mla: Lenslets, column: int, row: int, curvature: float, x: float, y: float) -> float:
    """Return the sag of a lenslet, mm.

    Parameters
    ----------
    mla : Lenslets
    column, row : int
    curvature : float, 1/mm
        From `shape_of`.
    x, y : float, mm
        From the apex.
    """
    return _sag_by(mla.profile, mla, column, row, curvature, x, y)


@inlined
def _sag_by(profile: Any, mla: Lenslets, column: int, row: int, curvature: float, x: float, y: float) -> float:
    if profile is None:
        return cap_sag(curvature, x * x + y * y)
    return profile_shape(profile, type_of(mla, column, row), curvature, x, y)[0]


@inlined
def face_normal(
    mla: Lenslets, column: int, row: int, curvature: float, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Return the unit normal of a lenslet, towards +z.

    Parameters
    ----------
    mla : Lenslets
    column, row : int
    curvature : float, 1/mm
        From `shape_of`.
    x, y, z : float, mm
        Point of the face, from the apex.
    """
    return _normal_by(mla.profile, mla, column, row, curvature, (x, y, z))


@inlined
def _normal_by(
    profile: Any, mla: Lenslets, column: int, row: int, curvature: float, place: tuple[float, float, float]
) -> tuple[float, float, float]:
    x, y, z = place
    if profile is None:
        return -curvature * x, -curvature * y, 1.0 - curvature * z
    _, gx, gy = profile_shape(profile, type_of(mla, column, row), curvature, x, y)
    scale = 1.0 / np.sqrt(1.0 + gx * gx + gy * gy)
    return -gx * scale, -gy * scale, scale


@inlined
def meets_profile(
    profile: Any, mla: Lenslets, column: int, row: int, ray: Ray, in_air: bool, begin: float, end: float
) -> tuple[bool, float]:
    """Return whether a ray crosses the face of an aspheric lenslet, and the first distance; False for spheres.

    Parameters
    ----------
    profile : Profile, or None
        Profile of `mla`.
    mla : Lenslets
    column, row : int
    ray : Ray
        From the cell's centre.
    in_air : bool
        True for a ray in the air in front of the face, False in the glass.
    begin, end : float, mm
        Distances between which it is in the cell.
    """
    x, y, z, dx, dy, dz = ray
    if profile is None:
        return False, 0.0
    curvature, ex, ey = shape_of(mla, column, row)
    return first_crossing(
        profile, type_of(mla, column, row), curvature, Ray(x - ex, y - ey, z, dx, dy, dz), 1.0 if in_air else -1.0,
        begin, end,
    )  # fmt: skip


@inlined
def leaves_face(profile: Any, mla: Lenslets, column: int, row: int, dx: float, dy: float, dz: float) -> bool:
    """Tell whether a ray that starts on a lenslet's face, out of the layer of faces, cannot meet that lenslet again.

    A sphere it cannot; of other faces that is known of directions steeper than they are anywhere.

    Parameters
    ----------
    profile : Profile, or None
        That of `mla`.
    mla : Lenslets
    column, row : int
        Of the lenslet.
    dx, dy, dz : float
    """
    if profile is None:
        return True
    return is_steeper(profile, type_of(mla, column, row), dx, dy, dz)


@kernel
def border_sag(mla: Lenslets, column: int, row: int, x: float, y: float, side: int) -> float:
    """Return z of a cell's mesh at a point on one of its sides, on the chord between two vertices of the border.

    Form errors are ignored.

    Parameters
    ----------
    mla : Lenslets
    column, row : int
    x, y : float, mm
        From the cell's centre.
    side : int
        Numbered as in `leaves_at`, by either of the two cells.
    """
    lattice = mla.lattice
    curvature = mla.curvature[type_of(mla, column, row)]
    segments = border_segments(lattice.hexagonal)
    angle = side * np.pi / (3.0 if lattice.hexagonal else 2.0)
    step = lattice.pitch / (np.sqrt(3.0) if lattice.hexagonal else 1.0) / segments
    nx, ny, half = np.cos(angle), np.sin(angle), 0.5 * lattice.pitch
    along = (nx * y - ny * x) / step + 0.5 * segments
    low = np.floor(along)
    a, b = (low - 0.5 * segments) * step, (low + 1.0 - 0.5 * segments) * step
    side_at = nx, ny, half
    z_low = _border_vertex(mla.profile, mla, column, row, curvature, side_at, a)
    z_high = _border_vertex(mla.profile, mla, column, row, curvature, side_at, b)
    return z_low + (along - low) * (z_high - z_low)


@inlined
def _border_vertex(
    profile: Any, mla: Lenslets, column: int, row: int, curvature: float, side: tuple[float, float, float], along: float
) -> float:
    """Return the sag at a distance from the middle of a side, given by its normal and distance."""
    nx, ny, half = side
    if profile is None:
        return cap_sag(curvature, half * half + along * along)
    return face_sag(mla, column, row, curvature, half * nx - along * ny, half * ny + along * nx)


@kernel
def border_segments(hexagonal: bool, subdivisions: int = SUBDIVISIONS) -> int:
    """Return the number of `cell_pattern` edges on one side of a cell."""
    return subdivisions if hexagonal else (subdivisions + 1) // 2


def faces_at(mla: Lenslets, kind: int, curvature: float, from_apex: Array) -> tuple[Array, Array]:
    """Return the sag (n,), mm, and the unit normals (n, 3) towards +z of lenslets of a type.

    Parameters
    ----------
    mla : Lenslets
    kind : int
        Type of the lenslets.
    curvature : float, 1/mm
        Including the lenslet's error.
    from_apex : (n, 2) float64, mm
        Points, from the apex.
    """
    if mla.profile is not None:
        z, normal = np.zeros(len(from_apex)), np.zeros((len(from_apex), 3))
        fill_shapes(mla.profile, kind, curvature, np.ascontiguousarray(from_apex, np.float64), z, normal)
        return z, normal
    r2 = np.einsum("ij,ij->i", from_apex, from_apex)
    z = curvature * r2 / (1.0 + np.sqrt(1.0 - curvature**2 * r2))
    normal = np.column_stack([-curvature * from_apex, 1.0 - curvature * z])
    return z, normal / np.linalg.norm(normal, axis=1, keepdims=True)
