"""Fit of a camera to its white image and to boards: focus, poses and assembly errors.

Least squares on traced rays: the ray of each observed corner should meet that corner on the board. The white image's
fit is the prior, with its errors and undetermined parameters.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from lfmesh.errors import LfmeshError
from lfmesh.geometry.index_media import refuse_bending
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.geometry.motions import refuse_motion
from lfmesh.lightfield.calibration.calibration import calibrate
from lfmesh.lightfield.detector import Exposed
from lfmesh.lightfield.rays.ray_model import RayModel
from lfmesh.notebook import Say, announced, silent
from lfmesh.scene import Scene
from lfmesh.scene.literals import counted, plain
from lfmesh.study.fits.board_corners import BoardCorners
from lfmesh.study.fits.board_pictures import Board, corners_of
from lfmesh.study.fits.board_pose import BoardPose, first_pose, pose_of, world_pose
from lfmesh.study.fits.fit import SAMPLES, Estimate, Fit, fit
from lfmesh.study.fits.fit_model import STEP, FitModel, parameters_of
from lfmesh.study.fits.ray_map import RayMap, view_spread
from lfmesh.study.fits.white_picture import Orientation, light_of
from lfmesh.transport.render.image import Image

Array = NDArray[np.float64]

FOCUS = "camera.mla.distance_mm"
"""Field for the focus: array and sensor move with it."""

FOCUS_REACH = 0.05
"""Largest plausible relative error of that distance."""

ROUNDS = 8
"""Largest number of rounds; each traces the rays of the camera fitted in the round before."""

SETTLED = 0.05
"""Change between rounds, in standard errors, below which a fit has converged."""

OUTLIER = 6.0
"""Distance from the median, in normal standard deviations, beyond which an observation is rejected."""

RESELECTED = 10
"""Largest number of times per round that outliers are selected anew, as the fit moves."""

FIRST_SIGMA = 0.05
"""Assumed standard deviation of an observation in the first fit, in samples."""

MODEL_ERROR = 0.002
"""Assumed model error of corner places that varies smoothly over field and views, in samples at the border.

At the true camera and pose, rendered boards leave slopes of 0.0005 to 0.004 over the field and the views.
"""

WORST = 0.5
"""Rms residual, in samples, above which a fit is refused."""


@dataclass(frozen=True, eq=False)
class BoardFit:
    """A camera fitted to its white image and to boards.

    Attributes
    ----------
    scene : Scene
        Scene with the fitted values.
    white : Fit
        Fit to the white image alone.
    estimates : tuple of Estimate
        Camera parameters, from all pictures. Kept: more than half of the plausible range remains.
    covariance : (p + 6 b, p + 6 b) float64
        Covariance of the values in their units, then of each board's position (mm) and rotation (degrees).
    poses : tuple of BoardPose
        Poses of the boards, world frame.
    corners : tuple of BoardCorners
        Observed corners of each board.
    residuals : tuple of (n, 2) float64
        Observed minus fitted places, in samples along s and t; NaN: rejected.
    """

    scene: Scene
    white: Fit
    estimates: tuple[Estimate, ...]
    covariance: Array
    poses: tuple[BoardPose, ...]
    corners: tuple[BoardCorners, ...]
    residuals: tuple[Array, ...]

    def __repr__(self) -> str:
        boards, places = counted(len(self.poses), "board"), counted(self.used, "place")
        return f"<BoardFit: {boards}, {places}, {self.rms:.3g} samples rms>"

    def __getitem__(self, path: str) -> Estimate:
        for each in self.estimates:
            if path in (each.parameter.path, each.parameter.name):
                return each
        raise KeyError(f"{path!r} was not fitted; there are {', '.join(e.parameter.path for e in self.estimates)}")

    @property
    def used(self) -> int:
        """Number of observed places used."""
        return int(sum(np.isfinite(each[:, 0]).sum() for each in self.residuals))

    @property
    def left_out(self) -> int:
        """Number of places rejected as outliers."""
        return sum(len(each) for each in self.residuals) - self.used

    @property
    def rms(self) -> float:
        """Root mean square of the residuals' coordinates, in samples of a view."""
        return float(np.sqrt(np.nanmean(np.concatenate(self.residuals) ** 2)))

    @property
    def corner_rms(self) -> float:
        """Root mean square of the corners' residuals averaged over views, in samples."""
        means = [
            np.nanmean(residuals[seen.corner == corner], axis=0)
            for residuals, seen in zip(self.residuals, self.corners, strict=True)
            for corner in np.unique(seen.corner[np.isfinite(residuals[:, 0])])
        ]
        return float(np.sqrt(np.mean(np.square(means))))

    @property
    def notes(self) -> tuple[str, ...]:
        """Reservations about the values, one sentence each."""
        places = f"{counted(self.left_out, 'place')} of corners"
        more = (f"outliers far from the fit: {places} left out",) if self.left_out else ()
        return (*self.white.notes, *more)

    def traded(self, board: int) -> tuple[float, float]:
        """Return the change of a board's distance with the focus, and its error at a known focus.

        Parameters
        ----------
        board : int
            Number of the board, from 0.

        Returns
        -------
        moved : float
            mm per mm.
        error : float
            Standard error of the distance at a known focus, mm.
        """
        focus = [each.parameter.path for each in self.estimates].index(FOCUS)
        z = len(self.estimates) + 6 * board + 2
        slope = self.covariance[z, focus] / self.covariance[focus, focus]
        left = self.covariance[z, z] - slope * self.covariance[z, focus]
        return float(slope), float(np.sqrt(max(left, 0.0)))


