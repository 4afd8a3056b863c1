"""Coherent point spread: irradiance on the sensor from one point, through lens, lenslets and cover.

The lens is traced (`pupil_waves`). Its plane waves propagate to the microlens array, through the relief of all lenslets
at once and on to the sensor (`angular_spectrum`). The grid is refined and widened until the picture is stable.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import DiffractionWarning, LfmeshError, PictureWarning, warn_caller
from lfmesh.geometry.lens.main_order import left_out, phases_of
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.notebook import Pictured, watched
from lfmesh.scene import Scene
from lfmesh.scene.literals import percent
from lfmesh.transport.render.progress import Progress
from lfmesh.waves.angular_spectrum import Grid, Irradiance, Sampling, Spectrum
from lfmesh.waves.camera_faces import WaveFace
from lfmesh.waves.extent import FINER, Extent
from lfmesh.waves.pupil_waves import PupilRays, PupilWaves, pupil_waves
from lfmesh.waves.refused import lines_of_band, no_light, numbers_of, refuse_values, shares_of
from lfmesh.waves.wave_camera import WaveCamera

Array = NDArray[np.float64]

TOLERANCE = 3e-3
"""Default of the change of the picture, over its power, at which grids are fine enough."""

BEYOND = 0.005
"""Fraction of light beyond a grid's directions that causes a warning."""


@dataclass(frozen=True, eq=False)
class PointSpread(Pictured):
    """The point spread of one point on the sensor.

    Attributes
    ----------
    mean : (rows, columns) float64, W
        Power on each pixel, or part of one, per W/sr of an isotropic point. Columns run along +x, rows along +y of the
        sensor. 0 outside the computed light.
    x_mm : (columns,) float64
        Centre of each column, sensor frame.
    y_mm : (rows,) float64
    step_mm : float
        Between columns, and between rows.
    point_mm : (3,) float64
        Camera frame.
    wavelengths_nm, weights : tuple of float
        Of the sum; weights add up to 1.
    oversample : int
        Parts along each side of a pixel.
    entered_w : float
        Power behind the lens.
    power_w : float
        Power on the sensor's plane, pixels or not. Diffraction tails beyond the grid at the focus are missing and not
        part of `beyond`: 0.5 to 1 % of `entered_w` for a perfect lens without an array.
    peak_w_mm2 : float
        Largest irradiance, at the wavelength with the largest weight.
    strehl : float or None
        Peak over the peak of light in phase; None with a microlens array.
    airy_radius_mm : float
        Of the first dark ring at the wavelength with the largest weight: 0.61 λ / sin u by the rays behind the lens or,
        behind an array, λ / sin u by pitch and focal length of a lenslet.
    lenslets : int
        Number of lenslets that the rays meet; 0 without an array.
    change : float
        With the last refinement of the grid: sum of absolute differences of the picture, over its power.
    beyond : float
        Fraction of light missing because steps and rims of lenslets send it outside the grid's directions. The picture
        is wrong by about as much.
    misfit_waves : float
        Largest error of the polynomials fitted to the wavefront.
    """

    mean: Array
    x_mm: Array
    y_mm: Array
    step_mm: float
    point_mm: tuple[float, float, float]
    wavelengths_nm: tuple[float, ...]
    weights: tuple[float, ...]
    oversample: int
    entered_w: float
    power_w: float
    peak_w_mm2: float
    strehl: float | None
    airy_radius_mm: float
    lenslets: int
    change: float
    beyond: float
    misfit_waves: float

    def __repr__(self) -> str:
        rows, columns = self.mean.shape
        nm = ", ".join(f"{each:g}" for each in self.wavelengths_nm)
        return f"<PointSpread: {columns} × {rows} at {nm} nm, {self.power_w:.4g} W, change {self.change:.1g}>"

    @property
    def irradiance_w_mm2(self) -> Array:
        """(rows, columns) W/mm²: mean over each pixel, or part of one."""
        return self.mean / self.step_mm**2

    def lines(self) -> list[str]:
        """Return the key figures in words.

        Returns
        -------
        list of str
        """
        pixel_mm = self.step_mm * self.oversample
        lit = f"{self.lenslets} lenslet{'' if self.lenslets == 1 else 's'} lit, "
        peak = f"Strehl ratio {self.strehl:.4g}, " if self.strehl is not None else lit
        part = "pixel" if self.oversample == 1 else f"1/{self.oversample} × 1/{self.oversample} of a pixel"
        of = f" at {self.wavelengths_nm[int(np.argmax(self.weights))]:g} nm" if len(self.wavelengths_nm) > 1 else ""
        return [
            f"{peak}peak {self.peak_w_mm2:.4g} W/mm² per W/sr{of}",
            f"Airy radius {1e3 * self.airy_radius_mm:.4g} µm, {self.airy_radius_mm / pixel_mm:.3g} pixels",
            f"{100.0 * self.brightest_share:.3g} % of the light on the brightest {part}; last change "
            f"{percent(self.change)}, {percent(self.beyond)} beyond the grid",
        ]

    def facts(self) -> dict[str, object]:
        """Return all but the picture, by name.

        Returns
        -------
        dict
        """
        named = {
            name: getattr(self, name) for name in self.__dataclass_fields__ if name not in ("mean", "x_mm", "y_mm")
        }
        return named | {"first_x_mm": float(self.x_mm[0]), "first_y_mm": float(self.y_mm[0])}

    @property
    def brightest_share(self) -> float:
        """Fraction of the power that falls on the brightest pixel, or part of one."""
        return float(self.mean.max()) / self.power_w


