"""What a render returns: the mean and standard error of every pixel, with the ledger that goes with it."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lfmesh.scene import Scene
from lfmesh.transport.adaptive import Refinement
from lfmesh.transport.ledger import Ledger


@dataclass
class Image:
    """A raw sensor image in W per pixel.

    Attributes
    ----------
    mean : (H, W, wavelengths) float64, W
    stderr : (H, W, wavelengths) float64, W
        Standard error of `mean` from the independent replicates; NaN where fewer than two were finished.
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

    @property
    def complete(self) -> bool:
        """False when the run was interrupted before its last replicate."""
        transport = self.scene.transport
        refined = transport.target_error is None or (
            self.refinement is not None and self.refinement.replicates == transport.replicates
        )
        return self.replicates == transport.replicates and refined

    @property
    def wavelengths_nm(self) -> tuple[float, ...]:
        """One a channel of `mean`."""
        return tuple(self.scene.transport.wavelengths_nm)
