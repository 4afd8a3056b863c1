"""Table for kernels of the media in object space that absorb, emit or scatter.

To add a quantity that varies by voxels, name it in `geometry.voxels`, give it a place in the rows here and use it in
`events.volume`.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.geometry import frame
from lfmesh.geometry.box_corners import corners_between
from lfmesh.geometry.meshes.shell_tree import tree_of
from lfmesh.geometry.objects.primitives import primitive
from lfmesh.geometry.objects.refractors import bounding_mesh
from lfmesh.geometry.voxels import OF_LINES, VoxelGrid, read_voxels
from lfmesh.kernels.by_address import by_address
from lfmesh.optics.cie import planck_constants
from lfmesh.optics.phase import PHASE, PhaseTables, phase_tables
from lfmesh.scene import Box, Cylinder, Scene, Sphere
from lfmesh.scene.light.spectra import Spectrum, curve_of, planck_curve
from lfmesh.scene.media.media import Medium, MeshBounds
from lfmesh.scene.media.phase import IsotropicPhase
from lfmesh.transport.packets.packet import CAMERA_FRAME, OBJECT_FRAME, WORLD_FRAME
from lfmesh.transport.tables.displaced import refuse_displaced
from lfmesh.transport.tables.hosts import Hosts
from lfmesh.transport.tables.lines import Lines
from lfmesh.transport.tables.phases import phase_functions
from lfmesh.transport.tables.spectra import emission_at, spread
from lfmesh.transport.tables.tables import NOTHING_NEAR_LAMPS, Media, SingleScatter

Array = NDArray[np.float64]

IN_FRONT, BOX, SPHERE, CYLINDER, SHELL = range(5)
"""Kinds of bounds."""

PER_VOLUME, OF_VOXELS, OF_BODY, BY_TEMPERATURE = range(4)
"""Kinds of emission: uniform, by voxels, as a body of one temperature, or by voxel temperatures."""

NOT_IN_GRID = -1

NOWHERE = -1

ROUNDING = 1e-12
"""Largest reach behind the first lens vertex that counts as rounding, relative to a medium's farthest corner."""

COLDEST_K = 1e-30
"""Stands for 0 K, where Planck's law is undefined; a body this cold does not shine either."""

BEYOND_BODY = 1.01
"""Size of the box of a medium that fills a body, over the body's own, so that it does not end in the body."""

W_MM3 = 1e6
"""W/(mm² sr) in W/(m² sr)."""

VOLUME = np.dtype(
    [
        ("inside", "i8"),  # rank of the body of glass or liquid around it; 0: air; NOWHERE: it only bends light
        ("bounds", "i8"),
        ("size", "f8", (3,)),  # mm: half edges of a box; radius; radius and half height of a cylinder
        ("box", "f8", (2, 3)),  # mm, lowest and highest corner of the bounds
        ("nodes", "i8", (2,)),  # first node of a mesh in `Volumes.shells`, and the one after its last
        ("to_own", "f8", (3, 4)),  # from the object frame into the medium's own
        ("cells", "i8", (3,)),  # voxels along x, y, z; 0: no grid
        ("constant", "i8"),  # 1: each voxel has one value throughout
        ("origin", "f8", (3,)),  # mm, centre of voxel 0
        ("spacing", "f8", (3,)),  # mm
        ("low", "f8", (3,)),  # mm, box of the grid or, without one, of the bounds
        ("high", "f8", (3,)),
        ("absorption", "i8"),  # first of the grid's values, or NOT_IN_GRID
        ("scattering", "i8"),
        ("emission", "i8"),  # W/(m² sr mm), or temperature
        ("emits", "i8"),
        ("slot", "i8"),  # of the book
        ("first", "i8"),  # first of `Volumes.until`
        ("drawn", "i8"),  # number of voxels to draw points from; 0: uniform from `low` to `high`
    ]
)


FITTED_K = 800.0, 2000.0
"""Temperatures at which `_planck_constants` are exact."""


