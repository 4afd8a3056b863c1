"""`lfmesh frames`: runs of moving particles and the true vectors beside them."""

import numpy as np
import PIL.Image

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.files import run
from tests.cameras import bench_camera

SCENE = (
    bench_camera(4, 4)
    + """
[[particles]]
count = 30
bounds = { kind = "sphere", radius_mm = 3.0 }
position_mm = [0.0, 0.0, -480.0]
intensity_w_sr = 1.0
samples = 8
displacement = { kind = "uniform", vector_mm = [0.5, 0.0, 0.25] }
[transport]
split = "transmit"
samples = 2
replicates = 2
"""
)


def test_frames_are_runs_with_true_vectors_beside_them(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    out = tmp_path / "pair"
    assert main(["frames", str(tmp_path / "scene.toml"), "-o", str(out)]) == 0
    first, second = lf.open_run(out / "frame_0"), lf.open_run(out / "frame_1")
    assert first.mean.sum() > 0.0
    assert (first.mean != second.mean).any()
    table = np.loadtxt(out / "vectors_0.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table[:, 3:], np.tile([0.5, 0.0, 0.25], (30, 1)))
    np.testing.assert_allclose(lf.particle_vectors(second.scene)[0], table[:, :3] + table[:, 3:], atol=1e-6)


def test_particles_that_stand_still_have_no_frames(tmp_path, capsys):
    (tmp_path / "scene.toml").write_text("\n".join(line for line in SCENE.splitlines() if "displacement" not in line))
    assert main(["frames", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "pair")]) == 2
    assert "none of the scene's particles moves" in capsys.readouterr().err
    assert not (tmp_path / "pair").exists()


def test_a_texture_that_changes_between_two_frames_is_named_and_in_none(tmp_path, monkeypatch, capsys):
    chart = tmp_path / "chart.png"
    PIL.Image.new("L", (4, 4), 60).save(chart)
    target = """
[[targets]]
shape = { kind = "plane", width_mm = 60.0, height_mm = 60.0 }
position_mm = [0.0, 0.0, -500.0]
material = { reflectance = 0.0, radiance_w_m2_sr = 1.0, texture = "chart.png" }
"""
    (tmp_path / "scene.toml").write_text(SCENE + target)
    usual = run.save

    def changed_after(image, folder):
        usual(image, folder)
        PIL.Image.new("L", (4, 4), 250).save(chart)

    monkeypatch.setattr(run, "save", changed_after)
    out = tmp_path / "pair"
    assert main(["frames", str(tmp_path / "scene.toml"), "-o", str(out)]) == 2
    assert "chart.png has changed" in " ".join(capsys.readouterr().err.split())
    assert (out / "frame_0" / "raw.exr").is_file()
    assert not (out / "frame_1" / "raw.exr").exists()
