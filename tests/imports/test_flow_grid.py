"""Flow fields resampled onto voxels: exact values, the stated error, and files that are refused."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import pyvista as pv

from lfmesh.cli import main
from lfmesh.errors import FileError
from lfmesh.geometry.voxels import read_voxels
from lfmesh.imports.flow_grid import FlowArray, Resampling, resampled, vti_bytes

Field = Callable[[Any, Any, Any], Any]

T = FlowArray("T", "temperature_k")


def flow(path: Path, field: Field, nodes: int = 9, kind: str = "tetrahedra") -> Path:
    """Write a field T on a cube from -4 to 4 m, with nodes in line with x, y and z."""
    step = 8.0 / (nodes - 1)
    image = pv.ImageData(dimensions=(nodes,) * 3, spacing=(step,) * 3, origin=(-4.0,) * 3)
    x, y, z = np.asarray(image.points).T
    image.point_data["T"] = field(x, y, z)
    image.point_data["U"] = np.ones((image.n_points, 3))
    if kind == "tetrahedra":
        image = image.to_tetrahedra()
    elif kind == "cells":
        image = image.point_data_to_cell_data().cast_to_unstructured_grid()
    image.save(path)
    return path


def linear(x: Any, y: Any, z: Any) -> Any:
    return 300.0 + 2.0 * x - 3.0 * y + 0.5 * z


@pytest.mark.parametrize(("name", "kind"), [("f.vtu", "tetrahedra"), ("f.vti", "image"), ("f.vtk", "tetrahedra")])
def test_a_linear_field_is_exact_in_every_format(tmp_path: Path, name: str, kind: str) -> None:
    """Lengths are converted, and a factor and further nodes change nothing but the numbers."""
    path = flow(tmp_path / name, linear, kind=kind)
    found = resampled(path, (FlowArray("T", "temperature_k", 2.0),), Resampling((700.0, 900.0, 1100.0), "m"))
    x, y, z = np.moveaxis(1e-3 * found.grid.centres_mm(), -1, 0)
    assert found.grid.shape == (12, 9, 8)
    np.testing.assert_allclose(found.grid.values["temperature_k"], 2.0 * linear(x, y, z), rtol=1e-5)
    np.testing.assert_allclose(found.grid.bounds_mm[0], -found.grid.bounds_mm[1], atol=1e-9)
    assert found.outside == 0.0
    assert found.largest["temperature_k"] < 1e-5 * 600.0
    (tmp_path / "g.vti").write_bytes(vti_bytes(found.grid))
    again = read_voxels(tmp_path / "g.vti")
    np.testing.assert_array_equal(again.values["temperature_k"], found.grid.values["temperature_k"])
    np.testing.assert_allclose(again.origin_mm, found.grid.origin_mm)


def test_the_stated_error_is_that_of_the_interpolation(tmp_path: Path) -> None:
    """Linear interpolation of x² is wrong by h²/4 in the middle of two nodes, and by 0 at them."""
    path = flow(tmp_path / "f.vti", lambda x, y, z: x * x, nodes=17, kind="image")
    found = resampled(path, (FlowArray("T", "absorption_per_mm"),), Resampling((1000.0, 2000.0, 2000.0), "m"))
    assert found.largest["absorption_per_mm"] == pytest.approx(0.25, rel=1e-6)
    # 8 of 17 layers of nodes across x.
    assert found.rms["absorption_per_mm"] == pytest.approx(0.25 * np.sqrt(8.0 / 17.0), rel=1e-6)
    # A cubic spline is exact.
    splined = resampled(path, (FlowArray("T", "density_kg_m3"),), Resampling((1000.0, 2000.0, 2000.0), "m"))
    assert splined.largest["density_kg_m3"] < 1e-6


def test_finer_voxels_state_a_smaller_error(tmp_path: Path) -> None:
    """Of a Gaussian with its nodes in line with all voxels, by about 2⁴ for each halving: cubic splines."""
    path = flow(tmp_path / "f.vti", lambda x, y, z: 300.0 + np.exp(-(x * x + y * y + z * z) / 4.0), 65, "image")
    errors = [
        resampled(path, (T,), Resampling((spacing,) * 3, "m")).largest["temperature_k"] for spacing in (1000.0, 500.0)
    ]
    assert 8.0 < errors[0] / errors[1] < 40.0


def test_values_in_cells_are_brought_to_points(tmp_path: Path) -> None:
    path = flow(tmp_path / "f.vtu", lambda x, y, z: 0.0 * x + 350.0, kind="cells")
    found = resampled(path, (T,), Resampling((2000.0,) * 3, "m"))
    np.testing.assert_allclose(found.grid.values["temperature_k"], 350.0, rtol=1e-6)


def test_voxels_outside_the_cells_take_the_value_that_is_given(tmp_path: Path) -> None:
    path = flow(tmp_path / "f.vtu", linear)
    wanted = Resampling((1000.0,) * 3, "m", (-6000.0, 6000.0, -4000.0, 4000.0, -4000.0, 4000.0))
    with pytest.raises(FileError, match=r"30\.8 % of the voxels lie outside its cells"):
        resampled(path, (T,), wanted)
    found = resampled(path, (FlowArray("T", "temperature_k", fill=293.0),), wanted)
    assert found.outside == pytest.approx(4.0 / 13.0)
    assert (found.grid.values["temperature_k"][[0, 1, -2, -1]] == 293.0).all()
    assert found.grid.values["temperature_k"][2, 4, 4] == pytest.approx(292.0, rel=1e-6)
    assert "lie outside the cells of the file" in found.lines()[-1]


@pytest.mark.parametrize(
    ("arrays", "wanted", "message"),
    [
        ((T,), Resampling((1.0,) * 3), "carry no unit of length; give one of um, mm"),
        ((T,), Resampling((1.0,) * 3, "mile"), "unknown unit 'mile'"),
        ((T,), Resampling((0.0,) * 3, "m"), "the spacing of voxels must be above 0"),
        ((T,), Resampling((1.0,) * 3, "m"), "8001 × 8001 × 8001 voxels; at most"),
        ((T,), Resampling((1e3,) * 3, "m", (1.0, -1.0, 0.0, 1.0, 0.0, 1.0)), "the lowest and highest x, y and z"),
        ((T,), Resampling((1e3,) * 3, "m", None, 2.0), "has no time 2 s; it has no times"),
        ((), Resampling((1e3,) * 3, "m"), "no array is named as a quantity.*its arrays are T, U"),
        ((FlowArray("p", "pressure_kpa"),), Resampling((1e3,) * 3, "m"), "has no array 'p'; its arrays are T, U"),
        ((FlowArray("T", "heat"),), Resampling((1e3,) * 3, "m"), "unknown quantity 'heat'"),
        ((FlowArray("U", "index"),), Resampling((1e3,) * 3, "m"), "U is a vector"),
        ((FlowArray("T", "index", -1.0),), Resampling((1e3,) * 3, "m"), "index is -.* it must be finite and 0 or more"),
    ],
)
def test_flows_that_cannot_be_resampled_are_refused(
    tmp_path: Path, arrays: tuple[FlowArray, ...], wanted: Resampling, message: str
) -> None:
    with pytest.raises(FileError, match=message):
        resampled(flow(tmp_path / "f.vtu", linear), arrays, wanted)


def test_files_without_a_volume_are_refused(tmp_path: Path) -> None:
    wanted = Resampling((1e3,) * 3, "m")
    sheet = pv.Plane()
    sheet.point_data["T"] = np.ones(sheet.n_points)
    sheet.save(tmp_path / "sheet.vtp")
    with pytest.raises(FileError, match="holds no cells with a volume"):
        resampled(tmp_path / "sheet.vtp", (T,), wanted)
    (tmp_path / "bad.vtu").write_text("<VTKFile")
    for name, message in (("bad.vtu", "bad.vtu: "), ("none.vtu", "cannot be read as a flow: it "), (".", "it is")):
        with pytest.raises(FileError, match=message):
            resampled(tmp_path / name, (T,), wanted)


HEAD = 'FoamFile {{ version 2.0; format ascii; class {kind}; location "{where}"; object {name}; }}\n'


def openfoam(folder: Path, temperatures: dict[str, tuple[float, float]]) -> Path:
    """Write an OpenFOAM case of two cubes of 1 m along x, with the temperature of each at some times."""

    def put(where: str, name: str, kind: str, text: str) -> None:
        (folder / where).mkdir(parents=True, exist_ok=True)
        (folder / where / name).write_text(HEAD.format(kind=kind, where=where, name=name) + text)

    points = [(x, y, z) for x in range(3) for y in range(2) for z in range(2)]
    number = {point: i for i, point in enumerate(points)}

    def across(x: int) -> list[int]:
        return [number[x, y, z] for y, z in ((0, 0), (1, 0), (1, 1), (0, 1))]

    def walls(x: int) -> list[list[int]]:
        ring = ((0, 0), (1, 0), (1, 1), (0, 1))
        pairs = zip(ring, (*ring[1:], ring[0]), strict=True)
        return [[number[x, *a], number[x, *b], number[x + 1, *b], number[x + 1, *a]] for a, b in pairs]

    # The internal face first; each face's normal leaves its owner.
    faces = [across(1), across(0)[::-1], *walls(0), across(2), *walls(1)]
    mesh = "constant/polyMesh"
    put(
        mesh,
        "points",
        "vectorField",
        f"{len(points)}\n(\n" + "\n".join(f"({x} {y} {z})" for x, y, z in points) + "\n)\n",
    )
    put(mesh, "faces", "faceList", "11\n(\n" + "\n".join(f"4({' '.join(map(str, f))})" for f in faces) + "\n)\n")
    put(mesh, "owner", "labelList", "11\n(\n" + "\n".join("00000011111") + "\n)\n")
    put(mesh, "neighbour", "labelList", "1\n(\n1\n)\n")
    put(mesh, "boundary", "polyBoundaryMesh", "1\n(\nwall { type patch; nFaces 10; startFace 1; }\n)\n")
    put("system", "controlDict", "dictionary", "application x; startTime 0; endTime 9; deltaT 1; writeInterval 1;\n")
    for time, (one, other) in temperatures.items():
        field = f"dimensions [0 0 0 1 0 0 0];\ninternalField nonuniform List<scalar> 2(\n{one}\n{other}\n);\n"
        put(time, "T", "volScalarField", field + "boundaryField { wall { type zeroGradient; } }\n")
    (folder / "case.foam").touch()
    return folder / "case.foam"


def test_the_last_time_of_an_openfoam_case_is_read_in_metres(tmp_path: Path) -> None:
    case = openfoam(tmp_path, {"1": (300.0, 300.0), "2.5": (400.0, 400.0)})
    wanted = Resampling((500.0, 500.0, 500.0))
    last, first = resampled(case, (T,), wanted), resampled(case, (T,), Resampling((500.0,) * 3, time_s=1.0))
    assert last.grid.shape == (5, 3, 3)
    np.testing.assert_allclose(last.grid.values["temperature_k"], 400.0, rtol=1e-6)
    np.testing.assert_allclose(first.grid.values["temperature_k"], 300.0, rtol=1e-6)
    np.testing.assert_allclose(last.grid.origin_mm, 0.0, atol=1e-6)
    with pytest.raises(FileError, match=r"has no time 2 s; it has times from 1 to 2\.5 s"):
        resampled(case, (T,), Resampling((500.0,) * 3, time_s=2.0))


def cgns(path: Path, field: Field, nodes: int = 5) -> Path:
    """Write a field T at the vertices of a structured zone of CGNS, a cube from -4 to 4 m, as HDF5."""

    def put(parent: h5py.Group, name: str, label: str, kind: str = "MT", data: Any = None) -> h5py.Group:
        made = parent.create_group(name) if name else parent
        for key, text, length in (("name", name or "HDF5 MotherNode", 33), ("label", label, 33), ("type", kind, 3)):
            made.attrs.create(key, np.bytes_(text), dtype=f"S{length}")
        made.attrs["flags"] = np.array([1], np.int32)
        if data is not None:
            made.create_dataset(" data", data=np.frombuffer(data.encode(), np.int8) if kind == "C1" else data)
        return made

    along = np.linspace(-4.0, 4.0, nodes)
    # Indices run along x first, and HDF5 holds the last one first.
    z, y, x = np.meshgrid(along, along, along, indexing="ij")
    with h5py.File(path, "w") as root:
        put(root, "", "Root Node of HDF5 File")
        put(root, "CGNSLibraryVersion", "CGNSLibraryVersion_t", "R4", np.array([3.1], np.float32))
        base = put(root, "Base", "CGNSBase_t", "I4", np.array([3, 3], np.int32))
        sizes = np.array([[nodes] * 3, [nodes - 1] * 3, [0] * 3], np.int32)
        zone = put(base, "Zone", "Zone_t", "I4", sizes)
        put(zone, "ZoneType", "ZoneType_t", "C1", "Structured")
        places = put(zone, "GridCoordinates", "GridCoordinates_t")
        for name, values in (("CoordinateX", x), ("CoordinateY", y), ("CoordinateZ", z)):
            put(places, name, "DataArray_t", "R8", values)
        solution = put(zone, "Solution", "FlowSolution_t")
        put(solution, "GridLocation", "GridLocation_t", "C1", "Vertex")
        put(solution, "T", "DataArray_t", "R8", field(x, y, z))
    return path


def test_a_linear_field_of_a_cgns_file_is_exact(tmp_path: Path) -> None:
    found = resampled(cgns(tmp_path / "f.cgns", linear), (T,), Resampling((1000.0, 500.0, 800.0), "m"))
    x, y, z = np.moveaxis(1e-3 * found.grid.centres_mm(), -1, 0)
    assert found.grid.shape == (9, 17, 11)
    np.testing.assert_allclose(found.grid.values["temperature_k"], linear(x, y, z), rtol=1e-5)


def test_a_file_that_crashes_the_reader_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The trial in another process ends by a signal, as after a segmentation fault."""
    path = flow(tmp_path / "f.vtu", linear)
    script = tmp_path / "crash.py"
    script.write_text("import os\nos.abort()\n")
    monkeypatch.setattr("lfmesh.imports.vtk_child.__file__", str(script))
    with pytest.raises(FileError, match="it is damaged, or larger than this machine's memory"):
        resampled(path, (T,), Resampling((1e3,) * 3, "m"))


def test_the_command_writes_the_grid_of_a_medium(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = flow(tmp_path / "f.vtu", linear), tmp_path / "plume.vti"
    given = ["grid", str(path), "-o", str(out), "--units", "m", "--spacing-mm", "1000", "1000", "1000"]
    assert main([*given, "--array", "T=pressure_kpa", "--factor", "T=0.1", "--fill", "T=5"]) == 0
    assert "9 × 9 × 9 voxels of 1000 × 1000 × 1000 mm" in " ".join(capsys.readouterr().out.split())
    assert read_voxels(out).values["pressure_kpa"][4, 4, 4] == pytest.approx(30.0, rel=1e-6)
    for wrong in (["--array", "T"], ["--array", "T=index", "--fill", "p=1"], ["--array", "T=index", "--factor", "T=x"]):
        assert main([*given, *wrong]) == 2
    assert main([*given[:3], str(tmp_path / "plume.npz"), *given[4:]]) == 2
