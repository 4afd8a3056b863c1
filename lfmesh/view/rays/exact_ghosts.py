"""Image and ghost power from field points, by sequence of surfaces, integrated over the pupil.

The image path and each sequence with two reflections in the camera are traced separately through the exact surfaces,
without noise. So the power on the sensor has a numerical error estimate instead of a standard error. Array, cover and a
reflecting sensor are mirrors like the lens. Paths that meet the curved faces of two lenslets in turn belong to no
sequence.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.analysis.quadrature import Integral, integral
from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.geometry.meshes.levels import EXACT
from lfmesh.geometry.objects.targets import named_target
from lfmesh.scene.first_order.paraxial import Paraxial
from lfmesh.transport.aims.aim_table import widest_disk
from lfmesh.transport.packets.packet import CAMERA_FRAME, SENSOR_FRAME, WORLD_FRAME
from lfmesh.transport.sequences.ray_tables import Arrived, faces_of, follow_sequence
from lfmesh.transport.sequences.sequences import Itinerary
from lfmesh.transport.tables.interfaces import refused_in_order
from lfmesh.transport.tables.tables import THIN_LENS, Tables
from lfmesh.transport.trace import at_wavelength
from lfmesh.transport.world import World
from lfmesh.view.rays.launch import INTENSITY_W_SR
from lfmesh.view.rays.names import label, mirror_names
from lfmesh.view.rays.paths import Rays
from lfmesh.view.rays.shadows import Shadow, in_the_way, is_opaque, shadow

Floats = NDArray[np.float64]

DASH, PLUS_MINUS = "\N{EN DASH}", "\N{PLUS-MINUS SIGN}"

SHOWN = 10
"""Number of printed ghosts."""

BY_QUADRATURE = "Origin quadrature: the pair's sequences are integrated over the pupil; ± is the error of the integral."


@dataclass(frozen=True)
class SequencePower:
    """Power that a sequence of surfaces brings to the sensor.

    Attributes
    ----------
    path : Itinerary
        Path over all faces of the camera, including the array's.
    words : str
        "L1a T, L1b T, L2a R, ..., sensor", as in the path table.
    mirrors : tuple of str
        Labels of the reflecting surfaces, in order.
    power, error : float, W
        Power on the sensor from all field points and wavelengths, and the estimated error of the quadrature.
    focus_mm : float
        Paraxial focus of the first field point from the lens's last vertex, at the scene's primary wavelength; negative
        before the vertex. NaN: the path has no paraxial rays, or is reflected behind the lens.
    """

    path: Itinerary
    words: str
    mirrors: tuple[str, ...]
    power: float
    error: float
    focus_mm: float


@dataclass(frozen=True)
class ExactGhosts:
    """Image path and two-reflection ghosts.

    Attributes
    ----------
    image : SequencePower
    ghosts : list of SequencePower
        In descending order, including ghosts without power.
    image_plane_mm : float
        Distance from the lens's last vertex to the array or, without one, to the sensor.
    with_array : bool
        Whether there is an array.
    mirrors : str
        Reflecting parts in words.
    """

    image: SequencePower
    ghosts: list[SequencePower]
    image_plane_mm: float
    with_array: bool
    mirrors: str

    @cached_property
    def by_words(self) -> dict[str, SequencePower]:
        """All sequences by their words."""
        return {row.words: row for row in (self.image, *self.ghosts)}

    @property
    def power(self) -> float:
        """Power of all ghosts, W."""
        return sum(row.power for row in self.ghosts)

    @property
    def error(self) -> float:
        """Error of `power`, W, as the sum of the ghosts' errors."""
        return sum(row.error for row in self.ghosts)

    def lines(self, most: int = SHOWN) -> list[str]:
        """Return the strongest ghosts for a terminal, one line each, and their total.

        Parameters
        ----------
        most : int
            Number of ghosts to list.

        Returns
        -------
        list of str
        """
        lit = [row for row in self.ghosts if row.power > 0.0]
        lines = [f"{'ghost':<10}{'power/W':>11}{'error/W':>10}{'of image':>10}{'focus/mm':>11}"]
        for row in lit[:most]:
            focus = f"{row.focus_mm:z.2f}" if math.isfinite(row.focus_mm) else "-"
            share = f"{row.power / self.image.power:.1e}" if self.image.power > 0.0 else "-"
            lines.append(f"{DASH.join(row.mirrors):<10}{row.power:11.4e}{row.error:10.1e}{share:>10}{focus:>11}")
        if len(lit) > most:
            rest = sum(row.power for row in lit[most:])
            lines.append(f"and {len(lit) - most} more with {rest:.3e} W")
        what = "array" if self.with_array else "sensor"
        lines += [
            f"image path {self.image.power:.5e} W {PLUS_MINUS} {self.image.error:.0e}; two reflections in the "
            f"{self.mirrors} {self.power:.4e} W {PLUS_MINUS} {self.error:.0e}",
            f"by quadrature over the pupil; focus from the last vertex, the {what} is at {self.image_plane_mm:z.2f} mm",
        ]
        return lines


