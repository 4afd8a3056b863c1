"""Watts in pixels against closed forms: the camera equation, lamps, form factors, a furnace.

Form factors of a surface element: J. R. Howell, "A Catalog of Radiation Heat Transfer Configuration Factors",
B-4 (rectangle) and B-13 (disk off its axis).
"""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from tests.renders import by_seed

Array = NDArray[np.float64]

LEVEL = 1e-3
"""Chance that a statistical test fails though the law holds; shared by its comparisons (Bonferroni)."""

MM2 = 1e-6


def disk_factor(height: float, offset: Array | float, radius: float) -> Array:
    """Form factor from an element to a parallel disk whose centre stands `height` above and `offset` aside."""
    # Z of the catalogue times offset², so that an offset of zero is no special case.
    z = np.square(offset) + height**2 + radius**2
    return 0.5 * (1.0 - (z - 2.0 * radius**2) / np.sqrt(z**2 - 4.0 * np.square(offset) * radius**2))


def rectangle_factor(height: float, x0: float, x1: float, y0: float, y1: float) -> float:
    """Form factor from an element at the origin to the rectangle [x0, x1] x [y0, y1] parallel to it."""

    def corner(x: float, y: float) -> float:
        a, b = x / height, y / height
        p, q = np.sqrt(1.0 + a * a), np.sqrt(1.0 + b * b)
        return float(a / p * np.arctan(b / p) + b / q * np.arctan(a / q)) / (2.0 * np.pi)

    return corner(x1, y1) - corner(x0, y1) - corner(x1, y0) + corner(x0, y0)


def test_form_factors_agree_with_quadrature() -> None:
    """The formulas above against ∫ cos² / (π r²) dA, by Gauss-Legendre to the last digits."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    x, y = np.meshgrid(6.0 + 3.0 * nodes, 1.0 + 2.0 * nodes)
    r2 = x**2 + y**2 + 25.0
    integral = 6.0 * (np.outer(weights, weights) * 25.0 / (np.pi * r2**2)).sum()
    assert rectangle_factor(5.0, 3.0, 9.0, -1.0, 3.0) == pytest.approx(integral, rel=1e-12)
    r, phi = np.meshgrid(1.0 + nodes, np.pi * nodes)
    r2 = (6.0 + r * np.cos(phi)) ** 2 + (r * np.sin(phi)) ** 2 + 25.0
    integral = np.pi * (np.outer(weights, weights) * r * 25.0 / (np.pi * r2**2)).sum()
    assert disk_factor(5.0, 6.0, 2.0) == pytest.approx(integral, rel=1e-12)


def behind_a_stop(index: float, method: str) -> lf.Scene:
    """A conventional camera whose stop, 3 mm in radius, is the last thing before the sensor, 16 mm on."""
    return lf.Scene(
        camera={
            "lens": {
                "surfaces": [
                    {"radius_mm": 40.0, "thickness_mm": 2.0, "index": index, "semi_diameter_mm": 8.0},
                    {"radius_mm": -40.0, "thickness_mm": 0.5, "semi_diameter_mm": 8.0},
                    {"stop": True, "semi_diameter_mm": 3.0},
                ]
            },
            "sensor": {"pixels": [8, 6], "pixel_mm": 0.5, "distance_mm": 16.0},
        },
        targets=[
            {"shape": {"kind": "plane", "width_mm": 22.0, "height_mm": 22.0}, "position_mm": [0, 0, -20.0],
             "material": {"reflectance": 0.0, "radiance_w_m2_sr": 5.0}}
        ],
        transport={"method": method, "samples": 64 if method == "adjoint" else 2000, "replicates": 1,
                   "split": "transmit", "threads": 1},
    )  # fmt: skip


@pytest.mark.parametrize("method", ["adjoint", "forward"])
@pytest.mark.parametrize(("index", "transmittance", "bound"), [(1.0001, 1.0, 1e-8), (1.5, 0.96**2, 2e-4)])
def test_irradiance_of_every_pixel_is_pi_l_t_times_the_stops_form_factor(
    method: str, index: float, transmittance: float, bound: float
) -> None:
    """E = π L T sin² u' on the axis, and off it π L T times the form factor of the stop, averaged over the pixel.

    A plane of one radiance fills what the lens sees, so the radiance behind the lens is L T. Up to 20° of incidence
    the transmittance of unpolarised light is that of normal incidence within 1e-4 a surface: it differs in θ⁴.
    """
    images = np.array([image.mean[..., 0] for image in by_seed(behind_a_stop(index, method), range(32))])
    rows, columns = images.shape[1:]
    nodes, weights = np.polynomial.legendre.leggauss(8)
    x = 0.5 * (np.arange(columns)[:, None] - 0.5 * (columns - 1) + 0.5 * nodes)
    y = 0.5 * (np.arange(rows)[:, None] - 0.5 * (rows - 1) + 0.5 * nodes)
    factor = disk_factor(16.0, np.hypot(x[None, :, None, :], y[:, None, :, None]), 3.0)
    factor = (factor * 0.25 * np.outer(weights, weights)).sum(axis=(2, 3))
    expected = np.pi * 5.0 * transmittance * factor * 0.25 * MM2
    # The axial pixels by the camera equation alone: sin² u' = r² / (r² + d²).
    axial = expected[rows // 2, columns // 2]
    assert axial == pytest.approx(np.pi * 5.0 * transmittance * 9.0 / 265.0 * 0.25 * MM2, rel=2e-3)
    total = images.sum(axis=(1, 2))
    assert stats.sem(total) < 0.006 * total.mean()
    assert_means(np.column_stack([images.reshape(32, -1), total]), np.append(expected, expected.sum()), bound)


def assert_means(samples: Array, expected: Array, bound: float) -> None:
    """Test that the columns' means are `expected` within a relative bound: t-tests, Bonferroni."""
    error = stats.sem(samples, axis=0)
    off = np.maximum(np.abs(samples.mean(axis=0) - expected) - bound * expected, 0.0)
    p = 2.0 * stats.t.sf(off / error, len(samples) - 1)
    assert p.min() > LEVEL / p.size


