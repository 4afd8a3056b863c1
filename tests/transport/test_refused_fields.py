"""Media that bend light are refused where rays cannot be traced through them, with the reason."""

from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.transport.refused_fields import triangles_meet_box
from tests.cameras import camera_without_array

FIELD = {
    "name": "plume",
    "bounds": {"kind": "box", "size_mm": [20.0, 20.0, 20.0]},
    "index": 1.0005,
    "position_mm": [0.0, 0.0, -100.0],
}


def world_of(*media: dict[str, Any], **tables: Any) -> lf.World:
    return lf.build(lf.Scene(**{"camera": camera_without_array(), "media": media} | tables), aimed=False)  # type: ignore[arg-type]


def ball(radius_mm: float, z_mm: float) -> dict[str, Any]:
    return {
        "refractor": {"shape": {"kind": "sphere", "radius_mm": radius_mm}, "index": 1.5},
        "position_mm": [0.0, 0.0, z_mm],
    }


@pytest.mark.parametrize(
    ("change", "tables", "reason"),
    [
        ({}, {"transport": {"polarisation": True}}, r"media\[0\] \(plume\): bends light, which transport.polarisation"),
        (
            {},
            {"transport": {"diffraction": "stop", "split": "transmit"}},
            r'plume\): bends light, but transport.diffraction = "stop"',
        ),
        ({"position_mm": [0.0, 0.0, -9.0]}, {}, r"media\[0\].* reaches 1 mm behind the"),
        ({}, {"targets": [ball(5.0, -100.0)]}, r"reaches into media\[0\] \(plume\)"),
        ({}, {"targets": [ball(5.0, -86.0)]}, r"reaches into media\[0\] \(plume\)"),
        ({}, {"targets": [ball(50.0, -120.0)]}, r"media\[0\]: lies inside"),
    ],
)
def test_a_field_is_refused_where_light_cannot_be_followed(
    change: dict[str, Any], tables: dict[str, Any], reason: str
) -> None:
    with pytest.raises(lf.SceneError, match=reason):
        world_of(FIELD | change, **tables)


def test_glass_beside_a_field_is_allowed() -> None:
    assert world_of(FIELD, targets=[ball(5.0, -84.0)]).tables.objects.fields is not None


def test_a_triangle_meets_a_box_exactly_if_they_share_a_point() -> None:
    draw = np.random.default_rng(0)
    corners, half = draw.uniform(-3.0, 3.0, (400, 3, 3)), np.array([1.0, 0.7, 1.3])
    found = triangles_meet_box(corners, half)
    # Clip each triangle to the six half-spaces.
    truth = []
    for polygon in corners:
        for axis in range(3):
            for sign in (1.0, -1.0):
                kept: list[np.ndarray] = []
                for p, q in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
                    a, b = half[axis] - sign * p[axis], half[axis] - sign * q[axis]
                    if a >= 0.0:
                        kept.append(p)
                    if (a >= 0.0) != (b >= 0.0):
                        kept.append(p + a / (a - b) * (q - p))
                polygon = np.array(kept).reshape(-1, 3)
        truth.append(len(polygon) > 0)
    assert found.tolist() == truth
    assert 50 < sum(truth) < 350
