"""Lens elements where their poses put them: surfaces, edges and solids, and poses that cannot be."""

from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.geometry.lens.element_poses import pose_of
from lfmesh.geometry.surfaces.sag import sag

LENS = [
    {"radius_mm": 30.0, "thickness_mm": 4.0, "index": 1.6, "semi_diameter_mm": 6.0},
    {"radius_mm": -40.0, "thickness_mm": 3.0, "semi_diameter_mm": 6.0},
    {"stop": True, "thickness_mm": 3.0, "semi_diameter_mm": 4.0},
    {"radius_mm": 60.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 7.0},
    {"radius_mm": -25.0, "thickness_mm": 2.0, "index": 1.7, "semi_diameter_mm": 7.0},
    {"radius_mm": -80.0, "semi_diameter_mm": 7.0},
]


def scene(*elements: Any) -> lf.Scene:
    sensor = {"pixels": [20, 20], "pixel_mm": 0.5, "distance_mm": 30.0}
    return lf.Scene(camera={"lens": {"surfaces": LENS, "elements": list(elements)}, "sensor": sensor})


def pose(surfaces: list[int], tilt: Any = (0.0, 0.0, 0.0), shift: Any = (0.0, 0.0, 0.0)) -> dict[str, Any]:
    return {"surfaces": surfaces, "pose": {"tilt_deg": list(tilt), "shift_mm": list(shift)}}


def test_an_element_turns_about_the_vertex_of_its_first_surface() -> None:
    lens = scene(pose([3, 4, 5], (0.0, 90.0 / 4, 0.0), (1.0, 2.0, 3.0))).camera.lens
    motion = pose_of(lens, 4)
    first = np.array([0.0, 0.0, lens.vertices_mm[3]])
    moved = motion[:, :3] @ first + motion[:, 3]
    assert np.allclose(moved - first, [1.0, 2.0, 3.0], atol=1e-14)
    # A turn about y takes +z towards +x.
    second = motion[:, :3] @ [0.0, 0.0, lens.vertices_mm[4]] + motion[:, 3]
    assert np.allclose(second - moved, 3.0 * np.array([np.sin(np.pi / 8), 0.0, np.cos(np.pi / 8)]), atol=1e-14)
    assert np.array_equal(pose_of(lens, 1), np.eye(3, 4))


ELEMENTS = {
    "singlet": [pose([0, 1], (3.0, -2.0, 0.0), (0.2, 0.1, -0.1))],
    "wedge": [pose([1], (2.0, 0.0, 0.0))],
    "half turn about the axis": [pose([0], (0.0, 0.0, 180.0), (0.1, 0.0, 0.0))],
    "cemented face": [pose([4], (1.0, 0.0, 33.0), (0.0, 0.1, 0.0))],
    "all apart": [pose([k], (0.5 * k, -0.4, 20.0 * k), (0.05 * k, 0.1, 0.0)) for k in (0, 1, 3, 4, 5)],
}


@pytest.mark.parametrize("name", ELEMENTS)
def test_posed_elements_are_closed_solids_bounded_by_their_surfaces(name: str) -> None:
    world = lf.build(scene(*ELEMENTS[name]))
    shape = world.lens_shape
    for number in range(len(shape.elements)):
        solid = world.mesh(f"lens[{number}]")
        solid.merge_vertices()
        assert solid.is_watertight
        assert solid.volume > 0.0
    lens = world.scene.camera.lens
    for k, cap in enumerate(shape.caps):
        motion = pose_of(lens, shape.numbers[k])
        p = (cap.vertices - motion[:, 3]) @ motion[:, :3]
        inside = np.hypot(p[:, 0], p[:, 1]) <= shape.surfaces[k]["semi_diameter"]
        expected = shape.surfaces[k]["vertex_z"] + sag(shape.surfaces[k], np.hypot(p[:, 0], p[:, 1]))
        assert np.abs(p[:, 2] - expected)[inside].max() < 1e-12
        # Each ring ends on the rims of the two surfaces that it joins.
        for ring in shape.closures[max(k - 1, 0) : k + 1]:
            rim = cap.vertices[np.isclose(np.hypot(p[:, 0], p[:, 1]), shape.rims[k], rtol=1e-9)]
            distance = np.linalg.norm(ring.vertices[:, None] - rim[None], axis=2).min(axis=0)
            assert distance.max() < 1e-9


