"""The error that an image reports is the error that it has, against long renders of crops of the scenes in assets."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.accuracy.reported_error import (
    CROPS,
    ErrorRatio,
    coverage,
    crop,
    error_ratios,
    mean_error_ratios,
    sampled,
    study_errors,
)
from lfmesh.assets import asset_path
from lfmesh.files import words
from lfmesh.transport.render.certainty import Certainty

WITHIN = (0.8, 1.25)
"""Reported over true error in groups that the reference makes."""

OF_QUARTERS = 2.5
"""By what factor they may differ in quarters of the reported error itself."""

FOR_QUARTERS = 4
"""Replicates from which on they are held to it: the spread of two is anything."""

SIGMAS = 3.5
"""Of a ratio's own error, in some dozen ratios a test: one in 200 tests would fail by chance."""

OTHERS = 24
"""Pictures that tell whether an error which is too large in one picture is so by chance."""

ENOUGH = 32
"""Samples a pixel from which on no picture is said to have too few."""

MORE = {"crossed_cylinders": 64, "particles": 1024}
"""In place of `ENOUGH`: half of the samples miss the openings of crossed lenslets, and most of them every particle."""


def scene(name: str, side: int) -> lf.Scene:
    return crop(lf.load(asset_path(f"scenes/{name}.toml")), side, CROPS[name])


def off(ratios: Sequence[ErrorRatio], replicates: int) -> list[ErrorRatio]:
    """Return those of the ratios of reported and true error that are surely beyond their bounds."""
    found = []
    for each in ratios:
        by_report = each.group.startswith("reported")
        if by_report and replicates < FOR_QUARTERS:
            continue
        low, high = (1.0 / OF_QUARTERS, OF_QUARTERS) if by_report else WITHIN
        if each.ratio + SIGMAS * each.stderr < low or each.ratio - SIGMAS * each.stderr > high:
            found.append(each)
    return found


def off_in_picture(image: lf.Image, reference: lf.Image, error: np.ndarray | None = None) -> list[ErrorRatio]:
    return off(error_ratios(image, reference, error), image.replicates)


def off_by_more_than_chance(image: lf.Image, reference: lf.Image) -> list[ErrorRatio]:
    """Return what is off in a picture, and where that is errors which are too large, in others of the same camera.

    A single heavy path in the light that few paths bring makes a picture report larger errors for all of its pixels,
    and blocks of that picture know nothing of the others. Errors that are too small are never excused.
    """
    found = off_in_picture(image, reference)
    if not found or any(each.ratio < 1.0 for each in found):
        return found
    transport = image.scene.transport
    seeds = range(10_000, 10_000 + OTHERS)
    others = (sampled(image.scene, transport.samples, transport.replicates, seed) for seed in seeds)
    return off(mean_error_ratios(others, reference), transport.replicates)


def test_the_reported_error_is_true_and_a_pixels_own_spread_is_not() -> None:
    """32 samples: of two replicates, a quarter of the pixels have a spread that is far too small."""
    small = scene("lytro_class", 48)
    image, reference = sampled(small, 32, 4, 1), sampled(small, 2048, 8, 0)
    assert off_in_picture(image, reference) == []
    two = sampled(small, 32, 2, 1)
    smallest = next(r for r in error_ratios(two, reference, two.stderr) if r.group.startswith("reported 0"))
    assert smallest.ratio + SIGMAS * smallest.stderr < 1.0 / OF_QUARTERS
    # Errors twice or half the truth are seen.
    assert off_in_picture(image, reference, 2.0 * image.error)
    assert off_in_picture(image, reference, 0.5 * image.error)


def test_errors_that_are_too_large_in_every_picture_are_not_taken_for_chance() -> None:
    small = scene("lytro_class", 48)
    reference = sampled(small, 2048, 8, 0)
    pictures = [sampled(small, 32, 4, seed) for seed in range(2, 8)]
    assert off(mean_error_ratios(pictures, reference), 4) == []
    for factor in (0.5, 2.0):
        wrong = [replace(each, certainty=Certainty(factor * each.error, each.upper)) for each in pictures]
        assert off(mean_error_ratios(wrong, reference), 4)


@pytest.mark.long
@pytest.mark.parametrize("name", CROPS)
def test_the_reported_error_is_true_or_the_run_says_that_samples_are_too_few(name: str) -> None:
    for image, reference in study_errors(scene(name, 64), (8, 32, 128, 512), (2, 4, 8), 4096):
        too_few = "too few samples" in " ".join(words.summary(image))
        transport = image.scene.transport
        case = f"{transport.samples} samples in {transport.replicates} replicates"
        assert too_few or off_by_more_than_chance(image, reference) == [], case
        assert not too_few or transport.samples < MORE.get(name, ENOUGH), case


@pytest.mark.long
@pytest.mark.parametrize("name", ["conventional", "lit_chart"])
@pytest.mark.parametrize("replicates", [2, 4, 8])
def test_single_pixels_are_covered_as_student_says(name: str, replicates: int) -> None:
    """1, 2 and 3 standard errors, within two points and what chance adds; a picture of one part."""
    small = scene(name, 64).changed({"transport.split": "transmit"})
    image, reference = sampled(small, 128, replicates, 1), sampled(small, 8192, 8, 0)
    for covered in coverage(image, reference):
        chance = np.sqrt(covered.expected * (1.0 - covered.expected) / covered.pixels)
        assert covered.found == pytest.approx(covered.expected, abs=0.02 + SIGMAS * chance), covered


@pytest.mark.long
def test_pixels_of_several_parts_are_covered_as_by_one_to_all_of_their_replicates() -> None:
    """The variance of a picture is the sum of its parts', each with degrees of freedom of its own (Satterthwaite)."""
    small, replicates, parts = scene("conventional", 64), 2, 3
    image, reference = sampled(small, 128, replicates, 1), sampled(small, 8192, 8, 0)
    for covered in coverage(image, reference):
        most = 1.0 - 2.0 * stats.t.sf(covered.sigmas, parts * (replicates - 1))
        chance = SIGMAS * np.sqrt(0.25 / covered.pixels)
        assert covered.expected - chance <= covered.found <= most + chance, covered
