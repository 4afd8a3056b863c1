"""Light field of a run: `lfmesh decode`, `refocus`, `depth`; and `expose`, the detector."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from lfmesh.cli.application import app
from lfmesh.cli.interrupts import defer_interrupt
from lfmesh.cli.options import RunFolder, Whole
from lfmesh.cli.printing import list_files, say_note
from lfmesh.errors import LfmeshError
from lfmesh.wrapping import wrapped

if TYPE_CHECKING:
    from lfmesh.lightfield.photographs.photograph import AllInFocus, FocalStack, Photograph
    from lfmesh.lightfield.views.field import LightField

MOST_PLANES = 1000
"""Largest number of planes in a focal stack."""

Photographs = tuple["list[Photograph]", "FocalStack | None", "AllInFocus | None"]
"""Photographs of single planes, a focal stack, and an all-in-focus photograph."""


@app.command(
    help_epilogue="""\
More examples:

    lfmesh decode run/ --centres white-image  as the owner of a camera has to
"""
)
def decode(
    run: RunFolder,
    /,
    *,
    centres: Annotated[
        Literal["traced", "white-image"],
        Parameter(help="Source of the centres of the micro-images: traced chief rays, or the white image."),
    ] = "traced",
    white: Annotated[
        bool, Parameter(negative="--no-white", help="Divide by the white image if the run has one.")
    ] = True,
    views: Annotated[
        Whole | None, Parameter(help="Number of views along each axis (default: pixels across a micro-image).")
    ] = None,
) -> int:
    """Decode a run into its light field: lightfield.exr with all views and standard errors, views.png."""
    from lfmesh.files import field as field_files

    field = _decoded(run, centres, white, views)
    # Save first: the light field is not lost if printing fails.
    paths = field_files.save_field(field, run)
    print(wrapped(_field_in_words(field)))
    list_files(paths)
    return 0


@app.command(
    help_epilogue="""\
More examples:

    lfmesh refocus run/ --distance-mm 480 --f-number 8
    lfmesh refocus run/ --stack 300:800:20 --all-in-focus
    lfmesh refocus run/ --distance-mm 500 --method patches  of a focused camera
"""
)
def refocus(
    run: RunFolder,
    /,
    *,
    distance_mm: Annotated[
        list[float] | None,
        Parameter(help="Object distances before the first vertex, mm.", consume_multiple=True),
    ] = None,
    stack: Annotated[
        str | None, Parameter(help="Focal stack FIRST:LAST:STEP, mm; an EXR with all planes and an animated PNG.")
    ] = None,
    all_in_focus: Annotated[
        bool, Parameter(help="With --stack: also write a photograph with each pixel from its sharpest plane.")
    ] = False,
    f_number: Annotated[
        float | None,
        Parameter(help="F-number of the photographs on the image side, not below the lens's (default: all views)."),
    ] = None,
    method: Annotated[
        Literal["shift", "fourier", "patches"],
        Parameter(
            help="Shift and add views; slice their 4D Fourier transform; or join patches of a focused camera's image."
        ),
    ] = "shift",
) -> int:
    """Focus a run on other planes, from its lightfield.exr or else from its raw image."""
    if not distance_mm and stack is None:
        raise LfmeshError("nothing to focus on: give --distance-mm 480 or --stack 300:800:20")
    if all_in_focus and stack is None:
        raise LfmeshError("--all-in-focus needs --stack FIRST:LAST:STEP, whose planes it combines; give both")
    if method == "patches" and f_number is not None:
        raise LfmeshError(f"--f-number {f_number:g}: patches use all views; omit it, or use --method shift")
    planes = _planes(stack) if stack is not None else []
    with defer_interrupt():
        from lfmesh.files import photographs as files

    if method == "patches":
        single, series, sharpest = _patched(run, distance_mm or [], planes, all_in_focus)
    else:
        single, series, sharpest = _refocused(run, distance_mm or [], planes, all_in_focus, f_number, method)
    for photograph in single:
        list_files(files.save_photograph(photograph, run))
    if series is not None:
        list_files(files.save_stack(series, run))
    if sharpest is not None:
        list_files(files.save_all_in_focus(sharpest, run))
    return 0


@app.command(
    help_epilogue="""\
More examples:

    lfmesh depth run/ --near-mm 300 --far-mm 900
"""
)
def depth(
    run: RunFolder,
    /,
    *,
    near_mm: Annotated[
        float | None, Parameter(help="Nearest distance to search, mm (default: the near end of the refocus range).")
    ] = None,
    far_mm: Annotated[float | None, Parameter(help="Farthest distance to search, mm (default: the far end).")] = None,
    samples: Annotated[Whole, Parameter(help="Rays per raw pixel for its true depth.")] = 16,
) -> int:
    """Estimate the depth of a run's scene from its light field, and state the error against the traced true depth.

    Media and particles have no true depth, only an estimate.
    """
    with defer_interrupt():
        from lfmesh.files import depth as depth_files
        from lfmesh.lightfield.photographs.depth import estimate_depth
        from lfmesh.lightfield.photographs.depth_truth import depth_truth

    field = field_of(run)
    estimate = estimate_depth(field, near_mm=near_mm, far_mm=far_mm)
    truth = depth_truth(field.scene, views=field.views[0], samples=samples)
    paths = depth_files.save_truth(truth, run)
    paths += depth_files.save_depth(estimate, truth.middle_mm, run, truth.without_depth)
    print(wrapped(estimate.in_words(truth.middle_mm, truth.without_depth)))
    list_files(paths)
    return 0


@app.command(
    help_epilogue="""\
More examples:

    lfmesh expose run/ --exposure-s 0.01 --bayer RGGB \\
      --bits 10 --full-well-e 6000
