"""What of an image is traced in which way.

Paths with reflections carry a few per cent of the light and cost ten times as much as the image path. So the adjoint
method estimates the two apart, and adds them: the image path with the sequential engine, and with the mesh engine all
other paths, for which fewer samples do. Each path is in one of the two, and counts once.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfmesh.transport.aiming import WIDE_SHARE_OF_IMAGE_PATH, WIDE_SHARE_OF_STRAYS
from lfmesh.transport.choice import engine_of
from lfmesh.transport.packet import LIT, REACHED, TRANSMIT, Options
from lfmesh.transport.settings import options_of
from lfmesh.transport.tables import Tables
from lfmesh.transport.world import World

IMAGE_PATHS_PER_STRAY = 2
"""Samples of the image path for each one of the paths off it."""


@dataclass(frozen=True)
class Part:
    """Paths that are traced in one way.

    Attributes
    ----------
    number : int
    options : Options
    tables : Tables
    thinned : int
        It takes one of so many samples.
    accounts : bool
        Its book accounts for all energy; another part's has nothing new but what its own paths reach.
    """

    number: int
    options: Options
    tables: Tables
    thinned: int = 1
    accounts: bool = True

    def samples(self, of_image: int) -> int:
        """Return its samples of a pixel that gets so many in all; one at least."""
        return max(1, of_image // self.thinned)

    def booked(self, book: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what of a chunk's book goes into the ledger."""
        kept = book.copy()
        if not self.accounts:
            kept[:] = 0.0
            kept[[REACHED, LIT]] = book[[REACHED, LIT]]
        return kept


def parts_of(world: World, *, aimed: bool = True) -> tuple[Part, ...]:
    """Return the parts of a scene's image; all that are there are added."""
    options, tables = options_of(world, aimed=aimed), world.tables
    if engine_of(world.scene)[0] != "both":
        return (Part(0, options, tables),)
    path = tables.aim._replace(wide_share=WIDE_SHARE_OF_IMAGE_PATH, blind_share=WIDE_SHARE_OF_IMAGE_PATH)
    strays = tables.aim._replace(wide_share=WIDE_SHARE_OF_STRAYS)
    return (
        Part(0, options._replace(split=TRANSMIT, sequential=True), tables._replace(aim=path), accounts=False),
        Part(1, options._replace(strays=True), tables._replace(aim=strays), IMAGE_PATHS_PER_STRAY),
    )
