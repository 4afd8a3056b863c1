"""Fit of a camera to its white image: assembly errors, their uncertainties, and undetermined combinations.

Least squares on the positions of the micro-images. Directions that the picture determines worse than the plausible
range, found by singular values, keep the scene's values; the known combinations are reported.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from lfmesh.errors import LfmeshError, PictureWarning, summed_up, warn_caller
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.lightfield.calibration.calibration import calibrate
from lfmesh.lightfield.detector import Exposed
from lfmesh.lightfield.rays.ray_model import RayModel
from lfmesh.notebook import Say, announced
from lfmesh.scene import Scene
from lfmesh.scene.literals import counted, plain
from lfmesh.study.fits.fit_errors import Split, neighbours_meat
from lfmesh.study.fits.fit_model import FitModel, Parameter, parameters_of, smooth
from lfmesh.study.fits.micro_image_phase import micro_image_places
from lfmesh.study.fits.white_picture import Orientation, light_of
from lfmesh.transport.render.image import Image

Array = NDArray[np.float64]

SAMPLES = 128
"""Samples per pixel of simulated white images: their noise is about that of a well exposed picture."""

ROUNDS = 10
"""Largest number of simulated white images."""

SETTLED = 0.25
"""Change by another simulated image, in standard errors (rms over the directions), below which a fit has converged."""

FIRST_SIGMA_PX = 0.02
"""Assumed offset of micro-images from chief rays before any image is simulated."""

OUTLIER = 6.0
"""Distance from the median, in normal standard deviations, that rejects a micro-image: dust, a dead lenslet."""

WORST = 0.05
"""Rms residual, over the micro-image pitch, above which a fit is refused."""


@dataclass(frozen=True)
class Estimate:
    """Fitted parameter.

    Attributes
    ----------
    parameter : Parameter
    value : float
        In the unit of the scene's field.
    standard_error : float
        One standard deviation; NaN if the scene's value was kept.
    together : tuple of str
        Paths of parameters known only in combination with it; the standard error then assumes that the kept ones are
        right.
    """

    parameter: Parameter
    value: float
    standard_error: float
    together: tuple[str, ...]

    @property
    def kept(self) -> bool:
        """True if the scene's value was kept."""
        return math.isnan(self.standard_error)


@dataclass(frozen=True)
class Combination:
    """Known weighted sum of unknown parameters.

    Attributes
    ----------
    coefficients : dict
        Coefficients by path, applied to differences from the scene's values.
    value, standard_error : float
        In the unit of the first path, which has coefficient 1.
    """

    coefficients: dict[str, float]
    value: float
    standard_error: float


@dataclass(frozen=True, eq=False)
class Fit:
    """A camera fitted to its white image.

    Attributes
    ----------
    scene : Scene
        Scene with the fitted values; distances solved from `focus_mm` are given as numbers.
    estimates : tuple of Estimate
    covariance : (p, p) float64
        Covariance of the values, in their units; NaN for kept ones. It covers noise, and the effect of kept values on
        the light within micro-images.
    combinations : tuple of Combination
    pitch_px, pitch_error_px : float
        Mean distance of neighbouring fitted micro-images, and its standard error.
    residuals_px : (rows, columns, 2) float64
        Measured minus simulated positions, by lenslet as on the sensor; NaN: not used.
    sigma_px : float
        Standard deviation of a coordinate, from the residuals: noise of both images, and lenslet deviations.
    left_out : int
        Number of rejected micro-images.
    warnings : tuple of PictureWarning
        Warnings of the simulated white images, one per class.
    """

    scene: Scene
    estimates: tuple[Estimate, ...]
    covariance: Array
    combinations: tuple[Combination, ...]
    pitch_px: float
    pitch_error_px: float
    residuals_px: Array
    sigma_px: float
    left_out: int
    warnings: tuple[PictureWarning, ...]

    def __repr__(self) -> str:
        return f"<Fit: {len(self.estimates)} parameters, {self.used} micro-images, {self.rms_px:.3g} pixels rms>"

    def __getitem__(self, path: str) -> Estimate:
        for each in self.estimates:
            if path in (each.parameter.path, each.parameter.name):
                return each
        raise KeyError(
            f"{path!r} was not fitted; there are {', '.join(each.parameter.path for each in self.estimates)}"
        )

    @property
    def used(self) -> int:
        """Number of micro-images used."""
        return int(np.isfinite(self.residuals_px[..., 0]).sum())

    @property
    def rms_px(self) -> float:
        """Root mean square of the residuals' coordinates."""
        return float(np.sqrt(np.nanmean(self.residuals_px**2)))

    @property
    def notes(self) -> tuple[str, ...]:
        """Reservations about the values, one sentence each."""
        if not self.left_out:
            return ()
        return (f"outliers far from the fit: {counted(self.left_out, 'micro-image')} left out",)


