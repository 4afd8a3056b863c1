"""Content of a layout drawing: a camera's meridional section, real rays through it, and a close-up of its array.

Pure geometry, as z and y in the camera frame, mm; `lfmesh.view.layout.figure` draws it.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from lfmesh.geometry import frame
from lfmesh.geometry.lens.main_order import with_main_orders
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.motions import motions_of
from lfmesh.geometry.objects.targets import target_mesh
from lfmesh.geometry.rigid_motion import pose_at
from lfmesh.optics.glass import refractive_index
from lfmesh.scene import FirstOrder, MicrolensArray, Scene
from lfmesh.scene.first_order.focused import middle_of
from lfmesh.scene.first_order.solve import (
    apparent_thickness_mm,
    front_principal_mm,
    lenslet_focal_length_mm,
    rear_principal_mm,
)
from lfmesh.transport.build import build
from lfmesh.transport.packets.packet import BACK_FRAME, CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME, WORLD_FRAME, Status
from lfmesh.transport.world import World
from lfmesh.view.layout.media_sections import MediumSection, media_sections
from lfmesh.view.layout.sections import (
    Cut,
    Diffractive,
    Glass,
    ThinLens,
    curved_face,
    cut_through,
    diffractive_surfaces,
    lens_glass,
    mesh_section,
    sag_at_rim,
    thin_lenses,
)
from lfmesh.view.rays.aimed_rays import Aim, AimedRay
from lfmesh.view.rays.names import lens_names

FIELDS = (("axis", 0.0), ("0.7 field", 0.7), ("full field", 1.0))
"""Field points of the drawing, as fractions of the field seen by array and sensor."""

MARGINAL = ((0.0, -1.0), (0.0, 0.0), (0.0, 1.0))
"""Points of the stop, relative to its radius: lower marginal, chief, upper marginal ray."""

LENSLET_FAN = 5
"""Rays across the stop through the centre of a lenslet in the close-up, ..."""

IMAGE_FAN = 15
"""... or from one point imaged before or behind the lenslets, or onto pixels."""

FAR = 1e4
"""Distance in focal lengths from which rays are drawn as collimated."""

LEAST_LENSLETS, MOST_LENSLETS = 4, 16
"""Lenslets in the close-up."""

LENSLET_POINTS = 80
"""Points of a lenslet's section, over one pitch."""

DETAIL_SHAPE = 0.6
"""Height-to-width ratio of the close-up."""

PIXELS_IN_DETAIL = 24
"""Pixels in the close-up of a conventional camera."""


@dataclass(frozen=True)
class Bundle:
    """Rays from one object point.

    Attributes
    ----------
    name : str
    slope : float
        y of the object point over its distance from the first vertex.
    rays : list of AimedRay
        From the lower rim of the stop to the upper one.
    """

    name: str
    slope: float
    rays: list[AimedRay]


@dataclass(frozen=True)
class TargetSection:
    """Meridional section of a target: (n, 2) lines; `closed`: an outline; `glass`: refracts; `at_end`: after motion."""

    name: str
    lines: list[Array]
    closed: bool
    glass: bool
    at_end: list[Array] = field(default_factory=list)


@dataclass(frozen=True)
class Dimension:
    """Labelled distance between two points (2,); `cut`: it starts outside the view."""

    start: Array
    end: Array
    text: str
    cut: bool = False


@dataclass(frozen=True)
class Detail:
    """Close-up of array and sensor.

    Attributes
    ----------
    x_mm : float
        Position of the section plane, through the centres of lenslets.
    window : tuple of float
        z from and to, y from and to.
    plate : (n, 2) float64 or None
        Closed outline of the part of the array in the window.
    sensor : (2, 2) float64
        Ends of the sensor surface.
    pixels : (m, 2, 2) float64
        Ticks behind the sensor, at pixel borders.
    bundles : list of Bundle
    heights : list of Dimension
        Dimensions across the axis, such as the pitch.
    lengths : list of Dimension
        Dimensions along the axis.
    caption : str
    """

    x_mm: float
    window: tuple[float, float, float, float]
    plate: Array | None
    sensor: Array
    pixels: Array
    bundles: list[Bundle]
    heights: list[Dimension]
    lengths: list[Dimension]
    caption: str


