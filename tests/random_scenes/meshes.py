"""Targets, glass boxes and bounds of media as mesh files of flat facets, which can be divided and put in another order.

Files lie in a folder that is removed when the process ends.
"""

import copy
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from itertools import count
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from tests.random_scenes.draft import Tables

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ROUND = 12
"""Corners of a circle."""


class Facets(NamedTuple):
    """A mesh of flat facets.

    Attributes
    ----------
    vertices : (n, 3) float64, mm
    faces : (m, 3) int64
        Counter-clockwise as seen from outside.
    uv : (n, 2) float64 or None
        Texture coordinates.
    """

    vertices: Array
    faces: Index
    uv: Array | None = None


Change = Callable[[Facets], Facets]


def of_shape(shape: Tables) -> Facets:
    """Return a coarse mesh of a shape: texture coordinates on planes, few corners on round shapes.

    Parameters
    ----------
    shape : dict
        Table of a plane, disk, sphere, box or cylinder.
    """
    match shape["kind"]:
        case "plane":
            uv = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
            flat = (uv - 0.5) * [shape["width_mm"], shape["height_mm"]]
            return Facets(np.column_stack([flat, np.zeros(4)]), np.array([[0, 1, 2], [0, 2, 3]]), uv)
        case "disk":
            rim = _ring(shape["radius_mm"], 0.0)
            corners = np.arange(1, ROUND - 1)
            return Facets(rim, np.stack([np.zeros_like(corners), corners, corners + 1], axis=1))
        case "box":
            corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
            return hull(corners * shape["size_mm"])
        case "cylinder":
            half = 0.5 * shape["height_mm"]
            return hull(np.concatenate([_ring(shape["radius_mm"], z) for z in (-half, half)]))
    return hull(sphere_points(shape["radius_mm"]))


def sphere_points(radius_mm: float) -> Array:
    """Return points of a sphere in rings, with one ring in the plane z = 0, (n, 3), mm."""
    angles = np.deg2rad([-60.0, -30.0, 0.0, 30.0, 60.0])
    rings = [_ring(radius_mm * np.cos(a), radius_mm * np.sin(a)) for a in angles]
    return np.concatenate([*rings, [[0.0, 0.0, -radius_mm], [0.0, 0.0, radius_mm]]])


def _ring(radius_mm: float, z: float) -> Array:
    angles = 2.0 * np.pi * np.arange(ROUND) / ROUND
    return np.stack([radius_mm * np.cos(angles), radius_mm * np.sin(angles), np.full(ROUND, z)], axis=1)


def hull(points: Array) -> Facets:
    """Return the convex hull of points, with facets that face outwards."""
    found = ConvexHull(points)
    faces = found.simplices.astype(np.int64)
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inwards = np.einsum("ij,ij->i", normals, found.equations[:, :3]) < 0.0
    faces[inwards] = faces[inwards][:, ::-1]
    used, faces = np.unique(faces, return_inverse=True)
    return Facets(points[used], faces.reshape(-1, 3))


def folded(sheet: Facets, angle_deg: float) -> Facets:
    """Return a plane of two facets, the second one turned out of the plane about the edge between them."""
    vertices = sheet.vertices.copy()
    along = vertices[2] - vertices[0]
    along /= np.linalg.norm(along)
    arm = vertices[3] - vertices[0]
    foot = along * (arm @ along)
    across, angle = arm - foot, np.deg2rad(angle_deg)
    vertices[3] = vertices[0] + foot + np.cos(angle) * across + np.sin(angle) * np.cross(along, across)
    return sheet._replace(vertices=vertices)


def in_four(mesh: Facets) -> Facets:
    """Return a mesh with each of its facets divided at the middles of its edges."""
    attributes = {} if mesh.uv is None else {"uv": mesh.uv}
    vertices, faces, attributes = trimesh.remesh.subdivide(mesh.vertices, mesh.faces, vertex_attributes=attributes)
    return Facets(vertices, faces, attributes.get("uv"))


