"""Glasses named in lens files: found in the catalogue or refused, never guessed."""

import math
import re
from collections.abc import Callable
from contextlib import suppress
from itertools import pairwise

from lfmesh.errors import GlassError, SceneError
from lfmesh.optics.glass import (
    C_LINE_NM,
    D_LINE_NM,
    F_LINE_NM,
    FORMER,
    MAKERS,
    OTHER_GLASS,
    SUCCESSORS_OFF,
    find_glass,
    former_index,
    glass_in_words,
    glass_name,
    is_glass,
    line_indices,
    material_page,
    near_glasses,
    refractive_index,
    successor,
)
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.materials.own_glass import OwnGlass

UNLIKE = 2e-3
"""Difference between the catalogue's nd and the file's above which the report says so."""

SAME = 1e-4
"""Largest difference of nd between equal glasses of one name; makers' melts differ by about 1e-5."""

FORMULA_FROM_NM, FORMULA_STEP_NM, FORMULA_ROWS = 365.0, 5.0, 148
"""Tabulation of a dispersion formula from 365 to 1,100 nm, so dense that a spline is accurate to 1e-9."""

Medium = float | str | OwnGlass | Gradient
"""Constant index, name of a catalogue glass, a glass defined by its dispersion, or gradient-index glass."""


Stated = tuple[float, float | None]
"""n_d, and the Abbe number if given, beside a glass's name."""

SPECIAL = "_SPECIAL"
"""CODE V's suffix of materials that are in no maker's catalogue."""

_FORMER = "SCHOTT's former glass"

_FORMER_NAME = re.compile(r"[A-Z]{1,5}[0-9]{1,3}[A-Z]?")
"""Names used before makers marked new glasses by a letter and hyphen: BK7, LAKN12, SSK4A."""


def _material(name: str) -> tuple[str, str] | None:
    """Return the catalogue page of a crystal or plastic, and a note on it; None for other names."""
    page = material_page(name)
    if page is None:
        return None
    return page, f"{name}: not a maker's glass; taken as {glass_in_words(page)} of the catalogue"


def named_glass(name: str, catalogues: list[str], stated: Stated | None = None) -> tuple[str, str]:
    """Return the catalogue name of a glass, with a note if it is not from the file's catalogues.

    Parameters
    ----------
    name : str
        Name in the file: "N-BK7", "NBK7_SCHOTT", "BK7".
    catalogues : list of str
        Makers of the file's glasses, in order of preference; empty if not stated.
    stated : tuple of float and float or None, optional
        n_d and Abbe number beside the name. They distinguish glasses of equal name but do not overrule it, as files
        often hold the indices of an earlier glass.

    Raises
    ------
    GlassError
        The name matches no glass or several; the message gives the remedy.
    """
    name = name[: -len(SPECIAL)] if name.upper().endswith(SPECIAL) else name
    stem, _, maker = name.partition("_")
    if "/" in name:
        maker, _, stem = name.partition("/")
    if maker.upper() in MAKERS and is_glass(name):
        return name, ""
    if maker.upper() == "SCHOTT" and (heir := successor(stem)):
        return _succeeded(stem, heir, stated)
    if options := _of_catalogues(name, catalogues, stated):
        heir = successor(name)
        if options[0] != heir:
            return options[0], ""
        alike = [each for each in options[1:] if _off(each, heir) <= OTHER_GLASS]
        if alike:
            return alike[0], ""
        if not is_glass(name):
            return _succeeded(name, heir, stated)
    if found := _former_melt(stem, catalogues, maker, stated) or _meant(name, catalogues, stated):
        return found
    if not is_glass(name):
        return _not_found(name, catalogues, stated)
    if not catalogues:
        # Files without a maker mean SCHOTT's names; other makers reused some of them for other glasses.
        own = "/" in name or find_glass(name)[:2] == find_glass("SCHOTT/N-BK7")[:2]
        return name, "" if own else f"the file names no catalogue; taken as {glass_in_words(name)}"
    return name, f"not in {', '.join(catalogues)}; the catalogue has it as {glass_in_words(name)}"


def glass_code(name: str, stated: Stated | None = None) -> tuple[float, float] | None:
    """Return n_d and Abbe number of a six-digit glass code, e.g. 1.517 and 64.2 for "517642", or None.

    Parameters
    ----------
    name : str
    stated : tuple of float and float or None, optional
        n_d and Abbe number beside the code, used for their extra digits if they round to it.
    """
    if not re.fullmatch(r"[0-9]{6}", name) or not int(name[3:]):
        return None
    index, abbe = 1.0 + int(name[:3]) / 1000.0, int(name[3:]) / 10.0
    if stated is not None and stated[1] is not None and abs(stated[0] - index) < 1e-3 and abs(stated[1] - abbe) < 0.1:
        return stated[0], stated[1]
    return index, abbe


