"""Where rays are aimed: the lens's opening as targets and sensor see it, and which lenslets show it to a pixel."""

import numpy as np

from lfmesh.geometry import frame as frames
from lfmesh.geometry.lattice import ROW_SPACING, centre
from lfmesh.geometry.lenslets import cap_sag, shape_of
from lfmesh.geometry.mesh import Array
from lfmesh.geometry.surface import sag
from lfmesh.geometry.targets import TargetMesh
from lfmesh.kernel import kernel
from lfmesh.optics.glass import refractive_index
from lfmesh.scene import FirstOrder, Scene
from lfmesh.transport.aiming import WIDE_SHARE, WIDE_SHARE_OF_IMAGE_PATH
from lfmesh.transport.packet import (
    ARRAY_FRAME,
    CAMERA_FRAME,
    SENSOR_FRAME,
    WORLD_FRAME,
)
from lfmesh.transport.pupil import opening_from, outlook, paraxial_opening, real_opening, unknown_opening
from lfmesh.transport.tables import (
    Aim,
    ArrayTables,
    LensTables,
    Opening,
)

ABERRATION = 0.25
"""Third-order aberrations of a lenslet, in slope, over what it bends at its rim times the squared slopes there."""

FAR = 1e9
"""Distance in mm that stands for infinity."""

BORDER = 8
"""Points of an opening's border that are moved with it where the array is tilted."""


def aim_table(
    scene: Scene,
    report: FirstOrder,
    lens: LensTables,
    array: ArrayTables,
    targets: list[TargetMesh],
    moves: Array,
    *,
    analytic: bool,
) -> Aim:
    """Return where the rays of a scene are aimed.

    Parameters
    ----------
    analytic : bool
        Every surface of the lens has an exact parent, through which the opening is found; else first-order optics says
        where it is.
    """
    seen = np.concatenate(
        [frames.points(moves[WORLD_FRAME, CAMERA_FRAME], t.mesh.vertices) for t in targets] or [np.zeros((0, 3))]
    )
    width, height = (0.5 * size for size in scene.camera.sensor.size_mm)
    behind = frames.points(moves[SENSOR_FRAME, CAMERA_FRAME], _grid(width, height, 0.0))
    front_radius = widest_disk(lens, seen, front=True)
    back_radius = widest_disk(lens, behind, front=False)
    glass = 1.0
    if array.present and scene.camera.mla is not None:
        glass = refractive_index(scene.camera.mla.medium, report.wavelength_nm)
        lattice = array.lenslets.lattice
        apexes = _grid(*lattice.half_extent, _apex_z(array, glass)[1])
        behind = frames.points(moves[ARRAY_FRAME, CAMERA_FRAME], apexes)
    entrance = opening_seen(report, lens, seen, front_radius, analytic, front=True)
    exit_ = opening_seen(report, lens, behind, back_radius, analytic, front=False)
    # Reflections reach the sensor from all over the lens; without them only what the opening leaves out does.
    followed = scene.transport.split != "transmit"
    aim = Aim(
        entrance, front_radius, exit_, back_radius,
        WIDE_SHARE if followed else WIDE_SHARE_OF_IMAGE_PATH, 1.0 if followed else WIDE_SHARE_OF_IMAGE_PATH,
        0.0, 0.0, 0.0, 0.0, 0.0, np.zeros((1, 2)), np.zeros(1), 0.0, 0,
    )  # fmt: skip
    return _aim_through_lenslets(scene, report, array, aim, moves, glass) if array.present else aim


def opening_seen(
    report: FirstOrder, lens: LensTables, points: Array, wide_radius: float, analytic: bool, *, front: bool
) -> Opening:
    """Return a side of the lens as points (n, 3) (camera frame) see it."""
    plane_z = float(lens.box_low[2] if front else lens.box_high[2])
    seen = outlook(plane_z, wide_radius, points, to_sensor=front)
    if seen is None:
        return unknown_opening(plane_z, to_sensor=front)
    if analytic:
        return real_opening(seen, lens)
    z = report.entrance_pupil_z_mm if front else report.exit_pupil_z_mm
    diameter = report.entrance_pupil_diameter_mm if front else report.exit_pupil_diameter_mm
    if not np.isfinite(z):
        if front:
            return unknown_opening(plane_z, to_sensor=front)
        # Telecentric: a pupil so far away that all points see it in one direction.
        z, diameter = plane_z - FAR, FAR / report.working_f_number
    return paraxial_opening(seen, z, 0.5 * diameter)


