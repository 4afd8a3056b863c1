"""What a layout drawing shows: real rays through the stop's middle and rim, true profiles, bodies where they stand."""

import functools
import math

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.optics.glass import refractive_index
from lfmesh.scene import load_lens
from lfmesh.view.layout.content import Layout, layout
from lfmesh.view.rays.aimed_rays import Aim

LENSES = sorted(path.stem for path in asset_path("lenses").glob("*.toml"))

# Stopped down so far that the whole field passes: marginal rays then touch the stop's rim and nothing before it.
STOP_MM = {"double_gauss_50mm": 4.77, "plano_convex_25mm": 4.0, "ball_10mm": 1.0, "asphere_100mm": 15.0}


def camera(lens: str, stop_mm: float | None = None, **more) -> lf.Scene:
    """A camera with 16 × 12 lenslets behind a lens, focused on eight focal lengths."""
    focal_length = float(lens.rpartition("_")[2].removesuffix("mm"))
    stop = {} if stop_mm is None else {"stop_semi_diameter_mm": stop_mm}
    scene = lf.Scene(
        camera={
            "focus_mm": 8.0 * focal_length,
            "lens": {"file": str(asset_path(f"lenses/{lens}.toml")), **stop},
            "mla": {
                "count": (16, 12), "pitch_mm": 0.125, "focal_length_mm": 0.5, "index": 1.5, "thickness_mm": 0.3,
            },
            "sensor": {"pixels": (160, 120), "pixel_mm": 0.0125},
        }
    )  # fmt: skip
    return scene.changed(more) if more else scene


@functools.cache
def stopped_down(lens: str) -> Layout:
    return layout(camera(lens, STOP_MM.get(lens)))


def prescription(lens: str):
    return load_lens(asset_path(f"lenses/{lens}.toml"))


def has_gradient(lens: str) -> bool:
    return any(surface.gradient is not None for surface in prescription(lens).surfaces)


def sag(surface, y):
    """ISO 10110-12, as it is printed."""
    c = 0.0 if math.isinf(surface.radius_mm) else 1.0 / surface.radius_mm
    z = c * y**2 / (1.0 + np.sqrt(1.0 - (1.0 + surface.conic) * c**2 * y**2))
    return z + sum(a * y ** (4 + 2 * i) for i, a in enumerate(surface.asphere_mm))


def crossing_of_stop(points: np.ndarray, lens: str) -> np.ndarray:
    """Where a drawn path through every surface crosses the stop: x, y."""
    surfaces = prescription(lens).surfaces
    number = next(i for i, s in enumerate(surfaces) if s.stop)
    if surfaces[number].radius_mm != math.inf:
        return points[1 + number, :2]
    z = sum(s.thickness_mm for s in surfaces[:number])
    p, q = points[number], points[number + 1]
    assert p[2] < z < q[2]
    return p[:2] + (z - p[2]) / (q[2] - p[2]) * (q[:2] - p[:2])


@pytest.mark.parametrize("lens", LENSES)
def test_chief_rays_cross_the_axis_at_the_stop_and_marginal_rays_touch_its_rim(lens):
    drawn = stopped_down(lens)
    rim = STOP_MM.get(lens) or next(s for s in prescription(lens).surfaces if s.stop).semi_diameter_mm
    assert [bundle.name for bundle in drawn.bundles] == ["axis", "0.7 field", "full field"]
    for bundle in drawn.bundles:
        lower, chief, upper = (crossing_of_stop(ray.points, lens) for ray in bundle.rays)
        np.testing.assert_allclose(chief, 0.0, atol=1e-6)
        np.testing.assert_allclose(lower, [0.0, -rim], atol=1e-6)
        np.testing.assert_allclose(upper, [0.0, rim], atol=1e-6)


