"""Paths with reflections in a lens of two surfaces, kind by kind, against a tracer that shares nothing with lfmesh.

The tracer draws rays from the sensor over a disk that holds the whole lens, and follows both children at each surface
without roulette. Where the image path brings no light, on the dark part of the sensor, its light of the lens's ghosts
and that of all other paths are compared with the two parts of an image. A survey of the whole sensor finds the dark
part; the other rays start there. LEVEL is the chance that this file fails though all is right, shared by its
comparisons (Bonferroni).
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.geometry.surfaces.tessellation import OVERREACH
from lfmesh.transport.paths.automaton import GHOSTS, OTHER_STRAYS
from lfmesh.transport.render.parts import Part, parts_of
from lfmesh.transport.render.render import Renderer
from tests.instances import instances

Array = NDArray[np.float64]

LEVEL = 1e-3
COMPARISONS = 12
REPLICATES = 32
SURVEY = 50_000
"""Rays from the whole sensor that find its dark squares."""
STARTS, BATCHES = 800, 48
"""Rays from each dark square of a batch; with many batches the limit of Student's t is near that of a normal."""
SEMI, PIXELS, PIXEL = 8.0, 12, 1.0
BLOCK = 3
LIGHTEST = 1e-7
"""Share of a ray's weight below which the tracer leaves a path."""

TARGET, SIZE = (90.0, 0.0, -100.0), 120.0

IMAGE, GHOST, OTHER, REFRACTED_AGAIN = 0, 1, 2, 3


@dataclass(frozen=True)
class Element:
    """A lens of two surfaces in air, and the sensor's distance from its last vertex; lengths in mm."""

    radii: tuple[float, float]
    thickness: float
    index: float
    distance: float

    @property
    def vertices(self) -> tuple[float, float]:
        return 0.0, self.thickness

    def sag(self, k: int) -> float:
        """Return the height of the rim above the vertex."""
        r = self.radii[k]
        return 0.0 if np.isinf(r) else r - np.sign(r) * np.sqrt(r * r - SEMI * SEMI)

    def scene(self, **transport: Any) -> lf.Scene:
        """Return a camera with this lens that looks past a glowing square, so that much of the sensor is dark."""
        surfaces = [
            {"radius_mm": self.radii[0], "thickness_mm": self.thickness, "index": self.index, "stop": True},
            {"radius_mm": self.radii[1], "thickness_mm": 0.0},
        ]
        return lf.Scene(
            camera={
                "lens": {"surfaces": [surface | {"semi_diameter_mm": SEMI} for surface in surfaces]},
                "sensor": {"pixels": [PIXELS, PIXELS], "pixel_mm": PIXEL, "distance_mm": self.distance},
            },
            targets=[
                {
                    "shape": {"kind": "plane", "width_mm": SIZE, "height_mm": SIZE},
                    "position_mm": TARGET,
                    "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
                }
            ],
            transport={"samples": 1024 * REPLICATES, "replicates": REPLICATES, "threads": 2} | transport,
        )


def drawn(number: int) -> Element:
    """Return a random element: flat behind, biconvex, or a meniscus, hollow before or behind."""
    draw = np.random.default_rng(number)
    steep, other = draw.uniform(8.5, 16.0), draw.uniform(12.0, 40.0)
    radii = [(steep, np.inf), (steep, -other), (steep, other), (-other, -steep)][number % 4]
    element = Element(radii, 0.0, draw.uniform(1.4, 2.0), draw.uniform(8.0, 25.0))
    # Rims stand off by 0.5 mm at least.
    apart = max(0.0, element.sag(0) - element.sag(1))
    clear = max(0.0, element.sag(1))
    return replace(element, thickness=apart + draw.uniform(0.5, 3.0), distance=element.distance + clear)


