"""A path's history obeys the laws of optics: R + T = 1, Snell's law, and powers that are products of R and T."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene import load_lens
from lfmesh.view.rays.history import history, lines
from lfmesh.view.rays.launch import from_field_point, from_pixels

BENDS = (lf.Event.TRANSMITTED, lf.Event.REFLECTED)
POINT = (8.0, -5.0, -400.0)


def world_of(surface="exact", lens="double_gauss_50mm", **more):
    form = {"decenter_mm": 0.004, "radius_error": 0.02} if surface == "exact" else {}
    mla = lf.MicrolensArray(
        layout="hexagonal", count=(40, 40), pitch_mm=0.125, focal_length_mm=0.5, glass="SCHOTT/N-BK7",
        thickness_mm=0.3, form=lf.ArrayForm(**form),
    )  # fmt: skip
    camera = lf.Camera(
        lens=load_lens(asset_path(f"lenses/{lens}.toml")),
        focus_mm=400.0,
        mla=mla,
        sensor=lf.Sensor(pixels=(60, 50), pixel_mm=0.08),
    )
    coarse = lf.Tessellation() if surface == "exact" else lf.Tessellation(sag_mm=0.01)
    transport = lf.Transport(surface=surface, wavelengths_nm=(486.1, 656.3), tessellation=coarse)
    return lf.build(lf.Scene(camera=camera, transport=transport, **more))


@pytest.fixture(scope="module")
def world():
    return world_of()


@pytest.fixture(scope="module")
def rays(world):
    return from_field_point(world, POINT, 120, aim="lens", weight_cutoff=0.003)


def histories(rays, most=400):
    for path in np.unique(np.linspace(0, len(rays) - 1, most).astype(int)):
        yield int(path), history(rays, int(path))


def check_laws(rays, most, tolerance_deg=1e-6):
    """Check every step of some paths; return how many refractions, reflections and roulettes there were."""
    seen = {lf.Event.TRANSMITTED: 0, lf.Event.REFLECTED: 0, "roulette": 0, "total": 0}
    for path, steps in histories(rays, most):
        part = rays.position[rays.offsets[path] : rays.offsets[path + 1]]
        assert steps[0].event == lf.Event.START
        product = 1.0
        for number, step in enumerate(steps):
            np.testing.assert_array_equal(step.position_mm, part[number])
            if step.event not in BENDS or step.reflectance is None:
                continue
            before = steps[number - 1]
            assert step.reflectance + step.transmittance == pytest.approx(1.0, abs=1e-12)
            arriving, leaving = part[number] - part[number - 1], part[number + 1] - part[number]
            lengths = np.linalg.norm(arriving), np.linalg.norm(leaving)
            if lengths[1] > 1e-6:
                turned = np.arccos(np.clip(arriving @ leaving / (lengths[0] * lengths[1]), -1.0, 1.0))
                incidence = np.deg2rad(step.incidence_deg)
                if step.event == lf.Event.REFLECTED:
                    assert step.medium == before.medium
                    expected = np.pi - 2.0 * incidence
                else:
                    sine = before.index / step.index * np.sin(incidence)
                    expected = abs(incidence - np.arcsin(min(sine, 1.0)))
                # arccos loses half of the digits of a small turn.
                assert turned == pytest.approx(expected, abs=np.deg2rad(tolerance_deg) + 1e-7 + 1e-12 / min(lengths))
            share = step.transmittance if step.event == lf.Event.TRANSMITTED else step.reflectance
            product *= share
            seen[step.event] += 1
            seen["total"] += step.transmittance == 0.0
            if step.roulette > 1.0 + 1e-9:
                seen["roulette"] += 1
            else:
                assert step.power == pytest.approx(before.power * share, rel=1e-9)
            product *= step.roulette
        if all(step.reflectance is not None for step in steps if step.event in BENDS):
            assert steps[-1].power == pytest.approx(steps[0].power * product, rel=1e-8)
    return seen


def test_laws_hold_along_every_path_with_the_light(rays):
    seen = check_laws(rays, 500)
    assert seen[lf.Event.TRANSMITTED] > 4000
    assert seen[lf.Event.REFLECTED] > 500
    assert seen["roulette"] > 50
    assert seen["total"] > 0
    assert all(s.reflectance is not None for _, steps in histories(rays, 100) for s in steps if s.event in BENDS)


def test_laws_hold_along_every_path_from_the_sensor(world):
    seen = check_laws(from_pixels(world, range(20, 23), range(30, 33), 100), 300)
    assert seen[lf.Event.TRANSMITTED] > 1000
    assert seen[lf.Event.REFLECTED] > 100


def test_laws_hold_at_tilted_and_decentred_elements(world):
    """Angles are those to the surface where it stands: without its pose they would be off by degrees."""
    pose = {"tilt_deg": (3.0, -1.0, 10.0), "shift_mm": (0.4, 0.2, 0.3)}
    elements = [{"surfaces": (6, 7, 8, 9, 10), "pose": pose}, {"surfaces": (0,), "pose": {"tilt_deg": (0.0, 0.5, 0.0)}}]
    posed = lf.build(world.scene.changed({"camera.lens.elements": elements}))
    seen = check_laws(from_field_point(posed, POINT, 60, aim="lens", weight_cutoff=0.003), 200)
    assert seen[lf.Event.TRANSMITTED] > 1000
    assert seen[lf.Event.REFLECTED] > 100


def test_laws_hold_at_lenslets_on_both_faces(world):
    """Angles are those to the face where it stands: to a flat one they would be off by degrees."""
    array = {"camera.mla.focal_length_mm": None, "camera.mla.radius_mm": 0.3}
    back = {"radius_mm": 0.4, "decenter_mm": [0.01, -0.02]}
    plate = lf.build(world.scene.changed(array | {"camera.mla.back": back}))
    seen = check_laws(from_field_point(plate, POINT, 60, aim="lens", weight_cutoff=0.003), 200)
    assert seen[lf.Event.TRANSMITTED] > 1000
    assert seen[lf.Event.REFLECTED] > 100


@pytest.mark.parametrize("surface", ["flat", "patch"])
def test_laws_hold_where_a_facet_stands_for_the_surface(surface):
    """The normal is then the one that bent the path, not the exact surface's, which is several mrad off it."""
    seen = check_laws(from_field_point(world_of(surface), POINT, 40, aim="lens"), 100)
    assert seen[lf.Event.TRANSMITTED] > 500


