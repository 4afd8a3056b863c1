"""Random cameras and scenes before the judge, each within a time limit, and failing ones made as small as can be."""

from collections.abc import Callable, Collection
from typing import Any

from tests.random_scenes.generator import OWN_KERNELS, Drawn, Kind, draw, smaller
from tests.random_scenes.judge import Verdict, judge, ways
from tests.random_scenes.time_limit import TookTooLongError, within

CAMERAS, SCENES = 300, 200
IN_SUITE = 12
"""Numbers of each kind that the suite examines; they have no features that compile kernels of their own."""

REPEATED: dict[Kind, Collection[int]] = {"camera": (1, 6, 8, 9, 10, 11), "scene": (1, 2, 5, 8, 11)}
"""Numbers below that all of whose features others below it have, of either kind: long tests."""

LONGEST_S = 600.0
"""A judgement that has not ended after so much of a processor is slow, or does not end; compiling may take minutes."""

FEWER = 32
"""A judgement that took too long is made once more with the samples over this number."""

FAILURES = ("silent", "endless")


def left_out(number: int) -> Collection[str]:
    """Return the features that a number does not have."""
    return OWN_KERNELS if number < IN_SUITE else ()


def verdict_on(kind: Kind, number: int, without: Collection[str], attempt: int | None, samples: int) -> Verdict:
    """Judge the ways to render a drawn scene."""
    return judge(ways(draw(kind, number, without, attempt).scene), samples)


def judged(longest_s: float, function: Callable[..., Any], *arguments: Any) -> Any:
    """Return what a judgement returns; one that takes too long, as where paths are long, is made with fewer samples.

    Parameters
    ----------
    longest_s : float
        Of each of the two attempts.
    function : callable
        Makes the judgement.
    *arguments : object
        The last one is the number of samples.

    Raises
    ------
    TookTooLongError
        It does not end with fewer samples either.
    """
    *scene, samples = arguments
    try:
        return within(longest_s, function, *scene, samples)
    except TookTooLongError:
        return within(longest_s, function, *scene, max(1, samples // FEWER))


def outcome(drawn: Drawn, samples: int, longest_s: float = LONGEST_S) -> tuple[str, str]:
    """Return in one word how the judgement of a drawn scene ends, and the verdict in words.

    Parameters
    ----------
    drawn : Drawn
    samples : int
        A pixel, in each batch.
    longest_s : float
    """
    try:
        verdict = judged(longest_s, verdict_on, drawn.kind, drawn.number, drawn.without, drawn.attempt, samples)
    except TookTooLongError as error:
        return "endless", str(error)
    return verdict.outcome, str(verdict)


def smallest(drawn: Drawn, samples: int, longest_s: float = LONGEST_S) -> Drawn:
    """Leave out every feature without which a scene still fails."""
    for one in smaller(drawn):
        if outcome(one, samples, longest_s)[0] in FAILURES:
            return smallest(one, samples, longest_s)
    return drawn
