"""Text over the picture: title, caption, legend, and a scale bar that follows the zoom."""

from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkRenderingCore import vtkActor2D, vtkCoordinate, vtkPolyDataMapper2D, vtkTextActor, vtkTextRenderer

from lfmesh.view.scene3d.colours import BACKGROUND, FAINT_TEXT, TEXT, Legend
from lfmesh.view.scene3d.parts import round_length
from lfmesh.view.scene3d.projection import projection_matrix

_FONTS = Path(mpl.get_data_path()) / "fonts" / "ttf"
FONT, FONT_OF_COLUMNS = _FONTS / "DejaVuSans.ttf", _FONTS / "DejaVuSansMono.ttf"
"""VTK's own fonts lack Greek letters and many signs."""

LINE = 1.55
"""Line spacing relative to the text size."""

DPI = 72
"""VTK's dots per inch: sizes of text are in pixels."""

BORDER = 0.01
"""Room between a name and the border of the picture, relative to the picture's size."""

APART = 1.2
"""Distance of names, relative to their size."""

BAR_PX = 220
"""Longest scale bar in a picture 1000 pixels high."""


@dataclass(frozen=True)
class Name:
    """Name of a body.

    Attributes
    ----------
    text : vtkTextActor
    size_px : (width, height)
    points : (9, 4) float64
        Its place, and the corners of a box round the body, homogeneous, mm, world frame.
    """

    text: vtkTextActor
    size_px: NDArray[np.float64]
    points: NDArray[np.float64]


