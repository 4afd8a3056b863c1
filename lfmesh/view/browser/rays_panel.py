"""Rays in the page: launching, the 3D view, the path table with its filter, and picking."""

import math
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.scene.literals import counted
from lfmesh.transport.world import World
from lfmesh.view.browser.ghosts_panel import GhostsPanel
from lfmesh.view.browser.replies import Replies
from lfmesh.view.rays import launch
from lfmesh.view.rays.filters import FilterError, parse
from lfmesh.view.rays.ghosts import GHOST_CUTOFF, GHOST_RAYS
from lfmesh.view.rays.history import Step, history
from lfmesh.view.rays.path_table import PathRow, PathTable, path_table, relative_error, short_form
from lfmesh.view.request import REFRACTED, first_points, middle_pixel, pixels_on_array, why_dark
from lfmesh.view.scene3d.colours import ColourBy
from lfmesh.view.scene3d.describe import describe
from lfmesh.view.scene3d.pick import PickedPart, PickedPixel, PickedRay, pick
from lfmesh.view.scene3d.plotter import View

if TYPE_CHECKING:
    from lfmesh.view.browser.light_field import LightFieldPanel
    from lfmesh.view.rays.paths import Rays

COUNT = 100
"""Default number of launched rays."""

ALL = "all"
"""Choice of all the scene's wavelengths."""

FORM = (
    "launch", "light", "point_x", "point_y", "point_z", "row", "column", "count", "wavelength", "split", "cutoff",
)  # fmt: skip
"""Variables of the launch form."""

PICKED, PICKED_COLOUR, PICKED_WIDTH = "picked path", "white", 3.0
"""Name, colour and width in px of the line along the clicked path."""

MOST_ROWS = 300
"""Most rows of the path table in the page."""

HEADS = {
    "path": "path",
    "short": "sequence",
    "count": "count",
    "power": "power in {unit}",
    "share": "share",
    "error": "±",
    "irradiance": "peak in {unit}/mm²",
}
"""Visible columns of the path table, with their headings."""

NOTHING = "There is nothing at that point: click a ray, glass, a target or a pixel."

STEP_HEADS = ["surface", "event", "angle in °", "R", "T", "power in {unit}", "medium", "x, y, z in mm", "roulette"]
"""Headings of a history's table."""


