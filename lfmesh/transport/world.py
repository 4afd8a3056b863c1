"""From a scene to what rays can meet: meshes, Embree scenes, and the tables that the kernels read."""

from collections.abc import Callable

import numpy as np
import trimesh
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError, SceneError
from lfmesh.geometry import frame as frames
from lfmesh.geometry.lattice import ROW_SPACING, Lattice
from lfmesh.geometry.lens_shape import LensShape, lens_shape
from lfmesh.geometry.lenslets import OFFSET, Lenslets, array_mesh, cell_mesh, lenslets
from lfmesh.geometry.levels import PATCH, SURFACE_LEVEL
from lfmesh.geometry.mesh import Array, Mesh, facet_normals, facet_table, joined
from lfmesh.geometry.patch import neighbours, patches
from lfmesh.geometry.refractors import measured
from lfmesh.geometry.surface import sag, surface
from lfmesh.geometry.targets import TargetMesh, target_mesh
from lfmesh.geometry.tessellation import (
    element,
    revolved,
)
from lfmesh.geometry.texture import wavelength_weights
from lfmesh.optics.glass import refractive_index
from lfmesh.scene import FirstOrder, Scene, first_order, solved
from lfmesh.transport.embree import Finder
from lfmesh.transport.packet import (
    ARRAY_FRAME,
    CAMERA_FRAME,
    FIRST_BODY,
    MOUNT,
    OBJECT_FRAME,
    SENSOR_FRAME,
    STOP,
    WORLD_FRAME,
)
from lfmesh.transport.tables import (
    DIRECTIONAL,
    DISK,
    LIGHT,
    POINT,
    SOURCE,
    Aim,
    ArrayTables,
    LensTables,
    ObjectTables,
    SensorTables,
    Tables,
)

PUPIL_MARGIN = 1.15
"""How much wider than the paraxial pupil the disk is that most rays are aimed at: pupils have aberrations."""

FIXED_SLOTS = (
    "emitted", "sensor", "escaped", "roulette added", "roulette removed", "sampling added", "sampling removed",
    "depth", "miss", "contradiction", "reflections not followed", "reached", "lit", "beside the sensor", "housing",
    "stop", "mount", "mla mount", "mla edge", "mla wall", "lens front",
)  # fmt: skip


