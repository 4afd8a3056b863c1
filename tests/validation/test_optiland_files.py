"""Files that optiland writes, against optiland's own rays; `tools/test --long` installs it.

Its paraxial optics leave out a term in r², so that focal lengths are compared where there is none.
"""

from pathlib import Path

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.imports import read_lens_file
from lfmesh.scene import Paraxial

optic_part = pytest.importorskip("optiland.optic", reason="optiland is not there; tools/test --long installs it")
WAVELENGTH_UM = 0.5876
SQUARE = 1e-4


def optiland_lens(square: float):
    """Return a lens of two elements with an even and an odd asphere, made by optiland."""
    from optiland.materials import IdealMaterial

    optic = optic_part.Optic()
    add = optic.surfaces.add
    add(index=0, thickness=np.inf)
    add(
        index=1, thickness=4, radius=25, conic=-0.3, is_stop=True, material=IdealMaterial(1.5168),
        surface_type="even_asphere", coefficients=[square, -2e-6, 1e-9], tol=1e-12,
    )  # fmt: skip
    add(index=2, thickness=3, radius=-60)
    add(
        index=3, thickness=2, radius=-40, material=IdealMaterial(1.62), surface_type="odd_asphere",
        coefficients=[0, 0, 1e-6, 2e-7], tol=1e-12,
    )  # fmt: skip
    add(index=4, thickness=30, radius=np.inf)
    add(index=5)
    optic.set_aperture("EPD", 8.0)
    optic.fields.set_type("angle")
    optic.fields.add(y=0)
    optic.fields.add(y=5)
    optic.wavelengths.add(WAVELENGTH_UM, is_primary=True)
    return optic


@pytest.mark.parametrize("square", [0.0, SQUARE])
def test_rays_land_where_optiland_lands_them(tmp_path: Path, square: float) -> None:
    from optiland.fileio import save_optiland_file

    optic = optiland_lens(square)
    save_optiland_file(optic, str(tmp_path / "lens.json"))
    lens, _ = read_lens_file(tmp_path / "lens.json")
    if not square:
        assert Paraxial.of(lens, 1e3 * WAVELENGTH_UM).efl_mm == pytest.approx(float(optic.paraxial.f2()), rel=1e-10)
    pupil = np.random.default_rng(5).uniform(-0.6, 0.6, (2, 10))
    optic.trace_generic(Hx=np.zeros(10), Hy=np.ones(10), Px=pupil[0], Py=pupil[1], wavelength=WAVELENGTH_UM)
    points = np.stack([np.asarray(getattr(optic.surfaces, axis)) for axis in "xyz"], axis=-1)
    directions = np.stack([np.asarray(getattr(optic.surfaces, axis)) for axis in "LMN"], axis=-1)[0]
    behind = float(points[-1, 0, 2]) - lens.vertices_mm[-1]
    sensor = {"pixels": [4000, 4000], "pixel_mm": 0.02, "distance_mm": behind}
    camera = {"lens": lens, "focus_mm": 5000.0, "sensor": sensor}
    scene = lf.Scene(camera=camera, transport={"wavelengths_nm": [1e3 * WAVELENGTH_UM]})
    paths = lf.trace(
        lf.build(scene), points[1] - 5.0 * directions, directions, wavelength_nm=1e3 * WAVELENGTH_UM, split="transmit"
    )
    assert paths.source.tolist() == list(range(10))
    np.testing.assert_allclose(paths.position, points[-1], rtol=0.0, atol=1e-8)
