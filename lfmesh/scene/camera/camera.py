"""The camera: lens, optional microlens array and sensor, with their positions."""

from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from lfmesh.errors import SceneError
from lfmesh.optics.glass import Medium, refractive_index
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.camera.lens import Lens
from lfmesh.scene.camera.mla import MicrolensArray
from lfmesh.scene.camera.sensor import Sensor
from lfmesh.scene.materials.matter import Matter
from lfmesh.scene.media.air import Air
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.motion import Motion
from lfmesh.scene.objects.gltf_keys import GltfPose, or_table
from lfmesh.scene.pose import Pose
from lfmesh.scene.quantities import Flag, Number, ObjectDistance


class Camera(Model):
    """Everything between the objects and the raw image.

    The camera frame is right-handed, with its origin at the first lens vertex and z towards the sensor.
    """

    focus_mm: ObjectDistance | None = None
    """Distance of the object plane in front of the first vertex, in mm; inf is at infinity. With `focus_from =
    "sensor"` it is measured from the sensor. Solves the distances that are omitted. Omitted: follows from the given
    distances."""
    focus_from: Literal["first_vertex", "sensor"] = "first_vertex"
    """Origin of `focus_mm`: first vertex of the lens, or the sensor, as on the distance scales of photographic lenses.
    Of the two object planes at a given distance from the sensor, the farther one is meant; its image is no larger than
    the object."""
    lens: Lens
    """The main lens."""
    mla: MicrolensArray | None = None
    """Microlens array. Omitted: a conventional camera."""
    sensor: Sensor
    """The sensor."""
    absorption: Flag = False
    """Absorption in the glasses of lens, array and sensor cover, by the catalogue's internal transmittance. A catalogue
    glass without such data is refused; materials given by index or dispersion do not absorb."""
    air: Air | None = None
    """Temperature and pressure of the air. Every glass and liquid in the scene, unless given by a plain `index`, has
    its index relative to this air. Omitted: the catalogues' 20 °C and 101.325 kPa."""
    object_medium: Matter | None = None
    """Clear medium that fills object space, such as { index = 1.333 }. The first surface, targets, lights, media and
    glass bodies are immersed in it; radiance and power are given for it. It overrides the medium of the lens file;
    { index = 1.0 } is air. Omitted: that of the lens file, else air."""
    image_medium: Matter | None = None
    """Clear medium between the lens and the sensor, such as { index = 1.336 }. The last surface looks into it; the
    array, the sensor's cover and the pixels are immersed in it. It overrides the medium behind the last surface of the
    lens; { index = 1.0 } is air. Omitted: that of the last surface, else air."""
    polariser_deg: Number | None = None
    """Ideal linear polariser right before the sensor: angle of the transmitted field, in degrees. It counts from the
    sensor's x axis towards its y axis (counter-clockwise as seen from behind the camera). The polariser absorbs the
    perpendicular field, as dichroic sheets do. Needs `transport.polarisation`. Omitted: none."""
    pose: Pose = Field(default_factory=Pose, json_schema_extra=or_table(GltfPose))
    """Place of the camera in the world; also { file = "scene.glb" }: that of a camera of a glTF file. Omitted: the
    world frame is the camera frame."""
    motion: Motion | None = None
    """Motion of the whole camera during the exposure; needs `[exposure]`. Omitted: it stands still."""

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields."""
        outside, surfaces = self.object_medium, self.lens.surfaces
        if outside is not None and outside.medium is not None and surfaces and surfaces[0].paraxial:
            yield Fault(
                ("object_medium",), None,
                "omit it: lens.surfaces[0] is a paraxial surface, and a thin lens stands in air",
            )  # fmt: skip
        behind, last = self.image_medium, self.lens.last_interface
        if behind is not None and behind.medium is not None and surfaces and surfaces[last].paraxial:
            yield Fault(
                ("image_medium",), None,
                f"omit it: lens.surfaces[{last}] is a paraxial surface, and a thin lens stands in air",
            )  # fmt: skip

    @property
    def medium_behind_lens(self) -> Medium:
        """Medium between the lens and the sensor; None for air."""
        if self.image_medium is not None:
            return self.image_medium.medium
        return self.lens.surfaces[-1].medium if self.lens.surfaces else None

    def image_index(self, wavelength_nm: float) -> float:
        """Return the refractive index of the medium between the lens and the sensor.

        Parameters
        ----------
        wavelength_nm : float

        Returns
        -------
        float
        """
        return refractive_index(self.medium_behind_lens, wavelength_nm)

    def relative_index(self, medium: Medium, wavelength_nm: float) -> float:
        """Return the refractive index of a plate behind the lens over that of the medium around it.

        Parameters
        ----------
        medium : Medium
            Of the array or the sensor's cover.
        wavelength_nm : float

        Returns
        -------
        float

        Raises
        ------
        SceneError
            The plate has a gradient, and so has no single index.
        """
        if isinstance(medium, Gradient):
            raise SceneError("camera.mla.gradient: not supported here; give a homogeneous plate, by index or glass")
        return refractive_index(medium, wavelength_nm) / self.image_index(wavelength_nm)
