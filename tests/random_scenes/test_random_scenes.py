"""Default, mesh engine and forward method show the same light for random cameras and scenes, or say that they do not.

`--random-scenes 40:80` chooses the numbers 40 to 79; a failure's message is the smallest scene that fails, as a file of
the folder of assets.
"""

from collections.abc import Callable

import pytest

from tests.random_scenes.examine import FAILURES, IN_SUITE, left_out, outcome, smallest
from tests.random_scenes.generator import Kind, draw

SAMPLES, LONG_SAMPLES = 24, 96
"""A pixel, in each of the judge's batches."""

Record = Callable[[str, object], None]


def examine(kind: Kind, number: int, record: Record) -> None:
    drawn, samples = draw(kind, number, left_out(number)), SAMPLES if number < IN_SUITE else LONG_SAMPLES
    found, words = outcome(drawn, samples)
    record("random scene", (f"{kind} {number}", found, words))
    if found in FAILURES:
        pytest.fail(f"{words}\n\nthe smallest scene that fails:\n{smallest(drawn, samples).toml}", pytrace=False)


def test_all_ways_to_render_a_random_camera_agree_or_warn(camera_number: int, record_property: Record) -> None:
    examine("camera", camera_number, record_property)


def test_all_ways_to_render_a_random_scene_agree_or_warn(scene_number: int, record_property: Record) -> None:
    examine("scene", scene_number, record_property)
