"""Conversion of transport settings to kernel options, and of the book to a ledger."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.geometry.meshes.levels import SURFACE_LEVEL
from lfmesh.transport.choice import engine_of
from lfmesh.transport.packets.ledger import Ledger
from lfmesh.transport.packets.packet import (
    BOTH,
    BY_MESH,
    BY_ORDER,
    BY_ORDER_OR_MESH,
    CAMERA_FRAME,
    EVENTS,
    FALLBACKS,
    OBJECT_FRAME,
    REQUERIES,
    ROULETTE,
    TRANSMIT,
    WORLD_FRAME,
    Options,
    Thinning,
)
from lfmesh.transport.paths.automaton import EVERY
from lfmesh.transport.tables.motions import STILL
from lfmesh.transport.tables.swept import path_of_camera
from lfmesh.transport.world import World

NEAR_LENS = 10.0
"""Distance of a target from the lens, in radii of its widest surface, below which light may return to the target. It
makes a white sheet in front of an uncoated singlet 5.2 % brighter at half a radius, 0.25 % at four radii, and less
than 0.05 % at ten."""

BENT_BACK = 1e-2
"""Deflection by media, rad, above which light may return to a flat target: the square is its largest share."""

SPLIT_MODE = {"both": BOTH, "roulette": ROULETTE, "transmit": TRANSMIT}


def options_of(world: World, *, tracing: bool = False, record: bool = False, **override: Any) -> Options:
    """Return a scene's transport settings for kernels.

    Parameters
    ----------
    world : World
    tracing, record : bool
        See `Options`.
    **override
        Replacements of the scene's options, or of fields of their `Thinning`.
    """
    transport = world.scene.transport
    tables = world.tables
    options = Options(
        surface=SURFACE_LEVEL[transport.surface],
        faces=BY_MESH if tracing else _faces(world),
        thinning=Thinning(SPLIT_MODE[transport.split], transport.weight_cutoff, transport.weight_cutoff),
        max_events=transport.max_events,
        adjoint=transport.method == "adjoint" and not tracing,
        tracing=tracing,
        record=record,
        # Light may go from target to target unless all facets lie in one plane, far from the lens, and no medium sends
        # it there.
        bounce=not tracing
        and (
            not world.is_flat
            or _bend_back(world)
            or (tables.objects.volumes is not None and (tables.objects.volumes.scatters or tables.objects.volumes.emit))
            or (transport.split != "transmit" and _is_near_lens(world))
        ),
        aimed=True,
        paths=EVERY,
        importance=transport.method == "adjoint" and not tracing,
        still=tracing or record,
    )
    thinning = {name: override.pop(name) for name in Thinning._fields if name in override}
    return with_thinning(options._replace(**override), **thinning)


def _bend_back(world: World) -> bool:
    """Tell whether media bend so much of a flat target's light back onto it that it counts, or light is aimed there."""
    fields = world.tables.objects.fields
    if fields is None:
        return False
    return fields.deflection > BENT_BACK or world.scene.transport.method == "forward"


def with_thinning(options: Options, **change: Any) -> Options:
    """Return options with other fields of their `Thinning`."""
    return options._replace(thinning=options.thinning._replace(**change))


def _faces(world: World) -> int:
    """Return the method, `Options.faces`, to find surfaces of lens and array in a render."""
    transport, tables = world.scene.transport, world.tables
    if engine_of(world.scene)[0] == "sequential":
        return BY_ORDER
    in_order = bool(tables.lens.ordered.any()) or (tables.mla.present and transport.surface == "exact")
    return BY_ORDER_OR_MESH if in_order and transport.engine != "mesh" else BY_MESH


def _is_near_lens(world: World) -> bool:
    """Tell whether a target may come so near that the lens reflects some of its light back onto it."""
    moves, motions = world.tables.frames, world.tables.motions
    (eye,) = frame.points(moves[CAMERA_FRAME, OBJECT_FRAME], np.zeros((1, 3)))
    near, to_world = NEAR_LENS * max(world.lens_shape.rims), moves[OBJECT_FRAME, WORLD_FRAME]
    for number, body in enumerate(world.targets):
        mover = STILL if motions is None else int(motions.of_target[number])
        # A still scene has one place of the lens and no reach.
        places, reach = path_of_camera(motions, mover, eye, 0.5 * near)
        if any(body.distance_mm(place) < near + reach for place in frame.points(to_world, places)):
            return True
    return False


def ledger_of(book: NDArray[np.float64], counts: NDArray[np.int64], world: World, packets: int, unit: str) -> Ledger:
    """Return a book's entries as a ledger.

    Parameters
    ----------
    book : (slots,) float64
    counts : (COUNTERS,) int64
    world : World
    packets : int
        Packets started.
    unit : str
        Unit of the book.
    """
    return world.book.ledger(
        book,
        unit,
        packets=packets,
        events=int(counts[EVENTS]),
        requeries=int(counts[REQUERIES]),
        fallbacks=int(counts[FALLBACKS]),
    )
