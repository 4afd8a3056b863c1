"""Classes of paths that are estimated independently: every path from the sensor to a light is in exactly one of them.

A path is the sequence of what it meets between sensor and light, in whichever direction it is traced. Three questions,
in this order, give its class:

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

from typing import Any

from lfmesh.kernels.decorators import inlined
from lfmesh.transport.packets.packet import LAMP, OBJECT_FRAME, Options

EVERY, OFF_IMAGE_PATH, LAMP_THROUGH_GLASS, LAMP_ON_CAMERA, GHOSTS, OTHER_STRAYS = 0, 1, 2, 3, 4, 5
"""`Options.paths`."""

IN_NO_GHOST, ON_IMAGE_PATH, STRAY, REFLECTED_ONCE, REFLECTED_TWICE = -1, 0, 1, 2, 3
"""`stray` of a packet. Above 0: its path has left the image path, by one or by two reflections as those of ghosts, or
otherwise. `IN_NO_GHOST`: still on the image path, but it can become none of the ghosts any more."""

STRAYS_OF = {OFF_IMAGE_PATH: (STRAY, REFLECTED_ONCE, REFLECTED_TWICE), OTHER_STRAYS: (STRAY,)}
"""`stray` of the packets that count, in the classes of which not all packets do that are traced."""

THROWN_BACK_PER_FOLLOWED = 25.0
"""Number of paths of ghosts, among other strays, for each that is followed from its second reflection on:
the inverse of a polished surface's reflectance, some 4 %."""


@inlined
def stray_after(frame: int, refracts: bool, transmittance: float, stray: int) -> int:
    """Return `stray` of a child at an interface, from its parent's.

    Parameters
    ----------
    frame, refracts, transmittance
        As for `turns_off_image_path`.
    stray : int
        Of the parent.
    """
    if not turns_off_image_path(frame, refracts, transmittance):
        return stray
    return STRAY if frame == OBJECT_FRAME else stray_after_mirror(stray)


@inlined
def stray_after_mirror(stray: int) -> int:
    """Return `stray` of a packet that a face of the camera has reflected, from what it was before."""
    if stray == ON_IMAGE_PATH:
        return REFLECTED_ONCE
    return REFLECTED_TWICE if stray == REFLECTED_ONCE else STRAY


@inlined
def stray_at_same_surface(stray: int) -> int:
    """Return `stray` of a packet that meets the surface again that it comes from, from what it was before."""
    return IN_NO_GHOST if stray <= ON_IMAGE_PATH else STRAY


@inlined
def stray_before_lens(stray: int) -> int:
    """Return `stray` of a packet that leaves the lens to object space, from what it was in the lens."""
    return IN_NO_GHOST if stray == ON_IMAGE_PATH else stray


@inlined
def turns_off_image_path(frame: int, refracts: bool, transmittance: float) -> bool:
    """Tell whether a child at an interface leaves the image path.

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
    """
    return not refracts and (frame != OBJECT_FRAME or transmittance > 0.0)


@inlined
def is_unturned(options: Options, packet: Any) -> bool:
    """Tell whether a packet does not count yet: it is on the image path or, among other strays, on that of a ghost."""
    if options.paths == OTHER_STRAYS:
        return packet.stray != STRAY
    return options.paths == OFF_IMAGE_PATH and packet.stray <= ON_IMAGE_PATH


@inlined
def is_other_ghost(options: Options, packet: Any) -> bool:
    """Tell whether a packet, of which only other strays count, is on the path of one of the ghosts so far."""
    return options.paths == OTHER_STRAYS and packet.stray == REFLECTED_TWICE


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
        The parent, with `stray` of the child.
    """
    if leaves and is_unturned(options, packet):
        return options.unturned_cutoff
    if not refracts and is_other_ghost(options, packet):
        return min(options.unturned_cutoff, THROWN_BACK_PER_FOLLOWED * options.cutoff)
    return 0.0


@inlined
def is_estimated(options: Options, packet: Any) -> bool:
    """Tell whether a packet's path so far belongs to the class that is being estimated.

    Called where the class is decided: on every target (adjoint), and on the first target after the light (forward).
    """
    if options.paths == OFF_IMAGE_PATH:
        return packet.stray > ON_IMAGE_PATH
    if options.paths == OTHER_STRAYS:
        return packet.stray == STRAY
    if options.paths == LAMP_THROUGH_GLASS:
        # All events of a lamp's packet so far were at glass.
        return packet.kind == LAMP and packet.events > 0
    if options.paths == LAMP_ON_CAMERA:
        # The rough surface of the camera has made it one of the camera's.
        return packet.kind != LAMP
    return True
