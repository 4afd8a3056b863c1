"""The focused plenoptic camera (2.0) by first-order optics: planes in focus, virtual depth, covering, resolution.

Its lenslets do not image the pupil onto the sensor, d behind them, but the main lens's image, a before them:
1/a + 1/d = 1/f. In the Keplerian arrangement that image is real and lies before the lenslets; in the Galilean one it
would lie behind them, and a is negative. A lenslet reduces the main image by the virtual depth v = a/d and samples it v
times more coarsely than pixels would (T. Georgiev, A. Lumsdaine, "Focused plenoptic camera and rendering", J.
Electronic Imaging 19 (2010) 021106; C. Perwass, L. Wietzke, "Single lens 3D-camera with extended depth-of-field", Proc.
SPIE 8291 (2012) 829108).

With N pixels per lenslet, a point of virtual depth v' is blurred by N |1/v − 1/v'| pixels; the depth range ends at one
pixel. From the total covering plane on, the light cone of every main image point covers a lenslet of each type.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from lfmesh.scene.camera.camera import Camera
from lfmesh.scene.camera.lenslet_optics import LensletOptics, lenslet_optics
from lfmesh.scene.first_order.conjugates import along_depths
from lfmesh.scene.first_order.lenslets import are_cylinders, lenslet_to_sensor_mm
from lfmesh.scene.first_order.paraxial import Paraxial, quotient
from lfmesh.scene.first_order.relay import FOCUSED_BLUR_PX
from lfmesh.scene.first_order.solve import front_principal_mm

COVERING = {
    ("square", 1): math.sqrt(0.5),
    ("square", 2): 1.0,
    ("square", 3): math.sqrt(50.0) / 6.0,
    ("hexagonal", 1): math.sqrt(1.0 / 3.0),
    ("hexagonal", 2): 1.0,
    ("hexagonal", 3): 1.0,
}
"""Largest distance of a point from the nearest lenslet of a type, in pitches, by layout and number of types."""


@dataclass(frozen=True)
class FocusedLenslets:
    """Lenslets of one type of a focused plenoptic camera."""

    focal_length_mm: float
    to_sensor_mm: float
    """Distance from the lenslet to the sensor, as in the image medium all the way."""
    main_image_mm: float
    """Distance before the lenslets of the plane imaged onto the sensor; negative behind them."""
    virtual_depth: float
    """`main_image_mm` over `to_sensor_mm`, with its sign. Its modulus is the reduction of the image, and the factor by
    which the sampling is coarser than the sensor's."""
    in_focus_mm: float
    """Object distance of the plane in focus."""
    near_mm: float
    """Nearest object distance with a blur of at most one pixel."""
    far_mm: float
    """Farthest such distance; may be inf."""
    covering_depth: float
    """Smallest virtual depth, unsigned, with every point seen by a lenslet of this type."""
    covering_mm: float
    """Object distance of the total covering plane, which has this virtual depth. All farther planes are covered in the
    Keplerian arrangement, all nearer ones in the Galilean. inf if it lies at infinity or beyond."""
    seen_by: float
    """Average number of lenslets of this type that see a point in focus."""
    sampling_mm: float
    """Size of a pixel on the plane in focus, through a lenslet: lateral resolution of rendered pictures."""


Type = TypeVar("Type", LensletOptics, FocusedLenslets)


def focused_lenslets(
    camera: Camera, wavelength_nm: float, lens: Paraxial, cone: float, per_pupil: float
) -> tuple[FocusedLenslets, ...]:
    """Return the lenslet types of a focused plenoptic camera; empty for other cameras.

    The lenslets of the middle focal length define the focus of a multi-focus camera.

    Parameters
    ----------
    camera : Camera
        Solved.
    wavelength_nm : float
    lens : Paraxial
        The camera's lens at this wavelength.
    cone : float
        Diameter of the exit pupil over its distance from the lenslets.
    per_pupil : float, 1/mm
        1 over this distance; 0 for a telecentric lens.
    """
    mla = camera.mla
    if mla is None or are_cylinders(camera, wavelength_nm):
        return ()
    types = [lenslet_optics(camera, wavelength_nm, kind) for kind in range(mla.types)]
    middle = middle_of(types)
    blur = abs(_per_depth(camera, wavelength_nm, middle)) * mla.pitch_mm / camera.sensor.pixel_mm
    if not blur > FOCUSED_BLUR_PX or not lenslet_to_sensor_mm(camera, wavelength_nm, middle) > 0.0:
        return ()
    return tuple(_of_type(camera, wavelength_nm, at, lens, (cone, per_pupil)) for at in types)


