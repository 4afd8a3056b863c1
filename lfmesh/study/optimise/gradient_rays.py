"""Rays through gradient-index glass, with their derivatives by the variables of a design.

The glass is a map from position and optical ray vector T (the index times the unit direction) where a ray enters to
those after a given length in σ, see `lfmesh.optics.gradient_path`. Derivatives of this map are central differences
along each variable, with all its effects before the glass and in it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import kernel
from lfmesh.optics.gradient_path import GradientRay, advance
from lfmesh.optics.gradient_shapes import GradientProfile
from lfmesh.optics.gradients import Gradients, field_at, gradient_table
from lfmesh.scene import Surface
from lfmesh.study.optimise.jet import Jet

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

DIFFERENCE = 1e-3
"""Step of the differences, over a variable's range or, if less, the largest relative change of a ray. As they have
order 4, their error is some 1e-12 of the change over the whole range, like that of rounding."""

FEWEST_STEPS, MOST_STEPS = 8, 1024
"""Numbers of equal steps through a glass."""

PRECISION = 1e-12
"""Change of the rays' ends by twice as many steps, over the length of the glass, at which steps suffice."""


class GradientForm(NamedTuple):
    """Properties of a surface's gradient that stay fixed while its numbers vary.

    Attributes
    ----------
    kind, quantity, counts
        As for `GradientProfile`.
    numbers, material : int
        Numbers of coefficients of the polynomial and of its material.
    """

    kind: int
    quantity: int
    counts: tuple[int, int, int]
    numbers: int
    material: int

    def table(self, numbers: Array) -> Gradients:
        """Return the gradients that have given numbers, (wavelengths, numbers + material)."""
        return gradient_table([GradientProfile(*self[:3], row[: self.numbers], row[self.numbers :]) for row in numbers])


def gradient_form(surface: Surface, wavelength_nm: float) -> GradientForm | None:
    """Return the form of the gradient behind a surface; None without one."""
    if surface.gradient is None:
        return None
    profile = surface.gradient.profile(wavelength_nm)
    return GradientForm(*profile[:3], len(profile.numbers), len(profile.material))


def gradient_numbers(surface: Surface, waves_nm: tuple[float, ...]) -> Array:
    """Return the numbers of the gradient behind a surface, (wavelengths, numbers); (wavelengths, 0) without one."""
    if surface.gradient is None:
        return np.zeros((len(waves_nm), 0))
    profiles = [surface.gradient.profile(wave) for wave in waves_nm]
    return np.array([np.concatenate([profile.numbers, profile.material]) for profile in profiles])


