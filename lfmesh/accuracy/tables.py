"""The rows of an accuracy report as tables: CSV with every digit, and rounded columns."""

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict, fields
from typing import TypeVar

from lfmesh.accuracy.image_efficiency import ImageRow
from lfmesh.accuracy.lens_accuracy import LensRow

Row = TypeVar("Row", LensRow, ImageRow)

WAY_TITLE = {"lens": "the lens alone", "camera": "the whole camera, through the microlenses"}

PARSERS = {str: str, int: int, float: float}


def csv_table(rows: Sequence[LensRow] | Sequence[ImageRow]) -> str:
    """Return rows as CSV, with all fields and digits."""
    text = io.StringIO()
    if rows:
        writer = csv.DictWriter(text, [field.name for field in fields(rows[0])], lineterminator="\n")
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    return text.getvalue()


def read_csv(text: str, kind: type[Row]) -> list[Row]:
    """Return the rows from the text of `csv_table`."""
    types = {field.name: field.type for field in fields(kind)}
    return [
        kind(**{name: PARSERS[types[name]](value) for name, value in line.items()})  # type: ignore[index]
        for line in csv.DictReader(io.StringIO(text))
    ]


def lens_columns(row: LensRow) -> dict[str, str]:
    """Return the page's columns of a row, by heading."""
    return {
        "surface": row.surface,
        "triangles": f"{row.triangles:,}",
        "rms / mm": f"{row.rms_mm:.1e}",
        "max / mm": f"{row.max_mm:.1e}",
        "rms / pixels": _few_digits(row.rms_px),
        "max / pixels": _few_digits(row.max_px),
        "weight, rms": _share(row.rms_weight),
        "weight, max": _share(row.max_weight),
        "other lenslet": _share(row.elsewhere),
        "astray": _share(row.astray),
        "lost": _share(row.lost),
        "asked again": _share(row.requeried),
        "build / s": f"{row.build_seconds:.2f}",
        "tables / MB": f"{row.table_bytes / 1e6:.1f}",
        "process / MB": _megabytes(row.process_bytes),
        "million events / s": f"{row.events_per_second / 1e6:.2f}",
    }


def short_lens_columns(row: LensRow) -> dict[str, str]:
    """Return the columns that fit a terminal of 80 characters."""
    return {
        "surface": row.surface,
        "trian-\ngles": f"{row.triangles:,}",
        "rms\nmm": f"{row.rms_mm:.0e}",
        "max\nmm": f"{row.max_mm:.0e}",
        "rms\npixels": _few_digits(row.rms_px),
        "max\npixels": _few_digits(row.max_px),
        "weight\nerror": _share(row.rms_weight),
        "\nastray": _share(max(row.astray, row.elsewhere)),
        "\nlost": _share(row.lost),
        "asked\nagain": _share(row.requeried),
        "build\ns": f"{row.build_seconds:.2f}",
        "\nMB": f"{max(row.table_bytes, row.process_bytes) / 1e6:.0f}",
        "Mev\n/s": f"{row.events_per_second / 1e6:.1f}",
    }


def short_image_columns(row: ImageRow) -> dict[str, str]:
    """Return the columns that fit a terminal of 80 characters."""
    headings = ("estimate", "sam-\nples", "time\ns", "rms\nerror", "typical\nerror", "effi-\nciency", "\n±", "\nz")
    return dict(zip(headings, image_columns(row).values(), strict=True))


def image_columns(row: ImageRow) -> dict[str, str]:
    """Return the page's columns of a row, by heading."""
    known = row.mse > 0.0
    return {
        "estimate": row.way,
        "samples": f"{row.samples}",
        "time / s": f"{row.seconds:.2f}",
        "rms error": f"{row.mse**0.5:.3g}" if known else "?",
        "typical": f"{row.typical:.2g}",
        "1/(MSE·t), 1/s": f"{row.efficiency:.2g}" if known else "?",
        "±": f"{row.efficiency_error:.1g}" if known else "",
        "z": f"{row.bias_z:+.1f}",
    }


def _few_digits(value: float) -> str:
    return f"{value:.2g}" if 1e-3 <= value < 99.5 else f"{value:.0e}"


def _share(value: float) -> str:
    if value == 0.0:
        return "0"
    return f"{value:.2g}" if value >= 0.1 else f"{value:.0e}"


def _megabytes(count: int) -> str:
    return f"{count / 1e6:.1f}" if count > 0 else "–"