def fit_boards(
    white: Image | Exposed | NDArray[Any], scene: Scene, boards: Sequence[Board], *,
    also: Mapping[str, float] | None = None, orientation: Orientation = "upright", samples: int = SAMPLES,
    progress: Say | bool | None = None,
) -> BoardFit:  # fmt: skip
    """Estimate the assembly errors and focus of a camera, and the poses of boards in front of it.

    Parameters
    ----------
    white : Image, Exposed or (H, W) or (H, W, channels) array
        White image, as for `lf.fit`.
    scene : Scene
        Camera as designed.
    boards : sequence of Board
        Pictures or corner lists, all from the same camera.
    also, orientation, samples, progress
        As for `lf.fit`; the orientation is also the boards'.

    Returns
    -------
    BoardFit

    Raises
    ------
    LfmeshError
        As for `lf.fit`; or the scene has media that bend light, or motion; or a board is not found, has another number
        of corners than stated, or does not fit the camera.
    """
    if not boards:
        raise LfmeshError("boards is empty: give one picture of a board or more, or use lf.fit")
    refuse_bending(scene, "boards are fitted through air alone; omit it")
    refuse_motion(scene, "boards are fitted by cameras and boards at rest; omit it")
    start = solved_camera(scene.pinned()).scene
    parameters_of(start, also)
    distance = start.camera.mla.distance_mm if start.camera.mla is not None else None
    further = {FOCUS: FOCUS_REACH * float(distance or 0.0), **(also or {})}
    with announced(progress) as say:
        by_white = fit(white, start, also=further, orientation=orientation, samples=samples, progress=say)
        return with_boards(by_white, start, light_of(white, start, orientation), boards, orientation, say)


def with_boards(
    by_white: Fit, start: Scene, light: Array, boards: Sequence[Board], orientation: Orientation = "upright",
    progress: Say = silent,
) -> BoardFit:  # fmt: skip
    """Fit boards after the white image has been fitted.

    Parameters
    ----------
    by_white : Fit
        Fit of the white image, including the focus.
    start : Scene
        Start of that fit, solved.
    light : (H, W) float64
        White image, as it lies on the sensor.
    boards : sequence of Board
    orientation : {"upright", "upside_down", "sensor"}
        Orientation of the boards' pictures.
    progress : callable, optional

    Raises
    ------
    LfmeshError
        As for `fit_boards`.
    """
    progress("finding corners")
    seen = corners_of(boards, by_white.scene, light, orientation)
    model = FitModel(start, tuple(each.parameter for each in by_white.estimates), SAMPLES)
    return _Adjustment(by_white, model, seen, progress).run()


