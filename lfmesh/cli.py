"""The command line: parses, calls, prints. Everything heavy is imported inside the commands."""

import json
import os
import re
import signal
import sys
import textwrap
import threading
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import cyclopts
from cyclopts import App, Parameter

import lfmesh
from lfmesh.errors import LfmeshError, SceneError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lfmesh.lightfield.field import LightField
    from lfmesh.lightfield.photograph import AllInFocus, FocalStack, Photograph
    from lfmesh.scene import Scene
    from lfmesh.transport.render.image import Image
    from lfmesh.transport.render.progress import Progress

WRONG_INPUT = 2
INTERRUPTED = 130
"""128 + SIGINT, what a shell expects after Ctrl-C."""
BROKEN_PIPE = 141
"""128 + SIGPIPE."""

CASE_FAILED = 1

COLUMNS = 80
"""Width of what is printed, on a terminal or not."""

MOST_PLANES = 1000
"""Of a focal stack."""

LEAST_PIXELS, MOST_PIXELS = 64, 8192
"""Sides of a picture of the scene."""

STATUS_SECONDS = 10.0
"""Where there is no terminal, what is being done is said no more often."""

app = App(
    name="lfmesh",
    help="Simulate light-field cameras physically: glass as triangle meshes, raw images with error bars.",
    help_epilogue="""\
Examples:

    lfmesh demo                          render the scene that comes with lfmesh
    lfmesh check scene.toml              first-order optics and warnings
    lfmesh draw scene.toml -o layout.svg   lens, array and rays as a drawing
    lfmesh render scene.toml -o run/     raw image, previews and report in run/
    lfmesh white run/                    white image, true micro-image centres
    lfmesh decode run/                   the light field: all views of the run
    lfmesh refocus run/ --stack 300:800:20   photographs of other planes
    lfmesh depth run/                    true depth, and from the light field
    lfmesh expose run/ --bayer RGGB      what a detector with noise counts
    lfmesh export run/ --format hci -o hci/   files of other people's tools
    lfmesh compare scene.toml -o cmp/    beside two other kinds of camera
    lfmesh view scene.toml               lens, array, sensor and rays in 3D
    lfmesh accuracy -o report/           speed against error, in tables, figures
    lfmesh schema > scene.schema.json    for completion in an editor
""",
    help_format="plaintext",
    version=lambda: lfmesh.__version__,
    result_action="return_value",
    suppress_keyboard_interrupt=False,
)


def _whole(_: object, tokens: Sequence[cyclopts.Token]) -> int:
    """Read a whole number; cyclopts by itself would cut 4.5 down to 4."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f'"{tokens[0].value}" is no whole number') from None


Whole = Annotated[int, Parameter(converter=_whole, n_tokens=1)]


@Parameter(name="*")
@dataclass
class Overrides:
    """Settings that replace those of the scene's [transport] table."""

    samples: Annotated[Whole | None, Parameter(help="Samples per pixel, in all; 4 times as many halve the noise.")] = (
        None
    )
    target_error: Annotated[
        float | None, Parameter(help="Relative standard error up to which noisy pixels get more samples, as 0.05.")
    ] = None
    max_samples: Annotated[Whole | None, Parameter(help="With --target-error: per pixel, in all, at most.")] = None
    method: Annotated[
        Literal["adjoint", "forward"] | None,
        Parameter(help="adjoint: from the sensor to the light; forward: from the light to the sensor."),
    ] = None
    engine: Annotated[
        Literal["auto", "mesh", "sequential"] | None,
        Parameter(help="mesh: Embree, everything; sequential: the image path only; auto: the least that will do."),
    ] = None
    surface: Annotated[
        Literal["exact", "flat", "smooth", "patch"] | None,
        Parameter(help="What a facet of a lens stands for."),
    ] = None
    split: Annotated[
        Literal["both", "roulette", "transmit"] | None,
        Parameter(help="At an interface: follow both children, one by chance, or the refracted one."),
    ] = None
    replicates: Annotated[
        Whole | None, Parameter(help="Independent parts of the samples; their spread is the standard error.")
    ] = None
    seed: Annotated[Whole | None, Parameter(help="Of the random numbers.")] = None
    threads: Annotated[Whole | None, Parameter(help="0: all cores; the result is the same for any number.")] = None
    wavelengths_nm: Annotated[
        list[float] | None, Parameter(help="One or more, nm.", consume_multiple=True, negative=())
    ] = None

    def given(self) -> dict[str, Any]:
        """Return what the user set."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if value is not None}


SceneFile = Annotated[Path, Parameter(name="scene", help="Scene file (TOML).")]
RunFolder = Annotated[Path, Parameter(name="run", help="Run folder of a light-field camera, from lfmesh render.")]


@app.command(help_epilogue="")
def demo(
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"], help="Run folder to write.")] = Path("lfmesh-demo"),
    overrides: Overrides | None = None,
) -> int:
    """Render the scene that comes with lfmesh: a bracket in front of a chart."""
    from lfmesh.assets import asset_path

    return _render(asset_path("scenes/first_light.toml"), out, overrides)


@app.command(help_epilogue="")
def check(scene: SceneFile, /) -> int:
    """Check a scene file and print its first-order optics, with warnings in plain words.

    Exits with 0 if the scene can be rendered, whatever the warnings, and with 2 if it cannot.
    """
    from lfmesh.geometry.lens_shape import mesh_lines
    from lfmesh.geometry.refractors import first_order
    from lfmesh.scene import load

    loaded = load(scene)
    print("\n".join([*first_order(loaded).lines(), *mesh_lines(loaded)]))
    return 0


@app.command(
    help_epilogue="""\
