"""STEP and 3MF files: sizes and names as in the file, and one line for whatever is broken, huge or hostile.

`tests/solids` was made by gmsh 4.15 (OpenCASCADE 7.8): biconvex.step has spheres of 30 and -40 mm, 6 mm apart, in a
cylinder of 10 mm; doublet.step is an assembly of L1 (50, -40, 8 mm) and L2 (-40, -120, 3 mm) in a cylinder of 12 mm.
"""

import zipfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.errors import LensFileWarning, MeshError, SceneError
from lfmesh.geometry.files import cad_file
from lfmesh.geometry.files.mesh_file import load_mesh
from tests.processor_time import processor_seconds

SOLIDS = Path(__file__).resolve().parents[3] / "tests" / "solids"
needs_cascadio = pytest.mark.skipif(find_spec("cascadio") is None, reason="cascadio, of the extra cad, is not there")

RELATIONSHIPS = (
    '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship Id="a" '
    'Target="/3D/m.model" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
)
TETRAHEDRON = (
    '<mesh><vertices><vertex x="0" y="0" z="0"/><vertex x="1" y="0" z="0"/><vertex x="0" y="2" z="0"/>'
    '<vertex x="0" y="0" z="3"/></vertices><triangles><triangle v1="0" v2="2" v3="1"/><triangle v1="0" v2="1" v3="3"/>'
    '<triangle v1="1" v2="2" v3="3"/><triangle v1="2" v2="0" v3="3"/></triangles></mesh>'
)
ONE = f'<object id="1" name="pin">{TETRAHEDRON}</object>'
NAMESPACE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"


def model(objects, items='<item objectid="1"/>', unit="millimeter", head=""):
    return (
        f'{head}<model unit="{unit}" xmlns="{NAMESPACE}"><resources>{objects}</resources><build>{items}</build></model>'
    )


def save_3mf(path, text, relationships=RELATIONSHIPS, part="m.model"):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as package:
        package.writestr("_rels/.rels", relationships.replace("m.model", part))
        package.writestr(f"3D/{part}", text)
    return path


def extents(pieces):
    points = np.concatenate([piece.mesh.vertices for piece in pieces])
    return np.ptp(points, axis=0)


def volume(mesh):
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0


