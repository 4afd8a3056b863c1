"""Landing error of rays through a faceted lens: each level of `surface` on ever finer meshes, against the truth.

The truth is `lfmesh.accuracy.analytic`. Two paths are measured: through the lens alone, to the plane of the microlenses
(or of the sensor), and through the whole camera, including the lenslets.
"""

import ctypes
import gc
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.accuracy import analytic
from lfmesh.geometry.array.array_mesh import cell_pattern
from lfmesh.geometry.array.lattice import Lattice
from lfmesh.geometry.frame import points
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.scene import Scene
from lfmesh.transport.build import build
from lfmesh.transport.packets.packet import SENSOR_FRAME, WORLD_FRAME, Status
from lfmesh.transport.trace import trace
from lfmesh.transport.world import World

LEVELS = ("flat", "smooth", "patch", "exact")
RINGS = (6, 12, 24, 48, 96)
"""Rings of triangles per surface; each step has four times as many triangles as the one before."""

QUICK_RINGS = (6, 12, 24)

EXACT_MULTIPLES = (1, 2, 4)
"""Multiples of the default mesh on which `exact` is measured, to show that its error does not depend on the mesh."""

RAYS = 1 << 16
QUICK_RAYS = 1 << 13

TIMED_RUNS = 2
TIMED_SECONDS = 0.2
"""The fastest of at least so many runs counts: other load on the machine only ever adds to a run's time."""

START_MM = 1.0
"""Distance of the rays' starts in front of the first point of the lens."""

LENS_ALONE, WHOLE_CAMERA = "lens", "camera"


class Bundle(NamedTuple):
    """Rays in the camera frame, (n, 3) each, with unit directions."""

    origins: NDArray[np.float64]
    directions: NDArray[np.float64]


@dataclass(frozen=True)
class LensRow:
    """One level on one mesh.

    Attributes
    ----------
    lens : str
        Name of the lens.
    way : str
        "lens": to the plane of its image; "camera": through the microlenses to the sensor.
    surface : str
        Level of `surface`.
    rings, triangles : int
        Per lens surface.
    rms_mm, max_mm, rms_px, max_px : float
        Distance between a ray's actual and true landing points.
    elsewhere : float
        Fraction of rays that land half a lenslet or more from the truth, through another lenslet. They count in
        `max_mm`, but not in `rms_mm`, which they would dominate.
    expected_mm : float
        Estimate of `rms_mm` by `lfmesh check`.
    rms_weight, max_weight : float
        Relative error of a ray's power.
    astray : float
        Fraction of rays that arrive but should not, or the reverse.
    lost, requeried : float
        Fraction of the power lost, and of events queried again.
    build_seconds : float
    table_bytes, process_bytes : int
        Size of the kernels' tables, and growth of the process including Embree's trees (0 if unknown or too small).
    events_per_second : float
        Ray-surface events per second of CPU time.
    rays : int
        Number of rays compared.
    """

    lens: str
    way: str
    surface: str
    rings: int
    triangles: int
    rms_mm: float
    max_mm: float
    rms_px: float
    max_px: float
    elsewhere: float
    expected_mm: float
    rms_weight: float
    max_weight: float
    astray: float
    lost: float
    requeried: float
    build_seconds: float
    table_bytes: int
    process_bytes: int
    events_per_second: float
    rays: int


@dataclass(frozen=True)
class LensStudy:
    """All rows of one lens, and the uncertainty of the truth.

    Attributes
    ----------
    default_rings : dict
        Default rings of a scene, by level.
    truth_error_mm : float or None
        Largest difference between the truth in float64 and in extended precision.
    lenslet_triangles : int
        Triangles of one lenslet's curved face, for any mesh of the lens; 0 without microlenses.
    """

    name: str
    pixel_mm: float
    rows: tuple[LensRow, ...]
    default_rings: dict[str, int]
    truth_error_mm: float | None
    lenslet_triangles: int = 0

    @property
    def ways(self) -> tuple[str, ...]:
        """Measured paths: through the lens alone and, with microlenses, the whole camera."""
        return tuple(dict.fromkeys(row.way for row in self.rows))

    def of(self, way: str, level: str | None = None) -> tuple[LensRow, ...]:
        """Return the rows of a way, optionally of one level only."""
        return tuple(row for row in self.rows if row.way == way and level in (None, row.surface))


def bare(scene: Scene) -> Scene:
    """Return a solved scene with only its camera, in the world frame."""
    scene = solved_camera(scene).scene
    return scene.camera_alone({"camera.pose": {}, "transport.engine": "auto"})


def lens_alone(scene: Scene) -> Scene:
    """Return a solved scene without its microlenses, with the sensor in their plane."""
    camera = scene.camera
    if camera.mla is None:
        return scene
    return scene.changed(
        {
            "camera.mla": None,
            "camera.sensor.distance_mm": camera.mla.distance_mm,
            "camera.sensor.pose": {},
            "camera.sensor.cover": None,
        }
    )


