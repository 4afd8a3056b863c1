"""The main lens as meshes: a cap for each refracting surface, and a ring for each space between two."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.lens.air_gaps import cap_on, circles_of
from lfmesh.geometry.lens.element_poses import closure, pose_of, refuse_crossing_elements
from lfmesh.geometry.lens.surface_gaps import end_where_they_touch
from lfmesh.geometry.meshes.levels import SMOOTH, SURFACE_LEVEL
from lfmesh.geometry.meshes.mesh import Array, Mesh
from lfmesh.geometry.objects.refractors import RIM_MARGIN, face_of
from lfmesh.geometry.surfaces.bends import set_bends
from lfmesh.geometry.surfaces.mesh_error import facet_errors, landing_errors
from lfmesh.geometry.surfaces.surface import put_in_pose, surface_of
from lfmesh.geometry.surfaces.tessellation import (
    MAX_RINGS,
    cap,
    rim_radius,
    rings_for,
)
from lfmesh.optics.glass import Medium
from lfmesh.scene import Scene

LEAST_RINGS = 5
"""Least number of triangle rings of a lens surface: enough for `exact`, which takes only facet numbers from meshes."""

PIXEL_SHARE = 0.1
"""Error at the sensor, in pixels, below which the default tessellation of the other levels stays if it can."""

ORDER = {"flat": 1.0, "smooth": 2.0, "patch": 3.0}
"""Order in the facet size with which the error at the sensor decreases."""


@dataclass
class LensShape:
    """The lens as meshes in the camera frame; see the module."""

    numbers: list[int]
    """Position of each refracting surface in the scene's list."""
    surfaces: NDArray[np.void]
    """(K,) SURFACE, with their poses."""
    rings: int
    """Rings of triangles per cap, unless a neighbour is near."""
    azimuths: int
    """Points on the rim of a cap."""
    rims: list[float]
    caps: list[Mesh]
    closures: list[Mesh]
    """closures[k] joins the rims of surfaces k and k + 1 and faces the axis."""
    media: list[Medium]
    """Medium of each space: K + 1 entries, the object medium first, the image medium last."""
    analytic: NDArray[np.bool_]
    """True for surfaces with an exact shape, False for meshes from a file."""
    errors_mm: Array
    """(K,) estimated rms error at the sensor due to each surface's mesh; NaN for a mesh from a file."""

    @property
    def elements(self) -> list[int]:
        """Number of the front surface of each piece of glass, in order."""
        return [k for k in range(len(self.caps) - 1) if self.media[k + 1] is not None]


def lens_shape(scene: Scene, rings: int | None = None) -> LensShape:
    """Return the meshes of a solved scene's main lens.

    Parameters
    ----------
    scene : Scene
    rings : int, optional
        Rings of triangles per cap. Default: from the tolerance or the pixel size.
    """
    prescription = scene.camera.lens
    numbers = [i for i in range(len(prescription.surfaces)) if not prescription.is_pure_stop(i)]
    media: list[Medium] = [prescription.media[0]]
    records = []
    for i in numbers:
        s = prescription.surfaces[i]
        media.append(s.medium)
        records.append(
            surface_of(s, vertex_z=prescription.vertices_mm[i], semi_diameter=s.semi_diameter_mm or np.inf, stop=s.stop)
        )
        put_in_pose(records[-1], pose_of(prescription, i))
    surfaces = np.array(records)
    if prescription.elements:
        refuse_crossing_elements(prescription)
    given = [prescription.surfaces[i].mesh for i in numbers]
    own = np.array([mesh is None for mesh in given])
    end_where_they_touch(surfaces, LEAST_RINGS)
    level = SURFACE_LEVEL[scene.transport.surface]
    rings = rings or _rings(scene, numbers, surfaces)
    circles = circles_of(surfaces, rings)
    azimuths = int(circles[0].counts[-1])
    rims: list[float] = []
    caps: list[Mesh] = []
    for k, mesh in enumerate(given):
        if mesh is None:
            surfaces[k]["level"] = level
            rims.append(rim_radius(surfaces[k], azimuths // 6))
            set_bends(surfaces[k], rims[k])
            caps.append(cap(surfaces[k], rings, rims[k]) if circles[k].even else cap_on(surfaces[k], circles[k]))
        else:
            face = face_of(mesh, scene)
            surfaces[k]["level"] = SURFACE_LEVEL[mesh.facets]
            # A ring that starts slightly inside the rim leaves no gap to a rim that is not quite a circle.
            rims.append((1.0 - 0.2 * RIM_MARGIN) * face.rim_mm)
            shift = surfaces[k]["vertex_z"] - face.vertex_z
            caps.append(Mesh(np.add(face.mesh.vertices, [0.0, 0.0, shift]), face.mesh.faces, face.mesh.corner_normals))
    closures = [closure(prescription, surfaces, rims, numbers, k, azimuths) for k in range(len(numbers) - 1)]
    errors = landing_errors(scene, numbers, surfaces, caps, level)
    caps = [mesh.moved(s["pose"]) if s["posed"] else mesh for mesh, s in zip(caps, surfaces, strict=True)]
    errors = np.where(own, errors, np.nan)
    return LensShape(numbers, surfaces, rings, azimuths, rims, caps, closures, media, own, errors)


def _rings(scene: Scene, numbers: list[int], surfaces: NDArray[np.void]) -> int:
    """Return the number of rings of the coarsest meshes within the tolerance.

    The tolerance is the user's, if given. Otherwise it is a tenth of a pixel at the sensor, except for `exact`.
    """
    wished = scene.transport.tessellation
    rings = rings_for(surfaces, LEAST_RINGS, wished.sag_mm or np.inf)
    name = scene.transport.surface
    pixel = scene.camera.sensor.pixel_mm
    if wished.normal_mrad is None and (wished.sag_mm is not None or name == "exact"):
        return rings
    while rings < MAX_RINGS:
        rims = [rim_radius(s, rings) for s in surfaces]
        caps = [cap(s, rings, rim) for s, rim in zip(surfaces, rims, strict=True)]
        if wished.normal_mrad is not None:
            # `exact` bends rays by the surface's own normal; the tolerance then applies to the mesh's.
            level = SMOOTH if name == "exact" else SURFACE_LEVEL[name]
            worst = max(facet_errors(s, c, level)[0] for s, c in zip(surfaces, caps, strict=True))
            excess = worst * 1e3 / wished.normal_mrad
        else:
            errors = landing_errors(scene, numbers, surfaces, caps, SURFACE_LEVEL[name])
            excess = float(np.sqrt(np.sum(errors**2))) / (PIXEL_SHARE * pixel)
        if excess <= 1.0:
            return rings
        rings = max(rings + 1, min(MAX_RINGS, int(np.ceil(rings * excess ** (1.0 / ORDER.get(name, 2.0))))))
    return min(rings, MAX_RINGS)
