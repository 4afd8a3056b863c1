"""Ray figures with their derivatives: spots, MTF, distortion, lateral colour."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lfmesh.analysis.analysis import FIELDS, wavelengths_of
from lfmesh.errors import LfmeshError
from lfmesh.scene import Scene
from lfmesh.study.optimise.design_file import Goal, Rays
from lfmesh.study.optimise.jet import Jet
from lfmesh.study.optimise.lens_numbers import RayLayout, layout_of
from lfmesh.study.optimise.ray_derivatives import Landed, RayFan, land
from lfmesh.transport.build import build
from lfmesh.waves.bundle import LensRays, pupil_grid

Array = NDArray[np.float64]
Whole = NDArray[np.int64]


HALF = 0.5
"""Fraction of a field's rays below which a note says that the camera blocks most of them."""


@dataclass
class RayFigures:
    """Rays of a design: those that pass the initial camera.

    Attributes
    ----------
    layout : RayLayout
    fan : RayFan
        Chief rays of each field and wavelength, followed by all others.
    guess : (n, 2) float64
        Intersections of the last camera's rays with the plane of the first vertex, mm.
    shares : dict of float
        Fraction of a field's rays that pass initially, by image height, mm.
    """

    layout: RayLayout
    fan: RayFan
    guess: Array
    shares: dict[float, float]
    _start: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._start = self.guess

    @property
    def passed(self) -> int:
        """Number of rays without chief rays."""
        return len(self.fan.field) - self._chiefs

    @property
    def stopped(self) -> str:
        """Fields that initially pass less than half of their rays, in words, or ""."""
        few = [f"{100.0 * share:.0f} % at {height:.4g} mm" for height, share in self.shares.items() if share < HALF]
        return ", ".join(few)

    @property
    def _chiefs(self) -> int:
        return len(self.layout.fields) * len(self.layout.waves_nm)

    def landed(self, numbers: Jet) -> Landed:
        """Trace the rays through a lens; NaN for rays without a path.

        Parameters
        ----------
        numbers : Jet
            From `RayLayout.numbers_of`.
        """
        landed = land(self.layout, numbers, self.fan, self.guess)
        fine = np.isfinite(landed.entry).all() and np.isfinite(landed.x.value).all()
        if not fine and self.guess is not self._start:
            landed = land(self.layout, numbers, self.fan, self._start)
            fine = np.isfinite(landed.entry).all() and np.isfinite(landed.x.value).all()
        if fine:
            self.guess = landed.entry
        return landed

    def values(self, goal: Goal, landed: Landed, numbers: Jet) -> Jet:
        """Return the values of a figure, (k,), with their derivatives.

        If reports show their rms, it is the root of the sum of their squares.

        Parameters
        ----------
        goal : Goal
            A ray figure.
        landed : Landed
        numbers : Jet
            Numbers of the lens.
        """
        shares = FIELDS if goal.field is None else (goal.field,)
        fields = [self.layout.fields.index(share) for share in shares]
        if goal.metric == "mtf":
            return _joined([mtf for each in fields for mtf in self._mtf(landed, each, goal.per_mm or 0.0)])
        if goal.metric == "distortion":
            found = self._distortion(landed, numbers, fields)
        elif goal.metric == "lateral_colour_mm":
            if not self._others:
                raise LfmeshError("lateral_colour_mm: there is one wavelength; name more by wavelengths_nm in [rays]")
            found = [self._chief(landed, f, w)[1] - self._chief(landed, f)[1] for f in fields for w in self._others]
        else:
            about_chief = goal.metric == "spot_chief_rms_mm"
            spots = [self._spot(landed, each, about_chief=about_chief) for each in fields]
            return _joined([part for spot in spots for part in spot]) * (1.0 / math.sqrt(len(fields)))
        return _joined(found) * (1.0 / math.sqrt(len(found)))

    @property
    def _primary(self) -> int:
        return len(self.layout.waves_nm) // 2

    @property
    def _others(self) -> list[int]:
        return [wave for wave in range(len(self.layout.waves_nm)) if wave != self._primary]

    def _rows(self, number: int) -> Whole:
        rows = np.flatnonzero(self.fan.field == number)
        return rows[rows >= self._chiefs]

    def _chief(self, landed: Landed, number: int, wave: int | None = None) -> tuple[Jet, Jet]:
        row = number * len(self.layout.waves_nm) + (self._primary if wave is None else wave)
        return landed.x.picked(slice(row, row + 1)), landed.y.picked(slice(row, row + 1))

    def _spot(self, landed: Landed, number: int, *, about_chief: bool) -> list[Jet]:
        """Return the deviations of a field's rays along x and y, divided by the root of their number."""
        rows = self._rows(number)
        at = [landed.x.picked(rows), landed.y.picked(rows)]
        middle = self._chief(landed, number) if about_chief else tuple(map(_mean, at))
        return [(each - of) * (1.0 / math.sqrt(len(rows))) for each, of in zip(at, middle, strict=True)]

    def _mtf(self, landed: Landed, number: int, per_mm: float) -> list[Jet]:
        """Return the tangential and sagittal MTF of a field."""
        rows = self._rows(number)
        return [_modulus(along.picked(rows), per_mm) for along in (landed.y, landed.x)]

    def _distortion(self, landed: Landed, numbers: Jet, fields: list[int]) -> list[Jet]:
        heights = self.layout.opened(numbers).heights
        off_axis = [each for each in fields if self.layout.fields[each] > 0.0]
        return [self._chief(landed, each)[1] / heights.picked(slice(each, each + 1)) - 1.0 for each in off_axis]


