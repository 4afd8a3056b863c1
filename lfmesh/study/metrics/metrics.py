"""Metrics of a camera against the reference, each as jackknife pseudo-values of its replicates.

A metric is given the films of both cameras, replicate by replicate. Where the study is paired, replicates of the same
number have the same random numbers, and the noise that both cameras share drops out of every difference.
"""

import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.lightfield.calibration.calibration import Calibration, calibrate
from lfmesh.lightfield.calibration.centres import estimate_centres
from lfmesh.lightfield.calibration.white import white_scene
from lfmesh.lightfield.photographs.refocus import refocus
from lfmesh.lightfield.views.decode import decode
from lfmesh.lightfield.views.field import LightField
from lfmesh.scene import Scene
from lfmesh.study.cameras.compare import measuring
from lfmesh.study.metrics.depth_error import depth_errors_mm, textured, true_depth_mm
from lfmesh.study.metrics.edge_focus import edge_shift_mm
from lfmesh.study.metrics.pictures import Camera, Films, edge_scene, image_of
from lfmesh.study.metrics.resolution import edge_mtf50
from lfmesh.study.metrics.similarity import structural_similarity
from lfmesh.study.sweeps.statistics import (
    Estimate,
    Numbers,
    combined,
    independent_product,
    inner_products,
    pseudo_values,
)
from lfmesh.transport.render.image import Image

Array = NDArray[np.float64]


class Column(NamedTuple):
    """A column of the table.

    Attributes
    ----------
    name : str
        With its unit as a suffix.
    title : str
        In words, with the unit.
    of : str
        How it follows from the mean of its pseudo-values: "itself", "root", "psnr".
    magnitude : bool
        Whether it is the size of something that may have a sign: its derivative is by the size of an error.
    worse : str
        "low" or "high", or "": neither.
    """

    name: str
    title: str
    of: str = "itself"
    magnitude: bool = False
    worse: str = ""

    def estimate(self, pseudo: Array) -> Estimate:
        """Return the value and its standard error, by first-order propagation."""
        mean, error = combined(pseudo)
        if self.of == "root":
            root = math.sqrt(max(mean, 0.0))
            # Of what is not told apart from zero, no more is known than its square's error.
            return Estimate(root, error / (2.0 * root) if root * root > error else math.sqrt(error))
        if self.of == "psnr":
            if not mean > 0.0:
                return Estimate(math.inf, 0.0 if error == 0.0 else math.nan)
            return Estimate(-10.0 * math.log10(mean), 10.0 / math.log(10.0) * error / mean)
        return Estimate(mean, error)


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
    """

    camera: Camera
    reference: Camera
    films: Films
    reference_films: Films
    replicates: int
    maps: dict[str, Array] = field(default_factory=dict)

    @cached_property
    def chief_rays(self) -> Calibration:
        """Centres of the camera's micro-images by traced chief rays."""
        return calibrate(self.camera.scene)

    @cached_property
    def reference_chief_rays(self) -> Calibration:
        """The same of the reference."""
        return calibrate(self.reference.scene)

    @cached_property
    def products(self) -> Array:
        """Mean products of the films of the scene, the camera's before the reference's, less their means."""
        both = [*self.films["scene"], *self.reference_films["scene"]]
        return inner_products([film - film.mean() for film in both])

    @cached_property
    def brightest(self) -> float:
        """Brightest pixel of the reference's image, W."""
        return float(self.reference_films["scene"].mean(axis=0).max())


Compute = Callable[[Comparison], Array]
"""Returns pseudo-values, (replicates or 1, columns)."""


class Metric(NamedTuple):
    """A metric: its columns, the pictures that it needs, and how it is computed."""

    columns: tuple[Column, ...]
    pictures: tuple[str, ...]
    compute: Compute
    needs_mla: bool = False


def _psnr(pair: Comparison) -> Array:
    differences = inner_products(list(pair.films["scene"] - pair.reference_films["scene"]))
    peak = pair.brightest**2 or math.nan

    def estimate(use: Numbers) -> Array:
        return np.array([independent_product(differences[np.ix_(use, use)]) / peak])

    return _from_replicates(estimate, pair)


def _ncc(pair: Comparison) -> Array:
    n, products = pair.replicates, pair.products

    def estimate(use: Numbers) -> Array:
        own = independent_product(products[np.ix_(use, use)])
        other = independent_product(products[np.ix_(use + n, use + n)])
        both = independent_product(products[np.ix_(use, use + n)])
        return np.array([both / math.sqrt(own * other) if own > 0.0 and other > 0.0 else math.nan])

    return _from_replicates(estimate, pair)


def _ssim(pair: Comparison) -> Array:
    own, other = pair.films["scene"].sum(axis=3), pair.reference_films["scene"].sum(axis=3)
    brightest = float(other.mean(axis=0).max())

    def estimate(use: Numbers) -> Array:
        return np.array([structural_similarity(own[use].mean(axis=0), other[use].mean(axis=0), brightest)])

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
        own = products[np.ix_(use, use)]
        signal = independent_product(own)
        # Of the mean of all replicates, whatever number the estimate is from.
        return np.array([(float(np.trace(own)) / len(use) - signal) / pair.replicates / signal])

    return _from_replicates(estimate, pair)


def _centres(pair: Comparison) -> Array:
    """Compare the centres that both white images show."""
    scene, nominal = pair.camera.scene, pair.reference.scene

    def estimate(use: Numbers) -> Array:
        own = estimate_centres(image_of(scene, pair.films["white"][use]), nominal)
        other = estimate_centres(image_of(nominal, pair.reference_films["white"][use]), nominal)
        if len(use) == pair.replicates:
            pair.maps["centres"] = _displacement(own, other)
        return _moved(own, other)

    return _from_replicates(estimate, pair)


