"""Sequential trace through the analytic surfaces, without meshes: the truth for the tracer's errors.

It shares no code with the engine. Rays are transferred by Welford's formulae (Aberrations of Optical Systems, 1986,
chapter 4) and Newton's method for aspheric terms, and by extrapolation in gradient-index glass. They are refracted by
Snell's law in vector form, turned by phases, and weighted by Fresnel's transmittances and the shares of orders. The
difference between float64 and extended precision is the error of the truth itself.

Camera frame throughout: z along the axis from object to sensor, origin at the first vertex, mm.
"""

from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.accuracy.analytic_array import LensletArray, lenslet_array, through_array
from lfmesh.accuracy.analytic_gradients import GradientIndex, Index, index_at, index_behind
from lfmesh.accuracy.analytic_phases import DiffractionOrder, only_order
from lfmesh.accuracy.analytic_rays import (
    NEWTON_STEPS,
    Array,
    Rays,
    conic_transfer,
    into_frame,
    out_of_frame,
    refract,
    turned,
)
from lfmesh.errors import LfmeshError
from lfmesh.optics.glass import refractive_index
from lfmesh.scene import Lens, Scene, solved


@dataclass(frozen=True)
class Interface:
    """One surface of the prescription at one wavelength; a pure stop has the same index on both sides."""

    vertex_z: float
    curvature: float
    conic: float
    asphere: tuple[float, ...]
    aperture: float
    index_before: Index
    index_after: Index
    turn: NDArray[np.float64] | None = None
    """Rotation of a posed element, with `origin` as its shift; None: the surface is as prescribed."""
    origin: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    thin_power: float = 0.0
    """Power of a thin lens in place of an interface, 1/mm."""
    odd: tuple[float, ...] = ()
    """Coefficients of r³, r⁵, ..."""
    order: DiffractionOrder | None = None
    """Order of the surface's phase."""


@dataclass(frozen=True)
class Landing:
    """Rays on the sensor's plane.

    Attributes
    ----------
    position : (n, 2) float, mm
        x and y in the sensor's frame; NaN for a ray that does not arrive.
    weight : (n,) float
        Remaining fraction of the ray's power: the product of Fresnel's transmittances and the shares of orders.
    arrives : (n,) bool
        False if the ray is stopped by an aperture, misses a surface, is totally reflected, or turns evanescent.
    """

    position: Array
    weight: Array
    arrives: NDArray[np.bool_]


