"""Metrics of a camera against the reference, each as jackknife pseudo-values of its replicates.

A metric is given the films of both cameras, replicate by replicate. Where the study is paired, replicates of the same
number have the same random numbers, and the noise that both cameras share drops out of every difference.
"""

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.lightfield.calibration.calibration import Calibration, calibrate
from lfmesh.lightfield.calibration.centres import estimate_centres
from lfmesh.lightfield.calibration.white import white_scene
from lfmesh.lightfield.photographs.refocus import refocus
from lfmesh.lightfield.rays.ray_model import RayModel
from lfmesh.lightfield.views.decode import decode
from lfmesh.lightfield.views.field import LightField
from lfmesh.scene import Scene
from lfmesh.study.cameras.compare import measuring
from lfmesh.study.metrics.depth_error import depth_errors_mm, textured, true_depth_mm
from lfmesh.study.metrics.edge_focus import LEAST_VIEWS, edge_shift_mm, why_unknown
from lfmesh.study.metrics.pictures import Camera, Films, edge_scene, image_of
from lfmesh.study.metrics.resolution import edge_mtf50
from lfmesh.study.metrics.similarity import structural_similarity
from lfmesh.study.sweeps.statistics import (
    Estimate,
    Numbers,
    chosen,
    combined,
    in_parts,
    independent_product,
    inner_products,
    mean_square,
    of_products,
    pseudo_values,
)
from lfmesh.transport.render.image import Image

Array = NDArray[np.float64]

Found = dict[tuple[str, tuple[int, ...]], Any]
"""Results by their name and the numbers of the replicates behind them."""

RESOLVED = 2.0
"""Standard errors by which a value has to differ from the border of what is possible, such as 0, to have an error."""

RESOLVED_LOGARITHM = 4.0
"""The same for a mean square whose logarithm has an error."""

IMPOSSIBLE = 4.0
"""Standard errors by which noise may bring a value beyond what is possible."""

ROUNDING = 1e-9
"""By this share a value may be beyond what is possible and still be exact."""

TRACED_DECIMALS = 9
"""Of pixels and degrees that traced rays move: what follows is rounding."""

LEAST_LENSLETS = 10
"""Along each axis, of which the middle, without micro-images that may be cut off, is enough for an MTF."""

SHARPEST = 0.6034
"""MTF50 of a box as wide as a sample, cycles a sample; samples that gather light of their whole width have no more."""


