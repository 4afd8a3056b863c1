"""The deflection that `check` states, against path integrals, and its errors."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.cli import main
from lfmesh.geometry.lens.solved_camera import first_order, solved_camera
from lfmesh.optics.gladstone_dale import air_density, gladstone_dale_of_air
from lfmesh.transport.checks.field_lines import field_lines, picture_shift, seen_deflection
from lfmesh.transport.tables.bending_fields import bending_media
from lfmesh.transport.tables.field_lines import coarse_fields
from tools.make_plume import temperature_k

SCENE = "scenes/schlieren_plume.toml"


def test_the_deflection_seen_by_the_camera_is_the_largest_path_integral() -> None:
    """Chief rays cross the plume nearly along its slot, and spread from the entrance pupil."""
    scene = solved_camera(lf.load(asset_path(SCENE))).scene
    (plume,) = bending_media(scene, (550.0,))
    found = seen_deflection(plume, scene, first_order(scene))
    constant = gladstone_dale_of_air(550.0)

    def slope(x: float, z: float, h: float) -> float:
        step = 1e-3
        ends = [float(air_density(temperature_k(x + s, h, z), 101.325)) for s in (-step, step)]  # type: ignore[arg-type]
        return constant * (ends[1] - ends[0]) / (2.0 * step)

    # The field is 50 mm high at the plume; the axis is in its middle, 45 mm above the burner.
    pupil_mm, lowest = first_order(scene).entrance_pupil_z_mm, 45.0 - 0.5 * first_order(scene).field.size_mm(-600.0)[1]
    truth = max(
        abs(quad(lambda z, x=x: slope(x * (1.0 - z / (600.0 + pupil_mm)), z, lowest), -120.0, 120.0)[0])
        for x in np.linspace(5.0, 15.0, 21)
    )
    # The lattice of lines meets the steepest place to 1 %.
    assert found == pytest.approx(truth, rel=0.03)
    assert found < plume.probe.deflection


def test_the_shift_of_a_background_follows_from_similar_triangles() -> None:
    """The plane in focus lies behind the plume: the field of view there has the width of the array."""
    scene = solved_camera(lf.load(asset_path(SCENE))).scene
    facts = first_order(scene)
    width = facts.field.size_mm(-2000.0)[0]
    pixels, lenslets = picture_shift(1e-3, 500.0, 2000.0, scene, facts).split(", ")
    assert float(lenslets.split()[0]) == pytest.approx(1.5 / width * 92.0, rel=5e-3)
    assert float(pixels.split()[0]) == pytest.approx(1.5 / width * 644.0, rel=5e-3)
    far = picture_shift(1e-3, 500.0, math.inf, scene, facts)
    focal_mm = facts.efl_mm
    # For a far background the angle counts whole: about f / pitch lenslets for each radian, and less by the focus.
    assert float(far.split(", ")[1].split()[0]) == pytest.approx(1e-3 * focal_mm / 0.0875, rel=0.15)


def test_check_states_deflection_scheme_steps_and_errors(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(asset_path(SCENE))]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "media[0] (plume): bends light" in said
    for words in ("seen from the camera by", "far background moves by up to", "plane in focus moves by up to"):
        assert words in said
    assert "steps of 2 voxels" in said
    assert "error of the grid" in said
    assert "has no effect" not in said


def test_a_coarse_grid_is_warned_of_and_a_fine_one_is_not(tmp_path: Path) -> None:
    def of(spacing: float) -> list[str]:
        at = np.arange(-24.0, 24.0 + 0.5 * spacing, spacing)
        r2 = at[:, None, None] ** 2 + at[None, :, None] ** 2 + at[None, None, :] ** 2
        np.savez(tmp_path / "g.npz", index=1.0 + 1e-4 * np.exp(-r2 / 36.0), spacing_mm=spacing)
        scene = lf.load(asset_path(SCENE)).changed(
            {"media[0].grid": "g.npz", "media[0].pressure_kpa": None, "media[0].name": None}
        )
        media = bending_media(solved_camera(scene.in_folder(tmp_path)).scene, (550.0,))
        return [str(each) for each in coarse_fields(media)]

    (said,) = of(2.0)
    assert said.startswith("media[0]: a grid with half as many voxels along each axis bends light by up to")
    assert said.endswith("give smaller voxels")
    assert not of(0.5)


def test_a_uniform_index_has_no_deflection_to_state() -> None:
    scene = lf.load(asset_path(SCENE)).changed(
        {
            "media": [
                {"index": 1.0001, "bounds": {"kind": "box", "size_mm": [9.0] * 3}, "position_mm": [0.0, 0.0, -500.0]}
            ]
        }
    )
    solved = solved_camera(scene).scene
    (said,) = field_lines(bending_media(solved, (550.0,)), solved, first_order(solved))
    assert said == "media[0]: its index is uniform, so it refracts light at its faces alone"
