"""First-order optics of a lenslet with both faces of its plate: focal length and principal points in each section.

The faces towards the lens and the sensor have the powers φ₁ and φ₂, the plate the reduced thickness t/n. Then (for
instance Hecht, Optics, section 6.1) the power is φ = φ₁ + φ₂ − φ₁ φ₂ t/n. The front principal point lies φ₂/φ · t/n
behind the first face, the rear one φ₁/φ · t/n before the second, as in the medium outside. A cylinder has power in one
section only. Only ratios of indices count: n is the plate's index over that of the medium between lens and sensor. The
phase of a face adds its power, over the index of that medium. A plate with a gradient has the paraxial matrix of its
gap in place of t/n.
"""

import math
from typing import Literal, NamedTuple

from lfmesh.scene.camera.camera import Camera
from lfmesh.scene.camera.mla import MicrolensArray
from lfmesh.scene.first_order.paraxial import Matrix, gradient_gap, quotient


class LensletOptics(NamedTuple):
    """One section of a lenslet, as in the medium outside its plate.

    Attributes
    ----------
    power_per_mm : float
        1 / focal length in that medium; 0 if it does not focus in this section.
    front_principal_mm : float
        Distance from the face towards the lens to the front principal point, positive towards the sensor.
    rear_principal_mm : float
        Distance from the rear principal point to the face towards the sensor.
    """

    power_per_mm: float
    front_principal_mm: float
    rear_principal_mm: float

    @property
    def focal_length_mm(self) -> float:
        """Focal length; inf without power."""
        return quotient(1.0, self.power_per_mm)

    @property
    def focus_behind_mm(self) -> float:
        """Distance of the rear focal point behind the face towards the sensor."""
        return self.focal_length_mm - self.rear_principal_mm


def lenslet_optics(camera: Camera, wavelength_nm: float, kind: int = 0, section: str | None = None) -> LensletOptics:
    """Return the first-order optics of a lenslet type of a camera's array.

    Parameters
    ----------
    camera : Camera
        Its array has radii.
    wavelength_nm : float
    kind : int
        Lenslet type.
    section : str, optional
        "x" or "y". Default: `main_section`.
    """
    mla = camera.mla
    assert mla is not None
    section = section or main_section(camera, wavelength_nm)
    if mla.gradient is not None:
        return _through_gradient(camera, wavelength_nm, kind, section)
    n = camera.relative_index(mla.medium, wavelength_nm)
    assert mla.radius_mm is not None
    main = 0.0 if mla.cylinder_axis == section else (n - 1) / mla.radius_mm[kind]
    other = 0.0
    if mla.back is not None and mla.back.cylinder_axis != section and not math.isinf(mla.back.radius_mm):
        other = (n - 1) / mla.back.radius_mm
    if mla.phases:
        outside, in_x = camera.image_index(wavelength_nm), section == "x"
        main, other = (
            power if phase is None else power + phase.power_per_mm(wavelength_nm, in_x) / outside
            for power, phase in ((main, mla.curved_phase), (other, mla.flat_phase))
        )
    first, second = (main, other) if mla.curved_side == "lens" else (other, main)
    reduced = mla.thickness_mm / n
    power = first + second - first * second * reduced
    if first == 0.0 or second == 0.0:
        # Exact, and defined even without power.
        front = reduced if second != 0.0 or (first == 0.0 and mla.curved_side == "sensor") else 0.0
        return LensletOptics(power, front, reduced - front)
    return LensletOptics(power, quotient(second * reduced, power), quotient(first * reduced, power))


def _through_gradient(camera: Camera, wavelength_nm: float, kind: int, section: str) -> LensletOptics:
    """Return the first-order optics of a lenslet of gradient-index glass."""
    front, plate, back = gradient_matrices(camera, wavelength_nm, kind, section)
    whole, outside = front.then(plate).then(back), camera.image_index(wavelength_nm)
    power = -whole.c
    if power == 0.0:
        return LensletOptics(0.0, 0.0, whole.b * outside)
    return LensletOptics(power / outside, outside * (1.0 - whole.d) / power, outside * (1.0 - whole.a) / power)


def gradient_matrices(
    camera: Camera, wavelength_nm: float, kind: int = 0, section: str | None = None
) -> tuple[Matrix, Matrix, Matrix]:
    """Return the matrices of a lenslet of gradient-index glass: the face towards the lens, the plate, the other face.

    Parameters
    ----------
    camera : Camera
        Its array has a gradient, and radii.
    wavelength_nm : float
    kind : int
        Lenslet type.
    section : str, optional
        As in `lenslet_optics`.
    """
    mla, outside = camera.mla, camera.image_index(wavelength_nm)
    assert mla is not None
    assert mla.gradient is not None
    section = section or main_section(camera, wavelength_nm)
    own, opposite = (0.0 if mla.cylinder_axis == section else 1.0 / mla.radii_mm[kind]), 0.0
    if mla.back is not None and mla.back.cylinder_axis != section:
        opposite = 1.0 / mla.back.radius_mm
    # Positive where the face bulges out of the plate.
    first, second = (own, opposite) if mla.curved_side == "lens" else (opposite, own)
    within = gradient_gap(mla.gradient, wavelength_nm, mla.thickness_mm, section == "x")
    start = mla.gradient.index_at(wavelength_nm)
    front = Matrix(1.0, 0.0, -(start - outside) * first, 1.0)
    return front, within.matrix, Matrix(1.0, 0.0, -(within.end_index - outside) * second, 1.0)


def main_section(camera: Camera, wavelength_nm: float) -> Literal["x", "y"]:
    """Return the section with the power of the curved face, or with phases the larger power of the whole lenslet.

    Parameters
    ----------
    camera : Camera
        Its array has radii.
    wavelength_nm : float
    """
    mla = camera.mla
    assert mla is not None
    if not mla.phases:
        return mla.main_section
    in_x, in_y = (abs(lenslet_optics(camera, wavelength_nm, section=each).power_per_mm) for each in ("x", "y"))
    return "y" if in_y > in_x else "x"


def astigmatism_per_mm(camera: Camera, wavelength_nm: float) -> float:
    """Return the largest difference of a lenslet's power between two sections at right angles, over all types.

    It is that of the principal sections, which a phase may turn from x and y: √((φx − φy)² + 4 φxy²).

    Parameters
    ----------
    camera : Camera
        Its array has radii.
    wavelength_nm : float
    """
    mla = camera.mla
    assert mla is not None
    outside = camera.image_index(wavelength_nm)
    mixed = sum(
        phase.path_per_rad_mm(wavelength_nm) * phase.curvature_rad_mm2[1] / outside for phase in mla.phases.values()
    )
    differences = []
    for kind in range(mla.types):
        in_x, in_y = (lenslet_optics(camera, wavelength_nm, kind, each).power_per_mm for each in ("x", "y"))
        differences.append(math.hypot(in_x - in_y, 2.0 * mixed))
    return max(differences)


def sections(mla: MicrolensArray) -> tuple[str, ...]:
    """Return the distinct sections of an array's lenslets: "x" and "y" if their power differs, else only "x"."""
    differ = mla.cylinder_axis is not None or (mla.back is not None and mla.back.cylinder_axis is not None)
    for phase in mla.phases.values():
        in_x, _, in_y = phase.curvature_rad_mm2
        differ = differ or in_x != in_y
    if mla.gradient is not None:
        in_x, in_y = mla.gradient.curvatures
        differ = differ or in_x != in_y
    return ("x", "y") if differ else ("x",)
