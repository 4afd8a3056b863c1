"""Real rays of first-order optics at a surface with a phase: the change of their direction in the main order."""

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lfmesh.scene.camera.phase import Phase

if TYPE_CHECKING:
    from lfmesh.optics.phase_profiles import Phases

Array = NDArray[np.float64]


def turn_by_phase(phase: Phase, wavelength_nm: float, x_mm: Array, y_mm: Array) -> Array:
    """Return the change (n, 2) along x and y of index times direction, before its projection onto the surface.

    Parameters
    ----------
    phase : Phase
    wavelength_nm : float
    x_mm, y_mm : (n,) float64
    """
    return phase.path_per_rad_mm(wavelength_nm) * phase_gradients(phase, x_mm, y_mm)


def phase_gradients(phase: Phase, x_mm: Array, y_mm: Array) -> Array:
    """Return the derivatives of a phase by x and y, (n, 2) rad/mm.

    Parameters
    ----------
    phase : Phase
    x_mm, y_mm : (n,) float64
    """
    # Imported here, because kernels load numba, which scenes without phases do not need.
    from lfmesh.optics.phase_profiles import phases_at

    return phases_at(_table(phase), 0, x_mm, y_mm)[:, 1:]


def turn_in_meridian(phase: Phase, wavelength_nm: float, height_mm: float) -> float:
    """Return the change along y of index times direction at a height, before its projection onto the surface.

    Parameters
    ----------
    phase : Phase
        Of revolution.
    wavelength_nm, height_mm : float
    """
    return float(turn_by_phase(phase, wavelength_nm, np.zeros(1), np.array([height_mm]))[0, 1])


@lru_cache(maxsize=64)
def _table(phase: Phase) -> "Phases":
    from lfmesh.optics.phase_profiles import phase_table

    return phase_table([phase.profile()])
