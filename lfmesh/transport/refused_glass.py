"""Refuse bodies of glass in object space through which rays cannot be traced.

A packet keeps track of the bodies of glass that it is in, by the surfaces that it crosses. So no surface may cut
itself, the shells of a body must be nested with the right orientation, and camera and lamps must stand in air. Where
bodies overlap, it must be defined which of them counts: the one of higher priority or, at equal priority, the one that
lies inside the other.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.geometry.meshes.crossings import parts_in_shells, set_back
from lfmesh.geometry.meshes.mesh import Array, Mesh, boxes_meet, crossings, facet_normals, joined
from lfmesh.geometry.meshes.winding import shells, winding
from lfmesh.geometry.objects.targets import TargetMesh, named_target
from lfmesh.scene import Light, Scene
from lfmesh.scene.light.region import Region
from lfmesh.scene.literals import plain
from lfmesh.transport.close_faces import refuse_close_faces
from lfmesh.transport.events.bodies import MOST_AT_ONCE, MOST_BODIES
from lfmesh.transport.events.facets import FLOAT32_GRAIN
from lfmesh.transport.regions.embree import Finder
from lfmesh.transport.tables.contacts import CUT, common_area, touching_mm, widest_contact_mm

Index = NDArray[np.int64]

MOST_ROUNDS = 64
"""Largest number of queries along an edge, which passes its own facets and those that it touches."""

JUST_BESIDE = 1e-6
"""Distance from the centre of a facet at which a point is just inside or outside its body, relative to the radius of
the facet's inscribed circle."""

AS_CLOSE = 2.0
"""Faces of glass and of another target lie on each other where they are closer than this, in roundings of float32."""


def refuse_untraceable_glass(scene: Scene, targets: list[TargetMesh], front: Array) -> Index:
    """Refuse glass that cuts itself, encloses the camera or a light, or overlaps without a rule; return the ranks.

    Parameters
    ----------
    scene : Scene
    targets : list of TargetMesh
        Of the scene, in order.
    front : (n, 3) float64, mm
        Points of the camera's first surface, world frame.

    Returns
    -------
    (targets,) int64
        Rank of each body of glass, from 1; where bodies overlap, the highest rank counts. 0: not a body of glass.

    Raises
    ------
    SceneError
        Naming the bodies and the place.
    """
    bodies = [i for i, target in enumerate(scene.targets) if target.refractor is not None]
    ranks = np.zeros(len(targets), np.int64)
    if not bodies:
        return ranks
    if len(bodies) > MOST_BODIES:
        raise SceneError(f"{len(bodies)} targets are glass bodies; there can be {MOST_BODIES}")
    priority = {i: _priority(scene, i) for i in bodies}
    names = {i: named_target(scene, i) for i in bodies}
    meshes = {i: targets[i].mesh for i in bodies}
    _refuse_cuts(meshes, names, priority)
    parts = {i: [meshes[i].vertices[meshes[i].faces[facets]] for facets in shells(meshes[i])] for i in bodies}
    _refuse_wrong_shells(parts, names)
    refuse_close_faces(scene, targets, bodies)
    holders = _holders(parts, names, priority)
    # A body inside another of its priority is also inside all bodies that enclose that one, and so inside more.
    order = sorted(bodies, key=lambda i: (priority[i], len(holders[i])))
    parts = {i: parts[i] for i in reversed(order)}
    _refuse_crowds(parts, names, touching_mm(list(meshes.values())))
    _refuse_covered_faces(scene, targets, bodies)
    _refuse_camera_inside(parts, names, front)
    boxes = {i: _box(own) for i, own in parts.items()}
    for number, light in enumerate(scene.lights):
        near = {i: parts[i] for i, box in boxes.items() if _reaches(box, light.region)}
        if near:
            _refuse_lamp_inside(near, names, number, light)
    ranks[order] = np.arange(1, len(bodies) + 1)
    return ranks


