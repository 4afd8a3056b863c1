"""Blocks of rays through gradient-index glass: by closed form, by packets, along ghosts, and in whole pictures."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.transport.sequences.gradient_gaps import gap_curves, gap_paths
from lfmesh.transport.sequences.ray_tables import follow_sequence, lens_of_faces
from lfmesh.transport.sequences.sequences import Itinerary, two_reflections
from tests.renders import unchecked
from tests.transport.gradient_lenses import (
    ALPHA,
    INDEX,
    ROD,
    built,
    camera,
    crossed,
    index_in_rod,
    passed,
    point_of,
    rod,
    rod_ray,
    unit,
)

Array = NDArray[np.float64]

LEVEL = 1e-3
"""Chance that a statistical test fails though the law holds."""


@pytest.mark.parametrize("engine", ["mesh", "sequential"])
def test_rays_through_a_rod_land_by_the_closed_form(engine: str) -> None:
    """From the air in front to the sensor behind: place, direction, and Fresnel's shares at both local indices."""
    length, gap = 30.0, 5.0
    world = built(rod(length), distance_mm=gap)
    draw = np.random.default_rng(1)
    place = draw.uniform(-1.4, 1.4, (200, 2))
    d = np.column_stack([draw.uniform(-0.2, 0.2, (200, 2)), np.ones(200)])
    d /= np.linalg.norm(d, axis=1)[:, None]
    start = np.column_stack([place, np.zeros(200)]) - 2.0 * d
    paths = lf.trace(world, start, d, split="transmit", engine=engine)
    landed = paths.status == lf.Status.SENSOR
    assert landed.all()
    for i, source in enumerate(paths.source):
        n, along = index_in_rod(place[source]), d[source]
        vector = np.array([along[0], along[1], np.sqrt(n * n - along[0] ** 2 - along[1] ** 2)])
        end = rod_ray(place[source], vector, length)
        out = np.append(end.vector[:2], np.sqrt(1.0 - (end.vector[:2] ** 2).sum()))
        np.testing.assert_allclose(paths.direction[i], out, atol=2e-9)
        np.testing.assert_allclose(paths.position[i], [*end.place + gap * out[:2] / out[2], length + gap], atol=3e-9)
        first = passed(1.0, n, float(np.hypot(*along[:2])))
        second = passed(index_in_rod(end.place), 1.0, float(np.hypot(*end.vector[:2])))
        assert paths.weight[i] == pytest.approx(first * second, rel=1e-8)


def test_both_engines_end_the_same_rays_on_the_edge() -> None:
    """Rays that start near the rim and lean outwards, in a glass whose index rises there."""
    outwards = {"kind": "radial_n2", "index": 1.5, "coefficients": [0.01]}
    world = built(rod(15.0, 3.0, outwards))
    draw = np.random.default_rng(2)
    place = draw.uniform(-1.9, 1.9, (300, 2))
    d = np.column_stack([0.08 * place + draw.uniform(-0.1, 0.1, (300, 2)), np.ones(300)])
    d /= np.linalg.norm(d, axis=1)[:, None]
    start = np.column_stack([place, np.zeros(300)]) - d
    packets, blocks = (lf.trace(world, start, d, split="transmit", engine=engine) for engine in ("mesh", "sequential"))
    assert packets.body == blocks.body
    assert 50 < packets.body.count("lens[0] edge") < 300
    np.testing.assert_allclose(packets.position, blocks.position, atol=1e-12)
    np.testing.assert_allclose(packets.weight, blocks.weight, rtol=1e-12)
    on_edge = np.array(packets.body) == "lens[0] edge"
    rim = world.tables.lens.gradients.edge[1, 1]
    np.testing.assert_allclose(np.hypot(*packets.position[on_edge, :2].T), rim, rtol=1e-9)