def _chief_rays(pair: Comparison) -> Array:
    """Compare where the chief rays of both cameras land; nothing here is random."""
    own, other = pair.chief_rays, pair.reference_chief_rays
    pair.maps["chief_rays"] = _displacement(own, other)
    return _moved(own, other)[None, :]


def _displacement(own: Calibration, other: Calibration) -> Array:
    """Return how far each centre has moved, (rows, columns, 2) pixels; NaN where one of them is not known."""
    both = own.known & other.known
    return np.where(both[..., None], own.centres_px - other.centres_px, np.nan)


def _moved(own: Calibration, other: Calibration) -> Array:
    moved = _displacement(own, other)
    known = moved[np.isfinite(moved[..., 0])]
    turn = math.degrees(own.rotation_rad - other.rotation_rad)
    return np.array([*known.mean(axis=0), (known**2).sum(axis=1).mean(), own.pitch_px / other.pitch_px, turn])


def _mtf50(pair: Comparison) -> Array:
    """Measure an edge, decoded as the nominal camera and with the centres that the camera's own white image shows."""
    nominal = edge_scene(pair.reference)
    films, white = pair.films["edge"], pair.films["white"]

    def estimate(use: Numbers) -> Array:
        seen = estimate_centres(image_of(pair.reference.scene, white[use]), pair.reference.scene)
        image = image_of(nominal, films[use])
        return np.array([_sharpness(image, nominal, pair, centres) for centres in (pair.reference_chief_rays, seen)])

    return _from_replicates(estimate, pair)


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
    cameras = (pair.films, pair.reference_films)

    def estimate(use: Numbers) -> Array:
        traced, found = [], []
        for films in cameras:
            seen = estimate_centres(image_of(nominal, films["white"][use]), nominal)
            traced.append(_refocused_mm(films, use, nominal, pair.reference_chief_rays))
            found.append(_refocused_mm(films, use, nominal, seen))
        shift, mended = traced[0] - traced[1], found[0] - found[1]
        return np.array([traced[0], shift, shift**2, mended, mended**2])

    return _from_replicates(estimate, pair)


def _refocused_mm(films: Films, use: Numbers, nominal: Scene, centres: Calibration) -> float:
    """Return at which distance the photograph of the edge is sharpest; NaN where that is no real one."""
    edge, white = measuring(nominal), measuring(white_scene(nominal))
    light = image_of(white, films["white"][use].sum(axis=3, keepdims=True))
    field = decode(image_of(edge, films["edge"][use]), edge, white=light, calibration=centres)
    distance = field.model.distance_mm(edge_shift_mm(field))
    return distance if 0.0 < distance < math.inf else math.nan


def _depth(pair: Comparison) -> Array:
    """Compare the depth that the picture shows with the truth, decoded to plan and with centres found anew."""
    nominal = pair.reference.scene
    every = np.arange(pair.replicates)
    where = textured(_divided(pair.reference_films, every, nominal, pair.reference_chief_rays))
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
        Column(f"{prefix}_error_mm", f"depth error, {words}: median of its size / mm", magnitude=True, worse="high"),
    )


METRICS: Mapping[str, Metric] = {
    "psnr": Metric((Column("psnr_db", "PSNR / dB", "psnr", worse="low"),), ("scene",), _psnr),
    "ncc": Metric((Column("ncc", "normalised cross-correlation", magnitude=True, worse="low"),), ("scene",), _ncc),
    "ssim": Metric((Column("ssim", "structural similarity", magnitude=True, worse="low"),), ("scene",), _ssim),
    "light": Metric(
        (
            Column("light_w_per_pixel", "light / W per pixel", worse="low"),
            Column("light_ratio", "light over the reference's", worse="low"),
        ),
        ("scene",),
        _light,
    ),
    "ghosts": Metric(
        (Column("ghost_share", "share of light that was reflected on its way", worse="high"),),
        ("scene", "image path"),
        _ghosts,
    ),
    "centres": Metric(_movement("centres", "micro-images"), ("white",), _centres, needs_mla=True),
    "chief_rays": Metric(_movement("chief_rays", "chief rays"), (), _chief_rays, needs_mla=True),
    "mtf50": Metric(
        (
            Column("mtf50_lp_per_height", "MTF50, decoded as built to plan / lp per height", worse="low"),
            Column(
                "mtf50_calibrated_lp_per_height", "MTF50, calibrated by its white image / lp per height", worse="low"
            ),
        ),
        ("edge", "white"),
        _mtf50,
        needs_mla=True,
    ),
    "refocus": Metric(
        (
            Column("refocus_mm", "refocus distance, decoded as built to plan / mm"),
            Column("refocus_shift_mm", "refocus distance less the reference's / mm"),
            Column("refocus_error_mm", "size of this shift / mm", "root", magnitude=True, worse="high"),
            Column("refocus_calibrated_shift_mm", "refocus shift, calibrated by its white image / mm"),
            Column("refocus_calibrated_error_mm", "size of this shift / mm", "root", magnitude=True, worse="high"),
        ),
        ("edge", "white"),
        _refocus,
        needs_mla=True,
    ),
    "depth": Metric(
        (
            *_depths("depth", "decoded as built to plan"),
            *_depths("depth_calibrated", "calibrated by its white image"),
        ),
        ("scene", "white"),
        _depth,
        needs_mla=True,
    ),
    "crosstalk": Metric(
        (Column("crosstalk_share", "share of light in micro-images through other lenslets", worse="high"),),
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
