"""Rays from the stop, uniform over area and directions, traced to sensor and object space."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.surfaces.bends import height_range
from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import kernel
from lfmesh.transport.events.kick import kick_by_key
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME
from lfmesh.transport.packets.random import derived, descendant
from lfmesh.transport.sequences.follower import (
    ARRAY_AGAIN,
    IN_LENS,
    LENS_AGAIN,
    RAY_ENDED,
    RAY_KICK_AT,
    RAY_KICK_X,
    RAY_KICK_Y,
    RAY_WEIGHT,
    image_route,
)
from lfmesh.transport.sequences.ray_tables import follow_route, lens_of_faces
from lfmesh.transport.tables.gradient_spaces import fills_space
from lfmesh.transport.tables.phase_faces import carrying, first_order
from lfmesh.transport.tables.tables import (
    FACES_OF_ARRAY,
    Camera,
    LensTables,
    MlaTables,
    SensorTables,
    thin_lens_power,
)

Array = NDArray[np.float64]

BATCH = 1 << 16
"""Number of rays drawn at once."""

BATCHES = 40
"""Largest number of batches in a round; fewer once `ENOUGH` rays have come through."""

ENOUGH = 45_000
"""Number of rays in a round: if none is outside the aim, less than 7e-5 of the throughput is (95 % confidence)."""

NEAREST = 1e-3
"""Least distance from the sensor's centre, in half diagonals, at which the rays of the first search land by first-order
optics."""

FURTHEST = 1e3
"""Largest distance, likewise."""

ROOM = 1.15
"""Factor on the largest distance or slope of a ray that reached the sensor; the measurement draws rays within it."""

SEARCHES = 8
"""Most searches for the largest slope, each within `ROOM_OF_SEARCH` times the one before."""

ROOM_OF_SEARCH = 2.0
"""Factor on the largest slope found, within which the next search draws."""


class Rays(NamedTuple):
    """Rays from the stop that reach the sensor and object space.

    Attributes
    ----------
    sensor : (n, 5) float64
        Place (mm) and direction (unit, towards the sensor), sensor frame.
    objects : (n, 6) float64
        Point (mm) and direction (unit, away from the lens), camera frame.
    throughput : (n,) float64
        Relative throughput.
    colour : (n,) int64
        Wavelength number.
    kick : (n, 2) float64
        Deflection at the lenslet, see `events.kick`; 0 without diffraction.
    """

    sensor: Array
    objects: Array
    throughput: Array
    colour: NDArray[np.int64]
    kick: Array


class CoverPlate(NamedTuple):
    """Plate before the sensor: thickness, apparent shift of the sensor towards the lens (mm), indices by colour.

    Indices are relative to the medium outside.
    """

    thickness: float
    nearer: float
    indices: Array


class Reach(NamedTuple):
    """Disc in which rays from the stop are drawn uniformly.

    Where first-order optics image the stop near the sensor, a ray's landing point says little of its slope, and nearly
    all rays drawn by landing points are too steep for the lens. Rays are then drawn by their slopes.

    Attributes
    ----------
    radius : float
        Largest distance of first-order landing points from the sensor's centre, in mm, or largest slope.
    of_slopes : bool
        The disc is one of slopes.
    """

    radius: float
    of_slopes: bool = False


@by_address
class CameraTables(NamedTuple):
    """Camera tables for rays from the stop; the sensor is at its apparent place.

    `stop` holds the apertures of a stop that diffracts. The lens's own tables have no diffraction at the stop.
    """

    lens: LensTables
    mla: MlaTables
    sensor: SensorTables
    frames: Array
    cover: CoverPlate | None = None
    stop: Any = None


def reach_of(through: CameraTables, random: np.random.Generator) -> Reach | None:
    """Return the smaller disc, of landing points or slopes, that holds all rays that reach the sensor.

    None: no ray reaches it, or none can be drawn, as the stop lies between gradient-index glass on both sides.
    """
    sensor = through.sensor
    if _is_within_gradients(through.lens):
        return None
    diagonal = 0.5 * sensor.pixel * np.hypot(sensor.columns, sensor.rows)
    drawn = NEAREST * diagonal * (FURTHEST / NEAREST) ** random.random(BATCH)
    _, found = _trace_from_stop(through, drawn, random)
    if not len(found.drawn):
        return None
    places = Reach(ROOM * float(found.drawn.max()))
    steepest, limit = float(found.slope.max()), 0.0
    # At a stop that diffracts, slopes before and behind it differ.
    if through.stop is not None or ROOM * steepest >= places.radius * abs(_first_order_of(through).slope):
        return places
    # So few rays came through that steeper ones may have been missed.
    for _ in range(SEARCHES):
        if ROOM * steepest <= limit:
            break
        limit = ROOM_OF_SEARCH * steepest
        _, found = _trace_from_stop(through, limit * np.sqrt(random.random(BATCH)), random, of_slopes=True)
        steepest = max(steepest, float(found.slope.max(initial=0.0)))
    return Reach(ROOM * steepest, of_slopes=True)


def rays_from_stop(through: CameraTables, reach: Reach, random: np.random.Generator) -> Rays:
    """Return rays from the stop, uniform over its area and the disc of their slopes or first-order landing points.

    Parameters
    ----------
    through : CameraTables
    reach : Reach
        See `reach_of`.
    random : Generator
    """
    some: list[Rays] = []
    for _ in range(BATCHES):
        drawn = reach.radius * np.sqrt(random.random(BATCH))
        rays, _ = _trace_from_stop(through, drawn, random, of_slopes=reach.of_slopes)
        some.append(rays)
        if sum(len(r.throughput) for r in some) >= ENOUGH:
            break
    return Rays(*(np.concatenate(each) for each in zip(*some, strict=True)))


class _Found(NamedTuple):
    """Rays that came through: what they were drawn by, and their slopes at the stop; (n,) each."""

    drawn: Array
    slope: Array


def _trace_from_stop(
    through: CameraTables, drawn: Array, random: np.random.Generator, *, of_slopes: bool = False
) -> tuple[Rays, _Found]:
    """Trace random rays from the stop; return those that come through, and how they were drawn.

    Parameters
    ----------
    drawn : (n,) float64
        Distance of each ray's first-order landing point from the sensor's centre, in mm, or its slope.
    random : Generator
    of_slopes : bool
        Slopes are given.
    """
    lens, sensor = through.lens, through.sensor
    space, z, rim, depth, pose = _stop_of(lens)
    optics = _first_order_of(through)
    out, turn = np.sqrt(random.random(len(drawn))), 2.0 * np.pi * random.random(len(drawn))
    around = 2.0 * np.pi * random.random(len(drawn))
    height, slope, (centre_x, centre_y) = optics.height, optics.slope, optics.centre
    # Rays through the aperture of a curved stop cross the plane at its vertex slightly further out.
    if of_slopes:
        radius = rim + depth * drawn
    else:
        radius = rim * (1.0 + depth * abs(height * slope)) + depth * (drawn + np.hypot(centre_x, centre_y)) * abs(slope)
    x, y = radius * out * np.cos(turn), radius * out * np.sin(turn)
    if of_slopes:
        tx, ty = drawn * np.cos(around), drawn * np.sin(around)
    else:
        # The map from landing points to slopes is a shear at fixed height, so the density of slopes stays uniform.
        tx = slope * (centre_x + drawn * np.cos(around) - height * x)
        ty = slope * (centre_y + drawn * np.sin(around) - height * y)
    to_sensor, to_objects, of_colour = np.zeros((len(x), 6)), np.zeros((len(x), 7)), np.zeros(len(x), np.int64)
    key = 0 if through.mla.apertures is None else int(random.integers(1 << 63))
    kick = np.zeros((len(x), 2))
    count = lens.media.indices.shape[1]
    colours = sorted({0, count // 2, count - 1})
    start = float(lens.box_high[2] - lens.box_low[2]) + depth
    half_width, half_height = 0.5 * sensor.columns * sensor.pixel, 0.5 * sensor.rows * sensor.pixel
    for number, colour in enumerate(colours):
        mine = slice(number, None, len(colours))
        _find_kicks(through.mla.apertures, colour, descendant(key, number), changes := np.zeros((len(x[mine]), 2)))
        plane, ahead = (x[mine], y[mine], z), (tx[mine], ty[mine])
        back = ahead
        if through.stop is not None:
            # On the other side of the stop the same rays have other directions.
            back = _turned_at_stop(through.stop, lens, space, colour, ahead, random)
        to_sensor[mine] = ends = _sensor_side(through, space, _starts(plane, ahead, start, pose), colour, changes)
        lands = (ends[:, 5] > 0.0) & (abs(ends[:, 0]) < half_width) & (abs(ends[:, 1]) < half_height)
        # Rays that miss the sensor are not traced to object space.
        on = np.flatnonzero(lands)
        plane, back = (plane[0][on], plane[1][on], z), (back[0][on], back[1][on])
        to_objects[mine][on] = _object_side(through, space, _starts(plane, back, -start, pose), colour)
        of_colour[mine], kick[mine] = colour, changes
    throughput = to_sensor[:, 5] * to_objects[:, 6] * radius * radius / (1.0 + tx * tx + ty * ty) ** 2
    found = np.flatnonzero(throughput > 0.0)
    rays = Rays(to_sensor[found, :5], to_objects[found, :6], throughput[found], of_colour[found], kick[found])
    return rays, _Found(drawn[found], np.hypot(tx, ty)[found])


class _FirstOrder(NamedTuple):
    """Rays from the stop to the plane of the array or sensor, by first-order optics.

    Attributes
    ----------
    height : float
        Height at the plane for unit height at the stop.
    slope : float, 1/mm
        Slope at the stop for unit height at the plane; 1 if the plane is an image of the stop.
    centre : (2,) float64, mm
        Point of the plane that the drawn points lie about.
    """

    height: float
    slope: float
    centre: Array


def _first_order_of(through: CameraTables) -> _FirstOrder:
    lens = through.lens
    space, z = _stop_of(lens)[:2]
    moves = through.frames[MLA_FRAME if through.mla.present else SENSOR_FRAME, CAMERA_FRAME]
    height, angle, aside = _to_plane(lens, space, z, float(moves[2, 3]))
    slope = 1.0 / angle if abs(angle) > 1e-9 * abs(z - moves[2, 3]) else 1.0
    # Phases that deflect light, such as gratings, move the landing points aside.
    return _FirstOrder(height, slope, through.frames[SENSOR_FRAME, CAMERA_FRAME][:2, 3] - aside)


def _turned_at_stop(
    stop: Any, lens: LensTables, space: int, colour: int, slopes: tuple[Array, Array], random: np.random.Generator
) -> tuple[Array, Array]:
    """Return slopes, (n,) each, after deflection at the stop; unchanged if no such direction exists."""
    kicks, given = np.zeros((len(slopes[0]), 2)), np.array(slopes)
    _find_kicks(stop, colour, np.uint64(random.integers(1 << 63)), kicks)
    index = float(lens.media.indices[lens.medium[space], colour])
    cosines = given / np.sqrt(1.0 + (given**2).sum(axis=0)) + kicks.T / index
    left = 1.0 - (cosines**2).sum(axis=0)
    turned = np.where(left > 0.0, cosines / np.sqrt(np.where(left > 0.0, left, 1.0)), given)
    return turned[0], turned[1]


def _starts(plane: tuple[Array, Array, float], slopes: tuple[Array, Array], back: float, pose: Array) -> Array:
    """Return rays (10, n) of weight 1 through the stop's plane, as `follow_rays` takes them.

    Parameters
    ----------
    plane : tuple
        x and y, (n,), and z, in mm.
    slopes : tuple
        In x and y, (n,).
    back : float, mm
        Distance before the plane where the straight rays start, so that all surfaces lie ahead; negative for rays
        against the axis.
    pose : (3, 4) float64
        Rigid motion of the plane and the rays from their place in the prescription.
    """
    (x, y, z), (tx, ty) = plane, slopes
    rays = np.ones((RAY_KICK_AT + 1, len(x)))
    rays[:3] = x - back * tx, y - back * ty, np.full(len(x), z - back)
    rays[3:6] = np.stack([tx, ty, np.ones(len(x))]) * (np.sign(back) / np.sqrt(1.0 + tx * tx + ty * ty))
    rays[:3], rays[3:6] = _moved(pose, rays[:3]), _turned(pose, rays[3:6])
    return rays


def _object_side(through: CameraTables, space: int, rays: Array, colour: int) -> Array:
    """Return point and direction in object space, camera frame, and transmittance, (n, 7), of stop rays."""
    # The rays go against the light.
    camera = carrying(_camera_of_faces(through, 0, space), importance=True)
    ends = follow_route(camera, image_route(space, False), rays, (LENS_AGAIN, LENS_AGAIN + 1), colour)
    passes = (ends[RAY_ENDED] == 0.0) & (ends[5] < 0.0)
    return np.vstack([ends[:3], _unit(ends[3:6]), np.where(passes, ends[RAY_WEIGHT], 0.0)]).T


def _sensor_side(through: CameraTables, space: int, rays: Array, colour: int, kicks: Array) -> Array:
    """Return place and direction at the sensor, its frame, and transmittance, (n, 6), of stop rays.

    Parameters
    ----------
    kicks : (n, 2) float64
        Deflections by diffraction at the array.
    """
    last = len(through.lens.surfaces)
    camera, route = _camera_of_faces(through, space, last), image_route(last - space, bool(through.mla.present))
    if (apertures := through.mla.apertures) is not None:
        rays[RAY_KICK_X], rays[RAY_KICK_Y] = kicks.T
        rays[RAY_KICK_AT] = last - space + (0 if apertures.to_lens else FACES_OF_ARRAY)
    ends = follow_route(camera, route, rays, (IN_LENS, ARRAY_AGAIN), colour)
    to_sensor = through.frames[CAMERA_FRAME, SENSOR_FRAME]
    p, d = _moved(to_sensor, ends[:3]), _turned(to_sensor, _unit(ends[3:6]))
    along = -p[2] / d[2]
    passes = (ends[RAY_ENDED] == 0.0) & (d[2] > 0.0) & (along > 0.0)
    landed = np.vstack([p[:2] + along * d[:2], d, np.where(passes, ends[RAY_WEIGHT], 0.0)]).T
    if through.cover is not None:
        _land_behind(landed, through.cover, colour)
    return landed


def _camera_of_faces(through: CameraTables, first: int, last: int) -> Camera:
    """Return the camera with consecutive lens faces only, without the stop, where rays start."""
    lens = lens_of_faces(through.lens, first, last)._replace(stop_space=-1)
    return Camera(lens, through.mla, through.sensor, through.frames)


def _unit(d: Array) -> Array:
    """Return directions (3, n) at unit length, which interfaces change by rounding errors."""
    return d / np.sqrt((d * d).sum(axis=0))


def _moved(through: Array, p: Array) -> Array:
    """Return points (3, n) transformed to another frame."""
    return _turned(through, p) + through[:, 3:]


def _turned(through: Array, d: Array) -> Array:
    """Return directions (3, n) transformed to another frame, without BLAS, whose threads cost more."""
    return np.einsum("ij,jn->in", through[:, :3], d)


def _land_behind(rays: Array, cover: CoverPlate, colour: int) -> None:
    """Move rays (n, 6) from the sensor's apparent place to their landing points behind the cover.

    By first-order optics, which gives the apparent place, the two agree.
    """
    slopes = rays[:, 2:4] / np.where(rays[:, 4:5] > 0.0, rays[:, 4:5], 1.0)
    glass2 = cover.indices[colour] ** 2
    square = glass2 + (glass2 - 1.0) * (slopes**2).sum(axis=1, keepdims=True)
    # A cover of less index than the medium outside reflects the steepest rays totally: they land nowhere.
    in_glass = cover.thickness / np.sqrt(np.where(square > 0.0, square, np.nan))
    rays[:, :2] += (in_glass - (cover.thickness - cover.nearer)) * slopes


def _to_plane(lens: LensTables, space: int, z: float, plane_z: float) -> tuple[float, float, Array]:
    """Return the first-order coefficients of the height at a plane behind the lens.

    The height there is the first coefficient times the height at z in the space, plus the second times the slope, plus
    the third, in x and y, (2,) mm, by phases that deflect light.
    """
    colour = lens.media.indices.shape[1] // 2
    surfaces, indices = lens.surfaces, lens.media.indices[lens.medium, colour]
    heights, slopes = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0, 0.0])
    for k in range(space, len(surfaces)):
        before = indices[k]
        if fills_space(lens.gradients, k):
            a, b, c, d, behind = lens.gradients.paraxial[k, colour]
            heights, slopes = a * heights + b * before * slopes, (c * heights + d * before * slopes) / behind
            before = behind
        else:
            heights = heights + (float(surfaces[k]["vertex_z"]) - z) * slopes
        z = float(surfaces[k]["vertex_z"])
        power, deflection_x, deflection_y = first_order(lens.interfaces, k, colour)
        power += (indices[k + 1] - before) * surfaces[k]["curvature"] + thin_lens_power(lens.interfaces, k)
        slopes = (before * slopes - power * heights + [0.0, 0.0, deflection_x, deflection_y]) / indices[k + 1]
    heights = heights + (plane_z - z) * slopes
    return float(heights[0]), float(heights[1]), heights[2:]


def _stop_of(lens: LensTables) -> tuple[int, float, float, float, Array]:
    """Return a space that holds or touches the stop, and the stop's z, radius, largest sag and pose.

    Of two spaces beside a surface it is the one in front, unless gradient-index glass fills it: rays start straight.
    """
    if lens.stop_space >= 0:
        return lens.stop_space, lens.stop_z, lens.stop_radius, 0.0, lens.stop_pose
    surfaces = lens.surfaces
    k = int(np.argmax(surfaces["stop"] == 1))
    rim = float(surfaces[k]["semi_diameter"])
    depth = max(map(abs, height_range(surfaces[k], rim)))
    space = k + 1 if fills_space(lens.gradients, k) else k
    return space, float(surfaces[k]["vertex_z"]), rim, depth, np.array(surfaces[k]["pose"])


def _is_within_gradients(lens: LensTables) -> bool:
    """Tell whether the spaces on both sides of the stop are filled by gradient-index glass."""
    return fills_space(lens.gradients, _stop_of(lens)[0])


@kernel
def _find_kicks(apertures: Any, colour: int, key: np.uint64, kicks: Array) -> None:
    """Draw the rays' deflections, (n, 2)."""
    if apertures is None:
        return
    for i in range(len(kicks)):
        kicks[i, 0], kicks[i, 1] = kick_by_key(apertures, colour, derived(key, i), apertures.events)
