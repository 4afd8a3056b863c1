"""Fresnel's equations: closed forms, 40-digit truth, conservation, and the limits that must hold."""

import mpmath as mp
import numpy as np
import pytest
from scipy.integrate import quad

from lfmesh.kernels.decorators import kernel
from lfmesh.optics.fresnel import fresnel

RNG = np.random.default_rng(11)
EPSILON = np.finfo(np.float64).eps


@kernel
def worst_imbalance(n_i, n_t, cos_i):
    worst = 0.0
    for k in range(len(n_i)):
        R, T, _ = fresnel(n_i[k], n_t[k], cos_i[k])
        worst = max(worst, abs(R + T - 1.0))
    return worst


def truth(n_i, n_t, cos_i):
    """R and T in 40 digits, by the sines and tangents' equivalent in cosines of the exact angles."""
    with mp.workdps(40):
        n1, n2, c1 = mp.mpf(n_i), mp.mpf(n_t), mp.mpf(cos_i)
        s2 = (n1 / n2) ** 2 * (1 - c1**2)
        if s2 >= 1:
            return mp.mpf(1), mp.mpf(0)
        c2 = mp.sqrt(1 - s2)
        r_s = (n1 * c1 - n2 * c2) / (n1 * c1 + n2 * c2)
        r_p = (n2 * c1 - n1 * c2) / (n2 * c1 + n1 * c2)
        R = (r_s**2 + r_p**2) / 2
        return R, 1 - R


def test_normal_incidence():
    R, T, cos_t = fresnel(1.0, 1.5, 1.0)
    assert pytest.approx(0.04, rel=4e-16) == R
    assert pytest.approx(0.96, rel=4e-16) == T
    assert cos_t == 1.0


def test_eighty_degrees():
    R, _, _ = fresnel(1.0, 1.5, np.cos(np.deg2rad(80.0)))
    assert pytest.approx(0.387704354691473, rel=2e-15) == R


def test_energy_is_conserved_over_random_angles_and_indices():
    count = 200_000
    n_i, n_t = RNG.uniform(1.0, 4.0, size=(2, count))
    assert worst_imbalance(n_i, n_t, RNG.uniform(size=count)) < 1e-15


@pytest.mark.parametrize(
    "cos_i",
    [1.0, 1.0 - 1e-16, 1.0 - 1e-12, 1e-3, 1e-8, np.sin(1e-10), 5e-324, 0.0],
    ids=["normal", "normal-1ulp", "normal-1e-12", "1e-3", "1e-8", "grazing", "tiniest", "parallel"],
)
@pytest.mark.parametrize(
    ("n_i", "n_t"),
    [
        (1.0, 1.5),
        (1.5, 1.0),
        (1.0, 4.0),
        (4.0, 1.0),
        (1.5, 1.5),
        (1.5, 1.5 + 1e-12),
        (1.5 + 1e-12, 1.5),
        (1.3, 1.7),
    ],
)
def test_energy_is_conserved_in_the_limits(n_i, n_t, cos_i):
    R, T, cos_t = fresnel(n_i, n_t, cos_i)
    assert abs(R + T - 1.0) < 1e-15
    assert 0.0 <= R <= 1.0
    assert 0.0 <= T <= 1.0 + EPSILON
    assert 0.0 <= cos_t <= 1.0


def test_energy_is_conserved_near_the_critical_angle():
    n_i = RNG.uniform(1.1, 4.0, size=20_000)
    critical = np.sqrt((1.0 - 1.0 / n_i) * (1.0 + 1.0 / n_i))
    near = critical * (1.0 + RNG.choice([-1, 1], 20_000) * 10.0 ** RNG.uniform(-16, -2, size=20_000))
    assert worst_imbalance(n_i, np.ones_like(n_i), np.clip(near, 0, 1)) < 1e-15


def test_reflectance_and_transmittance_to_13_digits_away_from_the_critical_angle():
    compared = 0
    for n_i, n_t, cos_i in RNG.uniform((1, 1, 0), (4, 4, 1), size=(2000, 3)):
        s2 = (n_i / n_t) ** 2 * (1 - cos_i**2)
        if abs(s2 - 1) < 0.01:
            continue
        R, T, _ = fresnel(n_i, n_t, cos_i)
        exact_R, exact_T = truth(n_i, n_t, cos_i)
        # Where the amplitudes cancel, at Brewster's angle or matched indices, the digits of R are those of r.
        assert abs(R - exact_R) < 1e-13 * exact_R + 4 * EPSILON * mp.sqrt(exact_R)
        assert abs(T - exact_T) <= 1e-13 * exact_T
        compared += 1
    assert compared > 1500