REFLECTANCE = 0.6


def patch(lights: list[Any], others: list[Any] | None = None, radiance: float = 0.0) -> lf.Scene:
    """A patch 0.2 mm wide on the axis, 60 mm before a conventional camera: small, so that it is lit evenly."""
    size = {"kind": "plane", "width_mm": 0.2, "height_mm": 0.2}
    material = {"reflectance": REFLECTANCE, "radiance_w_m2_sr": radiance}
    if radiance:
        material["reflectance"] = 0.0
    return lf.Scene(
        camera={
            "focus_mm": 60.0,
            "lens": {
                "surfaces": [
                    {"radius_mm": 20.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 2.0, "stop": True},
                    {"radius_mm": -20.0, "semi_diameter_mm": 5.0},
                ]
            },
            "sensor": {"pixels": [4, 4], "pixel_mm": 0.025},
        },
        targets=[
            {"shape": size, "position_mm": [0, 0, -60.0], "material": material},
            *(others or []),
        ],
        lights=lights,
        transport={"samples": 256, "replicates": 1, "split": "transmit", "threads": 1},
    )


def irradiance(scene: lf.Scene, glowing: lf.Scene) -> float:
    """Return the patch's irradiance in W/m² as the camera sees it: L = ρ E / π, against a patch of 1 W/(m² sr).

    The same seed gives both the same paths from the sensor to the patch, so their noise is not in the ratio.
    """
    return float(np.pi / REFLECTANCE * lf.render(scene).mean.sum() / lf.render(glowing).mean.sum())


def irradiances(scene: lf.Scene, count: int) -> NDArray[np.float64]:
    """Return the patch's irradiance by so many seeds, (count,) W/m², as `irradiance` measures it."""
    light, glow = (
        np.array([image.mean.sum() for image in by_seed(one, range(count))]) for one in (scene, patch([], radiance=1.0))
    )
    return np.asarray(np.pi / REFLECTANCE * light / glow)


