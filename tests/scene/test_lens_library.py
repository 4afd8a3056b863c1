"""The index of the lenses that come with lfmesh says what the lenses are; a missing file leads to them."""

from pathlib import Path

import pytest

from lfmesh.assets import asset_path
from lfmesh.errors import SceneError
from lfmesh.scene import load_lens, loads
from lfmesh.scene.lens_library import entries


def test_the_index_holds_a_line_for_each_lens_with_its_computed_focal_length() -> None:
    """To be written again by tools/make_lens_index.py where it differs."""
    assert asset_path("lenses/index.txt").read_text(encoding="utf-8").splitlines() == list(map(str, entries()))


HAS_IT = 'cannot be read: No such file or directory; the library has this lens: file = "lib:double_gauss_50mm"'


@pytest.mark.parametrize(
    ("file", "answer"),
    [
        ("assets/lenses/double_gauss_50mm.toml", HAS_IT),
        ("../lenses/double_gauss_50mm.toml", HAS_IT),
        (
            "assets/lenses/double_gaus_50mm.toml",
            "\"lib:NAME\" (did you mean 'double_gauss_50mm'?), see lfmesh lens list",
        ),
        ("double_gaus_50mm.toml", ""),
    ],
)
def test_a_missing_lens_file_leads_to_the_lens_of_the_library(file: str, answer: str, tmp_path: Path) -> None:
    with pytest.raises(SceneError) as of_scene:
        loads(f'camera.lens.file = "{file}"\ncamera.sensor = {{ pixels = [9, 9], pixel_mm = 0.1 }}', tmp_path)
    with pytest.raises(SceneError) as of_lens:
        load_lens(tmp_path / file)
    for told in (str(of_scene.value), str(of_lens.value)):
        assert f"{tmp_path / file}: cannot be read" in told
        assert answer in told if answer else "lib:" not in told
