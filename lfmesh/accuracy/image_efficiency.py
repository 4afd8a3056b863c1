"""Cost of an image: error against time of each estimator, and its efficiency 1 / (MSE · t).

All estimators of the same light converge to the same power per pixel; those without reflections have their own
reference. The mean squared error over all pixels is taken against a converged reference with another seed, less the
reference's own variance (from its replicates); both are relative to the image's mean square. Time is CPU time. The
efficiency of independent samples does not depend on their number; a better estimator has a higher one.

Rare, heavy paths such as ghosts concentrate a mean square in a few pixels. The typical error complements it: the median
magnitude of the error over the lit pixels.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.scene import Scene
from lfmesh.transport.build import build
from lfmesh.transport.render.image import Image
from lfmesh.transport.render.render import Renderer
from lfmesh.transport.world import World


@dataclass(frozen=True)
class Way:
    """A way to estimate an image.

    Attributes
    ----------
    name : str
    means : str
        Description.
    method, split : str
        Transport settings of the scene.
    aimed, stratified : bool
        See `Renderer`.
    engine : str
        Transport setting of the scene.
    """

    name: str
    means: str
    method: str
    split: str
    aimed: bool
    stratified: bool
    engine: str = "mesh"

    @property
    def reference(self) -> "Way":
        """The way that renders the reference for this one's light."""
        return IMAGE_PATH if self.split == "transmit" else SOBOL


ANALOG = Way(
    "analog forward",
    "light from the lamp, one child by chance at every interface, scattered into the whole hemisphere",
    "forward", "roulette", False, False,
)  # fmt: skip
SPLITTING = Way(
    "forward, splitting",
    "the same, but both children of every interface are followed",
    "forward", "both", False, False,
)  # fmt: skip
AIMING = Way(
    "forward, splitting and aiming",
    "and every scattering sends a weighted child at the entrance pupil",
    "forward", "both", True, False,
)  # fmt: skip
RANDOM = Way(
    "adjoint, random",
    "from the pixel through the lenslets that show it the pupil; random starting points",
    "adjoint", "both", True, False,
)  # fmt: skip
SOBOL = Way(
    "adjoint, Sobol'",
    "the same from scrambled Sobol' points",
    "adjoint", "both", True, True,
)  # fmt: skip
PARTS = Way(
    "adjoint, in parts",
    "the same, the image path sequentially through exact surfaces, the reflections apart from it",
    "adjoint", "both", True, True, "auto",
)  # fmt: skip
IMAGE_PATH = Way(
    "adjoint, image path",
    "the same without reflections",
    "adjoint", "transmit", True, True,
)  # fmt: skip
SEQUENTIAL = Way(
    "adjoint, sequential",
    "the same without reflections, sequentially through exact surfaces",
    "adjoint", "transmit", True, True, "sequential",
)  # fmt: skip
WAYS = (ANALOG, SPLITTING, AIMING, RANDOM, SOBOL, PARTS)


@dataclass(frozen=True)
class Effort:
    """Pixels, samples and repetitions spent on the images.

    Attributes
    ----------
    pixels : int
        Most pixels on the sensor's shorter side; larger sensors are binned.
    samples : dict
        Samples per pixel by way, one point in the figure each.
    repeats : int
        Runs with other seeds, two or more. Their spread gives the uncertainty of the error.
    reference : int
        Samples per pixel of the reference.
    """

    pixels: int
    samples: dict[str, tuple[int, ...]]
    repeats: int
    reference: int


USUAL = Effort(
    160,
    {
        ANALOG.name: (64, 512),
        SPLITTING.name: (64, 512),
        AIMING.name: (8, 32),
        RANDOM.name: (8, 32),
        SOBOL.name: (8, 32),
        PARTS.name: (8, 32),
    },
    4,
    512,
)
QUICK = Effort(
    64,
    {
        ANALOG.name: (256, 1024),
        SPLITTING.name: (256, 1024),
        AIMING.name: (16, 32),
        RANDOM.name: (8, 16),
        SOBOL.name: (8, 16),
        PARTS.name: (8, 16),
    },
    3,
    256,
)

