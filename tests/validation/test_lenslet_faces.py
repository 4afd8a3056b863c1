"""White pictures with the kick of lenslets against scalar waves on their true faces: curved, thick, and lit aslant.

Kirchhoff's integral over the face, point by point and order by order, gives the waves behind an array without end, of
each plane wave that comes from the pupil. Rays are drawn one by one, turned as the Fraunhofer pattern of the aperture
says, and traced to a pixel, as the renderer's packets are. Waves are sums over the pupil. They are computed for six
directions, and interpolated between these. Lengths are in mm.
"""

from typing import NamedTuple

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from scipy.special import sici
from scipy.stats import qmc

from lfmesh.scene.first_order.lenslet_waves import Lenslet, error_with_kick

Array = NDArray[np.float64]

WAVELENGTH, PIXELS, ORDERS, POINTS = 587.6e-6, 14, 20, 24
"""Wavelength; pixels behind a lenslet; harmonics of a picture; points across the pupil."""

RAYS, SEEDS = 19, 4
"""Power of 2 of the rays of one picture, and pictures."""


class Plate(NamedTuple):
    """A plano-convex array whose flat face is its other one."""

    pitch: float = 0.014
    focal: float = 0.056
    side: str = "lens"
    index: float = 1.5
    conic: float = 0.0
    thickness: float = 0.035
    distance: float = 1.0  # of the sensor from the principal plane, over the focal length
    width: float = 1.0  # of micro-images, in pitches

    @property
    def to_sensor(self) -> float:
        return self.distance * self.focal

    @property
    def gap(self) -> float:
        return self.to_sensor - (self.thickness / self.index if self.side == "lens" else 0.0)

    @property
    def fresnel(self) -> float:
        return self.pitch**2 / (4.0 * WAVELENGTH * self.to_sensor)

    @property
    def cone(self) -> float:
        return float(np.sin(np.arctan(0.5 * self.width * self.pitch / self.to_sensor)))

    @property
    def radius(self) -> float:
        return (self.index - 1.0) * self.focal

    @property
    def indices(self) -> tuple[float, float]:
        return (1.0, self.index) if self.side == "lens" else (self.index, 1.0)

    def face(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return z of points of the face, and its normals over their z."""
        sense, curvature = 1.0 if self.side == "lens" else -1.0, 1.0 / self.radius
        root = np.sqrt(1.0 - (1.0 + self.conic) * (curvature * curvature) * (x * x + y * y))
        slope = -sense * curvature / root
        return sense * curvature * (x * x + y * y) / (1.0 + root), np.stack([slope * x, slope * y, np.ones_like(x)])

    def refracted(self, s: Array, square: Array) -> tuple[Array, Array, Array]:
        """Return directions before and behind the face, by direction cosines in air, and the cosine before it."""
        before, behind = self.indices
        into = np.array([*(s / before), np.sqrt(1.0 - (s * s).sum(axis=0) / before**2)])
        normal, ratio = square / np.sqrt((square * square).sum(axis=0)), before / behind
        cosine = (into * normal).sum(axis=0)
        turn = np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2)) - ratio * cosine
        return into, ratio * into + turn * normal, cosine


def spectrum(plate: Plate, s: tuple[float, float]) -> NDArray[np.complex128]:
    """Return Fourier coefficients of the light of a plane wave on the sensor, from the place of the vertex's ray on."""
    most = 15 + int(3.0 * plate.fresnel)
    g, w = leggauss(3 * most)
    x, y = (each.ravel() for each in np.meshgrid(0.5 * plate.pitch * g, 0.5 * plate.pitch * g, indexing="ij"))
    area, (before, behind) = 0.25 * np.outer(w, w).ravel(), plate.indices
    z, square = plate.face(x, y)
    into, out, cosine = plate.refracted(np.array(s)[:, None], square)
    normal = square / np.sqrt((square * square).sum(axis=0))
    k, m = 2.0 * np.pi / WAVELENGTH, np.arange(-most, most + 1)
    kx, ky = (k * each + 2.0 * np.pi * m / plate.pitch for each in s)
    kz = np.sqrt(np.maximum((behind * k) ** 2 - kx[:, None] ** 2 - ky**2, 0.0))
    amplitude = np.sqrt(before * cosine / (behind * (out * normal).sum(axis=0)))
    source = amplitude * area * np.exp(1j * k * before * (into[0] * x + into[1] * y + into[2] * z))
    onto, wave = k * behind * (out * square).sum(axis=0), np.zeros(kz.shape, np.complex128)
    across = np.exp(-1j * np.outer(ky, y))
    for row, (kx_row, kz_row) in enumerate(zip(kx, kz[:, :, None], strict=True)):
        oblique = onto + kx_row * square[0] + ky[:, None] * square[1] + kz_row
        phase = np.exp(-1j * (kz_row * z + kx_row * x)) * across
        lit = kz_row[:, 0] > 0.0
        wave[row, lit] = ((phase * oblique) @ source)[lit] / (2.0 * kz_row[lit, 0])
    along = plate.thickness if plate.side == "lens" else plate.gap
    wave *= np.exp(1j * kz * along)
    if plate.side == "lens":
        air = np.sqrt(np.maximum(k**2 - kx[:, None] ** 2 - ky**2, 0.0))
        wave *= np.exp(1j * air * plate.gap) * np.sqrt(np.divide(kz, air, out=np.zeros_like(kz), where=air > 0.0))
    size, q = 4 * most + 2, np.arange(-ORDERS, ORDERS + 1)
    field = np.zeros((size, size), np.complex128)
    field[: len(m), : len(m)] = wave
    series = np.fft.fft2(np.abs(np.fft.ifft2(field)) ** 2)[np.ix_(q % size, q % size)]
    moved = np.outer(*[np.exp(2j * np.pi / plate.pitch * q * each) for each in vertex_ray(plate, s)])
    return np.asarray(series * moved / series[ORDERS, ORDERS].real)


def vertex_ray(plate: Plate, s: tuple[float, float]) -> Array:
    """Return where the ray through the vertex of a lenslet falls on the sensor."""
    square = s[0] ** 2 + s[1] ** 2
    glass = plate.thickness / np.sqrt(plate.index**2 - square) if plate.side == "lens" else 0.0
    return np.array(s) * (glass + plate.gap / np.sqrt(1.0 - square))


def picture_of_waves(plate: Plate) -> Array:
    q, nodes = np.arange(-ORDERS, ORDERS + 1), plate.cone * np.array([-1.0, -0.62, 0.0, 0.62, 1.0])
    known = {(i, j): spectrum(plate, (nodes[i], nodes[j])) for i in (2, 3, 4) for j in range(2, i + 1)}

    def mirrored(i: int, j: int) -> NDArray[np.complex128]:
        a, b = 2 + abs(i - 2), 2 + abs(j - 2)
        one = known[a, b] if a >= b else known[b, a].T
        return one[:: 1 if i >= 2 else -1, :: 1 if j >= 2 else -1]

    table = np.array([[mirrored(i, j) for j in range(5)] for i in range(5)])

    def weights(at: float) -> Array:
        return np.array([np.prod([(at - b) / (a - b) for b in nodes if b != a]) for a in nodes])

    middles, truth = (np.arange(PIXELS) + 0.5) / PIXELS - 0.5, np.zeros((PIXELS, PIXELS))
    steps, fine = (2.0 * (np.arange(n) + 0.5) / n - 1.0 for n in (POINTS, 8 * POINTS))
    inside = (np.hypot(fine[:, None], fine) < 1.0).reshape(POINTS, 8, POINTS, 8).mean(axis=(1, 3))
    for sx, shares in zip(plate.cone * steps, inside, strict=True):
        row = np.tensordot(weights(sx), table, (0, 0))
        for sy, share in zip(plate.cone * steps[shares > 0.0], shares[shares > 0.0], strict=True):
            place = vertex_ray(plate, (sx, sy)) / plate.pitch
            across, along = (np.exp(2j * np.pi * np.outer(middles - c, q)) * np.sinc(q / PIXELS) for c in place)
            truth += share * (across @ np.tensordot(weights(sy), row, (0, 0)) @ along.T).real
    return np.asarray(truth / truth.sum())


def kicks(shares: Array) -> Array:
    """Return numbers of the density sinc², by shares of the light."""
    x = np.concatenate([np.linspace(0.0, 8.0, 80001), 8.0 + np.geomspace(1e-3, 1e3, 20000)])
    within = 2.0 / np.pi * (sici(2.0 * np.pi * x)[0] - np.pi * x * np.sinc(x) ** 2)
    side = 2.0 * shares - 1.0
    return np.asarray(np.sign(side) * np.interp(np.abs(side), within, x))


def picture_of_kicked_rays(plate: Plate, seed: int) -> Array:
    """Return a picture of rays whose direction cosines in air change at the face."""
    u = qmc.Sobol(6, seed=seed).random_base2(RAYS).T
    s = plate.cone * np.sqrt(u[0]) * np.stack([np.cos(2.0 * np.pi * u[1]), np.sin(2.0 * np.pi * u[1])])
    at, turn = plate.pitch * (u[2:4] - 0.5), WAVELENGTH / plate.pitch * np.stack([kicks(u[4]), kicks(u[5])])
    z, square = plate.face(*at)
    into, out, _ = plate.refracted(s, square)
    light = (into * square).sum(axis=0) / into[2]
    if plate.side == "lens":
        possible = ((s + turn) ** 2).sum(axis=0) < 1.0
        _, out, _ = plate.refracted(np.where(possible, s + turn, 0.0), square)
        sine, ways = plate.index * out[:2], [(plate.thickness - z, plate.index), (plate.gap, 1.0)]
    else:
        possible = ((out[:2] + turn) ** 2).sum(axis=0) < 1.0
        sine, ways = np.where(possible, out[:2] + turn, 0.0), [(plate.gap - z, 1.0)]
    inside = [np.maximum(n * n - (sine * sine).sum(axis=0), 0.0) for _, n in ways]
    light *= possible & (inside[-1] > 0.0)
    shift = sum(np.divide(way, np.sqrt(each), out=np.zeros_like(z), where=each > 0.0)
                for (way, _), each in zip(ways, inside, strict=True))  # fmt: skip
    column, row = np.floor(((at + sine * shift) / plate.pitch + 0.5) * PIXELS).astype(int) % PIXELS
    found = np.bincount(column * PIXELS + row, light, PIXELS * PIXELS).reshape(PIXELS, PIXELS)
    found = found + found[::-1]
    found = found + found[:, ::-1]
    found = found + found.T
    return np.asarray(found / found.sum())


def stated(plate: Plate) -> float:
    layers = ((plate.thickness, plate.index), (plate.gap, 1.0)) if plate.side == "lens" else ((plate.gap, 1.0),)
    lenslet = Lenslet(plate.pitch, "square", plate.radius, plate.conic, (), plate.side, plate.index, layers, WAVELENGTH)
    return error_with_kick(lenslet, plate.cone, PIXELS)


@pytest.mark.parametrize(
    "plate",
    [
        Plate(),
        Plate(side="sensor"),
        pytest.param(Plate(focal=0.112), marks=pytest.mark.long),
        pytest.param(Plate(focal=0.112, side="sensor"), marks=pytest.mark.long),
        pytest.param(Plate(distance=0.85, width=0.85), marks=pytest.mark.long),
        pytest.param(Plate(side="sensor", conic=-2.25), marks=pytest.mark.long),
        pytest.param(Plate(side="sensor", index=1.8), marks=pytest.mark.long),
        pytest.param(Plate(index=1.8), marks=pytest.mark.long),
        pytest.param(Plate(focal=0.035, thickness=0.03), marks=pytest.mark.long),
        pytest.param(Plate(pitch=0.028, focal=0.112), marks=pytest.mark.long),
        pytest.param(Plate(pitch=0.028, focal=0.112, side="sensor"), marks=pytest.mark.long),
    ],
)
def test_stated_errors_are_those_of_single_kicked_rays_and_of_waves_point_by_point(plate: Plate) -> None:
    """To a fifth, and to the noise of the rays: the stated error takes the mean response to kicks, to first order.

    Some of the plates are those of `transport/README.md`.
    """
    pictures = np.array([picture_of_kicked_rays(plate, seed) for seed in range(SEEDS)])
    noise = float((pictures.std(axis=0, ddof=1) / np.sqrt(SEEDS)).sum())
    error = float(np.abs(pictures.mean(axis=0) - picture_of_waves(plate)).sum())
    assert stated(plate) == pytest.approx(error, abs=0.2 * error + noise)