class Column(NamedTuple):
    """A column of the table.

    Attributes
    ----------
    name : str
        With its unit as a suffix.
    title : str
        In words, with the unit.
    of : str
        How it follows from the mean of its pseudo-values: "itself", "root", "psnr", or "chance": itself, and where it
        is zero chance has shown none, which does not tell how much there is.
    magnitude : bool
        Whether it is the size of something that may have a sign: its derivative is by the size of an error.
    worse : str
        "low" or "high", or "": neither.
    possible : (float, float)
        Range of what the value can be.
    """

    name: str
    title: str
    of: str = "itself"
    magnitude: bool = False
    worse: str = ""
    possible: tuple[float, float] = (-math.inf, math.inf)

    @property
    def noun(self) -> str:
        """The title without its unit."""
        return self.title.rsplit(" / ", 1)[0]

    @property
    def unit(self) -> str:
        """The unit, after a space; "" where the column has none."""
        return f" {self.title.rsplit(' / ', 1)[1]}" if " / " in self.title else ""

    @property
    def reach(self) -> tuple[float, float]:
        """Least and largest value that the column can have."""
        return (max(self.possible[0], 0.0) if self.of == "root" else self.possible[0], self.possible[1])

    @property
    def is_square(self) -> bool:
        """True if the mean of the pseudo-values is a mean square, to which independent errors add."""
        return self.of in ("root", "psnr")

    def knows(self, mean: Estimate) -> bool:
        """Tell whether the column has a value at a mean of pseudo-values; mean squares of nothing are known, too."""
        return not math.isnan(mean.value if self.is_square else self.estimate(mean).value)

    def estimate(self, mean: Estimate) -> Estimate:
        """Return the value and its standard error from the mean of the pseudo-values, by first-order propagation.

        NaN where the value is not known, such as the PSNR of pictures that do not differ. The error is NaN where it
        cannot be told: of the root or the logarithm of a mean square that is hardly told from zero, and of a value that
        is hardly told from the border of what is possible.
        """
        value, error = mean
        if self.is_square:
            return self._of_square(value, error)
        low, high = self.possible
        slack = ROUNDING * abs(value)
        if low - slack <= value <= high + slack:
            unseen = self.of == "chance" and value == 0.0
            at_border = error > 0.0 and min(value - low, high - value) < RESOLVED * error
            return Estimate(min(max(value, low), high), math.nan if unseen or at_border else error)
        # Beyond what is possible by noise, it is at the border; by more, it is wrong.
        near = low - IMPOSSIBLE * error <= value <= high + IMPOSSIBLE * error
        return Estimate(min(max(value, low), high) if near else math.nan, math.nan)

    def _of_square(self, square: float, error: float) -> Estimate:
        if self.of == "root":
            root = math.sqrt(max(square, 0.0))
            exact = square == error == 0.0
            return Estimate(root, error / (2.0 * root) if square > RESOLVED * error else 0.0 if exact else math.nan)
        if not square > 0.0:
            return Estimate(math.nan, math.nan)
        told = square > RESOLVED_LOGARITHM * error
        return Estimate(-10.0 * math.log10(square), 10.0 / math.log(10.0) * error / square if told else math.nan)

    def bound(self, mean: Estimate) -> float:
        """Return the value that is as bad as a mean square leaves possible, by `RESOLVED` standard errors."""
        worst = max(mean.value, 0.0) + RESOLVED * mean.stderr
        if self.of == "psnr":
            return -10.0 * math.log10(worst) if worst > 0.0 else math.nan
        return math.sqrt(worst)

    def mean_at(self, value: float) -> float:
        """Return the mean of the pseudo-values at which the column has a value."""
        return {"root": value * value, "psnr": 10.0 ** (-value / 10.0)}.get(self.of, value)

    def keeps(self, mean: float, limit: float) -> bool:
        """Tell whether a mean of pseudo-values, which is known, keeps a limit of the column."""
        return self.room(mean, limit) >= 0.0

    def harm(self, mean: float) -> float:
        """Return a mean of pseudo-values with the sign by which more is worse."""
        return -mean if self.worse == "low" and not self.is_square else mean

    def room(self, mean: float, limit: float) -> float:
        """Return how far a mean of pseudo-values is from a limit, below 0 beyond it.

        Mean squares are compared by their roots, which go with the size of a small error.

        Parameters
        ----------
        mean : float
            Of pseudo-values.
        limit : float
            Of the column.
        """
        most = self.mean_at(limit)
        if self.is_square:
            return math.sqrt(most) - (math.sqrt(max(mean, 0.0)) if mean == mean else math.nan)
        return mean - most if self.worse == "low" else most - mean

    def room_error(self, mean: Estimate) -> float:
        """Return the standard error of `room` at a mean of pseudo-values that is not zero."""
        return mean.stderr / (2.0 * math.sqrt(mean.value)) if self.is_square else mean.stderr


