"""Lamps that stand on a surface light what lies before it, as lamps just off the surface do."""

from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.geometry import frame
from lfmesh.transport.packets.packet import OBJECT_FRAME, WORLD_FRAME
from tests.validation.test_sized_lamps import CAMERA, WALL

BLACK = {"material": {"reflectance": 0.0}}
SHEET: dict[str, Any] = BLACK | {"shape": {"kind": "plane", "width_mm": 30.0, "height_mm": 30.0},
                                 "position_mm": [10.0, 0.0, -40.0]}  # fmt: skip
BALL: dict[str, Any] = BLACK | {"shape": {"kind": "sphere", "radius_mm": 4.0}, "position_mm": [10.0, 3.0, -46.0]}
BLOCK: dict[str, Any] = BLACK | {"shape": {"kind": "box", "size_mm": [8.0, 6.0, 4.0]},
                                 "position_mm": [10.0, 3.0, -46.0], "rotation_deg": [10.0, 20.0, 30.0]}  # fmt: skip
OFF = 1e-3
"""Distance, mm, that is surely off a surface, and hardly changes a picture."""


def on(target: dict[str, Any], place: list[float], out: list[float]) -> tuple[list[float], list[float]]:
    """Return a point of a target and its normal in the world, from those in its own frame."""
    own = frame.frame(target.get("rotation_deg", (0.0, 0.0, 0.0)), target["position_mm"])
    normal = frame.directions(own, np.array([out]) / np.linalg.norm(out))[0]
    return frame.points(own, np.array([place]))[0].tolist(), normal.tolist()


TURNED = SHEET | {"rotation_deg": [0.0, -90.0, 0.0]}
ASLANT = SHEET | {"rotation_deg": [0.0, -70.0, 10.0]}
STANDS: dict[str, tuple[dict[str, Any], list[float], list[float]]] = {
    "on a sheet": (TURNED, [-7.0, 2.7, 0.0], [0.0, 0.0, 1.0]),
    "on a sheet aslant": (ASLANT, [-7.0, 0.3, 0.0], [0.0, 0.0, 1.0]),
    "on the back of a sheet": (SHEET | {"rotation_deg": [0.0, 90.0, 0.0]}, [7.0, -3.1, 0.0], [0.0, 0.0, -1.0]),
    "on a ball": (BALL, [-2.0, 2.0, -np.sqrt(8.0)], [-2.0, 2.0, -np.sqrt(8.0)]),
    "on a block": (BLOCK, [-4.0, 1.0, -0.5], [-1.0, 0.0, 0.0]),
}  # fmt: skip


def spot(place: list[float], normal: list[float], off: float) -> dict[str, Any]:
    place = (np.array(place) + off * np.array(normal)).tolist()
    return {"kind": "spot", "position_mm": place, "direction": normal, "half_angle_deg": 80.0, "power_w": 1.0}


def disk(place: list[float], normal: list[float], off: float) -> dict[str, Any]:
    lamp = spot(place, normal, off) | {"kind": "disk", "radius_mm": 0.02}
    del lamp["half_angle_deg"]
    return lamp


def picture(method: str, target: dict[str, Any], lamp: dict[str, Any]) -> lf.Image:
    transport = {"method": method, "samples": 32 if method == "adjoint" else 1024, "replicates": 2, "split": "transmit"}
    return lf.render(lf.Scene(camera=CAMERA, targets=[WALL, target], lights=[lamp], transport=transport))


@pytest.mark.filterwarnings("ignore::lfmesh.TooFewSamplesWarning")
@pytest.mark.parametrize("name", STANDS)
def test_a_lamp_on_a_surface_lights_as_one_just_off_it(name: str) -> None:
    """With the same random numbers, so that pictures differ by the distance alone."""
    target, place, out = STANDS[name]
    place, normal = on(target, place, out)
    lamp = disk if name == "on a sheet" else spot
    for method in ("adjoint", "forward"):
        off = picture(method, target, lamp(place, normal, OFF)).mean
        assert off.sum() > 0.0
        for height in (0.0, -1e-7):
            on_it = picture(method, target, lamp(place, normal, height)).mean
            np.testing.assert_allclose(on_it, off, rtol=1e-3, atol=1e-3 * off.max())


