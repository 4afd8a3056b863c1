"""Estimators of an image: each traces some classes of paths, and the image is their sum.

The number of an estimator keys its random numbers, so no two estimators share them.
"""

from enum import IntEnum


class Estimator(IntEnum):
    """Number of an estimator."""

    IMAGE_PATH = 0  # sequential engine; with the mesh engine, or forward, every path
    STRAYS = 1  # off the image path; without the ghosts if they have their own estimator
    LAMPS_THROUGH_GLASS = 2  # forward from lamps
    BLIND_CHECK = 3  # every path by another method, to check the other estimators
    GHOSTS = 4
    PARTICLES = 5  # forward from the first entry of particles; later entries take the next numbers


def lamps_on_camera(entries: int) -> int:
    """Return the number of the estimator of lamp light on rough camera surfaces, traced forward.

    Parameters
    ----------
    entries : int
        Number of `particles` entries in the scene.
    """
    return Estimator.PARTICLES + entries
