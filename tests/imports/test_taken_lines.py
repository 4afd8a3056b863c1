"""Lines that a reader calls taken: another value in one of them makes another lens, or another word about it."""

import json
import math
from copy import deepcopy
from pathlib import Path

import pytest

from lfmesh.errors import SceneError
from lfmesh.imports import codev, lens_table, optiland_json, oslo, zemax
from lfmesh.imports.report import Verdict
from lfmesh.scene.camera.lens import FileChoices
from tests.imports.files import GRADIENTS_ZMX, PHASES_SEQ, PHASES_ZMX, SINGLET_SEQ, SINGLET_ZMX
from tests.imports.test_optiland_json import LENS as OPTILAND

ZMX = (
    SINGLET_ZMX.replace("  TYPE EVENASPH\n", "  TYPE EVENASPH\n  COAT I.95\n")
    .replace("SURF 3\n", "SURF 3\n  TYPE COORDBRK\n  PARM 3 2\n  PARM 2 0.1\n  DISZ 3\nSURF 3\n  TYPE BICONICX\n"
             "  PARM 1 60\n  PARM 2 -0.4\n  CURV 0.01\n  DISZ 2\n  GLAS ___BLANK 1 0 1.6 40\n  DIAM 6\nSURF 3\n"
             "  TYPE XASPHERE\n  XDAT 1 2\n  XDAT 2 5\n  XDAT 4 0.001\n  XDAT 5 5e-4\n"
             "  CURV 0.002\n  DISZ -5\n  DIAM 5\nSURF 3\n"
             "  TYPE COORDBRK\n  PARM 3 -2\n  PARM 2 -0.1\n  PARM 6 1\n  DISZ 40\nSURF 3\n")
)  # fmt: skip
SEQ = (
    SINGLET_SEQ.replace("NBK7_SCHOTT", "'G0'")
    .replace(" ! C, d, F", "")
    .replace("S -80.0 &\n  50.0", "S -80.0 50.0")
    .replace("  ASP\n  K -0.5; A 1e-6; B -2e-9\n", "  K -0.5\n  A 1e-6\n  B -2e-9\n")
    .replace("SO 0.0 0.1e14", "PRV\nPWL 400 800\n'G0' 1.53 1.51\nEND\nSO 0.0 300.0")
)

LEN = """\
LEN NEW "two lenses" 50 7
EBR 4.0
ANG 5.0
UNI 1.0
WV 0.58756 0.48613 0.65627
WV2 0.5
TH 1e20
NXT
GLA N-BK7
RD 20.0
TH 2.0
AP CHK 6.0
CC -0.5
ASP ASR
AD 1e-6
AS3 -2e-9
NXT
AIR
CVF -0.03
TH 3.0
NXT
GLA MOD G1 1.62 1.63 1.615
TH 2.0
AST
NXT
AIR
RD 60.0
TH 3.0
DT -1
DCX 0.1
DCY 0.2
TLA 1.5
TLC 2.5
RCO
NXT
GLA 1.5
CV 0.01
TH 2.0
NXT
AIR
RD -50
TH 30
NXT
AIR
GTO 5
TOZ 2.5
TLB 1.0
RCO
GTO 7
TH 1.5
END 7
RST NEW
F 1 0 0 0 0 0 -.9 .8 -1 1 1
F 2 1 .5 0 0 0 -1 1 -1 1 1
END
"""
CSV = """\
radius thickness n v sd conic A4
inf inf 1 0 5 0 0
50.0 4.0 1.5168 64.2 8.0 -0.5 1e-6
-80.0 3.0 1.0 0 7.5 0.2 -1e-6
inf 2.0 1.0 0 5.0 0 0
60.0 3.0 1.62 36.4 7.0 0.1 2e-6
-70.0 45.0 1.0 0 7.0 0.3 0
""".replace(" ", "\t")

WITHOUT_VALUES = {"RDM", "LEN", "PRV", "END", "STOP", "STO", "NXT", "AIR", "AST", "RCO", "ASP"}
"""Commands that are there or not; leaving one out may change nothing in these files."""


def outcome(read, lines):
    """Return all that a reader says and makes; of a refusal, that it is one."""
    try:
        lens, report = read(Path("lens"), lines)
    except SceneError:
        return "refused"
    said = [line.how for line in report.lines if line.verdict is Verdict.APPROXIMATED]
    return lens, report.conditions, report.notes, said


def others(line):
    """Yield the line with another value in place of each of its words."""
    words = line.split()
    for place in range(1, len(words)):
        try:
            value = float(words[place])
            new = repr(1.01 * value + 0.0013) if value % 1.0 else str(int(value) + 1)
        except (ValueError, OverflowError):
            new = f"{words[place]}X"
        indent = line[: len(line) - len(line.lstrip())]
        yield indent + ("\t" if "\t" in line else " ").join([*words[:place], new, *words[place + 1 :]])


