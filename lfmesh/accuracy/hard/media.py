"""Light through media at their limits: optical depth, single voxels, cell faces, sharp phase functions."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

from lfmesh.accuracy.hard.outcome import SINGLET, Outcome, case, lens_scene, outcome, surfaces_of
from lfmesh.accuracy.hard.truth import Array
from lfmesh.scene import Medium, Plane, Scene, Surface, Target
from lfmesh.scene.objects.targets import Material
from lfmesh.transport.build import build
from lfmesh.transport.render.render import render
from lfmesh.transport.trace import Status, trace
from lfmesh.transport.traced_paths import Paths
from lfmesh.transport.world import World

CHART_AT = -400.0
MIDDLE = -200.0
"""z of the centres of media, mm."""

DEPTHS = (1e-300, 1e-17, 1e-9, 1.0, 40.0, 700.0)
"""Optical depths; e⁻⁷⁰⁰ is about the smallest value in float64."""

RELATIVE = 1e-12
"""Tolerance of transmittances per unit of optical depth."""

AT_LENS = 3e-9
"""The same at the lens: there the medium ends at the lens's box, a billionth of its size in front of the glass."""

ALONG = 1e-12
"""Component of a face's unit normal along a line, and mm beside the face, below which the line lies in the face."""

KOLMOGOROV = 2.2
"""Distance between two distributions, times the root of the count, that chance exceeds once in 8,000 times."""


def _in_front(
    *media: dict[str, Any], surfaces: list[Surface] = SINGLET, folder: Path = Path(), **changes: Any
) -> Scene:
    """Return a camera that looks through media at an opaque plane behind them."""
    black = Material(reflectance=0.0)
    plane = Target(shape=Plane(width_mm=4e4, height_mm=4e4), position_mm=(0.0, 0.0, CHART_AT), material=black)
    scene = lens_scene(surfaces, targets=(plane,))
    return scene.changed({"media": [Medium(**each) for each in media], **changes}).in_folder(folder)


def _slab(thickness: float, **values: Any) -> dict[str, Any]:
    bounds = {"kind": "box", "size_mm": [1e3, 1e3, thickness]}
    return {"bounds": bounds, "position_mm": [0.0, 0.0, MIDDLE], **values}


def _voxels(folder: Path, values: Array, spacing: float, **quantities: Any) -> dict[str, Any]:
    """Write the absorption of voxels to a file, and return their medium."""
    np.savez(folder / "voxels.npz", absorption_per_mm=values, spacing_mm=spacing)
    return {"grid": {"file": "voxels.npz", **quantities}, "position_mm": [0.0, 0.0, MIDDLE]}


def _away(world: World, x: Array, y: Array, **settings: Any) -> Paths:
    """Trace rays along −z from in front of the lens."""
    origins = np.column_stack([x, y, np.full(len(x), -1.0)])
    return trace(world, origins, np.tile([0.0, 0.0, -1.0], (len(x), 1)), **settings)


def _straight(paths: Paths, count: int) -> Array:
    """Return the weight of each ray that reaches the chart without an event; NaN if it does not."""
    weight = np.full(count, np.nan)
    arrived = (paths.status == Status.TARGET) & (paths.events == 0)
    weight[paths.source[arrived]] = paths.weight[arrived]
    return weight


def _compared(
    paths: Paths | list[Paths], found: Array, depth: Array, what: str, tolerance: float = RELATIVE
) -> Outcome:
    """Compare transmittances with e to the minus optical depth, (n,) each."""
    error = np.abs(found * np.exp(depth) - 1.0) / (1.0 + depth)
    worst = float(np.max(error)) if len(error) and np.isfinite(error).all() else np.inf
    return outcome(
        paths, f"{what}: e to the minus optical depth within {tolerance:.0e} of it",
        f"{len(found)} rays, error {worst:.1e}", worst <= tolerance,
    )  # fmt: skip