class World:
    """A scene that rays can be traced through. Made by `build`."""

    def __init__(
        self, scene: Scene, report: FirstOrder, tables: Tables, finders: tuple[Finder, Finder, Finder],
        slots: list[str], lens: LensShape, targets: list[TargetMesh], housing: Mesh,
    ) -> None:  # fmt: skip
        self.scene = scene
        self.first_order = report
        self.tables = tables
        self.finders = finders
        self.slots = slots
        self.lens_shape = lens
        self._targets = targets
        self.housing = housing

    @property
    def mesh_names(self) -> list[str]:
        """What `mesh` knows: "lens[0]", ..., "mount", "stop", "mla", "sensor", "housing", "targets[0]", ..."""
        names = [f"lens[{i}]" for i in range(len(self.lens_shape.elements))]
        names += ["mount"] if self._mounts() else []
        names += ["stop"] + (["mla"] if self.tables.array.present else []) + ["sensor", "housing"]
        return names + [f"targets[{i}]" for i in range(len(self._targets))]

    def mesh(self, name: str) -> trimesh.Trimesh:
        """Return a body as a mesh in the world frame, mm.

        Lens elements and the array are closed solids, outward-oriented. Cemented elements are a solid each; the
        interface they share is one mesh to the rays.

        Raises
        ------
        LfmeshError
            No body has this name.
        """
        if name not in self.mesh_names:
            raise LfmeshError(f"no mesh is called {name!r}; there are {', '.join(self.mesh_names)}")
        kind, _, number = name.rstrip("]").partition("[")
        makers: dict[str, Callable[[], trimesh.Trimesh]] = {
            "lens": lambda: self._in_world(
                self._element(int(number)).solid(), self.tables.frames[CAMERA_FRAME, WORLD_FRAME]
            ),
            "mount": lambda: self._in_world(
                joined(self._mounts()).solid(), self.tables.frames[CAMERA_FRAME, WORLD_FRAME]
            ),
            "stop": lambda: self._in_world(self._stop(), self.tables.frames[CAMERA_FRAME, WORLD_FRAME]),
            "mla": lambda: self._in_world(
                array_mesh(self.tables.array.lenslets), self.tables.frames[ARRAY_FRAME, WORLD_FRAME]
            ),
            "sensor": lambda: self._in_world(self._sensor(), self.tables.frames[SENSOR_FRAME, WORLD_FRAME]),
            "housing": lambda: self._in_world(self.housing.solid(), self.tables.frames[CAMERA_FRAME, WORLD_FRAME]),
            "targets": lambda: self._targets[int(number)].mesh.solid(),
        }
        return makers[kind]()

    def surface_name(self, number: int) -> str:
        """Return what a recorded vertex's `surface` number stands for."""
        if number < 1000:
            return f"lens surface {self.lens_shape.numbers[number]}" if number >= 0 else "start"
        if number < 2000:
            return ("mla curved face", "mla flat face", "target", "glass")[number - 1000]
        return self.slots[number - 2000]

    @staticmethod
    def _in_world(mesh: trimesh.Trimesh, to_world: Array) -> trimesh.Trimesh:
        moved = Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces)).moved(to_world)
        return trimesh.Trimesh(moved.vertices, moved.faces, process=False)

    def _element(self, number: int) -> Mesh:
        shape = self.lens_shape
        k = shape.elements[number]
        return element(shape.caps[k], shape.closures[k], shape.caps[k + 1])

    def _mounts(self) -> list[Mesh]:
        shape = self.lens_shape
        return [mesh for k, mesh in enumerate(shape.closures) if shape.media[k + 1] is None]

    def _stop(self) -> trimesh.Trimesh:
        """Return the annulus round the stop's aperture."""
        surfaces = self.scene.camera.lens.surfaces
        number = next(i for i, s in enumerate(surfaces) if s.stop)
        z = self.scene.camera.lens.vertices_mm[number]
        inner = surfaces[number].semi_diameter_mm or 0.0
        outer = max(1.3 * inner, *self.lens_shape.rims)
        record = surface(
            surfaces[number].radius_mm, surfaces[number].conic, surfaces[number].asphere_mm, aperture=inner
        )
        z += float(sag(record, inner))
        return revolved(np.array([[outer, z], [inner, z]]), 96).solid()

    def _sensor(self) -> trimesh.Trimesh:
        x, y = (0.5 * size for size in self.scene.camera.sensor.size_mm)
        corners = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
        return trimesh.Trimesh(corners, [[0, 2, 1], [0, 3, 2]], process=False)


def build(scene: Scene, *, rings: int | None = None) -> World:
    """Build everything a scene's rays can meet.

    Parameters
    ----------
    scene : Scene
        Solved first, where distances or files are still open.
    rings : int, optional
        Rings of triangles a lens surface, in place of the scene's tessellation.

    Raises
    ------
    SceneError, MeshError, FileError
        The scene cannot be built: rims that cross, a mesh or texture that cannot be used, a target inside the camera.
    """
    scene = solved(measured(scene))
    report = first_order(scene)
    waves = scene.transport.wavelengths_nm
    shape = lens_shape(scene, rings)
    targets = [target_mesh(target, scene) for target in scene.targets]
    slots = [*FIXED_SLOTS, *(f"lens[{i}] edge" for i in range(len(shape.elements)))]
    target_slots = np.arange(len(targets)) + len(slots)
    slots += [target.name or f"targets[{i}]" for i, target in enumerate(scene.targets)]

    lens_mesh, lens = _lens_tables(scene, shape, waves)
    array_mesh_, array = _array_tables(scene, waves)
    middle = _middle(targets)
    moves = _frames(scene, middle)
    housing = _housing(scene, shape)
    _refuse_targets_inside(targets, housing, moves)
    object_mesh, objects = _object_tables(scene, targets, housing, moves, target_slots, waves)
    sensor = SensorTables(*scene.camera.sensor.pixels, scene.camera.sensor.pixel_mm)
    tables = Tables(lens, array, sensor, objects, moves, _aim(scene, report, lens, array, targets, moves))
    finders = (Finder(lens_mesh), Finder(array_mesh_), Finder(object_mesh))
    return World(scene, report, tables, finders, slots, shape, targets, housing)