Examples:

    lfmesh draw scene.toml
    lfmesh draw scene.toml -o layout.pdf
"""
)
def draw(
    scene: SceneFile,
    /,
    *,
    out: Annotated[
        Path, Parameter(name=["--out", "-o"], help="File to write, by its ending an SVG, PNG or PDF.")
    ] = Path("layout.svg"),
) -> int:
    """Draw a camera's layout: meridional section with marginal and chief rays, object side, array close up."""
    with _undivided():
        from lfmesh.scene import load
        from lfmesh.view.layout import figure as layout_figure

    _list_files([layout_figure.draw(load(scene), out)])
    return 0


@app.command(
    help_epilogue="""\
Examples:

    lfmesh render scene.toml -o run/
    lfmesh render scene.toml -o run/ --samples 256 --threads 4
    lfmesh render scene.toml -o run/ --wavelengths-nm 486.1 587.6 656.3
    lfmesh render --resume run/          go on with a render that was cut short
"""
)
def render(
    scene: Annotated[Path | None, Parameter(name="scene", help="Scene file (TOML).")] = None,
    /,
    *,
    out: Annotated[
        Path | None, Parameter(name=["--out", "-o"], help="Run folder to write: new, empty or an older run.")
    ] = None,
    resume: Annotated[
        Path | None, Parameter(help="Run folder of a render that was cut short or killed: go on with it.")
    ] = None,
    with_white: Annotated[
        bool, Parameter(name="--white", negative=(), help="Also do what lfmesh white does, for decoding.")
    ] = False,
    overrides: Overrides | None = None,
) -> int:
    """Render a scene into a run folder: raw.exr with its standard error, previews, report.json.

    Ctrl-C keeps the replicates that are finished as a valid run, marked as incomplete. --resume goes on with it, or
    with what a render that was killed had kept, to the same bits as without the break.
    """
    if resume is not None:
        code = _resume(resume, scene, out, overrides)
        return _white(resume, None) if with_white and code == 0 else code
    if scene is None or out is None:
        missing = "a scene file" if scene is None else "--out, the run folder to write"
        raise LfmeshError(f"render needs {missing}: lfmesh render scene.toml -o run/, or lfmesh render --resume run/")
    code = _render(scene, out, overrides)
    return _white(out, None) if with_white and code == 0 else code


@app.command(help_epilogue="")
def white(run: RunFolder, /, *, overrides: Overrides | None = None) -> int:
    """Render what the camera of a run records of a uniform plane, and trace where its micro-images lie.

    Adds white.exr and calibration.json to the run; the settings of the run hold unless replaced.
    """
    return _white(run, overrides)


@app.command(
    help_epilogue="""\
Examples:

    lfmesh decode run/
    lfmesh decode run/ --centres white-image     as the owner of a real camera has to
"""
)
def decode(
    run: RunFolder,
    /,
    *,
    centres: Annotated[
        Literal["traced", "white-image"],
        Parameter(help="Where the centres of the micro-images come from: chief rays, or the white image."),
    ] = "traced",
    white: Annotated[
        bool, Parameter(negative="--no-white", help="Divide by the white image where the run has one.")
    ] = True,
    views: Annotated[
        Whole | None, Parameter(help="Along each axis; as many pixels as a micro-image is wide, if omitted.")
    ] = None,
) -> int:
    """Decode a run into its light field: lightfield.exr with all views and standard errors, views.png."""
    from lfmesh.files import field as field_files

    field = _decoded(run, centres, white, views)
    print(textwrap.fill(_field_in_words(field), COLUMNS, subsequent_indent="  "))
    _list_files(field_files.save_field(field, run))
    return 0


