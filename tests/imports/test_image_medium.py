"""Lens files of lenses that end in a medium: read with it behind their last surface, and written with it."""

import math
from pathlib import Path

import pytest

from lfmesh.imports import read_lens_file, write_lens_file
from lfmesh.scene import Lens, Paraxial, Scene, Surface, first_order
from lfmesh.scene.materials.own_glass import OwnGlass
from tests.imports.test_object_medium import CODE_V, OSLO, TABLE, ZEMAX, optiland

VITREOUS = 1.336


def eye(**behind: object) -> Lens:
    """Return a lens with a stop before its last surface, and a medium behind that."""
    return Lens(
        surfaces=(
            Surface(radius_mm=20.0, thickness_mm=3.0, index=1.6, semi_diameter_mm=5.0),
            Surface(radius_mm=25.0, thickness_mm=0.5, index=1.45, semi_diameter_mm=5.0),
            Surface(stop=True, thickness_mm=0.5, index=1.45, semi_diameter_mm=4.0),
            Surface(radius_mm=-25.0, semi_diameter_mm=5.0, **behind),
        )
    )


@pytest.mark.parametrize(
    ("ending", "matter"),
    [
        (".zmx", {"index": VITREOUS}),
        (".zmx", {"glass": OwnGlass(nd=1.333, vd=55.7)}),
        (".zmx", {"glass": "SCHOTT/N-SF11"}),
        (".seq", {"index": VITREOUS}),
        (".seq", {"glass": "SCHOTT/N-SF11"}),
        (".seq", {"glass": OwnGlass(wavelengths_nm=(400.0, 600.0, 800.0), values=(1.34, 1.333, 1.329))}),
        (".toml", {"glass": "main/H2O/Daimon-20.0C"}),
    ],
)
def test_the_image_medium_comes_back(tmp_path: Path, ending: str, matter: dict[str, object]) -> None:
    lens, path = eye(**matter), tmp_path / f"lens{ending}"
    write_lens_file(lens, path)
    again, _ = read_lens_file(path)
    old, new = (Paraxial.of(each, 587.6) for each in (lens, again))
    assert new.image_index > 1.3
    assert new.indices == pytest.approx(old.indices, rel=1e-12)
    assert (new.efl_mm, new.bfl_mm) == pytest.approx((old.efl_mm, old.bfl_mm), rel=1e-10)
    # The stop comes back from its entrance pupil.
    assert again.surfaces[2].semi_diameter_mm == pytest.approx(4.0, rel=1e-10)


@pytest.mark.parametrize(
    ("ending", "text"),
    [
        (".len", OSLO.replace("AIR; RD -20.0; TH 60.0", "GLA MOD V 1.336 1.336 1.336; RD -20.0; TH 60.0")),
        (".csv", TABLE.replace("-20.0,60.0,1.0", "-20.0,60.0,1.336")),
        (".json", optiland().replace('"radius": -20.0, "conic": 0.0}, "material_post": {"type": "IdealMaterial", '
                                     '"index": 1.0', '"radius": -20.0, "conic": 0.0}, "material_post": '
                                     '{"type": "IdealMaterial", "index": 1.336')),
        (".zmx", ZEMAX.replace("  DISZ 60.0\n", "  DISZ 60.0\n  GLAS ___BLANK 1 0 1.336 0 0 0\n")),
        (".seq", CODE_V.replace("S -20.0 60.0\n", "S -20.0 60.0 336000.000\n")),
    ],
)  # fmt: skip
def test_a_medium_up_to_the_image_is_read(tmp_path: Path, ending: str, text: str) -> None:
    """Focal lengths n/φ and n'/φ, with the step from glass to the medium at the last face."""
    assert "1.336" in text or "336000" in text
    path = tmp_path / f"eye{ending}"
    path.write_text(text)
    lens, report = read_lens_file(path)
    assert report.conditions is not None
    assert report.conditions.image_mm == pytest.approx(60.0)
    found = Paraxial.of(lens, 587.6)
    water, glass, behind = found.indices
    assert behind == pytest.approx(VITREOUS, rel=1e-12)
    first, second = (glass - water) / 20.0, (behind - glass) / -20.0
    power = first + second - first * second * 4.0 / glass
    assert 1.0 / found.efl_mm == pytest.approx(power, rel=1e-12)
    assert found.bfl_mm == pytest.approx(behind / power * (1.0 - first * 4.0 / glass), rel=1e-12)
    assert any("the image stands in the medium behind the last surface" in note for note in report.notes)


def test_an_aperture_of_the_images_side_counts_the_index(tmp_path: Path) -> None:
    """A numerical aperture n' sin u' = 0.1 at the image of the object at 400 mm."""
    path = tmp_path / "eye.seq"
    text = CODE_V.replace("EPD 6.0", "NA 0.1").replace("S -20.0 60.0\n", "S -20.0 60.0 336000.000\n")
    path.write_text(text)
    lens, _ = read_lens_file(path)
    found = Paraxial.of(lens, 587.6)
    marginal = found.whole(found.marginal_ray(400.0, lens.surfaces[0].semi_diameter_mm or math.nan))
    assert abs(marginal.angle) / VITREOUS == pytest.approx(math.tan(math.asin(0.1 / VITREOUS)), rel=1e-9)


def test_the_slope_of_a_marginal_ray_is_that_behind_the_lens(tmp_path: Path) -> None:
    """OSLO's PUK is u' itself, not n' u'."""
    path = tmp_path / "eye.len"
    path.write_text(
        OSLO.replace("AIR; RD -20.0; TH 60.0", "GLA MOD V 1.336 1.336 1.336; RD -20.0; TH 60.0").replace(
            "EBR 3.0", "PUK -0.05"
        )
    )
    lens, _ = read_lens_file(path)
    found = Paraxial.of(lens, 587.6)
    marginal = found.whole(found.marginal_ray(400.0, lens.surfaces[0].semi_diameter_mm or math.nan))
    assert abs(marginal.angle) / VITREOUS == pytest.approx(0.05, rel=1e-9)


def test_a_scene_takes_the_medium_of_its_lens_file_or_another(tmp_path: Path) -> None:
    path = tmp_path / "eye.toml"
    write_lens_file(eye(index=VITREOUS), path)
    sensor = {"pixels": [6, 6], "pixel_mm": 0.1}
    own = Scene(camera={"lens": {"file": str(path)}, "sensor": sensor, "focus_mm": 500.0})
    assert first_order(own).image_index == VITREOUS
    assert first_order(own.changed({"camera.image_medium": {"index": 1.4}})).image_index == 1.4
    assert first_order(own.changed({"camera.image_medium": {"index": 1.0}})).image_index == 1.0