@pytest.mark.parametrize("angle", [1e-10, 1e-6, 1e-3])
@pytest.mark.parametrize("n_t", [1.5, 4.0])
def test_transmittance_keeps_its_digits_at_grazing_incidence(angle, n_t):
    cos_i = np.sin(angle)
    _, T, _ = fresnel(1.0, n_t, cos_i)
    assert abs(T - truth(1.0, n_t, cos_i)[1]) < 1e-13 * T


def test_absolute_error_is_small_near_the_critical_angle():
    for n_i in (1.1, 1.5, 4.0):
        critical = np.sqrt((1 - 1 / n_i) * (1 + 1 / n_i))
        for step in (1e-3, 1e-6, 1e-9):
            for cos_i in (critical * (1 + step), critical * (1 - step)):
                R, T, _ = fresnel(n_i, 1.0, cos_i)
                exact_R, exact_T = truth(n_i, 1.0, cos_i)
                # T goes as the root of the distance, which has the rounding error of 1 - sin².
                tolerance = 40 * EPSILON / np.sqrt(step)
                assert abs(R - exact_R) < tolerance
                assert abs(T - exact_T) < tolerance


def test_nothing_passes_beyond_the_critical_angle():
    assert fresnel(1.5, 1.0, 0.5) == (1.0, 0.0, 0.0)


@pytest.mark.parametrize("cos_i", [1.0, 0.3, 1e-12, 5e-324])
def test_matched_indices_reflect_nothing(cos_i):
    assert fresnel(1.5, 1.5, cos_i) == (0.0, 1.0, cos_i)


def test_p_polarised_light_is_not_reflected_at_brewsters_angle():
    for n in (1.33, 1.5, 2.4):
        # tan θ = n; what is left is half of r_s², which is ((n² - 1) / (n² + 1))² there.
        R, _, _ = fresnel(1.0, n, 1.0 / np.hypot(1.0, n))
        assert pytest.approx(0.5 * ((n * n - 1) / (n * n + 1)) ** 2, rel=1e-14) == R


def test_snells_law():
    for n_i, n_t, cos_i in RNG.uniform((1, 1, 0), (2, 2, 1), size=(200, 3)):
        _, T, cos_t = fresnel(n_i, n_t, cos_i)
        if T > 0.0:
            left, right = n_i**2 * (1 - cos_i**2), n_t**2 * (1 - cos_t**2)
            assert left == pytest.approx(right, abs=4e-15)


def test_both_sides_reflect_and_pass_the_same():
    for n, cos_i in RNG.uniform((1.01, 0.01), (4, 1), size=(200, 2)):
        R, T, cos_t = fresnel(1.0, n, cos_i)
        back_R, back_T, back_cos = fresnel(n, 1.0, cos_t)
        # The rounding of cos_t, as Snell's law passes it back.
        rounding = 4 * EPSILON * n**2 / cos_i
        assert back_cos == pytest.approx(cos_i, abs=rounding)
        assert back_R == pytest.approx(R, abs=4 * n * rounding)
        assert back_T == pytest.approx(T, abs=4 * n * rounding)


@pytest.mark.parametrize(("n", "hemispherical"), [(1.1, 0.025157), (1.5, 0.091778), (2.5, 0.221867)])
def test_hemispherical_reflectivity(n, hemispherical):
    """Walsh's closed form, to the digits of its published table, and its dense-to-thin counterpart."""

    def over_hemisphere(n_i, n_t, kink):
        integral, _ = quad(lambda c: 2 * c * fresnel(n_i, n_t, c)[0], 0, 1, points=kink, epsabs=1e-11, limit=200)
        return integral

    closed = (
        0.5
        + (3 * n + 1) * (n - 1) / (6 * (n + 1) ** 2)
        + n**2 * (n**2 - 1) ** 2 / (n**2 + 1) ** 3 * np.log((n - 1) / (n + 1))
        - 2 * n**3 * (n**2 + 2 * n - 1) / ((n**2 + 1) * (n**4 - 1))
        + 8 * n**4 * (n**4 + 1) / ((n**2 + 1) * (n**4 - 1) ** 2) * np.log(n)
    )
    thin_to_dense = over_hemisphere(1.0, n, [0.1])
    assert thin_to_dense == pytest.approx(hemispherical, abs=6e-7)
    assert thin_to_dense == pytest.approx(closed, abs=1e-9)
    dense_to_thin = over_hemisphere(n, 1.0, [np.sqrt(1 - 1 / n**2)])
    assert dense_to_thin == pytest.approx(1 - (1 - closed) / n**2, abs=1e-8)
