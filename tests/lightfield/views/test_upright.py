"""Which way up a picture is: what real rays say of the lens, and maps that agree with the picture itself."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.lightfield.rays.lens_alone import lens_alone
from lfmesh.lightfield.views.upright import Upright

BOTH = pytest.mark.parametrize("upright", [Upright(inverts=True), Upright(inverts=False)], ids=["inverting", "erect"])

FRONT = {"radius_mm": 50.0, "thickness_mm": 4.0, "index": 1.5, "semi_diameter_mm": 14.0}
BACK = {"radius_mm": -50.0, "semi_diameter_mm": 14.0}


def scene(surfaces: list[dict[str, Any]], array_mm: float | None = None, focus_mm: float | None = None) -> lf.Scene:
    mla = {"count": (8, 8), "pitch_mm": 0.125, "focal_length_mm": 0.7, "index": 1.5, "thickness_mm": 0.3}
    camera: dict[str, Any] = {
        "lens": {"surfaces": surfaces},
        "mla": {**mla, "distance_mm": array_mm},
        "sensor": {"pixels": (80, 80), "pixel_mm": 0.0125},
    }
    if focus_mm is not None:
        camera["focus_mm"] = focus_mm
    return lf.solved(lf.Scene(camera=camera))


def stop(thickness_mm: float) -> dict[str, Any]:
    return {"stop": True, "thickness_mm": thickness_mm, "semi_diameter_mm": 2.0}


def relay(gap_mm: float = 196.0) -> list[dict[str, Any]]:
    return [stop(1.0), FRONT, {**BACK, "thickness_mm": gap_mm}, FRONT, BACK]


CASES: dict[str, tuple[lf.Scene, bool]] = {
    "one lens": (scene([stop(1.0), FRONT, BACK], focus_mm=400.0), True),
    "stop imaged behind the array": (scene([stop(100.0), FRONT, BACK], focus_mm=400.0), True),
    "exit pupil near infinity": (scene([stop(49.32), FRONT, BACK], focus_mm=400.0), True),
    "relay": (scene(relay(), focus_mm=100.0), False),
    "relay of longer distances": (scene(relay(250.0), focus_mm=130.0), False),
    "relay focused at infinity": (scene(relay(), array_mm=75.7033), False),
    "focused beyond infinity": (scene([stop(1.0), FRONT, BACK], array_mm=45.0), True),
}


@pytest.mark.parametrize("case", CASES)
def test_a_lens_inverts_where_real_rays_of_objects_land_on_the_other_side(case: str) -> None:
    """Rays through the middle of the entrance pupil from points beside the axis; the nearest has a real image."""
    made, expected = CASES[case]
    assert Upright.of(made).inverts is expected
    pupil = np.array([0.0, 0.0, lf.first_order(made).entrance_pupil_z_mm])
    focus = lf.first_order(made).object_distance_mm
    for distance in (focus if 0.0 < focus < 1e4 else 1000.0, 2000.0):
        point = np.array([0.004 * distance, 0.002 * distance, -distance])
        paths = lf.trace(lens_alone(made), [point + 0.5 * (pupil - point)], [pupil - point], split="transmit")
        assert paths.status[0] == lf.Status.SENSOR
        landed = paths.position[0, :2]
        assert np.sign(landed).tolist() == ([-1.0, -1.0] if expected else [1.0, 1.0])


@pytest.mark.parametrize("name", sorted(path.name for path in asset_path("scenes").glob("*.toml")))
def test_cameras_that_come_with_lfmesh_invert_unless_their_lenslets_image_upright(name: str) -> None:
    scene = lf.load(asset_path("scenes") / name)
    assert Upright.of(scene).inverts == (lf.first_order(scene).relay_magnification is None)


def test_an_element_given_as_a_mesh_is_measured_first(tmp_path: Path) -> None:
    made = CASES["one lens"][0]
    trimesh.creation.icosphere(subdivisions=3, radius=20.0).export(tmp_path / "ball.stl")
    element = {"refractor": {"file": (tmp_path / "ball.stl").as_posix(), "units": "mm", "index": 1.5}}
    assert Upright.of(made.changed({"camera.lens": {"surfaces": [stop(1.0), element]}})).inverts


@BOTH
def test_every_map_is_its_own_inverse_and_agrees_with_the_picture(upright: Upright) -> None:
    shape = (5, 7)
    raw = np.arange(35).reshape(shape)
    picture = upright.picture(raw)
    assert np.shares_memory(picture, raw), "large images are not copied"
    np.testing.assert_array_equal(upright.picture(picture), raw)
    np.testing.assert_array_equal(raw[np.ix_(upright.rows(5), upright.columns(7))], picture)
    for row, column in np.ndindex(shape):
        seen = upright.pixel(row, column, shape)
        assert picture[seen] == raw[row, column]
        assert upright.pixel(*seen, shape) == (row, column)
        x, y = upright.points_px(np.array([column + 0.25, row - 0.125]), shape)
        assert (y, x) == (seen[0] - 0.125 * upright.senses[1], seen[1] + 0.25 * upright.senses[0])
    rows, columns = range(1, 3), range(2, 6)
    seen_rows, seen_columns = upright.box(rows, columns, shape)
    assert set(picture[np.ix_(seen_rows, seen_columns)].ravel()) == set(raw[np.ix_(rows, columns)].ravel())
    assert upright.box(seen_rows, seen_columns, shape) == (rows, columns)


@BOTH
def test_an_image_is_turned_once(upright: Upright) -> None:
    """One axis is reversed and the other is not: two would mirror what the lens has turned already."""
    assert math.prod(upright.senses) == -1.0