@dataclass(frozen=True)
class GradientGlass:
    """Gradient-index glass of a camera for rays of several wavelengths, in its own frame.

    Attributes
    ----------
    form : GradientForm
    numbers : Jet
        (wavelengths, numbers).
    wave : (n,) int64
        Wavelength of each ray.
    """

    form: GradientForm
    numbers: Jet
    wave: Whole

    def index_at(self, points: Jet) -> Jet:
        """Return the index at points, (n, 3) mm, of the rays: (n,)."""
        fields = self._fields_at(self.numbers.value, points.value)
        index = np.sqrt(fields[:, 0])
        slope = 2.0 * np.einsum("nk,nkm->nm", fields[:, 1:], points.slope)
        for variable in _of_numbers(self.numbers):

            def square(move: float, along: Array = self.numbers.slope[:, :, variable]) -> Array:
                return self._fields_at(self.numbers.value + move * along, points.value)[:, 0]

            slope[:, variable] += _derivative(square, DIFFERENCE)
        return Jet(index, slope / (2.0 * index[:, None]))

    def kicks(self, points: Array) -> Array:
        """Return ½ ∇n² at points, (n, 3) mm⁻¹."""
        return self._fields_at(self.numbers.value, points)[:, 1:]

    def ends(self, points: Array, momenta: Array, lengths: Array, steps: int) -> Array:
        """Return positions and optical ray vectors after given lengths in σ, (n, 6).

        Parameters
        ----------
        points, momenta : (n, 3) float64
            Where rays enter, mm, and T there.
        lengths : (n,) float64, mm
        steps : int
        """
        return self._ends(self.numbers.value, np.hstack([points, momenta]), lengths, steps)

    def steps_for(self, points: Array, momenta: Array, lengths: Array) -> int:
        """Return a sufficient number of steps.

        Parameters
        ----------
        points, momenta, lengths
            As for `ends`.
        """
        steps, ends = FEWEST_STEPS, self.ends(points, momenta, lengths, FEWEST_STEPS)
        while steps < MOST_STEPS:
            finer = self.ends(points, momenta, lengths, 2 * steps)
            scale = np.nanmax(np.abs(lengths)) if np.isfinite(lengths).any() else 0.0
            known = np.isfinite(finer).all(axis=1) & np.isfinite(ends).all(axis=1)
            if not (np.abs(finer - ends)[known].max(initial=0.0) > PRECISION * scale):
                break
            steps, ends = 2 * steps, finer
        return steps

    def carried(self, points: Jet, momenta: Jet, lengths: Array, steps: int) -> tuple[Jet, Jet]:
        """Return positions and optical ray vectors after fixed lengths in σ, with their derivatives, (n, 3) each.

        Parameters
        ----------
        points, momenta : Jet
            (n, 3), as for `ends`.
        lengths : (n,) float64, mm
        steps : int
        """
        start = np.hstack([points.value, momenta.value])
        slopes = np.concatenate([points.slope, momenta.slope], axis=1)
        reach = float(np.max(np.abs(lengths), initial=0.0, where=np.isfinite(lengths))) or 1.0
        of_numbers = set(_of_numbers(self.numbers))
        slope = np.zeros_like(slopes)
        for variable in range(slopes.shape[-1]):
            along, of_number = slopes[:, :, variable], self.numbers.slope[:, :, variable]
            relative = np.abs(along) / np.array([reach] * 3 + [1.0] * 3)
            size = float(np.max(relative, initial=float(variable in of_numbers), where=np.isfinite(relative)))
            if not size > 0.0:
                continue

            def end(move: float, along: Array = along, of_number: Array = of_number) -> Array:
                return self._ends(self.numbers.value + move * of_number, start + move * along, lengths, steps)

            slope[:, :, variable] = _derivative(end, DIFFERENCE / size)
        ends = self._ends(self.numbers.value, start, lengths, steps)
        return Jet(ends[:, :3], slope[:, :3]), Jet(ends[:, 3:], slope[:, 3:])

    def _ends(self, numbers: Array, start: Array, lengths: Array, steps: int) -> Array:
        ends = np.ascontiguousarray(start)
        ends = ends.copy() if ends is start else ends
        _advance(self.form.table(numbers), np.ascontiguousarray(self.wave), ends, np.ascontiguousarray(lengths), steps)
        return ends

    def _fields_at(self, numbers: Array, points: Array) -> Array:
        fields = np.empty((len(points), 4))
        _fill_fields(self.form.table(numbers), np.ascontiguousarray(self.wave), np.ascontiguousarray(points), fields)
        return fields


def _derivative(function: Callable[[float], Array], step: float) -> Array:
    """Return the derivative of a function at 0 by differences of order 4."""
    near, far = function(step) - function(-step), function(2.0 * step) - function(-2.0 * step)
    return np.asarray((8.0 * near - far) / (12.0 * step))


def _of_numbers(numbers: Jet) -> list[int]:
    """Return the variables that change numbers of the glass."""
    return np.flatnonzero(numbers.slope.any(axis=(0, 1))).tolist()


@kernel
def _advance(gradients: Gradients, wave: Whole, rays: Array, lengths: Array, steps: int) -> None:
    """Move rays, rows of position and optical ray vector, by lengths in σ."""
    for i in range(len(rays)):
        ray = GradientRay(
            rays[i, 0], rays[i, 1], rays[i, 2], rays[i, 3], rays[i, 4], rays[i, 5], 0.0, 0.0
        )  # fmt: skip
        end = advance(gradients, wave[i], ray, lengths[i] / steps, steps)
        rays[i, 0], rays[i, 1], rays[i, 2] = end.x, end.y, end.z
        rays[i, 3], rays[i, 4], rays[i, 5] = end.tx, end.ty, end.tz


@kernel
def _fill_fields(gradients: Gradients, wave: Whole, points: Array, fields: Array) -> None:
    """Find n² and ½ ∇n² at points, each of its own wavelength."""
    for i in range(len(points)):
        n2, by_x, by_y, by_z = field_at(gradients, wave[i], points[i, 0], points[i, 1], points[i, 2])
        fields[i, 0], fields[i, 1], fields[i, 2], fields[i, 3] = n2, by_x, by_y, by_z
