"""Ghosts in the page: from the rays at once, integrated over the pupil as soon as that is done."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.geometry.objects.targets import named_target
from lfmesh.notebook import Say
from lfmesh.transport.packets.packet import CAMERA_FRAME, WORLD_FRAME
from lfmesh.view.browser.background import Background
from lfmesh.view.browser.ghost_cells import GHOST_HEADS, ghost_cells, ghost_picture
from lfmesh.view.browser.replies import Replies
from lfmesh.view.pictures import figure_url
from lfmesh.view.rays.exact_ghosts import ExactGhosts, exact_of, origin_in_words
from lfmesh.view.rays.ghosts import GhostMatrix, ghost_matrix
from lfmesh.view.rays.paths import Rays
from lfmesh.view.rays.shadows import in_the_way
from lfmesh.view.request import why_dark

MOST_ROWS = 300
"""Most pairs in the table."""

UNTIL = "Powers are from the rays, ± their standard error, until the integrals are done."


class GhostsPanel:
    """State and handlers of the page's ghosts.

    Parameters
    ----------
    server : trame_server.Server
    replies : Replies
    integrated : callable
        Called when the powers of other tables can be replaced by integrated ones.
    """

    def __init__(self, server: Any, replies: Replies, integrated: Callable[[], None]) -> None:
        self._state, self._on_integrated = server.state, integrated
        self._background = Background(server, replies)
        self._rays: Rays | None = None
        self._kept: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._begun = False
        self._shade = ""
        self.exact: ExactGhosts | None = None
        self._state.update({"ghosts_full": "", "ghosts_progress": ""})
        self.forget()
        replies.on_call("ghosts_full", self._show_full)

    def close(self) -> None:
        """Stop what is still being computed for the page."""
        self._background.close()

    def forget(self) -> None:
        """Forget the ghosts of earlier rays."""
        self._background.stop()
        self._rays, self.exact, self._begun, self._shade = None, None, False, ""
        self._state.update(
            {"ghosts_src": "", "ghosts_full": "", "ghosts_note": "", "ghosts_progress": "", "ghost_heads": [],
             "ghost_rows": []}
        )  # fmt: skip

    def show(self, rays: Rays, kept: NDArray[np.bool_]) -> None:
        """Show the ghosts of rays, and begin to integrate them over the pupil.

        Parameters
        ----------
        rays : Rays
        kept : (n,) bool
            Paths that the filter keeps.
        """
        self._rays, self._kept = rays, kept
        if not self._begun:
            # This takes seconds, so it is done for an open tab of ghosts only.
            self._begun = True
            self._background.begin(lambda say: _integrated(rays, say), self._tell, self._take)
            self._tell("beginning")
        self._draw()

    def _tell(self, words: str) -> None:
        self._state.ghosts_progress = words

    def _take(self, found: tuple[ExactGhosts | None, str]) -> None:
        """Show integrated powers."""
        self.exact, self._shade = found
        if self.exact is not None:
            self._on_integrated()
        if self._state.side == "ghosts":
            self._draw()

    @property
    def _is_whole(self) -> bool:
        return bool(self._kept.all())

    def _matrix(self, rays: Rays) -> GhostMatrix:
        return ghost_matrix(rays.keep(self._kept), self.exact if self._is_whole else None)

    def _draw(self) -> None:
        """Draw the ghosts by pair of surfaces, and list them."""
        state, rays = self._state, self._rays
        if rays is None:
            return
        matrix, is_pending = self._matrix(rays), bool(state.ghosts_progress)
        try:
            state.ghosts_src = figure_url(ghost_picture(matrix))
        except LfmeshError as none:
            note = "" if is_pending else why_dark(rays) or str(none)
            state.update({"ghosts_src": "", "ghost_rows": [], "ghosts_note": note})
            return
        state.ghost_heads = [head.format(unit=rays.unit) for head in GHOST_HEADS]
        state.ghost_rows = [ghost_cells(pair) for pair in matrix.pairs()[:MOST_ROWS]]
        origin = UNTIL if is_pending and self._is_whole else origin_in_words(rays, is_whole=self._is_whole)
        state.ghosts_note = " ".join(filter(None, [origin, self._shade]))

    def _show_full(self) -> None:
        """Draw the whole figure, with its numbers."""
        if self._rays is not None:
            self._state.ghosts_full = figure_url(self._matrix(self._rays).figure())


def _integrated(rays: Rays, say: Say) -> tuple[ExactGhosts | None, str]:
    """Return the integrated ghosts of rays, if any, and the targets that shade their field points in words."""
    say("Integrating over the pupil")
    exact = exact_of(rays)
    return exact, "" if exact is None else shade_in_words(rays)


def shade_in_words(rays: Rays) -> str:
    """Return the targets between the field points of a launch and the lens in words, or ""."""
    world, points = rays.world, rays.field.points_mm if rays.field is not None else ()
    to_camera, numbers = world.tables.frames[WORLD_FRAME, CAMERA_FRAME], list(range(len(world.targets)))
    found = {number for point in points for number in in_the_way(world, frames.points(to_camera, [point])[0], numbers)}
    names = [named_target(world.scene, number) for number in sorted(found)]
    if not names:
        return ""
    return f"{' and '.join(names)} {'shades' if len(names) == 1 else 'shade'} part of the lens, which is left out."
