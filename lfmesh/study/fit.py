"""Fit of a camera to its white image: the assembly errors with their errors, and what the picture cannot tell apart.

Least squares on the places of the micro-images. Directions in which they tell less than what is plausible anyway
are found by the singular values of the derivative; along these the scene's own values are kept, and what is known is
reported as a combination.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr
from scipy.optimize import least_squares

from lfmesh.errors import LfmeshError
from lfmesh.geometry.solved_camera import solved_camera
from lfmesh.lightfield.calibration import calibrate
from lfmesh.lightfield.detector import Exposed
from lfmesh.lightfield.ray_model import RayModel
from lfmesh.scene import Scene
from lfmesh.study.fit_model import FitModel, Parameter, parameters_of
from lfmesh.study.micro_image_phase import micro_image_places
from lfmesh.study.white_picture import Orientation, light_of
from lfmesh.transport.render.image import Image

Array = NDArray[np.float64]

SAMPLES = 128
"""A pixel, of the simulated white images: their noise is then about that of a well exposed picture."""

ROUNDS = 10
"""Simulated white images at most."""

ASIDE = 0.5
"""Of the range: how far what is kept is moved to see what that does to the micro-images."""

SETTLED = 0.25
"""Of a standard error: a fit that moves less from one simulated image to the next is done."""

FIRST_SIGMA_PX = 0.02
"""About what micro-images lie beside chief rays as long as no image was simulated."""

OUTLIER = 6.0
"""Standard deviations of a normal law, off the median, beyond which a micro-image is left out: dust, a dead lenslet."""

WORST = 0.05
"""Of the pitch of the micro-images: residuals of more, rms, are no fit."""


@dataclass(frozen=True)
class Estimate:
    """A parameter as fitted.

    Attributes
    ----------
    parameter : Parameter
    value : float
        In the unit of the scene's field.
    standard_error : float
        One standard deviation; NaN where the value is that of the scene, which was kept.
    together : tuple of str
        Paths of the parameters with which it is known only in combination: the standard error then holds if those
        that were kept are right. Empty: it is known by itself.
    """

    parameter: Parameter
    value: float
    standard_error: float
    together: tuple[str, ...]

    @property
    def kept(self) -> bool:
        """Whether the scene's value was kept."""
        return math.isnan(self.standard_error)


@dataclass(frozen=True)
class Combination:
    """A sum of parameters that is known where they themselves are not.

    Attributes
    ----------
    coefficients : dict
        By path; the sum is that of coefficient times difference from the scene's value.
    value, standard_error : float
        In the unit of the first path, whose coefficient is 1.
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
        With the fitted values; distances that `focus_mm` had solved stand as numbers.
    estimates : tuple of Estimate
    covariance : (p, p) float64
        Of the values, in their units; NaN for those that were kept. It holds the noise, and what kept values anywhere
        in their range would do to the light within micro-images.
    combinations : tuple of Combination
    pitch_px, pitch_error_px : float
        Mean distance of neighbouring micro-images as fitted, and its standard error.
    residuals_px : (rows, columns, 2) float64
        Micro-images less those of the fitted camera's simulated image, by lenslet as on the sensor; NaN: not used.
    sigma_px : float
        Standard deviation of a coordinate of a micro-image's place, from the residuals: the noise of both images, and
        whatever single lenslets do.
    left_out : int
        Micro-images that lie far beside the fit.
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
        """Number of micro-images that were used."""
        return int(np.isfinite(self.residuals_px[..., 0]).sum())

    @property
    def rms_px(self) -> float:
        """Root mean square of the coordinates of the residuals."""
        return float(np.sqrt(np.nanmean(self.residuals_px**2)))

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know before trusting the values, a sentence each."""
        if not self.left_out:
            return ()
        return (f"{self.left_out} micro-images lie far beside the fit and were left out",)