def test_paths_and_curves_are_those_of_the_closed_form() -> None:
    lens = built(rod(20.0)).tables.lens
    draw = np.random.default_rng(3)
    p = np.column_stack([draw.uniform(-1.0, 1.0, (20, 2)), np.zeros(20)])
    d = np.column_stack([draw.uniform(-0.15, 0.15, (20, 2)), np.ones(20)])
    d /= np.linalg.norm(d, axis=1)[:, None]
    paths, curves = gap_paths(lens, 1, 0, p, d), gap_curves(lens, 1, 1, 0, p, d, 11)
    for i in range(20):
        vector = index_in_rod(p[i]) * d[i]
        assert paths[i] == pytest.approx(rod_ray(p[i, :2], vector, 20.0).path, abs=1e-9)
        for z, point in zip(np.linspace(0.0, 20.0, 11), curves[i], strict=True):
            # A rod is constant along z, so equal parts of σ are equal parts of z.
            np.testing.assert_allclose(point, [*rod_ray(p[i, :2], vector, z).place, z], atol=3e-9)
    aside = gap_paths(lens, 1, 0, np.array([[0.0, 2.9, 0.0]]), unit(0.0, 0.9, 1.0)[None])
    assert np.isnan(aside).all()


def test_a_part_of_a_lens_keeps_the_gradients_of_its_spaces() -> None:
    """Faces cut out of a lens, the gap whole or half: rays cross it, or begin in it, as in the whole lens."""
    gradient = {"kind": "axial", "index": 1.7, "coefficients": [-0.02]}
    lens = built([
        {"radius_mm": 30.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 4.0},
        {"radius_mm": 20.0, "thickness_mm": 6.0, "gradient": gradient, "semi_diameter_mm": 4.0},
        {"radius_mm": -20.0, "semi_diameter_mm": 4.0},
    ]).tables.lens  # fmt: skip
    start, d = np.array([0.5, -0.3, 5.0]), unit(0.1, 0.05, 1.0)
    whole = point_of(crossed(lens, 2, 2, start, d))
    for first, space, k in ((1, 1, 1), (2, 0, 0)):
        cut = lens_of_faces(lens, first, 3)
        for one, other in zip(whole, point_of(crossed(cut, space, k, start, d)), strict=True):
            np.testing.assert_array_equal(one, other)
    assert lens_of_faces(lens, 0, 1).gradients.number.max() < 0


GHOSTLY: list[dict[str, Any]] = [
    {"radius_mm": 18.0, "thickness_mm": 4.0, "gradient": {"kind": "axial", "index": 1.75, "coefficients": [-0.03]},
     "semi_diameter_mm": 5.0},
    {"radius_mm": -20.0, "thickness_mm": 1.0, "semi_diameter_mm": 5.0},
    {"radius_mm": -25.0, "thickness_mm": 5.0, "gradient": ROD, "semi_diameter_mm": 5.0},
    {"radius_mm": -40.0, "semi_diameter_mm": 5.0},
]  # fmt: skip


def test_sequences_with_two_reflections_are_those_of_recorded_packets() -> None:
    """Where they leave the lens, and which share of the power they carry."""
    world = built(GHOSTLY, distance_mm=10.0)
    draw = np.random.default_rng(4)
    to = np.column_stack([draw.uniform(-2.5, 2.5, (60, 2)), np.zeros(60)])
    p = np.tile([2.0, -1.0, -80.0], (60, 1))
    d = (to - p) / np.linalg.norm(to - p, axis=1)[:, None]
    paths = lf.trace(world, p, d, split="both", weight_cutoff=0.0, max_events=9, record=True)
    found: dict[Itinerary, list[int]] = {}
    for row in np.flatnonzero(paths.status == lf.Status.SENSOR):
        met = [v for v in paths.vertices(int(row)) if v.surface.startswith("lens surface")]
        mirrored = tuple(v.event == lf.Event.REFLECTED for v in met)
        if sum(mirrored) == 2:
            found.setdefault(Itinerary(tuple(int(v.surface[-1]) for v in met), mirrored), []).append(int(row))
    known = set(two_reflections(4))
    assert len(known & set(found)) >= 4
    for path in known & set(found):
        rows = found[path]
        sources = paths.source[rows]
        arrived = follow_sequence(world.tables, path, p[sources], d[sources])
        along = paths.position[rows, 2] - arrived.position[:, 2]
        reach = arrived.position + (along / arrived.direction[:, 2])[:, None] * arrived.direction
        np.testing.assert_allclose(reach, paths.position[rows], atol=1e-9)
        np.testing.assert_allclose(arrived.weight, paths.weight[rows], rtol=1e-11)


