"""Aim tables of a scene: the lens's opening as seen from targets and sensor."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.geometry.index_media import any_bends
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.objects.targets import TargetMesh
from lfmesh.geometry.surfaces.bends import rim_hull
from lfmesh.geometry.surfaces.surface import is_revolved
from lfmesh.scene import FirstOrder, Scene
from lfmesh.scene.first_order.cover import cover_shift_mm
from lfmesh.transport.aims.fitting import decentred
from lfmesh.transport.aims.lenslet_view import aim_through_lenslets, apex_z, grid, no_lenslets
from lfmesh.transport.aims.mixture import WIDE_SHARE, WIDE_SHARE_OF_IMAGE_PATH, anywhere
from lfmesh.transport.aims.near_points import NearViewpoints, near_viewpoints
from lfmesh.transport.aims.pupil import (
    Viewpoints,
    closed_opening,
    paraxial_near,
    paraxial_opening,
    real_near,
    real_opening,
    viewpoints,
)
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME, WORLD_FRAME
from lfmesh.transport.sequences.stop_rays import CameraTables, CoverPlate
from lfmesh.transport.tables.gradient_spaces import is_revolved_by_gradients, unposed
from lfmesh.transport.tables.lines import Lines
from lfmesh.transport.tables.phase_faces import is_revolved_by_phase, spreads_light
from lfmesh.transport.tables.tables import (
    AimTables,
    Camera,
    Disks,
    LensAim,
    LensTables,
    Opening,
)

FAR = 1e9
"""Distance in mm that stands for infinity."""

Shapes = tuple[tuple[Array, NDArray[np.intp]], ...]
"""Corners of surfaces and convex bodies, (n, 3) mm, and pairs of joined corners, (m, 2)."""

DISTANT, WIDE = 1e4, 10.0
"""Visible depth of an unbounded medium, in radii of the lens's front, and tangent of its field angle."""

CORNERS = 8
"""Number of corners of a box."""


def shapes_in_camera(targets: list[TargetMesh], boxes: Array, moves: Array) -> Shapes:
    """Return the corners of targets and boxes, camera frame, and each shape's pairs of joined corners.

    Parameters
    ----------
    targets : list of TargetMesh
        In the world frame.
    boxes : (8 n, 3) float64, mm, camera frame
        Corners of boxes, all joined.
    moves : (6, 6, 3, 4) float64
        Between frames, see `frame_table`.
    """
    to_camera = moves[WORLD_FRAME, CAMERA_FRAME]
    pairs = np.stack(np.triu_indices(CORNERS, 1), axis=1)
    return (
        *((frame.points(to_camera, hull.vertices), hull.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2))
          for hull in (t.hull for t in targets)),
        *((boxes[first : first + CORNERS], pairs) for first in range(0, len(boxes), CORNERS)),
    )  # fmt: skip


def all_before(lens: LensTables) -> Array:
    """Return the corners of an unbounded medium before the lens, camera frame, (8, 3) mm.

    Its sides exceed the field angle of any lens.
    """
    near = float(lens.surfaces[0]["semi_diameter"])
    far = DISTANT * near
    return np.array(
        [(x * WIDE * size, y * WIDE * size, lens.box_low[2] - z)
         for x in (-1.0, 1.0) for y in (-1.0, 1.0) for size, z in ((near, 0.0), (far, far))]
    )  # fmt: skip


class Unproven(NamedTuple):
    """Aim tables of a scene, with the data to prove them.

    Attributes
    ----------
    aim : AimTables
    through : CameraTables
        Camera for rays from the stop.
    seen : Viewpoints or None
        Viewpoints of the targets; None if no target lies before the lens.
    near : NearViewpoints or None
        Viewpoints close before the lens.
    fits : bool
        Rays from the stop may widen the aim.
    """

    aim: AimTables
    through: CameraTables
    seen: Viewpoints | None
    near: NearViewpoints | None
    fits: bool


