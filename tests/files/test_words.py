"""What the end of a run says: true numbers, in sentences a user can act on."""

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.errors import in_order
from lfmesh.files import words
from lfmesh.scene import Lens, Scene, first_order
from lfmesh.scene.advice import doubtful
from lfmesh.transport.checks.blind_check import BlindCheck
from lfmesh.transport.checks.found import found
from lfmesh.transport.checks.order_check import OrderCheck

Build = Callable[..., lf.Image]


def text(image: lf.Image) -> str:
    image.warnings = in_order([*found(image), *doubtful(image.scene, first_order(image.scene))])
    return "\n".join(words.summary(image))


def test_noise_is_the_quartiles_over_lit_pixels(image_of: Build) -> None:
    # A thousand replicates, so that nothing is to be corrected.
    image = image_of(replicates=1000)
    image.mean[:] = 1e-18
    image.stderr[:] = 1e-18
    # Four strips of 20 columns that are no neighbours in brightness.
    for strip, error in enumerate((0.01, 0.02, 0.03, 0.04)):
        here = np.s_[:20, 20 * strip : 20 * strip + 20]
        image.mean[here] = 2.0**-strip * 1e-12
        image.stderr[here] = error * image.mean[here]
    measured = words.noise(image)
    assert measured.relative_error == pytest.approx((0.0175, 0.025, 0.0325), rel=0.3)
    assert measured.lit_share == pytest.approx(20 / 60)
    assert measured.received_share == 1.0


@pytest.mark.parametrize("count", [2, 4, 8])
def test_the_stated_noise_is_the_true_error_and_four_times_the_samples_halve_it(image_of: Build, count: int) -> None:
    """Against pictures whose truth is known: the stated standard error is the scatter of the error.

    The middle of 4800 pixels' stated errors has a chance error below 1 %; that of two replicates' own spreads is 0.67
    of the truth.
    """
    rng = np.random.default_rng(11)
    truth = rng.uniform(1.0, 1.2, (60, 80, 1))
    stated = []
    for samples in (64, 256):
        replicates = rng.normal(truth, 1.0 / np.sqrt(samples / count), (count, *truth.shape))
        stderr = replicates.std(axis=0, ddof=1) / np.sqrt(count)
        measured = words.noise(image_of(mean=replicates.mean(axis=0), stderr=stderr, replicates=count)).relative_error
        assert measured is not None
        scatter = np.std(replicates.mean(axis=0) / truth - 1.0)
        assert measured[1] == pytest.approx(scatter, rel=0.05)
        stated.append(measured[1])
    assert stated[0] / stated[1] == pytest.approx(2.0, rel=0.05)


def test_a_run_says_how_many_pixels_found_no_light_and_when_samples_are_too_few(image_of: Build) -> None:
    hits = np.full((60, 80, 1), 64, np.uint32)
    assert "No path brought light" not in text(image_of(hits=hits))
    assert "too few samples" not in text(image_of(hits=hits))
    hits[:6] = 0
    image = image_of(hits=hits)
    image.mean[:6] = image.stderr[:6] = 0.0
    assert words.noise(image).without_hits == 480
    assert "No path brought light to 480 pixels, 10 %. Their value is 0; upper bounds are in image.upper." in text(
        image
    )
    hits[6:26] = 9
    assert words.noise(image).few_hits_share == pytest.approx(20 / 54)
    assert "In 37 % of the lit pixels fewer than 10 samples found light" in text(image)


def test_the_summary_says_noise_and_the_samples_that_halve_it(image_of: Build) -> None:
    lines = text(image_of())
    assert re.search(
        r"Noise: at most \d+\.?\d* % \(one standard error\) in a quarter of the lit pixels, 10\.\d % in half", lines
    )
    assert "256 per pixel, would at least halve it" in lines
    assert "4.1 million packets" in lines
    assert "10 million events per second" in lines


def test_a_black_picture_says_that_the_light_ended_on_the_stop(image_of: Build, scene: Scene) -> None:
    image = image_of(
        scene.changed({"transport.method": "forward"}),
        mean=np.zeros((60, 80, 1)),
        stderr=np.zeros((60, 80, 1)),
        ledger=lf.Ledger(emitted=1.0, absorbed={"stop": 0.997, "mount": 0.002}, escaped=0.001),
    )
    lines = text(image)
    assert "The picture is black" in lines
    assert "Of the light, 99.7 % ended on the stop, 0.2 % ended on the mount, 0.1 % left the scene." in lines


