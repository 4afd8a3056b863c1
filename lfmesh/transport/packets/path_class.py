"""Classes of paths, each estimated by itself: every path from the sensor to a light is in exactly one of them.

A path is what it meets between sensor and light, whichever way it is traced. Two questions, asked in this order, tell
its class:

1. Does light of a lamp (`[[lights]]`) meet glass in object space before the first target that scatters it? A lamp is a
   point, a direction, or a disk that rays do not see, and a straight line to it (next-event estimation) is blocked by
   glass: from the sensor such a path cannot be found. It is `LAMP_THROUGH_GLASS`, and traced from the lamp, forward.
   Everything else ends, seen from the sensor, on a target that emits, or on one that a straight line in air joins to a
   lamp.
2. Was it, anywhere between the sensor and that end, turned off the image path? Then it is `OFF_IMAGE_PATH`, else it is
   on the image path, as the sequential engine follows it. It is turned off by a reflection in lens or array, by a
   reflection at glass in object space where it might have been refracted (total reflection there is the image path's
   own way on), and where it meets curved faces of the array twice in one passage. Where on the path that happens does
   not matter: targets may have scattered it before, and may afterwards.

`EVERY` is all paths that a method can find: forward all of them, adjoint all but `LAMP_THROUGH_GLASS`. The light that
is in none of them is named in README, "Limits": that of a lamp which comes to the sensor, or by way of the lens to a
target, before any target has scattered it.
"""

from typing import Any

from lfmesh.kernel import inlined
from lfmesh.transport.packets.packet import LAMP, OBJECT_FRAME, Options

EVERY, OFF_IMAGE_PATH, LAMP_THROUGH_GLASS = 0, 1, 2
"""`Options.paths`."""


@inlined
def turns_off_image_path(frame: int, refracts: bool, transmittance: float) -> bool:
    """Tell whether a packet's child at an interface of lens or array, or of glass in object space, leaves that path.

    Lens and array are met in their order on the image path, which total reflection breaks as any other reflection does;
    in object space that path goes on as total reflection sends it.
    """
    return not refracts and (frame != OBJECT_FRAME or transmittance > 0.0)


@inlined
def is_estimated(options: Options, packet: Any) -> bool:
    """Tell whether the path that a packet has come by so far is one of those that are estimated.

    Asked where the class is settled: on every target (adjoint), and on the first one from the light (forward).
    """
    if options.paths == OFF_IMAGE_PATH:
        return packet.stray != 0
    if options.paths == LAMP_THROUGH_GLASS:
        # A lamp's packet has had no event but at glass.
        return packet.kind == LAMP and packet.events > 0
    return True
