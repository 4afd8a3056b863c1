"""The index of the lenses that come with lfmesh says what the lenses are."""

from lfmesh.assets import asset_path
from lfmesh.scene.lens_library import entries


def test_the_index_holds_a_line_for_each_lens_with_its_computed_focal_length() -> None:
    """To be written again by tools/make_lens_index.py where it differs."""
    assert asset_path("lenses/index.txt").read_text(encoding="utf-8").splitlines() == list(map(str, entries()))
