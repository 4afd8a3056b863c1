"""Surfaces of Zemax files against their defining formulas, at 40 digits where a term is rewritten."""

import functools
import math
import random
from decimal import Decimal, localcontext

import pytest

from lfmesh.imports.report import Verdict
from lfmesh.imports.zemax import read
from lfmesh.optics.glass import refractive_index
from lfmesh.scene.camera.lens import FileChoices
from tests.imports.files import SINGLET_ZMX
from tests.imports.test_zemax import FILE, lens_of, refusal_of, report_of


def aspheric(kind: str, *lines: str) -> str:
    """Return the singlet with other terms on its second surface."""
    text = SINGLET_ZMX.replace("TYPE EVENASPH", f"TYPE {kind}").replace("  PARM 1 0\n  PARM 2 1e-6\n", "")
    return text.replace("  PARM 3 -2e-9\n", "".join(f"  {line}\n" for line in lines))


def test_an_odd_asphere_of_even_terms_is_an_even_one() -> None:
    """OpticStudio's parameter n of an odd asphere goes with r^n, of an even one with r^2n."""
    odd = aspheric("ODDASPHE", "PARM 1 0", "PARM 4 1e-6", "PARM 6 -2e-9")
    assert lens_of(odd).surfaces == lens_of(SINGLET_ZMX).surfaces


def test_odd_powers_are_those_of_their_parameters() -> None:
    """1e-4 r³ − 2e-7 r⁵ in inches: the coefficient of r^n goes with 25.4^(1 − n)."""
    text = aspheric("ODDASPHE", "PARM 3 1e-4", "PARM 4 1e-6", "PARM 5 -2e-7").replace("UNIT MM", "UNIT IN")
    surface = lens_of(text).surfaces[1]
    assert surface.odd_asphere_mm == pytest.approx((1e-4 * 25.4**-2, -2e-7 * 25.4**-4), rel=1e-12)
    assert surface.asphere_mm == pytest.approx((1e-6 * 25.4**-3,), rel=1e-12)


@pytest.mark.parametrize(("unit", "mm"), [("MM", 1.0), ("IN", 25.4)])
def test_another_section_in_x_is_a_biconic_or_toroid(unit: str, mm: float) -> None:
    """Parameter 1 is the radius in x, where 0 is flat; a toroid's y⁴ has the coefficient of parameter 3."""
    terms = ("PARM 1 50", "PARM 2 -0.7")
    surface = lens_of(aspheric("BICONICX", *terms).replace("UNIT MM", f"UNIT {unit}")).surfaces[1]
    assert surface.biconic is not None
    assert (surface.biconic.radius_x_mm, surface.biconic.conic_x) == (pytest.approx(50.0 * mm, rel=1e-14), -0.7)
    terms = (
        "PARM 0 1",
        "PARM 1 -40",
        "PARM 2 0",
        "PARM 3 1e-6",
        "PARM 13 0",
        "PARM 14 5",
        "XDAT 1 0 0 0",
        "XDAT 2 1 0 0",
    )
    surface = lens_of(aspheric("TOROIDAL", *terms).replace("UNIT MM", f"UNIT {unit}")).surfaces[1]
    assert surface.toroid is not None
    assert surface.toroid.radius_x_mm == pytest.approx(-40.0 * mm, rel=1e-14)
    assert surface.asphere_mm == pytest.approx((1e-6 * mm**-3,), rel=1e-12)
    for kind in ("TOROIDAL", "BICONICX"):
        surface = lens_of(aspheric(kind, "PARM 1 0")).surfaces[1]
        section = surface.toroid or surface.biconic
        assert section is not None
        assert math.isinf(section.radius_x_mm)


@pytest.mark.parametrize(("unit", "mm"), [("MM", 1.0), ("IN", 25.4)])
def test_an_extended_asphere_counts_its_height_in_its_own_radius(unit: str, mm: float) -> None:
    """Terms a₂ ρ⁴ + a₃ ρ⁶, ρ = r / 6, are 1e-6 r⁴ − 2e-9 r⁶ in the file's unit."""
    terms = ("XDAT 1 3 0 0", "XDAT 2 6 0 0", "XDAT 3 0 0 0", f"XDAT 4 {1e-6 * 6**4} 0 0", f"XDAT 5 {-2e-9 * 6**6} 0 0")
    surface = lens_of(aspheric("XASPHERE", *terms).replace("UNIT MM", f"UNIT {unit}")).surfaces[1]
    assert surface.asphere_mm == pytest.approx((1e-6 * mm**-3, -2e-9 * mm**-5), rel=1e-12)


