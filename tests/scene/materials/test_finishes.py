"""Finishes in scene files: names and tables, and one clear line for what is wrong."""

from typing import Any

import pytest

from lfmesh.errors import SceneError
from lfmesh.scene import Finish, Refractor, Scene, Surface, first_order, loads
from tests.cameras import SQUARE_ARRAY, biconvex


def glass(**more: Any) -> Refractor:
    return Refractor(file="body.stl", units="mm", index=1.5, **more)


@pytest.mark.parametrize(
    ("given", "finish"),
    [
        ("polished", Finish()),
        ("diffuse", Finish(kind="diffuse")),
        ({"kind": "diffuse"}, Finish(kind="diffuse")),
        ({"kind": "ground", "roughness": 0.1}, Finish(kind="ground", roughness=0.1)),
    ],
    ids=str,
)
def test_a_name_or_a_table_gives_a_finish(given: Any, finish: Finish) -> None:
    assert glass(finish=given).finish == finish
    assert Surface(finish=given).finish == finish


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("ground", r"finish.roughness: missing"),
        ("difuse", r'finish.kind = "difuse": must be .*did you mean \'diffuse\''),
        ({"kind": "diffuse", "roughness": 0.1}, r"finish.roughness = 0.1: omit it"),
        ({"kind": "ground", "roughness": -0.1}, r"finish.roughness = -0.1: must be 0 or more"),
        ({"kind": "ground", "roughness": 1.5}, r"finish.roughness = 1.5: must be 1 or less"),
        ({"kind": "ground", "roughness": float("nan")}, r"finish.roughness = nan: must be a finite number"),
    ],
    ids=str,
)
def test_what_is_wrong_with_a_finish_is_one_line(given: Any, said: str) -> None:
    with pytest.raises(SceneError, match=said) as error:
        glass(finish=given)
    assert "\n" not in str(error.value)


def test_a_rough_face_has_no_coating() -> None:
    with pytest.raises(SceneError, match=r'finish = "diffuse": the face also has coating = "ar"'):
        glass(finish="diffuse", coating="ar")
    assert glass(finish="polished", coating="ar").coating == "ar"


def test_roughness_that_counts_as_polished_is_not_rough() -> None:
    assert [Finish(kind="ground", roughness=r).is_rough for r in (0.0, 0.99e-4, 1e-4, 1.0)] == [
        False,
        False,
        True,
        True,
    ]


def test_a_scene_with_finishes_is_written_and_read_again() -> None:
    mla = SQUARE_ARRAY | {"distance_mm": 12.0, "flat_finish": {"kind": "ground", "roughness": 0.2}}
    lens = biconvex()
    lens["surfaces"][0] |= {"finish": "diffuse"}
    scene = Scene(
        camera={"lens": lens, "mla": mla, "sensor": {"pixels": [20, 20], "pixel_mm": 0.1, "distance_mm": 1.0}}
    )
    again = loads(scene.dump_toml())
    assert again.camera.lens.surfaces[0].finish == Finish(kind="diffuse")
    assert again.camera.mla is not None
    assert again.camera.mla.flat_finish == Finish(kind="ground", roughness=0.2)
    rough = [finish.in_words() for _, finish in again.finishes() if finish.is_rough]
    assert rough == ["diffuse", "ground, roughness 0.2"]
    assert "camera.lens.surfaces[0].finish scatters light" in " ".join(first_order(again).warnings)
