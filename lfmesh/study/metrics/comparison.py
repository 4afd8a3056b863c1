"""Films of a camera and the reference, replicate by replicate, as input of metrics.

In a paired study, replicates of the same number share random numbers, and the common noise of both cameras cancels in
differences.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.lightfield.calibration.calibration import Calibration, calibrate
from lfmesh.lightfield.calibration.centres import estimate_centres
from lfmesh.study.metrics.pictures import Camera, Films, image_of
from lfmesh.study.sweeps.statistics import (
    Numbers,
    chosen,
    in_parts,
    independent_product,
    inner_products,
    pseudo_values,
)

Array = NDArray[np.float64]
Found = dict[tuple[str, tuple[int, ...]], Any]
"""Results by name and replicate numbers."""


@dataclass
class Comparison:
    """A camera and the reference, as input of metrics.

    Attributes
    ----------
    camera, reference : Camera
    films, reference_films : dict of (replicates, H, W, channels) float64, W
    replicates : int
        Number of replicates.
    maps : dict of (rows, columns, 2) float64
        Fields over the array, stored by metrics.
    found : dict
        Results of the reference alone, by name and replicates, shared by comparisons.
    """

    camera: Camera
    reference: Camera
    films: Films
    reference_films: Films
    replicates: int
    maps: dict[str, Array] = field(default_factory=dict)
    found: Found = field(default_factory=dict)

    def of_reference(self, name: str, use: Numbers, compute: Callable[[Numbers], Any]) -> Any:
        """Return a result of some replicates of the reference alone, computed once for all cameras.

        Parameters
        ----------
        name : str
            Name of the result.
        use : (n,) int64
        compute : callable
            Computes the result from the numbers of the replicates.
        """
        key = name, tuple(use.tolist())
        if key not in self.found:
            self.found[key] = compute(use)
        return self.found[key]

    @cached_property
    def chief_rays(self) -> Calibration:
        """Centres of the camera's micro-images from traced chief rays."""
        return calibrate(self.camera.scene)

    @cached_property
    def reference_chief_rays(self) -> Calibration:
        """The same for the reference."""
        found: Calibration = self.of_reference("chief rays", self.every, lambda _: calibrate(self.reference.scene))
        return found

    @cached_property
    def products(self) -> Array:
        """Products by parts of the mean-free films of the scene, the camera's before the reference's."""
        both = [*self.films["scene"], *self.reference_films["scene"]]
        return inner_products([film - film.mean() for film in both])

    @cached_property
    def reference_products(self) -> Array:
        """Products by parts of the reference's films of the scene, W²."""
        return inner_products(list(self.reference_films["scene"]))

    @cached_property
    def reference_light(self) -> Array:
        """Contributions of the parts to the means of these films, (parts, replicates), W."""
        films = self.reference_films["scene"]
        return np.stack([in_parts(film).sum(axis=1) / film.size for film in films], axis=1)

    def peak(self, use: Numbers) -> float:
        """Return the brightness of white in the reference's picture, W: its mean square over its mean.

        This is exact for black-and-white pictures and too low for others. The brightest pixel would be the noisiest.
        """
        light = float(self.reference_light[:, use].sum(axis=0).mean())
        square = independent_product(chosen(self.reference_products, use))
        return square / light if light > 0.0 and square > 0.0 else math.nan

    @property
    def every(self) -> Numbers:
        """Numbers of all replicates."""
        return np.arange(self.replicates)


Compute = Callable[[Comparison], Array]
"""Function that returns pseudo-values, (replicates or 1, columns)."""


def reference_centres(pair: Comparison, use: Numbers) -> Calibration:
    """Return the centres of micro-images in the reference's white images.

    Parameters
    ----------
    pair : Comparison
    use : (n,) int64
        Numbers of the replicates.
    """
    nominal, white = pair.reference.scene, pair.reference_films["white"]
    found: Calibration = pair.of_reference(
        "centres", use, lambda use: estimate_centres(image_of(nominal, white[use]), nominal)
    )
    return found


def from_replicates(estimate: Callable[[Numbers], Array], pair: Comparison) -> Array:
    """Return pseudo-values by the jackknife over the replicates.

    Parameters
    ----------
    estimate : callable
        Returns (columns,) values for the numbers of some replicates.
    pair : Comparison
    """
    return pseudo_values(estimate, pair.replicates)
