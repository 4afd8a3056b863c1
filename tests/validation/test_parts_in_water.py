"""What stands before a camera that looks into water, by closed forms: fog, hot gas, lamps, spheres, gloss, polarisers.

Brewster's angle of a face in water is the arc tangent of its index over that of water, and spheres and facets scatter
by the same ratio. Power and radiance are those in the water; out of it radiance is divided by n².
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy import stats

import lfmesh as lf
from lfmesh.optics.gloss import EXTINCTION, INDEX, interface_reflectance
from tests.cameras import camera_without_array
from tests.renders import by_seed
from tests.validation.test_object_medium import GLASS, IN_WATER, PORT, WATER
from tests.validation.test_radiometry import patch

WAVELENGTH = 587.6


def pinhole(**scene: Any) -> lf.Scene:
    """A pixel that sees rays within 3° of the axis through a port in water."""
    stop = {"stop": True, "semi_diameter_mm": 0.2}
    sensor = {"pixels": [1, 1], "pixel_mm": 0.1, "distance_mm": 10.0}
    camera = {"lens": {"surfaces": [*PORT[:2], stop]}, "sensor": sensor, "object_medium": {"index": WATER}}
    glow = {"shape": {"kind": "plane", "width_mm": 30.0, "height_mm": 30.0}, "position_mm": [0.0, 0.0, -100.0],
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}  # fmt: skip
    return lf.Scene(
        camera=camera, targets=[glow], transport={"samples": 256, "split": "transmit", "threads": 1}, **scene
    )


def test_gas_in_water_emits_the_radiance_of_a_black_body_there() -> None:
    """That is n² times Planck's in air, by Kirchhoff; what a given emission is said to be in water it is."""
    bands = [{"name": "R", "center_nm": 620.0, "fwhm_nm": 20.0}]
    box = {"bounds": {"kind": "box", "size_mm": [9.0, 9.0, 4.0]}, "position_mm": [0.0, 0.0, -50.0]}
    media = [box | {"absorption_per_mm": 0.1, "temperature_k": 2500.0}, box | {"emission_w_mm3_sr": 1.0}]
    wet = pinhole().changed({"camera.sensor.bands": bands, "media": media})
    emission, in_air = (
        lf.build(scene).tables.objects.volumes.emission
        for scene in (wet, wet.changed({"camera.object_medium": {"index": 1.0}}))
    )
    np.testing.assert_allclose(emission[0], WATER**2 * in_air[0], rtol=1e-12)
    np.testing.assert_array_equal(emission[1], in_air[1])


def test_a_lamp_in_water_lights_a_patch_with_its_watts_over_the_sphere() -> None:
    """E = P cos θ / (4 π d²), whatever the index; the patch then looks as one that shines with ρ E / π."""
    lamp = {"kind": "point", "position_mm": [20.0, -15.0, -25.0], "power_w": 1.0}
    distance = np.sqrt(20.0**2 + 15.0**2 + 35.0**2)
    irradiance = 1e6 * 35.0 / distance / (4.0 * np.pi * distance**2)
    lit = patch([lamp]).changed(IN_WATER)
    shining = patch([], radiance=0.6 * irradiance / np.pi).changed(IN_WATER)
    sums = [np.array([image.mean.sum() for image in by_seed(each, range(12))]) for each in (lit, shining)]
    error = np.hypot(*(stats.sem(each) for each in sums))
    assert error < 0.01 * sums[1].mean()
    assert abs(sums[0].mean() - sums[1].mean()) < 4.0 * error + 1e-4 * sums[1].mean()


