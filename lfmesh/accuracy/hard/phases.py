"""Phase surfaces: steep metalenses, gratings near their evanescent limit, a phase on a strong asphere."""

import numpy as np

from lfmesh.accuracy.hard.outcome import Outcome, case, disk, lens_scene, on_sensor, outcome, through_lens, tilted
from lfmesh.scene import Surface
from lfmesh.scene.camera.phase import GratingPhase, MetalensPhase, RadialPhase
from lfmesh.transport.build import build
from lfmesh.transport.trace import Status, trace

NM = 587.6
"""Primary wavelength of the scenes."""

FOCAL_MM, INDEX, PLATE_MM, SEMI_MM = 7.0, 1.46, 1.0, 5.0


def _metalens() -> list[Surface]:
    """Return a plate with a metalens of f/0.7 on its back."""
    phase = MetalensPhase(focal_length_mm=FOCAL_MM, design_nm=NM)
    return [
        Surface(thickness_mm=PLATE_MM, index=INDEX, semi_diameter_mm=SEMI_MM, stop=True),
        Surface(semi_diameter_mm=SEMI_MM, phase=phase),
    ]


@case
def metalens_of_f_0_7() -> Outcome:
    """Focus parallel light to a point with a flat metalens of f/0.7."""
    count = 20_000
    o = np.column_stack([disk(0.9999 * SEMI_MM, count), np.full(count, -20.0)])
    paths = trace(
        build(lens_scene(_metalens(), distance=FOCAL_MM, sensor_mm=1.0)), o, np.tile([0.0, 0.0, 1.0], (count, 1)),
        split="transmit",
    )  # fmt: skip
    focus = np.tile([0.0, 0.0, PLATE_MM + FOCAL_MM], (count, 1))
    passed = (4.0 * INDEX / (1.0 + INDEX) ** 2) ** 2
    return on_sensor(paths, focus, np.full(count, passed), 1e-13)


@case
def metalens_up_to_evanescent_light() -> Outcome:
    """Cross a metalens of f/0.7 at up to 50 degrees, where part of the light turns evanescent."""
    d = tilted(20_000, 1.2)
    o = np.column_stack([disk(4.5, 20_000), np.zeros(20_000)]) - 2.0 * d
    # Light that leaves at 84 degrees has its rounding errors multiplied by a thousand.
    return through_lens(lens_scene(_metalens(), distance=3.0), o, d, 1e-10, relative=1e-10)


@case
def grating_at_its_evanescent_limit() -> Outcome:
    """Diffract skew rays to grazing, from 0.1 to 1e-13 below and above the limit in the sine."""
    count, step, turn = 4000, 0.5, np.deg2rad(30.0)
    draw = np.random.default_rng(7)
    below = 10.0 ** draw.uniform(-13.0, -1.0, count)
    propagates = draw.uniform(size=count) < 0.5
    sine = np.where(propagates, 1.0 - below, 1.0 + below)
    azimuth = turn + draw.uniform(-1.0, 1.0, count)
    behind = sine[:, None] * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    across = behind - step * np.array([np.cos(turn), np.sin(turn)])
    d = np.column_stack([across, np.sqrt(1.0 - (across**2).sum(axis=1))])
    grating = GratingPhase(lines_per_mm=step / (NM * 1e-6), direction_deg=30.0)
    scene = lens_scene(
        [
            Surface(thickness_mm=0.1, index=1.5, semi_diameter_mm=5.0, stop=True),
            Surface(semi_diameter_mm=5.0, phase=grating),
        ],
        distance=1.0,
    )
    o = np.column_stack([disk(1.0, count), np.zeros(count)]) - d
    paths = trace(build(scene), o, d, split="transmit")
    arrived = (paths.status == Status.SENSOR) | (np.array(paths.body) == "beside the sensor")
    came, lost = np.zeros(count, dtype=bool), int((paths.status == Status.LOST).sum())
    came[paths.source[arrived]] = True
    wrong = int((came != propagates).sum())
    both = arrived & propagates[paths.source]
    error = np.abs(paths.direction[both][:, :2] - behind[paths.source[both]]).max(initial=0.0)
    return outcome(
        paths,
        f"{int(propagates.sum())} of {count} rays leave, within 2e-15 of their direction along the face",
        f"{int(came.sum())} leave, {wrong} end wrongly, {lost} lost; error {error:.1e}",
        wrong == 0 and lost == 0 and bool(both.sum() > 0.4 * count) and bool(error < 2e-15),
    )


@case
def phase_on_a_strong_asphere() -> Outcome:
    """Turn rays by a radial phase in its second order on an asphere that is inclined by up to 40 degrees."""
    phase = RadialPhase(coefficients_rad=(-700.0, 250.0, -60.0), radius_mm=7.0, order=2)
    surfaces = [
        Surface(
            radius_mm=11.0, conic=-0.8, asphere_mm=(4e-5, 1e-6), thickness_mm=7.0, index=1.6, semi_diameter_mm=7.0,
            stop=True, phase=phase,
        ),
        Surface(radius_mm=-60.0, semi_diameter_mm=10.0),
    ]  # fmt: skip
    d = tilted(5000, 0.3)
    o = np.column_stack([disk(6.99, 5000), np.zeros(5000)]) - 60.0 * d
    return through_lens(lens_scene(surfaces, distance=9.0), o, d, 1e-10, relative=1e-10)
