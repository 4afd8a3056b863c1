"""Points of emitting facets are drawn with the density that is told for them, and only where there is a need."""

from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
import trimesh
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.kernels.decorators import kernel
from lfmesh.transport import engine
from lfmesh.transport.lights.emitting_facets import density_at, emitting_point
from lfmesh.transport.lights.many_emitters import chance_of_leaf
from lfmesh.transport.lights.many_lamps import NO_NORMAL, Place
from lfmesh.transport.tables import emitting_facets
from lfmesh.transport.tables.emitting_facets import MOST_PIECES, emitter_table
from lfmesh.transport.tables.tables import ObjectTables

Array = NDArray[np.float64]

LEVEL = 1e-3
"""Chance that a test of random numbers fails though all is right."""

LENS = {"surfaces": [{"radius_mm": 20.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 5.0},
                     {"radius_mm": -20.0, "thickness_mm": 1.0, "semi_diameter_mm": 5.0},
                     {"stop": True, "semi_diameter_mm": 4.0}]}  # fmt: skip
CHART = str(asset_path("charts/chart.png"))
SHINING: list[dict[str, Any]] = [
    {"shape": {"kind": "sphere", "radius_mm": 3.0}, "position_mm": [8.0, 0.0, -55.0],
     "material": {"reflectance": 0.2, "radiance_w_m2_sr": 9.0}},
    {"shape": {"kind": "plane", "width_mm": 20.0, "height_mm": 10.0}, "position_mm": [-14.0, 0.0, -50.0],
     "rotation_deg": [0.0, 60.0, 0.0], "material": {"reflectance": 0.0, "radiance_w_m2_sr": 5.0, "texture": CHART}},
]  # fmt: skip
SCREEN: dict[str, Any] = {"shape": {"kind": "plane", "width_mm": 8.0, "height_mm": 8.0},
                          "position_mm": [0.0, 0.0, -60.0]}  # fmt: skip
LAMP = {"kind": "point", "position_mm": [30.0, 10.0, -20.0], "power_w": 1.0}


def scene(targets: list[dict[str, Any]], lights: list[dict[str, Any]], **transport: Any) -> lf.Scene:
    return lf.Scene(camera={"focus_mm": 60.0, "lens": LENS, "sensor": {"pixels": [6, 5], "pixel_mm": 0.5}},
                    targets=targets, lights=lights, transport={"samples": 64, "replicates": 2} | transport)  # fmt: skip


@pytest.fixture
def objects(monkeypatch: pytest.MonkeyPatch) -> ObjectTables:
    """Sheets of a few facets, in a tree all the same."""
    monkeypatch.setattr(emitting_facets, "FEW", 1)
    return lf.build(scene([SCREEN, *SHINING], [])).tables.objects


@kernel
def fill_chances(objects: ObjectTables, place: Any, normal: Any, chances: Array) -> None:
    """Write the chance of the leaf of each piece."""
    for piece in range(len(chances)):
        chances[piece] = chance_of_leaf(objects.emitters, 0, place, normal, piece)


@kernel
def drawn(objects: ObjectTables, place: Any, normal: Any, numbers: Array, found: Array) -> None:
    """Write the facet and the density of points, as drawn for a place and as told for them."""
    for i in range(len(numbers)):
        prim, x, y, z, density = emitting_point(objects, place, normal, numbers[i, 0], numbers[i, 1], None, 0)
        found[i, 0], found[i, 1] = prim, density
        found[i, 2] = density_at(objects, place, normal, prim, (x, y, z), None, 0) if prim >= 0 else 0.0
        found[i, 3], found[i, 4], found[i, 5] = x, y, z


PLACES: list[tuple[Place, Place]] = [
    ((0.0, 0.0, -60.0), (0.0, 0.0, 1.0)),
    ((4.5, 1.0, -54.0), NO_NORMAL),
    ((-10.0, 2.0, -50.0), (0.6, 0.0, 0.8)),
    ((1e5 * np.sin(np.pi / 3.0), 0.0, 1e5 * np.cos(np.pi / 3.0)), NO_NORMAL),
]
"""Points and their normals: of the screen, close to the sphere and to the sheet, and far away, square to the sheet."""


