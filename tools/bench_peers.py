"""The main lens of a scene in other people's tracers: batoid, optiland and mitsuba, for tools/bench lens.

Each does the least that lands its rays on the sensor's plane, so the comparison errs in its favour: no apertures, and
no weights but mitsuba's. Rays come in the camera frame; `landing` answers in mm.
"""

import json
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.accuracy.lens_accuracy import Bundle
from lfmesh.geometry.lens.lens_shape import LensShape, lens_shape
from lfmesh.geometry.surfaces.sag import normals
from lfmesh.optics.glass import refractive_index
from lfmesh.scene import Scene

Array = NDArray[np.float64]

INSTALL = "install the extra: .venv/bin/pip install -e '.[bench]'"
MM_PER_M = 1e3
NM_PER_UM = 1e3
MITSUBA_RINGS = 56
"""Of triangles a surface: 19,000 triangles, 190,000 for a double Gauss. Finer meshes are no better in float32."""


@dataclass(frozen=True)
class Peer:
    """A tracer with the lens built in.

    Attributes
    ----------
    name : str
    triangles : int or None
        A surface, where it takes meshes.
    prepare : callable
        Makes rays for one run: some tracers move them in place.
    run : callable
        Traces what `prepare` made.
    landing : callable
        Returns (n, 2) mm and (n,) weights, ones where it has none, from what `run` returned.
    """

    name: str
    triangles: int | None
    prepare: Callable[[], Any]
    run: Callable[[Any], Any]
    landing: Callable[[Any], tuple[Array, Array]]


@dataclass(frozen=True)
class Interface:
    """A refracting surface, with the indices around it."""

    radius_mm: float
    conic: float
    asphere_mm: tuple[float, ...]
    vertex_mm: float
    before: float
    after: float


def interfaces_of(scene: Scene, wavelength_nm: float) -> list[Interface]:
    """Return the refracting surfaces of a solved scene's lens."""
    lens, found, before = scene.camera.lens, [], 1.0
    for number, (surface, z) in enumerate(zip(lens.surfaces, lens.vertices_mm, strict=True)):
        if not lens.is_pure_stop(number):
            after = refractive_index(surface.medium, wavelength_nm)
            found.append(Interface(surface.radius_mm, surface.conic, surface.asphere_mm, z, before, after))
            before = after
    return found


def image_plane_mm(scene: Scene) -> float:
    """Return where the sensor of a solved scene without microlenses stands."""
    return scene.camera.lens.vertices_mm[-1] + (scene.camera.sensor.distance_mm or 0.0)


def fault_of(name: str) -> str | None:
    """Return why a peer cannot be used, or None. Mitsuba is tried in a child: a wrong LLVM ends the process."""
    program = f"import bench_peers; bench_peers.try_peer({name!r})"
    child = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=Path(__file__).parent)
    if child.returncode == 0:
        return None
    said = child.stdout.strip().splitlines()
    if said:
        return str(json.loads(said[-1]))
    if name == "mitsuba":
        return "it ends its process; name another LLVM (19 works) in DRJIT_LIBLLVM_PATH"
    return f"its import fails: {(child.stderr.strip().splitlines() or ['no message'])[-1]}"


def try_peer(name: str) -> None:
    """Use a peer a little; print why it fails, and exit with 1 then."""
    fault = None
    try:
        module = imported(name)
        if name == "mitsuba":
            mitsuba_variant(module)
            sphere = module.load_dict({"type": "scene", "a": {"type": "sphere"}})
            ray = module.Ray3f([0.0, 0.0, -3.0], module.Vector3f(0.0, 0.0, 1.0))
            float(sphere.ray_intersect(ray).t[0])
    except ModuleNotFoundError:
        fault = f"not installed; {INSTALL}"
    except Exception as error:  # whatever a stranger's code may raise is a reason to go on without it
        fault = str(error).splitlines()[0] if name != "mitsuba" else no_llvm(error)
    if fault is not None:
        print(json.dumps(fault))
        sys.exit(1)


def no_llvm(error: Exception) -> str:
    return (
        "no LLVM that it can use; name one (19 works; Debian: libllvm19) in DRJIT_LIBLLVM_PATH "
        f"({str(error).splitlines()[0]})"
    )


def imported(name: str) -> Any:
    """Import a peer; batoid turns every warning of the process into an error, which is undone."""
    with warnings.catch_warnings():
        return import_module(name)