def _priority(scene: Scene, number: int) -> int:
    refractor = scene.targets[number].refractor
    return 0 if refractor is None else refractor.priority


def _refuse_cuts(meshes: dict[int, Mesh], names: dict[int, str], priority: dict[int, int]) -> None:
    """Refuse surfaces that cut themselves or another surface of the same priority."""
    mesh = joined(meshes.values())
    owner = np.repeat(list(meshes), [len(m.faces) for m in meshes.values()])
    sizes = {i: float(np.ptp(m.vertices, axis=0).max()) for i, m in meshes.items()}
    size = np.array([sizes[i] for i in owner])
    found = cut(mesh, owner, size, priority)
    if found is None:
        return
    one, other, (x, y, z) = found
    where = f"near ({x:.4g}, {y:.4g}, {z:.4g}) mm"
    if one == other:
        raise SceneError(
            f"{names[one]}: its surface cuts itself {where}; the surface of a glass body must not: join its parts into "
            "one body (a Boolean union) and export it again"
        )
    raise SceneError(
        f"{names[one]} and {names[other]}: these glass bodies cut each other {where}, and both have priority = "
        f"{priority[one]}; give the one that is to fill what they share the higher one, or move one"
    )


def cut(
    mesh: Mesh, owner: Index, size: Array, priority: dict[int, int] | None = None
) -> tuple[int, int, tuple[float, float, float]] | None:
    """Return two owners of facets that cut each other, and the place; None if there are none.

    Where two closed surfaces cut each other, an edge of one passes through a facet of the other. Embree finds facets
    that an edge may meet, and float64 decides.

    Parameters
    ----------
    mesh : Mesh
        Adjacent facets of one owner must share their vertices.
    owner : (m,) int64
        Owner of each facet.
    size : (m,) float64, mm
        Size of the owner of each facet.
    priority : dict of int, optional
        Priority of owners; two of different priority may cut each other.
    """
    middle = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
    vertices = mesh.vertices - middle
    pairs = np.sort(np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]]), axis=1)
    edges, first = np.unique(pairs, axis=0, return_index=True)
    facet_of_edge = first % len(mesh.faces)
    normals, _ = facet_normals(mesh)
    start, end = vertices[edges[:, 0]], vertices[edges[:, 1]]
    length = np.linalg.norm(end - start, axis=1)
    way = (end - start) / length[:, None]
    grain = FLOAT32_GRAIN * float(np.abs(vertices).sum(axis=1).max())
    finder = Finder(Mesh(vertices, mesh.faces))
    going, reach = np.arange(len(edges)), np.full(len(edges), grain)
    of_facet = np.array([(priority or {}).get(int(i), 0) for i in owner])
    for turn in range(MOST_ROUNDS):
        if not len(going):
            break
        origin = start[going] + reach[going, None] * way[going]
        facet = finder.find(origin.astype(np.float32), way[going].astype(np.float32))
        going, facet = going[facet >= 0], facet[facet >= 0].astype(np.int64)
        a, b, c = np.moveaxis(vertices[mesh.faces[facet]], 1, 0)
        before = np.einsum("ij,ij->i", normals[facet], start[going] - a)
        after = np.einsum("ij,ij->i", normals[facet], end[going] - a)
        share = np.divide(before, before - after, out=np.ones(len(going)), where=before != after)
        place = start[going] + share[:, None] * (end - start)[going]
        deep = CUT * np.minimum(size[facet], size[facet_of_edge[going]])
        passes = (before * after < 0.0) & (np.minimum(np.abs(before), np.abs(after)) > deep)
        passes &= ~(mesh.faces[facet][:, :, None] == edges[going][:, None, :]).any(axis=(1, 2))
        own = facet_of_edge[going]
        passes &= of_facet[facet] == of_facet[own]
        for p, q in ((a, b), (b, c), (c, a)):
            # Inside the facet by as much, so that contact along an edge does not count.
            inward = np.cross(normals[facet], q - p)
            passes &= np.einsum("ij,ij->i", place - p, inward) > deep * np.linalg.norm(q - p, axis=1)
        if passes.any():
            i = int(np.flatnonzero(passes)[0])
            x, y, z = place[i] + middle
            return int(owner[facet_of_edge[going[i]]]), int(owner[facet[i]]), (float(x), float(y), float(z))
        reach[going] = np.maximum(reach[going], share * length[going]) + grain * 2.0 ** min(turn, 20)
        going = going[reach[going] < length[going]]
    return None


