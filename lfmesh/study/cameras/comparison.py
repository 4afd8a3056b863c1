"""Results of a comparison of cameras, as plain values and as the table that a user reads."""

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
    """Resolution of a camera on a slanted edge at one distance: MTF50 in line pairs per height of the array.

    NaN where no edge is to be seen, or the picture cannot be made.
    """

    distance_mm: float
    as_taken: float
    """Left at the plane in focus."""
    refocused: float
    """Focused on the edge after the fact; a conventional camera cannot."""


@dataclass(frozen=True)
class CameraResult:
    """Results of one camera.

    Attributes
    ----------
    name : str
    picture_samples : tuple of int
        Width and height of the picture focused on the plane in focus.
    mtf50_lp_per_height : float
        There, of a slanted edge.
    point_width_mm, worst_point_width_mm : float
        There, on the object: rms width of points, mean and largest over the grid.
    views_across : float
        Directions that the camera tells apart in each point, along one axis.
    depth_of_field_mm, refocus_range_mm : tuple of float
        In which an edge is at least half as sharp as in the plane in focus, as taken and when focused after the fact;
        of the distances tried.
    light_w_per_pixel : float
        Mean over all pixels, of a white plane of 1 W/(m² sr).
    lit_share : float
        Of the pixels.
    edges : tuple of Focus
    unknown_beyond_mm : dict of tuple of float
        Ends of these ranges, by their name, beyond which an edge was not tried or its sharpness is not known.
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
    """Three cameras and the pictures that they took of the scene."""

    focus_mm: float
    samples: int
    cameras: tuple[CameraResult, ...]
    pictures: tuple[Array, ...]
    warnings: tuple[PictureWarning, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers as plain values; what is not known or infinite is None."""
        return plain_json(
            {
                "focus_mm": self.focus_mm,
                "samples_per_pixel": self.samples,
                "cameras": [asdict(camera) for camera in self.cameras],
                "warnings": [each.as_dict() for each in self.warnings],
            }
        )

    def rows(self) -> list[tuple[str, ...]]:
        """Return the table that a user reads: a heading, then a row a quantity."""
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
