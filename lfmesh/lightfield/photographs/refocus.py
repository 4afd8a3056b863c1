"""Refocusing: photographs focused on other planes and with other apertures, from one exposure.

The views, shifted back by `RayModel`'s shift of the photograph's plane, are averaged. Every photograph keeps the place
and size of the middle view.
"""

import math
import warnings
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.kernels.decorators import kernel
from lfmesh.lightfield.photographs.fourier_slice import ViewSpectra
from lfmesh.lightfield.photographs.photograph import FocalStack, Photograph
from lfmesh.lightfield.views.field import LightField, Samples
from lfmesh.notebook import Say, announced, silent
from lfmesh.scene.distance import reach_in_words

Array = NDArray[np.float64]
Method = Literal["shift", "fourier"]

LEAST_VIEWS_WIDE = 1.0
"""Radius of the smallest aperture, in views."""

ROUNDING = 1e-9
"""Relative difference below which an f-number counts as the camera's."""


def refocus(
    field: LightField, distance_mm: float, *, f_number: float | None = None, method: Method = "shift"
) -> Photograph:
    """Focus a light field on a plane.

    Parameters
    ----------
    field : LightField
    distance_mm : float
        In front of the first vertex of the lens; may be inf.
    f_number : float, optional
        Image-side f-number, no smaller than the camera's (default: all views).
    method : {"shift", "fourier"}
        "shift" averages the shifted views, interpolated linearly between samples; unknown samples are ignored.
        "fourier" takes a slice of the light field's Fourier transform (R. Ng, "Fourier Slice Photography", SIGGRAPH
        2005): exact without detail finer than a sample, for views continued beyond their borders. Beside samples that
        some views do not know it rings, which the standard error does not cover; use "shift" there.

    Returns
    -------
    Photograph

    Warns
    -----
    UserWarning
        In the plane, views a pixel apart shift by more than a lenslet.

    Raises
    ------
    LfmeshError
        The plane lies behind the front focal point, or these views cannot give the f-number.
    """
    (photograph,) = _photographs(field, [distance_mm], f_number, method)
    return photograph


def focal_stack(
    field: LightField, distances_mm: Sequence[float], *, f_number: float | None = None, method: Method = "shift",
    progress: Say | bool | None = None,
) -> FocalStack:  # fmt: skip
    """Focus a light field on several planes; see `refocus`.

    Parameters
    ----------
    field : LightField
    distances_mm : sequence of float
        Before the first vertex.
    f_number : float, optional
    method : {"shift", "fourier"}
    progress : callable or bool, optional
        Called with the progress in words. True shows it, False nothing. Default: it is shown at a terminal or in a
        notebook after two seconds.

    Returns
    -------
    FocalStack

    Raises
    ------
    LfmeshError
        As from `refocus`, or no plane is given.
    """
    if not len(distances_mm):
        raise LfmeshError("distances_mm is empty: a focal stack needs at least one plane")
    with announced(progress) as say:
        return FocalStack(_photographs(field, distances_mm, f_number, method, say))


def range_warning(field: LightField, distances_mm: Sequence[float]) -> str | None:
    """Name the planes beyond the range of sharp refocusing in a message, or return None."""
    near, far = field.model.refocus_range_mm
    beyond = [distance for distance in distances_mm if not near <= distance <= far]
    if not beyond:
        return None
    which = f"{beyond[0]:g} mm" if len(beyond) == 1 else f"{len(beyond)} planes, {beyond[0]:g} to {beyond[-1]:g} mm,"
    return (
        f"{which} lie{'s' if len(beyond) == 1 else ''} beyond the range of sharp refocusing, "
        f"{reach_in_words(near, far)}: neighbouring views are more than a lenslet apart there, and edges show as echoes"
    )


