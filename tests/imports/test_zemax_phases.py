"""Phase surfaces of Zemax files against the formulas of OpticStudio's help; stored rays are in tests/validation."""

import functools
import math

import numpy as np
import pytest

from lfmesh.imports.report import Verdict
from lfmesh.optics.phase_profiles import phase_table, phases_at
from tests.imports.files import PHASES_ZMX
from tests.imports.test_zemax import lens_of, refusal_of, report_of

SURFACE = """\
MODE SEQ
UNIT {unit}
ENPD 8
GCAT SCHOTT
FTYP 0 0 1 1 0 0 0
YFLN 0
WAVM 1 0.55 1
PWAV 1
SURF 0
  TYPE STANDARD
  DISZ INFINITY
SURF 1
  STOP
  TYPE {kind}
  CURV {curvature}
{lines}  DISZ 4
  GLAS N-BK7 0 0 1.5 40
  DIAM 5
SURF 2
  TYPE STANDARD
  CURV -0.01
  DISZ 60
  DIAM 6
SURF 3
  TYPE STANDARD
  DISZ 0
"""
XY = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, -2.0), (1.3, 2.9), (-3.1, 0.7)])
PIECES = {
    "BINARY_1": ("PARM 0 1", "XDAT 1 2", "XDAT 2 5", "XDAT 3 4.5", "XDAT 4 -2"),
    "BINARY_2": ("PARM 0 1", "XDAT 1 2", "XDAT 2 5", "XDAT 3 -90", "XDAT 4 7"),
    "FZERNPHA": ("PARM 0 1", "XDAT 1 5", "XDAT 2 5", "XDAT 6 0.5", "XDAT 7 2"),
    "DGRATING": ("PARM 1 0.05", "PARM 2 1"),
    "HOLOGRM2": ("PARM 3 -200", "PARM 6 100", "PARM 7 0.55", "PARM 8 1"),
}


def text_of(kind, *lines, unit="MM", curvature=None):
    held = "".join(f"  {line}\n" for line in lines)
    curvature = curvature or ("0" if kind.startswith("HOLOGRM") else "0.02")
    return SURFACE.format(kind=kind, lines=held, unit=unit, curvature=curvature)


def phase_of(kind, *lines, unit="MM"):
    return lens_of(text_of(kind, *lines, unit=unit)).surfaces[0].phase


def values_of(phase, points=XY):
    """Return m Φ, relative to the vertex, rad."""
    x, y = points.T
    values = phases_at(phase_table([phase.profile()]), 0, x, y)[:, 0]
    return phase.main_order * (values - phases_at(phase_table([phase.profile()]), 0, np.zeros(1), np.zeros(1))[0, 0])


@pytest.mark.parametrize(("unit", "mm"), [("MM", 1.0), ("IN", 25.4)])
def test_binary_2_has_even_powers_of_the_height_over_its_radius(unit, mm):
    phase = phase_of("BINARY_2", "PARM 0 2", "XDAT 1 2", "XDAT 2 4", "XDAT 3 -90.5", "XDAT 4 7.25", unit=unit)
    assert (phase.kind, phase.main_order, phase.coefficients_rad) == ("radial", 2, (-90.5, 7.25))
    assert phase.radius_mm == pytest.approx(4.0 * mm, rel=1e-15)
    r2 = (XY**2).sum(axis=1) / (4.0 * mm) ** 2
    np.testing.assert_allclose(values_of(phase), 2.0 * (-90.5 * r2 + 7.25 * r2**2), rtol=1e-13)


def test_binary_2_is_an_even_asphere_as_well():
    surface = lens_of(text_of("BINARY_2", *PIECES["BINARY_2"], "PARM 1 0", "PARM 2 1e-5", "PARM 3 -2e-7")).surfaces[0]
    even = lens_of(text_of("EVENASPH", "PARM 2 1e-5", "PARM 3 -2e-7")).surfaces[0]
    assert surface.asphere_mm == even.asphere_mm == (1e-5, -2e-7)
    assert surface.model_copy(update={"phase": None}) == even
    bent = lens_of(text_of("BINARY_2", *PIECES["BINARY_2"], "PARM 1 1e-3", curvature="0")).surfaces[0]
    assert bent.radius_mm == pytest.approx(500.0, rel=1e-14)


