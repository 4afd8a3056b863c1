"""Meshes from files: broken, skewed, far away, or huge."""

from collections.abc import Callable

import numpy as np
import trimesh

from lfmesh.accuracy.hard.outcome import (
    SINGLET,
    Outcome,
    case,
    faces_of,
    lens_scene,
    on_sensor,
    outcome,
    sensor_z,
    surfaces_of,
    world_with,
)
from lfmesh.accuracy.hard.truth import Array, Interface, at_plane, through
from lfmesh.errors import LfmeshError
from lfmesh.scene import Plane, Target
from lfmesh.transport.build import build
from lfmesh.transport.trace import Status, trace

SPHERE_AT = -40.0


def _grid(count: int, size: float) -> trimesh.Trimesh:
    """Return a square sheet of 2 count² facets at z = 0, facing +z."""
    at = np.linspace(-0.5 * size, 0.5 * size, count + 1)
    x, y = np.meshgrid(at, at, indexing="xy")
    i, j = (k.ravel() for k in np.meshgrid(np.arange(count), np.arange(count), indexing="xy"))
    low = j * (count + 1) + i
    faces = np.concatenate(
        [np.column_stack([low, low + 1, low + count + 2]), np.column_stack([low, low + count + 2, low + count + 1])]
    )
    return trimesh.Trimesh(np.column_stack([x.ravel(), y.ravel(), 0.0 * x.ravel()]), faces, process=False)


def _on_sheet(sheet: trimesh.Trimesh, aims: Array, *, tolerance: float = 1e-9, z: float = -100.0) -> Outcome:
    """Aim rays at points of an opaque sheet at a distance; all must end on its plane."""
    world = world_with(sheet, position_mm=(0.0, 0.0, z))
    draw = np.random.default_rng(21)
    d = np.column_stack([draw.uniform(-0.3, 0.3, (len(aims), 2)), -np.ones(len(aims))])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    truth = np.column_stack([aims, np.full(len(aims), z)])
    o = truth - 60.0 * d
    paths = trace(world, o, d)
    true = at_plane(o, d, z)
    hit = paths.status == Status.TARGET
    lost = int((paths.status == Status.LOST).sum())
    error = np.linalg.norm(paths.position - true, axis=1)[hit].max(initial=0.0)
    return outcome(
        paths,
        f"{len(aims)} rays end on the sheet, within {tolerance:.0e} mm",
        f"{int(hit.sum())} do, {lost} lost; error {error:.1e} mm",
        bool((hit | (paths.status == Status.LOST)).all()) and error <= tolerance,
    )


def _spread(count: int, size: float) -> Array:
    return np.random.default_rng(22).uniform(-0.5 * size, 0.5 * size, (count, 2))


@case
def duplicate_faces() -> Outcome:
    """Hit a sheet that contains every facet twice."""
    sheet = _grid(20, 60.0)
    sheet.faces = np.concatenate([sheet.faces, sheet.faces])
    return _on_sheet(sheet, _spread(20_000, 58.0))


@case
def flipped_faces() -> Outcome:
    """Hit a sheet with every second facet reversed."""
    sheet = _grid(20, 60.0)
    faces = np.array(sheet.faces)
    faces[::2] = faces[::2, ::-1]
    sheet.faces = faces
    return _on_sheet(sheet, _spread(20_000, 58.0))


@case
def zero_area() -> Outcome:
    """Hit a sheet that also has facets without area, collinear and pointlike."""
    sheet = _grid(20, 60.0)
    faces = np.array(sheet.faces)
    empty = np.concatenate([faces[:100, [0, 1, 1]], faces[:100, [0, 0, 0]], [[0, 1, 2], [1, 2, 3]]])
    sheet.faces = np.concatenate([empty, faces])
    return _on_sheet(sheet, np.asarray(sheet.vertices)[:, :2] * 0.95)


@case
def needles() -> Outcome:
    """Hit a sheet cut into needles of aspect ratio 1e8."""
    height = 60.0
    cuts = np.concatenate([[-30.0], np.cumsum(np.full(200, 6e-7)) - 6e-5, [30.0]])
    low = np.column_stack([cuts, np.full(len(cuts), -0.5 * height), 0.0 * cuts])
    high = np.add(low, [0.0, height, 0.0])
    n = len(cuts)
    k = np.arange(n - 1)
    faces = np.concatenate([np.column_stack([k, k + 1, k + 1 + n]), np.column_stack([k, k + 1 + n, k + n])])
    sheet = trimesh.Trimesh(np.concatenate([low, high]), faces, process=False)
    draw = np.random.default_rng(23)
    aims = np.column_stack([draw.uniform(-1e-4, 1e-4, 20_000), draw.uniform(-29.0, 29.0, 20_000)])
    return _on_sheet(sheet, aims)


