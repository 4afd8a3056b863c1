"""Path differences and Zernike coefficients against listings of OpticStudio and CODE V, to their printed digits.

OpticStudio 25.1.1 and 20.3.2: Zernike Standard Coefficients of a biconvex singlet, with the tests of ZOSPy
(github.com/MREYE-LUMC/ZOSPy, tests/data/reference, test_zernike_standard_coefficients of the simple, the decentered and
the object height system).
OpticStudio 26.1.0: optical path difference fans of its sample "Cooke 40 degree field"
(github.com/VendettaMask/opticalsystem, validation/zemax/2026-r1/standard-sample-opd-2026-10-06).
CODE V 10.8: the option ANA for its sample double Gauss (github.com/mjhoptics/ray-optics, codev/ag_dblgauss.lis).

A field angle upwards is that of rays that go up, from an object below the axis: the pupil is turned by half a turn
against ours.
"""

import dataclasses
import math

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

import lfmesh as lf
from lfmesh.waves.bundle import LensRays
from lfmesh.waves.wavefront import path_differences

Array = NDArray[np.float64]

SINGLET_IMAGE_MM = 1.0 + 19.792
LISTED_COEFFICIENTS = {
    # field: Noll's terms from 1 on, waves of 543 nm
    "axis": {1: -0.01473686, 4: 0.00031809, 11: 0.00684048, 22: 3.01e-6},
    "10 and 20 degrees": {
        1: 4.02513343, 2: -0.10648889, 3: -0.219812, 4: 2.33101678, 5: 0.87167548, 6: -0.68850307, 7: -0.07753531,
        8: -0.03756232, 9: -0.00240843, 10: -0.01090353, 11: 0.00550002, 12: 0.00063092, 13: -0.00079878,
        14: 0.00002652, 15: 0.0001114, 16: 0.00004788, 17: 0.00009883, 18: -0.0000304, 19: -6.72e-6, 20: 2.4e-6,
        21: -1.96e-6, 22: -2.92e-6,
    },
    "1 and 2 mm, at 10 mm": {
        1: -42.51603929, 2: -0.42563624, 3: -0.85127249, 4: -24.55667978, 5: 1.01683361, 6: -0.76262521,
        7: -0.30036605, 8: -0.15018302, 9: -0.00383358, 10: -0.0210847, 11: -0.0077611, 12: 0.00341074,
        13: -0.00454765, 14: -0.00010265, 15: -0.00035195, 16: 0.00016466, 17: 0.00032933, 18: 0.0000951,
        19: 0.00001729, 20: 3.58e-6, 21: -3.32e-6, 22: 8.86e-6,
    },
}  # fmt: skip

TRIPLET_IMAGE_MM = 3.25896 + 6.00755 + 0.99997 + 4.75041 + 2.95208 + 42.20778
TRIPLET_FANS = (
    # degrees, nm, places in the entrance pupil over its radius, waves
    (0.0, 550.0, [(0.0, 0.25), (0.0, 0.5), (0.0, 0.75), (0.0, 1.0)], [
        -0.11215519058722796, -0.37821109723546914, -0.61071365866476923, -0.59175102236640564,
    ]),
    (20.0, 480.0, [(0.0, -1.0), (0.0, -0.75), (0.0, -0.5), (0.0, -0.25), (0.0, 0.25), (0.0, 0.5), (0.0, 0.75),
                   (0.0, 1.0), (0.25, 0.0), (0.5, 0.0), (0.75, 0.0), (1.0, 0.0)], [
        2.0568926792405295, 1.7270311027421197, 0.93289412237314762, 0.25731906654428521, 0.2604743297517087,
        0.94961377864142649, 1.7304559398398369, 1.8620740794154471, 0.13375533515415083, 0.54695082930296179,
        1.2383356235527259, 2.061570100819754,
    ]),
)  # fmt: skip

DOUBLE_GAUSS_DEFOCUS_MM = -0.400269
DOUBLE_GAUSS_PATHS = (
    # degrees, places in the stop, mm, and waves of 587.6 nm
    (10.0, [(0.0, 12.397180), (0.0, -12.209678), (15.727108, -0.223552)], [-3.972, -2.241, 1.889]),
    (14.0, [(0.0, 9.376192), (0.0, -9.874843), (15.754175, -0.328604)], [0.894, 0.361, 3.840]),
)


def turned(found: lf.Wavefront, towards: Array) -> lf.Wavefront:
    """Return a wavefront whose object point lies in this direction, in place of y."""
    x, y = towards / np.linalg.norm(towards)
    return dataclasses.replace(found, pupil=found.pupil @ np.array([[y, -x], [x, y]]))


