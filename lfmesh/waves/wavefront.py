"""The wavefront in the exit pupil: optical paths of traced rays, against the sphere around the image point.

Optical paths run from the object point (or a plane perpendicular to a parallel bundle) to the reference sphere, and are
compared with the chief ray's. The sphere is centred on the chief ray in the image plane. It passes through the chief
ray in the plane of the exit pupil, as in OpticStudio (in CODE V, on the axis); the radius matters little (W. T.
Welford, Aberrations of Optical Systems, 1986, chapter 7). Paths are relative to air, wavelengths in air.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError, warn_caller
from lfmesh.geometry.index_media import refuse_bending
from lfmesh.geometry.lens.main_order import left_out, lens_phases, with_main_orders
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.notebook import Pictured
from lfmesh.optics.curve import LONGEST_NM, SHORTEST_NM
from lfmesh.scene import Scene
from lfmesh.scene.quantities import LARGEST
from lfmesh.transport.build import build
from lfmesh.transport.trace import check_numbers, check_whole, shown
from lfmesh.waves.bundle import LensRays, Traced, pupil_grid
from lfmesh.waves.zernike import FRINGE_TERMS, fitted

Array = NDArray[np.float64]

FAR = 1e4
"""Radius of the reference sphere for an exit pupil at infinity, over the focal length."""

ACROSS = 64
"""Default number of rays on a diameter of the stop."""

NM_PER_MM = 1e6


@dataclass(frozen=True)
class Wavefront(Pictured):
    """The wavefront of one object point at one wavelength.

    Attributes
    ----------
    wavelength_nm : float
    slope : float
        Height of the object point over its distance from the first vertex; for parallel bundles, tangent of the field
        angle.
    image_mm : (3,) float64
        Centre of the reference sphere: the chief ray in the image plane, camera frame.
    radius_mm : float
        Radius of the reference sphere.
    pupil : (n, 2) float64
        Points of equal area in the stop, in units of its radius.
    opd_waves : (n,) float64
        Optical path of the chief ray less that of each ray; positive if the wavefront is ahead of the sphere.
    weight : (n,) float64
        Transmittance of each ray by Fresnel's equations, coatings included.
    passed : float
        Transmitted fraction of the rays.
    """

    wavelength_nm: float
    slope: float
    image_mm: Array
    radius_mm: float
    pupil: Array
    opd_waves: Array
    weight: Array
    passed: float

    def __repr__(self) -> str:
        return (
            f"<Wavefront: {self.wavelength_nm:g} nm, rms {self.rms_waves:.4g} waves, P-V {self.pv_waves:.4g}, "
            f"Strehl {self.strehl:.4g}>"
        )

    @cached_property
    def rms_waves(self) -> float:
        """Standard deviation of the path difference, weighted by transmittance; tilt is not removed."""
        mean = np.average(self.opd_waves, weights=self.weight)
        return float(np.sqrt(np.average((self.opd_waves - mean) ** 2, weights=self.weight)))

    @property
    def pv_waves(self) -> float:
        """Peak to valley."""
        return float(np.ptp(self.opd_waves))

    @cached_property
    def strehl(self) -> float:
        """Intensity at the sphere's centre over that without aberrations, ``|Σ √w exp(2πi W)|² / (Σ √w)²``."""
        amplitude = np.sqrt(self.weight)
        return float(np.abs(amplitude @ np.exp(2j * np.pi * self.opd_waves)) ** 2 / amplitude.sum() ** 2)

    def zernike(self, terms: int = FRINGE_TERMS, order: Literal["fringe", "noll"] = "fringe") -> Array:
        """Return the coefficients of Zernike polynomials, by least squares over the stop.

        Parameters
        ----------
        terms : int
            Number of terms, piston included; up to 37 for the Fringe order.
        order : {"fringe", "noll"}
            Noll's polynomials are orthonormal; Fringe polynomials are 1 at the rim.

        Returns
        -------
        (terms,) float64
            Waves.

        Raises
        ------
        LfmeshError
            An unknown order, or a number of terms that does not exist or exceeds the number of rays.
        """
        if order not in ("fringe", "noll"):
            raise LfmeshError(f'order = {order!r}: use "fringe" or "noll"')
        most = FRINGE_TERMS if order == "fringe" else len(self.opd_waves)
        check_whole(terms=terms)
        if not 1 <= terms <= min(most, len(self.opd_waves)):
            raise LfmeshError(f"terms = {shown(terms)}: must be from 1 to {min(most, len(self.opd_waves))}")
        return fitted(self.pupil, self.opd_waves, terms, order)