@case
def depths_of_absorption() -> Outcome:
    """Cross absorbing slabs with optical depths from 1e-300 to 700."""
    traces = [_away(build(_in_front(_slab(10.0, absorption_per_mm=0.1 * d))), np.zeros(1), np.zeros(1)) for d in DEPTHS]
    found = np.concatenate([_straight(paths, 1) for paths in traces])
    return _compared(traces, found, np.array(DEPTHS), "what passes straight on")


@case
def depths_of_scattering() -> Outcome:
    """Cross purely scattering slabs with optical depths from 1e-300 to 700, without any absorption."""
    traces = [_away(build(_in_front(_slab(10.0, scattering_per_mm=0.1 * d))), np.zeros(8), np.zeros(8)) for d in DEPTHS]
    found = np.concatenate([_straight(paths, 8) for paths in traces])
    result = _compared(traces, found, np.repeat(DEPTHS, 8), "what passes straight on")
    absorbed = sum(weight for paths in traces for name, weight in paths.ledger.absorbed.items() if "media" in name)
    return result if absorbed == 0.0 else outcome(traces, result.expected, f"{absorbed:.1e} absorbed", passed=False)


@case
def sharp_phase_functions() -> Outcome:
    """Scatter by Henyey–Greenstein with g = ±0.999 and albedo 1, and compare the distribution of cosines."""
    traces, worst = [], 0.0
    for g in (0.999, -0.999):
        phase = {"kind": "henyey_greenstein", "g": g}
        world = build(_in_front(_slab(1.0, scattering_per_mm=0.01, phase=phase)))
        # So far from the axis that returning light passes beside the lens.
        aside = np.full(20_000, 300.0)
        paths = _away(world, aside, aside)
        once = (paths.events == 1) & (paths.weight > 0.0)
        cosine = np.sort(-paths.direction[once, 2])
        count = len(cosine)
        below = (1.0 - g * g) / (2.0 * g) * (1.0 / np.sqrt(1.0 + g * g - 2.0 * g * cosine) - 1.0 / (1.0 + g))
        steps = np.arange(count + 1) / count
        off = max(np.abs(below - steps[1:]).max(), np.abs(below - steps[:-1]).max())
        worst = max(worst, off * np.sqrt(count)) if count > 200 else np.inf
        traces.append(paths)
    return outcome(
        traces,
        f"Kolmogorov's distance within {KOLMOGOROV} over the root of the number",
        f"{worst:.2f}",
        worst < KOLMOGOROV,
    )


@case
def one_voxel() -> Outcome:
    """Cross a trilinear grid of a single voxel through its middle, its edges and its corners."""
    with tempfile.TemporaryDirectory(prefix="lfmesh-") as folder:
        world = build(_in_front(_voxels(Path(folder), np.full((1, 1, 1), 0.5), 4.0), folder=Path(folder)))
    inside = np.array([0.0, 1.0, -1.999, 1.999, 0.5, -2.0 + 1e-12])
    paths = _away(world, inside, inside[::-1])
    return _compared(paths, _straight(paths, len(inside)), np.full(len(inside), 2.0), "through one voxel")


@case
def plane_of_voxels() -> Outcome:
    """Cross grids that are one voxel thick, along and across the plane, with both interpolations."""
    traces, found, depth = [], [], []
    for way in ("trilinear", "constant"):
        for shape in ((5, 5, 1), (1, 5, 5)):
            with tempfile.TemporaryDirectory(prefix="lfmesh-") as name:
                folder = Path(name)
                medium = _voxels(folder, np.full(shape, 0.25), 2.0, interpolation=way)
                world = build(_in_front(medium, folder=folder))
            x = np.linspace(-0.9, 0.9, 7)
            traces.append(_away(world, x, 0.5 * x))
            found.append(_straight(traces[-1], len(x)))
            depth.append(np.full(len(x), 0.25 * 2.0 * shape[2]))
    return _compared(traces, np.concatenate(found), np.concatenate(depth), "through a plane of voxels")


