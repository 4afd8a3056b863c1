"""The library of cameras: commented scenes of published cameras, to start from."""

from dataclasses import dataclass
from pathlib import Path

from lfmesh.assets import asset_path
from lfmesh.errors import SceneError
from lfmesh.regular_file import read_text
from lfmesh.scene.model import nearest

_SOURCE = "Source: "
"""Start of the paragraph in a scene's first comment that names its publications."""


@dataclass(frozen=True)
class LibraryCamera:
    """A camera of the library.

    Attributes
    ----------
    name : str
        Name that `lfmesh new --camera` takes.
    title : str
        First paragraph of the scene's comment: the camera and its key figures.
    source : str
        Publications of its figures.
    text : str
        Scene file, with comments.
    """

    name: str
    title: str
    source: str
    text: str

    def __str__(self) -> str:
        return f"{self.name}: {self.title} {self.source}"


def camera_names() -> list[str]:
    """Return the names of the library's cameras."""
    return sorted(_files())


def cameras_in_words() -> str:
    """Return the end of a message: the names of the cameras, and the command that describes them."""
    return f"there are: {', '.join(camera_names())}; lfmesh new --list describes them"


def library_camera(name: str) -> LibraryCamera:
    """Return a camera of the library.

    Parameters
    ----------
    name : str

    Raises
    ------
    SceneError
        There is no such camera; the message lists the valid names.
    """
    files = _files()
    if name not in files:
        raise SceneError(f"no camera {name!r}{nearest(name, files)}; {cameras_in_words()}")
    text = read_text(files[name])
    paragraphs = _comment(text)
    source = next((each.removeprefix(_SOURCE) for each in paragraphs if each.startswith(_SOURCE)), "")
    return LibraryCamera(name, paragraphs[0], source, text)


def _files() -> dict[str, Path]:
    return {path.stem: path for path in asset_path("cameras").glob("*.toml")}


def _comment(text: str) -> list[str]:
    """Return the paragraphs of the comment that begins a file."""
    paragraphs: list[list[str]] = [[]]
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        words = line.removeprefix("#").strip()
        if words:
            paragraphs[-1].append(words)
        else:
            paragraphs.append([])
    return [" ".join(lines) for lines in paragraphs if lines]