@by_address
class Volumes(NamedTuple):
    """Media in object space; grid values are multiplied by the entry of their wavelength.

    The media of the scene come first, then the absorbing glasses and liquids that hold a medium.
    """

    rows: NDArray[np.void]  # (n,) VOLUME
    absorption: Array  # (n, wavelengths) 1/mm; 1 for a grid
    scattering: Array  # (n, wavelengths) 1/mm
    # (n, wavelengths) W/(m² sr mm); OF_BODY: radiance of the black body, W/(m² sr); BY_TEMPERATURE: n² of the place
    emission: Array
    planck: Array  # (2, wavelengths) of Planck's law c₁ / (exp(c₂ / T) − 1), W/(m² sr) and K
    values: Array  # of all grids, one after the other, each [x, y, z]
    until: Array  # of all emitting grids: cumulative probability of the voxels
    phases: PhaseTables
    isotropic: NDArray[np.void]  # (1,) PHASE, of emission
    powers: Array  # (n,) approximate emitted power, W; inf: no bounds
    scatters: bool  # scattered light is followed; otherwise it is lost
    emit: bool
    shells: Any = None  # ShellTree of the meshes that bound media; None: their code is not compiled
    near_lamps: SingleScatter = NOTHING_NEAR_LAMPS


def volume_tables(
    scene: Scene, moves: Array, lines: Lines, slots: NDArray[np.int64], hosts: Hosts
) -> tuple[Volumes | None, Media]:
    """Return the media of a scene, None if there are none, and the media of bodies without the absorption moved here.

    Parameters
    ----------
    scene : Scene
    moves : (6, 6, 3, 4) float64
        See `frame_table`.
    lines : Lines
    slots : (media,) int64
        Slots of the book.
    hosts : Hosts
        Bodies that may hold media.

    Raises
    ------
    SceneError, FileError
        A grid cannot be used, a spectrum is too short, or a medium reaches behind the lens or is displaced by bodies.
    """
    if not scene.media:
        return None, hosts.media
    wavelengths_nm = lines.wavelengths_nm
    holding = [scene.body_named(m.inside) if m.inside is not None else None for m in scene.media]
    absorbing = hosts.absorbing({body for body in holding if body is not None})
    rows = np.zeros(len(scene.media) + len(absorbing), VOLUME)
    absorption, scattering, emission = np.zeros((3, len(rows), len(wavelengths_nm)))
    values: list[Array] = [np.zeros(0)]
    filled = 0
    until: list[Array] = [np.zeros(0)]
    powers = np.zeros(len(rows))
    planck = _planck_constants(lines)
    shells: list[Array] = []
    with_shell: list[int] = []
    for i, (medium, body) in enumerate(zip(scene.media, holding, strict=True)):
        row = rows[i]
        where = f"media[{i}]"
        row["slot"] = slots[i]
        own = frame.frame(medium.rotation_deg, medium.position_mm)
        row["to_own"] = frame.compose(frame.inverse(own), moves[OBJECT_FRAME, WORLD_FRAME])
        corners = _set_bounds(scene, medium, row)
        if corners is not None:
            shells.append(corners)
            with_shell.append(i)
        if body is not None and medium.bounds is None and medium.grid is None:
            _fill(row, hosts, body, moves)
        row["low"], row["high"] = row["box"]
        absorption[i] = _coefficient(scene, medium.absorption_per_mm, lines, f"{where}.absorption_per_mm")
        scattering[i] = _coefficient(scene, medium.scattering_per_mm, lines, f"{where}.scattering_per_mm")
        row["absorption"] = row["scattering"] = row["emission"] = NOT_IN_GRID
        grid = _grid_of(scene, medium, where)
        hot = _is_hot(medium, grid)
        spectrum = np.zeros(len(wavelengths_nm))
        if grid is not None:
            row["cells"], row["constant"] = grid.shape, grid.interpolation == "constant"
            row["origin"], row["spacing"] = grid.origin_mm, grid.spacing_mm
            row["low"], row["high"] = grid.bounds_mm
            for key, place in (("absorption_per_mm", "absorption"), ("scattering_per_mm", "scattering"),
                               ("emission_w_mm3_sr", "emission"), ("temperature_k", "emission")):  # fmt: skip
                if key in grid.values and (hot or key != "temperature_k"):
                    row[place] = filled
                    values.append(grid.values[key].ravel())
                    filled += grid.values[key].size
            if "absorption_per_mm" in grid.values:
                absorption[i] = 1.0
            if "scattering_per_mm" in grid.values:
                scattering[i] = 1.0
        if hot and grid is not None and "temperature_k" in grid.values:
            row["emits"] = BY_TEMPERATURE
            spectrum = np.ones(len(wavelengths_nm))
        elif hot and medium.temperature_k is not None:
            row["emits"] = OF_BODY
            spectrum = lines.mean(planck_curve(medium.temperature_k, scene.reach_nm)) * lines.weight_nm
        elif grid is not None and "emission_w_mm3_sr" in grid.values:
            row["emits"] = OF_VOXELS
            spectrum = W_MM3 * spread(scene, 1.0, medium.spectrum, lines, f"{where}.spectrum")
        else:
            spectrum = W_MM3 * emission_at(
                scene, medium.emission_w_mm3_sr, medium.spectrum, lines, where, "emission_w_mm3_sr"
            )
        if body is not None:
            row["inside"] = hosts.rank[body]
        if not (medium.acts or hot or (grid is not None and any(key in grid.values for key in OF_LINES))):
            row["inside"] = NOWHERE
        if row["emits"] in (OF_BODY, BY_TEMPERATURE):
            # Kirchhoff: a black body's radiance in a medium is n² times that in air.
            spectrum = spectrum * hosts.index_of(body) ** 2
        emission[i] = spectrum
        if row["bounds"] == IN_FRONT and (emission[i] > 0.0).any() and not (absorption[i] > 0.0).all():
            raise SceneError(
                f"{where}: a medium without bounds that emits must absorb at every wavelength; give bounds"
            )
        if body is None:
            _refuse_behind_lens(row, where, moves, corners)
        boundary = _boundary(row, corners)
        if boundary is not None:
            to_world = frame.compose(moves[OBJECT_FRAME, WORLD_FRAME], frame.inverse(row["to_own"]))
            refuse_displaced(frame.points(to_world, boundary.reshape(-1, 3)).reshape(-1, 3, 3), where, hosts, body)
        if spectrum.any():
            brightness = _brightness(row, grid, absorption[i], spectrum, planck)
            powers[i] = 4.0 * np.pi / W_MM3 * brightness.sum() * np.prod(row["high"] - row["low"]) / brightness.size
            if brightness.size > 1 and powers[i] > 0.0:
                row["first"], row["drawn"] = sum(map(len, until)), brightness.size
                until.append(np.cumsum(brightness) / brightness.sum())
    count = len(scene.media)
    rows[count:], absorption[count:] = _of_bodies(absorbing, hosts, moves, len(wavelengths_nm))
    phases = _phases(scene, lines, holding, hosts, len(absorbing))
    tree = None
    if shells:
        tree, ends = tree_of(shells)
        rows["nodes"][with_shell] = ends
    volumes = Volumes(
        rows, absorption, scattering, emission, planck, np.concatenate(values), np.concatenate(until), phases,
        np.zeros(1, PHASE), powers, bool((scattering > 0.0).any()), bool((emission > 0.0).any()), tree,
    )  # fmt: skip
    return volumes, hosts.without_absorption(absorbing)