class RaysPanel:
    """State and handlers of the ray controls in the page.

    Parameters
    ----------
    server : trame_server.Server
    replies : Replies
    view : View
        3D scene, off screen.
    rays : Rays, optional
        Initial rays.
    light_field : LightFieldPanel
        Owner of the sensor picture for choosing and marking pixels.
    """

    def __init__(
        self, server: Any, replies: Replies, view: View, rays: "Rays | None", light_field: "LightFieldPanel"
    ) -> None:
        self._state, self._controller = server.state, server.controller
        self._view, self._light_field = view, light_field
        self._rays: Rays | None = None
        self._whence = ""
        self._drawn: Rays | None = None
        self._kept: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._table: PathTable | None = None
        self._ghosts = GhostsPanel(server, replies, self._tabulate)
        self._state.update(_first_state(view.world, view.presets))
        for name, answer in (
            ("launch", self._launch),
            ("look", self._look),
            ("pick_in_view", self._pick),
            ("filter", self._filter_by),
            ("choose", self._choose),
            ("csv", self._csv),
            ("pixel_rays", self._pixel_rays),
            ("area_rays", self._area_rays),
            ("marked_rays", self._marked_rays),
            ("ghost_rays", self._ghost_rays),
        ):
            replies.on_call(name, answer)
        replies.on_change(["colour", "fade"], self._draw)
        replies.on_change(["cut"], self._cut)
        replies.on_change(["sort"], self._tabulate)
        replies.on_change(["side"], self._show_ghosts)
        self._show(rays, self._said_in_the_form(rays))

    def close(self) -> None:
        """Stop what is still being computed for the page."""
        self._ghosts.close()

    def _said_in_the_form(self, rays: "Rays | None") -> str:
        """Set the form from given rays as far as possible; return their launch in words."""
        if rays is None or not len(rays):
            return ""
        state, starts = self._state, np.unique(rays.position[rays.offsets[:-1]].round(9), axis=0)
        state.count = rays.launched
        state.split = "both" if rays.reflected.any() else "transmit"
        different = np.unique(rays.wavelength_nm)
        if len(different) == 1 and float(different[0]) in state.wavelengths:
            state.wavelength = float(different[0])
        pixels = np.unique(rays.pixel, axis=0)
        if rays.from_sensor:
            if len(pixels) > 1:
                return f"from {len(pixels):,} pixels"
            row, column = pixels[0].tolist()
            state.update({"launch": "pixel", "row": row, "column": column})
            return f"from the pixel in row {row}, column {column}"
        if len(starts) > 1:
            state.count = max(1, round(rays.launched / len(starts)))
            return f"from {len(starts):,} points"
        x, y, z = (float(f"{value:.6g}") for value in starts[0])
        state.update({"launch": "point", "point_x": x, "point_y": y, "point_z": z})
        return f"from x = {x:zg}, y = {y:zg}, z = {z:zg} mm"

    def _launch(self, form: dict[str, Any]) -> None:
        """Launch rays according to the form.

        The values come with the call, as a busy page's state may arrive later.
        """
        state, world = self._state, self._view.world
        state.update({name: value for name, value in form.items() if name in FORM})
        if state.launch == "point":
            x, y, z = point = [_number(getattr(state, f"point_{axis}"), f"{axis} / mm") for axis in "xyz"]
            rays = launch.from_field_point(world, point, self._count(), **self._options())
            self._show(rays, f"from x = {x:zg}, y = {y:zg}, z = {z:zg} mm")
        elif state.launch == "light":
            number = round(_number(state.light, "light"))
            self._show(launch.from_light(world, number, self._count(), **self._options()), f"from lights[{number}]")
        elif state.launch == "pixel":
            row, column = (round(_number(getattr(state, name), name)) for name in ("row", "column"))
            self._from_pixels(range(row, row + 1), range(column, column + 1))
        else:
            self._show(launch.as_in_run(world, self._count(), **self._options()), "as in a run")

    def _ghost_rays(self, form: dict[str, Any]) -> None:
        """Launch rays from the source in the form with the number and settings for ghosts, and keep all of them."""
        self._state.expression = ""
        self._launch({**form, "count": GHOST_RAYS, "split": "both", "cutoff": GHOST_CUTOFF})

    def _pixel_rays(self, x: float, y: float) -> None:
        row, column = self._light_field.picture.pixel(x, y)
        self._from_pixels(range(row, row + 1), range(column, column + 1))

    def _area_rays(self, x0: float, y0: float, x1: float, y1: float) -> None:
        self._from_pixels(*self._light_field.picture.pixels(x0, y0, x1, y1))

    def _marked_rays(self) -> None:
        if self._light_field.marked is not None:
            self._from_pixels(*self._light_field.marked)

    def _from_pixels(self, rows: range, columns: range) -> None:
        """Launch rays backwards from pixels, and update the form."""
        rays = launch.from_pixels(self._view.world, rows, columns, self._count(), **self._options())
        if len(rows) == len(columns) == 1:
            self._state.update({"launch": "pixel", "row": rows.start, "column": columns.start})
            self._show(rays, f"from the pixel in row {rows.start}, column {columns.start}")
        else:
            area = f"rows {rows.start} to {rows.stop - 1}, columns {columns.start} to {columns.stop - 1}"
            self._show(rays, f"from the pixels in {area}")
        self._light_field.mark(rows, columns)

    def _count(self) -> int:
        return round(_number(self._state.count, "number"))

    def _options(self) -> dict[str, Any]:
        wavelength = self._state.wavelength
        return {
            "split": self._state.split,
            "weight_cutoff": _number(self._state.cutoff, "cutoff"),
            "wavelength_nm": None if wavelength == ALL else float(wavelength),
        }

    def _show(self, rays: "Rays | None", whence: str = "") -> None:
        """Show new rays with the filter if it fits; `whence` is their source in words."""
        self._rays, self._whence = rays, whence
        self._ghosts.forget()
        self._state.chosen = None
        self._forget_pick()
        if rays is None:
            self._draw()
            return
        self._kept = np.ones(len(rays), np.bool_)
        self._view.near(pixels_on_array(rays))
        self._filter()

    def _filter_by(self, expression: str) -> None:
        """Keep the paths that match another expression, which is passed with the call like a form."""
        self._state.expression = expression
        self._filter()

    def _filter(self) -> None:
        """Keep the paths that match the expression; show a mistake below it and change nothing."""
        if self._rays is None:
            return
        self._state.filter_fault = ""
        try:
            self._kept = parse(self._state.expression, self._rays)
        except FilterError as fault:
            self._state.filter_fault = str(fault)
            return
        self._state.chosen = None
        self._tabulate()
        self._draw()
        self._show_ghosts()

    def _tabulate(self) -> None:
        """Fill the path table."""
        if self._rays is None:
            return
        self._table = path_table(self._rays, self._ghosts.exact).filtered(self._kept).sorted(self._state.sort)
        self._state.rows = [_row(row) for row in self._table.rows[:MOST_ROWS]]
        unit = self._rays.unit
        self._state.heads = [[name, head.format(unit=unit)] for name, head in HEADS.items()]
        self._state.kept = f"{self._kept.sum():,} of {len(self._rays):,} paths, {self._table.power:.4g} {unit}"
        rest = len(self._table) - len(self._state.rows)
        sequences = counted(len(self._table), "sequence")
        self._state.table_note = f"{sequences}; power at the sensor. Click one to draw it alone." + (
            f" {rest:,} more are in the CSV." if rest else ""
        )
        if any(row.exact for row in self._table):
            self._state.table_note += " Those without ± are integrated over the pupil."

    def _choose(self, number: int, sequence: str) -> None:
        """Draw only one sequence, or all again if it was already chosen.

        Parameters
        ----------
        number : int
        sequence : str
            As in the table that was clicked, which rays launched since may have changed.
        """
        if self._rays is None or self._rays.sequences[number : number + 1] != [sequence]:
            raise LfmeshError("other rays have been launched since this table was shown: click its row again")
        self._state.chosen = None if self._state.chosen == number else number
        self._forget_pick()
        self._draw()

    def _csv(self) -> str:
        """Return the table as the text of a CSV file."""
        return "" if self._table is None else self._table.csv_text()

    def _draw(self) -> None:
        """Draw the filtered paths of the chosen sequence, or of all."""
        self._drawn = None
        if self._rays is not None:
            chosen = self._state.chosen
            shown = self._kept if chosen is None else self._kept & (self._rays.sequence == chosen)
            self._drawn = self._rays.keep(shown)
        self._view.show_rays(self._drawn, self._state.colour, fade=bool(self._state.fade))
        self._view.write([])
        words = ["No rays", *self._view.caption]
        if self._rays is not None:
            how = "" if self._rays.reflected.any() else REFRACTED
            words = [*self._view.caption, self._whence, how, why_dark(self._rays)]
        # The page has these words beside the picture, not in it.
        self._view.overlay.write("", [], self._view.legend)
        words.append(self._view.scale)
        self._state.drawn = ", ".join(filter(None, words))
        self._redraw()

    def _look(self, preset: str) -> None:
        self._view.look(preset)
        self._redraw()

    def _cut(self) -> None:
        self._view.cut(bool(self._state.cut))
        self._redraw()

    def _redraw(self) -> None:
        if self._controller.redraw.exists():
            self._controller.redraw()

    def _pick(self, x: float, y: float) -> None:
        """Show the object at a point of the 3D view, given in fractions of its width and height from the upper left."""
        width, height = self._view.plotter.render_window.GetSize()
        found = pick(self._view, x * width, y * height)
        self._forget_pick()
        if isinstance(found, PickedRay):
            self._show_history(found)
        elif isinstance(found, PickedPixel):
            self._from_pixels(range(found.row, found.row + 1), range(found.column, found.column + 1))
        elif isinstance(found, PickedPart):
            self._show_part(found.name)
        else:
            self._state.picked_note = NOTHING
        self._redraw()

    def _show_history(self, found: PickedRay) -> None:
        """Show the history of a path, with the clicked segment marked."""
        assert self._drawn is not None
        rays, state = self._drawn, self._state
        first = int(rays.offsets[found.path])
        steps = history(rays, found.path)
        state.picked = f"Ray {rays.source[found.path]}, {short_form(rays, found.path)}"
        others = len(found.paths) - 1
        shared = f"; {others} more path{'s share' if others > 1 else ' shares'} this segment" if others else ""
        state.picked_note = f"{rays.wavelength_nm[found.path]:.6g} nm, path {rays.sequence[found.path]}{shared}"
        columns = len(STEP_HEADS) if any(step.was_raised for step in steps) else len(STEP_HEADS) - 1
        state.picked_heads = [head.format(unit=rays.unit) for head in STEP_HEADS[:columns]]
        state.picked_left = 2
        state.picked_rows = [_step_cells(step)[:columns] for step in steps]
        state.picked_at = int(found.vertex) - first
        line = pv.lines_from_points(rays.line(found.path))
        self._view.plotter.add_mesh(
            line, name=PICKED, color=PICKED_COLOUR, line_width=PICKED_WIDTH, lighting=False,
            reset_camera=False, render=False,
        )  # fmt: skip

    def _show_part(self, name: str) -> None:
        """Show the prescription of glass, or the facts about another part."""
        rows = [list(fact) for fact in describe(self._view.world, name)]
        self._state.update({"picked": name, "picked_heads": [], "picked_left": 2, "picked_rows": rows})

    def _forget_pick(self) -> None:
        self._view.plotter.remove_actor(PICKED, render=False)
        self._state.update({"picked": "Nothing picked", "picked_note": "", "picked_rows": [], "picked_at": -1})

    def _show_ghosts(self) -> None:
        """Show the ghosts when their tab is open."""
        if self._state.side == "ghosts" and self._rays is not None:
            self._ghosts.show(self._rays, self._kept)


