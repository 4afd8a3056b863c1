"""Balls and cylinders of glass as rays meet them: Snell and Fresnel by hand, and the laws of light in any glass."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.optics.fresnel import fresnel
from tests.cameras import camera_without_array
from tests.renders import by_seed, unchecked
from tests.validation.test_furnace import furnace

Array = NDArray[np.float64]

LEVEL = 1e-3
"""Chance that a statistical test fails though the law holds."""

PLACE = np.array([3.0, -2.0, -300.0])
RADIUS, GLASS = 5.0, 1.5168
BALL = {"kind": "sphere", "radius_mm": RADIUS}
ROD = {"kind": "cylinder", "radius_mm": RADIUS, "height_mm": 30.0}
TOWARDS = np.array([0.0, 0.0, -1.0])


def glass(shape: dict[str, Any], index: float = GLASS, at: Any = PLACE, **keys: Any) -> dict[str, Any]:
    turn = {"rotation_deg": keys.pop("turned", (0.0, 0.0, 0.0))}
    return {"refractor": {"shape": shape, "index": index} | keys, "position_mm": tuple(map(float, at))} | turn


def world_of(*targets: dict[str, Any], **settings: Any) -> lf.World:
    return lf.build(lf.Scene(camera=camera_without_array(), targets=targets, transport=settings), aimed=False)


def sent(world: lf.World, starts: Array, ways: Array, split: str = "transmit") -> lf.Paths:
    return lf.trace(world, starts, ways, split=split, threads=1)


def parallel(heights: Array) -> tuple[Array, Array]:
    """Rays towards −z at heights along x from the axis of the body."""
    starts = PLACE + np.stack([heights, 0.0 * heights, np.full(len(heights), 40.0)], axis=1)
    return starts, np.broadcast_to(TOWARDS, starts.shape).copy()


def through_circle(heights: Array, index: float) -> tuple[Array, Array, Array]:
    """Points of exit (x, z) from the centre, directions (x, z) and power of parallel rays through a circle of glass."""
    before = np.arcsin(heights / RADIUS)
    within = np.arcsin(np.sin(before) / index)
    # The ray comes in at the angle `before` from +z; the chord spans π − 2 `within`.
    out, turn = before + np.pi - 2.0 * within, 2.0 * (before - within)
    cosines = zip(np.cos(before), np.cos(within), strict=True)
    power = np.array([fresnel(1.0, index, c)[1] * fresnel(index, 1.0, d)[1] for c, d in cosines])
    return (
        RADIUS * np.stack([np.sin(out), np.cos(out)], axis=1),
        np.stack([-np.sin(turn), -np.cos(turn)], axis=1),
        power,
    )


@pytest.mark.parametrize("index", [1.02, GLASS, 2.4])
@pytest.mark.parametrize("shape", [BALL, ROD], ids=["ball", "rod"])
def test_marginal_rays_follow_snells_law_to_a_billionth_of_a_millimetre(shape: dict[str, Any], index: float) -> None:
    """Up to a ten-thousandth of the radius from the outline, and by Fresnel's equations in power."""
    heights = np.concatenate([np.linspace(-0.9999, 0.9999, 400), [1e-6, 0.3, -1e-9]]) * RADIUS
    world = world_of(glass(shape, index, turned=(90.0, 0.0, 0.0)))
    paths = sent(world, *parallel(heights))
    assert (paths.status == lf.Status.ESCAPED).all()
    np.testing.assert_array_equal(paths.source, np.arange(len(heights)))
    place, way, power = through_circle(heights, index)
    found = paths.position - PLACE
    assert np.abs(found[:, [0, 2]] - place).max() < 1e-9
    assert np.abs(paths.direction[:, [0, 2]] - way).max() < 1e-11
    assert np.abs(found[:, 1]).max() < 1e-12
    np.testing.assert_allclose(paths.weight, power, rtol=1e-9)
    assert (paths.events == 2).all()


