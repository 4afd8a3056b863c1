"""Foci, distortion, lateral colour and illumination over the field, and foci over the zones of the stop."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfmesh.analysis.quadrature import integral
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.scene.first_order.paraxial import Paraxial
from lfmesh.transport.sequences.ray_tables import follow_sequence
from lfmesh.transport.sequences.sequences import image_path
from lfmesh.transport.trace import at_wavelength
from lfmesh.waves.bundle import LensRays, pupil_grid

Array = NDArray[np.float64]

POINTS = 21
"""Points per curve."""

CLOSE = 1e-3
"""Distance from the chief ray of the rays that locate its foci, in stop radii."""

RISE = 1e-3
"""Finite-difference step for the local image scale, as a fraction of the largest field."""

BEAM, WIDER, WIDENINGS = 16, 1.25, 16
"""Rays across the stop's diameter that first locate a beam, the factor by which the circle round it is widened until no
light crosses it, and the largest number of widenings. The light is integrated inside the circle."""

ALL_ROUND = np.linspace(0.0, 2.0 * np.pi, 256, endpoint=False)
"""Azimuths on this circle: about as many as the integral has cells round it, so that no light slips between them."""


@dataclass(frozen=True)
class FieldCurves:
    """Curves over the field, from the axis to its edge, (m,) each; NaN where the lens blocks the rays.

    Attributes
    ----------
    height_mm : (m,) float64
        Paraxial image height at the primary wavelength, the field's name.
    slope_y : (m,) float64
        Slope of the object points.
    chief_mm : (wavelengths, m) float64
        Image heights of the chief rays.
    tangential_mm, sagittal_mm : (wavelengths, m) float64
        Foci of rays close to the chief ray, along z from the image plane; positive behind it.
    distortion : (m,) float64
        (y − y₀) / y₀ of the primary chief ray, with y₀ the paraxial height; 0 on the axis.
    illumination : (m,) float64
        Relative illumination of a Lambertian plane at the primary wavelength, with Fresnel losses, vignetting and the
        local image scale. 0 where no light passes, even without a chief ray.
    """

    height_mm: Array
    slope_y: Array
    chief_mm: Array
    tangential_mm: Array
    sagittal_mm: Array
    distortion: Array
    illumination: Array

    @property
    def lateral_mm(self) -> Array:
        """(wavelengths, m): heights of the chief rays relative to the primary (middle) wavelength's."""
        return np.asarray(self.chief_mm - self.chief_mm[len(self.chief_mm) // 2])


def paraxial_scale(rays: LensRays, wavelength_nm: float) -> float:
    """Return the paraxial image height of the chief ray of an object point with a slope of one, mm."""
    camera = solved_camera(rays.world.scene)
    lens = Paraxial.of(camera.scene.camera.lens, wavelength_nm)
    return lens.chief_scale_mm(rays.object_mm, rays.image_z_mm - lens.length_mm)


def field_curves(rays: LensRays, wavelengths_nm: tuple[float, ...], height_mm: float) -> FieldCurves:
    """Trace the curves of a lens up to a paraxial image height.

    Parameters
    ----------
    rays : LensRays
    wavelengths_nm : tuple of float
        The primary one in the middle.
    height_mm : float
        Above 0.
    """
    primary = wavelengths_nm[len(wavelengths_nm) // 2]
    scale = paraxial_scale(rays, primary)
    heights = np.linspace(0.0, height_mm, POINTS)
    # If the lens inverts, objects below the axis have images above it.
    slopes = heights / scale
    chief, tangential, sagittal = (np.full((len(wavelengths_nm), POINTS), np.nan) for _ in range(3))
    cross = CLOSE * np.array([[0.0, 0.0], [0.0, 1.0], [0.0, -1.0], [1.0, 0.0], [-1.0, 0.0]])
    for w, wavelength in enumerate(wavelengths_nm):
        for i, slope in enumerate(slopes):
            five = rays.bundle(float(slope), cross, wavelength)
            chief[w, i] = five.place[0, 1]
            steep = five.direction[:, :2] / five.direction[:, 2:]
            with np.errstate(divide="ignore", invalid="ignore"):
                tangential[w, i] = -(five.place[1, 1] - five.place[2, 1]) / (steep[1, 1] - steep[2, 1])
                sagittal[w, i] = -(five.place[3, 0] - five.place[4, 0]) / (steep[3, 0] - steep[4, 0])
    seen = chief[len(wavelengths_nm) // 2]
    distortion = np.divide(seen - heights, heights, out=np.zeros(POINTS), where=heights > 0.0)
    return FieldCurves(heights, slopes, chief, tangential, sagittal, distortion, _illumination(rays, primary, slopes))


def _illumination(rays: LensRays, wavelength_nm: float, slopes: Array) -> Array:
    """Return the relative illumination of the image of a Lambertian plane."""
    power = np.array([_collected(rays, wavelength_nm, float(slope)) for slope in slopes])
    # The image scale follows from the chief rays, even where an aperture stops them.
    step = RISE * float(slopes[-1])
    below, chief_mm, above = (
        np.array([rays.chief(float(slope), wavelength_nm).place[1] for slope in slopes + move])
        for move in (-step, 0.0, step)
    )
    along = (above - below) / (2.0 * step)
    around = np.divide(chief_mm, slopes, out=np.full(len(slopes), along[0]), where=slopes != 0.0)
    if rays.object_mm == np.inf:
        # Solid angle is cos³ times the area in slopes.
        power = power * (1.0 + slopes**2) ** -1.5
    level = np.divide(power, np.abs(along * around), out=np.zeros(len(power)), where=power > 0.0)
    return np.asarray(level / level[0])


def _collected(rays: LensRays, wavelength_nm: float, slope_y: float) -> float:
    """Return the light of a piece of a Lambertian plane that passes the lens, in arbitrary units.

    The integral covers a circle round all rays through the rim of the stop, widened by `WIDER`. Only crossed rays could
    pass outside it; `LensRays.bundle` refuses fields where these pass and a caustic ends others.
    """
    tables = at_wavelength(rays.world, wavelength_nm)
    path, slope = image_path(len(tables.lens.surfaces)), np.array([0.0, slope_y])
    # Only rays that reach the stop can pass.
    entries = rays.bundle(slope_y, pupil_grid(BEAM, rim=True), wavelength_nm).entry
    entries = entries[np.isfinite(entries).all(axis=1)]
    if not len(entries):
        # All of these end at an edge: search the whole front for light between them.
        entries = rays.aim.trials()
    middle = 0.5 * (entries.min(axis=0) + entries.max(axis=0))
    radius = max(float(np.hypot(*(entries - middle).T).max()), rays.stop_radius / BEAM)
    rim = np.column_stack([np.cos(ALL_ROUND), np.sin(ALL_ROUND)])

    def irradiance(off: Array) -> Array:
        start, ahead = rays.starts(np.broadcast_to(slope, off.shape), middle + off)
        cosine = ahead[:, 2] if rays.object_mm == np.inf else ahead[:, 2] ** 4
        arrived = follow_sequence(tables, path, start, ahead)
        # Negative values name the edge where rays end, so that the integral searches between two edges for narrow
        # light.
        return np.where(arrived.weight > 0.0, arrived.weight * cosine, -1.0 - arrived.way)

    for _ in range(WIDENINGS):
        radius *= WIDER
        if not (irradiance(radius * rim) > 0.0).any():
            break
    return integral(irradiance, radius).value


def zone_foci(rays: LensRays, wavelengths_nm: tuple[float, ...], zones: Array) -> Array:
    """Return the foci of axial rays through zones of the stop, from the image plane, mm.

    These are the longitudinal spherical aberration and the axial colour.

    Parameters
    ----------
    rays : LensRays
    wavelengths_nm : tuple of float
    zones : (m,) float64
        Heights in the stop, in units of its radius, above 0.

    Returns
    -------
    (wavelengths, m) float64
        NaN where blocked; inf where the ray leaves parallel to the axis.
    """
    pupil = np.column_stack([np.zeros(len(zones)), zones])
    found = []
    for wavelength in wavelengths_nm:
        bundle = rays.bundle(0.0, pupil, wavelength)
        with np.errstate(divide="ignore", invalid="ignore"):
            found.append(-bundle.place[:, 1] * bundle.direction[:, 2] / bundle.direction[:, 1])
    return np.array(found)
