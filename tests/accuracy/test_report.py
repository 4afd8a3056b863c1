"""The accuracy report: what it measures is right, complete, and in every file it writes."""

import csv
import html
import io
import math
import re
from dataclasses import asdict, fields, replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from scipy import stats

import lfmesh as lf
from lfmesh.accuracy import report as accuracy
from lfmesh.accuracy import verdict
from lfmesh.accuracy.image_efficiency import (
    AIMING,
    ANALOG,
    RANDOM,
    SOBOL,
    SPLITTING,
    WAYS,
    Effort,
    ImageRow,
    ImageStudy,
    study_images,
)
from lfmesh.accuracy.lens_accuracy import (
    EXACT_MULTIPLES,
    LENS_ALONE,
    LEVELS,
    QUICK_RINGS,
    WHOLE_CAMERA,
    LensRow,
    LensStudy,
    lens_files,
    lens_scene,
    order_of,
    release_freed_memory,
    resident_bytes,
    study_lens,
)
from lfmesh.accuracy.report import AccuracyReport
from lfmesh.accuracy.tables import csv_table, read_csv
from lfmesh.assets import asset_path
from lfmesh.errors import FileError, LfmeshError
from tests.instances import instances

LEVEL = 1e-3
"""Chance that a statistical test fails though the law holds."""

EXACT_MM = 1e-9

ORDERS = {"flat": 0.9, "smooth": 1.9, "patch": 2.7}


