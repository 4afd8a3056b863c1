"""The book, where kernels enter energy: its slots, each with a name and an account in the ledger.

A new slot for all scenes is one line here and one line in the kernel that makes entries in it. The ledger, the names of
bodies in paths and the size of the book follow from the list. The slots of a scene's own bodies come after the fixed
ones, see `Book.of_bodies`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.transport.packets.ledger import Ledger

LOST_PREFIX = "lost in "
"""Prefix of the name of a body in which a packet was lost."""

ABSORBED, LOST, LOST_IN = "absorbed", "lost", "lost_in"
"""Accounts of the ledger that list their slots by name; every other account is a single number."""

Slots = NDArray[np.int64]


class Slot(NamedTuple):
    """Entry of the book.

    Attributes
    ----------
    name : str
        Name in the ledger and in recorded paths.
    account : str
        Field of `Ledger` that the slot adds to.
    """

    name: str
    account: str


_fixed: list[Slot] = []


def _slot(name: str, account: str = ABSORBED) -> int:
    _fixed.append(Slot(name, account))
    return len(_fixed) - 1


EMITTED = _slot("emitted", "emitted")
ON_SENSOR = _slot("sensor", "sensor")
ESCAPED = _slot("escaped", "escaped")
ROULETTE_ADDED = _slot("roulette added", "roulette_added")
ROULETTE_REMOVED = _slot("roulette removed", "roulette_removed")
SAMPLING_ADDED = _slot("sampling added", "sampling_added")
SAMPLING_REMOVED = _slot("sampling removed", "sampling_removed")
DEPTH = _slot("depth", "depth")
REACHED = _slot("reached", "reached_target")
LIT = _slot("lit", "lit")
# Lost energy is entered twice: by reason, and by the body in which it was lost.
LOST_MISS = _slot("miss", LOST)
LOST_CONTRADICTION = _slot("contradiction", LOST)
LOST_STUCK = _slot("stuck", LOST)
LOST_IN_MLA = _slot("mla", LOST_IN)
LOST_AT_SENSOR = _slot("sensor", LOST_IN)
LOST_OUTSIDE = _slot("the open", LOST_IN)
# Absorbers that every scene has.
UNFOLLOWED = _slot("reflections not followed")
THIN_LENSES = _slot("étendue of thin lenses")
BESIDE_SENSOR = _slot("beside the sensor")
HOUSING = _slot("housing")
STOP = _slot("stop")
MOUNT = _slot("mount")
MLA_MOUNT = _slot("mla mount")
MLA_EDGE = _slot("mla edge")
MLA_WALL = _slot("mla wall")
MLA_MASK = _slot("mla mask")
LENS_FRONT = _slot("lens front")
EVANESCENT = _slot("diffracted beyond a right angle")
TURNED_BACK = _slot("turned back in gradient-index glass")
TRAPPED = _slot("trapped in gradient-index glass")

FIXED = tuple(_fixed)
"""The slots that every scene has."""


@dataclass(frozen=True)
class Book:
    """The slots of a scene.

    Attributes
    ----------
    slots : tuple of Slot
    edges, targets : (n,) int64
        Slots of the lens elements' edges, and of the targets.
    lost_in_targets, lost_in_spaces : (n,) int64
        Slots of energy lost in each target, and in each space of the lens.
    coatings : dict of str to int
        Slots of the coatings and of other light lost at faces, by name.
    media : (n,) int64
        Slots of absorption in media.
    absorbers : (n,) int64
        Slots of absorption in glasses and liquids.
    trapped : (n,) int64
        Slots of light that never leaves a medium because it bends it.
    """

    slots: tuple[Slot, ...]
    edges: Slots
    targets: Slots
    lost_in_targets: Slots
    lost_in_spaces: Slots
    coatings: dict[str, int] = field(default_factory=dict)
    media: Slots = field(default_factory=lambda: np.zeros(0, np.int64))
    absorbers: Slots = field(default_factory=lambda: np.zeros(0, np.int64))
    trapped: Slots = field(default_factory=lambda: np.zeros(0, np.int64))

    @classmethod
    def of_bodies(
        cls, elements: int, targets: list[str], spaces: list[str], coatings: Sequence[str] = (),
        media: Sequence[str] = (), absorbers: Sequence[str] = (), bending: Sequence[str] = (),
    ) -> "Book":  # fmt: skip
        """Return the book of a scene.

        Parameters
        ----------
        elements : int
            Number of lens elements.
        targets, spaces : list of str
            Names of the targets, and of the spaces of the lens.
        coatings, media, absorbers, bending : sequence of str
            Names of coatings and of other light lost at faces, of media in object space, of bodies of absorbing glass
            or liquid, and of media that bend light.
        """
        slots = list(FIXED)
        numbers = []
        for account, names in (
            (ABSORBED, [f"lens[{i}] edge" for i in range(elements)]),
            (ABSORBED, targets),
            (LOST_IN, targets),
            (LOST_IN, spaces),
        ):
            numbers.append(np.arange(len(slots), len(slots) + len(names)))
            slots += [Slot(name, account) for name in names]
        first = len(slots)
        within = [f"inside {name}" for name in absorbers]
        traps = [f"trapped in {name}" for name in bending]
        slots += [Slot(name, ABSORBED) for name in (*coatings, *media, *within, *traps)]
        edges, of_targets, lost_in_targets, lost_in_spaces = numbers
        by_name = {name: first + i for i, name in enumerate(coatings)}
        until = first + len(coatings) + len(media)
        of_media, of_absorbers = np.arange(first + len(coatings), until), np.arange(until, until + len(within))
        trapped = np.arange(until + len(within), len(slots))
        return cls(
            tuple(slots), edges, of_targets, lost_in_targets, lost_in_spaces, by_name, of_media, of_absorbers, trapped
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.slots)

    @property
    def names(self) -> list[str]:
        """Name of each slot in recorded paths; lost energy is marked by `LOST_PREFIX`."""
        return [f"{LOST_PREFIX}{slot.name}" if slot.account == LOST_IN else slot.name for slot in self.slots]

    def ledger(self, entries: NDArray[np.float64], unit: str, **work: int) -> Ledger:
        """Return the entries of the book as a ledger.

        Parameters
        ----------
        entries : (slots,) float64
        unit : str
            Unit of the entries, see `Ledger`.
        **work : int
            Counts of packets, events and queries, by field of the ledger.
        """
        listed: dict[str, dict[str, float]] = {ABSORBED: {}, LOST: {}, LOST_IN: {}}
        numbers: dict[str, float] = {}
        for slot, value in zip(self.slots, entries.tolist(), strict=True):
            if slot.account not in listed:
                numbers[slot.account] = value
            elif value != 0.0 or slot.account == LOST:
                by_name = listed[slot.account]
                by_name[slot.name] = by_name.get(slot.name, 0.0) + value
        return Ledger(unit=unit, **numbers, **listed, **work)  # type: ignore[arg-type]
