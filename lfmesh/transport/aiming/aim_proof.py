"""Proof that the aim holds all light, by rays that start in the stop and are traced both ways.

Aiming decides where samples go, never what light there is; light outside the aim is found only by the few samples that
go anywhere, with large weights. Rays drawn uniformly in the stop, over all directions, are independent of the search
that made the aim. Traced to the sensor and to object space, each either is or is not a ray that the aim could draw. The
throughput of those that are not, over the throughput of all, is the share that the aim misses. It is measured when a
world is built, and the aim is widened until the share is negligible. Where that does not succeed, rays go anywhere.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from lfmesh.geometry.array.lattice import cell_of, centre
from lfmesh.geometry.array.lenslets import shape_of, type_of
from lfmesh.geometry.frame import directions, move_direction, move_point, points
from lfmesh.geometry.surfaces.tessellation import QUARTER, mesh_heights
from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import kernel
from lfmesh.transport.aiming.lenslet_aim import (
    LISTED,
    cells_that_show,
    glass_before_faces,
    half_width_to,
    list_cells,
    most_listed,
    on_lenslet,
    path_to_apexes,
    pixel_extent,
    spread_on_faces,
)
from lfmesh.transport.aiming.lenslet_view import RINGS, fitted_views, unmeasured_light, with_wider_cells
from lfmesh.transport.aiming.mixture import WIDE_SHARE_OF_FALLBACK
from lfmesh.transport.aiming.near_points import NearViewpoints, near_disk, wide_open
from lfmesh.transport.aiming.pupil import Viewpoints, opening_from, unknown_opening
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME
from lfmesh.transport.sequences.bundle import (
    BLOCK,
    DROPPED,
    DX,
    DY,
    DZ,
    ENDED_ON,
    WEIGHT,
    X,
    Y,
    Z,
    empty_bundle,
    load,
    move_bundle,
    normalise,
    pad,
)
from lfmesh.transport.sequences.follower import ARRAY_AGAIN, IN_ARRAY, Route, follow_legs, image_route
from lfmesh.transport.sequences.lens_surfaces import at_surface
from lfmesh.transport.sequences.ray_tables import unread_book
from lfmesh.transport.tables.tables import (
    AimTables,
    Camera,
    LensTables,
    MlaTables,
    NearOpening,
    Opening,
    SensorTables,
    thin_lens_power,
)

Array = NDArray[np.float64]

ALLOWED = 1e-4
"""Share of the throughput that the aim may miss."""

CONFIDENCE = 0.95
"""With which a share is known to be below its bound, when it is decided whether it is allowed."""

ROUNDS = 8
"""Number of times that rays are drawn, at most, until they tell whether the share is allowed."""

BATCH = 1 << 16
"""Rays that are drawn at once."""

BATCHES = 40
"""Largest number of batches in a round; fewer once `ENOUGH` rays have come through."""

ENOUGH = 45_000
"""Number of rays in a round: if none of them is outside the aim, less than 7e-5 of the throughput is (with 95 %
confidence)."""

NEAREST = 1e-3
"""Least distance from the sensor's centre, in its half diagonals, at which rays of the first search would land by
first-order optics."""

FURTHEST = 1e3
"""Largest distance, likewise."""

ROOM = 1.15
"""Factor on the largest such distance of a ray that reached the sensor; rays of the measurement are drawn within it."""

ATTEMPTS = 5
"""Number of attempts to fit the aim, each with its own rays."""

MARGIN = 1.02
"""Factor by which a fitted aim is wider than the rays need."""

FEWEST = 3000
"""Least number of rays by which the light over the views is measured. Rings that none of them meets hold less than 1e-3
of the light (with 95 % confidence), and main rays do not go there."""

FEW_CELLS = 6.5
"""Value of `AimTables.search`, in pitches, above which the views are taken to be far too wide."""


class Missed(NamedTuple):
    """Share of the throughput outside the aim of one side, and its standard error.

    If no ray was outside, `error` is the share of a single ray.
    """

    share: float
    error: float

    @property
    def most(self) -> float:
        """Upper bound of the share, by the number of rays outside (Poisson), of the mean weight that they have."""
        number, weight = self._outside
        return float(weight * gammaincinv(number + 1.0, CONFIDENCE))

    @property
    def least(self) -> float:
        """Lower bound of the share, likewise."""
        number, weight = self._outside
        return float(weight * gammaincinv(number, 1.0 - CONFIDENCE)) if number > 0.0 else 0.0

    @property
    def _outside(self) -> tuple[float, float]:
        """Number of equal rays that would give share and error, and the share of each."""
        return ((self.share / self.error) ** 2, self.error**2 / self.share) if self.share > 0.0 else (0.0, self.error)


class AimProof(NamedTuple):
    """Result of the proof of an aim by rays from the stop.

    Attributes
    ----------
    rays : int
        Number of rays that came through lens and array to the sensor.
    sensor, objects : Missed
        Share missed by the aim from the sensor, and by the aim from the targets.
    fitted : int
        Number of times that the aim was fitted to rays.
    fallback : bool
        Whether the fitted aim still missed more than is allowed, so that more rays, or all, go anywhere.

    A share that few rays tell is as large as chance has it: so its upper bound decides whether the proof holds.
    """

    rays: int
    sensor: Missed
    objects: Missed
    fitted: int
    fallback: bool = False

    @property
    def holds(self) -> bool:
        """True if the share that the aim misses is allowed, with the `CONFIDENCE` of its bound."""
        return self.most <= ALLOWED

    @property
    def is_open(self) -> bool:
        """True if more rays might tell that the share is allowed, or that it is not."""
        return max(self.sensor.least, self.objects.least) <= ALLOWED < self.most

    @property
    def most(self) -> float:
        """Upper bound of the throughput outside the aim, the larger of both sides."""
        return max(self.sensor.most, self.objects.most)

    @property
    def missed(self) -> float:
        """Share of the throughput outside the aim, the larger of both sides."""
        return max(self.sensor.share, self.objects.share)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "AimProof":
        """Return the proof whose `_asdict` was written as JSON."""
        sensor, objects = (Missed(*values[side]) for side in ("sensor", "objects"))
        return cls(values["rays"], sensor, objects, values["fitted"], values.get("fallback", False))


class Rays(NamedTuple):
    """Rays that came through from the stop to the sensor and to object space.

    Attributes
    ----------
    sensor : (n, 5) float64
        Place (mm) and direction (unit, towards the sensor), sensor frame.
    objects : (n, 6) float64
        Point (mm) and direction (unit, away from the lens), camera frame.
    throughput : (n,) float64
        Relative throughput.
    colour : (n,) int64
        Number of the wavelength.
    """

    sensor: Array
    objects: Array
    throughput: Array
    colour: NDArray[np.int64]


class CoverPlate(NamedTuple):
    """Plate before the sensor: thickness, how much nearer the sensor appears through it (mm), and indices by colour."""

    thickness: float
    nearer: float
    indices: Array


@by_address
class CameraTables(NamedTuple):
    """Tables of the camera that rays from the stop go through; the sensor is where it appears to be."""

    lens: LensTables
    mla: MlaTables
    sensor: SensorTables
    frames: Array
    cover: CoverPlate | None = None


def proven(
    aim: AimTables, through: CameraTables, seen: Viewpoints | None, near: NearViewpoints | None = None
) -> tuple[AimTables, AimProof | None]:
    """Return the aim, widened until it misses a negligible share of the light, and the proof by rays from the stop.

    The proof is None if no ray from the stop arrives at the sensor.

    Parameters
    ----------
    aim : AimTables
    through : CameraTables
        Every surface of the lens must be exact.
    seen : Viewpoints or None
        Viewpoints of the targets; None if no target lies before the lens.
    near : NearViewpoints, optional
        Those close before the lens.
    """
    random = np.random.default_rng(0x5106)
    reach = _reach(through, random)
    if reach == 0.0:
        return aim, None
    proof = None
    for attempt in range(ATTEMPTS):
        rays = _rays_from_stop(through, reach, random)
        if not len(rays.throughput):
            return aim, None
        if attempt == 0 and through.mla.present and aim.search > FEW_CELLS:
            aim = _fitted(aim, through, rays)
            continue
        proof, behind, before, close = _measured(aim, through, seen, near, rays, random, attempt)
        for _ in range(ROUNDS - 1):
            if not proof.is_open:
                break
            more = _rays_from_stop(through, reach, random)
            rays = Rays(*(np.concatenate(each) for each in zip(rays, more, strict=True)))
            proof, behind, before, close = _measured(aim, through, seen, near, rays, random, attempt)
        if proof.holds:
            break
        if attempt == ATTEMPTS - 1:
            aim, proof = _completed(aim, proof, through.mla.present)
            break
        if through.mla.present:
            aim = _fitted(aim, through, rays)
        else:
            aim = aim._replace(exit=_widened(aim.exit, behind, rays.throughput))
        aim = aim._replace(entrance=_widened(aim.entrance, before, rays.throughput))
        aim = aim._replace(entrance=_widened_near(aim.entrance, close, rays.throughput, aim.front_radius))
    if through.mla.present and len(rays.throughput) >= FEWEST:
        off, radius, _ = _seen_from_cells(aim, through, rays)
        aim = aim._replace(shown=_shown((off / radius)[radius > 0.0], rays.throughput[radius > 0.0]))
    return aim, proof


def _measured(
    aim: AimTables, through: CameraTables, seen: Viewpoints | None, near: NearViewpoints | None, rays: Rays,
    random: np.random.Generator, attempt: int,
) -> tuple[AimProof, Array, Array, Array]:  # fmt: skip
    """Return the proof of an aim by rays from the stop.

    The other results are the factors of `_beyond_sensor_aim`, `_beyond_object_aim` and `_beyond_near_aim`.
    """
    behind, before = _beyond_sensor_aim(aim, through, rays), _beyond_object_aim(aim, seen, rays, random)
    close = _beyond_near_aim(aim, near, rays, random)
    objects = max(_missed(before, rays.throughput), _missed(close, rays.throughput), key=lambda m: m.most)
    return AimProof(len(rays.throughput), _missed(behind, rays.throughput), objects, attempt), behind, before, close


def _completed(aim: AimTables, proof: AimProof, has_array: bool) -> tuple[AimTables, AimProof]:
    """Return an aim that holds all light, whatever rays from the stop found outside, and its proof, which says so.

    Rays to the lens go all over it. Behind an array half of the rays go into the whole hemisphere. A side of which rays
    found no more outside than is allowed keeps its aim, though too few of them came through to prove it.

    Parameters
    ----------
    aim : AimTables
        Fitted as often as may be.
    proof : AimProof
        That it misses more than is allowed, or may do so.
    has_array : bool
    """
    if proof.objects.share > ALLOWED:
        aim = aim._replace(entrance=_unknown(aim.entrance))
    if proof.sensor.share > ALLOWED:
        aim = (
            aim._replace(wide_share=WIDE_SHARE_OF_FALLBACK, share_without_aim=1.0)
            if has_array
            else aim._replace(exit=_unknown(aim.exit))
        )
    return aim, proof._replace(fallback=proof.missed > ALLOWED)


def _unknown(opening: Opening) -> Opening:
    """Return the opening that stands for "not known" on the same side of the lens."""
    return unknown_opening(opening.plane_z, to_sensor=opening.sense > 0.0, near_depth=opening.near.depth)


def _shown(off: Array, throughput: Array) -> Array:
    """Return the root mean square of the light in each ring of a lenslet's view, (RINGS + 1,); see `AimTables.shown`.

    A ring counts as no darker than those further out, so that none is dark because few rays met it by chance. Only
    rings that no ray met are dark: whatever light main rays leave out comes by single margin rays of great weight.

    Parameters
    ----------
    off : (n,) float64
        Distance of rays from the centres of views, relative to the views' radius.
    throughput : (n,) float64
    """
    light, _ = np.histogram(off * off, RINGS, (0.0, 1.0), weights=throughput)
    brightest = light.max()
    if not brightest > 0.0:
        return unmeasured_light()
    light = np.maximum.accumulate(light[::-1])[::-1]
    # A direction leads through the opening or not, so its mean square is its mean.
    return np.append(np.sqrt(light / brightest), 0.0)


def decentred(entrance: Opening, exit_: Opening, through: CameraTables) -> tuple[Opening, Opening]:
    """Return the openings of both sides, moved to where poses of lens elements let the light through.

    Rays from the stop say by how much, on average: a shift, and how it changes with the distance of the point.

    Parameters
    ----------
    entrance, exit_ : Opening
        Of the lens as prescribed.
    through : CameraTables
        With poses.
    """
    random = np.random.default_rng(0x905E)
    bare = through._replace(mla=through.mla._replace(present=False))
    reach = _reach(bare, random)
    if reach == 0.0:
        return entrance, exit_
    rays = _rays_from_stop(bare, reach, random)
    to_camera = through.frames[SENSOR_FRAME, CAMERA_FRAME]
    landing = np.column_stack([rays.sensor[:, :2], np.zeros(len(rays.sensor))])
    behind = points(to_camera, landing), -directions(to_camera, rays.sensor[:, 2:])
    before = rays.objects[:, :3], rays.objects[:, 3:]
    entrance = entrance._replace(near=_near_moved_to_rays(entrance, *before, rays.throughput, random))
    return (
        _moved_to_rays(entrance, *before, rays.throughput, random),
        _moved_to_rays(exit_, *behind, rays.throughput, random),
    )


def _moved_to_rays(opening: Opening, p: Array, d: Array, throughput: Array, random: np.random.Generator) -> Opening:
    """Return an opening whose centres are moved by the mean distance of rays from them.

    Parameters
    ----------
    opening : Opening
    p, d : (n, 3) float64
        Points, mm, and directions of the rays, camera frame.
    throughput : (n,) float64
    """
    if not opening.known or not len(throughput):
        return opening
    rows = len(opening.radius) if opening.nearness_step != 1.0 else 0
    row = rows * random.random(len(p))
    z = opening.plane_z - opening.sense / (opening.nearness + row * opening.nearness_step)
    seen_from = p + ((z - p[:, 2]) / d[:, 2])[:, None] * d
    tangent = np.hypot(seen_from[:, 0], seen_from[:, 1]) * (opening.nearness + row * opening.nearness_step)
    opening = _open_out_to(opening, int(tangent.max() / opening.tangent_step) + 2)
    off = np.full((len(p), 2), np.nan)
    _off_centre(seen_from, d, opening, off)
    known = np.isfinite(off[:, 0])
    if not known.any():
        return opening
    weight = np.sqrt(throughput[known])[:, None]
    terms = np.column_stack([np.ones(known.sum()), row[known]])[:, : 2 if rows else 1]
    shift = np.zeros((2, 2))
    shift[: terms.shape[1]] = np.linalg.lstsq(weight * terms, weight * off[known], rcond=None)[0]
    return opening._replace(decentre=shift)


def _near_moved_to_rays(
    opening: Opening, p: Array, d: Array, throughput: Array, random: np.random.Generator
) -> NearOpening:
    """Return the table of near points of an opening, moved likewise; parameters as for `_moved_to_rays`."""
    near = opening.near
    rows = len(near.radius) - 1
    if not opening.known or not near.depth > 0.0 or not (near.radius > 0.0).any() or not len(throughput):
        return near
    row = rows * random.random(len(p))
    distance = near.distance + row * near.distance_step
    t = (opening.plane_z - distance - p[:, 2]) / d[:, 2]
    seen_from = p + t[:, None] * d
    height = np.hypot(seen_from[:, 0], seen_from[:, 1])
    near = _near_open_out_to(near, int(height.max() / near.height_step) + 2)
    off = np.full((len(p), 2), np.nan)
    _off_near_centre(seen_from, d, near, distance, off)
    known = np.isfinite(off[:, 0])
    if not known.any():
        return near
    weight = np.sqrt(throughput[known])[:, None]
    terms = np.column_stack([np.ones(known.sum()), row[known]])
    # Disks that vanish towards the plane do not move there.
    first = 1 if near.distance == 0.0 and not (near.radius[0] > 0.0).any() else 0
    shift = np.zeros((2, 2))
    shift[first:] = np.linalg.lstsq(weight * terms[:, first:], weight * off[known], rcond=None)[0]
    return near._replace(decentre=shift)


def _near_open_out_to(near: NearOpening, columns: int) -> NearOpening:
    """Return a table of near points that is open at so many heights at least, as `_open_out_to` does."""
    width = int(np.flatnonzero((near.radius >= 0.0).any(axis=0)).max(initial=-1))
    if not 0 < width < columns:
        return near
    middle, radius = near.middle[:, : width + 1], near.radius[:, : width + 1]
    further = np.arange(1, columns - width + 1)
    middle = np.hstack([middle, middle[:, -1:] + further * (middle[:, -1:] - middle[:, -2:-1])])
    radius = np.hstack([radius, np.repeat(radius.max(axis=1, keepdims=True), columns - width, axis=1)])
    return near._replace(middle=np.ascontiguousarray(middle), radius=np.ascontiguousarray(radius))


@kernel
def _off_near_centre(p: Array, d: Array, near: NearOpening, distance: Array, off: Array) -> None:
    """Write what `_off_centre` does, of near points at a distance."""
    for i in range(len(off)):
        cx, cy, radius = near_disk(near, p[i, 0], p[i, 1], distance[i])
        if radius > 0.0:
            over = distance[i] / abs(d[i, 2])
            off[i, 0], off[i, 1] = p[i, 0] + over * d[i, 0] - cx, p[i, 1] + over * d[i, 1] - cy


def _open_out_to(opening: Opening, columns: int) -> Opening:
    """Return an opening that is open at so many field angles at least, as poses may let light through beyond.

    Beyond those at which the lens as prescribed is open, centres go on evenly, and radii stay.
    """
    width = int(np.flatnonzero((opening.radius > 0.0).any(axis=0)).max(initial=-1)) + 1
    if not 0 < width < columns:
        return opening
    middle, radius = opening.middle[:, : width + 1], opening.radius[:, :width]
    further = np.arange(1, columns - width + 1)
    middle = np.hstack([middle, middle[:, -1:] + further * (middle[:, -1:] - middle[:, -2:-1])])
    radius = np.hstack([radius, np.repeat(radius.max(axis=1, keepdims=True), columns - width, axis=1)])
    return opening._replace(middle=np.ascontiguousarray(middle), radius=np.ascontiguousarray(radius))


@kernel
def _off_centre(p: Array, d: Array, opening: Opening, off: Array) -> None:
    """Write how far each ray crosses the opening's plane from the centre of the disk seen from its point, (n, 2) mm."""
    for i in range(len(off)):
        cx, cy, radius = opening_from(opening, p[i, 0], p[i, 1], p[i, 2])
        if radius > 0.0:
            t = (opening.plane_z - p[i, 2]) / d[i, 2]
            off[i, 0], off[i, 1] = p[i, 0] + t * d[i, 0] - cx, p[i, 1] + t * d[i, 1] - cy


