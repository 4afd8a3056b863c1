"""Warnings about lamps in the field, close to a target, or with a narrow beam."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from lfmesh.errors import HeavyPathsWarning, MissedLightWarning, PictureWarning
from lfmesh.geometry import frame
from lfmesh.geometry.meshes.mesh import Array, Mesh, crossings, distance_of_segment_mm
from lfmesh.geometry.objects.targets import named_target
from lfmesh.scene.advice import half_field_mm
from lfmesh.scene.light.region import Region
from lfmesh.scene.literals import plain
from lfmesh.transport.packets.packet import CAMERA_FRAME, OBJECT_FRAME, OBJECTS, WORLD_FRAME
from lfmesh.transport.regions.first_met import first_met
from lfmesh.transport.tables.motions import STILL
from lfmesh.transport.tables.swept import swept
from lfmesh.transport.world import World

ENOUGH_ON_SPOT = 20.0
"""Effective number of samples needed in the spot lit by a lamp close to a target. The truth lay within twice the stated
error in 96 of 100 runs with 26 samples, in 85 with 7, in 60 with 1."""

NARROW = 64.0
"""Ratio of largest to mean intensity above which a lamp's light is a beam: a cone of 14° or less."""

STEEPEST = 2.0**-10
"""Cosine of incidence below which the computed spot of a beam grows no larger."""

MOST_NAMED = 8
"""Largest number of lamps named individually."""

GRAIN = 2.0**-40
"""Relative enlargement of the bounds of lamps, over their size and distance: more than rounding."""


def lamps_in_field(world: World) -> Iterator[PictureWarning]:
    """Warn of lamps in view of the camera: they are not imaged, and few paths find a flat lamp's light in fog."""
    scatters = any(medium.may_scatter for medium in world.scene.media)
    for named, (number, stands) in enumerate(_found_in_field(world)):
        light = world.scene.lights[number]
        if named == MOST_NAMED:
            yield MissedLightWarning(
                f"lights[{number}] and perhaps more of the {len(world.scene.lights)} lights stand in the field; no "
                "further ones are named"
            )
            return
        yield MissedLightWarning(
            f"lights[{number}] {stands} the field, but lamps light the scene and are not seen themselves. To see it, "
            "replace it by a target with radiance_w_m2_sr"
        )
        if scatters and light.region is not None and light.region.thickness_mm > 0.0:
            yield HeavyPathsWarning(
                f"lights[{number}], a {light.kind}, stands in the field of a scene with scattering media. Where "
                f"lines of sight cross the plane of the {light.kind}, few paths bring much of the light, and errors "
                "and upper bounds of single pixels are too small. Take many more samples, or a point lamp"
            )


def _found_in_field(world: World) -> Iterator[tuple[int, str]]:
    """Yield the numbers of lamps in the field, and whether they stand in it or pass through it."""
    near, moving = set(_near_field(world)), set(_moving(world))
    for number in sorted(near | moving):
        if number in near and _is_seen(world, world.scene.lights[number].region):
            yield number, "stands in"
        elif number in moving and _passes(world, number):
            yield number, "passes through"


def _is_seen(world: World, region: Region | None) -> bool:
    """Tell whether a lamp stands in the field, not hidden by a target."""
    if region is None or not _in_field(world, _spine(world, region), region.thickness_mm):
        return False
    return not _hidden(world, region)


def _moving(world: World) -> list[int]:
    """Return the numbers of the lamps that move relative to the camera."""
    motions = world.tables.motions
    return [] if motions is None else np.flatnonzero(motions.of_lamp != STILL).tolist()


def _passes(world: World, number: int) -> bool:
    """Tell whether a moving lamp may come into the field during the exposure; targets may hide it there."""
    region, tables = world.scene.lights[number].region, world.tables
    if region is None or tables.motions is None:
        return False
    (place,) = frame.points(tables.frames[WORLD_FRAME, OBJECT_FRAME], [region.centre_mm])
    places, margin = swept(tables.motions, int(tables.motions.of_lamp[number]), place[None])
    path = frame.points(tables.frames[OBJECT_FRAME, CAMERA_FRAME], places)
    beside = float(np.linalg.norm(region.spine_mm)) + region.thickness_mm + margin
    return any(_in_field(world, np.stack(chord), beside) for chord in pairwise(path))


