"""Light in media against solutions of the transfer equation that do not trace rays.

Sources: S. Chandrasekhar, Radiative Transfer (1950), chapter V, equation 31 and the law of diffuse reflection of a
semi-infinite isotropic medium (chapter III, equation 112); for slabs, adding and doubling of thin layers (H. C. van de
Hulst, Multiple Light Scattering, 1980, chapter 4), written here, as his tables are not at hand; for light that is
scattered once, the integral along the line of sight.
"""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.accuracy.hard.outcome import lens_scene, surfaces_of
from tests.cameras import camera_without_array
from tests.instances import instances
from tests.renders import unchecked

Array = NDArray[np.float64]

TILT_DEG = 40.0
"""Of the slab's normal from the camera's axis, about y."""


SAMPLES = 65536
"""Of a pixel, where light is scattered many times."""


def camera(small_stop: bool = False) -> dict[str, Any]:
    """Return a camera of so few degrees that all its pixels see a slab at one angle."""
    camera = camera_without_array(pixels=2, pixel_mm=0.2)
    if small_stop:
        camera["lens"]["stop_semi_diameter_mm"] = 0.6
    return camera


@cache
def power_of_one(small_stop: bool) -> float:
    """Return the power that the pixels receive of a radiance of 1 W/(m² sr) everywhere, W."""
    scene = lf.Scene(
        camera=camera(small_stop),  # type: ignore[arg-type]
        targets=[{"shape": {"kind": "plane", "width_mm": 100.0, "height_mm": 100.0},  # type: ignore[list-item]
                  "position_mm": [0.0, 0.0, -150.0], "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}],
        transport={"split": "transmit", "samples": 1 << 16, "seed": 5},  # type: ignore[arg-type]
    )  # fmt: skip
    return float(unchecked(scene).mean.sum())


def mean_radiance(
    media: list[dict[str, Any]], lights: list[dict[str, Any]], small_stop: bool = False, **transport: Any
) -> tuple[float, float]:
    """Return the mean radiance that the pixels see, W/(m² sr), and its standard error."""
    settings = {"split": "transmit", "replicates": 16, "seed": 5} | transport
    scene = lf.Scene(camera=camera(small_stop), media=media, lights=lights, transport=settings)  # type: ignore[arg-type]
    image = unchecked(scene)
    whole = power_of_one(small_stop)
    return float(image.mean.sum() / whole), float(np.sqrt((image.stderr**2).sum()) / whole)


def tilted_slab(depth_mm: float, **values: Any) -> dict[str, Any]:
    """Return a slab whose lit face passes through the axis at z = -150."""
    normal = np.array([np.sin(np.deg2rad(TILT_DEG)), 0.0, np.cos(np.deg2rad(TILT_DEG))])
    middle = np.array([0.0, 0.0, -150.0 - 0.0]) - 0.5 * depth_mm * normal
    return {
        "bounds": {"kind": "box", "size_mm": [150.0, 150.0, depth_mm]},
        "position_mm": middle.tolist(),
        "rotation_deg": [0.0, TILT_DEG, 0.0],
        **values,
    }


def along_normal(behind: bool = False) -> dict[str, Any]:
    """Return a light of 1 W/m² that falls on a slab along its normal, on the face that is seen or on the other one."""
    angle, sense = np.deg2rad(TILT_DEG), 1.0 if behind else -1.0
    direction = [sense * np.sin(angle), 0.0, sense * np.cos(angle)]
    return {"kind": "directional", "direction": direction, "irradiance_w_m2": 1.0}


@cache
def h_function(albedo: float) -> tuple[Array, Array]:
    """Return nodes μ and H(μ) of Chandrasekhar's equation, by iteration of its form with 1 / H."""
    x, w = np.polynomial.legendre.leggauss(200)
    mu, w = 0.5 * (x + 1.0), 0.5 * w
    h = np.ones_like(mu)
    for _ in range(2000):
        rest = np.sqrt(1.0 - albedo) + 0.5 * albedo * (w * mu * h / (mu[:, None] + mu)).sum(axis=1)
        new = 1.0 / rest
        if np.abs(new - h).max() < 1e-13:
            break
        h = 0.5 * (h + new)
    return mu, h


def h_at(albedo: float, mu: float) -> float:
    nodes, h = h_function(albedo)
    w = 0.5 * np.polynomial.legendre.leggauss(200)[1]
    return float(1.0 / (np.sqrt(1.0 - albedo) + 0.5 * albedo * (w * nodes * h / (mu + nodes)).sum()))


def test_h_function_has_its_zeroth_moment() -> None:
    h = h_function(0.8)[1]
    w = 0.5 * np.polynomial.legendre.leggauss(200)[1]
    # The zeroth moment of H is known in closed form.
    assert (w * h).sum() == pytest.approx(2.0 / 0.8 * (1.0 - np.sqrt(0.2)), rel=1e-10)


def test_semi_infinite_isotropic_medium_reflects_by_chandrasekhars_h_function() -> None:
    albedo, mu, mu0 = 0.8, np.cos(np.deg2rad(TILT_DEG)), 1.0
    medium = tilted_slab(120.0, scattering_per_mm=0.8, absorption_per_mm=0.2)
    found, sigma = mean_radiance([medium], [along_normal()], samples=32768)
    expected = albedo / (4.0 * np.pi) * mu0 / (mu + mu0) * h_at(albedo, mu) * h_at(albedo, mu0)
    assert sigma < 0.005 * expected
    assert abs(found - expected) < 3.0 * sigma, (found, expected, sigma)


@cache
def slab_functions(
    albedo: float, depth: float, g: float, mu: float, nodes: int = 24
) -> tuple[Array, Array, Array, Array, Array]:
    """Return what a slab reflects and transmits diffusely between pairs of cosines, by adding and doubling.

    With them the cosines, their weights, and the share of light at each that nothing meets. Layers are doubled from one
    so thin that light is scattered in it once (van de Hulst 1980, section 4.2). The last two cosines, μ and 1, are
    nodes of no weight.
    """
    x, w = np.polynomial.legendre.leggauss(nodes)
    angles = np.concatenate([0.5 * (x + 1.0), [mu, 1.0]])
    weights = np.concatenate([0.5 * w, [0.0, 0.0]])
    order = np.arange(2 * nodes)
    polynomials = np.array([np.polynomial.legendre.Legendre.basis(n)(angles) for n in order])
    moments = (2 * order + 1) * g**order
    # Phase functions, means over the azimuth, for light that goes on towards the same face, and towards the other one.
    on, back = (np.einsum("n,ni,nj->ij", moments * sign**order, polynomials, polynomials) / 2.0 for sign in (1.0, -1.0))
    # Truncated and normalised on the nodes, so that no light is made or lost.
    whole = ((on + back) * weights).sum(axis=1, keepdims=True)
    halvings = 30
    step = depth / 2.0**halvings
    r, t = (albedo * step * each / whole / angles[:, None] for each in (back, on))
    beam = np.exp(-step / angles)
    for _ in range(halvings):
        between = r * weights @ r
        between = np.linalg.solve(np.eye(len(angles)) - between * weights, between)
        down = t + between * beam + between * weights @ t
        up = r * beam + r * weights @ down
        r = r + beam[:, None] * up + t * weights @ up
        t = beam[:, None] * down + t * beam + t * weights @ down
        beam = beam * beam
    return r, t, angles, weights, beam


@cache
def slab_radiance(albedo: float, depth: float, g: float, mu: float, nodes: int = 24) -> tuple[Array, Array]:
    """Return what a slab reflects and transmits diffusely of unit irradiance along the normal.

    Each is the radiance at the cosine μ, and the flux through the face.
    """
    r, t, angles, weights, _ = slab_functions(albedo, depth, g, mu, nodes)
    reflected, transmitted = (
        np.array([each[-2, -1] / (2.0 * np.pi), (weights * angles * each[:, -1]).sum()]) for each in (r, t)
    )
    return reflected, transmitted


def test_adding_and_doubling_agree_with_the_h_function_and_with_known_fluxes() -> None:
    mu = np.cos(np.deg2rad(TILT_DEG))
    expected = 0.8 / (4.0 * np.pi) / (mu + 1.0) * h_at(0.8, mu) * h_at(0.8, 1.0)
    assert slab_radiance(0.8, 40.0, 0.0, mu)[0][0] == pytest.approx(expected, rel=1e-5)
    # Of the program iadpython, for an isotropic slab of albedo 0.9 and optical depth 1, and for a half-space.
    reflected, transmitted = slab_radiance(0.9, 1.0, 0.0, mu)
    assert (reflected[1], transmitted[1]) == pytest.approx((0.267410, 0.223746), abs=2e-6)
    assert slab_radiance(0.9, 100.0, 0.0, mu)[0][1] == pytest.approx(0.414947, abs=2e-6)
    # What nothing absorbs comes out.
    reflected, transmitted = slab_radiance(1.0, 3.0, 0.75, mu)
    assert reflected[1] + transmitted[1] + np.exp(-3.0) == pytest.approx(1.0, abs=1e-6)


SLABS = [(0.9, 1.0, 0.0), (0.9, 2.0, 0.0), (1.0, 1.0, 0.0), (0.9, 4.0, 0.6), (0.99, 2.0, 0.75), (0.5, 0.5, -0.5)]
"""Albedo, optical depth, asymmetry."""
LONG_SLABS = [(0.9, 1.0, 0.0), (0.9, 2.0, 0.0), (0.9, 4.0, 0.6), (0.99, 2.0, 0.75)]
"""Those between others, and the deepest: the suite has that which absorbs nothing, and one that scatters backwards."""


@pytest.mark.parametrize("slab", instances(SLABS, long=LONG_SLABS))
@pytest.mark.parametrize("face", ["reflected", "transmitted"])
def test_slab_shines_as_adding_and_doubling_say(slab: tuple[float, float, float], face: str) -> None:
    """Radiance at 40 degrees from the normal, lit along it: 12 z-tests at 3 sigma, sigma below 0.5 %."""
    albedo, depth, g = slab
    mu = float(np.cos(np.deg2rad(TILT_DEG)))
    expected = slab_radiance(albedo, depth, g, mu)[face == "transmitted"][0]
    kappa = depth / 4.0
    medium = tilted_slab(4.0, scattering_per_mm=albedo * kappa, absorption_per_mm=(1.0 - albedo) * kappa,
                         phase={"kind": "henyey_greenstein", "g": g})  # fmt: skip
    found, sigma = mean_radiance([medium], [along_normal(behind=face == "transmitted")], samples=SAMPLES)
    assert sigma < 0.005 * expected
    assert abs(found - expected) < 3.0 * sigma, (found, expected, sigma)


def slab_emission(albedo: float, depth: float, g: float, mu: float) -> float:
    """Return the radiance at the cosine μ of a slab at one temperature, as a share of a black body's.

    Between black walls of its own temperature the slab would be as bright as they are. What it reflects and transmits
    of their light is not its own (Kirchhoff's law): B (1 − R − T).
    """
    r, t, _, weights, beam = slab_functions(albedo, depth, g, mu)
    return float(1.0 - r[-2] @ weights - t[-2] @ weights - beam[-2])


def test_emission_of_slabs_has_its_known_limits() -> None:
    mu = float(np.cos(np.deg2rad(TILT_DEG)))
    assert slab_emission(0.0, 1.5, 0.0, mu) == pytest.approx(1.0 - np.exp(-1.5 / mu), rel=1e-8)
    assert slab_emission(1.0, 2.0, 0.6, mu) == pytest.approx(0.0, abs=1e-6)
    # Of a half-space that scatters alike in all directions: √(1 − ϖ) H(μ).
    assert slab_emission(0.8, 60.0, 0.0, mu) == pytest.approx(np.sqrt(0.2) * h_at(0.8, mu), rel=1e-5)
    # By reciprocity: the flux of light that falls on the slab at μ.
    r, t, angles, weights, beam = slab_functions(0.9, 4.0, 0.6, mu)
    fluxes = [(weights * angles * each[:, -2]).sum() / mu for each in (r, t)]
    assert slab_emission(0.9, 4.0, 0.6, mu) == pytest.approx(1.0 - sum(fluxes) - beam[-2], rel=1e-5)


@pytest.mark.parametrize("slab", instances([slab for slab in SLABS if slab[0] < 1.0], long=LONG_SLABS))
def test_slab_that_emits_and_scatters_shines_by_kirchhoffs_law(slab: tuple[float, float, float]) -> None:
    """Radiance at 40 degrees from the normal: 5 z-tests at 3 sigma, sigma below 0.5 %.

    Through a small stop: a slab is brighter where it is seen more obliquely, by a thousandth over the whole lens.
    """
    albedo, depth, g = slab
    mu = float(np.cos(np.deg2rad(TILT_DEG)))
    kappa = depth / 4.0
    absorption = (1.0 - albedo) * kappa
    medium = tilted_slab(4.0, scattering_per_mm=albedo * kappa, absorption_per_mm=absorption,
                         emission_w_mm3_sr=absorption * 1e-6, phase={"kind": "henyey_greenstein", "g": g})  # fmt: skip
    found, sigma = mean_radiance([medium], [], small_stop=True, samples=SAMPLES, replicates=32)
    expected = slab_emission(albedo, depth, g, mu)
    assert sigma < 0.005 * expected
    assert abs(found - expected) < 3.0 * sigma, (found, expected, sigma)


@pytest.mark.parametrize("g", [0.0, 0.7])
def test_single_scattering_is_its_integral_along_lines_of_sight(g: float) -> None:
    """A point lamp before a tilted slab that absorbs a million times what it scatters, so that twice is nothing.

    Along a line of sight through the slab ∫ κs p(cos θ) I / r² exp(−κ (a + b)) dt, with the ways a from the point to
    the camera and b to the lamp inside the slab; the mean over the rays of a pixel through the stop of a thin lens.
    """
    kappa, ks, depth = 0.2, 2e-7, 12.0
    medium = tilted_slab(depth, absorption_per_mm=kappa - ks, scattering_per_mm=ks,
                         phase={"kind": "henyey_greenstein", "g": g})  # fmt: skip
    place = np.array([30.0, -20.0, -110.0])
    lamp = {"kind": "point", "position_mm": place.tolist(), "power_w": 4.0 * np.pi}
    found, sigma = mean_radiance([medium], [lamp], small_stop=True, samples=8192)
    normal = np.array([np.sin(np.deg2rad(TILT_DEG)), 0.0, np.cos(np.deg2rad(TILT_DEG))])
    face = np.array([0.0, 0.0, -150.0])
    nodes, weights = np.polynomial.legendre.leggauss(24)
    report = lf.first_order(lf.Scene(camera=camera(small_stop=True)))  # type: ignore[arg-type]
    half = 0.2 / abs(report.magnification)
    total = 0.0
    for px, py in ((-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)):
        eye = np.array([0.0, 0.0, report.entrance_pupil_z_mm])
        d = np.array([px * half, py * half, -150.0]) - eye
        d /= np.linalg.norm(d)
        near, far = ((face - shift * normal - eye) @ normal / (d @ normal) for shift in (0.0, depth))
        t = 0.5 * (near + far) + 0.5 * (far - near) * nodes
        points = eye + t[:, None] * d
        to_lamp = place - points
        r = np.linalg.norm(to_lamp, axis=1)
        inside = (face - points) @ normal / (to_lamp @ normal / r)
        cosine = -(to_lamp @ -d) / r
        p = (1.0 - g * g) / (4.0 * np.pi * (1.0 + g * g - 2.0 * g * cosine) ** 1.5)
        values = ks * p / r**2 * 1e6 * np.exp(-kappa * (t - near + inside))
        total += 0.25 * 0.5 * (far - near) * (weights * values).sum()
    assert sigma < 0.003 * total
    assert abs(found - total) < 3.0 * sigma + 5e-4 * total, (found, total, sigma)


@pytest.mark.parametrize(("g", "absorption", "depth"), [(0.0, 0.01, 120.0), (0.7, 0.01, 120.0), (0.0, 1e-7, 60.0)])
def test_single_scattering_past_a_lamp_in_the_medium_is_its_integral_along_lines_of_sight(
    g: float, absorption: float, depth: float
) -> None:
    """Two lamps in a slab that hardly scatters, one 2 mm beside lines of sight of 120 mm, the other bright and farther.

    As above, from both lamps, by even steps of the angle at which a lamp sees the line: mean over pixels and pupil.
    """
    ks, front = 1e-7, 90.0
    medium = {"bounds": {"kind": "box", "size_mm": [200.0, 200.0, depth]}, "position_mm": [0, 0, -front - 0.5 * depth],
              "absorption_per_mm": absorption - ks, "scattering_per_mm": ks,
              "phase": {"kind": "henyey_greenstein", "g": g}}  # fmt: skip
    lamps = [((2.0, 1.0, -130.0), 1.0), ((-25.0, 10.0, -140.0), 3.0)]
    lights = [{"kind": "point", "position_mm": place, "power_w": 4.0 * np.pi * i} for place, i in lamps]
    found, sigma = mean_radiance([medium], lights, small_stop=True, samples=24576)
    report = lf.first_order(lf.Scene(camera=camera(small_stop=True)))  # type: ignore[arg-type]
    half, radius = 0.2 / abs(report.magnification), 0.5 * report.entrance_pupil_diameter_mm
    across = half * (np.arange(8) - 3.5) / 4.0
    turn = 2.0 * np.pi * np.arange(6) / 6.0
    pupil = np.sqrt(0.5) * radius * np.stack([np.cos(turn), np.sin(turn), np.zeros(6)], axis=1)
    eyes = pupil + np.array([0.0, 0.0, report.entrance_pupil_z_mm])
    nodes, weights = np.polynomial.legendre.leggauss(64)
    values = []
    for eye in eyes:
        for px, py in np.stack(np.meshgrid(across, across), axis=-1).reshape(-1, 2):
            d = np.array([px, py, -150.0]) - eye
            d /= np.linalg.norm(d)
            near, far = ((-z - eye[2]) / d[2] for z in (front, front + depth))
            value = 0.0
            for place, intensity in lamps:
                s = (place - eye) @ d
                h = np.linalg.norm(place - eye - s * d)
                low, high = np.arctan2(near - s, h), np.arctan2(far - s, h)
                theta = 0.5 * (low + high) + 0.5 * (high - low) * nodes
                t, r = s + h * np.tan(theta), h / np.cos(theta)
                # The light goes on along the line from the lamp to the point, and is seen against the line of sight.
                p = (1.0 - g * g) / (4.0 * np.pi * (1.0 + g * g - 2.0 * g * (s - t) / r) ** 1.5)
                each = ks * p * intensity * 1e6 / h * np.exp(-absorption * (t - near + r))
                value += 0.5 * (high - low) * (weights * each).sum()
            values.append(value)
    expected = float(np.mean(values))
    assert sigma < 0.004 * expected
    assert abs(found - expected) < 3.0 * sigma + 5e-4 * expected, (found, expected, sigma)


def lines_past_a_disk(place: Array, normal: Array, radius: float, near: float, far: float) -> float:
    """Return ∫ Ω dt, of the solid angle Ω of a disk's front as points of the axis z = -t see it, mm sr.

    Panels of Gauss's quadrature are narrow where the line crosses the disk's plane and passes over its border. About
    the foot of a point's height h over the plane, a disk's solid angle is ∫ h / √(h² + ρ²) between its borders ρ(φ).
    """
    nodes, weights = np.polynomial.legendre.leggauss(10)
    turns, turn_weights = np.polynomial.legendre.leggauss(200)
    crossing = -(place @ normal) / normal[2]
    along = np.array([0.0, 0.0, -1.0]) + normal[2] * normal
    start = -place + (place @ normal) * normal
    a, b, c = along @ along, start @ along, start @ start - radius**2
    root = np.sqrt(max(b * b - a * c, 0.0))
    ends = {near, far}
    for at in (-place[2], crossing, (-b - root) / a, (-b + root) / a):
        ends |= {at, *(at + side * width for side in (-1.0, 1.0) for width in np.geomspace(1e-4 * radius, 100.0, 24))}
    cuts = np.unique(np.clip(list(ends), near, far))
    half = 0.5 * np.diff(cuts)[:, None]
    t = (cuts[:-1, None] + half * (1.0 + nodes)).ravel()
    points = np.stack([0.0 * t, 0.0 * t, -t], axis=1) - place
    h = points @ normal
    q = np.linalg.norm(points - h[:, None] * normal, axis=1)[:, None]
    # Over the disk all turns φ; beside it those within asin(R / q), by φ = asin(R / q) sin w.
    w = 0.5 * np.pi * 0.5 * (turns + 1.0)
    over = q < radius
    widest = np.arcsin(radius / np.maximum(q, radius))
    phi = np.where(over, 2.0 * w, widest * np.sin(w))
    chord = np.sqrt(np.maximum(radius**2 - (q * np.sin(phi)) ** 2, 0.0))
    first = np.where(over, 0.0, q * np.cos(phi) - chord)
    last = np.where(over, chord - q * np.cos(phi), q * np.cos(phi) + chord)
    steps = np.where(over, 2.0, widest * np.cos(w)) * 0.25 * np.pi * turn_weights
    height = np.where(h > 0.0, h, 1.0)[:, None]
    omega = 2.0 * (steps * (height / np.hypot(height, first) - height / np.hypot(height, last))).sum(axis=1)
    return float((np.where(h > 0.0, omega, 0.0).reshape(-1, len(nodes)) * half * weights).sum())


def test_fog_past_disk_lamps_is_its_integral_along_the_line_and_errors_are_as_stated() -> None:
    """Twenty random disks on or beside the axis in thin fog: the pixels' and their sums' z are Student's t of 15.

    Their mean squares are held against 1.154 + 3.3 times their spread, √(3.39 / n).
    """
    ks, near, far, power = 1e-6, 100.0, 300.0, 2.0
    random = np.random.default_rng(31)
    surfaces = surfaces_of(((50.0, 4.0, 1.5168), (-50.0, 0.0, 1.0)), aperture=5e-6)
    changes = {"camera.sensor.pixels": (2, 2), "camera.sensor.pixel_mm": 1e-6, "transport.samples": 2048,
               "transport.replicates": 16, "transport.split": "transmit"}  # fmt: skip
    wall = {"shape": {"kind": "plane", "width_mm": 1e3, "height_mm": 1e3}, "position_mm": [0.0, 0.0, -400.0],
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}  # fmt: skip
    fog = {"bounds": {"kind": "box", "size_mm": [1e3, 1e3, far - near]}, "position_mm": [0.0, 0.0, -200.0],
           "scattering_per_mm": ks}  # fmt: skip
    one = unchecked(lens_scene(surfaces).changed({"targets": [wall], **changes})).mean.mean()
    pixels, sums = [], []
    for number in range(20):
        radius = 10.0 ** random.uniform(-0.5, 1.3)
        aside, turn = radius * max(random.uniform(-0.5, 2.0), 0.0), random.uniform(0.0, 2.0 * np.pi)
        place = np.array([aside * np.cos(turn), aside * np.sin(turn), random.uniform(-240.0, -160.0)])
        normal = random.normal(size=3) if number % 4 else np.array([np.cos(turn), np.sin(turn), 0.02])
        normal /= np.linalg.norm(normal)
        lamp = {"kind": "disk", "position_mm": place.tolist(), "direction": normal.tolist(), "radius_mm": radius,
                "power_w": power}  # fmt: skip
        scene = lens_scene(surfaces).changed({"media": [fog], "lights": [lamp], "transport.seed": number, **changes})
        image = unchecked(scene)
        radiance = power / (np.pi * np.pi * radius**2) * 1e6
        expected = ks / (4.0 * np.pi) * radiance * lines_past_a_disk(place, normal, radius, near, far) * one
        pixels += ((image.mean - expected) / image.stderr).ravel().tolist()
        sums.append((image.mean - expected).sum() / np.sqrt((image.stderr**2).sum()))
    for z in (np.array(pixels), np.array(sums)):
        assert (z**2).mean() < 1.154 + 3.3 * np.sqrt(3.39 / len(z)), z


def test_a_thin_flame_is_its_abel_integral_seen_through_a_thin_lens(tmp_path: Path) -> None:
    """Emission j(r) = j₀ exp(−r²/s²) about an upright axis in the plane in focus.

    A line that passes the axis at the distance p gathers its Abel integral j₀ s √π exp(−p²/s²), over the sine of its
    angle with the axis. Rays of a pixel at X in the plane of the axis go to points u, v of a thin lens at the distance
    D, so that p = |X| cos(atan((X − u) / D)); the mean is taken over the lens.
    """
    s, j, n = 3.0, 1e-6, 161
    axis = np.linspace(-4.0 * s, 4.0 * s, n)
    profile = j * np.exp(-(axis[:, None, None] ** 2 + axis**2) / s**2)
    np.savez(tmp_path / "flame.npz", emission_w_mm3_sr=np.repeat(profile, 2, axis=1),
             spacing_mm=[axis[1] - axis[0], 40.0, axis[1] - axis[0]])  # fmt: skip
    camera = camera_without_array(pixels=24, pixel_mm=0.06)
    camera["lens"]["stop_semi_diameter_mm"] = 0.6
    even = {"shape": {"kind": "plane", "width_mm": 100.0, "height_mm": 100.0}, "position_mm": [0.0, 0.0, -150.0],
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}  # fmt: skip
    flame = {"grid": "flame.npz", "position_mm": [0.0, 0.0, -150.0]}
    sums = []
    for what in ({"media": [flame]}, {"targets": [even]}):
        transport = {"split": "transmit", "samples": 512, "seed": 2}
        image = unchecked(lf.Scene(camera=camera, transport=transport, **what).in_folder(tmp_path))
        sums.append((image.mean.sum(axis=(0, 2)), np.sqrt((image.stderr**2).sum(axis=(0, 2)))))
    (seen, seen_error), (flat, flat_error) = sums
    report = lf.first_order(lf.Scene(camera=camera))
    # The lens inverts. X over a pixel, and u and v over the pupil, by the midpoint rule.
    across = (np.arange(24)[:, None] - 11.5 + (np.arange(8) - 3.5) / 8.0) * 0.06 / report.magnification
    d, radius = 150.0 + report.entrance_pupil_z_mm, 0.5 * report.entrance_pupil_diameter_mm
    u, v = radius * (np.indices((12, 12)) + 0.5 - 6.0) / 6.0
    inside = u**2 + v**2 < radius**2
    turn = np.arctan((across[..., None] - u[inside]) / d)
    rise = np.arctan(v[inside] / d)
    lines = s * np.sqrt(np.pi) * np.exp(-((across[..., None] * np.cos(turn)) ** 2) / s**2) / np.cos(rise)
    expected = j * 1e6 * lines.mean(axis=(1, 2))
    found = seen / flat
    error = found * np.hypot(seen_error / seen, flat_error / flat)
    lit = expected > 0.1 * expected.max()
    assert lit.sum() > 8
    assert (np.abs(found - expected) < 0.005 * expected + 3.0 * error)[lit].all(), found[lit] / expected[lit]
    assert (error[lit] < 0.002 * expected[lit]).all()


AMONG = {"kind": "sphere", "radius_mm": 20.0}
PLACE = [3.0, 2.0, -130.0]
WALL = {"shape": {"kind": "plane", "width_mm": 100.0, "height_mm": 80.0}, "position_mm": [0.0, 0.0, -160.0],
        "material": {"reflectance": 0.6}}  # fmt: skip
WINDOW = {"refractor": {"box_mm": [200.0, 200.0, 2.0], "index": 1.5}, "position_mm": [0.0, 0.0, -95.0]}
LAMP = {"kind": "point", "position_mm": [60.0, 40.0, -40.0], "power_w": 1.0}
HG = {"kind": "henyey_greenstein", "g": 0.6}
BOTH_WAYS: dict[str, tuple[dict[str, Any], list[Any], list[Any]]] = {
    "emission": ({"emission_w_mm3_sr": 1e-8}, [], []),
    "absorption before a lit wall": ({"absorption_per_mm": 0.05}, [WALL], [LAMP]),
    "a wall lit by emission": ({"absorption_per_mm": 0.05, "emission_w_mm3_sr": 1e-8}, [WALL], []),
    "scattering": ({"scattering_per_mm": 0.05, "phase": HG}, [], [LAMP]),
    "everything": (
        {"scattering_per_mm": 0.05, "absorption_per_mm": 0.01, "emission_w_mm3_sr": 1e-9, "phase": HG}, [WALL], [LAMP]
    ),
    "everything behind a window": (
        {"scattering_per_mm": 0.05, "absorption_per_mm": 0.01, "emission_w_mm3_sr": 1e-9, "phase": HG},
        [WALL, WINDOW],
        [LAMP],
    ),
}  # fmt: skip


NOISY = {"scattering": (512, 8192), "everything behind a window": (512, 2048)}
"""Samples of the adjoint and the forward method where 128 and 2048 see too little."""


def by_both_methods(camera: dict[str, Any], samples: tuple[int, int], **tables: Any) -> tuple[float, list[lf.Image]]:
    """Return how many sigma the whole light of the adjoint image is above that of the forward one, and both images."""
    images = []
    for method, count in zip(("adjoint", "forward"), samples, strict=True):
        transport = {"method": method, "samples": count, "replicates": 16, "seed": 3}
        images.append(unchecked(lf.Scene(camera=camera, transport=transport, **tables)))  # type: ignore[arg-type]
        assert abs(images[-1].ledger.imbalance) < 1e-11
    a, f = (image.mean.sum() for image in images)
    return float((a - f) / np.sqrt(sum((image.stderr**2).sum() for image in images))), images


@pytest.mark.parametrize("case", instances(BOTH_WAYS, long=["everything behind a window"]))
def test_forward_equals_adjoint_with_media(case: str) -> None:
    """A z-test of the whole light at 3.3 sigma, for six scenes a level of 0.6 %; the ledgers close."""
    values, targets, lights = BOTH_WAYS[case]
    medium = {"name": "cloud", "bounds": AMONG, "position_mm": PLACE, **values}
    samples = NOISY.get(case, (128, 2048))
    z, images = by_both_methods(camera_without_array(pixels=8), samples, media=[medium], targets=targets, lights=lights)
    for image in images:
        assert ("cloud" in image.ledger.absorbed) == ("absorption_per_mm" in values)
    assert abs(z) < 3.3, (z, images)


def hollow_front() -> dict[str, Any]:
    """Return a camera whose first surface is hollow, with its stop behind the lens."""
    camera = camera_without_array(pixels=8)
    del camera["focus_mm"]
    camera["sensor"]["distance_mm"] = 60.0
    camera["lens"]["surfaces"] = [
        {"radius_mm": -16.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 8.0},
        {"radius_mm": -11.0, "semi_diameter_mm": 8.0, "thickness_mm": 0.5},
        {"stop": True, "semi_diameter_mm": 6.5},
    ]
    return camera


def at_the_lens(depth_mm: float) -> dict[str, Any]:
    return {"bounds": {"kind": "box", "size_mm": [40.0, 40.0, depth_mm]}, "position_mm": [0.0, 0.0, -0.5 * depth_mm]}


FOG = {"scattering_per_mm": 0.004, "absorption_per_mm": 0.002, "phase": HG}
DISK = {"kind": "disk", "position_mm": [40.0, 20.0, -100.0], "direction": [-1.0, -0.5, -0.7], "radius_mm": 8.0,
        "power_w": 1.0}  # fmt: skip
GLOW = WALL | {"material": {"reflectance": 0.3, "radiance_w_m2_sr": 1.0}}
SIDE = GLOW | {"position_mm": [50.0, 0.0, -130.0], "rotation_deg": [0.0, 90.0, 0.0]}
CLOUD = {"bounds": AMONG, "position_mm": PLACE, "scattering_per_mm": 0.05, "absorption_per_mm": 0.01, "phase": HG}
TURNED = {"bounds": {"kind": "cylinder", "radius_mm": 12.0, "height_mm": 30.0}, "position_mm": [5.0, 4.0, -135.0],
          "rotation_deg": [70.0, 0.0, 5.0], "absorption_per_mm": 0.06, "emission_w_mm3_sr": 1e-9}  # fmt: skip
BALL = {"shape": {"kind": "sphere", "radius_mm": 8.0}, "position_mm": [0.0, 0.0, -125.0],
        "material": {"reflectance": 0.9}}  # fmt: skip
MIRROR = WALL | {"rotation_deg": [0.0, 20.0, 0.0],
                 "material": {"reflectance": 0.0, "gloss": {"metal": "Al", "roughness": 0.05}}}  # fmt: skip
GLASS = {"refractor": {"box_mm": [8.0, 8.0, 8.0], "index": 1.5}, "position_mm": [0.0, 0.0, -130.0],
         "rotation_deg": [20.0, 30.0, 0.0]}  # fmt: skip

SURROUNDED: dict[str, tuple[dict[str, Any] | None, tuple[int, int], dict[str, Any]]] = {
    "fog without an end and nothing in it": (None, (256, 4096), {"media": [FOG], "lights": [DISK]}),
    "fog before a hollow lens": (
        hollow_front(), (256, 8192), {"media": [at_the_lens(8.0) | {"absorption_per_mm": 0.5}], "targets": [GLOW]}
    ),
    "a cloud lit by a wall beside it": (None, (2048, 8192), {"media": [CLOUD], "targets": [SIDE]}),
    "a cloud before a mirror": (None, (512, 8192), {"media": [CLOUD], "targets": [MIRROR], "lights": [LAMP]}),
    "media over one another and a ball": (
        None, (512, 8192), {"media": [CLOUD, TURNED], "targets": [BALL], "lights": [LAMP, DISK]}
    ),
    "glass in a shining cloud": (
        None, (256, 4096), {"media": [CLOUD | {"emission_w_mm3_sr": 1e-8}], "targets": [GLASS]}
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", instances(SURROUNDED, long=["glass in a shining cloud", "a cloud before a mirror"]))
def test_forward_equals_adjoint_wherever_media_are(case: str) -> None:
    """A z-test of the whole light at 3.3 sigma, for six scenes a level of 0.6 %; no light is lost."""
    camera, samples, tables = SURROUNDED[case]
    z, images = by_both_methods(camera or camera_without_array(pixels=8), samples, **tables)
    for image in images:
        assert image.mean.sum() > 0.0
        assert sum(image.ledger.lost.values()) < 1e-7 * image.ledger.emitted
    assert abs(z) < 3.3, (z, images)


@pytest.mark.long
def test_forward_equals_adjoint_in_a_ring_by_its_mesh(tmp_path: Path) -> None:
    """A torus that glows, absorbs and scatters before a lit wall: a z-test of the whole light at 3.3 sigma.

    Media in meshes compile kernels of their own; chords through them are in transport/events/test_volume_in_mesh.
    """
    trimesh.creation.torus(14.0, 6.0).export(tmp_path / "ring.stl")
    ring = CLOUD | {"bounds": {"file": str(tmp_path / "ring.stl"), "units": "mm"}, "rotation_deg": [30.0, 20.0, 0.0],
                    "emission_w_mm3_sr": 1e-8}  # fmt: skip
    z, images = by_both_methods(
        camera_without_array(pixels=8), (128, 2048), media=[ring], targets=[WALL], lights=[LAMP]
    )
    for image in images:
        assert sum(image.ledger.lost.values()) == 0.0
        assert np.sqrt((image.stderr**2).sum()) < 0.02 * image.mean.sum()
    assert abs(z) < 3.3, (z, images)
