"""Another lens optimiser: its own ray tracer in numpy, differences in place of derivatives, scipy's least squares.

It shares no code with lfmesh but the indices of glasses. Lenses are centred conics in parallel light, which is cut
nowhere but at the stop.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from lfmesh.optics.glass import refractive_index

Array = NDArray[np.float64]


@dataclass
class OtherLens:
    """A lens: curvatures, conics and gaps, the last to the image plane; indices (waves, surfaces + 1); its stop."""

    curvatures: Array
    conics: Array
    gaps: Array
    indices: Array
    stop: int
    stop_radius: float

    @classmethod
    def of(cls, surfaces: Any, sensor_mm: float, waves_nm: tuple[float, ...]) -> "OtherLens":
        return cls(
            np.array([0.0 if math.isinf(s.radius_mm) else 1.0 / s.radius_mm for s in surfaces]),
            np.array([s.conic for s in surfaces]),
            np.array([*(s.thickness_mm for s in surfaces[:-1]), sensor_mm]),
            np.array([[1.0, *(refractive_index(s.medium, w) for s in surfaces)] for w in waves_nm]),
            next(i for i, s in enumerate(surfaces) if s.stop),
            next(s.semi_diameter_mm for s in surfaces if s.stop),
        )

    def paraxial(self, height: float, angle: float, last: int) -> tuple[float, float]:
        """Return height and angle of a paraxial ray, at the middle wavelength, before a surface or the image plane."""
        n = self.indices[len(self.indices) // 2]
        for k in range(last):
            angle = (n[k] * angle - (n[k + 1] - n[k]) * self.curvatures[k] * height) / n[k + 1]
            height += self.gaps[k] * angle
        return height, angle

    @property
    def efl(self) -> float:
        return -1.0 / self.paraxial(1.0, 0.0, len(self.gaps))[1]

    def slope(self, height: float) -> float:
        """Return the slope of the parallel light whose paraxial chief ray meets the image plane at a height."""
        a, b = (self.paraxial(*ray, self.stop)[0] for ray in ((1.0, 0.0), (0.0, 1.0)))
        return -height / self.paraxial(-b / a, 1.0, len(self.gaps))[0]

    def traced(self, entry: Array, slope: Array, wave: NDArray[np.int64], last: int) -> Array:
        """Return where rays meet a surface, or the image plane, (n, 2); slopes are those of object points."""
        ahead = np.column_stack([np.zeros(len(entry)), -slope, np.ones(len(entry))])
        d = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
        p = np.column_stack([entry, np.zeros(len(entry))])
        for k in range(last + 1):
            p = p - (p[:, 2] / d[:, 2])[:, None] * d
            if k == len(self.curvatures):
                break
            c, q = self.curvatures[k], 1.0 + self.conics[k]
            a = c * (d[:, 0] ** 2 + d[:, 1] ** 2 + q * d[:, 2] ** 2)
            b = c * (p[:, 0] * d[:, 0] + p[:, 1] * d[:, 1]) - d[:, 2]
            e = c * (p[:, 0] ** 2 + p[:, 1] ** 2)
            p = p + (e / (np.sqrt(b * b - a * e) - b))[:, None] * d
            if k == last:
                break
            normal = np.column_stack([-c * p[:, 0], -c * p[:, 1], 1.0 - c * q * p[:, 2]])
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            ratio = self.indices[wave, k] / self.indices[wave, k + 1]
            cosine = (normal * d).sum(axis=1)
            turned = np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2)) - ratio * cosine
            d = ratio[:, None] * d + turned[:, None] * normal
            p = p - [0.0, 0.0, self.gaps[k]]
        return p[:, :2]

    def spots(self, heights: Array, pupil: Array) -> Array:
        """Return the deviations of all rays from their field's centroid, over √(rays): (fields, waves · pupil, 2)."""
        waves = len(self.indices)
        slope = np.repeat([self.slope(h) for h in heights], waves * len(pupil))
        wave = np.tile(np.repeat(np.arange(waves), len(pupil)), len(heights))
        aim = np.tile(pupil * self.stop_radius, (len(heights) * waves, 1))
        a, b = (self.paraxial(*ray, self.stop)[0] for ray in ((1.0, 0.0), (0.0, 1.0)))
        entry = (aim + np.column_stack([0.0 * slope, b * slope])) / a
        for _ in range(12):
            at = self.traced(entry, slope, wave, self.stop)
            h = 1e-5
            right, up = (self.traced(entry + step, slope, wave, self.stop) - at for step in ([h, 0.0], [0.0, h]))
            if np.abs(at - aim).max() < 1e-11 * self.stop_radius:
                break
            entry = entry - np.linalg.solve(np.stack([right, up], axis=2) / h, (at - aim)[:, :, None])[:, :, 0]
        place = self.traced(entry, slope, wave, len(self.curvatures)).reshape(len(heights), -1, 2)
        return (place - place.mean(axis=1, keepdims=True)) / math.sqrt(place.shape[1] * len(heights))


@dataclass
class OtherProblem:
    """Variables: kind ("curvature" or "gap"), number, lowest, highest; a merit of spots and focal length."""

    lens: OtherLens
    variables: list[tuple[str, int, float, float]]
    heights: Array
    pupil: Array
    efl: float
    spot_weight: float
    efl_weight: float

    def lens_at(self, x: Array) -> OtherLens:
        found = OtherLens(**{key: np.copy(value) if key != "stop" else value for key, value in vars(self.lens).items()})
        for (kind, number, low, high), place in zip(self.variables, x, strict=True):
            (found.curvatures if kind == "curvature" else found.gaps)[number] = low + place * (high - low)
        return found

    def residuals(self, lens: OtherLens) -> Array:
        with np.errstate(all="ignore"):
            try:
                spots = lens.spots(self.heights, self.pupil).ravel()
            except np.linalg.LinAlgError:
                spots = np.full(2 * len(self.heights) * len(self.pupil) * len(lens.indices), np.nan)
        found = np.append(self.spot_weight * spots, self.efl_weight * (lens.efl - self.efl))
        return found if np.isfinite(found).all() else np.full(len(found), 1e3)

    def merit(self, lens: OtherLens) -> float:
        residuals = self.residuals(lens)
        return float(residuals @ residuals)

    def start(self) -> Array:
        values = [
            (self.lens.curvatures if kind == "curvature" else self.lens.gaps)[k] for kind, k, *_ in self.variables
        ]
        return np.array([(v - low) / (high - low) for v, (*_, low, high) in zip(values, self.variables, strict=True)])

    def best_of(self, starts: int, seed: int, spread: float = 0.2) -> float:
        """Return the best merit that searches from so many starts find, the first from the lens as it is."""
        rng, first = np.random.default_rng(seed), self.start()
        found = []
        for number in range(starts):
            at = first if number == 0 else np.clip(first + spread * rng.uniform(-1.0, 1.0, len(first)), 0.01, 0.99)
            x = least_squares(
                lambda x: self.residuals(self.lens_at(x)), at, bounds=(0.0, 1.0), x_scale="jac", max_nfev=150
            ).x
            found.append(self.merit(self.lens_at(x)))
        return min(found)
