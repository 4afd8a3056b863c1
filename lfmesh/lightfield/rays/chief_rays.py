"""Chief rays: traced from the middle of the stop through the apex of every lenslet to the sensor.

`lf.trace` follows them through any lens. In the array, a lenslet acts as a plane-parallel plate: at the apex its curved
face is square to the axis. A diffractive curved face deflects them by the gradient of its phase at the apex. At a
diffractive face with several orders they follow the main one.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.geometry.array.lenslets import Lenslets
from lfmesh.geometry.lens.element_poses import pose_of
from lfmesh.geometry.lens.solved_camera import SolvedCamera, solved_camera
from lfmesh.lightfield.rays.lens_alone import lens_alone
from lfmesh.optics.ray_aiming import aim_rays
from lfmesh.scene import Scene
from lfmesh.scene.camera.lenslet_optics import lenslet_optics, sections
from lfmesh.scene.first_order.lenslets import are_cylinders
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME
from lfmesh.transport.tables.frames import frame_table
from lfmesh.transport.tables.interfaces import interface_tables
from lfmesh.transport.tables.lens import mla_tables
from lfmesh.transport.tables.media import MediumList
from lfmesh.transport.trace import Status, trace

Array = NDArray[np.float64]

FAN = 41
"""Rays along each side of the fan for the first guess."""

AHEAD, CLOSE = 2.0**-4, 2.0**-10
"""Distance behind the stop at which rays start, over that of the next surface; the second in gradient-index glass."""

DEGREE = 5
"""Degree of the polynomial from the place on the array to the chief ray's slope at the stop."""


class ChiefRays(NamedTuple):
    """One ray per lenslet; all but `apex` is NaN if the lens stops it or cannot reach the apex.

    Attributes
    ----------
    apex : (rows, columns, 3) float64, mm, camera frame
    entry : (rows, columns, 3) float64, mm, camera frame
        Point on the array's first face; the apex, if the curved face is on the lens side.
    direction : (rows, columns, 3) float64
        Unit, between lens and array, camera frame.
    landing : (rows, columns, 2) float64, mm, sensor frame
    """

    apex: Array
    entry: Array
    direction: Array
    landing: Array

    @property
    def traced(self) -> NDArray[np.bool_]:
        """(rows, columns): True for lenslets with a chief ray."""
        return np.isfinite(self.landing[..., 0])


