"""Classes of paths that are estimated independently. Every path from the sensor to a light is in exactly one.

A path is the sequence of its events between sensor and light, in either tracing direction. An automaton reads it: a
packet carries a `State`, each event leads to the next state, and `STANDING` maps states to classes. Three questions
decide the class, in this order:

1. Does a rough surface of the lens or array scatter light of a lamp (`[[lights]]`) before any target, medium or rough
   glass in object space does? The class is `LAMP_ON_CAMERA`, traced forward from the lamp in both methods.
2. Does light of a lamp meet smooth glass in object space before the first target or rough glass that scatters it? A
   lamp is a point, a direction, or a disk that rays cannot hit, and glass blocks the straight line to it (next-event
   estimation), so a path from the sensor never finds it. The class is `LAMP_THROUGH_GLASS`, traced forward from the
   lamp. Seen from the sensor, every other path ends on a target that emits, or on a target or rough glass joined to a
   lamp by a straight line in air. A medium that bends light counts as smooth glass, from the first chord on that it
   bends: light of a lamp inside such a medium belongs to the class too.
3. Does the path leave the image path, as the sequential engine follows it, between the sensor and that end? The class
   is then `OFF_IMAGE_PATH`; otherwise the path is on the image path. Four events leave the image path: a reflection in
   the lens or array; a reflection at glass in object space that could have refracted (total reflection there continues
   the image path); a second hit in succession on the same curved side of the array; and a second hit in succession on
   the same lens surface from within gradient-index glass, in which the path has turned back. Their place on the path
   does not matter. Scattering at targets and rough glass before or after changes nothing. The mesh engine, which
   estimates `EVERY` path at once, traces rough surfaces of the lens and array. A diffraction order of a phase counts as
   the refraction, or the reflection, on its side.

If ghosts have their own estimator, `OFF_IMAGE_PATH` is divided into `GHOSTS` and `OTHER_STRAYS`. Seen from the sensor,
a ghost path first leaves the camera after exactly two reflections, each at a refracting surface of the lens, a face of
the array or sensor cover, or the sensor. From each of these faces it leads to an adjacent one, and it leaves the image
path nowhere else. (A path that meets the concave side of a surface just left, turns back in gradient-index glass, or
goes from one lenslet straight to its neighbour, is another stray.)

`EVERY` stands for all paths that a method can find: all but `LAMP_ON_CAMERA`, and in the adjoint method all but
`LAMP_THROUGH_GLASS` too. Light in no class is named in transport/README.md, "Limits": lamp light that reaches the
sensor, or a target through the lens, before anything has scattered it.
"""

from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined
from lfmesh.transport.packets.packet import OBJECT_FRAME, Options


class State(IntEnum):
    """State of a packet's path so far: `PACKET.path`.

    The last three states apply to packets from a lamp until the first scattering, which decides their class.
    """

    ON_IMAGE_PATH = 0
    IN_NO_GHOST = 1  # on the image path, but can no longer become a ghost
    REFLECTED_ONCE = 2  # possible ghost after one reflection
    REFLECTED_TWICE = 3
    STRAY = 4  # off the image path otherwise
    FROM_LAMP = 5  # has met no glass in object space
    LAMP_AT_GLASS = 6  # met smooth glass in object space first, or a medium that bends light
    LAMP_IN_CAMERA = 7  # scattered by a rough surface of the camera


ON_IMAGE_PATH, IN_NO_GHOST, REFLECTED_ONCE, REFLECTED_TWICE, STRAY, FROM_LAMP, LAMP_AT_GLASS, LAMP_IN_CAMERA = (
    int(state) for state in State
)


class PathClass(IntEnum):
    """Class of paths that an estimator counts: `Options.paths`."""

    EVERY = 0
    OFF_IMAGE_PATH = 1
    LAMP_THROUGH_GLASS = 2
    LAMP_ON_CAMERA = 3
    GHOSTS = 4
    OTHER_STRAYS = 5


EVERY, OFF_IMAGE_PATH, LAMP_THROUGH_GLASS, LAMP_ON_CAMERA, GHOSTS, OTHER_STRAYS = (int(of) for of in PathClass)


def _step(leads: dict[int, int]) -> NDArray[np.int8]:
    """Return the state after a step for each state before it, (states,); states not in `leads` stay."""
    after = np.arange(len(State), dtype=np.int8)
    for before, state in leads.items():
        after[before] = state
    return after


