"""Mesh files and pictures with bytes changed at random are read or refused by one line that names the file."""

import contextlib
import io
import re
import warnings
import zipfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lfmesh.errors import LensFileWarning, LfmeshError
from lfmesh.geometry.files.cad_child import UnusableError, read_3mf
from lfmesh.geometry.files.mesh_file import NODE_ENDINGS, load_mesh
from lfmesh.geometry.objects.texture import load_texture
from tests.geometry.files.test_3mf_parts import PLAIN, body, model, saved
from tests.geometry.files.test_plain_files import ply
from tests.glb import QUAD, QUAD_UV, SPLIT, Glb


def exported(ending: str) -> bytes:
    body = trimesh.creation.box(extents=(1.0, 2.0, 3.0))
    whole = body.export(file_type=ending)
    return whole if isinstance(whole, bytes) else whole.encode()


def gltf() -> bytes:
    files = trimesh.creation.box(extents=(1.0, 2.0, 3.0)).export(file_type="gltf", embed_buffers=True)
    return files["model.gltf"]


OBJ = b"""mtllib file.mtl
v 0 0 0 0.1 0.2 0.3
v 2 0 0 0.1 0.2 0.3
v 2 1 0 0.4 0.5 0.6
v 1 0.5 0 1 1 1
v 0 1 0 1 1 1
vt 0 0
vt 1 0
vt 1 1
vn 0 0 1
usemtl a # the first
f 1/1/1 2/2/1 3/3/1 4/1/1 5//
usemtl b
f -5//1 -4//1 -3//1 # back
l 1 2
"""
MTL = b"newmtl a\nKd 0.5\nmap_Kd -s 2 2 1 -clamp on file.png\nd 0.5\n\nnewmtl b # other\nKd 0.1 0.2 0.3\nKe 1 1 1\n"


def glb_with_everything() -> bytes:
    """Return a GLB file with sparse positions, whole texture coordinates, vertex colours, a strip and a fan."""
    glb = Glb()
    material = glb.material(picture=picture("png"))
    glb.tree["materials"][material]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"] = {
        "KHR_texture_transform": {"offset": [0.1, 0.2], "rotation": 0.3, "scale": [2.0, 1.0]}
    }
    first = glb.primitive(QUAD, SPLIT, material, TEXCOORD_0=QUAD_UV)
    accessors = glb.tree["accessors"]
    accessors[first["attributes"]["POSITION"]]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": glb.view(np.array([1], "<u2").tobytes()), "componentType": 5123},
        "values": {"bufferView": glb.view(np.ones((1, 3), "<f4").tobytes())},
    }
    accessors[first["attributes"]["TEXCOORD_0"]] |= {
        "bufferView": glb.view((255 * QUAD_UV).astype("<u2").tobytes()),
        "componentType": 5123,
        "normalized": True,
    }
    others = [glb.primitive(QUAD, range(4)) | {"mode": mode} for mode in (5, 6)]
    others[0]["attributes"]["COLOR_0"] = glb.table(np.eye(4, 3), "VEC3")
    glb.node("A", mesh=glb.add("meshes", {"primitives": [first, *others]}))
    return glb.bytes()


def picture(format_name: str) -> bytes:
    pixels = (np.arange(16 * 16 * 3).reshape(16, 16, 3) % 251).astype(np.uint8)
    stream = io.BytesIO()
    PIL.Image.fromarray(pixels).save(stream, format=format_name)
    return stream.getvalue()


PLY_KINDS = ("ascii", "binary_little_endian", "binary_big_endian")

WHOLE = {
    **{ending: exported(ending) for ending in ("stl", "obj", "ply", "off", "glb")},
    "gltf": gltf(),
    **{name: picture(name) for name in ("png", "jpeg", "tiff", "bmp", "webp", "gif")},
}
BESIDE = {"file.mtl": MTL, "file.png": WHOLE["png"]}
RICH = {"obj": OBJ, "mtl": MTL, "glb": glb_with_everything(), **{f"{kind} ply": ply(kind) for kind in PLY_KINDS}}
"""Files that use much of their formats; the material file is read by the OBJ file beside it."""

PICTURES = ("png", "jpeg", "tiff", "bmp", "webp", "gif")

# Whole numbers that stand for a count, an index or an offset once they are put there.
LARGE = [
    b"\xff\xff\xff\xff",
    b"\xff\xff\xff\x7f",
    b"\x00\x00\x00\x80",
    b"\x00\x00\x00\x00",
    b"9",
    b"-",
    b"99999999",
    b"nan",
]