@pytest.mark.parametrize("place", range(len(PLACES)))
def test_the_density_of_a_place_is_that_with_which_it_is_drawn(objects: ObjectTables, place: int) -> None:
    found = np.empty((100_000, 6))
    drawn(objects, *PLACES[place], np.random.default_rng(1).random((len(found), 2)), found)
    assert (found[:, 0] >= 0.0).all()
    # On the edge between two pieces, rounding may take either.
    same = np.isclose(found[:, 1], found[:, 2], rtol=1e-9)
    assert same.mean() > 0.9999
    # The mean of 1 / density is the area that is drawn from; pieces that are black, or bring no light, are left out.
    emitters, chances = objects.emitters, np.empty(len(objects.emitters.facet))
    fill_chances(objects, *PLACES[place], chances)
    begins = emitters.nodes["begin"][emitters.nodes["right"] == 0]
    assert chances[begins].sum() == pytest.approx(1.0, rel=1e-12)
    shares = np.diff(emitters.until, prepend=0.0)
    shares[begins] = emitters.until[begins]
    given = (shares > 0.0) & (chances > 0.0)
    area = (shares[given] / emitters.density[given]).sum()
    assert stats.ttest_1samp(1.0 / found[:, 1], area).pvalue > LEVEL / len(PLACES)
    assert area < 4.0 * np.pi * 9.0 + 200.0


def test_facets_far_away_are_drawn_by_power_and_evenly(objects: ObjectTables) -> None:
    """Chi-square over the octants of the sphere, and over the sheet."""
    found = np.empty((100_000, 6))
    drawn(objects, *PLACES[3], np.random.default_rng(2).random((len(found), 2)), found)
    body = objects.facets["body"][found[:, 0].astype(np.int64)]
    own = found[body == 1, 3:]
    assert len(own) == (body == 1).sum()
    (middle,) = objects.rounds.faces["centre"]
    octant = ((own - middle) > 0.0) @ [1, 2, 4]
    assert stats.chisquare(np.bincount(octant, minlength=8)).pvalue > LEVEL
    # A sheet shines on both sides; its texture's mean is a part of its power.
    picture = objects.texels[objects.texture[2, 0] :, 0].mean()
    power = np.array([9.0 * 4.0 * np.pi * 9.0, 5.0 * 2.0 * 200.0 * picture])
    assert (body == 1).mean() == pytest.approx(power[0] / power.sum(), rel=0.02)


def glowing(place: list[float], radiance: float, **body: Any) -> dict[str, Any]:
    return {"position_mm": place, "material": {"reflectance": 0.0, "radiance_w_m2_sr": radiance}} | body


@pytest.fixture(scope="module")
def crowd(tmp_path_factory: pytest.TempPathFactory) -> ObjectTables:
    """A bright mesh far away, one near by whose power is a hundred-millionth of that, and a sheet of facets."""
    folder = tmp_path_factory.mktemp("meshes")
    trimesh.creation.icosphere(subdivisions=4, radius=1.0).export(folder / "ball.ply")
    trimesh.creation.box((8.0, 8.0, 1e-3)).subdivide_to_size(0.5).export(folder / "slab.ply")
    ball, slab = ({"file": str(folder / name), "units": "mm"} for name in ("ball.ply", "slab.ply"))
    return lf.build(scene([
        SCREEN,
        glowing([0.0, 0.0, 2000.0], 1.0, scale=400.0, **ball),
        glowing([1.0, 1.0, -59.0], 0.1, scale=0.2, **ball),
        glowing([-6.0, 0.0, -57.0], 1e-3, **slab),
    ], []), aimed=False).tables.objects  # fmt: skip


