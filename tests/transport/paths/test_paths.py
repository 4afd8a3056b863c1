"""The classes of paths: each recorded path is in the class that its vertices tell, and brings light there alone.

The rule is written here a second time, from the geometry of the vertices, and knows nothing of the flags that packets
carry.
"""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.transport.engine import Workspace
from lfmesh.transport.packets.packet import (
    BY_MESH,
    CURVED_FACE,
    ENDED,
    FLAT_FACE,
    NODES,
    ON_GLASS,
    ON_TARGET,
    ROULETTE,
    Event,
)
from lfmesh.transport.packets.random import run_key
from lfmesh.transport.paths.automaton import EVERY, OFF_IMAGE_PATH
from lfmesh.transport.render.tally import Film
from lfmesh.transport.settings import options_of
from lfmesh.transport.sources.pixels import PixelSource
from lfmesh.transport.sources.source import Launcher
from lfmesh.transport.tables.emitting_facets import no_emitters
from tests.cameras import biconvex
from tests.instances import instances

INDEX = 1.8
ALBEDO = 0.5
SIDE = 120
"""Pixels along each side of the sensor: each starts one path."""

LENS = biconvex(48.0, index=2.2)
STEEP = {"count": (4, 4), "pitch_mm": 0.5, "radius_mm": 0.36, "index": 1.5, "thickness_mm": 0.5, "distance_mm": 2.0}
GLOW = {"reflectance": ALBEDO, "radiance_w_m2_sr": 1.0}


def wall(width_mm: float, z_mm: float) -> dict[str, Any]:
    shape = {"kind": "plane", "width_mm": width_mm, "height_mm": width_mm}
    return {"shape": shape, "position_mm": (0.0, 0.0, z_mm), "material": GLOW}