def _of_catalogues(name: str, catalogues: list[str], stated: Stated | None) -> list[str]:
    """Return the glasses of this name in the file's catalogues, only the ones with the stated n_d if any.

    SCHOTT's successors stand in for its former glasses.
    """
    found = []
    for maker in catalogues:
        if is_glass(full := f"{maker}/{name}"):
            found.append(full)
        elif maker == "SCHOTT" and (heir := successor(name)):
            found.append(heir)
        elif maker == "SCHOTT" and former_index(name) is not None:
            # Older files mean the former glass, newer ones the glass of a later catalogue.
            break
    return [each for each in found if _fits(each, stated)] or found


def _meant(name: str, catalogues: list[str], stated: Stated | None) -> tuple[str, str] | None:
    """Return the glass of a bare name that needs n_d or SCHOTT's convention to resolve; None if the name suffices.

    Raises
    ------
    GlassError
        Makers use the name for different glasses, and n_d does not tell which.
    """
    if "/" in name or "_" in name:
        return None
    makers = [full for maker in MAKERS if is_glass(full := f"{maker}/{name}")]
    # Omit glasses without data at that line.
    found = {full: lines[1] for full in makers if (lines := line_indices(full)) is not None}
    heir, former = successor(name), former_index(name)
    words = {full: f"{full} (nd = {index:.5f})" for full, index in found.items()}
    if former is not None:
        key = heir or _FORMER
        found[key] = former
        words[key] = f"{f'{heir} for ' if heir else ''}SCHOTT's former {name} (nd = {former:.5f})"
    if found and max(found.values()) - min(found.values()) > SAME:
        fits = [full for full, index in found.items() if stated and abs(index - stated[0]) <= OTHER_GLASS]
        if not fits or max(found[full] for full in fits) - min(found[full] for full in fits) > SAME:
            choice = next((full for full in found if full != _FORMER), "GLASS")
            raise GlassError(
                f"glass {name!r} means different glasses: {', '.join(words.values())}; name the maker in the file, or "
                f"{_remedy(name, choice)}"
            )
        if fits[0] != _FORMER:
            if fits[0] == heir:
                return _succeeded(name, heir, stated)
            return fits[0], f"several glasses are named {name}; by its nd it is {glass_in_words(fits[0])}"
        return _by_indices(name, stated) or _not_found(name, catalogues, stated)
    if heir and not makers and (not catalogues or _fits(heir, stated)) and not is_glass(name):
        return _succeeded(name, heir, stated)
    return None


def _succeeded(name: str, heir: str, stated: Stated | None) -> tuple[str, str]:
    """Return SCHOTT's successor of a former glass, and a note on their difference."""
    said = f"SCHOTT's former {name}; taken as its successor {glass_in_words(heir)}"
    if stated is not None and abs(stated[0] - refractive_index(heir, D_LINE_NM)) <= UNLIKE:
        return heir, f"{said}, {_apart(heir, stated)}"
    return heir, f"{said}, whose index at F, d and C differs by at most {SUCCESSORS_OFF:g}"


def _by_indices(name: str, stated: Stated | None, called: str = "") -> tuple[str, str] | None:
    """Return the successor of a former name, or any melt, with the stated n_d and Abbe number, or None."""
    bare = name.partition("_")[0].upper()
    if stated is None or not stated[1] or not _FORMER_NAME.fullmatch(bare):
        return None
    index, dispersion = stated[0], (stated[0] - 1.0) / stated[1]
    for limit, ending in ((OTHER_GLASS, f"-{bare}"), (SAME, "")):
        off, glass = next(iter(near_glasses(index, dispersion, ending=ending)), (math.inf, ""))
        if off <= limit:
            said = f"{called or name} is in no catalogue; by its nd and Vd taken as {glass_in_words(glass)}"
            return glass, f"{said}, {_apart(glass, stated)}"
    return None


def _former_melt(name: str, catalogues: list[str], maker: str, stated: Stated | None) -> tuple[str, str] | None:
    """Return a melt with the indices of a former SCHOTT glass without successor, if the name is SCHOTT's."""
    former = FORMER.get(name.upper())
    used = any(is_glass(f"{each}/{name}") for each in catalogues or MAKERS)
    if former is None or maker.upper() not in ("", "SCHOTT"):
        return None
    if not maker and (used or (catalogues and "SCHOTT" not in catalogues)):
        return None
    if stated is not None and abs(stated[0] - former[0]) > OTHER_GLASS:
        return None
    return _by_indices(name, former, f"SCHOTT's former {name}")