def _lens_tables(scene: Scene, shape: LensShape, waves: tuple[float, ...]) -> tuple[Mesh, LensTables]:
    count = len(shape.caps)
    mesh = joined([*shape.caps, *shape.closures])
    bodies = np.repeat(
        [*range(count), *(-1 - s for s in range(1, count))],
        [len(m.faces) for m in (*shape.caps, *shape.closures)],
    )
    ring_slot = np.full(count + 1, MOUNT)
    for i, k in enumerate(shape.elements):
        ring_slot[k + 1] = FIRST_BODY + i
    stop_space, stop_z, stop_radius = _pure_stop(scene, shape)
    caps = np.concatenate([m.vertices for m in shape.caps])
    # The box stands off by a rounding error, so that a flat surface has one that a ray can enter.
    slack = 1e-9 * np.abs(caps).max()
    first, last = shape.surfaces[0], shape.surfaces[-1]
    return mesh, LensTables(
        shape.surfaces,
        *_curved(bool((shape.surfaces["level"] == PATCH).any()), mesh),
        facet_table(mesh, bodies.astype(np.int64)),
        np.array([[refractive_index(medium, w) for w in waves] for medium in shape.media]),
        ring_slot.astype(np.int64),
        np.where(shape.surfaces["stop"] == 1, STOP, MOUNT).astype(np.int64),
        stop_space,
        stop_z,
        stop_radius,
        caps.min(axis=0) - slack,
        caps.max(axis=0) + slack,
        bool(first["curvature"] >= 0 and first["terms"] == 0),
        bool(last["curvature"] <= 0 and last["terms"] == 0),
    )


def _pure_stop(scene: Scene, shape: LensShape) -> tuple[int, float, float]:
    """Return the space of a stop that is no refracting surface, its z and its radius; space −1: there is none."""
    prescription = scene.camera.lens
    for i, s in enumerate(prescription.surfaces):
        if prescription.is_pure_stop(i):
            space = sum(number < i for number in shape.numbers)
            return space, prescription.vertices_mm[i], float(s.semi_diameter_mm or np.inf)
    return -1, 0.0, np.inf


def _array_tables(scene: Scene, waves: tuple[float, ...]) -> tuple[Mesh, ArrayTables]:
    mla = scene.camera.mla
    if mla is None:
        nothing = lenslets(Lattice(False, 1.0, 1, 1), np.array([np.inf]), 1.0)
        empty = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
        return empty, _cells(False, False, nothing, empty, 0.0, np.ones(len(waves)), True)
    lattice = Lattice(
        mla.layout == "hexagonal", mla.pitch_mm * (1.0 + mla.form.pitch_error), mla.count[0], mla.count[1]
    )
    shapes = lenslets(
        lattice,
        np.asarray(mla.radius_mm, dtype=np.float64),
        mla.thickness_mm,
        decenter_mm=mla.form.decenter_mm,
        radius_error=mla.form.radius_error,
        seed=mla.form.seed,
    )
    shift = OFFSET * lattice.pitch
    cells = [cell_mesh(shapes, kind) for kind in range(mla.types)]
    mesh = joined(
        Mesh(np.add(c.vertices, [kind * shift, 0.0, 0.0]), c.faces, c.corner_normals) for kind, c in enumerate(cells)
    )
    index = np.array([refractive_index(mla.medium, w) for w in waves])
    return mesh, _cells(scene.transport.surface == "patch", True, shapes, mesh, shift, index, mla.curved_side == "lens")