def fit(
    white: Image | Exposed | NDArray[Any], scene: Scene, *, also: Mapping[str, float] | None = None,
    orientation: Orientation = "upright", samples: int = SAMPLES, progress: Callable[[str], None] | None = None,
) -> Fit:  # fmt: skip
    """Estimate the assembly errors of a camera from its white image.

    Fitted are rotation, tilts, shifts and distance of the array against the sensor, and the error of its pitch. Shifts
    are known up to whole lenslets. Like an error in the scene, each is counted from the camera with solved distances.

    Parameters
    ----------
    white : Image, Exposed or (H, W) or (H, W, channels) array
        White image, linear in light; a constant black level does no harm. Arrays are pictures.
    scene : Scene
        The camera as designed.
    also : mapping, optional
        Further fields to fit, with their largest plausible change: {"camera.sensor.distance_mm": 0.05}.
    orientation : {"upright", "upside_down", "sensor"}
        Of an array: as a viewer shows it, turned by half a turn, or row 0 at the sensor's −y and column 0 at its −x.
    samples : int
        A pixel, of the simulated white images with which the picture is compared.
    progress : callable, optional
        Called with what is being done.

    Raises
    ------
    LfmeshError
        A picture of another size, black, saturated, with too few micro-images, or that no such camera takes.
    """
    if samples < 2:
        raise LfmeshError(f"samples = {samples}: must be 2 or more, one for each of two replicates")
    start = solved_camera(scene).scene
    model = FitModel(start, parameters_of(start, also), samples + samples % 2)
    light = light_of(white, start, orientation)
    return _Search(model, light, progress or (lambda _: None)).run()


