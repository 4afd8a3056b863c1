"""Glasses given by nd and Vd, by Sellmeier coefficients, by a table, or by name in other air."""

from collections.abc import Iterator, Mapping
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Discriminator, Field, Tag, ValidationInfo, model_validator

from lfmesh.errors import FileError, GlassError
from lfmesh.optics.curve import curve_fault, read_curve
from lfmesh.optics.dispersion import model_index, sellmeier_index, table_index
from lfmesh.optics.glass import C_LINE_NM, D_LINE_NM, F_LINE_NM, glass_in_words, refractive_index
from lfmesh.scene.literals import counted
from lfmesh.scene.media.air import Air
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.quantities import FilePath, GlassName, Index, Number, Positive

MOST_TERMS = 8
"""Maximum number of terms of the Sellmeier formula."""

MOST_ROWS = 2000
"""Maximum number of rows of a table: more than any maker publishes, few enough for one spline."""

CLOSEST_NM = 1e-3
"""Smallest spacing of wavelengths in a table: no maker measures closer, and a spline through closer ones is noise."""

AbbeNumber = Annotated[float, Field(strict=True, gt=0, le=1000)]

_KEYS = "nd with vd, or sellmeier_b with sellmeier_c_um2, or table, or wavelengths_nm with values, or name"


class OwnGlass(Model):
    """A glass by its dispersion: `nd` with `vd`, Sellmeier's coefficients or a table; or by name, in other air."""

    nd: Index | None = None
    """Index at the d line, 587.56 nm; with `vd` it defines a glass of normal dispersion."""
    vd: AbbeNumber | None = None
    """Abbe number (nd − 1) / (nF − nC) (no unit)."""
    sellmeier_b: tuple[Number, ...] | None = None
    """Coefficients of n² = 1 + Σ b λ² / (λ² − c) (no unit)."""
    sellmeier_c_um2: tuple[Number, ...] | None = None
    """Coefficients c of that formula, in µm²."""
    table: FilePath | None = None
    """CSV file with wavelength_nm and n, relative to the file that names it. It is read at once, and `wavelengths_nm`
    and `values` replace it."""
    wavelengths_nm: tuple[Positive, ...] | None = None
    """Wavelengths of a table, increasing, in nm; smooth in between, nothing outside."""
    values: tuple[Number, ...] | None = None
    """Refractive index at each of `wavelengths_nm`."""
    name: GlassName | None = None
    """Name of the glass in the catalogue, for a glass in other air."""
    air: Air | None = None
    """Air that the index is relative to. `camera.air` sets it for all glasses. Omitted: the catalogues' 20 °C and
    101.325 kPa."""

    @property
    def catalogue_name(self) -> str | None:
        """Name in the catalogue, if any."""
        return self.name

    @model_validator(mode="before")
    @classmethod
    def _read_table(cls, data: Any, info: ValidationInfo) -> Any:
        """Replace the file of a table with its contents."""
        file = data.get("table") if isinstance(data, Mapping) else None
        if (
            not isinstance(file, str)
            or "\0" in file
            or any(data.get(key) is not None for key in data if key not in ("table", "air"))
        ):
            return data
        path = (info.context or {}).get("folder", Path()) / file
        try:
            present = path.is_file()
        except OSError:
            # No file can have this name.
            present = False
        if not present:
            # The check of the field reports it.
            return data if (info.context or {}).get("folder") is not None else _refuse(f"no file {file!r}")
        try:
            curve = read_curve(path, "n")
        except FileError as error:
            _refuse(str(error))
        rows = {"wavelengths_nm": curve.wavelengths_nm.tolist(), "values": curve.values.tolist()}
        return rows | {key: value for key, value in data.items() if key == "air"}

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields."""
        kinds = (("nd", "vd"), ("sellmeier_b", "sellmeier_c_um2"), ("table",), ("wavelengths_nm", "values"), ("name",))
        given = [kind for kind in kinds if any(getattr(self, key) is not None for key in kind)]
        if not given:
            yield Fault((), None, f"a glass needs {_KEYS}")
            return
        for kind in given[1:]:
            key = next(key for key in kind if getattr(self, key) is not None)
            yield Fault((key,), getattr(self, key), f"{given[0][0]} is given too; give one of {_KEYS}")
        for key in given[0]:
            if getattr(self, key) is None:
                yield Fault((key,), None, f"missing: a glass needs {_KEYS}")
                return
        if self.sellmeier_b is not None and self.sellmeier_c_um2 is not None:
            yield from self._sellmeier_faults(self.sellmeier_b, self.sellmeier_c_um2)
        if self.wavelengths_nm is not None and self.values is not None:
            if why := curve_fault(self.wavelengths_nm, self.values):
                yield Fault((), None, why)
            elif close := [w for v, w in pairwise(self.wavelengths_nm) if w - v < CLOSEST_NM]:
                yield Fault((), None, f"wavelength {close[0]:g} nm: give wavelengths {CLOSEST_NM:g} nm apart or more")
            elif len(self.values) > MOST_ROWS:
                yield Fault((), None, f"{len(self.values)} values; a glass table has at most {MOST_ROWS}")
            for wavelength, value in zip(self.wavelengths_nm, self.values, strict=False):
                if not 1.0 <= value <= 10.0:
                    yield Fault((), None, f"value {value:g} at {wavelength:g} nm: an index must lie between 1 and 10")
                    break

    def _sellmeier_faults(self, b: tuple[float, ...], c: tuple[float, ...]) -> Iterator[Fault]:
        if not 1 <= len(b) <= MOST_TERMS:
            yield Fault(("sellmeier_b",), None, f"{len(b)} coefficients; give 1 to {MOST_TERMS}, usually 3")
        elif len(b) != len(c):
            given = counted(len(c), "coefficient")
            yield Fault(("sellmeier_c_um2",), None, f"{given}, but {len(b)} in sellmeier_b; give equally many")
        if any(value < 0.0 for value in c):
            yield Fault(("sellmeier_c_um2",), list(c), "squares of wavelengths, in µm², must be 0 or more")

    def index_at(self, wavelength_nm: float) -> float:
        """Return the refractive index at a wavelength, relative to air.

        Parameters
        ----------
        wavelength_nm : float

        Returns
        -------
        float

        Raises
        ------
        GlassError
            The index is unknown at this wavelength.
        """
        return _index(self, float(wavelength_nm))

    def in_words(self) -> str:
        """Describe the glass, with nd and Vd if it covers the visible range.

        Returns
        -------
        str
        """
        where = f" {self.air.in_words()}" if self.air is not None else ""
        if self.name is not None:
            return glass_in_words(self.name) + where
        kind = (
            "glass table"
            if self.values is not None
            else "Sellmeier's formula"
            if self.sellmeier_b is not None
            else "model glass"
        )
        try:
            f, d, c = (_known_index(self, line) for line in (F_LINE_NM, D_LINE_NM, C_LINE_NM))
        except GlassError:
            return kind + where
        numbers = f"nd {d:.5f}, Vd {(d - 1.0) / (f - c):.2f}" if f > c else f"nd {d:.5f}"
        return f"{kind} ({numbers}){where}"


def _refuse(why: str) -> Any:
    raise ValueError(why)


@lru_cache(maxsize=4096)
def _index(glass: OwnGlass, wavelength_nm: float) -> float:
    index = _known_index(glass, wavelength_nm)
    if glass.air is not None:
        index = glass.air.index_of(index, wavelength_nm)
    if not 1.0 <= index <= 10.0:
        raise GlassError(f"glass at {wavelength_nm:g} nm: index {index:g}; it must lie between 1 and 10")
    return index


def _known_index(glass: OwnGlass, wavelength_nm: float) -> float:
    """Return the index relative to the catalogues' air."""
    if glass.name is not None:
        return refractive_index(glass.name, wavelength_nm)
    if glass.nd is not None and glass.vd is not None:
        index = model_index(glass.nd, glass.vd, wavelength_nm)
    elif glass.sellmeier_b is not None:
        index = sellmeier_index(glass.sellmeier_b, glass.sellmeier_c_um2 or (), wavelength_nm)
    else:
        index = table_index(glass.wavelengths_nm or (), glass.values or (), wavelength_nm)
    return index