Shells = dict[int, list[Array]]
"""Corners (m, 3, 3) of the facets of every shell, by the number of the target."""


def _beside(corners: Array, distance: float) -> Array:
    """Return (m, 3) points behind the centres of facets, at a distance in inscribed radii; negative: in front."""
    edges = np.roll(corners, -1, axis=1) - corners
    cross = np.cross(edges[:, 0], edges[:, 1])
    around = np.linalg.norm(edges, axis=2).sum(axis=1)
    return np.asarray(corners.mean(axis=1) - distance * cross / around[:, None])


def _largest(shell: Array) -> Array:
    """Return the corners (1, 3, 3) of a shell's largest facet: where shells do not meet, one tells of all."""
    area = np.linalg.norm(np.cross(shell[:, 1] - shell[:, 0], shell[:, 2] - shell[:, 0]), axis=1)
    return shell[area.argmax()][None]


def _turns(parts: Sequence[Array], points: Array) -> Index:
    """Return the winding number of all shells of a body about points, (n,)."""
    return np.sum([winding(corners, points) for corners in parts], axis=0, dtype=np.int64)


def _refuse_wrong_shells(parts: Shells, names: dict[int, str]) -> None:
    """Refuse a body with a shell that does not have glass behind it and air in front of it.

    Shells that do not meet are wholly within or outside each other, so that one facet of each decides.
    """
    for i, own in parts.items():
        _refuse_shells_that_meet(own, names[i])
        for shell in own:
            facet = _largest(shell)
            if _turns(own, _beside(facet, JUST_BESIDE))[0] != 1 or _turns(own, _beside(facet, -JUST_BESIDE))[0] != 0:
                x, y, z = facet[0].mean(axis=0)
                raise SceneError(
                    f"{names[i]}: there is not glass behind its surface and air before it near "
                    f"({x:.4g}, {y:.4g}, {z:.4g}) mm; its {len(own)} closed surfaces must not cut each other, outer "
                    "ones must face outwards, those of hollows into them"
                )


def _refuse_shells_that_meet(own: Sequence[Array], name: str) -> None:
    """Refuse a body with a closed surface a part of which lies in another one, or on it, and a part does not.

    The edges of two surfaces that cut each other may all pass through edges, where `cut` takes them to touch.
    """
    outward = [_outward(shell) for shell in own]
    for k, shell in enumerate(outward):
        low, high = _box([shell])
        near_by = [j for j in range(len(own)) if j != k and _boxes_overlap((low, high), _box([outward[j]]))]
        if not near_by:
            continue
        others = [outward[j] for j in near_by]
        near = CUT * min(float((high - low).max()), *(float(np.ptp(other, axis=(0, 1)).max()) for other in others))
        inside, places = parts_in_shells(shell, others, near)
        met = [("cut", places[int(inside.sum(axis=1).argmax())])] if len(inside) > 1 else []
        met += [("lie on", place) for j in near_by if j > k for place in _common_places(shell, outward[j])]
        if met:
            words, (x, y, z) = met[0]
            raise SceneError(
                f"{name}: its closed surfaces {words} each other near ({x:.4g}, {y:.4g}, {z:.4g}) mm; join its parts "
                "into one body (a Boolean union) and export it again"
            )


