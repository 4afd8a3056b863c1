"""Signs of inverted or nounless English in guides and docstrings, per 1,000 words.

A native guide of the field, OpenMC's user's guide (65,000 words), has 0.05, 0.09, 0.51 and 0.02 of them.
"""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

import lfmesh

PACKAGE = Path(lfmesh.__file__).parent
ROOT = PACKAGE.parent

SIGNS = {
    "a sentence begins with What, Who, Where, How, Which or Whether": (
        r"(?:^|[.;:] )(?:What|Who|Where|How|Which|Whether)\b[^?.;]*[.;]",
        0.10,
        0.30,
    ),
    "'what ... is' stands for a noun": (
        r"\bwhat (?:a|the|it|is|are|each|others?|an|was|has|stands?|passes)\b",
        0.18,
        0.97,
    ),
    "of which, by which, whose": (r"\b(?:of|by|in|from|at|to|with) which\b|\bwhose\b", 1.02, 1.23),
    "those that, those of": (r"\bthose (?:that|of|which|from|in)\b", 0.04, 0.47),
}
"""By sign: its pattern, and limits per 1,000 words of guides and of docstrings.

Guides have at most twice OpenMC's rate, docstrings a third of that of version 1.0.0.
"""

FEW = 3
"""Number of places that counts as none in the guides."""


@cache
def guides() -> list[str]:
    folders = [ROOT / "assets" / "docs", PACKAGE]
    paths = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(p for f in folders for p in sorted(f.rglob("*.md")))]
    return [prose(path.read_text(encoding="utf-8")) for path in paths]


@cache
def docstrings() -> list[str]:
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in sorted(PACKAGE.rglob("*.py"))]
    documented = ast.FunctionDef | ast.ClassDef | ast.Module
    nodes = [node for tree in trees for node in ast.walk(tree) if isinstance(node, documented)]
    return [prose(ast.get_docstring(node) or "") for node in nodes]


def prose(text: str) -> str:
    """Return a Markdown text without code, headings, addresses of links and bars of tables."""
    text = re.sub(r"```.*?```", " ", text, flags=re.DOTALL)
    text = re.sub(r"^\s*\|.*$", lambda row: row.group().replace("|", ". "), text, flags=re.MULTILINE)
    text = re.sub(r"^#+ .*$", " ", text, flags=re.MULTILINE)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", re.sub(r"`[^`]*`", "X", text))
    return re.sub(r"\s+", " ", text)


@pytest.mark.parametrize("sign", SIGNS)
def test_guides_and_docstrings_read_as_a_native_guide_does(sign: str) -> None:
    pattern, of_guides, of_docstrings = SIGNS[sign]
    for texts, limit, few in ((guides(), of_guides, FEW), (docstrings(), of_docstrings, 0)):
        words = sum(len(text.split()) for text in texts)
        places = [
            text[max(0, hit.start() - 30) : hit.end() + 30] for text in texts for hit in re.finditer(pattern, text)
        ]
        assert len(places) <= max(few, limit * words / 1000.0), places


def test_signs_are_found() -> None:
    text = "Where it ends, stop; use what a lens has, the face of which is round, and those of glass."
    assert all(re.search(pattern, text) for pattern, _, _ in SIGNS.values())
    assert not any(
        re.search(pattern, prose("`what is`\n# What is\n```\nwhose\n```")) for pattern, _, _ in SIGNS.values()
    )
