"""Error of a regularised volume: by noise, by what is not resolved, and whether it can be told at all."""

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lfmesh.lightfield.volumes.regularised import SIGMAS, STEP, Array, Problem, chance, halves

HALVINGS = 2
"""Ways to halve the pixels."""

LEFT = 2.0
"""Noise variances of the residual above which something else than noise is left."""

KEPT = 0.85
"""Share of what a weaker strength predicts that a strength predicts which is not too large."""


class Halved(NamedTuple):
    """Two halves of the pixels, weighted twice, and the volume of each."""

    parts: list[Problem]
    volumes: list[Array]

    @classmethod
    def of(cls, problem: Problem, strength: float) -> "list[Halved]":
        """Return several ways to halve the pixels."""
        ways = [[problem.of_pixels(some, 2.0) for some in halves(len(problem.b), way)] for way in range(HALVINGS)]
        return [cls(parts, [part.path(strength) for part in parts]) for parts in ways]


def error_by_halves(halved: list[Halved]) -> Array:
    """Return the standard error of each voxel by noise, from volumes of halves of the pixels.

    Half of the pixels, weighted twice, have twice the variance of all, so that half the difference of two halves has
    that of all. Each way to halve them is a draw of its own.
    """
    return np.asarray(np.sqrt(np.mean([0.25 * (one - other) ** 2 for _, (one, other) in halved], axis=0)))


class Prediction(NamedTuple):
    """Prediction of halves of the pixels from the volumes of the other halves.

    Attributes
    ----------
    gain : float
        Fall of the squared residual from that of an even volume, of a single voxel from that of the dark.
    by_chance : float
        Standard error of the gain, where there is nothing to gain.
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
            level = max(float(seen @ other.b), 0.0) / max(float(seen @ seen), np.finfo(np.float64).tiny)
            even.append((level if len(x) > 1 else 0.0) * sums - part.b)
            off.append(part.rows @ x - part.b)
        plain, left = np.concatenate(even), np.concatenate(off)
        shift = float(np.linalg.norm(left - plain))
        return cls(float(plain @ plain - left @ left), 2.0 * shift * float(np.sqrt(np.mean(left**2))))


def why_unknown(problem: Problem, strength: float, x: Array, halved: Halved, *, is_noise_known: bool) -> str:
    """Return in words why nobody can tell how far a volume is from the truth; nothing if it can be told.

    Three things are looked at. Noise that is known must explain what is left of the image. Volumes of half of the
    pixels must predict the other half nearly as well as those of a weaker strength do, and better than an even volume
    by more than chance.

    Parameters
    ----------
    problem : Problem
    strength : float
    x : (voxels,) float64
        The volume of all pixels.
    halved : Halved
        Volumes of halves of them for the same strength.
    is_noise_known : bool
    """
    parts, volumes = halved
    own = Prediction.of(parts, volumes)
    weaker = [part.solved(strength / STEP**2, each) for part, each in zip(parts, volumes, strict=True)]
    further = Prediction.of(parts, weaker)
    left = problem.misfit(x) / len(problem.b)
    if is_noise_known and left > LEFT * (1.0 + chance(len(problem.b))):
        return (
            f"{left:.3g} of the noise's variance are left of the image: the strength of {strength:.3g} is too large, "
            "the noise too small, or the image is not one of this matrix"
        )
    if further.gain > SIGMAS * further.by_chance and own.gain < KEPT * further.gain:
        return f"the strength of {strength:.3g} is too large for the image: a weaker one tells more of it"
    if not own.gain > SIGMAS * own.by_chance:
        return (
            "the image does not determine the volume: half of the pixels tell no more of the other half than "
            f"{'an even volume' if len(x) > 1 else 'the dark'} does"
        )
    return ""


def whole_error(problem: Problem, strength: float, x: Array, alike: Iterable[Array]) -> float:
    """Return the norm of the difference from the truth that is to be expected, with what is not resolved.

    Volumes that are known, with about the image that there is, are reconstructed from their images with noise. The
    largest of their errors, over what was found of them, is taken times what was found here.

    Parameters
    ----------
    problem : Problem
    strength : float
    x : (voxels,) float64
        The volume found.
    alike : iterable of (voxels,) float64
        See `as_deep_as_wide`.
    """
    noise = np.sqrt(problem.misfit(x) / len(problem.b))
    draw = np.random.default_rng(11)
    shares = []
    for known in alike:
        image = problem.rows @ known + noise * draw.standard_normal(len(problem.b))
        found = replace(problem, b=image).path(strength)
        size = float(found @ found)
        shares.append(float(np.sum((found - known) ** 2)) / size if size > 0.0 else np.inf)
    return float(np.sqrt(max(shares) * (x @ x)))


def as_deep_as_wide(volume: Array, depth: int) -> list[Array]:
    """Return volumes with the same sums along the worst-resolved axis, as deep as they are wide along the others.

    Each row of the sums along another axis becomes round in the plane of that axis and the depth, in voxels: an
    emission by the distance from the middle of its light, whose sums are nearest to the row.

    Parameters
    ----------
    volume : (nx, ny, nz) float64
    depth : int
        Number of the worst-resolved axis.
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
    """Return a round emission, (along the row, along the depth), whose sums over the depth are nearest to a row."""
    from scipy import optimize

    if not row.any():
        return np.zeros((len(row), depth))
    along = np.arange(len(row)) - np.average(np.arange(len(row)), weights=row)
    radius = np.hypot(along[:, None], np.arange(depth) - 0.5 * (depth - 1))
    # Linear between whole radii.
    share = np.maximum(1.0 - np.abs(radius[..., None] - np.arange(np.ceil(radius.max()) + 1.0)), 0.0)
    return np.asarray(share @ optimize.nnls(share.sum(axis=1), row)[0])
