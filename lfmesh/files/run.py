"""Run folder: a rendered image with everything needed to judge and repeat it."""

import itertools
import json
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import lfmesh
from lfmesh.errors import FileError
from lfmesh.files import exr, words
from lfmesh.files.calibration import read_calibration, write_calibration
from lfmesh.files.checkpoint import CHECKPOINT
from lfmesh.files.claims import claimed, refuse_claimed
from lfmesh.files.colour import white_in_words
from lfmesh.files.folder import (
    MANIFEST,
    STAGING,
    Change,
    Entry,
    Manifest,
    commit,
    is_safe,
    manifest_of,
    recover,
    saved,
    staged,
)
from lfmesh.files.image_file import ERROR, FORMAT, HITS, PARTS, UPPER, image_from, refuse_damage, write_image
from lfmesh.files.inputs import within
from lfmesh.files.inside import refuse_link
from lfmesh.files.json_values import parse_json, plain_json
from lfmesh.files.lenslets import lenslet_means, paint
from lfmesh.files.preview import write_linear16, write_preview
from lfmesh.files.scene_file import save_scene
from lfmesh.geometry.array.lattice import Lattice
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.lightfield.calibration.calibration import Calibration
from lfmesh.lightfield.views.upright import UPRIGHT, Upright
from lfmesh.regular_file import read_text
from lfmesh.scene import Scene
from lfmesh.scene.inputs import COPIES
from lfmesh.scene.literals import shown_path
from lfmesh.transport.render.image import Image

WHY_OTHERS_ARE_REFUSED = {1: "its pictures and light fields are mirror images of the scene"}
"""Faults of runs in older formats, and of files derived from them, by format."""

RAW, REPORT, SCENE = "raw.exr", "report.json", "scene.toml"
PREVIEW, VIEW, OVERVIEW = "preview.png", "preview_view.png", "overview.png"
WHITE, CALIBRATION, WHITE_PREVIEW = "white.exr", "calibration.json", "white.png"

EDITED_SECONDS = 2.0
"""A scene file that is newer than the report by more than this was edited (runs without a manifest)."""

_OURS = re.compile(
    r"raw\.exr|report\.json|scene\.toml|preview(_view)?\.png|overview\.png|linear16[\w.]*\.png|calibration\.json"
    r"|views\.png|exposed\.(png|json)|depth(_views|_pixels)?\.exr|depth\.png|schlieren\.(exr|png)"
    r"|(white|lightfield|stack|all_in_focus|refocused_[\w.+]+)\.(exr|png)|inputs/.*"
)


def prepare(folder: str | os.PathLike[str]) -> Path:
    """Check that a run can be saved into a folder, without leaving anything there.

    Parameters
    ----------
    folder : path
        Missing, empty, or holding an older run.

    Returns
    -------
    Path

    Raises
    ------
    FileError
        The path is not a folder or cannot be written, or it holds something other than a run, or an edited scene file
        of a run.
    """
    path = Path(folder)
    with _writable(path) as made:
        refuse_link(path / COPIES)
        if edited := _edited(path, _held_by(path)):
            raise FileError(
                f"{path / edited[0]} was edited since lfmesh wrote it, and the new run would replace it: rename it, or"
                " copy it elsewhere (paths in a scene file start from its folder), or choose another run folder"
            )
        _remove_unused(made)
    return path


@contextmanager
def rendering(folder: Path) -> Iterator[None]:
    """Keep other processes from rendering or saving into a run folder while the body computes.

    Parameters
    ----------
    folder : Path
        Created if missing, and removed at the end if empty.

    Raises
    ------
    FileError
        Another process is rendering into the folder, or it cannot be written.
    """
    with ExitStack() as stack:
        with _writable(folder) as made:
            stack.callback(_remove_unused, made)
            stack.enter_context(claimed(folder))
        yield


