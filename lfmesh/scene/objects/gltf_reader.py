"""Reader of glTF scenes, registered by the package that holds it."""

from collections.abc import Callable
from importlib import import_module

from lfmesh.scene.objects.gltf_keys import GltfKeys
from lfmesh.scene.scene import Scene

Reader = Callable[[Scene, GltfKeys], Scene]
"""Function that puts the contents of glTF files into a scene, or raises LfmeshError."""

_PART = "lfmesh.imports"
"""Package that registers the reader on import."""

_readers: list[Reader] = []


def register(reader: Reader) -> None:
    """Register the function that reads glTF scenes.

    Parameters
    ----------
    reader : callable
    """
    _readers[:] = [reader]


def gltf_reader() -> Reader:
    """Return the reader of glTF scenes."""
    import_module(_PART)
    return _readers[0]
