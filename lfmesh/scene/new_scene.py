"""A scene to start from: a camera of the library, on request with another lens and with a mesh in front of it.

The library's file is edited table by table, so that its comments stay.
"""

import math
import os
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from lfmesh.errors import LfmeshError, SceneError
from lfmesh.scene.camera_library import library_camera
from lfmesh.scene.files import LIBRARY, loads
from lfmesh.scene.first_order.compute import facts_of_solved
from lfmesh.scene.first_order.focused import in_focus_distance_mm
from lfmesh.scene.first_order.report import FirstOrder
from lfmesh.scene.first_order.solve import solved
from lfmesh.scene.literals import literal, shown_path
from lfmesh.scene.objects.refractor import UNITS_MISSING

_TABLE = re.compile(r"\[+([\w.]+)\]+")
_DISTANCE = re.compile(r"^distance_mm = .*$", flags=re.MULTILINE)
_VERSION = re.compile(r"^schema_version\b", flags=re.MULTILINE)
_LENS, _ARRAY = "camera.lens", "camera.mla"
_OBJECTS = ("targets", "particles", "media", "tanks", "lights")
"""Tables that a mesh and its lamp replace."""

Tables = list[tuple[str, str]]
"""Tables of a scene file in order: dotted name, and text with the comment above. The first has no name."""


def new_scene(name: str, folder: Path, *, lens: str | None = None, target: Path | None = None) -> str:
    """Return the text of a scene with a camera of the library.

    Another lens keeps the plane in focus and the f-number at the array. A mesh takes the place of all objects and
    lamps: it stands in the plane in focus, with a lamp above it.

    Parameters
    ----------
    name : str
        Camera of the library.
    folder : Path
        Folder of the scene file; its paths are relative to it.
    lens : str, optional
        Lens file, or "lib:" and the name of a library lens.
    target : Path, optional
        Mesh file.

    Returns
    -------
    str
        TOML that loads as a scene.

    Raises
    ------
    SceneError
        There is no such camera, or the scene with this lens or mesh has a fault.
    """
    text = library_camera(name).text
    facts = _facts(text, folder)
    if lens is not None:
        with _blamed_on("--lens", lens):
            text = _with_lens(text, facts, lens, folder)
    if target is not None:
        with _blamed_on("--target", target):
            text = _with_target(text, facts, target, folder)
            loads(text, folder)
    return text


def _facts(text: str, folder: Path) -> FirstOrder:
    """Return the first-order optics of a scene, without warnings, which take a second."""
    return facts_of_solved(solved(loads(text, folder)))


@contextmanager
def _blamed_on(option: str, value: object) -> Iterator[None]:
    """Name an option in errors of the scene that it makes."""
    try:
        yield
    except LfmeshError as error:
        raise SceneError(f"{option} {shown_path(value)}: {error}") from None


def _with_lens(text: str, facts: FirstOrder, lens: str, folder: Path) -> str:
    """Return a scene with another lens, of the same plane in focus and f-number at the array."""
    file = lens if lens.startswith(LIBRARY) else _relative(Path(lens), folder)

    def stopped(text: str, f_number: float) -> str:
        stop = f"f_number = {f_number:.6g}"
        table = (
            f"[{_LENS}]                    # in place of the published camera's\n"
            f"file = {literal(file)}\n"
            f"{stop:<32} # f/{facts.working_f_number:.3g} at the array, as the published camera\n\n"
        )
        return _joined(_replaced(_tables(text), (_LENS,), table))

    f_number = facts.efl_mm / facts.entrance_pupil_diameter_mm
    text = stopped(text, f_number)
    if facts.focused:
        ready = solved(loads(text, folder))
        focus = facts.object_distance_mm
        distance = in_focus_distance_mm(ready.camera, ready.primary_nm, facts.focused, focus)
        place = f"distance_mm = {distance:.6g}"
        place = f"{place:<32} # from the last vertex: the plane in focus is the published camera's"
        text = _joined((name, _DISTANCE.sub(place, each) if name == _ARRAY else each) for name, each in _tables(text))
    found = _facts(text, folder)
    text = stopped(text, f_number * facts.working_f_number / found.working_f_number)
    note = f"#\n# The lens is {shown_path(lens)}: figures of the source that depend on the lens do not hold.\n"
    return _VERSION.sub(lambda found: note + found[0], text, count=1)


def _with_target(text: str, published: FirstOrder, target: Path, folder: Path) -> str:
    """Return a scene with a mesh in the plane in focus and a lamp, in place of its objects."""
    facts = _facts(text, folder)
    distance = facts.object_distance_mm
    if not 0.0 < distance < math.inf:
        distance = published.object_distance_mm
    width, height = facts.field.size_mm(-distance)
    lines = [
        f"[[targets]]                      # in the plane in focus; field of view: {width:.3g} mm x {height:.3g} mm",
        f"name = {literal(target.stem)}",
        f"file = {literal(_relative(target, folder))}",
    ]
    bare = target.suffix.lower() in UNITS_MISSING
    if bare:
        lines.append('units = "mm"                     # of the file\'s coordinates: um, mm, cm, m, inch or foot')
    lines += [
        'anchor = "centre"                # point of the mesh at position_mm: centre of its box, "base" or "origin"',
        f"position_mm = [0.0, 0.0, {-distance:.6g}]",
        "rotation_deg = [0.0, 0.0, 0.0]   # about x, then y, then z",
    ]
    if bare:
        lines += ["[targets.material]", "reflectance = 0.6                # share of the light that is scattered, 0..1"]
    lamp = ", ".join(f"{share * distance:.4g}" for share in (-0.3, 0.5, -0.5))
    power = f"power_w = {10.0 * (distance / 500.0) ** 2:.3g}"
    lines += [
        "",
        "[[lights]]                       # high on the left, halfway to the target",
        'kind = "point"',
        f"position_mm = [{lamp}]",
        f"{power:<32} # over the whole sphere",
        "",
        "",
    ]
    return _joined(_replaced(_tables(text), _OBJECTS, "\n".join(lines)))


def _relative(file: Path, folder: Path) -> str:
    """Return the path of a file from a folder, or its full path if they share no root."""
    try:
        return Path(os.path.relpath(file, folder)).as_posix()
    except ValueError:
        return file.resolve().as_posix()


def _tables(text: str) -> Tables:
    """Return the tables of a scene file."""
    tables: list[tuple[str, list[str]]] = [("", [])]
    comment: list[str] = []
    for line in text.splitlines(keepends=True):
        if line.startswith("#"):
            comment.append(line)
            continue
        if found := _TABLE.match(line):
            tables.append((found[1], []))
        tables[-1][1].extend([*comment, line])
        comment = []
    tables[-1][1].extend(comment)
    return [(name, "".join(lines)) for name, lines in tables]


def _replaced(tables: Tables, names: tuple[str, ...], text: str) -> Tables:
    """Return tables with new text in place of the named ones and of the tables inside them."""
    is_old = [any(name == each or name.startswith(f"{each}.") for each in names) for name, _ in tables]
    first = is_old.index(True)
    kept = [table for table, old in zip(tables, is_old, strict=True) if not old]
    return [*kept[:first], (names[0], text), *kept[first:]]


def _joined(tables: Iterable[tuple[str, str]]) -> str:
    return "".join(text for _, text in tables)
