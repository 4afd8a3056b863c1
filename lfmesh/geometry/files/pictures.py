"""Pictures in or beside mesh files, as linear light, each opened once per file."""

import io
from pathlib import Path

import PIL
import PIL.Image

from lfmesh.errors import FileError
from lfmesh.geometry.files.companion import check_companion
from lfmesh.geometry.files.piece import Notes
from lfmesh.geometry.objects.texture import (
    FORMATS,
    Texture,
    Transfer,
    linear_light,
    opened,
    srgb_to_linear,
    with_alpha,
)
from lfmesh.regular_file import read_bytes


class Pictures:
    """The pictures of one mesh file; pieces with the same picture share its memory.

    Parameters
    ----------
    path : Path
        The mesh file.
    alpha : bool
        Read their alpha, too.
    notes : Notes
    transfer : function
        From codes, 0..1, to texture values.
    """

    def __init__(self, path: Path, alpha: bool, notes: Notes, transfer: Transfer = srgb_to_linear) -> None:
        self.path, self.alpha, self.notes, self.transfer = path, alpha, notes, transfer
        self._known: dict[object, Texture | None] = {}

    def of_file(self, names: list[str]) -> Texture | None:
        """Return the picture in the first existing file; None, with a note, if there is none.

        Parameters
        ----------
        names : list of str
            Possible files, relative to the mesh file's folder.

        Raises
        ------
        MeshError
            The file is outside the mesh's folder.
        ValueError
            It is not a readable picture.
        """
        name = companion_name(self.path, names, "picture")
        if name is None:
            self.notes.add(f"its picture {names[0][:100]} is missing: its facets have their plain colour")
            return None
        if name not in self._known:
            self._known[name] = self._read(read_bytes(self.path.parent / name), name)
        return self._known[name]

    def of_bytes(self, key: object, content: bytes) -> Texture | None:
        """Return a picture embedded in the mesh file.

        Parameters
        ----------
        key : object
            Key for the cache.
        content : bytes

        Raises
        ------
        ValueError
            It is not a readable picture.
        """
        if key not in self._known:
            self._known[key] = self._read(content, "")
        return self._known[key]

    def _read(self, content: bytes, name: str) -> Texture:
        its = f"its picture {name}".rstrip()
        try:
            with opened(io.BytesIO(content)) as image:
                values = linear_light(image, self.transfer)
                return with_alpha(values, image) if self.alpha else values
        except FileError as error:
            raise ValueError(f"{its} {str(error).partition(': ')[2]}") from None
        except PIL.UnidentifiedImageError:
            raise ValueError(f"{its} is of an unsupported kind; valid are {', '.join(FORMATS)}") from None
        except Exception as error:  # a damaged file may raise anything inside Pillow's readers
            reason = f"{error}".splitlines()[0] if str(error) else type(error).__name__
            raise ValueError(f"{its} is broken ({reason[:100]})") from None


def companion_name(path: Path, names: list[str], kind: str) -> str | None:
    """Return the first of some names that exists beside a mesh file or below; None if none does.

    Parameters
    ----------
    path : Path
        The mesh file.
    names : list of str
    kind : str
        Kind of the other file in messages.

    Raises
    ------
    MeshError
        One is elsewhere, or not a regular file.
    """
    for name in names:
        check_companion(path, name, kind)
    return next((name for name in names if (path.parent / name).is_file()), None)
