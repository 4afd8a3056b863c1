"""Scattering models: what is drawn has the density that is told, and carries what the BRDF says.

Every model is put to the same tests. A new one is one line in MATERIALS.
"""

from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from lfmesh.kernels.decorators import kernel
from lfmesh.optics.fresnel import fresnel
from lfmesh.optics.gloss import MARGIN, gloss_parameters, interface_reflectance
from lfmesh.optics.gltf_material import SMALLEST_ALPHA, GltfMaterial, metal_of_reflectance
from lfmesh.optics.scattering import tangents
from lfmesh.scene.objects.targets import SMALLEST_ROUGHNESS, Gloss, Material
from lfmesh.transport.events.scattering import Point, albedo, density, evaluate, sample
from lfmesh.transport.tables.scattering import (
    GLOSSY,
    SCATTERING,
    THERMAL,
    ScatteringTables,
    mean_emission,
    scattering_tables,
)
from tests.instances import instances

Array = NDArray[np.float64]

MATERIALS = {
    "matt": Material(reflectance=0.7),
    "black": Material(reflectance=0.0),
    "lacquer": Material(reflectance=0.7, gloss=Gloss(index=1.5, roughness=0.2)),
    "smoothest": Material(reflectance=0.3, gloss=Gloss(index=1.5, roughness=SMALLEST_ROUGHNESS)),
    "rough and faint": Material(reflectance=0.9, gloss=Gloss(index=1.01, roughness=1.0)),
    "dense": Material(reflectance=0.5, gloss=Gloss(index=4.0, roughness=0.05)),
    "black lacquer": Material(reflectance=0.0, gloss=Gloss(index=1.5, roughness=0.5)),
    "aluminium": Material(gloss=Gloss(metal="Al", roughness=0.3)),
    "gold": Material(gloss=Gloss(metal="Au", roughness=1.0)),
}
FROM_FILES = {
    "glTF plastic": GltfMaterial((0.8, 0.3, 0.1), 0.0, 0.5),
    "glTF brass": GltfMaterial((0.9, 0.7, 0.3), 1.0, 0.4),
    "glTF mixture": GltfMaterial((0.2, 0.6, 0.9), 0.3, 0.8),
}
"""As mesh files bring them; and after them emission, which no scene states."""

NAMES = [*MATERIALS, *FROM_FILES, "emission"]
WAVE = 1
TEXEL = 0.6
NORMALS = [np.array([0.0, 0.0, 1.0]), np.array([0.48, -0.6, -0.64])]
STEEPNESS = [1.0, 0.5, 0.05]
"""Cosines of incidence."""

LEVEL = 1e-3
"""Chance that the chi-square tests of this file fail though all is right, shared by all of them (Bonferroni)."""

DRAWN = 20_000
PARTS = 6
"""Intervals to each side of the direction that a mirror would reflect into, which crowd there."""


@cache
def all_models() -> ScatteringTables:
    """Return the tables of all models, which take seconds to make: not while tests are collected."""
    return scattering_tables(list(MATERIALS.values()), (500.0, 600.0), from_files=list(FROM_FILES.values()))


def direction(normal: Array, cosine: float | Array, azimuth: float | Array) -> Array:
    """Return unit directions at an angle from the normal."""
    u, v = np.reshape(tangents(*normal), (2, 3))
    cosine, azimuth = np.broadcast_arrays(cosine, azimuth)
    sine = np.sqrt(1.0 - cosine**2)
    parts = (sine * np.cos(azimuth), sine * np.sin(azimuth), cosine)
    return np.asarray(sum(part[..., None] * axis for part, axis in zip(parts, (u, v, normal), strict=True)))


def point_of(name: str, normal: Array) -> Point:
    return Point(3, 1.0, 2.0, 3.0, *map(float, normal), NAMES.index(name), TEXEL)


MIRRORED = 0.7 + np.pi
"""Azimuth into which a mirror would reflect the light of `cases`."""


