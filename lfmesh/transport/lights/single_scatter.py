"""Light scattered once near lamps: directions past a lamp, their density, and points on the line.

A way past a lamp samples the glow of the medium round it, which grows as one over the angle from the lamp. It brings
only that lamp's light, scattered once on its line. All other light is left to scattered rays.

The point on the line is drawn by the phase function and by the angle at which the lamp sees the line. Any point of the
medium is then drawn in proportion to the light that it scatters to the packet's start, apart from extinction (as in
Georgiev et al., Joint importance sampling of low-order volumetric scattering, SIGGRAPH Asia 2013).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.ray import Ray, along, ray_of
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.phase import evaluate_phase
from lfmesh.optics.scattering import near
from lfmesh.transport.events.bodies import bodies_round
from lfmesh.transport.events.crossing import LIGHT_U, draw_two
from lfmesh.transport.events.scattering_point import scattered_at, scattering_point
from lfmesh.transport.events.volume import Line, Passage
from lfmesh.transport.lights.lamps import LIGHT_DIMENSIONS, illuminate_from
from lfmesh.transport.lights.lamps_on_line import NARROWEST, lit_part
from lfmesh.transport.lights.many_lamps import chance_passed, passed_lamp
from lfmesh.transport.lights.places import point_of_light
from lfmesh.transport.lights.shadow import Way, send
from lfmesh.transport.packets.packet import NO_SURFACE, PAST_LAMP, TO_LAMP, Flow, Options
from lfmesh.transport.packets.random import uniform
from lfmesh.transport.tables.lights import Lamps
from lfmesh.transport.tables.single_scatter import DENSE, angle_beyond, drawn_angle, light_beyond, phase_at
from lfmesh.transport.tables.tables import ObjectTables, SingleScatter
from lfmesh.transport.tables.volumes import Volumes

Array = NDArray[np.float64]

LAMP_U, LAMP_V, BY_ANGLE, ALONG, LAMP, SENT = 0, 1, 2, 3, 4, 5
"""Dimensions of the random numbers of a way past a lamp: point of the lamp, point on the line, choice of the lamp."""


@inlined
def is_asked(volumes: Volumes, options: Options, events: int) -> bool:
    """Tell whether points, after so many events, send packets past lamps.

    Parameters
    ----------
    volumes : Volumes
    options : Options
    events : int
        Number of the packet's events so far.
    """
    return (
        len(volumes.near_lamps.angles) > 0 and options.bounce and volumes.scatters and events + 1 < options.max_events
    )


@inlined
def sample(
    near_lamps: SingleScatter, options: Options, objects: ObjectTables, packet: Any, key: np.uint64
) -> Way:  # fmt: skip
    """Draw a way past a lamp from a packet's position in air.

    Parameters
    ----------
    near_lamps : SingleScatter
    options : Options
    objects : ObjectTables
    packet : PACKET
    key : uint64
        Key of the random numbers.
    """
    place, colour = (packet.x, packet.y, packet.z), packet.colour
    number, drawn, ray = NO_SURFACE, 0.0, ray_of(packet)
    if bodies_round(packet) == 0:
        number = _lamp_drawn(near_lamps, objects.lamps, colour, place, key)
    if number >= 0:
        px, py, pz = point_of_light(objects.lamps.rows[number], uniform(key, LAMP_U), uniform(key, LAMP_V))
        px, py, pz = px - place[0], py - place[1], pz - place[2]
        far = np.sqrt(px * px + py * py + pz * pz)
        u, v = draw_two(options, packet, LIGHT_U + LIGHT_DIMENSIONS * len(objects.lamps.rows))
        angle = drawn_angle(near_lamps, colour, u)
        sine = np.sin(angle)
        if far > 0.0 and sine > 0.0:
            height = 2.0 * np.sin(0.5 * angle) ** 2
            ux, uy, uz = near(px / far, py / far, pz / far, height, 2.0 * np.pi * v)
            ray = Ray(place[0], place[1], place[2], ux, uy, uz)
            chance = _chance(near_lamps, objects.lamps, number, colour, place)
            drawn = chance * _per_solid_angle(near_lamps, colour, angle, sine)
    return Way(PAST_LAMP, number, ray, np.inf, 1.0, drawn)


@kernel
def density(
    near_lamps: SingleScatter, objects: ObjectTables, packet: Any, number: int, of_lamp: tuple[float, float, float]
) -> float:  # fmt: skip
    """Return the density, 1/sr, of `sample` for the direction of a packet's ray past a lamp.

    Parameters
    ----------
    near_lamps : SingleScatter
    objects : ObjectTables
    packet : PACKET
        At the start of the ray.
    number : int
        Number of the lamp.
    of_lamp : (3,) float, mm
        Point of the lamp that emits the light.
    """
    chance = _chance(near_lamps, objects.lamps, number, packet.colour, (packet.x, packet.y, packet.z))
    if chance <= 0.0:
        return 0.0
    s, h, far = _past(of_lamp, ray_of(packet))
    return chance * _per_solid_angle(near_lamps, packet.colour, np.arctan2(h, s), h / far) if far > 0.0 else 0.0


@kernel
def gather(
    near_lamps: SingleScatter, flow: Flow, objects: ObjectTables, packet: Any, line: Line, passage: Passage,
    key: np.uint64,
) -> None:  # fmt: skip
    """Send a shadow packet to a lamp from a random point on the line of a packet sent past that lamp.

    The point is drawn by the mean phase function over the scattering angle or, with equal chance, by the local
    scattering. The light is divided by the sum of both densities (balance heuristic).

    Parameters
    ----------
    near_lamps : SingleScatter
    flow : Flow
    objects : ObjectTables
    packet : PACKET
        At the start of the line, in no body of glass.
    line : Line
        Line of the packet.
    passage : Passage
        Passage along the line.
    key : uint64
        Key of the random numbers of the way.
    """
    volumes, colour, ray = objects.volumes, line.colour, line.ray
    light = objects.lamps.rows[packet.goal]
    place = point_of_light(light, uniform(packet.key, LAMP_U), uniform(packet.key, LAMP_V))
    s, h, _ = _past(place, ray)
    first, last = lit_part(light, ray, passage.first, passage.last)
    if first >= last:
        return
    begin = light_beyond(near_lamps, colour, np.arctan2(h, s - first))
    on_line = begin - light_beyond(near_lamps, colour, np.arctan2(h, s - last))
    if uniform(packet.key, BY_ANGLE) < 0.5:
        angle = angle_beyond(near_lamps, colour, begin - uniform(packet.key, ALONG) * on_line)
        t = min(max(s - h / np.tan(angle), first), last)
        scattered, medium = scattered_at(volumes, line, t, flow.book, key)
    else:
        t, _, scattered, medium = scattering_point(volumes, line, passage, key)
    if scattered <= 0.0 or t < first or t > last or on_line <= 0.0:
        return
    off = t - s
    drawn = 0.5 * scattered / passage.scattered
    drawn += 0.5 * phase_at(near_lamps, colour, np.arctan2(h, -off)) / on_line * h / (h * h + off * off)
    x, y, z = along(ray, t)
    ux, uy, uz, reach, irradiance = illuminate_from(objects.lamps.profiles, light, place, x, y, z)
    cosine = ray.dx * ux + ray.dy * uy + ray.dz * uz
    phase = evaluate_phase(volumes.phases, volumes.phases.rows[medium, colour], cosine)
    lit = packet.weight * scattered / drawn * phase * irradiance * objects.lamps.spectra[packet.goal, colour]
    if lit > 0.0:
        way = Way(TO_LAMP, packet.goal, Ray(x, y, z, ux, uy, uz), reach, irradiance, 1.0)
        shadow = send(flow, packet, way, lit, packet.key, 0.0)
        shadow.facet = NO_SURFACE


@inlined
def _distance(light: Any, place: tuple[float, float, float]) -> float:
    """Return the distance of a lamp from a point, mm, blurred by the size of the lamp."""
    px, py, pz = light.position[0] - place[0], light.position[1] - place[1], light.position[2] - place[2]
    return np.sqrt(px * px + py * py + pz * pz + light.size * light.size)


@inlined
def _chance_sent(near_lamps: SingleScatter, colour: int, far: float) -> float:
    """Return the probability of sending a packet past a lamp: small in thin media, where the glow has little weight."""
    depth = 0.0
    for number in range(len(near_lamps.extent)):
        depth += near_lamps.scattering[number, colour] * min(far, near_lamps.extent[number])
    return min((depth / DENSE) ** 2, 1.0)


@kernel
def _chance(
    near_lamps: SingleScatter, lamps: Lamps, number: int, colour: int, place: tuple[float, float, float]
) -> float:  # fmt: skip
    """Return the probability that a point sends a packet past a given lamp."""
    far = _distance(lamps.rows[number], place)
    return _chance_sent(near_lamps, colour, far) * chance_passed(lamps, number, colour, place)


@kernel
def _lamp_drawn(
    near_lamps: SingleScatter, lamps: Lamps, colour: int, place: tuple[float, float, float], key: np.uint64
) -> int:  # fmt: skip
    """Return the lamp past which a point sends a packet, drawn by `_chance`; −1: none."""
    number = passed_lamp(lamps, colour, place, uniform(key, LAMP))
    if number < 0 or uniform(key, SENT) >= _chance_sent(near_lamps, colour, _distance(lamps.rows[number], place)):
        return -1
    return number


@inlined
def _past(place: tuple[float, float, float], ray: Ray) -> tuple[float, float, float]:
    """Return a ray's closest approach to a point, along it and off it, and the point's distance from its start, mm."""
    px, py, pz = place[0] - ray.x, place[1] - ray.y, place[2] - ray.z
    s = px * ray.dx + py * ray.dy + pz * ray.dz
    ex, ey, ez = px - s * ray.dx, py - s * ray.dy, pz - s * ray.dz
    far = np.sqrt(px * px + py * py + pz * pz)
    return s, max(np.sqrt(ex * ex + ey * ey + ez * ez), NARROWEST * far), far


@inlined
def _per_solid_angle(near_lamps: SingleScatter, colour: int, angle: float, sine: float) -> float:
    """Return the density, 1/sr, of directions past a lamp at an angle, rad, from it."""
    whole = near_lamps.below[colour, len(near_lamps.angles) - 1]
    return light_beyond(near_lamps, colour, angle) / (2.0 * np.pi * whole * sine)
