"""Points of emitting facets are drawn with the density that is told for them, and only where there is a need."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.kernels.decorators import kernel
from lfmesh.transport import engine
from lfmesh.transport.lights.emitting_facets import density_at, emitting_point
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


@pytest.fixture(scope="module")
def objects() -> ObjectTables:
    return lf.build(scene([SCREEN, *SHINING], [])).tables.objects


@kernel
def drawn(objects: ObjectTables, numbers: Array, found: Array) -> None:
    """Write the facet and the density of points, as drawn and as told for the place."""
    for i in range(len(numbers)):
        prim, x, y, z, density = emitting_point(objects, numbers[i, 0], numbers[i, 1])
        found[i, 0], found[i, 1] = prim, density
        found[i, 2] = density_at(objects, prim, x, y, z)
        found[i, 3], found[i, 4], found[i, 5] = x, y, z


def test_the_density_of_a_place_is_that_with_which_it_is_drawn(objects: ObjectTables) -> None:
    found = np.empty((200_000, 6))
    drawn(objects, np.random.default_rng(1).random((len(found), 2)), found)
    # On the edge between two pieces, rounding may take either.
    same = found[:, 1] == found[:, 2]
    assert same.mean() > 0.9999
    # The mean of 1 / density is the area that is drawn from; pieces on which the texture is black are left out.
    emitters = objects.emitters
    shares = np.diff(emitters.until, prepend=0.0)
    area = (shares[shares > 0.0] / emitters.density[shares > 0.0]).sum()
    assert stats.ttest_1samp(1.0 / found[:, 1], area).pvalue > LEVEL
    assert 0.5 * (4.0 * np.pi * 9.0 + 200.0) < area < 4.0 * np.pi * 9.0 + 200.0


def test_facets_are_drawn_by_power_and_evenly(objects: ObjectTables) -> None:
    """Chi-square over the octants of the sphere, and over the sheet."""
    found = np.empty((100_000, 6))
    drawn(objects, np.random.default_rng(2).random((len(found), 2)), found)
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


def test_a_facet_without_area_and_a_black_one_are_never_drawn(objects: ObjectTables) -> None:
    facets = objects.facets.copy()
    thin = np.flatnonzero(facets["body"] == 2)[:1]
    facets["corners"][thin, 2] = facets["corners"][thin, 1]
    emitters = emitter_table(objects._replace(facets=facets))
    assert (emitters.first[thin] == -1).all()
    assert not np.isin(emitters.facet, thin).any()
    assert np.isfinite(emitters.density).all()
    assert emitters.until[-1] == pytest.approx(1.0, abs=1e-12)
    assert (emitters.first[facets["body"] == 0] == -1).all()


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