def _points_of(shapes: Shapes) -> Array:
    """Return the corners of all shapes, (n, 3) mm."""
    return np.concatenate([points for points, _ in shapes] or [np.zeros((0, 3))])


def aim_table(scene: Scene, report: FirstOrder, camera: Camera, shapes: Shapes, *, analytic: bool) -> Unproven:
    """Return a scene's aim tables, not yet proved by rays from the stop.

    Parameters
    ----------
    scene : Scene
    report : FirstOrder
    camera : Camera
        Tables of the scene, without absorption; frames with the sensor at its apparent place.
    shapes : of (points (n, 3) float64, mm, camera frame; edges (m, 2) int)
        Sources of light: corners of targets and media, and round particles, see `shapes_in_camera`.
    analytic : bool
        All lens surfaces are exact: find the opening by real rays, else by first-order optics.
    """
    lens, mla, sensor, moves = camera.lens, camera.mla, camera.sensor, camera.frames
    through = CameraTables(lens, mla, sensor, moves, _cover_of(scene))
    if spreads_light(lens.interfaces) or spreads_light(mla.interfaces):
        return Unproven(_anywhere(scene, camera, shapes), through, None, None, fits=False)
    seen = _points_of(shapes)
    behind = _sensor_corners(scene, moves)
    front_radius = widest_disk(lens, seen, front=True)
    back_radius = widest_disk(lens, behind, front=False)
    glass = 1.0
    if mla.present and scene.camera.mla is not None:
        if mla.back is None:
            # Lenslets on both faces are seen without a plate before them.
            glass = scene.camera.relative_index(scene.camera.mla.medium, report.wavelength_nm)
        lattice = mla.lenslets.lattice
        apexes = grid(*lattice.half_extent, apex_z(mla, glass)[1])
        behind = frame.points(moves[MLA_FRAME, CAMERA_FRAME], apexes)
    near, disks = _seen_close(report, lens, shapes, analytic)
    if near is not None and not has_glass(scene):
        # Rays from near points go everywhere; rays from glass are aimed only at a disk.
        front_radius = widest_disk(lens, seen, front=True, nearest=near.depth)
    from_targets = viewpoints(float(lens.box_low[2]), front_radius, seen, to_sensor=True, near=near)
    revolved = (
        all(map(is_revolved, lens.surfaces))
        and is_revolved_by_phase(lens.interfaces)
        and is_revolved_by_gradients(lens.gradients)
    )
    posed = has_poses(lens) or not revolved
    entrance = opening_seen(report, lens, seen, front_radius, analytic, front=True, near=near)
    if near is not None and disks is not None:
        entrance = entrance._replace(near=disks, near_depth=near.depth)
    exit_ = opening_seen(report, lens, behind, back_radius, analytic, front=False)
    if posed:
        # Poses move the openings' disks, and other sections pass other field angles; the proof widens the disks.
        entrance, exit_ = decentred(entrance, exit_, through)
    aim = before_array(scene, (entrance, exit_), (front_radius, back_radius))
    if mla.present:
        lenslets = aim_through_lenslets(scene, report, mla, exit_, moves, sensor, glass)
        aim = aim._replace(lenslets=lenslets)
    # Surfaces fitted to meshes show how much poses widen the openings.
    return Unproven(aim, through, from_targets, near, fits=analytic or posed)


def _sensor_corners(scene: Scene, moves: Array) -> Array:
    """Return corners, side midpoints and centre of the sensor, (9, 3) mm, camera frame."""
    width, height = (0.5 * size for size in scene.camera.sensor.size_mm)
    return frame.points(moves[SENSOR_FRAME, CAMERA_FRAME], grid(width, height, 0.0))


def _cover_of(scene: Scene) -> CoverPlate | None:
    """Return the plate before a scene's sensor; None without one."""
    camera, cover = scene.camera, scene.camera.sensor.cover
    if cover is None:
        return None
    indices = [camera.relative_index(cover.medium, wavelength) for wavelength in Lines.of(scene).wavelengths_nm]
    return CoverPlate(cover.thickness_mm, cover_shift_mm(camera, scene.primary_nm), np.array(indices))