def _cells(
    curved: bool, present: bool, shapes: Lenslets, mesh: Mesh, shift: float, index: Array, curved_to_lens: bool
) -> ArrayTables:
    bodies = np.zeros(len(mesh.faces), np.int64)
    return ArrayTables(present, shapes, *_curved(curved, mesh), facet_table(mesh, bodies), shift, index, curved_to_lens)


def _curved(needed: bool, mesh: Mesh) -> tuple[Array, NDArray[np.int64]]:
    """Return the patches of a mesh and their neighbours, empty where no surface needs them."""
    if not needed or mesh.corner_normals is None:
        return np.zeros((0, 6, 3)), np.zeros((0, 3), np.int64)
    return patches(mesh.vertices[mesh.faces], mesh.corner_normals), neighbours(mesh.faces, mesh.corner_normals)


def _middle(targets: list[TargetMesh]) -> Array:
    """Return the middle of the targets' bounding box in the world frame."""
    if not targets:
        return np.zeros(3)
    vertices = np.concatenate([t.mesh.vertices for t in targets])
    return np.asarray(0.5 * (vertices.min(axis=0) + vertices.max(axis=0)))


def _frames(scene: Scene, middle: Array) -> Array:
    """Return the (5, 5, 3, 4) moves between the frames of camera, array, objects, sensor and world."""
    camera = scene.camera
    to_world = [frames.IDENTITY] * 5
    to_world[CAMERA_FRAME] = frames.frame(camera.pose.tilt_deg, camera.pose.shift_mm)
    to_world[OBJECT_FRAME] = frames.frame(origin_mm=middle)
    face = camera.lens.vertices_mm[-1]
    array_to_camera = frames.IDENTITY
    if camera.mla is not None:
        mla = camera.mla
        face += mla.distance_mm or 0.0
        placed = frames.frame(mla.pose.tilt_deg, np.add([0.0, 0.0, face], mla.pose.shift_mm))
        turned = frames.IDENTITY
        if mla.curved_side == "sensor":
            turned = np.column_stack([np.diag([1.0, 1.0, -1.0]), [0.0, 0.0, mla.thickness_mm]])
        array_to_camera = frames.compose(placed, turned)
        face += mla.thickness_mm
    sensor = camera.sensor
    face += sensor.distance_mm or 0.0
    sensor_to_camera = frames.frame(sensor.pose.tilt_deg, np.add([0.0, 0.0, face], sensor.pose.shift_mm))
    # The camera's parts are moved among themselves without the world, whose origin may be far away.
    to_camera = {CAMERA_FRAME: frames.IDENTITY, ARRAY_FRAME: array_to_camera, SENSOR_FRAME: sensor_to_camera}
    moves = np.empty((5, 5, 3, 4))
    for here in range(5):
        if here in to_camera:
            to_world[here] = frames.compose(to_world[CAMERA_FRAME], to_camera[here])
    for here in range(5):
        for there in range(5):
            if here in to_camera and there in to_camera:
                moves[here, there] = frames.compose(frames.inverse(to_camera[there]), to_camera[here])
            else:
                moves[here, there] = frames.compose(frames.inverse(to_world[there]), to_world[here])
    return moves


