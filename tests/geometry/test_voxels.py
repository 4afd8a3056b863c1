"""Voxel grids are read with their names, places and faults."""

import io
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
import pyvista

from lfmesh.errors import FileError
from lfmesh.geometry.voxels import read_voxels, voxel_grid


def test_a_grid_is_read_with_its_place(tmp_path: Path) -> None:
    emission = np.arange(24.0).reshape(2, 3, 4)
    np.savez(tmp_path / "g.npz", emission_w_mm3_sr=emission, spacing_mm=[1.0, 2.0, 3.0], origin_mm=[5.0, 6.0, 7.0])
    grid = read_voxels(tmp_path / "g.npz")
    np.testing.assert_array_equal(grid.values["emission_w_mm3_sr"], emission)
    low, high = grid.bounds_mm
    np.testing.assert_allclose(low, [4.5, 5.0, 5.5])
    np.testing.assert_allclose(high, [6.5, 11.0, 17.5])
    np.testing.assert_allclose(grid.centres_mm()[1, 2, 3], [6.0, 10.0, 16.0])


def test_without_an_origin_a_grid_is_centred() -> None:
    low, high = voxel_grid({"absorption_per_mm": np.ones((3, 4, 5))}, 0.5).bounds_mm
    np.testing.assert_allclose(low, -high)


def test_a_bare_array_needs_its_quantity_and_spacing(tmp_path: Path) -> None:
    np.save(tmp_path / "g.npy", np.ones((2, 2, 2)))
    with pytest.raises(FileError, match="quantity"):
        read_voxels(tmp_path / "g.npy", spacing_mm=1.0)
    with pytest.raises(FileError, match="missing spacing_mm"):
        read_voxels(tmp_path / "g.npy", quantity="temperature_k")


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"absorption_per_mm": np.array([[[1.0, -1.0]]])}, r"absorption_per_mm is -1 at voxel \[0, 0, 1\]"),
        ({"absorption_per_mm": np.array([[[np.nan]]])}, "absorption_per_mm is nan"),
        (
            {"absorption_per_mm": np.full((2, 2, 2), 1.0 + 2.0j)},
            "absorption_per_mm holds complex numbers; it must hold real",
        ),
        ({"absorption_per_mm": np.full((2, 2, 2), None)}, "absorption_per_mm holds Python objects; it must hold real"),
        ({"absorption_per_mm": np.full((2, 2, 2), "1.0")}, "absorption_per_mm holds text; it must hold real"),
        ({"absorption_per_mm": np.full((2, 2, 2), "2001-01-01", "M8[D]")}, "absorption_per_mm holds dates"),
        ({"absorption_per_mm": np.ones((2, 2, 2)), "origin_mm": [0.0, 0.0, 1.0j]}, "origin_mm holds complex numbers"),
        ({"absorption_per_mm": np.ones((2, 2, 2)), "origin_mm": ["a", "b", "c"]}, "origin_mm holds text"),
        ({"absorption_per_mm": np.ones((2, 2, 2)), "spacing_mm": "wide"}, "spacing_mm holds text"),
        ({"absorption_per_mm": np.ones((2, 2, 2)), "spacing_mm": 1.0 + 1.0j}, "spacing_mm holds complex numbers"),
        ({"absorption_per_mm": np.ones((2, 2))}, r"must be an array \[x, y, z\]"),
        ({"absorbtion": np.ones((2, 2, 2))}, "unknown array 'absorbtion'"),
        ({"absorption_per_mm": np.ones((2, 2, 2)), "scattering_per_mm": np.ones((2, 2, 3))}, "differ in shape"),
        (
            {"emission_w_mm3_sr": np.ones((2, 2, 2)), "temperature_k": np.ones((2, 2, 2))},
            "emission_w_mm3_sr and temperature_k are both given",
        ),
    ],
)
def test_bad_grids_are_refused_in_one_line(arrays: dict[str, object], message: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "g.npz", **({"spacing_mm": 1.0} | arrays))  # type: ignore[arg-type]
    with pytest.raises(FileError, match=message) as caught:
        read_voxels(tmp_path / "g.npz")
    assert "\n" not in str(caught.value)
    assert "pickle" not in str(caught.value)


