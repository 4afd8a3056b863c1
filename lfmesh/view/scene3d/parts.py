"""Parts of a camera and its scene for drawing: meshes in the world frame, mm, with their looks."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import PIL.Image
import pyvista as pv
from numpy.typing import ArrayLike, NDArray

from lfmesh.files.colour import srgb_encode
from lfmesh.geometry import frame as frames
from lfmesh.geometry.lens.element_poses import pose_of
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.geometry.meshes.mesh import Mesh, joined
from lfmesh.geometry.motions import motions_of
from lfmesh.geometry.objects.targets import TargetMesh
from lfmesh.geometry.surfaces.tessellation import element
from lfmesh.optics.glass import refractive_index
from lfmesh.scene.light.region import Region
from lfmesh.transport.packets.packet import BACK_FRAME, CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME, WORLD_FRAME
from lfmesh.transport.tables.tables import MlaTables
from lfmesh.transport.world import World
from lfmesh.view.media import shown_media
from lfmesh.view.scene3d import array_shape
from lfmesh.view.scene3d.array_shape import FINE, Detail
from lfmesh.view.scene3d.base_colours import base_colours, paint
from lfmesh.view.scene3d.colours import tint
from lfmesh.view.scene3d.describe import lone_diffractive
from lfmesh.view.scene3d.media_parts import bodies
from lfmesh.view.scene3d.motion_parts import drawn_motions, end_pose
from lfmesh.view.scene3d.outlines import outline_of_medium, outline_of_sheet
from lfmesh.view.scene3d.presets import chip_size_mm
from lfmesh.view.scene3d.ray_lines import line_segments

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

RINGS = 16
"""Triangle rings of a lens surface, enough for round rims; tracing `exact` surfaces needs fewer."""

AS_THIN_LENS = 1.5
"""Refractive index that sets the colour of thin lenses."""

CREASE_DEG = 25.0
"""Smallest angle between facets that is drawn as an edge."""

PIXEL_PX = 16
"""Width of one pixel in the pattern for pixels without an image."""

TICKS = 60
"""Most marks on the optical axis."""

GLOWING = "#ffe9b0"
"""Colour of emitting targets without a picture."""

DARKEST = 0.25
"""Smallest brightest channel of a target's colour, which would otherwise vanish before the background."""

MOVES, GHOST = "#d08cff", 0.12
"""Colour of ways during the exposure and of bodies at its end, and the opacity of these."""

SYMBOL = 0.03
"""Size of a light's symbol relative to the scene."""


@dataclass
class Part:
    """Drawn and clickable part of the scene.

    Attributes
    ----------
    name : str
        Name in `World.mesh_names`: "lens[0]", "stop", "mla", "sensor", "targets[0]", ...; "lights[0]", "axis", ...
    kind : str
        "glass", "mount", "stop", "array", "sensor", "target", "light", "medium" or "sign".
    mesh : pyvista.PolyData
    look : dict
        Arguments of `pyvista.Plotter.add_mesh`.
    label : str
        The name, or a distinct name for a piece of a part: "mla plate".
    picture : (h, w, 3) uint8, optional
        Picture on the part, placed by texture coordinates; the part's colour multiplies it. (h, w, 4) with its opacity.
    tiled : bool
        The picture repeats.
    edges : pyvista.PolyData, optional
        Lines drawn on it in `edge_colour`.
    solid : pyvista.PolyData, optional
        The same body closed, for a cut with a solid face.
    """

    name: str
    kind: str
    mesh: pv.PolyData
    look: dict[str, Any]
    edges: pv.PolyData | None = None
    edge_colour: str = "#ffffff"
    solid: pv.PolyData | None = None
    label: str = ""
    picture: Picture | None = None
    tiled: bool = False

    def __post_init__(self) -> None:
        self.label = self.label or self.name


