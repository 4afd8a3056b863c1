"""Results in notebooks and figures: short, upright, with their key figures, and shown where the user is."""

import base64
import html
import io
import math
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import PIL.Image
import pytest

import lfmesh as lf
from lfmesh import notebook
from lfmesh.files.depth import save_depth
from lfmesh.lightfield.views.upright import Upright
from lfmesh.view import progress, results

BRIGHT = (slice(10, 40), slice(90, 120))
"""Rows and columns of the sensor that are lit: above the middle and right of it, so that no turn goes unseen."""


def image_of(scene: lf.Scene, channels: int = 1) -> lf.Image:
    mean = np.full((100, 120, channels), 1e-12)
    mean[BRIGHT] = 1e-9
    ledger = lf.Ledger(unit="m² sr", emitted=2.0, sensor=0.5, absorbed={"stop": 1.0}, escaped=0.5, packets=1200)
    return lf.Image(mean, 0.01 * mean, scene, ledger, 1.5, scene.transport.replicates, 64.0, "by hand")


def field_of(scene: lf.Scene) -> lf.LightField:
    data = np.full((4, 4, 10, 12, 1), 1e-12, np.float32)
    data[:, :, 1:3, 9:11] = 1e-9
    data[0, 0] = np.nan
    axes = [np.linspace(-0.1, 0.1, 4), np.linspace(-0.1, 0.1, 4), np.arange(10.0) - 4.5, np.arange(12.0) - 5.5]
    return lf.LightField(data, 0.1 * data, *axes, (587.6,), "W per pixel", scene, "one a lenslet", np.ones((10, 12)))  # type: ignore[arg-type]


def photograph_of(distance_mm: float = 200.0) -> lf.Photograph:
    mean = np.linspace(0.0, 1.0, 120).reshape(10, 12, 1)
    return lf.Photograph(mean, 0.1 * mean, distance_mm, 4.0, 0.5, (587.6,), "W per pixel")


def spread_of() -> lf.PointSpread:
    mean = np.full((10, 12), 1e-12)
    mean[1:3, 2:4] = 1e-9
    return lf.PointSpread(
        mean, np.arange(12.0), np.arange(10.0), 0.5, (0.0, 0.0, -500.0), (550.0,), (1.0,), 1, 1e-8, 5e-9, 1e-8, None,
        0.01, 4, 0.001, 0.0, 1e-5,
    )  # fmt: skip


@pytest.fixture(scope="module")
def made(scene: lf.Scene, world: Any) -> dict[str, Any]:
    """One of every kind of result."""
    stack = lf.FocalStack((photograph_of(150.0), photograph_of(), photograph_of(300.0)))
    known = np.full((10, 12), 200.0)
    known[0, 0] = np.nan
    return {
        "image": image_of(scene.changed({"transport.replicates": 8})),
        "field": field_of(world.scene),
        "photograph": photograph_of(),
        "stack": stack,
        "sharp": lf.all_in_focus(stack),
        "depth": lf.DepthMap(known, known, known / 400.0, (100.0, 400.0)),
        "truth": lf.DepthTruth(*(known.astype(np.float32)[None, None], known, known, known, known)),
        "exposed": lf.Detector(exposure_s=2e-6, bayer="RGGB").expose(image_of(world.scene)),
        "report": lf.first_order(scene),
        "ledger": image_of(scene).ledger,
        "paths": lf.trace(world, [[0.0, 0.0, -5.0]] * 3, [[0.0, 0.0, 1.0]] * 3),
        "world": world,
        "scene": scene,
        "calibration": lf.calibrate(scene),
        "spread": spread_of(),
        "wavefront": lf.wavefront(scene, across=8),
    }


def test_every_result_is_one_short_line(made: dict[str, Any]) -> None:
    for name, result in made.items():
        assert repr(result).startswith(f"<{type(result).__name__}: "), name
        assert "\n" not in repr(result), name
        assert len(repr(result)) < 160, name


def test_every_result_shows_its_key_figures_as_text(made: dict[str, Any]) -> None:
    for name, result in made.items():
        if name == "calibration":
            continue
        shown = result._repr_html_()
        rows = results.key_figures(result)
        assert len(rows) >= 3, name
        for label, value in rows:
            assert f">{html.escape(label, quote=False)}</td>" in shown, (name, label)
            assert value in html.unescape(shown), (name, value)
        assert not re.search(r"""(?:src|href)=["'](?!data:)|https?:""", shown), name


