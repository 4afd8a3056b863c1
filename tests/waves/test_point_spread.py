"""Point spreads: focal shifts, Airy's disk, Strehl's ratio, power, and what is refused."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import j0, j1

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.transport.render.progress import Progress
from lfmesh.waves.particles import particle_film, refuse_particles

WAVE_NM, WAVE = 550.0, 0.55e-3
PITCH, FOCAL, PIXEL = 0.14, 2.5, 0.014
STOP, IMAGE = 1.4, 50.0
FAR = 1e5
COUNT = 21
"""Lenslets along each side."""


def scene(lens: list[dict[str, Any]], sensor: dict[str, Any], mla: dict[str, Any] | None = None) -> lf.Scene:
    camera: dict[str, Any] = {"lens": {"surfaces": lens}, "sensor": sensor}
    return lf.Scene.model_validate({"schema_version": 1, "camera": camera | ({"mla": mla} if mla else {})})


def ideal(focal_mm: float, stop_mm: float) -> list[dict[str, Any]]:
    return [{"paraxial": True, "focal_length_mm": focal_mm, "stop": True, "semi_diameter_mm": stop_mm}]


def light_field_camera(array_mm: float, count: int = COUNT) -> lf.Scene:
    """A camera of the Fresnel number of 14 µm lenslets of f = 25 µm at ten times the size; the lens is ideal."""
    mla = {
        "count": [count, count], "pitch_mm": PITCH, "focal_length_mm": FOCAL, "index": 1.5, "conic": -1.0,
        "thickness_mm": 0.01, "distance_mm": array_mm,
    }  # fmt: skip
    sensor = {"pixels": [10 * count, 10 * count], "pixel_mm": PIXEL}
    return scene(ideal(1.0 / (1.0 / IMAGE + 1.0 / FAR), STOP), sensor, mla)


def conventional(stop_mm: float, image_mm: float, pixel_mm: float, count: int, at_mm: float | None = None) -> lf.Scene:
    """A camera of an ideal lens that images the far point at a distance, with the sensor there or elsewhere."""
    sensor = {"pixels": [count, count], "pixel_mm": pixel_mm, "distance_mm": at_mm or image_mm}
    return scene(ideal(1.0 / (1.0 / image_mm + 1.0 / FAR), stop_mm), sensor)


def test_the_focus_of_a_small_round_lens_shifts_towards_it() -> None:
    """At a Fresnel number of 3.5636 the brightest place is at 0.9202 of the focal length, with 1.0911 of the light."""
    image = 2.5

    def on_axis(distance: float) -> float:
        camera = conventional(0.07, image, 0.0005, 9, distance)
        return float(lf.point_spread(camera, (0.0, 0.0, -FAR), WAVE_NM).mean[4, 4])

    places = image * np.linspace(0.88, 0.96, 5)
    curve = np.polynomial.Polynomial.fit(places, [on_axis(z) for z in places], 4)
    fine = np.linspace(places[0], places[-1], 2001)
    best = fine[curve(fine).argmax()]
    assert best / image == pytest.approx(0.9202, abs=0.001)
    assert curve(best) / on_axis(image) == pytest.approx(1.0911, abs=0.002)


def test_the_disk_of_a_perfect_lens_is_airys() -> None:
    """Ten times the size of f/2: .6170 of the light within 7 µm, .8379 within 14 µm, of the light behind the lens."""
    image = 50.0
    found = lf.point_spread(conventional(image / 40.0, image, 0.0014, 41), (0.0, 0.0, -FAR), WAVE_NM, oversample=8)
    distance = np.hypot(found.x_mm[None, :], found.y_mm[:, None])
    for radius, published in ((0.007, 0.6170), (0.014, 0.8379)):
        v = 2.0 * np.pi / WAVE * radius / 40.0
        assert 1.0 - j0(v) ** 2 - j1(v) ** 2 == pytest.approx(published, abs=1e-4)
        assert found.mean[distance <= radius].sum() / found.entered_w == pytest.approx(published, abs=0.001)
    assert found.strehl == pytest.approx(1.0, abs=1e-3)
    assert found.airy_radius_mm == pytest.approx(1.22 * WAVE * 20.0, rel=1e-3)


def test_power_closes() -> None:
    """Behind the lens is the solid angle of the stop; what the grid's plane lacks of it is Airy's light far away."""
    image = 50.0
    stop = image / 40.0
    found = lf.point_spread(conventional(stop, image, 0.0014, 41), (0.0, 0.0, -FAR), WAVE_NM)
    solid = 2.0 * math.pi * (1.0 - FAR / math.hypot(FAR, stop))
    # The difference of 1 and a cosine has few digits.
    assert found.entered_w == pytest.approx(solid, rel=1e-4)
    assert 0.99 < found.power_w / found.entered_w < 1.0
    assert found.mean.sum() < found.power_w


def test_an_aberrated_lens_sends_no_more_light_on_than_has_entered() -> None:
    """Spherical aberration of many waves carries light far from the focus."""
    front = {"radius_mm": 25.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 8.0, "stop": True}
    lens = {"surfaces": [front, {"semi_diameter_mm": 8.0}], "stop_semi_diameter_mm": 6.0}
    camera = {"focus_mm": 200.0, "lens": lens, "sensor": {"pixels": [301, 301], "pixel_mm": 0.001}}
    scene = lf.Scene.model_validate({"schema_version": 1, "camera": camera})
    found = lf.point_spread(scene, (0.0, 0.0, -200.0), WAVE_NM, tolerance=0.01)
    assert 0.985 < found.power_w / found.entered_w < 1.0


@pytest.mark.parametrize("f_number", [4.0, 8.0])
def test_the_peak_of_a_library_lens_is_that_of_its_wavefront(f_number: float) -> None:
    lens = {"file": "lib:double_gauss_50mm", "f_number": f_number}
    camera = {"focus_mm": 2000.0, "lens": lens, "sensor": {"pixels": [65, 65], "pixel_mm": 0.0005}}
    given = lf.Scene.model_validate({"schema_version": 1, "camera": camera}).in_folder(asset_path("scenes"))
    facts = lf.first_order(given)
    found = lf.point_spread(given, (0.0, 0.0, -facts.object_distance_mm), WAVE_NM)
    wanted = lf.wavefront(given, 0.0, WAVE_NM, image_z_mm=facts.image_z_mm).strehl
    assert found.strehl == pytest.approx(wanted, abs=0.01)


def test_white_light_is_the_sum_of_its_wavelengths() -> None:
    camera = conventional(1.25, 50.0, 0.005, 15)
    point = (0.0, 0.0, -FAR)
    both = lf.point_spread(camera, point, (500.0, 600.0), weights=(5e307, 1.5e308))
    blue, red = (lf.point_spread(camera, point, nm) for nm in (500.0, 600.0))
    assert both.weights == (0.25, 0.75)
    np.testing.assert_allclose(both.mean, 0.25 * blue.mean + 0.75 * red.mean, rtol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"point_mm": (0.0, 0.0, 5.0)}, "z below 0"),
        ({"point_mm": "here"}, 'point_mm = "here": must be a number, or a list of numbers'),
        ({"point_mm": None}, "point_mm = None: must be a number, or a list of numbers"),
        ({"point_mm": (0.0, 0.0, -1e300)}, r"z must be -1e\+15 or more"),
        ({"point_mm": (1000.0, 0.0, -FAR)}, "no light falls on the sensor's pixels"),
        ({"wavelengths_nm": "red"}, 'wavelengths_nm = "red": must be a number: the scene has no bands'),
        ({"wavelengths_nm": [[550.0]]}, "wavelengths_nm = "),
        ({"wavelengths_nm": 0.001}, "wavelengths_nm = 0.001: must be from 100 to 20000"),
        ({"wavelengths_nm": [500.0, 600.0], "weights": [math.inf, 1.0]}, "weights = "),
        ({"wavelengths_nm": [500.0, 600.0], "weights": [0.0, 0.0]}, "weights = "),
        ({"wavelengths_nm": ["550"]}, r'wavelengths_nm = \["550"\]: must be a number, or a list of numbers'),
        ({"point_mm": ("0", "0", "-500")}, "must be a number, or a list of numbers"),
        ({"point_mm": (True, False, True)}, "must be a number, or a list of numbers"),
        ({"point_mm": (1e9, 0.0, -500.0)}, "no light falls on the sensor's pixels"),
        ({"weights": "ab"}, 'weights = "ab"'),
        ({"window": 2.5}, "window = 2.5: must be a whole number"),
        ({"oversample": "a"}, 'oversample = "a": must be a whole number'),
        ({"tolerance": None}, "tolerance = None"),
        ({"scene": "scene.toml"}, r'lf\.load\("scene\.toml"\) reads one'),
        ({"point_mm": (0.0, math.nan, -5.0)}, "finite"),
        ({"oversample": 0}, "oversample = 0"),
        ({"window": 0}, "window = 0"),
        ({"tolerance": 2.0}, "tolerance = 2"),
        ({"wavelengths_nm": -1.0}, "wavelengths_nm = -1"),
        ({"weights": (1.0, 2.0)}, "weights"),
    ],
)
def test_wrong_values_are_refused_in_one_line(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(lf.LfmeshError, match=words) as error:
        lf.point_spread(**({"scene": conventional(1.25, 50.0, 0.005, 15), "point_mm": (0.0, 0.0, -FAR)} | arguments))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"camera.mla.pose.tilt_deg": (1.0, 0.0, 0.0)}, "camera.mla.pose.tilt_deg"),
        ({"camera.sensor.pose.tilt_deg": (0.0, 1.0, 0.0)}, "camera.sensor.pose.tilt_deg"),
        ({"camera.mla.flat_finish": {"kind": "ground", "roughness": 0.1}}, "polished"),
    ],
)
def test_cameras_that_waves_are_not_taken_through_are_refused(values: dict[str, Any], words: str) -> None:
    with pytest.raises(lf.LfmeshError, match=words):
        lf.point_spread(light_field_camera(IMAGE).changed(values), (0.0, 0.0, -FAR))


def test_out_of_focus_no_more_passes_an_array_than_fresnel_lets_pass() -> None:
    """Two bare faces of n = 1.5 pass 0.96² at most, however steep they are and wherever light comes from."""
    scene = lf.load(asset_path("scenes/first_light.toml")).changed({"camera.lens.stop_semi_diameter_mm": 2.4})
    found = lf.point_spread(scene, (0.0, 0.0, -480.0), window=64, tolerance=0.05)
    assert 0.96**2 * 0.99 < found.power_w / found.entered_w < 0.96**2


def test_the_spread_of_a_band_is_about_that_of_its_middle() -> None:
    band = {"name": "green", "center_nm": 530.0, "fwhm_nm": 60.0}
    camera = conventional(1.25, 50.0, 0.005, 15).changed({"camera.sensor.bands": [band]})
    found = lf.point_spread(camera, (0.0, 0.0, -FAR), "green")
    assert len(found.wavelengths_nm) > 1
    assert np.average(found.wavelengths_nm, weights=found.weights) == pytest.approx(530.0, abs=0.1)
    middle = lf.point_spread(camera, (0.0, 0.0, -FAR), 530.0)
    assert np.abs(found.mean - middle.mean).sum() < 0.02 * middle.power_w
    with pytest.raises(lf.LfmeshError, match='wavelengths_nm = "red": must be a band of the scene: green'):
        lf.point_spread(camera, (0.0, 0.0, -FAR), "red")
    with pytest.raises(lf.LfmeshError, match="a band has weights of its own"):
        lf.point_spread(camera, (0.0, 0.0, -FAR), "green", weights=[1.0])


def test_figures_of_several_wavelengths_are_those_of_the_weightiest() -> None:
    camera = conventional(1.25, 50.0, 0.005, 15)
    both = lf.point_spread(camera, (0.0, 0.0, -FAR), [500.0, 600.0], weights=[1.0, 0.0])
    one = lf.point_spread(camera, (0.0, 0.0, -FAR), 500.0)
    assert both.peak_w_mm2 == one.peak_w_mm2
    assert "at 500 nm" in both.lines()[0]
    np.testing.assert_array_equal(both.mean, one.mean)


def test_a_spread_too_wide_for_the_largest_grid_is_refused() -> None:
    with pytest.raises(lf.LfmeshError, match=r"its rays at lenslets or sensor are .* nearer the plane in focus"):
        lf.point_spread(light_field_camera(IMAGE), (0.0, 0.0, -8.0))


@pytest.mark.parametrize("thick", [5.0, 10.0])
def test_a_thick_cover_in_a_wide_beam_has_its_own_spherical_aberration(thick: float) -> None:
    """At NA 0.15 its light is 0.9 mm wide before it, a hundred times as wide as the spread."""
    index, image, stop, wave_nm = 1.5, 100.0, 15.0, 500.0
    cover = {"thickness_mm": thick, "gap_mm": 1.0, "index": index}
    sensor = {"pixels": [32, 32], "pixel_mm": 0.001, "cover": cover, "distance_mm": image + thick * (1.0 - 1.0 / index)}
    found = lf.point_spread(scene(ideal(50.0, stop), sensor), (0.0, 0.0, -100.0), wave_nm, tolerance=0.01)
    # Along the axis, with the light of a flat lens: even over tan θ.
    slope = np.linspace(0.0, stop / image, 4001)
    sine = slope / np.hypot(1.0, slope)
    cosine, inside = np.sqrt(1.0 - sine**2), index * np.sqrt(1.0 - (sine / index) ** 2)
    path = thick * (inside - cosine - (index - 1.0) + (1.0 - 1.0 / index) * (cosine - 1.0))
    wave = np.exp(2j * np.pi * path / (1e-6 * wave_nm))
    strehl = abs(np.trapezoid(wave * slope, slope) / np.trapezoid(slope, slope)) ** 2
    assert found.strehl == pytest.approx(strehl, abs=0.005)


PLATE = {"shape": {"kind": "plane", "width_mm": 100.0, "height_mm": 100.0}}
BESIDE = PLATE | {"position_mm": (50.5, 0.0, -200.0)}


@pytest.mark.parametrize(
    ("target", "message"),
    [
        (PLATE | {"position_mm": (0.0, 0.0, -200.0)}, r"targets\[0\] hides it; move the point"),
        (BESIDE | {"name": "fence"}, r"fence hides it from .* of .* points of the pupil"),
    ],
    ids=["whole", "part"],
)
def test_points_that_a_target_hides_even_in_part_are_refused(target: dict[str, Any], message: str) -> None:
    camera = conventional(1.25, 50.0, 0.005, 15).changed({"targets": [target]})
    with pytest.raises(lf.LfmeshError, match=message) as error:
        lf.point_spread(camera, (0.0, 0.0, -400.0), window=4)
    assert "\n" not in str(error.value)


def test_targets_beside_and_behind_a_point_and_under_it_change_nothing() -> None:
    camera, point = conventional(1.25, 50.0, 0.005, 15), (0.0, 0.0, -50000.0)
    wanted = lf.point_spread(camera, point, window=4)
    targets = [BESIDE | {"position_mm": (53.0, 0.0, -200.0)}, PLATE | {"position_mm": point}]
    found = lf.point_spread(camera.changed({"targets": targets}), point, window=4)
    np.testing.assert_array_equal(found.mean, wanted.mean)


def test_progress_is_told_in_parts_of_each_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    """With lenslets, from 0 to 100 % on ever finer grids, which may be small here."""
    monkeypatch.setattr("lfmesh.waves.extent.FIRST_RINGS", 3.0)
    told: list[Progress] = []
    lf.point_spread(light_field_camera(IMAGE, 3), (0.0, 0.0, -FAR), tolerance=0.5, progress=told.append)
    stages = list(dict.fromkeys(each.stage for each in told))
    assert len(stages) == 2
    for stage in stages:
        percent = [each.done for each in told if each.stage == stage]
        assert percent == sorted(percent)
        assert (percent[0], percent[-1], told[0].total) == (0, 100, 100)
        assert len(set(percent)) > 5


@pytest.mark.filterwarnings("ignore::lfmesh.errors.DiffractionWarning")
def test_light_of_steep_lenslets_is_on_the_grid_or_beyond_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of f/3, behind a lens of f/4, on a small grid, whose rim takes a percent of the light from centre and corner."""
    monkeypatch.setattr("lfmesh.waves.extent.FIRST_RINGS", 6.0)
    mla = {"count": [5, 5], "pitch_mm": 0.02, "focal_length_mm": 0.06, "index": 1.5, "thickness_mm": 0.01,
           "distance_mm": IMAGE, "conic": -1.0}  # fmt: skip
    camera = scene(ideal(1.0 / (1.0 / IMAGE + 1.0 / FAR), IMAGE / 8.0), {"pixels": [50, 50], "pixel_mm": 0.002}, mla)
    centre, corner = (
        lf.point_spread(camera, (-x * FAR / IMAGE, -x * FAR / IMAGE, -FAR), WAVE_NM, tolerance=0.1) for x in (0.0, 0.01)
    )
    assert centre.beyond < 0.001
    on, in_all = (found.power_w / found.entered_w / 0.96**2 for found in (centre, corner))
    assert in_all < on - 0.003
    assert in_all * (1.0 + corner.beyond) == pytest.approx(on, abs=0.0025)


