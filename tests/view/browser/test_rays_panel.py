"""The ray controls of the page without a browser: where they begin, and what they answer."""

import asyncio
from collections.abc import Callable
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.scene import loads
from lfmesh.view.browser.ghost_cells import ghost_picture
from lfmesh.view.browser.rays_panel import RaysPanel
from lfmesh.view.browser.replies import Replies
from lfmesh.view.rays import launch
from lfmesh.view.rays.ghosts import GhostMatrix, ghost_matrix
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


def test_the_caption_has_the_amounts_of_media_with_rays_and_without(panels: Any) -> None:
    smoke = {"name": "smoke", "scattering_per_mm": 0.001}
    world = lf.build(loads(SCENE).changed({"media": [smoke]}))
    for rays in (None, launch.from_field_point(world, [0.0, 0.0, -190.0], 4, split="transmit")):
        server, _ = panels(world, rays)
        assert "smoke, everywhere before the camera, scatters 0.001 per mm" in server.state.drawn


@pytest.mark.parametrize("split", ["transmit", "both"])
def test_the_caption_says_whether_ghosts_are_among_the_rays(panels: Any, world: lf.World, split: str) -> None:
    server, _ = panels(world, launch.from_field_point(world, [0.0, 0.0, -190.0], 10, split=split))
    assert ("no ghosts" in server.state.drawn) == (split == "transmit")
    words = launched(world, split=split).caption[0]
    assert ("no ghosts" in words) == (split == "transmit")


def with_ghosts(server: Server) -> tuple[set[str], str]:
    """Open the tab of ghosts and wait for its integrals; return origins and note of what is shown until then."""

    async def open_tab() -> tuple[set[str], str]:
        server.state.side = "ghosts"
        server.answers["filter"]("")
        before = {row[4] for row in server.state.ghost_rows}, server.state.ghosts_note
        await asyncio.sleep(0.01)
        while server.state.ghosts_progress:
            await asyncio.sleep(0.05)
        return before

    return asyncio.run(open_tab())


def test_ghosts_are_those_of_the_rays_until_they_are_integrated(panels: Any, split_rays: Rays) -> None:
    server, panel = panels(split_rays.world, split_rays)
    origins, note = with_ghosts(server)
    assert origins == {"rays"}
    assert "until" in note
    assert any("Integrating" in value for name, value in server.state.said if name == "ghosts_progress")
    assert any(row[4].startswith("quadrature") for row in server.state.ghost_rows)
    assert server.state.ghosts_note.startswith("Origin quadrature")
    assert server.state.fault == ""
    image = next(row for row in server.state.rows if row["short"] == "image path")
    assert image["error"] == "", "the path table has the integrals too"
    server.answers["filter"]("ghost")
    assert {row[4] for row in server.state.ghost_rows} == {"rays"}
    assert "filter" in server.state.ghosts_note
    panel.close()


def test_targets_in_the_way_of_ghosts_are_named(panels: Any, scene: lf.Scene) -> None:
    half = loads(SCENE.replace("[[lights]]", WALL + "[[lights]]")).changed({"targets[1].position_mm[0]": 31.0})
    for world, z, words in (
        (lf.build(half), -190.0, "(wall) shades part of the lens"),
        (lf.build(scene), -420.0, "stands in the way"),
    ):
        server, panel = panels(world, launch.from_field_point(world, [0.0, 0.0, z], 40, split="both"))
        with_ghosts(server)
        assert words in server.state.ghosts_note
        panel.close()


@pytest.mark.parametrize("count", [0, 40])
def test_labels_of_the_ghost_picture_are_legible(split_rays: Rays, count: int) -> None:
    """In the panel a point of the picture is about a pixel."""
    matrix = ghost_matrix(split_rays)
    if count:
        labels = [f"L{number}a" for number in range(count)]
        power = np.tril(np.random.default_rng(2).uniform(1e-6, 1e-3, (count, count)))
        none = np.zeros_like(power)
        matrix = GhostMatrix(labels, labels, power, 1.0, "W", "from 10 rays", none, none, none)
    figure = ghost_picture(matrix)
    figure.draw_without_rendering()
    axes, bar = figure.axes
    for ticks, side in ((axes.get_xticklabels(), 0), (axes.get_yticklabels(), 1)):
        assert len(ticks) > 5
        assert min(tick.get_fontsize() for tick in ticks) >= 8.0
        boxes = sorted((tick.get_window_extent().get_points() for tick in ticks), key=lambda box: box[0][side])
        assert all(a[1][side] <= b[0][side] for a, b in pairwise(boxes))
    assert not axes.texts, "numbers are in the table"
    title = axes.title if axes.get_title() else axes._left_title
    assert title.get_window_extent().x1 <= figure.bbox.x1
    assert bar.get_ylabel()
