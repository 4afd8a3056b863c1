"""Lens files of lenses that look into water: read with their object medium, and written with it."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from lfmesh.errors import SceneError
from lfmesh.imports import read_lens_file, write_lens_file
from lfmesh.scene import Lens, Matter, Paraxial, Surface
from lfmesh.scene.materials.own_glass import OwnGlass

PORT = (
    Surface(thickness_mm=5.0, glass="SCHOTT/N-BK7", semi_diameter_mm=9.0),
    Surface(thickness_mm=2.0, semi_diameter_mm=9.0),
    Surface(radius_mm=20.0, thickness_mm=3.0, index=1.6, semi_diameter_mm=5.0),
    Surface(radius_mm=-25.0, thickness_mm=0.5, semi_diameter_mm=5.0),
    Surface(stop=True, semi_diameter_mm=4.0),
)

ZEMAX = """MODE SEQ
UNIT MM X W X CM MR CPMM
ENPD 6.0
WAVM 1 0.5876 1
SURF 0
  TYPE STANDARD
  CURV 0.0
  DISZ 400.0
  GLAS WATER 0 0 1.333 55 0 0
SURF 1
  STOP
  TYPE STANDARD
  CURV 0.05
  DISZ 4.0
  GLAS N-BK7 0 0 1.5168 64 0 0
SURF 2
  TYPE STANDARD
  CURV -0.05
  DISZ 60.0
SURF 3
  TYPE STANDARD
  CURV 0.0
  DISZ 0.0
"""

CODE_V = """RDM;LEN
TITLE 'wet'
EPD 6.0
DIM M
WL 587.6
SO 0.0 400.0 WATER
S 20.0 4.0 NBK7_SCHOTT
STO
S -20.0 60.0
SI 0.0 0.0
GO
"""


@pytest.mark.parametrize(
    ("ending", "matter"),
    [
        (".zmx", {"index": 1.333}),
        (".zmx", {"glass": OwnGlass(nd=1.333, vd=55.7)}),
        (".zmx", {"glass": "SCHOTT/N-SF11"}),
        (".seq", {"index": 1.333}),
        (".seq", {"index": 1.6}),
        (".seq", {"glass": "SCHOTT/N-SF11"}),
        (".seq", {"glass": OwnGlass(wavelengths_nm=(400.0, 600.0, 800.0), values=(1.34, 1.333, 1.329))}),
        (".toml", {"glass": "main/H2O/Daimon-20.0C"}),
    ],
)
def test_the_object_medium_comes_back(tmp_path: Path, ending: str, matter: dict[str, object]) -> None:
    lens = Lens(surfaces=PORT, object_medium=Matter(**matter))
    path = tmp_path / f"lens{ending}"
    write_lens_file(lens, path)
    again, _ = read_lens_file(path)
    wave = 587.6
    assert again.object_medium is not None
    assert Paraxial.of(again, wave).indices == pytest.approx(Paraxial.of(lens, wave).indices, rel=1e-12)
    assert Paraxial.of(again, wave).efl_mm == pytest.approx(Paraxial.of(lens, wave).efl_mm, rel=1e-10)
    # The stop comes back from its entrance pupil.
    assert again.surfaces[-1].semi_diameter_mm == pytest.approx(4.0, rel=1e-10)


OSLO = """\
LEN NEW "wet" 50 3
EBR 3.0
UNI 1.0
WV 0.5876
GLA MOD WET 1.333 1.333 1.333; TH 400.0
NXT
GLA MOD G1 1.5 1.5 1.5; RD 20.0; TH 4.0; AST
NXT
AIR; RD -20.0; TH 60.0
NXT
AIR
END 3
"""

TABLE = """\
surface,radius,thickness,index,semi-diameter,stop
obj,,400.0,1.333,,
1,20.0,4.0,1.5,3.0,x
2,-20.0,60.0,1.0,5.0,
"""


def optiland() -> str:
    """Return such a file of optiland's."""

    def surface(z: float, radius: float, index: float, stop: bool = False) -> dict[str, object]:
        frame = {"x": 0.0, "y": 0.0, "z": z, "rx": 0.0, "ry": 0.0, "rz": 0.0, "reference_cs": None}
        kind = "Plane" if math.isinf(radius) else "StandardGeometry"
        return {
            "type": "Surface", "geometry": {"type": kind, "cs": frame, "radius": radius, "conic": 0.0},
            "material_post": {"type": "IdealMaterial", "index": index, "absorp": 0.0},
            "is_stop": stop, "aperture": None, "comment": "",
            "interaction_model": {
                "type": "RefractiveReflectiveModel", "is_reflective": False, "coating": None, "bsdf": None
            },
        }  # fmt: skip

    surfaces = [
        surface(-400.0, math.inf, 1.333), surface(0.0, 20.0, 1.5, True), surface(4.0, -20.0, 1.0),
        surface(64.0, math.inf, 1.0),
    ]  # fmt: skip
    data = {
        "version": 1.0, "name": "wet", "aperture": {"type": "EPD", "value": 6.0},
        "fields": {"fields": [{"x": 0.0, "y": 0, "vx": 0.0, "vy": 0.0}],
                   "field_definition": {"field_type": "AngleField"}},
        "wavelengths": {"wavelengths": [{"value": 587.6, "is_primary": True, "unit": "nm"}]},
        "pickups": [], "solves": {"solves": []}, "surface_group": {"surfaces": surfaces},
    }  # fmt: skip
    return json.dumps(data)


