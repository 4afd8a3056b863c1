"""Lines through media: transmittance and emission against closed forms and quadrature."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from lfmesh.geometry.frame import IDENTITY
from lfmesh.geometry.ray import Ray
from lfmesh.scene import Scene
from lfmesh.transport.events.scattering_point import scattering_point
from lfmesh.transport.events.volume import Line, Passage, pass_through
from lfmesh.transport.packets.random import descendant
from lfmesh.transport.tables.hosts import Hosts
from lfmesh.transport.tables.lines import Lines
from lfmesh.transport.tables.tables import Media
from lfmesh.transport.tables.volumes import Volumes, volume_tables
from tests.cameras import camera_without_array

MOVES = np.broadcast_to(IDENTITY, (5, 5, 3, 4)).copy()
KEY = np.uint64(5)


def volumes_of(*media: dict[str, Any], folder: Path | None = None, **changes: Any) -> Volumes:
    scene = Scene(camera=camera_without_array(), media=media, **changes)  # type: ignore[arg-type]
    lines, none = Lines.of(scene), np.zeros(0, np.int64)
    air = Hosts([], none, none, Media(np.ones((1, len(lines.wavelengths_nm)))), [], [])
    found, _ = volume_tables(scene.in_folder(folder or "."), MOVES, lines, np.arange(len(media)), air)
    assert found is not None
    return found


def line(*ray: float, colour: int = 0) -> Line:
    """Return a line in air."""
    return Line(Ray(*map(float, ray)), 0, colour, None, 0)


def passage(volumes: Volumes, p: Any, d: Any, reach: float, book: Any = None, colour: int = 0) -> Passage:
    d = np.array(d, dtype=float) / np.linalg.norm(d)
    book = np.zeros(len(volumes.rows)) if book is None else book
    return Passage(*pass_through(volumes, line(*map(float, p), *d.tolist(), colour=colour), reach, book, 1.0, KEY))


def slab(thickness: float, **values: Any) -> dict[str, Any]:
    return {"bounds": {"kind": "box", "size_mm": [1e3, 1e3, thickness]}, "position_mm": [0.0, 0.0, -100.0], **values}


@pytest.mark.parametrize("kappa", [1e-9, 0.01, 0.3, 20.0])
def test_slab_transmits_by_beer_and_lambert_and_emits_what_it_absorbs(kappa: float) -> None:
    volumes = volumes_of(slab(10.0, absorption_per_mm=kappa, emission_w_mm3_sr=2e-6 * kappa))
    book = np.zeros(1)
    d = np.array([0.3, -0.2, 1.0])
    way = 10.0 * np.linalg.norm(d)
    found = passage(volumes, (1.0, 2.0, -200.0), d, np.inf, book)
    np.testing.assert_allclose(found.transmittance, np.exp(-kappa * way), rtol=1e-12, atol=1e-300)
    # Kirchhoff: a radiance of 2 W/(m² sr) times the absorptance.
    np.testing.assert_allclose(found.light, -2.0 * np.expm1(-kappa * way), rtol=1e-13)
    np.testing.assert_allclose(book[0], -np.expm1(-kappa * way), rtol=1e-13)


@pytest.mark.parametrize("kappa", [5e-324, 1e-310, 1e-200])
def test_light_of_a_medium_that_absorbs_next_to_nothing_is_its_emission_times_the_way(kappa: float) -> None:
    volumes = volumes_of(slab(10.0, absorption_per_mm=kappa, emission_w_mm3_sr=2e-6))
    found = passage(volumes, (0.0, 0.0, -200.0), (0.0, 0.0, 1.0), np.inf)
    # 2e-6 W/(mm³ sr) along 10 mm, in W/(m² sr).
    np.testing.assert_allclose(found.light, 20.0, rtol=1e-13)


def test_a_line_that_ends_in_a_medium_is_cut_there() -> None:
    volumes = volumes_of(slab(10.0, absorption_per_mm=0.1))
    found = passage(volumes, (0.0, 0.0, -98.0), (0.0, 0.0, -1.0), 4.0)
    np.testing.assert_allclose(found.transmittance, np.exp(-0.4), rtol=1e-14)


@pytest.mark.parametrize(
    ("bounds", "chord"),
    [
        ({"kind": "sphere", "radius_mm": 5.0}, 2.0 * np.sqrt(25.0 - 9.0)),
        ({"kind": "cylinder", "radius_mm": 5.0, "height_mm": 3.0}, 3.0),
        ({"kind": "box", "size_mm": [8.0, 1.0, 7.0]}, 7.0),
    ],
)
def test_bounds_cut_chords(bounds: dict[str, Any], chord: float) -> None:
    medium = {"bounds": bounds, "position_mm": [0.0, 0.0, -100.0], "absorption_per_mm": 0.1}
    found = passage(volumes_of(medium), (3.0, 0.0, 0.0), (0.0, 0.0, -1.0), 1e4)
    np.testing.assert_allclose(found.transmittance, np.exp(-0.1 * chord), rtol=1e-13)
    turned = medium | {"rotation_deg": [20.0, 30.0, -40.0], "position_mm": [1.0, 2.0, -100.0]}
    volumes = volumes_of(turned)
    own = volumes.rows[0]["to_own"]
    p, d = own[:, :3].T @ (np.array([3.0, 0.0, 50.0]) - own[:, 3]), own[:, :3].T @ [0.0, 0.0, -1.0]
    np.testing.assert_allclose(passage(volumes, p, d, np.inf).transmittance, np.exp(-0.1 * chord), rtol=1e-12)


def test_overlapping_media_add_and_share_what_they_absorb() -> None:
    book = np.zeros(2)
    near = slab(10.0, absorption_per_mm=0.03, emission_w_mm3_sr=1e-8)
    far = slab(10.0, absorption_per_mm=0.07) | {"position_mm": [0.0, 0.0, -105.0]}
    found = passage(volumes_of(near, far), (0.0, 0.0, 0.0), (0.0, 0.0, -1.0), np.inf, book)
    np.testing.assert_allclose(found.transmittance, np.exp(-0.15 - 0.5 - 0.35), rtol=1e-13)
    first, both = -np.expm1(-0.15), -np.expm1(-0.5) * np.exp(-0.15)
    np.testing.assert_allclose(book, [first + 0.3 * both, 0.7 * both - np.expm1(-0.35) * np.exp(-0.65)], rtol=1e-12)
    np.testing.assert_allclose(found.light, 0.01 * (first / 0.03 + both / 0.1), rtol=1e-12)


def test_an_endless_medium_fills_the_space_before_the_lens() -> None:
    volumes = volumes_of({"absorption_per_mm": 0.01, "emission_w_mm3_sr": 1e-8})
    np.testing.assert_allclose(
        passage(volumes, (0.0, 0.0, 5.0), (0.0, 0.0, -1.0), 105.0).transmittance, np.exp(-1.0), rtol=1e-13
    )
    away = passage(volumes, (0.0, 0.0, 5.0), (0.0, 0.0, -1.0), np.inf)
    assert away.transmittance == 0.0
    np.testing.assert_allclose(away.light, 1.0, rtol=1e-14)


def test_fog_without_an_end_scatters_all_that_it_does_not_absorb() -> None:
    """Ways to scattering points have the mean 1 / κ: a z-test at 4.5 sigma."""
    volumes = volumes_of({"absorption_per_mm": 0.002, "scattering_per_mm": 0.004})
    way = (0.0, 0.0, -5.0, 0.6, 0.0, -0.8)
    points = []
    for i in range(4000):
        key = descendant(KEY, i)
        found = Passage(*pass_through(volumes, line(*way), np.inf, np.zeros(1), 0.0, key))
        points.append(scattering_point(volumes, line(*way), found, key)[:2])
    t, share = np.array(points).T
    np.testing.assert_allclose(share, 2.0 / 3.0, rtol=1e-13)
    assert abs(t.mean() * 0.006 - 1.0) < 4.5 / np.sqrt(len(t))


def test_a_constant_grid_is_exact(tmp_path: Path) -> None:
    draw = np.random.default_rng(1)
    kappa, emission = draw.uniform(0.0, 0.3, (2, 5, 4, 6))
    np.savez(tmp_path / "g.npz", absorption_per_mm=kappa, emission_w_mm3_sr=1e-6 * emission, spacing_mm=[1.0, 2.0, 3.0])
    volumes = volumes_of(
        {"grid": {"file": "g.npz", "interpolation": "constant"}, "position_mm": [0.0, 0.0, -100.0]}, folder=tmp_path
    )
    start, ends = np.array([-2.9, 3.1, -108.0]), np.array([2.3, -3.7, -92.0])
    reach = float(np.linalg.norm(ends - start))
    found = passage(volumes, start, ends - start, reach)
    cuts = [0.0, 1.0]
    low = np.array([-2.5, -4.0, -109.0])
    for axis, (n, s) in enumerate(zip(kappa.shape, (1.0, 2.0, 3.0), strict=True)):
        cuts += [(low[axis] + i * s - start[axis]) / (ends - start)[axis] for i in range(n + 1)]
    cuts = sorted(c for c in cuts if 0.0 <= c <= 1.0)
    left, light = 1.0, 0.0
    for a, b in pairwise(cuts):
        place = np.floor((start + 0.5 * (a + b) * (ends - start) - low) / [1.0, 2.0, 3.0]).astype(int)
        if (place < 0).any() or (place >= kappa.shape).any():
            continue
        k, j = kappa[tuple(place)], emission[tuple(place)]
        light += left * j * -np.expm1(-k * (b - a) * reach) / k
        left *= np.exp(-k * (b - a) * reach)
    np.testing.assert_allclose(found.transmittance, left, rtol=1e-12)
    np.testing.assert_allclose(found.light, light, rtol=1e-12)


def smooth_grid(folder: Path, n: int, half: float = 10.0) -> Volumes:
    """Save and load samples of smooth formulas on n³ voxels whose outer centres lie on the faces of a cube."""
    axis = np.linspace(-half, half, n)
    r2 = axis[:, None, None] ** 2 + 1.3 * axis[:, None] ** 2 + axis**2
    name = f"g{n}.npz"
    np.savez(
        folder / name, absorption_per_mm=0.2 * np.exp(-r2 / 12.0), emission_w_mm3_sr=1e-6 * np.exp(-r2 / 9.0),
        spacing_mm=axis[1] - axis[0],
    )  # fmt: skip
    return volumes_of({"grid": name, "position_mm": [0.0, 0.0, -100.0]}, folder=folder)


START, DIRECTION = np.array([0.7, -0.4, -85.0]), np.array([0.1, 0.2, -1.0])


def test_a_formula_on_a_grid_converges_with_the_second_order(tmp_path: Path) -> None:
    d = DIRECTION / np.linalg.norm(DIRECTION)

    def along(t: float, state: Any) -> list[float]:
        p = START + t * d + [0.0, 0.0, 100.0]
        r2 = p[0] ** 2 + 1.3 * p[1] ** 2 + p[2] ** 2
        return [0.2 * np.exp(-r2 / 12.0), np.exp(-r2 / 9.0) * np.exp(-state[0])]

    ends = [(100.0 - 85.0 - 10.0) / -d[2], (100.0 - 85.0 + 10.0) / -d[2]]
    exact = solve_ivp(along, ends, [0.0, 0.0], rtol=1e-11, atol=1e-13, max_step=0.1).y[:, -1]
    errors = []
    for n in (33, 65, 129):
        found = passage(smooth_grid(tmp_path, n), START, DIRECTION, np.inf)
        errors.append([-np.log(found.transmittance) / exact[0] - 1.0, found.light / exact[1] - 1.0])
    orders = np.log2(np.abs(np.array(errors))[:-1] / np.abs(np.array(errors))[1:])
    assert (np.abs(orders - 2.0) < 0.2).all(), (errors, orders)
    assert np.abs(errors[-1]).max() < 1e-3


def test_the_quadrature_within_a_grid_is_far_finer_than_its_voxels(tmp_path: Path) -> None:
    volumes = smooth_grid(tmp_path, 17)
    d = DIRECTION / np.linalg.norm(DIRECTION)
    whole = passage(volumes, START, d, 40.0)
    # The same line in 4000 pieces, each of which is a line of its own.
    left, light = 1.0, 0.0
    for t in np.arange(4000) * 0.01:
        piece = passage(volumes, START + t * d, d, 0.01)
        light += left * piece.light
        left *= piece.transmittance
    np.testing.assert_allclose(whole.transmittance, left, rtol=1e-11)
    np.testing.assert_allclose(whole.light, light, rtol=2e-5)


@pytest.mark.parametrize("n", [0, 9])
def test_scattering_points_have_the_density_of_single_scattering(n: int, tmp_path: Path) -> None:
    """The mean of f at random points, weighted by their share, is ∫ f κs exp(−τ) dt; 8 z-tests at 4.5 sigma."""
    if n:
        axis = np.linspace(-10.0, 10.0, n)
        ks = 0.15 * np.exp(-(axis[:, None, None] ** 2 + axis[:, None] ** 2 + axis**2) / 30.0)
        np.savez(tmp_path / "g.npz", scattering_per_mm=ks, spacing_mm=axis[1] - axis[0])
        medium: dict[str, Any] = {"grid": "g.npz", "position_mm": [0.0, 0.0, -100.0], "absorption_per_mm": 0.04}
    else:
        medium = slab(20.0, scattering_per_mm=0.1, absorption_per_mm=0.04)
    volumes = volumes_of(medium, folder=tmp_path)
    d = DIRECTION / np.linalg.norm(DIRECTION)
    fine = np.linspace(0.0, 40.0, 8001)
    coefficient = np.zeros((2, len(fine) - 1))
    for i, t in enumerate(fine[:-1]):
        piece = passage(volumes, START + t * d, d, fine[1])
        coefficient[:, i] = -np.log(piece.transmittance), piece.scattered
    left = np.exp(-np.concatenate([[0.0], np.cumsum(coefficient[0])]))[:-1]
    density = left * coefficient[1]
    middle = 0.5 * (fine[1:] + fine[:-1])
    points = []
    for i in range(20000):
        key = descendant(KEY, i)
        book = np.zeros(1)
        found = Passage(*pass_through(volumes, line(*START, *d), np.inf, book, 0.0, key))
        t, share, _, _ = scattering_point(volumes, line(*START, *d), found, key)
        points.append((t, share))
    t, share = np.array(points).T
    np.testing.assert_allclose(found.scattered, density.sum(), rtol=5e-3 if n else 1e-4)
    for power in range(4):
        values = share * (t / 20.0) ** power
        expected = (density * (middle / 20.0) ** power).sum()
        z = (values.mean() - expected) / (values.std() / np.sqrt(len(values)) + 1e-9 + 1e-4 * expected)
        assert abs(z) < 4.5, (power, values.mean(), expected)


def test_media_that_overlap_scatter_as_one_of_their_sum() -> None:
    """Where the sum is constant, a scattering point carries just what is scattered; each medium has its share."""
    volumes = volumes_of(
        slab(20.0, scattering_per_mm=0.02, absorption_per_mm=0.01), slab(20.0, scattering_per_mm=0.06),
        slab(20.0, absorption_per_mm=0.03),
    )  # fmt: skip
    sole = volumes_of(slab(20.0, scattering_per_mm=0.08, absorption_per_mm=0.04))
    d = DIRECTION / np.linalg.norm(DIRECTION)
    chosen = np.zeros(3)
    for i in range(4000):
        key = descendant(KEY, i)
        found = Passage(*pass_through(volumes, line(*START, *d), np.inf, np.zeros(3), 0.0, key))
        t, share, _, which = scattering_point(volumes, line(*START, *d), found, key)
        one = Passage(*pass_through(sole, line(*START, *d), np.inf, np.zeros(1), 0.0, key))
        np.testing.assert_allclose((t, share), scattering_point(sole, line(*START, *d), one, key)[:2], rtol=1e-12)
        np.testing.assert_allclose(share, one.scattered, rtol=1e-12)
        chosen[which] += 1
    # Binomial, at 4 sigma.
    assert chosen[2] == 0
    assert abs(chosen[0] / 4000 - 0.25) < 4.0 * np.sqrt(0.25 * 0.75 / 4000)
