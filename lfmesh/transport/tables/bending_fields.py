"""Tables for kernels of the media in object space that bend light.

The index comes from a voxel grid or, for gradient-index glass, from a formula. A field without targets, glass or
housing in its box is free: rays cross it without a search for a hit.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import GlassError, SceneError
from lfmesh.geometry import frame
from lfmesh.geometry.box_corners import corners_between
from lfmesh.geometry.index_media import IndexMedium, index_media
from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.gradient_range import InBox, index_range
from lfmesh.optics.gradient_shapes import GradientProfile
from lfmesh.optics.gradients import Gradients, field_at, fields_at, gradient_table
from lfmesh.optics.index_field_path import INSIDE, deflections, follower
from lfmesh.optics.index_field_steps import FINEST, FieldProbe, probed, with_steps
from lfmesh.optics.index_fields import (
    LEAPFROG,
    RUNGE_KUTTA,
    IndexField,
    IndexFields,
    field_table,
    index_field_at,
)
from lfmesh.scene import Scene
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.media.bending import density_law
from lfmesh.scene.quantities import MOST_INDEX
from lfmesh.transport.packets.packet import OBJECT_FRAME, WORLD_FRAME
from lfmesh.transport.tables.tables import AIR, Media

Array = NDArray[np.float64]

NO_FORMULA = -1
"""`BendingFields.formula` of a row with a voxel grid."""

FEWEST_CELLS, MOST_CELLS = 8, 1 << 13
"""Smallest and largest number of steps along the longest edge of a field given by a formula."""

FORMULA_PRECISION = 1e-9
"""Error of the deflection by the steps of a formula, over the largest deflection, below which steps are not halved."""

ROUNDING_RAD = 1e-12
"""Error of the deflection, rad, likewise: thousands of steps make one of 1e-13 by rounding."""

FORMULA_PROBES = 64
"""Probe rays that give the steps of a formula."""

SAME_EXIT, FEWEST_COMPARED = 0.01, 0.5
"""Relative difference of lengths up to which two rays have the same exit, and the least fraction of such rays."""

NEAR_CURVE = 0.01
"""Largest distance of a chord from its curve, over the size of a pixel there, in a field in which something stands."""

LEAST_STEP = 2.0**-10
"""Steps in voxels that are not halved further."""

MOST_POINTS_ALONG = 64
"""Largest number of intervals along each axis between points at which the curvature of rays is found."""


@by_address
class BendingFields(NamedTuple):
    """Media that bend light, each with a box of its own; rows of a field at all wavelengths are in succession."""

    fields: IndexFields  # (n · wavelengths,) rows; of a formula, only box and steps are used
    wavelengths: int
    around: Array  # (wavelengths,) index of the air, or object medium, around them
    to_own: Array  # (n, 3, 4) from the object frame to the field's own
    from_own: Array  # (n, 3, 4) the inverse
    free: NDArray[np.bool_]  # (n,) whether the boxes of all targets and of the housing lie beside the field's
    medium: NDArray[np.int64]  # (n,) number of the medium in the scene
    slot: NDArray[np.int64]  # (n,) slot of the book of light that is trapped
    deflection: float  # rad, largest of all
    alone: bool  # nothing happens to light between their nodes: no medium absorbs, scatters or emits
    emit_radiance: bool  # media emit a given radiance, whatever the index; else they emit by their temperature
    curves: bool  # recorded paths have a vertex at the end of each chord, not only at the faces of fields
    formula: NDArray[np.int64]  # (n · wavelengths,) row in `formulas`, or NO_FORMULA
    formulas: Any = None  # Gradients if an index is a formula, else None: code for them is not even compiled


class FieldMedium(NamedTuple):
    """A medium that bends light, with its steps.

    Attributes
    ----------
    medium : IndexMedium
    field : IndexField
        At all wavelengths; of a formula, only bounds and steps are used.
    probe : FieldProbe
    """

    medium: IndexMedium
    field: IndexField
    probe: FieldProbe


@inlined
def bending_at(fields: BendingFields, number: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return n² at a point, and ½ ∇n², mm⁻¹.

    Parameters
    ----------
    fields : BendingFields
    number : int
        Row of the field and wavelength.
    x, y, z : float, mm
        In the field's own frame.
    """
    return _value_at(fields.formulas, fields, number, x, y, z)


