"""Rough, coated and polarising interfaces, and spectral bands, at their limits."""

import tempfile
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from lfmesh.accuracy.hard.outcome import SINGLET, Outcome, case, lens_scene, outcome
from lfmesh.kernels.decorators import kernel
from lfmesh.optics.cie import planck_radiance
from lfmesh.optics.coatings import Stack, coated
from lfmesh.optics.fresnel import fresnel
from lfmesh.optics.polarisation import bare_interface, coated_interface
from lfmesh.scene import Refractor, Target
from lfmesh.scene.materials.finishes import SMOOTHEST
from lfmesh.transport.build import build
from lfmesh.transport.events.ground import ground_direction
from lfmesh.transport.packets.random import derived, run_key, uniform
from lfmesh.transport.tables.lines import Lines
from lfmesh.transport.trace import trace

DRAWN = 20_000
INDICES = (1.01, 4.0)
MOST_SIGMAS = 4.5
"""With twenty values, one is that far off once in 7000 runs."""

GRAZING = 10.0 ** np.arange(-1.0, -10.5, -1.0)
"""Cosines of angles of incidence, down to grazing."""


@kernel
def _ground(alpha: float, n_i: float, n_t: float, z: NDArray, key: np.uint64, found: NDArray) -> None:  # type: ignore[type-arg]
    """Write the directions (n, 3) of light behind ground glass, by cosines of incidence (n,); NaN on a wrong side."""
    for i in range(len(found)):
        own = derived(key, i)
        across = np.sqrt(1.0 - z[i] * z[i])
        arriving = across, 0.0, -z[i]
        passes, x, y, w = ground_direction(alpha, n_i, n_t, arriving, uniform(own, -1), uniform(own, -2), own)
        found[i, 0], found[i, 1], found[i, 2] = x, y, w if passes == (w < 0.0) else np.nan


@case
def ground_at_its_ends() -> Outcome:
    """Illuminate ground glass of extreme roughness, index 1.01 and 4, on both sides, down to grazing."""
    found, wrong, worst, seed = np.empty((DRAWN, 3)), 0, 0.0, 0
    even = np.sqrt((np.arange(DRAWN) + 0.5) / DRAWN)
    for index in INDICES:
        for alpha in (SMOOTHEST, 1.0):
            passed = []
            for n_i, n_t in ((1.0, index), (index, 1.0)):
                for z in (np.resize(GRAZING, DRAWN), even):
                    seed += 1
                    _ground(alpha, n_i, n_t, z, run_key(seed), found)
                    # The negated comparison counts NaN as wrong.
                    wrong += int((~(np.abs((found**2).sum(axis=1) - 1.0) < 1e-12)).sum())
                passed.append((found[:, 2] < 0.0).mean())
            # Uniform light passes equally in either direction: n² T is the same from both sides.
            into, out = passed[0], index * index * passed[1]
            sigma = np.sqrt((passed[0] * (1.0 - passed[0]) + index**4 * passed[1] * (1.0 - passed[1])) / DRAWN)
            worst = max(worst, abs(into - out) / max(sigma, 1.0 / DRAWN))
    return Outcome(
        "", "unit directions on their side; n² T alike from both sides",
        f"{wrong} wrong directions; n² T off by {worst:.1f} σ", wrong == 0 and bool(worst < MOST_SIGMAS),
        0.0, float(seed * DRAWN), 0,
    )  # fmt: skip


def _grazed(finish: object) -> Outcome:
    """Trace rays that graze a plate of rough glass from outside, and check that they keep all weight."""
    ends, count = [], 20 * len(GRAZING)
    for index in INDICES:
        with tempfile.TemporaryDirectory(prefix="lfmesh-") as folder:
            trimesh.creation.box((40.0, 40.0, 3.0)).export(Path(folder) / "plate.stl")
            glass = Refractor.model_validate(
                {"file": "plate.stl", "units": "mm", "index": index, "finish": finish, "surface": "flat"}
            )
            body = Target(refractor=glass, position_mm=(0.0, 0.0, -60.0))
            world = build(lens_scene(SINGLET, targets=(body,)).in_folder(Path(folder)))
        cosine = np.repeat(GRAZING, 20)
        turn = np.linspace(0.0, 2.0 * np.pi, count)
        across = np.sqrt(1.0 - cosine**2)
        d = np.column_stack([across * np.cos(turn), across * np.sin(turn), -cosine])
        ends.append(trace(world, np.array([0.0, 0.0, -58.5]) - 5.0 * d, d, split="transmit", max_events=32_000))
    met = [int((paths.events > 0).sum()) for paths in ends]
    # Only light that enters the lens, beyond z = 0, loses weight there.
    whole = [int(((paths.weight == 1.0) | (paths.position[:, 2] > 0.0)).sum()) for paths in ends]
    unscathed = [int((paths.weight == 1.0).sum()) for paths in ends]
    at_depth = sum(paths.ledger.depth for paths in ends)
    return outcome(
        ends, f"{count} rays of each index meet the plate, and leave it whole",
        f"{met} meet it, {whole} leave it whole, {at_depth:g} cut by depth",
        met == whole == [count] * len(ends) and at_depth == 0.0 and min(unscathed) > 0.9 * count,
    )  # fmt: skip


@case
def diffuse_grazed() -> Outcome:
    """Graze a plate of diffuse glass of index 1.01 and 4, down to 1e-10 rad."""
    return _grazed("diffuse")


