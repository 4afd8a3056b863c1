"""The accuracy report as files: CSV tables and one HTML page that loads nothing."""

import csv
import html
import io
from collections.abc import Iterable, Sequence
from dataclasses import asdict, fields
from typing import Any

from lfmesh.study import figures, verdict
from lfmesh.study.image_efficiency import ImageRow, ImageStudy
from lfmesh.study.lens_accuracy import LENS_ALONE, LensRow, LensStudy

STYLE = """
body { font: 16px/1.5 sans-serif; color: #222; background: #fff; max-width: 60em; margin: 2em auto; padding: 0 1em }
h1, h2, h3 { line-height: 1.2; font-weight: 600 }
h2 { margin-top: 2.5em; border-bottom: 1px solid #ddd }
figure { margin: 1.5em 0 }
figure svg { max-width: 100%; height: auto }
figcaption { max-width: 46em }
.numbers { overflow-x: auto }
table { border-collapse: collapse; font-size: 13px; font-variant-numeric: tabular-nums }
th, td { padding: .15em .7em; text-align: right; white-space: nowrap }
th { border-bottom: 1px solid #888; vertical-align: bottom; white-space: normal }
td:first-child, th:first-child { text-align: left }
tr.first td { border-top: 1px solid #ddd }
"""

WAY_TITLE = {"lens": "the lens alone", "camera": "the whole camera, through the microlenses"}


def csv_table(rows: Sequence[LensRow] | Sequence[ImageRow]) -> str:
    """Return rows as CSV, all fields, every digit."""
    text = io.StringIO()
    if rows:
        writer = csv.DictWriter(text, [field.name for field in fields(rows[0])], lineterminator="\n")
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)
    return text.getvalue()


def page(lenses: Sequence[LensStudy], images: ImageStudy | None, title: str, made_on: str) -> str:
    """Return the whole report as HTML.

    Parameters
    ----------
    made_on : str
        Versions and machine, in a line.
    """
    body = [f"<h1>{_text(title)}</h1>", f"<p>{_text(made_on)}</p>"]
    for study in lenses:
        body += _lens_part(study)
    if images is not None:
        body += _image_part(images)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{_text(title)}</title><style>{STYLE}</style></head>\n<body>\n" + "\n".join(body) + "\n</body></html>\n"
    )


def lens_columns(row: LensRow) -> dict[str, str]:
    """Return what a table shows of a row, by heading."""
    return {
        "surface": row.surface,
        "triangles": f"{row.triangles:,}",
        "rms / mm": f"{row.rms_mm:.1e}",
        "max / mm": f"{row.max_mm:.1e}",
        "rms / pixel": f"{row.rms_px:.2g}",
        "weight rms": f"{row.rms_weight:.0e}",
        "other lenslet": _share(row.elsewhere),
        "astray": _share(row.astray),
        "lost": _share(row.lost),
        "asked again": _share(row.requeried),
        "build / s": f"{row.build_seconds:.2f}",
        "tables / MB": f"{row.table_bytes / 1e6:.1f}",
        "grown / MB": f"{row.process_bytes / 1e6:.1f}",
        "Mevents/s": f"{row.events_per_second / 1e6:.2f}",
    }


def image_columns(row: ImageRow) -> dict[str, str]:
    """Return what a table shows of a row, by heading."""
    return {
        "estimate": row.way,
        "samples": f"{row.samples}",
        "time / s": f"{row.seconds:.2f}",
        "rms error": f"{row.mse**0.5:.3g}" if row.mse > 0.0 else "below the reference's",
        "efficiency · s": f"{row.efficiency:.3g}",
        "±": f"{row.efficiency_error:.1g}",
        "whole power, z": f"{row.bias_z:+.1f}",
    }


def _lens_part(study: LensStudy) -> list[str]:
    parts = [f"<h2>{_text(study.name)}</h2>", f"<p>{_text(verdict.about_the_truth(study))}</p>"]
    for way in study.ways:
        rows = study.of(way)
        title = f"{study.name}: {WAY_TITLE[way]}"
        parts += [
            f"<h3>{_text(WAY_TITLE[way].capitalize())}</h3>",
            _figure(
                figures.error_against_triangles(rows, title, study.pixel_mm),
                "Error against triangles; lines: rms, dots: largest. " + verdict.about_triangles(study, way),
            ),
            _figure(
                figures.error_against_time(rows, title, study.pixel_mm),
                "Error against time; numbers: triangles a surface. " + verdict.about_time(study, way),
            ),
            _table([lens_columns(row) for row in rows], "surface"),
        ]
    if LENS_ALONE in study.ways and len(study.ways) > 1:
        parts.append(
            "<p>Through the microlenses a ray that an error carries over the border of a lenslet lands under the next one: "
            "such rays are counted as another lenslet and left out of the rms.</p>"
        )
    return parts


def _image_part(study: ImageStudy) -> list[str]:
    return [
        f"<h2>Images of {_text(study.scene)}</h2>",
        _figure(figures.image_error_against_time(study), "Error against time. " + verdict.about_images(study)),
        _table([image_columns(row) for row in study.rows], "estimate"),
        "<p>z: by how many standard errors the image's whole power differs from the reference's; all ways estimate the "
        "same image.</p>",
    ]


def _figure(svg: str, words: str) -> str:
    return f"<figure>{svg}<figcaption>{_text(words)}</figcaption></figure>"


def _table(rows: Iterable[dict[str, str]], grouped_by: str) -> str:
    rows = list(rows)
    head = "".join(f"<th>{_text(name)}</th>" for name in rows[0])
    lines, previous = [], ""
    for row in rows:
        mark = ' class="first"' if row[grouped_by] != previous else ""
        previous = row[grouped_by]
        lines.append(f"<tr{mark}>" + "".join(f"<td>{_text(value)}</td>" for value in row.values()) + "</tr>")
    return f'<div class="numbers"><table><tr>{head}</tr>\n' + "\n".join(lines) + "</table></div>"


def _share(value: float) -> str:
    return "0" if value == 0.0 else f"{value:.1e}"


def _text(value: Any) -> str:
    return html.escape(str(value))
