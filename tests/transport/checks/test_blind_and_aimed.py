"""Aimed paths bring what paths to everywhere bring, in every block of pixels of random cameras."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.transport.checks.blind_check import BlindSamples, without_aim
from lfmesh.transport.render.render import Renderer

RandomCamera = Callable[[int], lf.Scene]

LEVEL = 1e-3
"""Chance that any of the cameras fails though the law holds."""

CAMERAS = 100


def check(scene: lf.Scene) -> None:
    """Compare an aimed image with one by rays that go anywhere, block by block, at the level for all cameras."""
    aimed = Renderer(lf.build(scene.changed({"transport.samples": 64, "transport.replicates": 4}))).image()
    world = lf.build(scene.changed({"transport.samples": 256, "transport.replicates": 1, "transport.seed": 7}))
    world.aim = without_aim(world.aim)
    blind = Renderer(world, check=False).image()
    samples = BlindSamples(*blind.mean.shape)
    samples.add(np.arange(blind.mean[..., 0].size), 0, blind.mean.reshape(-1))
    for found in (samples.compared(aimed.mean, aimed.stderr**2), aimed.blind):
        assert found is not None
        assert abs(found.worst) <= stats.norm.isf(LEVEL / (4.0 * CAMERAS * np.prod(found.blocks))), found


@pytest.mark.parametrize("seed", range(4))
def test_aimed_and_blind_estimates_agree(seed: int, random_camera: RandomCamera) -> None:
    check(random_camera(seed))


@pytest.mark.long
@pytest.mark.parametrize("seed", range(4, CAMERAS))
def test_aimed_and_blind_estimates_agree_for_many_cameras(seed: int, random_camera: RandomCamera) -> None:
    check(random_camera(seed))
