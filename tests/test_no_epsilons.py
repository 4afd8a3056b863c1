"""No absolute epsilons: a length is never compared with, or moved by, a small number that knows nothing of the scene.

A small number in the geometry or the transport is either a factor of something that carries the scale, or a constant
with a name that is on the list below; the code says at each of those why it has no dimension.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "lfmesh"
SMALL = 1e-3

DIMENSIONLESS = {
    "geometry/objects/atlas.py": {"_NOISE"},
    "geometry/files/cad_child.py": {"DEFAULT_TOLERANCE", "FINEST_MM", "MM_PER_UNIT"},
    "geometry/files/cad_file.py": {"STRETCHED"},
    "geometry/files/mesh_file.py": {"MM_PER_UNIT"},
    "geometry/surfaces/first_crossing.py": {"SETTLED"},
    "geometry/meshes/patch.py": {"INSIDE", "SETTLED"},
    "geometry/meshes/patch_tree.py": {"MARGIN"},
    "geometry/surfaces/optical_face.py": {
        "BESIDE",
        "EXACT_MM",
        "FITTED_MM",
        "FORM_MM",
        "INDEPENDENT",
        "NO_TURN",
        "ON_AXIS",
        "ON_SURFACE",
    },
    "geometry/surfaces/profile_fit.py": {"FIRST_DAMPING", "FLAT_ENOUGH", "ROUNDED", "SETTLED"},
    "geometry/objects/refractors.py": {"FLAT_SHADED", "NO_POWER", "SAME_NORMAL", "SLIVER"},
    "geometry/files/polygons.py": {"STRAIGHT"},
    "geometry/index_media.py": {"LARGEST_STEP", "PARALLEL", "ROUNDING"},
    "geometry/files/step_surfaces.py": {"SI_PREFIXES", "SMALLEST"},
    "geometry/meshes/shell_tree.py": {"MARGIN"},
    "geometry/surfaces/surface.py": {"SETTLED"},
    "geometry/objects/round_faces.py": {"MARGIN"},
    "geometry/objects/targets.py": {"FLAT"},
    "geometry/array/lenslets.py": {"DEPTH_WITHIN", "FLAT_LAYER"},
    "geometry/surfaces/bends.py": {"BEFORE_END", "HEIGHT_WITHIN"},
    "optics/bounds.py": {"ROUNDING"},
    "geometry/surfaces/edges.py": {"ROUNDING_OF_COORDINATES"},
    "geometry/surfaces/tessellation.py": {"FLOAT32_MARGIN"},
    "geometry/meshes/vertex_normals.py": {"IN_ONE_PLANE", "NO_FIT"},
    "transport/aims/fitting.py": {"ALLOWED"},
    "transport/sequences/stop_rays.py": {"NEAREST"},
    "transport/checks/found.py": {"CUT_SHARE", "OPEN_SHARE"},
    "transport/checks/lamps.py": {"GRAIN", "STEEPEST"},
    "transport/checks/tails.py": {"BRIGHT"},
    "transport/checks/blind_check.py": {"LEVEL"},
    "transport/render/certainty.py": {"RARE"},
    "transport/render/glass_aim.py": {"FEW", "FLATTEST"},
    "transport/checks/order_check.py": {"LARGEST_MM"},
    "transport/events/bending.py": {"CONTACT", "GRAIN", "SHORT", "SMALLEST"},
    "transport/events/facets.py": {"EDGE", "FLOAT32_GRAIN"},
    "transport/events/ground.py": {"LOWEST"},
    "transport/events/volume.py": {"CLEAR_DEPTH"},
    "transport/lights/lamps_on_line.py": {"NARROWEST", "ONE_SIDE"},
    "transport/lights/many_lamps.py": {"BELOW_ONE"},
    "transport/lights/places.py": {"GRAIN"},
    "transport/events/polarisation.py": {"NORMAL2"},
    "transport/trace.py": {"ROUNDING"},
    "transport/packets/ledger.py": {"LOST_LIMIT"},
    "transport/sequences/lens_surfaces.py": {"NEAR", "TOUCHING"},
    "transport/aims/lenslet_faces.py": {"EXACT"},
    "transport/aims/disks.py": {"BEYOND"},
    "transport/aims/near_points.py": {"NEAREST"},
    "optics/ray_aiming.py": {"ARRIVED", "TOLERANCE"},
    "transport/aims/lenslet_view.py": {"ROUNDING"},
    "transport/regions/lens_hits.py": {"SAME_HIT"},
    "transport/regions/standing_lamps.py": {"GRAZING"},
    "transport/regions/lens_block.py": {"SETTLED"},
    "transport/regions/mla.py": {"ROUNDED", "UNSURE"},
    "transport/tables/single_scatter.py": {"FINEST"},
    "transport/tables/emitter_tree.py": {"MARGIN"},
    "transport/tables/lamp_tree.py": {"GRAIN", "MARGIN"},
    "transport/tables/lens.py": {"STEEPER"},
    "transport/tables/particles.py": {"UM2"},
    "transport/tables/motion_tables.py": {"ROOM"},
    "transport/tables/volumes.py": {"COLDEST_K", "ROUNDING"},
    "transport/refused_fields.py": {"PARALLEL", "ROUNDING"},
    "transport/refused_glass.py": {"JUST_BESIDE"},
    "transport/tables/bending_fields.py": {"FORMULA_PRECISION", "LEAST_STEP", "ROUNDING_RAD"},
    "transport/tables/contacts.py": {"CUT"},
    "transport/sources/face_starts.py": {"ON_FACE"},
    "transport/tables/lights.py": {"MM2"},
    "transport/packets/random.py": {"_UNIT"},
    "transport/packets/sobol.py": {"_UNIT"},
}
"""Constants that have a small value: ratios, angles, weights, conversions of units.