def cases() -> Iterator[tuple[Point, Array, Array]]:
    """Yield points of every model, their normals, and directions in which light arrives there."""
    for name in NAMES:
        for normal in NORMALS:
            for cosine in STEEPNESS:
                yield point_of(name, normal), normal, -direction(normal, cosine, 0.7)


@kernel
def tell(scattering: ScatteringTables, point: Point, ways: Array, way: Array, told: Array) -> None:
    """Write density and BRDF of directions (n, 3) into `told` (n, 2)."""
    for i in range(len(ways)):
        ox, oy, oz = ways[i]
        told[i, 0] = density(scattering, point, WAVE, (way[0], way[1], way[2]), (ox, oy, oz))
        told[i, 1] = evaluate(scattering, point, WAVE, (way[0], way[1], way[2]), (ox, oy, oz))


@kernel
def draw(scattering: ScatteringTables, point: Point, way: Array, numbers: Array, drawn: Array) -> None:
    """Write directions, and what each carries, into `drawn` (n, 4)."""
    for i in range(len(numbers)):
        u, v = numbers[i]
        drawn[i] = sample(scattering, point, WAVE, (way[0], way[1], way[2]), u, v)


def tell_all(tables: ScatteringTables, point: Point, ways: Array, way: Array, both: Array) -> None:
    """Call `tell` with tables of one wavelength."""
    tell(ScatteringTables(tables.models, np.repeat(tables.parameters, 2, axis=1)), point, ways, way, both)


def told(point: Point, way: Array, ways: Array) -> tuple[Array, Array]:
    both = np.empty((ways[..., 0].size, 2))
    tell(all_models(), point, np.ascontiguousarray(ways.reshape(-1, 3)), way, both)
    return both[:, 0].reshape(ways.shape[:-1]), both[:, 1].reshape(ways.shape[:-1])


def drawn(point: Point, way: Array, seed: int) -> tuple[Array, Array]:
    """Return DRAWN directions, and what each carries of what arrived."""
    rows = np.empty((DRAWN, 4))
    draw(all_models(), point, way, np.random.default_rng(seed).random((DRAWN, 2)), rows)
    return rows[:, :3], rows[:, 3]


def about_the_mirrored(normal: Array, way: Array, parts: int) -> tuple[Array, Array]:
    """Return edges in the cosine and in the azimuth from where a mirror would reflect, which crowd about it."""
    near = np.linspace(0.0, 1.0, parts + 1) ** 4
    cosine = -float(way @ normal)
    cosines = np.concatenate([(cosine * (1.0 - near))[::-1], cosine + (1.0 - cosine) * near[1:]])
    return np.unique(cosines), np.concatenate([-np.pi * near[:0:-1], np.pi * near])


def within(edges: Array, points: int) -> tuple[Array, Array]:
    """Return points and weights in every interval, (intervals, points)."""
    x, w = np.polynomial.legendre.leggauss(points)
    half = 0.5 * np.diff(edges)[:, None]
    return edges[:-1, None] + half * (x + 1.0), half * w


def over_the_side(normal: Array, way: Array, parts: int = 24, points: int = 8) -> tuple[Array, Array]:
    """Return directions all over the side of a normal, and their solid angles, by cell (a, b, points, points)."""
    cosines, azimuths = about_the_mirrored(normal, way, parts)
    (c, cw), (a, aw) = within(cosines, points), within(azimuths, points)
    mirrored = MIRRORED + a
    ways = direction(normal, c[:, None, :, None], mirrored[None, :, None, :])
    return ways, cw[:, None, :, None] * aw[None, :, None, :]


def test_the_density_of_directions_integrates_to_one() -> None:
    for point, normal, way in cases():
        ways, solid_angle = over_the_side(normal, way)
        assert (told(point, way, ways)[0] * solid_angle).sum() == pytest.approx(1.0, rel=1e-7), point


def test_nothing_is_drawn_on_the_other_side() -> None:
    for point, normal, way in cases():
        assert not told(point, way, -over_the_side(normal, way, 8, 2)[0])[0].any(), point
        assert (drawn(point, way, 1)[0] @ normal >= -1e-15).all(), point