def points_of(objects: ObjectTables) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Return middles, areas, normals of all emitting pieces, plain facets, and whether they shine on both sides."""
    facets = objects.facets[objects.emitters.facet]
    edges = facets["corners"][:, 1:] - facets["corners"][:, :1]
    areas = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    return facets["corners"].mean(axis=1), areas, facets["normal"], ~objects.one_sided[facets["body"]]


def brought(objects: ObjectTables, place: Place, normal: Place) -> Array:
    """Return what each piece brings to a point if nothing is between, as if it were small."""
    middles, areas, normals, both = points_of(objects)
    to = middles - place
    d2 = (to**2).sum(axis=1)
    along = -np.einsum("ij,ij->i", normals, to) / np.sqrt(d2)
    cosine = to @ normal / np.sqrt(d2) if any(normal) else np.ones(len(to))
    radiance = objects.radiance[objects.facets["body"][objects.emitters.facet], 0]
    return np.asarray(radiance * areas * np.where(both, abs(along), along).clip(0.0) * cosine.clip(0.0) / d2)


NEAR_CROWD: list[tuple[Place, Place]] = [
    ((0.0, 0.0, -60.0), (0.0, 0.0, 1.0)),
    ((1.05, 1.0, -59.3), (0.0, 0.0, 1.0)),
    ((-3.0, 2.0, -57.5), (-0.6, 0.0, 0.8)),
    ((3.0, -2.0, -58.0), NO_NORMAL),
]


def test_no_piece_that_lights_a_point_is_without_a_chance(crowd: ObjectTables) -> None:
    chances = np.empty(len(crowd.emitters.facet))
    for place, normal in NEAR_CROWD:
        fill_chances(crowd, place, normal, chances)
        light = brought(crowd, place, normal)
        assert (chances[light > 0.0] > 0.0).all()
        # The bounds leave out some of what faces away.
        assert (chances[light == 0.0] == 0.0).mean() > 0.3


def test_pieces_are_drawn_about_by_the_light_that_they_bring(crowd: ObjectTables) -> None:
    """The second moment of the light of one draw, over its squared mean, is a small number, and less than by power."""
    emitters, chances = crowd.emitters, np.empty(len(crowd.emitters.facet))
    areas = points_of(crowd)[1]
    power = areas * crowd.radiance[crowd.facets["body"][emitters.facet], 0]
    for place, normal in NEAR_CROWD:
        fill_chances(crowd, place, normal, chances)
        light, drawn_with = brought(crowd, place, normal), chances * emitters.density * areas
        # Some draws end where the bounds of both parts of a node show that no light comes.
        assert 0.5 < drawn_with.sum() < 1.0 + 1e-9
        own = light > 0.0
        squared = (light[own] ** 2 / drawn_with[own]).sum() / light.sum() ** 2
        by_power = (light[own] ** 2 / power[own]).sum() * power.sum() / light.sum() ** 2
        assert squared < min(5.0, by_power)


def test_a_node_of_the_tree_bounds_its_pieces_and_has_their_power(crowd: ObjectTables) -> None:
    nodes, corners = crowd.emitters.nodes, crowd.facets["corners"][crowd.emitters.facet]
    normals, both = points_of(crowd)[2:]
    for number in range(0, len(nodes), 7):
        node = nodes[number]
        own = slice(node["begin"], node["end"])
        assert np.linalg.norm(corners[own] - node["middle"], axis=2).max() <= node["radius"]
        cosine = normals[own] @ node["axis"]
        assert (np.where(node["both"], abs(cosine), cosine) >= node["cos_spread"]).all()
        assert node["both"] == both[own].any()
    assert nodes[0]["power"] == pytest.approx(1.0, rel=1e-12)
    assert (nodes["begin"][0], nodes["end"][0]) == (0, len(corners))


def test_a_facet_without_area_and_a_black_one_are_never_drawn(objects: ObjectTables) -> None:
    facets = objects.facets.copy()
    thin = np.flatnonzero(facets["body"] == 2)[:1]
    facets["corners"][thin, 2] = facets["corners"][thin, 1]
    emitters = emitter_table(objects._replace(facets=facets))
    assert (emitters.first[thin] == -1).all()
    assert not np.isin(emitters.facet, thin).any()
    assert np.isfinite(emitters.density).all()
    assert emitters.nodes["power"][0] == pytest.approx(1.0, abs=1e-12)
    assert (emitters.first[facets["body"] == 0] == -1).all()


def test_few_pieces_are_drawn_by_power_alone() -> None:
    """As always, whatever the point: so scenes with few emitting facets have the pictures that they had."""
    plane = {"kind": "plane", "width_mm": 4.0, "height_mm": 4.0}
    few = lf.build(scene([SCREEN, *(glowing([x, 0.0, -50.0], 1.0 + x, shape=plane) for x in (0.0, 5.0, 10.0))], []),
                   aimed=False).tables.objects  # fmt: skip
    numbers = np.random.default_rng(3).random((1000, 2))
    found = np.empty((2, len(numbers), 6))
    for number, (place, normal) in enumerate(PLACES[:2]):
        drawn(few, place, normal, numbers, found[number])
    np.testing.assert_array_equal(found[0], found[1])
    assert len(few.emitters.nodes) == 0


@pytest.mark.parametrize("few", [8, 1], ids=["few", "in a tree"])
def test_facets_between_two_texels_are_drawn_by_their_light(
    few: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the middle of a black texel to that of a white one, light grows evenly along a sheet of eight facets."""
    monkeypatch.setattr(emitting_facets, "FEW", few)
    x, y = (each.ravel() for each in np.meshgrid([0.0, 1.0, 2.0], [0.0, 1.0, 2.0], indexing="ij"))
    corners = np.array([[i, i + 3, i + 4] for i in (0, 1, 3, 4)] + [[i, i + 4, i + 1] for i in (0, 1, 3, 4)])
    lines = [f"v {a} {b} 0\nvt {0.25 + 0.25 * a} {0.5 * b}" for a, b in zip(x, y, strict=True)]
    lines += ["f " + " ".join(f"{k}/{k}" for k in face) for face in (corners + 1).tolist()]
    (tmp_path / "sheet.obj").write_text("\n".join(lines))
    PIL.Image.fromarray(np.array([[0, 255]], np.uint8)).save(tmp_path / "step.png")
    glow = {"reflectance": 0.0, "radiance_w_m2_sr": 1.0, "texture": str(tmp_path / "step.png")}
    sheet = {"file": str(tmp_path / "sheet.obj"), "units": "mm", "position_mm": [0.0, 0.0, -60.0], "material": glow}
    tables = lf.build(scene([sheet], [LAMP]), aimed=False).tables.objects
    emitters, whole = tables.emitters, np.ones(8)
    leaves = emitters.nodes[emitters.nodes["right"] == 0]
    if len(leaves):
        whole = np.repeat(leaves["power"], leaves["end"] - leaves["begin"])
    corners = tables.facets["corners"][emitters.facet, :, 0]
    light = corners.mean(axis=1) - corners.min()
    np.testing.assert_allclose(0.5 * emitters.density * whole, light / light.sum(), rtol=1e-6)


