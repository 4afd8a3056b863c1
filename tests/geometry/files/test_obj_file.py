"""OBJ files and their materials: nothing vanishes and nothing is invented."""

import warnings

import numpy as np
import PIL.Image
import pytest

from lfmesh.errors import LensFileWarning, MeshError
from lfmesh.geometry.files.mesh_file import companions, load_mesh

SQUARE = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
FACET = "f 1/1 2/2 3/3 4/4\n"


def chart(path):
    path.parent.mkdir(exist_ok=True)
    PIL.Image.fromarray(np.full((2, 2, 3), 51, np.uint8)).save(path)


def loaded(folder, text, material=None):
    """Load an OBJ file without a warning."""
    if material is not None:
        (folder / "m.mtl").write_text(material)
    (folder / "t.obj").write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return load_mesh(folder / "t.obj", "mm")


@pytest.mark.parametrize("before", ["", "mtllib m.mtl\n"])
def test_facets_without_a_material_have_no_colour_of_their_own(tmp_path, before):
    (piece,) = loaded(tmp_path, before + SQUARE + FACET, "newmtl a\nKd 0 0 0\n")
    assert piece.picture is None
    np.testing.assert_array_equal(piece.factor, 1.0)
    assert piece.uv is not None


@pytest.mark.parametrize(
    ("defined", "used"),
    [
        ("newmtl m # the only one\nKd 0.2 0.5 0.1 # green", "m"),
        ("newmtl m\nKd\t0.2 0.5 0.1", "m # green"),
        ("newmtl Material #1\nKd 1 1 1\nnewmtl Material #2\nKd 0.2 0.5 0.1", "Material #2"),
        ("newmtl m\nkd 0.2 0.5 0.1", "m"),
    ],
)
def test_a_colour_is_found_beside_comments(tmp_path, defined, used):
    (piece,) = loaded(tmp_path, f"mtllib m.mtl\n{SQUARE}usemtl {used}\n{FACET}", defined)
    np.testing.assert_array_equal(piece.factor, (0.2, 0.5, 0.1))


def test_one_number_is_grey(tmp_path):
    (piece,) = loaded(tmp_path, f"mtllib m.mtl\n{SQUARE}usemtl m\n{FACET}", "newmtl m\nKd 0.5\n")
    np.testing.assert_array_equal(piece.factor, 0.5)


def test_a_colour_above_1_is_taken_as_1_and_told(tmp_path):
    (tmp_path / "m.mtl").write_text("newmtl m\nKd 1.5 0.5 0.1\n")
    (tmp_path / "t.obj").write_text(f"mtllib m.mtl\n{SQUARE}usemtl m\n{FACET}")
    with pytest.warns(LensFileWarning, match=r"material m: Kd 1\.5 0\.5 0\.1 is taken as the nearest colour"):
        (piece,) = load_mesh(tmp_path / "t.obj", "mm")
    np.testing.assert_array_equal(piece.factor, (1.0, 0.5, 0.1))


