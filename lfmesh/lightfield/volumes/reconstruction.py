"""Reconstruction of a volume's emission from one image, by the projection matrix of the camera.

Image b, matrix A and emission x satisfy b = A x, with x ≥ 0. One camera sees a volume from few directions, so many
volumes give the same image; the method selects one.
"""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import LfmeshError, PictureWarning, UnknownErrorWarning, warn_caller
from lfmesh.lightfield.volumes import regularised, volume_error
from lfmesh.lightfield.volumes.algebraic import ITERATIONS, SOLVERS, relative_residual
from lfmesh.lightfield.volumes.projection_matrix import ProjectionMatrix
from lfmesh.lightfield.volumes.resolution_messages import fine_voxels
from lfmesh.notebook import Say, announced, silent
from lfmesh.scene.literals import literal
from lfmesh.transport.render.image import Image

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Array = NDArray[np.float64]
Method = Literal["mart", "rl", "sart", "nnls", "tikhonov", "tv"]

REGULARISED = ("tikhonov", "tv")
"""Methods that weight pixels by their noise and choose the smoothness of the volume."""

MOST_RELAXED = 2.0
"""Relaxation below which MART and SART converge."""


@dataclass(frozen=True)
class Reconstruction:
    """A volume reconstructed from an image.

    Attributes
    ----------
    volume : (nx, ny, nz) or (voxels,) float64
        Emission of each voxel, in the matrix's unit of emission, never negative; 0 for unseen voxels. In the grid's
        shape, if the matrix has a grid.
    seen : like `volume`, bool
        True for voxels with a matrix entry.
    residual : (iterations + 1,) float64
        ‖b − A x‖ / ‖b‖ at the start and after each iteration; for "nnls", "tikhonov" and "tv" only at the end.
    method : str
    warnings : tuple of PictureWarning
        Reasons why the volume is or may be wrong; empty for a matrix without a grid.
    strength : float
        Regularisation of "tikhonov" and "tv". NaN for other methods, like the numbers below.
    tried : (n, 2) float64
        Strengths tried, and their scores: the expected `total_error`; for "half-sets" the squared difference of each
        half from the other's prediction, for "discrepancy" the squared residual, both per pixel and noise variance.
    misfit : float
        Squared residual over the noise, per pixel: 1 if noise explains it. NaN for unknown noise.
    error : like `volume`
        Standard error of each voxel by noise, without unresolved parts such as depth, from volumes of halves of the
        pixels. With two ways of halving, a single voxel's error is known to 50 %.
    total_error : float
        Expected norm of the difference from the truth over all voxels, in the unit of `volume`: noise and unresolved
        parts. The image cannot show the latter. They are taken from a test truth that is, in voxels, as deep along the
        worst-resolved axis as wide along another, the narrower of the two. If the volume is larger than the test truth
        and its noise explain, the error grows in proportion. For single bright voxels it may be a third of the true
        error. NaN without a grid, or if it cannot be determined (an UnknownErrorWarning gives the reason).
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
    """Return the normalised correlation Q of two volumes: 1 if they differ only by a factor.

    Q = Σ E₁E₀ / √(ΣE₁² ΣE₀²), by G. E. Elsinga, F. Scarano, B. Wieneke & B. W. van Oudheusden, "Tomographic particle
    image velocimetry", Exp. Fluids 41 (2006) 933-947; they consider particle volumes with Q above 0.75 good.

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
            raise LfmeshError(f"{name} volume is {'dark' if size == 0.0 else 'not finite'}: it has no quality")
    return float(np.vdot(one / sizes[0], other / sizes[1]))


