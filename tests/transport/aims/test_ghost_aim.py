"""Ghosts are drawn by the light that they bring from where something stands: what is rare is not heavy."""

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.geometry import frame
from lfmesh.transport.aims.ghost_trace import Passing, meeting
from lfmesh.transport.packets.packet import CAMERA_FRAME, WORLD_FRAME

SEEDS, SAMPLES, LENSLETS = 8, 32, 16


@pytest.fixture(scope="module")
def world() -> lf.World:
    """A glowing chart through a small camera, with all reflections."""
    return lf.build(
        lf.load(asset_path("scenes/emitting_plane.toml")).changed(
            {
                "camera.mla.count": [LENSLETS, LENSLETS],
                "camera.sensor.pixels": [10 * LENSLETS] * 2,
                "transport.samples": SAMPLES,
                "transport.replicates": 1,
            }
        )
    )


def test_one_in_a_thousand_pixels_holds_little_of_the_noise_of_reflections(world: lf.World) -> None:
    """Of the variance over seeds they hold less than a twentieth, and a tenth where rays go to the opening alone."""
    images = np.array([lf.render(world.scene.changed({"transport.seed": seed})).mean for seed in range(SEEDS)])
    variance = np.sort(images.var(axis=0, ddof=1).ravel())[::-1]
    assert variance[: len(variance) // 1000].sum() < 0.05 * variance.sum()


@pytest.mark.parametrize("flat", [0, 1, 2])
def test_rays_meet_boxes_as_their_points_say(flat: int, world: lf.World) -> None:
    """A ray meets a box if any of many points on its way lies within, a box without thickness if it crosses there."""
    draw = np.random.default_rng(flat)
    low = np.array([-3.0, -2.0, -9.0])
    high = -0.5 * low
    high[2] = low[2] + 4.0
    p, d = draw.normal(0.0, 4.0, (400, 3)), draw.normal(size=(400, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    move = world.tables.frames[WORLD_FRAME, CAMERA_FRAME]
    as_left = frame.points(move, p), frame.directions(move, d)
    rays = Passing(400, np.zeros(400, np.int64), np.arange(400), np.ones(400), *as_left)
    thin = high.copy()
    thin[flat] = low[flat]
    along = p[:, None] + np.linspace(0.0, 60.0, 6001)[:, None] * d[:, None]
    inside = ((along >= low) & (along <= high)).all(axis=2).any(axis=1)
    found = meeting(world.tables, np.array([[low, high]]), rays)
    # Points are 0.01 mm apart, so that they may miss a corner.
    assert found[inside].all()
    assert (found & ~inside).sum() <= 2
    t = (low[flat] - p[:, flat]) / d[:, flat]
    at = p + t[:, None] * d
    others = [axis for axis in range(3) if axis != flat]
    crosses = (t > 0.0) & ((at >= low) & (at <= high))[:, others].all(axis=1)
    assert np.array_equal(meeting(world.tables, np.array([[low, thin]]), rays), crosses)
