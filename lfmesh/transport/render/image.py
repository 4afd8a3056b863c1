"""What a render returns: the mean and standard error of every pixel, with the ledger that goes with it."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.scene import Scene
from lfmesh.transport.aiming.aim_proof import AimProof
from lfmesh.transport.packets.ledger import Ledger
from lfmesh.transport.render.adaptive import Refinement
from lfmesh.transport.render.blind_check import BlindCheck
from lfmesh.transport.render.certainty import neighbours, pooled_error, upper_bound


@dataclass
class Image:
    """A raw sensor image in W per pixel.

    Attributes
    ----------
    mean : (H, W, wavelengths) float64, W
    stderr : (H, W, wavelengths) float64, W
        Standard error of `mean` from the independent replicates; NaN where fewer than two were finished. It is the
        spread and nothing more: 0 in a pixel that no path found light for, and of few replicates often far too small.
        Weights 1/stderr² favour the pixels that missed the bright paths, and a mean taken with them is too dark, the
        more so the fewer hits there are; `error` is milder, plain sums over blocks of pixels are right.
    scene : Scene
        As rendered: every distance solved, files inlined.
    ledger : Ledger
    seconds : float
        Wall-clock time of tracing.
    replicates : int
        Replicates finished, of `scene.transport.replicates`.
    samples : float
        Samples per pixel in the finished replicates, of both stages where there are two; their mean over the pixels.
    engine : str
        Which engine ran and why, in words.
    timings : dict
        Seconds by part, and counts that go with them.
    refinement : Refinement or None
        What adaptive sampling did after the `replicates`, where it came to that.
    hits : (H, W, wavelengths) uint32, or None
        Samples that brought light to the pixel at the wavelength, over all finished replicates, stages and parts of the
        image; None where nobody counted (an image made by hand). Adjoint: paths started at the pixel, each once,
        however many lights and targets it met and however often it split; the image path and the paths with
        reflections, where they are estimated apart, start paths of their own. Forward: packets that fell on the
        pixel, of which two may descend from one.

    See Also
    --------
    Image.error : the error to report for a pixel.
    Image.upper : what a pixel holds at most, whether a path found light for it or not.
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

    @property
    def complete(self) -> bool:
        """False when the run was interrupted before its last replicate."""
        transport = self.scene.transport
        refined = transport.target_error is None or (
            self.refinement is not None and self.refinement.replicates == transport.replicates
        )
        return self.replicates == transport.replicates and refined

    @property
    def error(self) -> NDArray[np.float64]:
        """Standard error of each pixel, pooled, (H, W, wavelengths) float64, W; computed at each call.

        Half a pixel's own variance and half the mean one of itself and its neighbours as bright (within a factor of
        1.5) and in as steep a part of the picture (within one of 2): the eight around, and those at its place in the
        adjacent micro-images. What a few replicates of one pixel cannot know, its neighbours do. NaN with fewer than
        two replicates.
        """
        return pooled_error(self.mean, self.stderr, neighbours(self.scene))[0]

    @property
    def upper(self) -> NDArray[np.float64]:
        """What each pixel holds at most, with a confidence of 95 % each, (H, W, wavelengths) float64, W.

        Mean plus Student's quantile of standard errors; with few hits or none, what follows from the share of samples
        that could have brought light unseen, and from what a sample of the brightest pixel brings. Computed at each
        call; see `lfmesh.transport.render.certainty.upper_bound`.

        Raises
        ------
        LfmeshError
            Nobody counted the hits.
        """
        if self.hits is None:
            raise LfmeshError("an image without hits has no upper bound: it was not rendered, or by an older lfmesh")
        transport = self.scene.transport
        samples = transport.samples // transport.replicates * self.replicates
        if transport.method == "forward":
            samples *= self.mean.shape[0] * self.mean.shape[1]
        return upper_bound(self.mean, self.stderr, self.hits, self.replicates, samples)

    @property
    def wavelengths_nm(self) -> tuple[float, ...]:
        """One a channel of `mean`."""
        return tuple(self.scene.transport.wavelengths_nm)
