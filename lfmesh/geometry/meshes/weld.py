"""Merging of coincident vertices, so that touching facets share their edges."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.mesh import Index, Mesh
from lfmesh.kernels.decorators import inlined, kernel

Bits = NDArray[np.uint64]

MULTIPLIERS = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9)
"""Odd numbers that spread the bits of coordinates (G. L. Steele, D. Lea and C. H. Flood, "Fast splittable pseudorandom
number generators", OOPSLA 2014)."""

_FIRST, _SECOND = MULTIPLIERS
_SHIFT = np.uint64(29)


def welded(mesh: Mesh) -> Mesh:
    """Return the mesh with equal vertices merged; the facets keep their order and their corner normals.

    Vertices must be equal in float64, so gaps stay open. They are ordered by first use, so that neighbours are close in
    memory; unused ones are dropped.
    """
    # Adding zero turns -0.0 into 0.0.
    vertices = np.ascontiguousarray(mesh.vertices + 0.0)
    most = min(mesh.faces.size, len(vertices))
    faces = np.empty(mesh.faces.shape, np.int64)
    places, number = np.empty(most, np.int64), np.full(len(vertices), -1)
    # Fill at most half of the table.
    table = np.full(1 << (2 * most).bit_length(), -1)
    count = _number(mesh.faces, vertices.view(np.uint64), number, table, places, faces)
    return Mesh(vertices[places[:count]], faces, mesh.corner_normals)


@kernel
def _number(given: Index, bits: Bits, number: Index, table: Index, places: Index, faces: Index) -> int:
    """Assign a number to each distinct position of the vertices that facets use, by a hash table; return their count.

    Parameters
    ----------
    given : (m, 3) int64
        Facets, by vertices.
    bits : (n, 3) uint64
        Bits of the vertices' coordinates.
    number : (n,) int64
        Output: position of each vertex; initially −1.
    table : (2^k,) int64
        Output: the hash table, of positions; initially −1.
    places : (n,) int64
        Output: first vertex at each position.
    faces : (m, 3) int64
        Output: facets, by positions.
    """
    count = 0
    for i in range(len(given)):
        for k in range(3):
            vertex = given[i, k]
            if number[vertex] < 0:
                slot = _slot(bits, vertex, len(table))
                while table[slot] >= 0 and not _is_equal(bits, vertex, places[table[slot]]):
                    slot = (slot + 1) & (len(table) - 1)
                if table[slot] < 0:
                    table[slot], places[count] = count, vertex
                    count += 1
                number[vertex] = table[slot]
            faces[i, k] = number[vertex]
    return count


@inlined
def _slot(bits: Bits, vertex: int, size: int) -> int:
    """Return the first slot to try for a vertex in a hash table with a power-of-two size."""
    hashed = bits[vertex, 0]
    for axis in range(1, 3):
        hashed = (hashed ^ (hashed >> _SHIFT)) * _FIRST + bits[vertex, axis]
    hashed = (hashed ^ (hashed >> _SHIFT)) * _SECOND
    hashed ^= hashed >> _SHIFT
    return int(np.int64(hashed & np.uint64(size - 1)))


@inlined
def _is_equal(bits: Bits, one: int, other: int) -> bool:
    """Tell whether two vertices coincide."""
    return bits[one, 0] == bits[other, 0] and bits[one, 1] == bits[other, 1] and bits[one, 2] == bits[other, 2]
