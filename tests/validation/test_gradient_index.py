"""Rays through gradient-index media against closed forms in 40 digits: positions, optical paths, perfect images.

- Rod, n² = n₀² (1 − g² r²): rays are harmonic in σ, dσ = ds/n, skew ones too (E. W. Marchand, Gradient Index Optics,
  Academic Press 1978).
- Hyperbolic secant, n = n₀ sech(g r): sinh(g x) of a meridional ray is harmonic in z with the rate g, so rays from a
  point of the axis, however steep, meet again at π/g (A. Fletcher, T. Murphy and A. Young, Proc. R. Soc. Lond. A 223,
  216, 1954).
- Axial gradient: n times the sine of the angle with the axis is constant, and the rest are integrals over z.
- Maxwell's fish-eye, n = n₀ / (1 + ρ²/a²): rays are circles, and the image of a point P is −a² P/|P|², with the optical
  path π n₀ a/2 (M. Born and E. Wolf, Principles of Optics, 4.2.2).
- Luneburg's lens, n² = 2 − ρ²/R²: parallel rays meet on the rim (R. K. Luneburg, Mathematical Theory of Optics, 1944).
"""

import math
from collections.abc import Callable
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.gradient_path import (
    ConicFace,
    GradientRay,
    conic_height_at,
    starting_rays,
    steps_needed,
    traced,
    tracer,
)
from lfmesh.optics.gradient_shapes import (
    INDEX_SQUARED,
    radial_and_axial_profile,
    radial_square_profile,
    revolved_profile,
)
from lfmesh.optics.gradients import Gradients, gradient_table

Array = NDArray[np.float64]
Traced = tuple[NDArray[np.bool_], Array]

POSITION_MM, PATH_MM = 1e-9, 1e-10
INDEX = 1.6


def direction(angle_deg: float, azimuth_deg: float = 0.0) -> tuple[float, float, float]:
    angle, azimuth = math.radians(angle_deg), math.radians(azimuth_deg)
    return math.sin(angle) * math.cos(azimuth), math.sin(angle) * math.sin(azimuth), math.cos(angle)


def agree(rays: Array, truth: Array) -> None:
    """Compare positions and optical paths, (n, 8) and (n, 4)."""
    np.testing.assert_allclose(rays[:, :3], truth[:, :3], rtol=0.0, atol=POSITION_MM)
    np.testing.assert_allclose(rays[:, 6], truth[:, 3], rtol=0.0, atol=PATH_MM)


def through(table: Gradients, rays: Array, face: ConicFace) -> Array:
    """Return rays at a face, in the number of steps that they need as probes."""
    steps = steps_needed(lambda number: traced(table, 0, rays, face, number), POSITION_MM)
    reached, ends = traced(table, 0, rays, face, steps)
    assert reached.all()
    return ends


def in_rod(ray: Array, power: float, length: float) -> Array:
    """Return position and optical path ∫ n² dσ behind a length of n² = n₀² (1 + c r²)."""
    with mp.workdps(40):
        x, y, z, tx, ty, tz, _, _ = (mp.mpf(float(c)) for c in ray)
        omega = mp.sqrt(mp.mpc(-(mp.mpf(INDEX) ** 2) * mp.mpf(power)))
        end = mp.mpf(length) / tz
        cos, sin, double = mp.cos(omega * end), mp.sin(omega * end), mp.sin(2 * omega * end) / (4 * omega)

        def square(start: Any, rate: Any) -> Any:
            return start**2 * (end / 2 + double) + rate**2 * (end / 2 - double) + start * rate * sin**2 / omega

        path = mp.mpf(INDEX) ** 2 * end - omega**2 * (square(x, tx / omega) + square(y, ty / omega))
        found = [x * cos + tx * sin / omega, y * cos + ty * sin / omega, z + length, path]
        return np.array([float(mp.re(c)) for c in found])


@pytest.mark.parametrize("length", [12.0, 50.0])
@pytest.mark.parametrize("power", [-0.09, -0.0025, 0.0025])
def test_rays_in_a_rod_are_harmonic(power: float, length: float) -> None:
    """Meridional, parallel, skew and steep ones; hyperbolic where the index grows outwards."""
    table = gradient_table([radial_square_profile(INDEX, [power])])
    points = [(0.7, 0.0, 0.0), (0.0, 1.1, 0.0), (0.4, -0.2, 0.0), (0.8, 0.6, 0.0), (0.0, 0.0, 0.0), (0.3, 0.9, 0.0)]
    tilts = [(12.0, 0.0), (0.0, 0.0), (20.0, 50.0), (15.0, 130.0), (36.0, 30.0), (30.0, 70.0)]
    rays = starting_rays(table, 0, points, [direction(*tilt) for tilt in tilts])
    agree(through(table, rays, ConicFace(0.0, 0.0, length)), np.array([in_rod(ray, power, length) for ray in rays]))