@dataclass(frozen=True)
class Camera:
    """The optical path from the first vertex to the sensor, at one wavelength."""

    interfaces: tuple[Interface, ...]
    mla: LensletArray | None
    sensor_turn: NDArray[np.float64]
    sensor_origin: NDArray[np.float64]
    precision: type = field(default=np.float64)

    @classmethod
    def of(cls, scene: Scene, wavelength_nm: float, precision: type = np.float64) -> "Camera":
        """Return the camera of a scene at one wavelength.

        Parameters
        ----------
        scene : Scene
        wavelength_nm : float, nm
        precision : type
            `numpy.float64` or `numpy.longdouble`.

        Raises
        ------
        LfmeshError
            A surface of the lens has no analytic truth: a mesh from a file, a surface not of revolution, or a phase
            from a file or with several orders.
        """
        scene = solved(scene)
        lens, camera = scene.camera.lens, scene.camera
        interfaces = []
        media = lens.media
        before: Index = refractive_index(media[0], wavelength_nm)
        for i, (surface, z) in enumerate(zip(lens.surfaces, lens.vertices_mm, strict=True)):
            if surface.mesh is not None:
                raise LfmeshError(
                    f"camera.lens.surfaces[{i}]: a mesh from a file has no analytic surface to measure its error "
                    "against; give a lens with radii"
                )
            if surface.section_key is not None:
                raise LfmeshError(
                    f"camera.lens.surfaces[{i}].{surface.section_key}: the truth that errors are measured against has "
                    f"{lens.kinds_followed(i)}"
                )
            after = index_behind(media[i + 1], wavelength_nm, z)
            order = only_order(surface.phase, wavelength_nm, media[i], media[i + 1], f"camera.lens.surfaces[{i}].phase")
            interfaces.append(
                Interface(
                    z, surface.curvature_per_mm, surface.vertex_conic, surface.terms_mm,
                    surface.semi_diameter_mm or np.inf, before, after, *_placed(lens, i),
                    surface.thin_lens_power_per_mm, surface.odd_asphere_mm, order,
                )
            )  # fmt: skip
            before = after
        z = lens.vertices_mm[-1]
        mla = None
        if camera.mla is not None:
            z += camera.mla.distance_mm or 0.0
            mla = lenslet_array(scene, z, wavelength_nm)
            z += camera.mla.thickness_mm
        pose = camera.sensor.pose
        origin = np.add([0.0, 0.0, z + (camera.sensor.distance_mm or 0.0)], pose.shift_mm)
        return cls(tuple(interfaces), mla, turned(pose.tilt_deg), origin, precision)

    def land(self, origins: ArrayLike, directions: ArrayLike) -> Landing:
        """Trace rays from object space to the sensor's plane.

        Parameters
        ----------
        origins, directions : (n, 3) float
            Camera frame; rays start in front of the first surface and run towards +z.
        """
        kind = self.precision
        d: Array = np.array(directions, dtype=kind)
        d /= np.sqrt((d * d).sum(axis=1))[:, None]
        rays = Rays(np.array(origins, dtype=kind), d, np.ones(len(d), kind), np.ones(len(d), np.bool_))
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            for interface in self.interfaces:
                _through_surface(rays, interface)
            if self.mla is not None:
                through_array(rays, self.mla)
            p, d = into_frame(rays, self.sensor_turn, self.sensor_origin)
            landed = p[:, :2] - (p[:, 2] / d[:, 2])[:, None] * d[:, :2]
            rays.alive &= (d[:, 2] > 0) & np.isfinite(landed).all(axis=1)
        landed[~rays.alive] = np.nan
        return Landing(landed, np.where(rays.alive, rays.weight, 0), rays.alive)


def own_error(scene: Scene, wavelength_nm: float, origins: ArrayLike, directions: ArrayLike) -> float | None:
    """Return the largest difference between the truth in float64 and in extended precision, mm.

    None if the platform has 64-bit long doubles.

    Parameters
    ----------
    scene : Scene
    wavelength_nm : float, nm
    origins, directions : (n, 3) float64
        See `Camera.land`.
    """
    if np.finfo(np.longdouble).eps >= np.finfo(np.float64).eps:
        return None
    plain = Camera.of(scene, wavelength_nm).land(origins, directions)
    fine = Camera.of(scene, wavelength_nm, np.longdouble).land(origins, directions)
    both = plain.arrives & fine.arrives
    difference = plain.position[both] - fine.position[both]
    shift = np.sqrt((difference * difference).sum(axis=1))
    return float(shift.max(initial=0.0))


def _placed(lens: Lens, number: int) -> tuple[NDArray[np.float64] | None, NDArray[np.float64]]:
    """Return rotation and shifted origin of a surface from its element's pose; the rotation may be None."""
    which = lens.element_of(number)
    if which is None:
        return None, np.zeros(3)
    element = lens.elements[which]
    turn, pivot = turned(element.pose.tilt_deg), np.array([0.0, 0.0, lens.vertices_mm[element.surfaces[0]]])
    return turn, pivot - turn @ pivot + element.pose.shift_mm


