"""The error that an image reports is the error that it has, against long renders of crops of the scenes in assets."""

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.accuracy.reported_error import CROPS, coverage, crop, error_ratios, sampled, study_errors
from lfmesh.assets import asset_path
from lfmesh.files import words

WITHIN = (0.8, 1.25)
"""Reported over true error in groups that the reference makes."""

OF_QUARTERS = 2.5
"""By what factor they may differ in quarters of the reported error itself."""

FOR_QUARTERS = 4
"""Replicates from which on they are held to it: the spread of two is anything."""

SIGMAS = 3.5
"""Of a ratio's own error, in some dozen ratios a test: one in 200 tests would fail by chance."""


def scene(name: str, side: int) -> lf.Scene:
    return crop(lf.load(asset_path(f"scenes/{name}.toml")), side, CROPS[name])


def off(image: lf.Image, reference: lf.Image, error: np.ndarray | None = None) -> list[str]:
    """Return the groups in which reported and true error surely differ by more than they may."""
    found = []
    for ratio in error_ratios(image, reference, error):
        by_report = ratio.group.startswith("reported")
        if by_report and image.replicates < FOR_QUARTERS:
            continue
        low, high = (1.0 / OF_QUARTERS, OF_QUARTERS) if by_report else WITHIN
        if ratio.ratio + SIGMAS * ratio.stderr < low or ratio.ratio - SIGMAS * ratio.stderr > high:
            found.append(f"{ratio.group}: {ratio.ratio:.2f} ± {ratio.stderr:.2f}")
    return found


def test_the_reported_error_is_true_and_a_pixels_own_spread_is_not() -> None:
    """32 samples: of two replicates, a quarter of the pixels have a spread that is far too small."""
    small = scene("lytro_class", 48)
    image, reference = sampled(small, 32, 4, 1), sampled(small, 2048, 8, 0)
    assert off(image, reference) == []
    two = sampled(small, 32, 2, 1)
    smallest = next(r for r in error_ratios(two, reference, two.stderr) if r.group.startswith("reported 0"))
    assert smallest.ratio + SIGMAS * smallest.stderr < 1.0 / OF_QUARTERS
    # Errors twice or half the truth are seen.
    assert off(image, reference, 2.0 * image.error)
    assert off(image, reference, 0.5 * image.error)


@pytest.mark.long
@pytest.mark.parametrize("name", CROPS)
def test_the_reported_error_is_true_or_the_run_says_that_samples_are_too_few(name: str) -> None:
    for image, reference in study_errors(scene(name, 64), (8, 32, 128, 512), (2, 4, 8), 4096):
        too_few = "too few samples" in " ".join(words.summary(image))
        transport = image.scene.transport
        case = f"{transport.samples} samples in {transport.replicates} replicates"
        assert too_few or off(image, reference) == [], case
        assert not too_few or transport.samples < 32, case


@pytest.mark.long
@pytest.mark.parametrize("name", ["conventional", "lit_chart"])
@pytest.mark.parametrize("replicates", [2, 4, 8])
def test_single_pixels_are_covered_as_student_says(name: str, replicates: int) -> None:
    """1, 2 and 3 standard errors, within two points and what chance adds."""
    small = scene(name, 64)
    image, reference = sampled(small, 128, replicates, 1), sampled(small, 8192, 8, 0)
    for covered in coverage(image, reference):
        chance = np.sqrt(covered.expected * (1.0 - covered.expected) / covered.pixels)
        assert covered.found == pytest.approx(covered.expected, abs=0.02 + SIGMAS * chance), covered
