"""Scene and rays in a pyvista plotter, shared by windows, pictures, pages and the browser's server."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from vtkmodules.vtkRenderingCore import vtkMapper, vtkProp

from lfmesh.geometry import frame as frames
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME, WORLD_FRAME
from lfmesh.transport.world import World
from lfmesh.view.media import shown_media
from lfmesh.view.scene3d.array_shape import FINE, Detail
from lfmesh.view.scene3d.colours import BACKGROUND, BACKGROUND_TOP, ColourBy, Legend, default_colour
from lfmesh.view.scene3d.gl import expect_no_display
from lfmesh.view.scene3d.overlay import Overlay, in_words
from lfmesh.view.scene3d.parts import Part, Picture, parts, smooth, texture_of, tick_mm
from lfmesh.view.scene3d.presets import ANGLE_DEG, PRESETS, box_corners, viewpoint
from lfmesh.view.scene3d.ray_lines import MOST_SEGMENTS, RayLines, ray_lines

if TYPE_CHECKING:
    from lfmesh.view.rays.paths import Rays

SIZE = (1600, 1000)

RAY_WIDTH, EDGE_WIDTH = 1.6, 1.3
"""Line widths in pixels."""

NEAREST = 1e-5
"""Smallest ratio of near to far plane distance: allows an eye before a lenslet to see a wall as well."""

CORNER = 0.8
"""Lower bound on the cosine of the angle from the centre of a perspective view to its corners."""

SAMPLES = 8
"""Samples per pixel in pictures."""

MOST_NAMED = 6
"""Most media in names and in the caption."""

SAME_HEIGHT = 1e-6
"""Difference in height of two points of the same edge, relative to the height of a body."""

CUT_KINDS = ("glass", "mount", "stop", "array")
"""Kinds of parts opened by the cut; sensor, targets and rays stay whole."""


class View:
    """World and rays drawn in a plotter.

    Attributes
    ----------
    plotter : pyvista.Plotter
    world : World
    lines : RayLines or None
        Drawn rays.
    ray_mesh : pyvista.PolyData or None
    ray_actor : vtkActor or None
        Its cells carry "path" and "vertex", see `RayLines`.
    caption : list of str
    legend : Legend or None
    preset : str
    is_cut : bool
    """

    def __init__(
        self, world: World, picture: Picture | None = None, *, size: tuple[int, int] = SIZE,
        off_screen: bool = True, near_mm: tuple[float, float] = (0.0, 0.0), detail: Detail = FINE,
    ) -> None:  # fmt: skip
        self.world = world
        self.near_mm, self.detail = near_mm, detail
        self.lines: RayLines | None = None
        self.ray_mesh: pv.PolyData | None = None
        self.ray_actor: Any = None
        self.caption: list[str] = []
        self.legend: Legend | None = None
        self.preset = "whole"
        self._fitted: tuple[Any, ...] = ()
        self._picture = picture
        self._parts = parts(world, picture, near_mm, detail)
        self._of_actor: dict[Any, Part] = {}
        self.is_cut = False
        expect_no_display()
        # Edges lie on the faces that they bound, and must be drawn in front of them.
        vtkMapper.SetResolveCoincidentTopologyToPolygonOffset()
        self.plotter = pv.Plotter(off_screen=off_screen, window_size=size, lighting="light kit")
        # Without smoothing, software rendering is twice as fast; it is for pictures.
        self.smooth(False)
        self.plotter.set_background(BACKGROUND, top=BACKGROUND_TOP)
        self.plotter.renderer.SetNearClippingPlaneTolerance(NEAREST)
        # Before each picture: whatever changed the window or moved the camera.
        self.plotter.renderer.AddObserver("StartEvent", lambda *_: self._keep_preset())
        self.plotter.renderer.AddObserver("StartEvent", lambda *_: self._move_near_plane())
        self.plotter.add_axes(xlabel="x", ylabel="y", zlabel="z", color="white", line_width=2)
        self.overlay = Overlay(self.plotter)
        self._media = shown_media(world)
        self._name_media()
        self._draw_parts()
        self.look(self.preset)

    @property
    def presets(self) -> list[str]:
        """Names that `look` accepts for this camera."""
        return [name for name in PRESETS if name != "array" or self.world.tables.mla.present]

    @property
    def title(self) -> str:
        """Title of the scene."""
        return self.world.scene.title or "unnamed scene"

    @property
    def scale(self) -> str:
        """Lengths of the picture's scales in words."""
        length = float(self.world.tables.frames[SENSOR_FRAME, CAMERA_FRAME, 2, 3])
        return f"axis marked every {in_words(tick_mm(self.world))}; {length:.4g} mm from the first vertex to the sensor"

    @property
    def array_edge(self) -> NDArray[np.float64]:
        """(3,) centre of the array's lower edge, mm, world frame."""
        tables = self.world.tables
        edge = [[0.0, -tables.mla.lenslets.lattice.half_extent[1], 0.0]]
        return np.asarray(frames.points(tables.frames[MLA_FRAME, WORLD_FRAME], edge)[0])

    def look(self, preset: str, aspect: float | None = None, angle_deg: float = ANGLE_DEG) -> None:
        """Move the eye to one of the `presets`.

        Parameters
        ----------
        preset : str
        aspect : float, optional
            Width over height of the picture (default: the plotter's).
        angle_deg : float
            Vertical field of view of a perspective picture.
        """
        width, height = self.plotter.window_size
        seen = viewpoint(self.world, preset, aspect or width / height, self.near_mm, angle_deg)
        camera = self.plotter.camera
        camera.position, camera.focal_point, camera.up = seen.eye, seen.focus, seen.up
        camera.parallel_projection = seen.parallel
        camera.parallel_scale = seen.half_height_mm
        camera.view_angle = angle_deg
        self.plotter.renderer.ResetCameraClippingRange()
        self.plotter.camera_set = True
        self.preset = preset
        self._fitted = ((width, height), self._eye()) if aspect is None else ()

    def cut(self, on: bool = True) -> None:
        """Cut lens and array along the axis and hide the half before the eye; rays stay whole."""
        if on != self.is_cut:
            self.is_cut = on
            self._draw_parts()

    def near(self, place_mm: tuple[float, float]) -> None:
        """Move the real lenslets of a large array, and the view "array", to a point (x, y) of the array's frame."""
        if place_mm != self.near_mm:
            self.near_mm = place_mm
            self._parts = parts(self.world, self._picture, place_mm, self.detail)
            self._draw_parts()

    def show_rays(
        self, rays: "Rays | None", colour: ColourBy | None = None, *,
        fade: bool = False, most_segments: int = MOST_SEGMENTS, width: float = RAY_WIDTH,
    ) -> None:  # fmt: skip
        """Draw rays, replacing any drawn before.

        Parameters
        ----------
        rays : Rays or None
        colour : {"wavelength", "power", "events", "status", "path", "field"}, optional
        fade : bool
            Draw weaker rays fainter.
        most_segments : int
            Above this, an even selection of whole paths is drawn, and the caption gives their number.
        width : float
            Line width in pixels.
        """
        self.plotter.remove_actor("rays", render=False)
        self.lines = self.ray_mesh = self.ray_actor = self.legend = None
        if rays is not None and len(rays):
            self.lines = ray_lines(rays, most_segments)
            mesh, self.legend = self.lines.coloured(colour or default_colour(rays), fade=fade)
            mesh = in_single_precision(mesh) if self.detail.is_single else mesh
            self.ray_mesh = mesh
            if mesh.n_cells:
                self.ray_actor = self.plotter.add_mesh(
                    mesh, scalars="rgba", rgb=True, line_width=width, lighting=False,
                    name="rays", reset_camera=False, render=False, copy_mesh=False,
                )  # fmt: skip

    def write(self, lines: list[str]) -> None:
        """Write the title and a caption over the picture: description and number of the drawn rays, and media."""
        drawn = [self.lines.caption] if self.lines is not None else []
        self.caption = [*lines, *drawn, *(medium.in_words for medium in self._media[:MOST_NAMED])]
        more = len(self._media) - MOST_NAMED
        if more > 0:
            self.caption.append(f"and {more} more {'medium' if more == 1 else 'media'}")
        self.overlay.write(self.title, [*self.caption, self.scale], self.legend)

    def smooth(self, on: bool) -> None:
        """Draw edges and lines smoothly, or quickly."""
        self.plotter.render_window.SetMultiSamples(SAMPLES if on else 0)

    def tell(self, lines: list[str]) -> None:
        """Replace the text at the bottom of the picture."""
        self.overlay.tell(lines)

    def part_of(self, actor: vtkProp) -> Part | None:
        """Return the part that an actor shows; None for rays and text."""
        return self._of_actor.get(actor)

    def meshes(self) -> list[tuple[Part, pv.PolyData]]:
        """Return the drawn mesh of every part, whole or cut."""
        return [(part, self._shown(part)) for part in self._parts]

    def _name_media(self) -> None:
        """Write the names of media with a body at their tops."""
        up = self.world.tables.frames[CAMERA_FRAME, WORLD_FRAME][:, 1]
        for medium in self._media[:MOST_NAMED]:
            if medium.body is not None:
                corners = np.asarray(medium.body.vertices)
                height = corners @ up
                highest = corners[height >= height.max() - SAME_HEIGHT * np.ptp(height)]
                self.overlay.name(medium.name, highest.mean(axis=0), box_corners(corners))

    def _eye(self) -> tuple[Any, ...]:
        camera = self.plotter.camera
        return camera.position, camera.focal_point, camera.up, camera.parallel_scale

    def _keep_preset(self) -> None:
        """Fit the preset into a window of another shape, unless the user has turned or zoomed the view."""
        if self._fitted and tuple(self.plotter.window_size) != self._fitted[0] and self._eye() == self._fitted[1]:
            self.look(self.preset)

    def _move_near_plane(self) -> None:
        """Put the near plane halfway to the nearest part, as nearer planes reduce the depth resolution."""
        camera = self.plotter.camera
        if camera.parallel_projection:
            return
        eye = np.array(camera.position)
        boxes = np.array([part.mesh.bounds for part in self._parts]).reshape(-1, 3, 2)
        beside = np.maximum(0.0, np.maximum(boxes[..., 0] - eye, eye - boxes[..., 1]))
        # The eye may be inside a medium, which has nothing to show there.
        is_medium = np.array([part.kind == "medium" for part in self._parts])
        beside = beside[beside.any(axis=1) | ~is_medium]
        near, far = camera.clipping_range
        # Depth along the view axis is less than the distance to a box at the picture's corners.
        camera.clipping_range = (max(near, 0.5 * CORNER * float(np.linalg.norm(beside, axis=1).min())), far)

    def _draw_parts(self) -> None:
        for actor in self._of_actor:
            self.plotter.remove_actor(actor, render=False)
        self._of_actor = {}
        # Parts of a target share its picture.
        textures = {id(part.picture): texture_of(part) for part in self._parts if part.picture is not None}
        for number, part in enumerate(self._parts):
            mesh = self._shown(part)
            label = f"{part.label} {number}"
            if mesh.n_cells:
                self._add(part, mesh, name=label, texture=textures.get(id(part.picture)), **part.look)
            edges = self._cut_edges(part, mesh)
            if edges is not None and edges.n_cells:
                self._add(
                    part, edges, name=f"{label} edges", color=part.edge_colour, line_width=EDGE_WIDTH, lighting=False
                )

    def _add(self, part: Part, mesh: pv.PolyData, **look: Any) -> None:
        mesh = in_single_precision(mesh) if self.detail.is_single else mesh
        actor = self.plotter.add_mesh(mesh, reset_camera=False, render=False, copy_mesh=False, **look)
        self._of_actor[actor] = part

    def _shown(self, part: Part) -> pv.PolyData:
        if not self.is_cut or part.kind not in CUT_KINDS:
            return part.mesh
        normal, origin = self._plane()
        if part.solid is not None:
            return smooth(part.solid.clip_closed_surface(normal=-normal, origin=origin))
        return part.mesh.clip(normal=normal, origin=origin, invert=True)

    def _cut_edges(self, part: Part, mesh: pv.PolyData) -> pv.PolyData | None:
        if part.edges is None or not self.is_cut or part.kind not in CUT_KINDS:
            return part.edges
        normal, origin = self._plane()
        outline = part.mesh.slice(normal=normal, origin=origin)
        return part.edges.clip(normal=normal, origin=origin, invert=True).merge(outline)

    def _plane(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the plane of the cut, the camera's yz plane: its normal, towards the hidden half, and a point."""
        to_world = self.world.tables.frames[CAMERA_FRAME, WORLD_FRAME]
        return -to_world[:, 0], to_world[:, 3]


def in_single_precision(mesh: pv.PolyData) -> pv.PolyData:
    """Return a copy of a mesh with points and normals in single precision."""
    small, normals = mesh.copy(), mesh.point_data.active_normals
    small.points = np.asarray(mesh.points, dtype=np.float32)
    if normals is not None:
        small.point_data.active_normals = np.asarray(normals, dtype=np.float32)
    return small


@dataclass(frozen=True)
class Drawing:
    """Drawing options of a world and its rays.

    Attributes
    ----------
    colour : {"wavelength", "power", "events", "status", "path", "field"}, optional
        Meaning of the ray colours (default: the wavelength, or the field point if there is one wavelength).
    fade : bool
        Draw weaker rays fainter.
    preset : str
        Viewpoint, one of `PRESETS`.
    cut : bool
        Cut lens and array along the axis; rays stay whole.
    size : (width, height), pixels
    most_segments : int
        Above this, a selection of whole paths is drawn, and the caption gives their number.
    """

    colour: ColourBy | None = None
    fade: bool = False
    preset: str = "whole"
    cut: bool = False
    size: tuple[int, int] = SIZE
    most_segments: int = MOST_SEGMENTS


def build_view(
    world: World, rays: "Rays | None", picture: Picture | None, drawing: Drawing, *,
    off_screen: bool = True, near_mm: tuple[float, float] = (0.0, 0.0), caption: tuple[str, ...] = (),
    detail: Detail = FINE,
) -> View:  # fmt: skip
    """Draw a world and its rays.

    Parameters
    ----------
    world : World
    rays : Rays or None
    picture : (rows, columns, 3) uint8, or None
        Picture on the sensor, in physical orientation: see `sensor_picture`.
    drawing : Drawing
    off_screen : bool
    near_mm : (x, y), mm
        Point of the array for a close view, in the array's frame.
    caption : tuple of str
        Lines between the title and the number of paths.
    detail : Detail
    """
    view = View(world, picture, size=drawing.size, off_screen=off_screen, near_mm=near_mm, detail=detail)
    view.cut(drawing.cut)
    view.show_rays(rays, drawing.colour, fade=drawing.fade, most_segments=drawing.most_segments)
    view.write(list(caption))
    view.look(drawing.preset)
    return view