@pytest.mark.parametrize("ending", ["npz", "npy"])
@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"absorption_per_mm = 1.0\n", "it is no file of numpy's by its content; write it with numpy.save"),
        (b"", "it is empty; write it with numpy.save"),
        (pickle.dumps(1.0), "it is no file of numpy's by its content"),
        (b"PK\x03\x04 and no archive", "File is not a zip file|it is a .npz file by its content"),
        (b"\x93NUMPY and no array", "cannot be read as numpy's .npy|it is a .npy file by its content"),
    ],
)
def test_files_that_are_not_numpys_are_refused_in_one_line(
    content: bytes, message: str, ending: str, tmp_path: Path
) -> None:
    path = tmp_path / f"g.{ending}"
    path.write_bytes(content)
    with pytest.raises(FileError, match=message) as caught:
        read_voxels(path, quantity="absorption_per_mm" if ending == "npy" else None, spacing_mm=1.0)
    assert "\n" not in str(caught.value)
    assert "pickle" not in str(caught.value)


def test_an_array_of_objects_is_refused_in_one_line(tmp_path: Path) -> None:
    np.save(tmp_path / "g.npy", np.full((2, 2, 2), None))
    with pytest.raises(FileError, match="absorption_per_mm holds Python objects; it must hold real numbers"):
        read_voxels(tmp_path / "g.npy", spacing_mm=1.0, quantity="absorption_per_mm")
    with pytest.raises(FileError, match="absorption_per_mm holds no regular array"):
        voxel_grid({"absorption_per_mm": [[[1.0, 2.0], [3.0]]]}, 1.0)


@pytest.mark.parametrize("ending", ["npz", "npy"])
def test_a_grid_of_too_many_voxels_is_refused_by_its_header_alone(ending: str, tmp_path: Path) -> None:
    """Nothing follows the header, so a reader that goes on finds the file cut short."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (1024, 1024, 1024)})
    path = tmp_path / f"g.{ending}"
    if ending == "npy":
        path.write_bytes(header.getvalue())
    else:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("absorption_per_mm.npy", header.getvalue())
    with pytest.raises(FileError, match=r"1024 × 1024 × 1024 = 1073741824 voxels; at most 134217728 are read"):
        read_voxels(path, quantity="absorption_per_mm" if ending == "npy" else None, spacing_mm=1.0)


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("kind", ["<f8", ">f4", "<u2", "?"])
def test_an_array_is_read_in_any_order_and_type_of_numbers(kind: str, order: str, tmp_path: Path) -> None:
    values = np.asarray(np.arange(24).reshape(2, 3, 4) % 2, kind, order=order)
    np.savez_compressed(tmp_path / "g.npz", absorption_per_mm=values, spacing_mm=1.0)
    assert (read_voxels(tmp_path / "g.npz").values["absorption_per_mm"] == values).all()


def test_a_damaged_archive_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "g.npz"
    np.savez(path, absorption_per_mm=np.full((2, 2, 2), 0.25), spacing_mm=1.0)
    content = path.read_bytes()
    path.write_bytes(content.replace(np.float64(0.25).tobytes(), np.float64(0.5).tobytes(), 1))
    with pytest.raises(FileError, match=r"cannot be read as numpy's \.npz: Bad CRC-32"):
        read_voxels(path)


def vtk_image(kind: str, **arrays: np.ndarray) -> pyvista.ImageData:
    """An image of 3 x 4 x 5 voxels, given at points or in cells."""
    shape = np.array((3, 4, 5))
    image = pyvista.ImageData(dimensions=shape + (kind == "cells"), spacing=(1.0, 2.0, 0.5), origin=(10.0, -3.0, 7.0))
    data = image.cell_data if kind == "cells" else image.point_data
    for name, array in arrays.items():
        data[name] = array.ravel(order="F")
    return image


@pytest.mark.parametrize("kind", ["points", "cells"])
def test_vtk_image_data_has_its_values_where_vtk_has_them(kind: str, tmp_path: Path) -> None:
    """Every voxel's centre is where VTK says that its point or cell lies."""
    values = np.arange(60.0).reshape(3, 4, 5)
    image = vtk_image(kind, absorption_per_mm=values, beside=values)
    image.save(tmp_path / "grid.vti")
    grid = read_voxels(tmp_path / "grid.vti")
    assert list(grid.values) == ["absorption_per_mm"]
    np.testing.assert_array_equal(grid.values["absorption_per_mm"], values)
    places = image.cell_centers().points if kind == "cells" else image.points
    np.testing.assert_allclose(grid.centres_mm().reshape(-1, 3, order="F"), places, atol=1e-12)


