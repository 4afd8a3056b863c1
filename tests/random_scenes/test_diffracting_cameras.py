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


SLOWER = 4.0
"""The f-number of a lens with a small stop over that of the drawn one: much light lies between the micro-images."""


def diffracting(number: int) -> lf.Scene:
    """Return a drawn camera, without features that compile kernels of their own, whose lenslets diffract."""
    return draw("camera", number, OWN_KERNELS).scene.changed({"transport.diffraction": "lenslets"})


def stopped_down(number: int) -> lf.Scene:
    """Return such a camera with a small stop."""
    scene = diffracting(number)
    f_number = SLOWER * lf.first_order(scene).working_f_number
    return scene.changed({"camera.lens.f_number": f_number, "camera.lens.stop_semi_diameter_mm": None})


def check(scene: lf.Scene, name: str, record_property: Callable[[str, object], None]) -> None:
    found = judge(ways(scene), SAMPLES)
    record_property("random scene", (name, found.outcome, str(found)))
    assert found.outcome not in FAILURES, f"{found}\n\n{scene.dump_toml()}"


@pytest.mark.parametrize("number", instances(CAMERAS, long=[n for n in CAMERAS if n not in IN_SUITE]))
def test_all_ways_to_render_a_camera_whose_lenslets_diffract_agree_or_warn(
    number: int, record_property: Callable[[str, object], None]
) -> None:
    check(diffracting(number), f"diffracting camera {number}", record_property)


@pytest.mark.long
@pytest.mark.parametrize("number", CAMERAS[1::2])
def test_all_ways_agree_or_warn_behind_a_small_stop(
    number: int, record_property: Callable[[str, object], None]
) -> None:
    check(stopped_down(number), f"diffracting camera {number}, stopped down", record_property)
