"""Ghosts by sequence, through a lens and an array, against launched rays; and how figure and table take them up."""

import csv
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.cli import main
from lfmesh.scene import load_lens
from lfmesh.view.rays.exact_ghosts import exact_ghosts, exact_of
from lfmesh.view.rays.ghosts import ghost_matrix
from lfmesh.view.rays.history import history
from lfmesh.view.rays.launch import from_field_point, from_pixels
from lfmesh.view.rays.path_table import path_table
from lfmesh.view.request import together
from tests.instances import instances

POINT = (4.0, 3.0, -300.0)
SEEDS = 8
ABSORBING = {"layers": [{"index": 1.38, "extinction": 0.02, "thickness_nm": 250.0}]}
LEVEL = 1e-3
"""Of all comparisons together."""


@pytest.fixture(scope="module")
def scene():
    """A triplet before an array; the point is out of focus, so that its light falls on many lenslets."""
    camera = lf.Camera(
        lens=load_lens(asset_path("lenses/cooke_triplet_50mm.toml")),
        focus_mm=500.0,
        mla=lf.MicrolensArray(count=(60, 60), pitch_mm=0.125, focal_length_mm=0.5, index=1.5, thickness_mm=0.3),
        sensor=lf.Sensor(pixels=(60, 60), pixel_mm=0.125),
    )
    return lf.Scene(camera=camera)


@pytest.fixture(scope="module")
def covered(scene):
    """The same before a cover and a sensor that reflects, without the array."""
    changes = {"camera.mla": None, "camera.sensor.reflectance": 0.3}
    changes["camera.sensor.cover"] = {"thickness_mm": 0.5, "gap_mm": 0.3, "index": 1.6, "coating": "ar"}
    changes["coatings"] = {"ar": {"layers": [{"index": 1.38, "thickness_nm": 250.0}]}}
    return scene.changed(changes | {"camera.sensor.pose": {"tilt_deg": (2.0, -1.0, 0.0)}})


@pytest.fixture(scope="module")
def world(scene):
    return lf.build(scene)


@pytest.fixture(scope="module")
def exact(world):
    return exact_ghosts(world, POINT)


def launched(world, seed=0, **options):
    return from_field_point(world, POINT, 400, aim="lens", seed=seed, **{"weight_cutoff": 1e-3} | options)


@pytest.fixture(scope="module")
def rays(world):
    return launched(world)


@pytest.mark.parametrize(
    "behind", instances(["array", "cover and sensor", "cover that absorbs"], long=["array", "cover and sensor"])
)
def test_image_path_and_ghosts_have_the_power_that_rays_find(request, behind):
    camera = request.getfixturevalue("scene" if behind == "array" else "covered")
    if behind == "cover that absorbs":
        camera = camera.changed({"coatings": {"ar": ABSORBING}})
    world = lf.build(camera)
    exact = exact_ghosts(world, POINT)
    rows = [exact.image, *exact.ghosts[: 2 if behind == "array" else 4]]
    found = []
    for seed in range(SEEDS):
        rays = launched(world, seed)
        number = {words: k for k, words in enumerate(rays.sequences)}
        brought = np.bincount(rays.sequence, rays.end_power * rays.arrives, len(rays.sequences))
        ghosts = rays.of_sequences({row.words for row in exact.ghosts})
        each = [brought[number[row.words]] if row.words in number else 0.0 for row in rows]
        found.append([*each, float((rays.end_power * rays.arrives)[ghosts].sum())])
    truth = np.array([*(row.power for row in rows), exact.power])
    error = np.std(found, axis=0, ddof=1) / math.sqrt(SEEDS)
    assert (error < 0.1 * truth).all()
    limit = stats.t.isf(0.5 * LEVEL / len(truth), SEEDS - 1)
    off = np.abs(np.mean(found, axis=0) - truth)
    stated = np.array([*(row.error for row in rows), exact.error])
    assert (off < limit * error + stated).all(), (off / truth, error / truth)
    assert exact.error < 0.01 * exact.power


def test_a_small_sensor_gets_its_share_of_what_a_larger_one_gets():
    """The lit part of the pupil is narrow, as ghosts spread over much more than the sensor."""

    def behind_triplet(side_mm, shift_mm=(0.0, 0.0, 0.0)):
        lens = load_lens(asset_path("lenses/cooke_triplet_50mm.toml"))
        sensor = lf.Sensor(pixels=(10, 10), pixel_mm=side_mm / 10, pose={"shift_mm": shift_mm})
        return lf.build(lf.Scene(camera=lf.Camera(lens=lens, focus_mm=500.0, sensor=sensor)), aimed=False)

    whole = exact_ghosts(behind_triplet(1.0), POINT)
    quarters = [
        exact_ghosts(behind_triplet(0.5, (x, y, 0.0)), POINT) for x in (-0.25, 0.25) for y in (-0.25, 0.25)
    ]  # fmt: skip
    lit = 0
    for words, row in whole.by_words.items():
        parts = [quarter.by_words[words] for quarter in quarters]
        stated = row.error + sum(part.error for part in parts)
        assert abs(sum(part.power for part in parts) - row.power) <= 2.0 * stated, words
        assert stated < 0.01 * row.power or row.power == 0.0
        lit += row.power > 0.0
    assert lit == 16


