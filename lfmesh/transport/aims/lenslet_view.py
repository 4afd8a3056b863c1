"""Views through lenslets: the lenslets that show the lens's opening to a point of the sensor.

Real rays from the opening's border through every lenslet measure how far from the paraxial view light may land. The
views must hold every path; those outside would have the large weight of the few rays that go anywhere.
"""

from typing import Any

import numpy as np

from lfmesh.errors import SceneError
from lfmesh.geometry import frame
from lfmesh.geometry.array.lattice import centre
from lfmesh.geometry.array.lenslets import Lenslets, border_segments, face_normal, face_sag, shape_of
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.scene import FirstOrder, Scene
from lfmesh.transport.aims.lenslet_aim import pixel_extent
from lfmesh.transport.aims.plate_view import (
    NOTHING_SEEN,
    bent_at_lenslet,
    refract_if_possible,
    views_through_plate,
)
from lfmesh.transport.aims.pupil import opening_from
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME
from lfmesh.transport.tables.gradient_cells import at_colours as gradient_at_colours
from lfmesh.transport.tables.media import with_media
from lfmesh.transport.tables.phase_faces import at_colours, first_order
from lfmesh.transport.tables.tables import AIR, LensletAim, MlaTables, Opening, SensorTables

ZONES = 2
"""Number of points of a lenslet, from its centre to each corner, at which the view is measured."""

VIEW_MARGIN = 1.02
"""Factor on the radius of a view, for light between the measured rays."""

TRUSTED, WIDENED = 0.7, 1.3
"""Range of the needed factor that keeps the measured views; they are widened by a common factor above 1."""

ROUNDING = 1e-6
"""Margin of aimed cells, in pitches, for rounding errors."""


RINGS = 64
"""Number of rings of equal area that resolve the light over a lenslet's view."""

SURELY_SHOWN = 0.9
"""Share of a view's area that is taken to show the whole opening until that is measured."""

MOST_INDICES = 8
"""Number of lenslet indices for the view measurement; in between, a view changes steadily."""


def by_rings(light: Array) -> Array:
    """Return the light in a view's rings, relative to the brightest, as `LensletAim.shown`.

    Parameters
    ----------
    light : (rings,) float64
        Root mean square of each ring.
    """
    return np.append(light / light.max(), 0.0)


def unmeasured_light() -> Array:
    """Return the unmeasured light in a view's rings, see `LensletAim.shown`."""
    return by_rings(np.where(np.arange(RINGS) < SURELY_SHOWN * RINGS, 1.0, 0.0))


def no_lenslets(cells: int) -> LensletAim:
    """Return the aim of lenslets not known to show anything."""
    return LensletAim(
        apex_z=0.0, pupil_x=0.0, pupil_y=0.0, pupil_vergence=0.0,
        slope=np.zeros((cells, 2)), slope_radius2=np.full(cells, NOTHING_SEEN),
        shown=unmeasured_light(), cell_margin=0.0, search=0.0,
    )  # fmt: skip


def grid(half_width: float, half_height: float, z: float) -> Array:
    """Return the corners, side midpoints and centre of a rectangle at height z, (9, 3) mm.

    Parameters
    ----------
    half_width, half_height, z : float, mm
    """
    return np.array([[i * half_width, j * half_height, z] for i in (-1, 0, 1) for j in (-1, 0, 1)])


def apex_z(mla: MlaTables, glass: float) -> tuple[float, float]:
    """Return z (array frame) of the apexes as seen by the sensor and the lens; one through the plate.

    If both faces have lenslets, each sees the lenslets on its own side.
    """
    thickness = mla.lenslets.thickness
    if mla.back is not None:
        return 0.0, thickness
    through_plate = thickness - thickness / glass
    return (through_plate, 0.0) if mla.curved_to_lens else (0.0, through_plate)


