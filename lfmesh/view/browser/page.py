"""The page: its template, variables and parts."""

import asyncio
from pathlib import Path
from typing import Any

from lfmesh.view.browser.light_field import LightFieldPanel
from lfmesh.view.browser.rays_panel import RaysPanel
from lfmesh.view.browser.replies import Replies
from lfmesh.view.browser.subject import PageSubject
from lfmesh.view.scene3d.colours import ColourBy, default_colour
from lfmesh.view.scene3d.plotter import Drawing, build_view

SIZE = (1000, 760)
"""Size of the 3D view in px, until the browser reports its own."""

STATIC = Path(__file__).with_name("static")

LATEST_SECONDS = 0.03
"""Interval after which a picture still being encoded is requested again."""

SAID = '<div class="page"><div id="fault" class="fault wide">{{ fault }}</div></div>'
"""Template of a page with a single message."""

VIEW = "<!-- view -->"
"""Placeholder for the 3D view in the template."""


class Page:
    """Page of a scene or run in a trame server, with its own camera, rays, filter and light field.

    Parameters
    ----------
    server : trame_server.Server
    subject : PageSubject
    expression : str
        Initial content of the filter box.
    colour, fade, preset, cut
        See `lfmesh.view.scene3d.plotter.Drawing`.
    """

    def __init__(
        self, server: Any, subject: PageSubject, *,
        expression: str = "", colour: ColourBy | None = None, fade: bool = False, preset: str = "whole",
        cut: bool = False,
    ) -> None:  # fmt: skip
        folder, rays = subject.folder, subject.rays
        name = subject.scene.title or "unnamed scene"
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
        seen = subject.seen
        view = self._view = build_view(seen.world, None, seen.picture, Drawing(preset=preset, cut=cut, size=SIZE))
        view.plotter.show(auto_close=False, interactive=False)
        self.light_field = LightFieldPanel(server, replies, subject)
        server.state.update(
            {"expression": expression, "colour": colour or default_colour(rays), "fade": fade, "cut": cut}
        )
        self.rays = RaysPanel(server, replies, view, rays, self.light_field)
        # Rays from pixels have moved the visible part of the array.
        view.look(preset)
        self._sending: asyncio.Task[None] | None = None
        self._lay_out(server)

    def close(self) -> None:
        """Close the 3D view."""
        if self._sending is not None:
            self._sending.cancel()
        self.light_field.close()
        self.rays.close()
        self._view.plotter.close()

    def _lay_out(self, server: Any) -> None:
        """Give the server the template with the 3D view in it."""
        from trame.ui.html import DivLayout
        from trame.widgets.vtk import VtkRemoteView

        add_files(server)
        window = self._view.plotter.render_window
        before, after = (STATIC / "page.html").read_text(encoding="utf-8").split(VIEW)
        with DivLayout(server) as layout:
            view = VtkRemoteView(window, ref="scene", interactive_ratio=1, interactive_quality=70, connect_parent=False)
            layout.root.add_child(before + view.html + after)
        server.controller.redraw = view.update

        def begin(**_state: Any) -> None:
            self._sending = asyncio.ensure_future(_send_what_is_encoded(server, window))

        server.controller.on_server_ready.add(begin)


def add_files(server: Any) -> None:
    """Register the files that the templates need."""
    server.enable_module(
        {
            "serve": {"lfmesh": str(STATIC)},
            "scripts": ["lfmesh/page.js"],
            "styles": ["lfmesh/page.css"],
            "vue_use": ["lfmesh_page"],
        }
    )


def say(server: Any, words: str) -> None:
    """Fill a server with a page that only shows a message."""
    from trame.ui.html import DivLayout

    server.state.update({"trame__title": "lfmesh", "fault": words})
    add_files(server)
    with DivLayout(server) as layout:
        layout.root.add_child(SAID)


async def _send_what_is_encoded(server: Any, window: Any) -> None:
    """Send every picture of the 3D view that was not yet encoded when it was due.

    trame tries again only once, half a second later; on a busy machine the last picture would be lost.
    """
    publisher, _ = server.protocol.getRPCMethod("viewport.image.push")
    view = str(publisher.get_global_id(window))
    while True:
        await asyncio.sleep(LATEST_SECONDS)
        if publisher.app.GetHasImagesBeingProcessed(window):
            publisher.push_render(view)