def one_divided(draw: np.random.Generator) -> Change:
    """Return a change that divides a single random facet into three, about a random point of it."""

    def change(mesh: Facets) -> Facets:
        number = int(draw.integers(len(mesh.faces)))
        a, b, c = mesh.faces[number]
        shares = 0.1 + 0.7 * draw.dirichlet([1.0, 1.0, 1.0])
        new = len(mesh.vertices)
        faces = np.concatenate([np.delete(mesh.faces, number, axis=0), [[a, b, new], [b, c, new], [c, a, new]]])
        uv = None if mesh.uv is None else np.vstack([mesh.uv, shares @ mesh.uv[[a, b, c]]])
        return Facets(np.vstack([mesh.vertices, shares @ mesh.vertices[[a, b, c]]]), faces, uv)

    return change


def in_another_order(draw: np.random.Generator) -> Change:
    """Return a change that permutes the facets and vertices of a mesh, and lets facets begin at another corner."""

    def change(mesh: Facets) -> Facets:
        order = draw.permutation(len(mesh.vertices))
        place = np.argsort(order)
        begins = draw.integers(3, size=(len(mesh.faces), 1))
        turned = np.take_along_axis(mesh.faces, (np.arange(3) + begins) % 3, axis=1)
        faces = place[turned[draw.permutation(len(turned))]]
        return Facets(mesh.vertices[order], faces, None if mesh.uv is None else mesh.uv[order])

    return change


def as_meshes(scene: Tables, draw: np.random.Generator, change: Change | None = None) -> Tables:
    """Return a scene with mesh files in place of shapes, glass boxes and bounds; half of all planes are folded.

    Parameters
    ----------
    scene : dict
        Tables of a scene.
    draw : Generator
        Of the folds; the same one must be given for scenes that are compared.
    change : callable, optional
        Of each mesh.
    """
    scene = copy.deepcopy(scene)
    for target in scene["targets"]:
        if (shape := target.pop("shape", None)) is not None:
            mesh = of_shape(shape)
            fold = draw.uniform(10.0, 60.0) if shape["kind"] == "plane" and draw.random() < 0.5 else 0.0
            # Only the material of the scene counts.
            target |= in_file(folded(mesh, fold) if fold else mesh, change) | {"materials": "ignore"}
        elif (shape := _taken(target.get("refractor", {}))) is not None:
            target["refractor"] |= in_file(of_shape(shape), change) | {"surface": "flat"}
    for medium in scene.get("media", []):
        if "bounds" in medium:
            medium["bounds"] = in_file(of_shape(medium["bounds"]), change)
    return scene


def _taken(refractor: Tables) -> Tables | None:
    """Take the primitive shape out of a body of glass; None if it has none."""
    size = refractor.pop("box_mm", None)
    return refractor.pop("shape", None) if size is None else {"kind": "box", "size_mm": size}


def in_file(mesh: Facets, change: Change | None = None) -> Tables:
    """Return the keys that give a target, glass or bounds the shape of a mesh."""
    return {"file": str(written(change(mesh) if change else mesh)), "units": "mm"}


def written(mesh: Facets) -> Path:
    """Write a mesh to an OBJ file, with every digit of its numbers, and return its path."""
    path = _folder() / f"mesh_{next(_numbers)}.obj"
    path.write_text("\n".join(_lines(mesh)) + "\n")
    return path


def _lines(mesh: Facets) -> Iterator[str]:
    yield from (f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist())
    if mesh.uv is not None:
        yield from (f"vt {u!r} {v!r}" for u, v in mesh.uv.tolist())
    for face in mesh.faces + 1:
        yield "f " + " ".join(f"{i}/{i}" if mesh.uv is not None else str(i) for i in face)


_numbers = count()
_kept: list[tempfile.TemporaryDirectory[str]] = []


@cache
def _folder() -> Path:
    _kept.append(tempfile.TemporaryDirectory())
    return Path(_kept[-1].name)