class _Search:
    """The rounds of a fit: each simulates the white image of the camera that the one before found."""

    def __init__(self, model: FitModel, light: Array, say: Callable[[str], None]) -> None:
        self.model, self.light, self.say = model, light, say
        self.pitch = RayModel.of(model.scene).micro_image_pitch_px
        self.measured = micro_image_places(light, model.scene)
        self.steps = np.zeros(len(model.parameters))
        self.beside = np.zeros_like(self.measured)
        self.sigma = FIRST_SIGMA_PX
        self.traced: tuple[Array, Array] | None = None
        self.unseen = np.zeros((*self.measured.shape, 0))
        self.outliers = np.zeros(self.measured.shape[:2], bool)

    def run(self) -> Fit:
        """Fit until the camera no longer moves.

        Raises
        ------
        LfmeshError
            As `fit`.
        """
        self.say("tracing derivatives")
        derivative = self.model.derivative(self.steps)
        split = self._fit(derivative)
        for number in range(1, ROUNDS + 1):
            self.say(f"simulating white image {number}")
            self.beside = self.model.beside(self.model.simulated(self.steps), self.steps)
            if number == 1:
                derivative = self.model.derivative(self.steps)
                split = self._fit(derivative)
                self.say("simulating what is kept")
                self.unseen = self._unseen(split)
                continue
            before = self.steps
            split = self._fit(derivative, split)
            moved = (self.steps - before)[split.free] / np.sqrt(np.diag(split.covariance))
            if np.abs(moved).max() < SETTLED:
                return self._result(derivative, split)
        raise LfmeshError(
            f"the fit did not settle in {ROUNDS} simulated images; give more samples, or check the scene against the "
            "camera"
        )

    def _unseen(self, split: "Split") -> Array:
        """Return what the search finds beside chief rays if kept parameters change, (rows, columns, 2, kept) pixels.

        Chief rays land in the same places then, but micro-images have another size: pixels sample them differently, and
        the light in them is spread otherwise. What that may do to the fitted ones is part of their errors.
        """
        patterns = []
        for column, kept in enumerate(split.kept):
            way = np.zeros(len(self.steps))
            way[kept] = 1.0
            way[split.free] = split.traded[:, column]
            ends = [self.steps + sign * ASIDE * way for sign in (1.0, -1.0)]
            up, down = (self.model.beside(self.model.simulated(end), end) for end in ends)
            patterns.append((up - down) / (2.0 * ASIDE))
        return np.stack(patterns, axis=-1) if patterns else self.unseen

    def _fit(self, derivative: Array, like: "Split | None" = None) -> "Split":
        """Move to the least squares with the present offsets, and take their scatter as the noise."""
        for _ in range(2):
            used = self._used(derivative)
            rows = derivative[used].reshape(-1, derivative.shape[-1])
            split = Split.of(rows, self.sigma, like)
            solved = least_squares(
                lambda free, used=used, split=split: self.residuals(self._with(free, split))[used].ravel(),
                self.steps[split.free],
                jac=lambda _, rows=rows, split=split: -rows[:, split.free],
                method="trf", x_scale="jac",
            )  # fmt: skip
            self.steps = self._with(solved.x, split)
            self.sigma = math.sqrt(2.0 * solved.cost / max(len(rows) - len(split.free), 1))
            self._check(math.sqrt(2.0 * solved.cost / len(rows)))
            size = np.linalg.norm(self.residuals(self.steps), axis=-1)
            # The median of a Rayleigh law is 1.177 σ.
            far = size > OUTLIER * np.nanmedian(size) / math.sqrt(2.0 * math.log(2.0))
            if (far == self.outliers).all():
                break
            self.outliers = far
        return Split.of(rows, self.sigma, split, self._meat(derivative, used))

    def _meat(self, derivative: Array, used: NDArray[np.bool_]) -> Array:
        """Return the covariance of the derivative's product with the residuals, (p, p).

        What is found of one micro-image shares pixels with its neighbours: residuals of neighbours are correlated.
        The products of residuals are averaged over the array, by the distance in columns and rows. What is kept may lie
        anywhere in its range.
        """
        residuals = np.where(used[..., None], self.residuals(self.steps), 0.0)
        slopes = np.where(used[..., None, None], derivative, 0.0)
        meat = np.zeros((len(self.steps), len(self.steps)))
        for rows, columns in NEIGHBOURS:
            here, there = _overlap(used.shape, rows, columns)
            pairs = max((used[here] & used[there]).sum(), 1)
            for axis in (0, 1):
                product = (residuals[here][..., axis] * residuals[there][..., axis]).sum() / pairs
                meat += product * np.einsum("rcp,rcq->pq", slopes[here][..., axis, :], slopes[there][..., axis, :])
        known = used & np.isfinite(self.unseen).all(axis=(-1, -2))
        # The variance of a uniform law of half width 1, in ranges, is 1/3.
        moved = np.einsum("nip,nik->pk", derivative[known], self.unseen[known]) / math.sqrt(3.0)
        freedom = 2.0 * used.sum() / max(2.0 * used.sum() - len(self.steps), 1.0)
        return freedom * 0.5 * (meat + meat.T) + moved @ moved.T

    def _with(self, free: Array, split: "Split") -> Array:
        steps = np.zeros_like(self.steps)
        steps[split.free] = free
        return steps

    def residuals(self, steps: Array) -> Array:
        """Return where micro-images lie beside those of a camera, (rows, columns, 2) pixels."""
        if self.traced is None or not np.array_equal(self.traced[0], steps):
            self.traced = (steps.copy(), self.model.centres(steps))
        return np.asarray(self.measured - self.beside - self.traced[1])

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
                f"no camera like the scene's takes this picture: its micro-images lie {rms:.2g} pixels rms beside the "
                "best fit; check layout, count, pitch and pixels of the scene, and --orientation"
            )

    def _result(self, derivative: Array, split: "Split") -> Fit:
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
        )

    def _pitch_slopes(self, derivative: Array, used: NDArray[np.bool_]) -> Array:
        """Return the derivative of the pitch, the scale from lattice to centres, by the parameters."""
        lattice = calibrate(self.model.scene).lattice
        ideal = lattice.centres()[used] / lattice.pitch
        ideal = ideal - ideal.mean(axis=0)
        return np.asarray(np.einsum("ni,nip->p", ideal, derivative[used]) / (ideal**2).sum())

    def _combinations(self, split: "Split", errors: Array) -> tuple[Combination, ...]:
        """Return each fitted parameter of the group with the parts of those that were kept."""
        parameters, found = self.model.parameters, []
        for i in (i for i in split.group if i in split.free):
            parts = {parameters[i].path: 1.0}
            for column, kept in enumerate(split.kept):
                part = -split.traded[split.free.index(i), column] * parameters[i].reach / parameters[kept].reach
                parts[parameters[kept].path] = float(part)
            found.append(Combination(parts, float(self.steps[i] * parameters[i].reach), float(errors[i])))
        return tuple(found)


