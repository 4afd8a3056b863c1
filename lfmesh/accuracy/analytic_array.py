"""Microlens array of the analytic truth; see `analytic`."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.accuracy.analytic_gradients import GradientIndex, Height, Index, index_behind
from lfmesh.accuracy.analytic_phases import DiffractionOrder, only_order
from lfmesh.accuracy.analytic_rays import (
    NEWTON_STEPS,
    Array,
    Rays,
    conic_transfer,
    into_frame,
    out_of_frame,
    refract,
    turned,
)
from lfmesh.errors import LfmeshError
from lfmesh.geometry.array.lattice import Lattice
from lfmesh.geometry.array.lenslets import lenslets
from lfmesh.optics.glass import refractive_index
from lfmesh.scene import BackFace, MicrolensArray, Scene

CELL_STEPS = 6
"""Lenslets tried in turn: a ray may meet a neighbour of the lenslet guessed first."""

WALL_SAMPLES = 32
"""Points of a curved path that are held against the walls of its cell."""


@dataclass(frozen=True)
class LensletArray:
    """The faces of all lenslets, and the position of the array.

    Attributes
    ----------
    turn : (3, 3) float64, origin : (3,) float64
        Frame of the array; its z runs from the curved face into the glass.
    index : float or GradientIndex
        Refractive index of the glass. A gradient depends on the place from the axis of each lenslet, and z on the depth
        behind the face towards the lens.
    outside : float
        Refractive index of the medium on both sides of the array.
    curvature : (rows, columns) float64, 1/mm
    apex : (rows, columns, 2) float64, mm
    centre : (rows, columns, 2) float64, mm
    conic : (rows, columns) float64
    terms : (rows, columns, n) float64
        Coefficients of r⁴, r⁶, ...
    bends : (2,) float64
        1 for each of x and y, but 0 along cylinders.
    order, flat_order : DiffractionOrder or None
        Orders of the phases of this face, about the apexes, and of a flat other face, about the centres of the cells.
    back : LensletArray or None
        Lenslets on the other face, in their own frame, which looks the other way.
    """

    turn: NDArray[np.float64]
    origin: NDArray[np.float64]
    curved_to_lens: bool
    index: Index
    outside: float
    thickness: float
    hexagonal: bool
    pitch: float
    curvature: NDArray[np.float64]
    apex: NDArray[np.float64]
    centre: NDArray[np.float64]
    conic: NDArray[np.float64]
    terms: NDArray[np.float64]
    bends: NDArray[np.float64]
    order: DiffractionOrder | None = None
    flat_order: DiffractionOrder | None = None
    back: "LensletArray | None" = None

    @property
    def spherical(self) -> bool:
        """True if all lenslets are spheres."""
        return not self.conic.any() and not self.terms.any() and bool(self.bends.all())


def lenslet_array(scene: Scene, face_z: float, wavelength_nm: float) -> LensletArray:
    """Return the microlens array of a scene whose face towards the lens stands at `face_z`.

    Parameters
    ----------
    scene : Scene
    face_z : float, mm
    wavelength_nm : float, nm

    Raises
    ------
    LfmeshError
        A plate with a gradient has clear walls, lenslets on both faces or errors of form.
    """
    mla = scene.camera.mla
    assert mla is not None
    _refuse_without_truth(mla)
    lattice = Lattice(
        mla.layout == "hexagonal", mla.pitch_mm * (1.0 + mla.form.pitch_error), mla.count[0], mla.count[1]
    )
    radii = np.asarray(mla.radii_mm, np.float64)
    # The form errors are data, drawn from the scene's seed; their effect on rays is computed here.
    drawn = lenslets(
        lattice, radii, mla.thickness_mm,
        decenter_mm=mla.form.decenter_mm, radius_error=mla.form.radius_error, seed=mla.form.seed,
        conic=mla.conic, asphere_mm=mla.asphere_mm, cylinder_axis=mla.cylinder_axis,
    )  # fmt: skip
    row, column = np.indices((lattice.rows, lattice.columns))
    kinds = len(radii)
    if kinds == 1:
        kind = np.zeros_like(row)
    elif mla.cylinder_axis is not None:
        kind = (column if mla.cylinder_axis == "y" else row) % kinds
    elif lattice.hexagonal:
        kind = (column - row // 2 + 2 * row) % 3 if kinds == 3 else (column + row) % 2
    else:
        kind = (column + row) % kinds
    curvature = 1.0 / radii[kind]
    centre = lattice.centres()
    apex = centre.copy()
    if len(drawn.stretch):
        curvature = curvature * drawn.stretch.reshape(curvature.shape)
    if len(drawn.decentre):
        apex = apex + drawn.decentre.reshape(apex.shape)
    turn = turned(mla.pose.tilt_deg)
    origin = np.add([0.0, 0.0, face_z], mla.pose.shift_mm)
    to_lens = mla.curved_side == "lens"
    if not to_lens:
        # The curved face is on the far side, and its own z points back.
        origin = origin + turn @ [0.0, 0.0, mla.thickness_mm]
        turn = turn @ np.diag([1.0, 1.0, -1.0])
    around = scene.camera.lens.media[-1]
    index, outside = index_behind(mla.medium, wavelength_nm, 0.0), refractive_index(around, wavelength_nm)
    # Light enters by the face towards the lens.
    inwards, outwards = (around, mla.medium), (mla.medium, around)
    order = only_order(mla.curved_phase, wavelength_nm, *(inwards if to_lens else outwards), "camera.mla.curved_phase")
    flat_order = only_order(mla.flat_phase, wavelength_nm, *(outwards if to_lens else inwards), "camera.mla.flat_phase")
    profiles = [mla.profile_of(k) for k in range(kinds)]
    terms = np.zeros((kinds, max(len(given) for _, given in profiles)))
    for own, (_, given) in zip(terms, profiles, strict=True):
        own[: len(given)] = given
    face = LensletArray(
        turn, origin, to_lens, index, outside, mla.thickness_mm, lattice.hexagonal, lattice.pitch, curvature, apex,
        centre, np.array([conic for conic, _ in profiles])[kind], terms[kind],
        np.array([mla.cylinder_axis != "x", mla.cylinder_axis != "y"], np.float64), order, flat_order,
    )  # fmt: skip
    return face if mla.back is None else replace(face, back=_other_face(face, mla.back))


def _refuse_without_truth(mla: MicrolensArray) -> None:
    """Refuse plates of gradient-index glass that are not traced here."""
    if mla.gradient is None:
        return
    for key, is_there in (
        ("walls", mla.walls != "absorb"),
        ("back", mla.back is not None),
        ("form", bool(mla.form.decenter_mm or mla.form.radius_error)),
    ):
        if is_there:
            raise LfmeshError(
                f"camera.mla.{key}: the truth that errors are measured against has a gradient only in perfect lenslets "
                "with one flat face and walls that absorb"
            )


def _other_face(face: LensletArray, back: BackFace) -> LensletArray:
    """Return the lenslets on the other face, all alike, in their own frame."""
    alike = np.ones(face.curvature.shape)
    return replace(
        face,
        turn=face.turn @ np.diag([1.0, 1.0, -1.0]),
        origin=face.origin + face.turn @ [*back.decenter_mm, face.thickness],
        curvature=alike / back.radius_mm,
        apex=face.centre,
        conic=back.conic * alike,
        terms=np.multiply.outer(alike, np.array(back.asphere_mm or (0.0,))),
        bends=np.array([back.cylinder_axis != "x", back.cylinder_axis != "y"], np.float64),
        order=face.flat_order,
    )


def through_array(rays: Rays, mla: LensletArray) -> None:
    """Trace the rays through both faces of the array, in either order."""
    if mla.back is not None:
        order = (mla, mla.back) if mla.curved_to_lens else (mla.back, mla)
        for face, (before, after) in zip(order, ((mla.outside, mla.index), (mla.index, mla.outside)), strict=True):
            rays.p, rays.d = into_frame(rays, face.turn, face.origin)
            _through_lenslets(rays, face, before, after)
            rays.p, rays.d = out_of_frame(rays.p, rays.d, face.turn, face.origin)
        return
    rays.p, rays.d = into_frame(rays, mla.turn, mla.origin)
    faces = _through_lenslets, _through_flat_face
    first, last = faces if mla.curved_to_lens else faces[::-1]
    cell = first(rays, mla, mla.outside, mla.index)
    last(rays, mla, mla.index, mla.outside, cell)
    rays.p, rays.d = out_of_frame(rays.p, rays.d, mla.turn, mla.origin)


Cells = NDArray[np.int64]
"""Number of the cell of each ray; −1 outside the array."""


def _through_flat_face(
    rays: Rays, mla: LensletArray, before: Index, after: Index, entered: Cells | None = None
) -> Cells:  # fmt: skip
    """Refract the rays at the flat face, and return their cells there."""
    kind = rays.p.dtype.type
    if isinstance(before, GradientIndex) and entered is not None:
        cell = entered
        _along_curves(rays, mla, before, cell, _flat_height(kind(mla.thickness)))
    else:
        t = (kind(mla.thickness) - rays.p[:, 2]) / rays.d[:, 2]
        rays.p = rays.p + t[:, None] * rays.d
        cell = _nearest_cell(mla, rays.p)
    # Between the faces a ray may exit through the array's edge.
    rays.alive &= cell >= 0
    along = np.sign(rays.d[:, 2])
    centre = mla.centre.reshape(-1, 2)[np.maximum(cell, 0)].astype(kind)
    normal = np.stack([np.zeros_like(along), np.zeros_like(along), along], axis=1)
    n_i, n_t = (_index_near(index, mla, cell, rays.p) for index in (before, after))
    _into(mla.flat_order, rays, rays.p[:, :2] - centre, normal, n_i, n_t)
    return cell


def _through_lenslets(
    rays: Rays, mla: LensletArray, before: Index, after: Index, entered: Cells | None = None
) -> Cells:  # fmt: skip
    """Refract the rays at the face of the lenslet in the cell where they meet it, and return these cells.

    Rays without a settled cell, which cross the wall between unlike lenslets, are dropped.
    """
    kind = rays.p.dtype.type
    if isinstance(before, GradientIndex) and entered is not None:
        cell = entered
        _along_curves(rays, mla, before, cell, partial(_lenslet_height, mla, cell))
        apex, c = _apexes(mla, cell, kind)
        q = np.column_stack([rays.p[:, :2] - apex, rays.p[:, 2]])
    else:
        cell, q = _met_lenslets(rays, mla)
        c = _apexes(mla, cell, kind)[1]
    normal = np.column_stack([-c[:, None] * q[:, :2], 1 - c * q[:, 2]])
    if not mla.spherical:
        normal = np.column_stack([-_profile(mla, np.maximum(cell, 0), c, q)[1], np.ones_like(c)])
    normal = normal * np.sign(rays.d[:, 2:])
    n_i, n_t = (_index_near(index, mla, cell, rays.p) for index in (before, after))
    _into(mla.order, rays, q[:, :2], normal, n_i, n_t)
    return cell


def _met_lenslets(rays: Rays, mla: LensletArray) -> tuple[Cells, Array]:
    """Move straight rays to the faces that they meet; return the cells, and the points from their apexes."""
    kind = rays.p.dtype.type
    to_apexes = -rays.p[:, 2] / rays.d[:, 2]
    at = rays.p + to_apexes[:, None] * rays.d
    cell = _nearest_cell(mla, at)
    settled = np.zeros(len(cell), np.bool_)
    for _ in range(CELL_STEPS):
        apex, c = _apexes(mla, cell, kind)
        p = np.column_stack([rays.p[:, :2] - apex, rays.p[:, 2]])
        if mla.spherical:
            t = conic_transfer(p, rays.d * np.sign(rays.d[:, 2:]), c, kind(0)) * np.sign(rays.d[:, 2])
        else:
            t = _profile_transfer(p, rays.d, mla, np.maximum(cell, 0), c)
        q = p + t[:, None] * rays.d
        hit = np.column_stack([q[:, :2] + apex, q[:, 2]])
        there = _nearest_cell(mla, hit)
        settled = (there == cell) & (cell >= 0)
        if settled.all():
            break
        cell = there
    rays.alive &= settled
    rays.p = hit
    return cell, q


def _apexes(mla: LensletArray, cell: Cells, kind: type) -> tuple[Array, Array]:
    """Return the apexes (n, 2) and the curvatures (n,) of the lenslets in cells."""
    flat = np.maximum(cell, 0)
    return mla.apex.reshape(-1, 2)[flat].astype(kind), mla.curvature.reshape(-1)[flat].astype(kind)


def _flat_height(thickness: Any) -> Height:
    def height(p: Array) -> tuple[Array, Array]:
        return p[:, 2] - thickness, np.broadcast_to(np.array([0, 0, 1], p.dtype), p.shape)

    return height


def _lenslet_height(mla: LensletArray, cell: Cells, p: Array) -> tuple[Array, Array]:
    """Return z minus the sag of the lenslets in cells, and its gradient."""
    apex, c = _apexes(mla, cell, p.dtype.type)
    q = np.column_stack([p[:, :2] - apex, p[:, 2]])
    sag, slopes = _profile(mla, np.maximum(cell, 0), c, q)
    return p[:, 2] - sag, np.column_stack([-slopes, np.ones_like(sag)])


def _from_lens(mla: LensletArray, cell: Cells, p: Array) -> Array:
    """Return points in the frame of their lenslets: its z runs from the face towards the lens into the glass."""
    kind = p.dtype.type
    centre = mla.centre.reshape(-1, 2)[np.maximum(cell, 0)].astype(kind)
    z = p[:, 2] if mla.curved_to_lens else kind(mla.thickness) - p[:, 2]
    return np.column_stack([p[:, :2] - centre, z])


def _index_near(index: Index, mla: LensletArray, cell: Cells, p: Array) -> float | Array:
    """Return the index of a medium, or the indices at points in cells."""
    return index.at(_from_lens(mla, cell, p)) if isinstance(index, GradientIndex) else index


def _along_curves(rays: Rays, mla: LensletArray, index: GradientIndex, cell: Cells, height: Height) -> None:
    """Move rays through the glass of their cells to its other face; those that reach a wall are absorbed."""
    kind = rays.p.dtype.type
    centre = mla.centre.reshape(-1, 2)[np.maximum(cell, 0)].astype(kind)
    mirror = np.array([1, 1, 1 if mla.curved_to_lens else -1], kind)

    def out(q: Array) -> Array:
        z = q[:, 2] if mla.curved_to_lens else kind(mla.thickness) - q[:, 2]
        return np.column_stack([q[:, :2] + centre, z])

    def own_height(q: Array) -> tuple[Array, Array]:
        above, normal = height(out(q))
        return mirror[2] * above, mirror[2] * mirror * normal

    start = np.where(rays.alive[:, None], _from_lens(mla, cell, rays.p), kind(np.nan))
    met, d, points = index.follow(start, rays.d * mirror, own_height, WALL_SAMPLES)
    for at in points:
        rays.alive &= _nearest_cell(mla, out(at)) == cell
    rays.p, rays.d = out(met), d * mirror


def _into(
    order: DiffractionOrder | None, rays: Rays, at: Array, normal: Array, before: float | Array, after: float | Array
) -> None:  # fmt: skip
    """Refract the rays, and turn them by the phase of the face at points (n, 2) from its own centre."""
    if order is None:
        refract(rays, normal, before, after)
        return
    refract(rays, normal, before, after, order.change(at))
    rays.weight = rays.weight * rays.p.dtype.type(order.share)


def _profile(mla: LensletArray, cell: NDArray[np.int64], c: Array, q: Array) -> tuple[Array, Array]:
    """Return the sag and the slopes (n, 2) of aspheric lenslets at points from their apexes."""
    kind = q.dtype.type
    across = q[:, :2] * mla.bends.astype(kind)
    r2 = (across * across).sum(axis=1)
    root = np.sqrt(1 - (1 + mla.conic.reshape(-1)[cell].astype(kind)) * c * c * r2)
    sag, steep = c * r2 / (1 + root), c / root
    for j, a in enumerate(mla.terms.reshape(mla.conic.size, mla.terms.shape[-1])[cell].astype(kind).T):
        sag = sag + a * r2 ** (j + 2)
        steep = steep + (2 * j + 4) * a * r2 ** (j + 1)
    return sag, steep[:, None] * across


def _profile_transfer(p: Array, d: Array, mla: LensletArray, cell: NDArray[np.int64], c: Array) -> Array:
    """Return the distances to the faces of aspheric lenslets, by Newton's method from the apexes."""
    t = -p[:, 2] / d[:, 2]
    for _ in range(NEWTON_STEPS):
        q = p + t[:, None] * d
        sag, slopes = _profile(mla, cell, c, q)
        step = (q[:, 2] - sag) / (d[:, 2] - (slopes * d[:, :2]).sum(axis=1))
        t = t - step
        if not np.any(np.abs(step) > 4 * np.finfo(t.dtype).eps * (1 + np.abs(t))):
            break
    return np.asarray(t)


