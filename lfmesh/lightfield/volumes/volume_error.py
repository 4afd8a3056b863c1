"""Error of a regularised volume by noise and unresolved parts, its validity, and the strength with the least error."""

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lfmesh.lightfield.volumes.regularised import SIGMAS, STEP, WEAKEST, Array, Problem, chance, halves, steps_to
from lfmesh.notebook import Say

TINY = float(np.finfo(np.float64).tiny)

HALVINGS = 2
"""Number of ways to halve the pixels."""

LEFT = 2.0
"""Residual, in noise variances, above which noise does not explain it."""

KEPT = 0.85
"""Prediction gain, over a weaker strength's, below which a strength is too large."""

RADII = 2
"""Radii per voxel at which a round emission may change its slope."""

PARTS = 4
"""Parts of a voxel's side over which a round emission is averaged."""

SMOOTH = 0.01
"""Weight of a round emission's curvature over that of its sums."""


class Halved(NamedTuple):
    """Two halves of the pixels, with double weight, and the volume of each."""

    parts: list[Problem]
    volumes: list[Array]

    @classmethod
    def of(cls, problem: Problem, strength: float) -> "list[Halved]":
        """Return several ways to halve the pixels."""
        ways = [[problem.of_pixels(some, 2.0) for some in halves(len(problem.b), way)] for way in range(HALVINGS)]
        return [cls(parts, [part.path(strength) for part in parts]) for parts in ways]


def error_by_halves(halved: list[Halved]) -> Array:
    """Return the standard error of each voxel by noise, from volumes of halves of the pixels.

    Half of the pixels, with double weight, have twice the variance of all, so half the difference of two halves has the
    variance of all. Each way of halving is an independent draw.
    """
    return np.asarray(np.sqrt(np.mean([0.25 * (one - other) ** 2 for _, (one, other) in halved], axis=0)))


class Prediction(NamedTuple):
    """Prediction of halves of the pixels from the volumes of the other halves.

    Attributes
    ----------
    gain : float
        Reduction of the squared residual from a uniform volume's; for a single voxel, from the dark's.
    by_chance : float
        Standard error of the gain, if there is nothing to gain.
    """

    gain: float
    by_chance: float

    @classmethod
    def of(cls, parts: list[Problem], volumes: list[Array]) -> "Prediction":
        """Return the prediction of each part from the volume of the other."""
        if not all(len(part.b) for part in parts):
            return cls(0.0, 0.0)
        even, off = [], []
        for part, other, x in zip(parts, reversed(parts), reversed(volumes), strict=True):
            sums, seen = (np.asarray(each.rows.sum(axis=1)).ravel() for each in (part, other))
            level = max(float(seen @ other.b), 0.0) / max(float(seen @ seen), TINY)
            even.append((level if len(x) > 1 else 0.0) * sums - part.b)
            off.append(part.rows @ x - part.b)
        plain, left = np.concatenate(even), np.concatenate(off)
        shift = float(np.linalg.norm(left - plain))
        return cls(float(plain @ plain - left @ left), 2.0 * shift * float(np.sqrt(np.mean(left**2))))


def why_unknown(problem: Problem, strength: float, x: Array, halved: Halved, *, is_noise_known: bool) -> str:
    """Return the reason why a volume's error cannot be determined, in words; empty if it can.

    Known noise must explain the residual. Volumes of half of the pixels must predict the other half nearly as well as
    with a weaker strength, and better than a uniform volume by more than chance.

    Parameters
    ----------
    problem : Problem
    strength : float
    x : (voxels,) float64
        Volume of all pixels.
    halved : Halved
        Volumes of halves of the pixels for the same strength.
    is_noise_known : bool
    """
    parts, volumes = halved
    own = Prediction.of(parts, volumes)
    weaker = [part.solved(strength / STEP**2, each) for part, each in zip(parts, volumes, strict=True)]
    further = Prediction.of(parts, weaker)
    left = problem.misfit(x) / len(problem.b)
    if is_noise_known and left > LEFT * (1.0 + chance(len(problem.b))):
        return (
            f"the squared residual of the image is {left:.3g} times the noise's variance: the strength of "
            f"{strength:.3g} is too large, the noise too small, or the image does not belong to this matrix"
        )
    if further.gain > SIGMAS * further.by_chance and own.gain < KEPT * further.gain:
        return f"the strength of {strength:.3g} is too large for the image: a smaller one uses more of it"
    if not own.gain > SIGMAS * own.by_chance:
        return (
            "the image does not determine the volume: half of the pixels predict the other half no better than "
            f"{'an even volume' if len(x) > 1 else 'the dark'} does"
        )
    return ""


