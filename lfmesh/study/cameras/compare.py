"""One scene, three cameras: conventional, standard plenoptic (1.0) and focused plenoptic (2.0).

    lfmesh compare scene.toml -o comparison/

The cameras share lens, sensor and samples. Each images the scene, a slanted edge at several distances, a grid of points
and a white plane. Resolution, depth of field and light are measured on these pictures.
"""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import FileError, LfmeshError, PictureWarning, collected, summed_up, warn_caller
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.lightfield.calibration.white import white_scene
from lfmesh.lightfield.photographs.refocus import refocus
from lfmesh.lightfield.rays.ray_model import RayModel
from lfmesh.lightfield.views.decode import decode
from lfmesh.lightfield.views.focused import focused
from lfmesh.lightfield.views.patches import patch_px, render_patches
from lfmesh.lightfield.views.upright import Upright
from lfmesh.scene import FirstOrder, Scene
from lfmesh.study.cameras.comparison import CameraResult, Comparison, Focus
from lfmesh.study.metrics.resolution import edge_mtf50, point_width
from lfmesh.transport.render.image import Image
from lfmesh.waves.render import render

Array = NDArray[np.float64]

CONVENTIONAL, STANDARD, FOCUSED = "conventional", "plenoptic 1.0", "plenoptic 2.0"

STEPS = 13
"""Number of edge distances across the standard camera's refocus range; denser near the focus, where the conventional
camera's sharpness falls off within a few millimetres."""

REACH = 0.9
"""Fraction of that range, to either side, covered by the edge distances."""

EDGE_DEG = 5.0

POINTS = (-0.3, 0.0, 0.3)
"""Positions of the points along both axes, as fractions of the field of view."""

POINT_SAMPLES = 2
LIT = 0.1
"""Fraction of the brightest pixel above which a pixel counts as lit."""


class _Camera:
    """One of the three cameras, and its conversion of raw images to pictures."""

    def __init__(self, name: str, scene: Scene, array_height_mm: float) -> None:
        self.name, self.scene = name, scene
        self.warned: dict[str, tuple[PictureWarning, ...]] = {}
        self.white = self.rendered("white plane", white_scene(measuring(scene)))
        # A conventional picture is as high as the sensor, the others as high as the array.
        self.heights = array_height_mm / scene.camera.sensor.size_mm[1] if scene.camera.mla is None else 1.0

    def rendered(self, what: str, scene: Scene) -> Image:
        """Render a scene, and keep the image's warnings by subject."""
        with collected():
            image = render(scene)
        self.warned[f"{self.name}, {what}"] = image.warnings
        return image

    def taken(self, what: str, targets: list[dict[str, Any]], **transport: Any) -> Image:
        """Render other targets in place of the scene's."""
        scene = measuring(self.scene).changed({"targets": targets})
        return self.rendered(what, scene.changed({f"transport.{name}": value for name, value in transport.items()}))

    def picture(self, image: Image, distance_mm: float) -> tuple[Array, float]:
        """Return the upright picture, (t, s), focused on a plane, and its sample size there in mm."""
        white = self.white if image.wavelengths_nm == self.white.wavelengths_nm else None
        if self.name == CONVENTIONAL:
            light = image.mean if white is None else image.mean / np.maximum(white.mean, np.finfo(float).tiny)
            pixel = self.scene.camera.sensor.pixel_mm
            picture = Upright.of(self.scene).picture(light).mean(axis=2)
            return picture, pixel / abs(solved_camera(self.scene).report.magnification)
        if self.name == STANDARD:
            photograph = refocus(decode(image, white=white), distance_mm)
        else:
            photograph = render_patches(image, distance_mm, white=white)
        return photograph.mean.mean(axis=2), photograph.sample_mm


def measuring(scene: Scene) -> Scene:
    """Return a camera's scene with the transport for measurements: one wavelength, no reflections."""
    values = {"transport.split": "transmit", "transport.method": "adjoint"}
    return scene.camera_alone(values).at_line(scene.primary_nm)


def three_cameras(scene: Scene, reduction: float = 3.0) -> dict[str, Scene]:
    """Return the scene with a conventional, its own and a focused plenoptic camera.

    Raises
    ------
    LfmeshError
        The scene's camera is conventional, or cannot become a focused plenoptic one.
    """
    scene = solved_camera(scene).scene
    if scene.camera.mla is None:
        raise LfmeshError(
            "camera.mla is missing: give the scene of a plenoptic camera; its array is taken out to compare"
        )
    distance = solved_camera(scene).report.object_distance_mm
    conventional = scene.changed(
        {
            "camera.mla": None,
            "camera.focus_mm": distance,
            "camera.focus_from": "first_vertex",
            "camera.sensor.distance_mm": None,
        }
    )
    return {CONVENTIONAL: solved_camera(conventional).scene, STANDARD: scene, FOCUSED: focused(scene, reduction)}