def lens_scene(file: Path) -> Scene:
    """Return a test scene for a lens file: object twenty focal lengths away, 25° of half field."""
    draft = {
        "camera": {
            "focus_mm": 1e3,
            "lens": {"file": str(file.resolve())},
            "sensor": {"pixels": [8, 8], "pixel_mm": 0.005, "distance_mm": 1.0},
        }
    }
    camera = solved_camera(Scene.model_validate(draft))
    lens, focal_length = camera.scene.camera.lens, camera.facts.efl_mm
    pixels = int(2 * np.tan(np.deg2rad(25.0)) * focal_length / 0.005)
    draft["camera"]["focus_mm"] = 20.0 * focal_length
    draft["camera"]["sensor"] = {"pixels": [pixels, pixels], "pixel_mm": 0.005}
    return solved_camera(Scene.model_validate({**draft, "name": lens.name or file.stem})).scene


def bundle(scene: Scene, rays: int, seed: int = 0) -> Bundle:
    """Return rays from the whole field through the whole entrance pupil of a solved scene's camera.

    Object points lie in the plane of focus and cover the sensor's view. The pupil is overfilled by a tenth; the truth
    decides which rays pass.

    Parameters
    ----------
    scene : Scene
        Solved.
    rays : int
    seed : int
    """
    known = solved_camera(scene)
    report, lens, camera = known.facts, known.paraxial, scene.camera
    image = (camera.mla or camera.sensor).distance_mm or 0.0
    distance = abs(lens.object_mm(image))
    pupil_z, pupil_radius = report.entrance_pupil_z_mm, 0.55 * report.entrance_pupil_diameter_mm
    widest = max(s.semi_diameter_mm or 0.0 for s in camera.lens.surfaces)
    if not np.isfinite(pupil_z) or pupil_radius > widest:
        pupil_z, pupil_radius = 0.0, widest
    half = 0.5 * np.asarray(camera.sensor.size_mm)
    # Slopes of the chief rays in object space.
    reach = abs(1.0 / lens.magnification(distance)) / (distance + pupil_z) if np.isfinite(distance) else 1 / lens.efl_mm
    random = np.random.default_rng(seed)
    field = random.uniform(-1.0, 1.0, (rays, 2)) * half * abs(reach)
    r, phi = pupil_radius * np.sqrt(random.random(rays)), 2.0 * np.pi * random.random(rays)
    pupil = np.column_stack([r * np.cos(phi), r * np.sin(phi), np.full(rays, pupil_z)])
    slope = -field + (pupil[:, :2] / (distance + pupil_z) if np.isfinite(distance) else 0.0)
    directions = np.column_stack([slope, np.ones(rays)])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    first = camera.lens.surfaces[0]
    start = min(0.0, first.sag_mm(first.semi_diameter_mm or 0.0)) - START_MM
    origins = pupil - directions * ((pupil_z - start) / directions[:, 2])[:, None]
    return Bundle(origins, directions)


def study_lens(
    scene: Scene,
    *,
    rings: tuple[int, ...] = RINGS,
    rays: int = RAYS,
    progress: Callable[[str], None] | None = None,
) -> LensStudy:
    """Measure a scene's lens, and the whole camera if it has microlenses, at every level that it can have, and mesh.

    Parameters
    ----------
    scene : Scene
    rings : tuple of int
        Rings of facets per surface, one mesh each.
    rays : int
    progress : callable of str, optional
        Called with the current step.

    Raises
    ------
    LfmeshError
        The lens has a mesh from a file, or the scene cannot be built.
    """
    scene = bare(scene)
    name = scene.camera.lens.name or scene.title or "lens"
    ways = [(LENS_ALONE, lens_alone(scene))]
    if scene.camera.mla is not None:
        ways.append((WHOLE_CAMERA, scene))
    levels = levels_of(scene)
    default = {level: solved_camera(scene.changed({"transport.surface": level})).lens_shape().rings for level in levels}
    rows: list[LensRow] = []
    errors: list[float | None] = []
    for way, camera in ways:
        wavelength = camera.primary_nm
        camera = camera.at_line(wavelength)
        sent = bundle(camera, rays)
        truth = analytic.Camera.of(camera, wavelength).land(*sent)
        errors.append(analytic.own_error(camera, wavelength, *(a[:2000] for a in sent)))
        # Let the compiler and the libraries allocate their memory before any is measured.
        trace(build(camera), *sent, wavelength, "transmit")
        for level in levels:
            for number in rings if level != "exact" else tuple(m * default["exact"] for m in EXACT_MULTIPLES):
                if progress is not None:
                    progress(f"{name}, {way}: {level}, {number} rings")
                rows.append(_measured(name, way, camera, level, number, sent, truth))
    known = [e for e in errors if e is not None]
    pixel = scene.camera.sensor.pixel_mm
    return LensStudy(name, pixel, tuple(rows), default, max(known) if known else None, _lenslet_triangles(scene))


