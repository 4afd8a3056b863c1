"""Cache of results that other renders or studies need again, such as those about a camera."""

import hashlib
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, Generic, TypeVar

import numpy as np

from lfmesh.scene.model import Model

T = TypeVar("T")

KEPT = 8
"""Number of cached results, the most recently used ones."""


class Kept(Generic[T]):
    """Cache of one kind of result, keyed by its inputs or their digest."""

    def __init__(self) -> None:
        self._found: OrderedDict[Hashable, T] = OrderedDict()
        self._access = threading.Lock()

    def of(self, key: Hashable, find: Callable[[], T]) -> T:
        """Return the result cached under a key, or compute it.

        Parameters
        ----------
        key : hashable
            For large inputs, see `digest_of`.
        find : callable
            Returns the result; called without arguments.
        """
        with self._access:
            if key in self._found:
                self._found.move_to_end(key)
                return self._found[key]
        found = find()
        with self._access:
            self._found[key] = found
            while len(self._found) > KEPT:
                self._found.popitem(last=False)
        return found


def digest_of(*values: Any) -> bytes:
    """Return a hash of arrays, models, tuples of these, and values fully described by their `repr`.

    Parameters
    ----------
    *values : array, Model, tuple or object

    Returns
    -------
    bytes
    """
    hashed = hashlib.blake2b(digest_size=16)
    for value in values:
        if isinstance(value, np.ndarray):
            hashed.update(f"{value.dtype} {value.shape}".encode())
            hashed.update(value.tobytes())
        elif isinstance(value, tuple):
            hashed.update(digest_of(*value))
        elif isinstance(value, Model):
            hashed.update(f"{type(value).__name__} {value.model_dump_json()}".encode())
        else:
            hashed.update(repr(value).encode())
    return hashed.digest()
