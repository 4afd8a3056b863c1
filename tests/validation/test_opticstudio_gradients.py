"""Gradient-index glass of OpticStudio's sample files: the image semi-diameters stored in the files.

The prescriptions are retyped from the repository yiningli/Project_X, `Sequential/Interconnects/GRIN interconnect`,
`Sequential/GRINs/Selfoc lens` and `Short course/sc_grin3`, with the materials' numbers of its files GRADIENT_9.DAT,
SGRIN.DAT and PROFILE.GRD. OpticStudio integrates in steps of 0.1 mm, the last lens in steps of 0.25 mm.
"""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from lfmesh.optics.gradient_path import ConicFace, starting_rays, traced
from lfmesh.optics.gradient_shapes import (
    GradientMaterial,
    GradientProfile,
    at_wavelength,
    gradium_profile,
    radial_and_axial_profile,
    selfoc_profile,
)
from lfmesh.optics.gradients import gradient_table, n2_at

Array = NDArray[np.float64]

STEPS = 64

SLS_1 = (1.5477, 6.37e-3), (0.4785, 7.157e-3, 3.749e-4)

G41SFN = [
    *[1.7442713, -3.4052535e-2, 2.3409570e-1, -1.9639026, 2.7022110, 9.7109829e-1],
    *[-1.6557914, -1.8892388, -1.4033652e-1, 1.6773232, 1.6433982, -1.5930068],
]
LENGTH_MM, OFFSET_MM = 12.1, 5.0
GSF = GradientMaterial(
    np.array(
        [
            [-0.0683636, -0.0323639, -0.0286748, -0.0169163, 0.00256909, 0.0174719],
            [-0.00109783, 0.0334663, 0.0388098, 0.0370413, 0.017429, -0.0405421],
            [0.931075, -0.0306245, -0.0392756, -0.0423487, -0.0256629, 0.0437821],
        ]
    ),
    np.array([[0.00498103, 0.000410271, 2.44e-5], [0.082168, 0.0343531, -0.0337717], [110.0, 2.85988e-4, 3.62547e-4]]),
    587.56,
)


def behind_rod(profile: GradientProfile, length: float, distance: float) -> float:
    """Return the height at which the marginal ray of a point in front of a rod, of the sine 0.2, meets its image."""
    table, sine = gradient_table([profile]), 0.2
    height = distance * sine / math.sqrt(1.0 - sine * sine)
    within = sine / math.sqrt(n2_at(table, 0, 0.0, height, 0.0))
    ray = starting_rays(table, 0, [(0.0, height, 0.0)], [(0.0, within, math.sqrt(1.0 - within * within))])
    _, ((_, y, _, _, across, _, _, _),) = traced(table, 0, ray, ConicFace(0.0, 0.0, length), STEPS)
    return float(y + distance * across / math.sqrt(1.0 - across * across))


def test_gradient_1_has_the_blur_of_the_interconnect() -> None:
    blur = behind_rod(radial_and_axial_profile(1.5, [-0.083]), 4.0, 2.5406992524)
    assert abs(blur) == pytest.approx(2.491944691397e-2, abs=1e-8)


def test_gradient_9_has_the_blur_of_the_selfoc_lens() -> None:
    """The largest of its three wavelengths."""
    blurs = [behind_rod(selfoc_profile(*SLS_1, wavelength), 3.8, 0.87204864785) for wavelength in (500.0, 550.0, 600.0)]
    assert max(map(abs, blurs)) == pytest.approx(2.449239901782e-2, abs=1e-8)


def test_a_gradium_profile_has_the_index_that_the_file_states_at_the_vertex() -> None:
    table = gradient_table([gradium_profile(G41SFN, LENGTH_MM, OFFSET_MM)])
    assert math.sqrt(n2_at(table, 0, 0.0, 0.0, 0.0)) == pytest.approx(1.710571457024, abs=1e-12)


def on_sphere(point: Array, along: Array, curvature: float, vertex_z: float) -> tuple[Array, Array]:
    """Return the point at which a straight ray meets a sphere, and the unit normal."""
    start = point - [0.0, 0.0, vertex_z]
    b, c = curvature * start @ along - along[2], curvature * start @ start - 2.0 * start[2]
    at = point + c / (math.sqrt(b * b - curvature * c) - b) * along
    return at, sphere_normal(at, curvature, vertex_z)


def sphere_normal(at: Array, curvature: float, vertex_z: float) -> Array:
    return np.array([0.0, 0.0, 1.0]) - curvature * (at - [0.0, 0.0, vertex_z])


def refracted(ray_vector: Array, normal: Array, n2: float) -> Array:
    """Return n' times the direction behind a face: the part along the face stays."""
    within = ray_vector - (ray_vector @ normal) * normal
    return within + math.sqrt(n2 - within @ within) * normal


def image_height(wavelength_um: float, pupil: float) -> float:
    """Trace a ray of the field of 4° through the sphere of BK7 and the lens of G41SFN behind it."""
    b, c = np.array([1.03961212, 0.231792344, 1.01046945]), np.array([0.00600069867, 0.0200179144, 103.560653])
    square = wavelength_um**2
    bk7 = 1.0 + float(np.sum(b * square / (square - c)))
    curvatures = 3.8887055900509997e-2, -4.805916862489e-2, -2.6110467750182106e-2
    first, thickness, last = 12.00002775736, 6.86911924985, 29.05899462685
    table = gradient_table([at_wavelength(gradium_profile(G41SFN, LENGTH_MM, OFFSET_MM), GSF, 1e3 * wavelength_um)])
    along = np.array([0.0, math.sin(math.radians(4.0)), math.cos(math.radians(4.0))])
    at, normal = on_sphere(np.array([0.0, pupil, 0.0]), along, curvatures[0], 0.0)
    vector = refracted(along, normal, bk7)
    at, normal = on_sphere(at, vector / np.linalg.norm(vector), curvatures[1], first)
    at -= [0.0, 0.0, first]
    vector = refracted(vector, normal, n2_at(table, 0, *at.tolist()))
    reached, ends = traced(table, 0, [*at, *vector, 0.0, 0.0], ConicFace(curvatures[2], 0.0, thickness), STEPS)
    assert reached.all()
    at, vector = ends[0, :3], ends[0, 3:6]
    vector = refracted(vector, sphere_normal(at, curvatures[2], thickness), 1.0)
    return float((at + (thickness + last - at[2]) / vector[2] * vector)[1])


def test_gradium_with_its_dispersion_has_the_image_of_the_short_course() -> None:
    """The largest height is the lower marginal ray's in the line C; F's upper one is 3 µm less."""
    heights = [image_height(line, pupil) for line in (0.4861327, 0.5875618, 0.6562725) for pupil in (-12.5, 0.0, 12.5)]
    assert max(map(abs, heights)) == pytest.approx(2.618121161292, abs=1e-6)