def parts(
    world: World, picture: Picture | None = None, near_mm: tuple[float, float] = (0.0, 0.0), detail: Detail = FINE
) -> list[Part]:
    """Return all drawn parts of a scene except the rays.

    Parameters
    ----------
    world : World
    picture : (rows, columns, 3) uint8, optional
        Picture on the sensor, in physical orientation.
    near_mm : (x, y), mm
        Point of a large array with real lenslets around it, in its own frame.
    detail : Detail
    """
    made = [*_lens(world, detail), *_stop(world), *_array(world, near_mm, detail), *_sensor(world, picture)]
    made += [part for i, target in enumerate(world.targets) for part in _target(world, i, target)]
    _reduce_pictures(made, detail.picture_px)
    return [*made, *_lights(world), *_particles(world), *_media(world), *_motions(world), *_signs(world)]


def _reduce_pictures(made: list[Part], longest_px: int) -> None:
    """Reduce larger pictures; parts of a target go on to share theirs."""
    reduced: dict[int, Picture] = {}
    for part in made:
        if part.picture is not None:
            factor = -(-max(part.picture.shape[:2]) // longest_px)
            if factor > 1 and id(part.picture) not in reduced:
                picture = PIL.Image.fromarray(np.ascontiguousarray(part.picture))
                reduced[id(part.picture)] = np.asarray(picture.reduce(factor))
            part.picture = reduced.get(id(part.picture), part.picture)


def texture_of(part: Part) -> pv.Texture | None:
    """Return the texture of a part's picture."""
    if part.picture is None:
        return None
    texture = pv.Texture(np.ascontiguousarray(part.picture))
    # No mipmaps: with them, Mesa's software rasteriser hangs on close edge-on views.
    texture.repeat = part.tiled
    # Keep pixels square at close range.
    texture.interpolate = part.tiled or part.kind != "sensor"
    return texture


def polydata(points: Array, triangles: ArrayLike) -> pv.PolyData:
    """Return a mesh of triangles."""
    return pv.PolyData.from_regular_faces(np.asarray(points, dtype=np.float64), np.asarray(triangles, dtype=np.int64))


def closed(mesh: Mesh) -> pv.PolyData:
    """Return a body with vertices shared between facets."""
    solid = mesh.solid()
    return polydata(solid.vertices, solid.faces)


def smooth(body: pv.PolyData) -> pv.PolyData:
    """Return a body with smooth normals between its creases."""
    return body.compute_normals(split_vertices=True, feature_angle=CREASE_DEG, auto_orient_normals=False)


def creases_of(body: pv.PolyData) -> pv.PolyData:
    """Return a body's edges."""
    return body.extract_feature_edges(CREASE_DEG, boundary_edges=True, non_manifold_edges=False, manifold_edges=False)


def _lens(world: World, detail: Detail) -> Iterator[Part]:
    shape = solved_camera(world.scene).lens_shape(min(max(RINGS, world.lens_shape.rings), detail.rings))
    to_world = world.tables.frames[CAMERA_FRAME, WORLD_FRAME]
    wavelength = world.scene.primary_nm
    for number, k in enumerate(shape.elements):
        colour = tint(refractive_index(shape.media[k + 1], wavelength))
        body = closed(element(shape.caps[k], shape.closures[k], shape.caps[k + 1]).moved(to_world))
        look = {"color": colour, "opacity": 0.14, "specular": 0.6, "specular_power": 30}
        yield Part(f"lens[{number}]", "glass", smooth(body), look, creases_of(body), colour, solid=body)
    surfaces = world.scene.camera.lens.surfaces
    diffractive = lone_diffractive(world)
    for k, i in enumerate(shape.numbers):
        if surfaces[i].paraxial or i in diffractive:
            body = polydata(frames.points(to_world, shape.caps[k].vertices), shape.caps[k].faces)
            rim = body.extract_feature_edges(feature_edges=False, manifold_edges=False)
            colour = tint(AS_THIN_LENS)
            yield Part(f"surface[{i}]", "glass", body, {"color": colour, "opacity": 0.2}, rim, colour)
    mounts = [mesh for k, mesh in enumerate(shape.closures) if shape.media[k + 1] is None]
    if mounts:
        body = smooth(closed(joined(mounts).moved(to_world)))
        # Mount faces point to the axis: draw only the ones behind it, so that the lens stays visible.
        yield Part("mount", "mount", body, {"color": "#56606c", "opacity": 0.35, "culling": "back"})


def _stop(world: World) -> Iterator[Part]:
    ring = world.mesh("stop")
    lens = world.scene.camera.lens
    # Use its own frame, with the axis of the aperture.
    to_world = frames.compose(world.tables.frames[CAMERA_FRAME, WORLD_FRAME], pose_of(lens, lens.stop_index or 0))
    points = frames.points(frames.inverse(to_world), ring.vertices)
    # Draw it up to the surrounding mount.
    shape = world.lens_shape
    mount = np.interp(points[:, 2].mean(), shape.surfaces["vertex_z"], shape.rims)
    radius = np.hypot(points[:, 0], points[:, 1])
    points[:, :2] *= np.minimum(1.0, np.maximum(mount, radius.min() * 1.1) / radius)[:, None]
    body = polydata(frames.points(to_world, points), ring.faces)
    rims = body.extract_feature_edges(boundary_edges=True, feature_edges=False, manifold_edges=False)
    yield Part(
        "stop", "stop", body, {"color": "#3c4653", "ambient": 0.4, "opacity": 0.8}, edges=rims, edge_colour="#ff6f9c"
    )


def _array(world: World, near_mm: tuple[float, float], detail: Detail) -> Iterator[Part]:
    if not world.tables.mla.present:
        return
    mla = world.scene.camera.mla
    assert mla is not None
    glass = {"color": tint(refractive_index(mla.medium, world.scene.primary_nm)), "opacity": 0.3}
    tables = world.tables.mla
    yield from _lenslets(world, tables, glass, near_mm, detail)
    if tables.back is not None:
        yield from _lenslets(world, tables.back, glass, near_mm, detail)
    plate = _plate(world, tables.lenslets.valley)
    outline = plate.extract_feature_edges(CREASE_DEG)
    yield Part("mla", "array", plate, glass, edges=outline, edge_colour="#79d0dc", label="mla plate")


def _lenslets(
    world: World, face: MlaTables, glass: dict[str, Any], near_mm: tuple[float, float], detail: Detail
) -> Iterator[Part]:
    """Yield the lenslets of a face of the array and, for a large array, the lattice of the others."""
    lenslets, to_world = face.lenslets, world.tables.frames[face.frame, WORLD_FRAME]
    lattice, near = lenslets.lattice, array_shape.cells_near(lenslets.lattice, near_mm, detail)
    large = array_shape.is_large(lattice, detail)
    curved = array_shape.caps(lenslets, *(near if large else array_shape.all_cells(lattice)), detail)
    caps = polydata(frames.points(to_world, curved.points), curved.triangles)
    caps.point_data.active_normals = frames.directions(to_world, curved.normals)
    lines = array_shape.borders(lenslets, *near)
    borders = line_segments(frames.points(to_world, lines.reshape(-1, 3)).reshape(-1, 2, 3))
    shine = {"specular": 1.0, "specular_power": 12, "smooth_shading": True}
    back = face.frame == BACK_FRAME
    label = "mla other lenslets" if back else ""
    yield Part("mla", "array", caps, {**glass, **shine}, edges=borders, edge_colour="#8fb9c9", label=label)
    if large:
        picture, (width, height) = array_shape.lattice_picture(lenslets.lattice)
        corners = array_shape.face_round(lenslets, lenslets.valley, *near)
        sheet = polydata(frames.points(to_world, corners), array_shape.ROUND)
        sheet.active_texture_coordinates = (corners[:, :2] - lattice.centres()[0, 0]) / [width, height]
        look = {"opacity": 0.45, "lighting": False}
        label = "mla other lattice" if back else "mla lattice"
        yield Part("mla", "array", sheet, look, label=label, picture=picture, tiled=True)


def _plate(world: World, front_mm: float) -> pv.PolyData:
    """Return the box of the array's glass, from the valleys between lenslets to the flat face or the back's valleys."""
    lenslets, back = world.tables.mla.lenslets, world.tables.mla.back
    end_mm = lenslets.thickness - (0.0 if back is None else back.lenslets.valley)
    corners = [array_shape.face_corners(lenslets, z) for z in (front_mm, end_mm)]
    points = frames.points(world.tables.frames[MLA_FRAME, WORLD_FRAME], np.concatenate(corners))
    sides = [[i, (i + 1) % 4, (i + 1) % 4 + 4, i + 4] for i in range(4)]
    quads = np.array(sides if back is not None else [[4, 5, 6, 7], *sides])
    return polydata(points, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))


