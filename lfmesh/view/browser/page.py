"""The page: its template, its variables, and what stands behind each of its parts."""

import asyncio
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfmesh.files import run
from lfmesh.transport.render.image import Image
from lfmesh.view.browser.light_field import LightFieldPanel
from lfmesh.view.browser.rays_panel import RaysPanel
from lfmesh.view.browser.replies import Replies
from lfmesh.view.request import Subject, sensor_picture, subject_of
from lfmesh.view.scene3d.colours import ColourBy, default_colour
from lfmesh.view.scene3d.plotter import Drawing, build_view

if TYPE_CHECKING:
    from lfmesh.scene import Scene
    from lfmesh.transport.world import World
    from lfmesh.view.rays.paths import Rays

SIZE = (1000, 760)
"""Of the 3D view until the browser says how large it is, px."""

STATIC = Path(__file__).with_name("static")

LATEST_SECONDS = 0.03
"""After so long a picture that is being encoded is asked for again."""

VIEW = "<!-- view -->"
"""Where the template takes the 3D view."""


class Page:
    """Fills a trame server with the page of one scene or run.

    Parameters
    ----------
    server : trame_server.Server
    subject : Scene, World, Image, or path of a scene file or a run folder
    rays : Rays, optional
        Drawn from the start; launched in the subject's world.
    expression : str
        Stands in the filter box from the start.
    colour, fade, preset, cut
        See `lfmesh.view.scene3d.plotter.Drawing`.

    Raises
    ------
    LfmeshError
        There is no such scene or run, or it is damaged.
    """

    def __init__(
        self, server: Any, subject: "Scene | World | Image | str | os.PathLike[str]", rays: "Rays | None" = None, *,
        expression: str = "", colour: ColourBy | None = None, fade: bool = False, preset: str = "whole",
        cut: bool = False,
    ) -> None:  # fmt: skip
        folder = Path(subject) if isinstance(subject, str | os.PathLike) and Path(subject).is_dir() else None
        image = run.open_run(folder) if folder is not None else subject if isinstance(subject, Image) else None
        if rays is not None:
            seen = Subject(rays.world, sensor_picture(image) if image is not None else None)
        else:
            seen = subject_of(subject if image is None else image)
        scene = seen.world.scene
        name = scene.name or "unnamed scene"
        server.state.update(
            {
                "trame__title": f"{name} · lfmesh",
                "what": name if folder is None else f"{name} · {folder}",
                "tab": "rays",
                "side": "paths",
                "fault": "",
            }
        )
        replies = Replies(server)
        view = build_view(seen.world, None, seen.picture, Drawing(preset=preset, cut=cut, size=SIZE))
        view.plotter.show(auto_close=False, interactive=False)
        self.light_field = LightFieldPanel(server, replies, scene, image, folder)
        server.state.update(
            {"expression": expression, "colour": colour or default_colour(rays), "fade": fade, "cut": cut}
        )
        self.rays = RaysPanel(server, replies, view, rays, self.light_field)
        # Rays from pixels have moved the place of the array that is looked at.
        view.look(preset)
        _lay_out(server, view.plotter.render_window)


def _lay_out(server: Any, window: Any) -> None:
    """Give the server the template, with the 3D view in its place, and the files that the template needs."""
    from trame.ui.html import DivLayout
    from trame.widgets.vtk import VtkRemoteView

    server.enable_module(
        {
            "serve": {"lfmesh": str(STATIC)},
            "scripts": ["lfmesh/page.js"],
            "styles": ["lfmesh/page.css"],
            "vue_use": ["lfmesh_page"],
        }
    )
    before, after = (STATIC / "page.html").read_text(encoding="utf-8").split(VIEW)
    with DivLayout(server) as layout:
        view = VtkRemoteView(window, ref="scene", interactive_ratio=1, interactive_quality=70, connect_parent=False)
        layout.root.add_child(before + view.html + after)
    server.controller.redraw = view.update
    sending: list[asyncio.Task[None]] = []
    server.controller.on_server_ready.add(
        lambda **_state: sending.append(asyncio.ensure_future(_send_what_is_encoded(server, window)))
    )


async def _send_what_is_encoded(server: Any, window: Any) -> None:
    """Send every picture of the 3D view that was not encoded yet when it should have been sent.

    trame looks a second time, half a second later, and then no more: on a busy machine the last picture would be lost.
    """
    publisher, _ = server.protocol.getRPCMethod("viewport.image.push")
    view = str(publisher.get_global_id(window))
    while True:
        await asyncio.sleep(LATEST_SECONDS)
        if publisher.app.GetHasImagesBeingProcessed(window):
            publisher.push_render(view)
