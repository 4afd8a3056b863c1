"""Surfaces that lens files move off the axis: where they stand, by a walk of frames that is written here."""

from pathlib import Path

import numpy as np
import pytest

from lfmesh.errors import SceneError
from lfmesh.geometry.lens.element_poses import pose_of
from lfmesh.imports import codev, zemax
from lfmesh.imports.decentres import START, Move

SAME_MM = 1e-11

TRIPLET_ZMX = """\
MODE SEQ
UNIT {unit}
ENPD 2
SURF 0
  TYPE STANDARD
  DISZ INFINITY
SURF 1
  STOP
  TYPE STANDARD
  CURV 0.02
  DISZ 4
  GLAS ___BLANK 1 0 1.5 0
  DIAM 8 1
SURF 2
  TYPE STANDARD
  CURV -0.02
  DISZ 5
  DIAM 8 1
SURF 3
  TYPE COORDBRK
  DISZ {pivot}
{breaks}SURF 4
  TYPE STANDARD
  CURV -0.01
  DISZ 2
  GLAS ___BLANK 1 0 1.7 0
  DIAM 4 1
SURF 5
  TYPE STANDARD
  CURV 0.01
  DISZ {back}
  DIAM 4 1
SURF 6
  TYPE COORDBRK
  DISZ 12
{returns}SURF 7
  TYPE STANDARD
  CURV 0.01
  DISZ 3
  GLAS ___BLANK 1 0 1.6 0
  DIAM 4 1
SURF 8
  TYPE STANDARD
  CURV 0.0
  DISZ 62
  DIAM 4 1
SURF 9
  TYPE STANDARD
  DISZ 0
"""

TRIPLET_SEQ = """\
RDM
EPD 2
DIM M
WL 587.6
SO 0 0.1e14
S 50 4 500000.5000
  STO
S -50 5
S -100 2 700000.5000
{first}  CIR 4
S 100 10
{second}  CIR 4
SI 0 0
"""


def about(axis, degrees):
    """Return the right-handed rotation of two coordinates, (3, 3)."""
    a, (i, j) = np.deg2rad(degrees), ((1, 2), (2, 0), (0, 1))[axis]
    turn = np.eye(3)
    turn[i, i] = turn[j, j] = np.cos(a)
    turn[i, j], turn[j, i] = -np.sin(a), np.sin(a)
    return turn


def parameters(x, y, tilt, order):
    return "".join(f"  PARM {k} {value!r}\n" for k, value in enumerate((x, y, *tilt, order), 1))


def standing(lens, number):
    """Return vertex and axes of a surface where its pose puts it."""
    pose = pose_of(lens, number)
    return pose[:, :3] @ [0.0, 0.0, lens.vertices_mm[number]] + pose[:, 3], pose[:, :3]


@pytest.mark.parametrize(("unit", "mm"), [("MM", 1.0), ("IN", 25.4)])
@pytest.mark.parametrize("pivot", [0.0, 1.5])
@pytest.mark.parametrize("order", [0, 1])
def test_groups_between_coordinate_breaks_stand_where_zemax_has_them(unit, mm, pivot, order):
    x, y, tilt = 0.3, -0.2, (4.0, -3.0, 7.0)
    # The way back undoes the way there, from the pivot: the other order, and the other signs.
    text = TRIPLET_ZMX.format(
        unit=unit, pivot=pivot, back=-2 - pivot,
        breaks=parameters(x, y, tilt, order), returns=parameters(-x, -y, [-t for t in tilt], 1 - order),
    )  # fmt: skip
    lens, report = zemax.read(Path("lens.zmx"), text.splitlines())
    turns = [about(axis, angle) for axis, angle in enumerate(tilt)]
    turn = turns[0] @ turns[1] @ turns[2] if order == 0 else turns[2] @ turns[1] @ turns[0]
    shift = np.array([x, y, 0.0]) if order == 0 else turn @ [x, y, 0.0]
    vertex = np.array([0.0, 0.0, 9.0]) + shift + turn @ [0.0, 0.0, pivot]
    for number, at in ((2, vertex), (3, vertex + turn @ [0.0, 0.0, 2.0])):
        found, axes = standing(lens, number)
        np.testing.assert_allclose(found, mm * at, atol=SAME_MM)
        np.testing.assert_allclose(axes, turn, atol=1e-13)
    for number, z in ((1, 4.0), (4, 21.0), (5, 24.0)):
        found, axes = standing(lens, number)
        np.testing.assert_allclose(found, [0.0, 0.0, mm * z], atol=SAME_MM)
        np.testing.assert_array_equal(axes, np.eye(3))
    assert [element.surfaces for element in lens.elements] == [(2, 3)]
    assert any(note.startswith(f"image: {62.0 * mm:.10g} mm behind") for note in report.notes)


def test_an_axis_that_is_not_turned_back_is_refused():
    text = TRIPLET_ZMX.format(unit="MM", pivot=0, back=-2, breaks=parameters(0.0, 0.0, (4.0, 0.0, 0.0), 0), returns="")
    with pytest.raises(SceneError, match=r"the axis is not restored: the image lies .* tilted by 4 degrees"):
        zemax.read(Path("lens.zmx"), text.splitlines())


