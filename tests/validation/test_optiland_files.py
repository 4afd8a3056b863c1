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
from lfmesh.optics.glass import D_LINE_NM
from lfmesh.scene import Paraxial, load_lens
from tests.imports.dialects import in_common_words
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
    """Compare where rays land, and which of them do, with what optiland finds on the surfaces.

    It stops no ray at a clear aperture; those that it finds outside of one must end at a mount here.
    """
    from optiland.rays import RealRays

    draw = np.random.default_rng(5)
    square = 1.1 * (lens.aperture_mm(0) or 1.0) * draw.uniform(-1.0, 1.0, (200, 2))
    starts = np.column_stack([square, np.full(200, -12.0)])
    directions = np.column_stack([draw.uniform(-0.05, 0.05, (200, 2)), np.ones(200)])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    with np.errstate(all="ignore"):
        optic.surfaces.trace(RealRays(*starts.T, *directions.T, np.ones(200), np.full(200, 1e-3 * wavelength_nm)))
    points = np.stack([np.asarray(getattr(optic.surfaces, axis)) for axis in "xyz"], axis=-1)
    heights = np.hypot(points[1:-1, :, 0], points[1:-1, :, 1])
    apertures = [lens.aperture_mm(number) for number in range(len(lens.surfaces))]
    inside = (heights < np.array(apertures)[:, None]).all(axis=0) & np.isfinite(points[-1]).all(axis=1)
    behind = float(np.median(points[-1, inside, 2])) - lens.vertices_mm[-1]
    sensor = {"pixels": [800, 800], "pixel_mm": 0.5, "distance_mm": behind}
    scene = lf.Scene(
        camera={"lens": lens, "focus_mm": 5000.0, "sensor": sensor}, transport={"wavelengths_nm": [wavelength_nm]}
    )
    world = lf.build(scene, aimed=False)
    paths = lf.trace(world, starts, directions, wavelength_nm, split="transmit", engine="sequential")
    landed = paths.status == lf.Status.SENSOR
    assert landed.sum() >= 10
    np.testing.assert_array_equal(paths.source[landed], np.flatnonzero(inside))
    np.testing.assert_allclose(paths.position[landed], points[-1, inside], rtol=0.0, atol=1e-8)


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


NAMED = ["edmund_55278_52mm", "double_gauss_100mm", "asphere_100mm"]


@pytest.mark.parametrize("of", [*NAMED, *range(10)])
def test_optiland_reads_what_is_written(tmp_path: Path, of: str | int) -> None:
    from optiland.fileio import load_zemax_file

    lens = in_common_words(load_lens(f"lib:{of}") if isinstance(of, str) else random_lens(of, ".json"), [MISTAKEN])
    image_mm = SENSOR_MM if isinstance(of, int) else Conditions.usual(lens).image_mm
    fields = (FieldPoint(), FieldPoint(0.0, 2.0))
    write_lens_file(lens, tmp_path / "lens.zmx", Conditions(fields=fields, image_mm=image_mm))
    optic = load_zemax_file(str(tmp_path / "lens.zmx"))
    for surface in optic.surfaces:
        surface.geometry.tol = 1e-12
    assert Paraxial.of(lens, D_LINE_NM).efl_mm == pytest.approx(float(np.squeeze(optic.paraxial.f2())), rel=1e-10)
    assert_rays_agree(optic, lens, D_LINE_NM)


def test_rays_land_where_optilands_phases_land_them(tmp_path: Path) -> None:
    """A radial phase and a linear one in air, and a plane grating, behind a lens."""
    from optiland.fileio import save_optiland_file
    from optiland.materials import IdealMaterial
    from optiland.phase import LinearGratingPhaseProfile, RadialPhaseProfile

    optic = optic_part.Optic()
    add = optic.surfaces.add
    add(index=0, thickness=np.inf)
    add(index=1, thickness=4, radius=40, is_stop=True, material=IdealMaterial(1.5168))
    add(index=2, thickness=3, radius=-60)
    add(index=3, thickness=2, phase_profile=RadialPhaseProfile([-3.0, 2e-3]))
    add(index=4, thickness=2, phase_profile=LinearGratingPhaseProfile(period=0.2, angle=0.7, order=-2))
    add(
        index=5, thickness=20, surface_type="grating", grating_order=1, grating_period=100.0,
        groove_orientation_angle=0.4,
    )  # fmt: skip
    add(index=6)
    optic.set_aperture("EPD", 8.0)
    optic.fields.set_type("angle")
    optic.fields.add(y=0)
    optic.wavelengths.add(WAVELENGTH_UM, is_primary=True)
    save_optiland_file(optic, str(tmp_path / "lens.json"))
    lens, _ = read_lens_file(tmp_path / "lens.json")
    assert [surface.phase is not None for surface in lens.surfaces] == [False, False, True, True, True]
    assert_rays_agree(optic, lens, 1e3 * WAVELENGTH_UM)
