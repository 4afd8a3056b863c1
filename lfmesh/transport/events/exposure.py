"""The exposure: the time of a packet, and the share of a time in the mean over the window of a row."""

from typing import Any

import numpy as np

from lfmesh.kernels.decorators import kernel
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

    A packet from a pixel has a random time in the window of its row, by the opening of the shutter. A packet from a
    light has a time for all rows, and packets whose numbers follow each other have times that spread evenly. Without
    random times, t = 0.

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
            return _time_in_windows(motions, owen_sobol(key, packet.source, TIME))
        return _time_in_windows(motions, uniform(derived(key, packet.source), 0))
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


@kernel
def _time_in_windows(motions: Motions, u: float) -> float:
    """Return a random time for all rows.

    If they have different windows, every second time is that of a random row, by the shutter; the others are uniform,
    since few rows are open at the begin and at the end.
    """
    rows = len(motions.begin_s)
    if motions.begin_s[0] == motions.begin_s[rows - 1]:
        return motions.begin_s[0] + shutter_time(motions, u)
    if u < 0.5:
        return motions.end_s * 2.0 * u
    place = (2.0 * u - 1.0) * rows
    row = min(int(place), rows - 1)
    return motions.begin_s[row] + shutter_time(motions, place - row)


@kernel
def _opening(motions: Motions, time_s: float) -> float:
    """Return the opening of the shutter at a time in a window, over its integral, 1/s."""
    times, opening, integral = motions.shutter
    last = len(times) - 1
    if time_s < 0.0 or time_s > times[last]:
        return 0.0
    k = 0
    while k + 2 <= last and times[k + 1] <= time_s:
        k += 1
    share = (time_s - times[k]) / (times[k + 1] - times[k])
    return (opening[k] + share * (opening[k + 1] - opening[k])) / integral[last]


@kernel
def _density(motions: Motions, time_s: float) -> float:
    """Return the density of `_time_in_windows`, 1/s."""
    begin, rows = motions.begin_s, len(motions.begin_s)
    low, high = 0, rows - 1
    step = (begin[high] - begin[0]) / max(high, 1)
    if step == 0.0:
        return _opening(motions, time_s - begin[0])
    # Rows whose windows hold the time, and one more on each side for rounding.
    ends = (time_s - begin[0]) / step, (time_s - motions.duration_s - begin[0]) / step
    low, high = max(low, int(np.ceil(min(ends))) - 1), min(high, int(np.floor(max(ends))) + 1)
    total = 0.0
    for row in range(low, high + 1):
        total += _opening(motions, time_s - begin[row])
    return 0.5 / motions.end_s + 0.5 * total / rows


@kernel
def share_of_time(motions: Motions, row: int, time_s: float) -> float:
    """Return the weight of the time of a packet from a light in the mean over the window of a row of pixels.

    Parameters
    ----------
    motions : Motions
    row : int
        Row of the sensor.
    time_s : float
    """
    own = _opening(motions, time_s - motions.begin_s[row])
    return own / _density(motions, time_s) if own > 0.0 else 0.0
