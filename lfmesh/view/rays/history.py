"""History of one path: the events at every surface, by the laws of refraction and reflection.

Angles, R and T are recomputed from the vertices and surface normals, which checks the tracer: without roulette, the
recorded power is the product of the path's R and T.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.geometry.array.lattice import cell_of, centre
from lfmesh.geometry.array.lenslets import faces_at, shape_of, type_of
from lfmesh.geometry.meshes.levels import EXACT
from lfmesh.geometry.surfaces.sag import normals
from lfmesh.geometry.surfaces.surface import in_place
from lfmesh.optics.glass import Medium, medium_in_words, refractive_index
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.camera.phase import AnyPhase
from lfmesh.scene.first_order.phase_turns import phase_gradients
from lfmesh.scene.literals import percent
from lfmesh.transport.events.interface import shares
from lfmesh.transport.packets.packet import BACK_FACE, CAMERA_FRAME, CURVED_FACE, SENSOR_FRAME, WORLD_FRAME, Event
from lfmesh.transport.tables.cover import FRONT_ROW, REAR_ROW
from lfmesh.transport.tables.gradient_spaces import has_gradients
from lfmesh.transport.tables.interfaces import InterfaceTables, interface_tables
from lfmesh.transport.tables.tables import AIR, CURVED_ROW, FLAT_ROW, Interfaces, body_row
from lfmesh.transport.trace import at_wavelength
from lfmesh.view.rays.gradient_cells import cells_at, indices_in_cells
from lfmesh.view.rays.gradient_segments import IN_ARRAY, indices_in
from lfmesh.view.rays.names import BACK, CURVED, FLAT, FRONT, REAR, SENSOR, label, target_names
from lfmesh.view.rays.paths import Rays

NEAR_WALL_MM = 1e-7
"""Distance from a wall between lenslets at which a point lies in a cell for certain."""

LEVEL = 1e-9
"""Largest change of direction by the first order at which a phase counts as level."""

IN_SHORT = {Event.TRANSMITTED: "transmit", Event.REFLECTED: "reflect", Event.SCATTERED: "scatter"}

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Step:
    """Vertex of a path.

    Attributes
    ----------
    surface : str
        Name in `Rays.surfaces`; `short` is its label.
    event : Event
    position_mm : (3,) float64, world frame
    incidence_deg : float or None
        Angle between the arriving ray and the surface normal; None at the start, or where there is no surface (an edge,
        the mount, the border of the scene).
    reflectance, transmittance : float or None
        Fractions of the power; only at interfaces. At a diffractive face on a path from the sensor: those of light,
        which arrives against the path.
    medium : str
        Medium after the vertex, or at the end: "air", "n = 1.67", "SCHOTT/N-BK7".
    index : float
        Its refractive index at the path's wavelength; of gradient-index glass, at the vertex.
    power : float
        Power after the vertex, or at the end.
    roulette : float
        Factor by which roulette raised the power here (default 1).
    order : int or None
        Diffraction order; None at faces without a phase.
    order_share : float
        Fraction of the transmitted or reflected light in this order.
    in_gradient : bool
        True if the medium is gradient-index glass.
    """

    surface: str
    short: str
    event: Event
    position_mm: Vector
    incidence_deg: float | None
    reflectance: float | None
    transmittance: float | None
    medium: str
    index: float
    power: float
    roulette: float
    order: int | None = None
    order_share: float = 1.0
    in_gradient: bool = False

    @property
    def medium_in_short(self) -> str:
        """The medium in at most 13 characters; gradient-index glass by its index at the vertex."""
        return f"n = {self.index:.6g}" if self.in_gradient else self.medium[:13]

    @property
    def event_in_short(self) -> str:
        """The event in at most 9 characters; at a diffractive face with its order, such as "order +1"."""
        if self.order is None or (self.order == 0 and self.event == Event.REFLECTED):
            return IN_SHORT.get(self.event, self.event.name.lower())
        return f"{'order' if self.event == Event.TRANSMITTED else 'refl.'} {self.order:+d}"

    @property
    def event_in_words(self) -> str:
        """The event, with the order and its share of the light at a diffractive face."""
        words = self.event.name.lower()
        return words if self.order is None else f"{words}, order {self.order:+d} with {percent(self.order_share)}"

    @property
    def was_raised(self) -> bool:
        """True if the power was raised here by roulette rather than rounding."""
        return self.roulette > 1.0 + 1e-6


@dataclass(frozen=True)
class _Interface:
    """Interface at a vertex: its unit normal (of either sense), and its row of an interface table.

    The normal is None where a facet represents a surface without formula; then it follows from the path. The table is
    None where light does not split, as on the sensor. A glass body has one row for each surrounding medium; `body` is
    its number among the targets. `outside` is the number of the medium around that part of the scene. `steepness` is
    the gradient of a diffractive face's phase, (3,) rad/mm in the world frame.
    """

    normal: Vector | None
    table: Interfaces | None = None
    row: int = 0
    body: int | None = None
    outside: int = AIR
    phase: AnyPhase | None = None
    steepness: Vector | None = None


def history(rays: Rays, path: int) -> list[Step]:
    """Return the steps of a path from start to end.

    Parameters
    ----------
    rays : Rays
    path : int
        Index among the rays, 0 to len(rays) − 1.

    Raises
    ------
    LfmeshError
        The path does not exist.
    """
    if not 0 <= path < len(rays):
        raise LfmeshError(f"path {path}: the rays have paths 0 to {len(rays) - 1}")
    wavelength = float(rays.wavelength_nm[path])
    interfaces = interface_tables(rays.world.scene, (wavelength,))
    steps: list[Step] = []
    first, end = int(rays.offsets[path]), int(rays.offsets[path + 1])
    to_camera = rays.world.tables.frames[WORLD_FRAME, CAMERA_FRAME]
    medium = _medium_beyond(rays, first, _around(rays, frames.points(to_camera, rays.position[first][None])[0, 2]))
    for vertex in range(first, end):
        event, met = Event(int(rays.event[vertex])), _interface(rays, vertex, interfaces)
        incidence = reflectance = transmittance = None
        order, part = None, 1.0
        power = left = float(rays.power[vertex])
        if met is not None and vertex > first:
            other = medium if met.table is None else _medium_beyond(rays, vertex, met.outside)
            n_i, n_t = _index(rays, vertex, medium, wavelength), _index(rays, vertex, other, wavelength, beyond=True)
            cosine = _cosine(rays, vertex, met.normal, n_i, n_t)
            row = met.row if met.body is None else _row_of_body(rays, met.body, medium, other)
            incidence = None if cosine is None else float(np.degrees(np.arccos(cosine)))
            if cosine is not None and met.table is not None and event in (Event.TRANSMITTED, Event.REFLECTED):
                ways, sides = (_arriving(rays, vertex), _leaving(rays, vertex)), (n_i, n_t, cosine)
                order, part = _order(met, event, wavelength, ways, (medium, other))
                if order is not None and rays.unit != "W":
                    sides = _against_light(met, event, ways[1], sides)
                if part > 0.0:
                    reflectance, transmittance, _ = shares(met.table, row, 0, *sides, False)
                    left = steps[-1].power * (transmittance if event == Event.TRANSMITTED else reflectance) * part
            medium = other if event == Event.TRANSMITTED else medium
        name = rays.surfaces[rays.surface[vertex]]
        index = _index(rays, vertex, medium, wavelength, beyond=event == Event.TRANSMITTED)
        steps.append(
            Step(
                name, label(name), event, rays.position[vertex], incidence, reflectance, transmittance,
                medium_in_words(medium), index, power, power / left if left > 0.0 else 1.0, order, part,
                isinstance(medium, Gradient),
            )
        )  # fmt: skip
    return steps


def lines(steps: list[Step], unit: str) -> list[str]:
    """Return a history for an 80-column terminal, one line per step; the roulette factor precedes the medium."""
    lines = [f"{'surface':<17}{'event':<9}{'angle':>7}{'R':>7}{'T':>7}{f'power/{unit}':>12}{'':7} medium"]
    for step in steps:
        angle = "" if step.incidence_deg is None else f"{step.incidence_deg:.2f}\N{DEGREE SIGN}"
        r, t = ("" if share is None else f"{share:.4f}" for share in (step.reflectance, step.transmittance))
        factor = f"x{step.roulette:.2g}" if step.roulette < 100.0 else f"x{min(step.roulette, 99999.0):.0f}"
        raised = factor if step.was_raised else ""
        lines.append(
            f"{step.short[:16]:<17}{step.event_in_short:<9}{angle:>7}{r:>7}{t:>7}"
            f"{step.power:12.4e}{raised:>7} {step.medium_in_short}"
        )
    return lines


def _index(rays: Rays, vertex: int, medium: Medium, wavelength_nm: float, *, beyond: bool = False) -> float:
    """Return the index of a medium at a vertex: of the one that a path arrives in, or of the one beyond the face."""
    if not isinstance(medium, Gradient):
        return refractive_index(medium, wavelength_nm)
    tables, name = at_wavelength(rays.world, wavelength_nm), rays.surfaces[rays.surface[vertex]]
    point = frames.points(tables.frames[WORLD_FRAME, CAMERA_FRAME], rays.position[vertex][None])
    space, face = int(rays.gradients.space_behind[vertex]), int(rays.surface[vertex]) - 1
    on_face = name in (CURVED, BACK)
    if on_face or space == IN_ARRAY:
        along = _arriving(rays, vertex)
        arriving = frames.directions(
            tables.frames[WORLD_FRAME, CAMERA_FRAME], np.zeros((1, 3)) if along is None else along[None]
        )
        # A wall belongs to the cell that a path comes from.
        cell = rays.lenslet[vertex : vertex + 1] if on_face else cells_at(tables, point - NEAR_WALL_MM * arriving)
        return float(indices_in_cells(tables, cell, point)[0])
    if face < len(rays.world.lens_shape.surfaces) and beyond != (rays.event[vertex] == Event.TRANSMITTED):
        space = 2 * face + 1 - space
    return float(indices_in(tables.lens, space, point)[0])


def _arriving(rays: Rays, vertex: int) -> Vector | None:
    """Return the direction in which a path arrives at a vertex; None if the last vertex coincides."""
    curved = _curved(rays, vertex - 1)
    return _chord(rays, vertex - 1) if curved is None else curved[1]


def _leaving(rays: Rays, vertex: int) -> Vector | None:
    """Return the direction of a path after a vertex; None if the next vertex coincides."""
    curved = _curved(rays, vertex)
    return _chord(rays, vertex) if curved is None else curved[0]


def _curved(rays: Rays, vertex: int) -> tuple[Vector, Vector] | None:
    """Return the directions at both ends of a segment in gradient-index glass, by its first vertex, or None."""
    number = rays.gradients.number_of(vertex) if has_gradients(rays.world.scene) else None
    if number is None:
        return None
    both = np.stack([rays.gradients.leaving[number], rays.gradients.arriving[number]])
    leaving, arriving = frames.directions(rays.world.tables.frames[CAMERA_FRAME, WORLD_FRAME], both)
    return leaving, arriving


def _chord(rays: Rays, vertex: int) -> Vector | None:
    """Return the direction from a vertex to the next; None if these coincide."""
    step = rays.position[vertex + 1] - rays.position[vertex]
    length = float(np.linalg.norm(step))
    return step / length if length > 0.0 else None


def _cosine(rays: Rays, vertex: int, normal: Vector | None, n_i: float, n_t: float) -> float | None:
    """Return the cosine of incidence at a vertex; None if indeterminate."""
    arriving = _arriving(rays, vertex)
    if arriving is None:
        return None
    if normal is None:
        # Snell's law preserves the tangential part of n d, so the change is along the normal.
        leaving = _leaving(rays, vertex)
        if leaving is None:
            return None
        change = leaving - arriving if rays.event[vertex] == Event.REFLECTED else n_t * leaving - n_i * arriving
        length = float(np.linalg.norm(change))
        if length == 0.0:
            return None
        normal = change / length
    return min(abs(float(arriving @ normal)), 1.0)


def _order(
    met: _Interface, event: Event, wavelength_nm: float, ways: tuple[Vector | None, Vector | None],
    media: tuple[Medium, Medium],
) -> tuple[int | None, float]:  # fmt: skip
    """Return the diffraction order that a path follows at an interface, and its share of the light.

    The order is the change of the tangential part of n d, over that of the first order. Where the phase is level, all
    orders have one direction; the main one stands for them, or the zeroth of reflected light. The order of a path that
    ends at the interface is unknown if there are several: None, with a share of 0.

    Parameters
    ----------
    met : _Interface
    event : Event
    wavelength_nm : float
    ways : (3,) float64, (3,) float64
        Directions before and behind the interface, where known.
    media : (Medium, Medium)
        Media before and beyond it.
    """
    if met.phase is None or met.steepness is None or met.normal is None:
        return None, 1.0
    (arriving, leaving), reflects = ways, event == Event.REFLECTED
    n_i, n_t = (refractive_index(each, wavelength_nm) for each in media)
    known = dict(met.phase.reflected() if reflects else met.phase.orders_of(wavelength_nm, *media))
    if leaving is None and len(known) > 1:
        return None, 0.0
    order = 0 if reflects else met.phase.main_order
    first = wavelength_nm * 1e-6 / (2.0 * np.pi) * met.steepness
    first = first - (first @ met.normal) * met.normal
    size = float(first @ first)
    if arriving is not None and leaving is not None and size > LEVEL**2:
        change = (n_i if reflects else n_t) * leaving - n_i * arriving
        order = round(float(change @ first) / size)
    return order, known.get(order, 0.0)


def _against_light(
    met: _Interface, event: Event, leaving: Vector | None, sides: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Return indices before and after a diffractive face, and the cosine of incidence, of light against a path.

    Parameters
    ----------
    met : _Interface
    event : Event
    leaving : (3,) float64
        Direction of the path behind the face, where known.
    sides : (3,) float
        The same along the path.
    """
    n_i, n_t, _ = sides
    if leaving is None or met.normal is None:
        return sides
    turned = min(abs(float(leaving @ met.normal)), 1.0)
    return (n_i, n_t, turned) if event == Event.REFLECTED else (n_t, n_i, turned)


