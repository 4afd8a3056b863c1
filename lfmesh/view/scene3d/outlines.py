"""Outlines of media and light sheets, which have no surface: line segments in the world frame, mm."""

import numpy as np

from lfmesh.geometry import frame
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.meshes.shell_tree import ShellTree
from lfmesh.scene.light.particles import Particles, unit
from lfmesh.transport.packets.packet import OBJECT_FRAME, WORLD_FRAME
from lfmesh.transport.tables.volumes import CYLINDER, SHELL, SPHERE, corners_of
from lfmesh.transport.world import World

POINTS = 48
"""Points of a circle."""

EDGES = ((0, 1), (0, 2), (0, 4), (1, 3), (1, 5), (2, 3), (2, 6), (3, 7), (4, 5), (4, 6), (5, 7), (6, 7))
"""Edges of a box, by corner numbers with x varying last."""


def outline_of_medium(world: World, number: int) -> Array:
    """Return the outline of a medium, (n, 2, 3) mm; empty if it fills a body or all space before the camera."""
    medium, volumes = world.scene.media[number], world.tables.objects.volumes
    row = volumes.rows[number]
    corners = corners_of(row)
    if corners is None or (medium.bounds is None and medium.grid is None):
        return np.zeros((0, 2, 3))
    to_world = frame.compose(world.tables.frames[OBJECT_FRAME, WORLD_FRAME], frame.inverse(row["to_own"]))
    radius, half = row["size"][0], row["size"][2]
    if row["cells"][0] == 0 and row["bounds"] == SHELL:
        lines = _edges(volumes.shells, *row["nodes"])
    elif row["cells"][0] > 0 or row["bounds"] not in (SPHERE, CYLINDER):
        lines = corners[np.array(EDGES)]
    elif row["bounds"] == SPHERE:
        circle = _circle(radius, 0.0)
        lines = np.concatenate([np.roll(circle, turn, axis=2) for turn in range(3)])
    else:
        angles = np.arange(4) * 0.5 * np.pi
        rim = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        sides = np.stack([np.column_stack([rim, np.full(4, z)]) for z in (-half, half)], axis=1)
        lines = np.concatenate([_circle(radius, -half), _circle(radius, half), sides])
    return frame.points(to_world, lines.reshape(-1, 3)).reshape(-1, 2, 3)


def _edges(shells: ShellTree, begin: int, end: int) -> Array:
    """Return the edges of the shell with these nodes, (n, 2, 3) mm, each in one direction only."""
    leaves = shells.nodes[begin:end]
    leaves = leaves[leaves["count"] > 0]
    facets = shells.corners[leaves["first"][0] : leaves["first"][-1] + leaves["count"][-1]]
    edges = np.stack([facets, np.roll(facets, -1, axis=1)], axis=2).reshape(-1, 2, 3)
    # The first coordinate in which the ends differ gives the direction.
    steps = edges[:, 1] - edges[:, 0]
    sense = np.take_along_axis(steps, (steps != 0.0).argmax(axis=1)[:, None], axis=1)[:, 0]
    return np.asarray(edges[sense > 0.0])


def _circle(radius: float, z: float) -> Array:
    """Return the chords of a circle about the z axis, (n, 2, 3)."""
    angles = 2.0 * np.pi * np.arange(POINTS) / POINTS
    points = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(POINTS, z)])
    return np.stack([points, np.roll(points, -1, axis=0)], axis=1)


def outline_of_sheet(group: Particles, points: Array) -> Array:
    """Return the box of a light sheet around its particles, between its 1/e² planes, (n, 2, 3) mm, or none.

    Parameters
    ----------
    group : Particles
    points : (n, 3) float64, mm, world frame
        Particles in the sheet.
    """
    sheet = group.sheet
    if sheet is None or not len(points):
        return np.zeros((0, 2, 3))
    along, normal = unit(sheet.direction), unit(sheet.normal)
    middle = np.array(sheet.point_mm)
    way = (points - middle) @ along
    ends = (
        (float(way.min()), float(way.max())),
        (-0.5 * sheet.width_mm, 0.5 * sheet.width_mm),
        (-0.5 * sheet.thickness_mm, 0.5 * sheet.thickness_mm),
    )
    axes = np.stack([along, np.cross(normal, along), normal])
    corners = np.array([[ends[0][i], ends[1][j], ends[2][k]] for i, j, k in np.ndindex(2, 2, 2)])
    return (middle + corners @ axes)[np.array(EDGES)]