OPERANDS = """\
MNUM 2 1
THIC 1 1 4.0 0 0 0 1 1 1 0 0
THIC 1 2 5.0 0 0 0 1 1 1 0 0
CRVT 2 1 -0.0125 0 0 0 1 1 1 0 0
CRVT 2 2 -0.02 0 0 0 1 1 1 0 0
CONN 1 1 0.0 0 0 0 1 1 1 0 0
CONN 1 2 -0.7 0 0 0 1 1 1 0 0
APER 0 1 10.0 0 0 0 1 1 1 0 0
APER 0 2 8.0 0 0 0 1 1 1 0 0
YFIE 2 1 7.0 0 0 0 1 1 1 0 0
YFIE 2 2 5.0 0 0 0 1 1 1 0 0
WAVE 1 1 0.4861327 0 0 0 1 1 1 0 0
WAVE 1 2 0.5 0 0 0 1 1 1 0 0
"""
ZOOM = """\
ZOO 2
ZOO THI S1 5.0 6.5
ZOO EPD 10.0 8.5
ZOO YAN F2 7.0 5.5
YAN F1 Z2 0.5
WL W3 Z2 500.5
ZOO K S1 -0.5 -0.7
"""
SECOND = FileChoices(configuration=2)


def read_second(reader):
    """Return a reader of the second configuration."""
    return lambda path, lines: reader(path, lines, SECOND)


READERS = {"zmx": (zemax.read, ZMX), "seq": (codev.read, SEQ), "len": (oslo.read, LEN), "csv": (lens_table.read, CSV)}
READERS |= {
    "zmx phases": (zemax.read, PHASES_ZMX),
    "zmx gradients": (zemax.read, GRADIENTS_ZMX),
    "seq phases": (codev.read, PHASES_SEQ),
    "zmx 2": (read_second(zemax.read), OPERANDS.join(SINGLET_ZMX.split("MNUM 1 1\n"))),
    "seq 2": (read_second(codev.read), SEQ.replace("GO\n", ZOOM + "GO\n")),
}


@pytest.mark.parametrize("name", READERS)
def test_what_is_taken_is_used(name):
    read, text = READERS[name]
    lines = text.splitlines()
    whole = outcome(read, lines)
    assert whole != "refused"
    report = read(Path("lens"), lines)[1]
    # A line that is approximated is taken in its other parts.
    taken = sorted({line.number for verdict in (Verdict.TAKEN, Verdict.APPROXIMATED) for line in report.of(verdict)})
    assert len(taken) > 4
    unused = []
    for number in taken:
        line, before, after = lines[number - 1], lines[: number - 1], lines[number:]
        if name.endswith("2") and line.split()[0] in ("EPD", "ENPD", "YAN"):
            continue  # Another configuration has values of its own.
        changed = any(outcome(read, [*before, other, *after]) != whole for other in others(line))
        if not changed and outcome(read, before + after) == whole and line.split()[0] not in WITHOUT_VALUES:
            unused.append(line)
    assert unused == []


def leaves(entry, path=()):
    """Yield the paths of the numbers, words and flags in a file of JSON."""
    if isinstance(entry, dict | list):
        for key, value in entry.items() if isinstance(entry, dict) else enumerate(entry):
            yield from leaves(value, (*path, key))
    elif entry is not None:
        yield path


def test_every_value_of_an_optiland_file_is_used_or_known_to_be_without_effect():
    def outcome_with(path, change):
        data = deepcopy(OPTILAND)
        *inner, last = path
        entry = data
        for key in inner:
            entry = entry[key]
        entry[last] = change(entry[last])
        return outcome(optiland_json.read, json.dumps(data).splitlines())

    def other(value):
        if isinstance(value, bool):
            return not value
        return f"{value}X" if isinstance(value, str) else 1.01 * value + 0.0013 if math.isfinite(value) else 3.0

    whole = outcome_with(("name",), lambda name: name)
    paths = [path for path in leaves(OPTILAND) if path[1:3] != ("surfaces", 6)]
    unused = {path[-1] for path in paths if outcome_with(path, other) == whole}
    # A surface's own type says no more than its geometry; vx squeezes beams across, where apertures are round.
    assert unused == {"version", "comment", "tol", "filename", "vx", "type"}
    assert (
        outcome_with(("surface_group", "surfaces", 4, "material_post", "type"), lambda _: "AbbeMaterialE") == "refused"
    )


@pytest.mark.parametrize(("number", "name"), [("0", "object"), ("3", "image")])
def test_a_curved_object_or_image_is_said(number, name):
    head, tail = SINGLET_ZMX.split(f"SURF {number}\n")
    _, report = zemax.read(
        Path("lens.zmx"), f"{head}SURF {number}\n{tail.replace('CURV 0.0', 'CURV 0.01', 1)}".splitlines()
    )
    said = [line.how for line in report.of(Verdict.APPROXIMATED)]
    assert said == [f"the {name} is curved in the file; here it is flat"]
