"""Names of the estimators of an image: each traces some classes of paths, and the image is their sum.

The number of an estimator keys its random numbers, so that no two share them.
"""

from enum import IntEnum


class Estimator(IntEnum):
    """Number of an estimator."""

    IMAGE_PATH = 0  # by the sequential engine; by the mesh engine or forward it traces every path
    STRAYS = 1  # off the image path; where ghosts have an estimator of their own, all other strays
    LAMPS_THROUGH_GLASS = 2  # forward from lamps
    BLIND_CHECK = 3  # every path in another way, to check the others
    GHOSTS = 4
    PARTICLES = 5  # forward from the first entry of particles; each further one has the next number


def lamps_on_camera(entries: int) -> int:
    """Return the number of the estimator of lamps' light on rough surfaces of the camera, traced forward.

    Parameters
    ----------
    entries : int
        Of particles in the scene.
    """
    return Estimator.PARTICLES + entries
