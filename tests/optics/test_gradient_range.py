"""The range of an index over a region against dense samples of its formula and against closed forms."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from lfmesh.errors import GlassError
from lfmesh.optics.bounds import Range
from lfmesh.optics.gradient_range import GlassRegion, InBox, OnAxis, depth_range, index_range
from lfmesh.optics.gradient_shapes import (
    GradientMaterial,
    GradientProfile,
    at_wavelength,
    radial_and_axial_profile,
    radial_square_profile,
    revolved_profile,
    separable_profile,
    spherical_profile,
)
from lfmesh.optics.gradients import fields_at, gradient_table

Array = NDArray[np.float64]

SAMPLES = 40_000
MATERIAL = GradientMaterial(np.array([[0.3, 0.1], [0.02, 0.0]]), np.array([[0.01, 0.003], [0.04, 0.0]]), 587.6)


@dataclass(frozen=True)
class Meniscus(GlassRegion):
    """Glass between two paraboloids, z = r²/2R, that ends in a cylinder."""

    front_mm: float
    back_mm: float
    length_mm: float
    rim_mm: float

    @property
    def corners_mm(self) -> tuple[tuple[float, float], tuple[float, float]]:
        return (-self.rim_mm, -self.rim_mm), (self.rim_mm, self.rim_mm)

    @property
    def radii_mm(self) -> tuple[float, float]:
        return 0.0, self.rim_mm

    def depths(self, radii: Range) -> Range:
        front, back = ([0.5 * r * r / radius for r in radii] for radius in (self.front_mm, self.back_mm))
        return np.minimum(*front), self.length_mm + np.maximum(*back)

    def points(self, draw: np.random.Generator) -> Array:
        r, turn = self.rim_mm * np.sqrt(draw.uniform(size=SAMPLES)), draw.uniform(0.0, 2.0 * np.pi, SAMPLES)
        # A quarter of the points on each face, on the edge, and on the axis.
        r[::4], r[3::4] = self.rim_mm, 0.0
        share = draw.uniform(size=SAMPLES)
        share[1::4], share[2::4] = 0.0, 1.0
        low, high = self.depths((r, r))
        return np.column_stack([r * np.cos(turn), r * np.sin(turn), low + share * (high - low)])


def random_profile(kind: str, draw: np.random.Generator) -> GradientProfile:
    terms = [float(each) for each in draw.uniform(-1.0, 1.0, 6)]
    match kind:
        case "radial":
            return radial_square_profile(3.0, [0.05 * terms[0], 0.01 * terms[1], 0.002 * terms[2]])
        case "mixed":
            return radial_and_axial_profile(3.0, [0.1 * terms[0], 0.02 * terms[1]], [0.2 * terms[2], 0.1 * terms[3]])
        case "spherical":
            return spherical_profile(7.0 * np.sign(terms[0]), [3.0, 0.1 * terms[1], 0.05 * terms[2], 0.01 * terms[3]])
        case "ball":
            # The centre lies in the glass.
            return spherical_profile(1.0 + terms[0], [3.0, 0.1 * terms[1], 0.05 * terms[2]])
        case "dispersive":
            profile = radial_and_axial_profile(2.0, [0.1 * terms[0], 0.02 * terms[1]], [0.1 * terms[2]])
            return at_wavelength(profile, MATERIAL, 450.0)
        case _:
            x, y, z = [0.0, *terms[:2]], [0.0, *terms[2:4]], [3.0, *terms[4:]]
            scales = 0.2 ** np.arange(3)
            return separable_profile(x * scales, y * scales, z * scales, folded=kind == "folded")


@pytest.mark.parametrize("kind", ["radial", "mixed", "spherical", "ball", "dispersive", "separable", "folded"])
@pytest.mark.parametrize("seed", range(6))
def test_the_range_holds_all_of_the_glass_and_is_reached(kind: str, seed: int) -> None:
    draw = np.random.default_rng([seed, 66])
    profile = random_profile(kind, draw)
    front, back = draw.choice([-1.0, 1.0], 2) * draw.uniform(5.0, 30.0, 2)
    region = Meniscus(float(front), float(back), 2.0, 1.5)
    found = index_range(profile, region)
    sampled = np.sqrt(fields_at(gradient_table([profile]), 0, region.points(draw))[:, 0])
    # A search ends within 1e-8 of the smallest value, or of its square.
    assert found.least.value <= sampled.min() + 1e-8
    assert found.most.value >= sampled.max() - 1e-8
    spread = sampled.max() - sampled.min()
    assert found.least.value >= sampled.min() - 0.02 * spread
    assert found.most.value <= sampled.max() + 0.02 * spread
    for each in found:
        low, high = (float(ends[0]) for ends in region.depths((np.array([each.radius_mm]),) * 2))
        assert each.radius_mm <= region.rim_mm
        assert low - 1e-12 <= each.z_mm <= high + 1e-12


def test_a_ring_between_two_equal_indices_is_found() -> None:
    """n = 1.5 − r² + r⁴/4 is 1.5 on the axis and at r = 2, and 0.5 at √2."""
    least, most = index_range(radial_and_axial_profile(1.5, [-1.0, 0.25]), Meniscus(math.inf, math.inf, 0.3, 2.0))
    assert least.value == pytest.approx(0.5, abs=1e-8)
    assert least.radius_mm == pytest.approx(math.sqrt(2.0), rel=1e-4)
    assert most.value == pytest.approx(1.5, abs=1e-8)


def test_a_narrow_dip_between_depths_is_found() -> None:
    """A Chebyshev polynomial has all its extremes at 1 and −1, the closest ones at the ends."""
    degree, length = 12, 4.0
    chebyshev = np.polynomial.chebyshev.Chebyshev.basis(degree, [0.0, length])
    power = chebyshev.convert(kind=np.polynomial.Polynomial, domain=[-1.0, 1.0], window=[-1.0, 1.0]).coef
    least, most = index_range(revolved_profile([[2.0 + power[0], *power[1:]]]), OnAxis(length))
    # The powers of z lose eight digits.
    assert (least.value, most.value) == pytest.approx((1.0, 3.0), abs=1e-7)


def test_equal_indices_are_told_by_the_place_nearest_the_axis() -> None:
    least, _ = index_range(radial_and_axial_profile(1.5, (), [-0.1]), Meniscus(math.inf, math.inf, 3.0, 2.0))
    assert (least.radius_mm, least.z_mm) == (0.0, 3.0)
    assert least.in_words() == "index 1.2 on the axis at z = 3 mm"


def test_a_box_beside_the_axis_has_no_index_of_the_axis() -> None:
    found = index_range(radial_and_axial_profile(2.0, [-0.1]), InBox((1.0, -1.0, 0.0), (2.0, 2.0, 1.0)))
    assert (found.most.value, found.least.value) == pytest.approx((1.9, 1.2), abs=1e-8)
    assert depth_range(InBox((1.0, -1.0, 0.5), (2.0, 2.0, 1.0))) == (0.5, 1.0)


@pytest.mark.parametrize("coefficient", [1e120, -1e300, math.inf])
def test_terms_beyond_float64_are_refused(coefficient: float) -> None:
    with pytest.raises(GlassError, match=r"a term of the formula of the index reaches"):
        index_range(radial_and_axial_profile(1.5, [0.0, coefficient]), Meniscus(math.inf, math.inf, 3.0, 2.0))
