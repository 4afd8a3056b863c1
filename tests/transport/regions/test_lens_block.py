"""A block of packets at their surfaces: each met where its conic is, and divided by the laws of Snell and Fresnel."""

import numpy as np
import pytest

from lfmesh.geometry.surfaces.sag import normals, sag, slope
from lfmesh.geometry.surfaces.surface import MAX_ASPHERE_TERMS, surface
from lfmesh.optics.fresnel import fresnel
from lfmesh.transport.events.facets import FLOAT32_GRAIN
from lfmesh.transport.regions import lens_block as lb

EPSILON = np.finfo(np.float64).eps
BLOCKS = 200
SURFACES = 6


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def rows(block, first, count=1):
    """Return `count` rows of a block from one of its offsets, a packet a row."""
    return block[first : first + count * lb.BLOCK].reshape(count, lb.BLOCK).T


def ready_block(draw):
    """Return a block of rays that cross conics of all kinds, each in the sense of its medium, and where they do."""
    block, n = lb.empty_block(), lb.BLOCK
    c = np.where(draw.random(n) < 0.1, 0.0, draw.uniform(-0.05, 0.05, n))
    k = np.where(draw.random(n) < 0.3, 0.0, draw.uniform(-3.0, 1.0, n))
    sense, vertex = draw.choice([-1.0, 1.0], n), draw.uniform(0.0, 50.0, n)
    r, phi = draw.uniform(0.0, 12.0, n), draw.uniform(0.0, 2.0 * np.pi, n)
    x, y = r * np.cos(phi), r * np.sin(phi)
    z = c * r * r / (1.0 + np.sqrt(1.0 - (1.0 + k) * c * c * r * r))
    up = unit(np.column_stack([-c * x, -c * y, 1.0 - c * (1.0 + k) * z]))
    directions = unit(sense[:, None] * up + draw.normal(scale=0.5, size=(n, 3)))
    against = np.einsum("ij,ij->i", up, directions) * sense < 0.1
    directions[against] = sense[against, None] * up[against]
    met = np.column_stack([x, y, z + vertex])
    way = draw.uniform(0.1, 20.0, n)
    rows(block, lb.X, 3)[:] = met - way[:, None] * directions
    rows(block, lb.DX, 3)[:] = directions
    rows(block, lb.FROM)[:, 0] = way * draw.uniform(0.0, 1.2, n)
    rows(block, lb.CURVATURE, 5)[:] = np.column_stack([c, 1.0 + k, vertex, np.full(n, 13.0**2), sense])
    rows(block, lb.FACET_X, 3)[:] = up
    rows(block, lb.OFFSET)[:, 0] = np.einsum("ij,ij->i", up, met)
    rows(block, lb.SIZE)[:, 0] = draw.uniform(0.5, 3.0, n)
    n_i, n_t = draw.uniform(1.0, 2.0, (2, n))
    rows(block, lb.N_I, 2)[:] = np.column_stack([n_i, np.where(draw.random(n) < 0.1, n_i, n_t)])
    rows(block, lb.NUMBER)[:, 0] = draw.integers(0, SURFACES, n)
    return block, met, up * sense[:, None]


@pytest.fixture(scope="module")
def blocks():
    """Met and split, with where each ray crosses its conic and the normal there."""
    draw = np.random.default_rng(5)
    made = [ready_block(draw) for _ in range(BLOCKS)]
    for block, _, _ in made:
        lb.meet_conics(block)
        lb.split_block(block)
    return made


def test_rays_meet_their_conics_where_these_are(blocks):
    for block, met, normal in blocks:
        assert (rows(block, lb.HELD) == 1.0).all()
        # Coordinates of up to 80 mm, met at a cosine of 0.1 at least.
        assert np.abs(rows(block, lb.PX, 3) - met).max() < 100 * 80 * EPSILON
        assert np.abs(rows(block, lb.NX, 3) - normal).max() < 100 * EPSILON


def spoil_start(block):
    """Start behind the surface."""
    start, along = rows(block, lb.X, 3), rows(block, lb.DX, 3)
    start += 25.0 * along
    rows(block, lb.FROM)[:] = 0.0


