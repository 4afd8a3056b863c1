"""Program that opens one STEP or 3MF file; `cad_file` runs it as a separate process with resource limits.

It imports nothing from lfmesh, and reports errors in the file as one line on standard error.
"""

import io
import json
import posixpath
import re
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MODEL_TYPE = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
"""Relationship of a 3MF package to its model part (3MF Core Specification 1.3, appendix C)."""

MM_PER_UNIT = {"micron": 1e-3, "millimeter": 1.0, "centimeter": 10.0, "meter": 1e3, "inch": 25.4, "foot": 304.8}
"""Values of a 3MF model's unit (section 3.4)."""

PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
MATERIALS = "http://schemas.microsoft.com/3dmanufacturing/material/2015/02"
EXTENSIONS = (PRODUCTION, MATERIALS)
"""Extensions that a 3MF model may require: objects in further parts, colours, pictures."""

MOST_MODEL_BYTES = 2**28
"""Limit for all models of a 3MF file, unpacked."""

MOST_PLACED_FACETS = 3_000_000
"""Limit for all bodies of a 3MF model, counted once per instance."""

DEEPEST, MOST_PLACED = 50, 100_000
"""Limits of a 3MF file for the nesting of components, and for objects, counted once per instance."""

FINEST_MM = 1e-6
"""Finest tolerance: above OpenCASCADE's own precision of 1e-7 mm."""

GRACE_SECONDS = 60
"""CPU time after the limit within which the limit's signal ends the process."""

TURN_RAD = 0.1
"""Largest turn of a facet's edge on a curved face."""

COARSE_MM = 1e12
"""Tolerance of the first mesh, which yields the size of the bodies."""

DEFAULT_TOLERANCE = 3e-4
"""Default tolerance over the diagonal of the largest body's box. Much finer facets of glass are slivers, which float32
tilts."""

_STRINGS_AND_COMMENTS = re.compile(rb"'(?:[^']|'')*'|/\*.*?\*/", re.DOTALL)
_DEFINED = re.compile(rb"#\s*(\d+)\s*=")
_NAMED = re.compile(rb"#\s*(\d+)")


class UnusableError(Exception):
    """An error in the file, in one line."""


def _limit(mebibytes: int, seconds: int, output_mebibytes: int) -> None:
    """Limit this process's memory, CPU time and written files, if the system can."""
    try:
        import resource
    except ImportError:
        return
    for what, most in (
        (resource.RLIMIT_AS, mebibytes * 2**20),
        (resource.RLIMIT_FSIZE, output_mebibytes * 2**20),
        (resource.RLIMIT_CORE, 0),
    ):
        resource.setrlimit(what, (most, most))
    # At the soft limit the process gets SIGXCPU; at the hard one SIGKILL, as when the system is out of memory.
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + GRACE_SECONDS))


def check_step(content: bytes) -> None:
    """Raise on errors that OpenCASCADE ignores: not a STEP file, a truncated file, or undefined entities."""
    if not content.lstrip().startswith(b"ISO-10303-21;"):
        raise UnusableError("broken, or not a STEP file: it does not begin with ISO-10303-21;")
    if not content.rstrip().endswith(b"END-ISO-10303-21;"):
        raise UnusableError("cut short: it does not end with END-ISO-10303-21;")
    bare = _STRINGS_AND_COMMENTS.sub(b"''", content)
    defined = set(map(int, _DEFINED.findall(bare)))
    missing = sorted(set(map(int, _NAMED.findall(bare))) - defined)
    if missing:
        entities = "entity is" if len(missing) == 1 else "entities are"
        raise UnusableError(f"broken: {len(missing)} {entities} named but missing, the first is #{missing[0]}")


def step_to_glb(content: bytes, tolerance_mm: float | None, factor: float = 1.0) -> bytes:
    """Convert the bodies of a STEP file to a GLB file that also lists the surfaces of their faces.

    Parameters
    ----------
    content : bytes
    tolerance_mm : float, optional
        Largest distance of a facet from its surface. Default: from the size of the bodies.
    factor : float
        Factor on the tolerance and on the turn of an edge.
    """
    import cascadio

    def meshed(tolerance: float) -> bytes:
        made: bytes = cascadio.load(
            content,
            "step",
            tol_linear=tolerance,
            tol_angular=min(TURN_RAD * factor, 1.0),
            use_parallel=False,
            include_brep=True,
        )
        if not made:
            raise UnusableError("broken, or not a STEP file: OpenCASCADE finds no body in it")
        return made

    if tolerance_mm is None:
        tolerance_mm = max(DEFAULT_TOLERANCE * _diagonal_mm(meshed(COARSE_MM)), FINEST_MM)
    if tolerance_mm < FINEST_MM:
        raise UnusableError(f"tolerance_mm = {tolerance_mm:g} is finer than the limit of {FINEST_MM:g}")
    return meshed(tolerance_mm * factor)


