"""Ghosts as a part of the image of their own: each path counts once, and brings what the mesh engine finds.

Estimates by other random numbers are compared by z-tests of the image's whole power, and pixel by pixel by their sum of
squares; LEVEL is the chance that this file fails though all is right, shared by its comparisons (Bonferroni).
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.transport.aims import ghost_aim
from lfmesh.transport.aims.ghost_trace import Passing, coarse_trace
from lfmesh.transport.checks import ghost_check
from lfmesh.transport.engine import Workspace
from lfmesh.transport.packets.packet import PIXEL_MASK, PLATE
from lfmesh.transport.paths.automaton import EVERY, GHOSTS, OFF_IMAGE_PATH, OTHER_STRAYS
from lfmesh.transport.render.parts import Part, parts_of
from lfmesh.transport.render.render import Renderer
from lfmesh.transport.render.tally import Film
from lfmesh.transport.sequences.ghosts import kind_of_ray
from lfmesh.transport.sources.pixels import PixelSource
from tests.instances import instances

LEVEL = 1e-3
COMPARISONS = 43
REPLICATES = 16

MLA = {"count": [12, 12], "pitch_mm": 0.2, "focal_length_mm": 1.0, "index": 1.5, "thickness_mm": 0.4}
POSED = {"surfaces": [0, 1], "pose": {"shift_mm": [0.05, 0.02, 0.0], "tilt_deg": [0.2, 0.4, 0.0]}}


def lens(number: int) -> dict[str, Any]:
    """Return a lens of two or three elements, drawn at random, with its stop behind the first."""
    draw = np.random.default_rng(number)
    surfaces: list[dict[str, Any]] = []
    for k in range(draw.integers(2, 4)):
        weak = draw.uniform(60.0, 200.0) * draw.choice([-1.0, 1.0])
        surfaces += [
            {"radius_mm": draw.uniform(30.0, 50.0), "thickness_mm": 4.0, "index": draw.uniform(1.5, 2.0)},
            {"radius_mm": weak, "thickness_mm": draw.uniform(0.5, 2.0)},
        ]
        if k == 0:
            surfaces.append({"stop": True, "thickness_mm": 1.5, "semi_diameter_mm": 5.0})
    for surface in surfaces:
        surface.setdefault("semi_diameter_mm", 7.0)
    surfaces[-1]["thickness_mm"] = 0.0
    return {"surfaces": surfaces}


def with_first(given: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """Return a lens with its first surface changed."""
    return {"surfaces": [given["surfaces"][0] | changes, *given["surfaces"][1:]]}


PLANE_FACE = with_first(lens(4), radius_mm=np.inf)
CYLINDERS = "a coated array with crossed cylinders on its faces, tilted"
ABSORBING_CYLINDERS = "a coated array that absorbs, with crossed cylinders on its faces, tilted"
"""Both of two other cameras, whose kernels nothing else needs and compile for a minute."""

PHASES = "phases on lens and array"

CAMERAS: dict[str, dict[str, Any]] = {
    "one": {"lens": lens(0)},
    "two": {"lens": lens(1), "mla": MLA},
    "three": {"lens": lens(2), "mla": MLA | {"curved_side": "sensor"}},
    "a plane face": {"lens": PLANE_FACE},
    "an asphere": {"lens": with_first(lens(5), conic=-0.4, asphere_mm=[1e-6, -1e-9])},
    "a posed element": {"lens": lens(6) | {"elements": [POSED]}},
    "a coated surface": {"lens": with_first(lens(7), coating="ar")},
    "a sensor that reflects, behind a cover": {
        "lens": lens(8), "reflectance": 0.2, "cover": {"thickness_mm": 0.5, "gap_mm": 0.1, "index": 1.5},
    },
    "a cover alone": {"lens": lens(9), "cover": {"thickness_mm": 1.5, "gap_mm": 2.0, "index": 1.9}},
    "a sensor that reflects, behind an array": {"lens": lens(10), "mla": MLA, "reflectance": 0.3},
    "array, cover, and a sensor that reflects": {
        "lens": lens(11), "mla": MLA | {"curved_side": "sensor", "layout": "hexagonal"}, "reflectance": 0.3,
        "cover": {"thickness_mm": 0.1, "gap_mm": 0.05, "index": 1.7},
    },
    CYLINDERS: {
        "lens": lens(13),
        "mla": MLA | {
            "focal_length_mm": None, "radius_mm": 0.5, "cylinder_axis": "y", "conic": -0.5, "curved_coating": "ar",
            "back": {"radius_mm": 0.8, "cylinder_axis": "x"}, "pose": {"tilt_deg": [1.5, -1.0, 4.0]},
        },
    },
    ABSORBING_CYLINDERS: {
        "lens": lens(13), "absorption": True,
        "mla": MLA | {
            "focal_length_mm": None, "radius_mm": 0.5, "cylinder_axis": "y", "conic": -0.5, "index": None,
            "glass": "N-SF66", "curved_coating": "ar", "back": {"radius_mm": 0.8, "cylinder_axis": "x"},
            "pose": {"tilt_deg": [1.5, -1.0, 4.0]},
        },
    },
    "glass that absorbs, in lens and array": {
        "lens": with_first(lens(15), index=None, glass="N-SF66"), "absorption": True,
        "mla": MLA | {"index": None, "glass": "N-SF66"},
    },
    "coatings that absorb, on lens, array and cover": {
        "lens": with_first(lens(14), coating="sun"), "mla": MLA | {"curved_coating": "sun", "flat_coating": "sun"},
        "cover": {"thickness_mm": 0.1, "gap_mm": 0.05, "index": 1.7, "coating": "sun"},
    },
    "paths that end early": {"lens": lens(12), "reflectance": 0.2, "max_events": 12},
    PHASES: {
        "lens": with_first(lens(16), phase={"kind": "radial", "coefficients_rad": [-500.0], "radius_mm": 7.0}),
        "mla": MLA | {"curved_phase": {"kind": "radial", "coefficients_rad": [-5.0], "radius_mm": 0.1}},
    },
}  # fmt: skip

LONG = [
    "one", "three", "a plane face", "a coated surface", "a cover alone", "a sensor that reflects, behind an array",
    CYLINDERS, ABSORBING_CYLINDERS, PHASES,
    "glass that absorbs, in lens and array",
]  # fmt: skip
"""Their parts are in the others together, or compared ray by ray with those of the meshes."""

SUN = [{"index": 1.46, "thickness_nm": 60.0}, {"index": 1.8, "extinction": 0.4, "thickness_nm": 45.0}]


def scene(camera: dict[str, Any], **transport: Any) -> lf.Scene:
    """A glowing square that the lens sees small before a dark plane, and a wall that scatters light to the plane."""
    sensor = {"pixels": [6, 6], "pixel_mm": 0.4} | {
        key: camera[key] for key in ("reflectance", "cover") if key in camera
    }
    events = {key: camera[key] for key in ("max_events",) if key in camera}
    glow = {"reflectance": 0.5, "radiance_w_m2_sr": 1000.0}
    square = {"kind": "plane", "width_mm": 60.0, "height_mm": 60.0}
    parts = {key: camera[key] for key in ("lens", "mla", "absorption") if key in camera}
    return lf.Scene(
        camera={"focus_mm": 300.0, "sensor": sensor} | parts,
        coatings={"ar": {"reflectance": 0.01}, "sun": {"layers": SUN}},
        targets=[
            {"shape": square, "position_mm": [20.0, 0.0, -300.0], "material": glow},
            {"shape": square, "position_mm": [-40.0, 0.0, -280.0], "rotation_deg": [0.0, 60.0, 0.0]}
            | {"material": {"reflectance": 0.8}},
        ],
        lights=[{"kind": "point", "position_mm": [50.0, 50.0, -20.0], "power_w": 20.0}],
        transport={"samples": 1024 * REPLICATES, "replicates": REPLICATES, "threads": 2, "wavelengths_nm": [587.6]}
        | events
        | transport,
    )


def image_of(world: Any, parts: tuple[Part, ...]) -> lf.Image:
    renderer = Renderer(world, check=False)
    renderer.parts = parts
    return renderer.image()


def off_path(world: Any) -> dict[int, Part]:
    """Return the two parts off the image path, and the single one in their place, by their classes."""
    apart, joined = parts_of(world), parts_of(world, by_meshes=True)
    found = {part.options.paths: part for part in (*apart, *joined) if part.options.paths != EVERY}
    assert set(found) == {GHOSTS, OTHER_STRAYS, OFF_IMAGE_PATH}
    return found


def p_value(one: lf.Image, other: lf.Image) -> float:
    """Return how likely the whole powers of two images differ as much: Welch's t-test over the replicates."""
    variances = np.array([np.square(image.stderr).sum() for image in (one, other)])
    difference = one.mean.sum() - other.mean.sum()
    freedom = variances.sum() ** 2 / np.square(variances).sum() * (REPLICATES - 1)
    return float(2.0 * stats.t.sf(abs(difference) / np.sqrt(variances.sum()), freedom))