def volumes_at(volumes: Volumes, scene: Scene, moves: Array, lines: Lines, hosts: Hosts) -> tuple[Volumes, Media]:
    """Return media with absorption and scattering at other lines, unchanged emission, and no file read again.

    Parameters
    ----------
    volumes : Volumes
        Media of the scene.
    scene : Scene
    moves, lines
        As for `volume_tables`.
    hosts : Hosts
        Bodies with their media at these lines.

    Returns
    -------
    Volumes
    Media
        As from `volume_tables`.
    """
    count, wide = len(scene.media), len(lines.wavelengths_nm)
    holding = [scene.body_named(m.inside) if m.inside is not None else None for m in scene.media]
    # A body may absorb at these lines and be clear at the scene's, and the other way round.
    absorbing = hosts.absorbing({body for body in holding if body is not None})
    added, taken = _of_bodies(absorbing, hosts, moves, wide)
    rows = np.concatenate([volumes.rows[:count], added])
    absorption, scattering = np.zeros((2, len(rows), wide))
    absorption[count:] = taken
    for i, medium in enumerate(scene.media):
        for key, own in (("absorption_per_mm", absorption), ("scattering_per_mm", scattering)):
            in_grid = rows[key.removesuffix("_per_mm")][i] != NOT_IN_GRID
            own[i] = 1.0 if in_grid else _coefficient(scene, getattr(medium, key), lines, f"media[{i}].{key}")
    emission, powers = np.zeros((len(rows), volumes.emission.shape[1])), np.zeros(len(rows))
    emission[:count], powers[:count] = volumes.emission[:count], volumes.powers[:count]
    moved = volumes._replace(
        rows=rows, absorption=absorption, scattering=scattering, emission=emission, powers=powers,
        phases=_phases(scene, lines, holding, hosts, len(absorbing)),
        scatters=volumes.scatters or bool((scattering > 0.0).any()),
    )  # fmt: skip
    return moved, hosts.without_absorption(absorbing)