def widest_disk(lens: LensTables, p: Array, *, front: bool) -> float:
    """Return the radius of a disk in the lens's outermost plane that every ray to it from points (n, 3) crosses."""
    surfaces = lens.surfaces
    plane = lens.box_low[2] if front else lens.box_high[2]
    outer = surfaces[0] if front else surfaces[-1]
    rim = float(max(abs(lens.box_low[0]), abs(lens.box_high[0]), abs(lens.box_low[1]), abs(lens.box_high[1])))
    edge = float(outer["vertex_z"] + sag(outer, outer["aperture"]))
    depth = abs(max(outer["vertex_z"], edge) - plane) if front else abs(plane - min(outer["vertex_z"], edge))
    distance = np.maximum((plane - p[:, 2]) if front else (p[:, 2] - plane), depth)
    spread = (np.hypot(p[:, 0], p[:, 1]) + rim) * np.divide(
        depth, distance, out=np.zeros_like(distance), where=distance > 0
    )
    return rim + float(spread.max(initial=0.0))


def _grid(half_width: float, half_height: float, z: float) -> Array:
    """Return the corners, the middles of the sides and the middle of a rectangle, (9, 3) mm."""
    return np.array([[i * half_width, j * half_height, z] for i in (-1, 0, 1) for j in (-1, 0, 1)])


def _apex_z(array: ArrayTables, glass: float) -> tuple[float, float]:
    """Return z (array frame) of the lenslets' apexes as the sensor and as the lens sees them, one through the plate."""
    thickness = array.lenslets.thickness
    through_plate = thickness - thickness / glass
    return (through_plate, 0.0) if array.curved_to_lens else (0.0, through_plate)


def _aim_through_lenslets(
    scene: Scene, report: FirstOrder, array: ArrayTables, aim: Aim, moves: Array, glass: float
) -> Aim:
    """Add which lenslets show the exit pupil to a point of the sensor: each one's view of it, and its own blur.

    A ray from x through a lenslet's point c + u leaves it with slope (c + u − x)/d − φ (u − e), e the apex's decentre.
    The opening lies at slope σ − κ u from there: so from the lenslet's middle, at φ e − σ off (c − x)/d, give or take
    |κ + 1/d − φ| |u|.
    """
    lattice = array.lenslets.lattice
    sensor_z, lens_z = _apex_z(array, glass)
    middle = np.array([[0.0, 0.0, lens_z]])
    to_pupil = float(frames.points(moves[ARRAY_FRAME, CAMERA_FRAME], middle)[0, 2]) - report.exit_pupil_z_mm
    vergence = 1.0 / to_pupil if np.isfinite(to_pupil) else 0.0
    pupil = [0.0, 0.0, report.exit_pupil_z_mm if np.isfinite(to_pupil) else scene.camera.lens.vertices_mm[-1]]
    pupil_x, pupil_y, _ = frames.points(moves[CAMERA_FRAME, ARRAY_FRAME], [pupil])[0]
    width, height = (0.5 * size for size in scene.camera.sensor.size_mm)
    corners = frames.points(moves[SENSOR_FRAME, ARRAY_FRAME], _grid(width, height, 0.0))
    distance = np.abs(corners[:, 2] - sensor_z)
    cells = lattice.columns * lattice.rows
    slope, slope_radius = np.zeros((cells, 2)), np.zeros(cells)
    _view_through_cells(
        array, aim.exit, moves, lens_z, glass - 1.0, vergence, 1.0 / distance.max(), 1.0 / distance.min(),
        lattice.circumradius, slope, slope_radius,
    )  # fmt: skip
    seen = slope_radius > 0.0
    # The cells that show the opening to a point lie this far at most from where its chief ray meets the array; a row
    # of a hexagonal lattice is nearer than a pitch and half a pitch aside.
    off_chief = vergence * (lattice.centres().reshape(-1, 2) - [pupil_x, pupil_y]) + slope
    reach = np.where(seen, np.hypot(off_chief[:, 0], off_chief[:, 1]) + slope_radius, 0.0).max()
    reach /= (vergence + 1.0 / distance.max()) * lattice.pitch
    steepest = np.where(seen, np.hypot(slope[:, 0], slope[:, 1]) + slope_radius, 0.0).max()
    low, high = _border_depths(array)
    shortened = 1.0 / glass if array.curved_to_lens else 1.0
    return aim._replace(
        lenslet_z=sensor_z,
        border_z=sensor_z + 0.5 * (low + high) * shortened,
        pupil_x=pupil_x,
        pupil_y=pupil_y,
        pupil_vergence=vergence,
        slope=slope,
        slope_radius2=np.where(seen, slope_radius**2, -1.0),
        cell_margin=0.5 * (high - low) * shortened * (steepest + lattice.circumradius / distance.min()),
        search=int(reach / ROW_SPACING + 1.0) if lattice.hexagonal else int(reach + 0.5),
    )


