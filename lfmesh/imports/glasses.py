"""Glasses that lens files name: found in the catalogue or refused, never guessed."""

import math
from collections.abc import Callable
from contextlib import suppress
from itertools import pairwise

from lfmesh.errors import GlassError, SceneError
from lfmesh.optics.glass import D_LINE_NM, MAKERS, find_glass, glass_in_words, is_glass, material_page, refractive_index
from lfmesh.scene.materials.own_glass import OwnGlass

UNLIKE = 2e-3
"""Difference between the catalogue's nd and the one that a file gives beside the name, above which it is said."""

SAME = 1e-4
"""Difference of nd up to which glasses of one name count as the same: makers' melts differ by some 1e-5."""

FORMULA_FROM_NM, FORMULA_STEP_NM, FORMULA_ROWS = 365.0, 5.0, 148
"""Table that stands for a formula: from 365 to 1,100 nm, so close that a spline through it is off by 1e-9."""

Medium = float | str | OwnGlass
"""Index without dispersion, name of a catalogue glass, or a glass by its dispersion."""


SPECIAL = "_SPECIAL"
"""Suffix that CODE V writes behind a material that is in no maker's catalogue."""


def _material(name: str) -> tuple[str, str] | None:
    """Return the catalogue's page of a crystal or plastic, and what to say of it; None if the name is none."""
    page = material_page(name)
    if page is None:
        return None
    return page, f"{name}: no maker's glass; taken as {glass_in_words(page)} of the catalogue"


def named_glass(name: str, catalogues: list[str]) -> tuple[str, str]:
    """Return the catalogue's name of a glass, and what to say where it is not from one of the file's catalogues.

    Parameters
    ----------
    name : str
        As the file writes it: "N-BK7", "NBK7_SCHOTT".
    catalogues : list of str
        Makers whose glasses the file uses, the first first; empty where it does not say.

    Raises
    ------
    GlassError
        There is no such glass; the message names close ones.
    """
    name = name[: -len(SPECIAL)] if name.upper().endswith(SPECIAL) else name
    for maker in catalogues:
        if is_glass(full := f"{maker}/{name}"):
            return full, ""
    _refuse_ambiguous(name)
    try:
        find_glass(name)
    except GlassError:
        if (material := _material(name)) is not None:
            return material
        stem, _, maker = name.partition("_")
        if maker.upper() not in MAKERS:
            raise
        # Names close to a CODE V name are found by maker and glass.
        find_glass(f"{maker}/{stem}")
    if not catalogues:
        # SCHOTT's names are those that files without a maker mean; others have used some of them for other glasses.
        own = "/" in name or find_glass(name)[:2] == find_glass("SCHOTT/N-BK7")[:2]
        return name, "" if own else f"the file names no catalogue; taken as {glass_in_words(name)}"
    return name, f"not in {', '.join(catalogues)}; the catalogue has it as {glass_in_words(name)}"


def _refuse_ambiguous(name: str) -> None:
    """Raise if a name without a maker means glasses that differ, SCHOTT's successor of an old one among them."""
    found: dict[str, float] = {}
    for full in filter(is_glass, (*(f"{maker}/{name}" for maker in MAKERS), f"SCHOTT/N-{name}")):
        # Not one whose data do not reach that line.
        with suppress(GlassError):
            found[full] = refractive_index(full, D_LINE_NM)
    if found and max(found.values()) - min(found.values()) > SAME:
        listed = ", ".join(f"{glass} (nd = {index:.5f})" for glass, index in found.items())
        raise GlassError(
            f"glass {name!r} means different glasses: {listed}; name the maker in the file (GCAT), or give --glass "
            f"{name}={next(iter(found))} or camera.lens.substitutes"
        )


