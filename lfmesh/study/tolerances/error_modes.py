"""Ready-made studies: installation errors, manufacturing errors, sensor position, and effort of the transport.

Each is made for a scene, scaled by its pixels and lenslets, and is written as a file to edit.
"""

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomlkit

from lfmesh.errors import LfmeshError
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.scene import Lens, Scene
from lfmesh.scene.model import nearest
from lfmesh.scene.toml import in_line
from lfmesh.study.sweeps.axes import Axis

STEPS = (-1.0, -0.5, 0.5, 1.0)
"""Values of an error, as multiples of its largest; with the reference there are five."""

TILT_DEG = 0.1
ELEMENT_TILT_DEG = 0.05
ELEMENT_SHIFT_MM = 0.02
SPACING_MM = 0.02

PITCH_ERROR = 1e-3
RADIUS_ERROR = 0.04

RMS_STEPS = (0.25, 0.5, 0.75, 1.0)

DIGITS = 6
"""Digits of the values written."""

AXES = "xyz"

QUICK_REPLICATES = 4
SAMPLES_TIMES_SIDE, MOST_SAMPLES = 5120, 128
"""Samples per pixel times the root of the number of pixels: with common random numbers, these few tell cameras apart.
For the first scene's camera with 320 × 320 pixels, PSNR resolves the errors at 6 standard errors or more."""
IMAGE_PATH = {"transport.split": "transmit"}
"""Reflections take most of the time, and say little about positions."""


@dataclass(frozen=True)
class Ready:
    """Ready-made part of a study.

    Attributes
    ----------
    axes : tuple of Axis
    changes : dict
        Values at every point, by path.
    metrics : tuple of str
    """

    axes: tuple[Axis, ...]
    changes: dict[str, Any] = field(default_factory=dict)
    metrics: tuple[str, ...] = ("psnr", "ncc", "ssim", "light", "centres")


def assembly(scene: Scene) -> Ready:
    """Return the installation errors of array, sensor, lens elements and stop."""
    axes = [*_poses("camera.sensor", scene.camera.sensor.pixel_mm)]
    if scene.camera.mla is not None:
        axes = [*_poses("camera.mla", scene.camera.sensor.pixel_mm), *axes]
    metrics = Ready(()).metrics if scene.camera.mla is not None else ("psnr", "ncc", "ssim", "light")
    lens = scene.camera.lens
    elements = [list(element.surfaces) for element in lens.elements] or _elements(lens)
    for number, surfaces in enumerate(elements):
        stop = all(lens.is_pure_stop(i) for i in surfaces)
        name = "stop" if stop else f"lens surfaces {surfaces[0]} to {surfaces[-1]}"
        place = f"camera.lens.elements[{number}].pose"
        axes.append(_axis(f"{place}.shift_mm[0]", ELEMENT_SHIFT_MM, f"{name}: decentre / mm"))
        if not stop:
            axes.append(_axis(f"{place}.tilt_deg[0]", ELEMENT_TILT_DEG, f"{name}: tilt / deg"))
    for i in range(len(lens.surfaces) - 1):
        if not lens.has_glass_behind(i):
            space = "air" if lens.surfaces[i].medium is None else "medium"
            label = f"{space} after lens surface {i} / mm"
            axes.append(_axis(f"camera.lens.surfaces[{i}].thickness_mm", SPACING_MM, label))
    changes = {} if lens.elements else {"camera.lens.elements": [{"surfaces": surfaces} for surfaces in elements]}
    return Ready(tuple(axes), {**_quick(scene), **IMAGE_PATH, **changes}, metrics)


def manufacturing(scene: Scene) -> Ready:
    """Return the manufacturing errors of the array, both systematic and random between lenslets."""
    mla = scene.camera.mla
    if mla is None:
        raise LfmeshError('template = "manufacturing": its errors need a microlens array, but the camera has none')
    form, is_curved = "camera.mla.form", mla.focal_length_mm is not None or any(map(math.isfinite, mla.radii_mm))
    axes = [
        _axis(f"{form}.pitch_error", PITCH_ERROR, "pitch error"),
        _rms(f"{form}.decenter_mm", scene.camera.sensor.pixel_mm, "lenslet decentre, rms / mm"),
        *([_rms(f"{form}.radius_error", RADIUS_ERROR, "lenslet radius error, rms")] if is_curved else []),
        *(
            _axis(f"camera.mla.radius_mm[{i}]", RADIUS_ERROR * abs(radius), "lenslet radius, all / mm")
            for i, radius in enumerate(mla.radius_mm or ())
            if math.isfinite(radius)
        ),
        _axis("camera.mla.thickness_mm", 0.02 * mla.thickness_mm, "plate thickness / mm"),
    ]
    if mla.back is not None and mla.has_back:
        radius = mla.back.radius_mm
        shift = min(scene.camera.sensor.pixel_mm, 0.2 * mla.pitch_mm)
        if math.isfinite(radius):
            axes.append(_axis("camera.mla.back.radius_mm", RADIUS_ERROR * abs(radius), "radius, other face / mm"))
        # The cells of a gradient-index plate lie opposite each other.
        axes += [
            _axis(f"camera.mla.back.decenter_mm[{i}]", shift, f"other face, shift {name} / mm")
            for i, name in enumerate("xy" if mla.gradient is None else "")
        ]
    return Ready(tuple(axes), {**_quick(scene), **IMAGE_PATH})


