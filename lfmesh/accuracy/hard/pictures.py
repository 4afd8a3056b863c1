"""Whole images with light that is hard to aim at, or with errors that are hard to state."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from lfmesh.accuracy.hard.outcome import Outcome, case, images_of, of_images, same_light, surfaces_of
from lfmesh.assets import asset_path
from lfmesh.scene import Camera, Lens, Refractor, Scene, Sensor, Target, load
from lfmesh.scene.objects.shapes import Plane, Sphere
from lfmesh.scene.objects.targets import Material

ROOM_MM, HOLE_MM, KELVIN = 120.0, 0.6, 1700.0
"""Sides of a room and of the hole in its front wall, and the room's temperature."""


def _sheet(
    at: tuple[float, float, float], size: tuple[float, float], turned: tuple[float, float, float] = (0.0, 0.0, 0.0),
    **material: Any,
) -> Target:  # fmt: skip
    return Target(
        shape=Plane(width_mm=size[0], height_mm=size[1]), position_mm=at, rotation_deg=turned,
        material=Material(**material),
    )  # fmt: skip


@case
def pixels_wider_than_lenslets_views() -> Outcome:
    """Aim through lenslets 1.5 pixels wide at f/5.45, where a pixel also sees lenslets off its centre's chief ray."""
    white = _sheet((0.0, 0.0, -500.0), (40.0, 40.0), reflectance=0.0, radiance_w_m2_sr=1.0)
    scene = load(asset_path("scenes/first_light.toml")).changed(
        {
            "camera.mla.count": (8, 8), "camera.sensor.pixels": (12, 12), "camera.sensor.pixel_mm": 0.125 / 1.5,
            "camera.lens.stop_semi_diameter_mm": 3.5, "targets": (white,), "lights": (), "transport.split": "transmit",
        }
    )  # fmt: skip
    adjoint = images_of(scene, range(8), samples=512)
    return same_light(adjoint, images_of(scene, range(8), method="forward", samples=4096), 5e-3)


@case
def room_of_one_temperature() -> Outcome:
    """Look into a room at one temperature, with balls of rough silver and gloss, and see a black body."""
    half, near = 0.5 * ROOM_MM, -0.1
    hot: dict[str, Any] = {"temperature_k": KELVIN}
    black = hot | {"reflectance": 0.0}
    middle, aside = near - half, 0.5 * (half + 0.5 * HOLE_MM)
    walls = [_sheet((0.0, 0.0, near - ROOM_MM), (ROOM_MM, ROOM_MM), **black)]
    for side in (-1.0, 1.0):
        walls += [
            _sheet((side * half, 0.0, middle), (ROOM_MM, ROOM_MM), (0.0, 90.0, 0.0), **black),
            _sheet((0.0, side * half, middle), (ROOM_MM, ROOM_MM), (90.0, 0.0, 0.0), **black),
            # The front wall, around the hole for the camera.
            _sheet((side * aside, 0.0, near), (half - 0.5 * HOLE_MM, ROOM_MM), **black),
            _sheet((0.0, side * aside, near), (HOLE_MM, half - 0.5 * HOLE_MM), **black),
        ]
    gloss: list[dict[str, Any]] = [
        {"gloss": {"metal": "Ag", "roughness": 0.3}},
        {"reflectance": 0.5, "gloss": {"index": 1.6, "roughness": 0.3}},
    ]
    balls = [
        Target(
            shape=Sphere(radius_mm=20.0), position_mm=(side * 22.0, 0.0, -70.0),
            material=Material.model_validate(hot | made),
        )
        for side, made in zip((-1.0, 1.0), gloss, strict=True)
    ]  # fmt: skip
    lens: dict[str, Any] = {"paraxial": True, "focal_length_mm": 50.0, "semi_diameter_mm": 0.2, "stop": True}
    band: dict[str, Any] = {"name": "R", "center_nm": 650.0, "fwhm_nm": 0.02}
    camera: dict[str, Any] = {
        "focus_mm": 100.0, "lens": {"surfaces": [lens]},
        "sensor": {"pixels": (2, 2), "pixel_mm": 55.0, "bands": [band]},
    }  # fmt: skip
    empty = Scene(camera=Camera.model_validate(camera), targets=tuple(walls)).changed({"transport.split": "transmit"})
    furnished = empty.changed({"targets": (*walls, *balls)})
    # The light of the empty room comes straight from its walls, without scattering.
    return same_light(images_of(furnished, range(8), samples=2048), images_of(empty, range(8), samples=2048), 2e-3)


