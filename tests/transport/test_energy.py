"""Energy closes: what packets started with is on the sensor, absorbed, escaped or cut, in every mode and method."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from tests.cameras import close_up_camera
from tests.renders import by_seed

LEVEL = 1e-3
"""Chance that a statistical test fails though the law holds."""

BALL_MM = 0.6
CLOSED = 1e-12
"""Of the emitted power: rounding of a few hundred thousand packets."""

# An emitting wall and a painted plane light each other, a ball and a lamp join in: every way to gain and lose energy.
CROWDED: dict[str, Any] = {
    "camera": close_up_camera(),
    "targets": [
        {"shape": {"kind": "plane", "width_mm": 6.0, "height_mm": 5.0}, "position_mm": [0, 0, -60.0],
         "material": {"reflectance": 0.8}},
        {"shape": {"kind": "plane", "width_mm": 8.0, "height_mm": 8.0}, "position_mm": [3.2, 0, -56.0],
         "rotation_deg": [0.0, 90.0, 0.0], "material": {"reflectance": 0.7, "radiance_w_m2_sr": 1e3}},
        {"shape": {"kind": "sphere", "radius_mm": BALL_MM}, "position_mm": [-1.0, -1.0, -56.0],
         "material": {"reflectance": 0.5}},
    ],
    "lights": [{"kind": "point", "position_mm": [-20.0, -15.0, -25.0], "power_w": 1.0}],
    "transport": {"samples": 64, "threads": 1},
}  # fmt: skip


def crowded(**transport: Any) -> lf.Scene:
    """The scene with other transport settings."""
    return lf.Scene(**CROWDED | {"transport": CROWDED["transport"] | transport})


@pytest.mark.parametrize("method", ["adjoint", "forward"])
@pytest.mark.parametrize("split", ["transmit", "both", "roulette"])
@pytest.mark.parametrize("max_events", [64, 5])
def test_energy_closes(method: str, split: str, max_events: int) -> None:
    # In parts, the image path's own book is not kept: see test_parts.
    engine = "auto" if split == "transmit" else "mesh"
    image = lf.render(crowded(method=method, split=split, max_events=max_events, weight_cutoff=0.6, engine=engine))
    ledger = image.ledger
    assert abs(ledger.imbalance) <= CLOSED
    assert ledger.lost_share < 1e-7
    # The books are not closed by being empty.
    assert ledger.absorbed["targets[0]"] > 0.0
    assert ledger.absorbed["stop"] > 0.0
    assert ledger.escaped > 0.0
    assert ledger.roulette_added > 0.0
    assert ledger.roulette_removed > 0.0
    assert (ledger.depth > 0.0) == (max_events == 5)


@pytest.mark.parametrize("split", ["transmit", "both", "roulette"])
def test_the_image_holds_what_the_ledger_books_on_the_sensor(split: str) -> None:
    image = lf.render(crowded(method="forward", split=split))
    assert image.ledger.sensor > 0.0
    assert image.mean.sum() == pytest.approx(image.ledger.sensor, rel=CLOSED)


@pytest.mark.parametrize(
    "light",
    [
        {"kind": "point", "position_mm": [-20.0, -15.0, -25.0], "power_w": 3.0},
        {"kind": "disk", "position_mm": [-20.0, 0.0, -25.0], "direction": [1, 0, -1], "radius_mm": 2, "power_w": 3.0},
    ],
)
def test_a_lamp_emits_its_power(light: dict[str, Any]) -> None:
    scene = crowded(method="forward", samples=8).changed({"lights": [light], "targets[1].material": {}})
    assert lf.render(scene).ledger.emitted == pytest.approx(3.0, rel=CLOSED)


def test_a_sheet_emits_pi_l_from_each_side_and_a_ball_from_its_outside() -> None:
    """Lambert's law: M = π L."""
    glow = {"radiance_w_m2_sr": 100.0, "reflectance": 0.0}
    sheet = crowded(method="forward", samples=8).changed(
        {"lights": [], "targets[1].material": {}, "targets[0].material": glow}
    )
    assert lf.render(sheet).ledger.emitted == pytest.approx(2.0 * np.pi * 100.0 * 6e-3 * 5e-3, rel=CLOSED)
    ball = sheet.changed({"targets[0].material": {}, "targets[2].material": glow})
    area = 4.0 * np.pi * (1e-3 * BALL_MM) ** 2
    assert lf.render(ball).ledger.emitted == pytest.approx(np.pi * 100.0 * area, rel=CLOSED)


def test_pixels_see_a_whole_hemisphere() -> None:
    """∫ cos θ dω = π over what a pixel's packets are spread over, so no direction is missed."""
    pixels = 4e-6  # m²: 20 x 20 of 0.1 mm
    emitted = [image.ledger.emitted for image in by_seed(crowded(samples=256, replicates=1), range(24))]
    assert stats.sem(emitted) < 0.01 * np.mean(emitted)
    assert stats.ttest_1samp(emitted, np.pi * pixels).pvalue > LEVEL


@pytest.mark.parametrize("method", ["adjoint", "forward"])
def test_roulette_does_not_bias(method: str) -> None:
    """Cutoffs from almost none to the harshest: strips of the image and its sum by Welch's t-test, Bonferroni."""
    cutoffs = (0.01, 0.1, 1.0)
    settings = {"method": method, "split": "both", "samples": 24, "replicates": 1}
    scenes = [crowded(weight_cutoff=cutoff, **settings) for cutoff in cutoffs]
    images = [
        np.array([image.mean[..., 0] for image in by_seed(given, range(100 * which, 100 * which + 24))])
        for which, given in enumerate(scenes)
    ]
    sums = [stack.sum(axis=(1, 2)) for stack in images]
    for total in sums:
        assert stats.sem(total) < 0.03 * total.mean()
    p = []
    for a, b in ((0, 1), (0, 2), (1, 2)):
        p.append(stats.ttest_ind(sums[a], sums[b], equal_var=False).pvalue)
        p.extend(stats.ttest_ind(strips(images[a]), strips(images[b]), equal_var=False).pvalue)
    assert min(p) > LEVEL / len(p)


def strips(images: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum strips of four columns: (n, 20, 20) to (n, 5)."""
    return images.reshape(len(images), 20, 5, 4).sum(axis=(1, 3))


def test_what_a_depth_cut_takes_from_the_image_is_on_the_depth_account() -> None:
    """Without splits or bounces the same packets run with and without the cut; they are summed in another order.

    A packet on its way to the sensor meets the target and four faces of glass: five events.
    """
    alone = crowded(method="forward", split="transmit", samples=64).changed(
        {"targets": [CROWDED["targets"][0]], "targets[0].material.reflectance": 0.8}
    )
    whole = lf.render(alone).ledger
    assert whole.depth == 0.0
    for events in (1, 2, 3, 4):
        cut = lf.render(alone.changed({"transport.max_events": events})).ledger
        assert cut.sensor == 0.0
        assert cut.depth > whole.sensor
        assert abs(cut.imbalance) <= CLOSED
    enough = lf.render(alone.changed({"transport.max_events": 5})).ledger
    assert abs(enough.sensor - whole.sensor) <= CLOSED * whole.sensor