class _Adjustment:
    """Rounds of a board fit; each traces the camera fitted in the round before."""

    def __init__(self, by_white: Fit, model: FitModel, seen: Sequence[BoardCorners], say: Say) -> None:
        self.by_white, self.model, self.seen, self.say = by_white, model, seen, say
        self.decoded = calibrate(by_white.scene)
        self.reach = max(float(np.abs(each.view).max()) for each in seen) + 0.5
        self.expected = np.array(
            [(each.value - each.parameter.start) / each.parameter.reach for each in by_white.estimates]
        )
        self.precision = precision_of(by_white)
        self.board = np.concatenate([np.full(len(each.corner), i) for i, each in enumerate(seen)])
        self.corner = np.concatenate([each.corner for each in seen])
        self.corner = np.unique(np.column_stack([self.board, self.corner]), axis=0, return_inverse=True)[1].ravel()
        self.board_mm = np.concatenate([each.board_mm for each in seen])
        self.place = np.concatenate([np.column_stack([each.sample, each.view]) for each in seen])
        self.spread = view_spread(self.decoded, by_white.scene, self.place)
        self.used = np.ones(len(self.place), bool)
        self.sigma = FIRST_SIGMA

    def run(self) -> BoardFit:
        """Fit until the camera has converged.

        Raises
        ------
        LfmeshError
            The fit does not converge, or does not fit the boards.
        """
        steps = self.expected
        rays = self._map(steps)
        near = RayModel.of(self.model.scene).refocus_range_mm[0]
        poses = np.concatenate(
            [first_pose(self._rays_at(rays, self.board == i), each.board_mm, near) for i, each in enumerate(self.seen)]
        )
        for number in range(1, ROUNDS + 1):
            self.say(f"tracing rays, round {number}")
            if number <= DERIVATIVES:
                slopes = self._derivative(steps)
            base = steps
            solution = self._solve(rays, slopes, base, np.concatenate([steps, poses]))
            if number == 1:
                solution = self._best_turned(rays, slopes, base, solution)
            values = solution.values
            covariance = self._covariance(solution, np.zeros((0, len(values))))
            moved = np.abs(values[: len(steps)] - base) / np.sqrt(np.diag(covariance))[: len(steps)]
            steps, poses = values[: len(steps)], values[len(steps) :]
            if moved.max() < SETTLED and number > 1:
                covariance = self._covariance(solution, self._model_pulls(base, solution))
                return self._result(rays, slopes, base, values, covariance)
            rays = self._map(steps)
        raise LfmeshError(
            f"the fit to the boards did not converge in {ROUNDS} rounds; check the scene against the camera"
        )

    def _map(self, steps: Array) -> RayMap:
        return RayMap.of(self.model.at(steps), self.decoded, self.reach)

    def _rays_at(self, rays: RayMap, which: NDArray[np.bool_]) -> Array:
        return np.asarray(rays.terms(self.place[which], self.spread[which]) @ rays.coefficients)

    def _derivative(self, steps: Array) -> Array:
        """Return the derivative of the ray map's coefficients by the camera's parameters, (terms, 4, p)."""
        return np.stack(
            [
                (self._map(steps + unit).coefficients - self._map(steps - unit).coefficients) / (2.0 * STEP)
                for unit in STEP * np.eye(len(steps))
            ],
            axis=-1,
        )

    def _solve(self, rays: RayMap, slopes: Array, base: Array, start: Array) -> "_Solution":
        """Fit camera and poses with the rays of a camera and their derivative."""
        root = np.linalg.cholesky(self.precision).T
        for number in range(RESELECTED + 1):
            terms, per_sample = self._in_samples(rays, start)

            def residuals(values: Array, terms: Array = terms, per_sample: Array = per_sample) -> Array:
                steps = values[: len(base)]
                own = self._beside(terms, rays.coefficients + slopes @ (steps - base), values, per_sample)
                return np.concatenate([own[self.used].ravel() / self.sigma, root @ (steps - self.expected)])

            solved = least_squares(residuals, start, x_scale="jac", method="trf")
            start = solved.x
            own = self._beside(terms, rays.coefficients + slopes @ (start[: len(base)] - base), start, per_sample)
            rms = float(np.sqrt(np.mean(own[self.used] ** 2)))
            if not rms < WORST:
                raise LfmeshError(
                    f"no camera like the scene's fits the boards: their corners lie {plain(rms, 2)} samples rms from "
                    "the best fit; check the squares' size, the scene, and --orientation"
                )
            self.sigma = rms
            size = np.linalg.norm(own, axis=1)
            used = size < OUTLIER * np.median(size) / np.sqrt(2.0 * np.log(2.0))
            if number and (number == RESELECTED or (used == self.used).all()):
                break
            self.used = used
        rows = len(solved.fun) - len(base)
        jacobian = solved.jac[:rows].reshape(-1, 2, len(start))
        left = solved.fun[:rows].reshape(-1, 2)
        hessian = np.asarray(solved.jac.T @ solved.jac)
        scores = self._scores(jacobian, left, np.linalg.inv(hessian))
        return _Solution(start, jacobian, hessian, scores, float(np.median(size)))

    def _best_turned(self, rays: RayMap, slopes: Array, base: Array, solution: "_Solution") -> "_Solution":
        """Return the best of a solution and its variants with one board's tilts reversed.

        From afar, opposite tilts look alike: both are minima of the sum of squares.
        """
        for board in range(len(self.seen)):
            used, sigma = self.used, self.sigma
            self.used, self.sigma = np.ones(len(self.place), bool), FIRST_SIGMA
            start = solution.values.copy()
            tilts = len(base) + 6 * board + 3
            start[tilts : tilts + 2] *= -1.0
            try:
                other = self._solve(rays, slopes, base, start)
            except LfmeshError:
                other = solution
            if other.typical < solution.typical:
                solution = other
            else:
                self.used, self.sigma = used, sigma
        return solution

    def _in_samples(self, rays: RayMap, values: Array) -> tuple[Array, Array]:
        """Return the ray map's terms, and the matrices from board distance to samples at each place, (n, 2, 2)."""
        terms = rays.terms(self.place, self.spread)
        columns = []
        for unit in 0.5 * np.eye(4)[:2]:
            ends = [
                self._beside(rays.terms(self.place + sign * unit, self.spread), rays.coefficients, values, None)
                for sign in (1.0, -1.0)
            ]
            columns.append(ends[0] - ends[1])
        return terms, np.linalg.inv(np.stack(columns, axis=-1))

    def _beside(self, terms: Array, coefficients: Array, values: Array, per_sample: Array | None) -> Array:
        """Return the distances of the rays from the corners on the boards, (n, 2): mm, or samples."""
        rays = terms @ coefficients
        beside = np.empty((len(rays), 2))
        for board, pose in enumerate(values[len(self.expected) :].reshape(-1, 6)):
            which = self.board == board
            beside[which] = pose_of(pose).meet(rays[which]) - self.board_mm[which]
        return beside if per_sample is None else np.einsum("nij,nj->ni", per_sample, beside)

    def _scores(self, jacobian: Array, left: Array, inverse: Array) -> Array:
        """Return the corners' scores, each as if the corner had been left out (CR3).

        R. M. Bell, D. F. McCaffrey, "Bias reduction in standard errors for linear regression with multi-stage
        samples", Survey Methodology 28 (2002) 169.
        """
        corner = self.corner[self.used]
        scores = []
        for each in np.unique(corner):
            own = jacobian[corner == each].reshape(-1, jacobian.shape[-1])
            hat = own @ inverse @ own.T
            free = np.linalg.solve(np.eye(len(own)) - hat, left[corner == each].ravel())
            scores.append(own.T @ free)
        return np.array(scores)

    def _model_pulls(self, steps: Array, solution: "_Solution") -> Array:
        """Return the pulls of model errors on the values, (k, p + 6 b), each for one standard deviation.

        A corner's place lies between the apex ray's and the bundle's mean ray's: the first error is their difference.
        The others are `MODEL_ERROR`, smooth over field and views.
        """
        camera = self.model.at(steps)
        rays = [RayMap.of(camera, self.decoded, self.reach, of_bundles=whole) for whole in (False, True)]
        terms, per_sample = self._in_samples(rays[0], solution.values)
        apex, mean = (self._beside(terms, each.coefficients, solution.values, per_sample)[self.used] for each in rays)
        half = 0.5 * (rays[0].size - 1.0)
        ones = np.ones(self.used.sum())
        field = [ones, *((self.place[self.used, :2] - half) / half).T]
        views = [ones, *(self.place[self.used, 2:] / self.reach).T]
        patterns = [mean - apex]
        for even in (one * other for one in field for other in views):
            patterns += [MODEL_ERROR * np.outer(even, axis) for axis in np.eye(2)]
        return np.stack([np.einsum("nip,ni->p", solution.jacobian, each) / self.sigma for each in patterns])

    def _covariance(self, solution: "_Solution", pulls: Array) -> Array:
        """Return the covariance of steps and poses, clustered by corner: its views share disturbances."""
        inverse = np.linalg.inv(solution.hessian)
        meat = solution.scores.T @ solution.scores
        count = len(self.expected)
        meat[:count, :count] += self.precision
        meat += pulls.T @ pulls
        return np.asarray(inverse @ meat @ inverse)

    def _result(self, rays: RayMap, slopes: Array, base: Array, values: Array, covariance: Array) -> BoardFit:
        count = len(self.expected)
        terms, per_sample = self._in_samples(rays, values)
        own = self._beside(terms, rays.coefficients + slopes @ (values[:count] - base), values, per_sample)
        own[~self.used] = np.nan
        scene = self.model.at(values[:count])
        to_units = np.zeros((len(values), len(values)))
        to_units[:count, :count] = np.diag(self.model.reach)
        poses = []
        for board in range(len(self.seen)):
            at = np.s_[count + 6 * board : count + 6 * board + 6]
            place, turn = world_pose(values[at], scene)
            to_units[at, at] = turn
            errors = np.sqrt(np.diag(turn @ covariance[at, at] @ turn.T))
            poses.append(BoardPose(tuple(place[:3].tolist()), tuple(place[3:].tolist()), tuple(errors.tolist())))
        covariance = to_units @ covariance @ to_units.T
        errors = np.sqrt(np.diag(covariance))
        return BoardFit(
            scene, self.by_white, tuple(
                _estimate(self.by_white, i, float(step), float(error))
                for i, (step, error) in enumerate(zip(values[:count], errors[:count], strict=True))
            ), covariance, tuple(poses), tuple(self.seen), tuple(own[self.board == i] for i in range(len(self.seen))),
        )  # fmt: skip


