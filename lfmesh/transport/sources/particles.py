"""Particles as packet sources, traced forward in both methods: no ray from the sensor hits a point.

Each particle starts the same number of packets from its own scrambled Sobol' points, aimed at the lens opening as seen
from there, also through glass or liquid. Its other power is booked as escaped at once. Targets hide particles and
absorb their light; particles do not light targets.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import move_direction, move_point
from lfmesh.kernels.decorators import kernel
from lfmesh.optics.phase import evaluate_phase
from lfmesh.transport.aims.mixture import aimed
from lfmesh.transport.engine import Workspace
from lfmesh.transport.events.bodies import medium_of, set_bodies
from lfmesh.transport.events.polarisation import depolarise
from lfmesh.transport.packets.book import EMITTED, ESCAPED
from lfmesh.transport.packets.packet import (
    CAMERA_FRAME,
    NO_SURFACE,
    OBJECT_FRAME,
    OBJECTS,
    SPECULAR,
    WORLD_FRAME,
    Flow,
    put,
)
from lfmesh.transport.packets.random import derived
from lfmesh.transport.packets.sobol import owen_sobol
from lfmesh.transport.paths.automaton import ON_IMAGE_PATH
from lfmesh.transport.sources.source import Source
from lfmesh.transport.sources.wavelengths import ALONE, Turn, order_of_particles
from lfmesh.transport.tables.lines import Nodes
from lfmesh.transport.tables.particles import ParticleTables
from lfmesh.transport.tables.tables import AIR, LensAim, ObjectTables

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
        launch_particles(
            *order_of_particles(self.nodes, numbers, count, self.samples * turn.step, self.key), self.samples,
            self.key, self.particles, tables.objects, tables.aim.entrance, tables.frames, work.flow(), work.template,
        )  # fmt: skip


@kernel
def launch_particles(
    numbers: NDArray[np.int64], colours: NDArray[np.int64], samples: int, replicate_key: np.uint64,
    particles: ParticleTables, objects: ObjectTables, aim: LensAim, frames: Array, flow: Flow,
    template: NDArray[np.void],
) -> None:  # fmt: skip
    """Start packets of particles towards the lens.

    Parameters
    ----------
    numbers, colours : (n,) int64
        Packet numbers in the replicate, and their wavelength numbers.
    samples : int
        Packets per particle in the replicate.
    replicate_key : uint64
    particles : ParticleTables
    objects : ObjectTables
    aim : LensAim
    frames : (6, 6, 3, 4) float64
    flow : Flow
    template : (1,) PACKET
        Working memory.
    """
    packet = template[0]
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
        x, y, z = particles.points[i, 0], particles.points[i, 1], particles.points[i, 2]
        power = particles.strength[i] * particles.scale[colour] / samples
        flow.book[EMITTED] += power
        own = derived(replicate_key, i)
        px, py, pz = move_point(frames, WORLD_FRAME, CAMERA_FRAME, x, y, z)
        draws = owen_sobol(own, sample, 2), owen_sobol(own, sample, 0), owen_sobol(own, sample, 1)
        ax, ay, az, at_lens = aimed(aim, (px, py, pz), draws)
        weight = 0.0
        if at_lens > 0.0:
            dx, dy, dz = move_direction(frames, CAMERA_FRAME, WORLD_FRAME, ax, ay, az)
            along = particles.along
            cosine = along[0] * dx + along[1] * dy + along[2] * dz
            row = particles.phases.rows[0, colour]
            weight = power * evaluate_phase(particles.phases, row, cosine) / at_lens
            if in_glass:
                set_bodies(packet, particles.inside[i])
                packet.medium = medium_of(objects, particles.inside[i])
            packet.source = number
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
