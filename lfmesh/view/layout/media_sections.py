"""Media in a layout drawing: outlines of their bodies in the meridional plane, and their amounts there."""

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy import ndimage

from lfmesh.geometry import frame
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.scene import Scene
from lfmesh.transport.build import build
from lfmesh.transport.packets.packet import CAMERA_FRAME, WORLD_FRAME
from lfmesh.view.layout.sections import mesh_section
from lfmesh.view.media import ShownMedium, shown_media

ACROSS = 200
"""Points along the longer side of a picture of amounts."""


@dataclass(frozen=True)
class MediumSection:
    """Meridional section of a medium.

    Attributes
    ----------
    medium : ShownMedium
    lines : list of (n, 2) float64
        Outlines, z and y, mm; none if the medium has no body of its own, or the plane does not cut it.
    amounts : (h, w) float64 or None
        Amount of its effect over its largest, 0 to 1, from the lowest y and z on; None if it is uniform.
    window : tuple of float
        z from and to, y from and to, of `amounts`.
    """

    medium: ShownMedium
    lines: list[Array]
    amounts: Array | None = None
    window: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    @property
    def is_everywhere(self) -> bool:
        """True if it fills all space before the camera."""
        return self.medium.body is None and not self.medium.fills

    @property
    def in_words(self) -> str:
        """Name and amounts, and whether it is beside the plane."""
        beside = self.medium.body is not None and not self.lines
        return self.medium.in_words + (", beside this section" if beside else "")


def media_sections(scene: Scene) -> list[MediumSection]:
    """Return the sections of all media, without lines where the meridional plane does not cut them.

    Parameters
    ----------
    scene : Scene
        Without lamps and particles, which do not matter here and take time to build.

    Raises
    ------
    LfmeshError
        The scene cannot be built.
    """
    if not scene.media:
        return []
    world = build(scene)
    to_camera = world.tables.frames[WORLD_FRAME, CAMERA_FRAME]
    found = []
    for medium in shown_media(world):
        if medium.body is None:
            found.append(MediumSection(medium, []))
            continue
        body = medium.body.moved(to_camera)
        lines = mesh_section(trimesh.Trimesh(body.vertices, body.faces, process=False))
        found.append(_cut(medium, lines, to_camera))
    return found


def _cut(medium: ShownMedium, lines: list[Array], to_camera: Array) -> MediumSection:
    """Return the section of a medium with a body, with its amounts if they vary."""
    if medium.grid is None or not lines:
        return MediumSection(medium, lines)
    corners = np.concatenate(lines)
    (z0, y0), (z1, y1) = corners.min(axis=0), corners.max(axis=0)
    step = max(z1 - z0, y1 - y0) / ACROSS
    count = [max(2, round(size / step)) for size in (z1 - z0, y1 - y0)]
    z, y = (
        low + (np.arange(n) + 0.5) / n * (high - low) for low, high, n in zip((z0, y0), (z1, y1), count, strict=True)
    )
    places = np.stack([np.zeros((len(y), len(z))), *np.meshgrid(y, z, indexing="ij")], axis=-1).reshape(-1, 3)
    to_own = frame.inverse(frame.compose(to_camera, medium.to_world))
    grid = medium.grid
    cells = (frame.points(to_own, places) - grid.origin_mm) / grid.spacing_mm
    values = ndimage.map_coordinates(grid.values, cells.T, order=1, mode="nearest")
    outside = (np.abs(cells - 0.5 * (np.array(grid.values.shape) - 1)) > 0.5 * np.array(grid.values.shape)).any(axis=1)
    amounts = np.where(outside, 0.0, values).reshape(len(y), len(z))
    return MediumSection(medium, lines, amounts, (float(z0), float(z1), float(y0), float(y1)))
