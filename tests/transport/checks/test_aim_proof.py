"""Rays from the stop tell what the aim misses: for cameras of all kinds nothing that matters; and if it does."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.accuracy.reported_error import crop
from lfmesh.assets import asset_path
from lfmesh.transport.aims.fitting import ALLOWED, shown_by
from lfmesh.transport.aims.pupil import viewpoints
from lfmesh.transport.aims.support import beyond_object_aim, beyond_sensor_aim
from lfmesh.transport.checks import aim_proof
from lfmesh.transport.checks.aim_proof import (
    CONFIDENCE,
    AimProof,
    Missed,
    proven,
)
from lfmesh.transport.checks.found import proofs
from lfmesh.transport.sequences import stop_rays
from lfmesh.transport.sequences.stop_rays import CameraTables, rays_from_stop, reach_of
from lfmesh.transport.tables.phase_faces import has_orders
from lfmesh.transport.tables.tables import AimTables, LensAim, LensletAim
from tests.instances import instances
from tests.renders import of_world
from tests.transport.conftest import TARGET

RandomCamera = Callable[[int], lf.Scene]


def missed(world: lf.World, aim: AimTables, seed: int = 99) -> tuple[float, float]:
    """Return the shares of the throughput outside an aim's two sides, by new rays."""
    random = np.random.default_rng(seed)
    tables = world.tables
    through = CameraTables(tables.lens, tables.mla, tables.sensor, tables.frames)
    reach = reach_of(through, random)
    assert reach is not None
    rays = rays_from_stop(through, reach, random)
    corners = world.targets[0].mesh.vertices
    seen = viewpoints(aim.entrance.opening.plane_z, aim.entrance.wide_radius, corners, to_sensor=True)
    found = beyond_sensor_aim(aim, through, rays), beyond_object_aim(aim, seen, None, rays, random)[0]
    return tuple(float(rays.throughput[of > 1.0].sum() / rays.throughput.sum()) for of in found)  # type: ignore[return-value]


@pytest.mark.parametrize("seed", instances(range(12), long=range(4, 12)))
def test_the_aim_of_a_random_camera_holds_all_light(seed: int, random_camera: RandomCamera) -> None:
    """By rays other than those to which it was fitted; a factor of two for their number."""
    world = lf.build(random_camera(seed))
    if has_orders(world.scene):
        assert world.aim_proof is None  # Rays go anywhere.
        return
    assert world.aim_proof is not None
    assert world.aim_proof.holds, world.aim_proof
    assert max(missed(world, world.aim)) <= 2.0 * ALLOWED


UNDECIDED = (24, 33, 55, 129, 139, 145, 179, 193, 243)
"""Cameras whose sensors, some micrometres across, too few rays from the stop meet to prove an aim by."""


@pytest.mark.long
@pytest.mark.parametrize("seed", sorted({*range(12, 300)} - {*UNDECIDED}))
def test_the_aim_of_many_random_cameras_holds_all_light(seed: int, random_camera: RandomCamera) -> None:
    world = lf.build(random_camera(seed))
    if has_orders(world.scene):
        assert world.aim_proof is None  # Rays go anywhere.
        return
    assert world.aim_proof is not None
    assert world.aim_proof.holds, world.aim_proof
    assert max(missed(world, world.aim)) <= 2.0 * ALLOWED


@pytest.mark.long
@pytest.mark.parametrize("seed", UNDECIDED)
def test_an_aim_that_too_few_rays_prove_is_warned_of(seed: int, random_camera: RandomCamera) -> None:
    world = lf.build(random_camera(seed))
    proof = world.aim_proof
    assert proof is None or (proof.missed == 0.0 and not proof.fallback)
    (warning,) = (each for each in proofs(world.scene, proof, None) if isinstance(each, lf.LightOutsideAimWarning))
    assert re.search("cannot rule out less|no ray from the stop", str(warning))


