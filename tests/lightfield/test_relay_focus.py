"""Relays refocus where real rays do: their principal planes lie far from the lens, whose focus is near it."""

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.lightfield.rays.ray_model import RayModel
from lfmesh.scene import Paraxial, solved

GAPS_MM = (30.0, 40.0, 48.35, 50.0)
"""From each of two lenses to the stop between: some 48.4 mm makes the relay afocal, more its focal length negative."""


def relay(gap: float, stop: float) -> lf.Scene:
    ball = {"radius_mm": 51.68, "thickness_mm": 5.0, "index": 1.5168, "semi_diameter_mm": 14.0}
    back = {"radius_mm": -51.68, "thickness_mm": gap, "semi_diameter_mm": 14.0}
    surfaces = [ball, back, {"stop": True, "thickness_mm": gap, "semi_diameter_mm": stop}, ball, back]
    surfaces[-1] = {key: value for key, value in back.items() if key != "thickness_mm"}
    mla = {"count": [32, 32], "pitch_mm": 0.25, "index": 1.5, "thickness_mm": 0.3, "focal_length_mm": 1.0}
    sensor = {"pixels": [256, 256], "pixel_mm": 0.03125}
    return solved(
        lf.Scene(camera={"focus_mm": 48.3, "lens": {"surfaces": surfaces}, "mla": mla, "sensor": sensor}, targets=[])
    )


def sharpest_mm(scene: lf.Scene, distance_mm: float) -> float:
    """Return z behind the last vertex where rays of equal areas of the stop are closest, from a meridional trace.

    Spheres only; written out here, with Snell's law in angles.
    """
    lens = scene.camera.lens
    stop = next(i for i, s in enumerate(lens.surfaces) if s.stop)
    radius = lens.surfaces[stop].semi_diameter_mm or 0.0

    def trace(angle: float) -> tuple[float, float, float]:
        y, z, u, n, at_stop = 0.0, -distance_mm, angle, 1.0, 0.0
        for surface, vertex in zip(lens.surfaces, lens.vertices_mm, strict=True):
            if surface.stop:
                at_stop = y + (vertex - z) * np.tan(u)
                continue
            r, after = surface.radius_mm, surface.index or 1.0
            centre = vertex + r
            # Where the ray meets the sphere, on the side of the vertex.
            b = (z - centre) * np.cos(u) + y * np.sin(u)
            c = (z - centre) ** 2 + y * y - r * r
            t = -b - np.sign(r) * np.sqrt(b * b - c)
            z, y = z + t * np.cos(u), y + t * np.sin(u)
            slope = np.arcsin(y / r)
            u = -slope + np.arcsin(n / after * np.sin(u + slope))
            n = after
        return y - (z - lens.vertices_mm[-1]) * np.tan(u), np.tan(u), at_stop

    heights, slopes = [], []
    for share in (np.arange(48) + 0.5) / 48:
        low, high = 0.0, 0.5
        for _ in range(60):
            middle = 0.5 * (low + high)
            if trace(middle)[2] < radius * np.sqrt(share):
                low = middle
            else:
                high = middle
        y, slope, _ = trace(low)
        heights.append(y)
        slopes.append(slope)
    y, s = np.array(heights), np.array(slopes)
    return float(-(y * s).sum() / (s * s).sum())


@pytest.mark.parametrize("gap", GAPS_MM)
@pytest.mark.parametrize("distance", [45.0, 48.3, 52.0])
def test_a_relay_focuses_where_real_rays_do(gap: float, distance: float) -> None:
    """Within a sixth of what aberrations shift the focus by, as the model's rays fill the paraxial pupil."""
    scene = relay(gap, 4.0)
    model = RayModel.of(scene)
    paraxial = Paraxial.of(scene.camera.lens, scene.primary_nm).image_mm(distance)
    shift = sharpest_mm(scene, distance) - paraxial
    found = model.image_excess_mm(distance) - model.paraxial.image_excess_mm(distance)
    assert shift < -0.1
    assert found == pytest.approx(shift, rel=0.16)


@pytest.mark.parametrize("gap", GAPS_MM)
def test_the_plane_in_focus_lies_within_a_relays_refocus_range(gap: float) -> None:
    near, far = RayModel.of(relay(gap, 2.0)).refocus_range_mm
    assert near < 48.3 < far < 100.0