OFF_FACE = _step({
    ON_IMAGE_PATH: REFLECTED_ONCE, REFLECTED_ONCE: REFLECTED_TWICE, REFLECTED_TWICE: STRAY, IN_NO_GHOST: STRAY,
})  # fmt: skip
"""Reflection, total or not, at a face of the lens, array or cover, or at the sensor."""

FACE_AGAIN = _step({ON_IMAGE_PATH: IN_NO_GHOST, REFLECTED_ONCE: STRAY, REFLECTED_TWICE: STRAY})
"""Second hit in succession on the same lens surface, along a straight line."""

NEXT_LENSLET = _step(dict.fromkeys((ON_IMAGE_PATH, IN_NO_GHOST, REFLECTED_ONCE, REFLECTED_TWICE), STRAY))
"""Second hit in succession on the same curved side of the array."""

FACE_AGAIN_ALONG_CURVE = NEXT_LENSLET
"""Second hit in succession on the same lens surface, from within gradient-index glass."""

OUT_OF_LENS = _step({ON_IMAGE_PATH: IN_NO_GHOST, REFLECTED_ONCE: STRAY})
"""Exit from the lens to object space."""

AT_GLASS = _step({FROM_LAMP: LAMP_AT_GLASS})
"""Refraction or total reflection at smooth glass in object space, or a chord in a medium that bends light."""

OFF_GLASS = _step(
    {FROM_LAMP: LAMP_AT_GLASS} | dict.fromkeys((ON_IMAGE_PATH, IN_NO_GHOST, REFLECTED_ONCE, REFLECTED_TWICE), STRAY)
)
"""Reflection at smooth glass in object space where refraction was possible."""

ON_ROUGH_FACE = _step({FROM_LAMP: LAMP_IN_CAMERA, LAMP_AT_GLASS: LAMP_IN_CAMERA})
"""Scattering by a rough surface of the lens or array."""

NEVER, NOT_YET, COUNTS = 0, 1, 2
"""Standing of a state in a class: the light belongs to another class; it does not count yet but may; it counts."""


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
"""Ghost paths per ghost path that the estimator of other strays follows past its second reflection:
the inverse of a polished surface's reflectance of about 4 %."""


@inlined
def after_interface(frame: int, refracts: bool, transmittance: float, path: int) -> int:
    """Return the state of a child at a smooth interface.

    In the lens and array, every reflection leaves the image path, total reflection included. In object space total
    reflection continues the image path.

    Parameters
    ----------
    frame : int
        Frame of the interface: lens, array or object space.
    refracts : bool
        True for the refracted child.
    transmittance : float
        Transmittance of the interface; 0 for total reflection.
    path : int
        State of the parent.
    """
    if frame != OBJECT_FRAME:
        return path if refracts else OFF_FACE[path]
    return AT_GLASS[path] if refracts or transmittance == 0.0 else OFF_GLASS[path]


@inlined
def counts(options: Options, packet: Any) -> bool:
    """Tell whether a packet's path so far belongs to the estimated class.

    Called where the class is decided: at every target (adjoint), and at the first target after the light (forward).
    """
    return STANDING[options.paths, packet.path] == COUNTS


@inlined
def counts_not_yet(options: Options, packet: Any) -> bool:
    """Tell whether a packet does not count yet in the estimated class but may later."""
    return STANDING[options.paths, packet.path] == NOT_YET


@inlined
def cutoff_at_child(options: Options, leaves: bool, refracts: bool, packet: Any) -> float:
    """Return the weight, relative to the packet's start, below which a child at a face plays extra Russian roulette.

    Such a child does not count yet, and only a few of its kind continue. 0 means no extra roulette.

    Parameters
    ----------
    options : Options
    leaves : bool
        The child leaves the lens to object space for good.
    refracts : bool
        True for the refracted child.
    packet : PACKET
        Parent, with the state of the child.
    """
    if not counts_not_yet(options, packet):
        return 0.0
    if leaves:
        return options.thinning.unturned_cutoff
    if not refracts and packet.path == REFLECTED_TWICE:
        return min(options.thinning.unturned_cutoff, THROWN_BACK_PER_FOLLOWED * options.thinning.cutoff)
    return 0.0
