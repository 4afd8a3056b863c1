"""Forbes' mild aspheres: the published polynomials, their orthogonality, rays refracted there in both engines."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import brentq

import lfmesh as lf
from lfmesh.errors import SceneError
from lfmesh.imports import read_lens_file, write_lens_file
from lfmesh.scene.camera.qbfs import Qbfs

Array = NDArray[np.float64]

STEP = 1e-5
"""mm: the derivative of the sag is a central difference of fourth order."""


def published(x: Array) -> Array:
    """Return Q₀ to Q₅ (6, n) as Forbes (2007) prints them."""
    return np.array(
        [
            np.ones_like(x),
            (13 - 16 * x) / np.sqrt(19),
            np.sqrt(2 / 95) * (29 - 4 * x * (25 - 19 * x)),
            np.sqrt(2 / 2545) * (207 - 4 * x * (315 - x * (577 - 320 * x))),
            (7737 - 16 * x * (4653 - 2 * x * (7381 - 8 * x * (1168 - 509 * x)))) / (3 * np.sqrt(131831)),
            (66657 - 32 * x * (28338 - x * (135325 - 8 * x * (35884 - x * (34661 - 12432 * x)))))
            / (3 * np.sqrt(6632213)),
        ]
    )


def sag(curvature: float, rho: float, coefficients: Array, r: Array) -> Array:
    """Return the sphere and the deviation of up to six terms, by the formula of the paper."""
    x = (r / rho) ** 2
    root = np.sqrt(1.0 - (curvature * r) ** 2)
    q = np.tensordot(coefficients, published(x)[: len(coefficients)], axes=1)
    return np.asarray(curvature * r * r / (1.0 + root) + x * (1.0 - x) / root * q)


def drawn(seed: int) -> tuple[float, float, Array]:
    """Return curvature, norm radius and coefficients; every fourth sphere is flat."""
    draw = np.random.default_rng(seed)
    rho = float(10.0 ** draw.uniform(-1.0, 2.0))
    curvature = 0.0 if seed % 4 == 0 else float(draw.choice([-1.0, 1.0]) * draw.uniform(0.01, 0.5) / rho)
    return curvature, rho, rho * draw.normal(size=int(draw.integers(1, 5))) * 10.0 ** draw.uniform(-6.0, -2.5)


def lens_surface(curvature: float, rho: float, coefficients: Array, **keys: Any) -> lf.Surface:
    """Return a surface whose aperture is that of its polynomials, unless `keys` say otherwise."""
    qbfs = {"norm_radius_mm": rho, "coefficients_mm": coefficients}
    keys = {"index": 1.5, "semi_diameter_mm": rho} | keys
    return lf.Surface(radius_mm=1.0 / curvature if curvature else np.inf, qbfs=qbfs, **keys)


@pytest.mark.parametrize("m", range(10))
def test_the_slopes_of_the_terms_are_orthonormal(m: int) -> None:
    """Their mean product over ρ, weighted by 1 / √(1 − u²), is 1 for equal terms and 0 for others, as Forbes wants."""
    u = np.cos((np.arange(64) + 0.5) * np.pi / 128)

    def slopes(order: int) -> Array:
        # A flat sphere makes the even form exact: its coefficients, without their own rounding at this order.
        form = Qbfs(norm_radius_mm=1.0, coefficients_mm=(0.0,) * order + (0.01,)).even_form(0.0)
        assert form is not None
        terms = (0.5 / form.radius_mm, *form.asphere_mm)
        return np.asarray(100.0 * sum((2 * k + 2) * a * u ** (2 * k + 1) for k, a in enumerate(terms)))

    for other in range(m + 1):
        assert np.mean(slopes(m) * slopes(other)) == pytest.approx(float(m == other), abs=1e-7)


@pytest.mark.parametrize("m", range(6))
def test_polynomials_are_those_of_the_paper(m: int) -> None:
    """On a flat sphere, where u² (1 − u²) Q_m is all there is."""
    form = Qbfs(norm_radius_mm=1.0, coefficients_mm=(0.0,) * m + (0.01,)).even_form(0.0)
    assert form is not None
    x = np.linspace(0.0, 1.0, 50)
    found = sum(a * x ** (k + 1) for k, a in enumerate((0.5 / form.radius_mm, *form.asphere_mm)))
    np.testing.assert_allclose(found, 0.01 * x * (1.0 - x) * published(x)[m], atol=1e-13)


@pytest.mark.parametrize("seed", range(24))
def test_the_sag_is_that_of_the_paper(seed: int) -> None:
    """Within the limit that no surface is accepted beyond, and within what the even form says of itself."""
    curvature, rho, coefficients = drawn(seed)
    surface = lens_surface(curvature, rho, coefficients)
    r = rho * np.linspace(0.0, 1.0, 301)
    off = np.abs([surface.sag_mm(float(h)) for h in r] - sag(curvature, rho, coefficients, r)).max()
    form = Qbfs(norm_radius_mm=rho, coefficients_mm=coefficients).even_form(1.0 / surface.radius_mm)
    assert form is not None
    assert form.error_mm <= 1e-9 * min(1.0, rho)
    assert off <= 1.5 * form.error_mm + 1e-14 * rho
    bent = 2.0 * (sag(curvature, rho, coefficients, np.array([1e-3 * rho])) / (1e-3 * rho) ** 2)[0]
    assert surface.curvature_per_mm == pytest.approx(bent, abs=1e-4 * np.abs(coefficients).sum() / rho**2 + 1e-6 / rho)


@pytest.mark.parametrize("seed", range(6))
def test_rays_are_refracted_at_the_surface_of_the_formula(seed: int) -> None:
    """They meet it within 1e-9 mm of a root of the formula, turn by Snell's law; both engines end within 1e-9 mm."""
    draw = np.random.default_rng(seed)
    index, rho = float(draw.uniform(1.4, 1.9)), 4.5
    curvature = 0.0 if seed == 0 else float(draw.choice([-1.0, 1.0]) / draw.uniform(9.0, 60.0))
    coefficients = draw.normal(size=4) * 0.03 * 0.3 ** np.arange(4)
    keys = {"thickness_mm": 6.0, "index": index, "stop": True, "semi_diameter_mm": 4.0}
    scene = lf.Scene(
        camera={
            "lens": {"surfaces": [lens_surface(curvature, rho, coefficients, **keys), {"semi_diameter_mm": 8.0}]},
            "sensor": {"pixels": (400, 400), "pixel_mm": 0.2, "distance_mm": 10.0},
        }
    )
    p = np.column_stack([draw.uniform(-2.5, 2.5, (60, 2)), np.full(60, -30.0)])
    d = np.column_stack([draw.uniform(-2.0, 2.0, (60, 2)), np.zeros(60)]) - p
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    world = lf.build(scene)
    paths = lf.trace(world, p, d, split="transmit", record=True)
    met = 0
    for path in np.flatnonzero(paths.status == lf.Status.SENSOR):
        _, first, second, *_ = (vertex.position for vertex in paths.vertices(path))
        start, along = p[paths.source[path]], d[paths.source[path]]

        def above(t: float, start: Array = start, along: Array = along) -> float:
            x, y, z = start + t * along
            return float(z - sag(curvature, rho, coefficients, np.hypot(x, y)[None])[0])

        root = brentq(above, 28.0 / along[2], 32.0 / along[2], xtol=1e-13, rtol=1e-15)
        np.testing.assert_allclose(first, start + root * along, atol=1e-9)
        r = float(np.hypot(first[0], first[1]))
        around = sag(curvature, rho, coefficients, np.abs(r + STEP * np.array([-2.0, -1.0, 1.0, 2.0])))
        slope = (8.0 * (around[2] - around[1]) - (around[3] - around[0])) / (12.0 * STEP)
        normal = np.array([-slope * first[0] / r, -slope * first[1] / r, 1.0])
        normal /= np.linalg.norm(normal)
        inside = (second - first) / np.linalg.norm(second - first)
        # Across the normal, n times the direction stays.
        assert np.abs(np.cross(normal, index * inside - along)).max() < 1e-8
        met += 1
    assert met > 30
    other = lf.trace(world, p, d, split="transmit", engine="sequential")
    whole, same = paths.status == lf.Status.SENSOR, other.status == lf.Status.SENSOR
    np.testing.assert_array_equal(paths.source[whole], other.source[same])
    np.testing.assert_allclose(paths.position[whole], other.position[same], atol=1e-9)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"norm_radius_mm": 0.0}, "norm_radius_mm = 0"),
        ({"coefficients_mm": []}, "coefficients_mm"),
        ({"coefficients_mm": [0.1] * 15}, "coefficients_mm"),
        ({"coefficients_mm": [1e300]}, "qbfs.*ends inside semi_diameter_mm = 5"),
        ({"norm_radius_mm": 31.0}, "qbfs.*ends inside semi_diameter_mm = 31"),
        ({"norm_radius_mm": 28.0}, "qbfs.*even terms give its sag with an error of .* mm"),
        ({"coefficients_mm": [0.0] * 13 + [0.1]}, "qbfs.*even terms give its sag with an error of .* mm"),
        ({"norm_radius_mm": 4.0}, "semi_diameter_mm = 5.*ends at norm_radius_mm = 4"),
    ],
)
def test_what_is_no_asphere_is_refused(keys: dict[str, object], message: str) -> None:
    own = {"norm_radius_mm": 5.0, "coefficients_mm": [0.1]} | keys
    with pytest.raises(SceneError, match=message):
        lf.Surface(radius_mm=30.0, semi_diameter_mm=max(5.0, own["norm_radius_mm"]), index=1.5, qbfs=own)


