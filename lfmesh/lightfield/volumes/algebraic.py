"""Iterative reconstruction without a noise model: MART, Richardson–Lucy, SART and least squares.

Solvers take a matrix by rows and an image, with entries and pixels near 1. They return the volume and the relative
residual at the start and after each iteration.
"""

from itertools import count
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.kernels.decorators import kernel
from lfmesh.notebook import Say

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Array = NDArray[np.float64]

ITERATIONS: dict[str, int] = {"mart": 20, "rl": 100, "sart": 100, "nnls": 2000}
"""Default number of iterations; for "nnls" the maximum."""

LEAST_STEP = 0.1
"""Limit, with its inverse, of the ratio of a pixel to its model value in a MART step."""

MOST_DENSE = 4_000_000
"""Matrix entries, zeros included, up to which "nnls" uses the method of Lawson and Hanson on a dense matrix."""

CONVERGED = 1e-12
"""Relative change of the squared residual at which "nnls" ends for larger matrices."""


def relative_residual(rows: "csr_array", b: Array, x: Array) -> float:
    """Return ‖b − A x‖ / ‖b‖.

    Parameters
    ----------
    rows : (pixels, voxels) csr_array
    b : (pixels,) float64
    x : (voxels,) float64

    Returns
    -------
    float
    """
    return float(np.linalg.norm(b - rows @ x) / np.linalg.norm(b))


def _mart(
    rows: "csr_array", b: Array, seen: NDArray[np.bool_], rounds: int, step: float, say: Say
) -> tuple[Array, Array]:
    b = np.maximum(b, 0.0)
    # Start from a uniform volume as bright as the image.
    sums = np.asarray(rows.sum(axis=1)).ravel()
    x = np.where(seen, b.sum() / sums.sum(), 0.0)
    if not b.any():
        return np.zeros_like(x), np.zeros(1)
    history = [relative_residual(rows, b, x)]
    for number in range(rounds):
        mart_round(rows.indptr, rows.indices, rows.data, b, step, x)
        history.append(relative_residual(rows, b, x))
        say(_told(number, rounds, history))
    return x, np.array(history)


@kernel
def mart_round(
    first: NDArray[np.int32], column: NDArray[np.int32], entry: Array, b: Array, step: float, x: Array
) -> None:
    """Multiply a volume, row after row, by (b_i / Σ a_ik x_k) to the power of step · a_ij.

    Parameters
    ----------
    first, column, entry
        The matrix by rows, as in scipy's csr; its largest entry is 1.
    b : (pixels,) float64
    step : float
    x : (voxels,) float64
        Changed in place.
    """
    for i in range(len(b)):
        shown = 0.0
        for k in range(first[i], first[i + 1]):
            shown += entry[k] * x[column[k]]
        if shown <= 0.0:
            continue
        ratio = min(max(b[i] / shown, LEAST_STEP), 1.0 / LEAST_STEP)
        for k in range(first[i], first[i + 1]):
            x[column[k]] *= ratio ** (step * entry[k])


def _richardson_lucy(
    rows: "csr_array", b: Array, seen: NDArray[np.bool_], rounds: int, _: float, say: Say
) -> tuple[Array, Array]:
    sums, columns = np.asarray(rows.sum(axis=0)).ravel(), rows.T.tocsr()
    # Pixels that see no voxel are not part of the likelihood.
    b = np.where(np.diff(rows.indptr) > 0, np.maximum(b, 0.0), 0.0)
    x = np.where(seen, b.sum() / sums.sum(), 0.0)
    if not b.any():
        return np.zeros_like(x), np.zeros(1)
    history = [relative_residual(rows, b, x)]
    for number in range(rounds):
        shown = rows @ x
        x = x * _inverse(sums) * (columns @ (b * _inverse(shown)))
        history.append(relative_residual(rows, b, x))
        say(_told(number, rounds, history))
    return x, np.array(history)


def _sart(
    rows: "csr_array", b: Array, seen: NDArray[np.bool_], rounds: int, step: float, say: Say
) -> tuple[Array, Array]:
    over_rows = _inverse(np.asarray(rows.sum(axis=1)).ravel())
    over_columns = step * _inverse(np.asarray(rows.sum(axis=0)).ravel())
    columns = rows.T.tocsr()
    x = np.zeros(rows.shape[1])
    history = [1.0]
    for number in range(rounds):
        x += over_columns * (columns @ (over_rows * (b - rows @ x)))
        np.maximum(x, 0.0, out=x)
        history.append(relative_residual(rows, b, x))
        say(_told(number, rounds, history))
    return x, np.array(history)


def _told(number: int, rounds: int, history: list[float]) -> str:
    return f"iteration {number + 1} of {rounds}, residual {history[-1]:.3g}"


def _inverse(sums: Array) -> Array:
    return np.divide(1.0, sums, out=np.zeros_like(sums), where=sums > 0.0)


def _nnls(rows: "csr_array", b: Array, seen: NDArray[np.bool_], rounds: int, _: float, say: Say) -> tuple[Array, Array]:
    from scipy import optimize

    lit = np.flatnonzero(np.diff(rows.indptr))
    part = rows[lit][:, np.flatnonzero(seen)]
    # Normalise columns, so that weakly seen voxels converge as fast as others.
    length = np.sqrt(np.asarray(part.power(2).sum(axis=0)).ravel())
    part = part.multiply(1.0 / length[None, :]).tocsr()
    if part.shape[0] * part.shape[1] <= MOST_DENSE:
        try:
            found, _residual_of = optimize.nnls(part.toarray(), b[lit], maxiter=max(rounds, 3 * part.shape[1]))
        except RuntimeError:
            raise LfmeshError('method = "nnls" did not converge on this matrix; use "sart"') from None
    else:
        columns, tries = part.T.tocsr(), count(1)

        def squares(y: Array) -> tuple[float, Array]:
            say(f"volume {next(tries)} of at most {2 * rounds}")
            off = part @ y - b[lit]
            return 0.5 * float(off @ off), columns @ off

        options = {"maxiter": rounds, "maxfun": 2 * rounds, "ftol": CONVERGED, "gtol": 0.0, "maxcor": 20}
        bounds = optimize.Bounds(0.0, np.inf)
        found = optimize.minimize(
            squares, np.zeros(part.shape[1]), jac=True, method="L-BFGS-B", bounds=bounds, options=options
        ).x
    x = np.zeros(rows.shape[1])
    x[seen] = found / length
    return x, np.array([relative_residual(rows, b, x)])


SOLVERS = {"mart": _mart, "rl": _richardson_lucy, "sart": _sart, "nnls": _nnls}
"""Solvers by method: each takes rows, image, mask of seen voxels, iterations, relaxation and receiver of progress."""
