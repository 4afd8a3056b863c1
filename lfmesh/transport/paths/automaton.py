"""Classes of paths that are estimated independently: every path from the sensor to a light is in exactly one of them.

A path is the sequence of what it meets between sensor and light, in whichever direction it is traced. An automaton
reads it as a packet follows it: the packet has a `State`, each thing that it meets is a step that leads from state to
state, and `STANDING` tells which states belong to which class. Three questions, in this order, give a path's class:

1. Is light of a lamp (`[[lights]]`) scattered by a rough surface of lens or array before any target or rough glass in
   object space, or a medium, has scattered it? The class is `LAMP_ON_CAMERA`, traced forward from the lamp in both
   methods.
2. Does light of a lamp meet smooth glass in object space before the first target, or rough glass, that scatters it? A
   lamp is a point, a direction, or a disk that rays cannot hit, and a straight line to it (next-event estimation) is
   blocked by glass, so a path from the sensor never finds it. The class is `LAMP_THROUGH_GLASS`, traced forward from
   the lamp. Every other path ends, seen from the sensor, on a target that emits, or on a target or rough glass that a
   straight line in air joins to a lamp.
3. Does the path leave the image path anywhere between the sensor and that end? Then its class is `OFF_IMAGE_PATH`;
   else it is on the image path, as the sequential engine follows it. A path leaves the image path by a reflection in
   lens or array, by a reflection at glass in object space where it could have been refracted (total reflection there
   continues the image path), and where it meets the same curved side of the array twice running. Where on the path
   that happens does not matter: targets and rough glass may scatter it before and after, which by itself changes
   nothing. Rough surfaces of lens and array are traced by the mesh engine, which estimates `EVERY` path at once.

Where ghosts are estimated by themselves, `OFF_IMAGE_PATH` is divided into `GHOSTS` and `OTHER_STRAYS`. A path is one of
the ghosts if, seen from the sensor, it leaves the camera first after exactly two reflections, each at a refracting
surface of the lens, at a face of the array or of the sensor's cover, or at the sensor; if from each of these faces it
leads to the next one on either side; and if it leaves the image path nowhere else. (Straight after a surface a path may
meet it again on its hollow side, and straight after a lenslet the one beside it: those are other strays.)

`EVERY` stands for all paths that a method can find: all but `LAMP_ON_CAMERA`, and in the adjoint method all but
`LAMP_THROUGH_GLASS` too. Light that is in no class is named in transport/README.md, "Limits": light of a lamp that
reaches the sensor, or through the lens a target, before anything has scattered it.
"""

from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined
from lfmesh.transport.packets.packet import OBJECT_FRAME, Options


class State(IntEnum):
    """State of a packet's path so far: `PACKET.path`.

    The last three are those of packets that start at a lamp, up to what scatters them first: that decides their class.
    """

    ON_IMAGE_PATH = 0
    IN_NO_GHOST = 1  # on the image path, but past where a ghost begins
    REFLECTED_ONCE = 2  # off the image path as ghosts are, by one reflection
    REFLECTED_TWICE = 3
    STRAY = 4  # off the image path otherwise
    FROM_LAMP = 5  # and has met no glass in object space
    LAMP_AT_GLASS = 6  # smooth glass in object space was the first that it met
    LAMP_IN_CAMERA = 7  # a rough surface of the camera has scattered it


ON_IMAGE_PATH, IN_NO_GHOST, REFLECTED_ONCE, REFLECTED_TWICE, STRAY, FROM_LAMP, LAMP_AT_GLASS, LAMP_IN_CAMERA = (
    int(state) for state in State
)


class PathClass(IntEnum):
    """Paths that an estimator counts: `Options.paths`."""

    EVERY = 0
    OFF_IMAGE_PATH = 1
    LAMP_THROUGH_GLASS = 2
    LAMP_ON_CAMERA = 3
    GHOSTS = 4
    OTHER_STRAYS = 5


EVERY, OFF_IMAGE_PATH, LAMP_THROUGH_GLASS, LAMP_ON_CAMERA, GHOSTS, OTHER_STRAYS = (int(of) for of in PathClass)


def _step(leads: dict[int, int]) -> NDArray[np.int8]:
    """Return the state after a step, (states,), where it leads from one state to another; other states stay."""
    after = np.arange(len(State), dtype=np.int8)
    for before, state in leads.items():
        after[before] = state
    return after


OFF_FACE = _step({
    ON_IMAGE_PATH: REFLECTED_ONCE, REFLECTED_ONCE: REFLECTED_TWICE, REFLECTED_TWICE: STRAY, IN_NO_GHOST: STRAY,
})  # fmt: skip
"""A face of lens, array or cover reflects it, totally or not, or the sensor does."""

FACE_AGAIN = _step({ON_IMAGE_PATH: IN_NO_GHOST, REFLECTED_ONCE: STRAY, REFLECTED_TWICE: STRAY})
"""It meets the surface of the lens again that it comes from."""

