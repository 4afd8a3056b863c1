"""The exposure: the time of a packet, and the share of a time in the mean over the window of a row."""

from typing import Any

import numpy as np

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.packets.packet import PIXEL_MASK, Options, sample_of
from lfmesh.transport.packets.random import derived, uniform
from lfmesh.transport.packets.sobol import TIME, owen_sobol
from lfmesh.transport.tables.motions import Motions

TIMES = (1 << 62) + 1
"""Number of a key's child that no sample, packet or wavelength uses."""

MOST_POINTS = 1 << 32
"""Number of Sobol' points; packets with larger numbers have independent times."""


@kernel
def drawn_time(motions: Motions, options: Options, packet: Any) -> float:
    """Return the time of a packet, s.

    A packet from a pixel has a random time in the window of its row, by the opening of the shutter; a packet from a
    light has a uniform time in all windows together, and packets whose numbers follow each other have times that spread
    evenly. Without random times, t = 0.

    Parameters
    ----------
    motions : Motions
    options : Options
    packet : PACKET
    """
    if options.still:
        return 0.0
    if not options.adjoint:
        key = derived(options.stream, TIMES)
        if packet.source < MOST_POINTS:
            return motions.end_s * owen_sobol(key, packet.source, TIME)
        return motions.end_s * uniform(derived(key, packet.source), 0)
    pixel = packet.source & PIXEL_MASK
    if options.pixels.each > 0:
        stream, sample = sample_of(options.pixels, packet)
        # In the order of `sobol.step`, as the other numbers of the sample.
        u = owen_sobol(stream, sample ^ (sample >> 1), TIME)
    else:
        u = uniform(derived(derived(options.stream, TIMES), packet.source), 0)
    columns = options.pixels.columns
    return motions.begin_s[pixel // columns] + shutter_time(motions, u)


@kernel
def shutter_time(motions: Motions, u: float) -> float:
    """Return the time in a window, s, up to which the shutter has let the share u of the light in.

    Parameters
    ----------
    motions : Motions
    u : float
    """
    times, opening, integral = motions.shutter
    last = len(times) - 1
    wanted = u * integral[last]
    k = 0
    while k + 2 <= last and integral[k + 1] <= wanted:
        k += 1
    rest, width = wanted - integral[k], times[k + 1] - times[k]
    first, slope = opening[k], (opening[k + 1] - opening[k]) / width
    # Root of first · t + slope · t² / 2 = rest, without cancellation.
    root = np.sqrt(max(first * first + 2.0 * slope * rest, 0.0))
    return times[k] + min(2.0 * rest / (first + root), width) if first + root > 0.0 else times[k]


@inlined
def share_of_time(motions: Any, row: int, time_s: float) -> float:
    """Return the weight of a time, drawn uniformly in all windows, in the mean over the window of a row of pixels.

    Parameters
    ----------
    motions : Motions
    row : int
        Row of the sensor.
    time_s : float
    """
    times, opening, integral = motions.shutter
    last = len(times) - 1
    t = time_s - motions.begin_s[row]
    if t < 0.0 or t > times[last]:
        return 0.0
    k = 0
    while k + 2 <= last and times[k + 1] <= t:
        k += 1
    share = (t - times[k]) / (times[k + 1] - times[k])
    return (opening[k] + share * (opening[k + 1] - opening[k])) * motions.end_s / integral[last]