def save(content: Image | Scene, place: str | os.PathLike[str]) -> Path:
    """Write an image as a run folder, or a scene as a scene file.

    A scene is written as TOML that loads to an equal scene, with relative paths from its new place. An image is written
    as

    - ``raw.exr``: mean and standard error as float32, samples that found light as uint32, and other data as JSON
    - ``report.json``: figures of the run
    - ``scene.toml``: the scene as rendered
    - ``preview.png``: the raw image; for a light-field camera also ``preview_view.png``, the picture it saw
    - ``linear16.png``: linear counts
    - ``inputs``: copies of meshes and textures
    - ``manifest.json``: every file with its digest

    Pictures are upright; ``raw.exr`` is oriented as on the sensor. Files are moved into place when all are complete, so
    a failure or Ctrl-C leaves the folder unchanged. An older run is replaced; its edited scene file is renamed, and
    other files stay. A complete image removes any checkpoint.

    Parameters
    ----------
    content : Image or Scene
    place : path
        A folder, or the name of a scene file, which ends in ``.toml``.

    Returns
    -------
    Path
        The folder or file.

    Raises
    ------
    FileError
        As for `prepare`; or another process is rendering or saving into the folder, the disk is full, or a scene file
        has another extension.
    """
    path = Path(place)
    if isinstance(content, Scene):
        return save_scene(content, path)
    image = content
    with _writable(path), claimed(path, again=True), staged(path) as staging:
        _write_all(image, staging, path)

        def decide(new: Manifest) -> Change:
            held = _held_by(path)
            edited = _edited(path, held)
            removed = {name for name in held if _OURS.fullmatch(name)} - new.keys() - set(edited)
            checkpoint = {CHECKPOINT} if image.complete else set()
            return Change(new, removed | checkpoint, {name: _other_name(path, name) for name in edited if name in new})

        commit(path, staging, decide)
    return path


def open_run(folder: str | os.PathLike[str]) -> Image:
    """Read a run folder back.

    Parameters
    ----------
    folder : path

    Returns
    -------
    Image
        Rounded to float32, as saved.

    Raises
    ------
    FileError
        There is no run, it is incomplete or damaged, or another version of lfmesh wrote it.
    """
    path = Path(folder)
    report = report_of(path)
    _refuse_change(path, RAW)
    spectral = exr.read(path / RAW, PARTS, [HITS, ERROR, UPPER])
    metadata = spectral.metadata
    refuse_damage(path / RAW, spectral)
    if metadata["pixels_sha256"] != report.get("pixels_sha256"):
        raise FileError(f"{path} mixes two runs: {RAW} and {REPORT} do not belong together; render it again")
    _refuse_change(path, REPORT)
    return image_from(spectral, path / RAW)


def save_white(white: Image, calibration: Calibration, folder: str | os.PathLike[str]) -> Path:
    """Add a white image and the geometry of its camera to a run folder.

    Parameters
    ----------
    white : Image
        From `lf.white_image`, for the run's camera.
    calibration : Calibration
    folder : path

    Returns
    -------
    Path

    Raises
    ------
    FileError
        The folder holds no complete run or cannot be written.
    """
    path = Path(folder)
    with added(path) as staging:
        write_image(staging / WHITE, white, path)
        picture = Upright.of(white.scene).picture
        write_preview(staging / WHITE_PREVIEW, picture(white.mean), white.wavelengths_nm, picture(white.stderr))
        write_calibration(staging / CALIBRATION, calibration)
    return path


def open_white(folder: str | os.PathLike[str]) -> Image | None:
    """Read the white image of a run folder; return None if it has none.

    Parameters
    ----------
    folder : str or path

    Returns
    -------
    Image or None

    Raises
    ------
    FileError
        It is damaged.
    """
    path = Path(folder)
    recover(path)
    if saved(path, WHITE) is None:
        return None
    spectral = exr.read(path / WHITE, PARTS, [HITS, ERROR, UPPER])
    refuse_damage(path / WHITE, spectral)
    return image_from(spectral, path / WHITE)


def open_calibration(folder: str | os.PathLike[str]) -> Calibration | None:
    """Read the camera geometry added by `save_white`; return None if the run folder has none.

    Parameters
    ----------
    folder : str or path

    Raises
    ------
    FileError
        It is damaged or differs from the one saved.
    """
    path = Path(folder)
    recover(path)
    kept = saved(path, CALIBRATION)
    return None if kept is None else read_calibration(kept)


@contextmanager
def added(folder: Path) -> Iterator[Path]:
    """Yield a folder for files that join a complete run, all or none, when the body is done.

    Raises
    ------
    FileError
        The folder holds no complete run or cannot be written.
    """
    report_of(folder)
    with _writable(folder), staged(folder) as staging:
        yield staging

        def decide(new: Manifest) -> Change:
            there = {name: entry for name, entry in _held_by(folder).items() if (folder / name).is_file()}
            return Change({name: entry or Entry.of(folder / name) for name, entry in there.items()} | new)

        commit(folder, staging, decide)