def test_directions_that_are_drawn_have_their_density() -> None:
    """Chi-square tests over cells that crowd where a mirror would reflect; those of few directions count as one."""
    p = []
    for seed, (point, normal, way) in enumerate(cases()):
        cosines, azimuths = about_the_mirrored(normal, way, PARTS)
        ways, solid_angle = over_the_side(normal, way, PARTS, 24)
        expected = (told(point, way, ways)[0] * solid_angle).sum(axis=(2, 3)).ravel()
        ways = drawn(point, way, seed)[0]
        u, v = np.reshape(tangents(*normal), (2, 3))
        turn = np.angle(np.exp(1j * (np.arctan2(ways @ v, ways @ u) - MIRRORED)))
        row = np.clip(np.searchsorted(cosines, ways @ normal, side="right") - 1, 0, len(cosines) - 2)
        column = np.clip(np.searchsorted(azimuths, turn, side="right") - 1, 0, len(azimuths) - 2)
        counts = np.bincount(row * (len(azimuths) - 1) + column, minlength=len(expected))
        expected *= DRAWN / expected.sum()
        few = expected < 10.0
        counts = np.append(counts[~few], counts[few].sum())
        expected = np.append(expected[~few], expected[few].sum())
        if expected[-1] < 10.0:
            counts, expected = np.append(counts[:-2], counts[-2:].sum()), np.append(expected[:-2], expected[-2:].sum())
        p.append(stats.chisquare(counts, expected).pvalue)
    assert min(p) > LEVEL / len(p)


def test_a_direction_carries_brdf_and_cosine_over_its_density() -> None:
    for point, normal, way in cases():
        ways, carried = drawn(point, way, 2)
        chance, brdf = told(point, way, ways)
        # Along the surface a cosine is known to the rounding of its terms.
        off = np.abs(carried * chance - brdf * (ways @ normal))
        assert (off <= brdf * (1e-12 * (ways @ normal) + 4e-16)).all(), point


def test_the_albedo_is_the_share_of_light_that_all_directions_carry() -> None:
    """Within the error of the tables under gloss, and never above one."""
    for point, normal, way in cases():
        ways, solid_angle = over_the_side(normal, way)
        scattered = (told(point, way, ways)[1] * (ways @ normal) * solid_angle).sum()
        error = 2.0 * MARGIN if "gloss" in repr(MATERIALS.get(NAMES[point.model], "gloss")) else 0.0
        assert scattered == pytest.approx(albedo(all_models(), point, WAVE, *way), rel=1e-8, abs=max(error, 1e-300)), (
            point
        )
        assert scattered <= 1.0


WHITE = [Gloss(index=n, roughness=r) for n in (1.01, 1.5, 4.0) for r in (SMALLEST_ROUGHNESS, 0.1, 0.4, 1.0)]

