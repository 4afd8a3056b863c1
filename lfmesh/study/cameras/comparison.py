"""Results of a camera comparison, as plain values and as a table for the user."""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import PictureWarning
from lfmesh.files.json_values import plain_json

Array = NDArray[np.float64]

NOT_KNOWN = "not known"


@dataclass(frozen=True)
class Focus:
    """Slanted-edge MTF50 of a camera at one distance, in line pairs per height of the array.

    NaN if the edge is not visible or the picture cannot be made.
    """

    distance_mm: float
    as_taken: float
    """Focused at the plane in focus."""
    refocused: float
    """Refocused on the edge; a conventional camera cannot."""


@dataclass(frozen=True)
class CameraResult:
    """Results of one camera.

    Attributes
    ----------
    name : str
    picture_samples : tuple of int
        Width and height of the picture at the plane in focus.
    mtf50_lp_per_height : float
        Of a slanted edge in the plane in focus.
    point_width_mm, worst_point_width_mm : float
        Rms width of points in the plane in focus, on the object: mean and largest over the grid.
    views_across : float
        Number of resolved directions per point, along one axis.
    depth_of_field_mm, refocus_range_mm : tuple of float
        Range of tried distances with an edge at least half as sharp as in the plane in focus, as taken and refocused.
    light_w_per_pixel : float
        Mean over all pixels, for a white plane of 1 W/(m² sr).
    lit_share : float
        Fraction of lit pixels.
    edges : tuple of Focus
    unknown_beyond_mm : dict of tuple of float
        Ends of these ranges, by name, beyond which sharpness is unknown or was not measured.
    """

    name: str
    picture_samples: tuple[int, int]
    mtf50_lp_per_height: float
    point_width_mm: float
    worst_point_width_mm: float
    views_across: float
    depth_of_field_mm: tuple[float, float]
    refocus_range_mm: tuple[float, float]
    light_w_per_pixel: float
    lit_share: float
    edges: tuple[Focus, ...]
    unknown_beyond_mm: dict[str, tuple[float, ...]]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Three cameras and their pictures of the scene."""

    focus_mm: float
    samples: int
    cameras: tuple[CameraResult, ...]
    pictures: tuple[Array, ...]
    warnings: tuple[PictureWarning, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers as plain values; None: unknown or infinite."""
        return plain_json(
            {
                "focus_mm": self.focus_mm,
                "samples_per_pixel": self.samples,
                "cameras": [asdict(camera) for camera in self.cameras],
                "warnings": [each.as_dict() for each in self.warnings],
            }
        )

    def rows(self) -> list[tuple[str, ...]]:
        """Return the table for the user: a heading, then one row per quantity."""
        rows: list[tuple[str, ...]] = [("", *(camera.name for camera in self.cameras))]
        quantities: list[tuple[str, Callable[[CameraResult], str]]] = [
            ("picture / samples", lambda c: f"{c.picture_samples[0]} × {c.picture_samples[1]}"),
            ("MTF50 / lp per height", lambda c: _number(c.mtf50_lp_per_height)),
            ("point width / mm", lambda c: f"{_number(c.point_width_mm)}, worst {_number(c.worst_point_width_mm)}"),
            ("views across", lambda c: _number(c.views_across)),
            ("depth of field / mm", lambda c: _range(c, "depth_of_field_mm")),
            ("refocus range / mm", lambda c: _range(c, "refocus_range_mm")),
            ("light / W per pixel", lambda c: f"{c.light_w_per_pixel:.3g}"),
            ("lit pixels", lambda c: f"{c.lit_share:.0%}"),
        ]
        for words, of in quantities:
            rows.append((words, *(of(camera) for camera in self.cameras)))
        return rows


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else NOT_KNOWN


def _range(camera: CameraResult, name: str) -> str:
    near, far = getattr(camera, name)
    if not math.isfinite(near):
        return NOT_KNOWN
    open_ends = " and ".join(f"{end:.4g}" for end in camera.unknown_beyond_mm[name])
    return f"{near:.4g} to {far:.4g}" + (f" ({NOT_KNOWN} beyond {open_ends})" if open_ends else "")