def formula_glass(formula: str, coefficients: list[float]) -> tuple[Medium, str]:
    """Return a glass by one of CODE V's dispersion formulas, λ in µm, and what to say of it.

    "LAU" or "GML", Laurent's n² = a₀ + a₁ λ² + a₂ λ⁻² + a₃ λ⁻⁴ + a₄ λ⁻⁶ + a₅ λ⁻⁸; "GMS" or "SLM", Sellmeier's
    n² = 1 + Σ b λ² / (λ² − c) by pairs of b and c; "CAU", Cauchy's n = a₀ + a₁ λ⁻² + a₂ λ⁻⁴ + ...; "HAR", Hartmann's
    n = a₀ + a₁ / (λ − a₂).

    Parameters
    ----------
    formula : str
    coefficients : list of float

    Raises
    ------
    GlassError
        The formula is none of these, has another number of coefficients, or they give no index.
    """
    if formula not in FORMULAS:
        raise GlassError(f"formula {formula} is not read; {', '.join(FORMULAS)} are")
    count, index = FORMULAS[formula]
    if len(coefficients) not in count:
        raise GlassError(f"{len(coefficients)} coefficients of formula {formula}, which has {count[0]} to {count[-1]}")
    rows = [FORMULA_FROM_NM + FORMULA_STEP_NM * k for k in range(FORMULA_ROWS)]
    try:
        indices = [index(coefficients, 1e-3 * nm) for nm in rows]
    except (ZeroDivisionError, ValueError):
        raise GlassError("its formula gives no index of 1 or more") from None
    steps = [abs(after - before) for before, after in pairwise(indices)]
    if not min(indices) >= 1.0 or max(steps) > MOST_STEP:
        raise GlassError("its formula gives no index of 1 or more, or a pole, from 365 to 1,100 nm")
    # The manual that gives the coefficients' order was at hand for Laurent's formula alone.
    how = "" if formula == "LAU" else f"formula {formula} with its coefficients in the order that other readers take"
    return private_glass(rows, indices), how


def _laurent(a: list[float], um: float) -> float:
    return math.sqrt(sum(each * um**power for each, power in zip(a, (0, 2, -2, -4, -6, -8), strict=False)))


def _sellmeier(a: list[float], um: float) -> float:
    pairs = zip(a[::2], a[1::2], strict=True)
    return math.sqrt(1.0 + sum(b * um * um / (um * um - c) for b, c in pairs))


def _cauchy(a: list[float], um: float) -> float:
    return sum(each * um ** (-2 * k) for k, each in enumerate(a))


def _hartmann(a: list[float], um: float) -> float:
    return a[0] + a[1] / (um - a[2])


FORMULAS: dict[str, tuple[range | tuple[int, ...], Callable[[list[float], float], float]]] = {
    **dict.fromkeys(("LAU", "GML"), (range(1, 7), _laurent)),
    **dict.fromkeys(("GMS", "SLM"), ((2, 4, 6), _sellmeier)),
    "CAU": (range(1, 7), _cauchy),
    "HAR": ((3,), _hartmann),
}
"""Number of coefficients of each formula, and its index."""

MOST_STEP = 0.01
"""Step of the index in 5 nm, above which there is a pole: glasses change by a tenth of that."""


def unlike(name: str, index_d: float) -> str:
    """Return what to say where a file's nd is not that of the glass it names; nothing where it is."""
    try:
        known = refractive_index(name, D_LINE_NM)
    except GlassError:
        return ""
    if abs(known - index_d) <= UNLIKE:
        return ""
    return f"the file gives nd = {index_d:.6g}, the catalogue {known:.6g}, which is taken"


def model_glass(index_d: float, abbe: float, wavelengths_nm: list[float]) -> Medium:
    """Return a glass that is given by nd and Vd alone.

    Parameters
    ----------
    index_d, abbe : float
        nd, and Vd; a Vd of 0 says that it does not disperse.
    wavelengths_nm : list of float
        Light that the file uses.

    Raises
    ------
    GlassError
        There is no such glass, or nd and Vd do not tell its index at one of these wavelengths.
    """
    if abbe == 0:
        return index_d
    try:
        glass = OwnGlass(nd=index_d, vd=abbe)
    except SceneError as error:
        raise GlassError(f"glass given by nd = {index_d:.6g}, Vd = {abbe:.4g}: {error}") from None
    for line in wavelengths_nm:
        glass.index_at(line)
    return glass


def private_glass(wavelengths_nm: list[float], indices: list[float]) -> Medium:
    """Return a glass that a file gives by a table; an index where it does not disperse.

    Raises
    ------
    GlassError
        The table is none.
    """
    if indices and max(indices) == min(indices):
        return indices[0]
    if len(wavelengths_nm) != len(indices):
        raise GlassError(f"{len(indices)} indices for {len(wavelengths_nm)} wavelengths")
    rows = sorted(zip(wavelengths_nm, indices, strict=True))
    try:
        return OwnGlass(wavelengths_nm=tuple(w for w, _ in rows), values=tuple(n for _, n in rows))
    except SceneError as error:
        raise GlassError(str(error)) from None
