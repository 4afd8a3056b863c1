"""Faces of the microlens array and of the sensor's cover, for waves."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry.array.lattice import cell_of, is_inside
from lfmesh.geometry.array.lenslets import Lenslets
from lfmesh.geometry.array.relief import CELLS, SUMS, FacePhase, fill_relief
from lfmesh.optics.coatings import Stack, coated
from lfmesh.optics.glass import Medium, absorption_per_mm, refractive_index
from lfmesh.optics.phase_profiles import phase_table
from lfmesh.optics.share_table import looked_up
from lfmesh.scene import Scene
from lfmesh.scene.camera.phase import AnyPhase
from lfmesh.scene.materials.coatings import UNCOATED
from lfmesh.transport.packets.packet import BACK_FRAME, CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME
from lfmesh.transport.tables.coatings import coating_table
from lfmesh.transport.tables.interfaces import Face, array_faces, cover_faces
from lfmesh.transport.tables.tables import CURVED_ROW, Tables
from lfmesh.waves.angular_spectrum import Spectrum, Waves

Array = NDArray[np.float64]

ANGLES = 257
"""Number of angles at which the transmittance of a face is computed; linear in between."""

STRAIGHT = 1e-12
"""Largest difference of a cosine from 1 for a part to count as square to the axis."""

GRAZING = 0.05
"""Approximate least cosine between light and a lenslet's face for transmission."""


class Relief(NamedTuple):
    """Relief of a face at points of an even grid, camera frame.

    Attributes
    ----------
    height : (n, n) float64, mm
    slope : (2, n, n) float64
    share : (n, n) complex128
        Mean over each cell of the transmitted wave, over that of a clear cell with this height and phase.
    clear : (n, n) float64
        Unobstructed fraction of each cell.
    phase : (n, n) float64, rad, or None
        Of a diffractive face.
    steepness : (2, n, n) float64, rad/mm, or None
        Gradient of the phase.
    """

    height: Array
    slope: Array
    share: Waves
    clear: Array
    phase: Array | None
    steepness: Array | None


