"""Program that reads the surfaces in a STEP file; `cad_file` runs it as a separate process with resource limits.

It imports nothing from lfmesh, parses the entities of ISO 10303-21 and -42 itself, and writes the surfaces as JSON, in
mm. Unknown or non-standard entities are left out, so that no ray is traced through them.
"""

import json
import math
import re
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

MOST_READ_BYTES = 2**26
"""Largest file from which surfaces are read; larger ones are traced by their facets."""

MOST_SURFACES, MOST_POINTS = 20_000, 2_000_000
"""Most surfaces read, and most points in all their curves and nets."""

DEEPEST = 8
"""Most nested references, from a curve to the one that it is part of; this also ends cycles."""

SMALLEST = 1e-9
"""Smallest radius or weight: nothing smaller is a lens, and squares would leave float64's range."""

LARGEST = 1e9
"""Largest number of any kind, for the same reason."""

HIGHEST_DEGREE = 25
"""Highest degree of a B-spline."""

SI_PREFIXES = {
    ".KILO.": 1e6, ".HECTO.": 1e5, ".DECA.": 1e4, "$": 1e3, ".DECI.": 1e2, ".CENTI.": 10.0, ".MILLI.": 1.0,
    ".MICRO.": 1e-3, ".NANO.": 1e-6,
}  # fmt: skip
"""Millimetres per metre with each prefix."""

_STRINGS_AND_COMMENTS = re.compile(r"'(?:[^']|'')*'|/\*.*?\*/", re.DOTALL)
_ENTITY = re.compile(r"#\s*(\d+)\s*=([^;]*);")
_SURFACE = re.compile(
    r"^\s*(?:PLANE|SPHERICAL_SURFACE|CYLINDRICAL_SURFACE|TOROIDAL_SURFACE|SURFACE_OF_REVOLUTION|"
    r"SURFACE_OF_LINEAR_EXTRUSION|B_SPLINE_SURFACE_WITH_KNOTS)\s*\(|^\s*\(.*\bB_SPLINE_SURFACE\s*\(",
    re.DOTALL,
)
_TOKEN = re.compile(r"\s*([(),]|[^\s(),]+)")

Tree = Any
"""An entity's arguments: numbers, references and enumerations as text, and lists of these."""


class UnreadError(Exception):
    """An entity is non-standard or of an unsupported kind."""


class Entities:
    """The entities of a file, each parsed on request."""

    def __init__(self, content: str) -> None:
        self.text = {int(found[1]): found[2] for found in _ENTITY.finditer(_STRINGS_AND_COMMENTS.sub("''", content))}
        self.points = 0

    def parts(self, reference: Tree) -> dict[str, list[Tree]]:
        """Return the arguments of an entity by name: a simple entity has one name, a complex one several."""
        if not isinstance(reference, str) or not reference.startswith("#"):
            raise UnreadError
        text = self.text.get(int(reference[1:]) if reference[1:].isdigit() else -1)
        if text is None:
            raise UnreadError
        tree = _tree(text)
        # A complex entity's parts are enclosed in one more pair of brackets.
        words = tree[0] if len(tree) == 1 and isinstance(tree[0], list) else tree
        if len(words) % 2:
            raise UnreadError
        return {str(name): part for name, part in zip(words[::2], words[1::2], strict=True) if isinstance(part, list)}

    def simple(self, reference: Tree, name: str, least: int) -> list[Tree]:
        """Return the arguments of an entity, checking its name and their number.

        Parameters
        ----------
        reference : str
            As in the file: "#" and the entity's number.
        name : str
        least : int
        """
        found = self.parts(reference).get(name)
        if found is None or len(found) < least:
            raise UnreadError
        return found

    def triple(self, reference: Tree, name: str) -> list[float]:
        """Return the coordinates of a point or direction."""
        self.points += 1
        if self.points > MOST_POINTS:
            raise UnreadError
        values = self.simple(reference, name, 2)[1]
        if not isinstance(values, list) or len(values) != 3:
            raise UnreadError
        return [_number(value) for value in values]

    def direction(self, reference: Tree) -> list[float]:
        """Return a direction as a unit vector."""
        return _unit(self.triple(reference, "DIRECTION"))

    def placement(self, reference: Tree) -> tuple[list[float], list[float], list[float], list[float]]:
        """Return origin and axes x, y, z of a placement (ISO 10303-42, 4.4.12)."""
        _, origin, axis, first = self.simple(reference, "AXIS2_PLACEMENT_3D", 4)[:4]
        z = [0.0, 0.0, 1.0] if axis == "$" else self.direction(axis)
        if first == "$":
            first_axis = [1.0, 0.0, 0.0] if abs(z[0]) < 1.0 else [0.0, 1.0, 0.0]
        else:
            first_axis = self.direction(first)
        along = sum(a * b for a, b in zip(z, first_axis, strict=True))
        x = _unit([a - along * b for a, b in zip(first_axis, z, strict=True)])
        y = [z[1] * x[2] - z[2] * x[1], z[2] * x[0] - z[0] * x[2], z[0] * x[1] - z[1] * x[0]]
        return self.triple(origin, "CARTESIAN_POINT"), x, y, z


