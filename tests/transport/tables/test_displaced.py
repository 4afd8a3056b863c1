"""Media in and beside bodies of glass: the boundary of a medium decides, not its corners or its box."""

from typing import Any

import pytest

import lfmesh as lf
from tests.cameras import camera_without_array

MIDDLE = -150.0


def slab(x_mm: float, name: str = "") -> dict[str, Any]:
    """A slab of glass 4 mm thick, across x."""
    box = {"box_mm": [4.0, 30.0, 30.0], "index": 1.5}
    return {"name": name or f"slab at {x_mm:g}", "refractor": box, "position_mm": [x_mm, 0.0, MIDDLE]}


def scene(bodies: list[dict[str, Any]], **medium: Any) -> lf.Scene:
    """The camera before bodies and a medium that absorbs."""
    media = [{"absorption_per_mm": 0.1, "position_mm": [0.0, 0.0, MIDDLE]} | medium]
    return lf.Scene(camera=camera_without_array(), targets=bodies, media=media)


def test_a_medium_with_its_corners_and_middle_in_glass_shows_between() -> None:
    """A box from slab to slab, with its middle in a third one, is seen in the air between them."""
    bodies = [slab(-8.0), slab(0.0), slab(8.0)]
    lf.build(scene(bodies, bounds={"kind": "box", "size_mm": [16.0, 10.0, 10.0]}))
    for size_mm in (3.0, 4.0):
        within = scene(bodies, bounds={"kind": "box", "size_mm": [size_mm, 10.0, 10.0]})
        with pytest.raises(lf.SceneError, match=r"media\[0\]: lies inside slab at 0, which displaces"):
            lf.build(within)


@pytest.mark.parametrize("bounds", [{"kind": "sphere", "radius_mm": 1.0}, {"kind": "box", "size_mm": [2.0, 2.0, 2.0]}])
def test_a_medium_in_the_box_round_a_turned_body_but_beside_it_is_refused(bounds: dict[str, Any]) -> None:
    """The slab lies across the diagonal of the box round it; the medium is in a corner of that box."""
    turned = slab(0.0, "plate") | {"rotation_deg": [0.0, 0.0, 45.0]}
    beside = scene([turned], bounds=bounds, position_mm=[9.0, 9.0, MIDDLE], inside="plate")
    with pytest.raises(lf.SceneError, match=r"media\[0\]: lies wholly outside plate"):
        lf.build(beside)
    for place_mm in ([0.0, 0.0, MIDDLE], [1.5, 1.5, MIDDLE]):
        lf.build(scene([turned], bounds=bounds, position_mm=place_mm, inside="plate"))


def test_a_medium_of_the_very_size_of_its_body_is_in_it() -> None:
    lf.build(scene([slab(0.0, "plate")], bounds={"kind": "box", "size_mm": [4.0, 30.0, 30.0]}, inside="plate"))


def test_a_medium_round_its_body_is_not_beside_it() -> None:
    lf.build(scene([slab(0.0, "plate")], bounds={"kind": "box", "size_mm": [50.0, 50.0, 50.0]}, inside="plate"))