def _through_surface(rays: Rays, s: Interface) -> None:
    """Transfer the rays to a surface, stop those outside its aperture, and refract the rest."""
    kind = rays.p.dtype.type
    if s.turn is not None:
        rays.p, rays.d = into_frame(rays, s.turn, s.origin)
    vertex = np.array([0, 0, s.vertex_z], kind)
    if isinstance(s.index_before, GradientIndex):
        start = np.where(rays.alive[:, None], rays.p, kind(np.nan))
        met, rays.d, _ = s.index_before.follow(start, rays.d, partial(_height, s))
        p = met - vertex
    else:
        p = rays.p - vertex
        t = conic_transfer(p, rays.d, kind(s.curvature), kind(s.conic))
        if any(s.asphere) or any(s.odd):
            t = _asphere_transfer(p, rays.d, s, t)
        p = p + t[:, None] * rays.d
    r2 = p[:, 0] ** 2 + p[:, 1] ** 2
    rays.alive &= r2 <= kind(s.aperture) ** 2
    g = 2 * _sag_rate(s, r2)
    normal = np.stack([-g * p[:, 0], -g * p[:, 1], np.ones_like(g)], axis=1)
    rays.p = p + vertex
    if s.order is not None:
        refract(rays, normal, index_at(s.index_before, rays.p), index_at(s.index_after, rays.p), s.order.change(p))
        rays.weight = rays.weight * kind(s.order.share)
    elif s.index_before != s.index_after:
        refract(rays, normal, index_at(s.index_before, rays.p), index_at(s.index_after, rays.p))
    if s.thin_power:
        slopes = rays.d[:, :2] / rays.d[:, 2:] - kind(s.thin_power) * p[:, :2]
        rays.d = np.column_stack([slopes, np.ones_like(r2)]) / np.sqrt(1 + (slopes * slopes).sum(axis=1))[:, None]
    if s.turn is not None:
        rays.p, rays.d = out_of_frame(rays.p, rays.d, s.turn, s.origin)


def _height(s: Interface, p: Array) -> tuple[Array, Array]:
    """Return z minus the sag at points in the frame of the surface's element, and its gradient."""
    r2 = p[:, 0] ** 2 + p[:, 1] ** 2
    steep = -2 * _sag_rate(s, r2)
    above = p[:, 2] - p.dtype.type(s.vertex_z) - _sag(s, r2)
    return above, np.stack([steep * p[:, 0], steep * p[:, 1], np.ones_like(r2)], axis=1)


def _sag(s: Interface, r2: Array) -> Array:
    kind = r2.dtype.type
    c, k = kind(s.curvature), kind(s.conic)
    z = c * r2 / (1 + np.sqrt(1 - (1 + k) * c * c * r2))
    for j, a in enumerate(s.asphere):
        z = z + kind(a) * r2 ** (j + 2)
    for j, b in enumerate(s.odd):
        z = z + kind(b) * np.sqrt(r2) * r2 ** (j + 1)
    return z


def _sag_rate(s: Interface, r2: Array) -> Array:
    """Return d sag / d r²."""
    kind = r2.dtype.type
    c, k = kind(s.curvature), kind(s.conic)
    rate = c / (2 * np.sqrt(1 - (1 + k) * c * c * r2))
    for j, a in enumerate(s.asphere):
        rate = rate + (j + 2) * kind(a) * r2 ** (j + 1)
    for j, b in enumerate(s.odd):
        rate = rate + kind(j + 1.5) * kind(b) * np.sqrt(r2) * r2**j
    return rate


def _asphere_transfer(p: Array, d: Array, s: Interface, t: Array) -> Array:
    """Refine the conic's distance by Newton's method until every ray has settled."""
    for _ in range(NEWTON_STEPS):
        q = p + t[:, None] * d
        r2 = q[:, 0] ** 2 + q[:, 1] ** 2
        rate = d[:, 2] - 2 * _sag_rate(s, r2) * (q[:, 0] * d[:, 0] + q[:, 1] * d[:, 1])
        step = (q[:, 2] - _sag(s, r2)) / rate
        t = t - step
        if not np.any(np.abs(step) > 4 * np.finfo(t.dtype).eps * (1 + np.abs(t))):
            break
    return t
