"""The sequential engine: the image path through the exact surfaces of lens and array, met in their known order.

It replaces the stations of the lens and of the array, in either direction; targets are still found by Embree. Reflected
light, and light that total reflection or a neighbouring lenslet turns off the path, is not followed; its power is
booked.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.array.lattice import cell_of, centre, is_inside, leaves_at, neighbour, stays_inside
from lfmesh.geometry.array.lenslets import (
    Lenslets,
    are_alike,
    face_normal,
    face_sag,
    is_spherical,
    meets_profile,
    shape_of,
)
from lfmesh.geometry.frame import direction_through, point_through
from lfmesh.geometry.surfaces.surface import conic_distance
from lfmesh.geometry.surfaces.tessellation import OVERREACH
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.crossing import at_box, box_entry, end, move_packet, refracted
from lfmesh.transport.events.interface import shares
from lfmesh.transport.events.travel import transmitted
from lfmesh.transport.packets.book import HOUSING, MLA_EDGE, MLA_MOUNT, MLA_WALL, STOP, UNFOLLOWED
from lfmesh.transport.packets.packet import (
    BACK_FRAME,
    CAMERA_FRAME,
    EVENTS,
    LEFT_LENS,
    LENS,
    MLA_FRAME,
    NO_SURFACE,
    OBJECT_FRAME,
    OBJECTS,
    PLATE,
    S_ABSORBED,
    SENSOR,
    Flow,
    Options,
    put,
)
from lfmesh.transport.sequential.lens_bundle import (
    BESIDE,
    BLOCK,
    DROPPED,
    DX,
    DY,
    DZ,
    ENDED_ON,
    LEFT_BEHIND,
    MET,
    WEIGHT,
    X,
    Y,
    Z,
    absorb_since_start,
    begin_etendue,
    load,
    move_bundle,
    normalise,
    note_start,
    pad,
    take_etendue,
    through_stop,
    through_surface,
)
from lfmesh.transport.sequential.lenslet_bundle import PASSED, through_single_lenslets
from lfmesh.transport.tables.tables import FLAT_ROW, LensTables, MlaTables

Array = NDArray[np.float64]

MEETS_FACE, LEAVES_LAYER = -1, -2
"""What becomes of a ray in the layer of curved faces, if it does not end there."""


@kernel
def follow_image_path(
    wave: NDArray[np.void], station: int, lens: LensTables, mla: MlaTables, frames: Array,
    bundle: Array, numbers: NDArray[np.int64], options: Options, flow: Flow,
) -> None:  # fmt: skip
    """Take a wave of packets that wait for the lens or the array to object space or to the sensor.

    Parameters
    ----------
    wave : (n,) PACKET
    station : int
        `LENS` or `PLATE`.
    bundle : (ROWS · BLOCK,) float64
    numbers : (BLOCK,) int64
        Working memory.
    """
    for to_sensor in (True, False):
        count = 0
        for i in range(len(wave)):
            packet = wave[i]
            if packet.frame != CAMERA_FRAME:
                move_packet(frames, packet, CAMERA_FRAME)
                if station == LENS:
                    packet.limit = _way_to_box(lens, packet)
            if (packet.dz > 0.0) != to_sensor:
                continue
            if station == LENS and packet.space == 0 and not to_sensor:
                # It comes from object space and flies away from the lens, back into object space.
                _pass_beside(flow, packet, packet.weight)
                continue
            load(
                bundle, count, packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz, packet.weight
            )  # fmt: skip
            numbers[count] = i
            count += 1
            if count == BLOCK:
                follow_block(wave, station, to_sensor, count, lens, mla, frames, bundle, numbers, options, flow)
                count = 0
        if count > 0:
            pad(bundle, count)
            follow_block(wave, station, to_sensor, count, lens, mla, frames, bundle, numbers, options, flow)


@kernel
def follow_block(
    wave: NDArray[np.void], station: int, to_sensor: bool, count: int, lens: LensTables, mla: MlaTables,
    frames: Array, bundle: Array, numbers: NDArray[np.int64], options: Options, flow: Flow,
) -> None:  # fmt: skip
    """Take a bundle of rays (camera frame) of one direction of travel along the image path, and queue its packets.

    Parameters
    ----------
    wave : (n,) PACKET
        The packets before the passage.
    count : int
        Rays in the bundle.
    numbers : (BLOCK,) int64
        Index in the wave of each ray's packet.
    """
    colour = wave[numbers[0]].colour
    at_lens = station != PLATE
    if to_sensor:
        if at_lens:
            through_lens(bundle, lens, colour, True, flow.book)
            if options.importance:
                take_etendue(lens.interfaces, bundle, flow.book)
        if mla.present:
            through_mla(bundle, count, mla, colour, frames, to_sensor, flow.book)
    else:
        if not at_lens:
            through_mla(bundle, count, mla, colour, frames, to_sensor, flow.book)
        through_lens(bundle, lens, colour, False, flow.book)
        if options.importance:
            take_etendue(lens.interfaces, bundle, flow.book)
    normalise(bundle)
    _hand_on(wave, to_sensor, count, frames, bundle, numbers, options, flow)


@kernel
def _hand_on(
    wave: NDArray[np.void], to_sensor: bool, count: int, frames: Array, bundle: Array, numbers: NDArray[np.int64],
    options: Options, flow: Flow,
) -> None:  # fmt: skip
    """Queue the packets that came through at their next station, and end the others."""
    station, frame = SENSOR, CAMERA_FRAME
    if not to_sensor:
        # Moved together, which is faster than one by one at the station.
        station, frame = OBJECTS, OBJECT_FRAME
        move_bundle(bundle, frames[CAMERA_FRAME, OBJECT_FRAME])
    left_behind, events = 0.0, 0
    for i in range(count):
        packet = wave[numbers[i]]
        left_behind += bundle[LEFT_BEHIND + i]
        met = int(bundle[MET + i])
        events += met
        packet.events += met
        x, y, z = bundle[X + i], bundle[Y + i], bundle[Z + i]
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        weight, ended = bundle[WEIGHT + i], bundle[ENDED_ON + i]
        if ended == 0.0:
            child = put(flow, station, packet, frame, x, y, z, dx, dy, dz, weight, packet.key, 0.0)
            child.last, child.facet, child.bodies = LEFT_LENS, NO_SURFACE, NO_SURFACE
        elif ended == BESIDE:
            _pass_beside(flow, packet, weight)
        elif ended != DROPPED:
            end(
                options, flow, frames, packet, frame, x, y, z, dx, dy, dz, weight, int(ended) - 1, S_ABSORBED
            )  # fmt: skip
    flow.counts[EVENTS] += events
    flow.book[UNFOLLOWED] += left_behind


@inlined
def _way_to_box(lens: LensTables, packet: Any) -> float:
    """Return the distance at which a packet from object space enters the box of the lens; nothing is in its way."""
    t = box_entry(lens.box_low, lens.box_high, packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz)
    # By rounding, a ray along the border may miss the box that it was found to enter.
    return t if t < np.inf else 0.0


@inlined
def _pass_beside(flow: Flow, packet: Any, weight: float) -> None:
    """Queue a packet from object space (camera frame) that met nothing of the lens for object space."""
    x, y, z = at_box(packet)
    child = put(
        flow, OBJECTS, packet, CAMERA_FRAME, x, y, z, packet.dx, packet.dy, packet.dz, weight, packet.key, 0.0
    )  # fmt: skip
    child.last, child.facet, child.bodies = LEFT_LENS, NO_SURFACE, NO_SURFACE


@kernel
def through_lens(bundle: Array, lens: LensTables, colour: int, to_sensor: bool, book: Array) -> None:
    """Take a bundle (camera frame) through all surfaces of the lens and through its stop.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
    lens : LensTables
    colour : int
        Number of the wavelength.
    to_sensor : bool
        Direction of travel.
    book : (slots,) float64
        For light that the glasses absorb.
    """
    absorption, last = lens.media.absorption, len(lens.surfaces)
    begin_etendue(lens.interfaces, bundle)
    for step in range(last + 1):
        space = step if to_sensor else last - step
        note_start(absorption, bundle)
        if lens.stop_space == space:
            if lens.stop_posed:
                move_bundle(bundle, lens.stop_unpose)
            through_stop(bundle, lens.stop_z, lens.stop_radius, float(STOP))
            if lens.stop_posed:
                move_bundle(bundle, lens.stop_pose)
        if step == last:
            break
        k = space if to_sensor else space - 1
        beyond = lens.ring_slot[space] + 1.0
        if step == 0:
            beyond = BESIDE if to_sensor else HOUSING + 1.0
        through_surface(
            bundle, lens, k, colour, 1.0 if to_sensor else -1.0,
            lens.surfaces[k].semi_diameter * (1.0 + OVERREACH), lens.mount_slot[k] + 1.0, beyond,
        )  # fmt: skip
        absorb_since_start(absorption, bundle, lens.medium[space], colour, book)


@kernel
def through_mla(
    bundle: Array, count: int, mla: MlaTables, colour: int, frames: Array, to_sensor: bool, book: Array
) -> None:
    """Take a bundle (camera frame) through the array, curved or flat face first.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
    count : int
        Number of rays in it.
    mla : MlaTables
    colour : int
        Number of the wavelength.
    frames : (6, 6, 3, 4) float64
    to_sensor : bool
        Direction of travel.
    book : (slots,) float64
        For light that the array absorbs.
    """
    move_bundle(bundle, frames[CAMERA_FRAME, MLA_FRAME])
    begin_array(bundle, count, mla, colour, to_sensor == mla.curved_to_lens, frames, True)
    for i in range(count):
        if bundle[ENDED_ON + i] != 0.0 or bundle[PASSED + i] > 0.0:
            continue
        if bundle[DZ + i] > 0.0:
            through = _through_curved_face(bundle, i, mla, colour, book)
            through = through and _through_other_face(mla.back, bundle, i, mla, colour, frames, book)
        else:
            through = _through_other_face(mla.back, bundle, i, mla, colour, frames, book)
            through = through and _through_curved_face(bundle, i, mla, colour, book)
        if not through and bundle[ENDED_ON + i] == 0.0:
            bundle[LEFT_BEHIND + i] += bundle[WEIGHT + i]
            bundle[ENDED_ON + i] = DROPPED
    move_bundle(bundle, frames[MLA_FRAME, CAMERA_FRAME])


@kernel
def begin_array(
    bundle: Array, count: int, mla: MlaTables, colour: int, inward: bool, frames: Array, together: bool
) -> None:
    """Take rays of a bundle that meet a single lenslet of a face through the array together; `PASSED` marks these rays.

    The others are left for their callers, which take them one by one, from cell to cell. So are all in an array that is
    coated or absorbs, or whose lenslets are no spheres.

    Parameters
    ----------
    bundle, count, mla, colour, frames
        As for `through_mla`, in the array frame.
    inward : bool
        The rays meet the curved face first.
    together : bool
        False leaves all rays.
    """
    if (
        not together
        or mla.interfaces.coated
        or _absorbs(mla.media.absorption)
        or not _of_spheres(mla.lenslets, mla.back)
    ):
        for i in range(count):
            bundle[PASSED + i] = 0.0
    else:
        through_single_lenslets(bundle, mla, colour, inward, frames)


@inlined
def _of_spheres(lenslets: Lenslets, back: Any) -> bool:
    """Tell whether all lenslets are spheres, those on the other face too, if there are any."""
    if back is None:
        return is_spherical(lenslets.profile)
    return is_spherical(lenslets.profile) and is_spherical(back.lenslets.profile)


@inlined
def _through_other_face(
    back: Any, bundle: Array, i: int, mla: MlaTables, colour: int, frames: Array, book: Array
) -> bool:  # fmt: skip
    """Refract a ray at the flat face, or at the lenslets that stand in its place; `back` is that of `mla`."""
    if back is None:
        return _through_flat_face(bundle, i, mla, colour, book)
    move_ray(bundle, i, frames[MLA_FRAME, BACK_FRAME])
    through = _through_curved_face(bundle, i, back, colour, book)
    move_ray(bundle, i, frames[BACK_FRAME, MLA_FRAME])
    return through


@kernel
def move_ray(bundle: Array, i: int, move: Array) -> None:
    """Move one ray of a bundle into another frame.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
    i : int
        Place of the ray.
    move : (3, 4) float64
    """
    x, y, z = point_through(move, bundle[X + i], bundle[Y + i], bundle[Z + i])
    dx, dy, dz = direction_through(move, bundle[DX + i], bundle[DY + i], bundle[DZ + i])
    bundle[X + i], bundle[Y + i], bundle[Z + i] = x, y, z
    bundle[DX + i], bundle[DY + i], bundle[DZ + i] = dx, dy, dz


@inlined
def _absorbs(absorption: Any) -> bool:
    return absorption is not None


@inlined
def _absorb(absorption: Any, bundle: Array, i: int, medium: int, colour: int, t: float, book: Array) -> None:
    """Take from a ray what the array's glass absorbs over a distance."""
    if absorption is None:
        return
    left = bundle[WEIGHT + i] * transmitted(absorption, medium, colour, t)
    if left < bundle[WEIGHT + i]:
        book[absorption.slot[medium]] += bundle[WEIGHT + i] - left
        bundle[WEIGHT + i] = left


