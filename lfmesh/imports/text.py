"""Text files of other programs: UTF-8, UTF-16 with or without byte-order mark, or Latin-1, up to a limit."""

from pathlib import Path

from lfmesh.errors import SceneError
from lfmesh.regular_file import open_regular

MOST_BYTES = 8_000_000
MOST_LINES = 100_000
"""Far more than any lens file, and read in well under a second."""

_MARKS = {b"\xff\xfe": "utf-16-le", b"\xfe\xff": "utf-16-be", b"\xef\xbb\xbf": "utf-8"}


def command_names(text: str) -> frozenset[str]:
    """Return the space-separated names in a text."""
    return frozenset(text.split())


def read_lines(path: Path) -> list[str]:
    """Return the lines of a text file.

    Raises
    ------
    SceneError
        The file cannot be read, is too large, or is not text.
    """
    try:
        with open_regular(path) as file:
            data = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise SceneError(f"{path}: cannot be read: {error.strerror}") from None
    if len(data) > MOST_BYTES:
        raise SceneError(f"{path}: larger than {MOST_BYTES // 1_000_000} MB; a lens file has a few kilobytes")
    text = _decoded(data, path)
    lines = text.splitlines()
    if len(lines) > MOST_LINES:
        raise SceneError(f"{path}: more than {MOST_LINES} lines; a lens file has hundreds")
    return lines


def _decoded(data: bytes, path: Path) -> str:
    """Decode by the byte-order mark, else by the pattern of zero bytes, else as UTF-8 or Latin-1."""
    mark = next((mark for mark in _MARKS if data.startswith(mark)), b"")
    encoding = _MARKS.get(mark, "utf-8")
    if not mark:
        # Plain text in UTF-16 has a zero in every pair of bytes.
        if data[1:400:2] and not any(data[1:400:2]):
            encoding = "utf-16-le"
        elif data[0:400:2] and not any(data[0:400:2]):
            encoding = "utf-16-be"
    body = data[len(mark) :]
    try:
        text = body.decode(encoding)
    except UnicodeDecodeError as error:
        if encoding != "utf-8":
            raise SceneError(
                f"{path}: byte {len(mark) + error.start} is not {encoding}: the file is cut short"
            ) from None
        text = body.decode("latin-1")
    strange = sum(sign < " " and sign not in "\t\r\n\f\x1a" for sign in text)
    if strange:
        signs = f"control character{'' if strange == 1 else 's'}"
        raise SceneError(f"{path}: not text: it holds {strange} {signs}; a lens file is plain text")
    return text
