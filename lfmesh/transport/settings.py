"""Conversion of transport settings to the kernels' options, and of the kernels' book to a ledger."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.levels import SURFACE_LEVEL
from lfmesh.transport.choice import engine_of
from lfmesh.transport.packets.ledger import Ledger
from lfmesh.transport.packets.packet import BOTH, EVENTS, FALLBACKS, REQUERIES, ROULETTE, TRANSMIT, Options
from lfmesh.transport.packets.path_class import EVERY
from lfmesh.transport.world import World

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
        # Light may go from target to target, unless there is only a single flat sheet, and no medium sends it there.
        bounce=not tracing
        and (
            len(tables.objects.one_sided) > 1
            or bool((tables.objects.facets["body"] >= 0).sum() > 2)
            or (tables.objects.volumes is not None and (tables.objects.volumes.scatters or tables.objects.volumes.emit))
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