@dataclass(frozen=True)
class Layout:
    """Layout of a camera.

    Attributes
    ----------
    scene : Scene
        Solved scene.
    facts : FirstOrder
    distance_mm : float
        Distance of the rays' object plane, the plane of best focus.
    glass : list of Glass
    thin : list of ThinLens
    diffractive : list of Diffractive
        Rays follow the main order of each.
    stop : (2,) float64
        z and height of the stop's upper rim.
    bundles : list of Bundle
    mla : (4, 2) float64 or None
        Section of the array's plate.
    sensor : (2, 2) float64
    cover : (4, 2) float64 or None
        Section of the sensor's cover, drawn as wide as the sensor.
    targets : list of TargetSection
    media : list of MediumSection
    detail : Detail
    """

    scene: Scene
    facts: FirstOrder
    distance_mm: float
    glass: list[Glass]
    thin: list[ThinLens]
    diffractive: list[Diffractive]
    stop: Array
    bundles: list[Bundle]
    mla: Array | None
    sensor: Array
    cover: Array | None
    targets: list[TargetSection]
    media: list[MediumSection]
    detail: Detail


def layout(scene: Scene) -> Layout:
    """Lay out a camera with real rays from three points of its plane of focus.

    At diffractive faces with several orders, the rays follow the main one; the drawing says so.
    Opaque targets are drawn but block no rays; glass in front of the camera refracts them.

    Raises
    ------
    LfmeshError
        The scene cannot be built.
    """
    camera = solved_camera(scene)
    drawn, facts = camera.scene, camera.report
    still = drawn.still()
    glass_targets = [t.model_dump() for t in still.targets if t.refractor is not None]
    unpolarised = {"transport.polarisation": False, "camera.polariser_deg": None}
    unlit = still.changed({"lights": (), "particles": (), **unpolarised})
    world = build(with_main_orders(unlit.changed({"targets": glass_targets, "media": ()})))
    distance = _focus_mm(facts)
    aim = Aim(world, distance)
    moves = world.tables.frames
    shape = world.lens_shape
    indices = np.array([refractive_index(medium, facts.wavelength_nm) for medium in shape.media])
    return Layout(
        drawn,
        facts,
        distance,
        lens_glass(shape, indices),
        thin_lenses(shape, drawn.camera.lens),
        diffractive_surfaces(shape, drawn.camera.lens, lens_names(world)),
        _stop_rim(drawn, world),
        _field_bundles(drawn, facts, aim),
        _array_section(drawn, moves),
        _sensor_section(drawn, moves),
        _cover_section(drawn, moves),
        _target_sections(drawn, moves),
        media_sections(unlit),
        _detail(drawn, facts, world, aim),
    )


def _focus_mm(facts: FirstOrder) -> float:
    """Return the sharpest object distance before the first vertex; inf if very large."""
    distance = facts.object_distance_mm
    return distance if abs(distance) < FAR * abs(facts.efl_mm) else math.inf


def _field_bundles(scene: Scene, facts: FirstOrder, aim: Aim) -> list[Bundle]:
    """Return three rays per field point; the chief rays end at 0, 0.7 and 1 of the used image height."""
    camera = scene.camera
    used = 0.5 * (camera.sensor.size_mm[1] - camera.sensor.pixel_mm)
    if camera.mla is not None:
        used = min(used, 0.5 * (camera.mla.count[1] - 1) * camera.mla.row_pitch_mm)
    # Image heights are below the axis for points above it.
    slopes = aim.slopes_to([(0.0, -share * used, facts.image_z_mm) for _, share in FIELDS])
    slopes[0] = 0.0
    return _bundles([name for name, _ in FIELDS], aim, slopes, np.array(MARGINAL))


def _bundles(names: list[str], aim: Aim, slopes: Array, stop: Array) -> list[Bundle]:
    n = len(stop)
    rays = aim.through(np.repeat(slopes, n, axis=0), np.tile(stop, (len(slopes), 1)))
    return [
        Bundle(name, float(slope[1]), rays[i * n : (i + 1) * n])
        for i, (name, slope) in enumerate(zip(names, slopes, strict=True))
    ]


def _stop_rim(scene: Scene, world: World) -> Array:
    lens = scene.camera.lens
    number = lens.stop_index or 0
    z = lens.vertices_mm[number]
    if number in world.lens_shape.numbers:
        z = sag_at_rim(world.lens_shape, world.lens_shape.numbers.index(number))
    return np.array([z, lens.surfaces[number].semi_diameter_mm or math.nan])


def _array_section(scene: Scene, moves: Array) -> Array | None:
    mla = scene.camera.mla
    if mla is None:
        return None
    cut = cut_through("camera.mla", moves[MLA_FRAME, CAMERA_FRAME], mla.size_mm)
    ends = np.array([cut.low, cut.high])
    return np.concatenate([cut.section(ends), cut.section(ends[::-1], mla.thickness_mm)])


