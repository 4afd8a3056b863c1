"""Foci, distortion, lateral colour and illumination of a lens over its field, and its foci over its zones."""

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
"""Of each curve."""

CLOSE = 1e-3
"""Of the stop's radius: distance from the chief ray of the rays that its foci are found by."""

RISE = 1e-3
"""Of the largest field: step by which the scale of the image is found, from chief rays on both sides of a field."""

BEAM, WIDER, WIDENINGS = 16, 1.25, 16
"""Rays on a diameter of the stop that the extent of a beam is first found by, and by how much more is looked at, until
no light comes through the circle round it. Within it the light itself is integrated, up to the edges that end it."""

ALL_ROUND = np.linspace(0.0, 2.0 * np.pi, 256, endpoint=False)
"""Azimuths on this circle: about as many as the integral has cells round it, which light must not slip between."""


@dataclass(frozen=True)
class FieldCurves:
    """Curves over the field, from the axis to its edge, (m,) each; NaN where the lens stops the rays.

    Attributes
    ----------
    height_mm : (m,) float64
        Paraxial image height of the primary wavelength, which fields are named by.
    slope_y : (m,) float64
        Of the object points.
    chief_mm : (wavelengths, m) float64
        Where the chief rays meet the image plane.
    tangential_mm, sagittal_mm : (wavelengths, m) float64
        Foci of rays close round the chief ray, along z, from the image plane; positive behind it.
    distortion : (m,) float64
        (y − y₀) / y₀ of the primary wavelength's chief ray, y₀ the paraxial height; 0 on the axis.
    illumination : (m,) float64
        Of a Lambertian plane, relative to the axis, primary wavelength; Fresnel's losses, vignetting and the change of
        scale over the field included. 0 where no light passes, also if there is no chief ray.
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
        """(wavelengths, m): chief rays relative to the primary wavelength's, which is the middle one."""
        return np.asarray(self.chief_mm - self.chief_mm[len(self.chief_mm) // 2])


def paraxial_scale(rays: LensRays, wavelength_nm: float) -> float:
    """Return the paraxial height on the image plane of the chief ray of an object point with a slope of one, mm."""
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
    # Objects below the axis have their images above it where the lens inverts.
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
    """Return the irradiance of the image of a Lambertian plane, relative to the axis."""
    power = np.array([_collected(rays, wavelength_nm, float(slope)) for slope in slopes])
    # The scale of the image is that of chief rays, which apertures may stop while others pass.
    step = RISE * float(slopes[-1])
    below, chief_mm, above = (
        np.array([rays.chief(float(slope), wavelength_nm).place[1] for slope in slopes + move])
        for move in (-step, 0.0, step)
    )
    along = (above - below) / (2.0 * step)
    around = np.divide(chief_mm, slopes, out=np.full(len(slopes), along[0]), where=slopes != 0.0)
    if rays.object_mm == np.inf:
        # A solid angle of directions is cos³ times the area that it has in slopes.
        power = power * (1.0 + slopes**2) ** -1.5
    level = np.divide(power, np.abs(along * around), out=np.zeros(len(power)), where=power > 0.0)
    return np.asarray(level / level[0])


def _collected(rays: LensRays, wavelength_nm: float, slope_y: float) -> float:
    """Return the light of a piece of a Lambertian plane that the lens passes, in arbitrary units.

    It is integrated inside a circle that holds the rays through the rim of the stop, with a margin of `WIDER`. Beyond
    them rays come to the stop only if they have crossed; `LensRays.bundle` refuses fields in which a caustic ends rays
    and others that have crossed pass.
    """
    tables = at_wavelength(rays.world, wavelength_nm)
    path, slope = image_path(len(tables.lens.surfaces)), np.array([0.0, slope_y])
    # Only what comes to the stop can pass.
    entries = rays.bundle(slope_y, pupil_grid(BEAM, rim=True), wavelength_nm).entry
    entries = entries[np.isfinite(entries).all(axis=1)]
    if not len(entries):
        # An edge ends each of these; what passes between them is sought across the whole front.
        entries = rays.aim.trials()
    middle = 0.5 * (entries.min(axis=0) + entries.max(axis=0))
    radius = max(float(np.hypot(*(entries - middle).T).max()), rays.stop_radius / BEAM)
    rim = np.column_stack([np.cos(ALL_ROUND), np.sin(ALL_ROUND)])

    def irradiance(off: Array) -> Array:
        start, ahead = rays.starts(np.broadcast_to(slope, off.shape), middle + off)
        cosine = ahead[:, 2] if rays.object_mm == np.inf else ahead[:, 2] ** 4
        arrived = follow_sequence(tables, path, start, ahead)
        # Darkness tells on which edge rays end: light between two edges, too narrow for the cells, is sought there.
        return np.where(arrived.weight > 0.0, arrived.weight * cosine, -1.0 - arrived.way)

    for _ in range(WIDENINGS):
        radius *= WIDER
        if not (irradiance(radius * rim) > 0.0).any():
            break
    return integral(irradiance, radius).value


def zone_foci(rays: LensRays, wavelengths_nm: tuple[float, ...], zones: Array) -> Array:
    """Return where rays from the axis through zones of the stop cross the axis, from the image plane, mm.

    Longitudinal spherical aberration, and axial colour.

    Parameters
    ----------
    rays : LensRays
    wavelengths_nm : tuple of float
    zones : (m,) float64
        Heights in the stop, in units of its radius, above 0.

    Returns
    -------
    (wavelengths, m) float64
        NaN where the lens stops the ray; inf where it leaves parallel to the axis.
    """
    pupil = np.column_stack([np.zeros(len(zones)), zones])
    found = []
    for wavelength in wavelengths_nm:
        bundle = rays.bundle(0.0, pupil, wavelength)
        with np.errstate(divide="ignore", invalid="ignore"):
            found.append(-bundle.place[:, 1] * bundle.direction[:, 2] / bundle.direction[:, 1])
    return np.array(found)
