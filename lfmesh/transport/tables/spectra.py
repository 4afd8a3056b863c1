"""Spectra of targets and lights at the lines of a scene."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.scene import Scene
from lfmesh.scene.light.spectra import Spectrum, curve_of, planck_curve
from lfmesh.transport.tables.lines import Lines

Array = NDArray[np.float64]


def reflectance_at(scene: Scene, number: int, wavelengths_nm: tuple[float, ...]) -> Array:
    """Return the reflectance of a target at some wavelengths, (wavelengths,).

    Parameters
    ----------
    scene : Scene
    number : int
        Of the target.
    wavelengths_nm : (wavelengths,) tuple of float

    Raises
    ------
    SceneError, FileError
        It is not known at a wavelength, or exceeds 1.
    """
    where = f"targets[{number}].material.reflectance"
    reach_nm = min(wavelengths_nm), max(wavelengths_nm)
    curve = curve_of(scene.targets[number].material.reflectance, reach_nm, scene, where)
    if curve.values.max() > 1.0:
        at = curve.wavelengths_nm[curve.values.argmax()]
        raise SceneError(f"{where}: value {curve.values.max():g} at {at:g} nm: a reflectance must lie between 0 and 1")
    return curve.at(wavelengths_nm)


def radiance_at(scene: Scene, number: int, lines: Lines) -> Array:
    """Return the radiance of a target for each line, (lines,), W/(m² sr).

    For a target with a temperature it is the black body's radiance, before its emissivity.

    Parameters
    ----------
    scene : Scene
    number : int
        Of the target.
    lines : Lines

    Raises
    ------
    SceneError, FileError
        A spectrum does not cover the scene's wavelengths, or its file cannot be used.
    """
    material, where = scene.targets[number].material, f"targets[{number}].material"
    if material.temperature_k is not None:
        black = planck_curve(material.temperature_k, scene.reach_nm)
        return np.asarray(lines.mean(black) * lines.weight_nm)
    return emission_at(scene, material.radiance_w_m2_sr, material.spectrum, lines, where, "radiance_w_m2_sr")


def emission_at(
    scene: Scene, value: float | Spectrum, shape: Spectrum | None, lines: Lines, where: str, key: str
) -> Array:
    """Return the emission for each line, (lines,), in the unit of the emission.

    Parameters
    ----------
    scene : Scene
    value : float or Spectrum
        A number is the emission at each wavelength or, with bands, over their whole range; a spectrum is per nm.
    shape : Spectrum or None
        Spectrum of a number spread over the bands; None: constant.
    lines : Lines
    where, key : str
        Place in the scene, and key of `value` there, for messages.

    Raises
    ------
    SceneError, FileError
        As in `spread` and `curve_of`.
    """
    if not isinstance(value, Spectrum):
        return spread(scene, value, shape, lines, f"{where}.spectrum")
    curve = curve_of(value, scene.reach_nm, scene, f"{where}.{key}")
    return np.asarray(lines.mean(curve) * lines.weight_nm)


def spread(scene: Scene, total: float, shape: Spectrum | None, lines: Lines, where: str) -> Array:
    """Return the share of a power with a given spectrum for each line, (lines,), in the unit of the power.

    Parameters
    ----------
    scene : Scene
    total : float
    shape : Spectrum or None
        None: constant.
    lines : Lines
    where : str
        Place in the scene, for messages.

    Raises
    ------
    SceneError, FileError
        The spectrum does not cover the scene's wavelengths or is 0 at all of them, or its file cannot be used.
    """
    if shape is None or lines.span_nm is None:
        return lines.power(total)
    curve = curve_of(shape, lines.span_nm, scene, where)
    if not curve.integral(*lines.span_nm) > 0.0:
        first, last = lines.span_nm
        raise SceneError(f"{where}: it has no power from {first:g} to {last:g} nm, the range of the bands")
    return lines.power(total, curve)
