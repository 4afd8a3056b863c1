"""The history of a path across diffractive faces: orders, their shares, and powers that are products of all shares."""

import itertools
import math
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.view.rays.history import history, lines
from lfmesh.view.rays.launch import from_field_point, from_pixels
from lfmesh.view.rays.paths import Rays

SEVERAL = [{"order": 0, "share": 0.25}, {"order": 1, "share": 0.5}, {"order": -1, "share": 0.125}]
REFLECTED = [{"order": 0, "share": 0.5}, {"order": 1, "share": 0.25}]


def world(phase: dict[str, Any], **transport: Any) -> lf.World:
    front = {"stop": True, "thickness_mm": 2.0, "index": 1.5, "semi_diameter_mm": 3.0, "radius_mm": 30.0}
    camera = {
        "lens": {"surfaces": [front, {"semi_diameter_mm": 4.0, "phase": phase}]},
        "sensor": {"pixels": (200, 200), "pixel_mm": 0.1, "distance_mm": 40.0},
    }
    return lf.build(lf.Scene(camera=camera, transport={"wavelengths_nm": (550.0,), **transport}))


@pytest.mark.parametrize(
    "phase",
    [
        {"kind": "grating", "lines_per_mm": 80.0, "orders": SEVERAL, "reflected_orders": REFLECTED},
        {"kind": "radial", "coefficients_rad": [-300.0], "radius_mm": 3.0, "orders": SEVERAL},
        {"kind": "metalens", "focal_length_mm": 60.0, "design_nm": 500.0, "efficiency": "blaze"},
    ],
)
def test_powers_are_products_of_the_shares_of_faces_and_orders(phase: dict[str, Any]) -> None:
    # Each event at the grating has five children, and roulette is off: more events would be millions of paths.
    made = world(phase, max_events=6)
    rays = from_field_point(made, (1.0, 2.0, -100.0), 40, aim="lens", weight_cutoff=0.0)
    check_powers(rays, phase)
    # From the sensor, importance travels against the light.
    check_powers(from_pixels(made, range(98, 102), range(98, 102), 8, weight_cutoff=0.0), phase)


def check_powers(rays: Rays, phase: dict[str, Any]) -> None:
    seen: dict[tuple[str, int | None], int] = {}
    for path in range(len(rays)):
        steps = history(rays, path)
        for before, step in itertools.pairwise(steps):
            if step.reflectance is None or step.transmittance is None:
                continue
            share = step.transmittance if step.event == lf.Event.TRANSMITTED else step.reflectance
            assert step.power == pytest.approx(before.power * share * step.order_share, rel=1e-9, abs=0.0)
            assert step.roulette == pytest.approx(1.0, rel=1e-9)
            key = step.event.name, step.order
            seen[key] = seen.get(key, 0) + 1
    listed = [each["order"] for each in phase.get("orders", ())] or [1]
    mirrored = [each["order"] for each in phase.get("reflected_orders", ())] or [0]
    assert {order for event, order in seen if event == "TRANSMITTED" and order is not None} == set(listed)
    assert {order for event, order in seen if event == "REFLECTED" and order is not None} == set(mirrored)


def test_the_order_stands_in_place_of_the_event() -> None:
    phase = {"kind": "grating", "lines_per_mm": 80.0, "orders": SEVERAL}
    rays = from_field_point(world(phase), (0.0, 0.0, -100.0), 10, aim="lens", weight_cutoff=0.0)
    said = "\n".join(line for path in range(len(rays)) for line in lines(history(rays, path), rays.unit))
    assert all(f"order {order}" in said for order in ("+0", "+1", "-1"))


def test_a_ray_in_an_order_is_turned_by_its_lines() -> None:
    """m L λ in the tangential part of n d, whatever the side of arrival."""
    phase = {"kind": "grating", "lines_per_mm": 80.0, "orders": SEVERAL, "reflected_orders": REFLECTED}
    made = world(phase, max_events=6)
    rays = from_field_point(made, (1.0, 2.0, -100.0), 20, aim="lens", weight_cutoff=0.0)
    for path in range(len(rays)):
        steps = history(rays, path)
        for number, step in enumerate(steps[1:-1], start=1):
            if step.order is None:
                continue  # no diffractive face, or a path that ends there
            here, place = steps[number - 1], [each.position_mm for each in steps[number - 1 : number + 2]]
            arriving, leaving = (b - a for a, b in itertools.pairwise(place))
            change = step.index * leaving / np.linalg.norm(leaving) - here.index * arriving / np.linalg.norm(arriving)
            np.testing.assert_allclose(change[:2], [step.order * 80.0 * 550e-6, 0.0], atol=1e-9)
    assert math.isfinite(rays.end_power.sum())
