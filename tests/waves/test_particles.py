"""Particles with diffraction: their light is that of their point spreads, and no ray adds to it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.files.words import account
from lfmesh.scene.literals import percent
from lfmesh.transport.render.progress import Progress
from lfmesh.transport.render.render import Renderer
from lfmesh.transport.render.render import render as trace_alone
from lfmesh.waves.between import BETWEEN
from lfmesh.waves.lit_particle import Lit, Particle
from lfmesh.waves.particles import LOOKING, STAGE
from lfmesh.waves.pupil_waves import pupil_waves

WAVE_NM, FAR = 550.0, 2000.0

POINT = {
    "count": 2,
    "bounds": {"kind": "box", "size_mm": (1.0, 1.0, 1.0)},
    "position_mm": (0.0, 0.0, -FAR),
    "intensity_w_sr": 3.0,
    "samples": 20_000,
}
BANDS = {"diffraction": "stop", "split": "transmit", "samples": 8, "replicates": 4}
PLANE = {
    "shape": {"kind": "plane", "width_mm": 400.0, "height_mm": 400.0},
    "position_mm": (0.0, 0.0, -2.0 * FAR),
    "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0},
}


def scene(**changes: Any) -> lf.Scene:
    """A camera at f/25 without an array, and two particles about the plane in focus."""
    image = 50.0
    lens = [{
        "paraxial": True, "focal_length_mm": 1.0 / (1.0 / image + 1.0 / FAR), "stop": True, "semi_diameter_mm": 1.0,
    }]  # fmt: skip
    given = {
        "schema_version": 1,
        "camera": {"lens": {"surfaces": lens}, "sensor": {"pixels": [40, 40], "pixel_mm": 0.01, "distance_mm": image}},
        "particles": [POINT],
        "transport": {
            "diffraction": "stop", "split": "transmit", "wavelengths_nm": [WAVE_NM], "samples": 8, "replicates": 4,
        },
    }  # fmt: skip
    return lf.Scene.model_validate(given).changed(changes)


def test_particles_are_pictured_by_their_point_spreads() -> None:
    given = scene()
    film = sum(3.0 * lf.point_spread(given, point).mean for point in lf.build(given).particles[0].points)
    image = lf.render(given)
    np.testing.assert_allclose(image.mean[:, :, 0], film, rtol=1e-12)
    assert (image.error == 0.0).all()
    assert "particles by point spreads" in image.engine
    # Rays that diffraction does not turn bring the same light to as few pixels as there are particles.
    plain = lf.render(scene(**{"transport.diffraction": "none"}))
    error = np.sqrt((plain.stderr**2).sum())
    tails = 0.015 * plain.mean.sum()
    assert abs(image.mean.sum() - plain.mean.sum()) < 4.0 * error + tails
    assert image.mean.max() < 0.8 * plain.mean.max()


SHEET = {
    "point_mm": (0.0, 0.0, -FAR), "normal": (0.0, 0.0, 1.0), "direction": (1.0, 0.0, 0.0), "thickness_mm": 4.0,
    "width_mm": 9.0, "power_w": 1.0,
}  # fmt: skip


def in_a_sheet(diameter_um: float, **changes: Any) -> lf.Scene:
    """A particle in a light sheet, seen from aside, that scatters by Mie's functions."""
    one = {key: POINT[key] for key in ("bounds", "position_mm", "samples")} | {"count": 1, "sheet": SHEET}
    phase = {"kind": "mie", "diameter_um": diameter_um, "index": 1.59}
    return scene(particles=[one | {"phase": phase}], **changes)