@pytest.mark.parametrize("name", [name for name in lf.__all__ if isinstance(getattr(lf, name), type)])
def test_results_that_notebooks_show_have_something_to_show(name: str) -> None:
    kind = getattr(lf, name)
    if issubclass(kind, notebook.Shown):
        assert results.key_figures.dispatch(kind) is not results.key_figures.dispatch(object)
    if issubclass(kind, notebook.Pictured):
        assert results.panels.dispatch(kind) is not results.panels.dispatch(object)


def test_point_spreads_and_wavefronts_are_upright_and_have_scales(made: dict[str, Any]) -> None:
    """A light of decades by its logarithm; a wavefront by the places of its rays in the stop."""
    spread, scale = made["spread"].figure().axes
    drawn = np.asarray(spread.images[0].get_array())
    assert np.argwhere(drawn > drawn.max() - 0.5).mean(axis=0).tolist() == [1.5, 8.5]
    assert drawn.max() - drawn.min() == pytest.approx(3.0)
    assert spread.images[0].get_extent() == [-3.0, 3.0, -2.5, 2.5]
    assert "W on a pixel" in scale.get_ylabel()
    found = made["wavefront"]
    stop, scale = found.figure().axes
    drawn = np.asarray(stop.images[0].get_array().filled(np.nan))
    assert np.isfinite(drawn).sum() == len(found.opd_waves)
    x, y = found.pupil[5]
    assert drawn[round(4.0 * (1.0 - y) - 0.5), round(4.0 * (x + 1.0) - 0.5)] == found.opd_waves[5]
    assert scale.get_ylabel() == "waves"


def test_what_a_scene_is_called_is_no_markup(scene: lf.Scene) -> None:
    assert "<b>" not in scene.changed({"name": "<b>"})._repr_html_()


@pytest.mark.parametrize("name", ["image", "exposed"])
def test_pictures_of_the_sensor_are_upright(made: dict[str, Any], name: str) -> None:
    picture = np.asarray(PIL.Image.open(io.BytesIO(made[name]._repr_png_())).convert("L")).astype(float)
    lit = np.argwhere(picture > 128).mean(axis=0) / picture.shape
    # The lens inverts: rows stay as they are, columns are reversed.
    assert Upright.of(made["scene"]).inverts
    np.testing.assert_allclose(lit, [0.25, 1.0 - 105.0 / 120.0], atol=0.02)
    (axes, *_) = made[name].figure().axes
    drawn = axes.images[0].get_array()
    assert np.argwhere(drawn > 0.5 * drawn.max()).mean(axis=0) / drawn.shape == pytest.approx(lit, abs=0.02)


def test_a_light_field_is_shown_as_it_is(made: dict[str, Any]) -> None:
    picture = np.asarray(PIL.Image.open(io.BytesIO(made["field"]._repr_png_())).convert("L"))
    lit = np.argwhere(picture > 128).mean(axis=0) / picture.shape
    np.testing.assert_allclose(lit, [0.2, 10.0 / 12.0], atol=0.05)
    assert len(made["field"].figure().axes) == 4, "two pictures and their scales"


def test_the_page_holds_the_picture_that_is_shown_alone(made: dict[str, Any]) -> None:
    (content,) = re.findall(r"data:image/png;base64,([^\"]+)", made["image"]._repr_html_())
    assert base64.b64decode(content) == made["image"]._repr_png_()


def test_pictures_suit_a_notebook(scene: lf.Scene, made: dict[str, Any]) -> None:
    sizes = [PIL.Image.open(io.BytesIO(made[name]._repr_png_())).size for name in ("image", "photograph")]
    assert all(results.SMALLEST_PX <= max(size) <= 2 * results.SMALLEST_PX for size in sizes), "enlarged"
    large = image_of(scene)
    large.mean, large.stderr = (np.tile(each, (9, 9, 1)) for each in (large.mean, large.stderr))
    large.replicates = 1
    assert max(PIL.Image.open(io.BytesIO(large._repr_png_())).size) == results.LARGEST_PX


def test_bands_are_shown_in_colour(scene: lf.Scene) -> None:
    coloured = scene.changed({"transport.wavelengths_nm": [450.0, 550.0, 650.0]})
    image = image_of(coloured, 3)
    image.mean[..., :2] = 1e-13
    picture = np.asarray(PIL.Image.open(io.BytesIO(image._repr_png_())).convert("RGB")).astype(int)
    red, green, blue = picture[picture.sum(axis=2) > 150].mean(axis=0)
    assert red > 2 * max(green, blue)


