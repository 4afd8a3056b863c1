"""Numbers of random cameras and scenes, by the option --random-scenes, and the count of outcomes."""

from collections import Counter
from collections.abc import Iterator

import pytest

from tests.random_scenes.examine import CAMERAS, IN_SUITE, SCENES

KINDS = {"camera_number": CAMERAS, "scene_number": SCENES}


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Give tests their numbers: those of the option, or the suite's, then the rest as long tests."""
    chosen = metafunc.config.getoption("--random-scenes")
    for name in KINDS.keys() & set(metafunc.fixturenames):
        metafunc.parametrize(name, list(numbers(chosen, KINDS[name])))


def numbers(chosen: str | None, count: int) -> Iterator[object]:
    if chosen is not None:
        first, last = (int(part) for part in chosen.split(":"))
        yield from range(first, min(last, count))
        return
    yield from range(IN_SUITE)
    yield from (pytest.param(number, marks=pytest.mark.long) for number in range(IN_SUITE, count))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Count the outcomes of random scenes, and list those that disagreed and said so."""
    reports = [r for of in terminalreporter.stats.values() for r in of if getattr(r, "when", None) == "call"]
    found = [value for report in reports for key, value in report.user_properties if key == "random scene"]
    if found:
        terminalreporter.section("random scenes")
        counts = Counter(str(outcome) for _, outcome, _ in found)
        terminalreporter.line(", ".join(f"{number} {outcome}" for outcome, number in counts.most_common()))
        for name, outcome, words in found:
            if outcome in ("warned", "refused", "dark"):
                terminalreporter.line(f"{name}: {words}")