@case
def ground_grazed() -> Outcome:
    """Graze a plate of the roughest ground glass of index 1.01 and 4, down to 1e-10 rad."""
    return _grazed({"kind": "ground", "roughness": 1.0})


@case
def coating_at_its_ends() -> Outcome:
    """Meet stacks of 1000 layers, films without effect and 1 mm of metal, at grazing and near the critical angle."""
    cosine = np.concatenate([[1.0], GRAZING])
    error = 0.0
    for n_i, n_t in ((1.0, 1.5), (1.5, 1.0), (4.0, 1.01)):
        critical = np.sqrt(np.maximum(1.0 - (n_t / n_i) ** 2, 0.0))
        beside = critical + np.array([-1e-6, -1e-9, -1e-12, 1e-12, 1e-9, 1e-6]) if n_i > n_t else np.empty(0)
        angles = np.concatenate([cosine, beside])
        bare = np.array([fresnel(n_i, n_t, float(c))[:2] for c in angles]).T
        for film in (Stack((complex(n_i),), (1e6,)), Stack((complex(n_t),), (137.0,)), Stack((2.0 + 0j,), (1e-12,))):
            shares = np.array(coated(n_i, n_t, film, 550.0, angles))
            # A film of one of the media, or one far thinner than an atom, has no effect.
            error = max(error, float(np.abs(shares - bare)[:, np.abs(angles - critical) > 1e-8].max()))
        many = Stack((2.3 + 0j, 1.38 + 0j) * 500, (61.0, 99.0) * 500)
        error = max(error, float(np.abs(np.sum(coated(n_i, n_t, many, 550.0, angles), axis=0) - 1.0).max()))
        metal = coated(n_i, n_t, Stack((0.9 + 6.2j,), (1e6,)), 550.0, angles)
        error = max(error, float(metal[1].max()), float(np.maximum(metal[0] - 1.0, -metal[0]).max()))
    return Outcome(
        "", "R and T of the bare face, R + T = 1, nothing through metal, to 1e-9", f"off by {error:.1e}",
        bool(error < 1e-9), 0.0, 1.0, 0,
    )  # fmt: skip


@case
def polarisation_at_its_ends() -> Outcome:
    """Meet bare and coated faces with polarised light at grazing, near Brewster's and the critical angle."""
    nothing, film = np.zeros((1, 1), np.complex128), np.array([[1.9 + 0j]])
    error, states = 0.0, 0
    for n_i, n_t in ((1.0, 1.01), (1.0, 4.0), (4.0, 1.0), (1.01, 1.0), (1.5, 1.5)):
        special = [1.0, 1.0 / np.hypot(1.0, n_t / n_i), np.sqrt(max(1.0 - (n_t / n_i) ** 2, 0.0))]
        near = [c + off for c in special for off in (-1e-9, -1e-12, 0.0, 1e-12, 1e-9)]
        for cosine in [c for c in (*near, *GRAZING) if 0.0 < c <= 1.0]:
            for ways in (
                bare_interface(n_i, n_t, cosine),
                coated_interface(n_i, n_t, cosine, nothing, np.zeros(1), 0, 0, 0, False, 550.0),
                coated_interface(n_i, n_t, cosine, film, np.array([77.0]), 0, 0, 1, False, 550.0),
            ):
                back, on = ways
                states += 1
                off = [back.s + on.s - 1.0, back.p + on.p - 1.0]
                # Completely polarised light stays so: |ρ|² is the product of both fractions.
                off += [way.real**2 + way.imaginary**2 - way.s * way.p for way in ways]
                off += [max(-share, share - 1.0, 0.0) for way in ways for share in (way.s, way.p)]
                error = max(error, *(abs(value) if np.isfinite(value) else np.inf for value in off))
    return Outcome(
        "", "S and P of both ways sum to 1 and pure states stay pure, to 1e-12", f"off by {error:.1e}",
        bool(error < 1e-12), 0.0, float(states), 0,
    )  # fmt: skip


@case
def bands_at_their_ends() -> Outcome:
    """Draw wavelengths in bands of 1e-6 to 400 nm, and evaluate black bodies of 3 to 1e6 K."""
    worst, wrong, count = 0.0, 0, 0
    for width in (1e-6, 1e-3, 1.0, 400.0):
        scene = lens_scene(SINGLET).changed(
            {"camera.sensor.bands": [{"name": "band", "center_nm": 800.0, "fwhm_nm": width}]}
        )
        lines = Lines.of(scene)
        w = np.array(lines.wavelengths_nm)
        first, last = scene.reach_nm
        wrong += int(((w < first) | (w > last) | ~np.isfinite(lines.weight_nm) | (lines.weight_nm <= 0.0)).sum())
        wrong += int((np.diff(w) < 0.0).sum())
        centroid = scene.passbands[0].response.centroid_nm
        # Pairs are symmetric in equal parts of the integral, so their mean is off by a small part of the width.
        worst = max(worst, abs(float(w.mean()) - centroid) / width)
        for kelvin in (3.0, 1e6):
            radiance = planck_radiance(w, kelvin)
            wrong += int((~np.isfinite(radiance) | (radiance < 0.0)).sum())
        count += len(w)
    return Outcome(
        "", "wavelengths in their band, with its centroid to 2 % of the width, and finite radiances",
        f"{wrong} wrong of {count}; centroid off by {worst:.1e} widths", wrong == 0 and bool(worst < 0.02),
        0.0, float(count), 0,
    )  # fmt: skip
