"""Lenses of the library as cameras to optimise, and what their tests share."""

import math
from typing import Any

import lfmesh as lf

TRIPLET_MM = 18.2
"""Image height of the triplet at 20 degrees."""

PUBLISHED_SENSOR_MM = 42.21
"""Image plane of the published triplet, behind its last vertex, where its spots are best over the field."""


def camera(lens: str, sensor_mm: float, waves_nm: tuple[float, ...] = (480.0, 550.0, 650.0), **more: Any) -> lf.Scene:
    """Return a camera with a lens of the library and a sensor at a distance behind it."""
    return lf.Scene(
        camera={
            "lens": {"file": f"lib:{lens}", **more},
            "sensor": {"pixels": [100, 100], "pixel_mm": 0.25, "distance_mm": sensor_mm},
        },
        transport={"wavelengths_nm": waves_nm},
    )


def prescription(scene: lf.Scene) -> tuple[Any, ...]:
    """Return the surfaces of the lens, read from its file."""
    return lf.solved(scene).camera.lens.surfaces


def radius_range(radius_mm: float) -> list[float]:
    """Return a range about a radius; of a weak one through flat."""
    if abs(radius_mm) > 200.0:
        return [-100.0, 100.0]
    return sorted([0.7 * radius_mm, 1.5 * radius_mm])


def lens_variables(scene: lf.Scene, spaces: tuple[int, ...] = ()) -> list[dict[str, Any]]:
    """Return all radii of the lens as variables, some spaces, and the distance of the sensor."""
    surfaces = prescription(scene)
    path = "camera.lens.surfaces[{}].{}".format
    variables = [
        {"path": path(i, "radius_mm"), "range": radius_range(surface.radius_mm)}
        for i, surface in enumerate(surfaces)
        if math.isfinite(surface.radius_mm)
    ]
    for i in spaces:
        thickness = surfaces[i].thickness_mm
        variables.append({"path": path(i, "thickness_mm"), "range": [0.5 * thickness, 1.5 * thickness]})
    distance = scene.camera.sensor.distance_mm or 0.0
    return [*variables, {"path": "camera.sensor.distance_mm", "range": [0.93 * distance, 1.07 * distance]}]


def detuned(scene: lf.Scene, signs: Any, share: float = 0.05) -> lf.Scene:
    """Return a camera whose radii and spaces are a share larger or smaller than published, by their signs in turn."""
    scene = scene.changed({"camera.lens": lf.solved(scene).camera.lens.model_dump()})
    changes: dict[str, float] = {}
    for i, surface in enumerate(scene.camera.lens.surfaces):
        for key in ("radius_mm", "thickness_mm"):
            value = getattr(surface, key)
            if value and math.isfinite(value):
                changes[f"camera.lens.surfaces[{i}].{key}"] = value * (1.0 + share * next(signs))
    return scene.changed(changes)