@pytest.mark.parametrize("name", instances(CAMERAS, long=[*LONG, "two", "a sensor that reflects, behind a cover"]))
def test_ghosts_and_other_strays_are_what_the_mesh_engine_finds_off_the_image_path(name: str) -> None:
    """The ghosts by sequence alone too, against the mesh engine's share of them."""
    world = lf.build(scene(CAMERAS[name]))
    parts = off_path(world)
    apart = image_of(world, (parts[OTHER_STRAYS], parts[GHOSTS]))
    by_meshes = replace(parts[OFF_IMAGE_PATH], number=7)
    whole = image_of(world, (by_meshes,))
    assert p_value(apart, whole) > LEVEL / COMPARISONS
    assert np.sqrt(np.square(whole.stderr).sum()) < 0.05 * whole.mean.sum()
    # Walks off the image path that are no ghosts, with the same random numbers as all walks.
    others = image_of(world, (replace(by_meshes, options=by_meshes.options._replace(paths=OTHER_STRAYS)),))
    ghosts = image_of(world, (parts[GHOSTS],))
    assert p_value(ghosts, _difference(whole, others)) > LEVEL / COMPARISONS
    assert ghosts.mean.sum() > 10.0 * np.sqrt(np.square(ghosts.stderr).sum())


def _difference(one: lf.Image, other: lf.Image) -> lf.Image:
    """Return the difference of two images with the error of two that are independent, which is more than it has."""
    return replace(one, mean=one.mean - other.mean, stderr=np.hypot(one.stderr, other.stderr))


