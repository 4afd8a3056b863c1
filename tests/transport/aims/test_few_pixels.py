"""Cameras with few pixels a lenslet: pixels as large as lenslets, which straddle several micro-images."""

from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.transport.aims.lenslet_aim import LISTED, ArraySeen, list_cells, most_listed, pixel_extent
from lfmesh.transport.packets.packet import MLA_FRAME, SENSOR_FRAME
from tests.instances import instances
from tests.random_scenes.generator import draw
from tests.renders import by_seed
from tests.transport.conftest import LEFT_OUT, TARGET

Array = NDArray[np.float64]

LEVEL = 1e-3
"""Chance that any comparison of the 60 cameras fails though the law holds, shared by all of them (Bonferroni)."""

PITCH = 0.125

PIXELS = (1.2, 1.5, 2.3, 3.3, 5.3, 8.0)
"""Pixels a lenslet."""

F_NUMBERS = (2.25, 4.0, 5.6, 8.0, 16.0)

COMBINATIONS = tuple(product(PIXELS, F_NUMBERS, ("square", "hexagonal")))

SEEDS = 64


def camera(pixels: float, f_number: float, layout: str, **changes: Any) -> lf.Scene:
    """Return the double Gauss lens before a small array, with so many pixels a lenslet, and an evenly shining plane."""
    lenslets = int(np.clip(12.0 / pixels, 4, 8))
    side = int(lenslets * pixels)
    rows = int(side * np.sqrt(0.75)) if layout == "hexagonal" else side
    return lf.load(asset_path("scenes/first_light.toml")).changed(
        {"camera.mla.count": (lenslets, lenslets), "camera.mla.layout": layout, "camera.sensor.pixels": (side, rows),
         "camera.sensor.pixel_mm": PITCH / pixels, "camera.lens.stop_semi_diameter_mm": 19.05 / f_number,
         "targets": [TARGET], "lights": [], "transport.split": "transmit", "transport.samples": 64,
         "transport.replicates": 4, "transport.threads": 1} | changes
    )  # fmt: skip


def images(scene: lf.Scene, first: int) -> tuple[Array, Array]:
    """Return the images of `SEEDS` seeds, and the variances that they state, (n, H, W)."""
    some = [(image.mean[..., 0], image.stderr[..., 0] ** 2) for image in by_seed(scene, range(first, first + SEEDS))]
    mean, variance = (np.array(each) for each in zip(*some, strict=True))
    return mean, variance


def check(one: Array, other: Array) -> None:
    """Compare the sums and the pixels of two sets of images by Welch's t-tests of batch means.

    The sum may differ to either side; a pixel of the first may not be below the second.
    """
    sums = stats.ttest_ind(one.sum((1, 2)), other.sum((1, 2)), equal_var=False)
    assert sums.pvalue > LEVEL / (2.0 * len(COMBINATIONS)), one.sum() / other.sum()
    lit = other.std(0) > 0.0
    below = stats.ttest_ind(one[:, lit], other[:, lit], equal_var=False, alternative="less").pvalue
    assert below.min() > LEVEL / (2.0 * len(COMBINATIONS) * lit.sum())


def as_complex(points: Array) -> NDArray[np.complex128]:
    """Return points as single numbers, which a set operation can compare, to 9 digits after the point."""
    x, y = points.round(9).T
    return x + 1j * y


def check_by_forward(number: int) -> None:
    """Compare a camera's adjoint images with those of the forward method."""
    # Their errors are those of the seeds.
    of = camera(*COMBINATIONS[number], **{"transport.replicates": 1})
    adjoint, _ = images(of, 1 + 2 * SEEDS * number)
    forward, _ = images(
        of.changed({"transport.method": "forward", "transport.samples": 1024}), 1 + SEEDS * (2 * number + 1)
    )
    check(adjoint, forward)


@pytest.mark.parametrize("number", instances([2, 13, 21, 44], long=[13, 21, 44]))
def test_few_pixels_have_the_light_of_the_forward_method(number: int) -> None:
    check_by_forward(number)


@pytest.mark.long
@pytest.mark.parametrize("number", range(len(COMBINATIONS)))
def test_few_pixels_of_many_cameras_have_the_light_of_the_forward_method(number: int) -> None:
    check_by_forward(number)


def test_few_pixels_have_the_light_of_the_mesh_engine_and_errors_of_the_size_of_their_scatter() -> None:
    """Pooled over pixels, the variance that images state is that of the scatter over seeds, by a factor of 1.25²."""
    of = camera(1.5, 5.6, "hexagonal")
    sequential, stated = images(of, 20_001)
    meshes, _ = images(of.changed({"transport.engine": "mesh"}), 30_001)
    check(sequential, meshes)
    found = sequential.var(axis=0, ddof=1).sum()
    assert 0.8**2 < np.nansum(stated) / SEEDS / found < 1.25**2


@pytest.mark.parametrize("tilt_deg", [0.0, 8.0])
@pytest.mark.parametrize("seed", instances(range(6), long=[3, 4, 5]))
def test_every_lenslet_that_shows_the_opening_to_a_point_of_a_pixel_is_listed(seed: int, tilt_deg: float) -> None:
    """By the condition of a single point, for points all over a pixel, its corners among them."""
    of = draw("camera", seed, (*LEFT_OUT, "cover", "tilted_sensor", "phase_on_the_lens", "phase_on_the_array")).scene
    assert of.camera.mla is not None
    pixel = of.camera.mla.pitch_mm / 1.7
    world = lf.build(
        of.changed(
            {"camera.sensor.pixels": (8, 8), "camera.sensor.pixel_mm": pixel,
             "camera.sensor.pose.tilt_deg": (tilt_deg, -0.6 * tilt_deg, 30.0)}
        )
    )  # fmt: skip
    aim, mla, frames = world.aim.lenslets, world.tables.mla, world.tables.frames
    centres, radius = mla.lenslets.lattice.centres().reshape(-1, 2), np.sqrt(np.maximum(aim.slope_radius2, 0.0))
    to_array = frames[SENSOR_FRAME, MLA_FRAME]
    near = np.zeros((most_listed(aim, aim.search) + 1, LISTED))
    extent = pixel_extent(world.tables.sensor, frames)
    random = np.random.default_rng(seed)
    shown = 0
    for middle in (random.integers(0, 8, (150, 2)) - 3.5) * pixel:
        centre = to_array[:, :2] @ middle + to_array[:, 3]
        listed = list_cells(ArraySeen(mla, aim, 1.0), tuple(centre), extent, aim.search, near)
        known = as_complex(near[:listed, :2])
        for off in (random.choice([-0.5, 0.5], 2), random.uniform(-0.5, 0.5, 2)):
            point = to_array[:, :2] @ (middle + off * pixel) + to_array[:, 3]
            slope = (centres - point[:2]) / abs(point[2] - aim.apex_z) - aim.slope
            shows = (np.hypot(*slope.T) <= radius) & (aim.slope_radius2 >= 0.0)
            shown += shows.sum()
            assert np.isin(as_complex(centres[shows]), known).all()
    assert shown > 20
