"""Glass bodies that touch, nest or absorb."""

import tempfile
from pathlib import Path

import numpy as np
import trimesh

from lfmesh.accuracy.hard.outcome import SINGLET, Outcome, case, disk, lens_scene, outcome
from lfmesh.accuracy.hard.truth import Array, Interface, at_plane, through
from lfmesh.scene import Plane, Refractor, Target
from lfmesh.transport.build import build
from lfmesh.transport.trace import Status, trace
from lfmesh.transport.traced_paths import Paths
from lfmesh.transport.world import World

WATER, GLASS = 1.333, 1.52
CHART_AT = -400.0
SIDES = 3000.0
"""Distance of the bodies' sides from the axis, mm."""


def _before_chart(*bodies: tuple[trimesh.Trimesh, float]) -> World:
    """Build a camera that looks through glass bodies (mesh in the world frame, index) at an opaque plane."""
    with tempfile.TemporaryDirectory(prefix="lfmesh-") as folder:
        targets = []
        for number, (mesh, index) in enumerate(bodies):
            name = f"body{number}.ply"
            mesh.export(Path(folder) / name)
            targets.append(Target(refractor=Refractor(file=name, units="mm", index=index, surface="flat")))
        plane = Target(shape=Plane(width_mm=4e4, height_mm=4e4), position_mm=(0.0, 0.0, CHART_AT))
        return build(lens_scene(SINGLET, targets=(plane, *targets)).in_folder(Path(folder)))


def _slab(near: float, far: float) -> trimesh.Trimesh:
    """Return a box of six by six metres between two distances in front of the camera."""
    return trimesh.creation.box(bounds=[[-SIDES, -SIDES, -far], [SIDES, SIDES, -near]])


def _away(count: int, steepest_deg: float, seed: int) -> tuple[Array, Array]:
    """Return rays from 1 mm in front of the lens towards the chart, at all angles up to a limit."""
    draw = np.random.default_rng(seed)
    angle, turn = np.deg2rad(steepest_deg) * draw.random(count), 2.0 * np.pi * draw.random(count)
    sine = np.sin(angle)
    d = np.column_stack([sine * np.cos(turn), sine * np.sin(turn), -np.cos(angle)])
    o = np.column_stack([draw.uniform(-2.0, 2.0, (count, 2)), np.full(count, -1.0)])
    return o, d


def _at_chart(paths: Paths, truth: Array, weight: Array, tolerance: float) -> Outcome:
    """Compare the end points of rays, all on the chart, with the truth."""
    hit = paths.status == Status.TARGET
    far = 1.0 + np.linalg.norm(truth, axis=1)
    error = (np.linalg.norm(paths.position - truth, axis=1) / far)[hit].max(initial=0.0)
    loss = np.abs(paths.weight / weight - 1.0)[hit].max(initial=0.0)
    return outcome(
        paths,
        f"{len(truth)} rays end on the chart, within {tolerance:.0e} of the way",
        f"{int(hit.sum())} do; error {error:.1e} of the way, of the weight {loss:.1e}",
        bool(hit.all()) and len(paths) == len(truth) and error <= tolerance and loss <= 1e-10,
    )


def _mirrored(p: Array) -> Array:
    """Turn points or directions about the x axis: the truth's rays travel along +z."""
    return np.asarray(p * np.array([1.0, -1.0, -1.0]))


@case
def water_behind_a_window() -> Outcome:
    """Look through water between two windows, at angles up to 89 degrees."""
    edges, media = (20.0, 25.0, 65.0, 70.0), (GLASS, WATER, GLASS, 1.0)
    bodies = [(_slab(near, far), n) for near, far, n in zip(edges[:-1], edges[1:], media, strict=False)]
    o, d = _away(20_000, 89.0, 31)
    paths = trace(_before_chart(*bodies), o, d, split="transmit")
    true = through([Interface(np.inf, z, n) for z, n in zip(edges, media, strict=True)], _mirrored(o), _mirrored(d))
    return _at_chart(paths, _mirrored(at_plane(true.p, true.d, -CHART_AT)), true.weight, 1e-12)


@case
def glass_of_the_waters_index() -> Outcome:
    """Look through water that contains a ball of its own index, which neither refracts nor reflects."""
    ball = trimesh.creation.icosphere(4, 12.0)
    ball.apply_translation([0.0, 0.0, -40.0])
    o, d = _away(20_000, 30.0, 32)
    paths = trace(_before_chart((_slab(20.0, 60.0), WATER), (ball, WATER)), o, d, split="transmit")
    faces = [Interface(np.inf, 20.0, WATER), Interface(np.inf, 60.0, 1.0)]
    true = through(faces, _mirrored(o), _mirrored(d))
    return _at_chart(paths, _mirrored(at_plane(true.p, true.d, -CHART_AT)), true.weight, 1e-12)


