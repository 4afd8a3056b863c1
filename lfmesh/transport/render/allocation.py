"""Allocation of samples to the parts of an image, by their variance and cost, measured before the run.

The variance of an image whose parts take n samples each, at a cost c a sample, is Σ V / n. For a given Σ n c it is
smallest where n goes as √(V / c). A few samples of some pixels measure V; what a packet meets, and not the clock, gives
c, so that a run is bitwise the same wherever it is made. A part never gets fewer samples than `parts` says: what is
rare may be missing in what was measured.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfmesh.transport.packets.packet import BY_ORDER, EVENTS
from lfmesh.transport.paths.automaton import GHOSTS
from lfmesh.transport.render.parts import Part

LEAST_SAMPLES = 1 << 17
"""Samples of an image, of all its pixels, below which measuring does not pay."""

MEASURED, MEASURED_SHARE = 1 << 13, 64
"""Packets of each part in each of two sets by which its variance is measured: at most, and one of how many samples of
the image."""

SAMPLES_OF_PATH, SAMPLES_OF_OTHERS = 8, 2
"""Samples of each pixel that are measured: of the image path at most, whose Sobol' points are the better the more there
are, and of other parts."""

EACH_NS, QUERY_NS = 100.0, 200.0
EVENT_OF_PATH_NS, EVENT_OF_GHOST_NS, EVENT_NS = 5.0, 25.0, 75.0
"""Processor time of a packet, of a query of Embree, and of an event: on the image path and of ghosts, which are traced
in blocks, and of packets that are traced one by one; fitted to eight of the scenes in assets, on one core."""


@dataclass(frozen=True)
class Measured:
    """Variance and cost of a part's samples.

    Attributes
    ----------
    variance : float, W²
        Of one sample of a pixel, mean over the pixels, less one standard error: rare heavy paths, of which the samples
        hold one by chance, decide nothing.
    cost : float, ns
        Of a sample.
    """

    variance: float
    cost: float


def measured(part: Part, sets: NDArray[np.float64], samples: int, counts: NDArray[np.int64], queries: int) -> Measured:
    """Return the variance and the cost of a part's samples.

    Parameters
    ----------
    part : Part
    sets : (2, pixels) float64, W
        Two independent estimates of some pixels.
    samples : int
        Of each pixel in each of them.
    counts : (COUNTERS,) int64
    queries : int
        What all the packets met.
    """
    squares = 0.5 * samples * (sets[0] - sets[1]) ** 2
    error = squares.std(ddof=1) / math.sqrt(len(squares)) if len(squares) > 1 else math.inf
    per_event = EVENT_NS
    if part.options.faces == BY_ORDER:
        per_event = EVENT_OF_GHOST_NS if part.options.paths == GHOSTS else EVENT_OF_PATH_NS
    met = per_event * counts[EVENTS] + QUERY_NS * queries
    return Measured(max(float(squares.mean()) - error, 0.0), EACH_NS + float(met) / (2 * samples * len(squares)))


def shared(
    parts: tuple[Part, ...], pixels: int, samples: int, replicates: int, measure: Callable[[Part, int, int], Measured]
) -> tuple[Part, ...]:
    """Return the parts of an image with the samples that their variances and costs ask for.

    Parameters
    ----------
    parts : tuple of Part
    pixels : int
        Of the image.
    samples, replicates : int
        Samples of a pixel in each replicate, and replicates.
    measure : callable
        Measures a part with so many pixels, and so many samples of each.
    """
    thinned = [part for part in parts if part.options.adjoint and part.thinned > 1]
    total = pixels * samples * replicates
    if not thinned or total < LEAST_SAMPLES:
        return parts
    packets = min(MEASURED, total // MEASURED_SHARE)
    of_path = min(samples, SAMPLES_OF_PATH)
    path = measure(parts[0], min(pixels, packets // of_path), of_path)
    others = min(pixels, packets // SAMPLES_OF_OTHERS)
    found = {part.number: measure(part, others, SAMPLES_OF_OTHERS) for part in thinned}
    return tuple(_with_share(part, path, found.get(part.number)) for part in parts)


def _with_share(part: Part, path: Measured, own: Measured | None) -> Part:
    """Return a part with the power of two by which its samples should be fewer than those of the image path."""
    # Of an image path that few pixels see, chance may leave no variance to compare with.
    if own is None or not (own.variance > 0.0 and path.variance > 0.0):
        return part
    fewer = math.sqrt(path.variance / path.cost * own.cost / own.variance)
    # Half of the powers of two round down.
    return replace(part, thinned=next((n for n in _powers(part.thinned) if n * math.sqrt(2.0) >= fewer), part.thinned))


def _powers(most: int) -> Iterable[int]:
    """Return the powers of two up to a number."""
    return (1 << k for k in range(most.bit_length()))
