"""The report on an imported file gives each of its lines one verdict."""

from collections import Counter
from pathlib import Path

import pytest

from lfmesh.imports import codev, oslo, zemax
from lfmesh.imports.report import Report, Verdict
from tests.imports.files import CROWDED_ZMX, GRADIENTS_ZMX, PHASES_SEQ, PHASES_ZMX, SINGLET_SEQ, SINGLET_ZMX
from tests.imports.test_oslo import LENS

OTHER_GLASS = SINGLET_ZMX.replace("N-BK7 0 0 1.5168 64.17", "N-BK7 0 0 1.6 64.17")


def test_the_weightiest_verdict_on_a_line_stands_with_its_reasons() -> None:
    report = Report(Path("lens.zmx"))
    for verdict, how in [
        (Verdict.TAKEN, "as the file has it"),
        (Verdict.APPROXIMATED, "first"),
        (Verdict.WITHOUT_EFFECT, ""),
        (Verdict.APPROXIMATED, "second"),
        (Verdict.APPROXIMATED, "first"),
    ]:
        report.add(3, "GLAS X", verdict, how)
    report.add(4, "GLAS X", Verdict.TAKEN)
    assert [str(line) for line in report.lines] == [
        "line 3: GLAS X: approximated: first; second",
        "line 4: GLAS X: taken",
    ]
    report.refuse(3, "GLAS X", "why")
    assert [line.how for line in report.of(Verdict.REFUSED)] == ["why"]
    assert not report.of(Verdict.APPROXIMATED)


@pytest.mark.parametrize(
    ("read", "text"),
    [
        (zemax.read, CROWDED_ZMX),
        (zemax.read, OTHER_GLASS),
        (zemax.read, PHASES_ZMX),
        (zemax.read, GRADIENTS_ZMX),
        (codev.read, SINGLET_SEQ),
        (codev.read, PHASES_SEQ),
        (oslo.read, LENS),
    ],
    ids=["zmx", "other index", "zmx phases", "zmx gradients", "seq", "seq phases", "len"],
)
def test_no_line_of_a_file_has_two_verdicts(read, text) -> None:
    _, report = read(Path("lens"), text.splitlines())
    assert report.lines
    counts = Counter((line.number, line.text) for line in report.lines)
    assert max(counts.values()) == 1