def _small_camera(pixels: int, pixel_mm: float) -> Camera:
    surfaces = surfaces_of(((0.8, 0.08, 1.5), (-0.8, 0.0, 1.0)), aperture=0.08)
    return Camera(
        focus_mm=60.0, lens=Lens(surfaces=tuple(surfaces)), sensor=Sensor(pixels=(pixels, pixels), pixel_mm=pixel_mm)
    )


@case
def wall_behind_a_block() -> Outcome:
    """Aim light from a matt wall at a lens of 0.16 mm through a glass block of 20 mm, forward from the lamp."""
    block = Target(refractor=Refractor(box_mm=(20.0, 20.0, 20.0), index=1.5), position_mm=(0.0, 0.0, -50.0))
    wall = _sheet((0.0, 0.0, -80.0), (16.0, 16.0), reflectance=0.8)
    lamp: dict[str, Any] = {"kind": "point", "position_mm": (45.0, 0.0, -45.0), "power_w": 1.0}
    scene = Scene(camera=_small_camera(4, 0.03), targets=(wall, block)).changed({"lights": [lamp]})
    adjoint = images_of(scene, range(6), samples=128, replicates=16)
    return same_light(images_of(scene, range(6), method="forward", samples=4096, replicates=16), adjoint, 0.02)


@case
def sums_of_a_red_band() -> Outcome:
    """Add up the pixels of a red matt plane under D65 in bands; pixels must not share wavelengths."""
    seeds, low, high = 40, 0.75, 1.35
    red = {"wavelengths_nm": [380.0, 580.0, 620.0, 780.0], "values": [0.05, 0.05, 0.8, 0.8]}
    plane = _sheet((0.0, 0.0, -60.0), (20.0, 20.0), reflectance=red)
    sun = {"kind": "directional", "direction": (0.1, 0.1, -1.0), "irradiance_w_m2": 1.0, "spectrum": "D65"}
    scene = Scene(camera=_small_camera(12, 0.02), targets=(plane,)).changed(
        {"camera.sensor.bands": "xyz", "lights": [sun], "transport.split": "transmit"}
    )
    images = images_of(scene, range(seeds), samples=64, replicates=8)
    scatter = np.array([image.mean.sum(axis=(0, 1)) for image in images]).var(axis=0, ddof=1)
    stated = np.mean([np.square(image.stderr).sum(axis=(0, 1)) for image in images], axis=0)
    ratio = float(np.sqrt((scatter / stated).mean()))
    return of_images(
        images, f"sums scatter by {low:g} to {high:g} of what the pixels' errors say", f"by {ratio:.2f} of it",
        low < ratio < high,
    )  # fmt: skip


@case
def caustic_of_a_ball() -> Outcome:
    """Bound pixels of a caustic that meet a second lamp by every path and the caustic by few."""
    seeds, promised, brightest = 24, 0.93, 0.2
    with tempfile.TemporaryDirectory(prefix="lfmesh-") as folder:
        trimesh.creation.icosphere(3, 1.0).export(Path(folder) / "ball.stl")
        glass = Refractor(file="ball.stl", units="mm", index=1.5)
        lens = surfaces_of(((20.0, 3.0, 1.5), (-20.0, 0.0, 1.0)), aperture=2.0)
        lamp: dict[str, Any] = {"kind": "point", "position_mm": (20.0, -15.0, -25.0), "power_w": 1.0}
        # Each sample meets its light, but hardly any meets the caustic, which lies in the shadow of the ball.
        other = lamp | {"position_mm": (-20.0, 15.0, -25.0), "power_w": 0.1}
        scene = Scene(
            camera=Camera(
                focus_mm=60.0, lens=Lens(surfaces=tuple(lens)), sensor=Sensor(pixels=(12, 12), pixel_mm=0.05)
            ),
            targets=(
                _sheet((0.0, 0.0, -60.0), (8.0, 8.0), reflectance=0.8),
                Target(refractor=glass, position_mm=(2.0, -1.5, -57.0)),
            ),
        ).in_folder(Path(folder)).changed({"lights": [lamp, other], "transport.split": "transmit"})  # fmt: skip
        images = images_of(scene, range(seeds), samples=16, replicates=8)
        longer = images_of(scene, range(100, 103), samples=512, replicates=8)
    truth = np.mean([image.mean for image in longer], axis=0)
    lit = truth >= np.quantile(truth, 1.0 - brightest)
    held = float(np.mean([(image.upper >= truth)[lit] for image in images]))
    least = promised - 4.0 * float(np.sqrt(promised * (1.0 - promised) / (seeds * lit.sum())))
    return of_images(
        [*images, *longer], f"upper holds in {promised:.0%} of the brightest fifth, {least:.0%} by chance",
        f"in {held:.1%}", held > least,
    )  # fmt: skip