HALF = [gloss for number, gloss in enumerate(WHITE) if (number // 4 + number) % 2]
"""Those left have all indices and all roughnesses."""


@pytest.mark.parametrize("gloss", instances(WHITE, long=HALF), ids=lambda g: f"n {g.index:g} roughness {g.roughness:g}")
def test_gloss_on_a_white_base_loses_and_gains_no_light(gloss: Gloss) -> None:
    """Total reflected share of light from any direction: one, less at most twice the margin, never more."""
    tables = scattering_tables([Material(reflectance=1.0, gloss=gloss)], (550.0,))
    normal = NORMALS[0]
    for cosine in (1.0, 0.8, 0.5, 0.2, 0.05, 0.01, 0.002):
        way = -direction(normal, cosine, 0.7)
        ways, solid_angle = over_the_side(normal, way, 24, 12)
        both = np.empty((ways[..., 0].size, 2))
        tell_all(tables, Point(0, 0.0, 0.0, 0.0, *map(float, normal), 0, 1.0), ways.reshape(-1, 3), way, both)
        total = (both[:, 1] * (ways.reshape(-1, 3) @ normal) * solid_angle.ravel()).sum()
        assert 1.0 - 2.0 * MARGIN < total <= 1.0, cosine


def test_metal_that_reflects_everything_scatters_everything() -> None:
    """An index of 1 + 10⁶ i, whose facets reflect 1 - 4e-12: what single facets lose, others catch."""
    for roughness in (SMALLEST_ROUGHNESS, 0.1, 0.4, 1.0):
        parameters = gloss_parameters(np.zeros(1), np.array([1.0 + 1e6j]), roughness)
        models = np.zeros(1, SCATTERING)
        models["kind"] = GLOSSY
        normal = NORMALS[0]
        for cosine in (1.0, 0.5, 0.1, 0.01):
            way = -direction(normal, cosine, 0.7)
            ways, solid_angle = over_the_side(normal, way, 24, 12)
            both = np.empty((ways[..., 0].size, 2))
            point = Point(0, 0.0, 0.0, 0.0, *map(float, normal), 0, 1.0)
            tell_all(ScatteringTables(models, parameters), point, ways.reshape(-1, 3), way, both)
            total = (both[:, 1] * (ways.reshape(-1, 3) @ normal) * solid_angle.ravel()).sum()
            assert 1.0 - 2.0 * MARGIN < total <= 1.0, (roughness, cosine)


def test_metal_of_a_gltf_file_reflects_its_base_colour_squarely() -> None:
    """And over the hemisphere what Schlick's approximation says, as glTF has it, where any metal does."""
    assert SMALLEST_ALPHA == SMALLEST_ROUGHNESS
    wanted = np.array([0.0, 0.04, 0.2, 0.5, 0.8, 0.95, 1.0])
    metal = metal_of_reflectance(wanted)
    np.testing.assert_allclose(abs((metal - 1.0) / (metal + 1.0)) ** 2, wanted, atol=2e-6)
    x, w = np.polynomial.legendre.leggauss(200)
    cosine = 0.5 * (x + 1.0)
    mean = interface_reflectance(metal.real[:, None], metal.imag[:, None], cosine) @ (w * cosine)
    difference = mean - (wanted + (1.0 - wanted) / 21.0)
    assert abs(difference[2:-1]).max() < 1e-4
    assert abs(difference).max() < 0.05


@pytest.mark.parametrize("metallic", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("roughness", [0.0, 0.5, 1.0])
def test_a_white_gltf_material_loses_and_gains_no_light(metallic: float, roughness: float) -> None:
    tables = scattering_tables([], (550.0,), from_files=[GltfMaterial((1.0, 1.0, 1.0), metallic, roughness)])
    normal = NORMALS[0]
    for cosine in (1.0, 0.5, 0.05):
        way = -direction(normal, cosine, 0.7)
        ways, solid_angle = over_the_side(normal, way, 24, 12)
        both = np.empty((ways[..., 0].size, 2))
        tell_all(tables, Point(0, 0.0, 0.0, 0.0, *map(float, normal), 0, 1.0), ways.reshape(-1, 3), way, both)
        total = (both[:, 1] * (ways.reshape(-1, 3) @ normal) * solid_angle.ravel()).sum()
        assert 1.0 - 2.0 * MARGIN - 1e-5 < total <= 1.0, cosine


def smooth_point(name: str, normal: Array, tilted: Array, to_light: bool) -> Point:
    """A point whose interpolated normal is not the facet's."""
    return point_of(name, normal)._replace(
        smooth=True, sx=float(tilted[0]), sy=float(tilted[1]), sz=float(tilted[2]), to_light=to_light
    )


@pytest.mark.parametrize("name", ["matt", "lacquer", "gold", "glTF mixture"])
def test_interpolated_normals_gain_no_light(name: str) -> None:
    """Uniform light, seen from any direction, is not brighter for them: at most as from a flat facet, up to Lambert's.

    Along the outline, too, something is seen. And the two methods evaluate the same number.
    """
    normal = NORMALS[0]
    for tilt in (0.1, 0.4, np.pi / 4):
        tilted = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
        toward, away = (smooth_point(name, normal, tilted, to_light) for to_light in (True, False))
        white = albedo(all_models(), point_of(name, normal)._replace(texel=1.0), WAVE, 0.0, 0.0, -1.0)
        for azimuth in (0.0, 1.5, np.pi):
            for cosine in (1.0, 0.5, 0.05):
                seen = direction(normal, cosine, azimuth)
                ways, solid_angle = over_the_side(normal, -seen, 8, 6)
                rows = ways.reshape(-1, 3)
                both = np.empty((len(rows), 2))
                tell_all(all_models(), toward, rows, -seen, both)
                total = (both[:, 1] * (rows @ normal) * solid_angle.ravel()).sum()
                assert total > 0.02 * white
                if name == "matt":
                    assert total <= 0.7 * TEXEL * 1.002
                assert total <= 1.0
                for row in rows[:: len(rows) // 7]:
                    there = evaluate(all_models(), toward, WAVE, tuple(-seen), tuple(row))
                    assert there == evaluate(all_models(), away, WAVE, tuple(-row), tuple(seen))


@pytest.mark.parametrize("name", ["matt", "lacquer", "glTF mixture"])
@pytest.mark.parametrize("to_light", [True, False])
def test_what_is_drawn_at_an_interpolated_normal_carries_the_brdf(name: str, to_light: bool) -> None:
    """BRDF · cos θ over the density, in the facet's own cosine."""
    normal, tilted = NORMALS[0], np.array([0.36, 0.0, np.sqrt(1.0 - 0.36**2)])
    point = smooth_point(name, normal, tilted, to_light)
    random = np.random.default_rng(5)
    carried = 0
    for u, v in random.random((200, 2)):
        way = tuple(-direction(normal, 0.3, random.random() * 6.0))
        *drawn, share = sample(all_models(), point, WAVE, way, u, v)
        out = tuple(drawn)
        cosine = float(normal @ out)
        if cosine > 0.0:
            there = (
                evaluate(all_models(), point, WAVE, way, out) * cosine / density(all_models(), point, WAVE, way, out)
            )
            assert share == pytest.approx(there, rel=1e-9, abs=1e-12)
            carried += share > 0.0
    assert carried > 50


@cache
def hot_models() -> ScatteringTables:
    """Return the tables of the materials at 900 K."""
    return scattering_tables(
        [each.model_copy(update={"temperature_k": 900.0}) for each in MATERIALS.values()], (500.0, 600.0)
    )


TILTS = (0.0, 0.1, 0.5)
"""Angles between the interpolated normal and the facet's, rad; 0: there is none."""


@pytest.mark.parametrize("name", list(MATERIALS))
def test_a_hot_surface_emits_what_it_does_not_scatter(name: str) -> None:
    """In every direction emissivity and albedo add up to 1: z-tests of means over directions of light.

    The albedo is the mean of what the BRDF's own samples carry. No sample of the emission is below 0.
    """
    hot = hot_models()
    row, emits = NAMES.index(name), int(hot.models["emission"][NAMES.index(name)])
    numbers = np.random.default_rng(7).random((2, 4000, 2))
    z = []
    for tilt in TILTS:
        tilted = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
        point = smooth_point(name, NORMALS[0], tilted, True)._replace(smooth=tilt > 0.0)
        for azimuth, cosine in ((0.0, 1.0), (0.5, 0.4), (np.pi, 0.1)):
            seen = direction(NORMALS[0], cosine, azimuth)
            rows = np.empty((len(numbers[0]), 4))
            draw(hot, point._replace(model=row), -seen, numbers[0], rows)
            emitted = np.array(
                [
                    np.pi * evaluate(hot, point._replace(model=emits, u=u, v=v), WAVE, (0.0, 0.0, 1.0), tuple(seen))
                    for u, v in (numbers[1] if tilt > 0.0 else numbers[1, :1])
                ]
            )
            assert emitted.min() >= 0.0
            spread = stats.sem(rows[:, 3]) + (stats.sem(emitted) if tilt > 0.0 else 0.0)
            off = abs(rows[:, 3].mean() + emitted.mean() - 1.0)
            z.append(max(off - 2.0 * MARGIN, 0.0) / spread if spread > 0.0 else 0.0 if off < 1e-12 else np.inf)
    assert max(z) < stats.norm.isf(LEVEL / 2.0 / len(z) / len(MATERIALS))


@pytest.mark.parametrize("name", list(MATERIALS))
def test_the_power_of_a_hot_surface_is_the_mean_of_its_emissivity(name: str) -> None:
    """Over the hemisphere, weighted by the cosine; and the table of light sources has the same."""
    model = NAMES.index(name)
    point = point_of(name, NORMALS[1])._replace(model=int(hot_models().models["emission"][model]))
    rows = np.empty((4096, 4))
    draw(hot_models(), point, -NORMALS[1], np.column_stack([(np.arange(4096) + 0.5) / 4096, np.full(4096, 0.3)]), rows)
    assert rows[:, 3].mean() == pytest.approx(albedo(hot_models(), point, WAVE, 0.0, 0.0, 1.0), abs=2e-5)
    alone, by_texture = mean_emission(hot_models(), model)
    assert albedo(hot_models(), point, WAVE, 0.0, 0.0, 1.0) == pytest.approx(
        alone[WAVE] + TEXEL * by_texture[WAVE], rel=1e-12
    )


def test_the_black_side_of_a_hot_sheet_is_a_black_body() -> None:
    tables = scattering_tables([Material(reflectance=0.7, temperature_k=900.0, sides="front"), Material()], (500.0,))
    behind = tables.models["behind"]
    assert list(behind[1:]) == list(range(1, len(behind)))
    assert tables.models["black"][behind[0]]
    there = tables.models["emission"][behind[0]]
    assert tables.models["kind"][there] == THERMAL
    point = Point(0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, int(there), TEXEL)
    assert evaluate(tables, point, 0, (0.0, 0.0, -1.0), (0.0, 0.6, 0.8)) == pytest.approx(1.0 / np.pi, rel=1e-15)


def test_the_smoothest_gloss_reflects_as_fresnel_says() -> None:
    """The albedo of lacquer over black, away from grazing, is the reflectance of a smooth surface."""
    tables = scattering_tables(
        [Material(reflectance=0.0, gloss=Gloss(index=1.5, roughness=SMALLEST_ROUGHNESS))], (1.0,)
    )
    for cosine in (1.0, 0.8, 0.5):
        point = Point(0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0, 1.0)
        found = albedo(tables, point, 0, *map(float, -direction(NORMALS[0], cosine, 0.7)))
        assert found == pytest.approx(fresnel(1.0, 1.5, cosine)[0], abs=2.0 * MARGIN + 1e-4)


def test_light_goes_either_way_alike() -> None:
    """Helmholtz reciprocity, by which adjoint and forward see the same target."""
    random = np.random.default_rng(3)
    for point, normal, _ in cases():
        one, other = direction(normal, random.random(2), 2.0 * np.pi * random.random(2))
        there = evaluate(all_models(), point, WAVE, tuple(-one), tuple(other))
        assert there == pytest.approx(evaluate(all_models(), point, WAVE, tuple(-other), tuple(one)), rel=1e-12), point


def test_a_matt_target_scatters_by_lamberts_law() -> None:
    """BRDF = albedo / π; its texture dims it."""
    normal = NORMALS[1]
    for name, reflectance in (("matt", 0.7), ("black", 0.0), ("emission", 1.0)):
        point = point_of(name, normal)
        for ways in (direction(normal, 0.9, 1.0), direction(normal, 0.1, 4.0)):
            brdf = evaluate(all_models(), point, WAVE, tuple(-ways), tuple(direction(normal, 0.3, 2.0)))
            assert brdf == pytest.approx(reflectance * TEXEL / np.pi, rel=1e-15)


def test_what_is_black_is_known_to_be() -> None:
    assert [name for name, black in zip(NAMES, all_models().models["black"], strict=True) if black] == ["black"]