def _sensor(world: World, picture: Picture | None) -> Iterator[Part]:
    corners = np.asarray(world.mesh("sensor").vertices)
    pixels = polydata(corners, [[0, 2, 1], [0, 3, 2]])
    # Row 0 of a picture is at v = 1, pixel (0, 0) at the corner −x, −y.
    place = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]])
    tiled = picture is None
    pixels.active_texture_coordinates = place * (world.scene.camera.sensor.pixels if tiled else (1, 1))
    drawn = _bare_pixel() if picture is None else picture
    yield Part("sensor", "sensor", pixels, {"lighting": False}, picture=drawn, tiled=tiled)
    cover = world.scene.camera.sensor.cover
    if cover is not None:
        x, y = (0.5 * size for size in world.scene.camera.sensor.size_mm)
        box = pv.Box(bounds=(-x, x, -y, y, -cover.height_mm, -cover.gap_mm)).triangulate()
        place = frames.points(world.tables.frames[SENSOR_FRAME, WORLD_FRAME], box.points)
        plate = polydata(place, box.regular_faces)
        glass = {"color": tint(refractive_index(cover.medium, world.scene.primary_nm)), "opacity": 0.2}
        edges = plate.extract_feature_edges(CREASE_DEG)
        yield Part("sensor", "sensor", plate, glass, edges, "#79d0dc", label="sensor cover")
    board = _chip(world)
    edges = board.extract_feature_edges(CREASE_DEG)
    green = "#4fae86"
    yield Part("sensor", "sensor", board, {"color": green, "opacity": 0.15}, edges, green, label="sensor board")


