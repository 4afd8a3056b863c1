"""Images through tilted and decentred elements: both engines, aimed and unaimed paths, and the same for any threads."""

from typing import Any

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from tests.cameras import biconvex, close_up_camera
from tests.renders import by_seed
from tests.transport.checks.test_blind_and_aimed import check

LEVEL = 1e-3
"""Chance that a comparison of images fails though the law holds."""

ELEMENTS = [
    {"surfaces": [0, 1], "pose": {"tilt_deg": [3.0, -2.0, 0.0], "shift_mm": [0.4, 0.2, 0.0]}},
    {"surfaces": [2], "pose": {"tilt_deg": [0.0, 2.0, 0.0], "shift_mm": [0.0, 0.7, 0.1]}},
]


def posed_camera(split: str = "both", elements: Any = ELEMENTS) -> lf.Scene:
    """Return a small light-field camera with a tilted lens and a stop off its axis, before a glowing plane."""
    glow = {
        "shape": {"kind": "plane", "width_mm": 6.0, "height_mm": 5.0},
        "position_mm": [0.0, 0.0, -60.0],
        "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
    }
    camera = close_up_camera() | {"lens": biconvex() | {"elements": elements}}
    return lf.Scene(camera=camera, targets=[glow], transport={"split": split, "threads": 1, "samples": 32})


def sums(scene: lf.Scene, seeds: range) -> np.ndarray:
    """Return what 4 × 4 pixels add up to, in the image of every seed, (seeds, squares) W."""
    images = np.array([image.mean[..., 0] for image in by_seed(scene, seeds)])
    n, height, width = images.shape
    return images.reshape(n, height // 4, 4, width // 4, 4).sum(axis=(2, 4)).reshape(n, -1)


def test_both_engines_make_the_same_image() -> None:
    """The image path alone, by 24 seeds each: Welch's test of 25 squares, at LEVEL for all of them."""
    scene = posed_camera("transmit").changed({"transport.replicates": 1})
    mesh, sequential = (
        sums(scene.changed({"transport.engine": engine}), range(first, first + 24))
        for first, engine in ((0, "mesh"), (100, "sequential"))
    )
    p = stats.ttest_ind(mesh, sequential, equal_var=False).pvalue
    assert p.min() > LEVEL / p.size
    # The image of the lens without poses is another one.
    straight = sums(posed_camera("transmit", []).changed({"transport.replicates": 1}), range(200, 224))
    assert stats.ttest_ind(mesh, straight, equal_var=False).pvalue.min() < 1e-9


def test_aimed_and_blind_estimates_agree() -> None:
    check(posed_camera("transmit"))


def test_energy_closes_and_nothing_is_lost() -> None:
    image = lf.render(posed_camera())
    assert abs(image.ledger.imbalance) < 1e-12
    assert image.ledger.lost_share == 0.0


@pytest.mark.parametrize("engine", ["mesh", "sequential"])
def test_the_image_does_not_depend_on_the_number_of_threads(engine: str) -> None:
    scene = posed_camera("transmit").changed({"transport.engine": engine})
    one, two = (lf.render(scene.changed({"transport.threads": threads})).mean.tobytes() for threads in (1, 2))
    assert one == two