def _first_state(world: World, presets: list[str]) -> dict[str, Any]:
    """Return the panel's variables before any rays."""
    scene, transport = world.scene, world.scene.transport
    launches = [["point", "field point"], ["pixel", "pixel"]]
    if scene.lights and scene.targets:
        launches.append(["light", "light"])
    launches.append(["run", "as in a run"])
    x, y, z = (float(f"{value:.6g}") for value in first_points(world)[0])
    row, column = middle_pixel(world)
    known = [wavelength for _, wavelength in launch.wavelengths_of(world)]
    several = [ALL] if len(known) > 1 else []
    return {
        "launches": launches,
        "launch": "point",
        "point_x": x,
        "point_y": y,
        "point_z": z,
        "light": 0,
        "row": row,
        "column": column,
        "count": COUNT,
        "wavelengths": [*several, *known],
        "wavelength": [*several, *known][0],
        "split": transport.split,
        "cutoff": transport.weight_cutoff,
        "presets": presets,
        "colours": list(get_args(ColourBy)),
        "drawn": "",
        "filter_fault": "",
        "heads": [],
        "sort": "power",
        "rows": [],
        "chosen": None,
        "kept": "",
        "table_note": "",
        "picked": "",
        "picked_note": "",
        "picked_heads": [],
        "picked_left": 2,
        "picked_rows": [],
        "picked_at": -1,
    }


