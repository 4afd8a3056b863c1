"""Wavefronts: optical paths against 40 digits, perfect lenses, defocus, Strehl's ratio and Zernike's polynomials."""

import math
import warnings
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.optics.glass import refractive_index
from lfmesh.waves.bundle import LensRays, pupil_grid
from lfmesh.waves.zernike import ORDERS, fitted, zernike

Array = NDArray[np.float64]

DIGITS = 40
WAVE_NM = 546.07


def camera(surfaces: list[dict[str, Any]], focus_mm: float = math.inf, **lens: Any) -> lf.Scene:
    return lf.Scene.model_validate(
        {
            "schema_version": 1,
            "camera": {
                "focus_mm": focus_mm,
                "lens": {"surfaces": surfaces, **lens},
                "sensor": {"pixels": [8, 8], "pixel_mm": 0.01},
            },
        }
    )


def hyperbola() -> lf.Scene:
    """A plano-hyperbolic lens of index 1.5 with conic −1.5²: collimated light comes to a point, to all orders."""
    flat = {"radius_mm": math.inf, "thickness_mm": 6.0, "index": 1.5, "semi_diameter_mm": 11.0, "stop": True}
    surfaces = [flat, {"radius_mm": -25.0, "conic": -2.25, "semi_diameter_mm": 11.0}]
    return camera(surfaces, stop_semi_diameter_mm=10.0)


def exact_path(scene: lf.Scene, start: Array, direction: Array, point: Array, sphere: tuple[Array, float]) -> mp.mpf:
    """Return the optical path of a ray over spheres and planes to the reference sphere, with 40 digits."""
    lens = scene.camera.lens
    p, d = ([mp.mpf(float(x)) for x in v] for v in (start, direction))
    norm = mp.sqrt(mp.fsum(x * x for x in d))
    d = [x / norm for x in d]
    path = mp.sqrt(mp.fsum((a - mp.mpf(float(b))) ** 2 for a, b in zip(p, point, strict=True)))
    before = mp.mpf(1)
    for z, surface in zip(lens.vertices_mm, lens.surfaces, strict=True):
        if surface.stop and surface.index is None and surface.glass is None and math.isinf(surface.radius_mm):
            continue
        after = mp.mpf(refractive_index(surface.index or surface.glass or 1.0, WAVE_NM))
        c = mp.mpf(0) if math.isinf(surface.radius_mm) else 1 / mp.mpf(surface.radius_mm)
        q = [p[0], p[1], p[2] - mp.mpf(float(z))]
        a = c
        b = c * mp.fsum(x * y for x, y in zip(q, d, strict=True)) - d[2]
        e = c * mp.fsum(x * x for x in q) - 2 * q[2]
        t = e / (-b + mp.sqrt(b * b - a * e))
        p = [x + t * y for x, y in zip(p, d, strict=True)]
        path += before * t
        q = [x + t * y for x, y in zip(q, d, strict=True)]
        n = [-c * q[0], -c * q[1], 1 - c * q[2]]
        cosine = mp.fsum(x * y for x, y in zip(n, d, strict=True))
        ratio = before / after
        other = mp.sqrt(1 - ratio**2 * (1 - cosine**2))
        d = [ratio * x + (other - ratio * cosine) * y for x, y in zip(d, n, strict=True)]
        before = after
    off = [x - mp.mpf(float(y)) for x, y in zip(p, sphere[0], strict=True)]
    along = mp.fsum(x * y for x, y in zip(off, d, strict=True))
    return path - along - mp.sqrt(along**2 - mp.fsum(x * x for x in off) + mp.mpf(float(sphere[1])) ** 2)


@pytest.mark.parametrize(("focus_mm", "height_mm"), [(500.0, 0.0), (500.0, 30.0), (10_000.0, 600.0)])
@pytest.mark.parametrize("lens", ["double_gauss_50mm", "cooke_triplet_50mm", "tessar_50mm", "achromat_100mm"])
def test_optical_paths_agree_with_those_of_forty_digits(lens: str, focus_mm: float, height_mm: float) -> None:
    """To λ/10,000 at 0.5 and 10 m, the field included; the exact trace shares only the rays' starts."""
    scene = lf.solved(
        lf.Scene.model_validate(
            {
                "schema_version": 1,
                "camera": {
                    "focus_mm": focus_mm,
                    "lens": {"file": f"lib:{lens}", "f_number": 6.0},
                    "sensor": {"pixels": [8, 8], "pixel_mm": 0.01},
                },
            }
        ).in_folder(asset_path("scenes"))
    )
    found = lf.wavefront(scene, height_mm, WAVE_NM, across=8)
    rays = LensRays(lf.build(scene), lf.first_order(scene).object_distance_mm, lf.first_order(scene).image_z_mm)
    pupil = np.vstack([np.zeros(2), pupil_grid(8)])
    bundle = rays.bundle(found.slope, pupil, WAVE_NM)
    point = np.array([0.0, height_mm, -rays.object_mm])
    position, direction = rays.starts(np.broadcast_to([0.0, found.slope], bundle.entry.shape), bundle.entry)
    sphere = found.image_mm, found.radius_mm
    with mp.workdps(DIGITS):
        paths = [exact_path(scene, *each, point, sphere) for each in zip(position, direction, strict=True)]
        opd = np.array([float((paths[0] - path) * 1e6 / WAVE_NM) for path in paths[1:]])
    assert len(found.opd_waves) == len(opd)
    assert np.abs(found.opd_waves - opd).max() < 1e-4
    assert np.ptp(opd) > 0.05