@inlined
def _value_at(
    formulas: Any, fields: BendingFields, number: int, x: float, y: float, z: float
) -> tuple[float, float, float, float]:
    """Return the result of `bending_at`; `formulas` : Gradients or None."""
    if formulas is None:
        return index_field_at(fields.fields, number, x, y, z)
    formula = fields.formula[number]
    if formula >= 0:
        return field_at(formulas, formula, x, y, z)
    return index_field_at(fields.fields, number, x, y, z)


_follow_formula = follower(field_at)


def bending_media(scene: Scene, wavelengths_nm: tuple[float, ...]) -> list[FieldMedium]:
    """Return the media of a scene that bend light, with their steps.

    Parameters
    ----------
    scene : Scene
    wavelengths_nm : (wavelengths,) tuple of float

    Raises
    ------
    SceneError, FileError
        As from `index_media`, or an index is not real, or a formula bends light too strongly.
    """
    found = []
    for medium in index_media(scene, wavelengths_nm):
        if medium.field is None:
            found.append(_by_formula(medium))
        else:
            probe = probed(medium.field)
            found.append(FieldMedium(medium, with_steps(medium.field, probe), probe))
    return found


def _by_formula(medium: IndexMedium) -> FieldMedium:
    """Return a medium with an index by a formula, with the steps that probe rays need."""
    box, formulas = medium.bounds_mm, gradient_table(medium.formulas)
    _refuse_extremes(medium)
    rays = _rays_through(formulas, box)
    cells, truth = FEWEST_CELLS, _ends(formulas, box, rays, 2 * MOST_CELLS)
    largest, error = float(deflections(rays, truth[0]).max(initial=0.0)), np.inf
    while cells <= MOST_CELLS:
        error = _error(_ends(formulas, box, rays, cells), truth) / largest if largest > 0.0 else 0.0
        if error <= FORMULA_PRECISION or error * largest <= ROUNDING_RAD:
            break
        cells *= 2
    cells = min(cells, MOST_CELLS)
    if error > FINEST and error * largest > ROUNDING_RAD:
        raise SceneError(f"{medium.name}: index: bends light too strongly for its box; give a smaller box")
    row = _uniform(box, cells, len(medium.formulas))
    return FieldMedium(medium, row, FieldProbe(RUNGE_KUTTA, 1.0, largest, error, 0.0, 0))


def _uniform(box: Array, cells: int, wavelengths: int) -> IndexField:
    """Return a uniform field of a box with steps of a fraction of its longest edge, for the table of a formula."""
    size = box[1] - box[0]
    spacing = np.full(3, float(size.max()) / cells)
    return IndexField(
        np.zeros((4, 4, 4)), spacing, box[0].copy(), box, np.ones(wavelengths), np.zeros(wavelengths), RUNGE_KUTTA, 1.0
    )


def _refuse_extremes(medium: IndexMedium) -> None:
    """Refuse a formula whose index leaves the range of valid ones anywhere in its box."""
    valid = f"it must be above 0 and at most {MOST_INDEX:g} in all of its box"
    for profile in medium.formulas:
        try:
            found = index_range(profile, InBox.of(*medium.bounds_mm))
        except GlassError as error:
            raise SceneError(f"{medium.name}: index: {error}; {valid}") from None
        for each in found:
            if not 0.0 < each.value <= MOST_INDEX:
                raise SceneError(f"{medium.name}: {each.in_words()}; {valid}")


