"""PNG with 16 bits per colour channel, which Pillow cannot write."""

import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_TRUE_COLOUR = 2


def write_rgb16(path: Path, counts: NDArray[np.uint16]) -> None:
    """Write (H, W, 3) counts unchanged, without a transfer curve (ISO/IEC 15948)."""
    height, width, _ = counts.shape
    lines = np.zeros((height, 1 + 6 * width), np.uint8)  # each line begins with its filter type: none
    lines[:, 1:] = np.ascontiguousarray(counts, dtype=">u2").view(np.uint8).reshape(height, -1)
    header = struct.pack(">IIBBBBB", width, height, 16, _TRUE_COLOUR, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(lines.tobytes(), 6)), (b"IEND", b"")]
    path.write_bytes(_SIGNATURE + b"".join(_chunk(kind, content) for kind, content in chunks))


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