def test_spheres_in_water_scatter_by_their_index_over_the_waters(tmp_path: Any) -> None:
    """The phase function of fog, and of particles in a sheet of light, is that of spheres said to be in water."""
    fog = {"bounds": {"kind": "box", "size_mm": [9.0, 9.0, 4.0]}, "position_mm": [0.0, 0.0, -50.0],
           "scattering_per_mm": 0.05}  # fmt: skip
    (tmp_path / "points.csv").write_text("x_mm,y_mm,z_mm\n0.0,0.0,-50.0\n")
    sheet = {"point_mm": [0.0, 0.0, -50.0], "normal": [0.0, 0.0, 1.0], "direction": [1.0, 0.0, 0.0],
             "thickness_mm": 2.0, "width_mm": 20.0, "power_w": 1.0}  # fmt: skip

    def tables(mie: dict[str, Any], medium: dict[str, Any]) -> Any:
        phase = {"kind": "mie", "diameter_um": 2.0, "index": 1.59} | mie
        particles = {"file": "points.csv", "sheet": sheet, "phase": phase}
        scene = pinhole(media=[fog | {"phase": phase}], particles=[particles]).in_folder(tmp_path)
        built = lf.build(scene.changed(medium))
        lit = built.particles[0]
        return [built.tables.objects.volumes.phases.values, np.append(lit.scale, lit.phases.values)]

    in_air = {"camera.object_medium": {"index": 1.0}}
    for own, said, dry in zip(
        tables({}, {}), tables({"surrounding_index": WATER}, in_air), tables({}, in_air), strict=True
    ):
        np.testing.assert_array_equal(own, said)
        assert own.shape != dry.shape or np.abs(own / dry - 1.0).max() > 0.1


def test_light_at_brewsters_angle_of_a_port_in_water_passes_its_first_face_whole() -> None:
    """None of the light in the plane of incidence is reflected; Brewster's angle in air is another."""
    surfaces = [PORT[0], {"thickness_mm": 1.0, "semi_diameter_mm": 12.0}, {"stop": True, "semi_diameter_mm": 12.0}]
    camera = {"lens": {"surfaces": surfaces}, "sensor": {"pixels": [40, 40], "pixel_mm": 1.0, "distance_mm": 1.0}}
    scene = lf.Scene(
        camera=camera | {"object_medium": {"index": WATER}},
        transport={"polarisation": True, "wavelengths_nm": [WAVELENGTH]},
    )
    world, reflected = lf.build(scene), []
    for angle in (np.arctan(GLASS / WATER), np.arctan(GLASS)):
        ahead = np.array([np.sin(angle), 0.0, np.cos(angle)])
        paths = lf.trace(world, -10.0 * ahead, ahead, max_events=1, weight_cutoff=0.0, stokes=[1.0, 1.0, 0.0, 0.0])
        reflected.append(paths.weight[paths.direction[:, 2] < 0.0].sum())
    assert reflected[0] < 1e-12
    assert reflected[1] > 1e-4


def test_gloss_in_a_tank_reflects_by_its_index_over_the_liquids() -> None:
    """Facets at normal incidence: ((1.5 − 1.4) / (1.5 + 1.4))² in the liquid, in air ((1.5 − 1) / (1.5 + 1))²."""
    lacquer = {"reflectance": 0.0, "gloss": {"index": 1.5, "roughness": 0.3}}
    tank = {"size_mm": [40.0, 40.0, 40.0], "wall_mm": 2.0, "wall": {"index": 1.5}, "liquid": {"index": 1.4},
            "position_mm": [0.0, 0.0, -150.0]}  # fmt: skip
    # It stands on the floor of the tank, 18 mm below the middle, and reaches a little into it.
    box = {"shape": {"kind": "box", "size_mm": [6.0, 6.0, 6.0]}, "material": lacquer, "position_mm": [0.0, -15.1, -150]}
    outside = box | {"position_mm": [0.0, 0.0, -120.0]}
    scene = lf.Scene(camera=camera_without_array(), tanks=[tank], targets=[box, outside])
    half_in = scene.changed({"targets[0].position_mm": [0.0, 0.0, -131.0]})
    # Half in the tank it meets the wall too, in which it reflects nothing.
    for each, target, media in ((scene, 0, (1.4,)), (scene, 1, (1.0,)), (half_in, 0, (1.0, 1.5, 1.4))):
        objects = lf.build(each).tables.objects
        for around in media:
            medium = objects.media.indices[:, 0].tolist().index(around)
            model = objects.scattering.models[objects.glass.models[target, medium]]
            index, extinction = objects.scattering.parameters[model["first"] + np.array([INDEX, EXTINCTION]), 0]
            reflected = interface_reflectance(index, extinction, np.array([1.0]))
            assert reflected[0] == pytest.approx(((1.5 - around) / (1.5 + around)) ** 2, rel=1e-12)
    thin = scene.changed({"targets[0].material.gloss.index": 1.35, "targets[0].position_mm": [0.0, -14.9, -150.0]})
    with pytest.raises(lf.SceneError, match=r"gloss\.index = 1\.35: must not be below that of tanks\[0\] liquid, 1\.4"):
        lf.build(thin)
    on_floor = scene.changed({"targets[0].material.gloss.index": 1.45})
    with pytest.raises(lf.SceneError, match=r"gloss\.index = 1\.45: must not be below that of tanks\[0\] wall, 1\.5"):
        lf.build(on_floor)
    lf.build(on_floor.changed({"targets[0].position_mm": [0.0, -14.9, -150.0]}))