def _rays_through(formulas: Gradients, box: Array) -> Array:
    """Return probe rays from the faces of a box, (n, 8): rows of `GradientRay`."""
    random = np.random.default_rng(0)
    starts = box[0] + (box[1] - box[0]) * random.random((FORMULA_PROBES, 3))
    faces = np.arange(FORMULA_PROBES) % 6
    starts[np.arange(FORMULA_PROBES), faces // 2] = box[faces % 2, faces // 2]
    along = box[0] + (box[1] - box[0]) * random.random((FORMULA_PROBES, 3)) - starts
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    n = np.sqrt(fields_at(formulas, 0, starts)[:, 0])
    return np.hstack([starts, n[:, None] * along, np.zeros((FORMULA_PROBES, 2))])


def _error(ends: tuple[Array, NDArray[np.int64]], truth: tuple[Array, NDArray[np.int64]]) -> float:
    """Return the largest angle between probe rays at their exits, rad; inf if too few can be compared.

    A ray that grazes a face may miss its exit between two steps, and leave far behind; it is not compared.
    """
    (rays, faces), (right, by) = ends, truth
    same = (faces == by) & (np.abs(rays[:, 7] - right[:, 7]) <= SAME_EXIT * right[:, 7])
    if np.count_nonzero(same) < FEWEST_COMPARED * len(rays):
        return np.inf
    return float(deflections(rays[same], right[same]).max())


def _ends(formulas: Gradients, box: Array, rays: Array, cells: int) -> tuple[Array, NDArray[np.int64]]:
    """Return probe rays at their exits from a box, and the faces, with steps of a fraction of its longest edge."""
    rows = field_table([_uniform(box, cells, 1)]).rows
    ends, faces = rays.copy(), np.full(len(rays), INSIDE)
    _follow_formula(formulas, rows, 0, ends, faces, None)
    return ends, faces


def bending_fields(
    media: Sequence[FieldMedium], moves: Array, around: Array, slots: NDArray[np.int64]
) -> BendingFields | None:
    """Return the table of media that bend light; None without any.

    Parameters
    ----------
    media : sequence of FieldMedium
    moves : (6, 6, 3, 4) float64
        See `frame_table`.
    around : (wavelengths,) float64
        Index of air, or of the object medium.
    slots : (n,) int64
        Slots of the book for trapped light.
    """
    if not media:
        return None
    from_own = np.array([frame.compose(moves[WORLD_FRAME, OBJECT_FRAME], each.medium.to_world) for each in media])
    profiles = [profile for each in media for profile in each.medium.formulas]
    formula = np.full((len(media), len(around)), NO_FORMULA, np.int64)
    by_formula = np.array([len(each.medium.formulas) > 0 for each in media])
    formula[by_formula] = np.arange(len(profiles)).reshape(-1, len(around))
    return BendingFields(
        fields=field_table([each.field for each in media]),
        wavelengths=len(around),
        around=around.copy(),
        to_own=np.array([frame.inverse(each) for each in from_own]),
        from_own=from_own,
        free=np.zeros(len(media), np.bool_),
        medium=np.array([each.medium.number for each in media], np.int64),
        slot=slots,
        deflection=max(each.probe.deflection for each in media),
        alone=False,
        emit_radiance=False,
        curves=True,
        formula=formula.ravel(),
        formulas=gradient_table(profiles) if profiles else None,
    )


def at_wavelength(
    fields: BendingFields, scene: Scene, wavelengths_nm: tuple[float, float], media: Media
) -> BendingFields:
    """Return the table at another wavelength, with the same steps and no file read again.

    Parameters
    ----------
    fields : BendingFields
        Table of the scene.
    scene : Scene
    wavelengths_nm : (float, float)
        First wavelength of the scene, and the new one.
    media : Media
        Media of object space at the new wavelength.
    """
    rows = fields.fields.rows[:: fields.wavelengths].copy()
    formula, profiles = np.full(len(rows), NO_FORMULA, np.int64), list[GradientProfile]()
    for k, row in enumerate(rows):
        medium = scene.media[fields.medium[k]]
        if fields.formula[k * fields.wavelengths] >= 0 and isinstance(medium.index, Gradient):
            formula[k] = len(profiles)
            profiles.append(medium.index.profile(wavelengths_nm[1]))
        offsets, scales = density_law(wavelengths_nm, scene.camera.air, medium.gladstone_dale_m3_kg)
        if row["scale"] == scales[0]:
            # A grid of indices has the scale 1.
            middle = (row["offset"] - offsets[0]) / scales[0]
            row["offset"], row["scale"] = offsets[1] + scales[1] * middle, scales[1]
    return fields._replace(
        fields=fields.fields._replace(rows=rows),
        wavelengths=1,
        around=media.indices[AIR].copy(),
        formula=formula,
        formulas=gradient_table(profiles) if profiles else None,
    )


def boxes_of_fields(fields: BendingFields | None) -> Array:
    """Return the corners of the fields, (n, 8, 3) mm, object frame."""
    if fields is None:
        return np.zeros((0, 8, 3))
    rows = fields.fields.rows[:: fields.wavelengths]
    return np.array([frame.points(back, corners_between(row["low"], row["high"]))
                     for row, back in zip(rows, fields.from_own, strict=True)])  # fmt: skip


def beside(fields: BendingFields, number: int, points: Array) -> bool:
    """Tell whether the box of some points lies beside a field, by the axes of the field and of the object frame.

    Parameters
    ----------
    fields : BendingFields
    number : int
        Number of the field.
    points : (n, 3) float64, mm
        Object frame.
    """
    row = fields.fields.rows[number * fields.wavelengths]
    own = frame.points(fields.to_own[number], points)
    corners = boxes_of_fields(fields)[number]
    return bool(
        (own.min(axis=0) > row["high"]).any()
        or (own.max(axis=0) < row["low"]).any()
        or (points.min(axis=0) > corners.max(axis=0)).any()
        or (points.max(axis=0) < corners.min(axis=0)).any()
    )


def with_free(fields: BendingFields, bodies: Sequence[Array]) -> BendingFields:
    """Return the table with its free fields marked.

    Parameters
    ----------
    fields : BendingFields
    bodies : sequence of (n, 3) float64, mm
        Points round each target and round the housing, object frame.
    """
    free = [all(beside(fields, k, points) for points in bodies) for k in range(len(fields.free))]
    return fields._replace(free=np.array(free, np.bool_))


def crossed_at_once(fields: BendingFields | None) -> BendingFields | None:
    """Return the table for recorded paths with vertices at the faces of fields alone, and without other media."""
    return None if fields is None else fields._replace(curves=False, alone=True)


def with_short_chords(fields: BendingFields, footprints_mm: Sequence[float]) -> BendingFields:
    """Return the table with steps whose chords stay near the curve in fields in which something stands.

    Parameters
    ----------
    fields : BendingFields
    footprints_mm : sequence of float
        Size of a pixel at each field.
    """
    rows = fields.fields.rows.copy()
    for k, footprint in enumerate(footprints_mm):
        if fields.free[k]:
            continue
        own = rows[k * fields.wavelengths : (k + 1) * fields.wavelengths]
        bound = _largest_curvature(fields, k)
        row = own[0]
        by_slabs = float(np.linalg.norm((row["high"] - row["low"]) / row["slabs"]))
        by_cells = float(row["step"] * np.linalg.norm(1.0 / row["per_mm"]))
        longest = by_slabs if row["scheme"] == LEAPFROG else by_cells
        # The height of an arc over its chord is κ L² / 8.
        while bound * longest**2 / 8.0 > NEAR_CURVE * footprint and row["step"] > LEAST_STEP:
            own["step"], own["slabs"] = 0.5 * own["step"], 2 * own["slabs"]
            longest *= 0.5
    return fields._replace(fields=fields.fields._replace(rows=rows))


def _largest_curvature(fields: BendingFields, number: int) -> float:
    """Return the approximate largest curvature of rays in a field, 1/mm: |∇n| / n on a lattice of points."""
    row = fields.fields.rows[number * fields.wavelengths]
    counts = np.clip(np.round((row["high"] - row["low"]) * row["per_mm"]).astype(np.int64), 2, MOST_POINTS_ALONG)
    curvatures = np.zeros(fields.wavelengths)
    for colour in range(fields.wavelengths):
        curvatures[colour] = _curvature(fields, number * fields.wavelengths + colour, row["low"], row["high"], counts)
    return float(curvatures.max())


@kernel
def _curvature(fields: BendingFields, number: int, low: Array, high: Array, counts: NDArray[np.int64]) -> float:
    largest = 0.0
    for i in range(counts[0] + 1):
        x = low[0] + (high[0] - low[0]) * i / counts[0]
        for j in range(counts[1] + 1):
            y = low[1] + (high[1] - low[1]) * j / counts[1]
            for k in range(counts[2] + 1):
                z = low[2] + (high[2] - low[2]) * k / counts[2]
                n2, by_x, by_y, by_z = bending_at(fields, number, x, y, z)
                largest = max(largest, np.sqrt(by_x * by_x + by_y * by_y + by_z * by_z) / n2)
    return largest