def test_a_ball_lens_has_its_paraxial_focus_and_its_spherical_aberration() -> None:
    """From the centre, n R / (2 (n − 1)); rays at a height h cross the axis at h / sin 2 (i − r)."""
    heights = np.concatenate([[1e-4], np.linspace(0.05, 0.95, 19)]) * RADIUS
    paths = sent(world_of(glass(BALL)), *parallel(heights))
    found = paths.position - PLACE
    crossing = -(found[:, 2] - found[:, 0] * paths.direction[:, 2] / paths.direction[:, 0])
    assert crossing[0] == pytest.approx(GLASS * RADIUS / (2.0 * (GLASS - 1.0)), rel=1e-7)
    i = np.arcsin(heights / RADIUS)
    r = np.arcsin(np.sin(i) / GLASS)
    np.testing.assert_allclose(crossing, heights / np.sin(2.0 * (i - r)), rtol=1e-9)
    assert (np.diff(crossing) < 0.0).all()


def test_the_area_of_a_balls_outline_is_right_to_a_millionth() -> None:
    """A ray beside the ball goes straight on; one that grazes it is reflected, nearly whole, and turns a little."""
    turn = 2.0 * np.pi * np.arange(720) / 720
    ring = RADIUS * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    world = world_of(glass(BALL))
    for share, meets in ((-2.5e-7, True), (2.5e-7, False)):
        starts = PLACE + (1.0 + share) * ring - 40.0 * TOWARDS
        paths = sent(world, starts, np.broadcast_to(TOWARDS, starts.shape).copy())
        assert len(paths) == len(turn)
        assert (paths.events == (2 if meets else 0)).all()


def crossed(centres: Array, radii: Array, indices: Array, start: Array, way: Array) -> tuple[Array, Array, float]:
    """Trace a ray through balls, of which the last counts where several are; return where it leaves, and power."""
    power, p, d = 1.0, start, way
    for _ in range(100):
        a = p - centres
        b, c = a @ d, (a * a).sum(axis=1) - radii**2
        room = b * b - c
        roots = np.sort(np.concatenate([(-b + s * np.sqrt(np.where(room > 0.0, room, np.nan))) for s in (-1.0, 1.0)]))
        roots = roots[roots > 1e-9]

        def medium(t: float, p: Array = p, d: Array = d) -> float:
            inside = np.flatnonzero(((p + t * d - centres) ** 2).sum(axis=1) < radii**2)
            return float(indices[inside[-1]]) if len(inside) else 1.0

        ends = np.concatenate([[0.0], roots])
        media = [medium(0.5 * (s + t)) for s, t in pairwise(ends)] + [1.0]
        change = next((k for k in range(len(roots)) if media[k] != media[k + 1]), None)
        if change is None:
            return p, d, power
        p = p + roots[change] * d
        one, other = media[change], media[change + 1]
        off = np.abs(((p - centres) ** 2).sum(axis=1) - radii**2)
        n = (p - centres[off.argmin()]) / radii[off.argmin()]
        cosine = float(n @ d)
        n = n if cosine > 0.0 else -n
        _, transmittance, cos_t = fresnel(one, other, abs(cosine))
        if transmittance == 0.0:
            d = d - 2.0 * abs(cosine) * n
        else:
            power *= transmittance
            d = one / other * d + (cos_t - one / other * abs(cosine)) * n
    raise AssertionError("a ray goes round for ever")


