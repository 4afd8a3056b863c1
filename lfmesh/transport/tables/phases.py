"""Phase functions of a scene at its wavelengths."""

from lfmesh.errors import SceneError
from lfmesh.optics.mie import MieSphere, mie_sphere
from lfmesh.optics.phase import PhaseFunction, henyey_greenstein, isotropic, rayleigh, read_phase
from lfmesh.scene import Scene
from lfmesh.scene.phase import HenyeyGreensteinPhase, MiePhase, Phase, RayleighPhase, TabulatedPhase


def sphere_of(phase: MiePhase, wavelength_nm: float, where: str) -> MieSphere:
    """Return what the spheres of a phase function do to light.

    Parameters
    ----------
    phase : MiePhase
    wavelength_nm : float, nm
    where : str
        Place of the phase function in the scene, for messages.

    Raises
    ------
    SceneError
        The spheres are too large.
    """
    index = complex(phase.index, phase.extinction)
    try:
        return mie_sphere(phase.diameter_um, index, wavelength_nm, phase.surrounding_index, phase.sigma)
    except ValueError as error:
        raise SceneError(f"{where}.diameter_um = {phase.diameter_um:g}: {error}") from None


def phase_functions(
    phase: Phase, wavelengths_nm: tuple[float, ...], scene: Scene, where: str
) -> tuple[PhaseFunction, ...]:
    """Return a phase function at some wavelengths.

    Parameters
    ----------
    phase : Phase
    wavelengths_nm : (wavelengths,) tuple of float
    scene : Scene
    where : str
        Its place in the scene, for messages.

    Raises
    ------
    SceneError, FileError
        Spheres are too large, or a file cannot be used.
    """
    match phase:
        case MiePhase():
            return tuple(sphere_of(phase, wavelength, where).phase for wavelength in wavelengths_nm)
        case HenyeyGreensteinPhase(g=g):
            function = henyey_greenstein(g)
        case RayleighPhase():
            function = rayleigh()
        case TabulatedPhase(file=file):
            function = read_phase(scene.resolve(file))
        case _:
            function = isotropic()
    return (function,) * len(wavelengths_nm)
