"""Lines of `check` on lamps: angular profiles, spectra, and the share of the light in each band."""

from collections.abc import Iterator
from functools import cache

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.objects.targets import TargetMesh
from lfmesh.optics.light_profile import LightProfile, read_profile
from lfmesh.scene import Light, Scene
from lfmesh.scene.light.spectra import curve_of

Array = NDArray[np.float64]


def lamp_lines(scene: Scene, targets: list[TargetMesh]) -> list[str]:
    """Describe the profiles and spectra of a scene's lamps.

    Parameters
    ----------
    scene : Scene
    targets : list of TargetMesh
        World frame.

    Raises
    ------
    SceneError, FileError
        A profile or spectrum cannot be used.
    """
    lines = []
    read = cache(read_profile)
    for number, light in enumerate(scene.lights):
        where = f"lights[{number}]"
        if light.ies is not None:
            profile = read(scene.resolve(light.ies))
            lines.append(f"{where} profile: {light.ies}, {_in_words(profile, light.strength)}")
            if targets and not _shines_on(profile, light, targets):
                lines.append(
                    f"Note: {where}: its profile sends no light towards the corners or centres of any target's facets"
                )
        if scene.passbands:
            lines.append(f"{where} spectrum: {_spectrum(scene, number)}")
    return lines


def _in_words(profile: LightProfile, power_w: float) -> str:
    """Describe a profile's lit angles and peak, for the power of its lamp and in the units of its file."""
    lit = np.rad2deg(profile.vertical[profile.intensity.any(axis=0)])
    peak = profile.intensity.max()
    at = np.rad2deg(profile.vertical[int(np.argmax(profile.intensity.max(axis=0)))])
    return (
        f"lit from {lit[0]:g} to {lit[-1]:g} degrees, brightest at {at:g}: {peak * power_w:.4g} W/sr of "
        f"{power_w:g} W; in the file {peak * profile.flux_lm:.4g} cd of {profile.flux_lm:.4g} lm"
    )


def _shines_on(profile: LightProfile, light: Light, targets: list[TargetMesh]) -> bool:
    """Return whether a profile shines from a corner of its lamp towards a corner or the middle of any facet.

    The note names these places only; nothing else depends on the result.
    """
    if light.region is None:
        return True
    x, y, down = light.axes
    for target in targets:
        hull = target.hull
        facets = np.concatenate([hull.vertices, hull.vertices[hull.faces].mean(axis=1)])
        points = np.concatenate([facets - corner for corner in light.region.corners_mm])
        far = np.linalg.norm(points, axis=1)
        points = points[far > 0.0] / far[far > 0.0, None]
        if not len(points):
            return True
        theta = np.arccos(np.clip(points @ down, -1.0, 1.0))
        first = profile.horizontal[0]
        phi = (np.arctan2(points @ y, points @ x) - first) % (2.0 * np.pi) + first
        if (profile.at(theta, phi) > 0.0).any():
            return True
    return False


def _spectrum(scene: Scene, number: int) -> str:
    """Return the name of a lamp's spectrum and each band's share of its power over the bands' span."""
    spectrum = scene.lights[number].spectrum
    first, last = scene.reach_nm
    name = "even" if spectrum is None else spectrum.in_words()
    return f"{name}, {first:g} to {last:g} nm; the bands take " + ", ".join(
        f"{band} {100.0 * share:.3g} %" for band, share in _shares(scene, number)
    )


def _shares(scene: Scene, number: int) -> Iterator[tuple[str, float]]:
    """Yield each band's name and the share of a lamp's power that it takes."""
    spectrum = scene.lights[number].spectrum
    first, last = scene.reach_nm
    shape = None if spectrum is None else curve_of(spectrum, scene.reach_nm, scene, f"lights[{number}].spectrum")
    whole = last - first if shape is None else shape.integral(first, last)
    for band in scene.passbands:
        (taken,) = band.response.integrals(np.array(band.response.ends_nm), shape)
        yield band.name, float(taken / whole)
