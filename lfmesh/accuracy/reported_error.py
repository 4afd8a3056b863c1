"""Reported against true error of an image, from crops of a scene and a long render of the same crop.

Pixels are grouped in two ways: by brightness and local contrast in the reference, independently of the image's noise;
and by quarters of the reported error, among pixels that found light. Each group compares the rms of the reported error
with that of the true error, less the reference's own variance.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfmesh.scene import Scene
from lfmesh.transport.render.image import Image
from lfmesh.waves.render import render

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CROPS = {
    "anamorphic": (-1.0, 0.5),
    "aquarium": (-1.0, 0.5),
    "circuit_board": (1.4, 0.6),
    "coated": (-1.0, 0.5),
    "color_checker": (-1.0, 0.5),
    "conventional": (-1.0, 0.5),
    "cover_glass": (-1.0, 0.5),
    "crossed_cylinders": (-1.0, 0.5),
    "demo": (-1.0, 0.5),
    "diffraction": (0.0, 0.0),
    "emitting_plane": (-0.5, 0.5),
    "eye": (-0.3, 0.15),
    "first_light": (-1.0, 0.5),
    "flame": (0.0, 0.5),
    "focused": (-1.0, 0.5),
    "fog": (-1.0, 0.5),
    "glossy": (1.0, 0.5),
    "grin_rods": (-1.0, 0.5),
    "ground_glass": (-1.0, 0.5),
    "hexagonal": (-1.0, 0.5),
    "hybrid_singlet": (-1.0, 0.5),
    "hot_metal": (1.1, 0.5),
    "immersed_sensor": (-1.0, 0.5),
    "light_field_microscope": (0.0, 0.0),
    "lit_chart": (-1.0, 0.5),
    "metalens_array": (-1.0, 0.5),
    "lytro_class": (-2.5, 1.5),
    "panel_and_tube": (-1.0, 0.5),
    "particles": (-1.0, 0.5),
    "polarised": (-1.0, 0.5),
    "rolling_shutter": (-1.0, 0.3),
    "schlieren_plume": (-1.0, 0.5),
    "streaks": (-0.9, 1.0),
    "tank": (-1.0, 0.5),
    "underwater": (-1.0, 0.5),
}
"""Centre of a crop of each scene in assets, mm on the sensor; the crops contain edges, smooth parts and shadows."""

DIM_SHARE = 0.05
"""Fraction of the reference's bright pixels (99th percentile) below which pixels form a separate group."""

LEVELS = 2
"""Classes of brightness, and of contrast in each."""

BLOCK_PX = 8
"""Side of the blocks of pixels for the jackknife error of a ratio."""

ENOUGH_HITS = 100
"""Least number of hits for the coverage of single pixels."""


@dataclass(frozen=True)
class ErrorRatio:
    """Reported over true error in a group of pixels.

    Attributes
    ----------
    group : str
        "dim", "brightness 0, contrast 1", ... (by the reference) or "reported 0" to "reported 3".
    pixels : int
    ratio : float
        Root mean square over root mean square.
    stderr : float
        Standard error of the ratio: jackknife over blocks of pixels, or over images.
    """

    group: str
    pixels: int
    ratio: float
    stderr: float


@dataclass(frozen=True)
class Coverage:
    """Fraction of pixels with the truth within a number of their standard errors; see `coverage`.

    Attributes
    ----------
    sigmas : float
    found, expected : float
        Fraction of the pixels (NaN if there are none), and that from Student's t for the image's groups of replicates.
    pixels : int
    """

    sigmas: float
    found: float
    expected: float
    pixels: int


def crop(scene: Scene, side: int, at_mm: tuple[float, float]) -> Scene:
    """Crop a scene's sensor to `side` × `side` of its own pixels about a point, on the same grid.

    Parameters
    ----------
    scene : Scene
    side : int, pixels
    at_mm : (x, y), mm
        On the sensor, from its centre.
    """
    pitch = scene.camera.sensor.pixel_mm
    shift = scene.camera.sensor.pose.shift_mm
    # The centre of a sensor with an even number of pixels is between two of them.
    x, y = (round(at / pitch) * pitch + moved for at, moved in zip(at_mm, shift[:2], strict=True))
    return scene.changed({"camera.sensor.pixels": (side, side), "camera.sensor.pose.shift_mm": (x, y, shift[2])})


def sampled(scene: Scene, samples: int, replicates: int, seed: int) -> Image:
    """Render with other samples, replicates and seed; images of different seeds share no random number.

    Parameters
    ----------
    scene : Scene
    samples : int
        A pixel, in all.
    replicates : int
    seed : int
    """
    changes = {"samples": samples, "replicates": replicates, "seed": seed}
    return render(scene.changed({f"transport.{name}": value for name, value in changes.items()}))


def error_ratios(image: Image, reference: Image, error: Array | None = None) -> list[ErrorRatio]:
    """Compare the reported with the true error in every group of pixels.

    Parameters
    ----------
    image, reference : Image
        From one scene with different seeds, at one wavelength; the reference has many more samples.
    error : (H, W, 1) float64, optional
        Replaces the image's error.
    """
    return [
        _ratio(name, int(here.sum()), *_by_blocks(here, reported, true))
        for name, here, reported, true in _groups(image, reference, image.error if error is None else error)
    ]


def mean_error_ratios(images: Iterable[Image], reference: Image) -> list[ErrorRatio]:
    """Compare the reported with the true error over several images of one scene, in every group of pixels.

    A heavy path met by few images raises their reported errors in all pixels. Only other images show how much of this
    is chance, so the standard error of a ratio is a jackknife over images.
    """
    sums: dict[str, list[tuple[int, float, float]]] = {}
    for image in images:
        for name, here, reported, true in _groups(image, reference, image.error):
            sums.setdefault(name, []).append((int(here.sum()), reported[here].sum(), true[here].sum()))
    ratios = []
    for name, of_images in sums.items():
        pixels, above, below = np.array(of_images).T
        ratios.append(_ratio(name, int(pixels.sum()), above, below))
    return ratios