def _housing(scene: Scene, shape: LensShape) -> Mesh:
    """Return the camera's outside: a plate round the first rim, the barrel, and the body round array and sensor."""
    barrel = 1.05 * max(shape.rims)
    front = float(shape.surfaces[0]["vertex_z"] + sag(shape.surfaces[0], shape.rims[0]))
    back = float(shape.surfaces[-1]["vertex_z"] + sag(shape.surfaces[-1], shape.rims[-1]))
    moves = _frames(scene, np.zeros(3))
    corners = [np.multiply(0.5, scene.camera.sensor.size_mm)]
    if scene.camera.mla is not None:
        corners.append(np.multiply(0.5, scene.camera.mla.size_mm))
    body = max(barrel, 1.1 * max(float(np.hypot(*corner)) for corner in corners))
    end = float(moves[SENSOR_FRAME, CAMERA_FRAME, 2, 3]) + 0.5 * body
    back = max(back, front)
    profile = [[shape.rims[0], front], [barrel, front], [barrel, back], [body, back], [body, end], [0.0, end]]
    mesh = revolved(np.array(profile), 6 * shape.rings)
    return Mesh(mesh.vertices, mesh.faces[facet_normals(mesh)[1] > 0.0])


def _refuse_targets_inside(targets: list[TargetMesh], housing: Mesh, moves: Array) -> None:
    """Refuse a target that reaches into the camera's outline."""
    radius = np.hypot(housing.vertices[:, 0], housing.vertices[:, 1])
    front, end = housing.vertices[:, 2].min(), housing.vertices[:, 2].max()
    barrel = radius[housing.vertices[:, 2] <= front + 1e-9].max()
    for i, target in enumerate(targets):
        p = frames.points(moves[WORLD_FRAME, CAMERA_FRAME], target.mesh.vertices)
        inside = (np.hypot(p[:, 0], p[:, 1]) < barrel) & (p[:, 2] > front) & (p[:, 2] < end)
        if inside.any():
            raise SceneError(
                f"targets[{i}] reaches into the camera, to z = {p[inside][:, 2].max():.6g} mm in the camera frame; "
                f"move it in front of z = {front:.6g} mm or beside the barrel (radius {barrel:.6g} mm)"
            )


def _object_tables(
    scene: Scene, targets: list[TargetMesh], housing: Mesh, moves: Array,
    target_slots: NDArray[np.int64], waves: tuple[float, ...],
) -> tuple[Mesh, ObjectTables]:  # fmt: skip
    to_object = moves[WORLD_FRAME, OBJECT_FRAME]
    parts = [t.mesh.moved(to_object) for t in targets]
    mesh = joined([*parts, housing.moved(moves[CAMERA_FRAME, OBJECT_FRAME])])
    bodies = np.repeat([*range(len(parts)), -1], [len(m.faces) for m in (*parts, housing)])
    facets = facet_table(mesh, bodies.astype(np.int64))
    uv = np.zeros((len(mesh.faces), 3, 2))
    texture = np.zeros((len(targets), 3), np.int64)
    weights = np.array([wavelength_weights(w) for w in waves])
    texels: list[NDArray[np.float32]] = []
    filled = 0
    for i, target in enumerate(targets):
        if target.texture is None or target.uv is None:
            continue
        uv[bodies == i] = target.uv
        height, width = target.texture.shape[:2]
        texture[i] = filled, height, width
        texels.append((target.texture.reshape(-1, 3) @ weights.T).astype(np.float32))
        filled += height * width
    materials = [t.material for t in scene.targets]
    radius = max((float(np.linalg.norm(m.vertices, axis=1).max()) for m in parts), default=0.0)
    glasses = [t.refractor for t in scene.targets]
    level = np.array([SURFACE_LEVEL[g.surface] if g is not None else 0 for g in glasses], dtype=np.int64)
    tables = ObjectTables(
        facets,
        uv,
        np.array([t.closed for t in targets], dtype=np.bool_),
        _by_wave([m.reflectance for m in materials], waves),
        _by_wave([m.radiance_w_m2_sr for m in materials], waves),
        np.array([[refractive_index(g.medium, w) if g is not None else 0.0 for w in waves] for g in glasses]).reshape(
            -1, len(waves)
        ),
        level,
        *_curved(bool((level == PATCH).any()), mesh),
        texture,
        np.concatenate(texels) if texels else np.zeros((0, len(waves)), np.float32),
        target_slots.astype(np.int64),
        _lights(scene, to_object),
        np.zeros(0, SOURCE),
        np.zeros(3),
        radius,
    )
    return mesh, tables._replace(sources=_sources(tables, mesh))


