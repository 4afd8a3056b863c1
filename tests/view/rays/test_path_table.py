"""The path table adds up: to the sensor's power, the paths, and the brightest pixel."""

import csv

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.view.rays.filters import FilterError, parse
from lfmesh.view.rays.launch import as_in_run, from_field_point, from_pixels
from lfmesh.view.rays.path_table import COLUMNS, path_table


@pytest.fixture(scope="module")
def world():
    """The first scene at a small size, as a forward run that follows every child."""
    scene = lf.load(asset_path("scenes/first_light.toml"))
    transport = scene.transport.model_copy(update={"method": "forward", "split": "both", "samples": 8})
    sensor = scene.camera.sensor.model_copy(update={"pixels": (64, 64), "pixel_mm": 0.125})
    camera = scene.camera.model_copy(update={"sensor": sensor})
    return lf.build(scene.model_copy(update={"camera": camera, "transport": transport}))


@pytest.fixture(scope="module")
def rays(world):
    return as_in_run(world)


@pytest.fixture(scope="module")
def table(rays):
    return path_table(rays)


def test_powers_sum_to_the_ledgers_sensor_power(world, table):
    ledger = lf.render(world.scene).ledger
    assert ledger.sensor > 0.0
    assert table.power == pytest.approx(ledger.sensor, rel=1e-12)
    assert sum(row.share for row in table) == pytest.approx(1.0, rel=1e-12)
    # Ghosts are among them.
    assert sum(row.power for row in table if row.reflections >= 2) > 0.0


def test_rows_are_the_sequences_and_count_every_path_once(rays, table):
    assert [row.path for row in table] == list(range(len(rays.sequences)))
    assert sorted(row.sequence for row in table) == sorted(rays.sequences)
    assert sum(row.count for row in table) == len(rays)
    for row in table[:5]:
        of_row = rays.sequence == row.path
        assert row.count == of_row.sum()
        assert row.power == pytest.approx(rays.end_power[of_row].sum(), rel=1e-12)
        path = int(np.flatnonzero(of_row)[0])
        events = [lf.Event(e) for e in rays.event[rays.offsets[path] : rays.offsets[path + 1]]]
        assert row.events == sum(e in (lf.Event.TRANSMITTED, lf.Event.REFLECTED, lf.Event.SCATTERED) for e in events)
        assert row.reflections == events.count(lf.Event.REFLECTED)


def test_largest_irradiance_is_that_of_the_brightest_pixel(rays, table):
    for row in (*table[:3], table[len(table) - 1]):
        film = np.zeros((64, 64))
        hit = (rays.sequence == row.path) & rays.arrives
        np.add.at(film, tuple(rays.pixel[hit].T), rays.end_power[hit])
        assert row.irradiance == pytest.approx(film.max() / 0.125**2, rel=1e-12)


@pytest.mark.parametrize("column", COLUMNS)
@pytest.mark.parametrize("descending", [True, False])
def test_any_column_sorts(table, column, descending):
    values = [getattr(row, column) for row in table.sorted(column, descending=descending)]
    assert values == sorted(values, reverse=descending)
    assert sorted(values) == sorted(getattr(row, column) for row in table)


def test_numbers_sort_from_large_to_small_by_themselves(table):
    assert table.sorted("count")[0].count == max(row.count for row in table)
    assert table.sorted("path")[0].path == 0


def test_an_unknown_column_is_refused_with_the_nearest(table):
    with pytest.raises(lf.LfmeshError, match="did you mean 'power'"):
        table.sorted("pover")


