"""Numbers and bytes in a glTF file: buffers, their views, and accessors.

glTF 2.0, sections 3.6 and 5.1: an accessor has a number of entries of one type, stored with a stride in a view of a
buffer, or zero. A sparse accessor replaces some of them. Integers may stand for fractions of 1.
"""

import base64
import binascii
from functools import cached_property
from os import SEEK_END
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import MeshError
from lfmesh.geometry.files.companion import check_companion
from lfmesh.geometry.files.pictures import companion_name
from lfmesh.geometry.meshes.mesh import Array, Index
from lfmesh.regular_file import open_regular, read_bytes

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""Number types by glTF's codes (section 5.1.3)."""

TYPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
"""Numbers per entry, for the types that meshes use (section 5.1.6)."""

LONGEST_STRIDE = 252
"""Most bytes from one entry to the next (section 5.11)."""

MOST_ZEROS = 10_000_000
"""Most entries of an accessor without stored data."""


def names_of(uri: str) -> list[str]:
    """Return the files that a URI may mean: percent-decoded, as it should be, or unchanged."""
    return list(dict.fromkeys((unquote(uri), uri)))


class Buffers:
    """Buffers, views and accessors of one glTF file.

    Parameters
    ----------
    path : Path
    document : dict
        JSON of the file.
    """

    def __init__(self, path: Path, document: dict[str, Any]) -> None:
        self.path, self.document = path, document
        self._contents: dict[int, bytes] = {}
        self._views: dict[int, bytes] = {}

    def _entry(self, key: str, number: Any) -> dict[str, Any]:
        entries = self.document.get(key, [])
        if isinstance(number, int) and not isinstance(number, bool) and 0 <= number < len(entries):
            return entries[number]
        raise ValueError(f"{key}[{repr(number)[:40]}] is named, but there are {len(entries)}, counted from 0")

    @cached_property
    def _chunk(self) -> tuple[int, int]:
        """Position and length of the binary chunk in a GLB file."""
        return binary_chunk(self.path)

    def _is_chunk(self, number: int) -> bool:
        """Tell whether a buffer is the binary chunk of a GLB file."""
        return number == 0 and self._entry("buffers", number).get("uri") is None and self.path.suffix.lower() == ".glb"

    def _content(self, number: int) -> bytes:
        """Return the bytes of a buffer other than the binary chunk."""
        uri = self._entry("buffers", number).get("uri")
        if uri is None:
            raise ValueError(f"buffers[{number}] has no uri, as with an extension that is not supported")
        if number not in self._contents:
            self._contents[number] = bytes_of(self.path, uri, "buffer")
        return self._contents[number]

    def view(self, number: Any) -> tuple[memoryview, int]:
        """Return the bytes of a view, and its stride, or 0 if it has none."""
        entry = self._entry("bufferViews", number)
        buffer = entry.get("buffer")
        self._entry("buffers", buffer)
        assert isinstance(buffer, int)
        size = self._chunk[1] if self._is_chunk(buffer) else len(self._content(buffer))
        start, length = _whole(entry, "byteOffset", 0), _whole(entry, "byteLength", None)
        if start + length > size:
            raise ValueError(
                f"cut short: bufferViews[{number}] ends at byte {start + length}, but its buffer has {size}"
            )
        if not self._is_chunk(buffer):
            return memoryview(self._content(buffer))[start : start + length], _whole(entry, "byteStride", 0)
        if number not in self._views:
            # Read no more of the file: a scene may use each of its hundreds of nodes as a separate target.
            with open_regular(self.path) as file:
                file.seek(self._chunk[0] + start)
                self._views[number] = file.read(length)
        return memoryview(self._views[number]), _whole(entry, "byteStride", 0)

    def accessor(self, number: Any, types: tuple[str, ...]) -> Array:
        """Return the numbers of an accessor, (count, components) float64.

        Parameters
        ----------
        number : int
        types : tuple of str
            Valid types.
        """
        values, normalized = self._numbers(number, types)
        made = values.astype(np.float64)
        if normalized and values.dtype.kind in "iu":
            # Section 3.11: two signed integers map to −1.
            made = np.maximum(made / np.iinfo(values.dtype).max, -1.0)
        return made

    def indices(self, number: Any) -> Index:
        """Return the integers of an accessor, (count,)."""
        values, _ = self._numbers(number, ("SCALAR",))
        if values.dtype.kind != "u":
            raise ValueError(f"accessors[{number}] must hold unsigned whole numbers, as indices")
        return values[:, 0].astype(np.int64)

    def _numbers(self, number: Any, types: tuple[str, ...]) -> tuple[NDArray[Any], bool]:
        """Return the stored numbers of an accessor, and whether they are fractions of 1."""
        entry = self._entry("accessors", number)
        where = f"accessors[{number}]"
        kind = entry.get("type")
        if kind not in types or kind not in TYPES:
            raise ValueError(f"{where}.type is {repr(kind)[:40]}; valid are {', '.join(types)}")
        count = _whole(entry, "count", None)
        dtype = _dtype(where, entry.get("componentType"))
        values = self._stored(where, entry, dtype, TYPES[kind], count)
        if "sparse" in entry:
            values = self._with_sparse(where, entry["sparse"], values, dtype)
        return values, bool(entry.get("normalized"))

    def _stored(self, where: str, entry: dict[str, Any], dtype: np.dtype[Any], width: int, count: int) -> Array:
        if "bufferView" not in entry:
            if count > MOST_ZEROS:
                raise ValueError(f"{where} has {count} entries that are not stored; the limit is {MOST_ZEROS}")
            return np.zeros((count, width), dtype)
        view, stride = self.view(entry["bufferView"])
        return _strided(where, view, dtype, (count, width), _whole(entry, "byteOffset", 0), stride)

    def _with_sparse(self, where: str, sparse: Any, values: Array, dtype: np.dtype[Any]) -> Array:
        """Return stored numbers with the replacements of a sparse accessor (section 3.6.2.3)."""
        if not isinstance(sparse, dict) or not all(isinstance(sparse.get(key), dict) for key in ("indices", "values")):
            raise ValueError(f"{where}.sparse has no indices and values")
        count = _whole(sparse, "count", None)
        found = []
        for key, kind, width in (
            ("indices", _dtype(where, sparse["indices"].get("componentType")), 1),
            ("values", dtype, values.shape[1]),
        ):
            view, _ = self.view(sparse[key].get("bufferView"))
            offset = _whole(sparse[key], "byteOffset", 0)
            found.append(_strided(f"{where}.sparse.{key}", view, kind, (count, width), offset, 0))
        places = found[0][:, 0]
        if count and not 0 <= places.min() <= places.max() < len(values):
            raise ValueError(f"{where}.sparse replaces entry {places.max()}, but there are {len(values)}")
        made = values.copy()
        made[places] = found[1]
        return made


