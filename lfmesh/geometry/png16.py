"""PNG files of 16 bits a channel in colour (or with transparency), which Pillow would cut to 8 bits.

Follows the PNG specification, third edition (W3C 2025): chunks in section 5, filters in section 9.
"""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import FileError
from lfmesh.kernel import kernel

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEADER_END = 33
_CHANNELS = {2: 3, 4: 2, 6: 4}
"""By colour type: RGB, grey with alpha, RGB with alpha."""


def is_deep_png(path: Path) -> bool:
    """Tell whether a file is a PNG of 16 bits and of a colour type that Pillow reads with 8."""
    with path.open("rb") as file:
        head = file.read(_HEADER_END)
    return len(head) == _HEADER_END and head.startswith(_SIGNATURE) and head[24] == 16 and head[25] in _CHANNELS


def read_deep_png(path: Path) -> NDArray[np.float64]:
    """Return (h, w, 3) values from 0 to 1, as coded in the file.

    Raises
    ------
    FileError
        The file is cut short, broken or interlaced.
    """
    data = path.read_bytes()
    width, height, _, colour_type, _, _, interlaced = struct.unpack(">IIBBBBB", data[16:29])
    if interlaced:
        raise FileError(f"{path}: an interlaced 16-bit PNG; save it without interlacing")
    channels = _CHANNELS[colour_type]
    stride = 1 + 2 * channels * width
    try:
        packed = zlib.decompress(b"".join(body for kind, body in _chunks(data) if kind == b"IDAT"))
    except (zlib.error, struct.error) as error:
        raise FileError(f"{path}: a broken picture ({error}); a texture is a PNG or JPEG") from None
    if len(packed) < stride * height:
        raise FileError(f"{path}: a broken picture (cut short); a texture is a PNG or JPEG")
    rows = np.frombuffer(packed, dtype=np.uint8, count=stride * height).reshape(height, stride)
    octets = _unfiltered(rows[:, 0], rows[:, 1:], 2 * channels)
    coded = octets.view(">u2").reshape(height, width, channels) / 65535.0
    return coded[:, :, [0, 0, 0] if colour_type == 4 else [0, 1, 2]]


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    at = len(_SIGNATURE)
    while at + 8 <= len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        yield kind, data[at + 8 : at + 8 + length]
        at += 12 + length


@kernel
def _unfiltered(filters: NDArray[np.uint8], rows: NDArray[np.uint8], step: int) -> NDArray[np.uint8]:
    """Undo each row's filter; `step` is the number of bytes a pixel."""
    out = np.zeros_like(rows)
    for r in range(rows.shape[0]):
        kind = filters[r]
        for i in range(rows.shape[1]):
            left = int(out[r, i - step]) if i >= step else 0
            above = int(out[r - 1, i]) if r > 0 else 0
            corner = int(out[r - 1, i - step]) if r > 0 and i >= step else 0
            guess = 0
            if kind == 1:
                guess = left
            elif kind == 2:
                guess = above
            elif kind == 3:
                guess = (left + above) // 2
            elif kind == 4:
                guess = _paeth(left, above, corner)
            out[r, i] = (int(rows[r, i]) + guess) & 255
    return out


@kernel
def _paeth(left: int, above: int, corner: int) -> int:
    """Return which of the three neighbours is closest to left + above - corner."""
    to_left, to_above, to_corner = abs(above - corner), abs(left - corner), abs(left + above - 2 * corner)
    if to_left <= to_above and to_left <= to_corner:
        return left
    return above if to_above <= to_corner else corner
