"""Tables, grids, profiles, pictures, studies, datasets, designs damaged at random are read or refused clearly."""

import codecs
import functools
import io
import json
import re
import tempfile
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import PIL.Image
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.errors import FileError, LensFileWarning, LfmeshError
from lfmesh.files import exr
from lfmesh.files.calibration import read_calibration, write_calibration
from lfmesh.files.white_picture import read_picture
from lfmesh.geometry.voxels import read_voxels
from lfmesh.imports.coatings import CoatingFile, UnreadableCoatingError
from lfmesh.imports.gradient_files import GradientFiles, MissingMaterialError
from lfmesh.imports.lens_file import read_lens, write_lens_file
from lfmesh.lightfield.volumes.voxel_box import read_box
from lfmesh.optics.curve import read_curve
from lfmesh.optics.light_profile import read_profile
from lfmesh.optics.phase_grid import read_phase_grid
from lfmesh.optics.reflectance_table import read_reflectance
from lfmesh.scene import solved
from lfmesh.scene.light.particles import Particles, particle_places
from lfmesh.study.fits.board_files import read_corners
from lfmesh.study.optimise.optimise import load_design
from tests.cameras import bench_camera
from tests.fuzz.test_meshes import damaged, damages, kept
from tests.imports.files import CROWDED_ZMX, GRADIENT_FILES, GRADIENTS_ZMX, PHASES_SEQ, PHASES_ZMX
from tests.imports.test_optiland_phases import PHASES as OPTILAND_PHASES

SCENE = bench_camera(4, 4) + (
    '[[targets]]\nshape = { kind = "plane", width_mm = 6.0, height_mm = 6.0 }\nposition_mm = [0.0, 0.0, -500.0]\n'
)

CORNERS = "board_x_mm,board_y_mm,view_row,view_column,row,column\n" + "".join(
    f"{5.5 * x},{5.5 * y},0.5,-1.5,{3 + y},{2.5 + x}\n" for x in range(3) for y in range(3)
)
STUDY = """name = "tilts"
scene = "scene.toml"
metrics = ["psnr", "light"]
design = "grid"
seed = 1
batches = 1
edge_distance_mm = 400.0
[changes]
"transport.samples" = 16
[limits]
"psnr_db" = 30.0
[[compensators]]
path = "camera.mla.pose.tilt_deg[2]"
range = [-0.1, 0.1]
metric = "psnr_db"
[[axes]]
path = "camera.mla.pose.tilt_deg[0]"
values = [0.0, 0.1, 0.2]
[[axes]]
path = "camera.mla.pose.shift_mm[1]"
uniform = [-0.01, 0.01]
count = 3
relative = true
"""
FILLING = STUDY.replace('"grid"', '"sobol"\ncount = 4').replace("values = [0.0, 0.1, 0.2]", "normal = [0.0, 0.1]")
FILLING = FILLING.replace("count = 3\nrel", "rel")
DATASET = """scene = "scene.toml"
count = 3
seed = 2
parts = ["white", "camera"]
views = 3
[changes]
"transport.samples" = 16
[[random]]
path = "targets[0].position_mm[2]"
uniform = [-500.0, -300.0]
[[random]]
path = "targets[0].material.reflectance"
values = [0.2, 0.5]
[[random]]
path = "targets[0].position_mm[0]"
normal = [0.0, 1.0]
relative = true
"""
DESIGN = """scene = "scene.toml"
[changes]
"camera.lens.surfaces[1].radius_mm" = 48.0
[rays]
object_mm = 400.0
height_mm = 1.0
across = 4
[search]
starts = 2
evaluations = 3
[[variables]]
path = "camera.lens.surfaces[1].radius_mm"
range = [30.0, 80.0]
[[variables]]
path = "camera.lens.surfaces[1].index"
values = [1.5, 1.6]
[[merit]]
metric = "mtf"
per_mm = 5.0
field = 0.7
[[merit]]
metric = "efl_mm"
target = 50.0
weight = 0.1
[[constraints]]
metric = "edge_thickness_mm"
least = 0.1
"""
IES = """IESNA:LM-63-2002
[TEST] a lamp
TILT=INCLUDE
1
2
0 90
1 0.9
1 1000 1 3 2 1 2 0.1 0.1 0.1
1 1 20
0 45 90
0 360
100 80 10
100 80 10
"""
DISPLACED = "x_mm,y_mm,z_mm,dx_mm,dy_mm,dz_mm\n" + "".join(
    f"{x},{y},{z},0.1,0.0,{0.1 * x}\n" for x in (-5, 5) for y in (-5, 5) for z in (-505, -495)
)
COATING = "wavelength_nm,angle_deg,reflectance\n" + "".join(
    f"{w},{a},{r}\n" for w in (400, 700) for a, r in ((0, 0.01), (45, 0.02), (90, 1))
)
COATING_DAT = """MATE X
0.4 1.4 0
0.7 1.3 -0.1
COAT STACK
X 0.25 0 2
X 0.05 1 2
IDEAL GREY 0.5 0.5
TABLE MEASURED
ANGL 0
WAVE 0.5 0.1 0.1 0.9 0.9
"""