@dataclass(frozen=True, eq=False)
class WaveFace:
    """A face square to the axis.

    Attributes
    ----------
    z_mm : float
        Position of the plane, or of the apexes of lenslets.
    interface : Face
        Its media and coating.
    index : float
        Of the medium behind.
    absorption_per_mm : float
        Of the medium behind.
    lenslets : Lenslets, optional
        Lenslets on the face; flat ones on a flat diffractive face.
    frame : (3, 4) float64
        Transformation from camera to lenslets.
    phase : FacePhase, optional
        Phase of a diffractive face.
    order_share : float
        Fraction of the transmitted light in the order of the phase.
    """

    z_mm: float
    interface: Face
    index: float
    absorption_per_mm: float
    lenslets: Lenslets | None
    frame: Array
    phase: FacePhase | None = None
    order_share: float = 1.0

    def passed(self, light: Spectrum, scene: Scene, told: Callable[[float], None]) -> Spectrum:
        """Return the light behind the face.

        Parameters
        ----------
        light : Spectrum
            Across the plane of the face, before it.
        scene : Scene
            For its coatings.
        told : callable
            Called with the completed fraction of the work, except for plane faces.
        """
        sines, amplitude = self._amplitudes(light, scene)
        grid = light.grid
        if self.lenslets is None:
            px, py = grid.directions
            return light.through_plane(np.interp(np.hypot(px[None, :], py[:, None]), sines, amplitude), self.index)
        x, y = light.at_mm[0] + grid.places, light.at_mm[1] + grid.places
        per_mm = 2.0 * np.pi / grid.wavelength_mm * (grid.middle_z(light.index) - grid.middle_z(self.index))
        relief = self._relief(self.lenslets, x, y, per_mm)
        height, slope, share, clear = relief[:4]
        # Kinks at borders have waves outside the grid's directions. The height is averaged over a cell, less the effect
        # of averaging on waves within the grid. This removes the kinks' waves to the second order of the grid's step.
        # At steps between lenslets, the slopes represent only the kink.
        lit = clear > 0.0
        bend = _central_difference(slope[0], lit, 1) + _central_difference(slope[1], lit, 0)
        height = height - grid.step_mm / 24.0 * bend
        phase, change = per_mm * height, per_mm * grid.step_mm * slope
        turn = None
        if relief.phase is None or relief.steepness is None:
            share = _sharpened(share, phase, change)
        else:
            # The phase of the face has the same kinks at borders.
            by_x, by_y = relief.steepness
            bend = _central_difference(by_x, lit, 1) + _central_difference(by_y, lit, 0)
            own = relief.phase - grid.step_mm / 24.0 * bend
            share = _sharpened(share, phase + own, change + grid.step_mm * relief.steepness) * np.exp(1j * own)
            turn = grid.wavelength_mm / (2.0 * np.pi) * relief.steepness
        # The transmittance of a point depends on direction. It is expanded to first order: out of focus, the direction
        # of light varies with position.
        steps = np.diag(light.spread)
        table = sines, amplitude
        through, aslant = self._passed_at(slope, turn, light.index, grid.middle, table)
        passed = [through]
        for step in steps:
            more, less = (
                self._passed_at(slope, turn, light.index, grid.middle + way, table)[0] for way in (step, -step)
            )
            passed.append((more - less) / (2.0 * step.sum()))
        return light.through_relief(height, share, clear / aslant, passed, self.index, told)

    def _passed_at(
        self, slope: Array, turn: Array | None, index: float, direction: Array, table: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        """Return the amplitude that each point of the relief transmits of one direction, (n, n).

        The second array is the squared amplitude over the transmitted power.

        Parameters
        ----------
        slope : (2, n, n) float64
            Of the face.
        turn : (2, n, n) float64, optional
            Change of the optical direction cosines by a diffractive face, of which the tangential part counts.
        index : float
            Of the medium before it.
        direction : (2,) float64
            Optical direction cosines of the incident light.
        table : (angles,) float64, (angles,) float64
            See `_amplitudes`.
        """
        steep = np.sqrt(1.0 + (slope**2).sum(axis=0))
        along_z = math.sqrt(max(index * index - float(direction @ direction), GRAZING**2))
        onto = (along_z - direction[0] * slope[0] - direction[1] * slope[1]) / steep
        across = np.sqrt(np.maximum(index**2 - onto**2, 0.0))
        turned, normal = across, onto
        if turn is not None:
            px, py = direction[:, None, None] + turn
            normal = (along_z - px * slope[0] - py * slope[1]) / steep
            turned = np.sqrt(np.maximum(px * px + py * py + along_z * along_z - normal**2, 0.0))
        behind = np.sqrt(np.maximum(self.index**2 - turned**2, 0.0))
        # Refraction changes the wave vector along the normal (−slope, 1) / steep.
        pz = along_z + (behind - normal) / steep
        # Ratio of the flux through the tilted face to that through a plane, before and behind.
        aslant = np.maximum(behind, GRAZING) * steep / np.maximum(pz, GRAZING)
        flux = (onto * steep / along_z) * aslant
        clear = (onto > GRAZING) & (behind > GRAZING) & (pz > GRAZING)
        return np.where(clear, np.sqrt(np.maximum(flux, 0.0)) * np.interp(across, *table), 0.0), aslant

    def turn(self, places: Array, index: float, wavelength_mm: float) -> tuple[float, float]:
        """Return the largest change of direction cosines by lenslets, and their pitch; 0, 0 for a plane.

        Parameters
        ----------
        places : (n, 2) float64, mm
            Points of the face; the lenslets near them count.
        index : float
            Of the medium before the face.
        wavelength_mm : float
        """
        if self.lenslets is None:
            return 0.0, 0.0
        pitch = self.lenslets.lattice.pitch
        low, high = places.min(axis=0) - pitch, places.max(axis=0) + pitch
        x, y = (np.linspace(a, b, min(400, 8 + int(20 * (b - a) / pitch))) for a, b in zip(low, high, strict=True))
        relief = self._relief(self.lenslets, x, y)
        turned = (index - self.index) * relief.slope
        if relief.steepness is not None:
            turned = turned + wavelength_mm / (2.0 * np.pi) * relief.steepness
        return float(np.abs(turned).max()), pitch

    def missed_by(self, places: Array) -> float:
        """Return the gap, mm, between the lenslets and the bounding box of points (n, 2); 0 if they meet."""
        assert self.lenslets is not None
        own = places @ self.frame[:2, :2].T + self.frame[:2, 3]
        return outside(own, np.asarray(self.lenslets.lattice.half_extent))

    def met_by(self, places: Array) -> int:
        """Return the number of lenslets that rays to points (n, 2), mm, meet."""
        assert self.lenslets is not None
        lattice = self.lenslets.lattice
        own = places @ self.frame[:2, :2].T + self.frame[:2, 3]
        cells = {cell_of(lattice, float(x), float(y)) for x, y in own}
        return sum(is_inside(lattice, *cell) for cell in cells)

    def _relief(self, lenslets: Lenslets, x: Array, y: Array, per_mm: float = 0.0) -> Relief:
        """Return the relief of the lenslets on an even grid.

        Parameters
        ----------
        lenslets : Lenslets
        x, y : (columns,), (rows,) float64, mm
        per_mm : float, rad/mm
            Phase gained per height of the face.
        """
        xs, ys = (each.ravel() for each in np.meshgrid(x, y, indexing="xy"))
        turn, sense = self.frame[:2, :2], float(np.sign(self.frame[2, 2]))
        own = np.ascontiguousarray(turn @ np.stack([xs, ys]) + self.frame[:2, 3:])
        relief, parts = np.zeros((6 if self.phase is None else 9, len(xs))), np.zeros((CELLS, SUMS))
        fill_relief(lenslets, own, abs(x[1] - x[0]), sense * per_mm, self.phase, parts, relief)
        shape = len(y), len(x)
        slope = sense * (turn.T @ relief[1:3])
        share = (relief[3] + 1j * relief[4]).reshape(shape)
        height, clear = sense * relief[0].reshape(shape), relief[5].reshape(shape)
        if self.phase is None:
            return Relief(height, slope.reshape(2, *shape), share, clear, None, None)
        steepness = (turn.T @ relief[7:9]).reshape(2, *shape)
        return Relief(height, slope.reshape(2, *shape), share, clear, relief[6].reshape(shape), steepness)

    def _amplitudes(self, light: Spectrum, scene: Scene) -> tuple[Array, Array]:
        """Return values of n sin θ, and the amplitude that the face transmits there, both (angles,)."""
        n_i, n_t, wavelength = light.index, self.index, light.grid.wavelength_mm * 1e6
        thin = min(n_i, n_t)
        cosines = np.linspace(1.0, 1e-6, ANGLES)
        sines = thin * np.sqrt(1.0 - cosines**2)
        face = self.interface
        if face.coating == UNCOATED:
            share = coated(thin, max(n_i, n_t), Stack((), ()), wavelength, cosines)[1]
        else:
            table = coating_table(scene, face.coating, face.outer, face.inner, (wavelength,))
            # Tables use the angle in the thinner medium. For absorbing layers the third quantity is the transmittance.
            first = 2 * len(table.values) // 3 if table.absorbs else 0
            found = np.array([looked_up(table.values, first, table.pieces, 0, float(np.sqrt(c))) for c in cosines])
            share = found if table.absorbs else 1.0 - found
        return sines, np.sqrt(self.order_share * share)


def outside(places: Array, half: Array) -> float:
    """Return the gap between the bounding box of points (n, 2) and a centred box of given half size; 0 if they meet."""
    return float(np.maximum(places.min(axis=0) - half, -half - places.max(axis=0)).max(initial=0.0))


def faces_before_sensor(scene: Scene, tables: Tables, wavelength_nm: float) -> list[WaveFace]:
    """Return the faces of array and cover at one wavelength, from the lens to the sensor.

    Parameters
    ----------
    scene : Scene
        Solved.
    tables : Tables
    wavelength_nm : float

    Raises
    ------
    LfmeshError
        The array or the sensor is tilted.
    """
    faces, mla, cover = [], scene.camera.mla, scene.camera.sensor.cover
    absorbs = scene.camera.absorption
    if mla is not None:
        tilt = list(mla.pose.tilt_deg)
        _refuse_tilt(tables.frames[MLA_FRAME, CAMERA_FRAME], "camera.mla.pose.tilt_deg", tilt, turn=True)
        curved, flat = array_faces(scene)
        lenslets = {tables.mla.frame: (tables.mla.lenslets, curved if tables.mla.row == CURVED_ROW else flat)}
        if tables.mla.back is not None:
            back = tables.mla.back
            lenslets[back.frame] = back.lenslets, curved if back.row == CURVED_ROW else flat
        for frame in (MLA_FRAME, BACK_FRAME):
            z = float(tables.frames[frame, CAMERA_FRAME][2, 3])
            shape, interface = lenslets.get(frame, (None, flat))
            phase = mla.curved_phase if interface is curved else mla.flat_phase
            if phase is not None and shape is None:
                shape = _flattened(tables.mla.lenslets)
            faces.append((z, interface, shape, tables.frames[CAMERA_FRAME, frame], mla.medium, phase))
    sensor_z = float(tables.frames[SENSOR_FRAME, CAMERA_FRAME][2, 3])
    _refuse_tilt(
        tables.frames[SENSOR_FRAME, CAMERA_FRAME],
        "camera.sensor.pose.tilt_deg",
        list(scene.camera.sensor.pose.tilt_deg),
    )
    faces.sort(key=lambda face: face[0])
    if cover is not None:
        for interface, height in zip(cover_faces(scene), (cover.height_mm, cover.gap_mm), strict=True):
            faces.append((sensor_z - height, interface, None, np.zeros((3, 4)), cover.medium, None))
    found = []
    outside = scene.camera.medium_behind_lens
    for number, (z, interface, shape, frame, medium, phase) in enumerate(faces):
        enters = number % 2 == 0
        taken = absorption_per_mm(medium, wavelength_nm) if enters and absorbs and isinstance(medium, str) else 0.0
        index = refractive_index(medium if enters else outside, wavelength_nm)
        diffracts = _order_of(phase, wavelength_nm, outside, medium)
        found.append(WaveFace(z, interface, index, taken, shape, frame, *diffracts))
    return found


def _flattened(lenslets: Lenslets) -> Lenslets:
    """Return the cells of an array's flat face as flat lenslets."""
    none = np.zeros(0)
    return lenslets._replace(
        curvature=np.zeros(1), decentre=np.zeros((0, 2)), stretch=none, top=0.0, valley=0.0, profile=None,
        clear_radius=np.inf,
    )  # fmt: skip


def _order_of(
    phase: AnyPhase | None, wavelength_nm: float, outside: Medium, medium: Medium
) -> tuple[FacePhase | None, float]:
    """Return the main order of a phase between two media, and the fraction of the transmitted light in it."""
    if phase is None:
        return None, 1.0
    share = dict(phase.orders_of(wavelength_nm, outside, medium)).get(phase.main_order, 0.0)
    return FacePhase(phase_table([phase.profile()]), 0, float(phase.main_order)), share


def _central_difference(values: Array, given: NDArray[np.bool_], axis: int) -> Array:
    """Return half the difference of both neighbours on a grid in FFT order; 0 if one is not given."""
    found = 0.5 * (np.roll(values, -1, axis) - np.roll(values, 1, axis))
    return np.where(given & np.roll(given, 1, axis) & np.roll(given, -1, axis), found, 0.0)


def _sharpened(share: Waves, phase: Array, change: Array) -> Waves:
    """Correct the transmitted wave for the loss by cell averaging at steps and rims.

    Parameters
    ----------
    share : (n, n) complex128
        Transmitted fraction of the wave, in FFT order.
    phase : (n, n) float64
        Of the transmitted wave.
    change : (2, n, n) float64
        Phase change from cell to cell along x and y, by the slope.
    """
    wave, bent = share * np.exp(1j * phase), -4.0 * share
    for axis, own in ((1, change[0]), (0, change[1])):
        for way in (1, -1):
            slope = 0.5 * (own + np.roll(own, way, axis))
            bent += np.roll(wave, way, axis) * np.exp(1j * (way * slope - phase))
    return np.asarray(share - bent / 24.0)


def _refuse_tilt(move: Array, where: str, value: list[float], *, turn: bool = False) -> None:
    straight = abs(move[2, 2]) if turn else move[0, 0] * move[1, 1] * abs(move[2, 2])
    if not math.isclose(straight, 1.0, abs_tol=STRAIGHT):
        raise LfmeshError(f"{where} = {value}: a point spread needs array and sensor perpendicular to the axis; give 0")
