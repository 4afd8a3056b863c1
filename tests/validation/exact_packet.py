"""One packet in a space of the lens, traced with 40 digits: which surface it meets, where, and what its children are.

It shares nothing with the engines but the surfaces' records, which are the prescription. It judges packets on which the
two engines differ by more than they should: by how much each is off, and by how much the truth itself moves when the
packet is changed by the last digit of each of its numbers.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import mpmath as mp
import numpy as np
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.geometry.surfaces.sag import sag

DIGITS, STEPS = 40, 400_000
HALVINGS = 130

APART_MM = 1e-3
"""Places farther apart are not the same."""

FIELDS = ("x", "y", "z", "dx", "dy", "dz")

Vector = list[mp.mpf]


@dataclass(frozen=True)
class Outcome:
    """A place at which a child of the packet starts or ends, mm, camera frame, and its share of the weight."""

    place: Vector
    share: mp.mpf


def line_of(packet: NDArray[np.void], changed: str = "") -> tuple[Vector, Vector]:
    """Return start and direction of a packet, one of its numbers changed by its last digit."""
    given = {name: float(packet[name]) for name in FIELDS}
    if changed:
        given[changed] = float(np.nextafter(given[changed], np.inf))
    p, d = ([mp.mpf(given[name]) for name in names] for names in (FIELDS[:3], FIELDS[3:]))
    return p, d


def moved(frame: NDArray[np.float64], v: Vector, *, point: bool) -> Vector:
    """Return a vector in another frame (3, 4), as a point or as a direction."""
    return [mp.fdot([mp.mpf(float(m)) for m in row[:3]], v) + (mp.mpf(float(row[3])) if point else 0) for row in frame]


def along(p: Vector, d: Vector, t: mp.mpf) -> Vector:
    return [a + t * b for a, b in zip(p, d, strict=True)]


def height_above(surface: Any, p: Vector) -> mp.mpf:
    """Return how far a point lies above a conic with even terms, along z."""
    r2, c = p[0] ** 2 + p[1] ** 2, mp.mpf(float(surface["curvature"]))
    z = c * r2 / (1 + mp.sqrt(1 - (1 + mp.mpf(float(surface["conic"]))) * c * c * r2))
    z += mp.fsum(mp.mpf(float(a)) * r2 ** (n + 2) for n, a in enumerate(surface["asphere"][: surface["terms"]]))
    return p[2] - mp.mpf(float(surface["vertex_z"])) - z


def normal_at(surface: Any, p: Vector) -> Vector:
    """Return the unit normal of a conic with even terms at a point of it."""
    r2, c = p[0] ** 2 + p[1] ** 2, mp.mpf(float(surface["curvature"]))
    rate = c / mp.sqrt(1 - (1 + mp.mpf(float(surface["conic"]))) * c * c * r2)
    terms = enumerate(surface["asphere"][: surface["terms"]])
    rate += mp.fsum((2 * n + 4) * mp.mpf(float(a)) * r2 ** (n + 1) for n, a in terms)
    n = [-rate * p[0], -rate * p[1], mp.mpf(1)]
    length = mp.sqrt(mp.fdot(n, n))
    return [a / length for a in n]


def root_between(f: Callable[[mp.mpf], mp.mpf], low: mp.mpf, high: mp.mpf) -> mp.mpf:
    """Return where a function that changes its sign is zero, by bisection."""
    sign = mp.sign(f(low))
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if mp.sign(f(middle)) == sign else (low, middle)
    return (low + high) / 2


def within(surface: Any, p: Vector, d: Vector) -> tuple[mp.mpf, mp.mpf] | None:
    """Return between which distances a line is inside the cylinder of a surface's clear aperture."""
    a, b = d[0] ** 2 + d[1] ** 2, p[0] * d[0] + p[1] * d[1]
    c = p[0] ** 2 + p[1] ** 2 - mp.mpf(float(surface["semi_diameter"])) ** 2
    if a == 0:
        return (mp.mpf(0), mp.mpf(10) ** 6) if c <= 0 else None
    root = b * b - a * c
    return None if root < 0 else ((-b - mp.sqrt(root)) / a, (-b + mp.sqrt(root)) / a)


def crossings(surface: Any, p: Vector, d: Vector, leaves: bool) -> Iterator[mp.mpf]:
    """Yield the distances ahead at which a line (in the surface's own frame) crosses a surface within its aperture.

    Crossings closer than a 400,000th of the way through the aperture are found where the line is nearest to the
    surface between two steps.

    Parameters
    ----------
    leaves : bool
        The packet starts on this surface.
    """
    ends = within(surface, p, d)
    if ends is None or ends[1] <= 0:
        return
    start = max(ends[0], mp.mpf(0))
    t = np.linspace(float(start), float(ends[1]), STEPS)
    x, y, z = (float(a) + t * float(b) for a, b in zip(p, d, strict=True))
    f = z - surface["vertex_z"] - sag(surface, np.hypot(x, y))
    near = 1e-9 * (1.0 + float(mp.norm(p)))

    def height(at: mp.mpf) -> mp.mpf:
        return height_above(surface, along(p, d, at))

    for i in np.flatnonzero(np.sign(f[1:]) != np.sign(f[:-1])):
        root = root_between(height, mp.mpf(t[i]), mp.mpf(t[i + 1]))
        if root > (near if leaves else 0):
            yield root
    for i in 1 + np.flatnonzero((np.abs(f[1:-1]) < np.abs(f[:-2])) & (np.abs(f[1:-1]) < np.abs(f[2:]))):
        if np.sign(f[i - 1]) == np.sign(f[i]) == np.sign(f[i + 1]):
            turn = mp.findroot(lambda at: mp.diff(height, at), mp.mpf(t[i]))
            if height(turn) * mp.mpf(f[i]) < 0:
                for other in (t[i - 1], t[i + 1]):
                    yield root_between(height, turn, mp.mpf(other))


