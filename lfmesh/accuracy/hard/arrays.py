"""Microlens arrays: small, large, far away, and rays along the borders of their cells."""

import numpy as np

from lfmesh.accuracy.analytic_phases import only_order
from lfmesh.accuracy.hard.outcome import SINGLET, Outcome, case, disk, lens_scene, on_sensor
from lfmesh.accuracy.hard.truth import Array, Plate
from lfmesh.geometry.frame import directions, frame, inverse, points
from lfmesh.scene import BackFace, MicrolensArray, Pose
from lfmesh.scene.camera.phase import MetalensPhase
from lfmesh.transport.build import build
from lfmesh.transport.trace import trace

PRIMARY_NM = 587.6

BEHIND_LENS = 10.0
"""Distance from the lens to the array, mm."""


def _array(
    plate: Plate, start: Array, towards: Array, *, pose: Pose | None = None, around: int = 3, outside: float = 1.0,
    tolerance: float = 1e-12, relative: float = 1e-12,
) -> Outcome:  # fmt: skip
    """Trace rays, given in the array's frame, to the sensor behind it, which moves with the array.

    The plate's index is relative to `outside`, the index of the medium around it.
    """
    pose = pose or Pose()
    mla = MicrolensArray(
        layout="hexagonal" if plate.hexagonal else "square", count=(plate.columns, plate.rows), pitch_mm=plate.pitch,
        radius_mm=(plate.radius,) if np.isfinite(plate.radius) else None, conic=(plate.conic,),
        asphere_mm=(plate.asphere,), index=plate.index * outside,
        thickness_mm=plate.thickness, distance_mm=BEHIND_LENS, pose=pose,
        back=BackFace(radius_mm=plate.back_radius) if np.isfinite(plate.back_radius) else None,
        curved_phase=None if plate.order is None else plate.order.phase,
    )  # fmt: skip
    lens_end = sum(surface.thickness_mm or 0.0 for surface in SINGLET)
    scene = lens_scene(
        SINGLET, mla=mla, sensor_mm=max(60.0, 3.0 * plate.columns * plate.pitch), distance=plate.to_sensor
    ).changed({"camera.image_medium": {"index": outside}})
    if pose != Pose():
        scene = scene.model_copy(
            update={"camera": scene.camera.model_copy(update={"sensor": scene.camera.sensor.model_copy(
                update={"pose": _sensor_pose(pose, plate)})})}
        )  # fmt: skip
    # From the array's frame to the camera's.
    placed = frame(pose.tilt_deg, np.add([0.0, 0.0, lens_end + BEHIND_LENS], pose.shift_mm))
    o, d = points(placed, start), directions(placed, towards)
    # The truth gets the engine's ray, including its rounding in the camera's frame.
    back = inverse(placed)
    landings, weights = plate.land(points(back, o), directions(back, d), around)
    landings = np.stack([points(placed, landing) for landing in landings])
    paths = trace(build(scene), o, d, split="transmit")
    if len(paths) == len(o):
        # On a border several answers are right; the engine may give any of them.
        distance = np.linalg.norm(landings - paths.position, axis=-1)
        nearest = np.argmin(np.where(np.isfinite(distance), distance, np.inf), axis=0)
        every = np.arange(len(o))
        return on_sensor(paths, landings[nearest, every], weights[nearest, every], tolerance, relative=relative)
    return on_sensor(paths, landings[0], weights[0], tolerance)


def _sensor_pose(pose: Pose, plate: Plate) -> Pose:
    """Return the pose that keeps the sensor fixed relative to the array."""
    nominal = plate.thickness + plate.to_sensor
    turned = frame(pose.tilt_deg)[:, 2] * nominal
    shift = np.add(pose.shift_mm, turned) - [0.0, 0.0, nominal]
    return Pose(shift_mm=tuple(float(s) for s in shift), tilt_deg=pose.tilt_deg)


def _cone(count: int, radius: float, slope: float) -> tuple[Array, Array]:
    """Return rays in the array's frame that meet a disk of it at slopes up to one value."""
    d = np.column_stack([disk(slope, count, 7), np.ones(count)])
    at = np.column_stack([disk(radius, count, 8), np.zeros(count)])
    return at - 2.0 * d, d


def _small(pitch: float) -> Outcome:
    plate = Plate(False, pitch, 101, 101, 2.0 * pitch, 3.0 * pitch, 1.5, 2.0 * pitch)
    o, d = _cone(20_000, 45.0 * pitch, 0.4)
    return _array(plate, o, d)


@case
def lenslets_5_um() -> Outcome:
    """Cross lenslets of 5 µm."""
    return _small(0.005)


@case
def lenslets_14_um() -> Outcome:
    """Cross lenslets of 14 µm."""
    return _small(0.014)


@case
def lenslets_14_um_in_oil() -> Outcome:
    """Cross lenslets of 14 µm in oil, at slopes up to 1.5."""
    plate = Plate(False, 0.014, 101, 101, 0.028, 0.042, 1.2, 0.028)
    o, d = _cone(20_000, 0.6, 1.5)
    return _array(plate, o, d, outside=1.5)


@case
def lenslets_500_um() -> Outcome:
    """Cross lenslets of 500 µm."""
    return _small(0.5)


