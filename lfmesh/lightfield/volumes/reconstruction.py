"""Reconstruction of what a volume emits from one image of it, by the projection matrix of the camera.

Image b, matrix A and emission x belong together as b = A x, with x ≥ 0. One camera sees a volume from few directions,
so that many volumes give the same image: the method says which of them is taken.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import LfmeshError, PictureWarning, UnknownErrorWarning, warn_caller
from lfmesh.lightfield.volumes import regularised, volume_error
from lfmesh.lightfield.volumes.algebraic import ITERATIONS, SOLVERS, relative_residual
from lfmesh.lightfield.volumes.projection_matrix import ProjectionMatrix
from lfmesh.lightfield.volumes.resolution_messages import fine_voxels
from lfmesh.scene.literals import literal
from lfmesh.transport.render.image import Image

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Array = NDArray[np.float64]
Method = Literal["mart", "rl", "sart", "nnls", "tikhonov", "tv"]

REGULARISED = ("tikhonov", "tv")
"""Methods that weight the pixels by their noise, and choose how smooth the volume is."""

MOST_RELAXED = 2.0
"""Relaxation below which MART and SART converge."""


@dataclass(frozen=True)
class Reconstruction:
    """A volume reconstructed from an image.

    Attributes
    ----------
    volume : (nx, ny, nz) or (voxels,) float64
        Emission of each voxel, in the unit that the matrix is per, never negative; 0 where no pixel looks. In the
        shape of the grid, where the matrix brings one.
    seen : like `volume`, bool
        Whether the matrix has any entry for a voxel.
    residual : (iterations + 1,) float64
        ‖b − A x‖ / ‖b‖ at the start and after each iteration; of "nnls", "tikhonov" and "tv" at the end only.
    method : str
    warnings : tuple of PictureWarning
        By which the volume is or may be wrong; empty for a matrix without a grid.
    strength : float
        Regularisation of "tikhonov" and "tv", of the others NaN, as are the rest of the numbers.
    tried : (n, 2) float64
        Strengths that were tried, and the score of each: `total_error` as it is to be expected, where that is what the
        strength is chosen by; else over the number of pixels and the noise's variance, of "half-sets" the squared
        difference of each half from what the other predicts, of "discrepancy" the squared residual.
    misfit : float
        Squared residual over the noise, by the number of pixels: 1 where noise explains it. NaN where no noise is
        known.
    error : like `volume`
        Standard error of each voxel by noise, from volumes of halves of the pixels. What no pixel tells, such as depth
        that is not resolved, is not in it. Of two ways to halve them, so that one voxel's is known to 50 % only.
    total_error : float
        Norm of the difference from the truth that is to be expected, all voxels together, in the unit of `volume`:
        noise, and what is not resolved. No image tells the latter. It is that of a truth which is, in voxels, as deep
        along the worst-resolved axis as it is wide along another, the narrower of the two. Where the volume is larger
        than what such a truth and its noise lead to, the error grows as it does. Single bright voxels are no such
        truth: there it may be a third of the true error. NaN of a matrix without a grid, for which only `error` is
        known, and where it cannot be told: an UnknownErrorWarning says why.
    """

    volume: Array
    seen: NDArray[np.bool_]
    residual: Array
    method: str
    warnings: tuple[PictureWarning, ...] = ()
    strength: float = np.nan
    tried: Array = field(default_factory=lambda: np.zeros((0, 2)))
    misfit: float = np.nan
    error: Array | None = None
    total_error: float = np.nan

    def __repr__(self) -> str:
        shape = " × ".join(map(str, self.volume.shape))
        misfit = "" if np.isnan(self.misfit) else f", misfit {self.misfit:.3g}"
        error = "" if np.isnan(self.total_error) else f", total error {self.total_error:.3g}"
        return f"<Reconstruction: {shape} voxels, {self.method}, residual {self.residual[-1]:.3g}{misfit}{error}>"

    def quality(self, true: ArrayLike) -> float:
        """Return the quality Q against the true volume, see `volume_quality`.

        Parameters
        ----------
        true : (nx, ny, nz) or (voxels,) float

        Returns
        -------
        float
            From 0 to 1.
        """
        return volume_quality(self.volume, true)


def volume_quality(found: ArrayLike, true: ArrayLike) -> float:
    """Return the normalised correlation Q of two volumes: 1 where they differ by a factor only.

    Q = Σ E₁E₀ / √(ΣE₁² ΣE₀²), by G. E. Elsinga, F. Scarano, B. Wieneke & B. W. van Oudheusden, "Tomographic particle
    image velocimetry", Exp. Fluids 41 (2006) 933-947; particle volumes with Q above 0.75 count as good there.

    Parameters
    ----------
    found, true : arrays of the same shape

    Returns
    -------
    float

    Raises
    ------
    LfmeshError
        The shapes differ, or a volume is dark or not finite.
    """
    one, other = np.asarray(found, dtype=np.float64), np.asarray(true, dtype=np.float64)
    if one.shape != other.shape:
        raise LfmeshError(f"volumes of {one.shape} and {other.shape} voxels: give two of the same shape")
    sizes = [float(np.linalg.norm(volume)) for volume in (one, other)]
    for name, size in zip(("the first", "the second"), sizes, strict=True):
        if not 0.0 < size < np.inf:
            raise LfmeshError(f"{name} volume is {'dark all over' if size == 0.0 else 'not finite'}: it has no quality")
    return float(np.vdot(one / sizes[0], other / sizes[1]))


def reconstruct(
    matrix: Any, image: Image | ArrayLike, method: Method = "mart", iterations: int | None = None,
    relaxation: float | None = None, *, noise: ArrayLike | None = None,
    strength: float | Literal["half-sets", "discrepancy"] | None = None, say: Callable[[str], None] | None = None,
) -> Reconstruction:  # fmt: skip
    """Reconstruct the emission of a volume from an image of it.

    Parameters
    ----------
    matrix : ProjectionMatrix, or (pixels, voxels) scipy.sparse array or matrix
        From `lf.projection_matrix`; no entry may be negative.
    image : Image, or (pixels,), (H, W) or (H, W, 1) float64, W
        One value for each row of the matrix: what `lf.render(scene)` returns, or its `mean`. H and W are those of the
        rectangle that the pixels of a ProjectionMatrix fill. Negative ones, which noise makes, count as 0 for "mart"
        and "rl".
    method : {"mart", "rl", "sart", "nnls", "tikhonov", "tv"}
        "mart": the multiplicative algebraic reconstruction of Gordon, Bender & Herman (1970), row after row, with
        weights over the largest of the matrix. For an image that a volume can have, it goes to the volume of largest
        entropy (Lent 1977; Herman & Lent 1976). No step multiplies by less than 0.1 or more than 10, so that a pixel
        that is dark by noise puts out no voxel that others see.
        "rl": Richardson (1972) and Lucy (1974): all pixels at once, x ← x · Aᵀ(b / A x) / Aᵀ1. It raises the likelihood
        of counts with Poisson's noise at each step (Shepp & Vardi 1982), and keeps the light of the image.
        "sart": the simultaneous algebraic reconstruction of Andersen & Kak (1984), all rows of the image at once, with
        negative voxels set to 0 after each iteration. From zero it goes to least squares, a row weighted with the
        inverse of its sum (Jiang & Wang 2003).
        "nnls": least squares with x ≥ 0: scipy's `nnls`, for large matrices its L-BFGS-B.
        "tikhonov": the smallest of ½‖(A x − b)/σ‖² + ½ λ Σ(differences of neighbouring voxels)² with x ≥ 0; of a
        matrix without a grid, of the voxels themselves.
        "tv": the same with λ Σ|gradient|, which keeps edges: total variation.
        Of both, the strength is chosen by the image, and the error stated.
    iterations : int, optional
        20 for "mart", 100 for "rl" and "sart"; 2000 at most for "nnls". "tikhonov" and "tv" end when they are settled.
    relaxation : float, optional
        Factor of each step, 0 to 2; 1 if left out. Of "mart" and "sart" only.
    noise : float or like `image`, optional
        Standard error σ of the pixels, W, of "tikhonov" and "tv": that of an Image if left out, else the same for all,
        and not known. Pixels with 0 or NaN count as the median one. Few samples that found little light by chance seem
        to be certain of the dark: no pixel has less than a quarter of the noise, root of the mean square, of those that
        a first volume shows about as bright, of an Image no less than that noise. Where the noise is known, what the
        matrix's own standard errors make of this volume is added by squares.
    strength : float, "half-sets" or "discrepancy", optional
        Of "tikhonov" and "tv": λ over that at which data and penalty weigh the same, by the sums of their diagonals.
        If left out, the one of which the least `total_error` is to be expected; of a matrix without a grid "half-sets".
        "half-sets": the one with which two halves of the pixels predict each other best.
        "discrepancy": the largest one that leaves a squared residual of the noise's, which must be known; where none
        does, 3 standard deviations more are allowed. The matrix's own errors count as noise, so that for an image that
        this very matrix has made "discrepancy" is far too strong.
    say : callable, optional
        Called with lines for the user: each strength that is tried, and what came of it.

    Returns
    -------
    Reconstruction

    Warns
    -----
    FineVoxelsWarning
        The voxels are finer than the camera resolves.
    UnknownErrorWarning
        Of "tikhonov" and "tv": the image does not determine the volume, or noise does not explain what is left of it.

    Raises
    ------
    LfmeshError
        The shapes do not fit, an entry is negative or not finite, or a setting is out of range.
    """
    _check(method, iterations, relaxation, noise, strength)
    rows, shape = _rows_of(matrix)
    b = _pixels("image", image.mean if isinstance(image, Image) else image, rows.shape[0], matrix)
    seen = np.zeros(rows.shape[1], np.bool_)
    seen[rows.indices[rows.data > 0.0]] = True
    if not seen.any():
        raise LfmeshError("the matrix has no entry above 0: its camera does not see the grid")
    warned = tuple(fine_voxels(matrix, int(seen.sum()))) if isinstance(matrix, ProjectionMatrix) else ()
    warn_caller(warned)
    # By rounding alone a unit could decide: the steps are computed with entries and pixels near 1.
    scale, level = float(rows.data.max()), float(np.abs(b).max())
    if level == 0.0:
        unknown = _unknown_error("the image is dark" if method in REGULARISED else "")
        warn_caller(unknown)
        return Reconstruction(np.zeros(shape), seen.reshape(shape), np.zeros(1), method, (*warned, *unknown))
    unit = level / scale
    rows, b = rows / scale, b / level
    if method in REGULARISED:
        # That of an Image is estimated from few samples of each pixel.
        certain = regularised.CERTAIN
        if noise is None and isinstance(image, Image):
            noise, certain = image.error, 1.0
        sigma = None if noise is None else _noise(noise, b, matrix) / level
        task = _Task(matrix, rows, b, seen, shape, method, unit, certain, say or (lambda _: None))
        found = task.solved(sigma, strength)
        warn_caller(found.warnings)
        return replace(found, warnings=(*warned, *found.warnings))
    rounds = ITERATIONS[method] if iterations is None else int(iterations)
    x, residual = SOLVERS[method](rows, b, seen, rounds, 1.0 if relaxation is None else float(relaxation))
    x[~seen] = 0.0
    return Reconstruction(x.reshape(shape) * unit, seen.reshape(shape), residual, method, warned)


def _check(method: Any, iterations: Any, relaxation: Any, noise: Any, strength: Any) -> None:
    if not isinstance(method, str) or method not in (*ITERATIONS, *REGULARISED):
        raise LfmeshError(f"method = {literal(method)}: use one of {', '.join((*ITERATIONS, *REGULARISED))}")
    if iterations is not None and method in REGULARISED:
        raise LfmeshError(f'iterations = {literal(iterations)}: method = "{method}" has none; leave it out')
    whole = isinstance(iterations, int | np.integer) and not isinstance(iterations, bool)
    if iterations is not None and (not whole or iterations < 1):
        raise LfmeshError(f"iterations = {literal(iterations)}: must be a whole number from 1")
    if relaxation is not None and method not in ("mart", "sart"):
        raise LfmeshError(f'relaxation = {literal(relaxation)}: method = "{method}" has none; leave it out')
    if relaxation is not None and (not _is_number(relaxation) or not 0.0 < relaxation < MOST_RELAXED):
        raise LfmeshError(f"relaxation = {literal(relaxation)}: must lie between 0 and {MOST_RELAXED:g}")
    for name, value in (("noise", noise), ("strength", strength)):
        if value is not None and method not in REGULARISED:
            raise LfmeshError(f'{name}: method = "{method}" has none; leave it out, or take "tikhonov" or "tv"')
    if strength in (None, "half-sets", "discrepancy"):
        return
    if not _is_number(strength) or not 0.0 <= strength <= regularised.LARGEST:
        raise LfmeshError(
            f"strength = {literal(strength)}: must be a number from 0 to {regularised.LARGEST:.0e}, "
            '"half-sets" or "discrepancy"'
        )


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _noise(noise: ArrayLike, b: Array, matrix: Any) -> Array:
    """Return the standard error of each pixel, above 0."""
    given = np.full(len(b), noise) if np.ndim(noise) == 0 else noise
    sigma = _pixels("noise", given, len(b), matrix, is_error=True)
    known = sigma > 0.0
    if not known.any() or (sigma < 0.0).any() or np.isinf(sigma).any():
        raise LfmeshError(
            "noise: must be standard errors of the pixels, from 0 and finite, at least one of them above 0"
        )
    return np.where(known, sigma, np.median(sigma[known]))


@dataclass(frozen=True)
class _Task:
    """A volume that is to be found by regularised least squares, in units in which entries and pixels are near 1."""

    matrix: Any
    rows: "csr_array"
    b: Array
    seen: NDArray[np.bool_]
    shape: tuple[int, ...]
    method: str
    unit: float
    certain: float
    say: Callable[[str], None]

    def solved(self, noise: Array | None, strength: float | str | None) -> Reconstruction:
        """Return the volume, for noise of the pixels that is known or not."""
        if noise is None and strength == "discrepancy":
            raise LfmeshError('strength = "discrepancy": needs noise, the standard error of the pixels')
        # Pixels that weigh the same: by errors of their own those that chance left dark would decide.
        problem = self._problem(np.full(len(self.b), 1.0 if noise is None else np.sqrt(np.mean(noise**2))))
        if noise is not None:
            first = self._whole(problem.path(1.0))
            variance = regularised.not_too_certain(noise**2, self.rows @ first, self.certain)
            if isinstance(self.matrix, ProjectionMatrix):
                level = float(np.abs(self.matrix.matrix.data).max()) * self.unit
                variance = variance + regularised.noise_of_matrix(self.matrix, first * self.unit) / level**2
            problem = self._problem(np.sqrt(variance))
        strength, tried = self._chosen(problem, strength)
        x = problem.path(strength)
        halved = volume_error.Halved.of(problem, strength)
        error = volume_error.error_by_halves(halved)
        total = np.nan
        why = volume_error.why_unknown(problem, strength, x, halved[-1], is_noise_known=noise is not None)
        if isinstance(self.matrix, ProjectionMatrix) and not why:
            trials = self._trials(problem, x)
            total = trials.error(x, [each.path(strength) for each in trials.problems])
            why = trials.why_no_better_than_dark(total)
            total = np.nan if why else total
        misfit = problem.misfit(x) / len(problem.b)
        size = max(float(np.linalg.norm(x)), np.finfo(np.float64).tiny)
        unknown = f"; {why or 'without a grid it is not known what is not resolved'}"
        rest = unknown if np.isnan(total) else f", {total / size:.2g} with what is not resolved"
        self.say(f"strength {strength:.3g}: error of {np.linalg.norm(error) / size:.2g} of the volume by noise{rest}")
        whole = self._whole(x)
        return Reconstruction(
            whole.reshape(self.shape) * self.unit, self.seen.reshape(self.shape),
            np.array([relative_residual(self.rows, self.b, whole)]), self.method, _unknown_error(why),
            float(strength), tried, misfit if noise is not None else np.nan,
            self._whole(error).reshape(self.shape) * self.unit, total * self.unit,
        )  # fmt: skip

    def _chosen(self, problem: regularised.Problem, strength: float | str | None) -> tuple[float, Array]:
        """Return the strength that is given or chosen, and what was tried."""
        if strength == "discrepancy":
            return regularised.strength_by_discrepancy(problem, self.say)
        if isinstance(strength, int | float | np.number):
            return float(strength), np.zeros((0, 2))
        by_halves = regularised.strength_by_halves(problem, self.say)
        first = problem.path(by_halves[0])
        if strength == "half-sets" or not isinstance(self.matrix, ProjectionMatrix) or not first.any():
            return by_halves
        best, tried = volume_error.strength_of_least_error(problem, self._trials(problem, first), self.say)
        return best, tried * np.array([1.0, self.unit])

    def _trials(self, problem: regularised.Problem, x: Array) -> volume_error.Trials:
        """Return trials with volumes as deep as wide that have about the image of a volume."""
        coarse = np.nan_to_num(self.matrix.resolved_mm / self.matrix.grid.spacing_mm)
        alike = volume_error.as_deep_as_wide(self._whole(x).reshape(self.shape), int(np.argmax(coarse)))
        return volume_error.Trials.of(problem, x, (each.reshape(-1)[self.seen] for each in alike))

    def _problem(self, noise: Array) -> regularised.Problem:
        lit = np.flatnonzero(np.diff(self.rows.indptr))
        penalty = regularised.penalty(self.shape, self.seen, self.method == "tv")
        return regularised.Problem.of(self.rows[lit][:, np.flatnonzero(self.seen)], self.b[lit], noise[lit], penalty)

    def _whole(self, x: Array) -> Array:
        """Return a volume of the voxels that are seen with the others dark."""
        whole = np.zeros(len(self.seen))
        whole[self.seen] = x
        return whole


def _unknown_error(why: str) -> tuple[UnknownErrorWarning, ...]:
    """Return the warning that nobody can tell how far a volume is from the truth, if there is a reason."""
    return (UnknownErrorWarning(f"the error of the volume cannot be told: {why}"),) if why else ()


def _rows_of(matrix: Any) -> tuple["csr_array", tuple[int, ...]]:
    """Return a matrix by its rows, float64, without duplicates, and the shape of its volume."""
    from scipy import sparse

    sparse_one = getattr(matrix, "matrix", matrix)
    if not sparse.issparse(sparse_one) or sparse_one.ndim != 2:
        raise LfmeshError(
            f"matrix is {type(matrix).__name__}: give what lf.projection_matrix returns, or a scipy.sparse array"
        )
    rows = sparse.csr_array(sparse_one, dtype=np.float64)
    if not rows.has_canonical_format:
        rows = rows.copy()
        rows.sum_duplicates()
    if not (np.isfinite(rows.data).all() and (rows.data >= 0.0).all()):
        raise LfmeshError("the matrix has entries that are negative or not finite: light only adds")
    shape = tuple(int(n) for n in matrix.grid.shape) if hasattr(matrix, "grid") else (rows.shape[1],)
    return rows, shape


def _pixels(name: str, image: ArrayLike, rows: int, matrix: Any, *, is_error: bool = False) -> Array:
    """Return one value for each row of the matrix."""
    try:
        if np.iscomplexobj(image):
            raise LfmeshError(f"the {name} is complex: give real numbers, W")
        b = np.asarray(image, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise LfmeshError(f"{name} must be numbers: {error}") from None
    if b.size != rows or (b.ndim == 3 and b.shape[2] != 1) or b.ndim > 3:
        raise LfmeshError(
            f"the {name} has the shape {b.shape} and the matrix {rows} rows, one a pixel: give {rows} values"
        )
    if isinstance(matrix, ProjectionMatrix) and b.ndim > 1 and matrix.sensor_pixels is not None:
        fits = matrix.image_shape
        if b.shape[:2] != fits:
            valid = f"of the shape {fits}: give that, or" if fits else "that fill no rectangle: give"
            raise LfmeshError(
                f"the {name} has the shape {b.shape} and the matrix {rows} pixels {valid} {rows} values in a row"
            )
    if not is_error and not np.isfinite(b).all():
        raise LfmeshError("the image has values that are not finite")
    return np.ascontiguousarray(b.reshape(-1))
