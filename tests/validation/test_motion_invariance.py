"""Motions that change no picture, and a turning target against the mean of pictures at rest.

Pictures of two scenes come from different seeds and are compared by the scatter over them.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image as Picture
from scipy.spatial.transform import Rotation

import lfmesh as lf
from lfmesh.geometry import frame
from tests.cameras import close_up_camera
from tests.instances import instances
from tests.renders import by_seed, unchecked
from tests.validation.motion_scenes import (
    DURATION_S,
    Array,
    Tables,
    assert_same,
    exposure,
    profiles,
    stack,
)
from tests.validation.test_forward_equals_adjoint import squares

SEEDS, OTHER_SEEDS = range(16), range(1000, 1016)

PAINTED: Tables = {"reflectance": 0.8, "texture": "chart.png"}
CHART: Tables = {
    "shape": {"kind": "plane", "width_mm": 7.0, "height_mm": 6.0}, "position_mm": (0.0, 0.0, -60.0), "material": PAINTED
}  # fmt: skip
GLOWING: Tables = CHART | {"material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0, "texture": "chart.png"}}
BOX: Tables = {
    "shape": {"kind": "box", "size_mm": (1.2, 1.0, 1.5)}, "position_mm": (0.8, -0.6, -57.0),
    "rotation_deg": (20.0, 10.0, 30.0), "material": {"reflectance": 0.5},
}  # fmt: skip
DISK: Tables = {"kind": "disk", "position_mm": (15.0, 5.0, -40.0), "direction": (-15.0, -5.0, -20.0),
                "radius_mm": 4.0, "power_w": 1.0}  # fmt: skip
FOG: Tables = {
    "bounds": {"kind": "sphere", "radius_mm": 2.0}, "position_mm": (-0.8, 0.5, -52.0), "absorption_per_mm": 0.05,
    "scattering_per_mm": 0.05,
}  # fmt: skip
GLASS: Tables = {
    "refractor": {"box_mm": (9.0, 9.0, 2.0), "index": 1.5}, "position_mm": (0.0, 0.0, -48.0),
    "rotation_deg": (10.0, 20.0, 0.0),
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a coarse chart that looks like none of its mirror images."""
    there = tmp_path_factory.mktemp("motions")
    levels = np.random.default_rng(5).integers(40, 256, (5, 6)).astype(np.uint8)
    levels[0, 0], levels[-1, 1] = 0, 255
    Picture.fromarray(levels).save(there / "chart.png")
    return there


def scene_of(folder: Path, *targets: Tables, **tables: Any) -> lf.Scene:
    """Return a plenoptic camera close to targets, by default under a disk lamp."""
    settings = {"split": "transmit", "threads": 1, "samples": 64, "replicates": 1} | tables.pop("transport", {})
    own = {"camera": close_up_camera(), "targets": list(targets), "lights": [DISK], "transport": settings} | tables
    return lf.Scene(**own).in_folder(folder)


# Everything moves

SCREW = frame.frame((6.0, -9.0, 14.0), (0.7, -1.1, 0.4))
"""Motion in the exposure, world frame."""


def carried(keys: Tables, at: str = "position_mm", turned: str = "rotation_deg") -> Tables:
    """Return the keys of an object with poses that carry it along SCREW."""
    position, angles = (np.array(keys.get(key, (0.0, 0.0, 0.0)), np.float64) for key in (at, turned))
    first = {"time_s": 0.0, at: position.tolist(), turned: angles.tolist()}
    last = {
        "time_s": DURATION_S, at: frame.points(SCREW, position).tolist(),
        turned: frame.tilt_of(SCREW[:, :3] @ frame.rotation(angles)),
    }  # fmt: skip
    return keys | {"motion": {"poses": [first, last]}}


def screwed(lamp: Tables) -> Tables:
    """Return the keys of a lamp that moves along SCREW, as a spin about a point of its axis and a slide along it."""
    turn, shift = SCREW[:, :3], SCREW[:, 3]
    vector = Rotation.from_matrix(turn).as_rotvec()
    axis = vector / np.linalg.norm(vector)
    slide = axis * (axis @ shift)
    centre, *_ = np.linalg.lstsq(np.eye(3) - turn, shift - slide)
    motion = {
        "velocity_mm_s": (slide / DURATION_S).tolist(), "spin_deg_s": (np.rad2deg(vector) / DURATION_S).tolist(),
        "center_mm": centre.tolist(),
    }  # fmt: skip
    return lamp | {"motion": motion}


def all_carried(scene: lf.Scene, lamp: Tables) -> lf.Scene:
    """Return a scene whose camera, targets, media and lamp move as one rigid body."""
    tables = scene.model_dump(exclude_unset=True)
    motion = carried(tables["camera"].get("pose", {}), "shift_mm", "tilt_deg")["motion"]
    return scene.changed(
        {
            "exposure": exposure(),
            "camera.motion": motion,
            "targets": [carried(target) for target in tables["targets"]],
            "media": [carried(medium) for medium in tables.get("media", [])],
            "lights": [screwed(lamp)],
        }
    )