def report_of(path: Path) -> dict[str, Any]:
    """Return the report of a complete run.

    Raises
    ------
    FileError
        The folder holds no complete run, or another version of lfmesh wrote it.
    """
    _check_folder(path)
    missing = [name for name in (RAW, REPORT) if not (path / name).is_file()]
    if missing:
        mended = f"lfmesh render --resume {path} continues it" if has_checkpoint(path) else "render it again"
        raise FileError(f"{path} is not a complete run: {' and '.join(missing)} missing; {mended}")
    report = _read_report(path)
    if report is None:
        raise FileError(f"{path / REPORT} is damaged or not a report of lfmesh; render the scene again")
    if report["format"] != FORMAT:
        reason = WHY_OTHERS_ARE_REFUSED.get(report["format"])
        raise FileError(
            f"{path} has run format {report['format']}, written by lfmesh {report['lfmesh_version']};"
            f" this lfmesh {lfmesh.__version__} reads format {FORMAT}"
            + (f": {reason}; render its {SCENE} again" if reason else "")
        )
    # Check that it can be read, and by this version.
    manifest_of(path)
    return report


def _check_folder(path: Path) -> None:
    """Raise if a path cannot be a run; finish the work of a process that died."""
    recover(path)
    try:
        why = None if path.is_dir() else "it is a file" if path.exists() else "it does not exist"
    except OSError as error:
        why = str(error.strerror)
    if why is not None:
        raise FileError(f"{path} is not a run folder: {why}")


def is_complete(path: Path) -> bool:
    """Tell whether a folder holds a finished render and no checkpoint of a later one.

    Raises
    ------
    FileError
        It is not a folder.
    """
    _check_folder(path)
    report = _read_report(path)
    return report is not None and bool(report.get("complete")) and not has_checkpoint(path)


def has_checkpoint(path: Path) -> bool:
    """Tell whether a folder holds an interrupted render that can resume."""
    return (path / CHECKPOINT).is_file()


def pixels_digest(folder: Path) -> str:
    """Return the hash of a run's raw pixels, from its report.

    Raises
    ------
    FileError
        The folder holds no complete run, its report was changed, or another version of lfmesh wrote it.
    """
    report = report_of(folder)
    _refuse_change(folder, REPORT)
    return str(report.get("pixels_sha256"))


def _refuse_change(folder: Path, name: str) -> None:
    """Refuse a file that differs from the one saved, before parsing it.

    Parsers may do anything on a few wrong bits.
    """
    if saved(folder, name) is None:
        raise FileError(f"{folder / MANIFEST} does not name {name}, which every run needs; render it again")


@contextmanager
def _writable(path: Path) -> Iterator[list[Path]]:
    """Make a run folder and yield its missing folders, outermost first; remove them on failure.

    Every OSError, here or in the body, counts as the user's: a full disk, a missing permission.
    """
    _refuse_unwritable_name(path)
    recover(path)
    refuse_claimed(path)
    _refuse_foreign(path)
    made: list[Path] = []
    try:
        for ancestor in reversed([path, *path.parents]):
            if not ancestor.exists():
                ancestor.mkdir()
                made.append(ancestor)
        with tempfile.TemporaryFile(dir=path):
            pass
        yield made
    except BaseException as error:
        _remove_unused(made)
        if isinstance(error, OSError):
            raise _cannot_write(path, error) from None
        raise


def _remove_unused(made: list[Path]) -> None:
    """Remove the folders made for a run (listed outermost first) as far as they are empty."""
    for folder in reversed(made):
        with suppress(OSError):
            folder.rmdir()


def _refuse_unwritable_name(path: Path) -> None:
    """Refuse a name that OpenEXR and JSON cannot hold, before computing results that would be lost."""
    try:
        path.absolute().as_posix().encode("utf-8")
    except UnicodeEncodeError:
        shown = os.fsencode(path).decode("utf-8", errors="backslashreplace")
        raise FileError(f"{shown} cannot be written: its path is not UTF-8; choose another folder") from None
    if "\0" in str(path):
        raise FileError(f"{shown_path(path)} cannot be written: a file name must not contain a NUL character")


def _refuse_foreign(path: Path) -> None:
    """Refuse a place whose content lfmesh may not replace."""
    try:
        if path.exists() and not path.is_dir():
            raise FileError(f"{path} is a file; a run is written into a folder")
        entries = [entry.name for entry in path.iterdir()] if path.exists() else []
    except OSError as error:
        raise _cannot_write(path, error) from None
    foreign = sorted(name for name in entries if not name.startswith(STAGING) and name != CHECKPOINT)
    if foreign and _read_report(path) is None:
        what = foreign[0] if len(foreign) == 1 else f"{len(foreign)} files or folders ({foreign[0]}, ...)"
        raise FileError(f"{path} holds {what} and no run of lfmesh: choose an empty or a new folder")


