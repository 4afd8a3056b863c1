"""Gradient-index rods that image a plane before them onto the sensor: a single one, or an array with upright images.

With the paraxial matrix (A, B, C, D) of a rod on height and reduced angle, and the reduced distance s from the rod to
the sensor, the magnification is m = A + C s, and the plane lies (B + D s) / −m before the rod, as a reduced distance.
Lenslets that form no image within themselves have m > 0 only for planes behind them. Arrays with m < 0 are focused
plenoptic cameras.

The rod at x_r images the point X onto x_r + m (X − x_r). The images of all rods join if m = 1; otherwise those of
neighbours a pitch p apart lie |1 − m| p apart.

Light stays inside a rod if its amplitude, y² + (u/q)² at any height y and reduced angle u, is at most half a pitch
squared, where q is the sine of the widest guided cone over half a pitch.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from lfmesh.scene.camera.camera import Camera
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.camera.lenslet_optics import gradient_matrices
from lfmesh.scene.camera.mla import MicrolensArray
from lfmesh.scene.first_order.cover import cover_shift_mm
from lfmesh.scene.first_order.paraxial import Matrix, quotient

FOCUSED_BLUR_PX = 1.0
"""Blur of a distant pupil's image above which lenslets are taken to image the main image instead."""


class Relay(NamedTuple):
    """Imaging by every lenslet of an array.

    Attributes
    ----------
    magnification : float
        Positive; for a single lenslet also negative.
    before_mm : float
        Distance of the imaged plane before the array's face towards the lens.
    f_number : float
        1 / (2 n' sin θ') of the widest cone that a rod guides to the sensor; 0 if it guides none.
    lenslet_f_number : float
        1 / (2 n' u) of the cone from a point of the plane, on a rod's axis, through this rod alone.
    reach_mm : float
        Distance on the sensor from a rod's axis to the edge of the image by this rod.
    """

    magnification: float
    before_mm: float
    f_number: float
    lenslet_f_number: float
    reach_mm: float

    def spread_mm(self, mla: MicrolensArray) -> float:
        """Return the largest distance on the sensor between images of one point; 0 for a single rod or m = 1."""
        between = max(size - pitch for size, pitch in zip(mla.size_mm, _pitches_mm(mla), strict=True))
        return abs(1.0 - self.magnification) * min(2.0 * self.reach_mm / abs(self.magnification), between)

    def joins(self, camera: Camera) -> bool:
        """Tell whether the images of all rods coincide to a pixel."""
        return camera.mla is not None and self.spread_mm(camera.mla) <= camera.sensor.pixel_mm


def conjugate(camera: Camera, wavelength_nm: float) -> tuple[float, float] | None:
    """Return the magnification onto the sensor by gradient-index lenslets, and the distance of the plane before them.

    None for other cameras, and if the sensor's distance is not known. The distance is negative for a plane behind the
    array's face towards the lens, and inf if the sensor lies in the focal plane.

    Parameters
    ----------
    camera : Camera
    wavelength_nm : float
    """
    mla, distance = camera.mla, camera.sensor.distance_mm
    if mla is None or mla.gradient is None or distance is None:
        return None
    front, plate, back = gradient_matrices(camera, wavelength_nm)
    whole, outside = front.then(plate).then(back), camera.image_index(wavelength_nm)
    behind = (distance - cover_shift_mm(camera, wavelength_nm)) / outside
    magnification = whole.a + whole.c * behind
    return magnification, outside * quotient(-(whole.b + whole.d * behind), magnification)


