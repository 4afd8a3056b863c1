"""Memory of this machine."""

import os
from functools import cache


@cache
def physical_memory_bytes() -> int:
    """Return the physical memory of this machine."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        # Windows has no sysconf: refuse only sizes that no machine has.
        return 2**44


def fits_into_memory(size: float) -> bool:
    """Return True if this machine has enough memory.

    Parameters
    ----------
    size : float, bytes
    """
    return size <= physical_memory_bytes()