def test_a_negative_coefficient_of_a_binary_lens_converges():
    """Its power is −2 A₁ λ / (2π R²)."""
    texts = [text_of("BINARY_2", f"PARM 0 {m}", *PIECES["BINARY_2"][1:]) for m in (0, 1)]
    powers = [1.0 / report_of(text).focal_length_mm for text in texts]
    index = 1.518522
    thin = 2.0 * 90.0 * 550e-6 / (2.0 * math.pi * 25.0)
    # The second surface stands 4 mm behind the first.
    assert powers[1] - powers[0] == pytest.approx(thin * (1.0 - 4.0 / index * (1.0 - index) * -0.01), rel=1e-5)


@pytest.mark.parametrize(("unit", "mm"), [("MM", 1.0), ("IN", 25.4)])
def test_binary_1_has_powers_of_x_and_y_over_its_radius(unit, mm):
    lines = ("PARM 0 -1", "XDAT 1 9", "XDAT 2 5", "XDAT 3 2", "XDAT 5 -3", "XDAT 6 0.5", "XDAT 11 4")
    phase = phase_of("BINARY_1", *lines, unit=unit)
    x, y = (XY / (5.0 * mm)).T
    np.testing.assert_allclose(values_of(phase), -(2.0 * x - 3.0 * x**2 + 0.5 * x * y + 4.0 * y**3), rtol=1e-13)


