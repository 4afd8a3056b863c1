"""Diffractive surfaces of CODE V sequences."""

import math

import numpy as np
import pytest

from lfmesh.imports.report import Verdict
from lfmesh.scene.camera.lens import FileChoices
from lfmesh.scene.camera.phase import HologramPhase
from tests.imports.files import PHASES_SEQ, SINGLET_SEQ
from tests.imports.test_codev import lens_of, refusal_of, report_of
from tests.imports.test_zemax_phases import XY, values_of


def with_lines(*lines, unit="M"):
    text = SINGLET_SEQ.replace("  CIR 6.25\n", "".join(f"  {line}\n" for line in ("CIR 6.25", *lines)))
    return text.replace("DIM M", f"DIM {unit}")


def flat_with_lines(*lines):
    return with_lines(*lines).replace("S -80.0 &", "S 0.0 &").replace("; A 1e-6; B -2e-9", "")


def phase_of(*lines, unit="M"):
    return lens_of(with_lines(*lines, unit=unit)).surfaces[1].phase


DOE = ("DIF DOE", "HOR 1.0", "HWL 600.0")


@pytest.mark.parametrize(("unit", "mm"), [("M", 1.0), ("I", 25.4)])
def test_radial_coefficients_are_path_lengths_over_powers_of_the_unit(unit, mm):
    phase = phase_of(*DOE, "HCT R", "HCO C1 -0.001", "HCO C2 2e-6", unit=unit)
    r2 = (XY**2).sum(axis=1) / mm**2
    np.testing.assert_allclose(values_of(phase), 2.0 * math.pi * mm / 600e-6 * (-0.001 * r2 + 2e-6 * r2**2), rtol=1e-13)


@pytest.mark.parametrize(("unit", "mm"), [("M", 1.0), ("I", 25.4)])
def test_coefficients_of_x_and_y_are_counted_by_degree(unit, mm):
    terms = ("HCO C1 1e-3", "HCO C3 -2e-4", "HCO C4 3e-4", "HCO C9 1e-5")
    phase = phase_of("DIF DOE", "HOR -2", "HWL 600.0; HCT XY", *terms, unit=unit)
    x, y = (XY / mm).T
    lengths = mm * (1e-3 * x - 2e-4 * x**2 + 3e-4 * x * y + 1e-5 * y**3)
    np.testing.assert_allclose(values_of(phase), -4.0 * math.pi / 600e-6 * lengths, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("unit", "mm"), [("M", 1.0), ("I", 25.4)])
@pytest.mark.parametrize(
    ("lines", "direction"),
    [((), (0.0, 1.0)), (("GRX 3.0", "GRY 4.0", "GRZ 0.0"), (0.6, 0.8)), (("GRX -2.0", "GRY 0.0"), (-1.0, 0.0))],
)
def test_grooves_stand_across_their_direction(lines, direction, unit, mm):
    phase = phase_of("DIF GRT", "GRO 2", "GRS 0.5", *lines, unit=unit)
    across = XY @ np.array(direction)
    np.testing.assert_allclose(values_of(phase), 2.0 * 2.0 * math.pi * across / (0.5 * mm), rtol=1e-12, atol=1e-12)
    reverse = phase_of("DIF GRT", "GRO 2", "GRS -0.5", *lines, unit=unit)
    np.testing.assert_allclose(values_of(reverse), -values_of(phase), rtol=1e-14)


POINTS = ("HX1 1", "HY1 -2", "HZ1 -200", "HX2 3", "HY2 0.5", "HZ2 100")


