"""Make the pictures of the warnings' pages: a scene that warns, beside the same scene with the page's remedy.

    .venv/bin/python tools/make_warnings.py [NAME ...]

NAME is a warning, such as HeavyPathsWarning; omitted: all that have a picture. A scene that does not warn, or a remedy
that warns as well, ends with an error.
"""

import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import lfmesh as lf
from lfmesh.files.colour import srgb_encode, to_display
from lfmesh.files.preview import white_point
from lfmesh.lightfield.views.upright import Upright

PICTURES = Path(__file__).resolve().parent.parent / "assets" / "pictures"

SIDE_PX, GAP_PX = 360, 8
"""Side of each of the two pictures, and the space between them."""

SHOWN_PX = 120
"""Largest side of the part of a picture that is shown."""

Pair = tuple[lf.Scene, lf.Scene]


def base(**changes: Any) -> lf.Scene:
    """Return the conventional camera before bracket and chart, with few pixels."""
    few = {"camera.sensor.pixels": [120, 120], "camera.sensor.pixel_mm": 0.0667, "transport.split": "transmit"}
    return lf.load(lf.asset_path("scenes/conventional.toml")).changed({**few, **changes})


def black_picture() -> Pair:
    """Return the scene without and with its lamp."""
    return base(lights=()), base()


def hidden_scene() -> Pair:
    """Return the scene with a closed sphere around the camera, and without."""
    scene = base()
    sphere = lf.Target(name="sphere", shape=lf.Sphere(radius_mm=200.0), position_mm=(0.0, 0.0, 0.0))
    return scene.changed({"targets": (*scene.targets, sphere)}), scene


def few_samples() -> Pair:
    """Return the scene with few samples and with many."""
    scene = base(**{"transport.samples": 4, "transport.replicates": 2})
    return scene, scene.changed({"transport.samples": 256, "transport.replicates": 8})


def heavy_paths() -> Pair:
    """Return a lamp close to a wall beside the chart, by samples from the sensor and from the lamp."""
    lamp = lf.PointLight(position_mm=(58.5, 0.0, -580.0), power_w=1.0)
    wall = lf.Target(
        name="wall", shape=lf.Plane(width_mm=60.0, height_mm=94.0), position_mm=(60.0, 0.0, -570.0),
        rotation_deg=(0.0, -90.0, 0.0),
    )  # fmt: skip
    scene = base()
    near = scene.changed({"lights": (lamp,), "targets": (*scene.targets, wall), "transport.samples": 16})
    return near, near.changed({"transport.method": "forward", "transport.samples": 64})


def missed_light() -> Pair:
    """Return a second lamp in view, which is not seen, and a target that emits as much."""
    place, radius, power = (15.0, 10.0, -520.0), 6.0, 2e-3
    scene = base()
    lamp = lf.DiskLight(position_mm=place, direction=(0.0, 0.0, 1.0), radius_mm=radius, power_w=power)
    area_m2 = np.pi * radius**2 * 1e-6
    paint = lf.Material(reflectance=0.0, radiance_w_m2_sr=power / (np.pi * area_m2), sides="front")
    glowing = lf.Target(name="lamp", shape=lf.Disk(radius_mm=radius), position_mm=place, material=paint)
    return scene.changed({"lights": (*scene.lights, lamp)}), scene.changed({"targets": (*scene.targets, glowing)})


def cut_paths() -> Pair:
    """Return thick fog, with paths that are cut after few events or after many."""
    fog = lf.Medium(bounds=lf.Sphere(radius_mm=60.0), position_mm=(0.0, 0.0, -520.0), scattering_per_mm=0.05)
    scene = base(**{"media": (fog,), "transport.max_events": 12})
    return scene, scene.changed({"transport.max_events": 512})


def diffraction() -> Pair:
    """Return lenslets of 14 µm without and with diffraction."""
    scene = lf.load(lf.asset_path("scenes/diffraction.toml")).changed({"transport.diffraction": "none"})
    return scene, scene.changed({"transport.diffraction": "lenslets"})


def cut_out(picture: np.ndarray) -> np.ndarray:
    """Return the middle of a picture, small enough to show single pixels."""
    top, left = (max(0, (side - SHOWN_PX) // 2) for side in picture.shape[:2])
    return picture[top : top + SHOWN_PX, left : left + SHOWN_PX]


PAIRS: dict[str, Callable[[], Pair]] = {
    "BlackPictureWarning": black_picture,
    "HiddenSceneWarning": hidden_scene,
    "TooFewSamplesWarning": few_samples,
    "HeavyPathsWarning": heavy_paths,
    "MissedLightWarning": missed_light,
    "CutPathsWarning": cut_paths,
    "DiffractionWarning": diffraction,
}


def main(names: list[str]) -> int:
    """Write the pictures of the named warnings, or of all."""
    for name in names or PAIRS:
        write(name, *PAIRS[name]())
    return 0


def write(name: str, doubtful: lf.Scene, mended: lf.Scene) -> None:
    """Render both scenes, and write them side by side with the exposure of the second.

    Parameters
    ----------
    name : str
        Warning that the first scene must have, and the second must not.
    doubtful, mended : Scene
    """
    images = []
    for scene in (doubtful, mended):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", lf.PictureWarning)
            image = lf.render(scene)
        kinds = {type(warning).__name__ for warning in image.warnings}
        print(f"{name}: {sorted(kinds)}, {image.seconds:.0f} s", flush=True)
        if (name in kinds) != (scene is doubtful):
            raise SystemExit(f"tools/make_warnings.py: {name}: the scene has the warnings {sorted(kinds)}")
        images.append(image)
    lights = [
        cut_out(to_display(Upright.of(image.scene).picture(image.mean), image.wavelengths_nm)) for image in images
    ]
    white = white_point(lights[1])
    sheet = Image.new("RGB", (2 * SIDE_PX + GAP_PX, SIDE_PX), "white")
    for number, light in enumerate(lights):
        shown = Image.fromarray(srgb_encode(light / white)).convert("RGB")
        sheet.paste(shown.resize((SIDE_PX, SIDE_PX), Image.Resampling.NEAREST), (number * (SIDE_PX + GAP_PX), 0))
    sheet.quantize(64, dither=Image.Dither.NONE).save(PICTURES / f"{name}.png", optimize=True)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
