"""Aim at the lens through glass, fitted to probe rays, and its proof by further probes.

The points where probes would be scattered divide object space into cells. In each cell, the directions of probes that
came the same way form a bundle: a centre that moves linearly with the point, and an ellipse around it that holds them.
Cells are as small as the number of probes allows, and are joined again where that loses little.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.kernels.decorators import kernel
from lfmesh.optics.scattering import tangents
from lfmesh.scene.literals import percent
from lfmesh.transport.aims.kept import Kept, digest_of
from lfmesh.transport.aims.mixture import aimed_density
from lfmesh.transport.aims.pupil import opening_from
from lfmesh.transport.aims.through_glass import BUNDLE, CELL, GlassAim, cell_at
from lfmesh.transport.render.glass_probes import ON_ROUGH_GLASS, Sights, probe
from lfmesh.transport.tables.tables import OPAQUE, AimTables, LensAim
from lfmesh.transport.world import World

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

PROBES, MOST_PROBES = 1 << 16, 1 << 17
"""Number of probe rays for the first fit of the aim, and largest number."""

FEWEST = 24
"""Least number of sights of a way to fit a bundle; with fewer, the bundle of a larger cell is used."""

FEWEST_IN_CELL = 2 * FEWEST
"""Least number of sights in each half of a divided cell."""

LOSS = 1.15
"""Largest factor by which joining two cells may increase the mean weight of packets."""

IDLE = 3
"""Number of successive divisions without a lower weight that ends the division of a cell."""

MARGIN = 1.1
"""Size of a bundle over the ellipse that holds the directions of its probes."""

AROUND, EVERY = 0.15, 3
"""Share of a cell's rays for the bundles of enclosing cells, the largest and every third: they hold directions that the
few probes in the cell itself did not show."""

STRAIGHT = 0.05
"""Least share of a cell's rays aimed as if there were no glass."""

FEW = 1e-3
"""Share of light that may be hardly aimed at without more probes."""

TOO_MUCH = 0.02
"""Share of hardly aimed light that the forward method refuses."""

HARDLY = 100.0
"""Relative weight of packets above which their light counts as hardly aimed at."""

KEPT = "aim through glass"
"""Name under which a world keeps the aim and its proof."""

FLATTEST = 1e-6
"""Extent of a cell in one direction, relative to others, below which it counts as 0; relative floor on the variance of
a bundle's slopes."""

STEEPEST = 0.2
"""Least cosine between the directions of a bundle and their mean."""


class Bundle(NamedTuple):
    """Directions of light that reaches the lens one way from a cell."""

    row: np.void  # BUNDLE
    size: float  # area of its ellipse, in slopes
    way: int = 0
    chance: float = 0.0  # share of light that goes its way
    share: float = 0.0  # share of the rays of a cell


_Known = dict[int, tuple[Bundle, int]]
"""Bundles of a cell by way, with the number of sights of each."""


@dataclass(frozen=True)
class Cell:
    """Part of object space.

    Attributes
    ----------
    axis : int
        Axis of its division; −1: not divided.
    border : float, mm
    halves : tuple of Cell
    bundles : tuple of Bundle
    straight : float
        Share of rays aimed as if there were no glass.
    count : int
        Number of sights.
    weight : float
        Mean weight of packets from there at the lens.
    """

    axis: int
    border: float
    halves: tuple["Cell", ...]
    bundles: tuple[Bundle, ...]
    straight: float
    count: int
    weight: float


@dataclass(frozen=True)
class GlassProof:
    """Measured quality of the aim for light through or off glass.

    Attributes
    ----------
    missed : float
        Share of the light that is hardly aimed at: its packets have more than a hundred times the weight of others. The
        largest share for targets, a medium or an entry of particles.
    probes : int
        Number of probe rays measured.
    """

    missed: float
    probes: int


_aims: Kept[tuple[GlassAim | None, GlassProof | None]] = Kept()

_OF_SAMPLES = dict.fromkeys(("method", "samples", "replicates", "seed", "threads", "target_error", "max_samples"))
"""Settings of a scene that do not affect the paths of light through glass."""

_STRAIGHT_ONLY = GlassAim(np.array([(-1, 0.0, 0, 0, 1.0, 0, 0)], CELL), np.zeros(0, BUNDLE), 0.0, 1.0)


def has_glass(world: World) -> bool:
    """Tell whether glass or liquid stands before the camera, or a medium that bends light."""
    objects = world.tables.objects
    return objects.fields is not None or bool((objects.medium != OPAQUE).any())


