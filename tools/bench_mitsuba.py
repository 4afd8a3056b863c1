"""A plenoptic camera in Mitsuba 3, as its users would build it: a mesh scene, and a sensor in Python that aims.

The lens is the meshes of `bench_peers.mitsuba_lens`, the array one mesh of caps with exact normals at their vertices
and a flat face behind; what is no glass is black. The sensor aims every ray, uniformly, at the 3 × 3 lenslets round the
pixel. The `path` integrator does the rest, and takes one child by chance at every interface. The image path has a known
number of them, and a ghost two more at least: cut at the image path's depth, Mitsuba models the light that lfmesh's
sequential engine does; without the cut it follows reflections too, as far as they reach a pixel through the nine
lenslets. A pixel's value is power in W, from the same radiance in W/(m² sr).

The origin lies on the array's apexes, where float32 has to tell µm apart.
"""

from typing import Any

import numpy as np
from bench_peers import imported, mitsuba_lens, mitsuba_mesh
from numpy.typing import NDArray

from lfmesh.geometry.objects.targets import target_mesh
from lfmesh.optics.glass import refractive_index
from lfmesh.scene import Scene

Array = NDArray[np.float64]

VARIANT = "llvm_ad_mono"
LENSLET_STEPS = 16
"""Squares along a side of a lenslet's mesh: 512 triangles."""
NEIGHBOURS = 3
BLACK = {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.0}}
MAX_DEPTH = 64
MM2_PER_M2 = 1e6


def square_grid(steps: int) -> tuple[Array, NDArray[np.int64]]:
    """Return points of the unit square about the origin, (n, 2), and its triangles, counter-clockwise."""
    side = np.linspace(-0.5, 0.5, steps + 1)
    points = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    row, column = np.indices((steps, steps))
    corner = (row * (steps + 1) + column).ravel()
    up = corner + steps + 1
    faces = np.concatenate([np.column_stack([corner, corner + 1, up]), np.column_stack([corner + 1, up + 1, up])])
    return points, faces


def annulus(inner: float, outer: float, z: float, azimuths: int = 192) -> tuple[Array, NDArray[np.int64]]:
    """Return a flat ring square to the axis; its polygon's corners lie on the inner circle's outside."""
    angle = 2.0 * np.pi * np.arange(azimuths) / azimuths
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    # Of the same area as the circle.
    inner *= np.sqrt(2.0 * np.pi / azimuths / np.sin(2.0 * np.pi / azimuths))
    points = np.concatenate([inner * circle, outer * circle])
    a = np.arange(azimuths)
    b = (a + 1) % azimuths
    faces = np.concatenate([np.column_stack([a, a + azimuths, b + azimuths]), np.column_stack([a, b + azimuths, b])])
    return np.column_stack([points, np.full(len(points), z)]), faces


