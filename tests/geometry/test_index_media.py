"""Index fields of media: the laws of their indices, their boxes, and scenes in which they are refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog

from lfmesh.errors import FileError, LfmeshError, SceneError
from lfmesh.geometry import frame
from lfmesh.geometry.index_media import IndexMedium, any_bends, bends, boxes_overlap, index_media
from lfmesh.optics.air import air_index
from lfmesh.scene import Scene
from tests.cameras import camera_without_array

BOX = {"kind": "box", "size_mm": [10.0, 10.0, 10.0]}
PLACE = {"position_mm": [0.0, 0.0, -100.0]}
LINES = (450.0, 587.6, 650.0)
FAR = {"file": "g.npz", "origin_mm": [90.0, 0.0, 0.0]}
MIDDLE = np.zeros((1, 3))
AIR = {"temperature_k": 293.15, "pressure_kpa": 101.325}


def fields(
    folder: Path, *media: dict[str, Any], air: dict[str, float] | None = None, **arrays: Any
) -> list[IndexMedium]:
    """Return the fields of media, the grid of which is in g.npz."""
    if arrays:
        np.savez(folder / "g.npz", **{"spacing_mm": 1.0} | arrays)
    camera = camera_without_array()
    scene = Scene(camera=camera, media=[PLACE | each for each in media]).in_folder(folder)  # type: ignore[arg-type]
    return index_media(scene if air is None else scene.changed({"camera.air": air}), LINES)


def test_an_index_is_relative_to_the_air_of_the_scene(tmp_path: Path) -> None:
    (given,) = fields(tmp_path, {"index": 1.0002, "bounds": BOX})
    (vacuum,) = fields(tmp_path, {"density_kg_m3": 0.0, "bounds": BOX})
    (same,) = fields(tmp_path, {**AIR, "bounds": BOX})
    (thin,) = fields(tmp_path, {**AIR, "bounds": BOX}, air={"temperature_c": 20.0, "pressure_kpa": 0.0})
    for column, line in enumerate(LINES):
        around = air_index(line, 20.0, 101.325)
        assert given.indices(column, MIDDLE) == 1.0002
        assert vacuum.indices(column, MIDDLE) == pytest.approx(1.0 / around, abs=1e-15)
        assert same.indices(column, MIDDLE) == pytest.approx(1.0, abs=1e-15)
        assert thin.indices(column, MIDDLE) == pytest.approx(around, abs=1e-15)


@pytest.mark.parametrize(("line_nm", "constant"), [(703.4, 2.250e-4), (607.4, 2.259e-4), (509.7, 2.274e-4)])
def test_air_has_the_gladstone_dale_constants_of_the_textbook(tmp_path: Path, line_nm: float, constant: float) -> None:
    """W. Merzkirch, Flow Visualization, Academic Press 1987, table 3.1: constants of air, m³/kg."""
    scene = Scene(
        camera=camera_without_array(), media=[{"density_kg_m3": density, "bounds": BOX} | place for density, place in
        ((0.0, PLACE), (1.0, {"position_mm": [0.0, 0.0, -200.0]}))],
    )  # fmt: skip
    vacuum, air = (each.indices(0, MIDDLE)[0] for each in index_media(scene, (line_nm,)))
    assert air / vacuum - 1.0 == pytest.approx(constant, rel=2e-3)


def test_a_gas_of_its_own_constant_has_no_dispersion_of_air(tmp_path: Path) -> None:
    (helium,) = fields(tmp_path, {"density_kg_m3": 0.1664, "gladstone_dale_m3_kg": 1.96e-4, "bounds": BOX})
    for column, line in enumerate(LINES):
        index = (1.0 + 1.96e-4 * 0.1664) / air_index(line, 20.0, 101.325)
        assert helium.indices(column, MIDDLE) == pytest.approx(index, abs=1e-15)


def test_arrays_and_keys_give_the_same_field(tmp_path: Path) -> None:
    """The density of the ideal gas is interpolated, not its temperature; the nodes are exact."""
    kelvin = 300.0 + 20.0 * np.random.default_rng(1).random((5, 6, 7))
    given = {"grid": "g.npz"}
    (by_key,) = fields(tmp_path, given | {"pressure_kpa": 99.0}, temperature_k=kelvin)
    (by_array,) = fields(tmp_path, given, temperature_k=kelvin, pressure_kpa=np.full(kelvin.shape, 99.0))
    density = 99.0e3 / (287.05287 * kelvin)
    (by_density,) = fields(tmp_path, given, density_kg_m3=density)
    nodes = np.stack(np.meshgrid(*[np.arange(n) - 0.5 * (n - 1) for n in kelvin.shape], indexing="ij"), -1).reshape(
        -1, 3
    )
    for column, line in enumerate(LINES):
        found = by_key.indices(column, nodes)
        np.testing.assert_allclose(by_array.indices(column, nodes), found, rtol=0.0, atol=1e-15)
        np.testing.assert_allclose(by_density.indices(column, nodes), found, rtol=0.0, atol=1e-15)
        constant = (air_index(line, 20.0, 101.325) - 1.0) / (101.325e3 / (287.05287 * 293.15))
        truth = (1.0 + constant * density.ravel()) / air_index(line, 20.0, 101.325)
        np.testing.assert_allclose(found, truth, rtol=0.0, atol=1e-14)


def test_a_grid_alone_bends_light_by_its_arrays(tmp_path: Path) -> None:
    def of(**arrays: Any) -> Scene:
        np.savez(tmp_path / "g.npz", spacing_mm=1.0, **arrays)
        return Scene(camera=camera_without_array(), media=[{"grid": "g.npz"}]).in_folder(tmp_path)  # type: ignore[list-item]

    ones = np.ones((2, 2, 2))
    assert any_bends(of(index=ones))
    assert any_bends(of(absorption_per_mm=ones, density_kg_m3=ones))
    assert not any_bends(of(absorption_per_mm=ones))
    assert not any_bends(of(temperature_k=ones, absorption_per_mm=ones))


def test_a_grid_of_vtk_and_a_single_array_bend_light(tmp_path: Path) -> None:
    import pyvista as pv

    image = pv.ImageData(dimensions=(3, 3, 3), origin=(-1.0, -1.0, -1.0))
    image.point_data["index"] = np.ones(27)
    image.point_data["velocity"] = np.ones(27)
    image.save(tmp_path / "g.vti")
    np.save(tmp_path / "g.npy", np.ones((2, 2, 2)))
    single = {"file": "g.npy", "quantity": "index", "spacing_mm": [1.0, 1.0, 1.0]}
    scene = Scene(camera=camera_without_array(), media=[PLACE | {"grid": each} for each in ("g.vti", single)])  # type: ignore[list-item]
    assert [bends(scene.in_folder(tmp_path), each) for each in scene.media] == [True, True]
    (found,) = fields(tmp_path, {"grid": "g.vti"})
    np.testing.assert_array_equal(found.bounds_mm, [[-1.5] * 3, [1.5] * 3])


def test_a_field_fills_what_its_box_and_its_grid_have_in_common(tmp_path: Path) -> None:
    bounds = {"kind": "box", "size_mm": [2.0, 4.0, 100.0]}
    (found,) = fields(
        tmp_path, {"grid": "g.npz", "bounds": bounds}, index=np.ones((4, 4, 4)), origin_mm=[-0.5, 0.5, 0.5]
    )
    np.testing.assert_array_equal(found.bounds_mm, [[-1.0, 0.0, 0.0], [1.0, 2.0, 4.0]])


def test_a_formula_holds_about_the_medium(tmp_path: Path) -> None:
    given = {"kind": "radial_n", "index": 1.0, "coefficients": [-1e-6], "axial_coefficients": [2e-6]}
    (found,) = fields(tmp_path, {"index": given, "bounds": BOX, "rotation_deg": [0.0, 90.0, 0.0]})
    points = np.random.default_rng(2).uniform(-5.0, 5.0, (50, 3))
    truth = 1.0 - 1e-6 * (points[:, 0] ** 2 + points[:, 1] ** 2) + 2e-6 * points[:, 2]
    np.testing.assert_allclose(found.indices(1, points), truth, rtol=0.0, atol=1e-15)
    corners = found.corners_mm()
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], [[-5, -5, -105], [5, 5, -95]], atol=1e-12)


@pytest.mark.parametrize(
    ("medium", "arrays", "message"),
    [
        ({"index": 1.0}, {"index": 1.0}, r"media\[0\]: index: g.npz gives it by voxels"),
        ({"index": 1.0}, {"pressure_kpa": 99.0}, "pressure_kpa: index is given too"),
        ({"density_kg_m3": 1.0}, {"index": 1.0}, "density_kg_m3: index is given too"),
        ({"gladstone_dale_m3_kg": 2e-4}, {"index": 1.0}, "gladstone_dale_m3_kg: index sets the index without it"),
        ({}, {"pressure_kpa": 99.0}, "pressure_kpa: needs temperature_k"),
        ({"pressure_kpa": 99.0}, {"temperature_k": 0.0}, "temperature_k is 0 at a voxel"),
        ({"name": "jet"}, {"index": 0.0}, r"media\[0\] \(jet\): index field: the index is 0 at a voxel"),
        ({"bounds": {"kind": "sphere", "radius_mm": 1.0}}, {"index": 1.0}, "give it a box or a grid"),
        ({"inside": "water"}, {"index": 1.0}, "in air or the object medium only"),
        (
            {"bounds": BOX, "grid": {"file": "g.npz", "origin_mm": [90.0, 0.0, 0.0]}},
            {"index": 1.0},
            "nothing in common",
        ),
        ({}, {"index": 1.0 + 1.1e-3}, r"differs by 0\.0011 from 1 around it at a face.*give a body of glass"),
    ],
)
def test_fields_that_cannot_be_are_refused(
    tmp_path: Path, medium: dict[str, Any], arrays: dict[str, float], message: str
) -> None:
    held = {key: np.full((3, 3, 3), value) for key, value in arrays.items()}
    if medium.get("inside"):
        body = {"shape": {"kind": "box", "size_mm": [30.0] * 3}, "index": 1.3}
        np.savez(tmp_path / "g.npz", spacing_mm=1.0, **held)
        scene = Scene(
            camera=camera_without_array(), media=[PLACE | {"grid": "g.npz"} | medium],  # type: ignore[list-item]
            targets=[{"name": "water", "refractor": body, "position_mm": [0.0, 0.0, -100.0]}],  # type: ignore[list-item]
        ).in_folder(tmp_path)  # fmt: skip
        with pytest.raises(SceneError, match=message):
            index_media(scene, LINES)
        return
    with pytest.raises(SceneError, match=message):
        fields(tmp_path, {"grid": "g.npz"} | medium, **held)


def test_two_laws_in_one_file_are_refused(tmp_path: Path) -> None:
    ones = np.ones((2, 2, 2))
    with pytest.raises(FileError, match="index and density_kg_m3 are both given"):
        fields(tmp_path, {"grid": "g.npz"}, index=ones, density_kg_m3=ones)


def test_a_step_is_measured_from_the_medium_around_the_field(tmp_path: Path) -> None:
    """In water a field of the index of water does not step, and one of air does."""
    water = Scene(
        camera=camera_without_array(), media=[PLACE | {"index": 1.3335, "bounds": BOX}],  # type: ignore[list-item]
    ).changed({"camera.object_medium": {"index": 1.333}})  # fmt: skip
    assert len(index_media(water, LINES)) == 1
    with pytest.raises(SceneError, match=r"differs by 0\.333 from 1\.333 around it"):
        index_media(water.changed({"media[0].index": 1.0}), LINES)


def test_a_formula_may_not_step_at_its_bounds(tmp_path: Path) -> None:
    """At the corners r² is 50 mm²."""
    for factor, refused in ((1.9e-5, False), (2.1e-5, True)):
        given = {"index": {"kind": "radial_n", "index": 1.0, "coefficients": [-factor]}, "bounds": BOX}
        if not refused:
            assert len(fields(tmp_path, given)) == 1
            continue
        with pytest.raises(SceneError, match=r"differs by 0\.00105 from 1 "):
            fields(tmp_path, given)


def test_fields_may_touch_but_not_overlap(tmp_path: Path) -> None:
    one = {"index": 1.0001, "bounds": BOX}
    assert len(fields(tmp_path, one, one | {"position_mm": [10.0, 0.0, -100.0]})) == 2
    turned = one | {"rotation_deg": [0.0, 0.0, 45.0]}
    # Its corner reaches 5 √2 mm.
    assert len(fields(tmp_path, one, turned | {"position_mm": [12.072, 0.0, -100.0]})) == 2
    for other in (one | {"position_mm": [9.999, 0.0, -100.0]}, turned | {"position_mm": [12.07, 0.0, -100.0]}):
        with pytest.raises(SceneError, match=r"media\[0\] and media\[1\] both bend light, but overlap"):
            fields(tmp_path, one, other)


def box(draw: np.random.Generator, scale: float) -> IndexMedium:
    """Return a medium with a random box."""
    to_world = frame.frame(draw.uniform(-180.0, 180.0, 3), scale * draw.uniform(-1.5, 1.5, 3))
    half = scale * draw.uniform(0.05, 1.0, 3)
    return IndexMedium(0, "", to_world, np.array([-half, 2.0 * half]), None)


def depth_of_common_point(one: IndexMedium, other: IndexMedium) -> float:
    """Return the depth of the deepest point in both boxes, by linear programming; negative if they are apart."""
    rows, ends = [], []
    for each in (one, other):
        own = frame.inverse(each.to_world)
        for sign, bound in ((1.0, each.bounds_mm[1]), (-1.0, -each.bounds_mm[0])):
            rows.append(np.column_stack([sign * own[:, :3], np.ones(3)]))
            ends.append(bound - sign * own[:, 3])
    found = linprog([0.0, 0.0, 0.0, -1.0], np.concatenate(rows), np.concatenate(ends), bounds=[(None, None)] * 4)
    return float(-found.fun)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
def test_boxes_overlap_where_linear_programming_finds_a_common_point(scale: float) -> None:
    draw = np.random.default_rng(3)
    seen = set()
    for _ in range(150):
        one, other = box(draw, scale), box(draw, scale)
        depth = depth_of_common_point(one, other)
        if abs(depth) > 1e-6 * scale:
            assert boxes_overlap(one, other) == (depth > 0.0)
            assert boxes_overlap(other, one) == (depth > 0.0)
            seen.add(depth > 0.0)
    assert seen == {False, True}


def test_a_broken_grid_does_not_decide_whether_a_medium_bends_light(tmp_path: Path) -> None:
    (tmp_path / "g.npz").write_bytes(b"PK\x03\x04 nothing")
    scene = Scene(camera=camera_without_array(), media=[{"grid": "g.npz"}]).in_folder(tmp_path)  # type: ignore[list-item]
    assert not any_bends(scene)
    with pytest.raises(LfmeshError):
        index_media(scene.changed({"media[0].pressure_kpa": 99.0}), LINES)
