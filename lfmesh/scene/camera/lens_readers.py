"""Readers of lens files by extension, registered by the packages that hold them."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from lfmesh.scene.camera.file_choices import FileChoices
from lfmesh.scene.camera.lens import Lens

Reader = Callable[[Path, FileChoices], tuple[Lens, tuple[float, ...]]]
"""Function that returns the lens of a file and the file's wavelengths in nm, the primary one first."""

_PARTS = dict.fromkeys((".zmx", ".seq", ".len", ".json", ".csv"), "lfmesh.imports")
"""Package that registers the reader of an extension on import; by name, because scenes do not depend on it."""

_readers: dict[str, Reader] = {}


def register(ending: str, reader: Reader) -> None:
    """Register the reader of an extension such as ".zmx"; it raises SceneError on failure."""
    _readers[ending] = reader


def reader_of(path: Path) -> Reader | None:
    """Return the reader of a file by its extension, in upper or lower case, or None for lfmesh's own TOML."""
    ending = path.suffix.lower()
    if ending in _PARTS and ending not in _readers:
        import_module(_PARTS[ending])
    return _readers.get(ending)


def endings() -> list[str]:
    """Return the extensions of other programs' lens files."""
    return sorted({*_PARTS, *_readers})
