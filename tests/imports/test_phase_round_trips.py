"""Phases written to Zemax and CODE V files and read again."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.errors import SceneError
from lfmesh.imports import read_lens_file, write_lens_file
from lfmesh.imports.conditions import Conditions
from tests.imports.test_zemax_phases import values_of

SEMI = 4.0
ENDINGS = (".zmx", ".seq")
KINDS = ("radial", "xy", "grating", "ruled grating", "hologram")
POINTS = np.random.default_rng(0).uniform(-0.7 * SEMI, 0.7 * SEMI, (40, 2))


def phase(draw: np.random.Generator, kind: str) -> dict[str, Any]:
    """Return a random phase."""
    keys: dict[str, Any] = {"kind": kind.split()[-1], "order": int(draw.choice([-2, -1, 1, 3]))}
    if kind == "radial":
        keys |= {"coefficients_rad": (50.0 * draw.normal(size=draw.integers(1, 6))).tolist(), "radius_mm": 1.3 * SEMI}
    elif kind == "xy":
        powers = {(int(i), int(j)) for i, j in draw.integers(0, 5, (6, 2))} - {(0, 0)}
        keys |= {"coefficients_rad": [(i, j, float(30.0 * draw.normal())) for i, j in sorted(powers)], "radius_mm": 5.5}
    elif kind == "grating":
        keys |= {"lines_per_mm": float(draw.uniform(1.0, 50.0)), "direction_deg": float(draw.uniform(-180.0, 180.0))}
    elif kind == "ruled grating":
        keys |= {"lines_per_mm": float(draw.uniform(1.0, 50.0)), "direction_deg": float(draw.choice([90.0, -90.0]))}
    else:
        for point in (1, 2):
            x, y, z = draw.uniform(-20.0, 20.0, 3)
            keys |= {f"point_{point}_mm": (float(x), float(y), float(z + math.copysign(100.0, z)))}
            keys |= {f"point_{point}": str(draw.choice(["real", "virtual"]))}
        keys |= {"construction_nm": 532.123456789}
    return keys


def random_lens(seed: int, kind: str) -> lf.Lens:
    """Return a lens of two elements, each surface of which has a phase of one kind."""
    draw = np.random.default_rng([seed, KINDS.index(kind)])
    aspheric = kind not in ("hologram", "ruled grating")
    surfaces = []
    for number in range(4):
        keys: dict[str, Any] = {"radius_mm": float(draw.choice([-1.0, 1.0]) * draw.uniform(20.0, 80.0))}
        keys |= {"conic": float(draw.uniform(-2.0, 0.5))} if kind != "hologram" else {"radius_mm": math.inf}
        keys |= {"semi_diameter_mm": SEMI, "phase": phase(draw, kind)}
        if aspheric and draw.random() < 0.5:
            keys["asphere_mm"] = (0.02 * draw.normal(size=3) / SEMI ** np.arange(4.0, 10.0, 2.0)).tolist()
        keys |= {"index": 1.5 + 0.1 * number} if number % 2 == 0 else {}
        keys |= {"thickness_mm": 5.0} if number < 3 else {}
        surfaces.append(keys)
    surfaces[int(draw.integers(4))]["stop"] = True
    return lf.Lens(surfaces=surfaces)


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.filterwarnings("ignore::lfmesh.errors.LensFileWarning")
def test_random_phases_come_back(seed: int, kind: str, ending: str, tmp_path: Path) -> None:
    lens = random_lens(seed, kind)
    write_lens_file(lens, tmp_path / f"lens{ending}", Conditions((550.0,), image_mm=60.0))
    again, report = read_lens_file(tmp_path / f"lens{ending}")
    assert len(again.surfaces) == len(lens.surfaces)
    assert next(note for note in report.notes if note.startswith("phases: ")).startswith("phases: 4, of surfaces 0 (")
    for one, other in zip(lens.surfaces, again.surfaces, strict=True):
        assert other.stop == one.stop
        for x, y in ((0.0, 2.0), (2.2, 0.0), (1.5, -1.1)):
            assert other.sag_at_mm(x, y) == pytest.approx(one.sag_at_mm(x, y), abs=1e-12)
        before, after = values_of(one.phase, POINTS), values_of(other.phase, POINTS)
        np.testing.assert_allclose(after, before, rtol=1e-12, atol=1e-12 * np.abs(before).max())
    if ending == ".zmx" and kind in ("radial", "xy"):
        assert [sorted(each.phase.coefficients_rad) for each in again.surfaces] == [
            sorted(each.phase.coefficients_rad) for each in lens.surfaces
        ]


@pytest.mark.parametrize("kind", KINDS)
def test_a_phase_goes_through_both_formats(kind: str, tmp_path: Path) -> None:
    lens = random_lens(9, kind)
    first = tmp_path / "one.zmx"
    write_lens_file(lens, first, Conditions((550.0,), image_mm=60.0))
    write_lens_file(read_lens_file(first)[0], tmp_path / "two.seq", Conditions((600.0,), image_mm=60.0))
    again, _ = read_lens_file(tmp_path / "two.seq")
    for one, other in zip(lens.surfaces, again.surfaces, strict=True):
        before, after = values_of(one.phase, POINTS), values_of(other.phase, POINTS)
        np.testing.assert_allclose(after, before, rtol=1e-12, atol=1e-12 * np.abs(before).max())


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_phase_of_both_formats_keeps_its_type(ending: str, tmp_path: Path) -> None:
    written = {
        ".zmx": ("BINARY_2", "BINARY_1", "BINARY_1", "DGRATING", "HOLOGRM"),
        ".seq": ("DOE", "DOE", "GRT", "GRT", "HOE"),
    }
    for kind, name in zip(KINDS, written[ending], strict=True):
        path = tmp_path / f"{kind}{ending}"
        write_lens_file(random_lens(1, kind), path, Conditions((550.0,), image_mm=60.0))
        text = path.read_text("utf-16" if ending == ".zmx" else "utf-8")
        assert text.count(f"TYPE {name}" if ending == ".zmx" else f"DIF {name}") == 4


def single(**keys: Any) -> lf.Lens:
    """Return a lens of one element with a phase on its second surface."""
    back = {"radius_mm": -50.0, "semi_diameter_mm": SEMI} | keys
    front = {"radius_mm": 50.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": SEMI, "stop": True}
    return lf.Lens(surfaces=(front, back))


RADIAL = {"kind": "radial", "coefficients_rad": [-10.0], "radius_mm": 4.0}
GRATING = {"kind": "grating", "lines_per_mm": 5.0, "direction_deg": 90.0}
METALENS = {"kind": "metalens", "focal_length_mm": 20.0, "design_nm": 550.0}
ZONES = {
    "kind": "zones",
    "zones": [{"border_mm": 1.0, "coefficients_rad": [-5.0], "radius_mm": 1.0},
              {"coefficients_rad": [-9.0], "radius_mm": 4.0}],
}  # fmt: skip
HOLOGRAM = {
    "kind": "hologram",
    "point_1_mm": (0.0, 0.0, -90.0),
    "point_2_mm": (0.0, 0.0, 90.0),
    "construction_nm": 550.0,
}


@pytest.mark.parametrize(
    ("ending", "keys", "said"),
    [
        (".zmx", {"phase": METALENS}, "surfaces[1].phase: a Zemax file cannot hold a phase of kind metalens"),
        (".seq", {"phase": METALENS}, "surfaces[1].phase: a CODE V file cannot hold a phase of kind metalens"),
        (".zmx", {"phase": ZONES}, "surfaces[1].phase: a Zemax file cannot hold a phase of kind zones"),
        (".seq", {"phase": ZONES}, "surfaces[1].phase: a CODE V file cannot hold a phase of kind zones"),
        (
            ".zmx", {"outer_zone": {"border_mm": 1.0, "radius_mm": -40.0}},
            "surfaces[1].outer_zone: not written to Zemax files",
        ),
        (
            ".seq", {"outer_zone": {"border_mm": 1.0, "radius_mm": -40.0}},
            "surfaces[1].outer_zone: not written to CODE V files",
        ),
        (".zmx", {"phase": {"kind": "grid", "file": "phase.npz"}}, "a Zemax file cannot hold a phase of kind grid"),
        (".seq", {"phase": {"kind": "grid", "file": "phase.npz"}}, "a CODE V file cannot hold a phase of kind grid"),
        (
            ".zmx", {"phase": RADIAL | {"orders": [{"order": 0, "share": 0.5}, {"order": 1, "share": 0.5}]}},
            "surfaces[1].phase: a Zemax file holds one order of a phase",
        ),
        (
            ".seq", {"phase": RADIAL | {"reflected_orders": [{"order": 1, "share": 1.0}]}},
            "surfaces[1].phase: a CODE V file holds one order of a phase",
        ),
        (".zmx", {"phase": RADIAL, "odd_asphere_mm": [1e-5]}, "surfaces[1].odd_asphere_mm: Zemax's surfaces"),
        (".zmx", {"phase": RADIAL, "asphere_mm": [1e-9] * 8}, "surfaces[1].asphere_mm: Zemax's BINARY_2 has 7 terms"),
        (".zmx", {"phase": HOLOGRAM}, "a Zemax file cannot hold the phase of a hologram on a curved surface"),
        (".seq", {"phase": HOLOGRAM}, "a CODE V file cannot hold the phase of a hologram on a curved surface"),
        (
            ".zmx", {"phase": {"kind": "xy", "coefficients_rad": [(20, 1, 1.0)], "radius_mm": 4.0}},
            "surfaces[1].phase.coefficients_rad: Zemax's BINARY_1 has powers i + j up to 20",
        ),
        (
            ".seq", {"phase": {"kind": "xy", "coefficients_rad": [(10, 1, 1.0)], "radius_mm": 4.0}},
            "surfaces[1].phase.coefficients_rad: CODE V's polynomial XY has 65 terms",
        ),
        (".seq", {"phase": RADIAL | {"coefficients_rad": [1.0] * 11}}, "CODE V's polynomial R has 10 terms, not 11"),
        (".seq", {"phase": RADIAL | {"coefficients_rad": [1.0] * 8, "radius_mm": 1e-25}}, "leaves the range"),
    ],
)  # fmt: skip
def test_a_phase_that_a_file_cannot_hold_is_refused_in_one_line(ending, keys, said, tmp_path):
    path = tmp_path / f"lens{ending}"
    with pytest.raises(SceneError) as raised:
        write_lens_file(single(**keys), path, Conditions(image_mm=50.0))
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)
    assert not path.exists()


@pytest.mark.parametrize("ending", ENDINGS)
def test_an_efficiency_is_noted_as_missing(ending, tmp_path):
    path = tmp_path / f"lens{ending}"
    for keys in (
        {"efficiency": 0.8},
        {"efficiency": "blaze", "design_nm": 550.0},
        {"orders": [{"order": 1, "share": 0.9}]},
    ):
        notes = write_lens_file(single(phase=RADIAL | keys), path, Conditions(image_mm=50.0))
        assert "efficiencies of the phases of surfaces 1 are not in the file" in notes
    assert not [
        note for note in write_lens_file(single(phase=RADIAL), path, Conditions(image_mm=50.0)) if "effic" in note
    ]


def test_a_hologram_of_two_like_points_is_noted_as_doubtful(tmp_path):
    path = tmp_path / "lens.zmx"
    flat = {"radius_mm": math.inf}
    notes = write_lens_file(single(phase=HOLOGRAM, **flat), path, Conditions(image_mm=50.0))
    assert any(note.startswith("HOLOGRM1: the sign of its order") for note in notes)
    mixed = single(phase=HOLOGRAM | {"point_2": "virtual"}, **flat)
    assert not any("HOLOGRM1" in note for note in write_lens_file(mixed, path, Conditions(image_mm=50.0)))


def test_a_grating_on_an_asphere_is_written_as_a_polynomial(tmp_path):
    path = tmp_path / "lens.zmx"
    lens = single(phase=GRATING, asphere_mm=[1e-6])
    write_lens_file(lens, path, Conditions(image_mm=50.0))
    again, _ = read_lens_file(path)
    assert again.surfaces[1].phase.kind == "xy"
    np.testing.assert_allclose(
        values_of(again.surfaces[1].phase, POINTS), values_of(lens.surfaces[1].phase, POINTS), rtol=1e-12, atol=1e-12
    )
