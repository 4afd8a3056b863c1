"""Background-oriented schlieren of pictures made by hand: signs, scales, errors, refusals and files."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.lightfield.views.upright import Upright
from lfmesh.scene import Scene

Array = np.ndarray

FIELD_MM, NOISE = 350.0, 0.05

SIGMAS = 4.0
"""Level of each z-test: 6e-5."""


def deflection(x: Array, y: Array) -> tuple[Array, Array]:
    """Return the change of the slopes of light that a pixel sees at x and y, mm, on the background."""
    return 4e-5 + 1e-5 * x, -3e-5 + 6e-6 * y


def dots(x: Array, y: Array) -> Array:
    """Return the light of a background at points, mm."""
    random = np.random.default_rng(3)
    light = np.full(x.shape, 0.5)
    for at_x, at_y in random.uniform(-9.0, 9.0, (1500, 2)):
        light += np.exp(-0.5 * ((x - at_x) ** 2 + (y - at_y) ** 2) / 0.16**2)
    return light


@pytest.fixture
def scene(camera: Callable[..., Scene]) -> Scene:
    """A conventional camera that is focused on 500 mm."""
    plenoptic = camera().camera
    sensor = {"pixels": (120, 110), "pixel_mm": plenoptic.sensor.pixel_mm}
    return Scene(
        camera={"focus_mm": 500.0, "lens": plenoptic.lens, "sensor": sensor}, transport={"threads": 1, "seed": 1}
    )


def grid(scene: Scene) -> tuple[Array, Array]:
    """Return x and y on the plane in focus of the pixels of an upright picture, mm."""
    columns, rows = scene.camera.sensor.pixels
    sample = lf.first_order(scene).object_sampling_mm
    return np.meshgrid(sample * (np.arange(columns) - 0.5 * (columns - 1)), -sample * (
        np.arange(rows) - 0.5 * (rows - 1)
    ))  # fmt: skip


def pair(scene: Scene, image_of: Callable[..., lf.Image], seed: int = 0) -> tuple[lf.Image, lf.Image]:
    """Return noisy images of the background, with and without the flow."""
    x, y = grid(scene)
    eps_x, eps_y = deflection(x, y)
    away = 500.0 - FIELD_MM
    random, turn = np.random.default_rng(seed), Upright.of(scene).picture
    images = []
    for light, number in ((dots(x + away * eps_x, y + away * eps_y), 1), (dots(x, y), 2)):
        mean = turn(light + NOISE * random.standard_normal(light.shape))
        images.append(image_of(scene.changed({"transport.seed": number}), mean, np.full(mean.shape, NOISE)))
    return images[0], images[1]


def test_deflections_are_those_of_the_light(scene: Scene, image_of: Callable[..., lf.Image]) -> None:
    """Positive deflections turn light to the right and up; the dots go the other way."""
    x, y = grid(scene)
    z = []
    for seed in range(8):
        found = lf.schlieren(*pair(scene, image_of, seed), step=27, field_mm=FIELD_MM)
        at = np.ix_(found.t_px, found.s_px)
        right = np.stack(deflection(x[at], y[at]), axis=-1)
        z.append((found.deflection_rad - right) / found.deflection_error_rad * np.maximum(found.misfit, 1.0)[..., None])
    number = np.size(z)
    assert number > 100
    assert (np.abs(np.mean(z, axis=(0, 1, 2))) < SIGMAS / np.sqrt(number / 2)).all()
    assert abs(np.mean(np.square(z)) - 1.0) < SIGMAS * np.sqrt(2.0 / number)
    dots_moved = -found.deflection_rad * (500.0 - FIELD_MM) / found.sample_mm
    assert np.allclose(found.displacement_px, dots_moved, rtol=1e-9)
    assert found.background_mm == pytest.approx(500.0)
    assert found.sample_mm == pytest.approx(lf.first_order(scene).object_sampling_mm, rel=1e-6)


def light_field(scene: Scene, shift_px: tuple[float, float], seed: int) -> lf.LightField:
    """Return a light field of 2 × 3 views of the same dots, displaced by samples to the right and up."""
    rows, columns = 60, 50
    t, s = np.mgrid[:rows, :columns].astype(np.float64)
    assert scene.camera.mla is not None
    pitch = scene.camera.mla.pitch_mm
    picture = dots(0.16 * (s - 25.0 - shift_px[0]), -0.16 * (t - 30.0 + shift_px[1]))
    noise = NOISE * np.random.default_rng(seed).standard_normal((2, 3, rows, columns, 1))
    values = {
        "data": (picture[..., None] + noise).astype(np.float32),
        "stderr": np.full(noise.shape, NOISE, np.float32),
        "v_rad": np.zeros(2),
        "u_rad": np.zeros(3),
        "t_mm": pitch * np.arange(rows),
        "s_mm": pitch * np.arange(columns),
        "sharing": np.ones((rows, columns), np.float32),
    }
    rest = {"wavelengths_nm": scene.wavelengths_nm, "unit": "W per pixel", "scene": scene, "sampling": "by hand"}
    return lf.LightField(**values, **rest)


def test_every_view_of_a_light_field_is_evaluated(camera: Callable[..., Scene]) -> None:
    scene = camera()
    moved = light_field(scene.changed({"transport.seed": 5}), (0.4, -0.7), 1)
    words: list[str] = []
    found = lf.schlieren(moved, light_field(scene, (0.0, 0.0), 2), field_mm=FIELD_MM, progress=words.append)
    assert words[-1] == "displacements: picture 6 of 6"
    assert found.misfit.shape[:2] == (2, 3)
    error = (found.displacement_px - (0.4, -0.7)) / found.displacement_error_px
    assert np.abs(error).max() < 5.0
    assert found.sample_mm == pytest.approx(lf.first_order(scene).object_sampling_mm, rel=0.01)


def test_scales_follow_from_the_distances(scene: Scene, image_of: Callable[..., lf.Image]) -> None:
    """A background twice as far from the entrance pupil has twice the size per pixel."""
    images = pair(scene, image_of)
    near = lf.schlieren(*images, field_mm=100.0)
    pupil = lf.first_order(scene).entrance_pupil_z_mm
    far = lf.schlieren(*images, background_mm=2.0 * (500.0 + pupil) - pupil, field_mm=100.0)
    assert far.sample_mm == pytest.approx(2.0 * near.sample_mm, rel=1e-9)
    ratio = 2.0 * (near.background_mm - 100.0) / (far.background_mm - 100.0)
    assert np.allclose(far.deflection_rad, ratio * near.deflection_rad, rtol=1e-9)


def test_the_flow_lies_where_the_media_bend_light(scene: Scene, image_of: Callable[..., lf.Image]) -> None:
    """The middle of the boxes of all fields, in the camera's frame; media that only absorb do not count."""
    run, reference = pair(scene, image_of)
    box = {"kind": "box", "size_mm": [20.0, 20.0, 40.0]}
    media = [
        {"bounds": box, "index": 1.0001, "position_mm": [0.0, 0.0, -300.0]},
        {"bounds": box, "index": 1.0001, "position_mm": [0.0, 0.0, -390.0]},
        {"bounds": box, "absorption_per_mm": 0.001, "position_mm": [0.0, 0.0, -100.0]},
    ]
    hot = image_of(run.scene.changed({"media": media}), run.mean, run.stderr)
    assert lf.schlieren(hot, reference).field_mm == pytest.approx(345.0)


