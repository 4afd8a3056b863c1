"""The accuracy report as one HTML page that loads nothing."""

import html
from collections.abc import Iterable, Sequence
from typing import Any

from lfmesh.accuracy import figures, verdict
from lfmesh.accuracy.image_efficiency import WAYS, ImageStudy
from lfmesh.accuracy.lens_accuracy import LENS_ALONE, LensStudy
from lfmesh.accuracy.tables import WAY_TITLE, image_columns, lens_columns

STYLE = """
:root { color-scheme: light }
body { font: 16px/1.55 system-ui, sans-serif; color: #222; background: #fff; max-width: 64em; margin: 2.5em auto;
  padding: 0 1.2em }
p, li, figure, .short { max-width: 52em }
h1, h2, h3 { line-height: 1.2; font-weight: 600; margin-bottom: .4em }
h2 { margin-top: 2.6em; padding-bottom: .2em; border-bottom: 1px solid #ccc }
h3 { margin-top: 1.8em }
.made { color: #666; font-size: 14px; margin-top: 0 }
.short { background: #f4f6f8; border-left: 4px solid #1f4e8c; padding: .7em 1.2em }
.short ul { margin: .3em 0; padding-left: 1.2em }
figure { margin: 1.2em 0 1.8em }
figure svg { max-width: 100%; height: auto; display: block }
figure svg { margin-left: -.5em }
figcaption { margin-top: .5em }
.numbers { overflow-x: auto; margin: 1em 0 }
table { border-collapse: collapse; font-size: 12px; line-height: 1.35; font-variant-numeric: tabular-nums }
th, td { padding: .18em .5em; text-align: right; white-space: nowrap }
th { border-bottom: 1px solid #888; vertical-align: bottom; white-space: normal; font-weight: 600 }
td:first-child, th:first-child { text-align: left; padding-left: 0 }
tr.first td { border-top: 1px solid #ddd }
.note { font-size: 14px; color: #555 }
"""


def page(lenses: Sequence[LensStudy], images: ImageStudy | None, title: str, made_on: str) -> str:
    """Return the whole report as HTML.

    Parameters
    ----------
    made_on : str
        Versions and machine, in a line.
    """
    body = [f"<h1>{_text(title)}</h1>", f'<p class="made">{_text(made_on)}</p>', _in_short(lenses, images)]
    for study in lenses:
        body += _lens_part(study)
    body += _image_part(images) if images is not None else [f"<h2>Images</h2><p>{verdict.NO_LIGHT}</p>"]
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{_text(title)}</title><style>{STYLE}</style></head>\n<body>\n" + "\n".join(body) + "\n</body></html>\n"
    )


def _in_short(lenses: Sequence[LensStudy], images: ImageStudy | None) -> str:
    """Return what to choose, before all figures; of several lenses a line each in a table."""
    lines = verdict.three_numbers(lenses[0]) if len(lenses) == 1 else []
    if images is not None:
        lines.append(verdict.most_efficient(images))
    items = "".join(f"<li>{_text(_capital(line))}</li>" for line in lines)
    table = _table([verdict.lens_summary(study) for study in lenses], "lens") if len(lenses) > 1 else ""
    return f'<div class="short"><b>In short</b>{table}<ul>{items}</ul></div>'


def _lens_part(study: LensStudy) -> list[str]:
    parts = [f"<h2>{_text(study.name)}</h2>", f"<p>{_text(verdict.about_the_truth(study))}</p>"]
    for way in study.ways:
        rows = study.of(way)
        title = f"{study.name}: {WAY_TITLE[way]}"
        parts += [
            f"<h3>{_text(_capital(WAY_TITLE[way]))}</h3>",
            _figure(
                figures.error_against_triangles(rows, f"{title}, error against triangles", study.pixel_mm),
                verdict.about_triangles(study, way),
            ),
            _figure(
                figures.error_against_time(rows, f"{title}, error against time", study.pixel_mm),
                verdict.about_time(study, way),
            ),
            _table([lens_columns(row) for row in rows], "surface"),
            f'<p class="note">{_text(LENS_NOTE if way == LENS_ALONE else LENS_NOTE + CAMERA_NOTE)}</p>',
        ]
    return parts


LENS_NOTE = (
    "Weight: relative error of the power that a ray brings. Astray: share of rays that end elsewhere than in the "
    "truth, at an aperture's edge or nowhere. Lost: share of the power. Asked again: share of events whose query was "
    "repeated. Process: by how much it grew, Embree's trees included. Events are counted on one core."
)
CAMERA_NOTE = (
    " Other lenslet: share of rays that an error carries over a lenslet's border, to land half a lenslet or more from "
    "where they should; they are in the maximum, not in the rms."
)


def _image_part(study: ImageStudy) -> list[str]:
    return [
        f"<h2>Images of {_text(study.scene)}</h2>",
        _ways(),
        _figure(
            figures.efficiency(study.rows, f"{study.scene}: efficiency, from each way's largest run"),
            verdict.about_images(study),
        ),
        _figure(
            figures.image_error_against_time(study.rows, f"{study.scene}: error against time", study.reference_error),
            verdict.about_image_time(study),
        ),
        _table([image_columns(row) for row in study.rows], "estimate"),
        '<p class="note">Rms error: over all pixels, relative to the image\'s rms. Typical: median over the lit pixels '
        "of the error's size, relative to the same. z: by how many standard errors the image's whole power differs "
        "from the reference's. Processor time: of all cores.</p>",
    ]


def _ways() -> str:
    items = "".join(f"<li><b>{_text(way.name)}</b>: {_text(way.means)}</li>" for way in WAYS)
    return f"<ul>{items}</ul>"


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]


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


def _text(value: Any) -> str:
    return html.escape(str(value))