class Plate(NamedTuple):
    """Array and cover as seen by a chief ray: their glass, and the side of the curved face.

    Indices are relative to the medium outside. The deflection is the change of the direction cosines x and y outside
    the array by a diffractive curved face, the same in both directions of travel.
    """

    lenslets: Lenslets
    glass: float
    curved_to_lens: bool
    moves: Array
    cover_mm: float = 0.0  # thickness of the cover; 0: none
    cover_index: float = 1.0
    deflection: tuple[float, float] = (0.0, 0.0)

    @property
    def apexes(self) -> Array:
        """(rows · columns, 2) mm, array frame."""
        return self.lenslets.apexes.reshape(-1, 2)

    def at_apexes(self, position: Array, direction: Array) -> Array:
        """Return the points of rays (n, 3), camera frame, in the plane of the apexes, (n, 2) mm in the array frame."""
        p = frames.points(self.moves[CAMERA_FRAME, MLA_FRAME], position)
        d = frames.directions(self.moves[CAMERA_FRAME, MLA_FRAME], direction)
        if self.curved_to_lens:
            return p[:, :2] - (p[:, 2] / d[:, 2])[:, None] * d[:, :2]
        t = (self.lenslets.thickness - p[:, 2]) / d[:, 2]
        inside = self.inside(d)
        return p[:, :2] + t[:, None] * d[:, :2] - (self.lenslets.thickness / inside[:, 2])[:, None] * inside[:, :2]

    def entries(self, direction: Array) -> Array:
        """Return the entry points, on the array's first face, of rays to the apexes, (n, 3) mm in the camera frame."""
        points = np.column_stack([self.apexes, np.zeros(len(self.apexes))])
        if not self.curved_to_lens:
            inside = self.inside(frames.directions(self.moves[CAMERA_FRAME, MLA_FRAME], direction))
            points = points + (self.lenslets.thickness / inside[:, 2])[:, None] * inside
        return frames.points(self.moves[MLA_FRAME, CAMERA_FRAME], points)

    def landing(self, direction: Array) -> Array:
        """Return the landing points, on the sensor, of rays through the apexes, (n, 2) mm in its frame.

        Parameters
        ----------
        direction : (n, 3) float64
            Before the array, camera frame.
        """
        d = self.deflected(frames.directions(self.moves[CAMERA_FRAME, MLA_FRAME], direction))
        leaves = np.column_stack([self.apexes, np.zeros(len(d))])
        if self.curved_to_lens:
            inside = self.inside(d)
            leaves = leaves + (self.lenslets.thickness / inside[:, 2])[:, None] * inside
        p = frames.points(self.moves[MLA_FRAME, SENSOR_FRAME], leaves)
        d = frames.directions(self.moves[MLA_FRAME, SENSOR_FRAME], d)
        landed = p[:, :2] - (p[:, 2] / d[:, 2])[:, None] * d[:, :2]
        return landed if self.cover_mm == 0.0 else landed + self.moved_by_cover(d)

    def moved_by_cover(self, direction: Array) -> Array:
        """Return the lateral displacement of rays by the cover, (n, 2) mm in the sensor's frame.

        A plate of thickness t moves a ray by t tan θ' rather than t tan θ, with sin θ = n sin θ'.

        Parameters
        ----------
        direction : (n, 3) float64
            Outside the cover, unit, sensor frame.
        """
        across, along = direction[:, :2], np.abs(direction[:, 2])
        in_glass = np.sqrt(self.cover_index**2 - np.einsum("ij,ij->i", across, across))
        return self.cover_mm * (1.0 / in_glass - 1.0 / along)[:, None] * across

    def deflected(self, direction: Array) -> Array:
        """Return unit directions (array frame) on the far side of the array of rays through the apexes."""
        if self.deflection == (0.0, 0.0):
            return direction
        across = direction[:, :2] + self.deflection
        along = np.sqrt(1.0 - np.einsum("ij,ij->i", across, across))
        return np.column_stack([across, np.copysign(along, direction[:, 2])])

    def inside(self, direction: Array) -> Array:
        """Return unit directions (array frame) in the glass, by Snell's law at a face square to the axis."""
        across = direction[:, :2] / self.glass
        along = np.sqrt(1.0 - np.einsum("ij,ij->i", across, across))
        return np.column_stack([across, np.copysign(along, direction[:, 2])])


def refuse_undecodable(scene: Scene) -> None:
    """Refuse arrays with lenslets that act as cylinders, with lenslets on both faces, or with a diffractive flat face.

    Parameters
    ----------
    scene : Scene
        With an array.

    Raises
    ------
    LfmeshError
        The message names the functions that accept such an array.
    """
    mla = scene.camera.mla
    assert mla is not None
    lines = "make lines, not micro-images, and are not decoded or calibrated; render, check, draw, view and "
    lines += "lf.white_image accept them"
    if mla.cylinder_axis is not None and not mla.phases:
        raise LfmeshError(f'camera.mla.cylinder_axis = "{mla.cylinder_axis}": cylindrical lenslets {lines}')
    if mla.has_back:
        raise LfmeshError(
            "camera.mla.back: arrays with lenslets on both faces are not decoded or calibrated, because chief rays are "
            "known through a flat face only; render, check, draw, view and lf.white_image accept them"
        )
    if mla.gradient is not None:
        raise LfmeshError(
            "camera.mla.gradient: arrays of gradient-index glass are not decoded or calibrated, because chief rays are "
            "known through homogeneous plates only; render, check, draw, view and lf.white_image accept them"
        )
    if mla.flat_phase is not None:
        raise LfmeshError(
            "camera.mla.flat_phase: arrays with a diffractive flat face are not decoded or calibrated, because chief "
            "rays are known through a plain flat face only; render, check, draw, view and lf.white_image accept them, "
            "and curved_phase is decoded"
        )
    solved = solved_camera(scene).scene.camera
    if are_cylinders(solved, scene.primary_nm):
        key = "curved_phase" if mla.curved_phase is not None else "cylinder_axis"
        powers = " and ".join(
            f"{lenslet_optics(solved, scene.primary_nm, section=each).power_per_mm:.4g} per mm in {each}"
            for each in ("x", "y")
        )
        if len(sections(mla)) == 1:
            powers = f"{powers}, and differ between them"
        raise LfmeshError(
            f"camera.mla.{key}: lenslets of different power in two sections ({powers}) act as cylinders. They {lines}"
        )