def _photographs(
    field: LightField, distances_mm: Sequence[float], f_number: float | None, method: Method, say: Say = silent
) -> tuple[Photograph, ...]:
    if method not in ("shift", "fourier"):
        raise LfmeshError(f'method = {method!r}: use "shift" or "fourier"')
    shares = _aperture(field, f_number)
    # Check all planes before the first photograph.
    shifts = [field.model.shift_mm(distance) for distance in distances_mm]
    spectra = ViewSpectra(field, max(map(abs, shifts), default=0.0)) if method == "fourier" else None
    note = range_warning(field, distances_mm)
    if note:
        warnings.warn(note, stacklevel=3)
    photographs: list[Photograph] = []
    for distance, shift in zip(distances_mm, shifts, strict=True):
        say(f"photograph {len(photographs) + 1} of {len(shifts)}")
        mean, stderr, coverage = _shifted_sum(field, shift, shares, sharp=method == "fourier")
        if spectra is not None:
            known = np.isfinite(mean)
            mean = np.where(known, spectra.slice(shift, shares), np.nan)
        sample = abs(field.spacing_mm[1] * field.model.object_scale(distance)) if math.isfinite(distance) else math.inf
        photographs.append(
            Photograph(
                mean, stderr, float(distance), f_number or field.model.f_number, sample,
                field.wavelengths_nm, field.unit, method, coverage,
            )
        )  # fmt: skip
    return tuple(photographs)


def _aperture(field: LightField, f_number: float | None) -> Array:
    """Return the fraction (v, u) of each view that an aperture passes."""
    rows, columns = field.views
    if f_number is None:
        return np.ones((rows, columns))
    step, widest, index = field.model.slope_step, field.model.f_number, field.model.image_index
    narrowest = 0.5 / (index * LEAST_VIEWS_WIDE * step)
    if not widest * (1.0 - ROUNDING) <= f_number <= narrowest:
        raise LfmeshError(
            f"f_number = {f_number:g}: must be from {widest:.6g}, the aperture that the lens recorded, to "
            f"{narrowest:.6g}, an aperture two views wide"
        )
    off_axis = np.hypot(field.v_rad[:, None], field.u_rad[None, :])
    # Views within half a view of the rim count by their part inside.
    return np.clip((0.5 / (index * f_number) - off_axis) / step + 0.5, 0.0, 1.0)


def _shifted_sum(field: LightField, shift_mm: float, shares: Array, *, sharp: bool) -> tuple[Array, Array, Array]:
    """Return mean, standard error and coverage of the views by shift-and-add."""
    shape = field.data.shape[2:]
    mean, stderr, coverage = np.empty(shape), np.empty(shape), np.empty(shape[:2])
    along_t, along_s = (shift_mm / spacing for spacing in field.spacing_mm)
    _shift_and_add(
        field.data, field.stderr, field.sharing, shares, along_t, along_s, sharp, mean, stderr, coverage
    )  # fmt: skip
    return mean, stderr, coverage


@kernel
def _shift_and_add(
    data: Samples, spread: Samples, sharing: Samples, shares: Array, along_t: float, along_s: float, sharp: bool,
    mean: Array, stderr: Array, coverage: Array,
) -> None:  # fmt: skip
    """Average the views, each shifted by given samples per view; unknown samples are ignored.

    Parameters
    ----------
    sharp : bool
        Give the standard error of an interpolation that does not average neighbouring samples.
    """
    rows, columns, height, width, channels = data.shape
    views = shares.sum()
    for t in range(height):
        for s in range(width):
            coverage[t, s] = 1.0
            for c in range(channels):
                total, value, square = 0.0, 0.0, 0.0
                for v in range(rows):
                    for u in range(columns):
                        share = shares[v, u]
                        if share == 0.0:
                            continue
                        # Objects nearer than the focus move against the view.
                        y, x = t - along_t * (v - 0.5 * (rows - 1)), s - along_s * (u - 0.5 * (columns - 1))
                        if not (0.0 <= x <= width - 1.0 and 0.0 <= y <= height - 1.0):
                            continue
                        column, row = min(int(x), max(width - 2, 0)), min(int(y), max(height - 2, 0))
                        fx, fy = x - column, y - row
                        for j in range(2):
                            for i in range(2):
                                weight = share * (fx if i else 1.0 - fx) * (fy if j else 1.0 - fy)
                                if weight == 0.0:
                                    continue
                                sample = float(data[v, u, row + j, column + i, c])
                                if np.isnan(sample):
                                    continue
                                total += weight
                                value += weight * sample
                                power = share * weight if sharp else weight * weight
                                error = float(spread[v, u, row + j, column + i, c])
                                square += power * sharing[row + j, column + i] * error * error
                coverage[t, s] = min(coverage[t, s], total / views)
                mean[t, s, c] = value / total if total > 0.0 else np.nan
                stderr[t, s, c] = np.sqrt(square) / total if total > 0.0 else np.nan