def aim_through_lenslets(
    scene: Scene, report: FirstOrder, mla: MlaTables, opening: Opening, moves: Array, sensor: SensorTables, glass: float
) -> LensletAim:
    """Return the aim through lenslets, with each one's view of the exit pupil.

    A ray from x through a lenslet's point c + u leaves it with slope (c + u − x)/d − φ (u − e) + g, where e is the
    apex's decentre and g the deflection by a phase such as a grating. The opening lies at slope σ − κ u from there. So,
    seen from the lenslet's centre, it is off (c − x)/d by φ e + g − σ, with a blur of |κ + 1/d − φ| |u| and of the
    lenslet's aberrations, which real rays measure.

    Parameters
    ----------
    scene : Scene
    report : FirstOrder
    mla : MlaTables
    opening : Opening
        Opening of the lens, as seen from the lenslets.
    moves : (6, 6, 3, 4) float64
        Between frames.
    sensor : SensorTables
    glass : float
        Refractive index of the lenslets, relative to the medium outside.
    """
    lattice = mla.lenslets.lattice
    sensor_z, lens_z = apex_z(mla, glass)
    middle = np.array([[0.0, 0.0, lens_z]])
    to_pupil = float(frame.points(moves[MLA_FRAME, CAMERA_FRAME], middle)[0, 2]) - report.exit_pupil_z_mm
    if to_pupil == 0.0:
        raise SceneError(
            "camera.mla: the lens's exit pupil lies in the lenslets, so no light can be aimed at it; move the "
            "array, or avoid distances of billions of mm, which are lost in rounding"
        )
    vergence = 1.0 / to_pupil if np.isfinite(to_pupil) else 0.0
    pupil = [0.0, 0.0, report.exit_pupil_z_mm if np.isfinite(to_pupil) else scene.camera.lens.vertices_mm[-1]]
    pupil_x, pupil_y, _ = frame.points(moves[CAMERA_FRAME, MLA_FRAME], [pupil])[0]
    cells = lattice.columns * lattice.rows
    slope, slope_radius = np.zeros((cells, 2)), np.zeros(cells)
    few = _at_few_indices(mla)
    if mla.back is not None:
        views_through_plate(few, opening, moves, sensor_z, slope, slope_radius)
        slope_radius = VIEW_MARGIN * slope_radius
    else:
        by_phase = first_order(few.interfaces, few.row, few.media.indices.shape[1] // 2)
        _view_through_cells(
            few, opening, moves, lens_z, sensor_z, glass - 1.0, by_phase, lattice.corners(), slope, slope_radius
        )  # fmt: skip
    seen = slope_radius > 0.0
    # Lenslets that show nothing look along chief rays, in case rays from the stop still come through them.
    slope[~seen] = vergence * ([pupil_x, pupil_y] - lattice.centres().reshape(-1, 2)[~seen])
    aim = LensletAim(
        apex_z=sensor_z,
        pupil_x=pupil_x,
        pupil_y=pupil_y,
        pupil_vergence=vergence,
        slope=slope,
        slope_radius2=np.where(seen, slope_radius**2, NOTHING_SEEN),
        shown=unmeasured_light(),
        cell_margin=_off_by_facets(mla),
        search=0.0,
    )
    return _searched(aim, mla, moves, sensor)


def _at_few_indices(mla: MlaTables) -> MlaTables:
    """Return the array's tables at few wavelengths, including the extreme indices of the lenslets to the outside."""
    indices, colours = np.unique(mla.media.indices[mla.medium] / mla.media.indices[AIR], return_index=True)
    if mla.interfaces.phases is not None or mla.gradient is not None:
        # A phase depends on the wavelength even if the index does not, and so do coefficients of a gradient.
        colours = np.arange(mla.media.indices.shape[1])
        indices = mla.media.indices[mla.medium] / mla.media.indices[AIR]
    if len(indices) > MOST_INDICES:
        some = np.linspace(0, len(indices) - 1, MOST_INDICES).round().astype(np.int64)
        indices, colours = indices[some], colours[some]
    phases = at_colours(mla.interfaces.phases, colours, mla.media.indices[AIR, colours])
    return with_media(
        gradient_at_colours(mla, colours), mla.media._replace(indices=indices[None], absorption=None), medium=0,
        interfaces=mla.interfaces._replace(phases=phases),
    )  # fmt: skip


def _off_by_facets(mla: MlaTables) -> float:
    """Return the margin, mm, around its cell where a ray may meet a meshed lenslet's face.

    It is the sag of the chords, as nearly all rays are inclined by less than 45°.
    """
    lattice = mla.lenslets.lattice
    chord = lattice.circumradius / border_segments(lattice.hexagonal)
    return ROUNDING * lattice.pitch + _largest_curvature(mla.lenslets) * chord**2 / 8.0


def _largest_curvature(lenslets: Lenslets) -> float:
    """Return a bound on the curvature of an array's faces, 1/mm."""
    profile = lenslets.profile
    return float(np.abs(lenslets.curvature).max() if profile is None else profile.bend.max())


def _searched(aim: LensletAim, mla: MlaTables, moves: Array, sensor: SensorTables) -> LensletAim:
    """Return the aim with the largest search that `list_cells` needs around a pixel's chief ray.

    With o = s + κ (c − p), where p is the pupil's centre and κ its vergence, the condition of `list_cells` is
    (1 + κ d) |c − c₀| ≤ |o| d + ρ d + `extent`, where c₀ is the chief ray's intersection with the array. The bound on
    |c − c₀| has no maximum within a range of d, so it is largest at the sensor's nearest or farthest corner. If it has
    a pole there, as the pupil lies near the sensor, c₀ is taken straight ahead, the same as κ = 0.
    """
    lattice = mla.lenslets.lattice
    width, height = 0.5 * sensor.columns * sensor.pixel, 0.5 * sensor.rows * sensor.pixel
    corners = frame.points(moves[SENSOR_FRAME, MLA_FRAME], grid(width, height, 0.0))
    distance = np.abs(corners[:, 2] - aim.apex_z)
    distance = np.array([distance.min(), distance.max()])
    lateral, deep = pixel_extent(sensor, moves)
    seen = aim.slope_radius2 >= 0.0
    slope, radius = aim.slope[seen], np.sqrt(aim.slope_radius2[seen])
    extent = lateral + deep * np.abs(slope).sum(axis=1).max(initial=0.0)

    def farthest(vergence: float) -> float:
        off_chief = vergence * (lattice.centres().reshape(-1, 2)[seen] - [aim.pupil_x, aim.pupil_y]) + slope
        spread = (np.hypot(off_chief[:, 0], off_chief[:, 1]) + radius).max(initial=0.0)
        nearer = 1.0 + vergence * distance
        return float(((spread * (distance + deep) + extent) / nearer).max()) if nearer.min() > 0.0 else np.inf

    by_vergence = {vergence: farthest(vergence) for vergence in (aim.pupil_vergence, 0.0)}
    vergence = min(by_vergence, key=by_vergence.__getitem__)
    search = by_vergence[vergence] / lattice.pitch + ROUNDING
    return aim._replace(pupil_vergence=vergence, search=search)


def fitted_views(
    aim: LensletAim, mla: MlaTables, moves: Array, sensor: SensorTables, needed: float, furthest: float, opened: float
) -> LensletAim:
    """Return the aim with views as wide as the light needs, and the search extended to match.

    Parameters
    ----------
    needed : float
        Factor on the width of the measured views that the light needs.
    furthest : float
        Radius, in slope, about the centre of a view that holds all but a negligible share of the light.
    opened : float
        The same for lenslets taken to show nothing; 0: they show nothing.
    """
    seen, radius2 = aim.slope_radius2 > 0.0, aim.slope_radius2
    if 1.0 < needed <= WIDENED:
        radius2 = needed * needed * radius2
    elif not TRUSTED <= needed <= 1.0:
        # Rays at the lenslets' borders were reflected totally or left at grazing angles, so the views are not measured.
        radius2 = np.full_like(radius2, furthest * furthest)
    unseen = opened * opened if opened > 0.0 else NOTHING_SEEN
    return _searched(aim._replace(slope_radius2=np.where(seen, radius2, unseen)), mla, moves, sensor)


def with_wider_cells(aim: LensletAim, mla: MlaTables, by: float) -> LensletAim:
    """Return the aim with wider cells.

    Parameters
    ----------
    aim : LensletAim
    mla : MlaTables
    by : float
        Factor on the width of the cells.
    """
    half = 0.5 * mla.lenslets.lattice.pitch
    return aim._replace(cell_margin=by * (half + aim.cell_margin) - half)


@kernel
def _view_through_cells(
    mla: MlaTables, opening: Opening, moves: Array, lens_z: float, sensor_z: float, power_of_curvature: float,
    by_phase: tuple[float, float, float], corners: Array, slope: Array, slope_radius: Array,
) -> None:  # fmt: skip
    """Measure every lenslet's view of the opening by real rays.

    Rays go from the opening's border through points of the lenslet, up to its corners (n, 2), to the sensor.

    Parameters
    ----------
    by_phase : (3,) float
        Power, 1/mm, and deflection in x and y by a phase of the lenslets.
    slope : (cells, 2) float64
        Filled with a lenslet's slope to the opening's centre (array frame, away from the sensor).
    slope_radius : (cells,) float64
        Filled with the radius of the view, in slopes; −1: the lenslet does not show the opening.
    """
    lenslets = mla.lenslets
    lattice = lenslets.lattice
    toward = -1.0 if mla.curved_to_lens else 1.0
    for row in range(lattice.rows):
        for column in range(lattice.columns):
            cell = row * lattice.columns + column
            cx, cy = centre(lattice, column, row)
            x, y, z = frame.move_point(moves, MLA_FRAME, CAMERA_FRAME, cx, cy, lens_z)
            mx, my, radius = opening_from(opening, (x, y, z))
            if radius <= 0.0:
                slope_radius[cell] = -1.0
                continue
            sx, sy = _slope(moves, mx - x, my - y, opening.plane_z - z, toward)
            curvature, ex, ey = shape_of(lenslets, column, row)
            power = power_of_curvature * curvature
            bends_x, bends_y = _bends_along(lenslets.profile)
            sx, sy = sx - bends_x * power * ex, sy - bends_y * power * ey
            sx, sy = sx - by_phase[0] * ex - by_phase[1], sy - by_phase[0] * ey - by_phase[2]
            furthest = 0.0
            for point in range(1 + ZONES * len(corners)):
                zone, corner = (point + len(corners) - 1) // len(corners) / ZONES, point % len(corners)
                ux, uy = zone * corners[corner, 0], zone * corners[corner, 1]
                off = _farthest_landing(
                    mla, opening, moves, column, row, curvature, ux - ex, uy - ey, cx, cy, cx + ux, cy + uy, sensor_z,
                    sx, sy,
                )  # fmt: skip
                furthest = max(furthest, off)
            slope[cell, 0], slope[cell, 1], slope_radius[cell] = sx, sy, VIEW_MARGIN * furthest


@inlined
def _bends_along(profile: Any) -> tuple[float, float]:
    """Return 1 for each of x and y along which lenslets have power; 0 for a cylinder's other one."""
    if profile is None:
        return 1.0, 1.0
    return profile.weight_x, profile.weight_y


@inlined
def _farthest_landing(
    mla: MlaTables, opening: Opening, moves: Array, column: int, row: int, curvature: float, ux: float, uy: float,
    cx: float, cy: float, x: float, y: float, sensor_z: float, sx: float, sy: float,
) -> float:  # fmt: skip
    """Return the largest distance, in slope, of rays through a point from the view's centre.

    Parameters
    ----------
    column, row : int
        Column and row of the cell.
    curvature : float, 1/mm
    ux, uy : float, mm
        Point of the face, relative to its apex.
    cx, cy, x, y : float, mm
        The cell's centre, and the same point, array frame.
    sx, sy : float
        Slope from the cell's centre to the opening.
    """
    to_sensor = 1.0 if mla.curved_to_lens else -1.0
    sag = face_sag(mla.lenslets, column, row, curvature, ux, uy)
    normal = face_normal(mla.lenslets, column, row, curvature, ux, uy, sag)
    sx0, sy0, sz0 = frame.move_point(moves, SENSOR_FRAME, MLA_FRAME, 0.0, 0.0, 0.0)
    mx, my, mz = frame.move_direction(moves, SENSOR_FRAME, MLA_FRAME, 0.0, 0.0, 1.0)
    furthest = 0.0
    for colour in range(mla.media.indices.shape[1]):
        glass = mla.media.indices[mla.medium, colour]
        # If the plate lies between lens and face, the lens sees the face through it.
        seen_z = sag if mla.curved_to_lens else mla.lenslets.thickness - (mla.lenslets.thickness - sag) / glass
        px, py, pz = frame.move_point(moves, MLA_FRAME, CAMERA_FRAME, x, y, seen_z)
        ox, oy, radius = opening_from(opening, (px, py, pz))
        outward_x, outward_y, _ = frame.move_direction(moves, MLA_FRAME, CAMERA_FRAME, x - cx, y - cy, 0.0)
        length = np.sqrt(outward_x * outward_x + outward_y * outward_y)
        hx, hy = (outward_x / length, outward_y / length) if length > 0.0 else (1.0, 0.0)
        # Four points of the opening's border, a quarter turn apart.
        for _ in range(4 if radius > 0.0 else 0):
            hx, hy = -hy, hx
            dx, dy, dz = px - ox - radius * hx, py - oy - radius * hy, pz - opening.plane_z
            dx, dy, dz = frame.move_direction(moves, CAMERA_FRAME, MLA_FRAME, dx, dy, dz)
            through, at_x, at_y, at_z, dx, dy, dz = _through_lenslet(
                mla, colour, (ux, uy), normal, glass, to_sensor, sag, x, y, dx, dy, dz
            )
            if not through:
                continue
            t = ((sx0 - at_x) * mx + (sy0 - at_y) * my + (sz0 - at_z) * mz) / (dx * mx + dy * my + dz * mz)
            over = 1.0 / abs(at_z + t * dz - sensor_z)
            a, b = (cx - at_x - t * dx) * over - sx, (cy - at_y - t * dy) * over - sy
            furthest = max(furthest, np.sqrt(a * a + b * b))
    return furthest


@inlined
def _through_lenslet(
    mla: MlaTables, colour: int, u: tuple[float, float], normal: tuple[float, float, float], glass: float,
    to_sensor: float, sag: float, x: float, y: float, dx: float, dy: float, dz: float,
) -> tuple[bool, float, float, float, float, float, float]:  # fmt: skip
    """Trace a ray through a lenslet's point; return whether it gets through, its exit point and direction."""
    thickness, phases = mla.lenslets.thickness, mla.interfaces.phases
    scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
    dx, dy, dz = dx * scale, dy * scale, dz * scale
    nx, ny, nz = normal[0] * to_sensor, normal[1] * to_sensor, normal[2] * to_sensor
    if to_sensor > 0.0:
        one, dx, dy, dz = bent_at_lenslet(phases, mla.row, colour, u, (1.0, glass), (dx, dy, dz), (nx, ny, nz))
        t = (thickness - sag) / dz
        other, ex, ey, ez = refract_if_possible(dx, dy, dz, 0.0, 0.0, to_sensor, glass)
        return one and other, x + t * dx, y + t * dy, thickness, ex, ey, ez
    one, dx, dy, dz = refract_if_possible(dx, dy, dz, 0.0, 0.0, to_sensor, 1.0 / glass)
    other, dx, dy, dz = bent_at_lenslet(phases, mla.row, colour, u, (glass, 1.0), (dx, dy, dz), (nx, ny, nz))
    return one and other, x, y, sag, dx, dy, dz


@kernel
def _slope(moves: Array, dx: float, dy: float, dz: float, toward: float) -> tuple[float, float]:
    """Return the slope, array frame, of a camera-frame direction."""
    x, y, z = frame.move_direction(moves, CAMERA_FRAME, MLA_FRAME, dx, dy, dz)
    return x / (toward * z), y / (toward * z)