def _strided(
    where: str, view: memoryview, dtype: np.dtype[Any], shape: tuple[int, int], offset: int, stride: int
) -> Array:  # fmt: skip
    """Return the numbers of a view from an offset on, without a copy."""
    count, width = shape
    size = width * dtype.itemsize
    stride = stride or size
    if not size <= stride <= LONGEST_STRIDE:
        raise ValueError(f"{where} has a stride of {stride} bytes; valid are {size} to {LONGEST_STRIDE}")
    if count and offset + stride * (count - 1) + size > len(view):
        raise ValueError(f"cut short: {where} counts {count} entries, more than its view of {len(view)} bytes holds")
    if not count:
        return np.zeros(shape, dtype)
    return np.ndarray(shape, dtype, view, offset, (stride, dtype.itemsize))


def _dtype(where: str, component: Any) -> np.dtype[Any]:
    if not isinstance(component, int) or component not in COMPONENTS:
        raise ValueError(
            f"{where}.componentType is {repr(component)[:40]}; valid are {', '.join(map(str, COMPONENTS))}"
        )
    return np.dtype(COMPONENTS[component])


def _whole(entry: dict[str, Any], key: str, default: int | None) -> int:
    value = entry.get(key, default)
    if isinstance(value, int) and not isinstance(value, bool) and value >= 0:
        return value
    raise ValueError(f"{key} is {repr(value)[:40]}; valid are whole numbers from 0")


def binary_chunk(path: Path) -> tuple[int, int]:
    """Return position and length of the binary chunk of a GLB file; length 0 if it has none.

    It follows the JSON chunk (glTF 2.0, section 4.4). For a truncated chunk, the length is that of the existing part.
    """
    with open_regular(path) as file:
        start = 28 + int.from_bytes(file.read(20)[12:16], "little")
        file.seek(start - 8)
        head = file.read(8)
        if head[4:] != b"BIN\0":
            return start, 0
        return start, min(int.from_bytes(head[:4], "little"), file.seek(0, SEEK_END) - start)


def bytes_of(path: Path, uri: Any, kind: str) -> bytes:
    """Return the data in a URI, or the content of the file beside the glTF file that it names.

    Parameters
    ----------
    path : Path
    uri : str
    kind : str
        Kind of data in messages.

    Raises
    ------
    MeshError
        The file does not exist, or is elsewhere.
    ValueError
        The URI holds no data.
    """
    if not isinstance(uri, str):
        raise ValueError(f"the uri of a {kind} is {repr(uri)[:40]}; valid is text")
    if uri.startswith("data:"):
        head, _, data = uri.partition(",")
        try:
            return (
                base64.b64decode(unquote(data), validate=False) if head.endswith(";base64") else unquote(data).encode()
            )
        except binascii.Error as error:
            raise ValueError(f"the data of a {kind} are not encoded as stated ({error})") from None
    name = companion_name(path, names_of(uri), kind)
    if name is None:
        shown = names_of(uri)[0]
        check_companion(path, shown, kind)
        raise MeshError(f"{path}: its {kind} {shown[:200]} is missing; put it beside the mesh")
    return read_bytes(path.parent / name)