def _diagonal_mm(glb: bytes) -> float:
    """Return the diagonal of the largest mesh box in a GLB file, mm."""
    document = json.loads(glb[20 : 20 + int.from_bytes(glb[12:16], "little")])
    boxes = [(entry["min"], entry["max"]) for entry in document.get("accessors", []) if len(entry.get("max", [])) == 3]
    sizes = [1e3 * float(np.linalg.norm(np.subtract(high, low))) for low, high in boxes]
    if not sizes or not max(sizes) > 0.0:
        raise UnusableError("holds no body with facets")
    return max(sizes)


Key3mf = tuple[str, str]
"""Key of an object: part of the package, and number in it."""


class Object3mf(NamedTuple):
    """An object of a 3MF model: facets with corner colours, or other objects with their transforms.

    Colours are sRGB codes, NaN if a facet has none.
    """

    name: str
    vertices: Array
    faces: NDArray[np.int64]
    colours: Array | None  # (m, 3, 3)
    parts: list[tuple[Key3mf, Array]]  # transforms (4, 3)


class _Package:
    """The models of a 3MF package, each read once, with notes on the parts left out."""

    def __init__(self, package: zipfile.ZipFile) -> None:
        self.package = package
        self.root = _model_part(package)
        self.objects: dict[Key3mf, Object3mf] = {}
        self.notes: dict[str, None] = {}
        self._models: dict[str, ElementTree.Element] = {}
        self._unpacked = 0

    def model(self, part: str) -> ElementTree.Element:
        """Return a model, after its objects have been read."""
        if part not in self._models:
            content = _unpacked(self.package, part)
            self._unpacked += len(content)
            if self._unpacked > MOST_MODEL_BYTES:
                raise UnusableError(f"its models unpack to more than the limit of {MOST_MODEL_BYTES // 2**20} MiB")
            root = ElementTree.fromstring(content)
            if _tag(root) != "model":
                raise UnusableError(f"broken: its model begins with <{_tag(root)[:40]}>; valid is <model>")
            _check_extensions(root, content)
            self._models[part] = root
            colours = _Colours(root, self.notes)
            for each in (each for each in root.iter() if _tag(each) == "object"):
                self.objects[part, _need(each, "id")] = _object(each, part, colours)
        return self._models[part]

    def object(self, key: Key3mf) -> Object3mf:
        """Return an object, reading its model if needed."""
        self.model(key[0])
        if key not in self.objects:
            raise UnusableError(f"broken: its model names object {key[1][:40]!r}, which is missing")
        return self.objects[key]


def _check_extensions(root: ElementTree.Element, content: bytes) -> None:
    """Raise if a model requires an unsupported extension."""
    needed = root.get("requiredextensions", "").split()
    if not needed:
        return
    prefixes: dict[str, str] = {}
    for event, told in ElementTree.iterparse(io.BytesIO(content), events=("start-ns", "start")):
        if event == "start":
            break
        prefixes.setdefault(*told)
    for prefix in needed:
        if (name := prefixes.get(prefix, prefix)) not in EXTENSIONS:
            raise UnusableError(f"needs the extension {name[:100]!r} of 3MF, which is not read; export it without")


def read_3mf(path: Path) -> dict[str, Any]:
    """Return the bodies of a 3MF file in mm: names, and vertices, facets and colours of each.

    Raises
    ------
    UnusableError
        The package or its model is broken, larger than the limits, or needs an unsupported extension.
    """
    try:
        with zipfile.ZipFile(path) as package:
            return _read_package(_Package(package))
    except (UnusableError, MemoryError):
        raise
    except Exception as error:  # a broken file may raise anything inside zipfile, the XML parser and numpy
        reason = f"{error}".splitlines()[0] if str(error) else type(error).__name__
        raise UnusableError(f"broken, or not a 3MF file ({reason})") from None


