"""Media that bend light at their limits: strong balls, grazed faces, corners, turning points, faint and huge fields.

Deflections by balls follow from Bouguer's law n r sin θ = b, by an integral from the nearest point r₀. With r = r₀ + u²
its integrand is even, smooth, and fades, so that the midpoint rule converges exponentially.
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lfmesh.accuracy.hard.outcome import SINGLET, Outcome, case, lens_scene, outcome
from lfmesh.accuracy.hard.truth import Array
from lfmesh.scene import Medium, Scene
from lfmesh.scene.camera.gradient import RadialSquareGradient, XyzGradient
from lfmesh.transport.build import build
from lfmesh.transport.trace import Status, trace
from lfmesh.transport.traced_paths import Paths

AWAY = -6e4
"""z of the middles of fields, mm."""

BISECTIONS = 100
NODES = 512
"""Nodes of the midpoint rule."""

OF_STEPS = 2e-6
"""Accepted error of a deflection over the largest one, in fields without an error of the grid."""


def _with(*media: dict[str, Any], folder: Path = Path()) -> Scene:
    """Return the singlet in front of media about (0, 0, AWAY)."""
    placed = [Medium.model_validate({"position_mm": (0.0, 0.0, AWAY)} | each) for each in media]
    return lens_scene(SINGLET).changed({"media": placed}).in_folder(folder)


def _box(size: tuple[float, float, float], **keys: Any) -> dict[str, Any]:
    return {"bounds": {"kind": "box", "size_mm": size}, **keys}


def _sent(scene: Scene, points: Array, directions: Array) -> Paths:
    """Trace rays that are given about the middle of the fields."""
    return trace(build(scene), points + np.array([0.0, 0.0, AWAY]), directions, split="transmit", max_events=4000)


def _judged(
    paths: Paths, points: Array, directions: Array, largest: float, *, within: float = OF_STEPS, away: float = 1e3
) -> Outcome:
    """Compare the lines behind fields with true ones.

    Parameters
    ----------
    paths : Paths
    points, directions : (n, 3) float64
        Of the true lines: a point about the middle of the fields, mm, and a unit vector.
    largest : float
        Largest deflection, rad.
    within : float
        Accepted error over it.
    away : float, mm
        Distance from which errors of positions are seen.
    """
    count = len(points)
    if len(paths) != count or (paths.status == Status.LOST).any():
        lost = int((paths.status == Status.LOST).sum())
        return outcome(paths, f"{count} rays", f"{len(paths)} ends, {lost} lost", passed=False)
    order = np.argsort(paths.source)
    at, along = paths.position[order] - np.array([0.0, 0.0, AWAY]), paths.direction[order]
    angle = float(np.linalg.norm(along - directions, axis=1).max()) / largest
    apart = float(np.linalg.norm(np.cross(points - at, directions), axis=1).max()) / (away * largest)
    weight = float(np.abs(paths.weight - 1.0).max())
    return outcome(
        paths, f"deflections up to {largest:.2g} rad, within {within:.1e} of that",
        f"error {angle:.1e}, of the position {apart:.1e}, of the weight {weight:.1e}",
        bool(angle <= within and apart <= within and weight < 1e-12),
    )  # fmt: skip


def _deflections(delta: float, width: float, impacts: Array) -> Array:
    """Return the deflections by n = 1 + δ exp(−r²/w²) towards its centre, (n,) rad."""

    def index(r: Array) -> Array:
        return np.asarray(1.0 + delta * np.exp(-((r / width) ** 2)))

    low, high = np.zeros(len(impacts)), impacts * (1.0 + abs(delta)) + width
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        inside = middle * index(middle) < impacts
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    step = 4.0 * np.sqrt(width) / NODES
    u2 = ((np.arange(NODES) + 0.5) * step)[:, None] ** 2
    r = high + u2
    n = index(r)
    # (n r)² − b² over u², without the difference of near numbers at r₀.
    rise = delta * np.exp(-((high / width) ** 2)) * np.expm1(-u2 * (r + high) / width**2)
    square = (n * r + impacts) * (n + high * rise / u2)
    bend = 4.0 * r / width**2 * (n - 1.0) / n / np.sqrt(square)
    return np.asarray(2.0 * impacts * step * bend.sum(axis=0))


@case
def ball_that_turns_rays_round() -> Outcome:
    """Send rays past a ball of index 2 in its middle, which turns them by up to 96 degrees."""
    delta, width, spacing, count = 1.0, 8.0, 0.5, 129
    impacts = width * np.linspace(0.01, 1.8, 400)
    draw = np.random.default_rng(7)
    along = draw.normal(size=(len(impacts), 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, draw.normal(size=along.shape))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    bent = _deflections(delta, width, impacts)[:, None]
    x2 = (spacing * (np.arange(count) - 0.5 * (count - 1))) ** 2
    values = 1.0 + delta * np.exp(-(x2[:, None, None] + x2[:, None] + x2) / width**2)
    with tempfile.TemporaryDirectory(prefix="lfmesh-") as folder:
        np.savez(Path(folder) / "ball.npz", index=values, spacing_mm=spacing)
        paths = _sent(_with({"grid": "ball.npz"}, folder=Path(folder)), impacts[:, None] * across - 90.0 * along, along)
    # The line behind is as far from the centre as the one in front.
    points = impacts[:, None] * (np.cos(bent) * across + np.sin(bent) * along)
    # The error of the grid, whose voxels are a sixteenth of the ball's radius.
    return _judged(paths, points, np.cos(bent) * along - np.sin(bent) * across, float(bent.max()), within=1e-4)


@case
def edges_and_corners_of_fields() -> Outcome:
    """Aim at corners, edges and along the faces of a field whose index is that of the air around: no ray turns."""
    size, angles = np.array([30.0, 20.0, 50.0]), (30.0, -40.0, 55.0)
    marks = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)])
    on_edges = 0.5 * size * marks[(np.abs(marks).sum(axis=1) >= 2)]
    draw = np.random.default_rng(5)
    along = draw.normal(size=(40, len(on_edges), 3))
    # Some run in the planes of faces, and along edges.
    along[:20] *= draw.integers(0, 2, (20, 1, 3)) * 1.0
    along[~along.any(axis=2)] = [0.0, 0.0, 1.0]
    along = (along / np.linalg.norm(along, axis=2, keepdims=True)).reshape(-1, 3)
    points = np.tile(on_edges, (40, 1))
    turn = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    points, along = points @ turn.T, along @ turn.T
    field = _box(tuple(size.tolist()), index=1.0, rotation_deg=angles)
    paths = _sent(_with(field), points - 80.0 * along, along)
    return _judged(paths, points, along, 1.0, within=1e-12)


@case
def grazing_the_face_of_a_field() -> Outcome:
    """Meet the face of thin gas at its critical angle, and 1e-1 to 1e-8 of that beside it."""
    count, index = 2000, 1.0 - 9e-4
    draw = np.random.default_rng(2)
    sense = np.where(draw.uniform(size=count) < 0.5, -1.0, 1.0)
    angle = np.arccos(index) * (1.0 + sense * 10.0 ** draw.uniform(-8.0, -1.0, count))
    along = np.column_stack([0.0 * angle, -np.sin(angle), np.cos(angle)])
    # Beside the lens, which some of them would meet otherwise.
    points = np.column_stack([draw.uniform(40.0, 90.0, count), np.full(count, 30.0), draw.uniform(-50.0, 50.0, count)])
    paths = _sent(_with(_box((200.0, 60.0, 4000.0), index=index)), points - 100.0 * along, along)
    turned = np.zeros(count, dtype=bool)
    turned[paths.source[paths.direction[:, 1] > 0.0]] = True
    wrong, lost = int((turned != (sense < 0.0)).sum()), int((paths.status == Status.LOST).sum())
    return outcome(
        paths, f"{int((sense < 0.0).sum())} of {count} rays are totally reflected, the others pass",
        f"{int(turned.sum())} are, {wrong} end wrongly, {lost} lost", len(paths) == count and wrong == 0 and lost == 0,
    )  # fmt: skip


@case
def turning_above_a_face() -> Outcome:
    """Turn rays round 1 mm to 0.1 µm above the lower face of a field, as above a hot road."""
    slope, half, low, count = 2e-5, 1000.0, -20.0, 400
    lowest = low + 10.0 ** np.linspace(0.0, -4.0, count)
    index = 1.0 + slope * lowest
    # n is a hyperbolic cosine of σ, about the lowest point in the middle.
    turn = slope * half / index
    height, rise = lowest + index * 2.0 * np.sinh(0.5 * turn) ** 2 / slope, index * np.sinh(turn)
    x = np.linspace(-5.0, 5.0, count)
    points = np.column_stack([x, height, np.full(count, -half)])
    along = np.column_stack([0.0 * x, -rise, np.sqrt(1.0 - rise**2)])
    field = XyzGradient(index=1.0, y_coefficients=(slope,))
    paths = _sent(_with(_box((40.0, -2.0 * low, 2.0 * half), index=field)), points - 50.0 * along, along)
    ahead = [1.0, -1.0, 1.0]
    return _judged(paths, points * [1.0, 1.0, -1.0], along * ahead, float(2.0 * rise.max()))


@case
def faint_field() -> Outcome:
    """Bend rays by 1e-9 rad in an index that changes by 1e-12 per mm."""
    slope, half, count = 1e-12, 500.0, 400
    draw = np.random.default_rng(3)
    points = np.column_stack([draw.uniform(-8.0, 8.0, (count, 2)), np.full(count, -half)])
    along = np.column_stack([draw.uniform(-0.01, 0.01, (count, 2)), np.ones(count)])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    field = XyzGradient(index=1.0, y_coefficients=(slope,))
    paths = _sent(_with(_box((60.0, 60.0, 2.0 * half), index=field)), points - 50.0 * along, along)
    length = 2.0 * half / along[:, 2]
    change = slope * length
    ends = points + length[:, None] * along + np.column_stack([0.0 * change, 0.5 * change * length, 0.0 * change])
    behind = along + np.column_stack([0.0 * change, change, -change * along[:, 1] / along[:, 2]])
    return _judged(paths, ends, behind, float(change.max()), within=1e-5, away=-AWAY)


@case
def fields_of_1_um_and_100_m() -> Outcome:
    """Bend rays in boxes of 1 µm to 100 m by an index that is linear in y."""
    outcomes = []
    for size in (1e-3, 1.0, 1e5):
        slope, half, count = 1e-3 / size, 0.5 * size, 200
        draw = np.random.default_rng(4)
        y, sine = draw.uniform(-0.3, 0.3, count) * size, draw.uniform(-0.05, 0.05, count)
        index = 1.0 + slope * y
        sigma = size / np.sqrt(index**2 - sine**2)
        end = index * np.cosh(slope * sigma) + sine * np.sinh(slope * sigma)
        rise = index * np.sinh(slope * sigma) + sine * np.cosh(slope * sigma)
        points = np.column_stack([0.0 * y, y, np.full(count, -half)])
        along = np.column_stack([0.0 * y, sine, np.sqrt(1.0 - sine**2)])
        field = XyzGradient(index=1.0, y_coefficients=(slope,))
        paths = _sent(_with(_box((size, size, size), index=field)), points - 0.01 * size * along, along)
        ends = np.column_stack([0.0 * y, (end - 1.0) / slope, np.full(count, half)])
        behind = np.column_stack([0.0 * y, rise, np.sqrt(1.0 - rise**2)])
        outcomes.append(_judged(paths, ends, behind, 1e-3, within=1e-5, away=max(size, 1.0)))
    return max(outcomes, key=lambda each: not each.passed)


DUCT_INDEX, DUCT_SQUARE = 1.0006, -2e-6
DUCT = RadialSquareGradient(index=DUCT_INDEX, coefficients=(DUCT_SQUARE,))
PITCH = 2.0 * np.pi / (DUCT_INDEX * np.sqrt(-DUCT_SQUARE))
"""Period of rays along a duct, mm of σ."""


def _in_duct(parts: int, length: float, within: float) -> Outcome:
    """Send skew rays through a duct that is cut into parts whose faces touch."""
    count, half = 400, 0.5 * length
    draw = np.random.default_rng(6)
    at, sines = draw.uniform(-6.0, 6.0, (count, 2)), draw.uniform(-0.008, 0.008, (count, 2))
    rate = DUCT_INDEX * np.sqrt(-DUCT_SQUARE)
    square = DUCT_INDEX**2 * (1.0 + DUCT_SQUARE * (at**2).sum(axis=1))
    sigma = (length / np.sqrt(square - (sines**2).sum(axis=1)))[:, None]
    points = np.column_stack([at, np.full(count, -half)])
    along = np.column_stack([sines, np.sqrt(1.0 - (sines**2).sum(axis=1))])
    ends = np.column_stack([at * np.cos(rate * sigma) + sines / rate * np.sin(rate * sigma), np.full(count, half)])
    behind = sines * np.cos(rate * sigma) - rate * at * np.sin(rate * sigma)
    middles = AWAY + length * ((np.arange(parts) + 0.5) / parts - 0.5)
    media = [
        _box((40.0, 40.0, length / parts), index=DUCT, position_mm=(0.0, 0.0, middle)) for middle in middles.tolist()
    ]
    paths = _sent(_with(*media), points - 50.0 * along, along)
    directions = np.column_stack([behind, np.sqrt(1.0 - (behind**2).sum(axis=1))])
    return _judged(paths, ends, directions, 2.0 * float(np.abs(behind).max()), within=within)


@case
def duct_of_ten_pitches() -> Outcome:
    """Cross a parabolic duct of 44 m, ten pitches long, with skew rays."""
    return _in_duct(1, 10.0 * PITCH, 1e-5)


@case
def fields_that_touch() -> Outcome:
    """Cross a parabolic duct that is cut into seven fields with common faces."""
    return _in_duct(7, 0.4 * PITCH, OF_STEPS)
