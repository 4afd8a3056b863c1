"""The judge: do several estimates of one image agree, and has an estimate that is wrong said so?

Each estimate is rendered with SEEDS independent seeds of few samples. The spread of these batches, not the errors that
images state, tells how well totals, quarters and pixels are known. Each estimate is compared with the first one by
Welch's t-test in all these places. The test has two steps. What differs at the level SCREEN, shared by the comparisons
of a scene (Bonferroni), is looked at again with fresh seeds and four times the samples, in those places alone, at the
level that is left: of SCENES scenes that are all right, one is found wrong with a chance of LEVEL. So rare heavy paths,
which make the t-test too sure, seldom pass both steps.

A pixel in which few packets found light has no spread that tells its error. Its variance is at least that of packets of
the mean weight that come by chance (Poisson), as many as the other estimate has light for.
"""

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from tests.renders import by_seed

Array = NDArray[np.float64]

SEEDS = 24
"""Independent batches of an estimate."""

LEVEL = 1e-3
"""Chance that any of the SCENES is found wrong though all are right."""

SCENES = 1300
"""Random cameras, random scenes, laws and pairs of features that one session examines."""

SCREEN = 0.02
"""Chance that a right scene is looked at again."""

CONFIRM = LEVEL / (SCENES * SCREEN)
"""Level of the second look."""

AGAIN = 4
"""Times the samples of the second look."""

FEW_HITS = 100
"""Packets with light in a place, below which their weight decides the least variance."""


@dataclass(frozen=True)
class Estimate:
    """One way to get an image.

    Attributes
    ----------
    name : str
    scenes : tuple of Scene
        Their images are added.
    factor : float
        The sum is multiplied with it.
    more : int
        Times the samples that others get, for a method of noisy packets.
    slack : float
        Relative difference from the first estimate that is none, where the law itself is approximate.
    """

    name: str
    scenes: tuple[lf.Scene, ...]
    factor: float = 1.0
    more: int = 1
    slack: float = 0.0


@dataclass(frozen=True)
class Batches:
    """Images of an estimate.

    Attributes
    ----------
    light : (SEEDS, places) float64, W
        Of the total of each channel, of its quarters, of its pixels.
    hits : (places,) float64
        Packets that found light there, in all seeds together.
    channels : int
    """

    light: Array
    hits: Array
    channels: int = 1

    @property
    def weight(self) -> float:
        """Mean light of a packet that found any, W of a batch."""
        return float(self.light[:, : self.channels].sum() / max(1.0, self.hits[: self.channels].sum()))


@dataclass(frozen=True)
class Difference:
    """Two estimates that disagree in a place.

    Attributes
    ----------
    estimate, place : str
        The estimate that is compared with the first one.
    ratio : float
        Of its light to that of the first one.
    sigmas : float
        Difference in standard errors of both.
    """

    estimate: str
    place: str
    ratio: float
    sigmas: float

    def __str__(self) -> str:
        return f"{self.estimate}, {self.place}: {self.ratio:.4g} of the first ({self.sigmas:+.1f} sigma)"


@dataclass
class Verdict:
    """What the judge found.

    Attributes
    ----------
    differences : list of Difference
        Confirmed ones, the surest first.
    said : dict of str to list of str
        Warnings of each estimate.
    refused : dict of str to str
        Estimates that were refused, and why.
    resolution : dict of str to float
        Relative standard error of the total's difference from the first estimate.
    is_dark : bool
        No estimate found light.
    looked_twice : bool
    """

    differences: list[Difference] = field(default_factory=list)
    said: dict[str, list[str]] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)
    resolution: dict[str, float] = field(default_factory=dict)
    is_dark: bool = False
    looked_twice: bool = False

    @property
    def silent(self) -> list[Difference]:
        """Differences of which neither of the two estimates has warned."""
        first = next(iter(self.said), "")
        return [
            d
            for d in self.differences
            if not any(tells_of(line, d) for line in (*self.said.get(d.estimate, ()), *self.said.get(first, ())))
        ]

    @property
    def outcome(self) -> str:
        """One word: agree, silent (wrong without a warning), warned, dark or refused."""
        if self.differences:
            return "silent" if self.silent else "warned"
        if self.is_dark:
            return "dark"
        return "refused" if len(self.said) - len(self.refused) < 2 else "agree"

    def __str__(self) -> str:
        lines = [self.outcome, *map(str, self.differences[:6])]
        lines += [f"{name} refused: {why}" for name, why in self.refused.items()]
        lines += [f"{name} says: {line}" for name, of in self.said.items() for line in of]
        return "\n".join(lines)