def _planck_constants(lines: Lines) -> Array:
    """Return c₁ and c₂ of Planck's law c₁ / (exp(c₂ / T) − 1) for each line, (2, lines), W/(m² sr) and K.

    They are corrected so that at two temperatures the law is the mean over the line's stratum: the light of a flame
    grows by some per cent per nanometre.
    """
    first, second = planck_constants(np.array(lines.wavelengths_nm))
    if lines.span_nm is not None:
        cold, hot = FITTED_K
        off_cold, off_hot = (
            np.log(lines.mean(planck_curve(t, lines.span_nm)) * np.expm1(second / t) / first) for t in FITTED_K
        )
        slope = (off_cold - off_hot) / (1.0 / cold - 1.0 / hot)
        first, second = first * np.exp(off_cold - slope / cold), second - slope
    return np.array([first * lines.weight_nm, second])


def _of_bodies(bodies: list[int], hosts: Hosts, moves: Array, wide: int) -> tuple[NDArray[np.void], Array]:
    """Return rows of media that absorb in place of bodies, and their coefficients at each wavelength."""
    rows, absorption = np.zeros(len(bodies), VOLUME), np.zeros((len(bodies), wide))
    for row, own, body in zip(rows, absorption, bodies, strict=True):
        own[:], row["slot"] = hosts.absorption_of(body)
        row["inside"] = hosts.rank[body]
        row["absorption"] = row["scattering"] = row["emission"] = NOT_IN_GRID
        _fill(row, hosts, body, moves)
    return rows, absorption


def _phases(scene: Scene, lines: Lines, holding: list[int | None], hosts: Hosts, more: int) -> PhaseTables:
    """Return the phase functions of the media, each in its body, and of `more` media that do not scatter."""
    functions = [
        phase_functions(m.phase, lines.wavelengths_nm, scene, f"media[{i}].phase", hosts.index_of(body))
        for i, (m, body) in enumerate(zip(scene.media, holding, strict=True))
    ]
    functions += [phase_functions(IsotropicPhase(), lines.wavelengths_nm, scene, "")] * more
    return phase_tables(functions)


def _brightness(row: np.void, grid: VoxelGrid | None, absorption: Array, spectrum: Array, planck: Array) -> Array:
    """Return the weights for drawing points: the mean emission over wavelengths, (voxels,) or (1,).

    In a trilinear grid, each voxel takes the largest value of itself and its neighbours, to include voxels that shine
    only in part.
    """
    # Only lines at which it shines, so that narrow-band light is not overlooked.
    body = absorption if row["emits"] in (OF_BODY, BY_TEMPERATURE) else np.ones_like(spectrum)
    shines = np.flatnonzero(body * spectrum > 0.0)
    if not len(shines):
        return np.zeros(1)
    some = shines[np.unique(np.linspace(0, len(shines) - 1, 8).astype(int))]
    # The other lines count as dark.
    count = len(some) * len(spectrum) / len(shines)
    if grid is None or (row["emission"] == NOT_IN_GRID and row["emits"] == PER_VOLUME):
        return np.array([(body * spectrum)[some].sum() / count])
    ones = np.ones(grid.shape)
    absorbs = grid.values.get("absorption_per_mm", ones)
    emission = np.zeros(grid.shape)
    for line in some:
        if row["emits"] == BY_TEMPERATURE:
            temperature = np.maximum(grid.values["temperature_k"], COLDEST_K)
            with np.errstate(over="ignore"):
                value = planck[0, line] / np.expm1(planck[1, line] / temperature)
            emission += absorption[line] * absorbs * value
        elif row["emits"] == OF_BODY:
            emission += absorption[line] * absorbs * spectrum[line]
        else:
            emission += grid.values["emission_w_mm3_sr"] * spectrum[line]
    if not row["constant"]:
        for axis in range(3):
            padded = np.pad(emission, [(1, 1) if i == axis else (0, 0) for i in range(3)], mode="edge")
            n = emission.shape[axis]
            emission = np.max([np.take(padded, range(k, k + n), axis) for k in range(3)], axis=0)
    return np.asarray(emission.ravel() / count)