def point_spread(
    scene: Scene, point_mm: ArrayLike, wavelengths_nm: float | Sequence[float] | str | None = None, *,
    weights: Sequence[float] | None = None, window: int | None = None, oversample: int = 1,
    tolerance: float = TOLERANCE, progress: Callable[[Progress], None] | bool = False,
) -> PointSpread:  # fmt: skip
    """Compute the irradiance on the sensor from an isotropic point of 1 W/sr, with diffraction and interference.

    A diffractive face with several orders sends the light of its main order alone.

    Parameters
    ----------
    scene : Scene
        Its camera is used. Lights are ignored; targets too, but they must not hide the point.
    point_mm : (3,) float
        x, y and z in the camera frame; z below 0.
    wavelengths_nm : float or sequence of float, optional
        Irradiances of several are summed. The name of a sensor band selects its traced wavelengths, weighted by its
        response. Default: the scene's primary wavelength.
    weights : sequence of float, optional
        Weights of the wavelengths, scaled to add up to 1 (default: equal).
    window : int, optional
        Pixels per side of a square around the light (default: the whole sensor).
    oversample : int
        Parts along each side of a pixel, from 1 to 64.
    tolerance : float
        Largest change of the picture, over its power, with the last refinement of the grid.
    progress : callable or bool, optional
        Called with the progress within each grid; True shows a bar (default: nothing).

    Returns
    -------
    PointSpread

    Warns
    -----
    DiffractionWarning
        Steps or rims of lenslets send light beyond the grid's directions, and the picture is wrong by 0.5 % of the
        light or more; or a diffractive face has several orders, and the light of all but the main one is missing.

    Raises
    ------
    LfmeshError
        An unsupported camera or scene (meshes, rough faces, tilted arrays and sensors, media, bodies of glass,
        polarisers), a point hidden by a target or without light on the sensor, a spread too large, or a value out of
        range.
    """
    with watched(progress) as report:
        asked = Asked(window, oversample, tolerance)
        camera = WaveCamera.of(scene, main_orders=True)
        found = followed(camera, point_mm, wavelengths_nm, weights, asked, report)
    warn_caller([*left_out(phases_of(solved_camera(scene).scene)), *warnings_of(found.beyond)])
    return found


def warnings_of(beyond: float) -> list[PictureWarning]:
    """Return a warning if much light went beyond the directions of a grid.

    Parameters
    ----------
    beyond : float
        Fraction of the light.
    """
    if beyond <= BEYOND:
        return []
    return [
        DiffractionWarning(
            f"steps and rims of lenslets send {beyond:.1%} of the light outside the directions of the wave grid, so "
            "the point spread is off by about as much; give a smaller tolerance for a finer grid"
        )
    ]


