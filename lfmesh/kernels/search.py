"""Search in ascending numbers, for kernels: numba's `np.searchsorted` takes ten times as long to compile."""

from typing import Any

from lfmesh.kernels.decorators import kernel


@kernel
def count_up_to(numbers: Any, x: float) -> int:
    """Return how many of some ascending numbers are at most x, as `np.searchsorted(numbers, x, side="right")` does.

    Parameters
    ----------
    numbers : (n,) float64
    x : float
        NaN counts as larger than all.
    """
    low, high = 0, len(numbers)
    while low < high:
        middle = (low + high) // 2
        if x < numbers[middle]:
            high = middle
        else:
            low = middle + 1
    return low


@kernel
def piece_with(nodes: Any, x: float) -> int:
    """Return the piece between two of some ascending numbers that x lies in; the first or last one beyond them.

    Parameters
    ----------
    nodes : (n,) float64
        Two or more.
    x : float
    """
    return min(max(count_up_to(nodes, x) - 1, 0), len(nodes) - 2)


@kernel
def drawn_by(until: Any, u: float) -> int:
    """Return which of several things a random number draws.

    Parameters
    ----------
    until : (n,) float64
        Cumulative chance of each.
    u : float
        Uniform in [0, 1); the last is drawn where rounding leaves the last chance below it.
    """
    return min(count_up_to(until, u), len(until) - 1)
