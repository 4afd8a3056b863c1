"""Error of white pictures with the kick of lenslets, from waves and rays behind their true faces.

A plane wave of each direction in the lens's cone meets an unbounded array. Kirchhoff's integral over the curved face of
one lenslet gives its diffraction orders, which propagate through plates to the sensor: two-dimensional scalar optics,
without approximations for thin, slow or sharp lenslets. Rays of the same direction are traced through the same faces
and blurred by the kick, as in the renderer. Both pictures are Fourier series over the lattice. Their sums over the cone
are white pictures, compared pixel by pixel.

For speed, the exponential of the face's phase (kz − kz₀)(z − z₀) at the depth z is a Taylor series of matrix products.
Apart from a shift, a picture changes slowly with the direction and is interpolated between a few. Mirrored directions
have mirrored pictures.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

from lfmesh.scene.camera.camera import Camera
from lfmesh.scene.first_order.kick_error import ACROSS_A_PIXEL, MOST_PIXELS, hexagons_in_common

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

MOST_FRESNEL = 16.0
"""Largest Fresnel number for which errors are computed: time grows as its square."""

MOST_CONE = 0.5
"""Largest sine of the half angle of the lens's cone for which errors are computed."""

LEAST_ORDERS, ORDERS_A_NUMBER = 8, 2.5
"""Diffraction orders to each side that contain a lenslet's waves: for its rims, and per unit of the Fresnel number."""

BEYOND_BAND, WAVES_A_PIXEL = 6, 2.2
"""Waves of a picture beyond the aperture's limit of 4 F along a pitch, and their maximum per pixel."""

NODES = 0.0, 0.62, 1.0
"""Directions, from the axis to the rim of the cone, at which pictures are computed for interpolation."""

ACROSS_CONE, PARTS = 48, 4
"""Cells across the cone of light, and subdivisions of a cell's side that give its fraction within the circle."""

SMALL = 1 << 15
"""Multiplications per block of a product; see `_product`."""

TAYLOR = 1e-4
"""Largest neglected term of the phase series."""

STEP = 1e-4
"""Finite-difference step in direction for the motion of a ray's landing point."""


class Lenslet(NamedTuple):
    """A lenslet of revolution on one face of a plate, and the layers between it and the sensor.

    Attributes
    ----------
    pitch_mm : float
    layout : str
        "square" or "hexagonal".
    radius_mm, conic, terms : float, float, (n,) tuple
        Shape of the face, positive into the glass; see `sag_mm`.
    side : str
        Side of the curved face, "lens" or "sensor".
    plate_index : float
    layers : tuple of (float, float)
        Thickness in mm and index of each layer from the apex to the sensor.
    wavelength_mm : float
    """

    pitch_mm: float
    layout: str
    radius_mm: float
    conic: float
    terms: tuple[float, ...]
    side: str
    plate_index: float
    layers: tuple[tuple[float, float], ...]
    wavelength_mm: float

    @property
    def distance_mm(self) -> float:
        """Distance from the lenslet to the sensor, as in the medium outside."""
        return sum(thickness / index for thickness, index in self.layers)

    @property
    def fresnel_number(self) -> float:
        """Square of half the pitch, over the wavelength times the distance."""
        return self.pitch_mm**2 / (4.0 * self.wavelength_mm * self.distance_mm)

    @property
    def ratio(self) -> float:
        """Period along y over the period along x; for hexagons, two rows make a period."""
        return math.sqrt(3.0) if self.layout == "hexagonal" else 1.0

    @property
    def height_mm(self) -> float:
        """Period along y."""
        return self.pitch_mm * self.ratio

    @property
    def indices(self) -> tuple[float, float]:
        """Indices before and behind the curved face."""
        return (1.0, self.plate_index) if self.side == "lens" else (self.plate_index, 1.0)


class Orders(NamedTuple):
    """Orders of a lattice from −m to m in each axis; for hexagons every second one is absent.

    Attributes
    ----------
    x, y : (n,) int64
    exist : (n_x, n_y) bool
    """

    x: NDArray[np.int64]
    y: NDArray[np.int64]
    exist: NDArray[np.bool_]

    @classmethod
    def of(cls, lenslet: Lenslet, most: int) -> "Orders":
        """Return the orders up to a maximum along x, and as far along y."""
        far = math.ceil(most * lenslet.ratio)
        x, y = np.arange(-most, most + 1), np.arange(-far, far + 1)
        even = (x[:, None] + y) % 2 == 0
        return cls(x, y, even if lenslet.layout == "hexagonal" else np.ones_like(even))