def _tree(text: str) -> list[Tree]:
    """Return an entity's text as nested lists of words."""
    stack: list[list[Tree]] = [[]]
    for found in _TOKEN.finditer(text):
        word = found[1]
        if word == "(":
            stack.append([])
        elif word == ")":
            if len(stack) == 1:
                raise UnreadError
            done = stack.pop()
            stack[-1].append(done)
        elif word != ",":
            stack[-1].append(word)
    if len(stack) != 1:
        raise UnreadError
    return stack[0]


def _number(word: Tree) -> float:
    try:
        value = float(word)
    except (TypeError, ValueError):
        raise UnreadError from None
    if not abs(value) <= LARGEST:
        raise UnreadError
    return value


def _positive(word: Tree) -> float:
    value = _number(word)
    if not SMALLEST <= value <= LARGEST:
        raise UnreadError
    return value


def _unit(vector: list[float]) -> list[float]:
    length = math.hypot(*vector)
    if not 0.0 < length < math.inf:
        raise UnreadError
    return [each / length for each in vector]


def _scaled(vector: list[float], mm: float) -> list[float]:
    return [mm * each for each in vector]


def mm_per_unit(entities: Entities) -> float:
    """Return the only length unit of a file's geometry, mm."""
    units = set()
    for text in entities.text.values():
        if "GLOBAL_UNIT_ASSIGNED_CONTEXT" in text:
            tree = _tree(text)
            words = tree[0] if len(tree) == 1 else tree
            for reference in words[words.index("GLOBAL_UNIT_ASSIGNED_CONTEXT") + 1][0]:
                if "LENGTH_UNIT" in (parts := entities.parts(reference)):
                    units.add(_length_unit_mm(entities, parts))
    if len(units) != 1:
        raise UnreadError
    return units.pop()


def _length_unit_mm(entities: Entities, parts: dict[str, list[Tree]], depth: int = 0) -> float:
    """Return a length unit in mm; inches are defined by another unit."""
    if "SI_UNIT" in parts:
        prefix = parts["SI_UNIT"][0]
        if prefix not in SI_PREFIXES or parts["SI_UNIT"][1] != ".METRE.":
            raise UnreadError
        return SI_PREFIXES[prefix]
    if depth > DEEPEST or "CONVERSION_BASED_UNIT" not in parts:
        raise UnreadError
    measure = next(iter(entities.parts(parts["CONVERSION_BASED_UNIT"][-1]).values()))
    words = [each for each in measure if each != "LENGTH_MEASURE"]
    return _positive(words[0][0]) * _length_unit_mm(entities, entities.parts(words[1]), depth + 1)


def _surface(entities: Entities, reference: str, mm: float) -> dict[str, Any]:
    """Return one surface, in mm."""
    parts = entities.parts(reference)
    if "B_SPLINE_SURFACE" in parts or "B_SPLINE_SURFACE_WITH_KNOTS" in parts:
        return _spline_surface(entities, parts, mm)
    name, words = next(iter(parts.items()))
    if name == "SURFACE_OF_LINEAR_EXTRUSION":
        along = entities.direction(entities.simple(words[2], "VECTOR", 2)[1])
        return {"kind": "extrusion", "axis": along, "curve": _curve(entities, words[1], mm)}
    if name == "SURFACE_OF_REVOLUTION":
        _, at, axis = entities.simple(words[2], "AXIS1_PLACEMENT", 3)[:3]
        z = [0.0, 0.0, 1.0] if axis == "$" else entities.direction(axis)
        place = _scaled(entities.triple(at, "CARTESIAN_POINT"), mm)
        return {"kind": "revolution", "at": place, "axis": z, "curve": _curve(entities, words[1], mm)}
    at_point, _, _, z = entities.placement(words[1])
    surface: dict[str, Any] = {"at": _scaled(at_point, mm), "axis": z}
    if name == "PLANE":
        return surface | {"kind": "plane"}
    surface["radius"] = mm * _positive(words[2])
    if name == "TOROIDAL_SURFACE":
        return surface | {"kind": "torus", "tube": mm * _positive(words[3])}
    return surface | {"kind": "sphere" if name == "SPHERICAL_SURFACE" else "cylinder"}


