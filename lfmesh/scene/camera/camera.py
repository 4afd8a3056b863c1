"""The camera: lens, microlens array (or none), sensor, and where they stand."""

from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from lfmesh.scene.camera.lens import Lens
from lfmesh.scene.camera.mla import MicrolensArray
from lfmesh.scene.camera.sensor import Sensor
from lfmesh.scene.materials.matter import Matter
from lfmesh.scene.media.air import Air
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.objects.gltf_keys import GltfPose, or_table
from lfmesh.scene.pose import Pose
from lfmesh.scene.quantities import Flag, Number, ObjectDistance


class Camera(Model):
    """Everything between the objects and the raw image.

    The camera frame is right-handed with its origin at the first vertex of the lens and z towards the sensor.
    """

    focus_mm: ObjectDistance | None = None
    """Distance of the object plane in front of the first vertex (or of the sensor, by `focus_from`), in mm; solves the
    omitted distances. inf focuses on infinity."""
    focus_from: Literal["first_vertex", "sensor"] = "first_vertex"
    """Origin of `focus_mm`. "sensor", as the distance scales of photographic lenses: of the two object
    planes at that distance it means the farther one, whose image is no larger than the object."""
    lens: Lens
    """The main lens."""
    mla: MicrolensArray | None = None
    """The microlens array; omitted in a conventional camera."""
    sensor: Sensor
    """The sensor."""
    absorption: Flag = False
    """Absorption in the glasses of lens, array and sensor cover, by the catalogue's internal transmittance. A
    glass without it is refused; what has an index, or a dispersion of its own, stays clear."""
    air: Air | None = None
    """Temperature and pressure of the air, where they are not the catalogues' 20 °C and 101.325 kPa. Every glass and
    liquid that is not given by a plain `index` then has its index relative to this air, everywhere in the scene."""
    object_medium: Matter | None = None
    """Medium that fills object space in place of air, such as { index = 1.333 }: what the first surface looks into, and
    what targets, lights, media and bodies of glass stand in. It is clear; radiance and power are those in it. It takes
    the place of the one that the lens's file names; { index = 1.0 } is air."""
    polariser_deg: Number | None = None
    """An ideal linear polariser right before the sensor: the angle of the field that it transmits, in degrees, from the
    sensor's x axis towards its y axis (counter-clockwise as seen from behind the camera). It absorbs the field along
    the axis square to that, as dichroic sheets do. Needs `transport.polarisation`."""
    pose: Pose = Field(default_factory=Pose, json_schema_extra=or_table(GltfPose))
    """Place of the camera in the world; omitted, the world frame is the camera frame. In a file also
    { file = "scene.glb" }: the place of a camera of a glTF file."""

    def faults(self) -> Iterator[Fault]:
        """Yield what is wrong between the fields."""
        outside, surfaces = self.object_medium, self.lens.surfaces
        if outside is not None and outside.medium is not None and surfaces and surfaces[0].paraxial:
            yield Fault(
                ("object_medium",), None,
                "omit it: lens.surfaces[0] is a paraxial surface, and a thin lens stands in air",
            )  # fmt: skip
