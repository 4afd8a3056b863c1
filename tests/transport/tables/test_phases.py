"""Phase functions of a scene by their kind, at its wavelengths."""

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from lfmesh.errors import SceneError
from lfmesh.optics.mie import mie_sphere
from lfmesh.optics.phase import henyey_greenstein, rayleigh
from lfmesh.scene.media.phase import MiePhase, Phase
from lfmesh.transport.tables.phases import phase_functions

MU = np.linspace(-1.0, 1.0, 7)


class Folder:
    def __init__(self, path):
        self.path = path

    def resolve(self, name):
        return self.path / name


def functions(table, *wavelengths_nm, folder=None):
    phase = TypeAdapter(Phase).validate_python(table)
    return phase_functions(phase, wavelengths_nm, Folder(folder), "media[0].phase")


def test_each_kind_is_the_function_of_its_name(tmp_path):
    (tmp_path / "p.csv").write_text("angle_deg,value\n0,3\n180,1\n")
    np.testing.assert_array_equal(functions({"kind": "isotropic"}, 500.0)[0].at(MU), np.full(7, 0.25 / np.pi))
    np.testing.assert_array_equal(functions({"kind": "rayleigh"}, 500.0)[0].at(MU), rayleigh().at(MU))
    found = functions({"kind": "henyey_greenstein", "g": 0.3}, 500.0)[0]
    np.testing.assert_array_equal(found.at(MU), henyey_greenstein(0.3).at(MU))
    found = functions({"kind": "table", "file": "p.csv"}, 500.0, folder=tmp_path)[0]
    np.testing.assert_allclose(found.at(MU), (2.0 + MU) / (8.0 * np.pi), rtol=1e-14)


def test_spheres_scatter_by_wavelength_and_by_what_is_round_them():
    table = {"kind": "mie", "diameter_um": 1.0, "index": 1.59, "extinction": 0.02, "surrounding_index": 1.333}
    blue, red = functions(table, 450.0, 650.0)
    np.testing.assert_array_equal(blue.at(MU), mie_sphere(1.0, 1.59 + 0.02j, 450.0, 1.333).phase.at(MU))
    np.testing.assert_array_equal(red.at(MU), mie_sphere(1.0, 1.59 + 0.02j, 650.0, 1.333).phase.at(MU))
    assert blue.mean_cosine != red.mean_cosine


def test_too_large_spheres_are_refused_by_their_place():
    table = {"kind": "mie", "diameter_um": 5000.0, "index": 1.5}
    with pytest.raises(SceneError, match=r"media\[0\]\.phase\.diameter_um = 5000"):
        functions(table, 500.0)


@pytest.mark.parametrize("g", [1.0, -1.0, float("nan")])
def test_a_mean_cosine_of_one_is_no_function(g):
    with pytest.raises((SceneError, ValidationError), match="g"):
        functions({"kind": "henyey_greenstein", "g": g}, 500.0)


def test_spheres_of_the_index_round_them_are_refused():
    with pytest.raises(SceneError, match="scatter nothing"):
        MiePhase(diameter_um=1.0, index=1.333, surrounding_index=1.333)