@case
def mesh_round_a_medium() -> Outcome:
    """Cross media along lines through all vertices of a ball of 1,280 facets and through diagonals of box faces."""
    traces, found, depth = [], [], []
    kappa = 0.05
    ball, box = trimesh.creation.icosphere(3, 8.0), trimesh.creation.box((8.0, 6.0, 4.0))
    for mesh, aims in ((ball, ball.vertices), (box, 0.5 * box.vertices)):
        planes = ConvexHull(mesh.vertices).equations
        across = np.abs(planes[:, 2]) > ALONG
        # Exclude lines within a face, which may or may not count as inside.
        aims = aims[(aims @ planes[~across, :3].T + planes[~across, 3] < -ALONG).all(axis=1)]
        with tempfile.TemporaryDirectory(prefix="lfmesh-") as folder:
            mesh.export(Path(folder) / "shell.off", digits=17)
            medium = {"bounds": {"file": "shell.off", "units": "mm"}, "position_mm": [0.0, 0.0, MIDDLE]}
            world = build(_in_front(medium | {"absorption_per_mm": kappa}, folder=Path(folder)))
        traces.append(_away(world, aims[:, 0], aims[:, 1]))
        found.append(_straight(traces[-1], len(aims)))
        ends = -(aims[:, :2] @ planes[across, :2].T + planes[across, 3]) / planes[across, 2]
        up = planes[across, 2] > 0.0
        depth.append(kappa * (ends[:, up].min(axis=1) - ends[:, ~up].max(axis=1)))
    return _compared(traces, np.concatenate(found), np.concatenate(depth), "through closed meshes")


@case
def along_faces_of_cells() -> Outcome:
    """Run along faces and edges of constant voxels, where either side is right, but nothing may count twice."""
    draw = np.random.default_rng(3)
    values = draw.uniform(0.01, 0.4, (4, 4, 16))
    with tempfile.TemporaryDirectory(prefix="lfmesh-") as name:
        folder = Path(name)
        world = build(_in_front(_voxels(folder, values, 1.0, interpolation="constant"), folder=folder))
    places = np.array([(x, y) for x in (-1.0, 0.0, 1.0) for y in (-1.0, -0.5, 0.0, 1.0)])
    paths = _away(world, places[:, 0], places[:, 1])
    found = -np.log(_straight(paths, len(places)))
    sums = values.sum(axis=2)
    worst = 0.0
    for depth, (x, y) in zip(found, places, strict=True):
        columns = [
            sums[int(np.floor(x + 2.0 + a)), int(np.floor(y + 2.0 + b))] for a in (-1e-9, 1e-9) for b in (-1e-9, 1e-9)
        ]
        outside = max(min(columns) - depth, depth - max(columns), 0.0)
        worst = max(worst, outside) if np.isfinite(depth) else np.inf
    return outcome(
        paths, "optical depths between those of the columns beside the ray, within 1e-11", f"{worst:.1e} outside them",
        worst <= 1e-11,
    )  # fmt: skip


@case
def medium_at_the_lens() -> Outcome:
    """Enter the lens from a medium that touches it, in front of a convex, a flat and a concave surface."""
    traces, found, depth = [], [], []
    kappa, start = 0.3, 8.0
    for radius, behind in ((50.0, -50.0), (np.inf, -50.0), (-30.0, -20.0)):
        surfaces = surfaces_of(((radius, 4.0, 1.5168), (behind, 0.0, 1.0)), aperture=8.0)
        slab = {"bounds": {"kind": "box", "size_mm": [99.0, 99.0, start]}, "absorption_per_mm": kappa}
        world = build(_in_front(slab | {"position_mm": [0.0, 0.0, -0.5 * start]}, surfaces=surfaces))
        clear = build(_in_front(surfaces=surfaces))
        x = np.linspace(0.0, 5.0, 6)
        origins = np.column_stack([x, 0.0 * x, np.full(len(x), -start - 3.0)])
        ends = [
            trace(each, origins, np.tile([0.0, 0.0, 1.0], (len(x), 1)), split="transmit") for each in (world, clear)
        ]
        weights = np.full((2, len(x)), np.nan)
        for row, paths in zip(weights, ends, strict=True):
            row[paths.source] = paths.weight
        sag = 0.0 * x if np.isinf(radius) else x**2 / (radius * (1.0 + np.sqrt(1.0 - (x / radius) ** 2)))
        traces += ends
        found.append(weights[0] / weights[1])
        depth.append(kappa * (start + np.minimum(sag, 0.0)))
    return _compared(traces, np.concatenate(found), np.concatenate(depth), "what the lens receives", AT_LENS)