class Camera:
    """A solved scene's camera (square lenslets, no errors of form or pose) and its one emitting target."""

    def __init__(self, scene: Scene, threads: int, reflections: bool) -> None:
        self.mitsuba, self.drjit = imported("mitsuba"), imported("drjit")
        self.mitsuba.set_variant(VARIANT)
        self.drjit.set_thread_count(threads)
        self.scene = scene
        camera = scene.camera
        assert camera.mla is not None
        self.mla = camera.mla
        self.apexes = camera.lens.vertices_mm[-1] + (self.mla.distance_mm or 0.0)
        self.sensor_z = self.mla.thickness_mm + (camera.sensor.distance_mm or 0.0)
        self.pixel_m2 = camera.sensor.pixel_mm**2 / MM2_PER_M2
        interfaces = sum(not camera.lens.is_pure_stop(i) for i in range(len(camera.lens.surfaces))) + 2
        # Light that is seen directly has depth 1.
        depth = MAX_DEPTH if reflections else interfaces + 1
        self.mitsuba.register_sensor("lenslet_sensor", self._sensor_class())
        self.world = self.mitsuba.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "path", "max_depth": depth, "rr_depth": MAX_DEPTH},
                **mitsuba_lens(self.mitsuba, scene, -self.apexes),
                **self._stops(),
                **self._array(),
                "target": self._target(),
                "sensor": {"type": "lenslet_sensor", **self._film()},
            }
        )

    def image(self, samples: int, seed: int) -> Array:
        """Return (rows, columns) W per pixel."""
        film = self.mitsuba.render(self.world, spp=samples, seed=seed)
        return np.array(film, np.float64).reshape(film.shape[:2]) * self.pixel_m2

    def _film(self) -> dict[str, Any]:
        columns, rows = self.scene.camera.sensor.pixels
        return {
            "film": {
                "type": "hdrfilm", "width": columns, "height": rows, "pixel_format": "luminance",
                "component_format": "float32", "rfilter": {"type": "box"},
            },
            "sampler": {"type": "independent"},
        }  # fmt: skip

    def _sensor_class(self) -> Any:
        """Return the sensor as Mitsuba's users write one."""
        mitsuba, drjit = self.mitsuba, self.drjit
        columns, rows = self.scene.camera.sensor.pixels
        pixel, z, pitch = self.scene.camera.sensor.pixel_mm, self.sensor_z, self.mla.pitch_mm
        across, down = self.mla.count

        class LensletSensor(mitsuba.Sensor):  # type: ignore[misc, name-defined]
            def sample_ray(
                self, time: Any, wavelength: Any, place: Any, aperture: Any, active: Any = True
            ) -> tuple[Any, Any]:
                x, y = (place.x - 0.5) * (columns * pixel), (place.y - 0.5) * (rows * pixel)
                # The cell over the pixel, then one of the nine round it, then a point of that. Cells beyond the array
                # are aimed at too: the plate bends some of their rays to a lenslet.
                own_column = drjit.floor(x / pitch + 0.5 * across)
                own_row = drjit.floor(y / pitch + 0.5 * down)
                u, v = aperture.x * NEIGHBOURS, aperture.y * NEIGHBOURS
                column, row = own_column + drjit.floor(u) - 1.0, own_row + drjit.floor(v) - 1.0
                to = mitsuba.Point3f(
                    (column + u - drjit.floor(u) - 0.5 * across) * pitch,
                    (row + v - drjit.floor(v) - 0.5 * down) * pitch,
                    0.0,
                )
                origin = mitsuba.Point3f(x, y, z)
                way = to - origin
                squared = drjit.squared_norm(way)
                direction = way * drjit.rsqrt(squared)
                cosine = -direction.z
                weight = cosine * cosine / squared * (NEIGHBOURS * pitch) ** 2
                ray = mitsuba.Ray3f(origin, direction, time, mitsuba.Color0f())
                return ray, weight & active

            def sample_ray_differential(
                self, time: Any, wavelength: Any, place: Any, aperture: Any, active: Any = True
            ) -> tuple[Any, Any]:
                ray, weight = self.sample_ray(time, wavelength, place, aperture, active)
                return mitsuba.RayDifferential3f(ray), weight

            def bbox(self) -> Any:
                return mitsuba.BoundingBox3f(
                    mitsuba.Point3f(-columns * pixel, -rows * pixel, z),
                    mitsuba.Point3f(columns * pixel, rows * pixel, z),
                )

            def to_string(self) -> str:
                return "LensletSensor"

        return LensletSensor

    def _black(self, name: str, vertices: Array, faces: NDArray[np.int64]) -> Any:
        up = np.tile([0.0, 0.0, 1.0], (len(vertices), 1))
        both = {"type": "twosided", "bsdf": BLACK}
        return mitsuba_mesh(self.mitsuba, name, vertices, faces, up, both)

    def _stops(self) -> dict[str, Any]:
        """Return the stop and every surface's mount as black rings, and the frame round the array."""
        lens = self.scene.camera.lens
        widest = 2.0 * max(s.semi_diameter_mm or 0.0 for s in lens.surfaces)
        meshes = {}
        for number, (surface, z) in enumerate(zip(lens.surfaces, lens.vertices_mm, strict=True)):
            radius = lens.aperture_mm(number) or 0.0
            ring = annulus(radius, widest, z + surface.sag_mm(radius) - self.apexes)
            meshes[f"ring_{number}"] = self._black(f"ring_{number}", *ring)
        corner = 0.5 * self.mla.pitch_mm * max(self.mla.count)
        frame = annulus(1.0, widest, 0.0, 4)
        # Four corners, turned by 45°, of the array's own size.
        turned = np.array([[np.cos(a), np.sin(a)] for a in np.pi / 4 + np.pi / 2 * np.arange(4)])
        frame[0][:4, :2] = corner * np.sqrt(2.0) * turned
        frame[0][4:, :2] = widest * turned
        meshes["frame"] = self._black("frame", *frame)
        return meshes

    def _array(self) -> dict[str, Any]:
        """Return the lenslets' caps as one mesh, and the flat face."""
        mla = self.mla
        index = refractive_index(mla.medium, self.scene.primary_nm)
        curvature = 1.0 / float(np.ravel(mla.radius_mm)[0])
        grid, cell_faces = square_grid(LENSLET_STEPS)
        grid = grid * mla.pitch_mm
        r2 = np.sum(grid**2, axis=1)
        steep = np.sqrt(1.0 - curvature**2 * r2)
        cap = np.column_stack([grid, curvature * r2 / (1.0 + steep)])
        cap_normals = np.column_stack([-curvature * grid, steep])
        across, down = mla.count
        column, row = np.meshgrid(np.arange(across), np.arange(down))
        centres = np.column_stack(
            [(column.ravel() + 0.5 - 0.5 * across) * mla.pitch_mm, (row.ravel() + 0.5 - 0.5 * down) * mla.pitch_mm]
        )
        shifts = np.column_stack([centres, np.zeros(len(centres))])
        vertices = (shifts[:, None] + cap).reshape(-1, 3)
        faces = (len(cap) * np.arange(len(centres))[:, None, None] + cell_faces).reshape(-1, 3)
        # Normals look towards the sensor, into the glass: that side is a dielectric's outside.
        curved = {"type": "dielectric", "ext_ior": index, "int_ior": 1.0}
        flat = {"type": "dielectric", "ext_ior": 1.0, "int_ior": index}
        plate, plate_faces = square_grid(1)
        size = np.array([across, down]) * mla.pitch_mm
        back = np.column_stack([plate * size, np.full(len(plate), mla.thickness_mm)])
        up = np.tile([0.0, 0.0, 1.0], (len(back), 1))
        return {
            "lenslets": mitsuba_mesh(
                self.mitsuba, "lenslets", vertices, faces, np.tile(cap_normals, (len(centres), 1)), curved
            ),
            "plate": mitsuba_mesh(self.mitsuba, "plate", back, plate_faces, up, flat),
        }

    def _target(self) -> Any:
        """Return the emitting target with its texture."""
        mitsuba = self.mitsuba
        target = self.scene.targets[0]
        shape = target_mesh(target, self.scene)
        radiance = target.material.radiance_w_m2_sr
        corners = shape.mesh.vertices[shape.mesh.faces].reshape(-1, 3) - [0.0, 0.0, self.apexes]
        properties = mitsuba.Properties()
        if shape.texture is None or shape.uv is None:
            light: dict[str, Any] = {"type": "uniform", "value": radiance}
        else:
            # Row 0 of its bitmaps lies at v = 0, of lfmesh's textures at v = 1.
            grey = np.ascontiguousarray(radiance * shape.texture[::-1].mean(axis=2, dtype=np.float64), np.float32)
            light = {
                "type": "bitmap", "bitmap": mitsuba.Bitmap(grey[:, :, None]), "raw": True, "wrap_mode": "clamp",
            }  # fmt: skip
        properties["emitter"] = mitsuba.load_dict({"type": "area", "radiance": light})
        properties["bsdf"] = mitsuba.load_dict(BLACK)
        mesh = mitsuba.Mesh(
            "target", len(corners), len(corners) // 3, has_vertex_texcoords=shape.uv is not None, props=properties
        )
        parameters = mitsuba.traverse(mesh)
        parameters["vertex_positions"] = np.ascontiguousarray(corners, np.float32).ravel()
        parameters["faces"] = np.arange(len(corners), dtype=np.uint32)
        if shape.uv is not None:
            parameters["vertex_texcoords"] = np.ascontiguousarray(shape.uv.reshape(-1, 2), np.float32).ravel()
        parameters.update()
        return mesh
