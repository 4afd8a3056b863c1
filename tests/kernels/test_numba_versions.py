"""Versions of numba: what `pyproject.toml` allows is what the README of `kernels/` says was tried."""

import re
import tomllib
from importlib.metadata import version
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

Version = tuple[int, ...]


def numbers(text: str) -> Version:
    """Return a version as numbers, such as (0, 68, 1)."""
    return tuple(map(int, text.split(".")))


def bounds() -> tuple[Version, Version]:
    """Return the oldest version of numba that `pyproject.toml` allows, and the first that it does not."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    (numba,) = [each for each in project["dependencies"] if re.match(r"numba\b", each)]
    found = re.fullmatch(r"numba>=([\d.]+),<([\d.]+)", numba)
    assert found is not None, f"{numba}: has no upper bound"
    return numbers(found[1]), numbers(found[2])


def tried() -> list[Version]:
    """Return the versions in the table of the README."""
    text = (ROOT / "lfmesh" / "kernels" / "README.md").read_text(encoding="utf-8")
    return [numbers(found) for found in re.findall(r"^\| (\d+\.\d+\.\d+) \|", text, re.MULTILINE)]


def test_the_installed_numba_is_within_the_bounds() -> None:
    oldest, beyond = bounds()
    assert oldest <= numbers(version("numba")) < beyond


def test_the_bounds_are_those_of_the_versions_tried() -> None:
    """A newer numba is allowed by trying it, as the README says, and by its line in the table."""
    oldest, beyond = bounds()
    assert min(tried())[:2] == oldest[:2]
    major, minor, *_ = max(tried())
    assert (major, minor + 1) == beyond


def test_every_release_in_between_was_tried() -> None:
    oldest, beyond = bounds()
    assert {each[:2] for each in tried()} == {(oldest[0], minor) for minor in range(oldest[1], beyond[1])}
