"""Refuse bodies of glass in object space that rays cannot be traced through.

A packet tracks the bodies of glass around it by the surfaces that it crosses. Therefore no surface may cut itself, the
shells of a body must be nested and oriented correctly, and camera and lamps must stand in air. In an overlap, the body
of higher priority counts or, at equal priority, the one inside the other.
"""

from collections.abc import Container, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.geometry.meshes.crossings import parts_in_shells, set_back
from lfmesh.geometry.meshes.mesh import Array, Mesh, boxes_meet, facet_normals, joined
from lfmesh.geometry.meshes.winding import shells, winding
from lfmesh.geometry.objects.round_body import RoundBody
from lfmesh.geometry.objects.round_pairs import Pair, common_place, pair_of
from lfmesh.geometry.objects.targets import TargetMesh, named_target
from lfmesh.scene import Scene, Sphere
from lfmesh.scene.literals import plain
from lfmesh.transport.close_faces import refuse_close_faces
from lfmesh.transport.events.bodies import MOST_AT_ONCE, MOST_BODIES
from lfmesh.transport.events.facets import FLOAT32_GRAIN
from lfmesh.transport.refused_lamps import refuse_camera_and_lamps_inside
from lfmesh.transport.regions.embree import Finder
from lfmesh.transport.tables.contacts import CUT, common_area, touching_mm, widest_contact_mm

Index = NDArray[np.int64]

MOST_ROUNDS = 64
"""Largest number of queries along an edge; it passes its own facets and all that it touches."""

JUST_BESIDE = 1e-6
"""Distance of test points in front of or behind a facet's centre, relative to the radius of its inscribed circle."""

AS_CLOSE = 2.0
"""Distance within which a face of glass and another target lie on each other, in roundings of float32."""


def refuse_untraceable_glass(scene: Scene, targets: list[TargetMesh], front: Array) -> Index:
    """Refuse glass that cuts itself, encloses camera or light, or overlaps without a rule; return the ranks.

    Parameters
    ----------
    scene : Scene
    targets : list of TargetMesh
        All targets of the scene, in order.
    front : (n, 3) float64, mm
        Points of the camera's first surface, world frame.

    Returns
    -------
    (targets,) int64
        Rank of each body of glass, from 1; the highest rank counts in an overlap. 0: not a body of glass.

    Raises
    ------
    SceneError
        Names the bodies and the place.
    """
    bodies = [i for i, target in enumerate(scene.targets) if target.refractor is not None]
    ranks = np.zeros(len(targets), np.int64)
    if not bodies:
        return ranks
    if len(bodies) > MOST_BODIES:
        raise SceneError(f"{len(bodies)} targets are glass bodies; the limit is {MOST_BODIES}")
    priority = {i: _priority(scene, i) for i in bodies}
    names = {i: named_target(scene, i) for i in bodies}
    meshes = {i: targets[i].mesh for i in bodies}
    rounds = {i: body for i in bodies if (body := targets[i].round) is not None}
    _refuse_cuts(meshes, names, priority, rounds)
    parts = {i: [meshes[i].vertices[meshes[i].faces[facets]] for facets in shells(meshes[i])] for i in bodies}
    _refuse_wrong_shells({i: own for i, own in parts.items() if i not in rounds}, names)
    refuse_close_faces(scene, targets, bodies)
    holders = _holders(parts, names, priority, rounds)
    # A body inside another of its priority is also inside all that enclose the other, and so inside more.
    order = sorted(bodies, key=lambda i: (priority[i], len(holders[i])))
    _refuse_crowds(parts, names, touching_mm(list(meshes.values())))
    _refuse_covered_faces(scene, targets, bodies)
    refuse_camera_and_lamps_inside(scene, {i: targets[i] for i in reversed(order)}, front)
    ranks[order] = np.arange(1, len(bodies) + 1)
    return ranks


def _priority(scene: Scene, number: int) -> int:
    refractor = scene.targets[number].refractor
    return 0 if refractor is None else refractor.priority