def _interface(rays: Rays, vertex: int, interfaces: InterfaceTables) -> _Interface | None:
    """Return the interface at a vertex; None if it has no normal of its own."""
    world, name = rays.world, rays.surfaces[rays.surface[vertex]]
    shape, mla = world.lens_shape, world.scene.camera.mla
    k = int(rays.surface[vertex]) - 1
    if 0 <= k < len(shape.surfaces):
        exact = shape.surfaces[k]["level"] == EXACT
        normal = _of_lens(rays, vertex, k) if exact else None
        phase = world.scene.camera.lens.surfaces[shape.numbers[k]].phase
        steepness = None if phase is None else _steepness_on_lens(rays, vertex, k, phase)
        return _Interface(normal, interfaces.lens, k, phase=phase, steepness=steepness)
    if name in (CURVED, FLAT, BACK) and mla is not None:
        exact = name == FLAT or world.scene.transport.surface == "exact"
        normal, row = _of_array(rays, vertex, name) if exact else None, CURVED_ROW if name == CURVED else FLAT_ROW
        phase = mla.curved_phase if name == CURVED else mla.flat_phase
        steepness = None if phase is None else _steepness_on_array(rays, vertex, name, phase)
        return _Interface(normal, interfaces.mla, row, None, world.media.behind_lens, phase, steepness)
    if name in (SENSOR, FRONT, REAR):
        axis = frames.directions(world.tables.frames[SENSOR_FRAME, WORLD_FRAME], [[0.0, 0.0, 1.0]])
        row = FRONT_ROW if name == FRONT else REAR_ROW
        table = None if name == SENSOR else interfaces.cover
        return _Interface(np.asarray(axis[0]), table, row, outside=world.media.behind_lens)
    if rays.event[vertex] in (Event.TRANSMITTED, Event.REFLECTED) and name in target_names(world):
        body = target_names(world).index(name)
        glass = world.scene.targets[body].refractor
        outside = world.media.before_lens
        return _Interface(None, interfaces.objects, body=body, outside=outside) if glass is not None else None
    return None