@case
def t_junction() -> Outcome:
    """Aim rays at T-junctions between facets."""
    left = np.array([[-20.0, -20.0, 0.0], [0.0, -20.0, 0.0], [0.0, 20.0, 0.0], [-20.0, 20.0, 0.0]])
    y = np.linspace(-20.0, 20.0, 8)
    right = np.concatenate([np.column_stack([0.0 * y, y, 0.0 * y]), np.column_stack([0.0 * y + 20.0, y, 0.0 * y])])
    k = np.arange(7)
    faces = np.concatenate(
        [[[0, 1, 2], [0, 2, 3]], np.column_stack([k, k + 8, k + 9]) + 4, np.column_stack([k, k + 9, k + 1]) + 4]
    )
    sheet = trimesh.Trimesh(np.concatenate([left, right]), faces, process=False)
    aims = np.column_stack([np.zeros(6 * 500), np.repeat(y[1:-1], 500)])
    return _on_sheet(sheet, aims)


@case
def non_manifold() -> Outcome:
    """Aim rays at an edge shared by three sheets."""
    sheet = _grid(4, 60.0)
    fin = trimesh.Trimesh([[0.0, -30.0, 0.0], [0.0, 30.0, 0.0], [0.0, 0.0, -5.0]], [[0, 1, 2]], process=False)
    both = trimesh.util.concatenate([sheet, fin])
    aims = np.column_stack([np.zeros(5000), np.linspace(-29.0, 29.0, 5000)])
    return _on_sheet(both, aims)


@case
def far_coordinates() -> Outcome:
    """Hit a mesh with coordinates near 1e6 mm that is moved in front of the camera."""
    sheet = _grid(50, 60.0)
    sheet.apply_translation([1e6, -1e6, 1e6])
    world = world_with(sheet, ending="ply", position_mm=(-1e6, 1e6, -1e6 - 100.0))
    aims = _spread(20_000, 58.0)
    o = np.column_stack([aims, np.full(len(aims), -40.0)])
    paths = trace(world, o, np.tile([0.0, 0.0, -1.0], (len(o), 1)))
    hit = paths.status == Status.TARGET
    error = np.abs(paths.position[hit] - np.column_stack([aims, np.full(len(aims), -100.0)])[hit]).max(initial=0.0)
    return outcome(
        paths, "all rays end on the sheet, within 1e-09 mm",
        f"{int(hit.sum())} of {len(o)} do; error {error:.1e} mm", bool(hit.all()) and error < 1e-9,
    )  # fmt: skip


@case
def million_triangles() -> Outcome:
    """Aim rays at the vertices of a sheet of a million triangles."""
    sheet = _grid(708, 60.0)
    vertices = np.asarray(sheet.vertices)[:, :2]
    picked = np.random.default_rng(24).integers(0, len(vertices), 20_000)
    aims = 0.99 * vertices[picked]
    inner = np.abs(vertices[picked]).max(axis=1) < 29.0
    aims = np.where(inner[:, None], vertices[picked], aims)
    return _on_sheet(sheet, aims)


def _refused(body: trimesh.Trimesh, why: str) -> Outcome:
    """Expect a broken glass body to be refused with a one-line reason."""
    try:
        world_with(body, index=1.5, position_mm=(0.0, 0.0, SPHERE_AT))
    except LfmeshError as error:
        said = str(error)
        return Outcome("", f"refused: {why}", said, why in said and "\n" not in said, 0.0, 0.0, 0)
    return Outcome("", f"refused: {why}", "accepted", False, 0.0, 0.0, 0)


@case
def glass_with_duplicates() -> Outcome:
    """Make glass of a body that contains some facets twice."""
    ball = trimesh.creation.icosphere(2, 5.0)
    ball.faces = np.concatenate([ball.faces, ball.faces[:40]])
    return _refused(ball, "closed body")


@case
def glass_with_flips() -> Outcome:
    """Make glass of a body with facets that face inwards."""
    ball = trimesh.creation.icosphere(2, 5.0)
    faces = np.array(ball.faces)
    faces[:40] = faces[:40, ::-1]
    ball.faces = faces
    return _refused(ball, "face one way")


@case
def glass_with_junction() -> Outcome:
    """Make glass of a body with a T-junction, which is not closed."""
    box = trimesh.creation.box((10.0, 10.0, 10.0))
    faces = np.array(box.faces)
    a, b, c = faces[0]
    middle = 0.5 * (box.vertices[a] + box.vertices[b])
    vertices = np.concatenate([box.vertices, [middle]])
    new = len(vertices) - 1
    faces = np.concatenate([[[a, new, c], [new, b, c]], faces[1:]])
    return _refused(trimesh.Trimesh(vertices, faces, process=False), "closed body")


def _ball(change: Callable[[trimesh.Trimesh], trimesh.Trimesh], *, tolerance: float) -> Outcome:
    """Look through a glass ball from a mesh file, and compare the rays with a sphere's."""
    body = change(trimesh.creation.icosphere(5, 5.0))
    world = world_with(body, ending="ply", index=1.5, surface="patch", position_mm=(0.0, 0.0, SPHERE_AT))
    draw = np.random.default_rng(25)
    o = np.column_stack([draw.uniform(-1.5, 1.5, (5000, 2)), np.full(5000, -60.0)])
    d = np.tile([0.0, 0.0, 1.0], (len(o), 1))
    paths = trace(world, o, d, split="transmit")
    faces = [Interface(5.0, SPHERE_AT - 5.0, 1.5), Interface(-5.0, SPHERE_AT + 5.0), *faces_of(world.scene)]
    true = through(faces, o, d)
    landing = at_plane(true.p, true.d, sensor_z(world.scene))
    return on_sensor(
        paths,
        landing,
        true.weight,
        tolerance,
        stopped=np.asarray((true.heights[:, 2:] > 10.0).any(axis=1)),
        relative=1e-4,
    )