def test_ghosts_counted_twice_would_be_seen() -> None:
    world = lf.build(scene(CAMERAS["two"]))
    parts = off_path(world)
    twice = image_of(world, (replace(parts[OFF_IMAGE_PATH], number=7), parts[GHOSTS]))
    apart = image_of(world, (parts[OTHER_STRAYS], parts[GHOSTS]))
    assert p_value(apart, twice) < LEVEL / COMPARISONS


@pytest.mark.parametrize(
    "name",
    [
        "array, cover, and a sensor that reflects", "paths that end early",
        *(
            pytest.param(name, marks=pytest.mark.long)
            for name in (
                "one", "two", "a sensor that reflects, behind a cover", "a posed element",
                "coatings that absorb, on lens, array and cover",
            )
        ),
    ],
)  # fmt: skip
def test_the_image_is_that_of_the_mesh_engine(name: str) -> None:
    """The ghosts are 0.6 to 6.5 % of these images; a difference of 0.2 to 1.2 % is seen."""
    given = scene(CAMERAS[name], samples=256 * REPLICATES)
    apart, by_mesh = lf.render(given), lf.render(given.changed({"transport.engine": "mesh", "transport.seed": 1}))
    assert p_value(apart, by_mesh) > LEVEL / COMPARISONS


@pytest.mark.parametrize("name", instances(CAMERAS, long=[CYLINDERS, ABSORBING_CYLINDERS]))
def test_ghosts_leave_the_lens_where_the_meshes_send_them(name: str) -> None:
    compared = Renderer(lf.build(scene(CAMERAS[name])))._compared_ghosts()
    assert compared is not None
    assert compared.compared > 500
    assert compared.differing == 0
    assert compared.deviation_mm <= 1e-10
    assert compared.deviation <= 1e-12