def tells_of(line: str, difference: Difference) -> bool:
    """Return whether a warning may be of a difference: one of lost energy is not of more than it says was lost."""
    share = re.match(r"LostEnergyWarning: ([0-9.e+-]+) of", line)
    return share is None or float(share[1]) >= 0.1 * abs(difference.ratio - 1.0)


def ways(scene: lf.Scene) -> list[Estimate]:
    """Return the estimates of a scene that share as little as possible: the default, meshes alone, and forward.

    Meshes alone find no faces of gradient-index glass.

    Parameters
    ----------
    scene : Scene
    """
    if any(True for _ in scene.gradients()):
        forward = scene.changed({"transport.method": "forward"})
        return [Estimate("default", (scene,)), Estimate("forward", (forward,), 1.0, 4)]
    by_meshes = scene.changed({"transport.engine": "mesh"})
    forward = by_meshes.changed({"transport.method": "forward"})
    return [
        Estimate("default", (scene,)),
        Estimate("mesh engine", (by_meshes,)),
        Estimate("forward", (forward,), 1.0, 4),
    ]


def judge(estimates: Sequence[Estimate], samples: int = 48, seed: int = 0) -> Verdict:
    """Compare all estimates with the first one.

    Parameters
    ----------
    estimates : sequence of Estimate
    samples : int
        A pixel, in each batch of the first look.
    seed : int
        The first seed; each estimate has others.
    """
    verdict, found = Verdict(), {}
    for number, estimate in enumerate(estimates):
        verdict.said[estimate.name] = []
        try:
            verdict.said[estimate.name] = what_runs_say(estimate, samples, seed)
            found[estimate.name] = batches(estimate, samples, seeds_of(number, seed))
        except lf.LfmeshError as error:
            verdict.refused[estimate.name] = str(error)
    if estimates[0].name not in found or len(found) < 2:
        return verdict
    first = found[estimates[0].name]
    verdict.is_dark = not any(each.hits.any() for each in found.values())
    names = places(estimates[0].scenes[0])
    for number, estimate in enumerate(estimates[1:], 1):
        if estimate.name not in found:
            continue
        p, sigmas, _ = compare(first, found[estimate.name], estimate.slack)
        verdict.resolution[estimate.name] = resolution(first, found[estimate.name])
        doubtful = np.nonzero(p < SCREEN / (p.size * (len(estimates) - 1)))[0]
        if doubtful.size:
            verdict.looked_twice = True
            one = batches(estimates[0], AGAIN * samples, seeds_of(0, seed + 1))
            other = batches(estimate, AGAIN * samples, seeds_of(number, seed + 1))
            p, sigmas, ratio = compare(one, other, estimate.slack)
            for at in doubtful[p[doubtful] < CONFIRM / doubtful.size]:
                verdict.differences.append(Difference(estimate.name, names[at], ratio[at], sigmas[at]))
    verdict.differences.sort(key=lambda d: -abs(d.sigmas))
    return verdict


def seeds_of(number: int, seed: int) -> range:
    """Return the seeds of an estimate, by its place among the others and what `judge` was given."""
    first = 1_000_000 * (number + 1) + 10_000 * seed
    return range(first, first + SEEDS)


def what_runs_say(estimate: Estimate, samples: int, seed: int) -> list[str]:
    """Return the warnings of runs as a user makes them, with eight replicates."""
    said: list[str] = []
    for scene in estimate.scenes:
        settings = {"samples": 8 * samples * estimate.more, "replicates": 8, "seed": seed}
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            lf.render(with_transport(scene, settings))
        said += [f"{w.category.__name__}: {w.message}" for w in caught if issubclass(w.category, UserWarning)]
    return said


