"""The one exception family: everything a user can cause ends in an `LfmeshError` with one clear message."""

from typing import ClassVar


class LfmeshError(Exception):
    """A mistake the user can mend: the message names the field or file, the value, and what is valid."""

    longest_line: ClassVar[int] = 1500
    """Most characters of a line of its message: a value of a broken file may be of any length."""

    def __str__(self) -> str:
        """Return the message, without the middle of lines that are too long to be read."""
        return "\n".join(_shortened(line, self.longest_line) for line in super().__str__().split("\n"))


def _shortened(line: str, most: int) -> str:
    return line if len(line) <= most else f"{line[: most // 2]} … {line[-(most // 2) :]}"


class SceneError(LfmeshError):
    """The scene file or model is wrong; the message lists every fault, one a line."""


class MeshError(LfmeshError):
    """A mesh file is missing, empty, broken, or not what its use needs."""


class GlassError(LfmeshError):
    """A glass or refractive index that the catalogue does not hold at the wished wavelength."""


class FileError(LfmeshError):
    """A run folder, image or texture cannot be read or written."""


class LensFileWarning(UserWarning):
    """A lens file or glTF scene was read with approximations, or holds what the reader does not know."""