@app.command(
    help_epilogue="""\
Examples:

    lfmesh refocus run/ --distance-mm 480
    lfmesh refocus run/ --distance-mm 480 --f-number 8
    lfmesh refocus run/ --stack 300:800:20 --all-in-focus
    lfmesh refocus run/ --distance-mm 500 --method patches   of a focused plenoptic camera
"""
)
def refocus(
    run: RunFolder,
    /,
    *,
    distance_mm: Annotated[
        list[float] | None,
        Parameter(help="Object distances before the first vertex, mm.", consume_multiple=True, negative=()),
    ] = None,
    stack: Annotated[
        str | None, Parameter(help="Focal stack FIRST:LAST:STEP, mm; an EXR with all planes and an animated PNG.")
    ] = None,
    all_in_focus: Annotated[
        bool, Parameter(negative=(), help="With --stack: every place from its sharpest plane.")
    ] = False,
    f_number: Annotated[
        float | None, Parameter(help="Aperture on the image side, no wider than the lens had; all views if omitted.")
    ] = None,
    method: Annotated[
        Literal["shift", "fourier", "patches"],
        Parameter(help="Shift and add views; slice their 4D Fourier transform; join patches of a focused camera's."),
    ] = "shift",
) -> int:
    """Focus a run on other planes, from its lightfield.exr or else from its raw image."""
    if not distance_mm and stack is None:
        raise LfmeshError("nothing to focus on: give --distance-mm 480 or --stack 300:800:20")
    if all_in_focus and stack is None:
        raise LfmeshError("--all-in-focus takes its planes from --stack FIRST:LAST:STEP; give that too")
    if method == "patches" and f_number is not None:
        raise LfmeshError(f"--f-number {f_number:g}: patches use all views; leave it out, or take --method shift")
    planes = _planes(stack) if stack is not None else []
    with _undivided():
        from lfmesh.files import photographs as files

    with _warnings_as_notes():
        if method == "patches":
            single, series, sharpest = _patched(run, distance_mm or [], planes, all_in_focus)
        else:
            single, series, sharpest = _refocused(run, distance_mm or [], planes, all_in_focus, f_number, method)
    for photograph in single:
        _list_files(files.save_photograph(photograph, run))
    if series is not None:
        _list_files(files.save_stack(series, run))
    if sharpest is not None:
        _list_files(files.save_all_in_focus(sharpest, run))
    return 0


Photographs = tuple["list[Photograph]", "FocalStack | None", "AllInFocus | None"]
"""Of single planes, of a stack of planes, and with every place in focus."""


def _refocused(
    run: Path, distances: list[float], planes: list[float], everywhere: bool, f_number: float | None,
    method: Literal["shift", "fourier"],
) -> Photographs:  # fmt: skip
    """Photograph planes from the views of a light field."""
    with _undivided():
        from lfmesh.lightfield.photograph import all_in_focus
        from lfmesh.lightfield.refocus import focal_stack
        from lfmesh.lightfield.refocus import refocus as focus_on

    field = _field_of(run)
    single = [focus_on(field, distance, f_number=f_number, method=method) for distance in distances]
    series = focal_stack(field, planes, f_number=f_number, method=method) if planes else None
    return single, series, all_in_focus(series) if series is not None and everywhere else None


def _patched(run: Path, distances: list[float], planes: list[float], everywhere: bool) -> Photographs:
    """Photograph planes from the raw image of a focused plenoptic camera."""
    with _undivided():
        from lfmesh.files.run import open_run, open_white
        from lfmesh.lightfield.patches import patch_stack, patches_in_focus, render_patches

    image, white = open_run(run), open_white(run)
    single = [render_patches(image, distance, white=white) for distance in distances]
    series = patch_stack(image, planes, white=white) if planes else None
    return single, series, patches_in_focus(image, planes, white=white) if planes and everywhere else None


@app.command(
    help_epilogue="""\
Examples:

    lfmesh depth run/
    lfmesh depth run/ --near-mm 300 --far-mm 900
"""
)
def depth(
    run: RunFolder,
    /,
    *,
    near_mm: Annotated[
        float | None, Parameter(help="Nearest distance to search; the near end of the refocus range, if omitted.")
    ] = None,
    far_mm: Annotated[float | None, Parameter(help="Farthest distance to search; the far end, if omitted.")] = None,
    samples: Annotated[Whole, Parameter(help="Rays of each raw pixel's bundle for its true depth.")] = 16,
) -> int:
    """Find the depth of what a run shows: the truth by tracing, the estimate from its light field, and its error."""
    with _undivided():
        from lfmesh.files import depth as depth_files
        from lfmesh.lightfield.depth import estimate_depth
        from lfmesh.lightfield.depth_truth import depth_truth

    field = _field_of(run)
    estimate = estimate_depth(field, near_mm=near_mm, far_mm=far_mm)
    truth = depth_truth(field.scene, views=field.views[0], samples=samples)
    paths = depth_files.save_truth(truth, run) + depth_files.save_depth(estimate, truth.middle_mm, run)
    print(textwrap.fill(estimate.in_words(truth.middle_mm), COLUMNS, subsequent_indent="  "))
    _list_files(paths)
    return 0