def _bare_pixel() -> Picture:
    """Return the picture of a pixel without an image."""
    tile = np.full((PIXEL_PX, PIXEL_PX, 3), [70, 84, 104], np.uint8)
    tile[[0, -1]] = tile[:, [0, -1]] = [54, 66, 84]
    return tile


def _chip(world: World) -> pv.PolyData:
    """Return a board behind the pixels, which marks the sensor."""
    (x, y), (front, back) = chip_size_mm(world)
    box = pv.Box(bounds=(-x, x, -y, y, front, back)).triangulate()
    return polydata(frames.points(world.tables.frames[SENSOR_FRAME, WORLD_FRAME], box.points), box.regular_faces)


def _target(world: World, number: int, target: TargetMesh) -> Iterator[Part]:
    """Yield a body of glass, or the facets of a surface: one part for each base colour."""
    name, model = f"targets[{number}]", world.scene.targets[number]
    if model.refractor is not None:
        colour = tint(refractive_index(model.refractor.medium, world.scene.primary_nm))
        glass = closed(target.mesh)
        shine = {"color": colour, "opacity": 0.25, "specular": 0.6}
        yield Part(name, "glass", smooth(glass), shine, creases_of(glass), colour, solid=glass)
        return
    picture, glows = _picture_of(target), model.material.emits
    for place, base in enumerate(base_colours(world, number)):
        label = name if place == 0 else f"{name} colour {place + 1}"
        faces = target.mesh.faces[base.facets]
        look: dict[str, Any] = {"opacity": base.opacity}
        if base.has_picture and target.uv is not None:
            corners = target.mesh.vertices[faces].reshape(-1, 3)
            body = polydata(corners, np.arange(len(corners)).reshape(-1, 3))
            body.active_texture_coordinates = target.uv[base.facets].reshape(-1, 2)
            look |= {"color": paint(base.colour), "lighting": False}
            yield Part(name, "target", body, look, label=label, picture=picture)
            continue
        used, corner = np.unique(faces, return_inverse=True)
        body = polydata(target.mesh.vertices[used], corner.reshape(-1, 3))
        shines = glows and bool((base.colour == 1.0).all())
        look |= {"color": GLOWING if shines else paint(base.colour, DARKEST), "ambient": 1.0 if glows else 0.25}
        yield Part(name, "target", smooth(body), look, creases_of(body), "#10151c", label=label)


