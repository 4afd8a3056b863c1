"""Point spreads of aberrated lenses, against a sum over the pupil function in the test: peak, MTF, Maréchal's law.

The pupil function comes from the path differences of `lf.wavefront`, and from where rays of `lf.trace` cross the
reference sphere. It is summed by force, so that grids, polynomials and the lens's own focus play no part.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.waves.pupil_waves import pupil_rays
from lfmesh.waves.wave_camera import WaveCamera

Array = NDArray[np.float64]

WAVE_NM, WAVE = 550.0, 0.55e-3
FAR = 1e5
RADIUS, THICK = 25.0, 2.0
FOCUS = 50.025
"""From the last vertex, of the far point."""
PERFECT = -2.25
"""Conic constant of a curved face of index 1.5 that has no spherical aberration."""
ACROSS = 200
"""Rays on a diameter of the pupil: the rim is then cut to 3·10⁻⁴ of the area."""


class Case(NamedTuple):
    """A plano-convex lens whose flat face is the stop, and the point that it sees."""

    stop_mm: float
    conic: float
    sensor_mm: float
    height_mm: float


DEFOCUS = Case(2.0, PERFECT, FOCUS - 0.344, 0.0)
COMA = Case(2.5, PERFECT, FOCUS, 1500.0)
SPHERICAL = Case(2.4, 0.0, FOCUS, 0.0)


def scene(case: Case) -> lf.Scene:
    wide = 1.3 * case.stop_mm
    flat = {"radius_mm": math.inf, "thickness_mm": THICK, "index": 1.5, "semi_diameter_mm": wide, "stop": True}
    curved = {"radius_mm": -RADIUS, "conic": case.conic, "semi_diameter_mm": wide}
    lens = {"surfaces": [flat, curved], "stop_semi_diameter_mm": case.stop_mm}
    pixel = 0.45 * WAVE * FOCUS / (2.0 * case.stop_mm)
    sensor = {"pixels": [1001, 1001], "pixel_mm": pixel, "distance_mm": case.sensor_mm}
    return lf.Scene.model_validate({"schema_version": 1, "camera": {"lens": lens, "sensor": sensor}})


def wavefront(case: Case, across: int = ACROSS) -> lf.Wavefront:
    image_z = THICK + case.sensor_mm
    return lf.wavefront(scene(case), case.height_mm, WAVE_NM, object_mm=FAR, image_z_mm=image_z, across=across)


def spread(case: Case) -> lf.PointSpread:
    return lf.point_spread(scene(case), (0.0, case.height_mm, -FAR), WAVE_NM, window=41)


def differences(values: Array, axis: int) -> Array:
    """Return differences between neighbours, one-sided at the edge of what is finite."""
    ahead = np.roll(values, -1, axis) - values
    both = 0.5 * (ahead + np.roll(ahead, 1, axis))
    one = np.where(np.isnan(ahead), np.roll(ahead, 1, axis), ahead)
    return np.where(np.isnan(both), one, both)


def pupil_function(case: Case, found: lf.Wavefront) -> tuple[Array, NDArray[np.complex128]]:
    """Return where the image point sees the rays cross the reference sphere (n, 2), and the amplitude of each (n,)."""
    aim = np.column_stack([found.pupil * case.stop_mm, np.zeros(len(found.pupil))])
    ahead = aim - [0.0, case.height_mm, -FAR]
    start = aim - 1e-4 * ahead
    rays = lf.trace(lf.build(scene(case)), start, ahead, WAVE_NM, split="transmit", engine="sequential", threads=1)
    off = rays.position - found.image_mm
    along = (off * rays.direction).sum(axis=1)
    back = -along - np.sqrt(along**2 - (off**2).sum(axis=1) + found.radius_mm**2)
    seen = -(off + back[:, None] * rays.direction)[:, :2] / found.radius_mm
    # A border of one cell has no rays.
    cell = np.round(0.5 * ((found.pupil + 1.0) * ACROSS + 1.0)).astype(int)
    grid = np.full((2, ACROSS + 2, ACROSS + 2), np.nan)
    grid[:, cell[:, 1], cell[:, 0]] = seen.T
    (xx, xy), (yx, yy) = ([differences(each, axis) for axis in (1, 0)] for each in grid)
    area = np.abs(xx * yy - xy * yx)[cell[:, 1], cell[:, 0]]
    area = np.where(np.isfinite(area), area, np.nanmean(area))
    return seen, np.sqrt(found.weight * area) * np.exp(-2j * np.pi * found.opd_waves)


def irradiance(seen: Array, amplitude: NDArray[np.complex128], x: Array, y: Array) -> Array:
    """Return that at places from the image point (rows, columns), over that of the pupil in phase."""
    waves_x, waves_y = (np.exp(2j * np.pi / WAVE * np.outer(each, seen[:, i])) for i, each in enumerate((x, y)))
    return np.asarray(np.abs((waves_y * amplitude) @ waves_x.T) ** 2 / np.abs(amplitude).sum() ** 2)


def contrast(power: Array, at: Array, frequency: Array, axis: int) -> Array:
    line = power.sum(axis=axis)
    return np.abs(np.exp(-2j * np.pi * np.outer(frequency, at)) @ line) / line.sum()


@pytest.mark.parametrize("case", [DEFOCUS, COMA, SPHERICAL], ids=["defocus", "coma", "spherical"])
def test_peak_and_contrast_of_an_aberrated_lens_are_those_of_its_pupil_function(case: Case) -> None:
    """Half a wave of each, within 10⁻³; contrast in both directions, from 0.05 to 0.95 of the highest frequency."""
    known, found = wavefront(case), spread(case)
    assert known.pv_waves == pytest.approx(0.5, abs=0.05)
    seen, amplitude = pupil_function(case, known)
    x, y = found.x_mm - known.image_mm[0], found.y_mm - known.image_mm[1]
    truth = irradiance(seen, amplitude, x, y)
    row, column = np.unravel_index(truth.argmax(), truth.shape)
    step = x[1] - x[0]
    near = np.linspace(-step, step, 33)
    peak = irradiance(seen, amplitude, x[column] + near, y[row] + near).max()
    assert found.strehl == pytest.approx(peak, abs=1e-3)
    frequency = np.linspace(0.05, 0.95, 10) * 2.0 * case.stop_mm / FOCUS / WAVE
    for axis, at in ((0, x), (1, y)):
        wanted = contrast(truth, at, frequency, axis)
        # The truth is at the middles of pixels, the spread is the mean over them.
        made = contrast(found.mean, at, frequency, axis) / np.sinc(frequency * step)
        np.testing.assert_allclose(made, wanted, rtol=0, atol=1e-3)


@pytest.mark.parametrize(
    "case",
    [
        DEFOCUS._replace(sensor_mm=FOCUS - 0.1),
        DEFOCUS._replace(sensor_mm=FOCUS + 0.15),
        SPHERICAL._replace(sensor_mm=FOCUS - 0.25),
    ],
)
def test_strehls_ratio_from_0_8_on_is_marechals(case: Case) -> None:
    """exp(−(2π σ)²) with the deviation σ of the wavefront, within 0.01."""
    found = spread(case).strehl
    assert found is not None
    assert 0.8 < found < 0.95
    assert found == pytest.approx(math.exp(-((2.0 * math.pi * wavefront(case, 64).rms_waves) ** 2)), abs=0.01)


def test_two_rays_that_pass_are_too_few_and_no_collimated_light() -> None:
    """Of a point at the edge of the field, of whose rays the lens stops nearly all."""
    scene = lf.load(Path(__file__).parents[2] / "assets" / "scenes" / "conventional.toml").changed({"targets": []})
    camera = WaveCamera.of(scene)
    bundle = camera.looked_at(np.array([0.0, 0.0, -500.0]), WAVE_NM)
    weight = bundle.weight.copy()
    weight[2:] = 0.0
    with pytest.raises(lf.LfmeshError, match="only 2 of 273 rays of this point pass the lens"):
        pupil_rays(bundle._replace(weight=weight), camera.camera, float(camera.sensor_mm[2]), WAVE_NM)
