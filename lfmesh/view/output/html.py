"""HTML page with an interactive 3D scene: vtk.js and all data in one file, for use without a network.

vtk.js loses text in the picture, so title, launch, counts, legend and scale are part of the page.
"""

import re
import signal
import sys
import tempfile
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from markupsafe import escape

from lfmesh.errors import LfmeshError
from lfmesh.files.whole import write_whole
from lfmesh.templates import filled
from lfmesh.view.scene3d.colours import BACKGROUND, FAINT_TEXT, TEXT
from lfmesh.view.scene3d.plotter import View

ASPECT = 1.25
"""The page's window may be narrower than the picture."""

ANGLE_DEG = 30.0
"""Vertical field of view in vtk.js, which reads the camera's position but not its angle."""

STYLE = f"""\
      body {{ background: {BACKGROUND}; }}
      .words {{ position: fixed; z-index: 10; top: 0; margin: 14px 18px; pointer-events: none;
                font: 14px/1.5 "DejaVu Sans", system-ui, sans-serif; color: {FAINT_TEXT}; }}
      .words h1 {{ margin: 0; font-size: 22px; font-weight: normal; color: {TEXT}; }}
      .words p {{ margin: 0; }}
      .words b {{ font-weight: normal; color: {TEXT}; }}
      .content {{ position: absolute; inset: 0; }}
      #caption {{ left: 0; max-width: 65%; }}
      #legend {{ right: 0; text-align: right; }}
      @media (max-aspect-ratio: {ASPECT}) {{ .content {{ top: auto; height: {100.0 / ASPECT:g}vw; }} }}
      @media (max-width: 700px) {{
        .words {{ position: relative; }}
        #caption {{ max-width: none; }}
        #legend {{ text-align: left; }}
      }}
"""
"""In windows narrower than `ASPECT` the picture keeps that ratio, so that its sides are not cut off. On narrow pages
the legend is below the caption."""

TEMPLATE = Path(__file__).parent / "templates" / "words.html"

VTK_WASM = "trame.widgets.vtklocal"
"""Another way to draw in a browser, not used here. Where trame finds it, its server fetches the compiled VTK from the
network at start, and prints tracebacks if there is none."""

MISSING: Any = object()

FOREIGN = re.compile(r"https://kitware\.github\.io/vtk-js/icon/[^`\"']*")
"""The only thing that vtk.js would fetch: its own icons."""


def has_extra() -> bool:
    """Tell whether the packages that make pages are installed."""
    return find_spec("trame_pyvista") is not None


def write_page(view: View, path: Path) -> None:
    """Write a view as a page.

    Raises
    ------
    LfmeshError
        The packages of the extra "browser" are missing, or the file cannot be written.
    """
    if not has_extra():
        raise LfmeshError('a page needs the packages of the extra "browser": pip install "lfmesh[browser]"')
    write_whole(path, page_of(view))


def page_of(view: View) -> str:
    """Return a view as the text of a page; needs the packages of the extra "browser"."""
    preset = view.preset
    view.look(preset, aspect=ASPECT, angle_deg=ANGLE_DEG)
    try:
        with (
            tempfile.TemporaryDirectory() as folder,
            warnings.catch_warnings(),
            _signals_kept(),
            _not_imported(VTK_WASM),
        ):
            warnings.simplefilter("ignore")
            raw = Path(folder) / "page.html"
            view.plotter.trame.export_html(raw)
            page = raw.read_text(encoding="utf-8")
    finally:
        view.look(preset)
    return captioned(page, view)


@contextmanager
def _signals_kept() -> Iterator[None]:
    """Restore the signal handlers afterwards: the server that exports a page takes Ctrl-C, and never gives it back."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    wakeup = signal.set_wakeup_fd(-1)
    signal.set_wakeup_fd(wakeup)
    try:
        yield
    finally:
        signal.set_wakeup_fd(wakeup)
        for number, handler in handlers.items():
            signal.signal(number, handler)


@contextmanager
def _not_imported(module: str) -> Iterator[None]:
    """Make imports of a module fail temporarily."""
    package, _, name = module.rpartition(".")
    attributes = vars(import_module(package))
    kept, attribute = sys.modules.get(module, MISSING), attributes.pop(name, MISSING)
    sys.modules[module] = None  # type: ignore[assignment]  # how Python marks what cannot be imported
    try:
        yield
    finally:
        del sys.modules[module]
        if kept is not MISSING:
            sys.modules[module] = kept
        if attribute is not MISSING:
            attributes[name] = attribute


def captioned(page: str, view: View) -> str:
    """Return a page with the view's words in it and without requests to other servers."""
    page = FOREIGN.sub("data:,", page)
    title = escape(view.title)
    page = re.sub(r"<title>.*?</title>", lambda _: f"<title>{title}</title>", page, count=1, flags=re.DOTALL)
    page = page.replace("</style>\n  </head>", f"{STYLE}    </style>\n  </head>", 1)
    words = filled(
        TEMPLATE,
        title=view.title,
        lines=[*view.caption, view.scale, "drag turns, wheel zooms"],
        legend=view.legend,
    )
    return page.replace("<body>", f"<body>\n{words}", 1)