class _Solution(NamedTuple):
    """Solution of a round.

    Attributes
    ----------
    values : (p + 6 b,) float64
        Steps of the camera's parameters, and poses.
    jacobian : (n, 2, p + 6 b) float64
        Jacobian of the residuals over their standard deviation.
    hessian : (p + 6 b, p + 6 b) float64
        Hessian of half the sum of squares.
    scores : (corners, p + 6 b) float64
        Pull of each corner's residuals on the values if it had not been fitted.
    typical : float
        Median distance of all places from the fit, in samples.
    """

    values: Array
    jacobian: Array
    hessian: Array
    scores: Array
    typical: float


DERIVATIVES = 1
"""Rounds that trace the derivative: it hardly changes with the camera."""

KEPT = 0.5
"""Largest error, over the standard deviation of the plausible range, of a parameter that counts as determined."""


def _estimate(by_white: Fit, number: int, step: float, error: float) -> Estimate:
    parameter = by_white.estimates[number].parameter
    known = error < KEPT * parameter.reach / np.sqrt(3.0)
    return Estimate(parameter, parameter.start + step * parameter.reach, error if known else float("nan"), ())


def precision_of(found: Fit) -> Array:
    """Return the inverse covariance, (p, p), of a white image's fit, in units of the plausible ranges.

    Kept parameters are uniform over their ranges; fitted ones follow them by the combinations.
    """
    paths = [each.parameter.path for each in found.estimates]
    reach = np.array([each.parameter.reach for each in found.estimates])
    kept = np.array([each.kept for each in found.estimates])
    covariance = np.where(np.isfinite(found.covariance), found.covariance, 0.0) / np.outer(reach, reach)
    follows = np.zeros((len(paths), int(kept.sum())))
    follows[np.flatnonzero(kept), np.arange(kept.sum())] = 1.0
    columns = {paths[i]: column for column, i in enumerate(np.flatnonzero(kept))}
    for both in found.combinations:
        own = paths.index(next(path for path in both.coefficients if path not in columns))
        for path, coefficient in both.coefficients.items():
            if path in columns:
                follows[own, columns[path]] = -coefficient * reach[paths.index(path)] / reach[own]
    # The variance of a uniform distribution of half-width 1 is 1/3.
    return np.asarray(np.linalg.inv(covariance + follows @ follows.T / 3.0))