@pytest.mark.parametrize("aside", [0.0, 10.0, 40.0, 120.0])
def test_point_lamp_obeys_the_cosine_cubed_law(aside: float) -> None:
    """E = P / (4 π h²) cos³ θ; the patch's extent changes it by some (0.1 mm / h)²."""
    h = 30.0
    cos = h / np.hypot(h, aside)
    lamp = {"kind": "point", "position_mm": [0.6 * aside, 0.8 * aside, h - 60.0], "power_w": 2.0}
    expected = 2.0 / (4.0 * np.pi * h * h * MM2) * cos**3
    assert irradiance(patch([lamp]), patch([], radiance=1.0)) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("angle", [10.0, 35.0, 80.0])
def test_directional_lamp_obeys_the_cosine_law(angle: float) -> None:
    """At 0° the camera would stand in the light."""
    a = np.radians(angle)
    lamp = {"kind": "directional", "direction": [np.sin(a), 0.0, -np.cos(a)], "irradiance_w_m2": 3.0}
    assert irradiance(patch([lamp]), patch([], radiance=1.0)) == pytest.approx(3.0 * np.cos(a), rel=1e-12)


def test_two_lamps_add_up() -> None:
    one = {"kind": "point", "position_mm": [10.0, 0.0, -30.0], "power_w": 2.0}
    two = {"kind": "directional", "direction": [1.0, 0.0, -1.0], "irradiance_w_m2": 30.0}
    glowing = patch([], radiance=1.0)
    alone = irradiance(patch([one]), glowing) + irradiance(patch([two]), glowing)
    assert irradiance(patch([one, two]), glowing) == pytest.approx(alone, rel=1e-12)


@pytest.mark.parametrize("aside", [0.0, 25.0])
def test_disk_lamp_is_a_lambertian_disk(aside: float) -> None:
    """E = π L₀ F with L₀ = P / (π² R²): on the axis P / (π (R² + d²))."""
    lamp = {"kind": "disk", "position_mm": [0.0, aside, -35.0], "direction": [0.0, 0.0, -1.0], "radius_mm": 8.0,
            "power_w": 2.0}  # fmt: skip
    expected = 2.0 / (np.pi * 64.0 * MM2) * disk_factor(25.0, aside, 8.0)
    if aside == 0.0:
        assert expected == pytest.approx(2.0 / (np.pi * (64.0 + 625.0) * MM2), rel=1e-12)
    found = irradiances(patch([lamp]), 128)
    assert stats.sem(found) < 0.0007 * expected
    assert_means(found[:, None], np.array([expected]), 1e-4)


@pytest.mark.parametrize("method", ["adjoint", "forward"])
def test_the_other_side_of_a_one_sided_sheet_is_black(method: str) -> None:
    """A patch that emits and reflects, and a glowing wall above it: what turns its back shows and gives no light."""
    wall = {"shape": {"kind": "plane", "width_mm": 30.0, "height_mm": 40.0}, "position_mm": [25.0, 5.0, -45.0],
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 7.0}}  # fmt: skip
    lamp = {"kind": "point", "position_mm": [10.0, 0.0, -30.0], "power_w": 2.0}
    settings = {"transport.method": method, "transport.samples": 64 if method == "adjoint" else 4000}

    def power(scene: lf.Scene, **changes: Any) -> float:
        return float(lf.render(scene.changed(settings | changes)).mean.sum())

    front, turned = "targets[0].material.sides", "targets[0].rotation_deg"
    for lit in (patch([], radiance=1.0), patch([lamp])):
        if method == "adjoint" or lit.lights:
            # Forward, packets of what emits on both sides draw their side, so that the image differs by chance.
            assert power(lit, **{front: "front"}) == power(lit) > 0.0
        assert power(lit, **{front: "front", turned: [0.0, 180.0, 0.0]}) == 0.0
        assert power(lit, **{turned: [0.0, 180.0, 0.0]}) > 0.0
    glowing, front, turned = patch([], [wall]), "targets[1].material.sides", "targets[1].rotation_deg"
    assert power(glowing, **{front: "front"}) == 0.0
    if method == "adjoint":
        # Forward, hardly a packet of the wall meets the patch.
        assert power(glowing, **{front: "front", turned: [0.0, 180.0, 0.0]}) > 0.0


