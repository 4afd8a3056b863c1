"""Read scene files, reporting all faults of a file in one error."""

import re
import tomllib
import warnings
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from lfmesh.assets import asset_path
from lfmesh.errors import FileError, LensFileWarning, LfmeshError, SceneError
from lfmesh.regular_file import MARK, open_regular
from lfmesh.scene.camera.file_choices import AS_IT_STANDS, FILE_CHOICES, FileChoices
from lfmesh.scene.camera.lens import STOP_SIZES, Lens
from lfmesh.scene.camera.lens_readers import endings, reader_of
from lfmesh.scene.camera.phase import with_grids_beside
from lfmesh.scene.file_kinds import FileKind, mistaken_for
from lfmesh.scene.literals import LONGEST_BITS, literal, shown_path
from lfmesh.scene.materials.own_glass import with_tables_beside
from lfmesh.scene.model import fault_lines, format_path, listed, nearest
from lfmesh.scene.objects.gltf_keys import take_keys
from lfmesh.scene.objects.gltf_reader import gltf_reader
from lfmesh.scene.quantities import path_fault
from lfmesh.scene.scene import Scene

MOST_BYTES = 20_000_000
"""Largest size of a TOML file in bytes, ample for tables of spectra."""

DEEPEST_TABLE = 32
"""Deepest nesting of tables and lists in a file; scenes need about six."""

_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(rf"(?<![\w-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{DEEPEST_TABLE}}}")
"""Dotted key with more parts than the deepest nesting: memory and time to parse it grow as the square of its length."""

SAME_LINE_NM = 1.0
"""Limit, in nm, on the difference between other programs' roundings of a spectral line."""

_LENS = "camera.lens"
_TOO_DEEP = "tables or lists are nested too deeply"

LIBRARY = "lib:"
"""Prefix that names a lens of the library, in place of a path."""


def load(path: str | Path) -> Scene:
    """Read a scene file.

    Parameters
    ----------
    path : str or Path
        A TOML file. Relative paths in it start from its folder.

    Returns
    -------
    Scene

    Raises
    ------
    SceneError
        The file cannot be read, is not TOML (with line and column), or is not a valid scene. The message has one line
        per fault: its path in the file, the value, and valid values. Missing meshes, textures and lens files are
        faults.
    """
    path = Path(path)
    data = _read(path)
    _refuse_other_kind("scene", data, path)
    return _scene(data, path.resolve().parent, str(path)).titled(path.stem)


def loads(text: str, folder: str | Path = ".") -> Scene:
    """Read a scene from TOML text. Relative paths start from `folder`.

    Parameters
    ----------
    text : str
    folder : str or Path

    Returns
    -------
    Scene

    Raises
    ------
    SceneError
        As `load`.
    """
    return _scene(_parse(text, "scene"), Path(folder).resolve(), "scene")


def load_lens(path: str | Path, choices: FileChoices = AS_IT_STANDS) -> Lens:
    """Read a lens from a TOML file with the keys of `[camera.lens]` at its top level, or from another program's file.

    Parameters
    ----------
    path : str or Path
        A `.toml`, `.zmx`, `.seq`, `.len`, `.json` or `.csv` file, or "lib:" and the name of a library lens.
    choices : FileChoices
        Options for reading another program's file.

    Raises
    ------
    SceneError
        As in `load`, or another program's file holds something that a lens cannot have.
    """
    path = _lens_path(str(path), Path())
    if reader := reader_of(path):
        return reader(path, choices)[0]
    data = _own_table(path, choices)
    _refuse_other_kind("lens", data, path)
    try:
        return Lens.model_validate(data)
    except ValidationError as error:
        raise _refused(str(path), fault_lines(error, data)) from None


def with_lens_file(lens: Lens, folder: Path) -> Lens:
    """Return a lens with its `file` replaced by the file's contents.

    A stop size, names, poses, coatings and object medium given beside the file take precedence.
    """
    if lens.file is None:
        return lens
    held = load_lens(_lens_path(lens.file, folder), _choices_in(folder, lens))
    beside = {key: value for key in ("name", "source", "object_medium") if (value := getattr(lens, key)) is not None}
    if lens.stop_size:
        beside |= {key: getattr(lens, key) for key in STOP_SIZES}
    if lens.elements:
        beside["elements"] = lens.elements
    if lens.coatings:
        beside["coatings"] = {**held.coatings, **lens.coatings}
    return Lens(**{**held.model_dump(), **beside})