@case
def hottest_and_coldest_gas() -> Outcome:
    """Look at a grey slab of 1 K to 1e6 K: emittance times Planck's radiance, without overflow."""
    kappa, thickness = 0.05, 10.0
    changes: dict[str, Any] = {
        "camera.sensor.bands": [{"name": "G", "center_nm": 550.0, "fwhm_nm": 2.0}],
        "camera.sensor.pixels": (4, 4),
        "transport.samples": 32,
        "transport.replicates": 2,
        "transport.split": "transmit",
    }
    sheet = {"shape": {"kind": "plane", "width_mm": 1e3, "height_mm": 1e3}, "position_mm": [0.0, 0.0, MIDDLE]}
    powers = {}
    for kelvin in (1.0, 300.0, 3000.0, 1e6):
        gas = _in_front(_slab(thickness, absorption_per_mm=kappa, temperature_k=kelvin), **changes)
        black = sheet | {"material": {"reflectance": 0.0, "temperature_k": kelvin}}
        wall = lens_scene(SINGLET).changed({"targets": [black], **changes})
        powers[kelvin] = [float(render(each).mean.sum()) for each in (gas, wall)]
    shares = [gas / wall for kelvin, (gas, wall) in powers.items() if wall > 0.0]
    finite = bool(np.isfinite(list(powers.values())).all())
    expected = -np.expm1(-kappa * thickness)
    # Oblique rays cross more of the slab, by 4 % at the edges of the pixels.
    passed = finite and len(shares) >= 3 and all(expected < share < 1.1 * expected for share in shares)
    return Outcome(
        "", f"{expected:.4f} of a black wall's light, or a little more aslant", ", ".join(f"{s:.4f}" for s in shares),
        passed, 0.0, 1.0, 0,
    )  # fmt: skip


def _thin_fog(scattering: float, thickness: float, lamps: list[dict[str, Any]]) -> tuple[Array, Array]:
    """Render thin fog along a single line, by one lamp at a time; return radiances and errors, W/(m² sr)."""
    changes: dict[str, Any] = {
        "camera.sensor.pixels": (2, 2),
        "camera.sensor.pixel_mm": 1e-6,
        "transport.samples": 1024,
        "transport.replicates": 8,
        "transport.split": "transmit",
    }
    surfaces = surfaces_of(((50.0, 4.0, 1.5168), (-50.0, 0.0, 1.0)), aperture=5e-6)
    wall = Target(
        shape=Plane(width_mm=1e3, height_mm=1e3), position_mm=(0.0, 0.0, CHART_AT),
        material=Material(reflectance=0.0, radiance_w_m2_sr=1.0),
    )  # fmt: skip
    glowing = float(render(lens_scene(surfaces).changed({"targets": [wall], **changes})).mean.sum())
    slab = _slab(thickness, scattering_per_mm=scattering)
    images = [render(_in_front(slab, surfaces=surfaces, lights=[lamp], **changes)) for lamp in lamps]
    found = np.array([image.mean.sum() for image in images]) / glowing
    return found, np.array([np.sqrt((image.stderr**2).sum()) for image in images]) / glowing


@case
def lamp_beside_the_line() -> Outcome:
    """Look through thin fog along lines that pass a lamp at 0.1 to 100 mm, where the scattered light peaks."""
    scattering, thickness, power = 1e-6, 200.0, 2.0
    aside = np.array([0.1, 1.0, 10.0, 100.0])
    lamps = [{"kind": "point", "position_mm": [each, 0.0, MIDDLE], "power_w": power} for each in aside]
    found, errors = _thin_fog(scattering, thickness, lamps)
    angle = 2.0 * np.arctan(0.5 * thickness / aside)
    # The integral of σ P / (4π)² r² along the line, per mm²; radiances are per m².
    expected = 1e6 * scattering * power * angle / ((4.0 * np.pi) ** 2 * aside)
    return _along_line(found / expected, errors / expected, "the integral of 1 / r² along the line")