def wavefront(
    scene: Scene,
    height_mm: float = 0.0,
    wavelength_nm: float | None = None,
    *,
    object_mm: float | None = None,
    image_z_mm: float | None = None,
    across: int = ACROSS,
) -> Wavefront:
    """Compute the wavefront of an object point in the exit pupil of a camera's lens.

    At a diffractive face with several orders it is the wavefront of the main order.

    Parameters
    ----------
    scene : Scene
        Its lens is used; array and sensor only define the image plane.
    height_mm : float
        Height of the object point above the axis (y); for an object at infinity, tangent of the field angle.
    wavelength_nm : float, optional
        Default: the scene's primary wavelength.
    object_mm : float, optional
        Distance of the object before the first vertex, or inf (default: the plane in focus).
    image_z_mm : float, optional
        Plane of the reference sphere's centre, from the first vertex (default: the image of the plane in focus).
    across : int
        Rays on a diameter of the stop, from 4 to 1000.

    Returns
    -------
    Wavefront

    Warns
    -----
    DiffractionWarning
        A diffractive face has several orders; the light of all but the main one is missing.

    Raises
    ------
    LfmeshError
        Media that bend light, meshes, ideal lenses beside real ones, rays that do not pass or cross before the stop, or
        a wrong value.
    """
    refuse_bending(scene, "a wavefront is that of the camera alone; omit it")
    camera = solved_camera(scene)
    facts = camera.report
    waves = scene.primary_nm if wavelength_nm is None else wavelength_nm
    distance = facts.object_distance_mm if object_mm is None else object_mm
    image_z = facts.image_z_mm if image_z_mm is None else image_z_mm
    check_whole(across=across)
    check_numbers(height_mm=height_mm, wavelength_nm=waves, object_mm=distance, image_z_mm=image_z)
    if not 4 <= across <= 1000:
        raise LfmeshError(f"across = {shown(across)}: must be from 4 to 1000 rays")
    if not SHORTEST_NM <= waves <= LONGEST_NM:
        raise LfmeshError(f"wavelength_nm = {shown(waves)}: must be from {SHORTEST_NM:g} to {LONGEST_NM:g}")
    for name, value in (("height_mm", height_mm), ("image_z_mm", image_z)):
        if not -LARGEST <= value <= LARGEST:
            raise LfmeshError(f"{name} = {shown(value)}: must be from {-LARGEST:g} to {LARGEST:g}")
    if object_mm is None and distance < 0.0:
        raise LfmeshError(
            f"object_mm: missing, and the plane in focus lies {-distance:.6g} mm behind the first vertex; give it"
        )
    if not 0.0 < distance <= LARGEST and distance != math.inf:
        raise LfmeshError(f"object_mm = {shown(distance)}: must be above 0, up to {LARGEST:g}, or inf")
    rays = LensRays(build(with_main_orders(camera.scene.camera_alone())), distance, image_z)
    slope = float(height_mm) if math.isinf(distance) else float(height_mm) / distance
    found = wavefront_of(rays, slope, waves, across, words=f"height_mm = {height_mm:g}")
    warn_caller(left_out(lens_phases(camera.scene)))
    return found


def wavefront_of(rays: LensRays, slope: float, wavelength_nm: float, across: int = ACROSS, *, words: str) -> Wavefront:
    """Return the wavefront of a field, about a centre in the rays' image plane.

    Parameters
    ----------
    rays : LensRays
    slope : float
        See `LensRays.bundle`.
    wavelength_nm : float
    across : int
        Rays on a diameter of the stop.
    words : str
        Name of the field for messages.

    Raises
    ------
    LfmeshError
        No chief ray, no other ray, rays that cross before the stop, or rays that miss the reference sphere.
    """
    pupil = np.vstack([np.zeros(2), pupil_grid(across)])
    bundle, chief = rays.bundle(slope, pupil, wavelength_nm), rays.chief(slope, wavelength_nm)
    passes = bundle.passes
    if not chief.exists or not passes.any():
        raise LfmeshError(f"{words}: the chief ray of this field is blocked by {bundle.ends.words_of(0)}")
    passes[0] = False
    if not passes.any():
        raise LfmeshError(f"{words}: the lens blocks all rays of this field but the chief ray")
    image = np.array([*chief.place, rays.image_z_mm])
    entry = np.vstack([chief.entry, bundle.entry[passes]])
    opd, radius = path_differences(rays, slope, entry, wavelength_nm, image)
    return Wavefront(
        wavelength_nm, slope, image, radius, pupil[passes], opd[1:], bundle.weight[passes], float(passes[1:].mean()),
    )  # fmt: skip


def path_differences(
    rays: LensRays, slope: float, entry: Array, wavelength_nm: float, centre: Array
) -> tuple[Array, float]:
    """Return the optical path of the first ray less that of each, and the reference sphere's radius.

    Parameters
    ----------
    rays : LensRays
    slope : float
    entry : (n, 2) float64, mm
        Points on the plane of the first vertex; the rays pass the lens. The first is the chief ray.
    wavelength_nm : float
    centre : (3,) float64, mm
        Centre of the reference sphere, camera frame.

    Returns
    -------
    (n,) float64, waves
    float, mm

    Raises
    ------
    LfmeshError
        Rays miss the reference sphere, or ideal lenses stand beside real surfaces.
    """
    traced = rays.traced([0.0, slope], entry, wavelength_nm)
    radius = _sphere_radius_mm(rays, traced, centre)
    _, paths = traced.onto_sphere(centre, radius)
    if not np.isfinite(paths).all():
        pupil_mm = solved_camera(rays.world.scene).report.exit_pupil_z_mm
        raise LfmeshError(
            f"image_z_mm = {centre[2]:g}, object_mm = {rays.object_mm:g}: rays miss the reference sphere, whose radius "
            f"is {abs(radius):.4g} mm; give a plane farther from the exit pupil at {pupil_mm:.6g} mm"
        )
    return np.asarray((paths[0] - paths) * NM_PER_MM / wavelength_nm), abs(radius)


def _sphere_radius_mm(rays: LensRays, traced: Traced, centre: Array) -> float:
    """Return the reference sphere's radius, up to the first ray in the exit pupil; negative if the pupil is behind."""
    facts = solved_camera(rays.world.scene).report
    pupil_z = facts.exit_pupil_z_mm
    if not math.isfinite(pupil_z):
        return FAR * abs(facts.efl_mm)
    position, direction = traced.position[0], traced.direction[0]
    crossing = position + (pupil_z - position[2]) / direction[2] * direction
    return math.copysign(float(np.linalg.norm(centre - crossing)), centre[2] - pupil_z)