def test_a_stop_before_the_port_is_no_face_of_water() -> None:
    """Rays pass it straight on, in both engines; one that says air is a face."""
    stop = {"stop": True, "thickness_mm": 3.0, "semi_diameter_mm": 3.0}
    port = [{"thickness_mm": 4.0, "index": GLASS, "semi_diameter_mm": 20.0}, {"semi_diameter_mm": 20.0}]
    sensor = {"pixels": [40, 40], "pixel_mm": 1.0, "distance_mm": 5.0}
    camera = {"lens": {"surfaces": [stop, *port]}, "sensor": sensor, "object_medium": {"index": WATER}}
    scene = lf.Scene(camera=camera, transport={"split": "transmit"})
    ahead = np.array([0.3, 0.0, np.sqrt(1.0 - 0.09)])
    x = 3.0 * 0.3 / ahead[2]
    for index in (GLASS, 1.0):
        sine = 0.3 * WATER / index
        x += (4.0 if index == GLASS else 5.0) * sine / np.sqrt(1.0 - sine**2)
    for engine in ("mesh", "sequential"):
        world = lf.build(scene.changed({"transport.engine": engine}))
        paths = lf.trace(world, -10.0 * ahead, ahead, split="transmit")
        assert paths.position[0, 0] == pytest.approx(x, abs=1e-10)
    named = scene.changed({"camera.lens.surfaces[0].index": 1.0})
    assert lf.first_order(scene).entrance_pupil_z_mm == pytest.approx(0.0, abs=1e-12)
    paths = lf.trace(lf.build(named), -10.0 * ahead, ahead, split="transmit")
    assert paths.position[0, 0] > x + 0.1


SHEET: dict[str, Any] = {
    "shape": {"kind": "plane", "width_mm": 150.0, "height_mm": 150.0}, "position_mm": [0.0, 0.0, -75.0],
    "rotation_deg": [0.0, 20.0, 0.0],
    "material": {"reflectance": 0.0, "gloss": {"index": 1.5, "roughness": 0.3}},
}  # fmt: skip
HOT: dict[str, Any] = {
    "reflectance": 0.9, "temperature_k": 1500.0, "gloss": {"index": 1.5, "roughness": 0.3},
}  # fmt: skip
BAND = [{"name": "b", "center_nm": 600.0, "fwhm_nm": 30.0}]


def before_a_tank(
    targets: list[dict[str, Any]], method: str, lights: tuple[dict[str, Any], ...] = (), **sensor: Any
) -> lf.Scene:
    """A camera that sees, through the front of a tank, only what stands in the water."""
    surfaces = [
        {"radius_mm": 10.0, "thickness_mm": 2.0, "index": 1.5, "semi_diameter_mm": 2.2, "stop": True},
        {"radius_mm": -10.0, "semi_diameter_mm": 2.4},
    ]
    tank = {"size_mm": [40.0, 36.0, 20.0], "wall_mm": 2.0, "position_mm": [0.0, 0.0, -75.0], "wall": {"index": 1.5},
            "liquid": {"index": WATER}}  # fmt: skip
    return lf.Scene(
        camera={"focus_mm": 100.0, "lens": {"surfaces": surfaces, "f_number": 2.6},
                "sensor": {"pixels": [6, 6], "pixel_mm": 0.4, **sensor}},
        targets=targets, tanks=[tank], lights=list(lights),
        transport={"split": "transmit", "samples": 128 if method == "adjoint" else 4096, "method": method},
    )  # fmt: skip