def _read_package(package: _Package) -> dict[str, Any]:
    root = package.model(package.root)
    unit = root.get("unit", "millimeter")
    if unit not in MM_PER_UNIT:
        raise UnusableError(f"its unit is {unit[:40]!r}; valid are {', '.join(MM_PER_UNIT)}")
    build = _Build(package)
    for item in (each for each in root.iter() if _tag(each) == "item"):
        build.place(_named(item, package.root), _transform(item))
    arrays: dict[str, Any] = {
        "names": np.array([body[0] for body in build.bodies], dtype=np.str_),
        "notes": np.array(list(package.notes), dtype=np.str_),
    }
    for k, (_, vertices, faces, colours) in enumerate(build.bodies):
        arrays |= {f"vertices_{k}": vertices * MM_PER_UNIT[unit], f"faces_{k}": faces}
        if colours is not None:
            arrays[f"colours_{k}"] = colours
    return arrays


def _named(element: ElementTree.Element, part: str) -> Key3mf:
    """Return the key of the object that an item or component refers to, in its own model or another part."""
    path = element.get(f"{{{PRODUCTION}}}path")
    return (part if path is None else posixpath.normpath(path).lstrip("/"), _need(element, "objectid"))


class _Colours:
    """Colours of a 3MF model by group and number (Core Specification 1.3, section 5; Materials, 2)."""

    def __init__(self, root: ElementTree.Element, notes: dict[str, None]) -> None:
        self.groups: dict[str, Array] = {}
        self.notes = notes
        for group in root.iter():
            key = {"basematerials": "displaycolor", "colorgroup": "color"}.get(_tag(group))
            if key is not None:
                self.groups[_need(group, "id")] = np.array([_coded(_need(each, key)) for each in group]).reshape(-1, 3)
            elif _tag(group) in ("texture2dgroup", "compositematerials", "multiproperties"):
                self.notes[f"its <{_tag(group)}> are left out: its facets have the scene's material"] = None

    def of(self, used: list[tuple[str | None, ...]], default: tuple[str | None, str | None]) -> Array | None:
        """Return the colours (m, 3, 3) of facets by their pid, p1, p2 and p3; None if none has one.

        Parameters
        ----------
        used : list of tuple
        default : (str or None, str or None)
            Group and number of the object.
        """
        known: dict[tuple[str | None, ...], Array] = {}
        for each in dict.fromkeys(used):
            group, *places = each
            group = group if group is not None else default[0]
            table = self.groups.get(group or "")
            first = places[0] if places[0] is not None else default[1]
            if table is None or first is None:
                known[each] = np.full((3, 3), np.nan)
                continue
            chosen = [int(place if place is not None else first) for place in places]
            if not all(0 <= number < len(table) for number in chosen):
                raise UnusableError(f"broken: a triangle names a colour beyond the {len(table)} of its group")
            known[each] = table[chosen]
        if all(np.isnan(colour).all() for colour in known.values()):
            return None
        return np.array([known[each] for each in used])


def _coded(text: str) -> list[float]:
    """Return red, green and blue, 0 to 1, of a colour such as #FF8000 or #FF8000FF."""
    if not re.fullmatch(r"#(?:[0-9a-fA-F]{6}|[0-9a-fA-F]{8})", text.strip()):
        raise UnusableError(f"broken: a colour of its model is {text[:40]!r}; valid are such as #FF8000")
    return [int(text.strip()[place : place + 2], 16) / 255.0 for place in (1, 3, 5)]


def _model_part(package: zipfile.ZipFile) -> str:
    """Return the name of a package's model from its relationships."""
    if "_rels/.rels" not in package.namelist():
        raise UnusableError("broken, or not a 3MF file: the package has no _rels/.rels")
    for each in ElementTree.fromstring(_unpacked(package, "_rels/.rels")).iter():
        if each.get("Type") == MODEL_TYPE:
            return _need(each, "Target").lstrip("/")
    raise UnusableError("broken, or not a 3MF file: the package names no 3D model")


def _unpacked(package: zipfile.ZipFile, name: str) -> bytes:
    """Return a part of the package, refusing more than `MOST_MODEL_BYTES`, whatever its header says."""
    if name not in package.namelist():
        raise UnusableError(f"broken: its part {name[:80]!r} is missing")
    with package.open(name) as part:
        content = part.read(MOST_MODEL_BYTES + 1)
    if len(content) > MOST_MODEL_BYTES:
        raise UnusableError(f"its part {name[:80]!r} unpacks to more than the limit of {MOST_MODEL_BYTES // 2**20} MiB")
    return content


def _tag(element: ElementTree.Element) -> str:
    return element.tag.rsplit("}", 1)[-1]


def _need(element: ElementTree.Element, key: str) -> str:
    value = element.get(key)
    if value is None:
        raise UnusableError(f"broken: a <{_tag(element)[:40]}> of its model has no {key}")
    return value