def with_opening(aim: LensAim, **changes: Any) -> LensAim:
    return aim._replace(opening=aim.opening._replace(far=aim.opening.far._replace(**changes)))


def with_lenslets(change: Callable[[LensletAim], dict[str, Any]]) -> Callable[[AimTables], AimTables]:
    return lambda aim: aim._replace(lenslets=aim.lenslets._replace(**change(aim.lenslets)))


NARROWER: dict[str, Callable[[AimTables], AimTables]] = {
    "lenslets' views": with_lenslets(lambda aim: {"slope_radius2": 0.8 * aim.slope_radius2}),
    "lenslets' faces": with_lenslets(lambda aim: {"cell_margin": -1e-3, "shown": np.zeros(2)}),
    "fewer cells": with_lenslets(
        lambda aim: {"slope_radius2": np.where(np.arange(64 * 64) % 500 == 7, -1.0, 1.0) * aim.slope_radius2}
    ),
    "the entrance pupil": lambda aim: aim._replace(
        entrance=with_opening(aim.entrance, radius=0.97 * aim.entrance.opening.far.radius)
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", NARROWER)
def test_rays_from_the_stop_find_what_a_narrower_aim_misses(name: str, emitting_plane: dict[str, Any]) -> None:
    world = lf.build(
        lf.load(asset_path("scenes/first_light.toml")).changed({"targets": [emitting_plane], "lights": []})
    )
    assert max(missed(world, world.aim)) <= ALLOWED
    assert max(missed(world, NARROWER[name](world.aim))) > 5.0 * ALLOWED


def test_rays_from_the_stop_find_what_a_narrower_pupil_misses_without_an_array(emitting_plane: dict[str, Any]) -> None:
    scene = lf.load(asset_path("scenes/conventional.toml")).changed({"targets": [emitting_plane], "lights": []})
    world = lf.build(scene)
    exit_ = with_opening(world.aim.exit, radius=0.97 * world.aim.exit.opening.far.radius)
    narrower = world.aim._replace(exit=exit_)
    assert missed(world, world.aim)[0] <= ALLOWED
    assert missed(world, narrower)[0] > 5.0 * ALLOWED


def test_lenslets_near_hemispheres_are_searched_among_few_cells() -> None:
    """Rays that leave a lenslet at grazing angles say nothing of what it shows: they would have all be searched."""
    mla = {"layout": "square", "count": [64, 64], "pitch_mm": 0.125, "radius_mm": 0.08930, "index": 1.5,
           "thickness_mm": 0.0938}  # fmt: skip
    scene = lf.load(asset_path("scenes/first_light.toml")).changed(
        {"camera.mla": mla, "camera.sensor.distance_mm": None, "camera.lens.stop_semi_diameter_mm": 10.0}
    )
    world = lf.build(scene)
    assert world.aim_proof is not None
    assert world.aim_proof.holds
    assert world.aim.lenslets.search <= 6.5


@pytest.mark.parametrize("side", ["exit", "entrance"])
def test_an_opening_that_is_taken_for_closed_is_opened_again(side: str, emitting_plane: dict[str, Any]) -> None:
    """As if the search for the pupil had found nothing: rays from the stop come through, and open it."""
    scene = lf.load(asset_path("scenes/conventional.toml")).changed({"targets": [emitting_plane], "lights": []})
    world = lf.build(scene)
    aim, tables = world.aim, world.tables
    at_lens = getattr(aim, side)
    closed = aim._replace(**{side: with_opening(at_lens, radius=np.full_like(at_lens.opening.far.radius, -1.0))})
    through = CameraTables(tables.lens, tables.mla, tables.sensor, tables.frames)
    seen = viewpoints(
        aim.entrance.opening.plane_z, aim.entrance.wide_radius, world.targets[0].mesh.vertices, to_sensor=True
    )
    mended, proof = proven(closed, through, seen)
    assert proof is not None
    assert proof.holds
    assert proof.fitted > 0
    assert max(missed(world, closed)) == pytest.approx(1.0)
    assert max(missed(world, mended)) <= ALLOWED


HOBBLED = {
    "narrow views": with_lenslets(lambda aim: {"slope_radius2": 0.01 * aim.slope_radius2}),
    "views that look aside": with_lenslets(lambda aim: {"slope": aim.slope + 0.1}),
    "narrow cells": with_lenslets(lambda aim: {"cell_margin": -0.02, "shown": np.zeros_like(aim.shown)}),
    "lenslets that show nothing": with_lenslets(
        lambda aim: {"slope_radius2": np.where(np.arange(64) % 3 == 0, -1.0, aim.slope_radius2)}
    ),
    "a search that ends at the nearest lenslet": with_lenslets(lambda aim: {"search": 0.5}),
}


def few_pixels(**changes: Any) -> lf.Scene:
    """Return a camera with 1.5 pixels a lenslet before an evenly shining plane."""
    return lf.load(asset_path("scenes/first_light.toml")).changed(
        {"camera.mla.count": (8, 8), "camera.sensor.pixels": (12, 12), "camera.sensor.pixel_mm": 0.125 / 1.5,
         "targets": [TARGET], "lights": [], "transport.split": "transmit", "transport.samples": 64,
         "transport.replicates": 2, "transport.threads": 1} | changes
    )  # fmt: skip


def proof_of(world: lf.World, aim: AimTables) -> tuple[AimTables, AimProof]:
    tables = world.tables
    seen = viewpoints(
        aim.entrance.opening.plane_z, aim.entrance.wide_radius, world.targets[0].mesh.vertices, to_sensor=True
    )
    mended, proof = proven(aim, CameraTables(tables.lens, tables.mla, tables.sensor, tables.frames), seen)
    assert proof is not None
    return mended, proof


@pytest.mark.parametrize("name", HOBBLED)
def test_an_aim_that_misses_light_for_any_cause_is_widened_until_it_holds(name: str) -> None:
    world = lf.build(few_pixels())
    hobbled = HOBBLED[name](world.aim)
    assert missed(world, hobbled)[0] > 5.0 * ALLOWED
    mended, proof = proof_of(world, hobbled)
    assert proof.holds
    assert proof.fitted > 0
    assert not proof.fallback
    assert missed(world, mended)[0] <= 2.0 * ALLOWED


def test_where_fitting_does_not_succeed_half_of_the_rays_go_anywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """The image then has its light by rays that are not aimed; 0.002 of them would hardly ever find any."""
    world = lf.build(few_pixels())
    truth = [image.mean.sum() for image in of_world(world, range(16))]
    monkeypatch.setattr(aim_proof, "ATTEMPTS", 1)
    world.aim, proof = proof_of(world, HOBBLED["narrow views"](world.aim))
    assert proof.fallback
    assert not proof.holds
    sums = np.array([image.mean.sum() for image in of_world(world, range(100, 116))])
    assert sums.std() < 0.3 * sums.mean()
    assert stats.ttest_ind(truth, sums, equal_var=False).pvalue > 1e-3


@pytest.mark.parametrize("side", ["exit", "entrance"])
def test_where_fitting_does_not_succeed_rays_go_all_over_the_lens(
    side: str, emitting_plane: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = lf.load(asset_path("scenes/conventional.toml")).changed({"targets": [emitting_plane], "lights": []})
    world = lf.build(scene)
    at_lens = getattr(world.aim, side)
    monkeypatch.setattr(aim_proof, "ATTEMPTS", 1)
    narrow = world.aim._replace(**{side: with_opening(at_lens, radius=0.5 * at_lens.opening.far.radius)})
    mended, proof = proof_of(world, narrow)
    assert proof.fallback
    assert getattr(mended, side).wide_share == 1.0
    assert max(missed(world, mended)) == 0.0


@pytest.mark.parametrize("expected", [0.5, 2.0, 10.0, 40.0])
def test_the_bounds_of_a_share_hold_the_truth_as_often_as_they_say(expected: float) -> None:
    """However few rays are outside; of equal weights, the rarest case of a bound that is missed has 5 %."""
    number = np.random.default_rng(5).poisson(expected, 4000)
    found = [Missed(n / 4e5, max(np.sqrt(n), 1.0) / 4e5) for n in number]
    above = sum(each.most < expected / 4e5 for each in found)
    below = sum(each.least > expected / 4e5 for each in found)
    for misses in (above, below):
        assert stats.binomtest(misses, len(found), 1.0 - CONFIDENCE, "greater").pvalue > 1e-3


def test_rays_are_drawn_until_they_tell_whether_the_share_is_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    """With four times too few rays in a round, none outside does not prove the share."""
    world = lf.build(few_pixels())
    monkeypatch.setattr(stop_rays, "BATCH", 1 << 14)
    monkeypatch.setattr(stop_rays, "BATCHES", 1)
    proof = proof_of(world, world.aim)[1]
    assert proof.holds
    assert proof.most <= ALLOWED
    monkeypatch.setattr(aim_proof, "ROUNDS", 1)
    proof = proof_of(world, world.aim)[1]
    assert proof.missed <= ALLOWED < proof.most
    assert not proof.holds
    assert not proof.fallback


def test_the_proof_sees_rays_where_they_meet_the_sensor_behind_its_cover() -> None:
    """A thick plate moves steep rays aside by more than the views' margin; flat to first order, it would not."""
    cover = {"thickness_mm": 0.3, "gap_mm": 0.02, "index": 1.5}
    world = lf.build(few_pixels(**{"camera.sensor.cover": cover, "camera.lens.stop_semi_diameter_mm": 8.3}))
    assert world.aim_proof is not None
    assert world.aim_proof.holds
    assert world.aim_proof.fitted > 0


def test_a_small_piece_of_a_sensor_far_off_the_axis_has_its_aim_proven() -> None:
    """Hardly any ray drawn about the axis lands on it."""
    whole = lf.load(asset_path("scenes/lytro_class.toml"))
    world = lf.build(crop(whole, 32, (-2.5, 1.5)))
    assert world.aim_proof is not None
    assert world.aim_proof.holds
    assert world.aim_proof.rays > 10_000
    # Micro-images touch: where the view of one lenslet ends, the opening is partly hidden, and the next one shows it.
    shown = world.aim.lenslets.shown
    assert shown[:40].min() > 0.8
    assert ((shown > 0.0) & (shown < 0.8)).any()
    assert shown[-2] == 0.0


@pytest.mark.parametrize("rays", [1, 30, 300, 30_000])
def test_no_part_of_a_view_is_dark_because_few_rays_met_it(rays: int) -> None:
    """Of an evenly lit view: up to the last ring that has a ray, every ring has its chance."""
    off = np.sqrt(np.random.default_rng(rays).random(rays))
    shown = shown_by(off, np.ones(rays))
    last = int(off.max() ** 2 * (len(shown) - 1))
    assert (shown[: last + 1] > 0.0).all()
    assert (np.diff(shown) <= 0.0).all()
    assert shown[-1] == 0.0


def test_rays_go_wherever_rays_have_met_light() -> None:
    """Light at the rim that they leave out, 5e-4 of all here, makes pixels of an even picture several times too bright.

    Margin rays alone would bring it, one of fifty rays with some fifty times the weight.
    """
    off = np.sqrt(np.random.default_rng(3).random(40_000) * 0.8)
    off[:20] = np.sqrt(0.9)
    shown = shown_by(off, np.ones(len(off)))
    rim = int(0.9 * (len(shown) - 1))
    assert (shown[: rim + 1] > 0.0).all()
    assert (shown[rim + 1 :] == 0.0).all()
    # And no more often than so little light is worth: by its root.
    assert shown[rim] < 0.3