NEXT_LENSLET = _step(dict.fromkeys((ON_IMAGE_PATH, IN_NO_GHOST, REFLECTED_ONCE, REFLECTED_TWICE), STRAY))
"""It meets the same curved side of the array twice running."""

OUT_OF_LENS = _step({ON_IMAGE_PATH: IN_NO_GHOST, REFLECTED_ONCE: STRAY})
"""It leaves the lens to object space."""

AT_GLASS = _step({FROM_LAMP: LAMP_AT_GLASS})
"""Smooth glass in object space refracts it, or reflects it totally."""

OFF_GLASS = _step(
    {FROM_LAMP: LAMP_AT_GLASS} | dict.fromkeys((ON_IMAGE_PATH, IN_NO_GHOST, REFLECTED_ONCE, REFLECTED_TWICE), STRAY)
)
"""Smooth glass in object space reflects it where it could have been refracted."""

ON_ROUGH_FACE = _step({FROM_LAMP: LAMP_IN_CAMERA, LAMP_AT_GLASS: LAMP_IN_CAMERA})
"""A rough surface of lens or array scatters it."""

NEVER, NOT_YET, COUNTS = 0, 1, 2
"""Standing of a state in a class: its light is another class's; as it is, but it may still come to count; it counts."""


def _standing(counts: tuple[int, ...], not_yet: tuple[int, ...] = ()) -> NDArray[np.int8]:
    """Return the standing of each state in a class, (states,)."""
    standing = np.full(len(State), NEVER, np.int8)
    standing[list(counts)], standing[list(not_yet)] = COUNTS, NOT_YET
    return standing


STANDING = np.array([
    _standing(counts=tuple(State)),  # EVERY
    _standing(counts=(REFLECTED_ONCE, REFLECTED_TWICE, STRAY), not_yet=(ON_IMAGE_PATH, IN_NO_GHOST)),  # OFF_IMAGE_PATH
    _standing(counts=(LAMP_AT_GLASS,)),  # LAMP_THROUGH_GLASS
    _standing(counts=(LAMP_IN_CAMERA,)),  # LAMP_ON_CAMERA
    _standing(counts=(REFLECTED_TWICE,)),  # GHOSTS
    _standing(counts=(STRAY,), not_yet=(ON_IMAGE_PATH, IN_NO_GHOST, REFLECTED_ONCE, REFLECTED_TWICE)),  # OTHER_STRAYS
])  # fmt: skip
"""Standing of each state in each class, (classes, states)."""

THROWN_BACK_PER_FOLLOWED = 25.0
"""Number of paths of ghosts, among other strays, for each that is followed from its second reflection on:
the inverse of a polished surface's reflectance, some 4 %."""


@inlined
def after_interface(frame: int, refracts: bool, transmittance: float, path: int) -> int:
    """Return the state of a child at a smooth interface, from its parent's.

    In lens and array, where the image path meets the surfaces in their order, every reflection leaves it, total
    reflection included. In object space total reflection continues the image path.

    Parameters
    ----------
    frame : int
        Frame of the interface: of the lens, the array, or object space.
    refracts : bool
        The child is the refracted one.
    transmittance : float
        Of the interface; 0 under total reflection.
    path : int
        The parent's state.
    """
    if frame != OBJECT_FRAME:
        return path if refracts else OFF_FACE[path]
    return AT_GLASS[path] if refracts or transmittance == 0.0 else OFF_GLASS[path]


@inlined
def counts(options: Options, packet: Any) -> bool:
    """Tell whether a packet's path so far belongs to the class that is being estimated.

    Called where the class is decided: on every target (adjoint), and on the first target after the light (forward).
    """
    return STANDING[options.paths, packet.path] == COUNTS


@inlined
def counts_not_yet(options: Options, packet: Any) -> bool:
    """Tell whether a packet brings nothing to the class that is being estimated as it is, but may come to."""
    return STANDING[options.paths, packet.path] == NOT_YET


@inlined
def cutoff_at_child(options: Options, leaves: bool, refracts: bool, packet: Any) -> float:
    """Return the weight, over a packet's starting weight, below which its child at a face plays another roulette.

    The child brings nothing as it is, and only few such packets continue. 0 if it plays none.

    Parameters
    ----------
    options : Options
    leaves : bool
        The child leaves the lens to object space for good.
    refracts : bool
        The child is the refracted one.
    packet : PACKET
        The parent, with the child's state.
    """
    if not counts_not_yet(options, packet):
        return 0.0
    if leaves:
        return options.thinning.unturned_cutoff
    if not refracts and packet.path == REFLECTED_TWICE:
        return min(options.thinning.unturned_cutoff, THROWN_BACK_PER_FOLLOWED * options.thinning.cutoff)
    return 0.0
