"""Names of glasses in lens files: former names, names that several glasses share, and codes."""

import re
from pathlib import Path

import numpy as np
import pytest

from lfmesh.errors import SceneError
from lfmesh.imports import codev
from lfmesh.imports.report import Verdict
from lfmesh.imports.zemax import read
from lfmesh.optics.glass import C_LINE_NM, D_LINE_NM, F_LINE_NM, OTHER_GLASS, SUCCESSORS_OFF, refractive_index
from tests.imports.files import SINGLET_SEQ, SINGLET_ZMX

FILE = Path("lens.zmx")


def lens_of(text):
    return read(FILE, text.splitlines())[0]


def report_of(text):
    return read(FILE, text.splitlines())[1]


def refusal_of(text):
    with pytest.raises(SceneError) as error:
        lens_of(text)
    return str(error.value)


def glass_line(words, catalogues="GCAT SCHOTT\n"):
    """Return the singlet with a glass and catalogues of its own."""
    return SINGLET_ZMX.replace("N-BK7 0 0 1.5168 64.17", words).replace("GCAT SCHOTT\n", catalogues)


def test_an_old_name_is_not_another_makers_glass_where_schotts_successor_differs():
    """SCHOTT's BK10 had nd = 1.49782, as N-BK10 has; the catalogue knows the name for a glass of LZOS alone."""
    old = "BK10 0 0 1.5 40"
    said = refusal_of(glass_line(old, ""))
    assert "glass 'BK10' means different glasses: LZOS/BK10 (nd = 1.56889), SCHOTT/N-BK10" in said
    assert "SCHOTT's former BK10 (nd = 1.49782)" in said
    assert "name the maker in the file, or give --glass BK10=LZOS/BK10 or camera.lens.substitutes" in said
    for makers, glass in {
        "LZOS": "LZOS/BK10",
        "SCHOTT": "SCHOTT/N-BK10",
        "SCHOTT LZOS": "SCHOTT/N-BK10",
        "LZOS SCHOTT": "LZOS/BK10",
    }.items():
        assert lens_of(glass_line(old, f"GCAT {makers}\n")).surfaces[0].glass == glass


@pytest.mark.parametrize("catalogues", ["", "GCAT SCHOTT\n", "GCAT SCHOTT CDGM\n"])
def test_a_former_glass_without_successor_is_not_another_makers(catalogues):
    said = refusal_of(glass_line("F7 0 0 1.5 40", catalogues))
    assert "means different glasses: CDGM/F7 (nd = 1.63636), SCHOTT's former F7 (nd = 1.62536)" in said
    by_index = glass_line("F7 0 0 1.63636 35.39", catalogues)
    assert lens_of(by_index).surfaces[0].glass == "CDGM/F7"
    assert lens_of(glass_line("F7 0 0 1.5 40", "GCAT CDGM SCHOTT\n")).surfaces[0].glass == "CDGM/F7"


@pytest.mark.parametrize("catalogues", ["", "GCAT OHARA\n", "GCAT LZOS CDGM SCHOTT\n"])
@pytest.mark.parametrize(
    ("name", "values", "glass"),
    [
        ("BK10", "1.49782 66.95", "SCHOTT/N-BK10"),
        ("BK10", "1.56889 56.05", "LZOS/BK10"),
        ("F4", "1.62005 36.36", "CDGM/F4"),
        ("F4", "1.62435 35.92", "LZOS/F4"),
    ],
)
def test_nd_tells_apart_the_glasses_that_share_a_name(catalogues, name, values, glass):
    assert lens_of(glass_line(f"{name} 0 0 {values}", catalogues)).surfaces[0].glass == glass