@pytest.mark.parametrize(
    ("elements", "message"),
    [
        ([pose([0, 1], shift=(0.0, 0.0, 4.0))],
         r"camera.lens.elements\[0\].pose = \{ shift_mm = \[0.0, 0.0, 4.0\], tilt_deg = \[0.0, 0.0, 0.0\] \}: "
         r"surfaces 1 and 2 cross inside their clear apertures, by 1 mm; give smaller shifts and tilts"),
        ([pose([3, 4, 5], (44.0, 0.0, 0.0))], r"elements\[0\].pose = .*: surfaces 2 and 3 cross"),
        ([pose([0]), pose([1], (40.0, 0.0, 0.0))], r"elements\[0\].pose = .*, camera.lens.elements\[1\].pose = .*: "
         "surfaces 0 and 1 cross"),
        ([pose([4], shift=(0.0, 0.0, -3.5))], "surfaces 3 and 4 cross inside their clear apertures, by 1.91 mm"),
        ([pose([2], (44.0, 0.0, 0.0), (0.0, 0.0, 0.5))], "surfaces 2 and 3 cross"),
    ],
)  # fmt: skip
def test_poses_that_make_surfaces_cross_are_refused_in_one_line(elements: list[Any], message: str) -> None:
    with pytest.raises(lf.SceneError, match=message) as refusal:
        lf.build(scene(*elements))
    assert len(str(refusal.value).splitlines()) == 1


def test_an_element_that_is_pushed_into_the_sensor_is_refused() -> None:
    with pytest.raises(lf.SceneError, match="into the lens"):
        lf.build(scene(pose([3, 4, 5], shift=(0.0, 0.0, 31.0))))


def test_an_element_that_is_a_mesh_keeps_its_pose_when_it_is_measured(tmp_path: Any) -> None:
    """One entry of the file becomes two surfaces, and the numbers behind it move on."""
    plain = lf.build(scene())
    plain.mesh("lens[0]").export(tmp_path / "element.stl")
    refractor = {"refractor": {"file": "element.stl", "units": "mm", "index": 1.6}, "thickness_mm": 3.0}
    given = scene().changed(
        {
            "camera.lens.surfaces": [refractor, *LENS[2:]],
            "camera.lens.elements": [pose([0], (1.0, 0.0, 0.0), (0.3, 0.0, 0.0)), pose([2, 3, 4], (0.0, 1.0, 0.0))],
        }
    )
    world = lf.build(given.in_folder(tmp_path))
    assert [element.surfaces for element in world.scene.camera.lens.elements] == [(0, 1), (3, 4, 5)]
    straight = lf.build(given.changed({"camera.lens.elements": []}).in_folder(tmp_path))
    motion = pose_of(world.scene.camera.lens, 1)
    for k in (0, 1):
        moved = straight.lens_shape.caps[k].vertices @ motion[:, :3].T + motion[:, 3]
        assert np.abs(world.lens_shape.caps[k].vertices - moved).max() < 1e-12
    draw = np.random.default_rng(2)
    origins = np.column_stack([draw.uniform(-3.0, 3.0, (500, 2)), np.full(500, -20.0)])
    paths = lf.trace(world, origins, np.tile([0.0, 0.0, 1.0], (500, 1)), split="transmit")
    exact = lf.build(scene(pose([0, 1], (1.0, 0.0, 0.0), (0.3, 0.0, 0.0)), pose([3, 4, 5], (0.0, 1.0, 0.0))))
    truth = lf.trace(exact, origins, np.tile([0.0, 0.0, 1.0], (500, 1)), split="transmit")
    both = np.intersect1d(
        paths.source[paths.status == lf.Status.SENSOR], truth.source[truth.status == lf.Status.SENSOR]
    )
    assert len(both) > 350
    off = paths.position[np.isin(paths.source, both)] - truth.position[np.isin(truth.source, both)]
    # The mesh has the coarse facets that stand for an exact surface: what they show is far below the pose's 0.2 mm.
    assert np.sqrt(np.mean(np.square(off).sum(axis=1))) < 0.02