NEAR_ARRAY = {"count": [3, 3], "pitch_mm": 0.1, "focal_length_mm": 2.0, "index": 1.5, "thickness_mm": 0.3}


@pytest.mark.parametrize("x_mm", [1.0, 3.0, 1e4])
@pytest.mark.parametrize("mla", [NEAR_ARRAY, None], ids=["array", "bare"])
def test_a_point_whose_light_misses_array_or_pixels_has_one_clear_line(x_mm: float, mla: dict[str, Any] | None) -> None:
    """However far it misses them, before the first wave is followed."""
    given = {
        "focus_mm": 200.0, "lens": {"surfaces": ideal(100.0, 2.0)}, "sensor": {"pixels": [64, 64], "pixel_mm": 0.004},
    }  # fmt: skip
    camera = lf.Scene.model_validate({"schema_version": 1, "camera": given | ({"mla": mla} if mla else {})})
    with pytest.raises(lf.LfmeshError, match=rf"point_mm = \[{x_mm}, .*: no light falls on the sensor's pixels; move"):
        lf.point_spread(camera, (x_mm, 0.0, -200.0), WAVE_NM)


def test_a_particle_beside_the_array_is_dark(tmp_path: Path) -> None:
    """Far aside as well, where a real lens lets nothing pass."""
    camera = {
        "focus_mm": 500.0, "lens": {"file": "lib:double_gauss_50mm", "stop_semi_diameter_mm": 4.77},
        "mla": NEAR_ARRAY, "sensor": {"pixels": [16, 16], "pixel_mm": 0.02},
    }  # fmt: skip
    (tmp_path / "points.csv").write_text("x_mm,y_mm,z_mm\n60,0,-500\n5000,0,-500\n")
    given = {
        "schema_version": 1, "camera": camera, "particles": [{"file": "points.csv", "intensity_w_sr": 2.0}],
        "transport": {"diffraction": "lenslets", "split": "transmit", "wavelengths_nm": [WAVE_NM]},
    }  # fmt: skip
    assert not particle_film(lf.build(lf.Scene.model_validate(given).in_folder(tmp_path))).power.any()