ALL: dict[str, tuple[list[Tables], Tables, dict[str, Any]]] = {
    # Targets, a lamp, and other tables.
    "a lit box": ([CHART, BOX], DISK, {}),
    "fog": ([CHART], DISK, {"media": [FOG], "transport": {"samples": 128}}),
    "glass": ([CHART, GLASS], DISK, {"transport": {"samples": 256}}),
    "a posed camera": (
        [CHART, BOX], DISK,
        {"camera": close_up_camera() | {"pose": {"shift_mm": (0.2, -0.1, 0.3), "tilt_deg": (0.4, -0.5, 3.0)}}},
    ),
    "polarised light": (
        [CHART, GLASS | {"rotation_deg": (40.0, 30.0, 0.0)}], DISK,
        {"camera": close_up_camera() | {"polariser_deg": 30.0}, "transport": {"polarisation": True, "samples": 256}},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ALL)
def test_one_motion_of_everything_changes_nothing(name: str, folder: Path) -> None:
    targets, lamp, tables = ALL[name]
    still = scene_of(folder, *targets, lights=[lamp], **tables)
    assert_same(profiles(stack(all_carried(still, lamp), SEEDS)), profiles(stack(still, OTHER_SEEDS)), 0.02)


def test_one_motion_of_everything_changes_nothing_in_the_forward_method(folder: Path) -> None:
    still = scene_of(folder, CHART, BOX, lights=[DISK], transport={"method": "forward", "samples": 256})
    assert_same(profiles(stack(all_carried(still, DISK), SEEDS)), profiles(stack(still, OTHER_SEEDS)), 0.02)


def test_only_relative_motion_counts(folder: Path) -> None:
    """A camera and a lamp that fly past a scene see what passes them as it flies."""
    steady = {"motion": {"velocity_mm_s": (90.0, -60.0, 40.0)}}
    against = {"motion": {"velocity_mm_s": (-90.0, 60.0, -40.0)}}
    one = scene_of(folder, CHART | steady, BOX | steady, exposure=exposure())
    other = scene_of(
        folder, CHART, BOX, exposure=exposure(), lights=[DISK | against], camera=close_up_camera() | against
    )
    assert_same(profiles(stack(one, SEEDS)), profiles(stack(other, OTHER_SEEDS)), 0.01)


def test_a_field_may_fly_with_the_camera(folder: Path) -> None:
    """Past a chart at rest, as a chart that flies past both."""
    steady, against = ({"motion": {"velocity_mm_s": (sign * 90.0, -sign * 60.0, 0.0)}} for sign in (1.0, -1.0))
    lens = {"kind": "radial_n2", "index": 1.0005, "coefficients": [-1e-5]}
    field = {"bounds": {"kind": "box", "size_mm": [8.0, 8.0, 8.0]}, "position_mm": (0.0, 0.0, -30.0), "index": lens}
    one = scene_of(folder, GLOWING | steady, media=[field], lights=[], exposure=exposure())
    other = scene_of(
        folder, GLOWING, media=[field | against], lights=[], exposure=exposure(), camera=close_up_camera() | against
    )
    assert_same(profiles(stack(one, SEEDS)), profiles(stack(other, OTHER_SEEDS)), 0.01)


# Motions that show nothing

BALL: Tables = {"shape": {"kind": "sphere", "radius_mm": 1.5}, "position_mm": (0.3, -0.2, -57.0)}
LENS_BALL: Tables = {
    "refractor": {"shape": {"kind": "sphere", "radius_mm": 1.5}, "index": 1.5}, "position_mm": (0.3, -0.2, -50.0)
}  # fmt: skip
SPIN: Tables = {"motion": {"spin_deg_s": (3000.0, -20000.0, 9000.0)}}
REST: Tables = {"motion": {"velocity_mm_s": (1e-9, 0.0, 0.0), "spin_deg_s": (0.0, 0.0, 1e-9)}}
GLIDES: Tables = {"motion": {"velocity_mm_s": (frame.rotation(GLASS["rotation_deg"]) @ [80.0, 50.0, 0.0]).tolist()}}
"""Along the faces of GLASS, which is wider than the camera's view."""

FAR: Tables = {
    "shape": {"kind": "sphere", "radius_mm": 50.0}, "position_mm": (4000.0, 0.0, -3000.0),
    "material": {"reflectance": 0.0}, "motion": {"velocity_mm_s": (0.0, 3e4, 0.0), "spin_deg_s": (0.0, 9000.0, 0.0)},
}  # fmt: skip

EVEN: Tables = {
    "shape": {"kind": "plane", "width_mm": 30.0, "height_mm": 30.0}, "position_mm": (0.0, 0.0, -60.0),
    "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
}  # fmt: skip

NOTHING: dict[str, tuple[list[Tables], list[Tables], dict[str, Any], dict[str, Any]]] = {
    # Targets in motion and at rest, other tables in motion, settings.
    "a ball that spins": ([CHART, BALL | SPIN], [CHART, BALL], {}, {}),
    "a ball of glass that spins": ([CHART, LENS_BALL | SPIN], [CHART, LENS_BALL], {}, {"samples": 96}),
    # In front of a chart that shines: light of the lamp that passes its edge would change.
    "a window that glides along itself": (
        [GLOWING, GLASS | GLIDES], [GLOWING, GLASS], {"lights": []}, {"samples": 256}
    ),
    "a body far away": ([CHART, BOX, FAR], [CHART, BOX], {}, {}),
    "a fog that spins": ([CHART], [CHART], {"media": [FOG | SPIN]}, {"samples": 128}),
    "motions without a path": (
        [CHART | REST, BOX | REST], [CHART, BOX], {"media": [FOG | REST], "lights": [DISK | REST]}, {"samples": 128}
    ),
    "a camera that rolls in front of even light": (
        [EVEN], [EVEN],
        {"camera": close_up_camera() | {"motion": {"spin_deg_s": (0.0, 0.0, 9000.0)}}, "lights": []}, {},
    ),
}  # fmt: skip


def pair(name: str, folder: Path, **settings: Any) -> tuple[lf.Scene, lf.Scene]:
    """Return a scene with a motion that shows nothing, and the same at rest."""
    moving, resting, tables, own = NOTHING[name]
    still = {
        key: [{k: v for k, v in thing.items() if k != "motion"} for thing in value] if key != "camera"
        else {k: v for k, v in value.items() if k != "motion"}
        for key, value in tables.items()
    }  # fmt: skip
    return (
        scene_of(folder, *moving, exposure=exposure(), transport=own | settings, **tables),
        scene_of(folder, *resting, transport=own | settings, **still),
    )


@pytest.mark.parametrize("name", NOTHING)
def test_a_motion_that_shows_nothing_changes_nothing(name: str, folder: Path) -> None:
    moving, resting = pair(name, folder)
    assert_same(profiles(stack(moving, SEEDS)), profiles(stack(resting, OTHER_SEEDS)), 0.02)


FORWARD = ("a ball that spins", "a ball of glass that spins")


@pytest.mark.parametrize("name", instances(FORWARD, long=FORWARD[1:]))
def test_a_motion_that_shows_nothing_changes_nothing_in_the_forward_method(name: str, folder: Path) -> None:
    moving, resting = pair(name, folder, method="forward", samples=256)
    assert_same(profiles(stack(moving, SEEDS)), profiles(stack(resting, OTHER_SEEDS)), 0.03)


def test_rays_that_are_traced_see_the_scene_at_the_begin(folder: Path) -> None:
    moving = scene_of(folder, CHART | SPIN, BOX | SPIN, GLASS | GLIDES, exposure=exposure())
    resting = scene_of(folder, CHART, BOX, GLASS)
    draw = np.random.default_rng(4)
    origins = np.column_stack([draw.uniform(-2.0, 2.0, (500, 2)), np.full(500, -2.0)])
    directions = np.column_stack([draw.uniform(-0.08, 0.08, (500, 2)), np.full(500, -1.0)])
    one, other = (sorted_ends(lf.trace(lf.build(scene), origins, directions)) for scene in (moving, resting))
    np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


def sorted_ends(paths: lf.Paths) -> Array:
    """Return source, status, weight and place of the ends of all packets, in an order of their own, (n, 6)."""
    ends = np.column_stack([paths.source, paths.status, paths.weight, paths.position])
    return np.asarray(ends[np.lexsort(np.round(ends, 6).T)])


# A turning target

SETS, STILLS = 8, 8
TURN_DEG_S = np.array([2500.0, 1200.0, -4000.0])
"""48 degrees in the exposure."""


def turned(keys: Tables, time_s: float) -> Tables:
    """Return a target at rest as it stands at a time of its turn."""
    rotation = Rotation.from_rotvec(np.deg2rad(TURN_DEG_S * time_s)).as_matrix()
    return keys | {"rotation_deg": frame.tilt_of(rotation @ frame.rotation(keys.get("rotation_deg", (0.0, 0.0, 0.0))))}


def test_a_target_that_turns_looks_like_the_mean_of_64_pictures_at_rest(folder: Path) -> None:
    """Eight means of eight pictures each, at random times of as many equal parts of the exposure."""
    body = BOX | {"shape": {"kind": "box", "size_mm": (3.2, 2.4, 2.0)}, "position_mm": (0.0, 0.0, -59.0)}
    moving = scene_of(folder, body | {"motion": {"spin_deg_s": TURN_DEG_S.tolist()}}, exposure=exposure())
    draw = np.random.default_rng(1)
    means = []
    for number in range(SETS):
        times = DURATION_S * (np.arange(STILLS) + draw.uniform(size=STILLS)) / STILLS
        stills = [
            next(iter(by_seed(scene_of(folder, turned(body, time), transport={"samples": 16}), [100 * number + k])))
            for k, time in enumerate(times)
        ]
        means.append(np.mean([image.mean[..., 0] for image in stills], axis=0))
    begun = squares(unchecked(scene_of(folder, body)).mean[None, ..., 0])
    rested, moved = squares(np.array(means)), squares(stack(moving, SEEDS))
    assert np.abs(begun - moved.mean(axis=0)).max() > 0.1 * moved.mean(axis=0).max()
    assert_same(moved, rested, 0.02)