def _numbers(values: list[str | None], of: Callable[[str], float], what: str) -> list[float]:
    try:
        return [of(value or "") for value in values]
    except (ValueError, OverflowError):
        raise UnusableError(f"broken: {what} of its model is not a number: {str(values)[:80]}") from None


def _transform(element: ElementTree.Element) -> Array:
    """Return the affine transform (4, 3) of an item or component; points are rows (section 3.3)."""
    text = element.get("transform", "1 0 0 0 1 0 0 0 1 0 0 0").split()
    if len(text) != 12:
        raise UnusableError(f"broken: a transform of its model has {len(text)} numbers; valid are 12")
    return np.array(_numbers(list(text), float, "a transform")).reshape(4, 3)


def _object(element: ElementTree.Element, part: str, colours: _Colours) -> Object3mf:
    """Return an object of a model; refuse facets with undefined vertices."""
    points: list[list[float]] = []
    corners: list[list[float]] = []
    used: list[tuple[str | None, ...]] = []
    parts: list[tuple[Key3mf, Array]] = []
    for each in element.iter():
        tag = _tag(each)
        if tag == "vertex":
            points.append(_numbers([each.get(key) for key in "xyz"], float, "a vertex"))
        elif tag == "triangle":
            corners.append(_numbers([each.get(key) for key in ("v1", "v2", "v3")], int, "a triangle"))
            used.append(tuple(each.get(key) for key in ("pid", "p1", "p2", "p3")))
        elif tag == "component":
            parts.append((_named(each, part), _transform(each)))
    faces = np.array(corners, dtype=np.int64).reshape(-1, 3)
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(points):
        raise UnusableError(f"broken: a triangle names a vertex beyond the {len(points)} of its object")
    name = element.get("name") or _need(element, "id")
    try:
        of_facets = colours.of(used, (element.get("pid"), element.get("pindex"))) if used else None
    except ValueError:
        raise UnusableError("broken: the number of a colour of its model is not a number") from None
    return Object3mf(name, np.array(points, dtype=np.float64).reshape(-1, 3), faces, of_facets, parts)


class _Build:
    """The placed bodies of a 3MF file: name, vertices, facets and colours of each."""

    def __init__(self, package: _Package) -> None:
        self.package = package
        self.bodies: list[tuple[str, Array, NDArray[np.int64], Array | None]] = []
        self.placed = self.facets = 0

    def place(self, key: Key3mf, place: Array, name: str | None = None, depth: int = 0) -> None:
        """Add an object and its components.

        Parameters
        ----------
        key : (str, str)
        place : (4, 3) float64
            Affine transform of points as rows.
        name : str, optional
            Name of the object that it is a component of.
        depth : int
            Nesting of components.
        """
        one = self.package.object(key)
        self.placed += 1
        self.facets += len(one.faces)
        if depth > DEEPEST:
            raise UnusableError(f"its components are nested more than {DEEPEST} deep, as in a loop")
        if self.placed > MOST_PLACED or self.facets > MOST_PLACED_FACETS:
            raise UnusableError(
                f"has more than {MOST_PLACED} objects or {MOST_PLACED_FACETS} facets, counted as placed"
            )
        name = name or one.name
        if len(one.faces):
            turned = slice(None, None, -1 if np.linalg.det(place[:3]) < 0.0 else 1)
            colours = one.colours[:, turned] if one.colours is not None else None
            self.bodies.append((name, one.vertices @ place[:3] + place[3], one.faces[:, turned], colours))
        for part, own in one.parts:
            self.place(part, np.vstack([own[:3] @ place[:3], own[3] @ place[:3] + place[3]]), name, depth + 1)


def main(arguments: list[str]) -> None:
    """Read `path` and write `out`: a GLB file for STEP, an npz file for 3MF.

    The arguments are path, out, tolerance in mm (0: default), a factor on it, and the limits: memory in MiB, output in
    MiB and seconds.
    """
    path, out, tolerance, factor = Path(arguments[0]), Path(arguments[1]), float(arguments[2]), float(arguments[3])
    memory, output, seconds = map(int, arguments[4:])
    _limit(memory, seconds, output)
    try:
        if path.suffix.lower() == ".3mf":
            with out.open("wb") as file:
                np.savez(file, **read_3mf(path))
        else:
            content = path.read_bytes()
            check_step(content)
            out.write_bytes(step_to_glb(content, tolerance or None, factor))
    except UnusableError as reason:
        sys.exit(f"unusable: {reason}")
    except MemoryError:
        sys.exit("unusable: memory")


if __name__ == "__main__":
    main(sys.argv[1:])
