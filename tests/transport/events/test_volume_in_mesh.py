"""Media that closed meshes bound: chords against closed forms and against trimesh, at faces, edges and corners."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from lfmesh.errors import LfmeshError
from lfmesh.geometry.frame import rotation
from lfmesh.geometry.meshes.shell_tree import LEAF, next_crossing, tree_of
from lfmesh.geometry.ray import Ray
from lfmesh.transport.tables.volumes import Volumes
from tests.transport.events.test_volume import passage, slab, volumes_of

Array = NDArray[np.float64]
KAPPA = 0.02


def written(mesh: trimesh.Trimesh, folder: Path, name: str = "body.ply") -> dict[str, Any]:
    """Write a mesh with float64 coordinates, and return the bounds that it gives."""
    mesh.export(folder / name, encoding="ascii") if name.endswith(".ply") else mesh.export(folder / name)
    return {"file": name, "units": "mm"}


def depth(volumes: Volumes, p: Array, d: Array, reach: float = np.inf) -> float:
    return -float(np.log(passage(volumes, p, d, reach).transmittance))


def chord_of_planes(normals: Array, offsets: Array, p: Array, d: Array) -> float:
    """Return the length of a line inside a convex body, n · x ≤ c for all its planes."""
    speed, room = normals @ d, offsets - normals @ p
    along = np.abs(speed) < 1e-13
    if (room[along] < 0.0).any():
        return 0.0
    t = room[~along] / speed[~along]
    first, last = t[speed[~along] < 0.0].max(), t[speed[~along] > 0.0].min()
    return max(float(last - first), 0.0)


def test_chords_of_random_boxes_and_hulls_are_those_of_their_planes(tmp_path: Path) -> None:
    """Random convex bodies at random poses, lines through them, beside them and far from them, within 1e-11."""
    draw = np.random.default_rng(8)
    met = 0
    for number in range(6):
        points = draw.normal(size=(8 * 3**number, 3)) * draw.uniform(2.0, 8.0, 3)
        if number == 0:
            points = draw.uniform(1.0, 8.0, 3) * (2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1.0)
        if number == 1:
            points = trimesh.creation.icosphere(3, 6.0).vertices
        mesh = trimesh.convex.convex_hull(points)
        bounds = written(mesh, tmp_path)
        _, _, rows = (tmp_path / "body.ply").read_text().partition("end_header\n")
        planes = ConvexHull(np.loadtxt(rows.splitlines()[: len(mesh.vertices)])).equations
        turn, place = draw.uniform(-180.0, 180.0, 3), np.array([*draw.uniform(-9.0, 9.0, 2), -150.0])
        volumes = volumes_of(
            {"bounds": bounds, "position_mm": place.tolist(), "rotation_deg": turn.tolist(),
             "absorption_per_mm": KAPPA},
            folder=tmp_path,
        )  # fmt: skip
        back = rotation(turn)
        for _ in range(200):
            target = draw.uniform(-14.0, 14.0, 3)
            d = draw.normal(size=3)
            d /= np.linalg.norm(d)
            p = target - 10.0 ** draw.uniform(1.5, 4.0) * d
            expected = chord_of_planes(planes[:, :3], -planes[:, 3], target, d)
            found = depth(volumes, place + back @ p, back @ d)
            assert found == pytest.approx(KAPPA * expected, abs=1e-11), (number, expected)
            met += expected > 0.0
    assert 200 < met < 1000


def test_no_line_slips_through_an_edge_or_a_corner(tmp_path: Path) -> None:
    """Lines aimed to the last digit at edges, corners and diagonals of faces, along axes and aslant."""
    mesh = trimesh.creation.box((8.0, 6.0, 4.0))
    place = np.array([0.0, 0.0, -64.0])
    values = {"bounds": written(mesh, tmp_path), "position_mm": place.tolist(), "absorption_per_mm": KAPPA}
    volumes = volumes_of(values, folder=tmp_path)
    planes = np.vstack([np.eye(3), -np.eye(3)])
    offsets = np.array([4.0, 3.0, 2.0] * 2)
    corners = mesh.vertices
    aims = [*corners, *(0.5 * (corners[:, None] + corners)).reshape(-1, 3)]
    ways = [np.array([i, j, k], float) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1) if i or j or k]
    ways += [a - b for a in corners[:4] for b in corners[4:]]
    inner = 0
    for aim in aims:
        for way in ways:
            d = way / np.linalg.norm(way)
            # A line in a face or an edge, whose way in the body is not defined, may count or not.
            lies_in_face = any(
                abs(n @ d) < 1e-12 and abs(c - n @ aim) < 1e-12 for n, c in zip(planes, offsets, strict=True)
            )
            expected = chord_of_planes(planes, offsets, aim, d)
            found = depth(volumes, place + aim - 32.0 * way, d)
            if lies_in_face:
                assert -1e-12 < found < KAPPA * expected + 1e-12
            else:
                assert found == pytest.approx(KAPPA * expected, abs=1e-12), (aim, way)
                inner += expected > 0.0
    assert inner > 500


def test_shells_with_hollows_parts_and_grids_are_crossed_as_trimesh_says(tmp_path: Path) -> None:
    """A hollow ball beside a torus, seen at random, and the same with a grid that ends within it."""
    hollow = trimesh.creation.icosphere(2, 4.0)
    hollow.invert()
    torus = trimesh.creation.torus(6.0, 1.5)
    torus.apply_translation([0.0, 14.0, 0.0])
    mesh = trimesh.util.concatenate([trimesh.creation.icosphere(3, 7.0), hollow, torus])
    bounds = written(mesh, tmp_path)
    read = trimesh.load(tmp_path / "body.ply", process=False)
    np.savez(tmp_path / "grid.npz", absorption_per_mm=np.full((3, 4, 5), KAPPA), spacing_mm=[3.0, 5.0, 2.0])
    box = np.array([4.5, 10.0, 5.0])
    place = [0.0, 0.0, -100.0]
    whole = volumes_of({"bounds": bounds, "position_mm": place, "absorption_per_mm": KAPPA}, folder=tmp_path)
    gridded = volumes_of({"bounds": bounds, "position_mm": place, "grid": "grid.npz"}, folder=tmp_path)
    draw = np.random.default_rng(3)
    pieces = 0
    for _ in range(120):
        d = draw.normal(size=3)
        d /= np.linalg.norm(d)
        start = draw.uniform([-7.0, -7.0, -7.0], [7.0, 21.0, 7.0]) - 60.0 * d
        hits, _, _ = read.ray.intersects_location([start], [d], multiple_hits=True)
        t = np.sort((hits - start) @ d)
        assert len(t) % 2 == 0
        pieces = max(pieces, len(t) // 2)
        low, high = np.sort([(-box - start) / d, (box - start) / d], axis=0)
        first, last = low.max(), high.min()
        expected = (t[1::2] - t[::2]).sum()
        cut = np.clip(np.minimum(t[1::2], last) - np.maximum(t[::2], first), 0.0, None).sum()
        p = start + place
        assert depth(whole, p, d) == pytest.approx(KAPPA * expected, abs=1e-9)
        assert depth(gridded, p, d) == pytest.approx(KAPPA * cut, abs=1e-9)
        middle = 0.5 * (t[0] + t[1]) if len(t) else 60.0
        assert depth(whole, p, d, middle) == pytest.approx(0.5 * KAPPA * (t[1] - t[0]) if len(t) else 0.0, abs=1e-9)
    assert pieces >= 3


def test_a_mesh_and_other_bounds_over_one_another_add(tmp_path: Path) -> None:
    """The slab's own absorption, that of a box in it by its mesh, and what is booked to each."""
    bounds = written(trimesh.creation.box((20.0, 20.0, 4.0)), tmp_path)
    inner = {"bounds": bounds, "position_mm": [0.0, 0.0, -100.0], "absorption_per_mm": 0.07}
    for media in ([slab(10.0, absorption_per_mm=0.03), inner], [inner, slab(10.0, absorption_per_mm=0.03)]):
        book = np.zeros(2)
        volumes = volumes_of(*media, folder=tmp_path)
        found = passage(volumes, (1.0, 2.0, 0.0), (0.0, 0.0, -1.0), np.inf, book)
        np.testing.assert_allclose(found.transmittance, np.exp(-0.3 - 0.28), rtol=1e-13)
        share = 0.7 * -np.expm1(-0.4) * np.exp(-0.09)
        place = media.index(inner)
        np.testing.assert_allclose(book[[place, 1 - place]], [share, -np.expm1(-0.58) - share], rtol=1e-12)