def test_a_picture_of_particles_alone_is_not_black_and_keeps_the_warnings_of_their_spreads(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told = lf.errors.DiffractionWarning("light goes beyond the grid")
    monkeypatch.setattr("lfmesh.waves.particles.warnings_of", lambda beyond: [told])
    with pytest.warns(lf.errors.DiffractionWarning, match="beyond the grid") as shown:
        image = lf.render(scene())
    assert told in image.warnings
    assert [each.message for each in shown].count(told) == 1
    assert not any(isinstance(each, lf.errors.BlackPictureWarning) for each in image.warnings)
    dark = lf.render(scene(**{"particles[0].intensity_w_sr": 0.0}))
    assert any(isinstance(each, lf.errors.BlackPictureWarning) for each in dark.warnings)


def test_particles_that_scatter_unevenly_send_what_rays_bring() -> None:
    """By the phase function towards the lens."""
    waves, rays = lf.render(in_a_sheet(2.0)), lf.render(in_a_sheet(2.0, **{"transport.diffraction": "none"}))
    assert waves.mean.sum() == pytest.approx(rays.mean.sum(), rel=0.03)


def test_particles_whose_light_changes_over_the_lens_are_refused() -> None:
    with pytest.raises(lf.LfmeshError, match=r"particles\[0\], number 0 at .*: its scattered light varies by"):
        lf.render(in_a_sheet(80.0, **{"camera.lens.surfaces[0].semi_diameter_mm": 10.0}))


def test_particles_add_to_what_is_traced() -> None:
    both = lf.render(scene(targets=[PLANE]))
    traced = lf.render(scene(targets=[PLANE], particles=[]))
    alone = lf.render(scene())
    np.testing.assert_allclose(both.mean, traced.mean + alone.mean, rtol=1e-9)
    np.testing.assert_array_equal(both.stderr, traced.stderr)
    np.testing.assert_allclose(both.upper, traced.upper + alone.mean, rtol=1e-9)


def test_particles_beside_the_field_are_dark() -> None:
    image = lf.render(scene(particles=[POINT | {"position_mm": (1000.0, 0.0, -FAR)}]))
    assert not image.mean.any()
    assert image.ledger.untraced == 0.0


def test_particles_behind_a_target_are_dark_and_one_that_is_half_hidden_is_named() -> None:
    """A wall before them takes all of their light; its edge on the axis, half of one particle's."""
    one = POINT | {"bounds": {"kind": "box", "size_mm": (1e-3, 1e-3, 1e-3)}, "count": 1}
    wall = {
        "shape": {"kind": "plane", "width_mm": 40.0, "height_mm": 40.0},
        "position_mm": (0.0, 0.0, -0.5 * FAR),
        "material": {"reflectance": 0.0},
    }
    assert (lf.render(scene(particles=[one], targets=[wall])).mean == 0.0).all()
    half = wall | {"position_mm": (20.0, 0.0, -0.5 * FAR)}
    words = r"particles\[0\], number 0 at \(.*, -2000\) mm: .* hides it from .* points of the pupil"
    with pytest.raises(lf.LfmeshError, match=words):
        lf.render(scene(particles=[one], targets=[half]))


def two_at(*z_mm: float) -> lf.Scene:
    """Particles on the axis before a lens of f/2.5."""
    one = POINT | {"bounds": {"kind": "box", "size_mm": (1e-3, 1e-3, 1e-3)}, "count": 1}
    particles = [one | {"position_mm": (0.0, 0.0, z)} for z in z_mm]
    return scene(particles=particles, **{"camera.lens.surfaces[0].semi_diameter_mm": 10.0})


def test_a_particle_too_wide_for_waves_is_named_before_the_first_spread(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By a render and by `lfmesh check`, which leaves those alone that can be pictured."""

    def never(*_: object, **__: object) -> None:
        pytest.fail("the waves were followed")

    monkeypatch.setattr("lfmesh.waves.lit_particle.followed", never)
    far, words = two_at(-FAR, -200.0), r"particles\[1\], number 0 at \(.*, -200\) mm: .* points per side"
    with pytest.raises(lf.LfmeshError, match=words) as error:
        lf.render(far)
    assert "\n" not in str(error.value)
    file = tmp_path / "scene.toml"
    file.write_text(far.dump_toml())
    assert main(["check", str(file)]) == 2
    assert "particles[1], number 0" in " ".join(capsys.readouterr().err.split())
    file.write_text(two_at(-FAR, -1.02 * FAR).dump_toml())
    assert main(["check", str(file)]) == 0
    file.write_text(far.changed({"transport.diffraction": "none"}).dump_toml())
    assert main(["check", str(file)]) == 0


def test_a_particle_whose_spread_does_not_settle_is_told_what_helps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Particles have no tolerance that could be raised."""
    monkeypatch.setattr("lfmesh.waves.extent.MOST", 250)
    monkeypatch.setattr("lfmesh.waves.lit_particle.TOLERANCE", 1e-9)
    with pytest.raises(lf.LfmeshError, match=r"particles\[0\], number 0 .* above 1e-09; give a point nearer") as error:
        lf.render(scene())
    assert "tolerance =" not in str(error.value)


def test_a_run_tells_the_progress_of_spreads_and_what_light_they_bring() -> None:
    told: list[Progress] = []
    given = scene(targets=[PLANE], **{"transport.wavelengths_nm": [500.0, 600.0]})
    image = lf.render(given, told.append)
    spreads = [each for each in told if each.stage == STAGE]
    assert [(each.done, each.total) for each in spreads] == [(done, 4) for done in (1, 2, 3, 4)]
    assert [(each.done, each.total) for each in told if each.stage == LOOKING] == [(1, 2), (2, 2)]
    traced = lf.render(given.changed({"particles": []}))
    assert traced.ledger.untraced == 0.0
    assert image.ledger.untraced == pytest.approx(image.mean.sum() - traced.mean.sum(), rel=1e-9)
    assert abs(image.ledger.imbalance) < 1e-12
    share = percent(image.ledger.untraced / image.mean.sum())
    assert any(line.startswith("Particles, pictured by") and share in line for line in account(image))
    assert not any(line.startswith("Particles, pictured by") for line in account(traced))


def test_check_says_beforehand_how_many_particles_are_pictured_by_spreads() -> None:
    said = "2 particles are pictured by point spreads"
    assert any(said in line for line in lf.first_order(scene()).warnings)
    plain = lf.first_order(scene(**{"transport.diffraction": "none"})).warnings
    assert not any("point spreads" in line for line in plain)


ARRAY = {
    "layout": "square", "count": (4, 4), "pitch_mm": 0.1, "focal_length_mm": 2.5, "index": 1.5, "thickness_mm": 0.1,
    "curved_side": "lens", "distance_mm": 50.0,
}  # fmt: skip


def own_pictures(given: lf.Scene) -> NDArray[np.float64]:
    """Return the sum of the particles' own point spreads."""
    points = lf.build(given).particles[0].points
    return np.asarray(sum(POINT["intensity_w_sr"] * lf.point_spread(given, point).mean for point in points))


def counted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Count the spreads that are computed, own and at corners of cells."""
    found: list[int] = []

    def counting(function: Any) -> Any:
        return lambda *given, **named: (found.append(1), function(*given, **named))[1]

    monkeypatch.setattr("lfmesh.waves.between.pupil_waves", counting(pupil_waves))
    monkeypatch.setattr("lfmesh.waves.point_spread.pupil_waves", counting(pupil_waves))
    return found


def test_many_particles_without_an_array_are_interpolated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Between few spreads, within a hundredth of the light of their own."""
    grains = POINT | {"count": 80, "bounds": {"kind": "box", "size_mm": (14.0, 14.0, 160.0)}}
    given = scene(particles=[grains])
    own = own_pictures(given)
    spreads = counted(monkeypatch)
    image = lf.render(given)
    assert len(spreads) < 40
    assert np.abs(image.mean[:, :, 0] - own).sum() < BETWEEN * own.sum()


def test_cells_are_cut_until_spreads_between_are_right(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where depth blurs, a single cell would be wrong by a tenth of the light and more."""
    grains = POINT | {"count": 40, "bounds": {"kind": "box", "size_mm": (10.0, 10.0, 1200.0)}}
    given = scene(particles=[grains], **{"camera.lens.surfaces[0].semi_diameter_mm": 2.0})
    own = own_pictures(given)
    image = lf.render(given)
    assert np.abs(image.mean[:, :, 0] - own).sum() < BETWEEN * own.sum()
    monkeypatch.setattr("lfmesh.waves.between.BETWEEN", 10.0)
    assert np.abs(lf.render(given).mean[:, :, 0] - own).sum() > 0.1 * own.sum()


def test_particles_whose_chief_ray_is_stopped_have_their_own_spreads(monkeypatch: pytest.MonkeyPatch) -> None:
    """No place is known for the spread between others; without its own the particle would be dark."""
    given = scene(particles=[POINT | {"count": 20, "bounds": {"kind": "box", "size_mm": (14.0, 14.0, 100.0)}}])
    own, seen = own_pictures(given), Particle.lit

    def stopped(self: Particle, *args: Any, **named: Any) -> Lit | None:
        found = seen(self, *args, **named)
        return found and (found._replace(place_mm=np.full(2, np.nan)) if self.number == 3 else found)

    monkeypatch.setattr(Particle, "lit", stopped)
    assert np.abs(lf.render(given).mean[:, :, 0] - own).sum() < BETWEEN * own.sum()


def test_particles_beside_the_field_are_pictured_with_those_within() -> None:
    """Those on the sensor's edge keep their part: pixels show what the same place of a larger sensor does."""
    grains = POINT | {"count": 60, "bounds": {"kind": "box", "size_mm": (40.0, 40.0, 100.0)}}
    given = scene(particles=[grains])
    larger = lf.render(given.changed({"camera.sensor.pixels": (100, 100)})).mean[30:70, 30:70]
    assert np.abs(lf.render(given).mean - larger).sum() < BETWEEN * larger.sum()


@pytest.mark.long
@pytest.mark.parametrize(("f_number", "thick_mm", "most"), [(4.0, 0.4, 600), (8.0, 2.0, 200)])
def test_particles_before_a_real_lens_are_interpolated(
    f_number: float, thick_mm: float, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a thin sheet before a double Gauss, which vignettes and whose aberrations change over the field.

    At f/4 nearly each of so few particles needs its own, and looking for others costs little.
    """
    loaded = lf.load(Path(__file__).parents[2] / "assets" / "scenes" / "conventional.toml")
    stop = loaded.camera.lens.stop_semi_diameter_mm
    assert stop is not None
    grains = POINT | {
        "count": 400, "position_mm": (0.0, 0.0, -500.0), "bounds": {"kind": "box", "size_mm": (45.0, 45.0, thick_mm)},
    }  # fmt: skip
    given = loaded.changed({
        "targets": [], "lights": [], "particles": [grains], "camera.lens.stop_semi_diameter_mm": stop * 4.0 / f_number,
        "camera.sensor.pixels": (1024, 1024), "camera.sensor.pixel_mm": 0.0055, "transport": BANDS,
    })  # fmt: skip
    own = own_pictures(given)
    spreads = counted(monkeypatch)
    image = lf.render(given)
    assert len(spreads) < most
    assert np.abs(image.mean[:, :, 0] - own).sum() < BETWEEN * own.sum()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"particles": [POINT | {"count": 2001}], "camera.mla": ARRAY, "transport.diffraction": "lenslets"},
            "2,001 point spreads",
        ),
        ({"media": [{"absorption_per_mm": 1e-4}]}, "media: a point spread"),
        (
            {
                "transport": BANDS,
                "camera.sensor.bands": [{"name": "r", "center_nm": 600.0, "fwhm_nm": 50.0}],
            },
            "omit bands",
        ),
    ],
)
def test_particles_that_waves_do_not_follow_are_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(lf.LfmeshError, match=words) as error:
        lf.render(scene(**changes))
    assert "\n" not in str(error.value)


def test_rays_alone_do_not_leave_particles_out_without_a_word() -> None:
    with pytest.raises(lf.LfmeshError, match="particles are pictured by point spreads"):
        trace_alone(scene())
    with pytest.raises(lf.LfmeshError, match="particles are pictured by point spreads"):
        Renderer(lf.build(scene())).image()
