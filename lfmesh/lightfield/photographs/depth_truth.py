"""True depth: traced distances to the first target on rays of views and raw pixels.

Media and particles have none, as light comes from all along a line of sight; rays pass through them. In media that bend
light, rays are curves.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.geometry.index_media import only_bends
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.lightfield.rays.view_rays import ViewRays, image_path_engine
from lfmesh.lightfield.views.decode import view_count
from lfmesh.notebook import Pictured, Say, announced
from lfmesh.scene import Scene
from lfmesh.transport.build import build
from lfmesh.transport.engine import CHUNK, Workspace
from lfmesh.transport.packets.packet import BY_MESH, BY_ORDER, CAMERA_FRAME, TRANSMIT, WORLD_FRAME
from lfmesh.transport.packets.random import descendant
from lfmesh.transport.settings import options_of
from lfmesh.transport.sources.pixels import PixelSource
from lfmesh.transport.sources.source import Launcher
from lfmesh.transport.trace import Status
from lfmesh.transport.world import World

Array = NDArray[np.float64]
Samples = NDArray[np.float32]

MOST_SAMPLES = CHUNK
"""Most rays per pixel, as its bundle is traced in one piece."""


@dataclass(frozen=True, eq=False)
class DepthTruth(Pictured):
    """Distances of targets before the first vertex, along its axis; glass targets are looked through.

    NaN if no ray passes the lens, inf if rays pass and meet nothing. A target with an opacity below 1 stops each ray
    with that probability: a chief ray gives the distance of the target or of what lies behind it.

    Attributes
    ----------
    views_mm : (v, u, t, s) float32, mm
        Along the chief ray of every sample of the light field, upright like `LightField`.
    middle_mm : (t, s) float32, mm
        From the middle of the exit pupil; between the views if their number is even.
    pixels_mm, spread_mm : (H, W) float32, mm
        Mean and standard deviation over the rays of a raw pixel's bundle that meet a target, weighted by their light,
        oriented like the raw image.
    seen : (H, W) float32
        Fraction of the bundle that meets a target; 0 for a dark pixel.
    without_depth : tuple of str
        Names of media and groups of particles.
    """

    views_mm: Samples
    middle_mm: Samples
    pixels_mm: Samples
    spread_mm: Samples
    seen: Samples
    without_depth: tuple[str, ...] = ()

    def __repr__(self) -> str:
        v, u, t, s = self.views_mm.shape
        known = np.isfinite(self.middle_mm).mean()
        untold = f", without depth: {', '.join(self.without_depth)}" if self.without_depth else ""
        return f"<DepthTruth: {u} × {v} views of {s} × {t} samples, {known:.1%} of them known{untold}>"


def depth_truth(
    scene: Scene, *, views: int | None = None, samples: int = 16, progress: Say | bool | None = None
) -> DepthTruth:
    """Trace the true depth of everything that a light-field camera sees, at the primary wavelength.

    Parameters
    ----------
    scene : Scene
    views : int, optional
        Along each axis, as for `lf.decode`.
    samples : int
        Rays per pixel.
    progress : callable or bool, optional
        Called with the progress in words. True shows it, False nothing. Default: it is shown at a terminal or in a
        notebook after two seconds.

    Returns
    -------
    DepthTruth

    Raises
    ------
    LfmeshError
        A conventional camera, or an invalid number of views or samples.
    """
    if not 1 <= samples <= MOST_SAMPLES:
        raise LfmeshError(f"samples = {samples}: must be from 1 to {MOST_SAMPLES}")
    with announced(progress) as say:
        rays = _rays_of(scene)
        count = view_count(rays.calibration, views)
        places = np.arange(count) - 0.5 * (count - 1)
        views_mm = []
        for number, (v, u) in enumerate(product(places, places)):
            say(f"true depth: view {number + 1} of {count * count}")
            views_mm.append(_of_view(rays, v, u))
        middle_mm = _of_view(rays, 0.0, 0.0)
        say("true depth: pixels")
        of_pixels = _of_pixels(rays.world, samples)
    of_views = np.stack(views_mm).reshape(count, count, *middle_mm.shape)
    return DepthTruth(of_views, middle_mm, *of_pixels, without_depth=without_depth(scene))


def without_depth(scene: Scene) -> tuple[str, ...]:
    """Return the names of a scene's media and groups of particles; rays follow media that only bend light."""
    media = (
        medium.name or f"media[{number}]" for number, medium in enumerate(scene.media) if not only_bends(scene, medium)
    )
    return *media, *(f"particles[{number}]" for number in range(len(scene.particles)))