def test_ghosts_between_plane_faces_have_their_reflectances(scene):
    """Near the axis, at small angles: the closed form of two reflections at normal incidence."""
    n, of_sensor = 1.7, 0.2
    changes = {"camera.mla": None, "camera.lens.f_number": 100.0, "camera.sensor.reflectance": of_sensor}
    cover = {"thickness_mm": 0.5, "gap_mm": 0.3, "index": n}
    exact = exact_ghosts(lf.build(scene.changed(changes | {"camera.sensor.cover": cover})), (0.0, 0.0, -500.0))
    of_face = ((n - 1.0) / (n + 1.0)) ** 2
    between = {("CVb", "CVa"): of_face**2, ("sensor", "CVb"): of_sensor * of_face}
    between["sensor", "CVa"] = of_sensor * of_face * (1.0 - of_face) ** 2
    found = {row.mirrors: row.power / exact.image.power for row in exact.ghosts}
    for mirrors, share in between.items():
        assert found[mirrors] == pytest.approx(share, rel=1e-3)


def test_a_cover_of_air_and_a_sensor_that_reflects_nothing_change_nothing(scene):
    bare = exact_ghosts(lf.build(scene), POINT)
    covered = scene.changed({"camera.sensor.cover": {"thickness_mm": 0.1, "gap_mm": 0.05, "index": 1.0}})
    same = exact_ghosts(lf.build(covered), POINT)
    assert same.image.power == pytest.approx(bare.image.power, rel=1e-9)
    powers = {row.mirrors: row.power for row in same.ghosts}
    assert not any(power for mirrors, power in powers.items() if "CVa" in mirrors or "CVb" in mirrors)
    for row in bare.ghosts:
        assert powers[row.mirrors] == pytest.approx(row.power, rel=1e-6)


def test_views_and_histories_know_the_faces_of_a_cover(covered, tmp_path):
    """The recorded power is the product of R and T of the events, worked out anew; figure, table and filters run."""
    rays = from_field_point(lf.build(covered), POINT, 20, aim="lens", weight_cutoff=1e-6)
    matrix = ghost_matrix(rays)
    assert matrix.labels[-3:] == ["CVa", "CVb", "sensor"]
    matrix.save(tmp_path / "ghosts.png")
    table = path_table(rays).filtered("reflects(cover.rear) and reflects(sensor) and pixel in (:, :)")
    assert table.rows[0].short == "ghost sensor–CVb"
    chosen = np.flatnonzero(rays.any_vertex(rays.surface == rays.surfaces.index("cover.front")) & rays.arrives)
    for path in chosen[:40]:
        steps = history(rays, int(path))
        assert {"CVa", "CVb"} <= {step.short for step in steps}
        # Where no roulette was played: those far above the cutoff.
        played = [step for step in steps if step.power > 1e-4 * steps[0].power]
        assert all(step.roulette == pytest.approx(1.0, rel=1e-9) for step in played)


def test_power_adds_up_over_points_and_wavelengths(scene):
    singlet = lf.Lens(
        surfaces=[
            {"radius_mm": 30.0, "thickness_mm": 4.0, "glass": "N-BK7", "semi_diameter_mm": 6.0, "stop": True},
            {"radius_mm": -40.0, "semi_diameter_mm": 6.0},
        ]
    )
    world, other = (
        lf.build(scene.changed({"camera.lens": singlet, "camera.mla": None}), aimed=False),
        (-3.0, 1.0, -320.0),
    )
    both = exact_ghosts(world, [POINT, other], [486.1, 656.3])
    parts = [exact_ghosts(world, point, [wavelength]) for point in (POINT, other) for wavelength in (486.1, 656.3)]
    assert both.image.power == pytest.approx(sum(part.image.power for part in parts), rel=1e-12)
    for words, row in both.by_words.items():
        assert row.power == pytest.approx(sum(part.by_words[words].power for part in parts), rel=1e-12)


def test_the_matrix_takes_pairs_from_the_sequences_and_other_paths_from_rays(rays, exact):
    noisy, matrix = ghost_matrix(rays), ghost_matrix(rays, exact)
    assert matrix.names == noisy.names
    assert noisy.power[-2:].sum() > 0.0
    for row in exact.ghosts[:10]:
        at = tuple(matrix.labels.index(name) for name in row.mirrors)
        # Rays that meet two lenslets in turn are on no sequence, and are added.
        assert row.power <= matrix.power[at] < 1.02 * row.power
    rest = rays.end_power[rays.arrives & ~rays.of_sequences(exact.by_words)].sum()
    assert matrix.total == pytest.approx(exact.image.power + exact.power + rest, rel=1e-12)
    assert "quadrature" in matrix.source
    assert "rays" in matrix.source
    assert "quadrature" in " ".join(matrix.figure().axes[0].get_title(loc="left").split())


