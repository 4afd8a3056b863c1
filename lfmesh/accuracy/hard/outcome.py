"""Outcome of a hard case, and scenes and comparisons that the cases share."""

import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from lfmesh.accuracy.analytic_gradients import index_behind
from lfmesh.accuracy.analytic_phases import only_order
from lfmesh.accuracy.hard.truth import Array, Bundle, Interface, at_plane, through
from lfmesh.optics.glass import refractive_index
from lfmesh.scene import Camera, Lens, MicrolensArray, Refractor, Scene, Sensor, Surface, Target
from lfmesh.scene.objects.refractor import FacetLevel
from lfmesh.transport.build import build
from lfmesh.transport.render.image import Image
from lfmesh.transport.render.render import Renderer
from lfmesh.transport.trace import Status, trace
from lfmesh.transport.traced_paths import Paths
from lfmesh.transport.world import World


@dataclass(frozen=True)
class Outcome:
    """Result of one hard case.

    Attributes
    ----------
    cause : str
        Difficulty of the case.
    expected, got : str
        The right answer and the engine's, in words and figures.
    passed : bool
        The answer is right for every ray that is not lost.
    lost_energy, emitted : float
        In units of one ray's power.
    requeried : int
        Queries refused in float64 and repeated.
    """

    cause: str
    expected: str
    got: str
    passed: bool
    lost_energy: float
    emitted: float
    requeried: int


def case(function: Callable[[], Outcome]) -> Callable[[], Outcome]:
    """Turn a function into a hard case; the first line of its docstring is the cause shown to users."""

    @wraps(function)
    def run() -> Outcome:
        return replace(function(), cause=(function.__doc__ or "").partition("\n")[0])

    return run


Prescription = Sequence[tuple[float, float, float]]
"""(radius, thickness behind, index behind) of each surface, mm."""


def surfaces_of(prescription: Prescription, aperture: float = 10.0) -> list[Surface]:
    """Return the surfaces of a prescription; the first is the stop."""
    last = len(prescription) - 1
    return [
        Surface(
            radius_mm=radius,
            thickness_mm=thickness if k < last else None,
            index=index if k < last else None,
            semi_diameter_mm=aperture,
            stop=k == 0,
        )
        for k, (radius, thickness, index) in enumerate(prescription)
    ]


SINGLET = surfaces_of(((50.0, 4.0, 1.5168), (-50.0, 0.0, 1.0)))
"""The default biconvex lens of the cases."""


def lens_scene(
    surfaces: Sequence[Surface], *, sensor_mm: float = 60.0, distance: float = 40.0,
    mla: MicrolensArray | None = None, targets: tuple[Target, ...] = (),
) -> Scene:  # fmt: skip
    """Return a camera with a lens and a sensor at a distance behind it.

    Parameters
    ----------
    surfaces : sequence of Surface
    sensor_mm : float, mm
        Side of the square sensor.
    distance : float, mm
        From the last vertex, or the array, to the sensor.
    mla : MicrolensArray, optional
    targets : tuple of Target
    """
    return Scene(
        camera=Camera(
            lens=Lens(surfaces=tuple(surfaces)),
            mla=mla,
            sensor=Sensor(pixels=(60, 60), pixel_mm=sensor_mm / 60.0, distance_mm=distance),
        ),
        targets=targets,
    )


def sensor_z(scene: Scene) -> float:
    """Return z of the sensor of a camera without an array."""
    return scene.camera.lens.vertices_mm[-1] + (scene.camera.sensor.distance_mm or 0.0)


def faces_of(scene: Scene) -> list[Interface]:
    """Return the lens in the format of the truth, without pure stops."""
    lens = scene.camera.lens
    nm, media = scene.primary_nm, lens.media
    return [
        Interface(
            s.vertex_radius_mm, z, index_behind(media[k + 1], nm, z), s.vertex_conic, s.terms_mm,
            1.01 * (s.semi_diameter_mm or 10.0), s.focal_length_mm or np.inf, s.odd_asphere_mm, _across(s),
            only_order(s.phase, nm, media[k], media[k + 1], f"camera.lens.surfaces[{k}].phase"), _zone(s),
        )
        for k, (s, z) in enumerate(zip(lens.surfaces, lens.vertices_mm, strict=True))
        if not lens.is_pure_stop(k)
    ]  # fmt: skip


