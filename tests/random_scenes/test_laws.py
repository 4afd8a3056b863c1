"""Laws of light that hold for random cameras and scenes: each compares an image with what another one says of it."""

from collections.abc import Callable, Sequence
from itertools import count, islice
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from tests.random_scenes import meshes, rearranged
from tests.random_scenes.examine import LONGEST_S, judged
from tests.random_scenes.generator import OWN_KERNELS, Drawn, Kind, draw
from tests.random_scenes.judge import Estimate, Verdict, judge
from tests.random_scenes.transforms import Tables, cut, isothermal, moved, scaled, split_sources

SAMPLES, LONG_SAMPLES = 16, 96
"""A pixel, in each of the judge's batches."""

IN_SUITE, LONG = 1, 40
"""Drawn scenes that each law is held against; in the suite one camera and one scene where it is of both."""

F_NUMBERS = (16.0, 32.0, 64.0)

Law = Callable[[Drawn], list[Estimate] | None]


def scene_of(tables: Tables) -> lf.Scene:
    return lf.Scene(**tables).in_folder(asset_path("."))


def stays_where_camera_and_world_are_moved(drawn: Drawn) -> list[Estimate] | None:
    far = drawn.tables["camera"]["focus_mm"]
    tables = moved(drawn.tables, [70.0, -40.0, 130.0], [0.7 * far, -0.2 * far, 0.4 * far])
    return [Estimate("as drawn", (drawn.scene,)), Estimate("moved", (scene_of(tables),))]


def has_the_square_of_the_scale_in_power(drawn: Drawn) -> list[Estimate] | None:
    try:
        tables = scaled(drawn.tables, 7.3)
    except ValueError:  # files have lengths of their own
        return None
    return [Estimate("as drawn", (drawn.scene,)), Estimate("scaled", (scene_of(tables),), 7.3**-2)]


def stays_where_a_target_is_cut_in_two(drawn: Drawn) -> list[Estimate] | None:
    tables = cut(drawn.tables)
    if tables is None:
        return None
    return [Estimate("as drawn", (drawn.scene,)), Estimate("cut", (scene_of(tables),))]


def is_the_sum_of_those_of_its_sources(drawn: Drawn) -> list[Estimate] | None:
    parts = split_sources(drawn.tables)
    if parts is None:
        return None
    return [Estimate("as drawn", (drawn.scene,)), Estimate("sum", tuple(map(scene_of, parts)))]


def is_black_in_an_isothermal_room(drawn: Drawn) -> list[Estimate] | None:
    if "camera_pose" in drawn.features:
        return None
    room, black = isothermal(drawn.tables)
    return [Estimate("black wall", (scene_of(black),)), Estimate("room", (scene_of(room),))]


def falls_with_the_square_of_the_f_number(drawn: Drawn) -> list[Estimate] | None:
    """On the axis of a camera without array, the stop changed alone; the law is paraxial, and may be off by 1 %."""
    camera = drawn.tables["camera"]
    if "mla" in camera or {"vignetting_rim", "edge_in_the_field", "sphere", "tilted_sensor"} & set(drawn.features):
        return None
    pixel = 1e-3 * abs(lf.first_order(drawn.scene).efl_mm)
    # Reflections in the lens look past the target from a wide stop, and less from a small one.
    changes = {"camera.sensor.pixels": (2, 2), "camera.sensor.pixel_mm": pixel, "transport.split": "transmit"}
    small = drawn.scene.changed(changes)
    scenes = [(n, small.changed({"camera.lens.f_number": n})) for n in (8.0, *F_NUMBERS)]
    return [Estimate(f"f/{n:g}", (scene,), (n / 8.0) ** 2, slack=0.01) for n, scene in scenes]


def both_methods(drawn: Drawn, images: dict[str, Tables]) -> list[Estimate]:
    """Return estimates of images: adjoint of scenes with even numbers, and forward of the others."""
    if drawn.number % 2 == 0:
        return [Estimate(name, (scene_of(tables),)) for name, tables in images.items()]
    forward = {"transport.method": "forward"}
    return [Estimate(name, (scene_of(tables).changed(forward),), 1.0, 4) for name, tables in images.items()]


