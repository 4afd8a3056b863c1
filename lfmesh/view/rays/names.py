"""Designers' names for the surfaces of a camera, and short labels.

| name              | label | meaning                                                                       |
|-------------------|-------|-------------------------------------------------------------------------------|
| `lens[0].front`   | L1a   | first surface of the first piece of glass, as in `world.mesh("lens[0]")`      |
| `lens[0].back`    | L1b   | its second; a cemented surface is the back of the first piece                 |
| `surface[3]`      | S3    | surface 3 of the prescription if it bounds no glass                           |
| `mla.curved`      | MLAc  | faces of the lenslets                                                         |
| `mla.flat`        | MLAf  | other side of the array                                                       |
| `mla.back`        | MLAb  | the same with lenslets                                                        |
| `cover.front`     | CVa   | face of the sensor's cover glass towards the lens                             |
| `cover.rear`      | CVb   | its face towards the pixels                                                   |

Ends have the names of the ledger: "sensor", "stop", "mount", "lens[0] edge", "housing", ...; targets their own. Faces
of media that bend light have the names of the media.
"""

import functools
import re

import numpy as np
from numpy.typing import NDArray

from lfmesh.transport.packets.packet import (
    BACK_FACE,
    COVER_FRONT,
    COVER_REAR,
    CURVED_FACE,
    ENDS_AT,
    FLAT_FACE,
    IN_FIELD,
    ON_GLASS,
    ON_TARGET,
)
from lfmesh.transport.world import World

START = "start"
CURVED, FLAT, BACK = "mla.curved", "mla.flat", "mla.back"
FRONT, REAR = "cover.front", "cover.rear"
SENSOR = "sensor"

_BEHIND_LENS = {CURVED_FACE: CURVED, FLAT_FACE: FLAT, COVER_FRONT: FRONT, COVER_REAR: REAR, BACK_FACE: BACK}
_IN_SHORT = {CURVED: "MLAc", FLAT: "MLAf", FRONT: "CVa", REAR: "CVb", BACK: "MLAb"}


def lens_names(world: World) -> list[str]:
    """Return the names of the refracting surfaces of the lens, in order."""
    shape = world.lens_shape
    names = [f"surface[{number}]" for number in shape.numbers]
    for element, k in reversed(list(enumerate(shape.elements))):
        names[k], names[k + 1] = f"lens[{element}].front", f"lens[{element}].back"
    # A cemented surface belongs to the earlier element.
    for element, k in enumerate(shape.elements):
        names[k + 1] = f"lens[{element}].back"
    return names


def aliases(world: World) -> dict[str, str]:
    """Return the alternative names of surfaces, with their main names: labels, cemented fronts, numbers."""
    shape, names = world.lens_shape, lens_names(world)
    other = {label(name): name for name in [*names, *_BEHIND_LENS.values()]}
    for element, k in enumerate(shape.elements):
        other[f"lens[{element}].front"] = names[k]
        other[f"L{element + 1}a"] = names[k]
    for number, target in enumerate(target_names(world)):
        other[f"targets[{number}]"] = target
    return {alias: name for alias, name in other.items() if alias != name}


def target_names(world: World) -> list[str]:
    """Return the names of the targets."""
    return [world.slots[slot] for slot in world.tables.objects.target_slot]


def surface_names(world: World) -> list[str]:
    """Return the names of all surfaces of vertices, in the order of `Rays.surface`."""
    return [START, *lens_names(world), *_BEHIND_LENS.values(), *target_names(world), *world.slots]


def mirror_names(world: World) -> list[str]:
    """Return the names of all potentially reflecting surfaces of the camera, from object to sensor."""
    tables, names = world.tables, lens_names(world)
    if tables.mla.present:
        other = FLAT if tables.mla.back is None else BACK
        names += [CURVED, other] if curved_to_lens(world) else [other, CURVED]
    if tables.cover is not None:
        names += [FRONT, REAR]
    return [*names, SENSOR] if tables.sensor.reflectance > 0.0 else names


def curved_to_lens(world: World) -> bool:
    """Tell whether the curved face described by `camera.mla` is towards the lens."""
    mla = world.scene.camera.mla
    return mla is not None and mla.curved_side == "lens"


def surface_numbers(world: World, surface: NDArray[np.int64], part: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return recorded surfaces as numbers in the order of `surface_names`.

    Parameters
    ----------
    world : World
    surface, part : (n,) int64
        As recorded, see `packet.NODE`.
    """
    first_face = 1 + len(world.lens_shape.surfaces)
    first_target = first_face + len(_BEHIND_LENS)
    first_end = first_target + len(world.tables.objects.target_slot)
    on_target = (surface == ON_TARGET) | (surface == ON_GLASS)
    numbers = np.where(on_target, first_target + part, surface + 1)
    for place, face in enumerate(_BEHIND_LENS):
        numbers = np.where(surface == face, first_face + place, numbers)
    slot = surface - ENDS_AT
    numbers = np.where(slot >= 0, first_end + slot, numbers)
    for target, own in enumerate(world.tables.objects.target_slot):
        numbers = np.where(slot == own, first_target + target, numbers)
    in_field = surface == IN_FIELD
    if in_field.any():
        numbers = np.where(in_field, first_end + world.book.media[np.where(in_field, part, 0)], numbers)
    return numbers.astype(np.int64)


@functools.cache
def label(name: str) -> str:
    """Return the short label of a surface; other names stay unchanged."""
    if found := re.fullmatch(r"lens\[(\d+)\]\.(front|back)", name):
        return f"L{int(found[1]) + 1}{'a' if found[2] == 'front' else 'b'}"
    if found := re.fullmatch(r"surface\[(\d+)\]", name):
        return f"S{found[1]}"
    return _IN_SHORT.get(name, name)