class Trials(NamedTuple):
    """Known test volumes, and problems of their images with an image's noise.

    The errors of their reconstructions show how far the image's reconstruction may be from the truth.
    """

    known: list[Array]
    problems: list[Problem]

    @classmethod
    def of(cls, problem: Problem, x: Array, known: Iterable[Array]) -> "Trials":
        """Return the trials for an image.

        Parameters
        ----------
        problem : Problem
        x : (voxels,) float64
            Volume found from the image; its residual is the noise.
        known : iterable of (voxels,) float64
            Volumes with about the same image, see `as_deep_as_wide`.
        """
        volumes, noise = list(known), np.sqrt(problem.misfit(x) / len(problem.b))
        draw = np.random.default_rng(11)
        images = [problem.rows @ each + noise * draw.standard_normal(len(problem.b)) for each in volumes]
        return cls(volumes, [replace(problem, b=image) for image in images])

    @property
    def size(self) -> float:
        """Norm of the largest known volume, above 0: the error of an empty one."""
        return max(TINY, *(float(np.linalg.norm(each)) for each in self.known))

    def error(self, x: Array, found: list[Array]) -> float:
        """Return the expected norm of a volume's difference from the truth, unresolved parts included.

        It is the largest error of the known volumes at the same strength. If x is larger than their reconstructions,
        noise and camera do not explain all of it, and the error grows in proportion.
        """
        size = float(np.linalg.norm(x))
        errors = [
            float(np.linalg.norm(each - known)) * max(1.0, size / max(float(np.linalg.norm(each)), TINY))
            for each, known in zip(found, self.known, strict=True)
        ]
        return max(errors)

    def why_no_better_than_dark(self, error: float) -> str:
        """Return a message if an error is larger than that of an empty volume, else an empty one."""
        times = error / self.size
        if times <= 1.0:
            return ""
        return f"an empty volume is expected to be closer to the truth, by a factor of {times:.3g}"


def strength_of_least_error(problem: Problem, trials: Trials, say: Say) -> tuple[float, Array]:
    """Return the strength with the least expected error, and the strengths tried.

    The volume that best predicts the image is not nearest to the truth. Barely resolved depth shows in the image less
    than noise, so prediction hardly requires it. Model errors shared by pixels are predicted like light.

    Parameters
    ----------
    problem : Problem
    trials : Trials
    say : callable

    Returns
    -------
    strength : float
    tried : (n, 2) float64
        Strength, and expected error.
    """
    x, *found = [np.full(problem.rows.shape[1], problem.mean)] * (1 + len(trials.known))
    tried: list[tuple[float, float]] = []
    # Follow the whole path: the error is almost constant over many strengths before depth appears.
    for strength in steps_to(WEAKEST):
        x = problem.solved(strength, x)
        found = [each.solved(strength, volume) for each, volume in zip(trials.problems, found, strict=True)]
        tried.append((strength, trials.error(x, found)))
        say(f"strength {strength:.3g}: expected error {tried[-1][1] / trials.size:.3g} of an empty volume's")
    return min(tried, key=lambda each: each[1])[0], np.array(tried)


def as_deep_as_wide(volume: Array, depth: int) -> list[Array]:
    """Return volumes with the same sums along the worst-resolved axis, as deep as they are wide along the others.

    Each row of the sums along another axis becomes round, in voxels, in the plane of that axis and the depth: an
    emission by radius about the centre of its light, with sums nearest to the row.

    Parameters
    ----------
    volume : (nx, ny, nz) float64
    depth : int
        Index of the worst-resolved axis.
    """
    sums = volume.sum(axis=depth)
    found = []
    for axis in (k for k in range(3) if k != depth and volume.shape[k] > 1):
        # Rows of the sums along this axis, and of the volume with the depth last.
        rows = np.moveaxis(sums, axis if axis < depth else axis - 1, -1)
        round_ones = np.stack([_round(row, volume.shape[depth]) for row in rows])
        found.append(np.moveaxis(round_ones, (1, 2), (axis, depth)))
    return found or [volume]


def _round(row: Array, depth: int) -> Array:
    """Return a round emission, (along the row, along the depth), with sums over the depth nearest to a row.

    It is linear between radii and averaged over each voxel, so that a thin shell has a thin shell's sums.
    """
    from scipy import optimize, sparse

    if not row.any():
        return np.zeros((len(row), depth))
    inside = (np.arange(PARTS) + 0.5) / PARTS - 0.5
    along = np.arange(len(row)) - np.average(np.arange(len(row)), weights=row)
    across = np.arange(depth) - 0.5 * (depth - 1)
    x, z = (np.add.outer(each, inside) for each in (along, across))
    radius = RADII * np.hypot(x[:, None, :, None], z[None, :, None, :]).reshape(len(row) * depth, PARTS**2)
    below = radius.astype(np.int64)
    count = int(below.max()) + 2
    voxel = np.broadcast_to(np.arange(len(radius))[:, None], radius.shape)
    weights = np.stack([1.0 - (radius - below), radius - below]) / PARTS**2
    places = np.stack([voxel, voxel]).ravel(), np.stack([below, below + 1]).ravel()
    share = sparse.csr_array((weights.ravel(), places), shape=(len(radius), count)).toarray()
    sums = share.reshape(len(row), depth, count).sum(axis=1)
    bends = SMOOTH * sums.max() * np.diff(np.eye(count), 2, axis=0)
    emission, _ = optimize.nnls(np.concatenate([sums, bends]), np.append(row, np.zeros(len(bends))))
    return np.asarray(share @ emission).reshape(len(row), depth)
