"""Metrics of a camera against the reference, each as jackknife pseudo-values over replicates.

In a paired study, replicates of the same number share random numbers, and the common noise of both cameras cancels in
differences.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from lfmesh.scene import Scene
from lfmesh.study.metrics.centre_metrics import centres, chief_rays
from lfmesh.study.metrics.column import Column
from lfmesh.study.metrics.comparison import Compute
from lfmesh.study.metrics.depth_metrics import depth
from lfmesh.study.metrics.edge_focus import LEAST_VIEWS
from lfmesh.study.metrics.edge_metrics import mtf50, refocus_distance, why_no_mtf50, why_no_refocus
from lfmesh.study.metrics.image_metrics import crosstalk, ghosts, light, ncc, noise, psnr, ssim


class Metric(NamedTuple):
    """A metric of a study.

    Attributes
    ----------
    columns : tuple of Column
    pictures : tuple of str
        Pictures that it needs, see `pictures.films`.
    compute : callable
    needs_mla : bool
    unknown : callable
        Returns the reason why a scene's camera has no value, or "".
    unseen : str
        Reason why pictures may give no value.
    """

    columns: tuple[Column, ...]
    pictures: tuple[str, ...]
    compute: Compute
    needs_mla: bool = False
    unknown: Callable[[Scene], str] = lambda _: ""
    unseen: str = "there is no light, or not enough of it"

    def why_unknown(self, scene: Scene) -> str:
        """Return the reason why the metric cannot be computed for a scene's camera, or ""."""
        if self.needs_mla and scene.camera.mla is None:
            return "needs a camera with a microlens array"
        return self.unknown(scene)


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
    "psnr": Metric((Column("psnr_db", "PSNR / dB", "psnr", worse="low"),), ("scene",), psnr),
    "ncc": Metric(
        (Column("ncc", "normalised cross-correlation", "itself", True, "low", (-1.0, 1.0)),),
        ("scene",),
        ncc,
    ),
    "ssim": Metric((Column("ssim", "structural similarity", "itself", True, "low", (-1.0, 1.0)),), ("scene",), ssim),
    "light": Metric(
        (
            Column("light_w_per_pixel", "light / W per pixel", worse="low", possible=POSITIVE),
            Column("light_ratio", "light over the reference's", worse="low", possible=POSITIVE),
        ),
        ("scene",),
        light,
    ),
    "ghosts": Metric(
        (Column("ghost_share", "share of light that was reflected on its way", worse="high", possible=SHARE),),
        ("scene", "image path"),
        ghosts,
    ),
    "centres": Metric(_movement("centres", "micro-images"), ("white",), centres, needs_mla=True),
    "chief_rays": Metric(_movement("chief_rays", "chief rays"), (), chief_rays, needs_mla=True),
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
        mtf50,
        needs_mla=True,
        unknown=why_no_mtf50,
        unseen=(
            "the middle of the photograph shows no straight edge, or one that is lost in noise or sharper than its "
            "samples resolve"
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
        refocus_distance,
        needs_mla=True,
        unknown=why_no_refocus,
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
        depth,
        needs_mla=True,
        unseen=(
            "no part of the reference's picture has enough texture to estimate depth, or at least half of it has no "
            "known depth here"
        ),
    ),
    "crosstalk": Metric(
        (Column("crosstalk_share", CROSSED, "chance", worse="high", possible=SHARE),),
        ("lenslets",),
        crosstalk,
        needs_mla=True,
    ),
    "noise": Metric((Column("noise", "noise, rms over rms of the image", "root", worse="high"),), ("scene",), noise),
    "efficiency": Metric((), ("scene",), lambda pair: np.empty((pair.replicates, 0))),
}
"""All metrics by name; "efficiency" has no column here because times vary from run to run, see `outcome`."""


def pictures_of(metrics: tuple[str, ...]) -> tuple[str, ...]:
    """Return the pictures needed by some metrics."""
    return tuple(dict.fromkeys(name for metric in metrics for name in METRICS[metric].pictures))


def columns_of(metrics: tuple[str, ...]) -> tuple[Column, ...]:
    """Return the columns of some metrics."""
    return tuple(column for metric in metrics for column in METRICS[metric].columns)


def metric_of(column: str) -> str:
    """Return the name of the metric that has a column."""
    return next(name for name, metric in METRICS.items() if any(each.name == column for each in metric.columns))
