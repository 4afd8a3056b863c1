"""Lens files by extension: reading with and without the report, and writing."""

from pathlib import Path

from lfmesh.errors import SceneError
from lfmesh.imports import codev, codev_writer, lens_table, optiland_json, oslo, zemax, zemax_writer
from lfmesh.imports.conditions import Conditions
from lfmesh.imports.report import Report
from lfmesh.scene import load_lens, toml
from lfmesh.scene.camera.lens import AS_IT_STANDS, FileChoices, Lens

READERS = {
    ".zmx": zemax.read,
    ".seq": codev.read,
    ".len": oslo.read,
    ".json": optiland_json.read,
    ".csv": lens_table.read,
}
"""Readers of other programs' lens files, by extension."""

_WRITERS = {".zmx": zemax_writer.written, ".seq": codev_writer.written}


def read_lens(path: Path, choices: FileChoices = AS_IT_STANDS) -> tuple[Lens, tuple[float, ...]]:
    """Return the lens of another program's file, with a LensFileWarning on inexact conversions.

    Returns
    -------
    lens : Lens
    wavelengths_nm : tuple of float
        Wavelengths of the file, the primary one first; empty if it has none.

    Raises
    ------
    SceneError
        The file cannot be read, or its lens is not supported.
    """
    lens, report = read_lens_file(path, choices)
    report.warn()
    if report.conditions is None:
        return lens, ()
    lines, primary = report.conditions.wavelengths_nm, report.conditions.primary
    return lens, (lines[primary], *lines[:primary], *lines[primary + 1 :])


def read_lens_file(path: str | Path, choices: FileChoices = AS_IT_STANDS) -> tuple[Lens, Report]:
    """Return the lens of a file and the report on its lines.

    Parameters
    ----------
    path : str or Path
        A `.toml` file, another program's file with an extension of `READERS`, or "lib:" and the name of a bundled lens.
    choices : FileChoices
        Options for another program's file.

    Raises
    ------
    SceneError
        The file cannot be read, or its lens is not supported.
    """
    name = str(path)
    path = Path(path)
    reader = READERS.get(path.suffix.lower())
    if reader is not None and not name.startswith("lib:"):
        return reader(path, choices=choices)
    if path.suffix.lower() != ".toml" and not name.startswith("lib:"):
        raise SceneError(f"{name}: unknown ending; a lens is read from .toml, {', '.join(READERS)} or lib:NAME")
    return load_lens(name, choices), Report(path)


def write_lens_file(lens: Lens, path: str | Path, conditions: Conditions | None = None) -> list[str]:
    """Write a lens as a TOML, Zemax (with coatings beside it) or CODE V file, by the extension of its path.

    Parameters
    ----------
    lens : Lens
    path : str or Path
    conditions : Conditions, optional
        Light, fields, object and image for other programs' files, such as `Report.conditions` of the source file
        (default: the d line, the axis, the object at infinity, the image in focus).

    Returns
    -------
    notes : list of str
        Properties that the file lacks.

    Raises
    ------
    SceneError
        The extension is unknown, the format cannot hold the lens, or the file cannot be written.
    """
    path = Path(path)
    ending = path.suffix.lower()
    notes: list[str] = []
    if ending == ".toml":
        files = {path: toml.dump(lens).encode()}
    elif ending in _WRITERS:
        files, notes = _WRITERS[ending](lens, conditions or Conditions.usual(lens), path)
    else:
        raise SceneError(f"{path}: unknown ending; a lens is written to .toml, {' or '.join(_WRITERS)}")
    for each, data in files.items():
        try:
            each.write_bytes(data)
        except OSError as error:
            raise SceneError(f"{each}: cannot be written: {error.strerror}") from None
    return notes
