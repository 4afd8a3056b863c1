"""Cross-talk: light in the cell of one lenslet's micro-image that came through another lenslet.

A cell is the part of the sensor nearest to its lenslet's chief ray. Rays start at random points of pixels, as in the
adjoint method, and pass array and lens to a uniform surround. The vertex on the curved face identifies the lenslet.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from lfmesh.errors import warn_caller
from lfmesh.geometry import frame as frames
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.lightfield.calibration.calibration import calibrate
from lfmesh.scene import Scene
from lfmesh.transport.build import build
from lfmesh.transport.checks.found import given_up
from lfmesh.transport.engine import Workspace
from lfmesh.transport.packets.packet import COUNTERS, CURVED_FACE, SENSOR_FRAME, TRANSMIT, WORLD_FRAME, Event
from lfmesh.transport.packets.random import descendant, run_key
from lfmesh.transport.settings import ledger_of, options_of
from lfmesh.transport.sources.pixels import PixelSource
from lfmesh.transport.sources.source import Launcher
from lfmesh.transport.trace import Status
from lfmesh.transport.world import World

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

STREAM = 0x63726F7373
"""Random-number stream, different from those of renders."""

CHUNK = 4096
"""Rays traced together, with all their vertices in memory."""

MOST_PIXELS = 65_536
"""Pixels per replicate on a larger sensor, random and evenly spread: enough for a fraction. Rays with recorded lenslets
take ten times as long as others."""


def lenslet_light(scene: Scene, replicates: Sequence[int]) -> Array:
    """Return the light of a uniform surround in the cell of each lenslet, split by its path.

    It is refracted light at the primary wavelength, from a radiance of 1 W/(m² sr), estimated from a sample of the
    pixels if there are more than `MOST_PIXELS`.

    Parameters
    ----------
    scene : Scene
        Scene with a microlens array.
    replicates : sequence of int
        Numbers of the replicates; scenes with the same seed share random numbers.

    Returns
    -------
    (replicates, rows, columns, 2) float64, W
        Light through the cell's own lenslet, and through all others.

    Warns
    -----
    PictureWarning
        The tracer lost light, or `max_events` cut paths.

    Raises
    ------
    LfmeshError
        The camera has no array, or cannot be built.
    """
    scene = solved_camera(scene).scene
    scene = scene.camera_alone({"transport.polarisation": False}).at_line(scene.primary_nm)
    centres = calibrate(scene).centres_px
    world, cells = build(scene), KDTree(centres.reshape(-1, 2))
    options = options_of(world, tracing=True, record=True, split=TRANSMIT, importance=True)
    tables = world.aimed_tables
    launcher = Launcher(lambda: Workspace(world, options, CHUNK, tables))
    transport, sensor = world.scene.transport, tables.sensor
    pixels = sensor.rows * sensor.columns

    def keep(work: Workspace, part: range) -> tuple[Array, Array]:
        return _sums(world, work.ends(), work.vertices(), cells), work.book.copy()

    found, book = [], np.zeros(len(world.slots))
    for replicate in replicates:
        key = descendant(descendant(run_key(transport.seed), STREAM), replicate)
        some = _spread(pixels, key)
        source = PixelSource(some, transport.samples_each, key, world.lines.middle)
        # Summed in order, whichever thread finishes first.
        light = np.zeros((2, len(cells.data)))
        for sums, own in launcher.traced(source, keep, transport.threads, CHUNK):
            light += sums
            book += own
        found.append(pixels / len(some) * light)
    warn_caller(given_up(scene, ledger_of(book, np.zeros(COUNTERS, np.int64), world, 0, "m² sr")))
    return np.stack(found).transpose(0, 2, 1).reshape(len(found), *centres.shape)


def _spread(pixels: int, key: np.uint64) -> Whole:
    """Return the pixels to sample: all, or a random one from each of `MOST_PIXELS` equal runs."""
    if pixels <= MOST_PIXELS:
        return np.arange(pixels)
    place = np.arange(MOST_PIXELS) + np.random.default_rng(int(key)).random(MOST_PIXELS)
    return np.minimum((place * (pixels / MOST_PIXELS)).astype(np.int64), pixels - 1)


def _sums(world: World, ended: NDArray[np.void], nodes: NDArray[np.void], cells: KDTree) -> Array:
    """Return the weights of the rays that left the camera, by starting cell, (2, cells).

    First row: through the cell's own lenslet; second: others.
    """
    out = ended[ended["status"] == Status.ESCAPED]
    start, lenslet = _followed_back(nodes, out["node"])
    sensor = world.tables.sensor
    on_sensor = frames.points(world.tables.frames[WORLD_FRAME, SENSOR_FRAME], nodes["position"][start])[:, :2]
    size = np.array([sensor.columns, sensor.rows])
    _, cell = cells.query(on_sensor / sensor.pixel + 0.5 * (size - 1.0))
    own, count = lenslet == cell, len(cells.data)
    return np.stack([np.bincount(cell[which], out["weight"][which], count) for which in (own, ~own)])


def _followed_back(nodes: NDArray[np.void], last: Whole) -> tuple[Whole, Whole]:
    """Return the first vertices of paths, and the lenslet next to the sensor on each path, −1 if none.

    Parameters
    ----------
    nodes : (n,) NODE
    last : (paths,) int64
        Last vertex of each path.
    """
    node, lenslet = last.copy(), np.full(len(last), -1)
    going = np.arange(len(last))
    while len(going):
        row = nodes[node[going]]
        # Going back to the sensor, the last curved face is the one next to it.
        through = (row["surface"] == CURVED_FACE) & (row["event"] == Event.TRANSMITTED)
        lenslet[going[through]] = row["part"][through]
        going, parent = going[row["parent"] >= 0], row["parent"][row["parent"] >= 0]
        node[going] = parent
    return node, lenslet
