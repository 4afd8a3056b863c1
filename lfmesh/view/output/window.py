"""Window with keys for viewpoints and the cut, and descriptions of clicked objects."""

from lfmesh.view.rays.history import history
from lfmesh.view.rays.history import lines as history_lines
from lfmesh.view.rays.path_table import short_form
from lfmesh.view.scene3d import pick
from lfmesh.view.scene3d.describe import describe
from lfmesh.view.scene3d.plotter import View

KEYS = "keys: F1–F{last} views, x cut, q quit; click a part to identify it"


def open_window(view: View) -> None:
    """Show a view until its window is closed."""
    plotter = view.plotter
    for number, preset in enumerate(view.presets, 1):
        plotter.add_key_event(f"F{number}", lambda preset=preset: _look(view, preset))
    plotter.add_key_event("x", lambda: _toggle_cut(view))
    plotter.track_click_position(lambda place: clicked(view, *place), side="left", viewport=True)
    view.tell([KEYS.format(last=len(view.presets))])
    plotter.show(title=f"lfmesh: {view.title}")


def clicked(view: View, x: float, y: float) -> list[str]:
    """Describe the object under a click in the picture and the terminal.

    Parameters
    ----------
    view : View
    x, y : float, pixels
        Position in the picture, from its lower left corner.
    """
    words = in_words(view, pick.pick(view, x, view.plotter.window_size[1] - y))
    view.tell(words)
    if words:
        print("\n".join(words), end="\n\n", flush=True)
    view.plotter.render()
    return words


def in_words(view: View, picked: pick.Picked) -> list[str]:
    """Return a short description of the picked object: a path's history, a part's prescription, a pixel's rays."""
    if isinstance(picked, pick.PickedRay):
        return path_in_words(view, picked)
    if isinstance(picked, pick.PickedPixel):
        return pixel_in_words(view, picked)
    if picked is None:
        return []
    return [f"{label:<14}{value}" for label, value in describe(view.world, picked.name)]


def path_in_words(view: View, picked: pick.PickedRay) -> list[str]:
    """Return the course of a path, one line per vertex."""
    assert view.lines is not None
    rays = view.lines.rays
    number, wavelength = rays.sequence[picked.path], rays.wavelength_nm[picked.path]
    shared = f"; {len(picked.paths)} paths share this segment" if len(picked.paths) > 1 else ""
    head = f"ray {picked.path}, path {number}, {short_form(rays, picked.path)}, {wavelength:g} nm{shared}"
    return [head, *history_lines(history(rays, picked.path), rays.unit)]


def pixel_in_words(view: View, picked: pick.PickedPixel) -> list[str]:
    """Return the number of shown rays on a pixel, and how to launch more of them."""
    words = [f"sensor pixel    row {picked.row}, column {picked.column}"]
    if view.lines is not None:
        rays = view.lines.rays
        on = (rays.pixel == [picked.row, picked.column]).all(axis=1)
        words.append(f"paths shown that end here: {int(on.sum())}, {rays.end_power[on].sum():.3e} {rays.unit}")
    return [*words, f'its own rays:   --rays "pixel {picked.row},{picked.column}"']


def _look(view: View, preset: str) -> None:
    view.look(preset)
    view.plotter.render()


def _toggle_cut(view: View) -> None:
    view.cut(not view.is_cut)
    view.plotter.render()