# Rays are drawn through gradient-index glass as curves, see `view/rays/test_gradient_segments.py`.
@pytest.mark.parametrize("lens", [lens for lens in LENSES if not has_gradient(lens)])
def test_drawn_rays_obey_the_law_of_refraction_at_the_surfaces_of_the_prescription(lens):
    surfaces = prescription(lens).surfaces
    z = np.cumsum([0.0, *(s.thickness_mm for s in surfaces[:-1])])
    glass = [(z0, s) for z0, s in zip(z, surfaces, strict=True) if not (s.stop and s.radius_mm == math.inf)]
    for bundle in stopped_down(lens).bundles:
        for ray in bundle.rays:
            before = 1.0
            for k, (vertex, surface) in enumerate(glass):
                p = ray.points[1 + k]
                assert p[2] == pytest.approx(vertex + sag(surface, math.hypot(p[0], p[1])), abs=1e-9)
                step = 1e-6
                slope = (sag(surface, p[1] + step) - sag(surface, p[1] - step)) / (2.0 * step)
                normal = np.array([0.0, -slope, 1.0]) / math.hypot(1.0, slope)
                after = refractive_index(surface.medium, 587.6)
                into, out = (np.diff(ray.points[k + i : k + i + 2], axis=0)[0] for i in (0, 1))
                sines = [np.cross(d / np.linalg.norm(d), normal)[0] for d in (into, out)]
                # The way out is that of the next vertex, in the array or on it: only the lens counts.
                assert before * sines[0] == pytest.approx(after * sines[1], abs=1e-8)
                before = after


@pytest.mark.parametrize("lens", LENSES)
def test_drawn_profiles_are_the_sag_of_the_prescription_out_to_its_clear_aperture(lens):
    drawn, surfaces = stopped_down(lens), prescription(lens).surfaces
    z = np.cumsum([0.0, *(s.thickness_mm for s in surfaces[:-1])])
    # The medium behind the last surface reaches to the sensor.
    before_glass = [i for i, s in enumerate(surfaces[:-1]) if s.medium is not None]
    assert len(drawn.glass) == len(before_glass)
    for glass, i in zip(drawn.glass, before_glass, strict=True):
        for profile, number in ((glass.front, i), (glass.back, i + 1)):
            y = profile[:, 1]
            np.testing.assert_allclose(profile[:, 0], z[number] + sag(surfaces[number], y), atol=1e-12)
            reach = surfaces[number].semi_diameter_mm
            if surfaces[number].stop:
                reach = STOP_MM.get(lens, reach)
            assert y[0] == -y[-1]
            assert reach <= y[-1] <= 1.1 * reach
            assert np.diff(y).max() < 0.03 * reach


def test_cemented_elements_share_a_face_and_no_outline_runs_through_another_element():
    first, second = stopped_down("achromat_100mm").glass
    np.testing.assert_array_equal(first.back, second.front)
    assert first.front[:, 0].max() < first.back[:, 0].max()
    for glass in stopped_down("double_gauss_50mm").glass:
        between = np.interp(glass.outline[:, 1], glass.front[:, 1], glass.front[:, 0])
        assert (glass.outline[:, 0] >= between - 1e-3).all()


@pytest.mark.parametrize("lens", LENSES)
def test_outlines_enclose_the_glass_between_the_profiles(lens):
    for glass in stopped_down(lens).glass:
        z, y = glass.outline.T
        enclosed = 0.5 * abs(np.sum(z * np.roll(y, -1) - np.roll(z, -1) * y))
        reach = min(glass.front[-1, 1], glass.back[-1, 1])
        height = np.linspace(-reach, reach, 4001)
        thickness = np.interp(height, *glass.back.T[::-1]) - np.interp(height, *glass.front.T[::-1])
        between = float(np.mean(thickness)) * 2.0 * reach
        # Beyond the lower of two rims there is only what stands out of the taller one.
        beyond = np.ptp(z) * 2.0 * (y.max() - reach)
        assert 0.999 * between <= enclosed <= 1.001 * between + beyond


