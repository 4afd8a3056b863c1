"""Phase functions of a scene at its wavelengths."""

from typing import assert_never

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import SceneError
from lfmesh.optics.mie import MieSphere, mie_sphere
from lfmesh.optics.phase import PhaseFunction, henyey_greenstein, isotropic, rayleigh, read_phase
from lfmesh.scene import Scene
from lfmesh.scene.media.phase import (
    HenyeyGreensteinPhase,
    IsotropicPhase,
    MiePhase,
    Phase,
    RayleighPhase,
    TabulatedPhase,
)

Array = NDArray[np.float64]


def sphere_of(phase: MiePhase, wavelength_nm: float, where: str, surrounding: float = 1.0) -> MieSphere:
    """Return the scattering properties of a phase function's spheres.

    Parameters
    ----------
    phase : MiePhase
    wavelength_nm : float, nm
    where : str
        Place in the scene, for messages.
    surrounding : float
        Refractive index around the spheres, unless the phase function gives it.

    Raises
    ------
    SceneError
        The spheres are too large, or have the index of their surroundings.
    """
    index = complex(phase.index, phase.extinction)
    round_them = phase.surrounding_index if phase.surrounding_index is not None else float(surrounding)
    if index == round_them:
        raise SceneError(
            f"{where}.index = {phase.index:g}: equals the index of the surroundings, so the spheres scatter nothing"
        )
    try:
        return mie_sphere(phase.diameter_um, index, wavelength_nm, round_them, phase.sigma)
    except ValueError as error:
        raise SceneError(f"{where}.diameter_um = {phase.diameter_um:g}: {error}") from None


def cross_sections_um2(
    phase: Phase, wavelengths_nm: tuple[float, ...], where: str, surrounding: ArrayLike = 1.0
) -> Array | None:
    """Return the scattering cross sections of spheres, (wavelengths,) µm².

    None if the phase function gives no size.

    Parameters
    ----------
    phase : Phase
    wavelengths_nm, where, surrounding
        As for `phase_functions`.

    Raises
    ------
    SceneError
        As in `sphere_of`.
    """
    if not isinstance(phase, MiePhase):
        return None
    indices = np.broadcast_to(surrounding, len(wavelengths_nm)).tolist()
    pairs = zip(wavelengths_nm, indices, strict=True)
    return np.array([sphere_of(phase, wavelength, where, index).scattering_um2 for wavelength, index in pairs])


def phase_functions(
    phase: Phase, wavelengths_nm: tuple[float, ...], scene: Scene, where: str, surrounding: ArrayLike = 1.0
) -> tuple[PhaseFunction, ...]:
    """Return a phase function at some wavelengths.

    Parameters
    ----------
    phase : Phase
    wavelengths_nm : (wavelengths,) tuple of float
    scene : Scene
    where : str
        Place in the scene, for messages.
    surrounding : float or (wavelengths,) float64
        Refractive index around the scatterers, unless the phase function gives it.

    Raises
    ------
    SceneError, FileError
        As in `sphere_of`, or a file cannot be used.
    """
    match phase:
        case MiePhase():
            indices = np.broadcast_to(surrounding, len(wavelengths_nm)).tolist()
            pairs = zip(wavelengths_nm, indices, strict=True)
            return tuple(sphere_of(phase, wavelength, where, index).phase for wavelength, index in pairs)
        case HenyeyGreensteinPhase(g=g):
            function = henyey_greenstein(g)
        case RayleighPhase():
            function = rayleigh()
        case TabulatedPhase(file=file):
            function = read_phase(scene.resolve(file))
        case IsotropicPhase():
            function = isotropic()
        case _:
            assert_never(phase)
    return (function,) * len(wavelengths_nm)
