"""Kinds of TOML files: one that was given in place of another is named, with the command or key that takes it."""

from collections.abc import Mapping
from typing import Any, Literal

FileKind = Literal["scene", "lens", "study", "dataset", "design"]

_TAKEN_BY: dict[FileKind, str] = {
    "scene": "lfmesh check, render, view and most other commands take it; studies, datasets and designs name it by "
    "scene =",
    "lens": "a scene names it by camera.lens = { file = ... }",
    "study": "lfmesh study takes it",
    "dataset": "lfmesh dataset takes it",
    "design": "lfmesh optimise takes it",
}


def kind_of(data: Mapping[str, Any]) -> FileKind | None:
    """Return what kind of file tables are of, by the keys that no other kind has; None where none tells."""
    if "camera" in data:
        return "scene"
    if "random" in data:
        return "dataset"
    if {"variables", "merit"} & data.keys():
        return "design"
    if {"axes", "metrics", "scenes"} & data.keys():
        return "study"
    return "lens" if "surfaces" in data else None


def mistaken_for(wanted: FileKind, data: Mapping[str, Any]) -> str | None:
    """Return what is said of a file of another kind than the wanted one; None of one of that kind.

    Parameters
    ----------
    wanted : {"scene", "lens", "study", "dataset", "design"}
    data : mapping
        Its tables.
    """
    found = kind_of(data)
    if found is None or found == wanted:
        return None
    words = f"is a {found} file, and a {wanted} file is needed: {_TAKEN_BY[found]}"
    if (found, wanted) == ("scene", "study"):
        words += "; lfmesh study --template assembly with it writes a study"
    return words