@pytest.fixture
def untimed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Studies trace the rays of each row once: nobody asks for their speed."""
    monkeypatch.setattr("lfmesh.accuracy.lens_accuracy.TIMED_RUNS", 1)
    monkeypatch.setattr("lfmesh.accuracy.lens_accuracy.TIMED_SECONDS", 0.0)


@pytest.mark.parametrize("file", lens_files(), ids=lambda file: file.stem)
def test_exact_lands_on_the_truth_whatever_the_mesh(file: Path, monkeypatch: pytest.MonkeyPatch, untimed: None) -> None:
    monkeypatch.setattr("lfmesh.accuracy.lens_accuracy.LEVELS", ("exact",))
    # The error of the truth itself has tests of its own, and takes half a minute through gradients.
    monkeypatch.setattr("lfmesh.accuracy.analytic.own_error", lambda *_: None)
    study = study_lens(lens_scene(file), rays=1 << 13)
    exact = study.of(LENS_ALONE, "exact")
    assert len(exact) == len(EXACT_MULTIPLES)
    for row in exact:
        assert row.rays > 500
        assert row.max_mm <= EXACT_MM
        assert row.max_weight <= 1e-12
        assert row.lost == 0.0
    # Rays that graze the rim of a ball pass by a coarse mesh; through every other lens none goes astray.
    assert exact[0].astray <= (2e-3 if file.stem == "ball_10mm" else 0.0)
    assert exact[-1].astray <= 1e-4


@pytest.mark.long
@pytest.mark.parametrize("file", lens_files(), ids=lambda file: file.stem)
def test_a_million_rays_land_on_the_truth(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfmesh.accuracy.lens_accuracy.LEVELS", ("exact",))
    monkeypatch.setattr("lfmesh.accuracy.lens_accuracy.EXACT_MULTIPLES", (1,))
    (row,) = study_lens(lens_scene(file), rays=4_000_000).rows
    assert row.rays >= 1_000_000
    assert row.max_mm <= EXACT_MM
    assert row.lost == 0.0


@pytest.mark.parametrize("lens", instances(["cooke_triplet_50mm", "achromat_100mm"], long=["achromat_100mm"]))
def test_every_level_converges_with_its_order(lens: str, monkeypatch: pytest.MonkeyPatch, untimed: None) -> None:
    """Flat facets with order one, interpolated normals two, quadratic patches three, over three refinements."""
    monkeypatch.setattr("lfmesh.accuracy.lens_accuracy.LEVELS", tuple(ORDERS))
    study = study_lens(lens_scene(asset_path(f"lenses/{lens}.toml")), rings=(6, 12, 24, 48), rays=1 << 11)
    for level, order in ORDERS.items():
        rows = study.of(LENS_ALONE, level)
        assert [row.triangles for row in rows] == [216, 864, 3456, 13824]
        assert order <= order_of(rows) < order + 0.5


def test_every_level_and_mesh_is_measured_both_ways(report: AccuracyReport) -> None:
    (study,) = report.lenses
    assert study.ways == (LENS_ALONE, WHOLE_CAMERA)
    for way in study.ways:
        for level in LEVELS:
            rings = QUICK_RINGS if level != "exact" else [m * study.default_rings["exact"] for m in EXACT_MULTIPLES]
            assert [row.rings for row in study.of(way, level)] == list(rings)
        for row in study.of(way):
            assert row.rms_mm <= row.max_mm
            assert row.rms_px == pytest.approx(row.rms_mm / study.pixel_mm)
            assert row.max_px == pytest.approx(row.max_mm / study.pixel_mm)
            assert row.events_per_second > 0.0
            assert row.build_seconds > 0.0
        for level in LEVELS:
            sizes = [row.table_bytes for row in study.of(way, level)]
            assert sizes == sorted(set(sizes))


@pytest.mark.skipif(resident_bytes() == 0, reason="the system does not say what a process holds")
def test_freed_memory_is_released_before_the_next_row_is_measured() -> None:
    size = 1 << 26
    circle: list[object] = [np.ones(size, np.uint8)]
    circle.append(circle)
    held = resident_bytes()
    del circle
    release_freed_memory()
    assert held - resident_bytes() > 0.9 * size


def test_through_the_microlenses_exact_is_exact_and_flat_takes_other_lenslets(report: AccuracyReport) -> None:
    (study,) = report.lenses
    for row in study.of(WHOLE_CAMERA, "exact"):
        assert row.max_mm <= EXACT_MM
        assert row.elsewhere == row.lost == 0.0
    shares = [row.elsewhere for row in study.of(WHOLE_CAMERA, "flat")]
    assert min(shares) > 0.05
    assert shares == sorted(shares, reverse=True)
    assert study.truth_error_mm is None or 0.0 < study.truth_error_mm < 1e-12


def test_the_error_that_check_estimates_is_the_one_measured(report: AccuracyReport) -> None:
    """Within a factor of three, for the levels whose error is the mesh's."""
    (study,) = report.lenses
    for level in ("flat", "smooth", "patch"):
        for row in study.of(LENS_ALONE, level):
            assert 1 / 3 < row.rms_mm / row.expected_mm < 3.0, row


def test_errors_of_images_are_those_of_their_standard_errors(report: AccuracyReport) -> None:
    """Mean squared errors fall with the samples; no way differs from the reference in the whole power.

    The twelve z are tested as normal ones, two-sided, Bonferroni.
    """
    images = report.images
    assert images is not None
    assert [row.way for row in images.rows] == [way.name for way in WAYS for _ in range(2)]
    assert 2.0 * stats.norm.sf(max(abs(row.bias_z) for row in images.rows)) > LEVEL / len(images.rows)
    for way in WAYS:
        few, many = images.of(way)
        assert few.mse > many.mse > 0.0
        assert many.efficiency == pytest.approx(1.0 / (many.mse * many.seconds))
    assert images.pixels == (20, 20)
    assert images.binned == 2
    assert images.reference_share() < 0.2
    # At equal samples; the same seeds give the same errors, whatever the machine does.
    analog, aimed = images.of(ANALOG)[-1], images.of(AIMING)[-1]
    assert analog.mse * analog.samples > 10.0 * aimed.mse * aimed.samples