def test_what_limits_the_grid_is_named_and_the_advice_works(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rings of a slow lens before any wave is followed: a wider stop; too small a tolerance: a larger one."""

    def slow(stop_mm: float) -> lf.Scene:
        given = {
            "focus_mm": 200.0, "lens": {"surfaces": ideal(100.0, stop_mm)}, "mla": NEAR_ARRAY,
            "sensor": {"pixels": [64, 64], "pixel_mm": 0.004},
        }  # fmt: skip
        return lf.Scene.model_validate({"schema_version": 1, "camera": given})

    told: list[Progress] = []
    with pytest.raises(
        lf.LfmeshError, match=r"the diffraction rings of its narrow beam are 6.* wide; give a wider stop"
    ):
        lf.point_spread(slow(0.5), (0.0, 0.0, -200.0), 500.0, progress=told.append)
    assert not told
    particle = {
        "count": 1, "bounds": {"kind": "box", "size_mm": (1e-6,) * 3}, "position_mm": (0.0, 0.0, -200.0),
        "intensity_w_sr": 1.0,
    }  # fmt: skip
    traced = {"diffraction": "lenslets", "split": "transmit", "wavelengths_nm": (500.0,)}
    refuse_particles(lf.build(slow(0.7).changed({"particles": [particle], "transport": traced})))

    monkeypatch.setattr("lfmesh.waves.extent.MOST", 300)
    camera, point = conventional(1.25, 50.0, 0.005, 15), (0.0, 0.0, -FAR)
    with pytest.raises(lf.LfmeshError, match=r"tolerance = 1e-12: .* give a tolerance of [\d.]+ or more$") as error:
        lf.point_spread(camera, point, WAVE_NM, tolerance=1e-12)
    enough = float(str(error.value).split()[-3])
    assert lf.point_spread(camera, point, WAVE_NM, tolerance=enough).change <= enough
