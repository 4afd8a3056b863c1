"""Rays of views traced from lenslets to object space, and the shift-to-distance map fitted to them."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.geometry.lens.main_order import with_main_orders
from lfmesh.lightfield.calibration.calibration import calibration_by
from lfmesh.lightfield.rays.chief_rays import chief_rays, plate_of
from lfmesh.lightfield.rays.ray_model import RayModel, TracedShift
from lfmesh.lightfield.views.decode import sampling_of
from lfmesh.lightfield.views.upright import Upright
from lfmesh.scene import Scene
from lfmesh.transport.build import build
from lfmesh.transport.choice import obstacle_of
from lfmesh.transport.packets.packet import CAMERA_FRAME, WORLD_FRAME
from lfmesh.transport.trace import Status, trace
from lfmesh.transport.traced_paths import Paths
from lfmesh.transport.world import World

Array = NDArray[np.float64]

ACROSS = 9
"""Lenslets along each axis of the array used to fit the shift-to-distance map."""


class ViewRays:
    """Rays of every view of a light-field camera, traced from the array to object space.

    At diffractive faces with several orders they follow the main one.
    """

    def __init__(self, world: World) -> None:
        scene = with_main_orders(world.scene)
        rays = chief_rays(scene)
        self.world = world if scene is world.scene else build(scene)
        self.calibration = calibration_by(scene, rays)
        self._upright = Upright.of(scene)
        self.sampling = sampling_of(self.calibration, self._upright)
        self._plate = plate_of(scene)
        self._slope_step = RayModel.of(scene).slope_step
        self._slopes = rays.direction[..., :2] / rays.direction[..., 2:]

    @classmethod
    def of_camera(cls, scene: Scene) -> "ViewRays":
        """Return the rays of a solved scene's camera, with nothing before it."""
        return cls(build(scene.camera_alone()))

    def trace(self, v: float, u: float, every: tuple[int, int] = (1, 1)) -> tuple[Paths, NDArray[np.int64]]:
        """Trace one view.

        Parameters
        ----------
        v, u : float
            Direction of the view from the chief rays, in views from the middle one, as (v, u) of `LightField`.
        every : tuple of int
            Steps between the samples traced, along t and s.

        Returns
        -------
        Paths
        sample : (n,) int64
            Index of each packet of `Paths` in the flattened (t, s) samples.
        """
        slopes = self._slopes + self._slope_step * np.array([u, v]) * self._upright.senses
        along = np.concatenate([slopes, np.ones((*slopes.shape[:2], 1))], axis=2)
        along /= np.linalg.norm(along, axis=2, keepdims=True)
        entry = self._plate.entries(along.reshape(-1, 3)).reshape(along.shape)
        starts, along = (
            self._of_samples(entry)[:: every[0], :: every[1]],
            self._of_samples(along)[:: every[0], :: every[1]],
        )
        starts, along = starts.reshape(-1, 3), along.reshape(-1, 3)
        known = np.flatnonzero(np.isfinite(starts).all(axis=1) & np.isfinite(along).all(axis=1))
        # Back against the light, from well before the array's bulging lenslets.
        room = 0.5 * self._plate.lenslets.lattice.pitch
        transport = self.world.scene.transport
        to_world = self.world.tables.frames[CAMERA_FRAME, WORLD_FRAME]
        paths = trace(
            self.world, frames.points(to_world, (starts - room * along)[known]),
            frames.directions(to_world, -along[known]), self.world.scene.primary_nm,
            split="transmit", engine=image_path_engine(self.world.scene, tracing=True), threads=transport.threads,
        )  # fmt: skip
        return paths, known[paths.source]

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of a view, in samples."""
        return len(self.sampling.t_mm), len(self.sampling.s_mm)

    def _of_samples(self, values: Array) -> Array:
        """Interpolate values of lenslets, (rows, columns, 3), at the samples of a view, (t, s, 3)."""
        parity, row = self.sampling.rows & 1, self.sampling.rows[:, None]
        left, share = self.sampling.columns[parity], self.sampling.share[parity][..., None]
        right = np.minimum(left + 1, values.shape[1] - 1)
        return np.asarray((1.0 - share) * values[row, left] + share * values[row, right])


def traced_shift(rays: ViewRays, usable: NDArray[np.bool_]) -> TracedShift:
    """Fit the shift-to-distance map to traced rays.

    Parameters
    ----------
    rays : ViewRays
        Of a camera with nothing before it.
    usable : (v, u) bool
        Views to use.

    Raises
    ------
    LfmeshError
        The lens passes hardly any of these rays.
    """
    height, width = rays.size
    every = max(1, -(-height // ACROSS)), max(1, -(-width // ACROSS))
    t, s = np.meshgrid(rays.sampling.t_mm[:: every[0]], rays.sampling.s_mm[:: every[1]], indexing="ij")
    rows, columns = usable.shape
    terms, at_zero, per_vergence = [], [], []
    for v, u in np.argwhere(usable):
        dv, du = v - 0.5 * (rows - 1), u - 0.5 * (columns - 1)
        paths, sample = rays.trace(dv, du, every)
        out = paths.status == Status.ESCAPED
        slope, height0 = _in_object_space(rays.world, paths, out)
        # s and u grow with x, t and v against y.
        for axis, sense, place, view in ((0, 1.0, s, du), (1, -1.0, t, dv)):
            at = place.ravel()[sample[out]]
            one = np.zeros((len(at), 2))
            one[:, axis] = 1.0
            terms.append(np.column_stack([at, np.full(len(at), view), one]))
            at_zero.append(-sense * slope[:, axis])
            per_vergence.append(sense * height0[:, axis])
    design = np.concatenate(terms)
    if len(design) < 8 * design.shape[1]:
        raise LfmeshError("camera: almost no ray of the views passes the lens; check it with lfmesh check")
    fit, *_ = np.linalg.lstsq(design, np.column_stack([np.concatenate(at_zero), np.concatenate(per_vergence)]))
    return TracedShift((float(fit[0, 0]), float(fit[0, 1])), (float(fit[1, 0]), float(fit[1, 1])))


def _in_object_space(world: World, paths: Paths, which: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return dx/dz and dy/dz of rays before the lens, and x and y in the first vertex's plane, (n, 2)."""
    to_camera = world.tables.frames[WORLD_FRAME, CAMERA_FRAME]
    p, d = frames.points(to_camera, paths.position[which]), frames.directions(to_camera, paths.direction[which])
    slope = d[:, :2] / d[:, 2:]
    return slope, p[:, :2] - p[:, 2:] * slope


def image_path_engine(scene: Scene, *, tracing: bool = False) -> str:
    """Return the fastest engine that follows a scene's image path, or with `tracing`, given rays along it."""
    transport = scene.transport
    obstacle = obstacle_of(scene, transport.surface, transport.max_events, tracing=tracing)
    return "sequential" if obstacle is None else "mesh"
