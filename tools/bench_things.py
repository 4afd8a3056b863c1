"""Scenes of many things, for `tools/bench scaling`: time and memory from the scene to its image, in a fresh process.

A row is a function from a number of things, and the folder where meshes lie, to what changes in the scene of the small
camera (16 × 16 lenslets, 160 × 160 pixels, 8 samples); it stands in `THINGS` with its sizes. Kernels are loaded before
the clock starts. The same scene is then rendered again, which should build nothing. The error of the image, the root
mean square of the pixels' standard errors over their mean, tells what the time was spent on. `GOALS` are compared with
the rows that are measured.
"""

import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from bench_report import peak_mib

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene import Scene
from lfmesh.transport.build import world_of

AWAY_MM = 500.0
ACROSS_MM = 100.0
"""Width of the square that parts stand in."""

ROUGHNESSES = (0.2, 0.3, 0.4, 0.5)

COLUMNS = {
    "thing": ("many", ""),
    "size": ("number", ",d"),
    "seconds": ("build + render s", ".2f"),
    "again_seconds": ("again s", ".2f"),
    "processor_s": ("of processor", ".2f"),
    "error_percent": ("error of a pixel %", ".3f"),
    "peak_mib": ("peak MiB", ".0f"),
    "builds_again": ("builds again", "d"),
}
GOAL_COLUMNS = {
    "goal": ("goal", ""),
    "measured": ("measured", ".2f"),
    "most": ("at most", ".2f"),
    "met": ("met", ""),
}
EXPONENT_COLUMNS = {"thing": ("build + render against", ""), "exponent": ("exponent", ".3f"), "error": ("±", ".3f")}


@dataclass(frozen=True)
class Things:
    """One kind of thing that a scene can have many of.

    Attributes
    ----------
    sizes, quick : tuple of int
    changes : callable
        From a number, and the folder where meshes lie, to what changes in the scene.
    """

    sizes: tuple[int, ...]
    quick: tuple[int, ...]
    changes: Callable[[int, Path], dict[str, Any]]


def parts(number: int, folder: Path) -> dict[str, Any]:
    """Put glossy parts of a GLB file side by side, every one with a colour of its own."""
    file = folder / f"parts_{number}.glb"
    if not file.exists():
        _write_parts(number, file)
    return {"targets": [{"file": str(file), "node": f"part {i}"} for i in range(number)]}