@pytest.mark.parametrize("kinds", [("REA", "REA"), ("REA", "VIR"), ("VIR", "REA"), ("VIR", "VIR")])
def test_a_hologram_turns_light_of_its_first_point_into_that_of_its_second(kinds):
    text = flat_with_lines("DIF HOE", "HOR 1", "HWL 600", f"HV1 {kinds[0]}; HV2 {kinds[1]}", *POINTS)
    phase = lens_of(text).surfaces[1].phase
    assert isinstance(phase, HologramPhase)
    assert (phase.point_1_mm, phase.point_2_mm) == ((1.0, -2.0, -200.0), (3.0, 0.5, 100.0))
    assert (phase.point_1, phase.point_2) == tuple("real" if kind == "REA" else "virtual" for kind in kinds)
    assert (phase.construction_nm, phase.main_order) == (600.0, 1)
    said = [line.how for line in report_of(text).of(Verdict.APPROXIMATED) if line.text == "DIF HOE"]
    assert len(said) == 1


def test_equal_points_leave_the_polynomial():
    far = ("HX1 0", "HZ1 0.1e19", "HX2 0", "HZ2 0.1e19", "HV1 REA", "HV2 REA")
    polynomial = ("HCT R", "HCO C1 -0.001")
    assert phase_of("DIF HOE", *DOE[1:], *far, *polynomial) == phase_of(*DOE, *polynomial)
    assert phase_of("DIF HOE", *DOE[1:], *far) is None
    assert phase_of("HOE", *DOE[1:], "HTO SPH", *polynomial) == phase_of(*DOE, *polynomial)


def test_a_command_may_name_its_surface():
    lines = [f"{line[:3]} S2{line[3:]}" for line in (*DOE, "HCT R", "HCO C1 -0.001")]
    text = SINGLET_SEQ.replace("GO\n", "\n".join([*lines, "GO\n"]))
    assert lens_of(text) == lens_of(with_lines(*DOE, "HCT R", "HCO C1 -0.001"))


def test_commands_of_zero_without_a_kind_are_nothing():
    report = report_of(with_lines("HOR 0"))
    assert "HOR 0" in [line.text for line in report.of(Verdict.WITHOUT_EFFECT)]


def test_a_zoom_position_may_have_an_order_of_its_own():
    text = with_lines(*DOE, "HCT R", "HCO C1 -0.001").replace("GO\n", "ZOO 2\nZOO HOR S2 1 2\nGO\n")
    orders = []
    for k in (1, 2):
        phase = lens_of(text, choices=FileChoices(configuration=k)).surfaces[1].phase
        orders.append(phase.main_order)
    assert orders == [1, 2]