def test_what_is_accepted_at_any_scale_is_the_formula() -> None:
    """From 1e-30 to 1e15 mm; the sag within 1e-9 mm, or 1e-9 of the norm radius where that is less."""
    draw = np.random.default_rng(1)
    accepted = 0
    for _ in range(200):
        rho, share = 10.0 ** draw.uniform(-30.0, 15.0), 10.0 ** draw.uniform(-12.0, 1.0)
        curvature = float(draw.choice([-1.0, 0.0, 1.0])) / max(1e-30, min(1e15, rho * 10.0 ** draw.uniform(-1.0, 3.0)))
        coefficients = share * rho * draw.normal(size=int(draw.integers(1, 7)))
        try:
            surface = lens_surface(curvature, rho, coefficients)
        except SceneError:
            continue
        r = rho * np.linspace(0.0, 1.0, 30)
        off = np.abs([surface.sag_mm(float(h)) for h in r] - sag(curvature, rho, coefficients, r)).max()
        assert off <= 1.5e-9 * min(1.0, rho) + 1e-14 * rho
        accepted += 1
    assert accepted > 30


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"asphere_mm": [1e-5]}, "asphere_mm.*omit it"),
        ({"qcon": {"norm_radius_mm": 5.0, "coefficients_mm": [0.1]}}, "qcon.*omit it"),
        ({"semi_diameter_mm": None}, "semi_diameter_mm.*missing"),
        ({"paraxial": True, "focal_length_mm": 50.0, "index": None, "radius_mm": np.inf}, "qbfs.*omit it"),
    ],
)
def test_what_a_mild_asphere_does_not_go_with_is_refused(keys: dict[str, Any], message: str) -> None:
    own = {"radius_mm": 30.0, "semi_diameter_mm": 5.0, "index": 1.5} | keys
    with pytest.raises(SceneError, match=message):
        lf.Surface(qbfs={"norm_radius_mm": 5.0, "coefficients_mm": [0.1]}, **own)