def _write_parts(number: int, file: Path) -> None:
    draw = np.random.default_rng(64)
    side = int(np.ceil(np.sqrt(number)))
    step = 1e-3 * ACROSS_MM / side
    scene = trimesh.Scene()
    for i in range(number):
        ball = i % 2 == 0
        mesh = trimesh.creation.icosphere(2, 0.4 * step) if ball else trimesh.creation.box(extents=[0.6 * step] * 3)
        mesh.visual = trimesh.visual.TextureVisuals(
            material=trimesh.visual.material.PBRMaterial(
                name=f"material {i}",
                baseColorFactor=np.append(draw.integers(30, 255, 3), 255).astype(np.uint8),
                metallicFactor=float(draw.uniform()),
                roughnessFactor=ROUGHNESSES[i % len(ROUGHNESSES)],
            )
        )
        place = trimesh.transformations.random_rotation_matrix(draw.uniform(size=3))
        place[:3, 3] = *((np.array([i % side, i // side]) - 0.5 * (side - 1)) * step), -1e-3 * AWAY_MM
        scene.add_geometry(mesh, node_name=f"part {i}", geom_name=f"mesh {i}", transform=place)
    scene.export(file)


def facets(number: int, folder: Path) -> dict[str, Any]:
    """Divide a surface with some relief, as a scanner finds it, into at least so many facets."""
    file = folder / f"facets_{number}.stl"
    if not file.exists():
        cells = int(np.ceil(np.sqrt(number / 2)))
        x, y = np.meshgrid(*[np.linspace(-0.5, 0.5, cells + 1) * ACROSS_MM] * 2, indexing="ij")
        points = np.stack([x, y, np.sin(0.3 * x) * np.cos(0.2 * y)], axis=-1).reshape(-1, 3)
        corner = np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)
        a, b, c, d = (corner + step for step in (0, cells + 1, cells + 2, 1))
        faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)
        trimesh.Trimesh(points, faces, process=False).export(file)
    return {"targets": [{"file": str(file), "units": "mm", "position_mm": [0.0, 0.0, -AWAY_MM]}]}


def lamps(number: int, _: Path) -> dict[str, Any]:
    """Light a white wall by lamps that share the power of one: a disk of them beside the camera, as if it were lit."""
    r, phi = 80.0 * np.sqrt((np.arange(number) + 0.5) / number), np.arange(number) * np.pi * (3.0 - np.sqrt(5.0))
    places = np.column_stack([r * np.cos(phi) - 200.0, r * np.sin(phi) + 200.0, np.full(number, -200.0)])
    side = 2.0 * ACROSS_MM
    wall = {"shape": {"kind": "plane", "width_mm": side, "height_mm": side}, "position_mm": [0.0, 0.0, -AWAY_MM]}
    return {
        "targets": [wall | {"material": {"reflectance": 0.8}}],
        "lights": [{"kind": "point", "position_mm": place, "power_w": 1.0 / number} for place in places.tolist()],
    }


def spheres(number: int, _: Path) -> dict[str, Any]:
    """Put spheres side by side, of three sizes."""
    side = int(np.ceil(np.sqrt(number)))
    step = ACROSS_MM / side
    place = step * (np.stack(np.divmod(np.arange(number), side)[::-1], axis=1) - 0.5 * (side - 1))
    return {
        "targets": [
            {
                "shape": {"kind": "sphere", "radius_mm": step * (0.25, 0.35, 0.45)[i % 3]},
                "position_mm": [*place[i].tolist(), -AWAY_MM],
            }
            for i in range(number)
        ]
    }


THINGS = {
    "lamps": Things((1, 10, 100, 1_000, 10_000), (1, 20), lamps),
    "spheres": Things((1, 30, 100, 500, 2_000), (1, 10), spheres),
    "parts": Things((1, 10, 100, 500, 2_000), (1, 10), parts),
    "facets": Things((100_000, 300_000, 1_000_000, 2_000_000, 4_000_000), (1_000, 10_000), facets),
}


@dataclass(frozen=True)
class Goal:
    """Largest value that a figure of a row may have.

    Attributes
    ----------
    thing, number
        Of the row.
    words : str
    most : float
    figure : callable
        From the rows of a thing, by their numbers, and the number, to the figure.
    """

    thing: str
    number: int
    words: str
    most: float
    figure: Callable[[Mapping[int, Mapping[str, Any]], int], float]


def _seconds(rows: Mapping[int, Mapping[str, Any]], number: int) -> float:
    return float(rows[number]["seconds"])


def _peak_gib(rows: Mapping[int, Mapping[str, Any]], number: int) -> float:
    return float(rows[number]["peak_mib"]) / 1024.0


def _to_equal_error(rows: Mapping[int, Mapping[str, Any]], number: int) -> float:
    """Return the time of a row over that of one thing, as if both had rendered to the error of that one."""
    row, one = rows[number], rows[1]
    build = row["seconds"] - row["again_seconds"]
    samples = (row["error_percent"] / one["error_percent"]) ** 2
    return float((build + samples * row["again_seconds"]) / one["seconds"])


GOALS = (
    Goal("lamps", 1_000, "time to equal error, over that of one", 4.0, _to_equal_error),
    Goal("lamps", 1_000, "peak GiB", 1.0, _peak_gib),
    Goal("spheres", 2_000, "build + render s", 6.0, _seconds),
    Goal("spheres", 2_000, "peak GiB", 1.0, _peak_gib),
    Goal("parts", 500, "build + render s", 3.0, _seconds),
    Goal("facets", 2_000_000, "build + render s", 6.0, _seconds),
    Goal("facets", 2_000_000, "peak GiB", 1.2, _peak_gib),
)


def goals_of(thing: str, rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Compare the rows of a thing with the goals that name them, and tell how many were built again."""
    known = {row["size"]: row for row in rows}
    compared = [
        (f"{goal.number:,} {thing}: {goal.words}", goal.figure(known, goal.number), goal.most)
        for goal in GOALS
        if goal.thing == thing and goal.number in known
    ]
    again = float(sum(row["builds_again"] for row in rows))
    compared.append((f"{thing}: scenes that a second render built again", again, 0.0))
    return [
        {"goal": words, "measured": measured, "most": most, "met": "yes" if measured <= most else "no"}
        for words, measured, most in compared
    ]


def scene_of(thing: str, number: int, folder: Path) -> Scene:
    """Return the scene of the small camera with a number of things."""
    return lf.load(asset_path("scenes/emitting_plane.toml")).changed(
        {
            "camera.mla.count": [16, 16],
            "camera.mla.pitch_mm": 0.5,
            "camera.mla.focal_length_mm": 2.0,
            "camera.mla.thickness_mm": 1.2,
            "camera.mla.distance_mm": None,
            "camera.sensor.distance_mm": None,
            "camera.sensor.pixels": [160, 160],
            "camera.sensor.pixel_mm": 0.05,
            "lights": [{"kind": "point", "position_mm": [-200.0, 300.0, -200.0], "power_w": 1.0}],
            "transport.samples": 8,
            "transport.replicates": 2,
        }
        | THINGS[thing].changes(number, folder)
    )


def measure_things(thing: str, number: int, folder: str) -> dict[str, float]:
    """Render in this process, twice; return the seconds of both, those of the processor, and the peak memory."""
    warnings.simplefilter("ignore", lf.PictureWarning)  # of few samples, which the error tells
    scene = scene_of(thing, number, Path(folder))
    lf.render(scene_of(thing, THINGS[thing].quick[0], Path(folder)).changed({"camera.sensor.pixels": [8, 8]}))
    began, processor = time.perf_counter(), time.process_time()
    # Held, as a large one is kept by nobody else.
    world = lf.build(scene)
    image = lf.render(scene)
    seconds, processor = time.perf_counter() - began, time.process_time() - processor
    began = time.perf_counter()
    lf.render(scene, world=world)
    again = time.perf_counter() - began
    peak = peak_mib()
    builds_again = world_of(scene).tables is not world.tables
    error = 100.0 * float(np.sqrt(np.mean(image.stderr**2)) / np.mean(image.mean))
    took = {"seconds": seconds, "again_seconds": again, "processor_s": processor}
    return took | {"error_percent": error, "peak_mib": peak, "builds_again": int(builds_again)}


def exponent_of(thing: str, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Fit time ∝ number^exponent through the three largest numbers, where fixed costs are least."""
    largest = sorted(rows, key=lambda row: row["size"])[-3:]
    x, y = np.log([row["size"] for row in largest]), np.log([row["seconds"] for row in largest])
    slope = float(np.polyfit(x, y, 1)[0])
    error = None
    if len(largest) > 2:
        rest = y - np.polyval(np.polyfit(x, y, 1), x)
        error = float(np.sqrt((rest @ rest) / (len(x) - 2) / ((x - x.mean()) ** 2).sum()))
    return {"thing": thing, "exponent": slope, "error": error}