def test_without_roulette_the_power_is_the_product_of_the_shares(rays):
    followed = 0
    for _, steps in histories(rays, 300):
        if any(step.roulette > 1.0 + 1e-9 for step in steps):
            continue
        shares = [
            s.transmittance if s.event == lf.Event.TRANSMITTED else s.reflectance for s in steps if s.event in BENDS
        ]
        assert steps[-1].power == pytest.approx(steps[0].power * np.prod(shares), rel=1e-9)
        followed += len(shares) > 10
    assert followed > 30


def test_media_are_those_of_the_prescription(rays):
    """On the image path: the glass of every element, the array's, and air elsewhere; indices at the wavelength."""
    path = int(np.flatnonzero(rays.sequence == 0)[0])
    steps = history(rays, path)
    indices = [1.0, 1.67, 1.0, 1.67, 1.699, 1.0, 1.603, 1.658, 1.0, 1.717, 1.0]
    assert [step.index for step in steps[:11]] == indices
    assert [step.medium for step in steps[:4]] == ["air", "n = 1.67", "air", "n = 1.67"]
    assert [step.medium for step in steps[11:]] == ["SCHOTT/N-BK7", "air", "air"]
    # Published values of the catalogue glass at the F and C lines.
    bk7 = {486.1: 1.52238, 656.3: 1.51432}
    assert steps[11].index == pytest.approx(bk7[rays.wavelength_nm[path]], abs=5e-6)
    assert [step.short for step in steps[-3:]] == ["MLAc", "MLAf", "sensor"]


def test_normal_incidence_on_the_axis_is_what_fresnel_says():
    """A ray along the axis of a plano-convex lens: 0° everywhere, R = ((n − 1)/(n + 1))²."""
    camera = lf.Camera(
        lens=load_lens(asset_path("lenses/plano_convex_25mm.toml")), focus_mm=300.0,
        sensor=lf.Sensor(pixels=(50, 50), pixel_mm=0.1),
    )  # fmt: skip
    world = lf.build(lf.Scene(camera=camera))
    rays = from_field_point(world, (0.0, 0.0, -300.0), 4000, split="transmit")
    first = rays.offsets[:-1] + 1
    axial = int(np.argmin(np.hypot(rays.position[first][:, 0], rays.position[first][:, 1])))
    steps = history(rays, axial)
    bends = [step for step in steps if step.event in BENDS]
    assert len(bends) == 2
    n = bends[0].index
    for step in bends:
        assert step.incidence_deg < 3.0
        assert step.reflectance == pytest.approx(((n - 1.0) / (n + 1.0)) ** 2, rel=1e-3)