def _border_depths(array: ArrayTables) -> tuple[float, float]:
    """Return the smallest and the largest z of the lenslets' faces on the borders of their cells, array frame, mm."""
    lenslets = array.lenslets
    stretch = lenslets.stretch if len(lenslets.stretch) else np.ones(1)
    curvatures = np.outer(lenslets.curvature, [stretch.min(), stretch.max()]).ravel()
    astray = np.hypot(lenslets.decentre[:, 0], lenslets.decentre[:, 1]).max() if len(lenslets.decentre) else 0.0
    nearest, furthest = max(0.5 * lenslets.lattice.pitch - astray, 0.0), lenslets.lattice.circumradius + astray
    depths = [cap_sag(c, r * r) for c in curvatures for r in (nearest, furthest)]
    return min(depths), max(depths)


@kernel
def _view_through_cells(
    array: ArrayTables, opening: Opening, moves: Array, lens_z: float, power_of_curvature: float,
    vergence: float, least_over: float, most_over: float, corner: float, slope: Array, slope_radius: Array,
) -> None:  # fmt: skip
    """Write for every lenslet the slope (array frame, away from the sensor) at which it sees the opening's middle.

    And how far from that a ray through its middle may go for another one through it to meet the opening; −1 for none.
    """
    lenslets = array.lenslets
    lattice = lenslets.lattice
    toward = -1.0 if array.curved_to_lens else 1.0
    for row in range(lattice.rows):
        for column in range(lattice.columns):
            cell = row * lattice.columns + column
            cx, cy = centre(lattice, column, row)
            x, y, z = frames.move_point(moves, ARRAY_FRAME, CAMERA_FRAME, cx, cy, lens_z)
            mx, my, radius = opening_from(opening, x, y, z)
            if radius <= 0.0:
                slope_radius[cell] = -1.0
                continue
            depth = opening.plane_z - z
            sx, sy = _slope(moves, mx - x, my - y, depth, toward)
            widest = 0.0
            for k in range(BORDER):
                angle = 2.0 * np.pi * k / BORDER
                bx, by = mx + radius * np.cos(angle), my + radius * np.sin(angle)
                ax, ay = _slope(moves, bx - x, by - y, depth, toward)
                widest = max(widest, np.hypot(ax - sx, ay - sy))
            curvature, ex, ey = shape_of(lenslets, column, row)
            power = power_of_curvature * curvature
            defocus = max(abs(vergence + least_over - power), abs(vergence + most_over - power))
            bend = abs(power) * corner
            steep = bend + widest
            blur = defocus * corner + ABERRATION * bend * (steep * steep + sx * sx + sy * sy)
            slope[cell, 0], slope[cell, 1] = sx - power * ex, sy - power * ey
            slope_radius[cell] = widest + blur


@kernel
def _slope(moves: Array, dx: float, dy: float, dz: float, toward: float) -> tuple[float, float]:
    """Return the slope, array frame, of a direction of the camera frame."""
    x, y, z = frames.move_direction(moves, CAMERA_FRAME, ARRAY_FRAME, dx, dy, dz)
    return x / (toward * z), y / (toward * z)