@app.command(
    help_epilogue="""\
Examples:

    lfmesh export run/ --format hci -o hci/ --depth depth.exr
    lfmesh export run/ --format plenopticam -o decoder/
"""
)
def export(
    run: RunFolder,
    /,
    *,
    kind: Annotated[
        Literal["lftoolbox", "eslf", "hci", "views", "plenopticam", "plenpy"],
        Parameter(
            name="--format",
            help="lftoolbox, eslf, hci, views: the light field; plenopticam, plenpy: raw and white image.",
        ),
    ],
    out: Annotated[Path, Parameter(name=["--out", "-o"], help="Folder to write: new or empty.")],
    depth: Annotated[
        Path | None,
        Parameter(help="With hci: EXR of the middle view's distances in mm, in its channel truth or else Z."),
    ] = None,
) -> int:
    """Write a run for other people's tools: a folder with their files, and export.json, which says what means what."""
    if depth is not None and kind != "hci":
        raise LfmeshError(f"--depth {depth}: {kind} holds no depth; leave it out, or take --format hci")
    with _undivided():
        from lfmesh.files import exr
        from lfmesh.files.exports.export import export_field

    if kind == "plenopticam" or kind == "plenpy":
        paths = _exported_raw(run, out, kind)
    else:
        depth_mm = exr.read_map(depth, ("truth", "Z")) if depth is not None else None
        field = _field_of(run)
        paths = export_field(field, out, kind, depth_mm=depth_mm)
    print(f"  {out}: {len(paths)} files; {paths[-1].name} says what means what")
    return 0


def _exported_raw(folder: Path, out: Path, kind: Literal["plenopticam", "plenpy"]) -> list[Path]:
    with _undivided():
        from lfmesh.files import run
        from lfmesh.files.calibration import read_calibration
        from lfmesh.files.exports.export import export_raw
        from lfmesh.lightfield.ray_model import RayModel

    image, recorded = run.open_run(folder), run.open_white(folder)
    RayModel.of(image.scene)  # a conventional camera is refused before a white image is asked for
    if recorded is None:
        raise LfmeshError(f"--format {kind}: {folder} has no white.exr; make it with lfmesh white {folder}")
    with _warnings_as_notes():
        return export_raw(image, recorded, read_calibration(folder / run.CALIBRATION), out, kind)


@app.command(
    help_epilogue="""\
Examples:

    lfmesh expose run/
    lfmesh expose run/ --exposure-s 0.01 --bayer RGGB --bits 10 --full-well-e 6000
"""
)
def expose(
    run: Annotated[Path, Parameter(name="run", help="Run folder, from lfmesh render.")],
    /,
    *,
    exposure_s: Annotated[
        float | None, Parameter(help="If omitted, the bright pixels fill 80 % of their wells.")
    ] = None,
    quantum_efficiency: Annotated[float, Parameter(help="Electrons a photon.")] = 0.6,
    bayer: Annotated[
        Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None,
        Parameter(help="Colour filters, from the upright picture's first corner; none if omitted."),
    ] = None,
    full_well_e: Annotated[float, Parameter(help="Electrons that a pixel holds.")] = 10000.0,
    dark_current_e_s: Annotated[float, Parameter(help="Electrons a second in the dark.")] = 1.0,
    read_noise_e: Annotated[float, Parameter(help="Standard deviation, electrons.")] = 2.0,
    bits: Annotated[Whole, Parameter(help="Of a count, 16 at most.")] = 12,
    black_level: Annotated[Whole, Parameter(help="Count of an empty pixel.")] = 64,
    seed: Annotated[Whole, Parameter(help="Of the noise.")] = 0,
) -> int:
    """Add what a detector counts: photons, wells, noise and conversion. The image of the run stays as it is."""
    with _undivided():
        from lfmesh.files import run as runs
        from lfmesh.files.exposed import save_exposed
        from lfmesh.lightfield.detector import Detector

    detector = Detector(
        exposure_s=1.0 if exposure_s is None else exposure_s,
        quantum_efficiency=quantum_efficiency,
        bayer=bayer,
        full_well_e=full_well_e,
        dark_current_e_s=dark_current_e_s,
        read_noise_e=read_noise_e,
        bits=bits,
        black_level=black_level,
        seed=seed,
    )
    image = runs.open_run(run)
    exposed = (detector.filling(image) if exposure_s is None else detector).expose(image)
    brightest, saturated = exposed.expected_e.max(), exposed.saturated.mean()
    line = f"{exposed.detector.exposure_s:.3g} s: up to {brightest:.3g} electrons a pixel, {saturated:.2%} saturated."
    print(textwrap.fill(line, COLUMNS, subsequent_indent="  "))
    _list_files(save_exposed(exposed, run))
    return 0