def test_in_an_axial_gradient_n_times_the_sine_is_constant() -> None:
    table = gradient_table([radial_and_axial_profile(1.5, (), (0.05, -0.004))])
    rays = starting_rays(
        table, 0, [(0.2, -0.1, 0.0)] * 4, [direction(angle, 25.0) for angle in (0.0, 15.0, 40.0, 65.0)]
    )
    ends = through(table, rays, ConicFace(0.0, 0.0, 8.0))
    assert np.array_equal(ends[:, 3:5], rays[:, 3:5])
    truth = []
    with mp.workdps(40):
        for ray in rays:
            x, y, _, tx, ty, _, _, _ = (mp.mpf(float(c)) for c in ray)

            def square(z: Any) -> Any:
                return (mp.mpf(1.5) + mp.mpf(0.05) * z - mp.mpf(0.004) * z * z) ** 2

            def rate(z: Any, across: Any = tx**2 + ty**2) -> Any:
                return 1 / mp.sqrt(square(z) - across)

            end = mp.quad(rate, [0, 4, 8])
            path = mp.quad(lambda z, rate=rate: square(z) * rate(z), [0, 4, 8])
            truth.append([float(c) for c in (x + tx * end, y + ty * end, 8, path)])
    agree(ends, np.array(truth))


@inlined
def secant_at(field: Array, number: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """n = n₀ sech(g r), with n₀ and g in the field."""
    g = field[1]
    r = np.sqrt(x * x + y * y)
    n = field[0] / np.cosh(g * r)
    along = -n * n * g * (np.tanh(g * r) / r if r > 0.0 else g)
    return n * n, along * x, along * y, 0.0


@inlined
def fish_eye_at(field: Array, number: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """n = n₀ / (1 + ρ²/a²) about (0, 0, field[2]), with n₀ and a in the field."""
    per2, w = 1.0 / (field[1] * field[1]), z - field[2]
    n = field[0] / (1.0 + per2 * (x * x + y * y + w * w))
    along = -2.0 * per2 * n * n * n / field[0]
    return n * n, along * x, along * y, along * w


_reach_in_secant = tracer(secant_at, conic_height_at)
_reach_in_fish_eye = tracer(fish_eye_at, conic_height_at)


@kernel
def reach_in_secant(field: Array, ray: GradientRay, face: ConicFace, steps: int) -> tuple[bool, GradientRay]:
    return _reach_in_secant(field, 0, ray, face, 1.0, steps)


@kernel
def reach_in_fish_eye(field: Array, ray: GradientRay, face: ConicFace, steps: int) -> tuple[bool, GradientRay]:
    return _reach_in_fish_eye(field, 0, ray, face, 1.0, steps)


def through_field(reach: Callable[..., Any], field: Array, rays: Array, face: ConicFace) -> Array:
    """Return rays at a face in an index field, in the number of steps that they need as probes."""

    def trace(steps: int) -> Traced:
        results = [reach(field, GradientRay(*ray), face, steps) for ray in rays.tolist()]
        return np.array([reached for reached, _ in results]), np.array([end for _, end in results])

    reached, ends = trace(steps_needed(trace, POSITION_MM))
    assert reached.all()
    return ends


def start(index: float, point: tuple[float, float, float], along: tuple[float, float, float]) -> Array:
    return np.array([*point, *(index * c for c in along), 0.0, 0.0])


SECANT = np.array([INDEX, 0.3])
MERIDIAN = math.radians(30.0)


def meridional(height: float, angle_deg: float) -> Array:
    """Return a ray in the meridian of 30°."""
    x, y = height * math.cos(MERIDIAN), height * math.sin(MERIDIAN)
    tilt = direction(angle_deg)[0]
    along = tilt * math.cos(MERIDIAN), tilt * math.sin(MERIDIAN), math.cos(math.radians(angle_deg))
    return start(INDEX / math.cosh(SECANT[1] * height), (x, y, 0.0), along)


@pytest.mark.parametrize("length", [2.0, 12.0, 40.0])
def test_meridional_rays_in_a_hyperbolic_secant_have_harmonic_hyperbolic_sines(length: float) -> None:
    cases = [(0.5, 0.0), (1.5, 20.0), (0.0, 35.0), (-2.0, 10.0)]
    rays = np.array([meridional(*case) for case in cases])
    truth = []
    with mp.workdps(40):
        n0, g = (mp.mpf(float(c)) for c in SECANT)
        for height, angle_deg in cases:
            x, slope = mp.mpf(height), mp.tan(mp.radians(mp.mpf(angle_deg)))
            u, rate = mp.sinh(g * x), mp.cosh(g * x) * slope
            axial = n0 / mp.cosh(g * x) / mp.sqrt(1 + slope**2)

            def u_at(z: Any, u: Any = u, rate: Any = rate) -> Any:
                return u * mp.cos(g * z) + rate * mp.sin(g * z)

            path = mp.quad(lambda z, u_at=u_at, n=axial: n0**2 / (1 + u_at(z) ** 2) / n, mp.linspace(0, length, 11))
            end = mp.asinh(u_at(mp.mpf(length))) / g
            truth.append([float(c) for c in (end * mp.cos(MERIDIAN), end * mp.sin(MERIDIAN), length, path)])
    agree(through_field(reach_in_secant, SECANT, rays, ConicFace(0.0, 0.0, length)), np.array(truth))


def test_a_hyperbolic_secant_refocuses_meridional_rays_of_any_angle() -> None:
    """Over one half period, from a point of the axis, with the optical path along the axis."""
    half = math.pi / SECANT[1]
    rays = np.array([meridional(0.0, angle_deg) for angle_deg in (1.0, 15.0, 30.0, 45.0, 55.0)])
    ends = through_field(reach_in_secant, SECANT, rays, ConicFace(0.0, 0.0, half))
    agree(ends, np.array([[0.0, 0.0, half, INDEX * half]] * len(rays)))


FISH_EYE = np.array([1.8, 4.0, 5.0])


@pytest.mark.parametrize(
    ("source", "steepest_deg"), [((0.0, 0.0, -4.0), 70.0), ((0.0, 0.0, -2.5), 70.0), ((1.0, 0.5, -4.0), 40.0)]
)
def test_a_fish_eye_images_each_point_perfectly(source: tuple[float, float, float], steepest_deg: float) -> None:
    """Steeper rays from beside the axis cross the plane of the image before they meet in it."""
    n0, a, centre = FISH_EYE
    square = math.fsum(c * c for c in source)
    point = source[0], source[1], source[2] + centre
    index = n0 / (1.0 + square / a**2)
    tilts = [(0.0, 0.0), (10.0, 0.0), (25.0, 90.0), (45.0, 200.0), (steepest_deg, 40.0)]
    rays = np.array([start(index, point, direction(*tilt)) for tilt in tilts])
    image = [-a * a * c / square for c in source]
    image[2] += centre
    ends = through_field(reach_in_fish_eye, FISH_EYE, rays, ConicFace(0.0, 0.0, image[2]))
    agree(ends, np.array([[*image, 0.5 * math.pi * n0 * a]] * len(rays)))


def test_points_of_the_rim_of_maxwells_lens_are_imaged_on_the_rim() -> None:
    """The fish-eye inside the sphere ρ = a: the rays end on the sphere."""
    n0, a, centre = FISH_EYE
    tilt = math.radians(25.0)
    point = a * math.sin(tilt), 0.0, centre - a * math.cos(tilt)
    rays = np.array([start(0.5 * n0, point, direction(angle, 70.0)) for angle in (2.0, 20.0, 40.0)])
    ends = through_field(reach_in_fish_eye, FISH_EYE, rays, ConicFace(-1.0 / a, 0.0, centre + a))
    agree(ends, np.array([[-point[0], 0.0, 2.0 * centre - point[2], 0.5 * math.pi * n0 * a]] * 3))


@pytest.mark.parametrize("radius", [1.0, 5.0])
@pytest.mark.parametrize("tilt_deg", [0.0, 20.0])
def test_luneburgs_lens_gathers_parallel_rays_in_a_point_of_its_rim(radius: float, tilt_deg: float) -> None:
    """With the optical path R (1 + π/2) from the plane that touches the lens."""
    table = gradient_table(
        [revolved_profile([[1.0, 2.0 / radius, -1.0 / radius**2], [-1.0 / radius**2, 0.0, 0.0]], INDEX_SQUARED)]
    )
    along, centre = np.array(direction(tilt_deg)), np.array([0.0, 0.0, radius])
    across = np.array([math.cos(math.radians(tilt_deg)), 0.0, -math.sin(math.radians(tilt_deg))])
    heights = np.array([[0.0, 0.0], [0.3, 0.0], [0.5, 0.5], [-0.9, 0.1], [0.0, 0.95]]) * radius
    depths = np.sqrt(radius**2 - (heights**2).sum(axis=1))
    points = centre - depths[:, None] * along + heights[:, :1] * across + heights[:, 1:] * np.array([0.0, 1.0, 0.0])
    rays = starting_rays(table, 0, points, [along] * 5)
    rays[:, 3:6] = along
    rays[:, 6] = radius - depths
    ends = through(table, rays, ConicFace(-1.0 / radius, 0.0, 2.0 * radius))
    agree(ends, np.array([[*(centre + radius * along), radius * (1.0 + 0.5 * math.pi)]] * 5))
