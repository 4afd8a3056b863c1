"""Numbers of random cameras and scenes, by the option --random-scenes, and the count of outcomes."""

from collections import Counter
from typing import Any

import pytest

from tests.instances import instances
from tests.random_scenes.examine import CAMERAS, IN_SUITE, REPEATED, SCENES
from tests.random_scenes.generator import Kind

KINDS: dict[str, tuple[Kind, int]] = {"camera_number": ("camera", CAMERAS), "scene_number": ("scene", SCENES)}


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Give tests their numbers: those of the option, or the suite's with the rest as long tests."""
    chosen = metafunc.config.getoption("--random-scenes")
    for name in KINDS.keys() & set(metafunc.fixturenames):
        metafunc.parametrize(name, numbers(chosen, *KINDS[name]))


def numbers(chosen: str | None, kind: Kind, count: int) -> list[Any]:
    if chosen is not None:
        first, last = (int(part) for part in chosen.split(":"))
        return list(range(first, min(last, count)))
    return instances(range(count), long=[*REPEATED[kind], *range(IN_SUITE, count)])


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
