"""Matplotlib figures as files: extension and folder are checked before drawing, and the bytes are reproducible."""

import io
import re
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfmesh.errors import FileError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PICTURES = (".svg", ".png", ".pdf")
"""File extensions that matplotlib writes."""

PNG_DPI = 150


def checked_kind(path: Path, what: str, endings: Collection[str] = PICTURES) -> str:
    """Return the kind of file for a path, such as "svg".

    Parameters
    ----------
    path : Path
    what : str
        The drawing in words, for the message: "a lens sheet".
    endings : collection of str
        Valid extensions.

    Raises
    ------
    FileError
        The extension is invalid, or the folder does not exist.
    """
    ending = path.suffix.lower()
    if ending not in endings:
        found = f"ends in {path.suffix}" if path.suffix else "has no ending"
        raise FileError(f"{path}: {found}; {what} must end in one of {', '.join(endings)}")
    if not path.parent.is_dir():
        raise FileError(f"{path}: the folder {path.parent} does not exist; create it, or give another")
    return ending.lstrip(".")


def encoded_figure(figure: "Figure", kind: str, title: str | None = None, dpi: float = PNG_DPI) -> bytes:
    """Return a figure as the bytes of a file, reproducible because it contains no dates or versions.

    SVG numbers its parts by `svg.hashsalt` of the current style, which must be set.

    Parameters
    ----------
    figure : Figure
    kind : {"svg", "png", "pdf"}
    title : str, optional
        Title in the file's metadata.
    dpi : float
        Pixels per inch of a PNG, and of rasterised parts in other formats.
    """
    metadata: dict[str, dict[str, Any]] = {
        "svg": {"Date": None, "Creator": None, "Title": title},
        "png": {"Software": None},
        "pdf": {"CreationDate": None, "Creator": None, "Producer": None, "Title": title},
    }
    content = io.BytesIO()
    figure.savefig(content, format=kind, dpi=dpi, metadata=metadata[kind])
    return content.getvalue()


def inline_svg(svg: bytes) -> str:
    """Return an SVG file as an element for an HTML page."""
    text = svg.decode()
    return re.sub(r"\s*<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
