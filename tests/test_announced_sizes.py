"""Small files that announce or unpack to very much are refused by what they announce, before memory is taken for it."""

import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.errors import FileError, LfmeshError
from lfmesh.files.sealed import read_sealed, write_sealed
from lfmesh.geometry.voxels import read_voxels
from lfmesh.lightfield.volumes.voxel_box import read_box
from lfmesh.scene.files import DEEPEST_TABLE, parse_toml

MOST = 50e6
"""Bytes that a refusal may take."""

PACKED = 80_000_000
"""Bytes of zeros, of which a packed file has some 350 kB."""


@contextmanager
def in_little_memory() -> Iterator[None]:
    """Fail if the body takes much memory by Python or numpy."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < MOST
    finally:
        tracemalloc.stop()


def packed(path: Path, zeros: dict[str, tuple[int, ...]], arrays: dict[str, Any]) -> Path:
    """Write arrays of zeros, of float64, beside others, packed, without building them."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, shape in zeros.items():
            with archive.open(f"{name}.npy", "w") as member:
                header = {"descr": "<f8", "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_1_0(member, header)
                for _ in range(int(np.prod(shape)) * 8 // 1_000_000):
                    member.write(bytes(1_000_000))
        for name, value in arrays.items():
            content = BytesIO()
            np.save(content, value)
            archive.writestr(f"{name}.npy", content.getvalue())
    return path


MATRIX = {
    "shape": np.array([4, 8]), "grid_shape": np.array([2, 2, 2]), "sensor_pixels": np.array([2, 2]),
    "spacing_mm": np.ones(3), "origin_mm": np.zeros(3), "position_mm": np.zeros(3), "rotation_deg": np.zeros(3),
    "indptr": np.array([0, 1, 1, 1, 1]), "data": np.ones(1), "indices": np.array([3]), "stderr": np.ones(1),
    "row_stderr": np.ones(4), "dropped": np.zeros(4), "pixels": np.arange(4), "threshold": np.array(0.1),
    "wavelength_nm": np.array(550.0), "warnings": np.array(b"[]"),
}  # fmt: skip


def test_a_packed_matrix_is_read(tmp_path: Path) -> None:
    """Else those below might be refused for another reason."""
    matrix = lf.open_projection_matrix(packed(tmp_path / "m.npz", {}, MATRIX))
    assert matrix.matrix[0, 3] == 1.0
    assert matrix.sensor_pixels == (2, 2)


@pytest.mark.parametrize("name", ["data", "indptr", "pixels", "spacing_mm", "warnings"])
def test_a_matrix_with_an_array_that_does_not_fit_is_not_unpacked(name: str, tmp_path: Path) -> None:
    others = {key: value for key, value in MATRIX.items() if key != name}
    path = packed(tmp_path / "m.npz", {name: (PACKED // 8,)}, others)
    with in_little_memory(), pytest.raises(FileError, match=r"m\.npz is not a projection matrix, or is damaged"):
        lf.open_projection_matrix(path)


@pytest.mark.parametrize("wrong", [{"warnings": np.array(b"[")}, {"dropped": np.zeros(3)}], ids=["warnings", "a row"])
def test_a_matrix_that_is_wrong_elsewhere_is_refused_before_its_rows_are_unpacked(wrong, tmp_path: Path) -> None:
    rows = PACKED // 8
    packed_rows = {"indptr": (rows + 1,), "row_stderr": (rows,), "dropped": (rows,), "pixels": (rows,)}
    sizes = {"shape": np.array([rows, 8]), "sensor_pixels": np.array([rows, 1])}
    others = {key: value for key, value in (MATRIX | sizes | wrong).items() if key not in packed_rows or key in wrong}
    large = {key: shape for key, shape in packed_rows.items() if key not in wrong}
    path = packed(tmp_path / "m.npz", large, others)
    with in_little_memory(), pytest.raises(FileError, match=r"m\.npz is not a projection matrix, or is damaged"):
        lf.open_projection_matrix(path)


def test_a_sealed_file_that_is_packed_is_not_unpacked(tmp_path: Path) -> None:
    """No writer of lfmesh packs: checkpoints, shares and units of studies are as large as their arrays."""
    path = packed(tmp_path / "c.npz", {"facts": (PACKED // 8,)}, {})
    with in_little_memory(), pytest.raises(FileError, match=r"c\.npz is damaged"):
        read_sealed(path, 1)
    with path.open("wb") as file:
        write_sealed(file, 1, {"a": 1}, {"zeros": np.zeros(1000)})
    facts, arrays = read_sealed(path, 1)
    assert facts == {"a": 1}
    assert arrays["zeros"].shape == (1000,)


def test_the_voxels_of_a_grid_are_not_unpacked_for_their_place(tmp_path: Path) -> None:
    path = packed(tmp_path / "grid.npz", {"emission": (200, 200, PACKED // 8 // 40_000)}, {"spacing_mm": np.ones(3)})
    with in_little_memory():
        assert read_box(path).shape == (200, 200, 250)
    packed(path, {"emission": (200, 200, PACKED // 8 // 40_000), "spacing_mm": (PACKED // 8,)}, {})
    with in_little_memory(), pytest.raises(FileError, match="missing spacing_mm"):
        read_box(path)


def long_header(path: Path, name: str, arrays: dict[str, Any]) -> Path:
    """Write an array whose header says that it is as long as `PACKED`, beside others."""
    packed(path, {}, arrays)
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr(f"{name}.npy", b"\x93NUMPY\x02\x00" + PACKED.to_bytes(4, "little") + bytes(PACKED))
    return path


def test_a_header_that_is_longer_than_any_is_not_unpacked(tmp_path: Path) -> None:
    grid = long_header(tmp_path / "g.npz", "temperature_k", {"spacing_mm": np.ones(3)})
    with in_little_memory(), pytest.raises(FileError, match=r"g\.npz: cannot be read as numpy's \.npz"):
        read_voxels(grid)
    matrix = long_header(tmp_path / "m.npz", "data", {key: value for key, value in MATRIX.items() if key != "data"})
    with in_little_memory(), pytest.raises(FileError, match=r"m\.npz is not a projection matrix, or is damaged"):
        lf.open_projection_matrix(matrix)


@pytest.mark.parametrize(
    ("beside", "message"),
    [
        ({}, "missing spacing_mm"),
        ({"spacing_mm": np.zeros(3)}, "spacing_mm must be one or three numbers above 0"),
        ({"spacing_mm": np.ones(3), "origin_mm": np.ones(2)}, "origin_mm must be three numbers"),
        ({"spacing_mm": np.ones(7)}, "spacing_mm has 7 numbers"),
        ({"spacing_mm": np.ones(3), "temperature_k": np.ones((2, 2, 2))}, "differ in shape"),
        ({"spacing_mm": np.ones(3), "colour": np.ones((2, 2, 2))}, "unknown array 'colour'"),
    ],
)
def test_the_voxels_of_a_medium_are_not_unpacked_if_the_file_is_wrong_elsewhere(
    beside: dict[str, Any], message: str, tmp_path: Path
) -> None:
    path = packed(tmp_path / "g.npz", {"absorption_per_mm": (200, 200, PACKED // 8 // 40_000)}, beside)
    with in_little_memory(), pytest.raises(FileError, match=message):
        read_voxels(path)


def test_a_vtk_image_of_too_many_voxels_is_refused_by_its_extent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("subprocess.run", lambda *_, **__: pytest.fail("VTK was asked to read it"))
    extent = 'WholeExtent="0 799 0 799 0 799" Origin="0 0 0" Spacing="1 1 1"'
    (tmp_path / "a.vti").write_text(f'<VTKFile type="ImageData"><ImageData {extent}></ImageData></VTKFile>')
    with pytest.raises(FileError, match=rf"a\.vti: has {799**3} voxels or more; at most {2**27} are read"):
        read_voxels(tmp_path / "a.vti")


KEYS = {
    "key": "{} = 1",
    "spaced": "{} = 1",
    "header": "[{}]\nb = 1",
    "list of tables": "[[{}]]\nb = 1",
    "inline": "x = {{ {} = 1 }}",
}


@pytest.mark.parametrize("kind", KEYS)
def test_a_dotted_key_of_very_many_parts_is_refused_unread(kind: str, tmp_path: Path) -> None:
    dotted = (" . " if kind == "spaced" else ".").join(["a", "'b'", '"c"'] * 17_000)
    (tmp_path / "scene.toml").write_text("schema_version = 1\n" + KEYS[kind].format(dotted))
    opened: list[Callable[[Path], Any]] = [lf.load, lf.Study.load]
    for each in opened:
        with in_little_memory(), pytest.raises(LfmeshError, match="are nested too deeply"):
            each(tmp_path / "scene.toml")


def test_text_that_looks_like_a_long_key_only_in_part_is_read() -> None:
    """Numbers, words and keys as deep as tables may stand."""
    deep = ".".join(["a"] * DEEPEST_TABLE)
    numbers = ", ".join(["1.5"] * 5000)
    text = f'{deep} = 1\nx = [{numbers}]\nname = "{"word " * 20_000}"\nlong = "{"w" * 100_000}"\n'
    held = parse_toml(text)
    assert len(held["x"]) == 5000
    assert len(held["long"]) == 100_000
