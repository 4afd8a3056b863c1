"""Arrays of gradient-index rods that image a plane before them upright onto the sensor, so that their images join.

With the power φ of a rod, and the distance s' from its rear principal plane to the sensor, the magnification is
m = 1 − φ s', and the plane lies −s'/m before the front principal plane. Lenslets that form no image within themselves
have m > 0 only for planes behind them.
"""

import math
from typing import NamedTuple

import numpy as np

from lfmesh.scene.camera.camera import Camera
from lfmesh.scene.camera.lenslet_optics import lenslet_optics
from lfmesh.scene.camera.mla import MicrolensArray
from lfmesh.scene.first_order.cover import cover_shift_mm
from lfmesh.scene.first_order.paraxial import quotient


class Relay(NamedTuple):
    """Upright imaging by every lenslet of an array.

    Attributes
    ----------
    magnification : float
        Positive.
    plane_mm : float
        Distance of the imaged plane behind the last vertex of the lens; negative before it.
    f_number : float
        1 / (2 sin θ') of the widest cone that a rod guides to the sensor; 0 if it guides none.
    """

    magnification: float
    plane_mm: float
    f_number: float


def relay_of(camera: Camera, wavelength_nm: float) -> Relay | None:
    """Return the upright imaging by a solved camera's array; None if that does not image a real plane upright.

    Parameters
    ----------
    camera : Camera
    wavelength_nm : float
    """
    mla, distance = camera.mla, camera.sensor.distance_mm
    if mla is None or mla.gradient is None or distance is None:
        return None
    at = lenslet_optics(camera, wavelength_nm)
    to_sensor = distance - cover_shift_mm(camera, wavelength_nm) + at.rear_principal_mm
    magnification = 1.0 - at.power_per_mm * to_sensor
    before = quotient(-to_sensor, magnification) - at.front_principal_mm
    if not (magnification > 0.0 and 0.0 < before < math.inf):
        return None
    plane = (mla.distance_mm or math.nan) - before
    return Relay(magnification, plane, _f_number(mla, camera.image_index(wavelength_nm), wavelength_nm))


def _f_number(mla: MicrolensArray, outside: float, wavelength_nm: float) -> float:
    """Return the f-number of the cone that a rod guides: sin² θ = n² − n²(p/2), with n on its axis."""
    from lfmesh.optics.gradients import fields_at, gradient_table

    assert mla.gradient is not None
    table = gradient_table([mla.gradient.profile(wavelength_nm)])
    axis, side = fields_at(table, 0, [[0.0, 0.0, 0.0], [0.5 * mla.pitch_mm, 0.0, 0.0]])[:, 0]
    return quotient(0.5 * outside, float(np.sqrt(max(axis - side, 0.0)))) if axis > side else 0.0
