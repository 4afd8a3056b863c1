"""Display of a scene in a window or notebook, or as a picture, page or 3D model."""

import io
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar, Unpack

import numpy as np
import PIL.Image
from numpy.typing import NDArray

from lfmesh.errors import FileError, LfmeshError
from lfmesh.files.whole import write_whole
from lfmesh.notebook import in_notebook
from lfmesh.scene import Scene
from lfmesh.signatures import with_keywords
from lfmesh.transport.render.image import Image
from lfmesh.transport.world import World
from lfmesh.view.rays.filters import parse
from lfmesh.view.rays.paths import Rays
from lfmesh.view.request import Launched, LaunchOptions, Subject, launched, subject_of
from lfmesh.view.scene3d.array_shape import FINE, SMALL, Detail
from lfmesh.view.scene3d.colours import FAINT_TEXT, ColourBy
from lfmesh.view.scene3d.gl import Probe, has_display
from lfmesh.view.scene3d.plotter import Drawing, View, build_view

CELL_SEGMENTS = 4000
"""Default of `most_segments` in a notebook, whose cells hold all data."""

WITH_INSET = ("whole", "side")
INSET, INSET_PLACE = 0.3, (0.15, 0.04)
"""Size of the magnified array relative to the picture, and position of its lower left corner."""

LETTER = "A"
"""Label of the magnified array and of its place in the picture."""

NO_DISPLAY = (
    'there is no display for a window: write a picture with screenshot="out.png" or a page with html="out.html"'
)


@dataclass(frozen=True)
class Seen:
    """Subject, its rays, and the chosen ones among them."""

    subject: Subject
    all_rays: Rays | None
    rays: Rays | None
    chosen: NDArray[np.bool_]
    caption: tuple[str, ...]
    near_mm: tuple[float, float]


@dataclass(frozen=True)
class Outputs:
    """Output files of a view, instead of a window."""

    screenshot: str | os.PathLike[str] | None = None
    html: str | os.PathLike[str] | None = None
    gltf: str | os.PathLike[str] | None = None

    def __bool__(self) -> bool:
        return bool(self._wished())

    def _wished(self) -> list[tuple[str, Path]]:
        return [(field.name, Path(path)) for field in fields(self) if (path := getattr(self, field.name)) is not None]

    def check(self) -> None:
        """Refuse an output that cannot be written, before anything is traced."""
        for option, path in self._wished():
            check_output(option, path)

    def write(self, view: View) -> list[Path]:
        """Write the requested outputs of a view; return the files."""
        for option, path in self._wished():
            if option == "screenshot":
                write_whole(path, png(picture_of(view)))
            elif option == "html":
                from lfmesh.view.output.html import write_page

                write_page(view, path)
            else:
                from lfmesh.view.output.gltf import write_model

                write_model(view, path)
        return [path for _, path in self._wished()]


Taken = TypeVar("Taken", Drawing, Outputs)


class Options(LaunchOptions, total=False):
    """Keyword arguments of `show`."""

    colour: ColourBy | None
    fade: bool
    preset: str
    cut: bool
    size: tuple[int, int]
    most_segments: int
    screenshot: str | os.PathLike[str]
    html: str | os.PathLike[str]
    gltf: str | os.PathLike[str]


@with_keywords(**asdict(Drawing()))
def show(
    subject: Scene | World | Image | str | os.PathLike[str],
    rays: Rays | str | Sequence[str] | None = None,
    *,
    filter: str | None = None,  # noqa: A002  # what it is called on the command line and in the browser
    **options: Unpack[Options],
) -> PIL.Image.Image | None:
    """Show a scene in 3D with rays.

    A notebook shows a page to turn and zoom, which needs the extra `browser`, below the cell. A script opens a window
    and waits until it is closed. With an output file it writes that instead.

    Parameters
    ----------
    subject : Scene, World, Image, or path of a scene file or a run folder
        The picture of a run appears on its sensor.
    rays : Rays, str or sequence of str, optional
        Rays, or how to launch them: "field 0,0,-500", "pixel 320,310", "none"; see
        `lfmesh.view.rays.launch_line.FORMS`. Default: refracted rays from points of the plane of focus.
    filter : str, optional
        Paths to draw, see `lfmesh.view.rays.filters`.

    Returns
    -------
    PIL.Image.Image or None
        The picture, in a notebook, which shows it as a page.

    Other Parameters
    ----------------
    count : int
        Rays per launch.
    wavelength_nm, split, weight_cutoff
        Settings of the launches (default: the scene's).
    colour : {"wavelength", "power", "events", "status", "path", "field"}
        Meaning of the ray colours (default: the wavelength, or the field point if there is one wavelength).
    fade : bool
        Draw weaker rays fainter.
    preset : {"whole", "side", "object", "lens", "array", "sensor"}
        Viewpoint (default: "whole").
    cut : bool
        Cut lens and array along the axis; rays stay whole.
    size : (width, height), pixels
    most_segments : int
        Above this, a selection of whole paths is drawn, and the caption gives their number (in a notebook: 4000).
    screenshot, html, gltf : path
        PNG; self-contained page; binary glTF model (.glb).

    Raises
    ------
    LfmeshError
        Nothing can be drawn here, a setting is out of range, or a file cannot be written.
    """
    given: dict[str, Any] = dict(options)
    few_segments = "most_segments" not in given
    drawing, outputs = _taken(Drawing, given), _taken(Outputs, given)
    unknown = sorted(given.keys() - LaunchOptions.__annotations__.keys())
    if unknown:
        raise TypeError(f"show() got an unexpected keyword argument {unknown[0]!r}")
    outputs.check()
    inline = not outputs and in_notebook()
    windowed = not outputs and not inline
    if windowed and not has_display():
        raise LfmeshError(NO_DISPLAY)
    with Probe() as probe:
        seen = look(subject, rays, filter, **given)
        probe.check()
    if inline:
        return _inline(seen, replace(drawing, most_segments=CELL_SEGMENTS) if few_segments else drawing)
    made = draw_seen(seen, drawing, off_screen=not windowed)
    outputs.write(made)
    if windowed:
        from lfmesh.view.output.window import open_window

        open_window(made)
    return None


