"""The cache of compiled kernels: file names that change with every source that a kernel was compiled from.

Numba caches a kernel beside its module, or in NUMBA_CACHE_DIR, and takes it as valid while that module's file stays the
same. But the functions that a kernel calls and the constants that it reads are compiled into it and stand in other
files. So the cache's file names carry a digest of the kernel's module and of all modules that it imports, directly or
not, from its own package and from lfmesh. Of the scene's models, which define no kernels, only the constants count: a
new key of a scene file would otherwise compile everything again. The places of all classes count too: numba's index of
a kernel names those of its arguments, and cannot be read once one of them has moved.
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
"""Number of older versions of a kernel that stay on disk, for checkouts that switch between branches."""

_DIGITS = 12
_WITHOUT_KERNELS = ("lfmesh.scene",)
_COMPILES = f"{__package__}.accelerator"
"""The module that imports the compilers, when they are first used."""
_IMPORT = re.compile(rb"^(?:from ([\w.]+) import (\([^)]*\)|[^\n]*)|import ([\w.]+))", re.MULTILINE)
_WORD = re.compile(rb"\w+")
_CLASS = re.compile(rb"^class (\w+)", re.MULTILINE)
_WITH_CLASSES = ("geometry", "kernels", "optics", "transport")
"""Packages whose classes are arguments of kernels."""
_FILE = re.compile(rf"(\w+)\.(?:([0-9a-f]{{{_DIGITS}}})\.)?([\w.]+)-\d+\.py\w+(?:\.\d+)?\.nb[ic]")


@contextmanager
def named_by_sources(function: Callable[..., Any]) -> Iterator[None]:
    """Name the cache files of a kernel made within this context by its digest, by way of the qualified name."""
    name = function.__qualname__
    function.__qualname__ = f"{digest(sys.modules[function.__module__])}.{name}"
    try:
        yield
    finally:
        function.__qualname__ = name


@cache
def digest(module: ModuleType) -> str:
    """Return the digest of a module's file and of the files that it imports.

    Imports inside functions and for type checking do not count: kernels use nothing from them. The compilers count,
    whether they are in use or not: code from either kind is the same.
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
    """Return the names of the classes that may be arguments of kernels, by file, below a folder."""
    files = sorted(file for part in _WITH_CLASSES for file in Path(folder, part).rglob("*.py"))
    held = [(str(file.relative_to(folder)), sorted(_CLASS.findall(file.read_bytes()))) for file in files]
    return repr([each for each in held if each[1]]).encode()


def _source(module: ModuleType) -> bytes:
    try:
        return Path(module.__file__ or "").read_bytes()
    except OSError:
        return b""


def _constants(module: ModuleType) -> bytes:
    """Return what a kernel can read from a module without kernels: numbers, texts, tuples of these, tuples' fields."""
    held = {name: getattr(value, "_fields", value) for name, value in vars(module).items() if not name.startswith("__")}
    return repr(sorted(item for item in held.items() if _is_constant(item[1]))).encode()


def _is_constant(value: object) -> bool:
    return all(map(_is_constant, value)) if isinstance(value, tuple) else isinstance(value, int | float | str | bytes)


def _imported(source: bytes) -> set[str]:
    """Return the possible names of modules that a file imports at its top."""
    names = set()
    for origin, parts, alone in _IMPORT.findall(source):
        names.add((origin or alone).decode())
        names.update(f"{origin.decode()}.{part.decode()}" for part in _WORD.findall(parts))
    return names


def _is_followed(other: ModuleType, module: ModuleType) -> bool:
    """Tell whether a module belongs to lfmesh, or lies in or below the folder of the module that imports it."""
    file, own = getattr(other, "__file__", None), module.__file__
    if file is None or own is None or other is module:
        return False
    return file.startswith((HERE, own.rpartition(os.sep)[0] + os.sep))


def remove_older_versions(folder: str | None, function: Callable[..., Any]) -> None:
    """Remove all but a few of the cache files of a kernel's earlier versions.

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
    # Files without a digest were written by releases that had none.
    stay = sorted(filter(None, old), key=lambda name: max(map(_written, old[name])))[-KEPT:]
    for name in old.keys() - stay:
        for file in old[name]:
            try:
                file.unlink()
            except OSError:
                # Another process removed it first, or is reading it.
                continue


def is_cached(kernel: Any) -> bool:
    """Tell whether a kernel is compiled already, in this process or on disk.

    What is on disk may still be of another processor; numba itself decides that.
    """
    source, folder = kernel.py_func, kernel.stats.cache_path
    if kernel.signatures or folder is None:
        return True
    module = sys.modules[source.__module__]
    name = f"{Path(module.__file__ or '').stem}.{digest(module)}.{source.__qualname__}"
    return any(Path(folder).glob(f"{glob.escape(name)}-*.nbi"))


@cache
def _versions(folder: str) -> dict[tuple[str, str], dict[str, list[Path]]]:
    """Return the cache files in a folder by kernel (module and name) and by digest."""
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