@app.command(
    help_epilogue="""\
Examples:

    lfmesh accuracy scene.toml -o report/
    lfmesh accuracy --quick              the lenses that come with lfmesh
    lfmesh accuracy --hard               cases made to break the tracer
"""
)
def accuracy(
    scene: Annotated[
        Path | None, Parameter(name="scene", help="Scene file (TOML); none: the lenses of lfmesh.")
    ] = None,
    /,
    *,
    output: Annotated[
        Path | None, Parameter(name=["--output", "-o"], help="Folder for the HTML page and the tables as CSV.")
    ] = None,
    quick: Annotated[bool, Parameter(negative=(), help="Fewer meshes, rays and samples.")] = False,
    hard: Annotated[bool, Parameter(negative=(), help="Run the hard cases instead, one line each.")] = False,
) -> int:
    """Measure speed against error: every level of `surface` on ever finer meshes, every way to estimate an image.

    With --hard exits with 1 if a case fails.
    """
    if hard:
        if scene is not None or output is not None or quick:
            raise LfmeshError("--hard stands alone: its cases are fixed, and their outcomes are printed")
        return _hard_cases()

    from lfmesh.scene import load

    given = load(scene) if scene is not None else None
    with _undivided():
        from rich.console import Console

        from lfmesh.accuracy.report import measure, prepare

    if output is not None:
        prepare(output)
    with _status() as say:
        report = measure(given, quick=quick, progress=say)
    report.print(Console(width=COLUMNS))
    for path in report.write(output) if output is not None else ():
        print(f"  {path}")
    return 0


@app.command(
    help_epilogue="""\
Examples:

    lfmesh compare scene.toml -o comparison/
    lfmesh compare scene.toml -o comparison/ --reduction 4 --steps 5
"""
)
def compare(
    scene: SceneFile,
    /,
    *,
    out: Annotated[Path, Parameter(name=["--out", "-o"], help="Folder for the figure and the numbers as JSON.")],
    reduction: Annotated[
        float, Parameter(help="By how much the lenslets of the focused camera reduce the main image.")
    ] = 3.0,
    steps: Annotated[Whole, Parameter(help="Distances at which sharpness is measured; odd.")] = 13,
    overrides: Overrides | None = None,
) -> int:
    """Take a scene with a conventional, a standard and a focused plenoptic camera, and measure what each can do.

    They have the same lens, sensor and samples; the scene is that of the standard one.
    """
    from lfmesh.scene import load

    loaded = _overridden(load(scene), overrides.given() if overrides else {})
    with _undivided():
        from lfmesh.accuracy.report import prepare
        from lfmesh.study import compare as comparing
        from lfmesh.transport.packets.ledger import LostEnergyWarning

    prepare(out)
    # That planes beyond the refocus range are blurred is what is measured.
    with _status() as say, _warnings_as_notes(LostEnergyWarning):
        comparison = comparing.compare(loaded, reduction=reduction, steps=steps, progress=say)
    for words, *values in comparison.rows():
        print(f"{words:<23}" + "".join(f"{value:<24}" for value in values).rstrip())
    _list_files(comparing.write(comparison, out))
    return 0


@app.command(
    help_epilogue="""\
Examples:

    lfmesh view scene.toml
    lfmesh view run/ --screenshot out.png --preset lens --cut
    lfmesh view scene.toml --rays "pixel 320,310" --preset array --html out.html
    lfmesh view scene.toml --rays "field 0,20,-500" --split both --table
    lfmesh view scene.toml --rays "field 0,20,-500" --split both --filter ghost
"""
)
def view(
    subject: Annotated[Path, Parameter(name="scene", help="Scene file (TOML), or run folder.")],
    /,
    *,
    rays: Annotated[
        list[str] | None,
        Parameter(
            help='"field x,y,z", "pixel row,column", "pixels r:r,c:c", "light number", "run" or "none"; may be '
            "repeated. Omitted: points of the plane in focus, refracted rays alone.",
            negative=(),
        ),
    ] = None,
    count: Annotated[Whole | None, Parameter(help="Rays of each launch.")] = None,
    wavelength_nm: Annotated[float | None, Parameter(help="Of all rays; those of the scene, if omitted.")] = None,
    split: Annotated[
        Literal["both", "roulette", "transmit"] | None,
        Parameter(help="At an interface: follow both children, one by chance, or the refracted one."),
    ] = None,
    weight_cutoff: Annotated[
        float | None, Parameter(help="Lighter children play roulette; 1e-4 follows ghosts of two reflections.")
    ] = None,
    filter: Annotated[  # noqa: A002
        str | None, Parameter(help='Paths to draw and report: "hits(mla) and not ghost", "reflects(L3b)", ...')
    ] = None,
    path: Annotated[Whole | None, Parameter(help="The one to draw and report, by its number in the table.")] = None,
    colour: Annotated[
        Literal["wavelength", "power", "events", "status", "path"], Parameter(help="What the rays' colours mean.")
    ] = "wavelength",
    fade: Annotated[bool, Parameter(negative=(), help="Draw rays with less power fainter.")] = False,
    preset: Annotated[
        Literal["whole", "side", "object", "lens", "array", "sensor"], Parameter(help="Where to look from.")
    ] = "whole",
    cut: Annotated[bool, Parameter(negative=(), help="Cut lens and array along the axis; rays stay whole.")] = False,
    size: Annotated[str, Parameter(help="Of window and picture, in pixels.")] = "1600x1000",
    segments: Annotated[
        Whole, Parameter(help="Of rays, drawn at most; beyond that whole paths are left out, evenly.")
    ] = 20_000,
    table: Annotated[bool, Parameter(negative=(), help="Print the path table.")] = False,
    paths: Annotated[Path | None, Parameter(help="CSV to write the path table to.")] = None,
    ghosts: Annotated[Path | None, Parameter(help="Figure to write: ghosts by pair of reflecting surfaces.")] = None,
    screenshot: Annotated[Path | None, Parameter(help="PNG to write, in place of a window.")] = None,
    html: Annotated[Path | None, Parameter(help="Page to write that turns in any browser, without a network.")] = None,
    gltf: Annotated[Path | None, Parameter(help="3D model to write (.glb).")] = None,
    browser: Annotated[bool, Parameter(negative=(), help="Show it on a page in the browser, with much more.")] = False,
    host: Annotated[str, Parameter(help="With --browser: the address that the page is served on.")] = "127.0.0.1",
    port: Annotated[Whole, Parameter(help="With --browser; 0: a free one.")] = 0,
    open_browser: Annotated[
        bool, Parameter(name="--open", negative="--no-open", help="With --browser: open the page in a browser.")
    ] = True,
) -> int:
    """Show lens, array, sensor, targets and rays in 3D: in a window, or as a picture, a page, a model."""
    with _undivided():
        from lfmesh.view import command
        from lfmesh.view.show import Drawing, Outputs

    launches = {"count": count, "wavelength_nm": wavelength_nm, "split": split, "weight_cutoff": weight_cutoff}
    lines, written = command.run(
        subject, rays, filter, path, launches,
        Drawing(colour, fade, preset, cut, _size(size), segments),
        Outputs(screenshot, html, gltf), command.Reports(table, paths, ghosts),
        command.Serving(browser, host, port, open_browser),
    )  # fmt: skip
    for line in lines:
        print(line)
    _list_files(written)
    return 0