@pytest.mark.parametrize("values", ["0 0", "1.5 40", "{nd} {abbe}"])
@pytest.mark.parametrize(
    ("name", "buchdahl", "glass"),
    [
        # Robb and Mercado, Applied Optics 22, 1198 (1983), Table V, SCHOTT: index at 574 nm and two coefficients.
        ("BK7", (1.517385, -0.044736, -0.0032737), "SCHOTT/N-BK7"),
        ("SK10", (1.623593, -0.060458, 0.00092315), "SCHOTT/N-SK10"),
        ("LAKN12", (1.678788, -0.067795, -0.0015477), "SCHOTT/N-LAK12"),
        ("BAFN10", (1.671054, -0.078140, 0.010138), "SCHOTT/N-BAF10"),
        ("KZFSN5", (1.655302, -0.090617, 0.014951), "SCHOTT/N-KZFS5"),
        ("SSKN5", (1.659373, -0.071231, 0.0060741), "SCHOTT/N-SSK5"),
    ],
)
def test_a_glass_that_schott_gave_up_is_its_successor_and_the_difference_is_said(values, name, buchdahl, glass):
    f, d, c = (buchdahl_index(buchdahl, line) for line in (F_LINE_NM, D_LINE_NM, C_LINE_NM))
    own = [refractive_index(glass, line) for line in (F_LINE_NM, D_LINE_NM, C_LINE_NM)]
    assert np.abs(np.subtract(own, (f, d, c))).max() <= SUCCESSORS_OFF
    text = glass_line(f"{name} 0 0 {values.format(nd=d, abbe=(d - 1) / (f - c))}")
    assert lens_of(text).surfaces[0].glass == glass
    (line,) = report_of(text).of(Verdict.APPROXIMATED)
    assert line.how.startswith(f"SCHOTT's former {name}; taken as its successor {glass} (nd ")
    if "nd" not in values:
        assert line.how.endswith(f", whose index at F, d and C differs by at most {SUCCESSORS_OFF:g}")
        return
    said = re.search(r"differs by (\S+) at F, (\S+) at d and (\S+) at C \(F, C: of a normal glass\)", line.how)
    assert said is not None
    at_f, at_d, at_c = map(float, said.groups())
    # Printed to five digits; the dispersion is exact, its two ends are a normal glass's.
    assert at_d == pytest.approx(own[1] - d, abs=0.6e-5)
    assert at_f - at_c == pytest.approx(own[0] - own[2] - (f - c), abs=1.1e-5)


def buchdahl_index(terms, wavelength_nm):
    """Return N0 + ν1 ω + ν2 ω² with Buchdahl's chromatic coordinate ω = δ / (1 + 2.5 δ), δ in µm from 0.574 µm."""
    off = 1e-3 * wavelength_nm - 0.574
    omega = off / (1.0 + 2.5 * off)
    return terms[0] + terms[1] * omega + terms[2] * omega**2


@pytest.mark.parametrize(("makers", "name"), [("CDGM", "LAK10"), ("OHARA HOYA", "BK7")])
def test_a_former_name_is_not_schotts_where_the_file_lists_other_makers(makers, name):
    said = refusal_of(glass_line(f"{name} 0 0 1.5 40", f"GCAT {makers}\n"))
    assert f"glass '{name}': not in the catalogue" in said
    assert f"SCHOTT/N-{name} " in said
    assert f"give --glass {name}=GLASS or camera.lens.substitutes" in said


def test_catalogues_that_lfmesh_does_not_have_are_named_where_a_glass_is_not_found():
    said = refusal_of(glass_line("OWN7 0 0 1.5 40", "GCAT MYCAT SCHOTT FOO_2019\n"))
    assert "; lfmesh does not have the file's catalogues MYCAT, FOO; give --glass OWN7=GLASS" in said
    assert "does not have" not in refusal_of(glass_line("OWN7 0 0 1.5 40"))


def test_a_former_name_of_another_maker_is_the_glass_that_continues_it_with_its_indices():
    text = glass_line("ZK50 0 0 1.60738 56.65", "GCAT CDGM\n")
    assert lens_of(text).surfaces[0].glass == "CDGM/H-ZK50"
    (line,) = report_of(text).of(Verdict.APPROXIMATED)
    assert line.how.startswith("ZK50 is in no catalogue; by its nd and Vd taken as CDGM/H-ZK50 (nd 1.60738, Vd 56.65)")
    said = refusal_of(text.replace("1.60738 56.65", "1.7 56.65"))
    assert "nearest to its nd and Vd is " in said
    assert "at d and " in said
    assert "give --glass ZK50=GLASS or camera.lens.substitutes" in said


