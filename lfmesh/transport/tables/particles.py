"""Table of particles for kernels."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.geometry import frame
from lfmesh.geometry.box_corners import corners_between
from lfmesh.kernels.by_address import by_address
from lfmesh.optics.phase import PhaseTables, phase_tables
from lfmesh.scene import Scene
from lfmesh.scene.light.particles import (
    DARKEST,
    Particles,
    Sheet,
    particle_places,
    particle_velocities,
    shining_particles,
    unit,
)
from lfmesh.transport.packets.packet import CAMERA_FRAME, OBJECT_FRAME, WORLD_FRAME
from lfmesh.transport.tables.lines import Lines
from lfmesh.transport.tables.motions import Motions
from lfmesh.transport.tables.phases import cross_sections_um2, phase_functions
from lfmesh.transport.tables.spectra import spread
from lfmesh.transport.tables.swept import swept
from lfmesh.transport.tables.tables import Media

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

UM2 = 1e-6
"""One µm² in mm²."""


@by_address
class SheetTable(NamedTuple):
    """A light sheet, see `Sheet`; world frame."""

    point: Array  # (3,) mm
    normal: Array  # (3,) unit
    across: Array  # (3,) unit, along the width
    half_width: float  # mm
    radius: float  # mm, distance from the middle plane where the irradiance is 1/e² of its peak
    peak: float  # W/mm²


@by_address
class Streaks(NamedTuple):
    """Motion of particles during the exposure."""

    velocities: Array  # (n, 3) mm/s, world frame
    sheet: Any  # SheetTable; None if particles shine by themselves


@by_address
class ParticleTables(NamedTuple):
    """Particles of one entry of `[[particles]]`, where they are at t = 0."""

    points: Array  # (n, 3) mm, world frame
    strength: Array  # (n,) W/sr, or W/mm² in a light sheet
    scale: Array  # (wavelengths,) sr or mm²: power, W, over the strength
    along: Array  # (3,) unit, world frame: direction of the light before scattering
    phases: PhaseTables  # with one function
    samples: int  # packets per particle, all replicates together
    entry: int  # number of the entry in the scene
    inside: Numbers  # (n,) bodies of glass or liquid around each, as packets hold them
    streaks: Any = None  # Streaks of particles that move, else None


def particle_tables(
    scene: Scene, lines: Lines, media: Media, places: Callable[[Array], tuple[Numbers, Numbers]]
) -> tuple[ParticleTables, ...]:
    """Return the particles of a scene, without entries that do not shine.

    Parameters
    ----------
    scene : Scene
    lines : Lines
    media : Media
        Of object space.
    places : callable
        Returns, for points (n, 3) in mm, world frame, the bodies around them, as packets hold them, and their media.

    Raises
    ------
    SceneError, FileError
        A file or spectrum cannot be used, or particles of an entry scatter in different media.
    """
    tables = []
    for number, group in enumerate(scene.particles):
        where = f"particles[{number}]"
        points, strength, velocities = _shining(group, scene)
        if not len(points):
            continue
        inside, numbers = places(points)
        index = _index_round(group, media, numbers, where)
        functions = phase_functions(group.phase, lines.wavelengths_nm, scene, f"{where}.phase", index)
        scale = spread(scene, 1.0, group.spectrum, lines, f"{where}.spectrum") * _power(group, lines, where, index)
        along = np.array([0.0, 0.0, 1.0])
        if group.sheet is not None:
            along = unit(group.sheet.direction)
        phases, streaks = phase_tables([functions]), None
        if velocities is not None:
            streaks = Streaks(velocities, None if group.sheet is None else _sheet_table(group.sheet))
        tables.append(ParticleTables(points, strength, scale, along, phases, group.samples, number, inside, streaks))
    return tuple(tables)


def _shining(group: Particles, scene: Scene) -> tuple[Array, Array, Array | None]:
    """Return the particles of a group that shine at some time of the exposure, and their velocities, (n, 3) mm/s.

    See `shining_particles`; the velocities are None at rest. A particle in a light sheet counts by its strength where
    it passes nearest to the middle of the sheet.
    """
    if group.frame_time_s is None or scene.exposure is None:
        return *shining_particles(group, scene), None
    points, strength = particle_places(group, scene)
    velocities = particle_velocities(group, points, scene)
    assert velocities is not None
    brightest, least = strength, 0.0
    if group.sheet is not None:
        paths = velocities * scene.exposure.end_s(scene.camera.sensor.pixels[1])
        brightest = _most_in_sheet(_sheet_table(group.sheet), points, paths)
        least = DARKEST * float(brightest.max(initial=0.0))
    bright = brightest > least
    return points[bright], strength[bright], velocities[bright]


def _sheet_table(sheet: Sheet) -> SheetTable:
    normal, radius = unit(sheet.normal), 0.5 * sheet.thickness_mm
    point = np.array(sheet.point_mm, np.float64)
    peak = float(sheet.irradiance_w_mm2(point[None])[0])
    across = np.cross(normal, unit(sheet.direction))
    return SheetTable(point, normal, across, 0.5 * sheet.width_mm, radius, peak)


def _most_in_sheet(sheet: SheetTable, points: Array, paths: Array) -> Array:
    """Return a bound on the irradiance of a sheet on straight paths from points, (n,) W/mm².

    The bound takes the nearest place to the middle plane and the nearest one to the middle of the width by themselves.
    """
    off, aside = (_nearest(points - sheet.point, paths, axis) for axis in (sheet.normal, sheet.across))
    lit = sheet.peak * np.exp(-2.0 * (off / sheet.radius) ** 2)
    return np.asarray(np.where(aside <= sheet.half_width, lit, 0.0))


def _nearest(starts: Array, paths: Array, axis: Array) -> Array:
    """Return the least distance of straight paths from the plane through the origin across an axis, (n,) mm."""
    begin = starts @ axis
    end = begin + paths @ axis
    return np.asarray(np.where(begin * end <= 0.0, 0.0, np.minimum(np.abs(begin), np.abs(end))))


def _index_round(group: Particles, media: Media, numbers: Numbers, where: str) -> Array:
    """Return the refractive index around particles, (wavelengths,); for spheres it must be the same for all.

    Parameters
    ----------
    group : Particles
    media : Media
    numbers : (n,) int64
        Number of the medium around each.
    where : str
        Place in the scene, for messages.
    """
    indices = media.indices[np.unique(numbers)]
    if group.phase.depends_on_surroundings and (indices != indices[0]).any():
        found = ", ".join(f"{index:.6g}" for index in indices[:, 0])
        raise SceneError(
            f"{where}: its particles lie in media of the refractive indices {found}, in which spheres scatter "
            "differently; give one entry for each medium, or phase.surrounding_index"
        )
    return np.asarray(indices[0])


def _power(group: Particles, lines: Lines, where: str, index: Array) -> Array:
    """Return a particle's power over its strength, (wavelengths,): 4π sr, or its cross section, mm²."""
    if group.sheet is None:
        return np.full(len(lines.wavelengths_nm), 4.0 * np.pi)
    cross_section = cross_sections_um2(group.phase, lines.wavelengths_nm, f"{where}.phase", index)
    if cross_section is not None:
        return cross_section * UM2
    diameter = group.diameter_um or 0.0
    return np.full(len(lines.wavelengths_nm), 0.25 * np.pi * diameter**2 * UM2)


