"""Errors of a fit: parameters that micro-images cannot tell apart, and the effect of noise on the others."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from lfmesh.errors import LfmeshError

Array = NDArray[np.float64]

NEIGHBOURS = [(rows, columns) for rows in (-1, 0, 1) for columns in (-1, 0, 1)]
"""Offsets of micro-images, rows and columns, over which their errors are correlated."""


def neighbours_meat(residuals: Array, slopes: Array, used: NDArray[np.bool_]) -> Array:
    """Return the covariance of the product of derivative and position errors, (p, p).

    Neighbouring micro-images share pixels, which shift both alike: their errors are correlated, never negatively.
    Products of residuals are averaged over the array by offset; the part absorbed by the fit, computed for independent
    errors, is added.

    Parameters
    ----------
    residuals : (rows, columns, 2) float64, pixels
    slopes : (rows, columns, 2, p) float64
        Derivative of the positions; 0 where unused.
    used : (rows, columns) bool
    """
    left = np.where(used[..., None], residuals, 0.0)
    inverse = np.linalg.inv(np.einsum("rcip,rciq->pq", slopes, slopes))
    variance = (left**2).sum() / max(2.0 * used.sum() - len(inverse), 1.0)
    meat = np.zeros_like(inverse)
    for rows, columns in NEIGHBOURS:
        here, there = _overlap(used.shape, rows, columns)
        pairs = max((used[here] & used[there]).sum(), 1)
        for axis in (0, 1):
            products = np.einsum("rcp,rcq->pq", slopes[here][..., axis, :], slopes[there][..., axis, :])
            taken_out = variance * (inverse * products).sum()
            together = (left[here][..., axis] * left[there][..., axis]).sum() + taken_out
            meat += max(together, 0.0) / pairs * products
    return np.asarray(0.5 * (meat + meat.T))


def _overlap(shape: Sequence[int], rows: int, columns: int) -> tuple[Any, Any]:
    """Return the indices of all lenslets that have a neighbour at an offset, and of that neighbour."""
    height, width = shape
    here = np.s_[max(-rows, 0) : height - max(rows, 0), max(-columns, 0) : width - max(columns, 0)]
    there = np.s_[max(rows, 0) : height + min(rows, 0), max(columns, 0) : width + min(columns, 0)]
    return here, there


@dataclass(frozen=True)
class Split:
    """Fitted parameters, and kept ones that the picture cannot tell apart.

    Attributes
    ----------
    free, kept : list of int
    group : tuple of int
        Parameters not known by themselves: the kept ones, and others that would change with them.
    traded : (free, kept) float64
        Change of a fitted parameter with a kept one for the same picture; both in ranges.
    covariance : (free, free) float64
        In ranges.
    """

    free: list[int]
    kept: list[int]
    group: tuple[int, ...]
    traded: Array
    covariance: Array

    @classmethod
    def of(cls, rows: Array, sigma: float, like: "Split | None" = None) -> "Split":
        """Split parameters by the singular values of a derivative.

        A direction with a standard error above its plausible range is not determined.

        Parameters
        ----------
        rows : (n, p) float64
            Derivative of the residuals, pixels per range.
        sigma : float
            Standard deviation of a residual, pixels; residuals count as independent.
        like : Split, optional
            Keep the same parameters as this one.
        """
        _, singular, directions = np.linalg.svd(rows, full_matrices=False)
        unknown = directions[singular <= sigma]
        # Keep the parameters with the largest share of the unknown directions.
        _, _, order = qr(unknown, mode="economic", pivoting=True) if len(unknown) else (None, None, [])
        kept = like.kept if like is not None else sorted(int(i) for i in order[: len(unknown)])
        free = [i for i in range(rows.shape[1]) if i not in kept]
        if not free:
            raise LfmeshError("the positions of the picture's micro-images scatter too much to determine any parameter")
        covariance: Array = sigma**2 * np.linalg.inv(rows[:, free].T @ rows[:, free]).astype(np.float64)
        if like is not None:
            return cls(free, kept, like.group, like.traded, covariance)
        traded: Array = unknown[:, free].T @ np.linalg.inv(unknown[:, kept].T) if kept else np.zeros((len(free), 0))
        shaken = np.abs(traded).sum(axis=1) > np.sqrt(np.diag(covariance))
        group = tuple(sorted((*kept, *(i for i, far in zip(free, shaken, strict=True) if far))))
        return cls(free, kept, group, traded, covariance)

    def known_to(self, covariance: Array) -> "Split":
        """Return the same split with another (free, free) covariance, in ranges."""
        return replace(self, covariance=covariance)
