"""Kinds of TOML files. A file of the wrong kind is named, with the command or key that takes it."""

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
    """Return the kind of file that has these tables, by keys unique to each kind, or None if unknown."""
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
    """Return a message about a file of the wrong kind, or None if its kind is right or unknown.

    Parameters
    ----------
    wanted : {"scene", "lens", "study", "dataset", "design"}
    data : mapping
        Tables of the file.
    """
    found = kind_of(data)
    if found is None or found == wanted:
        return None
    words = f"is a {found} file, but a {wanted} file is needed: {_TAKEN_BY[found]}"
    if (found, wanted) == ("scene", "study"):
        words += "; lfmesh study --template assembly writes a study of it"
    return words
