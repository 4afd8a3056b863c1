"""Proof of the order of the surfaces of lens and array: a sample of packets, also traced through meshes.

The meshes are the model. Finding surfaces by their order and their roots (`regions.lens.shade_lens`,
`regions.mla.shade_cells`) is a shortcut. So every run processes a sample of packets at lens and array in both ways, and
compares the places and weights of children and ends. If the shortcut deviates, the run uses the meshes.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.transport.engine import Workspace
from lfmesh.transport.packets.packet import (
    BACK_CELLS,
    BACK_CELLS_MESH,
    BACK_FRAME,
    BY_MESH,
    BY_ORDER_OR_MESH,
    CAMERA_FRAME,
    CELLS,
    CELLS_MESH,
    LENS,
    LENS_MESH,
    MLA_FRAME,
    OBJECTS,
    PLATE,
    SENSOR,
    STATIONS,
    Options,
)
from lfmesh.transport.paths.automaton import COUNTS, OFF_IMAGE_PATH, STANDING
from lfmesh.transport.tables.tables import Tables
from lfmesh.transport.world import World

STARTS = 2048
"""Packets that a run starts to take its sample from."""

SAMPLE = 1000
"""Most packets to compare."""

LARGEST_MM = 1e-9
"""Deviation in place, mm, above which a run does not use the order."""

_ARRAY_SPACES, _LARGEST_ROW = 4, 1 << 15
"""Strict upper bounds of the number of the array's spaces, and of the cells in a row."""

_MOST_ORDERS = 1 << 10
"""Strict upper bound of the number of diffraction orders of a phase."""

_OUTCOME = np.dtype([("source", "i8"), ("name", "i8"), ("position", "f8", (3,)), ("weight", "f8")])
"""A child or an end: its parent packet, and a number that identifies it."""


@dataclass(frozen=True)
class OrderCheck:
    """Comparison of packets traced by the order of the surfaces and through the meshes.

    Attributes
    ----------
    compared : int
        Packets that the order decided.
    reflected : int
        Compared packets that a reflection had turned off the image path.
    undecided : int
        Further packets of the sample that the order left to the meshes.
    differing : int
        Packets that met another surface, or ended differently.
    deviation_mm : float
        Largest distance between the places of two outcomes.
    deviation : float
        Largest difference between two outcomes' weights, over their parent's weight.
    """

    compared: int
    reflected: int
    undecided: int
    differing: int
    deviation_mm: float
    deviation: float

    @property
    def holds(self) -> bool:
        """True if the order may replace the meshes; False if there was nothing to compare."""
        return self.compared > 0 and self.differing == 0 and self.deviation_mm <= LARGEST_MM

    def joined(self, other: "OrderCheck | None") -> "OrderCheck":
        """Return both comparisons as one."""
        if other is None:
            return self
        return OrderCheck(
            compared=self.compared + other.compared,
            reflected=self.reflected + other.reflected,
            undecided=self.undecided + other.undecided,
            differing=self.differing + other.differing,
            deviation_mm=max(self.deviation_mm, other.deviation_mm),
            deviation=max(self.deviation, other.deviation),
        )

    @property
    def words(self) -> str:
        """The comparison and its result, in words."""
        said = f"{self.differing or 'none'} of {self.compared:,} test paths met another surface"
        return f"{said} (largest difference {self.deviation_mm:.1e} mm, {self.deviation:.1e} of a weight)"


def compare(world: World, options: Options, tables: Tables, packets: NDArray[np.void]) -> OrderCheck:
    """Process packets waiting at lens and array by the order of the surfaces and by meshes; compare the outcomes.

    Packets in gradient-index glass are left out: both ways follow the same curves there, which proves nothing.

    Parameters
    ----------
    world : World
    options : Options
    tables : Tables
    packets : (n,) PACKET
        Wait for a surface of the lens (camera frame) or in a cell (frames of the array's faces).
    """
    packets = packets[~_in_gradients(tables, packets)]
    found = outcomes(world, options, tables, packets)
    before = packets["weight"][found.by_order["source"]]
    turned = STANDING[OFF_IMAGE_PATH, np.delete(packets["path"], found.undecided)] == COUNTS
    return OrderCheck(
        compared=len(packets) - len(found.undecided),
        reflected=int(turned.sum()),
        undecided=len(found.undecided),
        differing=len(found.differing),
        deviation_mm=float(found.deviation_mm.max(initial=0.0)),
        deviation=float((np.abs(found.by_order["weight"] - found.by_mesh["weight"]) / before).max(initial=0.0)),
    )


def _in_gradients(tables: Tables, packets: NDArray[np.void]) -> NDArray[np.bool_]:
    """Return a mask of packets in gradient-index glass of the lens, whose faces no mesh finds."""
    if tables.lens.gradients is None:
        return np.zeros(len(packets), np.bool_)
    in_lens = packets["frame"] == CAMERA_FRAME
    return np.asarray(in_lens & (tables.lens.gradients.number[np.where(in_lens, packets["space"], 0)] >= 0))