def test_a_stop_is_not_sized_beyond_the_polynomials() -> None:
    front = lens_surface(0.05, 4.0, np.array([0.01]), stop=True, thickness_mm=3.0)
    with pytest.raises(SceneError, match=r"surfaces.0..qbfs.*size of this stop by semi_diameter_mm, not f_number"):
        lf.Lens(surfaces=(front, lf.Surface(radius_mm=-40.0, semi_diameter_mm=4.0)), f_number=2.0)


@pytest.mark.parametrize("ending", ["zmx", "seq"])
@pytest.mark.parametrize("curvature", [0.0, 0.02])
def test_files_of_other_programs_have_the_even_form(tmp_path: Path, ending: str, curvature: float) -> None:
    front = lens_surface(curvature, 4.0, np.array([0.02, -0.004]), stop=True, thickness_mm=3.0)
    lens = lf.Lens(surfaces=(front, lf.Surface(radius_mm=-40.0, semi_diameter_mm=4.0)))
    write_lens_file(lens, tmp_path / f"lens.{ending}")
    read, _ = read_lens_file(tmp_path / f"lens.{ending}")
    assert read.surfaces[0].asphere_mm == pytest.approx(front.terms_mm, rel=1e-12)
    assert read.surfaces[0].radius_mm == pytest.approx(front.vertex_radius_mm, rel=1e-12)
    assert read.surfaces[0].conic == front.vertex_conic
    assert read.surfaces[0].qbfs is None
