"""Scrambled Sobol' points for the first numbers of a path: they fill the unit cube more evenly than random numbers.

They combine Sobol's points (1967), the direction numbers of Joe & Kuo (SIAM J. Sci. Comput. 30, 2635, 2008:
new-joe-kuo-6) and Owen's scrambling (1995): each digit is flipped at random, by a hash of all digits before it. So
every point is uniformly distributed, averages are unbiased, and the spread of independent sets gives a valid standard
error. The hash is Laine & Karras's (EGSR 2011) in Burley's form (JCGT 9(4), 2020), on the reversed bits.
"""

import numpy as np

from lfmesh.kernels.decorators import kernel
from lfmesh.transport.packets.random import derived, mix

COLUMNS = (0, 1, 2, 21, 3, 4, 6, 11, 5)
"""Dimensions of Joe & Kuo's set that are used, counted from zero.

The first two make a (0, 2)-sequence. The next two nearly do, with t = 0 for 8 and 32 points and t = 1 for 16 and 64. In
Joe & Kuo's own order they would have t = 2 for eight points, and a replicate often has no more. The next to last two
nearly make one, too. The last is that of time: of the unused ones among the first 22, it gives a moving edge the least
error beside a coordinate of the lenslet or pixel, with 64 samples and with 256.
"""

DIMENSIONS = len(COLUMNS) - 1

TIME = DIMENSIONS
"""Dimension of a sample's time, beside those of its place and direction; drawn only in scenes with motion."""

_BITS = 32

_FIRST_OF_EVENTS = -7
"""Number of the child of a pixel's key for event number 0. It is negative like the numbers of `scramble_seed`, and
event numbers 0 and 1 would share two of those. No event has these numbers, see `crossing.BOUNCE_U`."""

_POLYNOMIALS = ((0, 0), (1, 0), (2, 1), (7, 7), (3, 1), (3, 2), (4, 4), (5, 13), (4, 1))
"""Degree and inner coefficients of each dimension's primitive polynomial; the first dimension has none."""

_FIRST_NUMBERS = (
    (), (1,), (1, 3), (1, 1, 3, 13, 7, 35, 63), (1, 3, 1), (1, 1, 1), (1, 3, 5, 13), (1, 1, 1, 3, 11), (1, 1, 3, 3),
)  # fmt: skip


def _direction_numbers() -> np.ndarray:
    """Return the (dimensions, 32) direction numbers, by Joe & Kuo's recurrence."""
    table = np.zeros((len(COLUMNS), _BITS), np.uint32)
    table[0] = [1 << (_BITS - 1 - i) for i in range(_BITS)]
    for row, (degree, inner), first in zip(table[1:], _POLYNOMIALS[1:], _FIRST_NUMBERS[1:], strict=True):
        v = [m << (_BITS - 1 - i) for i, m in enumerate(first)]
        for i in range(degree, _BITS):
            number = v[i - degree] ^ (v[i - degree] >> degree)
            for k in range(1, degree):
                number ^= ((inner >> (degree - 1 - k)) & 1) * v[i - k]
            v.append(number)
        row[:] = v
    return table


DIRECTIONS = _direction_numbers()

_M1, _M2, _M3, _M4 = np.uint32(0x55555555), np.uint32(0x33333333), np.uint32(0x0F0F0F0F), np.uint32(0x00FF00FF)
_U1, _U2, _U4, _U8, _U16 = np.uint32(1), np.uint32(2), np.uint32(4), np.uint32(8), np.uint32(16)
_LK1, _LK2, _LK3, _LK4 = (np.uint32(n) for n in (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6))
# Factor from a 32-bit integer to [0, 1).
_UNIT = 2.0**-32


@kernel
def _reversed(x: np.uint32) -> np.uint32:
    """Return 32 bits in reverse order."""
    x = np.uint32(((x >> _U1) & _M1) | ((x & _M1) << _U1))
    x = np.uint32(((x >> _U2) & _M2) | ((x & _M2) << _U2))
    x = np.uint32(((x >> _U4) & _M3) | ((x & _M3) << _U4))
    x = np.uint32(((x >> _U8) & _M4) | ((x & _M4) << _U8))
    return np.uint32((x >> _U16) | (x << _U16))


