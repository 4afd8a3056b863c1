"""Geometry of a light-field camera as seen in its raw image: centres of the micro-images."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.array.lattice import ROW_SPACING, Lattice
from lfmesh.geometry.array.lenslets import Lenslets, type_of
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.kernels.decorators import kernel
from lfmesh.lightfield.rays.chief_rays import ChiefRays, chief_rays, plate_of, polynomial_terms
from lfmesh.lightfield.rays.ray_model import RayModel
from lfmesh.scene import Scene
from lfmesh.scene.first_order.solve import lenslet_focal_length_mm

Array = NDArray[np.float64]

DISTORTION_DEGREE = 3
"""Degree of the polynomial that extrapolates centres to lenslets without a known one."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """Geometry that finds and interprets a lenslet's pixels.

    Pixel positions are (column, row) of the raw image, with the first pixel's centre at (0, 0).

    Attributes
    ----------
    layout : {"square", "hexagonal"}
    centres_px : (rows, columns, 2) float64
        Centre of every micro-image, at the chief ray of its lenslet.
    known : (rows, columns) bool
        False without a chief ray or light; the centre is then extrapolated.
    kinds : (rows, columns) int64
        Type number of each lenslet.
    focal_lengths_mm : tuple of float
        One per type.
    lenslet_pitch_mm : float
        Distance of neighbouring lenslets, pitch error included.
    pixel_mm : float
    sensor_px : tuple of int
        Columns, rows.
    f_number : float
        Of the main lens: the exit pupil's distance from the array over its diameter.
    microlens_f_number : float
        Distance of the lenslets from the sensor over their pitch.
    exit_pupil_z_mm, exit_pupil_diameter_mm : float
        Camera frame; inf if telecentric.
    pupil_to_array_mm, lenslet_to_sensor_mm : float
        D and d of the micro-image pitch (p/pixel)(D + d)/D.
    wavelength_nm : float
        Of the chief rays.
    origin : {"traced", "white image"}
        Source of the centres.
    """

    layout: Literal["square", "hexagonal"]
    centres_px: Array
    known: NDArray[np.bool_]
    kinds: NDArray[np.int64]
    focal_lengths_mm: tuple[float, ...]
    lenslet_pitch_mm: float
    pixel_mm: float
    sensor_px: tuple[int, int]
    f_number: float
    microlens_f_number: float
    exit_pupil_z_mm: float
    exit_pupil_diameter_mm: float
    pupil_to_array_mm: float
    lenslet_to_sensor_mm: float
    wavelength_nm: float
    origin: Literal["traced", "white image"]

    def __repr__(self) -> str:
        rows, columns = self.known.shape
        known = f"{self.known.mean():.1%} known"
        return f"<Calibration: {columns} × {rows} {self.layout} micro-images, {known}, {self.origin}>"

    @property
    def lattice(self) -> Lattice:
        """Lattice of the micro-images, with its pitch in pixels."""
        rows, columns = self.known.shape
        return Lattice(self.layout == "hexagonal", self.pitch_px, columns, rows)

    @property
    def row_pitch_mm(self) -> float:
        """Distance of neighbouring rows of lenslets."""
        return self.lenslet_pitch_mm * (ROW_SPACING if self.layout == "hexagonal" else 1.0)

    @cached_property
    def _similarity(self) -> complex:
        """Scale and rotation that best map the ideal lattice of pitch 1 to the known centres."""
        rows, columns = self.known.shape
        to_complex = np.array([1.0, 1.0j])
        ideal = Lattice(self.layout == "hexagonal", 1.0, columns, rows).centres()[self.known] @ to_complex
        seen = self.centres_px[self.known] @ to_complex
        ideal = ideal - ideal.mean()
        spread = np.vdot(ideal, ideal).real
        return complex(np.vdot(ideal, seen) / spread) if spread else complex(self.nominal_pitch_px)

    @property
    def pitch_px(self) -> float:
        """Mean distance of neighbouring micro-images, by least squares over known centres."""
        return abs(self._similarity)

    @property
    def nominal_pitch_px(self) -> float:
        """First-order pitch of the micro-images, (p/pixel)(D + d)/D."""
        return self.lenslet_pitch_mm / self.pixel_mm * (1.0 + self.lenslet_to_sensor_mm / self.pupil_to_array_mm)

    @property
    def rotation_rad(self) -> float:
        """Rotation of the rows of micro-images against the sensor's, from column (+x) to row (+y)."""
        return math.atan2(self._similarity.imag, self._similarity.real)

    def error_px(self, truth: "Calibration") -> Array:
        """Return the distances of these centres from the true ones, for lenslets known to both.

        Parameters
        ----------
        truth : Calibration
            From `lf.calibrate`.

        Returns
        -------
        (n,) float64
            Pixels, one per lenslet.
        """
        both = self.known & truth.known
        return np.asarray(np.linalg.norm(self.centres_px[both] - truth.centres_px[both], axis=1))


