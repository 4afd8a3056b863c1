"""What a scene says of absorption, and how it is refused where that cannot be."""

from typing import Any

import pytest

import lfmesh as lf
from lfmesh.errors import LfmeshError
from tests.cameras import biconvex, close_up_camera


def camera(glass: Any, **keys: Any) -> dict[str, Any]:
    """A camera whose lens is of a glass."""
    made = close_up_camera()
    surface = {key: value for key, value in biconvex()["surfaces"][0].items() if key != "index"} | {"glass": glass}
    made["lens"] = {"surfaces": [surface, *biconvex()["surfaces"][1:]]}
    return made | {"absorption": True} | keys


@pytest.mark.parametrize(
    ("glass", "message"),
    [
        ("LZOS/K8", r"surfaces\[0\]\.glass.*camera\.absorption: glass 'LZOS/K8': the catalogue has no internal"),
        ("HIKARI/J-SF03HS", r"extinction is known from 280 to 290 nm; omit it"),
        (
            {"nd": 1.5, "vd": 60.0},
            r"camera\.absorption = true: neither lens, array nor cover has a glass",
        ),
    ],
)
def test_a_glass_of_unknown_transmittance_is_refused_in_one_line(glass: Any, message: str) -> None:
    lf.Scene(camera=camera(glass, absorption=False))
    with pytest.raises(LfmeshError, match=message) as refused:
        lf.Scene(camera=camera(glass))
    assert "\n" not in str(refused.value)


def test_a_cover_of_unknown_transmittance_is_refused_in_one_line() -> None:
    given = camera("SCHOTT/N-BK7")
    given["sensor"] = given["sensor"] | {"cover": {"thickness_mm": 0.02, "gap_mm": 0.02, "glass": "LZOS/K8"}}
    with pytest.raises(LfmeshError, match=r"cover\.glass.*no internal") as refused:
        lf.Scene(camera=given)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (-1.0, r"absorption_per_mm.*-1.0: must be"),
        (float("nan"), r"absorption_per_mm"),
        (True, r"absorption_per_mm"),
        ({"blackbody_k": 3000.0}, r"absorption_per_mm: a coefficient is a number without quotes, a table"),
        ("lots", r'absorption_per_mm = "lots": a coefficient is a number without quotes, a table'),
        ("0.1", r'absorption_per_mm = "0.1": a coefficient is a number without quotes, a table'),
        (
            {"wavelengths_nm": [400.0, 700.0], "values": [0.1, -0.1]},
            r"value -0.1 at 700 nm: it must be a finite number, 0 or more",
        ),
        ({"wavelengths_nm": [600.0, 700.0], "values": [0.1, 0.1]}, r"extends from 600 to 700 nm"),
    ],
)
def test_a_coefficient_that_cannot_be_is_refused_in_one_line(value: Any, message: str) -> None:
    box = {"refractor": {"box_mm": [9.0, 9.0, 9.0], "index": 1.5, "absorption_per_mm": value}}
    with pytest.raises(LfmeshError, match=message) as refused:
        lf.Scene(camera=close_up_camera(), targets=[box | {"position_mm": [0, 0, -50.0]}])
    assert "\n" not in str(refused.value)


def test_a_scene_that_absorbs_is_written_and_read_again() -> None:
    dye = {"wavelengths_nm": [400.0, 700.0], "values": [0.1, 0.2]}
    tank = {"size_mm": [9.0, 9.0, 9.0], "wall_mm": 1.0, "position_mm": [0, 0, -50.0],
            "wall": {"index": 1.5, "absorption_per_mm": 0.1},
            "liquid": {"index": 1.3, "absorption_per_mm": dye}}  # fmt: skip
    scene = lf.Scene(camera=camera("SCHOTT/N-BK7"), tanks=[tank])
    assert lf.loads(scene.dump_toml()) == scene


def test_media_that_absorb_alike_share_a_line_of_the_ledger_and_clear_ones_have_none() -> None:
    boxes = [
        {"refractor": {"box_mm": [9.0, 9.0, 2.0], "index": 1.5, "absorption_per_mm": alpha}, "position_mm": [0, 0, z]}
        for alpha, z in ((0.1, -20.0), (0.0, -30.0), (0.2, -40.0), (0.1, -50.0))
    ]
    world = lf.build(lf.Scene(camera=camera("SCHOTT/N-BK7"), targets=boxes))
    names = [name for name in world.slots if name.startswith("inside ")]
    assert names == ["inside lens[0]", "inside targets[0], targets[3]", "inside targets[2]"]
    clear = lf.build(lf.Scene(camera=camera("SCHOTT/N-BK7", absorption=False), targets=boxes[1:2]))
    assert not any(name.startswith("inside ") for name in clear.slots)
    for tables in (clear.tables.lens, clear.tables.mla, world.tables.mla):
        assert tables.media.absorption is None
    assert not clear.tables.objects.media.absorption.per_mm.any()
