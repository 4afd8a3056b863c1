"""Pictures of the forward method that lack light are told wrong by paths from the pixels; right ones are not."""

from typing import Any

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.transport.checks.blind_check import LEVEL
from lfmesh.transport.render.render import Renderer
from tests.transport.checks.test_picture_warnings import scene, warned


def shining(z_mm: float, width_mm: float, radiance: float) -> dict[str, Any]:
    return {
        "shape": {"kind": "plane", "width_mm": width_mm, "height_mm": width_mm},
        "position_mm": (0.0, 0.0, z_mm),
        "material": {"reflectance": 0.0, "radiance_w_m2_sr": radiance},
    }


FORWARD = {
    "camera.sensor.pixel_mm": 0.5,
    "transport.method": "forward",
    "transport.samples": 256,
    "transport.replicates": 8,
}


@pytest.mark.parametrize("beside", [True, False])
def test_a_small_emitter_beside_a_powerful_one_is_told_missing(beside: bool) -> None:
    """Packets start by power: hardly any at the plate in the field, nearly all at a wall that it hides."""
    wall = [shining(-2000.0, 2000.0, 300.0)] if beside else []
    given = scene(targets=[shining(-100.0, 12.0, 1.0), *wall], **FORWARD)
    image, said = warned(lambda: lf.render(given))
    truth = lf.render(given.changed({"transport.method": "adjoint"}))
    lacks = image.mean.sum() < 0.5 * truth.mean.sum()
    assert lacks == beside
    assert (lf.BlindCheckWarning in map(type, said)) == beside


WALL = {"shape": {"kind": "plane", "width_mm": 12.0, "height_mm": 12.0}, "position_mm": (0.0, 0.0, -100.0)}
LAMP = {"kind": "point", "position_mm": (60.0, 0.0, -60.0), "power_w": 1.0}


def test_light_of_lamps_through_glass_that_paths_from_pixels_do_not_find_is_no_fault() -> None:
    """A block of glass stands between lamp and wall: the forward picture has its light, paths from pixels do not."""
    block = {"refractor": {"box_mm": (20.0, 20.0, 20.0), "index": 1.5}, "position_mm": (30.0, 0.0, -80.0)}
    image, said = warned(lambda: lf.render(scene(targets=[WALL, block], lights=[LAMP], **FORWARD)))
    assert image.blind is not None
    assert image.mean.sum() > 20.0 * np.sqrt((image.stderr**2).sum())
    assert image.blind.hits == 0
    assert lf.BlindCheckWarning not in map(type, said)


def test_a_forward_picture_that_is_right_is_seldom_called_wrong() -> None:
    """Not more often than the level says, by a binomial test at 1e-3."""
    world = lf.build(scene(targets=[WALL], lights=[LAMP], **FORWARD))
    checks = [Renderer(world.reseeded(seed)).image().blind for seed in range(40)]
    assert all(check is not None and check.hits > 100 for check in checks)
    wrong = sum(not check.agrees for check in checks if check is not None)
    assert stats.binomtest(wrong, 40, 2.0 * LEVEL, alternative="greater").pvalue > 1e-3
