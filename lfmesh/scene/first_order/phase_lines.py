"""The phases of a camera in words."""

import math

import numpy as np

from lfmesh.scene.camera.lenslet_depth import cell_corner_mm
from lfmesh.scene.camera.mla import MicrolensArray
from lfmesh.scene.camera.phase import Phase
from lfmesh.scene.first_order.phase_turns import phase_gradients
from lfmesh.scene.model import Location
from lfmesh.scene.scene import Scene

RADII, AZIMUTHS = 400, 48
"""Number of distances from the vertex and of directions in which the spacing of a phase is examined."""


def phase_lines(scene: Scene) -> list[str]:
    """Describe the phases of a solved scene, one line each: kind, orders, power, share of the light, least period.

    Power and share are those of the main order at the primary wavelength. The period is that of 2π of phase, within the
    clear aperture or, on the array, the cell.
    """
    lines = []
    for where, phase, before, behind in scene.phases():
        power, in_x = (phase.power_per_mm(scene.primary_nm, section) for section in (False, True))
        shares = dict(phase.orders_of(scene.primary_nm, before, behind))
        said = f"{phase.in_words()}: power {_power_in_words(power)}"
        if in_x != power:
            said += f" in y, {_power_in_words(in_x)} in x"
        said += f", {100.0 * shares[phase.main_order]:.3g} % of the light in order {phase.main_order}"
        period = least_period_mm(scene, where, phase)
        lines_of = f"period from {1e3 * period:.4g} µm" if math.isfinite(period) else "without lines"
        lines.append(f"{_face(where):<34}{said}, {lines_of}")
    return lines


def _face(where: Location) -> str:
    number = where[-2]
    if isinstance(number, int):
        return f"phase of surface {number}"
    return f"phase of the array's {str(where[-1]).removesuffix('_phase')} face"


def _power_in_words(power: float) -> str:
    return f"{power:.5g}/mm (focal length {1.0 / power:.6g} mm)" if power else "0"


def _extent_mm(scene: Scene, where: Location) -> tuple[float, float]:
    """Return the radius of the part of a face that light passes, and its half width along x and y."""
    number, mla = where[-2], scene.camera.mla
    if isinstance(number, int):
        radius = scene.camera.lens.surfaces[number].semi_diameter_mm or math.nan
        return radius, radius
    assert isinstance(mla, MicrolensArray)
    radius = cell_corner_mm(mla.pitch_mm, mla.layout, None)
    if mla.clear_diameter_mm is not None:
        radius = min(radius, 0.5 * mla.clear_diameter_mm)
    return radius, radius if mla.layout == "hexagonal" else 0.5 * mla.pitch_mm


def least_period_mm(scene: Scene, where: Location, phase: Phase) -> float:
    """Return the least distance along which a phase changes by 2π, in mm; inf if it is constant.

    Parameters
    ----------
    scene : Scene
        Solved.
    where : tuple of str and int
        Location of the phase.
    phase : Phase
    """
    radius_mm, half_mm = _extent_mm(scene, where)
    r, azimuth = np.linspace(0.0, radius_mm, RADII + 1), 2.0 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    x, y = (np.clip(np.outer(r, of(azimuth)).ravel(), -half_mm, half_mm) for of in (np.cos, np.sin))
    steepest = float(np.hypot(*phase_gradients(phase, x, y).T).max())
    return 2.0 * math.pi / steepest if steepest else math.inf