def same_totals(one: lf.Scene, other: lf.Scene, within: float) -> None:
    """Compare the totals of two scenes by a z-test at 4 σ of 12 seeds, whose error is a small share of them."""
    sums = [np.array([image.mean.sum() for image in by_seed(each, range(12))]) for each in (one, other)]
    error = np.hypot(*(stats.sem(each) for each in sums))
    assert error < within * sums[0].mean()
    assert abs(sums[1].mean() - sums[0].mean()) < 4.0 * error


METHODS = pytest.mark.parametrize("method", ["adjoint", pytest.param("forward", marks=pytest.mark.long)])


@METHODS
def test_a_glossy_sheet_in_water_looks_the_same_where_it_goes_on_through_the_wall(method: str) -> None:
    """The part in view is in the water in both scenes, and reflects none of its own light."""
    lamp = {"kind": "point", "position_mm": [25.0, 5.0, -55.0], "power_w": 1.0}
    small = SHEET | {"shape": {"kind": "plane", "width_mm": 30.0, "height_mm": 30.0}}
    same_totals(*(before_a_tank([each], method, (lamp,)) for each in (small, SHEET)), within=0.1)


def ring(path: Path, inner: tuple[float, float], outer: tuple[float, float]) -> dict[str, Any]:
    """A hot glossy sheet between two rectangles, given by width and height in mm, about the middle of the tank."""
    (a, b), (c, d) = np.multiply(0.5, inner), np.multiply(0.5, outer)
    corners = [[[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]]
               for x0, y0, x1, y1 in ((-c, -d, c, -b), (-c, b, c, d), (-c, -b, -a, b), (a, -b, c, b))]  # fmt: skip
    faces = np.concatenate([np.array([[0, 1, 2], [0, 2, 3]]) + 4 * k for k in range(4)])
    trimesh.Trimesh(np.concatenate(corners), faces, process=False).export(path)
    return {"file": str(path), "units": "mm", "position_mm": [0.0, 0.0, -75.0], "material": HOT}


@METHODS
def test_a_hot_glossy_sheet_across_a_wall_looks_as_cut_at_the_faces_of_the_wall(tmp_path: Path, method: str) -> None:
    """Each of the three pieces is in one medium; all light their neighbours by total reflection at the window."""
    sheet = {"position_mm": [0.0, 0.0, -75.0], "material": HOT}
    whole = sheet | {"shape": {"kind": "plane", "width_mm": 150.0, "height_mm": 150.0}}
    gap = 2e-3
    pieces = [
        sheet | {"shape": {"kind": "plane", "width_mm": 36.0 - gap, "height_mm": 32.0 - gap}},
        ring(tmp_path / "wall.stl", (36.0 + gap, 32.0 + gap), (40.0 - gap, 36.0 - gap)),
        ring(tmp_path / "outside.stl", (40.0 + gap, 36.0 + gap), (150.0, 150.0)),
    ]
    one, other = before_a_tank([whole], method, bands=BAND), before_a_tank(pieces, method, bands=BAND)
    assert len(np.unique(lf.build(one).tables.objects.glass.models[0])) == 3
    same_totals(one, other, within=0.02)


@pytest.mark.long
def test_both_methods_show_the_same_hot_gloss_across_a_wall() -> None:
    """What the forward method starts in water has n² times its power in air."""
    whole = {
        "shape": {"kind": "plane", "width_mm": 150.0, "height_mm": 150.0},
        "position_mm": [0.0, 0.0, -75.0],
        "material": HOT,
    }
    both = (before_a_tank([whole], method, bands=BAND) for method in ("adjoint", "forward"))
    same_totals(*both, within=0.05)