@dataclass
class Comparison:
    """A camera and the reference as metrics see them.

    Attributes
    ----------
    camera, reference : Camera
    films, reference_films : dict of (replicates, H, W, channels) float64, W
    replicates : int
        Number of them.
    maps : dict of (rows, columns, 2) float64
        Fields over the array, which metrics leave here.
    found : dict
        Results of the reference alone, by name and replicates; comparisons with the same films share them.
    """

    camera: Camera
    reference: Camera
    films: Films
    reference_films: Films
    replicates: int
    maps: dict[str, Array] = field(default_factory=dict)
    found: Found = field(default_factory=dict)

    def of_reference(self, name: str, use: Numbers, compute: Callable[[Numbers], Any]) -> Any:
        """Return what follows from some replicates of the reference alone; computed once for all cameras.

        Parameters
        ----------
        name : str
            Of the result.
        use : (n,) int64
        compute : callable
            Given the numbers of the replicates, returns the result.
        """
        key = name, tuple(use.tolist())
        if key not in self.found:
            self.found[key] = compute(use)
        return self.found[key]

    @cached_property
    def chief_rays(self) -> Calibration:
        """Centres of the camera's micro-images by traced chief rays."""
        return calibrate(self.camera.scene)

    @cached_property
    def reference_chief_rays(self) -> Calibration:
        """The same of the reference."""
        found: Calibration = self.of_reference("chief rays", self.every, lambda _: calibrate(self.reference.scene))
        return found

    @cached_property
    def products(self) -> Array:
        """Products of the films of the scene by parts, the camera's before the reference's, less their means."""
        both = [*self.films["scene"], *self.reference_films["scene"]]
        return inner_products([film - film.mean() for film in both])

    @cached_property
    def reference_products(self) -> Array:
        """Products of the reference's films of the scene by parts, W²."""
        return inner_products(list(self.reference_films["scene"]))

    @cached_property
    def reference_light(self) -> Array:
        """Shares of the parts of these films in their means, (parts, replicates), W."""
        films = self.reference_films["scene"]
        return np.stack([in_parts(film).sum(axis=1) / film.size for film in films], axis=1)

    def peak(self, use: Numbers) -> float:
        """Return the brightness of white in the reference's picture, W: its mean square over its mean.

        It is that of white where a picture is black and white, and lower in others. The brightest pixel would be that
        of the largest noise.
        """
        light = float(self.reference_light[:, use].sum(axis=0).mean())
        square = independent_product(chosen(self.reference_products, use))
        return square / light if light > 0.0 and square > 0.0 else math.nan

    @property
    def every(self) -> Numbers:
        """Numbers of all replicates."""
        return np.arange(self.replicates)


Compute = Callable[[Comparison], Array]
"""Returns pseudo-values, (replicates or 1, columns)."""


class Metric(NamedTuple):
    """A metric.

    Attributes
    ----------
    columns : tuple of Column
    pictures : tuple of str
        That it needs, see `pictures.films`.
    compute : callable
    needs_mla : bool
    unknown : callable
        Given a scene, returns in words why its camera can have none, or "".
    unseen : str
        What pictures lack, in words, where a value is not known although the camera could have one.
    """

    columns: tuple[Column, ...]
    pictures: tuple[str, ...]
    compute: Compute
    needs_mla: bool = False
    unknown: Callable[[Scene], str] = lambda _: ""
    unseen: str = "there is no light, or not enough of it"

    def why_unknown(self, scene: Scene) -> str:
        """Return in words why the metric cannot be computed of a scene's camera; nothing where it can."""
        if self.needs_mla and scene.camera.mla is None:
            return "needs a camera with a microlens array"
        return self.unknown(scene)


def _psnr(pair: Comparison) -> Array:
    differences = inner_products(list(pair.films["scene"] - pair.reference_films["scene"]))
    squares, light = pair.reference_products, pair.reference_light

    def estimate(use: Numbers) -> Array:
        return np.array([independent_product(chosen(differences, use)) / pair.peak(use) ** 2])

    square = independent_product(differences)
    mean, of_light = light.sum(axis=0).mean(), independent_product(squares)
    moved = (light[:, :, None] + light[:, None, :]) / mean - 2.0 * squares / of_light
    return of_products(estimate, differences + square * moved)