def test_numbers_below_0_count_back_from_their_line(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 5 0 0\nv 6 0 0\nv 5 1 0\nf -3 -2 -1\nf 1 -1 -2\n"
    (piece,) = loaded(tmp_path, text)
    x = piece.mesh.vertices[piece.mesh.faces][..., 0]
    np.testing.assert_array_equal(x, [[0, 1, 0], [5, 6, 5], [0, 5, 6]])
    (tmp_path / "far.obj").write_text("v 0 0 0\nv 1 0 0\nf -1 -2 -3\nv 0 1 0\n")
    with pytest.raises(MeshError, match="line 3: a facet names vertex -3, but there are 3"):
        load_mesh(tmp_path / "far.obj", "mm")


@pytest.mark.parametrize(
    ("option", "uv"),
    [
        ("-s 1 1 1", [0.0, 1.0]),
        ("-clamp on -blendu off", [0.0, 1.0]),
        ("-o 0.25 0.5 0 -s 2 4", [[0.25, 0.5], [2.25, 4.5]]),
        ("-bm 1 -mm 0 1 -s 2", [[0.0, 0.0], [2.0, 1.0]]),
    ],
)
def test_a_picture_has_the_place_that_its_options_give(tmp_path, option, uv):
    chart(tmp_path / "my chart.png")
    material = f"newmtl m\nmap_Kd {option} my chart.png\n"
    (piece,) = loaded(tmp_path, f"mtllib m.mtl\n{SQUARE}usemtl m\n{FACET}", material)
    assert piece.picture is not None
    assert piece.wrap == (("clamp", "clamp") if "clamp" in option else ("repeat", "repeat"))
    low, high = (np.broadcast_to(each, 2) for each in uv)
    np.testing.assert_array_equal(piece.uv.min(axis=(0, 1)), low)
    np.testing.assert_array_equal(piece.uv.max(axis=(0, 1)), high)


@pytest.mark.parametrize(
    ("library", "picture", "named"),
    [
        ("sub/m.mtl", "sub/chart.png", "chart.png"),
        ("sub/m.mtl", "chart.png", "chart.png"),
        ("sub\\m.mtl", "sub/maps/chart.png", "maps\\chart.png"),
        ("a.mtl m.mtl", "chart.png", "chart.png"),
        ("my materials.mtl", "chart.png", "./chart.png"),
        ("m.mtl # materials", "chart.png", '"chart.png"'),
    ],
)
def test_materials_and_pictures_are_found_where_programs_put_them(tmp_path, library, picture, named):
    (tmp_path / "sub").mkdir()
    (tmp_path / "a.mtl").write_text("newmtl other\n")
    chart(tmp_path / picture)
    file = library.split("#")[0].strip().replace("\\", "/").removeprefix("a.mtl ")
    (tmp_path / file).write_text(f"newmtl m\nmap_Kd {named}\n")
    (piece,) = loaded(tmp_path, f"mtllib {library}\n{SQUARE}usemtl m\n{FACET}")
    assert piece.picture is not None
    assert {file, picture} <= set(companions(tmp_path / "t.obj"))


def test_two_material_files_are_both_read(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl a\nKd 0.25\n")
    text = f"mtllib a.mtl\nmtllib m.mtl\n{SQUARE}usemtl a\n{FACET}usemtl b\n{FACET}"
    pieces = loaded(tmp_path, text, "newmtl b\nKd 0.5\n")
    assert [(piece.called, piece.factor[0]) for piece in pieces] == [("a", 0.25), ("b", 0.5)]


@pytest.mark.parametrize(
    ("material", "said"),
    [
        ("map_Kd gone.png", "its picture gone.png is missing: its facets have their plain colour"),
        ("map_Bump bump.png", "material m: its picture map_bump is left out"),
        ("Ke 1 1 1", "its emission"),
        ("map_Kd -mm 0.5 1 chart.png", r"the range of its picture \(-mm 0\.5 1\) is left out"),
        ("Kd spectral a.rfl", "Kd spectral a.rfl is left out"),
    ],
)
def test_what_a_material_has_and_the_scene_has_not_is_told(tmp_path, material, said):
    chart(tmp_path / "chart.png")
    (tmp_path / "m.mtl").write_text(f"newmtl m\n{material}\n")
    (tmp_path / "t.obj").write_text(f"mtllib m.mtl\n{SQUARE}usemtl m\n{FACET}l 1 2\n")
    with pytest.warns(LensFileWarning, match=said), pytest.warns(LensFileWarning, match="its 1 lines are left out"):
        load_mesh(tmp_path / "t.obj", "mm")


@pytest.mark.parametrize(
    ("facet", "said", "has"),
    [
        ("f 1/1 2/2 3/9\n", "1 facets name missing texture coordinates", (False, False)),
        ("f 1/1/1 2/2/1 3/3/1\n", "1 facets name missing normals", (True, False)),
    ],
)
def test_what_is_not_there_is_told_and_not_used(tmp_path, facet, said, has):
    (tmp_path / "t.obj").write_text(SQUARE + facet + "f 1/1 3/3 4/4\n")
    with pytest.warns(LensFileWarning, match=said):
        pieces = load_mesh(tmp_path / "t.obj", "mm")
    assert sum(len(piece.mesh.faces) for piece in pieces) == 2
    first = next(piece for piece in pieces if set(piece.mesh.vertices[piece.mesh.faces[0], 0].tolist()) == {-1.0, 1.0})
    assert (first.uv is not None, first.mesh.corner_normals is not None) == has


def test_comments_stand_anywhere_and_lines_go_on(tmp_path):
    text = SQUARE.replace("v 1 1 0", "v 1 \\\n1 0 # corner") + "# f 9 9 9\n  f 1/1 2/2 \\\n 3/3 4/4 # done\n"
    (piece,) = loaded(tmp_path, text)
    assert len(piece.mesh.faces) == 2
    assert np.ptp(piece.mesh.vertices, axis=0).tolist() == [2.0, 2.0, 0.0]


def test_colours_behind_the_coordinates_are_those_of_the_vertices(tmp_path):
    rows = [(0, 0, 0, 0.1, 0.2, 0.3), (1, 0, 0, 0.4, 0.5, 0.6), (0, 1, 0, 1.0, 0.0, 0.5)]
    (piece,) = loaded(tmp_path, "".join(f"v {' '.join(map(str, row))}\n" for row in rows) + "f 1 2 3\n")
    np.testing.assert_array_equal(piece.colours[0], np.array(rows)[:, 3:])


def test_opacity_and_vertex_colours_have_an_alpha_where_one_is_asked_for(tmp_path):
    (tmp_path / "m.mtl").write_text("newmtl m\nKd 0.5\nTr 0.25\n")
    (tmp_path / "t.obj").write_text("mtllib m.mtl\nusemtl m\nv 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nf 1 2 3\n")
    (piece,) = load_mesh(tmp_path / "t.obj", "mm", alpha=True)
    np.testing.assert_array_equal(piece.factor, (0.5, 0.5, 0.5, 0.75))
    np.testing.assert_array_equal(piece.colours[0], np.column_stack([np.eye(3), np.ones(3)]))