class Overlay:
    """Text and scale bar of one plotter.

    Attributes
    ----------
    names : list of Name
    """

    def __init__(self, plotter: pv.Plotter) -> None:
        self._plotter = plotter
        self._texts: list[vtkTextActor] = []
        self._told: list[vtkTextActor] = []
        self.names: list[Name] = []
        self._shows_names = True
        self._caption_end = np.array([0.0, 1.0])
        self._mark = vtkTextActor()
        self._scale = plotter.window_size[1] / 1000.0
        self._bar, self.bar_text, self.bar_points = self._scale_bar()
        # Just before every picture, whatever moved the camera.
        plotter.renderer.AddObserver("StartEvent", lambda *_: self._measure())
        plotter.renderer.AddObserver("StartEvent", lambda *_: self._place_names())

    def write(self, title: str, caption: list[str], legend: Legend | None) -> None:
        """Replace the text.

        Parameters
        ----------
        title : str
        caption : list of str
            Lines below the title.
        legend : Legend or None
        """
        for text in self._texts:
            self._plotter.renderer.RemoveViewProp(text)
        self._texts = [self._text(title, 24, (0.015, 0.985), TEXT, top=True)]
        height = self._plotter.window_size[1]
        below = 0.985 - 24 * LINE * self._scale / height
        for line in caption:
            self._texts.append(self._text(line, 15, (0.015, below), FAINT_TEXT, top=True))
            below -= 15 * LINE * self._scale / height
        wide = max(_size_px(text)[0] for text in self._texts)
        self._caption_end = np.array([0.015 + wide / self._plotter.window_size[0], below])
        if legend is not None and legend.entries:
            top = 0.985
            for label, colour in ((legend.title, TEXT), *legend.entries):
                self._texts.append(self._text(label, 15, (0.985, top), colour, top=True, right=True))
                top -= 15 * LINE * self._scale / height

    def only_scale(self, on: bool, enlarged: float = 2.4) -> None:
        """Show only the scale bar, its text enlarged, or everything again."""
        self._shows_names = not on
        for text in (*self._texts, *self._told):
            text.SetVisibility(not on)
        self.bar_text.GetTextProperty().SetFontSize(round((enlarged if on else 1.0) * 15 * self._scale))
        (self._plotter.hide_axes if on else self._plotter.show_axes)()

    def mark(self, words: str, place_mm: NDArray[np.float64] | None = None) -> None:
        """Write text at a point of the scene, world frame, or large in the upper left corner; see `unmark`."""
        self.unmark()
        self._mark = self._text(words, 20 if place_mm is not None else 36, (0.015, 0.985), TEXT, top=True)
        if place_mm is not None:
            self._mark.GetPositionCoordinate().SetCoordinateSystemToWorld()
            self._mark.GetPositionCoordinate().SetValue(*place_mm)

    def unmark(self) -> None:
        """Remove the text of `mark`."""
        self._plotter.renderer.RemoveViewProp(self._mark)

    def name(self, words: str, place_mm: NDArray[np.float64], corners_mm: NDArray[np.float64]) -> None:
        """Write a name above a point of a body in all pictures that show the body.

        A name whose point is outside the picture stands at the picture's border.

        Parameters
        ----------
        words : str
        place_mm : (3,) float64, world frame
        corners_mm : (8, 3) float64, world frame
            Corners of a box round the body.
        """
        text = self._text(words, 15, (0.0, 0.0), TEXT)
        text.GetTextProperty().SetJustificationToCentered()
        points = np.column_stack([np.vstack([place_mm, corners_mm]), np.ones(1 + len(corners_mm))])
        self.names.append(Name(text, _size_px(text), points))

    def tell(self, lines: list[str]) -> None:
        """Replace the text at the bottom."""
        for text in self._told:
            self._plotter.renderer.RemoveViewProp(text)
        step = 13 * LINE * self._scale / self._plotter.window_size[1]
        self._told = [
            self._text(line, 13, (0.2, 0.03 + step * place), TEXT) for place, line in enumerate(reversed(lines))
        ]
        for text in self._told:
            text.GetTextProperty().SetFontFile(str(FONT_OF_COLUMNS))

    def _text(
        self, words: str, size: int, place: tuple[float, float], colour: str, *, top: bool = False, right: bool = False
    ) -> vtkTextActor:
        text = vtkTextActor()
        # VTK treats text between two $ as mathematics unless escaped.
        text.SetInput(words.replace("$", r"\$"))
        text.GetPositionCoordinate().SetCoordinateSystemToNormalizedViewport()
        text.SetPosition(*place)
        look = text.GetTextProperty()
        look.SetFontFamily(4)  # VTK_FONT_FILE
        look.SetFontFile(str(FONT))
        look.SetFontSize(max(9, round(size * self._scale)))
        look.SetColor(*pv.Color(colour).float_rgb)
        # Keep it readable over lenslets and charts.
        look.SetBackgroundColor(*pv.Color(BACKGROUND).float_rgb)
        look.SetBackgroundOpacity(0.6)
        if top:
            look.SetVerticalJustificationToTop()
        if right:
            look.SetJustificationToRight()
        self._plotter.renderer.AddViewProp(text)
        return text

    def _place_names(self) -> None:
        """Move each name above its point, within the picture and clear of the names before it."""
        if not self.names:
            return
        size = np.array(self._plotter.window_size, dtype=np.float64)
        matrix = projection_matrix(self._plotter)
        taken: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []
        for name in self.names:
            place = _in_picture(name.points @ matrix.T) if self._shows_names else None
            name.text.SetVisibility(place is not None)
            if place is None:
                continue
            half, high = 0.5 * name.size_px[0], name.size_px[1]
            border = BORDER * size
            middle = 0.5 * (place + 1.0) * size
            middle[0] = np.clip(middle[0], border[0] + half, size[0] - border[0] - half)
            beside_caption = middle[0] - half > self._caption_end[0] * size[0]
            top = size[1] - border[1] if beside_caption else self._caption_end[1] * size[1]
            middle[1] = np.clip(middle[1], border[1], top - high)
            while any((np.abs(middle - other) < 0.5 * APART * (name.size_px + wide)).all() for other, wide in taken):
                middle[1] -= APART * name.size_px[1]
            taken.append((middle, name.size_px))
            name.text.SetPosition(*(middle / size))

    def _scale_bar(self) -> tuple[vtkActor2D, vtkTextActor, vtkPoints]:
        points, lines, data = vtkPoints(), vtkCellArray(), vtkPolyData()
        for _ in range(6):
            points.InsertNextPoint(0.0, 0.0, 0.0)
        for i in (0, 2, 4):
            lines.InsertNextCell(2)
            lines.InsertCellPoint(i)
            lines.InsertCellPoint(i + 1)
        data.SetPoints(points)
        data.SetLines(lines)
        system = vtkCoordinate()
        system.SetCoordinateSystemToViewport()
        mapper = vtkPolyDataMapper2D()
        mapper.SetTransformCoordinate(system)
        mapper.SetInputData(data)
        bar = vtkActor2D()
        bar.SetMapper(mapper)
        bar.GetProperty().SetColor(*pv.Color(TEXT).float_rgb)
        bar.GetProperty().SetLineWidth(2.0)
        self._plotter.renderer.AddViewProp(bar)
        return bar, self._text("", 15, (0.985, 0.05), TEXT, right=True), points

    def _measure(self) -> None:
        """Give the bar a round length in mm at the centre of rotation of the view."""
        width, height = self._plotter.renderer.GetSize()
        camera = self._plotter.camera
        if camera.parallel_projection:
            mm_per_px = 2.0 * camera.parallel_scale / height
        else:
            mm_per_px = 2.0 * camera.distance * np.tan(np.deg2rad(0.5 * camera.view_angle)) / height
        length = round_length(mm_per_px * BAR_PX * height / 1000.0)
        pixels = length / mm_per_px
        right, bottom, tick = 0.985 * width, 0.03 * height, 5.0 * height / 1000.0
        left = right - pixels
        ends = [(left, 0), (right, 0), (left, -tick), (left, tick), (right, -tick), (right, tick)]
        for i, (x, y) in enumerate(ends):
            self.bar_points.SetPoint(i, x, bottom + y, 0.0)
        self.bar_points.Modified()
        place = "" if camera.parallel_projection else " at the middle of the view"
        self.bar_text.SetInput(f"{in_words(length)}{place}")


def _size_px(text: vtkTextActor) -> NDArray[np.float64]:
    """Return the width and height of a text in pixels."""
    box = [0, 0, 0, 0]
    vtkTextRenderer.GetInstance().GetBoundingBox(text.GetTextProperty(), text.GetInput(), box, DPI)
    return np.maximum([box[1] - box[0], box[3] - box[2]], 1.0)


def _in_picture(points: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the place of the first of some points; None if the picture shows no part of the box of the others.

    Parameters
    ----------
    points : (n, 4) float64
        Homogeneous normalised device coordinates.

    Returns
    -------
    (2,) float64
        -1 to 1 across the picture, and beyond it.
    """
    before_eye = points[:, 3] > 0.0
    # A corner is outside a border of the picture if x > w, and so on; a box all of whose corners are outside one is.
    x, y, w = points[1:, 0], points[1:, 1], points[1:, 3]
    if any((beyond > w).all() for beyond in (x, -x, y, -y)) or not before_eye[1:].any():
        return None
    # A point behind the eye has no place; its body surrounds the eye.
    return np.asarray(points[0, :2] / points[0, 3]) if before_eye[0] else np.array([0.0, 1.0])


def in_words(length_mm: float) -> str:
    """Return a length with its unit."""
    return f"{1e3 * length_mm:.6g} µm" if length_mm < 0.1 else f"{length_mm:.6g} mm"
