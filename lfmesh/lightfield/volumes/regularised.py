"""Regularised least squares for a volume, and the choice of its strength by the image.

The volume minimises ½‖(A x − b)/σ‖² + λ R(x) with x ≥ 0. R is half the sum of squared differences of neighbouring
voxels (Tikhonov), or the sum of gradient lengths (total variation). One solver does both: total variation is a sum of
squares with weights that depend on the volume. Matrix, image and volume are scaled to about 1.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.notebook import Say, silent

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from lfmesh.lightfield.volumes.projection_matrix import ProjectionMatrix

Array = NDArray[np.float64]
Choice = Literal["half-sets", "discrepancy"]

STRONGEST, WEAKEST, STEP = 1024.0, 1e-7, 4.0
"""Strengths at the start and the end of the path, and the factor between steps."""

LARGEST = 1e6
"""Largest strength accepted; rounding hides the data next to a larger penalty."""

SIGMAS = 3.0
"""Standard errors that chance may explain."""

POOL = 100
"""Pixels in a group of equal brightness."""

CERTAIN = 0.25
"""Least standard error of a pixel, for given noise, over that of equally bright pixels."""

WORSE = 2
"""Steps in a row with worse predictions than the best, after which the path ends."""

BISECTIONS = 5
"""Bisections of the path's last step, by the discrepancy principle."""

SETTLED = 1e-5
"""Norm of the projected gradient at the minimum, over that of the dark volume."""

MOST_STEPS = 2000
"""Most steps of the solver for each strength."""

SAID_EVERY = 20
"""Steps of the solver from one message to the next."""

REWEIGHTINGS = 4
"""Reweightings of total variation for each strength."""

ROUNDED = 0.1
"""Gradient, over the mean emission, below which total variation becomes quadratic."""


class Penalty(NamedTuple):
    """The regularisation R of a volume.

    Attributes
    ----------
    differences : (edges, voxels) csr_array
        Differences of neighbouring voxels; for a matrix without a grid, the voxels themselves.
    cell : (edges,) int64
        First voxel of each difference.
    total_variation : bool
    """

    differences: "csr_array"
    cell: NDArray[np.int64]
    total_variation: bool

    def matrix(self, x: Array, mean: float) -> "csr_array":
        """Return P of R(x) = ½ xᵀ P x; for total variation, with the weights of the volume x."""
        from scipy import sparse

        if not self.total_variation:
            return sparse.csr_array(self.differences.T @ self.differences)
        squared = np.bincount(self.cell, (self.differences @ x) ** 2, len(x))
        weight = mean / np.sqrt(squared + (ROUNDED * mean) ** 2)
        return sparse.csr_array(self.differences.T @ self.differences.multiply(weight[self.cell][:, None]))


def penalty(shape: tuple[int, ...], seen: NDArray[np.bool_], total_variation: bool) -> Penalty:
    """Return the penalty of the seen voxels.

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
        Divided by the noise of each pixel, like `b`.
    b : (pixels,) float64
    penalty : Penalty
    scale : float
        λ that gives penalty and data equal weight; strengths are relative to it.
    mean : float
        Mean emission of a volume as bright as the image, or as equally strong noise.
    step : callable
        Called now and then with the progress of the solver in words.
    """

    rows: "csr_array"
    b: Array
    penalty: Penalty
    scale: float
    mean: float
    step: Say = silent

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
        # Without light the sum may be near 0 or negative; noise of this strength sums to about its norm.
        mean = max(float(b.sum()), float(np.linalg.norm(b))) / float(sums.sum())
        weighted = rows.multiply(1.0 / noise[:, None]).tocsr()
        own = float((penalty.differences.power(2)).sum())
        # Voxels without neighbours cannot be smoothed.
        scale = float(weighted.power(2).sum()) / own if own > 0.0 else 0.0
        return cls(weighted, b / noise, penalty, scale, mean)

    def of_pixels(self, some: NDArray[np.int64], weight: float = 1.0) -> "Problem":
        """Return the problem of some pixels, with their squares weighted."""
        root = np.sqrt(weight)
        return replace(self, rows=self.rows[some] * root, b=self.b[some] * root)

    def misfit(self, x: Array) -> float:
        """Return the squared residual over the noise."""
        off = self.rows @ x - self.b
        return float(off @ off)

    def solved(self, strength: float, x: Array) -> Array:
        """Return the volume for a strength, starting from a nearby one."""
        variation = self.penalty.total_variation
        for _ in range(REWEIGHTINGS if variation else 1):
            weighted = strength * self.scale * self.penalty.matrix(x, self.mean)
            x = self._least(weighted, x, f"strength {strength:.3g}")
        return x

    def _least(self, penalty: "csr_array", x: Array, words: str) -> Array:
        # Diagonal scaling, so that weakly seen voxels converge as fast as others.
        size = np.asarray(self.rows.power(2).sum(axis=0)).ravel() + penalty.diagonal()
        # Voxels without information from pixels or neighbours stay unchanged.
        unit = 1.0 / np.sqrt(np.where(size > 0.0, size, 1.0))
        across = self.rows.T

        def times(y: Array) -> Array:
            at = unit * y
            return np.asarray(unit * (across @ (self.rows @ at) + penalty @ at))

        def said(used: int) -> None:
            self.step(f"{words}: step {used} of at most {MOST_STEPS}")

        return unit * nonnegative_minimum(times, unit * (across @ self.b), x / unit, said)

    def path(self, strength: float) -> Array:
        """Return the volume for a strength by way of stronger ones, independent of any start."""
        x = np.full(self.rows.shape[1], self.mean)
        for each in steps_to(strength):
            x = self.solved(each, x)
        return x