def spoil_facet(block):
    """Let the facet be crossed the other way than the surface."""
    rows(block, lb.FACET_X, 3)[:] *= -1.0


def spoil_aperture(block):
    """Stop the surface down to a little less than where it is met."""
    met = rows(block, lb.PX, 2)
    rows(block, lb.APERTURE2)[:, 0] = np.square(met).sum(axis=1) * (1.0 - 1e-9)


def spoil_sense(block):
    """Say that the packet is not for the block."""
    rows(block, lb.SENSE)[:] = 0.0


def spoil_curvature(block):
    """Bend the surface out of the ray's way: a small sphere far off the axis of the ray."""
    rows(block, lb.CURVATURE, 2)[:] = [5.0, 1.0]
    rows(block, lb.X)[:] += 40.0


def spoil_incidence(block):
    """Let the ray graze a sphere in its vertex."""
    rows(block, lb.X, 3)[:] = [-4.0, 0.0, 0.0]
    rows(block, lb.DX, 3)[:] = [1.0, 0.0, 0.0]
    rows(block, lb.FROM)[:] = 0.0
    rows(block, lb.CURVATURE, 3)[:] = [0.125, 1.0, 0.0]
    rows(block, lb.FACET_X, 3)[:] = rows(block, lb.SENSE) * [0.1, 0.0, 1.0]


SPOILS = [spoil_start, spoil_facet, spoil_aperture, spoil_sense, spoil_curvature, spoil_incidence]


@pytest.mark.parametrize("spoil", SPOILS)
def test_what_is_not_met_as_it_should_be_does_not_hold(blocks, spoil):
    for block, _, _ in blocks:
        spoiled = lb.empty_block()
        spoiled[:] = block
        spoil(spoiled)
        lb.meet_conics(spoiled)
        assert (rows(spoiled, lb.HELD) == 0.0).all()


def test_a_block_divides_power_by_fresnel(blocks):
    for block, _, _ in blocks:
        cosine = np.einsum("ij,ij->i", rows(block, lb.NX, 3), rows(block, lb.DX, 3)).clip(max=1.0)
        told = rows(block, lb.REFLECTANCE, 2)
        truth = np.array([fresnel(*pair, c)[:2] for pair, c in zip(rows(block, lb.N_I, 2), cosine, strict=True)])
        # Near the critical angle a rounding of the cosine counts with its root.
        sin2 = (rows(block, lb.N_I)[:, 0] / rows(block, lb.N_T)[:, 0]) ** 2 * (1.0 - cosine**2)
        assert np.abs(told - truth)[np.abs(sin2 - 1.0) > 1e-6].max() < 1e-11
        assert np.abs(told.sum(axis=1) - 1.0).max() < 1e-14


def test_a_block_bends_rays_by_snell_and_mirrors_them(blocks):
    refracting = reflecting = straight = 0
    for block, _, _ in blocks:
        d, n = rows(block, lb.DX, 3), rows(block, lb.NX, 3)
        n_i, n_t = rows(block, lb.N_I), rows(block, lb.N_T)
        mirrored, bent = rows(block, lb.REFLECTED, 3), rows(block, lb.REFRACTED, 3)
        assert np.abs(mirrored - (d - 2.0 * np.sum(n * d, axis=1, keepdims=True) * n)).max() < 8 * EPSILON
        passes = rows(block, lb.TRANSMITTANCE)[:, 0] > 0.0
        assert np.abs(n_t * np.cross(n, bent) - n_i * np.cross(n, d))[passes].max() < 16 * EPSILON
        assert (np.sum(n * bent, axis=1)[passes] > 0.0).all()
        assert np.abs(np.linalg.norm(bent[passes], axis=1) - 1.0).max() < 4 * EPSILON
        total = (n_i * np.linalg.norm(np.cross(n, d), axis=1, keepdims=True) > n_t * (1.0 + 1e-12))[:, 0]
        assert (rows(block, lb.REFLECTANCE, 2)[total] == [1.0, 0.0]).all()
        matched = (n_i == n_t)[:, 0]
        assert (rows(block, lb.REFLECTANCE, 2)[matched] == [0.0, 1.0]).all()
        assert np.abs(bent - d)[matched].max(initial=0.0) <= EPSILON
        refracting, reflecting, straight = refracting + passes.sum(), reflecting + total.sum(), straight + matched.sum()
    assert min(refracting, reflecting, straight) > BLOCKS


