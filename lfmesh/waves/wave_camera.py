"""A scene's camera for waves, shared by its point spreads."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.geometry.lens.main_order import phases_of, refuse_several_orders, with_main_orders
from lfmesh.geometry.lens.solved_camera import SolvedCamera, solved_camera
from lfmesh.scene import Scene
from lfmesh.transport.build import build
from lfmesh.transport.packets.packet import CAMERA_FRAME, SENSOR_FRAME, WORLD_FRAME
from lfmesh.transport.trace import at_wavelength, trace
from lfmesh.transport.world import World
from lfmesh.waves.bundle import Bundle, LensRays, pupil_grid
from lfmesh.waves.camera_faces import WaveFace, faces_before_sensor
from lfmesh.waves.refused import NoLightError, refuse_rough_faces, refuse_scene

Array = NDArray[np.float64]

TRIALS = 16
"""Rays on a diameter of the stop, to find targets before a point and the width of its light."""

OFF_POINT = 1e-6
"""Distance before the point at which these rays start, over the way to the lens; the point may lie on a target."""


@dataclass(frozen=True, eq=False)
class WaveCamera:
    """A camera for wave propagation.

    Attributes
    ----------
    camera : SolvedCamera
    world : World
        Of the camera alone.
    """

    camera: SolvedCamera
    world: World

    @classmethod
    def of(cls, scene: Scene, *, main_orders: bool = False) -> "WaveCamera":
        """Return the camera of a scene.

        Parameters
        ----------
        scene : Scene
        main_orders : bool
            Reduce diffractive faces with several orders to their main one, instead of refusing them.

        Raises
        ------
        LfmeshError
            The scene is not supported, see `refuse_scene` and `refuse_rough_faces`.
        """
        refuse_scene(scene)
        camera = solved_camera(scene)
        if not main_orders:
            refuse_several_orders(phases_of(camera.scene))
        camera = solved_camera(with_main_orders(camera.scene))
        refuse_rough_faces(camera.scene)
        return cls(camera, build(camera.scene.camera_alone()))

    @property
    def scene(self) -> Scene:
        """The solved scene."""
        return self.camera.scene

    @property
    def sensor_mm(self) -> Array:
        """(3,): centre of the sensor, camera frame."""
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
        """World that includes the targets, which may hide a point."""
        return build(self.scene, aimed=False)

    def looked_at(self, point: Array, wavelength_nm: float) -> Bundle:
        """Return a point's chief ray and others, `TRIALS` on a diameter of the stop and some on its rim.

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
        """Refuse a point if targets hide it from any part of the lens.

        Parameters
        ----------
        point : (3,) float64, mm
            Camera frame.
        bundle : Bundle
            From `looked_at`.
        wavelength_nm : float

        Raises
        ------
        NoLightError
            All of its light is hidden.
        LfmeshError
            A part is hidden.
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
            raise NoLightError(f"point_mm = {point.tolist()}: {hiding[0]} hides it; move the point, or omit the target")
        if hiding:
            raise LfmeshError(
                f"point_mm = {point.tolist()}: {hiding[0]} hides it from {len(hiding)} of {len(ahead)} points of the "
                "pupil; move the point, or omit the target"
            )


def entering(point: Array, bundle: Bundle) -> Array:
    """Return the rays from a point to the plane of the first vertex, (rays that pass, 3) mm.

    Parameters
    ----------
    point : (3,) float64, mm
        Camera frame.
    bundle : Bundle
    """
    entry = bundle.entry[bundle.passes]
    return np.column_stack([entry, np.zeros(len(entry))]) - point