@pytest.mark.parametrize(
    ("lines", "where", "reason"),
    [
        (["DIF DOE"], "DIF DOE", "DOE needs HOR"),
        (["DIF DOE", "HOR 1"], "DIF DOE", "DOE needs HWL"),
        ([*DOE], "DIF DOE", "it needs HCT; R and XY are supported"),
        ([*DOE, "HCT AXY"], "DIF DOE", "HCT AXY is not supported"),
        ([*DOE, "HCT R", "HCO C11 1e-30"], "DIF DOE", "HCT R has at most 10 terms, not C11"),
        ([*DOE, "HCT XY", "HCO C66 1e-30"], "HCO C66 1e-30", "from C1 to C65"),
        ([*DOE, "HCT XY", "HCO 1"], "HCO 1", "from C1 to C65"),
        ([*DOE, "HCT XY", "HCO C1 nan"], "HCO C1 nan", "'nan' is not finite"),
        ([*DOE, "HCT XY", "HCO C1 1e300"], "DIF DOE", "HCO must be 1e+15 or less"),
        (["DIF DOE", "HOR inf", "HWL 500"], "DIF DOE", "HOR: 'inf' is not finite"),
        (["DIF DOE", "HOR 0.5", "HWL 500", "HCT R"], "DIF DOE", "order must be a whole number"),
        (["DIF DOE", "HOR 1", "HWL 0", "HCT R"], "DIF DOE", "HWL must be above 0"),
        ([*DOE, "HCT R", "HCO C1 -0.001", "HZ1 100"], "DIF DOE", "construction points beside a polynomial"),
        ([*DOE, "HCT R", "HTO ASP"], "DIF DOE", "HTO ASP is not supported"),
        ([*DOE, "HCT R", "GRO 1"], "DIF DOE", "GRO does not belong to DIF DOE"),
        (["DIF HOE", "HOR 1", "HWL 500", "HV1 X", "HZ2 100"], "DIF HOE", "X is unknown; REA and VIR are known"),
        (["DIF HOE", "HOR 1", "HWL 500", "HZ2 100"], "DIF HOE", "a hologram on a curved surface"),
        (["DIF GRT", "GRO 1"], "DIF GRT", "GRT needs GRS"),
        (["DIF GRT", "GRS 1"], "DIF GRT", "GRT needs GRO"),
        (["DIF GRT", "GRO 1", "GRS 0"], "DIF GRT", "GRS must not be 0"),
        (["DIF GRT", "GRO 1", "GRS 1", "GRZ 1"], "DIF GRT", "lean against the axis, GRZ"),
        (["DIF GRT", "GRO 1", "GRS 1", "GRY 0"], "DIF GRT", "GRX and GRY must not both be 0"),
        (["DIF GRT", "GRO 1", "GRS 1", "HCO C1 1"], "DIF GRT", "HCO does not belong to DIF GRT"),
        (["DIF KIN", "HOR 1"], "DIF KIN", "of kind KIN are not supported; DOE, HOE, GRT are"),
        (["DIF"], "DIF", "it is cut short"),
        (["HOR 1"], "HOR 1", "a command of diffractive surfaces without DIF"),
        ([*DOE, "HCT R", "RMD REFL"], "RMD REFL", "mirrors are not supported"),
    ],
)
def test_a_phase_that_cannot_be_read_is_one_line(lines, where, reason):
    message = refusal_of(with_lines(*lines))
    assert message.startswith("lens.seq: line ")
    assert where in message or ": S -80.0" in message
    assert reason in message
    assert "\n" not in message


def test_a_construction_point_in_the_surface_is_one_line():
    message = refusal_of(flat_with_lines("DIF HOE", "HOR 1", "HWL 500", "HZ2 100"))
    assert "must not lie in the vertex plane" in message
    assert "\n" not in message


def test_a_report_counts_the_phases():
    report = report_of(PHASES_SEQ)
    assert "phases: 4, of surfaces 0 (radial), 1 (xy), 2 (grating), 3 (hologram)" in report.notes
    assert not report.of(Verdict.UNKNOWN)


EDMUND_65988 = """\
RDM
EPD 12.0
DIM M
WL 656.2725 587.5618 486.1327
REF 2
YAN 0.0
PRV
PWL 656.2725 587.5618 486.1327
'E48' 1.52836 1.53116 1.5378
END
SO 0.0 0.1e14
S 9.93 3.7 'E48'
  STO
  CIR 6.0
  ASP
  K -0.71
  A -0.1581980090969e-4; B -0.2770951746068999e-6; C -0.1216086045095e-8
  DIF DOE
  HOR 1.0
  HWL 587.5618; HCT R
  HCO C1 -0.001807322521767816; HCC C1 100
S -48.3 12.94603127272
  CIR 6.0
SI 0.0 0.0
GO
"""
"""Edmund Optics' plastic hybrid asphere 65988, f = 15 mm, as the tests of ray-optics hold it."""


def test_a_catalogue_lens_has_its_makers_focal_length():
    """Without its phase, or with the opposite sign, it would be 15.9 or 16.8 mm."""
    report = report_of(EDMUND_65988)
    assert report.focal_length_mm == pytest.approx(15.0, abs=0.03)
    back = next(note for note in report.notes if note.startswith("focal length"))
    assert float(back.split()[-2]) == pytest.approx(12.946, abs=1e-3)
    for order, length in ((0, 15.85), (-1, 16.8)):
        other = report_of(EDMUND_65988.replace("HOR 1.0", f"HOR {order}"))
        assert other.focal_length_mm == pytest.approx(length, abs=0.1)