def _outward(shell: Array) -> Array:
    """Return a shell that faces outwards, that of a hollow turned over: its signed volume tells."""
    a, b, c = np.moveaxis(shell - shell.mean(axis=(0, 1)), 1, 0)
    return shell if (a * np.cross(b, c)).sum() > 0.0 else shell[:, ::-1]


def _common_places(one: Array, other: Array) -> list[Array]:
    """Return a place where facets of two shells lie on each other, too closely for rays to tell which comes first."""
    middle = one.mean(axis=(0, 1))
    first, second = (
        Mesh((shell - middle).reshape(-1, 3), np.arange(3 * len(shell)).reshape(-1, 3)) for shell in (one, other)
    )
    place = common_area(first, second, _too_close_mm(first, second))
    return [] if place is None else [middle + place]


def _too_close_mm(one: Mesh, other: Mesh) -> float:
    """Return the distance up to which rays in float32 cannot tell apart which of two faces comes first."""
    both = np.concatenate([one.vertices, other.vertices])
    return AS_CLOSE * FLOAT32_GRAIN * float(np.abs(both).sum(axis=1).max() + np.ptp(both, axis=0).max())


def _boxes_overlap(one: tuple[Array, Array], other: tuple[Array, Array]) -> bool:
    return bool(((one[0] <= other[1]) & (one[1] >= other[0])).all())


def _holders(parts: Shells, names: dict[int, str], priority: dict[int, int]) -> dict[int, set[int]]:
    """Return the bodies of the same priority that enclose each body; refuse bodies that overlap otherwise."""
    holders: dict[int, set[int]] = {i: set() for i in parts}
    for i in parts:
        for j in parts:
            if i < j and priority[i] == priority[j]:
                first, second = _share_inside(parts[i], parts[j]), _share_inside(parts[j], parts[i])
                if first == second == NOTHING:
                    continue
                if (first == WHOLE) == (second == WHOLE):
                    raise SceneError(
                        f"{names[i]} and {names[j]}: these glass bodies overlap, neither inside the other, and both "
                        f"have priority = {priority[i]}; give the one that is to fill what they share the higher one"
                    )
                inner, outer = (i, j) if first == WHOLE else (j, i)
                holders[inner].add(outer)
    return holders


def _refuse_crowds(parts: Shells, names: dict[int, str], near: float) -> None:
    """Refuse a body a part of whose surface lies in more bodies at once than packets can keep.

    Where most bodies are at once, there is a part of the surface of one of them.
    """
    corners = {i: np.concatenate(own) for i, own in parts.items()}
    boxes = {i: _box(own) for i, own in parts.items()}
    for i, own in corners.items():
        low, high = boxes[i]
        others = [corners[j] for j, its in boxes.items() if j != i and (its[0] <= high).all() and (its[1] >= low).all()]
        if len(others) < MOST_AT_ONCE:
            continue
        inside, places = parts_in_shells(own, others, near)
        counts = inside.sum(axis=1)
        most = int(counts.max(initial=0))
        if most >= MOST_AT_ONCE:
            x, y, z = places[int(counts.argmax())]
            raise SceneError(
                f"{names[i]} lies inside {most} other glass bodies near ({x:.4g}, {y:.4g}, {z:.4g}) mm; it can lie in "
                f"{MOST_AT_ONCE - 1}"
            )


def _refuse_covered_faces(scene: Scene, targets: list[TargetMesh], bodies: list[int]) -> None:
    """Refuse a target that lies on a face of glass so closely that rays cannot tell which comes first.

    A ray that leaves the glass looks for what is next from a little behind the face, and would miss the target.
    """
    corners = np.concatenate([target.mesh.vertices for target in targets])
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    for i in bodies:
        for j in range(len(targets)):
            if j in bodies:
                continue
            near = _too_close_mm(*(Mesh(targets[k].mesh.vertices - middle, targets[k].mesh.faces) for k in (i, j)))
            place = common_area(targets[i].mesh, targets[j].mesh, near)
            if place is not None:
                x, y, z = place
                raise SceneError(
                    f"{named_target(scene, j)} lies on the glass of {named_target(scene, i)} near "
                    f"({x:.4g}, {y:.4g}, {z:.4g}) mm, too closely for rays to tell which comes first: leave "
                    f"{plain(2.0 * near, 1)} mm or more between them, or let it reach as far into the glass"
                )


