"""Readers of lens files by their ending: TOML is the scene's own, others are registered by the part that has them."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from lfmesh.scene.camera.file_choices import FileChoices
from lfmesh.scene.camera.lens import Lens

Reader = Callable[[Path, FileChoices], tuple[Lens, tuple[float, ...]]]
"""Function that returns the lens of a file and the file's wavelengths in nm, the primary one first."""

_PARTS = dict.fromkeys((".zmx", ".seq", ".len", ".json", ".csv"), "lfmesh.imports")
"""Part that registers the reader of an ending when it is imported; by name, for the scene knows nothing of it."""

_readers: dict[str, Reader] = {}


def register(ending: str, reader: Reader) -> None:
    """Have files with an ending, such as ".zmx", read by a function that raises SceneError where it cannot."""
    _readers[ending] = reader


def reader_of(path: Path) -> Reader | None:
    """Return the reader of a file by its ending, upper or lower case; None for the scene's own TOML."""
    ending = path.suffix.lower()
    if ending in _PARTS and ending not in _readers:
        import_module(_PARTS[ending])
    return _readers.get(ending)


def endings() -> list[str]:
    """Return the endings that files of other programs may have."""
    return sorted({*_PARTS, *_readers})