def _across(surface: Surface) -> tuple[str, float, float] | None:
    """Return the x–z section of a surface in the format of the truth."""
    if surface.biconic is not None:
        return "biconic", surface.biconic.radius_x_mm, surface.biconic.conic_x
    if surface.toroid is not None:
        return "toroid", surface.toroid.radius_x_mm, 0.0
    if surface.form is not None and surface.outer_zone is None:
        raise NotImplementedError(f"{surface.section_key}: `hard.truth` has no such surface")
    return None


def _zone(surface: Surface) -> tuple[float, Interface] | None:
    """Return the outer zone of a surface in the format of the truth."""
    zone = surface.outer_zone
    if zone is None:
        return None
    return zone.border_mm, Interface(zone.radius_mm, 0.0, conic=zone.conic, asphere=zone.asphere_mm)


def disk(radius: float, count: int, seed: int = 0) -> Array:
    """Return (count, 2) random points of uniform density on a disk.

    Parameters
    ----------
    radius : float
    count : int
    seed : int
    """
    draw = np.random.default_rng(seed)
    r, phi = radius * np.sqrt(draw.uniform(size=count)), draw.uniform(0.0, 2.0 * np.pi, count)
    return np.column_stack([r * np.cos(phi), r * np.sin(phi)])


def tilted(count: int, spread: float, seed: int = 1) -> Array:
    """Return (count, 3) unit directions round +z with slopes up to `spread`.

    Parameters
    ----------
    count : int
    spread : float
        Largest slope.
    seed : int
    """
    d = np.column_stack([disk(spread, count, seed), np.ones(count)])
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))


def outcome(paths: Paths | Sequence[Paths], expected: str, got: str, passed: bool) -> Outcome:
    """Return an outcome with the ledgers of its traces.

    Parameters
    ----------
    paths : Paths or sequence of Paths
    expected, got : str
    passed : bool
        Apart from the ledgers, which must balance as well.
    """
    ledgers = [p.ledger for p in ([paths] if isinstance(paths, Paths) else paths)]
    closes = max(abs(ledger.imbalance) for ledger in ledgers)
    if not closes < 1e-9:
        got += f"; the books are {closes:.1e} out of balance"
    return Outcome(
        "",
        expected,
        got,
        bool(passed and closes < 1e-9),
        sum(sum(ledger.lost.values()) for ledger in ledgers),
        sum(ledger.emitted for ledger in ledgers),
        sum(ledger.requeries for ledger in ledgers),
    )


def images_of(scene: Scene, seeds: Iterable[int], **transport: Any) -> list[Image]:
    """Return the images of a scene by seed, without the blind check; `transport` overrides the scene's settings."""
    world = build(scene.changed({f"transport.{name}": value for name, value in transport.items()}))
    return [Renderer(world.reseeded(seed), check=False).image() for seed in seeds]


def of_images(images: Sequence[Image], expected: str, got: str, passed: bool) -> Outcome:
    """Return an outcome with the ledgers of images, each packet's power counted as 1.

    Parameters
    ----------
    images : sequence of Image
    expected, got : str
        In words.
    passed : bool
        Apart from the ledgers, which have to close as well.
    """
    ledgers = [image.ledger for image in images]
    closes = max(abs(ledger.imbalance) for ledger in ledgers)
    if not closes < 1e-9:
        got += f"; the books are {closes:.1e} out of balance"
    return Outcome(
        "", expected, got, bool(passed and closes < 1e-9),
        sum(ledger.lost_share * ledger.packets for ledger in ledgers),
        float(sum(ledger.packets for ledger in ledgers)),
        sum(ledger.requeries for ledger in ledgers),
    )  # fmt: skip


MOST_SIGMAS = 4.0
"""Largest difference of two estimates: chance exceeds it once in about a thousand comparisons of a few seeds."""


def same_light(images: Sequence[Image], others: Sequence[Image], largest: float) -> Outcome:
    """Compare the power of two sets of images by the scatter over their seeds.

    Parameters
    ----------
    images, others : sequence of Image
    largest : float
        Largest acceptable standard error of the ratio, relative.
    """
    one, other = (np.array([image.mean.sum() for image in each]) for each in (images, others))
    ratio = float(one.mean() / other.mean())
    sigma = float(np.hypot(*(each.std(ddof=1) / np.sqrt(len(each)) / each.mean() for each in (one, other))))
    return of_images(
        [*images, *others], f"the same light, to {largest:.1%}", f"{ratio:.4f} ± {sigma:.4f} of it",
        sigma < largest and abs(ratio - 1.0) < MOST_SIGMAS * sigma,
    )  # fmt: skip


