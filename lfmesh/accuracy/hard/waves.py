"""Limits of wave optics: lenses as small as their Fresnel zones, and paths exact to a fraction of a wave."""

import math

import numpy as np

from lfmesh.accuracy.hard.outcome import Outcome, case
from lfmesh.scene import Camera, Lens, Scene, Sensor, Surface, Transport
from lfmesh.transport.build import build
from lfmesh.waves.between import BETWEEN
from lfmesh.waves.particles import particle_film
from lfmesh.waves.point_spread import point_spread
from lfmesh.waves.wavefront import wavefront

NM = 550.0

FOCAL_MM, FAR_MM, PIXEL_MM = 2.5, 1e5, 0.0005

ALLOWED_LIGHT = 0.003
"""Relative difference of the light on the axis from the closed form: the tolerance of a point spread."""

ALLOWED_WAVES = 1e-7
"""Path difference of a lens without aberrations: rounding of paths of forty million waves."""


def _outcome(expected: str, got: str, passed: bool) -> Outcome:
    return Outcome("", expected, got, passed, 0.0, 1.0, 0)


@case
def lens_of_fresnel_number_one() -> Outcome:
    """Focus light with a lens of one Fresnel zone, which is brightest far in front of its focus."""
    semi = math.sqrt(NM * 1e-6 * FOCAL_MM)
    focal = 1.0 / (1.0 / FOCAL_MM + 1.0 / FAR_MM)
    lens = Surface(paraxial=True, focal_length_mm=focal, semi_diameter_mm=semi, stop=True)
    places = np.array([0.6, 1.0])
    light = []
    for place in places:
        sensor = Sensor(pixels=(9, 9), pixel_mm=PIXEL_MM, distance_mm=place * FOCAL_MM)
        scene = Scene(
            camera=Camera(lens=Lens(surfaces=(lens,)), sensor=sensor), transport=Transport(wavelengths_nm=(NM,))
        )
        light.append(point_spread(scene, (0.0, 0.0, -FAR_MM)).mean[4, 4])
    # For a round aperture with N zones (Y. Li, E. Wolf, Optics Communications 39, 1981, 211).
    truth = (np.sinc(0.5 * (1.0 / places - 1.0)) / places) ** 2
    return _outcome(
        f"{truth[0]:.4f} of the focal point's light at 0.6 of its distance", f"{light[0] / light[1]:.4f}",
        abs(light[0] / light[1] / truth[0] - 1.0) < ALLOWED_LIGHT,
    )  # fmt: skip


@case
def hyperboloid_of_f_0_6_before_a_plane_wave() -> Outcome:
    """Compare the paths through a perfect lens of f/0.6 and 12 m to a fraction of a wave."""
    focal, index, across = 12_000.0, 1.5, 10_000.0
    faces = (
        Surface(thickness_mm=8_000.0, index=index, semi_diameter_mm=across, stop=True),
        Surface(radius_mm=-(index - 1.0) * focal, conic=-index * index, semi_diameter_mm=across),
    )
    camera = Camera(focus_mm=math.inf, lens=Lens(surfaces=faces), sensor=Sensor(pixels=(4, 4), pixel_mm=1.0))
    found = wavefront(Scene(camera=camera), wavelength_nm=NM)
    return _outcome(
        "no path difference", f"{found.pv_waves:.1e} waves from peak to valley", found.pv_waves < ALLOWED_WAVES
    )


@case
def particles_in_a_row_through_focus() -> Outcome:
    """Interpolate point spreads along a depth over which defocus grows to many waves."""
    lens = Surface(paraxial=True, focal_length_mm=1.0 / (1.0 / 50.0 + 1.0 / 2000.0), semi_diameter_mm=2.0, stop=True)
    row = {"kind": "box", "size_mm": (1e-6, 1e-6, 300.0)}
    scene = Scene(
        camera=Camera(lens=Lens(surfaces=(lens,)), sensor=Sensor(pixels=(40, 40), pixel_mm=0.01, distance_mm=50.0)),
        particles=({"count": 40, "bounds": row, "position_mm": (0.0, 0.0, -2000.0), "intensity_w_sr": 1.0},),
        transport=Transport(wavelengths_nm=(NM,), diffraction="stop", split="transmit"),
    )
    world = build(scene)
    own = np.sum([point_spread(scene, point).mean for point in world.particles[0].points], axis=0)
    off = np.abs(particle_film(world).power[:, :, 0] - own).sum() / own.sum()
    return _outcome(f"within {BETWEEN:g} of their own spreads", f"{off:.2g}", bool(off < BETWEEN))
