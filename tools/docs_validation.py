"""The figures of the validation: every truth from outside, its source, and the differences that this build measured."""

import ast
import hashlib
import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from docs_reference import plain

PLUGINS = Path(__file__).resolve().parent
ROOT = PLUGINS.parent
CASES = ROOT / "tests" / "validation"

SHOWN = 3
"""Comparisons of a case on the page, of different tests: those that come nearest to their limits."""

LONGEST = 90
"""Characters of a comparison on the page."""


def validation(kept: Path, program: str, *, quick: bool) -> tuple[str, bool]:
    """Return the page, and whether all that was run has passed.

    Parameters
    ----------
    kept : Path
        Folder of earlier figures, by digest of tests and program.
    program : str
        Digest of the program.
    quick : bool
        Run nothing: only figures that are kept are shown.
    """
    lines = [
        "# Figures of the validation",
        "",
        "Every file of `tests/validation` compares lfmesh with truth from outside. This build ran each, without its",
        "long tests. The tables show the comparisons that came nearest to their limits, with what was measured.",
        "[Accuracy](../../../tests/validation/README.md) has the claims by subject, and further tests.",
        "",
    ]
    shared = b"".join(path.read_bytes() for path in sorted(CASES.glob("*.py")) if not path.stem.startswith("test_"))
    files = {}
    for path in sorted(CASES.glob("test_*.py")):
        digest = hashlib.sha256(path.read_bytes() + shared + program.encode()).hexdigest()[:12]
        files[path] = kept / f"{path.stem}-{digest}.json"
    if not quick:
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            list(pool.map(measured, files.keys(), files.values()))
    facts = {path: json.loads(found.read_text()) if found.is_file() else None for path, found in files.items()}
    passed = all("failed" not in each["outcomes"].values() for each in facts.values() if each is not None)
    return "\n".join([*lines, *(line for path, each in facts.items() for line in entry(path, each))]), passed


def measured(path: Path, out: Path) -> None:
    """Run the tests of a file, and keep the figures of their comparisons, if they are not kept already."""
    if out.is_file():
        return
    print(f"validation: {path.stem}", flush=True)
    out.parent.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "docs_figures", "--figures", str(out), str(path)]
    # Byte code of other runs of pytest tells nothing of assertions that pass.
    own = {"PYTHONPATH": f"{ROOT}{os.pathsep}{PLUGINS}", "PYTHONPYCACHEPREFIX": str(out.parent / "pycache")}
    done = subprocess.run(
        [*command, "-o", "enable_assertion_pass_hook=true"],
        cwd=ROOT, env={**os.environ, **own}, capture_output=True, text=True,
    )  # fmt: skip
    if not out.is_file():
        raise RuntimeError(f"{path}: pytest ended with {done.returncode}: {done.stdout[-2000:]}{done.stderr[-2000:]}")


def entry(path: Path, facts: dict[str, Any] | None) -> list[str]:
    """Return the lines of a file of tests on the page.

    Parameters
    ----------
    path : Path
    facts : dict or None
        Its figures, if there are any.
    """
    words = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    title, *paragraphs = words.split("\n\n")
    lines = [f"## {path.stem.removeprefix('test_').replace('_', ' ').capitalize()}", "", plain(title), ""]
    for text in paragraphs:
        lines += ["```text", text, "```", ""] if text.startswith("    ") else [plain(text), ""]
    if facts is None:
        return [*lines, "Not run in this build.", ""]
    outcomes, comparisons = list(facts["outcomes"].values()), facts["comparisons"]
    counts = {word: outcomes.count(word) for word in ("passed", "failed", "skipped")}
    said = ", ".join(f"{count} {word}" for word, count in counts.items() if count) or "none that is not long"
    line = f"`tools/test {path.relative_to(ROOT)}`: {said}, in {facts['seconds']:.0f} s."
    if comparisons:
        line += f" Of {len(comparisons):,} comparisons with a limit, the nearest to it:"
    lines += [line, ""]
    nearest = nearest_of(comparisons)
    if nearest:
        lines += ["| comparison | measured | limit |", "|---|---|---|"]
        for each in nearest:
            what = each["what"] if len(each["what"]) <= LONGEST else f"{each['what'][: LONGEST - 3]}..."
            cell = what.replace("|", "\\|").replace("`", "'")
            lines.append(f"| `{cell}` | {each['value']:.2g} | {each['limit']:.2g} |")
        lines.append("")
    return lines


def nearest_of(comparisons: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the comparisons that come nearest to their limits, one a line of the tests, the nearest first."""
    closest: dict[str, dict[str, Any]] = {}
    for each in comparisons:
        other = closest.get(each["what"])
        if each["limit"] > 0.0 <= each["value"] and (other is None or share(each) > share(other)):
            closest[each["what"]] = each
    return sorted(closest.values(), key=share, reverse=True)[:SHOWN]


def share(comparison: dict[str, Any]) -> float:
    """Return which share of its limit a comparison takes."""
    return float(comparison["value"] / comparison["limit"])