def _kind(value: Any) -> str:
    return "<own>" if isinstance(value, Mapping | OwnGlass) else "<name>"


def _name_or_table(value: Any) -> Any:
    """Refuse values that are neither a name nor a table."""
    if isinstance(value, str | Mapping | OwnGlass):
        return value
    return _refuse(
        'must be a name, like "SCHOTT/N-BK7", or a table, like { nd = 1.5168, vd = 64.17 }; give a number as index'
    )


Glass = Annotated[
    Annotated[GlassName, Tag("<name>")] | Annotated[OwnGlass, Tag("<own>")],
    Discriminator(_kind),
    BeforeValidator(_name_or_table),
]
"""A glass by catalogue name or by dispersion."""


def with_tables_beside(data: Any, folder: Path) -> Any:
    """Make the paths of glass tables in a lens file start from its folder, in place, and return its tables."""
    surfaces = data.get("surfaces") if isinstance(data, dict) else None
    for surface in surfaces if isinstance(surfaces, list) else ():
        glass = surface.get("glass") if isinstance(surface, dict) else None
        if isinstance(glass, dict) and isinstance(glass.get("table"), str):
            glass["table"] = str(folder.resolve() / glass["table"])
    return data


def in_air(model: Any, air: Air | None, part: str | None = None) -> Any:
    """Return a model with its glass, or that of one of its parts, in the given air.

    A plain `index` and a glass with its own `air` stay.

    Parameters
    ----------
    model : object
        Model with a `glass`, or None.
    air : Air or None
        None leaves the model unchanged.
    part : str, optional
        Field of the model that has the glass.
    """
    if part is not None:
        return model.model_copy(update={part: in_air(getattr(model, part), air)})
    if air is None or model is None or model.glass is None:
        return model
    glass = OwnGlass(name=model.glass) if isinstance(model.glass, str) else model.glass
    return model if glass.air is not None else model.model_copy(update={"glass": glass.model_copy(update={"air": air})})


def out_of_air(model: Any, air: Air | None, part: str | None = None) -> Any:
    """Return a model as it was before `in_air`: with a glass in the given air that names no air itself.

    Parameters
    ----------
    model, air, part
        As for `in_air`.
    """
    if part is not None:
        return model.model_copy(update={part: out_of_air(getattr(model, part), air)})
    glass = None if model is None or air is None else model.glass
    if not isinstance(glass, OwnGlass) or glass.air != air:
        return model
    plain = glass.model_copy(update={"air": None})
    return model.model_copy(update={"glass": plain if glass.name is None else glass.name})