NEIGHBOURS = [(rows, columns) for rows in (-1, 0, 1) for columns in (-1, 0, 1)]
"""Distances of micro-images, rows and columns, over which their errors are correlated."""


def _overlap(shape: tuple[int, ...], rows: int, columns: int) -> tuple[Any, Any]:
    """Return the indices of all lenslets that have one at a distance, and of that one."""
    height, width = shape
    here = np.s_[max(-rows, 0) : height - max(rows, 0), max(-columns, 0) : width - max(columns, 0)]
    there = np.s_[max(rows, 0) : height + min(rows, 0), max(columns, 0) : width + min(columns, 0)]
    return here, there


@dataclass(frozen=True)
class Split:
    """Which parameters can be fitted, and which have to be kept since the picture cannot tell them apart.

    Attributes
    ----------
    free, kept : list of int
    group : tuple of int
        Those that are not known by themselves: what was kept, and what would change with it.
    traded : (free, kept) float64
        By how much a fitted one changes with a kept one if the picture stays the same; both in ranges.
    covariance : (free, free) float64
        In ranges.
    """

    free: list[int]
    kept: list[int]
    group: tuple[int, ...]
    traded: Array
    covariance: Array

    @classmethod
    def of(cls, rows: Array, sigma: float, like: "Split | None" = None, meat: Array | None = None) -> "Split":
        """Split parameters by the singular values of a derivative.

        A direction whose standard error is above the plausible range itself is not determined.

        Parameters
        ----------
        rows : (n, p) float64
            Derivative of the residuals, pixels a range.
        sigma : float
            Standard deviation of a residual, pixels.
        like : Split, optional
            Keep what it keeps.
        meat : (p, p) float64, optional
            Covariance of the derivative's product with the residuals; that of independent ones if omitted.
        """
        _, singular, directions = np.linalg.svd(rows, full_matrices=False)
        unknown = directions[singular <= sigma]
        # The parameters that hold most of the unknown directions stand for them.
        _, _, order = qr(unknown, mode="economic", pivoting=True) if len(unknown) else (None, None, [])
        kept = like.kept if like is not None else sorted(int(i) for i in order[: len(unknown)])
        free = [i for i in range(rows.shape[1]) if i not in kept]
        if not free:
            raise LfmeshError("the picture's micro-images scatter so much that they determine nothing")
        inverse: Array = np.linalg.inv(rows[:, free].T @ rows[:, free]).astype(np.float64)
        covariance: Array = sigma**2 * inverse if meat is None else inverse @ meat[np.ix_(free, free)] @ inverse
        if like is not None:
            return cls(free, kept, like.group, like.traded, covariance)
        traded: Array = unknown[:, free].T @ np.linalg.inv(unknown[:, kept].T) if kept else np.zeros((len(free), 0))
        shaken = np.abs(traded).sum(axis=1) > np.sqrt(np.diag(covariance))
        group = tuple(sorted((*kept, *(i for i, far in zip(free, shaken, strict=True) if far))))
        return cls(free, kept, group, traded, covariance)
