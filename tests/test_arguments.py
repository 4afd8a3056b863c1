"""Public functions say in one line what they need in place of what they are given."""

import pickle
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from tests.study.studies import small_scene

OF_SCENES = ["render", "first_order", "build", "point_spread", "analyse", "calibrate", "white_image", "solved", "draw"]


@pytest.mark.parametrize("name", OF_SCENES)
def test_a_path_in_place_of_a_scene_is_named_with_what_reads_one(name: str) -> None:
    with pytest.raises(lf.LfmeshError) as told:
        getattr(lf, name)("s.toml")
    expected = f"lf.{name} needs Scene for scene, which is 's.toml'; lf.load(\"scene.toml\") reads one"
    assert str(told.value) == expected


@pytest.mark.parametrize(
    ("name", "arguments", "why"),
    [
        ("decode", ("run/",), r"Image for image, which is 'run/'; lf.render\(scene\) makes one, lf.open_run"),
        ("refocus", (3.0,), r"LightField for field, which is of type float; lf.decode\(image\) makes one"),
        ("trace", (small_scene(), None, None), r"World for world, which is of type Scene; lf.build\(scene\) makes one"),
        ("save", ("s.toml", "run/"), r"Image or Scene for content, which is 's.toml'"),
        ("decode", (small_scene(),), "Image for image, which is of type Scene"),
    ],
)
def test_each_kind_is_named(name: str, arguments: tuple[Any, ...], why: str) -> None:
    with pytest.raises(lf.LfmeshError, match=f"^lf.{name} needs {why}"):
        getattr(lf, name)(*arguments)


def test_a_keyword_is_checked_and_none_is_taken_where_it_is_allowed() -> None:
    with pytest.raises(lf.LfmeshError, match=r"needs Scene for scene, which is 's\.toml'"):
        lf.first_order(scene="s.toml")  # type: ignore[arg-type]
    image = lf.render(small_scene(samples=1))
    assert lf.decode(image, None).data.shape == lf.decode(image, scene=image.scene).data.shape


@pytest.mark.parametrize(
    ("value", "shown"),
    [([0.0], "[0.0]"), ("3", '"3"'), ((1.0, 2.0), "(1.0, 2.0)"), ([0] * 99, "[0, 0, 0, 0, 0, 0, ...]")],
)
def test_what_is_no_number_is_named_with_its_parameter(value: Any, shown: str) -> None:
    with pytest.raises(lf.LfmeshError) as told:
        lf.analyse(small_scene(), height_mm=value)
    assert str(told.value) == f"height_mm = {shown}: must be a number"
    with pytest.raises(lf.LfmeshError) as told:
        lf.analyse(small_scene(), across=value)
    assert str(told.value) == f"across = {shown}: must be a whole number"


@pytest.mark.parametrize("kind", [float, int, np.float32, np.int64, np.array])
def test_numbers_of_numpy_are_numbers(kind: Any) -> None:
    with pytest.raises(lf.LfmeshError, match=r"across = 3\S*: must be from 4 to 1000"):
        lf.analyse(small_scene(), across=kind(3))


def test_public_functions_can_be_pickled() -> None:
    assert pickle.loads(pickle.dumps(lf.first_order)) is lf.first_order