def sensor(scene: Scene) -> Ready:
    """Return the errors of the sensor's position, and its reflectance."""
    axes = [
        *_poses("camera.sensor", scene.camera.sensor.pixel_mm),
        _rms("camera.sensor.reflectance", 0.4, "reflectance"),
    ]
    metrics = Ready(()).metrics if scene.camera.mla is not None else ("psnr", "ncc", "light")
    return Ready(tuple(axes), _quick(scene), metrics)


def packets_and_splits(scene: Scene) -> Ready:
    """Return the transport settings that determine error and time: packets, splits, weight window, method."""
    replicates = scene.transport.replicates
    axes = (
        Axis(path="transport.samples", values=tuple(replicates * n for n in (1, 2, 4, 8)), label="samples per pixel"),
        Axis(path="transport.split", values=("both", "roulette", "transmit"), label="children followed"),
        Axis(path="transport.weight_cutoff", values=(0.01, 0.03, 0.1, 0.3, 1.0), label="weight window"),
        Axis(path="transport.method", values=("adjoint", "forward"), label="method"),
    )
    return Ready(axes, metrics=("noise", "efficiency", "light"))


TEMPLATES: dict[str, Callable[[Scene], Ready]] = {
    "assembly": assembly,
    "manufacturing": manufacturing,
    "packets-and-splits": packets_and_splits,
    "sensor": sensor,
}


def template_text(name: str, scene: Scene, path: Path, folder: Path) -> str:
    """Return a study file with the ready-made axes for a scene, to be edited.

    Parameters
    ----------
    name : str
        Name in `TEMPLATES`.
    scene : Scene
    path : Path
        File of the scene.
    folder : Path
        Future folder of the study file.

    Raises
    ------
    LfmeshError
        There is no such template, or it does not fit the scene.
    """
    if name not in TEMPLATES:
        raise LfmeshError(f"unknown template {name!r}{nearest(name, TEMPLATES)}; valid are {', '.join(TEMPLATES)}")
    ready = TEMPLATES[name](solved_camera(scene).scene)
    document = tomlkit.document()
    document.add(tomlkit.comment(f"{ABOUT[name]}, each by itself around the camera of {path.name}."))
    document.add(tomlkit.comment("Edit the values; lfmesh study --dry-run estimates the time."))
    document.add("scene", os.path.relpath(str(path), str(folder)))
    document.add("metrics", list(ready.metrics))
    document.add("design", "one_at_a_time")
    document.add("paired", True)
    changes = tomlkit.table()
    for key, value in ready.changes.items():
        changes.add(key, in_line(value))
    if ready.changes:
        document.add("changes", changes)
    axes = tomlkit.aot()
    for axis in ready.axes:
        block = tomlkit.table()
        block.add("label", axis.label or axis.path)
        block.add("path", axis.path)
        block.add("values", list(axis.values or ()))
        if axis.relative:
            block.add("relative", True)
        axes.append(block)
    document.add("axes", axes)
    return tomlkit.dumps(document)


ABOUT = {
    "assembly": "Installation errors of array, sensor, lens elements and stop",
    "manufacturing": "Manufacturing errors of the microlens array",
    "packets-and-splits": "Packets, splits, weight window and method against noise and time",
    "sensor": "Errors of the sensor's position, and its reflectance",
}
"""Title of each template."""


def _quick(scene: Scene) -> dict[str, Any]:
    """Return the samples needed to resolve small errors of a camera: more for fewer pixels."""
    columns, rows = scene.camera.sensor.pixels
    each = math.ceil(SAMPLES_TIMES_SIDE / math.sqrt(columns * rows) / QUICK_REPLICATES)
    samples = min(QUICK_REPLICATES * each, MOST_SAMPLES)
    return {"transport.samples": samples, "transport.replicates": QUICK_REPLICATES}


def _poses(body: str, pixel_mm: float) -> list[Axis]:
    """Return the six pose errors of a rigid body: tilts, rotation, decentres, distance."""
    name = "array" if body.endswith("mla") else "sensor"
    tilts = [
        _axis(
            f"{body}.pose.tilt_deg[{i}]", TILT_DEG, f"{name}: {'rotation' if i == 2 else 'tilt'} about {AXES[i]} / deg"
        )
        for i in range(3)
    ]
    shifts = [
        _axis(
            f"{body}.pose.shift_mm[{i}]", pixel_mm, f"{name}: {'distance' if i == 2 else 'decentre'} in {AXES[i]} / mm"
        )
        for i in range(3)
    ]
    return [*tilts, *shifts]


def _axis(path: str, largest: float, label: str) -> Axis:
    return Axis(path=path, values=_steps(largest, STEPS), relative=True, label=label)


def _rms(path: str, largest: float, label: str) -> Axis:
    return Axis(path=path, values=_steps(largest, RMS_STEPS), label=label)


def _steps(largest: float, steps: tuple[float, ...]) -> tuple[float, ...]:
    """Return the values of an error as a person would write them: 0.3, not 0.30000000000000004."""
    return tuple(float(f"{step * largest:.{DIGITS}g}") for step in steps)


def _elements(lens: Lens) -> list[list[int]]:
    """Return the surfaces of each element, cemented ones together and the stop alone."""
    groups: list[list[int]] = []
    inside = False
    for number in range(len(lens.surfaces)):
        if inside:
            groups[-1].append(number)
        else:
            groups.append([number])
        inside = lens.has_glass_behind(number)
    return groups