def _row_of_body(rays: Rays, body: int, medium: Medium, other: Medium) -> int:
    """Return the interface row of a glass body between two media, one of them its own."""
    known, glass = rays.world.media, rays.world.scene.targets[body].refractor
    own = glass.medium if glass is not None else None
    return body_row(body, known.media.index(other if medium == own else medium), len(known.media))


def _of_lens(rays: Rays, vertex: int, k: int) -> Vector:
    """Return the normal of a lens surface."""
    moves, lens_surface = rays.world.tables.frames, rays.world.lens_shape.surfaces[k]
    p = frames.points(moves[WORLD_FRAME, CAMERA_FRAME], rays.position[vertex][None])
    p = in_place(lens_surface, p)
    normal = frames.directions(lens_surface["pose"], normals(lens_surface, p[:, 0], p[:, 1]))
    return np.asarray(frames.directions(moves[CAMERA_FRAME, WORLD_FRAME], normal)[0])


def _of_array(rays: Rays, vertex: int, name: str) -> Vector:
    """Return the normal of a face of the array."""
    moves, face = rays.world.tables.frames, rays.world.tables.mla
    normal = np.array([0.0, 0.0, 1.0])
    if name != FLAT:
        if face.face != (CURVED_FACE if name == CURVED else BACK_FACE):
            face = face.back
        lenslets = face.lenslets
        row, column = divmod(int(rays.lenslet[vertex]), lenslets.lattice.columns)
        cx, cy = centre(lenslets.lattice, column, row)
        curvature, ex, ey = shape_of(lenslets, column, row)
        p = frames.points(moves[WORLD_FRAME, face.frame], rays.position[vertex][None])[0]
        kind = type_of(lenslets, column, row)
        normal = faces_at(lenslets, kind, curvature, p[None, :2] - [cx + ex, cy + ey])[1][0]
    return np.asarray(frames.directions(moves[face.frame, WORLD_FRAME], normal[None])[0])