@pytest.mark.parametrize("lens", ["double_gauss_50mm", "cooke_triplet_50mm", "achromat_100mm"])
def test_rays_of_the_axis_meet_at_the_paraxial_image_as_the_square_of_their_aperture(lens):
    scene = camera(lens, STOP_MM.get(lens))
    facts = lf.first_order(scene)
    aim = Aim(lf.build(scene), facts.object_distance_mm)
    apertures = np.array([0.02, 0.04, 0.08])
    rays = aim.through(np.zeros((3, 2)), np.column_stack([np.zeros(3), apertures]))
    missed = []
    for ray in rays:
        position, direction = ray.leaving
        missed.append(position[2] - position[1] * direction[2] / direction[1] - facts.image_z_mm)
    order = np.diff(np.log(np.abs(missed))) / np.log(2.0)
    np.testing.assert_allclose(order, 2.0, atol=0.1)
    # So small a share of the aperture's defocus that only an error of the aim or the focus could hide it.
    assert abs(missed[0]) < 1e-3 * facts.efl_mm


@pytest.mark.parametrize("lens", LENSES)
def test_chief_rays_come_out_at_the_shares_of_the_outermost_lenslet(lens):
    drawn = stopped_down(lens)
    outermost = 5.5 * 0.125
    for bundle, share in zip(drawn.bundles, (0.0, 0.7, 1.0), strict=True):
        p, q = bundle.rays[1].leaving
        y = p[1] + (drawn.facts.image_z_mm - p[2]) / q[2] * q[1]
        assert y == pytest.approx(-share * outermost, abs=1e-9)


def test_chief_rays_of_a_wide_field_come_out_at_the_outermost_pixel_in_spite_of_distortion():
    scene = camera("double_gauss_50mm", 4.77, **{"camera.mla": None, "camera.sensor.pixels": (2400, 2400)})
    drawn = layout(scene)
    outermost = 0.5 * 2399 * 0.0125
    for bundle, share in zip(drawn.bundles, (0.0, 0.7, 1.0), strict=True):
        assert bundle.rays[1].points[-1, 1] == pytest.approx(-share * outermost, abs=1e-9)
    paraxial = outermost / abs(drawn.facts.magnification)
    assert abs(drawn.bundles[-1].slope * drawn.distance_mm / paraxial - 1.0) > 0.005


def test_rays_start_at_points_of_the_plane_in_focus():
    drawn = stopped_down("double_gauss_50mm")
    assert drawn.distance_mm == pytest.approx(400.0)
    for bundle in drawn.bundles:
        start = np.array([ray.points[0] for ray in bundle.rays])
        np.testing.assert_allclose(start, [[0.0, bundle.slope * 400.0, -400.0]] * 3, atol=1e-9)


def test_rays_from_infinity_are_collimated():
    scene = camera("double_gauss_50mm", 4.77, **{"camera.focus_mm": 1e9})
    drawn = layout(scene)
    assert math.isinf(drawn.distance_mm)
    for bundle in drawn.bundles:
        slopes = [(ray.points[1] - ray.points[0]) for ray in bundle.rays]
        np.testing.assert_allclose([s[1] / s[2] for s in slopes], -bundle.slope, atol=1e-12)


@pytest.mark.parametrize(("focus_mm", "pixels"), [(400.0, 2400), (1e9, 2400), (1e9, 640)])
def test_vignetted_rays_end_outside_the_clear_aperture_that_stops_them(focus_mm, pixels):
    change = {"camera.mla": None, "camera.sensor.pixels": (pixels, pixels), "camera.focus_mm": focus_mm}
    drawn = layout(camera("double_gauss_50mm", **change))
    surfaces = prescription("double_gauss_50mm").surfaces
    z = np.cumsum([0.0, *(s.thickness_mm for s in surfaces[:-1])])
    stopped = [ray for bundle in drawn.bundles for ray in bundle.rays if ray.status != lf.Status.SENSOR]
    assert len(stopped) >= 3
    for ray in stopped:
        end, y = ray.points[-1], abs(ray.points[-1, 1])
        if len(ray.points) == 2:
            # It misses the first surface: the barrel is not what stops it.
            assert end[2] <= sag(surfaces[0], 1.04 * 12.6)
        assert end[2] < z[-1]
        places = [z[i] + sag(s, min(y, s.semi_diameter_mm)) for i, s in enumerate(surfaces)]
        nearest = int(np.argmin(np.abs(np.array(places) - end[2])))
        assert y > surfaces[nearest].semi_diameter_mm


