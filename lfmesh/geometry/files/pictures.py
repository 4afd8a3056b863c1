"""Pictures that mesh files name or hold, as linear light, each opened once a file."""

import io
from pathlib import Path

import PIL
import PIL.Image

from lfmesh.errors import FileError
from lfmesh.geometry.files.companion import check_companion
from lfmesh.geometry.files.piece import Notes
from lfmesh.geometry.objects.texture import FORMATS, Texture, linear_light, opened, with_alpha
from lfmesh.regular_file import read_bytes


class Pictures:
    """The pictures of one mesh file, so that pieces that share a picture share it in memory, too.

    Parameters
    ----------
    path : Path
        The mesh file.
    alpha : bool
        Read their alpha, too.
    notes : Notes
    """

    def __init__(self, path: Path, alpha: bool, notes: Notes) -> None:
        self.path, self.alpha, self.notes = path, alpha, notes
        self._known: dict[object, Texture | None] = {}

    def of_file(self, names: list[str]) -> Texture | None:
        """Return the picture in the first file that is there; None, which is noted, where none is.

        Parameters
        ----------
        names : list of str
            Files that may be meant, relative to the mesh file's folder.

        Raises
        ------
        MeshError
            The file lies outside the mesh's folder.
        ValueError
            It is no picture that can be read.
        """
        name = companion_name(self.path, names, "picture")
        if name is None:
            self.notes.add(f"its picture {names[0][:100]} is not there: its facets have their plain colour")
            return None
        if name not in self._known:
            self._known[name] = _light(read_bytes(self.path.parent / name), name, self.alpha)
        return self._known[name]

    def of_bytes(self, key: object, content: bytes) -> Texture | None:
        """Return a picture that stands in the mesh file itself.

        Parameters
        ----------
        key : object
            By which it is known again.
        content : bytes

        Raises
        ------
        ValueError
            It is no picture that can be read.
        """
        if key not in self._known:
            self._known[key] = _light(content, "", self.alpha)
        return self._known[key]


def companion_name(path: Path, names: list[str], kind: str) -> str | None:
    """Return the first of some names by which a file stands beside a mesh file or below; None where none does.

    Parameters
    ----------
    path : Path
        The mesh file.
    names : list of str
    kind : str
        Of the other file, in messages.

    Raises
    ------
    MeshError
        One lies elsewhere, or is no regular file.
    """
    for name in names:
        check_companion(path, name, kind)
    return next((name for name in names if (path.parent / name).is_file()), None)


def _light(content: bytes, name: str, alpha: bool) -> Texture:
    its = f"its picture {name}".rstrip()
    try:
        with opened(io.BytesIO(content)) as image:
            light = linear_light(image)
            return with_alpha(light, image) if alpha else light
    except FileError as error:
        raise ValueError(f"{its} {str(error).partition(': ')[2]}") from None
    except PIL.UnidentifiedImageError:
        raise ValueError(f"{its} is of no kind that is read; valid are {', '.join(FORMATS)}") from None
    except Exception as error:  # a damaged file may raise anything inside Pillow's readers
        reason = f"{error}".splitlines()[0] if str(error) else type(error).__name__
        raise ValueError(f"{its} is broken ({reason[:100]})") from None