def crossings(element: Element, k: int, p: Array, d: Array, last: NDArray[np.int64]) -> Array:
    """Return the distance at which rays (n, 3) meet surface `k` or its mount, first; inf: not at all."""
    r, z = element.radii[k], element.vertices[k]
    if np.isinf(r):
        with np.errstate(divide="ignore", invalid="ignore"):
            roots = ((z - p[:, 2]) / d[:, 2])[:, None]
        roots = np.where((last == k)[:, None], np.inf, roots)
    else:
        o = p - [0.0, 0.0, z + r]
        b, c = (o * d).sum(1), (o * o).sum(1) - r * r
        with np.errstate(invalid="ignore"):
            root = np.sqrt(b * b - c)
        roots = np.column_stack([-b - root, -b + root])
    with np.errstate(invalid="ignore"):
        at = p[:, None] + roots[..., None] * d[:, None]
        within = np.hypot(at[..., 0], at[..., 1]) <= SEMI * (1.0 + OVERREACH)
        near_half = np.isinf(r) | ((at[..., 2] - z) / r < 1.0)
        good = (roots > 1e-9) & within & near_half & np.isfinite(roots)
    return np.where(good, roots, np.inf).min(1)


def fresnel(cosine: Array, n_i: Array, n_t: Array) -> tuple[Array, Array]:
    """Return reflectances, and cosines of refraction (0 under total reflection)."""
    sine2 = (n_i / n_t) ** 2 * (1.0 - cosine**2)
    c = np.sqrt(np.maximum(1.0 - sine2, 0.0))
    s = (n_i * cosine - n_t * c) / (n_i * cosine + n_t * c)
    p = (n_t * cosine - n_i * c) / (n_t * cosine + n_i * c)
    return np.where(sine2 >= 1.0, 1.0, 0.5 * (s * s + p * p)), c