def test_balls_that_cut_hold_and_touch_each_other_pass_light_as_by_hand() -> None:
    """A ball cut by another of a higher priority, one wholly inside, a bubble, and one that touches in a point."""
    centres = PLACE + np.array([[0, 0, 0], [4.0, 0, 1.0], [-1.5, 0.5, 0.3], [1.0, -2.0, -1.0], [0, 10.0, 0]])
    radii, indices = np.array([5.0, 4.0, 2.0, 0.8, 5.0]), np.array([1.5, 1.7, 1.33, 1.0, 1.6])
    balls = [
        glass({"kind": "sphere", "radius_mm": float(r)}, float(n), at=c, priority=k)
        for k, (c, r, n) in enumerate(zip(centres, radii, indices, strict=True))
    ]
    draw = np.random.default_rng(4)
    starts = draw.normal(size=(400, 3))
    starts = PLACE + 60.0 * starts / np.linalg.norm(starts, axis=1, keepdims=True)
    ways = PLACE + draw.uniform(-6.0, 6.0, (400, 3)) + [0.0, 2.0, 0.0] - starts
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    paths = sent(world_of(*balls), starts, ways)
    assert not any(paths.ledger.lost.values())
    assert abs(paths.ledger.imbalance) < 1e-12
    # A path of many reflections makes much of rounding.
    few = (paths.status == lf.Status.ESCAPED) & (paths.events <= 12)
    assert few.sum() > 350
    by_hand = [crossed(centres, radii, indices, starts[k], ways[k]) for k in paths.source[few]]
    truth = [np.array(column) for column in zip(*by_hand, strict=True)]
    assert np.abs(paths.direction[few] - truth[1]).max() < 1e-8
    np.testing.assert_allclose(paths.weight[few], truth[2], rtol=1e-7)