def _read(path: Path) -> dict[str, Any]:
    if why := path_fault(str(path)):
        raise SceneError(f"{shown_path(path)}: {why}")
    try:
        return _parse(read_text(path), str(path))
    except OSError as error:
        raise SceneError(f"{shown_path(path)}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise SceneError(f"{path}: byte {error.start} is not UTF-8; a TOML file must be UTF-8 text") from None


def read_text(path: Path) -> str:
    """Return the text of a TOML file in UTF-8.

    Raises
    ------
    OSError
        The file cannot be read.
    SceneError
        The file has more than `MOST_BYTES`, or never ends, as a device does.
    UnicodeDecodeError
    """
    with open_regular(path) as file:
        data = file.read(MOST_BYTES + 1)
    if len(data) > MOST_BYTES:
        raise SceneError(
            f"{shown_path(path)}: larger than {MOST_BYTES // 1_000_000} MB, too large for a TOML file of lfmesh"
        )
    return data.decode("utf-8")


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML text; a leading byte order mark is ignored.

    Raises
    ------
    TOMLDecodeError
        A subclass of ValueError.
    RecursionError
        Tables are nested too deep, or a dotted key has too many parts.
    ValueError
        An integer has thousands of digits, or a date is impossible.
    """
    if _LONG_KEY.search(text):
        raise RecursionError(_TOO_DEEP)
    return tomllib.loads(text.removeprefix(MARK))


def _refuse_other_kind(wanted: FileKind, data: dict[str, Any], path: Path) -> None:
    if words := mistaken_for(wanted, data):
        raise SceneError(f"{path}: {words}")


def _parse(text: str, name: str) -> dict[str, Any]:
    try:
        data = parse_toml(text)
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"{name}: not valid TOML: {error}") from None
    except RecursionError:
        raise SceneError(f"{name}: {_TOO_DEEP}") from None
    except ValueError:
        # Python refuses integers of more than about 4,300 digits and impossible dates.
        raise SceneError(f"{name}: contains an integer of thousands of digits, or an impossible date or time") from None
    _check_bounds(data, name)
    return data


def _check_bounds(data: dict[str, Any], name: str) -> None:
    """Refuse nesting and integers that no validator or message can handle; iterative, to survive deep nesting.

    Raises
    ------
    SceneError
        With the path of the fault.
    """
    level: list[tuple[tuple[str | int, ...], Any]] = [((), data)]
    for _ in range(DEEPEST_TABLE):
        inside: list[tuple[tuple[str | int, ...], Any]] = []
        for where, value in level:
            if isinstance(value, dict):
                inside += [((*where, key), item) for key, item in value.items()]
            elif isinstance(value, list):
                inside += [((*where, number), item) for number, item in enumerate(value)]
            elif isinstance(value, int) and value.bit_length() > LONGEST_BITS:
                raise SceneError(f"{name}: {format_path(where)} = {literal(value)}: too large for any value of a scene")
        level = inside
        if not level:
            return
    raise SceneError(f"{name}: {format_path(level[0][0][:3])}: {_TOO_DEEP}")


def _scene(data: dict[str, Any], folder: Path, name: str) -> Scene:
    lens_table = _lens_with_file(data)
    lens_faults, origin, wavelengths_nm = _inline_lens(data, folder)
    gltf, gltf_faults = take_keys(data, folder)
    try:
        scene = Scene.model_validate(data, context={"folder": folder})
    except ValidationError as error:
        faults = fault_lines(error, data, origin=origin)
        if lens_faults:
            faults = lens_faults + [line for line in faults if not line.startswith(f"{_LENS}.surfaces: missing")]
        raise _refused(name, gltf_faults + faults) from None
    if lens_faults or gltf_faults:
        raise _refused(name, lens_faults + gltf_faults)
    scene = scene.in_folder(folder)
    scene._lens_table = lens_table
    if wavelengths_nm and lens_table is not None:
        _warn_of_other_light(scene, str(lens_table["file"]), wavelengths_nm)
    if gltf is None:
        return scene
    try:
        return gltf_reader()(scene, gltf)
    except LfmeshError as error:
        raise _refused(name, str(error).split("\n")) from None


def _warn_of_other_light(scene: Scene, file: str, wavelengths_nm: tuple[float, ...]) -> None:
    """Warn if a scene without wavelengths of its own is traced at another one than its lens file's primary."""
    chosen = scene.camera.sensor.bands is not None or "wavelengths_nm" in scene.transport.model_fields_set
    if chosen or abs(wavelengths_nm[0] - scene.primary_nm) <= SAME_LINE_NM:
        return
    lines = ", ".join(f"{line:.10g}" for line in sorted(wavelengths_nm))
    warnings.warn(
        f"{file}: its primary wavelength is {wavelengths_nm[0]:.10g} nm, but the scene names none and is traced at "
        f"{scene.primary_nm:g} nm; for the file's wavelengths give transport.wavelengths_nm = [{lines}]",
        LensFileWarning,
        stacklevel=2,
    )


def _lens_with_file(data: dict[str, Any]) -> dict[str, Any] | None:
    """Return a copy of the lens table if it names a file."""
    camera = data.get("camera")
    lens = camera.get("lens") if isinstance(camera, dict) else None
    return dict(lens) if isinstance(lens, dict) and isinstance(lens.get("file"), str) else None


def _inline_lens(data: dict[str, Any], folder: Path) -> tuple[list[str], dict[str, str], tuple[float, ...]]:
    """Put the contents of a lens file into the scene's unchecked tables.

    Returns
    -------
    faults : list of str
        Reasons why the file could not be read.
    origin : dict
        File that each path of the scene now comes from.
    wavelengths_nm : tuple of float
        Wavelengths of another program's file, the primary one first.
    """
    camera = data.get("camera")
    lens = camera.get("lens") if isinstance(camera, dict) else None
    if not isinstance(lens, dict) or not isinstance(lens.get("file"), str) or "surfaces" in lens:
        return [], {}, ()
    file = lens.pop("file")
    chosen = {key: lens.pop(key) for key in FILE_CHOICES if key in lens}
    try:
        choices = _choices_in(folder, Lens(file=file, **chosen))
    except SceneError as error:
        return [f"{_LENS}: {error}"], {}, ()
    try:
        held, wavelengths_nm = _lens_table(_lens_path(file, folder), choices)
    except SceneError as error:
        return [f"{_LENS}.file = {literal(file)}: {error}"], {}, ()
    if "file" in held:
        return [f"{_LENS}.file = {literal(file)}: a lens file has its own surfaces and must not name another"], {}, ()
    if any(key in lens for key in STOP_SIZES):
        held = {key: value for key, value in held.items() if key not in STOP_SIZES}
    if isinstance(lens.get("coatings"), dict):
        lens["coatings"] = {**held.get("coatings", {}), **lens["coatings"]}
    camera["lens"] = {**held, **lens}  # type: ignore[index]
    return [], {f"{_LENS}.surfaces": file}, wavelengths_nm


def _choices_in(folder: Path, lens: Lens) -> FileChoices:
    """Return the file choices of a lens, with paths relative to a folder."""
    choices = lens.file_choices
    given = choices.coating_file
    coatings = None if given is None else str(folder / given)
    gradients = tuple(str(folder / file) for file in choices.gradient_files)
    return replace(choices, coating_file=coatings, gradient_files=gradients)


def _lens_path(file: str, folder: Path) -> Path:
    """Return the path of a lens file or of a library lens."""
    if not file.startswith(LIBRARY):
        return folder / file
    name = file.removeprefix(LIBRARY).strip()
    known = _library()
    if name not in known:
        raise SceneError(f"no lens {file!r}{nearest(name, known)}; lfmesh lens list shows the library")
    return known[name]


def library() -> list[str]:
    """Return the names of the library's lenses, without "lib:"."""
    return sorted(_library())


def _library() -> dict[str, Path]:
    """Return the files of the library: the lenses of the examples and of the catalogue."""
    try:
        return {path.stem: path for path in asset_path("lenses").rglob("*.toml")}
    except FileError as error:
        raise SceneError(str(error)) from None


def _lens_table(path: Path, choices: FileChoices) -> tuple[dict[str, Any], tuple[float, ...]]:
    """Return the keys of any lens file and, if it is another program's, its wavelengths in nm."""
    if reader := reader_of(path):
        # Tables without defaults, except for the kinds of their parts.
        from lfmesh.scene import toml

        lens, wavelengths_nm = reader(path, choices)
        return toml.table(lens), wavelengths_nm
    return _own_table(path, choices), ()


def _own_table(path: Path, choices: FileChoices) -> dict[str, Any]:
    """Return the keys of a lens in TOML, which has no file choices."""
    for key in choices.given():
        raise SceneError(f"{path}: {key} can be chosen for {', '.join(endings())} files only")
    try:
        table = _read(path)
    except SceneError as error:
        raise SceneError(f"{error}{_in_library(path)}") from None
    return with_grids_beside(with_tables_beside(table, path.parent), path.parent)


def _in_library(path: Path) -> str:
    """Return a hint to the lens of the library that a missing file names, or ""."""
    with suppress(OSError, ValueError):
        path.stat()
        return ""
    known = _library()
    if path.stem in known:
        return f'; the library has this lens: file = "{LIBRARY}{path.stem}"'
    if "assets" not in path.parts:
        return ""
    return f'; lenses that come with lfmesh are "{LIBRARY}NAME"{nearest(path.stem, known)}, see lfmesh lens list'


def _refused(name: str, faults: list[str]) -> SceneError:
    if len(faults) == 1:
        return SceneError(f"{name}: {faults[0]}")
    return SceneError("\n".join([f"{name}: {len(faults)} faults", *(f"  {line}" for line in listed(faults))]))
