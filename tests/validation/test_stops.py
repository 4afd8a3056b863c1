"""The light that falls on the sensor at every stop, against a tracer in this file that knows no pupils.

An evenly emitting plane overfills the field. Rays that start uniformly in the stop, over its area and over projected
solid angle, are traced to the sensor and to object space; the étendue of those that arrive, times transmittance and
radiance, is the power. That needs no search for a pupil, so it cannot miss one, however small.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.optics.glass import refractive_index
from lfmesh.scene import load_lens, solved
from tests.instances import instances

Array = NDArray[np.float64]

ALLOWED = 0.005
"""Relative difference, beside three standard errors."""

MM2 = 1e-6


@dataclass
class Rays:
    """Places and directions (n, 3), mm, and what is left of each ray's power."""

    p: Array
    d: Array
    power: Array


def sag(surface: Any, r2: Array) -> Array:
    c, k = surface.curvature_per_mm, surface.conic
    z = c * r2 / (1.0 + np.sqrt(np.maximum(1.0 - (1.0 + k) * c * c * r2, 1e-12)))
    return z + sum(a * r2 ** (m + 2) for m, a in enumerate(surface.asphere_mm))


def slope_of(surface: Any, r2: Array) -> Array:
    """Derivative of the sag by r²."""
    h = 1e-6
    low = np.maximum(r2 - h, 0.0)
    return (sag(surface, r2 + h) - sag(surface, low)) / (r2 + h - low)


def meet(rays: Rays, surface: Any, vertex_z: float) -> Array:
    """Move rays onto a surface by Newton's method, end those outside its aperture; return unit normals towards +z."""
    t = (vertex_z - rays.p[:, 2]) / rays.d[:, 2]
    going = np.flatnonzero(rays.power > 0.0)
    for _ in range(25):
        d = rays.d[going]
        p = rays.p[going] + t[going, None] * d
        r2 = p[:, 0] ** 2 + p[:, 1] ** 2
        height = p[:, 2] - vertex_z - sag(surface, r2)
        rate = d[:, 2] - 2.0 * slope_of(surface, r2) * (p[:, 0] * d[:, 0] + p[:, 1] * d[:, 1])
        step = height / rate
        t[going] -= step
        going = going[~(np.abs(step) < 1e-13)]
        if len(going) == 0:
            break
    rays.p = rays.p + t[:, None] * rays.d
    r2 = rays.p[:, 0] ** 2 + rays.p[:, 1] ** 2
    slope = slope_of(surface, r2)
    aperture = surface.semi_diameter_mm or np.inf
    met = np.abs(rays.p[:, 2] - vertex_z - sag(surface, r2)) < 1e-9
    rays.power = np.where((r2 <= aperture**2) & met, rays.power, 0.0)
    normal = np.column_stack([-2.0 * slope * rays.p[:, 0], -2.0 * slope * rays.p[:, 1], np.ones(len(t))])
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def bend(rays: Rays, normal: Array, before: float, after: float) -> None:
    """Refract, with Fresnel's transmittance of unpolarised light."""
    cos_i = (rays.d * normal).sum(axis=1)
    normal = normal * np.sign(cos_i)[:, None]
    cos_i, eta = np.abs(cos_i), before / after
    squared = 1.0 - eta**2 * (1.0 - cos_i**2)
    cos_t = np.sqrt(np.maximum(squared, 0.0))
    s = (before * cos_i - after * cos_t) / (before * cos_i + after * cos_t)
    p = (after * cos_i - before * cos_t) / (after * cos_i + before * cos_t)
    rays.power = np.where(squared > 0.0, rays.power * (1.0 - 0.5 * (s**2 + p**2)), 0.0)
    d = eta * rays.d + (cos_t - eta * cos_i)[:, None] * normal
    rays.d = d / np.linalg.norm(d, axis=1, keepdims=True)


def index_of(medium: float | str | None, wavelength_nm: float) -> float:
    return refractive_index(medium, wavelength_nm)


def through_lenslets(rays: Rays, scene: lf.Scene, front_z: float, wavelength_nm: float) -> None:
    """Take rays through a square array of plano-convex lenslets whose curved side looks at the lens."""
    mla = scene.camera.mla
    assert mla is not None
    assert mla.layout == "square"
    assert mla.curved_side == "lens"
    glass, curvature = index_of(mla.medium, wavelength_nm), 1.0 / mla.radius_mm[0]
    half = 0.5 * mla.pitch_mm * np.array(mla.count)
    place = rays.p[:, :2] + ((front_z - rays.p[:, 2]) / rays.d[:, 2])[:, None] * rays.d[:, :2]
    for _ in range(3):
        apex = (np.floor((place + half) / mla.pitch_mm) + 0.5) * mla.pitch_mm - half
        a = rays.p - np.column_stack([apex, np.full(len(apex), front_z)])
        along = curvature * (a * rays.d).sum(axis=1) - rays.d[:, 2]
        root = np.sqrt(np.maximum(along**2 - curvature * (curvature * (a**2).sum(axis=1) - 2.0 * a[:, 2]), 0.0))
        t = (-along - root) / curvature
        place = rays.p[:, :2] + t[:, None] * rays.d[:, :2]
    rays.p = rays.p + t[:, None] * rays.d
    rays.power = np.where((np.abs(rays.p[:, :2]) < half).all(axis=1), rays.power, 0.0)
    off = rays.p - np.column_stack([apex, np.full(len(apex), front_z)])
    bend(rays, np.column_stack([-curvature * off[:, :2], 1.0 - curvature * off[:, 2]]), 1.0, glass)
    t = (front_z + mla.thickness_mm - rays.p[:, 2]) / rays.d[:, 2]
    rays.p = rays.p + t[:, None] * rays.d
    bend(rays, np.tile([0.0, 0.0, 1.0], (len(t), 1)), glass, 1.0)


