"""Rough surfaces of the lens and of the array: both methods show the same.

The camera is small, as rays are not aimed in a camera whose glass scatters.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy import stats

import lfmesh as lf
from lfmesh.errors import SceneError
from tests.cameras import SQUARE_ARRAY, biconvex
from tests.instances import instances
from tests.renders import unchecked

LEVEL = 1e-3
"""Chance that a scene fails though both methods are right; shared by its comparisons (Bonferroni)."""
SQUARE = 10

GROUND = {"kind": "ground", "roughness": 0.2}
GLOW = {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}
CAMERAS: dict[str, dict[str, Any]] = {
    "front of the lens, ground": {"camera.lens.surfaces[0].finish": GROUND},
    "back of the lens, diffuse": {"camera.lens.surfaces[1].finish": "diffuse"},
    "curved face of the array, ground": {"camera.mla.curved_finish": GROUND},
    "flat face of the array, diffuse": {"camera.mla.flat_finish": "diffuse"},
    "both faces, and the lens": {
        "camera.mla.curved_finish": GROUND,
        "camera.mla.flat_finish": {"kind": "ground", "roughness": 0.5},
        "camera.lens.surfaces[1].finish": GROUND,
    },
    "flat facets": {
        "camera.lens.surfaces[0].finish": GROUND,
        "camera.mla.curved_finish": GROUND,
        "transport.surface": "flat",
    },
}
LONG_CAMERAS = ["back of the lens, diffuse", "curved face of the array, ground", "flat facets"]
"""Before a lamp the suite has a ground lens, a diffuse array, and ground faces of both one behind the other."""


def scene(changes: dict[str, Any], width_mm: float = 6.0, **transport: Any) -> lf.Scene:
    """A camera of 20 x 20 pixels behind 4 x 4 lenslets, at a glowing sheet."""
    shape = {"kind": "plane", "width_mm": width_mm, "height_mm": width_mm}
    mla = SQUARE_ARRAY | {"distance_mm": 12.0}
    return lf.Scene(
        camera={
            "lens": biconvex(),
            "mla": mla,
            "sensor": {"pixels": [20, 20], "pixel_mm": 0.1, "distance_mm": 1.5},
        },
        targets=[{"shape": shape, "position_mm": [0.5, 0.0, -20.0], "material": GLOW}],
        transport={"split": "both", "threads": 1, **transport},
    ).changed(changes)


def squares(given: lf.Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return the light in squares of pixels and in all of them, and its standard errors, W; pixels are independent."""
    image = unchecked(given)
    for ledger in (image.ledger, image.ledger.lamps):
        assert ledger is None or abs(ledger.imbalance) < 1e-12
    assert sum(image.ledger.lost.values()) <= 1e-7 * image.ledger.emitted

    def sums(values: np.ndarray) -> np.ndarray:
        parts = values.reshape(20 // SQUARE, SQUARE, 20 // SQUARE, SQUARE).sum(axis=(1, 3)).ravel()
        return np.append(parts, parts.sum())

    return sums(image.mean[..., 0]), np.sqrt(sums(image.stderr[..., 0] ** 2))


def agree(first: lf.Scene, second: lf.Scene) -> None:
    """Assert that two scenes give one picture: two-sided z-tests, the squares and the whole."""
    (one, error), (other, its_error) = squares(first), squares(second)
    both = np.hypot(error, its_error)
    assert both[-1] < 0.08 * one[-1], (one, both)
    p = 2.0 * stats.norm.sf(np.abs(one - other) / both)
    assert p.min() > LEVEL / len(p), (one, other, both)


@pytest.mark.parametrize(
    "name", instances(CAMERAS, long=["back of the lens, diffuse", "curved face of the array, ground"])
)
def test_forward_equals_adjoint(name: str) -> None:
    """Two-sided z-tests of the squares and of the whole; a diffuse lens is below, before a point lamp."""
    more = 4 if "diffuse" in name else 1
    given = scene(CAMERAS[name], samples=more * 512, replicates=32)
    agree(given, given.changed({"transport.method": "forward"}))


def test_a_lamps_light_off_a_target_comes_through_ground_glass_alike_in_both_methods() -> None:
    """Two-sided z-tests, as above: a lamp lights a matt sheet, not the ground front through which the sheet is seen."""
    lamp = {"kind": "spot", "position_mm": (6.0, 4.0, -14.0), "direction": (-5.5, -4.0, -6.0), "half_angle_deg": 40.0}
    lamp |= {"power_w": 1.0}
    matt = {"reflectance": 0.9, "radiance_w_m2_sr": 0.0}
    given = scene(CAMERAS["front of the lens, ground"], samples=1024, replicates=32)
    given = given.changed({"lights": [lamp], "targets[0].material": matt})
    agree(given, given.changed({"transport.method": "forward"}))


BLACK = {"reflectance": 0.0, "radiance_w_m2_sr": 0.0}
RADIUS_MM, POWER_W = 3.0, 1.0
DISK_LAMP = {"kind": "disk", "position_mm": (0.0, 0.0, -20.0), "direction": (0.0, 0.0, 1.0), "radius_mm": RADIUS_MM,
             "power_w": POWER_W}  # fmt: skip


def glowing_disk() -> dict[str, Any]:
    """The disk lamp as a target that rays from the sensor meet: power over π times its area is its radiance."""
    radiance = POWER_W / (np.pi**2 * RADIUS_MM**2 * 1e-6)
    return {
        "shape": {"kind": "disk", "radius_mm": RADIUS_MM},
        "position_mm": (0.0, 0.0, -20.0),
        "material": {"reflectance": 0.0, "radiance_w_m2_sr": radiance},
    }


@pytest.mark.parametrize("method", ["adjoint", "forward"])
@pytest.mark.parametrize("name", instances(CAMERAS, long=LONG_CAMERAS))
def test_a_disk_lamp_before_a_rough_camera_shines_as_a_glowing_disk(name: str, method: str) -> None:
    """All light meets the rough surface, so the lamp, traced forward, is the disk that rays from the sensor find."""
    more = 4 if "diffuse" in name else 1
    bare = scene(CAMERAS[name], samples=more * 1024, replicates=32)
    lamp = bare.changed({"lights": [DISK_LAMP], "targets[0].material": BLACK, "targets[0].position_mm": (0, 0, -40)})
    agree(bare.changed({"targets": [glowing_disk()]}), lamp.changed({"transport.method": method}))


@pytest.mark.parametrize("method", instances(["adjoint", "forward"], long=["forward"]))
def test_a_lamp_shines_through_smooth_glass_on_a_rough_camera(method: str, tmp_path: Path) -> None:
    """As above, with a plate between: light that it bends or reflects into the lens is there, and only once."""
    bare = scene(CAMERAS["front of the lens, ground"], samples=2048, replicates=32)
    plate_mesh = trimesh.creation.box((12.0, 12.0, 2.0), trimesh.transformations.translation_matrix((0.0, 0.0, -8.0)))
    plate_mesh.export(tmp_path / "plate.stl")
    plate = {"refractor": {"file": str(tmp_path / "plate.stl"), "units": "mm", "index": 1.5}}
    lamp = bare.changed({"lights": [DISK_LAMP], "targets": [plate]})
    agree(bare.changed({"targets": [glowing_disk(), plate]}), lamp.changed({"transport.method": method}))


@pytest.mark.parametrize("method", instances(["adjoint", "forward"], long=["forward"]))
def test_a_point_lamp_lights_a_diffuse_front_and_a_sheet_as_a_glowing_ball_does(method: str) -> None:
    """The irradiance by a ball of one radiance is that of its centre, π L R²/d² cos θ, wherever all of it is seen."""
    bare = scene({"camera.lens.surfaces[0].finish": "diffuse"}, samples=4096, replicates=32)
    place, radius = (5.0, 0.0, -16.0), 1.0
    matt = {"reflectance": 0.9, "radiance_w_m2_sr": 0.0}
    sheet = {
        "shape": {"kind": "plane", "width_mm": 6.0, "height_mm": 6.0},
        "position_mm": (0.5, 0.0, -20.0),
        "material": matt,
    }
    ball = {
        "shape": {"kind": "sphere", "radius_mm": radius},
        "position_mm": place,
        "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0 / (4.0 * np.pi**2 * radius**2 * 1e-6)},
    }
    lamp = {"kind": "point", "position_mm": place, "power_w": 1.0}
    lit = bare.changed({"targets": [sheet], "lights": [lamp], "transport.method": method})
    agree(bare.changed({"targets": [sheet, ball]}), lit)


def test_far_lamps_are_as_bright_as_directional_light_and_small_disks_as_points() -> None:
    """A lamp at 100 m and light of its irradiance; a disk's intensity on its axis, P/π, and a point's, P/4π."""
    dark = scene(CAMERAS["curved face of the array, ground"], samples=512, replicates=32)
    dark = dark.changed({"targets[0].material": BLACK, "targets[0].position_mm": (0.0, 0.0, -40.0)})
    far = {"kind": "point", "position_mm": (0.0, 0.0, -1e5), "power_w": 4.0 * np.pi * 1e4}
    along = {"kind": "directional", "direction": (0.0, 0.0, 1.0), "irradiance_w_m2": 1.0}
    dark_behind = dark.changed({"targets[0].position_mm": (50.0, 0.0, -40.0)})
    agree(dark_behind.changed({"lights": [far]}), dark_behind.changed({"lights": [along], "transport.seed": 7}))
    small = DISK_LAMP | {"radius_mm": 0.01, "position_mm": (0.0, 0.0, -35.0)}
    point = {"kind": "point", "position_mm": (0.0, 0.0, -35.0), "power_w": 4.0 * POWER_W}
    agree(dark.changed({"lights": [small]}), dark.changed({"lights": [point], "transport.seed": 7}))


@pytest.mark.parametrize("distance_mm", instances([1e7, 1e9, 1e11], long=[1e9]))
def test_lamps_however_far_light_a_rough_front_as_directional_light_does(distance_mm: float) -> None:
    """Of one irradiance; seen from there, the angle of the lens is far below the rounding of a cosine."""
    dark = scene(CAMERAS["curved face of the array, ground"], samples=512, replicates=32)
    dark = dark.changed({"targets[0].material": BLACK, "targets[0].position_mm": (50.0, 0.0, -40.0)})
    power_w = 1e-3 * 4.0 * np.pi * (1e-3 * distance_mm) ** 2
    far = {"kind": "point", "position_mm": (0.0, 0.0, -distance_mm), "power_w": power_w}
    along = {"kind": "directional", "direction": (0.0, 0.0, 1.0), "irradiance_w_m2": 1e-3}
    agree(dark.changed({"lights": [far]}), dark.changed({"lights": [along], "transport.seed": 7}))


def test_a_rough_camera_without_targets_shows_lamps_and_is_not_called_black() -> None:
    given = scene(CAMERAS["front of the lens, ground"], samples=64, replicates=4).changed({"targets": []})
    assert any("there are no targets" in line for line in lf.first_order(given).warnings)
    lit = given.changed({"lights": [DISK_LAMP]})
    assert not any("there are no targets" in line for line in lf.first_order(lit).warnings)
    assert lf.render(lit).mean.sum() > 0.0


def test_lamps_on_a_rough_lens_are_said_and_a_polished_one_shows_none() -> None:
    """A lamp in the field shines on a rough front alone: its own image, which nothing scatters, is left out."""
    dark = scene(CAMERAS["front of the lens, ground"], samples=64, replicates=4)
    dark = dark.changed({"targets[0].material": BLACK, "targets[0].position_mm": (0.0, 0.0, -40.0)})
    lit = dark.changed({"lights": [DISK_LAMP]})
    assert lf.render(lit).mean.sum() > 0.0
    assert "lamps' light on the camera's rough surfaces forward" in lf.render(lit).engine
    said = "camera.lens.surfaces[0].finish also scatters light of lamps"
    assert any(said in line for line in lf.first_order(lit).warnings)
    assert not any("light of lamps" in line for line in lf.first_order(dark).warnings)
    polished = lit.changed({"camera.lens.surfaces[0].finish": "polished"})
    assert not any("light of lamps" in line for line in lf.first_order(polished).warnings)
    for method in ("adjoint", "forward"):
        assert lf.render(polished.changed({"transport.method": method})).mean.sum() == 0.0


def test_the_mesh_engine_is_taken_and_says_why() -> None:
    given = scene({"camera.mla.flat_finish": "diffuse"})
    few = {"transport.samples": 1, "transport.replicates": 2}
    assert lf.render(given.changed(few)).engine == "mesh: camera.mla, its flat face is diffuse"
    with pytest.raises(SceneError, match='its flat face is diffuse; use "mesh" or "auto"'):
        lf.render(given.changed({"transport.engine": "sequential"}))
    for polished in ("polished", {"kind": "ground", "roughness": 0.0}):
        assert lf.render(scene({"camera.mla.flat_finish": polished}).changed(few)).engine.startswith("both: ")


def test_rough_faces_of_curved_facets_are_refused() -> None:
    for changes in ({"camera.mla.curved_finish": GROUND}, {"camera.lens.surfaces[0].finish": "diffuse"}):
        with pytest.raises(SceneError, match="must be exact or of flat facets"):
            lf.build(scene(changes | {"transport.surface": "smooth"}))
