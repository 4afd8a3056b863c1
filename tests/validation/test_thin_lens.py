"""A thin lens images points into points at every angle, by the textbook's formulas, and keeps the power of light."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.accuracy import analytic
from lfmesh.errors import LfmeshError
from lfmesh.imports.lens_file import read_lens_file, write_lens_file
from lfmesh.scene import Scene
from lfmesh.scene.first_order.meridional import heights_mm
from lfmesh.scene.first_order.paraxial import Paraxial, Ray
from lfmesh.transport.sequences.ray_tables import etendue_factors, follow_sequence
from lfmesh.transport.sequences.sequences import image_path
from lfmesh.view.layout.content import layout
from lfmesh.view.rays.exact_ghosts import exact_ghosts
from tests.renders import unchecked

Array = NDArray[np.float64]
ENGINES = ("mesh", "sequential")


def thin(f: float, to_next: float | None = None, radius: float = 10.0, **more: Any) -> dict[str, Any]:
    away = {} if to_next is None else {"thickness_mm": to_next}
    return {"paraxial": True, "focal_length_mm": f, "semi_diameter_mm": radius, **away, **more}


def scene(
    surfaces: list[Any], sensor_mm: float, elements: Any = (), focus_mm: float | None = None, **tables: Any
) -> Scene:
    sensor: dict[str, Any] = {"pixels": [40, 40], "pixel_mm": 1.0}
    camera: dict[str, Any] = {"lens": {"surfaces": surfaces, "elements": elements}, "sensor": sensor}
    if focus_mm is None:
        sensor["distance_mm"] = sensor_mm
    else:
        camera["focus_mm"] = focus_mm
    return Scene(camera=camera, **tables)


def at_z(paths: Any, z: Array) -> Array:
    """Where the straight lines on which the rays end cross planes."""
    return paths.position + ((z - paths.position[:, 2]) / paths.direction[:, 2])[:, None] * paths.direction


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("backwards", [False, True])
def test_a_point_at_any_angle_becomes_a_point_by_the_lens_formula(engine: str, backwards: bool) -> None:
    """1/s' = 1/f + 1/s and y'/y = s'/s, real and virtual images, to rounding over the steepest coordinate."""
    draw = np.random.default_rng(5)
    for _ in range(20):
        f, aperture = (
            float(draw.choice([-1.0, 1.0]) * 10 ** draw.uniform(0.5, 2.5)),
            float(10 ** draw.uniform(-0.5, 1.5)),
        )
        world = lf.build(scene([thin(f, radius=aperture, stop=True)], 1e4), aimed=False)
        z = -abs(f) * 10 ** draw.uniform(-1.0, 1.0)
        slope = 3.0 * draw.uniform(-1.0, 1.0, 2)
        point = np.array([*(-z * slope), z])
        at = aperture * 0.7 * draw.uniform(-1.0, 1.0, (50, 3)) * [1.0, 1.0, 0.0]
        side = [1.0, 1.0, -1.0 if backwards else 1.0]
        # They start close to the lens, where no housing is in their way, on lines through the point.
        start = at + 0.05 * aperture / np.linalg.norm(point - at, axis=1).max() * (point - at)
        paths = lf.trace(world, start * side, (at - point) * side, split="transmit", engine=engine)
        assert len(paths) == 50
        np.testing.assert_array_equal(paths.weight, 1.0)
        image = 1.0 / (1.0 / f + 1.0 / z)
        met = at_z(paths, np.full(50, image * side[2]))
        off = np.linalg.norm(met - np.multiply([*(point[:2] * image / z), image], side), axis=1)
        # A ray that ends far away has the rounding of that place, carried back.
        size = np.abs(paths.position).max() + abs(image) * (1.0 + np.linalg.norm(slope)) + np.abs(met).max()
        assert off.max() <= 1e-12 * size


