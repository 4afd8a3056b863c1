"""The small cameras that many tests share, as tables of a scene and as text of a scene file."""

from typing import Any

from lfmesh.scene import Scene

SQUARE_ARRAY: dict[str, Any] = {
    "layout": "square",
    "count": [4, 4],
    "pitch_mm": 0.5,
    "focal_length_mm": 2.6,
    "index": 1.5,
    "thickness_mm": 0.5,
}
"""4 × 4 lenslets of f/5.2."""


def biconvex(radius_mm: float = 20.0, index: float = 1.5) -> dict[str, Any]:
    """Return the table of a biconvex lens of 3 mm with its stop 1 mm behind: as it is, f/3.6 where it is focused."""
    return {
        "surfaces": [
            {"radius_mm": radius_mm, "thickness_mm": 3.0, "index": index, "semi_diameter_mm": 5.0},
            {"radius_mm": -radius_mm, "thickness_mm": 1.0, "semi_diameter_mm": 5.0},
            {"stop": True, "semi_diameter_mm": 4.0},
        ]
    }


def close_up_camera(columns: int = 20, rows: int = 20) -> dict[str, Any]:
    """Return the table of a camera with this lens, focused at 60 mm, behind the lenslets pixels of 0.1 mm.

    Each micro-image covers the nearer half of its neighbours.
    """
    return {
        "focus_mm": 60.0,
        "lens": biconvex(),
        "mla": dict(SQUARE_ARRAY),
        "sensor": {"pixels": [columns, rows], "pixel_mm": 0.1},
    }


def camera_without_array(focus_mm: float = 150.0, pixels: int = 6, pixel_mm: float = 1.5) -> dict[str, Any]:
    """Return the table of a conventional camera: a biconvex lens of 30 mm, which is its own stop, and large pixels."""
    return {
        "focus_mm": focus_mm,
        "lens": {
            "surfaces": [
                {"radius_mm": 30.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 6.0, "stop": True},
                {"radius_mm": -30.0, "semi_diameter_mm": 6.0},
            ]
        },
        "sensor": {"pixels": [pixels, pixels], "pixel_mm": pixel_mm},
    }


def as_text(**tables: Any) -> str:
    """Return the text of a scene file from the tables of a scene."""
    return Scene(**tables).dump_toml()


def bench_camera(columns: int, rows: int) -> str:
    """Return the start of a scene file: a camera focused at 500 mm, with 10 × 10 pixels behind each lenslet.

    Its lens is biconvex, with the stop before it. Tables of the scene may follow.
    """
    return f"""
schema_version = 1
[camera]
focus_mm = 500.0
[camera.lens]
surfaces = [
  {{ stop = true, thickness_mm = 1.0, semi_diameter_mm = 5.0 }},
  {{ radius_mm = 50.0, thickness_mm = 4.0, index = 1.5, semi_diameter_mm = 8.0 }},
  {{ radius_mm = -50.0, thickness_mm = 0.0, semi_diameter_mm = 8.0 }},
]
[camera.mla]
count = [{columns}, {rows}]
pitch_mm = 0.125
focal_length_mm = 0.7
index = 1.5
thickness_mm = 0.3
[camera.sensor]
pixels = [{10 * columns}, {10 * rows}]
pixel_mm = 0.0125
"""
