"""The first-order numbers that tie a shift between views to a distance in object space.

A pixel seen through its lenslet's principal points belongs to one point of the exit pupil and one of the array: the
two planes between which a light field is measured. Views a pixel apart are `view_step_mm` apart on the pupil. An
object whose image lies ε behind the array crosses it, from view to view, by shift = k ε / (1 + ε/D) with k = pixel/d.
This is the model of C. Hahne et al., "Refocusing distance of a standard plenoptic camera", Opt. Express 24 (2016)
21521, whose shift parameter `a` is the shift in lenslets.
"""

import math
from dataclasses import dataclass, replace

from lfmesh.errors import LfmeshError
from lfmesh.geometry.refractors import measured
from lfmesh.lightfield.lens_alone import focus_shift
from lfmesh.scene import Paraxial, Scene, first_order, solved
from lfmesh.scene.report import lenslet_to_sensor_mm

ROUNDS = 10
"""Of successive approximation, for the distance of a shift."""


@dataclass(frozen=True)
class RayModel:
    """A light-field camera by its cardinal points. All z are in the camera frame, whose origin is the first vertex.

    Attributes
    ----------
    efl_mm : float
        Focal length of the main lens.
    front_principal_z_mm, rear_principal_z_mm : float
    array_z_mm : float
        The lenslets' front principal points.
    pupil_to_array_mm : float
        D, from the exit pupil to the lenslets' front principal points; inf for a telecentric lens, negative where the
        pupil lies behind the array.
    lenslet_to_sensor_mm : float
        d, from the lenslets' rear principal points to the sensor, in air.
    lenslet_pitch_mm, pixel_mm : float
    f_number : float
        Of the main lens, on the image side, at its focus.
    focus_shift_mm, focus_shift_mm2 : float
        From where first-order optics images a point of the axis to where the rays of the full aperture come closest
        together, along z: what spherical aberration does to the focus. The second is divided by the object's distance
        from the front principal plane and added.
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

    @classmethod
    def of(cls, scene: Scene) -> "RayModel":
        """Read a scene's camera, with the shifts along z and the pitch error of its array, and trace its real focus.

        Raises
        ------
        LfmeshError
            A conventional camera, or an afocal lens.
        """
        scene = solved(measured(scene))
        camera, wavelength = scene.camera, scene.transport.primary_nm
        mla = camera.mla
        if mla is None:
            raise LfmeshError("camera.mla is missing: a conventional camera records no light field")
        facts = first_order(scene)
        if not math.isfinite(facts.efl_mm):
            raise LfmeshError("camera.lens is afocal: it has no focal length to tell distances by")
        array_z = facts.image_z_mm + mla.pose.shift_mm[2]
        shift, slope = focus_shift(scene)
        return cls(
            efl_mm=facts.efl_mm,
            front_principal_z_mm=facts.front_principal_plane_z_mm,
            rear_principal_z_mm=facts.rear_principal_plane_z_mm,
            array_z_mm=array_z,
            pupil_to_array_mm=array_z - _exit_pupil_z_mm(scene),
            lenslet_to_sensor_mm=lenslet_to_sensor_mm(camera, wavelength)
            + camera.sensor.pose.shift_mm[2]
            - mla.pose.shift_mm[2],
            lenslet_pitch_mm=mla.pitch_mm * (1.0 + mla.form.pitch_error),
            pixel_mm=camera.sensor.pixel_mm,
            f_number=facts.working_f_number,
            focus_shift_mm=shift,
            focus_shift_mm2=slope,
        )

    @property
    def paraxial(self) -> "RayModel":
        """The same camera by first-order optics alone: without what aberrations do to its focus."""
        return replace(self, focus_shift_mm=0.0, focus_shift_mm2=0.0)

    @property
    def slope_step(self) -> float:
        """Difference in direction, dx/dz, of neighbouring views at a lenslet: k = pixel/d, in rad."""
        return self.pixel_mm / self.lenslet_to_sensor_mm

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
        return self.efl_mm - self.front_principal_z_mm

    def image_excess_mm(self, distance_mm: float) -> float:
        """Return ε, how far behind the array an object this far before the first vertex is imaged most sharply.

        Raises
        ------
        LfmeshError
            The object has no real image.
        """
        # With a negative focal length, a relay's, objects on either side of it may have one.
        if not (distance_mm > self.nearest_mm or (self.efl_mm < 0.0 and distance_mm < self.nearest_mm)):
            raise LfmeshError(
                f"distance_mm = {distance_mm:g}: must lie before the front focal point, {self.nearest_mm:.6g} mm in "
                "front of the first vertex"
            )
        vergence = 1.0 / (distance_mm + self.front_principal_z_mm)
        image = self._image_mm(vergence) + self.focus_shift_mm + self.focus_shift_mm2 * vergence
        return self.rear_principal_z_mm + image - self.array_z_mm

    def shift_mm(self, distance_mm: float) -> float:
        """Return how far an object point moves on the array from one view to the next; positive nearer than focus."""
        excess = self.image_excess_mm(distance_mm)
        return self.slope_step * excess / (1.0 + excess / self.pupil_to_array_mm)

    def distance_mm(self, shift_mm: float) -> float:
        """Return the object distance whose points move this far between views: the inverse of `shift_mm`.

        Negative for a virtual object, whose image lies within the focal length; inf at infinity.
        """
        sharpest = self.array_z_mm - self.rear_principal_z_mm + self._excess_of_shift_mm(shift_mm)
        vergence = 0.0
        # What aberrations add depends on the vergence by so little that every round settles two digits more.
        for _ in range(ROUNDS):
            image = sharpest - self.focus_shift_mm - self.focus_shift_mm2 * vergence
            vergence = 1.0 / self.efl_mm - 1.0 / image
        return (1.0 / vergence if vergence else math.inf) - self.front_principal_z_mm

    def object_scale(self, distance_mm: float) -> float:
        """Return the size of an object over that of its image in the middle view, where that crosses the array.

        The refocused picture keeps the middle view's place and size whatever it is focused on.
        """
        enlarged = 1.0 + self.image_excess_mm(distance_mm) / self.pupil_to_array_mm
        from_principal = distance_mm + self.front_principal_z_mm
        return enlarged * from_principal / self._image_mm(1.0 / from_principal)

    def _image_mm(self, vergence: float) -> float:
        """Return the distance of a paraxial image from the rear principal plane; vergence: 1/object distance, 1/mm."""
        return 1.0 / (1.0 / self.efl_mm - vergence)

    def _excess_of_shift_mm(self, shift_mm: float) -> float:
        steepness = self.slope_step - shift_mm / self.pupil_to_array_mm
        return shift_mm / steepness if steepness else math.inf


def _exit_pupil_z_mm(scene: Scene) -> float:
    lens = scene.camera.lens
    paraxial = Paraxial.of(lens, scene.transport.primary_nm)
    z, _ = paraxial.exit_pupil(lens.surfaces[paraxial.stop].semi_diameter_mm or 1.0)
    return z if math.isfinite(z) else -math.inf
