"""Rough faces in the interface table, and the lines that describe them."""

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.optics.glass import refractive_index
from lfmesh.optics.walsh import diffuse_reflectance
from lfmesh.transport.tables.interfaces import finish_lines, interface_tables
from lfmesh.transport.tables.tables import BARE, DIFFUSE, GROUND
from tests.cameras import SQUARE_ARRAY, biconvex


def scene() -> lf.Scene:
    given = lf.Scene(
        camera={
            "lens": biconvex(),
            "mla": SQUARE_ARRAY | {"distance_mm": 12.0},
            "sensor": {"pixels": [20, 20], "pixel_mm": 0.1, "distance_mm": 1.5},
        },
        transport={"wavelengths_nm": [486.1, 656.3]},
    )
    return given.changed(
        {
            "camera.lens.surfaces[0].finish": "diffuse",
            "camera.lens.surfaces[0].index": None,
            "camera.lens.surfaces[0].glass": "SCHOTT/N-BK7",
            "camera.mla.curved_finish": {"kind": "ground", "roughness": 0.3},
            "camera.mla.flat_finish": {"kind": "ground", "roughness": 0.00005},
        }
    )


def test_rough_faces_hold_their_parameters_for_each_wavelength() -> None:
    tables = interface_tables(scene(), (486.1, 656.3))
    assert tables.lens.rows["kind"].tolist() == [DIFFUSE, BARE]
    assert tables.mla.rows["kind"].tolist() == [GROUND, BARE]
    assert (tables.lens.rough, tables.mla.rough, tables.objects.rough) == (True, True, False)
    assert tables.mla.parameters.tolist() == [[0.3, 0.3]]
    indices = [refractive_index("SCHOTT/N-BK7", w) for w in (486.1, 656.3)]
    inwards, outwards = tables.lens.parameters
    np.testing.assert_array_equal(inwards, [diffuse_reflectance(1.0, n) for n in indices])
    np.testing.assert_array_equal(outwards, [diffuse_reflectance(n, 1.0) for n in indices])
    assert inwards[0] == pytest.approx(0.094, abs=2e-3)


def test_check_describes_rough_faces() -> None:
    lens, curved, flat = finish_lines(scene())
    assert lens.split("  ")[0] == "finish of lens surface 0"
    assert "diffuse: reflects 9.3" in lens or "diffuse: reflects 9.4" in lens
    assert curved.endswith("ground, roughness 0.3")
    assert flat.endswith("ground, roughness 5e-05; traced as polished")
