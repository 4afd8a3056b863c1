"""Stacks of thin films against the package `tmm`, by textbook values, and by the laws that hold for all of them."""

import warnings

import numpy as np
import pytest

from lfmesh.optics.coatings import P, S, Stack, beyond, coated, polarised
from lfmesh.optics.fresnel import fresnel

tmm = pytest.importorskip("tmm")

NOTHING = Stack((), ())


def random_stack(draw):
    """Media, layers, wavelength and angle of a random case; four in ten may hold layers that absorb."""
    layers = draw.integers(1, 9)
    n_i, n_t = draw.uniform(1.0, 2.6, 2)
    may_absorb = draw.random() < 0.4
    extinction = np.where(may_absorb & (draw.random(layers) < 0.5), draw.uniform(0.0, 5.0, layers), 0.0)
    indices = draw.uniform(1.0, 3.0, layers) + 1j * extinction
    stack = Stack(tuple(complex(n) for n in indices), tuple(draw.uniform(5.0, 400.0, layers)))
    return n_i, n_t, stack, draw.uniform(350.0, 1100.0), draw.uniform(0.0, np.radians(89.9))


def by_tmm(n_i, n_t, stack, wavelength, angle):
    with warnings.catch_warnings():
        # It notes that it limits the absorption of thick layers.
        warnings.simplefilter("ignore")
        found = tmm.unpolarized_RT(
            [n_i, *stack.indices, n_t], [np.inf, *stack.thicknesses_nm, np.inf], angle, wavelength
        )
    return found["R"], found["T"]


def compare_with_tmm(count, seed):
    draw = np.random.default_rng(seed)
    worst, total, absorbing = 0.0, 0, 0
    for _ in range(count):
        n_i, n_t, stack, wavelength, angle = random_stack(draw)
        R, T = coated(n_i, n_t, stack, wavelength, np.cos(angle))
        truth = by_tmm(n_i, n_t, stack, wavelength, angle)
        worst = max(worst, abs(R[0] - truth[0]), abs(T[0] - truth[1]))
        total += n_i * np.sin(angle) > n_t
        absorbing += stack.absorbs
    # A tenth of the cases at least reflect totally, and as many absorb: the comparison says something of both.
    assert min(total, absorbing) > 0.1 * count
    return worst


def test_random_stacks_are_those_of_tmm():
    assert compare_with_tmm(500, seed=1) < 1e-10


@pytest.mark.long
def test_ten_thousand_random_stacks_are_those_of_tmm():
    assert compare_with_tmm(10_000, seed=2) < 1e-10


def test_a_quarter_wave_of_magnesium_fluoride_reflects_as_in_textbooks():
    # ((n − n₁²) / (n + n₁²))² at the design wavelength: 1.26 % in place of 4.26 %.
    film = Stack((1.38 + 0j,), (550.0 / 4.0 / 1.38,))
    R, T = coated(1.0, 1.52, film, 550.0, np.ones(1))
    closed = ((1.52 - 1.38**2) / (1.52 + 1.38**2)) ** 2
    assert R[0] == pytest.approx(closed, rel=1e-12)
    assert R[0] == pytest.approx(0.0126, abs=5e-5)
    assert T[0] == pytest.approx(1.0 - closed, rel=1e-12)


def test_a_half_wave_is_absent():
    film = Stack((2.3 + 0j,), (550.0 / 2.0 / 2.3,))
    assert coated(1.0, 1.52, film, 550.0, np.ones(1))[0][0] == pytest.approx((0.52 / 2.52) ** 2, rel=1e-12)


def test_a_quarter_wave_mirror_has_its_closed_form():
    # (H L)^5 H on glass: admittance (H/L)^10 H² / n, Born & Wolf 1.6.5.
    high, low, glass = 2.3, 1.38, 1.52
    indices = (high, low) * 5 + (high,)
    stack = Stack(tuple(complex(n) for n in indices), tuple(550.0 / 4.0 / n for n in indices))
    Y = (high / low) ** 10 * high**2 / glass
    assert coated(1.0, glass, stack, 550.0, np.ones(1))[0][0] == pytest.approx(((1.0 - Y) / (1.0 + Y)) ** 2, rel=1e-12)


