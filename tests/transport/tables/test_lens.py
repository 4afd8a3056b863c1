"""What is known of the surfaces of a space without their meshes: how steep they are, and how wide a ring is."""

import numpy as np
import pytest

from lfmesh.geometry.frame import rotation
from lfmesh.geometry.meshes.levels import EXACT, PATCH
from lfmesh.geometry.meshes.mesh import Mesh
from lfmesh.geometry.surfaces.sag import sag, slope
from lfmesh.geometry.surfaces.surface import put_in_pose, surface
from lfmesh.geometry.surfaces.tessellation import OVERREACH, revolved
from lfmesh.transport.tables.lens import _free_radius, least_dz, steepest_slope

RIM = 8.0


def drawn_asphere(draw):
    terms = draw.normal(size=4) * 0.3
    record = surface(
        draw.choice([-1.0, 1.0]) * draw.uniform(10.0, 60.0), draw.uniform(-2.0, 0.3),
        [a / (2 * m + 4) / RIM ** (2 * m + 3) for m, a in enumerate(terms)],
    )  # fmt: skip
    record["level"] = EXACT
    return record


def test_no_slope_inside_the_rim_exceeds_the_bound_and_the_bound_is_close():
    draw = np.random.default_rng(1)
    for _ in range(50):
        record = drawn_asphere(draw)
        r = np.linspace(0.0, RIM * (1.0 + OVERREACH), 20_001)
        steepest = np.abs(slope(record, r)).max()
        assert steepest <= steepest_slope(record, RIM) <= 1.02 * steepest


def test_a_surface_that_ends_inside_the_rim_has_no_bound():
    assert steepest_slope(surface(0.9 * RIM), RIM) == np.inf
    record = surface(0.9 * RIM)
    record["level"] = EXACT
    assert least_dz(record, RIM) == np.inf


def test_along_steeper_rays_the_height_above_a_tilted_surface_changes_in_one_sense():
    draw = np.random.default_rng(2)
    both_ways = 0
    for _ in range(60):
        record = drawn_asphere(draw)
        turn = rotation(draw.normal(size=3) * [3.0, 3.0, 90.0])
        put_in_pose(record, np.column_stack([turn, draw.normal(size=3)]))
        least = least_dz(record, RIM)
        assert least < 1.0
        for dz, expected in ((least, True), (0.6 * least, False)):
            phi = draw.uniform(0.0, 2.0 * np.pi, (64, 1))
            across = np.sqrt(1.0 - dz * dz)
            d = np.hstack([across * np.cos(phi), across * np.sin(phi), np.full_like(phi, dz)]) @ turn
            start = np.hstack([draw.uniform(-RIM, RIM, (64, 2)), np.zeros((64, 1))])
            t = np.linspace(-4.0 * RIM, 4.0 * RIM, 801)
            p = start[:, None] + t[:, None] * d[:, None]
            r = np.hypot(p[..., 0], p[..., 1])
            height = p[..., 2] - sag(record, np.minimum(r, RIM))
            rises = np.diff(height, axis=1) > 0.0
            inside = (r <= RIM)[:, 1:] & (r <= RIM)[:, :-1]
            if expected:
                assert rises[inside].all()
            else:
                both_ways += not rises[inside].all()
    # The bound is no more than a few times too careful.
    assert both_ways > 30


def test_only_exact_surfaces_have_a_steepness():
    record = drawn_asphere(np.random.default_rng(3))
    record["level"] = PATCH
    assert least_dz(record, RIM) == np.inf


@pytest.mark.parametrize("shift", [0.0, 0.7])
def test_the_free_radius_of_a_ring_is_that_of_its_nearest_chord(shift):
    ring = revolved(np.array([[5.0, 0.0], [6.0, 3.0]]), 24)
    moved = Mesh(np.add(ring.vertices, [shift, 0.0, 0.0]), ring.faces)
    chord = 5.0 * np.cos(np.pi / 24)
    radius = _free_radius(moved, 5.0)
    if shift == 0.0:
        assert radius == pytest.approx(chord, rel=1e-12)
    else:
        assert chord - shift <= radius <= 5.0 - shift


def test_where_rims_meet_there_is_no_ring_and_the_space_ends_there() -> None:
    assert _free_radius(Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64)), 4.0) == 4.0
