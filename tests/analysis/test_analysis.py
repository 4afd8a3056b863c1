"""Figures of the lens sheet against closed forms and an independent trace."""

import html
import math
import re
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from scipy.special import j1

import lfmesh as lf
from lfmesh.analysis.analysis import LINES_NM, analyse
from lfmesh.assets import asset_path
from lfmesh.cli import main
from lfmesh.errors import LfmeshError
from lfmesh.optics.glass import refractive_index
from lfmesh.view.lens_sheet import STYLE, draw_lens_sheet, sheet_of

RADIUS, AWAY = 0.8, 60.0
"""Of a pinhole, mm: its radius, and its distance from the sensor."""


def scene(surfaces: list[dict[str, Any]], distance_mm: float, **transport: Any) -> lf.Scene:
    return lf.Scene(
        camera={
            "lens": {"surfaces": surfaces},
            "sensor": {"pixels": (64, 64), "pixel_mm": 0.25, "distance_mm": distance_mm},
        },
        transport=transport,
    )


def pinhole_scene() -> lf.Scene:
    """A hole behind a window of air."""
    window = {"radius_mm": math.inf, "semi_diameter_mm": 60.0}
    hole = {"stop": True, "thickness_mm": 0.0, "semi_diameter_mm": RADIUS}
    surfaces = [window | {"thickness_mm": 1.0, "index": 1.0}, window | {"thickness_mm": 1.0}, hole]
    return scene(surfaces, AWAY)


@pytest.fixture(scope="module")
def pinhole() -> lf.LensAnalysis:
    """Parallel light makes a hole's shadow."""
    return analyse(pinhole_scene(), object_mm=math.inf, height_mm=40.0)


def test_the_spot_of_a_pinhole_is_its_shadow(pinhole: lf.LensAnalysis) -> None:
    for spot, height in zip(pinhole.spots, pinhole.heights_mm, strict=True):
        assert spot.passed == pytest.approx(1.0, abs=1e-12)
        np.testing.assert_allclose(spot.chief_mm, [0.0, height], atol=1e-10)
        assert spot.geo_mm == pytest.approx(RADIUS, rel=0.02)
        assert spot.rms_mm == pytest.approx(RADIUS / math.sqrt(2.0), rel=2e-3)
        across = 2.0 * math.pi * pinhole.frequencies_per_mm[1:] * RADIUS
        known = np.abs(2.0 * j1(across) / across)
        for tangential in (True, False):
            found = spot.mtf(pinhole.frequencies_per_mm, tangential=tangential)
            assert found[0] == pytest.approx(1.0, abs=1e-12)
            np.testing.assert_allclose(found[1:][across < 10.0], known[across < 10.0], atol=4e-3)


def test_a_pinhole_has_no_distortion_and_the_illumination_of_cos4(pinhole: lf.LensAnalysis) -> None:
    curves = pinhole.curves
    np.testing.assert_allclose(curves.distortion, 0.0, atol=1e-12)
    cos4 = (1.0 + (curves.height_mm / AWAY) ** 2) ** -2.0
    np.testing.assert_allclose(curves.illumination, cos4, atol=1e-5)


def test_a_stop_before_the_lens_is_as_good_as_one_on_it() -> None:
    """Under parallel light along the axis; off the axis the bundle meets another part of the lens."""
    faces = [{"radius_mm": 20.0, "thickness_mm": 1.0, "index": 1.5, "semi_diameter_mm": 3.0}]
    faces.append({"radius_mm": -20.0, "semi_diameter_mm": 3.0})
    front = scene([{"stop": True, "thickness_mm": 2.0, "semi_diameter_mm": 1.0}, *faces], 19.8)
    on_it = scene([{"stop": True, "thickness_mm": 0.0, "semi_diameter_mm": 1.0}, *faces], 19.8)
    apart, together = (analyse(each, object_mm=math.inf, height_mm=2.0) for each in (front, on_it))
    assert apart.spots[0].rms_mm == pytest.approx(together.spots[0].rms_mm, rel=1e-9)
    assert apart.spots[-1].rms_mm != pytest.approx(together.spots[-1].rms_mm, rel=1e-3)