def refusal(path, **options):
    """Return the message of a file that is refused, which is one line that names it."""
    with pytest.raises(MeshError) as raised:
        load_mesh(path, **options)
    message = str(raised.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    assert len(message) < 300 + len(str(path))
    return message


@pytest.mark.parametrize(
    ("unit", "mm"), [("micron", 1e-3), ("millimeter", 1), ("centimeter", 10), ("inch", 25.4), ("foot", 304.8)]
)
def test_the_size_of_a_3mf_body_is_in_the_files_unit(tmp_path, unit, mm):
    pieces = load_mesh(save_3mf(tmp_path / "a.3mf", model(ONE, unit=unit)))
    np.testing.assert_allclose(extents(pieces), np.array([1, 2, 3]) * mm, rtol=1e-15)
    assert volume(pieces[0].mesh) == pytest.approx(mm**3)
    assert "names its own" in refusal(tmp_path / "a.3mf", units="mm")


def test_bodies_of_a_3mf_file_stand_where_their_transforms_put_them_and_go_by_name(tmp_path):
    twice = '<object id="2" name="pair"><components>{}</components></object>'.format(
        '<component objectid="1" transform="1 0 0 0 1 0 0 0 1 10 0 0"/>'
        '<component objectid="1" transform="-1 0 0 0 1 0 0 0 1 0 0 0"/>'
    )
    items = '<item objectid="1"/><item objectid="2" transform="0 1 0 -1 0 0 0 0 1 0 0 100"/>'
    path = save_3mf(tmp_path / "a.3mf", model(ONE + twice, items))
    pin, moved, mirrored = (piece.mesh for piece in load_mesh(path))
    # (x, y) becomes (-y, x), by hand: rows times matrix, section 3.3 of the specification.
    np.testing.assert_allclose(moved.vertices[1], [0, 11, 100])
    np.testing.assert_allclose(mirrored.vertices[1], [0, -1, 100])
    assert [volume(each) for each in (pin, moved, mirrored)] == pytest.approx([1.0, 1.0, 1.0])
    assert len(load_mesh(path, node="pin")) == len(load_mesh(path, node=2)) == 1
    assert "valid are 'pin', 1, 2" in refusal(path, node="pair")


def hostile_3mf(folder):
    """Yield 3MF files that are broken or made to do harm, with the reason each is given."""
    whole = save_3mf(folder / "whole.3mf", model(ONE)).read_bytes()
    named = save_3mf(folder / "named.3mf", model(ONE), part=f"{'m' * 500}.model")
    for name, content, reason in (
        ("renamed", named.read_bytes().replace(b"mmmm", b"nnnn", 1), "broken"),
        ("empty", b"", "not a 3MF file"),
        ("garbage", bytes(range(256)) * 9, "not a 3MF file"),
        ("short", whole[:-30], "not a 3MF file"),
        ("flipped", whole.replace(whole[300:320], bytes(20)), "broken"),
    ):
        (folder / f"{name}.3mf").write_bytes(content)
        yield folder / f"{name}.3mf", reason
    bomb = folder / "bomb.3mf"
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as package:
        package.writestr("_rels/.rels", RELATIONSHIPS)
        with package.open("3D/m.model", "w", force_zip64=True) as part:
            for _ in range(400):
                part.write(bytes(2**20))
    yield bomb, "unpacks to more than the limit of 256 MiB"
    laughs = '<!DOCTYPE m [<!ENTITY a0 "ha">{}]>'.format(
        "".join(f'<!ENTITY a{k + 1} "{f"&a{k};" * 10}">' for k in range(12))
    )
    components = '<object id="{}"><components>{}</components></object>'
    loop = components.format(1, '<component objectid="1"/>')
    doubling = "".join(components.format(k, f'<component objectid="{k + 1}"/>' * 4) for k in range(1, 30))
    one_facet = TETRAHEDRON.replace('v3="1"', 'v3="9"')
    for name, text, reason in (
        ("laughs", model("<object id='1'>&a12;</object>", head=laughs), "not a 3MF file"),
        ("loop", model(loop), "more than 50 deep"),
        ("doubling", model(doubling + f'<object id="30">{TETRAHEDRON}</object>'), "more than 100000 objects"),
        ("index", model(f'<object id="1">{one_facet}</object>'), "names a vertex beyond the 4"),
        ("word", model(ONE.replace('x="1"', 'x="one"')), "is not a number"),
        ("nan", model(ONE.replace('x="1"', 'x="nan"')), "is not finite"),
        ("far", model(ONE.replace('x="1"', 'x="1e300"')), "farther than"),
        ("gone", model(ONE, '<item objectid="7"/>'), "object '7', which is missing"),
        ("unit", model(ONE, unit="furlong"), "its unit is 'furlong'; valid are"),
        ("matrix", model(ONE, '<item objectid="1" transform="1 2"/>'), "2 numbers; valid are 12"),
        ("nothing", model(ONE, ""), "no facets"),
        ("xml", "<model><open>", "not a 3MF file"),
        ("slices", model(ONE).replace("<model ", '<model requiredextensions="s" '), "needs the extension 's'"),
    ):
        yield save_3mf(folder / f"{name}.3mf", text), reason


def test_every_broken_or_hostile_3mf_file_is_refused_in_one_line(tmp_path):
    for path, reason in hostile_3mf(tmp_path):
        assert reason in refusal(path), path.name


def test_a_step_file_without_cascadio_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr(cad_file, "find_spec", lambda name: None)
    (tmp_path / "a.stp").touch()
    assert "pip install 'lfmesh[cad]'" in refusal(tmp_path / "a.stp")


INCH = (
    "( CONVERSION_BASED_UNIT('INCH',#901) LENGTH_UNIT() NAMED_UNIT(#902) );\n"
    "#901 = LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(25.4),#903);\n#902 = DIMENSIONAL_EXPONENTS(1.,0.,0.,0.,0.,0.,0.);\n"
    "#903 = ( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.) );"
)
MILLIMETRE = "( LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.) );"


@needs_cascadio
@pytest.mark.parametrize(("unit", "mm"), [("", 1), (INCH, 25.4), (MILLIMETRE.replace(".MILLI.", "$"), 1e3)])
def test_the_size_of_a_step_body_is_in_the_files_unit(tmp_path, unit, mm):
    text = (SOLIDS / "biconvex.step").read_text()
    assert text.count(MILLIMETRE) == 1
    (tmp_path / "a.STEP").write_text(text.replace(MILLIMETRE, unit or MILLIMETRE))
    pieces = load_mesh(tmp_path / "a.STEP", tolerance_mm=0.05 * mm)
    # The facets' corners lie on the rim, not at its extremes: at most the tolerance within it.
    np.testing.assert_allclose(extents(pieces), np.array([20, 20, 6]) * mm, rtol=0.0, atol=0.1 * mm)
    assert extents(pieces)[2] == pytest.approx(6 * mm, rel=1e-6)


@needs_cascadio
def test_bodies_of_a_step_file_go_by_name_and_have_volumes_by_the_caps_formula():
    def cap(radius, depth):
        return np.pi * depth**2 * (radius - depth / 3.0)

    def depth(radius):
        return radius - np.sqrt(radius**2 - 144.0)

    path = SOLIDS / "doublet.step"
    cement = cap(40.0, depth(40.0))
    first = np.pi * 144.0 * (8.0 - depth(50.0) - depth(40.0)) + cap(50.0, depth(50.0)) + cement
    second = np.pi * 144.0 * (3.0 + depth(40.0) - depth(120.0)) + cap(120.0, depth(120.0)) - cement
    for name, true in (("L1", first), ("L2", second)):
        (piece,) = load_mesh(path, node=name)
        assert volume(piece.mesh) == pytest.approx(true, rel=2e-3)
    assert len(load_mesh(path)) == 2
    assert "valid are 'doublet', 'L1', 'L2'" in refusal(path, node="L3")


@pytest.mark.long
@needs_cascadio
def test_facets_lie_within_the_tolerance():
    for tolerance in (0.2, 0.01):
        (piece,) = load_mesh(SOLIDS / "biconvex.step", tolerance_mm=tolerance)
        middle = piece.mesh.vertices[piece.mesh.faces].mean(axis=1)
        front = middle[middle[:, 2] < 1.0]
        off = np.abs(np.linalg.norm(front - [0.0, 0.0, 30.0], axis=1) - 30.0)
        assert off.max() < tolerance


@needs_cascadio
def test_broken_and_endless_step_files_are_refused_in_one_line(tmp_path, monkeypatch):
    text = (SOLIDS / "biconvex.step").read_text()
    entities = text[text.index("#17 =") : text.index("ENDSEC;", text.index("DATA;"))]
    path = tmp_path / "a.step"
    for content, reason in (
        ("", "does not begin with"),
        ("ISO-10303-21;", "cut short"),
        (text[: len(text) // 2], "cut short"),
        (text.replace(entities, ""), "entities are named but missing, the first is #"),
        ("ISO-10303-21;\nEND-ISO-10303-21;\n", "finds no body"),
        ("ISO-10303-21;\nDATA;\n" + "((((" * 10_000 + "\nEND-ISO-10303-21;\n", "finds no body"),
    ):
        path.write_text(content)
        assert reason in refusal(path), content[:60]
    path.write_text(text)
    assert "tolerance_mm = 1e-09 is finer than the limit of 1e-06" in refusal(path, tolerance_mm=1e-9)
    monkeypatch.setenv(cad_file.SECONDS, "1")
    begun = processor_seconds()
    message = refusal(path, tolerance_mm=1e-6)
    assert "took more than 1 s of processor time, with coarser facets as well" in message
    assert cad_file.SECONDS in message
    assert processor_seconds() - begun < 10.0
    monkeypatch.setenv(cad_file.SECONDS, "soon")
    assert "LFMESH_CAD_SECONDS = 'soon': it must be a whole number" in refusal(path)


@needs_cascadio
def test_step_facets_that_take_too_long_are_made_coarser_with_a_warning(tmp_path, monkeypatch):
    # The child ends, out of time, unless its facets are coarser: what the system does to it after some seconds.
    program = Path(cad_file.cad_child.__file__).read_text()
    program = program.replace("def main(", "import os, signal\n\n\ndef main(")
    limited = "    if factor < 10.0:\n        os.kill(os.getpid(), signal.SIGXCPU)\n    memory, output"
    monkeypatch.setattr(cad_file.cad_child, "__file__", str(tmp_path / "child.py"))
    (tmp_path / "child.py").write_text(program.replace("    memory, output", limited, 1))
    path = tmp_path / "a.step"
    path.write_text((SOLIDS / "biconvex.step").read_text())
    with pytest.warns(LensFileWarning, match="up to 10 times as far off its surfaces as tolerance_mm = 0.001"):
        (coarse,) = load_mesh(path, tolerance_mm=1e-3)
    monkeypatch.undo()
    (same,) = load_mesh(SOLIDS / "biconvex.step", tolerance_mm=1e-2)
    (fine,) = load_mesh(SOLIDS / "biconvex.step", tolerance_mm=1e-3)
    assert len(same.mesh.faces) // 2 <= len(coarse.mesh.faces) < len(fine.mesh.faces)


@needs_cascadio
def test_a_process_that_the_system_ends_for_memory_is_told_of_memory_and_not_repeated(tmp_path, monkeypatch):
    program = Path(cad_file.cad_child.__file__).read_text()
    tries = tmp_path / "tries"
    killed = f"    open({str(tries)!r}, 'a').write('x')\n    os.kill(os.getpid(), signal.SIGKILL)\n    memory, output"
    program = program.replace("def main(", "import os, signal\n\n\ndef main(").replace("    memory, output", killed, 1)
    (tmp_path / "child.py").write_text(program)
    monkeypatch.setattr(cad_file.cad_child, "__file__", str(tmp_path / "child.py"))
    path = tmp_path / "a.step"
    path.write_text((SOLIDS / "biconvex.step").read_text())
    message = refusal(path)
    assert "the system ended the program that opened it, most likely because memory ran out" in message
    assert "processor time" not in message
    assert tries.read_text() == "x"


def test_time_for_a_file_grows_with_its_size(tmp_path):
    path = tmp_path / "a.step"
    path.write_bytes(b"x" * 2**20)
    assert cad_file.most_seconds(path) == cad_file.MOST_SECONDS + cad_file.SECONDS_PER_MEBIBYTE


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"file": "a.stl", "units": "mm", "tolerance_mm": 0.1}, "tolerance_mm = 0.1: omit it: only the faces of STEP"),
        ({"file": "a.stl", "units": "mm", "node": "b"}, 'node = "b": omit it: only .glb, .gltf, .step, .stp, .3mf'),
        ({"file": "a.step", "tolerance_mm": 0.0}, "tolerance_mm"),
        ({"shape": {"kind": "disk", "radius_mm": 1.0}, "tolerance_mm": 0.1}, "tolerance_mm = 0.1: only for a STEP"),
        ({"file": "a.iges"}, "export it from the CAD program as STEP"),
    ],
)
def test_keys_of_solids_are_refused_where_they_mean_nothing(keys, message):
    with pytest.raises(SceneError) as raised:
        lf.Target(**keys)
    assert message in str(raised.value)