@app.command(help_epilogue="")
def schema() -> int:
    """Print the JSON Schema of scene files."""
    from lfmesh.scene import Scene

    print(json.dumps(Scene.model_json_schema(), indent=2))
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the process if omitted.

    Returns
    -------
    int
        The exit code: 0, 2 for wrong input (one message on standard error), 130 after Ctrl-C.
    """
    try:
        code = app(arguments, exit_on_error=False, print_error=False)
        sys.stdout.flush()
        return code if isinstance(code, int) else 0
    except cyclopts.CycloptsError as error:
        return _complain(f"{_one_paragraph(str(error))}\nSee: lfmesh --help")
    except LfmeshError as error:
        return _complain(str(error))
    except KeyboardInterrupt:
        print("\nStopped before anything was finished; nothing was written.", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        # Our reader went away, as in `lfmesh schema | head`; Python must not flush into it at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE


def _hard_cases() -> int:
    with _undivided():
        from lfmesh.accuracy import hard_cases

    outcomes = []
    for case in hard_cases.CASES:
        outcomes.append(hard_cases.judged(case))
        print(hard_cases.line(outcomes[-1]), flush=True)
    failed = sum(not outcome.passed for outcome in outcomes)
    lost, allowed = hard_cases.lost_share(outcomes), hard_cases.ALLOWED_LOSS
    verdict = f"{failed} failed" if failed else "all passed"
    print(f"{len(outcomes)} cases, {verdict}; {lost:.1g} of the energy lost, {allowed:g} allowed")
    return CASE_FAILED if failed or lost > allowed else 0


def _complain(message: str) -> int:
    print(f"lfmesh: {message}", file=sys.stderr)
    return WRONG_INPUT


def _one_paragraph(text: str) -> str:
    return " ".join(text.split())


def _render(scene_file: Path, folder: Path, overrides: Overrides | None) -> int:
    from lfmesh.geometry.refractors import first_order
    from lfmesh.scene import load

    scene = _overridden(load(scene_file), overrides.given() if overrides else {})
    notes = first_order(scene).warnings

    # Whatever can be wrong with the folder is said before the seconds that importing the tracer takes.
    with _undivided():
        from lfmesh.files import run

    run.prepare(folder)
    if run.has_checkpoint(folder):
        notes = (
            *notes,
            f"a render into {folder} was cut short and begins anew; --resume {folder} would go on with it.",
        )
    for note in notes:
        _say_note(note)
    return _traced(scene, folder, None)


def _resume(folder: Path, scene: Path | None, out: Path | None, overrides: Overrides | None) -> int:
    """Go on with a render that was cut short; the run itself says which."""
    given = overrides.given() if overrides else {}
    threads = {name: given.pop(name) for name in ("threads",) if name in given}
    beside = [*(["a scene"] if scene else []), *(["--out"] if out else []), *(_as_option(name) for name in given)]
    if beside:
        raise LfmeshError(f"--resume takes scene and settings from the run: leave out {', '.join(beside)}")
    with _undivided():
        from lfmesh.files import checkpoint, run

    if run.is_complete(folder):
        print(f"{folder} is complete: there is nothing to go on with.")
        return 0
    run.prepare(folder)
    kept = checkpoint.read(folder, run.scene_from)
    return _traced(_overridden(kept.scene, threads), folder, kept.arrays)


def _traced(scene: "Scene", folder: Path, saved: "dict[str, Any] | None") -> int:
    """Render into a run folder, from the start or from where a checkpoint was `saved`."""
    with _undivided():
        from lfmesh.files import run, words
        from lfmesh.files.checkpoint import Checkpoints, CheckpointWarning
        from lfmesh.files.inputs import pinned
        from lfmesh.transport.render.render import render as trace_image

    scene = pinned(scene)
    keep = Checkpoints(folder, run.scene_metadata(scene, folder))
    # The summary says what light was lost.
    with _progress() as report, _warnings_as_notes(CheckpointWarning):
        image = trace_image(scene, progress=report, saved=saved, keep=keep)
    run.save(image, folder)
    for line in words.summary(image):
        print(textwrap.fill(line, COLUMNS, subsequent_indent="  "))
    print(_whereabouts(image, folder))
    if not image.complete:
        print(f"  lfmesh render --resume {folder} goes on with it.")
    return 0 if image.complete else INTERRUPTED


def _white(folder: Path, overrides: Overrides | None) -> int:
    with _undivided():
        from lfmesh.files import run
        from lfmesh.lightfield.calibration import calibrate
        from lfmesh.lightfield.centres import estimate_centres
        from lfmesh.lightfield.white import white_image

    # An image that cannot be decoded needs no white one: calibrating says so before the render.
    scene = run.open_run(folder).scene
    calibration = calibrate(scene)
    with _progress() as report, _warnings_as_notes():
        image = white_image(_overridden(scene, overrides.given() if overrides else {}), progress=report)
    if not image.complete:
        raise KeyboardInterrupt
    run.save_white(image, calibration, folder)
    print(
        f"{calibration.known.sum()} of {calibration.known.size} micro-images have a chief ray, "
        f"{calibration.pitch_px:.6g} pixels apart, turned by {1e3 * calibration.rotation_rad:.3f} mrad."
    )
    try:
        error = estimate_centres(image).error_px(calibration)
        print(f"Found on the white image alone, they are {error.mean():.3g} pixels off on average.")
    except LfmeshError as fault:
        _say_note(fault)
    _list_files([folder / name for name in (run.WHITE, run.WHITE_PREVIEW, run.CALIBRATION)])
    return 0


def _decoded(folder: Path, centres: str, divide: bool, views: int | None) -> "LightField":
    with _undivided():
        from lfmesh.files import run
        from lfmesh.lightfield.centres import estimate_centres
        from lfmesh.lightfield.decode import decode as decode_image

    image = run.open_run(folder)
    recorded = run.open_white(folder)
    if centres == "white-image" and recorded is None:
        raise LfmeshError(f"--centres white-image: {folder} has no white.exr; make it with lfmesh white {folder}")
    calibration = estimate_centres(recorded) if recorded is not None and centres == "white-image" else None
    return decode_image(image, white=recorded if divide else None, calibration=calibration, views=views)


def _field_of(folder: Path) -> "LightField":
    """Return the light field of a run: as it was decoded, or decoded now."""
    with _undivided():
        from lfmesh.files.field import open_field

    return open_field(folder) or _decoded(folder, "traced", True, None)


def _field_in_words(field: "LightField") -> str:
    from lfmesh.scene.distance import reach_in_words

    rows, columns = field.views
    height, width = field.size
    near, far = field.model.refocus_range_mm
    return (
        f"{columns} × {rows} views of {width} × {height} samples, in {field.unit}; {field.sampling}. It refocuses "
        f"sharply from {reach_in_words(near, far)}."
    )


def _planes(stack: str) -> list[float]:
    """Return the distances of a FIRST:LAST:STEP, the last one included where the steps meet it."""
    try:
        first, last, step = (float(part) for part in stack.split(":"))
        count = int((last - first) / step * (1.0 + 1e-9)) + 1
    except (ValueError, ZeroDivisionError, OverflowError):
        raise LfmeshError(f"--stack {stack}: give three numbers, FIRST:LAST:STEP in mm, such as 300:800:20") from None
    if count < 2 or not first > 0.0:
        raise LfmeshError(f"--stack {stack}: the steps must lead from FIRST, above 0, to LAST, such as 300:800:20")
    if count > MOST_PLANES:
        raise LfmeshError(f"--stack {stack}: {count} planes; give a larger STEP, for {MOST_PLANES} at most")
    return [first + i * step for i in range(count)]


def _size(words: str) -> tuple[int, int]:
    """Return the width and height of a picture from WIDTHxHEIGHT."""
    found = re.fullmatch(r"(\d+)\s*[x×]\s*(\d+)", words.strip())
    size = (int(found[1]), int(found[2])) if found else (0, 0)
    if not all(LEAST_PIXELS <= side <= MOST_PIXELS for side in size):
        raise LfmeshError(f"--size {words}: give WIDTHxHEIGHT from {LEAST_PIXELS} to {MOST_PIXELS}, such as 1600x1000")
    return size


@contextmanager
def _warnings_as_notes(kind: type[UserWarning] = UserWarning) -> "Iterator[None]":
    """Say what the library warns of as the other notes are said; of one kind only, if that is named."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore", UserWarning)
        warnings.simplefilter("always", kind)
        yield
    for warning in caught:
        _say_note(warning.message)