def built(*lights: dict[str, Any], **changes: Any) -> tuple[np.ndarray, list[str]]:
    """Return by how much lamps are moved as a scene is built, (n, 3) mm in the world, and the warnings."""
    scene = lf.Scene(camera=CAMERA, lights=lights, **{"targets": [WALL, TURNED]} | changes)  # type: ignore[arg-type]
    world = lf.build(scene, aimed=False)
    to_object = world.tables.frames[WORLD_FRAME, OBJECT_FRAME]
    given = np.array([light.region.centre_mm for light in scene.lights if light.region is not None])
    shift = world.tables.objects.lamps.rows["position"] - frame.points(to_object, given)
    return frame.directions(frame.inverse(to_object), shift), [str(each) for each in world.warnings]


def point(*place: float) -> dict[str, Any]:
    return {"kind": "point", "position_mm": place, "power_w": 1.0}


def test_a_lamp_off_a_surface_or_beside_it_stays_where_it_is() -> None:
    shift, said = built(point(10.0 - OFF, 0.0, -40.0), point(10.0 + OFF, 1.0, -40.0), point(10.0, 15.1, -40.0))
    assert (shift == 0.0).all()
    assert said == []


@pytest.mark.filterwarnings("ignore::lfmesh.MissedLightWarning")
def test_lamps_that_shine_all_round_move_to_the_front_of_their_surface_and_are_named() -> None:
    shift, said = built(point(10.0, 0.0, -40.0), point(10.0 + 1e-7, 2.0, -40.0), point(0.0, 0.0, -40.0))
    assert (shift[:2, 0] < 0.0).all()
    assert (np.abs(shift) < 1e-4).all()
    assert (shift[2] == 0.0).all()
    assert len(said) == 1
    assert "lights[0] stands on targets[1]" in said[0]
    assert "shines onto it (likewise 1 more light). It is" in said[0]


@pytest.mark.filterwarnings("ignore::lfmesh.MissedLightWarning")
def test_a_lamp_in_a_corner_moves_off_both_surfaces() -> None:
    (shift,), _ = built(point(10.0, 0.0, -60.0), targets=[WALL, TURNED | {"position_mm": [10.0, 0.0, -50.0]}])
    assert shift[0] < 0.0 < shift[2]


@pytest.mark.parametrize("height", [0.0, 1e-6, -1e-6])
def test_a_lamp_on_glass_stays_in_air(height: float) -> None:
    """On any face of a box or a ball, to rounding, whichever way it shines."""
    box = {"refractor": {"box_mm": [8.0, 6.0, 4.0], "index": 1.5}, "position_mm": [10.0, 3.0, -46.0]}
    ball = {
        "refractor": {"shape": {"kind": "sphere", "radius_mm": 4.0}, "index": 1.5},
        "position_mm": [-9.0, 3.0, -46.0],
    }
    middle, half = np.array(box["position_mm"]), np.array([4.0, 3.0, 2.0])
    ways = np.concatenate([np.eye(3), -np.eye(3)])
    places = [middle + 0.2 * np.roll(half, 1) * (way == 0.0) + (half + height) * way for way in ways]
    places += [np.array(ball["position_mm"]) + (4.0 + height) * way for way in ways]
    looks = np.repeat([*ways, *ways], 2, axis=0) * np.tile([1.0, -1.0], 12)[:, None]
    stands = np.repeat(places, 2, axis=0)
    lamps = [(spot, disk)[i % 2](stands[i].tolist(), looks[i].tolist(), 0.0) for i in range(len(stands))]
    shift, said = built(*lamps, targets=[WALL, box, ball])
    outwards = np.einsum("ij,ij->i", shift, np.repeat([*ways, *ways], 2, axis=0))
    assert (height + outwards > 1e-6).all()
    assert said == []


def test_a_panel_moves_off_the_wall_behind_it_and_one_through_a_wall_does_not() -> None:
    panel = {"kind": "rectangle", "position_mm": [10.0, 0.0, -40.0], "width_mm": 3.0, "height_mm": 2.0, "power_w": 1.0}
    shift, _ = built(panel | {"direction": [-1.0, 0.0, 0.0]}, panel | {"direction": [-1.0, 0.3, 0.0]})
    assert shift[0, 0] < 0.0
    assert (shift[1] == 0.0).all()