def test_a_black_adjoint_picture_says_that_no_light_reaches_the_target(image_of: Build) -> None:
    black = np.zeros((60, 80, 1))
    absorbed = {"stop": 1.0, "mount": 0.5, "targets[0]": 0.2, "housing": 2.0, "reflections not followed": 0.5}
    ledger = lf.Ledger(emitted=5.0, absorbed=absorbed, escaped=0.8, reached_target=1.0, lit=0.0)
    lines = text(image_of(mean=black, stderr=black, ledger=ledger))
    cause = lines.index("20 % of the paths traced back from the sensor reached targets[0], but nothing there")
    ends = lines.index(
        "50 % of the paths reached the lens; of these 40 % left through the front, 40 % ended on the stop, 20 % "
        "ended on the"
    )
    assert cause < ends, "the cause comes first"
    nowhere = lf.Ledger(emitted=4.0, escaped=4.0)
    said = text(image_of(mean=black, stderr=black, ledger=nowhere))
    assert "None of the paths traced back from the sensor reached a target" in said
    shadow = lf.Ledger(emitted=4.0, escaped=4.0, reached_target=4.0, lit=2.0)
    assert "50 % of these met a side that emits or faces a lamp, but something blocks the lamp." in text(
        image_of(mean=black, stderr=black, ledger=shadow)
    )


def test_shares_of_light_come_to_the_whole_in_sentences(image_of: Build) -> None:
    black = np.zeros((60, 80, 1))
    absorbed = {"housing": 0.4, "mla mount": 0.3, "mla edge": 0.1, "reflections not followed": 0.15, "mla wall": 0.05}
    lines = text(image_of(mean=black, stderr=black, ledger=lf.Ledger(emitted=1.0, absorbed=absorbed)))
    assert (
        "None of them reached the lens: 40 % ended on the housing, 30 % ended on the mla mount, 15 % went into "
        "untraced reflections, 10 % ended on the mla edge, 5 % elsewhere." in lines
    )


@pytest.mark.parametrize(
    ("changes", "ended", "said"),
    [
        ({"targets[0].material.reflectance": 0.0}, "targets[0]", "targets[0] reflects and emits nothing: its"),
        ({"lights[0].position_mm": [0.0, 0.0, -900.0]}, "targets[0]", "targets[0] is lit by no lamp on the side that"),
        ({"targets[0].name": "board"}, "targets[1]", "No path reached targets[0] (board), which stands in the field"),
    ],
)
def test_a_black_picture_names_what_is_wrong_with_its_targets(
    image_of: Build, scene: Scene, changes: dict[str, Any], ended: str, said: str
) -> None:
    black = np.zeros((60, 80, 1))
    ledger = lf.Ledger(emitted=1.0, absorbed={ended: 1.0}, reached_target=1.0)
    lines = text(image_of(scene.changed(changes), mean=black, stderr=black, ledger=ledger))
    assert said in lines
    good = text(image_of(mean=black, stderr=black, ledger=replace(ledger, absorbed={"targets[0]": 1.0})))
    assert said[-20:] not in good


def test_a_picture_from_within_a_target_says_that_its_inside_is_black(image_of: Build) -> None:
    ledger = lf.Ledger(emitted=1.0, escaped=0.1, absorbed={"targets[0]": 0.75, "stop": 0.15})
    said = text(image_of(mean=np.zeros((60, 80, 1)), stderr=np.zeros((60, 80, 1)), ledger=ledger))
    assert "75 % of the paths traced back from the sensor met the black side of a target" in said
    assert "reached a target" not in said


def test_a_well_lit_picture_does_not_speak_of_losses(image_of: Build) -> None:
    assert "ended on" not in text(image_of())


def test_roulette_is_no_place_where_light_goes(image_of: Build) -> None:
    black = np.zeros((60, 80, 1))
    ledger = lf.Ledger(emitted=1.0, absorbed={"stop": 1.0}, roulette_added=5.0, roulette_removed=5.0)
    assert "100 % ended on the stop" in text(image_of(mean=black, stderr=black, ledger=ledger))


def test_no_light_at_all_is_said(image_of: Build, scene: Scene) -> None:
    black = np.zeros((60, 80, 1))
    forward = scene.changed({"transport.method": "forward"})
    assert "have no power" in text(image_of(forward, mean=black, stderr=black, ledger=lf.Ledger()))


def test_where_only_particles_shine_their_light_is_accounted_for(image_of: Build) -> None:
    """In the adjoint method as well, whose paths from the sensor are then not traced at all."""
    ledger, few = lf.Ledger(unit="m² sr", lamps=lf.Ledger(emitted=4.0, sensor=1.0)), np.zeros((60, 80, 1))
    few[7, 9] = 1.0
    image = image_of(mean=few, stderr=0.1 * few, ledger=ledger)
    assert "Only particles emit: 25 % of their light reached the sensor." in text(image)
    assert repr(ledger).startswith("<Ledger: 4 W emitted, 25.000% on the sensor")