Some are lengths. `EXACT_MM`, `FITTED_MM` and `FORM_MM` are what is promised of a recognised surface, whatever its size;
they decide which surface a face is, and move no ray, nor does `SMALLEST`. `LARGEST_MM` compares two results for the
report, and moves or decides no ray. `FINEST_MM` bounds what OpenCASCADE, which calculates to 1e-7 mm whatever the
scale, can be asked for.
"""

FILES = sorted(path for part in ("geometry", "transport") for path in (PACKAGE / part).rglob("*.py"))


def value(node: ast.AST) -> float | None:
    """Return what a numeric literal, its negative or a power of literals stands for."""
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        return float(node.value)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        inner = value(node.operand)
        return None if inner is None else -inner
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
        base, power = value(node.left), value(node.right)
        return None if base is None or power is None else base**power
    return None


def is_small(node: ast.AST) -> bool:
    number = value(node)
    return number is not None and 0.0 < abs(number) <= SMALL


def is_factor(node: ast.AST, parents: dict[ast.AST, ast.AST]) -> bool:
    """Whether a number, or one plus or minus it, multiplies or divides something that is no literal."""
    parent = parents[node]
    if isinstance(parent, ast.BinOp) and isinstance(parent.op, ast.Add | ast.Sub):
        other = parent.right if parent.left is node else parent.left
        if value(other) != 1.0:
            return False
        node, parent = parent, parents[parent]
    if not (isinstance(parent, ast.BinOp) and isinstance(parent.op, ast.Mult | ast.Div)):
        return False
    other = parent.right if parent.left is node else parent.left
    return value(other) is None


def constants(tree: ast.Module) -> dict[str, ast.stmt]:
    """Return the module's named constants that have a small value, with their statements."""
    found: dict[str, ast.stmt] = {}
    for statement in tree.body:
        if isinstance(statement, ast.Assign) and any(is_small(node) for node in ast.walk(statement.value)):
            names = [target.id for target in statement.targets if isinstance(target, ast.Name)]
            found |= {name: statement for name in names if name.isupper()}
    return found


def epsilons(source: str) -> Iterator[str]:
    """Yield the lines on which a small number stands that is neither a factor nor a constant with a name."""
    tree = ast.parse(source)
    parents = {child: node for node in ast.walk(tree) for child in ast.iter_child_nodes(node)}
    named = {node for statement in constants(tree).values() for node in ast.walk(statement)}
    for node in ast.walk(tree):
        inside = isinstance(parents.get(node), ast.UnaryOp) or (
            isinstance(parents.get(node), ast.BinOp) and value(parents[node]) is not None
        )
        if is_small(node) and not inside and node not in named and not is_factor(node, parents):
            yield source.splitlines()[node.lineno - 1].strip()


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_small_numbers_are_factors_or_named(path: Path) -> None:
    assert not list(epsilons(path.read_text(encoding="utf-8")))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_named_ones_are_known_and_say_what_they_are(path: Path) -> None:
    source = path.read_text(encoding="utf-8")
    tree = ast.parse(source)
    found = constants(tree)
    assert set(found) == DIMENSIONLESS.get(path.relative_to(PACKAGE).as_posix(), set())
    for name, statement in found.items():
        after = tree.body[tree.body.index(statement) + 1]
        says = (
            isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and isinstance(after.value.value, str)
        )
        above = source.splitlines()[statement.lineno - 2].lstrip().startswith("#")
        assert says or above, f"{path.name}: {name} does not say why its value has no dimension"


@pytest.mark.parametrize(
    "line",
    [
        "met = t > 1e-9",
        "x = x + 1e-6",
        "x -= 1e-6",
        "t = np.maximum(t, 1e-12)",
        "t = max(t, 2.0**-30)",
        "close = np.allclose(a, b, atol=1e-8)",
        "def f(t, tolerance=1e-9): return t",
        "x = 1.0 - 1e-9",
        "small = -1e-9 < t",
        "t = 1e-6 * 1e-3",
    ],
)
def test_an_epsilon_is_found(line: str) -> None:
    assert set(epsilons(line)) == {line}


@pytest.mark.parametrize(
    "line",
    [
        "met = t <= layer * (1.0 + 1e-12)",
        "slack = 1e-9 * size",
        "GRAIN = 2.0**-22",
        "x = x + 0.5",
        "t = size / (1 - 1e-9)",
    ],
)
def test_a_factor_or_a_name_is_none(line: str) -> None:
    assert not list(epsilons(line))