def relay_of(camera: Camera, wavelength_nm: float) -> Relay | None:
    """Return the imaging by a camera's array; None if that does not image a real plane, or inverts it in several parts.

    Parameters
    ----------
    camera : Camera
        With radii of its lenslets; the array's distance need not be known.
    wavelength_nm : float
    """
    imaged, mla = conjugate(camera, wavelength_nm), camera.mla
    if imaged is None or mla is None or mla.gradient is None:
        return None
    magnification, before = imaged
    # With less, the lenslets image a pupil far away.
    least = FOCUSED_BLUR_PX * camera.sensor.pixel_mm / mla.pitch_mm
    single = mla.count[0] * mla.count[1] == 1
    if not ((abs(magnification) if single else magnification) > min(least, 0.5) and 0.0 < before < math.inf):
        return None
    outside, sine = camera.image_index(wavelength_nm), _guided_sine(mla.gradient, mla.pitch_mm, wavelength_nm)
    behind = (camera.sensor.distance_mm or math.nan) - cover_shift_mm(camera, wavelength_nm)
    matrices = gradient_matrices(camera, wavelength_nm)
    cone, reach = _extent(matrices, (before / outside, behind / outside), 0.5 * mla.pitch_mm, sine)
    return Relay(magnification, before, 0.5 / sine if sine else 0.0, quotient(0.5, cone), reach)


def _extent(
    matrices: tuple[Matrix, Matrix, Matrix], reduced_mm: tuple[float, float], half_mm: float, sine: float
) -> tuple[float, float]:
    """Return the reduced angle of the widest ray from the axis through a rod, and the reach of the image in mm.

    Parameters
    ----------
    matrices : tuple of Matrix
        Of the rod.
    reduced_mm : (float, float)
        Reduced distances of the plane before the rod, and of the sensor behind it.
    half_mm : float
        Half the rod's width.
    sine : float
        Index times sine of the widest guided cone; 0: both faces limit the light.
    """
    front, plate, back = matrices
    before, behind = reduced_mm
    if sine > 0.0:
        q = sine / half_mm
        cone = half_mm / math.hypot(before, (1.0 + front.c * before) / q)
        return cone, half_mm * math.hypot(1.0 + back.c * behind, behind * q)
    whole = front.then(plate).then(back)
    cone = half_mm / max(before, abs(whole.a * before + whole.b))
    reach = abs(1.0 + quotient(behind * whole.d, whole.b)) + abs(quotient(behind, whole.b))
    return cone, half_mm * reach


@lru_cache(maxsize=64)
def _guided_sine(gradient: Gradient, pitch_mm: float, wavelength_nm: float) -> float:
    """Return index times sine of the widest cone that a rod guides, sqrt(n² − n²(p/2)) with n on its axis, or 0."""
    from lfmesh.optics.gradients import fields_at, gradient_table

    table = gradient_table([gradient.profile(wavelength_nm)])
    axis, side = fields_at(table, 0, [[0.0, 0.0, 0.0], [0.5 * pitch_mm, 0.0, 0.0]])[:, 0]
    return float(np.sqrt(max(axis - side, 0.0)))


def seen_size_mm(camera: Camera, relay: Relay | None) -> tuple[float, float]:
    """Return width and height that array and sensor see of the plane that the lens focuses on.

    Parameters
    ----------
    camera : Camera
    relay : Relay or None
        Of this camera.
    """
    mla, (width, height) = camera.mla, camera.sensor.size_mm
    if mla is None:
        return width, height
    if relay is None:
        return min(width, mla.size_mm[0]), min(height, mla.size_mm[1])
    in_x, in_y = _pitches_mm(mla)
    return _relayed_mm(relay, width, mla.size_mm[0] - in_x), _relayed_mm(relay, height, mla.size_mm[1] - in_y)


def _relayed_mm(relay: Relay, sensor_mm: float, between_mm: float) -> float:
    """Return the size that rods with outermost axes `between_mm` apart see of their plane, on a sensor of a given size.

    A pixel at x sees X = x_r + (x − x_r)/m through the rod at x_r, if that reaches x. X is linear in both, so the
    largest X belongs to the outermost pixel for m < 1, and to the outermost rod for m > 1. A single rod sees the
    sensor's size over m.
    """
    half, outermost = 0.5 * sensor_mm, 0.5 * between_mm
    if relay.magnification <= 1.0:
        pixel = min(half, outermost + relay.reach_mm)
        rod = max(-outermost, pixel - relay.reach_mm)
    else:
        rod = min(outermost, half + relay.reach_mm)
        pixel = min(half, rod + relay.reach_mm)
    return 2.0 * abs(rod + (pixel - rod) / relay.magnification)


def _pitches_mm(mla: MicrolensArray) -> tuple[float, float]:
    return mla.pitch_mm, mla.row_pitch_mm
