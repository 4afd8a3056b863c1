"""Glass in uniform light, forward and adjoint: both methods show that light, wherever it is not the camera's darkness.

A body stands in a short box of walls that have one radiance, before the stop of a camera that has no glass: a window of
index 1 in an opening, and the sensor close behind it. So large a share of the light that walls emit reaches the sensor
that the forward method is as exact as the adjoint one. What a path from the sensor through glass brings is the walls'
radiance, whole, unless it ends in the opening, which is dark: that share is in the ledger. That glossy sheets show a
furnace's light to the adjoint method is held in test_radiometry.py; here forward shows the same.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import lfmesh as lf
from lfmesh.transport.render.render import Renderer
from tests.renders import unchecked

SIDE, DEPTH = 6.0, 5.0
SIGMA = 1e-3
"""Of the light, in each method, in the long tests."""

QUICK = 5e-3
"""The same in the others."""

POLISHED, DIFFUSE = "polished", "diffuse"


def ground(roughness: float) -> dict[str, Any]:
    return {"kind": "ground", "roughness": roughness}


def wall(position_mm: tuple[float, ...], rotation_deg: tuple[float, ...], height_mm: float) -> dict[str, Any]:
    shape = {"kind": "plane", "width_mm": SIDE if rotation_deg[1] == 0.0 else DEPTH, "height_mm": height_mm}
    material = {"reflectance": 0.0, "radiance_w_m2_sr": 1000.0}
    return {"shape": shape, "position_mm": position_mm, "rotation_deg": rotation_deg, "material": material}


HALF = 0.5 * SIDE
WALLS = [
    wall((0.0, 0.0, -DEPTH), (0.0, 0.0, 0.0), SIDE),
    wall((-HALF, 0.0, -0.5 * DEPTH), (0.0, 90.0, 0.0), SIDE),
    wall((HALF, 0.0, -0.5 * DEPTH), (0.0, 90.0, 0.0), SIDE),
    wall((0.0, -HALF, -0.5 * DEPTH), (90.0, 0.0, 0.0), DEPTH),
    wall((0.0, HALF, -0.5 * DEPTH), (90.0, 0.0, 0.0), DEPTH),
]


def plate(finish: Any) -> dict[str, Any]:
    """Return a plate of glass; light crosses each of its faces from both sides."""
    return {"refractor": {"file": "plate.stl", "units": "mm", "index": 1.5, "finish": finish}}


def sheet(roughness: float) -> dict[str, Any]:
    """Return a tilted glossy sheet that scatters all light."""
    shape = {"kind": "plane", "width_mm": 4.0, "height_mm": 4.0}
    material = {"reflectance": 1.0, "gloss": {"index": 1.5, "roughness": roughness}}
    return {"shape": shape, "rotation_deg": (0.0, 20.0, 0.0), "material": material}


def furnace(folder: Path, body: dict[str, Any], **transport: Any) -> lf.Scene:
    """Return a body in the box."""
    trimesh.creation.box((4.0, 4.0, 1.0)).export(folder / "plate.stl")
    flat = {"radius_mm": float("inf"), "index": 1.0, "thickness_mm": 0.01, "semi_diameter_mm": 2.0, "stop": True}
    lens = {"surfaces": [flat, {"radius_mm": float("inf"), "semi_diameter_mm": 2.2}]}
    sensor = {"pixels": (4, 4), "pixel_mm": 2.0, "distance_mm": 2.0}
    return lf.Scene(
        camera={"lens": lens, "sensor": sensor},
        targets=[*WALLS, {"position_mm": (0.0, 0.0, -3.5)} | body],
        transport={"replicates": 32, "threads": 1, "split": "transmit", "max_events": 1000, **transport},
    ).in_folder(folder)


def light(image: lf.Image) -> tuple[float, float]:
    """Return the light on the sensor and its standard error, W."""
    assert abs(image.ledger.imbalance) < 1e-12
    assert sum(image.ledger.lost.values()) <= 1e-7 * image.ledger.emitted
    return float(image.mean.sum()), float(np.sqrt((image.stderr**2).sum()))


# Children of fine facets that are aimed weigh far more than others: packets that are not aimed estimate those better.
CASES = [
    pytest.param(plate(POLISHED), True, QUICK, 2**16, id="polished, quick", marks=pytest.mark.long),
    pytest.param(plate(POLISHED) | {"rotation_deg": (15.0, -12.0, 17.0)}, True, QUICK, 2**16, id="tilted, quick"),
    pytest.param(plate(DIFFUSE), True, QUICK, 2**16, id="diffuse, quick"),
    pytest.param(plate(ground(1.0)), True, QUICK, 2**17, id="ground 1, quick", marks=pytest.mark.long),
    pytest.param(sheet(0.5), True, QUICK, 2**16, id="gloss 0.5, quick"),
    *(
        pytest.param(body, aimed, SIGMA, samples, id=name, marks=pytest.mark.long)
        for name, body, aimed, samples in (
            ("polished", plate(POLISHED), True, 3 * 2**18),
            ("diffuse", plate(DIFFUSE), True, 3 * 2**18),
            ("ground 0.1", plate(ground(0.1)), False, 3 * 2**20),
            ("ground 0.5", plate(ground(0.5)), False, 3 * 2**20),
            ("ground 1", plate(ground(1.0)), True, 2**20),
            ("gloss 0.1", sheet(0.1), False, 3 * 2**20),
            ("gloss 0.5", sheet(0.5), True, 3 * 2**18),
            ("gloss 1", sheet(1.0), True, 3 * 2**18),
        )
    ),
]


@pytest.mark.parametrize(("body", "aimed", "sigma", "packets"), CASES)
def test_both_methods_show_the_light_of_a_furnace(
    tmp_path: Path, body: dict[str, Any], aimed: bool, sigma: float, packets: int
) -> None:
    """Three standard errors of the difference; `packets` are those of the forward method over the 16 pixels."""
    adjoint = unchecked(furnace(tmp_path, body, samples=int(2**12 * (QUICK / sigma) ** 2)))
    there = furnace(tmp_path, body, method="forward", samples=packets)
    forward = Renderer(lf.build(there), aimed=aimed).image()
    (one, its_error), (other, other_error) = light(adjoint), light(forward)
    assert max(its_error / one, other_error / other) < sigma
    assert abs(one - other) < 3.0 * np.hypot(its_error, other_error)


@pytest.mark.parametrize("finish", [POLISHED, DIFFUSE, ground(0.1), ground(0.5), ground(1.0)], ids=str)
def test_paths_that_end_on_walls_have_the_walls_radiance(tmp_path: Path, finish: Any) -> None:
    """To rounding: a picture over that of no glass at all is the share of paths that reach walls."""
    held = unchecked(furnace(tmp_path, plate(finish), samples=512))
    none = furnace(tmp_path, plate(POLISHED), samples=512)
    empty = unchecked(none.changed({"targets[5].refractor.index": 1.0}))
    assert held.mean.sum() / empty.mean.sum() == pytest.approx(
        held.ledger.reached_target / empty.ledger.reached_target, rel=1e-9
    )
    # The opening's share of what the plate scatters.
    assert 0.85 < held.ledger.reached_target / empty.ledger.reached_target < 1.0 + 1e-9
