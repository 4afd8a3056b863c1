"""Optical path that a diffractive face adds to rays."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lfmesh.optics.phase_profiles import Phases, phase_table, phases_at
from lfmesh.scene.camera.phase import AnyPhase

Array = NDArray[np.float64]

KEPT = 16
"""Phases in the cache."""


def phase_path_mm(phase: AnyPhase, points: Array, wavelength_nm: float) -> Array:
    """Return the optical path m λ Φ / 2π that a phase adds to rays of its main order, (n,) mm.

    The gradient of the path is the change of the rays' tangential direction cosines.

    Parameters
    ----------
    phase : AnyPhase
    points : (n, 2) float64, mm
        On the face, in its own frame.
    wavelength_nm : float
    """
    found = phases_at(_table_of(phase), 0, points[:, 0], points[:, 1])
    return np.asarray(phase.path_per_rad_mm(wavelength_nm) * found[:, 0])


@lru_cache(maxsize=KEPT)
def _table_of(phase: AnyPhase) -> Phases:
    return phase_table([phase.profile()])
