"""Facets lie on the hollow side of their curved patches: rays that pass between the two are not lost."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf

Array = NDArray[np.float64]

RADIUS = 8.0
INDEX = 1.5
BALL_AT = np.array([0.0, 0.0, -60.0])
FACE = {"radius_mm": 30.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 2.0, "stop": True}
SMALL_LENS = {"surfaces": [FACE, {"radius_mm": -30.0, "semi_diameter_mm": 2.0}]}
LEVELS = ("exact", "patch")
SENSOR = {"pixels": [400, 400], "pixel_mm": 1.0, "distance_mm": 10.0}


def around(draw: np.random.Generator, centre: Array, distance: Array) -> tuple[Array, Array]:
    """Return rays from all sides that pass a point at given distances (n,)."""
    ways, aside = draw.normal(size=(2, len(distance), 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    aside = np.cross(ways, aside)
    aside *= (distance / np.linalg.norm(aside, axis=1))[:, None]
    return centre + aside - 4.0 * RADIUS * ways, ways


def tangents(draw: np.random.Generator, radius: float, semi: float, depth: Array) -> tuple[Array, Array]:
    """Return tangents of a sphere with its vertex at the origin, moved into it: points, (n, 3) mm, and directions."""
    r, phi = semi * np.sqrt(draw.random(len(depth))), draw.uniform(0.0, 2.0 * np.pi, len(depth))
    points = np.column_stack([r * np.cos(phi), r * np.sin(phi), radius - np.sqrt(radius**2 - r * r)])
    normals = (points - [0.0, 0.0, radius]) / radius
    ways = np.cross(normals, draw.normal(size=points.shape))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    return points - depth[:, None] * normals, ways


def events_of(paths: lf.Paths, count: int) -> NDArray[np.int64]:
    """Return the number of interfaces that each of some rays met."""
    events = np.zeros(count, np.int64)
    np.maximum.at(events, paths.source, paths.events)
    return events


def ball(folder: Path, divisions: int, radius: float, **changes: Any) -> dict[str, Any]:
    """A ball of glass as a file of facets, whose normals are estimated."""
    path = folder / f"ball_{divisions}_{radius:g}.stl"
    trimesh.creation.icosphere(divisions, radius).export(path)
    glass = {"file": str(path), "units": "mm", "index": INDEX, "crease_deg": 179.0}
    return {"refractor": glass | changes, "position_mm": tuple(BALL_AT)}


def world_of(*targets: dict[str, Any]) -> lf.World:
    camera = {"focus_mm": 100.0, "lens": SMALL_LENS, "sensor": {"pixels": [8, 8], "pixel_mm": 0.05}}
    return lf.build(lf.Scene(camera=camera, targets=list(targets), transport={"threads": 1}), aimed=False)


@pytest.mark.parametrize(("divisions", "inner"), [(1, 0.9), (2, 0.98), (3, 0.99)])
def test_rays_that_graze_a_ball_of_patches_are_bent_by_it(divisions: int, inner: float, tmp_path: Path) -> None:
    """Of 1,280 facets, by their chords alone a quarter of these rays goes straight on; of 80, two thirds."""
    draw = np.random.default_rng(divisions)
    # Patches of normals that are not quite the sphere's lie a little inside.
    beside = np.sqrt(draw.uniform(inner**2, 0.999**2, 20_000)) * RADIUS
    rays = around(draw, BALL_AT, beside)
    paths = lf.trace(world_of(ball(tmp_path, divisions, RADIUS)), *rays, split="transmit")
    assert (events_of(paths, len(beside)) > 0).mean() > 0.998
    assert paths.ledger.lost_share == 0.0
    assert abs(paths.ledger.imbalance) < 1e-12
    turn = 2.0 * (np.arcsin(beside / RADIUS) - np.arcsin(beside / RADIUS / INDEX))
    through = paths.events == 2
    cosine = np.einsum("ij,ij->i", paths.direction[through], rays[1][paths.source[through]])
    off = np.arccos(np.clip(cosine, -1.0, 1.0)) - turn[paths.source[through]]
    assert np.sqrt(np.mean(off**2)) < 0.06 * 4.0 ** (1 - divisions)


def test_what_grazes_and_reflects_leaves_no_energy_behind(tmp_path: Path) -> None:
    """Reflected children start above the facets, and inner ones may run along the patches without a facet."""
    draw = np.random.default_rng(9)
    rays = around(draw, BALL_AT, np.sqrt(draw.uniform(0.98**2, 1.0, 3000)) * RADIUS)
    paths = lf.trace(world_of(ball(tmp_path, 2, RADIUS)), *rays, split="both", weight_cutoff=1e-4)
    assert paths.ledger.lost_share == 0.0
    assert abs(paths.ledger.imbalance) < 1e-12
    assert paths.ledger.fallbacks == 0


def in_file(path: Path, *spheres: tuple[int, float]) -> dict[str, Any]:
    """Write spheres of some divisions and radii, with their normals; a negative radius is a hollow."""
    lines, faces, first = [], [], 1
    for divisions, radius in spheres:
        sphere = trimesh.creation.icosphere(divisions, 1.0)
        for x, y, z in sphere.vertices:
            lines += [f"v {abs(radius) * x} {abs(radius) * y} {abs(radius) * z}"]
            lines += [f"vn {np.sign(radius) * x} {np.sign(radius) * y} {np.sign(radius) * z}"]
        turned = first + sphere.faces[:, :: int(np.sign(radius))]
        faces += ["f " + " ".join(f"{i}//{i}" for i in face) for face in turned]
        first += len(sphere.vertices)
    path.write_text("\n".join(lines + faces) + "\n")
    return {"refractor": {"file": str(path), "units": "mm", "index": INDEX}, "position_mm": tuple(BALL_AT)}


def test_balls_that_share_their_facets_bend_grazing_rays_as_one_surface(tmp_path: Path) -> None:
    """A ball in a hollow of its own facets: its bulge is met from the glass round it, and both are left at once."""
    inner = in_file(tmp_path / "inner.obj", (3, 0.5 * RADIUS))
    inner["refractor"] |= {"index": 1.8, "priority": 1}
    filled = in_file(tmp_path / "shell.obj", (3, RADIUS), (3, -0.5 * RADIUS))
    nested = in_file(tmp_path / "whole.obj", (3, RADIUS))
    draw = np.random.default_rng(4)
    # Refracted at the outer ball they pass the middle at 1 / INDEX of their distance.
    rays = around(draw, BALL_AT, INDEX * 0.5 * RADIUS * np.sqrt(draw.uniform(0.99**2, 0.999**2, 4000)))
    events = []
    for outer in (filled, nested):
        paths = lf.trace(world_of(inner, outer), *rays, split="transmit")
        assert paths.ledger.lost_share == 0.0
        events.append(events_of(paths, 4000))
    assert (events[1] == 4).mean() > 0.99
    assert (events[0] == events[1]).mean() > 0.999


def lens_of(surface: str) -> lf.World:
    front = {"radius_mm": 12.0, "thickness_mm": 8.0, "index": INDEX, "semi_diameter_mm": 5.5, "stop": True}
    camera = {"lens": {"surfaces": [front, {"radius_mm": -12.0, "semi_diameter_mm": 5.5}]}, "sensor": SENSOR}
    transport = {"threads": 1, "surface": surface}
    return lf.build(lf.Scene(camera=camera, transport=transport), rings=5, aimed=False)


def test_a_lens_of_patches_bends_the_grazing_rays_that_the_exact_one_bends() -> None:
    """Its chords alone let six in ten of these rays go straight on."""
    draw = np.random.default_rng(2)
    points, ways = tangents(draw, 12.0, 5.5, 10.0 ** draw.uniform(-3.0, -1.5, 5000))
    exact, patches = (lf.trace(lens_of(level), points - 40.0 * ways, ways, split="transmit") for level in LEVELS)
    assert patches.ledger.lost_share == 0.0
    assert (events_of(exact, 5000) > 0).mean() > 0.5
    assert (events_of(exact, 5000) == events_of(patches, 5000)).mean() > 0.999


def test_lenslets_of_patches_bend_the_grazing_rays_that_exact_ones_bend() -> None:
    mla = {"layout": "square", "count": [11, 11], "pitch_mm": 0.125, "radius_mm": 0.11, "index": INDEX,
           "thickness_mm": 0.5, "distance_mm": 20.0, "curved_side": "lens"}  # fmt: skip
    sensor = SENSOR | {"pixel_mm": 0.05, "distance_mm": 0.5}
    draw = np.random.default_rng(5)
    points, ways = tangents(draw, 0.11, 0.0625, 10.0 ** draw.uniform(-6.0, -3.5, 5000))
    ways *= np.copysign(1.0, ways[:, 2:])
    steep = ways[:, 2] > 0.15
    points, ways = points[steep] + [0.0, 0.0, 23.0], ways[steep]
    # From just before the layer of the lenslets.
    starts = points - (points[:, 2:] - 23.0 + 0.02) / ways[:, 2:] * ways
    found = []
    for level in LEVELS:
        camera = {"lens": SMALL_LENS, "mla": mla, "sensor": sensor}
        world = lf.build(lf.Scene(camera=camera, transport={"threads": 1, "surface": level}), aimed=False)
        paths = lf.trace(world, starts, ways, split="transmit")
        assert paths.ledger.lost_share == 0.0
        found.append(events_of(paths, len(starts)))
    assert (found[0] > 0).mean() > 0.9
    assert (found[0] == found[1]).mean() > 0.998


def test_a_ball_hides_as_much_of_a_bright_wall_whatever_its_facets(tmp_path: Path) -> None:
    """A dark glass of hardly any power: the silhouette of the chords of 320 facets is smaller by 2 %."""
    wall = {"shape": {"kind": "plane", "width_mm": 200.0, "height_mm": 200.0}, "position_mm": (0.0, 0.0, -100.0),
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}  # fmt: skip
    camera = {"focus_mm": 60.0, "lens": SMALL_LENS, "sensor": {"pixels": [12, 12], "pixel_mm": 1.6}}
    transport = {"samples": 128, "replicates": 4, "threads": 1}
    light = []
    for divisions in (2, 4):
        dark = ball(tmp_path, divisions, RADIUS, index=1.001, absorption_per_mm=20.0)
        sums = []
        for seed in range(4):
            scene = lf.Scene(camera=camera, targets=[wall, dark], transport=transport | {"seed": seed})
            sums.append(float(lf.render(scene).mean.sum()))
        light.append(sums)
    assert stats.ttest_ind(*light, equal_var=False).pvalue > 1e-3
    assert np.std(light[0]) < 0.002 * np.mean(light[0])
