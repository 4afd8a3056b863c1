"""The sheet of a layout drawing: readable text, files that stand by themselves, written whole or not at all."""

import functools
import itertools
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import PIL.Image
import pytest
from matplotlib.text import Text

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.cli import main
from lfmesh.view.layout import figure as layout_figure
from lfmesh.view.layout.content import Layout, layout
from lfmesh.view.layout.figure import encoded, sheet_figure
from lfmesh.view.layout.sheet import spread
from tests.instances import instances

SCENES = sorted(path.stem for path in asset_path("scenes").glob("*.toml"))
LONG = [
    "circuit_board", "coated", "color_checker", "conventional", "diffraction", "emitting_plane", "fog", "glossy",
    "ground_glass", "hexagonal", "hot_metal", "immersed_sensor", "lit_chart", "aquarium", "lytro_class", "underwater",
    "polarised", "crossed_cylinders",
]  # fmt: skip
"""Their sheets have the parts of those of other scenes."""
LENSES = sorted(path.stem for path in asset_path("lenses").glob("*.toml"))


@functools.cache
def first_light() -> Layout:
    return layout(lf.load(asset_path("scenes/first_light.toml")))


def overlapping(drawn: Layout) -> list[tuple[str, str]]:
    """Texts of a sheet that overlap each other, or leave it."""
    with layout_figure._style():
        figure = sheet_figure(drawn)
        texts = [text for text in figure.findobj(Text) if text.get_text().strip() and text.get_visible()]
        boxes = [(text.get_text(), text.get_window_extent()) for text in texts]
    assert len(boxes) > 20
    width, height = figure.get_size_inches() * figure.dpi
    pairs = [
        (name, other)
        for (name, a), (other, b) in itertools.combinations(boxes, 2)
        if min(a.x1, b.x1) > max(a.x0, b.x0) and min(a.y1, b.y1) > max(a.y0, b.y0)
    ]
    margin = 0.3 * figure.dpi
    pairs += [
        (name, "the frame")
        for name, box in boxes
        if box.x0 < margin or box.y0 < margin or box.x1 > width - margin or box.y1 > height - margin
    ]
    return pairs


@pytest.mark.parametrize("name", instances(SCENES, long=LONG))
def test_every_scene_that_comes_with_lfmesh_draws_and_its_texts_are_clear_of_each_other(name):
    drawn = first_light() if name == "first_light" else layout(lf.load(asset_path(f"scenes/{name}.toml")))
    assert overlapping(drawn) == []
    arrived = [ray.status for bundle in drawn.bundles for ray in bundle.rays]
    # A contact sensor has no lens that sends light through its stop to every rod.
    relays = lf.first_order(lf.load(asset_path(f"scenes/{name}.toml"))).relay_magnification is not None
    assert arrived.count(lf.Status.SENSOR) >= (1 if relays else 7)


@pytest.mark.parametrize("lens", instances(LENSES, long=["achromat_100mm", "asphere_100mm", "cooke_triplet_50mm"]))
def test_every_lens_that_comes_with_lfmesh_draws_wide_open_and_its_texts_are_clear_of_each_other(lens):
    scene = lf.load(asset_path("scenes/emitting_plane.toml")).changed(
        {"camera.lens": {"file": f"../lenses/{lens}.toml"}, "targets": []}
    )
    assert overlapping(layout(scene)) == []


@pytest.mark.parametrize(
    "change",
    [
        {"camera.focus_mm": 1e9},
        {"camera.focus_mm": 60.0},
        {"camera.mla": None, "camera.sensor.pixels": (6, 4), "camera.sensor.pixel_mm": 6.0},
        {"camera.mla.pose": {"tilt_deg": (2.0, 1.5, 8.0)}, "camera.sensor.pose": {"shift_mm": (0.1, 0.4, 0.05)}},
        {"camera.lens.elements": [{"surfaces": (5, 6, 7, 8), "pose": {"tilt_deg": (2.0, 1.0, 0.0)}}]},
        {"name": "A $name$ & <tags>, " + "so long that it has to be cut " * 9, "targets[0].name": "lens " * 8},
        {"name": ""},
    ],
    ids=["infinity", "macro", "large sensor", "tilted", "tilted elements", "long names", "no name"],
)
def test_texts_are_clear_of_each_other_in_unusual_cameras(change):
    scene = lf.load(asset_path("scenes/first_light.toml"))
    assert overlapping(layout(scene.changed(change))) == []


def test_the_svg_is_xml_that_holds_its_labels_as_text():
    root = ElementTree.fromstring(encoded(first_light(), "svg"))
    assert root.tag.endswith("svg")
    texts = ["".join(e.itertext()).strip() for e in root.iter() if e.tag.endswith("}text")]
    facts = lf.first_order(first_light().scene)
    expected = {
        "first light", "double Gauss 50 mm f/2", f"{facts.efl_mm:.5g} mm", f"f/{facts.working_f_number:.3g}", "500 mm",
        "587.6 nm", "64 × 64 square, curved side to the lens", "125 µm", "0.5 mm", "p = 0.125 mm", "f = 0.5 mm",
        "stop ⌀ 9.54 mm", "array", "sensor", "axis", "bracket", "chart", "plane in focus", "100 mm",
        "640 × 640 pixels of 12.5 µm", *(f"L{i}" for i in range(1, 7)),
    }  # fmt: skip
    assert expected <= set(texts)
    assert "L7" not in texts