def test_a_hyperbolic_face_is_stigmatic() -> None:
    """Collimated light through a flat face and out through a conic of −n² comes to a point (Descartes)."""
    n, radius = 1.5, 25.0
    surfaces = [
        {"radius_mm": math.inf, "thickness_mm": 8.0, "index": n, "semi_diameter_mm": 10.0, "stop": True},
        {"radius_mm": -radius, "conic": -n * n, "semi_diameter_mm": 10.5},
    ]
    found = analyse(scene(surfaces, radius / (n - 1.0)), object_mm=math.inf, height_mm=3.0)
    assert found.spots[0].geo_mm < 1e-9
    np.testing.assert_allclose(found.zone_foci_mm, 0.0, atol=1e-8)
    assert found.spots[2].geo_mm > 1e-3, "it has coma"


SINGLET = [
    {"radius_mm": 61.5, "thickness_mm": 6.0, "glass": "SCHOTT/N-BK7", "semi_diameter_mm": 9.0, "stop": True},
    {"radius_mm": -45.5, "thickness_mm": 2.5, "glass": "SCHOTT/N-SF5", "semi_diameter_mm": 9.5},
    {"radius_mm": -130.0, "semi_diameter_mm": 9.5},
]
IMAGE_MM = 97.0


def by_hand(points: np.ndarray, ahead: np.ndarray, wavelength: float) -> tuple[np.ndarray, np.ndarray, list[Any]]:
    """Trace rays through the doublet to its image plane; return where, their directions, and angles at each surface."""
    index, z, met = 1.0, 0.0, []
    for surface in SINGLET:
        radius = surface["radius_mm"]
        after = refractive_index(surface.get("glass"), wavelength)
        centre = np.array([0.0, 0.0, z + radius])
        b = ((points - centre) * ahead).sum(axis=1)
        c = ((points - centre) ** 2).sum(axis=1) - radius**2
        t = -b - math.copysign(1.0, radius) * np.sqrt(b * b - c)
        points = points + t[:, None] * ahead
        normal = (centre - points) / radius
        cosine = (normal * ahead).sum(axis=1)
        ratio = index / after
        refracted = np.sqrt(1.0 - ratio**2 * (1.0 - cosine**2))
        ahead = ratio * ahead + (refracted - ratio * cosine)[:, None] * normal
        met.append((points, cosine, refracted, index, after, radius))
        index, z = after, z + surface.get("thickness_mm", 0.0)
    image = z + IMAGE_MM
    return points + ((image - points[:, 2]) / ahead[:, 2])[:, None] * ahead, ahead, met


@pytest.fixture(scope="module")
def doublet() -> lf.LensAnalysis:
    return analyse(scene(SINGLET, IMAGE_MM), object_mm=400.0, height_mm=6.0, across=40)


def test_spots_of_a_doublet_are_those_of_an_independent_trace(doublet: lf.LensAnalysis) -> None:
    """The stop is the first surface, so a point of the stop is a point that the ray is sent to."""
    grid = np.array([(x, y) for x in np.arange(-19.5, 20) for y in np.arange(-19.5, 20) if x * x + y * y <= 400]) / 20
    at = 9.0 * grid
    sag = 61.5 - np.sqrt(61.5**2 - (at * at).sum(axis=1))
    assert doublet.wavelengths_nm == LINES_NM
    for spot in doublet.spots:
        start = np.array([0.0, 400.0 * spot.slope_y, -400.0])
        places = []
        for wavelength in LINES_NM:
            ahead = np.column_stack([at, sag]) - start
            ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
            places.append(by_hand(np.broadcast_to(start, ahead.shape), ahead, wavelength)[0][:, :2])
        chief = np.array([[0.0, -start[1], 400.0]])
        reference = by_hand(start[None], chief / np.linalg.norm(chief), LINES_NM[1])[0][0, :2]
        np.testing.assert_allclose(spot.chief_mm, reference, atol=1e-9)
        off = np.concatenate(places) - reference
        assert spot.geo_mm == pytest.approx(np.hypot(*off.T).max(), abs=1e-7)
        # Fresnel's weights hardly differ over the pupil.
        assert spot.rms_chief_mm == pytest.approx(np.sqrt((off**2).sum(axis=1).mean()), rel=2e-3)


