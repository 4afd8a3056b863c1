"""Bodies of media as translucent meshes in the world frame, mm: fainter the less light they stop, denser inside."""

from collections.abc import Iterator

import numpy as np
import pyvista as pv

from lfmesh.geometry import frame as frames
from lfmesh.view.media import EMITS, ShownMedium

LEVELS = (0.1, 0.3, 0.6)
"""Shells of a medium that varies in space: amounts over the largest."""

FAINTEST, DENSEST = 0.06, 0.35
"""Opacity of a body: 1 − exp(−optical depth) within these limits."""

GLOWING = 0.25
"""Least opacity of a medium that emits."""


def bodies(medium: ShownMedium) -> Iterator[tuple[pv.PolyData, float]]:
    """Yield the surfaces of a medium with their opacities: its body, or shells of equal amount inside it.

    Nothing for a medium without a body.
    """
    if medium.body is None:
        return
    least = GLOWING if medium.effect == EMITS else FAINTEST
    opacity = float(np.clip(1.0 - np.exp(-medium.depth), least, DENSEST))
    if medium.grid is None:
        faces = np.asarray(medium.body.faces, dtype=np.int64)
        yield pv.PolyData.from_regular_faces(medium.body.vertices, faces).clean(), opacity
        return
    # A border without medium closes shells that reach the end of the grid.
    amounts, spacing = np.pad(medium.grid.values, 1), medium.grid.spacing_mm
    grid = pv.ImageData(dimensions=amounts.shape, spacing=tuple(spacing), origin=tuple(medium.grid.origin_mm - spacing))
    grid.point_data["amount"] = amounts.ravel(order="F")
    for level in LEVELS:
        shell = grid.contour([level], scalars="amount", compute_normals=False)
        if shell.n_cells:
            shell.clear_data()
            shell.points = frames.points(medium.to_world, shell.points)
            yield shell, opacity
