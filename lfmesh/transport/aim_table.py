"""Where rays are aimed: pupils and bounding disks from first-order optics, and which lenslets show the pupil."""

import numpy as np

from lfmesh.geometry import frame as frames
from lfmesh.geometry.lattice import ROW_SPACING
from lfmesh.geometry.mesh import Array
from lfmesh.geometry.surface import sag
from lfmesh.geometry.targets import TargetMesh
from lfmesh.optics.glass import refractive_index
from lfmesh.scene import FirstOrder, Scene
from lfmesh.transport.packet import (
    ARRAY_FRAME,
    CAMERA_FRAME,
    SENSOR_FRAME,
    WORLD_FRAME,
)
from lfmesh.transport.tables import (
    Aim,
    ArrayTables,
    LensTables,
)

PUPIL_MARGIN = 1.15
"""How much wider than the paraxial pupil the disk is that most rays are aimed at: pupils have aberrations."""


def aim_table(
    scene: Scene,
    report: FirstOrder,
    lens: LensTables,
    array: ArrayTables,
    targets: list[TargetMesh],
    moves: Array,
) -> Aim:
    """Return where the rays of a scene are aimed."""
    front_radius = _wide_radius(
        lens, [frames.points(moves[WORLD_FRAME, CAMERA_FRAME], t.mesh.vertices) for t in targets], front=True
    )
    width, height = (0.5 * size for size in scene.camera.sensor.size_mm)
    corners = np.array([[sx * width, sy * height, 0.0] for sx in (-1, 1) for sy in (-1, 1)])
    back_radius = _wide_radius(lens, [frames.points(moves[SENSOR_FRAME, CAMERA_FRAME], corners)], front=False)
    aim = Aim(
        report.entrance_pupil_z_mm,
        PUPIL_MARGIN * 0.5 * report.entrance_pupil_diameter_mm,
        float(lens.box_low[2]),
        front_radius,
        report.exit_pupil_z_mm,
        PUPIL_MARGIN * 0.5 * report.exit_pupil_diameter_mm,
        float(lens.box_high[2]),
        back_radius,
        0.0, 0.0, 0.0, 0.0, 0.0, np.zeros(1), 0.0, 0.0, 0,
    )  # fmt: skip
    # A pupil at infinity, or wider than the lens, is no place to aim at.
    if not np.isfinite(aim.entrance_z) or aim.entrance_radius > front_radius:
        aim = aim._replace(entrance_z=0.0, entrance_radius=0.0)
    if not array.present:
        if not np.isfinite(aim.exit_z) or aim.exit_radius > back_radius:
            aim = aim._replace(exit_z=0.0, exit_radius=0.0)
        return aim
    return _aim_through_lenslets(scene, report, array, aim, moves)


def _wide_radius(lens: LensTables, points: list[Array], *, front: bool) -> float:
    """Return the radius of a disk in the outermost plane of the lens that every ray from `points` to it crosses."""
    surfaces = lens.surfaces
    plane = lens.box_low[2] if front else lens.box_high[2]
    outer = surfaces[0] if front else surfaces[-1]
    rim = float(max(abs(lens.box_low[0]), abs(lens.box_high[0]), abs(lens.box_low[1]), abs(lens.box_high[1])))
    edge = float(outer["vertex_z"] + sag(outer, outer["aperture"]))
    depth = abs(max(outer["vertex_z"], edge) - plane) if front else abs(plane - min(outer["vertex_z"], edge))
    radius = 0.0
    for p in points:
        distance = np.maximum((plane - p[:, 2]) if front else (p[:, 2] - plane), depth)
        spread = (np.hypot(p[:, 0], p[:, 1]) + rim) * np.divide(
            depth, distance, out=np.zeros_like(distance), where=distance > 0
        )
        radius = max(radius, float(spread.max(initial=0.0)))
    return rim + radius


def _aim_through_lenslets(scene: Scene, report: FirstOrder, array: ArrayTables, aim: Aim, moves: Array) -> Aim:
    """Add the paraxial quantities that tell which lenslets show the exit pupil to a pixel."""
    mla = scene.camera.mla
    assert mla is not None
    glass = refractive_index(mla.medium, report.wavelength_nm)
    plate = mla.thickness_mm / glass
    to_sensor = scene.camera.sensor.distance_mm or 0.0
    to_pupil = scene.camera.lens.vertices_mm[-1] + (mla.distance_mm or 0.0) - report.exit_pupil_z_mm
    if array.curved_to_lens:
        to_sensor += plate
    else:
        to_pupil += plate
    vergence = 1.0 / to_pupil if np.isfinite(to_pupil) else 0.0
    slope = PUPIL_MARGIN / (2.0 * report.working_f_number)
    if np.isfinite(to_pupil):
        slope = abs(aim.exit_radius * vergence)
    power = (glass - 1.0) * array.lenslets.curvature
    pitch, radius = array.lenslets.lattice.pitch, array.lenslets.lattice.circumradius
    blur = np.abs(vergence + 1.0 / to_sensor - power).max() * radius
    # The lenslets that light a pixel lie this far at most from where its chief ray meets the array; a row of a
    # hexagonal lattice is nearer than a pitch and half a pitch aside.
    reach = to_sensor * (slope + blur) / pitch
    search = int(reach / ROW_SPACING + 1.0) if array.lenslets.lattice.hexagonal else int(reach + 0.5)
    pupil = [0.0, 0.0, report.exit_pupil_z_mm if np.isfinite(to_pupil) else scene.camera.lens.vertices_mm[-1]]
    pupil_x, pupil_y, _ = frames.points(moves[CAMERA_FRAME, ARRAY_FRAME], [pupil])[0]
    return aim._replace(
        lenslet_z=mla.thickness_mm - plate if array.curved_to_lens else 0.0,
        pupil_x=pupil_x,
        pupil_y=pupil_y,
        pupil_vergence=vergence,
        pupil_slope=slope,
        lenslet_power=power,
        circumradius=radius,
        cell_margin=(array.lenslets.valley - array.lenslets.top) * (slope + radius / to_sensor),
        search=search,
    )