REPLICATES = 2
"""Independent Sobol' sets per pixel that share the samples of a run."""

REFERENCE_REPLICATES = 8

LIT_SHARE = 0.05
"""Fraction of the reference's mean above which a pixel counts as lit."""


@dataclass(frozen=True)
class ImageRow:
    """One way with one number of samples.

    Attributes
    ----------
    samples : int
        Per pixel; forward: packets over pixels.
    seconds : float
        CPU time, mean of the repeats.
    mse, mse_error : float
        Mean squared error over the image's mean square, and its standard error over the repeats.
    typical : float
        Median magnitude of the error over the lit pixels, over the image's rms.
    efficiency, efficiency_error : float
        1 / (mse · seconds), 1/s; NaN if the error is below the reference's.
    bias_z : float
        Difference of the image's total power from the reference's, in standard errors.
    """

    way: str
    samples: int
    seconds: float
    mse: float
    mse_error: float
    typical: float
    efficiency: float
    efficiency_error: float
    bias_z: float


@dataclass(frozen=True)
class ImageStudy:
    """All rows, and their scene and reference.

    Attributes
    ----------
    scene : str
    pixels : tuple of int
    binned : int
        Sensor pixels per binned pixel along each side.
    reference_samples : int
    reference_error : float
        Rms standard error of the reference over the image's rms; if there are two, of the one with all reflections.
    reference_typical : float
        Median standard error over the lit pixels, over the image's rms.
    """

    scene: str
    pixels: tuple[int, int]
    binned: int
    reference_samples: int
    reference_error: float
    reference_typical: float
    rows: tuple[ImageRow, ...]

    def of(self, way: Way) -> tuple[ImageRow, ...]:
        """Return the rows of a way."""
        return tuple(row for row in self.rows if row.way == way.name)

    def efficiency(self, way: Way) -> float:
        """Return a way's efficiency, 1/s, from its largest run."""
        return self.of(way)[-1].efficiency

    def reference_share(self) -> float:
        """Return the reference's own variance over the smallest mean squared error measured against it."""
        smallest = min(row.mse for row in self.rows)
        return self.reference_error**2 / smallest if smallest > 0.0 else math.inf

    def typical_gain(self, way: Way, over: Way) -> float:
        """Return the gain in samples from one way's smaller typical error, at equal samples."""
        return (self.of(over)[-1].typical / self.of(way)[-1].typical) ** 2

    def gain(self, way: Way, over: Way) -> tuple[float, float]:
        """Return the ratio of the efficiencies of two ways, with its standard error."""
        a, b = self.of(way)[-1], self.of(over)[-1]
        ratio = a.efficiency / b.efficiency
        return ratio, ratio * math.hypot(a.efficiency_error / a.efficiency, b.efficiency_error / b.efficiency)


def study_images(
    scene: Scene,
    effort: Effort = USUAL,
    progress: Callable[[str], None] | None = None,
    seed: int = 1,
    ways: Sequence[Way] = WAYS,
) -> ImageStudy:
    """Measure error and time of the ways to estimate a scene's image.

    Parameters
    ----------
    scene : Scene
    effort : Effort
    progress : callable of str, optional
        Called with the current step.
    seed : int
    ways : sequence of Way

    Raises
    ------
    LfmeshError
        The scene cannot be built, or no light reaches the sensor.
    """
    say = progress or (lambda _: None)
    small, binned = _binned(scene, effort.pixels)
    references: dict[Way, Image] = {}
    for way in dict.fromkeys(way.reference for way in ways):
        say(f"images: reference by {way.name}, {effort.reference} samples per pixel")
        references[way] = _run(_world(small, way, effort.reference, REFERENCE_REPLICATES), way, seed)[0]
    main = references.get(SOBOL, next(iter(references.values())))
    power = _power(main)
    if not power > 0.0:
        raise LfmeshError(
            "no light of the scene reaches its sensor: there is no image whose error could be measured; "
            "lfmesh render says where the light goes"
        )
    rows = []
    for way in ways:
        # Compile first.
        _run(_world(small, way, REPLICATES, REPLICATES), way, seed)
        for samples in effort.samples[way.name]:
            say(f"images: {way.name}, {samples} samples per pixel")
            world = _world(small, way, samples, REPLICATES)
            runs = [_run(world, way, seed + 1 + k) for k in range(effort.repeats)]
            rows.append(_row(way, samples, runs, references[way.reference]))
    error = math.sqrt(float((main.stderr**2).mean()) / power)
    typical = float(np.median(main.stderr[_lit(main)])) / math.sqrt(power)
    columns, lines = small.camera.sensor.pixels
    name = scene.title or "the scene"
    return ImageStudy(name, (columns, lines), binned, effort.reference, error, typical, tuple(rows))