def _groups(image: Image, reference: Image, error: Array) -> Iterator[tuple[str, Mask, Array, Array]]:
    """Yield the non-empty groups of pixels, with the squares of reported and true error, (H, W)."""
    reported = error[:, :, 0] ** 2
    noise = reference.stderr[:, :, 0] ** 2
    true = (image.mean - reference.mean)[:, :, 0] ** 2 - noise
    assert image.hits is not None
    groups = [*by_reference(reference.mean[:, :, 0]), *by_report(reported, image.hits[:, :, 0] > 0)]
    yield from ((name, here, reported, true) for name, here in groups if here.any())


def by_reference(mean: Array) -> Iterator[tuple[str, Mask]]:
    """Yield groups by a reference (H, W): dim pixels, and the others by brightness and contrast."""
    lit = mean > DIM_SHARE * np.percentile(mean, 99.0)
    yield "dim", ~lit & (mean > 0.0)
    contrast = local_contrast(mean)
    parts = np.linspace(0.0, 1.0, LEVELS + 1)[1:-1]
    brightness = np.digitize(mean, np.quantile(mean[lit], parts))
    for level in range(LEVELS):
        bright = lit & (brightness == level)
        steep = np.digitize(contrast, np.quantile(contrast[bright], parts))
        for part in range(LEVELS):
            yield f"brightness {level}, contrast {part}", bright & (steep == part)


def by_report(reported: Array, seen: Mask) -> Iterator[tuple[str, Mask]]:
    """Yield the quarters of the pixels that found light, by the reported variance (H, W)."""
    quarter = np.digitize(reported, np.quantile(reported[seen], [0.25, 0.5, 0.75]))
    for part in range(4):
        yield f"reported {part}", seen & (quarter == part)


def local_contrast(mean: Array) -> Array:
    """Return the standard deviation of the 3 × 3 pixels about each, over their mean, (H, W)."""
    framed = np.pad(mean, 1, mode="edge")
    rows, columns = mean.shape
    near = np.stack([framed[i : i + rows, j : j + columns] for i in range(3) for j in range(3)])
    level = near.mean(axis=0)
    return np.divide(near.std(axis=0), level, out=np.zeros_like(level), where=level > 0.0)


def coverage(image: Image, reference: Image) -> list[Coverage]:
    """Count how often the truth lies within 1, 2 and 3 standard errors of a pixel.

    Only pixels with 100 hits or more and with noise larger than one hit count: in an evenly lit pixel, replicates may
    find equal numbers of hits and have no spread, although the truth is off by a fraction of a hit. The noise is the
    reference's, scaled to the image's samples. The reference's error widens the difference, as part of a pooled error.
    """
    from scipy import stats

    assert image.hits is not None
    one_hit = image.mean / np.maximum(image.hits, 1)
    noise = reference.error * np.sqrt(reference.samples / image.samples)
    known = (image.hits >= ENOUGH_HITS) & (noise > one_hit)
    wider = 1.0 + (reference.stderr[known] / image.error[known]) ** 2
    away = np.abs(image.mean - reference.mean)[known] / (image.stderr[known] * np.sqrt(wider))
    freedom = image.groups - 1
    return [
        Coverage(k, _share(away <= k), float(1.0 - 2.0 * stats.t.sf(k, freedom)), int(known.sum()))
        for k in (1.0, 2.0, 3.0)
    ]


def _by_blocks(here: Mask, reported: Array, true: Array) -> tuple[Array, Array]:
    """Return the sums of both over the pixels of a group in each block of the image."""
    rows, columns = np.nonzero(here)
    block = rows // BLOCK_PX * (here.shape[1] // BLOCK_PX + 1) + columns // BLOCK_PX
    _, block = np.unique(block, return_inverse=True)
    above, below = (np.bincount(block, of[here]).astype(float) for of in (reported, true))
    return above, below


def _ratio(name: str, pixels: int, above: Array, below: Array) -> ErrorRatio:
    """Return the ratio of a group from sums over blocks or images, with the jackknife's standard error."""
    ratio = _root(above.sum(), below.sum())
    count = len(above)
    without = np.array([_root(above.sum() - a, below.sum() - b) for a, b in zip(above, below, strict=True)])
    spread = np.sqrt((count - 1) / count * ((without - without.mean()) ** 2).sum()) if count > 1 else np.inf
    return ErrorRatio(name, pixels, ratio, float(spread))


def _share(of: Mask) -> float:
    return float(of.mean()) if of.size else np.nan


def _root(above: float, below: float) -> float:
    return float(np.sqrt(above / below)) if below > 0.0 else np.inf


def study_errors(
    scene: Scene,
    samples: Sequence[int],
    replicates: Sequence[int],
    reference_samples: int,
    step: Callable[[str], object] = lambda _: None,
) -> Iterator[tuple[Image, Image]]:
    """Yield pairs of image and reference, for every combination of samples and replicates.

    Parameters
    ----------
    scene : Scene
    samples : sequence of int
        Per pixel, in all.
    replicates : sequence of int
    reference_samples : int
    step : callable of str
        Called with the next render.
    """
    step(f"{scene.name}: reference of {reference_samples} samples")
    reference = sampled(scene, reference_samples, 8, 0)
    for number in samples:
        for count in replicates:
            step(f"{scene.name}: {number} samples in {count} replicates")
            yield sampled(scene, number, count, 1000 * number + count), reference
