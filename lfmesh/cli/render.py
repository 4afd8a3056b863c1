"""Rendering of scene files into run folders: `lfmesh check`, `render`, `white`."""

import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from lfmesh.cli.application import WRONG_INPUT, app
from lfmesh.cli.interrupts import code_of_last, defer_interrupt
from lfmesh.cli.options import Dask, Overrides, RunFolder, SceneFile, Shard, Verbose, as_option, overridden, share_of
from lfmesh.cli.printing import list_files, say_note, say_warnings
from lfmesh.errors import FileError, LfmeshError, warn_caller
from lfmesh.view.progress import progress, status
from lfmesh.wrapping import wrapped

if TYPE_CHECKING:
    from lfmesh.scene import Scene
    from lfmesh.transport.render.image import Image


Account = Callable[["Image", Path], list[str]]
"""Lines to print about an image that was saved into a folder."""


@app.command
def check(scene: SceneFile, /) -> int:
    """Check a scene file; print its first-order optics, the positions of its targets, media and particles, and notes.

    Loads every mesh and picture, and traces nothing but a few rays of particles that are to be pictured by waves.

    Exits with 0 if the scene can be rendered, whatever the warnings, and with 2 if it cannot.
    """
    from lfmesh.geometry.index_media import any_bends
    from lfmesh.geometry.lens.solved_camera import first_order, mesh_lines, solved_camera
    from lfmesh.geometry.objects.placement import placements
    from lfmesh.geometry.objects.tanks import tank_lines
    from lfmesh.scene import Finish, load
    from lfmesh.scene.materials.glasses import glass_lines

    loaded = load(scene)
    with defer_interrupt():
        from lfmesh.transport.build import build
        from lfmesh.transport.checks.foreseen import foreseen
        from lfmesh.transport.checks.lamp_lines import lamp_lines
    lines = [*first_order(loaded).lines(), *mesh_lines(loaded), *glass_lines(solved_camera(loaded).scene)]
    if loaded.tanks:
        lines += tank_lines(loaded, first_order(loaded).object_index)
    if loaded.all_coatings:
        from lfmesh.transport.tables.interfaces import coating_lines

        lines += coating_lines(solved_camera(loaded).scene)
    if any(finish != Finish() for _, finish in loaded.finishes()):
        from lfmesh.transport.tables.interfaces import finish_lines

        lines += finish_lines(solved_camera(loaded).scene)
    if any(True for _ in loaded.phases()):
        from lfmesh.scene.first_order.phase_lines import phase_lines

        lines += phase_lines(solved_camera(loaded).scene)
    camera = solved_camera(loaded).scene
    if any(True for _ in camera.gradients()):
        from lfmesh.scene.first_order.gradient_lines import gradient_lines

        lines += gradient_lines(camera)
    for placement in placements(loaded):
        lines += placement.lines()
    # Refuse what a render would refuse.
    world = build(loaded)
    if world.particles and loaded.transport.diffraction != "none":
        from lfmesh.waves.particles import refuse_particles

        with progress() as report:
            refuse_particles(world, report)
    found = foreseen(world)
    warn_caller(found)
    # Do not repeat warnings as notes.
    said = {f"Note: {each}" for each in found}
    lines = [line for line in lines if line not in said]
    lines += lamp_lines(loaded, world.targets)
    if world.scene.media or world.particles:
        from lfmesh.transport.checks.media_places import media_places

        lines += [line for place in media_places(world) for line in place.lines(world.scene.primary_nm)]
    if world.scene.exposure is not None:
        from lfmesh.transport.checks.motion_lines import motion_lines

        lines += motion_lines(world)
    if any_bends(world.scene):
        from lfmesh.transport.checks.field_lines import field_lines
        from lfmesh.transport.tables.bending_fields import bending_media

        lines += field_lines(bending_media(world.scene, world.lines.wavelengths_nm), world.scene, world.facts)
    print("\n".join(map(wrapped, lines)))
    return 0