@case
def disk_lamp_on_the_line() -> Outcome:
    """Look through thin fog along a line that ends in the middle of a disk lamp of 0.01 to 50 mm."""
    scattering, thickness, power = 1e-6, 200.0, 2.0
    radii, depth = np.array([0.01, 0.1, 1.0, 15.0, 50.0]), 0.5 * thickness
    lamps = [
        {"kind": "disk", "position_mm": [0.0, 0.0, MIDDLE], "direction": [0.0, 0.0, 1.0], "radius_mm": r,
         "power_w": power} for r in radii
    ]  # fmt: skip
    found, errors = _thin_fog(scattering, thickness, lamps)
    # σ L / 4π times the integral of the solid angle 2π (1 − h / √(h² + R²)) over the height h.
    seen = radii + depth - np.hypot(depth, radii)
    expected = 1e6 * scattering * 0.5 * power / (np.pi * radii) ** 2 * seen
    return _along_line(found / expected, errors / expected, "the integral of the disk's solid angle")


def _along_line(found: Array, sigma: Array, what: str, beside: float = 0.0) -> Outcome:
    """Compare found over expected light with 1, allowing a deviation not covered by the truth."""
    off = np.maximum(np.abs(found - 1.0) - beside, 0.0) / sigma
    return Outcome(
        "", f"{what} within 4 σ, σ below 4 %", f"off by {off.max():.1f} σ, σ = {sigma.max():.1%}",
        bool(off.max() < 4.0 and sigma.max() < 0.04), 0.0, float(len(found)), 0,
    )  # fmt: skip


def _glowing(emission: float, **values: Any) -> dict[str, Any]:
    """Return a fog that glows with the source function 1 W/(m² sr) and has the albedo 0."""
    return {"emission_w_mm3_sr": 1e-6 * emission, "absorption_per_mm": emission, **values}


@case
def camera_in_glowing_fog() -> Outcome:
    """Place the camera in fog that glows, absorbs and scatters, between equally bright walls: all views are alike."""
    # This holds for any scattering, if the medium ends just in front of the lens or touches it, and if media overlap.
    # Only the camera is dark; it hides less than half a percent of the light.
    fog = {"scattering_per_mm": 0.002, "phase": {"kind": "henyey_greenstein", "g": 0.7}, **_glowing(0.01)}
    near = {"bounds": {"kind": "box", "size_mm": [5e3, 5e3, 300.0]}}
    media = {
        "without bounds": [fog],
        "up to 1 µm before the lens": [fog | near | {"position_mm": [0.0, 0.0, -150.001]}],
        "over one another": [
            fog, fog | near | {"position_mm": [0.0, 0.0, -200.0]}, _glowing(0.03, **_slab(100.0)),
            {"scattering_per_mm": 0.01, **_slab(50.0)},
        ],
    }  # fmt: skip
    changes: dict[str, Any] = {
        "camera.sensor.pixels": (2, 2),
        "transport.samples": 1024,
        "transport.replicates": 8,
        "transport.split": "transmit",
        "transport.max_events": 2000,
    }
    material = {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}
    walls = [
        {"shape": {"kind": "plane", "width_mm": 4e5, "height_mm": 4e5}, "position_mm": [0.0, 0.0, z],
         "material": material} for z in (CHART_AT, -CHART_AT)
    ]  # fmt: skip
    clear = float(render(lens_scene(SINGLET).changed({"targets": walls, **changes})).mean.sum())
    found, errors = [], []
    for each in media.values():
        image = render(lens_scene(SINGLET).changed({"targets": walls, "media": each, **changes}))
        found.append(float(image.mean.sum()) / clear)
        errors.append(float(np.sqrt((image.stderr**2).sum())) / clear)
    return _along_line(np.array(found), np.array(errors), "as bright as the walls without fog", 5e-3)