def plate_of(scene: Scene) -> Plate:
    """Return the array of a scene for chief rays.

    Raises
    ------
    LfmeshError
        A conventional camera, cylindrical lenslets, lenslets on both faces, a diffractive flat face, or a
        gradient-index plate.
    """
    mla = scene.camera.mla
    if mla is None:
        raise LfmeshError("camera.mla is missing: a conventional camera has no lenslets to calibrate or decode by")
    refuse_undecodable(scene)
    primary = scene.primary_nm
    _, tables = mla_tables(scene, (primary,), interface_tables(scene, (primary,)).mla, MediumList.of(scene))
    moves = frame_table(scene, np.zeros(3))
    camera, cover = scene.camera, scene.camera.sensor.cover
    covered = (0.0, 1.0) if cover is None else (cover.thickness_mm, camera.relative_index(cover.medium, primary))
    deflection = (0.0, 0.0)
    if mla.curved_phase is not None:
        per_rad = mla.curved_phase.path_per_rad_mm(primary) / camera.image_index(primary)
        by_x, by_y = mla.curved_phase.gradient_rad_mm
        deflection = (per_rad * by_x, per_rad * by_y)
    glass = camera.relative_index(mla.medium, primary)
    return Plate(tables.lenslets, glass, tables.curved_to_lens, moves, *covered, deflection)


def chief_rays(scene: Scene) -> ChiefRays:
    """Trace the chief ray of every lenslet, at the primary wavelength.

    Raises
    ------
    LfmeshError
        A conventional camera, or a lens that passes no chief ray to the array.
    """
    return _chief_rays(solved_camera(scene))


@lru_cache(maxsize=2)
def _chief_rays(camera: SolvedCamera) -> ChiefRays:
    """Trace the chief rays of a camera; cached for decoding, calibration and views."""
    plate = plate_of(camera.scene)
    apexes = plate.apexes
    reach = float(np.hypot(*apexes.T).max()) + plate.lenslets.lattice.pitch
    fan = _Fan(camera, plate, reach)

    def landing(slopes: Array, _: NDArray[np.int64]) -> Array:
        return plate.at_apexes(*fan.trace(slopes))

    # In gaps between facets, the nearest ray found replaces the one to the apex.
    aimed = aim_rays(landing, apexes, fan.guess(apexes), fan.derivative(apexes), reach)
    _, direction = fan.trace(aimed.start)
    lattice = plate.lenslets.lattice
    in_camera = frames.points(plate.moves[MLA_FRAME, CAMERA_FRAME], np.column_stack([apexes, np.zeros(len(apexes))]))
    shape = (lattice.rows, lattice.columns, -1)
    rays = ChiefRays(
        in_camera.reshape(shape),
        plate.entries(direction).reshape(shape),
        direction.reshape(shape),
        plate.landing(direction).reshape(shape),
    )
    for values in rays:
        values.setflags(write=False)
    return rays


