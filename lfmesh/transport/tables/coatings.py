"""Coatings of a scene, tabulated once for each pair of media, coating and set of wavelengths."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.optics.coatings import Stack, between, beyond
from lfmesh.optics.glass import Medium, refractive_index
from lfmesh.optics.reflectance_table import ReflectanceTable, read_reflectance
from lfmesh.optics.share_table import ALLOWED_MEASURED, ShareTable, TooManyPiecesError, constant, tabulated
from lfmesh.scene import Coating, Layer, Scene
from lfmesh.scene.inputs import file_stamp

Array = NDArray[np.float64]

RESONANT = 256
"""Least number of pieces if a layer's index is below both media's. Light may then resonate between such layers, within
an angle so small that few points would miss it."""

KEPT = 256


@dataclass(frozen=True)
class CoatingTable:
    """Shares of a coating between two media at some wavelengths, for kernels.

    Attributes
    ----------
    values : (rows, wavelengths) float64
        Coefficients of all quantities, see `optics.share_table`.
    pieces : int
    absorbs : bool
    error : float
        Largest absolute error of interpolation found.
    """

    values: Array
    pieces: int
    absorbs: bool
    error: float


def absorbs(scene: Scene, name: str, wavelengths_nm: Sequence[float]) -> bool:
    """Tell whether a coating of the scene absorbs light at any of the wavelengths.

    Parameters
    ----------
    scene : Scene
    name : str
    wavelengths_nm : sequence of float
    """
    return _absorbs(scene.all_coatings[name], wavelengths_nm)


def _absorbs(coating: Coating, wavelengths_nm: Sequence[float]) -> bool:
    return any(stack_of(coating.layers or (), wavelength).absorbs for wavelength in wavelengths_nm)


def coating_table(
    scene: Scene, name: str, outer: Medium, inner: Medium, wavelengths_nm: Sequence[float]
) -> CoatingTable:
    """Return the shares of a coating between two media.

    Parameters
    ----------
    scene : Scene
    name : str
    outer, inner : Medium
        Media on the side of its first layer, and on the other side.
    wavelengths_nm : sequence of float

    Raises
    ------
    SceneError, FileError
        Its file cannot be used or does not cover a wavelength, or it cannot be tabulated.
    """
    coating = scene.all_coatings[name]
    path = scene.resolve(coating.table) if coating.table is not None else None
    stamp = file_stamp(path) if path is not None else ()
    return _tabulated(name, coating, path, stamp, outer, inner, tuple(float(w) for w in wavelengths_nm))


@lru_cache(maxsize=KEPT)
def _tabulated(
    name: str, coating: Coating, path: Path | None, stamp: tuple[object, ...], outer: Medium, inner: Medium,
    wavelengths_nm: tuple[float, ...],
) -> CoatingTable:  # fmt: skip
    """Return the table of a coating; `stamp` only identifies the version of its file."""
    measured = read_reflectance(path) if path is not None else None
    if (rows := coating.measured) is not None:
        measured = ReflectanceTable.of(rows.wavelengths_nm, rows.angles_deg, rows.reflectance)
    lossy = _absorbs(coating, wavelengths_nm)
    tables: list[ShareTable] = []
    try:
        # All wavelengths have as many pieces as the most demanding one.
        while not tables or len({table.pieces for table in tables}) > 1:
            least = max((table.pieces for table in tables), default=1)
            tables = [
                _at_wavelength(name, coating, measured, lossy, least, outer, inner, wavelength)
                for wavelength in wavelengths_nm
            ]
    except TooManyPiecesError as error:
        if measured is not None:
            raise SceneError(
                f"coatings.{name}.{coating.kind}: its reflectance changes too fast between angles to be interpolated "
                f"(error {error.args[0]:.1g}, limit {ALLOWED_MEASURED:g}); smooth it, or give fewer angles"
            ) from None
        raise SceneError(
            f"coatings.{name}: its reflectance changes too fast with the angle for a table (error "
            f"{error.args[0]:.1g}): {_size(coating)}. Give fewer or thinner layers, none of a lower index than both "
            "glasses that light resonates between, and between equal glasses none of nearly their index"
        ) from None
    values = np.stack([table.coefficients.ravel() for table in tables], axis=1)
    values.setflags(write=False)
    return CoatingTable(values, tables[0].pieces, lossy, max(table.error for table in tables))


def _size(coating: Coating) -> str:
    """Describe the size of a stack."""
    layers = coating.layers or ()
    total_um = sum(layer.thickness_nm for layer in layers) / 1000.0
    return f"it has {len(layers)} layer{'' if len(layers) == 1 else 's'}, {total_um:.4g} µm in all"


def _at_wavelength(
    name: str, coating: Coating, measured: ReflectanceTable | None, lossy: bool, least: int,
    outer: Medium, inner: Medium, wavelength_nm: float,
) -> ShareTable:  # fmt: skip
    if coating.reflectance is not None:
        return constant(coating.reflectance)
    if measured is not None:
        shortest, longest = measured.wavelengths_nm[[0, -1]]
        if not shortest <= wavelength_nm <= longest:
            raise SceneError(
                f"coatings.{name}.{coating.kind}: it extends from {shortest:g} to {longest:g} nm, but the scene has "
                f"{wavelength_nm:g} nm"
            )
        return tabulated(lambda u, total: measured.at(wavelength_nm, u * u)[None], False, least, ALLOWED_MEASURED)
    n_outer, n_inner = refractive_index(outer, wavelength_nm), refractive_index(inner, wavelength_nm)
    stack = stack_of(coating.layers or (), wavelength_nm)
    if n_outer > n_inner:
        stack = stack.reversed
    thin, dense = min(n_outer, n_inner), max(n_outer, n_inner)
    if any(index.real < thin for index in stack.indices):
        least = max(least, RESONANT)

    def shares(u: Array, total: bool) -> Array:
        if total:
            return _under_total_reflection(thin, dense, stack, wavelength_nm, u)[None]
        k_thin = thin * u * u
        k_dense = beyond(thin, dense, k_thin)
        from_thin, passed = between(thin, dense, stack, wavelength_nm, k_thin, k_dense)
        if not lossy:
            return from_thin[None]
        from_dense, _ = between(dense, thin, stack.reversed, wavelength_nm, k_dense.real, k_thin.astype(np.complex128))
        return np.stack([from_thin, from_dense, passed])

    return tabulated(shares, lossy, least)


def _under_total_reflection(thin: float, dense: float, stack: Stack, wavelength_nm: float, u: Array) -> Array:
    """Return the reflectance from the denser medium beyond the critical angle (u: see `optics.share_table`)."""
    edge = np.sqrt((dense - thin) * (dense + thin))
    if edge == 0.0:
        return np.ones_like(u)
    k_dense = edge * 2.0 * u / (1.0 + u * u)
    k_thin = np.asarray(1.0j * edge * (1.0 - u * u) / (1.0 + u * u), dtype=np.complex128)
    return between(dense, thin, stack.reversed, wavelength_nm, k_dense, k_thin)[0]


def stack_of(layers: Sequence[Layer], wavelength_nm: float) -> Stack:
    """Return layers at a wavelength, in the order of the scene.

    Parameters
    ----------
    layers : sequence of Layer
    wavelength_nm : float
    """
    return Stack(
        tuple(layer.index_at(wavelength_nm) for layer in layers), tuple(layer.thickness_nm for layer in layers)
    )
