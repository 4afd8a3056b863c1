"""Reports and drawings for `lfmesh view`."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from lfmesh.cli.view_options import Launches, Reports, Serving
from lfmesh.errors import LfmeshError
from lfmesh.view.rays.exact_ghosts import exact_of, origin_in_words
from lfmesh.view.rays.ghosts import DARK, GHOST_CUTOFF, GHOST_RAYS, ghost_matrix
from lfmesh.view.rays.path_table import path_table
from lfmesh.view.scene3d.gl import Probe, has_display
from lfmesh.view.scene3d.plotter import Drawing
from lfmesh.view.show import Outputs, Seen, check_output, draw_seen, look

NO_DISPLAY = (
    "there is no display for a window: write a picture with --screenshot out.png or a page with --html out.html, "
    "or open it with --browser"
)


def run(
    subject: Path, launches: Launches, expression: str | None,
    drawing: Drawing, outputs: Outputs, reports: Reports, serving: Serving,
) -> tuple[list[str], list[Path]]:  # fmt: skip
    """Carry out the options of `lfmesh view`; return the lines to print and the files written.

    A window opens if there is a display and no file is asked for.

    Parameters
    ----------
    subject : Path
        A scene file or a run folder.
    launches : Launches
    expression : str or None
        Filter that paths must pass.
    drawing, outputs
        Style of the drawing, and files to write.
    reports : Reports
    serving : Serving
    """
    outputs.check()
    _check(reports)
    if serving.browser:
        from lfmesh.view.browser import refuse_to_serve

        refuse_to_serve(serving.host, serving.port)
    windowed = not outputs and not serving.browser and (not reports or has_display())
    if windowed and not has_display():
        raise LfmeshError(NO_DISPLAY)
    if not (outputs or windowed):
        seen = look(subject, expression=expression, **_launches(launches, reports))
        lines, written = _reported(reports, seen)
        if serving.browser:
            print("\n".join(lines), end="\n" if lines else "", flush=True)
            _serve(subject, seen, expression or "", drawing, serving)
            lines = []
        return lines, written
    with Probe() as probe:
        seen = look(subject, expression=expression, **_launches(launches, reports))
        probe.check()
    lines, written = _reported(reports, seen)
    view = draw_seen(seen, drawing, off_screen=not windowed)
    written += outputs.write(view)
    if windowed:
        from lfmesh.view.output.window import open_window

        print("\n".join(lines), flush=True)
        lines = []
        open_window(view)
    return lines, written


def _launches(launches: Launches, reports: Reports) -> dict[str, Any]:
    """Return the keywords of `look`; for a ghost figure, the default values resolve ghosts well."""
    given = asdict(launches)
    if reports.ghosts is not None:
        for name, value in (("count", GHOST_RAYS), ("split", "both"), ("weight_cutoff", GHOST_CUTOFF)):
            given[name] = value if given[name] is None else given[name]
    return given


def _check(reports: Reports) -> None:
    """Refuse a file that cannot be written."""
    for option, path in (("paths", reports.paths), ("ghosts", reports.ghosts)):
        if path is not None:
            check_output(option, path)


def _reported(reports: Reports, seen: Seen) -> tuple[list[str], list[Path]]:
    """Return the lines to print about the rays and the files written."""
    if not reports:
        return [], []
    if seen.all_rays is None or seen.rays is None:
        raise LfmeshError('--rays none: there are no paths to report; omit it, or give "field 0,0,-500", for example')
    exact = exact_of(seen.all_rays) if reports.ghosts is not None else None
    table = path_table(seen.all_rays, exact).filtered(seen.chosen)
    lines = table.lines() if reports.table else []
    written = []
    if reports.paths is not None:
        written.append(table.to_csv(reports.paths))
    if reports.ghosts is not None:
        # A filter selects rays; it cannot divide an integral over the pupil.
        chosen = exact if seen.chosen.all() else None
        matrix = ghost_matrix(seen.rays, chosen)
        if matrix.total > 0.0:
            written.append(matrix.save(reports.ghosts))
        else:
            lines.append(f"{reports.ghosts} is not drawn: {DARK}")
        whole = bool(seen.chosen.all())
        lines += chosen.lines() if chosen is not None else [origin_in_words(seen.all_rays, is_whole=whole)]
    return lines, written


def _serve(subject: Path, seen: Seen, expression: str, drawing: Drawing, serving: Serving) -> None:
    from lfmesh.view.browser import serve

    serve(
        subject, seen.all_rays, expression=expression,
        colour=drawing.colour, fade=drawing.fade, preset=drawing.preset, cut=drawing.cut,
        host=serving.host, port=serving.port, open_browser=serving.open_browser,
    )  # fmt: skip