def _set_bounds(scene: Scene, medium: Medium, row: np.void) -> Array | None:
    """Set the bounds of a medium; return the corners of its bounding mesh, if any, own frame, (m, 3, 3) mm."""
    match medium.bounds:
        case Box(size_mm=size):
            row["bounds"], row["size"] = BOX, np.multiply(0.5, size)
        case Sphere(radius_mm=radius):
            row["bounds"], row["size"] = SPHERE, (radius, radius, radius)
        case Cylinder(radius_mm=radius, height_mm=height):
            row["bounds"], row["size"] = CYLINDER, (radius, radius, 0.5 * height)
        case MeshBounds(file=file, units=units, node=node, tolerance_mm=tolerance):
            mesh = bounding_mesh(scene.resolve(str(file)), units, node, tolerance)
            corners = np.asarray(mesh.vertices[mesh.faces])
            row["bounds"], row["box"] = SHELL, (corners.min(axis=(0, 1)), corners.max(axis=(0, 1)))
            return corners
        case _:
            row["bounds"], row["size"] = IN_FRONT if medium.grid is None else BOX, (np.inf, np.inf, np.inf)
    row["box"] = -row["size"], row["size"]
    return None


def _fill(row: np.void, hosts: Hosts, body: int, moves: Array) -> None:
    """Extend a medium over a box round a body; it then exists wherever packets are in that body."""
    low, high = hosts.box_mm(body)
    middle = frame.frame((0.0, 0.0, 0.0), tuple((0.5 * (low + high)).tolist()))
    row["to_own"] = frame.compose(frame.inverse(middle), moves[OBJECT_FRAME, WORLD_FRAME])
    row["bounds"], row["size"] = BOX, 0.5 * BEYOND_BODY * (high - low)
    row["box"] = -row["size"], row["size"]
    row["low"], row["high"] = row["box"]


def _boundary(row: np.void, shell: Array | None) -> Array | None:
    """Return the corners of the facets of a medium's boundary, (m, 3, 3) mm, own frame; None if it is unbounded."""
    corners = corners_of(row)
    if corners is None:
        return None
    if row["cells"][0] == 0 and shell is not None:
        return shell
    low, high = corners[0], corners[-1]
    mesh = primitive(Box(size_mm=tuple((high - low).tolist()))).mesh
    if row["cells"][0] == 0 and row["bounds"] == SPHERE:
        mesh = primitive(Sphere(radius_mm=float(row["size"][0]))).mesh
    elif row["cells"][0] == 0 and row["bounds"] == CYLINDER:
        mesh = primitive(Cylinder(radius_mm=float(row["size"][0]), height_mm=2.0 * float(row["size"][2]))).mesh
    return np.asarray(mesh.vertices[mesh.faces] + 0.5 * (low + high))


def _grid_of(scene: Scene, medium: Medium, where: str) -> VoxelGrid | None:
    """Return the voxel grid of a medium; refuse a quantity given both in the grid and beside it."""
    given = medium.grid
    if given is None:
        return None
    grid = read_voxels(
        scene.resolve(given.file), given.spacing_mm, given.origin_mm, given.interpolation, given.quantity
    )
    for key in grid.values:
        beside = getattr(medium, key)
        if beside is not None and beside != 0.0:
            raise SceneError(f"{where}.{key}: {given.file} gives it by voxels; give one of them")
    own = "temperature_k" if "temperature_k" in grid.values else "emission_w_mm3_sr"
    if own in grid.values and (medium.temperature_k is not None or medium.emission_w_mm3_sr != 0.0):
        raise SceneError(f"{where}: {given.file} holds {own}, but the medium has another emission; give one of them")
    if not _is_hot(medium, grid):
        return grid
    key = f"{where}.grid: temperature_k" if own == "temperature_k" else f"{where}.temperature_k:"
    if scene.camera.sensor.bands is None:
        emits = "what absorbs also emits" if _absorbs(medium, grid) else "give pressure_kpa, if it is to set the index"
        raise SceneError(f"{key} needs camera.sensor.bands: single wavelengths have no width; {emits}")
    if not _absorbs(medium, grid):
        raise SceneError(f"{key} needs absorption_per_mm: without absorption no emission")
    return grid