@case
def coincident_vertices() -> Outcome:
    """Look through a glass ball with facets that share no vertex."""

    def unmerged(ball: trimesh.Trimesh) -> trimesh.Trimesh:
        corners = np.asarray(ball.vertices)[ball.faces].reshape(-1, 3)
        return trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)

    return _ball(unmerged, tolerance=2e-3)


@case
def glass_with_empty_facets() -> Outcome:
    """Look through a glass ball with facets without area."""

    def dirtied(ball: trimesh.Trimesh) -> trimesh.Trimesh:
        faces = np.concatenate([ball.faces, np.asarray(ball.faces)[:50][:, [0, 1, 1]]])
        return trimesh.Trimesh(ball.vertices, faces, process=False)

    return _ball(dirtied, tolerance=2e-3)


@case
def corner_cube() -> Outcome:
    """Return rays by the three total reflections of a corner cube."""
    body = trimesh.Trimesh(
        [[0.0, 0.0, 0.0], [30.0, 0.0, 0.0], [0.0, 30.0, 0.0], [0.0, 0.0, 30.0]],
        [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        process=False,
    )
    body.fix_normals()
    world = world_with(body, index=1.8, surface="flat", position_mm=(0.0, 0.0, -100.0))
    axis = np.ones(3) / np.sqrt(3.0)
    draw = np.random.default_rng(26)
    n = 100_000
    d = -axis + 0.02 * draw.normal(size=(n, 3))
    o = np.array([0.0, 0.0, -100.0]) + 40.0 * axis + draw.uniform(-2.0, 2.0, (n, 3))
    paths = trace(world, o, d, split="transmit")
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    turned = np.linalg.norm(paths.direction + d[paths.source], axis=1)
    lost = paths.status == Status.LOST
    escaped = ~lost
    return outcome(
        paths, f"{n} rays return, antiparallel within 1e-12",
        f"{int((turned < 1e-12).sum())} do; the worst is {turned[escaped].max():.1e} off, {int(lost.sum())} lost",
        bool((turned[escaped] < 1e-12).all()) and len(paths) == n,
    )  # fmt: skip


@case
def trapped_light() -> Outcome:
    """Trap light in a plate by total reflection, until the limit on events ends it."""
    scene = lens_scene(surfaces_of(((np.inf, 0.05, 1.9), (np.inf, 2.0, 1.0), (60.0, 4.0, 1.5), (-60.0, 0.0, 1.0))))
    draw = np.random.default_rng(28)
    n = 5000
    # Emitted in the glass beyond its critical angle of 31.8°, so near the axis that 64 reflections stay inside.
    angle, phi = np.deg2rad(draw.uniform(32.0, 60.0, n)), draw.uniform(0.0, 2.0 * np.pi, n)
    d = np.column_stack([np.sin(angle) * np.cos(phi), np.sin(angle) * np.sin(phi), np.cos(angle)])
    paths = trace(build(scene), np.tile([0.0, 0.0, 0.02], (n, 1)), d, split="both", weight_cutoff=0.0)
    depth = int(((paths.status == Status.DEPTH) & (paths.events == 64)).sum())
    off = abs(paths.ledger.depth / n - 1.0)
    return outcome(
        paths, f"{n} rays end after 64 reflections with all their power",
        f"{depth} do; their power is {off:.1e} off", depth == n and len(paths) == n and off < 1e-12,
    )  # fmt: skip


def _target_at(distance: float, size: float) -> Outcome:
    plane = Target(shape=Plane(width_mm=size, height_mm=size), position_mm=(0.0, 0.0, -distance))
    scene = lens_scene(SINGLET, targets=(plane,))
    aims = _spread(20_000, 0.98 * size)
    o = np.column_stack([np.random.default_rng(27).uniform(-5.0, 5.0, (len(aims), 2)), np.full(len(aims), -0.5)])
    truth = np.column_stack([aims, np.full(len(aims), -distance)])
    d = truth - o
    paths = trace(build(scene), o, d)
    hit = paths.status == Status.TARGET
    error = np.linalg.norm(paths.position - truth, axis=1).max() / (1.0 + distance)
    return outcome(
        paths, "all rays end on it, within 1e-14 of its distance",
        f"{int(hit.sum())} of {len(o)} do; error {error:.1e} of the distance", bool(hit.all()) and error < 1e-14,
    )  # fmt: skip


@case
def target_100_m() -> Outcome:
    """Hit a target at 100 m."""
    return _target_at(1e5, 1e4)


@case
def target_1_mm() -> Outcome:
    """Hit a target 1 mm in front of the lens."""
    return _target_at(1.0, 15.0)
