"""Cache of built worlds, reused by renders of the same scene.

A world depends on its scene, except the seed, and on the files named in it. A world held by the caller costs nothing.
The latest world is kept even if nobody holds it, unless it is large.
"""

import threading
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from lfmesh.errors import LfmeshError
from lfmesh.geometry.files.mesh_file import companions
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.scene import Scene
from lfmesh.scene.inputs import STAMPED_FILES, digest_of, file_stamp, files_of
from lfmesh.scene.literals import literal
from lfmesh.transport.world import Key, World

MOST_BYTES = 1 << 29
"""Largest size of the arrays of a world that is kept while nobody else holds it; Embree's tree takes about as much
again."""

_held: WeakValueDictionary[Key, World] = WeakValueDictionary()
_latest: dict[Key, World] = {}
_access = threading.Lock()


def key_of(scene: Scene) -> Key:
    """Return the key of a scene's world: the solved scene without seed, and digests of its files.

    Parameters
    ----------
    scene : Scene

    Raises
    ------
    LfmeshError
        The scene cannot be solved.
    """
    ready = solved_camera(scene).scene
    digest = ready.changed({"transport.seed": 0}).digest
    return digest, ready.folder, tuple(sorted(ready.digests.items())), tuple(_contents(ready))


def _contents(scene: Scene) -> Iterator[Key]:
    for name in dict.fromkeys(name for _, name in files_of(scene)):
        path = scene.resolve(name)
        digest = _digest(path, file_stamp(path))
        yield name, digest
        # Computed each time: of the files named in a mesh file, only existing ones count.
        for other in companions(path) if digest else ():
            place = path.parent / other
            yield name, other, _digest(place, file_stamp(place))


@lru_cache(maxsize=STAMPED_FILES)
def _digest(path: Path, stamp: tuple[object, ...]) -> str:
    """Return the digest of a file's contents, computed once per stamp; "" if the file is missing."""
    return digest_of(path) if stamp else ""


def keep(key: Key, world: World) -> None:
    """Store a world under its key.

    Parameters
    ----------
    key : tuple
        See `key_of`.
    world : World
    """
    with _access:
        _held[key] = world
        _latest.clear()
        if bytes_of(world.tables) <= MOST_BYTES:
            _latest[key] = world


def let_go(key: Key) -> None:
    """Drop the latest world unless it has this key, so that a build does not hold two worlds."""
    with _access:
        if key not in _latest:
            _latest.clear()


def known(key: Key) -> World | None:
    """Return the world built from a key, if it still exists."""
    with _access:
        return _held.get(key)


def bytes_of(tables: Any) -> int:
    """Return the size of all arrays in nested tuples and lists, in bytes."""
    if isinstance(tables, np.ndarray):
        return tables.nbytes
    return sum(map(bytes_of, tables)) if isinstance(tables, tuple | list) else 0


def refuse_other(world: World, key: Key | None, scene: Scene) -> None:
    """Refuse a world that was built from another scene.

    Parameters
    ----------
    world : World
    key : tuple, optional
        Of the world; None if its files changed meanwhile.
    scene : Scene
        To render.

    Raises
    ------
    LfmeshError
        Names the first difference.
    """
    if key == key_of(scene):
        return
    own, other = (each.model_dump(mode="json") for each in (world.scene, solved_camera(scene).scene))
    difference = next(_differences("", own, other), None)
    told = "files that it was built from have changed, or lie elsewhere"
    if difference is not None:
        told = "{} is {} in the world and {} in the scene".format(difference[0], *map(_shown, difference[1:]))
    raise LfmeshError(f"world: was built from another scene: {told}; valid is lf.build(scene)")


def _differences(path: str, own: Any, other: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield the differences between two scenes, apart from their seeds: path and both values."""
    if isinstance(own, dict) and isinstance(other, dict):
        for key in dict.fromkeys([*own, *other]):
            yield from _differences(f"{path}.{key}" if path else key, own.get(key), other.get(key))
    elif isinstance(own, list) and isinstance(other, list) and len(own) == len(other):
        for number, pair in enumerate(zip(own, other, strict=True)):
            yield from _differences(f"{path}[{number}]", *pair)
    elif own != other and path != "transport.seed":
        yield path, own, other


def _shown(value: Any) -> str:
    """Return a value for a message; lists and tables by their length."""
    if isinstance(value, dict | list):
        return f"a {'table' if isinstance(value, dict) else 'list'} of {len(value)}"
    return "omitted" if value is None else literal(value if not isinstance(value, Path) else str(value))
