"""Glasses against their makers' data sheets, and what is said of names that are none."""

import math

import numpy as np
import pytest

from lfmesh.errors import GlassError
from lfmesh.optics.glass import (
    FORMER,
    MAKERS,
    OTHER_GLASS,
    _catalogue,
    absorption_per_mm,
    find_glass,
    former_index,
    glass_in_words,
    is_glass,
    refractive_index,
)

LINES = (486.1327, 587.5618, 656.2725)

# Indices at the helium d line, 587.5618 nm, as printed in the makers' data sheets (relative to air).
DATA_SHEETS = [
    ("SCHOTT/N-BK7", 1.51680),
    ("SCHOTT/F2", 1.62004),
    ("SCHOTT/N-SF11", 1.78472),
    ("HIKARI/SK16", 1.62041),
    ("OHARA/S-BSL7", 1.51633),
    ("CDGM/H-K9L", 1.51680),
]


@pytest.mark.parametrize(("name", "nd"), DATA_SHEETS)
def test_index_is_that_of_the_data_sheet(name: str, nd: float) -> None:
    assert refractive_index(name, 587.5618) == pytest.approx(nd, abs=1e-5)


def test_abbe_number_of_bk7() -> None:
    d, f, c = (refractive_index("SCHOTT/N-BK7", line) for line in (587.5618, 486.1327, 656.2725))
    assert (d - 1) / (f - c) == pytest.approx(64.17, abs=0.01)


def test_air_and_plain_indices_do_not_disperse() -> None:
    assert refractive_index(None, 300.0) == refractive_index(None, 900.0) == 1.0
    assert refractive_index(1.67, 300.0) == refractive_index(1.67, 900.0) == 1.67


def test_a_bare_name_works_where_one_maker_has_it() -> None:
    assert find_glass("n-bk7") == find_glass("SCHOTT/N-BK7") == ("specs", "SCHOTT-optical", "N-BK7")


def test_a_bare_name_of_several_makers_is_refused_with_the_choices() -> None:
    with pytest.raises(GlassError, match=r"'F2'.*SCHOTT/F2.*HIKARI/F2"):
        find_glass("F2")


def test_several_makers_of_one_name_come_with_their_indices_the_best_known_maker_first() -> None:
    with pytest.raises(GlassError) as refused:
        find_glass("F2")
    assert "'SCHOTT/F2' (nd 1.62004, Vd 36.37) or 'HIKARI/F2' (nd 1.62004, Vd 36.3" in str(refused.value)
    assert "'CDGM/F2' (nd 1.61293, Vd 36.9" in str(refused.value)


def test_a_bare_name_that_stands_for_one_glass_only_is_taken() -> None:
    """Where makers give the same indices it does not matter whose they are."""
    several = [name for name, pages in _catalogue().items() if "/" not in name and len(pages) > 1]
    taken = []
    for name in several:
        try:
            taken.append((name, find_glass(name)))
        except GlassError:
            continue
    assert "SF2" in dict(taken)
    assert find_glass("SF2") == find_glass("SCHOTT/SF2")
    # At F the dispersion of these differs by 8e-5, though nd is the same to five digits.
    assert "SF11" in several
    assert "SF11" not in dict(taken)
    for name, page in taken:
        indices = [[refractive_index("/".join(each), line) for line in LINES] for each in _catalogue()[name]]
        assert np.ptp(indices, axis=0).max() <= 1e-5
        assert page in _catalogue()[name]


@pytest.mark.parametrize(
    ("written", "glass"),
    [
        ("NSSK2_SCHOTT", "SCHOTT/N-SSK2"), ("NBK7_SCHOTT", "SCHOTT/N-BK7"), ("SBSL7_OHARA", "OHARA/S-BSL7"),
        ("HK9L_CDGM", "CDGM/H-K9L"), ("F2_HIKARI", "HIKARI/F2"), ("NBK7", "SCHOTT/N-BK7"),
        ("SILICA", "main/SiO2/Malitson"), ("F_SILICA", "main/SiO2/Malitson"),
    ],
)  # fmt: skip
def test_names_of_other_programs_are_understood(written: str, glass: str) -> None:
    assert find_glass(written) == find_glass(glass)


@pytest.mark.parametrize(
    ("old", "heir"),
    [
        ("BK7", r"close to it are SCHOTT/N-BK7 \(nd 1\.51680, Vd 64\.17\), SCHOTT/P-BK7"),
        ("BAK1", "are SCHOTT/N-BAK1 "),
    ],
)
def test_the_successor_of_an_old_glass_is_named_first(old: str, heir: str) -> None:
    with pytest.raises(GlassError, match=heir):
        find_glass(old)


def test_a_glass_is_described_with_catalogue_index_and_abbe_number() -> None:
    assert glass_in_words("n-bk7") == "SCHOTT/N-BK7 (nd 1.51680, Vd 64.17)"
    assert glass_in_words("main/Ge/Li-293K") == "main/Ge/Li-293K"