def _is_hot(medium: Medium, grid: VoxelGrid | None) -> bool:
    """Return True if a medium emits by its temperature; that of air that absorbs nothing may set its index alone."""
    values = {} if grid is None else grid.values
    if medium.temperature_k is None and "temperature_k" not in values:
        return False
    return _absorbs(medium, grid) or (medium.pressure_kpa is None and "pressure_kpa" not in values)


def _absorbs(medium: Medium, grid: VoxelGrid | None) -> bool:
    return medium.absorption_per_mm != 0.0 or (grid is not None and "absorption_per_mm" in grid.values)


def _coefficient(scene: Scene, value: float | Spectrum, lines: Lines, where: str) -> Array:
    """Return a coefficient at each line, 1/mm."""
    ends = min(lines.wavelengths_nm), max(lines.wavelengths_nm)
    found = curve_of(value, ends, scene, where).at(lines.wavelengths_nm)
    if (found < 0.0).any():
        raise SceneError(f"{where}: value {found.min():g}: a coefficient must be 0 or more")
    return found


def corners_of(row: np.void) -> Array | None:
    """Return the corners of a box round a medium in its own frame, (8, 3) mm; None if it is unbounded."""
    low, high = row["box"]
    if row["cells"][0] > 0:
        low, high = np.maximum(low, row["low"]), np.minimum(high, row["high"])
    if not np.isfinite(low).all():
        return None
    return corners_between(low, high)


def _refuse_behind_lens(row: np.void, where: str, moves: Array, shell: Array | None) -> None:
    """Refuse a medium that reaches behind the first lens vertex; cut an unbounded one off there."""
    to_camera = frame.compose(moves[OBJECT_FRAME, CAMERA_FRAME], frame.inverse(row["to_own"]))
    corners = corners_of(row)
    if corners is None:
        # Its own frame becomes the camera's, and it lies at z < 0.
        row["to_own"] = moves[OBJECT_FRAME, CAMERA_FRAME]
        return
    placed = frame.points(to_camera, corners if shell is None or row["cells"][0] > 0 else shell.reshape(-1, 3))
    behind = placed[:, 2].max()
    if row["bounds"] == SPHERE and row["cells"][0] == 0:
        behind = to_camera[2, 3] + row["size"][0]
    if row["bounds"] == CYLINDER and row["cells"][0] == 0:
        axis = to_camera[2, :3]
        behind = to_camera[2, 3] + row["size"][2] * abs(axis[2]) + row["size"][0] * np.hypot(axis[0], axis[1])
    if behind > ROUNDING * np.abs(placed).max():
        raise SceneError(f"{where} reaches {behind:.6g} mm behind the first lens vertex; a medium must stay before it")


def corners_in_camera(volumes: Volumes | None, moves: Array) -> Array:
    """Return the corners of boxes round the bounded media, camera frame, (n, 3) mm.

    Parameters
    ----------
    volumes : Volumes or None
    moves : (6, 6, 3, 4) float64
        See `frame_table`.
    """
    found = [np.zeros((0, 3))]
    for row in volumes.rows if volumes is not None else ():
        corners = corners_of(row)
        if corners is not None:
            to_camera = frame.compose(moves[OBJECT_FRAME, CAMERA_FRAME], frame.inverse(row["to_own"]))
            found.append(frame.points(to_camera, corners))
    return np.concatenate(found)


def reach_of(volumes: Volumes | None) -> tuple[float, bool]:
    """Return the radius about the object frame's origin that holds all bounded media, and whether one is unbounded."""
    radius, endless = 0.0, False
    for row in volumes.rows if volumes is not None else ():
        corners = corners_of(row)
        if corners is None:
            endless = True
        else:
            radius = max(
                radius, float(np.linalg.norm(frame.points(frame.inverse(row["to_own"]), corners), axis=1).max())
            )
    return radius, endless
