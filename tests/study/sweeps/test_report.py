"""The report stands by itself, and a designer finds in it what was asked."""

import html
import math
import re
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from pyarrow import parquet

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.study.metrics.metrics import METRICS, columns_of
from lfmesh.study.sweeps.figures import TITLE_LETTERS
from lfmesh.study.sweeps.report import ABREAST, NO_FIGURE, page
from lfmesh.study.sweeps.sentences import budget_in_words, in_short, written
from lfmesh.study.sweeps.statistics import Estimate, share_of
from lfmesh.study.sweeps.table import Row, Table
from lfmesh.study.tolerances.budget import budget_of
from lfmesh.study.tolerances.largest_change import Allowed
from tests.conftest import chromium
from tests.processor_time import HANGS_S
from tests.study.studies import SHIFT, shifted, small_scene


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study")
    axes = [
        {"path": SHIFT, "values": [-0.05, 0.05], "label": "decentre / mm"},
        {"path": "transport.split", "values": ["roulette"]},
    ]
    lf.Study(small_scene(), axes=axes, metrics=["psnr", "light", "chief_rays"], name="Two <axes>").run(
        folder, workers=0
    )
    return folder


def test_the_page_asks_for_nothing_from_outside(folder: Path) -> None:
    page = (folder / "report.html").read_text()
    assert not re.findall(r'(?:src|href)="(?!data:|#)', page)
    assert not re.findall(r"(?:https?:)?//[\w.]", re.sub(r"data:image/png;base64,[\w+/=]*", "", page))
    assert "@import" not in page
    assert "<script" not in page


def test_it_shows_figures_pictures_fields_and_all_points(folder: Path) -> None:
    page = (folder / "report.html").read_text()
    assert "Two &lt;axes&gt;" in page
    # A figure for each axis, and a field for each of two points that move; the third moves nothing.
    assert page.count("<svg") == 4
    assert page.count('<img src="data:image/png;base64,') == 3
    assert "decentre / mm" in page
    assert "Which error matters" in page
    for heading in ("Metric against parameter", "Where micro-images move", "All points"):
        assert heading in page
    assert page.count("±") > 5


@pytest.mark.parametrize("change_mm", [3e-8, 3e-5, 3e-2])
def test_numbers_beside_panels_have_room_however_little_a_metric_changes(change_mm: float, tmp_path: Path) -> None:
    """Pitches that differ by 1e-9, which is rounding, by 1e-6 and by 1e-3: eight letters at most."""
    axis = {"path": "camera.mla.pose.shift_mm[2]", "values": [-change_mm, change_mm]}
    lf.Study(small_scene(), axes=[axis], metrics=["chief_rays"]).run(tmp_path, workers=0)
    page = (tmp_path / "report.html").read_text()
    numbers = re.findall(r"text-anchor: end[^>]*>([^<]*)<", page)
    assert len(numbers) >= 9
    assert max(map(len, numbers)) <= 8


def test_a_worst_point_is_named_first(folder: Path) -> None:
    page = (folder / "report.html").read_text()
    found = re.search(r"Worst by PSNR: ([^,<]*),", page)
    assert found is not None
    assert found[1] in ("decentre = -0.05 mm", "decentre = 0.05 mm")


def test_parquet_holds_the_table(tmp_path: Path) -> None:
    table = shifted(3, ("chief_rays",)).run(tmp_path, workers=0)
    (tmp_path / "table.parquet").write_bytes(table.to_parquet())
    read = parquet.read_table(tmp_path / "table.parquet").to_pydict()
    assert read["point"] == [0, 1, 2, 3]
    assert read["chief_rays_x_px"] == list(table.values("chief_rays_x_px"))


@pytest.mark.browser
def test_a_browser_shows_the_page_without_errors(folder: Path, tmp_path: Path) -> None:
    program = chromium()
    assert program is not None
    shot = tmp_path / "page.png"
    command = [program, "--headless", "--no-sandbox", "--disable-gpu", "--window-size=900,600"]
    done = subprocess.run(
        [*command, f"--screenshot={shot}", f"file://{folder / 'report.html'}"], capture_output=True, timeout=HANGS_S
    )
    assert done.returncode == 0
    assert shot.stat().st_size > 10_000


def test_titles_of_panels_are_no_wider_than_their_panels(folder: Path) -> None:
    """A panel is 3.3 inches wide, in which some 34 letters fit: longer titles have several lines."""
    page = (folder / "report.html").read_text()
    texts = re.findall(r"<text[^>]*>([^<]*)</text>", page)
    assert any("chief rays: displacement, rms" in text for text in texts)
    assert max(map(len, texts)) <= TITLE_LETTERS


