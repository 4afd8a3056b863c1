"""Openings that are hard to find: tiny stops, and lenses seen through steep lenslets."""

import numpy as np

from lfmesh.accuracy.hard.outcome import SINGLET, Outcome, case, lens_scene
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.scene import MicrolensArray, Scene, Surface
from lfmesh.transport.aims.fitting import ALLOWED
from lfmesh.transport.aims.pupil import opening_from
from lfmesh.transport.build import build

SENSOR_MM = 45.0
"""Distance of the sensor behind the lens, near its focus."""


def _behind_stop(radius: float) -> list[Surface]:
    """Return the singlet with a stop of a given radius 5 mm behind it."""
    front, back = SINGLET
    return [
        front.model_copy(update={"stop": False}),
        back.model_copy(update={"thickness_mm": 5.0}),
        Surface(stop=True, semi_diameter_mm=radius),
    ]


def _proof(scene: Scene) -> Outcome:
    proof = build(scene).aim_proof
    assert proof is not None
    return Outcome(
        "",
        f"rays from the stop find at most {ALLOWED:.0e} of the light outside the aim",
        f"{proof.missed:.1e} of {proof.rays} rays' throughput",
        proof.holds,
        0.0,
        0.0,
        0,
    )


def _pinhole(radius: float) -> Outcome:
    scene = lens_scene(_behind_stop(radius), sensor_mm=20.0, distance=SENSOR_MM)
    world = build(scene)
    report = solved_camera(scene).facts
    z = scene.camera.lens.vertices_mm[-1] + SENSOR_MM
    found = opening_from(world.aim.exit.opening, (0.0, 0.0, z))[2]
    # The exit pupil is the stop itself; project it from the sensor's centre to the lens's last plane.
    plane = world.aim.exit.opening.plane_z
    true = 0.5 * report.exit_pupil_diameter_mm * (z - plane) / (z - report.exit_pupil_z_mm)
    outcome = _proof(scene)
    return Outcome(
        "",
        f"{outcome.expected}, and an opening {true:.4g} mm in radius, at most 5 % more",
        f"{outcome.got}; {found:.4g} mm",
        outcome.passed and true <= found <= 1.05 * true,
        outcome.lost_energy,
        outcome.emitted,
        0,
    )


@case
def stop_of_20_um() -> Outcome:
    """Stop a lens down to f/1200, a radius of 20 µm."""
    return _pinhole(0.02)


@case
def stop_of_10_nm() -> Outcome:
    """Stop a lens down to a radius of 10 nm, a millionth of its full radius."""
    return _pinhole(1e-5)


def _steep_lenslets(side: str, share: float, index: float) -> Outcome:
    """Aim at a wide lens through lenslets with a radius of 1/share times their corners' distance."""
    corner = 0.1 / np.sqrt(2.0)
    mla = MicrolensArray(
        layout="square", count=(60, 60), pitch_mm=0.1, radius_mm=(float(corner / share),), index=index,
        thickness_mm=float(1.05 * corner), curved_side="lens" if side == "lens" else "sensor", distance_mm=SENSOR_MM,
    )  # fmt: skip
    return _proof(lens_scene(SINGLET, mla=mla, sensor_mm=6.0, distance=0.1))


@case
def hemispheres_to_the_lens() -> Outcome:
    """Aim at a lens of f/2.4 through high-index lenslets, within 1 % of hemispheres, towards the lens."""
    return _steep_lenslets("lens", 0.99, 1.9)


@case
def hemispheres_to_the_sensor() -> Outcome:
    """Aim at a lens of f/2.4 through lenslets, within 1 % of hemispheres, towards the sensor."""
    return _steep_lenslets("sensor", 0.99, 1.5)
