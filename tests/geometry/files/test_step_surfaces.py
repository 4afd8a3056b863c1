"""The entities of a STEP file: what is read of them, and that broken or hostile ones are left out and cost nothing."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from lfmesh.errors import MeshError
from lfmesh.geometry.files import step_surfaces
from lfmesh.geometry.files.mesh_file import load_mesh
from lfmesh.geometry.files.step_surfaces import surfaces_of
from lfmesh.geometry.files.swept import curve_in_box, net_in_box
from tests.peak_memory import PRINT_PEAK, SAYS_PEAK
from tests.processor_time import processor_seconds

SOLIDS = Path(__file__).resolve().parents[3] / "tests" / "solids"
RUN_FILE = """
import runpy, sys

sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
"""
"""Runs a file with its arguments, as the command line would."""
IDENTITY = np.hstack([np.eye(3), np.zeros((3, 1))])
UNIT = (
    "#1=(GEOMETRIC_REPRESENTATION_CONTEXT(3) GLOBAL_UNIT_ASSIGNED_CONTEXT((#2)) REPRESENTATION_CONTEXT('',''));\n"
    "#2=(LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.));\n"
    "#3=CARTESIAN_POINT('',(0.,0.,5.));#4=DIRECTION('',(0.,0.,1.));#5=DIRECTION('',(1.,0.,0.));\n"
    "#6=AXIS2_PLACEMENT_3D('',#3,#4,#5);#7=AXIS1_PLACEMENT('',#3,#4);\n"
)
POINTS = "#10=CARTESIAN_POINT('',(0.,0.,0.));#11=CARTESIAN_POINT('',(4.,0.,0.));#12=CARTESIAN_POINT('',(8.,0.,1.));\n"
TURNED = "#20=SURFACE_OF_REVOLUTION('',#21,#7);\n"
SPLINE = "#21=B_SPLINE_CURVE_WITH_KNOTS('',2,(#10,#11,#12),.UNSPECIFIED.,.F.,.F.,(3,3),(0.,1.),.UNSPECIFIED.);\n"


def kinds(entities):
    return [each["kind"] for each in surfaces_of(UNIT + entities)]


def test_each_surface_is_read_with_its_sizes_in_mm():
    text = (
        "#30=PLANE('a;b''c',#6);#31=SPHERICAL_SURFACE('',#6,3.);/* #32=PLANE('',#6); */"
        "#33=CYLINDRICAL_SURFACE('',#6,4.);#34=TOROIDAL_SURFACE('',#6,9.,2.);"
    )
    plane, sphere, cylinder, torus = surfaces_of(UNIT.replace(".MILLI.", ".CENTI.") + text)
    assert plane == {"kind": "plane", "at": [0.0, 0.0, 50.0], "axis": [0.0, 0.0, 1.0]}
    assert (sphere["radius"], cylinder["radius"], torus["radius"], torus["tube"]) == (30.0, 40.0, 90.0, 20.0)


@pytest.mark.parametrize(
    "entities",
    [
        "#20=SURFACE_OF_REVOLUTION('',#20,#7);",
        "#20=SURFACE_OF_REVOLUTION('',#21,#7);#21=TRIMMED_CURVE('',#22);#22=TRIMMED_CURVE('',#21);",
        TURNED + POINTS + SPLINE.replace("(3,3)", "(3,1000000000)"),
        TURNED + POINTS + SPLINE.replace("(3,3)", "(2,3)"),
        TURNED + POINTS + SPLINE.replace("(0.,1.)", "(1.,0.)"),
        TURNED + POINTS + SPLINE.replace("(0.,1.)", "(1.,1.)"),
        TURNED + POINTS + SPLINE.replace("'',2", "'',99999999"),
        TURNED + POINTS + SPLINE.replace("#12)", "#99)"),
        TURNED + POINTS.replace("4.", "NAN") + SPLINE,
        TURNED + POINTS.replace("4.", "1E999") + SPLINE,
        TURNED + POINTS.replace("(4.,0.,0.)", "(4.,0.)") + SPLINE,
        "#30=SPHERICAL_SURFACE('',#6,0.);",
        "#30=SPHERICAL_SURFACE('',#6,-3.);",
        "#30=SPHERICAL_SURFACE('',#6,INF);",
        "#30=SPHERICAL_SURFACE('',#6);",
        "#30=CYLINDRICAL_SURFACE('',#5,3.);",
        "#30=PLANE('',#6;",
        "#30=PLANE" + "(" * 100_000 + ";",
        "#30=TOROIDAL_SURFACE('',#99999999999999999999,3.,1.);",
        "#30=(B_SPLINE_SURFACE(1,1,((#10),(#10,#11)),.U.,.F.,.F.,.F.) "
        "B_SPLINE_SURFACE_WITH_KNOTS((2),(2),(0.),(0.),.U.));",
    ],
)
def test_what_is_not_as_the_standard_has_it_is_left_out(entities):
    assert kinds(entities) == []
    assert kinds(entities + "#40=PLANE('',#6);") == ["plane"]


def test_a_file_of_several_units_or_of_none_tells_nothing():
    plane = "#40=PLANE('',#6);"
    other = "#8=(GLOBAL_UNIT_ASSIGNED_CONTEXT((#9)) X());#9=(LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT($,.METRE.));"
    assert surfaces_of(UNIT + other + plane) == []
    assert surfaces_of(UNIT.replace("LENGTH_UNIT", "MASS_UNIT") + plane) == []
    loop = (
        "(CONVERSION_BASED_UNIT('A',#50) LENGTH_UNIT() NAMED_UNIT(*));"
        "#50=LENGTH_MEASURE_WITH_UNIT(LENGTH_MEASURE(2.),#2);"
    )
    assert surfaces_of(UNIT.replace("(LENGTH_UNIT() NAMED_UNIT(*) SI_UNIT(.MILLI.,.METRE.));", loop) + plane) == []


def test_a_rational_curve_and_net_are_on_their_circle_and_sphere():
    """Standard rational arcs: a quarter circle with weights 1, √½, 1."""
    w = float(np.sqrt(0.5))
    text = (
        UNIT
        + POINTS.replace("(0.,0.,0.)", "(3.,0.,0.)")
        .replace("(4.,0.,0.)", "(3.,0.,3.)")
        .replace("(8.,0.,1.)", "(0.,0.,3.)")
        + "#20=SURFACE_OF_REVOLUTION('',#21,#7);#21=(BOUNDED_CURVE() "
        "B_SPLINE_CURVE(2,(#10,#11,#12),.UNSPECIFIED.,.F.,.F.) "
        "B_SPLINE_CURVE_WITH_KNOTS((3,3),(0.,1.),.UNSPECIFIED.) CURVE() "
        f"RATIONAL_B_SPLINE_CURVE((1.,{w!r},1.)));"
    )
    (turned,) = surfaces_of(text)
    found = curve_in_box(turned["curve"], IDENTITY, lambda p: np.maximum(p[:, 0] - 1.0, 0.0))
    assert len(found) >= 129
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 3.0, rtol=1e-14)
    arc = [([3, 0, 0], 1.0), ([3, 0, 3], w), ([0, 0, 3], 1.0)]
    turn = [([1, 0], 1.0), ([1, 1], w), ([0, 1], 1.0)]
    points = [[[x * c, x * s, z] for (c, s), _ in turn] for (x, _, z), _ in arc]
    net = {
        "points": points, "weights": [[a * b for _, b in turn] for _, a in arc], "degrees": [2, 2],
        "knots": [[0, 0, 0, 1, 1, 1]] * 2,
    }  # fmt: skip
    found = net_in_box(net, IDENTITY, lambda p: np.maximum(np.hypot(p[:, 0], p[:, 1]) - 0.1, 0.0))
    assert len(found) >= 129
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 3.0, rtol=1e-14)


def test_a_small_part_of_a_huge_circle_and_of_a_line_is_found():
    circle = {"kind": "circle", "at": [0.0, 0.0, 1e6], "x": [1.0, 0.0, 0.0], "y": [0.0, 0.0, 1.0], "a": 1e6, "b": 1e6}
    found = curve_in_box(circle, IDENTITY, lambda p: np.maximum(np.abs(p).max(axis=1) - 5.0, 0.0))
    assert len(found) >= 129
    np.testing.assert_allclose(found[:, 2], found[:, 0] ** 2 / 2e6, atol=1e-9)
    line = {"kind": "line", "at": [1e5, 0.0, 2.0], "x": [1.0, 0.0, 0.0]}
    found = curve_in_box(line, IDENTITY, lambda p: np.maximum(np.abs(p).max(axis=1) - 5.0, 0.0))
    assert len(found) >= 129
    nothing = curve_in_box(circle, IDENTITY, lambda p: np.full(len(p), 1e9))
    assert nothing.shape == (0, 3)


def hostile(folder):
    """Yield STEP files that a kernel wrote, each with one thing spoilt."""
    text = (SOLIDS / "rational.step").read_text()
    number = text[: text.index("= SURFACE_OF_REVOLUTION")].rsplit("#", 1)[1].strip()
    curve = text.split("SURFACE_OF_REVOLUTION('',", 1)[1].split(",")[0]
    for name, old, new in (
        ("ring", f"SURFACE_OF_REVOLUTION('',{curve},", f"SURFACE_OF_REVOLUTION('',#{number},"),
        ("nan", "CARTESIAN_POINT('',(8.,0.,", "CARTESIAN_POINT('',(NAN,0.,"),
        ("huge", "CARTESIAN_POINT('',(8.,0.,", "CARTESIAN_POINT('',(8.E300,0.,"),
        ("zero", "CYLINDRICAL_SURFACE('',#", "SPHERICAL_SURFACE('',#"),
        ("knots", "(3,3),(0.,1.)", "(3,300000000),(0.,1.)"),
    ):
        spoilt = text.replace(old, new)
        if spoilt != text:
            (folder / f"{name}.step").write_text(spoilt)
            yield folder / f"{name}.step"
    sphere = (SOLIDS / "biconvex.step").read_text()
    (folder / "radius.step").write_text(sphere.replace("SPHERICAL_SURFACE('',#32,30.)", "SPHERICAL_SURFACE('',#32,0.)"))
    yield folder / "radius.step"
    points = "".join(f"#{1000 + k}=CARTESIAN_POINT('',({k}.,0.,{k % 7}.));\n" for k in range(30_000))
    names = ",".join(f"#{1000 + k}" for k in range(30_000))
    spline = f"#900001=B_SPLINE_CURVE_WITH_KNOTS('',3,({names}),.U.,.F.,.F.,(4,{'1,' * 29_996}4),("
    spline += ",".join(map(str, range(29_998))) + "),.U.);\n#900002=SURFACE_OF_REVOLUTION('',#900001,#7);\n"
    at = sphere.index("ENDSEC;", sphere.index("DATA;"))
    (folder / "spline.step").write_text(sphere[:at] + points + spline + sphere[at:])
    yield folder / "spline.step"


def refusal(path):
    """The message of a file that is refused; None of one that is read."""
    try:
        load_mesh(path, tolerance_mm=0.2)
    except MeshError as error:
        return str(error)
    return None


@pytest.mark.skipif(find_spec("cascadio") is None, reason="cascadio, of the extra cad, is not there")
def test_a_hostile_file_is_read_or_refused_in_one_line_within_half_a_minute_of_processor_time(tmp_path):
    program = RUN_FILE + (PRINT_PEAK if SAYS_PEAK else "")
    for path in hostile(tmp_path):
        begun = processor_seconds()
        refused = refusal(path)
        assert refused is None or (refused.startswith(str(path)) and "\n" not in refused), path.name
        out = tmp_path / "out.json"
        # It ends by its own limits.
        child = subprocess.run(
            [sys.executable, "-P", "-c", program, step_surfaces.__file__, str(path), str(out), "1536", "128", "25"],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert child.returncode == 0, (path.name, child.stderr)
        assert isinstance(json.loads(out.read_text()), list)
        assert processor_seconds() - begun < 30.0, path.name
        if SAYS_PEAK:
            assert int(child.stdout) < 2 * 2**20, path.name
