"""Rough surfaces of the lens and of the array: both methods show the same.

The camera is small, as rays are not aimed in a camera whose glass scatters.
"""

from typing import Any

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.errors import SceneError
from lfmesh.transport.choice import engine_of
from tests.cameras import SQUARE_ARRAY, biconvex

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
    image = lf.render(given)
    assert abs(image.ledger.imbalance) < 1e-12
    assert sum(image.ledger.lost.values()) <= 1e-7 * image.ledger.emitted

    def sums(values: np.ndarray) -> np.ndarray:
        parts = values.reshape(20 // SQUARE, SQUARE, 20 // SQUARE, SQUARE).sum(axis=(1, 3)).ravel()
        return np.append(parts, parts.sum())

    return sums(image.mean[..., 0]), np.sqrt(sums(image.stderr[..., 0] ** 2))


@pytest.mark.parametrize("name", CAMERAS)
def test_forward_equals_adjoint(name: str) -> None:
    """Two-sided z-tests of the squares and of the whole."""
    more = 4 if "diffuse" in name else 1
    given = scene(CAMERAS[name], samples=more * 512, replicates=32)
    (one, error), (other, its_error) = squares(given), squares(given.changed({"transport.method": "forward"}))
    both = np.hypot(error, its_error)
    assert both[-1] < 0.08 * one[-1]
    p = 2.0 * stats.norm.sf(np.abs(one - other) / both)
    assert p.min() > LEVEL / len(p), (one, other, both)


def test_a_lamps_light_off_a_target_comes_through_ground_glass_alike_in_both_methods() -> None:
    """Two-sided z-tests, as above: a lamp beside the camera lights a matt sheet that is seen through a ground front."""
    lamp = {"kind": "point", "position_mm": (6.0, 4.0, -14.0), "power_w": 1.0}
    matt = {"reflectance": 0.9, "radiance_w_m2_sr": 0.0}
    given = scene(CAMERAS["front of the lens, ground"], samples=1024, replicates=32)
    given = given.changed({"lights": [lamp], "targets[0].material": matt})
    (one, error), (other, its_error) = squares(given), squares(given.changed({"transport.method": "forward"}))
    both = np.hypot(error, its_error)
    assert both[-1] < 0.08 * one[-1]
    p = 2.0 * stats.norm.sf(np.abs(one - other) / both)
    assert p.min() > LEVEL / len(p), (one, other, both)


LAMPS: dict[str, dict[str, Any]] = {
    "point": {"kind": "point", "position_mm": (1.0, 0.5, -20.0), "power_w": 1.0},
    "disk": {"kind": "disk", "position_mm": (0.0, 0.0, -20.0), "direction": (0.0, 0.0, 1.0), "radius_mm": 3.0,
             "power_w": 1.0},
    "directional": {"kind": "directional", "direction": (0.0, 0.0, 1.0), "irradiance_w_m2": 1.0},
}  # fmt: skip


@pytest.mark.parametrize("kind", LAMPS)
def test_what_lamps_shed_on_a_rough_lens_is_in_neither_method_and_is_said(kind: str) -> None:
    """A lamp in the field adds nothing in either method, and a warning says so, unless the camera is polished."""
    dark = scene(CAMERAS["front of the lens, ground"], samples=64, replicates=4)
    dark = dark.changed({"targets[0].material.radiance_w_m2_sr": 0.0, "targets[0].position_mm": (0.0, 0.0, -40.0)})
    lit = dark.changed({"lights": [LAMPS[kind]], "targets[0].material.reflectance": 0.0})
    for method in ("adjoint", "forward"):
        assert lf.render(lit.changed({"transport.method": method})).mean.sum() == 0.0
    said = "camera.lens.surfaces[0].finish scatters light, but what lamps shed on the lens itself is left out"
    assert any(said in line for line in lf.first_order(lit).warnings)
    assert not any("lamps shed" in line for line in lf.first_order(dark).warnings)
    polished = lit.changed({"camera.lens.surfaces[0].finish": "polished"})
    assert not any("lamps shed" in line for line in lf.first_order(polished).warnings)


def test_the_mesh_engine_is_taken_and_says_why() -> None:
    given = scene({"camera.mla.flat_finish": "diffuse"})
    assert engine_of(given) == ("mesh", "camera.mla, its flat face is diffuse")
    with pytest.raises(SceneError, match='its flat face is diffuse; use "mesh" or "auto"'):
        engine_of(given.changed({"transport.engine": "sequential"}))
    for polished in ("polished", {"kind": "ground", "roughness": 0.0}):
        assert engine_of(scene({"camera.mla.flat_finish": polished}))[0] == "both"


def test_rough_faces_of_curved_facets_are_refused() -> None:
    for changes in ({"camera.mla.curved_finish": GROUND}, {"camera.lens.surfaces[0].finish": "diffuse"}):
        with pytest.raises(SceneError, match="must be exact or of flat facets"):
            lf.build(scene(changes | {"transport.surface": "smooth"}))
