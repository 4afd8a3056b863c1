"""Mueller matrices of interfaces: fields that satisfy Maxwell's conditions, `tmm`, energy, and a rhomb."""

import numpy as np
import pytest

from lfmesh.optics.coatings import Stack, coated
from lfmesh.optics.fresnel import fresnel
from lfmesh.optics.polarisation import after, bare_interface, coated_interface, turned

tmm = pytest.importorskip("tmm")

WAVELENGTH = 587.6
CASES = 400


def random_case(draw, absorbing=True):
    """Draw two media, an angle and a stack of up to four layers."""
    n_i, n_t = draw.uniform(1.0, 2.5, 2)
    count = int(draw.integers(0, 5))
    indices = draw.uniform(1.2, 2.5, count) + 1j * draw.uniform(0.0, 0.3, count) * (absorbing and draw.random() < 0.5)
    return n_i, n_t, draw.uniform(0.02, 1.0), indices, draw.uniform(5.0, 300.0, count)


def through(n_i, n_t, cosine, indices, thicknesses, turned=False):
    """Reflection and transmission of a stack, which stands behind another one in the tables."""
    table = np.concatenate([[9.0], indices]).astype(complex)[:, None]
    return coated_interface(
        n_i, n_t, cosine, table, np.concatenate([[1e3], thicknesses]), 0, 1, len(indices), turned, WAVELENGTH
    )


def rho(way):
    return complex(way.real, way.imaginary)


def test_random_stacks_have_the_amplitudes_of_tmm():
    draw = np.random.default_rng(1)
    for _ in range(CASES):
        n_i, n_t, cosine, indices, thicknesses = random_case(draw)
        n_behind, order = n_t, slice(None, None, -1 if (is_turned := bool(draw.random() < 0.5)) else 1)
        back, on = through(n_i, n_t, cosine, indices, thicknesses, is_turned)
        s, p = (
            tmm.coh_tmm(
                each, [n_i, *indices[order], n_behind], [np.inf, *thicknesses[order], np.inf], np.arccos(cosine),
                WAVELENGTH,
            )
            for each in "sp"
        )  # fmt: skip
        assert np.allclose([back.s, back.p, on.s, on.p], [s["R"], p["R"], s["T"], p["T"]], rtol=0.0, atol=1e-10)
        assert abs(rho(back) - np.conj(s["r"]) * p["r"]) < 1e-10
        passed = np.conj(s["t"]) * p["t"]
        if on.s > 0.0:
            assert abs(rho(on) - passed / abs(passed) * np.sqrt(s["T"] * p["T"])) < 1e-10


def test_what_is_not_absorbed_is_reflected_or_transmitted():
    draw = np.random.default_rng(2)
    for _ in range(CASES):
        back, on = through(*random_case(draw, absorbing=False))
        assert abs(back.s + on.s - 1.0) < 1e-12
        assert abs(back.p + on.p - 1.0) < 1e-12


def test_the_mean_of_s_and_p_is_the_unpolarised_share():
    draw = np.random.default_rng(3)
    for _ in range(CASES):
        n_i, n_t, cosine, indices, thicknesses = random_case(draw)
        for ways, shares in (
            (bare_interface(n_i, n_t, cosine), fresnel(n_i, n_t, cosine)[:2]),
            (
                through(n_i, n_t, cosine, indices, thicknesses),
                coated(n_i, n_t, Stack(tuple(indices), tuple(thicknesses)), WAVELENGTH, cosine),
            ),
        ):
            assert [0.5 * (way.s + way.p) for way in ways] == pytest.approx(
                [np.ravel(share)[0] for share in shares], abs=1e-11
            )


def test_a_stack_without_layers_is_a_bare_interface():
    draw = np.random.default_rng(4)
    for _ in range(CASES):
        n_i, n_t, cosine, *_ = random_case(draw)
        none = np.zeros(0)
        assert np.allclose(bare_interface(n_i, n_t, cosine), through(n_i, n_t, cosine, none, none), rtol=0, atol=1e-12)


def test_transmission_is_the_same_in_both_directions():
    draw = np.random.default_rng(5)
    for _ in range(CASES):
        n_i, n_t, cosine, indices, thicknesses = random_case(draw)
        _, _, cos_t = fresnel(n_i, n_t, cosine)
        if cos_t == 0.0:
            continue
        _, there = through(n_i, n_t, cosine, indices, thicknesses)
        _, back = through(n_t, n_i, cos_t, indices, thicknesses, turned=True)
        assert np.allclose(there, back, rtol=0.0, atol=1e-11)