@kernel
def _through_flat_face(bundle: Array, i: int, mla: MlaTables, colour: int, book: Array) -> bool:
    along = 1.0 if bundle[DZ + i] > 0.0 else -1.0
    return meet_flat_face(bundle, i, mla, colour, book) and bend(
        bundle, i, mla, FLAT_ROW, colour, along < 0.0, 0.0, 0.0, along
    )


@kernel
def meet_flat_face(bundle: Array, i: int, mla: MlaTables, colour: int, book: Array) -> bool:
    """Take a ray to the flat face; False where it ends before, or beside it.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
        In the array's frame.
    i : int
        Place of the ray.
    mla : MlaTables
    colour : int
        Number of the wavelength.
    book : (slots,) float64
        For light that the array absorbs.
    """
    lattice = mla.lenslets.lattice
    x, y, dz = bundle[X + i], bundle[Y + i], bundle[DZ + i]
    t = (mla.lenslets.thickness - bundle[Z + i]) / dz
    if not t > 0.0:
        return _ends(bundle, i, 0.0, MLA_MOUNT)
    if dz > 0.0:
        _absorb(mla.media.absorption, bundle, i, mla.medium, colour, t, book)
    to_x, to_y = x + t * bundle[DX + i], y + t * bundle[DY + i]
    if dz > 0.0:
        held = stays_inside(lattice, x, y, to_x, to_y)
    else:
        column, row = cell_of(lattice, to_x, to_y)
        held = is_inside(lattice, column, row)
    if not held:
        return _ends(bundle, i, t, MLA_EDGE if dz > 0.0 else MLA_MOUNT)
    bundle[X + i], bundle[Y + i], bundle[Z + i] = to_x, to_y, mla.lenslets.thickness
    return True