def test_every_way_estimates_the_light_of_a_scene_in_motion(scene_file: Path) -> None:
    """A lamp that swings over a plane, a camera that moves and a rolling shutter, whose rows are binned."""
    scene = lf.load(scene_file).changed(
        {
            "exposure": {"duration_s": 0.01, "row_time_s": 2e-4},
            "lights[0].motion": {"velocity_mm_s": [-1000.0, 500.0, 0.0]},
            "camera.motion": {"velocity_mm_s": [0.0, 100.0, 0.0]},
        }
    )
    samples = {way.name: (64,) if way in (ANALOG, SPLITTING) else (8,) for way in WAYS}
    study = study_images(scene, Effort(20, samples, 4, 512))
    assert study.binned == 2
    assert 2.0 * stats.norm.sf(max(abs(row.bias_z) for row in study.rows)) > LEVEL / len(study.rows)


def test_splitting_and_aiming_gain_a_thousand_in_variance_a_sample_on_the_default_scene() -> None:
    """With the mesh engine: one-sided t-test over six runs of each, the logarithm of whose variances is taken.

    How long a sample takes is measured by tools/bench, not here.
    """
    effort = Effort(32, {ANALOG.name: (1024,), AIMING.name: (32,)}, 6, 256)
    study = study_images(lf.load(asset_path("scenes/first_light.toml")), effort, ways=(ANALOG, AIMING))
    aimed, analog = study.of(AIMING)[-1], study.of(ANALOG)[-1]
    gain = analog.mse * analog.samples / (aimed.mse * aimed.samples)
    error = math.hypot(*(row.efficiency_error / row.efficiency for row in (aimed, analog)))
    assert stats.t.sf(np.log(gain / 1000.0) / error, 5) < LEVEL


def test_a_dark_scene_is_refused_and_one_without_lamps_has_no_images(scene_file: Path) -> None:
    scene = lf.load(scene_file)
    away = scene.changed({"lights[0].position_mm": [0.0, 0.0, -600.0]})
    with pytest.raises(LfmeshError, match="no light of the scene reaches its sensor"):
        study_images(away, Effort(20, {way.name: (2,) for way in WAYS}, 2, 8))
    assert not accuracy.shines(scene.changed({"lights": []}))
    assert accuracy.shines(scene)
    assert accuracy.shines(lf.load(asset_path("scenes/emitting_plane.toml")))


def test_csv_holds_every_digit_of_every_row(report: AccuracyReport) -> None:
    rows = [row for study in report.lenses for row in study.rows]
    assert read_csv(csv_table(rows), LensRow) == rows
    assert report.images is not None
    assert read_csv(csv_table(report.images.rows), ImageRow) == list(report.images.rows)


