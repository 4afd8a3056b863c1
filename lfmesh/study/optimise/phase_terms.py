"""Phases of revolution as sums of powers and distances, whose gradients have derivatives by their numbers."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.optics.phase_shapes import HOLOGRAM, METALENS, RADIAL
from lfmesh.scene import Surface
from lfmesh.study.optimise.jet import Jet

Array = NDArray[np.float64]


class PhaseTerms(NamedTuple):
    """A phase m Φ = Σ a_i r^(2i) + Σ k_j √(r² + z_j²) of one order, less a constant.

    Attributes
    ----------
    powers : (n,) float64
        a_i, in rad/mm², rad/mm⁴, ...
    distances : (k, 2) float64
        k_j in rad/mm, and z_j in mm.
    """

    powers: Array
    distances: Array

    @property
    def counts(self) -> tuple[int, int]:
        """Number of terms of each kind."""
        return len(self.powers), len(self.distances)


def phase_terms(surface: Surface) -> PhaseTerms:
    """Return the phase of a surface in its main order; no terms without a phase.

    Parameters
    ----------
    surface : Surface
        Its phase, if any, is of revolution.
    """
    powers, distances = np.zeros(0), np.zeros((0, 2))
    if surface.phase is None:
        return PhaseTerms(powers, distances)
    order, (kind, scale, numbers) = surface.phase.main_order, surface.phase.profile()
    if kind == RADIAL:
        powers = order * numbers * scale ** (2.0 * (1.0 + np.arange(len(numbers))))
    elif kind == METALENS:
        distances = np.array([[-order * math.copysign(numbers[1], numbers[0]), numbers[0]]])
    elif kind == HOLOGRAM:
        signs, _, _, z = numbers[1:].reshape(2, 4).T
        distances = np.column_stack([order * numbers[0] * signs * (-1.0, 1.0), z])
    return PhaseTerms(powers, distances)


def steepness(powers: Jet, distances: Jet, r2: Jet) -> Jet:
    """Return the derivative of a phase by the height, divided by the height, at given squared heights, rad/mm².

    Parameters
    ----------
    powers : Jet
        (n,), as in `PhaseTerms`.
    distances : Jet
        (k, 2).
    r2 : Jet
        (rays,), mm².
    """
    total = r2 * 0.0
    for i in range(len(powers.value)):
        lower = r2.power(i) if i else r2 * 0.0 + 1.0
        total = total + powers.picked(i) * lower * (2.0 * (i + 1.0))
    for j in range(len(distances.value)):
        z = distances.picked((j, 1))
        total = total + distances.picked((j, 0)) / (r2 + z * z).root()
    return total
