"""The judge sees what differs, and rarely what does not; a call that never ends is ended."""

import time
import warnings
from collections.abc import Callable

import numpy as np
import pytest

import lfmesh as lf
from tests.cameras import camera_without_array
from tests.random_scenes import examine, time_limit
from tests.random_scenes.judge import (
    FEW_HITS,
    SCREEN,
    SEEDS,
    Batches,
    Difference,
    Estimate,
    compare,
    in_places,
    judge,
    places,
    tells_of,
)
from tests.random_scenes.time_limit import TookTooLongError, within

PLANE = {"shape": {"kind": "plane", "width_mm": 200.0, "height_mm": 200.0}, "position_mm": [0.0, 0.0, -150.0]}


def white(radiance: float = 1.0) -> lf.Scene:
    """A conventional camera of 6 × 6 pixels before a plane that shines."""
    return lf.Scene(
        camera=camera_without_array(),
        targets=[{**PLANE, "material": {"reflectance": 0.0, "radiance_w_m2_sr": radiance}}],
        transport={"split": "transmit", "threads": 1},
    )


def test_equal_scenes_agree_and_one_per_cent_more_light_is_seen() -> None:
    same = judge([Estimate("one", (white(),)), Estimate("other", (white(),))], 16)
    assert same.outcome == "agree"
    brighter = judge([Estimate("one", (white(),)), Estimate("other", (white(1.01),))], 16)
    assert brighter.outcome == "silent"
    assert brighter.differences[0].ratio == pytest.approx(1.01, abs=0.003)


def test_estimates_are_sums_and_have_factors() -> None:
    halves = Estimate("halves", (white(0.5), white(0.5)))
    tenfold = Estimate("a tenth of ten", (white(10.0),), 0.1)
    assert judge([Estimate("one", (white(),)), halves, tenfold], 16).outcome == "agree"


def test_a_single_pixel_is_seen_in_its_place() -> None:
    scene = white()
    names = places(scene)
    image = np.zeros((6, 6, 1))
    image[2, 4] = 1.0
    lit = [name for name, value in zip(names, in_places(image), strict=True) if value]
    assert lit == ["total", "second quarter", "pixel (2, 4)"]


def test_batches_of_equal_means_are_screened_as_often_as_stated() -> None:
    """Normal batches; the number of scenes in which any place is doubtful is binomial, within four deviations."""
    draw = np.random.default_rng(1)
    scenes, count = 2000, 40
    full = np.full(count, 10.0 * FEW_HITS)
    doubtful = 0
    for _ in range(scenes):
        one, other = (Batches(draw.normal(1.0, s, (SEEDS, count)), full) for s in (0.1, 0.3))
        doubtful += bool((compare(one, other)[0] < SCREEN / count).any())
    assert abs(doubtful - scenes * SCREEN) < 4.0 * np.sqrt(scenes * SCREEN)


def test_a_place_without_hits_is_known_no_better_than_packets_by_chance() -> None:
    """One method expects two packets of the other's weight in all batches, which found none: that is no disagreement.

    That it finds none of a thousand is one.
    """
    surely = Batches(np.full((SEEDS, 2), [100.0, 1.0]), np.full(2, 1e6))
    none = Batches(np.full((SEEDS, 2), [100.0, 0.0]), np.array([200.0 * SEEDS / 2.0, 0.0]))
    assert compare(surely, none)[0][1] < 1e-3
    seldom = Batches(np.full((SEEDS, 2), [100.0, 0.0]), np.array([2.0 * SEEDS, 0.0]))
    assert compare(surely, seldom)[0][1] > 1e-6


def test_a_difference_is_silent_unless_one_of_the_runs_has_warned(monkeypatch: pytest.MonkeyPatch) -> None:
    render = lf.render

    def warns(scene: lf.Scene) -> lf.Image:
        if scene == scene.changed({"targets[0].material.radiance_w_m2_sr": 1.2}):
            warnings.warn("too bright", lf.MissedLightWarning, stacklevel=2)
        return render(scene)

    monkeypatch.setattr(lf, "render", warns)
    verdict = judge([Estimate("one", (white(),)), Estimate("other", (white(1.2),))], 16)
    assert verdict.outcome == "warned"
    assert "too bright" in str(verdict)


def test_a_warning_of_little_lost_energy_tells_of_no_large_difference() -> None:
    difference = Difference("forward", "total", 0.4, -50.0)
    assert not tells_of("LostEnergyWarning: 2.2e-07 of the energy was lost", difference)
    assert tells_of("LostEnergyWarning: 0.3 of the energy was lost", difference)
    assert tells_of("MissedLightWarning: fog is found too seldom", difference)


def test_what_is_refused_is_no_disagreement() -> None:
    """The sequential engine refuses a diffuse surface."""
    diffuse = white().changed({"camera.lens.surfaces[0].finish": "diffuse", "transport.engine": "sequential"})
    verdict = judge([Estimate("one", (white(),)), Estimate("other", (white(),)), Estimate("third", (diffuse,))], 16)
    assert verdict.outcome == "agree"
    assert list(verdict.refused) == ["third"]


def test_a_call_that_never_ends_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    assert within(60.0, sum, [1, 2]) == 3
    with monkeypatch.context() as patched:
        patched.setattr(time_limit, "WAITS", 5.0)
        with pytest.raises(TookTooLongError, match="sleep"):
            within(0.2, time.sleep, 3600.0)
    with pytest.raises(TookTooLongError, match="of a processor"):
        within(0.2, sum, range(10**15))
    with pytest.raises(RuntimeError, match="TypeError"):
        within(60.0, sum, 1)


def test_a_judgement_that_takes_too_long_is_made_again_with_fewer_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    def in_time(limit: float, function: Callable[..., float], *arguments: float) -> float:
        if arguments[-1] > limit:
            raise TookTooLongError
        return function(*arguments)

    monkeypatch.setattr(examine, "within", in_time)
    assert [examine.judged(12.0, max, 0, samples) for samples in (12, 96)] == [12, 96 // examine.FEWER]
    with pytest.raises(TookTooLongError):
        examine.judged(12.0, max, 0, 13 * examine.FEWER)
