"""Stated errors of pixels, blocks and image sums are the scatter over independent seeds, for every kind of scene.

Each scene of the assets is cut to a few pixels. The scatter of pixels and of 2 × 2 blocks is pooled over the picture,
over PIXEL_SEEDS seeds; that of the whole image's sum is over SUM_SEEDS seeds. A ratio fails where it is surely outside
WITHIN, by SIGMAS of its own error (jackknife over seeds).

Packets of one particle are shared out among pixels: of a fixed number, what falls on one pixel does not fall on the
next. So pixels go up where others go down, and a sum is known better than the squares of its pixels' errors say. There
the stated error of blocks and sums may be too large, never too small.
"""

from itertools import islice
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.accuracy.reported_error import CROPS, crop
from lfmesh.assets import asset_path
from tests.instances import instances
from tests.renders import by_seed

Array = NDArray[np.float64]

WITHIN = (0.8, 1.25)
PIXEL_SEEDS, SUM_SEEDS = 24, 100
SIGMAS = 3.5
SIDE = 8
"""Pixels along each side of a crop."""

FORWARD = {"transport.method": "forward", "transport.samples": 1024}
RED = {
    "camera.sensor.bands": "rgb",
    "lights[0].spectrum": "D65",
    "targets[0].material.reflectance": {"wavelengths_nm": [380, 570, 630, 780], "values": [0.05, 0.05, 0.8, 0.8]},
}
"""Bands, and a coloured target: wavelengths matter."""
LIT = {
    "targets[0].material": {"reflectance": 0.6},
    "targets[1].material.radiance_w_m2_sr": 0.0,
    "lights": [{"kind": "point", "position_mm": [-60.0, 150.0, -260.0], "power_w": 10.0}],
    "camera.sensor.pixel_mm": 0.5,
}
"""The forward method starts no light in a liquid: a lamp outside lights what is in the tank, seen by large pixels."""
FEW_PARTICLES = {"camera.sensor.pixel_mm": 1.0, "particles[0].count": 300}
"""Over the whole field, so that each is drawn in a picture of few pixels."""

CASES: dict[str, tuple[str, dict[str, Any]]] = {
    **{name: (name, {}) for name in CROPS},
    "particles": ("particles", FEW_PARTICLES),
    "red chart in bands": ("lit_chart", RED),
    "red chart in bands, 64 replicates": ("lit_chart", RED | {"transport.replicates": 64, "transport.samples": 256}),
    "a sensor that reflects": ("coated", {"camera.sensor.reflectance": 0.3}),
    **{f"{name}, forward": (name, FORWARD) for name in (
        "aquarium", "coated", "conventional", "emitting_plane", "fog", "glossy", "lit_chart",
    )},
    "a lit tank": ("tank", LIT),
    "a lit tank, forward": ("tank", FORWARD | LIT),
}  # fmt: skip
"""Scenes of the assets, and what is changed in them."""

SHARED = ("particles",)
"""Cases in which pixels share the packets of a source."""

LONG = [case for case in CASES if case != "lit_chart"]


def images(case: str) -> list[lf.Image]:
    name, changes = CASES[case]
    scene = crop(lf.load(asset_path(f"scenes/{name}.toml")), SIDE, CROPS[name])
    settings = {"transport.samples": 64, "transport.replicates": 8, "transport.threads": 1}
    return list(islice(by_seed(scene.changed(settings | changes), range(SUM_SEEDS)), SUM_SEEDS))


def blocks(of: Array) -> Array:
    """Sum 2 × 2 pixels of a stack (seeds, H, W, channels)."""
    seeds, height, width, channels = of.shape
    return of.reshape(seeds, height // 2, 2, width // 2, 2, channels).sum(axis=(2, 4))


def scatter_over_stated(light: Array, variance: Array) -> tuple[float, float]:
    """Return root mean square scatter over stated error, of stacks (seeds, ...), and the ratio's own error."""
    seeds = len(light)
    light, variance = light.reshape(seeds, -1), variance.reshape(seeds, -1)

    def ratio(kept: Array) -> float:
        return float(np.sqrt(light[kept].var(axis=0, ddof=1).sum() / variance[kept].mean(axis=0).sum()))

    all_seeds = np.arange(seeds)
    without = np.array([ratio(np.delete(all_seeds, one)) for one in all_seeds])
    error = np.sqrt((seeds - 1) / seeds * ((without - without.mean()) ** 2).sum())
    return ratio(all_seeds), float(error)


def ratios(found: list[lf.Image]) -> dict[str, tuple[float, float]]:
    """Return scatter over stated error, with its own error, of pixels, blocks and sums of each channel."""
    light, variance = (np.stack([of(image) for image in found]) for of in (lambda i: i.mean, lambda i: i.stderr**2))
    few, few_variances = light[:PIXEL_SEEDS], variance[:PIXEL_SEEDS]
    pooled = np.stack([image.error**2 for image in found[:PIXEL_SEEDS]])
    sums = {
        f"sum of channel {c}": scatter_over_stated(light[..., c].sum(axis=(1, 2)), variance[..., c].sum(axis=(1, 2)))
        for c in range(light.shape[-1])
    }
    return {
        "pixels": scatter_over_stated(few, few_variances),
        "pixels by their pool": scatter_over_stated(few, pooled),
        "blocks": scatter_over_stated(blocks(few), blocks(few_variances)),
        **sums,
    }


def off(found: dict[str, tuple[float, float]], lowest: float = WITHIN[0]) -> list[str]:
    """Return the ratios that are surely outside what is allowed, or no numbers for want of light.

    Parameters
    ----------
    found : dict of str to (float, float)
    lowest : float
        Ratio of blocks and sums that is still allowed.
    """
    low = {name: WITHIN[0] if name.startswith("pixels") else lowest for name in found}
    return [
        f"{name}: scatter {ratio:.2f} ± {error:.2f} of the stated error"
        for name, (ratio, error) in found.items()
        if not (ratio + SIGMAS * error >= low[name] and ratio - SIGMAS * error <= WITHIN[1])
    ]


@pytest.mark.parametrize("case", instances(CASES, long=LONG))
def test_stated_errors_are_the_scatter_over_seeds(case: str) -> None:
    assert off(ratios(images(case)), 0.0 if case in SHARED else WITHIN[0]) == []


@pytest.mark.long
@pytest.mark.parametrize("case", SHARED)
def test_sums_of_pixels_that_share_packets_are_known_better_than_stated(case: str) -> None:
    ratio, error = ratios(images(case))["sum of channel 0"]
    assert ratio + SIGMAS * error < 1.0


def test_every_scene_of_the_assets_has_a_crop() -> None:
    scenes = {path.stem for path in asset_path("scenes").glob("*.toml")}
    assert set(CROPS) == scenes


def test_an_error_that_many_pixels_share_is_seen_in_blocks_and_sums() -> None:
    """Pictures whose pixels go up and down together, by half of each pixel's spread: sums scatter more than stated."""
    draw = np.random.default_rng(3)
    own = draw.normal(0.0, 1.0, (SUM_SEEDS, SIDE, SIDE, 1))
    together = own + 0.5 * draw.normal(0.0, 1.0, (SUM_SEEDS, 1, 1, 1))
    for light, seen in ((own, False), (together, True)):
        variance = np.full_like(light, light.var(axis=0).mean())
        ratio, error = scatter_over_stated(light.sum(axis=(1, 2)), variance.sum(axis=(1, 2)))
        assert (ratio - SIGMAS * error > WITHIN[1]) == seen