class Fit(NamedTuple):
    """Aim fitted to sights, with its bundles' data for the proof.

    Attributes
    ----------
    aim : GlassAim
    way : (m,) uint64
        Way of each bundle.
    chance : (m,) float64
        Share of light that goes its way.
    typical : (n,) float64
        One over the mean weight of packets from each cell.
    """

    aim: GlassAim
    way: NDArray[np.uint64]
    chance: Array
    typical: Array


def glass_aim(world: World) -> tuple[GlassAim | None, GlassProof | None]:
    """Return the aim through glass and its proof; None without light through glass.

    Parameters
    ----------
    world : World
        Keeps both.
    """
    if not has_glass(world):
        return None, None
    if KEPT not in world.kept:
        scene = world.scene.model_copy(update={"transport": world.scene.transport.model_copy(update=_OF_SAMPLES)})
        key = digest_of(scene.digest, world.aimed_tables, *world.particles)
        world.kept[KEPT] = _aims.of(key, lambda: _found(world))
    found: tuple[GlassAim | None, GlassProof | None] = world.kept[KEPT]
    return found


def _found(world: World) -> tuple[GlassAim | None, GlassProof | None]:
    """Return the result of `glass_aim`."""
    number = PROBES
    sights, others = probe(world, number, 0), probe(world, number, 1)
    if not (sights.way != 0).any():
        return None, None
    while True:
        fit = fitted(world, sights)
        proof = proof_of(fit, world.aim, others)
        known = len(others.way) > 0 and not FEW < proof.missed <= TOO_MUCH
        if known or number >= MOST_PROBES:
            return fit.aim, proof
        # The next fit includes the sights of this proof, and new ones prove it.
        sights, number = sights.joined(others), 2 * number
        others = probe(world, number, number)


def refuse_unaimed(world: World) -> None:
    """Refuse a forward render if too much light through glass is not aimed.

    Parameters
    ----------
    world : World

    Raises
    ------
    SceneError
        The forward method is asked for.
    """
    proof = glass_aim(world)[1]
    if proof is not None and proof.missed > TOO_MUCH and world.scene.transport.method == "forward":
        raise SceneError(
            f'transport.method = "forward" cannot aim {percent(proof.missed)} of the light at the lens, because it '
            'passes through glass or reflects off it on too many paths; use "adjoint"'
        )


def hardly_aimed(world: World) -> list[str]:
    """Return warnings of rarely found light that may make the picture darker than its error says.

    Parameters
    ----------
    world : World
        World of a render that has found the aim.
    """
    _, proof = world.kept.get(KEPT, (None, None))
    if proof is None or proof.missed <= FEW:
        return []
    forward = world.scene.transport.method == "forward"
    light = "the light" if forward else "the light traced forward (of lamps through glass, and of particles)"
    return [
        f"{percent(proof.missed)} of {light} reaches the lens through glass, or reflected by it, on paths at which "
        "few packets are aimed. The picture may be too dark by more than its error says, most of all at edges of "
        "glass" + ('. Use method = "adjoint"' if forward else "")
    ]


def fitted(world: World, sights: Sights) -> Fit:
    """Return the aim fitted to sights.

    Parameters
    ----------
    world : World
    sights : Sights
    """
    sights = sights.some(sights.place != ON_ROUGH_GLASS)
    ways, counts = np.unique(sights.way, return_counts=True)
    sights = sights.some(np.isin(sights.way, ways[counts >= FEWEST]))
    if not len(sights.way):
        return Fit(_STRAIGHT_ONLY, np.zeros(0, np.uint64), np.zeros(0), np.zeros(1))
    entrance, wide = world.aim.entrance.opening, world.aim.entrance.wide_radius
    middle = sights.point.mean(axis=0)
    radius = opening_from(entrance, (middle[0], middle[1], middle[2]))[2]
    radius = radius if radius > 0.0 else wide
    opening = np.pi * radius**2 / (entrance.plane_z - middle[2]) ** 2
    root = _Division(_chances(sights), float(opening)).cell(sights)
    cells, bundles = np.zeros(_number_of(root), CELL), list[Bundle]()
    typical = np.zeros(len(cells))
    _written(root, cells, 0, bundles, typical)
    rows = np.array([bundle.row for bundle in bundles], BUNDLE)
    rows["share"] = [bundle.share for bundle in bundles]
    aim = GlassAim(cells, rows, world.aim.entrance.wide_share, max(wide / radius, 1.0))
    way, chance = np.array([each.way for each in bundles], np.uint64), np.array([each.chance for each in bundles])
    return Fit(aim, way, chance, typical)


