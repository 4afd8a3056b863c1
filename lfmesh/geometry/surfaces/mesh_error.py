"""Error at the sensor due to the tessellation of a lens, estimated without tracing.

A facet in place of a curved surface has an error of its normal, which bends the ray, and of its height, which shifts
the intersection. Both are sampled and carried to the sensor by paraxial matrices; surfaces add in quadrature. The
estimate agrees with traced rays within a factor of about two.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.levels import EXACT, FLAT, PATCH, SMOOTH
from lfmesh.geometry.meshes.mesh import Array, Mesh, facet_normals
from lfmesh.geometry.meshes.patch import patch_points, patches
from lfmesh.geometry.surfaces.sag import heights, normals
from lfmesh.geometry.surfaces.tessellation import steepness
from lfmesh.scene import Scene
from lfmesh.scene.first_order.paraxial import Matrix, Paraxial, gap

INNER_POINTS = np.array([[4.0, 1.0, 1.0], [1.0, 4.0, 1.0], [1.0, 1.0, 4.0]]) / 6.0
"""Weights of a facet's corners at the three points of a quadrature exact to second order."""


def facet_errors(surface: Any, cap: Mesh, level: int) -> tuple[float, float]:
    """Return the rms error of the normal (rad) and of the height along z (mm) of a surface's mesh.

    Parameters
    ----------
    surface : SURFACE record
    cap : Mesh
        Mesh of the surface, facing +z, with exact corner normals.
    level : int
        See `levels`.
    """
    if level == EXACT or cap.corner_normals is None:
        return 0.0, 0.0
    corners = cap.vertices[cap.faces]
    if level == PATCH:
        eta, zeta = INNER_POINTS[:, 1] + INNER_POINTS[:, 2], INNER_POINTS[:, 2]
        points, used = patch_points(patches(corners, cap.corner_normals), eta, zeta)
    else:
        points = np.einsum("qk,mki->mqi", INNER_POINTS, corners)
        used = np.einsum("qk,mki->mqi", INNER_POINTS, cap.corner_normals)
        if level == FLAT:
            used = np.broadcast_to(facet_normals(cap)[0][:, None, :], used.shape)
        used = used / np.linalg.norm(used, axis=-1, keepdims=True)
    x, y = points[..., 0].ravel(), points[..., 1].ravel()
    inside = x * x + y * y <= float(surface["semi_diameter"]) ** 2
    exact = normals(surface, x[inside], y[inside])
    tilt = np.linalg.norm(used.reshape(-1, 3)[inside] - exact, axis=1)
    height = points[..., 2].ravel()[inside] - surface["vertex_z"] - heights(surface, x[inside], y[inside])
    return _rms(tilt), _rms(height)


def landing_errors(scene: Scene, numbers: list[int], surfaces: NDArray[np.void], caps: list[Mesh], level: int) -> Array:
    """Return the rms error (K,), mm, at the sensor or array due to each surface's mesh.

    Parameters
    ----------
    scene : Scene
        Solved.
    numbers : list of int
        Position of each refracting surface in the prescription.
    """
    lens = scene.camera.lens
    errors = _landing_errors(scene, Paraxial.of(lens, scene.primary_nm), numbers, surfaces, caps, level)
    if lens.number_off_revolution is None:
        return errors
    across = Paraxial.of(lens, scene.primary_nm, section_x=True)
    return np.maximum(errors, _landing_errors(scene, across, numbers, surfaces, caps, level))


def _landing_errors(
    scene: Scene, paraxial: Paraxial, numbers: list[int], surfaces: NDArray[np.void], caps: list[Mesh], level: int
) -> Array:
    """Compute `landing_errors` in one section of the lens."""
    lens = scene.camera.lens
    distance = (scene.camera.mla or scene.camera.sensor).distance_mm or 0.0
    to_image: Matrix = gap(distance, paraxial.image_index)
    carried = {}
    for number in reversed(range(len(lens.surfaces))):
        carried[number] = to_image
        to_image = paraxial.refraction(number).then(to_image)
        if number:
            to_image = paraxial.gap(number - 1).then(to_image)
    errors = []
    for number, surface, cap in zip(numbers, surfaces, caps, strict=True):
        tilt, height = facet_errors(surface, cap, level)
        n_i, n_t = paraxial.index_before(number), paraxial.indices[number + 1]
        # A typical ray meets the surface halfway out, at its slope there.
        incidence = float(steepness(surface, 0.5 * surface["semi_diameter"]))
        sideways = height * incidence * abs(n_t - n_i) / n_t
        if level in (FLAT, SMOOTH):
            # The facet's normal belongs to a point displaced by the path between facet and surface.
            bent = max(abs(surface["curvature"]), abs(surface["curvature_x"]))
            tilt = float(np.hypot(tilt, bent * height * incidence))
        bend = abs(carried[number].b * (n_t - n_i)) * tilt
        errors.append(np.hypot(bend, abs(carried[number].a) * sideways))
    return np.array(errors)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values * values))) if len(values) else 0.0