def _row(row: PathRow) -> dict[str, Any]:
    """Return a path-table row in the form that the page shows."""
    return {
        "path": row.path,
        "short": row.short,
        "sequence": row.sequence,
        "count": f"{row.count:,}",
        "power": f"{row.power:.3g}",
        "share": f"{100.0 * row.share:.3g} %",
        "error": relative_error(row),
        "irradiance": f"{row.irradiance:.3g}",
    }


def _step_cells(step: Step) -> list[str]:
    """Return a row of a history, in the order of `STEP_HEADS`."""
    shares = ("" if share is None else f"{share:.4f}" for share in (step.reflectance, step.transmittance))
    return [
        step.short,
        step.event_in_words,
        "" if step.incidence_deg is None else f"{step.incidence_deg:.3f}",
        *shares,
        f"{step.power:.3e}",
        step.medium,
        ", ".join(f"{place:z.2f}" for place in step.position_mm),
        f"× {step.roulette:.4g}" if step.was_raised else "",
    ]


def _number(value: Any, name: str) -> float:
    """Return the number in a form field.

    Raises
    ------
    LfmeshError
        The field is empty or not a number.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise LfmeshError(f"{name} = {value!r}: must be a number")
    if not math.isfinite(value):
        raise LfmeshError(f"{name} = {value!r}: must be a finite number")
    return float(value)