def test_an_interrupted_run_says_how_far_it_came(image_of: Build) -> None:
    image = image_of(replicates=1, samples=8.0)
    image.stderr[:] = np.nan
    lines = text(image)
    assert "1 of 8 replicates" in lines
    assert "at least 2 finished replicates" in lines


def test_leaks_are_reported(image_of: Build) -> None:
    lost_in = {f"targets[{i}]": 1e-4 * (i + 1) for i in range(4)} | {"mla": 2e-6, "lens[0]": 1e-6}
    ledger = lf.Ledger(
        emitted=2.0, absorbed={"stop": 1.9}, lost={"contradiction": sum(lost_in.values())}, lost_in=lost_in
    )
    lines = text(image_of(ledger=ledger))
    assert (
        "Warning: 5.0e-04 of the energy was lost by the tracer: 2.0e-04 in targets[3], 1.5e-04 in targets[2], 1.0e-04"
        " in targets[1], 5.0e-05 in targets[0], the rest in 2 others; the picture lacks it" in lines
    )
    assert "the energy ledger does not close" in lines


def test_the_airy_disks_are_said_and_warned_of_above_one_sample(image_of: Build, scene: Scene) -> None:
    facts = first_order(scene)
    assert facts.airy_disk_samples < facts.microlens_airy_disk_px < 1.0
    lines = text(image_of())
    assert (
        f"Diffraction is not traced: the lens's Airy disk is {facts.airy_disk_samples:.2g} lenslets wide, a lenslet's "
        f"{facts.microlens_airy_disk_px:.2g} pixels (at {facts.airy_wavelength_nm:g} nm)." in lines
    )
    infrared = scene.changed({"transport.wavelengths_nm": (facts.airy_wavelength_nm, 10_000.0)})
    lines = text(image_of(infrared))
    assert "Diffraction is not traced" not in lines
    assert "Warning: the lens's Airy disk is 1.09 lenslets wide" in lines
    assert "10000 nm), but this diffraction is not traced" in lines


@pytest.mark.parametrize(("lost", "said"), [(0.99e-7, False), (1.01e-7, True)])
def test_a_loss_above_one_part_in_ten_million_is_said(image_of: Build, lost: float, said: bool) -> None:
    ledger = lf.Ledger(emitted=1.0, escaped=1.0 - lost, lost={"miss": lost}, lost_in={"mla": lost})
    assert (
        "Warning: 1.0e-07 of the energy was lost by the tracer: 1.0e-07 in mla" in text(image_of(ledger=ledger))
    ) == said


@pytest.mark.parametrize(
    ("share", "shown"),
    [
        (0.0, "0 %"),
        (1.0, "100 %"),
        (0.99999, "more than 99.9 %"),
        (1e-9, "less than 0.0001 %"),
        (0.1234, "12.3 %"),
    ],
)
def test_shares_are_never_rounded_to_all_or_nothing(share: float, shown: str) -> None:
    assert words.percent(share) == shown


@pytest.mark.parametrize(
    ("seconds", "shown"), [(0.0, "0.0 s"), (59.6, "60 s"), (125.0, "2 min 05 s"), (7500.0, "2 h 05 min")]
)
def test_durations(seconds: float, shown: str) -> None:
    assert words.duration(seconds) == shown


@pytest.mark.parametrize(
    ("has_meshes", "said"),
    [(True, "The aim is not proven."), (False, "no ray from the stop could be traced")],
)
def test_an_aim_without_a_proof_says_why(
    image_of: Build, monkeypatch: pytest.MonkeyPatch, has_meshes: bool, said: str
) -> None:
    monkeypatch.setattr(Lens, "has_meshes", property(lambda _: has_meshes))
    image = image_of(blind=BlindCheck((4, 4), 100, 1.0, 4.0, 0.1))
    assert said in text(image)
    assert said in "".join(words.account(image)), "also without --verbose"


def test_a_run_says_first_how_good_the_picture_is_and_its_checks_in_one_line(image_of: Build) -> None:
    order = OrderCheck(compared=2948, reflected=100, undecided=0, differing=0, deviation_mm=1.4e-11, deviation=1e-14)
    image = image_of(blind=BlindCheck((4, 4), 100, 1.0, 4.0, 0.536), order=order)
    noise, checks = words.account(image)
    assert noise.startswith("Noise: ")
    found = (
        "Unaimed samples found no light missing in 4 × 4 blocks; in each they would have shown a loss above 53.6 %. "
    )
    assert checks.startswith(f"Checks: {found}")
    agree = "Sequential and mesh tracing agree on 2,948 test paths (largest difference 1.4e-11 mm)."
    assert agree in checks
    lines = words.account(image, verbose=True)
    assert lines[0] == noise
    assert agree in lines
    assert lines[-1].startswith("Traced ")
