"""Options for reading another program's lens file."""

from collections.abc import Mapping
from dataclasses import dataclass, field

FILE_CHOICES = ("substitutes", "configuration", "coating_file", "gradient_files")
"""Keys of a lens that select from its file."""


@dataclass(frozen=True)
class FileChoices:
    """Options for reading another program's lens file.

    Attributes
    ----------
    substitutes : mapping
        Catalogue glass or index that replaces a glass name of the file.
    configuration : int, optional
        Number from 1. Default: the values in the file's surfaces.
    coating_file : str, optional
        Path of the file that defines the coatings. Default: the one beside the lens file.
    gradient_files : tuple of str
        Paths of files of gradient-index materials. Default: the ones beside the lens file.
    """

    substitutes: Mapping[str, str | float] = field(default_factory=dict)
    configuration: int | None = None
    coating_file: str | None = None
    gradient_files: tuple[str, ...] = ()

    def given(self) -> list[str]:
        """Return the keys of the options that are given."""
        return [key for key in FILE_CHOICES if getattr(self, key)]


AS_IT_STANDS = FileChoices()
"""No options: the file as it stands."""