def _near_field(world: World, beside: float = 0.0) -> list[int]:
    """Return the numbers of the lamps that may reach into the field or near it.

    `beside` is the distance that counts as near, over the geometric mean of the field's width and height there.
    """
    lamps, facts = world.tables.objects.lamps.rows, world.facts
    placed = np.flatnonzero(lamps["placed"])
    if not len(placed):
        return []
    x, y, z = frame.points(world.tables.frames[OBJECT_FRAME, CAMERA_FRAME], lamps["position"][placed]).T
    # The edges of the field are straight between these planes. They are convex, so the ends of a lamp bound its width.
    size = lamps["size"][placed] * (1.0 + GRAIN) + GRAIN * (np.abs(x) + np.abs(y) + np.abs(z))
    planes = np.unique([0.0, -facts.object_distance_mm, facts.entrance_pupil_z_mm, *(z - size), *(z + size)])
    planes = planes[np.isfinite(planes)]
    ends = np.unique([planes.min(), planes.max(), 0.0, -facts.object_distance_mm, facts.entrance_pupil_z_mm])
    ends = ends[np.isfinite(ends) & (ends >= planes.min()) & (ends <= planes.max())]
    halves = np.array([half_field_mm(float(end), facts) for end in ends])
    width, height = (np.maximum(np.interp(z - size, ends, half), np.interp(z + size, ends, half)) for half in halves.T)
    margin = size + beside * np.sqrt(width * height) + GRAIN * (width + height)
    near = (np.abs(x) <= width + margin) & (np.abs(y) <= height + margin) & (z - size <= 0.0)
    return [int(number) for number in placed[near]]


def _spine(world: World, region: Region) -> Array:
    """Return the ends of a lamp's central segment, (2, 3) mm, camera frame."""
    ends = region.centre_mm + np.array([[-1.0], [1.0]]) * region.spine_mm
    return frame.points(world.tables.frames[WORLD_FRAME, CAMERA_FRAME], ends)


def _in_field(world: World, ends: Array, beside_mm: float) -> bool:
    """Tell whether a segment, (2, 3) in the camera frame, comes within a distance of the field.

    The edges of the field are straight between the focal, pupil and axial planes.
    """
    start, way = ends[0], ends[1] - ends[0]
    facts = world.facts
    planes = [(2, z) for z in (0.0, -facts.object_distance_mm, facts.entrance_pupil_z_mm)]
    with np.errstate(divide="ignore", invalid="ignore"):
        cuts = np.array([(z - start[axis]) / way[axis] for axis, z in (*planes, (0, 0.0), (1, 0.0))])
    shares = np.unique([0.0, *cuts[(cuts > 0.0) & (cuts < 1.0)], 1.0])
    places = start + shares[:, None] * way
    outside = np.array(
        [[*(np.abs(place[:2]) - beside_mm - half_field_mm(float(place[2]), facts)), place[2]] for place in places]
    )
    return any(_all_fall_to_zero(one, other) for one, other in pairwise(outside))


def _all_fall_to_zero(one: Array, other: Array) -> bool:
    """Tell whether numbers, linear between two ends, are all ≤ 0 at one place, with the last < 0 at an end."""
    first, last = 0.0, 1.0
    for a, b in zip(one, other, strict=True):
        if a > 0.0 and b > 0.0:
            return False
        if a > 0.0:
            first = max(first, a / (a - b))
        elif b > 0.0:
            last = min(last, a / (a - b))
    return first <= last and bool(min(one[-1], other[-1]) < 0.0)