def _refuse_cuts(
    meshes: dict[int, Mesh], names: dict[int, str], priority: dict[int, int], rounds: dict[int, RoundBody]
) -> None:
    """Refuse surfaces that cut themselves or another surface of the same priority."""
    for i, j in combinations(rounds, 2):
        if priority[i] == priority[j] and _pair(rounds[i], rounds[j]) is Pair.CUT:
            place = 0.5 * (rounds[i].place[:, 3] + rounds[j].place[:, 3])
            raise _cut(names, priority, (i, j, tuple(place.tolist())))
    if len(rounds) == len(meshes):
        return
    mesh = joined(meshes.values())
    owner = np.repeat(list(meshes), [len(m.faces) for m in meshes.values()])
    sizes = {i: float(np.ptp(m.vertices, axis=0).max()) for i, m in meshes.items()}
    size = np.array([sizes[i] for i in owner])
    found = cut(mesh, owner, size, priority, rounds)
    if found is not None:
        raise _cut(names, priority, found)


def _pair(one: RoundBody, other: RoundBody) -> Pair:
    """Return the relative position of two round bodies; a slight overlap counts as contact."""
    boxes = one.box_mm(), other.box_mm()
    near = CUT * min(float(np.ptp(box, axis=0).max()) for box in boxes)
    meet = (boxes[0][0] <= boxes[1][1]).all() and (boxes[0][1] >= boxes[1][0]).all()
    return pair_of(one, other, near) if meet else Pair.APART


def _cut(
    names: dict[int, str], priority: dict[int, int], found: tuple[int, int, tuple[float, float, float]]
) -> SceneError:
    """Return the error for bodies of one priority, or one body alone, that cut at a place."""
    one, other, (x, y, z) = found
    where = f"near ({x:.4g}, {y:.4g}, {z:.4g}) mm"
    if one == other:
        return SceneError(
            f"{names[one]}: its surface cuts itself {where}; the surface of a glass body must not: join its parts into "
            "one body (a Boolean union) and export it again"
        )
    return SceneError(
        f"{names[one]} and {names[other]}: these glass bodies cut each other {where}, and both have priority = "
        f"{priority[one]}; give a higher one to the body that fills the overlap, or move one"
    )


def cut(
    mesh: Mesh, owner: Index, size: Array, priority: dict[int, int] | None = None, rounds: Container[int] = ()
) -> tuple[int, int, tuple[float, float, float]] | None:
    """Return the owners of two facets that cut each other, and the place; None if there are none.

    If closed surfaces cut each other, an edge of one passes through a facet of the other. Embree finds the facets near
    an edge, and float64 decides.

    Parameters
    ----------
    mesh : Mesh
        Adjacent facets of one owner must share their vertices.
    owner : (m,) int64
        Owner of each facet.
    size : (m,) float64, mm
        Size of the owner of each facet.
    priority : dict of int, optional
        Priority of owners; owners of different priority may cut each other.
    rounds : container of int, optional
        Owners that are round bodies, which are not compared with each other.
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
    is_round = np.array([int(i) in rounds for i in owner])
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
        passes &= (of_facet[facet] == of_facet[own]) & ~(is_round[facet] & is_round[own])
        for p, q in ((a, b), (b, c), (c, a)):
            # At least as deep inside the facet, so that contact along an edge does not count.
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
    """Return points (m, 3) behind the centres of facets, at a distance in inscribed radii; negative: in front."""
    edges = np.roll(corners, -1, axis=1) - corners
    cross = np.cross(edges[:, 0], edges[:, 1])
    around = np.linalg.norm(edges, axis=2).sum(axis=1)
    return np.asarray(corners.mean(axis=1) - distance * cross / around[:, None])


def _largest(shell: Array) -> Array:
    """Return the corners (1, 3, 3) of a shell's largest facet, which represents the shell if shells do not meet."""
    area = np.linalg.norm(np.cross(shell[:, 1] - shell[:, 0], shell[:, 2] - shell[:, 0]), axis=1)
    return shell[area.argmax()][None]


def _turns(parts: Sequence[Array], points: Array) -> Index:
    """Return the winding number (n,) of all shells of a body about points."""
    return np.sum([winding(corners, points) for corners in parts], axis=0, dtype=np.int64)


def _refuse_wrong_shells(parts: Shells, names: dict[int, str]) -> None:
    """Refuse a body with a shell that does not have glass behind it and air in front of it.

    Shells that do not meet are wholly inside or outside each other, so one facet of each decides.
    """
    for i, own in parts.items():
        _refuse_shells_that_meet(own, names[i])
        for shell in own:
            facet = _largest(shell)
            if _turns(own, _beside(facet, JUST_BESIDE))[0] != 1 or _turns(own, _beside(facet, -JUST_BESIDE))[0] != 0:
                x, y, z = facet[0].mean(axis=0)
                raise SceneError(
                    f"{names[i]}: its surface does not have glass behind it and air in front of it near "
                    f"({x:.4g}, {y:.4g}, {z:.4g}) mm; its {len(own)} closed surfaces must not cut each other, outer "
                    "ones must face outwards, and surfaces of hollows into the hollow"
                )