@pytest.mark.parametrize("sides", ["both", "front"])
def test_light_of_a_glowing_rectangle_arrives_by_its_form_factor(sides: str) -> None:
    """E = π L F: one bounce from target to target."""
    wall = {"shape": {"kind": "plane", "width_mm": 30.0, "height_mm": 40.0}, "position_mm": [25.0, 5.0, -45.0],
            "rotation_deg": [180.0, 0.0, 0.0],
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 7.0, "sides": sides}}  # fmt: skip
    expected = np.pi * 7.0 * rectangle_factor(15.0, 10.0, 40.0, -15.0, 25.0)
    found = irradiances(patch([], [wall]), 32)
    assert stats.sem(found) < 0.015 * expected
    assert_means(found[:, None], np.array([expected]), 1e-4)


def test_light_that_went_through_two_walls_arrives_by_both_form_factors() -> None:
    """Lamp to wall to patch: a wall lit evenly by parallel light has the radiance ρ E / π."""
    wall = {"shape": {"kind": "plane", "width_mm": 30.0, "height_mm": 40.0}, "position_mm": [25.0, 5.0, -45.0],
            "material": {"reflectance": 0.9}}  # fmt: skip
    # From below: it reaches the wall's lower side, which faces the patch, but no side of the patch that is seen.
    lamp = {"kind": "directional", "direction": [0.0, 0.0, 1.0], "irradiance_w_m2": 10.0}
    expected = 0.9 * 10.0 * rectangle_factor(15.0, 10.0, 40.0, -15.0, 25.0)
    found = irradiances(patch([lamp], [wall]), 32)
    assert stats.sem(found) < 0.015 * expected
    assert_means(found[:, None], np.array([expected]), 1e-4)


def furnace(reflectance: float, radiance: float) -> lf.Scene:
    """A camera that looks through a hole, 3 mm square, into a box of walls alike, 40 mm wide."""
    material = {"reflectance": reflectance, "radiance_w_m2_sr": radiance}

    def wall(width: float, height: float, position: list[float], rotation: list[float]) -> dict[str, Any]:
        return {"shape": {"kind": "plane", "width_mm": width, "height_mm": height}, "position_mm": position,
                "rotation_deg": rotation, "material": material}  # fmt: skip

    front = -0.5
    middle = front - 20.0
    frame = 0.5 * (40.0 - 3.0)
    centre = 0.5 * (20.0 + 1.5)
    return lf.Scene(
        camera={
            "lens": {
                "surfaces": [
                    {"radius_mm": 20.0, "thickness_mm": 1.0, "index": 1.5, "semi_diameter_mm": 1.2},
                    {"radius_mm": -20.0, "thickness_mm": 0.3, "semi_diameter_mm": 1.2},
                    {"stop": True, "semi_diameter_mm": 0.8},
                ]
            },
            "sensor": {"pixels": [4, 4], "pixel_mm": 0.5, "distance_mm": 18.0},
        },
        targets=[
            wall(40.0, 40.0, [0.0, 0.0, front - 40.0], [0.0, 0.0, 0.0]),
            wall(40.0, 40.0, [-20.0, 0.0, middle], [0.0, 90.0, 0.0]),
            wall(40.0, 40.0, [20.0, 0.0, middle], [0.0, 90.0, 0.0]),
            wall(40.0, 40.0, [0.0, -20.0, middle], [90.0, 0.0, 0.0]),
            wall(40.0, 40.0, [0.0, 20.0, middle], [90.0, 0.0, 0.0]),
            wall(frame, 40.0, [-centre, 0.0, front], [0.0, 0.0, 0.0]),
            wall(frame, 40.0, [centre, 0.0, front], [0.0, 0.0, 0.0]),
            wall(3.0, frame, [0.0, -centre, front], [0.0, 0.0, 0.0]),
            wall(3.0, frame, [0.0, centre, front], [0.0, 0.0, 0.0]),
        ],
        transport={"samples": 256, "replicates": 1, "split": "transmit", "threads": 1},
    )