@pytest.mark.parametrize(
    ("name", "towards", "object_mm"),
    [
        ("axis", (0.0, 0.0), math.inf),
        ("10 and 20 degrees", (-math.tan(math.radians(10.0)), -math.tan(math.radians(20.0))), math.inf),
        ("1 and 2 mm, at 10 mm", (1.0, 2.0), 10.0),
    ],
)
def test_zernike_coefficients_are_those_that_opticstudio_lists(
    name: str, towards: tuple[float, float], object_mm: float
) -> None:
    """To the last of eight digits after the point; of wavefronts of 88 waves to nine digits in all."""
    surfaces = (
        {"stop": True, "thickness_mm": 0.0, "semi_diameter_mm": 1.0},
        {"radius_mm": 20.0, "thickness_mm": 1.0, "index": 1.5, "semi_diameter_mm": 3.0},
        {"radius_mm": -20.0, "semi_diameter_mm": 3.0},
    )
    scene = lf.Scene(
        camera={"focus_mm": math.inf, "lens": {"surfaces": surfaces}, "sensor": {"pixels": (8, 8), "pixel_mm": 0.01}}
    )
    found = lf.wavefront(
        scene, math.hypot(*towards), 543.0, object_mm=object_mm, image_z_mm=SINGLET_IMAGE_MM, across=32
    )
    if any(towards):
        found = turned(found, np.array(towards))
    listed = np.zeros(37)
    for term, value in LISTED_COEFFICIENTS[name].items():
        listed[term - 1] = value
    # The terms from 23 on, which are below 4e-6, are not typed here.
    difference = np.abs(found.zernike(37, "noll") - listed)
    assert difference[:22].max() < 1e-8 + 2e-8 * np.abs(listed).max()
    assert difference[22:].max() < 7e-6


@pytest.fixture(scope="module")
def triplet() -> lf.Scene:
    """OpticStudio's Cooke triplet, of Schott's N-SK16; rays are aimed at the paraxial pupil, the stop is wider."""
    scene = lf.solved(lf.Scene(camera=camera_of("lib:cooke_triplet_50mm"), transport={"wavelengths_nm": (550.0,)}))
    glasses = {f"camera.lens.surfaces[{i}].glass": "SCHOTT/N-SK16" for i in (0, 4)}
    return scene.changed({**glasses, "camera.lens.surfaces[3].semi_diameter_mm": 5.0})


def camera_of(file: str, **lens: float) -> dict[str, object]:
    return {"focus_mm": math.inf, "lens": {"file": file, **lens}, "sensor": {"pixels": (8, 8), "pixel_mm": 0.01}}


@pytest.mark.parametrize(("degrees", "wavelength_nm", "pupil", "waves"), TRIPLET_FANS)
def test_fans_of_a_cooke_triplet_are_those_that_opticstudio_lists(
    triplet: lf.Scene, degrees: float, wavelength_nm: float, pupil: ArrayLike, waves: list[float]
) -> None:
    """Within 2e-4 waves: the prescription is rounded to 1e-5 mm."""
    slope = math.tan(math.radians(degrees))
    rays = LensRays(lf.build(triplet), math.inf, TRIPLET_IMAGE_MM)
    through = -5.0 * np.vstack([[0.0, 0.0], np.asarray(pupil)])
    entry = through + np.array([0.0, slope * lf.first_order(triplet).entrance_pupil_z_mm])
    # The chief ray's place in the image plane.
    chief = rays.traced([0.0, slope], entry[:1], wavelength_nm)
    on = (TRIPLET_IMAGE_MM - chief.position[0, 2]) / chief.direction[0, 2]
    found, _ = path_differences(rays, slope, entry, wavelength_nm, chief.position[0] + on * chief.direction[0])
    assert np.abs(found[1:] - waves).max() < 2e-4


@pytest.fixture(scope="module")
def double_gauss() -> LensRays:
    """CODE V's double Gauss at f/2, whose fourth face passes all listed rays."""
    camera = camera_of("lib:double_gauss_100mm", stop_semi_diameter_mm=15.762)
    scene = lf.solved(lf.Scene(camera=camera, transport={"wavelengths_nm": (587.6,)}))
    scene = scene.changed({"camera.lens.surfaces[3].semi_diameter_mm": 23.0})
    return LensRays(lf.build(scene), math.inf, lf.first_order(scene).image_z_mm + DOUBLE_GAUSS_DEFOCUS_MM)


def test_paths_on_the_axis_of_a_double_gauss_are_those_that_code_v_lists(double_gauss: LensRays) -> None:
    entry = np.zeros((5, 2))
    entry[1:, 0] = 25.0 * np.array([1.0, 0.8, 0.6, 0.4])
    image = np.array([0.0, 0.0, double_gauss.image_z_mm])
    found, _ = path_differences(double_gauss, 0.0, entry, 587.6, image)
    np.testing.assert_allclose(found[1:], [-3.137, -3.775, -4.052, -2.636], rtol=0.0, atol=6e-4)


@pytest.mark.parametrize(("degrees", "places", "waves"), DOUBLE_GAUSS_PATHS)
def test_paths_in_the_field_of_a_double_gauss_are_those_that_code_v_lists(
    double_gauss: LensRays, degrees: float, places: ArrayLike, waves: list[float]
) -> None:
    """CODE V's sphere passes through the point where the chief ray itself crosses the axis: 0.003 waves at most."""
    slope = math.tan(math.radians(degrees))
    pupil = -np.vstack([[0.0, 0.0], np.asarray(places)]) / double_gauss.stop_radius
    bundle = double_gauss.bundle(slope, pupil, 587.6)
    image = np.array([*bundle.place[0], double_gauss.image_z_mm])
    traced = double_gauss.traced([0.0, slope], bundle.entry, 587.6)
    up, along = traced.direction[0, 1:]
    radius = abs(image[1]) * math.hypot(up, along) / abs(up)
    _, path_mm = traced.onto_sphere(image, radius)
    np.testing.assert_allclose((path_mm[0] - path_mm[1:]) / 587.6e-6, waves, rtol=0.0, atol=6e-4)
    found, ours = path_differences(double_gauss, slope, bundle.entry, 587.6, image)
    assert 0.93 * radius < ours < radius
    np.testing.assert_allclose(found[1:], waves, rtol=0.0, atol=4e-3)