def _refuse_shells_that_meet(own: Sequence[Array], name: str) -> None:
    """Refuse a body with a closed surface that lies partly in or on another one.

    The cut of two surfaces may run through edges only, which `cut` takes for contact.
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
    """Return a shell that faces outwards, flipped if its signed volume is negative."""
    a, b, c = np.moveaxis(shell - shell.mean(axis=(0, 1)), 1, 0)
    return shell if (a * np.cross(b, c)).sum() > 0.0 else shell[:, ::-1]


def _common_places(one: Array, other: Array) -> list[Array]:
    """Return a place, if any, where facets of two shells lie too close for rays to tell which comes first."""
    middle = one.mean(axis=(0, 1))
    first, second = (
        Mesh((shell - middle).reshape(-1, 3), np.arange(3 * len(shell)).reshape(-1, 3)) for shell in (one, other)
    )
    place = common_area(first, second, _too_close_mm(first, second))
    return [] if place is None else [middle + place]


def _too_close_mm(one: Mesh, other: Mesh) -> float:
    """Return the distance within which rays in float32 cannot order two faces."""
    both = np.concatenate([one.vertices, other.vertices])
    return AS_CLOSE * FLOAT32_GRAIN * float(np.abs(both).sum(axis=1).max() + np.ptp(both, axis=0).max())


def _boxes_overlap(one: tuple[Array, Array], other: tuple[Array, Array]) -> bool:
    return bool(((one[0] <= other[1]) & (one[1] >= other[0])).all())


def _holders(
    parts: Shells, names: dict[int, str], priority: dict[int, int], rounds: dict[int, RoundBody]
) -> dict[int, set[int]]:
    """Return the bodies of equal priority that enclose each body; refuse any other overlap."""
    holders: dict[int, set[int]] = {i: set() for i in parts}
    for i in parts:
        for j in parts:
            if i < j and priority[i] == priority[j]:
                if i in rounds and j in rounds:
                    first, second = SHARES[_pair(rounds[i], rounds[j])]
                else:
                    first, second = _share_inside(parts[i], parts[j]), _share_inside(parts[j], parts[i])
                if first == second == NOTHING:
                    continue
                if (first == WHOLE) == (second == WHOLE):
                    raise SceneError(
                        f"{names[i]} and {names[j]}: these glass bodies overlap, neither inside the other, and both "
                        f"have priority = {priority[i]}; give a higher one to the body that fills the overlap"
                    )
                inner, outer = (i, j) if first == WHOLE else (j, i)
                holders[inner].add(outer)
    return holders


def _refuse_crowds(parts: Shells, names: dict[int, str], near: float) -> None:
    """Refuse a body if part of its surface lies in more bodies at once than packets can keep.

    The place in the most bodies always touches the surface of one of them.
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
                f"{names[i]} lies inside {most} other glass bodies near ({x:.4g}, {y:.4g}, {z:.4g}) mm; the limit is "
                f"{MOST_AT_ONCE - 1}"
            )


def _refuse_covered_faces(scene: Scene, targets: list[TargetMesh], bodies: list[int]) -> None:
    """Refuse a target so close to a face of glass that rays cannot tell which comes first.

    A ray that leaves the glass searches on from slightly behind the face, and would miss the target. Pairs of glass
    bodies are refused only if one is round: coincident facets are crossed as one.
    """
    boxes = np.array([target.box_mm for target in targets])
    middle = 0.5 * (boxes[:, 0].min(axis=0) + boxes[:, 1].max(axis=0))
    slack = CUT * (boxes[:, 1] - boxes[:, 0]).max(axis=1)
    for i in bodies:
        for j in range(len(targets)):
            one, other = targets[i].round, targets[j].round
            if j in bodies and (i >= j or (one is None and other is None)):
                continue
            # Meshes of round shapes take time to make.
            gap = np.maximum(boxes[i, 0] - boxes[j, 1], boxes[j, 0] - boxes[i, 1])
            if gap.max() > slack[i] + slack[j]:
                continue
            near = _too_close_mm(*(Mesh(targets[k].mesh.vertices - middle, targets[k].mesh.faces) for k in (i, j)))
            place, has_facets = None, True
            if one is not None and other is not None:
                place = common_place(one, other, near)
                # Flat ends are compared by their facets; a sphere has none.
                has_facets = not (isinstance(one.shape, Sphere) or isinstance(other.shape, Sphere))
            if place is None and has_facets:
                place = common_area(targets[i].mesh, targets[j].mesh, near)
            if place is not None:
                x, y, z = place
                raise SceneError(
                    f"{named_target(scene, j)} lies on the glass of {named_target(scene, i)} near "
                    f"({x:.4g}, {y:.4g}, {z:.4g}) mm, too close for rays to find the first surface: leave "
                    f"{plain(2.0 * near, 1)} mm or more between them, or let it reach as far into the glass"
                    + (", with another priority" if j in bodies else "")
                )


