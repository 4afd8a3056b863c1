"""The camera behind a picture: `lfmesh fit`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from lfmesh.cli.application import app
from lfmesh.cli.interrupts import defer_interrupt
from lfmesh.cli.options import Whole
from lfmesh.cli.printing import list_files, say_note, wrapped
from lfmesh.cli.progress import status
from lfmesh.errors import LfmeshError

if TYPE_CHECKING:
    from lfmesh.study.fit import Fit


@app.command(
    help_epilogue="""\
Examples:

    lfmesh fit white.png scene.toml -o fitted/
    lfmesh fit run/ scene.toml -o fitted/             the white image of a run
    lfmesh fit white.tif scene.toml -o fitted/ --orientation sensor
    lfmesh fit white.png scene.toml -o fitted/ --also camera.sensor.distance_mm=0.05
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
        Parameter(help="How a picture lies; sensor: row 0 at −y, column 0 at −x of the sensor."),
    ] = "upright",
    also: Annotated[
        list[str] | None,
        Parameter(help="PATH=CHANGE: fit this field too; its largest plausible change.", negative=()),
    ] = None,
    samples: Annotated[Whole, Parameter(help="Per pixel, of the simulated white images.")] = 128,
) -> int:
    """Estimate the assembly errors of a real camera from its white image: fitted.toml, fit.json, residuals.png.

    Pictures are linear in light. What a white image cannot tell apart is kept as in the scene, and reported together.
    """
    further = dict(map(_further, also or []))
    with defer_interrupt():
        from lfmesh.files.white_picture import read_white
        from lfmesh.scene import load
        from lfmesh.study.fit import fit as fit_camera
        from lfmesh.study.fit_files import write_fit

    with status() as say:
        found = fit_camera(
            read_white(white), load(scene), also=further, orientation=orientation, samples=samples, progress=say
        )
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


def _in_words(found: "Fit") -> list[str]:
    lines = []
    for each in found.estimates:
        error = "kept, not determined" if each.kept else f"± {each.standard_error:.2g}"
        if each.together and not each.kept:
            error += ", if what is kept is right"
        lines.append(f"{each.parameter.name:<22}{each.value:>12.6g} {each.parameter.unit:<4}{error}")
    lines.append(f"{'micro-image pitch':<22}{found.pitch_px:>12.7g} px  ± {found.pitch_error_px:.2g}")
    for both in found.combinations:
        terms = " ".join(
            f"{factor:+.5g} Δ {path}" if factor != 1.0 else f"Δ {path}" for path, factor in both.coefficients.items()
        )
        lines.append(wrapped(f"Only known together: {terms} = {both.value:.6g} ± {both.standard_error:.2g}"))
    lines.append(f"Residuals {found.rms_px:.3g} pixels rms, {found.used} micro-images.")
    return lines