@pytest.fixture(scope="module")
def written(report: AccuracyReport, tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("report") / "a" / "b"
    paths = report.write(folder)
    assert sorted(path.name for path in paths) == ["accuracy.html", "images.csv", "lenses.csv"]
    assert sorted(folder.iterdir()) == sorted(paths)
    return {path.name: path.read_text(encoding="utf-8") for path in paths}


class Page(HTMLParser):
    """Counts tags, keeps text, and notes everything that a browser would fetch."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.open: list[str] = []
        self.text = ""
        self.fetched: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in ("meta", "br", "link"):
            self.open.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "xlink:href", "srcset", "action") and not (value or "").startswith("#"):
                self.fetched.append(f"{tag} {name}={value}")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if self.open and self.open[-1] == tag:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def test_the_page_loads_nothing(written: dict[str, str]) -> None:
    text = written["accuracy.html"]
    page = Page(text)
    assert page.open == []
    assert page.fetched == []
    assert not re.search(r"https?:|@import|<script|<link", text)
    assert not re.search(r"url\((?!#)", text)


def test_the_page_holds_every_figure_table_and_paragraph(report: AccuracyReport, written: dict[str, str]) -> None:
    page = Page(written["accuracy.html"])
    (study,) = report.lenses
    assert report.images is not None
    # Two figures a way, two of the images; a table a way, one of the images.
    assert page.tags.count("svg") == page.tags.count("figcaption") == 2 * len(study.ways) + 2
    assert page.tags.count("table") == len(study.ways) + 1
    assert page.tags.count("tr") == len(study.rows) + len(report.images.rows) + page.tags.count("table")
    words = [verdict.about_the_truth(study), verdict.about_images(report.images)]
    words += [verdict.about_image_time(report.images), *(verdict.about_triangles(study, way) for way in study.ways)]
    words += [verdict.about_time(study, way) for way in study.ways]
    for paragraph in words:
        assert paragraph in page.text
    for label in ("triangles per surface", "error where a ray lands / mm", "processor time / s", "a tenth of a pixel"):
        assert label in page.text
    assert "tiny camera <&>" in page.text
    assert "<&>" not in written["accuracy.html"]
    assert html.escape("tiny camera <&>") in written["accuracy.html"]


def test_the_csv_files_name_their_columns(written: dict[str, str]) -> None:
    for name, kind in (("lenses.csv", LensRow), ("images.csv", ImageRow)):
        assert next(csv.reader(io.StringIO(written[name]))) == [field.name for field in fields(kind)]


def test_the_terminal_shows_it_all_in_80_columns(report: AccuracyReport) -> None:
    text = io.StringIO()
    report.print(Console(file=text, width=80))
    lines = text.getvalue().splitlines()
    assert max(map(len, lines)) <= 80
    assert "…" not in text.getvalue()
    (study,) = report.lenses
    assert report.images is not None
    for level in LEVELS:
        shown = [line for line in lines if re.match(rf"{level} +[\d,]+ +\d", line)]
        assert len(shown) == len([row for row in study.rows if row.surface == level])
    for way in WAYS:
        shown = [line for line in lines if re.match(rf"{way.name} +\d+ +[\d.]+ ", line)]
        assert len(shown) == len(report.images.of(way))


def test_a_report_that_cannot_be_written_says_so_before_it_is_measured(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="is a file; give a folder"):
        accuracy.prepare(tmp_path / "file")
    with pytest.raises(FileError, match="below: cannot be written: Not a directory"):
        accuracy.prepare(tmp_path / "file" / "below")
    accuracy.prepare(tmp_path / "new" / "folder")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


ROW = LensRow(
    lens="lens", way=LENS_ALONE, surface="flat", rings=6, triangles=216, rms_mm=1e-3, max_mm=2e-3, rms_px=0.2,
    max_px=0.4, elsewhere=0.0, expected_mm=1e-3, rms_weight=0.0, max_weight=0.0, astray=0.0, lost=0.0, requeried=0.0,
    build_seconds=0.1, table_bytes=1000, process_bytes=0, events_per_second=1e6, rays=100,
)  # fmt: skip


def lens_rows(surface: str, errors: dict[int, float], rate: float = 1e6) -> list[LensRow]:
    """Return rows of a level by rings and error in pixels of 5 µm."""
    return [
        replace(ROW, surface=surface, rings=n, triangles=6 * n * n, rms_px=e, rms_mm=0.005 * e, events_per_second=rate)
        for n, e in errors.items()
    ]


def study_of(*rows: LensRow) -> LensStudy:
    return LensStudy("lens", 0.005, rows, {}, 1e-14)


def test_the_fitted_order_is_the_exponent() -> None:
    for order in (1.0, 2.5):
        rows = lens_rows("patch", {n: 7.0 * n**-order for n in (6, 12, 24, 48)})
        assert order_of(rows) == pytest.approx(order, rel=1e-12)
    assert np.isnan(order_of(rows[:1]))


def test_words_choose_the_coarsest_mesh_below_a_tenth_of_a_pixel() -> None:
    exact = lens_rows("exact", {5: 1e-12})
    flat, smooth = lens_rows("flat", {6: 9.0, 12: 5.0}), lens_rows("smooth", {6: 0.3, 12: 0.09})
    patch = lens_rows("patch", {6: 0.2, 12: 0.02})
    study = study_of(*flat, *smooth, *patch, *exact)
    # Of levels that need the same mesh, the better one.
    assert "only a mesh choose patch: 864 triangles" in verdict.about_triangles(study, LENS_ALONE)
    study = study_of(*flat, *lens_rows("smooth", {6: 0.05, 12: 0.01}), *patch, *exact)
    assert "only a mesh choose smooth: 216 triangles" in verdict.about_triangles(study, LENS_ALONE)
    study = study_of(*flat, *exact)
    assert "no mesh measured stays below a tenth" in verdict.about_triangles(study, LENS_ALONE)


def test_words_tell_a_level_that_is_faster_from_one_that_is_not() -> None:
    exact = lens_rows("exact", {5: 1e-12}, rate=1e6)
    for rate, said in ((1.2e6, "giving up accuracy buys no time"), (2e6, "The fastest of all is patch")):
        study = study_of(*lens_rows("patch", {6: 0.05}, rate), *exact)
        assert said in verdict.about_time(study, LENS_ALONE)


def test_words_own_up_to_what_went_wrong() -> None:
    exact, patch = lens_rows("exact", {5: 1e-12}), lens_rows("patch", {6: 0.05})
    assert "No power was lost." in verdict.about_time(study_of(*patch, *exact), LENS_ALONE)
    words = verdict.about_time(
        study_of(*(replace(row, lost=2e-4) for row in patch), *(replace(row, astray=1e-3) for row in exact)), LENS_ALONE
    )
    assert "At most 0.020\N{NO-BREAK SPACE}% of the power was lost, by patch with 216 triangles" in words
    assert "With exact on 150 triangles 0.10\N{NO-BREAK SPACE}% of the rays do not end where they should" in words


def image_study(typical: dict[str, float] | None = None, **efficiency: tuple[float, float]) -> ImageStudy:
    """Return a study with an efficiency and its error by way, and typical errors where given; runs of one second."""
    names = {"analog": ANALOG, "aiming": AIMING, "random": RANDOM, "sobol": SOBOL}
    rows = [
        ImageRow(
            names[name].name, 8, 1.0, 1.0 / value, error / value**2, (typical or {}).get(name, 0.1), value, error, 0.0
        )
        for name, (value, error) in efficiency.items()
    ]
    return ImageStudy("scene", (8, 8), 1, 64, 0.01, 0.01, tuple(rows))


def test_words_choose_the_most_efficient_way_and_call_a_tie_a_tie() -> None:
    clear = verdict.most_efficient(image_study(random=(20.0, 0.5), sobol=(30.0, 0.5), analog=(0.01, 0.001)))
    assert clear.startswith("The most efficient way is adjoint, Sobol', at 30 / s; it is 1.50 ± 0.05 times")
    assert "3,000 ± 300 times as efficient as analog forward" in clear
    # A tie goes to the way with the better typical pixel, whichever came out first by chance.
    for random, sobol in ((28.0, 30.0), (30.0, 28.0)):
        tie = verdict.most_efficient(
            image_study({"random": 0.1, "sobol": 0.08}, random=(random, 5.0), sobol=(sobol, 5.0), analog=(0.01, 0.001))
        )
        assert f"adjoint, Sobol', at {sobol:.0f} / s, indistinguishable from adjoint, random by its rms error" in tie
        assert "times as efficient as adjoint, random" not in tie


@pytest.mark.parametrize(
    ("mm", "words"),
    [(2.4, "2.4 mm"), (0.62, "0.62 mm"), (12.34, "12 mm"), (0.0052, "5.2 µm"), (7.3e-5, "73 nm"), (0.0, "0 mm"),
     (2.4e-14, "2.4 × 10⁻¹⁴ mm"), (0.00995, "10 µm"), (1234.0, "1,200 mm")],
)  # fmt: skip
def test_lengths_read_as_one_would_write_them(mm: float, words: str) -> None:
    assert verdict.length(mm).replace("\N{NO-BREAK SPACE}", " ") == words


def test_rows_are_plain_numbers(report: AccuracyReport) -> None:
    """So that CSV and words print 0.1 and not np.float64(0.1)."""
    rows = [*report.lenses[0].rows, *(report.images.rows if report.images else ())]
    assert {type(value) for row in rows for value in asdict(row).values()} <= {str, int, float}
