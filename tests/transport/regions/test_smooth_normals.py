"""Interpolated normals of a mesh: how near a ball of facets comes to the closed form of a sphere under a lamp."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.kernels.decorators import kernel
from lfmesh.transport.events.scattering import evaluate
from lfmesh.transport.events.surface import point_of
from lfmesh.transport.tables.tables import AIR, ObjectTables
from tests.cameras import camera_without_array

Array = NDArray[np.float64]

RADIUS_MM = 10.0
POINTS = 20_000

ERROR = {80: (0.071, 0.032), 320: (0.036, 0.0135), 1280: (0.018, 0.0052)}
"""Root mean square difference of the cosine of incidence from the sphere's over all points and directions of a lamp, of
flat and of interpolated normals: by number of facets, as an independent sum in numpy gave it, rounded up."""


class In(NamedTuple):
    """The part of a packet that a point depends on."""

    colour: int
    medium: int
    key: np.uint64
    events: int


@kernel
def cosines(objects: ObjectTables, facets: NDArray[np.int64], places: Array, lamps: Array, found: Array) -> None:
    """Write π BRDF · cos θ of points of white facets under lamps, seen along their normals, (n,)."""
    for i in range(len(found)):
        point = point_of(
            objects, In(0, AIR, np.uint64(0), 0), facets[i], (places[i, 0], places[i, 1], places[i, 2]), 1.0, True
        )
        ux, uy, uz = lamps[i, 0], lamps[i, 1], lamps[i, 2]
        cosine = point.nx * ux + point.ny * uy + point.nz * uz
        found[i] = 0.0
        if cosine > 0.0:
            incoming = -point.nx, -point.ny, -point.nz
            found[i] = np.pi * evaluate(objects.scattering, point, 0, incoming, (ux, uy, uz)) * cosine


@pytest.mark.parametrize("level", [1, 2, 3])
def test_a_ball_of_facets_is_lit_as_a_sphere(tmp_path: Path, level: int) -> None:
    ball = trimesh.creation.icosphere(level, RADIUS_MM)
    ball.vertex_normals = ball.vertices / RADIUS_MM
    ball.export(tmp_path / "ball.ply", vertex_normal=True)
    target = {"file": "ball.ply", "units": "mm", "position_mm": [0, 0, -150.0], "material": {"reflectance": 1.0}}
    random = np.random.default_rng(1)
    lamps = random.normal(size=(POINTS, 3))
    lamps /= np.linalg.norm(lamps, axis=1, keepdims=True)
    weights = random.dirichlet((1.0, 1.0, 1.0), POINTS)
    errors = []
    for normals in ("facets", "file"):
        scene = lf.Scene(camera=camera_without_array(), targets=[target | {"normals": normals}]).in_folder(tmp_path)
        objects = lf.build(scene).tables.objects
        own = np.flatnonzero(objects.facets["body"] == 0)
        area = np.linalg.norm(np.cross(*np.moveaxis(np.diff(objects.facets["corners"][own], axis=1), 1, 0)), axis=1)
        facets = own[random.choice(len(own), POINTS, p=area / area.sum())]
        places = np.einsum("nk,nki->ni", weights, objects.facets["corners"][facets])
        found = np.empty(POINTS)
        cosines(objects, facets, places, lamps, found)
        sphere = places / np.linalg.norm(places, axis=1, keepdims=True)
        truth = np.maximum(0.0, np.einsum("ni,ni->n", sphere, lamps))
        errors.append(float(np.sqrt(((found - truth) ** 2).mean())))
    for error, limit in zip(errors, ERROR[len(ball.faces)], strict=True):
        assert 0.9 * limit < error < 1.03 * limit
