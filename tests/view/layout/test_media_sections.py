"""Media in a layout drawing: where they are, as dense as they are, with their amounts in words."""

import numpy as np
import pytest
from matplotlib.image import AxesImage
from matplotlib.patches import Polygon
from matplotlib.text import Text

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.view.layout.content import layout
from lfmesh.view.layout.figure import sheet_figure


def words_of(scene: lf.Scene) -> list[str]:
    return [text.get_text() for text in sheet_figure(layout(scene)).findobj(Text)]


def example(name: str) -> lf.Scene:
    return lf.load(asset_path(f"scenes/{name}.toml"))


def test_a_flame_is_drawn_as_bright_as_its_voxels() -> None:
    drawn = layout(example("flame").changed({"media[0].name": "fire"}))
    (section,) = drawn.media
    held = np.load(asset_path("volumes/flame.npz"))
    emission, spacing = held["emission_w_mm3_sr"], np.broadcast_to(held["spacing_mm"], 3)
    number = [np.arange(n) - 0.5 * (n - 1) for n in emission.shape]
    origin = (
        held["origin_mm"] if "origin_mm" in held.files else [n[0] * d for n, d in zip(number, spacing, strict=True)]
    )
    x, y, z = (o + d * np.arange(n) for o, d, n in zip(origin, spacing, emission.shape, strict=True))
    middle = emission[np.abs(x).argmin()]
    assert section.amounts is not None
    z0, z1, y0, y1 = section.window
    rows, columns = section.amounts.shape
    at = y0 + (np.arange(rows) + 0.5) / rows * (y1 - y0), z0 + (np.arange(columns) + 0.5) / columns * (z1 - z0)
    for axis, places, truth, shift in ((0, at[0], y, -24.0), (1, at[1], z, -500.0)):
        drawn_mean = np.average(places, weights=section.amounts.sum(axis=1 - axis))
        true_mean = np.average(truth + shift, weights=middle.sum(axis=1 - axis))
        assert drawn_mean == pytest.approx(true_mean, abs=float(spacing.max()))
    assert section.amounts.max() == pytest.approx(middle.max() / emission.max(), rel=0.05)
    figure = sheet_figure(drawn)
    assert len(figure.findobj(AxesImage)) == 1
    said = [text.get_text() for text in figure.findobj(Text)]
    absorbs = held["absorption_per_mm"].max()
    assert "fire" in said
    assert f"fire emits up to {emission.max():.3g} W/(mm³ sr), absorbs up to {absorbs:.3g} per mm" in said


def test_fog_without_bounds_is_named_with_its_coefficients() -> None:
    assert "fog, everywhere before the camera, scatters 0.001 per mm, absorbs 0.0001 per mm" in words_of(example("fog"))


def test_a_bounded_medium_has_the_outline_of_its_body() -> None:
    drawn = layout(example("underwater"))
    (section,) = drawn.media
    corners = np.concatenate(section.lines)
    assert section.amounts is None
    assert corners.min(axis=0) == pytest.approx([-580.0, -200.0])
    assert corners.max(axis=0) == pytest.approx([-80.0, 200.0])
    said = [text.get_text() for text in sheet_figure(drawn).findobj(Text)]
    assert "haze" in said
    assert any(words.startswith("haze scatters") and "absorbs 0.0003 per mm" in words for words in said)


def test_a_medium_beside_the_section_is_in_words_alone() -> None:
    aside = {"media[0].name": "fire", "media[0].position_mm": [200.0, -24.0, -500.0]}
    drawn = layout(example("flame").changed(aside))
    (section,) = drawn.media
    assert section.lines == []
    figure = sheet_figure(drawn)
    assert not figure.findobj(AxesImage)
    said = [text.get_text() for text in figure.findobj(Text)]
    assert "fire" not in said
    assert any(words.startswith("fire emits") and words.endswith(", beside this section") for words in said)


def is_whole(outline: Polygon) -> bool:
    """Tell whether an outline is within the view that clips it."""
    view, size = outline.get_clip_box(), outline.get_extents()
    return view is not None and view.x0 < size.x0 and size.x1 < view.x1 and view.y0 < size.y0 and size.y1 < view.y1


def scale_of_object_side(scene: lf.Scene) -> str:
    (words,) = (words for words in words_of(scene) if words.startswith("Object side, scale"))
    return words


def test_fog_far_behind_the_targets_does_not_make_them_small_but_smoke_there_is_seen() -> None:
    scene = example("underwater")
    bare = scale_of_object_side(scene.changed({"media": ()}))
    deep = {"media[0].bounds.size_mm": [400.0, 400.0, 20_000.0], "media[0].position_mm": [0.0, 0.0, -10_080.0]}
    assert scale_of_object_side(scene.changed(deep)) == bare
    for place in ([0.0, 0.0, -900.0], [0.0, 300.0, -400.0]):
        ball = {"media[0].bounds": {"kind": "sphere", "radius_mm": 20.0}, "media[0].position_mm": place}
        outlines = [
            each for each in sheet_figure(layout(scene.changed(ball))).findobj(Polygon) if each.get_linestyle() == ":"
        ]
        assert any(is_whole(each) for each in outlines)


def test_media_alone_are_words_where_nothing_else_stands_before_the_camera() -> None:
    """Focused on infinity, without targets: the drawing has no object side."""
    scene = example("fog").changed({"targets": (), "lights": (), "camera.focus_mm": 1e9})
    assert any(words.startswith("fog, everywhere") for words in words_of(scene))


def test_a_scene_without_media_has_none() -> None:
    assert layout(example("emitting_plane")).media == []