def _hidden(world: World, region: Region) -> bool:
    """Tell whether an opaque target hides a lamp from the first vertex of the lens.

    A body that hides the lamp's middle hides all of it unless one of its silhouette or boundary edges covers a part.
    """
    (eye,) = frame.points(world.tables.frames[CAMERA_FRAME, WORLD_FRAME], np.zeros((1, 3)))
    corners = region.corners_mm
    for number, body in enumerate(world.targets):
        target = world.scene.targets[number]
        if target.refractor is not None or body.alpha is not None or target.material.opacity != 1.0:
            continue
        if _is_beside(body.box_mm, region.centre_mm, eye, 0.0):
            continue
        mesh = body.mesh
        if not crossings(mesh.vertices[mesh.faces], region.centre_mm, eye)[1].any():
            continue
        if len(corners) == 1 or not _any_before(_outline(mesh, eye), corners, eye):
            return True
    return False


def _outline(mesh: Mesh, eye: Array) -> Array:
    """Return the boundary and silhouette edges of a mesh as seen from an eye, (n, 2, 3) mm."""
    pairs = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    seen = np.repeat(np.einsum("ij,ij->i", np.cross(b - a, c - a), eye - a) > 0.0, 3)
    edges, which, count = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
    fronts = np.bincount(which.ravel(), weights=seen)
    return mesh.vertices[edges[(count != 2) | (fronts == 1.0)]]