@kernel
def _through_curved_face(bundle: Array, i: int, mla: MlaTables, colour: int, book: Array) -> bool:
    """Refract a ray at the face of the lenslet that it meets, and follow it out of the layer of faces."""
    inward = bundle[DZ + i] > 0.0
    met, column, row, nx, ny, nz = meet_curved_face(bundle, i, mla, colour, book)
    if not met or not bend(bundle, i, mla, mla.row, colour, inward, nx, ny, nz) or (bundle[DZ + i] > 0.0) != inward:
        return False
    return leave_layer(bundle, i, mla, not inward, column, row, colour, book)


@kernel
def meet_curved_face(
    bundle: Array, i: int, mla: MlaTables, colour: int, book: Array
) -> tuple[bool, int, int, float, float, float]:
    """Take a ray to the face of the lenslet that it meets.

    Parameters
    ----------
    bundle, i, mla, colour, book
        As for `meet_flat_face`, in the frame of these lenslets.

    Returns
    -------
    met : bool
        False where it ends before, or passes through the layer of faces.
    column, row : int
        The lenslet's cell.
    nx, ny, nz : float
        Unit normal, along the ray.
    """
    lenslets = mla.lenslets
    lattice = lenslets.lattice
    x, y, z, dz = bundle[X + i], bundle[Y + i], bundle[Z + i], bundle[DZ + i]
    inward = dz > 0.0
    if inward and z > lenslets.valley:
        return _ends(bundle, i, 0.0, MLA_MOUNT), 0, 0, 0.0, 0.0, 0.0
    t = max(0.0, ((lenslets.top if inward else lenslets.valley) - z) / dz)
    at_x, at_y = x + t * bundle[DX + i], y + t * bundle[DY + i]
    column, row = cell_of(lattice, at_x, at_y)
    if not (is_inside(lattice, column, row) if inward else stays_inside(lattice, x, y, at_x, at_y)):
        if not inward:
            _absorb(mla.media.absorption, bundle, i, mla.medium, colour, t, book)
        return _ends(bundle, i, t, MLA_MOUNT if inward else MLA_EDGE), 0, 0, 0.0, 0.0, 0.0
    fate, t, column, row = _next_in_layer(bundle, i, mla, inward, column, row, t)
    if not inward:
        _absorb(mla.media.absorption, bundle, i, mla.medium, colour, t, book)
    if fate >= 0:
        return _ends(bundle, i, t, fate), 0, 0, 0.0, 0.0, 0.0
    if fate != MEETS_FACE:
        return False, 0, 0, 0.0, 0.0, 0.0
    bundle[X + i] += t * bundle[DX + i]
    bundle[Y + i] += t * bundle[DY + i]
    bundle[Z + i] += t * dz
    cx, cy = centre(lattice, column, row)
    curvature, ex, ey = shape_of(lenslets, column, row)
    sense = 1.0 if inward else -1.0
    nx, ny, nz = face_normal(
        lenslets, column, row, curvature, bundle[X + i] - cx - ex, bundle[Y + i] - cy - ey, bundle[Z + i]
    )
    return True, column, row, sense * nx, sense * ny, sense * nz