def test_a_report_names_a_parameter_in_one_way_and_says_why_a_table_is_empty(folder: Path) -> None:
    page = re.sub(r"<svg.*?</svg>", "", (folder / "report.html").read_text(), flags=re.S)
    # The path stands once below the heading of its figures; else the label is the name.
    assert page.count(SHIFT) == 1
    assert page.count("decentre = 0.05 mm") > 1
    assert "No sensitivity: the values are not numbers." in page


def test_tables_are_no_wider_than_a_page_and_every_column_is_in_one(tmp_path: Path) -> None:
    """Columns that no point knows are in the table alone, not drawn."""
    shifted(3, ("psnr", "ssim", "light", "ghosts", "chief_rays", "noise")).run(tmp_path, workers=0)
    page = (tmp_path / "report.html").read_text()
    rows = re.findall(r"<tr>(.*?)</tr>", page, flags=re.S)
    assert max(row.count("<td>") for row in rows) <= 3 + ABREAST
    points = html.unescape(page[page.index("All points") :])
    heads = re.findall(r"<th>(.*?)</th>", points)
    assert heads.count("point") > 1
    columns = columns_of(("psnr", "ssim", "light", "ghosts", "chief_rays", "noise"))
    assert set(heads) - {"point", "camera"} == {each.title for each in columns if not each.name.endswith(NO_FIGURE)}
    # Each part names all of the points.
    assert all(points.count(f"<tr><td>{number}</td>") == heads.count("point") for number in range(4))


def test_numbers_are_resolved_ones(folder: Path) -> None:
    """An array that is moved along x is not turned, by symmetry, and moves all micro-images alike.

    Rounding is no rotation in the table, and colours of a field are told from none to the largest, without an offset.
    """
    page = (folder / "report.html").read_text()
    points = html.unescape(page[page.index("All points") :])
    assert "chief rays: rotation / deg" in points
    assert not re.findall(r"\de-1\d", points)
    fields = re.findall(r"<svg.*?</svg>", page[page.index("Where micro-images move") :], flags=re.S)
    for field in fields:
        texts = re.findall(r"<text[^>]*>([^<]*)</text>", field)
        numbers = texts[texts.index("lenslet row") + 2 : texts.index("pixels")]
        assert float(numbers[0]) == 0.0
        assert max(map(float, numbers)) > 0.1


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (100.2, 13.0, "100 ± 13"),
        (93.21, 2.97, "93.2 ± 3.0"),
        (-3012.0, 2200.0, "-3000 ± 2200"),
        (0.0012467, 0.00014, "0.0012 ± 0.00014"),
        (81.0920946, 1e-6, "81.0921"),
        (6.87e-8, 1.9e-7, "6.9e-08 ± 1.9e-07"),
        (8.7e6, 1.1e6, "8.7e+06 ± 1.1e+06"),
        (0.0, 0.35, "0 ± 0.35"),
        (2.5, 0.0, "2.5"),
        (1.9, math.nan, "1.9 ± ?"),
    ],
)
def test_a_value_has_the_digits_that_its_error_leaves(value: float, error: float, text: str) -> None:
    assert written(value, error) == text


def test_no_two_columns_have_one_title() -> None:
    titles = [column.title for column in columns_of(tuple(METRICS))]
    assert len(set(titles)) == len(titles)