def calibrate(scene: Scene) -> Calibration:
    """Trace the true geometry of a scene's camera, installation and form errors included.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    Calibration

    Raises
    ------
    LfmeshError
        A conventional camera, or a lens that passes no chief ray to the array.
    """
    scene = solved_camera(scene).scene
    return calibration_by(scene, chief_rays(scene))


def calibration_by(scene: Scene, rays: ChiefRays) -> Calibration:
    """Return the true geometry of a solved scene's camera from its chief rays."""
    sensor = scene.camera.sensor
    centres = rays.landing / sensor.pixel_mm + 0.5 * (np.asarray(sensor.pixels) - 1.0)
    return calibration_of(scene, continued(centres, rays.traced), rays.traced, "traced")


def calibration_of(
    scene: Scene, centres_px: Array, known: NDArray[np.bool_], origin: Literal["traced", "white image"]
) -> Calibration:
    """Return a calibration from its centres and a solved scene's first-order optics.

    Parameters
    ----------
    scene : Scene
        Solved.
    centres_px : (rows, columns, 2) float64
        Column and row of every micro-image's centre.
    known : (rows, columns) bool
        False for extrapolated centres.
    origin : {"traced", "white image"}
    """
    mla, sensor = scene.camera.mla, scene.camera.sensor
    lenslets = plate_of(scene).lenslets
    assert mla is not None
    facts, model = solved_camera(scene).report, RayModel.of(scene)
    kinds = np.zeros(known.shape, np.int64)
    _fill_kinds(lenslets, kinds)
    return Calibration(
        layout=mla.layout,
        centres_px=centres_px,
        known=known,
        kinds=kinds,
        focal_lengths_mm=lenslet_focal_length_mm(scene.camera, scene.primary_nm),
        lenslet_pitch_mm=model.lenslet_pitch_mm,
        pixel_mm=sensor.pixel_mm,
        sensor_px=sensor.pixels,
        f_number=model.image_index * model.f_number,
        microlens_f_number=facts.image_index * (facts.microlens_f_number or math.nan),
        exit_pupil_z_mm=facts.exit_pupil_z_mm,
        exit_pupil_diameter_mm=facts.exit_pupil_diameter_mm,
        pupil_to_array_mm=model.pupil_to_array_mm,
        lenslet_to_sensor_mm=model.lenslet_to_sensor_mm,
        wavelength_nm=scene.primary_nm,
        origin=origin,
    )


def continued(centres_px: Array, known: NDArray[np.bool_]) -> Array:
    """Fill in unknown centres by a polynomial of third degree through the known ones.

    Parameters
    ----------
    centres_px : (rows, columns, 2) float64
        May be NaN if unknown.
    known : (rows, columns) bool
    """
    if known.all() or not known.any():
        return centres_px
    row, column = np.indices(known.shape)
    index = np.stack([column, row], axis=-1).astype(np.float64)
    half = 0.5 * np.array(known.shape[::-1])
    # Odd and even rows separately, as rows of a hexagonal array are shifted against each other.
    filled = centres_px.copy()
    for parity in (0, 1):
        rows = np.arange(len(known)) % 2 == parity
        here, place = known & rows[:, None], ~known & rows[:, None]
        for degree in range(DISTORTION_DEGREE, -1, -1):
            terms = polynomial_terms((index[here] - half) / half, degree)
            if np.linalg.matrix_rank(terms) == terms.shape[1]:
                fit, *_ = np.linalg.lstsq(terms, centres_px[here], rcond=None)
                filled[place] = polynomial_terms((index[place] - half) / half, degree) @ fit
                break
    return filled


@kernel
def _fill_kinds(lenslets: Lenslets, kinds: NDArray[np.int64]) -> None:
    for row in range(kinds.shape[0]):
        for column in range(kinds.shape[1]):
            kinds[row, column] = type_of(lenslets, column, row)