def traced(element: Element, draw: np.random.Generator, blocks: NDArray[np.int64], starts: int) -> Array:
    """Return an estimate of the light of some squares of pixels by kind, (4, blocks, blocks), W."""
    half, side = 0.5 * PIXELS * PIXEL, BLOCK * PIXEL
    z_sensor = element.thickness + element.distance
    place = draw.choice(blocks, starts)
    corner = np.column_stack([place % (PIXELS // BLOCK), place // (PIXELS // BLOCK)]) * side - half
    start = np.column_stack([corner + draw.uniform(0.0, side, (starts, 2)), np.full(starts, z_sensor)])
    plane = element.thickness + max(0.0, element.sag(1))
    depth = max(0.0, -element.sag(1))
    radius = SEMI + depth * (1.5 * half + SEMI) / (z_sensor - plane)
    r, turn = radius * np.sqrt(draw.random(starts)), 2.0 * np.pi * draw.random(starts)
    d = np.column_stack([r * np.cos(turn), r * np.sin(turn), np.full(starts, plane)]) - start
    length = np.linalg.norm(d, axis=1)
    d /= length[:, None]
    weight = d[:, 2] ** 2 / length**2 * np.pi * radius**2 * len(blocks) * side**2 * 1e-6 / starts
    film = np.zeros((4, (PIXELS // BLOCK) ** 2))

    p, least = start, LIGHTEST * weight
    space, last = np.full(starts, 2), np.full(starts, -1)
    # Reflections, and whether a surface was met again straight after it.
    mirrors, again = np.zeros(starts, int), np.zeros(starts, bool)
    while len(p):
        t = np.stack([np.where(abs(space - k - 0.5) < 1.0, crossings(element, k, p, d, last), np.inf) for k in (0, 1)])
        k = np.argmin(t, axis=0)
        t = t[k, np.arange(len(p))]
        away = np.isinf(t) & (space == 0) & (d[:, 2] < 0.0)
        x, y = (p[away, i] + (TARGET[2] - p[away, 2]) / d[away, 2] * d[away, i] - TARGET[i] for i in (0, 1))
        seen = (abs(x) <= 0.5 * SIZE) & (abs(y) <= 0.5 * SIZE)
        kind = np.where(again[away] | (mirrors[away] == 1) | (mirrors[away] > 2), OTHER, mirrors[away] // 2)
        kind = np.where(again[away] & (mirrors[away] == 0), REFRACTED_AGAIN, kind)
        np.add.at(film, (kind[seen], place[away][seen]), weight[away][seen])
        # The mount, which a surface goes on in beyond its rim, absorbs.
        at = p + np.where(np.isinf(t), 0.0, t)[:, None] * d
        on = np.isfinite(t) & (np.hypot(at[:, 0], at[:, 1]) <= SEMI)
        p, d, k, space, weight, place, least, mirrors, again, last = (
            each[on] for each in (at, d, k, space, weight, place, least, mirrors, again, last)
        )
        again = again | (last == k)
        radii, vertices = np.array(element.radii)[k], np.array(element.vertices)[k]
        curved = np.isfinite(radii)
        along = np.where(curved, (p[:, 2] - vertices) / np.where(curved, radii, 1.0) - 1.0, -1.0)
        over = np.where(curved, 1.0 / np.where(curved, radii, 1.0), 0.0)
        normal = np.column_stack([p[:, 0] * over, p[:, 1] * over, along])
        cosine = (normal * d).sum(1)
        normal, cosine = normal * np.sign(cosine)[:, None], abs(cosine)
        beyond = np.where(space == k, k + 1, k)
        n_i, n_t = (np.where(s == 1, element.index, 1.0) for s in (space, beyond))
        reflectance, c = fresnel(cosine, n_i, n_t)
        back = d - 2.0 * cosine[:, None] * normal
        on_ = (n_i / n_t)[:, None] * d + (c - n_i / n_t * cosine)[:, None] * normal
        p, place, least, again, last = (np.concatenate([each, each]) for each in (p, place, least, again, k))
        d, space = np.concatenate([back, on_]), np.concatenate([space, beyond])
        weight = np.concatenate([weight * reflectance, weight * (1.0 - reflectance)])
        mirrors = np.concatenate([mirrors + 1, mirrors])
        kept = weight > least
        p, d, space, weight, place, least, mirrors, again, last = (
            each[kept] for each in (p, d, space, weight, place, least, mirrors, again, last)
        )
    return film.reshape(4, PIXELS // BLOCK, PIXELS // BLOCK)


def parts_by_class(world: Any) -> dict[int, Part]:
    return {part.options.paths: part for part in parts_of(world)}


def light_of(world: Any, parts: tuple[Part, ...], dark: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the power of parts on the dark blocks, W, and its variance."""
    renderer = Renderer(world, check=False)
    renderer.parts = parts
    image = renderer.image()
    pixels = np.repeat(np.repeat(dark, BLOCK, 0), BLOCK, 1)
    return float(image.mean[pixels].sum()), float(np.square(image.stderr[pixels]).sum())


STEEP = {
    "hollow behind": Element((8.5, 9.0), 4.0, 1.8, 15.0),
    "hollow before": Element((-12.0, -9.0), 3.0, 1.8, 10.0),
}
ELEMENTS = {f"drawn {number}": drawn(number) for number in (0, 1, 4, 7)} | STEEP


@pytest.mark.parametrize(
    "name", instances(ELEMENTS, long=["drawn 0", "drawn 1", "drawn 4", "drawn 7", "hollow behind"])
)
def test_dark_parts_of_the_image_have_the_light_of_all_paths_with_reflections(name: str) -> None:
    """The lens's ghosts and all other paths, each by a z-test; light on a steep hollow side counts among the others."""
    element = ELEMENTS[name]
    draw = np.random.default_rng([16, list(ELEMENTS).index(name)])
    survey = traced(element, draw, np.arange((PIXELS // BLOCK) ** 2), SURVEY)
    squares = np.flatnonzero(survey[IMAGE] + survey[REFRACTED_AGAIN] == 0.0)
    films = np.array([traced(element, draw, squares, STARTS * len(squares)) for _ in range(BATCHES)])
    dark = survey[IMAGE] + survey[REFRACTED_AGAIN] == 0.0
    dark &= films[:, IMAGE].sum(0) + films[:, REFRACTED_AGAIN].sum(0) == 0.0
    assert dark.sum() >= 4
    world = lf.build(element.scene(weight_cutoff=1e-3))
    parts = parts_by_class(world)
    for kind, paths in ((GHOST, GHOSTS), (OTHER, OTHER_STRAYS)):
        sums = films[:, kind][:, dark].sum(1)
        light, variance = light_of(world, (replace(parts[paths], thinned=8),), dark)
        variance += sums.var(ddof=1) / BATCHES
        assert np.sqrt(variance) < 0.05 * sums.mean()
        z = (light - sums.mean()) / np.sqrt(variance)
        assert 2.0 * stats.t.sf(abs(z), BATCHES - 1) > LEVEL / COMPARISONS