def _not_found(name: str, catalogues: list[str], stated: Stated | None) -> tuple[str, str]:
    """Return the crystal, plastic or glass of equal indices for a name that is no maker's glass.

    Raises
    ------
    GlassError
        None exists; the message gives the remedy, the nearest glass of the file's makers, and its unknown catalogues.
    """
    if (found := _material(name) or _by_indices(name, stated)) is not None:
        return found
    stem, _, maker = name.partition("_")
    try:
        # Similar CODE V names are searched by maker and glass.
        return glass_name(f"{maker}/{stem}" if maker.upper() in MAKERS else name), ""
    except GlassError as error:
        said = str(error)
    if stated is not None and stated[1]:
        makers = [each for each in MAKERS if each in catalogues] or ["SCHOTT"]
        _, nearest = near_glasses(stated[0], (stated[0] - 1.0) / stated[1], makers)[0]
        said += f"; nearest to its nd and Vd is {glass_in_words(nearest)}, {_apart(nearest, stated)}"
    if unknown := [each for each in catalogues if each not in MAKERS]:
        said += f"; lfmesh does not have the file's {_counted('catalogue', unknown)}"
    raise GlassError(f"{said}; {_remedy(name)}")


def _remedy(name: str, glass: str = "GLASS") -> str:
    return f"give --glass {name}={glass} or camera.lens.substitutes"


def _counted(noun: str, names: list[str]) -> str:
    return f"{noun}{'s' if len(names) > 1 else ''} {', '.join(names)}"


def _fits(glass: str, stated: Stated | None) -> bool:
    """Tell whether a file's n_d agrees with a glass."""
    lines = line_indices(glass)
    return stated is not None and lines is not None and abs(lines[1] - stated[0]) <= OTHER_GLASS


def _off(glass: str, other: str) -> float:
    """Return the largest index difference of two catalogue glasses at F, d and C."""
    pair = line_indices(glass), line_indices(other)
    if pair[0] is None or pair[1] is None:
        return math.inf
    return max(abs(a - b) for a, b in zip(pair[0], pair[1], strict=True))


def _apart(glass: str, stated: Stated) -> str:
    """Describe the index of a catalogue glass relative to the one given by the file's n_d and Abbe number."""
    lines = line_indices(glass)
    assert lines is not None
    if stated[1]:
        with suppress(SceneError, GlassError):
            normal = OwnGlass(nd=stated[0], vd=stated[1])
            f, d, c = (
                here - normal.index_at(line)
                for here, line in zip(lines, (F_LINE_NM, D_LINE_NM, C_LINE_NM), strict=True)
            )
            return f"whose index differs by {f:+.5f} at F, {d:+.5f} at d and {c:+.5f} at C (F, C: of a normal glass)"
    return f"whose index differs by {lines[1] - stated[0]:+.5f} at d"


def formula_glass(formula: str, coefficients: list[float]) -> tuple[Medium, str]:
    """Return a glass from one of CODE V's dispersion formulas, λ in µm, and a note on it.

    "LAU", "GML" (Laurent): n² = a₀ + a₁ λ² + a₂ λ⁻² + a₃ λ⁻⁴ + a₄ λ⁻⁶ + a₅ λ⁻⁸; "GMS", "SLM" (Sellmeier): n² = 1 + Σ b
    λ² / (λ² − c), pairs of b and c; "CAU" (Cauchy): n = a₀ + a₁ λ⁻² + a₂ λ⁻⁴ + ...; "HAR" (Hartmann): n = a₀ + a₁ / (λ
    − a₂).

    Parameters
    ----------
    formula : str
    coefficients : list of float

    Raises
    ------
    GlassError
        The formula is unknown, has another number of coefficients, or gives no valid index.
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
    # Only the order of Laurent's coefficients was verified in the manual.
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
"""Allowed numbers of coefficients of each formula, and its function."""

MOST_STEP = 0.01
"""Largest step of the index in 5 nm without a pole; glasses change by a tenth of it."""


def unlike(name: str, index_d: float) -> str:
    """Return a note if a file's nd differs from that of the glass it names, else an empty text."""
    try:
        known = refractive_index(name, D_LINE_NM)
    except GlassError:
        return ""
    if abs(known - index_d) <= UNLIKE:
        return ""
    return f"the file gives nd = {index_d:.6g}, the catalogue {known:.6g}, which is taken"


def model_glass(index_d: float, abbe: float, wavelengths_nm: list[float]) -> Medium:
    """Return a glass given only by nd and Vd.

    Parameters
    ----------
    index_d, abbe : float
        nd and Vd; a Vd of 0 means no dispersion.
    wavelengths_nm : list of float
        Wavelengths that the file uses.

    Raises
    ------
    GlassError
        No such glass exists, or nd and Vd do not determine its index at one of the wavelengths.
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
    """Return a glass tabulated in a file; a constant index if it has no dispersion.

    Raises
    ------
    GlassError
        The table is invalid.
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