def _ncc(pair: Comparison) -> Array:
    n, products = pair.replicates, pair.products
    own, other = products[:, :n, :n], products[:, n:, n:]
    both = 0.5 * (products[:, :n, n:] + products[:, n:, :n])

    def estimate(use: Numbers) -> Array:
        one, two, mixed = (independent_product(chosen(each, use)) for each in (own, other, both))
        return np.array([mixed / math.sqrt(one * two) if one > 0.0 and two > 0.0 else math.nan])

    one, two, mixed = map(independent_product, (own, other, both))
    return of_products(estimate, both / np.float64(mixed) - 0.5 * own / np.float64(one) - 0.5 * other / np.float64(two))


def _ssim(pair: Comparison) -> Array:
    own, other = pair.films["scene"].sum(axis=3), pair.reference_films["scene"].sum(axis=3)
    channels = pair.films["scene"].shape[3]

    def estimate(use: Numbers) -> Array:
        peak = channels * pair.peak(use)
        return np.array([structural_similarity(own[use].mean(axis=0), other[use].mean(axis=0), peak)])

    # Of these pictures with their noise: fewer replicates have more, which is not taken off.
    return _from_replicates(estimate, pair)


def _light(pair: Comparison) -> Array:
    own = pair.films["scene"].mean(axis=(1, 2, 3))
    other = pair.reference_films["scene"].mean(axis=(1, 2, 3))

    def estimate(use: Numbers) -> Array:
        mean = own[use].mean()
        return np.array([mean, mean / other[use].mean()])

    return _from_replicates(estimate, pair)


def _ghosts(pair: Comparison) -> Array:
    both = pair.films["scene"].mean(axis=(1, 2, 3))
    alone = pair.films["image path"].mean(axis=(1, 2, 3))

    def estimate(use: Numbers) -> Array:
        return np.array([1.0 - alone[use].mean() / both[use].mean()])

    return _from_replicates(estimate, pair)


def _noise(pair: Comparison) -> Array:
    products = inner_products(list(pair.films["scene"]))

    def estimate(use: Numbers) -> Array:
        signal = np.float64(independent_product(chosen(products, use)))
        # Of the mean of all replicates, whatever number the estimate is from.
        return np.array([(own[:, use].sum() / len(use) - signal) / pair.replicates / signal])

    own = products.diagonal(axis1=1, axis2=2)
    signal = np.float64(independent_product(products))
    mean = own.sum(axis=0).mean()
    return of_products(estimate, 0.5 * (own[:, :, None] + own[:, None, :]) - products * mean / signal)


def _centres(pair: Comparison) -> Array:
    """Compare the centres that both white images show."""
    scene, nominal = pair.camera.scene, pair.reference.scene

    def estimate(use: Numbers) -> Array:
        own = estimate_centres(image_of(scene, pair.films["white"][use]), nominal)
        return _moved(own, _reference_centres(pair, use))

    values = _from_replicates(estimate, pair)
    pair.maps["centres"] = _displacements(values, pair.reference_chief_rays)
    return _movements(values)


def _reference_centres(pair: Comparison, use: Numbers) -> Calibration:
    nominal, white = pair.reference.scene, pair.reference_films["white"]
    found: Calibration = pair.of_reference(
        "centres", use, lambda use: estimate_centres(image_of(nominal, white[use]), nominal)
    )
    return found


def _chief_rays(pair: Comparison) -> Array:
    """Compare where the chief rays of both cameras land; nothing here is random."""
    moved = _moved(pair.chief_rays, pair.reference_chief_rays)
    values = np.round(moved, TRACED_DECIMALS)[None, :] + 0.0
    pair.maps["chief_rays"] = _displacements(values, pair.reference_chief_rays)
    found = _movements(values)
    # Displacements that cancel leave rounding of their sum.
    found[:, :2] = np.round(found[:, :2], TRACED_DECIMALS) + 0.0
    return found


