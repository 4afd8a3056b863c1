"""No leaks: random packets through the double Gauss, every reflection followed, are in the medium that they claim.

A packet that slips through a surface unseen keeps its energy, so no balance shows it. Here the prescription itself
tells in which medium a point lies: spheres and planes in order, nothing of meshes or of the tracer.
"""

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene import load_lens

SHARES = (0.1, 0.5, 0.9)
"""Where along the way between two crossings the medium is looked up."""

ROUNDING_MM = 1e-12
BATCH = 1 << 17


@pytest.fixture(scope="module")
def scene():
    lens = load_lens(asset_path("lenses/double_gauss_50mm.toml"))
    sensor = lf.Sensor(pixels=(400, 400), pixel_mm=0.1, distance_mm=35.0)
    return lf.solved(lf.Scene(camera=lf.Camera(lens=lens, sensor=sensor)))


@pytest.fixture(scope="module")
def world(scene):
    return lf.build(scene)


def random_rays(count, seed):
    """Rays from before the lens, from behind it, and from within, in glass and air, in every direction."""
    draw = np.random.default_rng(seed)
    d = draw.normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    place = np.arange(count) % 4
    r, phi = np.sqrt(draw.uniform(size=count)), draw.uniform(0.0, 2.0 * np.pi, count)
    z = np.select([place == 0, place == 1], [-5.0, 45.0], draw.uniform(0.0, 32.0, count))
    reach = np.where(place < 2, 12.0, 8.0)
    o = np.column_stack([reach * r * np.cos(phi), reach * r * np.sin(phi), z])
    # Towards the lens, most of them near the axis as light is.
    towards = np.column_stack([0.3 * d[:, :2], np.abs(d[:, 2]) * np.where(place == 0, 1.0, -1.0)])
    d = np.where((place < 2)[:, None], towards / np.linalg.norm(towards, axis=1, keepdims=True), d)
    return o, d


class Prescription:
    """The refracting surfaces of a lens, in order; space s lies before surface s, space 0 is outside."""

    def __init__(self, scene):
        lens = scene.camera.lens
        kept = [k for k in range(len(lens.surfaces)) if not lens.is_pure_stop(k)]
        self.number = {f"lens surface {k}": order for order, k in enumerate(kept)}
        self.vertex = np.array([lens.vertices_mm[k] for k in kept])
        self.curvature = np.array([1.0 / lens.surfaces[k].radius_mm for k in kept])
        self.aperture = np.array([lens.surfaces[k].semi_diameter_mm for k in kept])
        self.index = np.array([1.0, *(lens.surfaces[k].medium or 1.0 for k in kept)])

    def height(self, k, p):
        """How far points stand behind surface k; NaN beside its clear aperture."""
        r2 = p[..., 0] ** 2 + p[..., 1] ** 2
        c = self.curvature[k]
        with np.errstate(invalid="ignore"):
            sag = c * r2 / (1.0 + np.sqrt(1.0 - c * c * r2))
        return np.where(r2 <= self.aperture[k] ** 2, p[..., 2] - self.vertex[k] - sag, np.nan)

    def astray(self, space, p):
        """Which points lie outside the space that they should lie in."""
        wrong = np.zeros(len(p), bool)
        for k in range(len(self.vertex)):
            height = self.height(k, p)
            wrong |= (k < space) & (height < -ROUNDING_MM)
            wrong |= (k >= space) & (height > ROUNDING_MM)
        return wrong

    def space_of(self, p):
        """Number of surfaces that a point lies behind: inside every aperture, or before or behind the whole lens."""
        heights = np.array([float(self.height(k, p)) for k in range(len(self.vertex))])
        return int(np.where(np.isnan(heights), p[2] > self.vertex[-1], heights > 0.0).sum())

    def normal(self, k, p):
        return np.array([*(-self.curvature[k] * p[:2]), 1.0 - self.curvature[k] * (p[2] - self.vertex[k])])


def segments(lens, paths, packets):
    """(points, spaces) along recorded paths, and the worst of Snell's law at their crossings."""
    points, spaces, worst = [], [], 0.0
    for packet in packets:
        path = paths.vertices(packet)
        space = lens.space_of(path[0].position)
        for before, here, after in zip(path[:-1], path[1:], [*path[2:], None], strict=True):
            way = here.position - before.position
            points += [before.position + share * way for share in SHARES]
            spaces += [space] * len(SHARES)
            k = lens.number.get(here.surface)
            if k is None:
                continue
            assert space in (k, k + 1), f"{here.surface} met from space {space}"
            other = 2 * k + 1 - space
            into = other if here.event.name == "TRANSMITTED" else space
            if after is not None:
                onward = after.position - here.position
                lengths = np.linalg.norm(way), np.linalg.norm(onward)
                # A short way has the digits of its ends only.
                if min(lengths) > 1e-2:
                    n = lens.normal(k, here.position)
                    bent = lens.index[into] * np.cross(onward / lengths[1], n)
                    bent -= lens.index[space] * np.cross(way / lengths[0], n)
                    worst = max(worst, np.abs(bent).max() * min(lengths))
            space = into
    return np.array(points), np.array(spaces), worst


def nothing_leaks(world, lens, packets, sample):
    """Trace until so many packets have ended; look up the media of a sample of each batch."""
    ended, emitted, batch = 0, 0.0, 0
    while ended < packets:
        o, d = random_rays(min(BATCH, packets), batch)
        paths = lf.trace(world, o, d, split="both", seed=batch)
        assert not any(paths.ledger.lost.values())
        assert abs(paths.ledger.imbalance) < 1e-12
        assert not (paths.status == lf.Status.LOST).any()
        ended, emitted, batch = ended + len(paths), emitted + paths.ledger.emitted, batch + 1
        recorded = lf.trace(world, o[:sample], d[:sample], split="both", seed=batch, record=True)
        points, spaces, snell = segments(lens, recorded, range(len(recorded)))
        assert len(points) > 3 * sample
        seen = np.bincount(spaces, minlength=len(lens.vertex) + 1)
        assert seen.min() > 0.002 * len(points)
        assert lens.astray(spaces, points).sum() == 0
        assert snell < 1e-11
    return ended


def test_every_packet_is_in_the_medium_that_it_says(world, scene):
    assert nothing_leaks(world, Prescription(scene), 100_000, 4000) >= 100_000


@pytest.mark.long
def test_ten_million_packets_never_leak(world, scene):
    assert nothing_leaks(world, Prescription(scene), 10_000_000, 1000) >= 10_000_000