def spoil_place(sources: Any, packets: Any) -> tuple[Any, Any]:
    """Shift the places at which packets leave the lens."""
    packets["x"] += 1e-8
    return sources, packets


def spoil_fate(sources: Any, packets: Any) -> tuple[Any, Any]:
    """Leave out one of the packets."""
    return sources[1:], packets[1:]


@pytest.mark.parametrize("spoil", [spoil_place, spoil_fate])
def test_a_run_whose_ghosts_deviate_from_the_meshes_does_without_them(
    spoil: Callable[[Any, Any], tuple[Any, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It estimates all strays together."""
    honest = ghost_check._through_meshes
    monkeypatch.setattr(ghost_check, "_through_meshes", lambda *given: spoil(*honest(*given)))
    renderer = Renderer(lf.build(scene(CAMERAS["one"])))
    assert renderer.order is not None
    assert not renderer.order.holds
    assert GHOSTS not in [part.options.paths for part in renderer.parts]
    assert OFF_IMAGE_PATH in [part.options.paths for part in renderer.parts]


@pytest.mark.parametrize(
    "changes",
    [
        {"transport.split": "transmit"},
        {"transport.engine": "mesh"},
        {"transport.max_events": 5},
        {"coatings": {"ar": {"reflectance": 0.0}}, "camera.lens": {
            "surfaces": [s | ({} if s.get("stop") else {"coating": "ar"}) for s in lens(0)["surfaces"]]}},
    ],
    ids=["no reflections", "meshes alone", "short paths", "nothing reflects"],
)  # fmt: skip
def test_ghosts_are_not_apart_where_there_are_none_or_they_cannot_be_followed(changes: dict[str, Any]) -> None:
    parts = parts_of(lf.build(scene(CAMERAS["one"]).changed(changes)))
    assert not {GHOSTS, OTHER_STRAYS} & {part.options.paths for part in parts}


def test_the_image_is_bitwise_the_same_for_any_number_of_threads() -> None:
    one, three = (lf.render(scene(CAMERAS["two"], threads=n, samples=64, replicates=2)) for n in (1, 3))
    assert one.order == three.order
    assert np.array_equal(one.mean, three.mean)


@pytest.mark.parametrize("name", ["two", "a cover alone", "array, cover, and a sensor that reflects"])
def test_every_sequence_has_a_chance_with_every_ray(name: str) -> None:
    """The chances of all paths with two reflections are positive and sum to one."""
    world = lf.build(scene(CAMERAS[name]))
    ghosts, tables = world.ghosts, world.tables
    assert ghosts is not None
    lens, array = len(tables.lens.surfaces), 2 if "mla" in CAMERAS[name] else 0
    planes = (2 if "cover" in CAMERAS[name] else 0) + (1 if "reflectance" in CAMERAS[name] else 0)
    pairs = [(first, second) for first in range(lens + array + planes) for second in range(first)]
    assert len(ghosts.lengths) == len(pairs)
    # From the sensor, which every path leaves and none meets at its end.
    total = lens + array + planes - ("reflectance" in CAMERAS[name])
    assert sorted(ghosts.lengths.tolist()) == sorted(total + 2 * (first - second) for first, second in pairs)
    chances, anew = np.diff(ghosts.until, prepend=0.0, axis=1), ghosts.anew
    assert (chances[:-1, ~anew] > 0.5 * 0.1 / len(pairs)).all()
    assert not chances[:, anew].any()
    assert (chances[-1] > 0.0).tolist() == (ghosts.from_pixel & ~anew).tolist()
    # Those without a mirror in the lens; of these, those with one at the array start in a new direction.
    assert ghosts.from_pixel.sum() == (array + planes) * (array + planes - 1) // 2
    assert anew.sum() == ghosts.from_pixel.sum() - planes * (planes - 1) // 2
    np.testing.assert_allclose(ghosts.until[:-1, -1], 1.0, rtol=1e-15)
    assert (ghosts.share_anew > 0.0) == anew.any()
    assert (np.diff(ghosts.until_anew, prepend=0.0) > 0.0).tolist() == anew.tolist()
    assert (np.diff(ghosts.sines[anew], prepend=0.0, axis=1) > 0.0).all()
    np.testing.assert_allclose([*ghosts.sines[anew, -1], *ghosts.until_anew[anew][-1:]], 1.0, rtol=1e-15)
    assert (np.diff(ghosts.cells, prepend=0.0, axis=1) > 0.0).all()
    np.testing.assert_allclose(ghosts.cells[:, -1], 1.0, rtol=1e-15)


def test_every_sample_may_leave_its_pixel_in_a_new_direction() -> None:
    """Those too for which no lenslet shows the opening: here those of nearly all pixels, beside a small array."""
    world = lf.build(scene(CAMERAS["two"] | {"mla": MLA | {"count": [2, 2]}}))
    part = next(part for part in parts_of(world) if part.options.paths == GHOSTS)
    work, samples = Workspace(world, part.options, 1 << 12, part.tables), 64
    work.begin(Film.empty(36, 1), 36 * samples)
    PixelSource(np.arange(36), samples, np.uint64(1)).launch(work, range(36))
    waiting = work.stacks.waiting(PLATE)
    assert sorted(waiting["source"] & PIXEL_MASK) == sorted([*range(36)] * samples)
    assert 0.0 < np.mean(waiting["weight"] == 0.0) < 1.0
    assert (waiting["start"] > 0.0).all()


def _dark(rays: Passing) -> Passing:
    """Return the same rays without light."""
    return rays._replace(weight=0.0 * rays.weight)


@pytest.mark.parametrize("from_pixel", [False, True], ids=["from behind the lens", "from the pixel"])
def test_sequences_of_which_the_coarse_trace_finds_nothing_keep_a_chance(
    from_pixel: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = lf.build(scene(CAMERAS["two"]))

    def missed(tables: Any, ghosts: Any) -> Any:
        trace = coarse_trace(tables, ghosts)
        names = ("at_sines", "to_array") if from_pixel else ("of_kinds",)
        return trace._replace(**{name: _dark(getattr(trace, name)) for name in names})

    monkeypatch.setattr(ghost_aim, "coarse_trace", missed)
    ghosts = ghost_aim.ghost_tables(world.aimed_tables, None, 64 + from_pixel)
    assert ghosts is not None
    assert 0.0 < ghosts.share_anew < 1.0
    assert (np.diff(ghosts.until[:-1], prepend=0.0, axis=1) > 0.0).all(axis=0).tolist() == (~ghosts.anew).tolist()
    assert (np.diff(ghosts.until_anew, prepend=0.0) > 0.0).tolist() == ghosts.anew.tolist()


@pytest.mark.parametrize("missed", [0, 1], ids=["by their angles", "to the array"])
def test_light_that_one_way_of_drawing_directions_has_missed_counts_by_the_other(missed: int) -> None:
    world = lf.build(scene(CAMERAS["two"]))
    assert world.ghosts is not None
    trace = coarse_trace(world.aimed_tables, world.ghosts)
    dark = trace._replace(at_sines=_dark(trace.at_sines), to_array=_dark(trace.to_array))
    one = dark._replace(to_array=trace.to_array) if missed == 0 else dark._replace(at_sines=trace.at_sines)
    tables = world.aimed_tables, None, world.ghosts
    assert ghost_aim.with_chances(*tables, one).share_anew > ghost_aim.LEAST_ANEW
    assert ghost_aim.with_chances(*tables, dark).share_anew == ghost_aim.LEAST_ANEW


@pytest.mark.parametrize("dz", [-1e-12, -1e-160, -5e-324])
def test_rays_that_graze_the_lens_are_of_a_kind(dz: float) -> None:
    """Where they cross the planes is farther than any integer, or than any number."""
    ghosts = lf.build(scene(CAMERAS["two"])).ghosts
    assert ghosts is not None
    assert 0 <= kind_of_ray(ghosts, 1.0, 0.0, 5.0, 1.0, 1e-3, dz) < len(ghosts.until) - 1
