"""Table of particles for kernels."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.geometry import frame
from lfmesh.kernels.by_address import by_address
from lfmesh.optics.phase import PhaseTables, phase_tables
from lfmesh.scene import Scene
from lfmesh.scene.light.particles import Particles, shining_particles, unit
from lfmesh.transport.packets.packet import CAMERA_FRAME, WORLD_FRAME
from lfmesh.transport.tables.lines import Lines
from lfmesh.transport.tables.phases import cross_sections_um2, phase_functions
from lfmesh.transport.tables.spectra import spread
from lfmesh.transport.tables.tables import Media

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

UM2 = 1e-6
"""One µm² in mm²."""


@by_address
class ParticleTables(NamedTuple):
    """Particles of one entry of `[[particles]]`."""

    points: Array  # (n, 3) mm, world frame
    strength: Array  # (n,) W/sr, or W/mm² in a light sheet
    scale: Array  # (wavelengths,) sr or mm²: power, W, over the strength
    along: Array  # (3,) unit, world frame: direction of the light before scattering
    phases: PhaseTables  # with one function
    samples: int  # packets per particle, all replicates together
    entry: int  # number of the entry in the scene
    inside: Numbers  # (n,) bodies of glass or liquid around each, as packets hold them


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
        points, strength = shining_particles(group, scene)
        if not len(points):
            continue
        inside, numbers = places(points)
        index = _index_round(group, media, numbers, where)
        functions = phase_functions(group.phase, lines.wavelengths_nm, scene, f"{where}.phase", index)
        scale = spread(scene, 1.0, group.spectrum, lines, f"{where}.spectrum") * _power(group, lines, where, index)
        along = np.array([0.0, 0.0, 1.0])
        if group.sheet is not None:
            along = unit(group.sheet.direction)
        phases = phase_tables([functions])
        tables.append(ParticleTables(points, strength, scale, along, phases, group.samples, number, inside))
    return tuple(tables)


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


def corners_round(tables: tuple[ParticleTables, ...]) -> Array:
    """Return the corners of boxes around the particles of each entry, (n, 3), mm, world frame."""
    corners = [np.zeros((0, 3))]
    for table in tables:
        ends = np.stack([table.points.min(axis=0), table.points.max(axis=0)])
        corners.append(np.array([[ends[i, 0], ends[j, 1], ends[k, 2]] for i, j, k in np.ndindex(2, 2, 2)]))
    return np.concatenate(corners)


def refuse_particles_behind(tables: tuple[ParticleTables, ...], moves: Array, front_mm: float) -> None:
    """Refuse particles that are not in front of the lens.

    Parameters
    ----------
    tables : tuple of ParticleTables
    moves : (6, 6, 3, 4) float64
        See `frame_table`.
    front_mm : float, mm
        Outermost plane of the lens, camera frame.

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