def test_a_break_inside_glass_is_no_interface():
    whole = TRIPLET_ZMX.format(unit="MM", pivot=0, back=-2, breaks="", returns="")
    parted = whole.replace("  DISZ 4\n", "  DISZ 1.5\n").replace(
        "SURF 2\n", "SURF 9\n  TYPE COORDBRK\n  DISZ 2.5\nSURF 2\n", 1
    )
    assert zemax.read(Path("a.zmx"), parted.splitlines())[0] == zemax.read(Path("a.zmx"), whole.splitlines())[0]


def test_surfaces_that_return_stand_where_code_v_has_them():
    """Each of two surfaces by itself: turns about x and y are left-handed there, about z right-handed."""
    text = TRIPLET_SEQ.format(
        first="  XDE 0.1; YDE 0.2; ZDE 0.3\n  ADE 3; BDE -2; CDE 5\n  DAR\n", second="  YDE -0.1\n  ADE 1\n  DAR\n"
    )
    lens, _ = codev.read(Path("lens.seq"), text.splitlines())
    for number, at, turn in (
        (2, [0.1, 0.2, 9.3], about(0, -3.0) @ about(1, 2.0) @ about(2, 5.0)),
        (3, [0.0, -0.1, 11.0], about(0, -1.0)),
    ):
        found, axes = standing(lens, number)
        np.testing.assert_allclose(found, at, atol=SAME_MM)
        np.testing.assert_allclose(axes, turn, atol=1e-13)


MOVED = "  XDE 0.1; YDE 0.2; ZDE 0.3\n  ADE 3; BDE -2; CDE 5\n"


@pytest.mark.parametrize(
    "back",
    [
        # From the pivot, by the same decentres reversed; and from the second surface, 5 mm before the group.
        f"S 100 -2\n  CIR 4\nS 0 12\n{MOVED}  REV\n",
        "S 100 0\n  CIR 4\nS 0 17\n  RET S2\n",
        "S 100 0\n  CIR 4\nS 0 17\n RET S5 S2\n",
    ],
    ids=["REV", "RET", "RET of a named surface"],
)
def test_an_axis_of_code_v_comes_back_by_reversed_decentres_or_to_an_earlier_surface(back):
    text = TRIPLET_SEQ.format(first=MOVED, second="").replace("S 100 10\n  CIR 4\n", back)
    text = text.replace("SI 0 0\n", "S 80 3 500000.5000\nS 0 20\nSI 0 0\n")
    lens, report = codev.read(Path("lens.seq"), text.splitlines())
    turn = about(0, -3.0) @ about(1, 2.0) @ about(2, 5.0)
    front = np.array([0.1, 0.2, 9.3])
    for number, at, axes in (
        (2, front, turn),
        (3, front + turn @ [0.0, 0.0, 2.0], turn),
        (4, [0.0, 0.0, 21.0], np.eye(3)),
        (5, [0.0, 0.0, 24.0], np.eye(3)),
    ):
        found, turned = standing(lens, number)
        np.testing.assert_allclose(found, at, atol=SAME_MM)
        np.testing.assert_allclose(turned, axes, atol=1e-13)
    assert [element.surfaces for element in lens.elements] == [(2, 3)]
    assert any(note.startswith("image: 20 mm behind") for note in report.notes)


def test_decentres_that_no_lens_here_has_are_refused():
    tilted = TRIPLET_SEQ.format(first="  ADE 3\n", second="")
    with pytest.raises(SceneError, match="the axis is not restored"):
        codev.read(Path("lens.seq"), tilted.splitlines())
    with pytest.raises(SceneError, match="the axis is not restored"):
        codev.read(Path("lens.seq"), tilted.replace("ADE 3\n", "ADE 3\n  REV\n").splitlines())
    for lines, why in (
        ("  DAR\n  REV\n", r"line \d+: REV: a surface may have only one DAR or REV"),
        ("  BEN\n", r"line \d+: BEN: an axis that bends at a mirror is not supported"),
        ("  RET S1\n", "RET with decentres of its own is not supported"),
        ("  RET S9\n", r"line \d+: RET S9"),
        ("  RET\n", r"line \d+: RET: it is cut short"),
        ("  RET SO\n", "it must name a surface between the object and this one"),
    ):
        with pytest.raises(SceneError, match=why):
            codev.read(Path("lens.seq"), tilted.replace("ADE 3\n", f"ADE 3\n{lines}").splitlines())
    with pytest.raises(SceneError, match=r"returns to another one's place must be empty"):
        codev.read(Path("lens.seq"), TRIPLET_SEQ.format(first="  RET S2\n", second="").splitlines())


def test_tilts_turn_as_a_published_listing_of_zemax_shows():
    """A chain of equal prisms, tilted about x one by one ("How to Work in Global Coordinates", Zemax KB 194, page 4).

    Relative to the first surface, the target prism stands at y = -162.03, z = 191.384 and is tilted by +83.007 degrees:
    a chain that turns evenly runs along half its last turn, so that this turn leads from +z towards -y, right-handed.
    """
    steps, turn = 5, 83.007
    place = START
    for _ in range(steps):
        place = place.moved(Move.shifted_then_tilted((0.0, 0.0, 0.0), (turn / steps, 0.0, 0.0))).along(50.0)
    x, y, z = place.vertex
    published = np.degrees(np.arctan2(-162.03, 191.384))
    assert x == 0.0
    # The prisms' own depths and angles are not published; half a step is what they may change.
    assert np.degrees(np.arctan2(y, z)) == pytest.approx(published, abs=turn / steps)
    np.testing.assert_allclose(place.turn.apply([0.0, 0.0, 1.0])[1], -np.sin(np.radians(turn)), rtol=1e-12)