@case
def far_and_tilted() -> Outcome:
    """Place the array 1 m from the origin, tilted by 10 degrees."""
    plate = Plate(False, 0.125, 65, 65, 0.25, 0.3, 1.5, 0.3)
    o, d = _cone(20_000, 3.5, 0.4)
    pose = Pose(shift_mm=(0.0, 0.0, 1000.0), tilt_deg=(10.0, 0.0, 0.0))
    return _array(plate, o, d, pose=pose, tolerance=1e-10)


@case
def lytro_size() -> Outcome:
    """Cross a hexagonal array of 541 by 434 lenslets of 14 µm."""
    plate = Plate(True, 0.014, 541, 434, 0.03, 0.1, 1.5, 0.025)
    o, d = _cone(20_000, 2.5, 0.25)
    return _array(plate, o, d)


def _both_faces(hexagonal: bool, steep: float) -> Outcome:
    """Cross a plate with lenslets on both faces, almost touching at their corners in the glass."""
    corner = 0.125 / np.sqrt(3.0 if hexagonal else 2.0)
    radius = steep * corner
    thickness = (1.0 + 1e-9) * 2.0 * (radius - np.sqrt(radius**2 - corner**2))
    plate = Plate(hexagonal, 0.125, 65, 65, radius, thickness, 1.3, 0.3, back_radius=radius)
    o, d = _cone(20_000, 3.0, 0.02)
    return _array(plate, o, d)


@case
def two_faces() -> Outcome:
    """Cross square lenslets on both faces of a plate, almost touching at their corners."""
    return _both_faces(False, 2.0)


@case
def two_hexagonal_faces() -> Outcome:
    """Cross hexagonal lenslets on both faces of a plate, almost touching at their corners."""
    return _both_faces(True, 2.5)


def _borders(hexagonal: bool, conic: float = 0.0) -> Outcome:
    """Aim rays into the planes of cell borders, along them, and through the corners of cells."""
    plate = Plate(hexagonal, 0.125, 33, 33, 0.15, 0.3, 1.5, 0.3, conic=conic)
    draw = np.random.default_rng(11)
    n = 3000
    column, row = draw.integers(8, 25, n), draw.integers(8, 25, n)
    centre = plate.centres(column, row)
    turn = np.deg2rad(np.arange(30, 390, 60) if hexagonal else np.arange(45, 405, 90))
    corner = (0.125 / np.sqrt(3.0 if hexagonal else 2.0)) * np.column_stack([np.cos(turn), np.sin(turn)])
    side = draw.integers(0, len(corner), n)
    a, b = corner[side], corner[(side + 1) % len(corner)]
    share = draw.uniform(size=(n, 1))
    along = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
    through_corner = centre + a
    on_border = centre + a + share * (b - a)
    at = np.concatenate([through_corner, on_border, on_border])
    d = np.ones((3 * n, 3))
    d[:, :2] = np.concatenate(
        [0.3 * draw.normal(size=(n, 2)), draw.uniform(-0.4, 0.4, (n, 1)) * along, np.zeros((n, 2))]
    )
    # The target point is on the border's plane in the middle of the layer, in front of the faces.
    start = np.column_stack([at, np.full(3 * n, 0.02)]) - 2.0 * d
    return _array(plate, start, d, around=4, tolerance=1e-11, relative=1e-10)


@case
def square_borders() -> Outcome:
    """Aim rays along cell borders and through cell corners of a square array."""
    return _borders(False)


@case
def hexagonal_borders() -> Outcome:
    """Aim rays along cell borders and through cell corners of a hexagonal array."""
    return _borders(True)


@case
def across_cells() -> Outcome:
    """Cross several cells inside the layer of curved faces, at slopes up to 8."""
    plate = Plate(True, 0.1, 101, 101, 0.06, 0.2, 1.3, 0.02)
    draw = np.random.default_rng(12)
    n = 20_000
    slope, phi = draw.uniform(1.0, 8.0, n), draw.uniform(0.0, 2.0 * np.pi, n)
    d = np.column_stack([slope * np.cos(phi), slope * np.sin(phi), np.ones(n)])
    start = np.column_stack([disk(2.0, n, 13), np.zeros(n)]) - 0.5 * d
    return _array(plate, start, d, around=7, tolerance=1e-8, relative=1e-8)


@case
def lenslets_that_turn_back() -> Outcome:
    """Cross hexagonal aspheres, deepest at 0.8 of the distance to their corners, at slopes up to 0.8."""
    pitch, radius = 0.125, 0.2
    deepest = 0.8 * pitch / np.sqrt(3.0)
    plate = Plate(True, pitch, 65, 65, radius, 0.3, 1.5, 0.3, conic=-1.0, asphere=(-0.25 / (radius * deepest**2),))
    o, d = _cone(8_000, 3.0, 0.8)
    return _array(plate, o, d, around=2, tolerance=1e-11, relative=1e-10)


@case
def borders_of_hyperbolic_lenslets() -> Outcome:
    """Aim rays along cell borders and through cell corners of a square array of hyperboloids."""
    return _borders(False, conic=-2.25)


@case
def metalens_lenslets() -> Outcome:
    """Cross flat hexagonal metalenses of f/0.9 at slopes up to 0.5, where light leaves at up to 81 degrees."""
    phase = MetalensPhase(focal_length_mm=0.1125, design_nm=PRIMARY_NM)
    order = only_order(phase, PRIMARY_NM, None, 1.46, "curved_phase")
    plate = Plate(True, 0.125, 65, 65, np.inf, 0.3, 1.46, 0.3, order=order)
    o, d = _cone(20_000, 3.3, 0.5)
    return _array(plate, o, d, tolerance=1e-10, relative=1e-10)