def batoid_peer(scene: Scene, sent: Bundle, threads: int) -> Peer:
    """Build the lens for batoid, in metres as its documentation has them."""
    batoid = imported("batoid")
    wavelength = scene.primary_nm
    m = 1.0 / MM_PER_M

    def shape(of: Interface) -> Any:
        if any(of.asphere_mm):
            # a r^(2j + 4) in mm is a 1000^(2j + 3) r^(2j + 4) in m.
            terms = [a * MM_PER_M ** (2 * j + 3) for j, a in enumerate(of.asphere_mm)]
            return batoid.Asphere(of.radius_mm * m, of.conic, terms)
        if of.conic:
            return batoid.Quadric(of.radius_mm * m, of.conic)
        return batoid.Sphere(of.radius_mm * m) if np.isfinite(of.radius_mm) else batoid.Plane()

    def at(z_mm: float) -> Any:
        return batoid.CoordSys(np.array([0.0, 0.0, z_mm * m]), np.eye(3))

    medium = batoid.ConstMedium
    items = [
        batoid.RefractiveInterface(
            shape(i),
            name=f"surface {n}",
            coordSys=at(i.vertex_mm),
            inMedium=medium(i.before),
            outMedium=medium(i.after),
        )
        for n, i in enumerate(interfaces_of(scene, wavelength))
    ]
    air = {"inMedium": medium(1.0), "outMedium": medium(1.0)}
    items.append(batoid.Detector(batoid.Plane(), name="sensor", coordSys=at(image_plane_mm(scene)), **air))
    optic = batoid.CompoundOptic(items, **air)
    rays = batoid.RayVector(*(sent.origins.T * m), *sent.directions.T, wavelength=wavelength * 1e-9)

    def landing(arrived: Any) -> tuple[Array, Array]:
        return np.column_stack([arrived.x, arrived.y]) * MM_PER_M, np.ones(len(arrived))

    return Peer("batoid", None, rays.copy, optic.trace, landing)


def optiland_peer(scene: Scene, sent: Bundle, threads: int) -> Peer:
    """Build the lens for optiland with its numpy back end, whose intersections numba compiles."""
    imported("optiland")
    from optiland.materials import IdealMaterial
    from optiland.optic import Optic
    from optiland.rays import RealRays

    # It compiles at first use, and numba warns of its code.
    warnings.filterwarnings("ignore", module="numba.*")
    wavelength = scene.primary_nm
    interfaces = interfaces_of(scene, wavelength)
    ends = [i.vertex_mm for i in interfaces[1:]] + [image_plane_mm(scene)]
    optic = Optic()
    optic.surfaces.add(index=0, radius=np.inf, thickness=np.inf)
    for number, (one, end) in enumerate(zip(interfaces, ends, strict=True), start=1):
        # Its terms begin at r².
        aspheric = (
            {"surface_type": "even_asphere", "coefficients": [0.0, *one.asphere_mm]} if any(one.asphere_mm) else {}
        )
        optic.surfaces.add(
            index=number, radius=one.radius_mm, conic=one.conic, thickness=end - one.vertex_mm,
            material=IdealMaterial(one.after), is_stop=number == 1, **aspheric,
        )  # fmt: skip
    optic.surfaces.add(index=len(interfaces) + 1)
    optic.set_aperture(aperture_type="EPD", value=1.0)
    optic.fields.set_type(field_type="angle")
    optic.fields.add(y=0)
    optic.wavelengths.add(value=wavelength / NM_PER_UM, is_primary=True)
    count = len(sent.origins)

    def prepare() -> Any:
        x, y, z = sent.origins.T.copy()
        return RealRays(x, y, z, *sent.directions.T.copy(), np.ones(count), np.full(count, wavelength / NM_PER_UM))

    def run(rays: Any) -> Any:
        return optic.surfaces.trace(rays, skip=1, record=False)

    return Peer("optiland", None, prepare, run, lambda rays: (np.column_stack([rays.x, rays.y]), np.ones(count)))


def mitsuba_variant(mitsuba: Any) -> None:
    """Choose the variant that compiles for the processor."""
    mitsuba.set_variant("llvm_ad_rgb")


def mitsuba_mesh(mitsuba: Any, name: str, vertices: Array, faces: NDArray[np.int64], normal: Array, bsdf: Any) -> Any:
    """Return a mesh with vertex normals; `bsdf` as `load_dict` takes it."""
    properties = mitsuba.Properties()
    properties["bsdf"] = mitsuba.load_dict(bsdf)
    mesh = mitsuba.Mesh(name, len(vertices), len(faces), has_vertex_normals=True, props=properties)
    parameters = mitsuba.traverse(mesh)
    parameters["vertex_positions"] = np.ascontiguousarray(vertices, np.float32).ravel()
    parameters["vertex_normals"] = np.ascontiguousarray(normal, np.float32).ravel()
    parameters["faces"] = np.ascontiguousarray(faces, np.uint32).ravel()
    parameters.update()
    return mesh


