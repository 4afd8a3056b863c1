"""No passage stands twice in the package: pylint's check for similar code finds none of 12 lines."""

import re
import subprocess
import sys
from pathlib import Path

import lfmesh
from tests.processor_time import HANGS_S

PACKAGE = Path(lfmesh.__file__).parent
LINES = 12
LEFT_OUT = ("--ignore-comments", "--ignore-docstrings")


def similar(files: list[Path]) -> tuple[int, str]:
    """Return how many lines stand in several of some files, and the report on them."""
    command = [sys.executable, "-c", "from pylint import run_symilar; run_symilar()", "-d", str(LINES), *LEFT_OUT]
    child = subprocess.run([*command, *map(str, files)], capture_output=True, text=True, check=True, timeout=HANGS_S)
    total = re.search(r"^TOTAL lines=\d+ duplicates=(\d+)", child.stdout, re.MULTILINE)
    assert total, child.stdout
    return int(total[1]), child.stdout


def test_a_copy_is_found(tmp_path: Path) -> None:
    files = [tmp_path / "one.py", tmp_path / "other.py"]
    for path in files:
        path.write_text("def f(x):\n" + "".join(f"    x = x + {i}\n" for i in range(LINES)) + "    return x\n")
    assert similar(files)[0] >= LINES


def test_no_passage_stands_twice() -> None:
    number, report = similar(sorted(PACKAGE.rglob("*.py")))
    assert number == 0, report
