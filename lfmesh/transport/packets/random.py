"""Counter-based random numbers: functions of a key and a dimension, without a state.

A packet's key is hashed from (seed, replicate, pixel or packet number, pedigree of splits); its numbers are hashed from
the key and a dimension. So no number depends on the order of chunks or the number of threads. The hash is the finaliser
of SplitMix64 (Steele, Lea & Flood, OOPSLA 2014), applied once for the key and once for the number.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import kernel

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_A = np.uint64(0xBF58476D1CE4E5B9)
_B = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
# Factor from a 53-bit integer, which float64 holds exactly, to [0, 1).
_UNIT = 2.0**-53

DIMENSIONS_PER_EVENT = 16
"""Most random numbers that one event of a packet may draw."""

WAVELENGTHS = 1 << 62
"""Number of a key's child that no sample or packet uses."""

START_DIMENSION = -64
"""First dimension of a packet's starting numbers. They lie before the dimensions of all events."""


@kernel
def mix(z: np.uint64) -> np.uint64:
    """Return the hash of a 64-bit integer (a bijection)."""
    z = (z ^ (z >> _S30)) * _A
    z = (z ^ (z >> _S27)) * _B
    return z ^ (z >> _S31)


@kernel
def derived(key: np.uint64, number: int) -> np.uint64:
    """Return the key of the `number`-th child of a key."""
    return mix(mix(key + GOLDEN) ^ (np.uint64(number) * GOLDEN))


@kernel
def uniform(key: np.uint64, dimension: int) -> float:
    """Return a random number in [0, 1), with 53 bits, for a key and a dimension."""
    return float(mix(key + GOLDEN * np.uint64(dimension + 1)) >> _S11) * _UNIT


@kernel
def start(key: np.uint64, dimension: int) -> float:
    """Return one of a packet's starting numbers, in [0, 1)."""
    return uniform(key, START_DIMENSION + dimension)


@kernel
def wavelength_number(key: np.uint64) -> float:
    """Return the random number in [0, 1) that places the wavelengths of a key's owner within a band."""
    return uniform(derived(key, WAVELENGTHS), 0)


def wavelength_numbers(key: np.uint64, numbers: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the `wavelength_number` of each given child of a key, (n,)."""
    found = np.empty(len(numbers))
    _fill_wavelength_numbers(key, numbers, found)
    return found


@kernel
def _fill_wavelength_numbers(key: np.uint64, numbers: NDArray[np.int64], found: NDArray[np.float64]) -> None:
    for i in range(len(numbers)):
        found[i] = wavelength_number(derived(key, numbers[i]))


def descendant(key: int | np.uint64, *numbers: int) -> np.uint64:
    """Return the key of a child of a child, and so on, of a key, for callers in Python.

    A kernel returns its uint64 as a Python integer, which numba would take as signed in the next call.
    """
    for number in numbers:
        key = derived(np.uint64(key), number)
    return np.uint64(key)


def run_key(seed: int) -> np.uint64:
    """Return the key of a run; its children are keys of replicates, and theirs keys of wavelengths."""
    return descendant(0x6C666D657368, seed)
