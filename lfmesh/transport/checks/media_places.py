"""Places of a scene's media and particles as seen by the camera, and the optical depths of the media."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lfmesh.geometry import frame
from lfmesh.geometry.index_media import bends
from lfmesh.geometry.objects.placement import in_field, share_of_field
from lfmesh.scene import FirstOrder
from lfmesh.scene.motion import is_moving
from lfmesh.transport.packets.packet import CAMERA_FRAME, OBJECT_FRAME, WORLD_FRAME
from lfmesh.transport.tables.volumes import CYLINDER, NOT_IN_GRID, SHELL, SPHERE, Volumes, corners_of
from lfmesh.transport.world import World

Array = NDArray[np.float64]

LINES = 33
"""Lines of sight along each side of a medium's part of the field, to find optical depths."""

STEPS = 4
"""Points on a line of sight per voxel along the longest side of a grid."""

OUT_OF_FIELD = "is out of the field: the camera does not see it"


@dataclass(frozen=True)
class MediumPlace:
    """Place of a medium, or of a group of particles.

    Attributes
    ----------
    name : str
    what : str
        Effect on light; for particles, the number that shine.
    reach_mm : (float, float)
        Distances of its ends in front of the first vertex; inf for an unbounded medium.
    share : float
        Share of the field of view filled by a medium, at most (box around its image); share of particles in the field.
    depths : (float, float) or None
        Optical depth along the axis, and the largest of some lines of sight, at the primary wavelength; per mm if
        unbounded. None for particles.
    in_box : bool
        True if the optical depths belong to a box round the medium and are upper limits: it is bounded by a mesh,
        or by the body it is inside.
    moves : bool
        True if it moves relative to the camera during the exposure; its place is that at t = 0.
    """

    name: str
    what: str
    reach_mm: tuple[float, float]
    share: float
    depths: tuple[float, float] | None
    in_box: bool = False
    moves: bool = False

    def lines(self, wavelength_nm: float) -> list[str]:
        """Describe the place in words, any warning last, as a note."""
        near, far = self.reach_mm
        endless = not np.isfinite(far)
        of_particles = self.what.startswith("particles")
        lines = [
            f"{self.name}: {self.what}",
            f"  before the lens      {near:.5g} mm " + ("and beyond, unbounded" if endless else f"to {far:.5g} mm"),
            f"  {'in the field' if of_particles else 'share of the field':<20} {100 * self.share:.3g} %"
            + ("" if of_particles or endless else " at most"),
        ]
        if self.depths is not None and endless:
            lines.append(f"  optical depth        {self.depths[0]:.4g} per mm at {wavelength_nm:g} nm")
        elif self.depths is not None:
            axis, most = self.depths
            lines.append(
                f"  optical depth        {axis:.4g} on the axis, at most {most:.4g} on {LINES} × {LINES} lines of "
                f"sight across its part of the field, at {wavelength_nm:g} nm"
                + ("; these are upper limits, of the box around it" if self.in_box else "")
            )
        return lines + [f"Note: {self.name} {OUT_OF_FIELD}{', at t = 0' if self.moves else ''}"] * (self.share == 0.0)


def media_places(world: World) -> list[MediumPlace]:
    """Return the place of each medium and of each group of particles of a built scene.

    Lines of sight are the straight chief rays in front of the lens; refraction at bodies of glass is ignored.
    """
    return [*_media(world), *_particles(world)]


def unseen(world: World) -> list[str]:
    """Return the names of media and particles that are out of the field."""
    return [place.name for place in media_places(world) if place.share == 0.0]


def _media(world: World) -> Iterator[MediumPlace]:
    volumes, facts = world.tables.objects.volumes, world.facts
    colour = int(np.argmin(np.abs(np.array(world.lines.wavelengths_nm) - world.scene.primary_nm)))
    for number, medium in enumerate(world.scene.media):
        row = volumes.rows[number]
        name = f"media[{number}]" + (f" ({medium.name})" if medium.name else "")
        takes = {
            "absorbs": volumes.absorption[number, colour] > 0.0,
            "scatters": volumes.scattering[number, colour] > 0.0,
            "emits": bool(volumes.emission[number].any()),
            "bends light": bends(world.scene, medium),
        }
        what = ", ".join(word for word, does in takes.items() if does) or "has no effect at this wavelength"
        to_camera = frame.compose(world.tables.frames[OBJECT_FRAME, CAMERA_FRAME], frame.inverse(row["to_own"]))
        corners = corners_of(row)
        if corners is None:
            extinction = float(volumes.absorption[number, colour] + volumes.scattering[number, colour])
            yield MediumPlace(name, what, (0.0, np.inf), 1.0, (extinction, extinction))
            continue
        seen = frame.points(to_camera, corners)
        depths = _depths(volumes, number, colour, to_camera, seen, facts)
        share = share_of_field(in_field(seen, facts))
        reach = float(-seen[:, 2].max()), float(-seen[:, 2].min())
        in_box = bool(row["bounds"] == SHELL) or medium.inside is not None
        moves = is_moving(medium) or is_moving(world.scene.camera)
        yield MediumPlace(name, what, reach, share, depths, in_box=in_box, moves=moves)


def _particles(world: World) -> Iterator[MediumPlace]:
    move = world.tables.frames[WORLD_FRAME, CAMERA_FRAME]
    for group in world.particles:
        seen = frame.points(move, group.points)
        share = float((np.abs(in_field(seen, world.facts)) <= 1.0).all(axis=1).mean())
        reach = float(-seen[:, 2].max()), float(-seen[:, 2].min())
        moves = world.scene.particles[group.entry].frame_time_s is not None or is_moving(world.scene.camera)
        what = f"particles, {len(seen)} of them emitting"
        yield MediumPlace(f"particles[{group.entry}]", what, reach, share, None, moves=moves)