def _fitted(aim: AimTables, through: CameraTables, rays: Rays) -> AimTables:
    """Return the aim with the lenslets' views and cell margins as wide as the rays need."""
    mla, weight = through.mla, rays.throughput
    off, radius, out = _seen_from_cells(aim, through, rays)
    seen = radius > 0.0
    needed, furthest = MARGIN * _above((off / radius)[seen], weight[seen]), MARGIN * _above(off[seen], weight[seen])
    closed = weight[~seen].sum() > 0.25 * ALLOWED * weight.sum()
    opened = MARGIN * _above(off[~seen], weight[~seen]) if closed else 0.0
    aim = fitted_views(aim, mla, through.frames, through.sensor, needed, furthest, opened)
    return with_wider_cells(aim, mla, max(1.0, MARGIN * _above(out, weight)))


def _missed(beyond: Array, throughput: Array) -> Missed:
    outside, total = throughput * (beyond > 1.0), throughput.sum()
    return Missed(float(outside.sum() / total), float(max(np.sqrt((outside**2).sum()), throughput.mean()) / total))


def _above(values: Array, throughput: Array) -> float:
    """Return the value above which a negligible share of the throughput lies; infinite values are left out."""
    known = np.isfinite(values)
    order = np.argsort(values[known])[::-1]
    above = np.cumsum(throughput[known][order])
    first = int(np.searchsorted(above, 0.25 * ALLOWED * throughput.sum()))
    return float(values[known][order][min(first, len(order) - 1)]) if len(order) else 1.0


