"""Camera fits: `lfmesh fit`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from lfmesh.cli.application import app
from lfmesh.cli.interrupts import defer_interrupt
from lfmesh.cli.options import Whole
from lfmesh.cli.printing import list_files, say_note
from lfmesh.errors import LfmeshError
from lfmesh.view.progress import status
from lfmesh.wrapping import wrapped

if TYPE_CHECKING:
    from lfmesh.study.fits.board_fit import BoardFit
    from lfmesh.study.fits.fit import Estimate, Fit


@app.command(
    help_epilogue="""\
More examples:

    lfmesh fit run/ scene.toml -o fitted/             the white image of a run
    lfmesh fit white.tif scene.toml -o fitted/ --orientation sensor
    lfmesh fit white.png scene.toml -o fitted/ \\
      --also camera.sensor.distance_mm=0.05
    lfmesh fit white.png scene.toml -o fitted/ \\
      --board near.png --board far.png --square-mm 5 --grid 7 5
    lfmesh fit white.png scene.toml -o fitted/ --corners corners.csv
"""
)
def fit(
    white: Annotated[Path, Parameter(name="white", help="White image: PNG, TIFF, EXR, or a run with one.")],
    scene: Annotated[Path, Parameter(name="scene", help="Scene file (TOML) of the camera as designed.")],
    /,
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"], help="Folder for scene, values and residuals.")],
    orientation: Annotated[
        Literal["upright", "upside_down", "sensor"],
        Parameter(help="Orientation of the pictures; sensor: row 0 at −y, column 0 at −x of the sensor."),
    ] = "upright",
    also: Annotated[
        list[str] | None,
        Parameter(help="PATH=CHANGE: also fit this field; CHANGE is its largest plausible change."),
    ] = None,
    samples: Annotated[Whole, Parameter(help="Samples per pixel of the simulated white images.")] = 128,
    board: Annotated[
        list[Path] | None,
        Parameter(help="Picture of a checkerboard, or a run, to fit focus and pose too; may be repeated."),
    ] = None,
    square_mm: Annotated[float | None, Parameter(help="Side of the boards' squares, mm.")] = None,
    grid: Annotated[
        tuple[Whole, Whole] | None,
        Parameter(help="Number of inner corners along x and y; all but a few of the outer ones must be in view."),
    ] = None,
    corners: Annotated[
        list[Path] | None, Parameter(help="List of a board's corners (CSV), in place of a picture.")
    ] = None,
) -> int:
    """Estimate the assembly errors of a real camera from its white image: fitted.toml, fit.json, residuals.png.

    Pictures are linear in light. Quantities that a white image cannot tell apart keep the scene's values, and are
    reported together. With boards, focus and poses are fitted to their corners: board_residuals.png.
    """
    further = dict(map(_further, also or []))
    if not board and (square_mm, grid) != (None, None):
        raise LfmeshError("--square-mm and --grid describe a checkerboard; give its picture with --board")
    if board or corners:
        columns, rows = grid or (None, None)
        size = {"square_mm": square_mm, "columns": columns, "rows": rows}
        return _with_boards(
            white,
            scene,
            out,
            (board or [], corners or [], size),
            {"also": further, "orientation": orientation, "samples": samples},
        )
    with defer_interrupt():
        from lfmesh.files.white_picture import read_white
        from lfmesh.scene import load
        from lfmesh.study.fits.fit import fit as fit_camera
        from lfmesh.study.fits.fit_files import write_fit

    with status() as say:
        found = fit_camera(
            read_white(white), load(scene), also=further, orientation=orientation, samples=samples, progress=say
        )
    # Finish writing the results even if interrupted.
    with defer_interrupt():
        paths = write_fit(found, out)
    for line in _in_words(found):
        print(line)
    for note in found.notes:
        say_note(note)
    list_files(paths)
    return 0


def _further(text: str) -> tuple[str, float]:
    path, _, change = text.partition("=")
    try:
        return path, float(change)
    except ValueError:
        raise LfmeshError(
            f"--also {text}: give a field and its largest plausible change, as camera.sensor.distance_mm=0.05"
        ) from None


def _with_boards(
    white: Path, scene: Path, out: Path, boards: tuple[list[Path], list[Path], dict[str, Any]], options: dict[str, Any]
) -> int:
    with defer_interrupt():
        from lfmesh.files.white_picture import read_picture, read_white
        from lfmesh.scene import load
        from lfmesh.study.fits.board_files import read_corners, write_board_fit
        from lfmesh.study.fits.board_fit import fit_boards
        from lfmesh.study.fits.board_pictures import Board

    pictures, lists, size = boards
    every = [Board(picture=read_picture(path, "picture of the board"), **size) for path in pictures]
    every += [Board(corners=read_corners(path)) for path in lists]
    with status() as say:
        found = fit_boards(read_white(white), load(scene), every, progress=say, **options)
    with defer_interrupt():
        paths = write_board_fit(found, out)
    for line in _boards_in_words(found, [*pictures, *lists]):
        print(line)
    for note in found.notes:
        say_note(note)
    list_files(paths)
    return 0


def _boards_in_words(found: "BoardFit", names: list[Path]) -> list[str]:
    from lfmesh.scene.literals import plain

    lines = list(map(_estimate, found.estimates))
    for number, (name, pose) in enumerate(zip(names, found.poses, strict=True)):
        for kind, unit, part in (("position", "mm", 0), ("rotation", "deg", 3)):
            values = (pose.position_mm, pose.rotation_deg)[part // 3]
            errors = pose.standard_error[part : part + 3]
            known = ", ".join(f"{value:.6g} ± {plain(error, 2)}" for value, error in zip(values, errors, strict=True))
            lines.append(f"{name.name}: {kind} {known} {unit}")
        slope, error = found.traded(number)
        together = f"z of {name.name} {-slope:+.4g} Δ camera.mla.distance_mm, to ± {plain(error, 2)} mm"
        lines.append(wrapped(f"Only known together: {together}"))
    lines.append(
        f"Residuals {found.rms:.3g} samples of a view rms, {found.used} places of corners; "
        f"{plain(found.corner_rms, 2)} in the mean of each corner."
    )
    return lines


def _estimate(each: "Estimate") -> str:
    from lfmesh.scene.literals import plain

    error = "kept, not determined" if each.kept else f"± {plain(each.standard_error, 2)}"
    if each.together and not each.kept:
        error += ", if the kept values are right"
    return f"{each.parameter.name:<22}{each.value:>12.6g} {each.parameter.unit:<4}{error}"


def _in_words(found: "Fit") -> list[str]:
    from lfmesh.scene.literals import plain

    lines = list(map(_estimate, found.estimates))
    lines.append(f"{'micro-image pitch':<22}{found.pitch_px:>12.7g} px  ± {plain(found.pitch_error_px, 2)}")
    for both in found.combinations:
        terms = " ".join(
            f"{factor:+.5g} Δ {path}" if factor != 1.0 else f"Δ {path}" for path, factor in both.coefficients.items()
        )
        lines.append(wrapped(f"Only known together: {terms} = {both.value:.6g} ± {plain(both.standard_error, 2)}"))
    lines.append(f"Residuals {found.rms_px:.3g} pixels rms, {found.used} micro-images.")
    return lines