def _depths(
    volumes: Volumes, number: int, colour: int, to_camera: Array, seen: Array, facts: FirstOrder
) -> tuple[float, float]:  # fmt: skip
    """Return a medium's optical depth along the axis, and the largest in its part of the field.

    Parameters
    ----------
    volumes : Volumes
    number, colour : int
        Indices of the medium and the wavelength.
    to_camera : (3, 4) float64
        From the medium's own frame.
    seen : (8, 3) float64, mm
        Corners of its box, camera frame.
    facts : FirstOrder
    """
    start, way = lines_of_sight(seen, facts)
    to_own = frame.inverse(to_camera)
    found = _along(volumes, number, colour, frame.points(to_own, start), frame.directions(to_own, way))
    return float(found[0]), float(found.max())


def lines_of_sight(seen: Array, facts: FirstOrder) -> tuple[Array, Array]:
    """Return starts and unit directions of the axis and of chief rays to the part of the field that holds a box.

    Parameters
    ----------
    seen : (8, 3) float64, mm
        Corners of the box, camera frame.
    facts : FirstOrder

    Returns
    -------
    start, way : (n, 3) float64
        Camera frame; the axis comes first.
    """
    field = facts.field
    start, way = np.zeros((2, 1 + LINES * LINES, 3))
    way[:, 2] = -1.0
    if np.isfinite(field.slope).all():
        low, high = _part_of_field(seen, facts)
        places = low + (high - low) * np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, LINES)] * 2), axis=-1).reshape(-1, 2)
        start[1:, :2], way[1:, :2] = places * field.at_vertex_mm, -places * field.slope
    way /= np.linalg.norm(way, axis=1)[:, None]
    return start, way


def _part_of_field(seen: Array, facts: FirstOrder) -> tuple[Array, Array]:
    """Return the corners of the part of the field (edges at ±½) that holds a box as seen along chief rays.

    Along a chief ray, x over the field's width is constant. In a box it is a quotient of linear functions with extremes
    at corners. The whole field counts if a corner lies behind the first vertex or the width changes sign.

    Parameters
    ----------
    seen : (8, 3) float64, mm
        Corners, camera frame.
    facts : FirstOrder
    """
    width = np.add(facts.field.at_vertex_mm, seen[:, 2:] * np.array(facts.field.slope))
    if (seen[:, 2] > 0.0).any() or not (np.abs(np.sign(width).sum(axis=0)) == len(width)).all():
        return np.full(2, -0.5), np.full(2, 0.5)
    places = seen[:, :2] / width
    return np.clip(places.min(axis=0), -0.5, 0.5), np.clip(places.max(axis=0), -0.5, 0.5)


def _along(volumes: Volumes, number: int, colour: int, start: Array, way: Array) -> Array:
    """Return the optical depth along lines in a medium's own frame, (n,)."""
    row = volumes.rows[number]
    low, high = np.maximum(row["box"][0], row["low"]), np.minimum(row["box"][1], row["high"])
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = (np.stack([low, high])[:, None] - start) / way
    first = np.nan_to_num(ends.min(axis=0), nan=-np.inf).max(axis=1)
    last = np.nan_to_num(ends.max(axis=0), nan=np.inf).min(axis=1)
    if row["bounds"] in (SPHERE, CYLINDER):
        across = 3 if row["bounds"] == SPHERE else 2
        p, d = start[:, :across], way[:, :across]
        a, b, c = (d * d).sum(axis=1), (p * d).sum(axis=1), (p * p).sum(axis=1) - row["size"][0] ** 2
        root = np.sqrt(np.maximum(b * b - a * c, 0.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            # A line along a cylinder's axis is in it everywhere, or nowhere.
            enters = np.where(a > 0.0, (-b - root) / a, -np.inf)
            leaves = np.where(a > 0.0, (-b + root) / a, np.inf)
        misses = (b * b < a * c) | ((a == 0.0) & (c > 0.0))
        first, last = np.maximum(first, enters), np.where(misses, -np.inf, np.minimum(last, leaves))
    first = np.maximum(first, 0.0)
    chord = np.maximum(last - first, 0.0)
    taken = np.zeros(len(start))
    for quantity in ("absorption", "scattering"):
        value = getattr(volumes, quantity)[number, colour] * chord
        held = row[quantity] != NOT_IN_GRID
        taken += value * (_mean(volumes, row, quantity, (start, way), (first, chord)) if held else 1.0)
    return taken


def _mean(
    volumes: Volumes, row: np.void, quantity: str, lines: tuple[Array, Array], span: tuple[Array, Array]
) -> Array:
    """Return the mean of a grid's quantity along chords, (n,)."""
    shape = tuple(row["cells"])
    values = volumes.values[row[quantity] : row[quantity] + int(np.prod(shape))].reshape(shape)
    steps, order = STEPS * max(shape), 0 if row["constant"] else 1
    (start, way), (first, chord) = lines, span
    total = np.zeros(len(start))
    lit = np.flatnonzero(chord > 0.0)
    for step in range(steps):
        along = first[lit] + (step + 0.5) / steps * chord[lit]
        cells = (start[lit] + along[:, None] * way[lit] - row["origin"]) / row["spacing"]
        total[lit] += ndimage.map_coordinates(values, cells.T, order=order, mode="nearest")
    return total / steps
