"""Light-field part of the page: raw image, view under the mouse, refocusing, epipolar-plane image, depth."""

import math
from collections.abc import Callable
from typing import Any

from lfmesh.errors import LfmeshError
from lfmesh.files.depth import save_depth, save_truth
from lfmesh.lightfield.photographs.depth import DepthMap, estimate_depth
from lfmesh.lightfield.photographs.depth_truth import DepthTruth, depth_truth
from lfmesh.lightfield.views.field import LightField
from lfmesh.lightfield.views.upright import Upright
from lfmesh.notebook import Say
from lfmesh.view.browser.background import Background
from lfmesh.view.browser.field_views import STEPS, FieldViews, Place
from lfmesh.view.browser.replies import Replies
from lfmesh.view.browser.sensor_picture import SensorPicture
from lfmesh.view.browser.subject import PageSubject
from lfmesh.view.pictures import data_url

SCREEN_PX = 560.0
"""Approximate width of the picture on a screen."""

CENTRES_FROM_PX, CIRCLES_FROM_PX = 6.0, 24.0
"""Micro-image widths on the screen from which centres are drawn, and circles around them."""

NO_RUN = (
    "The light-field views need a run: render the scene with lfmesh render scene.toml -o run/, then open the page with "
    "lfmesh view run/ --browser."
)
NO_LENSLET = "covered by no micro-image, so no view shows it"
NO_ARRAY = "This camera has no microlens array: it records no light field."