def _moved(own: Calibration, other: Calibration) -> Array:
    """Return how far each centre has moved, x and y in pixels, NaN where one is not known; then pitch and rotation."""
    both = (own.known & other.known)[..., None]
    moved = np.where(both, own.centres_px - other.centres_px, np.nan)
    turn = math.degrees(own.rotation_rad - other.rotation_rad)
    return np.array([*moved.ravel(), own.pitch_px / other.pitch_px, turn])


def _displacements(values: Array, centres: Calibration) -> Array:
    """Return the mean displacement of each centre, (rows, columns, 2) pixels, from pseudo-values of `_moved`."""
    return np.asarray(values[:, :-2].mean(axis=0).reshape(centres.centres_px.shape))


def _movements(values: Array) -> Array:
    """Return the columns of `_movement` from pseudo-values of `_moved`; noise of single centres adds to no square."""
    moved = values[:, :-2].reshape(len(values), -1, 2)
    moved = moved[:, np.isfinite(moved).all(axis=(0, 2))]
    if not moved.size:
        raise LfmeshError("no micro-image is whole in all replicates of this camera and of the reference")
    return np.column_stack([moved.mean(axis=1), 2.0 * mean_square(moved), values[:, -2:]])


def _mtf50(pair: Comparison) -> Array:
    """Measure an edge, decoded as the nominal camera and with the centres that the camera's own white image shows."""
    nominal = edge_scene(pair.reference)
    films, white = pair.films["edge"], pair.films["white"]

    def estimate(use: Numbers) -> Array:
        seen = estimate_centres(image_of(pair.reference.scene, white[use]), pair.reference.scene)
        image = image_of(nominal, films[use])
        return np.array([_sharpness(image, nominal, pair, centres) for centres in (pair.reference_chief_rays, seen)])

    found = _from_replicates(estimate, pair)
    most = SHARPEST * pair.reference_chief_rays.centres_px.shape[0]
    for values in found.T:
        value, error = combined(values)
        # Beyond what is possible by noise, it is at the border; by more, it is wrong.
        if value > most:
            values[:] += most - value if value <= most + RESOLVED * error else math.nan
    return found


