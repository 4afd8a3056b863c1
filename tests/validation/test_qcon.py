"""Forbes' strong aspheres: sags by Jacobi polynomials, and rays that are refracted there in both engines."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import eval_jacobi

import lfmesh as lf
from lfmesh.errors import SceneError
from lfmesh.imports import read_lens_file, write_lens_file
from lfmesh.scene.camera.qcon import Qcon

Array = NDArray[np.float64]

STEP = 1e-5
"""mm: the derivative of the sag is a central difference of fourth order."""


def sag(radius: float, conic: float, norm_radius: float, coefficients: Array, r: Array) -> Array:
    """Return the conic and u⁴ Σ a_m P_m^(0,4)(2u² − 1), as Forbes (2007) has them."""
    x = (r / norm_radius) ** 2
    base = r * r / radius / (1.0 + np.sqrt(1.0 - (1.0 + conic) * (r / radius) ** 2))
    return np.asarray(
        base + x * x * sum(a * eval_jacobi(m, 0.0, 4.0, 2.0 * x - 1.0) for m, a in enumerate(coefficients))
    )


def test_polynomials_are_those_of_the_paper() -> None:
    """Q₁ = −(5 − 6x), Q₂ = 15 − 14x(3 − 2x), Q₃ = −(35 − 12x(14 − x(21 − 10x))), with ρ = 1."""
    assert Qcon(norm_radius_mm=1.0, coefficients_mm=(0.0, 1.0)).asphere_mm == (-5.0, 6.0)
    assert Qcon(norm_radius_mm=1.0, coefficients_mm=(0.0, 0.0, 1.0)).asphere_mm == (15.0, -42.0, 28.0)
    assert Qcon(norm_radius_mm=1.0, coefficients_mm=(0.0,) * 3 + (1.0,)).asphere_mm == (-35.0, 168.0, -252.0, 120.0)


@pytest.mark.parametrize("seed", range(20))
def test_the_sag_is_that_of_jacobi_polynomials(seed: int) -> None:
    """Up to the rim of the polynomials, within the rounding that `Qcon.asphere_mm` states."""
    draw = np.random.default_rng(seed)
    count, norm_radius = int(draw.integers(1, 11)), float(10.0 ** draw.uniform(-1.0, 2.0))
    coefficients = norm_radius * draw.normal(size=count) * 10.0 ** draw.uniform(-6.0, -1.0, count)
    radius, conic = norm_radius * draw.choice([-1.0, 1.0]) * draw.uniform(1.5, 20.0), draw.uniform(-3.0, 1.0)
    qcon = {"norm_radius_mm": norm_radius, "coefficients_mm": coefficients}
    surface = lf.Surface(radius_mm=radius, conic=conic, qcon=qcon, index=1.5, semi_diameter_mm=norm_radius)
    r = norm_radius * np.linspace(0.0, 1.0, 101)
    found = np.array([surface.sag_mm(float(height)) for height in r])
    off = np.abs(found - sag(radius, conic, norm_radius, coefficients, r)).max()
    largest = np.abs(coefficients).max()
    assert off <= 1e-8 * largest + 1e-15 * norm_radius
    if count <= 4:
        assert off <= 1e-13 * largest + 1e-15 * norm_radius


@pytest.mark.parametrize("seed", range(6))
def test_rays_are_refracted_at_the_surface_of_the_formula(seed: int) -> None:
    """They meet it within 1e-9 mm and turn by Snell's law within 1e-8; both engines end within 1e-9 mm."""
    draw = np.random.default_rng(seed)
    semi, index = 4.0, float(draw.uniform(1.4, 1.9))
    radius, conic = float(draw.choice([-1.0, 1.0]) * draw.uniform(12.0, 60.0)), float(draw.uniform(-2.0, 0.5))
    coefficients = draw.normal(size=5) * 0.03 * 0.3 ** np.arange(5)
    scene = lf.Scene(
        camera={
            "lens": {
                "surfaces": [
                    {
                        "radius_mm": radius, "conic": conic, "thickness_mm": 6.0, "index": index, "stop": True,
                        "semi_diameter_mm": semi, "qcon": {"norm_radius_mm": 4.5, "coefficients_mm": coefficients},
                    },
                    {"semi_diameter_mm": 8.0},
                ]
            },
            "sensor": {"pixels": (400, 400), "pixel_mm": 0.2, "distance_mm": 10.0},
        }
    )  # fmt: skip
    p = np.column_stack([draw.uniform(-2.5, 2.5, (60, 2)), np.full(60, -30.0)])
    d = np.column_stack([draw.uniform(-2.0, 2.0, (60, 2)), np.zeros(60)]) - p
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    world = lf.build(scene)
    paths = lf.trace(world, p, d, split="transmit", record=True)
    met = 0
    for path in np.flatnonzero(paths.status == lf.Status.SENSOR):
        _, first, second, *_ = (vertex.position for vertex in paths.vertices(path))
        r = float(np.hypot(first[0], first[1]))
        around = sag(radius, conic, 4.5, coefficients, np.abs(r + STEP * np.array([-2.0, -1.0, 0.0, 1.0, 2.0])))
        assert abs(first[2] - around[2]) < 1e-9
        slope = (8.0 * (around[3] - around[1]) - (around[4] - around[0])) / (12.0 * STEP)
        normal = np.array([-slope * first[0] / r, -slope * first[1] / r, 1.0])
        normal /= np.linalg.norm(normal)
        inside = (second - first) / np.linalg.norm(second - first)
        # Across the normal, n times the direction stays.
        assert np.abs(np.cross(normal, index * inside - d[paths.source[path]])).max() < 1e-8
        met += 1
    assert met > 30
    other = lf.trace(world, p, d, split="transmit", engine="sequential")
    whole, same = paths.status == lf.Status.SENSOR, other.status == lf.Status.SENSOR
    np.testing.assert_array_equal(paths.source[whole], other.source[same])
    np.testing.assert_allclose(paths.position[whole], other.position[same], atol=1e-9)