def test_a_body_of_glass_in_object_space_is_a_medium_too(tmp_path):
    glass = tmp_path / "block.stl"
    trimesh.creation.box((40.0, 40.0, 5.0)).export(glass)
    block = lf.Target(
        name="window", position_mm=(0.0, 0.0, -50.0), rotation_deg=(20.0, 0.0, 0.0),
        refractor=lf.Refractor(file=str(glass), units="mm", index=1.5, surface="flat"),
    )  # fmt: skip
    rays = from_field_point(world_of(targets=(block,)), POINT, 40)
    check_laws(rays, 200)
    steps = history(rays, int(np.flatnonzero(rays.sequence == 0)[0]))
    assert [step.medium for step in steps[1:3]] == ["n = 1.5", "air"]
    assert [step.short for step in steps[1:3]] == ["window", "window"]
    # Through parallel faces: out as it came in.
    out = np.arcsin(np.sin(np.deg2rad(steps[2].incidence_deg)) * 1.5)
    assert np.rad2deg(out) == pytest.approx(steps[1].incidence_deg, abs=1e-6)


def test_bodies_that_touch_have_no_air_between_them(tmp_path):
    def plate(name, index, z, thickness, **refractor):
        file = tmp_path / f"{name}.stl"
        trimesh.creation.box((40.0, 40.0, thickness)).export(file)
        body = lf.Refractor(file=str(file), units="mm", index=index, surface="flat", **refractor)
        return lf.Target(name=name, position_mm=(0.0, 0.0, z), refractor=body)

    # The block lies in the water, and the window on it.
    parts = plate("water", 1.333, -57.5, 10.0), plate("block", 1.7, -58.0, 3.0), plate("window", 1.5, -50.0, 5.0)
    rays = from_field_point(world_of(targets=parts), POINT, 40)
    check_laws(rays, 200)
    steps = history(rays, int(np.flatnonzero(rays.sequence == 0)[0]))[1:6]
    assert [step.medium for step in steps] == ["n = 1.333", "n = 1.7", "n = 1.333", "n = 1.5", "air"]
    assert all(step.event == lf.Event.TRANSMITTED for step in steps)
    for step, (n_i, n_t) in zip(steps[2:], [(1.7, 1.333), (1.333, 1.5), (1.5, 1.0)], strict=True):
        # Near normal incidence.
        assert step.reflectance == pytest.approx(((n_i - n_t) / (n_i + n_t)) ** 2, rel=0.02)


def test_the_sensor_is_met_at_the_angle_of_the_last_segment(rays):
    for path, steps in histories(rays, 200):
        if steps[-1].surface != "sensor":
            continue
        last = rays.position[rays.offsets[path + 1] - 2 : rays.offsets[path + 1]]
        d = last[1] - last[0]
        assert steps[-1].incidence_deg == pytest.approx(np.rad2deg(np.arccos(d[2] / np.linalg.norm(d))), abs=1e-5)


def test_lines_fit_80_columns_and_show_every_step(rays):
    for _, steps in histories(rays, 60):
        shown = lines(steps, rays.unit)
        assert len(shown) == len(steps) + 1
        assert max(map(len, shown)) <= 80
        for step, line in zip(steps, shown[1:], strict=True):
            assert line.startswith(step.short[:16])
            assert step.event.name.lower()[:7] in line
            assert ("x" in line[59:66]) == (step.roulette > 1.0 + 1e-6)


def test_long_names_are_cut_to_fit(rays):
    step = history(rays, 0)[1]
    long = replace(step, short="a target with a long name", medium="CATALOGUE/LONG-NAME-7", roulette=12345.6)
    assert max(map(len, lines([long], rays.unit))) <= 80


def test_a_path_that_is_not_there_is_refused(rays):
    for path in (-1, len(rays)):
        with pytest.raises(lf.LfmeshError, match=f"path {path}"):
            history(rays, path)