def test_a_field_without_a_chief_ray_says_so_and_has_no_figures_from_it() -> None:
    """Far behind a stop a sphere ends before the chief ray of the edge, and rays from below it pass."""
    surfaces = [
        {"stop": True, "thickness_mm": 30.0, "semi_diameter_mm": 4.0},
        {"radius_mm": 10.0, "thickness_mm": 9.0, "index": 1.5, "semi_diameter_mm": 9.9},
        {"semi_diameter_mm": 9.9},
    ]
    found = analyse(scene(surfaces, 14.0), object_mm=math.inf, height_mm=6.4, across=20)
    inner, edge = found.spots[1], found.spots[2]
    assert np.isfinite([*inner.chief_mm, inner.geo_mm, inner.rms_chief_mm]).all()
    assert 0.0 < edge.passed < 0.5
    assert np.isnan([*edge.chief_mm, edge.geo_mm, edge.rms_chief_mm]).all()
    assert edge.reach_mm >= edge.rms_mm > 0.0
    assert np.isnan(found.curves.chief_mm[:, -1]).all()
    assert [line for line in found.lines() if "no chief ray:" in line] == [
        "    6.400  no chief ray: it is blocked by the end of surfaces[1]; spot and fans are relative to the mean of "
        "the other rays"
    ]
    # Rays through the stop's x axis meet the sphere farther out than the chief ray, and end at its rim as well.
    assert np.isnan([fan.sagittal_mm for fan in found.fans[-1]]).all()
    panels = {axes.get_title(): axes for axes in sheet_of(found).axes}
    tangential, sagittal = (panels[f"{side} fan, 6.40 mm"] for side in ("tangential", "sagittal"))
    assert " ".join(sagittal.texts[0].get_text().split()) == "no fan: no ray through the stop's x axis passes the lens"
    assert not sagittal.lines
    assert not tangential.texts


def test_every_row_of_the_printed_tables_has_as_many_values_as_the_head_has_names(pinhole: lf.LensAnalysis) -> None:
    lines = pinhole.lines()
    for head in (line for line in lines if line.split()[0] == "field/mm"):
        number = lines.index(head)
        rows = [line.split() for line in lines[number + 1 : number + 4]]
        assert {len(row) for row in rows if row[1] != "no"} <= {len(head.split())}
    assert "rms/µm" in lines[[line.split()[0] for line in lines].index("field/mm")]
    assert not any("um " in line for line in lines)


def test_a_sheet_of_another_object_than_the_focus_says_that_it_is_not_refocused() -> None:
    """An ideal lens of 50 mm, focused at 550 mm: images lie 55 mm behind it, those of infinity 5 mm before these."""
    lens = [{"paraxial": True, "focal_length_mm": 50.0, "semi_diameter_mm": 5.0, "stop": True}]
    focused = scene(lens, 55.0)
    far = analyse(focused, object_mm=math.inf, height_mm=2.0, across=8)
    words = (
        "not refocused: the camera is focused at 550 mm, and the object's paraxial image lies 5 mm before the image "
        "plane; to refocus, give camera.focus_mm = inf and omit the distances"
    )
    assert far.focus_in_words == words
    assert words in far.lines()
    assert words in [text.get_text() for text in sheet_of(far).texts]
    assert analyse(focused, object_mm=40.0, height_mm=2.0, across=8).focus_in_words.endswith("has no real image")
    assert analyse(focused, height_mm=2.0, across=8).focus_in_words == ""
    there = focused.changed({"camera.focus_mm": math.inf, "camera.sensor.distance_mm": None})
    assert analyse(there, object_mm=math.inf, height_mm=2.0, across=8).focus_in_words == ""