@pytest.mark.parametrize(
    ("kind", "line", "reason"),
    [
        ("ODDASPHE", "PARM 1 1e-4", "a term in r makes a cone"),
        ("TOROIDAL", "PARM 2 1e-4", "a term in y²"),
        ("TOROIDAL", "PARM 9 1e-4", "parameter 9 of TOROIDAL is unknown"),
        ("TOROIDAL", "PARM 13 3", "Zernike terms of a toroid are not supported"),
        ("TOROIDAL", "XDAT 3 1e-4 0 0", "Zernike terms of a toroid are not supported"),
        ("BICONICX", "PARM 3 1e-4", "parameter 3 of BICONICX is unknown"),
        ("XASPHERE", "XDAT 18 1e-4 0 0", "a term in r^32: aspheres reach up to r^30"),
        ("XASPHERE", "XDAT 2 -6 0 0", "above 0"),
        ("XASPHERE", "PARM 2 1e-4", "parameter 2 of XASPHERE is unknown"),
    ],
)
def test_terms_that_no_even_asphere_has_are_refused(kind: str, line: str, reason: str) -> None:
    message = refusal_of(aspheric(kind, line))
    assert line in message
    assert reason in message


def in_digits(curvature, conic, terms, radius):
    """Return the sag of a conic with terms (power, coefficient), at 50 digits."""
    with localcontext() as context:
        context.prec = 50
        c, k, r = Decimal(curvature), Decimal(conic), Decimal(radius)
        conic_sag = c * r * r / (1 + (1 - (1 + k) * c * c * r * r).sqrt())
        return float(conic_sag + sum(Decimal(a) * r**power for power, a in terms))


ASPHERE_ZMX = """\
MODE SEQ
UNIT {unit}
ENPD {epd!r}
SURF 0
  TYPE STANDARD
  DISZ INFINITY
SURF 1
  STOP
  TYPE {kind}
  CURV {curvature!r}
  CONI {conic!r}
{terms}  DISZ 5
  GLAS ___BLANK 1 0 1.5 0 0
  DIAM {radius!r}
  FLAP 0 {radius!r}
SURF 2
  TYPE STANDARD
  CURV 0
  DISZ 60
  DIAM {radius!r}
SURF 3
  TYPE STANDARD
  DISZ 0
"""


@pytest.mark.parametrize("seed", range(30))
def test_a_term_in_r2_is_put_into_the_others_without_a_change_of_shape(seed):
    rng = random.Random(seed)
    radius = rng.uniform(2.0, 12.0)
    curvature = rng.choice([0.0, rng.uniform(-0.3, 0.3) / radius])
    conic = rng.choice([0.0, -1.0, rng.uniform(-3.0, 1.0)])
    square = rng.choice([-0.5 * curvature, rng.uniform(-0.05, 0.05) / radius])
    quartic = rng.uniform(-1e-6, 1e-6)
    terms = f"  PARM 1 {square!r}\n  PARM 2 {quartic!r}\n"
    text = ASPHERE_ZMX.format(
        kind="EVENASPH", unit="MM", curvature=curvature, conic=conic, terms=terms, radius=radius, epd=2 * radius
    )
    surface = lens_of(text).surfaces[0]
    for share in (0.1, 0.5, 0.8, 1.0):
        truth = in_digits(curvature, conic, [(2, square), (4, quartic)], share * radius)
        assert surface.sag_mm(share * radius) == pytest.approx(truth, abs=2e-9)


def test_a_term_in_r2_holds_as_far_as_the_file_draws_the_surface():
    text = ASPHERE_ZMX.format(
        kind="EVENASPH", unit="MM", curvature=0.2, conic=0.0, terms="  PARM 1 0.1\n", radius=4.0, epd=0.2
    )
    assert "rewriting its term in r² leaves an error of" in refusal_of(text.replace("  FLAP 0 4.0\n", ""))


def test_a_term_in_r2_that_a_steep_surface_cannot_be_rid_of_is_refused():
    text = ASPHERE_ZMX.format(
        kind="EVENASPH", unit="MM", curvature=0.09, conic=0.0, terms="  PARM 1 1e-3\n", radius=10.0, epd=20.0
    )
    assert "rewriting its term in r² leaves an error of" in refusal_of(text)


@pytest.mark.parametrize("unit", ["MM", "IN"])
def test_extended_odd_aspheres_are_those_of_their_formula(unit):
    mm = {"MM": 1.0, "IN": 25.4}[unit]
    norm, values = 2.5, {3: 1e-4, 4: -2e-4, 5: 3e-5, 7: -1e-5}
    terms = f"  XDAT 1 7\n  XDAT 2 {norm!r}\n" + "".join(f"  XDAT {n + 2} {a!r}\n" for n, a in values.items())
    text = ASPHERE_ZMX.format(kind="XOSPHERE", unit=unit, curvature=0.04, conic=-0.3, terms=terms, radius=5.0, epd=10.0)
    surface = lens_of(text).surfaces[0]
    for height in (0.5, 2.5, 5.0):
        truth = in_digits(0.04, -0.3, [(n, a / norm**n) for n, a in values.items()], height)
        assert surface.sag_mm(height * mm) == pytest.approx(mm * truth, abs=1e-12)