def _sensor_section(scene: Scene, moves: Array) -> Array:
    cut = cut_through("camera.sensor", moves[SENSOR_FRAME, CAMERA_FRAME], scene.camera.sensor.size_mm)
    return cut.section(np.array([cut.low, cut.high]))


def _cover_section(scene: Scene, moves: Array) -> Array | None:
    cover = scene.camera.sensor.cover
    if cover is None:
        return None
    cut = cut_through("camera.sensor", moves[SENSOR_FRAME, CAMERA_FRAME], scene.camera.sensor.size_mm)
    ends = np.array([cut.low, cut.high])
    return np.concatenate([cut.section(ends, -cover.height_mm), cut.section(ends[::-1], -cover.gap_mm)])


def _target_sections(scene: Scene, moves: Array) -> list[TargetSection]:
    """Return the sections of targets that the meridional plane cuts."""
    to_camera = moves[WORLD_FRAME, CAMERA_FRAME]
    sections = []
    for i, target in enumerate(scene.targets):
        made = target_mesh(target, scene)
        lines = mesh_section(made.mesh.moved(to_camera).solid())
        if lines:
            name = target.name or f"targets[{i}]"
            at_end = _at_end(scene, i, to_camera)
            moved = [] if at_end is None else mesh_section(made.mesh.moved(at_end).solid())
            sections.append(TargetSection(name, lines, made.closed, target.refractor is not None, moved))
    return sections


def _at_end(scene: Scene, number: int, to_camera: Array) -> Array | None:
    """Return the move of a target to its place relative to the camera at the end of the exposure; None at rest."""
    motions = motions_of(scene)
    body, camera = motions.bodies[number], motions.camera
    if scene.exposure is None or (body is None and camera is None):
        return None
    end_s = scene.exposure.end_s(scene.camera.sensor.pixels[1])
    moved = frame.IDENTITY if body is None else pose_at(body, end_s)
    back = frame.IDENTITY if camera is None else frame.inverse(pose_at(camera, end_s))
    return frame.compose(to_camera, frame.compose(back, moved))


def _detail(scene: Scene, facts: FirstOrder, world: World, aim: Aim) -> Detail:
    if scene.camera.mla is None:
        return _pixels_close_up(scene, world, aim)
    return _lenslets_close_up(scene, facts, world, aim)