def fit(
    white: Image | Exposed | NDArray[Any], scene: Scene, *, also: Mapping[str, float] | None = None,
    orientation: Orientation = "upright", samples: int = SAMPLES, progress: Say | bool | None = None,
) -> Fit:  # fmt: skip
    """Estimate the assembly errors of a camera from its white image.

    The parameters are rotation, tilts, shifts (up to whole lenslets) and distance of the array relative to the sensor,
    and its pitch error. As in a scene, they are relative to the camera with solved distances.

    Parameters
    ----------
    white : Image, Exposed or (H, W) or (H, W, channels) array
        White image, linear in light; a constant black level is harmless.
    scene : Scene
        Camera as designed.
    also : mapping, optional
        Further fields to fit, with their largest plausible change: {"camera.sensor.distance_mm": 0.05}.
    orientation : {"upright", "upside_down", "sensor"}
        Orientation of an array: as displayed, rotated by 180°, or with row 0 at −y and column 0 at −x of the sensor.
    samples : int
        Samples per pixel of the simulated white images.
    progress : callable or bool, optional
        Called with a description of the current step. True shows it, False nothing. Default: it is shown at a terminal
        or in a notebook after two seconds.

    Returns
    -------
    Fit

    Warns
    -----
    PictureWarning
        Some simulated white images are or may be wrong: one warning per class, see `Fit.warnings`.

    Raises
    ------
    LfmeshError
        The picture has another size, is black or saturated, has too few micro-images, or does not fit the camera.
    """
    if samples < 2:
        raise LfmeshError(f"samples = {samples}: must be 2 or more, one for each of two replicates")
    start = solved_camera(scene.pinned()).scene
    model = FitModel(start, parameters_of(start, also), samples + samples % 2)
    light = light_of(white, start, orientation)
    try:
        with announced(progress) as say:
            return _Search(model, light, say).run()
    finally:
        warn_caller(_warnings(model))


def _warnings(model: FitModel) -> tuple[PictureWarning, ...]:
    return summed_up(model.warned, len(model.warned), "simulated white images")