def _widened(opening: Opening, beyond: Array, throughput: Array) -> Opening:
    """Return an opening widened to hold rays outside it; not known if too much light goes where it is closed.

    Parameters
    ----------
    opening : Opening
    beyond : (n,) float64
        Distance of each ray from the centre, in radii; inf where the opening is closed.
    throughput : (n,) float64
    """
    if throughput[np.isinf(beyond)].sum() > 0.5 * ALLOWED * throughput.sum():
        return _unknown(opening)
    by = max(1.0, MARGIN * _above(beyond, throughput))
    return opening._replace(radius=np.where(opening.radius > 0.0, by * opening.radius, opening.radius))


def _widened_near(opening: Opening, beyond: Array, throughput: Array, wide_radius: float) -> Opening:
    """Return an opening whose table of near points is widened likewise; if too much is closed, they see a wide disk."""
    near = opening.near
    if not opening.known or not (beyond > 1.0).any():
        return opening
    if throughput[np.isinf(beyond)].sum() > 0.5 * ALLOWED * throughput.sum():
        return opening._replace(near=wide_open(near, wide_radius))
    by = max(1.0, MARGIN * _above(beyond, throughput))
    return opening._replace(near=near._replace(radius=np.where(near.radius > 0.0, by * near.radius, near.radius)))


