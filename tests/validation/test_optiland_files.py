"""Files that optiland writes and reads, against optiland's own rays; `tools/test --long` installs it.

Its paraxial optics leave out a term in r², so that focal lengths are compared where there is none. It reads spheres,
conics, even and odd aspheres of .zmx files as they are meant; of coordinate breaks it ignores the order of shift and
tilt, of toroids it takes PARM 2 for the radius.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.imports import read_lens_file, write_lens_file
from lfmesh.imports.conditions import Conditions, FieldPoint
from lfmesh.optics.glass import D_LINE_NM, refractive_index
from lfmesh.scene import Paraxial, load_lens
from lfmesh.scene.materials.own_glass import OwnGlass
from tests.imports.test_round_trips import SENSOR_MM, random_lens

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


def assert_rays_agree(optic: Any, lens: lf.Lens, wavelength_nm: float) -> None:
    """Compare ten rays of optiland's last field, spread over the pupil, with those of a lens here."""
    pupil = np.random.default_rng(5).uniform(-0.6, 0.6, (2, 10))
    optic.trace_generic(Hx=np.zeros(10), Hy=np.ones(10), Px=pupil[0], Py=pupil[1], wavelength=1e-3 * wavelength_nm)
    points = np.stack([np.asarray(getattr(optic.surfaces, axis)) for axis in "xyz"], axis=-1)
    directions = np.stack([np.asarray(getattr(optic.surfaces, axis)) for axis in "LMN"], axis=-1)[0]
    behind = float(points[-1, 0, 2]) - lens.vertices_mm[-1]
    sensor = {"pixels": [4000, 4000], "pixel_mm": 0.02, "distance_mm": behind}
    scene = lf.Scene(
        camera={"lens": lens, "focus_mm": 5000.0, "sensor": sensor}, transport={"wavelengths_nm": [wavelength_nm]}
    )
    starts = points[1] - 5.0 * directions
    paths = lf.trace(
        lf.build(scene, aimed=False), starts, directions, wavelength_nm, split="transmit", engine="sequential"
    )
    assert paths.source.tolist() == list(range(10))
    np.testing.assert_allclose(paths.position, points[-1], rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("square", [0.0, SQUARE])
def test_rays_land_where_optiland_lands_them(tmp_path: Path, square: float) -> None:
    from optiland.fileio import save_optiland_file

    optic = optiland_lens(square)
    save_optiland_file(optic, str(tmp_path / "lens.json"))
    lens, _ = read_lens_file(tmp_path / "lens.json")
    if not square:
        assert Paraxial.of(lens, 1e3 * WAVELENGTH_UM).efl_mm == pytest.approx(float(optic.paraxial.f2()), rel=1e-10)
    assert_rays_agree(optic, lens, 1e3 * WAVELENGTH_UM)


MISTAKEN = "SCHOTT/SF5"
"""Its catalogue files N-SF5 under this name, too, and gives that."""


def in_words_of_optiland(lens: lf.Lens) -> lf.Lens:
    """Return a lens with at most seven terms a surface, bare indices and a mistaken glass given by nd and Vd.

    An Abbe number of 0 makes its indices infinite.
    """
    surfaces = []
    for surface in lens.surfaces:
        update: dict[str, Any] = {"asphere_mm": surface.asphere_mm[:7]}
        if surface.index is not None or surface.glass == MISTAKEN:
            nd = refractive_index(surface.medium, D_LINE_NM)
            update |= {"glass": OwnGlass(nd=nd, vd=50.0), "index": None}
        surfaces.append(surface.model_copy(update=update))
    return lens.model_copy(update={"surfaces": tuple(surfaces)})


NAMED = ["edmund_55278_52mm", "double_gauss_100mm", "asphere_100mm"]


SEEDS = (0, 1, 2, 4, 6, 7, 8, 9)
"""Of random lenses whose ten rays all land; of those of 3 none lands in optiland, of 5 eight here."""


@pytest.mark.parametrize("of", [*NAMED, *SEEDS])
def test_optiland_reads_what_is_written(tmp_path: Path, of: str | int) -> None:
    from optiland.fileio import load_zemax_file

    lens = in_words_of_optiland(load_lens(f"lib:{of}") if isinstance(of, str) else random_lens(of, ".json"))
    image_mm = SENSOR_MM if isinstance(of, int) else Conditions.usual(lens).image_mm
    fields = (FieldPoint(), FieldPoint(0.0, 2.0))
    write_lens_file(lens, tmp_path / "lens.zmx", Conditions(fields=fields, image_mm=image_mm))
    optic = load_zemax_file(str(tmp_path / "lens.zmx"))
    for surface in optic.surfaces:
        surface.geometry.tol = 1e-12
    assert Paraxial.of(lens, D_LINE_NM).efl_mm == pytest.approx(float(np.squeeze(optic.paraxial.f2())), rel=1e-10)
    assert_rays_agree(optic, lens, D_LINE_NM)