def closed_gaps(scene: Scene, targets: list[TargetMesh]) -> list[str]:
    """Describe the gaps between flat faces of glass that are taken to be closed, a line a pair of bodies.

    Faces that files meant to touch differ by the rounding of float32; they are not named.

    Parameters
    ----------
    scene : Scene
    targets : list of TargetMesh
        Of the scene, in order.
    """
    bodies = [i for i, target in enumerate(scene.targets) if target.refractor is not None]
    if len(bodies) < 2:
        return []
    near = touching_mm([targets[i].mesh for i in bodies])
    lines = []
    for place, i in enumerate(bodies):
        for j in bodies[place + 1 :]:
            gap = widest_contact_mm(targets[i].mesh, targets[j].mesh, near)
            size = max(float(np.ptp(targets[k].mesh.vertices, axis=0).max()) for k in (i, j))
            if gap is not None and gap > AS_CLOSE * FLOAT32_GRAIN * size:
                lines.append(
                    f"{named_target(scene, i)} and {named_target(scene, j)}: faces {plain(gap, 2)} mm apart are taken "
                    f"to touch, without air between them, as all that are nearer than {plain(near, 2)} mm "
                    f"({CUT:g} of the smaller body's size); leave more between them if there is air"
                )
    return lines


def cut_bodies(scene: Scene, targets: list[TargetMesh]) -> list[str]:
    """Describe the pairs of glass bodies that cut each other where facets stand for curved surfaces, a line a pair.

    Parameters
    ----------
    scene : Scene
    targets : list of TargetMesh
        Of the scene, in order.
    """
    bodies = {i: target.refractor for i, target in enumerate(scene.targets) if target.refractor is not None}
    lines = []
    for i, one in bodies.items():
        for j, other in bodies.items():
            # Of the same priority they are refused.
            if j <= i or one.priority == other.priority or one.level == other.level == "flat":
                continue
            if not boxes_meet(targets[i].mesh, targets[j].mesh, 0.0):
                continue
            if _cut_each_other(targets[i].mesh, targets[j].mesh):
                lines.append(
                    f"{named_target(scene, i)} and {named_target(scene, j)} cut each other, and their facets stand for "
                    "curved surfaces. Rays that pass the cut as near as facets stand off these may be lost, or take "
                    "one body for the other. Finer meshes have less of it"
                )
    return lines


def _cut_each_other(one: Mesh, other: Mesh) -> bool:
    """Tell whether the surfaces of two bodies, neither of which cuts itself, cut each other."""
    # Edges of equal bodies may meet exactly in each other's edges, which `cut` takes for contact.
    own, shell = (each.vertices[each.faces] for each in (one, other))
    return len(parts_in_shells(own, [shell], touching_mm([one, other]))[0]) > 1


def _box(shells: Sequence[Array]) -> tuple[Array, Array]:
    """Return the lowest and the highest coordinates of a body's shells, (3,) each."""
    low, high = np.transpose([(corners.min(axis=(0, 1)), corners.max(axis=(0, 1))) for corners in shells], (1, 0, 2))
    return low.min(axis=0), high.max(axis=0)


NOTHING, PART, WHOLE = 0, 1, 2


def _share_inside(own: Sequence[Array], others: Sequence[Array]) -> int:
    """Return how much of a body lies in the glass of another; `WHOLE` as soon as one of its closed surfaces does."""
    low, high = _box(others)
    glass, share = np.concatenate(others), NOTHING
    for shell in own:
        size = float(np.ptp(shell, axis=(0, 1)).max())
        near = CUT * min(float((high - low).max()), size)
        if not _boxes_overlap(_box([shell]), (low - near, high + near)):
            continue
        inside = parts_in_shells(shell, [glass], near)[0][:, 0]
        if not len(inside):
            # All of it lies on the other's surface: on the same side everywhere.
            inside = _turns(others, set_back(_largest(shell), near).mean(axis=1)) != 0
        if inside.all():
            return WHOLE
        share = PART if inside.any() else share
    return share