@kernel
def leave_layer(
    bundle: Array, i: int, mla: MlaTables, in_air: bool, column: int, row: int, colour: int, book: Array
) -> bool:
    """Tell whether a ray leaves the layer of faces, from a face in a cell, without meeting another one.

    Parameters
    ----------
    bundle, i, mla, colour, book
        As for `meet_flat_face`, in the frame of these lenslets.
    in_air : bool
        It has come into the air; else it is in the glass.
    column, row : int
    """
    fate, t, column, row = _next_in_layer(bundle, i, mla, in_air, column, row, 0.0)
    if fate >= 0:
        if not in_air:
            _absorb(mla.media.absorption, bundle, i, mla.medium, colour, t, book)
        return _ends(bundle, i, t, fate)
    return fate == LEAVES_LAYER


@kernel
def _next_in_layer(
    bundle: Array, i: int, mla: MlaTables, in_air: bool, column: int, row: int, start: float
) -> tuple[int, float, int, int]:
    """Walk a ray through the layer of faces; return its fate (or the slot that it ends on), the distance and the cell.

    Parameters
    ----------
    in_air : bool
        The ray is before the curved face; else in the glass.
    column, row : int
        Cell in which the walk starts.
    start : float, mm
        Distance at which the ray is in that cell.
    """
    lenslets = mla.lenslets
    lattice = lenslets.lattice
    x, y, z = bundle[X + i], bundle[Y + i], bundle[Z + i]
    dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
    out = ((lenslets.valley if dz > 0.0 else lenslets.top) - z) / dz
    t = start
    # Each step goes on in the ray's direction: the walk ends at the array's edge at the latest.
    while True:
        cx, cy = centre(lattice, column, row)
        curvature, ex, ey = shape_of(lenslets, column, row)
        leaves, side = leaves_at(lattice, x - cx, y - cy, dx, dy)
        if is_spherical(lenslets.profile):
            met, more = conic_distance(
                curvature, 0.0, x + t * dx - cx - ex, y + t * dy - cy - ey, z + t * dz, dx, dy, dz,
                1.0 if in_air else -1.0,
            )  # fmt: skip
            hit = t + more
            # A hit beyond the layer is on the sphere's other half.
            met = met and 0.0 < hit <= leaves and curvature * (z + hit * dz) < 1.0
        else:
            met, hit = meets_profile(
                lenslets.profile, lenslets, column, row, x - cx, y - cy, z, dx, dy, dz, in_air, t, min(leaves, out)
            )
        if met:
            return MEETS_FACE, hit, column, row
        if out < leaves:
            return LEAVES_LAYER, out, column, row
        t = leaves
        column, row = neighbour(lattice, column, row, side)
        if not is_inside(lattice, column, row):
            return MLA_MOUNT if in_air else MLA_EDGE, t, column, row
        if not are_alike(lenslets):
            cx, cy = centre(lattice, column, row)
            curvature, ex, ey = shape_of(lenslets, column, row)
            face = face_sag(lenslets, column, row, curvature, x + t * dx - cx - ex, y + t * dy - cy - ey)
            if (z + t * dz > face) == in_air:
                return MLA_WALL, t, column, row


