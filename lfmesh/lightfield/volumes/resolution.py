"""Resolution of a camera in a box of voxels: lengths along its axes, and the rank of its matrix above noise."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Array = NDArray[np.float64]

ALIKE = 0.5
"""Cosine of the images of two voxels above which they are unresolved: half of their light falls on the same pixels."""

PAIRS = 256
"""Most pairs of voxels used for the likeness of images at one distance."""

NOISE = 0.01
"""Fraction of the largest singular value above which others count."""

MOST_EXACT = 2_000
"""Number of voxels or pixels, the smaller one, up to which all singular values are computed."""

PROBED, STEPS = 30_000, 160
"""For larger matrices: voxels times random starts, and Lanczos steps from each start."""

MOST_KEPT = 50_000_000
"""Most numbers kept over all steps; very large matrices get fewer steps."""


def resolved_lengths(matrix: "csr_array", shape: tuple[int, ...], spacing_mm: Array) -> Array:
    """Return the distance between two voxels with half-alike images, along each axis of a grid.

    Likeness is the cosine of two columns of the matrix, as the median over up to 256 pairs. A Gaussian through the
    largest distance in the grid with a likeness above 1/2 gives the length, beyond the grid by extrapolation. If
    neighbours are less alike, the length is the voxel's.

    Parameters
    ----------
    matrix : (pixels, voxels) csr_array
    shape : (int, int, int)
    spacing_mm : (3,) float64

    Returns
    -------
    (3,) float64, mm
        Infinite if the images do not differ at all; NaN along an axis with one voxel.
    """
    columns = matrix.tocsc()
    length = np.sqrt(np.asarray(columns.power(2).sum(axis=0)).ravel())
    number = np.arange(int(np.prod(shape))).reshape(shape)
    found = np.full(3, np.nan)
    for axis in range(3):
        lags = sorted({*(1 << np.arange(32)), shape[axis] - 1} & set(range(1, shape[axis])))
        for lag in lags:
            likeness = _likeness(columns, length, number, axis, lag)
            if lag == 1:
                found[axis] = spacing_mm[axis]
            if not likeness > ALIKE:
                break
            fall = np.maximum(-np.log(likeness), 0.0)
            with np.errstate(divide="ignore"):
                found[axis] = lag * spacing_mm[axis] * np.sqrt(np.log(1.0 / ALIKE) / fall)
    return found


def _likeness(columns: Any, length: Array, number: NDArray[np.int64], axis: int, lag: int) -> float:
    """Return the median cosine of the images of voxels `lag` voxels apart; 0 if no two are seen."""
    one = np.take(number, range(number.shape[axis] - lag), axis=axis).ravel()
    other = np.take(number, range(lag, number.shape[axis]), axis=axis).ravel()
    both = np.flatnonzero((length[one] > 0.0) & (length[other] > 0.0))
    if not len(both):
        return 0.0
    both = both[np.unique(np.linspace(0, len(both) - 1, PAIRS).astype(np.int64))]
    one, other = one[both], other[both]
    shared = np.asarray(columns[:, one].multiply(columns[:, other]).sum(axis=0)).ravel()
    return float(np.median(shared / (length[one] * length[other])))


def effective_rank(matrix: "csr_array") -> int:
    """Count the singular values of a matrix above 1/100 of the largest.

    They are the independent features of a volume above noise of 1 % of the brightest one. Noise of the matrix adds
    features, so too few samples give too large a number. Small matrices are decomposed. In larger ones, stochastic
    Lanczos quadrature (L. Lin, Y. Saad & C. Yang, "Approximating spectral densities of large matrices", SIAM Review 58
    (2016) 34-65) counts to within some per cent.
    """
    rows = matrix[np.flatnonzero(np.diff(matrix.indptr))]
    if min(rows.shape) <= MOST_EXACT:
        squares = (rows @ rows.T if rows.shape[0] < rows.shape[1] else rows.T @ rows).toarray()
        values = np.linalg.eigvalsh(squares)
        return int((values > NOISE**2 * values[-1]).sum())
    return int(min(max(round(_count_above(rows)), 1), *rows.shape))


def _count_above(rows: "csr_array") -> float:
    """Return the expected number of singular values above the noise, by Lanczos recurrence from random starts."""
    n = rows.shape[1]
    starts = max(1, PROBED // n)
    steps = int(np.clip(MOST_KEPT // (starts * n), 2, STEPS))
    basis = np.zeros((steps + 1, starts, n))
    basis[0] = np.random.default_rng(0).choice([-1.0, 1.0], (starts, n)) / np.sqrt(n)
    diagonal, beside = np.zeros((starts, steps)), np.zeros((starts, steps))
    for step in range(steps):
        w = (rows.T @ (rows @ basis[step].T)).T
        diagonal[:, step] = (w * basis[step]).sum(axis=1)
        # Orthogonalise twice against all before; rounding would bring the largest values back.
        for _ in range(2):
            inner = np.einsum("kpn,pn->kp", basis[: step + 1], w)
            w = w - np.einsum("kp,kpn->pn", inner, basis[: step + 1])
        beside[:, step] = np.linalg.norm(w, axis=1)
        basis[step + 1] = np.divide(w, beside[:, step, None], out=np.zeros_like(w), where=beside[:, step, None] > 0.0)
    below = []
    for a, b in zip(diagonal, beside, strict=True):
        squares, vectors = np.linalg.eigh(np.diag(a) + np.diag(b[:-1], 1) + np.diag(b[:-1], -1))
        share = vectors[0] ** 2
        # The cumulative distribution at a node includes half of the node's weight.
        roots = np.sqrt(np.maximum(squares, 0.0))
        below.append(np.interp(NOISE * roots[-1], roots, np.cumsum(share) - 0.5 * share))
    return n * (1.0 - float(np.mean(below)))
