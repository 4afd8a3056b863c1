"""Regularised least squares for a volume: how much regularisation the image asks for, and the error that is left.

The volume is the smallest of ½‖(A x − b)/σ‖² + λ R(x) with x ≥ 0. R is half the sum of squared differences of
neighbouring voxels (Tikhonov's), or the sum of the lengths of gradients (total variation). One solver does both: total
variation is a sum of squares whose weights follow the volume. Everything here is in units in which matrix, image and
volume are near 1.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from lfmesh.lightfield.volumes.projection import ProjectionMatrix

Array = NDArray[np.float64]
Say = Callable[[str], None]
Choice = Literal["half-sets", "discrepancy"]

STRONGEST, WEAKEST, STEP = 1024.0, 1e-7, 4.0
"""Strengths from which and to which the path leads, and the factor between them."""

WORSE = 2
"""Strengths in a row that predict worse than the best one, after which the path ends."""

BISECTIONS = 5
"""Of the last step of the path, by the discrepancy principle."""

HALVINGS = 2
"""Ways to halve the pixels."""

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
        Mean emission of a volume that is as bright as the image.
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
        mean = max(float(b.sum() / sums.sum()), np.finfo(np.float64).tiny)
        weighted = rows.multiply(1.0 / noise[:, None]).tocsr()
        own = float((penalty.differences.power(2)).sum())
        return cls(weighted, b / noise, penalty, float(weighted.power(2).sum()) / own, mean)

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
        unit = 1.0 / np.sqrt(size)

        def times(y: Array) -> Array:
            at = unit * y
            return np.asarray(unit * (self.rows.T @ (self.rows @ at) + penalty @ at))

        return unit * nonnegative_minimum(times, unit * (self.rows.T @ self.b), x / unit)

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
    fixed = 1.0 / _largest_eigenvalue(times, len(x))
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

    V. A. Morozov's principle (1966): ‖(A x − b)/σ‖² is the number of pixels.

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

    def try_out(strength: float, x: Array) -> tuple[Array, bool]:
        x = problem.solved(strength, x)
        tried.append((strength, problem.misfit(x) / len(problem.b)))
        say(f"strength {strength:.3g}: squared residual of {tried[-1][1]:.5g} noise variances")
        return x, tried[-1][1] <= 1.0

    within = False
    for strength in steps_to(WEAKEST):
        before = x
        x, within = try_out(strength, x)
        if within:
            break
    if not within:
        raise LfmeshError(
            f'strength = "discrepancy": no volume explains the image within its noise: {tried[-1][1]:.3g} of its '
            'variance is left; give a larger noise, or strength = "half-sets"'
        )
    low, high = strength, min(strength * STEP, STRONGEST)
    for _ in range(BISECTIONS if low < high else 0):
        middle = float(np.sqrt(low * high))
        x, within = try_out(middle, before)
        low, high, before = (middle, high, before) if within else (low, middle, x)
    return low, np.array(tried)


def error_by_halves(problem: Problem, strength: float) -> Array:
    """Return the standard error of each voxel by noise, from volumes of halves of the pixels.

    Half of the pixels, weighted twice, have twice the variance of all, so that half the difference of two halves has
    that of all. Each way to halve them is a draw of its own.
    """
    squares = np.zeros(problem.rows.shape[1])
    for number in range(HALVINGS):
        one, other = (problem.of_pixels(some, 2.0).path(strength) for some in halves(len(problem.b), number))
        squares += 0.25 * (one - other) ** 2
    return np.sqrt(squares / HALVINGS)


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
