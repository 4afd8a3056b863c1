"""Lenses: `lfmesh lens list` and `lfmesh lens convert`."""

from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from lfmesh.assets import asset_path
from lfmesh.cli.application import app
from lfmesh.errors import LfmeshError
from lfmesh.wrapping import wrapped

INDEX = "lenses/index.txt"
"""Asset with one line for each lens of the library, as `scene.lens_library` describes it."""

lens_app = App(name="lens", help="Lenses that come with lfmesh, and lens files of other programs.")
app.command(lens_app)


@lens_app.command(name="list")
def list_lenses() -> int:
    """List the lenses that come with lfmesh: name, focal length, f-number, design, source.

    In a scene file: [camera.lens] file = "lib:cooke_triplet_50mm".
    """
    # Not from the lens files: loading them, their glasses and all scene models takes a second.
    for line in asset_path(INDEX).read_text(encoding="utf-8").splitlines():
        print(wrapped(line))
    return 0


@lens_app.command(
    help_epilogue="""\
More examples:

    lfmesh lens convert old.seq new.toml --glass BK7=SCHOTT/N-BK7
    lfmesh lens convert zoom.zmx tele.toml --configuration 2
    lfmesh lens convert coated.zmx coated.toml --coatings COATING.DAT
    lfmesh lens convert lib:cooke_triplet_50mm triplet.zmx
"""
)
def convert(
    source: Annotated[
        str, Parameter(name="in", help='Lens file: .zmx, .seq, .len, .json, .csv or .toml; or "lib:" and a name.')
    ],
    target: Annotated[Path, Parameter(name="out", help="Lens file to write: .toml, .zmx or .seq.")],
    /,
    *,
    glass: Annotated[
        list[str] | None,
        Parameter(help="NAME=GLASS or NAME=INDEX: replaces a glass that the catalogue lacks; may be repeated."),
    ] = None,
    configuration: Annotated[
        int | None, Parameter(help="Number of the configuration in a .zmx or .seq file, from 1.")
    ] = None,
    coatings: Annotated[Path | None, Parameter(help="Coating file of a .zmx file, if none lies beside it.")] = None,
    gradients: Annotated[
        list[Path] | None,
        Parameter(
            help="File of gradient-index materials of a .zmx file (SGRIN.DAT, GRADIENT_9.DAT, PROFILE.GRD), if none "
            "lies beside it; may be repeated."
        ),
    ] = None,
    every_line: Annotated[bool, Parameter(name="--lines", help="Report how every line was read.")] = False,
) -> int:
    """Convert a lens file of another program, and report how its lines were read."""
    from lfmesh.imports import read_lens_file, write_lens_file
    from lfmesh.scene.camera.file_choices import FileChoices

    if configuration is not None and configuration < 1:
        raise LfmeshError(f"--configuration {configuration}: must be 1 or more")
    coating_file = None if coatings is None else str(coatings)
    choices = FileChoices(_glasses(glass or []), configuration, coating_file, tuple(map(str, gradients or [])))
    lens, report = read_lens_file(source, choices)
    notes = write_lens_file(lens, target, report.conditions)
    for line in (*report.text(every_line), *notes):
        print(wrapped(line))
    print(f"  {target}")
    return 0


def _glasses(given: list[str]) -> dict[str, str | float]:
    """Return the glass or index given by --glass for each name in the file."""
    glasses: dict[str, str | float] = {}
    for pair in given:
        name, sign, medium = pair.partition("=")
        if not (name and sign and medium):
            raise LfmeshError(f"--glass {pair}: write NAME=GLASS or NAME=INDEX, such as BK7=SCHOTT/N-BK7")
        try:
            glasses[name] = float(medium)
        except ValueError:
            glasses[name] = medium
    return glasses