def _lenslets_close_up(scene: Scene, facts: FirstOrder, world: World, aim: Aim) -> Detail:
    """Lay out the lenslets nearest the axis, the pixels behind them, and the rays there."""
    mla = scene.camera.mla
    assert mla is not None
    moves, lenslets = world.tables.frames, world.tables.mla.lenslets
    to_camera = moves[MLA_FRAME, CAMERA_FRAME]
    toward_lens = mla.frame_side == "lens"
    # Seen through the plate, the apexes appear nearer to the lens; of two faces with lenslets it sees the first.
    seen_z = 0.0 if toward_lens else mla.thickness_mm - apparent_thickness_mm(scene.camera, scene.primary_nm)
    if _is_seen_directly(mla):
        seen_z = mla.thickness_mm
    at = lenslets.apexes
    apex = np.dstack([at, np.full(at.shape[:2], seen_z)]).reshape(-1, 3) @ to_camera[:, :3].T + to_camera[:, 3]
    middle = _nearest_axis(apex, lenslets.lattice.pitch)
    x = float(apex[middle, 0])
    # Only every other row of a hexagonal array lies in the section plane.
    step = mla.count[0] * (2 if lenslets.lattice.hexagonal else 1)
    image = middle_of(facts.focused).main_image_mm if facts.focused else None
    if image is not None:
        bundles = _bundles(["main image"], aim, aim.slopes_to(apex[[middle]]), _fan(IMAGE_FAN))
    else:
        fan = _fan(LENSLET_FAN)
        bundles = [
            Bundle(f"lenslet {n}", 0.0, _through_point(apex[n], aim, fan))
            for n in (middle - step, middle, middle + step)
            if 0 <= n < len(apex)
        ]
    half = lenslets.lattice.half_extent
    cut = cut_through("camera.mla", to_camera, (2.0 * half[0], 2.0 * half[1]), x)
    sensor = cut_through("camera.sensor", moves[SENSOR_FRAME, CAMERA_FRAME], scene.camera.sensor.size_mm, x)
    apex_z, sensor_z = float(apex[middle, 2]), _z_at(sensor, float(apex[middle, 1]))
    behind = sensor_z - apex_z
    before = min(1.25 * image, 16.0 * behind) if image is not None and image > 0.0 else 0.6 * behind
    window = _window(apex_z - before, sensor_z + 0.12 * (before + behind), float(apex[middle, 1]), mla.row_pitch_mm)
    s = _within(cut, window, mla.row_pitch_mm / LENSLET_POINTS)
    other = cut.section(s[[-1, 0]], mla.thickness_mm)
    if world.tables.mla.back is not None:
        second = cut_through("camera.mla", moves[BACK_FRAME, CAMERA_FRAME], (2.0 * half[0], 2.0 * half[1]), x)
        along = _within(second, window, mla.row_pitch_mm / LENSLET_POINTS)[::-1]
        other = second.section(along, curved_face(second, world.tables.mla.back.lenslets, along))
    plate = np.concatenate([cut.section(s, curved_face(cut, lenslets, s)), other])
    # Rays are aimed at the apparent apexes, but distances are measured from the real ones.
    stands = apex + (0.0 if _is_seen_directly(mla) else -seen_z) * to_camera[:, 2]
    neighbour = stands[middle + step if middle + step < len(apex) else max(0, middle - step)]
    heights, lengths = _array_dimensions(scene, to_camera, stands[middle], neighbour, sensor_z, image)
    if image is None:
        heights += _micro_image(bundles[min(1, middle // step)], scene.camera.sensor.pixel_mm)
    return Detail(
        x, window, plate, *_sensor_close_up(sensor, scene, window), bundles, heights, lengths,
        _array_caption(x, image, len(bundles)),
    )  # fmt: skip


def _is_seen_directly(mla: MicrolensArray) -> bool:
    """Tell whether the lens sees lenslets on its own side, though the array's frame starts from the other face."""
    return mla.has_back or mla.gradient is not None


def _nearest_axis(apex: Array, pitch: float) -> int:
    """Return the lenslet nearest the axis; among equals, the one with the largest y, then x."""
    distance = np.round(np.hypot(apex[:, 0], apex[:, 1]) / pitch, 6)
    return int(np.lexsort((-apex[:, 0], -apex[:, 1], distance))[0])


def _window(z0: float, z1: float, y: float, row: float) -> tuple[float, float, float, float]:
    """Return a window from z0 to z1 around a lenslet, with whole rows of lenslets."""
    rows = np.clip(math.ceil(DETAIL_SHAPE * (z1 - z0) / row), LEAST_LENSLETS, MOST_LENSLETS)
    half = 0.5 * float(rows) * row
    return z0, z1, y - half, y + half


def _within(cut: Cut, window: tuple[float, float, float, float], step: float) -> Array:
    """Return places along a cut, `step` apart within the window, including the ends of the sheet."""
    ends = cut.section(np.array([0.0, 1.0]))
    rise = ends[1, 1] - ends[0, 1]
    low, high = (window[2] - ends[0, 1]) / rise, (window[3] - ends[0, 1]) / rise
    low, high = max(low, cut.low), min(high, cut.high)
    return np.linspace(low, high, max(2, math.ceil((high - low) / step) + 1))


def _z_at(cut: Cut, y: float) -> float:
    """Return z of a cut sheet at a given height."""
    (z0, y0), (z1, y1) = cut.section(np.array([0.0, 1.0]))
    return float(z0 + (y - y0) / (y1 - y0) * (z1 - z0))


def _sensor_close_up(cut: Cut, scene: Scene, window: tuple[float, float, float, float]) -> tuple[Array, Array]:
    """Return the sensor's line (2, 2) and the ticks (m, 2, 2) between its pixels, in the window."""
    pixel, rows = scene.camera.sensor.pixel_mm, scene.camera.sensor.pixels[1]
    line = _within(cut, window, np.inf)
    borders = (np.arange(rows + 1) - 0.5 * rows) * pixel
    place = (borders - cut.start[1]) / cut.ahead[1] if abs(cut.ahead[1]) > 0.1 else np.zeros(0)
    place = place[(place >= line.min() - 1e-9 * pixel) & (place <= line.max() + 1e-9 * pixel)]
    tick = 0.018 * (window[1] - window[0])
    return cut.section(line[[0, -1]]), np.stack([cut.section(place), cut.section(place, tick)], axis=1)


def _array_dimensions(
    scene: Scene, to_camera: Array, apex: Array, neighbour: Array, sensor_z: float, image: float | None
) -> tuple[list[Dimension], list[Dimension]]:
    """Return the close-up's dimensions: pitch, thickness, distances, and position of the main image."""
    mla = scene.camera.mla
    assert mla is not None
    z = float(apex[2])
    what = "2 rows" if mla.layout == "hexagonal" else "p"
    distance = abs(float(neighbour[1] - apex[1]))
    heights = [Dimension(apex[[2, 1]], np.array([z, neighbour[1]]), f"{what} = {distance:.4g} mm")]
    # Along the axis, from the lenslet as placed, which may be tilted.
    # The apexes of the face that the lens sees directly are opposite the frame's origin.
    into = np.array([0.0, 0.0, -mla.thickness_mm if _is_seen_directly(mla) else mla.thickness_mm]) @ to_camera[:, :3].T
    front, back = sorted((z, z + float(into[2])))
    chain = [(front, back), (back, sensor_z)]
    lengths = [(a, b, f"{b - a:.4g} mm") for a, b in chain]
    types = lenslet_focal_length_mm(scene.camera, scene.primary_nm)
    focal = sorted(types)[len(types) // 2] if image is not None else types[0]
    # From the rear principal plane, which is at the apex if light leaves there.
    principal = back - rear_principal_mm(scene.camera, scene.primary_nm)
    if focal > 0.0:
        lengths.append((principal, principal + focal, f"f = {focal:.4g} mm"))
    if image is not None and image > 0.0:
        principal = front + front_principal_mm(scene.camera, scene.primary_nm)
        lengths.append((principal - image, principal, f"main image {image:.4g} mm before"))
    y = float(apex[1])
    return heights, [Dimension(np.array([a, y]), np.array([b, y]), text) for a, b, text in lengths]


def _through_point(point: Array, aim: Aim, stop: Array) -> list[AimedRay]:
    """Return the rays through stop points that meet a point behind the lens, unless the lens blocks them."""
    rays = aim.through(aim.slopes_to(np.tile(point, (len(stop), 1)), stop), stop)
    return [ray for ray in rays if np.allclose(ray.beyond_lens(point[2]), point[:2], atol=1e-6, rtol=0.0)]


def _micro_image(bundle: Bundle, pixel_mm: float) -> list[Dimension]:
    """Return the dimension between the outermost rays of a lenslet, if all reach the sensor."""
    landing = np.array([ray.points[-1, [2, 1]] for ray in bundle.rays if ray.status == Status.SENSOR])
    if len(landing) < LENSLET_FAN:
        return []
    low, high = landing[landing[:, 1].argmin()], landing[landing[:, 1].argmax()]
    return [Dimension(low, high, f"{(high[1] - low[1]) / pixel_mm:.3g} px")]


def _array_caption(x: float, image: float | None, lenslets: int) -> str:
    what = (
        f"rays through the stop and the middles of {lenslets} lenslets"
        if image is None
        else "one point of the plane in focus, shared by the lenslets"
    )
    return f"section x = {x:z.4g} mm; {what}".replace("-", "−")


def _fan(count: int) -> Array:
    """Return (count, 2) stop points in the meridional plane, relative to its radius, from rim to rim."""
    return np.column_stack([np.zeros(count), np.linspace(-1.0, 1.0, count)])


def _pixels_close_up(scene: Scene, world: World, aim: Aim) -> Detail:
    """Lay out a conventional camera's pixels around the axis."""
    pixel, rows = scene.camera.sensor.pixel_mm, scene.camera.sensor.pixels[1]
    cut = cut_through("camera.sensor", world.tables.frames[SENSOR_FRAME, CAMERA_FRAME], scene.camera.sensor.size_mm)
    shown = min(PIXELS_IN_DETAIL, rows)
    z, half = _z_at(cut, 0.0), 0.5 * shown * pixel
    wide = 2.0 * half / DETAIL_SHAPE
    window = z - 0.85 * wide, z + 0.15 * wide, -half, half
    bundles = _bundles(["axis"], aim, np.zeros((1, 2)), _fan(IMAGE_FAN))
    line, pixels = _sensor_close_up(cut, scene, window)
    at = int(np.searchsorted(pixels[:, 0, 1], 0.0)) if len(pixels) > 2 else 0
    heights = [Dimension(pixels[at - 1, 0], pixels[at, 0], f"pixel {pixel:.4g} mm")] if 0 < at < len(pixels) else []
    return Detail(0.0, window, None, line, pixels, bundles, heights, [], "the sensor where the axis meets it")