def _say_note(note: object) -> None:
    print(textwrap.fill(f"Note: {note}", COLUMNS, subsequent_indent="  "), file=sys.stderr)


def _list_files(paths: "Sequence[Path]") -> None:
    for path in paths:
        print(f"  {path}")


@contextmanager
def _undivided() -> "Iterator[None]":
    """Hold Ctrl-C back until the body is done: libraries that catch everything while they are imported would eat it."""
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.default_int_handler or threading.current_thread() is not threading.main_thread():
        yield
        return
    pressed: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: pressed.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if pressed:
        raise KeyboardInterrupt


def _overridden(scene: "Scene", changes: dict[str, Any]) -> "Scene":
    """Return the scene with other transport settings, checked as those of a file are."""
    try:
        return scene.changed({f"transport.{name}": value for name, value in changes.items()})
    except SceneError as error:
        raise SceneError(_as_options(str(error))) from None


def _as_option(field: str) -> str:
    return "--" + field.replace("_", "-")


def _as_options(message: str) -> str:
    """Name the options of the command line where a message names the fields that they set."""
    return re.sub(
        r"^Scene\.transport\.(\w+)",
        lambda field: _as_option(field[1]),
        message,
        flags=re.MULTILINE,
    )


def _whereabouts(image: "Image", folder: Path) -> str:
    from lfmesh.files import run

    pictures = [(run.PREVIEW, "the raw image, upright"), (run.RAW, "power and standard error, W a pixel")]
    if image.scene.camera.mla is not None:
        pictures.insert(0, (run.VIEW, "the picture that the camera saw"))
    pictures.append((run.REPORT, "all the numbers"))
    width = max(len(str(folder / name)) for name, _ in pictures)
    return "\n".join(f"  {folder / name!s:<{width}}  {what}" for name, what in pictures)