def test_the_path_table_has_exact_powers_and_says_of_which_rows(rays, exact, tmp_path):
    table, noisy = path_table(rays, exact), path_table(rays)
    for row, estimate in zip(table, noisy, strict=True):
        known = exact.by_words.get(row.sequence)
        assert row.power == (known.power if known else estimate.power)
        assert row.exact == (known is not None)
        assert row.error == (known.error if known else estimate.error)
        assert known or row.power == 0.0 or row.error > 0.0
        assert row.share == pytest.approx(row.power / table.total, rel=1e-12)
    assert sum(row.exact for row in table) > 5
    assert any("quadrature" in line for line in table.lines())
    with table.to_csv(tmp_path / "paths.csv").open(encoding="utf-8") as file:
        first = next(csv.DictReader(file))
    assert float(first["power_error_w"]) == table[0].error
    # Of some paths of a sequence only the rays know.
    half = table.filtered(np.arange(len(rays)) % 2 == 0)
    assert not any(row.exact for row in half if row.count < table[row.path].count)
    whole = table.filtered("ghost")
    assert all(row.power == table[row.path].power for row in whole)


def test_pairs_tell_what_of_them_is_integrated(rays, exact):
    matrix = ghost_matrix(rays, exact)
    pairs = {pair.label: pair for pair in matrix.pairs()}
    assert sum(pair.power for pair in pairs.values()) == pytest.approx(matrix.power.sum(), rel=1e-12)
    for row in exact.ghosts[:5]:
        pair = pairs["\N{EN DASH}".join(row.mirrors)]
        assert pair.integrated == pytest.approx(row.power / pair.power, rel=1e-12)
        assert pair.error >= row.error
    assert all(pair.integrated == 0.0 for pair in ghost_matrix(rays).pairs())


def test_without_reflected_rays_other_paths_are_said_to_be_left_out(world, exact):
    matrix = ghost_matrix(launched(world, split="transmit"), exact)
    assert "left out" in matrix.source
    assert matrix.power.sum() == pytest.approx(exact.power, rel=1e-12)


def test_launches_know_their_field_points_and_wavelengths(world, rays, exact):
    of_rays = exact_of(rays)
    assert [row.power for row in of_rays.ghosts] == [row.power for row in exact.ghosts]
    other = from_field_point(world, (-3.0, 1.0, -320.0), 5, wavelength_nm=450.0)
    assert other.field == (((-3.0, 1.0, -320.0),), (450.0,))
    assert together([rays, other]).field is None, "of other wavelengths"
    again = from_field_point(world, (-3.0, 1.0, -320.0), 5)
    both = together([rays, again]).keep(np.zeros(len(rays) + len(again), np.bool_))
    assert both.field == ((POINT, (-3.0, 1.0, -320.0)), rays.field.wavelengths_nm)
    pixels = from_pixels(world, range(2), range(2), 8)
    assert pixels.field is None
    assert exact_of(pixels) is None


def test_surfaces_that_are_not_exact_are_refused(scene):
    with pytest.raises(lf.LfmeshError, match="exact surfaces"):
        exact_ghosts(lf.build(scene.changed({"transport.surface": "smooth"})), POINT)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"transport.polarisation": True}, "polarisation"),
        ({"media": [{"absorption_per_mm": 0.001}]}, "media"),
    ],
)
def test_what_sequences_are_not_followed_through_is_refused_by_name(scene, rays, changes, named):
    world = lf.build(scene.changed(changes))
    with pytest.raises(lf.LfmeshError, match=named):
        exact_ghosts(world, POINT)
    assert exact_of(replace(rays, world=world)) is None


def test_a_point_behind_the_front_of_the_lens_is_refused(world):
    with pytest.raises(lf.LfmeshError, match="in front of the lens"):
        exact_ghosts(world, (0.0, 0.0, 10.0))


def test_the_command_prints_the_strongest_ghosts_of_field_points_alone(scene, exact, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("DISPLAY", "")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    file, figure = tmp_path / "scene.toml", tmp_path / "ghosts.png"
    file.write_text(scene.dump_toml(), encoding="utf-8")
    several = ["--count", "60", "--split", "both", "--weight-cutoff", "1e-3", "--ghosts", str(figure)]
    point = "field " + ",".join(f"{value:g}" for value in POINT)
    assert main(["view", str(file), "--rays", point, *several]) == 0
    printed = capsys.readouterr().out
    strongest = exact.ghosts[0]
    assert f"{strongest.mirrors[0]}\N{EN DASH}{strongest.mirrors[1]}" in printed.splitlines()[1]
    assert f"{strongest.power:.4e}" in printed
    assert figure.is_file()
    # What a filter leaves of the rays, and rays from pixels, have no such table.
    for options in (["--rays", point, "--filter", "ghost"], ["--rays", "pixels 20:40,20:40"]):
        assert main(["view", str(file), *options, *several]) == 0
        assert "quadrature" not in capsys.readouterr().out
