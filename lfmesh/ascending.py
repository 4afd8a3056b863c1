"""Search in ascending numbers, for kernels: numba's `np.searchsorted` takes ten times as long to compile."""

from typing import Any

from lfmesh.kernel import kernel


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
