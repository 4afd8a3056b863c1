"""Meshes and scenes that are arranged otherwise hold what they held."""

import numpy as np
import pytest
import trimesh

import lfmesh as lf
from tests.cameras import camera_without_array
from tests.random_scenes.draft import Tables
from tests.random_scenes.judge import Estimate, judge
from tests.random_scenes.meshes import Facets, as_meshes, folded, in_another_order, in_four, of_shape, one_divided
from tests.random_scenes.pairs import ies_file
from tests.random_scenes.rearranged import halved_lamps, halved_media
from tests.random_scenes.transforms import moved

SHAPES: list[Tables] = [
    {"kind": "plane", "width_mm": 3.0, "height_mm": 2.0},
    {"kind": "disk", "radius_mm": 1.5},
    {"kind": "sphere", "radius_mm": 1.5},
    {"kind": "box", "size_mm": [1.0, 2.0, 3.0]},
    {"kind": "cylinder", "radius_mm": 1.0, "height_mm": 3.0},
]
TILT, SHIFT = [70.0, -40.0, 130.0], [5.0, -2.0, 3.0]


def solid(mesh: Facets) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape["kind"])
def test_a_divided_or_permuted_mesh_is_the_same_surface(shape: Tables) -> None:
    whole, draw = of_shape(shape), np.random.default_rng(1)
    assert solid(whole).is_volume or shape["kind"] in ("plane", "disk")
    faces = len(whole.faces)
    for change, count in ((in_four, 4 * faces), (one_divided(draw), faces + 2), (in_another_order(draw), faces)):
        other = change(whole)
        assert len(other.faces) == count
        assert solid(other).area_faces.min() > 0.0
        assert solid(other).is_volume == solid(whole).is_volume
        np.testing.assert_allclose(integrals(other), integrals(whole), rtol=1e-12, atol=1e-12)


def integrals(mesh: Facets) -> list[float]:
    """Area, and the integrals of the normal and of the place over a mesh: they tell it from one of other facets."""
    surface = solid(mesh)
    areas = surface.area_faces[:, None]
    return [surface.area, *(areas * surface.face_normals).sum(axis=0), *(areas * surface.triangles_center).sum(axis=0)]


def test_a_folded_plane_has_two_facets_of_the_same_size_at_the_angle() -> None:
    sheet = solid(folded(of_shape(SHAPES[0]), 30.0))
    np.testing.assert_allclose(sheet.area_faces, 3.0, rtol=1e-12)
    np.testing.assert_allclose(np.dot(*sheet.face_normals), np.cos(np.deg2rad(30.0)), rtol=1e-12)


def test_scenes_that_are_compared_have_the_same_folds() -> None:
    scene = {"targets": [{"shape": SHAPES[0], "material": {}} for _ in range(8)]}
    seen = [as_meshes(scene, np.random.default_rng(3), change)["targets"] for change in (None, in_four)]
    areas = [[trimesh.load_mesh(target["file"]).bounds[1, 2] for target in targets] for targets in seen]
    assert 0 < np.count_nonzero(areas[0]) < 8
    np.testing.assert_allclose(*areas, rtol=1e-12)


def test_halves_of_a_medium_fill_it() -> None:
    bounds = [shape for shape in SHAPES if shape["kind"] not in ("plane", "disk")]
    found = halved_media({"media": [{"bounds": shape} for shape in bounds]})
    assert found is not None
    whole, halves = (sum(volume(medium["bounds"]) for medium in scene["media"]) for scene in found)
    assert len(found[1]["media"]) == 2 * len(bounds)
    assert halves == pytest.approx(whole, rel=1e-12)


def volume(bounds: Tables) -> float:
    match bounds:
        case {"file": file}:
            return float(trimesh.load_mesh(file).volume)
        case {"size_mm": size}:
            return float(np.prod(size))
    return float(np.pi * bounds["radius_mm"] ** 2 * bounds["height_mm"])


def test_halves_of_a_lamp_are_side_by_side() -> None:
    line = {"kind": "line", "start_mm": [0.0, 0.0, 0.0], "end_mm": [2.0, 0.0, 0.0], "power_w": 1.0}
    # Light along −y: the width is along x, and after a turn by 90 degrees along z.
    rectangle = {"kind": "rectangle", "position_mm": [0.0, 0.0, 0.0], "direction": [0.0, -1.0, 0.0], "turn_deg": 90.0,
                 "width_mm": 4.0, "height_mm": 1.0, "power_w": 1.0}  # fmt: skip
    found = halved_lamps({"lights": [line, rectangle]})
    assert found is not None
    a, b, c, d = found["lights"]
    assert (a["end_mm"], b["start_mm"]) == ([1.0, 0.0, 0.0], [1.0, 0.0, 0.0])
    np.testing.assert_allclose(np.abs([c["position_mm"], d["position_mm"]]), [[0, 0, 1], [0, 0, 1]], atol=1e-12)
    assert [lamp["power_w"] for lamp in found["lights"]] == [0.5] * 4


def test_profiles_of_lamps_turn_with_the_world() -> None:
    lamp = {"position_mm": [20.0, 22.0, -40.0], "power_w": 1.0, "profile": str(ies_file())}
    for turned in ({"kind": "point", "rotation_deg": [80.0, 20.0, 30.0]},
                   {"kind": "spot", "direction": [-20.0, -21.0, -50.0], "turn_deg": 25.0}):  # fmt: skip
        whole: Tables = {
            "camera": camera_without_array(60.0, 4), "lights": [lamp | turned],
            "targets": [{"shape": {"kind": "plane", "width_mm": 40.0, "height_mm": 40.0},
                         "position_mm": [0.0, 0.0, -60.0]}],
            "transport": {"split": "transmit", "threads": 1},
        }  # fmt: skip
        left = moved(whole, TILT, SHIFT)
        with_world = {"as it was": whole, "moved": left}
        assert outcome(with_world) == "agree"
        (key,) = {"rotation_deg", "turn_deg"} & turned.keys()
        left["lights"][0][key] = turned[key]
        assert outcome(with_world) == "silent"


def outcome(images: dict[str, Tables]) -> str:
    return judge([Estimate(name, (lf.Scene(**tables),)) for name, tables in images.items()], 8).outcome
