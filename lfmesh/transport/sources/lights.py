"""Lamps and emitting targets, the sources of the forward method (the paper's).

Lamp packets are aimed at the cone around the targets; the power in other directions is booked as escaped at once.
Packets of emitting facets start there, scattered by the emission model. The adjoint method also starts lamp packets,
aimed at the cone around glass, for lamp light through glass (`render.parts`).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.kernels.search import drawn_by
from lfmesh.optics.scattering import about
from lfmesh.transport.engine import Workspace
from lfmesh.transport.events.bending import squared_index_at
from lfmesh.transport.events.bodies import RANK, TOO_MANY, bodies_at, medium_of, set_bodies
from lfmesh.transport.events.bounds import own_ray, span
from lfmesh.transport.events.crossing import record
from lfmesh.transport.events.moving import (
    direction_between,
    mover_of,
    mover_of_medium,
    point_between,
    start_in_mover,
)
from lfmesh.transport.events.object_space import ObjectSpace
from lfmesh.transport.events.polarisation import polarise_as_light
from lfmesh.transport.events.scattering import albedo
from lfmesh.transport.events.surface import emission_of, opacity_at, place_on, point_of, spread
from lfmesh.transport.events.volume import coefficients
from lfmesh.transport.lights.media_emitters import drawn_point
from lfmesh.transport.packets.book import EMITTED, ESCAPED
from lfmesh.transport.packets.packet import E_START, LAMP, NO_SURFACE, OBJECT_FRAME, OBJECTS, Flow, mover_of_frame, put
from lfmesh.transport.packets.random import derived, start
from lfmesh.transport.paths.automaton import FROM_LAMP, ON_IMAGE_PATH
from lfmesh.transport.regions.targets import scatter
from lfmesh.transport.regions.volumes import send_from_medium
from lfmesh.transport.sources.lamp_rays import PLACE_U, PLACE_V, WAY_U, WAY_V, emitted
from lfmesh.transport.sources.source import Source
from lfmesh.transport.sources.wavelengths import ALONE, Turn, order_of_packets
from lfmesh.transport.tables.lights import MM2
from lfmesh.transport.tables.lines import Nodes
from lfmesh.transport.tables.motions import STILL
from lfmesh.transport.tables.scattering import THERMAL
from lfmesh.transport.tables.tables import AIR, FIRST_VOLUME, ObjectTables

Array = NDArray[np.float64]

CLEAR_OF_ALL = 2.0
"""Distance from the origin, in radii of the sphere that holds everything, beyond which no lamp packet starts."""

SOURCE_U, SIDE, PLACE_W, PLACE_T = 0, 5, 6, 7
"""Dimensions of starting numbers; those in between give the packet's point on the source and its direction."""


@dataclass(frozen=True, eq=False)
class LightSource(Source):
    """Packets of all lights and emitting targets.

    Attributes
    ----------
    first, count : int
        First packet in its replicate, and number of packets.
    total : int
        Number of packets that share the whole power.
    key : uint64
        Random key of the replicate at this wavelength.
    nodes : Nodes
        Wavelengths of the channel. Each packet takes one.
    turn : Turn
        Turn of the replicate in its group; the key belongs to the group.
    """

    first: int
    count: int
    total: int
    key: np.uint64
    nodes: Nodes
    turn: Turn = ALONE

    def __len__(self) -> int:
        return self.count

    def launch(self, work: Workspace, part: range) -> None:
        """Start some of the packets, if the scene has sources."""
        tables = work.tables
        work.options = work.options._replace(stream=self.key)
        if len(tables.objects.sources):
            numbers = np.arange(self.first + part.start, self.first + part.stop) * self.turn.step + self.turn.first
            frames, entrance = work.frames_of_objects, tables.aim.entrance
            space = ObjectSpace(work.options, work.flow(), frames, tables.objects, entrance)
            launch_forward(
                *order_of_packets(self.nodes, numbers, self.key), self.total, self.key, space, work.template,
            )  # fmt: skip