def _curve(entities: Entities, reference: Tree, mm: float, depth: int = 0) -> dict[str, Any]:
    """Return the generating curve, in mm; a part of a curve counts as the whole curve."""
    if depth > DEEPEST:
        raise UnreadError
    parts = entities.parts(reference)
    for name in ("TRIMMED_CURVE", "SURFACE_CURVE", "SEAM_CURVE"):
        if name in parts:
            return _curve(entities, parts[name][1], mm, depth + 1)
    if "B_SPLINE_CURVE" in parts or "B_SPLINE_CURVE_WITH_KNOTS" in parts:
        # In a simple entity, the words of both are in one list, after its name as text.
        words = parts.get("B_SPLINE_CURVE") or parts["B_SPLINE_CURVE_WITH_KNOTS"][1:]
        times, values = parts["B_SPLINE_CURVE_WITH_KNOTS"][-3:-1]
        points = [_scaled(entities.triple(each, "CARTESIAN_POINT"), mm) for each in words[1]]
        weights = [_positive(each) for each in parts.get("RATIONAL_B_SPLINE_CURVE", [["1"] * len(points)])[0]]
        degree = _degree(words[0])
        if len(weights) != len(points):
            raise UnreadError
        spline = {"points": points, "weights": weights, "degree": degree}
        return spline | {"kind": "spline", "knots": _knots(times, values, degree, len(points))}
    name, words = next(iter(parts.items()))
    if name == "LINE":
        along = entities.direction(entities.simple(words[2], "VECTOR", 2)[1])
        return {"kind": "line", "at": _scaled(entities.triple(words[1], "CARTESIAN_POINT"), mm), "x": along}
    if name not in ("CIRCLE", "ELLIPSE", "PARABOLA", "HYPERBOLA"):
        raise UnreadError
    at, x, y, _ = entities.placement(words[1])
    a = mm * _positive(words[2])
    b = mm * _positive(words[3]) if name in ("ELLIPSE", "HYPERBOLA") else a
    return {"kind": name.lower(), "at": _scaled(at, mm), "x": x, "y": y, "a": a, "b": b}


def _degree(word: Tree) -> int:
    degree = _number(word)
    if degree not in range(1, HIGHEST_DEGREE + 1):
        raise UnreadError
    return int(degree)


def _knots(multiplicities: Tree, values: Tree, degree: int, points: int) -> list[float]:
    """Return the knots of a B-spline, repeated by multiplicity."""
    times = [_number(each) for each in multiplicities]
    # Checked before repetition: a multiplicity of 1e9 would fill the memory.
    if any(each not in range(1, degree + 2) for each in times) or sum(times) != points + degree + 1:
        raise UnreadError
    knots = [value for each, n in zip(values, times, strict=True) for value in [_number(each)] * int(n)]
    if any(b < a for a, b in pairwise(knots)) or not knots[degree] < knots[points]:
        raise UnreadError
    return knots


def _weights(parts: dict[str, list[Tree]], points: list[list[list[float]]]) -> Tree:
    """Return the words of a net's weights, 1 if it has none."""
    if "RATIONAL_B_SPLINE_SURFACE" in parts:
        return parts["RATIONAL_B_SPLINE_SURFACE"][0]
    return [["1"] * len(row) for row in points]


def _spline_surface(entities: Entities, parts: dict[str, list[Tree]], mm: float) -> dict[str, Any]:
    words = parts.get("B_SPLINE_SURFACE") or parts["B_SPLINE_SURFACE_WITH_KNOTS"][1:]
    u_times, v_times, u_values, v_values = parts["B_SPLINE_SURFACE_WITH_KNOTS"][-5:-1]
    degrees = [_degree(each) for each in words[:2]]
    points = [[_scaled(entities.triple(each, "CARTESIAN_POINT"), mm) for each in row] for row in words[2]]
    weights = [[_positive(each) for each in row] for row in _weights(parts, points)]
    widths = {len(row) for row in points} | {len(row) for row in weights}
    if len(widths) != 1 or len(weights) != len(points):
        raise UnreadError
    knots = [_knots(u_times, u_values, degrees[0], len(points)), _knots(v_times, v_values, degrees[1], len(points[0]))]
    return {"kind": "net", "points": points, "weights": weights, "degrees": degrees, "knots": knots}


def surfaces_of(content: str) -> list[dict[str, Any]]:
    """Return the surfaces in the content of a STEP file, in mm, each in the frame of its body."""
    entities = Entities(content)
    try:
        mm = mm_per_unit(entities)
    except (UnreadError, LookupError, TypeError, ValueError):
        return []
    found = []
    for number, text in entities.text.items():
        if _SURFACE.search(text) is None:
            continue
        try:
            found.append(_surface(entities, f"#{number}", mm))
        except (UnreadError, LookupError, TypeError, ValueError):
            continue
        if len(found) == MOST_SURFACES:
            break
    return found


def main(arguments: list[str]) -> None:
    """Read `path` and write `out` as JSON.

    The arguments are path, out, and the limits: memory in MiB, output in MiB and seconds.
    """
    path, out, memory, output, seconds = Path(arguments[0]), Path(arguments[1]), *map(int, arguments[2:])
    try:
        import resource
    except ImportError:
        pass
    else:
        for what, most in (
            (resource.RLIMIT_AS, memory * 2**20),
            (resource.RLIMIT_CPU, seconds),
            (resource.RLIMIT_FSIZE, output * 2**20),
            (resource.RLIMIT_CORE, 0),
        ):
            resource.setrlimit(what, (most, most))
    if path.stat().st_size > MOST_READ_BYTES:
        sys.exit("too large")
    out.write_text(json.dumps(surfaces_of(path.read_text(encoding="latin-1"))))


if __name__ == "__main__":
    main(sys.argv[1:])