def test_best_and_worst_are_the_same_above_pictures_and_below(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Points at which a limit is reached are near the reference, and no answers to "which error is least"."""
    (tmp_path / "scene.toml").write_text(small_scene().dump_toml())
    (tmp_path / "study.toml").write_text(
        'scene = "scene.toml"\nmetrics = ["chief_rays", "light"]\nlimits = { chief_rays_rms_px = 0.3 }\n'
        f'[[axes]]\npath = "{SHIFT}"\nvalues = [0.06, 0.1]\nlabel = "decentre / mm"\n'
    )
    assert main(["study", str(tmp_path / "study.toml"), "-o", str(tmp_path / "out"), "--workers", "0"]) == 0
    page = html.unescape((tmp_path / "out/report.html").read_text())
    said = " ".join(capsys.readouterr().out.split())
    for which in ("Best", "Worst"):
        (above,) = re.findall(rf"{which} by chief rays: displacement, rms: (decentre = [\d.]+ mm)", page)
        below = re.findall(rf"{which.lower()} by chief rays: displacement, rms: ([^<\"]*)<", page)
        assert set(below) == {above}
    assert re.search(r"decentre may change by \+0\.\d+ \(\+[\d.e-]+ to \+[\d.e-]+\) mm, until a limit is reached", said)


def of_values(limit: float, values: dict[float, tuple[float, float]], label: str = "decentre / mm") -> Table:
    """Return the table of a study of a decentre: NCC with its error at each value, the last of which is searched."""
    axis = {"path": SHIFT, "values": list(values)[1:], "label": label}
    plan = lf.Study(small_scene(), axes=[axis], metrics=["ncc"], limits={"ncc": limit}).plan
    far = max(values)
    rows = []
    for point in plan.points:
        at = point.values[0] if point.values[0] is not None else 0.0
        means = {column.name: Estimate(*values[at]) for column in columns_of(("ncc",))}
        rows.append(Row(point, means, means, allowed=None if point.searched is None else Allowed(far, far, far, "")))
    return Table(plan, tuple(rows))


@pytest.mark.parametrize(
    ("at_middle", "at_end", "said"),
    [
        ((0.94, 0.01), (0.95, 0.01), "decentre may change by +0.1 mm, the whole studied range: no limit is reached."),
        ((0.94, 0.01), (0.95, 0.07), "; the limits are undecided at +0.1."),
        ((0.83, 0.05), (0.95, 0.07), "; the limits are undecided at +0.05, +0.1."),
        ((math.nan, math.nan), (0.95, 0.01), "; the limits are undecided at +0.05."),
        ((0.7, 0.01), (0.95, 0.07), "decentre keeps the limits when changed by +0.1 mm, the whole studied range, but "
         "breaks one in between, at +0.05."),
    ],
)  # fmt: skip
def test_a_change_that_reaches_no_limit_claims_no_more_than_its_errors_allow(
    at_middle: tuple[float, float], at_end: tuple[float, float], said: str
) -> None:
    table = of_values(0.838, {0.0: (0.93, 0.006), 0.05: at_middle, 0.1: at_end})
    (sentence,) = (each for each in in_short(table) if each.startswith("decentre"))
    assert sentence.endswith(said)


def test_a_limit_that_is_broken_where_the_search_ended_is_said_though_the_search_kept_it() -> None:
    """A point of the design and the end of the search are the same camera, traced twice."""
    table = of_values(0.838, {0.0: (0.93, 0.006), 0.1: (0.7, 0.01)})
    kept = {name: Estimate(0.95, 0.01) for name in table.rows[-1].means}
    table = replace(table, rows=(*table.rows[:-1], replace(table.rows[-1], means=kept)))
    (sentence,) = (each for each in in_short(table) if each.startswith("decentre"))
    assert sentence.endswith("but breaks one in between, at +0.1.")


def test_cameras_that_errors_do_not_tell_apart_are_said_to_be_so() -> None:
    values = {0.0: (0.93, 0.006), 0.02: (0.9, 0.01), 0.04: (0.6, 0.01), 0.06: (0.949, 0.07)}
    best, worst = (each for each in in_short(of_values(0.5, values)) if each.startswith(("Best", "Worst")))
    assert "decentre = 0.06 mm, 0.949 ± 0.070" in best
    assert best.endswith("; 1 of 2 others is equal to it within errors.")
    assert "decentre = 0.04 mm" in worst
    assert "within errors" not in worst
    held = " ".join(in_short(of_values(0.838, values)))
    assert "is broken at 1 of 3 cameras; 1 is too close to it to decide." in held
    held = " ".join(in_short(of_values(0.838, values | {0.04: (0.9, 0.01)})))
    assert "is held at 2 of 3 cameras; 1 is too close to it to decide." in held
    held = " ".join(in_short(of_values(0.838, dict.fromkeys((0.0, 0.02, 0.04), (0.9, math.nan)))))
    assert "is held at all 2 cameras." in held


def test_a_psnr_is_said_to_have_no_sensitivity_as_it_is_infinite_at_the_reference(tmp_path: Path) -> None:
    shifted(5, ("psnr",)).run(tmp_path, workers=0)
    page = html.unescape((tmp_path / "report.html").read_text())
    assert "PSNR has no sensitivity, because it is infinite at the reference; with a limit of PSNR, its budget" in page
    assert "it needs three points" not in page


@pytest.mark.parametrize("label", ["gap a$b^$", "$x$ & $y_2$ / mm", "50 $"])
def test_what_the_user_calls_an_axis_is_no_mathematics(label: str) -> None:
    """matplotlib takes what stands between two $ for it, and fails where that is unbalanced."""
    table = of_values(0.5, {0.0: (0.93, 0.006), 0.02: (0.9, 0.01), 0.04: (0.6, 0.01)}, label)
    figures = re.findall(r"<svg.*?</svg>", page(table), flags=re.DOTALL)
    assert any(label.split(" / ")[0] in html.unescape(figure) for figure in figures)


UNKNOWN = (math.nan, math.nan)


def drawn(values: list[tuple[float, float] | None]) -> Table:
    """Return the table of cameras with all errors together: NCC with its error; None: it cannot be traced."""
    axes = [{"path": SHIFT, "uniform": (-0.1, 0.1)}]
    plan = lf.Study(
        small_scene(), axes=axes, metrics=["ncc"], limits={"ncc": 0.8}, design="latin_hypercube", count=len(values)
    ).plan
    rows = []
    for point, value in zip(plan.points, [(1.0, 0.0), *values], strict=False):
        means = {} if value is None else {"ncc": Estimate(*value)}
        why = {"ncc": "dark"} if value is not None and value[0] != value[0] else {}
        rows.append(Row(point, means, means, fault="" if value is not None else "black", unknown=why))
    return Table(plan, tuple(rows))


def test_the_yields_interval_covers_cameras_that_are_not_known_as_good_and_as_bad() -> None:
    good, bad, impossible = (0.9, 0.001), (0.7, 0.001), (1.5, 0.01)
    for unknown in (UNKNOWN, None, impossible):
        table = drawn([good] * 4 + [bad] * 2 + [unknown] * 2)
        found = table.yield_share()
        assert found is not None
        assert (found.good, found.trials) == (4, 6)
        assert (found.low, found.high) == (share_of(4, 8).low, share_of(6, 8).high)
        said = " ".join(in_short(table))
        assert "Yield: 4 of 6 cameras keep the limits, 66.7 %" in said
        assert "for 2 more it is not known" in said
        assert "is broken at 2 of 8 cameras; for 2 its value is not known." in said
    nothing = drawn([UNKNOWN] * 3)
    assert nothing.yield_share() == (0, 0, 0.0, 1.0)
    assert "Yield: not known (95 % interval 0.0 to 100.0 %); for 3 more it is" in " ".join(in_short(nothing))


def test_the_yield_stands_on_the_command_line_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "scene.toml").write_text(small_scene().dump_toml())
    (tmp_path / "study.toml").write_text(
        'scene = "scene.toml"\nmetrics = ["ncc"]\nlimits = { ncc = 0.8 }\ndesign = "latin_hypercube"\ncount = 3\n'
        f'[[axes]]\npath = "{SHIFT}"\nuniform = [-0.1, 0.1]\n'
    )
    table = drawn([(0.9, 0.001), (0.9, 0.001), (0.7, 0.001)])
    monkeypatch.setattr(lf.Study, "run", lambda *_, **__: table)
    assert main(["study", str(tmp_path / "study.toml"), "-o", str(tmp_path / "out")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    (sentence,) = (each for each in in_short(table) if each.startswith("Yield: 2 of 3 cameras keep the limits"))
    assert sentence in said


def test_a_budget_leaves_cameras_out_that_are_not_known_and_counts_them() -> None:
    known = [(0.99, 0.001), (0.9, 0.001), (0.95, 0.001), (0.92, 0.001), (0.97, 0.001)]
    table = drawn([*known, UNKNOWN])
    budget = budget_of(table, table.columns[0])
    assert budget.left_out == 1
    assert budget.drawn == pytest.approx(sum((value - 1.0) ** 2 for value, _ in known) / len(known))
    assert "1 point left out, where normalised cross-correlation is not known." in budget_in_words(table, budget)


def test_a_search_that_ends_at_what_is_not_known_says_no_limit_is_reached_there() -> None:
    table = of_values(0.838, {0.0: (0.93, 0.006), 0.05: (0.92, 0.006), 0.1: UNKNOWN})
    end = replace(table.rows[-1], allowed=Allowed(0.05, 0.05, 0.1, "", "ncc: dark"), unknown={})
    table = replace(table, rows=(*table.rows[:-1], end))
    said = [each for each in in_short(table) if "decentre" in each and "Best" not in each and "Worst" not in each]
    assert "decentre may change by +0.05 (at least; not known from +0.05 to +0.1) mm." in said
    assert "It is not known whether decentre keeps the limits between +0.05 and +0.1 mm: ncc: dark." in said
    assert not any("until a limit is reached" in each or "no limit is reached" in each for each in said)
    assert "not known within the interval" in page(table)