PARTICLES = "x_mm,y_mm,z_mm,intensity_w_sr\n1,2,-500,0.1\n2,2.5,-510,1e-3\n"
SPECTRUM = "wavelength_nm,value\n400,0.5\n500,0.7\n700,0.1\n"


class Beside(NamedTuple):
    """A scene that finds its files in a folder."""

    folder: Path

    def resolve(self, path: str | Path) -> Path:
        return self.folder / path


def coating_file(path: Path) -> Any:
    file = CoatingFile.read(path)
    for name in file.entries:
        with suppress(UnreadableCoatingError):
            file.coating(name, 587.6)


def gradient_file(path: Path) -> Any:
    files = GradientFiles(path.parent, (path,))
    for find, name in ((files.dispersion, "GSF"), (files.rod, "SLS-1.0"), (files.blank, "G41SFN")):
        with suppress(MissingMaterialError):
            find(name)


def profile(path: Path) -> Any:
    found = read_profile(path)
    assert np.isfinite(found.shares()).all()
    assert found.shares().sum() == pytest.approx(1.0)


def particles(path: Path) -> Any:
    places, _ = particle_places(Particles(file=path.name), Beside(path.parent))
    assert np.isfinite(places).all()


def displaced(path: Path) -> Any:
    moved = {"kind": "file", "file": path.name}
    drawn = {"count": 20, "bounds": {"kind": "sphere", "radius_mm": 3.0}, "position_mm": (0.0, 0.0, -500.0)}
    group = Particles(**drawn, displacement=moved, frame=1, intensity_w_sr=1.0)  # type: ignore[arg-type]
    assert np.isfinite(particle_places(group, Beside(path.parent))[0]).all()


def study(path: Path) -> Any:
    (path.parent / "scene.toml").write_text(SCENE)
    return lf.Study.load(path)


def dataset(path: Path) -> Any:
    (path.parent / "scene.toml").write_text(SCENE)
    return lf.Dataset.load(path)


def design(path: Path) -> Any:
    (path.parent / "scene.toml").write_text(SCENE)
    return load_design(path)


def lens(path: Path) -> Any:
    read_lens(path)
    scene = f"""[camera]
lens = {{ file = "{path.name}" }}
mla = {{ count = [4, 4], pitch_mm = 0.1, focal_length_mm = 0.5, index = 1.5, thickness_mm = 0.3 }}
focus_mm = 500.0
sensor = {{ pixels = [8, 8], pixel_mm = 0.05 }}
"""
    return lf.first_order(lf.loads(scene, path.parent))


class Kind(NamedTuple):
    """A kind of file: its ending, a whole file, and what reads it."""

    ending: str
    whole: bytes
    read: Callable[[Path], Any]


