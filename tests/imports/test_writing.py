"""TOML to another program's file and back is the same lens; what a format cannot hold is refused or said."""

import pytest

from lfmesh.errors import SceneError
from lfmesh.imports import read_lens_file, write_lens_file
from lfmesh.optics.glass import glass_name
from lfmesh.scene import Lens, Surface, load_lens
from lfmesh.scene.files import library
from lfmesh.scene.materials.own_glass import OwnGlass

ENDINGS = (".zmx", ".seq", ".toml")


def with_full_names(lens):
    """The lens with each glass named by its maker."""
    surfaces = tuple(
        s.model_copy(update={"glass": glass_name(s.glass)}) if s.glass is not None else s for s in lens.surfaces
    )
    return lens.model_copy(update={"surfaces": surfaces})


def assert_same(lens, again):
    """Equal to the last digit, but for a stop that comes back from its entrance pupil."""
    assert len(again.surfaces) == len(lens.surfaces)
    for a, b in zip(lens.surfaces, again.surfaces, strict=True):
        assert b.model_copy(update={"semi_diameter_mm": None}) == a.model_copy(update={"semi_diameter_mm": None})
        assert b.semi_diameter_mm == (pytest.approx(a.semi_diameter_mm, rel=1e-14) if a.semi_diameter_mm else None)


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("name", library())
def test_every_lens_of_the_library_comes_back(tmp_path, name, ending):
    lens = with_full_names(load_lens(f"lib:{name}"))
    path = tmp_path / f"lens{ending}"
    if ending == ".seq" and any(surface.gradient for surface in lens.surfaces):
        with pytest.raises(SceneError, match="gradient: not written to CODE V files"):
            write_lens_file(lens, path)
        return
    notes = write_lens_file(lens, path)
    again, _ = read_lens_file(path)
    assert_same(lens, again)
    assert again.name == lens.name
    assert again.source == lens.source or (ending == ".seq" and notes == ["the source is written as a comment"])


@pytest.mark.parametrize("ending", ENDINGS)
def test_an_f_number_and_aspheres_come_back(tmp_path, ending):
    lens = Lens(
        name="fast",
        surfaces=(
            Surface(radius_mm=41.7, thickness_mm=6.1, index=1.6, semi_diameter_mm=12.0, conic=-0.7, asphere_mm=(1e-6,)),
            Surface(radius_mm=-77.3, thickness_mm=3.0, semi_diameter_mm=11.5, asphere_mm=(0.0, 2e-9, -1e-12)),
            Surface(stop=True),
        ),
        f_number=2.8,
    )
    path = tmp_path / f"lens{ending}"
    write_lens_file(lens, path)
    again, _ = read_lens_file(path)
    assert_same(lens, again)
    assert again.f_number == 2.8


OWN = (
    OwnGlass(nd=1.62, vd=36.4),
    OwnGlass(wavelengths_nm=(400.0, 600.0, 800.0), values=(1.53, 1.52, 1.51)),
    OwnGlass(sellmeier_b=(1.1, 0.2), sellmeier_c_um2=(0.01, 100.0)),
)


def of_own_glass(glass):
    """A plano-convex lens of a glass that no catalogue has."""
    front = Surface(radius_mm=41.7, thickness_mm=6.1, glass=glass, semi_diameter_mm=12.0, stop=True)
    return Lens(name="own", surfaces=(front, Surface(semi_diameter_mm=12.0)))


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("glass", OWN, ids=("model", "table", "sellmeier"))
def test_glasses_of_no_catalogue_come_back_or_are_refused(tmp_path, ending, glass):
    lens, path = of_own_glass(glass), tmp_path / f"lens{ending}"
    if ending == ".zmx" and glass.nd is None:
        with pytest.raises(SceneError, match=r"surfaces\[0\].glass: a Zemax file cannot hold"):
            write_lens_file(lens, path)
        return
    write_lens_file(lens, path)
    again = read_lens_file(path)[0].surfaces[0].glass
    if ending != ".seq" or glass.values is not None:
        assert again == glass
    else:
        # A table of a formula gives its values between the lines again to some digits.
        for wavelength_nm in (410.0, 520.0, 620.0, 900.0):
            assert again.index_at(wavelength_nm) == pytest.approx(glass.index_at(wavelength_nm), abs=2e-5)


def test_an_unknown_ending_is_refused():
    with pytest.raises(SceneError, match=r"written to \.toml, \.zmx or \.seq"):
        write_lens_file(load_lens("lib:ball_10mm"), "lens.len")