damages = st.lists(
    st.tuples(st.floats(0.0, 1.0), st.one_of(st.sampled_from(LARGE), st.binary(min_size=1, max_size=4))),
    min_size=1,
    max_size=3,
)


def damaged(whole: bytes, damage: list[tuple[float, bytes]], kept: float) -> bytes:
    content = bytearray(whole)
    for share, patch in damage:
        # Headers are short, and all that can go wrong is in them: most places are near the start.
        place = int(share**3 * len(content))
        content[place : place + len(patch)] = patch
    return bytes(content[: max(1, int(kept * len(content)))])


def is_read_or_refused(folder: Path, ending: str, content: bytes) -> None:
    path = folder / f"file.{ending}"
    path.write_bytes(content)
    try:
        if ending in PICTURES:
            texture = load_texture(path)
            assert ((texture >= 0) & (texture <= 1)).all()
        else:
            for piece in load_mesh(path, None if f".{ending}" in NODE_ENDINGS else "mm"):
                assert np.isfinite(piece.mesh.vertices[piece.mesh.faces]).all()
    except LfmeshError as error:
        message = str(error)
        assert message.startswith(str(path))
        assert len(message.splitlines()) == 1
        assert len(message) < 500 + len(str(path))


def is_read_or_refused_beside(folder: Path, kind: str, content: bytes) -> None:
    """Read a damaged file whose companions are whole, or a whole OBJ file whose companion is damaged."""
    for name, whole in BESIDE.items():
        (folder / name).write_bytes(whole)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LensFileWarning)
        if kind == "mtl":
            (folder / "file.mtl").write_bytes(content)
            is_read_or_refused(folder, "obj", OBJ)
        else:
            is_read_or_refused(folder, kind.split()[-1], content)


SOLIDS = Path(__file__).resolve().parents[1] / "solids"


def three_mf() -> bytes:
    """Return a box as a 3MF file, its model not compressed, so that damage is met by the reader of models."""
    body = trimesh.creation.box(extents=(1.0, 2.0, 3.0))
    points = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in body.vertices)
    facets = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in body.faces)
    kind = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as package:
        package.writestr("_rels/.rels", f'<R><Relationship Target="/m" Type="{kind}"/></R>')
        package.writestr(
            "m",
            f'<model><object id="1"><mesh><vertices>{points}</vertices><triangles>{facets}</triangles></mesh></object>'
            '<item objectid="1"/></model>',
        )
    return stream.getvalue()