def has_glass(scene: Scene) -> bool:
    """Tell whether glass or liquid stands before the camera, or a medium that bends light."""
    glass = bool(scene.tanks) or any(target.refractor is not None for target in scene.targets)
    return glass or any_bends(scene)


def _near_points(lens: LensTables, shapes: Shapes) -> NearViewpoints | None:
    """Return viewpoints closer to the lens than its front's semi-diameter; None without any."""
    return near_viewpoints(float(lens.box_low[2]), float(lens.surfaces[0]["semi_diameter"]), shapes)


def _seen_close(
    report: FirstOrder, lens: LensTables, shapes: Shapes, analytic: bool
) -> tuple[NearViewpoints | None, Disks | None]:
    """Return close viewpoints that see light through the lens, and the opening from them; None without any."""
    near = _near_points(lens, shapes)
    if near is None:
        return None, None
    z, diameter = _pupil(report, lens, front=True)
    seen = Viewpoints(float(lens.box_low[2]), near.depth, True, np.zeros(0), np.zeros(0))
    if not analytic:
        return near, paraxial_near(seen, near, z, 0.5 * diameter)
    near, found = real_near(seen, near, _as_prescribed(lens), z, 0.5 * diameter)
    return (near, found) if found is not None else (None, None)


def _anywhere(scene: Scene, camera: Camera, shapes: Shapes) -> AimTables:
    """Return the aim tables of a scattering camera, with light from anywhere on the lens."""
    lens, mla = camera.lens, camera.mla
    behind = _sensor_corners(scene, camera.frames)
    near = _near_points(lens, shapes)
    depth = near.depth if near is not None else 0.0
    nearest = 0.0 if has_glass(scene) else depth
    radii = (
        widest_disk(lens, _points_of(shapes), front=True, nearest=nearest), widest_disk(lens, behind, front=False)
    )  # fmt: skip
    planes = float(lens.box_low[2]), float(lens.box_high[2])
    openings = (
        closed_opening(planes[0], to_sensor=True, near_depth=depth), closed_opening(planes[1], to_sensor=False)
    )  # fmt: skip
    cells = mla.lenslets.lattice.columns * mla.lenslets.lattice.rows if mla.present else 1
    return before_array(scene, openings, radii)._replace(lenslets=no_lenslets(cells))


def before_array(scene: Scene, openings: tuple[Opening, Opening], radii: tuple[float, float]) -> AimTables:
    """Return aim tables with the openings of the lens but no lenslets.

    Parameters
    ----------
    scene : Scene
    openings : (entrance, exit) of Opening
    radii : (front, back), mm
        Radii of the disks that every ray to the lens crosses.
    """
    # Reflections reach the sensor from all over the lens; without them the wide disk only adds light beside the
    # measured opening.
    followed = scene.transport.split != "transmit"
    shares = (WIDE_SHARE, 1.0) if followed else (WIDE_SHARE_OF_IMAGE_PATH, WIDE_SHARE_OF_IMAGE_PATH)
    sides = [LensAim(opening, radius, *shares) for opening, radius in zip(openings, radii, strict=True)]
    # The table of an unknown opening is closed everywhere.
    entrance, exit_ = (side if (side.opening.far.radius > 0.0).any() else anywhere(side) for side in sides)
    return AimTables(entrance, exit_, no_lenslets(1))


def unaimed(scene: Scene, lens: LensTables) -> AimTables:
    """Return aim tables without a known opening: rays go anywhere on the lens's box."""
    planes = float(lens.box_low[2]), float(lens.box_high[2])
    radius = float(np.hypot(lens.box_high[0], lens.box_high[1]))
    openings = closed_opening(planes[0], to_sensor=True), closed_opening(planes[1], to_sensor=False)
    return before_array(scene, openings, (radius, radius))