@pytest.mark.parametrize(
    ("qcon", "message"),
    [
        ({"norm_radius_mm": 0.0, "coefficients_mm": [0.1]}, "norm_radius_mm = 0"),
        ({"norm_radius_mm": 5.0, "coefficients_mm": []}, "coefficients_mm"),
        ({"norm_radius_mm": 5.0, "coefficients_mm": [0.1] * 15}, "coefficients_mm"),
        ({"norm_radius_mm": 1e-30, "coefficients_mm": [0.1]}, "qcon.*inside the clear aperture"),
        ({"norm_radius_mm": 5.0, "coefficients_mm": [1e300]}, "qcon.*inside the clear aperture"),
        ({"coefficients_mm": [0.1]}, "norm_radius_mm.*missing"),
    ],
)
def test_what_is_no_asphere_is_refused(qcon: dict[str, object], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        lf.Surface(radius_mm=30.0, semi_diameter_mm=5.0, index=1.5, qcon=qcon)


def test_powers_of_a_tiny_radius_that_vanish_are_refused() -> None:
    """They would leave terms out without a word."""
    own = {"norm_radius_mm": 1e-22, "coefficients_mm": [1e-30] * 7}
    with pytest.raises(SceneError, match="norm_radius_mm = 1e-22: its powers"):
        lf.Surface(radius_mm=30.0, semi_diameter_mm=1e-22, index=1.5, qcon=own)


def test_an_ideal_lens_and_a_refractor_have_no_asphere() -> None:
    own = {"norm_radius_mm": 5.0, "coefficients_mm": [0.1]}
    with pytest.raises(SceneError, match="qcon: omit it"):
        lf.Surface(paraxial=True, focal_length_mm=50.0, semi_diameter_mm=5.0, qcon=own)


@pytest.mark.parametrize("ending", ["zmx", "seq"])
def test_files_of_other_programs_have_the_even_terms(tmp_path: Path, ending: str) -> None:
    own = {"norm_radius_mm": 4.0, "coefficients_mm": [0.02, -0.01, 0.003]}
    front = lf.Surface(
        radius_mm=20.0, conic=-0.5, thickness_mm=3.0, index=1.5, semi_diameter_mm=4.0, stop=True, qcon=own
    )
    lens = lf.Lens(surfaces=(front, lf.Surface(radius_mm=-40.0, semi_diameter_mm=4.0)))
    write_lens_file(lens, tmp_path / f"lens.{ending}")
    read, _ = read_lens_file(tmp_path / f"lens.{ending}")
    assert read.surfaces[0].asphere_mm == pytest.approx(front.terms_mm, rel=1e-12)
    assert read.surfaces[0].qcon is None


def test_many_terms_are_written_as_an_extended_asphere(tmp_path: Path) -> None:
    own = {"norm_radius_mm": 4.0, "coefficients_mm": [0.02, -0.01, 0.003, 1e-3, 2e-4, 1e-4, 3e-5, -1e-5, 1e-6, 2e-6]}
    front = lf.Surface(radius_mm=20.0, thickness_mm=3.0, index=1.5, semi_diameter_mm=4.0, stop=True, qcon=own)
    lens = lf.Lens(surfaces=(front, lf.Surface(radius_mm=-40.0, semi_diameter_mm=4.0)))
    write_lens_file(lens, tmp_path / "lens.zmx")
    read, _ = read_lens_file(tmp_path / "lens.zmx")
    assert read.surfaces[0].asphere_mm == front.terms_mm