def compare(
    scene: Scene, *, reduction: float = 3.0, steps: int = STEPS, progress: Callable[[str], None] | None = None
) -> Comparison:
    """Render a scene with three cameras, and measure their performance.

    Parameters
    ----------
    scene : Scene
        A standard plenoptic camera, focused at a finite distance.
    reduction : float
        Reduction a/b of the focused plenoptic camera.
    steps : int
        Number of edge distances; odd, so that one of them is the plane in focus.
    progress : callable, optional
        Called with a description of the current step.

    Warns
    -----
    PictureWarning
        Some pictures are or may be wrong: one warning per class, see `Comparison.warnings`.

    Raises
    ------
    LfmeshError
        As `three_cameras`, or too few steps.
    """
    if steps < 3 or steps % 2 == 0:
        raise LfmeshError(f"steps = {steps}: must be an odd number, 3 or more")
    say = progress or (lambda _: None)
    scenes = three_cameras(scene, reduction)
    standard = scenes[STANDARD]
    model, focus = RayModel.of(standard), solved_camera(standard).report.object_distance_mm
    if not 0.0 < focus < math.inf:
        raise LfmeshError(f"the camera is focused on {focus:g} mm; to compare, focus on a finite distance")
    distances = [_in_front(model, REACH * share**3) for share in np.linspace(1.0, -1.0, steps)]
    height = standard.camera.mla.size_mm[1] if standard.camera.mla is not None else math.nan
    results, pictures = [], []
    warned: dict[str, tuple[PictureWarning, ...]] = {}
    for name, of in scenes.items():
        say(f"{name}: white plane and scene")
        camera = _Camera(name, of, height)
        pictures.append(camera.picture(camera.rendered("scene", of), focus)[0])
        edges = []
        for distance in distances:
            say(f"{name}: edge at {distance:.4g} mm")
            edges.append(_edge(camera, distance, focus))
        say(f"{name}: points")
        results.append(_result(camera, edges, focus, standard))
        warned |= camera.warned
    samples = standard.transport.samples_each * standard.transport.replicates
    told = summed_up(warned, len(warned), "pictures")
    warn_caller(told)
    return Comparison(focus, samples, tuple(results), tuple(pictures), told)


def _in_front(model: RayModel, share: float) -> float:
    """Return the distance for a shift by a fraction of a lenslet; at most 1 km, which stands for infinity."""
    distance = model.distance_mm(share * model.lenslet_pitch_mm)
    return distance if 0.0 < distance < 1e6 else 1e6


def edge_plane(report: FirstOrder, distance_mm: float, focus_mm: float | None = None) -> dict[str, Any]:
    """Return the target of a bright half-plane with a slightly slanted edge through the axis.

    Parameters
    ----------
    report : FirstOrder
        First-order report; the plane fills the field.
    distance_mm : float
        Distance of the plane.
    focus_mm : float, optional
        Distance of the report's field of view. Default: the camera's plane in focus.
    """
    focus = report.object_distance_mm if focus_mm is None else focus_mm
    width = 4.0 * max(report.field_of_view_mm) * max(1.0, distance_mm / focus)
    turn = math.radians(EDGE_DEG)
    return {
        "shape": {"kind": "plane", "width_mm": width, "height_mm": width},
        "position_mm": (0.5 * width * math.cos(turn), 0.5 * width * math.sin(turn), -distance_mm),
        "rotation_deg": (0.0, 0.0, EDGE_DEG),
        "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
    }


def _edge(camera: _Camera, distance_mm: float, focus_mm: float) -> Focus:
    """Measure a bright half-plane with its edge through the axis."""
    plane = edge_plane(solved_camera(camera.scene).report, distance_mm, focus_mm)
    image = camera.taken(f"edge at {distance_mm:.4g} mm", [plane])
    as_taken = _sharpness(camera, image, focus_mm)
    refocused = math.nan if camera.name == CONVENTIONAL else _sharpness(camera, image, distance_mm)
    return Focus(distance_mm, as_taken, refocused)