def _lenslet_triangles(scene: Scene) -> int:
    mla = scene.camera.mla
    if mla is None:
        return 0
    return len(cell_pattern(Lattice(mla.layout == "hexagonal", mla.pitch_mm, *mla.count))[1])


def levels_of(scene: Scene) -> tuple[str, ...]:
    """Return the levels of `surface` that a scene can be traced at: phases and gradients need exact surfaces."""
    needs_exact = any(True for _ in (*scene.phases(), *scene.gradients()))
    return tuple(level for level in LEVELS if level == "exact" or not needs_exact)


def order_of(rows: Sequence[LensRow]) -> float:
    """Return the fitted order of the error in the facet size: rms ∝ rings^−order."""
    rings, errors = np.array([r.rings for r in rows]), np.array([r.rms_mm for r in rows])
    usable = errors > 0
    if usable.sum() < 2:
        return float("nan")
    return float(-np.polyfit(np.log(rings[usable]), np.log(errors[usable]), 1)[0])


def _measured(
    name: str, way: str, scene: Scene, level: str, rings: int, sent: Bundle, truth: analytic.Landing
) -> LensRow:
    scene = scene.changed({"transport.surface": level})
    release_freed_memory()
    before = resident_bytes()
    began = time.perf_counter()
    world = build(scene, rings=rings)
    build_seconds = time.perf_counter() - began
    # Embree builds its trees at the first query.
    wavelength = scene.primary_nm
    trace(world, sent.origins[:256], sent.directions[:256], wavelength, "transmit")
    release_freed_memory()
    grown = resident_bytes() - before
    seconds, spent, runs = np.inf, 0.0, 0
    while runs < TIMED_RUNS or spent < TIMED_SECONDS:
        began = time.process_time()
        paths = trace(world, sent.origins, sent.directions, wavelength, "transmit")
        took = time.process_time() - began
        seconds, spent, runs = min(seconds, took), spent + took, runs + 1

    landed = (paths.status == Status.SENSOR) | (np.array(paths.body) == "beside the sensor")
    both = landed & truth.arrives
    here = points(world.tables.frames[WORLD_FRAME, SENSOR_FRAME], paths.position[both])[:, :2]
    off = np.linalg.norm(here - truth.position[both], axis=1)
    weight = np.abs(paths.weight[both] / truth.weight[both] - 1.0)
    mla = scene.camera.mla
    elsewhere = off > 0.5 * mla.pitch_mm if mla is not None else np.zeros(len(off), np.bool_)
    rms = _rms(off[~elsewhere])
    errors = world.lens_shape.errors_mm
    return LensRow(
        lens=name,
        way=way,
        surface=level,
        rings=rings,
        triangles=max(len(cap.faces) for cap in world.lens_shape.caps),
        rms_mm=rms,
        max_mm=float(off.max(initial=0.0)),
        rms_px=rms / scene.camera.sensor.pixel_mm,
        max_px=float(off.max(initial=0.0)) / scene.camera.sensor.pixel_mm,
        elsewhere=float(elsewhere.mean()) if len(off) else 0.0,
        expected_mm=float(np.sqrt(np.sum(errors**2))),
        rms_weight=_rms(weight),
        max_weight=float(weight.max(initial=0.0)),
        astray=float((landed != truth.arrives).mean()),
        lost=paths.ledger.lost_share,
        requeried=paths.ledger.requeries / max(paths.ledger.events, 1),
        build_seconds=build_seconds,
        table_bytes=table_bytes(world),
        process_bytes=max(0, grown),
        events_per_second=paths.ledger.events / seconds,
        rays=int(both.sum()),
    )


def table_bytes(world: World) -> int:
    """Return the size of the kernels' tables, bytes: lens, array, objects."""
    parts = (*world.tables.lens, *world.tables.mla, *world.tables.objects)
    return sum(part.nbytes for part in parts if isinstance(part, np.ndarray))


def resident_bytes() -> int:
    """Return the memory of this process, bytes; 0 if the system does not report it."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")


def release_freed_memory() -> None:
    """Return freed memory to the system, so that it does not hide the next world's growth."""
    gc.collect()
    try:
        ctypes.CDLL(None).malloc_trim(0)
    except (AttributeError, OSError, TypeError):
        # Only the GNU C library has it.
        return


def lens_files() -> list[Path]:
    """Return the lens files that come with lfmesh."""
    from lfmesh.assets import asset_path

    return sorted(asset_path("lenses").glob("*.toml"))


def lens_scenes() -> list[Scene]:
    """Return a scene for each lens that comes with lfmesh."""
    return [lens_scene(file) for file in lens_files()]


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values * values))) if len(values) else 0.0