CAMERAS: dict[str, tuple[dict[str, Any], set[str]]] = {
    # and what is to turn paths off the image path there
    "conventional": (
        {"sensor": {"pixels": (SIDE, SIDE), "pixel_mm": 2.0 / SIDE}},
        {"lens", "lens after a target", "glass", "glass after a target", "total reflection"},
    ),
    "lenslets towards the lens": (
        {"mla": STEEP, "sensor": {"pixels": (SIDE, SIDE), "pixel_mm": 2.0 / SIDE, "distance_mm": 0.6}},
        {"lens", "array"},
    ),
    "hollow lenslets, whose other side a ray may meet": (
        {
            "mla": STEEP | {"radius_mm": -0.36, "index": 1.3, "distance_mm": 0.3},
            "sensor": {"pixels": (SIDE, SIDE), "pixel_mm": 2.0 / SIDE, "distance_mm": 0.6},
        },
        {"lens", "array", "second face"},
    ),
    "lenslets towards the sensor": (
        {
            "mla": STEEP | {"curved_side": "sensor"},
            "sensor": {"pixels": (SIDE, SIDE), "pixel_mm": 2.0 / SIDE, "distance_mm": 0.6},
        },
        {"lens", "array"},
    ),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("glass")
    trimesh.creation.box((6.0, 6.0, 6.0)).export(folder / "cube.stl")
    return folder


def world_of(camera: dict[str, Any], folder: Path) -> lf.World:
    """Glowing targets that light each other before the lens, with a cube of glass between them."""
    cube = {"file": "cube.stl", "units": "mm", "index": INDEX, "surface": "flat"}
    side = {"shape": {"kind": "box", "size_mm": (6.0, 6.0, 20.0)}, "position_mm": (9.0, 0.0, -15.0), "material": GLOW}
    scene = lf.Scene(
        camera={"focus_mm": 60.0, "lens": LENS, **camera},
        targets=[
            wall(80.0, -30.0),
            side,
            {"refractor": cube, "position_mm": (0.3, 0.2, -12.0), "rotation_deg": (20.0, 30.0, 10.0)},
        ],
        transport={"split": "roulette", "weight_cutoff": 0.0, "threads": 1},
    )
    return lf.build(scene.in_folder(folder))


def traced(world: lf.World, paths: int) -> tuple[NDArray[np.float64], Workspace]:
    """Return what single paths of all pixels bring if those of a class count, (pixels,), and the workspace."""
    # Scattered packets alone find all emission, so that each packet's own vertices tell what it brings.
    objects = world.tables.objects._replace(emitters=no_emitters())
    tables = world.tables._replace(
        aim=world.aim._replace(exit=world.aim.exit._replace(wide_share=0.5)), objects=objects
    )
    options = options_of(world, faces=BY_MESH, split=ROULETTE, record=True, paths=paths)
    work = Workspace(world, options, tables=tables)
    film = Film.empty(SIDE * SIDE, 1)
    source = PixelSource(np.arange(SIDE * SIDE), 1, run_key(3), stratified=False)
    Launcher(lambda: work).trace(source, film=film)
    return film.power[:, 0], work


def vertices(nodes: NDArray[np.void], last: int) -> NDArray[np.void]:
    """Return a path's vertices, from its start on."""
    chain = []
    while last >= 0:
        chain.append(last)
        last = int(nodes["parent"][last])
    return nodes[chain[::-1]]


def turns(path: NDArray[np.void], seen: Counter[str]) -> float:
    """Return what a path gathers before it is turned off the image path, and after that; count what turned it."""
    before, after, turned, inside, scattered = 0.0, 0.0, False, False, False
    for i, vertex in enumerate(path[1:], start=1):
        surface, reflected = int(vertex["surface"]), vertex["event"] == Event.REFLECTED
        what = ""
        if surface == ON_TARGET and vertex["event"] == Event.SCATTERED:
            gathered = vertex["weight"] / ALBEDO
            before, after = before + (not turned) * gathered, after + turned * gathered
            scattered = True
        elif surface == ON_GLASS:
            if reflected:
                come, go = (np.diff(path["position"][j : j + 2], axis=0)[0] for j in (i - 1, i))
                if not go.any():
                    # It has been reflected to and fro for so long that it is cut.
                    break
                come, go = come / np.linalg.norm(come), go / np.linalg.norm(go)
                cosine = abs(come @ (go - come)) / np.linalg.norm(go - come)
                total = inside and INDEX * np.sqrt(1.0 - cosine**2) > 1.0
                seen["total reflection"] += total
                what = "" if total else "glass"
            else:
                inside = not inside
        elif surface == CURVED_FACE:
            what = "array" if reflected else "second face" if path["surface"][i - 1] == CURVED_FACE else ""
        elif surface == FLAT_FACE:
            what = "array" if reflected else ""
        elif 0 <= surface < CURVED_FACE:
            what = "lens" if reflected else ""
        if what and not turned:
            turned = True
            seen[what + (" after a target" if scattered else "")] += 1
    return before, after


@pytest.mark.parametrize("name", instances(CAMERAS, long=["lenslets towards the lens"]))
def test_every_path_brings_light_in_the_class_that_its_vertices_tell(name: str, folder: Path) -> None:
    camera, kinds = CAMERAS[name]
    world = world_of(camera, folder)
    every, work = traced(world, EVERY)
    turned_off, _ = traced(world, OFF_IMAGE_PATH)
    ended, nodes = work.ended[: work.tops[ENDED]], work.nodes[: work.tops[NODES]]
    assert len(np.unique(ended["source"])) == len(ended)
    seen: Counter[str] = Counter()
    gathered = np.zeros((SIDE * SIDE, 2))
    for end in ended:
        gathered[end["source"]] = turns(vertices(nodes, int(end["node"])), seen)
    np.testing.assert_allclose(turned_off, gathered[:, 1], rtol=1e-12)
    np.testing.assert_allclose(every, gathered.sum(axis=1), rtol=1e-12)
    assert kinds <= {kind for kind, number in seen.items() if number}, seen
    assert min(np.count_nonzero(gathered, axis=0)) > 100