@pytest.mark.parametrize("reflectance", [0.5, 0.9])
def test_a_furnace_shows_no_walls(reflectance: float) -> None:
    """Walls that emit (1 − ρ) L and reflect ρ have the radiance L, after any number of bounces, whatever their shape.

    The hole is 9 mm² of 9600 mm²; light that meets it is gone. A path makes 1 / (1 − ρ) bounces on average, and the
    back wall sees the hole under a form factor of 9 / (π 40²) at most, so L lacks ρ / (1 − ρ) · 0.2 % at most.
    """
    walls, black = (
        np.array([image.mean.sum() for image in by_seed(scene, range(24))])
        for scene in (furnace(reflectance, 1.0 - reflectance), furnace(0.0, 1.0))
    )
    ratio = walls / black
    lack = 0.002 * reflectance / (1.0 - reflectance)
    assert stats.sem(ratio) < 0.01
    assert_means(ratio[:, None], np.array([1.0 - 0.5 * lack]), 0.5 * lack)


GLOSSES = {
    "smoothest": {"index": 1.5, "roughness": 0.01},
    "dense": {"index": 4.0, "roughness": 0.1},
    "rough": {"index": 1.5, "roughness": 1.0},
}


@pytest.mark.parametrize("gloss", GLOSSES.values(), ids=GLOSSES)
def test_a_furnace_shows_no_glossy_white_sheet(gloss: dict[str, float]) -> None:
    """In a box whose black walls have one radiance, a tilted sheet that scatters all light has that radiance, too.

    It fills the picture, and throws its highlight aside. From there the hole, which is dark, has a form factor of
    9 cos 45° / (π 27²) = 0.3 %; facets of the largest roughness throw a little more than that back to where they are
    seen from.
    """
    empty = furnace(0.0, 1.0)
    sheet = {"shape": {"kind": "plane", "width_mm": 14.0, "height_mm": 14.0}, "position_mm": [0.0, 0.0, -28.0],
             "rotation_deg": [0.0, 45.0, 0.0], "material": {"reflectance": 1.0, "gloss": gloss}}  # fmt: skip
    held = lf.Scene(**(empty.model_dump() | {"targets": [*empty.model_dump()["targets"], sheet]}))
    with_sheet, without = (
        np.array([image.mean.sum() for image in by_seed(scene, range(24))]) for scene in (held, empty)
    )
    ratio = with_sheet / without
    assert stats.sem(ratio) < 0.001
    assert_means(ratio[:, None], np.array([1.0 - 0.0025]), 0.0025)


def test_a_sheer_sheet_lets_pass_what_it_does_not_cover() -> None:
    """A black sheet of opacity 0.3 before a glowing patch leaves 0.7 of it; three of them leave 0.343."""

    def veil(z_mm: float) -> dict[str, Any]:
        return {"shape": {"kind": "plane", "width_mm": 30.0, "height_mm": 30.0}, "position_mm": [0.0, 0.0, z_mm],
                "material": {"reflectance": 0.0, "opacity": 0.3}}  # fmt: skip

    bare, one, three = (
        np.array([image.mean.sum() for image in by_seed(patch([], veils, radiance=1.0), range(32))])
        for veils in ([], [veil(-30.0)], [veil(-30.0), veil(-59.9999), veil(-29.0)])
    )
    found = np.column_stack([one, three]) / bare[:, None]
    assert (stats.sem(found, axis=0) < 0.01).all()
    assert_means(found, np.array([0.7, 0.343]), 1e-6)


def test_a_sheer_sheet_dims_a_lamp_behind_it() -> None:
    """A sheet of opacity 0.6 between lamp and patch, beside the camera's view."""
    lamp = {"kind": "point", "position_mm": [20.0, 0.0, -30.0], "power_w": 2.0}
    veil = {"shape": {"kind": "plane", "width_mm": 8.0, "height_mm": 8.0}, "position_mm": [10.0, 0.0, -45.0],
            "rotation_deg": [0.0, 40.0, 0.0], "material": {"reflectance": 0.0, "opacity": 0.6}}  # fmt: skip
    free, dimmed = irradiances(patch([lamp]), 32), irradiances(patch([lamp], [veil]), 32)
    found = dimmed / free
    assert stats.sem(found) < 0.01
    assert_means(found[:, None], np.array([0.4]), 1e-6)
