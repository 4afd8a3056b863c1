"""Paths through media that bend light: curves are drawn, and count as one passage."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.transport.packets.packet import Event
from lfmesh.view.rays.filters import parse
from lfmesh.view.rays.history import history, lines
from lfmesh.view.rays.launch import from_field_point, from_pixel
from lfmesh.view.rays.paths import Rays
from tests.cameras import camera_without_array

SLOPE, LONG_MM, MIDDLE_MM = 4e-5, 60.0, 100.0
"""dn/dy per mm of the gas, its length along the axis, and its distance."""


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> lf.World:
    """A camera that looks through gas with a uniform gradient of its index along y: rays are parabolas."""
    folder: Path = tmp_path_factory.mktemp("gas")
    y = np.linspace(-18.0, 18.0, 7)
    index = np.broadcast_to(1.0 + SLOPE * y[None, :, None], (7, 7, 11))
    np.savez(folder / "gas.npz", index=index, spacing_mm=[6.0, 6.0, 6.0])
    gas = {
        "name": "gas",
        "grid": "gas.npz",
        "bounds": {"kind": "box", "size_mm": [36.0, 36.0, LONG_MM]},
        "position_mm": [0.0, 0.0, -MIDDLE_MM],
    }
    chart = {"shape": {"kind": "plane", "width_mm": 60.0, "height_mm": 60.0}, "position_mm": [0.0, 0.0, -300.0]}
    settings = {"split": "transmit", "threads": 1}
    scene = lf.Scene(camera=camera_without_array(), media=[gas], targets=[chart], transport=settings)  # type: ignore[arg-type]
    return lf.build(scene.in_folder(folder))


@pytest.fixture(scope="module")
def rays(world: lf.World) -> Rays:
    return from_field_point(world, (0.0, 0.0, -250.0), 12, split="transmit")


def sags(line: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the places of the inner points of a line along its chord, (n,) mm, and their distances from it."""
    along = (line[-1] - line[0]) / np.linalg.norm(line[-1] - line[0])
    away = line[1:-1] - line[0]
    return away @ along, np.linalg.norm(away - (away @ along)[:, None] * along, axis=1)


def in_gas(rays: Rays, path: int) -> int:
    """Return the vertex at which a path enters the gas."""
    first = int(rays.offsets[path])
    return next(k for k in range(first, int(rays.offsets[path + 1])) if rays.bends[k])


def test_lines_are_the_parabolas_of_the_rays(rays: Rays) -> None:
    """With the curvature κ, a point at s of a chord of length L is κ s (L − s)/2 beside it."""
    for path in range(len(rays)):
        vertex = in_gas(rays, path)
        curve = rays.curves(np.array([vertex]))[vertex]
        length = np.linalg.norm(curve[-1] - curve[0])
        assert length == pytest.approx(LONG_MM, rel=0.01)
        at, sag = sags(curve)
        np.testing.assert_allclose(sag, 0.5 * SLOPE * at * (length - at), rtol=0.01)
        line = rays.line(path)
        assert len(line) == int(np.diff(rays.offsets)[path]) + int(rays.bends[vertex])


def test_a_passage_is_two_faces_and_no_more(rays: Rays) -> None:
    assert all(sequence.startswith("gas T, gas T, ") for sequence in rays.sequences)
    assert (np.isin(rays.event, [Event.BENT])).sum() == 0
    faces = rays.surface == rays.surfaces.index("gas")
    assert (rays.count_vertices(faces) == 2).all()
    assert parse("hits(gas) and transmits(gas)", rays).all()
    assert not parse("reflects(gas)", rays).any()


def test_chosen_paths_keep_their_curves(rays: Rays) -> None:
    chosen = np.arange(len(rays)) % 3 == 1
    kept = rays.keep(chosen)
    for path, number in enumerate(np.flatnonzero(chosen)):
        np.testing.assert_array_equal(kept.line(path), rays.line(int(number)))


def test_the_history_names_the_gas(rays: Rays) -> None:
    text = "\n".join(lines(history(rays, 0), rays.unit))
    assert text.count("gas") == 2


def test_rays_from_a_pixel_are_curves_as_well(world: lf.World) -> None:
    back = from_pixel(world, 0, 0, 8, split="transmit")
    out = np.flatnonzero(back.arrives)
    assert len(out)
    assert all(back.bends[in_gas(back, int(path))] > 0 for path in out)


def test_recorded_vertices_of_a_trace_name_the_points_of_a_curve(world: lf.World) -> None:
    paths = lf.trace(world, [[0.0, 1.0, -200.0]], [[0.0, 0.0, 1.0]], split="transmit", record=True)
    vertices = paths.vertices(0)
    bent: list[Any] = [vertex for vertex in vertices if vertex.event == lf.Event.BENT]
    assert bent
    z = [vertex.position[2] for vertex in bent]
    assert all(-MIDDLE_MM - 0.5 * LONG_MM < each < -MIDDLE_MM + 0.5 * LONG_MM for each in z)


def test_layouts_draw_the_curves(world: lf.World, tmp_path: Path) -> None:
    lf.draw(world.scene, tmp_path / "layout.svg")
    assert (tmp_path / "layout.svg").stat().st_size > 0
