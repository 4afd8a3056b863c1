"""Between the user's settings and the kernels' numbers: options going in, the book coming out."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.levels import SURFACE_LEVEL
from lfmesh.transport.choice import engine_of
from lfmesh.transport.packets.ledger import Ledger
from lfmesh.transport.packets.packet import (
    BOTH,
    DEPTH,
    EMITTED,
    ESCAPED,
    EVENTS,
    FALLBACKS,
    LIT,
    LOST_CONTRADICTION,
    LOST_IN_ARRAY,
    LOST_MISS,
    ON_SENSOR,
    REACHED,
    REQUERIES,
    ROULETTE,
    ROULETTE_ADDED,
    ROULETTE_REMOVED,
    SAMPLING_ADDED,
    SAMPLING_REMOVED,
    TRANSMIT,
    Options,
)
from lfmesh.transport.packets.path_class import EVERY
from lfmesh.transport.world import LOST_IN, World

SPLIT_MODE = {"both": BOTH, "roulette": ROULETTE, "transmit": TRANSMIT}


def options_of(world: World, *, tracing: bool = False, record: bool = False, **override: Any) -> Options:
    """Return a scene's transport settings as the kernels take them; `override` replaces single ones."""
    transport = world.scene.transport
    tables = world.tables
    options = Options(
        SURFACE_LEVEL[transport.surface],
        SPLIT_MODE[transport.split],
        transport.max_events,
        transport.weight_cutoff,
        transport.method == "adjoint" and not tracing,
        tracing,
        record,
        # Light goes from target to target, unless there is but one flat sheet.
        not tracing and (len(tables.objects.closed) > 1 or bool((tables.objects.facets["body"] >= 0).sum() > 2)),
        True,
        not tracing and engine_of(world.scene)[0] == "sequential",
        EVERY,
        transport.weight_cutoff,
        0,
    )
    return options._replace(**override)


def ledger_of(book: NDArray[np.float64], counts: NDArray[np.int64], world: World, packets: int, unit: str) -> Ledger:
    """Return a book with its slots as a ledger."""
    known = {
        EMITTED, ON_SENSOR, ESCAPED, ROULETTE_ADDED, ROULETTE_REMOVED, SAMPLING_ADDED, SAMPLING_REMOVED, DEPTH,
        LOST_MISS, LOST_CONTRADICTION, REACHED, LIT,
    }  # fmt: skip
    losses = {LOST_IN_ARRAY, *world.tables.lens.lost_slot.tolist(), *world.tables.objects.lost_slot.tolist()}
    absorbed: dict[str, float] = {}
    lost_in: dict[str, float] = {}
    for slot, name in enumerate(world.slots):
        if slot in losses and book[slot] != 0.0:
            name = name.removeprefix(LOST_IN)
            lost_in[name] = lost_in.get(name, 0.0) + float(book[slot])
        elif slot not in known and book[slot] != 0.0:
            absorbed[name] = float(book[slot])
    return Ledger(
        unit=unit,
        emitted=float(book[EMITTED]),
        sensor=float(book[ON_SENSOR]),
        absorbed=absorbed,
        escaped=float(book[ESCAPED]),
        roulette_added=float(book[ROULETTE_ADDED]),
        roulette_removed=float(book[ROULETTE_REMOVED]),
        sampling_added=float(book[SAMPLING_ADDED]),
        sampling_removed=float(book[SAMPLING_REMOVED]),
        depth=float(book[DEPTH]),
        lost={"miss": float(book[LOST_MISS]), "contradiction": float(book[LOST_CONTRADICTION])},
        lost_in=lost_in,
        packets=packets,
        events=int(counts[EVENTS]),
        requeries=int(counts[REQUERIES]),
        fallbacks=int(counts[FALLBACKS]),
        reached_target=float(book[REACHED]),
        lit=float(book[LIT]),
    )
