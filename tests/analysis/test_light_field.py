"""Cross-talk and the MTF of photographs against closed forms, random rays through the mesh, and a rendered edge."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.analysis.array_rays import ArrayRays
from lfmesh.analysis.light_field import analyse_light_field, photograph_mtf
from lfmesh.analysis.spots import half_contrast
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.lightfield.rays.ray_model import RayModel
from lfmesh.study.metrics.crosstalk import lenslet_light
from lfmesh.study.metrics.pictures import Camera, edge_scene
from lfmesh.study.metrics.resolution import edge_mtf50
from tests.instances import instances

Array = NDArray[np.float64]

PITCH, VIEWS = 0.2, 9


def ideal_camera(**mla: Any) -> lf.Scene:
    """A thin lens of f/16, an odd number of views, lenslets so slow that they are ideal, and no micro-images touch."""
    lens = {"paraxial": True, "focal_length_mm": 80.0, "semi_diameter_mm": 2.0, "stop": True}
    array = {"count": [15, 15], "pitch_mm": PITCH, "focal_length_mm": 3.0, "index": 1.5, "thickness_mm": 0.3, **mla}
    sensor = {"pixels": [15 * VIEWS, 15 * VIEWS], "pixel_mm": PITCH / VIEWS}
    return lf.Scene(camera={"focus_mm": 300.0, "lens": {"surfaces": [lens]}, "mla": array, "sensor": sensor})


def rays_of(scene: lf.Scene) -> ArrayRays:
    solved = solved_camera(scene)
    return ArrayRays(lf.build(solved.scene.camera_alone()), solved.report.image_z_mm)


def test_photographs_of_an_ideal_camera_are_blurred_by_a_lenslet_and_a_view() -> None:
    """A sample averages a point over its lenslet, and off the focus over the shift between views: two boxes.

    At whole shifts the views need no interpolation, and all of them together are as sharp as one.
    """
    scene = ideal_camera()
    # Micro-images a whole number of pixels apart are not interpolated.
    wider = RayModel.of(scene).micro_image_pitch_px / VIEWS
    rays = rays_of(scene.changed({"camera.sensor.pixel_mm": PITCH / VIEWS * wider}))
    model = RayModel.of(rays.world.scene)
    frequencies = np.linspace(0.0, 0.9 / PITCH, 19)
    for lenslets in (-1.0, -0.6, 0.0, 0.6, 1.0):
        # In place X, samples take light from θ = X/D ± k/2 and x = X ± p/2, and a point's rays cross at x = x₀ − ε θ.
        enlarged = 1.0 + model.image_excess_mm(model.distance_mm(lenslets * PITCH)) / model.pupil_to_array_mm
        known = np.abs(np.sinc(PITCH / enlarged * frequencies) * np.sinc(lenslets * PITCH * frequencies))
        middle, _, whole = photograph_mtf(
            rays, model.distance_mm(lenslets * PITCH), frequencies, by_patches=False
        )  # fmt: skip
        np.testing.assert_allclose(middle, known, atol=0.02)
        if lenslets in (-1.0, 0.0, 1.0):
            np.testing.assert_allclose(whole, known, atol=0.03)


def test_the_mtf_is_that_of_an_edge_that_is_rendered_and_refocused() -> None:
    """MTF50 of the photograph within 5 % of the slanted edge's, in focus and off it."""
    rays = rays_of(ideal_camera(count=[25, 25]).changed({"camera.sensor.pixels": (225, 225)}))
    scene = rays.world.scene.changed({"transport.samples": 16, "transport.replicates": 1})
    model = RayModel.of(scene)
    frequencies = np.linspace(0.0, 1.0 / PITCH, 61)
    for lenslets in (0.0, 0.6):
        distance = model.distance_mm(lenslets * PITCH)
        light = lf.render(edge_scene(Camera(scene, distance)), progress=False)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            picture = lf.refocus(lf.decode(light), distance).mean.mean(axis=2)
        measured = edge_mtf50(picture[3:-3, 4:-4]) / PITCH
        found = photograph_mtf(rays, distance, frequencies, by_patches=False)[2]
        assert half_contrast(frequencies, found) == pytest.approx(measured, rel=0.05)


@pytest.mark.parametrize("layout", instances(["square", "hexagonal"], long=["square"]))
def test_cross_talk_is_that_of_random_rays_through_the_mesh(layout: str) -> None:
    """A lens too fast for its lenslets, all inner ones alike: z-test at 4 sigma, and 3 % for the quadrature."""
    scene = ideal_camera(layout=layout, count=[9, 9]).changed(
        {"camera.lens.surfaces": [{"paraxial": True, "focal_length_mm": 80.0, "semi_diameter_mm": 4.2, "stop": True}],
         "camera.sensor.pixels": (88, 88), "transport.samples": 16, "transport.replicates": 8}
    )  # fmt: skip
    rays = rays_of(scene)
    found = analyse_light_field(rays.world, 300.0, np.zeros(1)).crosstalk[0]
    light = lenslet_light(scene, range(8))[:, 3:6, 3:6].sum(axis=(1, 2))
    shares = light[:, 1] / light.sum(axis=1)
    error = 4.0 * shares.std(ddof=1) / np.sqrt(8) + 0.03 * shares.mean()
    assert shares.mean() > 0.05
    assert abs(found.from_others - shares.mean()) < error
    # All lenslets are alike: what one gives, it gets.
    assert found.to_others == pytest.approx(found.from_others, rel=0.04)


@pytest.mark.parametrize(
    ("mla", "reason"),
    [
        ({"cylinder_axis": "x"}, "cylindrical lenslets make lines"),
        ({"focal_length_mm": None, "radius_mm": 3.0, "back": {"radius_mm": 3.0}}, "both faces"),
    ],
)
def test_arrays_that_cannot_be_decoded_have_no_light_field_and_a_line_that_says_why(
    mla: dict[str, Any], reason: str
) -> None:
    sheet = lf.analyse(ideal_camera(**mla), across=8)
    assert sheet.light_field is None
    assert reason in sheet.lines()[-1]


def test_the_sheet_of_a_plenoptic_camera_shows_its_light_field_and_defines_it(tmp_path: Path) -> None:
    sheet = lf.analyse(ideal_camera(), across=8)
    drawn = lf.draw_lens_sheet(sheet, tmp_path / "a.svg").read_text(encoding="utf-8")
    assert sheet.light_field is not None
    assert "micro-image cross-talk" in drawn
    assert "from others: share of the light" in drawn
    assert len(sheet.light_field.photographs) == 5
    lines = [line.split() for line in sheet.light_field.lines()]
    for head in ("lenslet/mm", "plane/mm"):
        (number,) = (number for number, words in enumerate(lines) if words[0] == head)
        assert len(lines[number]) == len(lines[number + 1])
    assert sheet.as_dict()["light_field"]["photographs"][2]["distance_mm"] == pytest.approx(300.0)
    focused = lf.analyse(lf.focused(ideal_camera(), 3.0), across=8, wavelengths_nm=(550.0,)).light_field
    assert focused is not None
    assert focused.parts[0] == "inner pixels"
