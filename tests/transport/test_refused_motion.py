"""Motions through glass or into the camera are refused with the objects and the time; all others are built."""

from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from tests.cameras import camera_without_array, close_up_camera

EXPOSURE = {"duration_s": 0.1}
TANK = {
    "size_mm": [60.0, 60.0, 60.0],
    "wall_mm": 5.0,
    "wall": {"index": 1.5},
    "liquid": {"index": 1.33},
    "position_mm": [0.0, 0.0, -150.0],
}


def build(**tables: Any) -> lf.World:
    return lf.build(lf.Scene(**{"camera": camera_without_array(), "exposure": EXPOSURE} | tables), aimed=False)


def going(x: float, y: float = 0.0, z: float = 0.0) -> dict[str, Any]:
    return {"velocity_mm_s": [x, y, z]}


def ball(place_mm: list[float], motion: dict[str, Any] | None = None, radius_mm: float = 5.0) -> dict[str, Any]:
    table = {"shape": {"kind": "sphere", "radius_mm": radius_mm}, "position_mm": place_mm}
    return table | ({} if motion is None else {"motion": motion})


def glass_ball(place_mm: list[float], motion: dict[str, Any] | None = None, radius_mm: float = 5.0) -> dict[str, Any]:
    table = ball(place_mm, motion, radius_mm)
    return table | {"refractor": {"shape": table.pop("shape"), "index": 1.5}}


def test_a_target_may_move_in_a_liquid_up_to_its_walls() -> None:
    build(tanks=[TANK], targets=[ball([0.0, 0.0, -150.0], going(190.0))])
    # The wall is 20 mm from the ball.
    with pytest.raises(lf.SceneError, match=r"tanks\[0\] .* and targets\[0\] touch at t = 0\.09\d+ s, before the expo"):
        build(tanks=[TANK], targets=[ball([0.0, 0.0, -150.0], going(210.0))])


def test_a_tank_may_move_with_all_that_it_holds() -> None:
    moving = TANK | {"motion": going(300.0, 20.0)}
    build(tanks=[moving], targets=[ball([0.0, 0.0, -150.0], going(300.0, 20.0))])
    with pytest.raises(lf.SceneError, match="touch at t ="):
        build(tanks=[moving], targets=[ball([0.0, 0.0, -150.0])])


@pytest.mark.parametrize(
    "motion",
    [
        {"spin_deg_s": [10.0, 0.0, 30.0]},
        {
            "poses": [
                {"time_s": 0.0},
                {"time_s": 0.1, "position_mm": [5.0, 1.0, -150.0], "rotation_deg": [3.0, 7.0, 0.0]},
            ]
        },
    ],
)
def test_wall_and_liquid_of_a_tank_move_as_one(motion: dict[str, Any]) -> None:
    turned = {"open": "top", "rotation_deg": [0.0, 20.0, 5.0]}
    dye = {"inside": "tanks[0] liquid", "scattering_per_mm": 0.01}
    build(tanks=[TANK | turned | {"motion": motion}], media=[dye])


def test_targets_may_pass_through_each_other() -> None:
    build(targets=[ball([0.0, 0.0, -150.0]), ball([-20.0, 0.0, -150.0], going(400.0))])


def test_glass_inside_glass_must_move_with_it() -> None:
    motion = going(50.0)
    outer, inner = glass_ball([0.0, 0.0, -150.0], motion, 20.0), glass_ball([0.0, 0.0, -150.0], motion)
    build(targets=[outer, inner])
    with pytest.raises(lf.SceneError, match=r"targets\[1\] lies inside targets\[0\], and they move differently"):
        build(targets=[outer, glass_ball([0.0, 0.0, -150.0])])


def test_glass_may_pass_glass_without_touching() -> None:
    build(targets=[glass_ball([0.0, 0.0, -150.0]), glass_ball([-20.0, 10.1, -150.0], going(400.0))])
    with pytest.raises(lf.SceneError, match=r"targets\[0\] and targets\[1\] touch at t = 0\.0\d+ s"):
        build(targets=[glass_ball([0.0, 0.0, -150.0]), glass_ball([-20.0, 9.9, -150.0], going(400.0))])


def test_glass_may_turn_on_a_table() -> None:
    glass = {"shape": {"kind": "cylinder", "radius_mm": 20.0, "height_mm": 30.0}, "index": 1.5}
    vase = {"refractor": glass, "position_mm": [0.0, 0.0, -150.0], "rotation_deg": [90.0, 0.0, 0.0]}
    table = {"shape": {"kind": "box", "size_mm": [200.0, 10.0, 100.0]}, "position_mm": [0.0, -20.01, -150.0]}
    build(targets=[vase | {"motion": {"spin_deg_s": [0.0, 3600.0, 0.0]}}, table])
    with pytest.raises(lf.SceneError, match=r"targets\[0\] and targets\[1\] touch at t = 0\.0\d+ s"):
        build(targets=[vase | {"motion": {"spin_deg_s": [0.0, 3600.0, 5.0]}}, table])


