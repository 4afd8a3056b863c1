"""An axis over the configurations of a lens file: each camera has the lens of its configuration."""

import warnings

import pytest

import lfmesh as lf
from lfmesh.errors import SceneError
from lfmesh.imports import read_lens_file
from lfmesh.scene.camera.lens import FileChoices
from lfmesh.study.sweeps.plan import plan_of
from lfmesh.study.sweeps.study_file import StudyFile
from tests.imports.files import SINGLET_ZMX

ZOOM = SINGLET_ZMX.replace("MNUM 1 1\n", "MNUM 2 1\nTHIC   1   1 5 0 0\nTHIC   1   2 7.5 0 0\n")
SCENE = """\
schema_version = 1
[camera]
focus_mm = 500.0
lens = { file = "zoom.zmx", configuration = 1, stop_semi_diameter_mm = 3.0 }
sensor = { pixels = [4, 4], pixel_mm = 0.5 }
[[targets]]
shape = { kind = "plane", width_mm = 90.0, height_mm = 90.0 }
position_mm = [0.0, 0.0, -500.0]
material = { radiance_w_m2_sr = 1.0 }
[transport]
replicates = 8
samples = 16
"""


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "zoom.zmx").write_text(ZOOM)
    (tmp_path / "scene.toml").write_text(SCENE)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return lf.load(tmp_path / "scene.toml")


def test_each_camera_of_the_axis_has_the_lens_of_its_configuration(scene):
    axes = [{"path": "camera.lens.configuration", "values": [1, 2]}]
    plan = plan_of(StudyFile(scene="scene.toml", metrics=["light"], axes=axes), scene)
    file = scene.folder / "zoom.zmx"
    for point in plan.points[1:]:
        lens = lf.solved(plan.scene_of(point)).camera.lens
        alone, _ = read_lens_file(file, FileChoices(configuration=point.values[0]))
        assert [s.thickness_mm for s in lens.surfaces] == [s.thickness_mm for s in alone.surfaces]
        assert lens.surfaces[0].semi_diameter_mm == 3.0
    assert len({lf.first_order(plan.scene_of(point)).efl_mm for point in plan.points[1:]}) == 2


def test_a_configuration_that_the_file_does_not_have_is_refused(scene):
    with pytest.raises(SceneError, match="configuration = 3: the file has configurations 1 to 2"):
        lf.solved(scene.changed({"camera.lens.configuration": 3}))


def test_other_changes_keep_the_lens_that_was_read(scene):
    changed = scene.changed({"camera.lens.stop_semi_diameter_mm": 2.0})
    assert changed.camera.lens.surfaces == scene.camera.lens.surfaces
    again = changed.changed({"camera.lens.configuration": 2})
    assert again.camera.lens.file == "zoom.zmx"
    assert lf.solved(again).camera.lens.surfaces[0].semi_diameter_mm == 2.0


def test_a_configuration_is_not_chosen_where_surfaces_of_the_file_were_changed(scene):
    changed = scene.changed({"camera.lens.surfaces[0].radius_mm": 51.0})
    with pytest.raises(SceneError, match="configuration = 2: it selects from a lens file, but no file is given"):
        changed.changed({"camera.lens.configuration": 2})