def test_two_thin_lenses_combine_by_the_textbook_formula() -> None:
    draw = np.random.default_rng(6)
    for _ in range(20):
        f1, f2 = draw.choice([-1.0, 1.0], 2) * 10 ** draw.uniform(1.0, 2.0, 2)
        gap = float(draw.uniform(1.0, 40.0))
        power = 1 / f1 + 1 / f2 - gap / (f1 * f2)
        made = scene([thin(float(f1), gap, stop=True, radius=0.5), thin(float(f2), radius=1e4)], 500.0)
        facts = lf.first_order(made)
        assert facts.efl_mm == pytest.approx(1 / power, rel=1e-12)
        back = (1 - gap / f1) / power
        assert facts.bfl_mm == pytest.approx(back, rel=1e-12)
        slope = np.array([*draw.uniform(-1.0, 1.0, 2), 1.0])
        start = np.column_stack([draw.uniform(-0.3, 0.3, (30, 2)), np.zeros(30)]) - slope
        paths = lf.trace(
            lf.build(made, aimed=False), start, np.tile(slope, (30, 1)), split="transmit", engine="sequential"
        )
        focus = at_z(paths, np.full(len(paths), gap + back))
        # A parallel bundle comes together at the height f times its slope: no distortion at all.
        assert np.abs(focus[:, :2] - slope[:2] / power).max() < 1e-11 * (
            abs(1 / power) + abs(back) + np.abs(paths.position).max()
        )


def test_real_axial_rays_meet_thin_lenses_at_the_heights_of_paraxial_ones() -> None:
    lens = scene([thin(60.0, 12.0), thin(-45.0, 7.0), thin(50.0, stop=True)], 60.0).camera.lens
    for object_mm in (np.inf, 80.0, -30.0):
        paraxial = Paraxial.of(lens, 587.6)
        ray = Ray(4.0, 0.0 if np.isinf(object_mm) else 4.0 / object_mm)
        np.testing.assert_allclose(heights_mm(lens, 587.6, object_mm, 4.0), paraxial.heights_mm(ray), rtol=1e-12)


@pytest.mark.parametrize("size", [{"f_number": 2.5}, {"epd_mm": 20.0}, {"stop_semi_diameter_mm": 10.0}])
def test_a_thin_lens_that_is_the_stop_takes_its_size_from_the_pupil(size: dict[str, float]) -> None:
    surface = {"paraxial": True, "focal_length_mm": 50.0, "stop": True}
    facts = lf.first_order(Scene(
        camera={"lens": {"surfaces": [surface], **size}, "focus_mm": np.inf,
                "sensor": {"pixels": [10, 10], "pixel_mm": 0.1}},
    ))  # fmt: skip
    assert facts.entrance_pupil_diameter_mm == pytest.approx(20.0, rel=1e-12)
    assert facts.working_f_number == pytest.approx(2.5, rel=1e-12)


def mixed(draw: np.random.Generator) -> list[Any]:
    """A thin lens before and one behind a piece of glass, one of them the stop."""
    return [
        thin(float(draw.choice([-90.0, 60.0])), 3.0, 9.0),
        {"radius_mm": 40.0, "thickness_mm": 4.0, "index": 1.6, "semi_diameter_mm": 9.0},
        {"radius_mm": -55.0, "thickness_mm": 5.0, "semi_diameter_mm": 9.0},
        thin(float(draw.choice([-70.0, 80.0])), radius=6.0, stop=True),
    ]