@pytest.mark.parametrize(("n_i", "n_t"), [(1.0, 1.5), (1.5, 1.0), (1.6, 1.7)])
def test_no_layers_are_bare_glass(n_i, n_t):
    cosines = np.linspace(0.01, 1.0, 100)
    R, T = coated(n_i, n_t, NOTHING, 550.0, cosines)
    bare = np.array([fresnel(n_i, n_t, c)[:2] for c in cosines])
    np.testing.assert_allclose(np.stack([R, T], axis=1), bare, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("stack", [NOTHING, Stack((1.5 + 0.0j,), (100.0,)), Stack((1.5 + 0.0j,) * 2, (1.0, 1e4))])
def test_without_a_step_of_the_index_all_light_passes_along_the_interface_too(stack):
    R, T = coated(1.5, 1.5, stack, 550.0, np.array([0.0, 1e-9, 0.5, 1.0]))
    np.testing.assert_allclose(np.stack([R, T]), [[0.0] * 4, [1.0] * 4], rtol=0.0, atol=1e-12)


def test_without_absorption_all_light_is_reflected_or_passes():
    draw = np.random.default_rng(3)
    seen = 0
    for _ in range(2000):
        n_i, n_t, stack, wavelength, angle = random_stack(draw)
        if not stack.absorbs:
            R, T = coated(n_i, n_t, stack, wavelength, np.cos(angle))
            assert abs(R[0] + T[0] - 1.0) < 1e-12
            seen += 1
    assert seen > 1000


def test_as_much_light_passes_either_way_and_without_absorption_as_much_is_reflected():
    draw = np.random.default_rng(4)
    both_ways = one_sided = 0
    for _ in range(2000):
        n_i, n_t, stack, wavelength, angle = random_stack(draw)
        sine = n_i / n_t * np.sin(angle)
        if sine >= 1.0:
            continue
        k_i = np.array([n_i * np.cos(angle)])
        k_t = beyond(n_i, n_t, k_i)
        for polarisation in (S, P):
            R, T = polarised(n_i, n_t, stack, wavelength, k_i, k_t, polarisation)
            back_R, back_T = polarised(n_t, n_i, stack.reversed, wavelength, k_t.real, k_i + 0j, polarisation)
            assert T[0] == pytest.approx(back_T[0], rel=1e-10, abs=1e-300)
            if not stack.absorbs:
                assert R[0] == pytest.approx(back_R[0], abs=1e-12)
            one_sided += abs(R[0] - back_R[0]) > 1e-3
        both_ways += 1
    assert both_ways > 1000
    # The sides of absorbing stacks do differ, so that a reversed stack is not the stack.
    assert one_sided > 100


def test_layers_that_absorb_leave_less_than_came():
    draw = np.random.default_rng(5)
    for _ in range(1000):
        n_i, n_t, stack, wavelength, angle = random_stack(draw)
        if stack.absorbs:
            R, T = coated(n_i, n_t, stack, wavelength, np.cos(angle))
            assert R[0] >= 0.0
            assert T[0] >= 0.0
            assert R[0] + T[0] < 1.0 + 1e-12


def test_a_thick_metal_reflects_as_its_surface_does_and_passes_nothing():
    # An infinite half-space of index n + ik: |(1 − n − ik) / (1 + n + ik)|².
    silver = 0.06 + 3.6j
    R, T = coated(1.0, 1.52, Stack((silver,), (1e6,)), 550.0, np.ones(1))
    assert R[0] == pytest.approx(abs((1.0 - silver) / (1.0 + silver)) ** 2, rel=1e-12)
    assert T[0] == 0.0


def test_light_tunnels_through_a_thin_gap_under_total_reflection_and_not_through_a_wide_one():
    angle = np.radians(60.0)
    gap = [
        coated(1.5, 1.5, Stack((1.0 + 0j,), (width,)), 550.0, np.cos(angle))[1][0] for width in (1.0, 100.0, 1e4, 1e7)
    ]
    assert gap[0] > 0.99
    assert gap[0] > gap[1] > gap[2] > gap[3] == 0.0
    # The transmittance of a wide gap falls by exp(−2 κ d), κ = 2π/λ √(n² sin² θ − 1).
    kappa = 2.0 * np.pi / 550.0 * np.sqrt((1.5 * np.sin(angle)) ** 2 - 1.0)
    near, far = (coated(1.5, 1.5, Stack((1.0 + 0j,), (d,)), 550.0, np.cos(angle))[1][0] for d in (3000.0, 3100.0))
    assert far / near == pytest.approx(np.exp(-200.0 * kappa), rel=1e-9)


def test_the_critical_angle_of_a_layer_is_no_exception():
    # There the field in the layer is a straight line, and the matrix is the limit of its neighbours'.
    n = 1.5
    at = np.sqrt(1.0 - (1.2 / n) ** 2)
    cosines = at + np.array([-1e-7, 0.0, 1e-7])
    R, T = coated(n, 1.4, Stack((1.2 + 0j,), (80.0,)), 550.0, cosines)
    assert np.isfinite(R).all()
    assert R[1] == pytest.approx(0.5 * (R[0] + R[2]), abs=1e-10)
    assert (R + T)[1] == pytest.approx(1.0, abs=1e-12)