@app.command(
    help_epilogue="""\
More examples:

    lfmesh render scene.toml -o run/ --samples 256 --threads 4 --verbose
    lfmesh render scene.toml -o run/ --wavelengths-nm 486.1 587.6 656.3
    lfmesh render --resume run/      continue an interrupted render
    lfmesh render scene.toml -o run/ --restart
    lfmesh render scene.toml -o a/ --shard 1/3
    lfmesh render --merge a/ b/ c/ -o run/
    lfmesh render scene.toml -o run/ --dask tcp://10.0.0.1:8786
"""
)
def render(
    scene: Annotated[Path | None, Parameter(name="scene", help="Scene file (TOML).")] = None,
    /,
    *,
    out: Annotated[
        Path | None,
        Parameter(name=["--out", "-o"], help="Run folder to write: new, empty, or an older run to replace."),
    ] = None,
    resume: Annotated[
        Path | None, Parameter(help="Continue the interrupted or killed render in this run folder.")
    ] = None,
    restart: Annotated[bool, Parameter(help="Discard an interrupted render in --out and start again.")] = False,
    with_white: Annotated[
        bool, Parameter(name="--white", help="Also render the white image for decoding, as lfmesh white does.")
    ] = False,
    dask: Dask = None,
    shard: Shard = None,
    merge: Annotated[
        list[Path] | None,
        Parameter(help="Combine these folders of shares into one run.", consume_multiple=True),
    ] = None,
    verbose: Verbose = False,
    overrides: Overrides | None = None,
) -> int:
    """Render a scene into a run folder: raw.exr with its standard error, previews, report.json.

    Ctrl-C keeps the finished replicates as a valid run, marked as incomplete. --resume continues such a run, or one
    that was killed, to the same bits as without the break.

    --shard traces one part of the samples here, and --merge combines the parts into a run; --dask divides the work
    among the workers of a cluster. The result has the same bits as on a single machine.
    """
    ways = {"--resume": resume, "--merge": merge, "--shard": shard, "--dask": dask}
    if len(given := [name for name, value in ways.items() if value is not None]) > 1:
        raise LfmeshError(f"{' and '.join(given)} cannot be combined: give one of them")
    if restart and given and dask is None:
        raise LfmeshError(f"--restart cannot be combined with {given[0]}: omit it")
    if merge is not None:
        code = _merged(merge, scene, out, overrides, with_white=with_white, verbose=verbose)
        return _white(out, None) if with_white and out is not None and code == 0 else code
    if resume is not None:
        code = _resume(resume, scene, out, overrides, with_white=with_white, verbose=verbose)
        return _white(resume, None) if with_white and code == 0 else code
    if scene is None or out is None:
        missing = "a scene file" if scene is None else "--out, the run folder to write"
        raise LfmeshError(f"render needs {missing}: lfmesh render scene.toml -o run/, or lfmesh render --resume run/")
    if (share := share_of(shard)) is not None:
        if with_white:
            raise LfmeshError("--white needs the whole run: give it with --merge")
        return _share(scene, out, share, overrides)
    account = partial(run_account, verbose=verbose)
    code = render_file(scene, out, account, overrides, dask, restart=restart, with_white=with_white)
    return _white(out, None) if with_white and code == 0 else code


@app.command
def white(run: RunFolder, /, *, overrides: Overrides | None = None) -> int:
    """Render the white image of a run's camera, which looks at a uniform plane, and trace its micro-image centres.

    Adds white.exr and calibration.json to the run; the settings of the run hold unless replaced.
    """
    return _white(run, overrides)


def _share(scene_file: Path, folder: Path, share: tuple[int, int], overrides: Overrides | None) -> int:
    """Trace a share of a render into a folder of pieces."""
    from lfmesh.scene import load

    scene = overridden(load(scene_file), overrides)
    _say_beforehand(scene)
    with defer_interrupt():
        from lfmesh.files.shares import trace_share

    number, shares = share
    with status() as say:
        count = trace_share(
            scene.pinned(), folder, number, shares, lambda done, total: say(f"{done} of {total} pieces")
        )
    print(f"{folder} holds the {count} pieces of share {number}/{shares}; when all shares are finished:")
    print(f"  lfmesh render --merge {folder} ... -o run/")
    return 0


