"""Plugin of pytest that writes down the figures which passing comparisons have, beside the limits they are held to.

    python -m pytest -p docs_figures -o enable_assertion_pass_hook=true --figures FILE tests/validation/test_codev.py

Comparisons are `assert measured < limit` with a number on either side, `==` with `pytest.approx`, and
`np.testing.assert_allclose`. FILE is JSON: the outcome of every test, the seconds, and the comparisons.
"""

import ast
import inspect
import json
import linecache
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

NUMBER = r"(?:np\.float\d+\()?([+-]?(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)\)?"
BELOW = re.compile(rf"{NUMBER} <=? {NUMBER}")
NEAR = re.compile(rf"{NUMBER} == {NUMBER} ± {NUMBER}")


def source_of(call: inspect.Traceback) -> str:
    """Return the source of a call, of one line or of several."""
    at = call.positions
    assert at is not None
    assert at.lineno is not None
    return " ".join(linecache.getlines(call.filename)[at.lineno - 1 : at.end_lineno])


class Figures:
    """Figures of a session."""

    def __init__(self, out: Path) -> None:
        self._out, self._began = out, time.perf_counter()
        self._outcomes: dict[str, str] = {}
        self._comparisons: list[dict[str, Any]] = []
        self._test = ""
        self._allclose = np.testing.assert_allclose
        np.testing.assert_allclose = self._watched  # type: ignore[assignment]

    def _watched(self, actual: Any, desired: Any, rtol: float = 1e-7, atol: float = 0.0, **others: Any) -> None:
        """Compare as numpy does, and keep the difference that comes nearest to its limit, with the limit."""
        self._allclose(actual, desired, rtol, atol, **others)
        found, truth = np.broadcast_arrays(np.asarray(actual, np.complex128), np.asarray(desired, np.complex128))
        known = np.isfinite(found) & np.isfinite(truth)
        away, allowed = np.abs(found - truth)[known], (atol + rtol * np.abs(truth))[known]
        if (allowed > 0.0).any():
            nearest = int(np.argmax(np.divide(away, allowed, out=np.zeros_like(away), where=allowed > 0.0)))
            self._add(source_of(inspect.getframeinfo(sys._getframe(1), 0)), away[nearest], allowed[nearest])

    def _add(self, what: str, value: float, limit: float) -> None:
        words = " ".join(what.split())
        self._comparisons.append({"test": self._test, "what": words, "value": float(value), "limit": float(limit)})

    def pytest_runtest_call(self, item: pytest.Item) -> None:
        """Note which test runs."""
        self._test = item.nodeid

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep the outcome of a test: that of its call, or of what else did not pass."""
        if report.when == "call" or not report.passed:
            self._outcomes[report.nodeid] = report.outcome

    def pytest_assertion_pass(self, orig: str, expl: str) -> None:
        """Keep the numbers of an assertion that has passed."""
        said, written = expl.splitlines()[0], ast.parse(orig.strip(), mode="eval").body
        # Of low < measured < high pytest tells the second pair alone: a range, no measured difference.
        single = isinstance(written, ast.Compare) and len(written.ops) == 1
        if (below := BELOW.fullmatch(said)) and single:
            self._add(orig, *map(float, below.groups()))
        elif near := NEAR.fullmatch(said):
            found, truth, limit = map(float, near.groups())
            self._add(orig, abs(found - truth), limit)

    def pytest_sessionfinish(self) -> None:
        """Write the figures."""
        np.testing.assert_allclose = self._allclose
        facts = {"outcomes": self._outcomes, "seconds": time.perf_counter() - self._began}
        self._out.write_text(json.dumps({**facts, "comparisons": self._comparisons}))


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option for the file."""
    parser.addoption("--figures", type=Path, metavar="FILE", help="file for the figures of comparisons (JSON)")


def pytest_configure(config: pytest.Config) -> None:
    """Watch the session if a file is given."""
    out: Callable[[str], Path | None] = config.getoption
    if (path := out("--figures")) is not None:
        config.pluginmanager.register(Figures(path))
