"""PLY, OFF and STL files: polygons, strips, colours, comments, and rows that are not of one size."""

import struct
import warnings

import numpy as np
import pytest

from lfmesh.errors import LensFileWarning, MeshError
from lfmesh.geometry.files.contents import counted
from lfmesh.geometry.files.mesh_file import load_mesh

CORNERS = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0], [0, 2, 1], [2, 2, 1]], float)
POLYGONS = [[0, 1, 2, 3], [3, 2, 4], [2, 5, 4]]


def loaded(path, content):
    """Load a file without a warning."""
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return load_mesh(path, "mm")


def areas(piece):
    a, b, c = np.moveaxis(piece.mesh.vertices[piece.mesh.faces], 1, 0)
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def ply(kind, strips=False, extra=()):
    """Return a PLY file of `POLYGONS`, or of strips with the same facets, with bytes behind each row's list."""
    lists = [[0, 1, 3, 2, 4, 5], [0, 1, 2]] if strips else POLYGONS
    head = [
        "ply",
        f"format {kind} 1.0",
        "comment made by hand",
        "obj_info of nobody",
        f"element vertex {len(CORNERS)}",
        *(f"property double {axis}" for axis in "xyz"),
        f"element {'tristrips' if strips else 'face'} {len(lists)}",
        "property list uchar int vertex_indices",
        *(f"property uchar {name}" for name in extra),
        "end_header\n",
    ]
    order = ">" if "big" in kind else "<"
    if kind == "ascii":
        rows = [" ".join(map(str, row)) for row in CORNERS]
        rows += [" ".join(map(str, [len(each), *each, *(51 for _ in extra)])) for each in lists]
        return ("\n".join(head) + "\n".join(rows) + "\n").encode()
    body = b"".join(struct.pack(f"{order}3d", *row) for row in CORNERS)
    body += b"".join(
        struct.pack(f"{order}B{len(each)}i{len(extra)}B", len(each), *each, *(51 for _ in extra)) for each in lists
    )
    return "\n".join(head).encode() + body


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_polygons_of_different_length_are_all_there(tmp_path, kind):
    (piece,) = loaded(tmp_path / "t.ply", ply(kind, extra=("red", "green", "blue")))
    assert areas(piece).sum() == pytest.approx(2.0 + 2.0 * np.sqrt(2.0))
    assert len(piece.mesh.faces) == 4
    np.testing.assert_allclose(piece.colours, 0.2)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
def test_ply_strips_turn_every_other_facet(tmp_path, kind):
    (piece,) = loaded(tmp_path / "t.ply", ply(kind, strips=True))
    truth = [[0, 1, 3], [1, 2, 3], [3, 2, 4], [2, 5, 4], [0, 1, 2]]
    canonical = lambda rows: sorted(min(row[k:] + row[:k] for k in range(3)) for row in rows)  # noqa: E731
    assert canonical(piece.mesh.faces.tolist()) == canonical(truth)


def test_a_ply_row_longer_than_its_header_is_told_and_cut(tmp_path):
    content = ply("ascii").replace(b"4 0 1 2 3", b"4 0 1 2 3 9 1 1 1").replace(b"3 3 2 4", b"3 3 2 4 9 1 1 1")
    (tmp_path / "t.ply").write_bytes(content)
    with pytest.warns(LensFileWarning, match="its rows have more numbers than its header names"):
        (piece,) = load_mesh(tmp_path / "t.ply", "mm")
    assert areas(piece).sum() == pytest.approx(2.0 + 2.0 * np.sqrt(2.0))


def test_off_colours_of_vertices_and_facets(tmp_path):
    vertices = "0 0 0 51 102 255 255\n1 0 0 51 102 255 255\n1 1 0 0 0 0 255\n0 1 0 0 0 0 255 # last\n"
    (piece,) = loaded(tmp_path / "t.off", f"COFF\n# a comment\n4 1 0\n\n{vertices}4 0 1 2 3\n")
    colour = {tuple(v): c for v, c in zip(piece.mesh.vertices[piece.mesh.faces[0]], piece.colours[0], strict=True)}
    np.testing.assert_allclose(colour[0.0, 0.0, 0.0], (0.2, 0.4, 1.0))
    (piece,) = loaded(tmp_path / "f.off", "OFF 3 2 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2 0.5 0.25 0.125\n3 0 2 1\n")
    np.testing.assert_array_equal(piece.colours[:, 0], [(0.5, 0.25, 0.125), (1.0, 1.0, 1.0)])


def test_off_needs_no_lines(tmp_path):
    (piece,) = loaded(
        tmp_path / "t.off", "OFF8 2 0\n" + "0 0 0 1 0 0 0 1 0 1 1 0 " + "0 0 9 " * 4 + "3 0 1 2 3 1 3 2\n"
    )
    assert areas(piece).sum() == pytest.approx(1.0)


@pytest.mark.parametrize("spoilt", ["%", "FACET", "one line", "comment"])
def test_stl_words_may_stand_anywhere(tmp_path, spoilt):
    text = "solid my vertex\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1e0 0\nendloop\n"
    text = (text + "endfacet\nendsolid my vertex\n") * 2
    if spoilt == "FACET":
        text = text.upper()
    elif spoilt == "one line":
        text = text.replace("\nvertex", " vertex").replace("\nendloop", " endloop")
    elif spoilt == "comment":
        text = text.replace("vertex 1 0 0\n", "vertex 1 0 0 # vertex 9 9 9\n// a facet\n")
    (piece,) = loaded(tmp_path / "t.stl", text)
    np.testing.assert_allclose(areas(piece), [0.5, 0.5])


def test_a_binary_stl_may_begin_with_the_word_solid(tmp_path):
    facet = struct.pack("<12fH", *[0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0], 0)
    (piece,) = loaded(tmp_path / "t.stl", b"solid vertex endfacet".ljust(80) + struct.pack("<I", 2) + 2 * facet)
    assert len(piece.mesh.faces) == 2
    (tmp_path / "short.stl").write_bytes(b"binary".ljust(80) + struct.pack("<I", 9) + facet)
    with pytest.raises(MeshError, match="its header counts 9 facets, but the file has room for 1"):
        load_mesh(tmp_path / "short.stl", "mm")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("part.obj", "v 0 0 0\nv 2 0 0\nv 2 1 0\nv 0 1 0\nv 9 9 9\nf 1 2 3 4\n"),
        ("part.off", "OFF\n4 1 0\n0 0 0\n2 0 0\n2 1 0\n0 1 0\n4 0 1 2 3\n"),
        ("part.stl", "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 2 0 0\nvertex 2 2 0\nendloop\n"
         "endfacet\nendsolid a\n"),
        ("part.ply", "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
         "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n2 0 0\n2 1 0\n0 1 0\n4 0 1 2 3\n"),
    ],
)  # fmt: skip
def test_a_byte_order_mark_is_no_part_of_a_file(tmp_path, name, text):
    (piece,) = loaded(tmp_path / name, text.encode("utf-8-sig"))
    assert areas(piece).sum() == pytest.approx(2.0)
    assert counted(tmp_path / name).facets == len(piece.mesh.faces)