def middle_depth_mm(scene: Scene) -> Samples:
    """Trace only `DepthTruth.middle_mm`.

    Raises
    ------
    LfmeshError
        A conventional camera.
    """
    return _of_view(_rays_of(scene), 0.0, 0.0)


def _rays_of(scene: Scene) -> ViewRays:
    scene = solved_camera(scene).scene
    return ViewRays(build(scene.changed({"lights": ()}).at_line(scene.primary_nm)))


def _of_view(rays: ViewRays, v: float, u: float) -> Samples:
    """Return the (t, s) distances along the chief rays of one view."""
    size = rays.size
    paths, sample = rays.trace(v, u)
    distances = np.full(size[0] * size[1], np.nan)
    met, beside = paths.status == Status.TARGET, paths.status == Status.ESCAPED
    distances[sample[met]] = _distances_mm(rays.world, paths.position[met])
    distances[sample[beside]] = np.inf
    return distances.reshape(size).astype(np.float32)


def _of_pixels(world: World, samples: int) -> tuple[Samples, Samples, Samples]:
    """Return mean, standard deviation and fraction on targets, (H, W), over the bundle of every raw pixel."""
    sensor = world.tables.sensor
    pixels = sensor.rows * sensor.columns
    mean, spread, seen = np.empty((3, pixels), np.float32)
    sequential = image_path_engine(world.scene) == "sequential"
    options = options_of(
        world, tracing=True, split=TRANSMIT, faces=BY_ORDER if sequential else BY_MESH, importance=True
    )
    tables = world.aimed_tables
    key = descendant(0x6465707468, world.scene.transport.seed)
    source = PixelSource(np.arange(pixels), samples, key, world.lines.middle)

    def keep(work: Workspace, part: range) -> None:
        some = slice(part.start, part.stop)
        mean[some], spread[some], seen[some] = _moments(_sums(world, work.ends(), part))

    Launcher(lambda: Workspace(world, options, tables=tables)).traced(source, keep, world.scene.transport.threads)
    shape = (sensor.rows, sensor.columns)
    return mean.reshape(shape), spread.reshape(shape), seen.reshape(shape)


def _sums(world: World, ended: NDArray[np.void], pixels: range) -> Array:
    """Return the sums of w, w z, w z² over rays that meet a target, and of w over the others, (4, pixels)."""
    sums = np.zeros((4, len(pixels)))
    met, beside = ended[ended["status"] == Status.TARGET], ended[ended["status"] == Status.ESCAPED]
    distance = _distances_mm(world, met["position"])
    for power in range(3):
        sums[power] = np.bincount(met["source"] - pixels.start, met["weight"] * distance**power, len(pixels))
    sums[3] = np.bincount(beside["source"] - pixels.start, beside["weight"], len(pixels))
    return sums


def _moments(sums: Array) -> tuple[Array, Array, Array]:
    """Return mean, standard deviation and fraction from the sums of `_sums`."""
    weight, first, second, beside = sums
    lit = weight + beside
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(weight > 0.0, first / weight, np.where(beside > 0.0, np.inf, np.nan))
        spread = np.sqrt(np.maximum(second / weight - (first / weight) ** 2, 0.0))
        seen = np.where(lit > 0.0, weight / lit, 0.0)
    return mean, spread, seen


def _distances_mm(world: World, positions: Array) -> Array:
    """Return the distances of (n, 3) points of the world frame before the first vertex."""
    return np.asarray(-frames.points(world.tables.frames[WORLD_FRAME, CAMERA_FRAME], positions)[:, 2])