def _steepness_on_lens(rays: Rays, vertex: int, k: int, phase: AnyPhase) -> Vector:
    """Return the gradient of a lens surface's phase."""
    moves, surface = rays.world.tables.frames, rays.world.lens_shape.surfaces[k]
    p = in_place(surface, frames.points(moves[WORLD_FRAME, CAMERA_FRAME], rays.position[vertex][None]))[0]
    return np.asarray(
        frames.directions(moves[CAMERA_FRAME, WORLD_FRAME], frames.directions(surface["pose"], _gradient(phase, p)))[0]
    )


def _steepness_on_array(rays: Rays, vertex: int, name: str, phase: AnyPhase) -> Vector:
    """Return the gradient of the phase of a face of the array."""
    moves, face = rays.world.tables.frames, rays.world.tables.mla
    if name != FLAT and face.face != (CURVED_FACE if name == CURVED else BACK_FACE):
        face = face.back
    lenslets = face.lenslets
    p = frames.points(moves[WORLD_FRAME, face.frame], rays.position[vertex][None])[0]
    if name == FLAT:
        apex = np.array(centre(lenslets.lattice, *cell_of(lenslets.lattice, p[0], p[1])))
    else:
        row, column = divmod(int(rays.lenslet[vertex]), lenslets.lattice.columns)
        _, ex, ey = shape_of(lenslets, column, row)
        apex = np.add(centre(lenslets.lattice, column, row), (ex, ey))
    return np.asarray(frames.directions(moves[face.frame, WORLD_FRAME], _gradient(phase, p[:2] - apex))[0])


def _gradient(phase: AnyPhase, place: Vector) -> Vector:
    """Return the gradient of a phase at a place in its own frame, (1, 3) rad/mm."""
    return np.column_stack([phase_gradients(phase, place[:1], place[1:2]), np.zeros(1)])


def _around(rays: Rays, z: float) -> int:
    """Return the number of the medium around all else at a place along the axis, mm from the first vertex."""
    known = rays.world.media
    if z < 0.0:
        return known.before_lens
    return known.behind_lens if z > rays.world.scene.camera.lens.vertices_mm[-1] else AIR


def _medium_beyond(rays: Rays, vertex: int, outside: int) -> Medium:
    """Return the medium beyond an interface or around a start; targets emit into the surrounding medium."""
    number = max(int(rays.beyond[vertex]), AIR)
    return rays.world.media.media[outside if number == AIR else number]
