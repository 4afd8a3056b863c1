"""Cache of compiled kernels, with file names that change with every source of a kernel.

Numba caches a kernel beside its module, or in NUMBA_CACHE_DIR, and checks only that module's file. But a kernel also
contains the functions that it calls and the constants that it reads, from other files. So the file names carry a digest
of the kernel's module and of all that it imports, directly or indirectly, from its package and lfmesh. Of the scene's
models only the constants count, or a new key of a scene file would recompile everything. The modules that define
classes count too: numba's index of a kernel names the classes of its arguments by module and cannot be read once one
has moved.
"""

import glob
import hashlib
import os
import re
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

HERE = f"{Path(__file__).parents[1]}{os.sep}"

KEPT = 3
"""Number of older versions of a kernel kept on disk, for checkouts that switch between branches."""

_DIGITS = 12
_WITHOUT_KERNELS = ("lfmesh.scene",)
_COMPILES = f"{__package__}.accelerator"
"""Module that imports the compilers at their first use."""
_IMPORT = re.compile(rb"^(?:from ([\w.]+) import (\([^)]*\)|[^\n]*)|import ([\w.]+))", re.MULTILINE)
_WORD = re.compile(rb"\w+")
_CLASS = re.compile(rb"^class (\w+)", re.MULTILINE)
_WITH_CLASSES = ("geometry", "kernels", "optics", "transport")
"""Packages whose classes are arguments of kernels."""
_FILE = re.compile(rf"(\w+)\.(?:([0-9a-f]{{{_DIGITS}}})\.)?([\w.]+)-\d+\.py\w+(?:\.\d+)?\.nb[ic]")


@contextmanager
def named_by_sources(function: Callable[..., Any]) -> Iterator[None]:
    """Add the digest to the cache file names of a kernel made within this context, through its qualified name."""
    name = function.__qualname__
    function.__qualname__ = f"{digest(sys.modules[function.__module__])}.{name}"
    try:
        yield
    finally:
        function.__qualname__ = name


@cache
def digest(module: ModuleType) -> str:
    """Return the digest of a module's file and of the files that it imports.

    Imports inside functions and for type checking are ignored, as kernels use nothing from them. The compilers count
    whether used or not, as both give the same code.
    """
    source = _source(module)
    found = hashlib.sha256(_constants(module) if module.__name__.startswith(_WITHOUT_KERNELS) else source)
    found.update(_places_of_classes(HERE))
    if module.__name__ == _COMPILES:
        for file in sorted(Path(__file__).with_name("private").glob("*.py")):
            found.update(file.read_bytes())
    for name in sorted(_imported(source)):
        other = sys.modules.get(name)
        if other is not None and _is_followed(other, module):
            found.update(digest(other).encode())
    return found.hexdigest()[:_DIGITS]


@cache
def _places_of_classes(folder: str) -> bytes:
    """Return the names of the classes below a folder that may be arguments of kernels, by file."""
    files = sorted(file for part in _WITH_CLASSES for file in Path(folder, part).rglob("*.py"))
    held = [(str(file.relative_to(folder)), sorted(_CLASS.findall(file.read_bytes()))) for file in files]
    return repr([each for each in held if each[1]]).encode()


def _source(module: ModuleType) -> bytes:
    try:
        return Path(module.__file__ or "").read_bytes()
    except OSError:
        return b""


def _constants(module: ModuleType) -> bytes:
    """Return the values that kernels can read from a module without kernels: numbers, texts, tuples and field names."""
    held = {name: getattr(value, "_fields", value) for name, value in vars(module).items() if not name.startswith("__")}
    return repr(sorted(item for item in held.items() if _is_constant(item[1]))).encode()


def _is_constant(value: object) -> bool:
    return all(map(_is_constant, value)) if isinstance(value, tuple) else isinstance(value, int | float | str | bytes)


def _imported(source: bytes) -> set[str]:
    """Return the possible names of the modules that a file imports at its top."""
    names = set()
    for origin, parts, alone in _IMPORT.findall(source):
        names.add((origin or alone).decode())
        names.update(f"{origin.decode()}.{part.decode()}" for part in _WORD.findall(parts))
    return names


def _is_followed(other: ModuleType, module: ModuleType) -> bool:
    """Tell whether a module belongs to lfmesh, or lies in or below the folder of its importer."""
    file, own = getattr(other, "__file__", None), module.__file__
    if file is None or own is None or other is module:
        return False
    return file.startswith((HERE, own.rpartition(os.sep)[0] + os.sep))


def remove_older_versions(folder: str | None, function: Callable[..., Any]) -> None:
    """Remove all but the newest `KEPT` older versions of a kernel from the cache.

    Parameters
    ----------
    folder : str, optional
        Cache folder of the kernel.
    function : callable
        The kernel's source function.
    """
    if folder is None:
        return
    module = sys.modules[function.__module__]
    versions = _versions(folder).get((Path(module.__file__ or "").stem, function.__qualname__), {})
    old = {name: files for name, files in versions.items() if name != digest(module)}
    # Early releases wrote files without a digest.
    stay = sorted(filter(None, old), key=lambda name: max(map(_written, old[name])))[-KEPT:]
    for name in old.keys() - stay:
        for file in old[name]:
            try:
                file.unlink()
            except OSError:
                # Another process has removed or is reading it.
                continue


def is_cached(kernel: Any) -> bool:
    """Tell whether a kernel is already compiled, in this process or on disk.

    A file on disk may be for another processor; numba decides that.
    """
    source, folder = kernel.py_func, kernel.stats.cache_path
    if kernel.signatures or folder is None:
        return True
    module = sys.modules[source.__module__]
    name = f"{Path(module.__file__ or '').stem}.{digest(module)}.{source.__qualname__}"
    return any(Path(folder).glob(f"{glob.escape(name)}-*.nbi"))


@cache
def _versions(folder: str) -> dict[tuple[str, str], dict[str, list[Path]]]:
    """Return the cache files of a folder, by kernel (module and name) and digest."""
    versions: dict[tuple[str, str], dict[str, list[Path]]] = defaultdict(lambda: defaultdict(list))
    try:
        names = [file.name for file in Path(folder).iterdir()]
    except OSError:
        names = []
    for found in filter(None, map(_FILE.fullmatch, names)):
        module, version, kernel = found.groups()
        versions[module, kernel][version or ""].append(Path(folder, found.string))
    return versions


def _written(file: Path) -> float:
    try:
        return file.stat().st_mtime
    except OSError:
        return 0.0