class Asked(NamedTuple):
    """Settings of a point spread.

    Attributes
    ----------
    window, oversample, tolerance
        As for `point_spread`.
    of_all : bool
        Compare changes with all light on the sensor's plane, pixels or not.
    """

    window: int | None = None
    oversample: int = 1
    tolerance: float = TOLERANCE
    of_all: bool = False


ALL_PIXELS = Asked()


def followed(
    camera: WaveCamera, point_mm: ArrayLike, wavelengths_nm: float | Sequence[float] | str | None = None,
    weights: Sequence[float] | None = None, asked: Asked = ALL_PIXELS,
    report: Callable[[Progress], None] | None = None,
) -> PointSpread:  # fmt: skip
    """Return the result of `point_spread`, without its warnings.

    Parameters
    ----------
    camera : WaveCamera
        Of the scene.
    point_mm, wavelengths_nm, weights
        As for `point_spread`.
    asked : Asked
    report : callable, optional
        Called with the progress.

    Raises
    ------
    LfmeshError
        As from `point_spread`.
    """
    scene, point = camera.scene, numbers_of("point_mm", point_mm)
    if isinstance(wavelengths_nm, str):
        if weights is not None:
            raise LfmeshError(f'wavelengths_nm = "{wavelengths_nm}": a band has weights of its own; omit weights')
        wavelengths_nm, weights = lines_of_band(scene, wavelengths_nm)
    nm = tuple(numbers_of("wavelengths_nm", scene.primary_nm if wavelengths_nm is None else wavelengths_nm).tolist())
    shares = shares_of(nm, numbers_of("weights", [1.0] * len(nm) if weights is None else weights).tolist())
    refuse_values(scene, point, asked.window, asked.oversample, asked.tolerance)
    each = [one.converged(asked, report) for one in _monochromes(camera, point, nm, asked)]
    mean = np.asarray(sum(share * one.mean for share, one in zip(shares, each, strict=True)))
    if not np.any(mean > 0.0):
        raise no_light(point)
    # Figures of a single wavelength are those at the largest weight.
    return replace(
        each[int(np.argmax(shares))],
        mean=mean,
        wavelengths_nm=nm,
        weights=shares,
        entered_w=sum(share * one.entered_w for share, one in zip(shares, each, strict=True)),
        power_w=sum(share * one.power_w for share, one in zip(shares, each, strict=True)),
        change=max(one.change for one in each),
        beyond=max(one.beyond for one in each),
        misfit_waves=max(one.misfit_waves for one in each),
    )


def _monochromes(
    camera: WaveCamera, point: Array, wavelengths_nm: tuple[float, ...], asked: Asked
) -> "list[Monochrome]":
    """Prepare the point spread at each wavelength."""
    middle = len(wavelengths_nm) // 2
    if camera.scene.targets:
        camera.refuse_hidden(point, camera.looked_at(point, wavelengths_nm[middle]), wavelengths_nm[middle])
    pupils = [pupil_waves(camera.world, camera.camera, point, wavelength) for wavelength in wavelengths_nm]
    pixels = pixels_of(camera, pupils[middle], asked)
    found = [
        Monochrome(camera, point, wavelength, pupil, pixels)
        for wavelength, pupil in zip(wavelengths_nm, pupils, strict=True)
    ]
    if all(one.extent.misses for one in found):
        raise no_light(point)
    return found


class Arrived(NamedTuple):
    """Light of a point at the sensor.

    Attributes
    ----------
    in_phase : float
        Sum of the amplitudes of the plane waves behind the lens, √W, as if in phase.
    behind_lens_w : float
        Power of these waves, corrected for the pupil's distance from the focus.
    light : Spectrum
        Across the plane of the sensor.
    """

    in_phase: float
    behind_lens_w: float
    light: Spectrum


