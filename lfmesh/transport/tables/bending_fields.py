"""Tables for kernels of the media in object space that bend light.

The index comes from a voxel grid or, for gradient-index glass, from a formula. A field without targets, glass or
housing in its box is free: rays cross it without a search for a hit.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.geometry import frame
from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined
from lfmesh.optics.gradient_shapes import GradientProfile
from lfmesh.optics.gradients import Gradients, field_at, fields_at, gradient_table
from lfmesh.optics.index_field_path import INSIDE, deflections, follower
from lfmesh.optics.index_field_steps import FINEST, FieldProbe, probed, with_steps
from lfmesh.optics.index_fields import (
    RUNGE_KUTTA,
    IndexField,
    IndexFields,
    field_table,
    index_field_at,
)
from lfmesh.scene import Scene
from lfmesh.scene.media.bending import index_field_of
from lfmesh.scene.media.media import Medium
from lfmesh.scene.objects.shapes import Box
from lfmesh.transport.packets.packet import OBJECT_FRAME, WORLD_FRAME

Array = NDArray[np.float64]

NO_FORMULA = -1
"""`BendingFields.formula` of a row with a voxel grid."""

FEWEST_CELLS, MOST_CELLS = 8, 1 << 13
"""Smallest and largest number of steps along the longest edge of a field given by a formula."""

FORMULA_PROBES = 64
"""Probe rays that give the steps of a formula."""


@by_address
class BendingFields(NamedTuple):
    """Media that bend light, each with a box of its own; rows of a field at all wavelengths are in succession."""

    fields: IndexFields  # (n · wavelengths,) rows; of a formula, only box and steps are used
    wavelengths: int
    to_own: Array  # (n, 3, 4) from the object frame to the field's own
    from_own: Array  # (n, 3, 4) the inverse
    free: NDArray[np.bool_]  # (n,) whether the boxes of all targets and of the housing lie beside the field's
    medium: NDArray[np.int64]  # (n,) number of the medium in the scene
    slot: NDArray[np.int64]  # (n,) slot of the book of light that is trapped
    deflection: float  # rad, largest of all
    curves: bool  # recorded paths have a vertex at the end of each chord, not only at the faces of fields
    formula: NDArray[np.int64]  # (n · wavelengths,) row in `formulas`, or NO_FORMULA
    formulas: Any = None  # Gradients if an index is a formula, else None: code for them is not even compiled


class FieldMedium(NamedTuple):
    """A medium that bends light.

    Attributes
    ----------
    number : int
        Number of the medium in the scene.
    field : IndexField
        At all wavelengths; of a formula, only bounds and steps are used.
    profiles : tuple of GradientProfile
        One for each wavelength, if the index is a formula; else empty.
    probe : FieldProbe
    """

    number: int
    field: IndexField
    profiles: tuple[GradientProfile, ...]
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


def bending_media(scene: Scene, wavelengths_nm: Sequence[float]) -> list[FieldMedium]:
    """Return the media of a scene that bend light, with their steps.

    Parameters
    ----------
    scene : Scene
    wavelengths_nm : (wavelengths,) sequence of float

    Raises
    ------
    SceneError, FileError
        A grid cannot be used, an index is not real, or a formula bends light too strongly.
    """
    found = []
    for number, medium in enumerate(scene.media):
        if not medium.bends:
            continue
        given = index_field_of(medium, wavelengths_nm, scene.camera.air)
        if isinstance(given, IndexField):
            probe = probed(given)
            found.append(FieldMedium(number, with_steps(given, probe), (), probe))
            continue
        profiles = (given,) * len(wavelengths_nm) if isinstance(given, GradientProfile) else tuple(given)
        found.append(_by_formula(f"media[{number}]", number, medium, profiles))
    return found


def _by_formula(where: str, number: int, medium: Medium, profiles: tuple[GradientProfile, ...]) -> FieldMedium:
    """Return a medium with an index by a formula, with the steps that probe rays need."""
    if not isinstance(medium.bounds, Box):
        raise SceneError(f"{where}.index: a formula has no bounds of its own; give the medium a box")
    half = 0.5 * np.array(medium.bounds.size_mm)
    box = np.array([-half, half])
    formulas = gradient_table(profiles)
    points = _points_in(box)
    squares = np.array([fields_at(formulas, row, points)[:, 0] for row in range(len(profiles))])
    if not (squares > 0.0).all():
        raise SceneError(f"{where}.index: n² = {squares.min():.6g} in its box; the index must be real everywhere")
    rays = _rays_through(formulas, box)
    cells, (starts, truth) = FEWEST_CELLS, _ends(formulas, box, rays, 2 * MOST_CELLS)
    largest, error = float(deflections(starts, truth).max(initial=0.0)), np.inf
    while cells <= MOST_CELLS:
        _, ends = _ends(formulas, box, rays, cells)
        error = float(deflections(ends, truth).max(initial=0.0)) / largest if largest > 0.0 else 0.0
        if error <= FINEST:
            break
        cells *= 2
    else:
        raise SceneError(f"{where}.index: bends light too strongly in its box; give a smaller box")
    row = _uniform(box, cells, len(profiles))
    return FieldMedium(number, row, profiles, FieldProbe(RUNGE_KUTTA, 1.0, largest, error, 0.0, 0))


def _uniform(box: Array, cells: int, wavelengths: int) -> IndexField:
    """Return a uniform field of a box with steps of a fraction of its longest edge, for the table of a formula."""
    size = box[1] - box[0]
    spacing = np.full(3, float(size.max()) / cells)
    return IndexField(
        np.zeros((4, 4, 4)), spacing, box[0].copy(), box, np.ones(wavelengths), np.zeros(wavelengths), RUNGE_KUTTA, 1.0
    )


def _points_in(box: Array) -> Array:
    """Return a lattice of points in a box, (n, 3)."""
    steps = np.linspace(0.0, 1.0, 17)
    return box[0] + (box[1] - box[0]) * np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)


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


def _ends(formulas: Gradients, box: Array, rays: Array, cells: int) -> tuple[Array, Array]:
    """Return probe rays that leave a box at their starts and ends, with steps of a fraction of its longest edge."""
    rows = field_table([_uniform(box, cells, 1)]).rows
    ends, faces = rays.copy(), np.full(len(rays), INSIDE)
    _follow_formula(formulas, rows, 0, ends, faces, None)
    return rays, ends


def bending_fields(
    media: Sequence[FieldMedium], scene: Scene, moves: Array, wide: int, slots: NDArray[np.int64]
) -> BendingFields | None:
    """Return the table of media that bend light; None without any.

    Parameters
    ----------
    media : sequence of FieldMedium
    scene : Scene
    moves : (6, 6, 3, 4) float64
        See `frame_table`.
    wide : int
        Number of wavelengths.
    slots : (n,) int64
        Slots of the book of trapped light.
    """
    if not media:
        return None
    own = [scene.media[each.number] for each in media]
    to_own = np.array([frame.compose(frame.inverse(frame.frame(m.rotation_deg, m.position_mm)),
                                     moves[OBJECT_FRAME, WORLD_FRAME]) for m in own])  # fmt: skip
    profiles = [profile for each in media for profile in each.profiles]
    formula = np.full((len(media), wide), NO_FORMULA, np.int64)
    by_formula = np.array([bool(each.profiles) for each in media])
    formula[by_formula] = np.arange(len(profiles)).reshape(-1, wide)
    return BendingFields(
        fields=field_table([each.field for each in media]),
        wavelengths=wide,
        to_own=to_own,
        from_own=np.array([frame.inverse(each) for each in to_own]),
        free=np.zeros(len(media), np.bool_),
        medium=np.array([each.number for each in media], np.int64),
        slot=slots,
        deflection=max(each.probe.deflection for each in media),
        curves=True,
        formula=formula.ravel(),
        formulas=gradient_table(profiles) if profiles else None,
    )


def boxes_of_fields(fields: BendingFields | None) -> Array:
    """Return the corners of the fields, (n, 8, 3) mm, object frame."""
    if fields is None:
        return np.zeros((0, 8, 3))
    rows = fields.fields.rows[:: fields.wavelengths]
    return np.array([frame.points(back, corners_between(row["low"], row["high"]))
                     for row, back in zip(rows, fields.from_own, strict=True)])  # fmt: skip


def corners_between(low: Array, high: Array) -> Array:
    """Return the corners of a box, (8, 3), from its lowest and its highest one."""
    return np.array([[(low, high)[i][0], (low, high)[j][1], (low, high)[k][2]]
                     for i in (0, 1) for j in (0, 1) for k in (0, 1)])  # fmt: skip


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


def with_free(fields: BendingFields | None, bodies: Sequence[Array]) -> BendingFields | None:
    """Return the table with its free fields marked.

    Parameters
    ----------
    fields : BendingFields or None
    bodies : sequence of (n, 3) float64, mm
        Points round each target and round the housing, object frame.
    """
    if fields is None:
        return None
    free = [all(beside(fields, k, points) for points in bodies) for k in range(len(fields.free))]
    return fields._replace(free=np.array(free, np.bool_))


def faces_only(fields: BendingFields | None) -> BendingFields | None:
    """Return the table for recorded paths with vertices at the faces of fields alone."""
    return None if fields is None else fields._replace(curves=False)
