"""Figures for merits and constraints, with values of those from the solved scene."""

import math
from collections.abc import Callable
from dataclasses import fields
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.scene import FirstOrder, Scene
from lfmesh.scene.camera.lens import Lens
from lfmesh.scene.first_order.paraxial import quotient
from lfmesh.study.metrics.metrics import METRICS

Array = NDArray[np.float64]


class Figure(NamedTuple):
    """A figure of a camera.

    Attributes
    ----------
    title : str
        Title in words.
    source : str
        Origin: "rays", traced with derivatives; "camera", the solved scene; "render", pictures as in a study.
    ideal : float or None
        Best possible value; None if the user must state it.
    shown : str
        Reduction of several values to one in reports: "rms", "mean" or "least".
    """

    title: str
    source: Literal["rays", "camera", "render"]
    ideal: float | None = None
    shown: Literal["rms", "mean", "least"] = "mean"


class CameraFigure(NamedTuple):
    """A figure that depends only on the solved scene."""

    title: str
    of: Callable[[Scene, FirstOrder], float | list[float]]
    shown: Literal["mean", "least"] = "mean"


def _glass_edges(scene: Scene, _: FirstOrder) -> list[float]:
    lens = _measurable(scene.camera.lens)
    return [lens.edge_mm(i) for i in range(len(lens.surfaces)) if lens.has_glass_behind(i)]


def _glass_centres(scene: Scene, _: FirstOrder) -> list[float]:
    lens = scene.camera.lens
    return [each.thickness_mm or 0.0 for i, each in enumerate(lens.surfaces) if lens.has_glass_behind(i)]


def _air_spaces(scene: Scene, _: FirstOrder) -> list[float]:
    lens = _measurable(scene.camera.lens)
    spaces = [math.inf]
    for number, (front, back) in enumerate(zip(lens.surfaces, lens.surfaces[1:], strict=False)):
        if not lens.has_glass_behind(number):
            edge = min(front.semi_diameter_mm or math.inf, back.semi_diameter_mm or math.inf)
            spaces += [front.thickness_mm or 0.0, lens.gap_mm(number, edge)]
    return spaces[1:] or spaces


def _measurable(lens: Lens) -> Lens:
    if lens.has_meshes:
        raise LfmeshError("the lens has surfaces that are meshes, whose edges are not measured")
    return lens


def _total_length(scene: Scene, _: FirstOrder) -> float:
    camera = scene.camera
    behind = camera.sensor.distance_mm or math.nan
    if camera.mla is not None:
        behind += (camera.mla.distance_mm or math.nan) + camera.mla.thickness_mm
    return camera.lens.vertices_mm[-1] + behind


def _micro_image_fill(_: Scene, facts: FirstOrder) -> float:
    return quotient(facts.micro_image_diameter_px or math.nan, facts.micro_image_pitch_px or math.nan)


def _depth_resolution(_: Scene, facts: FirstOrder) -> float:
    if not facts.refocused_mm:
        return facts.far_mm - facts.near_mm
    in_focus = facts.refocused_mm[1]
    return in_focus[2] - in_focus[1]


SPOTS = {
    "spot_rms_mm": Figure("rms radius of spots about their centroids, all fields / mm", "rays", 0.0, "rms"),
    "spot_chief_rms_mm": Figure("the same relative to the primary chief rays / mm", "rays", 0.0, "rms"),
    "mtf": Figure("geometric MTF at per_mm, tangential and sagittal", "rays", 1.0),
    "distortion": Figure("chief-ray heights divided by the paraxial heights, minus 1", "rays", 0.0, "rms"),
    "lateral_colour_mm": Figure("chief rays relative to the primary wavelength's / mm", "rays", 0.0, "rms"),
}
"""Figures of rays."""

CAMERA_FIGURES = {
    "edge_thickness_mm": CameraFigure("thickness of elements between their rims / mm", _glass_edges, "least"),
    "centre_thickness_mm": CameraFigure("thickness of elements on the axis / mm", _glass_centres, "least"),
    "air_space_mm": CameraFigure("spaces between elements, on the axis and at their edge / mm", _air_spaces, "least"),
    "total_length_mm": CameraFigure("from the first vertex to the sensor / mm", _total_length),
    "micro_image_fill": CameraFigure(
        "diameter of micro-images divided by their pitch: 1 if the f-numbers of lens and lenslets match, more if "
        "micro-images overlap", _micro_image_fill,
    ),
    "refocus_range_mm": CameraFigure("far_mm minus near_mm / mm", lambda _, facts: facts.far_mm - facts.near_mm),
    "depth_resolution_mm": CameraFigure(
        "depth that is sharp at once in a photograph of the plane in focus / mm", _depth_resolution
    ),
    "field_of_view_x_mm": CameraFigure("width seen in the plane in focus / mm", lambda _, at: at.field_of_view_mm[0]),
    "field_of_view_y_mm": CameraFigure("height seen in the plane in focus / mm", lambda _, at: at.field_of_view_mm[1]),
}  # fmt: skip
"""Figures of the solved scene in addition to the first-order report's."""

OF_REPORT = "of the first-order report"

FIRST_ORDER = tuple(field.name for field in fields(FirstOrder) if field.type in (float, float | None))
"""Numbers of the first-order report, by their names there."""

RENDERED = {column.name: column for metric in METRICS.values() for column in metric.columns}
"""Columns of a study's table."""

FIGURES: dict[str, Figure] = {
    **SPOTS,
    **{name: Figure(each.title, "camera", shown=each.shown) for name, each in CAMERA_FIGURES.items()},
    **{name: Figure(OF_REPORT, "camera") for name in FIRST_ORDER},
    **{
        name: Figure(column.title, "render", 0.0 if column.worse == "high" else None)
        for name, column in RENDERED.items()
    },
}
"""All figures by name."""


def figure_named(name: str) -> Figure | None:
    """Return the figure of a name, or None."""
    return FIGURES.get(name)


def camera_values(name: str, scene: Scene, facts: FirstOrder) -> Array:
    """Return the values of a figure of the solved scene, (k,).

    Parameters
    ----------
    name : str
    scene : Scene
        Solved.
    facts : FirstOrder
    """
    if name in CAMERA_FIGURES:
        return np.atleast_1d(np.asarray(CAMERA_FIGURES[name].of(scene, facts), dtype=np.float64))
    value = getattr(facts, name)
    return np.array([math.nan if value is None else value])


def shown_value(name: str, values: Array) -> float:
    """Reduce the values of a figure to the number in reports."""
    how = FIGURES[name].shown
    if not values.size:
        return math.nan
    if how == "rms":
        return float(np.sqrt(values @ values))
    return float(values.min() if how == "least" else values.mean())
