"""Lenslets in the first-order report: distance to the sensor, micro-images, and sections."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

from lfmesh.scene.camera.camera import Camera
from lfmesh.scene.camera.lenslet_optics import LensletOptics, astigmatism_per_mm, lenslet_optics, sections
from lfmesh.scene.first_order.cover import cover_shift_mm
from lfmesh.scene.first_order.paraxial import Paraxial, quotient
from lfmesh.scene.first_order.solve import rear_principal_mm

LONGEST_LINE = 0.25
"""Line over the pitch of the lenslets up to which it counts as a point with some astigmatism."""


@dataclass(frozen=True)
class LensletSection:
    """First lenslet type in one section through the axis."""

    section: str
    """"x": the x–z section, "y": the y–z section; "": every section, for lenslets of revolution."""
    focal_length_mm: float
    """Focal length of both faces of the plate, in the image medium; inf without power."""
    focus_behind_mm: float
    """Distance of the focus of collimated light behind the array's face towards the sensor."""
    f_number: float | None
    """Reduced distance from the sensor over the pitch in this section; None without power."""
    micro_image_pitch_px: float | None
    """As in the report, for this section; None without a micro-image."""
    micro_image_diameter_px: float | None


def lenslet_to_sensor_mm(camera: Camera, wavelength_nm: float, at: LensletOptics | None = None) -> float:
    """Return the apparent distance from a lenslet's rear principal plane to the sensor of a solved camera.

    The rear principal plane of a plano-convex lenslet lies t/n inside its flat face if light leaves there, else at the
    apex. For two curved faces see `lenslet_optics`. The distance is in the image medium, as if it filled the cover too.

    Parameters
    ----------
    camera : Camera
    wavelength_nm : float
    at : LensletOptics, optional
        A lenslet type, or a section through it. Default: the first type.
    """
    if camera.mla is None or camera.sensor.distance_mm is None:
        return math.nan
    inside = rear_principal_mm(camera, wavelength_nm) if at is None else at.rear_principal_mm
    return camera.sensor.distance_mm - cover_shift_mm(camera, wavelength_nm) + inside


def line_share(camera: Camera, wavelength_nm: float) -> float:
    """Return the length of the line that a point of the pupil becomes by astigmatic lenslets, over their pitch.

    In focus in one section, the point is as long in the other as the pitch times the difference of the powers times the
    distance from the sensor. Glass cylinders, phases and gradients count alike.

    Parameters
    ----------
    camera : Camera
        Solved; 0 without an array.
    wavelength_nm : float
    """
    if camera.mla is None:
        return 0.0
    difference = astigmatism_per_mm(camera, wavelength_nm)
    return difference * abs(lenslet_to_sensor_mm(camera, wavelength_nm)) if difference else 0.0


def are_cylinders(camera: Camera, wavelength_nm: float) -> bool:
    """Return whether the lenslets act as cylinders, which make lines longer than `LONGEST_LINE` of their pitch.

    Parameters
    ----------
    camera : Camera
        Solved; False without an array.
    wavelength_nm : float
    """
    return not line_share(camera, wavelength_nm) <= LONGEST_LINE


def micro_image(
    camera: Camera, wavelength_nm: float, per_pupil: float, ratio: float
) -> tuple[float, float, float] | None:
    """Return the microlens f-number, and the pitch and diameter of micro-images in pixels.

    Parameters
    ----------
    camera : Camera
        Solved.
    wavelength_nm : float
    per_pupil : float, 1/mm
        1 over the distance from the exit pupil to the lenslets; 0 for a telecentric lens.
    ratio : float
        Distance from the exit pupil to the lenslets over its diameter.
    """
    if camera.mla is None:
        return None
    pitch, pixel = camera.mla.pitch_mm, camera.sensor.pixel_mm
    to_sensor = lenslet_to_sensor_mm(camera, wavelength_nm)
    return (
        abs(to_sensor) / camera.image_index(wavelength_nm) / pitch,
        pitch / pixel * (1 + to_sensor * per_pupil),
        quotient(abs(to_sensor), ratio) / pixel,
    )


def lenslet_sections(
    camera: Camera, wavelength_nm: float, lens: Paraxial, ratio: float | None
) -> Iterator[LensletSection]:  # fmt: skip
    """Yield the lenslets section by section, if they are cylinders, on both faces, or have a phase or gradient.

    Parameters
    ----------
    camera : Camera
        Solved.
    wavelength_nm : float
    lens : Paraxial
        The camera's lens at this wavelength.
    ratio : float or None
        Distance from the exit pupil to the lenslets over its diameter. None: they make no micro-images.
    """
    mla, sensor = camera.mla, camera.sensor
    if mla is None or not (len(sections(mla)) > 1 or mla.both_faces_act):
        return
    for section in sections(mla):
        at = lenslet_optics(camera, wavelength_nm, section=section)
        number = pitch = diameter = None
        if at.power_per_mm != 0.0 and ratio is not None:
            inside = lenslet_to_sensor_mm(camera, wavelength_nm, at)
            height = lens.chief_height_mm((mla.distance_mm or math.nan) + at.front_principal_mm)
            apart = mla.pitch_mm if section == "x" else mla.row_pitch_mm
            pitch = apart / sensor.pixel_mm * (1 + quotient(inside / lens.image_index * lens.from_stop.d, height))
            diameter = quotient(abs(inside), ratio) / sensor.pixel_mm
            number = abs(inside) / lens.image_index / apart
        name = section if len(sections(mla)) > 1 else ""
        yield LensletSection(name, at.focal_length_mm, at.focus_behind_mm, number, pitch, diameter)