class Outcomes(NamedTuple):
    """Children and ends of packets in both ways, without packets that the order left undecided."""

    by_order: NDArray[np.void]  # (m,) with the fields `source`, the packet; `position`, mm, its own frame; and `weight`
    by_mesh: NDArray[np.void]  # (m,) the same children and ends by the meshes
    only_by_order: NDArray[np.void]  # outcomes without a counterpart by the meshes
    only_by_mesh: NDArray[np.void]
    undecided: NDArray[np.int64]  # packets that the order left to the meshes

    @property
    def differing(self) -> NDArray[np.int64]:
        """Packets that met another surface, or ended differently."""
        return np.unique(np.concatenate([self.only_by_order["source"], self.only_by_mesh["source"]]))

    @property
    def deviation_mm(self) -> NDArray[np.float64]:
        """Distance between the places of each pair, (m,)."""
        return np.linalg.norm(self.by_order["position"] - self.by_mesh["position"], axis=1)


def outcomes(world: World, options: Options, tables: Tables, packets: NDArray[np.void]) -> Outcomes:
    """Process packets that wait at lens and array by the order of the surfaces and by meshes.

    Parameters
    ----------
    world, options, tables, packets
        As for `compare`.
    """
    options = options._replace(tracing=True, record=False)
    given = packets.copy()
    given["source"] = np.arange(len(given))
    in_order, meshes = options._replace(faces=BY_ORDER_OR_MESH), options._replace(faces=BY_MESH)
    by_order, undecided = _outcomes(Workspace(world, in_order, len(given), tables), given)
    by_mesh, _ = _outcomes(Workspace(world, meshes, len(given), tables), given)
    by_order, by_mesh = (found[~np.isin(found["source"], undecided)] for found in (by_order, by_mesh))
    _, a, b = np.intersect1d(by_order["name"], by_mesh["name"], assume_unique=True, return_indices=True)
    return Outcomes(by_order[a], by_mesh[b], np.delete(by_order, a), np.delete(by_mesh, b), undecided)


def _outcomes(work: Workspace, packets: NDArray[np.void]) -> tuple[NDArray[np.void], NDArray[np.int64]]:
    """Let packets meet one surface each; return the outcomes, and the sources of packets left to the meshes."""
    frames = packets["frame"]
    in_cells, in_back = frames == MLA_FRAME, frames == BACK_FRAME
    found, undecided = [], []
    for station, by_mesh, given in (
        (LENS, LENS_MESH, packets[~in_cells & ~in_back]),
        (CELLS, CELLS_MESH, packets[in_cells]),
        (BACK_CELLS, BACK_CELLS_MESH, packets[in_back]),
    ):
        work.begin(packets=len(given))
        work.stacks.queue(station, given)
        if len(given) > 0:
            # What is queued here again has met its surface, or a side of its cell.
            work.advance(station)
        undecided.append(work.stacks.waiting(by_mesh)["source"].copy())
        while work.tops[by_mesh] > 0:
            work.advance(by_mesh)
        found += [_taken(work, each) for each in (LENS, CELLS, BACK_CELLS, PLATE, OBJECTS, SENSOR)]
        ended = work.ends()
        rows = np.zeros(len(ended), _OUTCOME)
        rows["position"], rows["weight"] = ended["position"], ended["weight"]
        rows["name"], rows["source"] = -1 - ended["body"], ended["source"]
        found.append(rows)
    outcomes = np.concatenate(found)
    names = outcomes["name"] * len(packets) + outcomes["source"]
    # Children of one packet that go on alike are orders of a phase, which are queued by their numbers.
    outcomes["name"] = names * _MOST_ORDERS + _ranks(names)
    return outcomes, np.concatenate(undecided)


def _ranks(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return for each value how many equal ones stand before it, (n,)."""
    order = np.argsort(values, kind="stable")
    _, counts = np.unique(values, return_counts=True)
    ranks = np.empty(len(values), np.int64)
    ranks[order] = np.arange(len(values)) - np.repeat(np.cumsum(counts) - counts, counts)
    return ranks


def _taken(work: Workspace, station: int) -> NDArray[np.void]:
    """Take the packets off a station's stack, as outcomes."""
    children = work.stacks.waiting(station)
    rows = np.zeros(len(children), _OUTCOME)
    rows["position"] = np.stack([children[axis] for axis in "xyz"], axis=-1)
    # The space tells the refracted from the reflected child, and in the array the cell tells where a packet goes on.
    place = children["space"].astype(np.int64)
    if station in (CELLS, BACK_CELLS):
        place += _ARRAY_SPACES * (children["column"] + _LARGEST_ROW * children["row"].astype(np.int64))
    rows["name"] = station + STATIONS * place
    rows["source"], rows["weight"] = children["source"], children["weight"]
    work.tops[station] = 0
    return rows