def test_trees_hold_every_facet_once() -> None:
    corners = np.asarray(trimesh.creation.icosphere(2, 1.0).triangles)
    tree, [(begin, end), (second, last)] = tree_of([corners, corners + 5.0])
    leaves = tree.nodes[tree.nodes["count"] > 0]
    assert (begin, end, second, last) == (0, end, end, len(tree.nodes))
    assert leaves["count"].sum() == 2 * len(corners)
    assert leaves["count"].max() <= LEAF
    assert sorted(map(tuple, tree.corners[: len(corners), 0])) == sorted(map(tuple, corners[:, 0]))
    assert next_crossing(tree, second, last, 0.0, Ray(5.0, 5.0, 5.0, 0.0, 0.0, 1.0))[0]
    assert not next_crossing(tree, begin, end, 0.0, Ray(5.0, 5.0, 5.0, 0.0, 0.0, 1.0))[0]


@pytest.mark.parametrize(
    ("case", "message"),
    [
        ("open", r"open\.stl: the boundary of a medium must be a closed body; 3 of its edges belong to only one facet"),
        ("round the camera", r"media\[0\] reaches .* mm behind the first lens vertex"),
        ("missing", r"none\.stl: the mesh file"),
        ("unit", r"units: missing: STL files carry no unit"),
        ("ending", r"media\[0\]\.bounds\.file = \"body\.txt\": must end in one of"),
        ("kind", r"bounds"),
    ],
)
def test_bounds_that_cannot_be_used_are_refused(case: str, message: str, tmp_path: Path) -> None:
    box = trimesh.creation.box((8.0, 6.0, 4.0))
    written(box, tmp_path, "body.stl")
    trimesh.Trimesh(box.vertices, box.faces[1:]).export(tmp_path / "open.stl")
    bounds = {
        "open": {"file": "open.stl", "units": "mm"},
        "round the camera": {"file": "body.stl", "units": "m"},
        "missing": {"file": "none.stl", "units": "mm"},
        "unit": {"file": "body.stl"},
        "ending": {"file": "body.txt", "units": "mm"},
        "kind": {"kind": "sphere", "file": "body.stl", "units": "mm"},
    }[case]
    with pytest.raises(LfmeshError, match=message):
        volumes_of({"bounds": bounds, "position_mm": [0.0, 0.0, -150.0], "absorption_per_mm": 0.1}, folder=tmp_path)