def _sharpness(camera: _Camera, image: Image, distance_mm: float) -> float:
    """Return the MTF50 of an edge in line pairs per picture height; NaN without a picture."""
    try:
        picture, _ = camera.picture(image, distance_mm)
    except LfmeshError:
        # The patches are wider than micro-images: the camera cannot focus there.
        return math.nan
    height, width = picture.shape
    # Long enough for the edge to cross lenslets at every phase: it is sharper between two lenslets than on one.
    middle = picture[height // 10 : height - height // 10, width // 4 : width - width // 4]
    return edge_mtf50(middle) * height * camera.heights


def _result(camera: _Camera, edges: list[Focus], focus_mm: float, standard: Scene) -> CameraResult:
    places, picture, sample = _points(camera, focus_mm, standard)
    height, width = picture.shape
    reach = 0.1 * height
    widths = [
        # Rows of an upright picture run downwards, opposite to y.
        sample * point_width(picture, (0.5 * (height - 1) - y / sample, 0.5 * (width - 1) + x / sample), reach)
        for x, y in places
    ]
    at_focus = min(edges, key=lambda edge: abs(edge.distance_mm - focus_mm))
    light = camera.white.mean[..., 0]
    conventional = camera.name == CONVENTIONAL
    taken, beyond_taken = sharp_range([(e.distance_mm, e.as_taken) for e in edges], focus_mm)
    after, beyond_after = taken, beyond_taken
    if not conventional:
        after, beyond_after = sharp_range([(e.distance_mm, e.refocused) for e in edges], focus_mm)
    return CameraResult(
        name=camera.name,
        picture_samples=(width, height),
        mtf50_lp_per_height=at_focus.as_taken,
        point_width_mm=float(np.mean(widths)),
        worst_point_width_mm=float(np.max(widths)),
        views_across=_views_across(camera, focus_mm),
        depth_of_field_mm=taken,
        refocus_range_mm=after,
        light_w_per_pixel=float(light.mean()),
        lit_share=float((light > LIT * np.percentile(light, 99.0)).mean()),
        edges=tuple(edges),
        unknown_beyond_mm={"depth_of_field_mm": beyond_taken, "refocus_range_mm": beyond_after},
    )


def _points(camera: _Camera, focus_mm: float, standard: Scene) -> tuple[list[tuple[float, float]], Array, float]:
    """Return a grid of points in the plane in focus, its picture, and the sample size there, mm."""
    facts = solved_camera(standard).report
    width, height = facts.field_of_view_mm
    places = [(x * width, y * height) for y in POINTS for x in POINTS]
    radius = 0.1 * facts.object_sampling_mm
    targets = [
        {
            "shape": {"kind": "disk", "radius_mm": radius},
            "position_mm": (x, y, -focus_mm),
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
        }
        for x, y in places
    ]
    # Trace from the points to the sensor: in the other direction hardly any ray would hit one.
    replicates = camera.scene.transport.replicates
    image = camera.taken("points", targets, method="forward", samples=POINT_SAMPLES * replicates)
    return places, *camera.picture(image, focus_mm)


def _views_across(camera: _Camera, focus_mm: float) -> float:
    if camera.name == CONVENTIONAL:
        return 1.0
    wide = solved_camera(camera.scene).report.micro_image_diameter_px or math.nan
    return wide / (patch_px(camera.scene, focus_mm) if camera.name == FOCUSED else 1.0)


def sharp_range(
    curve: list[tuple[float, float]], focus_mm: float
) -> tuple[tuple[float, float], tuple[float, ...]]:  # fmt: skip
    """Return the distances between which a curve stays above half of its value at the plane in focus.

    Parameters
    ----------
    curve : list of (float, float)
        Distances, mm, and sharpness; NaN: unknown.
    focus_mm : float

    Returns
    -------
    ends : (float, float)
        Nearest and farthest distance, mm; NaN if the sharpness at the plane in focus is unknown.
    unknown_beyond : tuple of float
        Ends beyond which sharpness is unknown or was not measured: the range may extend farther.
    """
    curve = sorted(curve)
    vergence = np.array([1.0 / distance for distance, _ in curve])
    value = np.array([v for _, v in curve])
    focus = int(np.abs(vergence - 1.0 / focus_mm).argmin())
    half = 0.5 * value[focus]
    if not half > 0.0:
        return (math.nan, math.nan), ()
    ends, open_ends = [], []
    for step in (-1, 1):
        i = focus
        while 0 <= i + step < len(value) and value[i + step] >= half:
            i += step
        j = i + step
        is_reached = 0 <= j < len(value) and value[j] < half
        share = (value[i] - half) / (value[i] - value[j]) if is_reached else 0.0
        ends.append(float(1.0 / (vergence[i] + share * (vergence[j if is_reached else i] - vergence[i]))))
        open_ends += [] if is_reached else ends[-1:]
    return (ends[0], ends[1]), tuple(open_ends)


def write(comparison: Comparison, folder: Path) -> list[Path]:
    """Write numbers (JSON) and figure (PNG) into a folder, created if necessary; return the files.

    Raises
    ------
    FileError
        The folder cannot be written.
    """
    numbers, figure = folder / "comparison.json", folder / "comparison.png"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _write(comparison, numbers, figure)
    except OSError as error:
        raise FileError(f"{folder}: cannot be written: {error.strerror}") from None
    return [numbers, figure]


def _write(comparison: Comparison, numbers: Path, figure: Path) -> None:
    # Drawing libraries are imported here, so that studies do not load them.
    from lfmesh.study.cameras.compare_figure import draw

    numbers.write_text(json.dumps(comparison.as_dict(), indent=2, allow_nan=False) + "\n", encoding="utf-8")
    draw(comparison, figure)
