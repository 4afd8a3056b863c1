"""Media that bend light: the index field of each, its box in the world, and scenes in which fields cannot be traced."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import GlassError, SceneError
from lfmesh.geometry import frame
from lfmesh.geometry.box_corners import corners_between
from lfmesh.geometry.voxels import INDEX_QUANTITIES, OF_LINES, VoxelGrid, quantities_in, read_voxels
from lfmesh.optics.gladstone_dale import air_density
from lfmesh.optics.glass import refractive_index
from lfmesh.optics.gradient_range import InBox, index_range
from lfmesh.optics.gradient_shapes import GradientProfile
from lfmesh.optics.gradients import fields_at, gradient_table
from lfmesh.optics.index_fields import IndexField, field_table, index_field, indices_at
from lfmesh.scene import Medium, Scene
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.materials.own_glass import in_air
from lfmesh.scene.media.bending import density_law, law_faults
from lfmesh.scene.media.media import NOT_A_BOX
from lfmesh.scene.objects.shapes import Box

Array = NDArray[np.float64]

LARGEST_STEP = 1e-3
"""Largest difference of the index across the bounds of a field."""

PARALLEL = 1e-7
"""Sine of the angle below which two edges count as parallel."""

ROUNDING = 1e-12
"""Relative rounding error of distances between boxes."""

FACE_POINTS = 65
"""Least number of points along each edge of a face at which the index is compared with that outside."""


@dataclass(frozen=True, eq=False)
class IndexMedium:
    """A medium that bends light.

    Attributes
    ----------
    number : int
        Its place in `scene.media`.
    name : str
        Its path in the scene file, with its own name if it has one.
    to_world : (3, 4) float64
        Its own frame as seen from the world.
    bounds_mm : (2, 3) float64
        Lowest and highest corner of the box in which it bends light, own frame.
    field : IndexField or None
        At all wavelengths, in its own frame; None if the index is a formula.
    formulas : tuple of GradientProfile
        Formula of the index at each wavelength, own frame; empty if there is a field.
    """

    number: int
    name: str
    to_world: Array
    bounds_mm: Array
    field: IndexField | None
    formulas: tuple[GradientProfile, ...] = ()

    def corners_mm(self) -> Array:
        """Return the corners of its box in the world, (8, 3)."""
        return frame.points(self.to_world, corners_between(*self.bounds_mm))

    def indices(self, column: int, points: Array) -> Array:
        """Return the index at points.

        Parameters
        ----------
        column : int
            Wavelength.
        points : (n, 3) float64, mm
            In its own frame.

        Returns
        -------
        (n,) float64
            NaN where n² of a formula is negative.
        """
        if self.field is not None:
            return np.asarray(indices_at(field_table([self.field]), column, points)[:, 0])
        with np.errstate(invalid="ignore"):
            return np.sqrt(fields_at(gradient_table([self.formulas[column]]), 0, points)[:, 0])


def bends(scene: Scene, medium: Medium) -> bool:
    """Return True if a medium of a scene bends light, by a key or by an array of its grid.

    Parameters
    ----------
    scene : Scene
    medium : Medium
    """
    if medium.bends or medium.grid is None:
        return medium.bends
    names = quantities_in(scene.resolve(medium.grid.file), medium.grid.quantity)
    return any(name in INDEX_QUANTITIES for name in names)


def only_bends(scene: Scene, medium: Medium) -> bool:
    """Return True if a medium of a scene bends light, and neither absorbs, scatters nor emits it.

    Parameters
    ----------
    scene : Scene
    medium : Medium
    """
    if medium.acts or not bends(scene, medium):
        return False
    held = () if medium.grid is None else quantities_in(scene.resolve(medium.grid.file), medium.grid.quantity)
    return not any(name in OF_LINES for name in held)


def any_bends(scene: Scene) -> bool:
    """Return True if a medium of a scene bends light."""
    return any(bends(scene, medium) for medium in scene.media)


def refuse_bending(scene: Scene, why: str) -> None:
    """Refuse media that bend light.

    Parameters
    ----------
    scene : Scene
    why : str
        Reason, with what is valid.

    Raises
    ------
    SceneError
    """
    for number, medium in enumerate(scene.media):
        if bends(scene, medium):
            name = f"media[{number}]" + (f" ({medium.name})" if medium.name else "")
            raise SceneError(f"{name} bends light: {why}")


def index_media(scene: Scene, wavelengths_nm: tuple[float, ...]) -> list[IndexMedium]:
    """Return the media of a scene that bend light.

    Parameters
    ----------
    scene : Scene
        Solved.
    wavelengths_nm : tuple of float

    Raises
    ------
    SceneError, FileError
        A grid cannot be used, an index is missing, given twice or not above 0, two fields overlap, or an index steps by
        more than `LARGEST_STEP` at the bounds of a field.
    """
    found = [
        index_medium(scene, number, wavelengths_nm) for number, medium in enumerate(scene.media) if bends(scene, medium)
    ]
    for one, other in combinations(found, 2):
        if boxes_overlap(one, other):
            raise SceneError(f"{one.name} and {other.name} both bend light, but overlap; move them apart")
    for medium in found:
        _refuse_steps(scene, medium, wavelengths_nm)
    return found


def index_medium(scene: Scene, number: int, wavelengths_nm: tuple[float, ...]) -> IndexMedium:
    """Return a medium that bends light, without the checks that concern what is around it.

    Parameters
    ----------
    scene : Scene
    number : int
        Its place in `scene.media`.
    wavelengths_nm : tuple of float

    Raises
    ------
    SceneError, FileError
        Its grid cannot be used, or its index is missing, given twice or not above 0.
    """
    medium = scene.media[number]
    name = f"media[{number}]" + (f" ({medium.name})" if medium.name else "")
    to_world = frame.frame(medium.rotation_deg, medium.position_mm)
    grid = _grid_of(scene, medium, name)
    bounds = _bounds(medium, grid, name)
    if isinstance(medium.index, Gradient):
        try:
            medium.index.check_region(InBox.of(*bounds))
        except GlassError as error:
            raise SceneError(f"{name}: index: {error}") from None
        formulas = tuple(medium.index.profile(each) for each in wavelengths_nm)
        return IndexMedium(number, name, to_world, bounds, None, formulas)
    try:
        values, law = _values_and_law(scene, medium, {} if grid is None else dict(grid.values), wavelengths_nm)
        return IndexMedium(number, name, to_world, bounds, _interpolated(values, law, grid, bounds))
    except SceneError as error:
        raise SceneError(f"{name}: {error}") from None


def _interpolated(values: Array, law: tuple[Array, Array], grid: VoxelGrid | None, bounds: Array) -> IndexField:
    """Return the field of a quantity, an array [x, y, z] or a number, within its bounds."""
    if grid is None or values.ndim == 0:
        # One node in the middle: the index is the same everywhere.
        size = bounds[1] - bounds[0]
        return index_field(values.reshape(1, 1, 1), size, bounds.mean(axis=0), bounds, law)
    return index_field(values, grid.spacing_mm, grid.origin_mm, bounds, law)


def _grid_of(scene: Scene, medium: Medium, name: str) -> VoxelGrid | None:
    """Return the grid of a medium; refuse keys and arrays that do not give one index."""
    given = {key for key in (*INDEX_QUANTITIES, "gladstone_dale_m3_kg", "temperature_k") if _has(medium, key)}
    grid = None
    if (source := medium.grid) is not None:
        path = scene.resolve(source.file)
        grid = read_voxels(path, source.spacing_mm, source.origin_mm, source.interpolation, source.quantity)
        if twice := sorted(given & grid.values.keys()):
            raise SceneError(f"{name}: {twice[0]}: {source.file} gives it by voxels; give one of them")
        given |= grid.values.keys()
    for key, why in law_faults(given, whole=True):
        raise SceneError(f"{name}: {key}: {why}")
    if medium.inside is not None:
        raise SceneError(f"{name}: inside: a medium that bends light is in air or the object medium only; omit it")
    return grid


def _has(medium: Medium, key: str) -> bool:
    return getattr(medium, key) is not None


def _bounds(medium: Medium, grid: VoxelGrid | None, name: str) -> Array:
    """Return the lowest and highest corner of a field, (2, 3) mm: the box of its bounds and of its grid."""
    low, high = np.full(3, -np.inf), np.full(3, np.inf)
    if grid is not None:
        low, high = grid.bounds_mm
    if isinstance(medium.bounds, Box):
        half = 0.5 * np.array(medium.bounds.size_mm)
        low, high = np.maximum(low, -half), np.minimum(high, half)
    elif medium.bounds is not None or grid is None:
        raise SceneError(f"{name}: bounds: {NOT_A_BOX}")
    if not (low < high).all():
        raise SceneError(f"{name}: its bounds and its grid have nothing in common; move origin_mm")
    return np.array([low, high])


def _values_and_law(
    scene: Scene, medium: Medium, arrays: dict[str, Array], wavelengths_nm: tuple[float, ...]
) -> tuple[Array, tuple[Array, Array]]:
    """Return the quantity that sets the index, an array [x, y, z] or a number, and the numbers a and b of its law."""

    def quantity(key: str) -> Array:
        return np.asarray(arrays[key] if key in arrays else getattr(medium, key), np.float64)

    def given(key: str) -> bool:
        return key in arrays or getattr(medium, key) is not None

    if given("index"):
        return quantity("index"), (np.zeros(len(wavelengths_nm)), np.ones(len(wavelengths_nm)))
    law = density_law(wavelengths_nm, scene.camera.air, medium.gladstone_dale_m3_kg)
    if given("density_kg_m3"):
        return quantity("density_kg_m3"), law
    temperature = quantity("temperature_k")
    if not temperature.min() > 0.0:
        raise SceneError("temperature_k is 0 at a voxel; with pressure_kpa it must be above 0")
    return air_density(temperature, quantity("pressure_kpa")), law


def boxes_overlap(one: IndexMedium, other: IndexMedium) -> bool:
    """Return True if the boxes of two media have a volume in common; boxes that touch do not.

    Two boxes are apart if and only if an axis separates them that is normal to a face of one, or to an edge of each (S.
    Gottschalk, M. C. Lin and D. Manocha, SIGGRAPH 1996).

    Parameters
    ----------
    one, other : IndexMedium
    """
    turn = one.to_world[:, :3].T @ other.to_world[:, :3]
    half = [0.5 * (each.bounds_mm[1] - each.bounds_mm[0]) for each in (one, other)]
    middles = [frame.points(each.to_world, each.bounds_mm.mean(axis=0)) for each in (one, other)]
    apart = one.to_world[:, :3].T @ (middles[1] - middles[0]).ravel()
    axes = [*np.eye(3), *turn.T, *(np.cross(a, b) for a in np.eye(3) for b in turn.T)]
    size = float(np.abs(apart).max() + half[0].max() + half[1].max())
    for axis in axes:
        length = float(np.linalg.norm(axis))
        # Edges that are parallel up to rounding give no axis; the faces' normals then suffice.
        if length < PARALLEL:
            continue
        reach = half[0] @ np.abs(axis) + half[1] @ np.abs(turn.T @ axis)
        if abs(float(apart @ axis)) >= reach - ROUNDING * size * length:
            return False
    return True


def _refuse_steps(scene: Scene, medium: IndexMedium, wavelengths_nm: tuple[float, ...]) -> None:
    """Refuse an index that steps at the bounds of a field more than chords between nodes can take."""
    camera = scene.camera
    matter = camera.object_medium or camera.lens.object_medium
    outside = in_air(matter, camera.air).medium if matter is not None else None
    points = np.concatenate(_face_points(medium)) if medium.field is not None else np.zeros((0, 3))
    for column, wavelength in enumerate(wavelengths_nm):
        around = refractive_index(outside, wavelength)
        try:
            found = medium.indices(column, points) if medium.field is not None else _on_faces(medium, column)
        except GlassError as error:
            raise SceneError(f"{medium.name}: index: {error}; give smaller coefficients") from None
        step = float(np.abs(found - around).max())
        if not step <= LARGEST_STEP:
            raise SceneError(
                f"{medium.name}: its index differs by {step:.3g} from {around:.6g} around it at a face of its bounds, "
                f"and at most {LARGEST_STEP:g} is traced; enlarge the field until it fades, or give a body of glass"
            )


def _on_faces(medium: IndexMedium, column: int) -> Array:
    """Return the smallest and the largest index of a formula on each face of its box, (12,)."""
    found = []
    for axis in range(3):
        for at in medium.bounds_mm[:, axis]:
            low, high = medium.bounds_mm.copy()
            low[axis] = high[axis] = at
            found += [each.value for each in index_range(medium.formulas[column], InBox.of(low, high))]
    return np.array(found)


def _face_points(medium: IndexMedium) -> list[Array]:
    """Return points on each face of a field, (n, 3): those on the edges, and at least two for each voxel."""
    low, high = medium.bounds_mm
    counts = np.full(3, FACE_POINTS)
    if medium.field is not None:
        counts = np.maximum(np.ceil(2.0 * (high - low) / medium.field.spacing_mm).astype(int) + 1, counts)
    axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]
    faces = []
    for axis in range(3):
        for at in (low[axis], high[axis]):
            along = [np.array([at]) if other == axis else axes[other] for other in range(3)]
            faces.append(np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, 3))
    return faces
