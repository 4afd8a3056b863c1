"""The focused plenoptic camera (2.0) by first-order optics: planes in focus, virtual depth, covering, resolution.

Its lenslets image the main lens's image, a before them, instead of the lens's pupil onto the sensor, d behind them:
1/a + 1/d = 1/f. In the Keplerian arrangement that image is real and lies before the lenslets; in the Galilean one it
would lie behind them, and a is negative. The virtual depth v = a/d is how often smaller a lenslet images the main
image, and how often more coarsely it is sampled than by pixels (T. Georgiev, A. Lumsdaine, "Focused plenoptic camera
and rendering", J. Electronic Imaging 19 (2010) 021106; C. Perwass, L. Wietzke, "Single lens 3D-camera with extended
depth-of-field", Proc. SPIE 8291 (2012) 829108).

With N pixels a lenslet, the blur of a point of virtual depth v' is N |1/v − 1/v'| pixels wide: the depth range of a
lenslet ends where that is one pixel. A lenslet sees points of the main image up to |v| w/2 from its axis, where w is
the diameter of its micro-image: on the total covering plane and beyond all points are seen by a lenslet of the type.
"""

import math
from dataclasses import dataclass

from lfmesh.scene.camera.camera import Camera
from lfmesh.scene.camera.lenslet_optics import lenslet_optics
from lfmesh.scene.first_order.paraxial import Paraxial, quotient
from lfmesh.scene.first_order.solve import cover_shift_mm

FOCUSED_BLUR_PX = 1.0
"""Lenslets that blur the image of a distant pupil by more image the main image, not the pupil."""

COVERING = {
    ("square", 1): math.sqrt(0.5),
    ("square", 2): 1.0,
    ("square", 3): math.sqrt(50.0) / 6.0,
    ("hexagonal", 1): math.sqrt(1.0 / 3.0),
    ("hexagonal", 2): 1.0,
    ("hexagonal", 3): 1.0,
}
"""Farthest that a point lies from the nearest lenslet of a type, in pitches, by layout and number of types."""


@dataclass(frozen=True)
class FocusedLenslets:
    """Lenslets of one type of a focused plenoptic camera."""

    focal_length_mm: float
    main_image_mm: float
    """How far before the lenslets the plane lies that they image onto the sensor; negative behind them."""
    virtual_depth: float
    """The same over the distance from lenslet to sensor, with its sign. Its modulus is how often smaller a lenslet
    images; lenslets resolve one over it of what the sensor's pixels would."""
    in_focus_mm: float
    """Object distance of that plane."""
    near_mm: float
    """Nearest object distance that they blur by a pixel at most."""
    far_mm: float
    """The farthest one; inf where it reaches infinity."""
    covering_depth: float
    """Virtual depth, without sign, from which on every point is seen by a lenslet of this type."""
    covering_mm: float
    """Object distance of the plane of this virtual depth, the total covering plane. All farther ones are covered in the
    Keplerian arrangement, all nearer ones in the Galilean. inf where it lies at infinity or beyond."""
    seen_by: float
    """Lenslets of this type that see a point in focus, on average."""
    sampling_mm: float
    """Size of a pixel on the plane in focus, through a lenslet: the lateral resolution of rendered pictures."""


def focused_lenslets(camera: Camera, wavelength_nm: float, lens: Paraxial, micro_image_mm: float) -> tuple[
    FocusedLenslets, ...
]:  # fmt: skip
    """Return the lenslets of a focused plenoptic camera by type; nothing of another camera.

    Parameters
    ----------
    camera : Camera
        Solved.
    wavelength_nm : float
    lens : Paraxial
        The camera's, at this wavelength.
    micro_image_mm : float
        Diameter of the micro-images.
    """
    mla, sensor = camera.mla, camera.sensor
    if mla is None or mla.cylinder_axis is not None:
        return ()
    pixels = mla.pitch_mm / sensor.pixel_mm
    wide = min(micro_image_mm / mla.pitch_mm, 1.0)
    found = []
    for kind in range(mla.types):
        at = lenslet_optics(mla, wavelength_nm, kind)
        to_sensor = (sensor.distance_mm or math.nan) - cover_shift_mm(sensor, wavelength_nm) + at.rear_principal_mm
        per_depth = to_sensor * at.power_per_mm - 1.0  # 1/v
        if not pixels * abs(per_depth) > FOCUSED_BLUR_PX or not to_sensor > 0.0:
            return ()
        plane = (mla.distance_mm or math.nan) + at.front_principal_mm

        def object_mm(per_depth: float, plane: float = plane, to_sensor: float = to_sensor) -> float:
            distance = lens.object_mm(plane - to_sensor / per_depth)
            return distance if distance > 0.0 else math.inf

        sharp = FOCUSED_BLUR_PX / pixels
        ends = sorted(object_mm(per_depth + step) for step in (-sharp, sharp))
        covering = quotient(2.0 * COVERING[mla.layout, mla.types], wide)
        main_image = to_sensor / per_depth
        cell = mla.row_pitch_mm / mla.pitch_mm
        found.append(
            FocusedLenslets(
                focal_length_mm=at.focal_length_mm,
                main_image_mm=main_image,
                virtual_depth=1.0 / per_depth,
                in_focus_mm=object_mm(per_depth),
                near_mm=ends[0],
                far_mm=ends[1],
                covering_depth=covering,
                covering_mm=object_mm(math.copysign(1.0 / covering, per_depth)),
                seen_by=math.pi / 4.0 * (wide / per_depth) ** 2 / cell / mla.types,
                sampling_mm=quotient(
                    sensor.pixel_mm / abs(per_depth),
                    abs(lens.magnification(lens.object_mm(plane - main_image))),
                ),
            )
        )
    return tuple(found)


def middle_of(types: tuple[FocusedLenslets, ...]) -> FocusedLenslets:
    """Return the type of the middle focal length, by which a multi-focus camera is said to be in focus."""
    return sorted(types, key=lambda at: at.focal_length_mm)[len(types) // 2]
