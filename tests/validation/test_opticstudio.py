"""Rays and spots of a singlet against OpticStudio's listings, to their printed digits.

The listings are those of OpticStudio 20.3.2 that come with the tests of ZOSPy (github.com/MREYE-LUMC/ZOSPy, tests/data/
reference, Single Ray Trace and Ray Fan of its "simple system"): a stop of 1 mm in front of a biconvex lens of n = 1.5,
radii of 20 mm, 1 mm thick, the image 19.792 mm behind it, an object at infinity on the axis.
"""

import math

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.analysis.analysis import ACROSS
from lfmesh.waves.bundle import pupil_grid

IMAGE_MM = 19.792
RAY = (
    # x = y, z in mm, and the direction's cosines in x = y and z behind the surface, of the ray through (1, 1) mm
    (1.0, 0.05006265674, -0.016694518, 0.9997212542),
    (0.98494782874, 0.95143492457, -0.04982749, 0.9975141315),
    (-0.0061213962872, 20.792, -0.04982749, 0.9975141315),
)
PATHS_MM = (0.9016235916, 19.890009023)
"""Between the surfaces, and from the second one to the image."""
FAN_UM = (
    0.09850086991911033, 0.19400674618204328, 0.28352156909319803, 0.36404714601789845, 0.4325820827589255,
    0.48612071234632737, 0.5216520203706332, 0.5361585659867663, 0.5266153977094845, 0.4899889631108656,
    0.4232360115237199, 0.3233024888489311, 0.18712242353879915, 0.011616802834235607, -0.2063075616964838,
    -0.4697591802775847, -0.781863043681108, -1.1457617956227573, -1.564616919812023, -2.041609942697864,
)  # fmt: skip
"""Transverse aberration of the rays at 1/20, 2/20, ..., 20/20 of the pupil's radius, in both sections."""


BEFORE_MM = 1.0
"""Where our stop stands before the lens; under parallel light along the axis that changes nothing."""


@pytest.fixture(scope="module")
def scene() -> lf.Scene:
    surfaces = (
        {"stop": True, "thickness_mm": BEFORE_MM, "semi_diameter_mm": 1.0},
        {"radius_mm": 20.0, "thickness_mm": 1.0, "index": 1.5, "semi_diameter_mm": 3.0},
        {"radius_mm": -20.0, "semi_diameter_mm": 3.0},
    )
    return lf.Scene(
        camera={
            "lens": {"surfaces": surfaces},
            "sensor": {"pixels": (64, 64), "pixel_mm": 0.1, "distance_mm": IMAGE_MM},
        },
        transport={"wavelengths_nm": (543.0,)},
    )


@pytest.fixture(scope="module")
def whole(scene: lf.Scene) -> lf.Scene:
    """The same with a stop that lets the skew ray through, which OpticStudio's does not hold back."""
    return scene.changed({"camera.lens.surfaces[0].semi_diameter_mm": 2.0})


def test_a_skew_ray_is_the_listed_one(whole: lf.Scene) -> None:
    paths = lf.trace(lf.build(whole), [[1.0, 1.0, -5.0]], [[0.0, 0.0, 1.0]], split="transmit", record=True)
    places = np.array([vertex.position for vertex in paths.vertices(0)][1:]) - [0.0, 0.0, BEFORE_MM]
    assert len(places) == len(RAY)
    for found, (beside, along, *_) in zip(places, RAY, strict=True):
        # Of eleven digits after the point.
        np.testing.assert_allclose(found, [beside, beside, along], rtol=0.0, atol=1e-11)
    legs = np.diff(places, axis=0)
    lengths = np.linalg.norm(legs, axis=1)
    assert (np.abs(lengths - PATHS_MM) < [1e-10, 1e-9]).all()
    for found, (_, _, cos_x, cos_z) in zip(legs / lengths[:, None], RAY, strict=False):
        np.testing.assert_allclose(found, [cos_x, cos_x, cos_z], rtol=0.0, atol=6e-11)


@pytest.mark.parametrize("engine", ["mesh", "sequential"])
def test_ray_fans_are_the_listed_ones(scene: lf.Scene, engine: str) -> None:
    world, heights = lf.build(scene), np.arange(1, 21) / 20.0
    # The outermost ray meets the rim to rounding.
    heights[-1] -= 1e-13
    for axis in range(2):
        starts = np.zeros((20, 3))
        starts[:, axis], starts[:, 2] = heights, -5.0
        paths = lf.trace(world, starts, np.tile([0.0, 0.0, 1.0], (20, 1)), split="transmit", engine=engine)
        np.testing.assert_array_equal(paths.source, np.arange(20))
        np.testing.assert_allclose(1e3 * paths.position[:, axis], FAN_UM, rtol=0.0, atol=1e-9)


def test_spot_radii_are_those_of_the_listed_fan(scene: lf.Scene) -> None:
    """RMS over the pupil's area and largest radius: the fan is an odd polynomial of the height to its last digits."""
    heights, powers = np.arange(1, 21) / 20.0, np.array([1, 3, 5, 7])
    terms, *_ = np.linalg.lstsq(heights[:, None] ** powers, np.array(FAN_UM), rcond=None)
    np.testing.assert_allclose(heights[:, None] ** powers @ terms, FAN_UM, atol=1e-7)
    # The mean of ε² over the pupil is ∫ 2 ρ ε² dρ.
    mean = 2.0 * np.sum(np.outer(terms, terms) / (np.add.outer(powers, powers) + 2))
    spot = lf.analyse(scene, object_mm=math.inf, across=256).spots[0]
    assert 1e3 * spot.rms_mm == pytest.approx(math.sqrt(mean), rel=5e-4)
    assert 1e3 * spot.rms_chief_mm == pytest.approx(math.sqrt(mean), rel=5e-4)
    # On the sheet's own grid, whose outermost ray is not on the rim, the listed fan gives the sheet's figures.
    height = np.hypot(*pupil_grid(ACROSS).T)
    listed = np.abs(height[:, None] ** powers @ terms)
    spot = lf.analyse(scene, object_mm=math.inf).spots[0]
    assert 1e3 * spot.rms_mm == pytest.approx(np.sqrt(np.mean(listed**2)), rel=2e-6)
    assert 1e3 * spot.geo_mm == pytest.approx(listed.max(), rel=2e-6)
    assert listed.max() < abs(FAN_UM[-1]) < 1.06 * listed.max()
