"""Showing a scene: in a window, in a notebook, or written as a picture, a page or a 3D model."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path

import PIL.Image

from lfmesh.errors import FileError, LfmeshError
from lfmesh.scene import Scene
from lfmesh.transport.image import Image
from lfmesh.transport.world import World
from lfmesh.view.colours import ColourBy
from lfmesh.view.gl import Probe, has_display
from lfmesh.view.plotter import SIZE, View, build_view
from lfmesh.view.ray_lines import MOST_SEGMENTS
from lfmesh.view.rays import Rays
from lfmesh.view.request import Launched, launched, subject_of

NO_DISPLAY = (
    "there is no display for a window: write a picture with --screenshot out.png or a page with --html out.html, "
    "or open it with --browser"
)


def view(
    subject: Scene | World | Image | str | os.PathLike[str],
    rays: Rays | str | Sequence[str] | None = None,
    *,
    count: int | None = None,
    wavelength_nm: float | None = None,
    split: str | None = None,
    colour: ColourBy = "wavelength",
    fade: bool = False,
    preset: str = "whole",
    cut: bool = False,
    size: tuple[int, int] = SIZE,
    most_segments: int = MOST_SEGMENTS,
    screenshot: str | os.PathLike[str] | None = None,
    html: str | os.PathLike[str] | None = None,
    gltf: str | os.PathLike[str] | None = None,
) -> PIL.Image.Image | None:
    """Show a scene in 3D with rays in it.

    In a notebook it returns the picture; in a script it opens a window and waits until that is closed; where an output
    is given it writes that instead.

    Parameters
    ----------
    subject : Scene, World, Image, or path of a scene file or a run folder
        A run's picture lies on its sensor.
    rays : Rays, str or sequence of str, optional
        Rays, or how to launch them: "field 0,0,-500", "pixel 320,310", ..., see `lfmesh.view.launch.FORMS`; "none".
        Left out: points of the plane in focus, refracted rays alone.
    count : int, optional
        Rays a launch.
    wavelength_nm, split : optional
        Of the launches, as the scene has them if left out.
    colour : {"wavelength", "power", "events", "status", "path"}
    fade : bool
        Draw rays with less power fainter.
    preset : {"whole", "side", "object", "lens", "array", "sensor"}
    cut : bool
        Cut lens and array along the axis; rays stay whole.
    size : (width, height), pixels
    most_segments : int
        Drawn at most; where rays have more, whole paths are left out, and the caption says how many.
    screenshot, html, gltf : path, optional
        PNG; self-contained page; GLB or glTF model, in mm.

    Raises
    ------
    LfmeshError
        Nothing can be drawn here, a setting is out of its range, a file cannot be written.
    """
    outputs = {"screenshot": screenshot, "html": html, "gltf": gltf}
    for name, path in outputs.items():
        check_output(name, path)
    inline = not any(outputs.values()) and in_notebook()
    windowed = not any(outputs.values()) and not inline
    if windowed and not has_display():
        raise LfmeshError(NO_DISPLAY)
    with Probe() as probe:
        seen = subject_of(subject)
        if isinstance(rays, Rays):
            shown = Launched(rays, (), (0.0, 0.0))
        else:
            specs = [rays] if isinstance(rays, str) else list(rays or ())
            shown = launched(seen.world, specs, count, wavelength_nm=wavelength_nm, split=split)
        probe.check()
    made = build_view(
        seen.world, shown.rays, seen.picture,
        colour=colour, fade=fade, preset=preset, cut=cut, size=size, off_screen=not windowed,
        most_segments=most_segments, near_mm=shown.near_mm, caption=shown.caption,
    )  # fmt: skip
    write(made, screenshot=screenshot, html=html, gltf=gltf)
    if inline:
        return picture_of(made)
    if windowed:
        from lfmesh.view.window import open_window

        open_window(made)
    return None


def write(
    view: View,
    *,
    screenshot: str | os.PathLike[str] | None = None,
    html: str | os.PathLike[str] | None = None,
    gltf: str | os.PathLike[str] | None = None,
) -> list[Path]:
    """Write what is wished of a view; return the files."""
    written = []
    if screenshot is not None:
        picture_of(view).save(screenshot, format="PNG")
        written.append(Path(screenshot))
    if html is not None:
        from lfmesh.view.page import write_page

        write_page(view, Path(html))
        written.append(Path(html))
    if gltf is not None:
        from lfmesh.view.model import write_model

        write_model(view, Path(gltf))
        written.append(Path(gltf))
    return written


ENDINGS = {"screenshot": (".png",), "html": (".html", ".htm"), "gltf": (".glb", ".gltf")}


def check_output(option: str, path: str | os.PathLike[str] | None) -> None:
    """Refuse an output that could not be written, before anything is traced for it."""
    if path is None:
        return
    path = Path(path)
    endings = ENDINGS[option]
    if path.suffix.lower() not in endings:
        raise FileError(f"{option} {path}: the name must end in {' or '.join(endings)}")
    if not path.parent.is_dir():
        raise FileError(f"{option} {path}: the folder {path.parent} does not exist")
    if path.is_dir() or not os.access(path if path.exists() else path.parent, os.W_OK):
        raise FileError(f"{option} {path}: cannot be written")


def picture_of(view: View) -> PIL.Image.Image:
    """Return what a view shows as a Pillow image."""
    return PIL.Image.fromarray(view.plotter.screenshot(return_img=True))


def in_notebook() -> bool:
    """Tell whether this process is a notebook's kernel, which shows pictures."""
    shell = sys.modules.get("IPython")
    running = shell.get_ipython() if shell is not None else None
    return running is not None and "IPKernelApp" in getattr(running, "config", {})