def mitsuba_lens(mitsuba: Any, scene: Scene, shift_mm: float, rings: int = MITSUBA_RINGS) -> dict[str, Any]:
    """Return the surfaces of a solved scene's lens as meshes of dielectrics, each with exact normals at its vertices.

    Parameters
    ----------
    shift_mm : float
        Added to z: Mitsuba's float32 keeps most digits near its origin.
    """
    shape: LensShape = lens_shape(scene, rings)
    wavelength = scene.primary_nm
    indices = [refractive_index(medium, wavelength) for medium in shape.media]
    meshes = {}
    for k, (cap, record) in enumerate(zip(shape.caps, shape.surfaces, strict=True)):
        normal = normals(record, cap.vertices[:, 0], cap.vertices[:, 1])
        normal *= np.sign(normal[:, 2:])
        corners = cap.vertices[cap.faces]
        looks = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
        faces = np.where((looks > 0.0)[:, None], cap.faces, cap.faces[:, ::-1])
        # Normals look towards +z; a dielectric's outside is where they look.
        glass = {"type": "dielectric", "ext_ior": indices[k + 1], "int_ior": indices[k]}
        meshes[f"surface_{k}"] = mitsuba_mesh(
            mitsuba, f"surface_{k}", np.add(cap.vertices, [0.0, 0.0, shift_mm]), faces, normal, glass
        )
    return meshes


def mitsuba_peer(scene: Scene, sent: Bundle, threads: int) -> Peer:
    """Build the lens for Mitsuba: meshes with smooth normals, and a loop that refracts through them, weighted."""
    mitsuba, drjit = imported("mitsuba"), imported("drjit")
    mitsuba_variant(mitsuba)
    drjit.set_thread_count(threads)
    wavelength = scene.primary_nm
    indices = [1.0, *(i.after for i in interfaces_of(scene, wavelength))]
    plane = image_plane_mm(scene)
    # The origin in the middle of the way.
    shift = -0.5 * plane
    world = mitsuba.load_dict({"type": "scene", **mitsuba_lens(mitsuba, scene, shift)})
    before, after = mitsuba.Float(indices[:-1]), mitsuba.Float(indices[1:])
    last = len(indices) - 1

    def through(ray: Any, weight: Any, number: Any) -> tuple[Any, Any, Any]:
        hit = world.ray_intersect(ray)
        n_i, n_t = drjit.gather(mitsuba.Float, before, number), drjit.gather(mitsuba.Float, after, number)
        normal = hit.sh_frame.n
        # The exact normals look along the light: to its outside.
        cosine = drjit.dot(ray.d, normal)
        reflectance, cos_t, _, _ = mitsuba.fresnel(cosine, n_t / n_i)
        eta = n_i / n_t
        bent = drjit.normalize(eta * ray.d + (drjit.abs(cos_t) - eta * cosine) * normal)
        return hit.spawn_ray(bent), weight * (1.0 - reflectance), number + 1

    def run(rays: Any) -> Any:
        ray, weight, number = rays, drjit.ones(mitsuba.Float, len(sent.origins)), mitsuba.UInt32(0)
        ray, weight, number = drjit.while_loop(
            (ray, weight, number), lambda ray, weight, number: number < last, through
        )
        along = (plane + shift - ray.o.z) / ray.d.z
        x, y = ray.o.x + along * ray.d.x, ray.o.y + along * ray.d.y
        drjit.eval(x, y, weight)
        drjit.sync_thread()
        return x, y, weight

    def prepare() -> Any:
        origin = np.ascontiguousarray(np.add(sent.origins, [0.0, 0.0, shift]).T, np.float32)
        ray = mitsuba.Ray3f(
            mitsuba.Point3f(*origin), mitsuba.Vector3f(*np.ascontiguousarray(sent.directions.T, np.float32))
        )
        drjit.eval(ray)
        drjit.sync_thread()
        return ray

    def landing(arrived: Any) -> tuple[Array, Array]:
        x, y, weight = (np.array(a, np.float64) for a in arrived)
        return np.column_stack([x, y]), weight

    return Peer("mitsuba", 6 * MITSUBA_RINGS**2, prepare, run, landing)


PEERS = {"batoid": batoid_peer, "optiland": optiland_peer, "mitsuba": mitsuba_peer}
"""By name, what builds each: from a solved scene without microlenses, rays, and the threads it may use.

Those that take no number of threads obey OMP_NUM_THREADS, or use one."""