class Face:
    """Quadrature points of a lenslet's curved face over its cell, row by row, in mm."""

    def __init__(self, lenslet: Lenslet, count: int) -> None:
        self.lenslet = lenslet
        y, across, half = _rows(lenslet, count)
        nodes, weights = leggauss(count)
        self.x, self.y = half[:, None] * nodes, np.repeat(y[:, None], count, axis=1)
        self.area = (across * half)[:, None] * weights
        square, curvature = self.x**2 + self.y**2, 1.0 / lenslet.radius_mm
        root = np.sqrt(1.0 - (1.0 + lenslet.conic) * curvature * curvature * square)
        depth, bend = curvature * square / (1.0 + root), curvature / root
        for j, term in enumerate(lenslet.terms):
            depth, bend = depth + term * square ** (j + 2), bend + (2 * j + 4) * term * square ** (j + 1)
        sense = 1.0 if lenslet.side == "lens" else -1.0
        self.z = sense * depth
        self.square = np.stack([-sense * bend * self.x, -sense * bend * self.y, np.ones_like(depth)])
        """Normals, divided by their z component."""
        self.slant = np.sqrt((self.square**2).sum(axis=0))

    def refracted(self, s: tuple[float, float]) -> tuple[Array, Array, Array, Array]:
        """Refract light of direction cosines s outside the plate.

        Returns
        -------
        into, onto : (3, 1, 1), (n, n) float64
            Unit direction before the face, and its cosine with the normal.
        out, off : (3, n, n), (n, n) float64
            The same behind the face; off is 0 on total reflection.
        """
        before, behind = self.lenslet.indices
        into = np.array([s[0] / before, s[1] / before, math.sqrt(1.0 - (s[0] ** 2 + s[1] ** 2) / before**2)])
        into, normal, ratio = into[:, None, None], self.square / self.slant, before / behind
        onto = np.maximum((into * normal).sum(axis=0), 0.0)
        off = np.sqrt(np.maximum(1.0 - ratio * ratio * (1.0 - onto * onto), 0.0))
        return into, onto, ratio * into + (off - ratio * onto) * normal, off

    def landing(self, s: tuple[float, float], kick: tuple[float, float] = (0.0, 0.0)) -> Array:
        """Return the sensor points (2, n, n) of rays with direction cosines s, kicked outside the face."""
        kicked_after = self.lenslet.side == "sensor"
        _, _, out, _ = self.refracted(s if kicked_after else (s[0] + kick[0], s[1] + kick[1]))
        cosines = self.lenslet.indices[1] * out[:2]
        if kicked_after:
            cosines = cosines + np.array(kick)[:, None, None]
        return np.stack([self.x, self.y]) + cosines * _way(self.lenslet, cosines, self.z)


def _rows(lenslet: Lenslet, count: int) -> tuple[Array, Array, Array]:
    """Return y, weight and half length of each row of a cell's points: Gauss's rule between corners."""
    if lenslet.layout == "square":
        nodes, weights = leggauss(count)
        half = 0.5 * lenslet.pitch_mm
        return half * nodes, half * weights, np.full(count, half)
    corner = lenslet.pitch_mm / math.sqrt(3.0)
    outer, inner = leggauss(math.ceil(count / 3)), leggauss(math.ceil(count / 2))
    y = corner * np.concatenate([0.25 * outer[0] - 0.75, 0.5 * inner[0], 0.25 * outer[0] + 0.75])
    across = corner * np.concatenate([0.25 * outer[1], 0.5 * inner[1], 0.25 * outer[1]])
    return y, across, np.minimum(0.5 * lenslet.pitch_mm, math.sqrt(3.0) * (corner - np.abs(y)))


def _way(lenslet: Lenslet, cosines: Array, z: Array | float = 0.0) -> Array:
    """Return the shift at the sensor of rays from a depth z, divided by their direction cosines outside the plate."""
    transverse, way = (cosines**2).sum(axis=0), 0.0
    for thickness, index in lenslet.layers:
        # A totally reflected ray carries no light; see `ray_series`.
        way, z = way + (thickness - z) / np.sqrt(np.maximum(index * index - transverse, STEP)), 0.0
    return np.asarray(way)


