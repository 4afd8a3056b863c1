"""Lines that a reader calls taken: another value in one of them makes another lens, or another word about it."""

from pathlib import Path

import pytest

from lfmesh.errors import SceneError
from lfmesh.imports import codev, zemax
from lfmesh.imports.report import Verdict
from tests.imports.files import SINGLET_SEQ, SINGLET_ZMX

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

WITHOUT_VALUES = {"RDM", "LEN", "PRV", "END", "STOP", "STO"}
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
        yield indent + " ".join([*words[:place], new, *words[place + 1 :]])


@pytest.mark.parametrize(("read", "text"), [(zemax.read, ZMX), (codev.read, SEQ)], ids=["zmx", "seq"])
def test_what_is_taken_is_used(read, text):
    lines = text.splitlines()
    whole = outcome(read, lines)
    assert whole != "refused"
    taken = sorted({line.number for line in read(Path("lens"), lines)[1].of(Verdict.TAKEN)})
    assert len(taken) > 15
    unused = []
    for number in taken:
        line, before, after = lines[number - 1], lines[: number - 1], lines[number:]
        changed = any(outcome(read, [*before, other, *after]) != whole for other in others(line))
        if not changed and outcome(read, before + after) == whole and line.split()[0] not in WITHOUT_VALUES:
            unused.append(line)
    assert unused == []


@pytest.mark.parametrize(("number", "name"), [("0", "object"), ("3", "image")])
def test_a_curved_object_or_image_is_said(number, name):
    head, tail = SINGLET_ZMX.split(f"SURF {number}\n")
    _, report = zemax.read(
        Path("lens.zmx"), f"{head}SURF {number}\n{tail.replace('CURV 0.0', 'CURV 0.01', 1)}".splitlines()
    )
    said = [line.how for line in report.of(Verdict.APPROXIMATED)]
    assert said == [f"the {name} is curved in the file; here it is flat"]
