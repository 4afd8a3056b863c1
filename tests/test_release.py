"""What stands beside the package for people and tools: changelog, citation, guide for contributors, licence."""

import re
import tomllib
from pathlib import Path

import lfmesh

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CHANGELOG = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
CITATION = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")

KINDS = {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
"""Of changes, by Keep a Changelog 1.1.0."""


def cited(key: str) -> str:
    """Return a plain value at the top of the citation file."""
    (value,) = re.findall(rf"^{key}: (.+)$", CITATION, flags=re.MULTILINE)
    return str(value).strip('"')


def test_the_citation_has_the_version_and_licence_of_the_package() -> None:
    assert cited("version") == PROJECT["version"]
    assert cited("license") == PROJECT["license"]
    assert cited("cff-version") == "1.2.0"
    listed = re.findall(r"^  - ([\w ]+)$", CITATION.split("keywords:")[1], flags=re.MULTILINE)
    assert listed == PROJECT["keywords"]


def test_the_changelog_begins_with_unreleased_changes_and_descends_by_version() -> None:
    first, *released = re.findall(r"^## \[([^\]]+)\]", CHANGELOG, flags=re.MULTILINE)
    assert first == "Unreleased"
    versions = [tuple(map(int, name.split("."))) for name in released]
    assert versions == sorted(versions, reverse=True)
    assert all(
        re.search(rf"^## \[{re.escape(name)}\] - \d{{4}}-\d\d-\d\d$", CHANGELOG, re.MULTILINE) for name in released
    )
    assert set(re.findall(r"^### (.+)$", CHANGELOG, flags=re.MULTILINE)) <= KINDS


def test_python_names_in_the_changelog_and_the_guide_are_public() -> None:
    named = set(re.findall(r"\blf\.(\w+)", CHANGELOG + CONTRIBUTING))
    assert named
    assert named <= set(lfmesh.__all__)


def test_the_guide_promises_the_schema_version_that_scenes_have() -> None:
    (promised,) = re.findall(r"`schema_version = (\d+)`", CONTRIBUTING)
    assert lfmesh.Scene.model_fields["schema_version"].default == int(promised)


def test_links_and_commands_of_the_pages_lead_somewhere() -> None:
    for page in (CHANGELOG, CONTRIBUTING):
        for link in re.findall(r"\]\((?!https?:)([^)#]+)", page):
            assert (ROOT / link).exists(), link
    for path in re.findall(r"\b((?:tools|tests|lfmesh)/[\w./]+\w)", CONTRIBUTING):
        assert (ROOT / path).exists(), path
