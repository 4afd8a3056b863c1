"""Rays and waves through scenes with gradient-index glass against closed forms in 40 digits.

- Rod, n² = n₀² (1 + c r²): rays are harmonic in σ, dσ = ds/n, skew ones too (E. W. Marchand, Gradient Index Optics,
  Academic Press 1978).
- Hyperbolic secant, n = n₀ sech(g r): sinh(g x) of a meridional ray is harmonic in z with the rate g (A. Fletcher,
  T. Murphy and A. Young, Proc. R. Soc. Lond. A 223, 216, 1954). The scene has the series of n² in r².
- Axial gradient: n times the sine of the angle with the axis is constant, and the rest are integrals over z.
- An index that is linear in y: y is a hyperbolic cosine, as above a hot road.
- Maxwell's fish-eye, n = n₀ / (1 + ρ²/a²): each point of the rim is imaged onto the opposite one, with the optical
  path π n₀ a/2 (M. Born and E. Wolf, Principles of Optics, 4.2.2).
- Luneburg's lens, n² = 2 − ρ²/R²: parallel rays meet on the rim (R. K. Luneburg, Mathematical Theory of Optics,
  University of California Press 1964). Scenes have polynomials of both that differ by less than 10⁻¹³.

A flat front face keeps n times the sine of a ray, so that the closed forms begin with the ray in air.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from numpy.polynomial import Chebyshev, Polynomial
from numpy.typing import NDArray

import lfmesh as lf

Array = NDArray[np.float64]
Keys = dict[str, Any]

POSITION_MM, PATH_MM, DIRECTION = 1e-9, 1e-10, 1e-9
DIGITS = 40
NM = 587.6
MM_PER_NM = 1e-6

INDEX = 1.6


@dataclass(frozen=True)
class End:
    """A ray in gradient-index glass in front of its flat back face.

    Attributes
    ----------
    x, y : mpf, mm
    tx, ty : mpf
        Index times the direction cosines.
    path : mpf, mm
        Optical path from the front face.
    """

    x: Any
    y: Any
    tx: Any
    ty: Any
    path: Any


Law = Callable[[Any, Any, Any, Any, Any], End]
"""From x, y, n cos α and n cos β at the front face, and the length, to the end."""


def rod(power: float) -> Law:
    """Return the rays in n² = n₀² (1 + c r²)."""

    def end_of(x: Any, y: Any, tx: Any, ty: Any, length: Any) -> End:
        n2, c = mp.mpf(INDEX) ** 2, mp.mpf(power)
        along = mp.sqrt(n2 * (1 + c * (x * x + y * y)) - tx * tx - ty * ty)
        rate, end = mp.sqrt(mp.mpc(-n2 * c)), length / along
        cos, sin = mp.cos(rate * end), mp.sin(rate * end)
        double = mp.sin(2 * rate * end) / (4 * rate)

        def square(start: Any, speed: Any) -> Any:
            return start**2 * (end / 2 + double) + speed**2 * (end / 2 - double) + start * speed * sin**2 / rate

        path = n2 * end - rate**2 * (square(x, tx / rate) + square(y, ty / rate))
        at = [x * cos + tx * sin / rate, y * cos + ty * sin / rate]
        vector = [tx * cos - x * rate * sin, ty * cos - y * rate * sin]
        return End(*(mp.re(each) for each in (*at, *vector, path)))

    return end_of


SECANT = 0.3


def secant(x: Any, y: Any, tx: Any, ty: Any, length: Any) -> End:
    """Return the end of a meridional ray in n = n₀ sech(g r)."""
    n0, g = mp.mpf(INDEX), mp.mpf(SECANT)
    # The axis across: along the point, or along the ray from a point of the axis.
    a, b = (x, y) if x or y else (tx, ty)
    size = mp.sqrt(a * a + b * b)
    a, b = (a / size, b / size) if size else (mp.mpf(1), mp.mpf(0))
    height, across = a * x + b * y, a * tx + b * ty
    along = mp.sqrt((n0 / mp.cosh(g * height)) ** 2 - across**2)
    start, speed = mp.sinh(g * height), mp.cosh(g * height) * across / along

    def at(z: Any) -> Any:
        return start * mp.cos(g * z) + speed * mp.sin(g * z)

    path = mp.quad(lambda z: n0**2 / (1 + at(z) ** 2) / along, mp.linspace(0, length, 9))
    u = at(length)
    slope = (speed * mp.cos(g * length) - start * mp.sin(g * length)) / mp.sqrt(1 + u * u)
    reached, vector = mp.asinh(u) / g, along * slope
    return End(a * reached, b * reached, a * vector, b * vector, path)


def secant_keys() -> Keys:
    """Return the series of n², to rounding within 2 mm of the axis."""
    with mp.workdps(DIGITS):
        series = mp.taylor(lambda r: mp.sech(mp.mpf(SECANT) * r) ** 2, 0, 58)[2::2]
        return {"kind": "radial_n2", "index": INDEX, "coefficients": [float(c) for c in series]}


AXIAL = (0.05, -0.004)


def axial(x: Any, y: Any, tx: Any, ty: Any, length: Any) -> End:
    """Return the end of a ray in n = n₀ + c₁ z + c₂ z²."""

    def square(z: Any) -> Any:
        return (mp.mpf(INDEX) + mp.mpf(AXIAL[0]) * z + mp.mpf(AXIAL[1]) * z * z) ** 2

    def rate(z: Any) -> Any:
        return 1 / mp.sqrt(square(z) - tx * tx - ty * ty)

    end = mp.quad(rate, [0, length / 2, length])
    path = mp.quad(lambda z: square(z) * rate(z), [0, length / 2, length])
    return End(x + tx * end, y + ty * end, tx, ty, path)


SLOPE = 0.04


def mirage(x: Any, y: Any, tx: Any, ty: Any, length: Any) -> End:
    """Return the end of a ray in n = n₀ + b y."""
    n0, b = mp.mpf(INDEX), mp.mpf(SLOPE)
    n = n0 + b * y
    along = mp.sqrt(n * n - tx * tx - ty * ty)
    end = length / along
    cosh, sinh = mp.cosh(b * end), mp.sinh(b * end)
    behind = n * cosh + ty * sinh
    double = mp.sinh(2 * b * end) / (4 * b)
    path = n * n * (end / 2 + double) + ty * ty * (double - end / 2) + n * ty * sinh**2 / b
    return End(x + tx * end, (behind - n0) / b, tx, n * sinh + ty * cosh, path)


MEDIA: dict[str, tuple[Keys, Law]] = {
    f"rod {c:g}": ({"kind": "radial_n2", "index": INDEX, "coefficients": [c]}, rod(c)) for c in (-0.09, -0.0025, 0.0025)
} | {
    "axial": ({"kind": "axial", "index": INDEX, "coefficients": list(AXIAL)}, axial),
    "linear in y": ({"kind": "xyz", "index": INDEX, "y_coefficients": [SLOPE]}, mirage),
}


def plate(gradient: Keys, length: float, semi: float = 2.5) -> lf.Scene:
    """Return a camera with a plate of gradient-index glass, whose front is the stop, and a wide sensor behind it."""
    surfaces = [
        {"thickness_mm": length, "semi_diameter_mm": semi, "stop": True, "gradient": gradient},
        {"semi_diameter_mm": semi},
    ]
    sensor = {"pixels": [400, 400], "pixel_mm": 0.5, "distance_mm": 3.0}
    return lf.Scene(camera={"lens": {"surfaces": surfaces}, "sensor": sensor}, transport={"wavelengths_nm": [NM]})


def traced(scene: lf.Scene, points: Array, sines: Array, surface: int = 1) -> tuple[Array, Array]:
    """Return points on a surface of the lens, and directions behind it, of rays that meet z = 0 in given points.

    Parameters
    ----------
    scene : Scene
    points : (n, 2) float, mm
    sines : (n, 2) float
        Direction cosines in air.
    surface : int
    """
    d = np.column_stack([sines, np.sqrt(1.0 - (sines**2).sum(axis=1))])
    origins = np.column_stack([points, np.zeros(len(points))]) - d
    paths = lf.trace(lf.build(scene), origins, d, split="transmit", record=True)
    assert np.isin(paths.body, ["sensor", "beside the sensor"]).all()
    np.testing.assert_array_equal(paths.source, np.arange(len(points)))
    at = []
    for packet in range(len(points)):
        (vertex,) = (v for v in paths.vertices(packet) if v.surface == f"lens surface {surface}")
        at.append(vertex.position)
    return np.array(at), paths.direction


def compare(scene: lf.Scene, law: Law, length: float, points: Array, sines: Array) -> None:
    """Compare rays behind a plate with a closed form."""
    at, direction = traced(scene, points, sines)
    with mp.workdps(DIGITS):
        ends = [
            law(*(mp.mpf(float(c)) for c in (*point, *sine)), mp.mpf(length))
            for point, sine in zip(points, sines, strict=True)
        ]
    np.testing.assert_allclose(at, [[float(e.x), float(e.y), length] for e in ends], rtol=0.0, atol=POSITION_MM)
    sines_behind = [[float(e.tx), float(e.ty)] for e in ends]
    np.testing.assert_allclose(direction[:, :2], sines_behind, rtol=0.0, atol=DIRECTION)


def in_polar(sine: float, azimuth_deg: float) -> tuple[float, float]:
    return sine * math.cos(math.radians(azimuth_deg)), sine * math.sin(math.radians(azimuth_deg))


POINTS = np.array([[0.7, 0.0], [0.0, 1.1], [0.4, -0.2], [0.8, 0.6], [0.0, 0.0], [0.3, 0.9]])
SINES = np.array(
    [in_polar(0.33, 0.0), (0.0, 0.0), in_polar(0.54, 50.0), in_polar(0.41, 130.0), in_polar(0.9, 30.0),
     in_polar(0.75, 70.0)]
)  # fmt: skip
"""Meridional, parallel and skew rays, up to 64 degrees in air."""


@pytest.mark.parametrize("length", [4.0, 12.0])
@pytest.mark.parametrize("medium", MEDIA)
def test_rays_behind_a_plate_are_those_of_the_closed_form(medium: str, length: float) -> None:
    gradient, law = MEDIA[medium]
    # Only the strong rod keeps steep rays near its axis.
    semi, sines = (2.5, SINES) if medium == "rod -0.09" else (6.0, 0.25 * SINES)
    compare(plate(gradient, length, semi), law, length, POINTS, sines)


@pytest.mark.parametrize("length", [2.0, 12.0, 40.0])
def test_meridional_rays_in_a_hyperbolic_secant_have_harmonic_hyperbolic_sines(length: float) -> None:
    heights, sines, turn = np.array([0.5, 1.2, 0.0, -1.0]), np.array([0.0, 0.3, 0.6, 0.4]), math.radians(30.0)
    axis = np.array([math.cos(turn), math.sin(turn)])
    compare(plate(secant_keys(), length), secant, length, heights[:, None] * axis, sines[:, None] * axis)


def test_a_rod_of_one_pitch_images_its_front_onto_its_back() -> None:
    """Upright and without magnification, near its axis."""
    pitch = 2.0 * math.pi / math.sqrt(0.09)
    points, sines = 1e-4 * POINTS, 1e-4 * SINES
    scene = plate(MEDIA["rod -0.09"][0], pitch)
    compare(scene, rod(-0.09), pitch, points, sines)
    at, direction = traced(scene, points, sines)
    np.testing.assert_allclose(at[:, :2], points, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(direction[:, :2], sines, rtol=0.0, atol=1e-10)


# Optical paths, by wavefronts


INSIDE = 1.0 - 1e-9
"""Rays through the points of a wavefront pass this share of their distance from the centre of the stop."""


def opd_mm(found: lf.Wavefront, law: Law, length: float, source: tuple[Any, Any], sense: int = 1) -> list[float]:
    """Return the optical path of the chief ray less that of each ray of a wavefront behind a plate, mm.

    Parameters
    ----------
    found : Wavefront
        Its points of the stop, its centre and its radius count.
    law : Law
    length : float, mm
    source : (mpf, mpf), mm
        Height of the object point, and its distance before the plate.
    sense : int
        −1 if the exit pupil, and so the reference sphere, lies behind the image.
    """
    height, distance = source
    centre, radius = [mp.mpf(float(c)) for c in found.image_mm], sense * mp.mpf(found.radius_mm)

    def to_sphere(x: Any, y: Any) -> Any:
        step = [x, y - height, distance]
        air = mp.sqrt(mp.fsum(c * c for c in step))
        end = law(x, y, step[0] / air, step[1] / air, mp.mpf(length))
        d = [end.tx, end.ty, mp.sqrt(1 - end.tx**2 - end.ty**2)]
        off = [end.x - centre[0], end.y - centre[1], length - centre[2]]
        b = mp.fsum(p * q for p, q in zip(off, d, strict=True))
        root = mp.sqrt(b * b - mp.fsum(p * p for p in off) + radius**2)
        return air + end.path - b - mp.sign(radius) * root

    chief = to_sphere(mp.mpf(0), mp.mpf(0))
    return [float(chief - to_sphere(*(INSIDE * SEMI_OPEN * mp.mpf(float(c)) for c in point))) for point in found.pupil]


SEMI_OPEN = 1.0
"""Semi-diameter of the stop of wavefronts, mm."""


def waves_behind(gradient: Keys, length: float, height: float, distance: float, image_z: float) -> lf.Wavefront:
    scene = plate(gradient, length).changed({"camera.lens.stop_semi_diameter_mm": SEMI_OPEN})
    return lf.wavefront(scene, height, object_mm=distance, image_z_mm=image_z, across=12)


@pytest.mark.parametrize("height", [0.0, 0.4])
@pytest.mark.parametrize("medium", MEDIA)
def test_wavefronts_behind_a_plate_are_those_of_the_closed_form(medium: str, height: float) -> None:
    gradient, law = MEDIA[medium]
    length, distance, image_z = 7.0, 4.0, 15.0
    found = waves_behind(gradient, length, height, distance, image_z)
    assert len(found.pupil) > 50
    with mp.workdps(DIGITS):
        truth = opd_mm(found, law, length, (mp.mpf(height), mp.mpf(distance)))
    assert np.ptp(truth) > 1e-4
    np.testing.assert_allclose(found.opd_waves * NM * MM_PER_NM, truth, rtol=0.0, atol=PATH_MM)


def test_the_wavefront_of_a_point_on_the_axis_of_a_hyperbolic_secant() -> None:
    """The exit pupil lies L − tan(g L) / (n₀ g) = 14.93 mm behind the front, and behind the image."""
    found = waves_behind(secant_keys(), 6.0, 0.0, 4.0, 12.0)
    with mp.workdps(DIGITS):
        truth = opd_mm(found, secant, 6.0, (mp.mpf(0), mp.mpf(4)), sense=-1)
    np.testing.assert_allclose(found.opd_waves * NM * MM_PER_NM, truth, rtol=0.0, atol=PATH_MM)


# Perfect images of balls


def ball(square: Callable[[Any], Any], radius: float) -> lf.Scene:
    """Return a camera with a ball in air whose index is 1 on its rim.

    Parameters
    ----------
    square : callable
        From the distance from the centre over the radius to n².
    radius : float, mm
    """
    # Polynomial of the depth below the rim, over the radius.
    fit = Chebyshev.interpolate(lambda t: np.sqrt(square(1.0 - t)), 22, [0.0, 1.0]).convert(kind=Polynomial)
    coefficients = [float(c) / radius**i for i, c in enumerate(fit.coef)]
    assert abs(coefficients[0] - 1.0) < 1e-13
    gradient = {"kind": "spherical", "radius_mm": radius, "index": 1.0, "coefficients": coefficients[1:]}
    surfaces = [
        {"radius_mm": radius, "thickness_mm": 2.0 * radius, "semi_diameter_mm": 0.95 * radius, "stop": True,
         "gradient": gradient},
        {"radius_mm": -radius, "semi_diameter_mm": 0.95 * radius},
    ]  # fmt: skip
    sensor = {"pixels": [400, 400], "pixel_mm": 0.2 * radius, "distance_mm": 0.5 * radius}
    return lf.Scene(camera={"lens": {"surfaces": surfaces}, "sensor": sensor}, transport={"wavelengths_nm": [NM]})


def luneburg(rho: Any) -> Any:
    return 2 - rho * rho


def fish_eye(rho: Any) -> Any:
    return 4 / (1 + rho * rho) ** 2


def ends_of(scene: lf.Scene, origins: Array, directions: Array) -> tuple[Array, Array]:
    """Return points on the back of a ball, and the weights behind it."""
    paths = lf.trace(lf.build(scene), origins, directions, split="transmit", record=True)
    assert len(paths) == len(origins)
    at = [v.position for k in range(len(paths)) for v in paths.vertices(k) if v.surface == "lens surface 1"]
    return np.array(at), paths.weight


@pytest.mark.parametrize("radius", [1.0, 5.0])
@pytest.mark.parametrize("tilt_deg", [0.0, 20.0])
def test_luneburgs_lens_gathers_parallel_rays_in_a_point_of_its_rim(radius: float, tilt_deg: float) -> None:
    """Without reflections, since its index is that of air there."""
    tilt = math.radians(tilt_deg)
    along, across = np.array([math.sin(tilt), 0.0, math.cos(tilt)]), np.array([math.cos(tilt), 0.0, -math.sin(tilt)])
    heights = np.array([[0.0, 0.0], [0.3, 0.0], [0.4, 0.4], [-0.55, 0.1], [0.0, 0.6]]) * radius
    centre = np.array([0.0, 0.0, radius])
    origins = centre - 2.0 * radius * along + heights[:, :1] * across + heights[:, 1:] * np.array([0.0, 1.0, 0.0])
    at, weight = ends_of(ball(luneburg, radius), origins, np.tile(along, (5, 1)))
    np.testing.assert_allclose(at, np.tile(centre + radius * along, (5, 1)), rtol=0.0, atol=POSITION_MM)
    np.testing.assert_allclose(weight, 1.0, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("tilt_deg", [0.0, 25.0])
def test_points_of_the_rim_of_maxwells_lens_are_imaged_on_the_rim(tilt_deg: float) -> None:
    radius, tilt = 4.0, math.radians(tilt_deg)
    centre = np.array([0.0, 0.0, radius])
    out = np.array([math.sin(tilt), 0.0, -math.cos(tilt)])
    across = np.array([math.cos(tilt), 0.0, math.sin(tilt)])
    angles, turns = np.radians([0.0, 5.0, 20.0, 35.0, 50.0]), np.radians([0.0, 40.0, 110.0, 200.0, 300.0])
    directions = -np.cos(angles)[:, None] * out
    directions += np.sin(angles)[:, None] * (np.cos(turns)[:, None] * across + np.sin(turns)[:, None] * [0.0, 1.0, 0.0])
    origins = centre + radius * out - 0.5 * directions
    at, _ = ends_of(ball(fish_eye, radius), origins, directions)
    np.testing.assert_allclose(at, np.tile(centre - radius * out, (5, 1)), rtol=0.0, atol=POSITION_MM)


def test_all_light_of_a_plane_wave_comes_to_luneburgs_focus_at_once() -> None:
    radius = 2.0
    scene = ball(luneburg, radius).changed({"camera.lens.stop_semi_diameter_mm": 0.9 * radius})
    found = lf.wavefront(scene, object_mm=math.inf, image_z_mm=2.0 * radius, across=16)
    assert found.passed > 0.95
    np.testing.assert_allclose(found.opd_waves * NM * MM_PER_NM, 0.0, atol=PATH_MM)
    assert found.strehl == pytest.approx(1.0, abs=1e-9)


# First-order optics


def test_focal_lengths_of_a_rod_are_those_of_its_sine_and_cosine() -> None:
    """f = 1 / (n₀ g sin g L), and the focus lies f cos g L behind the rod (Marchand, 1978)."""
    g, length = 0.3, 4.0
    facts = lf.first_order(plate(MEDIA["rod -0.09"][0], length))
    assert facts.efl_mm == pytest.approx(1.0 / (INDEX * g * math.sin(g * length)), rel=1e-12)
    assert facts.bfl_mm == pytest.approx(math.cos(g * length) * facts.efl_mm, rel=1e-12)


@pytest.mark.parametrize("medium", ["rod -0.09", "rod 0.0025"])
def test_paraxial_rays_are_the_limit_of_real_ones(medium: str) -> None:
    gradient, law = MEDIA[medium]
    length, height = 3.0, mp.mpf("1e-6")
    facts = lf.first_order(plate(gradient, length))
    with mp.workdps(DIGITS):
        end = law(mp.mpf(0), height, mp.mpf(0), mp.mpf(0), mp.mpf(length))
        assert facts.efl_mm == pytest.approx(float(-height / end.ty), rel=1e-11)
        assert facts.bfl_mm == pytest.approx(float(-end.y / end.ty), rel=1e-11)