def with_transport(scene: lf.Scene, settings: dict[str, object]) -> lf.Scene:
    """Return a scene with other transport settings."""
    return scene.changed({f"transport.{key}": value for key, value in settings.items()})


def batches(estimate: Estimate, samples: int, seeds: range) -> Batches:
    """Render an estimate with each of several seeds.

    Parameters
    ----------
    estimate : Estimate
    samples : int
        A pixel, in each batch.
    seeds : range
    """
    light, hits = 0.0, 0.0
    for number, scene in enumerate(estimate.scenes):
        settings = {"samples": samples * estimate.more, "replicates": 1}
        images = list(by_seed(with_transport(scene, settings), (100_000_000 * number + seed for seed in seeds)))
        light = light + estimate.factor * np.stack([in_places(image.mean) for image in images])
        hits = hits + sum(in_places(image.hits.astype(float)) for image in images)
    return Batches(np.asarray(light), np.asarray(hits), estimate.scenes[0].channels)


def in_places(image: Array) -> Array:
    """Return total, quarters and pixels of an image (H, W, channels), one after the other, each with its channels."""
    rows, columns = image.shape[0] // 2, image.shape[1] // 2
    halves = [(slice(None, rows), slice(rows, None)), (slice(None, columns), slice(columns, None))]
    quarters = [image[above, left].sum(axis=(0, 1)) for above in halves[0] for left in halves[1]]
    return np.concatenate([image.sum(axis=(0, 1)), *quarters, image.ravel()])


def places(scene: lf.Scene) -> list[str]:
    """Return the names of what `in_places` yields."""
    (columns, rows), channels = scene.camera.sensor.pixels, range(scene.channels)
    areas = ["total", "first quarter", "second quarter", "third quarter", "fourth quarter"]
    areas += [f"pixel ({r}, {c})" for r in range(rows) for c in range(columns)]
    return [area if len(channels) == 1 else f"{area} of channel {c}" for area in areas for c in channels]


def compare(one: Batches, other: Batches, slack: float = 0.0) -> tuple[Array, Array, Array]:
    """Return p-values, differences in standard errors, and ratios of two estimates in all places, by Welch's t-test."""
    means = [each.light.mean(axis=0) for each in (one, other)]
    variances = []
    for each, mean, of_other in ((one, means[0], means[1]), (other, means[1], means[0])):
        variance = each.light.var(axis=0, ddof=1) / SEEDS
        by_chance = np.maximum(mean, of_other) * each.weight / SEEDS
        variances.append(np.where(each.hits < FEW_HITS, np.maximum(variance, by_chance), variance))
    both = variances[0] + variances[1]
    # What is known to rounding has no spread: both are equal to rounding, or differ.
    floor = (1e-12 * np.maximum(*means)) ** 2
    difference = means[1] - means[0]
    difference = np.sign(difference) * np.maximum(0.0, np.abs(difference) - slack * means[0])
    away = difference / np.sqrt(np.where(both > floor, both, np.where(floor > 0.0, floor, 1.0)))
    freedom = np.full(away.shape, SEEDS - 1.0)
    spread = both > 0.0
    freedom[spread] = (both**2 / np.maximum((variances[0] ** 2 + variances[1] ** 2) / (SEEDS - 1), 1e-300))[spread]
    ratio = np.divide(means[1], means[0], out=np.full_like(means[0], np.inf), where=means[0] > 0.0)
    return 2.0 * stats.t.sf(np.abs(away), freedom), away, ratio


def resolution(one: Batches, other: Batches) -> float:
    """Return the relative standard error of the difference of two totals, of the first channel."""
    error = np.hypot(*(each.light[:, 0].std(ddof=1) / np.sqrt(SEEDS) for each in (one, other)))
    mean = one.light[:, 0].mean()
    return float(error / mean) if mean else np.inf