def test_fields_are_continuous_across_a_bare_interface():
    """The amplitudes' signs from Maxwell's conditions alone, with time dependence exp(-iωt)."""
    draw = np.random.default_rng(6)
    for _ in range(CASES):
        n_i, n_t, cosine, *_ = random_case(draw)
        sine = np.sqrt((1.0 - cosine) * (1.0 + cosine))
        sine_t = n_i / n_t * sine
        cos_t = np.sqrt(complex(1.0 - sine_t**2))
        normal, s = np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])
        ways = [np.array([sine, 0.0, cosine]), np.array([sine, 0.0, -cosine]), np.array([sine_t, 0.0, cos_t])]
        assert np.allclose(np.cross(ways[0], normal), sine * s)
        # E along s, and E along p = d × s; H = n d × E. Unknown are the amplitudes of the two waves that leave.
        fields = [
            [(e, n * np.cross(d, e)) for e in (s, np.cross(d, s))] for n, d in zip([n_i, n_i, n_t], ways, strict=True)
        ]
        r = []
        for each in range(2):
            rows = []
            for field in range(2):
                for axis in range(2):
                    here, mirrored, bent = (fields[k][each][field][axis] for k in range(3))
                    rows.append((mirrored, -bent, -here))
            table = np.array(rows)
            r.append(np.linalg.lstsq(table[:, :2], table[:, 2], rcond=None)[0][0])
        back, _ = bare_interface(n_i, n_t, cosine)
        assert abs(np.conj(r[0]) * r[1] - rho(back)) < 1e-12
        assert [abs(each) ** 2 for each in r] == pytest.approx([back.s, back.p], abs=1e-12)


def mueller(way):
    mean, half, real, imaginary = 0.5 * (way.s + way.p), 0.5 * (way.s - way.p), way.real, way.imaginary
    return np.array(
        [[mean, half, 0, 0], [half, mean, 0, 0], [0, 0, real, -imaginary], [0, 0, imaginary, real]], np.float64
    )


def random_state(draw, degree=1.0):
    state = draw.normal(size=3)
    return degree * state / np.linalg.norm(state)


def test_states_follow_the_mueller_matrix():
    draw = np.random.default_rng(7)
    for _ in range(CASES):
        state = random_state(draw, draw.uniform(0.0, 1.0))
        for way in through(*random_case(draw)):
            share, *found = after(way, *state)
            expected = mueller(way) @ [1.0, *state]
            assert np.allclose(share * np.array([1.0, *found]), expected, rtol=0.0, atol=1e-14)


def test_no_state_is_more_than_completely_polarised():
    draw = np.random.default_rng(8)
    for _ in range(CASES):
        angle = np.arctan(1.5) * (1.0 + draw.choice([0.0, 1e-16, 1e-9]))
        way, _ = bare_interface(1.0, 1.5, np.cos(angle))
        q = np.nextafter(-1.0, 0.0) if draw.random() < 0.5 else -1.0
        share, *state = after(way, q, 1e-8 * draw.normal(), 1e-8 * draw.normal())
        assert 0.0 <= share < 1e-15
        assert np.linalg.norm(state) <= 1.0 + 1e-15


def test_another_reference_direction_turns_linear_light_by_twice_the_angle():
    draw = np.random.default_rng(9)
    for psi, phi in draw.uniform(-4.0, 4.0, (CASES, 2)):
        q, u = turned(np.cos(2.0 * psi), np.sin(2.0 * psi), 3.0 * np.cos(phi), 3.0 * np.sin(phi))
        assert (q, u) == pytest.approx((np.cos(2.0 * (psi - phi)), np.sin(2.0 * (psi - phi))), abs=1e-14)


@pytest.mark.parametrize("n", [1.0, 1.5, 2.4])
def test_limits_hold(n):
    """Matched indices, normal and grazing incidence, and the critical angle."""
    assert bare_interface(n, n, 0.0) == ((0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 1.0, 0.0))
    assert np.allclose(bare_interface(1.0, n + 0.5, 0.0), [(1.0, 1.0, 1.0, 0.0), (0.0, 0.0, 0.0, 0.0)])
    back, on = bare_interface(1.0, n + 0.5, 1.0)
    # What comes back of right-handed light is left-handed: U and V change their signs.
    assert (back.s, back.real) == (back.p, -back.p)
    assert (on.s, on.real) == pytest.approx((on.p, on.p), abs=1e-15)
    critical = np.sqrt(1.0 - (1.0 / (n + 0.5)) ** 2)
    for way in (np.nextafter(critical, 0.0), critical, np.nextafter(critical, 1.0)):
        back, on = bare_interface(n + 0.5, 1.0, way)
        assert rho(back) == pytest.approx(1.0, abs=1e-6)
        assert back.s + on.s == pytest.approx(1.0, abs=1e-12)


def test_a_quarter_wave_of_magnesium_fluoride_leaves_its_published_share():
    """Macleod, Thin-Film Optical Filters: MgF2 (1.38) on glass of 1.52, (n0 ns - n1²)² / (n0 ns + n1²)²."""
    back, _ = through(1.0, 1.52, 1.0, np.array([1.38]), np.array([WAVELENGTH / 4.0 / 1.38]))
    share = ((1.52 - 1.38**2) / (1.52 + 1.38**2)) ** 2
    assert share == pytest.approx(0.0126, abs=5e-5)
    assert (back.s, back.p) == pytest.approx((share, share), abs=1e-15)


def test_total_reflection_turns_the_phase_by_born_and_wolfs_formula():
    n, angle = 1.51, np.radians(54.0 + 37.0 / 60.0)
    back, _ = bare_interface(n, 1.0, np.cos(angle))
    delta = 2.0 * np.arctan(np.cos(angle) * np.sqrt(np.sin(angle) ** 2 - n**-2) / np.sin(angle) ** 2)
    assert np.angle(rho(back)) == pytest.approx(-delta, abs=1e-14)
    # Born & Wolf, 1.5.4: an eighth of a wave at 54° 37'.
    assert np.degrees(delta) == pytest.approx(45.0, abs=0.01)