"""
)
def expose(
    run: Annotated[Path, Parameter(name="run", help="Run folder, from lfmesh render.")],
    /,
    *,
    exposure_s: Annotated[
        float | None,
        Parameter(
            help="Exposure time, s (default: the scene's exposure, else bright pixels fill 80 % of their wells)."
        ),
    ] = None,
    quantum_efficiency: Annotated[float, Parameter(help="Electrons per photon.")] = 0.6,
    bayer: Annotated[
        Literal["RGGB", "BGGR", "GRBG", "GBRG"] | None,
        Parameter(help="Colour filters, starting at the upper left corner of the upright picture (default: none)."),
    ] = None,
    full_well_e: Annotated[float, Parameter(help="Full-well capacity of a pixel, electrons.")] = 10000.0,
    dark_current_e_s: Annotated[float, Parameter(help="Dark current, electrons per second.")] = 1.0,
    read_noise_e: Annotated[float, Parameter(help="Standard deviation of the read noise, electrons.")] = 2.0,
    bits: Annotated[Whole, Parameter(help="Bits of a count, 16 at most.")] = 12,
    black_level: Annotated[Whole, Parameter(help="Count of a pixel without electrons.")] = 64,
    seed: Annotated[Whole, Parameter(help="Seed of the noise.")] = 0,
) -> int:
    """Add a detector's counts to a run: photons, full wells, noise and conversion. Its image does not change."""
    with defer_interrupt():
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
    if bayer is not None and len(image.wavelengths_nm) == 1:
        say_note("the image has a single wavelength, so its mosaic shows brightness, not colour")
    exposed = (detector.timed_by(image) if exposure_s is None else detector).expose(image)
    brightest, saturated = exposed.expected_e.max(), exposed.saturated.mean()
    line = f"{exposed.detector.exposure_s:.3g} s: up to {brightest:.3g} electrons per pixel, {saturated:.2%} saturated."
    print(wrapped(line))
    list_files(save_exposed(exposed, run))
    return 0


def field_of(folder: Path) -> "LightField":
    """Return the saved light field of a run, or decode it now."""
    with defer_interrupt():
        from lfmesh.files.field import open_field

    return open_field(folder) or _decoded(folder, "traced", True, None)


def _decoded(folder: Path, centres: str, divide: bool, views: int | None) -> "LightField":
    with defer_interrupt():
        from lfmesh.files import run
        from lfmesh.lightfield.calibration.centres import estimate_centres
        from lfmesh.lightfield.views.decode import decode as decode_image

    image = run.open_run(folder)
    recorded = run.open_white(folder)
    if centres == "white-image" and recorded is None:
        raise LfmeshError(f"--centres white-image: {folder} has no white.exr; make it with lfmesh white {folder}")
    calibration = estimate_centres(recorded) if recorded is not None and centres == "white-image" else None
    return decode_image(image, white=recorded if divide else None, calibration=calibration, views=views)


def _field_in_words(field: "LightField") -> str:
    from lfmesh.scene.distance import reach_in_words

    rows, columns = field.views
    height, width = field.size
    near, far = field.model.refocus_range_mm
    return (
        f"{columns} × {rows} views of {width} × {height} samples, in {field.unit}; {field.sampling}. It refocuses "
        f"sharply from {reach_in_words(near, far)}."
    )


def _refocused(
    run: Path, distances: list[float], planes: list[float], everywhere: bool, f_number: float | None,
    method: Literal["shift", "fourier"],
) -> Photographs:  # fmt: skip
    """Photograph planes from the views of a light field."""
    with defer_interrupt():
        from lfmesh.lightfield.photographs.photograph import all_in_focus
        from lfmesh.lightfield.photographs.refocus import focal_stack
        from lfmesh.lightfield.photographs.refocus import refocus as focus_on

    field = field_of(run)
    single = [focus_on(field, distance, f_number=f_number, method=method) for distance in distances]
    series = focal_stack(field, planes, f_number=f_number, method=method) if planes else None
    return single, series, all_in_focus(series) if series is not None and everywhere else None


def _patched(run: Path, distances: list[float], planes: list[float], everywhere: bool) -> Photographs:
    """Photograph planes from the raw image of a focused plenoptic camera."""
    with defer_interrupt():
        from lfmesh.files.run import open_run, open_white
        from lfmesh.lightfield.views.patches import patch_stack, patches_in_focus, render_patches

    image, white = open_run(run), open_white(run)
    single = [render_patches(image, distance, white=white) for distance in distances]
    series = patch_stack(image, planes, white=white) if planes else None
    return single, series, patches_in_focus(image, planes, white=white) if planes and everywhere else None


def _planes(stack: str) -> list[float]:
    """Return the distances of a FIRST:LAST:STEP, including the last one if a step reaches it."""
    try:
        first, last, step = (float(part) for part in stack.split(":"))
        if step == 0.0:
            raise LfmeshError(
                f"--stack {stack}: STEP = {step:g}: must not be 0; above 0 where LAST is farther than FIRST, else "
                "below, such as 300:800:20"
            )
        count = int((last - first) / step * (1.0 + 1e-9)) + 1
    except (ValueError, OverflowError):
        raise LfmeshError(f"--stack {stack}: give three numbers, FIRST:LAST:STEP in mm, such as 300:800:20") from None
    if count < 2 or not first > 0.0:
        raise LfmeshError(f"--stack {stack}: the steps must lead from FIRST, above 0, to LAST, such as 300:800:20")
    if count > MOST_PLANES:
        raise LfmeshError(f"--stack {stack}: {count} planes; give a larger STEP, for {MOST_PLANES} at most")
    return [first + i * step for i in range(count)]