def _by_wave(values: list[float], waves: tuple[float, ...]) -> Array:
    return np.repeat(np.array(values, dtype=np.float64).reshape(-1, 1), len(waves), axis=1)


def _lights(scene: Scene, to_object: Array) -> NDArray[np.void]:
    table = np.zeros(len(scene.lights), LIGHT)
    for row, light in zip(table, scene.lights, strict=True):
        row["kind"] = {"point": POINT, "directional": DIRECTIONAL, "disk": DISK}[light.kind]
        row["direction"] = (0.0, 0.0, 1.0)
        if light.kind != "directional":
            row["position"] = frames.points(to_object, [light.position_mm])[0]
            row["power"] = light.power_w
        else:
            row["power"] = light.irradiance_w_m2
        if light.kind != "point":
            d = frames.directions(to_object, [light.direction])[0]
            row["direction"] = d / np.linalg.norm(d)
        if light.kind == "disk":
            row["radius"] = light.radius_mm
    return table


def _sources(objects: ObjectTables, mesh: Mesh) -> NDArray[np.void]:
    """Return what the forward method starts packets from, with shares in proportion to the power towards targets."""
    entries = []
    for i, light in enumerate(objects.lights):
        distance = float(np.linalg.norm(light["position"]))
        seen = 1.0
        if light["kind"] == DIRECTIONAL:
            power = light["power"] * np.pi * objects.radius**2 * 1e-6
        else:
            power = light["power"]
            if distance > objects.radius:
                seen = 0.5 * (1.0 - np.sqrt(1.0 - (objects.radius / distance) ** 2))
        entries.append((i, -1, power * seen, power))
    areas = facet_normals(mesh)[1]
    glow = objects.radiance.max(axis=1) if len(objects.radiance) else np.zeros(0)
    for facet in np.flatnonzero(np.append(glow > 0.0, False)[objects.facets["body"]]):
        body = objects.facets["body"][facet]
        sides = 1.0 if objects.closed[body] else 2.0
        power = np.pi * glow[body] * areas[facet] * 1e-6 * sides
        entries.append((-1, int(facet), power, power))
    table = np.zeros(len(entries), SOURCE)
    if entries:
        table["light"], table["facet"], table["share"], table["power"] = zip(*entries, strict=True)
        table["share"] /= table["share"].sum()
        table["until"] = np.cumsum(table["share"])
    return table


def _aim(
    scene: Scene,
    report: FirstOrder,
    lens: LensTables,
    array: ArrayTables,
    targets: list[TargetMesh],
    moves: Array,
) -> Aim:
    front_radius = _wide_radius(
        lens, [frames.points(moves[WORLD_FRAME, CAMERA_FRAME], t.mesh.vertices) for t in targets], front=True
    )
    width, height = (0.5 * size for size in scene.camera.sensor.size_mm)
    corners = np.array([[sx * width, sy * height, 0.0] for sx in (-1, 1) for sy in (-1, 1)])
    back_radius = _wide_radius(lens, [frames.points(moves[SENSOR_FRAME, CAMERA_FRAME], corners)], front=False)
    aim = Aim(
        report.entrance_pupil_z_mm,
        PUPIL_MARGIN * 0.5 * report.entrance_pupil_diameter_mm,
        float(lens.box_low[2]),
        front_radius,
        report.exit_pupil_z_mm,
        PUPIL_MARGIN * 0.5 * report.exit_pupil_diameter_mm,
        float(lens.box_high[2]),
        back_radius,
        0.0, 0.0, 0.0, 0.0, 0.0, np.zeros(1), 0,
    )  # fmt: skip
    # A pupil at infinity, or wider than the lens, is no place to aim at.
    if not np.isfinite(aim.entrance_z) or aim.entrance_radius > front_radius:
        aim = aim._replace(entrance_z=0.0, entrance_radius=0.0)
    if not array.present:
        if not np.isfinite(aim.exit_z) or aim.exit_radius > back_radius:
            aim = aim._replace(exit_z=0.0, exit_radius=0.0)
        return aim
    return _aim_through_lenslets(scene, report, array, aim, moves)


