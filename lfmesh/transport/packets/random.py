"""Counter-based random numbers: a number is a function of who asks, not of who asked before.

A packet's key is hashed from (seed, replicate, pixel or packet number, pedigree of splits); its numbers are hashed
from the key and a dimension. So nothing depends on the order of chunks or the number of threads. The hash is the
finaliser of SplitMix64 (Steele, Lea & Flood, OOPSLA 2014), applied once for the key and once for the number.
"""

import numpy as np

from lfmesh.kernel import kernel

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_A = np.uint64(0xBF58476D1CE4E5B9)
_B = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
# From the 53 bits that a float64 holds to a number from 0 to 1.
_UNIT = 2.0**-53

DIMENSIONS_PER_EVENT = 16
"""Numbers that one event of a packet may draw."""


START_DIMENSION = -64
"""A packet's starting numbers have dimensions of their own, before those of any event."""


@kernel
def mix(z: np.uint64) -> np.uint64:
    """Return the hash of 64 bits: a bijection without visible structure."""
    z = (z ^ (z >> _S30)) * _A
    z = (z ^ (z >> _S27)) * _B
    return z ^ (z >> _S31)


@kernel
def derived(key: np.uint64, number: int) -> np.uint64:
    """Return the key of the `number`-th child of a key."""
    return mix(mix(key + GOLDEN) ^ (np.uint64(number) * GOLDEN))


@kernel
def uniform(key: np.uint64, dimension: int) -> float:
    """Return a number in [0, 1), 53 bits."""
    return float(mix(key + GOLDEN * np.uint64(dimension + 1)) >> _S11) * _UNIT


@kernel
def start(key: np.uint64, dimension: int) -> float:
    """Return one of a packet's starting numbers."""
    return uniform(key, START_DIMENSION + dimension)


def descendant(key: int | np.uint64, *numbers: int) -> np.uint64:
    """Return the key at the end of a line of children, to callers that are not compiled.

    A kernel returns 64 bits as a Python integer, and numba would take that for a signed one when it comes back.
    """
    for number in numbers:
        key = derived(np.uint64(key), number)
    return np.uint64(key)


def run_key(seed: int) -> np.uint64:
    """Return the key of a run; its replicates' are its children, and theirs those of the wavelengths."""
    return descendant(0x6C666D657368, seed)
