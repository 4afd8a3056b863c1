"""Gloss by pictures: the models that are drawn mix to the roughness and the metallic of the picture."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from lfmesh.geometry.meshes.mesh import Mesh
from lfmesh.geometry.objects.gloss_pictures import GlossOnFacets
from lfmesh.geometry.objects.targets import TargetMesh
from lfmesh.kernels.decorators import kernel
from lfmesh.optics.gltf_material import RATIO, GltfRange
from lfmesh.optics.microfacets import facet_density
from lfmesh.transport.tables.varied_gloss import VariedGloss, drawn_model, varied_gloss

BASE = (0.5, 0.5, 0.5)
TRIANGLE = Mesh(np.eye(3), np.array([[0, 1, 2]]))


def tables(of: GltfRange) -> tuple[VariedGloss, np.ndarray]:
    """Return tables of one range, and alpha and metallic of their rows."""
    gloss = GlossOnFacets(np.zeros((1, 3, 2)), np.ones((1, 1, 2), np.float32), (of,), np.zeros(1, np.int64))
    target = cast(TargetMesh, SimpleNamespace(mesh=TRIANGLE, gloss=gloss))
    rows = {(material, 0): row for row, material in enumerate(dict.fromkeys(of.materials))}
    return varied_gloss([target], [(0,)], rows), np.array([(each.alpha, each.metallic) for each, _ in rows])


@kernel
def fill(varied: VariedGloss, roughness: float, metallic: float, numbers: np.ndarray, rows: np.ndarray) -> None:
    for i in range(len(numbers)):
        rows[i] = drawn_model(varied, 0, roughness, metallic, numbers[i, 0], numbers[i, 1])


@pytest.mark.parametrize("ends", [((0.0, 1.0), (0.0, 1.0)), ((0.2, 0.7), (0.31, 0.62)), ((0.5, 0.5), (0.4, 0.4))])
def test_models_are_drawn_by_their_shares_of_the_picture(ends: tuple[tuple[float, float], tuple[float, float]]) -> None:
    """On an even lattice of random numbers, the mean is within a step of the lattice."""
    (least, most), (smoothest, roughest) = ends
    varied, of_rows = tables(GltfRange.of(BASE, np.array([least, most]), np.array([smoothest, roughest])))
    steps = 64
    numbers = (np.indices((steps, steps)).reshape(2, -1).T + 0.5) / steps
    drawn = np.empty(len(numbers), np.int64)
    for share in (0.0, 0.3, 1.0):
        metallic = least + share * (most - least)
        roughness = smoothest + share * (roughest - smoothest)
        fill(varied, roughness, metallic, numbers, drawn)
        alpha, metals = of_rows[drawn].T
        assert abs(metals.mean() - metallic) <= (most - least) / steps
        asked = np.log(max(roughness**2, 0.01))
        assert abs(np.log(alpha).mean() - asked) <= RATIO / steps
        assert abs(np.log(alpha) - asked).max() < RATIO * (1.0 + 1e-12)


def test_mixed_densities_of_facets_are_off_by_what_is_stated() -> None:
    """Between two neighbouring roughnesses, at all angles of the facets, by at most RATIO²/2."""
    worst = 0.0
    tilts = np.append(0.0, np.geomspace(1e-3, 1.57, 60))
    for middle in np.exp(RATIO * (np.arange(4, 30, 5) + 0.5)) * 0.01:
        for tilt in tilts:
            facet = float(np.sin(tilt)), 0.0, float(np.cos(tilt))
            one, other, true = (facet_density(middle * np.exp(k * RATIO / 2.0), *facet) for k in (-1, 1, 0))
            worst = max(worst, abs(0.5 * (one + other) / true - 1.0))
    assert 0.8 * RATIO**2 / 2.0 < worst < 1.01 * RATIO**2 / 2.0
    assert RATIO**2 / 2.0 < 0.0104