def test_the_only_array_of_vtk_image_data_may_have_any_name(tmp_path: Path) -> None:
    values = np.ones((3, 4, 5))
    vtk_image("points", soot=values).save(tmp_path / "grid.vti")
    grid = read_voxels(tmp_path / "grid.vti", quantity="emission_w_mm3_sr")
    np.testing.assert_array_equal(grid.values["emission_w_mm3_sr"], values)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ('Piece Extent="0 9 0 3 0 4"', "its Piece has the points 0 to 9 along x, but its WholeExtent 0 to 2"),
        ('Piece Extent="0 2 0 3 0 3"', "its pieces have 18 voxels, but its WholeExtent 24"),
    ],
)
def test_a_vtk_image_whose_pieces_are_not_the_whole_is_refused(wrong: str, message: str, tmp_path: Path) -> None:
    """VTK would leave out numbers of the file, or voxels without a number."""
    path = tmp_path / "grid.vti"
    vtk_image("points", absorption_per_mm=np.ones((3, 4, 5))).save(path)
    right = b'Piece Extent="0 2 0 3 0 4"'
    assert right in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(right, wrong.encode()))
    with pytest.raises(FileError, match=message):
        read_voxels(path)


def test_a_vtk_image_of_several_pieces_is_read(tmp_path: Path) -> None:
    array = '<PointData><DataArray type="Float64" Name="absorption_per_mm" format="ascii">{}</DataArray></PointData>'
    pieces = "".join(
        f'<Piece Extent="{i} {i + 1} 0 1 0 1">{array.format(f"{i} {i + 1} " * 4)}</Piece>' for i in range(2)
    )
    (tmp_path / "grid.vti").write_text(
        '<VTKFile type="ImageData" version="1.0"><!-- WholeExtent="0 1 0 1 0 1" --><ImageData '
        f'WholeExtent="0 2 0 1 0 1" Origin="0 0 0" Spacing="1 1 1">{pieces}</ImageData></VTKFile>'
    )
    values = read_voxels(tmp_path / "grid.vti").values["absorption_per_mm"]
    np.testing.assert_array_equal(values, np.broadcast_to(np.arange(3.0)[:, None, None], (3, 2, 2)))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "cannot be read as VTK"),
        (b"<VTKFile type='ImageData'><ImageData></VTKFile>", "cannot be read as VTK|no quantity"),
        (None, "holds no quantity"),
    ],
)
def test_bad_vtk_image_data_is_refused_in_one_line(
    content: bytes | None, message: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "grid.vti"
    if content is None:
        vtk_image("points", soot=np.ones((3, 4, 5))).save(path)
    else:
        path.write_bytes(content)
    with pytest.raises(FileError, match=message) as error:
        read_voxels(path)
    assert "\n" not in str(error.value)
    assert capfd.readouterr().err == ""
    with pytest.raises(FileError, match="it does not exist"):
        read_voxels(tmp_path / "nowhere.vti")