class LightFieldPanel:
    """State and handlers of the page's light-field part, and of the sensor picture beside the rays.

    Parameters
    ----------
    server : trame_server.Server
    replies : Replies
    subject : PageSubject
    """

    def __init__(self, server: Any, replies: Replies, subject: PageSubject) -> None:
        self._state = server.state
        self._subject, self._scene, self._image = subject, subject.scene, subject.image
        self._picture: SensorPicture | None = None
        self._views: FieldViews | None = None
        self._marked: tuple[range, range] | None = None
        self._epi_at: Place | None = None
        self._background = Background(server, replies)
        self._state.update(_first_state(subject))
        replies.on_change(["tab", "side", "centres"], self._open)
        replies.on_latest("raw_hover", self._hover)
        replies.on_call("raw_pick", self._pick)
        replies.on_call("raw_zoom", self._moved(lambda picture, x, y, enlarge: picture.zoom(x, y, enlarge)))
        replies.on_call("raw_move", self._moved(lambda picture, dx, dy: picture.move(dx, dy)))
        replies.on_call("raw_whole", self._moved(lambda picture: picture.whole()))
        replies.on_latest("focus", self._refocus)
        replies.on_call("parallax", self._parallax)
        replies.on_call("find_depth", self._find_depth)
        replies.on_change(["epi_along"], self._draw_epi)

    def close(self) -> None:
        """Stop what is still being computed for the page."""
        self._background.close()

    @property
    def picture(self) -> SensorPicture:
        """Picture of the sensor, made at first use."""
        if self._picture is None:
            columns, rows = self._scene.camera.sensor.pixels
            calibration = self._subject.calibration if self._scene.camera.mla is not None else None
            self._picture = SensorPicture(columns, rows, Upright.of(self._scene), self._image, calibration)
            self._picture.lit()
        return self._picture

    def mark(self, rows: range, columns: range) -> None:
        """Mark pixels in the sensor picture."""
        self._state.raw_marked = list(self.picture.box(rows, columns))
        self._marked = (rows, columns)

    @property
    def marked(self) -> tuple[range, range] | None:
        """Rows and columns of the marked pixels."""
        return self._marked

    def _open(self) -> None:
        """Fill a tab when it is first opened."""
        state = self._state
        if state.tab == "field" and state.has_field:
            try:
                self._read()
            except LfmeshError as fault:
                state.has_field, state.field_note = False, str(fault)
                return
        if (state.tab == "field" and state.has_field) or state.side == "sensor":
            self._show_raw()

    def _read(self) -> FieldViews:
        """Return the light field, read and shown at first use, which may be a click before the tab is filled.

        Raises
        ------
        LfmeshError
            There is none, or a file of it is damaged.
        """
        if self._views is None:
            if not self._state.has_field:
                raise LfmeshError(self._state.field_note)
            self._views = self._subject.field_views
            self._show_field(self._views)
        return self._views

    def _show_raw(self) -> None:
        picture, state = self.picture, self._state
        part = picture.part
        pitch = picture.pitch_px * SCREEN_PX / part.width
        state.raw_src = data_url(picture.pixels_shown())
        state.raw_width, state.raw_height = part.width, part.height
        wished = state.centres and pitch >= CENTRES_FROM_PX
        state.raw_centres = picture.centres_shown().round(5).tolist() if wished else []
        state.raw_spots = pitch < CIRCLES_FROM_PX
        state.raw_radius = 0.5 * picture.pitch_px / part.width
        lenslets = f", micro-image pitch {picture.pitch_px:.4g} px" if picture.pitch_px else ""
        shown = "" if part == picture.all else f"{part.width} × {part.height} of "
        state.raw_note = f"{shown}{picture.columns} × {picture.rows} px{lenslets}"
        if self._marked is not None:
            self.mark(*self._marked)

    def _moved(self, move: Callable[..., None]) -> Callable[..., None]:
        """Return a function that moves the visible part of the picture, shows it, and clears the marked area."""

        def moved(*arguments: float) -> None:
            move(self.picture, *arguments)
            if self._marked is not None and (len(self._marked[0]) > 1 or len(self._marked[1]) > 1):
                self._marked = self._state.raw_marked = None
            self._show_raw()

        return moved

    def _show_field(self, views: FieldViews) -> None:
        """Show the middle view, the plane of focus, the middle row's epipolar-plane image and the depth."""
        state, field = self._state, views.field
        (rows, columns), (height, width) = field.views, field.size
        ratio = width / height
        state.field_size = f"width: min(100cqw, {100 * ratio:.4f}cqh); height: min(100cqh, {100 / ratio:.4f}cqw)"
        state.focus_near, state.focus_far = _in_mm(views.planes_mm[0]), _in_mm(views.planes_mm[-1])
        state.focus = views.focus_step
        self._refocus(views.focus_step)
        self._show_view(rows // 2, columns // 2)
        self._show_epi(Place((0, 0), rows // 2, columns // 2, height // 2, width // 2))
        self._show_depth(views)

    def _hover(self, x: float, y: float) -> None:
        """Describe the pixel under the mouse, and show its view."""
        row, column = self.picture.pixel(x, y)
        words = f"pixel row {row}, column {column}"
        if self._image is not None:
            power, error = self._image.mean[row, column].sum(), math.hypot(*self._image.stderr[row, column])
            words += f": {power:.3g} ± {error:.1g} W"
        place = self._views.place(row, column) if self._views is not None else None
        if place is not None:
            words += f"; lenslet row {place.lenslet[0]}, column {place.lenslet[1]}{self._depth_at(place)}"
            self._show_view(place.v, place.u)
        self._state.raw_under = words

    def _depth_at(self, place: Place) -> str:
        assert self._views is not None
        if self._views.depth_mm is None or not math.isfinite(depth := self._views.depth_mm[place.t, place.s]):
            return ""
        return f", {depth:.4g} mm away"

    def _pick(self, x: float, y: float) -> None:
        """Mark a pixel, and show the epipolar-plane image of its lenslet row."""
        row, column = self.picture.pixel(x, y)
        self.mark(range(row, row + 1), range(column, column + 1))
        place = self._read().place(row, column)
        if place is None:
            self._state.raw_under = f"pixel row {row}, column {column}: {NO_LENSLET}"
            return
        self._show_epi(place)
        self._show_view(place.v, place.u)

    def _show_view(self, v: int, u: int) -> None:
        views = self._read()
        field = views.field
        self._state.view_src = data_url(views.view(v, u))
        self._state.view_note = f"v {v}, u {u} of {field.views[0]} × {field.views[1]}"

    def _refocus(self, step: int) -> None:
        views = self._read()
        distance = views.planes_mm[min(max(int(step), 0), STEPS)]
        self._state.focus_src = data_url(views.photograph(distance))
        self._state.focus_note = f"on {_in_mm(distance)}, all views"

    def _show_epi(self, place: Place) -> None:
        self._epi_at = place
        self._draw_epi()

    def _draw_epi(self) -> None:
        """Draw the epipolar-plane image of the row or column through the chosen position."""
        if self._views is None or self._epi_at is None:
            return
        state, field, (_, v, u, t, s) = self._state, self._views.field, self._epi_at
        height, width = field.size
        if state.epi_along == "row":
            state.epi_src = data_url(self._views.epi(t, v))
            state.epi_row = f"top: {100.0 * t / height:.3f}%; height: {100.0 / height:.3f}%"
            state.epi_note = f"row t {t} ({field.t_mm[t]:+.3g} mm), v {v}"
        else:
            state.epi_src = data_url(self._views.epi_of_column(s, u))
            place, wide = 100.0 * s / width, 100.0 / width
            state.epi_row = f"top: 0; height: 100%; left: {place:.3f}%; right: auto; width: {wide:.3f}%"
            state.epi_note = f"column s {s} ({field.s_mm[s]:+.3g} mm), u {u}"

    def _parallax(self) -> None:
        """Start or stop the circular motion of the viewpoint in the pupil."""
        views = self._read()
        self._state.parallax = [] if self._state.parallax else list(map(data_url, views.round_trip()))

    def _find_depth(self) -> None:
        """Find the depth in the light field and the true depth, as `lfmesh depth` does; the page answers meanwhile."""
        if self._state.depth_progress or self._read().depth_mm is not None:
            return
        field = self._read().field
        self._background.begin(lambda say: _depths(field, say), self._tell_depth, self._take_depth)
        self._tell_depth("beginning")

    def _tell_depth(self, words: str) -> None:
        self._state.depth_progress = words

    def _take_depth(self, depths: tuple[DepthMap, DepthTruth]) -> None:
        """Add depths to the run, and show them."""
        estimate, truth = depths
        views, folder = self._read(), self._subject.folder
        assert folder is not None
        save_truth(truth, folder)
        save_depth(estimate, truth.middle_mm, folder, truth.without_depth)
        views.read_depth()
        self._show_depth(views)

    def _show_depth(self, views: FieldViews) -> None:
        depth = views.depth()
        if depth is None:
            return
        picture, low, high = depth
        self._state.depth_src = data_url(picture)
        self._state.depth_low, self._state.depth_high = _in_mm(low), _in_mm(high)
        self._state.depth_note = "from the light field; grey: unknown"


def _first_state(subject: PageSubject) -> dict[str, Any]:
    """Return the panel's initial variables."""
    scene, folder = subject.scene, subject.folder
    has_field = subject.image is not None and folder is not None and scene.camera.mla is not None
    names = ["raw_src", "raw_note", "raw_under", "view_src", "view_note", "focus_src", "focus_note", "focus_near"]
    names += ["focus_far", "epi_src", "epi_note", "depth_src", "depth_low", "depth_high", "depth_note", "field_size"]
    names += ["depth_progress"]
    return {
        **dict.fromkeys(names, ""),
        "has_field": has_field,
        "field_note": NO_ARRAY if scene.camera.mla is None else NO_RUN,
        "run_name": str(folder) if folder is not None else "run/",
        "raw_width": 1,
        "raw_height": 1,
        "raw_centres": [],
        "raw_radius": 0.0,
        "raw_marked": None,
        "raw_spots": False,
        "centres": True,
        "epi_row": "",
        "epi_along": "row",
        "parallax": [],
        "focus": 0,
        "focus_steps": STEPS,
    }


def _depths(field: LightField, say: Say) -> tuple[DepthMap, DepthTruth]:
    """Return estimate and truth of the depth of a light field, with the progress in words."""
    estimate = estimate_depth(field, progress=say)
    return estimate, depth_truth(field.scene, views=field.views[0], progress=say)


def _in_mm(distance: float) -> str:
    return f"{distance:.4g} mm" if math.isfinite(distance) else "infinity"
