"""Particles as packet sources, traced forward in both methods: no ray from the sensor hits a point.

Each particle starts the same number of packets from its own scrambled Sobol' points, aimed at the lens opening as seen
from there, also through glass or liquid. Its other power is booked as escaped at once. Targets hide particles and
absorb their light; particles do not light targets. A particle that moves leaves a streak: each packet has its own time,
and starts where the particle is then.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import move_direction, move_point
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.phase import evaluate_phase
from lfmesh.transport.aims.mixture import aimed
from lfmesh.transport.engine import Workspace
from lfmesh.transport.events.bodies import medium_of, set_bodies
from lfmesh.transport.events.moving import direction_between, point_between, start_in_mover
from lfmesh.transport.events.object_space import ObjectSpace
from lfmesh.transport.events.polarisation import depolarise
from lfmesh.transport.packets.book import EMITTED, ESCAPED
from lfmesh.transport.packets.packet import (
    CAMERA_FRAME,
    NO_SURFACE,
    OBJECT_FRAME,
    OBJECTS,
    SPECULAR,
    WORLD_FRAME,
    put,
)
from lfmesh.transport.packets.random import derived
from lfmesh.transport.packets.sobol import owen_sobol
from lfmesh.transport.paths.automaton import ON_IMAGE_PATH
from lfmesh.transport.sources.source import Source
from lfmesh.transport.sources.wavelengths import ALONE, Turn, order_of_particles
from lfmesh.transport.tables.lines import Nodes
from lfmesh.transport.tables.motions import STILL
from lfmesh.transport.tables.particles import ParticleTables
from lfmesh.transport.tables.tables import AIR

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ParticleSource(Source):
    """Packets of particles: packet number p · n + i is sample p of particle i.

    Attributes
    ----------
    particles : ParticleTables
        Tables of n particles.
    first, count : int
        First packet in its replicate, and number of packets.
    samples : int
        Packets per particle in the replicate.
    key : uint64
        Random key of the replicate at this wavelength.
    nodes : Nodes
        Wavelengths of the channel. Each packet takes one.
    turn : Turn
        Turn of the replicate in its group; the key belongs to the group.
    """

    particles: ParticleTables
    first: int
    count: int
    samples: int
    key: np.uint64
    nodes: Nodes
    turn: Turn = ALONE

    def __len__(self) -> int:
        return self.count

    def launch(self, work: Workspace, part: range) -> None:
        """Start some of the packets."""
        tables = work.tables
        count, turn = len(self.particles.points), self.turn
        sample, particle = np.divmod(np.arange(self.first + part.start, self.first + part.stop), count)
        numbers = (turn.first + sample * turn.step) * count + particle
        work.options = work.options._replace(stream=self.key)
        each = self.samples * turn.step
        space = ObjectSpace(
            work.options, work.flow(), work.frames_of_objects, tables.objects, tables.aim.entrance
        )  # fmt: skip
        launch_particles(
            *order_of_particles(self.nodes, numbers, count, each, self.key), self.samples, each, self.key,
            self.particles, space, work.template,
        )  # fmt: skip


@kernel
def launch_particles(
    numbers: NDArray[np.int64], colours: NDArray[np.int64], samples: int, each: int, replicate_key: np.uint64,
    particles: ParticleTables, space: ObjectSpace, template: NDArray[np.void],
) -> None:  # fmt: skip
    """Start packets of particles towards the lens.

    Parameters
    ----------
    numbers, colours : (n,) int64
        Packet numbers in the replicate, and their wavelength numbers.
    samples, each : int
        Packets per particle in the replicate, and in the group of replicates.
    replicate_key : uint64
    particles : ParticleTables
    space : ObjectSpace
    template : (1,) PACKET
        Working memory.
    """
    options, flow, frames, objects, aim = space
    packet, moving = template[0], flow.moving
    packet.last, packet.column, packet.facet, packet.node = NO_SURFACE, NO_SURFACE, NO_SURFACE, NO_SURFACE
    packet.medium, packet.space, packet.events, packet.path = AIR, 0, 0, ON_IMAGE_PATH
    in_glass = bool(particles.inside.any())
    # Nothing else is aimed: glass may bend it into the lens, and no other packet lights what it meets.
    packet.kind = SPECULAR
    depolarise(flow.polarised, packet)
    n = len(particles.points)
    for k in range(len(numbers)):
        number, colour = numbers[k], colours[k]
        packet.colour = colour
        i, sample = number % n, number // n
        # The packets of a particle follow each other, which spreads their times.
        packet.source = i * each + sample
        start_in_mover(moving, options, packet, STILL)
        strength, (x, y, z) = at_present(particles.streaks, moving, frames, particles, i)
        power = strength * particles.scale[colour] / samples
        flow.book[EMITTED] += power
        own = derived(replicate_key, i)
        px, py, pz = move_point(frames, WORLD_FRAME, CAMERA_FRAME, x, y, z)
        draws = owen_sobol(own, sample, 2), owen_sobol(own, sample, 0), owen_sobol(own, sample, 1)
        ax, ay, az, at_lens = aimed(aim, (px, py, pz), draws)
        weight = 0.0
        if at_lens > 0.0:
            dx, dy, dz = move_direction(frames, CAMERA_FRAME, WORLD_FRAME, ax, ay, az)
            along = direction_of_light(moving, particles)
            cosine = along[0] * dx + along[1] * dy + along[2] * dz
            row = particles.phases.rows[0, colour]
            weight = power * evaluate_phase(particles.phases, row, cosine) / at_lens
            if in_glass:
                set_bodies(packet, particles.inside[i])
                packet.medium = medium_of(objects, particles.inside[i])
            packet.start = weight
            ox, oy, oz = move_direction(frames, WORLD_FRAME, OBJECT_FRAME, dx, dy, dz)
            x, y, z = move_point(frames, WORLD_FRAME, OBJECT_FRAME, x, y, z)
            put(
                flow,
                OBJECTS,
                packet,
                OBJECT_FRAME,
                x,
                y,
                z,
                ox,
                oy,
                oz,
                weight,
                derived(replicate_key, n + number),
                0.0,
            )
        flow.book[ESCAPED] += power - weight


@inlined
def at_present(
    streaks: Any, moving: Any, frames: Array, particles: ParticleTables, i: int
) -> tuple[float, tuple[float, float, float]]:
    """Return the strength of a particle at the present time, and its place in the world that the camera carries along.

    Parameters
    ----------
    streaks : Streaks or None
    moving : Moving or None
    frames : (6, 6, 3, 4) float64
    particles : ParticleTables
    i : int
        Number of the particle.
    """
    strength = particles.strength[i]
    x, y, z = particles.points[i, 0], particles.points[i, 1], particles.points[i, 2]
    if moving is None:
        return strength, (x, y, z)
    if streaks is not None:
        time_s, velocity = moving.time_s[0], streaks.velocities[i]
        x, y, z = x + time_s * velocity[0], y + time_s * velocity[1], z + time_s * velocity[2]
        strength = _in_sheet(streaks.sheet, strength, x, y, z)
    x, y, z = move_point(frames, WORLD_FRAME, OBJECT_FRAME, x, y, z)
    x, y, z = point_between(moving, moving.motions.resting, STILL, x, y, z)
    return strength, move_point(frames, OBJECT_FRAME, WORLD_FRAME, x, y, z)


@inlined
def _in_sheet(sheet: Any, strength: float, x: float, y: float, z: float) -> float:
    """Return the irradiance of a light sheet at a place in the world, W/mm²; without one, the particle's own strength.

    Parameters
    ----------
    sheet : SheetTable or None
    strength : float
    x, y, z : float, mm
    """
    if sheet is None:
        return strength
    px, py, pz = x - sheet.point[0], y - sheet.point[1], z - sheet.point[2]
    aside = px * sheet.across[0] + py * sheet.across[1] + pz * sheet.across[2]
    off = (px * sheet.normal[0] + py * sheet.normal[1] + pz * sheet.normal[2]) / sheet.radius
    return sheet.peak * np.exp(-2.0 * off * off) if abs(aside) <= sheet.half_width else 0.0


@inlined
def direction_of_light(moving: Any, particles: ParticleTables) -> tuple[float, float, float]:
    """Return the direction of the light before scattering, in the world that the camera carries along.

    Parameters
    ----------
    moving : Moving or None
    particles : ParticleTables
    """
    along = particles.along
    if moving is None:
        return along[0], along[1], along[2]
    return direction_between(moving, moving.motions.resting, STILL, along[0], along[1], along[2])
