"""Nodes that are computed once."""

import numpy as np
import pytest

from lfmesh.optics import gloss
from lfmesh.optics.gltf_material import GltfMaterial, gltf_parameters
from lfmesh.optics.quadrature import gauss_legendre


@pytest.mark.parametrize("count", [1, 4, 64])
def test_nodes_are_those_of_numpy_and_cannot_be_changed(count: int) -> None:
    for values, true in zip(gauss_legendre(count), np.polynomial.legendre.leggauss(count), strict=True):
        assert np.array_equal(values, true)
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 0.0


def test_nodes_of_one_number_are_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    gauss_legendre(17)
    monkeypatch.setattr(np.polynomial.legendre, "leggauss", pytest.fail)
    assert len(gauss_legendre(17)[0]) == 17


def test_materials_of_a_file_are_alike_together_and_alone() -> None:
    draw = np.random.default_rng(8)
    materials = [
        GltfMaterial((r, g, b), metallic, roughness) for r, g, b, metallic, roughness in draw.uniform(size=(5, 5))
    ]
    wavelengths, around = (450.0, 550.0, 650.0), draw.uniform(1.0, 1.5, (5, 3))
    together = gltf_parameters(materials, wavelengths, around)
    for one, own, found in zip(materials, around, together, strict=True):
        assert np.array_equal(found, gltf_parameters([one], wavelengths, own[None])[0])


def test_tables_of_a_layer_depend_on_its_index_and_its_roughness_and_cannot_be_changed() -> None:
    """Each of the inputs of the cached tables is changed by itself."""
    base, index = np.array([0.5]), np.array([1.5 + 0.0j])
    found = [
        gloss.gloss_parameters(base, index, 0.2),
        gloss.gloss_parameters(base, index, 0.21),
        gloss.gloss_parameters(base, np.array([1.6 + 0.0j]), 0.2),
        gloss.gloss_parameters(base, np.array([1.5 + 0.1j]), 0.2),
        gloss.gloss_parameters(np.array([0.6]), index, 0.2),
    ]
    assert len({each.tobytes() for each in found}) == len(found)
    found[0][:] = 0.0
    assert gloss.gloss_parameters(base, index, 0.2).any()
    with pytest.raises(ValueError, match="read-only"):
        gloss.facet_moments(0.2)[0] = 0.0