CONDENSER_ZMX = """\
MODE SEQ
UNIT MM
ENPD 45.72
WAVM 1 0.405 1
PWAV 1
SURF 0
  TYPE STANDARD
  DISZ INFINITY
SURF 1
  STOP
  TYPE QED_TYPE
  CURV 5.756078762782423225E-02
  CONI -0.67609120640407927
  XDAT 1 0
  XDAT 2 6
  XDAT 3 27
  XDAT 4 -8.148370167576E-01
  XDAT 5 -3.231100000000E-01
  XDAT 6 1.059100000000E-01
  XDAT 7 -5.058000000000E-02
  XDAT 8 9.870000000000E-03
  XDAT 9 -2.200000000000E-03
  XDAT 10 5.0
  DISZ 29.85
  GLAS C79-80
  DIAM 22.86
SURF 2
  TYPE STANDARD
  CURV 0.0
  DISZ 19.687453064998852
  DIAM 17.6 1
SURF 3
  TYPE STANDARD
  DISZ 0
"""
"""Thorlabs' ASL5040-UV, f = 40 mm, of fused silica."""


def test_a_catalogue_lens_with_forbes_asphere_has_its_makers_focus():
    """Its mild terms deviate along the normal of a conic: every height then meets the axis in the file's image."""
    choices = FileChoices({"C79-80": "main/SiO2/Malitson"})
    lens, report = read(FILE, CONDENSER_ZMX.splitlines(), choices)
    assert report.focal_length_mm == pytest.approx(40.0, abs=1e-3)
    assert "XDAT 10 5.0" in [line.text for line in report.of(Verdict.WITHOUT_EFFECT)]
    front, index = lens.surfaces[0], refractive_index("main/SiO2/Malitson", 405.0)
    for height in (1.0, 8.0, 16.0, 22.5):
        step = 1e-4
        slope = (front.sag_mm(height + step) - front.sag_mm(height - step)) / (2.0 * step)
        lean = math.atan(slope)
        inside = lean - math.asin(math.sin(lean) / index)
        left = height - (29.85 - front.sag_mm(height)) * math.tan(inside)
        assert left / math.tan(math.asin(index * math.sin(inside))) == pytest.approx(19.6875, abs=2e-3)


@pytest.mark.parametrize(("unit", "mm"), [("MM", 1.0), ("IN", 25.4)])
def test_strong_terms_are_those_of_a_scene(unit: str, mm: float) -> None:
    terms = ("XDAT 1 1", "XDAT 2 2", "XDAT 3 6", "XDAT 4 0.02", "XDAT 5 -0.01")
    surface = lens_of(aspheric("QED_TYPE", *terms).replace("UNIT MM", f"UNIT {unit}")).surfaces[1]
    assert surface.qcon is not None
    assert surface.qcon.norm_radius_mm == pytest.approx(6.0 * mm, rel=1e-15)
    assert surface.qcon.coefficients_mm == pytest.approx((0.02 * mm, -0.01 * mm), rel=1e-15)


def test_terms_beyond_their_count_are_none():
    terms = ("XDAT 1 2 0 0", "XDAT 2 6 0 0", "XDAT 4 1e-3 0 0", "XDAT 5 1e-3 0 0")
    lens, report = lens_of(aspheric("XASPHERE", *terms)), report_of(aspheric("XASPHERE", *terms))
    assert len(lens.surfaces[1].asphere_mm) == 1
    assert [line.text for line in report.of(Verdict.WITHOUT_EFFECT) if "XDAT" in line.text] == ["XDAT 5 1e-3 0 0"]


@pytest.mark.parametrize("kind", ["XASPHERE", "XOSPHERE"])
def test_extra_data_among_the_parameters_are_the_same_surface(kind):
    """OpticStudio's help, 24.2, counts the number of terms, the radius and the coefficients from parameter 13 on."""
    values = {1: 4, 2: 5.0, 4: -1e-3, 6: 2e-4}
    texts = [
        SINGLET_ZMX.replace(
            "  TYPE EVENASPH\n", f"  TYPE {kind}\n" + "".join(f"  {line(k)} {v!r}\n" for k, v in values.items())
        )
        for line in (lambda k: f"XDAT {k}", lambda k: f"PARM {k + 12}")
    ]
    own = ("  PARM 1 0\n", "  PARM 2 1e-6\n", "  PARM 3 -2e-9\n")
    stripped = [functools.reduce(lambda text, line: text.replace(line, ""), own, text) for text in texts]
    by_extra, by_parameters = (lens_of(text) for text in stripped)
    assert by_extra == by_parameters
    assert any(by_extra.surfaces[1].asphere_mm)


@pytest.mark.parametrize(("radius", "taken"), [("1e300", True), ("1e-300", False), ("0.1", True)])
def test_a_radius_whose_powers_leave_the_range_of_numbers_ends_in_no_traceback(radius, taken):
    text = aspheric("XASPHERE", "XDAT 1 12", f"XDAT 2 {radius}", "XDAT 4 1e-9")
    if taken:
        assert lens_of(text).surfaces[1].asphere_mm == (() if radius == "1e300" else pytest.approx((1e-5,), rel=1e-12))
    else:
        assert "XDAT 4 1e-9: its term in r^4 overflows float64" in refusal_of(text)