def test_more_motions_than_packets_can_tell_apart_are_refused() -> None:
    lamps = [
        {"kind": "point", "position_mm": [k - 60.0, 0.0, -150.0], "power_w": 1.0, "motion": going(k + 1.0)}
        for k in range(121)
    ]
    with pytest.raises(lf.SceneError, match="more than 120 things move differently relative to the camera"):
        build(lights=lamps)


def test_a_lamp_may_not_enter_glass() -> None:
    lamp = {"kind": "point", "position_mm": [50.0, 0.0, -150.0], "power_w": 1.0}
    build(targets=[glass_ball([0.0, 0.0, -150.0])], lights=[lamp | {"motion": going(-440.0)}])
    with pytest.raises(lf.SceneError, match=r"targets\[0\] and lights\[0\].* touch at t = 0\.09\d+ s"):
        build(targets=[glass_ball([0.0, 0.0, -150.0])], lights=[lamp | {"motion": going(-460.0)}])


def test_the_edge_of_a_medium_may_not_cross_glass() -> None:
    fog = {
        "bounds": {"kind": "sphere", "radius_mm": 20.0},
        "scattering_per_mm": 0.01,
        "position_mm": [0.0, 0.0, -150.0],
    }
    build(media=[fog], targets=[glass_ball([0.0, 0.0, -150.0], going(100.0))])
    with pytest.raises(lf.SceneError, match=r"targets\[0\] and media\[0\] touch at t = 0\.0[67]\d+ s"):
        build(media=[fog], targets=[glass_ball([0.0, 0.0, -150.0], going(200.0))])


def test_particles_may_not_flow_through_glass() -> None:
    jet = {
        "count": 50,
        "bounds": {"kind": "box", "size_mm": [10.0, 10.0, 10.0]},
        "position_mm": [0.0, 0.0, -150.0],
        "intensity_w_sr": 1.0,
        "displacement": {"kind": "uniform", "vector_mm": [15.0, 0.0, 0.0]},
    }
    build(tanks=[TANK], particles=[jet | {"frame_time_s": 0.1}])
    with pytest.raises(lf.SceneError, match=r"tanks\[0\] .* and particles\[0\] touch during the exposure; nothing"):
        build(tanks=[TANK], particles=[jet | {"frame_time_s": 0.03}])


def test_nothing_may_move_into_the_camera() -> None:
    build(targets=[ball([0.0, 0.0, -50.0], going(0.0, 0.0, 400.0))])
    with pytest.raises(lf.SceneError, match=r"targets\[0\] and the camera touch at t = 0\.0\d+ s"):
        build(targets=[ball([0.0, 0.0, -50.0], going(0.0, 0.0, 500.0))])
    lamp = {"kind": "point", "position_mm": [0.0, 0.0, -50.0], "power_w": 1.0}
    with pytest.raises(lf.SceneError, match=r"lights\[0\].* and the camera touch"):
        build(lights=[lamp | {"motion": going(0.0, 0.0, 600.0)}])


def test_the_camera_may_not_move_into_objects() -> None:
    def camera(z: float) -> dict[str, Any]:
        return camera_without_array() | {"motion": going(0.0, 0.0, z)}

    build(camera=camera(-400.0), targets=[ball([0.0, 0.0, -50.0])])
    with pytest.raises(lf.SceneError, match=r"targets\[0\] and the camera touch at t = 0\.0\d+ s"):
        build(camera=camera(-500.0), targets=[ball([0.0, 0.0, -50.0])])
    build(camera=camera(-500.0), targets=[ball([0.0, 0.0, -50.0], going(0.0, 0.0, -500.0))])


def test_a_turn_of_the_camera_may_not_move_it_into_objects() -> None:
    beside = [ball([17.0, 0.0, 42.0])]
    turning = {"spin_deg_s": [0.0, 0.0, 0.0], "center_mm": [0.0, 0.0, 0.0]}
    build(camera=close_up_camera() | {"motion": turning | {"spin_deg_s": [0.0, 10.0, 0.0]}}, targets=beside)
    far = {"spin_deg_s": [0.0, 900.0, 0.0], "center_mm": [60.0, 0.0, 0.0]}
    with pytest.raises(lf.SceneError, match=r"targets\[0\] and the camera touch"):
        build(camera=close_up_camera() | {"motion": far}, targets=beside)