def test_a_perfect_lens_has_no_aberration() -> None:
    found = lf.wavefront(hyperbola())
    assert found.pv_waves < 1e-9
    assert found.strehl == pytest.approx(1.0, abs=1e-12)
    assert found.passed == 1.0


@pytest.mark.parametrize("shift_mm", [-0.01, 0.003, 0.01])
def test_defocus_is_the_depth_of_the_cone(shift_mm: float) -> None:
    """A point δ behind the focus: δ (1 − cos θ)/λ over the cone, in the order of δ; for 0.003 mm Maréchal's Strehl."""
    scene = hyperbola()
    focus = lf.wavefront(scene)
    found = lf.wavefront(scene, image_z_mm=focus.image_mm[2] + shift_mm)
    # At the rim, 10 mm from the axis: the lens' sag there, and the distance to the focus 2 R behind the vertex.
    radius, conic, height = 25.0, -2.25, 10.0 * np.sqrt((found.pupil**2).sum(axis=1).max())
    sag = -(height**2) / radius / (1.0 + math.sqrt(1.0 - (1.0 + conic) * (height / radius) ** 2))
    angle = math.atan(height / (2.0 * radius - sag))
    assert found.pv_waves == pytest.approx(abs(shift_mm) * (1.0 - math.cos(angle)) * 1e6 / 587.6, rel=5e-3)
    assert found.zernike(4)[3] * shift_mm > 0.0
    if abs(shift_mm) == 0.003:
        marechal = math.exp(-((2.0 * math.pi * found.rms_waves) ** 2))
        assert found.strehl > 0.8
        assert found.strehl == pytest.approx(marechal, abs=0.01)


def test_the_reference_spheres_radius_and_a_plane_wave_from_afar_matter_little() -> None:
    scene = lf.load(asset_path("scenes/first_light.toml")).changed({"camera.focus_mm": math.inf})
    far = lf.wavefront(scene, 0.05)
    near = lf.wavefront(scene, 0.05 * 1e8, object_mm=1e8)
    assert np.abs(far.opd_waves - near.opd_waves).max() < 1e-3
    assert np.ptp(far.opd_waves) > 0.3


@pytest.mark.parametrize("order", ["fringe", "noll"])
def test_a_fit_gives_back_the_coefficients_of_zernikes_polynomials(order: str) -> None:
    x, y = pupil_grid(40).T
    wanted = np.random.default_rng(5).normal(size=20)
    values = sum(
        c * zernike(ORDERS[order](j), x, y, orthonormal=order == "noll") for j, c in enumerate(wanted, start=1)
    )
    assert fitted(np.column_stack([x, y]), np.asarray(values), 20, order) == pytest.approx(wanted, abs=1e-10)