def steps_to(strength: float) -> list[float]:
    """Return falling strengths that end with the given one."""
    if strength <= 0.0:
        return [*steps_to(WEAKEST), 0.0]
    above = max(0, int(np.ceil(np.log(STRONGEST / strength) / np.log(STEP))))
    return [strength * STEP**k for k in range(above, -1, -1)]


def nonnegative_minimum(
    times: Callable[[Array], Array], g0: Array, x: Array, said: Callable[[int], None] | None = None
) -> Array:
    """Minimise ½ xᵀ H x − g0ᵀ x with x ≥ 0, by conjugate gradients in the faces of the bounds.

    Z. Dostál & J. Schöberl, "Minimizing quadratic functions over non-negative cone with the rate of convergence and
    finite termination", Comput. Optim. Appl. 30 (2005) 23-43 (MPRGP).

    Parameters
    ----------
    times : callable
        Product of H and a vector; H is symmetric without negative eigenvalues.
    g0, x : (n,) float64
        x is the start of the search.
    said : callable, optional
        Called now and then with the number of steps.
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
        if said is not None and used % SAID_EVERY == 0:
            said(used)
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
    """Return the gradient of free voxels, of dark voxels that would rise, and of free voxels within their bounds."""
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
    """A random half of the pixels, and the other half."""

    one: NDArray[np.int64]
    other: NDArray[np.int64]


def halves(pixels: int, number: int) -> Halves:
    """Halve the pixels in one of several ways."""
    order = np.random.default_rng([7, number]).permutation(pixels)
    return Halves(np.sort(order[: pixels // 2]), np.sort(order[pixels // 2 :]))


def strength_by_halves(problem: Problem, say: Say) -> tuple[float, Array]:
    """Return the strength for the best mutual prediction of two halves of the pixels, and the strengths tried.

    The score is the squared difference, over the noise, of each half from the other volume's prediction. Only ratios of
    the pixels' noise matter. The largest strength within a standard error (over pixels) of the best is taken
    (one-standard-error rule, Breiman et al., 1984), as prediction is hardly sensitive to noise that the camera sees
    badly.

    Returns
    -------
    strength : float
    tried : (n, 2) float64
        Strength, and score per pixel.
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
    """Return the largest strength that explains the image within its noise, and the strengths tried.

    V. A. Morozov's principle (1966): ‖(A x − b)/σ‖² equals the number n of pixels. If no strength reaches n, 3 √(2n)
    more is allowed for scatter between images.

    Returns
    -------
    strength : float
    tried : (n, 2) float64
        Strength, and squared residual per pixel.

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
            f'strength = "discrepancy": no volume explains the image within its noise: {tried[-1][1]:.3g} times '
            'its variance remains; give a larger noise, or strength = "half-sets"'
        )
    low, before = nearly
    high = min(low * STEP, STRONGEST)
    for _ in range(BISECTIONS if low < high else 0):
        middle = float(np.sqrt(low * high))
        x = try_out(middle, before)
        low, high, before = (middle, high, before) if tried[-1][1] <= most else (low, middle, x)
    return low, np.array(tried)


def chance(count: int) -> float:
    """Return the deviation from 1 that noise may cause in a mean of squares over its variance."""
    return SIGMAS * float(np.sqrt(2.0 / count))


def not_too_certain(variance: Array, shown: Array, certain: float) -> Array:
    """Return the variance of pixels, at least a fraction of the mean over pixels equally bright in a volume.

    A pixel's error from its own samples is too small if these found little light by chance; its weight would keep that
    place dark.

    Parameters
    ----------
    variance : (pixels,) float64
    shown : (pixels,) float64
        Image of a volume.
    certain : float
        Least standard error over the root of that mean.
    """
    groups = max(1, len(shown) // POOL)
    group = np.empty(len(shown), np.int64)
    group[np.argsort(shown, kind="stable")] = np.arange(len(shown)) * groups // len(shown)
    mean = np.bincount(group, variance, groups) / np.bincount(group, minlength=groups)
    return np.maximum(variance, certain**2 * mean[group])


def noise_of_matrix(matrix: "ProjectionMatrix", x: Array) -> Array:
    """Return the variance of a volume's image due to the matrix's own noise, (pixels,).

    The mean emission seen by a pixel has the error of the row's sum; differences from it have the errors of the
    entries, taken as independent, which overestimates the variance slightly.
    """
    a = matrix.matrix
    sums = np.asarray(a.sum(axis=1)).ravel()
    mean = np.divide(a @ x, sums, out=np.zeros_like(sums), where=sums > 0.0)
    row = np.repeat(np.arange(a.shape[0]), np.diff(a.indptr))
    entry = np.nan_to_num(matrix.stderr.astype(np.float64)) ** 2 * (x[a.indices] - mean[row]) ** 2
    return np.asarray((np.nan_to_num(matrix.row_stderr) * mean) ** 2 + np.bincount(row, entry, a.shape[0]))
