"""Light in media against solutions of the transfer equation that do not trace rays.

Sources: S. Chandrasekhar, Radiative Transfer (1950), chapter V, equation 31 and the law of diffuse reflection of a
semi-infinite isotropic medium (chapter III, equation 112); and, for anisotropic scattering in a slab, successive orders
of scattering on discrete ordinates, written here, for light that falls in along the normal (as in H. C. van de Hulst,
Multiple Light Scattering, 1980, chapter 9, whose tables are not at hand).
"""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from tests.cameras import camera_without_array

Array = NDArray[np.float64]

TILT_DEG = 40.0
"""Of the slab's normal from the camera's axis, about y."""


def camera() -> dict[str, Any]:
    """Return a camera of so few degrees that all its pixels see a slab at one angle."""
    return camera_without_array(pixels=2, pixel_mm=0.2)


def mean_radiance(media: list[dict[str, Any]], lights: list[dict[str, Any]], **transport: Any) -> tuple[float, float]:
    """Return the mean radiance that the pixels see, W/(m² sr), and its standard error."""
    settings = {"split": "transmit", "replicates": 16, "seed": 5} | transport
    scene = lf.Scene(camera=camera(), media=media, lights=lights, transport=settings)  # type: ignore[arg-type]
    image = lf.render(scene)
    unit = lf.render(
        lf.Scene(  # type: ignore[call-arg]
            camera=camera(),  # type: ignore[arg-type]
            targets=[{"shape": {"kind": "plane", "width_mm": 100.0, "height_mm": 100.0},  # type: ignore[arg-type]
                      "position_mm": [0.0, 0.0, -150.0], "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}],
            transport={"split": "transmit", "samples": 4096, "seed": 5},  # type: ignore[arg-type]
        )
    )  # fmt: skip
    whole = unit.mean.sum()
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


def along_normal(irradiance: float = 1.0) -> dict[str, Any]:
    angle = np.deg2rad(TILT_DEG)
    return {"kind": "directional", "direction": [-np.sin(angle), 0.0, -np.cos(angle)], "irradiance_w_m2": irradiance}


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


def slab_reflection(albedo: float, depth: float, g: float, mu: float, cells: int = 250, nodes: int = 20) -> float:
    """Return a slab's reflected radiance at cosine μ for unit irradiance along the normal, by orders of scattering."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    angles = np.concatenate([0.5 * (x + 1.0), [mu]])
    weights = np.concatenate([0.5 * w, [0.0]])
    signed = np.concatenate([angles, -angles])  # downwards positive
    order = np.arange(2 * nodes)
    polynomials = np.array([np.polynomial.legendre.Legendre.basis(n)(signed) for n in order])
    moments = (2 * order + 1) * g**order
    phase = np.einsum("n,ni,nj->ij", moments, polynomials, polynomials) / 2.0
    # Truncated and normalised on the nodes, so that no light is made or lost.
    both = np.concatenate([weights, weights])
    phase /= (phase * both).sum(axis=1, keepdims=True)
    step = depth / cells
    middle = (np.arange(cells) + 0.5) * step
    beam = (moments[:, None] * polynomials).sum(axis=0) / (4.0 * np.pi)
    faded = (np.exp(-middle + 0.5 * step) - np.exp(-middle - 0.5 * step)) / step
    source = albedo * beam[None, :] * faded[:, None]
    total = 0.0
    t = np.exp(-step / angles)
    # Mean of e^(-x/μ) over a cell, for the mean radiance in it.
    gain = 1.0 - t
    for _ in range(4000):
        mean = np.zeros_like(source)
        n = len(angles)
        down = np.zeros(n)
        for i in range(cells):
            s = source[i, :n]
            mean[i, :n] = s + (down - s) * gain * angles / step
            down = down * t + s * gain
        up = np.zeros(n)
        for i in range(cells - 1, -1, -1):
            s = source[i, n:]
            mean[i, n:] = s + (up - s) * gain * angles / step
            up = up * t + s * gain
        total += up[-1]
        source = albedo * (mean * both) @ phase.T
        if up[-1] < 1e-7 * total:
            break
    return float(total)


def test_orders_of_scattering_agree_with_the_h_function() -> None:
    mu = np.cos(np.deg2rad(TILT_DEG))
    expected = 0.8 / (4.0 * np.pi) / (mu + 1.0) * h_at(0.8, mu) * h_at(0.8, 1.0)
    assert slab_reflection(0.8, 25.0, 0.0, mu) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize(("albedo", "depth", "g"), [(0.9, 2.0, 0.0), (0.9, 4.0, 0.6)])
def test_slab_reflects_as_discrete_ordinates_say(albedo: float, depth: float, g: float) -> None:
    expected = slab_reflection(albedo, depth, g, float(np.cos(np.deg2rad(TILT_DEG))))
    kappa = depth / 4.0
    medium = tilted_slab(4.0, scattering_per_mm=albedo * kappa, absorption_per_mm=(1.0 - albedo) * kappa,
                         phase={"kind": "henyey_greenstein", "g": g})  # fmt: skip
    found, sigma = mean_radiance([medium], [along_normal()], samples=65536)
    assert sigma < 0.005 * expected
    assert abs(found - expected) < 3.0 * sigma, (found, expected, sigma)


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
        image = lf.render(lf.Scene(camera=camera, transport=transport, **what).in_folder(tmp_path))
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


@pytest.mark.parametrize("case", BOTH_WAYS)
def test_forward_equals_adjoint_with_media(case: str) -> None:
    """A z-test of the whole light at 3.3 sigma, for six scenes a level of 0.6 %; the ledgers close."""
    values, targets, lights = BOTH_WAYS[case]
    medium = {"name": "cloud", "bounds": AMONG, "position_mm": PLACE, **values}
    sums = []
    for method, samples in (("adjoint", 512), ("forward", 8192)):
        scene = lf.Scene(
            camera=camera_without_array(pixels=8),  # type: ignore[arg-type]
            media=[medium], targets=targets, lights=lights,  # type: ignore[arg-type]
            transport={"method": method, "samples": samples, "replicates": 16, "seed": 3},  # type: ignore[arg-type]
        )  # fmt: skip
        image = lf.render(scene)
        assert abs(image.ledger.imbalance) < 1e-11
        assert ("cloud" in image.ledger.absorbed) == ("absorption_per_mm" in values)
        sums.append((image.mean.sum(), (image.stderr**2).sum()))
    (a, var_a), (f, var_f) = sums
    assert abs(a - f) < 3.3 * np.sqrt(var_a + var_f), (a, f, np.sqrt(var_a), np.sqrt(var_f))
