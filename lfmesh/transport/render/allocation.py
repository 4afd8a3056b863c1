"""Allocation of samples to the parts of an image, by measured variance and cost.

If each part takes n samples at cost c per sample, the image has the variance Σ V / n. For a given Σ n c it is smallest
if n ∝ √(V / c). A few samples of some pixels measure V. Event counts, not the clock, give c, so a run is bitwise the
same on any machine. A part never gets fewer samples than `parts` specifies, because the measurement may miss rare
light.
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
"""Samples of an image, over all pixels, below which measuring does not pay."""

MEASURED, MEASURED_SHARE = 1 << 13, 64
"""Packets per part in each of the two sets that measure its variance: the maximum, and the image samples per packet."""

SAMPLES_OF_PATH, SAMPLES_OF_OTHERS = 8, 2
"""Samples per measured pixel: the maximum for the image path, as more Sobol' points are better, and the number for
other parts."""

EACH_NS, QUERY_NS = 100.0, 200.0
EVENT_OF_PATH_NS, EVENT_OF_GHOST_NS, EVENT_NS = 5.0, 25.0, 75.0
"""Processor time of a packet, of an Embree query, and of an event: on the image path and for ghosts, both traced in
blocks, and for packets traced one by one. Fitted to eight of the scenes in assets, on one core."""


@dataclass(frozen=True)
class Measured:
    """Variance and cost of a part's samples.

    Attributes
    ----------
    variance : float, W²
        Variance of one sample of a pixel, mean over the pixels, less one standard error, so that a rare heavy path
        found by chance decides nothing.
    cost : float, ns
        Cost of a sample.
    """

    variance: float
    cost: float


def measured(part: Part, sets: NDArray[np.float64], samples: int, counts: NDArray[np.int64], queries: int) -> Measured:
    """Return the variance and cost of a part's samples.

    Parameters
    ----------
    part : Part
    sets : (2, pixels) float64, W
        Two independent estimates of some pixels.
    samples : int
        Samples per pixel in each set.
    counts : (COUNTERS,) int64
    queries : int
        Embree queries of all packets.
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
    """Return the parts of an image, with samples by variance and cost.

    Parameters
    ----------
    parts : tuple of Part
    pixels : int
        Pixels of the image.
    samples, replicates : int
        Samples per pixel in each replicate, and replicates.
    measure : callable
        Measures a part with the given numbers of pixels and of samples per pixel.
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
    """Return a part with its power-of-two divisor of samples, relative to the image path."""
    # If few pixels see the image path, its variance may be 0 by chance.
    if own is None or not (own.variance > 0.0 and path.variance > 0.0):
        return part
    fewer = math.sqrt(path.variance / path.cost * own.cost / own.variance)
    # Half of the powers of two round down.
    return replace(part, thinned=next((n for n in _powers(part.thinned) if n * math.sqrt(2.0) >= fewer), part.thinned))


def _powers(most: int) -> Iterable[int]:
    """Return the powers of two up to a number."""
    return (1 << k for k in range(most.bit_length()))
