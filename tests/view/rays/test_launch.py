"""Launched rays are those of a run: their sums are its image and its ledger, to rounding."""

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene import load_lens
from lfmesh.transport import engine
from lfmesh.view.rays.launch import as_in_run, from_field_point, from_light, from_pixel, from_pixels
from lfmesh.view.rays.launch_line import launch

LAMPS = (
    lf.PointLight(position_mm=(-60.0, -255.0, -260.0), power_w=10.0),
    lf.PointLight(position_mm=(80.0, 200.0, -300.0), power_w=3.0),
)


def camera(pixels=30):
    mla = lf.MicrolensArray(count=(12, 10), pitch_mm=0.125, focal_length_mm=0.5, index=1.5, thickness_mm=0.3)
    return lf.Camera(
        lens=load_lens(asset_path("lenses/double_gauss_50mm.toml")),
        focus_mm=500.0,
        mla=mla,
        sensor=lf.Sensor(pixels=(pixels, pixels - 5), pixel_mm=1.5 / pixels),
    )


def sheet(z=-500.0, width=60.0, **material):
    plane = lf.Plane(width_mm=width, height_mm=width)
    return lf.Target(name="sheet", shape=plane, position_mm=(0.0, 0.0, z), material=lf.Material(**material))


@pytest.fixture(scope="module")
def lit():
    """Two lamps light a sheet and a ball, which light each other; forward, every child followed."""
    ball = lf.Target(
        shape=lf.Sphere(radius_mm=8.0), position_mm=(5.0, -5.0, -450.0), material=lf.Material(reflectance=0.5)
    )
    transport = lf.Transport(
        method="forward", split="both", samples=8, replicates=2, wavelengths_nm=(500.0, 600.0), seed=5
    )
    scene = lf.Scene(camera=camera(), targets=(sheet(reflectance=0.9), ball), lights=LAMPS, transport=transport)
    return lf.build(scene)


@pytest.fixture(scope="module")
def glowing():
    """A sheet that emits and reflects nothing, so that a pixel's value is the importance that arrives there."""
    transport = lf.Transport(method="adjoint", split="both", samples=32, replicates=1, seed=3)
    targets = (sheet(reflectance=0.0, radiance_w_m2_sr=2.0),)
    return lf.build(lf.Scene(camera=camera(), targets=targets, transport=transport))


@pytest.fixture(scope="module")
def whole_run(lit):
    return as_in_run(lit)


def test_a_forward_runs_rays_are_its_image_and_its_ledger(lit, whole_run):
    image = lf.render(lit.scene)
    assert whole_run.unit == "W"
    on_sensor = whole_run.end_power * whole_run.arrives
    # One wavelength's packets share its power; the ledger adds all wavelengths.
    np.testing.assert_allclose(on_sensor.sum(), image.ledger.sensor, rtol=1e-12)
    film = np.zeros_like(image.mean)
    wave = np.searchsorted([500.0, 600.0], whole_run.wavelength_nm)
    row, column = whole_run.pixel.T
    hit = whole_run.arrives
    np.add.at(film, (row[hit], column[hit], wave[hit]), whole_run.end_power[hit])
    assert (image.mean > 0.0).sum() > 100
    np.testing.assert_allclose(film, image.mean, rtol=1e-10, atol=1e-14 * image.mean.max())
    assert (whole_run.pixel[~hit] == -1).all()


def test_recorded_paths_are_also_those_of_a_run_of_the_sequential_engine(lit):
    """What it meets in a known order is met here by way of meshes."""
    update = {"targets": (sheet(reflectance=0.9),)}
    update["transport"] = lit.scene.transport.model_copy(update={"split": "transmit"})
    world = lf.build(lit.scene.model_copy(update=update))
    image, rays = lf.render(world.scene), as_in_run(world)
    assert image.engine.startswith("sequential")
    np.testing.assert_allclose(rays.end_power[rays.arrives].sum(), image.ledger.sensor, rtol=1e-10)


def test_fewer_rays_of_a_run_are_its_first_ones_with_all_of_its_power(lit, whole_run):
    some = as_in_run(lit, 200)
    starts = {tuple(p) for p in whole_run.position[whole_run.offsets[:-1]]}
    assert {tuple(p) for p in some.position[some.offsets[:-1]]} <= starts
    # The first packet of either wavelength, which shares its power with fewer others.
    share = 200 / (30 * 25 * 8 * 2)
    first_vertex, of_whole = some.offsets[0], whole_run.offsets[0]
    np.testing.assert_array_equal(some.position[first_vertex], whole_run.position[of_whole])
    assert some.power[first_vertex] * share == pytest.approx(whole_run.power[of_whole], rel=1e-12)