def has_poses(lens: LensTables) -> bool:
    """Tell whether a lens surface or the stop is displaced."""
    return bool(lens.surfaces["posed"].any()) or lens.stop_posed


def without_poses(lens: LensTables) -> LensTables:
    """Return the tables of a lens in its prescribed place."""
    surfaces = lens.surfaces.copy()
    surfaces["posed"] = 0
    return lens._replace(surfaces=surfaces, stop_posed=False, gradients=unposed(lens.gradients))


def opening_seen(
    report: FirstOrder, lens: LensTables, points: Array, wide_radius: float, analytic: bool, *, front: bool,
    near: NearViewpoints | None = None,
) -> Opening:  # fmt: skip
    """Return the opening of one side of the lens, without poses, as seen from points.

    For a lens without rotational symmetry it is that of the x–z section.

    Parameters
    ----------
    report : FirstOrder
    lens : LensTables
    points : (n, 3) float64, mm, camera frame
    wide_radius : float, mm
        Radius of the disk that every ray to the lens crosses.
    analytic : bool
        See `aim_table`.
    front : bool
        Object side of the lens; else sensor side.
    near : NearViewpoints, optional
        Close points, with their own table.
    """
    plane_z = float(lens.box_low[2] if front else lens.box_high[2])
    seen = viewpoints(plane_z, wide_radius, points, to_sensor=front, near=near)
    if seen is None or (front and not analytic and not np.isfinite(report.entrance_pupil_z_mm)):
        return closed_opening(plane_z, to_sensor=front)
    z, diameter = _pupil(report, lens, front=front)
    if analytic:
        return real_opening(seen, _as_prescribed(lens), z, 0.5 * diameter)
    return paraxial_opening(seen, z, 0.5 * diameter)


def _pupil(report: FirstOrder, lens: LensTables, *, front: bool) -> tuple[float, float]:
    """Return z and diameter of one side's paraxial pupil, mm."""
    z = report.entrance_pupil_z_mm if front else report.exit_pupil_z_mm
    diameter = report.entrance_pupil_diameter_mm if front else report.exit_pupil_diameter_mm
    if not np.isfinite(z):
        # Telecentric: the pupil is so far away that all points see it in the same direction.
        plane_z = float(lens.box_low[2] if front else lens.box_high[2])
        return (plane_z + FAR, FAR) if front else (plane_z - FAR, FAR / (report.image_index * report.working_f_number))
    return z, diameter


def _as_prescribed(lens: LensTables) -> LensTables:
    """Return the tables of a lens without poses."""
    return without_poses(lens) if has_poses(lens) else lens


def widest_disk(lens: LensTables, p: Array, *, front: bool, nearest: float = 0.0) -> float:
    """Return the radius, mm, of a disk in the lens's outermost plane crossed by all rays from points to the lens.

    Parameters
    ----------
    lens : LensTables
    p : (n, 3) float64, mm, camera frame
    front : bool
        Object side of the lens; else sensor side.
    nearest : float, mm
        Rays from closer points need not cross the disk.
    """
    surfaces = lens.surfaces
    plane = lens.box_low[2] if front else lens.box_high[2]
    outer = surfaces[0] if front else surfaces[-1]
    rim = float(max(abs(lens.box_low[0]), abs(lens.box_high[0]), abs(lens.box_low[1]), abs(lens.box_high[1])))
    # Rays reach depths beyond the rim through the rim, and smaller depths nearer to the plane.
    z = np.concatenate([rim_hull(outer, r)[:, 2] for r in (0.0, float(outer["semi_diameter"]))])
    depth = abs(float(z.max() if front else z.min()) - plane)
    distance = np.maximum((plane - p[:, 2]) if front else (p[:, 2] - plane), max(depth, nearest))
    spread = (np.hypot(p[:, 0], p[:, 1]) + rim) * np.divide(
        depth, distance, out=np.zeros_like(distance), where=distance > 0
    )
    return rim + float(spread.max(initial=0.0))
