"""Random cameras whose lenslets diffract: default, mesh engine and forward method show the same light.

Of the drawn cameras few ask for diffraction. Here all that have an array do, where that is possible.
"""

from collections.abc import Callable

import pytest

import lfmesh as lf
from tests.instances import instances
from tests.random_scenes.examine import FAILURES
from tests.random_scenes.generator import OWN_KERNELS, draw
from tests.random_scenes.judge import judge, ways

SAMPLES = 24
"""A pixel, in each of the judge's batches."""

CAMERAS = (
    0, 1, 2, 3, 4, 5, 7, 8, 11, 13, 14, 15, 17, 18, 19, 21, 23, 24, 25, 26, 28, 29, 30, 31, 32, 33, 34, 36, 37, 38,
)  # fmt: skip
"""Numbers of the first 30 drawn cameras whose lenslets can diffract."""

IN_SUITE = (1, 3)
"""Square and hexagonal lenslets, so small that pictures without diffraction are told from those with it."""


def diffracting(number: int) -> lf.Scene:
    """Return a drawn camera, without features that compile kernels of their own, whose lenslets diffract."""
    return draw("camera", number, OWN_KERNELS).scene.changed({"transport.diffraction": "lenslets"})


@pytest.mark.parametrize("number", instances(CAMERAS, long=[n for n in CAMERAS if n not in IN_SUITE]))
def test_all_ways_to_render_a_camera_whose_lenslets_diffract_agree_or_warn(
    number: int, record_property: Callable[[str, object], None]
) -> None:
    found = judge(ways(diffracting(number)), SAMPLES)
    record_property("random scene", (f"diffracting camera {number}", found.outcome, str(found)))
    assert found.outcome not in FAILURES, f"{found}\n\n{diffracting(number).dump_toml()}"