def test_a_focused_camera_sends_its_rays_from_the_plane_that_its_lenslets_image_onto_the_sensor():
    scene = lf.load(asset_path("scenes/focused.toml"))
    drawn = layout(scene)
    # The scene's own figures: 1.5 mm before the lenslets lies the image of 500 mm.
    assert drawn.distance_mm == pytest.approx(500.0, rel=1e-5)
    (bundle,) = drawn.detail.bundles
    heights = []
    for ray in bundle.rays:
        position, direction = ray.leaving
        heights.append(position[1] + (75.0087 - 1.5 - position[2]) / direction[2] * direction[1])
    # Before the lenslets the rays are within a tenth of a lenslet of each other; on them they cover three.
    assert np.ptp(heights) < 0.3 * 0.125
    at_lenslets = [ray.beyond_lens(75.0087)[1] for ray in bundle.rays]
    assert 2.0 < np.ptp(at_lenslets) / 0.125 < 4.0


@pytest.mark.parametrize("curved_side", ["lens", "sensor"])
def test_rays_of_a_lenslet_cross_at_its_apex_and_span_the_micro_image_of_first_order_optics(curved_side):
    scene = camera("double_gauss_50mm", 4.77, **{"camera.mla.curved_side": curved_side})
    drawn = layout(scene)
    solved = drawn.scene.camera
    face = solved.lens.vertices_mm[-1] + solved.mla.distance_mm
    apex_z = face if curved_side == "lens" else face + 0.3
    assert [len(bundle.rays) for bundle in drawn.detail.bundles] == [5, 5, 5]
    for bundle, y in zip(drawn.detail.bundles, (-0.0625, 0.0625, 0.1875), strict=True):
        for ray in bundle.rays:
            points = ray.points[np.argsort(np.abs(ray.points[:, 2] - apex_z))]
            # Through the plate the apexes are seen as paraxial rays see them; steeper ones pass a little beside.
            slope = math.atan(ray.leaving[1, 1] / ray.leaving[1, 2])
            beside = 0.3 * (math.tan(slope) / 1.5 - math.tan(math.asin(math.sin(slope) / 1.5)))
            beside *= curved_side == "sensor"
            np.testing.assert_allclose(points[0], [0.0625, y - beside, apex_z], atol=5e-6)
    landing = [ray.points[-1, 1] for ray in drawn.detail.bundles[1].rays]
    pixels = np.ptp(landing) / 0.0125
    assert pixels == pytest.approx(drawn.facts.micro_image_diameter_px, rel=0.02)


@pytest.mark.parametrize("curved_side", ["lens", "sensor"])
def test_distances_of_the_plate_are_those_of_the_scene_whichever_side_is_curved(curved_side):
    drawn = layout(camera("double_gauss_50mm", 4.77, **{"camera.mla.curved_side": curved_side}))
    solved = drawn.scene.camera
    face = solved.lens.vertices_mm[-1] + solved.mla.distance_mm
    back, sensor = face + 0.3, face + 0.3 + solved.sensor.distance_mm
    # The rear principal plane of a plano-convex lenslet lies at its apex, or t / n before the flat face.
    principal = back if curved_side == "sensor" else back - 0.3 / 1.5
    ends = [(line.start[0], line.end[0]) for line in drawn.detail.lengths]
    np.testing.assert_allclose(ends, [(face, back), (back, sensor), (principal, principal + 0.5)], atol=1e-9)
    told = [line.text for line in drawn.detail.lengths]
    assert told == ["0.3 mm", f"{solved.sensor.distance_mm:.4g} mm", "f = 0.5 mm"]


