"""Real rays through a triplet, and the spot of a singlet, against CODE V's listings, to their printed digits.

The listings (LIS, RSI and SPO) come with opticspy (github.com/Sterncat/opticspy, lens/CodeV_examples/cooke_triplet and
singlet). They give a ray's place at each surface, in the frame of its vertex, with five digits after the point.
"""

import math

import numpy as np
import pytest

import lfmesh as lf

PRINTED_MM = 1.5e-5
"""Half of the last digit, of the place where a ray starts as well, which the lens may double."""

# radius, thickness, index behind at 546.1 nm
TRIPLET = (
    (16.87831, 3.250000, 1.622861),
    (247.02634, 4.984142, 1.0),
    (-35.95718, 1.250000, 1.624078),
    (15.88615, 6.099225, 1.0),
    (49.08083, 3.250000, 1.622861),
    (-27.62109, 38.898042 - 0.183758, 1.0),
)
# tangent of the field angle, and x, y, z at the six surfaces and the image
RAYS = {
    "axis, upper": (0.0, [
        (0.0, 5.0, 0.75760), (0.0, 4.70132, 0.04474), (0.0, 3.84622, -0.20630), (0.0, 3.71819, 0.44125),
        (0.0, 3.95235, 0.15939), (0.0, 3.93475, -0.28170), (0.0, -0.00559, 0.0),
    ]),
    "14 degrees, chief": (math.tan(math.radians(14.0)), [
        (0.0, -2.34690, 0.16396), (0.0, -1.70714, 0.00590), (0.0, 0.0, 0.0), (0.0, 0.25521, 0.00205),
        (0.0, 2.44324, 0.06085), (0.0, 3.01656, -0.16522), (0.0, 12.37162, 0.0),
    ]),
    "14 degrees, skew": (math.tan(math.radians(14.0)), [
        (5.05146, -2.15865, 0.91898), (4.76091, -1.66933, 0.05152), (3.84637, -0.04450, -0.20634),
        (3.71578, 0.33712, 0.44435), (4.00616, 2.41637, 0.22349), (3.99480, 2.90331, -0.44505),
        (-0.02408, 12.36795, 0.0),
    ]),
    "20 degrees, upper": (math.tan(math.radians(20.0)), [
        (0.0, 1.99561, 0.11839), (0.0, 2.51249, 0.01278), (0.0, 3.84720, -0.20641), (0.0, 4.28087, 0.58766),
        (0.0, 8.35529, 0.71641), (0.0, 8.66181, -1.39329), (0.0, 17.94307, 0.0),
    ]),
    "20 degrees, lower": (math.tan(math.radians(20.0)), [
        (0.0, -8.10614, 2.07399), (0.0, -7.54857, 0.11536), (0.0, -3.84801, -0.20649), (0.0, -3.21693, 0.32912),
        (0.0, -0.59956, 0.00366), (0.0, 0.27187, -0.00134), (0.0, 17.90208, 0.0),
    ]),
}  # fmt: skip


@pytest.fixture(scope="module")
def world() -> lf.World:
    surfaces = [
        {"radius_mm": radius, "thickness_mm": thickness, "index": index, "semi_diameter_mm": 9.0}
        for radius, thickness, index in TRIPLET
    ]
    surfaces[2]["stop"] = True
    distance = surfaces[-1].pop("thickness_mm")
    camera = {
        "lens": {"surfaces": tuple(surfaces)},
        "sensor": {"pixels": (400, 400), "pixel_mm": 0.1, "distance_mm": distance},
    }
    return lf.build(lf.Scene(camera=camera))


@pytest.mark.parametrize("name", RAYS)
def test_a_ray_through_the_triplet_is_the_listed_one(world: lf.World, name: str) -> None:
    tangent, places = RAYS[name]
    vertices = np.concatenate([[0.0], np.cumsum([thickness for _, thickness, _ in TRIPLET])])
    listed = np.array(places)
    listed[:, 2] += vertices
    way = np.array([0.0, math.sin(math.atan(tangent)), math.cos(math.atan(tangent))])
    paths = lf.trace(world, [listed[0] - 10.0 * way], [way], split="transmit", record=True)
    found = np.array([vertex.position for vertex in paths.vertices(0)][1:])
    np.testing.assert_allclose(found, listed, rtol=0.0, atol=PRINTED_MM)


def test_the_spot_of_the_singlet_is_as_large_as_listed() -> None:
    """CODE V's from 316 rays on a square grid, the outermost on the rim or nearly: 1 %."""
    surfaces = (
        {"radius_mm": 50.0, "thickness_mm": 5.0, "index": 1.521414, "semi_diameter_mm": 12.0},
        {"radius_mm": 1175.71107, "semi_diameter_mm": 12.0},
    )
    camera = {
        "lens": {"surfaces": surfaces, "epd_mm": 20.0},
        "sensor": {"pixels": (64, 64), "pixel_mm": 0.1, "distance_mm": 96.572831},
    }
    scene = lf.Scene(camera=camera, transport={"wavelengths_nm": (500.0,)})
    # Half of the last digit of the listed index changes it by 1e-4 mm.
    assert lf.first_order(scene).efl_mm == pytest.approx(100.0, abs=1.5e-4)
    spot = lf.analyse(scene, object_mm=math.inf, across=256).spots[0]
    assert 2.0 * spot.rms_mm == pytest.approx(0.11592, rel=0.01)
    assert 2.0 * spot.geo_mm == pytest.approx(0.23154, rel=0.02)
