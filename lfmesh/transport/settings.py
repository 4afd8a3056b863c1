"""Conversion of transport settings to the kernels' options, and of the kernels' book to a ledger."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.geometry.meshes.levels import SURFACE_LEVEL
from lfmesh.geometry.meshes.mesh import distance_mm
from lfmesh.transport.choice import engine_of
from lfmesh.transport.packets.ledger import Ledger
from lfmesh.transport.packets.packet import (
    BOTH,
    CAMERA_FRAME,
    EVENTS,
    FALLBACKS,
    REQUERIES,
    ROULETTE,
    TRANSMIT,
    WORLD_FRAME,
    Options,
)
from lfmesh.transport.paths.automaton import EVERY
from lfmesh.transport.world import World

NEAR_LENS = 10.0
"""Distance of a target from the lens, in radii of its widest surface, up to which light may come back to it. A white
sheet before an uncoated singlet is 5.2 % brighter by it at half a radius, 0.25 % at four radii, and less than 0.05 % at
ten."""

SPLIT_MODE = {"both": BOTH, "roulette": ROULETTE, "transmit": TRANSMIT}


def options_of(world: World, *, tracing: bool = False, record: bool = False, **override: Any) -> Options:
    """Return a scene's transport settings as kernels take them.

    Parameters
    ----------
    world : World
    tracing, record : bool
        See `Options`.
    **override
        Options that replace those of the scene.
    """
    transport = world.scene.transport
    tables = world.tables
    options = Options(
        surface=SURFACE_LEVEL[transport.surface],
        split=SPLIT_MODE[transport.split],
        max_events=transport.max_events,
        cutoff=transport.weight_cutoff,
        adjoint=transport.method == "adjoint" and not tracing,
        tracing=tracing,
        record=record,
        # Light may go from target to target, unless there is only a single flat sheet far from the lens, and no medium
        # sends it there.
        bounce=not tracing
        and (
            len(tables.objects.one_sided) > 1
            or bool((tables.objects.facets["body"] >= 0).sum() > 2)
            or (tables.objects.volumes is not None and (tables.objects.volumes.scatters or tables.objects.volumes.emit))
            or (transport.split != "transmit" and _is_near_lens(world))
        ),
        aimed=True,
        sequential=not tracing and engine_of(world.scene)[0] == "sequential",
        paths=EVERY,
        unturned_cutoff=transport.weight_cutoff,
        first_source=0,
        importance=transport.method == "adjoint" and not tracing,
        in_order=not tracing
        and transport.engine != "mesh"
        and (bool(tables.lens.ordered.any()) or (tables.mla.present and transport.surface == "exact")),
    )
    return options._replace(**override)


def _is_near_lens(world: World) -> bool:
    """Tell whether a target is so near that the lens throws some of its light back onto it."""
    (eye,) = frame.points(world.tables.frames[CAMERA_FRAME, WORLD_FRAME], np.zeros((1, 3)))
    near = NEAR_LENS * max(world.lens_shape.rims)
    return any(distance_mm(body.mesh.vertices[body.mesh.faces], eye) < near for body in world.targets)


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