def expected_power(scene: lf.Scene, block: tuple[slice, slice], rays: int = 1 << 17) -> tuple[float, float]:
    """Return the power in W on a block of pixels (rows, columns) from a radiance of 1 everywhere, and its error."""
    scene = solved(scene)
    lens, camera = scene.camera.lens, scene.camera
    wavelength = scene.transport.wavelengths_nm[0]
    surfaces, vertices = lens.surfaces, lens.vertices_mm
    media = [1.0, *(index_of(s.medium, wavelength) for s in surfaces)]
    stop = next(i for i, s in enumerate(surfaces) if s.stop)
    aperture = surfaces[stop].semi_diameter_mm
    assert aperture is not None
    sensor_z = vertices[-1] + camera.sensor.distance_mm
    array_z = None
    if camera.mla is not None:
        array_z = vertices[-1] + camera.mla.distance_mm
        sensor_z = array_z + camera.mla.thickness_mm + camera.sensor.distance_mm
    depth = abs(float(sag(surfaces[stop], np.array([aperture**2]))[0]))

    def arrived(numbers: Array, tangent: Array) -> tuple[Array, Array, Array]:
        """Return throughput, and place on the sensor, of rays from the stop."""
        radius = aperture + depth * tangent
        r, turn, around = radius * np.sqrt(numbers[:, 0]), 2 * np.pi * numbers[:, 1], 2 * np.pi * numbers[:, 3]
        p = np.column_stack([r * np.cos(turn), r * np.sin(turn), np.full(len(r), vertices[stop])])
        slope = np.column_stack([tangent * np.cos(around), tangent * np.sin(around), np.ones(len(r))])
        d = slope / np.linalg.norm(slope, axis=1, keepdims=True)
        front, back = Rays(p, -d, np.ones(len(p))), Rays(p, d, np.ones(len(p)))
        for k in range(stop - 1, -1, -1):
            bend(front, meet(front, surfaces[k], vertices[k]), media[k + 1], media[k])
        for k in range(stop, len(surfaces)):
            bend(back, meet(back, surfaces[k], vertices[k]), media[k], media[k + 1])
        if array_z is not None:
            through_lenslets(back, scene, array_z, wavelength)
        t = (sensor_z - back.p[:, 2]) / back.d[:, 2]
        place = back.p[:, :2] + t[:, None] * back.d[:, :2]
        throughput = front.power * back.power * np.pi * radius**2 * d[:, 2] ** 4 * media[stop] ** 2
        return throughput, place[:, 0], place[:, 1]

    width, height = camera.sensor.size_mm
    pixel = camera.sensor.pixel_mm
    rows, columns = block
    x0, x1 = columns.start * pixel - width / 2, columns.stop * pixel - width / 2
    y0, y1 = rows.start * pixel - height / 2, rows.stop * pixel - height / 2

    def lands(x: Array, y: Array) -> NDArray[np.bool_]:
        return (x > x0) & (x < x1) & (y > y0) & (y < y1)

    with np.errstate(all="ignore"):
        pilot = stats.qmc.Sobol(5, seed=1).random(1 << 15)
        tangent = 1e-4 * 1e5 ** pilot[:, 4]
        throughput, x, y = arrived(pilot, tangent)
        steepest = 1.2 * tangent[(throughput > 0.0) & lands(x, y)].max()
        sums = []
        for seed in range(8):
            numbers = stats.qmc.Sobol(4, seed=seed + 2).random(rays // 8)
            throughput, x, y = arrived(numbers, steepest * np.sqrt(numbers[:, 2]))
            sums.append(np.nansum(np.where(lands(x, y), throughput, 0.0)) / len(numbers) * np.pi * steepest**2)
    return float(np.mean(sums)) * MM2, float(np.std(sums, ddof=1) / np.sqrt(8.0)) * MM2


def check(scene: lf.Scene, block: tuple[slice, slice]) -> None:
    """The power on a block of pixels is the expected one within `ALLOWED` and three standard errors of both."""
    image = lf.render(scene)
    # Replicates would tell a block's error; four of them do so roughly, which three standard errors allow for.
    power = float(image.mean[block].sum())
    error = float(np.sqrt((image.stderr[block] ** 2).sum()))
    expected, spread = expected_power(scene, block)
    assert expected > 0.0
    assert abs(power - expected) <= ALLOWED * expected + 3.0 * np.hypot(error, spread), (power, expected, error, spread)


ALL_OF_FIELD = {"shape": {"kind": "plane", "width_mm": 4000.0, "height_mm": 4000.0}, "position_mm": [0, 0, -500.0],
                "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}  # fmt: skip
CENTRE, EDGE = (slice(6, 18), slice(6, 18)), (slice(0, 3), slice(0, 3))
# The truth here goes along straight lines; gradient-index glass is in `test_gradient_images.py`.
LENSES = sorted(
    path.name for path in Path(asset_path("lenses")).glob("*.toml") if not load_lens(path).has_gradients
)  # fmt: skip

WEAK = {
    "surfaces": [
        {"radius_mm": 30.0, "thickness_mm": 6.0, "index": 1.1, "semi_diameter_mm": 12.0},
        {"radius_mm": -30.0, "thickness_mm": 3.0, "semi_diameter_mm": 12.0},
        {"stop": True, "thickness_mm": 3.0, "semi_diameter_mm": 9.0},
        {"radius_mm": 40.0, "thickness_mm": 5.0, "index": 1.1, "semi_diameter_mm": 12.0},
        {"radius_mm": -40.0, "semi_diameter_mm": 12.0},
    ]
}
"""Reflections of its surfaces bring a hundred thousandth of the light: this file's tracer leaves them out."""


def camera_with(lens: dict[str, Any], mla: dict[str, Any] | None = None, **transport: Any) -> lf.Scene:
    sensor = {"pixels": [24, 24], "pixel_mm": 0.4} if mla is None else {"pixels": [240, 240], "pixel_mm": 0.0125}
    return lf.Scene(
        camera={"focus_mm": 500.0, "lens": lens, "sensor": sensor} | ({} if mla is None else {"mla": mla}),
        targets=[ALL_OF_FIELD],
        transport={"split": "transmit", "samples": 256, "replicates": 4, "threads": 1} | transport,
    )


def asset(name: str, **how: Any) -> dict[str, Any]:
    return {"file": str(asset_path(f"lenses/{name}"))} | how


@pytest.mark.parametrize("name", LENSES)
@pytest.mark.parametrize("radius", instances([0.02, 0.2], long=[0.2]))
def test_a_tiny_stop_passes_its_light(name: str, radius: float) -> None:
    scene = camera_with(asset(name, stop_semi_diameter_mm=radius))
    check(scene, CENTRE)


@pytest.mark.long
@pytest.mark.parametrize("name", LENSES)
@pytest.mark.parametrize("f_number", [4, 5.6, 8, 11, 16, 22, 25, 32, 45, 64])
def test_every_lens_passes_its_light_at_every_stop_on_axis_and_at_the_edge(name: str, f_number: float) -> None:
    try:
        scene = camera_with(asset(name, f_number=f_number))
        lf.first_order(scene)
    except lf.SceneError:
        pytest.skip("the lens has no such stop")
    check(scene, CENTRE)
    check(scene, EDGE)


SQUARE = {"layout": "square", "count": [24, 24], "pitch_mm": 0.125, "focal_length_mm": 0.5, "index": 1.5,
          "thickness_mm": 0.3}  # fmt: skip
CENTRAL_LENSLETS = (slice(60, 180), slice(60, 180))


@pytest.mark.parametrize("f_number", instances([4, 25, 64], long=[25]))
def test_the_light_behind_an_array_at_every_stop(f_number: float) -> None:
    check(camera_with(asset("double_gauss_50mm.toml", f_number=f_number), SQUARE, samples=32), CENTRAL_LENSLETS)


HOW = {
    "default": {"split": "both"},
    "mesh engine": {"split": "both", "engine": "mesh"},
    "image path": {},
    "forward": {"method": "forward", "samples": 1024},
}


@pytest.mark.parametrize("f_number", instances([4, 32, 64], long=[4, 32]))
@pytest.mark.parametrize("how", HOW)
def test_every_method_passes_the_light_at_every_stop(how: str, f_number: float) -> None:
    target = ALL_OF_FIELD | {"shape": {"kind": "plane", "width_mm": 200.0, "height_mm": 200.0}}
    scene = camera_with(WEAK | {"f_number": f_number}, **HOW[how]).changed({"targets": [target]})
    check(scene, CENTRE)


@pytest.mark.parametrize("how", ["default", "mesh engine", "forward"])
def test_every_method_passes_the_light_behind_an_array_at_a_small_stop(how: str) -> None:
    target = ALL_OF_FIELD | {"shape": {"kind": "plane", "width_mm": 60.0, "height_mm": 60.0}}
    scene = camera_with(WEAK | {"f_number": 45}, SQUARE, **HOW[how] | {"samples": 32}).changed({"targets": [target]})
    check(scene, CENTRAL_LENSLETS)