def test_each_light_alone_launches_from_where_it_stands(lit):
    for number, lamp in enumerate(LAMPS):
        rays = from_light(lit, number, 300)
        np.testing.assert_allclose(rays.position[rays.offsets[:-1]], np.tile(lamp.position_mm, (len(rays), 1)))
        assert (rays.event[rays.offsets[:-1]] == lf.Event.START).all()
        assert rays.any_vertex(rays.event == lf.Event.SCATTERED).any()
        # A point light's packets go into the cone round the targets' sphere, and share what it sends there.
        objects = lit.tables.objects
        distance = np.linalg.norm(objects.lamps.rows[number]["position"])
        seen = 0.5 * (1.0 - np.sqrt(1.0 - (objects.radius / distance) ** 2))
        np.testing.assert_allclose(rays.power[rays.offsets[:-1]], lamp.power_w * seen / 150, rtol=1e-9)


def test_a_scenes_only_light_alone_is_its_run(lit):
    world = lf.build(lit.scene.model_copy(update={"lights": LAMPS[:1]}))
    alone, run = from_light(world, 0, 300, seed=5), as_in_run(world, 300)
    np.testing.assert_array_equal(alone.position, run.position)
    np.testing.assert_array_equal(alone.power, run.power)


def test_importance_at_a_glowing_sheet_is_the_adjoint_runs_image(glowing):
    image = lf.render(glowing.scene.changed({"transport.engine": "mesh"}))
    rows, columns = image.mean.shape[:2]
    rays = from_pixels(glowing, range(rows), range(columns), 32 * rows * columns, seed=3)
    film = np.zeros((rows, columns))
    hit = rays.status == lf.Status.TARGET
    np.add.at(film, tuple(rays.pixel[hit].T), 2.0 * rays.end_power[hit])
    assert rays.unit == "m² sr"
    np.testing.assert_allclose(film, image.mean[..., 0], rtol=1e-10, atol=1e-14 * image.mean.max())
    one = from_pixel(glowing, 7, 11, 32, seed=3)
    np.testing.assert_allclose(2.0 * one.end_power[one.status == lf.Status.TARGET].sum(), film[7, 11], rtol=1e-12)
    assert (one.pixel == [7, 11]).all()
    from_box = rays.keep((rays.pixel == [7, 11]).all(axis=1))
    np.testing.assert_array_equal(np.sort(one.position, axis=0), np.sort(from_box.position, axis=0))


def test_an_adjoint_run_is_shown_by_pixels_all_over_the_sensor(glowing):
    rays = as_in_run(glowing, 150)
    assert len(np.unique(rays.source)) > 100
    assert np.unique(rays.pixel[:, 0]).size > 20
    assert np.unique(rays.pixel[:, 1]).size > 20
    # 150 of 750 pixels stand for all of them.
    whole = as_in_run(glowing, 750)
    started = [r.power[r.offsets[:-1]][np.unique(r.source, return_index=True)[1]] for r in (rays, whole)]
    assert np.median(started[0]) == pytest.approx(5.0 * np.median(started[1]), rel=0.2)


def test_wavelengths_share_the_rays(lit):
    rays = from_field_point(lit, (0.0, 0.0, -700.0), 101)
    of_wave = [len(np.unique(rays.source[rays.wavelength_nm == w])) for w in (500.0, 600.0)]
    assert of_wave == [51, 50]
    assert set(from_field_point(lit, (0.0, 0.0, -700.0), 9, wavelength_nm=450.0).wavelength_nm) == {450.0}


def power_through(targets, point):
    scene = lf.Scene(camera=camera(), targets=targets)
    rays = from_field_point(lf.build(scene), point, 500, split="transmit")
    return rays.end_power[rays.arrives].sum()


def test_a_target_hides_the_lens_from_points_behind_it_not_from_its_own():
    """Its own points lie on it to rounding only, on either side."""
    bare = power_through((), (1.0, 2.0, -500.0))
    assert bare > 0.0
    for offset in (-1e-7, 0.0, 1e-7):
        assert power_through((sheet(),), (1.0, 2.0, -500.0 + offset)) == pytest.approx(bare, rel=1e-6)
    assert power_through((sheet(),), (1.0, 2.0, -501.0)) == 0.0
    assert power_through((sheet(-499.0),), (1.0, 2.0, -500.0)) == 0.0


def test_rays_at_the_pupil_get_through_and_rays_at_the_lens_cover_it(glowing):
    """Of the rays that are aimed at the pupil, few end on the stop; those aimed at the lens fill its aperture."""
    point = (20.0, 0.0, -450.0)
    at_pupil = from_field_point(glowing, point, 1000, split="transmit")
    assert at_pupil.any_vertex(at_pupil.surface == at_pupil.surfaces.index("lens[5].back")).mean() > 0.85
    at_lens = from_field_point(glowing, point, 1000, split="transmit", aim="lens")
    front = at_lens.surface == at_lens.surfaces.index("lens[0].front")
    assert np.hypot(*at_lens.position[front][:, :2].T).max() > 0.97 * 12.6
    assert at_lens.any_vertex(at_lens.surface == at_lens.surfaces.index("mount")).any()