def _wide_radius(lens: LensTables, points: list[Array], *, front: bool) -> float:
    """Return the radius of a disk in the outermost plane of the lens that every ray from `points` to it crosses."""
    surfaces = lens.surfaces
    plane = lens.box_low[2] if front else lens.box_high[2]
    outer = surfaces[0] if front else surfaces[-1]
    rim = float(max(abs(lens.box_low[0]), abs(lens.box_high[0]), abs(lens.box_low[1]), abs(lens.box_high[1])))
    edge = float(outer["vertex_z"] + sag(outer, outer["aperture"]))
    depth = abs(max(outer["vertex_z"], edge) - plane) if front else abs(plane - min(outer["vertex_z"], edge))
    radius = 0.0
    for p in points:
        distance = np.maximum((plane - p[:, 2]) if front else (p[:, 2] - plane), depth)
        spread = (np.hypot(p[:, 0], p[:, 1]) + rim) * np.divide(
            depth, distance, out=np.zeros_like(distance), where=distance > 0
        )
        radius = max(radius, float(spread.max(initial=0.0)))
    return rim + radius


def _aim_through_lenslets(scene: Scene, report: FirstOrder, array: ArrayTables, aim: Aim, moves: Array) -> Aim:
    """Add the paraxial quantities that tell which lenslets show the exit pupil to a pixel."""
    mla = scene.camera.mla
    assert mla is not None
    glass = refractive_index(mla.medium, report.wavelength_nm)
    plate = mla.thickness_mm / glass
    to_sensor = scene.camera.sensor.distance_mm or 0.0
    to_pupil = scene.camera.lens.vertices_mm[-1] + (mla.distance_mm or 0.0) - report.exit_pupil_z_mm
    if array.curved_to_lens:
        to_sensor += plate
    else:
        to_pupil += plate
    vergence = 1.0 / to_pupil if np.isfinite(to_pupil) else 0.0
    slope = PUPIL_MARGIN / (2.0 * report.working_f_number)
    if np.isfinite(to_pupil):
        slope = abs(aim.exit_radius * vergence)
    power = (glass - 1.0) * array.lenslets.curvature
    pitch, radius = array.lenslets.lattice.pitch, array.lenslets.lattice.circumradius
    blur = np.abs(vergence + 1.0 / to_sensor - power).max() * radius
    # The lenslets that light a pixel lie this far at most from where its chief ray meets the array; a row of a
    # hexagonal lattice is nearer than a pitch and half a pitch aside.
    reach = to_sensor * (slope + blur) / pitch
    search = int(reach / ROW_SPACING + 1.0) if array.lenslets.lattice.hexagonal else int(reach + 0.5)
    pupil = [0.0, 0.0, report.exit_pupil_z_mm if np.isfinite(to_pupil) else scene.camera.lens.vertices_mm[-1]]
    pupil_x, pupil_y, _ = frames.points(moves[CAMERA_FRAME, ARRAY_FRAME], [pupil])[0]
    return aim._replace(
        lenslet_z=mla.thickness_mm - plate if array.curved_to_lens else 0.0,
        pupil_x=pupil_x,
        pupil_y=pupil_y,
        pupil_vergence=vergence,
        pupil_slope=slope,
        lenslet_power=power,
        search=search,
    )