def _cannot_write(path: Path, error: OSError) -> FileError:
    return FileError(f"{path} cannot be written: {error.strerror or error}")


def _read_report(path: Path) -> dict[str, Any] | None:
    """Return report.json of a run folder; None if there is none written by lfmesh."""
    try:
        report = parse_json(read_text(path / REPORT))
    except (OSError, ValueError):
        return None
    ours = isinstance(report, dict) and "lfmesh_version" in report and isinstance(report.get("format"), int)
    return report if ours else None


def _held_by(path: Path) -> dict[str, Entry | None]:
    """Return the files of the run in a folder, from its manifest or, without digests, from its report."""
    try:
        manifest = manifest_of(path)
    except FileError:
        manifest = None
    if manifest is not None:
        return dict(manifest)
    files = (_read_report(path) or {}).get("files")
    ours = [] if not isinstance(files, list) else [name for name in files if is_safe(name) and _OURS.fullmatch(name)]
    return {name: None for name in ours if (path / name).is_file()}


def scene_is_edited(path: Path) -> bool:
    """Tell whether the scene file of a run was edited, so that it no longer describes the image."""
    return SCENE in _edited(path, _held_by(path))


def _edited(path: Path, held: dict[str, Entry | None]) -> list[str]:
    """Return the edited files among a run's scene file and copied inputs."""

    def is_edited(name: str, entry: Entry | None) -> bool:
        if entry is not None:
            return not entry.fits(path / name)
        return (path / name).stat().st_mtime > (path / REPORT).stat().st_mtime + EDITED_SECONDS

    mine = [name for name in held if name == SCENE or name.startswith(f"{COPIES}/")]
    return [name for name in mine if (path / name).is_file() and is_edited(name, held[name])]


def _other_name(path: Path, name: str) -> str:
    """Return an unused name for an edited file of the run."""
    place = Path(name)
    numbers = (f"{place.stem}.edited{number or ''}{place.suffix}" for number in itertools.count())
    return next(other for other in (place.with_name(n).as_posix() for n in numbers) if not (path / other).exists())


def _write_all(image: Image, folder: Path, home: Path) -> None:
    """Write every file of a run that will live in `home`."""
    scene = within(image.scene, home, folder)
    metadata = write_image(folder / RAW, replace(image, scene=scene), home)
    (folder / SCENE).write_text(scene.dump_toml(), encoding="utf-8")
    upright = Upright.of(image.scene).picture
    white = write_preview(folder / PREVIEW, upright(image.mean), image.wavelengths_nm, upright(image.stderr))
    shown = {"orientation": UPRIGHT, "encoding": "sRGB", "white_point": white_in_words(image.wavelengths_nm)}
    pictures: dict[str, Any] = {PREVIEW: {**shown, "white_w": white}}
    grid = _micro_images(image.scene)
    if grid is not None:
        view = upright(paint(lenslet_means(image.mean, grid), grid))
        white = write_preview(folder / VIEW, view, image.wavelengths_nm)
        pictures[VIEW] = {**shown, "white_w": white}
    linear_names, watts_per_count = write_linear16(folder, upright(image.mean), image.wavelengths_nm)
    for name in linear_names:
        pictures[name] = {
            "orientation": UPRIGHT,
            "encoding": "linear",
            "watts_per_count": watts_per_count,
        }
    report = {
        **{key: value for key, value in metadata.items() if key != "scene_toml"},
        "noise": asdict(words.noise(image)),
        "diffraction": words.diffraction(image.scene),
        "summary": words.summary(image),
        "pictures": pictures,
    }
    text = json.dumps(plain_json(report), indent=2, allow_nan=False, ensure_ascii=False)
    (folder / REPORT).write_text(text + "\n", encoding="utf-8")


def _micro_images(scene: Scene) -> Lattice | None:
    """Return the nominal lattice of micro-images in pixels; None for a camera without a microlens array."""
    mla, pitch_px = scene.camera.mla, solved_camera(scene).facts.micro_image_pitch_px
    if mla is None or pitch_px is None:
        return None
    return Lattice(mla.layout == "hexagonal", pitch_px, columns=mla.count[0], rows=mla.count[1])
