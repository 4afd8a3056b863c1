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
   continues the image path), and where it meets curved faces of the array twice in one passage. Where on the path that
   happens does not matter: targets and rough glass may scatter it before and after, which by itself changes nothing.
   Rough surfaces of lens and array are traced by the mesh engine, which estimates `EVERY` path at once.

`EVERY` stands for all paths that a method can find: all but `LAMP_ON_CAMERA`, and in the adjoint method all but
`LAMP_THROUGH_GLASS` too. Light that is in no class is named in transport/README.md, "Limits": light of a lamp that
reaches the sensor, or through the lens a target, before anything has scattered it.
"""

from typing import Any

from lfmesh.kernel import inlined
from lfmesh.transport.packets.packet import LAMP, OBJECT_FRAME, Options

EVERY, OFF_IMAGE_PATH, LAMP_THROUGH_GLASS, LAMP_ON_CAMERA = 0, 1, 2, 3
"""`Options.paths`."""


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
    """Tell whether a packet's path, of which only those off the image path count, is still on it."""
    return options.paths == OFF_IMAGE_PATH and packet.stray == 0


@inlined
def is_estimated(options: Options, packet: Any) -> bool:
    """Tell whether a packet's path so far belongs to the class that is being estimated.

    Called where the class is decided: on every target (adjoint), and on the first target after the light (forward).
    """
    if options.paths == OFF_IMAGE_PATH:
        return packet.stray != 0
    if options.paths == LAMP_THROUGH_GLASS:
        # All events of a lamp's packet so far were at glass.
        return packet.kind == LAMP and packet.events > 0
    if options.paths == LAMP_ON_CAMERA:
        # The rough surface of the camera has made it one of the camera's.
        return packet.kind != LAMP
    return True