@kernel
def _scrambled(x: np.uint32, seed: np.uint32) -> np.uint32:
    """Return a number with its binary digits flipped, each by a hash of the digits before it."""
    x = _reversed(x)
    x = np.uint32(x + seed)
    x = np.uint32(x ^ np.uint32(x * _LK1))
    x = np.uint32(x ^ np.uint32(x * _LK2))
    x = np.uint32(x ^ np.uint32(x * _LK3))
    x = np.uint32(x ^ np.uint32(x * _LK4))
    return _reversed(x)


@kernel
def sobol(index: int, dimension: int) -> np.uint32:
    """Return a coordinate of Sobol' point number `index`, as the 32 bits after the binary point."""
    point = np.uint32(0)
    bit = 0
    while index > 0:
        if index & 1:
            point = np.uint32(point ^ DIRECTIONS[dimension, bit])
        index >>= 1
        bit += 1
    return point


@kernel
def owen_sobol(key: np.uint64, index: int, dimension: int) -> float:
    """Return a coordinate in [0, 1) of a point in the set scrambled by `key`.

    Parameters
    ----------
    key : uint64
        Key of the set, from (seed, replicate, pixel).
    index : int
        Number of the point, below 2³²; the first 2^m points are stratified.
    dimension : int
        Below `DIMENSIONS`, or `TIME`.
    """
    return scrambled(sobol(index, dimension), scramble_seed(key, dimension))


@kernel
def scramble_seed(key: np.uint64, dimension: int) -> np.uint32:
    """Return the seed of the hash that scrambles a dimension for the set of a key."""
    # Children with negative numbers: the numbers from zero on give the keys of the samples.
    return np.uint32(derived(key, -1 - dimension) & np.uint64(0xFFFFFFFF))


@kernel
def scrambled(point: np.uint32, seed: np.uint32) -> float:
    """Return a coordinate in [0, 1), its digits scrambled."""
    return _scrambled(point, seed) * _UNIT


@kernel
def of_event(key: np.uint64, number: int, sample: int) -> tuple[float, float]:
    """Return a point in the unit square for one event of a sample; a pixel's samples are evenly spread.

    Each event has its own Sobol' set with the samples in a different order, so events are independent (Burley, JCGT
    9(4), 2020, section 5).

    Parameters
    ----------
    key : uint64
        Of the pixel in its replicate.
    number : int
        First dimension of the event; identifies its set in the pixel.
    sample : int
        Number of the sample, below 2³².
    """
    own = derived(key, _FIRST_OF_EVENTS - number)
    order, first = np.uint32(own & np.uint64(0xFFFFFFFF)), np.uint32(own >> np.uint64(32))
    index = _scrambled(np.uint32(sample), order)
    # The second coordinate's direction numbers are Pascal's triangle modulo 2, applied in five steps.
    point = np.uint32(index ^ (index >> _U16))
    point = np.uint32(point ^ ((point >> _U8) & _M4))
    point = np.uint32(point ^ ((point >> _U4) & _M3))
    point = np.uint32(point ^ ((point >> _U2) & _M2))
    point = np.uint32(point ^ ((point >> _U1) & _M1))
    second = np.uint32(mix(own) & np.uint64(0xFFFFFFFF))
    return _scrambled(_reversed(index), first) * _UNIT, _scrambled(_reversed(point), second) * _UNIT


@kernel
def scramble(points: np.ndarray, seeds: np.ndarray, numbers: np.ndarray) -> None:
    """Scramble arrays of points.

    Parameters
    ----------
    points : (n,) uint32
    seeds : (n,) uint32
        See `scramble_seed`.
    numbers : (n,) float64
        Filled with the coordinates, in [0, 1).
    """
    for i in range(len(points)):
        numbers[i] = _scrambled(points[i], seeds[i]) * _UNIT


@kernel
def step(point: np.ndarray, sample: int) -> None:
    """Step from the point of sample − 1 to that of `sample` in Gray-code order: one digit of the index changes.

    Sample s is point number s ^ (s >> 1), so the first 2^m samples are the first 2^m points.
    """
    bit = 0
    while not (sample >> bit) & 1:
        bit += 1
    for dimension in range(len(point)):
        point[dimension] ^= DIRECTIONS[dimension, bit]