def test_a_filtered_table_is_that_of_the_kept_paths_with_shares_of_all(rays, table):
    for expression in ("ghost", "hits(mla) and not ghost", "last == stop", "reflects(L1a) or power > 1e-12"):
        kept = table.filtered(expression)
        mask = parse(expression, rays)
        assert sum(row.count for row in kept) == mask.sum() > 0
        assert kept.power == pytest.approx(rays.end_power[mask & rays.arrives].sum(), rel=1e-12)
        assert sum(row.share for row in kept) == pytest.approx(kept.power / table.power, rel=1e-12)
        for row in kept:
            assert row.sequence == rays.sequences[row.path]
    both = table.filtered("ghost").power + table.filtered("not ghost").power
    assert both == pytest.approx(table.power, rel=1e-12)
    assert len(table.filtered("path == 3")) == 1
    assert table.filtered("path == 3")[0].path == 3
    assert len(table.filtered(np.zeros(len(rays), bool))) == 0
    with pytest.raises(FilterError):
        table.filtered("gost")


def test_csv_holds_every_digit_and_the_whole_sequences(tmp_path, table):
    file = table.sorted("count").to_csv(tmp_path / "paths.csv")
    with file.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(table)
    for read, row in zip(rows, table.sorted("count"), strict=True):
        assert int(read["path"]) == row.path
        assert int(read["count"]) == row.count
        assert float(read["power_w"]) == row.power
        assert float(read["share"]) == row.share
        assert float(read["largest_irradiance_w_mm2"]) == row.irradiance
        assert read["sequence"] == row.sequence
    assert [f.name for f in tmp_path.iterdir()] == ["paths.csv"]


def test_csv_is_written_whole_or_not_at_all(tmp_path, table, monkeypatch):
    file = tmp_path / "paths.csv"
    file.write_text("before")
    monkeypatch.setattr("pathlib.Path.replace", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left")))
    with pytest.raises(lf.FileError, match="No space left"):
        table.to_csv(file)
    assert file.read_text() == "before"
    assert [f.name for f in tmp_path.iterdir()] == ["paths.csv"]
    monkeypatch.undo()
    for place in (tmp_path, tmp_path / "nowhere" / "paths.csv"):
        with pytest.raises(lf.FileError):
            table.to_csv(place)


@pytest.mark.parametrize("launched", ["run", "field", "pixels"])
def test_lines_fit_80_columns_and_name_the_reflections(world, rays, launched):
    if launched == "field":
        rays = from_field_point(world, (0.0, 0.0, -400.0), 500, aim="lens", weight_cutoff=1e-3)
    elif launched == "pixels":
        rays = from_pixels(world, range(30, 33), range(30, 33), 500)
    table = path_table(rays)
    lines = table.lines(most=len(table))
    assert max(map(len, lines)) <= 80
    assert len(lines) == len(table) + 2
    assert f"{len(rays):,} paths" in lines[-1]
    shortened = table.lines(most=4)
    assert len(shortened) == 7
    assert f"{len(table) - 4:,} more sequences" in shortened[-2]


def test_short_forms_name_reflections_in_the_order_of_light(world):
    forward = path_table(from_field_point(world, (0.0, 0.0, -400.0), 300, aim="lens", weight_cutoff=1e-3))
    short = {row.short: row for row in forward}
    assert short["image path"].reflections == 0
    ghost = short["ghost L6b\N{EN DASH}L5b"]
    assert "L6b R, L6a T, L5b R, L6a T, L6b T, MLAc T, MLAf T, sensor" in ghost.sequence
    assert ghost.sequence.startswith("L1a T, ")
    adjoint = path_table(from_pixels(world, range(30, 33), range(30, 33), 600, weight_cutoff=1e-3))
    same = next(row for row in adjoint if row.short.startswith("ghost L6b\N{EN DASH}L5b,"))
    assert "MLAf T, MLAc T, L6b T, L6a T, L5b R, L6a T, L6b R" in same.sequence


def test_a_table_of_nothing_is_empty(world, tmp_path):
    rays = from_field_point(world, (0.0, 0.0, -400.0), 5)
    nothing = path_table(rays.keep(np.zeros(len(rays), bool)))
    assert len(nothing) == 0
    assert nothing.power == 0.0
    assert len(nothing.lines()) == 2
    assert len(nothing.to_csv(tmp_path / "none.csv").read_text().splitlines()) == 1
