"""Regularised least squares for a volume, and how much regularisation the image asks for.

The volume is the smallest of ½‖(A x − b)/σ‖² + λ R(x) with x ≥ 0. R is half the sum of squared differences of
neighbouring voxels (Tikhonov's), or the sum of the lengths of gradients (total variation). One solver does both: total
variation is a sum of squares whose weights follow the volume. Everything here is in units in which matrix, image and
volume are near 1.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from lfmesh.lightfield.volumes.projection_matrix import ProjectionMatrix

Array = NDArray[np.float64]
Say = Callable[[str], None]
Choice = Literal["half-sets", "discrepancy"]

STRONGEST, WEAKEST, STEP = 1024.0, 1e-7, 4.0
"""Strengths from which and to which the path leads, and the factor between them."""

LARGEST = 1e6
"""Strength that may be given: beside a larger penalty rounding hides what the image says."""

SIGMAS = 3.0
"""Standard errors by which chance may explain something."""

POOL = 100
"""Pixels that count as equally bright."""

CERTAIN = 0.25
"""Least standard error of a pixel, of noise that is given, over that of pixels equally bright."""

WORSE = 2
"""Strengths in a row that predict worse than the best one, after which the path ends."""

BISECTIONS = 5
"""Of the last step of the path, by the discrepancy principle."""

SETTLED = 1e-5
"""Length of the projected gradient over that of the dark volume, at which a minimum is found."""

MOST_STEPS = 2000
"""Of the solver, for each strength."""

REWEIGHTINGS = 4
"""Of total variation, for each strength."""

ROUNDED = 0.1
"""Gradient, over the mean emission, below which total variation turns into squares."""


class Penalty(NamedTuple):
    """The regularisation R of a volume.

    Attributes
    ----------
    differences : (edges, voxels) csr_array
        Differences of neighbouring voxels; of a matrix without a grid the voxels themselves.
    cell : (edges,) int64
        Voxel that each difference starts at.
    total_variation : bool
    """

    differences: "csr_array"
    cell: NDArray[np.int64]
    total_variation: bool

    def matrix(self, x: Array, mean: float) -> "csr_array":
        """Return P of R(x) = ½ xᵀ P x; of total variation with the weights of the volume x."""
        from scipy import sparse

        if not self.total_variation:
            return sparse.csr_array(self.differences.T @ self.differences)
        squared = np.bincount(self.cell, (self.differences @ x) ** 2, len(x))
        weight = mean / np.sqrt(squared + (ROUNDED * mean) ** 2)
        return sparse.csr_array(self.differences.T @ self.differences.multiply(weight[self.cell][:, None]))


def penalty(shape: tuple[int, ...], seen: NDArray[np.bool_], total_variation: bool) -> Penalty:
    """Return the penalty of the voxels that are seen.

    Parameters
    ----------
    shape : (int, int, int) or (int,)
        Of the grid, or of voxels without one.
    seen : (voxels,) bool
    total_variation : bool
    """
    from scipy import sparse

    count = int(seen.sum())
    if len(shape) != 3:
        return Penalty(sparse.identity(count, format="csr"), np.arange(count), total_variation)
    place = np.where(seen, np.cumsum(seen) - 1, -1).reshape(shape)
    pairs = [
        (np.take(place, range(n - 1), axis=axis).ravel(), np.take(place, range(1, n), axis=axis).ravel())
        for axis, n in enumerate(shape)
    ]
    one, other = (np.concatenate(ends) for ends in zip(*pairs, strict=True))
    both = (one >= 0) & (other >= 0)
    one, other = one[both], other[both]
    edge = np.arange(len(one))
    entries = (np.repeat([-1.0, 1.0], len(one)), (np.tile(edge, 2), np.concatenate([one, other])))
    return Penalty(sparse.csr_array(entries, shape=(len(one), count)), one, total_variation)


@dataclass(frozen=True)
class Problem:
    """Least squares with a penalty.

    Attributes
    ----------
    rows : (pixels, voxels) csr_array
        Over the noise of each pixel, as `b` is.
    b : (pixels,) float64
    penalty : Penalty
    scale : float
        Penalty, by λ, that weighs as much as the data: strengths are relative to it.
    mean : float
        Mean emission of a volume that is as bright as the image, or as noise that is as strong.
    """

    rows: "csr_array"
    b: Array
    penalty: Penalty
    scale: float
    mean: float

    @classmethod
    def of(cls, rows: "csr_array", b: Array, noise: Array, penalty: Penalty) -> "Problem":
        """Return the problem of an image.

        Parameters
        ----------
        rows : (pixels, voxels) csr_array
        b : (pixels,) float64
        noise : (pixels,) float64
            Standard error of each pixel, above 0.
        penalty : Penalty
        """
        sums = np.asarray(rows.sum(axis=1)).ravel()
        # Without light the sum may be anything near 0, or below; noise of this strength adds up to about its norm.
        mean = max(float(b.sum()), float(np.linalg.norm(b))) / float(sums.sum())
        weighted = rows.multiply(1.0 / noise[:, None]).tocsr()
        own = float((penalty.differences.power(2)).sum())
        # Of voxels without neighbours nothing can be smoothed.
        scale = float(weighted.power(2).sum()) / own if own > 0.0 else 0.0
        return cls(weighted, b / noise, penalty, scale, mean)

    def of_pixels(self, some: NDArray[np.int64], weight: float = 1.0) -> "Problem":
        """Return the problem of some pixels, their squares weighted."""
        root = np.sqrt(weight)
        return replace(self, rows=self.rows[some] * root, b=self.b[some] * root)

    def misfit(self, x: Array) -> float:
        """Return the squared residual over the noise."""
        off = self.rows @ x - self.b
        return float(off @ off)

    def solved(self, strength: float, x: Array) -> Array:
        """Return the volume for a strength, from one that is near."""
        variation = self.penalty.total_variation
        for _ in range(REWEIGHTINGS if variation else 1):
            x = self._least(strength * self.scale * self.penalty.matrix(x, self.mean), x)
        return x

    def _least(self, penalty: "csr_array", x: Array) -> Array:
        # Diagonal scaling, so that weakly seen voxels are found as soon as others.
        size = np.asarray(self.rows.power(2).sum(axis=0)).ravel() + penalty.diagonal()
        # Voxels that neither these pixels nor neighbours tell anything about stay as they are.
        unit = 1.0 / np.sqrt(np.where(size > 0.0, size, 1.0))
        across = self.rows.T

        def times(y: Array) -> Array:
            at = unit * y
            return np.asarray(unit * (across @ (self.rows @ at) + penalty @ at))

        return unit * nonnegative_minimum(times, unit * (across @ self.b), x / unit)

    def path(self, strength: float) -> Array:
        """Return the volume for a strength by way of stronger ones, so that it depends on nothing else."""
        x = np.full(self.rows.shape[1], self.mean)
        for each in steps_to(strength):
            x = self.solved(each, x)
        return x


def steps_to(strength: float) -> list[float]:
    """Return falling strengths, of which the last is the one given."""
    if strength <= 0.0:
        return [*steps_to(WEAKEST), 0.0]
    above = max(0, int(np.ceil(np.log(STRONGEST / strength) / np.log(STEP))))
    return [strength * STEP**k for k in range(above, -1, -1)]


def nonnegative_minimum(times: Callable[[Array], Array], g0: Array, x: Array) -> Array:
    """Return the smallest of ½ xᵀ H x − g0ᵀ x with x ≥ 0, by conjugate gradients in the faces of its bounds.

    Z. Dostál & J. Schöberl, "Minimizing quadratic functions over non-negative cone with the rate of convergence and
    finite termination", Comput. Optim. Appl. 30 (2005) 23-43 (MPRGP).

    Parameters
    ----------
    times : callable
        H times a vector; H is symmetric and has no negative eigenvalue.
    g0, x : (n,) float64
        x is where the search begins.
    """
    x = np.maximum(x, 0.0)
    largest = _largest_eigenvalue(times, len(x))
    if largest == 0.0:
        return x
    fixed = 1.0 / largest
    g = times(x) - g0
    free, chopped, reduced = _gradients(x, g, fixed)
    p, enough, used = free, (SETTLED * np.linalg.norm(g0)) ** 2, 0
    while used < MOST_STEPS and free @ free + chopped @ chopped > enough:
        used += 1
        if chopped @ chopped > reduced @ free:
            p = chopped
        hp = times(p)
        curved = float(p @ hp)
        if curved <= 0.0:
            break
        ahead = float(g @ p) / curved
        falls = p > 0.0
        room = float((x[falls] / p[falls]).min()) if falls.any() else np.inf
        if ahead <= room:
            x, g = x - ahead * p, g - ahead * hp
            free, chopped, reduced = _gradients(x, g, fixed)
            p = free - (free @ hp / curved) * p
            continue
        x, g = np.maximum(x - room * p, 0.0), g - room * hp
        x = np.maximum(x - fixed * _gradients(x, g, fixed)[0], 0.0)
        g = times(x) - g0
        free, chopped, reduced = _gradients(x, g, fixed)
        p = free
    return x


def _gradients(x: Array, g: Array, fixed: float) -> tuple[Array, Array, Array]:
    """Return the gradient of free voxels, that of dark ones that would rise, and the first as far as voxels reach."""
    is_free = x > 0.0
    free = np.where(is_free, g, 0.0)
    return free, np.where(is_free, 0.0, np.minimum(g, 0.0)), np.where(is_free, np.minimum(x / fixed, free), 0.0)


def _largest_eigenvalue(times: Callable[[Array], Array], n: int) -> float:
    v = np.random.default_rng(0).random(n)
    size = 1.0
    for _ in range(15):
        v = times(v / np.linalg.norm(v))
        size = float(np.linalg.norm(v))
        if size == 0.0:
            break
    return 1.1 * size


class Halves(NamedTuple):
    """A random half of the pixels, and the other."""

    one: NDArray[np.int64]
    other: NDArray[np.int64]


def halves(pixels: int, number: int) -> Halves:
    """Return the pixels of one of several ways to halve them."""
    order = np.random.default_rng([7, number]).permutation(pixels)
    return Halves(np.sort(order[: pixels // 2]), np.sort(order[pixels // 2 :]))


def strength_by_halves(problem: Problem, say: Say) -> tuple[float, Array]:
    """Return the strength with which two halves of the pixels predict each other best, and what was tried.

    The score is the squared difference, over the noise, of each half from what the volume of the other shows it. It
    needs the noise of pixels only as ratios. Of strengths that differ from the best by no more than the standard error
    of that difference, from pixel to pixel, the largest is taken (the one-standard-error rule of Breiman et al., 1984):
    prediction hardly tells noise that the camera sees badly.

    Returns
    -------
    strength : float
    tried : (n, 2) float64
        Strength, and score over the number of pixels.
    """
    parts = [problem.of_pixels(some) for some in halves(len(problem.b), 0)]
    found = [np.full(problem.rows.shape[1], problem.mean)] * 2
    strengths, squares, best = steps_to(WEAKEST), list[Array](), 0
    for number, strength in enumerate(strengths):
        found = [part.solved(strength, x) for part, x in zip(parts, found, strict=True)]
        off = [part.rows @ x - part.b for part, x in zip(parts, reversed(found), strict=True)]
        squares.append(np.concatenate(off) ** 2)
        score = float(squares[-1].mean())
        say(f"strength {strength:.3g}: half-sets of pixels predict each other to {score:.5g} noise variances")
        if score < squares[best].mean():
            best = number
        if number - best >= WORSE:
            break
    beyond = [each - squares[best] for each in squares]
    near = (k for k, each in enumerate(beyond) if each.mean() <= each.std() / np.sqrt(len(each)))
    return strengths[next(near)], np.array([(s, each.mean()) for s, each in zip(strengths, squares, strict=False)])


def strength_by_discrepancy(problem: Problem, say: Say) -> tuple[float, Array]:
    """Return the largest strength whose volume explains the image within its noise, and what was tried.

    V. A. Morozov's principle (1966): ‖(A x − b)/σ‖² is the number n of pixels. It scatters from image to image: where
    no strength brings it there, it may be larger by 3 √(2n).

    Returns
    -------
    strength : float
    tried : (n, 2) float64
        Strength, and squared residual over the number of pixels.

    Raises
    ------
    LfmeshError
        No strength does.
    """
    x = np.full(problem.rows.shape[1], problem.mean)
    tried: list[tuple[float, float]] = []

    def try_out(strength: float, x: Array) -> Array:
        x = problem.solved(strength, x)
        tried.append((strength, problem.misfit(x) / len(problem.b)))
        say(f"strength {strength:.3g}: squared residual of {tried[-1][1]:.5g} noise variances")
        return x

    most = 1.0 + chance(len(problem.b))
    nearly: tuple[float, Array] | None = None
    for strength in steps_to(WEAKEST):
        before, x = x, try_out(strength, x)
        if nearly is None and tried[-1][1] <= most:
            nearly = strength, before
        if tried[-1][1] <= 1.0:
            most, nearly = 1.0, (strength, before)
            break
    if nearly is None:
        raise LfmeshError(
            f'strength = "discrepancy": no volume explains the image within its noise: {tried[-1][1]:.3g} of its '
            'variance is left; give a larger noise, or strength = "half-sets"'
        )
    low, before = nearly
    high = min(low * STEP, STRONGEST)
    for _ in range(BISECTIONS if low < high else 0):
        middle = float(np.sqrt(low * high))
        x = try_out(middle, before)
        low, high, before = (middle, high, before) if tried[-1][1] <= most else (low, middle, x)
    return low, np.array(tried)


def chance(count: int) -> float:
    """Return how far noise may bring a mean of squares, over its variance, from 1."""
    return SIGMAS * float(np.sqrt(2.0 / count))


def not_too_certain(variance: Array, shown: Array, certain: float) -> Array:
    """Return the variance of pixels, none below a share of the mean of those that a volume shows about as bright.

    The error of a pixel that is estimated from its own samples is small where these found little light by chance: its
    weight would hold that place dark.

    Parameters
    ----------
    variance : (pixels,) float64
    shown : (pixels,) float64
        What a volume shows them.
    certain : float
        Least standard error over the root of that mean.
    """
    groups = max(1, len(shown) // POOL)
    group = np.empty(len(shown), np.int64)
    group[np.argsort(shown, kind="stable")] = np.arange(len(shown)) * groups // len(shown)
    mean = np.bincount(group, variance, groups) / np.bincount(group, minlength=groups)
    return np.maximum(variance, certain**2 * mean[group])


def noise_of_matrix(matrix: "ProjectionMatrix", x: Array) -> Array:
    """Return the variance that a matrix, which is an estimate itself, gives to the image of a volume, (pixels,).

    The mean that a pixel sees comes with the error of the row's sum, and differences from that mean with those of the
    entries. Errors of entries count as independent, which makes the variance rather too large.
    """
    a = matrix.matrix
    sums = np.asarray(a.sum(axis=1)).ravel()
    mean = np.divide(a @ x, sums, out=np.zeros_like(sums), where=sums > 0.0)
    row = np.repeat(np.arange(a.shape[0]), np.diff(a.indptr))
    entry = np.nan_to_num(matrix.stderr.astype(np.float64)) ** 2 * (x[a.indices] - mean[row]) ** 2
    return np.asarray((np.nan_to_num(matrix.row_stderr) * mean) ** 2 + np.bincount(row, entry, a.shape[0]))