def _picture_of(target: TargetMesh) -> Picture | None:
    """Return the picture on a target, with its opacity as a fourth channel if it varies."""
    if target.texture is None or target.uv is None:
        return None
    picture = srgb_encode(target.texture)
    if target.alpha is None:
        return picture
    return np.dstack([picture, np.rint(255.0 * target.alpha).astype(np.uint8)])


def scene_size_mm(world: World) -> float:
    """Return the axial distance from the farthest target (or the lens if there is none) to the sensor."""
    to_camera = world.tables.frames[WORLD_FRAME, CAMERA_FRAME]
    z = [0.0, float(world.tables.frames[SENSOR_FRAME, CAMERA_FRAME, 2, 3])]
    z += [float(frames.points(to_camera, t.mesh.vertices.mean(axis=0)[None])[0, 2]) for t in world.targets]
    return max(z) - min(z)


def _lights(world: World) -> Iterator[Part]:
    size = SYMBOL * scene_size_mm(world)
    lamp = {"color": "#ffd24a", "lighting": False}
    for number, light in enumerate(world.scene.lights):
        name = f"lights[{number}]"
        if light.region is None:
            yield Part(name, "light", _parallel_arrows(world, light.axes[2], size), lamp)
            continue
        body = _body_of_lamp(light.region, size)
        if light.heading is not None:
            arrow = pv.Arrow(start=light.region.centre_mm, direction=light.heading, scale=2.0 * size).triangulate()
            body = body.append_polydata(arrow)
        spikes = None if light.region.size_mm > 0.0 else _spikes(tuple(light.region.centre_mm), size)
        yield Part(name, "light", body, lamp, spikes, "#ffd24a")


def _body_of_lamp(region: Region, size: float) -> pv.PolyData:
    """Return a sphere for a point, a thin tube for a line, and the shape itself for a flat lamp."""
    corners = region.corners_mm
    if len(corners) == 1:
        return pv.Sphere(radius=0.25 * size, center=region.centre_mm)
    if len(corners) == 2:
        return pv.Tube(pointa=corners[0], pointb=corners[1], radius=0.1 * size, n_sides=16).triangulate()
    if region.is_round:
        turns = 2.0 * np.pi * np.arange(ROUND_SIDES) / ROUND_SIDES
        corners = region.centre_mm + np.column_stack([np.cos(turns), np.sin(turns)]) @ region.half_mm
    return pv.PolyData(corners, faces=[len(corners), *range(len(corners))]).triangulate()


ROUND_SIDES = 48


def _parallel_arrows(world: World, along: Array, size: float) -> pv.PolyData:
    """Return three thin parallel arrows that end before the middle of the targets, or before the lens if none."""
    across = np.cross(along, np.eye(3)[np.abs(along).argmin()])
    across /= np.linalg.norm(across)
    middles = [target.mesh.vertices.mean(axis=0) for target in world.targets]
    end = (np.mean(middles, axis=0) if middles else np.zeros(3)) - 2.0 * size * along
    arrows = [
        pv.Arrow(
            start=end - 3.0 * size * along + offset * size * across, direction=along, scale=3.0 * size,
            tip_length=0.15, tip_radius=0.035, shaft_radius=0.008,
        )
        for offset in (-0.8, 0.0, 0.8)
    ]  # fmt: skip
    return pv.merge([arrow.triangulate() for arrow in arrows])


MOST_POINTS = 20_000
"""Most particles drawn for an entry; of more, an evenly spaced selection."""


