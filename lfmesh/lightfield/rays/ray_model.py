"""Maps between the shift from view to view and the distance in object space.

`RayModel`, for photographs, is the first-order map, moved to the best focus of a filled aperture. Views near the rim of
the pupil focus elsewhere, so depth uses `TracedShift`, fitted to the rays of its views.

A pixel seen through its lenslet's principal points belongs to one point of the exit pupil and one of the array, the two
planes of a light field. Views a pixel apart are `view_step_mm` apart on the pupil. An object imaged ε behind the array
crosses it, from view to view, by shift = k ε / (1 + ε/D) with k = pixel/d. This is the model of C. Hahne et al.,
"Refocusing distance of a standard plenoptic camera", Opt. Express 24 (2016) 21521; their shift parameter `a` is the
shift in lenslets.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, Protocol, overload

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry.lens.solved_camera import SolvedCamera, solved_camera
from lfmesh.lightfield.rays.chief_rays import refuse_undecodable
from lfmesh.lightfield.rays.lens_alone import focus_shift
from lfmesh.scene import Scene
from lfmesh.scene.first_order.lenslets import lenslet_to_sensor_mm

Array = NDArray[np.float64]

ROUNDS = 10
"""Iterations of successive approximation for the distance of a shift."""

ROUNDING = 2.0**-50
"""Relative difference below which two vergences are equal; their last digits are uncertain."""


class ShiftMap(Protocol):
    """Map between the distance of a plane and its shift on the array from view to view."""

    def shift_mm(self, distance_mm: float) -> float:
        """Return the shift of a point on the array from view to view; positive nearer than the focus.

        Parameters
        ----------
        distance_mm : float
            Of the object plane, before the first vertex.
        """

    @overload
    def distance_mm(self, shift_mm: float) -> float: ...
    @overload
    def distance_mm(self, shift_mm: Array) -> Array: ...
    def distance_mm(self, shift_mm: Any) -> Any:
        """Return the distances before the first vertex for given shifts: the inverse of `shift_mm`.

        Parameters
        ----------
        shift_mm : float, or array of any shape

        Returns
        -------
        float, or array of that shape, mm
            inf at infinity; negative for virtual objects, which lie beyond it.
        """


@dataclass(frozen=True)
class RayModel:
    """A light-field camera by its cardinal points. All z are in the camera frame, with the first vertex as origin.

    Attributes
    ----------
    efl_mm : float
        Focal length of the main lens: 1 over its power.
    front_principal_z_mm, rear_principal_z_mm : float
    array_z_mm : float
        The lenslets' front principal points.
    pupil_to_array_mm : float
        D, from the exit pupil to the lenslets' front principal points; inf for a telecentric lens, negative if the
        pupil lies behind the array.
    lenslet_to_sensor_mm : float
        d, from the lenslets' rear principal points to the sensor, as if the medium around them filled the cover too.
    lenslet_pitch_mm, pixel_mm : float
    f_number : float
        Of the main lens, on the image side, at its focus: 1 / (2 n' u').
    focus_shift_mm, focus_shift_mm2 : float
        Shift of the focus along z by spherical aberration, from an axial point's first-order image to the closest
        approach of the full aperture's rays. The second is divided by the object's distance from the front principal
        plane and added.
    object_index : float
        Refractive index of object space.
    image_index : float
        Refractive index between the lens and the sensor.
    """

    efl_mm: float
    front_principal_z_mm: float
    rear_principal_z_mm: float
    array_z_mm: float
    pupil_to_array_mm: float
    lenslet_to_sensor_mm: float
    lenslet_pitch_mm: float
    pixel_mm: float
    f_number: float
    focus_shift_mm: float = 0.0
    focus_shift_mm2: float = 0.0
    object_index: float = 1.0
    image_index: float = 1.0

    @classmethod
    def of(cls, scene: Scene) -> "RayModel":
        """Read a scene's camera, with the array's z shift and pitch error, and trace its real focus.

        Parameters
        ----------
        scene : Scene

        Returns
        -------
        RayModel

        Raises
        ------
        LfmeshError
            A conventional camera, cylindrical lenslets, an afocal lens, or an exit pupil on the array.
        """
        known = solved_camera(scene)
        scene, facts = known.scene, known.report
        camera, wavelength = scene.camera, scene.primary_nm
        mla = camera.mla
        if mla is None:
            raise LfmeshError("camera.mla is missing: a conventional camera records no light field")
        refuse_undecodable(scene)
        if not math.isfinite(facts.efl_mm):
            raise LfmeshError("camera.lens is afocal: it has no focal length to determine distances")
        array_z = (facts.lenslets_z_mm or 0.0) + mla.pose.shift_mm[2]
        pupil_to_array = array_z - _exit_pupil_z_mm(known)
        if abs(pupil_to_array) <= ROUNDING * abs(array_z):
            raise LfmeshError(
                f"camera.mla.distance_mm = {mla.distance_mm:g}: the exit pupil lies on the array, so no "
                "lenslet forms an image of it; move the array or the stop"
            )
        shift, slope = focus_shift(scene)
        return cls(
            efl_mm=facts.efl_mm,
            front_principal_z_mm=facts.front_principal_plane_z_mm,
            rear_principal_z_mm=facts.rear_principal_plane_z_mm,
            array_z_mm=array_z,
            pupil_to_array_mm=pupil_to_array,
            lenslet_to_sensor_mm=lenslet_to_sensor_mm(camera, wavelength)
            + camera.sensor.pose.shift_mm[2]
            - mla.pose.shift_mm[2],
            lenslet_pitch_mm=mla.pitch_mm * (1.0 + mla.form.pitch_error),
            pixel_mm=camera.sensor.pixel_mm,
            f_number=facts.working_f_number,
            focus_shift_mm=shift,
            focus_shift_mm2=slope,
            object_index=facts.object_index,
            image_index=facts.image_index,
        )

    @property
    def paraxial(self) -> "RayModel":
        """The same camera by first-order optics, without the focus shift by aberrations."""
        return replace(self, focus_shift_mm=0.0, focus_shift_mm2=0.0)

    @property
    def slope_step(self) -> float:
        """Difference in direction, dx/dz, of neighbouring views at a lenslet: k = pixel/d, in rad."""
        return self.pixel_mm / self.lenslet_to_sensor_mm

    @property
    def pupil_slope(self) -> float:
        """Largest direction, dx/dz, of light at a lenslet: half the exit pupil's diameter over its distance, in rad."""
        return 0.5 / (self.image_index * self.f_number)

    @property
    def view_step_mm(self) -> float:
        """Distance of neighbouring views on the exit pupil; inf for a telecentric lens."""
        return self.slope_step * self.pupil_to_array_mm

    @property
    def micro_image_pitch_px(self) -> float:
        """Distance of neighbouring micro-images, (p/pixel)(D + d)/D."""
        return self.lenslet_pitch_mm / self.pixel_mm * (1.0 + self.lenslet_to_sensor_mm / self.pupil_to_array_mm)

    @property
    def refocus_range_mm(self) -> tuple[float, float]:
        """Nearest and farthest object distance that refocuses sharply: a shift of one lenslet between views."""
        near = self.distance_mm(self.lenslet_pitch_mm)
        far = self.distance_mm(-self.lenslet_pitch_mm)
        return near if near > 0.0 else math.inf, far if far > near > 0.0 else math.inf

    @property
    def nearest_mm(self) -> float:
        """Distance of the front focal point before the first vertex; nearer objects have no real image."""
        return self.object_index * self.efl_mm - self.front_principal_z_mm

    def image_excess_mm(self, distance_mm: float) -> float:
        """Return ε, the distance of an object's sharpest image behind the array.

        Parameters
        ----------
        distance_mm : float

        Returns
        -------
        float
            mm, towards the sensor.

        Raises
        ------
        LfmeshError
            The object has no real image, or lies in the front principal plane of a lens with aberrations.
        """
        # With a relay's negative focal length, objects on either side of it may have a real image.
        if not (distance_mm > self.nearest_mm or (self.efl_mm < 0.0 and distance_mm < self.nearest_mm)):
            raise LfmeshError(
                f"distance_mm = {distance_mm:g}: must lie before the front focal point, {self.nearest_mm:.6g} mm in "
                "front of the first vertex"
            )
        from_principal = distance_mm + self.front_principal_z_mm
        vergence = 1.0 / from_principal if from_principal else math.inf
        paraxial = self.image_index / (1.0 / self.efl_mm - self.object_index * vergence)
        if math.isinf(vergence) and self.focus_shift_mm2:
            raise LfmeshError(
                f"distance_mm = {distance_mm:g}: lies in the front principal plane of the lens, where the effect of "
                "aberrations on its image is unknown; give another distance"
            )
        image = paraxial + self.focus_shift_mm + (self.focus_shift_mm2 * vergence if self.focus_shift_mm2 else 0.0)
        return self.rear_principal_z_mm + image - self.array_z_mm

    def shift_mm(self, distance_mm: float) -> float:
        """Return the shift of an object point on the array from view to view; positive nearer than the focus.

        Parameters
        ----------
        distance_mm : float
            Of the point, before the first vertex; may be inf.

        Returns
        -------
        float
            mm.
        """
        excess = self.image_excess_mm(distance_mm)
        return self.slope_step * excess / (1.0 + excess / self.pupil_to_array_mm)

    @overload
    def distance_mm(self, shift_mm: float) -> float: ...
    @overload
    def distance_mm(self, shift_mm: Array) -> Array: ...
    def distance_mm(self, shift_mm: Any) -> Any:
        """Return the distances for given shifts; see `ShiftMap`.

        Parameters
        ----------
        shift_mm : float or array
            On the array, from view to view.

        Returns
        -------
        float or array
            mm before the first vertex.
        """
        shift = np.asarray(shift_mm, dtype=np.float64)
        with np.errstate(divide="ignore", invalid="ignore"):
            excess = shift / (self.slope_step - shift / self.pupil_to_array_mm)
            sharpest = self.array_z_mm - self.rear_principal_z_mm + excess
            vergence = np.zeros_like(shift)
            # The focus shift depends so little on the vergence that every round gains two digits.
            for _ in range(ROUNDS):
                image = sharpest - self.focus_shift_mm - self.focus_shift_mm2 * vergence
                of_lens, of_image = 1.0 / self.efl_mm, self.image_index / image
                # A difference below its rounding error means an object at infinity.
                left = of_lens - of_image
                vergence = np.where(abs(left) <= ROUNDING * abs(of_lens), 0.0, left) / self.object_index
            return _alike(shift_mm, 1.0 / (vergence + 0.0) - self.front_principal_z_mm)

    def object_scale(self, distance_mm: float) -> float:
        """Return the size of an object over that of its image in the middle view, on the array.

        A refocused picture keeps the middle view's place and size.

        Parameters
        ----------
        distance_mm : float
            Of the object, before the first vertex.

        Returns
        -------
        float
        """
        enlarged = 1.0 + self.image_excess_mm(distance_mm) / self.pupil_to_array_mm
        # Object over image distance, in a form finite in the principal plane and for an image at infinity.
        from_principal = distance_mm + self.front_principal_z_mm
        return enlarged * (from_principal / (self.object_index * self.efl_mm) - 1.0)