def _nearest_cell(mla: LensletArray, p: Array) -> NDArray[np.int64]:
    """Return the cell with the nearest centre to each point; −1 outside the array."""
    rows, columns = mla.curvature.shape
    x, y = p[:, 0].astype(np.float64) / mla.pitch, p[:, 1].astype(np.float64) / mla.pitch
    far = 2.0 * (rows + columns)
    x, y = (np.nan_to_num(a, nan=far, posinf=far, neginf=far) for a in (x, y))
    spacing = np.sqrt(0.75) if mla.hexagonal else 1.0
    first = mla.centre[0, 0] / mla.pitch
    middle = np.rint((y - first[1]) / spacing)
    nearest = np.full(len(p), np.inf)
    best_row, best_column = middle.copy(), np.zeros_like(middle)
    for row in (middle - 1, middle, middle + 1) if mla.hexagonal else (middle,):
        start = first[0] + (0.5 * np.mod(row, 2) if mla.hexagonal else 0.0)
        column = np.rint(x - start)
        distance = (x - start - column) ** 2 + (y - first[1] - row * spacing) ** 2
        nearer = distance < nearest
        nearest = np.where(nearer, distance, nearest)
        best_row, best_column = np.where(nearer, row, best_row), np.where(nearer, column, best_column)
    inside = (best_row >= 0) & (best_row < rows) & (best_column >= 0) & (best_column < columns)
    return np.where(inside, best_row * columns + best_column, -1).astype(np.int64)