def test_no_text_of_a_sheet_is_cut_at_its_edge(doublet: lf.LensAnalysis, pinhole: lf.LensAnalysis) -> None:
    for found in (doublet, pinhole):
        with mpl.rc_context(STYLE):
            figure = sheet_of(found)
            figure.draw_without_rendering()
            width, height = figure.bbox.size
            for axes in figure.axes:
                if (box := axes.get_tightbbox()) is not None and axes.axison:
                    assert box.x0 >= 0.0, axes.get_title()
                    assert box.y0 >= 0.0, axes.get_title()
                    assert box.x1 <= width, axes.get_title()
                    assert box.y1 <= height, axes.get_title()


def test_foci_over_the_field_are_coddingtons(doublet: lf.LensAnalysis) -> None:
    for w, wavelength in enumerate(LINES_NM):
        for i in (0, 9, 20):
            start = np.array([[0.0, 400.0 * doublet.curves.slope_y[i], -400.0]])
            chief = -start / np.linalg.norm(start)
            landed, ahead, met = by_hand(start, chief, wavelength)
            before, s, t = start, 0.0, 0.0
            for points, cosine, refracted, index, after, radius in met:
                along = float(np.linalg.norm(points - before))
                s, t = s - along, t - along
                power = (after * refracted[0] - index * cosine[0]) / radius
                s = after / (index / s + power)
                t = after * refracted[0] ** 2 / (index * cosine[0] ** 2 / t + power)
                before = points
            to_plane = float(np.linalg.norm(landed - before))
            np.testing.assert_allclose(doublet.curves.sagittal_mm[w, i], (s - to_plane) * ahead[0, 2], atol=1e-5)
            np.testing.assert_allclose(doublet.curves.tangential_mm[w, i], (t - to_plane) * ahead[0, 2], atol=1e-5)


def test_the_sheet_is_drawn_and_says_the_same_again(doublet: lf.LensAnalysis, tmp_path: Path) -> None:
    one, other = (draw_lens_sheet(doublet, tmp_path / name).read_bytes() for name in ("a.pdf", "b.pdf"))
    assert one == other
    assert one.startswith(b"%PDF")
    with pytest.raises(LfmeshError, match="a lens sheet must end in one of"):
        draw_lens_sheet(doublet, tmp_path / "a.docx")


def test_the_sheet_is_a_page_too_that_stands_by_itself(doublet: lf.LensAnalysis, tmp_path: Path) -> None:
    page = draw_lens_sheet(doublet, tmp_path / "a.html").read_text(encoding="utf-8")
    assert page == draw_lens_sheet(doublet, tmp_path / "b.html").read_text(encoding="utf-8")
    assert page.count("<svg") == page.count("</svg>") == 1
    assert "<?xml" not in page
    assert "Coddington" in page[page.index("<svg") :]
    assert html.escape(doublet.lines()[-1]) in page
    fetched = re.findall(r"""(?:src|href)=["']([^"']*)|url\(([^)]*)\)""", page)
    assert fetched
    assert all("".join(each).startswith(("#", "data:")) for each in fetched)


def test_a_sheet_that_cannot_be_written_is_refused_before_the_lens_is_analysed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def analysed(*_: Any, **__: Any) -> None:
        raise AssertionError("analysed")

    monkeypatch.setattr("lfmesh.analysis.analysis.analyse", analysed)
    scene = str(asset_path("scenes/first_light.toml"))
    assert main(["lens", "sheet", scene, "-o", str(tmp_path / "sheet.docx")]) != 0
    assert main(["lens", "sheet", scene, "-o", str(tmp_path / "none" / "sheet.html")]) != 0
    errors = capsys.readouterr().err
    assert "a lens sheet must end in one of .svg, .png, .pdf, .html" in errors
    assert "does not exist; create it" in errors


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"object_mm": -3.0}, "must be above 0, or inf"),
        ({"height_mm": 0.0}, "must be above 0 and finite"),
        ({"height_mm": 1e6, "object_mm": math.inf}, "no ray of the field"),
        ({"across": 3}, "must be from 4 to 1000"),
        ({"wavelengths_nm": (400.0, 500.0)}, "give an odd number"),
    ],
)
def test_what_cannot_be_analysed_is_named(settings: dict[str, Any], reason: str) -> None:
    with pytest.raises(LfmeshError, match=reason):
        analyse(pinhole_scene(), **settings)
