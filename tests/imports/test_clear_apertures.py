"""Clear apertures of lens files where their surfaces leave no room for them."""

import math
from pathlib import Path

import pytest

from lfmesh.errors import SceneError
from lfmesh.imports.codev import read as read_codev
from lfmesh.imports.report import Verdict
from lfmesh.imports.zemax import read
from lfmesh.optics.glass import D_LINE_NM
from lfmesh.scene import Paraxial
from tests.imports.files import SINGLET_SEQ, SINGLET_ZMX

FILE = Path("lens.zmx")


def changed(*pairs):
    text = SINGLET_ZMX
    for old, new in pairs:
        assert text.count(old) == 1
        text = text.replace(old, new)
    return text


def refusal_of(text):
    with pytest.raises(SceneError) as error:
        read(FILE, text.splitlines())
    return str(error.value)


@pytest.mark.parametrize("kind", ["DIAM {} 1 0 0 1", "CLAP 0 {} 0", "FLAP 0 {} 0"])
@pytest.mark.parametrize("conic", [0.0, 0.5])
def test_a_clear_aperture_ends_where_its_surface_ends(kind, conic):
    edge = 15.898 / math.sqrt(1.0 + conic)
    text = changed(
        ("CURV -0.0125", f"CURV {-1 / 15.898!r}"),
        ("  CONI -0.5\n", f"  CONI {conic}\n"),
        ("  DIAM 6.5 1 0 0 1\n  CLAP 0 6.25 0\n", f"  {kind.format(16.2)}\n"),
        ("  PARM 2 1e-6\n", ""),
        ("  PARM 3 -2e-9\n", ""),
        ("  DISZ 5\n", "  DISZ 25\n"),
    )
    lens, report = read(FILE, text.splitlines())
    assert lens.surfaces[1].semi_diameter_mm == pytest.approx(edge, rel=1e-12)
    (line,) = report.of(Verdict.APPROXIMATED)
    assert line.how == f"semi-diameter 16.2 mm: reduced to {edge:.6g} mm, where the surface ends"


def test_a_surface_that_ends_inside_the_beam_is_refused():
    """Radii that are read as curvatures end near the axis, and a wrong number of a CURV line does."""
    said = refusal_of(changed(("CURV -0.0125", "CURV -2.0"), ("  CONI -0.5\n", "")))
    assert "line 31: SURF 2: the surface ends 0.5 mm from the axis, within the beam of " in said
    curvatures = SINGLET_SEQ.replace("RDM;", "").replace("  ASP\n  K -0.5; A 1e-6; B -2e-9\n", "")
    with pytest.raises(SceneError, match="if they are radii, put RDM before them"):
        read_codev(Path("lens.seq"), curvatures.splitlines())


@pytest.mark.parametrize("pupil", ["ENPD 10", "FLOA"])
@pytest.mark.parametrize("breaks", ["", "SURF 2\n  TYPE COORDBRK\n  DISZ 0\n"])
def test_a_stop_plane_in_the_vertex_of_a_surface_that_bulges_through_it_is_that_surface(pupil, breaks):
    """The same lens with its stop on the surface; at the vertex the beam has the same width on both."""
    plane = "SURF 1\n  STOP\n  TYPE STANDARD\n  DISZ 0\n  DIAM 5.0 0 0 0 1\n" + breaks + "SURF 3\n  TYPE STANDARD\n"
    text = changed(
        ("ENPD 10", pupil),
        ("SURF 1\n  STOP\n  TYPE STANDARD\n", plane),
        ("CURV 0.02 0", "CURV -0.02 0"),
    )
    lens, report = read(FILE, text.splitlines())
    on_it, _ = read(FILE, changed(("CURV 0.02 0", "CURV -0.02 0"), ("DIAM 5.2", "DIAM 5.0")).splitlines())
    assert lens.surfaces == on_it.surfaces
    assert lens.surfaces[0].stop
    assert lens.surfaces[0].semi_diameter_mm == pytest.approx(5.0, rel=1e-12)
    assert Paraxial.of(lens, D_LINE_NM).efl_mm == Paraxial.of(on_it, D_LINE_NM).efl_mm
    said = [line.how for line in report.of(Verdict.APPROXIMATED)]
    assert said == [
        f"this plane lies at the vertex of surface {3 if breaks else 2}, which bulges through it and becomes the stop"
    ]


def test_a_stop_plane_behind_the_vertex_of_a_surface_that_bulges_through_it_is_that_surface():
    behind = "  DISZ 0\n  DIAM 6.5 1 0 0 1\nSURF 3\n  STOP\n  TYPE STANDARD\n  DISZ 50\n  DIAM 4.0 0 0 0 1\n"
    text = changed(
        ("  STOP\n", ""),
        ("ENPD 10", "FLOA"),
        ("CURV -0.0125", "CURV 0.0125"),
        ("  DISZ 50\n  DIAM 6.5 1 0 0 1\n  CLAP 0 6.25 0\n", behind),
    )
    lens, _ = read(FILE, text.splitlines())
    assert [surface.stop for surface in lens.surfaces] == [False, True]
    assert lens.surfaces[1].semi_diameter_mm == 4.0


def test_surfaces_that_meet_at_the_axis_are_refused_with_their_lines():
    said = refusal_of(changed(("  DISZ 5\n", "  DISZ 0\n"), ("  CLAP 0 6.25 0\n", "")))
    assert said == ("lens.zmx: line 24: SURF 1: it crosses the next surface, line 31, off the axis; 0 mm apart")
