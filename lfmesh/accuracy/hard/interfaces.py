"""One interface at the limits of Fresnel's equations."""

import numpy as np

from lfmesh.accuracy.hard.outcome import Outcome, case, disk, lens_scene, outcome, surfaces_of, through_lens, tilted
from lfmesh.accuracy.hard.truth import Array, transmittance
from lfmesh.transport.build import build
from lfmesh.transport.packets.packet import Event
from lfmesh.transport.trace import Status, trace
from lfmesh.transport.traced_paths import Paths
from lfmesh.transport.world import World

WINDOW = surfaces_of(((np.inf, 4.0, 1.5), (-50.0, 0.0, 1.0)))
"""A flat front face, with enough power behind it to make a lens."""


def _bundle(count: int, radius: float = 9.0, spread: float = 0.15) -> tuple[Array, Array]:
    d = tilted(count, spread)
    return np.column_stack([disk(radius, count), np.zeros(count)]) - 60.0 * d, d


@case
def normal_incidence() -> Outcome:
    """Meet a flat face at normal incidence, where Fresnel's sin and tan quotients are 0/0."""
    scene = lens_scene(WINDOW)
    o = np.column_stack([disk(9.0, 2000), np.full(2000, -60.0)])
    return through_lens(scene, o, np.tile([0.0, 0.0, 1.0], (2000, 1)), 1e-12)


def _first_split(world: World, o: Array, d: Array) -> tuple[Paths, Array]:
    """Return reflected and transmitted weight (n, 2) at the first interface of each ray; NaN if none."""
    paths = trace(world, o, d, split="both", record=True, weight_cutoff=0.0, max_events=6)
    shares = np.zeros((len(o), 2))
    met = np.zeros(len(o), dtype=bool)
    for packet, source in enumerate(paths.source):
        path = paths.vertices(packet)
        if len(path) > 1 and path[1].event in (Event.REFLECTED, Event.TRANSMITTED):
            met[source] = True
            shares[source, 0 if path[1].event == Event.REFLECTED else 1] = path[1].weight
    shares[~met] = np.nan
    return paths, shares


@case
def grazing() -> Outcome:
    """Graze a flat face from outside, down to 1e-10 rad."""
    world = build(lens_scene(WINDOW))
    angle = np.repeat(10.0 ** np.arange(-2.0, -10.5, -0.5), 40)
    along = np.random.default_rng(2).uniform(0.0, 2.0 * np.pi, len(angle))
    d = np.column_stack([np.cos(along) * np.cos(angle), np.sin(along) * np.cos(angle), np.sin(angle)])
    o = -5.0 * d
    paths, shares = _first_split(world, o, d)
    cos_t = np.sqrt(1.0 - (np.cos(angle) / 1.5) ** 2)
    true = transmittance(1.0, 1.5, np.sin(angle), cos_t)
    error = np.abs(shares[:, 1] / true - 1.0)
    missed = int(np.isnan(error).sum())
    return outcome(
        paths,
        f"{len(angle)} rays meet the face; T within 1e-12 of itself",
        f"{len(angle) - missed} meet it; T off by {np.nanmax(error):.1e} of itself",
        missed == 0 and bool(np.nanmax(error) < 1e-12),
    )


def _graze(front: tuple[tuple[float, float, float], ...]) -> Outcome:
    """Graze a sphere behind other surfaces, starting 3 mm in front of it."""
    radius = 20.0
    scene = lens_scene(surfaces_of((*front, (radius, 6.0, 1.5), (-radius, 0.0, 1.0))))
    vertex = scene.camera.lens.vertices_mm[len(front)]
    draw = np.random.default_rng(3)
    n = 10_000
    polar, phi, turn = draw.uniform(0.01, 0.3, n), *draw.uniform(0.0, 2.0 * np.pi, (2, n))
    angle = 10.0 ** draw.uniform(-7.0, -1.0, n)
    outward = np.column_stack([np.sin(polar) * np.cos(phi), np.sin(polar) * np.sin(phi), -np.cos(polar)])
    round_axis = np.column_stack([-np.sin(phi), np.cos(phi), np.zeros(n)])
    along = np.cos(turn)[:, None] * round_axis + np.sin(turn)[:, None] * np.cross(round_axis, outward)
    d = np.cos(angle)[:, None] * along - np.sin(angle)[:, None] * outward
    truth = np.array([0.0, 0.0, vertex + radius]) + radius * outward
    o = truth - 3.0 * d
    paths = trace(build(scene), o, d, split="both", weight_cutoff=0.0, max_events=1, record=True)
    error = np.full(n, np.inf)
    for packet, source in enumerate(paths.source):
        path = paths.vertices(packet)
        if path[1].surface == f"lens surface {len(front)}":
            error[source] = np.linalg.norm(path[1].position - truth[source])
    # Shift along the ray at this angle due to the rounding of a coordinate of 20 mm.
    right = error * angle <= 1e-14
    lost = int((paths.status == Status.LOST).sum())
    return outcome(
        paths, f"{n} rays meet the sphere, to the rounding of their coordinates over the angle",
        f"{int(right.sum())} do, {lost} lost; error {(error * angle).max():.1e} mm over the angle", bool(right.all()),
    )  # fmt: skip


