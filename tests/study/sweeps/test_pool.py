"""Processes that compute units: which units have the start of a process in their time."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from lfmesh.study.sweeps.pool import here, in_pool


@dataclass(frozen=True)
class Nothing:
    """A unit that takes no time."""

    point: int
    batch: int = 0

    def compute(self, _: bytes | Path) -> bytes:
        return b"done"


@pytest.mark.parametrize("in_process", [False, True])
def test_the_first_unit_of_a_process_is_marked_and_has_the_start_in_its_time(in_process: bool) -> None:
    jobs = [(Nothing(number), Path()) for number in range(4)]
    results = list(in_pool(jobs, 1) if in_process else here(jobs))
    assert [result.unit.point for result in results] == [0, 1, 2, 3]
    assert [result.content for result in results] == [b"done"] * 4
    assert [result.is_first for result in results] == [True, False, False, False]
    assert all(result.seconds > 0.0 for result in results)