def test_queries_begin_behind_the_facet_by_a_float32_grain_and_no_further_than_its_size(blocks):
    for block, met, _ in blocks:
        facet, size = rows(block, lb.FACET_X, 3), rows(block, lb.SIZE)[:, 0]
        grain = FLOAT32_GRAIN * (np.abs(met).sum(axis=1) + size)
        for child in (lb.REFLECTED, lb.REFRACTED):
            clear = rows(block, child + lb.CLEAR)[:, 0]
            stands_off = clear * np.abs(np.sum(facet * rows(block, child, 3), axis=1))
            # The facets are tangent planes here.
            full = clear < size
            assert (clear > 0.0).all()
            assert (clear <= size).all()
            assert np.abs(stands_off / grain - 1.0)[full].max() < 1e-6


def test_what_becomes_of_a_packet_does_not_depend_on_its_place_in_the_block(blocks):
    draw = np.random.default_rng(6)
    for block, _, _ in blocks:
        order = draw.permutation(lb.BLOCK)
        shuffled = lb.empty_block()
        shuffled.reshape(lb.ROWS, lb.BLOCK)[: lb.PX // lb.BLOCK] = rows(block, 0, lb.PX // lb.BLOCK)[order].T
        lb.meet_conics(shuffled)
        lb.split_block(shuffled)
        assert np.array_equal(rows(shuffled, 0, lb.ROWS), rows(block, 0, lb.ROWS)[order], equal_nan=True)


def ready_aspheres(draw):
    """Return a block of rays steeper than the aspheres and conics that they are to meet, where they do, and along."""
    block, n = lb.empty_block(), lb.BLOCK
    met, normal, rays = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3))
    for i in range(n):
        r, sense = 10.0 * np.sqrt(draw.random()), draw.choice([-1.0, 1.0])
        terms = draw.normal(size=draw.integers(0, 5)) * 0.3
        shape = surface(
            draw.choice([-1.0, 1.0]) * draw.uniform(12.0, 60.0), draw.uniform(-2.0, 0.3),
            [a / (2 * m + 4) / 10.0 ** (2 * m + 3) for m, a in enumerate(terms)], vertex_z=draw.uniform(0.0, 50.0),
        )  # fmt: skip
        phi = draw.uniform(0.0, 2.0 * np.pi)
        x, y = r * np.cos(phi), r * np.sin(phi)
        met[i] = x, y, float(sag(shape, r)) + shape["vertex_z"]
        normal[i] = sense * normals(shape, [x], [y])[0]
        least = np.arctan(np.abs(slope(shape, np.linspace(0.0, 10.0, 500))).max())
        angle = draw.uniform(0.0, 0.5 * np.pi - least)
        turn = draw.uniform(0.0, 2.0 * np.pi)
        rays[i] = np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), sense * np.cos(angle)
        lb.set_only_conic.py_func(
            block, i, shape["curvature"], 1.0 + shape["conic"], shape["vertex_z"], (10.0 + 1e-9) ** 2, sense
        )  # fmt: skip
        block[lb.TERMS + i] = shape["terms"]
        rows(block, lb.COEFFICIENTS, MAX_ASPHERE_TERMS)[i] = shape["asphere"]
    rays = unit(rays)
    way = draw.uniform(0.1, 20.0, n)
    rows(block, lb.X, 3)[:] = met - way[:, None] * rays
    rows(block, lb.DX, 3)[:] = rays
    rows(block, lb.FROM)[:, 0] = way * draw.uniform(0.0, 1.2, n)
    return block, met, normal, way