@case
def grazing_sphere() -> Outcome:
    """Graze a sphere from outside, at 1e-1 to 1e-7 rad, where rays pass above its mesh's chords."""
    return _graze(())


@case
def grazing_inside() -> Outcome:
    """Graze a sphere inside the lens, where rays above its mesh would end on an edge, undetected."""
    return _graze(((np.inf, 2.0, 1.5), (np.inf, 3.0, 1.0)))


@case
def critical_angle() -> Outcome:
    """Leave glass 1e-12 rad to either side of the critical angle."""
    world = build(lens_scene(WINDOW))
    critical = np.arcsin(1.0 / 1.5)
    beyond = np.repeat([-1e-6, -1e-9, -1e-12, 1e-12, 1e-9, 1e-6], 40)
    angle = critical + beyond
    along = np.random.default_rng(2).uniform(0.0, 2.0 * np.pi, len(angle))
    d = np.column_stack([np.cos(along) * np.sin(angle), np.sin(along) * np.sin(angle), -np.cos(angle)])
    o = np.array([0.0, 0.0, 2.0]) + np.column_stack([disk(2.0, len(angle)), np.zeros(len(angle))])
    paths, shares = _first_split(world, o, d)
    # 1 − sin²θ / sin²θc = sin(θc + θ) sin(θc − θ) / sin²θc, which keeps its digits.
    inside = np.maximum(np.sin(critical + angle) * np.sin(-beyond), 0.0) * 1.5**2
    true = np.where(beyond < 0.0, transmittance(1.5, 1.0, np.cos(angle), np.sqrt(inside)), 0.0)
    # Four roundings of a direction, in rad, on a fraction that grows with the root of the angle.
    rounding = 4.0 * np.finfo(float).eps
    reach = np.sqrt(np.abs(beyond) + rounding) - np.sqrt(np.maximum(np.abs(beyond) - rounding, 0.0))
    allowed = 20.0 * reach + 1e-14
    error = np.abs(shares - np.column_stack([1.0 - true, true])).max(axis=1)
    total = beyond > 0.0
    right = (error <= allowed) & (~total | (shares[:, 1] == 0.0))
    return outcome(
        paths,
        "total reflection beyond it, R + T = 1 and T to rounding of the angle before it",
        f"{int((~right).sum())} of {len(angle)} wrong; T off by {np.nanmax(error):.1e}",
        bool(right.all()),
    )


@case
def matched_indices() -> Outcome:
    """Cross glass of index 1, which reflects and refracts nothing."""
    strong = ((50.0, 4.0, 1.5168), (-50.0, 1.0, 1.0), (np.inf, 3.0, 1.0), (-30.0, 0.0, 1.0))
    scene = lens_scene(surfaces_of(strong))
    o, d = _bundle(5000)
    return through_lens(scene, o, d, 1e-11)


@case
def faint_glass() -> Outcome:
    """Cross a lens of index 1.0001."""
    o, d = _bundle(5000, 8.0)
    return through_lens(lens_scene(surfaces_of(((20.0, 6.0, 1.0001), (-20.0, 0.0, 1.0)))), o, d, 1e-11)


@case
def dense_glass() -> Outcome:
    """Cross a lens of index 4, with most angles inside beyond the critical angle."""
    o, d = _bundle(5000, 9.0)
    surfaces = ((100.0, 5.0, 4.0), (150.0, 0.0, 1.0))
    return through_lens(lens_scene(surfaces_of(surfaces), distance=20.0), o, d, 1e-11)