def npz(**arrays: Any) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def npy(array: Any) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def picture(ending: str) -> bytes:
    stream = io.BytesIO()
    PIL.Image.fromarray((np.arange(1600).reshape(40, 40) % 251).astype(np.uint8)).save(stream, ending)
    return stream.getvalue()


GRID = np.linspace(0.0, 1.0, 24).reshape(2, 3, 4)
PHASES = np.linspace(0.0, 9.0, 30).reshape(6, 5)


def by_writing(ending: str, write: Callable[[Path], Any]) -> bytes:
    """Return the file that something writes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"file.{ending}"
        write(path)
        return path.read_bytes()


def vti(path: Path, binary: bool = False) -> None:
    import pyvista

    image = pyvista.ImageData(dimensions=GRID.shape, spacing=(1.0, 1.0, 2.0))
    image.point_data["absorption_per_mm"] = GRID.ravel(order="F")
    image.save(path, binary=binary)


def as_lens(ending: str) -> bytes:
    triplet, _ = read_lens(asset_path("lenses/cooke_triplet_50mm.toml"))
    return by_writing(ending, lambda path: write_lens_file(triplet, path))


def calibration() -> bytes:
    return by_writing("json", lambda path: write_calibration(path, lf.calibrate(solved(lf.loads(SCENE)))))


def foreign_exr(path: Path) -> None:
    exr.write_maps(path, {"Y": np.ones((8, 8))}, {})


TEXTS: dict[str, Callable[[], Kind]] = {
    "corners": lambda: Kind("csv", CORNERS.encode(), read_corners),
    "study": lambda: Kind("toml", STUDY.encode(), study),
    "filling study": lambda: Kind("toml", FILLING.encode(), study),
    "dataset": lambda: Kind("toml", DATASET.encode(), dataset),
    "design": lambda: Kind("toml", DESIGN.encode(), design),
    "particles": lambda: Kind("csv", PARTICLES.encode(), particles),
    "displacements": lambda: Kind("csv", DISPLACED.encode(), displaced),
    "profile": lambda: Kind("ies", IES.encode(), profile),
    "coating": lambda: Kind("csv", COATING.encode(), read_reflectance),
    "coating file": lambda: Kind("dat", COATING_DAT.encode(), coating_file),
    "spectrum": lambda: Kind("csv", SPECTRUM.encode(), lambda path: read_curve(path, "value")),
    "lens": lambda: Kind("toml", asset_path("lenses/cooke_triplet_50mm.toml").read_bytes(), lens),
    "zmx": lambda: Kind("zmx", as_lens("zmx"), lens),
    "seq": lambda: Kind("seq", as_lens("seq"), lens),
    "crowded zmx": lambda: Kind("zmx", CROWDED_ZMX.encode(), lens),
    "gradients zmx": lambda: Kind("zmx", GRADIENTS_ZMX.encode(), lens),
    "gradient dispersions": lambda: Kind("dat", GRADIENT_FILES["SGRIN.DAT"].encode(), gradient_file),
    "gradient rods": lambda: Kind("dat", GRADIENT_FILES["GRADIENT_9.DAT"].encode(), gradient_file),
    "gradient blanks": lambda: Kind("grd", GRADIENT_FILES["PROFILE.GRD"].encode(), gradient_file),
    "phases zmx": lambda: Kind("zmx", PHASES_ZMX.encode(), lens),
    "phases seq": lambda: Kind("seq", PHASES_SEQ.encode(), lens),
    "phases optiland": lambda: Kind("json", json.dumps(OPTILAND_PHASES, indent=1).encode(), lens),
    "calibration": lambda: Kind("json", calibration(), read_calibration),
    "vti": lambda: Kind("vti", by_writing("vti", vti), read_voxels),
}
BINARIES: dict[str, Callable[[], Kind]] = {
    "npz": lambda: Kind("npz", npz(absorption_per_mm=GRID, spacing_mm=1.0, origin_mm=np.zeros(3)), read_voxels),
    "packed vti": lambda: Kind("vti", by_writing("vti", lambda path: vti(path, binary=True)), read_voxels),
    "phases": lambda: Kind("npz", npz(phase_rad=PHASES, spacing_mm=0.5, origin_mm=np.zeros(2)), read_phase_grid),
    "box": lambda: Kind("npz", npz(absorption_per_mm=GRID, spacing_mm=np.ones(3)), read_box),
    "npy": lambda: Kind("npy", npy(GRID), lambda path: read_voxels(path, 1.0, quantity="absorption_per_mm")),
    "board": lambda: Kind("png", picture("png"), lambda path: read_picture(path, "picture of the board")),
    "photograph": lambda: Kind("tiff", picture("tiff"), lambda path: read_picture(path, "white image")),
    "exr": lambda: Kind("exr", by_writing("exr", foreign_exr), lambda path: read_picture(path, "white image")),
}


LENS_FILES = ("phases zmx", "phases seq", "phases optiland", "gradients zmx")
WITH_SCENES = ("study", "filling study", "dataset", "design", "lens", "zmx", "seq", "crowded zmx", *LENS_FILES)
"""What names a scene, or is part of one: all faults are said at once."""


@functools.cache
def kind_of(name: str) -> Kind:
    return (TEXTS | BINARIES)[name]()


def is_read_or_refused(folder: Path, name: str, content: bytes) -> None:
    kind = kind_of(name)
    path = folder / f"file.{kind.ending}"
    path.write_bytes(content)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LensFileWarning)
            kind.read(path)
    except LfmeshError as error:
        lines = str(error).splitlines()
        assert 1 <= len(lines) <= (22 if name in WITH_SCENES else 1), lines
        assert all(len(line) < 1600 for line in lines)
        assert path.name in lines[0] or name in WITH_SCENES, lines


WORD = re.compile(rb"[^\s,;=\[\]{}\"<>]+")
HARSH = [
    *[
        b"",
        b"0",
        b"-1",
        b"1.5",
        b"nan",
        b"inf",
        b"1e400",
        b"1e300",
        b"1e-320",
        b"9" * 5000,
        b"0x10",
        b"1_000",
        b'"',
        b"'",
    ],
    *[b"\x00", b"\xff\xfe", "é²".encode(), b"\n", b"\r", b",", b"a" * 200_000, b"[" * 3000, b"99999999999", b"true"],
    *[b"..", b"/dev/zero", b"1" + b"0" * 400, b"[1, 2]", b"null", b"2147483647"],
]
words = st.lists(st.tuples(st.floats(0.0, 1.0, exclude_max=True), st.sampled_from(HARSH)), min_size=1, max_size=3)


def with_words(whole: bytes, words: list[tuple[float, bytes]]) -> bytes:
    """Return a text with some of its words replaced."""
    places = list(WORD.finditer(whole))
    for share, word in sorted(words, reverse=True):
        place = places[int(share * len(places))]
        whole = whole[: place.start()] + word + whole[place.end() :]
    return whole


unhurried = settings(
    deadline=None, derandomize=True, database=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.mark.parametrize("name", [*TEXTS, *BINARIES])
def test_the_files_that_are_damaged_are_whole(tmp_path: Path, name: str) -> None:
    kind = kind_of(name)
    path = tmp_path / f"file.{kind.ending}"
    path.write_bytes(kind.whole)
    kind.read(path)


@pytest.mark.parametrize("name", sorted({*TEXTS} - {"zmx"}))  # which is UTF-16 with a mark of its own
def test_a_byte_order_mark_is_no_part_of_a_text(tmp_path: Path, name: str) -> None:
    kind = kind_of(name)
    path = tmp_path / f"file.{kind.ending}"
    path.write_bytes(codecs.BOM_UTF8 + kind.whole)
    kind.read(path)


QUICK = sorted({*TEXTS, *BINARIES} - {"vti", "packed vti"})
"""Kinds but those that are read in a process of their own."""


@settings(unhurried, max_examples=300)
@given(st.sampled_from(sorted({*TEXTS} & {*QUICK})), words)
def test_a_text_with_other_words_is_read_or_refused(
    tmp_path: Path, name: str, words: list[tuple[float, bytes]]
) -> None:
    is_read_or_refused(tmp_path, name, with_words(kind_of(name).whole, words))


@settings(unhurried, max_examples=300)
@given(st.sampled_from(QUICK), damages, kept)
def test_a_damaged_file_is_read_or_refused(
    tmp_path: Path, name: str, damage: list[tuple[float, bytes]], kept: float
) -> None:
    is_read_or_refused(tmp_path, name, damaged(kind_of(name).whole, damage, kept))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"phase_rad": PHASES[0]}, r"phase_rad has the shape \(5,\)"),
        ({"phase_rad": PHASES[None]}, r"phase_rad has the shape \(1, 6, 5\)"),
        ({"phase_rad": PHASES[:3]}, r"phase_rad has the shape \(3, 5\)"),
        ({"phase_rad": PHASES[:0]}, r"phase_rad has the shape \(0, 5\)"),
        ({"phase_rad": np.float64(1.0)}, r"phase_rad has the shape \(\)"),
        ({"phase_rad": PHASES + 0j}, "phase_rad must hold real numbers"),
        ({"phase_rad": PHASES.astype(str)}, "phase_rad must hold real numbers"),
        ({"phase_rad": np.where(PHASES > 8.0, np.nan, PHASES)}, "phase_rad must be finite"),
        ({"phase_rad": np.where(PHASES > 8.0, np.inf, PHASES)}, "phase_rad must be finite"),
        ({"phase_rad": np.mod(3.0 * PHASES, 6.28)}, "phase_rad looks wrapped"),
        ({"spacing_mm": [0.5, 0.5, 0.5]}, r"spacing_mm has the shape \(3,\)"),
        ({"spacing_mm": [0.5, 0.0]}, "spacing_mm must be above 0"),
        ({"spacing_mm": -0.5}, "spacing_mm must be above 0"),
        ({"spacing_mm": np.nan}, "spacing_mm must be finite"),
        ({"origin_mm": 0.0}, r"origin_mm has the shape \(\)"),
        ({"origin_mm": [0.0, np.inf]}, "origin_mm must be finite"),
        ({"height_mm": 1.0}, "unknown array 'height_mm'"),
    ],
)
def test_a_grid_that_is_no_phase_is_refused(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    path = tmp_path / "phase.npz"
    path.write_bytes(npz(**{"phase_rad": PHASES, "spacing_mm": 0.5} | changes))
    with pytest.raises(FileError, match=rf"phase\.npz: {words}"):
        read_phase_grid(path)


@pytest.mark.parametrize("extent", [b"0 2147483647 0 2 0 3", b"0 1 0 2 0 100000000000"])
def test_an_image_that_crashes_vtk_is_refused(tmp_path: Path, extent: bytes) -> None:
    path = tmp_path / "grid.vti"
    whole = kind_of("vti").whole
    path.write_bytes(whole.replace(b'WholeExtent="0 1 0 2 0 3"', b'WholeExtent="' + extent + b'"'))
    assert path.read_bytes() != whole
    with pytest.raises(FileError, match=r"grid\.vti: (cannot be read as VTK image data: it is damaged|has \d+ voxels)"):
        read_voxels(path)


@pytest.mark.long
@settings(unhurried, max_examples=5_000)
@given(st.sampled_from(sorted(TEXTS)), words)
def test_many_texts_with_other_words_are_read_or_refused(
    tmp_path: Path, name: str, words: list[tuple[float, bytes]]
) -> None:
    is_read_or_refused(tmp_path, name, with_words(kind_of(name).whole, words))


@pytest.mark.long
@settings(unhurried, max_examples=5_000)
@given(st.sampled_from(sorted(TEXTS | BINARIES)), damages, kept)
def test_many_damaged_files_are_read_or_refused(
    tmp_path: Path, name: str, damage: list[tuple[float, bytes]], kept: float
) -> None:
    is_read_or_refused(tmp_path, name, damaged(kind_of(name).whole, damage, kept))
