"""The accuracy report as one HTML page that loads nothing."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from lfmesh.accuracy import figures, verdict
from lfmesh.accuracy.image_efficiency import WAYS, ImageStudy
from lfmesh.accuracy.lens_accuracy import LENS_ALONE, LensStudy
from lfmesh.accuracy.tables import WAY_TITLE, image_columns, lens_columns
from lfmesh.templates import filled

TEMPLATE = Path(__file__).parent / "templates" / "report.html"


def page(lenses: Sequence[LensStudy], images: ImageStudy | None, title: str, made_on: str) -> str:
    """Return the whole report as HTML.

    Parameters
    ----------
    lenses : sequence of LensStudy
    images : ImageStudy or None
        None if the scene has no light.
    title : str
    made_on : str
        Versions and machine.
    """
    return filled(
        TEMPLATE,
        title=title,
        made_on=made_on,
        summaries=[verdict.lens_summary(study) for study in lenses] if len(lenses) > 1 else [],
        in_short=_in_short(lenses, images),
        lenses=[_lens_part(study) for study in lenses],
        images=_image_part(images) if images is not None else None,
        no_light=verdict.NO_LIGHT,
    )


def _in_short(lenses: Sequence[LensStudy], images: ImageStudy | None) -> list[str]:
    """Return the recommendations at the top of the page."""
    lines = verdict.three_numbers(lenses[0]) if len(lenses) == 1 else []
    if images is not None:
        lines.append(verdict.most_efficient(images))
    return [_capital(line) for line in lines]


def _lens_part(study: LensStudy) -> dict[str, Any]:
    return {
        "name": study.name,
        "about_the_truth": verdict.about_the_truth(study),
        "ways": [_way_part(study, way) for way in study.ways],
    }


def _way_part(study: LensStudy, way: str) -> dict[str, Any]:
    rows = study.of(way)
    title = f"{study.name}: {WAY_TITLE[way]}"
    return {
        "title": _capital(WAY_TITLE[way]),
        "triangles": _figure(
            figures.error_against_triangles(rows, f"{title}, error against triangles", study.pixel_mm),
            verdict.about_triangles(study, way),
        ),
        "time": _figure(
            figures.error_against_time(rows, f"{title}, error against time", study.pixel_mm),
            verdict.about_time(study, way),
        ),
        "rows": [lens_columns(row) for row in rows],
        "whole_camera": way != LENS_ALONE,
    }


def _image_part(study: ImageStudy) -> dict[str, Any]:
    return {
        "scene": study.scene,
        "ways": WAYS,
        "efficiency": _figure(
            figures.efficiency(study.rows, f"{study.scene}: efficiency, from each way's largest run"),
            verdict.about_images(study),
        ),
        "time": _figure(
            figures.image_error_against_time(study.rows, f"{study.scene}: error against time", study.reference_error),
            verdict.about_image_time(study),
        ),
        "rows": [image_columns(row) for row in study.rows],
    }


def _figure(svg: str, words: str) -> dict[str, str]:
    return {"svg": Markup(svg), "words": words}  # drawn by matplotlib, which escapes its texts


def _capital(text: str) -> str:
    return text[0].upper() + text[1:]