def test_zernike_coefficients_are_waves():
    phase = phase_of("FZERNPHA", "PARM 0 1", "XDAT 1 8", "XDAT 2 5", "XDAT 3 9", "XDAT 5 0.5", "XDAT 6 1", "XDAT 10 2")
    x, y = (XY / 5.0).T
    r2 = x**2 + y**2
    waves = 0.5 * y + (2.0 * r2 - 1.0) + 2.0 * (3.0 * r2 - 2.0) * y
    np.testing.assert_allclose(values_of(phase), 2.0 * math.pi * (waves + 1.0), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize(("per_um", "order"), [("0.2", 1), ("-0.2", -1)])
def test_a_grating_has_lines_per_micrometre_parallel_to_x(per_um, order):
    phase = phase_of("DGRATING", f"PARM 1 {per_um}", "PARM 2 1", unit="IN")
    assert (phase.lines_per_mm, phase.direction_deg, phase.main_order) == (200.0, 90.0, order)
    np.testing.assert_allclose(values_of(phase), order * 2.0 * math.pi * 200.0 * XY[:, 1], rtol=1e-13, atol=1e-10)


@pytest.mark.parametrize(("unit", "mm"), [("MM", 1.0), ("IN", 25.4)])
@pytest.mark.parametrize(("kind", "sign"), [("HOLOGRM1", 1.0), ("HOLOGRM2", -1.0)])
def test_a_hologram_turns_light_of_its_first_point_into_that_of_its_second(kind, sign, unit, mm):
    lines = ("PARM 1 1", "PARM 2 -2", "PARM 3 -200", "PARM 4 3", "PARM 5 0.5", "PARM 6 100", "PARM 7 0.6", "PARM 8 1")
    text = text_of(kind, *lines, unit=unit)
    first, second = (
        np.hypot(np.hypot(*(XY - mm * np.array(p[:2])).T), mm * p[2]) for p in ((1, -2, -200), (3, 0.5, 100))
    )
    path = sign * second - first
    truth = 2.0 * math.pi / 600e-6 * (path - path[0])
    np.testing.assert_allclose(values_of(lens_of(text).surfaces[0].phase), truth, rtol=1e-9, atol=1e-6)
    said = [line.how for line in report_of(text).of(Verdict.APPROXIMATED) if "HOLOGRM" in line.text]
    assert [how.startswith("the sign of its order") for how in said] == [True] * (kind == "HOLOGRM1")


def test_plane_waves_come_from_points_far_away():
    near, far = (
        phase_of("HOLOGRM1", f"PARM 3 -1{zeros}", f"PARM 5 1{zeros}", f"PARM 6 -1{zeros}", *PIECES["HOLOGRM2"][2:])
        for zeros in ("0" * 11, "0" * 40)
    )
    np.testing.assert_allclose(values_of(far), values_of(near), rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(
        values_of(far), -2.0 * math.pi / 550e-6 * XY[:, 1] / math.sqrt(2.0), rtol=1e-9, atol=1e-6
    )


@pytest.mark.parametrize("kind", ["BINARY_1", "BINARY_2", "FZERNPHA"])
def test_extra_data_among_the_parameters_are_the_same_phase(kind):
    by_extra = text_of(kind, *PIECES[kind])
    by_parameters = functools.reduce(
        lambda text, k: text.replace(f"XDAT {k} ", f"PARM {12 + k} "), range(1, 8), by_extra
    )
    assert "XDAT" not in by_parameters
    assert lens_of(by_extra) == lens_of(by_parameters)


BINARY_3 = (
    "PARM 1 50", "PARM 2 -0.5", "PARM 3 2", "PARM 4 3", "PARM 5 1", "PARM 6 1", "XDAT 1 2", "XDAT 2 0", "XDAT 3 -40",
    "XDAT 4 0", "XDAT 5 -90", "XDAT 6 1e-5", "XDAT 7 16", "XDAT 8 1e-5", "XDAT 9 81", "CONI -0.5",
)  # fmt: skip


def test_equal_zones_are_one():
    surface = lens_of(text_of("BINARY_3", *BINARY_3)).surfaces[0]
    assert surface.asphere_mm == (1e-5,)
    r2 = (XY**2).sum(axis=1)
    np.testing.assert_allclose(values_of(surface.phase), -10.0 * r2 + r2**2, rtol=1e-12)


def with_zones(**new):
    """Return a lens with equal zones but for some lines, by their beginning with "_" for the space."""
    new = {key.replace("_", " "): value for key, value in new.items()}
    lines = [f"{key} {new.pop(key)}" if (key := line.rsplit(" ", 1)[0]) in new else line for line in BINARY_3]
    return text_of("BINARY_3", *lines, *(f"{key} {value}" for key, value in new.items()))


@pytest.mark.parametrize(("unit", "mm"), [("MM", 1.0), ("IN", 25.4)])
def test_zones_of_two_shapes_join_at_the_border(unit, mm):
    """The outer zone is shifted by z₁(A₁) − z₂(A₁)."""
    text = with_zones(PARM_1=30, PARM_2=0.2, XDAT_8="-4e-5").replace("UNIT MM", f"UNIT {unit}")
    surface = lens_of(text).surfaces[0]
    assert surface.phase.kind == "radial"

    def sag(r, c, k, a):
        return c * r**2 / (1.0 + math.sqrt(1.0 - (1.0 + k) * (c * r) ** 2)) + a * r**4

    inner, outer = (0.02, -0.5, 1e-5), (1.0 / 30.0, 0.2, -4e-5)
    for r in (0.0, 1.0, 2.0):
        assert surface.sag_mm(r * mm) == pytest.approx(sag(r, *inner) * mm, rel=1e-12)
    for r in (2.001, 3.0, 4.5):
        wanted = sag(r, *outer) + sag(2.0, *inner) - sag(2.0, *outer)
        assert surface.sag_mm(r * mm) == pytest.approx(wanted * mm, rel=1e-12)


@pytest.mark.parametrize(
    ("changes", "order", "inner", "outer"),
    [
        ({"XDAT_9": 80}, 1, (-40.0, 16.0), (-90.0, 80.0)), ({"PARM_4": 3.01}, 1, (-40.0, 16.0), (-90.0, 81.0)),
        ({"PARM_6": 0}, 1, (-40.0, 16.0), (0.0,)), ({"PARM_5": -1, "PARM_6": 2}, 1, (40.0, -16.0), (-180.0, 162.0)),
        ({"PARM_5": 2, "PARM_6": 2, "XDAT_7": 17}, 2, (-40.0, 17.0), (-90.0, 81.0)),
    ],
)  # fmt: skip
def test_zones_of_two_phases_have_their_own_coefficients_and_orders(changes, order, inner, outer):
    surface = lens_of(with_zones(**changes)).surfaces[0]
    phase = surface.phase
    assert (phase.kind, phase.main_order, surface.outer_zone) == ("zones", order, None)
    assert [zone.coefficients_rad for zone in phase.zones] == [inner, outer]
    assert [(zone.border_mm, zone.radius_mm) for zone in phase.zones] == [
        (2.0, 2.0), (None, float(changes.get("PARM_4", 3))),
    ]  # fmt: skip


def test_a_phase_offset_is_a_constant_of_the_outer_zone():
    text = with_zones(PARM_5=2, PARM_6=2, PARM_7=0.5)
    assert [zone.offset_rad for zone in lens_of(text).surfaces[0].phase.zones] == [0.0, 0.25]
    assert any("constant phase of the outer zone" in line.how for line in report_of(text).lines)
    assert lens_of(with_zones(XDAT_3=0, XDAT_5=0, XDAT_7=0, XDAT_9=0, PARM_7=0.5)).surfaces[0].phase is None


def test_a_term_in_r2_of_a_flat_outer_zone_is_a_parabola():
    zone = lens_of(with_zones(PARM_1=0, PARM_2=0, XDAT_4=0.01)).surfaces[0].outer_zone
    assert (zone.radius_mm, zone.conic, zone.asphere_mm) == (50.0, -1.0, (1e-5,))


@pytest.mark.parametrize(
    ("changes", "where", "reason"),
    [
        ({"PARM_1": 51, "PARM_8": 1}, "PARM 8 1", "the break leaves a step between the zones"),
        ({"XDAT_4": 0.01}, "XDAT 4 0.01", "a term in r² of the outer zone needs a flat or parabolic conic"),
        ({"PARM_3": 0}, "PARM 3 0", "the radius of a zone must be above 0"),
        ({"PARM_5": 0.5}, "PARM 5 0.5", "order must be a whole number"),
        ({"PARM_9": 1}, "PARM 9 1", "parameter 9 of BINARY_3 is unknown"),
        ({"PARM_1": 1.5, "PARM_2": 0}, "surface 0 of the lens: outer_zone", "the zone ends 1.5 mm from the axis"),
    ],
)
def test_zones_that_cannot_be_read_are_one_line(changes, where, reason):
    message = refusal_of(with_zones(**changes))
    assert where in message
    assert reason in message
    assert "\n" not in message


def test_a_break_between_equal_shapes_leaves_no_step():
    assert lens_of(with_zones(PARM_8=1)).surfaces[0].outer_zone is None


def test_phases_without_effect_are_none():
    for kind, lines in PIECES.items():
        order = {"DGRATING": "PARM 2", "HOLOGRM2": "PARM 8"}.get(kind, "PARM 0")
        held = [f"{order} 0" if line.startswith(order) else line for line in lines]
        assert phase_of(kind, *held) is None
    assert phase_of("BINARY_2", "PARM 0 1", "XDAT 1 0") is None
    assert phase_of("BINARY_2", "PARM 0 1", "XDAT 1 1", "XDAT 2 4", "XDAT 3 0") is None
    assert phase_of("DGRATING", "PARM 1 0", "PARM 2 1") is None


@pytest.mark.parametrize(
    ("kind", "lines", "where", "reason"),
    [
        ("BINARY_2", ["PARM 0 1"], "TYPE BINARY_2", "its extra data are missing"),
        ("BINARY_2", ["PARM 0 1", "XDAT 1 2", "XDAT 3 -9"], "TYPE BINARY_2", "XDAT 2, the normalisation radius, is"),
        ("BINARY_2", ["PARM 0 1", "XDAT 1 2", "XDAT 2 4"], "TYPE BINARY_2", "the file has none of their coefficients"),
        ("BINARY_2", ["PARM 0 1", "XDAT 1 1", "XDAT 2 0", "XDAT 3 -9"], "XDAT 2 0", "radius must be above 0"),
        ("FZERNPHA", ["PARM 0 1", "XDAT 1 4", "XDAT 2 -4", "XDAT 6 1"], "XDAT 2 -4", "radius must be above 0"),
        ("BINARY_2", ["PARM 0 1", "XDAT 1 1", "XDAT 2 4", "XDAT 3 nan"], "XDAT 3 nan", "'nan' is not finite"),
        ("BINARY_1", ["PARM 0 1", "XDAT 1 1", "XDAT 2 inf", "XDAT 3 1"], "XDAT 2 inf", "'inf' is not finite"),
        ("BINARY_1", ["PARM 0 1", "XDAT 1 1", "XDAT 2 4", "XDAT 3 1e300"], "XDAT 3 1e300", "must be 1e+15 or less"),
        ("BINARY_1", ["PARM 0 1", "XDAT 1 2.5", "XDAT 2 4"], "XDAT 1 2.5", "must be a whole number up to 230"),
        ("BINARY_2", ["PARM 0 1", "XDAT 1 -1", "XDAT 2 4"], "XDAT 1 -1", "must be a whole number up to 240"),
        ("FZERNPHA", ["PARM 0 1", "XDAT 1 38", "XDAT 2 4"], "XDAT 1 38", "must be a whole number up to 37"),
        ("BINARY_2", PIECES["BINARY_2"][1:], "TYPE BINARY_2", "parameter 0, the diffraction order, is missing"),
        ("BINARY_2", ["PARM 0 0.5", *PIECES["BINARY_2"][1:]], "PARM 0 0.5", "order must be a whole number"),
        ("BINARY_1", [*PIECES["BINARY_1"], "PARM 9 1"], "PARM 9 1", "parameter 9 of BINARY_1 is unknown"),
        ("DGRATING", ["PARM 1 0.2"], "TYPE DGRATING", "parameter 2, the diffraction order, is missing"),
        ("DGRATING", ["PARM 2 1"], "TYPE DGRATING", "parameter 1, the lines per µm, is missing"),
        ("DGRATING", [*PIECES["DGRATING"], "PARM 3 1"], "PARM 3 1", "parameter 3 of DGRATING is unknown"),
        ("DGRATING", [*PIECES["DGRATING"], "XDAT 1 1"], "XDAT 1 1", "DGRATING has no extra data"),
        ("HOLOGRM1", ["PARM 3 -9", "PARM 7 -0.5", "PARM 8 1"], "PARM 7 -0.5", "made into a mirror"),
        ("HOLOGRM2", ["PARM 3 -9", "PARM 7 0.5", "PARM 8 1"], "TYPE HOLOGRM2", "must not lie in the vertex plane"),
        ("HOLOGRM2", [*PIECES["HOLOGRM2"], "CURV 1e-3"], "TYPE HOLOGRM2", "a hologram on a curved surface"),
        ("HOLOGRM2", [*PIECES["HOLOGRM2"], "PARM 9 1"], "PARM 9 1", "parameter 9 of HOLOGRM2 is unknown"),
        ("BINARY_2", [*PIECES["BINARY_2"], "GLAS MIRROR"], "GLAS MIRROR", "mirrors are not supported"),
        ("BINARY_4", ["PARM 0 1"], "TYPE BINARY_4", "a variable number of zones"),
    ],
)  # fmt: skip
def test_a_phase_that_cannot_be_read_is_one_line(kind, lines, where, reason):
    message = refusal_of(text_of(kind, *lines))
    assert message.startswith("lens.zmx: line ")
    assert where in message or "SURF 1" in message
    assert reason in message
    assert "\n" not in message


@pytest.mark.parametrize("kind", ["BINARY_1", "BINARY_2", "FZERNPHA"])
def test_thousands_of_terms_are_one_line(kind):
    lines = [f"XDAT {k} 1.0" for k in range(3, 5003)]
    message = refusal_of(text_of(kind, "PARM 0 1", "XDAT 1 5000", "XDAT 2 4", *lines))
    assert "XDAT 1 5000: the number of terms of" in message
    assert "\n" not in message


def test_terms_beyond_their_count_are_none():
    text = text_of("BINARY_2", "PARM 0 1", "XDAT 1 1", "XDAT 2 4", "XDAT 3 -9", "XDAT 4 5")
    assert lens_of(text).surfaces[0].phase.coefficients_rad == (-9.0,)
    (line,) = (line for line in report_of(text).of(Verdict.WITHOUT_EFFECT) if "XDAT" in line.text)
    assert str(line) == "line 20: XDAT 4 5: without effect: XDAT 1 counts 1 terms"


def test_zernike_terms_that_end_within_the_surface_are_said():
    inside, outside = (
        text_of("FZERNPHA", *PIECES["FZERNPHA"], "PARM 1 0").replace("DIAM 5", f"DIAM {d}") for d in (5, 6)
    )
    beyond = text_of("FZERNPHA", *PIECES["FZERNPHA"], "PARM 1 1").replace("DIAM 5", "DIAM 6")
    said = [
        [line.how for line in report_of(text).of(Verdict.APPROXIMATED) if "FZERNPHA" in line.text]
        for text in (inside, outside, beyond)
    ]
    assert said == [[], ["Zemax's phase ends at its radius 5; here it goes on to the rim of the surface"], []]


def test_a_report_counts_the_phases():
    report = report_of(PHASES_ZMX)
    assert "phases: 5, of surfaces 0 (radial), 1 (xy), 2 (grating), 3 (xy), 4 (hologram)" in report.notes
    assert not report.of(Verdict.UNKNOWN)
    assert "phases: 1, of surface 0 (radial)" in report_of(text_of("BINARY_2", *PIECES["BINARY_2"])).notes


def test_a_phase_of_the_image_is_said_to_be_left_out():
    head, tail = text_of("STANDARD").split("SURF 3\n  TYPE STANDARD\n")
    report = report_of(f"{head}SURF 3\n  TYPE DGRATING\n  PARM 1 0.1\n  PARM 2 1\n{tail}")
    assert [line.how for line in report.of(Verdict.APPROXIMATED)] == ["the image has a phase; it is left out"]


def test_a_sheet_in_air_may_be_a_lens():
    text = text_of("BINARY_2", *PIECES["BINARY_2"], curvature="0").replace("  GLAS N-BK7 0 0 1.5 40\n", "")
    assert lens_of(text).surfaces[0].phase is not None
    assert report_of(text).focal_length_mm == pytest.approx(2.0 * math.pi * 25.0 / (2.0 * 90.0 * 550e-6), rel=1e-12)
