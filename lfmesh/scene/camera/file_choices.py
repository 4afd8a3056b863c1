"""Choices that a lens file of another program leaves open."""

from collections.abc import Mapping
from dataclasses import dataclass, field

FILE_CHOICES = ("substitutes", "configuration", "coating_file")
"""Keys of a lens that choose from its file."""


@dataclass(frozen=True)
class FileChoices:
    """Choices that a lens file of another program leaves open.

    Attributes
    ----------
    substitutes : mapping
        Catalogue glass or index by the name that the file uses, in place of looking the name up.
    configuration : int, optional
        From 1; if left out, the one whose values stand in the file's surfaces.
    coating_file : str, optional
        Path of the file that defines the coatings; if left out, the one beside the lens file.
    """

    substitutes: Mapping[str, str | float] = field(default_factory=dict)
    configuration: int | None = None
    coating_file: str | None = None

    def given(self) -> list[str]:
        """Return the keys of the choices that are made."""
        return [key for key in FILE_CHOICES if getattr(self, key)]


AS_IT_STANDS = FileChoices()
"""No choices."""