def _lit(image: Image) -> NDArray[np.bool_]:
    return image.mean > LIT_SHARE * image.mean.mean()


def _power(image: Image) -> float:
    """Return the mean square of an image's pixels."""
    return float((image.mean**2).mean())


def _binned(scene: Scene, pixels: int) -> tuple[Scene, int]:
    """Return the scene with its sensor binned to about `pixels` along the shorter side, and the binning factor.

    Surplus pixels at the border are dropped.
    """
    sensor = scene.camera.sensor
    factor = max(1, min(sensor.pixels) // pixels)
    changes: dict[str, Any] = {
        "camera.sensor.pixels": [side // factor for side in sensor.pixels],
        "camera.sensor.pixel_mm": sensor.pixel_mm * factor,
    }
    if scene.exposure is not None:
        # A binned row begins as late as its place on the sensor says.
        changes["exposure.row_time_s"] = scene.exposure.row_time_s * factor
    return scene.changed(changes).at_line(scene.primary_nm), factor


def _world(scene: Scene, way: Way, samples: int, replicates: int) -> World:
    """Build a scene for one way."""
    transport = {
        "method": way.method, "split": way.split, "samples": samples, "replicates": replicates, "engine": way.engine,
    }  # fmt: skip
    return build(scene.changed({f"transport.{name}": value for name, value in transport.items()}))


def _run(world: World, way: Way, seed: int) -> tuple[Image, float]:
    """Return an image and the CPU seconds for tracing it."""
    renderer = Renderer(world.reseeded(seed), aimed=way.aimed, stratified=way.stratified)
    began = time.process_time()
    image = renderer.image()
    return image, time.process_time() - began


def _row(way: Way, samples: int, runs: list[tuple[Image, float]], reference: Image) -> ImageRow:
    power = _power(reference)
    own = float((reference.stderr**2).mean())
    errors = np.array([float(((image.mean - reference.mean) ** 2).mean()) - own for image, _ in runs]) / power
    seconds = float(np.mean([t for _, t in runs]))
    mse = float(errors.mean())
    spread = float(errors.std(ddof=1) / math.sqrt(len(errors)))
    known = mse > 0.0
    lit = _lit(reference)
    typical = np.median([np.abs(image.mean - reference.mean)[lit] for image, _ in runs]) / math.sqrt(power)
    totals = [float(image.mean.sum()) for image, _ in runs]
    uncertain = math.sqrt(
        sum(float((image.stderr**2).sum()) for image, _ in runs) / len(runs) ** 2 + float((reference.stderr**2).sum())
    )
    return ImageRow(
        way=way.name,
        samples=samples,
        seconds=seconds,
        mse=mse,
        mse_error=spread,
        typical=float(typical),
        efficiency=1.0 / (mse * seconds) if known else math.nan,
        efficiency_error=spread / (mse * mse * seconds) if known else math.nan,
        bias_z=(float(np.mean(totals)) - float(reference.mean.sum())) / uncertain if uncertain > 0.0 else math.nan,
    )