@case
def film_of_air_in_water() -> Outcome:
    """Start in water in front of a thin film of air; beyond the critical angle nothing passes."""
    film = 0.125
    world = _before_chart((_slab(20.0, 60.0), WATER), (_slab(60.0 + film, 65.0), GLASS))
    o, d = _away(20_000, 89.0, 33)
    o[:, 2] = -30.0
    paths = trace(world, o, d, split="transmit")
    walls = [Interface(np.inf, 60.0, 1.0), Interface(np.inf, 60.0 + film, GLASS), Interface(np.inf, 65.0, 1.0)]
    true = through(walls, _mirrored(o), _mirrored(d), WATER)
    truth = _mirrored(at_plane(true.p, true.d, -CHART_AT))
    # Reflected light leaves the water at its sides, metres away; light near the critical angle lands there too.
    with np.errstate(invalid="ignore"):
        through_film = np.linalg.norm(truth[:, :2], axis=1) < SIDES
    turned = np.isnan(truth).any(axis=1)
    landed = (paths.status == Status.TARGET) & (np.abs(paths.position[:, :2]).max(axis=1) < SIDES)
    error = np.linalg.norm(paths.position - truth, axis=1)[through_film].max(initial=0.0)
    return outcome(
        paths,
        f"{int(through_film.sum())} of {len(o)} rays reach the chart, within 1e-9 mm; {int(turned.sum())} never",
        f"{int(landed[through_film].sum())} do, {int(landed[turned].sum())} others; error {error:.1e} mm",
        bool(landed[through_film].all()) and not landed[turned].any() and len(paths) == len(o) and error <= 1e-9,
    )


@case
def glass_from_clear_to_black() -> Outcome:
    """Look through plates that absorb almost none or all of the light, at angles up to 89 degrees."""
    thickness, o, d = 5.0, *_away(2_000, 89.0, 34)
    cosine = np.sqrt(1.0 - (1.0 - d[:, 2] ** 2) / GLASS**2)
    behind = through([Interface(np.inf, 20.0, GLASS), Interface(np.inf, 25.0, 1.0)], _mirrored(o), _mirrored(d))
    worst, traces = 0.0, []
    for alpha in (0.0, 5e-324, 1e-18, 1e-6, 1.0, 140.0, 1e15):
        plate = Refractor(box_mm=(2 * SIDES, 2 * SIDES, thickness), index=GLASS, absorption_per_mm=alpha)
        target = Target(refractor=plate, position_mm=(0.0, 0.0, -20.0 - 0.5 * thickness))
        traces.append(trace(build(lens_scene(SINGLET, targets=(target,))), o, d, split="transmit"))
        got = np.bincount(traces[-1].source, traces[-1].weight, minlength=len(o))
        depth = np.minimum(alpha * thickness / cosine, 800.0)
        true = behind.weight * np.exp(-depth)
        # The rounding of the exponent carries over to the product; digits are lost below the smallest normal number.
        worst = max(worst, float((np.abs(got - true) / (1e-300 + true * (1.0 + depth))).max()))
    return outcome(
        traces, "T² exp(−α d / cos θ') at seven α from 0 to 1e15 per mm, within 1e-11",
        f"within {worst:.1e}; {len(traces[-1])} rays come through the blackest plate",
        worst <= 1e-11 and len(traces[-1]) == 0,
    )  # fmt: skip


@case
def total_reflection_in_absorbing_glass() -> Outcome:
    """Send light through a bar by total reflection: it decays with path length, not with events."""
    length, index, alpha, count = 200.0, 1.7, 0.01, 500
    bar = Refractor(box_mm=(2.0, 3.0, length), index=index, absorption_per_mm=alpha)
    target = Target(refractor=bar, position_mm=(0.0, 0.0, -300.0))
    _, d = _away(count, 70.0, 35)
    entry = np.column_stack([disk(0.9, count, 36), np.full(count, 0.5 * length - 300.0)])
    paths = trace(build(lens_scene(SINGLET, targets=(target,))), entry - d, d, split="transmit", max_events=200)
    out = np.abs(paths.position[:, 2] + 300.0 + 0.5 * length) < 1e-9
    ends = through([Interface(np.inf, 1.0, index), Interface(np.inf, 2.0, 1.0)], np.zeros((count, 3)), _mirrored(d))
    cosine = np.sqrt(1.0 - (1.0 - d[:, 2] ** 2) / index**2)
    true = ends.weight * np.exp(-alpha * length / cosine)
    loss = np.abs(np.bincount(paths.source[out], paths.weight[out], minlength=count) / true - 1.0).max()
    return outcome(
        paths, f"{count} rays come out, their power within 1e-10",
        f"{int(out.sum())} do, after up to {int(paths.events.max(initial=0))} events; error {loss:.1e}",
        int(out.sum()) == count and loss <= 1e-10,
    )  # fmt: skip
