"""The ray controls of the page without a browser: where they begin, and what they answer."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.scene import loads
from lfmesh.view.browser.rays_panel import RaysPanel
from lfmesh.view.browser.replies import Replies
from lfmesh.view.rays import launch
from lfmesh.view.rays.paths import Rays
from lfmesh.view.request import launched
from lfmesh.view.scene3d.plotter import View
from tests.view.browser.pages import Server
from tests.view.conftest import SCENE

pytestmark = pytest.mark.drawing

WALL = """
[[targets]]
name = "wall"
shape = { kind = "plane", width_mm = 60.0, height_mm = 60.0 }
position_mm = [0.0, 0.0, -150.0]
"""


@pytest.fixture
def panels(views: Callable[..., View]) -> Callable[..., tuple[Server, RaysPanel]]:
    def make(world: lf.World, rays: Rays | None = None) -> tuple[Server, RaysPanel]:
        server = Server()
        nothing = SimpleNamespace(mark=lambda *_: None, marked=None)
        return server, RaysPanel(server, Replies(server), views(world), rays, nothing)  # type: ignore[arg-type]

    return make


@pytest.mark.parametrize("pose", [{}, {"camera.pose": {"shift_mm": [5.0, -3.0, 0.0], "tilt_deg": [0.0, 4.0, 0.0]}}])
def test_the_form_begins_at_a_point_that_the_lens_sees(panels: Any, pose: dict[str, Any]) -> None:
    """A wall hides the middle of the plane in focus: the form names a point of the wall."""
    world = lf.build(loads(SCENE.replace("[[lights]]", WALL + "[[lights]]")).changed(pose))
    server, _ = panels(world)
    state = server.state
    point = [state.point_x, state.point_y, state.point_z]
    rays = launch.from_field_point(world, point, 20, split="transmit")
    assert rays.arrives.mean() > 0.5
    assert np.linalg.norm(point) < 160.0, "before the wall"
    server.answers["launch"]({})
    assert state.fault == ""
    assert "no ray reaches" not in state.drawn


def test_a_click_that_meets_nothing_is_answered(panels: Any, world: lf.World) -> None:
    server, _ = panels(world)
    server.answers["pick_in_view"](0.002, 0.002)
    assert "nothing at that point" in server.state.picked_note
    server.answers["pick_in_view"](0.5, 0.5)
    assert server.state.picked != "Nothing picked"
    assert server.state.picked_note == ""


def test_a_row_of_a_table_that_has_changed_is_not_taken_for_another(panels: Any, world: lf.World) -> None:
    """The number of its sequence belongs to another one by then."""
    first, second = (launch.from_field_point(world, [0.0, y, -190.0], 30, split="both") for y in (0.0, 8.0))
    server, _ = panels(world, first)
    row = server.state.rows[0]
    server.answers["choose"](row["path"], row["sequence"])
    assert (server.state.chosen, server.state.fault) == (row["path"], "")
    server, _ = panels(world, second)
    stale = next(each for each in first.sequences if each != second.sequences[0])
    server.answers["choose"](0, stale)
    assert server.state.chosen is None
    assert "click its row again" in server.state.fault


@pytest.mark.parametrize("split", ["transmit", "both"])
def test_the_caption_says_whether_ghosts_are_among_the_rays(panels: Any, world: lf.World, split: str) -> None:
    server, _ = panels(world, launch.from_field_point(world, [0.0, 0.0, -190.0], 10, split=split))
    assert ("no ghosts" in server.state.drawn) == (split == "transmit")
    words = launched(world, split=split).caption[0]
    assert ("no ghosts" in words) == (split == "transmit")
