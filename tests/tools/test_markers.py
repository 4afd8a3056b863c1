"""The markers of tests/conftest.py, seen from a small suite that uses them."""

from pathlib import Path

import pytest

pytest_plugins = ["pytester"]

CONFTEST = Path(__file__).resolve().parents[1] / "conftest.py"

SUITE = """
import pytest

@pytest.mark.long
def test_long(): pass

def test_short(): pass

@pytest.mark.drawing
def test_drawing(): pass
"""


@pytest.fixture
def suite(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> pytest.Pytester:
    monkeypatch.delenv("CI", raising=False)
    pytester.makeini("[pytest]\nmarkers =\n  long: x\n  drawing: x")
    pytester.makeconftest(CONFTEST.read_text())
    pytester.makepyfile(test_suite=SUITE)
    # A pyvista that cannot be imported stands for a machine that cannot draw.
    pytester.makepyfile(pyvista="raise ImportError('libEGL.so.1')")
    monkeypatch.setenv("PYTHONPATH", str(pytester.path))
    return pytester


def test_long_tests_run_only_when_asked_for(suite: pytest.Pytester) -> None:
    suite.runpytest_subprocess("-k", "not drawing").assert_outcomes(passed=1, deselected=2)
    suite.runpytest_subprocess("-k", "not drawing", "--long").assert_outcomes(passed=2, deselected=1)


def test_drawing_is_skipped_with_its_reason(suite: pytest.Pytester) -> None:
    result = suite.runpytest_subprocess("test_suite.py::test_drawing", "-rs")
    result.assert_outcomes(skipped=1)
    result.stdout.fnmatch_lines(["*install the packages libegl1 and libgl1-mesa-dri*"])


def test_drawing_is_never_skipped_under_ci(suite: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CI", "true")
    suite.runpytest_subprocess("test_suite.py::test_drawing").assert_outcomes(errors=1)