def _sharpness(image: Image, nominal: Scene, pair: Comparison, centres: Calibration) -> float:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        photograph = refocus(decode(image, nominal, calibration=centres), pair.reference.edge_distance_mm)
    picture = photograph.mean.mean(axis=2)
    height, width = picture.shape
    # Micro-images at the border may be cut off, and some samples unknown.
    middle = picture[height // 10 : height - height // 10, width // 8 : width - width // 8]
    return edge_mtf50(middle) * height


def _refocus(pair: Comparison) -> Array:
    """Compare the distances at which an edge is refocused, with the nominal geometry and with centres found anew."""
    nominal = pair.reference.scene

    def distances(films: Films, use: Numbers, seen: Calibration) -> Array:
        return np.array([_refocused_mm(films, use, nominal, each) for each in (pair.reference_chief_rays, seen)])

    def of_reference(use: Numbers) -> Array:
        return distances(pair.reference_films, use, _reference_centres(pair, use))

    def estimate(use: Numbers) -> Array:
        own = distances(pair.films, use, estimate_centres(image_of(nominal, pair.films["white"][use]), nominal))
        return np.array([own[0], *(own - pair.of_reference("refocus", use, of_reference))])

    distance, *shifts = _from_replicates(estimate, pair).T
    return np.column_stack([distance, *(column for shift in shifts for column in (shift, mean_square(shift)))])


def _no_refocus(scene: Scene) -> str:
    assert scene.camera.mla is not None
    columns, rows = scene.camera.mla.count
    return why_unknown(rows, columns, RayModel.of(scene))


def _no_mtf50(scene: Scene) -> str:
    assert scene.camera.mla is not None
    columns, rows = scene.camera.mla.count
    if min(columns, rows) >= LEAST_LENSLETS:
        return ""
    return f"needs {LEAST_LENSLETS} × {LEAST_LENSLETS} lenslets at least, and the camera has {columns} × {rows}"


def _refocused_mm(films: Films, use: Numbers, nominal: Scene, centres: Calibration) -> float:
    """Return at which distance the photograph of the edge is sharpest; NaN where that is no real one."""
    edge, white = measuring(nominal), measuring(white_scene(nominal))
    light = decode(image_of(white, films["white"][use].sum(axis=3, keepdims=True)), white, calibration=centres)
    field = decode(image_of(edge, films["edge"][use]), edge, calibration=centres)
    distance = field.model.distance_mm(edge_shift_mm(field, light))
    return distance if 0.0 < distance < math.inf else math.nan


def _depth(pair: Comparison) -> Array:
    """Compare the depth that the picture shows with the truth, decoded to plan and with centres found anew."""
    nominal = pair.reference.scene
    where = pair.of_reference(
        "textured",
        pair.every,
        lambda use: textured(_divided(pair.reference_films, use, nominal, pair.reference_chief_rays)),
    )
    truth = true_depth_mm(pair.camera.scene)

    def estimate(use: Numbers) -> Array:
        seen = estimate_centres(image_of(nominal, pair.films["white"][use]), nominal)
        fields = (_divided(pair.films, use, nominal, centres) for centres in (pair.reference_chief_rays, seen))
        errors = [depth_errors_mm(field, truth, where) for field in fields]
        return np.array([value for error in errors for value in (np.median(error), np.median(np.abs(error)))])

    return _from_replicates(estimate, pair)


def _divided(films: Films, use: Numbers, nominal: Scene, centres: Calibration) -> LightField:
    """Return the light field of the scene, divided by the white one."""
    white = image_of(white_scene(nominal), films["white"][use])
    return decode(image_of(nominal, films["scene"][use]), nominal, white=white, calibration=centres)


def _crosstalk(pair: Comparison) -> Array:
    own, others = (pair.films["lenslets"][..., i].sum(axis=(1, 2)) for i in (0, 1))

    def estimate(use: Numbers) -> Array:
        return np.array([others[use].sum() / (own[use] + others[use]).sum()])

    return _from_replicates(estimate, pair)


def _from_replicates(estimate: Callable[[Numbers], Array], pair: Comparison) -> Array:
    return pseudo_values(estimate, pair.replicates)


def _movement(prefix: str, words: str) -> tuple[Column, ...]:
    return (
        Column(f"{prefix}_x_px", f"{words}: mean shift in x / pixels"),
        Column(f"{prefix}_y_px", f"{words}: mean shift in y / pixels"),
        Column(f"{prefix}_rms_px", f"{words}: displacement, rms / pixels", "root", magnitude=True, worse="high"),
        Column(f"{prefix}_pitch_ratio", f"{words}: pitch over the reference's"),
        Column(f"{prefix}_turn_deg", f"{words}: rotation / deg"),
    )


def _depths(prefix: str, words: str) -> tuple[Column, ...]:
    return (
        Column(f"{prefix}_bias_mm", f"depth less the true one, {words}: median / mm"),
        Column(
            f"{prefix}_error_mm",
            f"depth error, {words}: median of its size / mm",
            magnitude=True,
            worse="high",
            possible=POSITIVE,
        ),
    )


CROSSED = "share of light in micro-images through other lenslets"
POSITIVE, SHARE = (0.0, math.inf), (0.0, 1.0)

METRICS: Mapping[str, Metric] = {
    "psnr": Metric((Column("psnr_db", "PSNR / dB", "psnr", worse="low"),), ("scene",), _psnr),
    "ncc": Metric(
        (Column("ncc", "normalised cross-correlation", "itself", True, "low", (-1.0, 1.0)),),
        ("scene",),
        _ncc,
    ),
    "ssim": Metric((Column("ssim", "structural similarity", "itself", True, "low", (-1.0, 1.0)),), ("scene",), _ssim),
    "light": Metric(
        (
            Column("light_w_per_pixel", "light / W per pixel", worse="low", possible=POSITIVE),
            Column("light_ratio", "light over the reference's", worse="low", possible=POSITIVE),
        ),
        ("scene",),
        _light,
    ),
    "ghosts": Metric(
        (Column("ghost_share", "share of light that was reflected on its way", worse="high", possible=SHARE),),
        ("scene", "image path"),
        _ghosts,
    ),
    "centres": Metric(_movement("centres", "micro-images"), ("white",), _centres, needs_mla=True),
    "chief_rays": Metric(_movement("chief_rays", "chief rays"), (), _chief_rays, needs_mla=True),
    "mtf50": Metric(
        (
            Column(
                "mtf50_lp_per_height",
                "MTF50, decoded as built to plan / lp per height",
                worse="low",
                possible=POSITIVE,
            ),
            Column(
                "mtf50_calibrated_lp_per_height",
                "MTF50, calibrated by its white image / lp per height",
                worse="low",
                possible=POSITIVE,
            ),
        ),
        ("edge", "white"),
        _mtf50,
        needs_mla=True,
        unknown=_no_mtf50,
        unseen=(
            "the middle of the photograph shows no straight edge, or one that is lost in noise or sharper than its "
            "samples can tell"
        ),
    ),
    "refocus": Metric(
        (
            Column("refocus_mm", "refocus distance, decoded as built to plan / mm"),
            Column("refocus_shift_mm", "refocus shift, decoded as built to plan / mm"),
            Column("refocus_error_mm", "size of the refocus shift / mm", "root", magnitude=True, worse="high"),
            Column("refocus_calibrated_shift_mm", "refocus shift, calibrated by its white image / mm"),
            Column(
                "refocus_calibrated_error_mm",
                "size of the refocus shift, calibrated / mm",
                "root",
                magnitude=True,
                worse="high",
            ),
        ),
        ("edge", "white"),
        _refocus,
        needs_mla=True,
        unknown=_no_refocus,
        unseen=(
            "the edge leaves the middle of the picture, is lost in noise, or is seen by fewer than "
            f"{LEAST_VIEWS} columns of views that the pupil does not cut; or it is sharpest at no finite distance"
        ),
    ),
    "depth": Metric(
        (
            *_depths("depth", "decoded as built to plan"),
            *_depths("depth_calibrated", "calibrated by its white image"),
        ),
        ("scene", "white"),
        _depth,
        needs_mla=True,
        unseen=(
            "no part of the reference's picture has texture enough to tell depth, or half of it or more has no known "
            "depth here"
        ),
    ),
    "crosstalk": Metric(
        (Column("crosstalk_share", CROSSED, "chance", worse="high", possible=SHARE),),
        ("lenslets",),
        _crosstalk,
        needs_mla=True,
    ),
    "noise": Metric((Column("noise", "noise, rms over rms of the image", "root", worse="high"),), ("scene",), _noise),
    "efficiency": Metric((), ("scene",), lambda pair: np.empty((pair.replicates, 0))),
}
"""All metrics by name; "efficiency" has no column here: times are not the same from run to run, see `outcome`."""


def pictures_of(metrics: tuple[str, ...]) -> tuple[str, ...]:
    """Return the pictures that some metrics need."""
    return tuple(dict.fromkeys(name for metric in metrics for name in METRICS[metric].pictures))


def columns_of(metrics: tuple[str, ...]) -> tuple[Column, ...]:
    """Return the columns of some metrics."""
    return tuple(column for metric in metrics for column in METRICS[metric].columns)


def metric_of(column: str) -> str:
    """Return the name of the metric that has a column."""
    return next(name for name, metric in METRICS.items() if any(each.name == column for each in metric.columns))
