"""tools/metrics counts what it says, of a small package."""

import subprocess
import sys
from pathlib import Path

import pytest

TOOL = Path(__file__).resolve().parents[2] / "tools" / "metrics.py"

STATE = '''"""States."""

from enum import IntEnum

OPEN, SHUT = range(2)
AIR = -1  # a code
MOST_PACKETS = 4096


class State(IntEnum):
    """Of a packet."""

    SENSOR = 0
    """It fell on a pixel."""
    LOST = 1


class Options:
    seed: int
    adjoint: bool
    paths: int
'''

WIDE = '''

def wide(a, b, c, d, *, e, f, g, h):
    """Add numbers.

    Parameters
    ----------
    a, b, c, d, e, f, g, h : float
    """
    return (
        a + b + c + d
        # the rest
        + e + f + g + h
    )


def narrow(a):
    """Return a."""
    return a


def _own(a):
    return a


class Holder:
    def grown(self, by):
        return by

    def alone(self):
        text = """a text
        of two lines"""
        return text
'''


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    folder = tmp_path / "lfmesh"
    for place, text in {"transport/state.py": STATE, "kernels/wide.py": WIDE, "scene/long.py": "x = 1\n" * 501}.items():
        file = folder / place
        file.parent.mkdir(parents=True)
        file.write_text(text)
    return tmp_path


def metrics(*arguments: object) -> list[str]:
    done = subprocess.run([sys.executable, TOOL, *map(str, arguments)], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


def test_figures_stand_beside_their_goals(checkout: Path) -> None:
    rows = [line.rsplit(maxsplit=2) for line in metrics(checkout)[1:]]
    # 4 lines of names, 3 of the enumeration, 4 of the options; 5 of `wide`, 2 + 2 of functions, 7 of the class.
    in_transport = 11 + 16
    assert rows == [
        ["enumerated values in transport/", "2", "40"],
        ["small integers named outside enumerations, transport/", "3", "–"],
        ["fields of Options", "3", "12"],
        ["lines of code, transport/ and kernels/", str(in_transport), "13,500"],
        ["lines of code, package", str(in_transport + 501), "47,000"],
        ["files of more than 500 lines", "1", "5"],
        ["functions with 8 arguments or more", "1", "100"],
        ["public functions with arguments, without Parameters", "2", "–"],
    ]


@pytest.mark.parametrize(
    ("figure", "listed"),
    [
        ("enumerated", ["transport/state.py: State.SENSOR", "transport/state.py: State.LOST"]),
        ("functions", ["kernels/wide.py: wide 8"]),
        ("undescribed", ["kernels/wide.py: narrow", "kernels/wide.py: grown"]),
        ("files", ["scene/long.py: 501"]),
    ],
)
def test_what_a_figure_counts_is_listed(checkout: Path, figure: str, listed: list[str]) -> None:
    assert metrics(checkout, "--list", figure) == listed


def test_a_folder_without_the_package_is_named(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, TOOL, tmp_path], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == f"tools/metrics: {tmp_path} holds no package lfmesh\n"