kept = st.one_of(st.just(1.0), st.just(1.0), st.floats(0.0, 1.0))
unhurried = settings(
    deadline=None, derandomize=True, database=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.mark.parametrize("ending", WHOLE)
def test_the_files_that_are_damaged_are_whole(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"file.{ending}"
    path.write_bytes(WHOLE[ending])
    if ending in PICTURES:
        assert load_texture(path).shape == (16, 16, 3)
    else:
        assert sum(len(piece.mesh.faces) for piece in load_mesh(path, None if ending.startswith("gl") else "mm")) == 12


@settings(unhurried, max_examples=250)
@given(st.sampled_from(sorted(WHOLE)), damages, kept)
def test_a_damaged_mesh_or_picture_is_read_or_refused(
    tmp_path: Path, ending: str, damage: list[tuple[float, bytes]], kept: float
) -> None:
    is_read_or_refused(tmp_path, ending, damaged(WHOLE[ending], damage, kept))


@pytest.mark.long
@settings(unhurried, max_examples=5_000)
@given(st.sampled_from(sorted(WHOLE)), damages, kept)
def test_many_damaged_meshes_and_pictures_are_read_or_refused(
    tmp_path: Path, ending: str, damage: list[tuple[float, bytes]], kept: float
) -> None:
    is_read_or_refused(tmp_path, ending, damaged(WHOLE[ending], damage, kept))


@settings(unhurried, max_examples=200)
@given(st.sampled_from(sorted(RICH)), damages, kept)
def test_a_damaged_file_that_uses_much_of_its_format_is_read_or_refused(
    tmp_path: Path, kind: str, damage: list[tuple[float, bytes]], kept: float
) -> None:
    is_read_or_refused_beside(tmp_path, kind, damaged(RICH[kind], damage, kept))


@pytest.mark.long
@settings(unhurried, max_examples=20_000)
@given(st.sampled_from(sorted(RICH)), damages, kept)
def test_many_damaged_files_that_use_much_of_their_format_are_read_or_refused(
    tmp_path: Path, kind: str, damage: list[tuple[float, bytes]], kept: float
) -> None:
    is_read_or_refused_beside(tmp_path, kind, damaged(RICH[kind], damage, kept))


@settings(unhurried, max_examples=8)
@given(damages, kept)
def test_a_damaged_3mf_file_is_read_or_refused(tmp_path: Path, damage: list[tuple[float, bytes]], kept: float) -> None:
    is_read_or_refused(tmp_path, "3mf", damaged(three_mf(), damage, kept))


COLOURS = (
    '<basematerials id="8"><base name="a" displaycolor="#FF0000"/></basematerials>'
    '<m:colorgroup id="9"><m:color color="#000000"/><m:color color="#FFFFFF80"/></m:colorgroup>'
    '<m:texture2dgroup id="6"/>'
)
MODELS = {
    "root": model(
        COLOURS + body(1, [*PLAIN[:3], (2, 0, 3, 'pid="9" p1="0" p2="1" p3="0"')], 'name="own" pid="8" pindex="0"')
        + '<object id="2"><components><component objectid="1" transform="1 0 0 0 1 0 0 0 -1 5 0 0"/>'
        '<component objectid="1" p:path="/3D/other.model"/></components></object>',
        '<item objectid="2" transform="0 1 0 1 0 0 0 0 1 1 2 3"/><item objectid="1"/>',
        "p m",
    ),
    "other": model(COLOURS + body(1, PLAIN, 'pid="9" pindex="1"'), ""),
}  # fmt: skip
"""Models of a 3MF file that uses much of its format."""

SPANS = {"value": r'(?<==")[^"]*', "key": r' [\w:]+="[^"]*"', "tag": "<[^>]*>", "again": "<[^>]*>"}
"""Places of a model that an edit changes: a value gets another, a key or tag is left out, a tag stands twice."""

WORDS = ["", "0", "3", "-1", "1e308", "1e999", "nan", "9" * 12, "9" * 400, "#12", "/3D/other.model", "..", "x"]
edits = st.lists(
    st.tuples(
        st.sampled_from(sorted(MODELS)), st.sampled_from([*SPANS, "value", "value"]), st.floats(0.0, 1.0),
        st.sampled_from(WORDS),
    ),
    min_size=1,
    max_size=3,
)  # fmt: skip


def is_read_or_found_unusable(path: Path, edits: list[tuple[str, str, float, str]]) -> None:
    """Read an edited 3MF file in this process: one of its own for each file, as users have, takes 0.2 s."""
    models = dict(MODELS)
    for name, kind, share, word in edits:
        text = models[name]
        if found := list(re.finditer(SPANS[kind], text)):
            start, end = found[int(share * (len(found) - 1))].span()
            models[name] = text[:start] + {"value": word, "again": 2 * text[start:end]}.get(kind, "") + text[end:]
    with contextlib.suppress(UnusableError):
        read_3mf(saved(path, **models))


@settings(unhurried, max_examples=150)
@given(edits)
def test_an_edited_3mf_file_is_read_or_found_unusable(
    tmp_path: Path, edits: list[tuple[str, str, float, str]]
) -> None:  # fmt: skip
    is_read_or_found_unusable(tmp_path / "file.3mf", edits)


@pytest.mark.long
@settings(unhurried, max_examples=20_000)
@given(edits)
def test_many_edited_3mf_files_are_read_or_found_unusable(
    tmp_path: Path, edits: list[tuple[str, str, float, str]]
) -> None:  # fmt: skip
    is_read_or_found_unusable(tmp_path / "file.3mf", edits)


@pytest.mark.long
@pytest.mark.skipif(find_spec("cascadio") is None, reason="cascadio, of the extra cad, is not there")
@settings(unhurried, max_examples=150)
@given(st.sampled_from(["3mf", "step"]), damages, kept)
def test_many_damaged_solids_are_read_or_refused(
    tmp_path: Path, ending: str, damage: list[tuple[float, bytes]], kept: float
) -> None:
    whole = three_mf() if ending == "3mf" else (SOLIDS / "biconvex.step").read_bytes()
    is_read_or_refused(tmp_path, ending, damaged(whole, damage, kept))
