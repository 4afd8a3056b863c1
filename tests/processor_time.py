"""Processor time, by which tests bound what a program takes: neither a busy machine nor a wait changes it much."""

import os

HANGS_S = 600.0
"""Longer than anything takes that does not hang, on a machine of any load."""


def processor_seconds() -> float:
    """Return the processor time of this process and of its children that have ended."""
    return sum(os.times()[:4])