def test_a_former_name_without_successor_is_a_melt_of_its_indices():
    # F6 of CDGM has nd = 1.62495 and Vd = 35.58.
    text = glass_line("FN7 0 0 1.62496 35.57")
    assert lens_of(text).surfaces[0].glass == "CDGM/F6"
    assert (
        "FN7 is in no catalogue; by its nd and Vd taken as CDGM/F6" in report_of(text).of(Verdict.APPROXIMATED)[0].how
    )


def test_indices_beside_a_name_do_not_overrule_it():
    """Lens files often hold the indices of a glass that stood there before."""
    text = glass_line("BK7 0 0 1.69673 56.42")
    assert lens_of(text).surfaces[0].glass == "SCHOTT/N-BK7"
    (line,) = report_of(text).of(Verdict.APPROXIMATED)
    assert line.how.startswith("SCHOTT's former BK7; taken as its successor SCHOTT/N-BK7")
    assert line.how.endswith("; the file gives nd = 1.69673, the catalogue 1.5168, which is taken")


@pytest.mark.parametrize(
    ("values", "glass"),
    [("0 0", (1.517, 64.2)), ("7734.33 17972.8", (1.517, 64.2)), ("1.5168 64.17", (1.5168, 64.17))],
)
def test_a_code_of_six_digits_is_nd_and_abbe_number(values, glass):
    text = glass_line(f"517642 0 0 {values}")
    found = lens_of(text).surfaces[0].glass
    assert (found.nd, found.vd) == glass
    assert [line.how for line in report_of(text).of(Verdict.APPROXIMATED)] == ["the normal glass of its nd and Vd"]


@pytest.mark.parametrize(
    ("name", "glass"), [("BK7_SCHOTT", "SCHOTT/N-BK7"), ("SCHOTT/LAKN12", "SCHOTT/N-LAK12"), ("BK7", "SCHOTT/N-BK7")]
)
def test_former_names_are_understood_in_other_formats(name, glass):
    lens, report = codev.read(Path("lens.seq"), SINGLET_SEQ.replace("NBK7_SCHOTT", name).splitlines())
    assert lens.surfaces[0].glass == glass
    (line,) = report.of(Verdict.APPROXIMATED)
    assert f"taken as its successor {glass}" in line.how


def test_a_code_is_read_in_other_formats():
    lens, _ = codev.read(Path("lens.seq"), SINGLET_SEQ.replace("NBK7_SCHOTT", "517642").splitlines())
    assert (lens.surfaces[0].glass.nd, lens.surfaces[0].glass.vd) == (1.517, 64.2)


@pytest.mark.parametrize(
    ("name", "buchdahl", "glass"),
    [
        # As above, of SCHOTT's glasses that have no successor.
        ("SF3", (1.741863, -0.14249, 0.055258), "CDGM/ZF5"),
        ("F4", (1.617794, -0.091970, 0.023170), "CDGM/H-F3"),
    ],
)
def test_a_former_glass_without_successor_is_a_melt_of_its_published_indices(name, buchdahl, glass):
    lens, report = (of(glass_line(f"{name} 0 0 1.5 40")) for of in (lens_of, report_of))
    assert lens.surfaces[0].glass == glass
    (line,) = report.of(Verdict.APPROXIMATED)
    assert line.how.startswith(f"SCHOTT's former {name} is in no catalogue; by its nd and Vd taken as {glass} (nd ")
    for wavelength in (F_LINE_NM, D_LINE_NM, C_LINE_NM):
        assert abs(refractive_index(glass, wavelength) - buchdahl_index(buchdahl, wavelength)) < OTHER_GLASS