@kernel
def launch_forward(
    numbers: NDArray[np.int64], colours: NDArray[np.int64], total: int, replicate_key: np.uint64, space: ObjectSpace,
    template: NDArray[np.void],
) -> None:  # fmt: skip
    """Start packets of all lights and emitting facets.

    Parameters
    ----------
    numbers, colours : (n,) int64
        Packet numbers in the replicate, and their wavelength numbers.
    total : int
        Number of packets that share the whole power.
    replicate_key : uint64
    space : ObjectSpace
    template : (1,) PACKET
        Working memory.
    """
    objects = space.objects
    sources = objects.sources
    packet = template[0]
    packet.last = NO_SURFACE
    for k in range(len(numbers)):
        number, colour = numbers[k], colours[k]
        key = derived(replicate_key, number)
        packet.colour = colour
        packet.source = number
        packet.key = key
        packet.medium = AIR
        set_bodies(packet, 0)
        packet.events = 0
        packet.kind, packet.path = LAMP, ON_IMAGE_PATH
        packet.facet = NO_SURFACE
        packet.node = NO_SURFACE
        which = drawn_by(sources["until"], start(key, SOURCE_U))
        source = sources[which]
        start_in_mover(space.flow.moving, space.options, packet, _mover_of(space.flow.moving, objects, source))
        weight = source.power / (source.share * total)
        if source.facet <= FIRST_VOLUME:
            _from_medium(objects.volumes, space, packet, FIRST_VOLUME - source.facet, weight / source.power)
        elif source.light >= 0:
            packet.path = FROM_LAMP
            weight *= objects.lamps.spectra[source.light, colour]
            _from_lamp(objects, space.flow, packet, source.light, weight)
        else:
            _from_facet(space, packet, source.facet, weight)


@inlined
def _mover_of(moving: Any, objects: ObjectTables, source: Any) -> int:
    """Return the mover of a source, `source` : SOURCE."""
    if moving is None:
        return STILL
    if source.facet <= FIRST_VOLUME:
        return int(mover_of_medium(moving, FIRST_VOLUME - source.facet))
    if source.light >= 0:
        return int(objects.lamps.rows[source.light].mover)
    return int(mover_of(moving, objects.facets[source.facet].body))


@kernel
def _from_lamp(objects: ObjectTables, flow: Flow, packet: Any, number: int, weight: float) -> None:
    """Start a lamp packet towards the target sphere; book its other power as escaped."""
    light, moving = objects.lamps.rows[number], flow.moving
    x, y, z, dx, dy, dz, share = emitted(objects, light, packet.key, moving)
    towards = weight * share
    flow.book[EMITTED] += weight
    flow.book[ESCAPED] += weight - towards
    if towards <= 0.0:
        return
    packet.start = towards
    # Embree's float32 is too coarse far away; a start nearer by still precedes everything that the ray may meet.
    ox, oy, oz = point_between(moving, STILL, light.mover, 0.0, 0.0, 0.0)
    ahead = -((x - ox) * dx + (y - oy) * dy + (z - oz) * dz) - CLEAR_OF_ALL * objects.outer_radius
    if ahead > 0.0:
        x, y, z = x + ahead * dx, y + ahead * dy, z + ahead * dz
    polarise_as_light(flow.polarised, packet, number, dx, dy, dz)
    _carry_reference(flow.polarised, moving, packet, light.mover)
    put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, towards, packet.key, 0.0)


@inlined
def _carry_reference(polarised: Any, moving: Any, packet: Any, mover: int) -> None:
    """Turn the reference direction of a packet's state with its lamp, whose polariser turns along.

    Parameters
    ----------
    polarised : PolarisationTables or None
    moving : Moving or None
    packet : POLARISED
    mover : int
        Mover of the lamp.
    """
    if polarised is None:
        return
    if moving is None:
        return
    turned, own = (
        packet.reference,
        direction_between(moving, mover, STILL, packet.reference[0], packet.reference[1], packet.reference[2]),
    )
    turned[0], turned[1], turned[2] = own


@kernel
def _from_medium(volumes: Any, space: ObjectSpace, packet: Any, number: int, weight: float) -> None:
    """Emit a packet from a point of a medium, drawn approximately by emission, in a uniform direction.

    Parameters
    ----------
    volumes : Volumes or None
        As for `is_stopped_by_media`.
    number : int
        Number of the medium.
    weight : float
        One over the number of packets that share the medium's emission.
    """
    if volumes is None:
        return
    flow, objects = space.flow, space.objects
    key, colour = packet.key, packet.colour
    x, y, z, density = drawn_point(
        volumes, number, start(key, PLACE_U), start(key, PLACE_V), start(key, PLACE_W), start(key, PLACE_T)
    )
    ray = own_ray(volumes.rows[number], Ray(x, y, z, 0.0, 0.0, 1.0))
    first, last, _ = span(volumes.shells, volumes.rows[number], ray, 0.0)
    if not first <= 0.0 <= last or density <= 0.0:
        return
    if len(objects.by_rank) > 1:
        inside = bodies_at(objects, flow.moving, mover_of_frame(packet.frame), x, y, z)
        if inside == TOO_MANY or inside & RANK != volumes.rows[number].inside:
            return
        packet.medium = medium_of(objects, inside)
        set_bodies(packet, inside)
    emission = coefficients(volumes, number, colour, 0.0, 0.0, ray)[2]
    px, py, pz = point_between(flow.moving, mover_of_frame(packet.frame), STILL, x, y, z)
    emission *= _grown_by_temperature(objects.fields, colour, px, py, pz)
    if emission <= 0.0:
        return
    # W/(m² sr mm) is 10⁻⁶ W/(mm³ sr).
    packet.weight = weight * 4.0 * np.pi * MM2 * emission / density
    packet.start = packet.weight
    flow.book[EMITTED] += packet.weight
    height, phi = 1.0 - 2.0 * start(key, WAY_U), 2.0 * np.pi * start(key, WAY_V)
    dx, dy, dz = about(0.0, 0.0, 1.0, height, phi)
    packet.dx, packet.dy, packet.dz = dx, dy, dz
    if space.options.record:
        packet.node = record(
            flow, space.frames, OBJECT_FRAME, x, y, z, packet.weight, NO_SURFACE, NO_SURFACE, E_START, NO_SURFACE
        )
    send_from_medium(space, packet, objects.volumes.isotropic[0], Ray(x, y, z, dx, dy, dz), key)