def corners_round(tables: tuple[ParticleTables, ...], motions: Motions | None = None) -> Array:
    """Return the corners of boxes that hold the particles of each entry throughout the exposure, (n, 3) mm.

    Parameters
    ----------
    tables : tuple of ParticleTables
    motions : Motions, optional

    Returns
    -------
    (n, 3) float64, mm
        In the world frame at t = 0, which the camera carries along.
    """
    corners = [np.zeros((0, 3))]
    for table in tables:
        places, margin = _paths(table, motions)
        corners.append(corners_between(places.min(axis=0) - margin, places.max(axis=0) + margin))
    return np.concatenate(corners)


def _paths(table: ParticleTables, motions: Motions | None) -> tuple[Array, float]:
    """Return places, (n, 3), and a margin, mm, with all paths of particles in their hull; see `corners_round`."""
    places = table.points
    if motions is None:
        return places, 0.0
    if table.streaks is not None:
        places = np.concatenate([places, places + motions.end_s * table.streaks.velocities])
    if not motions.camera_moves:
        return places, 0.0
    to_object, to_world = motions.frames[WORLD_FRAME, OBJECT_FRAME], motions.frames[OBJECT_FRAME, WORLD_FRAME]
    box = corners_between(places.min(axis=0), places.max(axis=0))
    places, margin = swept(motions, motions.resting, frame.points(to_object, box))
    return frame.points(to_world, places), margin


def refuse_particles_behind(
    tables: tuple[ParticleTables, ...], moves: Array, front_mm: float, motions: Motions | None = None
) -> None:
    """Refuse particles that are not in front of the lens throughout the exposure.

    Parameters
    ----------
    tables : tuple of ParticleTables
    moves : (6, 6, 3, 4) float64
        See `frame_table`.
    front_mm : float, mm
        Outermost plane of the lens, camera frame.
    motions : Motions, optional

    Raises
    ------
    SceneError
        Names the first such particle.
    """
    for table in tables:
        depth = frame.points(moves[WORLD_FRAME, CAMERA_FRAME], table.points)[:, 2]
        wrong = np.flatnonzero(~(depth < front_mm))
        if len(wrong):
            x, y, z = table.points[wrong[0]]
            raise SceneError(
                f"particles: one at ({x:.6g}, {y:.6g}, {z:.6g}) mm does not lie before the lens; in the camera frame "
                f"its z = {depth[wrong[0]]:.6g} mm must be below {front_mm:.6g}"
            )
        places, margin = _paths(table, motions)
        nearest = float(frame.points(moves[WORLD_FRAME, CAMERA_FRAME], places)[:, 2].max()) + margin
        if not nearest < front_mm:
            raise SceneError(
                f"particles[{table.entry}]: during the exposure one may come to z = {nearest:.6g} mm in the camera "
                f"frame; all must stay before the lens, at z below {front_mm:.6g} mm"
            )