class Light:
    """Pictures of plane waves behind an array, by waves and by rays, as Fourier series about the vertex ray."""

    def __init__(self, lenslet: Lenslet, pixels: int) -> None:
        number = lenslet.fresnel_number
        most = LEAST_ORDERS + math.ceil(ORDERS_A_NUMBER * number)
        self.lenslet, self.face, self.for_rays = lenslet, Face(lenslet, 3 * most), Face(lenslet, 2 * most)
        self.orders = Orders.of(lenslet, most)
        self.waves = Orders.of(lenslet, math.ceil(min(4.0 * number + BEYOND_BAND, WAVES_A_PIXEL * pixels)))
        self.turn = 2.0 * math.pi / lenslet.pitch_mm, 2.0 * math.pi / lenslet.height_mm
        square = lenslet.layout == "square"
        x, y = self.face.x[: 1 if square else None], self.face.y[:, 0]
        self._along = np.exp(-1j * self.turn[0] * x[:, :, None] * self.orders.x)
        self._across = np.exp(-1j * self.turn[1] * np.outer(self.orders.y, y))

    def of(self, s: tuple[float, float]) -> Complex:
        """Return the series of waves and of kicked rays for direction cosines s, (2, n_x, n_y)."""
        chief = np.array(s) * self.lenslet.distance_mm
        phases = [turn * at * q for turn, at, q in zip(self.turn, chief, (self.waves.x, self.waves.y), strict=True)]
        moved = np.exp(1j * np.add.outer(*phases))
        pair = np.stack([self.wave_series(s), self.ray_series(s)])
        middle = pair[:, len(self.waves.x) // 2, len(self.waves.y) // 2].real
        return np.asarray(pair * moved / middle[:, None, None])

    def wave_series(self, s: tuple[float, float]) -> Complex:
        """Return the power spectrum of the field on the sensor, from Kirchhoff's integral for each order."""
        face, lenslet, k = self.face, self.lenslet, 2.0 * math.pi / self.lenslet.wavelength_mm
        before, behind = lenslet.indices
        into, onto, _, off = face.refracted(s)
        transverse = np.add.outer((k * s[0] + self.turn[0] * self.orders.x) ** 2,
                                  (k * s[1] + self.turn[1] * self.orders.y) ** 2)  # fmt: skip
        lit = self.orders.exist & (transverse < k * k * min(index for _, index in lenslet.layers) ** 2)
        kz = np.sqrt(np.where(lit, (behind * k) ** 2 - transverse, (behind * k) ** 2))
        middle_k, middle_z = 0.5 * (kz.max() + kz.min()), 0.5 * (face.z.max() + face.z.min())
        # The flow through the face is that of the wave before it; the wave behind carries it in its own direction.
        source = face.area * face.slant * np.sqrt(onto * off)
        phase = before * k * (into[0] * face.x + into[1] * face.y + into[2] * face.z)
        source = source * np.exp(1j * (phase - k * s[0] * face.x - k * s[1] * face.y - middle_k * face.z))
        terms = _terms(0.25 * np.ptp(kz) * np.ptp(face.z))
        depths = [source]
        for term in range(1, terms):
            depths.append(depths[-1] * (face.z - middle_z) * (-1j / term))
        series = _product(self._across, _product(np.stack(depths, axis=1), self._along).swapaxes(0, 1))
        wave = series[-1].T
        for term in range(terms - 2, -1, -1):
            wave = wave * (kz - middle_k) + series[term].T
        paths = sum(t * np.sqrt(np.where(lit, (n * k) ** 2 - transverse, 0.0)) for t, n in lenslet.layers)
        wave = np.where(lit, wave / np.sqrt(kz) * np.exp(1j * (paths - (kz - middle_k) * middle_z)), 0.0)
        return self._power_spectrum(wave)

    def _power_spectrum(self, wave: Complex) -> Complex:
        """Return the series of a field's power over the lattice, from its orders."""
        sizes = [2 * len(orders) for orders in (self.orders.x, self.orders.y)]
        field = np.zeros(sizes, np.complex128)
        field[: wave.shape[0], : wave.shape[1]] = wave
        series = np.fft.fft2(np.abs(np.fft.ifft2(field)) ** 2)
        pairs = zip((self.waves.x, self.waves.y), sizes, strict=True)
        known = [np.where(2 * np.abs(q) < size, q % size, size // 2) for q, size in pairs]
        return np.asarray(series[np.ix_(*known)])

    def ray_series(self, s: tuple[float, float]) -> Complex:
        """Return the series of traced rays, times the kick's transfer function for their mean response to kicks."""
        face, (x, y, exist) = self.for_rays, self.waves
        into, onto, _, off = face.refracted(s)
        flow = np.where(off > 0.0, onto * face.slant / into[2] * face.area, 0.0)
        land = face.landing(s)
        along, across = (_powers(np.exp(-1j * turn * at), len(q) // 2) for turn, at, q in
                         zip(self.turn, land, (x, y), strict=True))  # fmt: skip
        across = np.concatenate([across[:0:-1].conj(), across])
        half = _product(np.moveaxis(along * flow, 0, 1), across.transpose(1, 2, 0)).sum(axis=0)
        rays = np.concatenate([half[:0:-1, ::-1].conj(), half])
        moves = [(face.landing(s, kick) - land) * flow for kick in ((STEP, 0.0), (0.0, STEP))]
        response = np.array([move.sum(axis=(1, 2)) for move in moves]) / (STEP * flow.sum())
        cycles = np.stack(np.meshgrid(x / self.lenslet.pitch_mm, y / self.lenslet.height_mm, indexing="ij"))
        shift = np.tensordot(response, cycles, 1) * (self.lenslet.wavelength_mm / self.lenslet.pitch_mm)
        return np.where(exist, rays * _in_common(self.lenslet.layout, shift), 0.0)


def _product(a: Array | Complex, b: Array | Complex) -> Complex:
    """Multiply stacks of matrices, in blocks of rows too small for numpy's library to distribute over threads.

    On a busy machine, threads that wait for each other take a hundred times as long.
    """
    # At least two rows, as the library uses another routine for single ones.
    rows = max(2, SMALL // (b.shape[-2] * b.shape[-1]))
    parts = np.array_split(a, max(1, a.shape[-2] // rows), axis=-2)
    return np.concatenate([part @ b for part in parts], axis=-2)


def _powers(base: Complex, most: int) -> Complex:
    """Return the powers of numbers from 0 up, along the first axis."""
    return np.multiply.accumulate(np.stack([np.ones_like(base), *[base] * most]), axis=0)


def _terms(largest: float) -> int:
    """Return the number of terms to sum of the exponential series."""
    term, number = 1.0, 0
    while term > TAYLOR:
        number += 1
        term *= largest / number
    return max(number, 2)


def _in_common(layout: str, shift: Array) -> Array:
    """Return the overlap of an aperture and its copy shifted by (2, n, n) pitches, as a fraction of its area."""
    if layout == "hexagonal":
        return hexagons_in_common(shift.reshape(2, -1).T).reshape(shift.shape[1:])
    return np.asarray(np.clip(1.0 - np.abs(shift), 0.0, None).prod(axis=0))


def error_on_true_faces(camera: Camera, wavelength_nm: float, ratio: float) -> float | None:
    """Return the error of a camera's white pictures with lenslet diffraction, averaged over the lenslet types.

    None for cylinders, clear apertures, two curved faces, phases, and beyond `MOST_FRESNEL` or `MOST_CONE`.

    Parameters
    ----------
    camera : Camera
        Solved.
    wavelength_nm : float
    ratio : float
        Distance from the exit pupil to the lenslets over its diameter.
    """
    mla, sensor = camera.mla, camera.sensor
    if mla is None or mla.both_faces_act or mla.cylinder_axis is not None or mla.clear_diameter_mm is not None:
        return None
    cone, lenslets = math.sin(math.atan(0.5 / ratio)), lenslets_of(camera, wavelength_nm)
    if not 0.0 < cone <= MOST_CONE or not all(0.0 < each.fresnel_number <= MOST_FRESNEL for each in lenslets):
        return None
    pixels = max(1, round(mla.pitch_mm / sensor.pixel_mm))
    return sum(error_with_kick(each, cone, pixels) for each in lenslets) / len(lenslets)


def lenslets_of(camera: Camera, wavelength_nm: float) -> list[Lenslet]:
    """Return one lenslet of each type of a solved array with one curved face.

    Indices and wavelength are relative to the image medium.

    Parameters
    ----------
    camera : Camera
        Solved.
    wavelength_nm : float
        In air.
    """
    mla, sensor = camera.mla, camera.sensor
    assert mla is not None
    index, cover = camera.relative_index(mla.medium, wavelength_nm), sensor.cover
    assert mla.radius_mm is not None
    assert sensor.distance_mm is not None
    layers = [(mla.thickness_mm, index)] if mla.curved_side == "lens" else []
    layers.append((sensor.distance_mm - (cover.height_mm if cover else 0.0), 1.0))
    if cover is not None:
        layers += [(cover.thickness_mm, camera.relative_index(cover.medium, wavelength_nm)), (cover.gap_mm, 1.0)]
    return [
        Lenslet(mla.pitch_mm, mla.layout, radius, *mla.profile_of(kind), mla.curved_side, index, tuple(layers),
                1e-6 * wavelength_nm / camera.image_index(wavelength_nm))
        for kind, radius in enumerate(mla.radius_mm)
    ]  # fmt: skip


@lru_cache(maxsize=64)
def error_with_kick(lenslet: Lenslet, cone: float, pixels: int) -> float:
    """Return the error of white pictures with the kick, relative to the light.

    Parameters
    ----------
    lenslet : Lenslet
        Fresnel number up to `MOST_FRESNEL`.
    cone : float
        Sine of the half angle of the lens's cone.
    pixels : int
        Pixels along a pitch.
    """
    pixels = min(pixels, MOST_PIXELS)
    light = Light(lenslet, pixels)
    known: dict[tuple[int, int], Complex] = {}
    for i, j in np.ndindex(len(NODES), len(NODES)):
        alike = known.get((j, i)) if lenslet.layout == "square" else None
        known[i, j] = light.of((cone * NODES[i], cone * NODES[j])) if alike is None else alike.swapaxes(1, 2)
    truth, found = _on_pixels(light, _summed(light, known, cone), pixels)
    return float(np.abs(found / found.sum() - truth / truth.sum()).sum())


def _summed(light: Light, known: dict[tuple[int, int], Complex], cone: float) -> Complex:
    """Return the series of the light of the whole cone, from directions in one quadrant."""
    nodes = cone * np.array([-NODES[2], -NODES[1], *NODES])
    step = cone * _middles(ACROSS_CONE)
    fine = _middles(ACROSS_CONE * PARTS)
    inside = (np.hypot(fine[:, None], fine) < 1.0).reshape(ACROSS_CONE, PARTS, ACROSS_CONE, PARTS).mean(axis=(1, 3))
    # Lagrange polynomials in each axis, times the shift of a direction.
    weights = np.array([np.prod([(step - b) / (a - b) for b in nodes if b != a], axis=0) for a in nodes])
    shifts = [np.exp(-1j * turn * light.lenslet.distance_mm * np.outer(step, q))
              for turn, q in zip(light.turn, (light.waves.x, light.waves.y), strict=True)]  # fmt: skip
    along = weights[:, None, :] * shifts[0].T
    share = _product(along[:, None], _product(inside, weights[:, :, None] * shifts[1]))
    total = np.zeros((2, *light.waves.exist.shape), np.complex128)
    for i in range(len(nodes)):
        for j in range(len(nodes)):
            mirrored = slice(None, None, 1 if i >= 2 else -1), slice(None, None, 1 if j >= 2 else -1)
            total += share[i, j] * known[abs(i - 2), abs(j - 2)][:, *mirrored]
    return total


def _on_pixels(light: Light, series: Complex, pixels: int) -> Array:
    """Evaluate pictures from their series: on a lenslet's pixels for squares, all over a cell for hexagons."""
    lenslet, (x, y, _) = light.lenslet, light.waves
    if lenslet.layout == "square":
        places = 0.5 * _middles(pixels), 0.5 * _middles(pixels)
    else:
        count = ACROSS_A_PIXEL * pixels
        # One of the two rows.
        rows = math.ceil(count * math.sqrt(0.75))
        places = np.arange(count) / count, 0.5 * np.arange(rows) / rows
    along = np.exp(2j * math.pi * np.outer(places[0], x)) * np.sinc(x / pixels)
    across = np.exp(2j * math.pi * np.outer(places[1], y)) * np.sinc(y / (pixels * lenslet.ratio))
    return _product(_product(along, series), across.T).real


def _middles(count: int) -> Array:
    """Return the centres of equal parts of the interval from -1 to 1."""
    return (2.0 * np.arange(count) + 1.0) / count - 1.0
