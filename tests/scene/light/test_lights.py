"""Lamps as properties: where they are, how far they reach, which axes they have, and what is refused."""

from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.scene.light.region import Region

LINE: dict[str, Any] = {"start_mm": (1.0, 2.0, -50.0), "end_mm": (1.0, 8.0, -58.0), "power_w": 1.0}
PANEL: dict[str, Any] = {"position_mm": (0.0, 0.0, -50.0), "direction": (0.0, 0.0, -2.0), "width_mm": 6.0,
                         "height_mm": 2.0, "power_w": 1.0}  # fmt: skip


def test_a_panels_width_lies_along_x_and_turns_counter_clockwise_as_seen_from_behind() -> None:
    """The eye behind a lamp that shines along -z has x to the right and y up."""
    flat, turned = (lf.RectangleLight(**PANEL, turn_deg=turn).region for turn in (0.0, 90.0))
    np.testing.assert_allclose(flat.half_mm, [[3.0, 0.0, 0.0], [0.0, 1.0, 0.0]], atol=1e-15)
    np.testing.assert_allclose(turned.half_mm, [[0.0, 3.0, 0.0], [-1.0, 0.0, 0.0]], atol=1e-15)
    along_x = lf.RectangleLight(**PANEL | {"direction": (1.0, 0.0, 0.0)}).region
    np.testing.assert_allclose(along_x.half_mm[0], [0.0, 3.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("direction", [(0.3, -0.4, -1.0), (0.0, 1e-9, 1.0), (-1.0, 1e-4, 0.0), (1e-60, 0.0, 0.0)])
def test_a_panels_axes_are_square_to_each_other_and_to_its_direction(direction: Any) -> None:
    axes = lf.RectangleLight(**PANEL | {"direction": direction}, turn_deg=33.0).axes
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(axes[2], np.array(direction) / np.linalg.norm(direction), atol=1e-15)


@pytest.mark.parametrize(
    ("half", "shape"),
    [
        (np.zeros((2, 3)), "straight"),
        ([[0.0, 3.0, -4.0], [0.0, 0.0, 0.0]], "straight"),
        ([[3.0, 0.0, 0.0], [0.0, 0.2, 0.0]], "straight"),
        ([[0.1, 0.0, 0.0], [0.0, 7.0, 0.0]], "straight"),
        ([[2.0, 0.0, 0.0], [0.0, 0.0, 2.0]], "round"),
    ],
    ids=["point", "line", "panel", "narrow panel", "disk"],
)
def test_every_point_of_a_region_is_within_its_bounds(half: Any, shape: Any) -> None:
    region = Region(np.array([5.0, -1.0, 2.0]), np.array(half), shape)
    u = np.random.default_rng(3).uniform(-1.0, 1.0, (4000, 2))
    if shape == "round":
        u /= np.maximum(np.hypot(*u.T), 1.0)[:, None]
    points = u @ region.half_mm
    spine = region.spine_mm
    share = np.clip(points @ spine / max(float(spine @ spine), 1e-300), -1.0, 1.0)
    assert np.linalg.norm(points, axis=1).max() <= region.size_mm * (1.0 + 1e-12)
    assert np.linalg.norm(points - share[:, None] * spine, axis=1).max() <= region.thickness_mm * (1.0 + 1e-12) + 1e-15
    normals = np.random.default_rng(4).normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    reach, corners = region.reach_mm(normals), (region.corners_mm - region.centre_mm) @ normals.T
    assert ((points @ normals.T).max(axis=0) <= reach + 1e-12).all()
    assert (reach <= corners.max(axis=0) + 1e-12).all()


def test_segments_across_a_panel_come_inside_it_by_more_than_a_margin() -> None:
    panel = Region(np.zeros(3), np.array([[3.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    disk = Region(np.zeros(3), np.array([[3.0, 0.0, 0.0], [0.0, 3.0, 0.0]]), "round")
    start = np.array([[-9.0, 0.5, 0.0], [-9.0, 1.5, 0.0], [2.5, 9.0, 0.0], [-9.0, 0.99, 0.0], [0.0, 0.5, 0.0]])
    end = np.array([[9.0, 0.5, 0.0], [9.0, 1.5, 0.0], [2.5, -9.0, 0.0], [9.0, 0.99, 0.0], [0.1, 0.5, 0.0]])
    margin = np.full(5, 0.02)
    assert panel.holds(start, end, margin).tolist() == [True, False, True, False, True]
    assert disk.holds(start, end, margin).tolist() == [True, True, True, True, True]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"end_mm": (1.0, 2.0, -50.0)}, r"end_mm = \[1\.0, 2\.0, -50\.0\]: must differ from start_mm"),
        ({"start_mm": (0.0, 0.0, 0.0), "end_mm": (0.0, 0.0, 1e-200)}, r"end_mm - start_mm must have a length from"),
    ],
)
def test_a_line_without_two_ends_is_refused_in_one_line(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(lf.LfmeshError, match=message) as error:
        lf.LineLight(**LINE | changes)
    assert "\n" not in str(error.value)


def test_a_panel_without_a_direction_or_extent_is_refused() -> None:
    for key, value in (("direction", (0.0, 0.0, 0.0)), ("width_mm", 0.0), ("height_mm", -1.0)):
        with pytest.raises(lf.LfmeshError, match=key):
            lf.RectangleLight(**PANEL | {key: value})