def _inline(seen: Seen, drawing: Drawing) -> PIL.Image.Image:
    """Return the picture of a subject as a notebook shows it."""
    from lfmesh.view.output.cell import shown_in_cell
    from lfmesh.view.output.html import has_extra

    made = draw_seen(seen, drawing, detail=SMALL if has_extra() else FINE)
    return shown_in_cell(made, picture_of(made))


def _taken(kind: type[Taken], options: dict[str, Any]) -> Taken:
    """Return a dataclass made from the options that are its fields; the others remain."""
    return kind(**{name: options.pop(name) for name in kind.__dataclass_fields__ if name in options})


def look(
    subject: Scene | World | Image | str | os.PathLike[str],
    rays: Rays | str | Sequence[str] | None = None,
    expression: str | None = None,
    **launches: Unpack[LaunchOptions],
) -> Seen:
    """Build a subject, launch rays in it, and apply a filter.

    Parameters
    ----------
    subject : Scene, World, Image, or path of a scene file or a run folder
    rays : Rays, str or sequence of str, optional
        As for `show`.
    expression : str, optional
        The filter.
    **launches
        See `LaunchOptions`.
    """
    what = subject_of(subject)
    if isinstance(rays, Rays):
        shown = Launched(rays, (), (0.0, 0.0))
    else:
        shown = launched(what.world, [rays] if isinstance(rays, str) else list(rays or ()), **launches)
    if shown.rays is None:
        return Seen(what, None, None, np.zeros(0, np.bool_), shown.caption, shown.near_mm)
    chosen = np.ones(len(shown.rays), np.bool_)
    caption, kept = shown.caption, shown.rays
    if expression is not None and expression.strip():
        chosen = parse(expression, shown.rays)
        kept = shown.rays.keep(chosen)
        caption += (f"filter: {expression.strip()}; {int(chosen.sum()):,} of {len(chosen):,} paths pass",)
    return Seen(what, shown.rays, kept, chosen, caption, shown.near_mm)


def draw_seen(seen: Seen, drawing: Drawing, *, off_screen: bool = True, detail: Detail = FINE) -> View:
    """Draw a subject and its chosen rays.

    Parameters
    ----------
    seen : Seen
    drawing : Drawing
    off_screen : bool
        Without a window.
    detail : Detail
    """
    return build_view(
        seen.subject.world, seen.rays, seen.subject.picture, drawing,
        off_screen=off_screen, near_mm=seen.near_mm, caption=seen.caption, detail=detail,
    )  # fmt: skip


ENDINGS = {
    "screenshot": (".png",), "html": (".html", ".htm"), "gltf": (".glb",), "paths": (".csv",),
    "ghosts": (".png", ".svg", ".pdf"),
}  # fmt: skip


def check_output(option: str, path: Path) -> None:
    """Refuse an output file that cannot be written."""
    endings = ENDINGS[option]
    if path.suffix.lower() not in endings:
        raise FileError(f"{option} {path}: the name must end in {' or '.join(endings)}")
    if not path.parent.is_dir():
        raise FileError(f"{option} {path}: the folder {path.parent} does not exist")
    if path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK):
        raise FileError(f"{option} {path}: cannot be written")


def picture_of(view: View) -> PIL.Image.Image:
    """Return the picture of a view; overviews have the magnified array in a corner."""
    if view.preset not in WITH_INSET or "array" not in view.presets:
        return shot(view)
    view.overlay.mark(LETTER, view.array_edge)
    picture = shot(view)
    preset = view.preset
    view.overlay.only_scale(True)
    view.overlay.mark(f"{LETTER}: lenslets")
    view.look("array")
    close = shot(view)
    view.look(preset)
    view.overlay.only_scale(False)
    view.overlay.unmark()
    _paste(picture, close)
    return picture


def shot(view: View) -> PIL.Image.Image:
    """Return a view as it stands, without the magnified array."""
    view.smooth(True)
    view.plotter.render()
    shot = PIL.Image.fromarray(view.plotter.screenshot(return_img=True))
    view.smooth(False)
    return shot


def _paste(picture: PIL.Image.Image, close: PIL.Image.Image) -> None:
    """Paste a reduced, framed picture into the corner of another that the views leave free."""
    width, height = (round(INSET * side) for side in picture.size)
    left, bottom = (round(place * side) for place, side in zip(INSET_PLACE, picture.size, strict=True))
    frame = PIL.Image.new("RGB", (width + 2, height + 2), FAINT_TEXT)
    frame.paste(close.resize((width, height), PIL.Image.Resampling.LANCZOS), (1, 1))
    picture.paste(frame, (left, picture.height - bottom - height))


def png(picture: PIL.Image.Image) -> bytes:
    """Encode a picture as PNG."""
    content = io.BytesIO()
    picture.save(content, format="PNG")
    return content.getvalue()