@pytest.mark.parametrize("shape", [BALL, ROD], ids=["ball", "rod"])
@pytest.mark.parametrize("index", [1.0, 1.2, GLASS, 2.0])
def test_all_energy_comes_out_of_round_glass_in_a_tanks_liquid(shape: dict[str, Any], index: float) -> None:
    """Both children followed, with total reflection, from outside and from within; the rod leaves by its ends, too."""
    tank = {"size_mm": [60.0, 60.0, 60.0], "wall_mm": 3.0, "position_mm": PLACE.tolist(),
            "wall": {"index": 1.52}, "liquid": {"index": 1.333}}  # fmt: skip
    body = glass(shape, index, turned=(30.0, 40.0, 0.0))
    world = lf.build(lf.Scene(camera=camera_without_array(), targets=[body], tanks=[tank]), aimed=False)
    draw = np.random.default_rng(6)
    ways = draw.normal(size=(2_000, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    reach = np.where(np.arange(2_000) % 2, 3.0, 25.0)[:, None] / np.sqrt(3.0)
    starts = PLACE + reach * draw.uniform(-1.0, 1.0, (2_000, 3))
    paths = sent(world, starts, ways, "both")
    assert abs(paths.ledger.imbalance) < 1e-12
    # Rays that meet an edge of the tank within rounding may be lost.
    assert sum(paths.ledger.lost.values()) <= 1e-6 * paths.ledger.emitted


def test_a_ball_in_a_liquid_bends_light_by_the_relative_index() -> None:
    box = {"refractor": {"box_mm": [80.0, 60.0, 60.0], "index": 1.333}, "position_mm": PLACE.tolist()}
    heights = np.linspace(-0.99, 0.99, 101) * RADIUS
    for index in (GLASS, 1.0):
        within = heights[np.abs(heights) < RADIUS * min(index / 1.333, 1.0) * 0.999]
        i = np.arcsin(within / RADIUS)
        # A plane face keeps n sin, and reflects all of what has more than 1.
        sine = -1.333 * np.sin(2.0 * (i - np.arcsin(np.sin(i) * 1.333 / index)))
        passes = np.abs(sine) < 0.999
        assert passes.sum() > 60
        paths = sent(world_of(box, glass(BALL, index)), *parallel(within[passes]))
        np.testing.assert_allclose(paths.direction[:, 0], sine[passes], atol=1e-11)


def test_a_ray_that_starts_just_inside_or_outside_the_exact_surface_starts_in_its_medium() -> None:
    draw = np.random.default_rng(7)
    outward = draw.normal(size=(500, 3))
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    world = world_of(glass(BALL))
    for share, events in ((1.0 - 1e-7, 1), (1.0 + 1e-7, 0)):
        paths = sent(world, PLACE + share * RADIUS * outward, outward.copy())
        assert (paths.events == events).all()
        np.testing.assert_allclose(paths.direction, outward, atol=1e-9)


@pytest.mark.parametrize("finish", ["polished", "diffuse", {"kind": "ground", "roughness": 0.5}], ids=str)
@pytest.mark.parametrize(
    "shape", [{"kind": "sphere", "radius_mm": 1.3}, {"kind": "cylinder", "radius_mm": 1.2, "height_mm": 2.0}],
    ids=["ball", "rod"],
)  # fmt: skip
def test_paths_through_round_glass_that_end_on_walls_have_the_walls_radiance(
    tmp_path: Path, shape: dict[str, Any], finish: Any
) -> None:
    """To rounding, for each path that ends there: glass that absorbs nothing leaves light of one radiance as it is."""
    body = {"refractor": {"shape": shape, "index": 1.5, "finish": finish}}
    scene = furnace(tmp_path, body, samples=256)
    clear = {"targets[5].refractor.index": 1.0, "targets[5].refractor.finish": "polished"}
    held, empty = unchecked(scene), unchecked(scene.changed(clear))
    assert abs(held.ledger.imbalance) < 1e-12
    assert sum(held.ledger.lost.values()) <= 1e-7 * held.ledger.emitted
    assert held.mean.sum() / empty.mean.sum() == pytest.approx(
        held.ledger.reached_target / empty.ledger.reached_target, rel=1e-9
    )


def seen_through_a_ball(**transport: Any) -> lf.Scene:
    """A matt sheet that a lamp lights, also through the ball of glass that stands before it."""
    camera = camera_without_array(60.0, 4, 0.5)
    lamp = {"kind": "point", "position_mm": [20.0, -15.0, -25.0], "power_w": 1.0}
    sheet = {"shape": {"kind": "plane", "width_mm": 30.0, "height_mm": 30.0}, "position_mm": [0, 0, -60.0],
             "material": {"reflectance": 0.8}}  # fmt: skip
    ball = glass({"kind": "sphere", "radius_mm": 3.0}, 1.5, at=(1.0, 0.5, -52.0))
    return lf.Scene(camera=camera, targets=[sheet, ball], lights=[lamp], transport={"threads": 1, **transport})


def test_forward_equals_adjoint_through_a_ball() -> None:
    """Welch's test of the sum of the pixels, of images with seeds of their own."""
    one = [image.mean.sum() for image in by_seed(seen_through_a_ball(samples=128), range(12))]
    other = [image.mean.sum() for image in by_seed(seen_through_a_ball(method="forward", samples=16384), range(12))]
    assert stats.ttest_ind(one, other, equal_var=False).pvalue > LEVEL
    # So a difference of some 7 % would show.
    assert stats.sem(one) / np.mean(one) < 0.02
    assert stats.sem(other) / np.mean(other) < 0.02


@pytest.mark.parametrize("shape", [BALL, ROD], ids=["ball", "rod"])
def test_a_medium_in_round_glass_weakens_light_along_its_chord(shape: dict[str, Any]) -> None:
    """By exp(−κ s) with s = 2 R cos r, as its glass does, to rounding: the medium ends at the exact surface."""
    kappa, heights = 0.07, np.linspace(-0.999, 0.999, 101) * RADIUS
    body = glass(shape, turned=(90.0, 0.0, 0.0)) | {"name": "ball"}
    dye = {"inside": "ball", "absorption_per_mm": 0.5 * kappa}
    lost = {"inside": "ball", "scattering_per_mm": 0.5 * kappa}
    stained = {"refractor": body["refractor"] | {"absorption_per_mm": kappa}}
    scene = lf.Scene(camera=camera_without_array(), targets=[body])
    chord = 2.0 * RADIUS * np.sqrt(1.0 - (heights / (GLASS * RADIUS)) ** 2)
    clear = sent(lf.build(scene, aimed=False), *parallel(heights))
    for changes in ({"media": [dye, lost]}, {"targets": [body | stained]}):
        paths = sent(lf.build(scene.changed(changes), aimed=False), *parallel(heights))
        straight = paths.events == 2
        ends = np.bincount(paths.source[straight], paths.weight[straight], minlength=len(heights))
        np.testing.assert_allclose(ends / clear.weight, np.exp(-kappa * chord), rtol=1e-11)


def test_forward_equals_adjoint_of_a_glow_in_a_ball() -> None:
    """Welch's test of the sum of the pixels; light is drawn in the ball alone, up to its exact surface."""
    ball = glass({"kind": "sphere", "radius_mm": 3.0}, 1.3, at=(1.0, 0.5, -52.0)) | {"name": "ball"}
    glow = {"inside": "ball", "absorption_per_mm": 0.1, "emission_w_mm3_sr": 1e-3}
    camera = camera_without_array(60.0, 4, 0.5)

    def sums(**transport: Any) -> list[float]:
        scene = lf.Scene(camera=camera, targets=[ball], media=[glow], transport={"threads": 1, **transport})
        return [float(image.mean.sum()) for image in by_seed(scene, range(12))]

    one, other = sums(samples=64), sums(method="forward", samples=4096)
    assert stats.ttest_ind(one, other, equal_var=False).pvalue > LEVEL
    assert stats.sem(one) / np.mean(one) < 0.02
    assert stats.sem(other) / np.mean(other) < 0.02


def test_a_ball_behind_a_plate_of_glass_is_met_as_in_air() -> None:
    """Rays square to the plate keep their ways; it lies a thousandth of a millimetre before the ball."""
    plate = {
        "refractor": {"box_mm": [40.0, 40.0, 2.0], "index": 1.7},
        "position_mm": np.add(PLACE, (0.0, 0.0, 6.001)).tolist(),
    }
    heights = np.concatenate([np.linspace(-0.9999, 0.9999, 200), [0.0]]) * RADIUS
    paths = sent(world_of(plate, glass(BALL)), *parallel(heights))
    place, way, power = through_circle(heights, GLASS)
    assert (paths.events == 4).all()
    assert np.abs((paths.position - PLACE)[:, [0, 2]] - place).max() < 1e-9
    assert np.abs(paths.direction[:, [0, 2]] - way).max() < 1e-11
    np.testing.assert_allclose(paths.weight, power * fresnel(1.0, 1.7, 1.0)[1] ** 2, rtol=1e-9)
    for material in ({}, {"opacity": 0.5}):
        world = world_of(plate, {"shape": BALL, "position_mm": PLACE.tolist(), "material": material})
        paths = sent(
            world, *parallel(np.array([-1.0 - 2.5e-7, -1.0 + 2.5e-7, 0.5, 1.0 - 2.5e-7, 1.0 + 2.5e-7]) * RADIUS)
        )
        assert (paths.status[[0, 4]] == lf.Status.ESCAPED).all()
        on = paths.position[paths.status == lf.Status.TARGET] - PLACE
        np.testing.assert_allclose(np.linalg.norm(on, axis=1), RADIUS, rtol=1e-12)
        assert len(on) == 3 or material


def test_true_depth_is_that_of_a_balls_surface_or_of_what_is_seen_through_it() -> None:
    lens = {"file": asset_path("lenses/double_gauss_50mm.toml").as_posix(), "stop_semi_diameter_mm": 4.77}
    array = {"count": (12, 12), "pitch_mm": 0.125, "focal_length_mm": 0.5, "index": 1.5, "thickness_mm": 0.3}
    camera = {"focus_mm": 500.0, "lens": lens, "mla": array, "sensor": {"pixels": (120, 120), "pixel_mm": 0.0125}}
    sheet = {"shape": {"kind": "plane", "width_mm": 400.0, "height_mm": 400.0}, "position_mm": [0.0, 0.0, -600.0]}
    shape, at = {"kind": "sphere", "radius_mm": 12.0}, (0.0, 0.0, -500.0)

    def depth(*bodies: dict[str, Any]) -> Array:
        scene = lf.Scene(camera=camera, targets=[sheet, *bodies], transport={"threads": 1})
        return lf.depth_truth(scene, views=1, samples=1).middle_mm

    opaque = depth({"shape": shape, "position_mm": at})
    assert (opaque >= np.float32(488.0)).all()
    # Chief rays pass the axis within a lenslet's width in object space, some 1.2 mm.
    assert opaque.min() < 488.0 + 1.2**2 / 24.0
    np.testing.assert_allclose(depth(glass(shape, at=at)), 600.0, rtol=1e-6)
    np.testing.assert_allclose(
        depth({"shape": shape, "position_mm": at, "material": {"opacity": 0.0}}), 600.0, rtol=1e-6
    )


@pytest.mark.parametrize("kind", ["sphere", "cylinder"])
def test_a_sheer_body_lets_light_pass_both_of_its_sides(kind: str) -> None:
    """Each side is there by a chance of its own: a share (1 − o)² of the rays passes, and outlines are exact."""
    opacity, count = 0.4, 40_000
    shape = BALL if kind == "sphere" else ROD
    world = world_of({"shape": shape, "position_mm": PLACE.tolist(), "material": {"opacity": opacity}})
    draw = np.random.default_rng(8)
    aside = draw.uniform(-0.5, 0.5, (count, 2)) * RADIUS
    starts = PLACE + np.column_stack([aside, np.full(count, 40.0)])
    paths = sent(world, starts, np.broadcast_to(TOWARDS, starts.shape).copy())
    on = paths.position[paths.status == lf.Status.TARGET] - PLACE
    front = int((on[:, 2] > 0.0).sum())
    assert stats.binomtest(front, count, opacity).pvalue > LEVEL
    assert stats.binomtest(len(on) - front, count - front, opacity).pvalue > LEVEL
    if kind == "sphere":
        np.testing.assert_allclose(np.linalg.norm(on, axis=1), RADIUS, rtol=1e-12)
    turn = 2.0 * np.pi * np.arange(360) / 360
    ring = RADIUS * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    for share, meets in ((-2.5e-7, True), (2.5e-7, False)):
        starts = PLACE + (1.0 + share) * ring - 40.0 * TOWARDS
        paths = sent(world, starts, np.broadcast_to(TOWARDS, starts.shape).copy())
        assert (paths.status == lf.Status.TARGET).any() == meets


def test_the_shadow_of_a_sheer_ball_is_the_square_of_what_each_side_lets_pass() -> None:
    """And a sheer ball that shines lights a sheet by both of its sides, an opaque one by one."""
    camera = camera_without_array(60.0, 2, 0.5)
    transport = {"threads": 1, "samples": 512, "replicates": 32, "split": "transmit"}
    sheet = {"shape": {"kind": "plane", "width_mm": 60.0, "height_mm": 60.0}, "position_mm": [0, 0, -60.0],
             "material": {"reflectance": 0.8}}  # fmt: skip
    sun = {"kind": "directional", "direction": [1.0, 0.0, -1.0], "irradiance_w_m2": 1.0}
    ball = {"shape": {"kind": "sphere", "radius_mm": 6.0}, "position_mm": [-25.0, 0.0, -35.0]}

    def light(**material: Any) -> tuple[float, float]:
        lit = "radiance_w_m2_sr" not in material
        scene = lf.Scene(
            camera=camera, targets=[sheet, ball | {"material": {"reflectance": 0.0} | material}],
            lights=[sun] if lit else [], transport=transport,
        )  # fmt: skip
        image = unchecked(scene)
        return float(image.mean.sum()), float(np.sqrt((image.stderr**2).sum()))

    (half, error), (clear, _) = light(opacity=0.5), light(opacity=0.0)
    assert abs(half / clear - 0.25) < 4.0 * error / clear
    (sheer, one), (opaque, other) = light(opacity=0.5, radiance_w_m2_sr=1.0), light(radiance_w_m2_sr=1.0)
    # Half of the near side shines, and half of the far one through the half that is not there.
    assert abs(sheer / opaque - 0.75) < 4.0 * np.hypot(one, other) / opaque