@pytest.mark.parametrize(("change", "said"), [({}, "500 mm"), ({"index": 1.333}, "500 mm in n = 1.333")])
def test_the_medium_of_the_objects_stands_beside_the_plane_in_focus(change, said):
    given = {"camera.object_medium": change} if change else {}
    figure = sheet_figure(layout(lf.load(asset_path("scenes/emitting_plane.toml")).changed(given)))
    assert said in [text.get_text() for text in figure.findobj(Text)]


def test_the_medium_of_the_image_stands_beside_the_pixels():
    scene = lf.load(asset_path("scenes/emitting_plane.toml")).changed({"camera.image_medium": {"index": 1.333}})
    figure = sheet_figure(layout(scene))
    assert any(text.get_text().endswith("µm in n = 1.333") for text in figure.findobj(Text))


def test_names_are_written_as_they_are():
    name = "A $x^2$ & <tag> \\alpha"
    drawn = replace(first_light(), scene=first_light().scene.changed({"name": name}))
    root = ElementTree.fromstring(encoded(drawn, "svg"))
    assert name in {"".join(e.itertext()) for e in root.iter() if e.tag.endswith("}text")}


def test_the_scale_of_the_main_view_is_that_of_its_bar():
    root = ElementTree.fromstring(encoded(first_light(), "svg"))
    texts = ["".join(e.itertext()).strip() for e in root.iter() if e.tag.endswith("}text")]
    (scale,) = (
        float(m[1]) for text in texts if (m := re.match(r"Meridional section x = 0, scale ([\d.]+) : 1$", text))
    )
    assert "10 mm" in texts
    lines = [
        np.array([float(v) for v in re.findall(r"-?[\d.]+", e.get("d"))]).reshape(-1, 2)
        for e in root.iter()
        if e.tag.endswith("}path") and e.get("d") and re.search(r"stroke-width: 2$", e.get("style") or "")
    ]
    # Three views, three bars; 72 points an inch.
    bars = [np.ptp(line[:, 0]) / 72.0 * 25.4 for line in lines if len(line) == 2 and np.ptp(line[:, 1]) == 0.0]
    assert len(bars) == 3
    assert bars[0] == pytest.approx(10.0 * scale, rel=0.005)


def test_the_same_scene_makes_the_same_bytes():
    again = layout(lf.load(asset_path("scenes/first_light.toml")))
    for kind in ("svg", "pdf"):
        assert encoded(first_light(), kind) == encoded(again, kind)


def test_each_ending_makes_its_kind_of_file(tmp_path, monkeypatch):
    monkeypatch.setattr(layout_figure, "layout", lambda scene: first_light())
    for ending, start in ((".svg", b"<?xml"), (".PNG", b"\x89PNG"), (".pdf", b"%PDF")):
        path = lf.draw(first_light().scene, tmp_path / f"layout{ending}")
        assert path.read_bytes().startswith(start)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["layout.PNG", "layout.pdf", "layout.svg"]
    picture = np.asarray(PIL.Image.open(tmp_path / "layout.PNG").convert("L"))
    assert picture.shape[1] > 1500
    assert 0.01 < (picture < 128).mean() < 0.1


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("layout.jpg", r"ends in \.jpg; a drawing must end in one of \.svg, \.png, \.pdf"),
        ("layout", r"has no ending; a drawing must end in one of \.svg, \.png, \.pdf"),
        ("nowhere/layout.svg", "nowhere does not exist"),
        ("folder.svg", "cannot be written"),
    ],
)
def test_a_path_that_will_not_do_is_one_clear_error_and_leaves_nothing(tmp_path, monkeypatch, name, says):
    monkeypatch.setattr(layout_figure, "layout", lambda scene: first_light())
    (tmp_path / "folder.svg").mkdir()
    with pytest.raises(lf.FileError, match=says) as error:
        lf.draw(first_light().scene, tmp_path / name)
    assert "\n" not in str(error.value)
    assert name in str(error.value)
    assert [p.name for p in tmp_path.iterdir()] == ["folder.svg"]


def test_a_failure_leaves_the_older_drawing_as_it_was(tmp_path, monkeypatch):
    path = tmp_path / "layout.svg"
    path.write_text("older")
    monkeypatch.setattr(layout_figure, "layout", lambda scene: first_light())
    monkeypatch.setattr(Path, "replace", lambda self, to: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(lf.FileError, match="No space left on device"):
        lf.draw(first_light().scene, path)
    assert path.read_text() == "older"
    assert [p.name for p in tmp_path.iterdir()] == ["layout.svg"]


def test_the_command_draws_and_says_where(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    scene = str(asset_path("scenes/conventional.toml"))
    assert main(["draw", scene]) == 0
    assert capsys.readouterr().out.split() == ["layout.svg"]
    assert (tmp_path / "layout.svg").read_bytes().startswith(b"<?xml")
    assert main(["draw", scene, "-o", "layout.gif"]) == 2
    assert "a drawing must end in one of" in capsys.readouterr().err


def test_names_side_by_side_keep_their_order_their_room_and_their_borders():
    draw = np.random.default_rng(1)
    for _ in range(100):
        count = int(draw.integers(1, 9))
        middles = np.sort(draw.uniform(0.0, 10.0, count))
        widths = draw.uniform(0.1, 1.0, count)
        placed = np.array(spread(list(middles), list(widths), 0.0, 10.0))
        assert (np.diff(placed) >= 0.5 * (widths[1:] + widths[:-1]) - 1e-9).all()
        assert placed[0] - 0.5 * widths[0] >= -1e-9
        assert placed[-1] + 0.5 * widths[-1] <= 10.0 + 1e-9
    assert spread([2.0, 8.0], [1.0, 1.0], 0.0, 10.0) == [2.0, 8.0]