@contextmanager
def _status() -> "Iterator[Callable[[str], None]]":
    """Yield what says on standard error what is being done: on a terminal in one line, elsewhere now and then."""
    from rich.console import Console

    errors = Console(stderr=True)
    if errors.is_terminal:
        with errors.status("building") as status:
            yield status.update
        return
    printed_at = -STATUS_SECONDS

    def say(text: str) -> None:
        nonlocal printed_at
        if time.monotonic() - printed_at >= STATUS_SECONDS:
            printed_at = time.monotonic()
            print(text, file=sys.stderr, flush=True)

    yield say


@contextmanager
def _progress() -> "Iterator[Callable[[Progress], None]]":
    """Yield what shows progress on standard error: a bar on a terminal, now and then a line elsewhere."""
    if sys.stderr.isatty():
        with _bar() as report:
            yield report
    else:
        yield _Lines()


@contextmanager
def _bar() -> "Iterator[Callable[[Progress], None]]":
    from rich import progress as bars
    from rich.console import Console

    from lfmesh.files.words import count, duration

    columns = (
        bars.TextColumn("{task.description}"),
        bars.BarColumn(bar_width=None),
        bars.TaskProgressColumn(),
        bars.TextColumn("{task.fields[rate]}"),
        bars.TextColumn("{task.fields[left]}"),
    )
    with bars.Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=None, rate="", left="")

        def report(now: "Progress") -> None:
            left = now.seconds_left
            replicate = min(now.replicate + 1, now.replicates)
            bar.update(
                task,
                description=f"{now.stage} (replicate {replicate}/{now.replicates})",
                completed=now.done,
                total=now.total or None,
                rate=f"{count(now.rate)} packets/s" if now.rate else "",
                left=f"{duration(left)} left" if left is not None else "",
            )

        yield report


class _Lines:
    """Progress as plain lines, at most one every tenth of the work and every two seconds."""

    STEPS = 10
    SECONDS = 2.0

    def __init__(self) -> None:
        self._step = 0
        self._printed_at = 0.0

    def __call__(self, now: "Progress") -> None:
        from lfmesh.files.words import count, duration

        step = self.STEPS * now.done // now.total if now.total else 0
        if step <= self._step or (now.seconds - self._printed_at < self.SECONDS and now.done < now.total):
            return
        self._step, self._printed_at = step, now.seconds
        line = f"{now.stage}: {100 * now.done // now.total} %, {count(now.rate)} packets/s"
        if now.seconds_left:
            line += f", {duration(now.seconds_left)} left"
        print(line, file=sys.stderr, flush=True)