def test_a_seed_is_its_rays(glowing):
    one, same, other = (from_field_point(glowing, (0.0, 0.0, -400.0), 50, seed=seed) for seed in (4, 4, 5))
    np.testing.assert_array_equal(one.position, same.position)
    assert one.position.shape != other.position.shape or (one.position != other.position).any()


@pytest.mark.parametrize(
    ("words", "make"),
    [
        ("field 1,2,-700", lambda w: from_field_point(w, (1.0, 2.0, -700.0), 40)),
        ("  field  1.0, 2e0 ,-7e2 ", lambda w: from_field_point(w, (1.0, 2.0, -700.0), 40)),
        ("pixel 7,11", lambda w: from_pixel(w, 7, 11, 40)),
        ("pixels 7:9,11:15", lambda w: from_pixels(w, range(7, 9), range(11, 15), 40)),
        ("run", lambda w: as_in_run(w, 40, seed=0)),
    ],
)
def test_words_launch_what_they_say(glowing, words, make):
    said, made = launch(glowing, words, 40, split="both", seed=0), make(glowing)
    np.testing.assert_array_equal(said.position, made.position)
    np.testing.assert_array_equal(said.power, made.power)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("", "field x,y,z"),
        ("fild 0,0,-500", "did you mean 'field'"),
        ("field 0,0", "field x,y,z"),
        ("field 0,0,5", "in front of the lens"),
        ("field 0,0,nan", "field x,y,z"),
        ("pixel 30,0", "the sensor has rows 0 to 24"),
        ("pixel 0,30", "the sensor has columns 0 to 29"),
        ("pixel -1,0", "row -1"),
        ("pixels 5:5,0:3", "row 5:5"),
        ("pixels 5:9", "pixels r:r,c:c"),
        ("light 0", "it has none"),
        ("light x", "light number"),
        ("run away", "run "),
    ],
)
def test_words_that_cannot_be_launched_are_one_clear_message(glowing, words, says):
    with pytest.raises(lf.LfmeshError) as error:
        launch(glowing, words, 40)
    assert says in str(error.value)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda w: from_field_point(w, (0.0, 0.0), 10), "three finite numbers"),
        (lambda w: from_field_point(w, (0.0, np.inf, 0.0), 10), "three finite numbers"),
        (lambda w: from_field_point(w, "here", 10), "three finite numbers"),
        (lambda w: from_field_point(w, (0.0, 0.0, -9.0), 0), "count = 0"),
        (lambda w: from_field_point(w, (0.0, 0.0, -9.0), 1.5), "count = 1.5"),
        (lambda w: from_field_point(w, (0.0, 0.0, -9.0), 10**9), "paths of at most 1,000,000 rays"),
        (lambda w: from_field_point(w, (0.0, 0.0, -9.0), 10**5000), "integer of about 5000 digits"),
        (lambda w: from_field_point(w, (0.0, 0.0, -9.0), 9, split="all"), "both, roulette, transmit"),
        (lambda w: from_field_point(w, (0.0, 0.0, -9.0), 9, aim="stop"), '"pupil" or "lens"'),
        (lambda w: from_field_point(w, (0.0, 0.0, -9.0), 9, wavelength_nm=-1.0), "wavelength_nm = -1.0"),
        (lambda w: from_field_point(w, (0.0, 0.0, -9.0), 9, weight_cutoff=2.0), "weight_cutoff = 2.0"),
        (lambda w: from_field_point(w, (0.0, 0.0, -9.0), 9, seed=-1), "seed = -1"),
        (lambda w: as_in_run(w, 9, wavelength_nm=450.0), "the scene's (587.6)"),
    ],
)
def test_wrong_settings_are_one_clear_message(glowing, make, says):
    with pytest.raises(lf.LfmeshError) as error:
        make(glowing)
    assert says in str(error.value)


def test_a_scene_in_which_nothing_shines_says_so(glowing):
    dark = glowing.scene.model_copy(
        update={"targets": (), "transport": glowing.scene.transport.model_copy(update={"method": "forward"})}
    )
    with pytest.raises(lf.LfmeshError, match="nothing emits"):
        as_in_run(lf.build(dark), 10)
    with pytest.raises(lf.LfmeshError, match="illuminates nothing"):
        from_light(lf.build(dark.model_copy(update={"lights": LAMPS})), 0, 10)


def test_more_paths_than_can_be_kept_are_refused(glowing, monkeypatch):
    monkeypatch.setattr(engine, "MOST_VERTICES", 100_000)
    with pytest.raises(lf.LfmeshError, match="fewer rays"):
        from_field_point(glowing, (0.0, 0.0, -400.0), 2000, weight_cutoff=1e-4)
    # Nor does it help that they come in chunks.
    monkeypatch.setattr(engine, "MOST_VERTICES", 300_000)
    assert len(from_field_point(glowing, (0.0, 0.0, -400.0), 15_000, split="transmit")) == 15_000
    with pytest.raises(lf.LfmeshError, match="fewer rays"):
        from_field_point(glowing, (0.0, 0.0, -400.0), 30_000, split="transmit")
