"""3MF files: objects in further parts of the package, and colours of facets."""

import warnings
import zipfile

import numpy as np
import pytest

from lfmesh.errors import MeshError
from lfmesh.geometry.files.mesh_file import load_mesh

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
MATERIAL = "http://schemas.microsoft.com/3dmanufacturing/material/2015/02"
RELATIONSHIPS = (
    '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship Id="a" '
    'Target="/3D/root.model" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
)
VERTICES = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in [(0, 0, 0), (1, 0, 0), (0, 2, 0), (0, 0, 3)])


def body(number, triangles, more=""):
    facets = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}" {rest}/>' for a, b, c, rest in triangles)
    mesh = f"<mesh><vertices>{VERTICES}</vertices><triangles>{facets}</triangles></mesh>"
    return f'<object id="{number}" {more}>{mesh}</object>'


def model(resources, items, needed=""):
    return (
        f'<model unit="millimeter" xmlns="{CORE}" xmlns:p="{PRODUCTION}" xmlns:m="{MATERIAL}" xmlns:x="urn:other" '
        f'requiredextensions="{needed}"><resources>{resources}</resources><build>{items}</build></model>'
    )


def saved(path, **parts):
    with zipfile.ZipFile(path, "w") as package:
        package.writestr("_rels/.rels", RELATIONSHIPS)
        for name, text in parts.items():
            package.writestr(f"3D/{name}.model", text)
    return path


PLAIN = [(0, 2, 1, ""), (0, 1, 3, ""), (1, 2, 3, ""), (2, 0, 3, "")]


def test_objects_in_further_parts_stand_where_the_root_puts_them(tmp_path):
    again = '<object id="7"><components><component objectid="1" p:path="/3D/other.model" transform="1 0 0 0 1 0 0 0 1 5 0 0"/></components></object>'  # noqa: E501
    items = '<item objectid="1" p:path="/3D/other.model"/><item objectid="7"/><item objectid="1"/>'
    path = saved(
        tmp_path / "a.3mf",
        root=model(again + body(1, PLAIN[:1]), items, "p"),
        other=model(body(1, PLAIN), ""),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pieces = load_mesh(path)
    assert [len(piece.mesh.faces) for piece in pieces] == [4, 4, 1]
    assert [piece.mesh.vertices[:, 0].min() for piece in pieces] == [0.0, 5.0, 0.0]


def test_an_extension_that_is_not_read_is_named(tmp_path):
    path = saved(tmp_path / "a.3mf", root=model(body(1, PLAIN), '<item objectid="1"/>', "x"))
    with pytest.raises(MeshError, match="needs the extension 'urn:other' of 3MF, which is not read"):
        load_mesh(path)
    path = saved(tmp_path / "b.3mf", root=model("", '<item objectid="1" p:path="/3D/gone.model"/>', "p"))
    with pytest.raises(MeshError, match=r"its part '3D/gone\.model' is missing"):
        load_mesh(path)


def test_damage_that_no_check_foresees_is_a_broken_file(tmp_path):
    with_large_number = saved(tmp_path / "a.3mf", root=model(body(1, [(0, 10**30, 1, "")]), '<item objectid="1"/>'))
    with pytest.raises(MeshError, match="broken, or not a 3MF file"):
        load_mesh(with_large_number)


def test_colours_of_facets_are_linear_light(tmp_path):
    groups = (
        '<basematerials id="8"><base name="a" displaycolor="#FF0000"/><base name="b" displaycolor="#808080FF"/>'
        '</basematerials><m:colorgroup id="9"><m:color color="#000000"/><m:color color="#FFFFFF"/></m:colorgroup>'
    )
    triangles = [
        (0, 2, 1, ""),
        (0, 1, 3, 'p1="0"'),
        (1, 2, 3, 'pid="9" p1="0" p2="1" p3="0"'),
        (2, 0, 3, 'pid="77" p1="0"'),
    ]
    path = saved(
        tmp_path / "a.3mf", root=model(groups + body(1, triangles, 'pid="8" pindex="1"'), '<item objectid="1"/>', "m")
    )
    (piece,) = load_mesh(path)
    grey = ((128 / 255 + 0.055) / 1.055) ** 2.4
    truth = [[[grey] * 3] * 3, [[1.0, 0.0, 0.0]] * 3, [[0.0] * 3, [1.0] * 3, [0.0] * 3], [[1.0] * 3] * 3]
    np.testing.assert_allclose(piece.colours, truth, rtol=1e-6)
