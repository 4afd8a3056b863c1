"""Reader of glTF scenes, which the part that reads such files registers, as readers of lens files are."""

from collections.abc import Callable
from importlib import import_module

from lfmesh.scene.objects.gltf_keys import GltfKeys
from lfmesh.scene.scene import Scene

Reader = Callable[[Scene, GltfKeys], Scene]
"""Puts the contents of glTF files into a scene; raises LfmeshError where it cannot."""

_PART = "lfmesh.imports"
"""Module that registers the reader when it is imported."""

_readers: list[Reader] = []


def register(reader: Reader) -> None:
    """Read glTF scenes by a function.

    Parameters
    ----------
    reader : callable
    """
    _readers[:] = [reader]


def gltf_reader() -> Reader:
    """Return the reader of glTF scenes."""
    import_module(_PART)
    return _readers[0]
