"""Repair of facets that a CAD kernel makes of faces with a pole, such as surfaces of revolution.

At the intersection of a generating curve with its axis, OpenCASCADE may reverse the normal of the pole. It may also
join three points of one meridian into a facet that stands on edge in the surface.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.mesh import Array, Mesh, facet_normals
from lfmesh.geometry.meshes.vertex_normals import edge_partners

ON_EDGE = 0.5
"""Cosine of the angle between a facet's normal and its corner normals below which the facet stands on edge."""

NARROW = 0.02
"""Largest ratio of height to length of a facet that counts as three points of one line."""

SAME_FACE = 0.01
"""Largest difference between the normals of two facets at a corner for them to belong to one face."""

MOST_ROUNDS = 8
"""Most passes over facets on edge with neighbours on edge."""


def mended(mesh: Mesh) -> Mesh:
    """Return a closed mesh with the normals of its poles corrected and facets on edge laid flat.

    Parameters
    ----------
    mesh : Mesh
        Welded. Without corner normals it is returned unchanged.
    """
    if mesh.corner_normals is None:
        return mesh
    for _ in range(MOST_ROUNDS):
        laid = _laid_flat(mesh.vertices, mesh.faces, mesh.corner_normals)
        if laid is None:
            break
        mesh = Mesh(mesh.vertices, *laid)
    assert mesh.corner_normals is not None
    return Mesh(mesh.vertices, mesh.faces, _with_poles_turned(mesh, mesh.corner_normals))


def _laid_flat(
    vertices: Array, faces: NDArray[np.int64], normals: Array
) -> tuple[NDArray[np.int64], Array] | None:  # fmt: skip
    """Return facets and corner normals with facets on edge laid flat; None if there are none.

    The middle corner of such a facet lies on its longest edge. The facet beyond that edge is divided at this corner
    instead.
    """
    own, area2 = facet_normals(Mesh(vertices, faces, None))
    corner = vertices[faces]
    # Edge e runs from corner e to the next one.
    length = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2)
    longest = length.argmax(axis=1)
    upright = (np.abs((normals * own[:, None]).sum(axis=2)) < ON_EDGE).sum(axis=1) >= 2
    on_edge = upright & (area2 < NARROW * length.max(axis=1) ** 2)
    if not on_edge.any():
        return None
    first, second = edge_partners(faces)
    partner = np.full(3 * len(faces), -1, dtype=np.int64)
    partner[first], partner[second] = second, first
    faces, normals = faces.copy(), normals.copy()
    touched = np.zeros(len(faces), dtype=bool)
    for facet in np.flatnonzero(on_edge).tolist():
        beyond, edge = divmod(int(partner[3 * facet + longest[facet]]), 3)
        if partner[3 * facet + longest[facet]] < 0 or touched[facet] or touched[beyond] or on_edge[beyond]:
            continue
        start = int(longest[facet])
        end, middle = (start + 1) % 3, (start + 2) % 3
        back_at_start, far = (edge + 1) % 3, (edge + 2) % 3
        at_start = np.linalg.norm(normals[facet, start] - normals[beyond, back_at_start])
        at_end = np.linalg.norm(normals[facet, end] - normals[beyond, edge])
        if max(at_start, at_end) > SAME_FACE:
            continue
        touched[[facet, beyond]] = True
        # From (start, end, middle) and (end, start, far) to (start, far, middle) and (end, middle, far).
        quad = [(facet, start), (beyond, far), (facet, middle), (facet, end)]
        number = np.stack([faces[at] for at in quad])
        normal = np.stack([normals[at] for at in quad])
        faces[facet], normals[facet] = number[[0, 1, 2]], normal[[0, 1, 2]]
        faces[beyond], normals[beyond] = number[[3, 2, 1]], normal[[3, 2, 1]]
    return (faces, normals) if touched.any() else None


def _with_poles_turned(mesh: Mesh, normals: Array) -> Array:
    """Return corner normals, replaced at vertices where they point to the back of all facets around."""
    own, area2 = facet_normals(mesh)
    behind = (normals * own[:, None]).sum(axis=2) <= 0.0
    everywhere = np.ones(len(mesh.vertices), dtype=bool)
    everywhere[mesh.faces[~behind]] = False
    corners = everywhere[mesh.faces]
    if not corners.any():
        return normals
    total = np.zeros((len(mesh.vertices), 3))
    np.add.at(total, mesh.faces, np.broadcast_to((area2[:, None] * own)[:, None], normals.shape))
    length = np.linalg.norm(total, axis=1, keepdims=True)
    mean = total / np.where(length > 0.0, length, 1.0)
    return np.where(corners[..., None], mean[mesh.faces], normals)