def _any_before(edges: Array, corners: Array, eye: Array) -> bool:
    """Tell whether an edge enters the cone from an eye to a convex outline of two or four corners, mm."""
    rays, middle = corners - eye, corners.mean(axis=0) - eye
    sides = np.cross(rays, np.roll(rays, -1, axis=0))
    if len(corners) == 2:
        sides = np.array([sides[0], sides[1], np.cross(rays[0], sides[0]), np.cross(rays[1], sides[0])])
        base = np.cross(corners[1] - corners[0], sides[0])
    else:
        base = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    planes = [side * (np.sign(side @ middle) or 1.0) for side in sides]
    if len(corners) == 2:
        planes[:2] = sides[:2]
    first, last = np.zeros(len(edges)), np.ones(len(edges))
    from_eye = edges - eye
    heights = [(from_eye @ plane) for plane in planes]
    heights.append((middle - from_eye) @ base * (np.sign(middle @ base) or 1.0))
    for height in heights:
        one, change = height[:, 0], height[:, 1] - height[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            meets = -one / change
        first = np.where(change > 0.0, np.maximum(first, meets), first)
        last = np.where(change < 0.0, np.minimum(last, meets), last)
        last = np.where((change == 0.0) & (one < 0.0), -np.inf, last)
    return bool((first <= last).any())


def lamps_at_targets(world: World) -> Iterator[PictureWarning]:
    """Warn of lamps so close to a target in the field that few paths from the pixels meet the spot that they light.

    A point lamp at a height h lights its target by h/(h² + r²)^(3/2), a long one a strip by h/(h² + r²). Samples spread
    evenly with a density d are then worth 8π h² d samples of equal light, plus 2π h d per unit length of the strip.
    """
    transport = world.scene.transport
    if transport.method != "adjoint":
        return
    columns, rows = world.scene.camera.sensor.pixels
    samples = columns * rows * transport.samples_each * transport.replicates
    # Largest distance of a point lamp, which lights the largest spot.
    beside = np.sqrt(ENOUGH_ON_SPOT / (2.0 * np.pi * samples))
    named = 0
    for number in _near_field(world, beside):
        region = world.scene.lights[number].region
        if region is None or named == MOST_NAMED:
            continue
        ends = _spine(world, region)
        half = np.max([half_field_mm(float(z), world.facts) for z in ends[:, 2]], axis=0)
        lit = ENOUGH_ON_SPOT / samples * 4.0 * half.prod()
        strip = 2.0 * np.pi * float(np.linalg.norm(ends[1] - ends[0]))
        reach = 2.0 * lit / (strip + np.sqrt(strip**2 + 32.0 * np.pi * lit)) if lit > 0.0 else 0.0
        if region.thickness_mm > reach or not _in_field(world, ends, reach):
            continue
        start, end = region.centre_mm - region.spine_mm, region.centre_mm + region.spine_mm
        for target, body in enumerate(world.targets):
            if world.scene.targets[target].refractor is not None or _is_beside(body.box_mm, start, end, reach):
                continue
            mesh = body.mesh
            near = _distance_mm(mesh.vertices[mesh.faces], start, end, reach)
            if near < reach:
                named += 1
                yield HeavyPathsWarning(
                    f"lights[{number}] stands {plain(near, 2)} mm from {named_target(world.scene, target)}, and few "
                    "samples meet the spot it lights. The picture may be too dark, and its error too small. Move the "
                    f'lamp {plain(reach, 2)} mm or more away, take more samples, or use method = "forward"'
                )


def narrow_beams(world: World) -> Iterator[PictureWarning]:
    """Warn of narrow beams that light a spot in the field met by few paths from the pixels.

    The solid angle of a beam is its power over its largest intensity.
    """
    transport, lamps = world.scene.transport, world.tables.objects.lamps.rows
    narrow = np.flatnonzero(lamps["placed"] & (lamps["gain"] > NARROW))
    if transport.method != "adjoint" or not len(narrow):
        return
    objects, axes = world.tables.objects, lamps["direction"][narrow]
    facet, t, normal = first_met(objects, world.finders[OBJECTS], lamps["position"][narrow], axes)
    to_camera = world.tables.frames[OBJECT_FRAME, CAMERA_FRAME]
    reach = np.where(facet >= 0, t, 0.0)
    ends = frame.points(to_camera, lamps["position"][narrow] + reach[:, None] * axes)
    normals = frame.directions(to_camera, normal)
    columns, rows = world.scene.camera.sensor.pixels
    samples = columns * rows * transport.samples_each * transport.replicates
    named = 0
    for k in np.flatnonzero(facet >= 0):
        number, body = int(narrow[k]), int(objects.facets["body"][facet[k]])
        half = half_field_mm(float(ends[k, 2]), world.facts)
        along, seen_along = float(normal[k] @ axes[k]), float(normals[k] @ ends[k])
        glass = body >= 0 and world.scene.targets[body].refractor is not None
        if body < 0 or glass or along * seen_along <= 0.0 or ends[k, 2] >= 0.0:
            continue
        if (np.abs(ends[k, :2]) > half).any() or named == MOST_NAMED:
            continue
        # Area across the beam, then as seen by the camera.
        area = 4.0 * np.pi / lamps["gain"][number] * reach[k] ** 2 + float(lamps["area"][number])
        seen = area * abs(seen_along) / (float(np.linalg.norm(ends[k])) * max(abs(along), STEEPEST))
        if samples * seen < ENOUGH_ON_SPOT * 4.0 * np.prod(half):
            named += 1
            yield HeavyPathsWarning(
                f"lights[{number}] lights a spot only {plain(2.0 * np.sqrt(area / np.pi), 2)} mm wide on "
                f"{named_target(world.scene, body)}, and few samples meet it. The picture may be too dark, and its "
                'error too small. Use a wider beam, more samples, or method = "forward"'
            )


def _is_beside(box: Array, start: Array, end: Array, reach: float) -> bool:
    """Tell whether a segment's bounding box clears a box, (2, 3) mm, by more than a reach."""
    low, high = np.minimum(start, end) - reach, np.maximum(start, end) + reach
    return bool((box[0] > high).any() or (box[1] < low).any())


def _distance_mm(corners: Array, start: Array, end: Array, reach: float) -> float:
    """Return the distance from a segment to the nearest facet; inf if all their boxes are beyond a reach."""
    low, high = np.minimum(start, end) - reach, np.maximum(start, end) + reach
    near = ((corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)).all(axis=1)
    if not near.any():
        return np.inf
    return distance_of_segment_mm(corners[near], start, end)