def first_hit(world: lf.World, packet: NDArray[np.void], changed: str = "") -> tuple[int, mp.mpf] | None:
    """Return the surface that a packet meets first, and at which distance; None: neither of its space."""
    lens, space = world.tables.lens, int(packet["space"])
    p, d = line_of(packet, changed)
    hits = []
    for k in (space - 1, space):
        if 0 <= k < len(lens.surfaces):
            surface = lens.surfaces[k]
            q, e = moved(surface["unpose"], p, point=True), moved(surface["unpose"], d, point=False)
            for t in crossings(surface, q, e, leaves=int(packet["last"]) == k):
                # Out of a space the surface towards the sensor is crossed along its normal, the other against it.
                along_normal = mp.fdot(normal_at(surface, along(q, e, t)), e) > 0
                hits += [(t, k)] if along_normal == (k == space) else []
    if not hits:
        return None
    t, k = min(hits)
    return k, t


def outcomes(world: lf.World, packet: NDArray[np.void], k: int, guess: mp.mpf, changed: str = "") -> list[Outcome]:
    """Return what comes of a packet at its surface: for each child the hit, and where it meets the stop's plane.

    Parameters
    ----------
    k : int
        The surface.
    guess : mpf
        Distance of the hit, about.
    """
    lens, colour, space = world.tables.lens, int(packet["colour"]), int(packet["space"])
    surface = lens.surfaces[k]
    p, d = line_of(packet, changed)
    q, e = moved(surface["unpose"], p, point=True), moved(surface["unpose"], d, point=False)
    t = mp.findroot(lambda at: height_above(surface, along(q, e, at)), guess)
    hit = along(q, e, t)
    n = normal_at(surface, hit)
    cosine = mp.fdot(n, e)
    if cosine < 0:
        n, cosine = [-a for a in n], -cosine
    beyond = k + 1 if space == k else k
    before, after = (mp.mpf(float(lens.media.indices[lens.medium[s], colour])) for s in (space, beyond))
    length = mp.sqrt(mp.fdot(e, e))
    cosine, ratio = cosine / length, before / after
    inside = 1 - ratio**2 * (1 - cosine**2)
    children = [([a / length - 2 * cosine * b for a, b in zip(e, n, strict=True)], mp.mpf(1))]
    if inside > 0:
        other = mp.sqrt(inside)
        s = (before * cosine - after * other) / (before * cosine + after * other)
        parallel = (after * cosine - before * other) / (after * cosine + before * other)
        share = (s * s + parallel * parallel) / 2
        bent = [ratio * a / length + (other - ratio * cosine) * b for a, b in zip(e, n, strict=True)]
        children = [(children[0][0], share), (bent, 1 - share)]
    found = []
    for direction, share in children:
        place, to = moved(surface["pose"], hit, point=True), moved(surface["pose"], direction, point=False)
        found.append(Outcome(place, share))
        place, to = moved(lens.stop_unpose, place, point=True), moved(lens.stop_unpose, to, point=False)
        if to[2] != 0:
            at = along(place, to, (mp.mpf(float(lens.stop_z)) - place[2]) / to[2])
            found.append(Outcome(moved(lens.stop_pose, at, point=True), share))
    return found


def distance(a: Any, b: Any) -> float:
    """Return the distance of two points, mm."""
    return float(mp.norm([mp.mpf(x) - mp.mpf(y) for x, y in zip(list(a), list(b), strict=True)]))


@dataclass(frozen=True)
class Judgement:
    """How far an engine's outcome is off the exact one, and how far the exact one moves with the last digits."""

    off_mm: float
    off_share: float
    moves_mm: float
    moves_share: float


def judge(world: lf.World, packet: NDArray[np.void], place: NDArray[np.float64], share: float) -> Judgement:
    """Compare an outcome of a packet, at a place in the camera frame with a share of its weight, with the exact one."""
    with mp.workdps(DIGITS):
        hit = first_hit(world, packet)
        assert hit is not None, "the packet meets neither of its surfaces"
        exact = outcomes(world, packet, *hit)
        # Both children start at the hit, and differ by their shares.
        order = [(distance(one.place, place) // APART_MM, abs(one.share - share)) for one in exact]
        nearest = order.index(min(order))
        truth = exact[nearest]
        moves_mm = moves_share = 0.0
        for name in FIELDS:
            other = outcomes(world, packet, *hit, changed=name)[nearest]
            moves_mm += distance(other.place, truth.place)
            moves_share += float(abs(other.share - truth.share))
        return Judgement(distance(truth.place, place), float(abs(truth.share - share)), moves_mm, moves_share)