def test_the_section_of_the_lenslets_is_that_of_their_spheres():
    for name in ("first_light", "hexagonal"):
        drawn = layout(lf.load(asset_path(f"scenes/{name}.toml")))
        mla = drawn.scene.camera.mla
        apex_z = drawn.scene.camera.lens.vertices_mm[-1] + mla.distance_mm
        face = drawn.detail.plate[:-2]
        row = mla.row_pitch_mm
        number = np.round(face[:, 1] / row + 0.5 * (mla.count[1] - 1)).astype(int)
        y = face[:, 1] - (number - 0.5 * (mla.count[1] - 1)) * row
        if mla.layout == "square":
            x, radius = np.zeros_like(y), np.full_like(y, mla.radius_mm[0])
            inside = np.ones(len(y), bool)
        else:
            # Rows of a hexagonal array are cut through the middle and beside it in turn; near the rows' middles the
            # cells are the rows' own.
            own = number % 2 == number[len(number) // 2] % 2
            x = np.where(own, 0.0, 0.5 * mla.pitch_mm)
            inside = own & (np.abs(y) < 0.4 * row)
            depth = face[:, 0] - apex_z
            radius = np.array(mla.radius_mm)[
                np.argmin([np.abs(r - np.sqrt(r**2 - y**2) - depth) for r in mla.radius_mm], axis=0)
            ]
        r2 = (x**2 + y**2)[inside]
        sphere = radius[inside] - np.sqrt(radius[inside] ** 2 - r2)
        np.testing.assert_allclose(face[inside, 0], apex_z + sphere, atol=1e-12)


def test_tilted_and_shifted_array_and_sensor_are_drawn_where_they_stand():
    pose = {"tilt_deg": (6.0, 0.0, 0.0), "shift_mm": (0.0, 0.3, -0.1)}
    scene = camera("double_gauss_50mm", 4.77, **{"camera.mla.pose": pose, "camera.sensor.pose": pose})
    drawn = layout(scene)
    mla, sensor = drawn.scene.camera.mla, drawn.scene.camera.sensor
    z = drawn.scene.camera.lens.vertices_mm[-1] + mla.distance_mm
    turn = np.deg2rad(6.0)
    # About x: y turns towards z.
    along, into = np.array([np.sin(turn), np.cos(turn)]), np.array([np.cos(turn), -np.sin(turn)])
    middle = np.array([z - 0.1, 0.3])
    half = 0.5 * 12 * 0.125
    corners = [middle - half * along, middle + half * along]
    corners += [corner + 0.3 * into for corner in corners[::-1]]
    np.testing.assert_allclose(drawn.mla, corners, atol=1e-12)
    at = np.array([z + 0.3 + sensor.distance_mm - 0.1, 0.3])
    np.testing.assert_allclose(drawn.sensor, [at - 0.75 * along, at + 0.75 * along], atol=1e-12)
    ray = drawn.detail.bundles[1].rays[2]
    on_sensor = ray.points[-1, [2, 1]] - at
    assert on_sensor[0] * into[0] + on_sensor[1] * into[1] == pytest.approx(0.0, abs=1e-9)


def test_tilted_and_decentred_elements_are_drawn_where_they_stand():
    """A turn about x and a shift along y keep the axis of an element in the plane of the drawing."""
    degrees, shift = 4.0, np.array([0.2, 0.5])
    pose = {"tilt_deg": (degrees, 0.0, 0.0), "shift_mm": (0.0, shift[1], shift[0])}
    elements = [{"surfaces": (6, 7, 8, 9, 10), "pose": pose}, {"surfaces": (5,), "pose": {"shift_mm": (0.0, 0.3, 0.0)}}]
    drawn = layout(camera("double_gauss_50mm", 3.0, **{"camera.lens.elements": elements}))
    surfaces = prescription("double_gauss_50mm").surfaces
    z = np.cumsum([0.0, *(s.thickness_mm for s in surfaces[:-1])])
    turn = np.deg2rad(degrees)
    before_glass = [i for i, s in enumerate(surfaces) if s.medium is not None]
    for glass, i in zip(drawn.glass, before_glass, strict=True):
        for profile, number in ((glass.front, i), (glass.back, i + 1)):
            along, y = profile[:, 0] - z[6], profile[:, 1]
            if number >= 6:
                # About x: y turns towards z.
                along, y = along - shift[0], y - shift[1]
                along, y = np.cos(turn) * along - np.sin(turn) * y, np.sin(turn) * along + np.cos(turn) * y
            inside = abs(y) <= surfaces[number].semi_diameter_mm
            off = along + z[6] - z[number] - sag(surfaces[number], np.where(inside, y, 0.0))
            # Posed surfaces are drawn by the chords of a fine mesh.
            np.testing.assert_allclose(off[inside], 0.0, atol=2e-3 if number >= 6 else 1e-12)
            assert np.ptp(y) > 1.99 * surfaces[number].semi_diameter_mm
    for bundle in drawn.bundles:
        lower, chief, upper = (crossing_of_stop(ray.points, "double_gauss_50mm") for ray in bundle.rays)
        np.testing.assert_allclose(chief, [0.0, 0.3], atol=1e-6)
        np.testing.assert_allclose([lower, upper], [[0.0, -2.7], [0.0, 3.3]], atol=1e-6)


@pytest.mark.parametrize("part", ["camera.mla", "camera.sensor"])
def test_what_the_plane_of_the_drawing_does_not_meet_is_a_clear_error(part):
    scene = camera("double_gauss_50mm", 4.77, **{f"{part}.pose": {"shift_mm": (5.0, 0.0, 0.0)}})
    with pytest.raises(lf.LfmeshError, match=rf"{part}\.pose: the plane of the drawing, x = .* does not meet it"):
        layout(scene)


def test_targets_that_cross_the_meridional_plane_are_cut_by_it(tmp_path):
    import trimesh

    trimesh.creation.icosphere(subdivisions=3, radius=5.0).export(tmp_path / "ball.stl")
    scene = camera(
        "double_gauss_50mm", 4.77, targets=[
                {"name": "ball", "shape": {"kind": "sphere", "radius_mm": 8.0}, "position_mm": (3.0, 20.0, -300.0)},
                {"name": "card", "shape": {"kind": "plane", "width_mm": 9.0, "height_mm": 7.0},
                 "position_mm": (0.0, 0.0, -350.0)},
                {"name": "aside", "shape": {"kind": "sphere", "radius_mm": 8.0}, "position_mm": (9.0, 0.0, -300.0)},
                {"name": "glass", "position_mm": (0.0, 60.0, -200.0),
                 "refractor": {"file": str(tmp_path / "ball.stl"), "units": "mm", "index": 1.5}},
            ]
    )  # fmt: skip
    ball, card, glass = layout(scene).targets
    assert (ball.name, card.name, glass.name) == ("ball", "card", "glass")
    assert (ball.closed, card.closed, glass.closed) == (True, False, True)
    assert (ball.glass, card.glass, glass.glass) == (False, False, True)
    (line,) = ball.lines
    radius = np.hypot(line[:, 0] + 300.0, line[:, 1] - 20.0)
    np.testing.assert_allclose(radius, math.sqrt(8.0**2 - 3.0**2), rtol=0.02)
    np.testing.assert_allclose(line[0], line[-1], atol=1e-9)
    (line,) = card.lines
    assert sorted([line[:, 1].min(), line[:, 1].max()]) == pytest.approx([-3.5, 3.5])
    np.testing.assert_allclose(line[:, 0], -350.0)
    (line,) = glass.lines
    assert np.hypot(line[:, 0] + 200.0, line[:, 1] - 60.0).max() == pytest.approx(5.0, rel=1e-3)


def test_opaque_targets_do_not_end_the_rays_of_the_drawing_and_the_camera_is_drawn_in_its_own_frame():
    scene = lf.load(asset_path("scenes/first_light.toml"))
    blocked = scene.changed(
        {"targets": [{"shape": {"kind": "plane", "width_mm": 50.0, "height_mm": 50.0}, "position_mm": (0, 0, -100)}]}
    )
    moved = blocked.changed(
        {"targets": [], "camera.pose": {"tilt_deg": (10.0, 20.0, 30.0), "shift_mm": (5.0, 6.0, 7.0)}}
    )
    here, there = layout(blocked), layout(moved)
    for a, b in zip(here.bundles, there.bundles, strict=True):
        for ray, same in zip(a.rays, b.rays, strict=True):
            n = min(len(ray.points), len(same.points)) - 3
            np.testing.assert_allclose(ray.points[:n], same.points[:n], atol=1e-8)
            assert len(ray.points) > 12


def test_targets_stand_where_the_camera_sees_them():
    card = {"shape": {"kind": "plane", "width_mm": 9.0, "height_mm": 8.0}, "position_mm": (0.0, 0.0, -300.0)}
    pose = {"tilt_deg": (0.0, 0.0, 180.0), "shift_mm": (0.0, 5.0, 20.0)}
    scene = camera("double_gauss_50mm", 4.77, targets=[card], **{"camera.pose": pose})
    ((line,),) = (target.lines for target in layout(scene).targets)
    # From a camera that stands on its head, 5 mm higher and 20 mm farther back.
    assert sorted([line[:, 1].min(), line[:, 1].max()]) == pytest.approx([1.0, 9.0])
    np.testing.assert_allclose(line[:, 0], -320.0)


def test_a_lens_of_mesh_files_is_drawn_in_section(tmp_path):
    drawn = stopped_down("achromat_100mm")
    world = lf.build(camera("plano_convex_25mm"), rings=12)
    world.mesh("lens[0]").export(tmp_path / "lens.stl")
    surface = {"refractor": {"file": str(tmp_path / "lens.stl"), "units": "mm", "index": 1.5}, "semi_diameter_mm": 11.0}
    scene = drawn.scene.changed({"camera.lens": {"surfaces": [surface]}, "camera.focus_mm": 400.0})
    scene = scene.changed({"camera.mla.distance_mm": None, "camera.lens.stop_semi_diameter_mm": None})
    (glass,) = layout(scene).glass
    y = glass.front[:, 1]
    assert y.max() > 11.0
    truth = sag(prescription("plano_convex_25mm").surfaces[0], y)
    np.testing.assert_allclose(glass.front[:, 0], truth, atol=0.02)
    np.testing.assert_allclose(glass.back[:, 0], 7.0, atol=0.02)


def diffractive(phase: dict) -> lf.Scene:
    """A metalens in air behind the stop, without glass."""
    surfaces = [{"stop": True, "thickness_mm": 2.0, "semi_diameter_mm": 2.0}, {"semi_diameter_mm": 6.0, "phase": phase}]
    return lf.Scene(
        camera={
            "focus_mm": 1000.0, "lens": {"surfaces": surfaces}, "sensor": {"pixels": (60, 60), "pixel_mm": 0.02},
        },
        transport={"wavelengths_nm": (550.0,)},
    )  # fmt: skip


def test_a_diffractive_surface_is_drawn_with_its_order_and_rays_in_it(tmp_path):
    """Several orders are drawn by the main one, and the drawing says so."""
    metalens = {"kind": "metalens", "focal_length_mm": 20.0, "design_nm": 550.0}
    one = layout(diffractive(metalens))
    several = layout(diffractive({**metalens, "orders": [{"order": 0, "share": 0.4}, {"order": 1, "share": 0.5}]}))
    (face,) = one.diffractive
    assert (face.name, face.orders) == ("surface[1]", "order +1")
    np.testing.assert_allclose(face.line[:, 0], 2.0)
    assert several.diffractive[0].orders == "order +1 alone"
    for drawn, other in zip(one.bundles, several.bundles, strict=True):
        for ray, same in zip(drawn.rays, other.rays, strict=True):
            np.testing.assert_allclose(ray.points, same.points, atol=1e-12)
    # The axial bundle meets on the sensor.
    ends = np.array([ray.points[-1, :2] for ray in one.bundles[0].rays])
    np.testing.assert_allclose(ends, 0.0, atol=1e-3)
    lf.draw(one.scene, tmp_path / "layout.svg")