def exact_ghosts(world: World, points_mm: ArrayLike, wavelengths_nm: Sequence[float] | None = None) -> ExactGhosts:
    """Integrate the power of the image and of the two-reflection ghosts on the sensor.

    Each field point emits 1 W/sr at each wavelength. Opaque targets block its light to the lens; light that they
    reflect or scatter belongs to no sequence.

    Parameters
    ----------
    world : World
    points_mm : (n, 3) float, mm, world frame
        Points in front of the lens.
    wavelengths_nm : sequence of float, optional
        Default: the scene's wavelengths.

    Returns
    -------
    ExactGhosts

    Raises
    ------
    LfmeshError
        The scene has parts that sequences cannot include, see `refusal`, or a point is not in front of the lens.
    """
    shape = world.lens_shape
    if (obstacle := refusal(world, points_mm)) is not None:
        raise LfmeshError(f"ghosts by sequence: {obstacle}")
    points = _in_camera(world, points_mm)
    if (points[:, 2] >= world.tables.lens.box_low[2]).any():
        raise LfmeshError("ghosts by sequence: a field point must lie in front of the lens")
    tables = [at_wavelength(world, wavelength) for wavelength in wavelengths_nm or world.scene.wavelengths_nm]
    # A concave side may be met twice; of an asphere, either.
    sides = [
        (k, behind)
        for k, surface in enumerate(shape.surfaces)
        for behind in (False, True)
        if surface["terms"] > 0 or (surface["curvature"] > 0.0 if behind else surface["curvature"] < 0.0)
    ]
    shaded = [(point, shadow(world, point)) for point in points]
    found = [_brought(world, tables, shaded, path) for path in _paths(world.tables, sides)]
    camera = world.scene.camera
    plane = camera.mla.distance_mm if camera.mla is not None else camera.sensor.distance_mm
    ghosts = sorted(found[1:], key=lambda row: -row.power)
    with_array, mirrors = camera.mla is not None, _mirrors_in_words(world.tables)
    return ExactGhosts(found[0], ghosts, float(plane or math.nan), with_array, mirrors)


def _paths(tables: Tables, hollow: list[tuple[int, bool]]) -> list[Itinerary]:
    """Return the image path and all paths with two reflections; thin lenses do not reflect."""
    thin = frozenset(np.flatnonzero(tables.lens.interfaces.rows["kind"] == THIN_LENS).tolist())
    return [path for path in faces_of(tables).paths(hollow) if thin.isdisjoint(path.mirrors)]


def _mirrors_in_words(tables: Tables) -> str:
    """Return the reflecting parts in words: lens, array, sensor cover, sensor."""
    there = {"array": tables.mla.present, "cover": tables.cover is not None, "sensor": tables.sensor.reflectance > 0.0}
    behind = [name for name, reflects in there.items() if reflects]
    return " and ".join([", ".join(["lens", *behind[:-1]]), *behind[-1:]])


def refusal(world: World, points_mm: ArrayLike) -> str | None:
    """Return the reason why ghosts of field points cannot be traced by sequence in a scene, or None.

    Parameters
    ----------
    world : World
    points_mm : (n, 3) float, mm, world frame
    """
    scene, shape = world.scene, world.lens_shape
    if not (shape.analytic.all() and (shape.surfaces["level"] == EXACT).all()):
        return 'sequences need exact surfaces of the lens: transport.surface = "exact", and no mesh glass in it'
    if scene.transport.polarisation:
        return "transport.polarisation = true: sequences are followed without polarisation"
    if (number := scene.camera.lens.number_off_revolution) is not None:
        key, followed = scene.camera.lens.surfaces[number].asymmetric_key, scene.camera.lens.kinds_followed(number)
        return f"camera.lens.surfaces[{number}].{key}: sequences are followed through {followed}"
    for name in ("media", "particles", "tanks"):
        if getattr(scene, name):
            return f"{name} stand between field points and lens; sequences are not followed through them"
    if (rough := refused_in_order(scene)) is not None:
        return rough
    clear = [number for number in range(len(world.targets)) if not is_opaque(world, number)]
    for point in _in_camera(world, points_mm):
        for number in in_the_way(world, point, clear) if point[2] < world.tables.lens.box_low[2] else ():
            return (
                f"{named_target(scene, number)} stands between a field point and the lens and transmits light along "
                "paths that no sequence follows"
            )
    return None


def _in_camera(world: World, points_mm: ArrayLike) -> Floats:
    return frames.points(world.tables.frames[WORLD_FRAME, CAMERA_FRAME], np.atleast_2d(np.asarray(points_mm, float)))


