"""The automaton of paths: each string of steps is in exactly one class, the one that the rule in words gives.

The rule is written here a second time, as questions about whole strings; the automaton goes step by step.
"""

from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from lfmesh.transport.paths.automaton import (
    AT_GLASS,
    COUNTS,
    EVERY,
    FACE_AGAIN,
    FACE_AGAIN_ALONG_CURVE,
    FROM_LAMP,
    GHOSTS,
    LAMP_ON_CAMERA,
    LAMP_THROUGH_GLASS,
    NEVER,
    NEXT_LENSLET,
    NOT_YET,
    OFF_FACE,
    OFF_GLASS,
    OFF_IMAGE_PATH,
    ON_IMAGE_PATH,
    ON_ROUGH_FACE,
    OTHER_STRAYS,
    OUT_OF_LENS,
    STANDING,
    State,
)

LENGTH = 8
"""Steps of a string. Glass changes nothing on paths from the sensor, so shorter strings are among them."""

STEPS = np.stack([OFF_FACE, FACE_AGAIN, NEXT_LENSLET, OUT_OF_LENS, AT_GLASS, OFF_GLASS])
FACE, AGAIN, LENSLET, OUT, GLASS, BESIDE_GLASS = range(len(STEPS))


@pytest.fixture(scope="module")
def strings() -> NDArray[np.int8]:
    """All strings of steps, (strings, LENGTH)."""
    return np.array(np.meshgrid(*[np.arange(len(STEPS), dtype=np.int8)] * LENGTH)).reshape(LENGTH, -1).T


def after(strings: NDArray[np.int8], start: int) -> NDArray[np.int64]:
    """Return the state after all steps, (strings,)."""
    state = np.full(len(strings), start)
    for step in strings.T:
        state = STEPS[step, state].astype(np.int64)
    return state


def test_every_path_from_the_sensor_is_in_exactly_one_class_that_of_the_rule(strings: NDArray[np.int8]) -> None:
    strings = strings[(strings == OUT).any(axis=1)]  # a path ends in object space
    inside = np.cumsum(strings == OUT, axis=1) == 0
    turns = np.isin(strings, [FACE, LENSLET, BESIDE_GLASS])
    breaks = turns | (strings == AGAIN)
    two_reflections = ((strings == FACE) & inside).sum(axis=1) == 2
    ghost = two_reflections & (breaks.sum(axis=1) == 2)
    stray = turns.any(axis=1) & ~ghost

    found = STANDING[:, after(strings, ON_IMAGE_PATH)] == COUNTS
    np.testing.assert_array_equal(found[OFF_IMAGE_PATH], turns.any(axis=1))
    np.testing.assert_array_equal(found[GHOSTS], ghost)
    np.testing.assert_array_equal(found[OTHER_STRAYS], stray)
    assert not found[[LAMP_THROUGH_GLASS, LAMP_ON_CAMERA]].any()


@pytest.mark.parametrize("before", [OFF_FACE, FACE_AGAIN, AT_GLASS])
def test_a_path_that_turns_back_in_gradient_glass_is_another_stray(before: NDArray[np.int8]) -> None:
    """Neither the image path nor a sequence of two reflections follows it, whatever comes before and after."""
    for first in (ON_IMAGE_PATH, int(before[ON_IMAGE_PATH]), int(before[before[ON_IMAGE_PATH]])):
        for after_turn in STEPS:
            state = int(after_turn[FACE_AGAIN_ALONG_CURVE[first]])
            assert [int(of) for of in np.flatnonzero(STANDING[:, state] == COUNTS)] == [
                EVERY, OFF_IMAGE_PATH, OTHER_STRAYS,
            ]  # fmt: skip


def test_light_of_a_lamp_is_in_the_class_of_what_it_meets_before_it_is_scattered(strings: NDArray[np.int8]) -> None:
    state = after(strings, FROM_LAMP)
    through_glass = np.isin(strings, [GLASS, BESIDE_GLASS]).any(axis=1)
    found = STANDING[:, state] == COUNTS
    np.testing.assert_array_equal(found[LAMP_THROUGH_GLASS], through_glass)
    assert not found[[OFF_IMAGE_PATH, LAMP_ON_CAMERA, GHOSTS, OTHER_STRAYS]].any()
    on_camera = STANDING[:, ON_ROUGH_FACE[state]] == COUNTS
    assert on_camera[LAMP_ON_CAMERA].all()
    assert not on_camera[[OFF_IMAGE_PATH, LAMP_THROUGH_GLASS, GHOSTS, OTHER_STRAYS]].any()


@pytest.mark.parametrize(("of", "state"), list(product(range(len(STANDING)), State)))
def test_what_counts_not_yet_may_still_count_and_what_never_counts_may_not(of: int, state: State) -> None:
    reached = {int(state)}
    for _ in State:
        reached |= {int(step[s]) for step in (*STEPS, ON_ROUGH_FACE) for s in reached}
    may = any(STANDING[of, s] == COUNTS for s in reached)
    if STANDING[of, state] == NOT_YET:
        assert may
    if STANDING[of, state] == NEVER and state < FROM_LAMP and of in (OFF_IMAGE_PATH, OTHER_STRAYS):
        assert not may
