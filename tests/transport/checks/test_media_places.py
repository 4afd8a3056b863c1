"""Where media and particles stand, and how much light media take away, against chords in closed form."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.scene.toml import dump
from lfmesh.transport.checks.found import _black
from lfmesh.transport.checks.media_places import media_places, unseen

RADIUS = 20.0
Place = tuple[float, float, float]


def camera(**more: Any) -> lf.Scene:
    """A thin lens of 50 mm, which sees 180 mm × 180 mm of the plane 500 mm before it."""
    lens = {"surfaces": [{"paraxial": True, "focal_length_mm": 50.0, "semi_diameter_mm": 5.0, "stop": True}]}
    sensor = {"pixels": [20, 20], "pixel_mm": 1.0}
    scene = {"schema_version": 1, "camera": {"focus_mm": 500.0, "lens": lens, "sensor": sensor}}
    return lf.Scene.model_validate(scene | more)


def ball(position_mm: Place = (0.0, 0.0, -500.0), **more: Any) -> dict[str, Any]:
    bounds = {"kind": "sphere", "radius_mm": RADIUS}
    return {"name": "smoke", "bounds": bounds, "position_mm": position_mm, "absorption_per_mm": 0.01} | more


def place_of(medium: dict[str, Any], **more: Any) -> Any:
    return media_places(lf.build(camera(media=[medium], **more)))[0]


def test_a_ball_has_its_diameter_along_the_axis_and_off_the_axis_its_chord() -> None:
    place = place_of(ball())
    assert place.reach_mm == pytest.approx((480.0, 520.0))
    assert place.depths == pytest.approx((0.4, 0.4), rel=1e-12)
    aside = place_of(ball((12.0, 0.0, -500.0), scattering_per_mm=0.03))
    assert aside.depths[0] == pytest.approx(0.04 * 2.0 * math.sqrt(RADIUS**2 - 12.0**2), rel=1e-12)
    assert 0.999 * 1.6 < aside.depths[1] <= 1.6 * (1.0 + 1e-12)


def test_a_cylinder_and_a_box_have_their_length_along_the_axis_however_the_camera_stands() -> None:
    cylinder = {"bounds": {"kind": "cylinder", "radius_mm": 5.0, "height_mm": 60.0}, "absorption_per_mm": 0.01}
    along = place_of(cylinder | {"position_mm": (1.0, 0.0, -400.0)})
    across = place_of(cylinder | {"position_mm": (0.0, 3.0, -400.0), "rotation_deg": (0.0, 90.0, 0.0)})
    assert along.depths[0] == pytest.approx(0.6, rel=1e-12)
    assert across.depths[0] == pytest.approx(0.01 * 8.0, rel=1e-9)
    scene = camera(media=[{"bounds": {"kind": "box", "size_mm": (10.0, 10.0, 70.0)}, "absorption_per_mm": 0.01,
                           "position_mm": (0.0, 0.0, -400.0)}])  # fmt: skip
    turned = scene.changed({"camera.pose": {"tilt_deg": (0.0, 90.0, 0.0)}, "media[0].position_mm": (-400.0, 0.0, 0.0)})
    for each, length in ((scene, 70.0), (turned, 10.0)):
        assert media_places(lf.build(each))[0].depths[0] == pytest.approx(0.01 * length, rel=1e-9)


def test_a_grid_has_the_integral_of_its_voxels_along_the_axis(tmp_path: Any) -> None:
    values = np.random.default_rng(1).uniform(0.0, 0.1, (3, 3, 8))
    np.savez(tmp_path / "smoke.npz", absorption_per_mm=values, spacing_mm=(4.0, 4.0, 5.0))
    for interpolation in ("constant", "trilinear"):
        grid = {"file": str(tmp_path / "smoke.npz"), "interpolation": interpolation}
        place = place_of({"grid": grid, "position_mm": (0.0, 0.0, -500.0)})
        # The axis runs through the middles of the central column's voxels. Trilinear, the ends count half as deep.
        exact = 5.0 * values[1, 1].sum()
        assert place.depths[0] == pytest.approx(exact, rel=0.02 if interpolation == "trilinear" else 1e-9)


def test_a_mesh_and_the_inside_of_a_body_are_as_deep_as_the_box_round_them_at_most(tmp_path: Any) -> None:
    trimesh.creation.icosphere(subdivisions=2, radius=RADIUS).export(tmp_path / "ball.stl")
    mesh = place_of(ball(bounds={"file": str(tmp_path / "ball.stl"), "units": "mm"}))
    # Chief rays cross the box a little longer than the axis does.
    assert mesh.depths[0] == pytest.approx(0.4, rel=1e-6)
    assert mesh.depths[0] <= mesh.depths[1] < 0.4 * math.sqrt(1.0 + 2.0 * (RADIUS / 500.0) ** 2)
    glass = {"name": "glass", "refractor": {"index": 1.5, "box_mm": [60.0, 60.0, 60.0]}, "position_mm": (0, 0, -500.0)}
    inside = place_of(ball(inside="glass"), targets=[glass])
    for place in (mesh, inside):
        (line,) = (line for line in place.lines(587.6) if "optical depth" in line)
        assert line.endswith("; these are upper limits, of the box around it")
    assert not any("upper limits" in line for line in place_of(ball()).lines(587.6))


def test_what_is_out_of_the_field_is_named_by_check_and_in_the_report_of_a_black_picture(
    tmp_path: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    spark = {"count": 2, "bounds": {"kind": "sphere", "radius_mm": 1.0}, "intensity_w_sr": 1.0}
    scene = camera(
        media=[ball((400.0, 0.0, -500.0), emission_w_mm3_sr=1.0), {"absorption_per_mm": 1e-4}],
        particles=[spark | {"position_mm": (0.0, 300.0, -500.0)}, spark | {"position_mm": (0.0, 0.0, -500.0)}],
    )
    places = media_places(lf.build(scene))
    assert [place.share == 0.0 for place in places] == [True, False, True, False]
    assert places[3].share == 1.0
    (tmp_path / "scene.toml").write_text(dump(scene))
    assert main(["check", str(tmp_path / "scene.toml")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    for words in (
        "media[0] (smoke): absorbs, emits before the lens 480 mm to 520 mm share of the field 0 % at most",
        "Note: media[0] (smoke) is out of the field",
        "media[1]: absorbs before the lens 0 mm and beyond, unbounded share of the field 100 %",
        "optical depth 0.0001 per mm",
        "Note: particles[0] is out of the field",
        "particles[1]: particles, 2 of them emitting",
    ):
        assert words in said, said
    black: Any = SimpleNamespace(mean=np.zeros((2, 2, 1)), scene=scene)
    assert unseen(lf.build(black.scene)) == ["media[0] (smoke)", "particles[0]"]
    assert "out of the field: media[0] (smoke), particles[0]" in str(next(_black(black)))


@pytest.mark.parametrize("position_mm", [(0.37, 51.3, -500.0), (-20.1, 7.7, -260.0)])
def test_the_depth_of_a_thread_is_found_however_thin_it_is_in_the_field(position_mm: Place) -> None:
    """A ball of 0.1 mm is a 2000th of the field across: its largest depth is that of its diameter."""
    thread = ball(position_mm, bounds={"kind": "sphere", "radius_mm": 0.05})
    axis, most = place_of(thread).depths
    assert axis == 0.0
    assert 0.98 * 0.001 < most <= 0.001 * (1.0 + 1e-12)
