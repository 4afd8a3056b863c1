"""Ready-made studies are valid as they are written, and hold every mode."""

import re
import tomllib
from pathlib import Path

import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.cli import main
from lfmesh.study.tolerances.error_modes import TEMPLATES
from tests.cameras import close_up_camera

SCENE = asset_path("scenes/first_light.toml")


@pytest.mark.parametrize("name", TEMPLATES)
def test_a_template_is_a_study_that_can_be_planned(name: str, tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    assert main(["study", "--template", name, str(SCENE), "-o", str(path)]) == 0
    plan = lf.Study.load(path).plan
    assert len(plan.points) > 10
    text = path.read_text()
    assert text.startswith("# ")
    # A reader who edits it finds each axis with its name.
    assert all(axis["label"] for axis in tomllib.loads(text)["axes"])
    # Values are written as a person would, without the rounding of products.
    assert not [number for number in re.findall(r"\d+\.\d+", text.partition("[[axes]]")[2]) if len(number) > 12]
    # The key does the same as the file that was written.
    path.write_text(f'scene = "{SCENE}"\ntemplate = "{name}"\nmetrics = {tomllib.loads(text)["metrics"]}\n')
    assert lf.Study.load(path).plan.digest == plan.digest


def test_assembly_moves_everything_in_every_way() -> None:
    ready = TEMPLATES["assembly"](lf.solved(lf.load(SCENE)))
    paths = {axis.path for axis in ready.axes}
    for body in ("mla", "sensor"):
        for field in ("tilt_deg", "shift_mm"):
            assert {f"camera.{body}.pose.{field}[{i}]" for i in range(3)} <= paths
    assert {f"camera.lens.elements[{i}].pose.shift_mm[0]" for i in range(5)} <= paths
    # The stop has a decentre and no tilt; the air between elements has its spacing.
    assert "camera.lens.elements[2].pose.tilt_deg[0]" not in paths
    assert "camera.lens.surfaces[1].thickness_mm" in paths
    assert all(len(axis.listed()) == 4 for axis in ready.axes)


def test_an_immersed_lens_has_the_elements_and_spaces_of_the_dry_one() -> None:
    """Its stop stands behind the last surface, in the medium."""
    dry = lf.Scene(camera=close_up_camera())
    air, oil = (
        TEMPLATES["assembly"](lf.solved(each)) for each in (dry, dry.changed({"camera.image_medium": {"index": 1.3}}))
    )
    assert [axis.path for axis in oil.axes] == [axis.path for axis in air.axes]
    assert oil.changes == air.changes
    assert "camera.lens.surfaces[1].thickness_mm" in [axis.path for axis in oil.axes]


def test_a_template_without_what_it_is_about_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = lf.load(SCENE).changed({"camera.mla": None, "camera.sensor.distance_mm": None, "targets": ()})
    (tmp_path / "scene.toml").write_text(scene.dump_toml())
    assert main(["study", "--template", "manufacturing", str(tmp_path / "scene.toml"), "-o", "x.toml"]) == 2
    assert "need a microlens array, but the camera has none" in capsys.readouterr().err
    assert main(["study", "--template", "asembly", str(SCENE), "-o", "x.toml"]) == 2
    assert "did you mean 'assembly'" in capsys.readouterr().err


@pytest.mark.parametrize(("pixels", "samples"), [(640, 8), (320, 16), (160, 32), (10, 128)])
def test_templates_name_more_samples_where_there_are_fewer_pixels(pixels: int, samples: int) -> None:
    """Noise of a mean square over pixels goes with 1/(samples · side)."""
    lenslets = (max(1, pixels // 10),) * 2
    scene = lf.load(SCENE).changed({"camera.sensor.pixels": (pixels, pixels), "camera.mla.count": lenslets})
    assert TEMPLATES["assembly"](lf.solved(scene)).changes["transport.samples"] == samples
