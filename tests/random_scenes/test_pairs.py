"""Every two features that meet in one place: the forward and the adjoint method show the same light.

The judge's level holds for each pair. A pair that lfmesh refuses says so in one clear line.
"""

from typing import Any

import pytest

import lfmesh as lf
from tests.random_scenes.examine import LONGEST_S, judged
from tests.random_scenes.judge import Estimate, Verdict, judge
from tests.random_scenes.pairs import FEATURES, pairs, scene_of_pair

SAMPLES, LONG_SAMPLES = 16, 96
"""A pixel, in each of the judge's batches."""

IN_SUITE = {("gloss", "temperature"), ("opacity", "texture"), ("hexagons", "multi-focus")}
"""Pairs without kernels of their own that the suite examines, all others are long tests."""

MAY_BE_REFUSED = {
    ("gloss", "tank"),
    ("gloss", "polarisation"),
    ("cover", "polarisation"),
    ("polarisation", "diffraction"),
    ("particles", "diffraction"),
}

NO_LINES = pytest.mark.skipif(not hasattr(lf, "LineLight"), reason="line lamps are not there yet")

LONGEST_LINE = 320

MORE, MANY_MORE = 4, 16
"""Packets of the forward method, over the samples of the adjoint one."""

FEW_ARRIVE = {"tank", "glass", "diffraction"}
"""Features whose forward packets seldom meet the sensor: it is small, or they come back through glass."""


def cases() -> list[Any]:
    return [
        pytest.param(
            one, other, id=f"{one}-{other}".replace(" ", "_"),
            marks=[pytest.mark.long] * ((one, other) not in IN_SUITE) + [NO_LINES] * ("line lamp" in (one, other)),
        )
        for one, other in pairs()
    ]  # fmt: skip


def verdict_on(one: str, other: str, samples: int) -> Verdict:
    adjoint = scene_of_pair(one, other)
    forward = adjoint.changed({"transport.method": "forward"})
    more = MANY_MORE if FEW_ARRIVE & {one, other} else MORE
    return judge([Estimate("adjoint", (adjoint,)), Estimate("forward", (forward,), 1.0, more)], samples)


def refusals(one: str, other: str) -> list[str]:
    said = []
    for method in ("adjoint", "forward"):
        try:
            lf.render(scene_of_pair(one, other).changed({"transport.method": method, "transport.samples": 8}))
        except lf.LfmeshError as error:
            said.append(str(error))
    return said


def test_there_are_scenes_of_every_two_features() -> None:
    assert len(pairs()) == len(FEATURES) * (len(FEATURES) - 1) // 2
    assert set(pairs()) >= IN_SUITE | MAY_BE_REFUSED
    assert {frozenset(pair) for pair in pairs()} == {frozenset((a, b)) for a in FEATURES for b in FEATURES if a != b}


@pytest.mark.parametrize(("one", "other"), cases())
def test_both_methods_agree_on_features_that_meet(one: str, other: str) -> None:
    if (one, other) in MAY_BE_REFUSED and (said := refusals(one, other)):
        assert len(said) == 2, said
        assert all("\n" not in line and len(line) <= LONGEST_LINE for line in said), said
        return
    samples = SAMPLES if (one, other) in IN_SUITE else LONG_SAMPLES
    verdict = judged(LONGEST_S, verdict_on, one, other, samples)
    assert not verdict.refused, verdict
    assert not verdict.is_dark, verdict
    assert not verdict.silent, f"{verdict}\n\n{scene_of_pair(one, other).dump_toml()}"