def stays_where_facets_are_divided(drawn: Drawn) -> list[Estimate] | None:
    """Each facet of every mesh divided into four, and one facet of each into three."""
    one = meshes.one_divided(np.random.default_rng(drawn.number))
    changes = {"as meshes": None, "each in four": meshes.in_four, "one divided": one}
    folds = {name: np.random.default_rng(drawn.number) for name in changes}
    images = {name: meshes.as_meshes(drawn.tables, folds[name], change) for name, change in changes.items()}
    return both_methods(drawn, images)


def stays_where_lists_are_in_another_order(drawn: Drawn) -> list[Estimate] | None:
    """Targets, lamps, media, tanks, particles, and the facets of each mesh."""
    draw, fold, again = (np.random.default_rng(drawn.number) for _ in range(3))
    whole = meshes.as_meshes(drawn.tables, fold)
    other = meshes.as_meshes(drawn.tables, again, meshes.in_another_order(draw))
    return both_methods(drawn, {"as meshes": whole, "permuted": rearranged.in_another_order(other, draw)})


def stays_where_a_medium_is_cut_in_two(drawn: Drawn) -> list[Estimate] | None:
    scenes = rearranged.halved_media(drawn.tables)
    if scenes is None:
        return None
    return both_methods(drawn, dict(zip(("whole", "halves"), scenes, strict=True)))


def stays_where_a_lamp_is_cut_in_two(drawn: Drawn) -> list[Estimate] | None:
    whole = rearranged.with_sizes(drawn.tables)
    halves = rearranged.halved_lamps(whole)
    if halves is None:
        return None
    return both_methods(drawn, {"whole": whole, "halves": halves})


def stays_before_something_black(drawn: Drawn) -> list[Estimate] | None:
    """Without fog, which would light the fog before the black from beyond it."""
    if {"camera_pose", "fog"} & set(drawn.features):
        return None
    tables = rearranged.with_black_behind(drawn.tables)
    return both_methods(drawn, {"as drawn": drawn.tables, "black behind": tables})


def applicable(law: Law, kind: Kind, number: int, without: frozenset[str]) -> list[Estimate]:
    """Return the estimates of a law for the number-th drawn scene that it says something of."""
    said = (law(draw(kind, n, without)) for n in count())
    return next(islice((estimates for estimates in said if estimates is not None), number, None))


def verdict_on(law: Law, kind: Kind, number: int, without: frozenset[str], samples: int) -> tuple[Verdict, str]:
    estimates = applicable(law, kind, number, without)
    texts = (f"# {e.name}\n{scene.dump_toml()}" for e in estimates for scene in e.scenes)
    return judge(estimates, samples), "\n".join(texts)


LAWS: Sequence[tuple[Law, Kind]] = [
    (stays_where_camera_and_world_are_moved, "camera"),
    (stays_where_camera_and_world_are_moved, "scene"),
    (has_the_square_of_the_scale_in_power, "camera"),
    (has_the_square_of_the_scale_in_power, "scene"),
    (stays_where_a_target_is_cut_in_two, "scene"),
    (is_the_sum_of_those_of_its_sources, "scene"),
    (is_black_in_an_isothermal_room, "scene"),
    (falls_with_the_square_of_the_f_number, "camera"),
    (stays_where_facets_are_divided, "scene"),
    (stays_where_lists_are_in_another_order, "scene"),
    (stays_where_a_medium_is_cut_in_two, "scene"),
    (stays_where_a_lamp_is_cut_in_two, "scene"),
    (stays_before_something_black, "scene"),
]

NO_SIZES = pytest.mark.skipif(
    not {"LineLight", "RectangleLight"} <= set(dir(lf)), reason="lamps that can be halved are not there yet"
)


def cases() -> list[Any]:
    """Every law for one drawn scene of a kind in the suite, and for more of them in the long tests."""
    return [
        pytest.param(
            law, kind, number, id=f"{law.__name__}-{kind}-{number}",
            marks=[pytest.mark.long] * (number >= IN_SUITE) + [NO_SIZES] * (law is stays_where_a_lamp_is_cut_in_two),
        )
        for law, kind in LAWS
        for number in range(LONG)
    ]  # fmt: skip


@pytest.mark.parametrize(("law", "kind", "number"), cases())
def test_the_image(law: Law, kind: Kind, number: int) -> None:
    in_suite = number < IN_SUITE
    without = OWN_KERNELS if in_suite else frozenset()
    samples = SAMPLES if in_suite else LONG_SAMPLES
    verdict, text = judged(LONGEST_S, verdict_on, law, kind, number, without, samples)
    assert not verdict.silent, f"{verdict}\n\n{text}"
