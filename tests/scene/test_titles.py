"""A scene without a name is called after its file, wherever it is shown."""

import pickle
from pathlib import Path

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.view.layout.content import layout
from lfmesh.view.layout.figure import encoded
from lfmesh.view.request import subject_of
from lfmesh.view.results import figure_of

NAMELESS = """
schema_version = 1
[camera]
focus_mm = 200.0
[camera.lens]
surfaces = [
  { radius_mm = 40.0, thickness_mm = 5.0, index = 1.5, semi_diameter_mm = 9.0 },
  { radius_mm = -40.0, thickness_mm = 2.0, semi_diameter_mm = 9.0 },
  { stop = true, semi_diameter_mm = 5.0 },
]
[camera.sensor]
pixels = [12, 10]
pixel_mm = 0.5
"""


@pytest.fixture
def scene(tmp_path: Path) -> lf.Scene:
    path = tmp_path / "small bench.toml"
    path.write_text(NAMELESS)
    return lf.load(path)


def image_of(scene: lf.Scene) -> lf.Image:
    mean = np.full((10, 12, 1), 1e-9)
    ledger = lf.Ledger(unit="m² sr", emitted=1.0, sensor=1.0, packets=1, events=1)
    return lf.Image(mean, 0.01 * mean, scene, ledger, 1.0, scene.transport.replicates, 4.0, "by hand")


def test_a_name_goes_before_the_files_and_a_script_has_none(scene: lf.Scene, tmp_path: Path) -> None:
    assert scene.title == "small bench"
    assert scene.changed({"name": "bench"}).title == "bench"
    assert lf.loads(NAMELESS).title == ""
    (tmp_path / "named.toml").write_text(f'name = "bench"\n{NAMELESS}')
    assert lf.load(tmp_path / "named.toml").title == "bench"


def test_the_title_stays_through_changes_and_is_no_part_of_the_scene(scene: lf.Scene) -> None:
    for other in (scene.changed({"camera.focus_mm": 300.0}), lf.solved(scene), lf.build(scene).scene,
                  pickle.loads(pickle.dumps(scene)), scene.in_folder("/")):  # fmt: skip
        assert other.title == "small bench"
    assert scene == lf.loads(NAMELESS)
    assert scene.digest == lf.loads(NAMELESS).digest
    assert "bench" not in scene.dump_toml()


def test_equal_scenes_of_two_files_keep_their_titles(scene: lf.Scene, tmp_path: Path) -> None:
    (tmp_path / "other.toml").write_text(NAMELESS)
    titles = [lf.analyse(each, wavelengths_nm=(550.0,)).name for each in (scene, lf.load(tmp_path / "other.toml"))]
    assert titles == ["small bench", "other"]


def test_figures_and_drawings_have_it(scene: lf.Scene) -> None:
    assert figure_of(image_of(scene)).axes[0].get_title(loc="left") == "small bench"
    assert b">small bench<" in encoded(layout(scene), "svg")


def test_a_run_keeps_the_title_of_its_scene(scene: lf.Scene, tmp_path: Path) -> None:
    folder = lf.save(image_of(scene), tmp_path / "run")
    assert lf.open_run(folder).scene.title == "small bench"
    assert subject_of(folder).world.scene.title == "small bench"