GLOW = {"reflectance": 0.0, "radiance_w_m2_sr": 1e3}


def glowing(method: str, **transport: Any) -> lf.Scene:
    """A rod that images a glowing plane close before it on a sensor."""
    length = np.pi / ALPHA * 0.75
    scene = camera(rod(length, 2.0), distance_mm=6.0)
    target = {"shape": {"kind": "plane", "width_mm": 6.0, "height_mm": 5.0}, "position_mm": [0.5, 0.0, -7.0],
              "material": GLOW}  # fmt: skip
    settings = {"method": method, "split": "transmit", "replicates": 16, "samples": 256} | transport
    sensor = {"camera.sensor.pixels": [6, 6], "camera.sensor.pixel_mm": 0.8}
    given = {f"transport.{key}": value for key, value in settings.items()}
    return scene.changed({"targets": [target]} | sensor | given)


@pytest.mark.parametrize("split", ["transmit", pytest.param("both", marks=pytest.mark.long)])
def test_forward_equals_adjoint_behind_a_rod(split: str) -> None:
    """Power of the whole image, by Welch's test; energy closes in both methods."""
    total, error = [], []
    for method, samples in (("adjoint", 64), ("forward", 1024)):
        image = unchecked(glowing(method, split=split, samples=samples))
        assert abs(image.ledger.imbalance) < 1e-11
        assert image.ledger.lost_share == 0.0
        total.append(float(image.mean.sum()))
        error.append(float(np.sqrt(np.square(image.stderr).sum())))
    assert max(e / t for e, t in zip(error, total, strict=True)) < 0.03
    assert abs(total[0] - total[1]) < stats.t.ppf(1.0 - 0.5 * LEVEL / 2, 15) * np.hypot(*error)


def mirroring(method: str, samples: int, split: str = "both") -> lf.Scene:
    """A thick lens close behind a glowing plane, with a mirror for a front face.

    The mirror turns light from the sensor to steep angles, at which it turns back in the glass. A third of the light
    that leaves the front has done so.
    """
    surfaces = [
        {"radius_mm": 5.0, "thickness_mm": 3.0, "gradient": {"kind": "axial", "index": 2.0, "coefficients": [-0.3]},
         "semi_diameter_mm": 4.0, "coating": "mirror"},
        {"semi_diameter_mm": 4.0},
    ]  # fmt: skip
    plane = {"shape": {"kind": "plane", "width_mm": 40.0, "height_mm": 40.0}, "position_mm": [0.0, 0.0, -0.3],
             "material": GLOW}  # fmt: skip
    scene = camera(
        surfaces, distance_mm=0.5, coatings={"mirror": {"reflectance": 0.9}}, targets=[plane],
        transport={"method": method, "split": split, "samples": samples, "replicates": 16},
    )  # fmt: skip
    return scene.changed({"camera.sensor.pixels": [2, 2], "camera.sensor.pixel_mm": 3.0})


def test_in_a_mirroring_lens_much_light_turns_back() -> None:
    """At least a fifth of the light from the sensor that leaves the front met a face twice in succession."""
    # Without the plane, on which most of this light would end, all of it escapes.
    world = lf.build(mirroring("adjoint", 16).changed({"targets": []}), aimed=False)
    draw = np.random.default_rng(6)
    sine, turn = np.sqrt(draw.uniform(size=2000)), draw.uniform(0.0, 2.0 * np.pi, 2000)
    d = np.column_stack([sine * np.cos(turn), sine * np.sin(turn), -np.sqrt(1.0 - sine**2)])
    p = np.column_stack([draw.uniform(-2.5, 2.5, (2000, 2)), np.full(2000, 3.01)])
    paths = lf.trace(world, p, d, split="roulette", record=True)
    out, turned = 0.0, 0.0
    for row in np.flatnonzero(paths.status == lf.Status.ESCAPED):
        met = [v.surface for v in paths.vertices(int(row)) if v.surface.startswith("lens surface")]
        out += paths.weight[row]
        turned += paths.weight[row] * any(one == other for one, other in pairwise(met))
    assert out > 0.02 * len(p)
    assert turned > 0.2 * out