@dataclass(frozen=True)
class TracedShift:
    """Map between shift and distance averaged over array and pupil, from traced rays.

    A ray from place s on the array in view u crosses the plane 1/V before the first vertex at x, with x V = a + b s + c
    u and b and c linear in V; likewise for t and v with −y. A point stays in place if s moves by −c/b per view.

    Attributes
    ----------
    place : tuple of float
        b = place[0] + place[1] V, for s in mm.
    view : tuple of float, 1/mm and mm/mm
        c = view[0] + view[1] V, for u in views.
    """

    place: tuple[float, float]
    view: tuple[float, float]

    def shift_mm(self, distance_mm: float) -> float:
        """Return the shift of a point on the array from view to view; positive nearer than the focus."""
        vergence = 1.0 / distance_mm
        return (self.view[0] + self.view[1] * vergence) / (self.place[0] + self.place[1] * vergence)

    @overload
    def distance_mm(self, shift_mm: float) -> float: ...
    @overload
    def distance_mm(self, shift_mm: Array) -> Array: ...
    def distance_mm(self, shift_mm: Any) -> Any:
        """Return the distances for given shifts; see `ShiftMap`."""
        shift = np.asarray(shift_mm, dtype=np.float64)
        with np.errstate(divide="ignore", invalid="ignore"):
            vergence = (shift * self.place[0] - self.view[0]) / (self.view[1] - shift * self.place[1])
            return _alike(shift_mm, 1.0 / (vergence + 0.0))


def _alike(given: Any, values: Array) -> Any:
    """Return values in the type of the argument: a number for a number."""
    return values if isinstance(given, np.ndarray) else float(values)


def _exit_pupil_z_mm(camera: SolvedCamera) -> float:
    paraxial = camera.paraxial
    z, _ = paraxial.exit_pupil(camera.scene.camera.lens.surfaces[paraxial.stop].semi_diameter_mm or 1.0)
    return z if math.isfinite(z) else -math.inf
