"""What `lfmesh view` does: the reports and drawings that its options ask for."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lfmesh.errors import LfmeshError
from lfmesh.view.output.gl import Probe, has_display
from lfmesh.view.rays.ghosts import ghost_matrix
from lfmesh.view.rays.path_table import path_table
from lfmesh.view.show import NO_DISPLAY, Drawing, Outputs, Seen, check_output, look


@dataclass(frozen=True)
class Reports:
    """What is said of the rays without drawing them: the path table printed, or as CSV; ghosts as a figure."""

    table: bool = False
    paths: Path | None = None
    ghosts: Path | None = None

    def __bool__(self) -> bool:
        return self.table or self.paths is not None or self.ghosts is not None

    def check(self) -> None:
        """Refuse a file that could not be written."""
        for option, path in (("paths", self.paths), ("ghosts", self.ghosts)):
            if path is not None:
                check_output(option, path)

    def of(self, seen: Seen) -> tuple[list[str], list[Path]]:
        """Return the lines to print and the files written."""
        if seen.all_rays is None or seen.rays is None:
            raise LfmeshError('--rays none: there are no paths to report; leave it out, or give "field 0,0,-500", say')
        table = path_table(seen.all_rays).filtered(seen.chosen)
        written = []
        if self.paths is not None:
            written.append(table.to_csv(self.paths))
        if self.ghosts is not None:
            written.append(ghost_matrix(seen.rays).save(self.ghosts))
        return table.lines() if self.table else [], written


@dataclass(frozen=True)
class Serving:
    """Whether, and where, the browser's page is served."""

    browser: bool = False
    host: str = "127.0.0.1"
    port: int = 0
    open_browser: bool = True


def run(
    subject: Path, rays: list[str] | None, expression: str | None, path: int | None,
    launches: dict[str, Any], drawing: Drawing, outputs: Outputs, reports: Reports,
    serving: Serving,
) -> tuple[list[str], list[Path]]:  # fmt: skip
    """Do what the options say; return the lines to print and the files written.

    A window opens where there is a display and no file is asked for.
    """
    outputs.check()
    reports.check()
    windowed = not outputs and not serving.browser and (not reports or has_display())
    if windowed and not has_display():
        raise LfmeshError(NO_DISPLAY)
    if path is not None:
        expression = f"path == {path}" if expression is None else f"({expression}) and path == {path}"
    if not (outputs or windowed):
        seen = look(subject, rays, expression, **launches)
        said = reports.of(seen) if reports else ([], [])
        if serving.browser:
            print("\n".join(said[0]), end="\n" if said[0] else "", flush=True)
            _serve(subject, seen, expression or "", drawing, serving)
        return said if not serving.browser else ([], said[1])
    with Probe() as probe:
        seen = look(subject, rays, expression, **launches)
        probe.check()
    lines, written = reports.of(seen) if reports else ([], [])
    view = drawing.of(seen, off_screen=not windowed)
    written += outputs.write(view)
    if windowed:
        from lfmesh.view.output.window import open_window

        print("\n".join(lines), flush=True)
        lines = []
        open_window(view)
    return lines, written


def _serve(subject: Path, seen: Seen, expression: str, drawing: Drawing, serving: Serving) -> None:
    from lfmesh.view.browser import serve

    serve(
        subject, seen.all_rays, expression=expression,
        colour=drawing.colour, fade=drawing.fade, preset=drawing.preset, cut=drawing.cut,
        host=serving.host, port=serving.port, open_browser=serving.open_browser,
    )  # fmt: skip
