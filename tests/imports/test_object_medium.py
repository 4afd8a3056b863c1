"""Lens files of lenses that look into water: read with their object medium, and written with it."""

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
    with pytest.raises(SceneError, match="no maker's glass"):
        write_lens_file(lens, tmp_path / "lens.zmx")


def test_an_aperture_of_the_objects_side_counts_the_index(tmp_path: Path) -> None:
    """The numerical aperture is n sin U."""
    path = tmp_path / "wet.zmx"
    path.write_text(ZEMAX.replace("ENPD 6.0", "OBNA 0.01 0"))
    lens, _ = read_lens_file(path)
    water = Paraxial.of(lens, 587.6).indices[0]
    assert lens.surfaces[0].semi_diameter_mm == pytest.approx(400.0 * np.tan(np.arcsin(0.01 / water)), rel=1e-9)