class _Search:
    """Rounds of a fit; each simulates the camera fitted in the round before."""

    def __init__(self, model: FitModel, light: Array, say: Say) -> None:
        self.model, self.light, self.say = model, light, say
        self.pitch = RayModel.of(model.scene).micro_image_pitch_px
        self.measured = micro_image_places(light, model.scene)
        self.steps = np.zeros(len(model.parameters))
        self.simulated: list[tuple[Array, Array]] = []
        # Derivative of the offsets from the chief rays by the parameters, as simulated and smoothed.
        self.seen = self.slopes = np.zeros((*self.measured.shape, len(self.steps)))
        self.sigma = FIRST_SIGMA_PX
        self.traced: tuple[Array, Array] | None = None
        self.outliers = np.zeros(self.measured.shape[:2], bool)

    def run(self) -> Fit:
        """Fit until the camera has converged.

        Raises
        ------
        LfmeshError
            As for `fit`.
        """
        self.say("tracing derivatives")
        self._fit(self.model.derivative(self.steps))
        self._simulate(1)
        derivative = self.model.derivative(self.steps)
        split = self._fit(derivative)
        self.say("simulating effects beyond chief rays")
        self.seen = self.model.beside_slopes(self.steps, derivative[self._used(derivative)])
        self.slopes = smooth(self.seen)
        # The first image was simulated before the camera was known well.
        self.simulated.clear()
        for number in range(2, ROUNDS + 1):
            self._simulate(number)
            derivative = self.model.derivative(self.steps)
            before = self.steps
            split = self._fit(derivative, split)
            moved = (self.steps - before)[split.free]
            if number > 2 and moved @ np.linalg.solve(split.covariance, moved) < SETTLED**2 * len(moved):
                return self._result(derivative, split)
        raise LfmeshError(
            f"the fit did not converge in {ROUNDS} simulated images; give more samples, or check the scene against "
            "the camera"
        )

    def _simulate(self, number: int) -> None:
        self.say(f"simulating white image {number}")
        beside = self.model.beside(self.model.simulated(self.steps, number), self.steps)
        self.simulated.append((self.steps.copy(), beside))

    def _fit(self, derivative: Array, like: Split | None = None) -> Split:
        """Move to the least-squares solution for the present offsets, and take its scatter as the noise."""
        slopes = derivative + self.slopes
        for _ in range(2):
            used = self._used(derivative)
            split = Split.of(_rows(derivative, used), self.sigma, like)
            rows = _rows(slopes, used)[:, split.free]
            solved = least_squares(
                lambda free, used=used, split=split: self.residuals(self._with(free, split))[used].ravel(),
                self.steps[split.free],
                jac=lambda _, rows=rows: -rows,
                method="trf", x_scale="jac",
            )  # fmt: skip
            self.steps = self._with(solved.x, split)
            self.sigma = math.sqrt(2.0 * solved.cost / max(len(rows) - len(split.free), 1))
            self._check(math.sqrt(2.0 * solved.cost / len(rows)))
            size = np.linalg.norm(self.residuals(self.steps), axis=-1)
            # The median of a Rayleigh distribution is 1.177 σ.
            far = size > OUTLIER * np.nanmedian(size) / math.sqrt(2.0 * math.log(2.0))
            if (far == self.outliers).all():
                break
            self.outliers = far
        split = Split.of(_rows(derivative, used), self.sigma, split)
        return split.known_to(self._covariance(slopes, used, split))

    def _covariance(self, slopes: Array, used: NDArray[np.bool_], split: Split) -> Array:
        """Return the covariance of the fitted parameters: from noise, and from kept ones anywhere in their ranges.

        Kept values do not move the chief rays, but change the size of micro-images and the light in them.
        """
        slopes = np.where(used[..., None, None], slopes, 0.0)
        free = slopes[..., split.free]
        inverse = np.linalg.inv(np.einsum("rcip,rciq->pq", free, free))
        noise = inverse @ neighbours_meat(self.residuals(self.steps), free, used) @ inverse
        unseen = self.seen[..., split.kept] + self.seen[..., split.free] @ split.traded
        known = np.isfinite(unseen).all(axis=(-1, -2))
        # In units of the range, the variance of a uniform distribution of half-width 1 is 1/3.
        moved = inverse @ np.einsum("nip,nik->pk", free[known], unseen[known]) / math.sqrt(3.0)
        return np.asarray(noise + moved @ moved.T)

    def _with(self, free: Array, split: Split) -> Array:
        steps = np.zeros_like(self.steps)
        steps[split.free] = free
        return steps

    def residuals(self, steps: Array) -> Array:
        """Return the offsets of micro-images from a camera's, (rows, columns, 2) pixels."""
        if self.traced is None or not np.array_equal(self.traced[0], steps):
            self.traced = (steps.copy(), self.model.centres(steps))
        return np.asarray(self.measured - self._beside(steps) - self.traced[1])

    def _beside(self, steps: Array) -> Array:
        """Return the offsets of micro-images from chief rays, averaged over all simulated images."""
        if not self.simulated:
            return np.zeros_like(self.measured)
        each = [beside + self.slopes @ (steps - at) for at, beside in self.simulated]
        return np.asarray(np.mean(each, axis=0))

    def _used(self, derivative: Array) -> NDArray[np.bool_]:
        known = np.isfinite(self.residuals(self.steps)).all(axis=-1) & np.isfinite(derivative).all(axis=(-1, -2))
        used = np.asarray(known & ~self.outliers)
        if 2 * used.sum() <= derivative.shape[-1]:
            raise LfmeshError(
                f"the picture shows {used.sum()} whole micro-images: too few to fit {derivative.shape[-1]} parameters"
            )
        return used

    def _check(self, rms: float) -> None:
        if rms > WORST * self.pitch:
            raise LfmeshError(
                f"no camera like the scene's fits this picture: its micro-images lie {plain(rms, 2)} pixels rms from "
                "the best fit; check layout, count, pitch and pixels of the scene, and --orientation"
            )

    def _result(self, derivative: Array, split: Split) -> Fit:
        parameters, reach = self.model.parameters, self.model.reach
        used = self._used(derivative)
        covariance = np.full((len(reach), len(reach)), np.nan)
        covariance[np.ix_(split.free, split.free)] = split.covariance
        covariance *= np.outer(reach, reach)
        errors = np.sqrt(np.diag(covariance))
        together = tuple(parameters[i].path for i in split.group)
        estimates = tuple(
            Estimate(
                each, each.start + float(step) * each.reach, float(error), together if i in split.group else ()
            )
            for i, (each, step, error) in enumerate(zip(parameters, self.steps, errors, strict=True))
        )  # fmt: skip
        fitted = self.model.at(self.steps)
        slopes = self._pitch_slopes(derivative, used)[split.free]
        return Fit(
            scene=fitted,
            estimates=estimates,
            covariance=covariance,
            combinations=self._combinations(split, errors),
            pitch_px=calibrate(fitted).pitch_px,
            pitch_error_px=float(np.sqrt(slopes @ split.covariance @ slopes)),
            residuals_px=np.where(used[..., None], self.residuals(self.steps), np.nan),
            sigma_px=self.sigma,
            left_out=int(self.outliers.sum()),
            warnings=_warnings(self.model),
        )

    def _pitch_slopes(self, derivative: Array, used: NDArray[np.bool_]) -> Array:
        """Return the derivative of the pitch (scale from lattice to centres) by the parameters."""
        lattice = calibrate(self.model.scene).lattice
        ideal = lattice.centres()[used] / lattice.pitch
        ideal = ideal - ideal.mean(axis=0)
        return np.asarray(np.einsum("ni,nip->p", ideal, derivative[used]) / (ideal**2).sum())

    def _combinations(self, split: Split, errors: Array) -> tuple[Combination, ...]:
        """Return a combination for each fitted parameter of the group, with the kept ones."""
        parameters, found = self.model.parameters, []
        for i in (i for i in split.group if i in split.free):
            parts = {parameters[i].path: 1.0}
            for column, kept in enumerate(split.kept):
                part = -split.traded[split.free.index(i), column] * parameters[i].reach / parameters[kept].reach
                parts[parameters[kept].path] = float(part)
            found.append(Combination(parts, float(self.steps[i] * parameters[i].reach), float(errors[i])))
        return tuple(found)


def _rows(derivative: Array, used: NDArray[np.bool_]) -> Array:
    return np.asarray(derivative[used].reshape(-1, derivative.shape[-1]))