def exact_of(rays: Rays) -> ExactGhosts | None:
    """Return `exact_ghosts` for a launch from field points in a scene without `refusal`, else None."""
    if rays.field is None or refusal(rays.world, rays.field.points_mm) is not None:
        return None
    return exact_ghosts(rays.world, rays.field.points_mm, rays.field.wavelengths_nm)


def origin_in_words(rays: Rays, *, is_whole: bool) -> str:
    """Describe the origin of the powers, and the reason if it is not quadrature.

    Parameters
    ----------
    rays : Rays
        Rays of the launch.
    is_whole : bool
        Whether the filter keeps all of them.
    """
    if rays.field is None:
        why = "only rays from field points are integrated"
    elif (obstacle := refusal(rays.world, rays.field.points_mm)) is not None:
        why = obstacle
    elif not is_whole:
        why = "a filter selects rays, and an integral over the pupil cannot be filtered"
    else:
        return BY_QUADRATURE
    return f"All powers are from the rays, ± their standard error: {why}."


def _brought(
    world: World, tables: list[Tables], points: list[tuple[Floats, Shadow | None]], path: Itinerary
) -> SequencePower:
    """Return the power of a path on the sensor from field points (camera frame), each with its obstacles."""
    parts = [_from_point(each, point, path, shade) for each in tables for point, shade in points]
    faces = [label(name) for name in mirror_names(world)]
    words = [
        f"{faces[face]} {'R' if mirrors else 'T'}" for face, mirrors in zip(path.faces, path.reflected, strict=True)
    ]
    return SequencePower(
        path, ", ".join([*words, "sensor"]), tuple(faces[face] for face in path.mirrors),
        sum(part.value for part in parts), sum(part.error for part in parts),
        _focus_mm(world, path, -float(points[0][0][2])),
    )  # fmt: skip


def _from_point(tables: Tables, point: Floats, path: Itinerary, shade: Shadow | None) -> Integral:
    """Integrate the intensity on the sensor over the plane before the lens."""
    plane_z, radius = float(tables.lens.box_low[2]), widest_disk(tables.lens, point[None], front=True)

    def irradiance(at: Floats) -> Floats:
        ray = np.column_stack([at, np.full(len(at), plane_z)]) - point
        length = np.linalg.norm(ray, axis=1)
        arrived = follow_sequence(tables, path, np.broadcast_to(point, ray.shape), ray / length[:, None])
        side = _side_of_sensor(arrived, tables)
        found = np.where(side == 0, arrived.weight * (1.0 - tables.sensor.reflectance), 0.0)
        light = INTENSITY_W_SR * found * ray[:, 2] / length**3
        return np.where(light > 0.0, light, -_darkness(arrived, side))

    return integral(irradiance, radius, shade)


def _darkness(arrived: Arrived, beside: NDArray[np.int64]) -> Floats:
    """Return numbers that distinguish dark rays by their end: surface and side, or the side of the sensor they miss.

    A narrow lit region may lie between two numbers, where the rays pass from one side of an aperture or of the sensor
    to the other.
    """
    side = 2 * (arrived.position[:, 0] > 0.0) + (arrived.position[:, 1] > 0.0)
    return np.asarray(14.0 * (1.0 + arrived.way) + np.where(arrived.weight > 0.0, 4 + beside, side))


def _side_of_sensor(rays: Arrived, tables: Tables) -> NDArray[np.int64]:
    """Return the side of the pixels on which rays (camera frame) cross the sensor's plane: one of eight.

    0: on a pixel; 9: they move away from the plane.
    """
    move, sensor = tables.frames[CAMERA_FRAME, SENSOR_FRAME], tables.sensor
    p, d = frames.points(move, rays.position), frames.directions(move, rays.direction)
    half = 0.5 * sensor.pixel * np.array([sensor.columns, sensor.rows])
    with np.errstate(divide="ignore", invalid="ignore"):
        at = p[:, :2] - (p[:, 2] / d[:, 2])[:, None] * d[:, :2]
    side = np.where(np.abs(at) <= half, 0, np.where(at > 0.0, 1, 2)) @ [1, 3]
    return np.where((d[:, 2] > 0.0) & (p[:, 2] <= 0.0), side, 9)


def _focus_mm(world: World, path: Itinerary, object_mm: float) -> float:
    """Return the distance of a path's paraxial focus behind the last vertex."""
    lens, primary = world.scene.camera.lens, world.scene.primary_nm
    paraxial, numbers = Paraxial.of(lens, primary), world.lens_shape.numbers
    if not path.mirrors:
        return paraxial.image_mm(object_mm)
    first, second = path.mirrors
    if first == second or max(first, second) >= len(numbers):
        return math.nan
    ray = paraxial.reflected_twice(numbers[first], numbers[second])(paraxial.axial_ray(object_mm))
    return -paraxial.image_index * ray.height_mm / ray.angle if ray.angle else math.inf