def sensor_over_focal_length(camera: Camera, wavelength_nm: float) -> float | None:
    """Return the sensor's distance behind the lenslets over their (middle) focal length, or None.

    None without lenslets and for cylinders.

    Parameters
    ----------
    camera : Camera
        Solved.
    wavelength_nm : float
    """
    mla = camera.mla
    if mla is None or are_cylinders(camera, wavelength_nm):
        return None
    middle = middle_of([lenslet_optics(camera, wavelength_nm, kind) for kind in range(mla.types)])
    return 1.0 + _per_depth(camera, wavelength_nm, middle)


def _per_depth(camera: Camera, wavelength_nm: float, at: LensletOptics) -> float:
    """Return 1/v = d/f − 1; 0 for lenslets that image a pupil at infinity."""
    return lenslet_to_sensor_mm(camera, wavelength_nm, at) * at.power_per_mm - 1.0


def _of_type(
    camera: Camera, wavelength_nm: float, at: LensletOptics, lens: Paraxial, pupil: tuple[float, float]
) -> FocusedLenslets:
    mla, sensor = camera.mla, camera.sensor
    assert mla is not None
    to_sensor, per_depth = lenslet_to_sensor_mm(camera, wavelength_nm, at), _per_depth(camera, wavelength_nm, at)
    plane = (mla.distance_mm or math.nan) + at.front_principal_mm

    depths = along_depths(lens, plane, to_sensor, per_depth)
    main_image = quotient(to_sensor, per_depth)
    focus = lens.object_mm(plane - main_image) if math.isfinite(main_image) else -lens.ffl_mm
    focus = focus if focus > 0.0 else math.inf
    sharp = FOCUSED_BLUR_PX * sensor.pixel_mm / mla.pitch_mm
    # Planes lie farther away as 1/v falls.
    near, far = depths.between_mm(per_depth - sharp, per_depth + sharp)
    # A lenslet sees at most its own pitch of the main image's cone.
    cone = min(pupil[0], mla.pitch_mm / to_sensor)
    apart = 2.0 * COVERING[mla.layout, mla.types] * mla.pitch_mm
    covering = quotient(apart, cone + apart * math.copysign(1.0, per_depth) * pupil[1]) / to_sensor
    covered = depths.object_mm(math.copysign(1.0 / covering, per_depth)) if 0.0 < covering < math.inf else math.nan
    is_farther = (covering * abs(per_depth) > 1.0) == (per_depth > 0.0)
    wide = abs(quotient(to_sensor * cone, per_depth - to_sensor * pupil[1])) / mla.pitch_mm
    cell = mla.row_pitch_mm / mla.pitch_mm
    return FocusedLenslets(
        focal_length_mm=at.focal_length_mm,
        to_sensor_mm=to_sensor,
        main_image_mm=main_image,
        virtual_depth=quotient(1.0, per_depth),
        in_focus_mm=focus,
        near_mm=near,
        far_mm=far,
        covering_depth=covering,
        covering_mm=covered if (covered > focus if is_farther else 0.0 < covered < focus) else math.inf,
        seen_by=math.pi / 4.0 * wide**2 / cell / mla.types,
        # Object size over image size, times the virtual depth.
        sampling_mm=quotient(sensor.pixel_mm, abs(depths.r + depths.s * per_depth)),
    )


def middle_of(types: Sequence[Type]) -> Type:
    """Return the type of the middle focal length, which defines the camera's focus."""
    return sorted(types, key=lambda at: at.focal_length_mm)[len(types) // 2]


def in_focus_distance_mm(
    camera: Camera, wavelength_nm: float, types: Sequence[FocusedLenslets], focus_mm: float
) -> float:
    """Return the `distance_mm` of a focused camera's array that puts a plane in focus.

    Parameters
    ----------
    camera : Camera
        Solved.
    wavelength_nm : float
    types : sequence of FocusedLenslets
        The camera's lenslets; they do not depend on the array's distance.
    focus_mm : float
        Distance of the plane before the first vertex.
    """
    lens = Paraxial.of(camera.lens, wavelength_nm)
    front = front_principal_mm(camera, wavelength_nm) if camera.mla is not None else 0.0
    return lens.image_mm(focus_mm) + middle_of(types).main_image_mm - front