@pytest.mark.parametrize(("ending", "text"), [(".len", OSLO), (".csv", TABLE), (".json", optiland())])
def test_an_index_before_the_lens_is_read(tmp_path: Path, ending: str, text: str) -> None:
    """Of other programs' files the power is that of two faces, the first of them with the step from water."""
    path = tmp_path / f"wet{ending}"
    path.write_text(text)
    lens, report = read_lens_file(path)
    assert report.conditions is not None
    assert report.conditions.object_mm == pytest.approx(400.0)
    found = Paraxial.of(lens, 587.6)
    assert found.indices == pytest.approx((1.333, 1.5, 1.0), rel=1e-12)
    first, second = (1.5 - 1.333) / 20.0, (1.0 - 1.5) / -20.0
    assert 1.0 / found.efl_mm == pytest.approx(first + second - first * second * 4.0 / 1.5, rel=1e-12)


@pytest.mark.parametrize("ending", [".zmx", ".seq", ".toml"])
@pytest.mark.parametrize("index", [None, 1.0])
def test_a_stop_before_the_port_comes_back_with_what_is_behind_it(
    tmp_path: Path, ending: str, index: float | None
) -> None:
    """The medium, where the stop names none, and air where it names that."""
    stop = Surface(stop=True, thickness_mm=2.0, semi_diameter_mm=3.0, index=index)
    last = Surface(radius_mm=-25.0, semi_diameter_mm=5.0)
    lens = Lens(surfaces=(stop, *PORT[:-2], last), object_medium=Matter(index=1.333))
    path = tmp_path / f"lens{ending}"
    write_lens_file(lens, path)
    again, _ = read_lens_file(path)
    indices = Paraxial.of(lens, 587.6).indices
    assert indices[:2] == (1.333, index or 1.333)
    assert Paraxial.of(again, 587.6).indices == pytest.approx(indices, rel=1e-12)


@pytest.mark.parametrize(("ending", "text"), [(".zmx", ZEMAX), (".seq", CODE_V)])
def test_water_in_object_space_is_read(tmp_path: Path, ending: str, text: str) -> None:
    path = tmp_path / f"wet{ending}"
    path.write_text(text)
    lens, report = read_lens_file(path)
    assert lens.media[0] == "main/H2O/Daimon-20.0C"
    assert report.conditions is not None
    assert report.conditions.object_mm == pytest.approx(400.0)
    # φ = φ1 + φ2 − φ1 φ2 t/n, φ1 with the index step from water.
    _, glass, _ = Paraxial.of(lens, 587.6).indices
    water = Paraxial.of(lens, 587.6).indices[0]
    first, second = (glass - water) / 20.0, (1.0 - glass) / -20.0
    assert 1.0 / Paraxial.of(lens, 587.6).efl_mm == pytest.approx(first + second - first * second * 4.0 / glass)
    assert water == pytest.approx(1.3334, abs=3e-4)


def test_water_by_its_measurements_has_no_name_in_zemax(tmp_path: Path) -> None:
    lens = Lens(surfaces=PORT, object_medium=Matter(glass="main/H2O/Daimon-20.0C"))
    with pytest.raises(SceneError, match="not a maker's glass"):
        write_lens_file(lens, tmp_path / "lens.zmx")


def test_an_aperture_of_the_objects_side_counts_the_index(tmp_path: Path) -> None:
    """The numerical aperture is n sin U."""
    path = tmp_path / "wet.zmx"
    path.write_text(ZEMAX.replace("ENPD 6.0", "OBNA 0.01 0"))
    lens, _ = read_lens_file(path)
    water = Paraxial.of(lens, 587.6).indices[0]
    assert lens.surfaces[0].semi_diameter_mm == pytest.approx(400.0 * np.tan(np.arcsin(0.01 / water)), rel=1e-9)
