"""A scene's camera as waves pass it: what all its point spreads share, built once."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.geometry.lens.solved_camera import SolvedCamera, solved_camera
from lfmesh.scene import Scene
from lfmesh.transport.packets.packet import CAMERA_FRAME, SENSOR_FRAME, WORLD_FRAME
from lfmesh.transport.trace import at_wavelength, trace
from lfmesh.transport.world import World, build
from lfmesh.waves.bundle import Bundle, LensRays, pupil_grid
from lfmesh.waves.camera_faces import WaveFace, faces_before_sensor
from lfmesh.waves.refused import NoLightError, refuse_scene

Array = NDArray[np.float64]

TRIALS = 16
"""Rays on a diameter of the stop that look for targets before a point, and for how wide its light is."""

OFF_POINT = 1e-6
"""Of the way to the lens: these rays start this far before the point, so that it may lie on a target."""


@dataclass(frozen=True, eq=False)
class WaveCamera:
    """A camera that waves are taken through.

    Attributes
    ----------
    camera : SolvedCamera
    world : World
        Of the camera alone.
    """

    camera: SolvedCamera
    world: World

    @classmethod
    def of(cls, scene: Scene) -> "WaveCamera":
        """Return the camera of a scene.

        Parameters
        ----------
        scene : Scene

        Raises
        ------
        LfmeshError
            Coherent waves are not taken through it.
        """
        refuse_scene(scene)
        camera = solved_camera(scene)
        return cls(camera, build(camera.scene.camera_alone()))

    @property
    def scene(self) -> Scene:
        """The solved scene."""
        return self.camera.scene

    @property
    def sensor_mm(self) -> Array:
        """(3,): middle of the sensor, camera frame."""
        return np.asarray(self.world.tables.frames[SENSOR_FRAME, CAMERA_FRAME][:, 3])

    @cached_property
    def _faces(self) -> dict[float, list[WaveFace]]:
        return {}

    def faces(self, wavelength_nm: float) -> list[WaveFace]:
        """Return the faces between lens and sensor at a wavelength.

        Parameters
        ----------
        wavelength_nm : float
        """
        if wavelength_nm not in self._faces:
            tables = at_wavelength(self.world, wavelength_nm)
            self._faces[wavelength_nm] = faces_before_sensor(self.scene, tables, wavelength_nm)
        return self._faces[wavelength_nm]

    @cached_property
    def _whole(self) -> World:
        """The world with the targets that may hide a point."""
        return build(self.scene, aimed=False)

    def looked_at(self, point: Array, wavelength_nm: float) -> Bundle:
        """Return some rays of a point: the chief ray, and `TRIALS` on a diameter of the stop and on its rim.

        Parameters
        ----------
        point : (3,) float64, mm
            Camera frame.
        wavelength_nm : float
        """
        rays = LensRays(self.world, -float(point[2]), float(self.sensor_mm[2]))
        pupil = np.vstack([np.zeros((1, 2)), pupil_grid(TRIALS, rim=True)])
        return rays.bundle(point[:2] / rays.object_mm, pupil, wavelength_nm)

    def refuse_hidden(self, point: Array, bundle: Bundle, wavelength_nm: float) -> None:
        """Refuse a point of whose light a part, or all, meets a target on its way to the lens.

        Parameters
        ----------
        point : (3,) float64, mm
            Camera frame.
        bundle : Bundle
            As `looked_at` returns it.
        wavelength_nm : float

        Raises
        ------
        NoLightError
            A target hides it whole.
        LfmeshError
            A target hides it in part.
        """
        if not self.scene.targets:
            return
        whole, ahead = self._whole, entering(point, bundle)
        out = at_wavelength(whole, wavelength_nm).frames[CAMERA_FRAME, WORLD_FRAME]
        started = frames.points(out, point[None, :] + OFF_POINT * ahead)
        found = trace(whole, started, frames.directions(out, ahead), wavelength_nm, "transmit")
        names = [target.name or f"targets[{i}]" for i, target in enumerate(self.scene.targets)]
        hiding = [body for body in found.body if body in names]
        if len(hiding) == len(ahead) > 0:
            raise NoLightError(
                f"point_mm = {point.tolist()}: {hiding[0]} hides it; move the point or leave the target out"
            )
        if hiding:
            raise LfmeshError(
                f"point_mm = {point.tolist()}: {hiding[0]} hides it from {len(hiding)} of {len(ahead)} places of the "
                "pupil; move the point or leave the target out"
            )


def entering(point: Array, bundle: Bundle) -> Array:
    """Return the ways of a bundle's rays from their point to the plane of the first vertex, (rays that pass, 3) mm.

    Parameters
    ----------
    point : (3,) float64, mm
        Camera frame.
    bundle : Bundle
    """
    entry = bundle.entry[bundle.passes]
    return np.column_stack([entry, np.zeros(len(entry))]) - point