def reconstruct(
    matrix: Any, image: Image | ArrayLike, method: Method = "mart", iterations: int | None = None,
    relaxation: float | None = None, *, noise: ArrayLike | None = None,
    strength: float | Literal["half-sets", "discrepancy"] | None = None, say: Say | bool | None = None,
) -> Reconstruction:  # fmt: skip
    """Reconstruct the emission of a volume from an image of it.

    Parameters
    ----------
    matrix : ProjectionMatrix, or (pixels, voxels) scipy.sparse array or matrix
        From `lf.projection_matrix`; no entry may be negative.
    image : Image, or (pixels,), (H, W) or (H, W, 1) float64, W
        One value for each row of the matrix: the result of `lf.render(scene)`, or its `mean`. H and W are the sides of
        the rectangle that a ProjectionMatrix's pixels fill. Negative values, due to noise, count as 0 for "mart" and
        "rl".
    method : {"mart", "rl", "sart", "nnls", "tikhonov", "tv"}
        "mart": multiplicative algebraic reconstruction (Gordon, Bender & Herman 1970), row after row, with weights over
        the largest of the matrix. For consistent images it converges to the volume of largest entropy (Lent 1977;
        Herman & Lent 1976). Steps multiply by 0.1 to 10, so a pixel dark by noise erases no voxel that others see.
        "rl": Richardson (1972) and Lucy (1974): all pixels at once, x ← x · Aᵀ(b / A x) / Aᵀ1. Each step raises the
        likelihood of counts with Poisson noise (Shepp & Vardi 1982) and keeps the light of the image.
        "sart": simultaneous algebraic reconstruction (Andersen & Kak 1984), all rows at once, with negative voxels set
        to 0 after each iteration. From zero it converges to least squares with rows weighted by their inverse sums
        (Jiang & Wang 2003).
        "nnls": least squares with x ≥ 0, by scipy's `nnls` or, for large matrices, its L-BFGS-B.
        "tikhonov": minimum of ½‖(A x − b)/σ‖² + ½ λ Σ(differences of neighbouring voxels)² with x ≥ 0; without a grid,
        Σ(voxels)².
        "tv": the same with λ Σ|gradient|, which keeps edges: total variation.
        For the last two, the image determines the strength, and the error is stated.
    iterations : int, optional
        20 for "mart", 100 for "rl" and "sart"; at most 2000 for "nnls". "tikhonov" and "tv" run to convergence.
    relaxation : float, optional
        Factor of each step of "mart" and "sart", 0 to 2 (default: 1).
    noise : float or like `image`, optional
        Standard error σ of the pixels, W, for "tikhonov" and "tv". Default: that of an Image, else equal for all pixels
        and unknown. Pixels with 0 or NaN get the median. Few samples that found little light seem too certain, so σ is
        at least a quarter of the rms noise of pixels equally bright in a first volume (for an Image, at least all of
        it). If noise is known, the matrix's own standard errors for this volume are added in quadrature.
    strength : float, "half-sets" or "discrepancy", optional
        For "tikhonov" and "tv": λ over the value that gives data and penalty equal weight, by the sums of their
        diagonals. Default: the strength with the smallest expected `total_error`; for a matrix without a grid,
        "half-sets".
        "half-sets": two halves of the pixels predict each other best.
        "discrepancy": the largest strength with a squared residual equal to the noise's, which must be known; if there
        is none, 3 standard deviations more are allowed. The matrix's own errors count as noise, so the strength is far
        too large for an image made by this very matrix.
    say : callable or bool, optional
        Called with messages on each strength tried, or on each iteration. True shows the progress, False nothing.
        Default: it is shown at a terminal or in a notebook after two seconds.

    Returns
    -------
    Reconstruction

    Warns
    -----
    FineVoxelsWarning
        The voxels are finer than the camera resolves.
    UnknownErrorWarning
        For "tikhonov" and "tv": the image does not determine the volume, or noise does not explain the residual.

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
    # Scale entries and pixels to about 1, so that results do not depend on units through rounding.
    scale, level = float(rows.data.max()), float(np.abs(b).max())
    if level == 0.0:
        unknown = _unknown_error("the image is dark" if method in REGULARISED else "")
        warn_caller(unknown)
        return Reconstruction(np.zeros(shape), seen.reshape(shape), np.zeros(1), method, (*warned, *unknown))
    unit = level / scale
    rows, b = rows / scale, b / level
    if method in REGULARISED:
        # The error of an Image is estimated from few samples per pixel.
        certain = regularised.CERTAIN
        if noise is None and isinstance(image, Image):
            noise, certain = image.error, 1.0
        sigma = None if noise is None else _noise(noise, b, matrix) / level
        with announced(say) as shown:
            step = silent if callable(say) else shown
            task = _Task(matrix, rows, b, seen, shape, method, unit, certain, shown, step)
            found = task.solved(sigma, strength)
        warn_caller(found.warnings)
        return replace(found, warnings=(*warned, *found.warnings))
    rounds = ITERATIONS[method] if iterations is None else int(iterations)
    with announced(say) as shown:
        x, residual = SOLVERS[method](rows, b, seen, rounds, 1.0 if relaxation is None else float(relaxation), shown)
    x[~seen] = 0.0
    return Reconstruction(x.reshape(shape) * unit, seen.reshape(shape), residual, method, warned)


def _check(method: Any, iterations: Any, relaxation: Any, noise: Any, strength: Any) -> None:
    if not isinstance(method, str) or method not in (*ITERATIONS, *REGULARISED):
        raise LfmeshError(f"method = {literal(method)}: use one of {', '.join((*ITERATIONS, *REGULARISED))}")
    if iterations is not None and method in REGULARISED:
        raise LfmeshError(f'iterations = {literal(iterations)}: method = "{method}" has none; omit it')
    whole = isinstance(iterations, int | np.integer) and not isinstance(iterations, bool)
    if iterations is not None and (not whole or iterations < 1):
        raise LfmeshError(f"iterations = {literal(iterations)}: must be a whole number from 1")
    if relaxation is not None and method not in ("mart", "sart"):
        raise LfmeshError(f'relaxation = {literal(relaxation)}: method = "{method}" has none; omit it')
    if relaxation is not None and (not _is_number(relaxation) or not 0.0 < relaxation < MOST_RELAXED):
        raise LfmeshError(f"relaxation = {literal(relaxation)}: must lie between 0 and {MOST_RELAXED:g}")
    for name, value in (("noise", noise), ("strength", strength)):
        if value is not None and method not in REGULARISED:
            raise LfmeshError(f'{name}: method = "{method}" has none; omit it, or use "tikhonov" or "tv"')
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
    """Regularised least squares for a volume, with entries and pixels scaled to about 1."""

    matrix: Any
    rows: "csr_array"
    b: Array
    seen: NDArray[np.bool_]
    shape: tuple[int, ...]
    method: str
    unit: float
    certain: float
    say: Say
    step: Say

    def solved(self, noise: Array | None, strength: float | str | None) -> Reconstruction:
        """Return the volume, for known or unknown noise of the pixels."""
        if noise is None and strength == "discrepancy":
            raise LfmeshError('strength = "discrepancy": needs noise, the standard error of the pixels')
        # Start with equal weights; pixels dark by chance would dominate with their own errors.
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
        self.step(f"strength {strength:.3g}: the error")
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
        unknown = f"; {why or 'without a grid the unresolved part is unknown'}"
        rest = unknown if np.isnan(total) else f", {total / size:.2g} with the unresolved part"
        self.say(f"strength {strength:.3g}: error by noise {np.linalg.norm(error) / size:.2g} of the volume{rest}")
        whole = self._whole(x)
        return Reconstruction(
            whole.reshape(self.shape) * self.unit, self.seen.reshape(self.shape),
            np.array([relative_residual(self.rows, self.b, whole)]), self.method, _unknown_error(why),
            float(strength), tried, misfit if noise is not None else np.nan,
            self._whole(error).reshape(self.shape) * self.unit, total * self.unit,
        )  # fmt: skip

    def _chosen(self, problem: regularised.Problem, strength: float | str | None) -> tuple[float, Array]:
        """Return the given or chosen strength, and the strengths tried."""
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
        """Return trials with volumes as deep as wide that have about the same image as a volume."""
        coarse = np.nan_to_num(self.matrix.resolved_mm / self.matrix.grid.spacing_mm)
        alike = volume_error.as_deep_as_wide(self._whole(x).reshape(self.shape), int(np.argmax(coarse)))
        return volume_error.Trials.of(problem, x, (each.reshape(-1)[self.seen] for each in alike))

    def _problem(self, noise: Array) -> regularised.Problem:
        lit = np.flatnonzero(np.diff(self.rows.indptr))
        penalty = regularised.penalty(self.shape, self.seen, self.method == "tv")
        rows = self.rows[lit][:, np.flatnonzero(self.seen)]
        return replace(regularised.Problem.of(rows, self.b[lit], noise[lit], penalty), step=self.step)

    def _whole(self, x: Array) -> Array:
        """Return a full volume from its seen voxels, with the others dark."""
        whole = np.zeros(len(self.seen))
        whole[self.seen] = x
        return whole


def _unknown_error(why: str) -> tuple[UnknownErrorWarning, ...]:
    """Return the warning of an unknown error, if there is a reason."""
    return (UnknownErrorWarning(f"the error of the volume is unknown: {why}"),) if why else ()


def _rows_of(matrix: Any) -> tuple["csr_array", tuple[int, ...]]:
    """Return a matrix by rows, float64, without duplicates, and the shape of its volume."""
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
            f"the {name} has the shape {b.shape}, but the matrix has {rows} rows, one per pixel: give {rows} values"
        )
    if isinstance(matrix, ProjectionMatrix) and b.ndim > 1 and matrix.sensor_pixels is not None:
        fits = matrix.image_shape
        if b.shape[:2] != fits:
            valid = f"of the shape {fits}: give that, or" if fits else "that fill no rectangle: give"
            raise LfmeshError(
                f"the {name} has the shape {b.shape}, but the matrix has {rows} pixels {valid} {rows} values in a row"
            )
    if not is_error and not np.isfinite(b).all():
        raise LfmeshError("the image has values that are not finite")
    return np.ascontiguousarray(b.reshape(-1))