def _chances(sights: Sights) -> dict[int, float]:
    """Return each way's largest share of the light in any small part of object space.

    It is about 1 for a way refracted everywhere; for a reflection it is the reflectance.
    """
    ways, number = np.unique(sights.way, return_inverse=True)
    most = np.zeros(len(ways))
    pieces = [np.arange(len(number))]
    while pieces:
        piece = pieces.pop()
        if len(piece) >= 2 * FEWEST_IN_CELL:
            point = sights.point[piece]
            axis = int(np.argmax(np.ptp(point, axis=0)))
            order = np.argsort(point[:, axis], kind="stable")
            pieces += [piece[order[: len(order) // 2]], piece[order[len(order) // 2 :]]]
        else:
            most = np.maximum(most, np.bincount(number[piece], minlength=len(ways)) / len(piece))
    return dict(zip(ways.tolist(), most.tolist(), strict=True))


def _number_of(cell: Cell) -> int:
    return 1 + sum(map(_number_of, cell.halves))


def _written(cell: Cell, cells: NDArray[np.void], number: int, bundles: list[Bundle], typical: Array) -> int:
    """Write a cell, its parts and bundles, from a row on; return the next free row."""
    row = cells[number]
    row["axis"], row["border"], row["straight"] = cell.axis, cell.border, cell.straight
    row["first"], row["bundles"] = len(bundles), 0
    following = number + 1
    if cell.halves:
        row["below"] = following
        following = _written(cell.halves[0], cells, following, bundles, typical)
        row["above"] = following
        return _written(cell.halves[1], cells, following, bundles, typical)
    row["bundles"] = len(cell.bundles)
    bundles += cell.bundles
    typical[number] = 1.0 / cell.weight if cell.weight > 0.0 else 0.0
    return following


@dataclass(frozen=True)
class _Division:
    """Division of object space into cells.

    A ray drawn with probability p for a way, into a bundle of size s, carries a weight t s / p, where t is the share of
    light that follows the way. A way with the share f of the light adds f t s / p to the mean weight. The probabilities
    p ~ √(f t s) minimise it: (Σ √(f t s))².

    Attributes
    ----------
    chance : dict of float
        t of each way.
    opening : float
        Size of the lens's opening as seen without glass, in slopes.
    """

    chance: dict[int, float]
    opening: float

    def cell(self, sights: Sights, around: tuple[_Known, ...] = (), before: float = np.inf, idle: int = 0) -> Cell:
        """Return the cell of some sights, divided if that lowers the mean weight.

        Parameters
        ----------
        sights : Sights
        around : tuple of dict
            Bundles of the enclosing cells by way, the largest cell first.
        before : float
            Mean weight in the last of them.
        idle : int
            Number of divisions that have not lowered it.
        """
        known = _known(sights, around[-1] if around else {})
        straight = float((sights.way == 0).sum())
        weight = (math.sqrt(straight * self.opening) + sum(self._rate(known, way) for way in known)) ** 2
        weight /= len(sights.way)

        def whole() -> Cell:
            return Cell(-1, 0.0, (), *self._mixed(straight, known, around), len(sights.way), weight)

        idle = idle + 1 if LOSS * weight >= before else 0
        if len(sights.way) < 2 * FEWEST_IN_CELL or not known or idle > IDLE:
            return whole()
        axis = int(np.argmax(np.ptp(sights.point, axis=0)))
        border = float(np.median(sights.point[:, axis]))
        low = sights.point[:, axis] < border
        if min(low.sum(), (~low).sum()) < FEWEST_IN_CELL:
            return whole()
        halves = tuple(self.cell(sights.some(half), (*around, known), weight, idle) for half in (low, ~low))
        mean = sum(half.count * half.weight for half in halves) / len(sights.way)
        if weight <= LOSS * mean:
            return whole()
        return Cell(axis, border, halves, (), 1.0, len(sights.way), mean)

    def _rate(self, known: _Known, way: int) -> float:
        """Return √(f t s) of a way, where f is a number of sights."""
        bundle, count = known[way]
        return math.sqrt(count * self.chance[way] * bundle.size)

    def _mixed(self, straight: float, known: _Known, around: tuple[_Known, ...]) -> tuple[tuple[Bundle, ...], float]:
        """Return a cell's bundles with their shares of rays, and the share of the straight aim."""
        larger = list({id(each): each for each in (*around[:1], *around[-EVERY::-EVERY]) if each}.values())
        levels = [(1.0 - AROUND if larger else 1.0, known)] if known else []
        levels += [((AROUND if known else 1.0) / len(larger), each) for each in larger]
        if not levels:
            return (), 1.0
        rates = [{way: self._rate(level, way) for way in level} for _, level in levels]
        unbent = math.sqrt(straight * self.opening)
        unbent = max(STRAIGHT, unbent / (unbent + sum(rates[0].values()))) if known or not straight else 1.0 - AROUND
        found = []
        for (share, level), rate in zip(levels, rates, strict=True):
            whole = sum(rate.values())
            for way, (bundle, _) in level.items():
                own = (1.0 - unbent) * share * rate[way] / whole
                found.append(Bundle(bundle.row, bundle.size, way, self.chance[way], own))
        return tuple(found), unbent


def _known(sights: Sights, around: _Known) -> _Known:
    """Return a cell's bundles by way, with their numbers of sights."""
    found = {}
    for way, count in zip(*np.unique(sights.way[sights.way != 0], return_counts=True), strict=True):
        bundle = around[int(way)][0] if int(way) in around else None
        if count >= FEWEST:
            mine = sights.way == way
            bundle = _bundle(sights.point[mine], sights.direction[mine]) or bundle
        if bundle is not None:
            found[int(way)] = bundle, int(count)
    return found


def _bundle(point: Array, direction: Array) -> Bundle | None:
    """Return the bundle of directions from a cell; None if they differ too much, or not at all."""
    axis = direction.mean(axis=0)
    axis /= np.linalg.norm(axis)
    along = direction @ axis
    if along.min() < STEEPEST:
        return None
    sides = np.array(tangents(*axis)).reshape(2, 3)
    slopes = direction @ sides.T / along[:, None]
    middle = point.mean(axis=0)
    columns = np.column_stack([np.ones(len(point)), point - middle])
    change, *_ = np.linalg.lstsq(columns, slopes, rcond=FLATTEST)
    off = slopes - columns @ change
    spread = off.T @ off / len(point)
    if not np.trace(spread) > 0.0:
        return None
    spread += FLATTEST * np.trace(spread) * np.eye(2)
    root = np.linalg.cholesky(spread)
    reach = MARGIN * np.sqrt((np.linalg.solve(root, off.T) ** 2).sum(axis=0).max())
    row = np.zeros(1, BUNDLE)[0]
    row["point"], row["axes"] = middle, [*sides, axis]
    row["slope"], row["per_mm"] = change[0], change[1:].T
    row["stretch"], row["squeeze"] = reach * root, np.linalg.inv(reach * root)
    size = np.pi * abs(np.linalg.det(row["stretch"]))
    row["density"] = 1.0 / size
    return Bundle(row, size)


def proof_of(fit: Fit, tables: AimTables, sights: Sights) -> GlassProof:
    """Return the proof of an aim by other sights than fitted; without any, everything may be missed.

    Parameters
    ----------
    fit : Fit
    tables : AimTables
    sights : Sights
    """
    weight = np.zeros(len(sights.way))
    through = sights.way != 0
    aim = tables.entrance._replace(glass=fit.aim)
    _weigh(*fit, aim, sights.point, sights.direction, sights.way, weight)
    missed = through & ((weight > HARDLY) | (sights.place == ON_ROUGH_GLASS))
    shares = [float(missed[sights.place == place].mean()) for place in np.unique(sights.place)]
    return GlassProof(max(shares, default=1.0), len(sights.way))


@kernel
def _weigh(
    glass: GlassAim, ways: NDArray[np.uint64], chance: Array, typical: Array, aim: LensAim, point: Array,
    direction: Array, way: NDArray[np.uint64], weight: Array,
) -> None:  # fmt: skip
    """Write the weight of light from a point in a direction, relative to other packets there.

    Parameters
    ----------
    glass, ways, chance, typical
        As the attributes of `Fit`.
    aim : LensAim
    point, direction, way
        As for `Sights`.
    weight : (n,) float64
        Written: inf where no packet goes.
    """
    for i in range(len(point)):
        p = point[i, 0], point[i, 1], point[i, 2]
        number = cell_at(glass.cells, p)
        cell = glass.cells[number]
        light = 0.0
        for j in range(cell.first, cell.first + cell.bundles):
            if ways[j] == way[i]:
                light = chance[j]
                break
        if light == 0.0:
            weight[i] = np.inf
            continue
        density = aimed_density(aim, p, (direction[i, 0], direction[i, 1], direction[i, 2]))
        weight[i] = light * typical[number] / density if density > 0.0 else np.inf