class Monochrome:
    """The point spread at one wavelength, on grids of any fineness."""

    def __init__(
        self, camera: WaveCamera, point: Array, wavelength_nm: float, pupil: PupilWaves, pixels: Sampling
    ) -> None:
        self.camera, self.point, self.wavelength_nm = camera, point, wavelength_nm
        self.pupil, self.pixels = pupil, pixels
        self.faces, self.sensor = camera.faces(wavelength_nm), camera.sensor_mm
        self.extent = Extent.of(camera, wavelength_nm, pupil)
        self.words = f"point_mm = {point.tolist()}"

    @property
    def _beyond_focus(self) -> float:
        """Apparent path along the middle ray from the focus to the sensor, mm, seen from the medium behind the lens."""
        ends, outside = [*(face.z_mm for face in self.faces), float(self.sensor[2])], self.pupil.index
        starts, indices = [float(self.pupil.focus_mm[2]), *ends[:-1]], [outside, *(face.index for face in self.faces)]
        way = sum((b - a) / (index / outside) for a, b, index in zip(starts, ends, indices, strict=True))
        ahead = self.pupil.middle / outside
        return way / math.sqrt(1.0 - float(ahead @ ahead))

    def converged(self, asked: Asked, report: Callable[[Progress], None] | None) -> PointSpread:
        """Return the point spread on the first grid with a change below the tolerance.

        Parameters
        ----------
        asked : Asked
        report : callable, optional

        Raises
        ------
        LfmeshError
            No grid is fine enough.
        """
        self.extent.refuse_wide(self.words)
        first, change, fineness = self._on_grid(self.extent.grid(1.0, self.words), report), math.inf, 1.0
        while change > asked.tolerance:
            fineness *= FINER
            if not self.extent.fits(fineness):
                self._refuse_unsettled(first, change, asked)
            finer = self._on_grid(self.extent.grid(fineness, self.words), report)
            light = finer.power_w if asked.of_all else float(finer.mean.sum())
            change = float(np.abs(finer.mean - first.mean).sum()) / max(light, 1e-300)
            first = finer
        return replace(first, change=change)

    def _refuse_unsettled(self, last: PointSpread, change: float, asked: Asked) -> None:
        """Refuse a picture that still changes on the finest grids, or has no light on the pixels."""
        share = float(last.mean.sum()) / last.entered_w
        if share < asked.tolerance:
            raise no_light(self.point)
        changed = f"still changes by {change:.2g} of its light on the finest possible grid"
        if asked.of_all:
            raise LfmeshError(
                f"the picture of {self.words} {changed}, above {asked.tolerance:g}; give a point nearer the "
                "plane in focus, or a smaller stop"
            )
        # Rounded up, so that the suggested tolerance is reached.
        digits = 1 - math.floor(math.log10(change))
        reached = math.ceil(change * 10.0**digits) / 10.0**digits
        more = f"give a tolerance of {reached:g} or more" if reached < 1.0 else "give a wider window"
        raise LfmeshError(f"tolerance = {asked.tolerance:g}: the picture of {self.words} {changed}; {more}")

    def at_sensor(self, grid: Grid, report: Callable[[Progress], None] | None = None) -> Arrived:
        """Return the light on the sensor's plane, computed on one grid.

        Parameters
        ----------
        grid : Grid
        report : callable, optional
            Called with the progress.
        """
        began, stage = time.perf_counter(), f"waves of {self.wavelength_nm:g} nm on {grid.n} × {grid.n} places"

        def told(relief: int, share: float) -> None:
            if report is not None:
                percent = round(100.0 * (relief + share) / max(1, len(self.extent.relief)))
                report(Progress(percent, 100, time.perf_counter() - began, 0, 0, stage))

        told(0, 0.0)
        behind, in_phase = _behind_lens(self.pupil, grid)
        light = behind
        reliefs = 0
        for before, face in zip([None, *self.faces], self.faces, strict=False):
            light = _travelled(light, face.z_mm, before)
            light = face.passed(light, self.camera.scene, partial(told, reliefs))
            reliefs += face.lenslets is not None
        light = _travelled(light, float(self.sensor[2]), self.faces[-1] if self.faces else None)
        light = replace(light, waves=light.waves * math.sqrt(1.0 - self.camera.scene.camera.sensor.reflectance))
        return Arrived(in_phase, behind.power_w, light)

    def _on_grid(self, grid: Grid, report: Callable[[Progress], None] | None) -> PointSpread:
        """Return the point spread on one grid, with an unknown change."""
        amplitudes, behind_lens, light = self.at_sensor(grid, report)
        irradiance = Irradiance.of(light)
        # Peak of the pupil's amplitudes in phase, less the loss behind the lens, scaled to the sensor's distance.
        in_phase = (amplitudes / (grid.n * grid.step_mm)) ** 2 * light.power_w / behind_lens
        in_phase /= (1.0 + self._beyond_focus / self.pupil.radius_mm) ** 2
        peak = irradiance.peak()
        pixels, point = self.pixels, self.point
        x, y = (pixels.first_mm[axis] + pixels.step_mm * np.arange(pixels.size[axis]) for axis in (0, 1))
        parts = round(self.camera.scene.camera.sensor.pixel_mm / pixels.step_mm)
        mean = np.zeros(pixels.size[::-1])
        irradiance.add_to(mean, pixels, self.sensor)
        return PointSpread(
            mean, x, y, pixels.step_mm, (float(point[0]), float(point[1]), float(point[2])),
            (self.wavelength_nm,), (1.0,), parts, self.pupil.power_w, light.power_w, peak,
            None if self.extent.relief else peak / in_phase, self._airy_radius(), self._lenslets(), math.inf,
            max(0.0, light.beyond_w) / light.power_w if light.power_w else 0.0, self.pupil.misfit_waves,
        )  # fmt: skip

    def _airy_radius(self) -> float:
        report, wavelength_nm = self.camera.camera.report, 1e6 * self.pupil.wavelength_mm
        if report.microlens_airy_disk_px is None:
            return 0.61 * self.pupil.wavelength_mm / float(self.pupil.half.min())
        disk_mm = report.microlens_airy_disk_px * self.camera.scene.camera.sensor.pixel_mm
        return 0.5 * disk_mm * wavelength_nm / report.airy_wavelength_nm

    def _lenslets(self) -> int:
        return max((face.met_by(self.pupil.places_at(face.z_mm)) for face in self.extent.relief), default=0)


