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
from lfmesh.view.scene3d.plotter import View
from tests.view.conftest import SCENE

pytestmark = pytest.mark.drawing

WALL = """
[[targets]]
name = "wall"
shape = { kind = "plane", width_mm = 60.0, height_mm = 60.0 }
position_mm = [0.0, 0.0, -150.0]
"""


class State(SimpleNamespace):
    """The page's variables, as trame keeps them."""

    def __init__(self) -> None:
        super().__init__(side="paths", expression="", colour="wavelength", fade=False, cut=False, fault="")
        self.__dict__["said"] = []

    def update(self, values: dict[str, Any]) -> None:
        self.__dict__.update(values)

    def change(self, *_names: str) -> Callable[[Any], Any]:
        return lambda answer: answer

    def __setattr__(self, name: str, value: Any) -> None:
        self.__dict__["said"].append((name, value))
        self.__dict__[name] = value

    def __enter__(self) -> "State":
        return self

    def __exit__(self, *_: object) -> None:
        return None


class Server:
    """A server that keeps what answers a trigger, by its name."""

    def __init__(self) -> None:
        self.state, self.answers = State(), {}
        exists = SimpleNamespace(exists=lambda: False)
        self.controller = SimpleNamespace(trigger=self._trigger, redraw=exists)

    def _trigger(self, name: str) -> Callable[[Any], Any]:
        return lambda answer: self.answers.setdefault(name, answer)


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