@kernel
def _from_facet(space: ObjectSpace, packet: Any, prim: int, weight: float) -> None:
    """Emit a packet from a uniform point of a facet, on either side of a two-sided sheet."""
    flow, objects, key = space.flow, space.objects, packet.key
    body = objects.facets[prim].body
    b, c = spread(objects, prim, start(key, PLACE_U), start(key, PLACE_V))
    x, y, z = place_on(objects, prim, b, c)
    side = 1.0
    if not objects.one_sided[body] and start(key, SIDE) < 0.5:
        side = -1.0
    weight *= objects.emission_spectra[body, packet.colour] * _enter_bodies(
        objects.glass, flow.moving, objects, packet, body, x, y, z
    )
    if objects.opacity[body] < 1.0:
        weight *= opacity_at(objects, prim, x, y, z)
    px, py, pz = point_between(flow.moving, mover_of_frame(packet.frame), STILL, x, y, z)
    weight *= _grown_in_field(objects.fields, objects, packet.colour, body, px, py, pz)
    point = emission_of(objects, point_of(objects, packet, prim, (x, y, z), side, False), key)
    emitted = weight * albedo(objects.scattering, point, packet.colour, 0.0, 0.0, 0.0)
    flow.book[EMITTED] += emitted
    packet.start = emitted
    packet.weight = emitted
    scatter(space, packet, point, weight, emitted)


@inlined
def _grown_in_field(
    fields: Any, objects: ObjectTables, colour: int, target: int, x: float, y: float, z: float
) -> float:  # fmt: skip
    """Return n² at a point of a target that emits by its temperature, over that outside the fields; else 1.

    `fields` : BendingFields or None.
    """
    if fields is None:
        return 1.0
    emission = objects.scattering.models[objects.scattering.models[target].emission]
    return squared_index_at(fields, colour, x, y, z) if emission.kind == THERMAL else 1.0


@inlined
def _grown_by_temperature(fields: Any, colour: int, x: float, y: float, z: float) -> float:
    """Return n² at a point over that outside the fields, for media that emit by temperature; else 1.

    `fields` : BendingFields or None.
    """
    if fields is None:
        return 1.0
    return 1.0 if fields.emit_radiance else squared_index_at(fields, colour, x, y, z)


@inlined
def _enter_bodies(
    glass: Any, moving: Any, objects: ObjectTables, packet: Any, target: int, x: float, y: float, z: float
) -> float:  # fmt: skip
    """Put a packet into the bodies around its start; return its power relative to outside them.

    Parameters
    ----------
    glass : GlassTables or None
        None: there are no bodies, and numba compiles only the first line.
    moving : Moving or None
    objects : ObjectTables
    packet : PACKET
    target : int
        Number of the emitting target.
    x, y, z : float, mm
        Start, object frame.

    Returns
    -------
    float
        Relative n² for thermal emission, as for a black body; else 1. 0 in more bodies than a packet can record.
    """
    if glass is None or not glass.emits_inside[target]:
        return 1.0
    inside = bodies_at(objects, moving, mover_of_frame(packet.frame), x, y, z)
    if inside == TOO_MANY:
        return 0.0
    packet.medium = medium_of(objects, inside)
    set_bodies(packet, inside)
    emission = objects.scattering.models[objects.scattering.models[target].emission]
    if emission.kind != THERMAL:
        return 1.0
    ratio = objects.media.indices[packet.medium, packet.colour] / objects.media.indices[AIR, packet.colour]
    return ratio * ratio
