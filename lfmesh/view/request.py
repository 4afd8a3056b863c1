"""Subject of a view: a scene or run, its rays, and their caption."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
import PIL.Image
from numpy.typing import NDArray

from lfmesh.errors import FileError, LfmeshError
from lfmesh.files import run as runs
from lfmesh.files.folder import recover
from lfmesh.files.preview import displayed
from lfmesh.geometry import frame as frames
from lfmesh.geometry.array.lattice import centre
from lfmesh.lightfield.views.upright import Upright
from lfmesh.scene import Scene, load
from lfmesh.scene.literals import counted
from lfmesh.transport.build import build
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME, WORLD_FRAME, Status
from lfmesh.transport.render.image import Image
from lfmesh.transport.trace import trace
from lfmesh.transport.world import World
from lfmesh.view.rays.launch_line import launch
from lfmesh.view.rays.paths import OF_PATHS, OF_VERTICES, FieldPoints, Rays

Picture = NDArray[np.uint8]

COUNT = 200
"""Default number of rays per launch."""

FIRST_COUNT = 24
"""Rays per point of the first view: few enough to distinguish."""

FIELDS = (0.0, 0.7, 1.0)
"""Field points of the first view, relative to the half field; the last is moved slightly inwards."""

INSIDE = 0.97
"""Fraction of the half field at which the outermost lenslets still show the point."""

FAR = 20.0
"""Object distance of the first view in focal lengths, for a camera focused on infinity."""

BEFORE_MM, BEFORE = 0.01, 1e-5
"""Clearance of the first view's points from lens and targets, and relative to the distance, as launches are written
with six digits."""

MOST_PX = 4096
"""Largest side of the picture on the sensor; larger pictures are reduced."""

NONE = "none"

REFRACTED = "refracted only: no ghosts"
"""Description of rays without reflected children."""


@dataclass(frozen=True)
class Subject:
    """Subject of a view: a world, and the picture (rows, columns, 3) on its sensor in physical orientation."""

    world: World
    picture: Picture | None


def subject_of(what: "Scene | World | Image | str | os.PathLike[str]") -> Subject:
    """Return the subject for a scene file, a run folder, or their Python objects.

    Raises
    ------
    LfmeshError
        It is none of these, or the file cannot be read.
    """
    if isinstance(what, World):
        return Subject(what, None)
    if isinstance(what, Scene):
        return Subject(build(what), None)
    if isinstance(what, Image):
        return Subject(build(what.scene), sensor_picture(what))
    if not isinstance(what, (str, os.PathLike)):
        raise LfmeshError(f"cannot show a {type(what).__name__}: give a scene, a world, an image, or a path to one")
    path = Path(what)
    if path.is_dir():
        return _run(path)
    return Subject(build(load(path)), None)


def _run(folder: Path) -> Subject:
    """Read the scene and preview of a run, but not its large images."""
    recover(folder)
    for name in (runs.SCENE, runs.PREVIEW):
        if not (folder / name).is_file():
            raise FileError(f"{folder}: has no {name}; give a scene file, or a run folder from lfmesh render")
    # Pictures of older runs have the wrong orientation.
    report = runs.report_of(folder)
    try:
        with PIL.Image.open(folder / runs.PREVIEW) as preview:
            picture = _reduced(preview.convert("RGB"))
    except (OSError, ValueError, PIL.Image.DecompressionBombError) as error:
        raise FileError(
            f"{folder / runs.PREVIEW}: cannot be read as a picture ({error}); render the run again"
        ) from None
    # Turn the upright preview back to the sensor's orientation.
    scene = load(folder / runs.SCENE).titled(str(report.get("scene_title", "")))
    return Subject(build(scene), np.ascontiguousarray(Upright.of(scene).picture(picture)))


def sensor_picture(image: Image) -> Picture:
    """Return an image as (rows, columns, 3) sRGB, exposed like its preview, in physical orientation."""
    picture, _ = displayed(image.mean, image.wavelengths_nm, image.stderr)
    return _reduced(PIL.Image.fromarray(picture).convert("RGB"))


def _reduced(picture: PIL.Image.Image) -> Picture:
    factor = -(-max(picture.size) // MOST_PX)
    return np.asarray(picture.reduce(factor) if factor > 1 else picture)


class LaunchOptions(TypedDict, total=False):
    """Settings of a launch, see `launched`; omitted or None: as in the scene."""

    count: int | None
    wavelength_nm: float | None
    split: str | None
    weight_cutoff: float | None


@dataclass(frozen=True)
class Launched:
    """Rays, their description, and the point of the array (x, y in its frame, mm) for a close view."""

    rays: Rays | None
    caption: tuple[str, ...]
    near_mm: tuple[float, float]


def launched(
    world: World, specs: Sequence[str] = (), count: int | None = None, *,
    wavelength_nm: float | None = None, split: str | None = None, weight_cutoff: float | None = None,
) -> Launched:  # fmt: skip
    """Launch rays from one or several lines of text, see `lfmesh.view.rays.launch_line.launch`.

    The default is a first view: refracted rays from three points of the plane of focus. "none": no rays.

    Parameters
    ----------
    world : World
    specs : sequence of str
        Lines such as "field 0,0,-500".
    count : int, optional
        Rays per launch.
    wavelength_nm : float, optional, nm
    split : {"both", "roulette", "transmit"}, optional
    weight_cutoff : float, optional
        Default of these three: as in the scene.
    """
    given = [spec.strip() for spec in specs]
    if NONE in given:
        return Launched(None, (), (0.0, 0.0))
    if not given:
        given = first_look(world)
        split = split or "transmit"
    number = count if count is not None else COUNT if specs else FIRST_COUNT
    parts = [
        launch(world, spec, number, wavelength_nm=wavelength_nm, split=split, weight_cutoff=weight_cutoff)
        for spec in given
    ]
    rays = together(parts)
    split = split or world.scene.transport.split
    how = REFRACTED if split == "transmit" else f"split: {split}"
    words = f"{counted(number, 'ray')}{' each' if len(given) > 1 else ''} from {'; '.join(given)}; {how}"
    dark = [f"{spec}: {why}" for spec, part in zip(given, parts, strict=True) if (why := why_dark(part))]
    return Launched(rays, (words, *dark), pixels_on_array(rays))


def why_dark(rays: Rays) -> str:
    """Return the reason why no ray from field points reaches the lens, or from pixels leaves it; else empty."""
    if rays.from_sensor and not rays.arrives.any():
        return "no ray leaves the camera"
    if rays.field is None or not (rays.status == Status.TARGET).all() or (np.diff(rays.offsets) > 2).any():
        return ""
    names = " and ".join(rays.surfaces[number] for number in np.unique(rays.end))
    return f"no ray reaches the lens, {names} stands in the way"


def first_look(world: World) -> list[str]:
    """Return the launches of the first view, from `first_points`."""
    return ["field " + ",".join(f"{value:.6g}" for value in point) for point in first_points(world)]


def first_points(world: World) -> NDArray[np.float64]:
    """Return points that the lens sees, (3, 3) mm, world frame.

    They lie in the plane of focus on the axis, in the zone and at the edge. If a target blocks a point, the point moves
    to its surface.
    """
    distance = world.facts.object_distance_mm
    half = 0.5 * world.facts.field_of_view_mm[1]
    if not 0.0 < distance < np.inf:
        sensor = world.scene.camera.sensor.size_mm[1]
        distance = FAR * abs(world.facts.efl_mm)
        half = 0.5 * sensor * FAR
    points = [[0.0, -INSIDE * field * half, -distance] for field in FIELDS]
    to_world = world.tables.frames[CAMERA_FRAME, WORLD_FRAME]
    placed = frames.points(to_world, points)
    # Look from in front of the lens for blocking targets.
    front = frames.points(to_world, [[0.0, 0.0, world.tables.lens.box_low[2] - BEFORE_MM]])
    ahead = placed - front
    seen = trace(world, np.repeat(front, len(ahead), axis=0), ahead, split="transmit", max_events=1, threads=1)
    distance = np.linalg.norm(ahead, axis=1)
    for i, status, place in zip(seen.source, seen.status, seen.position, strict=True):
        way = float(np.linalg.norm(place - front))
        clear = max(BEFORE_MM, BEFORE * way)
        if status == Status.TARGET and way + clear < distance[i]:
            placed[i] = front + (way - clear) / distance[i] * ahead[i]
    return np.asarray(placed + 0.0)


def together(parts: Sequence[Rays]) -> Rays:
    """Merge several launches into one world.

    Raises
    ------
    LfmeshError
        Some run backwards, so their powers have other units.
    """
    first = parts[0]
    if len(parts) == 1:
        return first
    if len({part.unit for part in parts}) > 1:
        raise LfmeshError(
            "rays launched from pixels (m² sr) and rays launched with the light (W) have different units; show one kind"
        )
    arriving: dict[str, float] = {}
    for part in parts:
        power = np.bincount(part.sequence, part.end_power * part.arrives, len(part.sequences))
        for sequence, brought in zip(part.sequences, power, strict=True):
            arriving[sequence] = arriving.get(sequence, 0.0) + float(brought)
    # Sequences with the most power come first, as in each launch.
    sequences = sorted(arriving, key=lambda sequence: -arriving[sequence])
    number = {sequence: i for i, sequence in enumerate(sequences)}
    renumbered = [np.array([number[s] for s in part.sequences], np.int64)[part.sequence] for part in parts]
    sources = np.cumsum([0, *(int(part.source.max(initial=-1)) + 1 for part in parts)])
    vertices = np.cumsum([0, *(len(part.position) for part in parts)])

    def all_of(name: str) -> Any:
        return np.concatenate([getattr(part, name) for part in parts])

    arrays: dict[str, Any] = {name: all_of(name) for name in (*OF_VERTICES, *OF_PATHS)}
    arrays |= {
        "bent": all_of("bent"),
        "source": np.concatenate([part.source + start for part, start in zip(parts, sources, strict=False)]),
        "sequence": np.concatenate(renumbered),
    }
    return replace(
        first,
        **arrays,
        offsets=np.concatenate(
            [[0], *(part.offsets[1:] + start for part, start in zip(parts, vertices, strict=False))]
        ),
        sequences=sequences,
        field=_all_points(parts),
    )


def _all_points(parts: Sequence[Rays]) -> FieldPoints | None:
    """Return the field points of several launches; None if one has none, or other wavelengths than the first."""
    fields = [part.field for part in parts if part.field is not None]
    if len(fields) < len(parts) or len({each.wavelengths_nm for each in fields}) > 1:
        return None
    return FieldPoints(tuple(point for each in fields for point in each.points_mm), fields[0].wavelengths_nm)


def pixels_on_array(rays: Rays) -> tuple[float, float]:
    """Return the point (x, y) of the array in front of the rays' start pixels, mm, in its own frame.

    For other launches, return its centre.
    """
    world = rays.world
    hit = rays.pixel[(rays.pixel >= 0).all(axis=1)]
    if not rays.from_sensor or not len(hit):
        return 0.0, 0.0
    sensor = world.tables.sensor
    row, column = hit.mean(axis=0)
    x = (column - 0.5 * (sensor.columns - 1)) * sensor.pixel
    y = (row - 0.5 * (sensor.rows - 1)) * sensor.pixel
    to_camera = world.tables.frames[SENSOR_FRAME, CAMERA_FRAME]
    at = frames.points(world.tables.frames[CAMERA_FRAME, MLA_FRAME], frames.points(to_camera, [[x, y, 0.0]]))[0]
    return float(at[0]), float(at[1])


def middle_pixel(world: World) -> tuple[int, int]:
    """Return row and column of the sensor's central pixel; with an array, the centre of a nearby micro-image.

    The centre of an array with even counts is a corner of four lenslets, which is dark.
    """
    columns, rows = world.scene.camera.sensor.pixels
    pitch_px = world.facts.micro_image_pitch_px
    if pitch_px is None:
        return rows // 2, columns // 2
    tables, lattice = world.tables, world.tables.mla.lenslets.lattice
    chief = frames.points(
        tables.frames[MLA_FRAME, SENSOR_FRAME], [[*centre(lattice, lattice.columns // 2, lattice.rows // 2), 0.0]]
    )
    x, y, _ = chief[0] * pitch_px / lattice.pitch
    return round(y + 0.5 * (rows - 1)), round(x + 0.5 * (columns - 1))