def _behind_lens(pupil: PupilWaves, grid: Grid) -> tuple[Spectrum, float]:
    """Return the light in the plane of the focus, and the sum of its amplitudes, √W, as if in phase."""
    px, py = grid.directions
    waves, shares = pupil.at(np.fft.fftshift(px), np.fft.fftshift(py))
    light = Spectrum(grid, np.fft.ifftshift(waves * shares), pupil.focus_mm, pupil.index)
    # Averaging over cells reduces the light far from the focus by this factor.
    taken = np.sinc(grid.places / (grid.n * grid.step_mm))
    seen = light.field * np.exp(2j * np.pi * pupil.rim_phase(grid.places, grid.places)) / np.outer(taken, taken)
    return replace(light, waves=scipy.fft.fft2(seen, norm="ortho")), float(np.abs(waves).sum())


def _travelled(light: Spectrum, z_mm: float, behind: WaveFace | None) -> Spectrum:
    """Return the light across another plane of the medium behind a face, less the medium's absorption."""
    way = z_mm - float(light.at_mm[2])
    light = light.travelled(z_mm)
    if behind is None or behind.absorption_per_mm == 0.0:
        return light
    return replace(light, waves=light.waves * math.exp(-0.5 * behind.absorption_per_mm * way))


def pixels_of(camera: WaveCamera, pupil: PupilRays | None = None, asked: Asked = ALL_PIXELS) -> Sampling:
    """Return all pixels, or a window around the light, or their parts, in the sensor's frame.

    Parameters
    ----------
    camera : WaveCamera
    pupil : PupilRays, optional
        The light; needed for a window.
    asked : Asked
    """
    sensor = camera.scene.camera.sensor
    window, oversample = asked.window, asked.oversample
    count, first = list(sensor.pixels), [0, 0]
    if window is not None and pupil is not None:
        place = camera.sensor_mm
        light = pupil.places_at(float(place[2])).mean(axis=0) - place[:2]
        for axis in (0, 1):
            size = min(window, count[axis])
            middle = light[axis] / sensor.pixel_mm + 0.5 * count[axis]
            first[axis] = int(np.clip(round(middle - 0.5 * size), 0, count[axis] - size))
            count[axis] = size
    step = sensor.pixel_mm / oversample
    # Corner of the first part of the first pixel.
    corner = [(number - 0.5 * whole) * sensor.pixel_mm for number, whole in zip(first, sensor.pixels, strict=True)]
    return Sampling(np.asarray(corner) + 0.5 * step, step, (count[0] * oversample, count[1] * oversample))
