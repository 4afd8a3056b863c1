"""Real rays through gradient-index glass in scenes that are not built yet.

Kernels are imported only where there is such glass.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import GlassError
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.camera.surface import Surface

if TYPE_CHECKING:
    from lfmesh.optics.gradients import Gradients

Array = NDArray[np.float64]

PRECISION = 1e-9
"""Largest error of a ray's position at the end of a gap, in mm."""

PROBES = 4
"""Number of parallel rays, up to the rim of the gap, that determine the number of steps."""

TRIALS = 20
"""Maximum number of Newton steps to the face at the end of a gap."""

ROUNDED = 1e-12
"""Distance from the face, relative to the length of the gap and the height, that rounding explains."""


class GradientSpace(NamedTuple):
    """Gradient-index glass behind a surface, at one wavelength, in the frame of that surface's vertex.

    Attributes
    ----------
    gradients : Gradients
        One profile.
    steps : int
        Number of equal steps of a ray.
    length_mm : float
        Distance to the next vertex.
    """

    gradients: "Gradients"
    steps: int
    length_mm: float

    def index_at(self, points: Array) -> Array:
        """Return the refractive index at points, (n,), from the points, (n, 3) mm."""
        from lfmesh.optics.gradients import fields_at

        with np.errstate(invalid="ignore"):
            return np.asarray(np.sqrt(fields_at(self.gradients, 0, points)[:, 0]))

    def followed(self, points: Array, directions: Array, met: Callable[[Array, Array], Array]) -> tuple[Array, Array]:
        """Return the points where rays end on a face, and their directions there; NaN if they do not reach it.

        Parameters
        ----------
        points, directions : (n, 3) float64
            Starts in the glass, in mm, and unit vectors.
        met : callable
            Returns the points, (n, 3), where straight rays meet the face, given points and directions.

        Returns
        -------
        tuple of two (n, 3) float64
        """
        from lfmesh.optics.gradient_path import advanced, starting_rays

        start = starting_rays(self.gradients, 0, points, directions)
        at, along = points, directions
        length = np.zeros(len(points))
        with np.errstate(all="ignore"):
            optical = np.linalg.norm(start[:, 3:6], axis=1)
            for _ in range(TRIALS):
                step = ((met(at, along) - at) * along).sum(axis=1)
                length = length + step / optical
                ends = advanced(self.gradients, 0, start, length, self.steps)
                at, optical = ends[:, :3], np.linalg.norm(ends[:, 3:6], axis=1)
                along = ends[:, 3:6] / optical[:, None]
                size = self.length_mm + np.abs(at).max(axis=1)
                if not (np.abs(step) > ROUNDED * size).any():
                    break
            arrived = (np.abs(step) <= 1e3 * ROUNDED * size) & (along[:, 2] > 0.0)
        return np.where(arrived[:, None], at, np.nan), np.where(arrived[:, None], along, np.nan)


def space_behind(surface: Surface, wavelength_nm: float) -> GradientSpace | None:
    """Return the gradient-index glass behind a surface, or None if the medium is homogeneous.

    Parameters
    ----------
    surface : Surface
        Of a solved scene.
    wavelength_nm : float

    Raises
    ------
    GlassError
        Rays cannot be traced through the glass.
    """
    if surface.gradient is None:
        return None
    radius, length = surface.semi_diameter_mm or 1.0, surface.thickness_mm or 0.0
    return _space(surface.gradient, wavelength_nm, length, radius)


@lru_cache(maxsize=64)
def _space(gradient: Gradient, wavelength_nm: float, length_mm: float, radius_mm: float) -> GradientSpace:
    from lfmesh.optics import gradient_path
    from lfmesh.optics.gradients import gradient_table

    gradients = gradient_table([gradient.profile(wavelength_nm)])
    if not length_mm:
        return GradientSpace(gradients, 1, length_mm)
    heights = radius_mm * np.arange(1, PROBES + 1) / PROBES
    points = np.column_stack([np.zeros(PROBES), heights, np.zeros(PROBES)])
    probes = gradient_path.starting_rays(gradients, 0, points, np.tile([0.0, 0.0, 1.0], (PROBES, 1)))
    end = gradient_path.ConicFace(0.0, 0.0, length_mm)

    def traced(some: Array, count: int) -> tuple[NDArray[np.bool_], Array]:
        return gradient_path.traced(gradients, 0, some, end, count)

    least = gradient_path.least_steps(gradients, 0, points, length_mm, 2.0 * radius_mm)
    arriving = probes[gradient_path.arriving_probes(lambda count: traced(probes, count)[0], least)]
    if not len(arriving):
        raise GlassError("gradient index: no ray along the axis reaches the next face")
    needed = gradient_path.steps_needed(lambda count: traced(arriving, count), PRECISION)
    return GradientSpace(gradients, max(needed, least), length_mm)