def test_a_medium_stays_before_the_first_vertex() -> None:
    fog = {"bounds": {"kind": "sphere", "radius_mm": 20.0}, "scattering_per_mm": 0.01, "position_mm": [0.0, 0.0, -50.0]}
    build(media=[fog | {"motion": going(0.0, 0.0, 299.0)}])
    with pytest.raises(lf.SceneError, match=r"media\[0\] may reach 0\.\d+ mm behind the first lens vertex during"):
        build(media=[fog | {"motion": going(0.0, 0.0, 305.0)}])


def test_particles_stay_before_the_lens() -> None:
    jet = {
        "count": 5,
        "bounds": {"kind": "box", "size_mm": [1.0, 1.0, 1.0]},
        "position_mm": [0.0, 0.0, -50.0],
        "intensity_w_sr": 1.0,
        "displacement": {"kind": "uniform", "vector_mm": [0.0, 0.0, 60.0]},
    }
    build(particles=[jet | {"frame_time_s": 0.2}])
    with pytest.raises(lf.SceneError, match=r"particles\[0\] may reach \d+\.\d+ mm behind the front of the lens"):
        build(particles=[jet | {"frame_time_s": 0.1}])


FIELD = {
    "name": "plume",
    "bounds": {"kind": "box", "size_mm": [20.0, 20.0, 20.0]},
    "index": 1.0005,
    "position_mm": [0.0, 0.0, -100.0],
}


def test_media_that_bend_light_rest_relative_to_the_camera() -> None:
    build(media=[FIELD | {"motion": going(10.0)}], camera=camera_without_array() | {"motion": going(10.0)})
    with pytest.raises(lf.SceneError, match=r"media\[0\]\.motion: media\[0\] \(plume\) bends light, and must rest"):
        build(media=[FIELD | {"motion": going(10.0)}])
    with pytest.raises(lf.SceneError, match=r"camera\.motion: media\[0\] \(plume\) bends light"):
        build(media=[FIELD], camera=camera_without_array() | {"motion": going(10.0)})


def test_glass_stays_outside_media_that_bend_light() -> None:
    build(media=[FIELD], targets=[glass_ball([30.0, 0.0, -100.0], going(-140.0))])
    with pytest.raises(lf.SceneError, match=r"targets\[0\] and media\[0\] \(plume\) touch.*; glass must stay outside"):
        build(media=[FIELD], targets=[glass_ball([30.0, 0.0, -100.0], going(-160.0))])


def test_a_medium_that_fills_a_body_moves_with_it() -> None:
    dye = {"inside": "tanks[0] liquid", "scattering_per_mm": 0.01}
    build(tanks=[TANK | {"motion": going(10.0)}], media=[dye])
    with pytest.raises(lf.SceneError, match=r"media\[0\]\.motion: the medium fills tanks\[0\] liquid, which moves"):
        build(tanks=[TANK], media=[dye | {"motion": going(10.0)}])


def test_models_of_the_camera_are_refused_while_things_move() -> None:
    scene = lf.Scene(camera=close_up_camera(), exposure=EXPOSURE, targets=[ball([0.0, 0.0, -60.0], going(1.0))])  # type: ignore[arg-type]
    with pytest.raises(lf.LfmeshError, match=r"targets\[0\]\.motion: a camera model is that of a camera at rest"):
        lf.camera_model(scene)
    with pytest.raises(lf.LfmeshError, match=r"targets\[0\]\.motion: boards are fitted by cameras and boards at rest"):
        lf.fit_boards(np.ones((20, 20)), scene, [lf.Board(np.ones((20, 20)), square_mm=1.0)])


def test_an_exposure_of_things_at_rest_proves_nothing() -> None:
    build(targets=[glass_ball([0.0, 0.0, -150.0], {"velocity_mm_s": [0.0, 0.0, 0.0]})])


def test_particles_may_travel_with_a_tank() -> None:
    tank = {
        "size_mm": [20.0, 20.0, 20.0], "wall_mm": 1.0, "wall": {"index": 1.5}, "liquid": {"index": 1.33},
        "position_mm": [0.0, 0.0, -100.0], "motion": going(300.0),
    }  # fmt: skip
    dust = {
        "count": 5, "bounds": {"kind": "box", "size_mm": [1.0, 1.0, 1.0]}, "position_mm": [0.0, 0.0, -100.0],
        "intensity_w_sr": 1.0, "frame_time_s": 0.1,
    }  # fmt: skip

    def flowing(by: list[float]) -> dict[str, Any]:
        return dust | {"displacement": {"kind": "uniform", "vector_mm": by}}

    along = np.array(going(300.0)["velocity_mm_s"]) * 0.1
    build(tanks=[tank], particles=[flowing(along.tolist())])
    build(tanks=[tank], particles=[flowing([along[0], 5.0, 0.0])])
    with pytest.raises(lf.SceneError, match=r"and particles\[0\] touch during the exposure"):
        build(tanks=[tank], particles=[flowing([along[0], 15.0, 0.0])])