def _merged(
    folders: list[Path], scene: Path | None, out: Path | None, overrides: Overrides | None, *,
    with_white: bool, verbose: bool,
) -> int:  # fmt: skip
    """Merge all shares of a render into a run."""
    beside = [
        *(["the scene"] if scene else []),
        *(as_option(name) for name in (overrides.given() if overrides else {})),
    ]
    if beside:
        raise LfmeshError(f"--merge takes scene and settings from the shares: omit {', '.join(beside)}")
    if out is None:
        raise LfmeshError("--merge needs --out, the run folder to write: lfmesh render --merge a/ b/ -o run/")
    with defer_interrupt():
        from lfmesh.files import run, shares

    run.prepare(out)
    with run.rendering(out):
        image = shares.merged(folders)
        if with_white:
            _refuse_undecodable(image.scene)
        return _concluded(image, out, partial(run_account, verbose=verbose))


def render_file(
    scene_file: Path, folder: Path, account: Account, overrides: Overrides | None = None, dask: str | None = None, *,
    restart: bool = False, with_white: bool = False,
) -> int:  # fmt: skip
    """Render a scene file into a run folder, print the account of it, and return the exit code.

    Parameters
    ----------
    scene_file, folder : Path
    account : callable
    overrides : Overrides, optional
    dask : str, optional
        Address of a scheduler.
    restart : bool
        Discard an interrupted render in the folder.
    with_white : bool
        Refuse a camera without a white image.
    """
    from lfmesh.geometry.lens.solved_camera import solved_camera
    from lfmesh.scene import load

    scene = overridden(load(scene_file), overrides)
    # Report faults of the scene before faults of the folder.
    solved_camera(scene)

    # Report faults of the folder before importing the tracer, which takes seconds.
    with defer_interrupt():
        from lfmesh.files import run
        from lfmesh.files.claims import refuse_claimed

    # A running render has a checkpoint, too.
    refuse_claimed(folder)
    if run.has_checkpoint(folder) and not restart:
        raise FileError(
            f"{folder} holds an interrupted render: continue it with lfmesh render --resume {folder}, or start again "
            "with --restart"
        )
    if with_white:
        _refuse_undecodable(scene)
    run.prepare(folder)
    _say_beforehand(scene)
    with run.rendering(folder):
        return _traced(scene, folder, account, dask=dask)


def _refuse_undecodable(scene: "Scene") -> None:
    """Refuse --white before tracing if the camera's light field cannot be decoded."""
    with defer_interrupt():
        from lfmesh.lightfield.calibration.calibration import calibrate

    calibrate(scene)


def _say_beforehand(scene: "Scene") -> None:
    """Print a scene's warnings and first-order notes before importing the tracer, which takes seconds."""
    from lfmesh.geometry.lens.solved_camera import solved_camera
    from lfmesh.scene.advice import doubtful

    camera = solved_camera(scene)
    say_warnings(doubtful(camera.scene, camera.report), camera.report)


def _resume(
    folder: Path, scene: Path | None, out: Path | None, overrides: Overrides | None, *, with_white: bool, verbose: bool
) -> int:
    """Resume an interrupted render with the scene and settings of its run."""
    given = overrides.given() if overrides else {}
    threads = Overrides(threads=given.pop("threads", None))
    beside = [*(["a scene"] if scene else []), *(["--out"] if out else []), *(as_option(name) for name in given)]
    if beside:
        raise LfmeshError(f"--resume takes scene and settings from the run: omit {', '.join(beside)}")
    with defer_interrupt():
        from lfmesh.files import checkpoint, image_file, run
        from lfmesh.files.claims import refuse_claimed

    refuse_claimed(folder)
    if run.is_complete(folder):
        print(f"{folder} is complete: there is nothing to continue.")
        return 0
    run.prepare(folder)
    with run.rendering(folder):
        kept = checkpoint.read(folder, image_file.scene_from)
        if with_white:
            _refuse_undecodable(kept.scene)
        return _traced(overridden(kept.scene, threads), folder, partial(run_account, verbose=verbose), kept.arrays)


def _traced(
    scene: "Scene", folder: Path, account: Account, saved: "dict[str, Any] | None" = None, dask: str | None = None
) -> int:
    """Render into a run folder.

    Parameters
    ----------
    scene : Scene
    folder : Path
    account : callable
    saved : dict of arrays, optional
        Arrays of a checkpoint to resume from.
    dask : str, optional
        Address of a scheduler.
    """
    with defer_interrupt():
        from lfmesh.files import image_file
        from lfmesh.files.checkpoint import Checkpoints
        from lfmesh.waves.particles import particle_film
        from lfmesh.waves.render import render as trace_image

    scene = scene.pinned()
    keep = Checkpoints(folder, image_file.scene_metadata(scene, folder))
    try:
        with progress() as report:
            if dask is None:
                image = trace_image(scene, progress=report, saved=saved, keep=keep)
            else:
                from lfmesh.transport.render.on_cluster import render_on_cluster

                image = render_on_cluster(scene, dask, progress=report, saved=saved, keep=keep, untraced=particle_film)
    except KeyboardInterrupt:
        if not keep.written:
            raise
        print(f"Stopped before a replicate was finished. To continue: lfmesh render --resume {folder}")
        return code_of_last()
    return _concluded(image, folder, account)