def test_a_large_texture_keeps_to_the_limit_of_pieces(objects: ObjectTables) -> None:
    assert objects.emitters.level.max() > 2
    assert (4 ** objects.emitters.level[np.unique(objects.emitters.facet)]).sum() <= MOST_PIECES


def test_nothing_is_asked_where_no_target_emits_or_none_scatters(monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel of the station is not even compiled there."""

    def refuse(*_: Any) -> None:
        raise AssertionError("lights were asked")

    monkeypatch.setattr(engine, "ask_lights", refuse)
    black = SHINING[1] | {"material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}
    for targets, lights in (([SCREEN, SCREEN | {"position_mm": [9.0, 0.0, -50.0]}], [LAMP]), ([black], [LAMP])):
        lf.render(scene(targets, lights))
    with pytest.raises(AssertionError, match="lights were asked"):
        lf.render(scene([SCREEN, *SHINING], []))


@pytest.mark.parametrize("split", ["transmit", "both"])
def test_energy_closes_and_the_image_is_the_same_for_any_number_of_threads(split: str) -> None:
    given = scene([SCREEN, *SHINING], [LAMP], split=split, samples=512, seed=3)
    one, three = (lf.render(given.changed({"transport.threads": threads})) for threads in (1, 3))
    np.testing.assert_array_equal(one.mean, three.mean)
    np.testing.assert_array_equal(one.stderr, three.stderr)
    assert abs(one.ledger.imbalance) < 1e-12
    assert one.ledger.lost_share < 1e-7


def test_paths_are_cut_at_the_same_depth_either_way() -> None:
    """With no event left after the screen, neither packet brings the emitters' light."""
    given = scene([SCREEN, *SHINING], [], split="transmit", engine="mesh")
    # The lens has two surfaces; the screen is the third event, an emitter would be the fourth.
    images = [lf.render(given.changed({"transport.max_events": events})) for events in (3, 4)]
    dark = lf.render(
        scene([SCREEN | {"material": {"reflectance": 0.0}}, *SHINING], [], split="transmit", engine="mesh")
    )
    np.testing.assert_array_equal(images[0].mean, dark.mean)
    assert images[1].mean.sum() > images[0].mean.sum()
