"""Result of a render: mean and standard error of every pixel, and the ledger."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import BlackPictureWarning, LfmeshError, PictureWarning, in_order
from lfmesh.notebook import Pictured
from lfmesh.scene import Scene
from lfmesh.scene.literals import counted
from lfmesh.transport.checks.aim_proof import AimProof
from lfmesh.transport.checks.blind_check import BlindCheck
from lfmesh.transport.checks.order_check import OrderCheck
from lfmesh.transport.packets.ledger import Ledger
from lfmesh.transport.render.adaptive import Refinement
from lfmesh.transport.render.certainty import (
    FEW_HITS,
    Certainty,
    Estimate,
    error_of,
    errors_by_rows,
    neighbours,
    upper_bound,
)
from lfmesh.transport.render.groups import Groups


class UntracedLight(NamedTuple):
    """Light that no path finds, added to an image."""

    power: NDArray[np.float64]  # (H, W, wavelengths) W
    warnings: tuple[PictureWarning, ...]  # known and possible errors


@dataclass
class Image(Pictured):
    """Raw sensor image in W per pixel.

    Attributes
    ----------
    mean : (H, W, wavelengths) float64, W
    stderr : (H, W, wavelengths) float64, W
        Standard error of `mean` from the spread of independent `groups` of replicates; NaN with fewer than two. It is 0
        in a pixel for which no path found light, and with few replicates often far too small. Weights 1/stderr² favour
        pixels that missed the bright paths, so the weighted mean is too dark, the more so the fewer hits there are.
        Weights from `error` do so less; plain sums over blocks of pixels are unbiased.
    scene : Scene
        The scene as rendered: every distance solved, files inlined.
    ledger : Ledger
    seconds : float
        Wall-clock time of tracing.
    replicates : int
        Number of finished replicates, of `scene.transport.replicates`.
    samples : float
        Samples per pixel in the finished replicates of all stages; mean over the pixels.
    engine : str
        The engine that ran, and the reason, in words.
    timings : dict
        Seconds by part, and related counts.
    refinement : Refinement or None
        Result of adaptive sampling, if any.
    hits : (H, W, wavelengths) uint32, or None
        Number of samples that brought light to the pixel at the wavelength, over all finished replicates, stages and
        parts of the image; None if not counted. Adjoint: paths started at the pixel, each counted once, however many
        lights and targets it met and however often it split; if the image path and paths with reflections are estimated
        separately, each starts its own paths. Forward: packets that fell on the pixel; several may stem from one start.
    aim : AimProof or None
        Proof that the aim holds all light.
    blind : BlindCheck or None
        Comparison with samples that were not aimed.
    order : OrderCheck or None
        Comparison of surfaces of lens and array found by order with surfaces found by meshes; None if only meshes were
        used.
    coatings : dict of str to float
        For each coating in use, the largest interpolation error of reflectance and transmittance.
    warnings : tuple of PictureWarning
        Known and possible errors of the picture, most important first, as warned by `lf.render`.
    certainty : Certainty or None
        `error` and `upper`, from the parts of the image; None for a single part, where they follow from `mean`,
        `stderr` and `hits`.

    See Also
    --------
    Image.error : the error to report for a pixel.
    Image.upper : an upper bound for a pixel, whether a path found light for it or not.
    """

    mean: NDArray[np.float64]
    stderr: NDArray[np.float64]
    scene: Scene
    ledger: Ledger
    seconds: float
    replicates: int
    samples: float
    engine: str
    timings: dict[str, float] = field(default_factory=dict)
    refinement: Refinement | None = None
    hits: NDArray[np.uint32] | None = None
    aim: AimProof | None = None
    blind: BlindCheck | None = None
    order: OrderCheck | None = None
    coatings: dict[str, float] = field(default_factory=dict)
    warnings: tuple[PictureWarning, ...] = ()
    certainty: Certainty | None = None

    def __repr__(self) -> str:
        rows, columns, channels = self.mean.shape
        return (
            f"<Image: {columns} × {rows} pixels, {counted(channels, 'wavelength')}, "
            f"{self.replicates} of {self.scene.transport.replicates} replicates, {self.samples:g} samples per pixel, "
            f"{self.mean.sum():.4g} W in all>"
        )

    @property
    def groups(self) -> int:
        """Number of independent groups of the finished replicates; `stderr` has one fewer degree of freedom.

        Each replicate is a group, except in scenes with bands. These have at most eight groups of replicates that share
        the wavelengths of their samples.
        """
        return Groups.of(self.scene).begun(self.replicates)

    @property
    def complete(self) -> bool:
        """True if all replicates are finished."""
        transport = self.scene.transport
        refined = transport.target_error is None or (
            self.refinement is not None and self.refinement.replicates == transport.replicates
        )
        return self.replicates == transport.replicates and refined

    @property
    def error(self) -> NDArray[np.float64]:
        """Pooled standard error of each pixel, (H, W, wavelengths) float64, W; for a single part computed at each call.

        For each part of the image, the variance is the mean of the pixel's own and that of a pool. The pool makes up
        for the few replicates of one pixel. It holds the pixel, the eight around it and those at its place in the
        adjacent micro-images, if they are as bright (within a factor of 1.5) and lie where the picture is as steep
        (within a factor of 2). Pixels with few hits are pooled if these differ by no more than chance. For a part with
        few hits in nearly all pixels, the pool holds all such pixels. NaN with fewer than two replicates.
        """
        if self.certainty is not None:
            return self.certainty.error
        return error_of(self._estimate(self.hits), neighbours(self.scene))

    def errors_by_rows(self) -> Iterator[tuple[slice, NDArray[np.float64], NDArray[np.int64]]]:
        """Yield some rows, their `error`, and the number of pixels in each pool of neighbours.

        Yields
        ------
        rows : slice
        error : (rows, W, wavelengths) float64
            W.
        pooled : (rows, W, wavelengths) int64
        """
        for rows, error, pooled in errors_by_rows(self._estimate(self.hits), neighbours(self.scene)):
            yield rows, error if self.certainty is None else self.certainty.error[rows], pooled

    @property
    def upper(self) -> NDArray[np.float64]:
        """Upper bound of each pixel, with a confidence of 95 % each, (H, W, wavelengths) float64, W.

        The bound is the mean plus Student's quantile of standard errors. With few hits or none, it is the limit on the
        share of samples that carry light, times the light of one such sample in the brightest pixels. It is at least
        the limit without a hit, times the light of paths met by neighbours, as heavy paths may have been missed among
        many light ones. The squares of several parts' margins are added; for a single part the bound is computed at
        each call. See `lfmesh.transport.render.certainty.upper_bound`.

        Raises
        ------
        LfmeshError
            The image has no count of hits.
        """
        if self.certainty is not None:
            return self.certainty.upper
        if self.hits is None:
            raise LfmeshError("an image without hits has no upper bound: it was not rendered, or by an older lfmesh")
        return upper_bound([self._estimate(self.hits)], [self.error], neighbours(self.scene), self.groups)

    def with_light(self, light: UntracedLight) -> "Image":
        """Return the image with noise-free light added to each pixel.

        Parameters
        ----------
        light : UntracedLight

        Returns
        -------
        Image
        """
        power = light.power
        certainty = Certainty(self.error, self.upper + power)
        ledger = replace(self.ledger, untraced=self.ledger.untraced + float(power.sum()))
        # A picture without light from paths is not black if it has such light.
        of_traced = [each for each in self.warnings if not (power.any() and isinstance(each, BlackPictureWarning))]
        warnings = in_order([*of_traced, *light.warnings])
        return replace(self, mean=self.mean + power, certainty=certainty, ledger=ledger, warnings=warnings)

    def _estimate(self, hits: NDArray[np.uint32] | None) -> Estimate:
        """Return the image as a single-part estimate; without hits, every pixel counts as having enough."""
        transport = self.scene.transport
        samples = transport.samples_each * self.replicates
        if transport.method == "forward":
            samples *= self.mean.shape[0] * self.mean.shape[1]
        if hits is None:
            hits = np.broadcast_to(np.uint32(FEW_HITS), self.mean.shape)
        return Estimate(self.mean, self.stderr, hits, samples)

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names of the bands; none for channels of single wavelengths."""
        return self.scene.channel_names

    @property
    def wavelengths_nm(self) -> tuple[float, ...]:
        """Wavelength of each channel of `mean`, nm; for a band, the centroid of its response."""
        return self.scene.wavelengths_nm
