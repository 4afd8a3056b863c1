"""Scenes that move during an exposure, closed forms of their pictures, and comparisons by the scatter over seeds.

The camera has an ideal lens, so that an edge in its plane of focus is sharp: a pixel is a rectangle of that plane.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

import lfmesh as lf
from tests.renders import by_seed

Array = NDArray[np.float64]
Tables = dict[str, Any]

LEVEL = 1e-3
"""Chance that a right picture fails a test, shared by all its comparisons (Bonferroni)."""

FOCAL_MM, FOCUS_MM = 50.0, 500.0
SCALE = FOCUS_MM / FOCAL_MM - 1.0
"""Size of an object in focus over that of its picture."""

PIXEL_MM = 0.05
DURATION_S = 0.01

OPEN = np.array([[0.0, DURATION_S], [1.0, 1.0]])
"""A shutter that is open throughout: times, s, and opening."""


def camera(columns: int = 16, rows: int = 8, semi_mm: float = 1.0, pixel_mm: float = PIXEL_MM) -> Tables:
    """Return a conventional camera with an ideal lens, which is its own stop."""
    lens = {"paraxial": True, "focal_length_mm": FOCAL_MM, "semi_diameter_mm": semi_mm, "stop": True}
    sensor = {"pixels": (columns, rows), "pixel_mm": pixel_mm}
    return {"focus_mm": FOCUS_MM, "lens": {"surfaces": [lens]}, "sensor": sensor}


def scene_of(targets: Iterable[Tables], **tables: Any) -> lf.Scene:
    """Return a scene of this camera; `transport` adds to its settings, other tables to the scene."""
    settings = {"split": "transmit", "threads": 1, "replicates": 1, "samples": 256} | tables.pop("transport", {})
    return lf.Scene(**({"camera": camera(), "targets": list(targets), "transport": settings} | tables))


def exposure(shutter: ArrayLike | None = None, **keys: Any) -> Tables:
    """Return an exposure of DURATION_S; the shutter as times and openings, (2, k)."""
    own: Tables = {} if shutter is None else {"shutter": np.asarray(shutter, np.float64).T.tolist()}
    return {"duration_s": DURATION_S, **own, **keys}


def glowing(low_mm: float, high_mm: float, **keys: Any) -> Tables:
    """Return a plane in focus that shines, between two x."""
    shape = {"kind": "plane", "width_mm": high_mm - low_mm, "height_mm": 8.0}
    return {
        "shape": shape, "position_mm": (0.5 * (low_mm + high_mm), 0.0, -FOCUS_MM),
        "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}, **keys,
    }  # fmt: skip


WHOLE = glowing(-5.0, 5.0)
"""A plane that shines and fills the picture."""


def borders(count: int, pixel_mm: float = PIXEL_MM) -> Array:
    """Return the borders of columns or rows in the plane of focus, (count + 1,) mm; the lens turns them round."""
    return np.asarray(-SCALE * pixel_mm * (np.arange(count + 1) - 0.5 * count))


def swept(borders_mm: Array, path: ArrayLike, begin_s: float = 0.0, shutter: ArrayLike = OPEN) -> Array:
    """Return the mean over a window of the share of intervals that lies below an edge that moves.

    Parameters
    ----------
    borders_mm : (n + 1,) float64
        Decreasing.
    path : (2, k) array_like
        Times, s, and where the edge is, mm; linear in between.
    begin_s : float
        Begin of the window.
    shutter : (2, m) array_like
        Times in the window, and opening.
    """
    times, at = np.asarray(path, np.float64)
    opens, opening = np.asarray(shutter, np.float64)
    # Simpson's rule is exact between the times at which the path, the shutter or the share changes its slope.
    nodes = [opens, times - begin_s]
    for k in np.flatnonzero(np.diff(at)):
        crossing = times[k] + (borders_mm - at[k]) / (at[k + 1] - at[k]) * (times[k + 1] - times[k])
        nodes.append(crossing - begin_s)
    node = np.unique(np.clip(np.concatenate(nodes), opens[0], opens[-1]))

    def integrand(time: Array) -> Array:
        edge = np.interp(begin_s + time, times, at)[:, None]
        share = np.clip((edge - borders_mm[1:]) / (borders_mm[:-1] - borders_mm[1:]), 0.0, 1.0)
        return np.asarray(np.interp(time, opens, opening)[:, None] * share)

    a, b = node[:-1], node[1:]
    parts = (b - a)[:, None] / 6.0 * (integrand(a) + 4.0 * integrand(0.5 * (a + b)) + integrand(b))
    return np.asarray(parts.sum(axis=0) / np.trapezoid(opening, opens))


def stack(scene: lf.Scene, seeds: Iterable[int]) -> Array:
    """Return the images of seeds, (n, H, W), W."""
    return np.array([image.mean[..., 0] for image in by_seed(scene, seeds)])


def assert_zero(differences: Array, one_sample: float, visible: float) -> None:
    """Test that independent estimates of numbers have a mean of zero, by t-tests at LEVEL.

    Parameters
    ----------
    differences : (n, ...) float64
    one_sample : float
        What one sample adds to an estimate: the error of a mean is not smaller than by one sample more or less.
    visible : float
        A larger standard error is refused: the test would see too little.
    """
    count = len(differences)
    of_all = differences.reshape(count, -1)
    mean, error = of_all.mean(axis=0), of_all.std(axis=0, ddof=1) / np.sqrt(count)
    assert error.max() < visible, f"standard errors of up to {error.max():.3g} show too little"
    z = mean / np.maximum(error, one_sample / np.sqrt(count))
    p = 2.0 * stats.t.sf(np.abs(z), count - 1)
    worst = int(np.argmin(p))
    assert p[worst] > LEVEL / (2 * p.size), f"number {worst}: {mean[worst]:.4g} ± {error[worst]:.2g}, z {z[worst]:.1f}"
    normal = stats.norm.isf(0.5 * np.maximum(p, 1e-300))
    assert stats.chi2.sf((normal**2).sum(), p.size) > 0.5 * LEVEL, f"sum of z²: {(normal**2).sum():.1f} of {p.size}"


def profiles(images: Array) -> Array:
    """Return the sums of columns, of rows and of all pixels, (n, H, W) to (n, W + H + 1)."""
    total = images.sum(axis=(1, 2))[:, None]
    return np.concatenate([images.sum(axis=1), images.sum(axis=2), total], axis=1)


def assert_same(one: Array, other: Array, visible: float) -> None:
    """Test that independent estimates of numbers have equal means, by Welch's t-tests at LEVEL.

    Parameters
    ----------
    one, other : (n, k) float64
        Such as `profiles` of images.
    visible : float
        Largest acceptable standard error of a difference, over the greatest number.
    """
    means = [part.mean(axis=0) for part in (one, other)]
    # At least rounding, where both take the same rays.
    spreads = [np.maximum(part.std(axis=0, ddof=1), 1e-9 * means[1].max()) for part in (one, other)]
    error = np.hypot(*(spread / np.sqrt(len(part)) for spread, part in zip(spreads, (one, other), strict=True)))
    assert error.max() < visible * means[1].max(), f"standard error {error.max() / means[1].max():.2g}"
    p = stats.ttest_ind_from_stats(
        means[0], spreads[0], len(one), means[1], spreads[1], len(other), equal_var=False
    ).pvalue
    worst = int(np.argmin(p))
    assert p[worst] > LEVEL / p.size, (
        f"number {worst}: {means[0][worst]:.5g}, not {means[1][worst]:.5g}: p {p[worst]:.1g}"
    )