def test_engines_and_the_plain_trace_agree_ray_by_ray_with_tilted_and_decentred_thin_lenses() -> None:
    draw = np.random.default_rng(7)
    for poses in range(4):
        elements = [
            {"surfaces": [k], "pose": {"shift_mm": draw.uniform(-0.5, 0.5, 3).tolist(),
                                       "tilt_deg": draw.uniform(-8.0, 8.0, 3).tolist()}}
            for k in ((0, 3) if poses else ())
        ]  # fmt: skip
        made = scene(mixed(draw), 60.0, elements)
        world = lf.build(made, aimed=False)
        origins = np.column_stack([draw.uniform(-10.0, 10.0, (2000, 2)), np.full(2000, -20.0)])
        directions = np.column_stack([draw.uniform(-0.4, 0.4, (2000, 2)), np.ones(2000)])
        one, other = (lf.trace(world, origins, directions, split="transmit", engine=engine) for engine in ENGINES)
        np.testing.assert_array_equal(one.status, other.status)
        lands = one.status == lf.Status.SENSOR
        np.testing.assert_allclose(one.position[lands], other.position[lands], rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(one.direction[lands], other.direction[lands], rtol=0.0, atol=1e-11)
        np.testing.assert_allclose(one.weight[lands], other.weight[lands], rtol=1e-12)
        truth = analytic.Camera.of(made, made.primary_nm).land(origins, directions)
        sent = one.source[lands]
        assert len(sent) > 200
        assert truth.arrives[sent].all()
        off = one.position[lands][:, :2] - truth.position[sent]
        assert np.abs(off).max() < 1e-9


def irradiance_of_image(f: float, s: float, radius: float, height: Array, radiance: float = 1.0) -> Array:
    """Irradiance, W/mm², of the image of a Lambertian plane at a distance, at heights of the image.

    The light that the plane sends through the lens, Σ L cos⁴/s² over the lens, is spread over m² times its area.
    """
    nodes, weights = np.polynomial.legendre.leggauss(40)
    r, around = radius * np.sqrt(0.5 * (nodes + 1.0)), 2.0 * np.pi * np.arange(64) / 64
    x, y = np.outer(r, np.cos(around)).ravel(), np.outer(r, np.sin(around)).ravel()
    area = np.repeat(0.5 * weights, 64) / 64 * np.pi * radius**2
    m = f / (s - f)
    squared = (x - height[:, None] / m) ** 2 + y**2
    return radiance / (s * m) ** 2 * ((1.0 + squared / s**2) ** -2 @ area)


def fast_scene(method: str, engine: str, elements: Any = ()) -> Scene:
    """An f/1 lens, its own stop, that images a glowing plane twice its focal length off to the same size and larger."""
    glow = {"shape": {"kind": "plane", "width_mm": 120.0, "height_mm": 120.0}, "position_mm": [0.0, 0.0, -75.0],
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}  # fmt: skip
    transport = {"method": method, "engine": engine, "split": "transmit", "samples": 64, "replicates": 16}
    made = scene([thin(50.0, radius=25.0, stop=True)], 150.0, elements, targets=[glow], transport=transport)
    return made.changed({"camera.sensor.pixels": [8, 8], "camera.sensor.pixel_mm": 20.0})


@pytest.mark.parametrize(
    ("engine", "posed"),
    [
        *(("mesh", False), ("sequential", True)),
        *(pytest.param(*values, marks=pytest.mark.long) for values in (("mesh", True), ("sequential", False))),
    ],
)
def test_forward_equals_adjoint_through_a_fast_thin_lens(engine: str, posed: bool) -> None:
    """Power sums of the whole image, by Welch's z at 1e-3 for both comparisons of a case.

    With radiance kept in place of power the adjoint image would be 3 % brighter, more than ten standard errors.
    """
    elements = [{"surfaces": [0], "pose": {"tilt_deg": [12.0, 0.0, 0.0]}}] if posed else ()
    total, error = [], []
    for method in ("adjoint", "forward"):
        made = fast_scene(method, engine, elements).changed(
            {"transport.samples": 512 if method == "adjoint" else 16384}
        )
        image = unchecked(made)
        assert abs(image.ledger.imbalance) < 1e-9
        total.append(float(image.mean.sum()))
        error.append(float(np.sqrt(np.square(image.stderr).sum())))
    assert max(error) < 0.003 * total[0]
    limit = stats.t.ppf(1.0 - 0.5e-3 / 2, 15)
    assert abs(total[0] - total[1]) < limit * np.hypot(*error)
    if not posed:
        fine = (np.arange(64) - 31.5) * 2.5
        height = np.hypot(*np.meshgrid(fine, fine)).ravel()
        truth = float(irradiance_of_image(50.0, 75.0, 25.0, height).sum()) * 2.5**2 * 1e-6
        for sum_, its in zip(total, error, strict=True):
            assert abs(sum_ - truth) < limit * its + 1e-4 * truth
        kept = float(irradiance_of_image(50.0, 150.0, 25.0, height).sum()) * 0.25 * 2.5**2 * 1e-6
        assert abs(kept - truth) > 10.0 * max(error)


def test_far_away_a_thin_lens_gives_the_textbook_irradiance() -> None:
    """π L / (4 N²) on the axis, which no cos⁴ of the cone dims: at f/0.5 an aplanatic lens gives that, too."""
    glow = {"shape": {"kind": "plane", "width_mm": 4e6, "height_mm": 4e6}, "position_mm": [0.0, 0.0, -1e6],
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}  # fmt: skip
    transport = {"split": "transmit", "samples": 1024, "replicates": 16}
    made = scene([thin(50.0, radius=50.0, stop=True)], 50.0, targets=[glow], transport=transport)
    image = unchecked(made.changed({"camera.sensor.pixels": [1, 1], "camera.sensor.pixel_mm": 0.01}))
    expected = np.pi / (4 * 0.5**2) * 1e-4 * 1e-6
    assert image.mean[0, 0, 0] == pytest.approx(expected, abs=float(stats.t.ppf(0.9995, 15) * image.stderr[0, 0, 0]))
    assert image.stderr[0, 0, 0] < 0.01 * expected


def test_depth_of_field_is_the_textbooks() -> None:
    """Near and far limits s f² / (f² ± N c (s − f)), with a circle of one pixel, of a lens that is its own stop."""
    draw = np.random.default_rng(8)
    for _ in range(20):
        f, n, s = float(draw.uniform(20.0, 100.0)), float(draw.uniform(1.0, 8.0)), float(draw.uniform(200.0, 5000.0))
        pixel = float(10 ** draw.uniform(-3.0, -1.5))
        made = scene([thin(f, radius=0.5 * f / n, stop=True)], 0.0, focus_mm=s).changed(
            {"camera.sensor.pixel_mm": pixel}
        )
        facts = lf.first_order(made)
        assert facts.near_mm == pytest.approx(s * f * f / (f * f + n * pixel * (s - f)), rel=1e-9)
        least = f * f - n * pixel * (s - f)
        assert facts.far_mm == pytest.approx(s * f * f / least if least > 0 else np.inf, rel=1e-9)


def test_the_lens_sheet_of_a_thin_lens_knows_no_aberration_and_no_ghosts() -> None:
    made = scene([thin(80.0, 20.0), {"stop": True, "semi_diameter_mm": 6.0, "thickness_mm": 10.0}, thin(60.0)], 0.0,
                 focus_mm=500.0)  # fmt: skip
    sheet = lf.analyse(made.changed({"camera.sensor.pixel_mm": 0.3}))
    assert max(spot.geo_mm for spot in sheet.spots) < 1e-12
    assert np.nanmax(np.abs(sheet.curves.distortion)) < 1e-12
    for focus in (sheet.curves.tangential_mm, sheet.curves.sagittal_mm):
        assert np.nanmax(np.abs(focus)) < 1e-9
    assert exact_ghosts(lf.build(made), [[3.0, 2.0, -500.0]]).ghosts == []


def test_illumination_falls_by_cos4_of_the_chief_ray_through_a_small_stop() -> None:
    sheet = lf.analyse(scene([thin(50.0, radius=0.1, stop=True)], 0.0, focus_mm=400.0))
    image = 1.0 / (1.0 / 50.0 - 1.0 / 400.0)
    cosine = np.cos(np.arctan(sheet.curves.height_mm / image))
    np.testing.assert_allclose(sheet.curves.illumination, cosine**4, rtol=1e-5)


def test_the_camera_model_weighs_pixels_by_the_power_that_they_gather() -> None:
    """A world of radiance 1 gives the pixels their weights, but for the few per cent that cross to other lenslets.

    Of a lens of f/1 as of one of f/5, which agree to 2 %; without the étendue of the fast one they differ by 7 %.
    """
    glow = {"shape": {"kind": "plane", "width_mm": 4000.0, "height_mm": 4000.0}, "position_mm": [0.0, 0.0, -75.0],
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}  # fmt: skip
    array = {"count": [5, 5], "pitch_mm": 2.0, "focal_length_mm": 6.0, "index": 1.5, "thickness_mm": 0.5,
             "distance_mm": 150.0}  # fmt: skip
    shares = []
    for radius in (5.0, 25.0):
        made = Scene(
            camera={"lens": {"surfaces": [thin(50.0, radius=radius, stop=True)]}, "mla": array,
                    "sensor": {"pixels": [20, 20], "pixel_mm": 0.5}},
            targets=[glow],
            transport={"split": "transmit", "samples": 512, "replicates": 16},
        )  # fmt: skip
        image = unchecked(made)
        shares.append(image.mean.sum() / lf.camera_model(made).weight.sum())
        assert np.sqrt(np.square(image.stderr).sum()) < 0.005 * image.mean.sum()
    assert shares[1] / shares[0] == pytest.approx(1.0, abs=0.02)


def test_etendue_factors_are_the_ratio_of_cosines_lens_by_lens() -> None:
    made = scene([thin(60.0, 12.0), thin(-45.0, 7.0), thin(50.0, stop=True)], 60.0)
    tables = lf.build(made, aimed=False).tables
    draw = np.random.default_rng(9)
    p = np.column_stack([draw.uniform(-5.0, 5.0, (300, 2)), np.full(300, -1.0)])
    d = np.column_stack([draw.uniform(-0.5, 0.5, (300, 2)), np.ones(300)])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    out = follow_sequence(tables, image_path(3), p, d)
    kept = out.weight > 0.0
    assert kept.sum() > 100
    # Parallel planes in air: what one lens leaves is what the next one meets.
    expected = (out.direction[kept, 2] / d[kept, 2]) ** 4
    np.testing.assert_allclose(etendue_factors(tables, p, d)[kept], expected, rtol=1e-12)


def test_a_zemax_file_holds_thin_lenses_and_a_codev_file_refuses_them(tmp_path: Any) -> None:
    lens = scene(
        [thin(80.0, 20.0), {"stop": True, "semi_diameter_mm": 6.0, "thickness_mm": 10.0}, thin(-60.25)], 50.0
    ).camera.lens
    write_lens_file(lens, tmp_path / "thin.zmx")
    again, _ = read_lens_file(tmp_path / "thin.zmx")
    assert again.surfaces == lens.surfaces
    with pytest.raises(LfmeshError, match=r"surfaces\[0\].paraxial: a CODE V file cannot hold a thin lens"):
        write_lens_file(lens, tmp_path / "thin.seq")
    assert not (tmp_path / "thin.seq").exists()


def test_a_drawing_shows_thin_lenses_with_arrow_heads() -> None:
    drawn = layout(scene([thin(80.0, 20.0, stop=True), thin(-90.0)], 0.0, focus_mm=500.0))
    assert [t.name for t in drawn.thin] == ["surface[0]", "surface[1]"]
    for t, inwards in zip(drawn.thin, (False, True), strict=True):
        line, *heads = t.lines
        assert np.ptp(line[:, 0]) == 0.0
        for head, end in zip(heads, line, strict=True):
            assert (head[1] == end).all()
            assert (np.abs(head[[0, 2], 1]) > abs(end[1])).all() == inwards


BAD: list[tuple[list[Any], str]] = [
    ([{"paraxial": True, "semi_diameter_mm": 5.0}], "focal_length_mm: missing"),
    ([{"focal_length_mm": 50.0, "semi_diameter_mm": 5.0}], "add paraxial = true"),
    ([thin(0.0)], "must be a number other than 0"),
    ([thin(1e-40)], "must lie between"),
    ([thin(float("nan"))], "focal_length_mm"),
    ([thin(50.0, radius_mm=20.0)], r"radius_mm = 20.*flat thin lens in air"),
    ([thin(50.0, conic=-1.0)], "conic = -1.*flat thin lens in air"),
    ([thin(50.0, asphere_mm=[1e-6])], "asphere_mm.*flat thin lens in air"),
    ([thin(50.0, 2.0, index=1.5), {"semi_diameter_mm": 5.0}], "index = 1.5.*flat thin lens in air"),
    ([thin(50.0, 2.0, glass="SCHOTT/N-BK7"), {"semi_diameter_mm": 5.0}], "glass.*flat thin lens in air"),
    ([thin(50.0, coating="ar")], "coating.*flat thin lens in air"),
    ([thin(50.0, finish="diffuse")], "finish.*flat thin lens in air"),
    ([{"thickness_mm": 2.0, "index": 1.5, "semi_diameter_mm": 5.0}, thin(50.0)], "a thin lens stands in air"),
]


@pytest.mark.parametrize(("surfaces", "message"), BAD)
def test_half_a_thin_lens_is_refused(surfaces: list[Any], message: str) -> None:
    with pytest.raises(LfmeshError, match=message):
        scene(surfaces, 50.0)


def test_polarised_light_is_refused() -> None:
    with pytest.raises(LfmeshError, match=r"surfaces\[0\].paraxial.*real interfaces only"):
        scene([thin(50.0)], 50.0, transport={"polarisation": True})