@kernel
def bend(
    bundle: Array, i: int, mla: MlaTables, face: int, colour: int, entering: bool, nx: float, ny: float, nz: float
) -> bool:
    """Refract a ray at a face whose normal points along it; return False under total reflection.

    Parameters
    ----------
    bundle, i, mla, colour
        As for `meet_flat_face`.
    face : int
        Row of the face among the array's interfaces.
    entering : bool
        The ray comes from the air.
    nx, ny, nz : float
        Unit normal.
    """
    glass = mla.media.indices[mla.medium, colour]
    n_i, n_t = (1.0, glass) if entering else (glass, 1.0)
    dx, dy, dz, weight = bundle[DX + i], bundle[DY + i], bundle[DZ + i], bundle[WEIGHT + i]
    cos_i = min(nx * dx + ny * dy + nz * dz, 1.0)
    reflectance, transmittance, cos_t = shares(mla.interfaces, face, colour, n_i, n_t, cos_i)
    bundle[MET + i] += 1.0
    if transmittance == 0.0:
        return False
    bundle[LEFT_BEHIND + i] += weight * reflectance
    bundle[WEIGHT + i] = weight * transmittance
    bundle[DX + i], bundle[DY + i], bundle[DZ + i] = refracted(dx, dy, dz, nx, ny, nz, n_i / n_t, cos_i, cos_t)
    return True


@kernel
def _ends(bundle: Array, i: int, t: float, slot: int) -> bool:
    """End a ray after a distance; always return False, as the ray does not continue."""
    bundle[X + i] += t * bundle[DX + i]
    bundle[Y + i] += t * bundle[DY + i]
    bundle[Z + i] += t * bundle[DZ + i]
    bundle[ENDED_ON + i] = slot + 1.0
    return False