def _particles(world: World) -> Iterator[Part]:
    for particles in world.particles:
        step = -(-len(particles.points) // MOST_POINTS)
        cloud = pv.PolyData(np.ascontiguousarray(particles.points[::step]))
        look = {"color": "#ffd24a", "lighting": False, "point_size": 3.0, "style": "points"}
        name = f"particles[{particles.entry}]"
        yield Part(name, "light", cloud, look)
        sheet = outline_of_sheet(world.scene.particles[particles.entry], particles.points)
        if len(sheet):
            look = {"color": "#7fe36b", "line_width": 1, "lighting": False}
            yield Part(name, "light", line_segments(sheet), look, label=f"{name} sheet")


def _media(world: World) -> Iterator[Part]:
    """Yield bodies and outlines of media with bounds or a grid."""
    for number, medium in enumerate(shown_media(world)):
        name, lines = f"media[{number}]", outline_of_medium(world, number)
        if len(lines):
            look = {"color": medium.colour, "line_width": 1, "lighting": False}
            yield Part(name, "medium", line_segments(lines), look)
        for place, (body, opacity) in enumerate(bodies(medium), 1):
            look = {"color": medium.colour, "opacity": opacity, "lighting": False}
            yield Part(name, "medium", body, look, label=f"{name} shell {place}")


def _motions(world: World) -> Iterator[Part]:
    """Yield the ways of everything that moves during the exposure, and a ghost of each body at its end."""
    if not world.scene.moves:
        return
    look = {"color": MOVES, "line_width": 2, "lighting": False}
    for name, way, tip in drawn_motions(world):
        yield Part(name, "sign", way, look, label=f"{name} way")
        yield Part(name, "sign", tip, {"color": MOVES, "lighting": False}, label=f"{name} arrow")
    for i, motion in enumerate(motions_of(world.scene).bodies):
        if motion is not None:
            ghost = closed(world.targets[i].mesh.moved(end_pose(world, motion)))
            faint = {"color": MOVES, "opacity": GHOST, "lighting": False}
            yield Part(
                f"targets[{i}]", "sign", ghost, faint, creases_of(ghost), MOVES, label=f"targets[{i}] at the end"
            )


def _spikes(centre: tuple[float, float, float], size: float) -> pv.PolyData:
    """Return the rays of a lamp's symbol."""
    ends = pv.Icosahedron(radius=1.0).points
    points = np.stack([0.4 * size * ends, size * ends], axis=1).reshape(-1, 3) + np.array(centre)
    return line_segments(points.reshape(-1, 2, 3))


def round_length(most_mm: float) -> float:
    """Return the largest of 1, 2, 5, 10, ... mm (or a decimal fraction) that does not exceed a length."""
    decade = 10.0 ** np.floor(np.log10(most_mm))
    return float(next(step * decade for step in (5.0, 2.0, 1.0) if step * decade <= most_mm * (1 + 1e-9)))


def tick_mm(world: World) -> float:
    """Return the spacing of the marks on the optical axis."""
    start, end = _axis(world)
    return round_length((end - start) / TICKS)


def _axis(world: World) -> tuple[float, float]:
    """Return the drawn range of the optical axis: from the plane of focus, or before the lens, to the sensor."""
    end = float(world.tables.frames[SENSOR_FRAME, CAMERA_FRAME, 2, 3])
    distance = world.facts.object_distance_mm
    return (-distance if 0.0 < distance < np.inf else -end), end


def _signs(world: World) -> Iterator[Part]:
    """Yield the optical axis with its marks, and the outline of the camera's field in its plane of focus."""
    to_world = world.tables.frames[CAMERA_FRAME, WORLD_FRAME]
    start, end = _axis(world)
    step, high = tick_mm(world), 0.08 * max(world.lens_shape.rims)
    marks = step * np.arange(np.ceil(start / step), np.floor(end / step) + 1)
    half = np.where(np.round(marks / step) % 5 == 0, 2.0 * high, high)
    none = np.zeros(len(marks))
    ticks = [np.stack([none, -half, marks], axis=1), np.stack([none, half, marks], axis=1)]
    ends = np.concatenate([[[[0.0, 0.0, start], [0.0, 0.0, end]]], np.stack(ticks, axis=1)])
    thin = {"color": "#8796a8", "line_width": 1, "lighting": False}
    placed = frames.points(to_world, ends.reshape(-1, 3)).reshape(-1, 2, 3)
    yield Part("axis", "sign", line_segments(placed), thin)
    if world.facts.object_distance_mm == -start:
        x, y = (0.5 * size for size in world.facts.field_of_view_mm)
        corners = frames.points(to_world, [[-x, -y, start], [x, -y, start], [x, y, start], [-x, y, start]])
        sides = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
        yield Part("plane in focus", "sign", line_segments(sides), {**thin, "color": "#49c3b1"})