def test_polynomials_are_those_of_the_literature() -> None:
    """Noll 1976, table 1, and Wyant and Creath 1992, table III: names, norms and signs of a few of each."""
    x, y = np.array([0.6]), np.array([0.3])
    r, t = math.hypot(0.6, 0.3), math.atan2(0.3, 0.6)
    noll = {2: 2 * r * math.cos(t), 3: 2 * r * math.sin(t), 4: math.sqrt(3) * (2 * r**2 - 1),
            5: math.sqrt(6) * r**2 * math.sin(2 * t), 6: math.sqrt(6) * r**2 * math.cos(2 * t),
            7: math.sqrt(8) * (3 * r**3 - 2 * r) * math.sin(t), 8: math.sqrt(8) * (3 * r**3 - 2 * r) * math.cos(t),
            9: math.sqrt(8) * r**3 * math.sin(3 * t), 11: math.sqrt(5) * (6 * r**4 - 6 * r**2 + 1),
            12: math.sqrt(10) * (4 * r**4 - 3 * r**2) * math.cos(2 * t)}  # fmt: skip
    fringe = {2: r * math.cos(t), 4: 2 * r**2 - 1, 5: r**2 * math.cos(2 * t), 6: r**2 * math.sin(2 * t),
              7: (3 * r**3 - 2 * r) * math.cos(t), 9: 6 * r**4 - 6 * r**2 + 1, 10: r**3 * math.cos(3 * t),
              12: (4 * r**4 - 3 * r**2) * math.cos(2 * t), 16: 20 * r**6 - 30 * r**4 + 12 * r**2 - 1,
              37: 924 * r**12 - 2772 * r**10 + 3150 * r**8 - 1680 * r**6 + 420 * r**4 - 42 * r**2 + 1}  # fmt: skip
    for order, known in (("noll", noll), ("fringe", fringe)):
        for j, value in known.items():
            assert zernike(ORDERS[order](j), x, y, orthonormal=order == "noll")[0] == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"across": 3}, "across = 3"),
        ({"wavelength_nm": -1.0}, "wavelength_nm = -1"),
        ({"height_mm": math.nan}, "height_mm = nan"),
        ({"object_mm": -5.0}, "object_mm = -5.0: must be above 0"),
        ({"height_mm": 4000.0}, "the chief ray of this field is blocked"),
        ({"image_z_mm": 14.3}, "rays miss the reference sphere"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(changes: dict[str, Any], message: str) -> None:
    scene = lf.load(asset_path("scenes/first_light.toml"))
    with pytest.raises(lf.LfmeshError, match=message) as caught:
        lf.wavefront(scene, **changes)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("height", [0.25, 0.26])
def test_a_symmetric_lens_has_the_same_wave_on_both_sides_of_the_axis(height: float) -> None:
    """The aperture of a plate 20 mm behind the stop takes half of the light: its rim lies on, or before, chief rays."""
    stop = {"stop": True, "semi_diameter_mm": 3.0, "thickness_mm": 20.0}
    plate = {"radius_mm": math.inf, "thickness_mm": 4.0, "index": 1.5, "semi_diameter_mm": 5.0}
    scene = camera([stop, plate, {"radius_mm": -50.0, "semi_diameter_mm": 30.0}])
    above, below = (lf.wavefront(scene, sign * height, object_mm=math.inf) for sign in (1.0, -1.0))
    assert 0.3 < above.passed < 0.6
    # A row of points lies as near to the aperture as rays are aimed.
    assert below.passed == pytest.approx(above.passed, abs=64 / 3228)
    assert below.rms_waves == pytest.approx(above.rms_waves, rel=1e-2)


def test_a_plane_in_the_exit_pupil_is_refused_without_a_warning_of_numpy() -> None:
    thin = camera([{"paraxial": True, "focal_length_mm": 50.0, "semi_diameter_mm": 5.0, "stop": True}], focus_mm=500.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(lf.LfmeshError, match=r"image_z_mm = 0.*rays miss the reference sphere"):
            lf.wavefront(thin, 20.0, image_z_mm=0.0)


def test_an_ideal_lens_is_perfect_at_its_image_and_defocused_beside_it() -> None:
    """Beside its image by δ: δ (1 − cos u) at the rim of a cone of half angle u."""
    thin = camera([{"paraxial": True, "focal_length_mm": 50.0, "semi_diameter_mm": 5.0, "stop": True}], focus_mm=500.0)
    assert lf.wavefront(thin, 20.0).pv_waves < 1e-9
    image, shift = 1.0 / (1.0 / 50.0 - 1.0 / 500.0), 0.01
    found = lf.wavefront(thin, image_z_mm=image + shift)
    height = 5.0 * np.sqrt((found.pupil**2).sum(axis=1).max())
    wanted = shift * (1.0 - math.cos(math.atan(height / image))) * 1e6 / found.wavelength_nm
    assert found.pv_waves == pytest.approx(wanted, rel=1e-3)


@pytest.mark.parametrize("height_mm", [0.0, 0.1, 5.0])
def test_light_that_an_ideal_lens_collimates_is_out_of_focus_on_its_image_plane(height_mm: float) -> None:
    """A plane wave differs from the sphere about the image by the sphere's sag; the wave of a point beside is alike."""
    thin = camera([{"paraxial": True, "focal_length_mm": 50.0, "semi_diameter_mm": 1.5, "stop": True}], focus_mm=500.0)
    found = lf.wavefront(thin, height_mm, object_mm=50.0)
    beside = lf.wavefront(thin, height_mm, object_mm=50.001)
    assert found.rms_waves == pytest.approx(beside.rms_waves, rel=1e-3)
    if height_mm == 0.0:
        image = 1.0 / (1.0 / 50.0 - 1.0 / 500.0)
        rim2, centre2 = (1.5**2 * extreme((found.pupil**2).sum(axis=1)) for extreme in (np.max, np.min))
        wanted = (math.sqrt(image**2 - centre2) - math.sqrt(image**2 - rim2)) * 1e6 / found.wavelength_nm
        assert found.pv_waves == pytest.approx(wanted, rel=1e-3)


def test_ideal_lenses_beside_real_ones_and_orders_that_there_are_not_are_refused() -> None:
    ideal = {"paraxial": True, "focal_length_mm": 50.0, "semi_diameter_mm": 5.0, "stop": True, "thickness_mm": 1.0}
    flat = {"radius_mm": math.inf, "semi_diameter_mm": 9.0}
    mixed = camera([ideal, flat | {"thickness_mm": 1.0, "index": 1.5}, flat], focus_mm=500.0)
    with pytest.raises(lf.LfmeshError, match=r"surfaces\[0\] is an ideal lens among real surfaces"):
        lf.wavefront(mixed)
    found = lf.wavefront(hyperbola(), across=8)
    with pytest.raises(lf.LfmeshError, match="terms = 38"):
        found.zernike(38)
    with pytest.raises(lf.LfmeshError, match="order = 'born'"):
        found.zernike(4, "born")  # type: ignore[arg-type]


@pytest.mark.filterwarnings("error")
def test_rays_that_miss_the_reference_sphere_are_refused_without_a_warning_before() -> None:
    scene = lf.load(asset_path("scenes/first_light.toml"))
    with pytest.raises(lf.LfmeshError, match="rays miss the reference sphere"):
        lf.wavefront(scene, image_z_mm=14.3)


@pytest.mark.parametrize("slope", [0.0, 0.02])
def test_waves_of_far_points_come_closer_to_those_of_infinity_as_one_over_the_distance(slope: float) -> None:
    """By h² / 2L over the stop of 1.5 mm to the second order, at all distances, and with no noise beside it."""
    camera = {
        "focus_mm": math.inf,
        "lens": {"surfaces": [
            {"radius_mm": math.inf, "thickness_mm": 5.0, "index": 1.5, "semi_diameter_mm": 1.5, "stop": True},
            {"radius_mm": -25.0, "semi_diameter_mm": 6.0},
        ]},
        "sensor": {"pixels": [32, 32], "pixel_mm": 0.002},
    }  # fmt: skip
    given = lf.Scene.model_validate({"schema_version": 1, "camera": camera})
    infinite = lf.wavefront(given, slope, 550.0)
    for distance in 10.0 ** np.arange(6, 16):
        found = lf.wavefront(given, slope * distance, 550.0, object_mm=distance)
        off = np.abs(found.opd_waves - infinite.opd_waves).max()
        assert off == pytest.approx(1.5**2 / 2.0 / distance / 550e-6, rel=0.01, abs=1e-9)
    near, far = (lf.point_spread(given, (0.01 * slope * z, 0.0, -z), 550.0, window=8) for z in (1e8, 1e15))
    np.testing.assert_allclose(far.mean * 1e14, near.mean, rtol=0.01)


@pytest.mark.parametrize("terms", ["a", 2.5, None, True])
def test_terms_that_do_not_count_are_refused(terms: Any) -> None:
    given = lf.load(asset_path("scenes/first_light.toml"))
    with pytest.raises(lf.LfmeshError, match=r"terms = .*: must be a whole number"):
        lf.wavefront(given, across=8).zernike(terms)


GAS = {
    "name": "gas",
    "bounds": {"kind": "box", "size_mm": [9.0, 9.0, 9.0]},
    "index": 1.0002,
    "position_mm": [0, 0, -80],
}


@pytest.mark.parametrize(
    "use",
    [
        lf.wavefront,
        lambda scene: lf.point_spread(scene, (0.0, 0.0, -300.0)),
        lf.camera_model,
        lambda scene: lf.fit_boards(np.ones((8, 8)), scene, [lf.Board(np.ones((8, 8)), square_mm=5.0)]),
    ],
)
def test_media_that_bend_light_are_refused(use: Any) -> None:
    scene = lf.load(asset_path("scenes/first_light.toml")).changed({"media": [GAS]})
    with pytest.raises(lf.LfmeshError, match=r"media\[0\] \(gas\) bends light: .*omit it") as refusal:
        use(scene)
    assert len(str(refusal.value).splitlines()) == 1