def test_a_common_seed_is_warned_of(scene: Scene, image_of: Callable[..., lf.Image]) -> None:
    run, _ = pair(scene, image_of)
    with pytest.warns(UserWarning, match="the same seed, 1"):
        lf.schlieren(run, run, field_mm=FIELD_MM)


def test_pictures_that_cannot_be_compared_are_refused(
    scene: Scene, image_of: Callable[..., lf.Image], camera: Callable[..., Scene]
) -> None:
    run, reference = pair(scene, image_of)
    other = scene.changed({"camera.lens.stop_semi_diameter_mm": 3.0, "transport.seed": 2})
    plenoptic = image_of(camera(), np.ones((130, 150)))
    cases = {
        "different cameras": lambda: lf.schlieren(run, image_of(other, reference.mean, reference.stderr)),
        "lf.decode": lambda: lf.schlieren(plenoptic, plenoptic),
        "no standard errors": lambda: lf.schlieren(
            run, image_of(reference.scene, reference.mean, np.full(reference.mean.shape, np.nan)), field_mm=FIELD_MM
        ),
        "window = 20": lambda: lf.schlieren(run, reference, window=20),
        "window = 111": lambda: lf.schlieren(run, reference, window=111, field_mm=FIELD_MM),
        "step = 0": lambda: lf.schlieren(run, reference, step=0),
        "reach = 0": lambda: lf.schlieren(run, reference, reach=0),
        "field_mm = 600": lambda: lf.schlieren(run, reference, field_mm=600.0),
        "background_mm = -5": lambda: lf.schlieren(run, reference, background_mm=-5.0, field_mm=1.0),
        "no medium of the run bends light": lambda: lf.schlieren(run, reference),
    }
    for words, call in cases.items():
        with pytest.raises(lf.LfmeshError, match=words):
            call()


def test_the_command_adds_maps_and_a_figure(
    scene: Scene, image_of: Callable[..., lf.Image], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, reference = pair(scene, image_of)
    folders = [str(lf.save(run, tmp_path / "hot")), str(lf.save(reference, tmp_path / "cold"))]
    assert main(["schlieren", *folders, "--field-mm", str(FIELD_MM), "--step", "20"]) == 0
    assert "Light is deflected by up to" in capsys.readouterr().out
    assert (tmp_path / "hot" / "schlieren.png").is_file()
    channels = OpenEXR.File(str(tmp_path / "hot" / "schlieren.exr"), separate_channels=True).channels()
    found = lf.schlieren(lf.open_run(folders[0]), lf.open_run(folders[1]), step=20, field_mm=FIELD_MM)
    assert np.allclose(channels["deflection_x_rad"].pixels, found.deflection_rad[..., 0], rtol=1e-6)
    assert np.allclose(channels["displacement_error_y_px"].pixels, found.displacement_error_px[..., 1], rtol=1e-6)
    # The files belong to the run, and a new run replaces them.
    lf.save(reference, tmp_path / "hot")
    assert not (tmp_path / "hot" / "schlieren.exr").exists()


def test_it_shows_itself(scene: Scene, image_of: Callable[..., lf.Image]) -> None:
    found = lf.schlieren(*pair(scene, image_of), field_mm=FIELD_MM)
    assert repr(found).startswith("<Schlieren: ")
    assert "largest deflection" in found._repr_html_()
    assert len(found.figure().axes) >= 2