def _refuse_camera_inside(parts: Shells, names: dict[int, str], front: Array) -> None:
    """Refuse glass that encloses the camera's first surface."""
    body = _holding(parts, front)
    if body is not None:
        raise SceneError(
            f"{names[body]}: the camera's first surface stands inside this glass; the camera must stand in air: "
            "move the body away, or give it a hollow round the camera, a surface that faces inwards"
        )


def _reaches(box: tuple[Array, Array], region: Region | None) -> bool:
    """Tell whether a lamp may reach into a box, given by its lowest and highest coordinates."""
    if region is None:
        return False
    (low, high), middle, size = box, region.centre_mm, region.size_mm
    return bool((middle + size >= low).all() and (middle - size <= high).all())


def _refuse_lamp_inside(parts: Shells, names: dict[int, str], number: int, light: Light) -> None:
    """Refuse a lamp in glass, with its middle or with any part of it: then a surface of the glass passes through it."""
    region = light.region
    if region is None:
        return
    body = _holding(parts, region.centre_mm[None])
    if body is None and region.size_mm > 0.0:
        body = next((i for i, own in parts.items() if _meets(own, region)), None)
    if body is not None:
        raise SceneError(
            f"lights[{number}].{light.place_in_words} lies inside {names[body]}; a lamp must stand in air: move it, or "
            "give the body a hollow round it, a surface that faces inwards"
        )


def _meets(own: Sequence[Array], region: Region) -> bool:
    """Tell whether a lamp with a size, whose middle is outside a body, reaches into its glass, deeper than contact."""
    low, high = _box(own)
    if (np.abs(0.5 * (low + high) - region.centre_mm) > 0.5 * (high - low) + region.size_mm).any():
        return False
    facets = np.concatenate(own)
    deep = CUT * min(float((high - low).max()), region.size_mm)
    ends = region.corners_mm
    if len(ends) == 2:
        # Whether the line is in glass changes only where it meets the surface.
        shares, inside = crossings(facets, *ends)
        places = np.unique([0.0, *shares[inside], 1.0])
        middles = 0.5 * (places[1:] + places[:-1])[np.diff(places) * region.size_mm > deep]
        return bool((_turns(own, ends[0] + middles[:, None] * (ends[1] - ends[0])) != 0).any())
    # Facets that pass through the plane of the lamp, and the segments in which they do.
    normal = np.cross(*region.half_mm)
    height = (facets - region.centre_mm) @ (normal / np.linalg.norm(normal))
    passes = (height.min(axis=1) < -deep) & (height.max(axis=1) > deep)
    facets, height = facets[passes], height[passes]
    # The corner that is alone on its side comes first: both edges from there meet the plane.
    above = height > 0.0
    alone = np.argmax(above == (above.sum(axis=1) == 1)[:, None], axis=1)
    order = (alone[:, None] + np.arange(3)) % 3
    facets, height = (np.take_along_axis(each, index, axis=1) for each, index in (
        (facets, order[:, :, None]), (height, order)
    ))  # fmt: skip
    start, end = (
        facets[:, 0] + (height[:, 0] / (height[:, 0] - height[:, k]))[:, None] * (facets[:, k] - facets[:, 0])
        for k in (1, 2)
    )
    return bool(region.holds(start, end, np.full(len(facets), deep)).any())


def _holding(parts: Shells, points: Array) -> int | None:
    """Return the body that any of the points lies in; of several the one that comes first, by rank from the highest."""
    return next((i for i, own in parts.items() if (_turns(own, points) != 0).any()), None)
