"""Lamps and emitting targets, the sources of the forward method (the paper's).

A lamp's packets go into the cone around the targets; the power that it sends elsewhere is booked as escaped at once.
An emitting facet's packet is scattered where it starts, by the model of its emission. The adjoint method starts lamps'
packets as well, for their light through glass (`render.parts`); those go into the cone around the glass.
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
from lfmesh.transport.events.bodies import RANK, TOO_MANY, bodies_at, medium_of, set_bodies
from lfmesh.transport.events.bounds import own_ray, span
from lfmesh.transport.events.crossing import record
from lfmesh.transport.events.object_space import ObjectSpace
from lfmesh.transport.events.polarisation import polarise_as_light
from lfmesh.transport.events.scattering import albedo
from lfmesh.transport.events.surface import emission_of, opacity_at, place_on, point_of, spread
from lfmesh.transport.events.volume import coefficients
from lfmesh.transport.lights.media_emitters import drawn_point
from lfmesh.transport.packets.book import EMITTED, ESCAPED
from lfmesh.transport.packets.packet import E_START, LAMP, NO_SURFACE, OBJECT_FRAME, OBJECTS, Flow, put
from lfmesh.transport.packets.random import derived, start
from lfmesh.transport.paths.automaton import FROM_LAMP, ON_IMAGE_PATH
from lfmesh.transport.regions.targets import scatter
from lfmesh.transport.regions.volumes import send_from_medium
from lfmesh.transport.sources.lamp_rays import PLACE_U, PLACE_V, WAY_U, WAY_V, emitted
from lfmesh.transport.sources.source import Source
from lfmesh.transport.sources.wavelengths import ALONE, Turn, order_of_packets
from lfmesh.transport.tables.lights import MM2
from lfmesh.transport.tables.lines import Nodes
from lfmesh.transport.tables.scattering import THERMAL
from lfmesh.transport.tables.tables import AIR, FIRST_VOLUME, ObjectTables

Array = NDArray[np.float64]

CLEAR_OF_ALL = 2.0
"""Distance from the origin, in radii of the sphere that holds everything, beyond which no packet of a lamp starts."""

SOURCE_U, SIDE, PLACE_W, PLACE_T = 0, 5, 6, 7
"""Dimensions of starting numbers; those between give the packet's point on the source and its direction."""


@dataclass(frozen=True, eq=False)
class LightSource(Source):
    """Packets of all lights and emitting targets.

    Attributes
    ----------
    first, count : int
        Number of the first packet in its replicate, and number of packets from there on.
    total : int
        Number of packets that share the whole power.
    key : uint64
        Key of the replicate's random numbers at this wavelength.
    nodes : Nodes
        Wavelengths of the channel, of which each packet takes one.
    turn : Turn
        Of the replicate in its group, which has the key.
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
        """Start some of the packets, if there is any light."""
        tables = work.tables
        if len(tables.objects.sources):
            numbers = np.arange(self.first + part.start, self.first + part.stop) * self.turn.step + self.turn.first
            space = ObjectSpace(work.options, work.flow(), tables.frames, tables.objects, tables.aim.entrance)
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
        Number of each packet in its replicate, and of its wavelength.
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
        weight = source.power / (source.share * total)
        if source.facet <= FIRST_VOLUME:
            _from_medium(objects.volumes, space, packet, FIRST_VOLUME - source.facet, weight / source.power)
        elif source.light >= 0:
            packet.path = FROM_LAMP
            weight *= objects.lamps.spectra[source.light, colour]
            _from_lamp(objects, space.flow, packet, source.light, weight)
        else:
            _from_facet(space, packet, source.facet, weight)


@kernel
def _from_lamp(objects: ObjectTables, flow: Flow, packet: Any, number: int, weight: float) -> None:
    """Start a packet of a light towards the sphere that is aimed at; book the power in other directions as escaped."""
    x, y, z, dx, dy, dz, share = emitted(objects, objects.lamps.rows[number], packet.key)
    towards = weight * share
    flow.book[EMITTED] += weight
    flow.book[ESCAPED] += weight - towards
    if towards <= 0.0:
        return
    packet.start = towards
    # Embree's numbers are too coarse far away. The lamp's light comes to all that it may meet from nearer by.
    ahead = -(x * dx + y * dy + z * dz) - CLEAR_OF_ALL * objects.outer_radius
    if ahead > 0.0:
        x, y, z = x + ahead * dx, y + ahead * dy, z + ahead * dz
    polarise_as_light(flow.polarised, packet, number, dx, dy, dz)
    put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, towards, packet.key, 0.0)


@kernel
def _from_medium(volumes: Any, space: ObjectSpace, packet: Any, number: int, weight: float) -> None:
    """Emit a packet from a random point of a medium, drawn by about its emission, in a random direction.

    Parameters
    ----------
    volumes : Volumes or None
        As for `is_stopped_by_media`.
    number : int
        Of the medium.
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
        inside = bodies_at(objects, x, y, z)
        if inside == TOO_MANY or inside & RANK != volumes.rows[number].inside:
            return
        packet.medium = medium_of(objects, inside)
        set_bodies(packet, inside)
    emission = coefficients(volumes, number, colour, 0.0, 0.0, ray)[2]
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
    """Emit a packet from a uniform point of a facet; of a sheet with two sides, from either."""
    flow, objects, key = space.flow, space.objects, packet.key
    body = objects.facets[prim].body
    b, c = spread(objects, prim, start(key, PLACE_U), start(key, PLACE_V))
    x, y, z = place_on(objects, prim, b, c)
    side = 1.0
    if not objects.one_sided[body] and start(key, SIDE) < 0.5:
        side = -1.0
    weight *= objects.emission_spectra[body, packet.colour] * _enter_bodies(
        objects.glass, objects, packet, body, x, y, z
    )
    if objects.opacity[body] < 1.0:
        weight *= opacity_at(objects, prim, x, y, z)
    point = emission_of(objects, point_of(objects, packet, prim, (x, y, z), side, False), key)
    emitted = weight * albedo(objects.scattering, point, packet.colour, 0.0, 0.0, 0.0)
    flow.book[EMITTED] += emitted
    packet.start = emitted
    packet.weight = emitted
    scatter(space, packet, point, weight, emitted)


@inlined
def _enter_bodies(
    glass: Any, objects: ObjectTables, packet: Any, target: int, x: float, y: float, z: float
) -> float:  # fmt: skip
    """Let a packet start in the bodies round its place; return its power there over that in what bodies stand in.

    Parameters
    ----------
    glass : GlassTables or None
        None: there are no bodies, and numba compiles nothing but the first line.
    objects : ObjectTables
    packet : PACKET
    target : int
        That emits.
    x, y, z : float, mm
        The place, object frame.

    Returns
    -------
    float
        n² by temperature, as the radiance of a black body; else 1. 0: in more bodies than packets can keep.
    """
    if glass is None or not glass.emits_inside[target]:
        return 1.0
    inside = bodies_at(objects, x, y, z)
    if inside == TOO_MANY:
        return 0.0
    packet.medium = medium_of(objects, inside)
    set_bodies(packet, inside)
    emission = objects.scattering.models[objects.scattering.models[target].emission]
    if emission.kind != THERMAL:
        return 1.0
    ratio = objects.media.indices[packet.medium, packet.colour] / objects.media.indices[AIR, packet.colour]
    return ratio * ratio