def test_steep_rays_meet_aspheres_where_these_are():
    draw = np.random.default_rng(7)
    curved = missed = 0
    for _ in range(20):
        block, met, normal, way = ready_aspheres(draw)
        lb.meet_in_order(block)
        lb.meet_aspheres(block, MAX_ASPHERE_TERMS)
        held = rows(block, lb.HELD)[:, 0] == 1.0
        missed += (~held).sum()
        curved += (rows(block, lb.TERMS)[:, 0] > 0).sum()
        # Coordinates of up to 80 mm; nearly along the surface, rounding counts by the inverse cosine.
        cosine = np.sum(normal * rows(block, lb.DX, 3), axis=1)
        tolerance = 100 * 80 * EPSILON / cosine[held]
        assert (np.abs(rows(block, lb.PX, 3) - met).max(axis=1)[held] < tolerance).all()
        assert (np.abs(rows(block, lb.NX, 3) - normal).max(axis=1)[held] < tolerance).all()
        assert (np.abs(rows(block, lb.AT)[:, 0] - way)[held] < tolerance).all()
        again = lb.empty_block()
        again[:] = block
        rows(again, lb.APERTURE2)[:, 0] = np.square(met[:, :2]).sum(axis=1) * (1.0 - 1e-9)
        rows(again, lb.NEXT_APERTURE2)[:] = rows(again, lb.APERTURE2)
        lb.meet_in_order(again)
        lb.meet_aspheres(again, MAX_ASPHERE_TERMS)
        assert (rows(again, lb.HELD) == 0.0).all()
    assert curved > 300
    # A ray may not settle where it is hardly steeper than the surface.
    assert missed < 0.02 * 20 * lb.BLOCK


def test_steep_rays_meet_aspheres_from_facets_beside_them():
    draw = np.random.default_rng(8)
    curved = missed = 0
    for _ in range(20):
        block, met, normal, way = ready_aspheres(draw)
        rays = rows(block, lb.DX, 3)
        sense = np.sign(rays[:, 2])
        # A plane through a point close to the hit, whose normal looks along +z, as those of facets do.
        plane = unit(normal * sense[:, None] + draw.uniform(-0.02, 0.02, (lb.BLOCK, 3)))
        rows(block, lb.FACET_X, 3)[:] = plane
        rows(block, lb.OFFSET)[:, 0] = np.sum(plane * met, axis=1) + draw.uniform(-0.02, 0.02, lb.BLOCK)
        rows(block, lb.SENSE)[:, 0] = sense
        either = np.where(sense > 0.0, rows(block, lb.NEXT_CURVATURE)[:, 0], rows(block, lb.CURVATURE)[:, 0])
        rows(block, lb.CURVATURE)[:, 0] = either
        aspheres = rows(block, lb.TERMS)[:, 0] > 0
        wrong = lb.empty_block()
        wrong[:] = block
        rows(wrong, lb.SENSE)[:] *= -1.0
        lb.meet_aspheres_at_facets(wrong, MAX_ASPHERE_TERMS)
        assert (rows(wrong, lb.HELD)[aspheres] == 0.0).all()
        narrow = lb.empty_block()
        narrow[:] = block
        rows(narrow, lb.APERTURE2)[:, 0] = np.square(met[:, :2]).sum(axis=1) * (1.0 - 1e-9)
        lb.meet_aspheres_at_facets(narrow, MAX_ASPHERE_TERMS)
        assert (rows(narrow, lb.HELD)[aspheres] == 0.0).all()
        rows(block, lb.APERTURE2)[:] = (10.0 + 1e-9) ** 2
        lb.meet_aspheres_at_facets(block, MAX_ASPHERE_TERMS)
        held = (rows(block, lb.HELD)[:, 0] == 1.0) & aspheres
        cosine = np.sum(normal * rays, axis=1)
        missed += (aspheres & ~held).sum()
        curved += held.sum()
        tolerance = 100 * 80 * EPSILON / cosine[held]
        assert (np.abs(rows(block, lb.PX, 3) - met).max(axis=1)[held] < tolerance).all()
        assert (np.abs(rows(block, lb.NX, 3) - normal).max(axis=1)[held] < tolerance).all()
        assert (np.abs(rows(block, lb.AT)[:, 0] - way)[held] < tolerance).all()
    assert curved > 300
    assert missed < 0.02 * curved