def test_a_black_image_and_an_unknown_depth_have_pictures_too(scene: lf.Scene) -> None:
    image = image_of(scene)
    image.mean[...] = image.stderr[...] = 0.0
    unknown = np.full((4, 5), np.nan)
    for result in (image, lf.DepthMap(unknown, unknown, unknown, (100.0, 200.0))):
        assert result._repr_png_().startswith(b"\x89PNG")
        assert "<table" in result._repr_html_()
        result.figure().canvas.draw()


def test_a_depth_map_without_depth_shows_its_confidence_alone() -> None:
    unknown = np.full((4, 5), np.nan)
    (panel,) = results.panels(lf.DepthMap(unknown, unknown, np.ones_like(unknown), (100.0, 200.0)))
    assert panel.title == "no depth found; confidence"
    assert (panel.values == 1.0).all()


def test_in_a_notebook_a_picture_is_displayed(made: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("IPython")
    displayed: list[Any] = []
    monkeypatch.setattr(results, "in_notebook", lambda: True)
    monkeypatch.setattr("IPython.display.display", displayed.append)
    assert made["image"].show() is None
    (picture,) = displayed
    assert picture.data.startswith(b"\x89PNG")


def test_in_a_script_a_picture_opens_a_window(made: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    from matplotlib import pyplot

    windows: list[list[int]] = []
    monkeypatch.setattr(pyplot, "show", lambda: windows.append(pyplot.get_fignums()))
    pyplot.switch_backend("agg")
    made["stack"].show()
    pyplot.close("all")
    assert [len(numbers) for numbers in windows] == [1]


def told(done: int) -> lf.Progress:
    return lf.Progress(done, 1000, 2.0, done // 250, 4, "tracing")


def test_progress_is_shown_to_those_who_ask(capsys: pytest.CaptureFixture[str]) -> None:
    heard: list[lf.Progress] = []
    for wish in (heard.append, True, False, None):
        with notebook.watched(wish) as report:
            assert (report is None) == (wish in (False, None))
            if report is not None:
                report(told(500))
    assert [each.done for each in heard] == [500]
    assert capsys.readouterr().err.splitlines() == ["tracing: 50 %, 250 packets/s, 2.0 s left"]


def test_what_comes_before_tracing_has_no_packets(capsys: pytest.CaptureFixture[str]) -> None:
    with notebook.watched(True) as report:
        assert report is not None
        for done in (0, 1, 4):
            report(lf.Progress(done, 4, 5.0 * done, 0, 0, "compiling"))
        report(told(500))
    assert capsys.readouterr().err.splitlines() == [
        "compiling: 0 %",
        "compiling: 25 %",
        "compiling: 100 %",
        "tracing: 50 %, 250 packets/s, 2.0 s left",
    ]


def test_in_a_notebook_progress_is_a_bar_that_ends_as_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("IPython")
    shown: list[str] = []
    handle = SimpleNamespace(update=lambda content: shown.append(content._repr_html_()))
    monkeypatch.setattr("IPython.display.display", lambda *_, **__: handle)
    for module in (notebook, progress):
        monkeypatch.setattr(module, "in_notebook", lambda: True)
    with notebook.watched(None) as report:
        assert report is not None
        report(told(500))
        report(told(1000))
    assert "replicate 3/4" in shown[0]
    assert "50%" in html.unescape(re.sub("<[^>]*>", "", shown[0])).replace(" ", "")
    assert re.search(r">traced after [\d.]+ s<", shown[-1])
    with pytest.raises(KeyboardInterrupt), notebook.watched(True):
        raise KeyboardInterrupt
    assert ">stopped after" in shown[-1]


def test_a_field_whose_scale_is_not_known_has_no_axes(made: dict[str, Any]) -> None:
    far = lf.Photograph(made["photograph"].mean, made["photograph"].stderr, math.inf, 4.0, math.inf, (587.6,), "W")
    assert results.panels(far)[0].size_mm is None
    assert results.panels(far)[0].title == "focused on infinity"
    assert dict(results.key_figures(far))["focused on"] == "infinity"


def test_names_with_unbalanced_mathematics_stand_in_figures_as_they_are(scene: lf.Scene, tmp_path: Path) -> None:
    named = scene.changed({"name": "gap a$b^$"})
    figure = results.figure_of(image_of(named))
    figure.savefig(tmp_path / "image.png")
    assert figure.axes[0].get_title(loc="left") == "gap a$b^$"
    lf.save(image_of(named), tmp_path / "run")
    found = np.linspace(400.0, 440.0, 12).reshape(3, 4)
    depth = lf.DepthMap(found, np.zeros_like(found), np.ones_like(found), (300.0, 900.0))
    save_depth(depth, found, tmp_path / "run", ["fire $x^$"])
    assert (tmp_path / "run" / "depth.png").is_file()