def closed_gaps(scene: Scene, targets: list[TargetMesh]) -> list[str]:
    """Describe, in a line per pair of bodies, the gaps between flat faces of glass that are treated as closed.

    Round bodies have none. Faces that touch up to the rounding of float32 in their files are not listed.
    """
    bodies = [i for i, target in enumerate(scene.targets) if target.refractor is not None and targets[i].round is None]
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
                    f"{named_target(scene, i)} and {named_target(scene, j)}: faces {plain(gap, 2)} mm apart are "
                    f"taken to touch, without air between them. If there is air, leave more than {plain(near, 2)} mm "
                    f"({CUT:g} of the smaller body's size)"
                )
    return lines


def cut_bodies(scene: Scene, targets: list[TargetMesh]) -> list[str]:
    """Describe, in a line per pair, the glass bodies that cut each other with facets that represent curved surfaces."""
    bodies = {i: target.refractor for i, target in enumerate(scene.targets) if target.refractor is not None}
    lines = []
    for i, one in bodies.items():
        for j, other in bodies.items():
            # Bodies of the same priority are refused elsewhere.
            if j <= i or one.priority == other.priority or one.level == other.level == "flat":
                continue
            if not boxes_meet(targets[i].mesh, targets[j].mesh, 0.0):
                continue
            if _cut_each_other(targets[i].mesh, targets[j].mesh):
                lines.append(
                    f"{named_target(scene, i)} and {named_target(scene, j)} cut each other, and their facets "
                    "approximate curved surfaces. Rays that pass close to the cut may be lost, or take one body for "
                    "the other. Use finer meshes"
                )
    return lines


def _cut_each_other(one: Mesh, other: Mesh) -> bool:
    """Tell whether the surfaces of two bodies cut each other; neither may cut itself."""
    # Edges of equal bodies may meet exactly at each other's edges, which `cut` takes for contact.
    own, shell = (each.vertices[each.faces] for each in (one, other))
    return len(parts_in_shells(own, [shell], touching_mm([one, other]))[0]) > 1


def _box(shells: Sequence[Array]) -> tuple[Array, Array]:
    """Return the lowest and the highest corner of a body's shells, (3,) each."""
    low, high = np.transpose([(corners.min(axis=(0, 1)), corners.max(axis=(0, 1))) for corners in shells], (1, 0, 2))
    return low.min(axis=0), high.max(axis=0)


NOTHING, PART, WHOLE = 0, 1, 2

SHARES = {
    Pair.APART: (NOTHING, NOTHING),
    Pair.FIRST_INSIDE: (WHOLE, PART),
    Pair.SECOND_INSIDE: (PART, WHOLE),
    Pair.CUT: (PART, PART),
}
"""Share of each of two round bodies that lies inside the other."""


def _share_inside(own: Sequence[Array], others: Sequence[Array]) -> int:
    """Return the share of a body in the glass of another: `WHOLE` as soon as one of its closed surfaces is inside."""
    low, high = _box(others)
    glass, share = np.concatenate(others), NOTHING
    for shell in own:
        size = float(np.ptp(shell, axis=(0, 1)).max())
        near = CUT * min(float((high - low).max()), size)
        if not _boxes_overlap(_box([shell]), (low - near, high + near)):
            continue
        inside = parts_in_shells(shell, [glass], near)[0][:, 0]
        if not len(inside):
            # The shell coincides with the other's surface and lies on one side of it everywhere.
            inside = _turns(others, set_back(_largest(shell), near).mean(axis=1)) != 0
        if inside.all():
            return WHOLE
        share = PART if inside.any() else share
    return share