class _Fan:
    """Rays from the middle of the stop, and the polynomial that maps points on the array back to their slopes."""

    def __init__(self, camera: SolvedCamera, plate: Plate, reach: float) -> None:
        scene, paraxial = camera.scene, camera.paraxial
        self._world = lens_alone(scene)
        lens = scene.camera.lens
        self._wavelength = scene.primary_nm
        after = lens.surfaces[paraxial.stop].thickness_mm or (scene.camera.mla and scene.camera.mla.distance_mm) or 0.0
        # Start behind the stop, which may be a glass surface, and well before the next surface.
        self._start = frames.points(pose_of(lens, paraxial.stop), [[0.0, 0.0, lens.vertices_mm[paraxial.stop]]])[0]
        # Rays in gradient-index glass are curved, so there they start closer.
        self._ahead = after * (CLOSE if lens.surfaces[paraxial.stop].gradient is not None else AHEAD)
        self._reach = reach
        array_z = lens.vertices_mm[-1] + (scene.camera.mla.distance_mm or 0.0 if scene.camera.mla else 0.0)
        m = paraxial.from_stop
        height = m.b + m.d * ((array_z - lens.vertices_mm[-1]) / paraxial.image_index)
        widest = 1.3 * reach / abs(height * paraxial.indices[paraxial.stop + 1])
        one = np.linspace(-widest, widest, FAN)
        slopes = np.stack(np.meshgrid(one, one), axis=-1).reshape(-1, 2)
        hit = plate.at_apexes(*self.trace(slopes))
        through = np.isfinite(hit[:, 0])
        if through.sum() < 2 * len(self._terms(np.zeros((1, 2)))[0]):
            raise LfmeshError(
                "camera: almost no ray from the middle of the stop reaches the microlens array; check apertures and "
                "distances with lfmesh check"
            )
        self._coefficients, *_ = np.linalg.lstsq(self._terms(hit[through]), slopes[through], rcond=None)

    def trace(self, slopes: Array) -> tuple[Array, Array]:
        """Return position and direction of rays from the stop, before the array, camera frame; NaN if lost.

        Parameters
        ----------
        slopes : (n, 2) float64
            dx/dz and dy/dz behind the stop; NaN is passed on.
        """
        ahead = np.column_stack([slopes, np.ones(len(slopes))])
        known = np.isfinite(slopes[:, 0])
        position, direction = np.full((2, len(slopes), 3), np.nan)
        paths = trace(
            self._world, self._start + self._ahead * ahead[known], ahead[known], self._wavelength, split="transmit"
        )  # fmt: skip
        arrived = paths.status == Status.SENSOR
        rays = np.flatnonzero(known)[paths.source[arrived]]
        position[rays], direction[rays] = paths.position[arrived], paths.direction[arrived]
        return position, direction

    def guess(self, apexes: Array) -> Array:
        """Return the slopes behind the stop, (n, 2), of rays that meet the array near (n, 2) points."""
        return self._terms(apexes) @ self._coefficients

    def derivative(self, apexes: Array) -> Array:
        """Return the derivative of points on the array by the rays' slopes, at (n, 2) points.

        (n, 2, 2) mm: the inverse of the polynomial's derivative.
        """
        by_x, by_y = (terms @ self._coefficients for terms in polynomial_slopes(apexes / self._reach, DEGREE))
        return np.asarray(np.linalg.inv(np.stack([by_x, by_y], axis=2) / self._reach))

    def _terms(self, points: Array) -> Array:
        return polynomial_terms(points / self._reach, DEGREE)


def polynomial_terms(points: Array, degree: int) -> Array:
    """Return the (n, terms) monomials x^i y^j, i + j ≤ degree, of (n, 2) points."""
    x, y = points.T
    return np.column_stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)])


def polynomial_slopes(points: Array, degree: int) -> tuple[Array, Array]:
    """Return the derivatives of `polynomial_terms` by x and by y, (n, terms) each."""
    x, y = points.T
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    by_x = np.column_stack([i * x ** max(i - 1, 0) * y**j for i, j in powers])
    by_y = np.column_stack([j * x**i * y ** max(j - 1, 0) for i, j in powers])
    return by_x, by_y