def ray_figures_of(scene: Scene, rays: Rays, shares: tuple[float, ...]) -> RayFigures:
    """Choose the rays of a design.

    Parameters
    ----------
    scene : Scene
        Initial scene, solved.
    rays : Rays
    shares : tuple of float
        Fractions of the largest image height, in addition to the lens sheet's.

    Raises
    ------
    LfmeshError
        A surface has no formula or is not of revolution; there is no object plane; no ray of a field passes.
    """
    layout = layout_of(scene, wavelengths_of(scene, rays.wavelengths_nm), rays.object_mm, rays.height_mm)
    layout = RayLayout(**{**layout.__dict__, "fields": tuple(dict.fromkeys((*layout.fields, *shares)))})
    values = layout.numbers_of(scene)
    lens = layout.opened(Jet(values, np.zeros((len(values), 0))))
    vergence = float(lens.vergence.value)
    bench = LensRays(
        build(scene.camera_alone()), 1.0 / vergence if vergence else math.inf, float(lens.image_z.value)
    )  # fmt: skip
    grid = pupil_grid(rays.across)
    chiefs, others, through = [], [], {}
    for number, slope in enumerate(lens.slopes.value):
        passed = 0
        for wave, wavelength in enumerate(layout.waves_nm):
            bundle = bench.bundle(float(slope), np.vstack([[0.0, 0.0], grid]), wavelength)
            passes = bundle.passes & np.isfinite(bundle.entry).all(axis=1)
            passes[0] = False
            passed += int(passes.sum())
            chiefs.append(_rows_of(bundle.pupil[:1], bundle.entry[:1], number, wave))
            others.append(_rows_of(bundle.pupil[passes], bundle.entry[passes], number, wave))
        through[float(lens.heights.value[number])] = passed / (len(grid) * len(layout.waves_nm))
        if not passed:
            raise LfmeshError(
                f"no ray of the field at {lens.heights.value[number]:.4g} mm passes the lens; give a smaller height_mm "
                "in [rays]"
            )
    rows = np.vstack(chiefs + others)
    if not np.isfinite(rows).all():
        raise LfmeshError("the chief ray of a field does not reach the stop; give a smaller height_mm in [rays]")
    numbers = rows[:, 4:].astype(np.int64)
    return RayFigures(layout, RayFan(rows[:, :2], numbers[:, 0], numbers[:, 1]), rows[:, 2:4], through)


def _rows_of(pupil: Array, entry: Array, number: int, wave: int) -> Array:
    return np.column_stack([pupil, entry, np.full(len(pupil), number), np.full(len(pupil), wave)])


def _mean(of: Jet) -> Jet:
    return Jet(of.value.mean(keepdims=True), of.slope.mean(axis=0, keepdims=True))


def _joined(parts: list[Jet]) -> Jet:
    return Jet(np.concatenate([part.value for part in parts]), np.concatenate([part.slope for part in parts]))


def _modulus(along: Jet, per_mm: float) -> Jet:
    """Return the modulus of the Fourier transform of points along one direction, (1,)."""
    turn = -2j * np.pi * per_mm
    phase = np.exp(turn * along.value)
    mean = phase.mean()
    slope = (turn * phase) @ along.slope / len(phase)
    modulus = abs(mean)
    return Jet(np.array([modulus]), (np.conj(mean) * slope).real[None, :] / modulus)