@pytest.mark.long
def test_forward_equals_adjoint_with_light_that_turns_back() -> None:
    """The adjoint method's image path and ghosts do not follow it, so its packets must.

    If neither method followed it, they would agree as well, at 1.05 times the image path: ghosts without a turn.
    """
    total, error = [], []
    for method, samples in (("adjoint", 65536), ("forward", 1048576)):
        image = unchecked(mirroring(method, samples))
        assert abs(image.ledger.imbalance) < 1e-11
        assert image.ledger.lost_share == 0.0
        total.append(float(image.mean.sum()))
        error.append(float(np.sqrt(np.square(image.stderr).sum())))
    assert max(e / t for e, t in zip(error, total, strict=True)) < 0.03
    assert abs(total[0] - total[1]) < stats.t.ppf(1.0 - 0.5 * LEVEL, 15) * np.hypot(*error)
    image_path = float(unchecked(mirroring("adjoint", 65536, "transmit")).mean.sum())
    assert min(total) > 1.3 * image_path


def test_a_picture_with_ghosts_passes_its_own_proofs() -> None:
    """Ghosts by sequence agree with packets, and the aim is proven by rays from the stop."""
    image = lf.render(glowing("adjoint", split="both", samples=32, replicates=4))
    assert image.order is not None
    assert image.order.compared > 100
    assert image.order.holds
    assert image.aim is not None
    assert image.aim.holds


@pytest.mark.parametrize("stop", [0, 1])
def test_the_aim_is_proven_wherever_the_stop_touches_the_glass(stop: int) -> None:
    """On the front or the rear face of a rod; rays from the stop start in the air beside it."""
    surfaces = rod(20.0, 2.0)
    scene = glowing("adjoint")
    given = [surface | {"stop": number == stop} for number, surface in enumerate(surfaces)]
    world = lf.build(scene.changed({"camera.lens.surfaces": given}))
    assert world.aim_proof is not None
    assert world.aim_proof.rays > 1000
    assert world.aim_proof.holds


def test_a_stop_between_two_gradients_is_not_proven() -> None:
    """No straight ray starts there; the run says that nothing proves its aim."""
    second = {"kind": "radial_n2", "index": 1.5, "coefficients": [-0.004]}
    surfaces = [
        {"thickness_mm": 8.0, "gradient": ROD, "semi_diameter_mm": 3.0},
        {"radius_mm": 50.0, "thickness_mm": 8.0, "gradient": second, "semi_diameter_mm": 1.5, "stop": True},
        {"semi_diameter_mm": 3.0},
    ]
    scene = glowing("adjoint").changed({"camera.lens.surfaces": surfaces})
    assert lf.build(scene).aim_proof is None
    with pytest.warns(lf.LightOutsideAimWarning, match="not proven"):
        lf.render(scene.changed({"transport.samples": 4, "transport.replicates": 2}))


def test_the_image_path_has_one_gap_after_the_other() -> None:
    """Two rods end to end are one rod: same places, and a face between of equal indices reflects nothing."""
    second = {"kind": "radial_n2", "index": INDEX, "coefficients": [-(ALPHA**2), 0.0]}
    halves = [
        {"thickness_mm": 7.0, "gradient": ROD, "semi_diameter_mm": 3.0},
        {"thickness_mm": 5.0, "gradient": second, "semi_diameter_mm": 3.0},
        {"semi_diameter_mm": 3.0},
    ]
    draw = np.random.default_rng(5)
    d = np.column_stack([draw.uniform(-0.2, 0.2, (50, 2)), np.ones(50)])
    d /= np.linalg.norm(d, axis=1)[:, None]
    p = np.column_stack([draw.uniform(-1.0, 1.0, (50, 2)), np.zeros(50)]) - d
    one, two = (lf.trace(built(lens), p, d, split="transmit", engine="sequential") for lens in (rod(12.0), halves))
    np.testing.assert_allclose(one.position, two.position, atol=3e-9)
    np.testing.assert_allclose(one.weight, two.weight, rtol=1e-9)