def _reach(through: CameraTables, random: np.random.Generator) -> float:
    """Return the largest distance from the sensor's centre, by first-order optics, of rays that reach the sensor.

    0: none does.
    """
    sensor = through.sensor
    diagonal = 0.5 * sensor.pixel * np.hypot(sensor.columns, sensor.rows)
    place = NEAREST * diagonal * (FURTHEST / NEAREST) ** random.random(BATCH)
    _, found = _trace_from_stop(through, place, random)
    return ROOM * float(place[found].max(initial=0.0))


def _rays_from_stop(through: CameraTables, reach: float, random: np.random.Generator) -> Rays:
    """Return rays from the stop, uniform over its area and over their landing points by first-order optics."""
    some: list[Rays] = []
    for _ in range(BATCHES):
        rays, _ = _trace_from_stop(through, reach * np.sqrt(random.random(BATCH)), random)
        some.append(rays)
        if sum(len(r.throughput) for r in some) >= ENOUGH:
            break
    return Rays(*(np.concatenate(each) for each in zip(*some, strict=True)))


def _trace_from_stop(through: CameraTables, place: Array, random: np.random.Generator) -> tuple[Rays, NDArray[np.intp]]:
    """Trace random rays from the stop; return those that come through, and their indices.

    Parameters
    ----------
    place : (n,) float64, mm
        Distance from the sensor's centre at which each ray would land by first-order optics.
    """
    lens, sensor = through.lens, through.sensor
    space, z, rim, depth, pose = _stop_of(lens)
    moves = through.frames[MLA_FRAME if through.mla.present else SENSOR_FRAME, CAMERA_FRAME]
    centre_x, centre_y = through.frames[SENSOR_FRAME, CAMERA_FRAME][:2, 3]
    height, angle = _to_plane(lens, space, z, float(moves[2, 3]))
    out, turn = np.sqrt(random.random(len(place))), 2.0 * np.pi * random.random(len(place))
    around = 2.0 * np.pi * random.random(len(place))
    # The map from landing points to slopes is a shear at fixed height, so the density of slopes stays uniform.
    slope = 1.0 / angle if abs(angle) > 1e-9 * abs(z - moves[2, 3]) else 1.0
    # Rays through the aperture of a curved stop cross the plane at its vertex slightly further out.
    radius = rim * (1.0 + depth * abs(height * slope)) + depth * (place + np.hypot(centre_x, centre_y)) * abs(slope)
    x, y = radius * out * np.cos(turn), radius * out * np.sin(turn)
    tx = slope * (centre_x + place * np.cos(around) - height * x)
    ty = slope * (centre_y + place * np.sin(around) - height * y)
    to_sensor, to_objects, of_colour = np.zeros((len(x), 6)), np.zeros((len(x), 7)), np.zeros(len(x), np.int64)
    count = lens.media.indices.shape[1]
    colours = sorted({0, count // 2, count - 1})
    start = float(lens.box_high[2] - lens.box_low[2]) + depth
    camera = Camera(lens, through.mla, sensor, through.frames)
    route, book = image_route(len(lens.surfaces), bool(through.mla.present)), unread_book(lens, through.mla)
    for number, colour in enumerate(colours):
        mine = slice(number, None, len(colours))
        x_, y_, tx_, ty_ = (np.ascontiguousarray(a[mine]) for a in (x, y, tx, ty))
        one_way, other_way = np.zeros((len(x_), 6)), np.zeros((len(x_), 7))
        _follow_both_ways(
            x_, y_, tx_, ty_, z, start, space, pose, colour, camera, route, empty_bundle(), book, one_way, other_way,
        )  # fmt: skip
        if through.cover is not None:
            _land_behind(one_way, through.cover, colour)
        to_sensor[mine], to_objects[mine], of_colour[mine] = one_way, other_way, colour
    half_width, half_height = 0.5 * sensor.columns * sensor.pixel, 0.5 * sensor.rows * sensor.pixel
    throughput = to_sensor[:, 5] * to_objects[:, 6] * radius * radius / (1.0 + tx * tx + ty * ty) ** 2
    lands = (abs(to_sensor[:, 0]) < half_width) & (abs(to_sensor[:, 1]) < half_height)
    found = np.flatnonzero(lands & (throughput > 0.0))
    return Rays(to_sensor[found, :5], to_objects[found, :6], throughput[found], of_colour[found]), found


def _land_behind(rays: Array, cover: CoverPlate, colour: int) -> None:
    """Move rays (n, 6) from where they would meet the sensor as it appears to where they meet it behind its cover.

    By first-order optics, with which the sensor's apparent place is found, these are the same.
    """
    slopes = rays[:, 2:4] / np.where(rays[:, 4:5] > 0.0, rays[:, 4:5], 1.0)
    glass2 = cover.indices[colour] ** 2
    in_glass = cover.thickness / np.sqrt(glass2 + (glass2 - 1.0) * (slopes**2).sum(axis=1, keepdims=True))
    rays[:, :2] += (in_glass - (cover.thickness - cover.nearer)) * slopes


def _to_plane(lens: LensTables, space: int, z: float, plane_z: float) -> tuple[float, float]:
    """Return the first-order coefficients of the height at a plane behind the lens by height and slope inside it.

    The height there is the first number times the height at z in the space, plus the second times the slope.
    """
    surfaces, indices = lens.surfaces, lens.media.indices[lens.medium, lens.media.indices.shape[1] // 2]
    heights, slopes = np.array([1.0, 0.0]), np.array([0.0, 1.0])
    for k in range(space, len(surfaces)):
        heights = heights + (float(surfaces[k]["vertex_z"]) - z) * slopes
        z = float(surfaces[k]["vertex_z"])
        power = (indices[k + 1] - indices[k]) * surfaces[k]["curvature"] + thin_lens_power(lens.interfaces, k)
        slopes = (indices[k] * slopes - power * heights) / indices[k + 1]
    heights = heights + (plane_z - z) * slopes
    return float(heights[0]), float(heights[1])


def _stop_of(lens: LensTables) -> tuple[int, float, float, float, Array]:
    """Return the space that the stop lies in or bounds, z and radius of the stop, sag of its surface, and its pose."""
    if lens.stop_space >= 0:
        return lens.stop_space, lens.stop_z, lens.stop_radius, 0.0, lens.stop_pose
    surfaces = lens.surfaces
    k = int(np.argmax(surfaces["stop"] == 1))
    rim = float(surfaces[k]["semi_diameter"])
    phi = np.linspace(0.0, 0.5 * np.pi, QUARTER)
    depth = float(np.abs(mesh_heights(surfaces[k], rim * np.cos(phi), rim * np.sin(phi))).max())
    return k, float(surfaces[k]["vertex_z"]), rim, depth, np.array(surfaces[k]["pose"])


@kernel
def _follow_both_ways(
    x: Array, y: Array, tx: Array, ty: Array, z: float, start: float, space: int, pose: Array, colour: int,
    camera: Camera, route: Route, bundle: Array, book: Array, to_sensor: Array, to_objects: Array,
) -> None:  # fmt: skip
    """Trace rays through points of a plane in a space of the lens to the sensor and to object space.

    Parameters
    ----------
    x, y, tx, ty : (n,) float64
        Place, mm, and slopes.
    start : float, mm
        Distance before the plane at which they start, as straight lines, so that all surfaces lie ahead.
    pose : (3, 4) float64
        Rigid motion of that plane and of the rays from their place in the prescription.
    to_sensor : (n, 6) float64
        Filled with place and direction in the sensor's frame, and transmittance; 0 for what ends.
    to_objects : (n, 7) float64
        Filled with point and direction in the camera's frame, and transmittance.
    """
    lens, frames = camera.lens, camera.frames
    last = len(lens.surfaces)
    for first in range(0, len(x), BLOCK):
        count = min(BLOCK, len(x) - first)
        for sense in (-1.0, 1.0):
            for i in range(count):
                sx, sy = tx[first + i], ty[first + i]
                scale = 1.0 / np.sqrt(1.0 + sx * sx + sy * sy)
                back = sense * start
                load(
                    bundle, i, x[first + i] - back * sx, y[first + i] - back * sy, z - back,
                    sense * scale * sx, sense * scale * sy, sense * scale, 1.0,
                )  # fmt: skip
            pad(bundle, count)
            move_bundle(bundle, pose)
            here = space
            while 0 <= here + (sense > 0.0) - 1 < last:
                k = here if sense > 0.0 else here - 1
                into = here + 1 if sense > 0.0 else here - 1
                fates = (lens.surfaces[k].semi_diameter, DROPPED, DROPPED)
                at_surface(bundle, lens, k, False, colour, sense, fates, False, book)
                here = into
            if sense < 0.0:
                normalise(bundle)
                _keep_object_side(bundle, count, first, to_objects)
                continue
            follow_legs(bundle, camera, route, IN_ARRAY, ARRAY_AGAIN, colour, book)
            normalise(bundle)
            move_bundle(bundle, frames[CAMERA_FRAME, SENSOR_FRAME])
            _keep_sensor_side(bundle, count, first, to_sensor)


@kernel
def _keep_object_side(bundle: Array, count: int, first: int, to_objects: Array) -> None:
    for i in range(count):
        kept = to_objects[first + i]
        kept[0], kept[1], kept[2] = bundle[X + i], bundle[Y + i], bundle[Z + i]
        kept[3], kept[4], kept[5] = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        kept[6] = bundle[WEIGHT + i] if bundle[ENDED_ON + i] == 0.0 and bundle[DZ + i] < 0.0 else 0.0


@kernel
def _keep_sensor_side(bundle: Array, count: int, first: int, to_sensor: Array) -> None:
    for i in range(count):
        kept = to_sensor[first + i]
        t = -bundle[Z + i] / bundle[DZ + i]
        kept[0], kept[1] = bundle[X + i] + t * bundle[DX + i], bundle[Y + i] + t * bundle[DY + i]
        kept[2], kept[3], kept[4] = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        kept[5] = bundle[WEIGHT + i] if bundle[ENDED_ON + i] == 0.0 and bundle[DZ + i] > 0.0 and t > 0.0 else 0.0


def _beyond_sensor_aim(aim: AimTables, through: CameraTables, rays: Rays) -> Array:
    """Return the factor by which the opening would have to be wider to hold each ray; up to 1: it holds the ray.

    With an array the factor is 0 for rays in the aim and inf for all others.
    """
    beyond = np.zeros(len(rays.throughput))
    if not through.mla.present:
        _beyond_exit(rays.sensor, aim.exit, through.frames, beyond)
        return beyond
    near, cells = np.zeros((most_listed(aim) + 1, LISTED)), np.zeros((2, most_listed(aim) + 1), np.int64)
    _outside_cells(rays.sensor, rays.colour, aim, through.mla, through.sensor, through.frames, near, cells, beyond)
    return beyond


def _seen_from_cells(aim: AimTables, through: CameraTables, rays: Rays) -> tuple[Array, Array, Array]:
    """Measure rays in the view of the lenslet that they pass.

    Returns
    -------
    off, radius : (n,) float64
        Distance, in slope, from the centre of the lenslet's view, and the radius of the view; −1: it shows nothing.
    out : (n,) float64
        Distance from the centre of the cell, relative to half the cell as it is aimed at.
    """
    off, radius, out = (np.zeros(len(rays.throughput)) for _ in range(3))
    _measure_in_cells(rays.sensor, rays.colour, aim, through.mla, through.frames, off, radius, out)
    return off, radius, out


def _beyond_object_aim(aim: AimTables, seen: Viewpoints | None, rays: Rays, random: np.random.Generator) -> Array:
    """Return the factor of `_beyond_sensor_aim` for the aim from the targets; 0 for rays that miss the targets.

    Each ray is tested at a random distance among those of the targets.
    """
    beyond = np.zeros(len(rays.throughput))
    if seen is None or not aim.entrance.known:
        return beyond
    share = random.random(len(beyond))
    distance = 1.0 / (share / seen.distance[0] + (1.0 - share) / seen.distance[-1])
    t = (seen.plane_z - distance - rays.objects[:, 2]) / rays.objects[:, 5]
    p = rays.objects[:, :3] + t[:, None] * rays.objects[:, 3:]
    inside = np.hypot(p[:, 0], p[:, 1]) <= seen.tangent[-1] * distance
    found = np.zeros(int(inside.sum()))
    _beyond_opening(p[inside], -rays.objects[inside, 3:], aim.entrance, found)
    beyond[inside] = found
    return beyond


def _beyond_near_aim(aim: AimTables, near: NearViewpoints | None, rays: Rays, random: np.random.Generator) -> Array:
    """Return the same for near points; each ray is tested at a random distance among theirs."""
    beyond = np.zeros(len(rays.throughput))
    if near is None or not aim.entrance.known:
        return beyond
    lowest, highest = near.measured[0], near.distance[-1]
    distance = lowest + (highest - lowest) * random.random(len(beyond))
    t = (aim.entrance.plane_z - distance - rays.objects[:, 2]) / rays.objects[:, 5]
    p = rays.objects[:, :3] + t[:, None] * rays.objects[:, 3:]
    inside = np.hypot(p[:, 0], p[:, 1]) <= near.height[-1]
    found = np.zeros(int(inside.sum()))
    _beyond_near(p[inside], -rays.objects[inside, 3:], aim.entrance, distance[inside], found)
    beyond[inside] = found
    return beyond


@kernel
def _beyond_near(p: Array, d: Array, opening: Opening, distance: Array, beyond: Array) -> None:
    """Write the factor of `_beyond_opening` for near points."""
    for i in range(len(beyond)):
        cx, cy, radius = near_disk(opening.near, p[i, 0], p[i, 1], distance[i])
        x, y = p[i, 0] + distance[i] * d[i, 0] / abs(d[i, 2]), p[i, 1] + distance[i] * d[i, 1] / abs(d[i, 2])
        beyond[i] = np.hypot(x - cx, y - cy) / radius if radius > 0.0 else np.inf


@kernel
def _beyond_opening(p: Array, d: Array, opening: Opening, beyond: Array) -> None:
    """Write the factor by which the disk seen from each point would have to be larger for the ray to cross it."""
    for i in range(len(beyond)):
        beyond[i] = _off_disk(opening, p[i, 0], p[i, 1], p[i, 2], d[i, 0], d[i, 1], d[i, 2])


@kernel
def _beyond_exit(rays: Array, opening: Opening, frames: Array, beyond: Array) -> None:
    for i in range(len(beyond)):
        x, y, z = move_point(frames, SENSOR_FRAME, CAMERA_FRAME, rays[i, 0], rays[i, 1], 0.0)
        dx, dy, dz = move_direction(frames, SENSOR_FRAME, CAMERA_FRAME, rays[i, 2], rays[i, 3], rays[i, 4])
        beyond[i] = _off_disk(opening, x, y, z, dx, dy, dz) if opening.known else 0.0


@kernel
def _off_disk(opening: Opening, x: float, y: float, z: float, dx: float, dy: float, dz: float) -> float:
    cx, cy, radius = opening_from(opening, x, y, z)
    if radius <= 0.0:
        return np.inf
    t = (opening.plane_z - z) / dz
    return np.hypot(x + t * dx - cx, y + t * dy - cy) / radius


@kernel
def _outside_cells(
    rays: Array, colour: NDArray[np.int64], aim: AimTables, mla: MlaTables, sensor: SensorTables, frames: Array,
    near: Array, cells: NDArray[np.int64], outside: Array,
) -> None:  # fmt: skip
    """Write inf for each ray (n, 5) along which no aimed path can start, from the pixel that it falls on."""
    extent = pixel_extent(sensor, frames)
    for i in range(len(outside)):
        column = min(max(np.floor(rays[i, 0] / sensor.pixel + 0.5 * sensor.columns), 0), sensor.columns - 1)
        row = min(max(np.floor(rays[i, 1] / sensor.pixel + 0.5 * sensor.rows), 0), sensor.rows - 1)
        x, y = (column + 0.5 - 0.5 * sensor.columns) * sensor.pixel, (row + 0.5 - 0.5 * sensor.rows) * sensor.pixel
        px, py, pz = move_point(frames, SENSOR_FRAME, MLA_FRAME, x, y, 0.0)
        glass = glass_before_faces(mla, colour[i])
        listed = list_cells(mla, aim, glass, px, py, pz, extent, near)
        x, y, z = move_point(frames, SENSOR_FRAME, MLA_FRAME, rays[i, 0], rays[i, 1], 0.0)
        dx, dy, dz = move_direction(frames, SENSOR_FRAME, MLA_FRAME, -rays[i, 2], -rays[i, 3], -rays[i, 4])
        maybe, _, _, _ = cells_that_show(aim, near, listed, cells, x, y, z)
        on_faces, drawn = spread_on_faces(mla, aim, glass, near, cells, maybe, x, y, z, dx, dy, dz)
        if not on_faces + drawn > 0.0:
            outside[i] = np.inf


@kernel
def _measure_in_cells(
    rays: Array, colour: NDArray[np.int64], aim: AimTables, mla: MlaTables, frames: Array,
    off: Array, radius: Array, out: Array,
) -> None:  # fmt: skip
    """Write the results of `_seen_from_cells`; a ray close to a border is measured in the likelier of the cells."""
    lattice = mla.lenslets.lattice
    half = 0.5 * lattice.pitch + aim.cell_margin
    for i in range(len(off)):
        x, y, z = move_point(frames, SENSOR_FRAME, MLA_FRAME, rays[i, 0], rays[i, 1], 0.0)
        dx, dy, dz = move_direction(frames, SENSOR_FRAME, MLA_FRAME, -rays[i, 2], -rays[i, 3], -rays[i, 4])
        over, glass = 1.0 / abs(z - aim.lenslet_z), glass_before_faces(mla, colour[i])
        air, depth, growth = path_to_apexes(mla, z)
        sx, sy = dx / abs(dz), dy / abs(dz)
        q = np.sqrt(glass * glass + (glass * glass - 1.0) * (sx * sx + sy * sy))
        gx, gy = growth * sx / q, growth * sy / q
        px, py = x + sx * air + sx / q * depth, y + sy * air + sy / q * depth
        middle = 0.5 * (mla.lenslets.top + mla.lenslets.valley)
        column, row = cell_of(lattice, px + gx * middle, py + gy * middle)
        off[i], radius[i], out[i] = np.inf, 1.0, np.inf
        for r in range(max(row - 2, 0), min(row + 3, lattice.rows)):
            for c in range(max(column - 2, 0), min(column + 3, lattice.columns)):
                cell = r * lattice.columns + c
                cx, cy = centre(lattice, c, r)
                curvature, ex, ey = shape_of(mla.lenslets, c, r)
                kind = type_of(mla.lenslets, c, r)
                met, ax, ay = on_lenslet(
                    mla.lenslets, kind, curvature, px - cx - ex, py - cy - ey, gx, gy, mla.curved_to_lens
                )
                a, b = (cx - x) * over - aim.slope[cell, 0], (cy - y) * over - aim.slope[cell, 1]
                slope, place = np.sqrt(a * a + b * b), half_width_to(lattice, ax + ex, ay + ey) / half
                if not met or max(place, 1.0) > max(out[i], 1.0):
                    continue
                if max(place, 1.0) < max(out[i], 1.0) or slope < off[i]:
                    off[i], out[i] = slope, place
                    radius[i] = np.sqrt(aim.slope_radius2[cell]) if aim.slope_radius2[cell] > 0.0 else -1.0