def test_the_rest_of_the_catalogue_is_reached_by_shelf_book_and_page() -> None:
    # Fused silica, three-term Sellmeier formula of Malitson, J. Opt. Soc. Am. 55, 1205 (1965).
    terms = [(0.6961663, 0.0684043), (0.4079426, 0.1162414), (0.8974794, 9.896161)]
    n2 = 1 + sum(b * 0.55**2 / (0.55**2 - c**2) for b, c in terms)
    assert refractive_index("main/SiO2/Malitson", 550.0) == pytest.approx(n2**0.5, rel=1e-12)


@pytest.mark.parametrize(
    ("slip", "meant"),
    [("SCHOTT/N-BK77", "SCHOTT/N-BK7"), ("SCHOT/N-BK7", "SCHOTT/N-BK7"), ("OHARA/N-BK7", "SCHOTT/N-BK7")],
)
def test_an_unknown_glass_names_close_ones(slip: str, meant: str) -> None:
    with pytest.raises(GlassError, match=rf"{slip}.*{meant}\b"):
        refractive_index(slip, 587.6)


def test_a_name_like_none_says_how_names_are_written() -> None:
    with pytest.raises(GlassError, match="SCHOTT/N-BK7"):
        refractive_index("???", 587.6)


def test_a_wavelength_outside_the_data_gives_their_range() -> None:
    with pytest.raises(GlassError, match=r"200 nm.*from 300 to 2500 nm"):
        refractive_index("SCHOTT/N-BK7", 200.0)


def test_the_ends_of_the_range_are_inside() -> None:
    assert refractive_index("SCHOTT/N-BK7", 300.0) > refractive_index("SCHOTT/N-BK7", 2500.0) > 1.4


def test_a_metal_is_no_glass() -> None:
    with pytest.raises(GlassError, match="index 0"):
        refractive_index("main/Ag/Johnson", 587.6)


@pytest.mark.parametrize(
    ("name", "first"),
    [("BK7_SCHOTT", "SCHOTT/N-BK7"), ("SK16_SCHOTT", "HIKARI/SK16"), ("BK7HT_SCHOTT", "SCHOTT/N-BK7HT")],
)
def test_a_makers_old_name_suggests_its_heirs_first(name: str, first: str) -> None:
    with pytest.raises(GlassError, match=f"close to it are .*{first}"):
        refractive_index(name, 587.6)


def test_air_is_no_glass() -> None:
    with pytest.raises(GlassError, match="for air omit glass and index"):
        refractive_index("AIR", 587.6)


@pytest.mark.parametrize(
    ("wavelength", "transmittance"),
    [(2325.0, 0.793), (1530.0, 0.992), (1060.0, 0.999), (700.0, 0.998), (546.0, 0.998), (400.0, 0.997), (365.0, 0.988),
     (350.0, 0.967), (334.0, 0.905), (320.0, 0.770), (310.0, 0.574)],
)  # fmt: skip
def test_absorption_is_the_internal_transmittance_of_the_makers_sheet(wavelength: float, transmittance: float) -> None:
    """SCHOTT's data sheet of N-BK7, internal transmittance of 10 mm, to its three digits."""
    assert abs(math.exp(-10.0 * absorption_per_mm("SCHOTT/N-BK7", wavelength)) - transmittance) < 0.0006


def test_a_glass_without_internal_transmittance_is_not_clear_but_refused() -> None:
    refractive_index("LZOS/K8", 587.6)
    with pytest.raises(GlassError, match="no internal transmittance for it"):
        absorption_per_mm("LZOS/K8", 587.6)


def test_a_bare_name_means_one_glass_whoever_used_it() -> None:
    """Over all names of makers: a name that is taken has the index of each maker's glass and of SCHOTT's former one."""
    bare = {name for name, pages in _catalogue().items() if "/" not in name and any(p[0] == "specs" for p in pages)}
    refused = set()
    for name in bare:
        own = [f"{maker}/{name}" for maker in MAKERS if is_glass(f"{maker}/{name}")]
        try:
            indices = [refractive_index(each, LINES[1]) for each in own]
        except GlassError:
            # Infrared glasses, whose data do not reach the d line.
            continue
        former = None if any(each.startswith("SCHOTT/") for each in own) else former_index(name)
        indices += [] if former is None else [former]
        if indices and np.ptp(indices) > OTHER_GLASS:
            refused.add(name)
            assert not is_glass(name)
    assert {"BK10", "F1", "F4"} <= refused
    assert set(FORMER) & bare <= refused
    assert {"BAF5", "BK6", "BK8", "F7"} <= refused


@pytest.mark.parametrize(
    ("name", "today", "former"),
    [
        ("BK6", 1.53998, "nd = 1.53113 and vd = 62.1 for SCHOTT's former glass"),
        ("BK10", 1.56889, r"'SCHOTT/N-BK10' \(nd 1.49782, Vd 66.95\) for SCHOTT's former glass"),
        ("f7", 1.63636, "nd = 1.62536 and vd = 35.6 for SCHOTT's former glass"),
    ],
)
def test_a_bare_name_that_another_maker_uses_for_another_glass_is_refused_with_both(name, today, former) -> None:
    both = rf"2 glasses of different index have this name; say '\w+/{name.upper()}' \(nd {today:.5f}, .* or {former}"
    with pytest.raises(GlassError, match=both):
        find_glass(name)