def on_sensor(
    paths: Paths,
    truth: Array,
    weight: Array,
    tolerance: float,
    *,
    stopped: NDArray[np.bool_] | None = None,
    relative: float = 1e-12,
) -> Outcome:
    """Compare the landing points of rays, one packet per ray, with the truth.

    A comparison fails if it covers at most a hundred rays, or a fifth of the rays that should arrive.

    Parameters
    ----------
    truth : (n, 3) mm
    weight : (n,)
    tolerance : float, mm
        Of the landing points.
    stopped : (n,) bool, optional
        Rays that an aperture must stop; the others must all reach the sensor's plane. A ray with a NaN truth is totally
        reflected and may end anywhere, but must not be lost; or it is evanescent and leaves no packet.
    relative : float
        Tolerance of the weights.
    """
    count = len(truth)
    known = np.asarray(np.isfinite(truth).all(axis=1))
    missing = np.bincount(paths.source, minlength=count) == 0
    if len(paths) + int(missing.sum()) != count or (missing & known).any():
        return outcome(paths, f"{count} packets", f"{len(paths)} packets", False)
    truth, weight, known = truth[paths.source], weight[paths.source], known[paths.source]
    kept = known if stopped is None else known & ~stopped[paths.source]
    arrived = (paths.status == Status.SENSOR) | (np.array(paths.body) == "beside the sensor")
    lost = paths.status == Status.LOST
    wrong = int(((arrived != kept) & known & ~lost).sum())
    # Beside the sensor, a ray may land so far out that rounding shows.
    both = (paths.status == Status.SENSOR) & kept
    error = np.linalg.norm(paths.position - truth, axis=1)[both].max(initial=0.0)
    loss = np.abs(paths.weight / weight - 1.0)[both].max(initial=0.0)
    return outcome(
        paths,
        f"{int(kept.sum())} of {count} rays at the sensor, within {tolerance:.0e} mm",
        f"{int(arrived.sum())} arrive, {wrong} end wrongly, {int(lost.sum())} lost; error of {int(both.sum())} "
        f"compared {error:.1e} mm, of the weight {loss:.1e}",
        wrong == 0 and bool(both.sum() > max(100, 0.2 * kept.sum())) and error <= tolerance and loss <= relative,
    )


def through_lens(
    scene: Scene, origins: ArrayLike, directions: ArrayLike, tolerance: float, *,
    world: World | None = None, relative: float = 1e-12,
) -> Outcome:  # fmt: skip
    """Trace rays through a lens and compare them with the truth, including apertures.

    Parameters
    ----------
    scene : Scene
    origins : (n, 3) float64, mm, world frame
    directions : (n, 3) float64
    tolerance, relative : float
        See `on_sensor`.
    world : World, optional
        The scene, if already built.
    """
    paths = trace(world or build(scene), origins, directions, split="transmit")
    outside = refractive_index(scene.camera.lens.media[0], scene.primary_nm)
    true = through(faces_of(scene), origins, directions, outside)
    return on_sensor(
        paths, at_plane(true.p, true.d, sensor_z(scene)), true.weight, tolerance,
        stopped=cut(scene, true), relative=relative,
    )  # fmt: skip


def cut(scene: Scene, true: Bundle) -> NDArray[np.bool_]:
    """Tell which rays are stopped by an aperture of the lens."""
    lens = scene.camera.lens
    limits = [s.semi_diameter_mm or np.inf for k, s in enumerate(lens.surfaces) if not lens.is_pure_stop(k)]
    return np.asarray(~(true.heights <= limits).all(axis=1))


def world_with(
    mesh: trimesh.Trimesh, *, ending: str = "stl", position_mm: tuple[float, float, float], index: float | None = None,
    surface: FacetLevel = "patch",
) -> World:  # fmt: skip
    """Build the singlet with a body from a mesh file in front of it, of glass if it has an index.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        Vertices in mm.
    ending : str
        Ending of the mesh file.
    position_mm : (x, y, z), mm, world frame
    index : float, optional
        Refractive index. Default: opaque.
    surface : str
    """
    with tempfile.TemporaryDirectory(prefix="lfmesh-") as folder:
        name = f"body.{ending}"
        mesh.export(Path(folder) / name)
        if index is None:
            body = Target(file=name, units="mm", position_mm=position_mm)
        else:
            glass = Refractor(file=name, units="mm", index=index, surface=surface)
            body = Target(refractor=glass, position_mm=position_mm)
        return build(lens_scene(SINGLET, targets=(body,)).in_folder(Path(folder)))