def run_account(image: "Image", folder: Path, *, verbose: bool) -> list[str]:
    """Return the lines about a run: its noise, its checks and its files; warnings were printed as they came."""
    from lfmesh.files import words

    return [*map(wrapped, words.account(image, verbose=verbose)), _whereabouts(image, folder)]


def _concluded(image: "Image", folder: Path, account: Account) -> int:
    """Save a run and print its account."""
    place = _saved(image, folder)
    try:
        print("\n".join(account(image, place)))
    except KeyboardInterrupt:
        print(f"\nStopped: the run in {place} is saved.", file=sys.stderr)
        return code_of_last()
    if not image.complete:
        print(f"  To continue: lfmesh render --resume {folder}")
    if place != folder:
        return WRONG_INPUT
    return 0 if image.complete else code_of_last()


def _saved(image: "Image", folder: Path) -> Path:
    """Save a run and return its folder: a temporary one if the given folder or its disk cannot take it."""
    from lfmesh.files import run

    try:
        run.save(image, folder)
        return folder
    except (OSError, FileError) as error:
        why = error.strerror or str(error) if isinstance(error, OSError) else str(error)
    other = Path(tempfile.mkdtemp(prefix="lfmesh-"))
    try:
        run.save(image, other)
    except (OSError, FileError):
        with suppress(OSError):
            other.rmdir()
        kept = f"; lfmesh render --resume {folder} continues from its checkpoint" if run.has_checkpoint(folder) else ""
        raise FileError(f"{folder}: the run cannot be saved: {why}, nor in {other.parent}{kept}") from None
    say_note(f"{folder}: the run cannot be saved: {why}. It is in {other}; move it from there.")
    return other


def _white(folder: Path, overrides: Overrides | None) -> int:
    with defer_interrupt():
        from lfmesh.files import run
        from lfmesh.lightfield.calibration.calibration import calibrate
        from lfmesh.lightfield.calibration.centres import estimate_centres
        from lfmesh.lightfield.calibration.white import white_image

    # Calibrate first: an image that cannot be decoded needs no white image, and this says so before the render.
    scene = run.open_run(folder).scene
    if run.scene_is_edited(folder):
        say_note(
            f"{folder / run.SCENE} was edited since it was rendered; the white image is of the camera of {run.RAW}, "
            "so that it can divide it"
        )
    calibration = calibrate(scene)
    with progress() as report:
        image = white_image(overridden(scene, overrides), progress=report)
    if not image.complete:
        raise KeyboardInterrupt
    run.save_white(image, calibration, folder)
    print(
        f"{calibration.known.sum()} of {calibration.known.size} micro-images have a chief ray, "
        f"{calibration.pitch_px:.6g} pixels apart, turned by {1e3 * calibration.rotation_rad:z.3f} mrad."
    )
    try:
        error = estimate_centres(image).error_px(calibration)
        print(f"Found from the white image alone, they are {error.mean():.3g} pixels off on average.")
    except LfmeshError as fault:
        say_note(fault)
    list_files([folder / name for name in (run.WHITE, run.WHITE_PREVIEW, run.CALIBRATION)])
    return 0


def _whereabouts(image: "Image", folder: Path) -> str:
    from lfmesh.files import run

    pictures = [(run.PREVIEW, "the raw image, upright"), (run.RAW, "power and standard error, W per pixel")]
    if image.scene.camera.mla is not None:
        pictures.insert(0, (run.VIEW, "the scene as the camera sees it"))
    pictures.append((run.REPORT, "all figures of the run"))
    width = max(len(str(folder / name)) for name, _ in pictures)
    return "\n".join(f"  {folder / name!s:<{width}}  {what}" for name, what in pictures)
